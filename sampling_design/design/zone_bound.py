"""Bound of all schedules whose samples lie in given zones after a sample at 0.

A relaxation on points of the zones gives multipliers, a chain over time cells the bound. Of the windows
that might matter only those are posed that do: each round adds the ones that the weights see least of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design.design.bound import (
    Cells,
    best_layers,
    cell_count,
    cell_values,
    jump_times,
    piece_edges,
    profile,
    roofs,
    rooted,
    value_at,
)
from sampling_design.design.problem import DesignProblem
from sampling_design.design.relaxation import Relaxation, grams_at, solve_relaxation
from sampling_design.design.zones import TINY

Array = npt.NDArray[np.floating[Any]]

_POINTS = 48  # grid times of one relaxation, spread over the zones
_BETWEEN = 36  # window starts beside the zones' ends
_TOLERANCE = 1e-5  # asked of the solver: hundreds of boxes, each with a bound that is true whatever it answers
_FINEST = 20000  # cells per period at most
_JUST_BESIDE = 1e-9  # of the period: a window that starts this much earlier still holds the sample
_FIRST, _ADDED = 10, 3  # windows of the first round where no hints are given, and of each further round
_ROUNDS, _FIRST_ROUNDS = 2, 6  # with and without hints: what mattered for a wider box mostly matters again
_SEEN = 1e-3  # a window whose sigma^2 falls short of the value by less than this share is seen well enough
_MARGIN = 0.15  # of a zone: a cut leaves at least that much on either side
_MATTERS = 1e-3  # share of all multipliers below which a window has no say


@dataclass(frozen=True, eq=False)
class ZoneRelaxation:
    """Weights on points of the zones, the windows that matter, and which follower gains most from a cut."""

    found: Relaxation
    index: int
    cut: float


def relax_zones(problem: DesignProblem, zones: Array, hints: Array) -> ZoneRelaxation:
    """Weights on points of the zones, a sample at 0; `hints` are window starts that mattered for a wider box."""
    starts = _window_starts(problem, zones, hints)
    grid, step = _points(zones)
    times, owner = _with_starts(problem, zones, grid, starts)
    every = np.ones((times.size, problem.plant.n_outputs), dtype=bool)
    grams = grams_at(problem, times, starts, every)
    anchor = grams_at(problem, np.zeros(1), starts, every[:1]).sum(axis=1)
    rows, limits = _order_rows(problem, zones, times, step)
    posed = np.arange(starts.size) < hints.size
    if not hints.size:
        posed[:: max(1, starts.size // _FIRST)] = True
    for _ in range(_ROUNDS if hints.size else _FIRST_ROUNDS):
        used = (owner < 0) | posed[owner]
        parts = grams[posed][:, used], anchor[posed], (rows[:, used], limits), float(problem.samples - 1)
        found = solve_relaxation(problem, times[used], starts[posed], *parts, tolerance=_TOLERANCE)
        seen = anchor + np.einsum("mjab,j->mab", grams[:, used], found.weights)
        sigma2 = np.where(posed, np.inf, problem.rows.least(seen)[0])
        worst = np.argsort(sigma2, kind="stable")[:_ADDED]
        worst = worst[sigma2[worst] < found.value * (1 - _SEEN)]
        if not worst.size:
            break
        posed[worst] = True
    return ZoneRelaxation(found, *_most_divided(problem, zones, found))


def _with_starts(
    problem: DesignProblem, zones: Array, grid: Array, starts: Array
) -> tuple[Array, npt.NDArray[np.intp]]:
    """Grid times, and just after each window start the time where what it sees jumps up; whose it is, or -1."""
    after = starts + 2 * _JUST_BESIDE * problem.period
    held = np.any((after[:, None] > zones[:, 0]) & (after[:, None] < zones[:, 1]), axis=1)
    times = np.concatenate([grid, after[held]])
    owner = np.concatenate([np.full(grid.size, -1), np.flatnonzero(held)])
    order = np.argsort(times, kind="stable")
    return times[order], owner[order]


def _window_starts(problem: DesignProblem, zones: Array, hints: Array) -> Array:
    """Hints first; then just before and just after every zone, and some between, in [0, period)."""
    P = problem.period
    early = np.append(0.0, zones[:, 0]) - _JUST_BESIDE * P
    late = np.append(0.0, zones[:, 1] + _JUST_BESIDE * P)
    between = (np.arange(_BETWEEN) + 0.5) * (P / _BETWEEN)
    rest = np.unique(np.mod(np.concatenate([early, late, early - problem.window, between]), P))
    return np.concatenate([hints, rest[~np.isin(rest, hints)]])


def _order_rows(problem: DesignProblem, zones: Array, times: Array, step: float) -> tuple[Array, Array]:
    """Rows and limits: spacing, and as many samples before each zone's end as have to lie there."""
    k, tiny = problem.samples, 1e-9 * problem.period
    t = times[None, :]
    crowd = (t >= times[:, None] - tiny) & (t < times[:, None] + problem.spacing - tiny)
    reached = (t <= zones[:, 1:] + tiny)[:-1]
    ahead = (t < zones[:, :1] - tiny)[1:]
    order = np.arange(1.0, k - 1)
    rows = np.vstack([crowd, -1.0 * reached, ahead])
    roof = max(1.0, step / problem.spacing)
    return rows, np.concatenate([np.full(len(crowd), roof), -order, order])


