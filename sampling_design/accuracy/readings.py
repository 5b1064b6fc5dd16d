"""What came: rows of the state that were read at given times, what was known at the start, and bounds; in plain units.

A mean over an interval is a row of a longer state: x and, for each output that is read so, its integral since the
interval began, which is set to zero there.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.checkers.strict import is_list
from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import discounted_flow, forced_flow
from sampling_design.plants.clusters import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask, freeze

Arrived = tuple[float | tuple[float, float], object, npt.ArrayLike | None]


class RowReading(NamedTuple):
    """Something read at a time: |H x - y| <= size, one-sided H x <= y + size where `below`.

    `since`: a mean of H x from that time on. `output`: whose reading it is, where that is known: rows may be alike.
    """

    H: Array
    y: float
    size: float
    below: bool = False
    since: float | None = None
    output: int | None = None


class UncertainTime(NamedTuple):
    """A reading that was taken between two times, nobody knows when, and what it showed then."""

    first: float
    last: float
    lower: float
    upper: float


class CensoredReading(NamedTuple):
    """What an output is known to lie between: now, in the mean from a time on (`since`), or at some time (`stamp`).

    As it comes, one with a stamp has the ends that were read; where it is used, they are what it says of now.
    """

    output: int
    lower: float
    upper: float
    since: float | None = None
    stamp: UncertainTime | None = None

    def shifted(self, by: float) -> CensoredReading:
        """Return the same of a clock that shows `by` more."""
        if self.stamp is not None:
            moved = self.stamp._replace(first=self.stamp.first + by, last=self.stamp.last + by)
            return self._replace(stamp=moved)
        return self if self.since is None else self._replace(since=self.since + by)

    @property
    def as_read(self) -> CensoredReading:
        """The same with the ends that were read."""
        return self if self.stamp is None else self._replace(lower=self.stamp.lower, upper=self.stamp.upper)

    @property
    def began(self) -> float | None:
        """The earliest time that it says something of, where that is not now."""
        return self.since if self.stamp is None else self.stamp.first

    def within(self, start: float, stop: float) -> bool:
        """Whether all that it says something of, but for now, lies between two times."""
        return (self.began is None or self.began >= start) and (self.stamp is None or self.stamp.last <= stop)

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last time that it says something of, where that is not one time alone; None where it ends now."""
        return None if self.stamp is None else (self.stamp.first, self.stamp.last)


@dataclass(frozen=True)
class BelowDetection:
    """A reading under the limit of detection: "<0.5"."""

    limit: float

    def censored(self, output: int, since: float | None = None) -> CensoredReading:
        """What it says of an output."""
        return CensoredReading(output, -np.inf, checks.number("limit", self.limit), since)


@dataclass(frozen=True)
class AboveRange:
    """A reading beyond the instrument's range: ">8"."""

    limit: float

    def censored(self, output: int, since: float | None = None) -> CensoredReading:
        """What it says of an output."""
        return CensoredReading(output, checks.number("limit", self.limit), np.inf, since)


@dataclass(frozen=True)
class CompositeReading:
    """A composite sample: the mean of the output from `since` until now, a number or itself a limit."""

    value: float | BelowDetection | AboveRange
    since: float

    def censored(self, output: int) -> CensoredReading:
        """What it says of an output."""
        since = checks.number("since", self.since)
        if isinstance(self.value, (BelowDetection, AboveRange)):
            return self.value.censored(output, since)
        mean = checks.number("value", self.value)
        return CensoredReading(output, mean, mean, since)


PartialReading: TypeAlias = BelowDetection | AboveRange | CompositeReading


def with_censored(y: object, p: int) -> tuple[object, tuple[CensoredReading, ...]]:
    """Return measurements with NaN in place of limits and means, and those.

    Raises ArgumentError if a limit or the mean is not a finite number.
    """
    listed = y if is_list(y) else [y]
    found = {k: value.censored(k) for k, value in enumerate(listed) if isinstance(value, PartialReading)}
    if not found:
        return y, ()
    return [np.nan if k in found else value for k, value in enumerate(listed)], tuple(found.values())


def time_or_span(t: object) -> tuple[float, tuple[float, float] | None]:
    """Return a time as a user gives it and None, or for a pair (first, last) the time between them and the pair.

    Raises ArgumentError if it is neither, or `last` comes before `first`.
    """
    if not isinstance(t, (tuple, list, np.ndarray)) or checks.dimensions(t) == 0:
        return checks.number("t", t), None
    first, last = (float(end) for end in checks.vector("t", t, 2))
    if first > last:
        raise ArgumentError(f"`t` must be a time or a pair (first, last) in order, got ({first!r}, {last!r}).")
    return first + (last - first) / 2, None if first == last else (first, last)


