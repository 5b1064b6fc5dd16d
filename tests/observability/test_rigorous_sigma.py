"""Lower bounds of sigma in ball arithmetic: against sixty digits, where they are tight, and where nothing is proven."""

import sys
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sampling_design import (
    PeriodicSchedule,
    Plant,
    Schedule,
    SpacedWindows,
    named_plant,
    window_sigma,
    worst_case_sigma,
)
from sampling_design.errors import MissingExtraError
from sampling_design.numerics.balls import precision
from sampling_design.observability.windows.balls import exact_times, prove_window_sigma
from sampling_design.observability.windows.pieces import window_pieces
from sampling_design.observability.worst_case import balls as rigorous_worst
from sampling_design.observability.worst_case.balls import WorstCase, prove_worst_sigma
from sampling_design.records.budget import Budget, BudgetSpentError
from tests.cases import few
from tests.counted_clock import Counted

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
STIFF = Plant([[-40.0, 5.0, 0.0], [0.0, 0.3, 2.0], [0.0, -2.0, 0.3]], [[1.0, 1.0, 0.0]])


def sigma_at(plant, times, start, digits=50):
    """Sigma of the samples at `times` for the state at `start`, in fifty digits."""
    with mpmath.workdps(digits):
        G = mpmath.zeros(plant.n_states)
        for t in times:
            row = mpmath.matrix(plant.C.tolist()) * mpmath.expm(
                mpmath.matrix(plant.A.tolist()) * (mpmath.mpf(t) - start)
            )
            G += row.T * row
        return mpmath.sqrt(min(mpmath.eigsy(G, eigvals_only=True)))


CASES = {
    "double integrator": (DOUBLE, PeriodicSchedule([1.0]), 2.0),
    "oscillator": (OSCILLATOR, PeriodicSchedule([0.5, 1.3, 0.9]), 4.0),
    "tenths": (OSCILLATOR, PeriodicSchedule([0.1]), 0.3),
    "finite": (OSCILLATOR, Schedule([0.0, 0.5, 1.3, 1.8, 2.9, 3.3]), 2.0),
    "stiff": (STIFF, PeriodicSchedule([0.6, 0.8]), 3.0),
    "partial outputs": (
        Plant([[0.0, 1.0], [-1.0, 0.1]], np.eye(2)),
        PeriodicSchedule([0.7, 0.4], outputs=[[1, 0], [0, 1]]),
        2.0,
    ),
    "scales": (named_plant("helicopter_he1"), PeriodicSchedule([0.4, 0.5, 0.6]), 3.0),
}


@pytest.mark.parametrize("name", CASES)
def test_lower_is_proven_and_gives_hardly_anything_away(name):
    plant, schedule, window = CASES[name]
    plain, proven = window_sigma(plant, schedule, window), window_sigma(plant, schedule, window, rigorous=True)
    assert proven.rigorous
    assert proven.closed
    assert plain.lower * (1 - 2e-6) <= proven.lower <= plain.lower
    assert 0 <= proven.slack <= 1e-13 * (window + 10)
    assert "ball arithmetic" in proven.claim.theorem
    assert "ball arithmetic" in proven.explain()
    assert "proven in ball arithmetic" in str(proven)
    assert proven.to_dict()["rigorous"] is True
    assert proven.coordinates == plain.coordinates


@pytest.mark.parametrize(
    ("plant", "gaps", "window"), few([(DOUBLE, [1.0], 2.0), (OSCILLATOR, [0.5, 1.25, 0.75], 4.0)], 0)
)
def test_a_bound_too_high_by_1e_9_is_never_proven(plant, gaps, window):
    schedule = PeriodicSchedule(gaps)
    witness = window_sigma(plant, schedule, window, rtol=1e-6).witness
    start = witness.t - window
    exact = float(sigma_at(plant, witness.samples, mpmath.mpf(start)))
    pieces = window_pieces(schedule, window)
    too_high = prove_window_sigma(plant, schedule, pieces, exact / (1 - 1e-6) * (1 + 1e-9))
    assert too_high.lower < exact
    just_below = prove_window_sigma(plant, schedule, pieces, exact / (1 - 1e-6) * (1 - 1e-9))
    assert exact * (1 - 2e-9) < just_below.lower < exact


