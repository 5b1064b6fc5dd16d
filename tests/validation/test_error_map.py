"""The linear error map gives what the estimator gives, and what a plain window filter gives."""

from itertools import product

import numpy as np
import pytest

from sampling_design import MovingHorizonEstimator
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.scenario import ErrorSources, ScenarioBounds, draw_inputs
from sampling_design.validation.timeline import build_timeline
from tests.cases import few
from tests.oracles.validation import integrate, moving_horizon
from tests.validation.plants import PLANTS, SCHEDULES, certificate

OPTIONS = {
    "plain": {},
    "carried": {"cost": CostFunction(arrival="filtered")},
    "paper": {"cost": CostFunction(form="paper")},
    "from samples": {"cost": CostFunction(begins="sample")},
    "paper, from samples": {"cost": CostFunction(form="paper", begins="sample")},
}


def built(name, duration, **options):
    plant, bounds = PLANTS[name], ScenarioBounds.of(PLANTS[name], 0.4, 0.3, 1.5)
    noise = {"w_bound": bounds.w, "v_bound": bounds.v, "initial_error": bounds.e0}
    mhe = MovingHorizonEstimator(plant, certificate(name), **noise, **options)
    line = build_timeline(plant, SCHEDULES[name], duration, mhe.horizon, mhe.begins)
    return plant, bounds, mhe, line, ErrorMap(line, mhe, bounds)


@pytest.mark.parametrize("name", few(PLANTS, 0))
def test_errors_are_those_of_a_plain_window_filter(name):
    plant, bounds, mhe, line, found = built(name, 12.0)
    inputs = draw_inputs(line, bounds, np.random.SeedSequence(1).spawn(4))
    errors = found.apply(inputs)
    weights = mhe.weights
    for run in range(4):
        x = integrate(plant.A, plant.G, -inputs.e0[run], line.times, inputs.w[run])[line.samples]
        y = np.where(line.masks > 0, x @ plant.C.T + inputs.v[run], np.nan)
        shape = plant.A, plant.C, plant.G, weights.prior, weights.w, weights.y, weights.eta, mhe.horizon
        expected = moving_horizon(*shape, line.times[line.samples], y) - x
        assert np.max(np.abs(errors.e[run, found.timeline.rows.samples] - expected)) < 1e-9


@pytest.mark.parametrize(("name", "option"), few(product(PLANTS, OPTIONS), 0, 6, 12, 3, 9))
def test_errors_and_radii_are_those_of_the_estimator(name, option):
    plant, bounds, mhe, line, found = built(name, 14.0, **OPTIONS[option])
    inputs = draw_inputs(line, bounds, np.random.SeedSequence(2).spawn(2))
    errors = found.apply(inputs)
    ratios = found.ellipsoid_ratio(errors)
    samples = line.sample_at
    x, rows, row = -inputs.e0[1], found.timeline.rows, 0
    for b in range(line.times.size):
        if b:
            x = line.F[b - 1] @ x + line.gamma[b - 1] @ inputs.w[1, b - 1]
        looks = [mhe.predict(line.times[b])]
        if b in samples:
            j = samples[b]
            looks.append(mhe.update(line.times[b], np.where(line.masks[j] > 0, plant.C @ x + inputs.v[1, j], np.nan)))
        for estimate in looks:
            assert rows.at[row] == b
            assert np.max(np.abs(estimate.x - x - errors.e[1, row])) < 1e-9
            assert estimate.radius == pytest.approx(errors.radius[1, row], rel=1e-8)
            if estimate.status == "predicted":  # ahead of the samples the estimator may know a smaller ellipsoid
                assert estimate.ratio(x) <= 1.0
            else:
                assert estimate.ratio(x) == pytest.approx(ratios[1, row], rel=1e-6, abs=1e-12)
            row += 1
    assert row == rows.at.size


def test_the_map_is_linear_and_the_truth_never_enters():
    _, bounds, _, line, found = built("unstable", 30.0)
    inputs = draw_inputs(line, bounds, np.random.SeedSequence(3).spawn(3))
    once, thrice = found.apply(inputs).e, found.apply(ErrorSources(*(3 * part for part in inputs))).e
    assert thrice == pytest.approx(3 * once, rel=1e-12)
    assert np.max(np.abs(once[:, -1])) < 10.0
