"""Numbers known to within two ends, one pair per cell: every operation is rounded outwards, so the truth is inside.

Sums, products, quotients and square roots of doubles are rounded to the nearest double (IEEE 754), so that one step
outwards holds the true value. Nothing is taken on trust from a library's exp, log, sin or atan: they are summed here
from their series with a bound of the rest, or guessed and corrected. Where a function is not defined on a whole cell
the ends are infinite, which proves nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np

from .strict import Array, Mask

TERMS = 20  # of a series at arguments of size at most 0.8: the rest is below 1e-20
MOST = 1e15  # a turn of sine is lost in the rounding of larger arguments
NEAR = 1e-9  # share of a turn by which a peak of sine is looked for beyond the ends of a cell


@dataclass(frozen=True)
class Interval:
    """Ends (cells,) of a number in each cell."""

    low: Array
    high: Array

    def __add__(self, other: "Interval") -> "Interval":
        return outwards(self.low + other.low, self.high + other.high)

    def __sub__(self, other: "Interval") -> "Interval":
        return outwards(self.low - other.high, self.high - other.low)

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __mul__(self, other: "Interval") -> "Interval":
        with np.errstate(invalid="ignore"):
            each = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        each = [np.where(np.isnan(x), 0.0, x) for x in each]  # 0 times infinity: an end that is 0 is a true 0
        return outwards(reduce(np.minimum, each), reduce(np.maximum, each))

    def __truediv__(self, other: "Interval") -> "Interval":
        return self * inverse(other)

    @property
    def middle(self) -> Array:
        """A double between the ends."""
        return self.low / 2 + self.high / 2

    def known(self) -> bool:
        """Whether it is one and the same double in all cells: then it is exact."""
        return bool(np.all(self.low == self.high) and np.all(self.low == self.low[0]))


def outwards(low: Array, high: Array) -> Interval:
    """Ends one double further out; what is no number says nothing."""
    low, high = np.nextafter(low, -np.inf), np.nextafter(high, np.inf)
    lost = np.isnan(low) | np.isnan(high)
    return Interval(np.where(lost, -np.inf, low), np.where(lost, np.inf, high))


def number(x: float, like: Interval) -> Interval:
    """The double x in every cell."""
    return Interval(np.full(like.low.shape, x), np.full(like.low.shape, x))


def nothing(like: Interval) -> Interval:
    """All numbers."""
    return Interval(np.full(like.low.shape, -np.inf), np.full(like.low.shape, np.inf))


def where(condition: Mask, a: Interval, b: Interval) -> Interval:
    """Cell by cell the one or the other."""
    return Interval(np.where(condition, a.low, b.low), np.where(condition, a.high, b.high))


def joined(a: Interval, b: Interval) -> Interval:
    """The least interval that holds both."""
    return Interval(np.minimum(a.low, b.low), np.maximum(a.high, b.high))


def rising(function: Callable[[Interval], Interval], x: Interval) -> Interval:
    """A function that grows, from its values at both ends."""
    return Interval(function(Interval(x.low, x.low)).low, function(Interval(x.high, x.high)).high)


def inverse(x: Interval) -> Interval:
    """1/x; all numbers where x may be 0."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = outwards(1 / x.high, 1 / x.low)
    return where((x.low > 0) | (x.high < 0), found, nothing(x))


def square(x: Interval) -> Interval:
    """x^2, never negative."""
    a, b = np.abs(x.low), np.abs(x.high)
    small = np.where((x.low <= 0) & (x.high >= 0), 0.0, np.minimum(a, b))
    big = np.maximum(a, b)
    return Interval(np.maximum(np.nextafter(small * small, -np.inf), 0.0), np.nextafter(big * big, np.inf))