@settings(max_examples=6)
@given(seed=st.integers(0, 10_000))
def test_no_position_in_fifty_digits_lies_below(seed):
    rng = np.random.default_rng(seed)
    plant = Plant(rng.standard_normal((2, 2)), rng.standard_normal((1, 2)))
    schedule = PeriodicSchedule(rng.uniform(0.3, 0.9, 2))
    window = float(rng.uniform(2.0, 3.0))
    proven = window_sigma(plant, schedule, window, rigorous=True)
    for start in rng.uniform(schedule.first, schedule.first + schedule.period, 5):
        times = schedule.between(float(start), float(start) + window).times
        assert sigma_at(plant, times, mpmath.mpf(float(start))) >= proven.lower


@pytest.mark.parametrize("name", ["oscillator", "stiff", "partial outputs", "finite"])
def test_units_that_lie_far_apart_make_a_proof_no_longer(name):
    """States and outputs in units of their own change sigma, but neither what is proven of it nor how many steps."""
    plant, schedule, window = CASES[name]
    rng = np.random.default_rng(len(name))
    x = 10.0 ** rng.permutation([9.0, -4.0, 0.0][: plant.n_states])
    y = 10.0 ** rng.permutation([5.0, 0.0][: plant.n_outputs])
    steps = []
    for here in (plant, Plant(plant.A * x[:, None] / x, plant.C * y[:, None] / x)):
        plain, clock = window_sigma(here, schedule, window), Counted()
        with clock.running():
            proven = prove_window_sigma(here, schedule, window_pieces(schedule, window), plain.lower)
        assert proven.lower == pytest.approx(plain.lower, rel=2e-6, abs=0)
        steps.append(clock.steps)
    assert steps[1] < 3 * steps[0]


def test_exact_times_are_whole_periods_away_from_the_first():
    schedule = PeriodicSchedule([0.1, 0.2])
    pieces = window_pieces(schedule, 0.7)
    first, period = [Fraction(t) for t in schedule.times.tolist()], Fraction(schedule.period)
    for t, exact in zip(pieces.times.tolist(), exact_times(schedule, pieces), strict=True):
        assert abs(exact - Fraction(t)) < Fraction(1, 10**14)
        assert any((exact - own) % period == 0 for own in first)


def test_a_window_that_is_a_multiple_of_the_gap_in_exact_numbers_needs_no_slack():
    assert window_sigma(DOUBLE, PeriodicSchedule([0.25]), 0.75, rigorous=True).slack == 0.0
    tenths = window_sigma(DOUBLE, PeriodicSchedule([0.1]), 0.3, rigorous=True)
    assert 0 < tenths.slack < 1e-15
    assert "samples in [t - T - " in tenths.claim.statement


def test_nothing_to_prove_is_said_as_before():
    few = window_sigma(DOUBLE, PeriodicSchedule([1.0]), 1.0, rigorous=True)
    assert (few.lower, few.status, few.closed) == (0.0, "too few samples", True)
    aliased = window_sigma(OSCILLATOR, PeriodicSchedule([np.pi]), 10.0, rigorous=True)
    assert aliased.lower == 0.0
    empty = window_sigma(Plant(np.zeros((0, 0)), np.zeros((1, 0))), PeriodicSchedule([1.0]), 2.0, rigorous=True)
    assert empty.lower == np.inf


def test_a_spent_budget_leaves_the_bound_open():
    schedule = PeriodicSchedule([0.5, 1.3, 0.9])
    proof = prove_window_sigma(OSCILLATOR, schedule, window_pieces(schedule, 4.0), 1.0, seconds=-1.0)
    assert (proof.lower, proof.status) == (0.0, "budget")
    record = window_sigma(OSCILLATOR, schedule, 4.0, budget=0.0, rigorous=True)
    assert not record.closed
    assert record.lower <= record.upper


def test_without_the_extra_the_refusal_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(MissingExtraError, match="python-flint, which is not installed"):
        window_sigma(DOUBLE, PeriodicSchedule([1.0]), 2.0, rigorous=True)


