"""Law: a design in opening hours is as good as its hours allow. Its sigma is no less than the search has seen, than any
schedule of a one-hour grid has, or than that of a stricter requirement; the bound is near; and a shift of all hours
shifts the schedule and changes nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from sampling_design import Plant, Requirement, design_schedule
from tests.cases import few
from tests.oracles.requirements import Problem, best_hours, random_hours, sigma_of, turned_spans

SHORT_OF_A_GRID = 0.05
GAP = 0.05
SAME = 1e-6
AS_GOOD = 1e-3
FEW = (3, 11, 39)
"""The last one closes for half a period, under windows of one and a half: a window that begins just after the last
sample before closing does not hold the one at opening yet, however short before closing that sample is."""
MANY = range(58)
BLOOD = Problem(
    block_diag([[0.0]], np.pi / 12 * np.array([[0.0, 1.0], [-1.0, 0.0]])),
    np.array([[1.0, 1.0, 0.0]]),
    window=24.0,
    period=24.0,
    spacing=1.0,
    samples=4,
    forbidden=[[0.0, 7.0], [22.0, 24.0]],
    available=[None],
    costs=[0.0],
)
"""A level and a daily rhythm, measured between 7 and 22 o'clock: the first hour."""


MADE = {}
"""Designs of this process, by plant and requirement: several laws ask for the same."""


def designed(problem, **changes):
    asked = Requirement(**(problem.requirement | changes))
    key = repr((problem.A.tolist(), problem.C.tolist(), asked.to_dict()))
    if key not in MADE:
        MADE[key] = design_schedule(Plant(problem.A, problem.C), asked, rtol=1e-7)
    return MADE[key]


def shifted(problem, shift):
    """The arguments of the requirement with all its hours later by `shift`."""
    outputs = {
        f"y{i + 1}": {} if spans is None else {"available": turned_spans(spans, shift, problem.period)}
        for i, spans in enumerate(problem.available)
    }
    fixed = sorted((t + shift) % problem.period for t in problem.fixed)
    return {"forbidden": turned_spans(problem.forbidden, shift, problem.period), "fixed": fixed, "sensors": outputs}


def judged(problem):
    """The design, after everything that holds for one design alone, the bound's distance left out."""
    design = designed(problem)
    assert design.status == "complete"
    assert design.sigma >= max(trial["after"] for trial in design.history) * (1 - SAME)
    times = design.schedule.times
    mask = problem.open(times) if design.schedule.outputs is None else design.schedule.outputs
    assert problem.open(times).any(axis=1).all()
    assert sigma_of(problem, times, mask) == pytest.approx(design.sigma, rel=SAME)
    best, _ = best_hours(problem)
    assert best <= design.upper_bound * (1 + SAME)
    assert design.sigma >= best * (1 - SHORT_OF_A_GRID)
    return design


@pytest.mark.long
@pytest.mark.parametrize("seed", few(FEW, 2))
def test_no_schedule_of_whole_hours_is_far_above_the_design(seed):
    assert judged(random_hours(np.random.default_rng(seed))).gap <= GAP


@pytest.mark.long
@pytest.mark.parametrize("seed", MANY)
def test_no_schedule_of_whole_hours_is_far_above_any_design(seed):
    assert judged(random_hours(np.random.default_rng(seed))).gap <= GAP


@pytest.mark.parametrize("seed", few([39, 7, 18, 21, 33], 0))
def test_no_sample_at_the_ends_of_hours_beats_the_bound(seed):
    problem = random_hours(np.random.default_rng(seed))
    design, rng, P = designed(problem), np.random.default_rng([seed, 2]), problem.period
    begins, ends = design.problem.intervals.T
    places = np.concatenate([begins, *(ends - beside * P for beside in (1e-10, 1e-9, 3e-9))])
    tried = 0
    for _ in range(60):
        drawn = rng.choice(places, len(design.schedule.times))
        times = np.where(rng.uniform(size=drawn.size) < 0.5, drawn, design.schedule.times)
        times = np.sort(np.concatenate([problem.fixed, times])[: drawn.size]) if problem.fixed else np.sort(times)
        mask = problem.open(times)
        if np.diff(np.append(times, times[0] + P)).min() >= problem.spacing and mask.any(axis=1).all():
            tried += 1
            assert sigma_of(problem, times, mask) <= design.upper_bound * (1 + SAME)
    assert tried > 3


@pytest.mark.long
@pytest.mark.parametrize(("seed", "shift"), few([(7, 9.0), (12, 3.7)], 0))
def test_a_shift_of_all_hours_shifts_the_schedule(seed, shift):
    problem = random_hours(np.random.default_rng(seed))
    first, other = designed(problem), designed(problem, **shifted(problem, shift))
    assert other.sigma == pytest.approx(first.sigma, rel=SAME)
    assert other.upper_bound == pytest.approx(first.upper_bound, rel=SAME)
    assert other.bound.value_for(other.problem) == pytest.approx(other.bound.value)
    moved = np.sort(np.mod(first.schedule.times + shift, problem.period))
    np.testing.assert_allclose(other.schedule.times, moved, atol=1e-5)


@pytest.mark.long
def test_the_first_hour_is_designed_for_what_its_hours_allow():
    assert designed(BLOOD).sigma > 1.277
    assert judged(replace(BLOOD, samples=3)).sigma > 1.104


def loosened(rng, problem):
    """The same with one demand less: a smaller spacing, one more sample, shorter closed hours, or a longer window."""
    kind = str(rng.choice(["spacing", "samples", "hours", "window", "fixed"]))
    if kind == "spacing":
        return replace(problem, spacing=problem.spacing * float(rng.uniform(0.2, 0.9)))
    if kind == "samples":
        return replace(problem, samples=problem.samples + 1, spacing=min(problem.spacing, 0.5))
    if kind == "fixed":
        return replace(problem, fixed=[])
    if kind == "window":
        return replace(problem, window=problem.window + 24.0)
    return replace(problem, forbidden=[[a, b - 0.5 * (b - a) * rng.uniform()] for a, b in problem.forbidden])


def assert_never_worse(problem, seed):
    rng = np.random.default_rng([seed, 1])
    sigma = 0.0
    for _ in range(2):
        design = designed(problem)
        assert design.sigma >= sigma * (1 - AS_GOOD)
        sigma, problem = design.sigma, loosened(rng, problem)


@pytest.mark.long
def test_smaller_spacing_costs_the_first_hour_nothing():
    wide, narrow = (designed(replace(BLOOD, spacing=spacing)) for spacing in (2.0, 1.0))
    assert narrow.sigma >= wide.sigma * (1 - AS_GOOD)
    assert wide.sigma > 1.261


@pytest.mark.parametrize("seed", [7])
def test_demands_that_are_loosened_never_lower_sigma(seed):
    assert_never_worse(random_hours(np.random.default_rng(seed)), seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(100, 120))
def test_many_demands_that_are_loosened_never_lower_sigma(seed):
    assert_never_worse(random_hours(np.random.default_rng(seed)), seed)
