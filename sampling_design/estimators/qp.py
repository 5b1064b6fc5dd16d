"""The window problem with active constraints: which engine, and whether its answer is taken.

The engines solve the least-distance problem min |z|^2 that the smoother leaves; what they bring back is
checked for feasibility and against a dual bound, and that bound, not their own value, enters the radius.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.estimators.constraints import Constraints
from sampling_design.estimators.least_distance import active_set, conic, is_accepted
from sampling_design.estimators.reference import find_obstacle, solve_reference
from sampling_design.estimators.solution import Solution
from sampling_design.estimators.window import Window

ENGINES = ("auto", "active set", "conic", "reference")


def solve_constrained(window: Window, constraints: Constraints, free: Solution, engine: str = "auto") -> Solution:
    """Return the minimiser under the constraints, given the one without.

    Notes
    -----
    *Method.* Rows only: the active-set method, and the conic one if that fails; norm balls: the conic one. An answer
    that misses ACCEPTED by both is the status "solver failed"; if the least sum of slacks is
    positive, the status is "infeasible" and names the constraint that needs most.
    """
    if engine == "reference":
        return solve_reference(window, constraints, free)
    problem = constraints.least_distance(window, free.nodes, free.kernel())
    engines = {"active set": [active_set], "conic": [conic]}.get(
        engine, [conic] if problem.cones else [active_set, conic]
    )
    for solve in engines:
        found = solve(problem)
        if found is not None and is_accepted(problem, found):
            nodes = free.nodes + np.matmul(problem.T, found.z)
            square = float(found.z @ found.z)
            return replace(
                free, nodes=nodes, cost=free.cost + square, dual=free.dual + max(0.0, found.dual), engine=found.engine
            )
    obstacle = find_obstacle(problem)
    if obstacle:
        return replace(free, status="infeasible", note=f"No trajectory meets {obstacle}.", engine="conic")
    return replace(free, status="solver failed", note="No engine reached its tolerance.", engine="conic")
