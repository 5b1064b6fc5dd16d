"""O3: a state with n-1 prescribed zeros has at most k* zeros in the window, and the oscillator reaches k*."""

import numpy as np
import pytest

from sampling_design import Plant, zero_count_bound
from tests.oracles import zero_count as oracle


@pytest.mark.parametrize("half_turns", [1, 2, 5])
def test_the_oscillator_reaches_the_bound(half_turns):
    """sin t has half_turns + 1 zeros in [0, half_turns pi]: exactly k*, so k* samples fail and one more does not."""
    A, C, T = [[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], half_turns * np.pi
    bound = zero_count_bound(Plant(A, C), T)
    zeros = np.arange(half_turns + 1) * np.pi
    assert bound.value == pytest.approx(len(zeros), abs=1e-12)
    assert bound.samples_needed == len(zeros) + 1
    assert oracle.rank(A, C, zeros, 1e-13) == 1
    for extra in (0.3, 2.0, T - 1e-3):
        assert oracle.rank(A, C, [*zeros, extra], 1e-13) == 2


def test_a_state_with_prescribed_zeros_never_has_more_than_the_bound():
    rng = np.random.default_rng(12)
    reached = 0
    for trial in range(14):
        values = [complex(rng.normal(0, 0.2), rng.uniform(0.5, 3.0)) for _ in range(rng.integers(1, 3))]
        spectrum = [*values, *np.conj(values), *([0.0, -0.5][: trial % 3])]
        A, C = oracle.companion(spectrum)
        T = float(rng.uniform(1.0, 8.0))
        zeros = np.sort(rng.uniform(0.0, T, len(spectrum) - 1))
        x = oracle.state_with_zeros(A, C, zeros)
        bound = zero_count_bound(Plant(A, C), T)
        found = oracle.count_zeros(A, C, x, T, points=200)
        assert len(zeros) <= found <= bound.value + 1e-9
        reached += found == int(np.floor(bound.value))
    assert reached >= 3  # where it is reached, one sample less would not do
