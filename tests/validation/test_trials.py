"""Runs of the real estimator: the truth is exact, steered where it would run away, and every row is asked."""

import numpy as np
import pytest

from sampling_design import MovingHorizonEstimator, PeriodicSchedule, Plant
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.scenario import ScenarioBounds, draw_inputs
from sampling_design.validation.timeline import build_timeline
from sampling_design.validation.trials import driven, extent, real_run, true_run
from tests.cases import few
from tests.oracles.validation import integrate

UNSTABLE = Plant([[0.0, 1.0], [2.0, 0.5]], [[1.0, 0.0]], B=[[0.0], [1.0]], D=[[1.0]])
OPTIONS = {"horizon": 2.0, "cost": CostFunction(eta=0.5), "w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}


def line_of(plant, duration, first):
    return build_timeline(plant, PeriodicSchedule([0.4, 0.6], first=first), duration, 2.0)


@pytest.mark.parametrize("first", few([0.0, 0.4], 1))
def test_an_unstable_truth_is_steered_and_the_estimator_is_told(first):
    line = line_of(UNSTABLE, 30.0, first)
    inputs = draw_inputs(line, ScenarioBounds.of(UNSTABLE, 0.1, 0.1, 1.0), np.random.SeedSequence(0).spawn(1))
    truth = true_run(line, inputs)
    assert np.max(np.abs(truth.states)) < 10.0
    n, marks = 2, np.unique(np.concatenate([[0], line.samples]))
    held = truth.u[np.searchsorted(marks, np.arange(line.cells), side="right") - 1]
    forces, both = np.hstack([inputs.w[0], held]), np.hstack([UNSTABLE.G, np.eye(n)])
    head = 30
    states = integrate(UNSTABLE.A, both, -inputs.e0[0], line.times[: head + 1], forces[:head])
    assert truth.states[: head + 1] == pytest.approx(states, abs=1e-8)
    mhe = MovingHorizonEstimator(driven(UNSTABLE), **OPTIONS)
    found = ErrorMap(line, mhe, ScenarioBounds.of(UNSTABLE, 0.1, 0.1, 1.0))
    run = real_run(line, truth, mhe)
    assert run.errors == pytest.approx(found.apply(inputs).e[0], abs=1e-10)


def test_a_calm_truth_is_left_alone():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    line = line_of(plant, 10.0, 0.4)
    inputs = draw_inputs(line, ScenarioBounds.of(plant, 0.1, 0.1, 1.0), np.random.SeedSequence(0).spawn(1))
    truth = true_run(line, inputs)
    assert truth.u is None
    low, high = extent(truth.states)
    assert np.all((truth.states >= low) & (truth.states <= high))
    assert np.all((low <= 0) & (high >= 0))
    wide = extent(truth.states, 1.0)
    assert wide[1] - wide[0] == pytest.approx(3 * (high - low))


def test_the_driven_plant_is_the_same_but_for_its_inputs():
    plant = driven(UNSTABLE)
    assert np.array_equal(plant.B, np.eye(2))
    assert not plant.D.any()
    for key in "ACG":
        assert np.array_equal(getattr(plant, key), getattr(UNSTABLE, key))
