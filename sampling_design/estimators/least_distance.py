"""Engines for min |z|^2 under rows and cones: an active-set method, an interior-point method, and a polish for both.

Every bound on the least value comes from weak duality with multipliers of the right sign, whatever the engine says.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design import _conic
from sampling_design.estimators.constraints import LeastDistance

Array = npt.NDArray[np.float64]

ACCEPTED = 1e-9
"""Infeasibility (in posterior standard deviations) and relative duality gap up to which an answer is taken."""

SOLVER_TOLERANCE = 1e-12
"""Asked of the engines; what comes back is judged by ACCEPTED."""

ACTIVE = (1e-7, 1e-5, 1e-9, 1e-3)
"""Shares of the largest multiplier above which one counts as active in the polish, tried in this order."""

EXACT = 1e-14
"""A relative duality gap and an infeasibility that need no further polish."""

POLISH_STEPS = 6


class Found(NamedTuple):
    """A point z, a lower bound on the least |z|^2, and which engine brought it."""

    z: Array
    dual: float
    engine: str


def is_accepted(problem: LeastDistance, found: Found) -> bool:
    """Whether a point is feasible and optimal, whatever its engine says of it."""
    excess = infeasibility(problem, found.z)
    square = float(found.z @ found.z)
    size = max(1.0, float(np.sqrt(square)))
    return excess <= ACCEPTED * size and square - found.dual <= ACCEPTED * max(1.0, square)


def infeasibility(problem: LeastDistance, z: Array) -> float:
    """Return the largest violation; cones relative to their radius and centre."""
    worst = 0.0
    if problem.A.shape[0]:
        value = problem.A @ z
        worst = max(worst, float(np.max(value - problem.upper)), float(np.max(problem.lower - value)))
    for M, c, radius in problem.cones:
        distance = float(np.linalg.norm(M @ z + c))
        worst = max(worst, (distance - radius) / max(radius, float(np.linalg.norm(c)), np.finfo(float).tiny))
    return worst


def dual_value(problem: LeastDistance, rows: Array, cones: Array) -> float:
    """Return a lower bound on the least |z|^2, for multipliers `rows` (> 0 upper, < 0 lower) and `cones` >= 0.

    With cone i as (|M_i z + c_i|^2 - r_i^2)/2 <= 0 the Lagrangian is a convex quadratic in z, and its minimum is
    a bound whatever the multipliers are.
    """
    up, low = rows > 0, rows < 0
    if np.isinf(problem.upper[up]).any() or np.isinf(problem.lower[low]).any():
        return -np.inf
    constant = -float(rows[up] @ problem.upper[up]) - float(rows[low] @ problem.lower[low])
    linear = problem.A.T @ rows
    used = np.flatnonzero(cones > 0)
    if used.size == 0:
        return 2 * constant - float(linear @ linear)
    quadratic = np.eye(linear.size)
    for i in used:
        M, c, radius = problem.cones[i]
        quadratic += cones[i] * (M.T @ M)
        linear = linear + cones[i] * (M.T @ c)
        constant += cones[i] * (float(c @ c) - radius**2) / 2
    half = np.linalg.solve(np.linalg.cholesky(quadratic), linear)
    return 2 * constant - float(half @ half)


def active_set(problem: LeastDistance) -> Found | None:
    """Solve the problem without cones by a dual active-set method."""
    import daqp

    size = problem.A.shape[1]
    lower, upper = np.maximum(problem.lower, -1e30), np.minimum(problem.upper, 1e30)
    sense = np.zeros(lower.size, dtype=np.int32)
    limits = {"primal_tol": 1e-11, "dual_tol": 1e-12, "iter_limit": 20 * (size + lower.size)}
    z, _, flag, info = daqp.solve(np.eye(size), np.zeros(size), problem.A, upper, lower, sense, **limits)
    if flag < 1:
        return None
    rows = np.asarray(info["lam"], dtype=np.float64)
    return _best(problem, np.asarray(z, dtype=np.float64), rows, np.zeros(0), "active set")


def conic(problem: LeastDistance) -> Found | None:
    """Solve the problem, cones and all, by an interior-point method."""
    from scipy import sparse

    cl = _conic.clarabel()
    size, count = problem.T.shape[2], problem.A.shape[0]
    has_up, has_low = np.isfinite(problem.upper), np.isfinite(problem.lower)
    blocks = [problem.A[has_up], -problem.A[has_low]]
    right = [problem.upper[has_up], -problem.lower[has_low]]
    kinds = [cl.NonnegativeConeT(int(has_up.sum() + has_low.sum()))]
    for M, c, radius in problem.cones:
        scale = max(1e-300, float(np.linalg.norm(M, 2)))
        blocks += [np.zeros((1, size)), -M / scale]
        right += [np.array([radius / scale]), c / scale]
        kinds.append(cl.SecondOrderConeT(1 + M.shape[0]))
    settings = cl.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = SOLVER_TOLERANCE
    A, b = sparse.csc_matrix(np.vstack(blocks)), np.concatenate(right)
    found = cl.DefaultSolver(sparse.identity(size, format="csc"), np.zeros(size), A, b, kinds, settings).solve()
    z, y = np.asarray(found.x), np.asarray(found.z)
    if "Infeasible" in str(found.status) or not (np.isfinite(z).all() and np.isfinite(y).all()):
        return None
    rows = np.zeros(count)
    rows[has_up] += np.maximum(y[: has_up.sum()], 0.0)
    rows[has_low] -= np.maximum(y[has_up.sum() : has_up.sum() + has_low.sum()], 0.0)
    at, cones = int(has_up.sum() + has_low.sum()), np.zeros(len(problem.cones))
    for i, (M, _, radius) in enumerate(problem.cones):
        # the multiplier of |Mz + c| <= r turned into that of (|Mz + c|^2 - r^2)/2 <= 0
        cones[i] = max(0.0, y[at]) / max(1e-300, float(np.linalg.norm(M, 2))) / radius if radius > 0 else 0.0
        at += 1 + M.shape[0]
    return _best(problem, z, rows, cones, "conic")


def _best(problem: LeastDistance, z: Array, rows: Array, cones: Array, engine: str) -> Found:
    """Return the best of the polished points that pass, else the point as it came."""
    best = Found(z, dual_value(problem, rows, cones), engine)
    gap = abs(_gap(best))
    for share in ACTIVE:
        if gap <= EXACT and infeasibility(problem, best.z) <= EXACT:
            break
        polished = _polished(problem, z, rows, cones, engine, share)
        if polished is not None and infeasibility(problem, polished.z) <= ACCEPTED and abs(_gap(polished)) < gap:
            best, gap = polished, abs(_gap(polished))
    return best


def _gap(found: Found) -> float:
    """Relative duality gap; the squared distance to the minimiser is at most that times max(1, |z|^2)."""
    square = float(found.z @ found.z)
    return (square - found.dual) / max(1.0, square)


def _polished(problem: LeastDistance, z: Array, rows: Array, cones: Array, engine: str, share: float) -> Found | None:
    """Newton's method on the optimality conditions of what is active: exact to rounding if that was guessed right."""
    rows_on = np.flatnonzero(np.abs(rows) > share * np.max(np.abs(rows), initial=1e-300))
    cones_on = np.flatnonzero(cones > share * np.max(cones, initial=1e-300))
    A = problem.A[rows_on]
    target = np.where(rows[rows_on] > 0, problem.upper[rows_on], problem.lower[rows_on])
    lam, mu = rows[rows_on], cones[cones_on]
    size, m = z.size, rows_on.size
    for _ in range(POLISH_STEPS if cones_on.size else 1):
        ends = [problem.cones[i][0] @ z + problem.cones[i][1] for i in cones_on]
        maps = [problem.cones[i][0] for i in cones_on]
        slopes = np.array([M.T @ end for M, end in zip(maps, ends, strict=True)]).reshape(-1, size)
        gaps = np.array([(problem.cones[i][2] ** 2 - end @ end) / 2 for i, end in zip(cones_on, ends, strict=True)])
        bend = np.eye(size) + sum((c * (M.T @ M) for c, M in zip(mu, maps, strict=True)), np.zeros((size, size)))
        J = np.vstack([A, slopes])
        right = -z - slopes.T @ mu - A.T @ lam
        # eliminate the step in z: J bend^-1 J' (new multipliers' change) = J bend^-1 right - constraint residual
        inner = np.linalg.solve(bend, np.column_stack([right, J.T])) if cones_on.size else np.column_stack([right, J.T])
        residual = np.concatenate([target - A @ z, gaps])
        change = np.linalg.lstsq(J @ inner[:, 1:], J @ inner[:, 0] - residual, rcond=None)[0]
        z = z + inner[:, 0] - inner[:, 1:] @ change
        lam, mu = lam + change[:m], mu + change[m:]
    if np.any(mu < 0) or not np.isfinite(z).all():
        return None
    exact_rows, exact_cones = np.zeros_like(rows), np.zeros_like(cones)
    exact_rows[rows_on] = np.where(lam * rows[rows_on] > 0, lam, 0.0)
    exact_cones[cones_on] = mu
    return Found(z, dual_value(problem, exact_rows, exact_cones), engine)
