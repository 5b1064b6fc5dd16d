"""Where lambda_max(P2 Y) is largest: a window and a time in it, and Y there.

Along the window Y follows the Riccati recursion of `riccati.py`, whose search proposes peaks; a proof names others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sampling_design.certificates.exact.window_problem import WindowProblem
from sampling_design.numerics.filtering import measurement_update, propagate
from sampling_design.records.arrays import Array

SAME_START = 1e-9
"""A window whose start is this near that of a sample, relative to the gap, is its window: times are rounded."""


@dataclass(frozen=True, eq=False)
class RiccatiPeak:
    """The largest lambda_max(P2 Y) met, and where: window (index, remaining), gap number `step`, `fraction` of it.

    `step` counts gaps after the window's first sample; -1 is the stretch before it.
    """

    value: float
    index: int
    remaining: float
    step: int
    fraction: float


def located(problem: WindowProblem, start: float, t: float) -> RiccatiPeak:
    """Return the window that starts at `start`, at time `t`, as a peak with the value that is attained there."""
    periods = 1 if problem.period is None else int(t / problem.period) + 2
    times = (problem.times + (problem.period or 0.0) * np.arange(periods)[:, None]).ravel()
    first = int(np.searchsorted(times, start * (1 + 1e-12), side="right"))
    index = first % problem.count
    remaining = float(min(times[first] - start, problem.reach[index]))
    if t <= times[first]:
        found = RiccatiPeak(0.0, index, remaining, -1, (t - start) / max(remaining, 1e-300))
    else:
        last = int(np.searchsorted(times, t * (1 - 1e-12), side="left"))
        left = min(max((times[last] - t) / problem.gaps[last % problem.count], 0.0), 1.0)
        found = RiccatiPeak(0.0, index, remaining, last - first - 1, 1.0 - left)
    return replace(found, value=float(np.linalg.eigvalsh(at_peak(problem, found)[0])[-1]))


def starts_at_sample(problem: WindowProblem, peak: RiccatiPeak) -> bool:
    """Whether a window is one of those that start at a sample, or at time 0."""
    index, remaining = problem.sample_starts()
    return bool(np.isclose(remaining[index == peak.index], peak.remaining, rtol=SAME_START, atol=0.0).any())


def at_peak(problem: WindowProblem, peak: RiccatiPeak) -> tuple[Array, float, float]:
    """Return Y at a peak, the time of the peak and the start of its window."""
    start = float(problem.times[peak.index]) - peak.remaining
    start = max(start if start >= 0 else start + (problem.period or 0.0), 0.0)
    before = peak.remaining * (peak.fraction if peak.step < 0 else 1.0)
    F, W = problem.flow([before])
    Y, elapsed, at = propagate(np.eye(problem.size), F[0], W[0]), before, peak.index
    gap_F, gap_W = problem.flow(problem.gaps)
    for step in range(peak.step + 1):
        Y = measurement_update(Y, problem.rows[at])
        at = (at + 1) % problem.count
        duration = problem.gaps[at] * (peak.fraction if step == peak.step else 1.0)
        last = problem.flow([duration]) if step == peak.step else (gap_F[at : at + 1], gap_W[at : at + 1])
        Y, elapsed = propagate(Y, last[0][0], last[1][0]), elapsed + duration
    return Y, start + float(elapsed), start
