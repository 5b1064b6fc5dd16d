"""Worst case sigma: seconds to a closed bracket, and what global searches find in ten times that.

python -m tests.benchmarks.bench_worst_case [ROW ...] writes docs/worst_case.md, or those rows in it
"""

import sys
import time

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import differential_evolution, shgo

from sampling_design import Plant
from sampling_design.observability.worst_case.worst_case_sigma import worst_case_sigma
from sampling_design.schedules.spaced_windows import SpacedWindows
from tests.benchmarks.pages import MeasuredPage, Table

TIMES, ENOUGH = 10, 600.0


def oscillators(*rates, damped=0.0):
    """One position, the sum of all; rows of A that are damped by -d on the diagonal."""
    swing = np.kron(np.diag(rates), [[0.0, 1.0], [-1.0, 0.0]])
    return swing - np.diag(np.repeat(damped * np.ones(len(rates)), 2)), np.tile([[1.0, 0.0]], len(rates))


def sums_of_both(count):
    """The sum of all positions and that of all speeds."""
    return oscillators(*np.arange(1.0, count + 1))[0], np.tile(np.eye(2), count)


def chain(n):
    return np.eye(n, k=1), np.eye(1, n)


def with_constant(A, C):
    return block_diag(A, [[0.0]]), np.hstack([C, np.ones((len(C), 1))])


def random_plant(n, seed):
    """Entries of A and of one row drawn from the normal distribution."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, n)), rng.standard_normal((1, n))


CASES = {
    "double integrator k=2": (*chain(2), 4.0, 2, 0.5, 0.01),
    "oscillator k=3": (*oscillators(1.0), 4.0, 3, 0.5, 0.01),
    "triple integrator k=3": (*chain(3), 4.0, 3, 0.5, 0.01),
    "pair 1, 2 rad/s k=6, 5 %": (*oscillators(1.0, 2.0), 4.0, 6, 0.3, 0.05),
    "pair 1, 2 rad/s k=6, 1 %": (*oscillators(1.0, 2.0), 4.0, 6, 0.3, 0.01),
    "pair 1, 3 rad/s k=7, 1 %": (*oscillators(1.0, 3.0), 4.0, 7, 0.3, 0.01),
    "chain of four k=6, 1 %": (*chain(4), 4.0, 6, 0.3, 0.01),
    "pair 1, 2 rad/s and a constant k=7, 1 %": (*with_constant(*oscillators(1.0, 2.0)), 5.0, 7, 0.3, 0.01),
    "chain of five k=7, 1 %": (*chain(5), 4.0, 7, 0.3, 0.01),
    "oscillator k=50, T=50": (*oscillators(1.0), 50.0, 50, 0.5, 0.01),
}
LARGE = {
    "chain of six k=8, 5 %": (*chain(6), 4.0, 8, 0.3, 0.05),
    "three pairs 1, 2, 3 rad/s k=8, 5 %": (*oscillators(1.0, 2.0, 3.0), 4.0, 8, 0.3, 0.05),
    "the same damped by 0, .3, .9, 5 %": (*oscillators(1.0, 2.0, 3.0, damped=(0.0, 0.3, 0.9)), 4.0, 8, 0.3, 0.05),
    "four pairs 1 to 4 rad/s, two outputs k=6, 5 %": (*sums_of_both(4), 4.0, 6, 0.3, 0.05),
    "random, six states, seed 0, k=8, 20 %": (*random_plant(6, 0), 4.0, 8, 0.3, 0.2),
    "random, six states, seed 1, k=8, 20 %": (*random_plant(6, 1), 4.0, 8, 0.3, 0.2),
    "random, six states, seed 2, k=8, 20 %": (*random_plant(6, 2), 4.0, 8, 0.3, 0.2),
    "random, six states, seed 4, k=8, 20 %": (*random_plant(6, 4), 4.0, 8, 0.3, 0.2),
    "random, eight states, seed 0, k=10, 20 %": (*random_plant(8, 0), 4.0, 10, 0.3, 0.2),
    "oscillator k=3, a millionth apart": (*oscillators(1.0), 4.0, 3, 1e-6, 0.01),
    "oscillator k=6, a millionth apart": (*oscillators(1.0), 4.0, 6, 1e-6, 0.01),
}
"""Nothing is searched beside these."""


class OutOfTime(Exception):
    """The searcher's time is up."""


