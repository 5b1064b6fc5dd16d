"""A bad spaced schedule: worst direction and worst times in turn, then Newton off the grid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sampling_design.observability.worst_case.spaced_paths import least_path
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget

_STARTS = 32  # random directions that are descended from, beside those of the basis
_TURNS = 30  # turns of schedule and direction: most end after five
_NEWTON_STEPS = 40  # steps of the refinement, which ends by itself where nothing is gained
_DAMPING = np.append(10.0 ** np.arange(-14.0, 0.5), [4.0, 16.0])  # of the largest curvature: all tried at once
_TIE = 1e-9  # slacks closer than this part of S move together
_LOOKS, _MOST_DIPS = 512, 64  # cells in which dips of one direction are looked for, and how many are followed
_HALVINGS = 52  # of such a cell
_NUMBERS = 2_000_000  # numbers per batch of starts
LEAST_CELLS, _MOST_CELLS = 48, 2048  # cells of the slack, where states turn slowly and where fast


class AttainedSchedule(NamedTuple):
    """A schedule (its slacks), its sigma, and the unit state that it sees least."""

    sigma: float
    slacks: Array
    direction: Array


def worst_of(rows: SpacedRows, slacks: Array) -> AttainedSchedule:
    """The worst of the schedules (B, k)."""
    sigma, direction = _weakest(rows.observed(slacks))
    best = int(np.argmin(sigma))
    return AttainedSchedule(float(sigma[best]), slacks[best], direction[best])


def search_worst(rows: SpacedRows, rng: np.random.Generator, seconds: float = np.inf) -> AttainedSchedule:
    """Alternate from many directions on a grid, then polish the worst few different schedules off it.

    After `seconds` no further turn begins.
    """
    budget = Budget(seconds)
    basis, inverse = rows.coordinates()
    speed = float(np.linalg.norm(inverse @ rows.A @ basis, 2))
    cells = int(np.clip(2 ** np.ceil(np.log2(max(4 * rows.slack * speed, 1.0))), LEAST_CELLS, _MOST_CELLS))
    slacks, times = rows.grid(cells)
    table = rows.at(times).reshape(-1, rows.n)
    starts = max(4, min(_STARTS, _NUMBERS // table.shape[0]))
    directions = np.vstack([basis.T, rng.standard_normal((starts, rows.n)) @ basis.T])
    found = _alternate(rows, slacks, table, directions, budget)
    if rows.spacing < rows.slack / cells:  # clusters are narrower than the grid: where it puts two of them says nothing
        found = np.vstack([found, *(_clustered(rows, x) for x in directions if not budget.over)])
    sigma, _ = _weakest(rows.observed(found))
    order = np.argsort(sigma, kind="stable")[:3]
    polished = [polish(rows, found[i], rows.slack / cells, budget) for i in order]
    return min(polished, key=lambda a: a.sigma)


def search_from(rows: SpacedRows, direction: Array, cells: int) -> AttainedSchedule:
    """Alternate from one direction on a grid of `cells`, then polish."""
    slacks, times = rows.grid(cells)
    found = _alternate(rows, slacks, rows.at(times).reshape(-1, rows.n), direction[None])
    return polish(rows, found[0], rows.slack / cells)


def polish(rows: SpacedRows, slacks: Array, step: float, budget: Budget = ENDLESS) -> AttainedSchedule:
    """Improve one schedule off the grid: alternation on shrinking local grids, then Newton on what is free."""
    best, tight = worst_of(rows, slacks[None]), rows.spacing < step
    for _ in range(_TURNS):
        if budget.over:
            return best
        near = (best.slacks[:, None] + step * np.linspace(-1, 1, 9)).ravel()
        far = _dips(rows, best.direction) if tight else best.slacks  # what the grid has not resolved may be elsewhere
        local = np.unique(np.clip(np.append(near, far), 0.0, rows.slack))
        outputs = rows.at(rows.times(local[:, None])) @ best.direction
        path = least_path(np.sum(outputs**2, axis=-1).T[None])[0]
        trial = worst_of(rows, local[path][None])
        if trial.sigma < best.sigma * (1 - 1e-6):
            best = trial
        else:
            step /= 4
            if step < 1e-4 * rows.slack:
                break
    return _newton(rows, best, budget)


def _clustered(rows: SpacedRows, direction: Array) -> Array:
    """The worst schedule (1, k) for a direction with all samples around its dips; none (0, k) where it has none."""
    slacks = np.unique(_dips(rows, direction))
    if not slacks.size:
        return np.zeros((0, rows.count))
    outputs = rows.at(rows.times(slacks[:, None])) @ direction
    return slacks[least_path(np.sum(outputs**2, axis=-1).T[None])]


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
    return np.asarray(np.sum((state @ rows.C.T) * (state @ (rows.C @ rows.A).T), axis=1))


def _weakest(observed: Array) -> tuple[Array, Array]:
    """Sigma_n and the right singular vector of matrices (B, N, n)."""
    n = observed.shape[-1]
    _, singular, right = np.linalg.svd(observed, full_matrices=observed.shape[1] < n)
    sigma = singular[:, n - 1] if observed.shape[1] >= n else np.zeros(observed.shape[0])
    return sigma, right[:, n - 1]


def _alternate(rows: SpacedRows, slacks: Array, table: Array, directions: Array, budget: Budget = ENDLESS) -> Array:
    """Schedules (B, k) on a grid: from each direction its worst times, from these their worst direction, in turn."""
    count, last = directions.shape[0], np.full(directions.shape[0], np.inf)
    for _ in range(_TURNS):
        outputs = (table @ directions.T).reshape(rows.count, slacks.size, rows.p, count)
        found = slacks[least_path(np.moveaxis(np.sum(outputs**2, axis=2), 2, 0))]
        sigma, directions = _weakest(rows.observed(found))
        if np.all(sigma >= last * (1 - 1e-6)) or budget.over:
            break
        last = sigma
    return found


def _newton(rows: SpacedRows, best: AttainedSchedule, budget: Budget) -> AttainedSchedule:
    """Newton on lambda = sigma^2 over the samples that no constraint holds; ties move together."""
    tie = _TIE * rows.slack
    for _ in range(_NEWTON_STEPS):
        if budget.over:
            break
        u = best.slacks
        group = np.concatenate([[0], np.cumsum(np.diff(u) > tie)])
        first, last = u[0] <= tie, u[-1] >= rows.slack - tie
        free = [g for g in range(group[-1] + 1) if not (first and g == 0) and not (last and g == group[-1])]
        if not free:
            break
        together = (group[:, None] == np.array(free)).astype(float)
        gradient, hessian = _derivatives(rows, best)
        gradient, hessian = together.T @ gradient, together.T @ hessian @ together
        values, vectors = np.linalg.eigh(hessian)
        damping = max(float(np.max(np.abs(values))), 1e-300) * _DAMPING[:, None]
        step = -((vectors.T @ gradient) / (np.abs(values) + damping)) @ vectors.T
        trial = u + step @ together.T
        trial = np.maximum.accumulate(np.clip(trial, 0.0, rows.slack), axis=1)
        better = worst_of(rows, trial)
        if not better.sigma < best.sigma * (1 - 1e-12):
            break
        best = better
    return best


def _derivatives(rows: SpacedRows, at: AttainedSchedule) -> tuple[Array, Array]:
    """Gradient (k,) and Hessian (k, k) of lambda_min(O'O) with respect to the sample times."""
    here = rows.at(rows.times(at.slacks))
    _, singular, right = np.linalg.svd(here.reshape(-1, rows.n), full_matrices=True)
    level = np.zeros(rows.n)
    level[: singular.size] = singular**2
    y, dy, ddy = (m @ right.T for m in (here, here @ rows.A, here @ rows.A @ rows.A))
    x = rows.n - 1
    gradient = 2 * np.sum(y[..., x] * dy[..., x], axis=1)
    # d(lambda)/dt_i of x'G_i y between the weakest direction and each other one
    mixed = np.sum(dy[..., x, None] * y + y[..., x, None] * dy, axis=1)[:, :x]
    gap = np.maximum(level[:x] - level[x], 1e-12 * max(float(level[0]), 1e-300))
    hessian = np.diag(2 * np.sum(dy[..., x] ** 2 + y[..., x] * ddy[..., x], axis=1)) - 2 * (mixed / gap) @ mixed.T
    return gradient, hessian
