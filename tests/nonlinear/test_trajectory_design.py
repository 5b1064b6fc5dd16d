"""Plants that vary in time: transitions against closed forms, accuracy against sums, designs against all choices."""

from itertools import combinations
from types import SimpleNamespace

import casadi
import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear.conversion import from_linear
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.time_varying import plant_along
from sampling_design.nonlinear.trajectory_design import design_along
from sampling_design.plants.time_varying import TimeVaryingPlant

A, C, G = np.array([[0.1, 1.0], [-2.0, -0.3]]), np.array([[1.0, 0.0]]), np.array([[0.0], [1.0]])
FIXED = TimeVaryingPlant(lambda t: A, lambda t: C, lambda t: G, horizon=3.0)
TIMES = np.array([0.0, 0.4, 1.7, 3.0])


def test_transitions_are_those_of_the_matrix_exponential():
    motion = FIXED.motion(TIMES, [0.5])
    for k, h in enumerate(np.diff(TIMES)):
        both = expm(h * np.block([[-A, 0.25 * G @ G.T], [np.zeros((2, 2)), A.T]]))  # Van Loan
        np.testing.assert_allclose(motion.F[k], both[2:, 2:].T, rtol=1e-7)
        np.testing.assert_allclose(motion.W[k], both[2:, 2:].T @ both[:2, 2:], rtol=1e-6, atol=1e-9)
    assert motion.error < 1e-7
    # a scalar with a closed form: x' = cos(t) x
    wave = TimeVaryingPlant(lambda t: [[np.cos(t)]], lambda t: [[1.0]], horizon=9.0)
    assert wave.motion([0.0, 7.0]).F[0, 0, 0] == pytest.approx(np.exp(np.sin(7.0)), rel=1e-7)
    assert wave.motion([0.0, 7.0]).W[0, 0, 0] == 0.0


