"""Units change nothing in windows: with scales that move along, neither sigma nor its worst window, decision or proof;
and without them, one unit for all states and one for all outputs scale sigma by their ratio."""

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import PeriodicSchedule, Plant, Schedule, SpacedWindows, window_sigma, worst_case_sigma
from sampling_design.observability.count.zero_count import default_window
from sampling_design.observability.windows.sampled import observability_gramian, observability_matrix, sigma_min
from sampling_design.plants.modes import split_modes
from tests.rescale import Units

EXACT = 1e-6
SEEDS = range(8)
SPECTRA = (
    [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.2]],
    [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]],
    [[-3.0, 0.0, 0.0], [0.0, 0.3, 1.0], [0.0, -1.0, 0.3]],
    [[0.0, 2.0, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.0, -6.0]],
)


def case(seed):
    """A plant of a known spectrum in random coordinates, a schedule with masks, a window of some five samples."""
    rng = np.random.default_rng([12, seed])
    S = np.linalg.qr(rng.standard_normal((3, 3)))[0] + 0.2 * rng.standard_normal((3, 3))
    A = np.linalg.solve(S, np.array(SPECTRA[seed % len(SPECTRA)]) @ S)
    plant = Plant(A, rng.standard_normal((2, 3)))
    mask = rng.random((4, 2)) < 0.8
    mask[~mask.any(axis=1), 0] = True
    return plant, PeriodicSchedule(rng.uniform(0.3, 1.0, 4), outputs=mask), rng


def moved(seed, plant, **limits):
    """The plant in other units, entry by entry, with its scales."""
    units = Units.drawn(np.random.default_rng([13, seed]), plant, **limits)
    return units, units.plant(plant).scaled(), units.plant(plant)


def same(one, other, factor=1.0):
    """Bounds, decision and worst window of two records."""
    assert (one.status, one.closed) == (other.status, other.closed)
    assert other.lower == pytest.approx(factor * one.lower, rel=EXACT, abs=0)
    assert other.upper == pytest.approx(factor * one.upper, rel=EXACT, abs=0)
    return True


@pytest.mark.parametrize("seed", SEEDS)
def test_sigma_over_sliding_windows(seed):
    plant, schedule, _ = case(seed)
    units, _, other = moved(seed, plant)
    here = window_sigma(plant, schedule, 3.0)
    there = window_sigma(other, units.schedule(schedule), 3.0 * units.time)
    assert same(here, there)
    assert there.witness.t == pytest.approx(units.time * here.witness.t, rel=EXACT)
    assert (there.witness.side, there.witness.samples.size) == (here.witness.side, here.witness.samples.size)
    blind = window_sigma(plant, PeriodicSchedule([3.0]), 2.0), PeriodicSchedule([3.0 * units.time])
    assert window_sigma(other, blind[1], 2.0 * units.time).status == blind[0].status == "too few samples"


@pytest.mark.parametrize("offset", [0.0, 1.7e9])
@pytest.mark.parametrize("seed", SEEDS)
def test_sigma_of_a_finite_schedule(seed, offset):
    plant, schedule, rng = case(seed)
    times = np.cumsum(np.rint(rng.uniform(0.3, 1.0, 9) * 64) / 64)  # exact in doubles beside 1.7e9
    units = Units(np.ones(3), np.ones(2), disturbances=np.ones(3), offset=offset)
    if not offset:
        units = moved(seed, plant)[0]
    mask = np.tile(schedule.outputs, (3, 1))[: times.size]
    here = window_sigma(plant, Schedule(times, mask), 2.5)
    there = window_sigma(units.plant(plant).scaled(), units.schedule(Schedule(times, mask)), 2.5 * units.time)
    assert same(here, there)


@pytest.mark.parametrize("seed", SEEDS)
def test_sigma_and_gramian_of_given_times(seed):
    plant, schedule, _ = case(seed)
    units, scaled, other = moved(seed, plant)
    times = schedule.times
    assert sigma_min(scaled, units.time * times) == pytest.approx(sigma_min(plant, times), rel=EXACT)
    rows = observability_matrix(plant, times).reshape(-1, 2, 3)
    factors = units.outputs[:, None] / units.states
    again = observability_matrix(other, units.time * times).reshape(-1, 2, 3) / factors
    assert np.allclose(again, rows, rtol=0, atol=EXACT * np.abs(rows).max())
    W = observability_gramian(plant, times)
    V = observability_gramian(scaled, units.time * times)
    assert np.allclose(V, W, rtol=0, atol=EXACT * np.abs(W).max())


