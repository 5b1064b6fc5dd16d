"""What samples can measure within a limit: every choice by enumeration, and a bound for each of them."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.bounds.evidence import BoundPart, zone_part
from sampling_design.design.bounds.zones import tightened
from sampling_design.design.problem.design_problem import DesignProblem, affordable_choices
from sampling_design.design.problem.feasible import changed
from sampling_design.design.search.costs import affordable
from sampling_design.design.search.local_search import FoundSchedule
from tests.cases import few
from tests.oracles.design import random_schedule, window_sigma_scan

OSCILLATOR = np.array([[0.0, 1.0], [-1.0, 0.0]])
TURN = 2 * np.pi


def problem(costs, limit, samples, period=TURN, **more):
    plant = Plant(OSCILLATOR, np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])[: len(costs)])
    bare = {"forbidden": np.zeros((0, 2)), "fixed": np.zeros(0), "available": (None,) * len(costs), **more}
    return DesignProblem(plant, period, period, 0.1, samples, costs=np.array(costs), cost_limit=limit, **bare)


@pytest.mark.parametrize(
    ("costs", "limit", "samples"),
    [([1.0, 3.0], 8.0, 4), ([2.0, 1.0], 7.0, 3), ([0.0, 1.0], 2.0, 4), ([1.0, 2.0, 4.0], 9.0, 3), ([0.1, 0.2], 0.9, 4)],
)
def test_every_affordable_choice_is_part_of_one_that_is_and_that_cannot_be_enlarged(costs, limit, samples):
    found = affordable_choices(problem(costs, limit, samples))
    lines = [
        np.array(line) for line in product([s for s in product((0, 1), repeat=len(costs)) if any(s)], repeat=samples)
    ]
    within = [line.astype(bool) for line in lines if (line * costs).sum() <= limit * (1 + 1e-12)]
    largest = [a for a in within if not any(np.all(a <= b) and np.any(a != b) for b in within)]
    assert {a.tobytes() for a in found} == {a.tobytes() for a in largest}
    assert len(found) == len(largest) > 0


def test_too_many_choices_are_not_looked_at():
    assert affordable_choices(problem([1.0, 1.0], 12.0, 9)) == []
    assert affordable_choices(problem([1.0] * 3, 90.0, 60)) == []
    assert affordable_choices(replace(problem([1.0, 1.0], 12.0, 9), costs=None)) == []


LIMITED = Requirement(
    window=TURN, samples=4, spacing=0.02 * TURN, sensors={"y1": {"price": 1.0}, "y2": {"price": 3.0}}, cost_limit=8.0
)


@pytest.fixture(scope="module")
def limited():
    return design_schedule(Plant(OSCILLATOR, np.eye(2)), LIMITED, starts=1)


def test_a_limit_on_cost_is_designed_and_bounded_to_the_last_digits(limited):
    """Five rows of length one have sigma^2 = 5/2 at most; two of them at right angles and a star of three reach it,
    where four samples alone would see 2 and no exchange of two measurements leads from there to here."""
    assert limited.sigma == pytest.approx(np.sqrt(2.5), rel=1e-3)
    assert limited.upper_bound == pytest.approx(np.sqrt(2.5), rel=1e-3)
    assert limited.schedule.outputs.sum() == 5
    assert limited.verify()


def test_a_choice_left_out_exchanged_or_forged_proves_nothing(limited):
    bound, case = limited.bound, limited.problem
    assert bound.value_for(case) == limited.upper_bound
    first = bound.parts[0]
    for parts in (
        bound.parts[1:],
        (replace(first, chosen=~first.chosen), *bound.parts[1:]),
        (replace(first, chosen=first.chosen[:2]), *bound.parts[1:]),
        (replace(first, chosen=np.zeros((0, 0), dtype=bool)), *bound.parts[1:]),
    ):
        assert replace(bound, parts=parts).value_for(case) == np.inf
    assert bound.value_for(changed(case, {"cost_limit": 9.0})) == np.inf  # more money, other choices


@pytest.mark.parametrize("side", few(["late", "sorted"], 1))
def test_the_bound_of_a_box_with_a_choice_holds_its_schedules(side):
    """Random schedules of random boxes, each measuring what the choice says where that is there, by a plain scan."""
    rng, A = np.random.default_rng(5), np.array([[0.1, 1.0, 0.0], [-1.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    C, P = np.array([[1.0, 0.0, 1.0], [0.3, 1.0, 0.0]]), 4.0
    there = (None, None) if side == "late" else (None, np.array([[0.0, 3.3]]))
    closed = np.zeros((0, 2)) if side == "late" else np.array([[1.0, 1.2]])
    case = DesignProblem(Plant(A, C), 5.0, P, 0.1, 4, closed, np.zeros(0), there, np.ones(2), 5.0)
    held = 0
    for chosen in affordable_choices(case)[::5]:
        posed = changed(case, {"chosen": chosen})
        times = random_schedule(rng, P, 0.1, 4)
        if side == "late":
            origin = int(np.argmin(times - np.arange(4) * P / 4))
            times = np.concatenate([times[origin:], times[:origin] + P]) - times[origin]
        zones = tightened(posed, np.stack([times - 0.05, times + 0.3], axis=1), side)
        seen = posed.measured(times)
        if zones is None or not seen.any(axis=1).all():
            continue
        order = np.argsort(np.mod(times, P))
        sigma = window_sigma_scan(A, C, np.mod(times, P)[order], P, 5.0, places=0, mask=seen[order])
        part, *_ = zone_part(posed, zones, side)
        assert sigma <= part.value * (1 + 1e-9)
        assert part.value <= BoundPart("zones", part.starts, part.weights, part.zones, side=side).value_for(case) * (
            1 + 1e-9
        )  # whatever is measured sees no less
        held += 1
    assert held >= 2


def test_choices_are_looked_at_until_nothing_is_left_to_gain():
    case = problem([1.0, 3.0], 8.0, 4)
    start = FoundSchedule(np.arange(4) * TURN / 4, 0.0, (), True)

    class Nothing:
        times, weights = np.arange(40) * TURN / 40, np.full(40, 0.1)

    few, _ = affordable(case, start, Nothing, enough=1.0)
    every, chosen = affordable(case, start, Nothing)
    assert not [trial for trial in few.trials if "enumerated" in trial.start]
    assert [trial for trial in every.trials if "enumerated" in trial.start]
    assert every.sigma == pytest.approx(np.sqrt(2.5), rel=1e-6)
    assert chosen.sum() == 5


@pytest.mark.parametrize(("fixed", "period"), few([([0.4, 2.9, 3.6], 4.0), ([1.3], 1.1), ([], 1.1)], 1))
def test_where_only_what_is_measured_is_left_to_choose_the_bound_is_reached(fixed, period):
    """Times that are all fixed, or one sample, and money for some of the outputs: every choice by a plain scan."""
    A, C, k = np.array([[0.1, 1.0], [-1.0, 0.1]]), np.array([[1.0, 0.2], [0.0, 0.7]]), max(len(fixed), 1)
    asked = Requirement(
        window=5.0,
        period=period,
        samples=k,
        spacing=0.1,
        fixed=np.mod(fixed, period),
        sensors={"y1": {"price": 1.0}, "y2": {"price": 2.0}},
        cost_limit=2.5 * k - 0.5,
    )
    design = design_schedule(Plant(A, C), asked)
    times, case = np.sort(np.mod(fixed or [0.0], period)), design.problem
    masks = [np.array(line, dtype=bool) for line in product([(1, 0), (0, 1), (1, 1)], repeat=k)]
    paid = [mask for mask in masks if (mask * [1.0, 2.0]).sum() <= 2.5 * k - 0.5]
    best = max(window_sigma_scan(A, C, times, period, 5.0, mask=mask) for mask in paid)
    assert best * (1 - 1e-9) <= design.upper_bound <= best * (1 + 1e-3)
    assert design.gap < 1e-3
    assert design.verify()
    parts = design.bound.parts
    assert design.bound.value_for(case) == design.upper_bound
    assert (
        replace(design.bound, parts=(*parts[1:], replace(parts[0], chosen=~parts[0].chosen))).value_for(case) == np.inf
    )
    assert replace(design.bound, parts=(*parts, parts[0])).value_for(case) == np.inf


def test_what_samples_measure_is_no_part_of_a_bound_that_does_not_tell_them_apart():
    case = problem([1.0, 3.0], 8.0, 4)
    part = BoundPart("placed", np.zeros(1), np.eye(2)[None], chosen=affordable_choices(case)[0])
    assert part.value_for(case) == np.inf
    assert 0 < replace(part, chosen=np.zeros((0, 0), dtype=bool)).value_for(case) < np.inf
