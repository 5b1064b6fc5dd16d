"""A limit on what the measurements of a period may cost: which outputs each sample measures.

The relaxation weighs outputs one by one, and the multiplier of the limit is the price at which the bound
over all real times is taken. The choice for a schedule starts from everything that can be measured and
gives up, one by one, what costs most for what it brings; then pairs are exchanged.
"""

from __future__ import annotations

import numpy as np

from sampling_design.design.bounds.relaxation import (
    Relaxation,
    feasible_multipliers,
    relaxation_grid,
    rows_at,
    solve_program,
    unsolved,
)
from sampling_design.design.problem.design_problem import SLACK, DesignProblem, affordable_choices
from sampling_design.design.problem.feasible import changed
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.design.search.fedorov_exchange import at_shares, even, is_admissible, refined, rounded
from sampling_design.design.search.local_search import FIRST_STEPS, HOPELESS, FoundSchedule, SearchTrial
from sampling_design.errors import InfeasibleRequirementError
from sampling_design.numerics.eigenvalue_program import MixedMatrices
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import ENDLESS, Budget

_WEAK = 0.1  # of a row: what is left out still counts so much where every choice is blind
_TOGETHER = 2_000_000  # operations between two looks at the clock, about: choices of what samples measure, times n^3
_PAIRS = 400  # exchanges that are looked at in one round
_ROUNDS = 6  # exchanges after which the sum of costs has settled
_DRAWN = 8  # random schedules with which every choice is looked at, where choices are few
_EACH, _TRIED = 2, 8  # refined of what the same numbers of outputs measure, and in all


def relax_costly(problem: DesignProblem, seconds: float | None = None) -> Relaxation:
    """Maximise t over weights of samples w and of their measurements u <= w <= sum u with sum cost u within the limit.

    A sample that one output alone can see is its own measurement. The weights u, and one that sees nothing, sum to more
    than they ever reach without it: so each stands in an equation, as `MixedMatrices` asks.
    """
    grid, _, starts, (crowd, limits) = relaxation_grid(problem)
    if seconds is not None and seconds <= 0:
        return unsolved(problem, grid, starts)
    free = grid.size if problem.samples > problem.fixed.size else 0
    program = _program(problem, np.concatenate([grid[:free], problem.fixed]), starts, crowd[:, :free], limits)
    found = solve_program(program, seconds)
    Z, mass = feasible_multipliers(problem, found.Z)
    begin = found.x.size - free - problem.fixed.size - 1
    weights = np.append(found.x[begin : begin + free], np.zeros(grid.size - free))
    price = float(found.l[0]) / problem.cost_limit / mass
    return Relaxation(grid, weights, starts, Z, found.t / problem.rows.unit, found.record, price)


def _program(problem: DesignProblem, times: Array, starts: Array, crowd: Array, limits: Array) -> MixedMatrices:
    """Choices are measurements, then samples at `times`, the fixed ones last, then the one that sees nothing."""
    from scipy import sparse

    free, fixed, paid = crowd.shape[1], problem.fixed.size, _costs(problem) / problem.cost_limit
    mask = problem.mask(times)
    single = mask.sum(axis=1, keepdims=True) == 1
    sample, output = np.nonzero(mask & ~single)  # of each measurement
    each, several = sample.size, np.unique(sample)
    shares = np.append(np.full(free, (problem.samples - fixed) / max(free, 1)), np.ones(fixed))
    halfway = (shares * (1 + 1 / mask.sum(axis=1)) / 2)[sample]  # between w and what w needs at least
    most = float(mask.sum(axis=1).max() * problem.samples)
    first = np.concatenate([halfway, shares, [most - halfway.sum()]])
    group = np.concatenate([np.full(each, -1), np.zeros(free), np.arange(fixed) + 1, [-1]])  # one equation for each
    equal = (group == np.unique(group)[:, None]).astype(float)
    seen = rows_at(problem, times, starts, mask).reshape(starts.size, times.size, -1, *problem.rows.C.shape)
    own = np.sum(seen * single[..., None, None], axis=3)
    unit = sparse.diags_array(1 / shares, format="csr")
    owner = unit[sample]
    limited = [
        [paid[output][None], ((mask * single) @ paid)[None], np.zeros((1, 1))],
        [None, np.pad(crowd, ((0, 0), (0, fixed))), None],
        [sparse.diags_array(1 / shares[sample]), -owner, None],
        [-owner.T.tocsr()[several], unit[several], None],
    ]
    return MixedMatrices(
        rows=np.concatenate([seen[:, sample, :, output].swapaxes(0, 1), own, np.zeros_like(own[:, :1])], axis=1),
        first=first, equal=equal, sums=equal @ first,
        bounded=sparse.block_array(limited, format="csr"),
        limits=np.concatenate([[1.0], limits, np.zeros(each + several.size)]), roof=problem.rows.N,
    )  # fmt: skip


