"""An output that is not measured might as well not exist: the estimate is that of the plant without it.

Weights of a plant without some outputs are those of the covariances without their rows, whatever the correlation.
"""

from dataclasses import replace

import numpy as np
import pytest

from sampling_design import (
    Constraints,
    KalmanFilter,
    MovingHorizonEstimator,
    PeriodicSchedule,
    Plant,
    certify,
    validate,
)
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, marginal
from tests.cases import few
from tests.oracles.windows import by_the_reference

A = np.array([[0.0, 1.0, 0.0], [-1.0, -0.1, 0.3], [0.0, 0.0, -0.4]])
SEEN = [0, 2]


def correlated(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T + 0.05 * np.eye(size)


def setting(seed):
    """A plant with three outputs and the same with two, with weights whose covariances agree on those two."""
    rng = np.random.default_rng(seed)
    C = rng.normal(size=(3, 3))
    fit, noise = correlated(rng, 3), correlated(rng, 3)
    both = np.ix_(SEEN, SEEN)
    whole = {"R": np.linalg.inv(fit), "Qv": np.linalg.inv(noise)}
    part = {"R": np.linalg.inv(fit[both]), "Qv": np.linalg.inv(noise[both])}
    return Plant(A, C), Plant(A, C[SEEN]), whole, part, rng


def test_half_the_prior_half_the_measurement():
    """Prior I, noise covariance [[1, .9], [.9, 1]], y = [1, not measured]: (.5, 0), information 1 of each."""
    noise = np.array([[1.0, 0.9], [0.9, 1.0]])
    weight = 2 * np.linalg.inv(noise)
    plant = Plant(np.zeros((2, 2)), np.eye(2), G=np.zeros((2, 0)))
    estimate = KalmanFilter(plant, cost=CostFunction(P2=np.eye(2), R=weight, Qv=weight)).update(0.0, [1.0, np.nan])
    assert estimate.x == pytest.approx([0.5, 0.0], abs=1e-14)
    assert estimate.covariance == pytest.approx(np.diag([0.5, 1.0]), abs=1e-14)


SETS = {
    "free": Constraints(),
    "box": Constraints(x=(-0.4, 0.4)),
    "noise box": Constraints(v=((-0.1, -9.0, -0.1), (0.1, 9.0, 0.1))),
    "output box": Constraints(y=((-0.3, -9.0, -0.3), (0.3, 9.0, 0.3))),
    "ball": Constraints(x=ConvexSet.ball(0.5, dimension=3)),
}


@pytest.mark.parametrize("name", few(SETS, 0, 1))
@pytest.mark.parametrize(
    ("form", "engine"),
    [({}, "auto"), ({"arrival": "filtered"}, "auto"), ({"form": "paper"}, "auto"), ({}, "reference")],
    ids=str,
)
def test_a_moving_horizon_estimate_is_that_without_the_output(name, form, engine):
    plant, fewer, whole, part, rng = setting(3)
    held = SETS[name]
    few = {key: tuple(np.take(side, SEEN) for side in getattr(held, key)) for key in "vy" if getattr(held, key)}
    bounds = {"w_bound": [1.0, 1.0, 1.0], "initial_error": [1.0, 1.0, 1.0], "horizon": 2.5}
    form = {"eta": 0.3, **form}
    one = MovingHorizonEstimator(
        plant, v_bound=np.ones(3), **bounds, constraints=held, cost=CostFunction(**form, **whole)
    )
    two = MovingHorizonEstimator(
        fewer, v_bound=np.ones(2), **bounds, constraints=replace(held, **few), cost=CostFunction(**form, **part)
    )
    if engine == "reference":
        one, two = by_the_reference(one), by_the_reference(two)
    for t in (0.4, 1.1, 1.9, 3.0, 3.6):
        y = rng.normal(size=3) * 0.6
        a, b = one.update(t, np.where([True, False, True], y, np.nan)), two.update(t, y[SEEN])
        assert a.status == b.status == "ok"
        accuracy = 1e-5 if engine == "reference" else 1e-9
        assert a.x == pytest.approx(b.x, rel=accuracy, abs=accuracy)
        assert a.radius == pytest.approx(b.radius, rel=accuracy)
        assert a.covariance == pytest.approx(b.covariance, rel=1e-9, abs=1e-12)


def test_filter_and_smoother_are_those_without_the_output():
    plant, fewer, whole, part, rng = setting(4)
    ys = rng.normal(size=(5, 3))
    times = [0.4, 1.1, 1.9, 3.0, 3.6]
    masked = [(t, np.where([True, False, True], y, np.nan), None) for t, y in zip(times, ys, strict=True)]
    less = [(t, y[SEEN], None) for t, y in zip(times, ys, strict=True)]
    for way in ("run", "smooth"):
        a = getattr(KalmanFilter(plant, cost=CostFunction(eta=0.2, **whole)), way)(masked)
        b = getattr(KalmanFilter(fewer, cost=CostFunction(eta=0.2, **part)), way)(less)
        assert a.x == pytest.approx(b.x, rel=1e-9, abs=1e-10)
        assert a.covariance == pytest.approx(b.covariance, rel=1e-9, abs=1e-10)
        assert a.cost == pytest.approx(b.cost, rel=1e-9)


@pytest.mark.long
def test_the_worst_pair_reaches_a_certificate_with_missing_outputs_and_none_breaks_it():
    """The certificate takes rows off covariances too, so that its worst pair is as near to equality as with all."""
    plant, _, whole, _, _ = setting(5)
    schedule = PeriodicSchedule([0.7, 0.5], outputs=[[True, False, True], [False, True, True]])
    certificate = certify(plant, schedule, eta=0.3, P2=np.eye(3), Qw=np.eye(3), **whole)
    report = validate(plant, schedule, certificate, runs=8, scenarios=["pairs", "random", "worst", "estimator"])
    assert report.passed, report.explain()
    worst = next(f for f in report.checks if f.scenario == "worst pair")
    assert 0.9 < worst.observed <= 1.0


def test_a_marginal_weight_is_the_inverse_of_a_part_of_the_covariance_in_any_units():
    rng = np.random.default_rng(1)
    for _ in range(20):
        covariance, units = correlated(rng, 4), 10.0 ** rng.integers(-12, 13, 4)
        seen = rng.random(4) < 0.6
        seen[0] = True
        weight = np.linalg.inv(covariance) / np.outer(units, units)
        found = marginal(weight, seen)[np.ix_(seen, seen)] * np.outer(units[seen], units[seen])
        assert found == pytest.approx(np.linalg.inv(covariance[np.ix_(seen, seen)]), rel=1e-9)
        assert not marginal(weight, seen)[~seen].any()
