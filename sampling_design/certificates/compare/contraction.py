"""How fast the estimator without constraints really forgets: the spectral radius of its error map."""

from __future__ import annotations

import numpy as np

from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.exact.window_problem import WindowProblem, window_problem
from sampling_design.errors import UndecidedError
from sampling_design.numerics.filtering import joint_update, propagate
from sampling_design.numerics.linalg import expm_batch
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import ENDLESS, Budget, BudgetSpentError
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import period_of

FINITE = "`certificate` must be on a periodic schedule: a finite one has no long run."
MOST_PERIODS = 64
"""A window is compared with itself this many times at most: e(t) -> e(t + M) repeats when M is whole periods."""
ONE_TIME = 1e-9  # share of a period by which times may differ, and be one: a sample at the end of a window lies in it
MOST_AT_ONCE = 4096  # windows that are followed side by side: a few megabytes


@checked
def error_map(certificate: Certificate, start: float, horizon: float, cost: str = "certificate") -> Array:
    """Return the map e(start) -> e(start + horizon) of the estimator without noise and constraints.

    One window with prior weight P2: the error is the plant's flow, less what each sample corrects,
    F (I - K_N C) ... (I - K_1 C).

    Parameters
    ----------
    certificate : Certificate
        Its weights are those of the estimator.
    start : float [time]
    horizon : float [time]
        Length of the window.
    cost : "certificate" or "paper"
        The certificate's cost with the window (start, start + horizon], or the paper's (15): twice P2, Qw and Qv
        and the closed window.

    Returns
    -------
    (n, n) array

    Raises
    ------
    ArgumentError
        If the cost is unknown, or the horizon not positive.
    """
    checks.positive("horizon", horizon)
    problem, ends = _stated(certificate, cost)
    sampled = certificate.schedule.between(start, start + horizon, closed=ends).times
    found: Array = _along(problem, np.array([start]), horizon, sampled, np.array([[0], [len(sampled)]]))[0]
    return found


@checked
def spectral_radius(certificate: Certificate, horizon: float, cost: str = "certificate") -> float:
    """Return the spectral radius of the error over one window of `horizon`, the worst start in a period.

    Parameters
    ----------
    certificate : Certificate
        On a periodic schedule.
    horizon : float [time]
    cost : "certificate" or "paper"

    Returns
    -------
    float
        Below one: the estimator that is restarted from its own estimate every `horizon` forgets.

    Raises
    ------
    ArgumentError
        If the schedule is finite, or the horizon not positive.

    Notes
    -----
    *Method.* Windows follow each other; after at most 64 of them they start at the same phase of it to 1e-9, and
    the radius of the product is taken per window. Where they never do, after 64.
    """
    return radius_within(ENDLESS, certificate, checks.positive("horizon", horizon), cost)


