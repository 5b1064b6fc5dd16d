"""Choices that a search begins with: as much as hours and spacing allow, and even times within the limits."""

from __future__ import annotations

import numpy as np

from sampling_design.errors import InfeasibleRequirementError
from sampling_design.planning.plan_record import without_limits
from sampling_design.planning.problem import SAME_PRICE, PlanProblem
from sampling_design.records.arrays import Mask


def densest(problem: PlanProblem) -> Mask:
    """As much as hours and spacing allow, from the first allowed time on."""
    chosen = np.zeros(problem.allowed.shape, dtype=bool)
    for i in np.flatnonzero(problem.allowed.any(axis=1)).tolist():
        for j in np.flatnonzero(problem.allowed[i]).tolist():
            chosen[i, j] = True
            if not without_limits(problem).is_admissible(chosen):
                chosen[i, j] = False
    return chosen


def sparse(problem: PlanProblem) -> Mask:
    """A choice within the limits: times as even as can be, at each as many sensors as there is money for.

    Raises InfeasibleRequirementError if not a single measurement is admissible.
    """
    at = np.flatnonzero(problem.allowed.any(axis=1))
    each = problem.visit + problem.price.min()
    affordable = problem.most_cost * (1 + SAME_PRICE) / each if each > 0 else np.inf
    most = int(min(problem.most_samples, len(at), affordable))
    for count in range(most, 0, -1):
        chosen = np.zeros(problem.allowed.shape, dtype=bool)
        wanted = np.arange(count) * problem.steps / count
        for step in wanted:
            near = np.argsort(np.abs((at - step + problem.steps / 2) % problem.steps - problem.steps / 2))
            for i in at[near].tolist():
                if _filled(problem, chosen, i):
                    break
        if int(chosen.any(axis=1).sum()) == count:
            return _filled_up(problem, chosen)
    raise InfeasibleRequirementError("No measurement is admissible within `cost_limit` and hours.", "cost_limit")


def _filled_up(problem: PlanProblem, chosen: Mask) -> Mask:
    """The samples of a choice with every sensor that there is room and money for, the cheapest first."""
    for _ in range(chosen.shape[1]):
        for i in np.flatnonzero(chosen.any(axis=1)).tolist():
            _filled(problem, chosen, i)
    return chosen


def _filled(problem: PlanProblem, chosen: Mask, i: int) -> bool:
    """Whether one more sensor, the cheapest, fits in at a step."""
    done = False
    for j in np.argsort(problem.price, kind="stable").tolist():
        if problem.allowed[i, j] and not chosen[i, j]:
            chosen[i, j] = True
            done = problem.is_admissible(chosen)
            if done:
                break
            chosen[i, j] = False
    return done
