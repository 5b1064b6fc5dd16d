"""Constrained signals: how they follow from the states, the rows that their sets ask of them, and the least-distance
problem that these leave to do, whole or for some of its rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.window.window_problem import EstimateDeviations
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.record import short


@dataclass(frozen=True, eq=False)
class ConstrainedSignal:
    """A constrained signal at K places; entries not `measured` are free.

        value_k = base_k + here_k dx_j + before_k dx_{j-1} + own_k e_k,    j = at_k,

    where dx are the states' deviations from those that belong to `base`, and e_k is noise of its own, and where
    `here`, `before` or `own` is None: 1 (the state itself), 0, 0.
    """

    name: str
    times: Array  # (K,)
    entries: tuple[str, ...]
    base: Array
    sets: Sequence[ConvexSet]
    at: Index
    unit: Array  # (k,): what each entry is uncertain by, about: what is small is small beside it
    here: Array | None = None
    before: Array | None = None
    own: Array | None = None
    measured: Mask | None = None  # (K, k)

    @property
    def n(self) -> int:
        """Number of states."""
        return int(self.base.shape[1] if self.here is None else self.here.shape[2])

    @cached_property
    def boxed(self) -> bool:
        """Whether all sets are boxes."""
        return all(chosen.is_box for chosen in self.sets)

    def values(self, dx: Array, noise: Array) -> Array:
        """Return the signal for deviations dx (N+1, n) and own noise (K, p)."""
        moved = dx[self.at]
        total = self.base + (moved if self.here is None else np.matmul(self.here, moved[:, :, None])[:, :, 0])
        if self.before is not None:
            total += np.matmul(self.before, dx[self.at - 1, :, None])[:, :, 0]
        if self.own is not None:
            total += np.matmul(self.own, noise[:, :, None])[:, :, 0]
        return total

    def groups(self) -> Iterator[tuple[ConvexSet, Index]]:
        """Yield each set with the places where its whole signal is measured: half-spaces and balls count only there."""
        whole = np.arange(self.base.shape[0]) if self.measured is None else np.flatnonzero(self.measured.all(axis=1))
        if len(self.sets) == 1:
            yield self.sets[0], whole
        else:
            yield from ((self.sets[int(place)], np.array([place])) for place in whole)

    def sizes(self, values: Array) -> Array:
        """Return the size of each entry: its largest value, or what it is uncertain by if that is more."""
        return np.asarray(np.maximum(self.unit, np.abs(values).max(axis=0, initial=0.0)))

    def keeps_balls(self, values: Array, tolerance: float) -> bool:
        """Whether no value leaves a ball by more than `tolerance` times the sizes of its entries."""
        sizes = self.sizes(values)
        for chosen, places in () if self.boxed else self.groups():
            for ball in chosen.round_balls if places.size else ():
                distance = np.linalg.norm((values[places] - ball.centre) @ ball.shape.T, axis=1)
                reach = float(np.linalg.norm(np.abs(ball.shape) @ (sizes + np.abs(ball.centre))))
                if float(distance.max()) - ball.radius > tolerance * max(ball.radius, reach):
                    return False
        return True


@dataclass(frozen=True, eq=False)
class ConstraintRows:
    """Inequalities lower <= row of a signal <= upper: an entry at a place each, or where `mix` is given that mixture.

    `entries` counts half-spaces, and after them the rows of balls that are points, after the signal's own entries.
    """

    signal: ConstrainedSignal
    places: Index
    entries: Index
    lower: Array
    upper: Array
    mix: Array | None = None

    def of(self, values: Array) -> Array:
        """Return what the rows see of the signal's values (K, k) or maps (K, k, n)."""
        if self.mix is None:
            if self.places.size == values.shape[0] * values.shape[1]:
                return values.reshape(self.places.size, *values.shape[2:])
            return values[self.places, self.entries]
        return np.asarray(np.einsum("ik,ik...->i...", self.mix, values[self.places]))

    def reach(self, sizes: Array) -> Array:
        """Return the size of what each row sees, for sizes (k,) of the signal's entries."""
        return sizes[self.entries] if self.mix is None else np.asarray(np.abs(self.mix) @ sizes)

    def only(self, chosen: Mask) -> ConstraintRows:
        """Return some of the rows."""
        mix = None if self.mix is None else self.mix[chosen]
        parts = (self.places[chosen], self.entries[chosen], self.lower[chosen], self.upper[chosen])
        return ConstraintRows(self.signal, *parts, mix)

    def gradients(self, states: int, size: int) -> Array:
        """Return the rows as rows over the stacked states, `states` in all, then the noise: (r, size)."""
        signal, n = self.signal, self.signal.n
        found, row, column = np.zeros((self.places.size, size)), np.arange(self.places.size)[:, None], np.arange(n)
        start = signal.at[self.places, None] * n
        if signal.here is not None:
            found[row, start + column] = self.of(signal.here)
        elif self.mix is not None:
            found[row, start + column] = self.mix
        else:
            found[row[:, 0], start[:, 0] + self.entries] = 1.0
        if signal.before is not None:
            found[row, start - n + column] = self.of(signal.before)
        if signal.own is not None:
            p = signal.own.shape[2]
            found[row, states + self.places[:, None] * p + np.arange(p)] = self.of(signal.own)
        return found

    def label(self, index: int, below: bool) -> str:
        """Say in words what a row asks, of its lower bound where `below`."""
        signal, place, entry = self.signal, int(self.places[index]), int(self.entries[index])
        where, k = f"t = {signal.times[place]:.6g}", signal.base.shape[1]
        if self.mix is not None:
            point = self.lower[index] == self.upper[index]
            return f"{'a ball' if point else f'half-space {entry - k + 1}'} of {signal.name} at {where}"
        bound = f">= {short(self.lower[index], up=True)}" if below else f"<= {short(self.upper[index], up=False)}"
        return f"{signal.entries[entry]} {bound} at {where} ({signal.name})"


