"""A larger noise gain never gives a longer horizon, whichever budgets are asked for, alone or as a curve."""

from __future__ import annotations

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates.certification import chosen
from sampling_design.certificates.compare.tradeoff import tradeoff_curve
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.weight_choice import LASTING
from tests.cases import few

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
FOUR = Plant(np.diag([-1.0, 0.1, 0.0, 0.0]) + np.diag([0, 0, 1.0], 1) - np.diag([0, 0, 1.0], -1), [[1, 1, 1, 0.0]])
CASES = [(OSCILLATOR, PeriodicSchedule([1.0])), (DOUBLE, PeriodicSchedule([0.3, 1.2]))]
CASES += [(DOUBLE, Schedule([0.5, 1.0, 2.5, 3.0])), (FOUR, PeriodicSchedule([1.0]))]
ROUNDING = 1e-6


@pytest.mark.parametrize(("plant", "schedule"), few(CASES, 2), ids=["oscillator", "double", "finite", "four states"])
def test_horizons_fall_along_any_list_of_gains(plant, schedule):
    budgets = sorted([1.2, 2.0, 3.0, 10.0, *np.exp(np.random.default_rng(7).uniform(0.1, 3.0, 2))])
    found = chosen(plant, schedule, weights_of(plant, None, None, None), 0.4, [float(b) for b in budgets])
    horizons = np.array([made.horizon().minimum for made in found])
    assert np.all(np.diff(horizons) <= ROUNDING * horizons[:-1]), dict(zip(budgets, horizons, strict=True))
    assert horizons[-1] < 0.95 * horizons[0]


@pytest.mark.long
@pytest.mark.parametrize("budget", few([1.2, 1.5, 2.0, 3.0], 0))
def test_a_gain_alone_gives_what_it_gives_among_others(budget):
    """And for the oscillator no less than the best that was ever found: 2.71, 2.39, 2.11, 1.88 were reached."""
    alone = certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.4, noise_gain=budget).horizon().minimum
    curve = tradeoff_curve(OSCILLATOR, PeriodicSchedule([1.0]), 0.4, [budget, 20.0])
    assert curve.horizons[0] == pytest.approx(alone, rel=1e-9)
    assert alone < {1.2: 2.75, 1.5: 2.4, 2.0: 2.15, 3.0: 1.9}[budget]


@pytest.mark.long
def test_the_rate_may_be_free():
    made = [certify(OSCILLATOR, PeriodicSchedule([1.0]), noise_gain=budget) for budget in (1.3, 2.5, 40.0)]
    horizons = np.array([one.horizon().minimum for one in made])
    assert np.all(np.diff(horizons) <= ROUNDING * horizons[:-1])


def left_by_lasting_noise(plant, certificate):
    """C_w and C_v over eta, states in their scales: what noise that does not end leaves of the squared error."""
    P1 = certificate.P1 * np.outer(plant.states.scales, plant.states.scales)
    return 1 / np.linalg.eigvalsh(P1)[0] / certificate.eta


@pytest.mark.long
@pytest.mark.parametrize("case", few(range(3), 0))
def test_no_horizon_is_bought_with_powers_of_ten_of_noise(case):
    """At the rate that `certify` chooses by itself lasting noise leaves at most LASTING times the least at any rate."""
    plant, schedule = [(OSCILLATOR, PeriodicSchedule([1.0, 1.0, 1.5])), CASES[1], CASES[3]][case]
    free = certify(plant, schedule)
    low, high = (factor / np.mean(schedule.gaps) for factor in (0.05, 3.0))
    least = min(left_by_lasting_noise(plant, certify(plant, schedule, eta=eta)) for eta in np.geomspace(low, high, 3))
    assert left_by_lasting_noise(plant, free) <= 1.1 * LASTING * least
    fastest = certify(plant, schedule, eta=high)
    assert free.horizon().minimum < 1.5 * fastest.horizon().minimum
    if case == 0:  # which chasing the horizon would have chosen
        assert left_by_lasting_noise(plant, fastest) > 2 * LASTING * least
