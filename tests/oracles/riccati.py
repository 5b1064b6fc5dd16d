"""Plain oracles for certificates: least squares without elimination, and a dense scan of the information recursion.

Nothing of the package is imported; exponentials come from scipy, everything else is written out.
"""

from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag, eigh, expm


def brute_force_information(A, C_list, times, G, P2, Qw, R, Qv, eta, t, steps):
    """Pi(t) from one large least-squares problem: x(0), w constant on `steps` pieces per interval, v explicit.

    The cost is a quadratic form z'Hz in z = (x(0), w_1, ..., v_1, ...), x(t) = M z, and its least value for given
    x(t) = xi is xi'(M H^-1 M')^-1 xi.
    """
    n, q = A.shape[0], G.shape[1]
    knots = np.unique(np.concatenate([[0.0, t], [s for s in times if 0 <= s <= t]]))
    edges = np.unique(np.concatenate([np.linspace(a, b, steps + 1) for a, b in pairwise(knots)]))
    pieces = len(edges) - 1
    seen = [(s, C) for s, C in zip(times, C_list, strict=True) if 0 <= s <= t]
    p = [C.shape[0] for _, C in seen]
    width = n + q * pieces + sum(p)
    blocks = [np.exp(-eta * t) * P2]
    for a, b in pairwise(edges):
        weight = (np.exp(-eta * (t - b)) - np.exp(-eta * (t - a))) / eta
        blocks.append(weight * Qw)
    for (s, _), size in zip(seen, p, strict=True):
        blocks.append(np.exp(-eta * (t - s)) * Qv[:size, :size])
    H = block_diag(*blocks)
    x = np.zeros((n, width))
    x[:, :n] = np.eye(n)
    state = {edges[0]: x.copy()}
    for k, (a, b) in enumerate(pairwise(edges)):
        E = expm(np.block([[A, G], [np.zeros((q, n + q))]]) * (b - a))
        x = E[:n, :n] @ x
        x[:, n + q * k : n + q * (k + 1)] += E[:n, n:]
        state[b] = x.copy()
    at = n + q * pieces
    for s, C in seen:
        size = C.shape[0]
        y = C @ state[min(state, key=lambda e: abs(e - s))]
        y[:, at : at + size] += np.eye(size)
        H += np.exp(-eta * (t - s)) * y.T @ R[:size, :size] @ y
        at += size
    return np.linalg.inv(x @ np.linalg.solve(H, x.T))


def flow(A, S, eta, h):
    """F and W over a gap or over each of several, Van Loan's formula as printed (fine where nothing is stiff)."""
    n = A.shape[0]
    shifted = A + eta / 2 * np.eye(n)
    E = expm(np.block([[-shifted, S], [np.zeros((n, n)), shifted.T]]) * np.asarray(h)[..., None, None])
    F = E[..., n:, n:].mT
    return F, F @ E[..., :n, n:]


def read(data):
    """Arrays of a certificate's plain data: A, S, information per sample, eta, gaps, first, periodic."""
    m = data["plant"]["matrices"]
    A, C = np.array(m["A"]), np.array(m["C"])
    G = np.array(m.get("G", np.eye(len(A))))
    V = np.linalg.inv(np.array(data["R"])) + np.linalg.inv(np.array(data["Qv"]))
    times = data["times"]
    periodic = times["kind"] == "periodic"
    gaps = np.array(times["gaps"]) if periodic else np.diff(times["times"], prepend=0.0)
    mask = times["outputs"] or [[1] * len(C)] * len(gaps)
    J = []
    for row in mask:
        k = np.flatnonzero(row)
        J.append(C[k].T @ np.linalg.solve(V[np.ix_(k, k)], C[k]))
    return (
        A,
        G @ np.linalg.solve(np.array(data["Qw"]), G.T),
        J,
        data["eta"],
        gaps,
        times.get("first", gaps[0]),
        periodic,
    )


def worst_ratio(data, target, samples=False, fine=14, periods=7):
    """Largest lambda_max(target Y) over a dense grid of window starts and later times; also where (start, t)."""
    return worst_ratios(data, [target], samples, fine, periods)[0]


