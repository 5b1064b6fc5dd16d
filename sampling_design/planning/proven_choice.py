"""A choice of samples with its accuracy proven, as a plan."""

from __future__ import annotations

import numpy as np

from sampling_design.errors import UndecidedError
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.feasible_choices import GoalProofs
from sampling_design.planning.figures import accuracy_of
from sampling_design.planning.plan_record import Plan, deviation_of, reached
from sampling_design.planning.problem import PlanProblem
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.checks import freeze


def proof_of(problem: PlanProblem, chosen: Mask) -> GoalProofs:
    """The proof of a choice: accuracy for what is guaranteed, and standard deviations."""
    return accuracy_of(problem, chosen), deviation_of(problem, chosen)


def ratios_of(problem: PlanProblem, chosen: Mask) -> tuple[GoalProofs, Array]:
    """The same, and the ratios to the tolerances: infinite where nothing bounds what early and late samples do."""
    tolerances = np.array([goal.tolerance for goal in problem.goals])
    try:
        proof = proof_of(problem, chosen)
    except UndecidedError:
        if not problem.timing_tolerance:
            raise
        return (None, None), np.full_like(tolerances, np.inf)
    return proof, reached(problem, chosen, *proof) / tolerances


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
