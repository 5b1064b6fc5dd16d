"""The filter's covariance on an endless schedule, by doubling: maps P -> Q + F P (I + G P)^-1 F' and their products.

Every map is three matrices (F, G, Q), G and Q positive semidefinite; two of them make a third without a difference
(structure-preserving doubling), so that nothing cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import psd_root, symmetrise

Array = npt.NDArray[np.float64]

SETTLED = 1e-14
"""Relative change of a doubled covariance at which it counts as the limit."""

DOUBLINGS = 60

UNSTABLE = 1e-9
"""A filter whose error grows by more than this share over a period from P = 0 has to be started elsewhere."""


@dataclass(frozen=True, eq=False)
class CovarianceMap:
    """P -> Q + F P (I + G P)^-1 F'."""

    F: Array
    G: Array
    Q: Array

    def __call__(self, P: Array) -> Array:
        """Return the image of a covariance."""
        return symmetrise(self.Q + self.F @ updated(P, self.G) @ self.F.T)

    def then(self, later: CovarianceMap) -> CovarianceMap:
        """Return the map that applies this one first."""
        root = psd_root(self.Q)
        inner = np.eye(root.shape[1]) + root.T @ later.G @ root
        # (I + Q G)^-1 = I - root inner^-1 root' G
        solved = np.linalg.solve(inner, root.T)
        passed = np.eye(len(self.F)) - root @ solved @ later.G
        F = later.F @ passed @ self.F
        Q = later.Q + later.F @ (root @ solved) @ later.F.T
        mid = later.G - later.G @ root @ solved @ later.G
        return CovarianceMap(F, symmetrise(self.G + self.F.T @ mid @ self.F), symmetrise(Q))


def strong(period: CovarianceMap, start: Array, share: float) -> Array:
    """Return the limit of repeated periods from any P > 0: that from 0 unless it lets an error grow.

    A mode that grows and that no noise reaches stays unseen from P = 0; a random walk of so small a `share` of what
    periods from `start` leave wakes it.
    """
    P = limit(period)
    closed = period.F @ np.linalg.inv(np.eye(len(P)) + P @ period.G)
    if np.max(np.abs(np.linalg.eigvals(closed)), initial=0.0) <= 1 + UNSTABLE:
        return P
    several = period
    for _ in range(int(np.ceil(np.log2(len(P) + 1)))):
        several = several.then(several)
    return limit(CovarianceMap(period.F, period.G, period.Q + share * several(start)))


def updated(P: Array, G: Array) -> Array:
    """Return P (I + G P)^-1 = root (I + root' G root)^-1 root', the covariance after information G."""
    root = psd_root(P)
    inner = np.eye(root.shape[1]) + root.T @ G @ root
    return symmetrise(root @ np.linalg.solve(inner, root.T))


def limit(period: CovarianceMap) -> Array:
    """Return the limit of repeated periods from P = 0, the least covariance that reproduces itself."""
    for _ in range(DOUBLINGS):
        twice = period.then(period)
        settled = np.all(np.abs(twice.Q - period.Q) <= SETTLED * np.sqrt(np.outer(np.diag(twice.Q), np.diag(twice.Q))))
        period = twice
        if settled:
            break
    return period.Q
