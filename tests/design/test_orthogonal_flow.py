"""Windows of plants whose flow stretches nothing, a smooth bound of their least eigenvalue, and where it leads."""

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.orthogonal_flow import UNSURE
from sampling_design.design.problem.positions import _worst_of_positions, worst_sigma2
from sampling_design.design.search import smooth
from sampling_design.design.search.fedorov_exchange import at_shares, is_admissible, refined
from sampling_design.design.search.rotations import exchanged_hours
from sampling_design.design.search.smooth import smoothed
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.oracles.design import random_schedule

TURN = [[0.0, 1.0], [-1.0, 0.0]]
Q = np.linalg.qr(np.random.default_rng(2).normal(size=(5, 5)))[0]
A = np.zeros((5, 5))
A[:2, :2], A[2:4, 2:4] = np.array(TURN), 1.7 * np.array(TURN)
A = Q @ A @ Q.T  # two oscillators and a constant, in coordinates that mix them
C = np.random.default_rng(3).normal(size=(2, 5))


def problem(plant=None, **changes):
    given = {"window": 6.0, "period": 6.0, "spacing": 0.2, "samples": 7}
    own = Plant(A, C) if plant is None else plant
    none = {"forbidden": np.zeros((0, 2)), "fixed": np.zeros(0), "available": (None,) * own.n_outputs}
    return DesignProblem(own, **(given | none | changes))


def plain(times, mask, window, period):
    """The least eigenvalue over windows [a, a + T) that begin at each sample, seen from there, term by term."""
    least = np.inf
    for a in times:
        W = np.zeros((5, 5))
        for t, seen in zip(times, mask, strict=True):
            for cycle in range(-3, 4):
                lag = t + cycle * period - a
                if -1e-9 < lag < window - 1e-9:
                    row = C[seen] @ expm(A * lag)
                    W += row.T @ row
        least = min(least, np.linalg.eigvalsh(W)[0])
    return least


@pytest.mark.parametrize(("window", "period"), [(6.0, 6.0), (6.0, 3.0), (6.0, 2.0)])
def test_every_window_is_the_plain_sum_and_no_window_between_samples_sees_less(window, period):
    rng = np.random.default_rng(4)
    case = problem(window=window, period=period)
    times = np.array([random_schedule(rng, period, 0.1, 7) for _ in range(5)])
    used = rng.random((5, 7, 2)) < 0.8
    assert case.orthogonal_flow is not None
    found, sure = case.orthogonal_flow.worst(times, used)
    assert sure.all()
    for b in range(5):
        assert found[b] == pytest.approx(plain(times[b], used[b], window, period), rel=1e-9)
    every = _worst_of_positions(case, times, 5, used)
    np.testing.assert_allclose(found, every, rtol=1e-6)
    np.testing.assert_array_equal(found, worst_sigma2(case, times, used=used))


def test_a_batch_is_its_schedules_one_by_one(monkeypatch):
    monkeypatch.setattr("sampling_design.design.problem.orthogonal_flow.BATCH_NUMBERS", 400)
    rng, case = np.random.default_rng(5), problem()
    times = np.array([random_schedule(rng, 6.0, 0.2, 7) for _ in range(9)])
    np.testing.assert_allclose(worst_sigma2(case, times), [worst_sigma2(case, t[None])[0] for t in times], rtol=1e-12)


def test_flows_that_stretch_and_windows_of_no_whole_number_of_periods_have_none():
    assert problem().orthogonal_flow is not None
    for changes in ({"window": 7.0}, {"window": 3.0}, {"period": 6.0 * (1 + 1e-9)}):
        assert problem(**changes).orthogonal_flow is None
    scaled = np.diag([1.0, 2.0])
    for stretched in (np.array(TURN) + 1e-9 * np.eye(2), scaled @ TURN @ np.linalg.inv(scaled), np.eye(2, k=1)):
        assert problem(Plant(stretched, [[1.0, 0.0]])).orthogonal_flow is None


