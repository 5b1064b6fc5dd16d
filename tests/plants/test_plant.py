"""Plant and Signals: what they accept, keep, refuse, and convert."""

import sys
from types import SimpleNamespace

import control
import numpy as np
import pytest
import scipy.signal

from sampling_design import ArgumentError, PeriodicSchedule, Plant, window_sigma
from sampling_design.errors import MissingExtraError
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.plants import library
from sampling_design.plants.plant import Signals

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
        ({"C": [[1.0], [0.0]]}, r"`C` must have shape \(1, 2\), got \(2, 1\)\. Did you pass the transpose"),
        ({"B": [[1.0, 0.0]]}, r"`B` must have shape \(2, 1\), got \(1, 2\)\. Did you pass the transpose"),
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


@pytest.mark.parametrize("name", ["satellite", "cart_pendulum", "tidal_gauge", "oscillator"])
@pytest.mark.parametrize("disturbances", [None, True])
def test_control_round_trip_keeps_everything(name, disturbances):
    plant = getattr(library, name)()
    system = plant.to_control(disturbances)
    for back in (Plant.from_control(system), Plant(system)):
        assert back.to_dict() == plant.to_dict()
        assert back.same_dynamics(plant)
    assert Plant(system, time_unit="d", outputs=[f"z{i}" for i in range(plant.n_outputs)]).time_unit == "d"
    driven = plant.n_inputs * bool(plant.n_inputs) + plant.n_disturbances * (not plant.n_inputs or bool(disturbances))
    assert system.ninputs == driven


def test_a_system_that_is_no_longer_the_plant_brings_nothing_of_it():
    plant = library.satellite()
    system = plant.to_control()
    system.A[0, 0] += 1.0
    back = Plant(system)
    assert (back.time_unit, back.n_disturbances, back.source) == ("s", plant.n_states, "")
    assert back.A[0, 0] == plant.A[0, 0] + 1


def test_the_unit_of_time_comes_back_through_a_verb():
    plant = library.tidal_gauge()  # in hours
    found = unobservable_modes(plant.to_control())
    assert found.names == plant.states.names
    assert window_sigma(plant.to_control(), PeriodicSchedule([2.0], time_unit="h"), 40.0, rtol=0.5).lower > 0


def test_names_that_are_inputs_and_disturbances_are_told_apart():
    plant = Plant(A, C, B=[[0.0], [1.0]], inputs=["push"], G=[[0.0], [1.0]], disturbances=["push"])
    assert plant.to_control(disturbances=True).input_labels == ["push", "push (disturbance)"]


def test_what_nothing_drives_is_no_system_of_control():
    with pytest.raises(ArgumentError, match="`control` has no system without inputs: this plant has neither B nor G"):
        Plant(A, C, G=np.zeros((2, 0))).to_control()


def transfer(system):
    """A transfer matrix at one point of the plane."""
    made = Plant(system)
    resolvent = np.linalg.solve(POINT * np.eye(made.n_states) - made.A, made.B)
    return made.C @ resolvent + made.D


POINT = 0.3 + 0.7j
SHARED = control.tf([[[1.0], [2.0]], [[1.0, 0.0], [3.0]]], [[[1, 1], [1, 2]], [[1, 1], [1.0, 0]]])


@pytest.mark.parametrize(
    ("system", "states"),
    [
        (control.tf([1.0, 3.0], [1.0, 3.0, 2.0]), 2),
        (control.tf([1.0, 2.0], [1.0, 3.0, 2.0]), 1),  # -2 cancels
        (control.tf([1e-9, 2e-15], [1.0, 3e-6, 2e-12]), 1),  # in microseconds as well
        (control.tf([2.0, 1.0], [4.0, 4.0]), 1),  # with what is passed on at once
        (control.tf([5.0], [2.0]), 0),
        (control.tf([0.0], [1.0, 1.0]), 0),
        (control.tf([1.0], [1.0, 0.0, 0.0, 0.0]), 3),
        (SHARED, 4),
        (control.tf([[[1.0], [2.0]]], [[[1.0, 1.0], [1.0, 1.0]]]), 1),  # one pole for both inputs
    ],
)
def test_a_transfer_function_is_taken_in_observer_form(system, states):
    made = Plant(system)
    assert made.n_states == states
    np.testing.assert_allclose(transfer(system), np.reshape(system(POINT), made.D.shape), rtol=1e-9)
    assert len(unobservable_modes(made)) == 0
    if states:
        assert made.source == "transfer function, in observer form"
        assert made.states.names[0] == f"{made.outputs.names[0]}_1"