def at_some_time(
    y: Array, limits: tuple[CensoredReading, ...], span: tuple[float, float]
) -> tuple[CensoredReading, ...]:
    """Return numbers and limits that were read at some time of a span. Raises ArgumentError if a mean is among them."""
    if any(each.since is not None for each in limits):
        raise ArgumentError(f"`t` = {span!r} of a mean must be one time, its end: give `since` and that.")
    numbers = [CensoredReading(int(i), float(y[i]), float(y[i])) for i in np.flatnonzero(np.isfinite(y))]
    found = sorted([*numbers, *limits], key=lambda each: each.output)
    return tuple(each._replace(stamp=UncertainTime(*span, each.lower, each.upper)) for each in found)


def as_typed(found: CensoredReading) -> PartialReading | float:
    """Return what is known of an output as a user gives it."""
    found = found.as_read
    if found.lower == found.upper and found.since is None:
        return found.lower
    limit = BelowDetection(found.upper) if np.isinf(found.lower) else AboveRange(found.lower)
    if found.since is None:
        return limit
    return CompositeReading(limit if np.isinf(found.upper - found.lower) else found.lower, found.since)


def censored_rows(
    plant: Plant,
    t: float,
    found: CensoredReading,
    size: float,
    centre: float,
    inputs: Sequence[tuple[float, Array]],
    feedthrough: float | None = None,
) -> tuple[RowReading, ...]:
    """Return what is known of an output as rows of the state: less D u and the centre of the noise.

    `feedthrough` is D u at t where an input that jumps there enters as it was before; default: as it is from t on.
    """
    i, fed = found.output, feedthrough
    if fed is None or (found.since is not None and found.since < t):
        fed = float(plant.D[i] @ _mean_input(inputs, found.since, t, plant.n_inputs))
    fed += centre
    H = plant.C[i]
    if found.lower == found.upper and found.since is not None:
        return (RowReading(H, found.lower - fed, size, since=found.since, output=i),)
    ends = ((H, found.upper - fed), (-H, fed - found.lower))
    return tuple(RowReading(row, y, size, True, found.since, i) for row, y in ends if np.isfinite(y))


def input_at(inputs: Sequence[tuple[float, Array]], t: float, count: int, before: bool = False) -> Array:
    """The input that holds from t on, or until then (`before`); 0 before the first."""
    at = (bisect_left if before else bisect_right)(inputs, t, key=lambda pair: pair[0])
    return inputs[at - 1][1] if at else np.zeros(count)


def _mean_input(inputs: Sequence[tuple[float, Array]], since: float | None, t: float, count: int) -> Array:
    """The input at t, or its mean from `since` until t; 0 before the first."""
    if since is None or since >= t:
        return input_at(inputs, t, count)
    marks = [since, *(given for given, _ in inputs if since < given < t), t]
    inputs_held = [input_at(inputs, a, count) for a in marks[:-1]]
    return np.asarray(np.diff(marks) @ np.array(inputs_held).reshape(len(inputs_held), count) / (t - since))


