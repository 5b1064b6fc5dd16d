"""Slow, plain references for the nonlinear room: shooting instead of collocation, sums written out.

Nothing here knows the code it judges.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares


def flow(f, x, u, w, length, rtol=1e-9, atol=1e-10, method="DOP853"):
    """State after `length` of x' = f(x, u, w) with constant u and w, by a Runge-Kutta method."""
    if length == 0:
        return np.array(x, float)
    found = solve_ivp(lambda t, z: f(z, u, w), (0.0, length), np.array(x, float), method=method, rtol=rtol, atol=atol)
    return found.y[:, -1]


def pieces(nodes, step):
    """Edges of equal pieces, at most `step` long, between consecutive nodes."""
    edges = [nodes[0]]
    for a, b in pairwise(nodes):
        count = max(1, int(np.ceil((b - a) / step - 1e-6)))
        edges += list(np.linspace(a, b, count + 1)[1:])
    return edges


def window(f, h, weights, eta, prior, edges, samples, q, boxes=None):
    """Minimise (15) over one window: x0, w on each piece and v at each sample, by shooting.

    `samples` maps an edge to its output; `boxes` = (w_low, w_high, v_low, v_high). Returns (last state, cost).
    """
    end, n = edges[-1], len(prior)
    factor = {key: np.linalg.cholesky(np.asarray(value, float)).T for key, value in weights.items()}
    p, K, seen = factor["R"].shape[0], len(edges) - 1, [t for t in edges if t in samples]

    def split(unknowns):
        x, rest = unknowns[:n], unknowns[n:]
        return x, rest[: K * q].reshape(K, q), dict(zip(seen, rest[K * q :].reshape(-1, p), strict=True))

    def residual(unknowns):
        x, w, v = split(unknowns)
        parts = [np.sqrt(2 * np.exp(-eta * (end - edges[0]))) * factor["P2"] @ (x - prior)]
        for j, t in enumerate(edges):
            if j:
                length = t - edges[j - 1]
                a, b = end - t, end - edges[j - 1]
                area = length if eta == 0 else (np.exp(-eta * a) - np.exp(-eta * b)) / eta
                parts.append(np.sqrt(2 * area) * factor["Qw"] @ w[j - 1])
                x = flow(f, x, None, w[j - 1], length)
            if t in samples:
                size = np.sqrt(np.exp(-eta * (end - t)))
                parts.append(size * np.sqrt(2) * factor["Qv"] @ v[t])
                parts.append(size * factor["R"] @ (np.asarray(samples[t]) - h(x, None, v[t])))
        residual.last = x
        return np.concatenate(parts)

    start = np.concatenate([prior, np.zeros(K * q + len(seen) * p)])
    lower, upper = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    if boxes is not None:
        lower[n:] = [*np.tile(boxes[0], K), *np.tile(boxes[2], len(seen))]
        upper[n:] = [*np.tile(boxes[1], K), *np.tile(boxes[3], len(seen))]
    found = least_squares(residual, start, bounds=(lower, upper), xtol=1e-10, ftol=1e-13, gtol=1e-9)
    cost = float(np.sum(residual(found.x) ** 2))
    return residual.last, cost


def scheme(f, h, weights, eta, horizon, prior, samples, step, q, boxes=None):
    """The whole scheme from `prior` at 0: a window per sample, open loop in between. Returns [(state, cost)]."""
    known, answers = [(0.0, np.array(prior, float))], []

    def online(t):
        at, x = [pair for pair in known if pair[0] <= t][-1]
        return flow(f, x, None, np.zeros(q), t - at)

    for t, _ in samples:
        start = max(0.0, t - horizon)
        inside = {s: y for s, y in samples if start <= s <= t}
        edges = pieces(sorted({start, *inside}), step)
        first = np.array(prior, float) if start == 0 else online(start)
        x, cost = window(f, h, weights, eta, first, edges, inside, q, boxes)
        answers.append((x, cost))
        known.append((t, x))
    return answers


def inequality(times, x, w, v, y, sampled, P1, P2, Qw, R, Qv, eta, cells=400):
    """Left and right side of (16) at each time for differences of one pair; w constant from each time on.

    The integral is a sum over small cells; the sample at the time itself is not counted.
    """
    rows = []
    for j, t in enumerate(times):
        right = x[0] @ P2 @ x[0] * np.exp(-eta * t)
        for k in range(j):
            if sampled[k]:
                right += (y[k] @ R @ y[k] + v[k] @ Qv @ v[k]) * np.exp(-eta * (t - times[k]))
            edges = np.linspace(times[k], times[k + 1], cells + 1)
            middle = (edges[:-1] + edges[1:]) / 2
            right += w[k] @ Qw @ w[k] * np.sum(np.exp(-eta * (t - middle)) * np.diff(edges))
        rows.append((x[j] @ P1 @ x[j], right))
    return np.array(rows)
