"""All numbers of one design: allowed times, how many samples they leave room for, and what these can measure.

Under a limit on cost every choice that cannot be enlarged counts: whatever an affordable schedule measures is part of
one of them, which sees no less. They are few where samples are few, and then each of them is a problem of its own,
without a limit on cost: searched and bounded one by one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, product
from math import comb, factorial, prod

import numpy as np

from sampling_design.design.problem.gram import ScaledRows
from sampling_design.design.problem.orthogonal_flow import OrthogonalFlowWindows
from sampling_design.numerics.linalg import expm_batch
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.schedules.sensor import joined

_EXACT = 1e-12  # relative: a period counts as a whole number of spacings where it is one to rounding
_COUNTED = 10**15  # where there is room for more samples than that, nobody asks how many
SLACK = 1e-9  # relative: gaps are designed this much wider than asked, so that rounding cannot break them
ON_AN_END = 1e-11  # of the period: what lies so near to a time at which something opens or closes lies on it
_JUST_SO = 5e-12  # of the period: what canonical units may round
_SAME = 1e-9  # of the period: what is allowed may differ so near to an end, and still counts as repeating
_TURNED = 2.0**30  # parts of a period: times that lie nearer to each other lie together


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """All numbers of one design: k samples per period, spacing, windows, allowed times, output masks."""

    plant: Plant  # the retained part, in the coordinates that sigma refers to
    window: float
    period: float
    spacing: float
    samples: int
    forbidden: Array
    fixed: Array
    available: tuple[Array | None, ...]  # per output
    costs: Array | None = None  # of one measurement, per output
    cost_limit: float = np.inf  # of one period
    chosen: Mask | None = None  # (k, p): what each sample measures, where that is decided
    late: float = 0.0  # how early or late each sample may be: by twice that, `window` is shorter than was asked
    closest: float = 0.0  # how early and late together: nearer to each other samples could change places
    counted: Array | None = None  # (k, n): |counted x| is all that counts of x where rows were asked for, else |x|

    @cached_property
    def rows(self) -> ScaledRows:
        """The plant's rows over one window, in the scaled basis."""
        return ScaledRows(self.plant, self.window, self.late)

    @cached_property
    def moves(self) -> Array:
        """(m, n, n) e^{Ad}, in the scaled basis, of the moves d that a bound lets each sample of a window make.

        The first is none, the others are the earliest and the latest where samples may be early or late.
        """
        return expm_batch(self.rows.A, np.array([0.0, -self.late, self.late] if self.late else [0.0]))

    @cached_property
    def orthogonal_flow(self) -> OrthogonalFlowWindows | None:
        """Cheaper windows, where the plant's flow stretches no state."""
        return OrthogonalFlowWindows.of(self.plant, self.window, self.period)

    @property
    def is_shift_invariant(self) -> bool:
        """Whether a schedule may be moved in time without breaking anything."""
        bare = not self.forbidden.size and not self.fixed.size and self.chosen is None
        return bare and all(a is None for a in self.available)

    @property
    def always_has_room(self) -> bool:
        """Whether every schedule with a sample fewer leaves room, and money, for one more; it then sees no less."""
        open_time = float(np.diff(self.intervals, axis=1).sum())  # of the period
        return not self.is_costly and open_time > 2 * self.spacing * (self.samples - 1) * (1 + SLACK)

    @property
    def is_costly(self) -> bool:
        """Whether the cost limit bars that every sample measures every output."""
        return self.costs is not None and bool(self.samples * self.costs.sum() > self.cost_limit)

    @cached_property
    def kinds(self) -> tuple[Mask, Index]:
        """The different sets of outputs (m, p) that samples measure, and which of them each sample does (k,)."""
        if self.chosen is None:
            return np.ones((1, self.plant.n_outputs), dtype=bool), np.zeros(self.samples, dtype=np.intp)
        kinds, which = np.unique(self.chosen, axis=0, return_inverse=True)
        return kinds, which.reshape(-1)

    def measured(self, times: Array) -> Mask:
        """What the samples at `times` (..., k), sorted, measure: all that is available, or what was chosen of it."""
        return self.mask(times) if self.chosen is None else self.mask(times) & self.chosen

    @cached_property
    def breakpoints(self) -> Array:
        """Times in [0, period] at which what is allowed changes, 0 and the period included."""
        spans = [self.forbidden, *(a for a in self.available if a is not None)]
        points = np.concatenate([np.array([0.0, self.period]), *(s.ravel() for s in spans)])
        return np.unique(np.clip(points, 0.0, self.period))

    @cached_property
    def least_shift(self) -> float:
        """The least shift after which the same times are allowed: 0 where all are, else a fraction of the period."""
        if not self.forbidden.size and all(a is None for a in self.available):
            return 0.0
        P, edges = self.period, self.breakpoints
        for parts in range(edges.size, 1, -1):
            shift = P / parts
            joint = np.unique(np.concatenate([edges, np.mod(edges - shift, P)]))
            joint = joint[np.append(np.diff(joint), P - joint[-1]) > _SAME * P]
            inner = (joint + np.append(joint[1:], P)) / 2
            if np.array_equal(self.mask(inner), self.mask(inner + shift)):
                return float(shift)
        return P

    def mask(self, times: Array) -> Mask:
        """Which outputs may be measured at `times` (any shape, mod period): shape (*times.shape, p)."""
        t = np.mod(times, self.period)
        open_ = ~_within(t, self.forbidden)
        parts = [open_ if a is None else open_ & _within(t, a) for a in self.available]
        return np.stack(parts, axis=-1)

    @cached_property
    def intervals(self) -> Array:
        """Maximal half-open intervals [a, b) of [0, period) on which some output may be measured, (m, 2)."""
        return self.intervals_of(np.ones(self.plant.n_outputs, dtype=bool))

    def intervals_of(self, outputs: Mask) -> Array:
        """The same for some of the `outputs` (p,)."""
        edges = self.breakpoints
        open_ = np.any(self.mask((edges[:-1] + edges[1:]) / 2) & outputs, axis=-1)
        return joined(np.stack([edges[:-1], edges[1:]], axis=1)[open_])

    def closes(self, times: Array) -> Mask:
        """Which of the `times`, mod period, are those at which an open interval ends: no sample is allowed then.

        A window that begins there means the limit of windows that begin before, [b, b + T): of any one schedule no
        sample lies between them, nor does it hold one at b + T yet. Windows elsewhere are (a, a + T].
        """
        return np.asarray(np.any(np.abs(self._after_closing(times)) <= ON_AN_END * self.period, axis=-1))

    def on_closings(self, starts: Array, near: float) -> Array:
        """Window starts, those that are `near` a time at which an open interval ends moved there."""
        away = self._after_closing(starts)
        return np.asarray(starts - np.sum(np.where(np.abs(away) <= near, away, 0.0), axis=-1))

    def _after_closing(self, times: Array) -> Array:
        ends = np.zeros(0) if self._is_whole else self.intervals[:, 1]
        return np.asarray(np.mod(times[..., None] - ends + self.period / 2, self.period) - self.period / 2)

    @cached_property
    def inner(self) -> Array:
        """The same as closed intervals [a, b], (m, 2): they end so early that rounding carries no time out."""
        if self._is_whole:
            return self.intervals
        a, b = self.intervals.T
        return np.stack([a, np.maximum(a, b - SLACK * self.period)], axis=1)

    @cached_property
    def free(self) -> Array:
        """What of these is left for samples that are not fixed, a gap away from fixed ones.

        Where an opening, or another fixed time, leaves room for the spacing just so, that one time stays.
        """
        found, slack = self.inner, 2 * (self.gap - self.spacing) + _JUST_SO * self.period
        for t in (self.fixed + self.period * np.arange(-1, 2)[:, None]).ravel():
            below = np.stack([found[:, 0], np.minimum(found[:, 1], t - self.gap)], axis=1)
            above = np.stack([np.maximum(found[:, 0], t + self.gap), found[:, 1]], axis=1)
            found = np.concatenate([below, above])
            found = found[found[:, 1] >= found[:, 0] - slack]
        begins = found[:, 0]
        begins = np.where(np.isin(begins, self.inner[:, 0]), begins, np.minimum(begins, found.mean(axis=1)))
        found = np.stack([begins, np.maximum(begins, found[:, 1])], axis=1)
        return np.asarray(found[np.argsort(begins, kind="stable")])

    @property
    def origin(self) -> float:
        """The time at which periods begin for the search: an opening after the longest closed time, or a fixed time.

        It moves along with what is allowed, so that a shift of all closed and fixed times changes nothing else; 0 where
        all times are alike.
        """
        return self._begin[0]

    @property
    def shut(self) -> float:
        """For how long before that time nothing is allowed, at least."""
        return self._begin[1]

    @cached_property
    def _begin(self) -> tuple[float, float]:
        P = self.period
        points = np.unique(np.concatenate([self.breakpoints[:-1], self.fixed]))
        points = points[np.append(True, np.diff(points) > P / _TURNED) & (points < P - P / _TURNED)]  # there it is 0
        there = self.mask((points + np.append(points[1:], P)) / 2)
        codes = np.unique(there, axis=0, return_inverse=True)[1].reshape(-1)
        away = np.mod(points[:, None] - self.fixed + P / 2, P) - P / 2
        pinned = np.any(np.abs(away) <= P / _TURNED, axis=1)
        real = np.flatnonzero(pinned | (codes != np.roll(codes, 1)))
        if not real.size:
            return 0.0, 0.0
        lengths = np.diff(np.append(points[real], points[real[0]] + P))
        closed = ~there[real].any(axis=1)
        waited = np.roll(np.where(closed, lengths, 0.0), 1) * ~closed
        patterns = np.stack([codes[real], pinned[real], np.rint(lengths * (_TURNED / P))], axis=1).astype(">i8")
        longest = np.flatnonzero(waited >= waited.max() - P / _TURNED)
        first = min(longest.tolist(), key=lambda i: np.roll(patterns, -i, axis=0).tobytes())
        return float(points[real[first]]), float(max(waited[first] - 4 * P / _TURNED, 0.0))

    def capacity(self, spacing: float | None = None) -> int:
        """Most samples per period that fixed and allowed times leave room for."""
        gap = self.spacing if spacing is None else spacing
        if self.fixed.size:
            return int(self.fixed.size + sum(self._count(a + gap, b - gap, gap) for a, b in self._between_fixed))
        if self._is_whole:
            return self._around(gap)
        return max((self._count(a, a + self.period - gap, gap) for a, _ in self.intervals), default=0)

    def packing(self) -> Array:
        """Times of a schedule with as many samples as there is room for.

        An optimal packing can be pushed left until some sample lies at the left end of an interval (or
        just after a fixed one), so that greedy placement from each left end finds it.
        """
        gap = self.spacing
        if self.fixed.size:
            inner = [self._greedy(a + gap, b - gap, gap) for a, b in self._between_fixed]
            return np.sort(np.mod(np.concatenate([self.fixed, *inner]), self.period))
        if self._is_whole:
            most = self._around(gap)
            return np.arange(most, dtype=np.float64) * (self.period / max(most, 1))
        packings = [self._greedy(a, a + self.period - gap, gap) for a, _ in self.intervals]
        return np.sort(np.mod(max(packings, key=len, default=[]), self.period))

    @property
    def _is_whole(self) -> bool:
        """Whether samples may lie anywhere."""
        return len(self.intervals) == 1 and bool(np.ptp(self.intervals[0]) == self.period)

    @property
    def _between_fixed(self) -> list[tuple[float, float]]:
        """Each fixed time and the next."""
        ends = np.append(self.fixed[1:], self.fixed[0] + self.period)
        return [(float(a), float(b)) for a, b in zip(self.fixed, ends, strict=True)]

    def _around(self, gap: float) -> int:
        """Samples `gap` apart that the whole period has room for; as many as can be counted where that is more."""
        return int(min(np.floor(self.period / gap * (1 + _EXACT)), _COUNTED))

    @property
    def gap(self) -> float:
        """The spacing that the search keeps: a little wider than asked, where there is room for that."""
        return float(max(min(self.spacing * (1 + SLACK), self.period / self.samples), self.spacing))

    def _stretches(self, start: float, stop: float, gap: float) -> Iterator[tuple[float, int]]:
        """Earliest admissible times in [start, stop], at least `gap` apart: first time and number, per interval."""
        tiny = SLACK * self.period
        t = start
        for cycle in range(int(np.floor(start / self.period)), int(np.floor(stop / self.period)) + 1):
            for a, b in self.intervals + cycle * self.period:
                t = max(t, float(a))
                if t >= b - tiny or t > stop + tiny:
                    continue
                last = min(float(b) - tiny, float(np.nextafter(stop + tiny, np.inf)))
                count = int(min(np.ceil((last - t) / gap), _COUNTED))
                yield t, max(count, 1)
                t += max(count, 1) * gap

    def _greedy(self, start: float, stop: float, gap: float) -> list[float]:
        return [t + i * gap for t, count in self._stretches(start, stop, gap) for i in range(count)]

    def _count(self, start: float, stop: float, gap: float) -> int:
        return min(sum(count for _, count in self._stretches(start, stop, gap)), _COUNTED)


