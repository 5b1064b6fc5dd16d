"""Runs of the real estimator: the truth is exact, steered where it would run away, and every row is asked."""

import numpy as np
import pytest

from sampling_design import MovingHorizonEstimator, PeriodicSchedule, Plant, validate
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.scenario import ScenarioBounds, draw_inputs, driven, extent, real_run, true_run
from sampling_design.validation.timeline import build_timeline
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


class Tight:
    """The exact interval of x' = w, y = x + v: a point where noise on both ends of its bound has shown it."""

    def __init__(self, w, v, e0, gain=1.0):
        self.w, self.v, self.e0, self.gain = w, v, e0, gain

    def start(self, prior, prior_time=0.0):
        self.t, self.ends = prior_time, prior[0] + self.e0 * np.array([-1.0, 1.0])

    def predict(self, t):
        low, high = self.ends + self.w * (t - self.t) * np.array([-1.0, 1.0])
        return Estimate(t, np.array([(low + high) / 2]), np.eye(1), max(high - low, 0.0) ** 2 / 4, certified=True)

    def update(self, t, y, u=None):
        reach = self.w * (t - self.t) + self.v
        read, before = float(y[0]) / self.gain, self.ends + (reach - self.v) * np.array([-1.0, 1.0])
        self.t, self.ends = t, np.array([max(before[0], read - self.v), min(before[1], read + self.v)])
        return self.predict(t)


LIES = {"none": {}, "w": {"w": 0.1 / 1.01}, "v": {"v": 0.2 / 1.01}, "e0": {"e0": 1 / 1.01}, "gain": {"gain": 1.01}}


@pytest.mark.parametrize("lie", few(LIES, 0, 1))
def test_what_is_tight_is_held_and_broken_by_a_lie_of_a_percent(lie):
    plant, schedule = Plant([[0.0]], [[1.0]]), PeriodicSchedule([0.7, 1.3])
    report = validate(
        plant, schedule, estimator=Tight(**{"w": 0.1, "v": 0.2, "e0": 1.0, **LIES[lie]}), w_bound=0.1, v_bound=0.2,
        initial_error=1.0, runs=10, duration=8.0, scenarios=("random", "initial"), rng=1,
    )  # fmt: skip
    held = [check.passed for check in report.checks if check.claim == "online ellipsoid"]
    assert len(held) == 2
    assert all(held) == (lie == "none")
