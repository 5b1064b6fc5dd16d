"""The tightest pairs near a trajectory: for small differences (16) is an eigenvalue problem at each time."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.simulation import CovarianceIntegrator
from sampling_design.nonlinear.weights import NonlinearWeights
from sampling_design.numerics.filtering import measurement_update, whitened
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array, Mask

FIRST_INSTANTS = 40
"""Times looked at between the start and the first grid time, evenly in their logarithms: fast modes speak there."""

EARLIEST = 1e-9  # the first of them, as a share of the grid's first step
CLOSER = 16  # times looked at between the neighbours of the worst of those, to have its peak
TOLERANCE = 1e-9  # of the integrator, relative: pairs are only sought with it, and judged anew


class SampledTrajectory(NamedTuple):
    """One trajectory on a grid, physical: x, w from each grid time on, v (rows), u constant; what is measured when."""

    grid: Array
    x: Array
    w: Array
    v: Array
    u: Array
    measured: Mask


class PairOutcome(NamedTuple):
    """What a pair, or all small differences from a trajectory, show of (16), scaled.

    ratio : the least right side over |d(t)|^2_P1, at `t` for the `difference` there; lam : the largest |d(t)|^2_P2 over
    the right side, at `lam_time`; quiet : that with equal disturbances.
    """

    ratio: float
    t: float
    difference: Array
    lam: float
    lam_time: float
    quiet: float = 1.0


class TightestPairs:
    """Finds them along trajectories of one plant.

        min of the right side over all small (d(0), dw, dv) that lead to d(t)  =  d(t)' Y(t)^-1 d(t)
        Y(0) = P2^-1,    Y' = AY + YA' + eta Y + G Qw^-1 G',    Y^-1 <- Y^-1 + C'(R^-1 + E Qv^-1 E')^-1 C at a sample

    with A, G, C, E the slopes of f and h along the trajectory.
    """

    def __init__(self, plant: NonlinearPlant, weights: NonlinearWeights) -> None:
        self.plant, self.weights = plant, weights
        self.scale = plant.scales
        noise: Array = np.asarray(np.linalg.solve(weights.Qw, np.eye(len(weights.Qw))), dtype=np.float64)
        self._loud, self._quiet = (
            CovarianceIntegrator(plant, part, weights.eta, TOLERANCE) for part in (noise, 0 * noise)
        )

    def along(self, path: SampledTrajectory, P1: Array) -> PairOutcome:
        """Return the tightest of all times along a trajectory."""
        own: Array = np.asarray(np.linalg.cholesky(self.weights.P2), dtype=np.float64)
        other: Array = np.asarray(np.linalg.cholesky(P1), dtype=np.float64)
        loud = self._covariances(path, self._loud, own)
        quiet = max(_largest(Y, own) for _, Y in self._covariances(path, self._quiet, own))
        lam, lam_time = max((_largest(Y, own), t) for t, Y in loud)
        most, k = max((_largest(Y, other), k) for k, (_, Y) in enumerate(loud))
        half = symmetrise(other.T @ loud[k][1] @ other)
        direction: Array = np.asarray(np.linalg.solve(other.T, np.linalg.eigh(half)[1][:, -1]), dtype=np.float64)
        return PairOutcome(1 / most, loud[k][0], direction, lam, lam_time, quiet)

    def _covariances(
        self, path: SampledTrajectory, integrator: CovarianceIntegrator, own: Array
    ) -> list[tuple[float, Array]]:
        """Y at the times looked at, as far as it can be followed."""
        n = own.shape[0]
        Y: Array = np.asarray(np.linalg.solve(self.weights.P2, np.eye(n)), dtype=np.float64)
        covariances = [(float(path.grid[0]), Y)]
        for j, (start, stop) in enumerate(pairwise(path.grid.tolist())):
            if path.measured[j].any():
                Y = self._sampled(Y, path, j)
            times = [stop]
            if j == 0:
                times = [start + s for s in np.geomspace(EARLIEST, 1.0, FIRST_INSTANTS) * (stop - start)]
            found = self._carried(path, j, Y, times, integrator)
            covariances += found
            if j == 0:
                worst = max(range(len(found)), key=lambda k: _largest(found[k][1], own))
                low, high = (found[k][0] - start for k in (max(worst - 1, 0), min(worst + 1, len(found) - 1)))
                closer = [start + s for s in np.geomspace(low, high, CLOSER)]
                covariances += self._carried(path, j, Y, closer, integrator)
            Y = found[-1][1]
            if not np.isfinite(Y).all():
                break
        return [(t, Y) for t, Y in covariances if np.isfinite(Y).all()]

    def _carried(
        self, path: SampledTrajectory, j: int, Y: Array, times: list[float], integrator: CovarianceIntegrator
    ) -> list[tuple[float, Array]]:
        """Y at increasing times after a grid time."""
        unit, start = self.scale["states"], float(path.grid[j])
        physical = Y * unit * unit[:, None]
        found = [integrator.step(path.x[j], physical, path.u, path.u, start, t, path.w[j]) for t in times]
        return [(t, each / unit / unit[:, None]) for t, each in zip(times, found, strict=True)]

    def _sampled(self, Y: Array, path: SampledTrajectory, j: int) -> Array:
        """Y after the sample at a grid time."""
        scale, weights, mask = self.scale, self.weights, path.measured[j]
        slopes = self.plant.slopes_casadi(path.x[j], path.u, path.w[j], path.v[j], path.grid[j])
        C, E = (np.array(slopes[k]) for k in (3, 5))
        C, E = C * scale["states"] / scale["outputs"][:, None], E * scale["noises"] / scale["outputs"][:, None]
        noise = np.linalg.solve(weights.R, np.eye(len(weights.R))) + E @ np.linalg.solve(weights.Qv, E.T)
        covariance: Array = np.asarray(noise, dtype=np.float64)
        return measurement_update(Y, whitened(C[mask], covariance[np.ix_(mask, mask)]))


def _largest(Y: Array, factor: Array) -> float:
    """Largest generalised eigenvalue of the weight L L' against Y^-1; none where Y is not finite."""
    if not np.isfinite(Y).all():
        return 0.0
    return float(np.linalg.eigvalsh(symmetrise(factor.T @ Y @ factor))[-1])