@pytest.mark.parametrize("seed", SEEDS[:4])
def test_sigma_over_a_family(seed):
    plant, _, _ = case(seed)
    units, _, other = moved(seed, plant)
    here = worst_case_sigma(plant, SpacedWindows(2.0, 2, 0.6), budget=None)
    there = worst_case_sigma(other, SpacedWindows(2.0 * units.time, 2, 0.6 * units.time), budget=None)
    assert same(here, there)


@pytest.mark.parametrize("seed", SEEDS)
def test_one_unit_of_all_states_and_one_of_all_outputs(seed):
    plant, schedule, rng = case(seed)
    x, y, c = 10.0 ** rng.integers(-12, 13, 2), 10.0 ** rng.integers(-12, 13), 10.0 ** rng.integers(-9, 10)
    units = Units(np.full(3, x[0]), np.full(2, y), disturbances=np.ones(3), time=float(c))
    other = units.plant(plant)
    bare = Plant(other.A, other.C)  # without scales
    factor = y / x[0]
    assert same(window_sigma(plant, schedule, 3.0), window_sigma(bare, units.schedule(schedule), 3.0 * c), factor)
    assert sigma_min(bare, c * schedule.times) == pytest.approx(
        factor * sigma_min(plant, schedule.times), rel=EXACT, abs=0
    )
    if seed < 2:
        one = worst_case_sigma(plant, SpacedWindows(2.0, 2, 0.6), budget=None)
        assert same(one, worst_case_sigma(bare, SpacedWindows(2.0 * c, 2, 0.6 * c), budget=None), factor)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_window_that_was_not_given(seed):
    plant, _, _ = case(seed)
    units, _, other = moved(seed, plant)
    here, there = default_window(split_modes(plant)), default_window(split_modes(other))
    if any(c.value.imag for c in split_modes(plant).clusters):  # else it comes of |A|, which units change
        assert there == pytest.approx(units.time * here, rel=EXACT)


@pytest.mark.parametrize("seed", range(6))
def test_sigma_is_proven_where_units_of_states_are_far_apart(seed):
    """1/sigma = |D F_z| with F_z of the plant in plain units: no digit is lost there, however far apart units are."""
    rng = np.random.default_rng(seed)
    n, p, W = int(rng.integers(2, 4)), int(rng.integers(1, 3)), 2.5
    A, C, D = rng.normal(size=(n, n)), rng.normal(size=(p, n)), 10.0 ** rng.permutation([-8.0, 0.0, 7.0])[:n]
    A = (A - A.T, A - np.eye(n) * (np.linalg.eigvals(A).real.max() - 0.1), np.diag(np.ones(n - 1), 1))[seed % 3]
    schedule = PeriodicSchedule(rng.uniform(0.3, 0.9, 2))
    found = window_sigma(Plant(A * D[:, None] / D, C / D), schedule, W)
    times = schedule.between(0.0, 3 * schedule.period + 2 * W).times
    starts = np.concatenate([times[times <= 2 * schedule.period] + 1e-9, rng.uniform(0, schedule.period, 20)])
    least = np.inf
    for start in starts:
        taus = times[(times >= start) & (times <= start + W)] - start
        rows = (C @ expm(A * taus[:, None, None])).reshape(-1, n)
        least = min(least, 1 / np.linalg.norm(D[:, None] * np.linalg.pinv(rows, rcond=1e-15), 2))
    assert 0.99 * found.upper <= found.lower <= least * (1 + 1e-9)
    assert found.upper <= least * 1.02


@pytest.mark.parametrize("seed", range(5))
def test_so_it_is_over_all_schedules(seed):
    rng = np.random.default_rng(seed)
    n, D = 2 + seed % 2, 10.0 ** rng.permutation([-5.0, 0.0, 3.0])
    A, C, D = rng.normal(size=(n, n)), rng.normal(size=(1, n)), D[:n]
    A = (A - A.T, A - np.eye(n) * (np.linalg.eigvals(A).real.max() - 0.1), np.diag(np.ones(n - 1), 1))[seed % 3]
    late = (0.0, 0.02)[seed % 2]
    family = SpacedWindows(window=2.0, count=n + 1, spacing=0.3)
    found = worst_case_sigma(Plant(A * D[:, None] / D, C / D), family, timing_tolerance=late, rtol=0.05)
    assert 0.9 * found.upper <= found.lower
    for _ in range(60):
        taus = np.sort(rng.uniform(0.0, 2.0 - n * 0.3, n + 1)) + 0.3 * np.arange(n + 1)
        rows = (C @ expm(A * (taus + late * rng.uniform(0, 2, n + 1))[:, None, None])).reshape(-1, n)
        assert found.lower <= (1 + 1e-9) / np.linalg.norm(D[:, None] * np.linalg.pinv(rows, rcond=1e-15), 2)
