"""Bound of all schedules whose samples lie in given zones.

A relaxation on points of the zones gives multipliers, a chain over time cells the bound. Of the windows
that might matter only those are posed that do: each round adds the ones that the weights see least of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.design.bounds.relaxation import (
    JUST_BESIDE,
    LEAST_SECONDS,
    Relaxation,
    least_points,
    mixed,
    rows_at,
    solve_relaxation,
)
from sampling_design.design.bounds.weak_duality import (
    best_layers,
    cell_values,
    cells,
    jump_times,
    piece_edges,
    profile,
    roofs,
    rooted,
)
from sampling_design.design.bounds.zones import MARGIN, TINY, Cut, within_period
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.schedules.sensor import joined

_MOST_POINTS = 480  # however many cycles a window holds: cost grows with its square, and the bound is true with any
_POINTS = 48  # grid times of one relaxation at least, spread over the zones
_BETWEEN = 36  # window starts beside the zones' ends
_REGULAR = 1e-12  # of its trace, added to a Gram matrix before it is divided by
_TOLERANCE = 1e-5  # asked of the solver: hundreds of boxes, each with a bound that is true whatever it answers
_FINEST = 20000  # cells per period at most
_FIRST, _ADDED = 10, 8  # windows of the first round where no hints are given, and of each further round
_ROUNDS, _FIRST_ROUNDS = 2, 6  # with and without hints: what mattered for a wider box mostly matters again
_MISSED = 0.02  # short by that share of the value, a window was missed by the hints: more rounds, as without
_OBSERVED_ENOUGH = 1e-3  # a window whose sigma^2 falls short of the value by less than this share is seen well enough
NARROW = 1e-4  # of a mean gap: zones no longer than that are cut no further
_MATTERS = 1e-3  # share of all multipliers below which a window has no say


def relax_zones(problem: DesignProblem, zones: Array, hints: Array, budget: Budget = ENDLESS) -> tuple[Relaxation, Cut]:
    """Weights on points of the zones, and the cut that gains most.

    `hints` are window starts that mattered for a wider box.
    Cut short at `budget`; multipliers of any quality prove a bound.
    """
    starts = _window_starts(problem, zones, hints)
    points, step = _points(problem, zones, starts)
    times, owner = points.times, points.owner
    rows = rows_at(problem, times, starts, points.mask)
    ordered, limits = _order_rows(problem, zones, points, step)
    posed = np.arange(starts.size) < hints.size
    if not hints.size:
        posed[:: max(1, starts.size // _FIRST)] = True
    for done in range(1, _FIRST_ROUNDS + 1):
        used = (owner < 0) | posed[owner]
        parts = rows[posed][:, used], (ordered[:, used], limits), float(problem.samples)
        left = budget.seconds_left(LEAST_SECONDS)
        found = solve_relaxation(problem, times[used], starts[posed], *parts, left, tolerance=_TOLERANCE)
        if budget.over:
            break
        sigma2 = np.where(posed, np.inf, problem.rows.least(mixed(rows[:, used], found.weights))[0])
        worst = np.argsort(sigma2, kind="stable")[:_ADDED]
        worst = worst[sigma2[worst] < found.value * (1 - _OBSERVED_ENOUGH)]
        if not worst.size or (hints.size and done >= _ROUNDS and sigma2[worst[0]] > found.value * (1 - _MISSED)):
            break
        posed[worst] = True
    return found, _most_divided(problem, zones, found, points.of(used))


def _window_starts(problem: DesignProblem, zones: Array, hints: Array) -> Array:
    """Hints first; then just before and just after every zone, and some between, in [0, period)."""
    P = problem.period
    early, late = zones[:, 0] - JUST_BESIDE * P, zones[:, 1] + JUST_BESIDE * P
    between = (np.arange(_BETWEEN) + 0.5) * (P / _BETWEEN)
    starts = np.concatenate([early, late, early - problem.window, between])
    rest = np.unique(np.mod(problem.on_closings(starts, 2 * JUST_BESIDE * P), P))
    return np.concatenate([hints, rest[~np.isin(rest, hints)]])


@dataclass(frozen=True, eq=False)
class _ZonePoints:
    """Times at which samples may lie, kind by kind (see `DesignProblem.kinds`), and what they measure there.

    `owner` is the window start just after which the time lies, or -1.
    """

    times: Array
    kind: Index
    owner: Index
    mask: Mask

    def of(self, used: Mask) -> _ZonePoints:
        """Some of them."""
        return _ZonePoints(self.times[used], self.kind[used], self.owner[used], self.mask[used])


def _points(problem: DesignProblem, zones: Array, starts: Array) -> tuple[_ZonePoints, float]:
    """Allowed times in the zones, every end included, and the widest step between them.

    Just after each window start, where what it sees jumps up, there is one more.
    """
    stretches = joined(zones).tolist()
    total = max(sum(b - a for a, b in stretches), TINY * problem.period)
    wanted = int(np.clip(least_points(problem), _POINTS, _MOST_POINTS))
    counts = [max(3, int(np.ceil(wanted * (b - a) / total)) + 1) for a, b in stretches]
    grid = [np.linspace(a, b, count) for (a, b), count in zip(stretches, counts, strict=True)]
    step = max((b - a) / (count - 1) for (a, b), count in zip(stretches, counts, strict=True))
    fixed = np.unique(np.concatenate([*grid, zones.ravel(), _ends(problem, zones)]))
    after = np.concatenate([starts, starts + problem.period]) + 2 * JUST_BESIDE * problem.period
    kept_here = np.any((after[:, None] > zones[:, 0]) & (after[:, None] < zones[:, 1]), axis=1)
    times = np.concatenate([fixed, after[kept_here]])
    owner = np.concatenate([np.full(fixed.size, -1), np.flatnonzero(kept_here) % starts.size])
    order = np.argsort(times, kind="stable")
    there = problem.mask(times[order])
    found = []
    for kind, outputs in enumerate(problem.kinds[0]):
        kept = np.any(there & outputs, axis=1)
        i = order[kept]
        found.append(_ZonePoints(times[i], np.full(i.size, kind), owner[i], there[kept] & outputs))
    joint = (np.concatenate([getattr(part, name) for part in found]) for name in ("times", "kind", "owner", "mask"))
    return _ZonePoints(*joint), step


def _ends(problem: DesignProblem, zones: Array) -> Array:
    """Ends of the allowed intervals, as far as they lie in the zones; the later end just inside."""
    if problem.is_shift_invariant:
        return np.zeros(0)
    open_ = np.concatenate([problem.intervals_of(outputs) for outputs in problem.kinds[0]])
    inside = np.stack([open_[:, 0], open_[:, 1] - JUST_BESIDE * problem.period])
    ends = np.concatenate([inside.ravel() + cycle * problem.period for cycle in (0, 1)])
    return ends[np.any((ends[:, None] > zones[:, 0]) & (ends[:, None] < zones[:, 1]), axis=1)]


def _order_rows(problem: DesignProblem, zones: Array, points: _ZonePoints, step: float) -> tuple[Array, Array]:
    """Rows and limits: spacing, and as many samples of a kind before each zone's end as have to lie there."""
    tiny, roof = 1e-9 * problem.period, max(1.0, step / problem.spacing)
    t = points.times[None, :]
    after = points.times if len(problem.kinds[0]) == 1 else np.unique(points.times)
    crowd = (t >= after[:, None] - tiny) & (t < after[:, None] + problem.spacing - tiny)
    rows, limits = [crowd], [np.full(len(crowd), roof)]
    for kind in range(len(problem.kinds[0])):
        zone, same = zones[problem.kinds[1] == kind], points.kind == kind
        alone = int(len(zone) == problem.samples)  # nothing lies before the first zone then, nor after the last
        last = len(zone) - alone
        reached, ahead = (t <= zone[:last, 1:] + tiny) & same, (t < zone[alone:, :1] - tiny) & same
        rows += [-1.0 * reached, ahead]
        limits += [-np.arange(1.0, last + 1), np.arange(float(alone), len(zone))]
    return np.vstack(rows), np.concatenate(limits)


