"""What the plants of a cell are beside its middle, in the norm of one metric: the same in floats and in balls.

With A(theta) = A + E, |E| <= moved, C(theta) = C + F, |C| <= c, |F| <= f, and |e^{A r}| <= e^{rate r},

    |C(theta) e^{A(theta) r} - C e^{A r}|  <=  first + second,    b(x) = e^x - 1 - x,
    first = e^{rate r} (c moved r + f),    second = e^{rate r} (c b(moved r) + f (moved r + b(moved r))),

the first order linear in E and F. A window that begins s later turns all rows by one e^{A(theta) s}.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from sampling_design.numerics.balls import Ball
from sampling_design.records.arrays import Array

Number = TypeVar("Number", Ball, Array)


class BoundArithmetic(NamedTuple, Generic[Number]):
    """What bounds need beside sums and products; none of it smaller than it is."""

    exp: Callable[[Number], Number]
    beyond_first: Callable[[Number], Number]
    """e^x - 1 - x for x >= 0."""


def _beyond_first(x: Array) -> Array:
    return np.where(x < 1e-3, 0.5 * x * x * (1 + 0.34 * x), np.expm1(x) - x + 1e-15 * x)


FLOATS: BoundArithmetic[Array] = BoundArithmetic(np.exp, _beyond_first)
BALLS: BoundArithmetic[Ball] = BoundArithmetic(lambda x: x.exp(), lambda x: x.expm1() - x)


@dataclass(frozen=True, eq=False)
class CellNorms(Generic[Number]):
    """Of every plant of a cell: balls, or floats (K, 1), one for each of K cells."""

    rate: Number  # |e^{A r} x| <= e^{rate r} |x| for the centre's A, r >= 0
    size: Number  # |A x| <= size |x|
    moved: Number  # |(A(theta) - A) x| <= moved |x|
    output_size: Number  # c: |C x| <= c |x|, outputs in the plain norm
    output_moved: Number  # f: |(C(theta) - C) x| <= f |x|
    arithmetic: BoundArithmetic[Number]

    def rows(self, r: Number, rate: Number) -> tuple[Number, Number]:
        """First order, and what is beyond it, of a sample r >= 0 after the window's start."""
        along, grown = self.moved * r, self.arithmetic.exp(rate * r)
        beyond = self.arithmetic.beyond_first(along)
        c, f = self.output_size, self.output_moved
        return grown * (c * along + f), grown * (c * beyond + f * (along + beyond))

    def displaced(self, r: Number, rate: Number, other: Number, late: float) -> Number:
        """What times up to `late` off do to the rows of samples at r beyond what they do to the centre's.

        `other` bounds C(theta) e^{A(theta) r} - C e^{A r}; |e^{A(theta) e} - I| <= e^{(size + moved) |e|} - 1, and the
        terms of its series differ from the centre's by those of e^{(size + moved) |e|} - e^{size |e|} at most.
        """
        whole, own = (self.arithmetic.exp(x * late) for x in (self.size + self.moved, self.size))
        return self.output_size * self.arithmetic.exp(rate * r) * (whole - own) + other * (whole - 1)

    def turned(self, h: Number) -> Number:
        """What |e^{A(theta) s} - I - A s| stays below for |s| <= h."""
        return self.moved * h + self.arithmetic.beyond_first((self.size + self.moved) * h)
