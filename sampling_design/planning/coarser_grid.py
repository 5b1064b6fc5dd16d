"""A coarser grid of the same problem, and what a search there says on the finer one.

All of its times are times of the finer grid: a choice is one there, and so is a disturbance, constant for more steps.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.adversary_program import forced_response
from sampling_design.planning.discrete_plant import DiscretePlant
from sampling_design.planning.hidden_trajectories import HiddenTrajectory
from sampling_design.planning.problem import WHOLE, PlanProblem, pose_plan
from sampling_design.records.arrays import Mask
from sampling_design.records.units import SECONDS, time_factor

COARSE = 168  # steps of a grid, the hours of a week, up to which it is not looked at more coarsely first


def coarser(problem: PlanProblem) -> PlanProblem | None:
    """The same on a grid of a third as many steps or fewer, all of them steps of this one; None where it is short.

    With a calendar its steps make up whole hours, then days: grids that people use are among those that follow.
    """
    requirement, whole = problem.requirement, np.inf
    if requirement.calendar is not None:
        seconds = problem.step * SECONDS[problem.plant.time_unit]
        whole = (SECONDS["h"] if seconds < SECONDS["h"] * (1 - WHOLE) else SECONDS["d"]) / seconds
    parts = [k for k in range(2, problem.steps) if problem.steps % k == 0]
    if np.isfinite(whole):
        parts = [k for k in parts if abs(whole / k - round(whole / k)) <= WHOLE]
    if problem.steps <= COARSE or not parts:
        return None
    step = problem.step * next((k for k in parts if k > 2), 2)
    unit = requirement.time_unit or problem.plant.time_unit
    try:
        return pose_plan(problem.plant, requirement.replace(grid=step * time_factor(problem.plant.time_unit, unit)))
    except (ArgumentError, InfeasibleRequirementError):  # times that a goal asks for, or hours, fall between its steps
        return None


def lifted_choices(problem: PlanProblem, coarse: Iterable[Mask]) -> list[Mask]:
    """The choices of a coarser grid, on this one, as far as they are admissible here."""
    found = []
    for chosen in coarse:
        lifted = np.zeros(problem.allowed.shape, dtype=bool)
        lifted[:: problem.steps // len(chosen)] = chosen
        found += [lifted] if problem.is_admissible(lifted) else []
    return found


def lifted_trajectories(
    oracle: AccuracyOracle, discrete: DiscretePlant, trajectories: Iterable[HiddenTrajectory]
) -> list[HiddenTrajectory]:
    """The trajectories of a coarser grid, where `discrete` is the plant, on the grid of an oracle.

    Flown over its steps, with what all of these would show. Of a tangent: the one that touches at the same samples.
    """
    found, steps = [], oracle.problem.steps
    for trajectory in trajectories:
        part = steps // len(trajectory.peaks)
        if trajectory.response is None:
            z = np.zeros(oracle.problem.allowed.shape)
            z[::part] = np.roll(trajectory.touches, -(trajectory.end + 1) % len(trajectory.peaks), axis=0)[::-1]
            lifted = oracle.tangent(z, trajectory.goal)
        else:
            response = trajectory.response
            states = np.asarray(
                np.linalg.lstsq(oracle.discrete.T, discrete.T @ response.states.T)[0].T, dtype=np.float64
            )
            propagated = forced_response(
                oracle.discrete, response.knots * part, states, np.repeat(response.w, part, axis=0)
            )
            lifted = oracle.scaled(propagated, trajectory.goal, trajectory.end * part, trajectory.at_sample)
        found += [lifted] if lifted is not None else []
    return found
