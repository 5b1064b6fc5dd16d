"""Law: "complete" means a finite bound and sigma > 0, or a bound that shows 0 is the best; every design verifies, and
no schedule drawn at random beats the bound, nor sees every state where the design says that none was found."""

from dataclasses import replace

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.errors import InfeasibleRequirementError
from tests.cases import few
from tests.oracles.requirements import Problem, random_admissible, random_problem, sigma_of

SEEDS = (0, 3, 8, 13, 23, 51, 60, 74, 97, 113, 118)
NOTHING = 1e-9  # beside the rows' own size: sigma is zero to rounding


def best_at_random(problem, seed, draws):
    """The best schedule of some drawn at random: sigma, times and mask."""
    rng = np.random.default_rng([seed, 1])
    drawn = [d for d in (random_admissible(rng, problem) for _ in range(draws)) if d is not None]
    return max(((sigma_of(problem, *d, places=2), *d) for d in drawn), key=lambda found: found[0], default=(0.0,))


def check(problem, seed=0, draws=12):
    """One problem: designed, or refused where nothing drawn at random meets it and sees every state."""
    plant = Plant(problem.A, problem.C)
    best, *schedule = best_at_random(problem, seed, draws)
    if best > 0:
        best = sigma_of(problem, *schedule, places=400)
    try:
        design = design_schedule(plant, Requirement(**problem.requirement), starts=1, branches=4)
    except InfeasibleRequirementError:
        assert best <= max(NOTHING, problem.target_sigma or 0.0)
        return None
    assert np.isfinite(design.upper_bound)
    assert design.verify()
    assert design.sigma <= design.upper_bound * (1 + 1e-12)
    if problem.target_sigma is None:
        assert best <= design.upper_bound * (1 + 1e-7)
    if design.status == "complete":
        assert design.sigma > 0 or design.upper_bound <= NOTHING * np.linalg.norm(problem.C)
        assert design.sigma > 0 or best <= NOTHING
    return design


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_random_requirements(seed):
    design = check(random_problem(np.random.default_rng(seed)), seed)
    assert design is None or 0 <= design.gap <= 1


OSCILLATOR = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]])


def problem(plant=OSCILLATOR, **keys):
    outputs = len(plant[1])
    return Problem(*plant, **{"available": [None] * outputs, "costs": [0.0] * outputs, **keys})


def test_fewer_samples_are_designed_where_spacing_makes_more_of_them_worse():
    asked = problem(window=6 * np.pi, period=3 * np.pi, spacing=np.pi, samples={"at_most": 3})
    design = check(asked)
    assert len(design.schedule) == 2
    assert design.sigma == pytest.approx(np.sqrt(2), rel=1e-3)
    assert design.gap < 1e-6
    assert set(design.other_counts) == {3}  # one sample alone always leaves room for a second
    assert "at most 3 samples" in design.claim.statement
    assert not replace(design, other_counts={}).verify()  # a bound of one count does not speak for the others


def test_as_many_samples_as_can_be_paid_are_designed():
    keys = {"window": 6.0, "period": 6.0, "spacing": 0.1, "samples": {"at_most": 8}}
    design = check(problem(**keys, costs=[1.0], cost_limit=6.0))
    assert len(design.schedule) == 6


@pytest.mark.long
def test_samples_that_must_tie_are_tied():
    w = 0.731813784889781
    plant = np.array([[0.0, w], [-w, 0.0]]), np.array([[0.16810587, 0.54840545]])
    P = 16.34
    keys = {"window": P / 2, "period": P, "spacing": 0.0125 * P, "samples": 4, "available": [[[0.0, 0.7 * P]]]}
    design = check(problem(plant, **keys))
    assert design.sigma > 0.527
    times = design.schedule.times
    assert times[2:] - times[:2] == pytest.approx(P / 2, rel=1e-12)


@pytest.mark.parametrize("growth", [0.0, 0.5])
def test_one_sample_a_period_has_no_gap(growth):
    plant = np.array([[growth, 1.0], [-1.0, growth]]), np.array([[1.0, 0.0]])
    design = check(problem(plant, window=5.0, period=2.5, spacing=1.0, samples=1))
    assert design.sigma > 0.4
    assert design.gap < 1e-6


@pytest.mark.parametrize("fixed", few([[0.0, np.pi], [0.0, 1.0, 2.5], [0.5, 1.0, 1.5, 4.0]], 1))
def test_where_all_samples_are_fixed_the_bound_is_what_they_see(fixed):
    design = check(problem(window=2 * np.pi, period=2 * np.pi, spacing=0.1, samples=len(fixed), fixed=fixed))
    assert design.schedule.times.tolist() == fixed
    assert design.upper_bound - design.sigma <= 1e-8


def test_one_fixed_sample_is_all_there_is():
    plant = np.array([[0.0]]), np.array([[1.0]])
    design = check(problem(plant, window=5.0, period=5.0, spacing=1.0, samples=1, fixed=[4.0]))
    assert design.schedule.times.tolist() == [4.0]
    assert design.sigma == pytest.approx(1.0)


@pytest.mark.parametrize(("seed", "least"), few([(25, 3.0), (71, 3.06), (84, 0.272)], 0, 1))
def test_what_leaves_a_window_as_something_else_enters_it_does_so_to_the_last_bit(seed, least):
    """Windows of 1.5 or 3 periods, fixed and closed times: rounding that parts what is tied would cost sigma."""
    design = check(random_problem(np.random.default_rng(seed)), seed)
    assert design.sigma > least
    assert design.gap < 0.01


@pytest.mark.long
@pytest.mark.parametrize(
    ("A", "window"), few([([[20.0, 2 * np.pi], [-2 * np.pi, 20.0]], 1.0), ([[10.0, 1.0], [0.0, 10.0]], 1.0)], 1)
)
def test_growth_within_the_window_leaves_no_gap(A, window):
    asked = problem((np.array(A), np.array([[1.0, 0.0]])), window=window, period=window, spacing=0.02, samples=4)
    design = check(asked)
    assert design.gap < 0.01
    assert design.bound.method == "local"
    assert design.bound.value_for(design.problem) == pytest.approx(design.bound.value, rel=1e-12)
    for part in design.bound.parts:  # windows that are none prove nothing
        if part.method == "local":
            wrong = replace(part, tied=part.tied + np.array([design.problem.samples, 0, 0, 0]))
            assert wrong.value_for(design.problem) == np.inf
            assert replace(part, tilt=part.tilt - 1.0).value_for(design.problem) == np.inf
            assert replace(part, tied=part.tied + np.array([0, 0, 0, 10**6])).value_for(design.problem) == np.inf
            break
