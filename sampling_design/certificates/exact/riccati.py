"""The exact supremum of lambda_max(P2 Y) over window starts and times, attained by a witness.

Windows run side by side in one batch: each step is one sample update and one gap.
"""

from __future__ import annotations

from contextlib import suppress
from operator import attrgetter

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.exact.riccati_peak import RiccatiPeak
from sampling_design.certificates.exact.window_problem import WindowProblem
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import SolverError
from sampling_design.numerics.filtering import CovarianceMap, measurement_update, propagate
from sampling_design.numerics.linalg import eigenvalue_bound, symmetrise
from sampling_design.records.arrays import Array, Index, Mask

STEADY_RTOL = 1e-10
"""Change of Y per doubling, relative in every state, at which the periodic solution counts as found; eps times some
condition 1e5."""
REPEATED_RTOL = 1e-6
"""What is found so must repeat itself to within this a period of samples later: doublings may be lost in rounding."""
MERGED_RTOL = 1e-5
"""A window below (1 + this) times the periodic solution brings nothing new: lambda is then its own within 1e-5."""
MAX_DOUBLINGS = 40
LONGEST_ITERATION, SHORTER_ITERATION = 4000, 1000
"""Samples that are followed one by one where the composition of periods is lost in rounding; likewise with a floor."""
FLOOR = 1e-13  # share of every state's variance that is added before each sample where nothing settles without
ROUGHLY = 1e-3
"""Change from period to period at which it has settled with such a floor: it serves as a proposal, and lies above."""
ITERATION_WORK = 150  # work of one of them
JUMP = 5  # periods that are followed between two jumps
MAX_STEPS = 100_000
LONGEST_REFINED = 200
"""Peaks after more samples than this lie on the periodic solution, where a finer look changes nothing."""
ATTAINED_RTOL = 2e-4  # how near to the periodic solution a window is followed; the certificate leaves 1e-3
LONGEST_RUN = 20_000  # samples along which a window is followed towards the periodic solution
FURTHER = 4  # times as far the highest window is followed alone, where all together took too much work
START_CELLS = 5
MIN_STARTS = 16
"""Inner starts: START_CELLS - 1 per gap, and at least about this many per period."""
TIME_FRACTIONS = (0.25, 0.5, 0.75, 1.0)  # of a gap, at which times are looked at: at its end lie most peaks
REFINEMENTS = 4
"""Times that a peak is looked at closer: each takes a quarter of the grid before, and the proof finds what is left."""


def periodic_riccati_solution(problem: WindowProblem, work: WorkLimit | None = None, iterate: bool = True) -> Array:
    """Return Y just after each sample of the period in the long run, shape (N, n, n).

    One period is a `CovarianceMap`; two periods are again one, so that 2^k periods cost k compositions and slow plants
    need no more time than fast ones. Where rounding spoils that, and `iterate` allows it, samples follow one by one,
    counted in `work`. Raises SolverError if Y has not settled after 2^40 periods: the schedule is on the edge of what
    can be certified.

    Notes
    -----
    *Method.* The periodic Riccati equation by structure-preserving doubling.

    References
    ----------
    Chu, Fan, Lin and Wang 2004.
    """
    flows = problem.flow(problem.gaps)
    with suppress(np.linalg.LinAlgError):
        if (solution := _doubled(problem, flows)) is not None:
            return solution
    for share in (0.0, FLOOR) if iterate else ():
        solution = _iterated(problem, flows, share, WorkLimit(np.inf) if work is None else work)
        if solution is not None:
            return solution
    raise SolverError(
        "the information did not settle over 2^40 periods: this schedule is on the edge of what can be certified.",
        status="unsettled",
    )


