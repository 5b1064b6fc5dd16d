"""Late samples and lost ones: the accuracy of the disturbed schedule, proven, and so what a plan bears."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.errors import NotDetectableError, UndecidedError
from sampling_design.planning.figures import PlanFigures, PlanRobustness, PlanStart
from sampling_design.planning.problem import WHOLE
from sampling_design.planning.sequence import proven_ratio, settled_since, settling_time, worst_ratio
from sampling_design.planning.sequence_deviation import (
    GRAIN,
    ORDINARY,
    SampleSequence,
    departs_and_returns,
    phase_of,
    planned,
    sequence_from_start,
)
from sampling_design.planning.sequence_system import plan_system, sequence_system
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.budget import Budget
from sampling_design.schedules.opening import PlanClock

LONGER = 2  # how often the time that a plan takes to settle is doubled, at most, until its start is forgotten

LARGER = 1 + 1e-3
"""So many times what a plan leaves of the error in the end counts as settled; what is more is looked at for longer."""

NEAR, NEARLY = 8.0, 1.1
"""Where it leaves at most so many times what it does in the end, the filter that is followed from a plan's start gives
way to the plan's own gains; where these leave at most so many times that, the start is forgotten, where time is short.
"""

SAME_ANEW = 1e-4  # figures worked out anew may be larger by this share: solvers of other machines


def plan_start(plan: PlanFigures, work: Budget | None = None) -> PlanStart | None:
    """Return from when on a plan keeps its tolerances; None where it keeps none, or where that is not decided.

    Raises BudgetSpentError if that takes more work than there is left.
    """
    if not plan.keeps:
        return None
    if work is not None:
        plan.count(work)
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


def settled_from_start(plan: PlanFigures, t: float, *, soon: bool) -> float:
    """How many times what a plan leaves of the error in the end it leaves at most from t after its start on, for ever.

    Infinite where that is not proven; `soon`: by gains that are quickly the plan's own, which prove a little less.
    """
    times, wider = _own_gains_from_start(plan) if soon else (np.zeros(0), np.zeros(0))
    if times.size:
        at = int(np.searchsorted(times, t, side="right")) - 1
        return float(wider[at]) if at >= 0 and wider[at] <= NEARLY else np.inf
    since, found = _filter_from_start(plan)
    return found if t >= since else np.inf


@lru_cache(maxsize=4)
def _own_gains_from_start(plan: PlanFigures) -> tuple[Array, Array]:
    """Times of a plan from its start on, and from each on how many times what it leaves in the end it leaves at most.

    The filter is followed from the start until it is near the plan's own, whose gains then serve.
    """
    nothing = np.zeros(0), np.zeros(0)
    if plan.accuracy is None or plan.deviation is not None:
        return nothing
    sequence, own = from_start(plan, settling_time(plan) * 2 ** (LONGER + 1), plan.clock), plan_system(plan)
    phases = [phase_of(plan.schedule, t) for t in sequence.clock_times.tolist()]
    back = departs_and_returns(plan, sequence)[1]
    for first in (len(own) * 2**k for k in range(LONGER + 2)):
        if first >= len(phases) or back > first or sequence.late or sequence.result_delay is not None:
            return nothing
        try:
            z = sequence_system(plan, sequence.until(first + 1))[1][first].reach
        except UndecidedError:
            return nothing
        if np.all(z <= NEAR * own.reach[phases[first]]):
            break
    wider = left_by_own_gains(own, phases[first:], z)
    return sequence.times[first : first + wider.size], wider


def left_by_own_gains(own: SampledSystem, phases: list[int], z: Array) -> Array:
    """How many times what an endless system leaves it leaves at most at each of its samples, and all that follow.

    After an error within z at the first. By its filter's gains, the error is M z + (what w and noise have added since);
    or it rests on an earlier sample, as `reach` does. Over as many samples as it looks back it is no more than what is
    found here, and so over all that follow.
    """
    M, found, memory = np.eye(z.size), list[Array](), int(own.forgetting.max())
    for phase in phases:
        if found:
            sample = own.samples[phase]
            M = own.gaps[phase - 1].F @ M
            M -= sample.K @ (sample.H @ M)
        bound = own.filter_reach[phase] + np.abs(M) @ z if found else z
        if len(found) >= own.forgetting[phase]:
            bound = np.minimum(bound, own.rests_on(phase, found[-own.forgetting[phase]]))
        found.append(bound)
    left = np.max(np.array(found) / own.reach[phases], axis=1)
    return np.maximum(np.maximum.accumulate(left[::-1])[::-1], 1.0)[: max(left.size - memory, 0)]


@lru_cache(maxsize=4)
def _filter_from_start(plan: PlanFigures) -> tuple[float, float]:
    """Since a plan's start, from when on what it leaves of the error is at most so many times what it does in the end.

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
    if np.isfinite(found.from_time) and found.ratio > 1:
        return False
    return anew.from_time <= found.from_time + tiny and anew.ratio <= found.ratio * (1 + SAME_ANEW)


