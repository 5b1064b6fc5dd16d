"""Sigma of many candidate schedules at once, at the window positions where it can be least.

Search only: rows come from a table and positions between events are a few per gap. What is claimed in
the end is proven by `observability.window_sigma`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design.design.gram import lags
from sampling_design.design.problem import DesignProblem

Array = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Positions:
    """Window starts of each schedule: `at` (B, q), as combinations of the sample times plus a constant.

    `first`, `second` (B, q) index the two events that a start lies between, `share` (q,) its place.
    Events are the samples (a window starts there: one leaves) and, where the window is no multiple of
    the period, the samples minus the window (one enters).
    """

    at: Array
    first: npt.NDArray[np.intp]
    second: npt.NDArray[np.intp]
    share: Array
    closed: tuple[str, ...]


def positions(problem: DesignProblem, times: Array, inner: int = 1) -> Positions:
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
    return Positions(
        at.reshape(shape),
        spread((order % k)[:, None, :], (times.shape[0], shares.size, q)).reshape(shape),
        spread((following % k)[:, None, :], (times.shape[0], shares.size, q)).reshape(shape),
        np.repeat(shares, q),
        tuple(np.repeat(["right", "left", *["right"] * inner], q)),
    )


def window_grams(problem: DesignProblem, times: Array, where: Positions) -> Array:
    """Scaled Gram matrices (B, q, n, n) of the schedules `times` (B, k) in their windows."""
    n, p = problem.plant.n_states, problem.plant.n_outputs
    mask = problem.mask(times)
    parts = []
    left = np.array([c == "left" for c in where.closed])
    for closed, chosen in (("right", ~left), ("left", left)):
        start = where.at[:, chosen, None]
        r, inside = lags(times[:, None, :], start, problem.window, problem.period, closed)
        shown = inside[..., None] & mask[:, None, :, None, :]
        c = problem.rows.rows(r) * shown[..., None]
        c = c.reshape(*start.shape[:2], -1, n) if c.size else np.zeros((*start.shape[:2], p, n))
        parts.append(np.swapaxes(c, -1, -2) @ c)
    grams = np.empty((times.shape[0], left.size, n, n))
    grams[:, ~left], grams[:, left] = parts
    return grams


def worst_sigma2(problem: DesignProblem, times: Array, inner: int = 1) -> Array:
    """Least sigma^2 over the positions, for each schedule (B, k) of sorted times."""
    result = np.empty(times.shape[0])
    chunk = max(1, 40000 // (times.shape[1] * 4 * max(1, times.shape[1])))
    for low in range(0, times.shape[0], chunk):
        part = times[low : low + chunk]
        sigma2, _ = problem.rows.least(window_grams(problem, part, positions(problem, part, inner)))
        result[low : low + chunk] = sigma2.min(axis=1)
    return result