def _iterated(problem: WindowProblem, flows: tuple[Array, Array], share: float, work: WorkLimit) -> Array | None:
    """The periodic solution by following it: slower, but no composition of periods is lost in rounding.

    Every `JUMP` periods it jumps to where the gains of the last one would settle (a step of Newton's method, from
    above): sums of positive terms alone. With a `share`, so much of every state's variance is added before each sample:
    what rounding does without order is then done with order, and from above, and less is asked of where it settles.
    """
    Y = np.eye(problem.size)
    settled, repeated = (ROUGHLY, ROUGHLY) if share else (STEADY_RTOL, REPEATED_RTOL)
    for period in range(1, (SHORTER_ITERATION if share else LONGEST_ITERATION) // problem.count + 2):
        work.spend(ITERATION_WORK * problem.count)
        with np.errstate(over="ignore", invalid="ignore"):  # an unobservable mode grows until that ends the loop
            around, whole, added = _with_gains(problem, flows, Y, share, period % JUMP == 0)
            if not np.isfinite(around).all():
                break
            if _settled(Y, around[-1], settled):
                return around
            jumps = period % JUMP == 0 and np.abs(np.linalg.eigvals(whole)).max(initial=0.0) < 1
            following = _summed(whole, added) if jumps else around[-1]
            if jumps and _settled(Y, following, repeated):  # what is left is of second order
                return _with_gains(problem, flows, following, share, False)[0]
        Y = following
    return None


def _with_gains(
    problem: WindowProblem, flows: tuple[Array, Array], Y: Array, share: float, composed: bool
) -> tuple[Array, Array, Array]:
    """Y after each sample of a period, and the period with these gains as the map Y -> `whole` Y `whole`' + `added`.

    The map where it is `composed`, which takes as much again.
    """
    unit = whole = np.eye(problem.size)
    pair = np.zeros((2 if composed else 1, problem.size, problem.size))  # Y, and `added`
    pair[0] = Y
    result = np.empty((problem.count, problem.size, problem.size))
    for i in range(problem.count):
        F, W = flows[0][i], flows[1][i]
        pair, whole = propagate(pair, F, W), F @ whole if composed else unit
        if share:
            pair = pair + np.diag(share * np.diagonal(pair[0]))
        for row in problem.rows[i]:  # products, not dyads, so that all sums are of positive terms
            cross = pair[0] @ row
            gain = cross / (1 + cross @ row)
            left = unit - gain[:, None] * row
            pair, whole = propagate(pair, left, gain[:, None] * gain), left @ whole if composed else unit
        result[i] = pair[0]
    return result, whole, pair[-1]


def _summed(whole: Array, added: Array) -> Array:
    """The sum over k of whole^k added whole'^k, by doubling."""
    for _ in range(MAX_DOUBLINGS):
        more = whole @ added @ whole.T
        added, whole = symmetrise(added + more), whole @ whole
        if not np.any(np.abs(more) > np.finfo(float).eps * np.abs(added)):
            break
    return added


def _doubled(problem: WindowProblem, flows: tuple[Array, Array]) -> Array | None:
    """The periodic solution by composing periods, twice as many in each step; None where rounding spoils it."""
    cycle = _one_period(problem, flows)
    Y = cycle(np.eye(problem.size))  # from 0 a growing mode without disturbance would stay there
    for _ in range(MAX_DOUBLINGS):
        with np.errstate(over="ignore", invalid="ignore"):  # an unobservable mode grows until that ends the loop
            following, longer = cycle(Y), cycle.then(cycle)
        if not all(np.isfinite(part).all() for part in (following, longer.F, longer.G, longer.Q)):
            break
        if _settled(Y, following, STEADY_RTOL):
            around = _around(problem, flows, following)
            if _settled(following, around[-1], REPEATED_RTOL):
                return around
            break
        Y, cycle = following, longer
    return None


def _settled(Y: Array, following: Array, rtol: float) -> bool:
    """Whether no entry changed by more than `rtol` of its row's and column's diagonal, in whatever units."""
    size = np.sqrt(np.abs(np.diagonal(following)))
    return bool(np.all(np.abs(following - Y) <= rtol * size * size[:, None]))


def _one_period(problem: WindowProblem, flows: tuple[Array, Array]) -> CovarianceMap:
    """One period: Q is where Y = 0 comes to, F its closed loop.

    Sample by sample, each output's information counted against what the disturbance has added by then: an output that
    is nearly exact leaves G as large as the disturbance lets it, and not as small as its noise.
    """
    n = problem.size
    F, W, H = np.eye(n), np.zeros((n, n)), np.zeros((n, n))
    for i in range(problem.count):
        F, W = flows[0][i] @ F, propagate(W, flows[0][i], flows[1][i])
        for row in problem.rows[i]:
            cross, output = W @ row, row @ F
            spread = 1 + cross @ row
            left = np.eye(n) - np.outer(cross / spread, row)
            F, W, H = left @ F, measurement_update(W, row[None]), H + np.outer(output, output) / spread
    return CovarianceMap(F, H, W)


def _around(problem: WindowProblem, flows: tuple[Array, Array], last: Array) -> Array:
    """Y after each sample, given Y after the period's last one."""
    result = np.empty((problem.count, problem.size, problem.size))
    Y = last
    for i in range(problem.count):
        Y = measurement_update(propagate(Y, flows[0][i], flows[1][i]), problem.rows[i])
        result[i] = Y
    return result


def sweep(
    problem: WindowProblem,
    index: Index,
    remaining: Array,
    fractions: npt.ArrayLike = TIME_FRACTIONS,
    steady: Array | None = None,
    last_step: int = MAX_STEPS,
    work: WorkLimit | None = None,
) -> list[RiccatiPeak]:
    """Return the peak of each window, looked for at `fractions` of every gap (0 is just before its first sample).

    A window ends with a finite schedule, after `last_step` gaps, or where its Y lies below the periodic solution.
    All end where the `work` is used up: what they have met by then stands.
    """
    work = WorkLimit(np.inf) if work is None else work
    part = np.append(np.asarray(fractions, dtype=np.float64), 1.0)
    m = part.size
    ahead = np.arange(problem.count) if last_step + 1 >= problem.count else np.arange(1, last_step + 2) + index.min()
    needed = ahead % problem.count if index.min() == index.max() else np.arange(problem.count)
    where = np.zeros(problem.count, dtype=np.intp)
    distinct, where[needed] = np.unique(problem.gaps[needed], return_inverse=True)
    F, W = (a.reshape(distinct.size, m, *a.shape[1:]) for a in problem.flow(np.outer(distinct, part).ravel()))
    head_F, head_W = problem.flow(np.outer(remaining, part).ravel())
    head = propagate(np.eye(problem.size), head_F, head_W).reshape(remaining.size, m, problem.size, problem.size)
    best = np.zeros((3, index.size))  # value, step and fraction of each window's peak
    best[1] = -1
    alive = np.arange(index.size)
    _note(best, alive, head, part, -1)
    Y, at = head[:, -1], index.copy()
    for step in range(last_step + 1):
        Y = measurement_update(Y, problem.rows[at])
        going = _may_still_grow(problem, Y, at, steady)
        Y, alive = Y[going], alive[going]
        at = (at[going] + 1) % problem.count
        if not alive.size or work.over:
            break
        work.spend(100 + alive.size * (m + 1) * problem.size)
        inside = propagate(Y[:, None], F[where[at]], W[where[at]])
        _note(best, alive, inside, part, step)
        Y = inside[:, -1]
    return [
        RiccatiPeak(float(value), int(i), float(r), int(step), float(fraction))
        for i, r, (value, step, fraction) in zip(index, remaining, best.T, strict=True)
    ]


def _may_still_grow(problem: WindowProblem, Y: Array, at: Index, steady: Array | None) -> Mask:
    """Which windows may still bring something: the schedule goes on and the periodic solution is not yet above."""
    if problem.period is None:
        return np.asarray(at + 1 < problem.count)
    if steady is None:
        return np.ones(at.size, dtype=bool)
    slack = (1 + MERGED_RTOL) * steady[at] - Y + MERGED_RTOL * 1e-3 * np.eye(problem.size)
    return np.asarray(np.linalg.eigvalsh(slack)[:, 0] < 0)


def _note(best: Array, alive: Index, Y: Array, part: Array, step: int) -> None:
    """Raise the peaks where a new value is larger; a cheap bound on the eigenvalue spares most of them."""
    values = eigenvalue_bound(Y)
    hopeful = values > best[0, alive][:, None]
    if not hopeful.any():
        return
    values[~hopeful] = 0.0
    values[hopeful] = np.linalg.eigvalsh(Y[hopeful])[:, -1]
    column = np.argmax(values, axis=1)
    value = values[np.arange(alive.size), column]
    higher = value > best[0, alive]
    best[:, alive[higher]] = value[higher], np.full(higher.sum(), step), part[column[higher]]


def supremum(problem: WindowProblem, finer: int = 1, work: WorkLimit | None = None) -> tuple[RiccatiPeak, RiccatiPeak]:
    """Return the largest attained lambda over all real starts, and over sample starts.

    A coarse look at starts and times, then a finer and finer one around the best; what lies between is
    for the checker to prove, which names a window where something was missed. `finer` multiplies both grids; the look
    ends with what it has where the `work` is used up.
    """
    index, remaining = problem.sample_starts()
    if np.linalg.eigvalsh(problem.A + problem.A.T + problem.eta * np.eye(problem.size) + problem.noise)[-1] <= 0:
        still = RiccatiPeak(1.0, int(index[0]), float(remaining[0]), -1, 0.0)  # Y falls, whatever the samples do
        return still, still
    steady = None if problem.period is None else periodic_riccati_solution(problem)
    inner = np.arange(1, finer * max(START_CELLS, -(-MIN_STARTS // problem.count)))
    parts = np.arange(1, 4 * finer + 1) / (4 * finer)
    more = np.repeat(np.arange(problem.count), inner.size)
    starts = problem.reach[more] * np.tile(inner / (inner.size + 1), problem.count)
    peaks = sweep(problem, np.append(index, more), np.append(remaining, starts), parts, steady, work=work)
    own, others = peaks[: index.size], peaks[index.size :]
    if steady is not None and work is not None and work.over:  # what still rises is followed alone
        rising = (max(some, key=attrgetter("value")) for some in (own, [*own, *others]))
        timed = WorkLimit(np.inf, stop=work.stop)
        own, others = ([_followed_further(problem, peak, steady, timed)] for peak in rising)
    if steady is not None:
        own.append(long_run(problem, steady, max(own, key=attrgetter("value")), work))
    at_sample = refine(problem, max(own, key=attrgetter("value")), 0.0, 1 / parts.size, work)
    anywhere = max([*others, at_sample], key=attrgetter("value"))
    anywhere = refine(problem, anywhere, problem.reach[anywhere.index] / (inner.size + 1), 1 / parts.size, work)
    return max(anywhere, at_sample, key=attrgetter("value")), at_sample


def _followed_further(problem: WindowProblem, peak: RiccatiPeak, steady: Array, work: WorkLimit) -> RiccatiPeak:
    """The peak of the same window after `FURTHER` times as many samples, if it is higher."""
    last, at = min(FURTHER * (peak.step + 1), MAX_STEPS), (np.array([peak.index]), np.array([peak.remaining]))
    return max(peak, *sweep(problem, *at, steady=steady, last_step=last, work=work), key=attrgetter("value"))


def long_run(problem: WindowProblem, steady: Array, best: RiccatiPeak, work: WorkLimit | None = None) -> RiccatiPeak:
    """Return `best`, or where the periodic solution exceeds it: a window followed until it reaches that."""
    follower = (np.arange(problem.count) + 1) % problem.count
    part = np.asarray(TIME_FRACTIONS)
    F, W = problem.flow(np.outer(problem.gaps[follower], part).ravel())
    values = np.linalg.eigvalsh(propagate(np.repeat(steady, part.size, axis=0), F, W))[:, -1]
    if values.max() <= best.value:
        return best
    index, remaining = problem.sample_starts()
    periods = 1
    peak = best
    while peak.value < (1 - ATTAINED_RTOL) * values.max() and periods * problem.count <= LONGEST_RUN:
        periods *= 4
        peak = sweep(problem, index[:1], remaining[:1], last_step=periods * problem.count, work=work)[0]
        if work is not None and work.over:
            break
    return max(peak, best, key=attrgetter("value"))


def refine(
    problem: WindowProblem, peak: RiccatiPeak, width: float, time_width: float = 0.25, work: WorkLimit | None = None
) -> RiccatiPeak:
    """Return a better peak near `peak`: its start may move by `width`, its time by `time_width` of the gap."""
    for _ in range(REFINEMENTS if peak.step <= LONGEST_REFINED else 0):
        if work is not None and work.over:
            break
        lowest = max(peak.remaining - width, 0.0)
        highest = min(peak.remaining + width, float(problem.reach[peak.index]))
        starts = np.linspace(lowest, highest, 7) if width else np.array([peak.remaining])
        parts = np.linspace(max(peak.fraction - time_width, 0.0), min(peak.fraction + time_width, 1.0), 5)
        peaks = sweep(problem, np.full(starts.size, peak.index), starts, parts, last_step=max(peak.step, 0), work=work)
        peak = max([peak, *peaks], key=attrgetter("value"))
        width, time_width = width / 3, time_width / 2
    return peak