def _points(zones: Array) -> tuple[Array, float]:
    """Grid times in the union of the zones, every end included, and the widest step."""
    joined: list[list[float]] = []
    for a, b in zones:
        if joined and a <= joined[-1][1]:
            joined[-1][1] = max(joined[-1][1], float(b))
        else:
            joined.append([float(a), float(b)])
    total = sum(b - a for a, b in joined)
    parts, widest = [], 0.0
    for a, b in joined:
        count = max(3, int(np.ceil(_POINTS * (b - a) / total)) + 1)
        parts.append(np.linspace(a, b, count))
        widest = max(widest, (b - a) / (count - 1))
    return np.unique(np.concatenate([*parts, zones.ravel()])), widest


def matters(problem: DesignProblem, found: Relaxation) -> Array:
    """The window starts whose multipliers have a say."""
    shares = np.einsum("mij,ij->m", found.Z, problem.rows.N) * problem.rows.unit
    return found.starts[shares > _MATTERS]


def _most_divided(problem: DesignProblem, zones: Array, found: Relaxation) -> tuple[int, float]:
    """The follower whose early and late shares differ most for the windows that matter, and its mean time.

    The relaxation gains from mixing schedules what the least eigenvalue is concave. Were follower i early
    in one half of them and late in the other, their Gram matrices would differ by D, and the mean of both
    lies above them by <Z, D W^-1 D> to second order: what a cut between the two takes away.
    """
    k = problem.samples
    held = np.isin(found.starts, matters(problem, found))
    starts, Z = found.starts[held], found.Z[held]
    every = np.ones((found.times.size, problem.plant.n_outputs), dtype=bool)
    grams = grams_at(problem, found.times, starts, every)
    W = grams_at(problem, np.zeros(1), starts, every[:1]).sum(axis=1) + np.einsum("mjab,j->mab", grams, found.weights)
    W = W + 1e-12 * np.trace(W, axis1=1, axis2=2)[:, None, None] * np.eye(W.shape[-1])
    total = np.append(0.0, np.cumsum(found.weights))
    total *= (k - 1) / max(float(total[-1]), 1e-300)
    gains, cuts = np.zeros(k - 1), zones.mean(axis=1)
    for i in range(k - 1):
        share = np.maximum(np.minimum(total[1:], i + 1) - np.maximum(total[:-1], i), 0.0)
        if share.sum() <= 0:
            continue
        cuts[i] = share @ found.times / share.sum()
        late = found.times >= cuts[i]
        parts = [share * side / max(float((share * side).sum()), 1e-300) for side in (late, ~late)]
        D = np.einsum("mjab,j->mab", grams, parts[0] - parts[1])
        weight = (share * late).sum() * (share * ~late).sum()
        gains[i] = weight * float(np.einsum("mab,mbc,mca->", Z, D, np.linalg.solve(W, D)))
    width = zones[:, 1] - zones[:, 0]
    index = int(np.argmax(gains)) if gains.max() > 0 else int(np.argmax(width))
    edge = _MARGIN * width[index]
    return index, float(np.clip(cuts[index], zones[index, 0] + edge, zones[index, 1] - edge))


def zone_bound(problem: DesignProblem, starts: Array, Z: Array, zones: Array) -> float:
    """Bound sigma of every schedule with a sample at 0 whose followers lie in `zones`."""
    P = problem.period
    zone = np.stack([zones[:, 0] - TINY * P, zones[:, 1] + TINY * P], axis=1)
    zone = np.clip(zone, 0.0, P)
    wide = float(np.max(zone[:, 1] - zone[:, 0]))
    fine = float(np.clip(wide / 6, P / _FINEST, P / cell_count(problem)))
    apart = int(np.ceil(problem.spacing / fine - 1e-9)) if problem.spacing >= fine else 0
    width = problem.spacing / apart if apart else fine
    arc = Cells(float(zone[0, 0]), float(zone[-1, 1]), width, apart)
    ends = arc.edges
    inside = np.any((ends[1:, None] > zone[:, 0]) & (ends[:-1, None] < zone[:, 1]), axis=1)
    marks = np.concatenate([ends[:-1][inside], ends[1:][inside], zone.ravel()])
    edges = piece_edges(P, np.concatenate([jump_times(problem, starts), marks]))
    every = np.ones((edges.size - 1, problem.plant.n_outputs), dtype=bool)
    roof = roofs(profile(problem, starts, Z, edges), every)
    # open comparison: a piece that only touches a zone holds none of its times, and may lie beyond a jump
    layers = [cell_values(arc, edges, np.where((edges[1:] > a) & (edges[:-1] < b), roof, -np.inf)) for a, b in zone]
    alone = float(value_at(problem, starts, Z, np.zeros(1)).sum())
    return rooted(alone + best_layers(layers, arc, P))
