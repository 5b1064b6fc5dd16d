"""Constrained signals: how they follow from the states, and the rows that their sets ask of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.estimators.constraints.convex_set import ConvexSet
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
