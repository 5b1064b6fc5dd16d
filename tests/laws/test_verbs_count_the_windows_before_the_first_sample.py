"""A schedule that begins late is judged from time 0 on by every verb, the windows before its first sample included.

The oracle lays out the samples one by one and looks at windows around each of them, from time 0 on.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from tests.cases import few


def laid_out(gaps, first, until):
    """Sample times; `gaps[0]` lies before the first one, as far as it does."""
    more = np.cumsum(np.tile(np.roll(gaps, -1), int(np.ceil(until / gaps.sum())) + 1))
    return first + np.concatenate([[0.0], more])


def windows(times, window, until):
    """Beginnings of windows from 0 on: just before and after a sample enters or leaves, and in between."""
    ends = np.concatenate([times, times - window])
    begins = np.concatenate([np.linspace(0, until, 40), ends + 1e-9, ends - 1e-9, [0.0]])
    return begins[(begins >= 0) & (begins <= until)]


def least(plant, times, window, until):
    """The least sigma over those windows."""
    found = np.inf
    for begin in windows(times, window, until):
        rows = [plant.C @ expm(plant.A * (t - begin)) for t in times[(times >= begin) & (times <= begin + window)]]
        stacked = np.vstack([np.zeros((plant.n_states,) * 2), *rows])
        found = min(found, np.linalg.svd(stacked, compute_uv=False)[-1])
    return found


@pytest.mark.parametrize("seed", few(range(12), *range(3)))
def test_families_and_windows_count_from_time_zero(seed):
    rng = np.random.default_rng(seed)
    unit, window, count = 10.0 ** rng.uniform(-9, 9), rng.uniform(1, 3), 3
    spacing, A, C = window / 8, rng.normal(size=(2, 2)), rng.normal(size=(1, 2))
    plain, plant = sd.Plant(A, C), sd.Plant(A / unit, C)
    family = sd.SpacedWindows(window * unit, count, spacing * unit)
    worst, members = sd.worst_case_sigma(plant, family, rtol=0.2), 0
    for _ in range(30):
        gaps = rng.uniform(spacing, 1.2 * window / count, int(rng.integers(1, 5)))
        first = float(rng.choice([0.0, rng.uniform(0, 1), 1.0])) * gaps.sum()
        schedule, until = sd.PeriodicSchedule(gaps * unit, first=first * unit), first + gaps.sum()
        times = laid_out(gaps, first, until + window)
        held = [np.sum((times >= a) & (times <= a + window)) for a in windows(times, window, until)]
        inside = min(held) >= count
        assert family.contains(schedule) is bool(inside)
        if inside:
            members += 1
            attained = least(plain, times, window, until)
            assert worst.lower <= attained * (1 + 1e-6)
            if members < 3:
                found = sd.window_sigma(plant, schedule, window * unit)
                assert found.lower <= attained * (1 + 1e-6)
                assert attained <= found.upper * 1.01
    assert members


@pytest.mark.parametrize(("late", "samples"), few([(0.4, 3), (0.0, 3), (0.4, 4), (1.1, 4)], 0))
def test_designs_count_from_time_zero(late, samples):
    plant, shut = sd.Plant([[0.0, 1.0], [-1.0, 0.1]], [[1.0, 0.0]]), [[0.0, late]] if late else []
    wanted = sd.Requirement(window=4.0, period=3.0, spacing=0.2, forbidden=shut)
    (point,) = sd.pareto_front(plant, wanted, [samples], starts=1, branches=0).points
    assert late <= point.times[0]
    times = np.add.outer(3.0 * np.arange(4), point.times).ravel()
    assert point.sigma <= least(plant, times, 4.0, 5.0) * (1 + 1e-6) <= point.sigma * 1.01
