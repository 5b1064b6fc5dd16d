"""What the weighted inequality of a certificate leaves of chosen rows, by one dense least-squares problem.

In the coordinates of the whole plant, hidden modes included: unknown are x(start) and w itself at Gauss nodes of every
gap. No quotient, no Riccati recursion, no Gramian; nothing of the package is imported.
"""

from itertools import pairwise

import numpy as np
from scipy.linalg import expm, sqrtm

SAME = 1e-9
"""Times nearer than this are one: what is asked is the limit after a sample at `start` and before one at t."""
ENTERS = 1e-6
"""Share of the rows, or of what it costs, from which on a start that the prior does not weigh enters it."""


def worst_energy(A, C, G, samples, start, t, rows, prior, Qw, Rtilde, eta, nodes=8, longest=0.5):
    """sup |rows x(t)|^2 over all motions from `start` of discounted cost one; inf where what costs nothing enters.

    e^{-eta (t-start)} |prior x(start)|^2 + int e^{-eta (t-s)} |w|^2_Qw ds + sum e^{-eta (t-tau)} |C x(tau)|^2_Rtilde.
    """
    n, q = len(A), G.shape[1]
    samples = np.array([s for s in samples if start + SAME < s < t - SAME])
    z, share = np.polynomial.legendre.leggauss(nodes)
    knots = np.unique(np.concatenate([[start, t], samples]))
    edges = np.unique(np.concatenate([
        np.linspace(a, b, 1 + int(np.ceil((b - a) / longest))) for a, b in pairwise(knots)
    ]))  # fmt: skip
    width = n + q * nodes * (edges.size - 1)
    state, cost = np.eye(n, width), [np.exp(-eta * (t - start) / 2) * prior @ np.eye(n, width)]
    root_w, root_y = np.linalg.inv(sqrtm(Qw).real) if q else np.zeros((0, 0)), sqrtm(Rtilde).real
    for k, (a, b) in enumerate(pairwise(edges)):
        state = expm(A * (b - a)) @ state
        for j in range(nodes):
            s, own = a + (z[j] + 1) * (b - a) / 2, n + q * (nodes * k + j)
            # w(s) in units in which it costs one: what it does is the weight of the node times e^{A (b - s)} G w
            worth = np.sqrt(share[j] * (b - a) / 2) * np.exp(eta * (t - s) / 2)
            state[:, own : own + q] += worth * expm(A * (b - s)) @ G @ root_w
        if np.any(np.abs(samples - b) < SAME):
            cost.append(np.exp(-eta * (t - b) / 2) * root_y @ C @ state)
    M, L = np.vstack([*cost, np.eye(width - n, width, n)]), rows @ state
    # w costs something in every direction: what may cost nothing is a start alone
    R = np.linalg.qr(np.hstack([M[:, n:], M[:, :n]]), mode="r")
    m = width - n
    driven = np.linalg.solve(R[:m, :m].T, L[:, n:].T).T
    begun, left = L[:, :n] - driven @ R[:m, m:], R[m:, m:]
    # in units in which each state costs one: starts that the prior does not weigh, and all others
    sizes = np.linalg.norm(M[:, :n], axis=0)
    V = np.linalg.svd(prior / sizes)[2].T
    free, others = np.split(V, [len(prior)], axis=1)[::-1]
    # what w leaves of a start may be far smaller than the terms whose difference it is, and then is their rounding
    terms = np.linalg.norm(L[:, :n] / sizes) + np.linalg.norm(driven, 2) * np.linalg.norm(R[:m, m:] / sizes)
    costs = np.linalg.norm(M[:, :n] / sizes)
    if max(np.linalg.norm(begun / sizes @ free) / terms, np.linalg.norm(M[:, :n] / sizes @ free) / costs) > ENTERS:
        return np.inf
    reach = np.linalg.lstsq((left / sizes @ others).T, (begun / sizes @ others).T, rcond=None)[0].T
    return float(np.linalg.norm(np.hstack([driven, reach]), 2) ** 2)
