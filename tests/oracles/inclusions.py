"""Assumption 7 along plants that switch between members of a set: the worst case over all disturbances, by Riccati.

Plain and slow: the covariance Y = Pi^-1 of a window that starts with P2 is carried along by exponentials of a doubled
matrix, and P1 <= Pi is asked at every corner of time, just before and just after each sample.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.linalg import expm


def flown(Y, A, Q, eta, h):
    """Y after a time h of Y' = AY + YA' + eta Y + Q."""
    n = len(A)
    shifted = A + eta / 2 * np.eye(n)
    M = expm(np.block([[-shifted, Q], [np.zeros((n, n)), shifted.T]]) * h)
    F = M[n:, n:].T
    W = F @ M[:n, n:]
    return F @ Y @ F.T + (W + W.T) / 2


def largest_ratio(members, weights, eta, P1, P2, gaps, switches):
    """Largest lambda_max(P1, Pi) along gaps with members (A, C, G) that change at times within each gap.

    `members` is a list; `switches` draws, for each gap, a list of (share of the gap, member). At most 1 where
    Assumption 7 holds.
    """
    Qw, R, Qv = weights
    Rt = np.linalg.inv(np.linalg.inv(R) + np.linalg.inv(Qv))
    Y, worst = np.linalg.inv(P2), 0.0
    root = np.linalg.cholesky(P1)
    for gap, parts in zip(gaps, switches, strict=True):
        for share, k in parts:
            A, C, G = members[k]
            for _ in range(3):
                Y = flown(Y, A, G @ np.linalg.solve(Qw, G.T), eta, share * gap / 3)
                worst = max(worst, float(np.linalg.eigvalsh(root.T @ Y @ root)[-1]))
        C = members[parts[-1][1]][1]
        S = C @ Y @ C.T + np.linalg.inv(Rt)
        Y = Y - Y @ C.T @ np.linalg.solve(S, C @ Y)
        Y = (Y + Y.T) / 2
        worst = max(worst, float(np.linalg.eigvalsh(root.T @ Y @ root)[-1]))
    return worst


def adversary(certificate, members, rng, samples=8, parts=3):
    """The largest ratio along one random schedule whose gaps lie at the ends, with a member switched at random."""
    a, b = certificate.family.shortest, certificate.family.longest
    gaps = np.where(rng.random(samples) < 0.6, rng.choice([a, b], samples), rng.uniform(a, b, samples))
    gaps[0] = rng.uniform(0, b)
    switches = []
    for _ in range(samples):
        shares = rng.dirichlet(np.ones(rng.integers(1, parts + 1)))
        switches.append([(float(s), int(rng.integers(len(members)))) for s in shares])
    weights = (certificate.Qw, certificate.R, certificate.Qv)
    return largest_ratio(members, weights, certificate.eta, certificate.P1, certificate.P2, gaps, switches)


def corners(data, facts):
    """(A, C, G) at the corners of the box that a file's model describes, read off the plain data."""
    found = []
    for signs in product((0, 1), repeat=len(data["model"]["parameters"])):
        parts = {key: np.array(facts[key], dtype=float) for key in "ACG"}
        for p, high in zip(data["model"]["parameters"], signs, strict=True):
            move = (p["high"] if high else p["low"]) - p["nominal"]
            for key in parts:
                parts[key] = parts[key] + move * np.array(p.get(key, np.zeros(parts[key].shape)), dtype=float)
        found.append((parts["A"], parts["C"], parts["G"]))
    return found


def holds(data, facts, draws=3):
    """Whether what a file of claim "inclusion" states about a box holds along switching corners, and P2 <= lam P1."""
    weights = tuple(np.array(data[key], dtype=float) for key in ("Qw", "R", "Qv"))
    P1, P2 = (np.array(data[key], dtype=float) for key in ("P1", "P2"))
    times, rng, every = data["times"], np.random.default_rng(5), corners(data, facts)
    room = (1 + 1e-6) / (1 + data["margin"])
    root = np.linalg.cholesky(P1)
    between = np.linalg.solve(root, np.linalg.solve(root, P2).T)
    if np.linalg.eigvalsh((between + between.T) / 2)[-1] > data["lam"] * (1 + 2e-3):
        return False
    for _ in range(draws):
        gaps = rng.choice([times["shortest"], times["longest"]], 8)
        switches = [[(0.5, int(rng.integers(len(every)))), (0.5, int(rng.integers(len(every))))] for _ in gaps]
        if largest_ratio(every, weights, data["eta"], P1, P2, gaps, switches) > room:
            return False
    return True


def theorem_5(t, dx, dw, dy, sampled, c, W, Qw, Rt):
    """Largest left over right side of each inequality that leads to Theorem 5, along one pair on an even grid.

    `c` gives the constants by name; dw (K,) is constant on each step; sums by the least discount of each step.
    """
    h, size = t[1] - t[0], {}
    size["x"], size["w"], size["y"] = (np.einsum("ti,ij,tj->t", d, M, d) for d, M in ((dx, W), (dw, Qw), (dy, Rt)))
    at = np.isin(np.arange(t.size), sampled)

    def past(rate, f):
        """Integral or sum up to and without each time."""
        total, found = 0.0, np.zeros(t.size)
        for k in range(1, t.size):
            total = (total + f[k - 1]) * np.exp(-rate * h)
            found[k] = total
        return found

    def both(rate, f, g):
        return past(rate, h * f) + past(rate, g * at)

    eta, gone, late = c["eta"], np.exp(-c["eta"] * t), t >= c["t_star"]
    fresh = c["gamma"] * size["x"][0]
    first = past(eta, h * (size["w"] + c["gamma_2"] * size["y"]))
    roots = {key: np.sqrt(value) for key, value in size.items()}
    pushed = past(0.0, h * c["Lf"] * c["rho"] * roots["w"])
    linear = both(eta / 2, c["linear_w"] * roots["w"], c["linear_y"] * roots["y"])
    found = {
        "definition 1": size["x"] / c["beta"] / (fresh * gone + first),
        "backwards": roots["x"][0] * np.exp(-c["mu"] * t) / (roots["x"] + pushed),
        "(5)": roots["x"] * np.exp(-c["Lf"] * t) / (roots["x"][0] + pushed),
        "result": size["x"] / c["beta"] / (c["P2_scale"] * size["x"][0] * gone
                                           + both(eta, c["Qw_scale"] * size["w"], c["R0"] * size["y"])),
        "linear": roots["x"] / np.sqrt(c["beta"]) / (c["linear_x"] * roots["x"][0] * np.sqrt(gone) + linear),
        "(4)": past(0.0, h * late * c["gamma_2"] * size["y"])[late]
        / both(0.0, c["alpha_w"] * size["w"], c["alpha_y"] * size["y"])[late],
        "linear (4)": past(0.0, h * late * c["gamma_2"] * roots["y"])[late]
        / both(0.0, c["linear_alpha_w"] * roots["w"], c["linear_alpha_y"] * roots["y"])[late],
    }  # fmt: skip
    return {key: float(np.max(value)) for key, value in found.items()}
