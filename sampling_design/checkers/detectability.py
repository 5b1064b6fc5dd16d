"""Claim "detectability": one inequality about a plant, without samples.

It proves, for the very doubles in the file, P > 0 and N > 0,

    N = [[c_y C'C - A'P - PA - (1 + margin) eta P, -PG], [-G'P, c_w I]],

so that d/dt x'Px <= -eta x'Px + c_w |w|^2 + c_y |Cx|^2 along x' = Ax + Gw.
1. Each row and column is divided by the root of the size of its diagonal's terms: eigenvalues are relative to them.
2. The least eigenvalue is found in floats, with a bound of all rounding: of the entries, and of the eigenvalues.
3. Where the bound leaves the sign open, L D L' in rational numbers decides, without any rounding.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from .numbers import EPS
from .outcome import PROVEN, Refused, Verdict, WorkLimit
from .parts import AROUND, RATES, SOLVER, Claim, Plant, symmetric
from .strict import Array, Tree, matrix, or_nothing, positive, table, word

EIGENVALUES = 8  # those of an (n, n) matrix M are computed to within this times n eps |M|_F
PLAIN = 1e-70, 1e70  # numbers of this size: no product of four underflows or overflows
Number = Any  # a double, or a Fraction, or an array of these
Numbers = npt.NDArray[Any]  # doubles, or Fractions
INEQUALITY = "[[A'P + PA + (1 + margin) eta P - c_y C'C, PG], [G'P, -c_w I]] < 0"


METHODS = ("riccati", "proof", "given")
TABLE = table(
    {
        **AROUND,
        **RATES,
        **{"P": matrix(), "c_w": positive, "c_y": positive, "method": word(*METHODS)},
        "solver": or_nothing(SOLVER),
    },
    whole="the certificate",
)


@dataclass(frozen=True)
class Detectability:
    """A file of claim "detectability": A'P + PA + (1 + margin) eta P - c_y C'C etc., no schedule."""

    plant: Plant
    P: Array
    eta: float
    c_w: float
    c_y: float
    margin: float


def detectability(read: Tree, plant: Plant) -> Detectability:
    """A file of this claim."""
    rates = {key: read[key] for key in ("eta", "c_w", "c_y", "margin")}
    return Detectability(plant, symmetric(read["P"], "P", plant.n), **rates)


def prove(c: Detectability, work: WorkLimit | None = None) -> Verdict:
    """Prove P > 0 and the dissipation inequality; the slack is that of the latter."""
    slack, how = 1.0, "no states"
    for name in ("P > 0", INEQUALITY) if c.plant.n else ():
        slack, how = in_floats(name, c) or in_rationals(name, c)
    return Verdict(PROVEN, INEQUALITY, f"P > 0 and {INEQUALITY}, {how}", slack)


def forms(name: str, c: Detectability, of: Callable[[Array | float], Number]) -> tuple[Numbers, Numbers]:
    """The matrix that must be positive definite, and the sizes of its terms, summed; `of` makes numbers of doubles."""
    A, C, G, P = of(c.plant.A), of(c.plant.C), of(c.plant.G), of(c.P) / 2 + of(c.P.T) / 2
    if name == "P > 0":
        return P, abs(P)
    c_y, c_w, rate = of(c.c_y), of(c.c_w), (1 + of(c.margin)) * of(c.eta)

    def negative(A: Numbers, C: Numbers, G: Numbers, P: Numbers, sign: int) -> Numbers:
        drift, off = A.T @ P, sign * (P @ G)
        corner = c_y * (C.T @ C) + sign * (drift + drift.T + rate * P)
        return np.block([[corner, off], [off.T, np.diag([c_w] * G.shape[1])]])

    return negative(A, C, G, P, -1), negative(abs(A), abs(C), abs(G), abs(P), 1)


def exact(X: Array | float) -> Number:
    """The same numbers without rounding: fractions, in an array of objects where it is one."""
    return np.vectorize(Fraction, otypes=[object])(X)[()]


def in_floats(name: str, c: Detectability) -> tuple[float, str] | None:
    """The slack if floats prove the inequality, Refused if they disprove it, None if rounding leaves it open."""
    matrices, plant = (c.plant.A, c.plant.C, c.plant.G, c.P / 2 + c.P.T / 2), c.plant
    numbers = np.abs(np.concatenate([*map(np.ravel, matrices), [c.eta, c.c_w, c.c_y, 1 + c.margin]]))
    if np.any((numbers != 0) & ((numbers < PLAIN[0]) | (numbers > PLAIN[1]))) or np.any(np.diag(c.P) == 0):
        return None
    N, terms = forms(name, c, lambda X: X)
    size = np.sqrt(np.diag(terms))
    M = N / size / size[:, None]
    values, vectors = np.linalg.eigh(M)
    # each at most EPS/2: P = (P + P')/2, sums of n or p products, c_y, rate, four terms, the division by sizes
    roundings = plant.n + len(plant.C) + 12
    bound = EPS * (roundings * np.linalg.norm(terms / size / size[:, None]) + EIGENVALUES * len(M) * np.linalg.norm(M))
    how = f"rounding below {bound:.1g}"
    if values[0] < -bound:
        raise failure(name, float(values[0]), vectors[:, 0] / size, how)
    return (float(values[0]), f"by {values[0]:.3g} of the size of its terms ({how})") if values[0] > bound else None


def in_rationals(name: str, c: Detectability) -> tuple[float, str]:
    """The same without rounding; a proven inequality is nearer to tight than floats can tell."""
    N, terms = forms(name, c, exact)
    x, value = downhill(N)
    if x is None:
        return 0.0, "by less of the size of its terms than floats can tell (proven in rational numbers)"
    size = np.diag(terms) @ (x * x)
    raise failure(name, float(value / size) if size else 0.0, (x / max(abs(x))).astype(float), "in rational numbers")


def downhill(N: Numbers) -> tuple[Numbers | None, Number]:
    """x with x'Nx <= 0 and this value, from the first pivot of L D L' that is not positive; None, None if N > 0."""
    n = len(N)
    N, X = N[::-1, ::-1].copy(), np.array([[Fraction(i == j) for j in range(n)] for i in range(n)])  # w comes first
    for k in range(n):
        if N[k, k] <= 0:
            return X[k, ::-1], N[k, k]
        factor = N[k + 1 :, k] / N[k, k]
        N[k + 1 :] -= np.outer(factor, N[k])
        X[k + 1 :] -= np.outer(factor, X[k])
    return None, None


def failure(name: str, amount: float, direction: Array, how: str) -> Refused:
    """What to say of an inequality that fails by `amount` along `direction`."""
    along = (direction / np.linalg.norm(direction)).tolist()
    parts = ", ".join(f"{x:.3g}" for x in along[:8]) + (", ..." if len(along) > 8 else "")
    reason = f"{name} fails by {-amount:.3g}, an eigenvalue relative to the size of its terms ({how}), along [{parts}]"
    return Refused(name, reason, amount, direction=along)


CLAIM = Claim(TABLE, detectability, prove)
