"""Designs against differential evolution and SHGO, each with ten times the design's CPU time.

python -m tests.benchmarks.bench_design_search writes docs/design_search.md
"""

import os
import time
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import differential_evolution, shgo

from sampling_design import PeriodicSchedule, Requirement, design_schedule, library, split_modes, window_sigma
from sampling_design.design.problem.posing import pose, resolve
from sampling_design.design.problem.positions import worst_sigma2

DOCS = Path(__file__).parents[2] / "docs"
TIMES = 10
CASES = {
    "oscillator, 3 samples": (library.oscillator(), {"window": 4.0, "spacing": 0.5, "samples": 3}),
    "double integrator, 4 samples": (library.double_integrator(), {"window": 4.0, "spacing": 0.5, "samples": 4}),
    "triple integrator, 5 samples": (library.triple_integrator(), {"window": 4.0, "spacing": 0.3, "samples": 5}),
    "oscillator, closed times": (
        library.oscillator(),
        {"window": 4.0, "spacing": 0.3, "samples": 5, "forbidden": [[0.0, 1.2]]},
    ),
    "satellite, 5 samples": (library.satellite(), {"window": 5554.0, "spacing": 60.0, "samples": 5}),
    "satellite, 12 samples": (library.satellite(), {"window": 5554.0, "spacing": 60.0, "samples": 12}),
}


class OutOfTime(Exception):
    """The searcher's time is up."""


class Objective:
    """Minus sigma of points of the unit cube (columns), read as gaps; remembers the best, stops on time."""

    def __init__(self, plant, requirement, seconds):
        split = split_modes(plant)
        asked = resolve(split, requirement).requirement
        self.problem = pose(split.retained, asked, asked.samples["exactly"])
        self.plant, self.best, self.times, self.calls = split.retained, 0.0, None, 0
        self.until = time.process_time() + seconds
        self.invariant = self.problem.is_shift_invariant

    def schedules(self, cube):
        """Exponential gaps are uniform over all schedules of the spacing; where time matters the first is drawn too."""
        p, k = self.problem, self.problem.samples
        shares = -np.log(np.clip(cube[:k], 1e-12, 1.0 - 1e-9))
        gaps = p.gap + (p.period - k * p.gap) * shares / np.sum(shares, axis=0)
        first = np.zeros(cube.shape[1]) if self.invariant else cube[-1] * p.period
        return np.sort(np.mod(first + np.cumsum(gaps, axis=0) - gaps[:1], p.period).T, axis=1)

    def __call__(self, cube):
        if time.process_time() > self.until:
            raise OutOfTime
        single = cube.ndim == 1
        times = self.schedules(np.atleast_2d(cube.T).T)
        allowed = self.problem.mask(times).any(axis=-1)
        sigma = np.sqrt(np.maximum(worst_sigma2(self.problem, times, inner=0), 0.0))
        sigma = np.where(allowed.all(axis=1), sigma, np.mean(allowed, axis=1) - 1.0)
        self.calls += sigma.size
        if sigma.max() > self.best:
            self.best, self.times = float(sigma.max()), times[int(np.argmax(sigma))]
        return float(-sigma[0]) if single else -sigma

    def proven(self):
        """Sigma of the best schedule, bracketed by the proof of every window position; attained value."""
        if self.times is None:
            return 0.0
        schedule = PeriodicSchedule.from_times(self.times, self.problem.period, time_unit=self.plant.time_unit)
        return window_sigma(self.plant, schedule, self.problem.window, rtol=1e-3).upper


def searched(name, plant, requirement, seconds):
    """Run one searcher from new seeds until its time is up."""
    objective, seed = Objective(plant, requirement, seconds), 0
    box = [(1e-3, 1.0)] * (objective.problem.samples + (not objective.invariant))
    try:
        while True:
            if name == "evolution":
                options = {"vectorized": True, "updating": "deferred", "polish": False, "maxiter": 2000}
                differential_evolution(objective, box, rng=seed, popsize=10, tol=1e-8, **options)
            else:
                shgo(objective, box, n=64 * (seed + 1), sampling_method="sobol")
            seed += 1
    except OutOfTime:
        pass
    return objective


def designed(name):
    plant, asked = CASES[name]
    return design_schedule(plant, Requirement(**asked))


@pytest.mark.parametrize("name", CASES)
def test_design(benchmark, name):
    design = benchmark.pedantic(designed, args=(name,), warmup_rounds=1, rounds=1)
    assert 0 < design.sigma <= design.upper_bound


def main():
    designed("oscillator, 3 samples")  # the first call loads the solver
    lines = ["# Designs against global searches", "", __doc__.split("\n\n")[0], ""]
    made = f"Made by `python -m tests.benchmarks.bench_design_search` on {date.today()}"
    lines += [f"{made}; CPU seconds, {os.cpu_count()} cores, one BLAS thread. Sigma of each best schedule found.", ""]
    lines += ["| case | CPU s | sigma proven | bound | gap | differential evolution | SHGO | beaten by |"]
    lines += ["|---|---|---|---|---|---|---|---|"]
    for name, (plant, asked) in CASES.items():
        began = time.process_time()
        design = designed(name)
        seconds = time.process_time() - began
        found = []
        # SHGO triangulates the cube: beyond some ten dimensions its first step alone takes longer
        for searcher in ("evolution", "shgo") if asked["samples"] <= 10 else ("evolution",):
            found.append(searched(searcher, plant, Requirement(**asked), TIMES * seconds).proven())
        assert max(found) <= design.upper_bound, name
        more = max(found) / design.sigma_attained - 1
        row = [name, f"{seconds:.2f}", f"{design.sigma:.6f}", f"{design.upper_bound:.6f}", f"{100 * design.gap:.2f} %"]
        row += (
            [f"{value:.6f}" for value in found]
            + ["-"] * (2 - len(found))
            + [f"{100 * more:.3f} %" if more > 0 else "-"]
        )
        lines.append("| " + " | ".join(row) + " |")
        print(lines[-1], flush=True)
    (DOCS / "design_search.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
