"""The named plants: their eigenvalues, their sources, and their files."""

import tomllib
from pathlib import Path

import control
import numpy as np
import pytest

from sampling_design import ArgumentError, PeriodicSchedule, Plant, named_plant, read_plant
from sampling_design.errors import CallError, FileFormatError
from sampling_design.plants import library
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.files import write_plant
from sampling_design.plants.modes import split_modes

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = list(library.PLANTS)


def indices(plant):
    return sorted((round(c.value.imag, 12), c.multiplicity, c.index) for c in eigenvalue_clusters(plant.A))


@pytest.mark.parametrize("name", NAMES)
def test_file_and_library_are_the_same_bits(name, tmp_path):
    plant = named_plant(name)
    assert plant.name == name
    path = EXAMPLES / "plants" / f"{name}.toml"
    assert read_plant(path).to_dict() == plant.to_dict()
    assert write_plant(plant, tmp_path / "again.toml").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_every_plant_has_a_source_and_is_observable(name):
    plant = named_plant(name).scaled()
    assert named_plant(name).source
    rows = [plant.C]
    scale = max(float(np.linalg.norm(plant.A)), 1e-9)
    for _ in range(plant.n_states - 1):
        rows.append(rows[-1] @ plant.A / scale)
    assert np.linalg.matrix_rank(np.vstack(rows), tol=1e-13) == plant.n_states


@pytest.mark.parametrize("name", NAMES)
def test_every_plant_has_a_requirement_that_fits_it(name):
    with (EXAMPLES / "requirements" / f"{name}.toml").open("rb") as stream:
        need = tomllib.load(stream)
    known = {"format", "window", "period", "spacing", "samples", "decay_rate", "forbidden", "fixed", "outputs"}
    known |= {"timing_tolerance"}
    assert need["format"] == "sampling-design/requirement/1"
    assert set(need) <= known
    count = need["samples"]["exactly"]
    blocked = sum(b - a for a, b in need.get("forbidden", []))
    assert need["spacing"] * count <= need["period"] - blocked
    assert need["window"] >= need["spacing"]
    retained = split_modes(named_plant(name), need.get("decay_rate", 0.0)).retained
    assert 0 < retained.n_states <= count * retained.n_outputs


def test_integrators():
    assert indices(library.double_integrator()) == [(0.0, 2, 2)]
    assert indices(library.triple_integrator()) == [(0.0, 3, 3)]


def test_oscillator():
    assert indices(library.oscillator(2.0)) == [(-2.0, 1, 1), (2.0, 1, 1)]
    with pytest.raises(ArgumentError, match="`omega` must be positive"):
        library.oscillator(0.0)


def test_satellite_has_a_drift_and_two_equal_oscillations():
    plant = library.satellite()
    n = 2 * np.pi / 5554
    assert indices(plant) == [(round(-n, 12), 2, 1), (0.0, 2, 2), (round(n, 12), 2, 1)]
    with pytest.raises(ArgumentError, match="`period` must be positive"):
        library.satellite(-1.0)


