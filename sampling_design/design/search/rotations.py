"""Starts where what is allowed repeats, every day say: from one sample to the next the time of day goes on evenly.

The relaxation says how much each time of day weighs, not on which day, and on random days little cancels. A rotation,
sample j at the quantile (offset + j step) mod 1 of those weights, sees each time of day as often as it weighs, and
sums over most frequencies cancel: of some hundred steps the best are kept. Of the very best, two samples then
exchange their times of day as long as that sees more.
"""

from __future__ import annotations

import numpy as np

from sampling_design.design.bounds.relaxation import Relaxation
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.design.search.fedorov_exchange import is_admissible, repaired
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget

_OFFSETS = 4  # by which a rotation begins, in quarters of a turn
_STEPS, _MOST_STEPS = 6000, 200  # steps times samples that are looked at, and steps at most
_SWAPS, _ROUNDS = 15000, 3  # exchanges times samples that are looked at in a round, and rounds at most
_BATCH = 40  # schedules that are judged between two looks at the clock
_GAIN = 1e-6  # relative, of sigma^2: less is no gain, and two schedules of one sigma are mostly one, moved by days
_TINY = 1e-12  # of the period: rounding in a time that is shifted


def rotated(
    problem: DesignProblem,
    found: Relaxation,
    count: int,
    share: float = 1.0,
    budget: Budget = ENDLESS,
    finer: float = 1.0,
) -> list[Array]:
    """The `count` best admissible rotations, of which no two are alike; `share` of the usual number is looked at.

    The number of steps is `finer` times the usual one. Those that were looked at by the
    `budget`.
    """
    k = problem.samples
    steps = int(np.clip(_STEPS * share / k, _OFFSETS, _MOST_STEPS) * finer)
    wanted = [(step, offset) for step in np.arange(steps) / steps for offset in np.arange(_OFFSETS) / _OFFSETS]
    drawn = _rotations(problem, found, np.array(wanted))
    pool, values = _judged(problem, drawn, budget)
    new = np.append(True, np.diff(values) < -_GAIN * values[:-1])[: values.size]
    best = list(pool[new][:count])
    return [_swapped(problem, best[0], float(values[0]), share, budget), *best[1:]] if best else []


def _rotations(problem: DesignProblem, found: Relaxation, wanted: Array) -> list[Array]:
    """Schedules of the steps and offsets that are `wanted` (m, 2), near admissible ones."""
    shift, k = problem.least_shift, problem.samples
    order = np.argsort(np.mod(found.times, shift), kind="stable")
    place, total = np.mod(found.times, shift)[order], np.cumsum(found.weights[order])
    j = np.arange(k)
    day = np.floor(j * (round(problem.period / shift) / k)) * shift
    drawn = []
    for step, offset in wanted:
        at = np.searchsorted(total, np.mod(step * j + offset, 1.0) * total[-1])
        drawn.append(day + place[np.minimum(at, place.size - 1)])
    return drawn


def _swapped(problem: DesignProblem, times: Array, value: float, share: float, budget: Budget) -> Array:
    """The schedule after exchanges of two samples' times of day, each the one of all that gains most."""
    shift, k = problem.least_shift, problem.samples
    apart = int(min(_SWAPS * share / k**2, k // 2))
    pairs = [(i, (i + d) % k) for d in range(1, apart + 1) for i in range(k)]
    for _ in range(_ROUNDS):
        drawn = [_swap(times, shift, i, other) for i, other in pairs]
        pool, values = _judged(problem, drawn, budget)
        if not values.size or values[0] <= value * (1 + _GAIN):
            break
        times, value = pool[0], float(values[0])
    return times


def exchanged_hours(problem: DesignProblem, times: Array, i: int, other: int) -> Array | None:
    """The schedule after an exchange of the times of day of two samples; None where it does not fit."""
    found = _admitted(problem, [_swap(times, problem.least_shift, i, other)])
    return found[0] if found else None


def _swap(times: Array, shift: float, i: int, other: int) -> Array:
    day = np.floor(times / shift + _TINY) * shift
    hours = times - day
    hours[[i, other]] = hours[[other, i]]
    return day + hours


def _judged(problem: DesignProblem, drawn: list[Array], budget: Budget) -> tuple[Array, Array]:
    """Admissible schedules near those drawn, the best first, and sigma^2 of each; as many as time allows."""
    pool: list[Array] = []
    values = np.zeros(0)
    for low in range(0, len(drawn), _BATCH):
        if budget.over:
            break
        made = _admitted(problem, drawn[low : low + _BATCH])
        pool += made
        if made:
            values = np.append(values, worst_sigma2(problem, np.array(made), inner=0))
    order = np.argsort(-values, kind="stable")
    return np.array(pool).reshape(-1, problem.samples)[order], values[order]


def _admitted(problem: DesignProblem, drawn: list[Array]) -> list[Array]:
    """Admissible schedules near those drawn, where there are any."""
    pool = []
    for each in drawn:
        wished = _opened(problem, np.sort(np.mod(each, problem.period)))
        times = wished if is_admissible(problem, wished) else repaired(problem, wished)
        pool += [times] if times is not None and is_admissible(problem, times) else []
    return pool


def _opened(problem: DesignProblem, times: Array) -> Array:
    """The times, where a shift has rounded one to before an allowed interval, moved to its beginning."""
    begins = problem.intervals[:, 0]
    last = np.searchsorted(begins, times + _TINY * problem.period, side="right") - 1
    return np.maximum(times, begins[np.maximum(last, 0)])
