"""Where the samples of a period can lie, counted from the sample after which all others come late, or early.

Let s_i be the samples of an endless schedule, k to a period P, and D_i = s_i - i P/k: how late sample i is
against even spacing. D repeats after k samples. From the sample where D is least, follower j comes after
j P/k or more, for every j at once (the cycle lemma); from the sample where D is largest, after j P/k or
less. That sample is the origin: sample 0. Where the requirement may be shifted by its `least_shift`, the origin lies
in [0, that] from where the problem's periods begin (`DesignProblem.origin`), at 0 alone if it may be shifted at will.
Where it may not be shifted by less than a period, or times are fixed, samples are "sorted": counted from the first of
that period, or from the first fixed one in it, and every way to share out the others between the fixed ones is a region
of its own. Every sample then has a zone, and boxes of zones are cut in two again and again (`branching`).

Where the flow turns states and stretches none, the schedules in a box of zones are bounded by their order alone. Seen
from time 0, window m, which begins just before sample m, holds the samples from m on, and those before it a period
later: a sum in which each sample has its own term, wherever its zone and those of others overlap. For psd Z_m with
sum <Z_m, I> = 1 every schedule has

    sigma^2 <= sum over its samples of q_i(s_i),   q_i(t) = <sum_{m<=i} Z_m, E(t)> + <sum_{m>i} Z_m, E(t + P)>,

E(t) the Gram matrix of a sample at t and whole periods after it, as often as the window holds them; so it is at most
the sum of what each q_i is at most in its zone. The best Z belong to weights of every sample on its zone, by which the
least eigenvalue of all windows is largest (`eigenvalue_program`).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import comb
from typing import Literal, NamedTuple

import numpy as np

from sampling_design.design.bounds.weak_duality import rooted
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import EPS, MANY_STATES, ROUNDING_MARGIN
from sampling_design.design.problem.orthogonal_flow import OrthogonalFlowWindows, squares
from sampling_design.numerics.eigenvalue_program import EigenvalueBracket, MixedMatrices, brackets
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import Budget

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


_APART = 1.1  # radians of the fastest quadratic form between two points of a zone: the bound looks between them
_CELL = 0.09  # radians between two times at which q is evaluated for the bound
_LOOSE, _ORDERS = 1e-4, 9  # of q: more is not left to what derivatives are at most, up to the eighth
_NEAR = 3e-3  # relative: a relaxation that is not below its aim ends when it is known so well
_CONVERGED = 1e-3  # relative: and any other
_SHARE = 1e-6  # of a sample that lies on either side of a cut, at least


def flow_of(problem: DesignProblem) -> OrthogonalFlowWindows | None:
    """The windows that follow from the order of samples alone, of many states; None where more decides what they see.

    Of few states boxes become so small that what is left of them to second order (`local_bound`) says more.
    """
    alike = problem.is_shift_invariant and not problem.late and not problem.is_costly
    return problem.orthogonal_flow if alike and problem.plant.n_states > MANY_STATES else None


def relax_ordered(
    problem: DesignProblem, flow: OrthogonalFlowWindows, zones: Array, aim: float, budget: Budget
) -> tuple[Array, Cut]:
    """Multipliers (k, n, n) for schedules in `zones`, near a sigma that is aimed at, and where to cut next."""
    points = _OrderedPoints(flow, zones)
    found: EigenvalueBracket | None = None
    for found in brackets(points.program):
        left = found.total - found.t
        if budget.over or left <= _CONVERGED * abs(found.t) or (found.t > aim**2 and left <= _NEAR * found.t):
            break
        if found.total <= aim**2 and ordered_bound(problem, flow, found.Z, zones) <= aim:
            break
    assert found is not None
    return found.Z, points.cut(found)


class _OrderedPoints:
    """Times in the zones, each sample's own, and what windows that begin no later, or later, see of it there."""

    def __init__(self, flow: OrthogonalFlowWindows, zones: Array) -> None:
        self.zones = zones
        self.times, self.owner = _grid(zones, _APART / flow.fastest)
        repeats = [_rows(flow, self.times + r * flow.period) for r in range(flow.repeats + 1)]
        self.measured = np.stack([np.concatenate(repeats[:-1], axis=1), np.concatenate(repeats[1:], axis=1)])
        after = np.arange(len(zones))[:, None] > self.owner
        self.rows = self.measured[after.astype(np.intp), np.arange(self.owner.size)]

    @property
    def program(self) -> MixedMatrices:
        """Each sample has its own weights, which sum to one."""
        members = (self.owner == np.arange(len(self.zones))[:, None]).astype(float)
        first = (1 / members.sum(axis=1))[self.owner]
        none, n = np.zeros((0, self.owner.size)), self.rows.shape[-1]
        return MixedMatrices(self.rows, first, members, np.ones(len(members)), none, none[:, 0], np.eye(n))

    def cut(self, found: EigenvalueBracket) -> Cut:
        """The sample whose early and late shares differ most for the windows that matter, and its mean time.

        The relaxation gains from mixing schedules what the least eigenvalue is concave: were sample i early in one half
        of them and late in the other, their Gram matrices would differ by D, and the mean of both lies above them by
        <Z, D W^-1 D> to second order.
        """
        k, width = len(self.zones), self.zones[:, 1] - self.zones[:, 0]
        grams = squares(self.measured)
        parts = found.x[:, None] * (self.owner[:, None] == np.arange(k))  # (points, k)
        means = parts.T @ self.times
        at = np.clip(means, self.zones[:, 0] + MARGIN * width, self.zones[:, 1] - MARGIN * width)
        late = parts * (self.times[:, None] >= at)
        shares = np.stack([late.sum(axis=0), (parts - late).sum(axis=0)])
        safe = np.maximum(shares, _SHARE)
        apart = np.einsum("sjab,ji->siab", grams, late / safe[0] - (parts - late) / safe[1])
        n = grams.shape[-1]
        W = np.einsum("mjpa,j,mjpb->mab", self.rows, found.x, self.rows, optimize=True)
        W += EPS * float(np.trace(W, axis1=1, axis2=2).max()) * np.eye(n)
        D = apart[(np.arange(k)[:, None] > np.arange(k)).astype(np.intp), np.arange(k)]  # (windows, samples, n, n)
        gains = np.einsum("miab,miba->i", found.Z[:, None] @ D, np.linalg.solve(W[:, None], D))
        gains = np.where(shares.min(axis=0) > _SHARE, gains * shares[0] * shares[1], 0.0)
        place = int(np.argmax(gains)) if gains.max() > 0 else int(np.argmax(width))
        return Cut(place, float(at[place]), float(width[place]))


