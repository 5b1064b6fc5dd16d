"""Windows that follow their samples, and what each of them sees of every sample.

Windows that begin at a sample or end there: rows (sample, 0 or 1, whether closed on the right instead of the left,
anchor). The anchor is the sample, counted on over the periods, at whose instant the state is judged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.records.arrays import Array, Index, Mask

SAME = 1e-11  # of the period: what lies this near to the end of a window lies on it
_GROWS = 1.0  # exponent of growth over a window from which states are judged at its last sample


def growth_rate(problem: DesignProblem) -> float:
    """The rate of the fastest growing mode in the times of the problem; 0 where none grows."""
    fastest = float(np.max(np.linalg.eigvals(problem.plant.A).real, initial=0.0))
    return fastest if fastest * problem.window > _GROWS else 0.0


def tied_windows(problem: DesignProblem, zones: Array) -> Index:
    """Windows just before and just after every event."""
    ratio = problem.window / problem.period
    whole = abs(ratio - round(ratio)) <= SAME * max(ratio, 1.0)
    grows = growth_rate(problem) > 0
    rows = []
    for j in range(problem.samples):
        for ends in (0,) if whole else (0, 1):
            for right in (0, 1):
                inside_window = _samples_within(problem, zones, j, ends, right)
                rows.append((j, ends, right, int(inside_window.max()) if grows and inside_window.size else j))
    return np.array(rows, dtype=np.intp)


def _samples_within(problem: DesignProblem, zones: Array, j: int, ends: int, right: int) -> Index:
    """Samples, counted on over the periods, that the window can hold for some schedule in the zones."""
    k, P, T = problem.samples, problem.period, problem.window
    tiny = SAME * P
    cycles = int(np.ceil(T / P)) + 1
    index = np.arange(-cycles * k, (cycles + 1) * k)
    offset = -T if ends else 0.0
    low, high = zones[index % k].T + P * (index // k)
    nearest, farthest = low - zones[j, 1] - offset, high - zones[j, 0] - offset
    order = index - j
    nearest = np.where(order > 0, np.maximum(nearest, order * problem.spacing - offset), nearest)
    farthest = np.where(order < 0, np.minimum(farthest, order * problem.spacing - offset), farthest)
    # no sample lies on a closing time itself: one that comes up to a whole window later than that is not seen
    shut = problem.closes(zones[:, 1])
    inside_window = (farthest >= np.where(shut[index % k], tiny, -tiny)) & (nearest <= T + (-tiny if shut[j] else tiny))
    own = order % k == 0
    lag = (order // k) * P - offset
    inside = (lag > tiny) & (lag <= T + tiny) if right else (lag >= -tiny) & (lag < T - tiny)
    return np.asarray(index[np.where(own, inside, inside_window)])


@dataclass(frozen=True, eq=False)
class MeasurementTerms:
    """All measurements of all windows: window, sample and anchor (both mod k), the lag at the middle of the box, half
    the range of its change, and which rows count; the term of the window's own state is one of them."""

    window: Index
    first: Index
    second: Index
    lag: Array
    reach: Array
    low: Array
    high: Array
    weights: Array
    own: Mask

    def states(self, count: int) -> Index:
        """The places of the terms of the windows' own states, window by window."""
        own = np.flatnonzero(self.own)
        return own[np.argsort(self.window[own])][:count]


def terms_of(problem: DesignProblem, zones: Array, windows: Index) -> MeasurementTerms:
    """The terms of `windows` for schedules in `zones`."""
    k, P = problem.samples, problem.period
    middle, half = zones.mean(axis=1), (zones[:, 1] - zones[:, 0]) / 2
    measurable = _can_measure(problem, zones)
    n, p = problem.plant.n_states, problem.plant.n_outputs
    measurable = np.hstack([measurable.astype(float), np.zeros((k, max(n - p, 0)))])
    state = np.append(np.ones(n), np.zeros(max(p - n, 0)))
    parts = []
    for m, (j, ends, right, anchor) in enumerate(windows.tolist()):
        index = np.append(_samples_within(problem, zones, j, ends, right), j)  # the window's own state comes last
        own = np.arange(index.size) == index.size - 1
        at, begins = middle[anchor % k] + P * (anchor // k), problem.window * ends * own
        lag, ahead = middle[index % k] + P * (index // k) - begins - at, np.where(own, 0, index - anchor)
        weights = np.where(own[:, None], state, measurable[index % k])
        parts.append((np.full(index.size, m), index % k, np.full(index.size, anchor % k), lag, ahead, weights, own))
    window, i, a, mid, ahead, weights, own = map(np.concatenate, zip(*parts, strict=True))
    reach, order = np.where(i == a, 0.0, half[i] + half[a]), ahead * problem.spacing
    low = np.where(order > 0, np.maximum(mid - reach, order), mid - reach)
    high = np.where(order < 0, np.minimum(mid + reach, order), mid + reach)
    return MeasurementTerms(
        window=window, first=i, second=a, lag=mid, reach=reach, low=low, high=np.maximum(low, high), weights=weights,
        own=own,
    )  # fmt: skip


def _can_measure(problem: DesignProblem, zones: Array) -> Mask:
    """(k, p): what a sample in its zone can measure somewhere."""
    edges, P = problem.breakpoints, problem.period
    inside = (edges[:-1] + edges[1:]) / 2
    there = problem.mask(inside)
    pieces = np.stack([edges[:-1], edges[1:]])[:, None, :] + P * np.arange(-1, 3)[:, None]
    low, high = pieces.reshape(2, -1)
    touched = (zones[:, :1] < high) & (zones[:, 1:] >= low)
    can = np.any(touched[..., None] & np.tile(there, (4, 1)), axis=1)
    return np.asarray(can if problem.chosen is None else can & problem.chosen)
