"""No schedule found by differential evolution or SHGO exceeds the bound, nor the design by more than the gap.

The long run, with ten times the design's own time, is `tests/benchmarks/bench_design_search.py`.
"""

import functools

import numpy as np
import pytest
from scipy.optimize import differential_evolution, shgo

from sampling_design import Requirement, design_schedule
from sampling_design.plants import library
from tests.oracles.design import window_sigma_scan

CASES = {
    "oscillator": (library.oscillator(), 4.0, 0.5, 3),
    "double integrator": (library.double_integrator(), 4.0, 0.5, 4),
    "triple integrator": (library.triple_integrator(), 4.0, 0.3, 5),
    "satellite": (library.satellite(), 5554.0, 60.0, 4),
}


@functools.cache
def designed(name):
    plant, window, spacing, count = CASES[name]
    return design_schedule(plant, Requirement(window=window, period=window, spacing=spacing, samples=count))


@pytest.mark.long
@pytest.mark.parametrize("search", ["evolution", "shgo"])
@pytest.mark.parametrize("name", CASES)
def test_global_search_stays_below(name, search):
    plant, window, spacing, count = CASES[name]
    own = plant.scaled()  # where a plant has scales its sigma is judged in them
    design = designed(name)

    def cost(cube):
        shares = -np.log(np.clip(cube, 1e-9, 1 - 1e-9))
        gaps = spacing + (window - count * spacing) * shares / shares.sum()
        return -window_sigma_scan(own.A, own.C, np.cumsum(gaps) - gaps[0], window, window, places=0)

    if search == "evolution":
        found = -differential_evolution(cost, [(0, 1)] * count, seed=1, maxiter=4, popsize=4, polish=False).fun
    else:
        found = -shgo(cost, [(0, 1)] * count, n=16, iters=1, options={"maxfev": 60}).fun
    assert 0 < found <= design.upper_bound
    assert found <= design.sigma_attained * (1 + 1e-6)
    assert found <= design.sigma / (1 - design.gap) * (1 + 1e-12)
