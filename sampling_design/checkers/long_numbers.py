"""Numbers of a fixed point, in integers: a costate crosses all gaps of a record without the rounding of doubles.

An array of integers X stands for X / 2^BITS. Every bound here is one on the largest absolute error of an entry.
"""

import math
from fractions import Fraction

import numpy as np

from .strict import Array

BITS = 320  # after the point: 1e-96
UNIT = 2.0**-BITS  # what one cut costs at most
SMALL = 2.0**-16  # a series is summed where |M| is at most so large
TERMS = 24  # of e^M: the rest is below 2^-470
LOOSE = 1 + 1e-9  # covers the rounding of bounds themselves


def long(x: object) -> tuple[Array, Array]:
    """Doubles or rationals as integers, and bounds of what is cut off: UNIT, or 0 where nothing is."""
    given = np.asarray(x, dtype=object)
    found, cut = np.empty(given.shape, dtype=object), np.zeros(given.shape)
    for at, value in np.ndenumerate(given):
        above, below = value.as_integer_ratio()
        found[at], rest = divmod(above << BITS, below)
        cut[at] = UNIT if rest else 0.0
    return found, cut


def product(a: Array, b: Array) -> Array:
    """The product of matrices, cut once for each entry."""
    return np.asarray(np.right_shift(a @ b, BITS))


def doubles(x: Array) -> Array:
    """The nearest doubles, infinite where there is none."""
    try:
        return np.asarray(x / (1 << BITS), dtype=np.float64)
    except OverflowError:
        return np.full(x.shape, np.inf)


def long_flow(a: Array, h: Fraction) -> tuple[Array, float]:
    """e^{ah} for a matrix of doubles, and what one of its entries is off by at most."""
    return long_flows(a, h)[-1]


def largest_flow(a: Array, h: Fraction) -> Array:
    """What the entries of |e^{as}| are at most for 0 <= s <= h: up to 2t they are |e^{at}| times those up to t."""
    doubled = long_flows(a, h)
    M = np.abs(a) * float(h / 2 ** (len(doubled) - 1))
    most = term = np.eye(len(a))
    for k in range(1, TERMS):
        term = term @ M / k
        most = most + term
    most = most * LOOSE + UNIT
    for S, off in doubled[:-1]:
        most = np.maximum(most, (np.abs(doubles(S)) + off) @ most * LOOSE)
    return most


def long_flows(a: Array, h: Fraction) -> list[tuple[Array, float]]:
    """The same for h/2^k, ..., h/2, h.

    A series at h/2^k, then k squarings: where S is off by D, S^2 is by (2|S| + 3|D|)|D| in the norm of row sums.
    OverflowError where a power leaves the doubles: each squaring would have twice as many digits as the one before.
    """
    n, size = len(a), norm(a)
    halvings = max(0, math.ceil(math.log2(max(size * float(h) / SMALL, 1.0))))
    step = h / 2**halvings
    M, one = long([[Fraction(x) * step for x in row] for row in a.tolist()])[0], long(np.eye(n))[0]
    total, term = one, one
    for k in range(1, TERMS):
        term = product(term, M) // k
        total = total + term
    # each term is off by less than n + 3 cuts: n of M, its own two, and what the one before is off, times |M|;
    # a row of the sum has n entries, and the rest of the series is less than one cut
    found = [(total, 5.0 * n * n * TERMS * UNIT)]
    for _ in range(halvings):
        S, off = norm(doubles(total)) * LOOSE, found[-1][1]
        if not math.isfinite(S):
            raise OverflowError("the flow of a gap")
        total = product(total, total)
        found.append((total, ((2 * S + 3 * off) * off + n * UNIT) * LOOSE))
    return found


def norm(a: Array) -> float:
    """The largest sum of a row."""
    return float(np.abs(a).sum(axis=1).max()) if a.size else 0.0
