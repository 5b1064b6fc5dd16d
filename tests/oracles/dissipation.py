"""Slow oracles for the dissipation inequality: eigenvalues at 50 digits, and trajectories; no import of the package."""

import mpmath
import numpy as np
import scipy.linalg as sla


def parts(data):
    """A, C, G, P, eta, c_w, c_y, margin of a certificate's plain data."""
    m = data["plant"]["matrices"]
    A, C = np.array(m["A"], dtype=float), np.array(m["C"], dtype=float)
    G = np.array(m["G"], dtype=float) if "G" in m else np.eye(len(A))
    return A, C, G, np.array(data["P"], dtype=float), *(float(data[k]) for k in ("eta", "c_w", "c_y", "margin"))


def least_eigenvalues(data, digits=50):
    """Least eigenvalues of P and of -[[A'P + PA + (1 + margin) eta P - c_y C'C, PG], [G'P, -c_w I]], as printed."""
    with mpmath.workdps(digits):
        A, C, G, P, *numbers = parts(data)
        A, C, G, P = (mpmath.matrix(X.tolist()) if X.size else mpmath.matrix(*X.shape) for X in (A, C, G, P))
        eta, c_w, c_y, margin = (mpmath.mpf(x) for x in numbers)
        n, q = A.rows, G.cols
        corner = A.T * P + P * A + (1 + margin) * eta * P - c_y * (C.T * C)
        off = P * G if q else None
        D = mpmath.matrix(n + q, n + q)
        for i in range(n):
            for j in range(n):
                D[i, j] = corner[i, j]
            for k in range(q):
                D[i, n + k] = D[n + k, i] = off[i, k]
        for k in range(q):
            D[n + k, n + k] = -c_w
        return min(mpmath.eigsy(P, eigvals_only=True)), min(mpmath.eigsy(-D, eigvals_only=True))


def holds(data, digits=50):
    """Whether P > 0 and the inequality holds strictly; None where 50 digits do not tell."""
    lowest = least_eigenvalues(data, digits)
    if any(abs(value) < mpmath.mpf(10) ** (-digits + 15) for value in lowest):
        return None
    return all(value > 0 for value in lowest)


def excess(data, x0, w, t, steps=64):
    """|x(t)|_P^2 minus what Definition 1 allows at the rate (1 + margin) eta, relative to |x(0)|_P^2 + that.

    w is a gain (w = K x) or a constant vector; integrals by Gauss-Legendre, states by the matrix exponential.
    """
    A, C, G, P, eta, c_w, c_y, margin = parts(data)
    n, rate = len(A), (1 + margin) * eta
    feedback = np.ndim(w) == 2
    drift = np.block([[A + G @ w, np.zeros((n, 1))], [np.zeros((1, n + 1))]]) if feedback else None
    if not feedback:
        drift = np.block([[A, (G @ w)[:, None]], [np.zeros((1, n + 1))]])
    nodes, weights = np.polynomial.legendre.leggauss(steps)
    allowed, start = np.exp(-rate * t) * x0 @ P @ x0, np.append(x0, 1.0)
    for s, weight in zip((nodes + 1) * t / 2, weights * t / 2, strict=True):
        x = (sla.expm(drift * s) @ start)[:n]
        noise = w @ x if feedback else w
        allowed += weight * np.exp(-rate * (t - s)) * (c_w * noise @ noise + c_y * np.sum((C @ x) ** 2))
    x = (sla.expm(drift * t) @ start)[:n]
    return (x @ P @ x - allowed) / (x @ P @ x + allowed)
