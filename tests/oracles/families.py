"""Slow and plain: lambda of one schedule by the Riccati recursion, sample after sample, start after start.

Imports nothing of what it judges.
"""

import numpy as np
from scipy.linalg import eigh, expm


def flow(A, G, Qw, eta, h):
    """F and W of Y -> F Y F' + W over h, by Van Loan's block exponential."""
    n = len(A)
    shifted = A + eta / 2 * np.eye(n)
    Q = G @ np.linalg.inv(Qw) @ G.T
    block = expm(np.block([[-shifted, Q], [np.zeros((n, n)), shifted.T]]) * h)
    F = block[n:, n:].T
    return F, F @ block[:n, n:]


def after_sample(Y, C, R, Qv, seen=None):
    """Y after a sample of the outputs `seen`, in information form."""
    rows = np.ones(len(C), bool) if seen is None else np.asarray(seen, bool)
    V = (np.linalg.inv(R) + np.linalg.inv(Qv))[np.ix_(rows, rows)]
    return np.linalg.inv(np.linalg.inv(Y) + C[rows].T @ np.linalg.inv(V) @ C[rows])


def information(plant, weights, eta, P2, times, start, t, outputs=None):
    """Pi(t) of the window that starts at `start`."""
    Qw, R, Qv = weights
    Y, now = np.linalg.inv(P2), start
    for k, tau in enumerate(times):
        if start < tau < t - 1e-12:
            F, W = flow(plant.A, plant.G, Qw, eta, tau - now)
            Y, now = after_sample(F @ Y @ F.T + W, plant.C, R, Qv, None if outputs is None else outputs[k]), tau
    F, W = flow(plant.A, plant.G, Qw, eta, t - now)
    return np.linalg.inv(F @ Y @ F.T + W)


def largest_lambda(plant, weights, eta, P2, times, outputs=None, starts=4, parts=3):
    """The largest lambda_max(P2, Pi) over some starts per gap (just after the sample too) and some times per gap."""
    return largest_ratio(plant, weights, eta, P2, times, outputs, P2, starts, parts)


def largest_ratio(plant, weights, eta, P2, times, outputs, against, starts=4, parts=3):
    """The largest lambda_max(against, Pi) likewise."""
    Qw, R, Qv = weights
    gaps = np.diff(times, prepend=0.0)
    top = 0.0
    for first in range(len(times)):
        for part in np.linspace(1.0, 0.0, starts, endpoint=False):
            Y, ahead = np.linalg.inv(P2), part * gaps[first]
            for k in range(first, len(times)):
                for x in np.linspace(1 / parts, 1.0, parts):
                    F, W = flow(plant.A, plant.G, Qw, eta, x * ahead)
                    inside = F @ Y @ F.T + W
                    top = max(top, eigh(inside, np.linalg.inv(against), eigvals_only=True)[-1])
                Y = after_sample(inside, plant.C, R, Qv, None if outputs is None else outputs[k])
                ahead = gaps[k + 1] if k + 1 < len(times) else 0.0
    return top


def readings(times, seen, shifts):
    """Times and outputs of the samples that planned ones become if each reading (row by row of `seen`) is shifted."""
    at, read = np.nonzero(seen)
    real = np.maximum(np.asarray(times)[at] + shifts, 0.0)
    instants = sorted(set(real.tolist()))
    mask = [
        [any(real[k] == t and read[k] == i for k in range(real.size)) for i in range(seen.shape[1])] for t in instants
    ]
    return np.array(instants), np.array(mask)


def adversarial_lambda(plant, weights, eta, P2, times, seen, early, late, rng, starts=2, parts=2):
    """The largest lambda over the times of readings that climbs find, one reading after the other, and these times.

    From samples early and late in turn, from the converse, and from ends at random.
    """
    at, read = np.nonzero(seen)
    low, high = -np.asarray(early)[read], np.asarray(late)[read]

    def reached(shifts):
        real, mask = readings(times, seen, shifts)
        return largest_lambda(plant, weights, eta, P2, real, mask, starts, parts), shifts

    found = []
    for side in (at % 2 == 0, at % 2 == 1, rng.uniform(size=read.size) < 0.5):
        best, before = reached(np.where(side, low, high)), (0.0, None)
        while best[0] > before[0] * (1 + 1e-9):
            before = best
            for k in range(read.size):
                for shift in (low[k], 0.0, high[k], rng.uniform(low[k], high[k])):
                    other = reached(np.where(np.arange(read.size) == k, shift, best[1]))
                    best = max(best, other, key=lambda pair: pair[0])
        found.append(best)
    return max(found, key=lambda pair: pair[0])


def step_holds(plant, weights, eta, P, target, h, seen):
    """The least eigenvalue of Phi_h(P) + C'R~C - target, relative to |target|; `seen` none for no sample."""
    Qw, R, Qv = weights
    F, W = flow(plant.A, plant.G, Qw, eta, h)
    Y = F @ np.linalg.inv(P) @ F.T + W
    if np.any(seen):
        Y = after_sample(Y, plant.C, R, Qv, seen)
    return np.linalg.eigvalsh(np.linalg.inv(Y) - target)[0] / np.linalg.norm(target)
