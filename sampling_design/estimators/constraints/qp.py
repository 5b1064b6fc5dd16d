"""The window problem with active constraints: engines for what the smoother leaves, and whether an answer is taken.

Left is the least-distance problem min |z|^2 under rows and cones: an active-set method solves it, or an interior-point
method with Newton's. Every bound on its least value comes from weak duality with multipliers of the right sign,
whatever the engine says; an answer is checked for feasibility and against that bound, which enters the radius.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sampling_design.errors import MissingExtraError
from sampling_design.estimators.constraints.constrained_signals import ConstraintDemands, LeastDistance
from sampling_design.estimators.constraints.constraints import WindowConstraints
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.gap_flows.cost_weights import marginal_root
from sampling_design.estimators.window.window_problem import EstimationWindow, WindowEstimate
from sampling_design.numerics import conic_programs
from sampling_design.records.arrays import Array, Mask

if TYPE_CHECKING:
    from cvxpy import Constraint, Expression
    from cvxpy import Problem as Problem

ACCEPTED = 1e-9
"""Infeasibility (in posterior standard deviations) and relative duality gap up to which an answer is taken."""

SOLVER_TOLERANCE = 1e-12  # asked of the engines; what comes back is judged by ACCEPTED
EXACT = 1e-13  # a relative duality gap and an infeasibility that may be rounding

STILL = 1e-9
"""A Newton step, relative to |z|, after which the next one would be rounding: it is about the square of this one."""

NEEDED = 1e-7
"""A sum of slacks (in posterior standard deviations) above this means that the constraints cannot all be met."""

NEWTON_STEPS = 10
"""Steps that polish an answer: each doubles the digits, so that four are enough but for degenerate cones."""


class NearestPoint(NamedTuple):
    """A point z, how far it is from feasible, |z|^2, a lower bound on the least |z|^2, and the engine."""

    z: Array
    excess: float
    square: float
    dual: float
    engine: str

    @property
    def gap(self) -> float:
        """Relative duality gap; the squared distance to the minimiser is at most that times max(1, |z|^2)."""
        return (self.square - self.dual) / max(1.0, self.square)

    @property
    def is_accepted(self) -> bool:
        """Whether the point is feasible and optimal, whatever its engine says of it."""
        return self.excess <= ACCEPTED * max(1.0, self.square**0.5) and self.gap <= ACCEPTED


def judged(problem: LeastDistance, z: Array, rows: Array, cones: Array, engine: str) -> NearestPoint:
    """Return the point z with what multipliers prove of it."""
    return NearestPoint(z, infeasibility(problem, z), float(z @ z), dual_value(problem, rows, cones), engine)


def infeasibility(problem: LeastDistance, z: Array) -> float:
    """Return the largest violation; cones relative to their radius and centre."""
    worst = 0.0
    if problem.A.shape[0]:
        value = problem.A @ z
        worst = max(worst, float((value - problem.upper).max()), float((problem.lower - value).max()))
    for M, c, radius in problem.cones:
        distance = float(np.linalg.norm(M @ z + c))
        worst = max(worst, (distance - radius) / max(radius, float(np.linalg.norm(c)), np.finfo(float).tiny))
    return worst


def dual_value(problem: LeastDistance, rows: Array, cones: Array) -> float:
    """Return a lower bound on the least |z|^2, for multipliers `rows` (> 0 upper, < 0 lower) and `cones` >= 0.

    With cone i as (|M_i z + c_i|^2 - r_i^2)/2 <= 0 the Lagrangian is a convex quadratic in z, and its minimum is
    a bound whatever the multipliers are.
    """
    on = np.flatnonzero(rows)
    bounds = np.where(rows[on] > 0, problem.upper[on], problem.lower[on])
    if np.isinf(bounds).any():
        return -np.inf
    constant = -float(rows[on] @ bounds)
    linear = rows[on] @ problem.A[on]
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


def active_set(problem: LeastDistance) -> NearestPoint | None:
    """Solve the problem without cones by a dual active-set method."""
    import daqp

    count, size = problem.A.shape
    lower, upper = np.maximum(problem.lower, -1e30), np.minimum(problem.upper, 1e30)
    sense = np.zeros(count, dtype=np.int32)
    z, _, flag, info = daqp.solve(np.eye(size), np.zeros(size), problem.A, upper, lower, sense, **_limits(problem.A))
    if flag < 1:
        return None
    rows = np.asarray(info["lam"], dtype=np.float64)
    return judged(problem, np.asarray(z, dtype=np.float64), rows, np.zeros(0), "active set")


def conic(problem: LeastDistance) -> NearestPoint | None:
    """Solve the problem, cones and all, by an interior-point method."""
    from scipy import sparse

    cl = conic_programs.clarabel()
    size, count = problem.size, problem.A.shape[0]
    has_up, has_low = np.isfinite(problem.upper), np.isfinite(problem.lower)
    blocks = [problem.A[has_up], -problem.A[has_low]]
    right = [problem.upper[has_up], -problem.lower[has_low]]
    kinds = [cl.NonnegativeConeT(int(has_up.sum() + has_low.sum()))]
    for M, c, radius in problem.cones:
        scale = max(1e-300, float(np.linalg.norm(M, 2)))
        blocks += [np.zeros((1, size)), -M / scale]
        right += [np.array([radius / scale]), c / scale]
        kinds.append(cl.SecondOrderConeT(1 + M.shape[0]))
    settings = conic_programs.quiet_settings()
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
        cones[i] = max(0.0, y[at]) / max(1e-300, float(np.linalg.norm(M, 2))) / radius
        at += 1 + M.shape[0]
    return _refined(problem, judged(problem, z, rows, cones, "conic"), cones)


def _refined(problem: LeastDistance, found: NearestPoint, cones: Array) -> NearestPoint:
    """Newton's method from an interior-point answer, taken if it settles and proves as much.

    A duality gap e leaves the point right to sqrt(e) only; Newton's step, whose size says how far it was, does not.
    """
    at = found
    for _ in range(NEWTON_STEPS):
        step = _newton(problem, at.z, cones)
        if step is None:
            return found
        moved = float(np.linalg.norm(step[0].z - at.z))
        at, cones = step
        if moved <= STILL * max(1.0, at.square**0.5):
            proven = max(abs(at.gap), at.excess) <= max(abs(found.gap), found.excess, EXACT)
            return at if proven else found
    return found


def _newton(problem: LeastDistance, z: Array, cones: Array) -> tuple[NearestPoint, Array] | None:
    """Return the next point and its cones' multipliers, which rows and cones are active being the solver's to find.

    min |x|^2 + sum mu_i |M_i (x - z)|^2 under the rows and a_i'M_i (x - z) <= (r_i^2 - |a_i|^2)/2, a_i = M_i z + c_i,
    mu_i = `cones`: the quadratic program of the optimality conditions at z.
    """
    import daqp

    bend, slopes, ends = np.eye(z.size), np.zeros((len(problem.cones), z.size)), np.zeros(len(problem.cones))
    pull = np.zeros(z.size)
    for i, (M, c, radius) in enumerate(problem.cones):
        a = M @ z + c
        slopes[i], ends[i] = M.T @ a, (radius**2 - float(a @ a)) / 2
        bend += cones[i] * (M.T @ M)
        pull += cones[i] * (M.T @ (M @ z))
    norms = np.linalg.norm(slopes, axis=1)
    sizes = np.where(norms > 0, norms, 1.0)
    A = np.vstack([problem.A, slopes / sizes[:, None]])
    upper = np.concatenate([np.minimum(problem.upper, 1e30), (ends + slopes @ z) / sizes])
    lower = np.concatenate([np.maximum(problem.lower, -1e30), np.full(ends.size, -1e30)])
    x, _, flag, info = daqp.solve(bend, -pull, A, upper, lower, np.zeros(upper.size, dtype=np.int32), **_limits(A))
    if flag < 1 or not np.isfinite(x).all():
        return None
    multipliers, count = np.asarray(info["lam"], dtype=np.float64), problem.A.shape[0]
    mu = np.maximum(multipliers[count:], 0.0) / sizes
    return judged(problem, np.asarray(x, dtype=np.float64), multipliers[:count], mu, "conic"), mu


def _limits(A: Array) -> dict[str, object]:
    """Settings of the active-set method."""
    return {"primal_tol": 1e-11, "dual_tol": 1e-12, "iter_limit": 20 * sum(A.shape)}


def find_obstacle(problem: LeastDistance) -> str:
    """Name the constraint that needs the largest slack when the sum of slacks is least ("" if none is needed)."""
    size, rows, balls = problem.size, problem.A.shape[0], len(problem.cones)
    up, low = np.flatnonzero(np.isfinite(problem.upper)), np.flatnonzero(np.isfinite(problem.lower))
    slack, wide = np.eye(rows, rows + balls), np.eye(balls, rows + balls, rows)
    blocks = [
        ("nonnegative", np.hstack([problem.A[up], -slack[up]]), problem.upper[up]),
        ("nonnegative", np.hstack([-problem.A[low], -slack[low]]), -problem.lower[low]),
        ("nonnegative", np.hstack([np.zeros((rows + balls, size)), -np.eye(rows + balls)]), np.zeros(rows + balls)),
    ]
    for (M, c, radius), own in zip(problem.cones, wide, strict=True):
        bound = np.hstack([np.zeros(size), -own])
        matrix = np.hstack([-M, np.zeros((len(M), rows + balls))])
        blocks.append(("second order", np.vstack([bound, matrix]), np.concatenate([[radius], c])))
    cost = np.concatenate([np.zeros(size), np.ones(rows + balls)])
    found = conic_programs.solve_cone_program(cost, [block for block in blocks if block[2].size])
    if not conic_programs.usable(found.record):
        return ""
    z, slacks = found.x[:size], found.x[size:]
    lost = np.finfo(float).eps * float((np.abs(problem.A) @ np.abs(z)).sum())
    if not slacks.sum() > NEEDED + lost:  # rows of a state that has grown are cancelled to no more digits than that
        return ""
    amounts = slacks * np.concatenate([problem.scales, np.ones(balls)])
    index = int(np.argmax(amounts))
    if index < rows:
        label = problem.row_label(index, bool(problem.A[index] @ z < problem.lower[index]))
    else:
        label = problem.cone_label(index - rows)
    return f"{label} (needs {amounts[index]:.3g} more)"


def cvxpy() -> ModuleType:
    """Return the modelling library, loaded on first use: it takes a second.

    Raises MissingExtraError if it is not installed; the message names the extra.
    """
    try:
        return import_module("cvxpy")
    except ImportError:
        raise MissingExtraError("cvxpy", "modelling") from None


def problem_as_written(window: EstimationWindow, constraints: WindowConstraints) -> Problem:
    """Return the window problem in states, omega and v, with nothing of the smoother's algebra.

    Variables x0, ..., omega1, ... and v0, ..., parameters prior and y0, ..., with the values that they have.
    """
    cp = cvxpy()
    weights, plant, root = window.weights, window.weights.plant, np.sqrt(window.discount)
    prior = cp.Parameter(plant.n_states, name="prior", value=window.reference[0])
    x = [cp.Variable(plant.n_states, name=f"x{j}") for j in range(window.times.size)]
    terms, parts = [cp.sum_squares(window.prior_half @ (x[0] - prior))], list["Constraint"]()
    for j, flow in enumerate(window.flows):
        omega = cp.Variable(flow.root.shape[1], name=f"omega{j + 1}")
        parts.append(x[j + 1] == flow.F @ x[j] + flow.root @ omega + window.drift[j])
        terms.append(cp.sum_squares(root[j + 1] * omega))
        if constraints.reach is not None:
            parts += _inside(cp, constraints.reach.over([flow])[0], omega)
    for j, state in enumerate(x):
        if constraints.x is not None:
            parts += _inside(cp, constraints.x, state)
        if window.limits is not None:
            parts += _inside(cp, ConvexSet.box(*window.limits[j]), plant.C @ state)
    for j in window.samples:
        v = cp.Variable(plant.n_outputs, name=f"v{j}")
        y = cp.Parameter(plant.n_outputs, name=f"y{j}", value=window.y[j])
        mask, model = window.masks[j], plant.C @ x[j] + window.feedthrough[j]
        fit, own = marginal_root(weights.R, mask > 0), marginal_root(weights.v, mask > 0)
        terms.append(cp.sum_squares(root[j] * (fit @ (cp.multiply(mask, y - model) - v))))
        terms.append(cp.sum_squares(root[j] * (own @ v)))
        for chosen, signal in ((constraints.v, v), (constraints.y, model + v)):
            if chosen is not None:
                parts += _inside(cp, chosen, signal, mask)
    if window.means is not None:
        half, means = np.linalg.cholesky(window.means.spread), window.means
        rows = np.linalg.solve(half, means.rows.reshape(len(half), -1))
        target = np.linalg.solve(half, means.target) + rows @ window.reference.ravel()
        terms.append(cp.sum_squares(target - rows @ cp.hstack(x)))
    found: Problem = cp.Problem(cp.Minimize(cp.sum(terms)), parts)
    return found


def _inside(cp: ModuleType, chosen: ConvexSet, z: Expression, mask: Array | None = None) -> list[Constraint]:
    """That z lies in a set, measured entries only where there is a mask."""
    measured = np.ones(chosen.dimension, bool) if mask is None else mask > 0
    low, up = measured & np.isfinite(chosen.lower), measured & np.isfinite(chosen.upper)
    found: list[Constraint] = [z[low] >= chosen.lower[low]] if low.any() else []
    found += [z[up] <= chosen.upper[up]] if up.any() else []
    if not measured.all():
        return found
    if chosen.rows.shape[0]:
        found.append(z @ chosen.rows.T <= chosen.offsets)
    for ball in chosen.balls:
        away = ball.shape @ (z - ball.centre)
        found.append(away == 0 if ball.radius == 0 else cp.sum_squares(away / ball.radius) <= 1)
    return found


FEW = 0.1  # share of the rows up to which those that matter are sought one by one; beyond, all are taken at once
SATISFIED = 1e-10  # excess, relative to the size of the values, up to which a signal counts as inside its set


def solve_constrained(
    window: EstimationWindow, constraints: WindowConstraints, free: WindowEstimate, engine: str = "auto"
) -> WindowEstimate:
    """Return the minimiser under the constraints, given the one without.

    Notes
    -----
    *Method.* If the minimiser without constraints keeps them all, it is the answer. Else, rows only: the active-set
    method, and the conic one if that fails; norm balls: the conic one. An answer that misses ACCEPTED by both is the
    status "solver failed"; if the least sum of slacks is positive, the status is "infeasible" and names the
    constraint that needs most.
    """
    demands = constraints.demands(window, free)
    values = demands.values()
    violated = demands.violated(values, SATISFIED)
    if not any(mask.any() for mask in violated) and demands.balls_hold(values, SATISFIED):
        return free
    found, whole = None, None
    if engine == "active set" or (engine == "auto" and not demands.has_balls):
        found = row_by_row(demands, violated)
    if engine == "conic" or (engine == "auto" and (found is None or not found.is_accepted)):
        whole = demands.pose()
        found = conic(whole)
    if found is not None and found.is_accepted:
        nodes = free.nodes + free.spread.states(found.z[: demands.states])
        cost, dual = free.cost + found.square, free.dual + max(0.0, found.dual)
        return replace(free, nodes=nodes, cost=cost, dual=dual, engine=found.engine)
    obstacle = find_obstacle(whole or demands.pose())
    if obstacle:
        return replace(free, status="infeasible", note=f"No trajectory meets {obstacle}.", engine="conic")
    return replace(free, status="solver failed", note="No engine reached its tolerance.", engine="conic")


def row_by_row(demands: ConstraintDemands, violated: list[Mask]) -> NearestPoint | None:
    """Solve under the rows that are `violated`, take in those that this breaks, and so on until none is.

    Every answer is a lower bound for the whole problem, so the last one, which keeps all rows, is the minimiser.
    """
    chosen, total = violated, sum(rows.places.size for rows in demands.rows)
    while True:
        few = sum(map(np.count_nonzero, chosen)) <= FEW * total
        found = active_set(demands.pose(chosen if few else None))
        if not few or found is None or not found.is_accepted:
            return found
        broken = demands.violated(demands.values(found.z), SATISFIED)
        if not any(np.any(new & ~old) for new, old in zip(broken, chosen, strict=True)):
            return found
        chosen = [new | old for new, old in zip(broken, chosen, strict=True)]