def _within(t: Array, spans: Array) -> Mask:
    return np.asarray(np.any((t[..., None] >= spans[:, 0]) & (t[..., None] < spans[:, 1]), axis=-1))


Outputs = tuple[bool, ...]

MOST_CHOICES = 48  # choices beyond which they are not looked at one by one
_MOST_COUNTS = 20_000  # of samples by what they measure: more are not counted through


def affordable_choices(problem: DesignProblem) -> list[Mask]:
    """(k, p) each: what sample j of the period measures, counted from any sample; none where there are too many.

    No measurement can be added to one of them within the limit, so that an affordable schedule measures a part of one.
    """
    costs, k = problem.costs, problem.samples
    if costs is None or comb(k + 2**costs.size - 2, k) > _MOST_COUNTS:
        return []
    sets = [outputs for outputs in product((False, True), repeat=costs.size) if any(outputs)]
    found: list[tuple[Outputs, ...]] = []
    orders = 0
    for chosen in combinations_with_replacement(sets, k):
        spare = problem.cost_limit * (1 + SLACK) - float(np.sum(np.array(chosen) * costs))
        absent = ~np.all(chosen, axis=0)
        if spare < 0 or np.any(costs[absent] <= spare):
            continue
        orders += factorial(k) // prod(factorial(n) for n in Counter(chosen).values())
        if orders > MOST_CHOICES:
            return []
        found.append(chosen)
    return [np.array(line) for chosen in found for line in _orders(Counter(chosen))]


def _orders(left: Counter[Outputs]) -> Iterator[tuple[Outputs, ...]]:
    """Every order of these sets, each once."""
    if not left:
        yield ()
    for outputs in sorted(left):
        for rest in _orders(left - Counter([outputs])):
            yield (outputs, *rest)
