"""What is known at the time, where results come later than their samples: the samples whose results are in by then.

Between two results the set of those that are in stays the same. It is all samples up to some time, and of those since
then the quick ones: a branch of the system, whose nodes are samples again without what is out. No noise is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.bounded_directions import BoundedDirections, LazyDirections
from sampling_design.accuracy.finite import determined_at
from sampling_design.accuracy.gains import ROUNDING, followed_back, path_bounds
from sampling_design.accuracy.sampled_system import KnownSpan, MeasurementModel, SampledSystem
from sampling_design.records.arrays import Array, Index, Mask

SAME = 1e-9  # results that come within this share of all times come together, when the last of them does


class ResultsIn(NamedTuple):
    """A time from which on some results are in, until the next one."""

    begin: float
    end: float
    samples: Index  # those of which something measured may be out or is just in, in order; the last has something in
    times: Array
    arrived: Mask  # (k, p): what of them is in
    new: Index  # (m, 3): what comes in as it begins: place among them (negative: before them), sample, output


def results_in(times: Array, delays: Array, *, period: float | None = None, end: float = np.inf) -> list[ResultsIn]:
    """Return what is in, from one result to the next: over one `period` of an endless schedule, or until an `end`.

    `times` (N,) are those of the samples, the first 0; `delays` (N, p) those of each output of each of them, infinite
    where it is not measured. Of a finite schedule the first node is known at once.
    """
    return _endless(times, period, delays) if period is not None else _finite(times, end, delays)


def with_results_out(system: SampledSystem, delays: Array) -> SampledSystem:
    """Return a system in which each result counts from its delay (N, p) on, as for `results_in`."""
    times = np.append(0.0, np.cumsum([gap.length for gap in system.gaps]))
    if system.start is None:
        arrivals = results_in(times[:-1], delays, period=float(times[-1]))
    else:
        arrivals = results_in(times, delays, end=float(times[-1]) + system.last)
    spans, again, before, samples = list[KnownSpan](), list[int](), list[int](), list(system.samples)
    for arrival in arrivals:
        measured = np.isfinite(delays[arrival.samples])
        part = np.flatnonzero(np.any(measured & ~arrival.arrived, axis=1))
        node, first = int(arrival.samples[-1]), int(part[0]) if part.size else len(arrival.samples)
        path = dict(enumerate(arrival.samples.tolist()))
        for k in range(first, len(arrival.samples)):
            j = int(arrival.samples[k])
            before.append(
                len(samples) - 1 if k > first else (j - 1 if system.start is not None else (j - 1) % len(system))
            )
            again.append(j)
            samples.append(_without(system.samples[j], arrival.arrived[k]))
            node = path[k] = len(samples) - 1
        time, new = float(arrival.times[-1]), tuple((path.get(k, j), i) for k, j, i in arrival.new.tolist())
        spans.append(KnownSpan(node, time, arrival.begin - time, arrival.end - time, new))
    L = np.concatenate([system.L, system.L[again]]) if again else system.L
    return replace(
        system, L=L, samples=tuple(samples), known_spans=tuple(spans), again=tuple(again), before=tuple(before)
    )


class NodeBounds(LazyDirections):
    """What bounds the nodes of a system, of those too of which some results are out: these when they are asked for."""

    def __init__(self, system: SampledSystem, directions: Sequence[BoundedDirections]):
        super().__init__(len(system.samples))
        self._system, self._directions = system, directions

    def _bounded(self, at: int) -> BoundedDirections:
        return self._directions[at] if at < len(self._directions) else self._branch(at)

    def _branch(self, node: int) -> BoundedDirections:
        system, path = self._system, self._system.nodes(node, 1)
        if system.start is None:
            r = system.determined
            basis, reach = np.eye(system.D.size)[:, :r], self[path[0]].reach
            gains = [system.samples[node].K.T for node in path]
            cost, g, _, _ = followed_back(system, path, basis, lambda k, rest: gains[k] @ rest)
            return BoundedDirections(basis, (cost + reach @ np.abs(g[:r])) * (1 + ROUNDING))
        path = system.nodes(node, len(system))
        basis = determined_at(system, path)

        def known(k: int) -> Array | None:
            return self[path[k]].reach if k and self[path[k]].whole else None

        return BoundedDirections(basis, path_bounds(system, path, system.start, known, basis))


def with_branches(system: SampledSystem, directions: Sequence[BoundedDirections]) -> Sequence[BoundedDirections]:
    """Return what bounds the nodes of a system; `directions` are its samples'.

    Raises UndecidedError where something free has decayed so far that doubles cannot tell what is left.
    """
    found = NodeBounds(system, directions)
    free = system.start is not None and system.start.free().shape[1]
    return found[:] if free else found


def _without(sample: MeasurementModel, arrived: Mask) -> MeasurementModel:
    """A sample of which only some outputs are in."""
    keep = arrived[sample.outputs]
    return MeasurementModel(
        sample.outputs[keep], sample.size[keep], sample.H[keep], sample.noise[keep], sample.K[:, keep]
    )


def _endless(times: Array, period: float, delays: Array) -> list[ResultsIn]:
    """From the first result of the first sample on, over a period."""
    measured = np.isfinite(delays)
    longest = float(np.max(delays[measured], initial=0.0))
    more = int(np.ceil(longest / period)) + 2
    turns = np.arange(-more - 1, more + 1)
    every = (times[None, :] + period * turns[:, None]).ravel()
    index = np.tile(np.arange(times.size), turns.size).astype(np.intp)
    comes = every[:, None] + delays[index]
    earliest = int(np.argmax(measured.any(axis=1)))
    first = float(np.min(delays[earliest]) + times[earliest])
    tiny = SAME * period
    marks = _clusters(
        comes[np.isfinite(comes) & (comes < first + period + 2 * tiny) & (comes > first - 2 * tiny)], tiny
    )
    marks = marks[marks < marks[0] + period - tiny]
    ends = np.append(marks[1:], marks[0] + period)
    return _each(marks, ends, every, index, comes, measured[index], tiny, float(marks[-1]) - period)


def _finite(times: Array, end: float, delays: Array) -> list[ResultsIn]:
    """From the first node, where nothing is in, until the end."""
    index, comes, measured = np.arange(times.size), times[:, None] + delays, np.isfinite(delays)
    tiny = SAME * max(end, 0.0)
    marks = _clusters(comes[np.isfinite(comes) & (comes <= end + tiny)], tiny)
    first = float(marks[0]) if marks.size else end
    ends = np.append(marks[1:], max(end, float(marks[-1]))) if marks.size else marks
    found = _each(marks, ends, times, index, comes, measured, tiny)
    if marks.size and first <= tiny:
        return found
    nothing = np.zeros((1, delays.shape[1]), dtype=bool)
    return [ResultsIn(0.0, first, index[:1], times[:1], nothing, np.zeros((0, 3), dtype=np.intp)), *found]


def _each(
    marks: Array, ends: Array, times: Array, index: Index, comes: Array, measured: Mask, tiny: float,
    before: float = -np.inf,
) -> list[ResultsIn]:  # fmt: skip
    """What is in from each of some times on: all before the first sample of which something is out.

    `before` is the time of the last result before them.
    """
    tops = np.maximum.accumulate(np.max(comes, axis=1, where=measured, initial=-np.inf))
    lows = np.minimum.accumulate(np.min(comes, axis=1, where=measured, initial=np.inf)[::-1])[::-1]
    lasts = np.searchsorted(lows, marks + tiny, side="right") - 1
    firsts = np.minimum(np.searchsorted(tops, marks + tiny, side="right"), lasts)
    found, came = list[ResultsIn](), np.argwhere(measured & (comes > before + tiny))
    at = np.searchsorted(marks + tiny, comes[tuple(came.T)])
    for m, (begin, end, first, last) in enumerate(zip(marks, ends, firsts.tolist(), lasts.tolist(), strict=True)):
        part, new = slice(first, last + 1), came[at == m]
        arrived = measured[part] & (comes[part] <= begin + tiny)
        new = np.column_stack([new[:, 0] - first, index[new[:, 0]], new[:, 1]])
        found.append(ResultsIn(float(begin), float(end), index[part], times[part], arrived, new))
    return found


def _clusters(marks: Array, tiny: float) -> Array:
    """The last of all that lie closer together than a little, in order."""
    marks = np.sort(marks)
    return marks[np.append(np.diff(marks) > tiny, True)] if marks.size else marks
