"""Schedules that repeat within the period: where a sample leaves a window, another enters at the same instant.

Where window/period = a/b in lowest terms and no window can spare a sample, every sample has another one window
later, so that the whole schedule repeats after period/b. No search that moves samples one by one finds such ties;
the problem folded to period/b, of which the window is a whole multiple, has none to find.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from sampling_design.design.problem.canonical import SAME_RATIO
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.feasible import obstacle
from sampling_design.records.arrays import Array, Mask
from sampling_design.schedules.sensor import complement, joined


def parts(problem: DesignProblem) -> int:
    """How many times a schedule repeats in the period if a sample leaves whenever another enters; 1 if it need not."""
    ratio = problem.window / problem.period
    near = Fraction(ratio).limit_denominator(problem.samples)
    return near.denominator if abs(float(near) - ratio) <= SAME_RATIO * ratio else 1


def folded(problem: DesignProblem) -> DesignProblem | None:
    """The problem of one of the equal parts; None where there is one part only, or no schedule repeats like that."""
    count = parts(problem)
    if count < 2 or problem.samples % count or problem.chosen is not None:
        return None
    period = problem.period / count
    fixed = np.sort(np.mod(problem.fixed, period))
    apart = np.append(np.diff(fixed) > SAME_RATIO * problem.period, True)[: fixed.size]
    part = DesignProblem(
        plant=problem.plant,
        window=problem.window,
        period=period,
        spacing=problem.spacing,
        samples=problem.samples // count,
        forbidden=_folded(problem.forbidden, period, count),
        fixed=fixed[apart],
        available=tuple(  # what intervals have in common in every part
            None if a is None else complement(_folded(complement(a, problem.period), period, count), period)
            for a in problem.available
        ),
        costs=problem.costs,
        cost_limit=problem.cost_limit / count,
    )
    part.__dict__["rows"] = problem.rows
    return part if obstacle(part) is None else None


def unfolded(problem: DesignProblem, count: int, times: Array, chosen: Mask) -> tuple[Array, Mask]:
    """The times of one of `count` parts and what they measure, over the whole period, fixed times to the last bit."""
    whole = (times + problem.period * (np.arange(count) / count)[:, None]).ravel()
    for t in problem.fixed:
        whole[np.argmin(np.abs(whole - t))] = t
    order = np.argsort(whole)
    return whole[order], np.tile(chosen, (count, 1))[order]


def _folded(spans: Array, period: float, count: int) -> Array:
    """Every interval in every part, as disjoint sorted intervals of [0, period)."""
    pieces = [(a - cycle * period, b - cycle * period) for a, b in spans for cycle in range(count + 1)]
    inside = [(max(float(a), 0.0), min(float(b), period)) for a, b in pieces if b > 0 and a < period]
    return joined(np.array(inside).reshape(-1, 2))
