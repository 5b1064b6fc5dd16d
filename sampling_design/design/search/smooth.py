"""All times at once by a quasi-Newton method, for plants whose flow stretches no state.

The least eigenvalue over all windows is made smooth, and ever less so (`OrthogonalFlowWindows.soft`). Where several
eigenvalues tie that ends a little below what small semidefinite programs reach (`refined`), from far away and at a
tenth of their time: many starts can be led to their best schedules.
"""

from __future__ import annotations

import numpy as np

from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.orthogonal_flow import OrthogonalFlowWindows
from sampling_design.design.search.fedorov_exchange import is_admissible, repaired
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget

_SHARPNESS = (100.0, 600.0, 3000.0)  # in 1/sigma^2: e^{-sharpness} is what an eigenvalue twice the least one weighs
_STEPS = (25, 60, 60)  # of each; after the first few it shows what a start is worth
_LOOKS = 3  # at the function in a step, about, at most
_BLIND = 1e-3  # of the mean eigenvalue: the sigma^2 at least by which sharpness is counted
_CROWDED = 100.0  # price of a gap that is short by a mean gap, in sigma^2: a hundredth of a gap costs a hundredth of it
_INSIDE = 1e-9  # of the period: how far a time stays from the end of an interval


def smoothed(
    problem: DesignProblem,
    orthogonal_flow: OrthogonalFlowWindows,
    times: Array,
    wanted: float = 0.0,
    budget: Budget = ENDLESS,
) -> Array | None:
    """Admissible times near a best schedule that `times` lead to, or on the way there at the `budget`.

    None where they can not be pushed apart, where no sample shows anything, or where sigma^2 is below `wanted` after
    the first steps.
    """
    from scipy.optimize import minimize

    low, high = _room(problem, times)
    mask, first = problem.measured(times), True
    for sharpness, steps in zip(_SHARPNESS, _STEPS, strict=True):
        grams = orthogonal_flow.grams(times[None], mask[None])
        mean, least = float(np.trace(grams[0, 0])) / grams.shape[-1], float(np.linalg.eigvalsh(grams).min())
        if not mean or (not first and least < wanted):
            return None
        first, unit = False, max(least, _BLIND * mean)

        def loss(t: Array, sharpness: float = sharpness / unit, unit: float = unit) -> tuple[float, Array]:
            value, slope = orthogonal_flow.soft(t, mask, sharpness)
            price, push = _crowding(problem, t)
            return price - value / unit, push - slope / unit

        once = Budget()
        loss(times)
        took = once.spent
        looks = min(budget.left / took, float(_LOOKS * steps)) if took > 0 else _LOOKS * steps
        if looks < 1:
            break
        options = {"maxiter": steps, "maxfun": int(looks)}
        bounds = np.stack([low, high], axis=1)
        times = np.asarray(minimize(loss, times, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x)
    wrapped = np.sort(np.mod(times, problem.period))
    return wrapped if is_admissible(problem, wrapped) else repaired(problem, wrapped)


def _room(problem: DesignProblem, times: Array) -> tuple[Array, Array]:
    """How far each time may go: fixed ones nowhere, the others to the ends of where the same is measured."""
    low, high = np.full(times.size, -np.inf), np.full(times.size, np.inf)
    if not problem.is_shift_invariant:
        edges = problem.breakpoints
        place = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, edges.size - 2)
        low, high = edges[place], np.maximum(edges[place + 1] - _INSIDE * problem.period, edges[place])
    frozen = np.isin(times, problem.fixed)
    return np.where(frozen, times, low), np.where(frozen, times, high)


def _crowding(problem: DesignProblem, times: Array) -> tuple[float, Array]:
    """What gaps shorter than allowed cost, and its gradient."""
    mean = problem.period / problem.samples
    gaps = np.diff(np.append(times, times[0] + problem.period))
    short = np.maximum(problem.gap - gaps, 0.0) / mean
    push = -2 * _CROWDED * short / mean
    return _CROWDED * float(short @ short), np.roll(push, 1) - push