def rows_of(signal: ConstrainedSignal) -> Iterator[ConstraintRows]:
    """Yield the bounds on entries, then what else is linear: half-spaces, and balls that are points."""
    K, k = signal.base.shape
    lower, upper = np.empty((K, k)), np.empty((K, k))
    lower[:] = [chosen.lower for chosen in signal.sets]
    upper[:] = [chosen.upper for chosen in signal.sets]
    kept = np.isfinite(lower) | np.isfinite(upper)
    if signal.measured is not None:
        kept &= signal.measured
    places, entries = np.nonzero(kept)
    if places.size:
        yield ConstraintRows(signal, places, entries, lower[kept], upper[kept])
    for chosen, at in () if signal.boxed else signal.groups():
        points = [ball for ball in chosen.balls if ball.radius == 0]
        matrix = np.concatenate([chosen.rows, *(ball.shape for ball in points)])
        count, there = len(matrix), [ball.shape @ ball.centre for ball in points]
        low, up = np.concatenate([np.full(len(chosen.rows), -np.inf), *there]), np.concatenate([chosen.offsets, *there])
        if count and at.size:
            places, entries = np.repeat(at, count), np.tile(k + np.arange(count), at.size)
            repeated = (np.tile(low, at.size), np.tile(up, at.size), np.tile(matrix, (at.size, 1)))
            yield ConstraintRows(signal, places, entries, *repeated)


Cone = tuple[Array, Array, float]
"""M, c, r of |M z + c| <= r."""


@dataclass(frozen=True, eq=False)
class LeastDistance:
    """min |z|^2 subject to lower <= A z <= upper and |M_i z + c_i| <= r_i: what the constraints leave to do.

    Rows have unit norm: bounds count in posterior standard deviations; `scales` turn slack back into the signal's
    unit. `blocks` and `cone_owners` remember which signal and place each row or cone belongs to.
    """

    size: int
    A: Array
    lower: Array
    upper: Array
    cones: list[Cone]
    scales: Array
    blocks: list[ConstraintRows]
    cone_owners: list[tuple[ConstrainedSignal, int]]

    def row_label(self, index: int, below: bool) -> str:
        """Say in words what row `index` asks, of its lower bound where `below`."""
        ends = np.cumsum([block.places.size for block in self.blocks])
        k = int(np.searchsorted(ends, index, side="right"))
        block = self.blocks[k]
        return block.label(index - int(ends[k]) + block.places.size, below)

    def cone_label(self, index: int) -> str:
        """Say in words what cone `index` asks."""
        signal, place = self.cone_owners[index]
        return f"a ball of {signal.name} at t = {signal.times[place]:.6g}"


