"""Which samples may be outliers, where at most so many of the last so many are."""

from __future__ import annotations

import math
from itertools import combinations

from sampling_design.errors import ArgumentError
from sampling_design.records import checks

MOST_CASES = 3000  # sets of samples that may be left out: some seconds for a small plant


def left_out(outliers: int | tuple[int, int], count: int) -> list[tuple[int, ...]]:
    """The sets of samples, counted from 0, that may be outliers: those of the largest size hold the others."""
    pair = (outliers, count) if isinstance(outliers, int) else outliers
    if len(pair) != 2:
        raise ArgumentError(f"`outliers` must be a number or a pair (how many, of the last so many), got {outliers!r}.")
    most, among = (checks.whole("outliers", each) for each in pair)
    among = min(among, count)
    if most > among or most >= count:
        raise ArgumentError(f"`outliers` must be of the {count} samples and leave one of them, got {outliers!r}.")
    if math.comb(among, most) > MOST_CASES:
        raise ArgumentError(
            f"`outliers` = {outliers!r} of {count} samples may be {math.comb(among, most)} sets, more than "
            f"{MOST_CASES}: say of how many of the last samples, (1, 10)."
        )
    return list(combinations(range(count - among, count), most))