def test_satellite_moves_on_the_closed_ellipse_when_the_drift_is_cancelled():
    """y'(0) = -2 n x(0) is the drift-free start: after one orbit the satellite is back, in between 2 : 1."""
    plant, n = library.satellite(), 2 * np.pi / 5554
    start = np.array([100.0, 0.0, 0.0, 0.0, -2 * n * 100.0, 0.0])
    there = plant.transition(np.array([5554 / 4, 5554 / 2, 5554.0])) @ start
    np.testing.assert_allclose(there[2], start, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(there[1][:2], [-100.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(there[0][:2], [0.0, -200.0], atol=1e-9)


def test_tides_have_their_periods():
    plant = library.tidal_gauge()
    frequencies = sorted(c.value.imag for c in eigenvalue_clusters(plant.A) if c.value.imag > 0)
    hours = [2 * np.pi / w for w in frequencies]
    np.testing.assert_allclose(hours, [25.8193, 23.9345, 12.6583, 12.4206, 12.0], atol=1e-4)
    assert all(c.index == 1 for c in eigenvalue_clusters(plant.A))
    assert plant.n_states == 11


def test_tide_requirement_reaches_over_the_slowest_beat_and_leaves_daylight():
    with (EXAMPLES / "requirements" / "tidal_gauge.toml").open("rb") as stream:
        need = tomllib.load(stream)
    beat = 360.0 / (library.TIDES["M2"][0] - library.TIDES["N2"][0])
    assert need["window"] > beat
    free = np.array([t for t in np.arange(0.5, 720.0) if not any(a <= t < b for a, b in need["forbidden"])])
    assert free.size == 30 * 12
    assert set(np.floor(free % 24)) == set(range(7, 19))


def test_cart_pendulum_obeys_its_equations_of_motion():
    plant = library.cart_pendulum()
    M, m, b, l, I, g = 0.5, 0.2, 0.1, 0.3, 0.006, 9.81
    rng = np.random.default_rng(0)
    x, u, w = rng.standard_normal(4), rng.standard_normal(1), rng.standard_normal(2)
    dx = plant.A @ x + plant.B @ u + plant.G @ w
    np.testing.assert_allclose((M + m) * dx[1] + b * x[1] - m * l * dx[3], u[0] + w[0], rtol=1e-12)
    np.testing.assert_allclose((I + m * l**2) * dx[3] - m * g * l * x[2] - m * l * dx[1], w[1], rtol=1e-12)
    assert split_modes(plant).retained.n_states == 2


def test_three_compartments_conserve_what_is_not_eliminated():
    plant = library.three_compartment()
    rng = np.random.default_rng(0)
    a = rng.random(3)
    np.testing.assert_allclose(np.sum(plant.A @ a), -0.119 * a[0])
    assert np.all(np.linalg.eigvals(plant.A).real < 0)
    assert np.all(np.linalg.eigvals(plant.A).imag == 0)
    np.testing.assert_allclose(library.three_compartment(35.0).C, 2 * plant.C)
    with pytest.raises(ArgumentError, match="`weight` must be positive"):
        library.three_compartment(0.0)


def test_helicopter_has_one_unstable_pair():
    split = split_modes(library.helicopter_he1())
    np.testing.assert_allclose(split.retained_clusters[0].value, 0.27579 + 0.257584j, atol=1e-5)
    assert split.retained.n_states == 2


def test_an_unknown_name_offers_the_nearest():
    with pytest.raises(
        ArgumentError, match=r"`name` must be a plant of the library, got 'satelite'\. Did you mean 'sat"
    ):
        named_plant("satelite")


def test_motions_are_summed_and_each_sensor_shows_the_sum():
    plant = library.plant_of_modes([24.0], [2.0], sensors=["blood", "saliva"], time_unit="h")
    assert plant.states.names == ("level", "oscillation_1", "oscillation_1_quadrature", "decaying_1")
    np.testing.assert_allclose(plant.C, [[1.0, 1.0, 0.0, 1.0]] * 2)
    np.testing.assert_allclose(np.diag(plant.transition(24.0)), [1.0, 1.0, 1.0, 3.0**-12], atol=1e-12)
    with pytest.raises(ArgumentError, match="`oscillations` or `decays` must name a time, or nothing moves"):
        library.plant_of_modes()


def test_a_name_of_the_library_in_place_of_a_file_leads_to_its_plant():
    with pytest.raises(FileFormatError, match=r"oscillator: no such file. Did you mean named_plant\('oscillator'\)\?$"):
        read_plant("oscillator")


@pytest.mark.parametrize("word", ["dt", "Ts", "sample_time"])
def test_a_plant_in_discrete_time_is_told_how_to_come(word):
    with pytest.raises(CallError, match=r"one in discrete time is given as Plant\(control.ss\(A, B, C, D, dt\)\)"):
        Plant([[-1.0]], [[1.0]], **{word: 0.1})
    taken = Plant(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1), time_unit="s")
    assert taken.transition(0.1)[0, 0] == pytest.approx(0.5)


def test_one_number_in_place_of_a_list_is_told_its_brackets():
    with pytest.raises(ArgumentError, match=r"`gaps` must have 1 dimension, got shape \(\). One number is \[...\]"):
        PeriodicSchedule(1.0)
