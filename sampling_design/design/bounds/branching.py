"""The upper bound narrowed by branching: boxes of zones, the one with the largest bound cut in two again and again.

First the schedules are told apart by the first sample that comes late by a share of the mean gap (or early,
if the zones count from the sample after which all come early). What is left is nearly even; in the others, the window
before the late sample sees little.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from sampling_design.design.bounds.evidence import BoundPart, UpperBound, chosen_in, local_part, ordered_part, zone_part
from sampling_design.design.bounds.tied_windows import growth_rate
from sampling_design.design.bounds.zone_bound import NARROW, matters
from sampling_design.design.bounds.zones import Side, flow_of, halves, regions, sides, tightened, zoned
from sampling_design.design.problem.design_problem import DesignProblem, affordable_choices
from sampling_design.design.problem.feasible import changed
from sampling_design.design.problem.interrupt import DesignInterrupt
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget

ValueProgress = Callable[[float, float], None]  # Called with the fraction done and the bound
_FIRST_CUT = 0.3  # of a mean gap: from there on a sample counts as late in the first cuts
_FEW_STATES = 6  # beyond, from sooner on: what is seen is of so high a degree in the differences of times
_MET = 1e-3  # how near the target a bound ends all cuts, relative
_SMALL = 0.8  # of a mean gap: zones no wider than that are bounded by windows that follow their samples too
_TINY_BOX = 0.1  # of a mean gap: by these alone
_STEEP = 1.0  # exponent by which sigma^2 grows over a zone: from there on only such windows say much
_CLEARLY = 0.9  # of the relaxation's bound: below, the parts of the box need no relaxation
_LOOK, _HELPS = 20, 0.05  # cuts after which a wide gap must have fallen by that share of itself
_LOCAL_COST = 0.06  # of a cut: such a bound takes a fraction of a relaxation's time
_INHERITS = 0.999  # of the wider box's bound: where a box gains less, the multipliers it came from are tried too


class _ZoneBox(NamedTuple):
    """A box of zones with its bound, where to cut it next, and the windows that mattered.

    `small` where only windows that follow their samples bound it, `cost` in relaxations.
    """

    part: BoundPart
    place: int  # the sample whose zone is cut next, `at` that time
    at: float
    width: float
    hints: Array
    small: bool
    cost: float
    problem: DesignProblem


def narrowed(
    problem: DesignProblem,
    bound: UpperBound,
    target: float,
    steps: int,
    budget: Budget = ENDLESS,
    progress: ValueProgress | None = None,
    most: int | None = None,
    near: float = 0.0,
) -> UpperBound:
    """Cut boxes until the bound is within `_MET` of `target`, `steps` cuts are made or time is up.

    Where the bound is `near` is said, nothing is cut once it is that share above the target, and up to `most` cuts are
    made before, as long as it comes nearer. An interrupt is raised as `DesignInterrupt`, with the bound held by then.
    Nothing is cut where there are more samples than cuts: each sample wants one at least, and the plain
    bounds are near anyway where samples are many. Boxes know no price of cost: under a limit each choice of what the
    samples measure is bounded by itself, unless there are too many.
    """
    if steps < problem.samples or not zoned(problem) or bound.value <= target * (1 + _MET):
        return bound
    choices = affordable_choices(problem) if problem.is_costly else []
    posed = [changed(problem, {"chosen": chosen}) for chosen in choices]
    if problem.is_costly and not posed:
        return bound
    try:
        tree = _rooted(problem, posed or [problem], bound, target * (1 + _MET), budget, progress)
    except KeyboardInterrupt:
        raise DesignInterrupt(bound) from None
    if tree is None:
        return bound
    try:
        _cut_on(tree, target, steps, most, near, progress)
    except KeyboardInterrupt:
        raise DesignInterrupt(tree.bound(bound)) from None
    return tree.bound(bound)


def _cut_on(
    tree: _ZoneBoxTree, target: float, steps: int, most: int | None, near: float, progress: ValueProgress | None
) -> None:
    """Cut the box with the largest bound again and again."""
    limit, looked = float(steps), (0.0, np.inf)
    while not tree.budget.over:
        away = tree.value / target - 1 if target > 0 else 0.0
        if tree.spent >= looked[0] + _LOOK:
            looked, helps = (tree.spent, away), away <= (1 - _HELPS) * looked[1]
            if tree.spent >= steps and not helps:
                break
        if tree.spent >= limit:
            limit = float(max(steps, most or 0))
        if progress:
            progress(min(tree.spent / limit, 1.0), tree.value)
        if tree.spent >= limit or away <= near or not tree.cut():
            break


def _rooted(
    problem: DesignProblem,
    posed: list[DesignProblem],
    bound: UpperBound,
    enough: float,
    budget: Budget,
    progress: ValueProgress | None,
) -> _ZoneBoxTree | None:
    """The tree before any cut, counted from the sample that promises most; None where time is up.

    `posed` are the problems that are one of them each: the problem itself, or its choices of what is measured.
    """
    best: list[_ZoneBox] | None = None
    tried = (bound.parts[0].side,) if bound.method == "zones" else sides(problem)
    for side in tried[:1] if len(posed) > 1 else tried:
        roots = []
        for case, region in product(posed, regions(problem, side)):
            if budget.over:
                return None
            root = _box(case, region, side, enough, budget=budget)
            roots += [] if root is None else [root]
        if roots and (best is None or _largest(roots) < _largest(best)):
            best = roots
    if best is None or budget.over:
        return None
    tree = _ZoneBoxTree(enough, budget)
    for root in best:
        counted = problem.least_shift == 0 and root.part.side != "sorted" and len(posed) == 1
        if counted and root.part.method != "ordered":
            tree.split_by_lateness(root, progress)
        else:
            tree.keep(root)
    return tree


def _largest(boxes: list[_ZoneBox]) -> float:
    return max(box.part.value for box in boxes)


class _ZoneBoxTree:
    """Boxes that together hold every schedule: open ones as a heap, and parts whose bound is low enough."""

    def __init__(self, enough: float, budget: Budget = ENDLESS) -> None:
        self.enough, self.budget = enough, budget
        self.open: list[tuple[float, int, _ZoneBox]] = []
        self.closed: list[BoundPart] = []
        self.made, self.spent = 0, 0.0

    @property
    def parts(self) -> tuple[BoundPart, ...]:
        """All parts; together they cover every schedule."""
        return (*self.closed, *(box.part for *_, box in self.open))

    @property
    def value(self) -> float:
        """The bound of all parts."""
        return max(part.value for part in self.parts)

    def bound(self, known: UpperBound) -> UpperBound:
        """The bound of all parts, unless the one that is known is smaller."""
        return UpperBound(self.value, self.parts) if self.value < known.value else known

    def split_by_lateness(self, root: _ZoneBox, progress: ValueProgress | None) -> None:
        """Cut the root by the first sample that comes late (or early) by more than a share of the mean gap."""
        rest, late = root.part.zones, root.part.side == "late"
        mean, n = root.problem.period / root.problem.samples, root.problem.plant.n_states
        share = _FIRST_CUT * min(1.0, (_FEW_STATES / n) ** 2)
        for index in range(1, len(rest)):
            cut = (index + (share if late else -share)) * mean
            if self.budget.over:
                break
            if progress:  # until the last one is bounded the root's bound holds
                progress(0.0, root.part.value)
            if rest[index, 0] + NARROW * mean < cut < rest[index, 1] - NARROW * mean:
                below, above = halves(rest, index, cut)
                self.add(above if late else below, root)
                rest = below if late else above
        self.add(rest, root)

    def cut(self) -> bool:
        """Cut the box with the largest bound in two; False where nothing is left to gain."""
        if not self.open or -self.open[0][0] <= self.enough:
            return False
        first = self.open[0]
        box = first[2]
        if box.width <= NARROW * box.problem.period / box.problem.samples:
            return False
        made = [self.bounded(half, box) for half in halves(box.part.zones, box.place, box.at)]
        for half in made:  # first the halves, then the whole is left out: an interrupt leaves no schedule uncovered
            if half is not None:
                self.keep(half)
        self.open.remove(first)
        heapq.heapify(self.open)
        return True

    def add(self, zones: Array, wider: _ZoneBox) -> None:
        """Bound the schedules in `zones`, part of the `wider` box, and keep them open where that is not enough."""
        box = self.bounded(zones, wider)
        if box is not None:
            self.keep(box)

    def bounded(self, zones: Array, wider: _ZoneBox) -> _ZoneBox | None:
        """The schedules in `zones`, part of the `wider` box, bounded; None where there are none."""
        box = _box(wider.problem, zones, wider.part.side, self.enough, wider, self.budget)
        self.spent += 0.0 if box is None else box.cost
        return box

    def keep(self, box: _ZoneBox) -> None:
        """Keep a bounded box, open where its bound is not enough."""
        self.made += 1
        if box.part.value > self.enough:
            heapq.heappush(self.open, (-box.part.value, self.made, box))
        else:
            self.closed.append(box.part)


def _box(
    problem: DesignProblem,
    zones: Array,
    side: Side,
    aim: float,
    wider: _ZoneBox | None = None,
    budget: Budget = ENDLESS,
) -> _ZoneBox | None:
    """The box with the smaller of its own bounds and that of the wider box's multipliers; None if it is empty."""
    tight = tightened(problem, zones, side)
    if tight is None:
        return None
    if flow_of(problem) is not None:
        near = aim if wider is None else (aim + wider.part.value) / 2
        by_order, at = ordered_part(problem, zones, side, near, budget)
        return _ZoneBox(_inherited(problem, by_order, wider), *at, np.zeros(0), small=False, cost=0.5, problem=problem)
    found: list[tuple[BoundPart, int, float, float]] = []
    widths = tight[:, 1] - tight[:, 0]
    size = float(widths.max()) * problem.samples / problem.period
    grown = 2 * growth_rate(problem) * float(widths.max())
    local = local_part(problem, zones, side, aim, budget) if size <= _SMALL or grown > _STEEP else None
    if local is not None:
        part, index = local
        found.append((part, index, float(tight[index].mean()), float(widths[index])))
        if part.value <= aim:
            return _ZoneBox(*found[0], np.zeros(0), small=True, cost=_LOCAL_COST, problem=problem)
    hints = np.zeros(0) if wider is None else wider.hints
    small = wider is not None and (wider.small or size <= _TINY_BOX or grown > _STEEP)
    if not small:
        made = zone_part(problem, zones, side, None if wider is None else hints, budget)
        if made is None:
            return None
        found.append((made[0], *made[2]))
        hints = matters(problem, made[1])
    if not found:
        index = int(np.argmax(widths))
        nothing = BoundPart("zones", np.zeros(0), np.zeros((0, 1, 1)), zones, side=side, chosen=chosen_in(problem))
        found.append((nothing, index, float(tight[index].mean()), float(widths[index])))
    part, index, cut, width = min(found, key=lambda one: one[0].value)
    part = _inherited(problem, part, wider)
    small = small or (part.method == "local" and part.value < _CLEARLY * found[-1][0].value)
    cost = (0.5 if len(found) == 2 or not small else 0.0) + _LOCAL_COST
    return _ZoneBox(part, index, cut, width, hints, small, cost, problem)


def _inherited(problem: DesignProblem, part: BoundPart, wider: _ZoneBox | None) -> BoundPart:
    """The part, or what the multipliers of the wider box prove of its zones where it gains little on that."""
    if wider is None or part.value <= _INHERITS * wider.part.value:
        return part
    return min(part, replace(wider.part, zones=part.zones).judged(problem), key=lambda p: p.value)
