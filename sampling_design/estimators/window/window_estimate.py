"""What an engine hands back: the minimiser of a window problem, and every other trajectory relative to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.estimators.online.estimate import Status
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array

DUAL_MARGIN = 1e-11
"""Share of the reference trajectory's cost by which a computed optimum may exceed the exact one (see `smooth`)."""


@dataclass(frozen=True, eq=False)
class EstimateDeviations:
    """All trajectories x = x* + T z around a minimiser x*; each costs |z|^2 more.

        x_N = x*_N + S_N y_N,    x_j = x*_j + G_j (x_{j+1} - x*_{j+1}) + S_j y_j,    y = Q z

    roots S (N+1, n, n), gains G (N, n, n); Q = I, or I - Z' diag(loss) Z with orthonormal rows Z (K, (N+1) n), of which
    composite samples say more: `known` = (Z, loss).
    """

    roots: Array
    gains: Array
    known: tuple[Array, Array] | None = None

    def _through(self, g: Array) -> Array:
        """Return g Q."""
        if self.known is None:
            return g
        Z, loss = self.known
        return np.asarray(g - (g @ Z.T * loss) @ Z)

    def covariances(self) -> Array:
        """Return T_j T_j' of every node, (N+1, n, n)."""
        if self.known is not None:
            T = self.maps()
            return np.asarray(np.matmul(T, np.swapaxes(T, 1, 2)))
        found: Array = np.matmul(self.roots, np.swapaxes(self.roots, 1, 2))
        for j in range(len(self.gains) - 1, -1, -1):
            found[j] += symmetrise(self.gains[j] @ found[j + 1] @ self.gains[j].T)
        return found

    def maps(self) -> Array:
        """Return T as (N+1, n, (N+1) n): block rows T_j = [0, S_j, G_j S_{j+1}, G_j G_{j+1} S_{j+2}, ...] Q."""
        count, n = self.roots.shape[:2]
        return self.rows(np.eye(count * n)).reshape(count, n, count * n)

    def states(self, z: Array) -> Array:
        """Return T z, (N+1, n)."""
        found: Array = np.matmul(self.roots, self._through(z).reshape(*self.roots.shape[:2], 1))[:, :, 0]
        for j in range(len(self.gains) - 1, -1, -1):
            found[j] += self.gains[j].dot(found[j + 1])
        return found

    def rows(self, g: Array) -> Array:
        """Return g T for (r, (N+1) n) rows g."""
        led = g.reshape(len(g), *self.roots.shape[:2]).transpose(1, 0, 2).copy()
        for j in range(len(self.gains)):
            led[j + 1] += led[j].dot(self.gains[j])
        return self._through(np.matmul(led, self.roots).transpose(1, 0, 2).reshape(g.shape))


@dataclass(frozen=True, eq=False)
class WindowEstimate:
    """The minimiser of a window problem."""

    nodes: Array  # (N+1, n): smoothed states
    covariance: Array  # (n, n): pi(t)^-1 at the last node
    cost: float  # cost, dual: cost at the minimiser, and a lower bound on the least cost
    dual: float
    engine: str
    spread: EstimateDeviations  # every other trajectory relative to this one
    status: Status = "ok"  # "ok", "infeasible" or "solver failed"
    note: str = ""  # what could not be met
    held: float = 0.0  # squares of the numbers behind the nodes, in units of what is known of each; see `moved`
