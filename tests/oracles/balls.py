"""Plain sixty-digit arithmetic with mpmath for what balls must contain; nothing of the package is imported."""

import mpmath

DIGITS = 60


def flow(A, S, Y, h):
    """Y(h) of Y' = A Y + Y A' + S by Van Loan's block exponential."""
    with mpmath.workdps(DIGITS + 40):
        n = len(A)
        block = mpmath.zeros(2 * n)
        for i in range(n):
            for j in range(n):
                block[i, j], block[i, n + j], block[n + i, n + j] = -mpmath.mpf(A[i][j]), S[i][j], A[j][i]
        E = mpmath.expm(block * mpmath.mpf(h), method="taylor")
        F = E[n:, n:].T
        return F * mpmath.matrix(Y) * F.T + F * E[:n, n:]


def largest(A, S, Y, h):
    """Largest eigenvalue of Y(h), to sixty digits."""
    with mpmath.workdps(DIGITS):
        Z = flow(A, S, Y, h)
        return max(mpmath.eigsy((Z + Z.T) / 2, eigvals_only=True))


def inside(number, entry):
    """Whether a ball (midpoint and radius) contains an mpmath number."""
    with mpmath.workdps(DIGITS):
        middle, radius = (mpmath.mpf(m) * mpmath.mpf(2) ** e for m, e in (exact(entry.mid()), exact(entry.rad())))
        return abs(number - middle) <= radius + mpmath.mpf(10) ** (-DIGITS + 8) * max(1, abs(number))


def exact(ball):
    """Mantissa and exponent of an exact ball as integers."""
    mantissa, exponent = ball.man_exp()
    return int(mantissa), int(exponent)