def worst_ratios(data, targets, samples=False, fine=14, periods=7):
    """The same of several targets on one grid."""
    A, S, J, eta, gaps, first, periodic = read(data)
    N = len(gaps)
    Y0 = np.linalg.inv(np.array(data["P2"]))
    roots = [np.linalg.cholesky(np.array(target)) for target in targets]
    times = first + np.concatenate([[0.0], np.cumsum(gaps[1:])])
    fractions = np.linspace(0, 1, fine + 1)
    flows = [flow(A, S, eta, g * fractions) for g in gaps]
    worst = [(0.0, 0.0, 0.0)] * len(roots)

    def look(inside, start, now):
        for j, T in enumerate(roots):
            values = np.linalg.eigvalsh(T.T @ inside @ T)[:, -1]
            k = int(np.argmax(values))
            worst[j] = max(worst[j], (values[k], start[k], now[k]))

    for i in range(N):
        reach = max(gaps[0], first) if i == 0 else gaps[i]
        remaining = np.unique([gaps[i], first] if i == 0 else [gaps[i]]) if samples else reach * fractions
        start = times[i] - remaining
        for r, s in zip(remaining, start, strict=True):  # from the start to the first sample
            F, W = flow(A, S, eta, r * fractions)
            look(F @ Y0 @ F.mT + W, np.full(fine + 1, s), s + r * fractions)
        F, W = flow(A, S, eta, remaining)
        Y = F @ Y0 @ F.mT + W
        now, k = times[i], i
        for _ in range(periods * N if periodic else N - 1 - i):
            Y = np.linalg.inv(np.linalg.inv(Y) + J[k])
            k = (k + 1) % N
            for f, F, W in zip(fractions, *flows[k], strict=True):
                inside = F @ Y @ F.T + W
                look(inside, start, np.full(len(start), now + gaps[k] * f))
            Y, now = inside, now + gaps[k]
    assert all(len(T) == len(A) for T in roots)
    return worst


def information_at(data, start, t):
    """Pi(t) of the window from `start`, by stepping through the samples strictly between."""
    A, S, J, eta, gaps, first, periodic = read(data)
    times = list(first + np.concatenate([[0.0], np.cumsum(gaps[1:])]))
    index = list(range(len(gaps)))
    while periodic and times[-1] < t:
        k = len(times) % len(gaps)
        times.append(times[-1] + gaps[k])
        index.append(k)
    Y, now = np.linalg.inv(np.array(data["P2"])), start
    for tau, k in zip(times, index, strict=True):
        if start + 1e-9 < tau < t - 1e-9:
            F, W = flow(A, S, eta, tau - now)
            Y, now = np.linalg.inv(np.linalg.inv(F @ Y @ F.T + W) + J[k]), tau
    F, W = flow(A, S, eta, t - now)
    return np.linalg.inv(F @ Y @ F.T + W)


def witness_ratio(data):
    """x'P2x / x'Pi x at the witness."""
    seen = data["witness"]
    x = np.array(seen["direction"])
    Pi = information_at(data, seen["start"], seen["t"])
    return float(x @ np.array(data["P2"]) @ x / (x @ Pi @ x))


def worst_trajectory_ratio(P1, Pi):
    """Largest x'P1x / x'Pi x."""
    return float(eigh(P1, Pi, eigvals_only=True)[-1])


def settled(A, noise, rows, gaps, eta, periods=80):
    """Y after each sample of the period once it has settled, in 360 digits and sample by sample; A without eta/2."""
    import flint

    before, flint.ctx.prec = flint.ctx.prec, 1200
    try:
        n = len(A)
        plain = lambda M: flint.arb_mat(M.nrows(), M.ncols(), [x.mid() for x in M.entries()])  # noqa: E731
        shifted, S = flint.arb_mat(A), flint.arb_mat(noise)
        for i in range(n):
            shifted[i, i] += flint.arb(eta) / 2
        flows = []
        for h in gaps:
            block = flint.arb_mat(2 * n, 2 * n)
            for i in range(n):
                for j in range(n):
                    block[i, j], block[i, n + j], block[n + i, n + j] = (
                        -shifted[i, j] * h,
                        S[i, j] * h,
                        shifted[j, i] * h,
                    )
            E = block.exp().tolist()
            F = flint.arb_mat([row[n:] for row in E[n:]]).transpose()
            flows.append((plain(F), plain(F * flint.arb_mat([row[n:] for row in E[:n]]))))
        Y = flint.arb_mat(n, n, [flint.arb(i == j) for i in range(n) for j in range(n)])
        found = []
        for period in range(periods):
            for i, (F, W) in enumerate(flows):
                Y = F * Y * F.transpose() + W
                for row in rows[i]:
                    c = flint.arb_mat([row])
                    cross = Y * c.transpose()
                    Y = plain(Y - cross * cross.transpose() / ((c * cross)[0, 0] + 1))
                if period == periods - 1:
                    found.append(np.array([float(x) for x in Y.entries()]).reshape(n, n))
        return found
    finally:
        flint.ctx.prec = before
