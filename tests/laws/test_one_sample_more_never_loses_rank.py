"""More than k* distinct times in a closed window of length T make O_s full rank, wherever they are placed."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sampling_design import Plant, zero_count_bound
from sampling_design.errors import NotObservableError
from tests.oracles import zero_count as oracle

frequencies = st.lists(st.integers(20, 400).map(lambda k: k / 100), min_size=0, max_size=2)
rates = st.lists(st.integers(-100, 50).map(lambda k: k / 100), min_size=0, max_size=2)
positions = st.lists(st.integers(0, 1000).map(lambda k: k / 1000), min_size=14, max_size=14, unique=True)


@pytest.mark.long
@settings(max_examples=40)
@given(frequencies, rates, st.floats(0.1, 6.0), positions, st.booleans(), st.booleans())
def test_rank_is_full(frequencies, rates, T, positions, clustered, on_zeros):
    spectrum = [s * 1j * w for w in frequencies for s in (1, -1)] + rates
    assume(len(spectrum) >= 1)
    A, C = oracle.companion(spectrum)
    bound = zero_count_bound(Plant(A, C), T)
    count = bound.samples
    assume(count <= len(positions))
    times = np.sort(positions[:count]) * T
    if clustered:
        times[: count // 2] *= 0.05
    if on_zeros and frequencies:  # as many times as fit on the zeros of the fastest mode
        zeros = np.arange(int(T / np.pi * max(frequencies)) + 1) * np.pi / max(frequencies)
        times[: zeros.size] = zeros[:count]
    times = np.unique(times)
    assume(times.size == count)
    assume(count < 2 or np.min(np.diff(times)) > 1e-4)
    assert oracle.rank(A, C, times, tolerance=1e-40) == len(spectrum)


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.floats(0.1, 4.0))
def test_rank_is_full_with_two_outputs(seed, T):
    rng = np.random.default_rng(seed)
    A, C = rng.integers(-2, 3, (4, 4)).astype(float), rng.integers(-1, 2, (2, 4)).astype(float)
    try:
        bound = zero_count_bound(Plant(A, C), T)
    except NotObservableError:
        assume(False)
    times = np.sort(rng.uniform(0.0, T, bound.samples))
    assume(bound.samples <= 12)
    assume(np.min(np.diff(times), initial=1.0) > 1e-4)
    assert oracle.rank(A, C, times, tolerance=1e-40) == 4
    assert bound.samples_least <= bound.samples


@settings(max_examples=20)
@given(st.floats(0.2, 4.0), st.integers(1, 6))
def test_one_sample_less_may_lose_it(omega, half_turns):
    """The printed minimum, taken with ceil, is one sample short where k* is whole."""
    A, C = [[0.0, omega], [-omega, 0.0]], [[1.0, 0.0]]
    T = half_turns * np.pi / omega
    bound = zero_count_bound(Plant(A, C), T)
    assert bound.samples_needed == half_turns + 2
    zeros = np.arange(bound.samples_needed - 1) * np.pi / omega
    assert oracle.rank(A, C, zeros, tolerance=1e-12) == 1
