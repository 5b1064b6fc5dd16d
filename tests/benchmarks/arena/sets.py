"""Rivals that hand out sets: a zonotope observer, and a constrained zonotope over the last samples."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

import sampling_design as sd

ORDER = 10
"""Generators that a zonotope keeps, in multiples of its dimension."""

BACK = 8
"""Samples that a constrained zonotope looks back; before them it is the box of the zonotope observer."""


CELLS = 4
"""Cells of a gap on which w is a generator of its own; what it does within a cell is a box."""


def entries(bound, count: int) -> np.ndarray:
    """Return a bound entry by entry: a number bounds the norm, and so each of them."""
    return np.broadcast_to(np.asarray(bound, float), (count,))


def pushed(plant: sd.Plant, h: float, w_bound) -> np.ndarray:
    """Return generators of what w does over a gap: its cells' means, and a box for what they leave, by fine sums.

    Of a w whose norm is bounded it is a box alone.
    """
    n, q = plant.G.shape
    if h <= 0:
        return np.zeros((n, 0))
    s = (np.arange(CELLS * 50) + 0.5) * (h / (CELLS * 50))
    flown = plant.transition(s) @ plant.G
    if np.ndim(w_bound) == 0 and q > 1:
        return np.diag(w_bound * 1.001 * np.linalg.norm(flown, axis=2).mean(axis=0) * h)
    rows = (flown * entries(w_bound, q)).reshape(CELLS, 50, n, q)
    means = rows.mean(axis=1, keepdims=True)
    left = np.abs(rows - means).sum(axis=(0, 1, 3)) * (h / (CELLS * 50)) * 1.001
    return np.hstack([*(means[:, 0] * (h / CELLS)), np.diag(left)])


def reduced(H: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Return a zonotope of fewer generators around one: the smallest, in these units, become a box (Girard)."""
    n, scaled = len(H), np.abs(H) / unit[:, None]
    if H.shape[1] <= ORDER * n:
        return H
    order = np.argsort(scaled.sum(axis=0) - scaled.max(axis=0))
    count = H.shape[1] - (ORDER - 1) * n
    return np.hstack([H[:, order[count:]], np.diag(np.abs(H[:, order[:count]]).sum(axis=1))])


def zonotope_observer(plant: sd.Plant, times, y, bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and half-widths: a strip is taken in with the gain of least Frobenius norm (Alamo et al. 2005)."""
    n, C = plant.n_states, plant.C
    v, H = entries(bounds["v_bound"], len(C)), np.diag(entries(bounds["initial_error"], n))
    c, now, centres, radii = np.zeros(n), 0.0, [], []
    for t, value in zip(times, y, strict=True):
        F = plant.transition(t - now)
        c, H = F @ c, reduced(np.hstack([F @ H, pushed(plant, t - now, bounds["w_bound"])]), plant.states.scales)
        S = H @ H.T
        gain = np.linalg.solve(C @ S @ C.T + np.diag(v**2), C @ S).T
        c = c + gain @ (value - C @ c)
        H, now = np.hstack([(np.eye(n) - gain @ C) @ H, gain * v]), t
        centres.append(c)
        radii.append(np.abs(H).sum(axis=1))
    return np.array(centres), np.array(radii)


def constrained_zonotope(plant: sd.Plant, times, y, bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and half-widths of the box around a constrained zonotope of the last samples."""
    n, C = plant.n_states, plant.C
    allowed, first_box = entries(bounds["v_bound"], len(C)), entries(bounds["initial_error"], n)
    observed, outer = zonotope_observer(plant, times, y, bounds)
    centres, radii = [], []
    for k in range(len(times)):
        first = k - BACK
        start, now = (observed[first], times[first]) if first >= 0 else (np.zeros(n), 0.0)
        H = np.diag(outer[first] if first >= 0 else first_box)
        c, rows, sides = start, [], []
        for j in range(max(first, -1) + 1, k + 1):
            F = plant.transition(times[j] - now)
            c, now = F @ c, times[j]
            gap = times[j] - (times[j - 1] if j else 0.0)
            H = np.hstack([F @ H, pushed(plant, gap, bounds["w_bound"])])
            rows.append(C @ H)
            sides.append(y[j] - C @ c)
        width = H.shape[1]
        A = np.vstack([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows])
        shown, size = np.concatenate(sides), np.tile(allowed, len(sides))
        ends = []
        for row in (*np.eye(n), *-np.eye(n)):
            found = linprog(
                -row @ H,
                A_ub=np.vstack([A, -A]) / np.tile(size, 2)[:, None],
                b_ub=np.concatenate([shown + size, size - shown]) / np.tile(size, 2),
                bounds=[(-1, 1)] * width,
            )
            ends.append(row @ c - found.fun)
        upper, lower = np.array(ends[:n]), -np.array(ends[n:])
        centres.append((upper + lower) / 2)
        radii.append((upper - lower) / 2)
    return np.array(centres), np.array(radii)