LATES = 8
"""Delays of one sample that are judged, at most, evenly spread up to the next sample, or up to the first of these."""

MOST_LOST = 2  # samples in a row that are left out, at most


def plan_robustness(plan: PlanFigures, work: Budget | None = None) -> PlanRobustness | None:
    """Return what a plan bears; None where it keeps nothing, or where nothing bounds what a change does.

    Raises BudgetSpentError if that takes more work than there is left.
    """
    if not plan.keeps:
        return None
    N = plan.samples
    plan.count(work or Budget(counted=True))
    try:
        late, step, late_ratio = zip(*(_late(plan, k) for k in range(N)), strict=True)
        single = [_judged(plan, without(plan, k, 1)) for k in range(N)]
        lost = 1 if max(single) <= 1 else 0
        while lost and lost < MOST_LOST and all(proven_ratio(plan, without(plan, k, lost + 1)) <= 1 for k in range(N)):
            lost += 1
    except NotDetectableError:
        return None
    arrays = [freeze(np.array(each, dtype=float)) for each in (late, step, late_ratio, single)]
    return PlanRobustness(
        plan.plant.time_unit, freeze(np.array(plan.schedule.times)), arrays[0], arrays[1], arrays[2], lost, arrays[3]
    )


def robustness_holds(plan: PlanFigures, found: PlanRobustness) -> bool:
    """Whether a plan bears what a record says, proven anew; what trajectories are said to attain, attained anew."""
    if found.time_unit != plan.plant.time_unit or len(found.times) != plan.samples:
        return False
    if not np.allclose(found.times, plan.schedule.times, atol=1e-9):
        return False
    if bool(found.lost) != bool(np.all(found.lost_ratio <= 1)):
        return False
    for k, late in enumerate(found.late.tolist()):
        if late > _room(plan, k) * plan.problem.step * (1 + GRAIN):
            return False
        reached = proven_ratio(plan, delayed(plan, k, late)) if late else plan.ratio
        if not reached <= found.late_ratio[k] * (1 + SAME_ANEW) <= 1 + SAME_ANEW:
            return False
        if not _tried(plan, k, late, float(found.step[k])) or not _lost_holds(plan, k, float(found.lost_ratio[k])):
            return False
    longer = range(2, found.lost + 1)
    return all(proven_ratio(plan, without(plan, k, count)) <= 1 for count in longer for k in range(plan.samples))


def _tried(plan: PlanFigures, k: int, late: float, stride: float) -> bool:
    """Whether delays were judged in such strides of the grid (one step where none is borne), and none below breaks."""
    steps = stride / plan.problem.step
    tries = late / stride if stride else np.inf
    if not (steps >= 1 - GRAIN and tries <= LATES + GRAIN) or (not late and steps > 1 + GRAIN):
        return False
    if abs(steps - round(steps)) > WHOLE or abs(tries - round(tries)) > WHOLE:
        return False
    return not any(_broken(plan, delayed(plan, k, m * stride)) for m in range(1, round(tries)))


