"""A trajectory that as few measurements as can be show: those that show it are taken away from it one after another.

    A  hidden from S, reaching a level   ->   A'  hidden from S and x, for as many x as leave one that reaches it

What is left shows all that reach the level and are hidden from the rest: a choice without any of it fails.
"""

from __future__ import annotations

import numpy as np

from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.hidden_trajectories import HiddenTrajectory
from sampling_design.records.arrays import Mask

MOST_FAILURES = 4  # measurements in a row that no trajectory can do without, after which it is left at that


def narrowed(oracle: AccuracyOracle, trajectory: HiddenTrajectory, level: float) -> HiddenTrajectory:
    """A trajectory that ends where this one does, reaches a level as it does, and that fewer measurements show.

    Those that show it least are taken first, many at once while that succeeds.
    """
    needed = np.zeros_like(oracle.problem.allowed)
    count = max(1, int(detecting_measurements(oracle, trajectory, level).sum()) // 4)
    failed = 0
    while failed < MOST_FAILURES:
        row = detecting_measurements(oracle, trajectory, level)
        left = np.argwhere(row & ~needed)
        if not len(left) or oracle.work.over:
            break
        count = max(1, min(count, len(left)))
        peaks = trajectory.peaks[(trajectory.end - left[:, 0]) % oracle.problem.steps, left[:, 1]]
        taken = left[np.argsort(peaks, kind="stable")[:count]]
        hidden = oracle.problem.allowed & ~row
        hidden[taken[:, 0], taken[:, 1]] = True
        other = oracle.ending_with(hidden, trajectory, level)
        if other is not None and other.reach > level:
            trajectory, count, failed = other, 2 * count, 0
        else:
            needed[taken[:, 0], taken[:, 1]] |= count == 1
            failed += count == 1
            count //= 2
    return trajectory


def detecting_measurements(oracle: AccuracyOracle, trajectory: HiddenTrajectory, level: float) -> Mask:
    """Which of all that may be measured shows a trajectory that is scaled to reach just a level (M, p)."""
    steps = oracle.problem.steps
    back = (trajectory.end - np.arange(steps)) % steps
    return np.asarray(oracle.problem.allowed & (trajectory.weights(level)[back] > 0))
