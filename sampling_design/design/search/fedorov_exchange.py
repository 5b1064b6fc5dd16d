"""From weights to schedules: systematic rounding, repair of the spacing, exchange of one time at a time.

The exchange is Fedorov's, for the worst window's least singular value in place of a determinant: sigma^2 is the least
eigenvalue of the window's information, the criterion that optimal design calls E-optimality.

References
----------
Fedorov 1972; Pukelsheim 1993.
"""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt

from sampling_design.design.bounds.relaxation import Relaxation
from sampling_design.design.problem.numbers import DesignProblem
from sampling_design.design.problem.positions import worst_sigma2

Array = npt.NDArray[np.float64]

_LEADS = 6  # turns of a period that repair tries


def rounded(problem: DesignProblem, found: Relaxation, offset: float) -> Array | None:
    """Systematic sampling of the cumulated weights from `offset` in [0, 1), repaired; None if no repair is found."""
    spare = problem.samples - problem.fixed.size
    total = np.cumsum(found.weights)
    if not total.size or total[-1] <= 0 or spare == 0:
        return repaired(problem, problem.fixed)
    marks = (np.arange(spare) + offset) / spare * total[-1]
    picked = found.times[np.minimum(np.searchsorted(total, marks), found.times.size - 1)]
    return repaired(problem, np.concatenate([problem.fixed, picked]))


def even(problem: DesignProblem, offset: float) -> Array | None:
    """Evenly spaced over the allowed time, repaired."""
    spare = problem.samples - problem.fixed.size
    return spread(problem, (np.arange(spare) + offset) / max(spare, 1))


def spread(problem: DesignProblem, shares: Array) -> Array | None:
    """Free samples at these shares (in [0, 1)) of the allowed time, fixed ones beside them, repaired."""
    lengths = np.diff(problem.intervals, axis=1)[:, 0]
    ends = np.cumsum(lengths)
    marks = shares * ends[-1]
    place = np.minimum(np.searchsorted(ends, marks, side="right"), lengths.size - 1)
    return repaired(problem, np.concatenate([problem.fixed, problem.intervals[place, 1] - (ends[place] - marks)]))


def shares_of(problem: DesignProblem, times: Array) -> Array:
    """The inverse of `spread`: at which share of the allowed time each of `times` lies."""
    lengths = np.diff(problem.intervals, axis=1)[:, 0]
    place = np.searchsorted(problem.intervals[:, 0], times, side="right") - 1
    before = np.cumsum(lengths)[place] - lengths[place]
    inside = np.minimum(times - problem.intervals[place, 0], lengths[place])
    return np.asarray((before + inside) / lengths.sum())


def packed(problem: DesignProblem) -> Array:
    """A schedule that fits whenever any does: of the densest packing as many as are asked for, fixed ones first."""
    times = problem.packing()
    free = times[~np.isin(times, np.mod(problem.fixed, problem.period))]
    spare = problem.samples - problem.fixed.size
    picked = np.floor(np.arange(spare) * (free.size / max(spare, 1))).astype(np.intp)
    return np.sort(np.concatenate([problem.fixed, free[picked]]))


def repaired(problem: DesignProblem, times: Array) -> Array | None:
    """Admissible times near `times` (fixed ones stay): pushed apart in order; None where that does not fit.

    From a sample after one of the widest gaps as the first of the period, later samples move right just enough;
    the turn that moves them least wins.
    """
    period, gap = problem.period, problem.gap
    t = np.sort(np.mod(times, period))
    best: tuple[float, Array] | None = None
    widest = np.argsort(-np.diff(np.append(t[-1] - period, t)), kind="stable")
    for lead in widest[:_LEADS]:
        turn = np.concatenate([t[lead:], t[:lead] + period])
        pushed = _pushed(problem, turn, gap)
        if pushed is not None and (best is None or np.abs(pushed - turn).sum() < best[0]):
            best = (float(np.abs(pushed - turn).sum()), np.sort(np.mod(pushed, period)))
    return None if best is None else best[1]


