"""The window problem with active constraints: which engine, and whether its answer is taken.

The engines solve the least-distance problem min |z|^2 that the smoother leaves; what they bring back is
checked for feasibility and against a dual bound, and that bound, not their own value, enters the radius.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.estimators.constraints.constraints import WindowConstraints
from sampling_design.estimators.constraints.least_distance import NearestPoint, active_set, conic, find_obstacle
from sampling_design.estimators.constraints.least_distance_problem import ConstraintDemands
from sampling_design.estimators.window.window_estimate import WindowEstimate
from sampling_design.estimators.window.window_problem import EstimationWindow
from sampling_design.records.arrays import Mask

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
