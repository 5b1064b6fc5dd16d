"""Law: the covariance of a filter that loses samples by chance has the tails that `loss_tolerance` proves."""

import re
from itertools import combinations

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from sampling_design import PeriodicSchedule, Plant
from sampling_design.observability.count import loss_tolerance as room
from sampling_design.observability.count.loss_tolerance import loss_tolerance
from tests.cases import few
from tests.rescale import Units

QUARTER = np.pi / 2
EVEN, UNEVEN = np.full(4, QUARTER), QUARTER * np.array([0.6, 1.1, 0.8, 1.5])
SPIRAL = Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])


def tail_exponent(gaps, p, rng, runs=9000, periods=60):
    """Hill's estimate of k in P(trace > x) ~ x^-k, of a filter that loses each sample with probability p."""
    P, seen = np.tile(np.eye(2), (runs, 1, 1)), []
    flows = [expm(SPIRAL.A * gap) for gap in gaps]
    for period in range(periods):
        for F in flows:
            P = F @ P @ F.T + 0.01 * np.eye(2)
            gain = P[:, :, 0] / (P[:, 0, 0] + 1)[:, None]
            received = rng.random(runs) >= p
            P = P - received[:, None, None] * (gain[:, :, None] * P[:, 0, :][:, None, :])
        if period >= periods // 2:
            seen.append(np.log(np.trace(P, axis1=1, axis2=2)))
    logs = np.sort(np.concatenate(seen))[::-1]
    high, low = logs.size // 3000, logs.size // 300
    return np.log(low / high) / (logs[high] - logs[low])


@pytest.mark.parametrize(("gaps", "borne"), few([(EVEN, 0.533488), (UNEVEN, 0.657784)], 0), ids=["even", "uneven"])
def test_tails_are_as_heavy_as_the_tolerance_says(gaps, borne):
    found = loss_tolerance(SPIRAL, PeriodicSchedule(gaps))
    assert found.lower == pytest.approx(borne, rel=1e-5) == found.upper
    assert found.limit == pytest.approx(np.exp(-0.1 * np.pi))
    rng = np.random.default_rng(7)
    for p in (0.5,):
        # the expectation of x with tail exponent k is finite exactly where k > 1
        assert tail_exponent(gaps, p, rng) == pytest.approx(np.log(p) / np.log(found.lower), rel=0.12)


def test_hidden_sets_are_those_of_all_subsets():
    rng = np.random.default_rng(3)
    for case in range(12):
        n, N = 2 + case % 2, 7
        rows = rng.standard_normal((N, 1, n))
        rows[1], rows[4] = rows[0], -rows[0]  # three that see the same
        if n == 3:
            rows[5] = rows[0] + rows[2]
        rows /= np.linalg.norm(rows, axis=2, keepdims=True)
        most = max(
            size
            for size in range(N + 1)
            for chosen in combinations(range(N), size)
            if not size or np.linalg.matrix_rank(rows[list(chosen), 0], tol=1e-9) < n
        )
        found = room.largest_hidden(rows)
        assert len(found) == most
        assert np.linalg.matrix_rank(rows[sorted(found), 0], tol=1e-9) < n


@pytest.mark.parametrize("seed", range(4))
def test_units_change_nothing(seed):
    rng = np.random.default_rng(seed)
    units = Units.drawn(rng, SPIRAL)
    for gaps in (EVEN, UNEVEN):
        plain = loss_tolerance(SPIRAL, PeriodicSchedule(gaps))
        other = loss_tolerance(units.plant(SPIRAL), units.schedule(PeriodicSchedule(gaps)))
        for name in ("lower", "upper", "limit"):
            assert getattr(other, name) == pytest.approx(getattr(plain, name), rel=1e-6)


def test_more_samples_never_bear_less():
    for k in (1, 2, 3):
        fewer = loss_tolerance(SPIRAL, PeriodicSchedule.from_times(np.linspace(0.1, 5.7, 2 * k), 2 * np.pi))
        more = loss_tolerance(
            SPIRAL, PeriodicSchedule.from_times(np.sort([*np.linspace(0.1, 5.7, 2 * k), 3.21]), 2 * np.pi)
        )
        assert more.limit > fewer.limit
        assert more.lower >= fewer.lower


def test_samples_that_all_miss_one_direction_bear_nothing():
    blind = loss_tolerance(SPIRAL, PeriodicSchedule([np.pi]))
    assert blind.lower == blind.upper == 0
    assert "No probability" in blind.explain()


def test_without_growth_any_loss_is_borne():
    integrator = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    found = loss_tolerance(integrator, PeriodicSchedule([1.0]))
    assert found.lower == found.upper == 1
    assert "No mode grows" in found.explain()
    assert loss_tolerance(Plant([[-1.0]], [[1.0]]), PeriodicSchedule([1.0])).lower == 1
    assert set(found.to_dict()) >= {"lower", "upper", "limit", "hidden_times", "claim"}


