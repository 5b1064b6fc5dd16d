"""Free responses that are bounded for all times before: they may have gone on for ever, within noise.

x(t - s) = sum_m X_m c_m e^{-mu_m s},   Re mu_m >= 0:   |C_i x(t - s)| <= sum_m |C_i X_m| |c_m|  for all s >= 0
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.grouping import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Complex

LASTS = 1e-12
"""Share of |A| below which a mode does not decay, and within which a direction is an eigenvector: rounding alone."""

AMONG = 1e-9
"""A state is that of a free response if what is left of it, balanced, is below this share of it: rounding alone."""


@dataclass(frozen=True, eq=False)
class FreeResponses:
    """All that eigenvectors of modes that do not decay span."""

    scale: Array  # (n,): of the states; balances A
    modes: Complex  # (n, m): eigenvectors of length one, in that scale
    # (p, m): what outputs show of each at most, in units of the least noise that a sample of the period bounds them by
    output_sizes: Array
    ball: bool  # whether the noise of a sample is bounded in the Euclidean norm

    @classmethod
    def of(cls, plant: Plant, bounds: SignalBounds) -> FreeResponses:
        """Return those of a plant."""
        scale = balanced_schur(plant.A).d
        A, n = plant.A * scale / scale[:, None], plant.n_states
        size = float(np.linalg.norm(A, 2))
        found = [np.zeros((n, 0), dtype=np.complex128)]
        for cluster in eigenvalue_clusters(A):
            value = complex(cluster.value)
            if value.real >= -LASTS * size:
                _, sizes, right = np.linalg.svd(A - value * np.eye(n))
                found.append(right[sizes <= LASTS * n * size].conj().T)
        modes, v = np.hstack(found), bounds.v.min(axis=0)
        modes[np.abs(modes) < LASTS] = 0.0
        size_of = np.abs(plant.C * scale @ modes)
        with np.errstate(divide="ignore"):
            output_sizes = np.divide(size_of, v[:, None], out=np.zeros_like(size_of), where=size_of > 0)
        return cls(scale, modes, output_sizes, bounds.v_ball)

    def _shares(self, x: Array) -> Complex:
        return np.asarray(np.linalg.lstsq(self.modes, (x / self.scale).astype(complex))[0])

    def nearest(self, x: Array) -> Array:
        """The state of a free response that is nearest to x."""
        return np.asarray(self.scale * (self.modes @ self._shares(x)).real)

    def strongest(self, row: Array) -> Array:
        """The state of a free response, within the noise at all times before, with about the largest row'x."""
        from scipy.optimize import linprog

        reached = (row * self.scale) @ self.modes
        finite = np.isfinite(self.output_sizes).all(axis=0)
        sizes, output_sizes = np.abs(reached) * finite, np.where(finite, self.output_sizes, 0.0)
        output_size = output_sizes.max(axis=0, initial=0.0)
        unit = np.where(output_size > 0, output_size, 1.0)
        if not np.any(sizes * output_size):
            return np.zeros(row.size)
        found = linprog(
            -sizes / unit,
            A_ub=output_sizes / unit,
            b_ub=np.ones(len(output_sizes)),
            bounds=[(0.0, float(s > 0)) for s in output_size],
        )
        return np.asarray(self.scale * (self.modes @ (found.x / unit * np.exp(-1j * np.angle(reached)))).real)

    def excess(self, x: Array) -> float:
        """By which factor outputs of the one through x may exceed the noise at any time before; infinite if none is."""
        shares = self._shares(x)
        z = x / self.scale
        if np.linalg.norm(z - self.modes @ shares) > AMONG * np.linalg.norm(z):
            return np.inf
        with np.errstate(invalid="ignore"):
            sizes = np.where(np.abs(shares) > 0, self.output_sizes * np.abs(shares), 0.0).sum(axis=1)
        return float(np.linalg.norm(sizes) if self.ball else np.max(sizes, initial=0.0))