def ordered_bound(problem: DesignProblem, flow: OrthogonalFlowWindows, Z: Array, zones: Array) -> float:
    """Bound sigma of every schedule whose samples lie in `zones`, by psd Z (k, n, n) whose traces sum to one."""
    earlier, C = np.cumsum(Z, axis=0), problem.plant.C
    times, owner = _grid(zones, _CELL / flow.fastest)
    turned = flow.fastest * flow.period * (flow.repeats + 1)
    lost = 4 * flow.stretch + ROUNDING_MARGIN * C.shape[1] * EPS * (1 + turned)  # of rows, as a share of their size
    total = 0.0
    for i in range(len(zones)):
        pair = earlier[i], earlier[-1] - earlier[i]
        high = sum(float(np.linalg.norm(Y, 2)) for Y in pair) * flow.repeats * float(np.sum(C**2))
        total += _highest(flow, pair, times[owner == i], high) + high * lost
    return rooted(problem, total)


def _highest(flow: OrthogonalFlowWindows, pair: tuple[Array, Array], times: Array, high: float) -> float:
    """What q is at most between `times` of even steps h, for the multipliers of its two terms; never above `high`.

    It exceeds both ends of a step by at most h^2/8 max(-q''), each derivative changes by at most h/2 times the most of
    the next, and q holds no frequency beyond w, twice the fastest mode's, so that the j-th is at most w^j `high`
    (Bernstein). As many are worked out as it takes until what is left is nothing beside q.
    """
    h, w = float(times[-1] - times[0]) / max(times.size - 1, 1), flow.fastest
    rows = [_rows(flow, times + r * flow.period) for r in range(flow.repeats + 1)]
    chains = [[np.concatenate(each, axis=1)] for each in (rows[:-1], rows[1:])]
    weighted = [[c[0] @ Y] for c, Y in zip(chains, pair, strict=True)]
    top = float(np.max(_derivative(chains, weighted, 0)))
    most: list[float] = []  # of -q'', and of the sizes of the derivatives after it
    for order in range(2, _ORDERS):
        for chain, weights, Y in zip(chains, weighted, pair, strict=True):
            while len(chain) <= order:
                chain.append(chain[-1] @ flow.skew)
                weights.append(chain[-1] @ Y)
        values = _derivative(chains, weighted, order)
        most.append(max(float(np.max(-values)), 0.0) if order == 2 else float(np.max(np.abs(values))))
        left = (h / 2) ** (order - 1) * w ** (order + 1) * high
        if left * h**2 / 8 <= _LOOSE * top:
            break
    rest = sum((h / 2) ** place * each for place, each in enumerate(most)) + left
    return top + h**2 / 8 * rest


def _derivative(chains: list[list[Array]], weighted: list[list[Array]], order: int) -> Array:
    """The derivative of q of that order, from those of the rows, by Leibniz's rule."""
    parts = [
        comb(order, i) * np.sum(weights[i] * chain[order - i], axis=(1, 2))
        for chain, weights in zip(chains, weighted, strict=True)
        for i in range(order + 1)
    ]
    return np.asarray(sum(parts))


def _rows(flow: OrthogonalFlowWindows, times: Array) -> Array:
    return flow.rows(times, np.ones((times.size, len(flow.outputs)), dtype=bool))


def _grid(zones: Array, apart: float) -> tuple[Array, Index]:
    """Times at most that far apart in every zone, its ends included, and whose they are."""
    counts = np.where(zones[:, 1] > zones[:, 0], np.ceil((zones[:, 1] - zones[:, 0]) / apart), 0).astype(int) + 1
    grid = [np.linspace(a, b, count) for (a, b), count in zip(zones, counts.tolist(), strict=True)]
    return np.concatenate(grid), np.repeat(np.arange(len(zones)), counts)
