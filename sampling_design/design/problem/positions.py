"""Sigma of many candidate schedules at once, at the window positions where it can be least.

Search only: rows come from a table and positions between events are a few per gap. What is claimed in
the end is proven by `observability.window_sigma`.

Gram matrices of all windows of a schedule at a cost linear in the number of samples.

Time is cut into blocks as long as the window. A window then holds the end of one block and the start of
the next, and both parts come from running sums within a block: the end carried back from sample to
sample, the start seen from its block's own start. Sums only, never a difference of sums, and only flows
forward in time over at most a window: no digit is lost that the direct sum would keep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import ScaledRows
from sampling_design.design.problem.orthogonal_flow import BATCH_NUMBERS, squares
from sampling_design.records.arrays import Array, Index, Mask

_WHOLE = 1e-11  # of the period: what lies this near to each other lies together


class SlidingSums:
    """Running sums over the periods of schedules `times` (B, k), sorted in [0, period), seen by `mask` (B, k, p)."""

    def __init__(self, rows: ScaledRows, times: Array, mask: Mask, period: float) -> None:
        self.rows, self.period = rows, period
        ratio = rows.window / period
        self.repeats = bool(abs(ratio - round(ratio)) <= _WHOLE * max(ratio, 1.0))
        self.length = rows.window - (0.0 if self.repeats else 2 * _WHOLE * period)
        periods = np.arange(-1, int(np.ceil(rows.window / period - 1e-9)) + 2)
        self.apart = 2 * period * (periods.size + 1)  # more than any row of times spans
        self.s = (times[:, None, :] + period * periods[:, None]).reshape(times.shape[0], -1)
        measured = np.tile(mask, (1, periods.size, 1))
        self.block = np.ceil(self.s / self.length)
        c = rows.C * measured[..., None]
        self.tail = self._tails(squares(c))
        r = np.clip(self.s - (self.block - 1) * self.length, 0.0, rows.window)
        c = rows.rows(r) * measured[..., None]
        self.head = self._heads(squares(c))

    def _tails(self, own: Array) -> Array:
        """Sums from each sample to the end of its block, seen from that sample; spans double."""
        total, reach = own, 1
        while reach < self.s.shape[1]:
            later = np.minimum(np.arange(self.s.shape[1]) + reach, self.s.shape[1] - 1)
            same = (self.block[:, later] == self.block) & (np.arange(self.s.shape[1]) + reach < self.s.shape[1])
            if not same.any():
                break
            flow = self.rows.flows(np.where(same, self.s[:, later] - self.s, 0.0))
            total = total + (np.swapaxes(flow, -1, -2) @ total[:, later] @ flow) * same[..., None, None]
            reach *= 2
        return np.asarray(total)

    def _heads(self, grams: Array) -> Array:
        """Sums from the start of a block to each sample in it, seen from the block's start; spans double."""
        total, reach, index = grams, 1, np.arange(self.s.shape[1])
        while reach < index.size:
            earlier = np.maximum(index - reach, 0)
            same = (self.block[:, earlier] == self.block) & (index >= reach)
            if not same.any():
                break
            total = total + total[:, earlier] * same[..., None, None]
            reach *= 2
        return np.asarray(total)

    def at(self, starts: Array, left: Mask) -> Array:
        """Gram matrices (B, q, n, n) of windows (a, a + T], or [a, a + T) where `left` (q,), a = `starts` (B, q).

        Where the window is no multiple of the period, a sample that leaves may meet another that enters at the same
        instant, but not to the last bit: neither is counted then, for the proof will find the instant between them.
        """
        tiny, T = _WHOLE * self.period, self.length
        a = np.mod(starts, self.period) + np.where(left & self.repeats, -tiny, tiny)
        first, stop = self._places(a, left), self._places(a + T, left)
        row, nonempty = np.arange(a.shape[0])[:, None], stop > first
        i, j = np.minimum(first, self.s.shape[1] - 1), np.maximum(stop - 1, 0)
        own, last = self.block[row, i], self.block[row, j]
        # samples of one block only: its start, where the window begins before it, or else its end
        begins = a < (own - 1) * T
        tail = self._carried(self.tail[row, i], self.s[row, i] - a, nonempty & ((last > own) | ~begins))
        head = self._carried(self.head[row, j], (last - 1) * T - a, nonempty & ((last > own) | begins))
        return np.asarray(tail + head)

    def _places(self, at: Array, left: Mask) -> Index:
        """Index of the first sample after `at` (B, q), or not before it where `left`; rows are searched as one."""
        far = self.apart * np.arange(at.shape[0])[:, None]
        flat, wanted = (self.s + far).ravel(), at + far
        base = self.s.shape[1] * np.arange(at.shape[0])[:, None]
        after = np.searchsorted(flat, wanted.ravel(), side="right").reshape(at.shape)
        before = np.searchsorted(flat, wanted.ravel(), side="left").reshape(at.shape)
        return np.asarray(np.clip(np.where(left, before, after) - base, 0, self.s.shape[1]))

    def _carried(self, gram: Array, by: Array, used: Mask) -> Array:
        """What is seen from an instant, seen from `by` earlier."""
        flow = self.rows.flows(np.clip(by, 0.0, self.rows.window))
        return np.asarray((np.swapaxes(flow, -1, -2) @ gram @ flow) * used[..., None, None])


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
    left: Mask  # (q,): which of them are limits just before a start


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
        np.repeat(np.arange(shares.size) == 1, q),
    )


def window_grams(problem: DesignProblem, times: Array, where: WindowPositions, used: Mask | None = None) -> Array:
    """Scaled Gram matrices (B, q, n, n) of the schedules `times` (B, k) in their windows.

    `used` (B, k, p) says which outputs each sample measures; default what the problem says.
    """
    mask = problem.measured(times) if used is None else used
    return SlidingSums(problem.rows, times, mask, problem.period).at(where.at, where.left)


def worst_sigma2(
    problem: DesignProblem, times: Array, inner: int = 1, used: Mask | None = None, graded: bool = False
) -> Array:
    """Least sigma^2 over the positions, for each schedule (B, k) of sorted times; `used` as for `window_grams`.

    `graded` tells apart those of which it is 0, with `inner` 1: less the share of window starts that miss a state.
    """
    if problem.orthogonal_flow is None or not times.size or graded:
        return _worst_of_positions(problem, times, inner, used, graded)
    result, sure = problem.orthogonal_flow.worst(times, problem.measured(times) if used is None else used)
    if not sure.all():
        result[~sure] = _worst_of_positions(problem, times[~sure], inner, None if used is None else used[~sure])
    return result


def _worst_of_positions(
    problem: DesignProblem, times: Array, inner: int, used: Mask | None, graded: bool = False
) -> Array:
    """The same for any plant, a few positions in every gap."""
    result = np.empty(times.shape[0])
    chunk = max(1, BATCH_NUMBERS // (times.shape[1] * (12 + 4 * inner) * problem.plant.n_states**2))
    for low in range(0, times.shape[0], chunk):
        part = times[low : low + chunk]
        mask = None if used is None else used[low : low + chunk]
        where = positions(problem, part, inner)
        sigma2 = problem.rows.least_sigma2(window_grams(problem, part, where, mask))
        result[low : low + chunk] = sigma2.min(axis=1)
        if graded:  # between two events all windows hold the same samples
            lengths = where.at[:, where.left] - where.at[:, where.share == 0]
            missed = np.where(sigma2[:, where.share == 0.5] > 0, 0.0, lengths)
            result[low : low + chunk] -= missed.sum(axis=1) / problem.period
    return result
