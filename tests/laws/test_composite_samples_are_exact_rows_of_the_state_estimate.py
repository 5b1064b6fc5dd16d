"""A composite sample moves the estimate as its mean over the interval does, the disturbance inside it taken along."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.readings import BelowDetection, CompositeReading
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from tests.cases import few
from tests.oracles.composites import posterior
from tests.oracles.windows import by_the_reference
from tests.rescale import Units

SAME = 1e-8
PLANT = sd.Plant(
    [[0.0, 1.0], [-1.5, -0.3]], [[1.0, 0.0], [0.4, -1.0]], B=[[0.0], [1.0]], D=[[0.0], [0.5]], time_unit="h"
)
WEIGHTS = {
    "P2": np.array([[1.0, 0.2], [0.2, 0.8]]),
    "Qw": np.array([[3.0, 0.4], [0.4, 2.0]]),
    "R": np.array([[9.0, 2.0], [2.0, 7.0]]),
    "Qv": np.array([[12.0, -1.0], [-1.0, 15.0]]),
}
INPUTS = {0.3: 1.0, 1.7: -0.6, 4.05: 0.2}
FAR = {"w_bound": 2.0, "v_bound": 2.0, "initial_error": 5.0}

RECORDS = {
    "one mean": [(0.7, {0: 0.4}), (1.6, {1: 0.2}), (2.5, {0: (0.9, 0.3)}), (3.1, {0: 0.1})],
    "between samples": [(0.7, {0: 0.4}), (1.6, {1: 0.2}), (2.5, {1: (0.35, 1.1), 0: 0.2}), (3.6, {0: (0.3, 2.6)})],
    "from a sample on": [(0.7, {0: 0.4, 1: 0.1}), (2.2, {0: (0.9, 0.7)}), (3.4, {0: (-0.3, 2.2), 1: 0.5})],
    "two that overlap": [(0.7, {0: 0.4}), (1.6, {0: (0.2, 0.9)}), (2.5, {1: (0.3, 1.2)}), (4.4, {0: (0.6, 1.7)})],
    "from the prior on, alone": [(2.0, {1: (0.5, 0.0)})],
    "both at once": [(0.5, {0: 0.4}), (3.0, {0: (0.9, 0.2), 1: (0.1, 1.4)}), (3.1, {1: 0.2})],
}


def rows_of(record, inputs):
    """Samples in order of time, with the inputs as rows of their own."""
    found = []
    for t, read in record:
        y = [np.nan, np.nan]
        for i, value in read.items():
            y[i] = CompositeReading(*value) if isinstance(value, tuple) else value
        found.append((t, y, None))
    if inputs:
        last = record[-1][0]
        found += [(t, None, [u]) for t, u in INPUTS.items() if t < last]
    return sorted(found, key=lambda row: row[0])


def wanted(record, inputs, eta, upto, prior=(0.3, -0.2)):
    plain, means = [], []
    for t, read in record:
        for i, value in read.items():
            if t <= upto:
                means.append((t, i, value[1], value[0])) if isinstance(value, tuple) else plain.append((t, i, value))
    w = WEIGHTS
    Y = np.linalg.inv(np.linalg.inv(w["R"]) + np.linalg.inv(w["Qv"]))
    given = (PLANT.B, PLANT.D, [(t, [u]) for t, u in INPUTS.items()]) if inputs else None
    return posterior(
        PLANT.A, PLANT.C, PLANT.G, w["P2"], w["Qw"], Y, eta, np.array(prior), 0.0, plain, means, upto, given
    )


def made(kind, eta, **options):
    cost = CostFunction(eta=eta, **WEIGHTS)
    if kind == "filter":
        return sd.KalmanFilter(PLANT, cost=cost, prior=[0.3, -0.2], **{"maximum_delay": 10.0, **options})
    return sd.MovingHorizonEstimator(PLANT, horizon=10.0, cost=cost, prior=[0.3, -0.2], **options)


def check_agrees(estimate, x, Y, cost):
    size = np.sqrt(np.diag(Y))
    assert np.max(np.abs(estimate.x - x) / size) < SAME
    assert np.max(np.abs(estimate.covariance - Y) / np.outer(size, size)) < SAME
    assert estimate.cost == pytest.approx(cost, rel=1e-7)


@pytest.mark.parametrize(("case", "kind"), few(product(RECORDS, ["filter", "window"]), 0, 3, 4, 7, 8, 9, 11))
def test_state_covariance_and_cost_are_those_of_quadrature(case, kind):
    record, inputs, eta = RECORDS[case], case != "one mean", 0.0 if case == "both at once" else 0.3
    estimator = made(kind, eta)
    for t, y, u in rows_of(record, inputs):
        estimate = estimator.update(t, y, u)
        if y is not None:
            check_agrees(estimate, *wanted(record, inputs, eta, t))


@pytest.mark.parametrize("kind", ["filter", "window"])
def test_a_late_sample_inside_the_interval_counts(kind):
    record = RECORDS["between samples"]
    rows = rows_of(record, True)
    late = next(row for row in rows if row[0] == 1.6)
    estimator = made(kind, 0.3)
    for row in rows:
        if row is not late:
            estimator.update(*row)
    check_agrees(estimator.update(*late), *wanted(record, True, 0.3, 3.6))


def test_the_smoother_takes_means_in_too():
    record = RECORDS["two that overlap"]
    found = made("filter", 0.0).smooth(rows_of(record, True))
    x, Y, _ = wanted(record, True, 0.0, 4.4)
    assert np.max(np.abs(found.x[-1] - x) / np.sqrt(np.diag(Y))) < SAME
    assert np.allclose(found.covariance[-1], Y, rtol=1e-7)
    kept = np.linalg.eigvalsh(found.covariance)
    filtered = made("filter", 0.0).run(rows_of(record, True))
    assert np.all(kept > 0)
    assert np.trace(found.covariance[0]) < np.trace(filtered.covariance[0])


def test_a_window_that_slides_past_the_interval_forgets_only_what_a_prior_forgets():
    """With the filtered arrival cost and windows that hold each interval, the window is the filter."""
    record = [(0.4 * k, {0: 0.1 * np.sin(k)} if k % 5 else {0: (0.05 * k, 0.4 * k - 1.0)}) for k in range(3, 24)]
    cost = CostFunction(eta=0.2, arrival="filtered", **WEIGHTS)
    mhe, deaf = (sd.MovingHorizonEstimator(PLANT, horizon=2.5, cost=cost, prior=[0.3, -0.2]) for _ in range(2))
    whole, off = made("filter", 0.2), []
    for t, y, _ in rows_of(record, False):
        size = np.sqrt(np.diag(whole.update(t, y).covariance))
        plain = deaf.predict(t) if isinstance(y[0], CompositeReading) else deaf.update(t, y)
        off.append([np.max(np.abs(each.x - whole.predict(t).x) / size) for each in (mhe.update(t, y), plain)])
    # an interval across the start of a window is known to the filter as a whole, to the window's prior not yet
    near, far = np.array(off)[10:].max(axis=0)
    assert near < 0.2
    assert far > 5 * near


@pytest.mark.parametrize("kind", ["filter", "window"])
@pytest.mark.parametrize("seed", range(3))
def test_radii_hold_the_truth_and_blame_finds_the_mean(kind, seed):
    """Admissible noise, means taken by fine sums; then one mean that is far off."""
    rng = np.random.default_rng(seed)
    step, count = 0.002, 2500
    F = PLANT.transition(step)
    x, path = rng.normal(size=2), []
    w = np.repeat(rng.uniform(-0.5, 0.5, (count // 100, 2)), 100, axis=0)
    for k in range(count):
        path.append(x)
        x = F @ (x + step * w[k])
    outputs, estimator = np.array(path) @ PLANT.C.T, made(kind, 0.3, **FAR)
    for k in range(250, count, 250):
        y = list(outputs[k] + rng.uniform(-0.5, 0.5, 2))
        if k % 500 == 0:
            y[0] = CompositeReading(outputs[k - 400 : k, 0].mean() + rng.uniform(-0.5, 0.5), (k - 400) * step)
        estimate = estimator.update(k * step, y)
        assert estimate.certified
        assert estimate.holds(path[k])
        assert np.all(np.abs(path[k] - estimate.x) <= estimate.ellipsoid_radii)
    wrong = estimator.update(count * step, [CompositeReading(400.0, (count - 400) * step), np.nan])
    assert wrong.status == "bounds disproved"
    assert (wrong.contradiction.output, wrong.contradiction.t) == ("y1", count * step)
    assert wrong.contradiction.factor > 10


def test_engines_agree_with_the_problem_as_it_is_written():
    rows = rows_of(RECORDS["from a sample on"][:2], False)
    sets = {"x": (-0.31, 0.31)}
    own, reference = (made("window", 0.3, constraints=sd.Constraints(**sets)) for _ in range(2))
    found = [each.run(rows).estimates[-1] for each in (own, by_the_reference(reference))]
    free = made("window", 0.3).run(rows).estimates[-1]
    assert np.max(np.abs(free.x - found[0].x)) > 1e-2
    assert np.allclose(found[0].x, found[1].x, atol=1e-5)
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_in_any_units(seed):
    units = Units.drawn(np.random.default_rng(seed), PLANT)
    plain = sd.KalmanFilter(PLANT, cost=CostFunction(eta=0.2), maximum_delay=10.0)
    cost = CostFunction(Qw=units.disturbance_weight(np.eye(2)), eta=0.2 / units.time)
    moved = sd.KalmanFilter(units.plant(PLANT), cost=cost, maximum_delay=10.0 * units.time)
    for t, read in RECORDS["two that overlap"]:
        y, z = [np.nan, np.nan], [np.nan, np.nan]
        for i, value in read.items():
            mean = isinstance(value, tuple)
            y[i] = CompositeReading(*value) if mean else value
            size = units.outputs[i]
            z[i] = CompositeReading(value[0] * size, value[1] * units.time) if mean else value * size
        one, other = plain.update(t, y), moved.update(t * units.time, z)
        size = np.sqrt(np.diag(other.covariance))
        assert np.max(np.abs(one.x * units.states - other.x) / size) < 1e-8


def test_without_bounds_a_mean_is_taken_and_a_limit_is_not():
    estimator = made("filter", 0.1)
    estimator.update(1.0, [0.3, np.nan])
    assert estimator.update(2.0, [CompositeReading(0.4, 0.5), np.nan]).status == "ok"
    with pytest.raises(
        sd.ArgumentError, match="`w_bound` and `v_bound` must be given for the limit, mean or uncertain time at t = 3"
    ):
        estimator.update(3.0, [CompositeReading(BelowDetection(0.4), 2.5), np.nan])


def test_what_began_before_the_window_is_said_to_be_left_out():
    mhe = sd.MovingHorizonEstimator(PLANT, horizon=1.0, cost=CostFunction(eta=0.1, **WEIGHTS))
    mhe.update(1.0, [0.1, 0.2])
    mhe.update(2.5, [0.2, np.nan])
    found = mhe.update(2.8, [np.nan, CompositeReading(0.5, 1.5)])
    assert "A composite sample began before the window" in found.note


@pytest.mark.parametrize("kind", ["filter", "window"])
def test_from_a_file(tmp_path, kind):
    path = tmp_path / "record.csv"
    path.write_text("time,y1,y1_since,y2,y2_since,u1\n0.7,0.4,,,,0\n1.6,0.2,0.9,,,\n2.5,,,0.3,1.2,\n4.4,0.6,1.7,,,\n")
    record = sd.read_measurements(path, PLANT)
    check_agrees(made(kind, 0.2).run(record).estimates[-1], *wanted(RECORDS["two that overlap"], False, 0.2, 4.4))
