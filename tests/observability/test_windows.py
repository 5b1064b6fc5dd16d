"""Sigma over all real window positions: traps, tight cases, refusals, words."""

from itertools import product

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule, window_sigma
from sampling_design.errors import ArgumentError
from sampling_design.observability.windows import bracket
from sampling_design.plants import library
from sampling_design.plants.plant import Signals
from sampling_design.uncertain.plants.uncertain_plant import UncertainParameter, UncertainPlant
from tests.cases import few
from tests.oracles.observability import scan_windows, sigma_of_window

J = np.array([[0.0, 1.0], [-1.0, 0.0]])
INTEGRATOR = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
OSCILLATOR = Plant(J, [[1.0, 0.0]])


def test_all_real_window_ends_and_not_only_sample_times():
    # window 1, samples at the integers: two samples at t = 5, one at t = 5.5
    at_sample = sigma_of_window(INTEGRATOR.A, INTEGRATOR.C, range(9), None, 5.0, 1.0)
    assert at_sample == pytest.approx((np.sqrt(5) - 1) / 2, rel=1e-12)
    result = window_sigma(INTEGRATOR, PeriodicSchedule([1.0]), 1.0)
    assert (result.lower, result.upper, result.closed, result.status) == (0.0, 0.0, True, "too few samples")
    assert result.witness.samples.size == 1
    assert result.witness.t % 1 == 0.5


def test_infimum_is_the_limit_just_after_a_sample_leaves():
    result = window_sigma(INTEGRATOR, PeriodicSchedule([1.0]), 2.0)
    expected = sigma_of_window(INTEGRATOR.A, INTEGRATOR.C, range(9), None, 5.0, 2.0, "after")
    assert result.upper == pytest.approx(expected, rel=1e-12)
    assert result.witness.side == "after"
    assert result.witness.samples.size == 2
    assert result.witness.position.startswith("just after ")
    assert result.upper < 0.9 * sigma_of_window(INTEGRATOR.A, INTEGRATOR.C, range(9), None, 5.0, 2.0)


def test_infimum_is_the_limit_just_before_a_sample_arrives():
    # a growing mode weighs the latest sample most
    result = window_sigma(Plant([[1.0]], [[1.0]]), PeriodicSchedule([1.0, 0.6]), 2.0)
    assert result.witness.side == "before"
    assert result.lower > 0.99 * result.upper


def test_half_a_turn_between_samples_sees_nothing():
    result = window_sigma(OSCILLATOR, PeriodicSchedule([np.pi]), 7.0)
    assert (result.lower, result.closed, result.status) == (0.0, True, "below rounding")
    assert result.upper < 1e-14
    assert abs(result.witness.direction[0]) < 1e-12
    assert "does not observe the state" in result.explain()


def test_nearly_half_a_turn_is_small_and_not_zero():
    result = window_sigma(OSCILLATOR, PeriodicSchedule([np.pi - 1e-5]), 7.0)
    assert result.closed
    assert 0.99 * result.upper <= result.lower <= result.upper
    assert result.upper == pytest.approx(1e-5 / np.sqrt(2), rel=1e-2)


def test_tight_on_the_rotation():
    # sigma of an oscillator does not change while the samples stay the same: the bracket is a point
    result = window_sigma(OSCILLATOR, PeriodicSchedule([0.7, 0.4]), 2.0)
    assert result.lower == pytest.approx(result.upper, rel=1e-9)


