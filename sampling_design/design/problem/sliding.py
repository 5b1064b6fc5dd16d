"""Gram matrices of all windows of a schedule at a cost linear in the number of samples.

Time is cut into blocks as long as the window. A window then holds the end of one block and the start of
the next, and both parts come from running sums within a block: the end carried back from sample to
sample, the start seen from its block's own start. Sums only, never a difference of sums, and only flows
forward in time over at most a window: no digit is lost that the direct sum would keep.
"""

from __future__ import annotations

import numpy as np

from sampling_design.design.problem.gram import ScaledRows
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
        self.tail = self._tails(np.swapaxes(c, -1, -2) @ c)
        r = np.clip(self.s - (self.block - 1) * self.length, 0.0, rows.window)
        c = rows.rows(r) * measured[..., None]
        self.head = self._heads(np.swapaxes(c, -1, -2) @ c)

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