class Objective:
    """Sigma of a point of the unit cube, sorted into an admissible schedule; remembers its best, stops on time."""

    def __init__(self, A, C, window, count, spacing, seconds):
        self.plant, self.spacing, self.slack = Plant(A, C), spacing * np.arange(count), window - (count - 1) * spacing
        self.best, self.calls, self.until = np.inf, 0, time.process_time() + seconds

    def __call__(self, steps):
        if time.process_time() > self.until:
            raise OutOfTime
        times = self.slack * np.sort(np.clip(steps, 0.0, 1.0)) + self.spacing
        rows = (self.plant.C @ self.plant.transition(times)).reshape(-1, self.plant.n_states)
        sigma = float(np.linalg.svd(rows, compute_uv=False)[-1])
        self.best, self.calls = min(self.best, sigma), self.calls + 1
        return sigma


def searched(name, case, seconds):
    A, C, window, count, spacing, _ = case
    objective, seed = Objective(A, C, window, count, spacing, seconds), 0
    try:
        while True:
            if name == "evolution":
                differential_evolution(objective, [(0, 1)] * count, rng=seed, maxiter=300)
            else:
                shgo(objective, [(0, 1)] * count, n=64 * (seed + 1), sampling_method="sobol")
            seed += 1
    except OutOfTime:
        pass
    return objective


def run(case):
    A, C, window, count, spacing, rtol = case
    return worst_case_sigma(Plant(A, C), SpacedWindows(window, count, spacing), rtol=rtol, budget=ENOUGH)


@pytest.mark.parametrize("name", CASES)
def test_worst_case(benchmark, name):
    found = benchmark.pedantic(run, args=(CASES[name],), warmup_rounds=1, rounds=3)
    assert found.closed


def cells(name):
    """The bracket, its cost, and the least that global searches find in ten times its CPU time."""
    case = EVERY[name]
    began = time.process_time()
    found = run(case)
    seconds = time.process_time() - began
    # SHGO triangulates the cube: hopeless beyond some ten dimensions
    names = () if name in LARGE else ("evolution", "shgo") if case[3] <= 10 else ("evolution",)
    least = [searched(each, case, TIMES * seconds).best for each in names]
    assert all(value >= found.lower * (1 - 1e-9) for value in least), name
    best = [f"{value:.5g}" if np.isfinite(value) else "-" for value in least] + ["-"] * (2 - len(least))
    bracket = f"{found.lower:.5g}", f"{found.upper:.5g}", "yes" if found.closed else "no"
    return f"{seconds:.2f}", *bracket, str(found.cells), *best


EVERY = CASES | LARGE
NOTE = (
    "The least sigma of k samples in a window of 4 s (5 s with a constant) that are at least .3 to .5 s apart, proven "
    "and attained, to 1 % unless more are named. Cells are those of directions or times that the proof looked at. No "
    "search found less than what is proven, or the program would have ended. Rows that a run does not name stay as an "
    "earlier run left them."
)
RIVALS = ("differential evolution", "SHGO")
PAGE = MeasuredPage(
    "worst_case.md",
    "The worst schedule of a family against global searches",
    __doc__.split("\n\n")[0],
    "python -m tests.benchmarks.bench_worst_case",
    NOTE,
    [
        Table(
            ("case", "CPU s", "proven", "attained", "closed", "cells", *RIVALS),
            list(EVERY),
            cells,
            clocked=frozenset({"CPU s", *RIVALS}),
        )
    ],
)

if __name__ == "__main__":
    run(CASES["oscillator k=3"])  # the first call loads what is loaded once
    PAGE.run(sys.argv[1:])