def test_dip_narrower_than_the_first_grid():
    # one state is 50 times the sum of three oscillators: sigma dips where their phases meet
    S = np.eye(6)
    S[0] = 50 * np.array([1.0, 0, 1, 0, 1, 0])
    A = np.zeros((6, 6))
    for k, rate in enumerate((40.0, 80.0, 120.0)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = rate * J
    plant = Plant(S @ A @ np.linalg.inv(S), np.random.default_rng(3).standard_normal((2, 6)))
    schedule = PeriodicSchedule([0.9, 0.5, 1.1, 0.7])
    result = window_sigma(plant, schedule, 4.0)
    times = schedule.between(0, 20).times
    profile = result.profile
    grid = [
        sigma_of_window(plant.A, plant.C, times, None, left + part * (right - left), 4.0)
        for left, right in zip(profile.start, profile.end, strict=True)
        for part in (0.25, 0.5, 0.75)
    ]
    ends = profile.start[0], profile.end[-1]
    least, *_ = scan_windows(plant.A, plant.C, times, None, 4.0, *ends, 600)
    assert result.closed
    assert result.lower <= least * (1 + 1e-9)
    assert 0.99 * result.upper <= least
    assert min(grid) > 1.2 * least


def test_partial_outputs():
    rng = np.random.default_rng(4)
    plant = Plant(rng.standard_normal((3, 3)), rng.standard_normal((2, 3)))
    mask = np.array([[1, 0], [0, 1], [1, 1], [1, 0], [0, 1]], dtype=bool)
    schedule = PeriodicSchedule([0.3, 0.5, 0.4, 0.6, 0.2], outputs=mask)
    result = window_sigma(plant, schedule, 1.9)
    held = schedule.between(0, 12)
    low, high = result.profile.start[0], result.profile.end[-1]
    least, *_ = scan_windows(plant.A, plant.C, held.times, held.outputs, 1.9, low, high, 200)
    assert 0.99 * result.upper <= result.lower <= least * (1 + 1e-12)
    assert result.upper <= 1.005 * least
    assert result.lower < window_sigma(plant, PeriodicSchedule(schedule.gaps), 1.9).lower


def test_two_measurements_of_three_states_are_too_few():
    plant = Plant(np.diag([-1.0, -2.0, -3.0]), [[1.0, 1, 1], [0, 1, 0]])
    result = window_sigma(plant, Schedule([0.0, 0.5, 1.5, 4.0], [[1, 1], [1, 0], [1, 1], [1, 1]]), 1.2)
    assert (result.lower, result.upper, result.status) == (0.0, 0.0, "too few samples")
    rows = plant.C @ plant.transition(result.witness.samples - (result.witness.t - 1.2))
    if rows.size:
        assert np.abs(rows.reshape(-1, 3) @ result.witness.direction).max() < 1e-12


def test_window_shorter_than_a_gap():
    result = window_sigma(Plant([[-1.0]], [[1.0]]), PeriodicSchedule([1.0, 3.0]), 2.0)
    assert (result.lower, result.upper, result.witness.samples.size) == (0.0, 0.0, 0)
    assert "shorter than a gap" in result.explain()


def test_window_equal_to_the_period_in_rounded_times():
    # a sample leaves as its successor arrives: rounding must not make a window without both
    gaps = np.full(10, 0.1)
    result = window_sigma(Plant([[0.0]], [[1.0]]), PeriodicSchedule(gaps), float(np.sum(gaps)))
    assert result.upper == pytest.approx(np.sqrt(10), rel=1e-12)
    assert result.witness.samples.size == 10
    third = window_sigma(Plant([[0.0]], [[1.0]]), PeriodicSchedule(gaps), 0.3)
    assert third.upper == pytest.approx(np.sqrt(3), rel=1e-12)


def test_finite_schedule_of_a_single_window():
    times = [0.0, 0.5, 1.0]
    result = window_sigma(OSCILLATOR, Schedule(times), 1.0)
    assert result.witness.samples.size == 3
    assert result.witness.side == "at"
    assert "The worst window ends at 1 s with 3 samples." in result.explain()
    assert result.upper == pytest.approx(sigma_of_window(J, OSCILLATOR.C, times, None, 1.0, 1.0), rel=1e-12)


def test_finite_schedule_starts_with_its_first_full_window():
    result = window_sigma(OSCILLATOR, Schedule([3.0, 3.5, 4.0]), 1.0)
    assert result.witness.samples.size == 3
    assert result.upper > 0.5
    assert (result.profile.start[0], result.profile.end[-1]) == (4.0, 4.0)
    counted = window_sigma(OSCILLATOR, Schedule([3.0, 3.5, 4.0]), 1.0, start=0.0)
    assert (counted.upper, counted.witness.samples.size) == (0.0, 0)
    assert counted.profile.start[0] == 1.0


@pytest.mark.parametrize("rigorous", few([False, True], 0))
def test_the_zero_of_the_clock_changes_nothing(rigorous):
    times = np.array([0.0, 0.5, 1.25, 1.875, 3.0, 3.5])  # exact in doubles beside 1.7e9
    plain, *others = (
        window_sigma(OSCILLATOR, Schedule(times + zero), 1.75, rigorous=rigorous) for zero in (0.0, 5.0, 1.7e9)
    )
    assert plain.lower > 0
    for other in others:
        assert (other.lower, other.upper, other.status) == pytest.approx((plain.lower, plain.upper, plain.status))


def test_a_start_far_before_the_first_sample_is_said_without_a_warning():
    growing = Plant([[1.0]], [[1.0]])
    result = window_sigma(growing, Schedule([1.7e9, 1.7e9 + 1]), 2.0, start=0.0)
    assert (result.lower, result.status) == (0.0, "too few samples")


def test_satellite_in_si_units_closes():
    plant = library.satellite()
    times = np.sort(np.random.default_rng(0).uniform(0, 5554, 20))
    schedule = PeriodicSchedule.from_times(times, 5554.0)
    result = window_sigma(plant, schedule, 5554.0)
    assert result.closed
    held = schedule.between(0, 3 * 5554.0)
    ends = np.sort(np.random.default_rng(1).uniform(result.profile.start[0], result.profile.end[-1], 150))
    least = min(sigma_of_window(plant.A, plant.C, held.times, held.outputs, t, 5554.0) for t in ends)
    assert result.lower <= least


def test_sigma_refers_to_the_scales_that_the_plant_has():
    plain = Plant(J, np.eye(2))
    scaled = Plant(J, np.eye(2), states=Signals(("a", "b"), scales=np.array([10.0, 0.1])))
    schedule = PeriodicSchedule([0.5, 0.7])
    result = window_sigma(scaled, schedule, 1.3)
    assert result.upper == window_sigma(scaled.scaled(), schedule, 1.3).upper
    assert "scaled coordinates" in str(result)
    assert result.claim.assumptions[-1] == "scaled coordinates"
    bare = window_sigma(scaled.unscaled(), schedule, 1.3)
    assert (bare.upper, bare.coordinates) == (window_sigma(plain, schedule, 1.3).upper, "physical")


def test_no_states_means_nothing_to_see():
    result = window_sigma(Plant(np.zeros((0, 0)), np.zeros((1, 0))), PeriodicSchedule([1.0]), 2.0)
    assert (result.lower, result.upper, result.closed) == (np.inf, np.inf, True)
    assert "nothing to observe" in result.explain()


def slow_to_close():
    A = np.array([[0.0, 900.0], [-100.0, 0.0]])
    return Plant(A, [[1.0, 0.3]]), PeriodicSchedule([0.37, 0.23, 0.31])


def test_budget_that_ran_out_is_said():
    plant, schedule = slow_to_close()
    result = window_sigma(plant, schedule, 2.0, budget=0)
    assert (result.closed, result.status) == (False, "budget")
    assert "the budget ran out before the bracket closed" in result.explain()
    done = window_sigma(plant, schedule, 2.0)
    assert done.closed
    assert result.lower <= done.lower <= done.upper <= result.upper


def test_node_limit_ends_a_search_without_a_budget(monkeypatch):
    monkeypatch.setattr(bracket, "_MOST_NODES", 20)
    plant, schedule = slow_to_close()
    assert window_sigma(plant, schedule, 2.0).status == "budget"


def test_rounding_that_keeps_the_bracket_open_is_said():
    result = window_sigma(Plant(np.diag([5.0, -5.0]), [[1.0, 1.0]]), PeriodicSchedule([0.5, 0.7]), 3.0, rtol=1e-9)
    assert (result.closed, result.status) == (False, "rounding")
    assert "rounding" in result.explain()
    assert result.lower < result.upper < (1 + 1e-4) * result.lower


def test_tighter_brackets_on_demand():
    for rtol in (0.3, 0.01, 1e-5):
        result = window_sigma(INTEGRATOR, PeriodicSchedule([0.5, 0.7]), 3.0, rtol=rtol)
        assert result.closed
        assert result.lower >= (1 - rtol) * result.upper


def test_profile_is_a_curve_above_its_own_bounds():
    result = window_sigma(INTEGRATOR, PeriodicSchedule([0.5, 0.7]), 3.0)
    profile = result.profile
    assert profile.t.shape == profile.sigma.shape == profile.piece.shape
    for g in range(profile.start.size):
        here = profile.piece == g
        assert profile.t[here][0] == pytest.approx(profile.start[g])
        assert profile.t[here][-1] == pytest.approx(profile.end[g])
        assert np.all(np.diff(profile.t[here]) >= 0)
        assert np.all(profile.sigma[here] >= profile.lower[g])
    assert profile.sigma.min() == pytest.approx(result.upper, rel=1e-9)
    assert profile.lower.min() == pytest.approx(result.lower, rel=1e-12)


def test_witness_can_be_checked_by_hand():
    result = window_sigma(INTEGRATOR, PeriodicSchedule([0.5, 0.7]), 3.0)
    w = result.witness
    rows = np.array([[1.0, tau - (w.t - 3.0)] for tau in w.samples])
    assert np.linalg.norm(w.direction) == pytest.approx(1.0)
    assert np.linalg.norm(rows @ w.direction) == pytest.approx(result.upper, rel=1e-9)
    assert "window end" in str(w)
    assert "is least observable there" in w.explain()


def test_progress_and_words():
    seen = []
    plant, schedule = slow_to_close()
    result = window_sigma(plant, schedule, 2.0, progress=lambda done, text: seen.append((done, text)))
    assert seen
    assert all(0 <= done <= 1 and "intervals open" in text for done, text in seen)
    assert "sigma at least" in str(result)
    assert repr(result).startswith("WindowSigma(")
    assert "(proven)" in result.explain()
    assert result.claim.strength == "proven"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"window": 0.0}, "`window` must be positive"),
        ({"window": np.nan}, "`window` must be finite"),
        ({"rtol": 1.0}, "`rtol` must be less than 1"),
        ({"rtol": -0.1}, "`rtol` must be positive"),
        ({"budget": -1.0}, "`budget` must not be negative"),
        ({"plant": J}, "`plant` must be a Plant or a plant of another kind, got ndarray"),
        ({"schedule": [0.0, 1.0]}, r"Use Schedule\(times\)"),
        ({"schedule": Schedule([0.0, 1.0])}, "`window` must fit into the schedule, which spans 1, got 1.5"),
        ({"schedule": Schedule([1.0, 2.0]), "start": 1.0}, "which ends 1 after `start`, got 1.5"),
        ({"start": -1.0}, "`start` must not be negative"),
        ({"schedule": Schedule([])}, "`window` must fit into the schedule"),
        ({"schedule": PeriodicSchedule([1.0], time_unit="h")}, "in h and the plant in s"),
        ({"plant": Plant([[900.0]], [[1.0]])}, "`window` must be short enough"),
    ],
)
def test_bad_input(arguments, message):
    given = {"plant": OSCILLATOR, "schedule": PeriodicSchedule([0.5]), "window": 1.5, **arguments}
    with pytest.raises(ArgumentError, match=message):
        window_sigma(**given)


