"""Ball arithmetic: the only door to python-flint (extra `rigorous`).

A number is a ball (midpoint, radius) that certainly holds the value; a double becomes a ball of radius zero. So
"certainly positive" here is a theorem about the doubles that were given. Floats enter as guesses only: a guessed bound
is proven by the pivots of L D L' in balls.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.errors import MissingExtraError
from sampling_design.records.arrays import Array

if TYPE_CHECKING:
    from flint import arb, arb_mat

Ball: TypeAlias = "arb"
Matrix: TypeAlias = "arb_mat"

BITS = 160  # Working precision: 53 bits of the doubles, and a hundred against cancellation and the growth of radii
BLOCK = 16
"""States up to which pivots are taken one by one; larger matrices are eliminated by blocks, whose products and
solutions are the library's."""
SLACKS = (1e-13, 1e-10, 1e-6)
"""By how much of a matrix's size a guessed eigenvalue is raised before it is proven; the first nearly always does."""


def flint() -> ModuleType:
    """Return the library, loaded on first use. Raises MissingExtraError if python-flint is not installed."""
    try:
        return sys.modules.get("flint") or import_module("flint")  # asked for with every number
    except ImportError:
        raise MissingExtraError("python-flint", "rigorous") from None


@contextmanager
def precision(bits: int = BITS) -> Iterator[None]:
    """Work with `bits` bits inside the block."""
    context = flint().ctx
    before = context.prec
    context.prec = bits
    try:
        yield
    finally:
        context.prec = before


def ball(x: float) -> Ball:
    """Return the double x as a ball of radius zero."""
    made: Ball = flint().arb(float(x))
    return made


def rational(x: Fraction) -> Ball:
    """Return a rational number as a ball."""
    made: Ball = flint().arb(x.numerator) / x.denominator
    return made


def matrix(X: npt.ArrayLike) -> Matrix:
    """Return doubles (m, n) as a matrix of balls of radius zero."""
    owned = np.asarray(X, dtype=np.float64)
    made: Matrix = flint().arb_mat(*owned.shape, owned.ravel().tolist())
    return made


def stacked(rows: Sequence[Sequence[Ball]], columns: int = 0) -> Matrix:
    """Return rows of balls as a matrix; `columns` says how many there are where there is no row."""
    made: Matrix = flint().arb_mat(rows) if rows and rows[0] else matrix(np.zeros((len(rows), columns)))
    return made


def symmetric(X: npt.ArrayLike) -> Matrix:
    """Return the symmetric part of X, all that the form x'Xx knows of it, without rounding."""
    M = matrix(X)
    return (M + M.transpose()) * ball(0.5)


def identity(n: int) -> Matrix:
    """Return I."""
    return matrix(np.eye(n))


def floats(M: Matrix) -> Array:
    """Return the midpoints as doubles: guesses, no proof."""
    count = M.nrows() * M.ncols()
    return np.fromiter(map(float, M.entries()), np.float64, count).reshape(M.nrows(), M.ncols())


def definite(M: Matrix) -> bool | None:
    """Say of a symmetric matrix: positive definite (True), not even semidefinite (False), or not decided (None)."""
    if M.nrows() > BLOCK:
        corner, side, rest = _quarters(M)
        found, carried = definite(corner), _solved(corner, side)
        if not found or carried is None:
            return None if found else found
        return definite(rest - side.transpose() * carried)
    rows = M.tolist()
    for k, row in enumerate(rows):
        pivot = row[k]
        if not pivot > 0:
            return False if pivot < 0 else None
        below = [other[k] for other in rows[k + 1 :]]
        for i, head in enumerate(below, k + 1):
            factor = head / pivot
            rows[i][k + 1 : i + 1] = [x - factor * y for x, y in zip(rows[i][k + 1 : i + 1], below, strict=False)]
    return True


def cholesky(M: Matrix) -> Matrix | None:
    """Return L with M = LL', or None where M is not certainly positive definite."""
    n = M.nrows()
    if n > BLOCK:
        corner, side, rest = _quarters(M)
        first = cholesky(corner)
        across = None if first is None else _solved(first, side)
        last = None if across is None else cholesky(rest - across.transpose() * across)
        if first is None or across is None or last is None:
            return None
        above = [[*row, *[flint().arb(0)] * last.nrows()] for row in first.tolist()]
        below = zip(across.transpose().tolist(), last.tolist(), strict=True)
        return stacked([*above, *([*a, *b] for a, b in below)])
    rows, L = M.tolist(), [[flint().arb(0)] * n for _ in range(n)]
    for k in range(n):
        if not rows[k][k] > 0:
            return None
        root = rows[k][k].sqrt()
        for i in range(k, n):
            L[i][k] = rows[i][k] / root
        for i in range(k + 1, n):
            for j in range(k + 1, i + 1):
                rows[i][j] -= L[i][k] * L[j][k]
    return stacked(L)


def _quarters(M: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """The blocks of a symmetric matrix, cut in the middle: first corner, the side to its right, last corner."""
    rows, k = M.tolist(), M.nrows() // 2
    parts = ([row[:k] for row in rows[:k]], [row[k:] for row in rows[:k]], [row[k:] for row in rows[k:]])
    first, side, last = map(stacked, parts)
    return first, side, last


def _solved(M: Matrix, right: Matrix) -> Matrix | None:
    """M^-1 right; None where M may be singular."""
    try:
        found: Matrix = M.solve(right)
    except ZeroDivisionError:
        return None
    return found


def frobenius(M: Matrix) -> Ball:
    """Return an exact number that is at least |M|_F."""
    return (M * M.transpose()).trace().upper().sqrt().upper()


def largest(M: Matrix) -> Ball:
    """Return an exact number that is at least the largest eigenvalue of a symmetric matrix, hardly above it."""
    n, guess = M.nrows(), floats(M)
    if np.isfinite(guess).all():
        size = float(np.abs(guess).max(initial=0.0))
        top = float(np.linalg.eigvalsh(guess)[-1])
        for slack in SLACKS:
            bound = ball(top + slack * max(size, 1e-300))
            if definite(bound * identity(n) - M):
                return bound
    return frobenius(M)


def spectral(M: Matrix) -> Ball:
    """Return an exact number that is at least |M|_2."""
    square = largest(M.transpose() * M)
    return (square if square > 0 else square * 0).sqrt().upper()


def raised(M: Matrix) -> Matrix:
    """Return a symmetric matrix, of hardly any radius, that is certainly at least M: radii no longer pile up."""
    middle = ((M + M.transpose()) * ball(0.5)).mid()
    return middle + frobenius(M - middle) * identity(M.nrows())


def lowered(M: Matrix) -> Matrix:
    """Return a symmetric matrix, of hardly any radius, that is certainly at most M."""
    return -raised(-M)


def positive_part(x: Ball) -> Ball:
    """Return an exact number that is at least max(x, 0)."""
    return x.upper() if x > 0 else flint().arb(0).max(x).upper()
