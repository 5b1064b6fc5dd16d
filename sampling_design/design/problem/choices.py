"""What the samples of a period can measure for the money there is: every choice that cannot be enlarged.

Whatever an affordable schedule measures is part of one of these choices, which sees no less. They are few where samples
are few, and then each of them is a problem of its own, without a limit on cost: searched and bounded one by one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import combinations_with_replacement, product
from math import comb, factorial, prod

import numpy as np

from sampling_design.design.problem.design_problem import SLACK, DesignProblem
from sampling_design.records.arrays import Mask

Outputs = tuple[bool, ...]

MOST_CHOICES = 48  # choices beyond which they are not looked at one by one
_MOST_COUNTS = 20_000  # of samples by what they measure: more are not counted through


def affordable_choices(problem: DesignProblem) -> list[Mask]:
    """(k, p) each: what sample j of the period measures, counted from any sample; none where there are too many.

    No measurement can be added to one of them within the limit, so that an affordable schedule measures a part of one.
    """
    costs, k = problem.costs, problem.samples
    if costs is None or comb(k + 2**costs.size - 2, k) > _MOST_COUNTS:
        return []
    sets = [outputs for outputs in product((False, True), repeat=costs.size) if any(outputs)]
    found: list[tuple[Outputs, ...]] = []
    orders = 0
    for chosen in combinations_with_replacement(sets, k):
        spare = problem.cost_limit * (1 + SLACK) - float(np.sum(np.array(chosen) * costs))
        absent = ~np.all(chosen, axis=0)
        if spare < 0 or np.any(costs[absent] <= spare):
            continue
        orders += factorial(k) // prod(factorial(n) for n in Counter(chosen).values())
        if orders > MOST_CHOICES:
            return []
        found.append(chosen)
    return [np.array(line) for chosen in found for line in _orders(Counter(chosen))]


def _orders(left: Counter[Outputs]) -> Iterator[tuple[Outputs, ...]]:
    """Every order of these sets, each once."""
    if not left:
        yield ()
    for outputs in sorted(left):
        for rest in _orders(left - Counter([outputs])):
            yield (outputs, *rest)
