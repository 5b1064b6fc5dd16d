"""How fast the estimator without constraints really forgets: the spectral radius of its error map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._door import door
from sampling_design._linalg import expm_batch
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.exact.riccati import update
from sampling_design.certificates.exact.window_problem import WindowProblem, window_problem
from sampling_design.errors import ArgumentError
from sampling_design.schedules.schedule import PeriodicSchedule

Array = npt.NDArray[np.float64]

MOST_PERIODS = 64
"""A window is compared with itself this many times at most: e(t) -> e(t + M) repeats when M is whole periods."""


def error_map(certificate: Certificate, start: float, length: float, cost: str = "certificate") -> Array:
    """Return the map e(start) -> e(start + length) of the estimator without noise and constraints.

    One window with prior weight P2: the error is the plant's flow, less what each sample corrects,
    F (I - K_N C) ... (I - K_1 C).

    Parameters
    ----------
    certificate : Certificate
        Its weights are those of the estimator.
    start : float [time]
    length : float [time]
        Window length.
    cost : "certificate" or "paper"
        The certificate's cost with the window (start, start + length], or the paper's (15): twice P2, Qw and Qv
        and the closed window.

    Returns
    -------
    (n, n) array

    Raises
    ------
    ArgumentError
        If the cost is unknown.
    """
    _checks.word("cost", cost, ("certificate", "paper"))
    problem = _problem(certificate, 2.0 if cost == "paper" else 1.0)
    ends = "both" if cost == "paper" else "right"
    seen = certificate.schedule.between(start, start + length, closed=ends).times
    return _along(problem, start, start + length, seen)


@door
def spectral_radius(certificate: Certificate, length: float, cost: str = "certificate") -> float:
    """Return the spectral radius of the error over one window of `length`, the worst start in a period.

    Parameters
    ----------
    certificate : Certificate
        On a periodic schedule.
    length : float [time]
    cost : "certificate" or "paper"

    Returns
    -------
    float
        Below one: the estimator that is restarted from its own estimate every `length` forgets.

    Raises
    ------
    ArgumentError
        If the schedule is finite.

    Notes
    -----
    *Method.* Windows follow each other; after at most 64 of them they start at the same phase of it to 1e-9, and
    the radius of the product is taken per window. Where they never do, after 64.
    """
    schedule = certificate.schedule
    if not isinstance(schedule, PeriodicSchedule):
        raise ArgumentError("`certificate` must be on a periodic schedule: a finite one has no long run.")
    period, first = schedule.period, schedule.first
    ratio = length / period
    whole = next((k for k in range(1, MOST_PERIODS) if abs(k * ratio - round(k * ratio)) < 1e-9), MOST_PERIODS)
    worst = 0.0
    for offset in schedule.times - schedule.times[0]:
        product = np.eye(certificate.plant.n_states)
        for k in range(whole):
            product = error_map(certificate, first + float(offset) + k * length, length, cost) @ product
        radius = np.abs(np.linalg.eigvals(product)).max(initial=0.0) if product.size else 0.0
        worst = max(worst, float(radius ** (1 / whole)))
    return worst


@door
def least_contracting(certificate: Certificate, cost: str = "certificate") -> float:
    """Return the least window, in steps from sample to sample of a period, from which on the true error map contracts.

    Parameters
    ----------
    certificate : Certificate
        On a periodic schedule.
    cost : "certificate" or "paper"

    Returns
    -------
    float [time]
        Least tried length whose spectral radius is below one and stays so for every longer one tried (up to two periods
        and four gaps). Infinite if there is none.
    """
    schedule = certificate.schedule
    if not isinstance(schedule, PeriodicSchedule):
        raise ArgumentError("`certificate` must be on a periodic schedule: a finite one has no long run.")
    lengths = np.unique(np.round(np.cumsum(np.tile(schedule.gaps, 3))[: len(schedule) + 4], 12))
    best = np.inf
    for length in lengths[::-1]:
        if spectral_radius(certificate, float(length), cost) >= 1:
            break
        best = float(length)
    return best


def _problem(certificate: Certificate, factor: float) -> WindowProblem:
    c = certificate
    return window_problem(c.plant, c.schedule, factor * c.P2, factor * c.Qw, c.R, factor * c.Qv, c.eta)


def _along(problem: WindowProblem, start: float, stop: float, seen: Array) -> Array:
    """The error map in the plant's coordinates."""
    n = problem.size
    Y, Phi = np.eye(n), np.eye(n)
    gaps = np.diff(seen, prepend=start, append=stop)
    F, W = problem.flow(gaps)
    crossed = expm_batch(problem.A, gaps)
    for k, tau in enumerate(seen):
        rows = _rows_at(problem, tau)
        Y, Phi = F[k] @ Y @ F[k].T + W[k], crossed[k] @ Phi
        gain = np.linalg.solve(np.eye(len(rows)) + rows @ Y @ rows.T, rows @ Y).T
        Y, Phi = update(Y, rows), (np.eye(n) - gain @ rows) @ Phi
    return np.asarray(np.linalg.solve(problem.root.T, crossed[-1] @ Phi @ problem.root.T), dtype=np.float64)


def _rows_at(problem: WindowProblem, tau: float) -> Array:
    """What the sample nearest to tau measures."""
    since, period = problem.times - problem.times[0], problem.period
    phase = (tau - problem.times[0]) % period if period else tau - problem.times[0]
    nearest = int(np.argmin(np.abs(np.append(since, period or np.inf) - phase)))
    rows: Array = problem.rows[nearest % problem.count]
    return rows