def test_what_has_lost_its_digits_is_worked_out_the_other_way():
    close = Plant(np.kron(np.diag([1.0, 1.001, 1.002]), TURN), np.tile([[1.0, 0.0]], 3))
    case = problem(close)
    times = np.array([random_schedule(np.random.default_rng(6), 6.0, 0.2, 7)])
    least, sure = case.orthogonal_flow.worst(times, case.mask(times))
    assert not sure.any()
    assert worst_sigma2(case, times)[0] == _worst_of_positions(case, times, 1, None)[0] != least[0]
    blind = problem(Plant(TURN, [[1.0, 0.0]]), window=np.pi, period=np.pi, samples=1)
    assert worst_sigma2(blind, np.array([[0.3]]))[0] == 0.0
    assert 0 < UNSURE < 1


@pytest.mark.parametrize("period", [6.0, 3.0])
def test_the_smooth_function_lies_just_below_and_its_slope_is_its_own(period):
    case = problem(period=period)
    times = random_schedule(np.random.default_rng(7), period, 0.1, 7)
    mask = np.random.default_rng(8).random((7, 2)) < 0.8
    least = float(case.orthogonal_flow.worst(times[None], mask[None])[0][0])
    for sharpness in (0.1, 5.0):
        value, slope = case.orthogonal_flow.soft(times, mask, sharpness)
        assert least - np.log(7 * 5) / sharpness <= value < least
        step = 1e-6 * np.eye(7)
        either = [[case.orthogonal_flow.soft(times + s * e, mask, sharpness)[0] for s in (1, -1)] for e in step]
        np.testing.assert_allclose(slope, [(a - b) / 2e-6 for a, b in either], atol=1e-5 * np.abs(slope).max())


@pytest.mark.long
@pytest.mark.parametrize(
    "changes",
    few(
        [
            {},
            {"fixed": np.array([1.0, 4.0])},
            {"forbidden": np.array([[0.0, 1.0], [2.5, 3.0]])},
            {"available": (None, np.array([[1.0, 2.0], [4.0, 5.0]]))},
            {"spacing": 0.8},
        ],
        0,
    ),
)
def test_it_leads_as_far_as_semidefinite_programs_mostly_and_keeps_to_what_is_asked(changes):
    case, rng = problem(**changes), np.random.default_rng(9)
    ratios = []
    while len(ratios) < 5:
        times = at_shares(case, rng.uniform(size=7 - case.fixed.size))
        if times is None or not is_admissible(case, times):
            continue
        before = float(worst_sigma2(case, times[None])[0])
        near = smoothed(case, case.orthogonal_flow, times)
        assert is_admissible(case, near)
        ratios.append(float(worst_sigma2(case, near[None])[0]) / refined(case, times, before)[1])
    assert np.median(ratios) > 0.97


def test_what_is_not_wanted_is_left_early_and_a_deadline_is_kept():
    case = problem()
    times = random_schedule(np.random.default_rng(10), 6.0, 0.2, 7)
    assert smoothed(case, case.orthogonal_flow, times, wanted=1e3) is None
    late = smoothed(case, case.orthogonal_flow, times, budget=Budget(-1.0))
    np.testing.assert_array_equal(late, times)
    crowded = problem(spacing=0.85)
    assert smooth._crowding(crowded, times)[0] > 0


def test_samples_that_show_nothing_lead_nowhere():
    dark = problem(Plant(A, [np.zeros(5), C[1]]), available=(None, np.array([[5.0, 6.0]])))
    assert smoothed(dark, dark.orthogonal_flow, np.linspace(0.1, 3.0, 7)) is None


def test_two_times_of_day_are_exchanged_and_the_days_stay():
    closed = np.array([[d + 0.0, d + 0.4] for d in range(6)])
    case = problem(forbidden=closed, spacing=0.05, samples=6)
    times = np.arange(6) + np.array([0.45, 0.5, 0.6, 0.7, 0.8, 0.9])
    found = exchanged_hours(case, times, 1, 4)
    np.testing.assert_allclose(found, np.arange(6) + np.array([0.45, 0.8, 0.6, 0.7, 0.5, 0.9]), atol=1e-9)
    tight = problem(forbidden=closed, spacing=0.99, samples=6)
    assert exchanged_hours(tight, np.arange(6) + 0.5, 0, 1) is not None
