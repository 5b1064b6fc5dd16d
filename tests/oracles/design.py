"""Slow, plain answers about schedules: sigma by dense scan, the best of all grid schedules, random schedules.

Nothing here imports what it judges: numpy and scipy only.
"""

from itertools import combinations, product

import numpy as np
from scipy.linalg import expm


def window_sigma_scan(A, C, times, period, window, places=7, mask=None, late=0.0, delays=0.0):
    """Least sigma_n of C e^{A r} over half-open windows (start, start + T] and [start, start + T), by scan.

    Starts: every event, and `places` places between two events. With `late`, each of the samples that are planned in a
    window comes that much early, that much late or on time, whichever is worst: all of these are tried. A window holds
    of each output what was sampled until its delay, one for each (p,), before the window ends.
    """
    A, C, times = (np.asarray(M, dtype=float) for M in (A, C, times))
    periods = np.arange(-1, int(np.ceil(window / period)) + 2)
    every = (times[:, None] + period * periods).ravel()
    which = np.repeat(np.arange(times.size), periods.size)
    lengths = window - np.broadcast_to(delays, len(C))
    events = np.unique(np.round(np.concatenate([every, *(every - length for length in lengths)]), 12))
    events = events[(events > -period * 1e-6) & (events < period * (1 + 1e-6))]
    starts = np.unique(
        np.concatenate([events, *(events[:-1] + f * np.diff(events) for f in np.linspace(0, 1, places + 2)[1:-1])])
    )
    tiny, lags = 1e-9 * period, every - starts[:, None]
    near = (lags > -tiny) & (lags < window + tiny)
    rows = np.zeros((*lags.shape, *C.shape))
    rows[near] = C @ expm(A * lags[near][:, None, None])
    if mask is not None:
        rows = rows * np.asarray(mask)[which][:, :, None]
    least = np.inf
    for seen, lag in zip(rows, lags, strict=True):
        for low, high in ((tiny, window + tiny), (-tiny, window - tiny)):
            inside = (lag[:, None] > low) & (lag[:, None] < high - window + lengths)
            held = (seen * inside[..., None])[inside.any(axis=1)]
            moved = held @ expm(A * np.array([-late, 0.0, late])[:, None, None])[:, None] if late else held[None]
            for moves in product(range(len(moved)), repeat=len(held)):
                O = moved[list(moves), np.arange(len(held))].reshape(-1, A.shape[0])
                values = np.linalg.svd(O, compute_uv=False) if O.size else np.zeros(0)
                least = min(least, values[A.shape[0] - 1] if values.size >= A.shape[0] else 0.0)
    return float(least)


def is_allowed(times, period, spacing, forbidden=(), fixed=()):
    """Whether sorted times in [0, period) keep spacing (around the end too), forbidden and fixed times."""
    gaps = np.diff(np.append(times, times[0] + period))
    clear = all(not (a <= t < b) for t in times for a, b in forbidden)
    return bool(gaps.min() >= spacing * (1 - 1e-9) and clear and all(np.any(np.isclose(times, f)) for f in fixed))


def best_on_grid(A, C, period, window, spacing, count, points, forbidden=(), fixed=()):
    """Enumerate all schedules of `count` samples on a grid; return the best sigma and its times."""
    grid = np.arange(points) * period / points
    best, where = 0.0, None
    for chosen in combinations(grid, count):
        times = np.array(chosen)
        if is_allowed(times, period, spacing, forbidden, fixed):
            sigma = window_sigma_scan(A, C, times, period, window, places=0)
            if sigma > best:
                best, where = sigma, times
    return best, where


def random_schedule(rng, period, spacing, count):
    """Uniform on the spacing polytope, turned at random."""
    slack = period - count * spacing
    cuts = np.sort(rng.uniform(0, slack, count))
    times = np.mod(cuts + spacing * np.arange(count) + rng.uniform(0, period), period)
    return np.sort(times)


def mean_after_samples(A, C, times, period, window, gaps, weights, late=0.0):
    """Mean of <Z(g), W> over windows (s, s + T] that follow the samples s of a schedule, as a share of that of tr Z(g).

    Z is linear between its `weights` (N, n, n) at `gaps`, and g the gap after s. Each sample of each window is that
    much early, that much late or on time, whichever shows less of Z. Every schedule's least sigma^2 is no more.
    """
    every = np.sort((np.asarray(times)[:, None] + period * np.arange(int(np.ceil(window / period)) + 2)).ravel())
    seen = total = 0.0
    for at, s in enumerate(every[: len(times)]):
        gap = every[at + 1] - s
        Z = np.array([[np.interp(gap, gaps, entries) for entries in row] for row in np.moveaxis(weights, 0, -1)])
        total += np.trace(Z)
        for t in every[at + 1 :]:
            if t - s <= window * (1 + 1e-12):
                rows = [C @ expm(A * (t - s + move)) for move in ((-late, 0.0, late) if late else (0.0,))]
                seen += min(np.trace(row @ Z @ row.T) for row in rows)
    return seen / total
