"""Slow, plain references for accuracy: the adversary's program and the estimator's on a uniform fine grid, in cvxpy.

Nothing here knows the code it judges. Bounds are Euclidean: |w(t)| <= w, |v_j| <= v. The start is free.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from scipy.linalg import expm


def _cells(A, G, h, count):
    """int over each of `count` equal cells of e^{A(h - s)} G ds, first cell first, by Van Loan's exponential."""
    n, q = G.shape
    block = np.zeros((n + q, n + q))
    block[:n, :n], block[:n, n:] = A, G
    step = h / count
    one = expm(block * step)[:n, n:]
    return [expm(A * (h - (k + 1) * step)) @ one for k in range(count)]


def adversary(A, C, G, times, c, w, v, cells=40, start=None, unmeasured=()):
    """Largest c'x(t_N) among all trajectories with y = 0 at every time and w constant on cells; (value, x(t_1), w).

    `start` = (half-widths or half-axes, "box" | "ball") bounds x(t_1); the times at places `unmeasured` show nothing.
    """
    A, C, G, c = (np.asarray(m, float) for m in (A, C, G, c))
    known, start = start, cp.Variable(A.shape[0])
    x, rules, inputs = start, [] if 0 in unmeasured else [cp.norm(C @ start) <= v], []
    if known is not None:
        some = np.isfinite(known[0])
        if known[1] == "ball":
            rules.append(cp.norm(start[some] / known[0][some]) <= 1)
        else:
            rules.append(cp.abs(start[some]) <= known[0][some])
    for place, h in enumerate(np.diff(times), 1):
        u = cp.Variable((cells, G.shape[1]))
        parts = _cells(A, G, h, cells)
        x = expm(A * h) @ x + sum(parts[k] @ u[k] for k in range(cells))
        rules += [cp.norm(u, axis=1) <= w, *([] if place in unmeasured else [cp.norm(C @ x) <= v])]
        inputs.append(u)
    problem = cp.Problem(cp.Maximize(c @ x), rules)
    problem.solve(solver=cp.CLARABEL)
    return problem.value, start.value, [u.value for u in inputs]


def gains(A, C, G, times, c, w, v, cells=40):
    """Least of w int |G'g| + v sum |lambda_j| with g(t_1) = 0, the integral by the trapezoidal rule; (value, gains)."""
    A, C, G, c = (np.asarray(m, float) for m in (A, C, G, c))
    count, q = len(times), G.shape[1]
    lam, g = cp.Variable((count, C.shape[0])), cp.Variable((count, A.shape[0]))
    rules = [g[count - 1] == c - C.T @ lam[count - 1], g[0] == 0]
    cost = v * cp.sum(cp.norm(lam, axis=1))
    for k in range(count - 1, 0, -1):
        h = times[k] - times[k - 1]
        rules.append(g[k - 1] == expm(A.T * h) @ g[k] - C.T @ lam[k - 1])
        stacked = np.vstack([G.T @ expm(A.T * s) for s in np.linspace(0.0, h, cells + 1)])
        sizes = cp.norm(cp.reshape(stacked @ g[k], (cells + 1, q), order="C"), axis=1)
        weights = np.full(cells + 1, h / cells)
        weights[[0, -1]] /= 2
        cost += w * (weights @ sizes)
    problem = cp.Problem(cp.Minimize(cost), rules)
    problem.solve(solver=cp.CLARABEL)
    return problem.value, lam.value


def flown(A, G, c, d, w, cells=2000):
    """w int_0^d |G'e^{A's}c| ds, by the trapezoidal rule: what the time since the last sample adds."""
    A, G, c = (np.asarray(m, float) for m in (A, G, c))
    s = np.linspace(0.0, d, cells + 1)
    norms = [np.linalg.norm(G.T @ expm(A.T * a) @ c) for a in s]
    return w * np.trapezoid(norms, s)


def undriven(A, C, ages, c, v):
    """Largest c'x(t) of motions without a disturbance whose outputs stayed within v so long ago; one linear program."""
    from scipy.optimize import linprog

    rows = np.vstack([np.asarray(C, float) @ expm(-np.asarray(A, float) * age) for age in ages])
    size = np.linalg.norm(rows, axis=1)
    rows, limit = rows[size > 0] / size[size > 0, None], v / size[size > 0]
    unit = float(limit.min())  # of rows of length one, the strictest
    sides = np.concatenate([limit, limit]) / unit
    found = linprog(-np.asarray(c, float), np.vstack([rows, -rows]), sides, bounds=(None, None))
    return np.inf if found.status == 3 else -found.fun * unit
