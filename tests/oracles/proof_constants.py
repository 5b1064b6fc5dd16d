"""Slow, plain oracles for detectability and the constants of the proof; nothing here imports the package."""

import numpy as np
import scipy.linalg as sla


def dissipation_top(A, C, G, P, eta, c_w, c_y):
    """Largest eigenvalue of the dissipation matrix as the theory writes it."""
    corner = A.T @ P + P @ A + eta * P - c_y * C.T @ C
    return np.linalg.eigvalsh(np.block([[corner, P @ G], [G.T @ P, -c_w * np.eye(G.shape[1])]]))[-1]


def flow(A, G, Qw, eta, h):
    """F = e^{(A + eta/2 I) h} and W_h by the block exponential."""
    n = len(A)
    shifted = A + eta / 2 * np.eye(n)
    N = G @ np.linalg.inv(Qw) @ G.T
    block = sla.expm(np.block([[-shifted, N], [np.zeros((n, n)), shifted.T]]) * h)
    F = block[n:, n:].T
    return F, F @ block[:n, n:]


def riccati_margin(A, C, G, gaps, P1, P2, Qw, R, Qv, eta, periods=12, steps=24, start=0.0, masks=None):
    """min over t of lambda_min(Pi(t), P1), Pi from P2 at `start` after a sample, samples by the periodic `gaps`.

    Values before and after every sample and at `steps` instants of every gap; a sample at the start is left out.
    """
    Rtilde = np.linalg.inv(np.linalg.inv(R) + np.linalg.inv(Qv))
    L = np.linalg.cholesky(P1)
    Y, worst = np.linalg.inv(P2), np.inf

    def least(Y):
        return 1 / np.linalg.eigvalsh(L.T @ Y @ L)[-1]

    for i in range(periods * len(gaps)):
        gap = gaps[i % len(gaps)] - (start if i == 0 else 0.0)
        F, W = flow(A, G, Qw, eta, gap / steps)
        worst = min(worst, least(Y))
        for _ in range(steps):
            Y = F @ Y @ F.T + W
            worst = min(worst, least(Y))
        rows = slice(None) if masks is None else masks[i % len(gaps)]
        Ci, Ri = C[rows], Rtilde[rows][:, rows]
        K = Y @ Ci.T @ np.linalg.inv(Ci @ Y @ Ci.T + np.linalg.inv(Ri))
        Y = Y - K @ Ci @ Y
        Y = (Y + Y.T) / 2
    return worst


def trajectories(A, C, G, t, cells):
    """Maps from (x(0), w_1..w_cells), w constant on each cell of [0, t], to the states at the cell ends."""
    n, q, h = len(A), G.shape[1], t / cells
    block = sla.expm(np.block([[A, G], [np.zeros((q, n + q))]]) * h)
    E, B = block[:n, :n], block[:n, n:]
    maps = [np.hstack([np.eye(n), np.zeros((n, q * cells))])]
    for k in range(cells):
        step = E @ maps[-1]
        step[:, n + q * k : n + q * (k + 1)] += B
        maps.append(step)
    return np.array(maps), h


def _top(left, right):
    """Largest generalised eigenvalue of (left, right), right regularised from below only."""
    return sla.eigh(left, right + 1e-13 * np.trace(right) * np.eye(len(right)), eigvals_only=True)[-1]


def worst_27(A, C, G, T, samples, mu_bar, kappa, k_w, cells=60):
    """sup of |y(T)|^2 over 2 mu^2 kappa sum |y(j)|^2 + 2 (mu kappa + 1)^2 T k_w^2 int |w|^2; samples at cell ends."""
    n, q = len(A), G.shape[1]
    maps, h = trajectories(A, C, G, T, cells)
    y = C @ maps
    right = np.zeros((maps.shape[2],) * 2)
    for s in samples:
        row = y[round(s / h)]
        right += 2 * mu_bar**2 * kappa * row.T @ row
    right[n:, n:] += 2 * (mu_bar * kappa + 1) ** 2 * T * k_w**2 * h * np.eye(q * cells)
    return _top(y[-1].T @ y[-1], right)


def worst_28(A, C, G, T, t, samples, alpha_w, alpha_y, c_2, discount=0.0, cells=120):
    """sup of int_T^t c_2 |y|^2 e^{-d(t-s)} over int_0^t alpha_w |w|^2 e^{..} + sum alpha_y |y(j)|^2 e^{..}.

    The integral on the left by Simpson's rule on the cell ends, so that it is a plain quadratic form.
    """
    n, q = len(A), G.shape[1]
    maps, h = trajectories(A, C, G, t, cells)
    y = C @ maps
    grid = h * np.arange(cells + 1)
    weight = np.exp(-discount * (t - grid))
    left = np.zeros((maps.shape[2],) * 2)
    first = round(T / h)
    assert (cells - first) % 2 == 0
    for k in range(first, cells + 1):
        simpson = h / 3 * (1 if k in (first, cells) else 4 if (k - first) % 2 else 2)
        left += c_2 * simpson * weight[k] * y[k].T @ y[k]
    right = np.zeros_like(left)
    for s in samples:
        right += alpha_y * weight[round(s / h)] * y[round(s / h)].T @ y[round(s / h)]
    for k in range(cells):
        part = slice(n + q * k, n + q * (k + 1))
        right[part, part] += alpha_w * h * weight[k] * np.eye(q)  # the least discount of the cell
    return _top(left, right)


def partition_exists(samples, t, t_star, last_may_be_short):
    """Whether [t*, t] can be cut as the proof of Theorem 5 asks, by trying every chain of cut points."""
    points = [s + t_star for s in samples if t_star < s + t_star < t]
    reached = {t_star}
    for point in sorted(points):
        if any(t_star - 1e-12 <= point - r <= 2 * t_star + 1e-12 for r in reached):
            reached.add(point)
    low = 0.0 if last_may_be_short else t_star - 1e-12
    return any(low < t - r <= 2 * t_star + 1e-12 for r in reached)


def largest_on_a_grid(M, A, N, T, points=4001):
    """Largest |M e^{As} N| on a grid."""
    return max(np.linalg.norm(M @ sla.expm(A * s) @ N, 2) for s in np.linspace(0, T, points))
