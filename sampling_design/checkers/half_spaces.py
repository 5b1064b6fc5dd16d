"""Does a box hold a point of some half-spaces? In rational numbers, so that neither answer is a matter of rounding."""

from fractions import Fraction
from math import isfinite

from .strict import Array

MOST_ENTRIES = 300_000  # of the tables that are made before the question is left open


def holds_a_point(low: Array, high: Array, rows: Array, offsets: Array) -> bool | None:
    """Whether some x has low <= x <= high and rows x <= offsets (infinite: no bound); None where it takes too long.

    The simplex method without a goal: the first sum beyond its bound is brought to it by the first of the numbers it
    depends on that has room, and the two change places; where none has room there is no such x. (Bland: no cycle.)
    """
    n, m = len(low), len(rows)
    least = [exact(x) for x in low.tolist()] + [None] * m
    most = [exact(x) for x in [*high.tolist(), *offsets.tolist()]]
    value = [middle(a, b) for a, b in zip(least[:n], most[:n], strict=True)]
    free, sums = list(range(n)), list(range(n, n + m))
    table = [[Fraction(x) for x in row] for row in rows.tolist()]
    value += [sum((c * x for c, x in zip(row, value, strict=True)), Fraction(0)) for row in table]
    for _ in range(MOST_ENTRIES // max(1, n * m)):
        over = [(k, most[k]) for k in sums if (end := most[k]) is not None and value[k] > end]
        under = [(k, least[k]) for k in sums if (end := least[k]) is not None and value[k] < end]
        if not over + under:
            return True
        leaving, aim = min(over + under, key=lambda item: item[0])
        assert aim is not None
        i, up = sums.index(leaving), aim > value[leaving]
        slopes = [(k, c) for k, c in zip(free, table[i], strict=True) if c]
        roomy = [k for k, c in slopes if has_room(value[k], least[k], most[k], up == (c > 0))]
        if not roomy:
            return False
        entering = min(roomy)
        j = free.index(entering)
        step = (aim - value[leaving]) / table[i][j]
        value[entering] += step
        for k, row in zip(sums, table, strict=True):
            value[k] += row[j] * step
        sums[i], free[j], pivot = entering, leaving, table[i][j]
        own = [1 / pivot if k == j else -c / pivot for k, c in enumerate(table[i])]
        for row in table:
            factor, row[j] = row[j], Fraction(0)
            row[:] = [c + factor * o for c, o in zip(row, own, strict=True)]
        table[i] = own
    return None


def exact(x: float) -> Fraction | None:
    """The number; None where there is no bound."""
    return Fraction(x) if isfinite(x) else None


def middle(low: Fraction | None, high: Fraction | None) -> Fraction:
    """The middle of two bounds, or what is nearest to 0 where one is missing."""
    if low is not None and high is not None:
        return (low + high) / 2
    return max(low, Fraction(0)) if low is not None else Fraction(0) if high is None else min(high, Fraction(0))


def has_room(value: Fraction, low: Fraction | None, high: Fraction | None, up: bool) -> bool:
    """Whether a number may move that way."""
    return (high is None or value < high) if up else (low is None or value > low)
