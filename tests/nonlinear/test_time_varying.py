"""Plants that vary in time: transitions against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

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


def test_the_worst_small_deviation_is_one_of_the_nonlinear_plant():
    """What a linear program finds worst along the trajectory is simulated: as hidden, and as far away at the end."""
    rate = lambda x, w: np.array([x[1], x[0] - x[0] ** 3 - 0.1 * x[1] + w])  # noqa: E731
    duffing = NonlinearPlant(
        lambda x, u, w: [x[1], x[0] - x[0] ** 3 - 0.1 * x[1] + w[0]],
        lambda x, u, v: [x[0] + v[0]],
        {"states": 2, "outputs": 1, "disturbances": 1},
    )
    begun, end, cells, small, v = np.array([1.4, 0.2]), 2.0, 20, 1e-5, 0.1
    along = plant_along(duffing, begun, end)
    schedule, h = sd.Schedule([0.0, 1.0]), end / cells
    given = {"w_bound": [small], "v_bound": [v * small], "of": [[0.3, 1.0]], "end": end}
    found = sd.guaranteed_accuracy(along, schedule, **given)
    F = along.transitions(np.linspace(0.0, end, 2 * cells + 1)).F
    of_start, of_w, read = np.eye(2), np.zeros((2, cells)), []
    for k in range(cells + 1):
        if k * h in schedule.times:
            read.append(np.append(of_start[0], of_w[0]))
        if k < cells:
            whole = F[2 * k + 1] @ F[2 * k]
            of_start, of_w = whole @ of_start, whole @ of_w
            of_w[:, k] = h * F[2 * k + 1] @ [0.0, 1.0]
    row = np.array([0.3, 1.0]) @ np.hstack([of_start, of_w])
    worst = linprog(-row, np.vstack([read, np.negative(read)]), [v] * 4, bounds=[(None, None)] * 2 + [(-1, 1)] * cells)
    ways = []
    for size in (0.0, small):
        x, way = begun + size * worst.x[:2], [begun + size * worst.x[:2]]
        for w in np.repeat(size * worst.x[2:], 10):  # by the rule of Runge and Kutta, of order four
            a = rate(x, w)
            b = rate(x + h / 20 * a, w)
            c = rate(x + h / 20 * b, w)
            x = x + h / 60 * (a + 2 * b + 2 * c + rate(x + h / 10 * c, w))
            way.append(x)
        ways.append(np.array(way))
    away = (ways[1] - ways[0]) / small
    assert np.all(np.abs(away[[0, 100], 0]) <= v * (1 + 1e-2))
    reached = small * abs(away[-1] @ [0.3, 1.0])
    assert found.times[-1] == end
    assert reached == pytest.approx(-small * worst.fun, rel=2e-3)
    assert 0.995 * found.lower[0, -1] <= reached <= 1.005 * found.upper[0, -1]


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
