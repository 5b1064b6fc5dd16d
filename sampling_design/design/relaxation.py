"""Semidefinite relaxations on a time grid: weights to round, multipliers to prove a bound with.

Two programs of one shape. *Placed*: weights on the times of the period, with forbidden and fixed times.
*Relative*: weights on the distances d from a sample to the others, averaged over all samples of a lap;
it uses that the windows just after each sample are the hard ones, that distances come in pairs d and
P - d, and that the distances between points have a non-negative Fourier transform.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _conic
from sampling_design.design.gram import lags
from sampling_design.design.problem import DesignProblem
from sampling_design.evidence import SolverRecord

Array = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Weights on grid times and the multipliers of its inequalities.

    The multipliers `Z` of the window starts `starts` are psd with sum <Z_m, S'S> = 1 and `cosines` are
    >= 0: both enforced here, so that the bound made from them does not rest on the solver.
    """

    times: Array
    weights: Array
    starts: Array
    Z: Array
    cosines: Array
    value: float
    record: SolverRecord


def grid_size(problem: DesignProblem) -> int:
    """Grid times per period: fine enough for the spacing, coarse enough for a solve in about a second."""
    fine = int(np.ceil(problem.period / problem.spacing))
    most = 96 if problem.plant.n_states <= 8 else 64
    return int(np.clip(max(fine, 4 * problem.samples), 24, most))


def relax_placed(problem: DesignProblem, points: int | None = None, budget: float | None = None) -> Relaxation:
    """Maximise t subject to sum_j w_j G(t_j - a_m) >= t I for every window start a_m on the grid."""
    N = grid_size(problem) if points is None else points
    step = problem.period / N
    times = np.arange(N) * step
    mask = problem.mask(times)
    free = mask.any(axis=-1)
    for t in problem.fixed:
        distance = np.abs((times - t + problem.period / 2) % problem.period - problem.period / 2)
        free &= distance >= problem.spacing * (1 - 1e-9)
    places = np.flatnonzero(free)
    grams = _grams(problem, times[places], times, mask[places])
    constant = _grams(problem, problem.fixed, times, problem.mask(problem.fixed)).sum(axis=1)
    span = max(1, int(np.ceil(problem.spacing / step - 1e-9)))
    roof = max(1.0, step / problem.spacing)
    crowd = np.zeros((N, N))
    for offset in range(span):
        crowd[np.arange(N), (np.arange(N) + offset) % N] = 1.0
    linear = (crowd[:, places], np.full(N, roof))
    count = float(problem.samples - problem.fixed.size)
    return _solve(problem, times[places], times, grams, constant, linear, count, 0, budget)


def relax_relative(problem: DesignProblem, points: int | None = None, budget: float | None = None) -> Relaxation:
    """As `relax_placed` for the distances from one sample to the others, averaged over the lap's samples."""
    N = grid_size(problem) if points is None else points
    N += N % 2
    step = problem.period / N
    starts = np.arange(N) * step
    half = np.arange(1, N // 2 + 1) * step
    near = half >= problem.spacing * (1 - 1e-9) - step / 2
    half = half[near]
    every = np.ones((half.size, problem.plant.n_outputs), dtype=bool)
    pair = _grams(problem, half, starts, every) + _grams(problem, problem.period - half, starts, every)
    anchor = _grams(problem, np.zeros(1), starts, every[:1]).sum(axis=1)
    span = max(1, int(np.ceil(problem.spacing / step - 1e-9)))
    roof = max(1.0, step / problem.spacing)
    rows = []
    for i in range(1, N):
        picked = (np.arange(i, i + span) - 1) % N + 1
        folded = np.minimum(picked, N - picked) * step
        rows.append(np.isclose(half[None, :], folded[:, None], rtol=0, atol=step / 4).sum(axis=0))
    linear = (np.unique(np.array(rows, dtype=float), axis=0) / 2, np.empty(0))
    linear = (linear[0], np.full(linear[0].shape[0], roof))
    waves = np.arange(1, min(N // 2, 4 * problem.samples) + 1)
    count = float(problem.samples - 1)
    solution = _solve(problem, half, starts, pair / 2, anchor, linear, count, waves.size, budget)
    return solution


def _grams(problem: DesignProblem, times: Array, starts: Array, mask: npt.NDArray[np.bool_]) -> Array:
    """(M, N, n, n) scaled Gram matrices of samples at `times` in the windows (a_m, a_m + T]."""
    rows = problem.rows
    n, p = problem.plant.n_states, problem.plant.n_outputs
    r, inside = lags(times[None, :], starts[:, None], problem.window, problem.period, "right")
    c = rows.rows(r) * (inside[..., None] & mask[None, :, None, :])[..., None]
    c = c.reshape(starts.size, times.size, -1, n) if times.size else np.zeros((starts.size, 0, p, n))
    return np.asarray(np.swapaxes(c, -1, -2) @ c)


def _solve(
    problem: DesignProblem,
    times: Array,
    starts: Array,
    grams: Array,
    constant: Array,
    linear: tuple[Array, Array],
    count: float,
    waves: int,
    budget: float | None,
) -> Relaxation:
    """Pose the cone program, solve it, and make its multipliers feasible."""
    rows = problem.rows
    N = times.size
    cost = np.zeros(N + 1)
    cost[-1] = -1.0
    total = np.append(np.ones(N), 0.0)[None, :]
    bounded = np.hstack([np.vstack([linear[0], -np.eye(N)]), np.zeros((linear[0].shape[0] + N, 1))])
    cosine = np.cos(2 * np.pi * np.outer(np.arange(1, waves + 1), times) / problem.period)
    blocks: list[tuple[str, Array, Array]] = [
        ("zero", total, np.array([count])),
        ("nonnegative", bounded, np.concatenate([linear[1], np.zeros(N)])),
    ]
    if waves:
        blocks.append(("nonnegative", np.hstack([-cosine, np.zeros((waves, 1))]), np.ones(waves)))
    ceiling = _conic.svec(rows.N)
    for m in range(starts.size):
        block = np.hstack([-_conic.svec(grams[m]).T, ceiling[:, None]])
        blocks.append(("psd", block, _conic.svec(constant[m])))
    found = _conic.solve_cone_program(cost, blocks, budget=budget, tolerance=1e-7)
    first = 3 if waves else 2
    Z = _psd_part(np.array(found.z[first:]))
    mass = float(np.einsum("mij,ij->", Z, rows.N))
    if not np.isfinite(mass) or mass <= 0:  # nothing usable came back: any psd multipliers give a true bound
        Z, mass = np.broadcast_to(rows.S.T @ rows.S, (starts.size, *rows.N.shape)).copy(), 0.0
        mass = float(np.einsum("mij,ij->", Z, rows.N))
    cosines = np.maximum(found.z[2], 0.0) / mass if waves else np.zeros(0)
    weights = np.clip(np.nan_to_num(found.x[:N]), 0.0, None)
    return Relaxation(
        times, weights, starts, Z / (mass * rows.unit), cosines / rows.unit, found.x[-1] / rows.unit, found.record
    )


def _psd_part(Z: Array) -> Array:
    """Nearest psd matrices of a stack; entries that are not finite count as zero."""
    values, vectors = np.linalg.eigh(np.nan_to_num(Z))
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2))