def _lost_holds(plan: PlanFigures, k: int, said: float) -> bool:
    """Whether no more than is said is proven without a sample; where that is above 1, no less either."""
    if said <= 1:
        return proven_ratio(plan, without(plan, k, 1)) <= said * (1 + SAME_ANEW)
    anew = _judged(plan, without(plan, k, 1))
    return anew <= said * (1 + SAME_ANEW) and said <= anew * (1 + SAME_ANEW)


def delayed(plan: PlanFigures, k: int, late: float) -> SampleSequence:
    """The plan with sample k so late (before the next one)."""
    t, mask = float(plan.schedule.times[k]) + late, plan.chosen[plan.chosen.any(axis=1)][k]
    return without(plan, k, 1, (np.array([t]), mask[None]))


def without(plan: PlanFigures, k: int, count: int, instead: tuple[Array, Mask] | None = None) -> SampleSequence:
    """The plan without so many samples from sample k on, with others in their place."""
    schedule, N, problem = plan.schedule, plan.samples, plan.problem
    tiny, span = 1e-6 * problem.step, settling_time(plan)
    first = float(schedule.times[k])
    back = float(schedule.times[(k + count) % N]) + (k + count) // N * schedule.period
    before, after = planned(plan, first - span, first - tiny), planned(plan, back - tiny, back + span)
    times, measured = map(np.concatenate, zip(before, *([instead] if instead else []), after, strict=True))
    return SampleSequence.of(problem, times, measured, before[0].size)


def _late(plan: PlanFigures, k: int) -> tuple[float, float, float]:
    """How late a sample may be, the distance of the delays tried, and the accuracy over tolerance there."""
    problem, room = plan.problem, _room(plan, k)
    if room < 1:
        return 0.0, problem.step, plan.ratio
    steps = max(1, room // LATES)
    while True:
        stride, unbroken = steps * problem.step, 0
        while unbroken < min(LATES, room // steps) and not _broken(plan, delayed(plan, k, (unbroken + 1) * stride)):
            unbroken += 1
        kept, reached = _proven_late(plan, k, stride, unbroken)
        if kept or steps == 1:
            return kept * stride, stride, reached
        steps = max(1, steps // LATES)


def _room(plan: PlanFigures, k: int) -> int:
    """How many steps late a sample may be at most, to come before the next one."""
    problem, times = plan.problem, plan.schedule.times
    following = float(times[k + 1]) if k + 1 < plan.samples else float(times[0]) + plan.schedule.period
    ordered = int(problem.timing_tolerance.span / problem.step + WHOLE) + 1  # so many steps apart samples keep order
    return round((following - float(times[k])) / problem.step) - ordered


def _proven_late(plan: PlanFigures, k: int, stride: float, unbroken: int) -> tuple[int, float]:
    """How many strides late a sample may be by proof, of so many, and the accuracy over tolerance there; by halves."""
    kept, reached, m = 0, plan.ratio, unbroken
    while m > kept:
        ratio = proven_ratio(plan, delayed(plan, k, m * stride))
        if ratio <= 1:
            kept, reached = m, ratio
        else:
            unbroken = m - 1
        m = (kept + unbroken + 1) // 2
    return kept, reached


def _broken(plan: PlanFigures, sequence: SampleSequence) -> bool:
    """Whether a trajectory on the grid breaks a tolerance before the first sample that is another one, or after it."""
    return worst_ratio(plan, sequence, 1.0, float(sequence.times[sequence.first + 1]), closely=False) > 1


def _judged(plan: PlanFigures, sequence: SampleSequence) -> float:
    """Accuracy over tolerance: proven up to 1, else as a trajectory on the grid attains it, or a bound."""
    ratio = np.inf if _broken(plan, sequence) else proven_ratio(plan, sequence)
    if ratio <= 1:
        return ratio
    until = float(sequence.times[-1]) - plan.schedule.period
    attained = worst_ratio(plan, sequence, np.inf, until, closely=False)
    return attained if attained > 1 else proven_ratio(plan, sequence, {})  # of all gaps: the first above 1 ended it
