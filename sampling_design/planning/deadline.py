"""When goals reach their tolerances if samples leave a plan, and from when on they keep them again: in floats."""

from __future__ import annotations

from collections.abc import Container, Iterator
from dataclasses import dataclass, replace
from itertools import chain, groupby, pairwise

import numpy as np

from sampling_design.planning.accuracy_oracle import GridSpan
from sampling_design.planning.adversary_program import GridWindow
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.problem import WHOLE
from sampling_design.planning.sequence import is_past, judged_at_once, longest_out, span_begin, spans_of, window_after
from sampling_design.planning.sequence_deviation import SampleSequence, departs_and_returns, sequence_filter
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget


@dataclass(frozen=True)
class GoalDeadline:
    """A goal, and when it reaches its tolerance: what keeps a sample from being later.

    Attributes
    ----------
    goal : str
    time : float
        When it reaches its tolerance, or comes nearest to it [the plant's time unit] since the start of the plan.
    ratio : float
        Accuracy over tolerance then, attained by a trajectory on the grid or by the filter: 1 and more where it breaks.
    """

    goal: str
    time: float
    ratio: float

    @property
    def breaks(self) -> bool:
        """Whether the tolerance is reached; else it is only nearer to it than what is proven."""
        return self.ratio >= 1


@dataclass(frozen=True, eq=False)
class GapRatios:
    """One goal in gap k: times that were looked at, in order, and its ratios to the tolerance."""

    k: int
    goal: str
    times: Array
    ratios: Array
    end: float  # when the gap is over

    def first(self, level: float = 1.0) -> GoalDeadline:
        """The first look at or above a level; if there is none, the worst."""
        above = np.flatnonzero(self.ratios >= level)
        at = int(above[0]) if above.size else int(np.argmax(self.ratios))
        return GoalDeadline(self.goal, float(self.times[at]), float(self.ratios[at]))


def first_deadline(plan: PlanFigures, sequence: SampleSequence, until: float) -> GoalDeadline | None:
    """The first goal to reach its tolerance in a sequence before a time; if none does, the one that comes nearest."""
    nearest: GoalDeadline | None = None
    firsts: list[GoalDeadline] = []
    for judged in (_bounded(plan, sequence, until, 1.0), _deviations(plan, sequence, until)):
        for _, gap in groupby(judged, key=lambda each: each.k):
            found = [each.first() for each in gap]
            breaks = [deadline for deadline in found if deadline.breaks]
            if breaks:
                firsts += breaks
                break
            nearest = max([*found, *([nearest] if nearest else [])], key=lambda deadline: deadline.ratio)
    return min(firsts, key=lambda deadline: deadline.time) if firsts else nearest


def kept_from(
    plan: PlanFigures,
    sequence: SampleSequence,
    until: float,
    level: float,
    latest: float = np.inf,
    budget: Budget = ENDLESS,
) -> float:
    """From when on every goal stays at most so high; infinite if that is later than `latest`, or the budget is over.

    Where a goal is too high up to the end of a gap, from the sample there on.
    """
    kept = max(sequence.since, float(sequence.times[sequence.start]))
    for gap in chain(_deviations(plan, sequence, until), _bounded(plan, sequence, until, level)):
        above = np.flatnonzero(gap.ratios > level)
        if above.size:
            after = int(above[-1]) + 1
            kept = max(kept, float(gap.times[after] if after < gap.times.size else gap.end))
        if kept > latest or budget.over:
            return np.inf
    return kept


def reached_at(
    plan: PlanFigures, history: SampleSequence, since: float, until: float, level: float, budget: Budget = ENDLESS
) -> float:
    """When the first goal is above a level if nothing more is measured; infinite if none is before a time.

    Once the budget is over, of the goals that were looked at by then.
    """
    past = _ending(history, max(until, float(history.times[-1]) + WHOLE * plan.problem.step), since)
    ahead = spans_of(plan, past)
    if past.result_delay is None:
        ahead = [span for span in ahead if span.last == len(past.times) - 2]
    judged = [e for i, span in enumerate(ahead) if not budget.over for e in _in_gap(plan, past, i, span, level)]
    judged += _deviations(plan, past, np.inf)
    over = [float(each.times[each.ratios > level][0]) for each in judged if np.any(each.ratios > level)]
    return min(over, default=np.inf)


