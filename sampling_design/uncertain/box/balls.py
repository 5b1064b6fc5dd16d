"""Cells of a box of constant parameters in ball arithmetic (extra `rigorous`).

Floats choose metrics |x|_W^2 = x'Wx and guess numbers; balls prove of each that it bounds, so that nothing is trusted:

    |e^{A r} x|_W <= e^{mu r} |x|_W  where  A'W + WA <= 2 mu W,      |M x|_W <= s |x|_W  where  M'WM <= s^2 W.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from sampling_design.numerics.balls import Ball, Matrix, ball, definite, floats, identity, matrix, symmetric
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array
from sampling_design.uncertain.box.model import BALLS, BoxModel, CellNorms, bases

RAISES = (1e-12, 1e-9, 1e-5)
"""By how much of its size a guessed bound is raised before it is proven, one after the other."""


class BallCell(NamedTuple):
    """The plants of a cell: A + sum d_k parts_A[k] and likewise C, |d_k| <= 1, in balanced coordinates."""

    A: Matrix
    C: Matrix
    parts_A: list[Matrix]
    parts_C: list[Matrix]


CellMetric: TypeAlias = tuple[Matrix, CellNorms[Ball], Ball]
"""A metric W, norms that are proven in it of every plant of a cell, and `whole`: |unit x| <= whole |x|."""


class BallBox:
    """A box as matrices of balls: the doubles of the plant and its parameters as they are."""

    def __init__(self, model: BoxModel) -> None:
        P, y, place = model.plant.nominal, model.outputs, model.place.tolist()
        own = [model.plant.parameters[k] for k in place]
        self.unit = _diagonal(model.unit)
        self.into = _diagonal(model.states) * self.unit
        self.back, self.rows = self.into.inv(), _diagonal(y).inv()
        self.A, self.C = self.balanced(matrix(P.A), matrix(P.C))
        moves = list(zip(model.plant.moves("A"), model.plant.moves("C"), strict=True))
        parts = [self.balanced(*map(matrix, moves[k])) for k in place]
        self.parts_A, self.parts_C = [A for A, _ in parts], [C for _, C in parts]
        self.half = [(ball(each.high) - ball(each.low)) / 2 for each in own]
        self.off = [(ball(each.high) + ball(each.low)) / 2 - ball(each.nominal) for each in own]
        self.n, self.m = P.n_states, len(own)

    def balanced(self, A: Matrix, C: Matrix) -> tuple[Matrix, Matrix]:
        """The matrices of a plant in the coordinates of the cells."""
        return self.back * A * self.into, self.rows * C * self.into

    def cell(self, u: Array, half: Array) -> BallCell:
        """The plants with parameters in middle + half-width (u +- half)."""
        A, C, parts_A, parts_C = self.A, self.C, [], []
        for k in range(self.m):
            move, wide = self.off[k] + self.half[k] * ball(u[k]), self.half[k] * ball(half[k])
            A, C = A + self.parts_A[k] * move, C + self.parts_C[k] * move
            parts_A.append(self.parts_A[k] * wide)
            parts_C.append(self.parts_C[k] * wide)
        return BallCell(A, C, parts_A, parts_C)

    def metrics(self, cell: BallCell, longest: float) -> list[CellMetric]:
        """Metrics that suit the cell's centre, with all that is proven in them."""
        A, C = floats(cell.A), floats(cell.C)
        found = []
        for T in bases(A[None], C[None], np.array([longest])):
            inverse = np.linalg.inv(T[0])
            W = symmetrise(np.real(np.conj(inverse.T) @ inverse))
            if np.isfinite(W).all():
                found.append(self._metric(cell, symmetric(W)))
        return [each for each in found if each is not None]

    def _metric(self, cell: BallCell, W: Matrix) -> CellMetric | None:
        norms: list[Ball] = []
        forms = [X.transpose() * W * X for X in (cell.A, *cell.parts_A)]
        forms += [X.transpose() * X for X in (cell.C, *cell.parts_C, self.unit)]
        for form in forms:
            square = largest_over(form, W)
            if square is None:
                return None
            norms.append(square.sqrt().upper())
        turning = (cell.A.transpose() * W + W * cell.A) / 2
        rate = largest_over(turning, W, float(norms[0]))
        if rate is None:
            return None
        m, zero = self.m, ball(0.0)
        moved, output_moved = sum(norms[1 : m + 1], zero), sum(norms[m + 2 : 2 * m + 2], zero)
        found = CellNorms(rate, norms[0], moved.upper(), norms[m + 1], output_moved.upper(), BALLS)
        return W, found, norms[-1]


def largest_over(form: Matrix, W: Matrix, size: float = 0.0) -> Ball | None:
    """Return a number s, hardly too large, with x'form x <= s x'Wx for all x; None where none is proven.

    `size` is what differences of s are small beside.
    """
    if all(x == 0 for x in form.entries()):
        return ball(0.0)
    try:
        root = np.linalg.inv(np.linalg.cholesky(floats(W)))
        guess = float(np.linalg.eigvalsh(symmetrise(root @ floats(form) @ root.T))[-1])
    except np.linalg.LinAlgError:
        return None
    for share in RAISES:
        bound = ball(guess + share * max(abs(guess), size))
        if definite(W * bound - form):
            return bound
    return None


def _diagonal(d: Array) -> Matrix:
    return matrix(np.diag(d)) if d.size else identity(0)
