"""Which goal reaches its tolerance first if samples leave a plan, and when: judged in floats, on the raster."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.sequence import window_after
from sampling_design.planning.spread_sequence import SampleSequence, spread_of


@dataclass(frozen=True)
class GoalDue:
    """The goal that keeps a sample from being later.

    Attributes
    ----------
    goal : str
    time : float
        When it reaches its tolerance, or comes nearest to it [the plant's time unit] since the start of the plan.
    ratio : float
        Accuracy over tolerance then, attained by a motion on the raster or by the filter: 1 and more where it breaks.
    """

    goal: str
    time: float
    ratio: float

    @property
    def breaks(self) -> bool:
        """Whether the tolerance is reached; else it is only nearer to it than what is proven."""
        return self.ratio >= 1


def first_due(plan: PlanFigures, sequence: SampleSequence, until: float) -> GoalDue | None:
    """The first goal to reach its tolerance in a sequence before a time; if none does, the one that comes nearest."""
    nearest: GoalDue | None = None
    firsts = []
    for found in (_bounded(plan, sequence, until), _spread(plan, sequence, until)):
        for due in found:
            if due.breaks:
                firsts.append(due)
                break
            nearest = due if nearest is None or due.ratio > nearest.ratio else nearest
    return min(firsts, key=lambda due: due.time) if firsts else nearest


def _bounded(plan: PlanFigures, sequence: SampleSequence, until: float) -> Iterator[GoalDue]:
    """Of the goals that are guaranteed, the worst of each gap, or what is reached first there."""
    oracle = plan.oracle
    goals = [g for g, goal in enumerate(oracle.problem.goals) if not goal.spread]
    for k in range(max(sequence.first - 1, 0), len(sequence.times) - 1):
        if not goals or sequence.times[k] >= until:
            return
        window, last, length = window_after(oracle, sequence, k)
        found = []
        for g in goals:
            looks = dict(sorted(oracle.looked(window, g, last, length).items()))
            broken = [offset for offset, ratio in looks.items() if ratio >= 1]
            at = broken[0] if broken else max(looks, key=lambda offset: looks[offset], default=0)
            good = max((offset for offset in looks if offset < at), default=at)
            while broken and at - good > 1 and oracle.problem.goals[g].at == "all times":
                middle = (good + at) // 2
                looks[middle] = oracle.reach(window, middle, g)
                good, at = (good, middle) if looks[middle] >= 1 else (middle, at)
            if looks:
                found.append(GoalDue(plan.goals[g].name, (last + at) * oracle.problem.step, float(looks[at])))
        yield from sorted(found, key=lambda due: (not due.breaks, due.time))


def _spread(plan: PlanFigures, sequence: SampleSequence, until: float) -> Iterator[GoalDue]:
    """The same of standard deviations."""
    if plan.deviation is None:
        return
    for k, goal, offsets, ratios in spread_of(plan).gaps(sequence, until):
        broken = np.flatnonzero(ratios >= 1)
        at = int(broken[0]) if broken.size else int(np.argmax(ratios))
        yield GoalDue(goal.name, float(sequence.times[k] + offsets[at]), float(ratios[at]))