def matters(problem: DesignProblem, found: Relaxation) -> Array:
    """The window starts whose multipliers have a say."""
    shares = np.einsum("mij,ij->m", found.Z, problem.rows.N) * problem.rows.unit
    return np.asarray(found.starts[shares > _MATTERS])


def _most_divided(problem: DesignProblem, zones: Array, found: Relaxation, points: _ZonePoints) -> Cut:
    """The sample whose early and late shares differ most for the windows that matter, its mean time, its zone's width.

    The relaxation gains from mixing schedules what the least eigenvalue is concave. Were sample i early
    in one half of them and late in the other, their Gram matrices would differ by D, and the mean of both
    lies above them by <Z, D W^-1 D> to second order: what a cut between the two takes away.
    """
    k = problem.samples
    kept_here = np.isin(found.starts, matters(problem, found))
    starts, Z = found.starts[kept_here], found.Z[kept_here]
    rows = rows_at(problem, points.times, starts, points.mask)
    W = mixed(rows, found.weights)
    size = float(np.trace(W, axis1=1, axis2=2).max(initial=0.0))  # a window may see nothing at all
    W = W + _REGULAR * max(size, np.finfo(float).tiny / _REGULAR) * np.eye(W.shape[-1])
    gains, cuts, width = np.zeros(k), zones.mean(axis=1), zones[:, 1] - zones[:, 0]
    which = problem.kinds[1]
    for i in np.flatnonzero(width > NARROW * problem.period / k):
        same, before = which == which[i], int(np.sum(which[:i] == which[i]))
        total = np.append(0.0, np.cumsum(np.where(points.kind == which[i], found.weights, 0.0)))
        total *= np.sum(same) / max(float(total[-1]), 1e-300)
        share = np.maximum(np.minimum(total[1:], before + 1) - np.maximum(total[:-1], before), 0.0)
        if share.sum() <= 0:
            continue
        cuts[i] = share @ found.times / share.sum()
        late = found.times >= cuts[i]
        parts = [share * side / max(float((share * side).sum()), 1e-300) for side in (late, ~late)]
        D = mixed(rows, parts[0] - parts[1])
        weight = (share * late).sum() * (share * ~late).sum()
        gains[i] = weight * float(np.einsum("mab,mbc,mca->", Z, D, np.linalg.solve(W, D)))
    index = int(np.argmax(gains)) if gains.max() > 0 else int(np.argmax(width))
    edge = MARGIN * width[index]
    at = float(np.clip(cuts[index], zones[index, 0] + edge, zones[index, 1] - edge))
    return Cut(index, at, float(width[index]))


