"""The filter's own behaviour: exact cases, refusals, lateness."""

import gc
from collections import Counter
from types import FunctionType, ModuleType

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import (
    KalmanFilter,
    PeriodicSchedule,
    Plant,
    Schedule,
    certify,
)
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.gap_flows.flows import GapFlow
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.estimator import Estimator
from sampling_design.estimators.online.evidence import REMEMBERED
from sampling_design.estimators.online.history import HistoryNode
from tests.benchmarks.baselines import periodic_at_equal_cost, standard_mhe
from tests.cases import few

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
    certificate = certify(PLANT, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2))
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


@pytest.mark.parametrize(
    "bounds", few([{}, {"w_bound": 1.0, "v_bound": 1.0, "initial_error": 1e-3}], 0), ids=["none", "all"]
)
def test_smoothing_begins_at_the_prior_whatever_the_filter_has_taken_in_since(bounds):
    """The oldest node that is kept is none: its error is not bounded as that of the prior is."""
    walk, record = sd.Plant([[0.0]], [[1.0]]), [(float(t), [t - 1.0]) for t in range(1, 41)]
    fresh, used = sd.KalmanFilter(walk, **bounds), sd.KalmanFilter(walk, **bounds)
    used.run(record)
    assert used.state.nodes[0].number > 0
    for rows in (record, [(40.1, [39.1]), (40.2, [39.2])]):
        a, b = fresh.smooth(rows), used.smooth(rows)
        assert np.array_equal(a.x, b.x)
        assert np.array_equal(a.covariance, b.covariance)
        assert np.array_equal(a.radii, b.radii)
        if bounds:
            assert all(each.certified and each.holds([each.t]) for each in b)
    used.start([5.0], 39.0)
    assert used.smooth([(40.0, [5.0])]).x == pytest.approx(
        sd.KalmanFilter(walk, prior=[5.0], prior_time=39.0, **bounds).run([(40.0, [5.0])]).x
    )


@pytest.mark.parametrize("turned", [False, True])
def test_smoothing_looks_back_past_a_gap_over_which_states_decay_beyond_numbers(turned):
    """Modes that share nothing are smoothed each by itself in any coordinates; fast ones by what came before a gap."""
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0] if turned else np.eye(3)
    A, G = np.diag([-1000.0, -1.0, -300.0]), np.array([[0.0], [1.0], [0.0]])
    all_three, slow = sd.Plant(Q @ A @ Q.T, Q.T, G=Q @ G), sd.Plant([[-1.0]], [[1.0]])
    record = [(0.0, [0.5, 0.2, 0.1]), (0.001, [0.2, 0.2, 0.1]), (1.0, [0.0, 0.1, 0.0]), (2.0, [0.0, 0.05, 0.0])]

    def smoothed(plant, rows, Q):
        n = plant.n_states
        cost = sd.CostFunction(P2=np.eye(n), Qw=[[1.0]], R=9 * np.eye(n), Qv=9 * np.eye(n), eta=0.1)
        found = sd.KalmanFilter(plant, cost=cost, w_bound=0.1, v_bound=np.full(n, 0.1), initial_error=np.ones(n))
        record = found.smooth(rows)
        return record.x @ Q, np.einsum("ji,kjl,li->ki", Q, record.covariance, Q)

    (x, own), (few, others) = smoothed(all_three, record, Q), smoothed(all_three, record[:2], Q)
    alone, variance = smoothed(slow, [(t, y[1:2]) for t, y in record], np.eye(1))
    discount = np.exp(0.1 * (2.0 - 0.001))  # covariances are in units of the last sample
    assert x[:, 1] == pytest.approx(alone[:, 0], rel=1e-9)
    assert own[:, 1] == pytest.approx(variance[:, 0], rel=1e-9)
    assert x[:2, [0, 2]] == pytest.approx(few[:, [0, 2]], rel=1e-9)
    assert own[:2, [0, 2]] == pytest.approx(discount * others[:, [0, 2]], rel=1e-9)


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


@pytest.mark.parametrize("unit", [1.0, 1e-12, 1e12])
@pytest.mark.parametrize("kind", [sd.MovingHorizonEstimator, sd.KalmanFilter])
def test_weights_are_those_of_the_bounds_that_are_given(kind, unit):
    """A first error of 3 and noise of .3: the data say [.9, 1.5], and the estimate lies near the middle."""
    more = {"horizon": 5.0} if kind is sd.MovingHorizonEstimator else {}
    bounds = {"w_bound": 0.01 * unit, "v_bound": 0.3 * unit, "initial_error": 3.0 * unit}
    found = kind(sd.Plant([[0.0]], [[1.0]]), **more, **bounds).update(0.0, [1.2 * unit])
    assert abs(found.x[0] / unit - 1.2) < 0.05 * 0.3
    assert found.radii[0] / unit < 1.05 * 0.3
    assert found.centred().x[0] / unit == pytest.approx(1.2, abs=1e-6)


