"""Plant and Signals: what they accept, keep, refuse, and convert."""

import control
import numpy as np
import pytest
import scipy.signal

from sampling_design import ArgumentError, Plant, Signals, library

A = [[0.0, 1.0], [-1.0, 0.0]]
C = [[1.0, 0.0]]


def test_defaults():
    plant = Plant(A, C)
    assert (plant.n_states, plant.n_outputs, plant.n_inputs, plant.n_disturbances) == (2, 1, 0, 2)
    np.testing.assert_array_equal(plant.G, np.eye(2))
    assert plant.D.shape == (1, 0)
    assert plant.states.names == ("x1", "x2")
    assert plant.disturbances.names == ("w1", "w2")
    assert not plant.has_scales


def test_arrays_are_copied_and_read_only():
    mine = np.array(A)
    plant = Plant(mine, C)
    mine[0, 0] = 9.0
    assert plant.A[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        plant.A[0, 0] = 1.0


def test_integers_become_floats():
    assert Plant([[0, 1], [-1, 0]], [[1, 0]]).A.dtype == np.float64


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"A": [[0.0, 1.0]]}, r"`A` must be square, got shape \(1, 2\)"),
        ({"A": [[0.0, np.nan], [0.0, 0.0]]}, r"`A` must be finite, got A\[0, 1\] = nan"),
        ({"A": [[0.0, np.inf], [0.0, 0.0]]}, r"`A` must be finite, got A\[0, 1\] = inf"),
        ({"A": [[1j, 0.0], [0.0, 0.0]]}, "`A` must be real, got complex entries. Use a real basis"),
        ({"A": [[0.0, 1.0], [2.0]]}, "`A` must be a rectangular array of numbers"),
        ({"A": [["a", "b"], ["c", "d"]]}, "`A` must hold real numbers"),
        ({"A": None}, "`A` must hold real numbers, got None"),
        ({"A": [1.0, 2.0]}, r"`A` must have 2 dimensions, got shape \(2,\)"),
        ({"C": np.zeros((0, 2))}, "`C` must have at least one row: a plant without outputs cannot be measured"),
        ({"C": []}, "`C` must have at least one row: a plant without outputs cannot be measured"),
        ({"C": [[1.0], [0.0]]}, r"`C` must have shape \(2, 2\), got \(2, 1\)"),
        ({"B": [[1.0, 0.0]]}, r"`B` must have shape \(2, 2\), got \(1, 2\)"),
        ({"B": [[1.0], [0.0]], "D": [[1.0, 2.0]]}, r"`D` must have shape \(1, 1\), got \(1, 2\)"),
        ({"G": [[1.0]]}, r"`G` must have shape \(2, 1\), got \(1, 1\)"),
        ({"time_unit": "y"}, "`time_unit` must be one of ms, s, min, h, d, wk, got 'y'"),
        ({"time_unit": ""}, "`time_unit` is missing"),
        ({"name": 3}, "`name` must be a string, got int 3"),
        ({"states": ["a"]}, "`states` must have 2 entries, got 1"),
        ({"states": Signals(["a"])}, "`states` must have 2 entries, got 1"),
        ({"states": ["a", "a"]}, "`states` must be distinct, got 'a' twice"),
        ({"outputs": "y"}, "`outputs` must be a list of strings, got str 'y'"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        Plant(**{"A": A, "C": C, **arguments})


def test_transpose_is_suspected_where_it_fits():
    with pytest.raises(ArgumentError, match=r"`D` must have shape \(2, 1\), got \(1, 2\). Did you pass the transpose"):
        Plant(A, np.eye(2), B=[[1.0], [0.0]], D=[[1.0, 2.0]])


def test_signals_refuse():
    with pytest.raises(ArgumentError, match="`names` must be a list of strings, got str 'ab'"):
        Signals("ab")
    with pytest.raises(ArgumentError, match="`units` must be 2 strings, one per name"):
        Signals(["a", "b"], ["m"])
    with pytest.raises(ArgumentError, match="`scales` must be positive"):
        Signals(["a"], scales=[0.0])
    with pytest.raises(ArgumentError, match="`scales` must have 1 entry, got 2"):
        Signals(["a"], scales=[1.0, 2.0])


def test_signals_say_what_they_are():
    signals = Signals(["level", "flow"], ["m", ""], [2.0, 1.0])
    assert signals.labels() == ("level [m]", "flow")
    assert signals.explain() == "Entries: level [m], flow."
    assert "scale 2" in str(signals)


def test_scaled_coordinates():
    plant = library.satellite()
    scaled = plant.scaled()
    s = plant.states.scales
    x = np.arange(1.0, 7.0)
    np.testing.assert_allclose(scaled.A @ (x / s), (plant.A @ x) / s)
    np.testing.assert_allclose(scaled.C @ (x / s), (plant.C @ x) / plant.outputs.scales)
    np.testing.assert_allclose(scaled.B, plant.B * plant.inputs.scales / s[:, None])
    np.testing.assert_allclose(scaled.G, plant.G * plant.disturbances.scales / s[:, None])
    assert plant.has_scales
    assert not scaled.has_scales


def test_transition():
    plant = Plant(A, C)
    assert plant.transition(0.5).shape == (2, 2)
    t = np.array([0.0, 1.0, 2.0])
    expected = np.array([[[np.cos(s), np.sin(s)], [-np.sin(s), np.cos(s)]] for s in t])
    np.testing.assert_allclose(plant.transition(t), expected, atol=1e-15)
    assert Plant(np.zeros((0, 0)), np.zeros((1, 0))).transition(t).shape == (3, 0, 0)


def test_control_round_trip_keeps_matrices_and_names():
    plant = library.cart_pendulum()
    back = Plant.from_control(plant.to_control(), time_unit="s")
    for key in "ABCD":
        np.testing.assert_array_equal(getattr(back, key), getattr(plant, key))
    assert back.states.names == plant.states.names
    assert back.outputs.names == plant.outputs.names
    assert back.inputs.names == plant.inputs.names
    assert back.name == "cart_pendulum"


def test_control_details_win_over_labels():
    system = control.ss(A, [[0.0], [1.0]], C, [[0.0]])
    plant = Plant.from_control(system, time_unit="h", states=["p", "q"], name="mine")
    assert plant.states.names == ("p", "q")
    assert (plant.name, plant.time_unit) == ("mine", "h")


def test_scipy_system_is_accepted():
    system = scipy.signal.StateSpace(A, [[0.0], [1.0]], C, [[2.0]])
    plant = Plant.from_scipy(system, time_unit="min")
    np.testing.assert_array_equal(plant.D, [[2.0]])
    assert plant.time_unit == "min"


def test_a_system_given_alone_is_a_plant():
    known = control.ss(A, [[0.0], [1.0]], C, [[2.0]], states=["a", "b"], outputs=["level"], name="tank")
    plain = scipy.signal.StateSpace(A, [[0.0], [1.0]], C, [[2.0]])
    for system in (known, plain):
        plant = Plant(system, time_unit="min", G=[[0.0], [1.0]])
        for key in "ABCD":
            np.testing.assert_array_equal(getattr(plant, key), getattr(system, key))
        assert (plant.time_unit, plant.n_disturbances) == ("min", 1)
    named = Plant(known, outputs=["depth"])
    assert (named.name, named.states.names, named.outputs.names) == ("tank", ("a", "b"), ("depth",))


def test_a_matrix_alone_or_beside_a_system_is_refused():
    with pytest.raises(ArgumentError, match="`C` is missing: which states"):
        Plant(A)
    with pytest.raises(ArgumentError, match=r"`C` must come with the system, got one beside it\."):
        Plant(scipy.signal.StateSpace(A, [[0.0], [1.0]], C, [[2.0]]), C)


@pytest.mark.parametrize(
    "system",
    [
        control.ss(A, [[0.0], [1.0]], C, [[0.0]], 0.1),
        control.ss(A, [[0.0], [1.0]], C, [[0.0]], True),
        scipy.signal.StateSpace(A, [[0.0], [1.0]], C, [[0.0]], dt=0.5),
    ],
)
def test_discrete_systems_are_refused(system):
    for make in (Plant.from_control if isinstance(system, control.StateSpace) else Plant.from_scipy, Plant):
        with pytest.raises(ArgumentError, match="`system` must be continuous-time, got a discrete one with dt"):
            make(system)


def test_other_systems_are_refused():
    with pytest.raises(ArgumentError, match="`system` must be a state-space system with A, B, C, D"):
        Plant.from_control(control.tf([1], [1, 1]))


def test_words_and_tables():
    plant = library.tidal_gauge()
    assert plant.explain() == "tidal_gauge with 11 states, 0 inputs, 1 output and 11 disturbances; time in h."
    assert repr(plant).startswith("Plant(name=tidal_gauge")
    assert "<th" in plant._repr_html_()
    assert plant.to_dict()["time_unit"] == "h"
