"""Slow, plain references for the estimators: a discounted Kalman filter and a window problem on a fine grid.

Nothing here knows the code it judges.
"""

from __future__ import annotations

from functools import wraps

import numpy as np
from scipy.integrate import quad_vec
from scipy.linalg import expm


def once(integral):
    """Each integral is done once: windows and prefixes of a record share their gaps."""
    known = {}

    @wraps(integral)
    def remembered(*args):
        key = tuple((np.shape(a), np.asarray(a, float).tobytes()) for a in args)
        if key not in known:
            known[key] = integral(*args)
            known[key].flags.writeable = False
        return known[key]

    return remembered


def transition(A, h):
    """e^{A h}."""
    return expm(np.asarray(A) * h)


@once
def input_integral(A, B, h):
    """int_0^h e^{A s} B ds by adaptive quadrature."""
    return quad_vec(lambda s: expm(A * s) @ B, 0.0, h, epsabs=1e-13, epsrel=1e-13)[0]


@once
def noise_integral(A, N, h, eta):
    """int_0^h e^{eta s} e^{A s} N e^{A' s} ds by adaptive quadrature."""
    return quad_vec(lambda s: np.exp(eta * s) * expm(A * s) @ N @ expm(A.T * s), 0.0, h, epsabs=1e-14, epsrel=1e-13)[0]


def discounted_kalman(A, C, G, P2, Qw, Rt, eta, prior, start, times, ys, end=None, inputs=None):
    """Filter with weights P2, Qw, Rt (inverse covariances) and discount eta; NaN in ys means not measured.

    Returns (x, Y, cost) at `end` (default: the last sample). `inputs` = (B, D, u) with u(t) piecewise constant between
    the sample times: u[0] from `start` on, u[k] from times[k-1] on; a sample sees the input from its time on.
    """
    A, C, G = np.asarray(A, float), np.asarray(C, float), np.asarray(G, float)
    N = G @ np.linalg.inv(Qw) @ G.T
    x, Y, t, cost = np.array(prior, float), np.linalg.inv(P2), start, 0.0
    for k, (tau, y) in enumerate(zip(times, ys, strict=True)):
        h = tau - t
        F = transition(A, h)
        x = F @ x
        if inputs is not None and h > 0:
            x = x + input_integral(A, inputs[0], h) @ inputs[2][k]
        Y = np.exp(eta * h) * F @ Y @ F.T + noise_integral(A, N, h, eta) if h > 0 else Y
        cost *= np.exp(-eta * h)
        t = tau
        y = np.atleast_1d(np.asarray(y, float))
        if inputs is not None:
            y = y - inputs[1] @ inputs[2][k + 1]
        seen = np.isfinite(y)
        c = C[seen]
        S = c @ Y @ c.T + np.linalg.inv(np.asarray(Rt))[np.ix_(seen, seen)]
        K = Y @ c.T @ np.linalg.inv(S)
        e = y[seen] - c @ x
        x = x + K @ e
        Y = (np.eye(x.size) - K @ c) @ Y
        cost += e @ np.linalg.solve(S, e)
    if end is not None and end > t:
        h = end - t
        F = transition(A, h)
        x = F @ x
        if inputs is not None:
            x = x + input_integral(A, inputs[0], h) @ inputs[2][len(times)]
        Y, cost = np.exp(eta * h) * F @ Y @ F.T + noise_integral(A, N, h, eta), cost * np.exp(-eta * h)
    return x, (Y + Y.T) / 2, cost


def fine_grid(A, C, G, P2, Qw, R, Qv, eta, prior, start, times, ys, steps, twice=False, constrain=None):
    """Window problem with explicit w (constant on `steps` cells per gap) and explicit v, solved by cvxpy.

    `twice` puts the paper's factors 2 on prior, w and v. `constrain(x, w, v)` returns cvxpy constraints from
    the list of states at the samples (start first), the (q, cells) array of w and the list of v.
    Returns (state at the last sample, cost).
    """
    import cvxpy as cp

    A, C, G = (np.asarray(M, float) for M in (A, C, G))
    n, q, factor, end = A.shape[0], G.shape[1], 2.0 if twice else 1.0, times[-1]
    x0 = cp.Variable(n)
    w = cp.Variable((q, steps * len(times)))
    vs = [cp.Variable(C.shape[0]) for _ in times]
    chol = {key: np.linalg.cholesky(np.asarray(M, float)).T for key, M in {"P": P2, "w": Qw, "R": R, "v": Qv}.items()}
    terms = [factor * np.exp(-eta * (end - start)) * cp.sum_squares(chol["P"] @ (x0 - prior))]
    x, states, t, column = x0, [x0], start, 0
    for tau, y, v in zip(times, ys, vs, strict=True):
        h = (tau - t) / steps
        F, Gam = transition(A, h), input_integral(A, G, h)
        for k in range(steps):
            middle = end - (t + (k + 0.5) * h)
            terms.append(factor * h * np.exp(-eta * middle) * cp.sum_squares(chol["w"] @ w[:, column]))
            x = F @ x + Gam @ w[:, column]
            column += 1
        t = tau
        node = cp.Variable(n)
        states.append(node)
        x_expression, x = x, node
        weight = np.exp(-eta * (end - tau))
        terms.append(weight * factor * cp.sum_squares(chol["v"] @ v))
        terms.append(weight * cp.sum_squares(chol["R"] @ (C @ node + v - y)))
        terms.append(("equal", node, x_expression))
    equal = [item[1] == item[2] for item in terms if isinstance(item, tuple)]
    cost = cp.sum([item for item in terms if not isinstance(item, tuple)])
    extra = [] if constrain is None else constrain(states, w, vs)
    problem = cp.Problem(cp.Minimize(cost), equal + extra)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    return states[-1].value, float(problem.value)


def least_slacks(A, lower, upper, cones):
    """Slacks of least sum for lower - s <= Az <= upper + s and |Mz + c| <= r + s: of the rows, of the cones."""
    import cvxpy as cp

    z, rows, balls = cp.Variable(A.shape[1]), cp.Variable(len(A), nonneg=True), cp.Variable(len(cones), nonneg=True)
    parts = [A[i] @ z <= upper[i] + rows[i] for i in range(len(A)) if np.isfinite(upper[i])]
    parts += [A[i] @ z >= lower[i] - rows[i] for i in range(len(A)) if np.isfinite(lower[i])]
    parts += [cp.norm(M @ z + c) <= r + balls[i] for i, (M, c, r) in enumerate(cones)]
    cp.Problem(cp.Minimize(cp.sum(rows) + cp.sum(balls)), parts).solve(solver=cp.CLARABEL)
    return rows.value, balls.value
