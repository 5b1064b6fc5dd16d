"""The bound narrowed by branching on the largest gap of a lap.

Where the requirement can be shifted in time, every schedule may be turned so that a sample lies at 0 and
the gap after it is the largest, b in [low, high] say. Then no sample lies in (0, low), every gap is at
most `high`, and sample i lies in a zone of its own; near even spacing the zones are narrow. One relaxation
and one chain bound per interval; together the intervals cover all gaps from P/k to P - (k - 1) spacing.
"""

from __future__ import annotations

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

Array = npt.NDArray[np.floating[Any]]

_POINTS = 64  # grid times of one relaxation, spread over the zones
_EXTRA_STARTS = 12  # window starts beside the zones' ends
_FINEST = 20000  # cells per period at most
_JUST_BEFORE = 1e-9  # of the period: a window that starts this much earlier still holds the sample


def applies(problem: DesignProblem) -> bool:
    """Whether every schedule may be turned: nothing forbidden, at most one fixed time, two samples or more."""
    free = not problem.forbidden.size and all(a is None for a in problem.available)
    return free and problem.fixed.size <= 1 and problem.samples >= 2


def gap_range(problem: DesignProblem) -> tuple[float, float]:
    """Least and most that the largest gap can be."""
    k, P = problem.samples, problem.period
    return P / k, max(P - (k - 1) * problem.spacing, P / k)


def zones(problem: DesignProblem, low: float, high: float) -> Array:
    """(k-1, 2): where sample i = 1..k-1 can lie, after the sample at 0 and before the one at P."""
    k, P, eps = problem.samples, problem.period, problem.spacing
    i = np.arange(1, k)
    first = np.maximum(np.maximum(low, eps) + (i - 1) * eps, P - (k - i) * high)
    last = np.minimum(i * high, P - (k - i) * eps)
    tiny = 1e-12 * P
    return np.stack([np.maximum(first - tiny, 0.0), np.minimum(np.maximum(last, first) + tiny, P)], axis=1)


def relax_zones(problem: DesignProblem, low: float, high: float) -> Relaxation:
    """Weights on points of the zones, a sample at 0; windows at the zones' ends and some between."""
    k, P = problem.samples, problem.period
    zone = zones(problem, low, high)
    times, step = _points(zone)
    early = np.append(0.0, zone[:, 0]) - _JUST_BEFORE * P
    late = np.append(0.0, zone[:, 1])
    between = (np.arange(_EXTRA_STARTS) + 0.5) * (P / _EXTRA_STARTS)
    starts = np.unique(np.mod(np.concatenate([early, late, early - problem.window, between]), P))
    every = np.ones((times.size, problem.plant.n_outputs), dtype=bool)
    grams = grams_at(problem, times, starts, every)
    anchor = grams_at(problem, np.zeros(1), starts, every[:1]).sum(axis=1)
    t, tiny = times[None, :], 1e-9 * P
    crowd = (t >= times[:, None] - tiny) & (t < times[:, None] + problem.spacing - tiny)
    empty = (t > times[:, None] + tiny) & (t <= times[:, None] + high + step + tiny)
    empty = empty[times + high + step < P - tiny]
    reached = (t <= zone[:, 1:] + tiny)[:-1]
    ahead = (t < zone[:, :1] - tiny)[1:]
    order = np.arange(1, k - 1)
    rows = np.vstack([crowd, ~(~empty), reached, ahead]).astype(float)
    signs = np.repeat([1.0, -1.0, -1.0, 1.0], [len(crowd), len(empty), len(reached), len(ahead)])
    roof = max(1.0, step / problem.spacing)
    limits = np.concatenate([np.full(len(crowd), roof), np.full(len(empty), -1.0), -order, order.astype(float)])
    linear = (rows * signs[:, None], limits)
    return solve_relaxation(problem, times, starts, grams, anchor, linear, float(k - 1))


def _points(zone: Array) -> tuple[Array, float]:
    """Grid times in the union of the zones, ends included, and the widest step."""
    joined: list[list[float]] = []
    for a, b in zone:
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
    return np.concatenate(parts), widest


def zone_bound(problem: DesignProblem, starts: Array, Z: Array, low: float, high: float) -> float:
    """Bound sigma of every schedule whose largest gap, turned to 0, lies in [low, high]."""
    P = problem.period
    zone = zones(problem, low, high)
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
    layers = [cell_values(arc, edges, np.where((edges[1:] >= a) & (edges[:-1] <= b), roof, -np.inf)) for a, b in zone]
    alone = float(value_at(problem, starts, Z, np.zeros(1)).sum())
    return rooted(alone + best_layers(layers, arc, high))
