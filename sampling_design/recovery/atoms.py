"""Directions at one sample that gains have bounded, and what they bound of every other direction.

rho(.; t_j) is a norm: if mu = a_1 mu_1 + a_2 mu_2 + rest, then rho(mu) <= |a_1| rho(mu_1) + |a_2| rho(mu_2) + rho(rest),
and the filter's reach bounds the last. A row turns between samples, and other rows turn through the same directions:
atoms serve them all.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sampling_design.recovery.program import NOTHING, Gains

Array = npt.NDArray[np.float64]
Places = npt.NDArray[np.intp]

SAME = 1e-12
"""Two directions are one if their cosine, in units of the reach, is 1 within this."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Targets as combinations of two atoms: mu[t] = sum_k share[t, k] atom[place[t, k]] + rest."""

    place: Places
    share: Array


@dataclass(eq=False)
class Atoms:
    """Bounded directions after one sample.

    Attributes
    ----------
    basis : (n, r) array
        Orthonormal; what the samples determine. Other directions are not bounded at all.
    reach : (r,) array
        Bounds on rho of the columns of `basis`.
    mu : (m, n) array
    gains : list of Gains
        What bounds them.
    """

    basis: Array
    reach: Array
    mu: Array = field(init=False)
    gains: list[Gains] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.mu = np.zeros((0, len(self.basis)))

    @property
    def values(self) -> Array:
        """Bounds on rho of the atoms."""
        return np.array([gains.value for gains in self.gains])

    def find(self, mu: Array) -> int | None:
        """The place of a direction among the atoms."""
        if not self.gains:
            return None
        unit, known = (self._units(x) for x in (mu[None], self.mu))
        near = np.abs(known @ unit[0])
        best = int(np.argmax(near))
        return best if near[best] > 1 - SAME else None

    def add(self, mu: Array, gains: Gains) -> None:
        """Keep a bounded direction; of two for the same one the better."""
        place = self.find(mu)
        if place is None:
            self.mu = np.vstack([self.mu, mu])
            self.gains.append(gains)
            return
        ratio = float(np.linalg.norm(mu) / np.linalg.norm(self.mu[place]))
        if gains.value < ratio * self.gains[place].value:
            self.mu = self.mu.copy()
            self.mu[place], self.gains[place] = mu, gains

    def _units(self, mu: Array) -> Array:
        """Directions in units of the reach, of length one."""
        scaled = mu @ self.basis * self.reach
        size = np.linalg.norm(scaled, axis=1, keepdims=True)
        return np.asarray(scaled / np.where(size > 0, size, 1.0))

    def fit(self, targets: Array) -> Fit:
        """Return each target's nearest atom and the nearest one on its other side, with their shares."""
        count, atoms = len(targets), len(self.gains)
        if not atoms:
            return Fit(np.zeros((count, 0), dtype=np.intp), np.zeros((count, 0)))
        T, U = self._units(targets), self._units(self.mu)
        near, rows = T @ U.T, np.arange(count)
        size = np.abs(near)
        first = np.argmax(size, axis=1)
        sign = np.where(near < 0, -1.0, 1.0)
        across = (U @ U.T)[first] * sign * sign[rows, first, None] - size * size[rows, first, None]
        second = np.argmax(np.where(across < 0, size, -1.0), axis=1)
        a, b, gram = near[rows, first], near[rows, second], np.einsum("ti,ti->t", U[first], U[second])
        alone = 1 - gram**2 < SAME
        det = np.where(alone, 1.0, 1 - gram**2)
        share = np.stack([np.where(alone, a, (a - gram * b) / det), np.where(alone, 0.0, (b - gram * a) / det)], axis=1)
        place = np.stack([first, second], axis=1)
        sizes = [np.linalg.norm(x @ self.basis * self.reach, axis=1) for x in (targets, self.mu)]
        return Fit(place, share * sizes[0][:, None] / np.where(sizes[1] > 0, sizes[1], 1.0)[place])

    def bound(self, targets: Array) -> Array:
        """Return bounds on rho of directions (t, n)."""
        fit = self.fit(targets)
        plain = self.rest(targets, targets)
        if not fit.place.size:
            return plain
        pair = self.judged(targets, fit)
        one = self.judged(targets, Fit(fit.place[:, :1], self._alone(targets, fit.place[:, 0])[:, None]))
        return np.minimum(np.minimum(pair, one), plain)

    def _alone(self, targets: Array, place: Places) -> Array:
        T, U = (x @ self.basis * self.reach for x in (targets, self.mu[place]))
        size = np.einsum("ti,ti->t", U, U)
        return np.asarray(np.einsum("ti,ti->t", T, U) / np.where(size > 0, size, 1.0))

    def judged(self, targets: Array, fit: Fit) -> Array:
        """Return what a fit bounds."""
        made = np.einsum("tk,tkn->tn", fit.share, self.mu[fit.place])
        return np.einsum("tk,tk->t", np.abs(fit.share), self.values[fit.place]) + self.rest(targets - made, targets)

    def rest(self, rest: Array, targets: Array) -> Array:
        """Return what the reach bounds of the rests of targets: nothing of them may lie outside the basis."""
        seen = rest @ self.basis
        found = np.abs(seen) @ self.reach
        if self.basis.shape[1] == self.basis.shape[0]:
            return np.asarray(found)
        left = np.linalg.norm(rest - seen @ self.basis.T, axis=1)
        return np.where(left <= NOTHING * np.linalg.norm(targets, axis=1), found, np.inf)
