"""The discounted filter with its ellipsoid in fifty digits: what radii are compared with.

Nothing here knows the code that it judges.
"""

from __future__ import annotations

import mpmath
import numpy as np

DIGITS = 50


def matrix(values):
    """Doubles as they are."""
    return mpmath.matrix(np.atleast_2d(np.asarray(values, dtype=float)).tolist())


def flow(A, noise, h, eta):
    """e^{Ah} and int_0^h e^{eta s} e^{As} N e^{A's} ds: Van Loan's block, Taylor's series, squarings."""
    n = A.rows
    block = mpmath.zeros(2 * n)
    for i in range(n):
        for j in range(n):
            shift = eta / 2 if i == j else 0
            block[i, j], block[i, n + j], block[n + i, n + j] = -A[i, j] - shift, noise[i, j], A[j, i] + shift
    block *= h
    halvings = max(0, int(mpmath.ceil(mpmath.log(mpmath.mnorm(block, 1) + 1, 2)))) + 10
    step, term, total = block / mpmath.mpf(2) ** halvings, mpmath.eye(2 * n), mpmath.eye(2 * n)
    for k in range(1, 30):
        term = term * step / k
        total += term
    for _ in range(halvings):
        total = total * total
    F = total[n:, n:].T
    W = F * total[:n, n:]
    return F * mpmath.exp(-eta * h / 2), (W + W.T) / 2


class Filter:
    """x, Y and the radius beta of |x(t) - x|^2_{Y^-1} <= beta.

    `energies` bound the costs of w (in a unit of time), of v (at a sample) and of the start.
    """

    def __init__(self, A, C, G, P2, Qw, R, Qv, eta, energies):
        with mpmath.workdps(DIGITS):
            self.A, self.C, self.eta = matrix(A), matrix(C), mpmath.mpf(eta)
            self.noise = matrix(G) * matrix(Qw) ** -1 * matrix(G).T
            self.V = matrix(R) ** -1 + matrix(Qv) ** -1
            self.w, self.v, self.beta = (mpmath.mpf(float(e)) for e in energies)
            self.x, self.Y, self.t = mpmath.zeros(self.A.rows, 1), matrix(P2) ** -1, mpmath.mpf(0)

    def ahead(self, t):
        """x, Y and beta at t, without a sample."""
        with mpmath.workdps(DIGITS):
            h = mpmath.mpf(t) - self.t
            F, W = flow(self.A, self.noise, h, self.eta)
            growth = mpmath.exp(self.eta * h)
            lost = self.w * ((1 - 1 / growth) / self.eta if self.eta else h)
            return F * self.x, growth * F * self.Y * F.T + W, self.beta / growth + lost

    def update(self, t, y):
        """Take in a sample."""
        x, Y, beta = self.ahead(t)
        with mpmath.workdps(DIGITS):
            S = self.C * Y * self.C.T + self.V
            e, K = matrix(y).T - self.C * x, Y * self.C.T * S**-1
            Y -= K * self.C * Y
            self.x, self.Y, self.t = x + K * e, (Y + Y.T) / 2, mpmath.mpf(t)
            self.beta = beta + self.v - (e.T * S**-1 * e)[0]

    def missed(self, estimate, at=None):
        """By how much, relative, the exact ellipsoid's extent leaves the estimate's radii; nan where it is empty."""
        with mpmath.workdps(DIGITS):
            x, Y, beta = (self.x, self.Y, self.beta) if at is None else at
            if beta < 0:
                return float("nan")
            far = []
            for i, (centre, radius) in enumerate(zip(estimate.x, estimate.ellipsoid_radii, strict=True)):
                need = abs(x[i] - mpmath.mpf(float(centre))) + mpmath.sqrt(beta * Y[i, i])
                far.append(float(need / mpmath.mpf(float(radius)) - 1))
            return max(far)
