"""Directions at one sample that gains have bounded, and what they bound of every other direction.

rho(.; t_j) is a norm: if mu = a mu_1 + b mu_2 + rest, then rho(mu) <= |a| rho(mu_1) + |b| rho(mu_2) + rho(rest), and
the filter's reach bounds the last. A row turns between samples, and other rows turn through the same ones: they
serve all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import overload

import numpy as np

from sampling_design.accuracy.bounds import NOTHING
from sampling_design.accuracy.gains import Gains
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.records.arrays import Array, Index, Mask

SAME = 1e-12  # two directions are one if their cosine, in units of the reach, is 1 within this
PARTNERS = 4  # directions tried beside the nearest one
AT_ONCE = 2**14  # numbers that are worked on at once: what a cache holds
NEIGHBOURS = (64, 16, 4, 1)  # how far away, on both sides, the neighbours are whose pairs a target tries


@dataclass(frozen=True, eq=False)
class GapProof:
    """Gains for some directions at one sample: what bounds every row from above over the gap that follows."""

    sample: int  # its place in the schedule's period
    directions: Array  # (m, n): in the coordinates of the system
    # for each direction, gains beside the filter's of the samples back in time, the latest last, in units of v_bound
    gains: tuple[tuple[Array, ...], ...]


@dataclass(eq=False)
class BoundedDirections:
    """Bounded directions after one sample."""

    basis: Array  # (n, r): orthonormal; what the samples determine. Other directions are not bounded at all.
    reach: Array  # (r,): bounds on rho of the columns of `basis`
    mu: Array = field(init=False)  # (m, n)
    gains: list[Gains] = field(init=False)  # what bounds them
    values: Array = field(init=False)  # (m,): bounds on rho of the directions

    def __post_init__(self) -> None:
        self.hold(np.zeros((0, len(self.basis))), [])

    def hold(self, mu: Array, gains: list[Gains]) -> None:
        """Keep these directions, and no others."""
        self.mu, self.gains, self.values = mu, gains, np.array([each.value for each in gains])
        vars(self).pop("_known", None)

    @classmethod
    def of(
        cls, reach: Array, mu: Array, gains: Sequence[tuple[Array, ...]], values: Sequence[float]
    ) -> BoundedDirections:
        """Those that were kept, all of them."""
        directions = cls(np.eye(len(reach)), reach)
        directions.hold(mu, [Gains(value, lam) for value, lam in zip(values, gains, strict=True)])
        return directions

    @property
    def bare(self) -> BoundedDirections:
        """The reach alone."""
        return BoundedDirections(self.basis, self.reach)

    @property
    def whole(self) -> bool:
        """Whether every direction is bounded."""
        return bool(self.basis.shape[0] == self.basis.shape[1])

    def find(self, mu: Array) -> int | None:
        """The place of a direction among those that are bounded."""
        if not self.gains:
            return None
        near = np.abs(self._known[1] @ self._units(mu[None])[1][0])
        best = int(np.argmax(near))
        return best if near[best] > 1 - SAME else None

    def add(self, mu: Array, gains: Gains) -> None:
        """Keep a bounded direction, unless others bound it better."""
        if gains.value >= self.bound(mu[None])[0]:
            return
        place = self.find(mu)
        if place is None:
            self.hold(np.vstack([self.mu, mu]), [*self.gains, gains])
        else:
            directions, others = self.mu.copy(), self.gains.copy()
            directions[place], others[place] = mu, gains
            self.hold(directions, others)
        self._prune()

    def extend(self, mu: Array, gains: Sequence[Gains]) -> None:
        """Keep those of many bounded directions (m, n) that others do not bound better."""
        better = [k for k, bound in enumerate(self.bound(mu)[: len(gains)]) if gains[k].value < bound]
        self.hold(np.vstack([self.mu, mu[better]]), self.gains + [gains[k] for k in better])
        self._prune()

    def _prune(self) -> None:
        """Drop what other directions bound better together."""
        if len(self.gains) < 2:
            return
        bounds = self.bound(self.mu)
        keep = np.flatnonzero(bounds >= self.values * (1 - SAME))
        if keep.size < len(self.gains):
            self.hold(self.mu[keep], [self.gains[k] for k in keep])

    @cached_property
    def _sizes(self) -> Array:
        """(r,): the reach, and 1, as coordinates are, where it is endless."""
        return np.where(np.isfinite(self.reach), self.reach, 1.0)

    def _units(self, mu: Array) -> tuple[Array, Array, Array]:
        """Directions in units of the reach, the same of length one, and their lengths; 1 where that is 0."""
        scaled = mu @ self.basis * self._sizes
        size = np.linalg.norm(scaled, axis=1)
        size = np.where(size > 0, size, 1.0)
        return scaled, scaled / size[:, None], size

    @cached_property
    def _known(self) -> tuple[Array, Array, Array]:
        """The directions that are bounded, like that."""
        return self._units(self.mu)

    def fit(self, targets: Array) -> tuple[Index, Array]:
        """Return each target as mu[t] = sum_k share[t, k] direction[place[t, k]] + rest: places and shares (T, 2).

        Of one direction, or of the best pair of near ones on both sides of it.

        Targets come along a curve as a rule: what serves a neighbour may serve a target.
        """
        count, directions = len(targets), len(self.gains)
        if not directions:
            return np.zeros((count, 0), dtype=np.intp), np.zeros((count, 0))
        (X, T, lengths), (Y, U, unit) = self._units(targets), self._known
        near, rows = T @ U.T, np.arange(count)
        firsts, seconds = self._near(near)
        alone = firsts[0]
        place = np.stack([alone, alone], axis=1)
        share = np.stack([near[rows, alone], np.zeros(count)], axis=1) * lengths[:, None] / unit[place]
        if directions == 1:
            return place, share
        value, bounded = self.judged(targets, place, share), self.values
        X, Y = (np.where(np.isfinite(self.reach), x, 0.0) for x in (X, Y))

        def tried(first: Index, second: Index) -> None:
            """Take pairs (k, t) and (k, t), k of them for each target, where they bound it better."""
            gram, a, b = (U[first] * U[second]) @ np.ones(X.shape[1]), near[rows, first], near[rows, second]
            det = 1 - gram**2
            alike = det < SAME
            det[alike] = np.inf
            one, two = (a - gram * b) / det, (b - gram * a) / det
            one, two = one * lengths / unit[first], two * lengths / unit[second]
            left = X - one[..., None] * Y[first]
            left -= two[..., None] * Y[second]
            combined = np.abs(one) * bounded[first] + np.abs(two) * bounded[second]
            combined += np.abs(left, out=left) @ np.ones(X.shape[1])
            combined[alike | ~(combined < value * (1 - SAME))] = np.inf  # what rounding makes better decides nothing
            which = np.argmin(combined, axis=0)
            least = combined[which, rows]
            better = np.flatnonzero(least < value)
            if better.size:
                at = which[better], better
                place[better, 0], place[better, 1] = first[at], second[at]
                share[better, 0], share[better, 1] = one[at], two[at]
                value[better] = least[better]

        tried(firsts, seconds)
        for shift in NEIGHBOURS if count > 1 else ():
            around = (rows + np.array([[-shift], [shift]])) % count
            tried(place[around, 0], place[around, 1])
        return place, share

    def _near(self, near: Array) -> tuple[Index, Index]:
        """First and second places (k, T) of pairs that may serve targets: whose cosines with the directions are given.

        The first is what bounds a target best alone, or else the nearest. A few at once, which a cache holds.
        """
        (count, directions), (_, U, unit) = near.shape, self._known
        partners, value = min(PARTNERS, directions), self.values / unit
        firsts, seconds = (np.empty((2, k, count), dtype=np.intp) for k in (1, partners))
        most = max(1, AT_ONCE // directions)
        for part in (slice(k, k + most) for k in range(0, count, most)):
            cosine, rows = near[part], np.arange(count)[part] - part.start
            size, side = np.abs(cosine), np.where(cosine < 0, -1.0, 1.0)
            left = np.sqrt(np.maximum(1 - cosine**2, 0.0))
            alone, nearest = np.argmin(size * value + left * np.sqrt(U.shape[1]), axis=1), np.argmax(size, axis=1)
            for way, first in enumerate((alone, nearest)):
                firsts[way, 0, part] = first
                if way and np.array_equal(alone, nearest):
                    seconds[1, :, part] = seconds[0, :, part]
                    continue
                across = U[first] * side[rows, first, None] @ U.T * side < size * size[rows, first, None]
                apart = np.where(across, size, size - 2)
                for k in range(partners):
                    second = seconds[way, k, part] = np.argmax(apart, axis=1)
                    apart[rows, second] = -np.inf
        firsts = np.repeat(firsts, partners, axis=1)
        return firsts.reshape(-1, count), seconds.reshape(-1, count)

    def bound(self, targets: Array) -> Array:
        """Return bounds on rho of directions (t, n)."""
        plain = self.rest(targets, targets)
        return np.minimum(self.judged(targets, *self.fit(targets)), plain) if self.gains else plain

    def judged(self, targets: Array, place: Index, share: Array) -> Array:
        """Return what a fit bounds."""
        made = np.einsum("tk,tkn->tn", share, self.mu[place])
        known = np.einsum("tk,tk->t", np.abs(share), self.values[place])
        return np.asarray(known + self.rest(targets - made, targets))

    def rest(self, rest: Array, targets: Array) -> Array:
        """Return what the reach bounds of the rests of targets: nothing of them may lie outside the basis."""
        scaled = rest @ self.basis
        endless = ~np.isfinite(self.reach)
        bound = np.abs(scaled) @ np.where(endless, 0.0, self.reach)
        if endless.any():
            bound = np.where(np.any(scaled[..., endless] != 0, axis=-1), np.inf, bound)
        if self.whole:
            return np.asarray(bound)
        return np.where(self.determines(rest, targets), bound, np.inf)

    def determines(self, rest: Array, targets: Array | None = None) -> Mask:
        """Say whether nothing of the rests of targets (default: of themselves) lies outside the basis."""
        left = np.linalg.norm(rest - (rest @ self.basis) @ self.basis.T, axis=1)
        return np.asarray(left <= NOTHING * np.linalg.norm(rest if targets is None else targets, axis=1))


class LazyDirections(Sequence[BoundedDirections], ABC):
    """Bounded directions of many nodes, each worked out when it is asked for."""

    def __init__(self, count: int):
        self._count, self._found = count, dict[int, BoundedDirections]()

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, at: int) -> BoundedDirections: ...
    @overload
    def __getitem__(self, at: slice) -> list[BoundedDirections]: ...
    def __getitem__(self, at: int | slice) -> BoundedDirections | list[BoundedDirections]:
        if isinstance(at, slice):
            return [self[k] for k in range(self._count)[at]]
        if at not in self._found:
            if not 0 <= at < self._count:
                raise IndexError(at)
            self._found[at] = self._bounded(at)
        return self._found[at]

    @abstractmethod
    def _bounded(self, at: int) -> BoundedDirections:
        """Those of one node."""


def combined(system: SampledSystem, j: int, mu: Array, directions: BoundedDirections) -> list[tuple[Array, ...]]:
    """Gains for rows of mu'z_j, mu (m, n), put together from those of the nearest directions, the latest last."""
    found = []
    for places, shares in zip(*directions.fit(mu), strict=True):
        parts = [directions.gains[k].gains for k in places]
        count = max(map(len, parts))
        ends = np.cumsum([0, *(len(system.samples[k].H) for k in system.latest(j, count))])
        total = np.zeros(ends[-1])
        for part, share in zip(parts, shares, strict=True):
            total[ends[count - len(part)] :] += share * np.concatenate([[], *part])
        found.append(tuple(np.split(total, ends[1:-1])))
    return found