def _ending(history: SampleSequence, end: float, since: float = -np.inf) -> SampleSequence:
    """What was measured, and a last gap."""
    times, measured = np.append(history.times, end), np.concatenate([history.measured, history.measured[-1:]])
    return replace(history, times=times, measured=measured, since=since)


def exceeded_since(
    plan: PlanFigures, sequence: SampleSequence, now: float, within: Container[str] = ()
) -> GoalDeadline | None:
    """The goal that has been above its tolerance for longest without a break until now, and since when; None if none.

    `ratio` is that of the last look. The sequence is what was measured until now. `within`: goals that are not above
    it now, which looks on the grid do not tell: a result that is in just now counts after it.
    """
    past = _ending(sequence, max(now, float(sequence.times[-1]) + WHOLE * plan.problem.step))
    deviations = {k: list(judged) for k, judged in groupby(_deviations(plan, past, np.inf), key=lambda each: each.k)}
    pending = {goal.name for goal in plan.goals if goal.name not in within}
    found: dict[str, GoalDeadline] = {}
    for i, span in [*enumerate(spans_of(plan, past))][::-1]:
        for each in [*_in_gap(plan, past, i, span, 1.0), *deviations.get(span.last, ())]:
            if each.goal not in pending:
                continue
            kept = np.flatnonzero(each.ratios < 1)
            after = int(kept[-1]) + 1 if kept.size else 0
            if after < each.times.size:
                ratio = found[each.goal].ratio if each.goal in found else float(each.ratios[-1])
                found[each.goal] = GoalDeadline(each.goal, float(each.times[after]), ratio)
            if kept.size:
                pending.remove(each.goal)
        if not pending:
            break
    return min(found.values(), key=lambda deadline: deadline.time, default=None)


def _bounded(plan: PlanFigures, sequence: SampleSequence, until: float, level: float) -> Iterator[GapRatios]:
    """Of the goals that are guaranteed, gap by gap, until what a change does has faded below a level."""
    worst = before = 0.0
    back, out, count = departs_and_returns(plan, sequence)[1], longest_out(plan), judged_at_once(plan)
    for i, span in enumerate(spans_of(plan, sequence)):
        if span_begin(plan, sequence, span) >= until + out:
            return
        for each in _in_gap(plan, sequence, i, span, level):
            worst = max(worst, float(each.ratios.max()))
            yield each
        if i % count == count - 1:
            if worst <= min(before, level) and is_past(plan, sequence, span, back):
                return
            worst, before = 0.0, worst


def _in_gap(plan: PlanFigures, sequence: SampleSequence, i: int, span: GridSpan, level: float) -> Iterator[GapRatios]:
    """The same of one gap; where the level is crossed, to the step."""
    oracle = plan.oracle
    goals = oracle.problem.guaranteed
    if not goals:
        return
    window, last = window_after(oracle, sequence, span)
    for g in goals:
        judged = oracle.ratios_at(window, g, last, span.length, begin=span.begin)
        if not judged:
            continue
        if oracle.problem.goals[g].at == "all times":
            _to_the_step(plan, window, g, judged, level)
        offsets = np.array(sorted(judged))
        ratios = np.array([judged[offset] for offset in offsets.tolist()])
        yield GapRatios(i, plan.goals[g].name, (last + offsets) * oracle.problem.step, ratios, span.end)


def _to_the_step(plan: PlanFigures, window: GridWindow, g: int, judged: dict[float, float], level: float) -> None:
    """Look between neighbours on both sides of a level until they are a step apart."""
    offsets = sorted(judged)
    for low, high in pairwise(offsets):
        sides = (judged[low] >= level, judged[high] >= level)
        while sides[0] != sides[1] and high - low > 1:
            middle = -(-(low + high) // 2)  # the last may end within a step
            judged[middle] = plan.oracle.reach(window, middle, g)
            low, high = (middle, high) if (judged[middle] >= level) == sides[0] else (low, middle)


def _deviations(plan: PlanFigures, sequence: SampleSequence, until: float) -> Iterator[GapRatios]:
    """The same of standard deviations."""
    if plan.deviation is None:
        return
    for k, goal, offsets, ratios in sequence_filter(plan).gaps(sequence, until):
        yield GapRatios(k, goal.name, float(sequence.times[k]) + offsets, ratios, float(sequence.times[k + 1]))
