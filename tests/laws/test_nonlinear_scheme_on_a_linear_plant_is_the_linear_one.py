"""On a linear plant the nonlinear estimator tends to the linear one, at order 2 in the grid of w."""

import casadi
import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.nonlinear.collocation import Collocation, WindowSolver
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from tests.cases import few

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
PENDULUM = sd.plants.library.cart_pendulum()
TIMES = np.array([0.0, 0.8, 1.6, 3.2, 4.0, 5.6, 6.4])


def samples(plant, stretch):
    rng = np.random.default_rng(7)
    start = 0.1 * np.arange(1.0, plant.n_states + 1)
    noise = 0.05 * rng.standard_normal((TIMES.size, plant.n_outputs))
    return [
        (t, plant.C @ plant.transition(t) @ start + v, np.full(plant.n_inputs, 0.2 * (-1) ** k))
        for k, (t, v) in enumerate(zip(stretch * TIMES, noise, strict=True))
    ]


@pytest.mark.parametrize(
    ("plant", "stretch", "weights"),
    few(
        [
            (OSCILLATOR, 1.0, {"Qw": np.diag([2.0, 1.0]), "R": [[5.0]], "Qv": [[3.0]], "eta": 0.3}),
            (PENDULUM, 0.25, {"eta": 0.5}),
        ],
        0,
    ),
)
def test_error_falls_by_four_with_every_halving(plant, stretch, weights):
    record, horizon = samples(plant, stretch), 3.2 * stretch
    linear = sd.MovingHorizonEstimator(plant, horizon=horizon, cost=sd.CostFunction(form="paper", **weights)).run(
        record
    )
    errors, costs = [], []
    for step in (0.4, 0.2, 0.1):
        scheme = NonlinearMovingHorizonEstimator(
            from_linear(plant),
            horizon=horizon,
            collocation=Collocation(w_step=step * stretch, degree=3),
            solver=WindowSolver(1e-11),
            cost=CostFunction(**weights),
        )
        found = scheme.run(record)
        assert set(found.status) == {"ok"}
        errors.append(np.abs((found.x - linear.x) / plant.states.scales).max())
        costs.append(np.abs(found.cost - linear.cost).max())
    assert errors[-1] > 1e-9  # else the ratios say nothing
    assert np.divide(errors[:-1], errors[1:]) == pytest.approx([4.0, 4.0], rel=0.1)
    assert np.divide(costs[:-1], costs[1:]) == pytest.approx([4.0, 4.0], rel=0.1)


def test_without_disturbances_they_agree_to_the_tolerance():
    # weights on w so large that w = 0: nothing is left to approximate but the flow, of order 5 here
    plant, weights = OSCILLATOR, {"Qw": 1e6 * np.eye(2), "eta": 0.3}
    record = samples(plant, 1.0)
    linear = sd.MovingHorizonEstimator(plant, horizon=3.2, cost=sd.CostFunction(form="paper", **weights)).run(record)
    scheme = NonlinearMovingHorizonEstimator(
        from_linear(plant),
        horizon=3.2,
        collocation=Collocation(w_step=0.1, degree=3),
        solver=WindowSolver(1e-11),
        cost=CostFunction(**weights),
    )
    assert scheme.run(record).x == pytest.approx(linear.x, abs=2e-8)


def test_open_loop_between_samples_agrees_likewise():
    record = samples(PENDULUM, 0.25)[:4]
    linear = sd.MovingHorizonEstimator(PENDULUM, horizon=0.8, cost=sd.CostFunction(form="paper", eta=0.5))
    linear.run(record)
    gaps = []
    for step in (0.05, 0.025):
        scheme = NonlinearMovingHorizonEstimator(
            from_linear(PENDULUM),
            horizon=0.8,
            collocation=Collocation(w_step=step, degree=3),
            cost=CostFunction(eta=0.5),
        )
        scheme.run(record)
        found = scheme.predict(0.95)
        assert found.status == "predicted"
        gaps.append(np.abs((found.x - linear.predict(0.95).x) / PENDULUM.states.scales).max())
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.1)


def test_near_an_equilibrium_it_is_that_of_the_linearisation_up_to_third_order():
    # a pendulum: sin x = x - x^3/6 + ..., so halving the amplitude divides the difference by 8
    swing = NonlinearPlant(
        lambda x, u, w: [x[1], -casadi.sin(x[0]) - 0.1 * x[1] + w[0]],
        lambda x, u, v: [x[0] + v[0]],
        {"states": 2, "disturbances": 1, "outputs": 1},
    )
    linear = from_linear(swing.linearise([0.0, 0.0]))
    rng = np.random.default_rng(3)
    y = np.cos(TIMES) + 0.1 * rng.standard_normal(TIMES.size)
    gaps = []
    for size in (0.2, 0.1, 0.05):
        runs = [
            NonlinearMovingHorizonEstimator(
                plant,
                horizon=3.2,
                cost=CostFunction(eta=0.3),
                collocation=Collocation(w_step=0.4),
                solver=WindowSolver(1e-12),
            ).run((t, [size * value]) for t, value in zip(TIMES, y, strict=True))
            for plant in (swing, linear)
        ]
        gaps.append(np.abs(runs[0].x - runs[1].x).max())
    assert np.divide(gaps[:-1], gaps[1:]) == pytest.approx([8.0, 8.0], rel=0.1)
