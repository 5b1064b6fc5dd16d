"""What is known at the time, where results come later than their samples: the samples whose results are in by then.

Between two results the set of those that are in stays the same. It is all samples up to some time, and of those since
then the quick ones: a branch of the chain, whose nodes are samples again without what is out. No noise is added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.bounded_directions import BoundedDirections
from sampling_design.accuracy.finite import determined_at
from sampling_design.accuracy.gains import followed_back, path_bounds
from sampling_design.accuracy.sample_chain import ChainSample, KnownSpan, SampleChain
from sampling_design.records.arrays import Array, Index, Mask

SAME = 1e-9  # results that come within this share of all times come together, when the last of them does


class ResultsIn(NamedTuple):
    """A time from which on some results are in, until the next one."""

    begin: float
    end: float
    samples: Index  # those of which something measured may be out or is just in, in order; the last has something in
    times: Array
    seen: Mask  # (k, p): what of them is in


def results_in(times: Array, delays: Array, *, period: float | None = None, end: float = np.inf) -> list[ResultsIn]:
    """Return what is in, from one result to the next: over one `period` of an endless schedule, or until an `end`.

    `times` (N,) are those of the samples, the first 0; `delays` (N, p) those of each output of each of them, infinite
    where it is not measured. Of a finite schedule the first node is known at once.
    """
    return _endless(times, period, delays) if period is not None else _finite(times, end, delays)


def with_results_out(chain: SampleChain, delays: Array) -> SampleChain:
    """Return a chain in which each result counts from its delay (N, p) on, as for `results_in`."""
    times = np.append(0.0, np.cumsum([gap.length for gap in chain.gaps]))
    if chain.start is None:
        arrivals = results_in(times[:-1], delays, period=float(times[-1]))
    else:
        arrivals = results_in(times, delays, end=float(times[-1]) + chain.last)
    spans, again, before, samples = list[KnownSpan](), list[int](), list[int](), list(chain.samples)
    for arrival in arrivals:
        measured = np.isfinite(delays[arrival.samples])
        part = np.flatnonzero(np.any(measured & ~arrival.seen, axis=1))
        node, first = int(arrival.samples[-1]), int(part[0]) if part.size else len(arrival.samples)
        for k in range(first, len(arrival.samples)):
            j = int(arrival.samples[k])
            before.append(
                len(samples) - 1 if k > first else (j - 1 if chain.start is not None else (j - 1) % len(chain))
            )
            again.append(j)
            samples.append(_without(chain.samples[j], arrival.seen[k]))
            node = len(samples) - 1
        time = float(arrival.times[-1])
        spans.append(KnownSpan(node, time, arrival.begin - time, arrival.end - time))
    L = np.concatenate([chain.L, chain.L[again]]) if again else chain.L
    return replace(
        chain, L=L, samples=tuple(samples), known_spans=tuple(spans), again=tuple(again), before=tuple(before)
    )


def with_branches(chain: SampleChain, atoms: list[BoundedDirections]) -> list[BoundedDirections]:
    """Return what bounds the nodes of a chain, of those too of which some results are out; `atoms` are its samples'."""
    found = list(atoms)
    for node in range(len(chain), len(chain.samples)):
        path = chain.nodes(node, 1)
        if chain.start is None:
            r = chain.determined
            basis, known = np.eye(chain.D.size)[:, :r], atoms[path[0]].reach
            cost, g, _, _ = followed_back(chain, path, basis, _filter_of(chain, path))
            found.append(BoundedDirections(basis, (cost + known @ np.abs(g[:r])) * (1 + 1e-11)))
            continue
        path = chain.nodes(node, len(chain))
        basis = determined_at(chain, path)
        whole = [a.reach if a.whole and k else None for k, a in enumerate(found[j] for j in path[:-1])]
        found.append(BoundedDirections(basis, path_bounds(chain, path, chain.start, whole, basis)))
    return found


def _filter_of(chain: SampleChain, path: list[int]) -> Callable[[int, Array], Array]:
    """The filter's gains at the nodes of a path."""
    return lambda k, rest: chain.samples[path[k]].K.T @ rest


def _without(sample: ChainSample, seen: Mask) -> ChainSample:
    """A sample of which only some outputs are in."""
    keep = seen[sample.outputs]
    return ChainSample(sample.outputs[keep], sample.size[keep], sample.H[keep], sample.exact[keep], sample.K[:, keep])


def _endless(times: Array, period: float, delays: Array) -> list[ResultsIn]:
    """From the first result of the first sample on, over a period."""
    measured = np.isfinite(delays)
    longest = float(np.max(delays[measured], initial=0.0))
    more = int(np.ceil(longest / period)) + 2
    turns = np.arange(-more - 1, more + 1)
    every = (times[None, :] + period * turns[:, None]).ravel()
    index = np.tile(np.arange(times.size), turns.size).astype(np.intp)
    comes = every[:, None] + delays[index]
    first = float(np.min(delays[int(np.argmax(measured.any(axis=1)))])) + float(
        times[int(np.argmax(measured.any(axis=1)))]
    )
    tiny = SAME * period
    marks = _clusters(
        comes[np.isfinite(comes) & (comes < first + period + 2 * tiny) & (comes > first - 2 * tiny)], tiny
    )
    marks = marks[marks < marks[0] + period - tiny]
    ends = np.append(marks[1:], marks[0] + period)
    return [_results_in(a, b, every, index, comes, measured[index], tiny) for a, b in zip(marks, ends, strict=True)]


def _finite(times: Array, end: float, delays: Array) -> list[ResultsIn]:
    """From the first node, where nothing is in, until the end."""
    index, comes, measured = np.arange(times.size), times[:, None] + delays, np.isfinite(delays)
    tiny = SAME * max(end, 0.0)
    marks = _clusters(comes[np.isfinite(comes) & (comes <= end + tiny)], tiny)
    first = float(marks[0]) if marks.size else end
    ends = np.append(marks[1:], max(end, float(marks[-1]))) if marks.size else marks
    found = [_results_in(a, b, times, index, comes, measured, tiny) for a, b in zip(marks, ends, strict=True)]
    if marks.size and first <= tiny:
        return found
    return [ResultsIn(0.0, first, index[:1], times[:1], np.zeros((1, delays.shape[1]), dtype=bool)), *found]


def _results_in(
    begin: float, end: float, times: Array, index: Index, comes: Array, measured: Mask, tiny: float
) -> ResultsIn:
    seen = measured & (comes <= begin + tiny)
    last = int(np.flatnonzero(seen.any(axis=1))[-1])
    out = np.flatnonzero(np.any(measured & ~seen, axis=1))
    first = min(int(out[0]) if out.size else last, last)
    part = slice(first, last + 1)
    return ResultsIn(begin, end, index[part], times[part], seen[part])


def _clusters(marks: Array, tiny: float) -> Array:
    """The last of all that lie closer together than a little, in order."""
    marks = np.sort(marks)
    return marks[np.append(np.diff(marks) > tiny, True)] if marks.size else marks
