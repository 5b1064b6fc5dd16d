"""Worst case sigma: seconds to a closed bracket, and what global searches find in ten times that.

python -m tests.benchmarks.bench_worst_case
"""

import time

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import differential_evolution, shgo

from sampling_design import Plant
from sampling_design.observability.worst_case.worst_case_sigma import worst_case_sigma
from sampling_design.schedules.spaced_windows import SpacedWindows


def oscillators(*rates):
    return np.kron(np.diag(rates), [[0.0, 1.0], [-1.0, 0.0]]), np.tile([[1.0, 0.0]], len(rates))


def chain(n):
    return np.eye(n, k=1), np.eye(1, n)


def with_constant(A, C):
    return block_diag(A, [[0.0]]), np.hstack([C, np.ones((len(C), 1))])


LARGE = {"chain of six k=8, 5 %": (*chain(6), 4.0, 8, 0.3, 0.05)}
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
    return worst_case_sigma(Plant(A, C), SpacedWindows(window, count, spacing), rtol=rtol)


@pytest.mark.parametrize("name", CASES)
def test_worst_case(benchmark, name):
    found = benchmark.pedantic(run, args=(CASES[name],), warmup_rounds=1, rounds=3)
    assert found.closed


def main():
    print(
        f"{'case':28} {'first s':>8} {'s':>8} {'lower':>9} {'upper':>9} {'evolution':>10} {'shgo':>10}  (ten times s)"
    )
    for name, case in (CASES | LARGE).items():
        seconds = []
        for _ in range(2 if name in CASES else 1):
            began = time.process_time()
            found = run(case)
            seconds.append(time.process_time() - began)
        # SHGO triangulates the cube: hopeless beyond some ten dimensions
        names = ("evolution", "shgo") if case[3] <= 10 else ("evolution",)
        others = [searched(s, case, 10 * seconds[-1]).best for s in names] + [np.inf] * (2 - len(names))
        verdict = "beaten" if min(others) < found.lower else ""
        print(
            f"{name:28} {seconds[0]:8.3f} {seconds[1]:8.3f} {found.lower:9.6f} {found.upper:9.6f} "
            f"{others[0]:10.6f} {others[1]:10.6f}  {verdict}",
            flush=True,
        )


if __name__ == "__main__":
    main()
