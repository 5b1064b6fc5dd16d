"""Plain counting of samples, for judging the schedules room. Imports nothing of it."""

import itertools
from fractions import Fraction


def sets_by_definition(gaps, count):
    """K_1, ..., K_count of Definition 2 as lists of exact fractions, from the gaps d_1, d_2, ... as given."""
    d = [Fraction(g) for g in gaps]
    result = []
    for i in range(count):
        total, times = Fraction(0), []
        for gap in d[i:]:
            total += gap
            times.append(total)
        result.append(times)
    return result


def least_count(times, window, last_start):
    """Least number of `times` in a closed window [s, s + window], s in [0, last_start] real.

    The count changes only where a sample enters or leaves: every such s is tried, and a point between each two.
    """
    times, window, last_start = [Fraction(t) for t in times], Fraction(window), Fraction(last_start)
    edges = {Fraction(0), last_start}
    for t in times:
        edges |= {s for s in (t, t - window) if 0 <= s <= last_start}
    edges = sorted(edges)
    starts = edges + [(a + b) / 2 for a, b in itertools.pairwise(edges)]
    return min(sum(1 for t in times if s <= t <= s + window) for s in starts)


def largest_count(times, window):
    """Largest number of `times` in any closed window of that length."""
    times, window = [Fraction(t) for t in times], Fraction(window)
    return max((sum(1 for u in times if t <= u <= t + window) for t in times), default=0)
