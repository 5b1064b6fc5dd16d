"""Without constraints the moving horizon estimate is the discounted Kalman filter's, started at the window's prior."""

from itertools import product

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from tests.cases import few
from tests.oracles.estimators import discounted_kalman, fine_grid

ETA = 0.3


def weights(rng, n, q, p):
    def positive(k, size=1.0):
        M = rng.normal(size=(k, k))
        return size * (M @ M.T + np.eye(k))

    return {"P2": positive(n), "Qw": positive(q), "R": positive(p, 5.0), "Qv": positive(p, 3.0)}


def parallel(R, Qv):
    return np.linalg.inv(np.linalg.inv(R) + np.linalg.inv(Qv))


PLANTS = {
    "oscillator": ([[0, 1], [-1, 0]], [[1, 0]], np.eye(2)),
    "double integrator, force noise": ([[0, 1], [0, 0]], [[1, 0]], [[0], [1]]),
    "unreached mode": ([[-0.2, 0, 0], [0, 0, 1], [0, -4, -0.1]], [[1, 1, 0]], [[0], [0], [1]]),
    "unstable": ([[0.6, 1, 0], [-1, 0.6, 0.2], [0, 0, -1]], [[1, 0, 1], [0, 1, 0]], np.eye(3)),
    "stiff": ([[-80, 1], [0, 0.1]], [[1, 1]], np.eye(2)),
}


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("cost", few(["certificate", "paper"], 0))
def test_a_window_that_holds_everything_is_the_filter(name, cost):
    A, C, G = (np.array(M, float) for M in PLANTS[name])
    rng = np.random.default_rng(3)
    plant = Plant(A, C, G=G)
    chosen = weights(rng, A.shape[0], G.shape[1], C.shape[0])
    prior = rng.normal(size=A.shape[0])
    mhe = MovingHorizonEstimator(plant, horizon=100.0, cost=CostFunction(eta=ETA, form=cost, **chosen), prior=prior)
    times = np.cumsum(rng.uniform(0.2, 1.5, 9))
    ys = rng.normal(size=(9, C.shape[0]))
    if C.shape[0] > 1:
        ys[2, 0] = ys[5, 1] = np.nan
    twice = 2.0 if cost == "paper" else 1.0
    P2, Qw, Rt = twice * chosen["P2"], twice * chosen["Qw"], parallel(chosen["R"], twice * chosen["Qv"])
    for k in range(9):
        estimate = mhe.update(times[k], ys[k])
        x, Y, value = discounted_kalman(A, C, G, P2, Qw, Rt, ETA, prior, 0.0, times[: k + 1], ys[: k + 1])
        assert np.max(np.abs(estimate.x - x)) <= 1e-10 * max(1.0, np.max(np.abs(x)))
        assert np.max(np.abs(estimate.covariance - Y)) <= 1e-10 * np.max(np.abs(Y))
        assert estimate.cost == pytest.approx(value, rel=1e-10, abs=1e-12)
        assert np.max(np.abs(estimate.Pi @ Y - np.eye(len(x)))) <= 1e-8


