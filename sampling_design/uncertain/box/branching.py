"""BoxCells of a box, halved until the bracket of the least value over all of them closes."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import optimize

from sampling_design.numerics.branch_and_bound import LeastOverCells, within
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import Budget, Progress
from sampling_design.uncertain.box.expansion import BoxCells

Judge = Callable[[BoxCells], tuple[Array, Array, Array]]
Value = Callable[[Array, float, int], float]
IsUnobservable = Callable[[Array, float, int], bool]

MOST_CELLS = 100_000  # cells after which a search without a budget ends as well
TOGETHER = 512  # cells judged in one batch
FIRST_TOGETHER = 4  # and in the first one of each round where seconds count; each is twice the one before
UNOBSERVABLE = 1e-8
"""What this share of the outputs shows at most, in balanced coordinates, counts as unobserved where a descent ends."""
DESCENTS = 3  # rounds between two descents
STEPS = 400
BALL_ROOM = 1.001
"""Of the tolerance: how much of it a bracket may be open, what balls give away included."""


REASONS = {
    "budget": "the budget ran out before the bracket closed; more time, or a smaller box, narrows it",
    "interrupted": "the search was interrupted before the bracket closed",
    "rounding": "rounding keeps the bracket open; scale the plant",
}


class BoxBounds(NamedTuple):
    """Lower and attained bound, where it is attained (u, window start, piece), why it ended, and the cells judged."""

    lower: float
    upper: float
    u: Array
    s: float
    piece: int
    status: str
    cells: int


def branch(
    start: BoxCells,
    judge: Judge,
    value: Value | None,
    is_unobservable: IsUnobservable,
    rtol: float,
    seconds: float,
    ends: tuple[Array, Array],
    progress: Progress | None,
) -> BoxBounds:
    """Halve cells until lower >= (1 - rtol) upper; `value` is exact at one point, `is_unobservable`: zero sigma.

    Without `value` the centres of cells alone are met.
    """
    best = (np.inf, start.u[0], float(start.s[0]), int(start.piece[0]))
    rounds, clock = 0, Budget(seconds)

    def judged(cells: BoxCells) -> tuple[Array, Array] | None:
        nonlocal best, rounds
        lower, centre, effect = judged_in_time(cells, judge, clock)
        k = int(np.argmin(centre))
        if centre[k] < best[0]:
            best = (float(centre[k]), cells.u[k], float(cells.s[k]), int(cells.piece[k]))
        if value is not None and rounds % DESCENTS == 0:
            best = descended(best, value, ends, clock)
        rounds += 1
        search.attain(np.array([best[0]]))
        return None if is_unobservable(*best[1:]) else (lower[:, None], effect)

    def look() -> bool:
        if progress is not None and rounds:
            progress(min(0.95, (rounds - 1) / 40), f"{len(search.bound)} cells of the box open")
        return False

    search = LeastOverCells(
        start, np.zeros((len(start.s), 1)), within(rtol), clock, together=MOST_CELLS, most=MOST_CELLS
    )
    status = search.run(judged, bisected, look)
    if value is not None and status != "interrupted":
        best = descended(best, value, ends, clock)
    if status == "stopped":
        return BoxBounds(0.0, *best, "unobservable", search.judged)
    lower = min(float(search.lower[0]), best[0])
    if status == "closed" and not lower >= (1 - BALL_ROOM * rtol) * best[0]:
        status = "rounding"
    return BoxBounds(lower, *best, status, search.judged)


def judged_in_time(cells: BoxCells, judge: Judge, clock: Budget) -> tuple[Array, Array, Array]:
    """What `judge` says of cells, of few at first; those for which there is no time are bounded by nothing."""
    count, m = cells.u.shape
    lower, centre, effect = np.zeros(count), np.full(count, np.inf), np.ones((count, m + 1))
    begin, together = 0, FIRST_TOGETHER if np.isfinite(clock.left) else TOGETHER
    while begin < count and not (begin and clock.over):
        some = np.arange(begin, min(begin + together, count))
        lower[some], centre[some], effect[some] = judge(cells.take(some))
        begin, together = begin + together, min(2 * together, TOGETHER)
    return lower, centre, effect


def bisected(cells: BoxCells, effect: Array) -> tuple[BoxCells, Index]:
    """Both halves of each cell, and whose they are."""
    return halved(cells, effect), np.tile(np.arange(len(effect)), 2)


def halved(cells: BoxCells, effect: Array) -> BoxCells:
    """Both halves of each cell, along the direction that matters most."""
    m = cells.u.shape[1]
    movable = np.column_stack([cells.half > 0, cells.h > 0])
    side = np.argmax(np.where(movable, np.where(np.isfinite(effect), effect, 1e300), -1.0), axis=1)
    rows, along = np.arange(len(side)), side < m
    parts = []
    for sign in (-1.0, 1.0):
        u, half, s, h = cells.u.copy(), cells.half.copy(), cells.s.copy(), cells.h.copy()
        at = (rows[along], side[along])
        half[at] /= 2
        u[at] += sign * half[at]
        h[~along] /= 2
        s[~along] += sign * h[~along]
        parts.append(BoxCells(u, half, s, h, cells.piece))
    return parts[0].joined(parts[1])


def least_near(value: Callable[[Array], float], x: Array, bounds: list[tuple[float, float]], most: int) -> Array:
    """Where a descent without derivatives ends, from a small simplex at x, after so many values at most."""
    simplex = np.vstack([x, x + np.diag(np.where(x > 0, -0.05, 0.05))])
    options = {"maxfev": most, "xatol": 1e-13, "fatol": 0.0, "initial_simplex": simplex}
    return np.asarray(optimize.minimize(value, x, method="Nelder-Mead", bounds=bounds, options=options).x)


def descended(
    best: tuple[float, Array, float, int], value: Value, ends: tuple[Array, Array], clock: Budget
) -> tuple[float, Array, float, int]:
    """The best point after a descent without derivatives, inside of the box and its piece, as far as there is time."""
    _, u, s, piece = best
    left, right = float(ends[0][piece]), float(ends[1][piece])
    bounds = [(-1.0, 1.0)] * len(u) + ([(0.0, 1.0)] if right > left else [])
    if not bounds or clock.over:
        return best
    span = right - left

    def at(x: Array) -> tuple[Array, float]:
        x = np.clip(x, [b[0] for b in bounds], [b[1] for b in bounds])
        return x[: len(u)], min(max(left + span * float(x[-1]), left), right) if span > 0 else s

    x0 = np.clip(np.append(u, (s - left) / span) if span > 0 else u, [b[0] for b in bounds], [b[1] for b in bounds])
    u_new, s_new = at(least_near(lambda x: np.inf if clock.over else value(*at(x), piece), x0, bounds, STEPS))
    reached = value(u_new, s_new, piece)
    return (reached, u_new, s_new, piece) if reached < best[0] else best
