"""Slow and plain: sigma of one window, a dense scan of windows, exponentials in 50 digits."""

import mpmath
import numpy as np
from scipy.linalg import expm


def exponential_50_digits(A, t):
    """e^{At} through mpmath: Taylor terms after halving t often enough, 50 digits left over."""
    n = len(A)
    norm = float(np.abs(np.asarray(A)).sum(axis=1).max(initial=0.0)) * abs(t)
    halvings = max(0, int(np.ceil(np.log2(max(norm, 1e-300)))) + 4)
    # squaring loses digits where modes decay: up to norm/ln(10) of them
    with mpmath.workdps(60 + halvings + min(400, int(norm / 2.3))):
        step = mpmath.matrix([[mpmath.mpf(float(v)) for v in row] for row in A]) * mpmath.ldexp(
            mpmath.mpf(float(t)), -halvings
        )
        total, term = mpmath.eye(n), mpmath.eye(n)
        for k in range(1, 2 * mpmath.mp.dps):
            term = term * step / k
            total += term
            if mpmath.mnorm(term, 1) < mpmath.mpf(10) ** (-mpmath.mp.dps):
                break
        for _ in range(halvings):
            total = total * total
        return np.array([[float(total[i, j]) for j in range(n)] for i in range(n)])


def rows_of(A, C, taus, mask=None):
    """Rows C e^{A tau}, those measured, one expm at a time."""
    rows = [C[i] @ expm(A * tau) for k, tau in enumerate(taus) for i in range(C.shape[0]) if mask is None or mask[k][i]]
    return np.array(rows).reshape(-1, A.shape[0])


def sigma_of_rows(rows, n):
    """The n-th singular value; 0 for fewer rows."""
    return 0.0 if rows.shape[0] < n else np.linalg.svd(rows, compute_uv=False)[n - 1]


def sigma_of_window(A, C, times, mask, t, window, side="at"):
    """Sigma at the window's start of the samples in [t - window, t]; at t+ (t-) a sample at an end is gone."""
    start = t - window
    low = start + (1e-9 if side == "after" else -1e-9)
    high = t + (-1e-9 if side == "before" else 1e-9)
    keep = [k for k, tau in enumerate(times) if low <= tau <= high]
    rows = rows_of(A, C, [times[k] - start for k in keep], None if mask is None else [mask[k] for k in keep])
    return sigma_of_rows(rows, A.shape[0])


def scan_windows(A, C, times, mask, window, first_end, last_end, points):
    """Least sigma over event positions, both limits, and `points` positions between: (sigma, t, side)."""
    events = [t for tau in times for t in (tau, tau + window) if first_end <= t <= last_end]
    found = [
        (sigma_of_window(A, C, times, mask, t, window, "at"), t, "at") for t in np.linspace(first_end, last_end, points)
    ]
    for t in {first_end, last_end, *events}:
        for side in ("after", "before"):
            if (side == "after" and t < last_end) or (side == "before" and t > first_end):
                found.append((sigma_of_window(A, C, times, mask, t, window, side), t, side))
    return min(found)
