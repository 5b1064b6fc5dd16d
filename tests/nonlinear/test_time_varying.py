"""Plants that vary in time: transitions against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from sampling_design.nonlinear.simulation import plant_along
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant

A, C, G = np.array([[0.1, 1.0], [-2.0, -0.3]]), np.array([[1.0, 0.0]]), np.array([[0.0], [1.0]])
FIXED = TimeVaryingPlant(lambda t: A, lambda t: C, lambda t: G, horizon=3.0)
TIMES = np.array([0.0, 0.4, 1.7, 3.0])


def test_transitions_are_those_of_the_matrix_exponential():
    motion = FIXED.transitions(TIMES)
    np.testing.assert_allclose(motion.F, [expm(h * A) for h in np.diff(TIMES)], rtol=1e-7)
    assert motion.error < 1e-7
    # a scalar with a closed form: x' = cos(t) x
    wave = TimeVaryingPlant(lambda t: [[np.cos(t)]], lambda t: [[1.0]], horizon=9.0)
    assert wave.transitions([0.0, 7.0]).F[0, 0, 0] == pytest.approx(np.exp(np.sin(7.0)), rel=1e-7)


def test_tables_run_straight_and_units_change_no_transition():
    table = TimeVaryingPlant.from_table([0.0, 2.0], [[[0.0]], [[2.0]]], [[[1.0]], [[3.0]]])
    assert table.transitions([0.0, 1.0, 2.0]).F[:, 0, 0] == pytest.approx(np.exp([0.5, 1.5]), rel=1e-7)
    assert table.transitions([0.0, 1.0]).C[:, 0, 0].tolist() == [1.0, 2.0]
    s = np.array([1e-9, 1e6])
    signals = {"states": sd.plants.Signals(("a", "b"), (), s), "outputs": sd.plants.Signals(("y",), (), [1e-9])}
    scaled = TimeVaryingPlant(lambda t: A * s[:, None] / s, lambda t: C * 1e-9 / s, horizon=3.0, **signals)
    np.testing.assert_allclose(scaled.transitions(TIMES).F, FIXED.transitions(TIMES).F, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(scaled.transitions(TIMES).C, FIXED.transitions(TIMES).C, rtol=1e-12)


def test_along_a_linear_plant_it_is_the_plant_itself():
    linear = from_linear(sd.Plant(A, C, G=G))
    along = plant_along(linear, [1.0, -1.0], 3.0)
    np.testing.assert_allclose(along.transitions(TIMES).F, FIXED.transitions(TIMES).F, rtol=1e-8)
    np.testing.assert_allclose(along.G(1.0), G)
    assert "2 states, 1 output, over 3 s" in along.explain()
    assert "horizon" in str(along)


def test_noise_that_is_not_added_has_no_bound_beside_outputs():
    """v of a relative error is no noise of y, whose bound would be taken for it."""
    relative = NonlinearPlant(lambda x, u, w: [-x[0]], lambda x, u, v: [x[0] * (1 + v[0])], {"states": 1, "outputs": 1})
    with pytest.raises(ArgumentError, match="`plant` must add its noise to its outputs"):
        plant_along(relative, [2.0], 1.0)
    unseen = NonlinearPlant(lambda x, u, w: [-x[0]], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    assert plant_along(unseen, [2.0], 1.0).C(0.5) == [[1.0]]


def test_bad_arguments_are_refused():
    with pytest.raises(ArgumentError, match="`times` must begin at 0 and go on"):
        TimeVaryingPlant.from_table([1.0, 2.0], [[[0.0]], [[2.0]]], [[[1.0]], [[3.0]]])
    with pytest.raises(ArgumentError, match="`A` must hold one finite matrix for each of the 2 times"):
        TimeVaryingPlant.from_table([0.0, 2.0], [[[0.0]]], [[[1.0]], [[3.0]]])
    with pytest.raises(ArgumentError, match=r"`times` must lie in \[0, 3\]"):
        FIXED.transitions([0.0, 4.0])
    with pytest.raises(ArgumentError, match="`states` must have 2 entries, got 1"):
        TimeVaryingPlant(lambda t: A, lambda t: C, horizon=1.0, states=sd.plants.Signals(("a",)))
    late = TimeVaryingPlant(lambda t: [[np.nan if t > 0.5 else 1.0]], lambda t: [[1.0]], horizon=1.0)
    with pytest.raises(ArgumentError, match="`A` must be finite on the whole horizon"):
        late.transitions([0.0, 1.0])
    steep = TimeVaryingPlant(lambda t: [[1 / abs(1.0 - t + 1e-300) ** 2]], lambda t: [[1.0]], horizon=2.0)
    with pytest.raises(SolverError, match="the integration comes to a stop at t = "):
        steep.transitions([0.0, 1.5])


def test_an_integrator_that_gives_up_is_named(monkeypatch):
    given_up = SimpleNamespace(success=False)
    monkeypatch.setattr("sampling_design.uncertain.plants.time_varying.solve_ivp", lambda *_, **options: given_up)
    with pytest.raises(SolverError, match=r"the integration comes to a stop at t = 0: "):
        FIXED.transitions([0.0, 1.5])
    still = NonlinearPlant(lambda x, u, w: [0.0 * x[0]], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    with pytest.raises(SolverError, match=r"the integration comes to a stop at t = 0: the trajectory escapes"):
        plant_along(still, [1.0], 2.0)
