"""A bad spaced schedule: worst direction and worst times in turn, then Newton off the grid.

Least sums along non-decreasing grid paths: dynamic programming, many problems at once.

A schedule with k samples at least `spacing` apart is tau_i = u_i + (i - 1) spacing with slacks
0 <= u_1 <= ... <= u_k <= S. In slacks the spacing is gone: what is left is the order, and the best
order-preserving path through k rows of costs is a running minimum per row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sampling_design.numerics.linalg import right_directions
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.records.arrays import Array, Integers
from sampling_design.records.budget import ENDLESS, Budget

_FEW = 128  # numbers below which a step of one's own costs more than numpy's accumulation of them


def least_path(cost: Array) -> Integers:
    """Return for each of B problems the non-decreasing path (B, k) of least sum through `cost` (B, k, N)."""
    length = cost.shape[2]
    total, choices = cost[:, 0], []
    for i in range(1, cost.shape[1]):
        running = np.minimum.accumulate(total, axis=1)
        choices.append(np.maximum.accumulate(np.where(total <= running, np.arange(length), 0), axis=1))
        total = cost[:, i] + running
    path = [np.argmin(total, axis=1)]
    for choice in reversed(choices):
        path.append(np.take_along_axis(choice, path[-1][:, None], axis=1)[:, 0])
    return np.stack(path[::-1], axis=1)


def sums_so_far(cost: Array, start: Integers) -> Array:
    """Return the least sum of a path that ends at each point, its own cost included.

    Parameters
    ----------
    cost : (k, W, B, c) array
        c problems for each of B sets of windows; point w of row i is grid point start[b, i] + w. The points come
        first, so that every step is one over all problems.
    start : (B, k) array
        Where the windows begin, non-decreasing along i.
    """
    total = np.empty_like(cost)
    total[0] = cost[0]
    for i in range(1, len(cost)):
        np.add(cost[i], _shifted(so_far(total[i - 1], np.minimum), start[:, i] - start[:, i - 1]), out=total[i])
    return total


def sums_to_go(cost: Array, start: Integers, end: Array | float = 0.0) -> Array:
    """Return the least sum of a path that begins at each point, its own cost left out; shapes as for `sums_so_far`.

    `end` (W, B, c) is what ending at each point of the last row costs besides.
    """
    total = np.zeros_like(cost)
    total[-1] += end
    for i in range(len(cost) - 2, -1, -1):
        running = so_far((cost[i + 1] + total[i + 1])[::-1], np.minimum)[::-1]
        total[i] = _shifted(running, start[:, i] - start[:, i + 1])
    return total


def so_far(values: Array, take: np.ufunc) -> Array:
    """The running `take`, np.minimum or np.maximum, of `values` along their first axis."""
    if values[0].size < _FEW:
        return np.asarray(take.accumulate(values, axis=0))
    found = np.empty_like(values)
    found[0] = values[0]
    for w in range(1, len(values)):
        take(found[w - 1], values[w], out=found[w])
    return found


def _shifted(values: Array, shift: Integers) -> Array:
    """`values` (W, B, c) read at w + shift[b], held constant beyond the ends (a running minimum is constant there)."""
    if not shift.any():
        return values
    width, sets, problems = values.shape
    place = np.clip(np.arange(width)[:, None] + shift, 0, width - 1) * sets + np.arange(sets)
    return np.asarray(np.take(values.reshape(-1, problems), place, axis=0))


_STARTS = 32  # random directions that are descended from, beside those of the basis
_TURNS = 30  # turns of schedule and direction: most end after five
_NEWTON_STEPS = 40  # steps of the refinement, which ends by itself where nothing is gained
_DAMPING = np.append(10.0 ** np.arange(-14.0, 0.5), [4.0, 16.0])  # of the largest curvature: all tried at once
_TIE = 1e-9  # slacks closer than this part of S move together
_LOOKS, _MOST_DIPS = 512, 64  # cells in which dips of one direction are looked for, and how many are followed
_HALVINGS = 52  # of such a cell
_NUMBERS = 2_000_000  # numbers per batch of starts
LEAST_CELLS, _MOST_CELLS = 48, 2048  # cells of the slack, where states turn slowly and where fast
_TABLE = 8_000_000  # numbers in the table of all rows at these cells, beyond which they are as many as that allows
MOVES = 8  # cells of the moves of readings
_SETTLED = 12  # times that these are cut, to a quarter each
_AGAIN = 4  # turns of schedule and moves in the refinement
_STILL = np.zeros((1, 1))


class AttainedSchedule(NamedTuple):
    """A schedule (its slacks), its sigma, the unit state that it sees least, and the moves of its readings (k, G)."""

    sigma: float
    slacks: Array
    direction: Array
    moves: Array = _STILL


def worst_of(rows: SpacedRows, slacks: Array, moves: Array = _STILL) -> AttainedSchedule:
    """The worst of the schedules (B, k), with moves (B, k, G) or one set of them for all."""
    sigma, direction = _weakest(rows.observed(slacks, moves))
    best = int(np.argmin(sigma))
    own = np.broadcast_to(moves, (*slacks.shape, len(rows.groups)))[best]
    return AttainedSchedule(float(sigma[best]), slacks[best], direction[best], own)


def search_worst(rows: SpacedRows, rng: np.random.Generator, seconds: float = np.inf) -> AttainedSchedule:
    """Alternate from many directions on a grid, then polish the worst few different schedules off it.

    After `seconds` no further turn begins.
    """
    budget = Budget(seconds)
    basis, inverse = rows.coordinates()
    speed = float(np.linalg.norm(inverse @ rows.A @ basis, 2))
    cells = int(np.clip(2 ** np.ceil(np.log2(max(4 * rows.slack * speed, 1.0))), LEAST_CELLS, _MOST_CELLS))
    each = len(rows.offsets) * sum((MOVES + 1 if rows.moving else 1) * group.C.size for group in rows.groups)
    cells = min(cells, max(LEAST_CELLS, 2 ** int(np.log2(max(_TABLE / each, 1.0)))))
    slacks, times = rows.grid(cells)
    table = rows.moved(times, MOVES)
    starts = max(4, min(_STARTS, _NUMBERS // (sum(part.size for part in table) // rows.n)))
    directions = np.vstack([basis.T, rng.standard_normal((starts, rows.n)) @ basis.T])
    found, moves = _alternate(rows, slacks, table, directions, budget)
    if rows.spacing < rows.slack / cells:  # clusters are narrower than the grid: where it puts two of them says nothing
        more = [_clustered(rows, x) for x in directions if not budget.over]
        found = np.vstack([found, *(each for each, _ in more)])
        moves = np.concatenate([moves, *(each for _, each in more)])
    sigma, _ = _weakest(rows.observed(found, moves))
    order = np.argsort(sigma, kind="stable")[:3]
    polished = [polish(rows, found[i], moves[i], rows.slack / cells, budget) for i in order]
    return min(polished, key=lambda a: a.sigma)


def search_from(rows: SpacedRows, direction: Array, cells: int) -> AttainedSchedule:
    """Alternate from one direction on a grid of `cells`, then polish."""
    slacks, times = rows.grid(cells)
    found, moves = _alternate(rows, slacks, rows.moved(times, MOVES), direction[None])
    return polish(rows, found[0], moves[0], rows.slack / cells)


def polish(rows: SpacedRows, slacks: Array, moves: Array, step: float, budget: Budget = ENDLESS) -> AttainedSchedule:
    """Improve one schedule off the grid: alternation on shrinking local grids, then Newton on what is free."""
    best, tight = worst_of(rows, slacks[None], moves[None]), rows.spacing < step
    for _ in range(_TURNS):
        if budget.over:
            return best
        near = (best.slacks[:, None] + step * np.linspace(-1, 1, 9)).ravel()
        far = _dips(rows, best.direction) if tight else best.slacks  # what the grid has not resolved may be elsewhere
        local = np.unique(np.clip(np.append(near, far), 0.0, rows.slack))
        chosen, moves = _least_path(rows, local, best.direction)
        trial = worst_of(rows, chosen, _settled(rows, chosen, moves, best.direction))
        if trial.sigma < best.sigma * (1 - 1e-6):
            best = trial
        else:
            step /= 4
            if step < 1e-4 * rows.slack:
                break
    best = _newton(rows, best, budget)
    for _ in range(_AGAIN if rows.moving else 0):
        moves = _settled(rows, best.slacks[None], best.moves[None], best.direction)
        trial = _newton(rows, worst_of(rows, best.slacks[None], moves), budget)
        if not trial.sigma < best.sigma * (1 - 1e-9):
            break
        best = trial
    return best


def _least_path(rows: SpacedRows, slacks: Array, direction: Array) -> tuple[Array, Array]:
    """The schedule (1, k) of these slacks that sees least of a direction, and its moves (1, k, G)."""
    table = rows.moved(rows.times(slacks[:, None]), MOVES)
    least, moves = rows.least_observed(table, direction[None], MOVES)
    path = least_path(least[..., 0].T[None])
    return slacks[path], moves[path, np.arange(rows.count), 0]


def _settled(rows: SpacedRows, slacks: Array, moves: Array, direction: Array) -> Array:
    """Moves (1, k, G), near these, at which each reading of a schedule (1, k) sees least of a direction."""
    if not rows.moving:
        return moves
    found = moves.copy()
    for g, group in enumerate(rows.groups):
        planned, at = rows.times(slacks)[0] + group.lag, moves[0, :, g]
        for cut in range(_SETTLED if group.radius else 0):
            tried = at[:, None] + 2 * group.radius / MOVES / 4**cut * np.linspace(-1.0, 1.0, 9)
            tried = np.clip(tried, -group.radius, group.radius)
            size = np.sum((rows.read(group, planned[:, None] + tried) @ direction) ** 2, axis=-1)
            at = np.take_along_axis(tried, np.argmin(size, axis=1)[:, None], axis=1)[:, 0]
        found[0, :, g] = at
    return found


def _clustered(rows: SpacedRows, direction: Array) -> tuple[Array, Array]:
    """The worst schedule (1, k) for a direction with all samples around its dips; none (0, k) where it has none."""
    slacks = np.unique(_dips(rows, direction))
    if not slacks.size:
        return np.zeros((0, rows.count)), np.zeros((0, rows.count, len(rows.groups)))
    return _least_path(rows, slacks, direction)


def _dips(rows: SpacedRows, direction: Array) -> Array:
    """Slacks at which samples cluster around a least |C e^{At} x|, to the last digit: no grid meets what is as narrow.

    m samples around t begin at t - (m - 1) epsilon/2, which for the i-th of all is that slack less (i - 1) epsilon.
    """
    edges = np.linspace(0.0, rows.window, _LOOKS + 1)
    slope = _slopes(rows, direction, edges)
    at = np.flatnonzero((slope[:-1] < 0) & (slope[1:] >= 0))[:_MOST_DIPS]
    low, high = edges[at], edges[at + 1]
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        falls = _slopes(rows, direction, middle) < 0
        low, high = np.where(falls, middle, low), np.where(falls, high, middle)
    slacks = (high[:, None] - rows.spacing / 2 * np.arange(2 * rows.count - 1)).ravel()
    return slacks[(slacks >= 0) & (slacks <= rows.slack)]


def _slopes(rows: SpacedRows, direction: Array, times: Array) -> Array:
    """Half the slope of |C e^{At} x|^2."""
    state = rows.plant.transition(times) @ direction
    return np.asarray(np.sum((state @ rows.middle.T) * (state @ (rows.middle @ rows.A).T), axis=1))


def _weakest(observed: Array) -> tuple[Array, Array]:
    """Sigma_n and the right singular vector of matrices (B, N, n)."""
    n = observed.shape[-1]
    singular, right = right_directions(observed)
    sigma = singular[:, n - 1] if observed.shape[1] >= n else np.zeros(observed.shape[0])
    return sigma, right[:, n - 1]


def _alternate(
    rows: SpacedRows, slacks: Array, table: list[Array], directions: Array, budget: Budget = ENDLESS
) -> tuple[Array, Array]:
    """Schedules (B, k) on a grid: from each direction its worst times, from these their worst direction, in turn.

    And their moves (B, k, G).
    """
    which, last = np.arange(directions.shape[0])[:, None], np.full(directions.shape[0], np.inf)
    for _ in range(_TURNS):
        least, moves = rows.least_observed(table, directions, MOVES)
        path = least_path(np.moveaxis(least, 2, 0))
        found, own = slacks[path], moves[np.arange(rows.count), path, which]
        sigma, directions = _weakest(rows.observed(found, own))
        if np.all(sigma >= last * (1 - 1e-6)) or budget.over:
            break
        last = sigma
    return found, own


def _newton(rows: SpacedRows, best: AttainedSchedule, budget: Budget) -> AttainedSchedule:
    """Newton on lambda = sigma^2 over the samples and moves that no constraint holds; ties move together."""
    tie, radii = _TIE * rows.slack, np.array([group.radius for group in rows.groups])
    shape = rows.count, len(rows.groups)
    for _ in range(_NEWTON_STEPS):
        if budget.over:
            break
        u = best.slacks
        group = np.concatenate([[0], np.cumsum(np.diff(u) > tie)])
        first, last = u[0] <= tie, u[-1] >= rows.slack - tie
        free = [g for g in range(group[-1] + 1) if not (first and g == 0) and not (last and g == group[-1])]
        moved = np.eye(rows.count * shape[1])[(np.abs(best.moves) < radii * (1 - _TIE)).ravel()]
        if not free and not len(moved):
            break
        together = (group[:, None] == np.array(free)).astype(float).reshape(rows.count, len(free))
        read = np.hstack([np.repeat(together, shape[1], axis=0), moved.T])  # what each reading's time goes with
        gradient, hessian = _derivatives(rows, best)
        gradient, hessian = read.T @ gradient, read.T @ hessian @ read
        values, vectors = np.linalg.eigh(hessian)
        damping = max(float(np.max(np.abs(values))), 1e-300) * _DAMPING[:, None]
        step = -((vectors.T @ gradient) / (np.abs(values) + damping)) @ vectors.T
        trial = u + step[:, : len(free)] @ together.T
        trial = np.maximum.accumulate(np.clip(trial, 0.0, rows.slack), axis=1)
        moves = best.moves + (step[:, len(free) :] @ moved).reshape(-1, *shape)
        better = worst_of(rows, trial, np.clip(moves, -radii, radii))
        if not better.sigma < best.sigma * (1 - 1e-12):
            break
        best = better
    return best


def _derivatives(rows: SpacedRows, at: AttainedSchedule) -> tuple[Array, Array]:
    """Gradient and Hessian of lambda_min(O'O) with respect to the times of the readings, k G of them."""
    here = rows.at(rows.times(at.slacks), at.moves)
    singular, right = right_directions(here.reshape(-1, rows.n))
    level = np.zeros(rows.n)
    level[: singular.size] = singular**2
    y, dy, ddy = (m @ right.T for m in (here, here @ rows.A, here @ rows.A @ rows.A))
    x, begun = rows.n - 1, np.cumsum([0, *(group.outputs.size for group in rows.groups[:-1])])

    def summed(parts: Array) -> Array:
        return np.asarray(np.add.reduceat(parts, begun, axis=1)).reshape(-1, *parts.shape[2:])

    gradient = 2 * summed(y[..., x] * dy[..., x])
    # d(lambda)/dt_i of x'G_i y between the weakest direction and each other one
    mixed = summed(dy[..., x, None] * y + y[..., x, None] * dy)[:, :x]
    gap = np.maximum(level[:x] - level[x], 1e-12 * max(float(level[0]), 1e-300))
    hessian = np.diag(2 * summed(dy[..., x] ** 2 + y[..., x] * ddy[..., x])) - 2 * (mixed / gap) @ mixed.T
    return gradient, hessian
