"""A function to be minimised whose time runs out: it remembers the best it has seen."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution, shgo


class OutOfTime(Exception):
    """The search has used its seconds."""


class Budgeted:
    """`function`, until `seconds` of processor time are over."""

    def __init__(self, function: Callable[[Any], float], seconds: float):
        self.function, self.started = function, time.process_time()
        self.until = self.started + seconds
        self.best, self.calls, self.spent = np.inf, 0, seconds

    def __call__(self, x: Any) -> float:
        if time.process_time() > self.until:
            raise OutOfTime
        value = self.function(x)
        self.best, self.calls = min(self.best, value), self.calls + 1
        return value

    def ended(self) -> Budgeted:
        """Keep the time it took in all: a search may go on long after its last call."""
        self.spent = time.process_time() - self.started
        return self


def evolve(function: Callable[[Any], float], dimension: int, seconds: float) -> Budgeted:
    """Run differential evolution on the unit cube with SciPy's defaults, from new seeds until the time is over."""
    goal, seed = Budgeted(function, seconds), 0
    try:
        while True:
            differential_evolution(goal, [(0.0, 1.0)] * dimension, seed=seed, tol=1e-8, maxiter=100_000)
            seed += 1
    except OutOfTime:
        return goal.ended()


def homology(function: Callable[[Any], float], dimension: int, seconds: float) -> Budgeted:
    """Run SHGO on the unit cube, first with its defaults, then with Sobol points, twice as many each round."""
    goal, points = Budgeted(function, seconds), 64
    try:
        shgo(goal, [(0.0, 1.0)] * dimension)
        while True:
            shgo(goal, [(0.0, 1.0)] * dimension, n=points, sampling_method="sobol")
            points *= 2
    except OutOfTime:
        return goal.ended()
