"""The proven bound lies below, and the attained bound not above, an independent minimum, on 50 random small cases."""

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.observability.worst_case.worst_case_sigma import worst_case_sigma
from sampling_design.schedules.spaced_windows import SpacedWindows
from tests.cases import few
from tests.oracles.worst_case import brute_force, is_admissible

POINTS = {1: 60, 2: 20, 3: 10}


def random_case(seed, reach):
    """A plant with |A| T = reach, a window, a count and a spacing."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    count = int(rng.integers(-(-n // p), 4))
    window = rng.uniform(1, 3)
    A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
    A *= reach / (np.linalg.norm(A, 2) * window)
    return A, C, window, count, window / max(count - 1, 1) * rng.uniform(0.05, 0.9)


@pytest.mark.parametrize("seed", few(range(50), *range(0, 50, 10), 1, 2))
def test_bracket_closes_around_the_brute_force_minimum(seed):
    A, C, window, count, spacing = random_case(seed, (1.0, 3.0, 6.0)[seed % 3])
    found = worst_case_sigma(Plant(A, C), SpacedWindows(window, count, spacing), budget=20.0)
    best, _ = brute_force(A, C, window, count, spacing, POINTS[count])
    assert found.lower <= best
    assert found.upper <= best * (1 + 1e-6) + 1e-12
    assert found.status in ("closed", "below rounding")
    assert found.lower >= 0.99 * found.upper or found.upper < 1e-11
    assert is_admissible(found.witness, window, spacing)


@pytest.mark.parametrize("seed", few(range(20), *range(0, 20, 5)))
def test_bracket_holds_the_minimum_also_where_it_cannot_close(seed):
    # up to twelve powers of e between the slowest and the fastest mode, and little time
    A, C, window, count, spacing = random_case(100 + seed, 16.0)
    found = worst_case_sigma(Plant(A, C), SpacedWindows(window, count, spacing), budget=0.2)
    best, _ = brute_force(A, C, window, count, spacing, POINTS[count])
    assert 0 <= found.lower <= found.upper
    # the two exponentials differ by rounding, of |C e^{At}| and not of sigma
    assert found.lower <= best + 1e-9 * np.linalg.norm(C) * np.exp(16.0)
    assert found.lower <= best * (1 + 1e-3) + 1e-12
