"""The paper's equivalence: solved anew at any t between samples, M_t = min(t, M + delta_t), nothing changes."""

import numpy as np
import pytest

from sampling_design import Constraints, Plant
from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.estimators.online.history import IncomingNode

PLANT = Plant([[0.0, 1.0, 0.0], [-1.0, -0.1, 0.3], [0.0, 0.0, 0.05]], [[1.0, 0.0, 0.5]], B=[[0.0], [1.0], [0.2]])


def resolved(mhe, t):
    """Solve the window problem from the last window's start to t, where nothing is measured."""
    start = mhe._start(mhe.state, mhe.state.last.t)
    nothing = np.zeros(PLANT.n_outputs)
    gap = mhe.loop.between(mhe.state, mhe.state.last.t, t)
    window = mhe._window(mhe.state, start, IncomingNode(t, RecordRow(t), nothing, nothing, nothing, *gap, False))
    return window, mhe._solve(window)


@pytest.mark.parametrize("cost", ["certificate", "paper"])
@pytest.mark.parametrize("bounds", [{}, {"constraints": Constraints(v=(-0.4, 0.4))}], ids=["free", "bounded v"])
def test_estimate_is_the_open_loop_from_the_last_solve_and_the_past_stays(cost, bounds):
    rng = np.random.default_rng(0)
    mhe = MovingHorizonEstimator(PLANT, horizon=3.0, cost=CostFunction(eta=0.4, form=cost), **bounds)
    t = 0.0
    for _ in range(12):
        gap = rng.uniform(0.3, 1.4)
        t += gap
        mhe.update(t, rng.normal(size=1), rng.normal(size=1))
        there = mhe._start(mhe.state, t)
        assert there.s == max(0.0, t - 3.0) or abs(there.s - (t - 3.0)) < 1e-9
        at_sample = resolved(mhe, t + 1e-9)[1]
        for delta in (0.2 * gap, gap, 2.5):
            window, again = resolved(mhe, t + delta)
            predicted = mhe.predict(t + delta)
            assert window.times[0] == there.s
            assert np.max(np.abs(again.nodes[-1] - predicted.x)) < 1e-9
            assert np.max(np.abs(again.nodes[0] - at_sample.nodes[0])) < 1e-7
            assert np.max(np.abs(again.covariance - predicted.covariance)) < 1e-9 * np.max(predicted.covariance)
            assert again.cost == pytest.approx(mhe.state.last.cost * np.exp(-0.4 * delta), rel=1e-9)
            drift = mhe.state.drift(mhe.table, t, t + delta)
            omega = again.nodes[-1] - PLANT.transition(delta) @ again.nodes[-2] - drift
            assert np.max(np.abs(omega)) < 1e-9


def test_the_maximum_in_the_printed_window_length_would_start_before_the_prior():
    """E2: with max{t, M + delta} the window of a young estimator starts before time 0; here it starts at 0."""
    mhe = MovingHorizonEstimator(PLANT, horizon=3.0, cost=CostFunction(eta=0.4))
    for t in (0.5, 1.0, 2.9, 3.5):
        assert mhe.update(t, [0.0]).window_start == pytest.approx(max(0.0, t - 3.0), abs=1e-12)
