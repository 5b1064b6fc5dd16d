"""From weights to schedules: systematic rounding, repair of the spacing, exchange of one time at a time; refinement.

The exchange is Fedorov's, for the worst window's least singular value in place of a determinant: sigma^2 is the least
eigenvalue of the window's information, the criterion that optimal design calls E-optimality.

The refinement moves all times at once, by a sequence of small semidefinite programs. At the best schedule several
eigenvalues of several windows tie, and a gradient of the least one says little. Linearising whole Gram matrices,
W_m + sum ds_i dW_m/ds_i >= t I, sees all of them.

References
----------
Fedorov 1972; Pukelsheim 1993.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from math import isfinite

import numpy as np

from sampling_design.design.bounds.relaxation import Relaxation
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import lags
from sampling_design.design.problem.positions import WindowPositions, positions, window_grams, worst_sigma2
from sampling_design.numerics import conic_programs
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import ENDLESS, Budget

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
    return at_shares(problem, (np.arange(spare) + offset) / max(spare, 1))


def at_shares(problem: DesignProblem, shares: Array) -> Array | None:
    """Free samples at these shares (in [0, 1)) of the allowed time, fixed ones beside them, repaired."""
    lengths = np.diff(problem.intervals, axis=1)[:, 0]
    ends = np.cumsum(lengths)
    marks = shares * ends[-1]
    place = np.minimum(np.searchsorted(ends, marks, side="right"), lengths.size - 1)
    return repaired(problem, np.concatenate([problem.fixed, problem.intervals[place, 1] - (ends[place] - marks)]))


def shares_of(problem: DesignProblem, times: Array) -> Array:
    """The inverse of `at_shares`: at which share of the allowed time each of `times` lies."""
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
    """Admissible times near `times` (fixed ones stay), moved either way; None where none are found.

    The period begins at a sample after one of the widest gaps. Each free sample may go to the nearest allowed time, as
    far as all earlier ones push it later, as far as all later ones push it earlier, or halfway between the two: of
    these the choices that keep the spacing and move all together least, by dynamic programming.
    """
    period, apart = problem.period, (problem.spacing * (1 - 1e-12) + problem.gap) / 2
    t = np.sort(np.mod(times, period))
    for fixed in problem.fixed:
        t = np.delete(t, np.argmin(np.abs((t - fixed + period / 2) % period - period / 2)))
    if t.size + problem.fixed.size != problem.samples or not (t.size == 0 or problem.free.size):
        return None
    best: tuple[float, list[float]] | None = None if t.size else (0.0, [])
    allowed = _AllowedTimes(problem)
    for lead in np.argsort(-np.diff(np.append(t[-1:] - period, t)), kind="stable")[:_LEADS]:
        turned = np.concatenate([t[lead:], t[:lead] + period]).tolist()
        found = _moved_least(turned, allowed, problem.gap, apart)
        if found is not None and found[1][-1] - found[1][0] <= period - apart and (best is None or found[0] < best[0]):
            best = found
            if allowed.nearest(turned[0]) == found[1][0] and allowed.nearest(turned[-1]) == found[1][-1]:
                break  # nothing is in the way across the end of the period: no other beginning moves less
    return None if best is None else np.sort(np.mod(np.concatenate([problem.fixed, best[1]]), period))


class _AllowedTimes:
    """Allowed times of free samples, on a line of some periods."""

    def __init__(self, problem: DesignProblem) -> None:
        spans = np.concatenate([problem.free + cycle * problem.period for cycle in range(-2, 4)])
        self.begins, self.ends = spans.T.tolist()

    def after(self, t: float) -> float:
        """The first one at or after t; infinite where the line ends."""
        i = bisect_left(self.ends, t)
        return max(t, self.begins[i]) if i < len(self.ends) else np.inf

    def before(self, t: float) -> float:
        """The last one at or before t."""
        i = bisect_right(self.begins, t) - 1
        return min(t, self.ends[i]) if i >= 0 else -np.inf

    def nearest(self, t: float) -> float:
        """The nearest one."""
        early, late = self.before(t), self.after(t)
        return early if t - early <= late - t else late


def _moved_least(
    wished: list[float], allowed: _AllowedTimes, gap: float, apart: float
) -> tuple[float, list[float]] | None:
    """By how much the samples have to be moved together, of the choices of `repaired`, and where to."""
    later, earlier = [allowed.after(wished[0])], [allowed.before(wished[-1])]
    for wish in wished[1:]:
        later.append(allowed.after(max(wish, later[-1] + gap)))
    for wish in wished[-2::-1]:
        earlier.append(allowed.before(min(wish, earlier[-1] - gap)))
    places = []
    for wish, high, low in zip(wished, later, reversed(earlier), strict=True):
        middle = allowed.nearest((high + low) / 2) if isfinite(high - low) else wish
        near = dict.fromkeys((allowed.nearest(wish), high, low, middle))  # mostly one and the same
        places.append([place for place in near if isfinite(place)])
    ways = [[(abs(place - wished[0]), -1, place) for place in places[0]]]
    for wish, here in zip(wished[1:], places[1:], strict=True):
        reached = []
        for place in here:
            fits = [(way[0], i) for i, way in enumerate(ways[-1]) if place - way[2] >= apart]
            if fits:
                cost, i = min(fits)
                reached.append((cost + abs(place - wish), i, place))
        if not reached:
            return None
        ways.append(reached)
    way = min(ways[-1])
    total, found = way[0], [way[2]]
    for before in ways[-2::-1]:
        way = before[way[1]]
        found.append(way[2])
    return total, found[::-1]


def candidates(problem: DesignProblem, others: Array, count: int) -> Array:
    """Admissible times for one more sample: a grid of `count`, and the ends of free stretches where these are few."""
    period, gap = problem.period, problem.gap
    grid = np.arange(count) * (period / count)
    near = np.concatenate([others - gap, others + gap]) if others.size <= count // 2 else np.zeros(0)
    wished = np.unique(np.mod(np.concatenate([grid, near, problem.inner.ravel()]), period))
    place = np.searchsorted(problem.inner[:, 0], wished, side="right") - 1
    wished = np.asarray(wished[(place >= 0) & (wished <= problem.inner[place, 1])], dtype=np.float64)
    if not others.size:
        return wished
    distance = np.abs((wished[:, None] - others[None, :] + period / 2) % period - period / 2)
    return np.asarray(wished[distance.min(axis=1) >= problem.spacing * (1 - 1e-12)])


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
    problem: DesignProblem, times: Array, sigma2: float, count: int, rounds: int, budget: Budget, graded: bool = False
) -> tuple[Array, float]:
    """Move one sample at a time to its best admissible place on a grid of `count`, until nothing improves.

    `graded` as for `worst_sigma2`, and so is `sigma2`.
    """
    for _ in range(rounds):
        before = sigma2
        for i in range(times.size):
            if np.any(times[i] == problem.fixed) or budget.over:
                continue
            others = np.delete(times, i)
            places = candidates(problem, others, count)
            if not places.size:
                continue
            trial = np.sort(np.concatenate([np.tile(others, (places.size, 1)), places[:, None]], axis=1), axis=1)
            values = worst_sigma2(problem, trial, inner=int(graded), graded=graded)
            top = int(np.argmax(values))
            if values[top] > sigma2 + 1e-9 * abs(sigma2):
                exact = float(worst_sigma2(problem, trial[top : top + 1], graded=graded)[0])
                if exact > sigma2:
                    times, sigma2 = trial[top], exact
        if sigma2 <= before + 1e-4 * abs(before):
            break
    return times, sigma2


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
