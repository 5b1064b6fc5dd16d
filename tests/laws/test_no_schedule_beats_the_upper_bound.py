"""Law: no admissible schedule over all real times, however it is found, beats the proven upper bound."""

import numpy as np
import pytest
from scipy.optimize import differential_evolution

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.bounds.branching import narrowed
from sampling_design.design.bounds.evidence import UpperBound, placed_part
from sampling_design.design.bounds.relaxation import relax_placed
from sampling_design.design.problem.posing import pose
from tests.oracles.design import best_on_grid, is_allowed, random_schedule, window_sigma_scan

OSCILLATOR = ([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
INTEGRATOR = ([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
PAIR = (
    [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, -2.0, 0.0]],
    [[1.0, 0.0, 1.0, 0.0]],
)
UNSTABLE = ([[2.0, 1.0], [0.0, 0.1]], [[1.0, 0.3]])


def designed(case, window, spacing, samples, **more):
    A, C = case
    return design_schedule(
        Plant(A, C), Requirement(window=window, spacing=spacing, samples=samples, **more), starts=4, branches=40
    )


@pytest.mark.parametrize("case", [OSCILLATOR, INTEGRATOR, UNSTABLE])
def test_enumeration_of_a_grid_stays_below_the_bound_and_within_the_gap(case):
    design = designed(case, 4.0, 0.5, 3)
    best, _ = best_on_grid(*case, 4.0, 4.0, 0.5, 3, 24)
    assert best <= design.upper_bound * (1 + 1e-9)
    assert best <= design.sigma_attained * (1 + 1e-6)
    assert design.sigma_attained <= design.upper_bound * (1 + 1e-9)


def test_enumeration_with_forbidden_and_fixed_times():
    rules = {"forbidden": [[0.5, 1.5]], "fixed": [0.0]}
    design = designed(OSCILLATOR, 4.0, 0.5, 3, **rules)
    best, times = best_on_grid(*OSCILLATOR, 4.0, 4.0, 0.5, 3, 24, **rules)
    assert is_allowed(times, 4.0, 0.5, **rules)
    assert best <= design.sigma_attained * (1 + 1e-6) <= design.upper_bound * (1 + 2e-6)


@pytest.mark.parametrize(
    ("case", "window", "period", "samples"),
    [(PAIR, 4.0, 4.0, 8), (PAIR, 4.0, 3.0, 6), (OSCILLATOR, 3.0, 5.0, 7), (INTEGRATOR, 6.0, 4.0, 3)],
)
def test_random_schedules_stay_below_the_bound(case, window, period, samples):
    design = designed(case, window, 0.2, samples, period=period)
    rng = np.random.default_rng(3)
    draws = [random_schedule(rng, period, 0.2, samples) for _ in range(25)]
    reached = max(window_sigma_scan(*case, times, period, window, places=0) for times in draws)
    assert 0 < reached <= design.upper_bound
    assert reached <= design.sigma_attained * (1 + 1e-6)


def test_differential_evolution_beats_neither_the_bound_nor_the_schedule():
    design = designed(OSCILLATOR, 4.0, 0.3, 3)

    def cost(gaps):
        times = np.concatenate([[0.0], np.cumsum(0.3 + gaps * (4.0 - 0.9) / max(np.sum(gaps), 1.0))[:2]])
        return -window_sigma_scan(*OSCILLATOR, times, 4.0, 4.0, places=0)

    found = -differential_evolution(cost, [(0, 1)] * 3, seed=1, maxiter=12, popsize=8, polish=False).fun
    assert found <= design.upper_bound
    assert found <= design.sigma_attained * (1 + 1e-6)


def test_the_bound_is_tight_for_four_samples_on_the_oscillator():
    design = designed(OSCILLATOR, 2 * np.pi, 0.2, 4)
    assert design.upper_bound == pytest.approx(np.sqrt(2), rel=1e-6)
    assert design.sigma == pytest.approx(np.sqrt(2), rel=2e-3)


SPIRAL = ([[2.0, 1.5], [-1.5, 2.0]], [[1.0, 0.0]])
CLOSED = [[0.0, 0.3], [1.0, 1.3], [2.0, 2.3], [3.0, 3.3]]


@pytest.mark.parametrize(
    ("case", "window", "rules"),
    [
        (OSCILLATOR, 4.0, {}),
        (OSCILLATOR, 3.0, {"forbidden": [[0.5, 1.5]]}),
        (OSCILLATOR, 4.0, {"fixed": [0.0, 1.75]}),
        (INTEGRATOR, 3.0, {}),
        (INTEGRATOR, 4.0, {"forbidden": CLOSED}),
        (UNSTABLE, 4.0, {}),
        (UNSTABLE, 3.0, {"fixed": [0.5], "forbidden": [[1.0, 2.1]]}),
        (SPIRAL, 4.0, {}),
        (SPIRAL, 3.0, {"forbidden": [[0.5, 1.5]]}),
        (SPIRAL, 4.0, {"fixed": [0.0, 1.75]}),
    ],
)
def test_boxes_cut_again_and_again_stay_above_every_schedule_of_a_grid(case, window, rules):
    requirement = Requirement(window=window, period=4.0, spacing=0.4, samples=3, **rules)
    problem = pose(Plant(*case), requirement, 3)
    first = UpperBound(np.inf, (placed_part(problem, relax_placed(problem)),))
    best, _ = best_on_grid(*case, 4.0, window, 0.4, 3, 16, **rules)
    loose, tight = (narrowed(problem, first, best, steps, rtol=0.0) for steps in (3, 7))
    assert best <= tight.value * (1 + 1e-9) <= loose.value * (1 + 2e-9)
    assert {part.method for part in tight.parts} <= {"zones", "averaged", "local"}
    assert tight.value_for(problem) == pytest.approx(tight.value)
    assert UpperBound(tight.value, tight.parts[1:]).value_for(problem) == np.inf  # one box less covers too little
