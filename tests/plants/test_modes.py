"""The modal split: what is retained, the bases, the two plants, and the doubts."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from sampling_design import ArgumentError, Plant
from sampling_design.errors import MathematicsError
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.plants import library, modes
from sampling_design.plants.modes import split_modes
from sampling_design.plants.plant import Signals


def hidden(A, seed=0, outputs=2):
    n = len(A)
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return Plant(Q @ A @ Q.T, rng.standard_normal((outputs, n)), B=rng.standard_normal((n, 1)))


def retained_values(plant, **options):
    return np.sort(np.linalg.eigvals(split_modes(plant, **options).retained.A).real)


def test_decay_rate_is_the_rate_of_the_squared_error():
    plant = hidden(np.diag([-1.0, -2.0, -3.0]))
    assert split_modes(plant).retained.n_states == 0
    np.testing.assert_allclose(retained_values(plant, decay_rate=2.1), [-1.0])
    np.testing.assert_allclose(retained_values(plant, decay_rate=4.1), [-2.0, -1.0])
    assert split_modes(plant, decay_rate=6.1).retained is plant


@pytest.mark.parametrize(("shift", "retained"), [(0.5, 2), (2.0, 1)])
def test_offset_is_tight(shift, retained):
    """An eigenvalue half an offset left of the line is retained, two offsets left of it is not."""
    offset = 1e-6
    split = split_modes(Plant(np.diag([1.0, -shift * offset]), np.ones((1, 2))), offset=offset)
    assert split.retained.n_states == retained
    assert split.offset == offset


def test_default_offset_is_a_fraction_of_the_balanced_norm():
    assert split_modes(Plant(np.diag([-3.0, 4.0]), np.ones((1, 2)))).offset == pytest.approx(5e-8)
    d = np.array([1.0, 2.0**30])
    A = np.array([[0.0, 1.0], [-1.0, 0.0]]) * d / d[:, None]
    assert split_modes(Plant(A, np.ones((1, 2)))).offset == pytest.approx(np.sqrt(2) * 1e-8)


def test_nearest_eigenvalue_on_the_line_is_named():
    split = split_modes(hidden(np.diag([0.0, -1.0, -2.0])), decay_rate=2.0)
    np.testing.assert_allclose(split.near_line, [-1.0], atol=1e-13)
    assert split_modes(hidden(np.diag([0.0, -1.0, -2.0])), decay_rate=3.0).near_line.size == 0


def test_an_ill_conditioned_eigenvalue_near_the_axis_is_reported_as_uncertain():
    """Beside the axis by 1e-4 only, with a condition of 1e12: rounding alone could move it across."""
    A = np.array([[-1e-4, 1e6], [0.0, -1.0]])
    T = np.array([[1.0, 0.0], [1e6, 1.0]])
    A = T @ A @ np.array([[1.0, 0.0], [-1e6, 1.0]])
    split = split_modes(Plant(A, np.ones((1, 2))))
    assert split.near_line.size >= 1


def test_coordinates_of_the_parts_carry_scales_names_and_units():
    plant = Plant(
        np.diag([1.0, -1.0]),
        [[1.0, 1.0]],
        B=[[1.0], [2.0]],
        D=[[3.0]],
        time_unit="h",
        name="p",
        states=Signals(("a", "b"), ("m", "kg"), [10.0, 5.0]),
        outputs=Signals(("level",), ("m",), [2.0]),
        inputs=["pump"],
        source="here",
    )
    split = split_modes(plant)
    for part in (split.retained, split.residual):
        assert part.time_unit == "h"
        assert part.source == "here"
        assert part.outputs is plant.outputs
        assert part.inputs is plant.inputs
        assert part.disturbances is plant.disturbances
    assert split.retained.states.scales == pytest.approx([1.0])
    assert split.residual.states.scales == pytest.approx([1.0])
    np.testing.assert_array_equal(split.retained.D, [[3.0]])
    np.testing.assert_array_equal(split.residual.D, [[0.0]])


def test_all_retained_keeps_the_plant_and_an_empty_residual():
    plant = library.satellite()
    split = split_modes(plant)
    assert split.retained is plant
    assert split.residual.n_states == 0
    assert split.residual.C.shape == (3, 0)
    assert split.residual.B.shape == (0, 3)
    assert split.residual.transition([1.0, 2.0]).shape == (2, 0, 0)
    np.testing.assert_array_equal(split.basis_retained, np.eye(6))
    assert split.left_residual.shape == (0, 6)
    assert split.separation == np.inf
    assert split.condition == 1.0


def test_nothing_retained_says_what_to_ask_instead():
    plant = library.three_compartment()
    split = split_modes(plant)
    assert split.retained.n_states == 0
    np.testing.assert_array_equal(split.residual.A, plant.A)
    assert split.residual.states is plant.states
    assert "no samples are needed" in split.explain()
    assert "decay_rate" in split.explain()
    assert split_modes(plant, decay_rate=0.07).retained.n_states == 2


def test_a_plant_without_states_splits_into_nothing():
    plant = Plant(np.zeros((0, 0)), np.zeros((1, 0)))
    split = split_modes(plant)
    assert split.retained is plant
    assert split.residual.n_states == 0
    assert split_modes(split.residual).retained.n_states == 0


def test_separation_falls_with_the_distance_of_the_parts():
    near, far = (split_modes(hidden(np.diag([0.0, -gap]))).separation for gap in (1e-3, 1.0))
    assert near == pytest.approx(1e-3, rel=1e-6)
    assert far == pytest.approx(1.0, rel=1e-6)


def test_condition_grows_with_the_angle_between_the_parts():
    flat = hidden([[0.0, 10.0], [0.0, -1.0]])  # eigenvectors (1, 0) and (10, -1), turned
    assert split_modes(flat).condition > 2.0
    assert split_modes(Plant(np.diag([0.0, -1.0]), np.ones((1, 2)))).condition == pytest.approx(1.0)


def test_a_cluster_with_members_on_both_sides_is_retained_whole_and_reported():
    jordan = -1e-7 * np.eye(3) + np.eye(3, k=1)
    split = split_modes(hidden(block_diag(jordan, -1.0)))
    assert split.retained.n_states == 3
    assert split.near_line.size == 3


def test_table_and_words_name_the_eigenvalues():
    split = split_modes(library.cart_pendulum())
    assert "5.56796, 0" in str(split)
    assert "1 eigenvalue lies at that rate within rounding" in split.explain()
    assert repr(split).startswith("ModalSplit(retained=2 of 4 states, line=Re >= 0 1/s")
    assert "(x2, index 2)" in str(split_modes(library.double_integrator()))


def test_bad_arguments_are_refused():
    plant = library.oscillator()
    with pytest.raises(ArgumentError, match=r"`decay_rate` must not be negative, got -1\.0"):
        split_modes(plant, -1.0)
    with pytest.raises(ArgumentError, match="`offset` must not be negative"):
        split_modes(plant, offset=-1e-9)
    with pytest.raises(ArgumentError, match="`rounding` must be positive"):
        split_modes(plant, rounding=0.0)
    with pytest.raises(ArgumentError, match="`cluster_cap` must be positive"):
        split_modes(plant, cluster_cap=0.0)


def test_a_failed_reordering_is_an_error_and_no_fallback(monkeypatch):
    reorder = modes.lapack.dtrsen

    class Refusing:
        dtrsyl = staticmethod(modes.lapack.dtrsyl)

        @staticmethod
        def dtrsen(*args, **kwargs):
            return (*reorder(*args, **kwargs)[:-1], 1)

    monkeypatch.setattr(modes, "lapack", Refusing)
    with pytest.raises(MathematicsError, match="too close to be separated"):
        split_modes(hidden(np.diag([1.0, -1.0])))


@pytest.mark.parametrize("size", [1e200, 1e308, 1e-200, 1e-310])
def test_rates_beyond_all_measure_are_refused_in_one_sentence(size):
    with pytest.raises(ArgumentError, match=r"must have rates between 1e-120 and 1e\+120 per unit of time, got"):
        split_modes(Plant(size * np.array([[0.0, 1.0], [-1.0, 0.5]]), np.ones((1, 2))))


def test_a_coupling_of_any_size_between_moderate_rates_is_no_obstacle():
    plant = Plant([[-1.0, 1e200, 0.0], [0.0, 0.5, 1e-200], [0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]])
    assert split_modes(plant).retained.n_states == 2
    assert len(unobservable_modes(plant)) == 0


def test_a_stiff_mode_hides_no_slow_one():
    assert len(unobservable_modes(Plant(np.diag([0.1, 0.2, -1e9]), np.ones((1, 3))))) == 0
    for coupling in (0.0, 1e-16, 1e-9):
        assert len(unobservable_modes(Plant([[0.1, 1.0], [0.0, coupling]], [[1.0, 1.0]]))) == 0


@pytest.mark.parametrize(
    ("offset", "words"),
    [
        (None, "1 eigenvalue lies at that rate within rounding: retained, which is the safe side."),
        (0.0, "1 eigenvalue lies at that rate within rounding: not all of them retained."),
    ],
)
def test_what_lies_at_the_line_is_said_in_words(offset, words):
    plant = Plant(np.diag([0.0 if offset is None else -1e-17, 1.0, -1.0]), np.ones((1, 3)))
    found = split_modes(plant, offset=offset, rounding=1e-13)
    assert found.near_line.size == 1
    assert found.explain().endswith(words)