@pytest.mark.parametrize("growth", [30.0, 340.0, 350.0, 400.0])
def test_growth_whose_square_is_no_number_hides_nothing(growth):
    """From e^355 on sigma was said to be zero to rounding, with e^400 attained."""
    plant = Plant([[growth]], [[1.0]])
    found = window_sigma(plant, PeriodicSchedule([0.5, 0.5], 0.2), 1.0)
    # the window that begins just after a sample has one half a period later, and another as it ends
    assert found.status == "closed"
    assert found.lower == pytest.approx(np.exp(growth / 2), rel=2e-3)
    assert found.upper == pytest.approx(np.exp(growth / 2), rel=2e-3)


LATE = {
    "one sample short": (PeriodicSchedule([1.0, 1.0], first=2.0), 3.0),
    "two short, uneven": (PeriodicSchedule([0.5, 0.25, 1.0, 0.75], first=1.7), 2.5),
    "a masked output": (PeriodicSchedule([0.5, 1.0], first=1.25, outputs=[[True, False], [True, True]]), 3.0),
    "nothing short": (PeriodicSchedule([1.0, 1.0], first=0.4), 3.0),
}


@pytest.mark.parametrize(("name", "rigorous"), few(product(LATE, [False, True]), 0, 3, 4, 6))
def test_the_windows_of_a_late_start_are_covered(name, rigorous):
    """A claim for every window from time 0 on holds of the finite schedule that is its beginning, from time 0 on."""
    schedule, window = LATE[name]
    plant = Plant(OSCILLATOR.A, np.eye(2)) if schedule.outputs is not None else OSCILLATOR
    found = window_sigma(plant, schedule, window, rigorous=rigorous)
    head = schedule.between(0.0, 4 * schedule.period + window)
    assert found.lower <= window_sigma(plant, head, window, start=0.0).upper * (1 + 1e-12)
    assert found.upper >= window_sigma(plant, head, window, start=0.0).lower * (1 - 1e-12)
    rhythm = window_sigma(plant, schedule, window, start=schedule.first)
    assert rhythm.lower >= found.lower * (1 - 1e-6)
    assert (rhythm.lower > 1.01 * found.upper) == (name != "nothing short")
    assert (found.from_time, rhythm.from_time) == (0.0, schedule.first)
    assert found.to_dict()["from_time"] == 0.0
    assert f"t >= T + {schedule.first:g}" in rhythm.claim.statement
    assert f"from {schedule.first:g} s on" in rhythm.explain()


def test_a_box_of_plants_covers_the_windows_of_a_late_start():
    stiff = UncertainParameter("omega^2", 0.99, 1.01, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
    found = window_sigma(UncertainPlant(OSCILLATOR, [stiff]), *LATE["one sample short"])
    assert found.lower <= 0.678011
    assert (found.from_time, found.to_dict()["from_time"]) == (0.0, 0.0)
