"""Design: the satellite (12 samples, n = 6) and the tidal gauge; cost against grid times and samples.

The first call of each function loads the solver; pytest-benchmark's warm-up keeps it apart.
"""

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.bounds.relaxation import relax_placed
from sampling_design.design.bounds.weak_duality import placed_bound
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.plants import library


def daylight(days):
    """Nights of a number of days, in hours."""
    ends = [0.0, *(24.0 * d + h for d in range(days) for h in (7.0, 19.0)), 24.0 * days]
    return np.array(ends).reshape(-1, 2)


def once(benchmark, function):
    return benchmark.pedantic(function, rounds=1, iterations=1, warmup_rounds=1)


def test_satellite_12_samples(benchmark):
    requirement = Requirement(window=5554.0, period=5554.0, spacing=60.0, samples=12)
    assert once(benchmark, lambda: design_schedule(library.satellite(), requirement)).sigma > 0.9


def test_tidal_gauge_30_samples(benchmark):
    requirement = Requirement(window=720.0, period=720.0, spacing=5.0, samples=30, forbidden=daylight(30))
    design = once(benchmark, lambda: design_schedule(library.tidal_gauge(), requirement, starts=3))
    assert design.sigma > 0.0895
    assert design.gap < 0.04


def oscillators(n):
    """n/2 oscillators of 1, 2, ... rad/time, one output."""
    A = np.kron(np.diag(np.arange(1.0, n // 2 + 1)), [[0.0, 1.0], [-1.0, 0.0]])
    return Plant(A, np.tile([[1.0, 0.0]], n // 2))


@pytest.mark.parametrize("samples", [12, 25, 50, 100])
def test_cost_grows_with_samples(benchmark, samples):
    requirement = Requirement(window=6.28, spacing=6.28 / samples / 4, samples=samples)
    design = once(benchmark, lambda: design_schedule(oscillators(4), requirement, starts=2, branches=0))
    assert design.sigma > 0


@pytest.mark.parametrize("states", [2, 4, 6, 8])
def test_cost_grows_with_states(benchmark, states):
    requirement = Requirement(window=6.28, spacing=0.1, samples=2 * states)
    design = once(benchmark, lambda: design_schedule(oscillators(states), requirement, starts=2, branches=0))
    assert design.sigma > 0


@pytest.mark.parametrize("cells", [600, 1200, 2400, 4800])
def test_cost_of_the_bound_grows_with_grid_times(benchmark, cells, monkeypatch):
    problem = DesignProblem(oscillators(4), 6.28, 6.28, 0.3, 12, np.zeros((0, 2)), np.zeros(0), (None,))
    found = relax_placed(problem)
    monkeypatch.setattr("sampling_design.design.bounds.weak_duality.CELLS", cells)
    assert once(benchmark, lambda: placed_bound(problem, found.starts, found.Z)) > 0
