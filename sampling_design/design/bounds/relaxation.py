"""Semidefinite relaxation on a time grid: weights to round, multipliers to prove a bound with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sampling_design import __version__
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import MANY_STATES, lags
from sampling_design.design.problem.orthogonal_flow import squares
from sampling_design.numerics import conic_programs
from sampling_design.numerics.eigenvalue_program import MixedMatrices, brackets
from sampling_design.numerics.linalg import psd_root
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget
from sampling_design.records.record import SolverRecord

TOLERANCE = 1e-7
"""Asked of the solver: the bound made from its multipliers is as good as they are, and true whatever they are."""

JUST_BESIDE = 1e-9  # of the period: a window that ends this much earlier does not hold the sample
_ENTRIES = 1600  # rows of all windows' inequalities together, about
_PER_TURN = 96  # grid times at least, where what is allowed repeats: one repetition alone has weights then
_OBSERVED_ENOUGH = 1e-5  # a window whose sigma^2 falls short of the value by less than this share is seen well enough
_MOVED = 3  # times that samples are moved against the state that is seen least
LEAST_SECONDS = 0.05  # granted to one of several relaxations when the time is up already


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Weights on grid times and the multipliers of its inequalities.

    The multipliers `Z` of the window starts `starts` are psd with sum <Z_m, S'S> = 1: enforced here, so
    that the bound made from them does not rest on the solver.
    """

    times: Array
    weights: Array
    starts: Array
    Z: Array
    value: float
    record: SolverRecord
    price: float = 0.0


def grid_size(problem: DesignProblem) -> int:
    """Grid times per period: as the spacing asks, and several per cycle of the fastest quadratic form."""
    fine = int(np.ceil(problem.period / problem.spacing))
    return int(np.clip(max(min(fine, 96), 4 * problem.samples, least_points(problem)), 24, 960))


def least_points(problem: DesignProblem) -> int:
    """Eight grid times per cycle of the fastest quadratic form."""
    fastest = float(np.max(np.abs(np.linalg.eigvals(problem.plant.A).imag), initial=0.0))
    return int(np.ceil(8 * problem.period * fastest / np.pi))


def _start_count(problem: DesignProblem) -> int:
    """Window starts: the same number for every grid, so that cost is linear in the grid times; fewer for many states.

    More than some twenty no longer change the value in the fourth digit.
    """
    n = problem.plant.n_states
    return int(np.clip(_ENTRIES / (n * (n + 1) / 2), 8, 32))


def relax_placed(problem: DesignProblem, seconds: float | None = None) -> Relaxation:
    """Maximise t subject to sum_j w_j G(t_j - a_m) >= t I for every window start a_m on the grid.

    Cut short after `seconds`; multipliers of any quality prove a bound.
    """
    if repeating(problem):
        return _relax_repeating(problem, problem.least_shift, seconds)
    times, mask, starts, linear = relaxation_grid(problem)
    if seconds is not None and seconds <= 0:
        return unsolved(problem, times, starts)
    every, there = np.append(times, problem.fixed), np.concatenate([mask, problem.mask(problem.fixed)])
    rows = rows_at(problem, every, starts, there)
    spare = float(problem.samples - problem.fixed.size)
    return solve_relaxation(problem, times, starts, rows, linear, spare, seconds)


def repeating(problem: DesignProblem) -> bool:
    """Whether what is allowed repeats within the period, and nothing else tells one repetition from another."""
    return not problem.fixed.size and problem.chosen is None and 0 < problem.least_shift < problem.period


