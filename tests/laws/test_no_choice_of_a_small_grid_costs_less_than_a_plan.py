"""The cheapest plan costs what the cheapest of all choices costs, and its bound says so.

Two sensors of different prices and a price of each visit, so that neither the number of samples nor that of
measurements decides. Standard deviations by the plain filter, all choices of the grid at once; guarantees by the
accuracy of each choice that costs less.
"""

from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.planning.bounds import CostProver
from sampling_design.planning.covering import CoveringRows
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.filter_deviation import GridFilter
from sampling_design.planning.hidden_trajectories import HiddenTrajectories
from sampling_design.records.budget import Budget
from tests.cases import few

STEPS, QUARTERS, PERIODS, NOISE = 5, 4, 40, 0.1
ROUNDING = 1e-6
DEAREST = 3  # guarantees of so many choices that cost less, none part of another, are worked out
BETWEEN = 0.02  # how much larger deviations may be between quarters of steps, or by the search's margin


def every_choice():
    """What each of two sensors measures at each step, the first sample at step 0 (B, M, 2)."""
    parts = [(0, 0), (1, 0), (0, 1), (1, 1)]
    return np.array([c for c in product(parts, repeat=STEPS) if any(c[0])], dtype=bool)


def deviations(A, C, intensity, step, choices):
    """Largest standard deviation of each state at quarters of steps (B, n), by the plain filter from nothing known."""
    n = len(A)
    joint = expm(np.block([[-A, intensity * np.eye(n)], [np.zeros((n, n)), A.T]]) * step / QUARTERS)
    F = joint[n:, n:].T
    P, Q = np.tile(1e4 * np.eye(n), (len(choices), 1, 1)), F @ joint[:n, n:]
    for _ in range(PERIODS):
        worst = np.zeros((len(choices), n))
        for measured in np.moveaxis(choices, 1, 0):
            for _ in range(QUARTERS):
                P = F @ P @ F.T + Q
                worst = np.maximum(worst, np.diagonal(P, axis1=1, axis2=2))
            for c, taken in zip(C, measured.T, strict=True):
                gain = P @ c / (np.einsum("i,bij,j->b", c, P, c) + NOISE**2)[:, None]
                P = P - taken[:, None, None] * gain[:, :, None] * np.einsum("i,bij->bj", c, P)[:, None, :]
    return np.sqrt(worst)


def deviation_case(seed):
    """A generator, a plant, what is asked but tolerances, all choices, their costs and what each leaves unknown."""
    rng = np.random.default_rng(seed)
    A, C = rng.standard_normal((2, 2)) * 0.7, rng.standard_normal((2, 2))
    A -= max(0.0, float(np.linalg.eigvals(A).real.max()) - 0.1) * np.eye(2)
    step, intensity, visit = rng.uniform(0.4, 1.2), rng.uniform(0.02, 0.1) ** 2, float(rng.integers(0, 3))
    price = rng.choice([1.0, 2.0, 3.0], size=2)
    choices = every_choice()
    costs = choices.any(axis=2).sum(axis=1) * visit + choices.sum(axis=1) @ price
    given = {
        "period": STEPS * step,
        "grid": step,
        "w_intensity": intensity,
        "visit_price": visit,
        "sensors": {f"y{j + 1}": {"noise_deviation": NOISE, "price": float(c)} for j, c in enumerate(price)},
    }
    return rng, sd.Plant(A, C), given, choices, costs, deviations(A, C, intensity, step, choices)


def planned(plant, tolerances, given):
    goals = {f"x{i + 1}": {"tolerance": float(e), "kind": "standard deviation"} for i, e in enumerate(tolerances)}
    return sd.plan_samples(
        plant, sd.PlanRequirement(goals, **given), certificate=False, robustness=False, from_start=False
    )


@pytest.mark.parametrize("seed", few(range(24), 21))
def test_a_plan_costs_what_the_cheapest_of_all_choices_costs(seed):
    rng, plant, given, choices, costs, reached = deviation_case(seed)
    wanted = reached[rng.integers(len(choices))] * rng.uniform(1.03, 1.3)
    ratios = (reached / wanted).max(axis=1)
    plan = planned(plant, wanted, given)
    least, sure = costs[ratios <= 1 + ROUNDING].min(), costs[ratios <= 1 - BETWEEN].min()
    assert plan.bound.cost.value <= least <= plan.cost <= sure
    assert plan.bound.cost.value == least
    assert plan.status == "complete"
    assert plan.verify()
    problem = plan.problem
    covering, grid_filter = CoveringRows(problem, fixed=problem.is_free), GridFilter(problem, discretize(problem))
    pool = HiddenTrajectories(STEPS, [problem.ends(g) for g in range(len(problem.goals))])
    prover = CostProver(covering, pool, Budget(counted=True), None, grid_filter)
    assert prover.least_cost(1.0, float(costs.max())).value == least  # as much as is true, where more is asked