def _costs(problem: DesignProblem) -> Array:
    assert problem.costs is not None
    return problem.costs


def affordable(
    problem: DesignProblem,
    found: FoundSchedule,
    relaxation: Relaxation,
    budget: Budget = ENDLESS,
    enough: float = np.inf,
) -> tuple[FoundSchedule, Mask]:
    """The best schedule within the limit from several starts, and what each of its samples measures.

    Choices are looked at one by one where they are few, until sigma is `enough`: none can be better. Raises
    InfeasibleRequirementError if the outputs that are available at the times that were found all cost too much.
    """
    starts = [("all outputs", found.times)]
    for name, times in (("rounded", rounded(problem, relaxation, 0.5)), ("even", even(problem, 0.5))):
        if times is not None and not budget.over:
            starts.append((name, times))
    best: tuple[float, Array, Mask] | None = None
    trials = list(found.trials)
    for name, times in starts:
        if best is not None and budget.over:
            break
        chosen = thinned(problem, times, budget)
        if chosen is None:
            continue
        before = float(worst_sigma2(problem, times[None], used=chosen[None])[0])
        for _ in range(2):  # times follow the choice, and the choice the times
            times, after = refined(changed(problem, {"chosen": chosen}), times, before, budget=budget)
            again = thinned(problem, times, budget)
            value = 0.0 if again is None else float(worst_sigma2(problem, times[None], used=again[None])[0])
            if again is None or value <= after * (1 + 1e-6):
                break
            chosen, after = again, value
        trials.append(_trial(name, before, after))
        if best is None or after > best[0]:
            best = after, times, chosen
    for times, chosen in [] if budget.over else _promising(problem, [times for _, times in starts]):
        if best is not None and (best[0] >= enough**2 or budget.over):
            break
        before = float(worst_sigma2(problem, times[None], used=chosen[None])[0])
        case = changed(problem, {"chosen": chosen})
        times, after = refined(case, times, before, steps=FIRST_STEPS, budget=budget)
        if best is None or after > HOPELESS * best[0]:
            times, after = refined(case, times, after, budget=budget)
        trials.append(_trial("enumerated", before, after))
        if best is None or after > best[0]:
            best = after, times, chosen
    if best is None:
        least = float(cheapest(problem, found.times).sum())
        raise InfeasibleRequirementError(
            f"`cost_limit` {problem.cost_limit:g} is not kept by any schedule that was found; the cheapest costs "
            f"{least:g}. The nearest that works: cost_limit {least:g}.",
            "cost_limit",
            {"cost_limit": least},
        )
    value, times, chosen = best
    return FoundSchedule(times, float(np.sqrt(max(value, 0.0))), tuple(trials), found.complete), chosen


def _trial(name: str, before: float, after: float) -> SearchTrial:
    return SearchTrial(f"cost limit, {name}", float(np.sqrt(max(before, 0.0))), float(np.sqrt(max(after, 0.0))))


def _promising(problem: DesignProblem, starts: list[Array]) -> list[tuple[Array, Mask]]:
    """Times with a choice each, where choices are few: what sees most at first, of every choice up to its order.

    Greedy choices end where no exchange of two measurements gains; times that suit another choice lie beyond.
    """
    choices = np.array(affordable_choices(problem))
    rng = np.random.default_rng(0)
    drawn = [at_shares(problem, rng.uniform(size=problem.samples - problem.fixed.size)) for _ in range(_DRAWN)]
    pool = [*starts, *(t for t in drawn if t is not None and is_admissible(problem, t))]
    found: list[tuple[float, bytes, Array, Mask]] = []
    for times in pool if choices.size else ():
        fits = choices[np.all(np.any(choices & problem.mask(times), axis=2), axis=1)]
        if not len(fits):
            continue
        values = worst_sigma2(problem, np.broadcast_to(times, fits.shape[:2]), inner=0, used=fits & problem.mask(times))
        for value, chosen in zip(values, fits, strict=True):
            found.append((float(value), np.sort(chosen, axis=0).tobytes(), times, chosen & problem.mask(times)))
    found.sort(key=lambda one: -one[0])
    taken: dict[bytes, int] = {}
    best: list[tuple[Array, Mask]] = []
    for _, kind, times, chosen in found:
        taken[kind] = taken.get(kind, 0) + 1
        if taken[kind] <= _EACH and len(best) < _TRIED:
            best.append((times, chosen))
    return best


