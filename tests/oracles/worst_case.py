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


def sigma_of_readings(A, C, readings):
    """The n-th singular value where output i of sample k is read at `readings[k, i]`."""
    rows = np.array([C[i] @ expm(A * t) for times in readings for i, t in enumerate(times)])
    n = A.shape[0]
    return 0.0 if rows.shape[0] < n else float(np.linalg.svd(rows, compute_uv=False)[n - 1])


def least_of_readings(A, C, window, count, spacing, early, late, rng, drawn=60, polished=3):
    """Least sigma found where output i of each planned sample is read within [t - early_i, t + late_i]; with them.

    Where there is one `early` and one `late`, all outputs of a sample are read together.

    The window begins max early before the first time that may be planned. Planned times and moves are drawn, half of
    them at their ends; then descended from by Nelder-Mead, all at once.
    """
    early, late = (np.asarray(side, dtype=float) for side in (early, late))
    p, slack = len(early), window - (count - 1) * spacing

    def readings_of(steps):
        slacks = slack * np.sort(np.clip(steps[:count], 0.0, 1.0))
        moves = np.clip(steps[count:].reshape(count, p), 0.0, 1.0)
        planned = early.max() + times_of_slacks(slacks, spacing)
        return np.broadcast_to(planned[:, None] - early + moves * (early + late), (count, len(C)))

    tried = []
    for turn in range(drawn):
        steps = rng.uniform(size=count * (1 + p))
        steps = steps if turn % 2 else np.where(rng.uniform(size=steps.size) < 0.7, np.round(steps), steps)
        tried.append((sigma_of_readings(A, C, readings_of(steps)), steps))
    tried.sort(key=lambda each: each[0])
    least, best = tried[0]
    for _, steps in tried[:polished]:
        options = {"maxfev": 60 * steps.size, "xatol": 1e-7, "fatol": 1e-12}
        found = minimize(
            lambda s: sigma_of_readings(A, C, readings_of(s)), steps, method="Nelder-Mead", options=options
        )
        least, best = min((least, best), (float(found.fun), found.x), key=lambda each: each[0])
    return least, readings_of(best)