def zone_bound(problem: DesignProblem, starts: Array, Z: Array, zones: Array) -> float:
    """Bound sigma of every schedule whose samples lie in `zones`."""
    P = problem.period
    zone = within_period(problem, np.stack([zones[:, 0] - TINY * P, zones[:, 1] + TINY * P], axis=1))
    wide = float(np.max(zone[:, 1] - zone[:, 0]))
    arc = cells(problem, float(zone[0, 0]), float(zone[-1, 1]), max(wide / 6, P / _FINEST))
    ends = arc.edges
    inside = np.any((ends[1:, None] > zone[:, 0]) & (ends[:-1, None] < zone[:, 1]), axis=1)
    marks = np.concatenate([ends[:-1][inside], ends[1:][inside], zone.ravel()])
    edges = piece_edges(P, np.concatenate([jump_times(problem, starts), np.mod(marks, P), problem.breakpoints]))
    there, g = problem.mask((edges[:-1] + edges[1:]) / 2), profile(problem, starts, Z, edges)
    periods = np.arange(-1, int(np.ceil(arc.stop / P)) + 1)
    line = np.append((edges[:-1] + P * periods[:, None]).ravel(), P * (periods[-1] + 1))
    roof = []
    for outputs in problem.kinds[0]:
        mask = there & outputs
        roof.append(np.tile(np.where(mask.any(axis=1), roofs(g, mask), -np.inf), periods.size))
    # open comparison: a piece that only touches a zone holds none of its times, and may lie beyond a jump
    layers = [
        cell_values(arc, line, np.where((line[1:] > a) & (line[:-1] < b), roof[kind], -np.inf))
        for (a, b), kind in zip(zone, problem.kinds[1], strict=True)
    ]
    return rooted(problem, best_layers(layers, arc, 2 * P))