@pytest.mark.parametrize("frequency", [1e3, 1e7, 1e10])
def test_what_oscillates_fast_hides_no_growth_beside_it(frequency):
    A = np.zeros((3, 3))
    A[0, 0], A[1, 2], A[2, 1] = 0.1, frequency, -frequency
    found = loss_tolerance(Plant(A, [[1.0, 1.0, 0.0]]), PeriodicSchedule([0.3, 0.7, 0.45]))
    assert found.growth == pytest.approx(0.1)
    assert found.lower <= found.limit == pytest.approx(np.exp(-2 * 0.1 * 1.45 / 3))


@pytest.mark.parametrize("growth", [1e-6, 1e-8, 1e-12])
def test_certain_is_said_of_no_probability_below_1(growth):
    found = loss_tolerance(Plant([[growth]], [[1.0]]), PeriodicSchedule([0.3, 0.7, 0.45]))
    assert found.lower < 1
    for text in (found.explain(), repr(found), found.claim.statement):
        numbers = re.findall(r"(?:below|from) (\d[\d.]*)", text)
        assert numbers
        assert all(float(number.rstrip(".")) < 1 for number in numbers)


def test_an_output_that_is_measured_seldom_is_hidden_more_often():
    plant = Plant(np.diag([0.1, 0.2]), np.eye(2))
    both = loss_tolerance(plant, PeriodicSchedule([1.0, 1.0]))
    one = loss_tolerance(plant, PeriodicSchedule([1.0, 1.0], outputs=[[True, True], [True, False]]))
    assert both.lower == pytest.approx(np.exp(-0.4))
    assert one.lower == pytest.approx(np.exp(-0.8))  # the second mode is seen by every other sample
    assert one.upper == pytest.approx(np.exp(-0.8))


def test_too_many_sets_leave_the_zero_count(monkeypatch):
    monkeypatch.setattr(room, "LOOKS", 2)
    found = loss_tolerance(SPIRAL, PeriodicSchedule(EVEN))
    assert found.periods == 0
    assert found.lower == pytest.approx(0.533488, rel=1e-5)
    assert found.upper == found.limit


def turned(seed, blocks, C):
    """The plant of the blocks in other coordinates: as they are, mixed, or in units far apart."""
    rng, A = np.random.default_rng([29, seed]), block_diag(*blocks)
    T = np.eye(len(A)) if seed % 3 == 0 else rng.standard_normal(A.shape)
    T = T * 10.0 ** (seed % 3 // 2 * rng.integers(-3, 4, (len(A), 1)))
    back = np.linalg.inv(T)
    return Plant(T @ A @ back, C @ back)


SPIRALS = {growth: np.array([[growth, 2.0], [-2.0, growth]]) for growth in (0.0, 0.1)}
HALF_TURNS = [1], [1, 1], [3, 1]


@pytest.mark.parametrize("seed", few(range(12), 1))
def test_samples_half_turns_apart_bear_nothing_however_many_there_are(seed):
    for growth, spiral in SPIRALS.items():
        for turns, beside in zip(HALF_TURNS, ([], [[[-0.3]]], [[[growth / 2]]]), strict=True):
            C = np.array([[1.0, 0.0] + [0.7] * len(beside)])
            plant = turned(seed, [spiral, *beside], C)
            found = loss_tolerance(plant, PeriodicSchedule(QUARTER * np.array(turns), first=0.3))
            assert found.lower == 0
            assert not growth or found.upper == 0


@pytest.mark.parametrize("seed", few(range(60), 35))
def test_an_output_that_shows_what_decays_alone_bears_no_more(seed):
    seen, blind = [0.5, 0.3, -0.2], [0.0, 0.4, 0.9]
    plant = turned(seed, [[[0.1]], SPIRALS[0.0] - 0.3 * np.eye(2)], np.array([seen, blind]))
    found = loss_tolerance(plant, PeriodicSchedule([0.5, 0.8], outputs=[[True, True], [False, True]]))
    assert found.lower == found.upper == pytest.approx(np.exp(-0.2 * 1.3))


@pytest.mark.parametrize("unit", [2.0**-30, 2.0**20, 2.0**30])
def test_a_chain_tolerates_the_same_losses_in_any_unit_of_time(unit):
    """Nothing but the schedule says how fast a chain of integrators is."""
    A, C, gaps = np.diag([1.0, 1.0], 1), [[1.0, 0.3, -0.2], [0.5, -1.0, 0.7]], np.array([0.3125, 0.6875, 0.8125])
    seen = [[0, 1], [1, 1], [1, 0]]
    here = loss_tolerance(Plant(A, C), PeriodicSchedule(gaps, outputs=seen))
    there = loss_tolerance(Plant(A / unit, C), PeriodicSchedule(gaps * unit, outputs=seen))
    assert (there.lower, there.upper) == (here.lower, here.upper) == (1.0, 1.0)