class ConstraintDemands:
    """What the constraints ask of all trajectories around the minimiser without them.

    x = x* + T z for the smoother's `spread` T; where signals have noise of their own, z has that after it.
    """

    def __init__(self, spread: EstimateDeviations, signals: Sequence[ConstrainedSignal], nodes: int, n: int):
        self.spread, self.signals = spread, signals
        self.rows = [rows for signal in signals for rows in rows_of(signal)]
        noisy = [signal.own.shape[::2] for signal in signals if signal.own is not None]
        self.states, self.noise_shape = nodes * n, noisy[0] if noisy else (0, 0)
        self.size = self.states + self.noise_shape[0] * self.noise_shape[1]

    def values(self, z: Array | None = None) -> list[Array]:
        """Return the signals at a point (default: at the minimiser without constraints)."""
        if z is None:
            return [signal.base for signal in self.signals]
        dx, noise = self.spread.states(z[: self.states]), z[self.states :].reshape(self.noise_shape)
        return [signal.values(dx, noise) for signal in self.signals]

    def violated(self, values: list[Array], tolerance: float) -> list[Mask]:
        """Return, per block of rows, those that `values` break by more than `tolerance` times their entries' sizes."""
        by_signal, found = dict(zip(self.signals, values, strict=True)), []
        for rows in self.rows:
            value = by_signal[rows.signal]
            value_there, limit = rows.of(value), tolerance * rows.reach(rows.signal.sizes(value))
            found.append((rows.lower - value_there > limit) | (value_there - rows.upper > limit))
        return found

    def balls_hold(self, values: list[Array], tolerance: float) -> bool:
        """Whether `values` keep all balls, up to `tolerance` times the signal's size."""
        return all(s.keeps_balls(value, tolerance) for s, value in zip(self.signals, values, strict=True))

    @property
    def has_balls(self) -> bool:
        """Whether there are norm balls."""
        return any(chosen.round_balls for signal in self.signals if not signal.boxed for chosen in signal.sets)

    def pose(self, chosen: list[Mask] | None = None) -> LeastDistance:
        """Return the whole problem, or that of the rows `chosen` per block, without balls."""
        blocks = self.rows
        if chosen is not None:
            blocks = [rows.only(mask) for rows, mask in zip(self.rows, chosen, strict=True) if mask.any()]
        cones = self._cones() if chosen is None else []
        parts = [self._gradients(rows) for rows in blocks]
        A = np.concatenate([np.zeros((0, self.size)), *parts]) if len(parts) != 1 else parts[0]
        base, lower, upper = np.zeros((3, A.shape[0]))
        if blocks:
            base = np.concatenate([rows.of(rows.signal.base) for rows in blocks])
            lower, upper = (np.concatenate([getattr(rows, side) for rows in blocks]) for side in ("lower", "upper"))
        norms = np.sqrt(np.einsum("ij,ij->i", A, A))
        scales = np.where(norms > 0, norms, 1.0)
        lower, upper = (lower - base) / scales, (upper - base) / scales
        return LeastDistance(
            self.size,
            A / scales[:, None],
            lower,
            upper,
            [cone for cone, _ in cones],
            scales,
            blocks,
            [of for _, of in cones],
        )

    def _gradients(self, rows: ConstraintRows) -> Array:
        """The rows over z: those over the states times T, those over the noise as they are."""
        found = rows.gradients(self.states, self.size)
        if self.size == self.states:
            return self.spread.rows(found)
        found[:, : self.states] = self.spread.rows(found[:, : self.states])
        return found

    def _cones(self) -> list[tuple[Cone, tuple[ConstrainedSignal, int]]]:
        """The balls as cones over z, with the signal and the place of each."""
        cones: list[tuple[Cone, tuple[ConstrainedSignal, int]]] = []
        for signal in self.signals:
            sets = () if signal.boxed else signal.groups()
            balls = [(ball, k) for chosen, at in sets for ball in chosen.round_balls for k in at.tolist()]
            if not balls:
                continue
            sizes = [len(ball.shape) for ball, _ in balls]
            places = np.repeat([k for _, k in balls], sizes)
            none, mix = np.zeros(places.size), np.vstack([ball.shape for ball, _ in balls])
            over = self._gradients(ConstraintRows(signal, places, places, none, none, mix))
            for (ball, k), M in zip(balls, np.split(over, np.cumsum(sizes)[:-1]), strict=True):
                cones.append(((M, ball.shape @ (signal.base[k] - ball.centre), ball.radius), (signal, k)))
        return cones
