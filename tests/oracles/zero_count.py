"""Zeros of C e^{At} x counted in 50 digits, and ranks of sampled observability. Imports nothing of what it judges."""

import mpmath as mp
import numpy as np

DIGITS = 50


def rows(A, C, times):
    """C e^{A t} for each t, stacked, as an mpmath matrix."""
    with mp.workdps(DIGITS):
        A, C = mp.matrix(np.asarray(A).tolist()), mp.matrix(np.asarray(C).tolist())
        blocks = [C * mp.expm(A * mp.mpf(t), method="taylor") for t in times]
        n = A.rows
        return mp.matrix([[b[i, j] for j in range(n)] for b in blocks for i in range(C.rows)])


def state_with_zeros(A, C, zeros):
    """A state x != 0 with C e^{A t} x = 0 at n-1 prescribed times (single output), by cofactors."""
    O = rows(A, C, zeros)
    n = O.cols
    with mp.workdps(DIGITS):
        x = []
        for j in range(n):
            keep = [c for c in range(n) if c != j]
            minor = mp.matrix([[O[i, c] for c in keep] for i in range(n - 1)])
            x.append((-1) ** j * (mp.det(minor) if n > 1 else mp.mpf(1)))
        size = mp.sqrt(sum(v * v for v in x))
        return [v / size for v in x]


def count_zeros(A, C, x, duration, points=2000):
    """Zeros of C e^{A t} x in [0, duration] that a fine scan sees: changes of sign, and values of 1e-30 or less."""
    with mp.workdps(DIGITS):
        A, row = mp.matrix(np.asarray(A).tolist()), mp.matrix(np.asarray(C).tolist())
        step = mp.mpf(duration) / points
        advance = mp.expm(A * step, method="taylor")
        state, signs = mp.matrix(x), []
        for _ in range(points + 1):
            value = (row * state)[0]
            signs.append(0 if abs(value) < mp.mpf(10) ** -30 else int(mp.sign(value)))
            state = advance * state
    zeros, before = 0, 0
    for sign in signs:
        if sign == 0:
            zeros += 1
            before = 0
        else:
            zeros += before * sign < 0
            before = sign
    return zeros


def rank(A, C, times, tolerance=1e-30):
    """Rank of the stacked rows by elimination with full pivoting in 50 digits."""
    M = rows(A, C, times)
    with mp.workdps(DIGITS):
        M, found = [[M[i, j] for j in range(M.cols)] for i in range(M.rows)], 0
        scale = max((abs(v) for r in M for v in r), default=mp.mpf(0))
        while M and M[0]:
            size, i, j = max((abs(v), i, j) for i, r in enumerate(M) for j, v in enumerate(r))
            if size <= tolerance * scale:
                break
            pivot = M.pop(i)
            M = [[r[c] - r[j] / pivot[j] * pivot[c] for c in range(len(r)) if c != j] for r in M]
            found += 1
        return found


def determinant(A, C, times):
    """det of the n sampled rows (single output) in 50 digits."""
    with mp.workdps(DIGITS):
        return mp.det(rows(A, C, times))


def companion(eigenvalues):
    """Companion matrix and first-coordinate output of a real polynomial with these roots."""
    coefficients = np.real(np.poly(eigenvalues))
    n = len(eigenvalues)
    A = np.diag(np.ones(n - 1), 1)
    A[-1] = -coefficients[:0:-1]
    return A, np.eye(n)[:1]


def minor_zero(eigenvalues, start, stop, points):
    """First zero of a top-right minor of e^{A_c t} on a grid in 50 digits, by sign change or a tiny value."""
    A, _ = companion(eigenvalues)
    n = len(eigenvalues)
    with mp.workdps(DIGITS):
        A = mp.matrix(A.tolist())
        before = None
        for i in range(points + 1):
            t = mp.mpf(start) + (mp.mpf(stop) - mp.mpf(start)) * i / points
            E = mp.expm(A * t, method="taylor")
            minors = [mp.det(E[0:k, n - k : n]) for k in range(1, n)]
            signs = [int(mp.sign(m)) if abs(m) > mp.mpf(10) ** -20 else 0 for m in minors]
            if 0 in signs or (before is not None and signs != before):
                return float(t)
            before = signs
    return None
