"""Accuracy along plants that vary in time: against plants that do not, a closed form, and random adversaries."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant
from tests.cases import few

A, C, G = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]]), np.array([[0.0], [1.0]])
SAMPLES = sd.Schedule([0.0, 1.0, 1.6, 3.0, 4.0])
STILL = TimeVaryingPlant.from_table([0.0, 5.0], [A] * 2, [C] * 2, [G] * 2)


@pytest.mark.parametrize("start", few([None, [1.0, 0.4], {"x1": 0.5}], 0))
def test_a_plant_that_stands_still_has_the_accuracy_of_the_plant(start):
    given = {"w_bound": 0.02, "v_bound": 0.1, "initial_error": start}
    plain, found = (sd.guaranteed_accuracy(p, SAMPLES, **given) for p in (sd.Plant(A, C, G=G), STILL))
    low, up = found.largest
    assert np.all(found.closed)
    assert np.all(low <= up * (1 + 1e-9))
    np.testing.assert_allclose(up, plain.upper, rtol=2e-3)
    np.testing.assert_allclose(found.known_from, plain.known_from)


def test_a_scalar_that_grows_and_shrinks_has_a_closed_form():
    # x' = a(t) x + w, one exact slope: error v e^{a(t)} + w int e^{a(t) - a(s)}, with a(t) = t - t^2/4 from a table
    plant = TimeVaryingPlant.from_table([0.0, 4.0], [[[1.0]], [[-1.0]]], [[[1.0]]] * 2, [[[1.0]]] * 2)
    found = sd.guaranteed_accuracy(plant, sd.Schedule([0.0]), w_bound=0.3, v_bound=0.1, end=4.0)
    grown = lambda t: t - t**2 / 4  # noqa: E731
    for t, up in zip(found.times.tolist(), found.upper[0].tolist(), strict=True):
        s = np.linspace(0.0, t, 20001)
        w = np.trapezoid(np.exp(grown(t) - grown(s)), s) if t else 0.0
        assert up == pytest.approx(0.1 * np.exp(grown(t)) + 0.3 * w, rel=1e-4)
    np.testing.assert_allclose(found.lower, found.upper, rtol=1e-4)
    assert found.worst[0] == 3.0, "it grows until 2 and w on top of it longer"


def test_no_adversary_beats_what_gains_guarantee():
    rng = np.random.default_rng(0)
    table = [[[0.0, 1.0], [-1.0 - k, -0.2]] for k in (0.0, 1.0, 0.0)]
    plant = TimeVaryingPlant.from_table([0.0, 2.0, 4.0], table, [C, [[0.5, 0.5]], C], [G] * 3)
    found = sd.guaranteed_accuracy(
        plant, SAMPLES, w_bound=[0.2], v_bound=[0.05], initial_error=[1.0, np.inf], of=[[1.0, -1.0]]
    )
    grid = np.linspace(0.0, 4.0, 161)
    motion = plant.transitions(grid)
    at = np.searchsorted(grid, SAMPLES.times - 1e-9)
    state = rng.normal(size=(4000, 2)) * [0.3, 0.3]
    inside = np.abs(state[:, 0]) <= 1.0
    for k in range(grid.size):
        if k in at:
            inside &= np.abs(state @ motion.C[k][0]) <= 0.05
        if k < grid.size - 1:
            push = 0.2 * np.sign(rng.normal(size=(4000, 1)))
            state = state @ motion.F[k].T + push * 0.025 * (motion.F[k] @ G).ravel() * 0.999
    assert inside.sum() > 5
    assert np.abs(state[inside] @ [1.0, -1.0]).max() <= found.upper[0, -1]


@pytest.mark.long
def test_rows_that_samples_do_not_determine_are_without_bound():
    first = sd.guaranteed_accuracy(STILL, sd.Schedule([1.0]), w_bound=0.1, v_bound=0.1)
    assert first.upper.tolist() == [[0.1], [np.inf]]
    assert "without bound" in str(first)
    assert "nothing of x2" in first.explain()
    assert first.to_dict()["upper"] == [[0.1], [None]]
    exact = sd.guaranteed_accuracy(STILL, SAMPLES, w_bound=0.0, v_bound=0.0)
    assert exact.known_from.tolist() == [1.0, 1.0]
    assert np.all(exact.largest[1] < 1e-9)
    mask = sd.Schedule(SAMPLES.times, [[True, False]] * 5)
    two = TimeVaryingPlant.from_table([0.0, 5.0], [A] * 2, [np.eye(2)] * 2, [G] * 2)
    one, both = (sd.guaranteed_accuracy(two, s, w_bound=[0.02], v_bound=[0.1, 0.1]) for s in (mask, SAMPLES))
    np.testing.assert_allclose(
        one.largest[1], sd.guaranteed_accuracy(STILL, SAMPLES, w_bound=0.02, v_bound=0.1).largest[1]
    )
    assert np.all(both.largest[1] < one.largest[1])


def test_units_change_nothing_but_the_unit():
    unit = np.array([1e-9, 1e6])
    signals = {"states": sd.plants.Signals(("a", "b"), (), unit), "outputs": sd.plants.Signals(("y",), (), [1e-9])}
    parts = A * unit[:, None] / unit, C * 1e-9 / unit, G * unit[:, None]
    scaled = TimeVaryingPlant.from_table([0.0, 5.0], *([part] * 2 for part in parts), **signals)
    own = sd.guaranteed_accuracy(scaled, SAMPLES, w_bound=0.02, v_bound=1e-10)
    np.testing.assert_allclose(
        own.largest[1], sd.guaranteed_accuracy(STILL, SAMPLES, w_bound=0.02, v_bound=0.1).largest[1] * unit
    )
    assert own.proven
    assert "Nothing is proven between these times" in own.explain()


@pytest.mark.parametrize("seed", few(range(12), 0, 1, 2))
def test_what_readings_determine_depends_on_no_unit(seed):
    rng = np.random.default_rng(seed)  # nothing moves: three readings are three equations for three states
    rows = rng.normal(size=(3, 3)) / 10.0 ** rng.integers(-9, 10, 3)
    plant = TimeVaryingPlant.from_table([0.0, 1.0, 2.0], np.zeros((3, 3, 3)), rows[:, None])
    found = sd.guaranteed_accuracy(plant, sd.Schedule([0.0, 1.0, 2.0]), v_bound=[0.1])
    assert np.all(np.isinf(found.upper[:, :-1]))
    np.testing.assert_allclose(found.upper[:, -1], 0.1 * np.abs(np.linalg.inv(rows)).sum(axis=1), rtol=1e-6)
    np.testing.assert_allclose(found.lower[:, -1], found.upper[:, -1], rtol=1e-6)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_what_an_exact_sensor_leaves_is_one_disturbance_in_any_unit(unit):
    plant = TimeVaryingPlant.from_table([0.0, 4.0], [[[0.0]]] * 2, [[[1 / unit]]] * 2, [[[unit]]] * 2)
    found = sd.guaranteed_accuracy(plant, sd.Schedule([0.0, 1.0, 3.0]), w_bound=[0.1], v_bound=[0.0], end=4.0)
    t, last = found.times, np.searchsorted([1.0, 3.0], found.times)
    since = t - np.array([0.0, 1.0, 3.0])[last]
    taken = np.append(False, np.diff(t) == 0) | (t == 0.0)  # of a sample: after it, and before it
    since[taken] = 0.0
    np.testing.assert_allclose(found.upper[0], 0.1 * unit * since, rtol=1e-6, atol=1e-9 * unit)
    np.testing.assert_allclose(found.lower[0], 0.1 * unit * since, rtol=1e-6, atol=1e-9 * unit)


def test_what_no_reading_observes_is_without_bound_however_little_it_moves():
    table = [[[0.0, 1e-12], [0.0, 0.0]]] * 2
    plant = TimeVaryingPlant.from_table([0.0, 1.0], table, [[[0.0, 0.0]]] * 2, [[[1.0], [0.0]]] * 2)
    found = sd.guaranteed_accuracy(
        plant, sd.Schedule([0.0, 1.0]), w_bound=[1.0], v_bound=[0.1], initial_error=[0.0, np.inf]
    )
    assert found.upper[0, 0] == 0.0
    assert np.all(np.isinf(found.upper[0, 1:]))


def test_bad_arguments_are_refused(monkeypatch):
    given = {"w_bound": 0.1, "v_bound": 0.1}
    with pytest.raises(ArgumentError, match="`schedule` must be a Schedule with samples within the plant's horizon"):
        sd.guaranteed_accuracy(STILL, sd.PeriodicSchedule([1.0]), **given)
    with pytest.raises(ArgumentError, match=r"must follow each other within \[0, 5\], the plant's horizon"):
        sd.guaranteed_accuracy(STILL, sd.Schedule([0.0, 6.0]), **given)
    with pytest.raises(ArgumentError, match="`of` must name states, or be rows of a matrix"):
        sd.guaranteed_accuracy(STILL, SAMPLES, of="y1", **given)
    with pytest.raises(ArgumentError, match="must hold one number for each entry here, not one bound on the norm"):
        sd.guaranteed_accuracy(STILL, SAMPLES, initial_error=1.0, **given)
    with pytest.raises(ArgumentError, match="`w_intensity` must be left out for accuracy of a plant that varies"):
        sd.guaranteed_accuracy(STILL, SAMPLES, w_intensity=1.0, **given)
    monkeypatch.setattr("scipy.optimize.linprog", lambda *a, **k: type("Lost", (), {"status": 4, "message": "lost"}))
    with pytest.raises(SolverError, match="the program of a row was not solved: lost"):
        sd.guaranteed_accuracy(STILL, SAMPLES, **given)
