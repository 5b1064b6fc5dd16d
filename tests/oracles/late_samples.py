"""The least sigma that real times were found to leave, sample by sample within a tolerance: a grid, then local steps.

Nothing here knows the code it judges: rows are C expm(A (t - a)) by scipy, sigma is their least singular value, and the
adversary chooses where the window begins, what each time in it is, and which sample is lost. A sample that may lie
outside the window does. For a fixed direction v the worst times are those of the least |C e^{A (t - a)} v|, one by one;
of these the worst direction is the last singular vector: both in turn, from several directions.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

STARTS, OFFSETS, TURNS, BEST, ROUNDS = 16, 5, 12, 3, 7
NEXT_TO = 1e-9  # share of the window by which it begins after a sample may have left, or ends before one may come


class Windows:
    """Windows over the samples `times` + k `period`, each of them up to `late` early or late, `lost` of them lost."""

    def __init__(self, A, C, times, period, window, late=0.0, lost=0):
        self.A, self.C, self.n = A, C, len(A)
        self.period, self.window, self.late, self.lost = period, window, late, lost
        turns = np.arange(-1, np.ceil((window + late) / period) + 2)
        self.times = (np.asarray(times)[None, :] + period * turns[:, None]).ravel()

    def sure(self, a):
        """The samples that a window from a on holds whatever their times are."""
        return np.flatnonzero((self.times - self.late >= a) & (self.times + self.late <= a + self.window))

    def rows(self, a, real):
        """C e^{A (t - a)} (k, p, n)."""
        return self.C @ expm(self.A * (np.asarray(real) - a)[..., None, None])

    def starts(self):
        """Where windows begin: evenly, and just where samples leave them."""
        tiny = NEXT_TO * self.window
        leave = np.concatenate([self.times - self.late + tiny, self.times + self.late - self.window - tiny])
        every = np.concatenate([np.linspace(0, self.period, STARTS, endpoint=False), leave])
        return np.unique(every[(every >= 0) & (every < self.period)])

    def sigma(self, rows):
        """The least singular value of rows (k, p, n), without the lost one that leaves least; 0 of fewer than n."""
        if self.lost and len(rows):
            kept = [np.delete(rows, k, axis=0) for k in range(len(rows))]
            return min(self._least(each) for each in kept)
        return self._least(rows)

    def _least(self, rows):
        flat = rows.reshape(-1, self.n)
        return 0.0 if len(flat) < self.n else float(np.linalg.svd(flat, compute_uv=False)[-1])

    def in_turn(self, table, v):
        """Offsets (k,) among those of a table (k, offsets, p, n): the worst for v, then v the worst for these."""
        places, before = np.zeros(len(table), dtype=int), None
        for _ in range(TURNS):
            seen = np.sum((table @ v) ** 2, axis=2)
            places = np.argmin(seen, axis=1)
            if before is not None and np.array_equal(places, before):
                break
            before = places
            taken = table[np.arange(len(table)), places]
            if self.lost:
                taken = np.delete(taken, int(np.argmax(seen[np.arange(len(table)), places])), axis=0)
            v = np.linalg.svd(taken.reshape(-1, self.n))[2][-1]
        return places


def least_sigma(windows):
    """The least sigma found, where that window begins, and the real times in it."""
    offsets = np.linspace(-1, 1, OFFSETS) * windows.late if windows.late else np.zeros(1)
    found = []
    for a in windows.starts():
        inside = windows.sure(a)
        if (len(inside) - windows.lost) * len(windows.C) < windows.n:
            return 0.0, float(a), windows.times[inside]
        table = windows.rows(a, windows.times[inside][:, None] + offsets)
        middle = table[:, len(offsets) // 2]
        for v in np.linalg.svd(middle.reshape(-1, windows.n))[2][::-1]:
            places = windows.in_turn(table, v)
            sigma = windows.sigma(table[np.arange(len(table)), places])
            found.append((sigma, float(a), offsets[places]))
    found.sort(key=lambda each: each[0])
    return min((_nearby(windows, *each) for each in found[:BEST]), key=lambda each: each[0])


def _nearby(windows, sigma, a, moved):
    """Where steps of the start and of one time after the other lead, ever smaller ones."""
    inside = windows.sure(a)
    rows = windows.rows(a, windows.times[inside] + moved)
    step, reach = windows.late / 4, windows.period / STARTS / 2
    for _ in range(ROUNDS):
        for sign in (-1.0, 1.0):
            other = a + sign * reach
            if np.array_equal(windows.sure(other), inside):
                there = windows.rows(other, windows.times[inside] + moved)
                if (less := windows.sigma(there)) < sigma:
                    sigma, a, rows = less, other, there
        for k in range(len(inside)) if windows.late else ():
            for sign in (-1.0, 1.0):
                tried = float(np.clip(moved[k] + sign * step, -windows.late, windows.late))
                there = rows.copy()
                there[k] = windows.rows(a, windows.times[inside[k]] + tried)
                if (less := windows.sigma(there)) < sigma:
                    sigma, rows, moved = less, there, np.where(np.arange(len(moved)) == k, tried, moved)
        step, reach = step / 2, reach / 3
    return sigma, a, windows.times[inside] + moved
