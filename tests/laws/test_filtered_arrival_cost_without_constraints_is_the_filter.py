"""An estimator that carries Pi(t - M) as the prior's weight is, without constraints, the filter of all samples."""

import numpy as np
import pytest

from sampling_design import KalmanFilter, Plant
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from tests.cases import few
from tests.oracles.estimators import discounted_kalman

A, C, G = np.array([[0.0, 1.0], [-1.0, -0.2]]), np.array([[1.0, 0.0], [0.5, 1.0]]), np.array([[0.0], [1.0]])
PLANT = Plant(A, C, B=[[1.0], [0.0]], D=[[0.0], [0.3]], G=G)
WEIGHTS = {"P2": np.eye(2), "Qw": [[1.0]], "R": 2 * np.eye(2), "Qv": 2 * np.eye(2)}
BOUNDS = {"w_bound": 0.5, "v_bound": [0.3, 0.4], "initial_error": [1.0, 2.0]}


def record(seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.2, 1.3, 16))
    ys, us = rng.normal(size=(16, 2)), rng.normal(size=(17, 1))
    ys[rng.random((16, 2)) < 0.3] = np.nan
    ys[np.isnan(ys).all(axis=1), 1] = 0.2
    return times, ys, us


@pytest.mark.parametrize("horizon", [0.9, 2.0, 5.0])
@pytest.mark.parametrize("eta", [0.0, 0.4])
def test_state_covariance_and_radius_agree(horizon, eta):
    times, ys, us = record(0)
    wide = {"w_bound": 2.0, "v_bound": [4.0, 5.0], "initial_error": [3.0, 4.0]}
    cost = CostFunction(eta=eta, arrival="filtered", **WEIGHTS)
    mhe = MovingHorizonEstimator(PLANT, horizon=horizon, cost=cost, **wide)
    kalman = KalmanFilter(PLANT, cost=CostFunction(eta=eta, **WEIGHTS), **wide)
    weights = kalman.weights
    for estimator in (mhe, kalman):
        estimator.update(0.0, None, us[0])
    for k, (t, y) in enumerate(zip(times, ys, strict=True)):
        a, b = mhe.update(t, y, us[k + 1]), kalman.update(t, y, us[k + 1])
        inputs = (PLANT.B, PLANT.D, us)
        arguments = (weights.prior, weights.w, weights.y, eta, [0.0, 0.0], 0.0, times[: k + 1], ys[: k + 1])
        x, Y, cost = discounted_kalman(A, C, G, *arguments, inputs=inputs)
        for estimate in (a, b):
            assert np.max(np.abs(estimate.x - x)) < 1e-10
            assert np.max(np.abs(estimate.covariance - Y)) < 1e-10 * np.max(Y)
        assert b.cost == pytest.approx(cost, rel=1e-10, abs=1e-12)
        assert a.radius == pytest.approx(b.radius, rel=1e-8)


def test_smoother_is_the_endless_window_and_its_last_estimate_the_filters():
    times, ys, us = record(1)
    rows = [(0.0, None, us[0]), *zip(times, ys, us[1:], strict=True)]
    kalman = KalmanFilter(PLANT, cost=CostFunction(eta=0.2), **BOUNDS)
    smoothed = kalman.smooth(rows)
    assert kalman.state.last.t == 0.0
    filtered = kalman.run(rows)
    assert np.max(np.abs(smoothed.x[-1] - filtered.x[-1])) < 1e-10
    mhe = MovingHorizonEstimator(PLANT, horizon=1e3, cost=CostFunction(eta=0.2), **BOUNDS)
    kept, solve = [], mhe._solve
    mhe._slid_window = lambda *_: (None, None)  # the whole window is wanted
    mhe._solve = lambda window: kept.append(solve(window)) or kept[-1]
    mhe.run(rows)
    assert np.max(np.abs(smoothed.x - kept[-1].nodes[1:])) < 1e-9


@pytest.mark.parametrize("eta", few([0.0, 0.3], 1))
def test_smoothed_ellipsoids_hold_the_whole_past(eta):
    rng = np.random.default_rng(3)
    plant = Plant(A, C, G=G)
    x, t, rows, truth = np.array([0.8, -1.5]), 0.0, [], []
    for _ in range(15):
        h = rng.uniform(0.2, 1.0)
        w = 0.5 * rng.choice([-1.0, 1.0], 1)
        x = plant.transition(h) @ x + np.linalg.solve(A, (plant.transition(h) - np.eye(2)) @ G @ w)
        t += h
        truth.append(x)
        rows.append((t, C @ x + [0.3, -0.4] * rng.choice([-1.0, 1.0], 2), None))
    found = KalmanFilter(plant, cost=CostFunction(eta=eta), **BOUNDS).smooth(rows)
    assert found.certified.all()
    for k, state in enumerate(truth):
        error = state - found.x[k]
        assert error @ np.linalg.solve(found.covariance[k], error) <= found.radius[k]
        assert np.all(np.abs(error) <= found.radii[k])
    variances = np.trace(found.covariance, axis1=1, axis2=2)
    filtered = KalmanFilter(plant, cost=CostFunction(eta=eta), **BOUNDS).run(rows)
    own = np.exp(eta * (t - found.times)) * np.trace(filtered.covariance, axis1=1, axis2=2)
    assert np.all(variances <= own * (1 + 1e-9))


@pytest.mark.parametrize("arrival", ["fixed", "filtered"])
def test_a_horizon_whose_beginning_has_no_weight_is_the_filter_too(arrival):
    plant = Plant([[0.0, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])
    rng = np.random.default_rng(3)
    rows = [(float(t), rng.normal(size=1)) for t in np.cumsum(rng.uniform(0.5, 1.5, 60))]
    mhe = MovingHorizonEstimator(plant, horizon=1e9, cost=CostFunction(eta=8.0, arrival=arrival))
    assert mhe.horizon == 240.0 / 8.0 < rows[-1][0] / 1.9
    found, filtered = mhe.run(rows), KalmanFilter(plant, cost=CostFunction(eta=8.0)).run(rows)
    np.testing.assert_allclose(found.x, filtered.x, rtol=0, atol=1e-9 * np.abs(filtered.x).max())
    np.testing.assert_allclose(found.covariance, filtered.covariance, rtol=1e-9, atol=1e-9)