def radius_within(clock: Budget, certificate: Certificate, horizon: float, cost: str = "certificate") -> float:
    """`spectral_radius` within a budget. Raises BudgetSpentError where that ends first."""
    schedule = period_of(certificate.schedule, FINITE).primitive()
    period, first = schedule.period, schedule.first
    if not certificate.plant.n_states:
        return 0.0
    ratio, near = horizon / period, ONE_TIME * period
    whole = next((k for k in range(1, MOST_PERIODS) if abs(k * ratio - round(k * ratio)) < ONE_TIME), MOST_PERIODS)
    problem, ends = _stated(certificate, cost)
    offsets, worst = first + (schedule.times - schedule.times[0]), 0.0
    for some in np.array_split(offsets, max(1, whole * len(offsets) // MOST_AT_ONCE)):
        clock.check()
        starts = (some[:, None] + horizon * np.arange(whole)).ravel()
        times = schedule.between(starts.min() - near, starts.max() + horizon + near).times
        within = np.searchsorted(times, [starts + (near if ends == "right" else -near), starts + horizon + near])
        maps = _along(problem, starts, horizon, times, within, clock)
        maps = maps.reshape(len(some), whole, problem.size, problem.size)
        product = maps[:, 0]
        for k in range(1, whole):
            product = maps[:, k] @ product
        worst = max(worst, float(np.abs(np.linalg.eigvals(product)).max() ** (1 / whole)))
    return worst


@checked
def least_contracting(certificate: Certificate, cost: str = "certificate", budget: float | None = None) -> float:
    """Return the least window, in steps from sample to sample of a period, from which on the true error map contracts.

    Parameters
    ----------
    certificate : Certificate
        On a periodic schedule.
    cost : "certificate" or "paper"
    budget : float, optional [seconds]

    Returns
    -------
    float [time]
        Least tried length whose spectral radius is below one and stays so for every longer one tried (up to a period
        and four gaps). Infinite if there is none.

    Raises
    ------
    ArgumentError
        If the schedule is finite.
    UndecidedError
        If the budget ends before.
    """
    return contracting_within(Budget(None if budget is None else checks.positive("budget", budget)), certificate, cost)


def contracting_within(given: Budget, certificate: Certificate, cost: str = "certificate") -> float:
    """`least_contracting` within a budget of which something may be spent already."""
    schedule = period_of(certificate.schedule, FINITE)
    passed = np.cumsum(np.tile(schedule.gaps, 3))[: len(schedule) + 4]
    lengths = passed[np.unique(np.round(passed / schedule.period, 12), return_index=True)[1]]
    best = np.inf
    for length in lengths[::-1]:
        try:
            if radius_within(given, certificate, float(length), cost) >= 1:
                break
        except BudgetSpentError:
            raise UndecidedError(
                f"undecided: not every length was tried within `budget` = {given.seconds:g} s."
            ) from None
        best = float(length)
    return best


def _stated(certificate: Certificate, cost: str) -> tuple[WindowProblem, str]:
    """The recursion of this cost, and which ends its windows have."""
    checks.word("cost", cost, ("certificate", "paper"))
    c, factor = certificate, 2.0 if cost == "paper" else 1.0
    problem = window_problem(c.plant, c.schedule, factor * c.P2, factor * c.Qw, c.R, factor * c.Qv, c.eta)
    return problem, "both" if cost == "paper" else "right"


def _along(
    problem: WindowProblem, starts: Array, length: float, sampled: Array, within: Index, clock: Budget = ENDLESS
) -> Array:
    """The error maps over windows of one length, side by side, in the plant's coordinates, shape (windows, n, n).

    Window k has the samples at the times `sampled` from number `within[0, k]` on, up to `within[1, k]`.
    """
    n, ends, first = problem.size, starts + length, within[0][:, None]
    steps = int(np.max(within[1] - within[0]))
    number = np.minimum(first + np.arange(steps), len(sampled) - 1)
    here = first + np.arange(steps) < within[1][:, None]
    times = np.where(here, sampled[number], ends[:, None])
    gaps = np.maximum(np.diff(times, prepend=starts[:, None], append=ends[:, None]), 0.0)
    rows = np.where(here[..., None, None], _rows_at(problem, sampled)[number], 0.0)  # no sample: nothing is observed
    unlike, which = np.unique(np.round(gaps / length, 14) * length, return_inverse=True)
    which = which.reshape(gaps.shape)
    F, W = problem.flow(unlike)
    crossed = expm_batch(problem.A, unlike)
    Y = Phi = np.broadcast_to(np.eye(n), (len(starts), n, n))
    for k in range(steps):
        clock.check()
        at = which[:, k]
        Y, closed = joint_update(propagate(Y, F[at], W[at]), rows[:, k], crossed[at] @ Phi)
        Phi = Phi if closed is None else closed
    last = crossed[which[:, steps]] @ Phi
    return np.asarray(np.linalg.solve(problem.root.T, last @ problem.root.T), dtype=np.float64)


def _rows_at(problem: WindowProblem, times: Array) -> Array:
    """What the samples nearest to these times measure."""
    since, period = problem.times - problem.times[0], problem.period
    phases = (times - problem.times[0]) % period if period else times - problem.times[0]
    nearest = np.argmin(np.abs(np.append(since, period or np.inf) - phases[..., None]), axis=-1)
    rows: Array = problem.rows[nearest % problem.count]
    return rows