def test_weights_of_the_bounds_are_those_that_one_may_write_out():
    plant, bounds = sd.named_plant("oscillator"), {"w_bound": 0.1, "v_bound": [0.2], "initial_error": [1.0, 2.0]}
    by_hand = sd.CostFunction(**sd.certificates.weights_from_bounds(plant, 0.5, **bounds), eta=0.5)
    schedule = sd.PeriodicSchedule([0.7, 1.1])
    record = sd.simulate_record(plant, schedule, 6.0, w_bound=0.1, v_bound=[0.2], rng=1).measurements
    one, two = (
        sd.MovingHorizonEstimator(plant, horizon=4.0, cost=cost, **bounds).run(record)
        for cost in (by_hand, sd.CostFunction(eta=0.5))
    )
    np.testing.assert_array_equal(one.x, two.x)
    weights = sd.MovingHorizonEstimator(plant, horizon=4.0, w_bound=0.0, v_bound=1e150, initial_error=2.0).weights
    assert (weights.w.tolist(), weights.prior.tolist()) == (np.eye(2).tolist(), (np.eye(2) / 4).tolist())


def test_estimators_show_themselves():
    mhe = sd.MovingHorizonEstimator(sd.named_plant("oscillator"), horizon=5.0, w_bound=0.1, v_bound=[0.1])
    assert repr(mhe) == "MovingHorizonEstimator(plant=oscillator, states=position, velocity, horizon=5 s, latest=0 s)"
    assert "No radius: initial_error not given" in str(mhe)
    assert "<th" in mhe._repr_html_()
    assert repr(sd.KalmanFilter(sd.named_plant("oscillator"))).startswith("KalmanFilter(plant=oscillator")


def test_times_of_a_clock_that_began_long_ago_are_told_to_the_second():
    walk = sd.KalmanFilter(sd.Plant([[0.0]], [[1.0]]), w_bound=0.1, v_bound=0.3, initial_error=1.0, prior_time=1.7e9)
    found = walk.run([(1.7e9 + k, [1.0]) for k in range(1, 13)])
    assert "from 1700000001 to 1700000012 s" in str(found)


def test_a_covariance_whose_squares_overflow_is_one_and_nothing_warns():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    for kind in (sd.KalmanFilter, sd.MovingHorizonEstimator):
        given = {"horizon": 1.0} if kind is sd.MovingHorizonEstimator else {}
        estimator = kind(plant, w_bound=0.1, v_bound=0.1, initial_error=1e80, **given)
        estimator.start([0.0, 0.0])
        first = estimator.predict(0.0)
        assert np.diag(first.covariance).min() > 1e155
        assert np.isfinite(first.radius)
        assert np.isfinite(estimator.update(0.3, [1.0]).x).all()
        assert np.isfinite(estimator.update(2.0, [1.0]).x).all()


def test_estimates_hold_the_samples_that_prove_them_and_no_copy_of_all_that_are_kept():
    """With a long `maximum_delay` each estimate held all before it: the square of a record's length in memory."""
    plant = sd.plants.library.oscillator()
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
    kalman = sd.KalmanFilter(plant, cost=sd.CostFunction(eta=0.2), maximum_delay=1e9, **bounds)
    record = [(float(k), [np.sin(k)]) for k in range(1, 60)]
    for found in (kalman.run(record), kalman.smooth(record)):
        assert max(len(each.proof.samples) for each in found) == REMEMBERED + 1
    assert len(kalman.state.nodes) == 60


@pytest.mark.parametrize("given", [{"maximum_delay": 0.0}, {"horizon": 3.0}], ids=["filter", "window"])
def test_what_estimates_keep_of_a_long_record_is_a_node_for_each_and_no_flow(given):
    """Each kept the node before with its estimate, without a radius, and the flow of its gap: twice the memory."""
    plant, rng = sd.plants.library.oscillator(), np.random.default_rng(0)
    kind = sd.MovingHorizonEstimator if "horizon" in given else sd.KalmanFilter
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
    estimator = kind(plant, cost=sd.CostFunction(eta=0.2), **bounds, **given)
    record = [(t, [np.sin(t)]) for t in np.cumsum(rng.uniform(0.5, 1.5, 80)).tolist()]
    found = estimator.run(record).estimates
    kept = Counter(type(each) for each in reached(found))
    assert kept[Estimate] == 80
    assert kept[HistoryNode] == 81  # with the prior
    assert kept[GapFlow] == 0


def reached(*begun):
    """All objects that some of them refer to, but for modules and what they define."""
    seen, ahead = {}, list(begun)
    while ahead:
        each = ahead.pop()
        if id(each) not in seen and not isinstance(each, (type, ModuleType, FunctionType)):
            seen[id(each)] = each
            ahead += gc.get_referents(each)
    return list(seen.values())


def test_a_record_whose_discount_vanishes_is_not_smoothed():
    """States were no numbers then."""
    kalman = sd.KalmanFilter(sd.plants.library.oscillator(), cost=sd.CostFunction(eta=20.0))
    with pytest.raises(ArgumentError, match="`record` must be shorter at the rate eta = 20: over 40"):
        kalman.smooth([(float(k), [0.1]) for k in range(1, 41)])
    assert np.isfinite(kalman.smooth([(float(k), [0.1]) for k in range(1, 31)]).x).all()