def _pushed(problem: DesignProblem, turn: Array, gap: float) -> Array | None:
    """Forward pass: each time at least `gap` after the last, in an allowed interval, fixed times untouched."""
    period = problem.period
    fixed = np.concatenate([problem.fixed + cycle * period for cycle in range(3)])
    fixed = fixed[(fixed >= turn[0] - gap) & (fixed < turn[0] + period + gap)]
    result: list[float] = []
    for wish in turn:
        if np.any(np.abs(fixed - wish) <= 1e-12 * period):
            if result and wish - result[-1] < problem.spacing * (1 - 1e-12):
                return None
            result.append(float(wish))
            continue
        t = max(float(wish), result[-1] + gap if result else -np.inf)
        moved = True
        while moved:
            near = fixed[np.abs(fixed - t) < gap]
            after = float(near[-1]) + gap if near.size else t
            opened = next_open(problem, after)
            moved = opened > t
            t = opened
            if t > turn[0] + 2 * period:
                return None
        result.append(t)
    wrapped = np.array(result)
    ordered = np.sort(np.mod(wrapped, period))
    gaps = np.diff(np.append(ordered, ordered[0] + period))
    return wrapped if gaps.min() >= problem.spacing * (1 - 1e-12) else None


def next_open(problem: DesignProblem, t: float) -> float:
    """The first allowed time at or after t."""
    cycle = np.floor(t / problem.period)
    inside = t - cycle * problem.period
    for a, b in problem.intervals:
        if inside < b - 1e-12 * problem.period:
            return float(max(t, cycle * problem.period + a))
    return float((cycle + 1) * problem.period + problem.intervals[0, 0])


def candidates(problem: DesignProblem, others: Array, count: int) -> Array:
    """Admissible times for one more sample: a grid of `count`, and the ends of free stretches where these are few."""
    period, gap = problem.period, problem.gap
    grid = np.arange(count) * (period / count)
    near = np.concatenate([others - gap, others + gap]) if others.size <= count // 2 else np.zeros(0)
    wished = np.unique(np.mod(np.concatenate([grid, near, problem.intervals[:, 0]]), period))
    wished = wished[problem.mask(wished).any(axis=-1)]
    if not others.size:
        return wished
    distance = np.abs((wished[:, None] - others[None, :] + period / 2) % period - period / 2)
    return np.asarray(wished[distance.min(axis=1) >= (problem.spacing + gap) / 2])


def is_admissible(problem: DesignProblem, times: Array) -> bool:
    """Whether sorted times in [0, period) meet spacing, forbidden and fixed times."""
    gaps = np.diff(np.append(times, times[0] + problem.period))
    fixed = all(np.any(times == t) for t in problem.fixed)
    return bool(
        times.size == problem.samples
        and gaps.min() >= problem.spacing * (1 - 1e-12)
        and problem.mask(times).any(axis=-1).all()
        and fixed
    )


def exchanged(
    problem: DesignProblem, times: Array, sigma2: float, count: int, rounds: int = 3, deadline: float = np.inf
) -> tuple[Array, float]:
    """Move one sample at a time to its best admissible place on a grid of `count`, until nothing improves."""
    for _ in range(rounds):
        before = sigma2
        for i in range(times.size):
            if np.any(times[i] == problem.fixed) or time.perf_counter() > deadline:
                continue
            others = np.delete(times, i)
            places = candidates(problem, others, count)
            if not places.size:
                continue
            trial = np.sort(np.concatenate([np.tile(others, (places.size, 1)), places[:, None]], axis=1), axis=1)
            values = worst_sigma2(problem, trial, inner=0)
            top = int(np.argmax(values))
            if values[top] > sigma2 * (1 + 1e-9):
                exact = float(worst_sigma2(problem, trial[top : top + 1])[0])
                if exact > sigma2:
                    times, sigma2 = trial[top], exact
        if sigma2 <= before * (1 + 1e-4):
            break
    return times, sigma2