CHAIN = Plant([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -0.3]], [[1.0, 0.0, 1.0]])
FAMILIES = {
    "double integrator": (DOUBLE, SpacedWindows(4.0, 2, 0.5), 0.09092),
    "oscillator": (OSCILLATOR, SpacedWindows(4.0, 3, 0.5), 0.34988),
    "triple integrator": (named_plant("triple_integrator"), SpacedWindows(4.0, 3, 0.5), None),
    "three states": (CHAIN, SpacedWindows(6.0, 5, 0.5), None),
    "one schedule only": (OSCILLATOR, SpacedWindows(1.0, 3, 0.5), None),
    "two outputs": (Plant([[0.0, 1.0], [-1.0, 0.1]], [[1.0, 0.0], [0.3, 1.0]]), SpacedWindows(2.0, 2, 0.3), None),
}


@pytest.mark.parametrize("name", few(FAMILIES, 1, 4, 5))
def test_the_worst_case_is_proven_and_gives_hardly_anything_away(name):
    plant, family, reference = FAMILIES[name]
    plain = worst_case_sigma(plant, family)
    proven = worst_case_sigma(plant, family, rigorous=True)
    assert proven.rigorous
    assert proven.closed
    assert plain.lower * (1 - 2e-6) <= proven.lower <= plain.lower
    assert "ball arithmetic" in proven.claim.theorem
    assert "proven in ball arithmetic" in proven.explain()
    assert "proven in ball arithmetic" in str(proven)
    assert proven.to_dict()["rigorous"] is True
    if reference is not None:
        assert 0.98 * reference < proven.lower < reference * (1 + 1e-4)


@pytest.mark.parametrize("name", few(FAMILIES, 0, 5))
def test_a_worst_case_above_an_attained_one_is_never_proven(name):
    plant, family, _ = FAMILIES[name]
    found = worst_case_sigma(plant, family)
    attained = sigma_at(plant, found.witness, 0)
    too_high = prove_worst_sigma(plant, family, float(attained) / (1 - 1e-6) * (1 + 1e-5), found.witness)
    assert too_high.lower < attained


@pytest.mark.long
@settings(max_examples=15)
@given(seed=st.integers(0, 10_000))
def test_no_spaced_schedule_in_fifty_digits_lies_below(seed):
    """Random schedules, corners of the polytope included, on plants without structure."""
    rng = np.random.default_rng(seed)
    n, k = int(rng.integers(2, 4)), 4
    plant, family = Plant(rng.standard_normal((n, n)), rng.standard_normal((1, n))), SpacedWindows(2.0, k, 0.2)
    proven = worst_case_sigma(plant, family, rtol=0.1, rigorous=True)
    for _ in range(5):
        slacks = np.sort(rng.choice([0.0, 1.0, rng.uniform()], k)) * (2.0 - 0.2 * (k - 1)) * (1 - 1e-12)
        assert sigma_at(plant, slacks + 0.2 * np.arange(k), 0) >= proven.lower


def test_a_dip_between_the_points_of_the_first_grid_is_seen():
    """A fast oscillator: the samples that see least lie closer together than the first grid."""
    plant, family = Plant([[0.0, 40.0], [-40.0, 0.0]], [[1.0, 0.0]]), SpacedWindows(3.0, 2, 0.5)
    proof = prove_worst_sigma(plant, family, 0.05, np.array([0.0, 0.5]))
    k = round(0.5 * 40 / np.pi) + 1
    assert sigma_at(plant, [0.0, k * np.pi / 40], 0) < 1e-7
    assert proof.lower == 0.0


def test_a_worst_case_without_time_or_with_too_many_states_stays_open():
    late = prove_worst_sigma(CHAIN, SpacedWindows(6.0, 5, 0.5), 0.12, np.linspace(0, 6, 5), seconds=-1.0)
    assert (late.lower, late.status) == (0.0, "budget")
    nine = Plant(-np.diag(np.arange(1.0, 10.0)), np.ones((1, 9)))
    large = prove_worst_sigma(nine, SpacedWindows(9.0, 9, 0.5), 0.1, np.arange(9.0))
    assert (large.lower, large.status) == (0.0, "too many states")


