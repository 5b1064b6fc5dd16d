"""E19 to E21: what the printed definitions say of samples and windows, beside what is right."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.errors import ArgumentError
from sampling_design.observability.windows.sampled import sigma_min
from sampling_design.schedules.sampling_set import SamplingSet


def oscillator(omega):
    return Plant([[0.0, omega], [-omega, 0.0]], [[1.0, 0.0]])


def test_integer_gaps_lose_a_plant_that_real_gaps_observe():
    """E19: with d_i whole, an oscillator of omega = pi is never observed; gaps of one half observe it."""
    plant = oscillator(np.pi)
    rng = np.random.default_rng(0)
    for _ in range(10):
        printed = Schedule(np.cumsum(rng.integers(1, 4, 10)).astype(float))
        assert sigma_min(plant, printed) < 1e-12
    assert sigma_min(plant, PeriodicSchedule([0.5]).between(0.0, 5.0)) > 2.0


def test_a_zero_gap_after_the_first_is_refused_where_a_set_forgets_it():
    """E19: D = {0, 0, 0, ...} satisfies the print (d_i >= 0, max d_i finite), yet its set is {0}."""
    printed = set(np.cumsum([0.0, 0.0, 0.0, 0.0]).tolist())
    assert printed == {0.0}
    with pytest.raises(ArgumentError, match=r"`gaps` must be positive, got gaps\[1\] = 0.0"):
        Schedule.from_gaps([0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"`gaps` must be positive, got gaps\[0\] = 0.0"):
        PeriodicSchedule([0.0, 1.0])
    assert SamplingSet(Schedule.from_gaps([0.0, 1.0])).first == 0.0  # d_1 = 0 is allowed


def test_the_least_singular_value_of_a_wide_matrix_is_zero():
    """E20: numpy's least singular value of one row is 1; the n-th one is 0."""
    row = np.array([[1.0, 0.0]])
    assert np.min(np.linalg.svd(row, compute_uv=False)) == 1.0
    assert sigma_min(oscillator(1.0), [0.0]) == 0.0
    assert sigma_min(oscillator(1.0), [0.0, 0.5 * np.pi]) == pytest.approx(1.0)


def test_windows_at_whole_times_miss_the_dip_between_them():
    """E21: double integrator, h = 1, T = 1: sigma .618 at every whole t, 0 at t = 5.5."""
    plant, schedule, T = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([1.0]), 1.0

    def sigma(t):
        return sigma_min(plant, schedule.window(t, T).times - (t - T))

    printed = [sigma(float(t)) for t in range(2, 9)]
    np.testing.assert_allclose(printed, 0.6180339887, atol=1e-9)
    assert sigma(5.5) == 0.0
    assert min(sigma(t) for t in np.linspace(2.0, 4.0, 41)) == 0.0


def test_the_set_that_leaves_out_its_origin_is_the_limit_after_a_departure():
    """E21: K_1 windows that start at a sample hold three, K_i leaves the origin out and holds two."""
    K = SamplingSet(PeriodicSchedule([1.0]))
    for i in (2, 3, 4):
        assert K.starting_at(i).count(0.0, 2.0) == 2
    assert K.schedule.count(1.0, 3.0) == 3
    assert K.schedule.count(1.0 + 1e-9, 3.0 + 1e-9) == 2
