"""The window problem with active constraints: which engine, and whether its answer is taken.

The engines solve the least-distance problem min |z|^2 that the smoother leaves; what they bring back is
checked for feasibility and against a dual bound, and that bound, not their own value, enters the radius.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from sampling_design.errors import MissingExtraError
from sampling_design.estimators.constraints.constraints import WindowConstraints
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.constraints.least_distance import NearestPoint, active_set, conic, find_obstacle
from sampling_design.estimators.constraints.least_distance_problem import ConstraintDemands
from sampling_design.estimators.gap_flows.cost_weights import marginal_root
from sampling_design.estimators.window.window_estimate import WindowEstimate
from sampling_design.estimators.window.window_problem import EstimationWindow
from sampling_design.records.arrays import Array, Mask

if TYPE_CHECKING:
    from cvxpy import Constraint, Expression
    from cvxpy import Problem as Problem


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
