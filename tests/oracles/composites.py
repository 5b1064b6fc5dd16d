"""The least-cost state after plain and composite readings, by functionals of the disturbance and quadrature over time.

Nothing here knows the code it judges: no flows between samples, no recursion, no window. Every reading is a linear
functional of the first error and of w(t); their Gram matrix in the discounted metric is one dense matrix.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.linalg import expm

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(12)


def posterior(A, C, G, P2, Qw, Y, eta, prior, start, plain, means, end, inputs=None):
    """Return state, covariance and cost at `end`.

    plain : (t, output, value); means : (t, output, since, value). Y is the weight of all outputs together; readings of
    one time share its noise. `inputs` = (B, D, [(t, u), ...]): u holds from t on, 0 before the first.
    """
    A, C, G = (np.asarray(M, float) for M in (A, C, G))
    n = len(A)
    rows = [(t, i, t, value) for t, i, value in plain] + [(t, i, since, value) for t, i, since, value in means]
    B, D, steps = inputs or (np.zeros((n, 0)), np.zeros((len(C), 0)), [])
    marks = sorted({start, end, *(t for row in rows for t in (row[0], row[2])), *(t for t, _ in steps)})
    marks = [t for t in marks if start <= t <= end]
    rate = np.linalg.norm(A) + eta + 1e-9
    edges = np.concatenate([np.linspace(a, b, 2 + int((b - a) * rate))[:-1] for a, b in pairwise(marks)] + [[end]])
    half = np.diff(edges) / 2
    times = ((edges[:-1] + half)[:, None] + half[:, None] * POINTS).ravel()
    share = (half[:, None] * WEIGHTS).ravel()
    u = np.array(
        [next((np.asarray(v, float) for t, v in reversed(steps) if t <= s), np.zeros(B.shape[1])) for s in times]
    )

    def functional(t, since, row):
        """Effect of the first error (n,) and of a force at each time (N, n), on a row read at t or as a mean."""
        if since == t:
            late = np.array([row @ expm(A * (t - s)) if s < t else np.zeros(n) for s in times])
            return row @ expm(A * (t - start)), late.reshape(-1, n)
        late = np.array([row @ (_sum(A, t - s) - _sum(A, since - s)) for s in times]) / (t - since)
        return row @ (_sum(A, t - start) - _sum(A, since - start)) / (t - since), late.reshape(-1, n)

    read = [functional(t, since, C[i]) for t, i, since, _ in rows]
    state = [functional(end, end, row) for row in np.eye(n)]
    fed = [_mean_input(D[i], steps, since, t) for t, i, since, _ in rows]
    nominal = [a @ prior + share @ np.einsum("kn,kn->k", b @ B, u) for a, b in [*read, *state]]
    first = np.linalg.inv(P2) * np.exp(eta * (end - start))
    force = np.linalg.inv(Qw)
    size = np.sqrt(share * np.exp(eta * (end - times)))
    factors = [
        np.concatenate([np.linalg.cholesky(first).T @ a, (b @ G @ np.linalg.cholesky(force) * size[:, None]).ravel()])
        for a, b in [*read, *state]
    ]
    gram = np.array(factors) @ np.array(factors).T
    noise = np.linalg.inv(Y)
    v = np.zeros((len(rows), len(rows)))
    for k, one in enumerate(rows):
        for j, other in enumerate(rows):
            if one[0] == other[0]:
                v[k, j] = noise[one[1], other[1]] * np.exp(eta * (end - one[0]))
    m = len(rows)
    S = gram[:m, :m] + v
    r = np.array([row[3] for row in rows]) - np.array(nominal[:m]) - np.array(fed)
    gain = np.linalg.solve(S, gram[:m, m:]).T
    return np.array(nominal[m:]) + gain @ r, gram[m:, m:] - gain @ gram[:m, m:], float(r @ np.linalg.solve(S, r))


def _sum(A, h):
    """int_0^h e^{As} ds, 0 for h <= 0."""
    n = len(A)
    if h <= 0:
        return np.zeros((n, n))
    return expm(np.block([[A * h, np.eye(n) * h], [np.zeros((n, 2 * n))]]))[:n, n:]


def _mean_input(row, steps, since, t):
    """The mean of row u over [since, t], or its value at t."""
    if not steps:
        return 0.0
    held = lambda s: next((float(row @ np.asarray(v, float)) for at, v in reversed(steps) if at <= s), 0.0)  # noqa: E731
    if since == t:
        return held(t)
    marks = [since, *(at for at, _ in steps if since < at < t), t]
    return sum((b - a) * held(a) for a, b in pairwise(marks)) / (t - since)
