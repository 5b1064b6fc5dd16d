"""The numbers of a certificate in units of powers of two (which changes no digit), and what is exact about them.

Weights get diagonals near 1, so that nothing below depends on the units of states, outputs and disturbances. What
may be singular, Qw, is factored in rational numbers: no direction of it, and none of G, is ever dropped.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from .outcome import Refused, Undecided
from .parts import Plant, Weights
from .strict import Array

EPS = float(np.finfo(float).eps)  # twice the rounding of one operation: what is of second order is paid by that
SAFE = 1e-140, 1e140  # sizes of numbers of which no product of two underflows or overflows
RESOLUTION = 1e-3  # lam and lam_samples are right to within this fraction
MOST_EXACT = 40  # states up to which a matrix that floats leave open is decided in rational numbers
MOST_ROWS = 2048  # eliminated from Qw in rational numbers, which grow: all of 64 coupled disturbances, some 6 s


@dataclass(frozen=True)
class Problem:
    """A, C, P1, P2 and S = G Qw^-1 G' in scaled units; V >= R^-1 + Qv^-1 by at most `loose` in each eigenvalue."""

    A: Array
    C: Array
    S: Array
    P1: Array
    P2: Array
    V: Array
    loose: float
    eta: float
    units: Array

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)


def problem(plant: Plant, weights: Weights) -> Problem:
    """Return the numbers in scaled units; Refused if a weight is not positive definite (Qw: semidefinite)."""
    x, y = unit(weights.P2), unit(weights.R)
    P1, P2 = definite("P1", weights.P1, x), definite("P2", weights.P2, x)
    R, Qv = definite("R", weights.R, y), definite("Qv", weights.Qv, y)
    inverses = [np.linalg.inv(W) for W in (R, Qv)]
    loose = sum(
        8 * len(W) * EPS * float(np.linalg.norm(W) * np.linalg.norm(X) ** 2)
        for W, X in zip((R, Qv), inverses, strict=True)
    )
    V = sum((X + X.T) / 2 for X in inverses) + loose * np.eye(len(R))
    # C x = y: rows in units of y, columns in units of x; a weight x'Px takes the inverse units
    C, A = plant.C * x / y[:, None], plant.A * x / x[:, None]
    S = inner(plant.G, weights.Qw, x)
    safe(A, C, S, P1, V)
    return Problem(A=A, C=C, S=S, P1=P1, P2=P2, V=V, loose=loose, eta=weights.eta, units=x)


def targets(numbers: Problem, margin: float, P1: Array, lam: float) -> list[tuple[Array, str]]:
    """What every window must stay above: (1 + margin) P1 and P2/lam, the latter to within the resolution."""
    return [
        ((1 + margin) * P1, "(1 + margin) P1 <= Pi(t)"),
        ((1 - RESOLUTION) * numbers.P2 / lam, "(1 - 1e-3) P2 <= lam Pi(t)"),
    ]


def unit(P: Array) -> Array:
    """Units of powers of two in which a weight has a diagonal between 1/2 and 4."""
    return np.ldexp(1.0, -np.frexp(np.sqrt(np.abs(np.diag(P))))[1])


def safe(*matrices: Array, power: int = 2) -> None:
    """Undecided if a number is so large or small that products of so many leave the range of doubles."""
    sizes, (low, high) = np.abs(np.concatenate([np.ravel(M) for M in matrices])), (x ** (2 / power) for x in SAFE)
    if np.any(~np.isfinite(sizes) | (sizes > high) | ((sizes != 0) & (sizes < low))):
        raise Undecided("range", "some numbers are too large or too small for an honest check in doubles")


def definite(name: str, M: Array, units: Array) -> Array:
    """Return the symmetric part of a positive definite matrix in these units; Refused if it is not."""
    M = M * units * units[:, None]
    if not len(M):
        return M
    if not np.all(np.diag(M) > 0):
        raise Refused(f"{name} > 0", f"{name} is not positive definite: least eigenvalue {np.diag(M).min():.3g}")
    M, d = (M + M.T) / 2, np.sqrt(np.diag(M))
    least = float(np.linalg.eigvalsh(M / d / d[:, None])[0])
    rounding = 8 * len(M) * EPS * len(M)
    if least < -rounding or (least <= rounding and len(M) <= MOST_EXACT and not pivots_positive(M)):
        raise Refused(f"{name} > 0", f"{name} is not positive definite: least eigenvalue {least:.3g}", least)
    if least <= rounding and len(M) > MOST_EXACT:
        raise Undecided(f"{name} > 0", f"{name} could not be decided: it is nearly singular", least)
    return M


def pivots_positive(M: Array) -> bool:
    """Whether all pivots of L D L' are positive, in rational numbers."""
    rows = [[Fraction(x) for x in row] for row in M.tolist()]
    for k, row in enumerate(rows):
        if row[k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            share = rows[i][k] / row[k]
            rows[i] = [a - share * b for a, b in zip(rows[i], row, strict=True)]
    return True


def inner(G: Array, Qw: Array, units: Array) -> Array:
    """Return G Qw^-1 G' in units of the states, each entry rounded once; Qw may be singular where G is exactly zero."""
    q, n = len(Qw), len(G)
    form = [[(Fraction(Qw[i, j]) + Fraction(Qw[j, i])) / 2 for j in range(q)] for i in range(q)]
    drive = [[Fraction(g) / Fraction(u) for g, u in zip(column, units, strict=True)] for column in G.T.tolist()]
    product = exact_inner(drive, form, [[Fraction(0)] * n for _ in range(n)])
    try:
        return np.array([[float(x) for x in row] for row in product], dtype=np.float64).reshape(n, n)
    except OverflowError:
        raise Undecided("range", "G Qw^-1 G' is beyond the range of doubles") from None


def exact_inner(
    drive: list[list[Fraction]], form: list[list[Fraction]], product: list[list[Fraction]]
) -> list[list[Fraction]]:
    """Return drive' form^-1 drive, (q, n) and (q, q), which it uses up, added to `product` (n, n).

    Fractions or another library's exact numbers. Refused if the form is not positive semidefinite, or singular in a
    direction of `drive`.
    """
    n = len(product)
    eliminated = 0
    for k, row in enumerate(form):
        pivot = row[k]
        if pivot < 0 or (pivot == 0 and any(x != 0 for x in row[k + 1 :])):
            raise Refused("Qw > 0", "Qw is not positive semidefinite")
        reached = [a for a in range(n) if drive[k][a] != 0]
        if pivot == 0:
            if reached:
                raise Refused("Qw > 0", "Qw is singular in a direction that drives the plant")
            continue
        for a in reached:
            for b in reached:
                product[a][b] += drive[k][a] * drive[k][b] / pivot
        coupled = [i for i in range(k + 1, len(form)) if form[i][k] != 0]
        eliminated += len(coupled)
        if eliminated > MOST_ROWS:
            raise Undecided("Qw > 0", "Qw couples more disturbances than rational numbers can invert in a check")
        for i in coupled:
            share = form[i][k] / pivot
            form[i] = [x - share * y for x, y in zip(form[i], row, strict=True)]
            drive[i] = [x - share * y for x, y in zip(drive[i], drive[k], strict=True)]
    return product
