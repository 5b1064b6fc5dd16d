"""A dense scan by plain exponentials, events and their limits included, never falls below the proven bound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sampling_design import PeriodicSchedule, Plant, Schedule, window_sigma
from tests.oracles.observability import scan_windows


def random_case(seed):
    """Plant (stable, unstable or oscillating), gaps that now and then repeat, window, mask for several outputs."""
    rng = np.random.default_rng(seed)
    n, p, count = int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(3, 7))
    A = rng.standard_normal((n, n))
    if seed % 3 == 0:
        A = 3 * (A - A.T)
    gaps = rng.choice([0.25, 0.5], count) if seed % 2 else rng.uniform(0.1, 0.6, count)
    mask = None
    if p == 2 and seed % 5 < 2:
        mask = rng.random((count, p)) < 0.7
        mask[~mask.any(axis=1), 0] = True
    return Plant(A, rng.standard_normal((p, n))), gaps, mask, float(rng.choice([1.5, 2.0, 2.3]))


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=40)
def test_scan_stays_above_the_bound_and_reaches_the_other(seed, endless):
    plant, gaps, mask, window = random_case(seed)
    if endless:
        schedule = PeriodicSchedule(gaps, outputs=mask)
        held = schedule.between(0.0, schedule.first + schedule.period + window + 1e-6)
        ends = schedule.first + window, schedule.first + window + schedule.period
    else:
        gaps = np.concatenate([gaps, gaps, gaps])
        held = schedule = Schedule(np.cumsum(gaps) - gaps[0], None if mask is None else np.tile(mask, (3, 1)))
        if schedule.times[-1] < window:
            return
        ends = window, float(schedule.times[-1])
    result = window_sigma(plant, schedule, window)
    least, _, _ = scan_windows(plant.A, plant.C, held.times, held.outputs, window, *ends, points=40)
    assert result.closed
    assert result.lower <= least * (1 + 1e-9) + 1e-13
    assert 0.99 * result.upper <= least + 1e-13
    assert result.lower >= 0.99 * result.upper or result.upper < 1e-13


@pytest.mark.parametrize("seed", range(6))
def test_longer_windows_never_see_less(seed):
    plant, gaps, mask, window = random_case(seed)
    schedule = PeriodicSchedule(gaps, outputs=mask)
    longer = window_sigma(plant, schedule, window + 0.9)
    assert longer.upper >= window_sigma(plant, schedule, window).lower


@pytest.mark.parametrize("seed", range(4))
def test_units_of_time_do_not_matter(seed):
    plant, gaps, mask, window = random_case(seed)
    minutes = Plant(plant.A / 60, plant.C, time_unit="min")
    schedule = PeriodicSchedule(gaps, outputs=mask, time_unit="h")
    hours = window_sigma(Plant(plant.A, plant.C, time_unit="h"), schedule, window)
    converted = window_sigma(minutes, schedule.in_unit("min"), 60 * window)
    assert converted.upper == pytest.approx(hours.upper, rel=1e-6, abs=1e-13)
