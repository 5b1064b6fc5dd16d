"""Weights from bounds: each term of the online radius is at most one, and the radii get smaller."""

import numpy as np
import pytest

from sampling_design import (
    GapRange,
    MovingHorizonEstimator,
    PeriodicSchedule,
    Plant,
    UncertainParameter,
    UncertainPlant,
    certify,
    simulate_record,
)
from sampling_design.certificates.exact.bound_weights import weights_from_bounds
from sampling_design.errors import ArgumentError

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_everything_within_the_bounds_costs_at_most_one():
    rng = np.random.default_rng(0)
    w, v, e0 = np.array([0.1, 0.3]), np.array([0.2]), np.array([1.0, 2.0])
    weights = weights_from_bounds(PLANT, 0.5, w, v, e0)
    corner = np.sign(rng.standard_normal((50, 2)))
    assert np.einsum("ki,ij,kj->k", corner * e0, weights["P2"], corner * e0) == pytest.approx(1.0)
    # int e^{-eta s} ds = 1/eta
    assert np.einsum("ki,ij,kj->k", corner * w, weights["Qw"], corner * w) / 0.5 == pytest.approx(1.0)
    together = np.linalg.solve(weights["R"] + weights["Qv"], weights["R"] @ weights["Qv"])
    assert float(v @ together @ v) == pytest.approx(1.0)


def test_certify_takes_bounds_in_place_of_weights():
    schedule = PeriodicSchedule([0.5, 1.0])
    made = certify(PLANT, schedule, v_bound=0.3, initial_error=0.0)
    assert made.eta == 1.0  # one over the longest gap
    stated = weights_from_bounds(PLANT, 1.0, PLANT.disturbances.scales, 0.3, PLANT.states.scales)
    for key, weight in stated.items():
        np.testing.assert_array_equal(getattr(made, key), weight)
    assert certify(PLANT, GapRange(0.5, 1.0), w_bound=0.1, eta=0.4).eta == 0.4
    with pytest.raises(ArgumentError, match="`v_bound` and `initial_error` say the weights: leave out P2, Qw, R and"):
        certify(PLANT, schedule, v_bound=0.3, R=[[1.0]])
    with pytest.raises(ArgumentError, match="`initial_error` are for exactly known plants: give Qw and R"):
        certify(UncertainPlant(PLANT, [UncertainParameter("k", 0.9, 1.1, A=-PLANT.A)]), schedule, v_bound=0.3)


def test_a_number_bounds_the_norm():
    weights = weights_from_bounds(PLANT, 1.0, 0.5, 0.5, 2.0)
    assert weights["P2"].tolist() == [[0.25, 0.0], [0.0, 0.25]]


def test_radii_are_far_smaller_than_with_the_shortest_horizon():
    bounds, eta, radii = {"w_bound": [0.01, 0.01], "v_bound": [0.01], "initial_error": [1.0, 1.0]}, 0.3, []
    noise = {"w_bound": bounds["w_bound"], "v_bound": bounds["v_bound"]}
    record = simulate_record(PLANT, PeriodicSchedule([1.0, 1.4]), 8.0, **noise, rng=1).measurements
    for weights in ({}, weights_from_bounds(PLANT, eta, **bounds)):
        certificate = certify(PLANT, GapRange(0.8, 1.7), eta=eta, **weights)
        found = MovingHorizonEstimator(PLANT, certificate, **bounds).run(record, centred=False)
        assert found.certified.all()
        radii.append(found.ellipsoid_radii[-1])
    assert np.all(radii[1] < 0.5 * radii[0])


def test_bounds_that_are_none_are_refused():
    with pytest.raises(ArgumentError, match="`w_bound` must be positive in every entry"):
        weights_from_bounds(PLANT, 1.0, [0.0, 1.0], 1.0, 1.0)
    for tiny in (1e-145, [1.0, 1e-149], 1e145):
        with pytest.raises(ArgumentError, match=r"`initial_error` must lie between 1e-140 and 1e\+140"):
            weights_from_bounds(PLANT, 1.0, 1.0, 1.0, tiny)
    with pytest.raises(ArgumentError, match=r"`eta` must be at most 1e\+140, got 1e\+308"):
        weights_from_bounds(PLANT, 1e308, 1.0, 1.0, 1.0)
    with pytest.raises(ArgumentError, match="`initial_error` must have 2 entries"):
        weights_from_bounds(PLANT, 1.0, 1.0, 1.0, [1.0])