@pytest.mark.parametrize(
    ("name", "cost", "begins"), few(product(PLANTS, ["certificate", "paper"], ["horizon", "sample"]), 0, 5, 10, 15)
)
def test_each_window_is_the_filter_from_the_online_estimate_at_its_start(name, cost, begins):
    A, C, G = (np.array(M, float) for M in PLANTS[name])
    rng = np.random.default_rng(4)
    chosen = weights(rng, A.shape[0], G.shape[1], C.shape[0])
    horizon = 3.1
    weighed = CostFunction(eta=ETA, form=cost, begins=begins, **chosen)
    mhe = MovingHorizonEstimator(Plant(A, C, G=G), horizon=horizon, cost=weighed)
    times = np.cumsum(rng.uniform(0.2, 1.5, 14))
    ys = rng.normal(size=(14, C.shape[0]))
    twice = 2.0 if cost == "paper" else 1.0
    P2, Qw, Rt = twice * chosen["P2"], twice * chosen["Qw"], parallel(chosen["R"], twice * chosen["Qv"])
    for k in range(14):
        start = max(0.0, times[k] - horizon)
        if begins == "sample":
            start = max([0.0, *times[times <= start]])
        prior = mhe.predict(start).x
        estimate = mhe.update(times[k], ys[k])
        closed = cost == "paper" and begins == "sample" and start > 0
        inside = ((times > start) | (closed & (times == start))) & (times <= times[k])
        x, Y, value = discounted_kalman(A, C, G, P2, Qw, Rt, ETA, prior, start, times[inside], ys[inside])
        assert estimate.window_start == pytest.approx(start, abs=1e-12)
        assert np.max(np.abs(estimate.x - x)) <= 1e-10 * max(1.0, np.max(np.abs(x)))
        assert np.max(np.abs(estimate.covariance - Y)) <= 1e-10 * np.max(np.abs(Y))
        assert estimate.cost == pytest.approx(value, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("cost", few(["certificate", "paper"], 1))
def test_the_fine_grid_with_explicit_w_and_v_comes_closer_as_the_square_of_its_step(cost):
    A, C, G = (np.array(M, float) for M in PLANTS["oscillator"])
    rng = np.random.default_rng(5)
    chosen = weights(rng, 2, 2, 1)
    prior, times, ys = np.array([1.0, -1.0]), [0.7, 1.9, 2.6], rng.normal(size=(3, 1))
    mhe = MovingHorizonEstimator(
        Plant(A, C, G=G), horizon=10.0, cost=CostFunction(eta=0.8, form=cost, **chosen), prior=prior
    )
    for t, y in zip(times, ys, strict=True):
        estimate = mhe.update(t, y)
    errors = []
    for steps in (4, 8, 16):
        x, value = fine_grid(
            A,
            C,
            G,
            chosen["P2"],
            chosen["Qw"],
            chosen["R"],
            chosen["Qv"],
            0.8,
            prior,
            0.0,
            times,
            ys,
            steps,
            twice=cost == "paper",
        )
        errors.append([np.max(np.abs(x - estimate.x)), abs(value - estimate.cost)])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(np.abs(orders - 2) < 0.25)
    assert errors[-1][0] < 2e-3


@pytest.mark.parametrize(("cost", "first"), [("certificate", 1), ("paper", 0)])
def test_a_window_that_starts_at_a_sample_is_half_open_or_closed_as_its_cost_says(cost, first):
    """Period .1, horizon .6: t - M falls on a sample although neither is a binary fraction."""
    A, C, G = (np.array(M, float) for M in PLANTS["oscillator"])
    rng = np.random.default_rng(6)
    chosen = weights(rng, 2, 2, 1)
    mhe = MovingHorizonEstimator(Plant(A, C, G=G), horizon=0.6, cost=CostFunction(eta=ETA, form=cost, **chosen))
    times, ys = 0.1 * np.arange(1, 25), rng.normal(size=(24, 1))
    twice = 2.0 if cost == "paper" else 1.0
    P2, Qw, Rt = twice * chosen["P2"], twice * chosen["Qw"], parallel(chosen["R"], twice * chosen["Qv"])
    for k in range(24):
        estimate = mhe.update(times[k], ys[k])
        if k >= 6:
            prior = mhe.predict(times[k - 6]).x
            inside = slice(k - 6 + first, k + 1)
            x, Y, _ = discounted_kalman(A, C, G, P2, Qw, Rt, ETA, prior, times[k - 6], times[inside], ys[inside])
            assert np.max(np.abs(estimate.x - x)) <= 1e-10 * max(1.0, np.max(np.abs(x)))
            assert np.max(np.abs(estimate.covariance - Y)) <= 1e-10 * np.max(np.abs(Y))
