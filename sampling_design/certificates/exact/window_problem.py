"""The discounted information recursion of a plant on a schedule, in coordinates where P2 = I.

A window starts at some real time, inside the gap before sample i, with `remaining` time to that sample,
and Y = Pi^-1 starts at P2^-1. In the coordinates x~ = L'x, P2 = L L', that is Y~ = I, and
lambda_max(P2 Y) is simply the largest eigenvalue of Y~.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from sampling_design.numerics.linalg import discounted_flow, symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.schedules.family import AnySchedule


def growing_flow(A: Array, noise: Array, eta: float, durations: npt.ArrayLike) -> tuple[Array, Array]:
    """Return F = e^{(A + eta/2) h} and W_h for each duration, so that Y(t + h) = F Y F' + W."""
    h = np.atleast_1d(np.asarray(durations, dtype=np.float64))
    plain, W = discounted_flow(A, noise, h, eta)
    return plain * np.exp(eta * h / 2)[:, None, None], W


@dataclass(frozen=True, eq=False)
class WindowProblem:
    """Everything the recursion needs: flow, whitened output rows per sample, gaps, and where windows may start.

    `A`, `noise` and `rows` are in coordinates x~ = root' x (P2 = root root'). `rows[i]` is V_i^{-1/2} C_i with
    V_i the measured block of R^-1 + Qv^-1, padded with zero rows. Before sample i a window may start with any
    remaining time in [0, reach[i]]; sample i lies `gaps[i]` after its predecessor in the period.
    """

    A: Array
    noise: Array
    rows: Array
    eta: float
    root: Array
    gaps: Array
    reach: Array
    times: Array
    period: float | None

    @property
    def count(self) -> int:
        """Samples in the period, or in the finite schedule."""
        return self.gaps.size

    @property
    def size(self) -> int:
        """Dimension n."""
        return len(self.A)

    def flow(self, durations: npt.ArrayLike) -> tuple[Array, Array]:
        """Return F and W of `growing_flow` for each duration."""
        return growing_flow(self.A, self.noise, self.eta, durations)

    def sample_starts(self) -> tuple[Index, Array]:
        """Return (index, remaining) of the windows of Def 2: from time 0 and from each sample."""
        index, first = np.arange(self.count), self.times[0]
        if first == self.gaps[0]:
            return index, self.gaps.copy()
        return np.append(index, 0), np.append(self.gaps, first)

    def physical(self, direction: Array) -> Array:
        """Return a direction of x~ as a unit direction of x."""
        x = np.linalg.solve(self.root.T, direction)
        return x / np.linalg.norm(x)


def noise_input(G: Array, Qw: Array) -> Array:
    """Return H = G Qw^(-1/2) (n, q), H H' = G Qw^-1 G', by one triangular solve: no direction is ever dropped."""
    if not Qw.size:
        return np.zeros((G.shape[0], 0))
    root = np.linalg.cholesky(Qw)
    return np.asarray(solve_triangular(root, G.T, lower=True).T, dtype=np.float64)


def covariance_flow(plant: Plant, Qw: Array, root: Array) -> tuple[Array, Array]:
    """Return A and G Qw^-1 G' of Y' = AY + YA' + eta Y + noise in coordinates x~ = root' x."""
    A, drive = np.linalg.solve(root, (root.T @ plant.A).T).T, root.T @ noise_input(plant.G, Qw)
    return np.asarray(A, dtype=np.float64), np.asarray(drive @ drive.T, dtype=np.float64)


def whitened_rows(C: Array, R: Array, Qv: Array, mask: Mask | None, count: int) -> Array:
    """Return V_i^{-1/2} C_i per sample, V = R^-1 + Qv^-1 restricted to the measured outputs; zero rows pad."""
    V = symmetrise(np.linalg.inv(R) + np.linalg.inv(Qv))
    if mask is None:
        return np.broadcast_to(np.linalg.solve(np.linalg.cholesky(V), C), (count, *C.shape))
    rows = np.zeros((count, *C.shape))
    for pattern in np.unique(mask, axis=0):
        measured = np.flatnonzero(pattern)
        part = np.linalg.solve(np.linalg.cholesky(V[np.ix_(measured, measured)]), C[measured])
        rows[np.ix_(np.flatnonzero((mask == pattern).all(axis=1)), np.arange(measured.size))] = part
    return rows


def window_problem(
    plant: Plant, schedule: AnySchedule, P2: Array, Qw: Array, R: Array, Qv: Array, eta: float
) -> WindowProblem:
    """Return the recursion of `plant` on `schedule` (already in the plant's terms) for given weights."""
    root = np.asarray(np.linalg.cholesky(P2), dtype=np.float64)
    A, noise = covariance_flow(plant, Qw, root)
    rows = whitened_rows(plant.C, R, Qv, schedule.outputs, len(schedule))
    rows = np.swapaxes(np.linalg.solve(root, np.swapaxes(rows, 1, 2)), 1, 2)
    times = np.array(schedule.times)
    gaps = np.array(schedule.gaps) if schedule.endless else np.diff(times, prepend=0.0)
    reach, period = gaps.copy(), float(schedule.period) if schedule.endless else None
    reach[0] = max(gaps[0], times[0])  # the first sample of an endless schedule may come later than its gap
    return WindowProblem(
        A=A, noise=noise, rows=rows, eta=eta, root=root, gaps=gaps, reach=reach, times=times, period=period
    )
