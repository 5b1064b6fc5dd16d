"""The sample-based observability matrix, its n-th singular value and its Gramian."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.errors import ArgumentError
from sampling_design.observability.windows.sampled import observability_gramian, observability_matrix, sigma_min
from tests.oracles.observability import rows_of

RNG = np.random.default_rng(2)
PLANT = Plant(RNG.standard_normal((4, 4)), RNG.standard_normal((2, 4)))
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_rows_one_by_one():
    times = np.array([0.0, 0.3, 1.7, 2.0])
    np.testing.assert_allclose(observability_matrix(PLANT, times), rows_of(PLANT.A, PLANT.C, times), rtol=1e-12)


def test_unmeasured_rows_are_left_out():
    times, mask = [0.0, 0.5, 2.0], [[1, 0], [1, 1], [0, 1]]
    expected = rows_of(PLANT.A, PLANT.C, times, mask)
    assert expected.shape == (4, 4)
    np.testing.assert_allclose(observability_matrix(PLANT, times, mask), expected, rtol=1e-12)
    np.testing.assert_allclose(observability_matrix(PLANT, Schedule(times, mask)), expected, rtol=1e-12)
    np.testing.assert_allclose(observability_matrix(PLANT, Schedule(times), mask), expected, rtol=1e-12)


def test_negative_and_unordered_times_are_relative_ones():
    rows = observability_matrix(PLANT, [-1.0, 0.5, -0.2])
    np.testing.assert_allclose(rows, rows_of(PLANT.A, PLANT.C, [-1.0, 0.5, -0.2]), rtol=1e-11)


def test_gramian_and_sigma_belong_together():
    times = np.linspace(0, 3, 7)
    W = observability_gramian(PLANT, times)
    assert np.array_equal(W, W.T)
    assert sigma_min(PLANT, times) ** 2 == pytest.approx(np.linalg.eigvalsh(W)[0], rel=1e-8)


def test_one_row_in_two_dimensions_sees_nothing():
    # the least singular value of the wide matrix is 1; the n-th is 0
    assert np.linalg.svd(observability_matrix(OSCILLATOR, [0.0]), compute_uv=False).min() == 1.0
    assert sigma_min(OSCILLATOR, [0.0]) == 0.0


def test_half_a_turn_apart_sees_nothing():
    assert sigma_min(OSCILLATOR, [0.0, np.pi, 2 * np.pi]) < 1e-15
    assert sigma_min(OSCILLATOR, [0.0, np.pi / 2]) == pytest.approx(1.0, rel=1e-15)


def test_integer_times_never_see_an_oscillator_of_half_the_rate():
    plant = Plant([[0.0, np.pi], [-np.pi, 0.0]], [[1.0, 0.0]])
    assert sigma_min(plant, np.arange(9.0)) < 1e-13
    assert sigma_min(plant, np.arange(0, 4.6, 0.5)) == pytest.approx(np.sqrt(5), rel=1e-12)


def test_no_states_and_no_samples():
    empty = Plant(np.zeros((0, 0)), np.zeros((1, 0)))
    assert observability_matrix(empty, [0.0, 1.0]).shape == (2, 0)
    assert sigma_min(empty, [0.0]) == np.inf
    assert observability_matrix(PLANT, []).shape == (0, 4)
    assert sigma_min(PLANT, Schedule([])) == 0.0
    np.testing.assert_array_equal(observability_gramian(PLANT, []), np.zeros((4, 4)))


def test_endless_schedule_is_refused():
    with pytest.raises(ArgumentError, match=r"finitely many, got a PeriodicSchedule. Use schedule.between"):
        observability_matrix(OSCILLATOR, PeriodicSchedule([1.0]))


def test_two_masks_are_refused():
    with pytest.raises(ArgumentError, match="`outputs` must be left out"):
        sigma_min(OSCILLATOR, Schedule([0.0, 1.0], [[1], [1]]), [[1], [1]])


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        ([[1, 0]], "one row per sample"),
        ([[1], [1]], "one column per output"),
        ([[0, 0], [1, 1]], "at least one output"),
    ],
)
def test_masks_of_another_shape_are_refused(mask, message):
    with pytest.raises(ArgumentError, match=message):
        observability_matrix(PLANT, [0.0, 1.0], mask)


def test_times_that_are_no_numbers_are_refused():
    with pytest.raises(ArgumentError, match=r"`times` must be finite, got times\[1\]"):
        sigma_min(PLANT, [0.0, np.nan])


def test_overflow_is_named():
    with pytest.raises(ArgumentError, match="where unstable modes overflow"):
        observability_matrix(Plant([[1.0]], [[1.0]]), [1.0, 800.0])


@pytest.mark.parametrize("outputs", [1, 2])
def test_a_plant_without_states_has_rows_without_columns(outputs):
    plant = Plant(np.zeros((0, 0)), np.zeros((outputs, 0)))
    assert observability_matrix(plant, [0.0, 1.0, 3.0]).shape == (3 * outputs, 0)
    assert observability_matrix(plant, []).shape == (0, 0)
    assert observability_matrix(plant, Schedule([0.5, 1.0])).shape == (2 * outputs, 0)
    assert observability_matrix(plant, [0.0], [[True] * outputs]).shape == (outputs, 0)
    assert sigma_min(plant, [0.0]) == np.inf
    assert observability_gramian(plant, [0.0]).shape == (0, 0)
