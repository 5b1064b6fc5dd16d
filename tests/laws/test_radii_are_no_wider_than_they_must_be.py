"""A constraint on the noise that changes nothing widens nothing; far ahead a radius grows as the plant lets w push."""

import numpy as np
import pytest

from sampling_design import (
    Constraints,
    CostFunction,
    MovingHorizonEstimator,
    Plant,
    SetMembershipEstimator,
    state_interval,
)

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
BOUNDS = {"w_bound": 0.05, "v_bound": [0.2], "initial_error": 1.0, "horizon": 6.0}
TIMES = [0.5, 1.2, 2.4, 3.1, 4.4]


def final(ys, weights, **options):
    mhe = MovingHorizonEstimator(PLANT, cost=CostFunction(eta=0.4, **weights), **BOUNDS, **options)
    return [mhe.update(t, [y]) for t, y in zip(TIMES, ys, strict=True)][-1], mhe


@pytest.mark.parametrize("weights", [{}, {"R": [[9.0]], "Qv": [[2.0]]}], ids=str)
def test_an_inactive_noise_set_leaves_the_radii_as_they_are(weights):
    ys = [0.1, -0.05, 0.1, 0.0, 0.15]
    free, _ = final(ys, weights)
    for options in (
        {"constraints": Constraints(v=(-0.2, 0.2))},
        {"constraints": Constraints(v=(-9.0, 9.0))},
        {"constraints": Constraints(y=(-9.0, 9.0))},
    ):
        held, _ = final(ys, weights, **options)
        assert held.ellipsoid_radii == pytest.approx(free.ellipsoid_radii, rel=1e-12)
        assert held.radii == pytest.approx(free.radii, rel=1e-5)


def test_an_active_noise_set_narrows_the_radii():
    ys = [0.9, -0.7, 0.8, 0.6, -0.9]
    loose = {**BOUNDS, "v_bound": [2.0], "cost": CostFunction(eta=0.4)}
    free, held = (
        MovingHorizonEstimator(PLANT, **loose, **o) for o in ({}, {"constraints": Constraints(v=(-0.3, 0.3))})
    )
    for t, y in zip(TIMES, ys, strict=True):
        one, two = free.update(t, [y]), held.update(t, [y])
    assert two.engine == "active set"
    assert np.all(two.ellipsoid_radii < one.ellipsoid_radii)
    assert two.interval().contradiction > 1  # the exact set knows that no such noise explains the data


def test_far_ahead_the_radius_grows_with_time_and_not_with_its_exponential():
    _, mhe = final([0.1, -0.05, 0.1, 0.0, 0.15], {})
    for ahead in (10.0, 50.0, 200.0):
        estimate = mhe.predict(TIMES[-1] + ahead)
        pushed = BOUNDS["w_bound"] * ahead
        assert estimate.certified
        assert np.all(estimate.radii < 2.0 * (pushed + 1.0))


@pytest.mark.parametrize(("units", "time"), [((1.0, 1.0, 1.0, 1.0), 1.0), ((1e-4, 1e-5, 1e-5, 1e-6), 1e4)])
def test_radii_as_samples_come_are_those_of_the_whole_record(units, time):
    rng, sizes = np.random.default_rng(1), np.array(units)
    A, G, C = np.diag(np.ones(3), 1), np.array([[-0.9], [-0.8], [0.4], [0.07]]), np.array([[0.4, -1.0, 0.8, 2.0]])
    plant = Plant(A * sizes[:, None] / sizes / time, C / sizes, G=sizes[:, None] * G / time)
    known = {"w_bound": 1.0, "v_bound": [0.4], "initial_error": sizes * [2.7, 1.9, 2.5, 1.5]}
    estimator, record = SetMembershipEstimator(plant, **known), []
    for t, y in zip([0.0, 0.8, 1.9, 2.6, 3.2], rng.uniform(-0.4, 0.4, 5), strict=True):
        record.append((t * time, [y]))
        radii = estimator.update(t * time, [y]).radii
        assert radii == pytest.approx(state_interval(plant, record, **known).radii, rel=0.005)
