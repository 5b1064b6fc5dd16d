"""Directions at one sample that gains have bounded, and what they bound of every other direction.

rho(.; t_j) is a norm: if mu = a mu_1 + b mu_2 + rest, then rho(mu) <= |a| rho(mu_1) + |b| rho(mu_2) + rho(rest), and
the filter's reach bounds the last. A row turns between samples, and other rows turn through the same ones: they
serve all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sampling_design.accuracy.bounds import NOTHING
from sampling_design.accuracy.gains import Gains
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.records.arrays import Array, Index, Mask

SAME = 1e-12  # two directions are one if their cosine, in units of the reach, is 1 within this
PARTNERS = 4  # directions tried beside the nearest one
NEIGHBOURS = (64, 16, 4, 1)  # how far away, on both sides, the neighbours are whose pairs a target tries


@dataclass(frozen=True, eq=False)
class GapProof:
    """Gains for some directions at one sample: what bounds every row from above over the gap that follows."""

    sample: int  # its place in the schedule's period
    directions: Array  # (m, n): in the coordinates of the system
    # for each direction, the gains of the samples back in time, the latest last, in units of v_bound
    gains: tuple[tuple[Array, ...], ...]


@dataclass(eq=False)
class BoundedDirections:
    """Bounded directions after one sample."""

    basis: Array  # (n, r): orthonormal; what the samples determine. Other directions are not bounded at all.
    reach: Array  # (r,): bounds on rho of the columns of `basis`
    mu: Array = field(init=False)  # (m, n)
    gains: list[Gains] = field(default_factory=list)  # what bounds them

    def __post_init__(self) -> None:
        self.mu = np.zeros((0, len(self.basis)))

    @classmethod
    def of(
        cls, reach: Array, mu: Array, gains: Sequence[tuple[Array, ...]], values: Sequence[float]
    ) -> BoundedDirections:
        """Those that were kept, all of them."""
        directions = cls(np.eye(len(reach)), reach)
        directions.mu, directions.gains = mu, [Gains(value, lam) for value, lam in zip(values, gains, strict=True)]
        return directions

    @property
    def bare(self) -> BoundedDirections:
        """The reach alone."""
        return BoundedDirections(self.basis, self.reach)

    @property
    def whole(self) -> bool:
        """Whether every direction is bounded."""
        return bool(self.basis.shape[0] == self.basis.shape[1])

    @property
    def values(self) -> Array:
        """Bounds on rho of the directions."""
        return np.array([gains.value for gains in self.gains])

    def find(self, mu: Array) -> int | None:
        """The place of a direction among those that are bounded."""
        if not self.gains:
            return None
        unit, known = (self._units(x) for x in (mu[None], self.mu))
        near = np.abs(known @ unit[0])
        best = int(np.argmax(near))
        return best if near[best] > 1 - SAME else None

    def add(self, mu: Array, gains: Gains) -> None:
        """Keep a bounded direction, unless others bound it better."""
        if gains.value >= self.bound(mu[None])[0]:
            return
        place = self.find(mu)
        if place is None:
            self.mu = np.vstack([self.mu, mu])
            self.gains.append(gains)
        else:
            self.mu = self.mu.copy()
            self.mu[place], self.gains[place] = mu, gains
        self._prune()

    def extend(self, mu: Array, gains: Sequence[Gains]) -> None:
        """Keep those of many bounded directions (m, n) that others do not bound better."""
        better = [k for k, bound in enumerate(self.bound(mu)[: len(gains)]) if gains[k].value < bound]
        self.mu = np.vstack([self.mu, mu[better]])
        self.gains += [gains[k] for k in better]
        self._prune()

    def _prune(self) -> None:
        """Drop what other directions bound better together."""
        if len(self.gains) < 2:
            return
        bounds = self.bound(self.mu)
        keep = np.flatnonzero(bounds >= self.values * (1 - SAME))
        self.mu, self.gains = self.mu[keep], [self.gains[k] for k in keep]

    @property
    def _sizes(self) -> Array:
        """(r,): the reach, and 1, as coordinates are, where it is endless."""
        return np.where(np.isfinite(self.reach), self.reach, 1.0)

    def _units(self, mu: Array) -> Array:
        """Directions in units of the reach, of length one."""
        scaled = mu @ self.basis * self._sizes
        size = np.linalg.norm(scaled, axis=1, keepdims=True)
        return np.asarray(scaled / np.where(size > 0, size, 1.0))

    def fit(self, targets: Array) -> tuple[Index, Array]:
        """Return each target as mu[t] = sum_k share[t, k] direction[place[t, k]] + rest: places and shares (T, 2).

        Of one direction, or of the best pair of near ones on both sides of it.

        Targets come along a curve as a rule: what serves a neighbour may serve a target.
        """
        count, directions = len(targets), len(self.gains)
        if not directions:
            return np.zeros((count, 0), dtype=np.intp), np.zeros((count, 0))
        scaled = [x @ self.basis * self._sizes for x in (targets, self.mu)]
        lengths = [np.linalg.norm(x, axis=1) for x in scaled]
        unit = np.where(lengths[1] > 0, lengths[1], 1.0)
        T, U = scaled[0] / np.where(lengths[0] > 0, lengths[0], 1.0)[:, None], scaled[1] / unit[:, None]
        near, rows, cosines = T @ U.T, np.arange(count), U @ U.T
        size, sign = np.abs(near), np.where(near < 0, -1.0, 1.0)
        rest = np.sqrt(np.maximum(1 - near**2, 0.0))
        alone = np.argmin(size * self.values / unit + rest * np.sqrt(U.shape[1]), axis=1)
        place = np.stack([alone, alone], axis=1)
        share = np.stack([near[rows, alone], np.zeros(count)], axis=1) * lengths[0][:, None] / unit[place]
        if directions == 1:
            return place, share
        value, bounded = self.judged(targets, place, share), self.values
        X, Y = (np.where(np.isfinite(self.reach), x, 0.0) for x in scaled)

        def tried(first: Index, second: Index) -> None:
            """Take pairs (k, t) and (k, t), k of them for each target, where they bound it better."""
            gram, a, b = cosines[first, second], near[rows, first], near[rows, second]
            det = 1 - gram**2
            alike = det < SAME
            det[alike] = np.inf
            one, two = (a - gram * b) / det, (b - gram * a) / det
            one, two = one * lengths[0] / unit[first], two * lengths[0] / unit[second]
            left = X - one[..., None] * Y[first]
            left -= two[..., None] * Y[second]
            combined = np.abs(one) * bounded[first] + np.abs(two) * bounded[second]
            combined += np.abs(left, out=left).sum(axis=-1)
            combined[alike | ~(combined < value)] = np.inf
            which = np.argmin(combined, axis=0)
            least = combined[which, rows]
            better = np.flatnonzero(least < value)
            if better.size:
                at = which[better], better
                place[better, 0], place[better, 1] = first[at], second[at]
                share[better, 0], share[better, 1] = one[at], two[at]
                value[better] = least[better]

        firsts, seconds = list[Index](), list[Index]()
        nearest = np.argmax(size, axis=1)
        for first in (alone,) if np.array_equal(alone, nearest) else (alone, nearest):
            across = cosines[first] * sign * sign[rows, first, None] - size * size[rows, first, None]
            apart = np.where(across < 0, -size, 2 - size)
            other = np.argpartition(apart, min(PARTNERS, directions) - 1, axis=1)[:, :PARTNERS]
            firsts += [first] * other.shape[1]
            seconds += list(other.T)
        tried(np.array(firsts), np.array(seconds))
        for shift in NEIGHBOURS if count > 1 else ():
            around = (rows + np.array([[-shift], [shift]])) % count
            tried(place[around, 0], place[around, 1])
        return place, share

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


def combined(
    system: SampledSystem, j: int, mu: Array, directions: BoundedDirections
) -> tuple[tuple[Array, ...], Array]:
    """Gains for mu'z_j put together from those of the nearest directions, the latest last; and of what: nearly mu."""
    place, share = directions.fit(mu[None])
    parts = [[a * g for g in directions.gains[k].gains] for k, a in zip(place[0], share[0], strict=True)]
    empty = [np.zeros(len(system.samples[k].H)) for k in system.latest(j, max(map(len, parts)))]
    both = [[*empty[: len(empty) - len(part)], *part] for part in parts]
    return tuple(a + b for a, b in zip(*both, strict=True)), share[0] @ directions.mu[place[0]]
