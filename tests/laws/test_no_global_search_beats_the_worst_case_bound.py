"""No schedule found by differential evolution or SHGO lies below the proven worst case, nor below the attained one."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import differential_evolution, shgo

from sampling_design import Plant
from sampling_design.observability.worst_case.worst_case_sigma import worst_case_sigma
from sampling_design.schedules.spaced_windows import SpacedWindows
from tests.cases import few
from tests.oracles.worst_case import from_steps, sigma_of_times

PAIR = np.kron(np.diag([1.0, 2.0]), [[0.0, 1.0], [-1.0, 0.0]])
CASES = {
    "triple integrator": (np.eye(3, k=1), np.eye(1, 3), 4.0, 3, 0.5),
    "oscillator": (np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]]), 4.0, 3, 0.5),
    "pair": (PAIR, np.array([[1.0, 0.0, 1.0, 0.0]]), 4.0, 6, 0.3),
}


@pytest.mark.parametrize(("search", "name"), few(product(["evolution", "shgo"], CASES), 0))
def test_global_search_stays_above(name, search):
    A, C, window, count, spacing = CASES[name]
    found = worst_case_sigma(Plant(A, C), SpacedWindows(window, count, spacing))

    def sigma(steps):
        return sigma_of_times(A, C, from_steps(steps, window, count, spacing))

    if search == "evolution":
        best = differential_evolution(sigma, [(0, 1)] * count, seed=1, maxiter=8, popsize=5, polish=False).fun
    else:
        best = shgo(sigma, [(0, 1)] * count, n=12, iters=1, options={"maxfev": 150}).fun
    assert best >= found.lower
    assert best >= found.upper * (1 - 1e-7)
