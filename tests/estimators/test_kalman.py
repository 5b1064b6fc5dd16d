"""The filter's own behaviour: exact cases, refusals, lateness."""

import numpy as np
import pytest

from sampling_design import (
    KalmanFilter,
    PeriodicSchedule,
    Plant,
    Schedule,
    certify,
)
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_function import CostFunction
from sampling_design.estimators.online.estimator import Estimator
from tests.benchmarks.baselines import periodic_at_equal_cost, standard_mhe

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_without_discount_and_noise_it_is_least_squares():
    times, rng = np.array([0.4, 1.1, 2.0, 3.7]), np.random.default_rng(0)
    ys = rng.normal(size=(4, 1))
    plant = Plant(PLANT.A, PLANT.C, G=np.zeros((2, 0)))
    kalman = KalmanFilter(plant, cost=CostFunction(P2=0.5 * np.eye(2), R=[[2.0]], Qv=[[2.0]]), prior=[0.3, -0.1])
    record = kalman.run([(t, y, None) for t, y in zip(times, ys, strict=True)])
    O = np.vstack([plant.C @ plant.transition(t) for t in times])
    start = np.linalg.solve(0.5 * np.eye(2) + O.T @ O, 0.5 * np.array([0.3, -0.1]) + O.T @ ys[:, 0])
    assert np.allclose(record.x[-1], plant.transition(times[-1]) @ start, atol=1e-12)


def test_certificate_weights_are_used_and_both_estimators_keep_the_protocol():
    certificate = certify(PLANT, PeriodicSchedule([1.0]))
    kalman = KalmanFilter(PLANT, certificate)
    assert np.array_equal(kalman.weights.prior, certificate.P2)
    assert isinstance(kalman, Estimator)
    assert isinstance(standard_mhe(PLANT, 0.1, horizon=1.0)[0], Estimator)
    assert not kalman.update(1.0, [0.0]).on_schedule


def test_late_samples_need_lateness():
    kalman = KalmanFilter(PLANT)
    kalman.update(1.0, [0.1])
    with pytest.raises(ArgumentError, match="goes back beyond the window"):
        kalman.update(0.5, [0.1])
    patient = KalmanFilter(PLANT, maximum_delay=1.0)
    patient.update(1.0, [0.1])
    late, straight = patient.update(0.5, [0.1]), KalmanFilter(PLANT).run([(0.5, [0.1], None), (1.0, [0.1], None)])
    assert np.array_equal(late.x, straight.x[-1])
    with pytest.raises(ArgumentError, match="`maximum_delay` must not be negative"):
        KalmanFilter(PLANT, maximum_delay=-1.0)


def test_a_sample_before_everything_kept_cannot_be_replayed():
    kalman = KalmanFilter(PLANT, maximum_delay=1.0)
    for t in (1.0, 2.0, 3.0, 4.0):
        kalman.update(t, [0.1])
    assert kalman.state.nodes[0].t == 3.0
    with pytest.raises(ArgumentError, match="nothing before it to replay from"):
        kalman.step(kalman.state._replace(nodes=kalman.state.nodes[1:]), (4.0, None, np.zeros(0)))


def test_smoothing_nothing_gives_nothing():
    assert len(KalmanFilter(PLANT).smooth([])) == 0


def test_standard_estimator_with_dense_samples():
    mhe, schedule = standard_mhe(PLANT, 0.1, horizon=1.0, cost=CostFunction(eta=0.2))
    assert (mhe.weights.cost, schedule.period) == ("paper", 0.1)
    for t in schedule.between(0.0, 5.0).times:
        estimate = mhe.update(t, [np.cos(t)])
    assert np.max(np.abs(estimate.x - [np.cos(estimate.t), -np.sin(estimate.t)])) < 0.1
    with pytest.raises(ArgumentError, match="`horizon` must be at least one `period`"):
        standard_mhe(PLANT, 2.0, horizon=1.0)


def test_equal_cost_means_equal_number():
    schedule = PeriodicSchedule([0.5, 3.0, 0.5, 2.0])
    regular = periodic_at_equal_cost(schedule)
    assert len(regular.between(0.0, 60.0, "right")) == len(schedule.between(0.0, 60.0, "right"))
    assert periodic_at_equal_cost(Schedule([1.0, 2.0, 5.0])).gaps[0] == 2.0
    with pytest.raises(ArgumentError, match="`schedule` must hold at least two samples"):
        periodic_at_equal_cost(Schedule([1.0]))
