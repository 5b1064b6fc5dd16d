"""Where the samples of a lap can lie, seen from the sample after which all others come late, or early.

Let s_i be the samples of an endless schedule, k to a period P, and D_i = s_i - i P/k: how late sample i is
against even spacing. D repeats after k samples. From the sample where D is least, sample j follows after
j P/k or more, for every j at once (the cycle lemma); from the sample where D is largest, after j P/k or
less. Where the requirement may be shifted in time, that sample may be turned to 0, and every follower then
has a zone of half the length that it had. Boxes of zones are cut in two again and again (`branching`).
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sampling_design.design.problem import DesignProblem

Array = npt.NDArray[np.floating[Any]]
Side = Literal["late", "early"]
SIDES: tuple[Side, ...] = ("late", "early")

TINY = 1e-12
"""Slack of every zone, in periods: rounding in a schedule's times cannot carry a sample out of its zone."""

_EMPTY = 1e-9  # zones that miss each other by more than this share of the period hold no schedule


def turnable(problem: DesignProblem) -> bool:
    """Whether every schedule may be turned: nothing forbidden, at most one fixed time, two samples or more."""
    free = not problem.forbidden.size and all(a is None for a in problem.available)
    return free and problem.fixed.size <= 1 and problem.samples >= 2


def origin_zones(problem: DesignProblem, side: Side) -> Array:
    """(k-1, 2): where followers 1..k-1 lie after the sample from which all come late, or early."""
    k, P = problem.samples, problem.period
    j = np.arange(1, k)
    first, last = j * problem.spacing, P - (k - j) * problem.spacing
    even = j * (P / k)
    low, high = (even, last) if side == "late" else (first, even)
    return np.stack([np.minimum(low, high) - TINY * P, np.maximum(low, high) + TINY * P], axis=1)


def tightened(problem: DesignProblem, zones: Array) -> Array | None:
    """The zones less what the spacing rules out, or None where they hold no schedule."""
    k, P, gap = problem.samples, problem.period, problem.spacing
    order = np.arange(1, k)
    low = np.maximum(np.maximum.accumulate(zones[:, 0] - order * gap), -TINY * P) + order * gap
    room = np.minimum.accumulate((zones[:, 1] + (k - order) * gap)[::-1])[::-1]
    high = np.minimum(room, P * (1 + TINY)) - (k - order) * gap
    if np.any(high < low - _EMPTY * P):
        return None
    return np.stack([np.maximum(low, 0.0), np.clip(np.maximum(high, low), 0.0, P)], axis=1)


def halves(zones: Array, index: int, cut: float) -> tuple[Array, Array]:
    """The box cut in two at `cut` along follower `index`."""
    below, above = zones.copy(), zones.copy()
    below[index, 1] = above[index, 0] = cut
    return below, above


def covered(problem: DesignProblem, region: Array, boxes: list[Array]) -> bool:
    """Whether boxes that came from cutting `region` again and again leave no schedule of it out.

    Found by looking for the cuts again: a place where no box is cut through, and then each half alone.
    """
    if tightened(problem, region) is None:
        return True
    tiny = TINY * problem.period
    if any(np.all(b[:, 0] <= region[:, 0] + tiny) and np.all(b[:, 1] >= region[:, 1] - tiny) for b in boxes):
        return True
    for index in range(region.shape[0]):
        for cut in np.unique([end for b in boxes for end in b[index]]):
            if not region[index, 0] + tiny < cut < region[index, 1] - tiny:
                continue
            below = [b for b in boxes if b[index, 1] <= cut]
            above = [b for b in boxes if b[index, 0] >= cut]
            if len(below) + len(above) == len(boxes):
                left, right = halves(region, index, float(cut))
                return covered(problem, left, below) and covered(problem, right, above)
    return False


def lateness(problem: DesignProblem, zones: Array) -> Array:
    """(k, 2): bounds of D_0 = 0 and of D_j, how late each follower can be against even spacing."""
    even = np.arange(1, problem.samples) * (problem.period / problem.samples)
    return np.vstack([np.zeros((1, 2)), zones - even[:, None]])


def follower_zones(problem: DesignProblem, zones: Array) -> Array:
    """(k-1, 2): where follower i of ANY sample can lie, if the followers of the origin lie in `zones`."""
    k, P, gap = problem.samples, problem.period, problem.spacing
    late = lateness(problem, zones)
    found = np.empty((k - 1, 2))
    for i in range(1, k):
        ahead = np.roll(late, -i, axis=0)  # D is periodic: how late the i-th follower of each sample is
        found[i - 1] = np.min(ahead[:, 0] - late[:, 1]), np.max(ahead[:, 1] - late[:, 0])
    order = np.arange(1, k)
    found += (order * (P / k))[:, None]
    low = np.maximum(found[:, 0], order * gap) - TINY * P
    high = np.minimum(found[:, 1], P - (k - order) * gap) + TINY * P
    return np.stack([np.maximum(low, 0.0), np.minimum(np.maximum(high, low), P)], axis=1)


def widest_gap(problem: DesignProblem, zones: Array) -> float:
    """Longest gap that the zones leave room for."""
    low, high = np.append(0.0, zones[:, 0]), np.append(zones[:, 1], problem.period)
    return float(np.max(high - low))
