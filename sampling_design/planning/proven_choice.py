"""A choice of samples with its accuracy proven, as a plan."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.accuracy import guaranteed_accuracy
from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.errors import NotDetectableError
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.feasible_choices import GoalProofs
from sampling_design.planning.plan_record import Plan, deviation_of, reached
from sampling_design.planning.problem import PlanProblem
from sampling_design.records.checks import freeze

Mask = npt.NDArray[np.bool_]

RTOL = 0.005
"""Width of the brackets that prove a plan."""


def proof_of(problem: PlanProblem, chosen: Mask) -> GoalProofs:
    """The proof of a choice: accuracy for what is guaranteed, and standard deviations."""
    return accuracy_of(problem, chosen), deviation_of(problem, chosen)


def accuracy_of(problem: PlanProblem, chosen: Mask) -> Accuracy | None:
    """The accuracy of a choice's goals that are guaranteed; None if it has none."""
    rows = [goal.row for goal in problem.goals if not goal.spread]
    if not rows:
        return None
    told = chosen & np.isfinite(problem.v_bound)
    if not told.any():
        raise NotDetectableError("`schedule` reads no sensor that has a `noise_bound`.")
    schedule = problem.schedule(told)
    v = np.tile(np.where(np.isfinite(problem.v_bound), problem.v_bound, 1.0), (len(schedule), 1))
    return guaranteed_accuracy(
        problem.plant, schedule, w_bound=problem.requirement.w_bound, v_bound=v, of=np.array(rows), rtol=RTOL
    )


def proven_plan(problem: PlanProblem, chosen: Mask, bound: PlanBound, status: str) -> Plan:
    """The plan of a choice, its accuracy proven."""
    return plan_of(problem, chosen, proof_of(problem, chosen), bound, status)


def plan_of(problem: PlanProblem, chosen: Mask, proof: GoalProofs, bound: PlanBound, status: str) -> Plan:
    """The plan of a choice whose proof is at hand."""
    return Plan(
        problem.plant,
        problem.requirement,
        problem.schedule(chosen),
        proof[0],
        freeze(reached(problem, chosen, *proof)),
        bound,
        status=status,
        deviation=proof[1],
    )