def test_a_worst_case_of_zero_or_without_states_is_said_as_before():
    few = worst_case_sigma(CHAIN, SpacedWindows(4.0, 2, 0.5), rigorous=True)
    assert (few.lower, few.status, few.closed) == (0.0, "too few samples", True)
    empty = worst_case_sigma(Plant(np.zeros((0, 0)), np.zeros((1, 0))), SpacedWindows(4.0, 2, 0.5), rigorous=True)
    assert empty.lower == np.inf


def test_a_worst_case_without_the_extra_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(MissingExtraError, match="python-flint, which is not installed"):
        worst_case_sigma(DOUBLE, SpacedWindows(4.0, 2, 0.5), rigorous=True)


def test_too_many_open_cells_end_the_attempt(monkeypatch):
    monkeypatch.setattr(rigorous_worst, "MOST_CELLS", 1)
    found = worst_case_sigma(CHAIN, SpacedWindows(6.0, 5, 0.5))
    with precision(), pytest.raises(BudgetSpentError, match="too many cells are open"):
        WorstCase(CHAIN, SpacedWindows(6.0, 5, 0.5), np.eye(3), Budget(60.0)).proves(found.lower)


@pytest.mark.parametrize("rate", [3.0, 10.0, 20.0])
def test_growth_within_a_window_hides_nothing(rate, monkeypatch):
    S = np.array([[1.0, 0.3], [-0.2, 1.0]])
    plant = Plant(np.linalg.solve(S, np.diag([rate, 0.0]) @ S), [[1.0, 0.4]])
    for asked in (False, True):
        found = window_sigma(plant, PeriodicSchedule([2.5]), 10.0, rigorous=asked)
        assert found.closed
        assert found.rigorous
        assert found.lower == pytest.approx(0.16590 if rate > 3 else 0.16587, abs=1e-5)  # 120 digits say so too
        assert found.lower <= found.upper == pytest.approx(found.lower, rel=2e-3)
    monkeypatch.setitem(sys.modules, "flint", None)
    plain = window_sigma(plant, PeriodicSchedule([2.5]), 10.0)
    assert plain.lower < 0.15  # rounding of e^30 and more
    assert plain.status in ("rounding", "below rounding")
    assert plain.status == "rounding" or "ball arithmetic shows: extra `rigorous`" in plain.explain()


@pytest.mark.parametrize("growth", few([40.0, 100.0, 150.0], 0))
@pytest.mark.parametrize("shape", few(["two", "coupled", "turning"], 1))
def test_sigma_beside_growth_is_what_many_digits_say(shape, growth):
    """Attained to ten digits, and no other window is below the bound."""
    rng, window = np.random.default_rng(int(growth)), 3.0
    block = np.diag([growth / window, -0.1, 0.2])
    if shape == "two":
        block = block[:2, :2]
    elif shape == "turning":
        block[1:, 1:] = [[0.0, 1.5], [-1.5, 0.0]]
    else:
        block += np.diag([0.7, 0.4], 1)
    S = np.linalg.qr(rng.standard_normal(block.shape))[0] @ np.diag(10.0 ** rng.uniform(-1, 1, len(block)))
    plant = Plant(S @ block @ np.linalg.inv(S), rng.standard_normal((1, len(block))) @ np.linalg.inv(S))
    schedule = PeriodicSchedule([0.8, 0.5, 0.6])
    found = window_sigma(plant, schedule, window)
    assert found.closed
    start = found.witness.t - window
    assert found.upper == pytest.approx(float(sigma_at(plant, found.witness.samples, start, 250)), rel=1e-10)
    assert 0 < found.lower <= found.upper <= found.lower * (1 + 2e-3)
    times = schedule.between(0.0, 12.0).times
    for start in rng.uniform(schedule.first, schedule.first + schedule.period, 4):
        held = times[(times >= start) & (times <= start + window)]
        assert found.lower <= sigma_at(plant, held, mpmath.mpf(start), 250)


def test_what_no_window_sees_stays_zero_beside_growth():
    """A mode that no output observes: 0, and not what rounding leaves of it."""
    found = window_sigma(Plant(np.diag([30.0, -0.1]), [[1.0, 0.0]]), PeriodicSchedule([1.0]), 3.0)
    assert (found.lower, found.upper, found.status) == (0.0, 0.0, "below rounding")
    assert "zero to rounding" in found.explain()