def _relax_repeating(problem: DesignProblem, shift: float, seconds: float | None) -> Relaxation:
    """The same where what is allowed repeats after a `shift`: weights and multipliers of one repetition, for all.

    Solutions may be shifted too, and their mean is a solution that repeats. Windows are posed one by one, each time
    the one that the weights see least of: few multipliers are enough, and each is one for every repetition.
    """
    P, budget = problem.period, Budget(seconds)
    repeats = round(P / shift)
    turns = np.arange(repeats, dtype=np.float64)[:, None] * shift
    N = grid_size(problem)
    N = max(-(-N // repeats), min(N, _PER_TURN))
    step, tiny, count = shift / N, 1e-9 * P, _start_count(problem)
    ends = np.concatenate([problem.intervals[:, 0], problem.intervals[:, 1] - tiny])
    times = np.unique(np.concatenate([np.arange(N) * step, ends[ends < shift]]))
    times = times[problem.mask(times).any(axis=-1)]
    times = times[np.append(True, np.diff(times) > 2 * tiny)]  # of a grid time on an end, the one just inside
    mask = problem.mask(times)  # of all turns: an end that is shifted may be rounded to the other side
    starts = _even_starts(problem, count, shift)
    starts = np.unique(np.concatenate([starts, np.mod(_telling_starts(problem), shift)]))
    starts = starts[np.append(np.diff(starts) > tiny, True)]
    every = (times + turns).ravel()
    if budget.over:
        return unsolved(problem, every, turns.ravel())
    grams = np.sum([grams_at(problem, times + at, starts, mask) for at in turns], axis=0)
    ahead = np.mod(every - times[:, None] + tiny, P) < problem.spacing
    crowd = np.sum(ahead.reshape(times.size, repeats, times.size), axis=1, dtype=float)
    linear = crowd, np.full(times.size, max(1.0, step / problem.spacing))
    rows = psd_root(grams).swapaxes(-1, -2)
    posed = np.zeros(starts.size, dtype=bool)
    posed[0] = True
    while True:
        parts = times, starts[posed], rows[posed], linear, problem.samples / repeats
        left = budget.seconds_left(LEAST_SECONDS)
        found = solve_relaxation(problem, *parts, left)
        least_sigma2, _ = problem.rows.least(np.einsum("mjab,j->mab", grams, found.weights))
        worst = int(np.argmin(np.where(posed, np.inf, least_sigma2)))
        if posed.all() or least_sigma2[worst] >= found.value * (1 - _OBSERVED_ENOUGH) or budget.over:
            break
        posed[worst] = True
    weights, Z = np.tile(found.weights, repeats), np.tile(found.Z / repeats, (repeats, 1, 1))
    return replace(found, times=every, weights=weights, starts=(found.starts + turns).ravel(), Z=Z)


def unsolved(problem: DesignProblem, times: Array, starts: Array) -> Relaxation:
    """Equal weights, and multipliers that ask for nothing: what there is where there is no time for a solver."""
    n = problem.plant.n_states
    Z, _ = feasible_multipliers(problem, [np.zeros((n, n))] * starts.size)
    return Relaxation(times, np.ones(times.size), starts, Z, np.inf, SolverRecord("none", status="budget"))


def relaxation_grid(problem: DesignProblem) -> tuple[Array, Mask, Array, tuple[Array, Array]]:
    """Grid times for free samples, what is available there, window starts, and the spacing's rows and limits."""
    N, P = grid_size(problem), problem.period
    step, tiny = P / N, 1e-9 * P
    ends = np.concatenate([problem.intervals[:, 0], problem.intervals[:, 1] - tiny])
    times = np.arange(N, dtype=np.float64) * step
    if not problem.is_shift_invariant:  # between grid times and the ends of an interval g could rise unseen
        times = np.unique(np.mod(np.concatenate([times, ends]), P))
    mask = problem.mask(times)
    free = mask.any(axis=-1)
    for t in problem.fixed:
        distance = np.abs((times - t + P / 2) % P - P / 2)
        free &= distance >= problem.spacing * (1 - 1e-9)
    times, mask = times[free], mask[free]
    count = _start_count(problem)
    starts = np.unique(np.concatenate([_even_starts(problem, count, P), _telling_starts(problem)]))
    ahead = np.mod(times[None, :] - times[:, None] + tiny, P)
    linear = ((ahead < problem.spacing).astype(float), np.full(times.size, max(1.0, step / problem.spacing)))
    return times, mask, starts, linear


def _even_starts(problem: DesignProblem, count: int, length: float) -> Array:
    """Evenly spaced window starts, none at an opening: there a sample on it is seen unlike one just after it."""
    return np.asarray((np.arange(count) + (0.0 if problem.is_shift_invariant else 0.5)) * (length / count))


def _telling_starts(problem: DesignProblem) -> Array:
    """Windows that see least whatever is chosen: after a fixed sample or a last allowed time, or before a first one."""
    P, before = problem.period, JUST_BESIDE * problem.period
    closed = problem.intervals if not problem.is_shift_invariant else np.zeros((0, 2))
    late = np.concatenate([problem.fixed, closed[:, 1]])
    early = np.concatenate([problem.fixed, closed[:, 0]]) - problem.window - before
    early = problem.on_closings(early, 2 * before)
    found = np.unique(np.mod(np.concatenate([late, early]), P))
    most = max(_start_count(problem) // 2, 4)
    return found[:: int(np.ceil(found.size / most))] if found.size else found


def rows_at(problem: DesignProblem, times: Array, starts: Array, mask: Mask) -> Array:
    """(M, N, rows, n) scaled rows of samples at `times` in the windows that `starts` mean, zero where none are seen."""
    r, inside = lags(times[None, :], starts[:, None], problem.window, problem.period, problem.closes(starts)[:, None])
    c = problem.rows.rows(r) * (inside[..., None] & mask[None, :, None, :])[..., None]
    return np.asarray(c.reshape(starts.size, times.size, r.shape[-1] * c.shape[-2], c.shape[-1]))


def grams_at(problem: DesignProblem, times: Array, starts: Array, mask: Mask) -> Array:
    """(M, N, n, n) their Gram matrices."""
    return squares(rows_at(problem, times, starts, mask))


def mixed(rows: Array, weights: Array) -> Array:
    """Sums (M, n, n) of the Gram matrices of rows (M, N, p, n), weighed."""
    weighted = (rows * weights[:, None, None]).reshape(len(rows), -1, rows.shape[-1])
    return np.asarray(np.swapaxes(weighted, 1, 2) @ rows.reshape(weighted.shape))


def sigma_of_moved(problem: DesignProblem, times: Array, mask: Mask) -> float:
    """Least sigma of windows just before and after samples at `times`, each early, late or on time as a bound moves it.

    Each goes where the state that is seen least is seen least, again and again: real times that are possible, so that
    no more than this is true of the schedule.
    """
    rows, starts = problem.rows, np.concatenate([times, times - problem.window])[:, None]
    r, inside = lags(times, starts, problem.window, problem.period, np.array([[[True]], [[False]]]))
    c = rows.rows(r) * (inside[..., None] & mask[:, None, :])[..., None]
    c = c.reshape(2 * starts.size, -1, *c.shape[-2:])
    sigma2, z = rows.least(squares(c.reshape(len(c), -1, c.shape[-1])))
    worst = sigma2.min()
    for _ in range(_MOVED if len(problem.moves) > 1 else 0):
        observed = c @ (problem.moves @ z.T).transpose(0, 2, 1)[:, :, None, :, None]
        least = problem.moves[np.argmin(np.sum(observed**2, axis=(3, 4)), axis=0)]
        sigma2, z = rows.least(squares((c @ least).reshape(len(c), -1, c.shape[-1])))
        worst = min(worst, sigma2.min())
    return float(np.sqrt(max(worst, 0.0)))


def solve_relaxation(
    problem: DesignProblem,
    times: Array,
    starts: Array,
    rows: Array,
    linear: tuple[Array, Array],
    count: float,
    seconds: float | None = None,
    tolerance: float = TOLERANCE,
) -> Relaxation:
    """Maximise t subject to sum w = count, linear rows w <= limits, w >= 0 and the windows' inequalities.

    `rows` are those of samples at `times`, and after them those of fixed ones, each of which is a choice of its own.
    """
    N = linear[0].shape[1]
    free, fixed = N if count > 0 else 0, rows.shape[1] - N
    own = np.append(np.zeros(free), np.arange(1.0, fixed + 1))  # which equation a choice belongs to
    each = np.unique(own)[:, None]
    bounded = np.zeros((linear[1].size, own.size))
    bounded[:, :free] = linear[0][:, :free]
    program = MixedMatrices(
        rows=rows[:, N - free :], first=np.where(own > 0, 1.0, count / max(free, 1)),
        equal=(own == each).astype(float), sums=np.where(each[:, 0] > 0, 1.0, count),
        bounded=bounded, limits=linear[1], roof=problem.rows.N,
    )  # fmt: skip
    found = solve_program(program, seconds, tolerance)
    Z, _ = feasible_multipliers(problem, found.Z)
    weights = np.append(found.x[:free], np.zeros(N - free))
    return Relaxation(times, weights, starts, Z, found.t / problem.rows.unit, found.record)


class MixedSolution(NamedTuple):
    """What a solver leaves: weights of the choices, multipliers of the matrices and of the limits, and t."""

    x: Array
    Z: Sequence[Array] | Array
    l: Array
    t: float
    record: SolverRecord


def solve_program(program: MixedMatrices, seconds: float | None, tolerance: float = TOLERANCE) -> MixedSolution:
    """Solve, cut short after `seconds`.

    Of many states a general solver would need gigabytes, and ten times as long.
    """
    solve = _solve_by_rows if len(program.roof) > MANY_STATES else _solve_by_matrices
    return solve(program, seconds, tolerance)


def _solve_by_matrices(program: MixedMatrices, seconds: float | None, tolerance: float) -> MixedSolution:
    """By a general solver, which is given every matrix."""
    from scipy import sparse

    N, roof = program.first.size, conic_programs.svec(program.roof)[:, None]
    of_x = np.vstack([sparse.csr_array(program.bounded).toarray(), -np.eye(N)])
    blocks: list[tuple[str, Array, Array]] = [
        ("zero", np.pad(program.equal, ((0, 0), (0, 1))), program.sums),
        ("nonnegative", np.pad(of_x, ((0, 0), (0, 1))), np.append(program.limits, np.zeros(N))),
    ]
    for grams in map(squares, program.rows):
        blocks.append(("psd", np.hstack([-conic_programs.svec(grams).T, roof]), np.zeros(roof.size)))
    cost = np.append(np.zeros(N), -1.0)
    found = conic_programs.solve_cone_program(cost, blocks, tolerance=tolerance, budget=seconds, refined=False)
    x, l = (np.clip(np.nan_to_num(part), 0.0, None) for part in (found.x[:N], found.z[1][: program.limits.size]))
    return MixedSolution(x, found.z[2:], l, found.x[-1], found.record)


def _solve_by_rows(program: MixedMatrices, seconds: float | None, tolerance: float) -> MixedSolution:
    """By `eigenvalue_program`, with limits just so loose that something lies inside them."""
    loose = program.limits + tolerance * np.maximum(np.abs(program.limits), 1.0)
    budget, steps, status = Budget(seconds), 0, conic_programs.INACCURATE
    for steps, found in enumerate(brackets(program._replace(limits=loose))):  # noqa: B007
        if found.total - found.t <= tolerance * min(abs(found.t), abs(found.total)):
            status = conic_programs.SOLVED
        elif budget.over:
            status = conic_programs.BUDGET
        else:
            continue
        break
    record = SolverRecord("sampling_design", __version__, status, steps, {"tolerance": tolerance})
    return MixedSolution(found.x, found.Z, found.l, found.t, record)


def feasible_multipliers(problem: DesignProblem, found: Sequence[Array] | Array) -> tuple[Array, float]:
    """Psd parts with sum <Z_m, S'S> = 1, and what they were divided by; any such give a true bound."""
    rows = problem.rows
    Z = psd_part(np.array(found))
    mass = float(np.einsum("mij,ij->", Z, rows.N)) * rows.unit
    if not np.isfinite(mass) or mass <= 0:  # nothing usable came back
        Z = np.broadcast_to(rows.R @ rows.R.T, Z.shape).copy()
        mass = float(np.einsum("mij,ij->", Z, rows.N)) * rows.unit
    return Z / mass, mass


def psd_part(Z: Array) -> Array:
    """Nearest psd matrices of a stack; entries that are not finite count as zero."""
    values, vectors = np.linalg.eigh(np.nan_to_num(Z))
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2))