@pytest.mark.parametrize("seed", few(range(12), 10))
@pytest.mark.parametrize("limit", ["samples", "cost_limit"])
def test_a_limit_beside_the_least_cost_is_kept_or_no_choice_within_it_does(limit, seed):
    rng, plant, given, choices, costs, reached = deviation_case(seed)
    taken = choices.any(axis=2).sum(axis=1) if limit == "samples" else costs
    most = float(np.quantile(taken, rng.uniform(0, 0.6), method="lower"))
    within = taken <= most * (1 + ROUNDING)
    given |= {"aim": "cheapest", limit: int(most) if limit == "samples" else most}
    wanted = reached[within].min(axis=0) * rng.uniform(0.8, 1.4)  # of several choices, or of none
    if (reached[within] / wanted).max(axis=1).min() > 1:
        with pytest.raises(sd.errors.InfeasibleRequirementError) as refused:
            planned(plant, wanted, given)
        wanted = np.array([refused.value.nearest[goal] for goal in ("x1", "x2")])
    ratios = (reached[within] / wanted).max(axis=1)
    assert ratios.min() <= 1
    plan = planned(plant, wanted, given)
    assert plan.keeps
    assert plan.verify()
    assert (plan.samples if limit == "samples" else plan.cost) <= most * (1 + ROUNDING)
    assert plan.cost <= costs[within][ratios <= 1 - BETWEEN].min(initial=np.inf)


def guaranteed_case(seed):
    """A plant, its bounds, and a requirement of guaranteed tolerances that the densest schedule keeps."""
    rng = np.random.default_rng(seed)
    A, C = rng.standard_normal((2, 2)) * 0.6, rng.standard_normal((2, 2))
    A -= max(0.0, float(np.linalg.eigvals(A).real.max()) - 0.05) * np.eye(2)
    step, noise, price = rng.uniform(0.2, 0.7), rng.uniform(0.05, 0.2, 2), rng.choice([1.0, 2.0, 3.0, 5.0], 2)
    bounds = {"w_bound": 0.1, "v_bound": noise.tolist(), "of": ["x1", "x2"]}
    plant, times = sd.Plant(A, C), np.arange(STEPS) * step
    dense = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule.from_times(times, STEPS * step), **bounds)
    tolerances = dense.upper * rng.uniform(1.05, 2.5, 2)
    sensors = {f"y{j + 1}": {"noise_bound": float(noise[j]), "price": float(price[j])} for j in range(2)}
    requirement = sd.PlanRequirement(
        dict(zip(("x1", "x2"), tolerances.tolist(), strict=True)),
        period=STEPS * step,
        grid=step,
        w_bound=0.1,
        visit_price=float(rng.integers(0, 3)),
        sensors=sensors,
    )
    return plant, bounds, requirement, tolerances, times


@pytest.mark.parametrize("seed", few([*range(2, 11), 32, 41, 75], 11))
def test_a_guaranteed_plan_costs_what_the_cheapest_of_all_choices_costs(seed):
    plant, bounds, requirement, tolerances, times = guaranteed_case(seed)
    plan = sd.plan_samples(plant, requirement, certificate=False, robustness=False, from_start=False)
    assert plan.bound.cost.value == plan.cost
    assert plan.status == "complete"
    turns = ([np.roll(each, t, axis=0).tobytes() for t in range(STEPS)] for each in every_choice())
    choices = np.array([each for each, turned in zip(every_choice(), turns, strict=True) if turned[0] == max(turned)])
    cheaper = choices[[plan.problem.cost(each) < plan.cost * (1 - ROUNDING) for each in choices]]
    joined = np.einsum("amp,bmp->ab", cheaper.astype(int), ~cheaper)  # 0: the one is part of the other
    np.fill_diagonal(joined, 1)
    dearest = sorted(cheaper[joined.min(axis=1, initial=1) > 0], key=plan.problem.cost, reverse=True)
    for each in dearest[:DEAREST]:
        at = each.any(axis=1)
        schedule = sd.PeriodicSchedule.from_times(times[at], requirement.period, outputs=each[at])
        try:
            upper = sd.guaranteed_accuracy(plant, schedule, **bounds).upper
        except sd.errors.NotDetectableError:
            continue
        assert np.any(upper > tolerances)
