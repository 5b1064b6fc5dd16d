"""A plan has a start: from when on its tolerances are kept if nothing, or a bound on the error, is known there."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sampling_design.errors import NotDetectableError, UndecidedError
from sampling_design.planning.figures import PlanFigures, PlanStart
from sampling_design.planning.sequence import proven_ratio, settled_since, settling_time
from sampling_design.planning.sequence_deviation import GRAIN, ORDINARY, SampleSequence, planned, sequence_from_start
from sampling_design.records.budget import Budget
from sampling_design.schedules.opening import PlanClock

LONGER = 2  # how often the time that a plan takes to settle is doubled, at most, until its start is forgotten

LARGER = 1 + 1e-3
"""So many times what a plan leaves of the error in the end counts as settled; what is more is looked at for longer."""

SAME_ANEW = 1e-4  # figures worked out anew may be larger by this share: solvers of other machines


def plan_start(plan: PlanFigures, work: Budget | None = None) -> PlanStart | None:
    """Return from when on a plan keeps its tolerances; None where it keeps none, or where that is not decided.

    Raises BudgetSpentError if that takes more work than there is left.
    """
    if not plan.keeps:
        return None
    if work is not None:
        plan.oracle.count(work)
    bounded = plan.requirement.initial_error is not None
    try:
        sequence, gaps = _settled(plan)
    except (NotDetectableError, UndecidedError):
        return None
    last = max((k for k, ratio in gaps.items() if not ratio <= 1), default=-1) + 1
    if last == len(sequence.times):
        return PlanStart(plan.plant.time_unit, np.inf, np.inf, bounded)
    ratio = max(ratio for k, ratio in gaps.items() if k >= last)
    return PlanStart(plan.plant.time_unit, float(sequence.taken_by[last]), float(ratio), bounded)


def _settled(plan: PlanFigures) -> tuple[SampleSequence, dict[int, float]]:
    """A plan from its start until that is forgotten, and the ratio in each gap and in all that follows."""
    span = settling_time(plan)
    for doubled in range(LONGER + 1):
        sequence, gaps = from_start(plan, span * 2**doubled), dict[int, float]()
        proven_ratio(plan, sequence, gaps)
        if gaps[len(sequence.times) - 1] <= 1:
            break
    return sequence, gaps


@lru_cache(maxsize=4)
def settled_from_start(plan: PlanFigures) -> tuple[float, float]:
    """Since its start, from when on what a plan leaves of the error is at most so many times what it does in the end.

    Infinite where that is not proven.
    """
    span = settling_time(plan)
    found = np.inf, np.inf
    for doubled in range(LONGER + 1):
        try:
            found = settled_since(plan, from_start(plan, span * 2**doubled, plan.clock))
        except (NotDetectableError, UndecidedError):
            break
        if found[1] <= LARGER:
            break
    return found


def from_start(plan: PlanFigures, stop: float, clock: PlanClock = ORDINARY) -> SampleSequence:
    """The plan from its start up to a time, with what is known of the error then."""
    return sequence_from_start(plan, *planned(plan, 0.0, stop, clock), clock)


def start_holds(plan: PlanFigures, found: PlanStart) -> bool:
    """Whether a plan keeps its tolerances from when on a record says, proven anew."""
    anew, tiny = plan_start(plan), GRAIN * plan.schedule.period
    if anew is None or (anew.time_unit, anew.bounded) != (found.time_unit, found.bounded):
        return False
    return anew.from_time <= found.from_time + tiny and anew.ratio <= found.ratio * (1 + SAME_ANEW)
