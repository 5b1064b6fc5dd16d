"""A thousand runs of a hundred samples, four states, through the linear error map; and one run of the real estimator.

Promised: the thousand runs within 30 s. `built` is what every map costs once, before the first run.
"""

import numpy as np
import pytest

from sampling_design import MovingHorizonEstimator, PeriodicSchedule, Plant
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.validation.apriori_bound import sensitivity
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.monte_carlo import monte_carlo
from sampling_design.validation.scenario import ScenarioBounds, draw_inputs, real_run, true_run
from sampling_design.validation.timeline import build_timeline

A = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, -0.1]], float)
PLANT = Plant(A, [[1.0, 0.0, 1.0, 0.0]])
SCHEDULE = PeriodicSchedule([0.7, 1.2, 0.9, 1.2])
BOUNDS = ScenarioBounds.of(PLANT, 0.5, 0.5, 3.0)
SAMPLES = 100


def estimator():
    return MovingHorizonEstimator(
        PLANT, horizon=20.0, cost=CostFunction(eta=0.2), w_bound=BOUNDS.w, v_bound=BOUNDS.v, initial_error=BOUNDS.e0
    )


def setting():
    line = build_timeline(PLANT, SCHEDULE, float(SAMPLES), 20.0)
    assert line.samples.size == SAMPLES
    return line, ErrorMap(line, estimator(), BOUNDS)


def test_built(benchmark):
    assert len(benchmark(setting)[1].windows) == SAMPLES


@pytest.mark.parametrize("runs", [100, 1000])
def test_unconstrained_runs(benchmark, runs):
    _, found = setting()
    seeds = np.random.SeedSequence(0).spawn(runs)
    trials = benchmark.pedantic(monte_carlo, (found, BOUNDS, None, np.eye(4), seeds), rounds=1)
    assert trials.size.shape[0] == runs
    assert trials.ellipsoid.max() <= 1.0 + 1e-9


def test_one_run_of_the_real_estimator(benchmark):
    line, found = setting()
    inputs = draw_inputs(line, BOUNDS, np.random.SeedSequence(0).spawn(1))
    truth = true_run(line, inputs)
    run = benchmark.pedantic(lambda: real_run(line, truth, estimator()), rounds=1)
    assert run.errors == pytest.approx(found.apply(inputs).e[0], abs=1e-9)


def test_worst_disturbance_by_going_back(benchmark):
    _, found = setting()
    assert benchmark(sensitivity, found, found.timeline.rows.at.size - 1).e0.shape == (4, 4)
