"""Simulation against another integrator, stiff and not."""

import numpy as np
import pytest

from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.thyroid import PRIOR_START, PROCESS_BOUND, SCALING, thyroid
from tests.oracles import nonlinear as oracle

PUSHED = NonlinearPlant(
    lambda x, u, w: [x[1], -(x[0] ** 3) + u[0] + w[0]],
    lambda x, u, v: [x[0]],
    {"states": 2, "inputs": 1, "disturbances": 1, "outputs": 1},
    bounds={"states": (-2.0, 2.0)},
)


def test_inputs_and_disturbances_hold_between_the_times():
    times = [0.0, 0.4, 1.0, 1.3]
    u, w = np.array([[0.1], [-0.3], [0.2], [9.0]]), np.array([[0.0], [0.5], [-0.5], [9.0]])
    found = simulate(PUSHED, [0.5, 0.0], times, u, w)
    x = np.array([0.5, 0.0])
    for k in range(3):
        x = oracle.flow(
            lambda z, a, b: np.array([z[1], -(z[0] ** 3) + a[0] + b[0]]), x, u[k], w[k], times[k + 1] - times[k]
        )
        assert found[k + 1] == pytest.approx(x, abs=1e-8)


def test_a_stiff_plant_agrees_with_an_implicit_runge_kutta_method():
    plant, w = thyroid(), np.array([0.5, -0.7]) * PROCESS_BOUND

    def scaled(z, a, b):
        return plant.f(z / SCALING, [0.0, 0.0], w) * SCALING

    slow = oracle.flow(scaled, PRIOR_START * SCALING, None, None, 0.1, method="Radau")
    assert simulate(plant, PRIOR_START, [0.0, 0.1], w=w)[1] * SCALING == pytest.approx(slow, rel=1e-7)


def test_what_cannot_be_simulated_is_refused():
    assert simulate(PUSHED, [-2.0, 2.0], [0.0, 0.1]).shape == (2, 2)  # a bound belongs to the box
    with pytest.raises(ArgumentError, match="`x0` must lie in the plant's box of states, got x2 = 3"):
        simulate(PUSHED, [0.0, 3.0], [0.0, 1.0])
    with pytest.raises(ArgumentError, match=r"`u` must have shape \(2, 1\)"):
        simulate(PUSHED, [0.0, 0.0], [0.0, 1.0], u=np.zeros((3, 1)))
    with pytest.raises(ArgumentError, match="`times` must increase strictly"):
        simulate(PUSHED, [0.0, 0.0], [1.0, 1.0])
    burst = NonlinearPlant(lambda x, u, w: [x[0] ** 2], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    with pytest.raises(SolverError, match=r"the integration fails between t = 0\.5 and 2 s") as caught:
        simulate(burst, [1.0], [0.0, 0.5, 2.0])
    assert caught.value.status == "integration failed"


def test_the_integrator_says_nothing_on_the_streams(capfd):
    burst = NonlinearPlant(lambda x, u, w: [x[0] ** 2], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    with pytest.raises(SolverError, match="the integration fails"):
        simulate(burst, [1.0], [0.0, 2.0])
    assert capfd.readouterr() == ("", "")
