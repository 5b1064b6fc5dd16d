"""Sizes, growth and counts beyond all measure end in one sentence, before anything is tried."""

import numpy as np
import pytest

from sampling_design import (
    ArgumentError,
    GapRange,
    PeriodicSchedule,
    Plant,
    Requirement,
    Schedule,
    SpacedWindows,
    certificate_exists,
    design_schedule,
    window_sigma,
    worst_case_sigma,
    zero_count_bound,
)
from sampling_design.certificates.existence.counterexample import find_counterexample
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.observability.count.zero_count import default_window
from sampling_design.observability.windows.sampled import observability_gramian
from sampling_design.plants.modes import split_modes
from tests.cases import few
from tests.counted_clock import Counted

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SADDLE = Plant([[4.0, 1.0], [0.0, -4.0]], [[1.0, 1.0]])


@pytest.mark.parametrize("window", [100.0, 200.0])
def test_growth_within_a_window(window):
    with pytest.raises(ArgumentError, match=r"short enough for e\^\(A T\) to be a number, and its square"):
        window_sigma(SADDLE, PeriodicSchedule([1.0]), window)
    with pytest.raises(ArgumentError, match=r"is too long for this plant: e\^\(A t\) overflows"):
        worst_case_sigma(SADDLE, SpacedWindows(window, 3, 1.0))


@pytest.mark.parametrize("gap", [1e4, 1e20, 1e150])
def test_nothing_is_proven_of_a_plant_that_forgets_all_between_samples(gap):
    plant = Plant([[-1.0, 1.0], [0.0, -2.0]], [[1.0, 0.0], [0.0, 1.0]])
    for schedule, window in ((PeriodicSchedule([gap]), 1.5 * gap), (Schedule([0.0, gap, 2 * gap]), 1.2 * gap)):
        found = window_sigma(plant, schedule, window)
        assert (found.lower, found.upper, found.status) == (0.0, 0.0, "below rounding")


@pytest.mark.parametrize("seed", few(range(4), 0, 1))
def test_an_integrator_is_designed_over_a_window_that_a_double_hardly_spans(seed):
    plant = Plant([[0.0, 1.0], [0.0, 0.0]], np.random.default_rng(seed).normal(size=(2, 2)))
    requirement = Requirement(window=1e9, spacing=5e7, samples=2)
    found = design_schedule(plant, requirement, starts=1, branches=0)
    assert found.sigma <= found.upper_bound * (1 + 1e-9)


def test_a_window_of_many_samples_takes_no_square_of_their_number():
    found = window_sigma(OSCILLATOR, PeriodicSchedule([1.0]), 1e5)
    assert found.closed
    assert found.lower == pytest.approx(np.sqrt(5e4), rel=1e-2)


@pytest.mark.parametrize(("count", "window"), [(100_000, 1e6), (10**9, 4e9)])
def test_counts_that_do_not_fit_are_refused_with_their_memory(count, window):
    with (
        Counted().running() as clock,
        pytest.raises(ArgumentError, match=r"samples in a window, which would take .* GiB; at most 2 GiB are taken"),
    ):
        worst_case_sigma(OSCILLATOR, SpacedWindows(window, count, 1.0))
    assert clock.read() < 1.0


@pytest.mark.parametrize("plant", [Plant(1e200 * OSCILLATOR.A, [[1.0, 0.0]]), Plant(OSCILLATOR.A, [[1e200, 0.0]])])
def test_entries_whose_products_are_no_numbers(plant):
    for ask in (
        lambda: window_sigma(plant, PeriodicSchedule([1.0]), 4.0),
        lambda: worst_case_sigma(plant, SpacedWindows(4.0, 3, 0.5)),
    ):
        with pytest.raises(ArgumentError, match=r"`plant` must have entries of [AC] up to .* Give it in other units"):
            ask()


def test_outputs_of_any_size_decide_nothing():
    for size in (1e308, 1e-300):
        large = Plant(OSCILLATOR.A, [[size, size]])
        assert len(unobservable_modes(large)) == 0
        assert certificate_exists(large, PeriodicSchedule([1.0]), 0.4).exists
        assert not certificate_exists(large, PeriodicSchedule([np.pi]), 0.4).exists
    with pytest.raises(ArgumentError, match=r"rows whose squares are numbers, got .* Use sigma_min"):
        observability_gramian(Plant(OSCILLATOR.A, [[1e200, 0.0]]), [0.0, 1.0])


def test_a_count_beyond_whole_numbers():
    with pytest.raises(ArgumentError, match=r"`duration` must hold fewer than 1e\+15 samples .*, got 1e\+308"):
        zero_count_bound(OSCILLATOR, 1e308)


def test_growth_beyond_numbers_within_a_family():
    found, nearest = find_counterexample(Plant(np.diag([400.0, 400.0]), [[1.0, 1.0]]), GapRange(5.0, 10.0), 0.1)
    assert found is None
    assert nearest.margin < 1e-12


def test_a_budget_ends_the_search_for_the_worst_case():
    rng = np.random.default_rng(0)
    plant = Plant(rng.standard_normal((4, 4)), rng.standard_normal((2, 4)))
    for count in (10, 100):
        with Counted().running() as clock:
            worst_case_sigma(plant, SpacedWindows(0.1 * count + 2.0, count, 0.1), budget=0.2)
        assert clock.read() < 1.5 * 0.2 + 2.0


def test_one_rule_for_the_window_that_was_not_given():
    split = split_modes(OSCILLATOR)
    design = design_schedule(OSCILLATOR)
    assert default_window(split) == pytest.approx(2 * np.pi)
    assert design.requirement.period == default_window(split)
    assert design.requirement.window == pytest.approx(default_window(split) + 2 * design.late.radius)
    again = window_sigma(OSCILLATOR, design.schedule, design.requirement.window, timing_tolerance=design.late.plain)
    assert again.lower == pytest.approx(design.sigma, rel=1e-2)
