"""Slow and plain: the least sigma over spaced schedules by enumeration on a grid and local descent from the best."""

from itertools import combinations_with_replacement

import numpy as np
from scipy.linalg import expm
from scipy.optimize import minimize


def sigma_of_times(A, C, times):
    """The n-th singular value of [C e^{A t}], one exponential at a time; 0 for fewer rows."""
    rows = np.vstack([C @ expm(A * t) for t in times])
    n = A.shape[0]
    return 0.0 if rows.shape[0] < n else float(np.linalg.svd(rows, compute_uv=False)[n - 1])


def is_admissible(times, window, spacing, tolerance=1e-9):
    """Whether the times lie in [0, window], at least `spacing` apart."""
    return bool(
        times[0] >= -tolerance and times[-1] <= window + tolerance and np.all(np.diff(times) >= spacing - tolerance)
    )


def times_of_slacks(slacks, spacing):
    """Slack u_i is what sample i has beyond the tightest packing."""
    return np.asarray(slacks) + spacing * np.arange(len(slacks))


def grid_minimum(A, C, window, count, spacing, points):
    """The best admissible schedules whose slacks lie on a grid of `points`: (sigma, times), best first."""
    levels = np.linspace(0.0, window - (count - 1) * spacing, points)
    rows = [[C @ expm(A * (u + i * spacing)) for u in levels] for i in range(count)]
    found = []
    n = A.shape[0]
    for pick in combinations_with_replacement(range(points), count):
        O = np.vstack([rows[i][j] for i, j in enumerate(pick)])
        sigma = np.linalg.svd(O, compute_uv=False)[n - 1] if O.shape[0] >= n else 0.0
        found.append((float(sigma), times_of_slacks(levels[list(pick)], spacing)))
    return sorted(found, key=lambda f: f[0])


def from_steps(steps, window, count, spacing):
    """Any point of the unit cube as an admissible schedule: sorted fractions of the slack."""
    slack = window - (count - 1) * spacing
    return times_of_slacks(slack * np.sort(np.clip(steps, 0.0, 1.0)), spacing)


def brute_force(A, C, window, count, spacing, points, polished=3):
    """Least sigma found by enumeration, then by Nelder-Mead from the best few; with its schedule."""
    slack = max(window - (count - 1) * spacing, 1e-300)
    candidates = grid_minimum(A, C, window, count, spacing, points)
    best = candidates[0]
    for _, times in candidates[:polished]:
        start = np.clip((times - spacing * np.arange(count)) / slack, 0.0, 1.0)
        result = minimize(
            lambda s: sigma_of_times(A, C, from_steps(s, window, count, spacing)),
            start,
            method="Nelder-Mead",
            options={"maxfev": 150, "xatol": 1e-7, "fatol": 1e-12},
        )
        best = min(best, (float(result.fun), from_steps(result.x, window, count, spacing)), key=lambda b: b[0])
    return best