def power(x: Interval, exponent: int) -> Interval:
    """x to a whole number."""
    if exponent < 0:
        return inverse(power(x, -exponent))
    if exponent == 0:
        return number(1.0, x)
    half = square(power(x, exponent // 2)) if exponent > 1 else number(1.0, x)
    if exponent % 2 == 0:
        return half
    if exponent == 1:
        return x
    return rising(lambda end: end * square(power(end, exponent // 2)), x)


def root(x: Interval) -> Interval:
    """Square root; all numbers where x may be negative."""
    low, high = np.sqrt(np.maximum(x.low, 0.0)), np.sqrt(np.maximum(x.high, 0.0))
    found = outwards(low, high)
    return where(x.low >= 0, Interval(np.maximum(found.low, 0.0), found.high), nothing(x))


def size(x: Interval) -> Interval:
    """|x|."""
    a, b = np.abs(x.low), np.abs(x.high)
    return Interval(np.where((x.low <= 0) & (x.high >= 0), 0.0, np.minimum(a, b)), np.maximum(a, b))


def series(x: Interval, first: int, step: int, sign: int) -> Interval:
    """Sum of sign^k x^i / i! over i = first, first + step, ... for |x| <= 0.8, the rest included."""
    total, term = number(0.0, x), x if first else number(1.0, x)
    i, factor = first, power(x, step)
    while i < TERMS:
        total = total + term
        term = term * factor * inverse(number(float(math.prod(range(i + 1, i + step + 1))), x))
        term, i = (-term if sign < 0 else term), i + step
    rest = 2 * np.maximum(np.abs(term.low), np.abs(term.high))
    return total + Interval(-rest, rest)


def bracket(x: float) -> tuple[float, float]:
    """The doubles around a number that was rounded to the nearest."""
    return math.nextafter(x, -math.inf), math.nextafter(x, math.inf)


LN2, QUARTER = bracket(math.log(2)), bracket(math.pi / 2)  # 0.6931471805599453, 1.5707963267948966: within one step


def reduced(x: Interval, unit: tuple[float, float]) -> tuple[Array, Interval]:
    """k and x - k unit for a single double per cell."""
    k = np.rint(x.low / unit[0])
    whole = Interval(k, k) * Interval(np.full(k.shape, unit[0]), np.full(k.shape, unit[1]))
    return k, x - whole


def exponential(x: Interval) -> Interval:
    """e^x."""

    def single(end: Interval) -> Interval:
        at = np.clip(end.low, -700.0, 700.0)
        k, rest = reduced(Interval(at, at), LN2)
        found = series(rest, 0, 1, 1)
        low, high = np.ldexp(found.low, k.astype(int)), np.ldexp(found.high, k.astype(int))
        return Interval(np.where(end.low < -700, 0.0, low), np.where(end.low > 700, np.inf, high))

    return rising(single, x)


def logarithm(x: Interval) -> Interval:
    """log x; all numbers where x may not be positive."""

    def single(end: Interval) -> Interval:
        guess = np.log(np.clip(end.low, 1e-300, 1e300))
        at = Interval(guess, guess)
        off = end * exponential(-at) - number(1.0, end)  # log x = guess + log(1 + off), |log(1 + t) - t| <= t^2
        error = square(off)
        return at + off + Interval(-error.high, error.high)

    fine = (x.low > 1e-300) & (x.high < 1e300)
    return where(fine, rising(single, where(fine, x, number(1.0, x))), nothing(x))


def sine(x: Interval) -> Interval:
    """sin x."""
    return turned(x, 0)


def cosine(x: Interval) -> Interval:
    """cos x = sin(x + pi/2)."""
    return turned(x, 1)


def turned(x: Interval, ahead: int) -> Interval:
    """sin(x + ahead pi/2): the values at both ends, and 1 or -1 where a peak lies between."""
    fine = (np.abs(x.low) < MOST) & (np.abs(x.high) < MOST)
    x = where(fine, x, number(0.0, x))
    a, b = (single_sine(Interval(end, end), ahead) for end in (x.low, x.high))
    both, turn = joined(a, b), 2 * math.pi
    shift = ahead * math.pi / 2

    def holds(peak: float) -> Mask:
        from_, to = (x.low + shift - peak) / turn - NEAR, (x.high + shift - peak) / turn + NEAR
        found: Mask = np.ceil(from_) <= np.floor(to)
        return found

    low = np.where(holds(-math.pi / 2) | ~fine, -1.0, both.low)
    high = np.where(holds(math.pi / 2) | ~fine, 1.0, both.high)
    return Interval(np.maximum(low, -1.0), np.minimum(high, 1.0))


def single_sine(x: Interval, ahead: int) -> Interval:
    """The same for a single double per cell."""
    k, rest = reduced(x, QUARTER)
    s, c = series(rest, 1, 2, -1), series(rest, 0, 2, -1)
    quadrant = np.mod(k + ahead, 4)
    found = where(np.mod(quadrant, 2) == 0, s, c)
    return where(quadrant >= 2, -found, found)


def arctangent(x: Interval) -> Interval:
    """atan x."""

    def single(end: Interval) -> Interval:
        guess = np.arctan(end.low)
        at = Interval(guess, guess)
        s, c = sine(at), cosine(at)
        off = (end * c - s) / (c + end * s)  # atan x = guess + atan(off), |atan t| <= |t|
        error = size(off).high
        return at + Interval(-error, error)

    return rising(single, x)


def tangent_hyperbolic(x: Interval) -> Interval:
    """tanh x = 1 - 2/(e^2x + 1)."""

    def single(end: Interval) -> Interval:
        one, two = number(1.0, end), number(2.0, end)
        small = np.abs(end.low) < 1e-3  # between x - x^3/3 and x
        near = joined(end, end - end * square(end) / number(3.0, end))
        return where(small, outwards(near.low, near.high), one - two / (exponential(two * end) + one))

    found = rising(single, x)
    return Interval(np.maximum(found.low, -1.0), np.minimum(found.high, 1.0))
