"""Continuous refinement: all times move at once, by a sequence of small semidefinite programs.

At the best schedule several eigenvalues of several windows tie, and a gradient of the least one says
little. Linearising whole Gram matrices, W_m + sum ds_i dW_m/ds_i >= t I, sees all of them.
"""

from __future__ import annotations

import numpy as np

from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import lags
from sampling_design.design.problem.positions import WindowPositions, positions, window_grams, worst_sigma2
from sampling_design.design.search.fedorov_exchange import is_admissible
from sampling_design.numerics import conic_programs
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import ENDLESS, Budget

_KEPT = 3.0  # windows whose sigma^2 exceeds this times the least one cannot become worst in a trusted step
_MOST_WINDOWS = 20  # the worst ones; a step that forgets another one is refused by the evaluation after it
_GAIN = 1e-10  # relative: moves for less than rounding only spoil times that are exact
_SUBSPACE = 4  # directions per window, the least seen ones: a larger inequality costs far more and says little more


def refined(
    problem: DesignProblem, times: Array, sigma2: float, steps: int = 25, budget: Budget = ENDLESS
) -> tuple[Array, float]:
    """Improve sorted admissible times until `budget`; a step is kept only if the worst sigma^2 grows."""
    trust = problem.period / (4 * problem.samples)
    for _ in range(steps):
        if budget.over:
            break
        move = _step(problem, times, sigma2, trust, budget)
        if move is None:
            return times, sigma2
        gained = False
        for share in (1.0, 0.4, 0.1):
            trial = times + share * move
            wrapped = np.sort(np.mod(trial, problem.period))
            for t in problem.fixed:  # to the last bit
                wrapped[np.argmin(np.abs(wrapped - t))] = t
            if not is_admissible(problem, wrapped):
                continue
            value = float(worst_sigma2(problem, wrapped[None, :])[0])
            if value > sigma2 * (1 + _GAIN):
                gained = True
                small = value <= sigma2 * (1 + 1e-7)
                times, sigma2 = wrapped, value
                trust = min(trust * (1.6 if share == 1.0 else share), problem.period / 4)
                break
        if not gained:
            trust /= 12
        if trust < 1e-8 * problem.period or (gained and small):
            break
    return times, sigma2


def _step(problem: DesignProblem, times: Array, sigma2: float, trust: float, budget: Budget) -> Array | None:
    """The move within `trust` that maximises the least eigenvalue of the linearised windows."""
    rows = problem.rows
    where = positions(problem, times[None, :])
    grams = window_grams(problem, times[None, :], where)[0]
    values, _ = rows.least(grams)
    kept = np.argsort(values, kind="stable")[:_MOST_WINDOWS]
    kept = kept[values[kept] <= _KEPT * max(sigma2, float(values[kept[0]]), 1e-300)]
    V = rows.least_observable(grams[kept], _SUBSPACE)
    W, roof = np.swapaxes(V, 1, 2) @ grams[kept] @ V, np.swapaxes(V, 1, 2) @ rows.N @ V
    unit = max(float(np.trace(W, axis1=1, axis2=2).max()), 1e-300)
    slopes = _slopes(problem, times, where, kept, V)
    blocks: list[tuple[str, Array, Array]] = [("nonnegative", *_limits(problem, times, trust))]
    for place in range(kept.size):
        D = conic_programs.svec(slopes[place]).T * (trust / unit)
        blocks.append(
            ("psd", np.hstack([-D, conic_programs.svec(roof[place])[:, None]]), conic_programs.svec(W[place]) / unit)
        )
    cost = np.zeros(times.size + 1)
    cost[-1] = -1.0
    left = budget.left
    seconds = left if np.isfinite(left) else None
    found = conic_programs.solve_cone_program(
        cost, blocks, tolerance=1e-6, iterations=60, budget=seconds, refined=False
    )
    if not conic_programs.usable(found.record) or not np.all(np.isfinite(found.x)):
        return None
    move = np.asarray(found.x[:-1] * trust)
    move[np.isin(times, problem.fixed)] = 0.0
    return move


def _slopes(problem: DesignProblem, times: Array, where: WindowPositions, kept: Index, V: Array) -> Array:
    """Derivatives (m, k, q, q) of the kept windows' Gram matrices, seen in the directions V, by each sample time.

    A lag is sample minus window start, and the start moves with the two events beside it.
    """
    rows, k, n = problem.rows, times.size, problem.plant.n_states
    result = np.zeros((kept.size, k, V.shape[-1], V.shape[-1]))
    mask = problem.measured(times)
    for place, m in enumerate(kept):
        r, inside = lags(times, where.at[0, m], problem.window, problem.period, bool(where.left[m]))
        c = rows.rows(r) * (inside[..., None] & mask[:, None, :])[..., None]
        c = c.reshape(k, -1, n)
        half = np.swapaxes(c @ V[place], -1, -2) @ (c @ (rows.A @ V[place]))
        D = half + np.swapaxes(half, -1, -2)
        result[place] = D
        total = D.sum(axis=0)
        share = where.share[m]
        result[place, where.first[0, m]] -= (1 - share) * total
        result[place, where.second[0, m]] -= share * total
    return result


def _limits(problem: DesignProblem, times: Array, trust: float) -> tuple[Array, Array]:
    """Rows of A, b in A move <= b (moves in units of `trust`): spacing, trust, fixed times, allowed intervals."""
    k, period = times.size, problem.period
    gap = problem.gap
    eye = np.eye(k)
    apart = eye - np.roll(eye, -1, axis=0)  # s_i - s_{i+1} <= distance - gap
    distance = np.diff(np.append(times, times[0] + period))
    free = np.where(np.isin(times, problem.fixed), 0.0, 1.0)
    rows, bounds = [eye, -eye], [free, free]
    if k > 1:
        rows.append(apart)
        bounds.append(np.maximum(distance - gap, 0.0) / trust)
    if not problem.is_shift_invariant:
        edges = problem.breakpoints
        place = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, edges.size - 2)
        tiny = 1e-9 * period
        bounds[0] = np.minimum(bounds[0], np.maximum(edges[place + 1] - tiny - times, 0.0) / trust)
        bounds[1] = np.minimum(bounds[1], np.maximum(times - edges[place], 0.0) / trust)
    A = np.hstack([np.vstack(rows), np.zeros((k * len(rows), 1))])
    return A, np.concatenate(bounds)
