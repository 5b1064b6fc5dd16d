"""Cells of a box, halved until the bracket of the least value over all of them closes; of each the least sigma.

That is a lower bound of every plant and position in a cell. With O(d) = O_0 + sum d_k O_k + X, |d_k| <= 1, and
G_0 = O_0'O_0 = S'S:

    O'O >= (1 - t) (G_0 + sum d_k (O_0'O_k + O_k'O_0)) - (1/t - 1) X'X,

since the square of the first order is no loss. The right side is linear in d: its corners decide. A window that begins
s later sees |O e^{A s} x|, and |x| is convex in s to first order: its ends decide, whatever the condition of O.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import optimize

from sampling_design.numerics.branch_and_bound import LeastOverCells, within
from sampling_design.numerics.linalg import right_directions
from sampling_design.records.arrays import Array, Complex, Index, Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.uncertain.box.model import BoxCells, BoxModel, expanded, signs

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


MOST_CORNERS = 6
"""Directions of a cell up to which all its corners are tried; beyond it every direction counts with its size."""
ROUNDING = 64 * float(np.finfo(float).eps)  # of sums of a few products, relative; times the number of rows and states
LEAST_SHARE = 1e-3  # of the weights of two rests, however small one is
LARGEST = 1e60  # a rest beyond it proves nothing


def least_sigma(
    model: BoxModel, cells: BoxCells, times: Array, measured: Mask, late: float
) -> tuple[Array, Array, Array]:
    """Of each cell: a proven lower bound of sigma, sigma at its centre, and how much parameters and position matter.

    For samples up to `late` early or late, of the centre the bound of it alone: what smaller cells lead to.
    """
    found = expanded(model, cells, times, measured, late)
    K, R, n = found.rows.shape
    if n > R:
        return np.zeros(K), np.zeros(K), np.ones((K, model.m + 1))
    Q, S = np.linalg.qr(found.rows)
    diagonal = np.abs(np.einsum("kii->ki", S))
    sound = (diagonal > 0).all(axis=1) & np.isfinite(found.slopes).all(axis=(1, 2, 3))
    S = np.where(sound[:, None, None], S, np.eye(n))
    back = np.linalg.solve(S, np.broadcast_to(np.eye(n), S.shape))
    unit = model.unit[:, None] * back
    turn = cells.h[:, None, None] * (model.unit[:, None] * (found.A @ back))
    centre = np.where(sound, 1 / np.linalg.norm(unit, 2, axis=(1, 2)), 0.0)
    turned = np.swapaxes(Q, 1, 2)[:, None] @ np.where(sound[:, None, None, None], found.slopes, 0.0) @ back[:, None]
    H = turned + np.swapaxes(turned, 2, 3)
    effect = np.linalg.norm(H, axis=(2, 3))
    moved = np.linalg.norm(turn, axis=(1, 2)) / np.linalg.norm(unit, axis=(1, 2))
    rounding = ROUNDING * (R + n) * (1 + effect.sum(axis=1))
    lower, slightest = np.zeros(K), np.full(K, np.inf)
    effect = np.column_stack([effect, moved])
    if found.lost is not None:
        lost = np.swapaxes(back, 1, 2) @ found.lost @ back
        fine = sound & (np.abs(lost).max(axis=(1, 2), initial=0.0) < LARGEST)
        lost = np.where(fine[:, None, None], lost, 0.0)
        alone = _lower(H[:, :0], lost, (unit, 0 * turn, 0 * unit), ROUNDING * (R + n) * np.ones(K))
        centre = np.where(fine, alone, 0.0)
    whole = effect
    for rest in found.rest:
        with np.errstate(over="ignore", invalid="ignore"):
            N = np.swapaxes(back, 1, 2) @ rest.N @ back
            N = N if found.lost is None else _together(N, lost)
            beyond = rest.beyond[:, None, None] * (rest.inverse @ back)
            worth = np.abs(beyond).max(axis=(1, 2), initial=0.0) / np.linalg.norm(unit, axis=(1, 2))
            worth = worth + np.einsum("kii->k", np.abs(N))
        close = sound & (worth < LARGEST)
        whole = np.where((worth < slightest)[:, None], effect + rest.effect, whole)
        slightest = np.fmin(slightest, worth)
        if close.any():
            k = np.flatnonzero(close)
            reached = _lower(H[k], N[k], (unit[k], turn[k], beyond[k]), rounding[k])
            lower[k] = np.maximum(lower[k], np.where(np.isfinite(reached), reached, 0.0))
    return np.minimum(lower, centre), centre, whole


def _together(one: Array, other: Array) -> Array:
    """What bounds |(X + E) z|^2 where X'X is at most the one (K, n, n) and E'E the other: weights by their size."""
    sizes = np.sqrt(np.maximum([np.trace(N, axis1=1, axis2=2) for N in (one, other)], np.finfo(float).tiny))
    share = np.clip(sizes[0] / sizes.sum(axis=0), LEAST_SHARE, 1 - LEAST_SHARE)[:, None, None]
    return np.asarray(one / share + other / (1 - share))


def _lower(H: Array, N: Array, window: tuple[Array, Array, Array | Complex], rounding: Array) -> Array:
    """The least sigma over the corners of I + sum +-H_k, the rest N taken off, and over both ends of the positions."""
    (K, m, n, _), (unit, turn, beyond) = H.shape, window
    eye = np.eye(n)
    if m <= MOST_CORNERS:
        corners = eye + np.einsum("cj,kjab->kcab", signs(m), H)
    else:
        values, vectors = np.linalg.eigh(H)
        sizes = (vectors * np.abs(values)[..., None, :]) @ np.swapaxes(vectors, 2, 3)
        corners = (eye - sizes.sum(axis=1))[:, None]
    worst = _worst(corners, unit)
    share = np.einsum("ka,kab,kb->k", worst, N, worst)
    t = np.clip(np.sqrt(np.clip(share, 0.0, 1.0)), 1e-12, 1 - 1e-12)
    less = (1 - t - rounding)[:, None, None, None] * corners - ((1 / t - 1)[:, None, None] * N)[:, None]
    values, vectors = np.linalg.eigh(less - 2 * rounding[:, None, None, None] * eye)
    positive = (values[..., 0] > 0).all(axis=1)
    root = vectors / np.sqrt(np.maximum(values, 1e-300))[..., None, :]  # less^-1 = root root'
    far = np.zeros(K)
    for sign in (-1.0, 1.0):
        far = np.maximum(far, np.linalg.norm((unit + sign * turn)[:, None] @ root, 2, axis=(2, 3)).max(axis=1))
    far = far + np.linalg.norm(beyond[:, None] @ root, 2, axis=(2, 3)).max(axis=1)
    return np.where(positive, 1 / (far * (1 + ROUNDING * n)), 0.0)


def _worst(M: Array, unit: Array) -> Array:
    """Of each stack the u, u'Mu = 1, that `unit` makes largest over all corners; zero where some M is not positive."""
    values, vectors = np.linalg.eigh(M)
    positive = np.asarray((values[..., 0] > 0).all(axis=1))
    root = vectors / np.sqrt(np.maximum(values, 1e-300))[..., None, :]
    s, right = right_directions(unit[:, None] @ root)
    k, rows = np.argmax(s[..., 0], axis=1), np.arange(len(M))
    found = np.einsum("kab,kb->ka", root[rows, k], right[rows, k, 0])
    return np.where(positive[:, None], found, 0.0)
