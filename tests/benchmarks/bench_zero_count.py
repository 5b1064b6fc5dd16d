"""Counts, families and windows of schedules: first calls apart, then the steady cost."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, SpacedWindows, zero_count_bound
from sampling_design.observability.count.zero_count import critical_length
from sampling_design.schedules.sampling_set import SamplingSet


def chain_of_oscillators(pairs):
    A = np.zeros((2 * pairs, 2 * pairs))
    for i in range(pairs):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, 1.0 + i], [-1.0 - i, 0.0]]
    return Plant(A, np.tile([1.0, 0.0], pairs)[None])


@pytest.mark.parametrize("pairs", [1, 3, 5])
def test_zero_count(benchmark, pairs):
    plant = chain_of_oscillators(pairs)
    zero_count_bound(plant, 2.0)
    assert benchmark(zero_count_bound, plant, 2.0).order == 2 * pairs


@pytest.mark.parametrize("order", [4, 8, 11])
def test_critical_length(benchmark, order):
    values = [0.0] * (order % 2) + [s * 1j * k for k in range(1, order // 2 + 1) for s in (1, -1)]
    assert benchmark(critical_length, values) >= np.pi / (order // 2)


def test_kappa_of_a_long_period(benchmark):
    K = SamplingSet(PeriodicSchedule(np.random.default_rng(0).uniform(0.1, 1.0, 10_000)))
    assert benchmark(K.kappa, 100.0) > 100


def test_spaced_windows_judge_a_long_schedule(benchmark):
    family = SpacedWindows(10.0, 8, 0.1)
    schedule = family.draw(samples=20_000)
    assert benchmark(family.contains, schedule)
