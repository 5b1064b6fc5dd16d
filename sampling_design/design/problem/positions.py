"""Sigma of many candidate schedules at once, at the window positions where it can be least.

Search only: rows come from a table and positions between events are a few per gap. What is claimed in
the end is proven by `observability.window_sigma`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.orthogonal_flow import BATCH_NUMBERS
from sampling_design.design.problem.sliding import SlidingSums
from sampling_design.records.arrays import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class WindowPositions:
    """Window starts of each schedule: `at` (B, q), as combinations of the sample times plus a constant.

    `first`, `second` (B, q) index the two events that a start lies between, `share` (q,) its place.
    Events are the samples (a window starts there: one leaves) and, where the window is no multiple of
    the period, the samples minus the window (one enters).
    """

    at: Array
    first: Index
    second: Index
    share: Array
    closed: tuple[str, ...]


def positions(problem: DesignProblem, times: Array, inner: int = 1) -> WindowPositions:
    """Limits just after and just before every event, and `inner` places inside every gap between events."""
    period, k = problem.period, times.shape[1]
    ratio = problem.window / period
    events = times
    if abs(ratio - round(ratio)) > 1e-11:
        events = np.concatenate([times, np.mod(times - problem.window, period)], axis=1)
    order = np.argsort(events, axis=1)
    events = np.take_along_axis(events, order, axis=1)
    gaps = np.diff(np.concatenate([events, events[:, :1] + period], axis=1), axis=1)
    shares = np.concatenate([[0.0, 1.0], (np.arange(inner) + 1) / (inner + 1)])
    at = events[:, None, :] + shares[:, None] * gaps[:, None, :]
    following = np.roll(order, -1, axis=1)
    q = events.shape[1]
    shape = (times.shape[0], shares.size * q)
    spread = np.broadcast_to
    return WindowPositions(
        at.reshape(shape),
        spread((order % k)[:, None, :], (times.shape[0], shares.size, q)).reshape(shape),
        spread((following % k)[:, None, :], (times.shape[0], shares.size, q)).reshape(shape),
        np.repeat(shares, q),
        tuple(np.repeat(["right", "left", *["right"] * inner], q)),
    )


def window_grams(problem: DesignProblem, times: Array, where: WindowPositions, used: Mask | None = None) -> Array:
    """Scaled Gram matrices (B, q, n, n) of the schedules `times` (B, k) in their windows.

    `used` (B, k, p) says which outputs each sample measures; default what the problem says.
    """
    mask = problem.measured(times) if used is None else used
    left = np.array([c == "left" for c in where.closed])
    return SlidingSums(problem.rows, times, mask, problem.period).at(where.at, left)


def worst_sigma2(problem: DesignProblem, times: Array, inner: int = 1, used: Mask | None = None) -> Array:
    """Least sigma^2 over the positions, for each schedule (B, k) of sorted times; `used` as for `window_grams`."""
    if problem.orthogonal_flow is None or not times.size:
        return _worst_of_positions(problem, times, inner, used)
    result, sure = problem.orthogonal_flow.worst(times, problem.measured(times) if used is None else used)
    if not sure.all():
        result[~sure] = _worst_of_positions(problem, times[~sure], inner, None if used is None else used[~sure])
    return result


def _worst_of_positions(problem: DesignProblem, times: Array, inner: int, used: Mask | None) -> Array:
    """The same for any plant, a few positions in every gap."""
    result = np.empty(times.shape[0])
    chunk = max(1, BATCH_NUMBERS // (times.shape[1] * (12 + 4 * inner) * problem.plant.n_states**2))
    for low in range(0, times.shape[0], chunk):
        part = times[low : low + chunk]
        mask = None if used is None else used[low : low + chunk]
        sigma2 = problem.rows.least_sigma2(window_grams(problem, part, positions(problem, part, inner), mask))
        result[low : low + chunk] = sigma2.min(axis=1)
    return result