def test_tables_run_straight_and_units_change_no_transition():
    table = TimeVaryingPlant.from_table([0.0, 2.0], [[[0.0]], [[2.0]]], [[[1.0]], [[3.0]]])
    assert table.motion([0.0, 1.0, 2.0]).F[:, 0, 0] == pytest.approx(np.exp([0.5, 1.5]), rel=1e-7)
    assert table.motion([0.0, 1.0]).C[:, 0, 0].tolist() == [1.0, 2.0]
    s = np.array([1e-9, 1e6])
    signals = {"states": sd.Signals(("a", "b"), (), s), "outputs": sd.Signals(("y",), (), [1e-9])}
    scaled = TimeVaryingPlant(lambda t: A * s[:, None] / s, lambda t: C * 1e-9 / s, horizon=3.0, **signals)
    np.testing.assert_allclose(scaled.motion(TIMES).F, FIXED.motion(TIMES).F, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(scaled.motion(TIMES).C, FIXED.motion(TIMES).C, rtol=1e-12)


def test_along_a_linear_plant_it_is_the_plant_itself():
    linear = from_linear(sd.Plant(A, C, G=G))
    along = plant_along(linear, [1.0, -1.0], 3.0)
    np.testing.assert_allclose(along.motion(TIMES, [0.5]).F, FIXED.motion(TIMES, [0.5]).F, rtol=1e-8)
    np.testing.assert_allclose(along.motion(TIMES, [0.5]).W, FIXED.motion(TIMES, [0.5]).W, rtol=1e-8)
    assert "2 states, 1 output, over 3 s" in along.explain()
    assert "horizon" in str(along)


def expected(chosen, prior, v):
    """Root of the trace at the end, by adding information at the start."""
    information = np.diag(1 / np.square(prior))
    for t in chosen:
        row = C @ expm(A * t)
        information += row.T @ row / v**2
    F = expm(A * 3.0)
    return np.sqrt(np.trace(F @ np.linalg.inv(information) @ F.T))


def test_a_design_is_the_best_of_all_choices_where_they_can_be_counted():
    grid = np.linspace(0.0, 3.0, 9)
    found = design_along(FIXED, 3, prior=[1.0, 2.0], v=[0.3], candidates=grid)
    values = {chosen: expected(chosen, [1.0, 2.0], 0.3) for chosen in combinations(grid.tolist(), 3)}
    assert found.accuracy == pytest.approx(min(values.values()), rel=1e-7)
    assert found.accuracy == pytest.approx(values[tuple(found.times.tolist())], rel=1e-7)
    assert found.even_accuracy == pytest.approx(values[tuple(found.even_times.tolist())], rel=1e-7)
    rows = np.vstack([C @ expm(A * t) for t in found.times])
    assert found.sigma[0] == pytest.approx(np.linalg.svd(rows)[1][-1], rel=1e-6)
    assert found.closed
    assert found.gain > 0
    # a sample less at the same times cannot be better, noise on w neither
    assert design_along(FIXED, 2, prior=[1.0, 2.0], v=[0.3], candidates=grid).accuracy > found.accuracy
    loud = design_along(FIXED, 3, prior=[1.0, 2.0], v=[0.3], w=[0.2], candidates=grid)
    assert loud.accuracy > found.accuracy


def orbit(eccentricity):
    def pull(x, u, w):
        cube = (x[0] ** 2 + x[1] ** 2) ** 1.5
        return [x[2], x[3], -x[0] / cube, -x[1] / cube]

    sizes = {"states": 4, "outputs": 1}
    plant = NonlinearPlant(pull, lambda x, u, v: [casadi.atan2(x[1], x[0]) + v[0]], sizes, name="orbit")
    e = eccentricity
    return plant_along(plant, [1 - e, 0.0, 0.0, np.sqrt((1 + e) / (1 - e))], 2 * np.pi)


def test_bearings_of_an_orbit_are_taken_near_its_ends():
    found = design_along(orbit(0.6), 5, prior=[0.1] * 4, v=[0.01], candidates=25)
    assert found.even_accuracy == pytest.approx(0.0229, rel=0.02)
    assert found.gain > 0.3
    assert "% less" in found.explain()
    coarse = design_along(orbit(0.6), 5, prior=[0.1] * 4, v=[0.07], candidates=25)
    assert (coarse.accuracy, coarse.even_accuracy) == pytest.approx((0.0948, 0.1240), rel=1e-3)
    assert coarse.sigma[0] < coarse.even_sigma[0] / 5  # along one trajectory sigma is another question
    ensemble = [orbit(e) for e in (0.5, 0.7)]
    for criterion in ("mean", "worst"):
        many = design_along(ensemble, 5, prior=[0.1] * 4, v=[0.01], candidates=9, criterion=criterion)
        assert many.accuracy <= many.even_accuracy
        assert many.accuracies.shape == many.sigma.shape == (2,)
        whole = many.accuracies.mean() if criterion == "mean" else many.accuracies.max()
        assert many.accuracy == pytest.approx(whole)
    assert "even spacing" in str(many)


def test_where_even_spacing_is_as_good_it_says_so():
    flat = TimeVaryingPlant(lambda t: [[0.0]], lambda t: [[1.0]], horizon=1.0)
    found = design_along(flat, 2, prior=[1.0], v=[1.0], candidates=5)
    assert found.gain == 0.0
    assert "Even spacing is as good" in found.explain()


def test_bad_arguments_are_refused():
    with pytest.raises(ArgumentError, match="`plants` must be one or more plants with one horizon"):
        design_along([], 2, prior=[1.0], v=[1.0])
    with pytest.raises(ArgumentError, match="`criterion` must be one of 'mean', 'worst'"):
        design_along(FIXED, 2, prior=[1.0, 1.0], v=[1.0], criterion="best")
    with pytest.raises(ArgumentError, match="`count` must be at most the 3 candidates"):
        design_along(FIXED, 4, prior=[1.0, 1.0], v=[1.0], candidates=3)
    with pytest.raises(ArgumentError, match="`prior` and `v` must hold positive standard deviations"):
        design_along(FIXED, 2, prior=[1.0, 0.0], v=[1.0])
    with pytest.raises(ArgumentError, match="`times` must begin at 0 and go on"):
        TimeVaryingPlant.from_table([1.0, 2.0], [[[0.0]], [[2.0]]], [[[1.0]], [[3.0]]])
    with pytest.raises(ArgumentError, match="`A` must hold one finite matrix for each of the 2 times"):
        TimeVaryingPlant.from_table([0.0, 2.0], [[[0.0]]], [[[1.0]], [[3.0]]])
    with pytest.raises(ArgumentError, match=r"`times` must lie in \[0, 3\]"):
        FIXED.motion([0.0, 4.0])
    with pytest.raises(ArgumentError, match="`states` must have 2 entries, got 1"):
        TimeVaryingPlant(lambda t: A, lambda t: C, horizon=1.0, states=sd.Signals(("a",)))
    late = TimeVaryingPlant(lambda t: [[np.nan if t > 0.5 else 1.0]], lambda t: [[1.0]], horizon=1.0)
    with pytest.raises(ArgumentError, match="`A` must be finite on the whole horizon"):
        late.motion([0.0, 1.0])
    steep = TimeVaryingPlant(lambda t: [[1 / abs(1.0 - t + 1e-300) ** 2]], lambda t: [[1.0]], horizon=2.0)
    with pytest.raises(SolverError, match="the integration comes to a stop at t = "):
        steep.motion([0.0, 1.5])


def test_an_integrator_that_gives_up_is_named(monkeypatch):
    for room in ("nonlinear", "plants"):
        monkeypatch.setattr(
            f"sampling_design.{room}.time_varying.solve_ivp", lambda *args, **options: SimpleNamespace(success=False)
        )
    with pytest.raises(SolverError, match=r"the integration comes to a stop at t = 0: "):
        FIXED.motion([0.0, 1.5])
    still = NonlinearPlant(lambda x, u, w: [0.0 * x[0]], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    with pytest.raises(SolverError, match="the nominal trajectory cannot be followed"):
        plant_along(still, [1.0], 2.0)