@dataclass(frozen=True, eq=False)
class Readings:
    """All that is known of a plant up to some time."""

    plant: Plant
    disturbance: BoundedSet
    start: BoundedSet  # of x(times[0])
    times: Array  # (K,): increasing; at each some rows (or none) were read
    rows: tuple[tuple[RowReading, ...], ...]  # those of each time; y less D u
    ball: bool  # the sizes of the two-sided rows of one time bound a Euclidean norm together
    inputs: tuple[tuple[float, Array], ...] = ()  # in order of time; u holds from t on, 0 before the first

    @cached_property
    def means(self) -> tuple[bytes, ...]:
        """Rows that are read as means, by their bytes: each has an integral of its own."""
        return tuple(dict.fromkeys(row.H.tobytes() for rows in self.rows for row in rows if row.since is not None))

    @cached_property
    def A(self) -> Array:
        """A of x and of the integrals."""
        n, A = self.plant.n_states, self.plant.A
        if not self.means:
            return A
        longer = np.zeros((n + len(self.means),) * 2)
        longer[:n, :n] = A
        longer[n:, :n] = [np.frombuffer(key) for key in self.means]
        return longer

    @cached_property
    def G(self) -> Array:
        """Effect of a where w = centre + root a."""
        G = self.plant.G @ self.disturbance.root
        return np.asarray(np.vstack([G, np.zeros((len(self.means), G.shape[1]))]))

    @cached_property
    def H(self) -> Array:
        """(R, n) all rows, one time after the other."""
        n = self.plant.n_states
        stacked = np.zeros((self.offsets[-1], len(self.A)))
        flat = [(t, row) for t, rows in zip(self.times, self.rows, strict=True) for row in rows]
        for k, (t, row) in enumerate(flat):
            if row.since is None:
                stacked[k, :n] = row.H
            else:
                stacked[k, n + self.means.index(row.H.tobytes())] = 1 / (t - row.since)
        return stacked

    @cached_property
    def offsets(self) -> Index:
        """(K+1,) where the rows of each time begin."""
        return np.concatenate([[0], np.cumsum([len(rows) for rows in self.rows])]).astype(np.intp)

    @cached_property
    def nodes(self) -> Index:
        """(R,) the time of each row."""
        return np.repeat(np.arange(len(self.times)), np.diff(self.offsets))

    @cached_property
    def y(self) -> Array:
        """(R,) values."""
        return np.array([row.y for rows in self.rows for row in rows], dtype=np.float64)

    @cached_property
    def size(self) -> Array:
        """(R,) bounds on the noise."""
        return np.array([row.size for rows in self.rows for row in rows], dtype=np.float64)

    @cached_property
    def below(self) -> Mask:
        """(R,) one-sided rows."""
        return np.array([row.below for rows in self.rows for row in rows], dtype=bool)

    @cached_property
    def units(self) -> Array:
        """(R,) the size of the noise of each row, of an exact one what the start and w do to it: for scaling only.

        Where neither does anything, how far states that the noise of others hides move it.
        """
        exact, H, lengths = (self.size == 0) & ~self.below, self.H, np.diff(self.times)
        if not exact.any():
            return np.where(self.size > 0, self.size, 1.0)
        covariance = np.zeros((H.shape[1], H.shape[1]))
        if lengths.size:
            with np.errstate(over="ignore", invalid="ignore"):
                W = discounted_flow(self.A, self.G @ self.G.T, lengths)[1].mean(axis=0)
            covariance = np.nan_to_num(W) * float(np.mean(lengths))
        if not self.start.unbounded:
            root = self.start.root
            covariance[: len(root), : len(root)] += root @ root.T
        moved = np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", H, covariance, H), 0.0))
        size, noisy = np.linalg.norm(H, axis=1), (self.size > 0) & ~self.below
        most = float(np.max(size[noisy] / self.size[noisy], initial=0.0))
        moved = np.where(moved > 0, moved, np.where(size > 0, size, 1.0) / (most if most > 0 else 1.0))
        return np.where(exact, moved, np.where(self.size > 0, self.size, 1.0))

    def per_time(self, values: Array) -> Array:
        """Sums (K, ...) of values (R, ...) over the rows of each time."""
        found = np.zeros((len(self.times), values.shape[1]))
        np.add.at(found, self.nodes, values)
        return found

    def noise(self, gains: Array) -> float:
        """The most that noise adds to the rows, times gains (R,)."""
        cost = np.abs(gains) * self.size
        if not self.ball:
            return float(cost.sum())
        square = self.per_time((np.where(self.below, 0.0, cost) ** 2)[:, None])
        return float(np.sqrt(square).sum() + cost[self.below].sum())

    @cached_property
    def kept(self) -> Array | None:
        """(K, n) 0 for an integral that is set to zero at that time, else 1; None where there is none."""
        if not self.means:
            return None
        n, found = self.plant.n_states, np.ones((len(self.times), len(self.A)))
        for rows in self.rows:
            for row in rows:
                if row.since is not None:
                    k = int(np.searchsorted(self.times, row.since))
                    found[k, n + self.means.index(row.H.tobytes())] = 0.0
        return found

    @cached_property
    def nominal(self) -> Array:
        """(K, n) the state that flows from the centre with the inputs and the centre of w, integrals reset."""
        x = np.zeros(len(self.A))
        x[: self.plant.n_states] = self.start.centre
        if not (self.inputs or np.any(self.start.centre) or np.any(self.disturbance.centre)):
            return np.zeros((len(self.times), len(x)))
        pieces = [self._pieces(a, b) for a, b in pairwise(self.times.tolist())]
        flows = iter(self._flows([length for gap in pieces for length, _ in gap]))
        found = [x]
        for k, gap in enumerate(pieces):
            x = x if self.kept is None else x * self.kept[k]
            for _, force in gap:
                x = next(flows) @ np.concatenate([x, force])
            found.append(x)
        return np.array(found)

    def nominal_at(self, t: float) -> Array:
        """Return that state at one of the times, or after the last one."""
        if t <= self.times[-1]:
            return np.asarray(self.nominal[int(np.searchsorted(self.times, t))][: self.plant.n_states])
        x, gap = self.nominal[-1], self._pieces(float(self.times[-1]), t)
        for flow, (_, force) in zip(self._flows([length for length, _ in gap]), gap, strict=True):
            x = flow @ np.concatenate([x, force])
        return np.asarray(x[: self.plant.n_states])

    @cached_property
    def residuals(self) -> Array:
        """(R,) what was read less what the nominal state would show."""
        return np.asarray(self.y - np.einsum("rn,rn->r", self.H, self.nominal[self.nodes]))

    def _pieces(self, a: float, b: float) -> list[tuple[float, Array]]:
        """Lengths and B u + G centre of the pieces of [a, b] on which u is constant."""
        plant, disturbance = self.plant, self.plant.G @ self.disturbance.centre
        first = bisect_right(self.inputs, a, key=itemgetter(0))
        last = bisect_left(self.inputs, b, key=itemgetter(0))
        edges = [a, *(t for t, _ in self.inputs[first:last]), b]
        inputs_held = [
            self.inputs[k - 1][1] if k else np.zeros(plant.n_inputs) for k in range(first, max(first, last) + 1)
        ]
        return [
            (d - c, plant.B @ u + disturbance) for (c, d), u in zip(pairwise(edges), inputs_held, strict=True) if d > c
        ]

    def _flows(self, lengths: Sequence[float]) -> Array:
        """(N, n, n + n_states) transitions, and what a constant force on the state does meanwhile."""
        n, m, d = len(self.A), self.plant.n_states, self._balance
        A = self.A * d / d[:, None]
        rate = float(np.max(np.abs(A).sum(axis=0), initial=0.0)) or 1.0  # forces weigh what the states do
        different, at = np.unique(np.asarray(lengths, dtype=np.float64), return_inverse=True)
        with np.errstate(over="ignore", invalid="ignore"):
            flow = forced_flow(A, rate * np.eye(n, m), different) * d[:, None]
            return np.asarray(flow / np.concatenate([d, rate * d[:m]]))[at]

    @cached_property
    def _balance(self) -> Array:
        """Sizes of the states in which A is even."""
        return balanced_schur(self.A).d

    @classmethod
    def unread(
        cls, plant: Plant, disturbance: BoundedSet, start: BoundedSet, begin: float, ball: bool = False,
        inputs: Sequence[tuple[float, Array]] = (),
    ) -> Readings:  # fmt: skip
        """Return what is known before anything is read: bounds, a set about the state at `begin`, and inputs."""
        return cls(plant, disturbance, start, freeze([begin]), ((),), ball, tuple(inputs))

    @property
    def begin(self) -> float:
        """The first of the times."""
        return float(self.times[0])

    def reading(self, rows: Sequence[tuple[float, tuple[RowReading, ...]]]) -> Readings:
        """Return the same with other rows, in order of time; the start, and where a mean began, become times, too.

        Raises ArgumentError if a mean began before the start, or two means of one row overlap.
        """
        at: dict[float, tuple[RowReading, ...]] = dict(rows)
        spans: dict[bytes, float] = {}
        for t, found in rows:
            for row in found:
                if row.since is None:
                    continue
                if row.since < self.begin or row.since < spans.get(row.H.tobytes(), self.begin):
                    raise ArgumentError(
                        f"`since` = {row.since!r} of the mean read at {t!r} lies before the start or in the mean "
                        "before it."
                    )
                spans[row.H.tobytes()] = t
                at.setdefault(row.since, ())
        if not self.start.unbounded or not at:  # of an unknown state it is unknown what it was before the first row
            at.setdefault(self.begin, ())
        times = sorted(at)
        return replace(self, times=freeze(times), rows=tuple(at[t] for t in times))


class RecordRow(NamedTuple):
    """One row of a record that was checked: limits and means among its outputs stand apart, y is NaN there."""

    t: float
    y: Any = None
    u: Any = None
    censored: tuple[CensoredReading, ...] = ()