def cheapest(problem: DesignProblem, times: Array) -> Array:
    """Cost of the cheapest output that each sample can measure."""
    return np.asarray(np.min(np.where(problem.mask(times), _costs(problem), np.inf), axis=-1))


def thinned(problem: DesignProblem, times: Array, budget: Budget = ENDLESS) -> Mask | None:
    """What each sample measures within the limit; None where even the cheapest outputs exceed it."""
    costs, limit, there = _costs(problem), problem.cost_limit * (1 + SLACK), problem.mask(times)
    if cheapest(problem, times).sum() > limit:
        return None
    used = there.copy()
    while np.sum(used * costs) > limit:
        moves = _drops(used, costs)
        moves = moves if moves.size else _swaps(used, there, costs)
        values = _values(problem, times, moves, budget)
        saved = np.sum(used * costs) - np.sum(moves * costs, axis=(1, 2))
        lost = max(float(values.max()), 0.0) - values
        # where there is no time to tell what is lost, what saves most
        used = moves[int(np.argmin((lost + max(1e-12 * values.max(), np.finfo(float).tiny)) / saved))]
    return _exchanged(problem, times, used, budget)


def _drops(used: Mask, costs: Array) -> Mask:
    """Choices with one costly measurement less, every sample keeping one."""
    spare = used & (used.sum(axis=1, keepdims=True) > 1) & (costs > 0)
    return _flipped(used, list(zip(*np.nonzero(spare), strict=True)))


def _swaps(used: Mask, there: Mask, costs: Array) -> Mask:
    """Choices in which one sample's only costly measurement gives way to a cheaper one."""
    result = []
    for i, j in zip(*np.nonzero(used & (costs > 0)), strict=True):
        for other in np.flatnonzero(there[i] & (costs < costs[j])):
            trial = used.copy()
            trial[i, j], trial[i, other] = False, True
            result.append(trial)
    return np.array(result)


def _flipped(used: Mask, places: list[tuple[int, ...]]) -> Mask:
    result = np.repeat(used[None], len(places), axis=0)
    for row, (i, j) in enumerate(places):
        result[row, i, j] = ~result[row, i, j]
    return result


def _values(problem: DesignProblem, times: Array, choices: Mask, budget: Budget = ENDLESS) -> Array:
    """Worst sigma^2 of each choice; where all are blind, with what is left out seen faintly. Nothing without time."""
    values = _in_time(problem, times, choices, budget)
    if values.max() > 0:
        return values
    weights_of_choice = np.where(choices, 1.0, _WEAK) * problem.mask(times)
    return _in_time(problem, times, weights_of_choice, budget)


def _in_time(problem: DesignProblem, times: Array, used: Mask, budget: Budget) -> Array:
    """Worst sigma^2 of each choice, a batch at a time; 0 of those that the budget ends before."""
    values, each = np.zeros(len(used)), used[0].size * problem.plant.n_states**3
    together = max(1, _TOGETHER // each) if np.isfinite(budget.left) else len(used)
    for low in range(0, len(used), together):
        if budget.over:
            break
        part = used[low : low + together]
        spread = np.broadcast_to(times, (len(part), times.size))
        values[low : low + together] = worst_sigma2(problem, spread, inner=0, used=part)
    return values


def _exchanged(problem: DesignProblem, times: Array, used: Mask, budget: Budget) -> Mask:
    """Add what can be afforded, and exchange one measurement for another, while the worst sigma grows."""
    costs, limit, there = _costs(problem), problem.cost_limit * (1 + SLACK), problem.mask(times)
    rng, value = np.random.default_rng(0), float(_values(problem, times, used[None])[0])
    for _ in range(_ROUNDS * used.size):
        absent = list(zip(*np.nonzero(there & ~used), strict=True))
        moves = list(_flipped(used, absent)) if absent else []
        for i, j in zip(*np.nonzero(used), strict=True):
            moves += [_flipped(m, [(i, j)])[0] for m in moves[: len(absent)]]
        kept = [m for m in moves if np.sum(m * costs) <= limit and m.any(axis=1).all()]
        if not kept or budget.over:
            break
        if len(kept) > _PAIRS:
            kept = [kept[i] for i in rng.choice(len(kept), _PAIRS, replace=False)]
        values = _values(problem, times, np.array(kept), budget)
        top = int(np.argmax(values))
        if values[top] <= value * (1 + 1e-6):
            break
        used, value = kept[top], float(values[top])
    return used
