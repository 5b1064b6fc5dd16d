"""Rivals that hand out sets: a zonotope observer, and a constrained zonotope over the last samples."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

import sampling_design as sd

ORDER = 10
"""Generators that a zonotope keeps, in multiples of its dimension."""

BACK = 8
"""Samples that a constrained zonotope looks back; before them it is the box of the zonotope observer."""


def pushed(plant: sd.Plant, h: float, w_bound: float) -> np.ndarray:
    """Return half-widths of what |w| <= w_bound does over a gap, by a fine sum rounded up."""
    s = np.linspace(0.0, h, 201)
    rows = np.linalg.norm(plant.transition(s) @ plant.G, axis=2)
    return w_bound * 1.001 * np.trapezoid(rows, s, axis=0)


def reduced(H: np.ndarray) -> np.ndarray:
    """Return a zonotope of fewer generators around one: the smallest become a box (Girard)."""
    n = len(H)
    if H.shape[1] <= ORDER * n:
        return H
    order = np.argsort(np.abs(H).sum(axis=0) - np.abs(H).max(axis=0))
    count = H.shape[1] - (ORDER - 1) * n
    return np.hstack([H[:, order[count:]], np.diag(np.abs(H[:, order[:count]]).sum(axis=1))])


def zonotope_observer(plant: sd.Plant, times, y, bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and half-widths: a strip is taken in with the gain of least Frobenius norm (Alamo et al. 2005)."""
    n, C = plant.n_states, plant.C
    c, H, now, centres, radii = np.zeros(n), bounds["initial_error"] * np.eye(n), 0.0, [], []
    for t, value in zip(times, y, strict=True):
        F = plant.transition(t - now)
        c, H = F @ c, reduced(np.hstack([F @ H, np.diag(pushed(plant, t - now, bounds["w_bound"]))]))
        S = H @ H.T
        gain = np.linalg.solve(C @ S @ C.T + bounds["v_bound"] ** 2 * np.eye(len(C)), C @ S).T
        c = c + gain @ (value - C @ c)
        H, now = np.hstack([(np.eye(n) - gain @ C) @ H, bounds["v_bound"] * gain]), t
        centres.append(c)
        radii.append(np.abs(H).sum(axis=1))
    return np.array(centres), np.array(radii)


def constrained_zonotope(plant: sd.Plant, times, y, bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and half-widths of the box around a constrained zonotope of the last samples."""
    n, C = plant.n_states, plant.C
    observed, outer = zonotope_observer(plant, times, y, bounds)
    centres, radii = [], []
    for k in range(len(times)):
        first = k - BACK
        start, now = (observed[first], times[first]) if first >= 0 else (np.zeros(n), 0.0)
        H = np.diag(outer[first] if first >= 0 else np.full(n, bounds["initial_error"]))
        c, rows, sides = start, [], []
        for j in range(max(first, -1) + 1, k + 1):
            F = plant.transition(times[j] - now)
            c, now = F @ c, times[j]
            H = np.hstack(
                [F @ H, np.diag(pushed(plant, 1e-300 + times[j] - (times[j - 1] if j else 0.0), bounds["w_bound"]))]
            )
            rows.append(C @ H)
            sides.append((y[j] - C @ c, bounds["v_bound"]))
        width = H.shape[1]
        A = np.vstack([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows])
        shown, allowed = np.concatenate([s for s, _ in sides]), bounds["v_bound"]
        ends = []
        for row in (*np.eye(n), *-np.eye(n)):
            found = linprog(
                -row @ H,
                A_ub=np.vstack([A, -A]),
                b_ub=np.concatenate([shown, -shown]) + allowed,
                bounds=[(-1, 1)] * width,
            )
            ends.append(row @ c - found.fun)
        upper, lower = np.array(ends[:n]), -np.array(ends[n:])
        centres.append((upper + lower) / 2)
        radii.append((upper - lower) / 2)
    return np.array(centres), np.array(radii)
