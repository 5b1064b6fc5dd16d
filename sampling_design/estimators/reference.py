"""The window problem as it is written, for the modelling library: slow, readable, what the engines are judged by."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _conic
from sampling_design.estimators.constraints import Constraints, LeastDistance
from sampling_design.estimators.convex_set import ConvexSet
from sampling_design.estimators.least_distance import ACCEPTED, SOLVER_TOLERANCE
from sampling_design.estimators.solution import Solution
from sampling_design.estimators.window import Window

Array = npt.NDArray[np.float64]

NEEDED = 1e-7
"""A sum of slacks (in posterior standard deviations) above this means that the constraints cannot all be met."""


def solve_reference(window: Window, constraints: Constraints, free: Solution) -> Solution:
    """Solve the window problem as it is written, in states, omega and v, with the modelling library. Slow.

    Nothing of the smoother's algebra is used (`free` lends only its type): this is what the others are judged by.
    """
    cp = _conic.cvxpy()
    weights, plant = window.weights, window.weights.plant
    count = window.times.size
    x = [cp.Variable(plant.n_states) for _ in range(count)]
    omega = [cp.Variable(flow.root.shape[1]) for flow in window.flows]
    root = np.sqrt(window.discount)
    parts, terms = [], [cp.sum_squares(window.prior_half @ (x[0] - window.reference[0]))]
    for j, flow in enumerate(window.flows):
        drift = window.defect[j] + window.reference[j + 1] - flow.F @ window.reference[j]
        parts.append(x[j + 1] == flow.F @ x[j] + drift + flow.root @ omega[j])
        terms.append(cp.sum_squares(root[j + 1] * omega[j]))
        if constraints.reach is not None:
            parts += _inside(cp, omega[j], constraints.reach.over(flow))
    if constraints.x is not None:
        parts += [part for node in x for part in _inside(cp, node, constraints.x)]
    fit, own = np.linalg.cholesky(weights.R).T, np.linalg.cholesky(weights.v).T
    for j in window.samples:
        mask, v = window.masks[j], cp.Variable(plant.n_outputs)
        model = plant.C @ x[j] + window.feedthrough[j]
        residual = cp.multiply(mask, window.y[j] - model) - v
        terms += [cp.sum_squares(root[j] * (fit @ residual)), cp.sum_squares(root[j] * (own @ v))]
        for chosen, signal in ((constraints.v, v), (constraints.y, model + v)):
            if chosen is not None:
                parts += _inside(cp, signal, chosen, mask)
    problem = cp.Problem(cp.Minimize(cp.sum(terms)), parts)
    record = _conic.solve(problem, tolerance=SOLVER_TOLERANCE)
    if record.status == _conic.INFEASIBLE:
        return replace(free, status="infeasible", note="No trajectory meets the constraints.", engine="reference")
    if not _conic.usable(record):
        return replace(free, status="solver failed", note=f"Status {record.status}.", engine="reference")
    value = float(problem.value)
    margin = ACCEPTED * max(1.0, abs(value))
    return replace(
        free, nodes=np.array([node.value for node in x]), cost=value, dual=value - margin, engine="reference"
    )


def _inside(cp: Any, signal: Any, chosen: ConvexSet, mask: Array | None = None) -> list[Any]:
    """Constraints that keep an expression in a set, measured entries only where there is a mask."""
    seen = np.ones(chosen.dimension, bool) if mask is None else mask > 0
    low, up = seen & np.isfinite(chosen.lower), seen & np.isfinite(chosen.upper)
    parts = [signal[i] >= chosen.lower[i] for i in np.flatnonzero(low)]
    parts += [signal[i] <= chosen.upper[i] for i in np.flatnonzero(up)]
    if seen.all():
        parts += [chosen.rows @ signal <= chosen.offsets] if chosen.rows.shape[0] else []
        parts += [cp.norm(ball.shape @ (signal - ball.centre)) <= ball.radius for ball in chosen.balls]
    return parts


def find_obstacle(problem: LeastDistance) -> str:
    """Name the constraint that needs the largest slack when the sum of slacks is least ("" if none is needed)."""
    cp = _conic.cvxpy()
    z = cp.Variable(problem.T.shape[2])
    slack, wide = cp.Variable(problem.A.shape[0], nonneg=True), cp.Variable(len(problem.cones), nonneg=True)
    has_up, has_low = np.isfinite(problem.upper), np.isfinite(problem.lower)
    parts = []
    if problem.A.shape[0]:
        value = problem.A @ z
        parts += [value[has_up] <= problem.upper[has_up] + slack[has_up]]
        parts += [value[has_low] >= problem.lower[has_low] - slack[has_low]]
    parts += [cp.norm(M @ z + c) <= r + wide[i] for i, (M, c, r) in enumerate(problem.cones)]
    record = _conic.solve(cp.Problem(cp.Minimize(cp.sum(slack) + cp.sum(wide)), parts))
    if not _conic.usable(record):
        return ""
    needs = [(float(s) * scale, i, True) for i, (s, scale) in enumerate(zip(slack.value, problem.scales, strict=True))]
    needs += [(float(s), i, False) for i, s in enumerate(wide.value)]
    amount, index, is_row = max(needs, default=(0.0, 0, True))
    total = float(slack.value.sum() + wide.value.sum())
    if total <= NEEDED:
        return ""
    if not is_row:
        return f"{problem.cone_label(index)} (needs {amount:.3g} more)"
    below = problem.A[index] @ z.value < problem.lower[index]
    return f"{problem.row_label(index, bool(below))} (needs {amount:.3g} more)"
