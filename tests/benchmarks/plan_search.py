"""Rivals of a plan: differential evolution and random search with ten times its CPU time.

Both look for times on the grid, judged by the
search's own program; their best is then proven by `accuracy`: it must neither lie below what the plan says is out of
reach, nor below the plan by more than its gap.
"""

from __future__ import annotations

import contextlib
import time

import numpy as np
from scipy.optimize import differential_evolution

import sampling_design as sd
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.proven_choice import accuracy_of
from tests.benchmarks.plan_gaps import posed

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"], outputs=["y"])
INTEGRATOR = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["place", "speed"], outputs=["y"])
FOUR, TIMES = 4, 10.0


def wanted(plant, row, period, steps, samples, noise):
    """The most accurate plan of so many samples for one row."""
    bounds = {"w_bound": 0.02, "sensors": {"y": {"noise_bound": noise}}}
    return plant, sd.PlanRequirement({row: 1.0}, period=period, grid=period / steps, samples=samples, **bounds)


CASES = {
    "oscillator, position": lambda: wanted(OSCILLATOR, "position", 6.4, 64, FOUR, 0.2),
    "oscillator, velocity": lambda: wanted(OSCILLATOR, "velocity", 6.4, 64, FOUR, 0.2),
    "double integrator, place": lambda: wanted(INTEGRATOR, "place", 5.0, 50, 3, 0.1),
    "triple integrator": lambda: posed("triple_integrator", FOUR),
    "three compartments": lambda: posed("three_compartment", FOUR),
    "cart and pendulum": lambda: posed("cart_pendulum", FOUR),
    "satellite": lambda: posed("satellite", FOUR),
}


class Spent(Exception):
    """The rival's time is up."""


class Rival:
    """Times as fractions of the period, judged on the grid; the best is kept."""

    def __init__(self, problem, seconds):
        self.problem, self.seconds = problem, seconds
        self.oracle, self.began = AccuracyOracle(problem, discretize(problem)), time.process_time()
        self.best, self.chosen, self.tried = np.inf, None, 0

    def __call__(self, shares):
        if time.process_time() - self.began > self.seconds:
            raise Spent
        chosen = np.zeros(self.problem.allowed.shape, dtype=bool)
        chosen[np.floor(np.asarray(shares) * self.problem.steps).astype(int) % self.problem.steps] = True
        worst = self.oracle.judge(chosen, above=self.best)[0]
        self.tried += 1
        if worst < self.best:
            self.best, self.chosen = worst, chosen
        return worst

    def evolved(self, samples):
        with contextlib.suppress(Spent):
            differential_evolution(self, [(0.0, 1.0)] * samples, seed=3, maxiter=10**6, tol=0.0, polish=False)

    def drawn(self, samples):
        rng = np.random.default_rng(4)
        with contextlib.suppress(Spent):
            while True:
                self(rng.uniform(size=samples))


RIVALS = {"differential evolution": Rival.evolved, "random search": Rival.drawn}


def spaced(problem, samples):
    """The choice whose samples are evenly spaced, as far as the grid allows."""
    chosen = np.zeros(problem.allowed.shape, dtype=bool)
    chosen[np.round(np.arange(samples) * problem.steps / samples).astype(int)] = True
    return chosen


def contest(name):
    """Ratios of a plan, of what is out of reach, of even spacing and of each rival after TIMES its CPU time."""
    plant, requirement = CASES[name]()
    began = time.process_time()
    found = sd.plan_samples(plant, requirement, certificate=False, robustness=False)
    spent, level = time.process_time() - began, found.bound.ratio.level
    choices = [spaced(found.problem, requirement.samples)]
    for rival in RIVALS.values():
        search = Rival(found.problem, TIMES * spent)
        rival(search, requirement.samples)
        choices.append(search.chosen)
    goal, reached = found.problem.goals[0].tolerance, []
    for chosen in choices:
        proof = accuracy_of(found.problem, chosen)
        assert proof.upper[0] >= level * goal
        assert proof.lower[0] >= found.ratio * (1 - found.gap) * goal * (1 - 1e-9)
        reached.append(proof.upper[0] / goal)
    return found.ratio, level, *reached, spent