def test_coefficients_of_one_transfer_function_are_taken_to_the_last_bit():
    made = Plant(control.tf([2.0, 1.0], [1.0, 0.0, 1.0]))
    assert made.A.tolist() == [[0.0, 1.0], [-1.0, 0.0]]
    assert made.B.tolist() == [[2.0], [1.0]]


def test_forms_of_scipy_are_taken():
    zeros = scipy.signal.ZerosPolesGain([-3.0], [-1.0, -2.0], 2.0)
    ratio = scipy.signal.TransferFunction([2.0, 6.0], [1.0, 3.0, 2.0])
    np.testing.assert_allclose(Plant(zeros).A, Plant(ratio).A)
    np.testing.assert_allclose(transfer(ratio), [[2 * (POINT + 3) / ((POINT + 1) * (POINT + 2))]])


def test_what_is_no_linear_system_says_what_to_do():
    with pytest.raises(ArgumentError, match="`system` must have no more zeros than poles, got degree 2 over 1"):
        Plant(control.tf([1.0, 0.0, 0.0], [1.0, 1.0]))
    answers = control.frd([1.0, 2.0], [1.0, 2.0])
    moving = control.nlsys(lambda t, x, u, p: -x, lambda t, x, u, p: x, inputs=1, outputs=1, states=1)
    for system in (answers, moving):
        with pytest.raises(
            ArgumentError, match=r"must be a state-space system or a transfer function, got .*linearise"
        ):
            Plant(system)
    with pytest.raises(ArgumentError, match="`system` must be a linear system of control or"):
        Plant.from_scipy(3)
    late = SimpleNamespace(A=A, B=[[0.0], [1.0]], C=C, D=[[0.0]], delay=[0.5])
    with pytest.raises(ArgumentError, match="must have no delay, got one with `delay`: add states for it"):
        Plant(late)


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
    ("system", "words"),
    [
        (control.ss(A, [[0.0], [1.0]], C, [[0.0]], True), "must say how long its sampling interval is"),
        (control.ss([[-0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1), r"with the pole -0\.5: a sign that changes"),
        (control.tf([1.0], [1.0, 0.0, 0.0], 0.1), "with the pole 0: what is forgotten within one sample"),
        (
            scipy.signal.StateSpace(np.eye(2, k=1) + 0.5 * np.eye(2) * [1, -1], [[0.0], [1.0]], C, [[0.0]], dt=0.5),
            "real",
        ),
        *[
            (control.ss(near @ np.diag([0.9, 0.2]) @ np.linalg.inv(near), [[0.0], [1.0]], C, [[0.0]], 1e-3), "doubles")
            for near in (np.array([[1.0, 1.0], [1.0, 1.0 + apart]]) for apart in (1e-6, 1e-9))
        ],
    ],
)
def test_discrete_systems_that_no_plant_has_as_its_samples_are_refused(system, words):
    for make in (Plant.from_control if isinstance(system, control.InputOutputSystem) else Plant.from_scipy, Plant):
        with pytest.raises(ArgumentError, match=words):
            make(system)


@pytest.mark.parametrize("dt", [0.1, 1e-9, 1e9])
def test_a_discrete_system_is_the_plant_that_has_its_samples(dt):
    """Held inputs, an integrator, a defective pole, a growing one, and states in units far apart."""
    for slow in (
        [[0.0, 1.0], [-1.0, -0.1]],
        [[0.0, 1.0], [0.0, 0.0]],
        [[-0.5, 1.0], [0.0, -0.5]],
        [[0.3, 0.2], [0, -1]],
    ):
        units = np.diag([1.0, 1e6])
        plant = control.ss(units @ np.array(slow) @ np.linalg.inv(units) / dt, units @ [[1.0], [0.5]] / dt, C, [[2.0]])
        found = Plant(control.c2d(plant, dt))
        for mine, theirs in ((found.A, plant.A), (found.B, plant.B)):
            np.testing.assert_allclose(mine * dt, theirs * dt, rtol=1e-7, atol=1e-7 * np.abs(theirs * dt).max())
        np.testing.assert_array_equal(found.C, plant.C)
        assert found.D.tolist() == [[2.0]]
        assert "the plant that oscillates slowest" in found.source


def test_words_and_tables():
    plant = library.tidal_gauge()
    assert plant.explain() == "tidal_gauge with 11 states, 0 inputs, 1 output and 11 disturbances; time in h."
    assert repr(plant).startswith("Plant(name=tidal_gauge")
    assert "<th" in plant._repr_html_()
    assert plant.to_dict()["time_unit"] == "h"


class TestAugmented:
    LEVEL = Plant(
        [[0.0, 1.0], [-1.0, 0.0]],
        [[1.0, 0.0]],
        B=[[0.0], [1.0]],
        G=[[0.0], [2.0]],
        outputs=Signals(["level"], ["m"]),
        disturbances=Signals(["inflow"], ["m/s"]),
        inputs=["gate"],
    )

    def test_constants_enter_where_they_belong(self):
        found = self.LEVEL.augmented(
            bias={"level": 0.1}, disturbance=["inflow"], parameter={"leak": [-1.0, 0.0]}, drift={"level_bias": 1e-3}
        )
        assert found.states.names == ("x1", "x2", "level_bias", "inflow_mean", "leak")
        assert found.states.units == ("", "", "m", "m/s", "")
        assert found.states.scales.tolist() == [1, 1, 0.1, 1, 1]
        np.testing.assert_array_equal(found.A[:2], [[0, 1, 0, 0, -1], [-1, 0, 0, 2, 0]])
        np.testing.assert_array_equal(found.A[2:], np.zeros((3, 5)))
        np.testing.assert_array_equal(found.C, [[1, 0, 1, 0, 0]])
        np.testing.assert_array_equal(found.B, [[0], [1], [0], [0], [0]])
        np.testing.assert_array_equal(found.G, [[0, 0], [2, 0], [0, 1], [0, 0], [0, 0]])
        assert (found.disturbances.names, found.disturbances.scales.tolist()) == (
            ("inflow", "level_bias_drift"),
            [1, 1e-3],
        )

    def test_a_constant_acts_as_what_it_stands_for(self):
        found = self.LEVEL.augmented(bias=["level"], disturbance=["inflow"])
        x = found.transition(2.0) @ [0.3, 0.0, 0.5, 0.2]
        alone = self.LEVEL.transition(2.0) @ [0.3, 0.0] + 0.2 * 2.0 * np.array([1 - np.cos(2.0), np.sin(2.0)])
        np.testing.assert_allclose(x, [*alone, 0.5, 0.2], atol=1e-12)
        np.testing.assert_allclose(found.C @ x, [alone[0] + 0.5])

    def test_what_is_not_there_cannot_be_unknown(self):
        with pytest.raises(ArgumentError, match="`augmented` needs a constant to add"):
            self.LEVEL.augmented()
        with pytest.raises(ArgumentError, match="levl"):
            self.LEVEL.augmented(bias=["levl"])
        with pytest.raises(ArgumentError, match="level_bia"):
            self.LEVEL.augmented(bias=["level"], drift={"level_bia": 1.0})
        with pytest.raises(ArgumentError, match=r"`parameter\.leak`"):
            self.LEVEL.augmented(parameter={"leak": [1.0]})


def test_a_system_of_control_is_given_where_control_is_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(MissingExtraError, match="python-control"):
        library.oscillator().to_control(disturbances=True)


def test_names_that_control_makes_are_none():
    made = Plant(control.tf([1, 2], [1, 3, 2.5]), time_unit="h")
    assert (made.name, made.outputs.names, made.states.names) == ("", ("y1",), ("y1_1", "y1_2"))
    named = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], states=["level"], name="tank")
    assert (Plant(named).name, Plant(named).states.names, Plant(named).outputs.names) == ("tank", ("level",), ("y1",))
