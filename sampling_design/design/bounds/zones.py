"""Where the samples of a period can lie, counted from the sample after which all others come late, or early.

Let s_i be the samples of an endless schedule, k to a period P, and D_i = s_i - i P/k: how late sample i is
against even spacing. D repeats after k samples. From the sample where D is least, follower j comes after
j P/k or more, for every j at once (the cycle lemma); from the sample where D is largest, after j P/k or
less. That sample is the origin: sample 0. Where the requirement may be shifted by its `least_shift`, the origin lies
in [0, that] from where the problem's periods begin (`DesignProblem.origin`), at 0 alone if it may be shifted at will.
Where it may not be shifted by less than a period, or times are fixed, samples are "sorted": counted from the first of
that period, or from the first fixed one in it, and every way to share out the others between the fixed ones is a region
of its own. Every sample then has a zone, and boxes of zones are cut in two again and again (`branching`).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import comb
from typing import Literal, NamedTuple

import numpy as np

from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.records.arrays import Array, Mask

Side = Literal["late", "early", "sorted"]

MOST_REGIONS = 64  # ways to share out samples between fixed times beyond which zones are not tried
TINY = 1e-12  # slack of every zone, in periods: rounding in a schedule's times cannot carry a sample out of its zone
MARGIN = 0.15  # of a zone: a cut leaves at least that much on either side
_EMPTY = 1e-9  # zones that miss each other by more than this share of the period hold no schedule


class Cut(NamedTuple):
    """The sample whose zone is cut next, where, and how wide its zone is."""

    place: int
    at: float
    width: float


def zoned(problem: DesignProblem) -> bool:
    """Whether zones can bound the problem: two samples or more, not all of them fixed, and not too many regions."""
    spare, fixed = problem.samples - problem.fixed.size, problem.fixed.size
    return problem.samples >= 2 and spare > 0 and comb(spare + fixed - 1, spare) <= MOST_REGIONS


def sides(problem: DesignProblem) -> tuple[Side, ...]:
    """From which sample the others can be counted."""
    if problem.fixed.size > (1 if problem.least_shift == 0 else 0) or problem.least_shift == problem.period:
        return ("sorted",)
    return ("late", "early")


def regions(problem: DesignProblem, side: Side) -> list[Array]:
    """Boxes (k, 2) that together hold every schedule, counted from a sample that `side` names; empty ones left out."""
    if side != "sorted":
        return [origin_zones(problem, side)]
    found = [_between(problem, at) for at in _shared_out(problem.samples, problem.fixed.size)]
    return [zones for zones in found if tightened(problem, zones, side) is not None]


def region_of(problem: DesignProblem, side: Side, zones: Array) -> int | None:
    """Which of the regions a box lies in; None where it lies in none."""
    tiny = 2 * TINY * problem.period
    for index, region in enumerate(regions(problem, side)):
        if np.all(zones[:, 0] >= region[:, 0] - tiny) and np.all(zones[:, 1] <= region[:, 1] + tiny):
            return index
    return None


def origin_zones(problem: DesignProblem, side: Side) -> Array:
    """(k, 2): where the origin and its followers lie, all other samples being late (or early) after it."""
    k, P = problem.samples, problem.period
    j = np.arange(k)
    first, last = j * problem.spacing, P - (k - j) * problem.spacing
    even = j * (P / k)
    low, high = (even, last) if side == "late" else (first, even)
    low, high = np.minimum(low, high), np.maximum(low, high) + problem.least_shift
    low[0], high[0] = 0.0, max(problem.least_shift - problem.shut, 0.0)
    return np.stack([low - TINY * P, high + TINY * P], axis=1) + begins(problem, side)


def begins(problem: DesignProblem, side: Side) -> float:
    """The time from which zones are counted: 0 where the requirement may be shifted at will."""
    return problem.origin if side == "sorted" or problem.least_shift > 0 else 0.0


def _shared_out(samples: int, fixed: int) -> Iterator[tuple[int, ...]]:
    """Which samples of a period are the fixed ones, the first of them first: every way there is."""
    if fixed == 0:
        yield ()
    for rest in combinations(range(1, samples), max(fixed - 1, 0)) if fixed else ():
        yield (0, *rest)


def _between(problem: DesignProblem, at: tuple[int, ...]) -> Array:
    """Zones of the sorted samples of which those `at` are the fixed ones; without any, of a period from the origin."""
    k, P, gap, origin = problem.samples, problem.period, problem.spacing, problem.origin
    if not at:
        j = np.arange(k)
        return np.stack([j * gap - TINY * P, P - problem.shut - (k - 1 - j) * gap + TINY * P], axis=1) + origin
    zones = np.empty((k, 2))
    ends = [*at, k]
    before = problem.fixed < origin - TINY * P  # counted in the next period
    ahead = np.concatenate([problem.fixed[~before], problem.fixed[before] + P])
    times = np.append(ahead, ahead[0] + P)
    for place, index in enumerate(at):
        a, b = times[place], times[place + 1]
        inside = np.arange(1, ends[place + 1] - index)
        zones[index] = a
        zones[index + inside, 0] = a + inside * gap
        zones[index + inside, 1] = b - (ends[place + 1] - index - inside) * gap
    return np.stack([zones[:, 0] - TINY * P, zones[:, 1] + TINY * P], axis=1)


def tightened(problem: DesignProblem, zones: Array, side: Side) -> Array | None:
    """The zones less what origin, spacing and allowed times rule out, or None where they hold no schedule."""
    k, P, gap = problem.samples, problem.period, problem.spacing
    order = np.arange(k)
    even, apart, room = order * (P / k), order * gap, P - (k - order) * gap
    low, high = zones[:, 0].copy(), zones[:, 1].copy()
    for _ in range(2):  # what one sample loses its neighbours lose; a second round finds most of the rest
        if problem.least_shift > 0:  # not every time is allowed for every output
            kinds, which = problem.kinds
            for kind, outputs in enumerate(kinds):
                same = which == kind
                low[same], high[same] = _allowed(problem, outputs, low[same], high[same])
        if side == "late":  # s_j >= s_0 + j P/k
            low, high[0] = np.maximum(low, low[0] + even), np.min(high - even)
        elif side == "early":
            high, low[0] = np.minimum(high, high[0] + even), np.max(low - even)
        low = np.maximum.accumulate(low - apart) + apart
        high = np.minimum.accumulate((high - apart)[::-1])[::-1] + apart
        high[1:] = np.minimum(high[1:], high[0] + room[1:])  # the next period's first sample is a spacing away too
        low[0] = max(low[0], float(np.max(low[1:] - room[1:])))
        if np.any(high < low - _EMPTY * P):
            return None
    return within_period(problem, np.stack([np.minimum(low, high), np.maximum(low, high)], axis=1))


def within_period(problem: DesignProblem, zones: Array) -> Array:
    """Zones less their slack before the origin, and after what is allowed has repeated from there.

    By the count the first sample is no earlier, nor that much later; where samples are sorted none is. So none measures
    in its slack what closes at the one end, or opens at the other.
    """
    if problem.fixed.size or problem.least_shift == 0:
        return zones
    found, tiny, end = zones.copy(), 4 * TINY * problem.period, problem.origin + problem.least_shift
    last = -1 if problem.least_shift == problem.period else 0
    if abs(found[0, 0] - problem.origin) <= tiny:
        found[0] = np.maximum(found[0], problem.origin)
    if abs(found[last, 1] - end) <= tiny:
        found[last] = np.minimum(found[last], np.nextafter(end, 0.0))
    return found


def _allowed(problem: DesignProblem, outputs: Mask, low: Array, high: Array) -> tuple[Array, Array]:
    """The ends of zones moved inwards to times at which some of the `outputs` may be measured; crossed if none are."""
    tiny, open_ = TINY * problem.period, problem.intervals_of(outputs)
    if not open_.size:
        return high + problem.period, low - problem.period
    spans = np.concatenate([open_ + cycle * problem.period for cycle in (-1, 0, 1, 2)])
    after = np.minimum(np.searchsorted(spans[:, 1], low - tiny), len(spans) - 1)
    before = np.maximum(np.searchsorted(spans[:, 0], high + tiny, side="right") - 1, 0)
    return np.maximum(low, spans[after, 0]), np.minimum(high, spans[before, 1])


def halves(zones: Array, index: int, cut: float) -> tuple[Array, Array]:
    """The box cut in two at `cut` along sample `index`."""
    below, above = zones.copy(), zones.copy()
    below[index, 1] = above[index, 0] = cut
    return below, above


def covered(problem: DesignProblem, region: Array, boxes: list[Array], side: Side) -> bool:
    """Whether boxes that came from cutting `region` again and again leave no schedule of it out.

    Found by looking for the cuts again: a place where no box is cut through, and then each half alone.
    """
    if tightened(problem, region, side) is None:
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
                return covered(problem, left, below, side) and covered(problem, right, above, side)
    return False
