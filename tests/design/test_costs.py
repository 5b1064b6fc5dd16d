"""A limit on cost: what is measured fits it, and no affordable schedule exceeds the bound."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from scipy.optimize import linprog

from sampling_design import Plant, Requirement, design_schedule, read_requirement
from sampling_design.design import sample_losses
from sampling_design.design.bounds import relaxation
from sampling_design.design.bounds.weak_duality import best_choice
from sampling_design.design.problem.posing import pose
from sampling_design.design.problem.requirement import write_requirement
from sampling_design.design.search.costs import relax_costly
from sampling_design.errors import InfeasibleRequirementError
from sampling_design.numerics import conic_programs
from tests.cases import few
from tests.oracles.design import is_allowed, window_sigma_scan

A = np.kron(np.diag([1.0, 2.0]), [[0.0, 1.0], [-1.0, 0.0]])
C = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
PLANT = Plant(A, C)
SMALL = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.3, 1.0]])
COSTS = np.array([2.0, 1.0])
OUTPUTS = {"y1": {"price": 2.0}, "y2": {"price": 1.0}}


def asked(**more):
    return Requirement(**{"window": 4.0, "spacing": 0.3, "samples": 4, "sensors": OUTPUTS, **more})


def best_affordable(points, count, limit, forbidden=(), fixed=()):
    """Every choice of outputs on every schedule of a grid."""
    grid, best = np.arange(points) * 4.0 / points, 0.0
    for chosen in combinations(grid, count):
        if not is_allowed(np.array(chosen), 4.0, 0.3, forbidden, fixed):
            continue
        for rows in product(((True, False), (False, True), (True, True)), repeat=count):
            mask = np.array(rows)
            if limit - 1 < (mask * COSTS).sum() <= limit:  # more outputs never see less
                best = max(best, window_sigma_scan(A, C, chosen, 4.0, 4.0, places=0, mask=mask))
    return best


def by_sets(case):
    """The relaxation with a weight for each set of outputs that a sample can measure.

    Its value, and what multipliers and a price prove of it: a linear program.
    """
    grid, _, starts, (crowd, most) = relaxation.relaxation_grid(case)
    times = np.append(grid, case.fixed)
    there = case.mask(times)
    picks = [(i, s) for i, m in enumerate(there) for s in product(*([False, True][: 1 + a] for a in m)) if any(s)]
    at, sets = np.array([i for i, _ in picks]), np.array([s for _, s in picks])
    rows = relaxation.rows_at(case, times, starts, there)[:, at]
    rows = rows * np.tile(sets, rows.shape[2] // sets.shape[1])[None, :, :, None]
    equal = np.array([at < grid.size, *(at == grid.size + i for i in range(case.fixed.size))], dtype=float)
    bounded = np.vstack([sets @ case.costs, crowd @ (at == np.arange(grid.size)[:, None]), -np.eye(at.size)])
    sums = np.array([case.samples - case.fixed.size, *np.ones(case.fixed.size)])
    limits = np.array([case.cost_limit, *most, *np.zeros(at.size)])
    programs = ("zero", equal, sums), ("nonnegative", bounded, limits)
    blocks = [(kind, np.pad(left, ((0, 0), (0, 1))), right) for kind, left, right in programs]
    roof = conic_programs.svec(case.rows.N)
    for c in rows:
        grams = conic_programs.svec(np.swapaxes(c, -1, -2) @ c)
        blocks.append(("psd", np.hstack([-grams.T, roof[:, None]]), np.zeros(roof.size)))
    found = conic_programs.solve_cone_program(np.append(np.zeros(at.size), -1.0), blocks, tolerance=1e-10)

    def proven(Z, price):
        gains = np.einsum("mjpa,mab,mjpb->j", rows, Z, rows, optimize=True) - price * (sets @ case.costs)
        best = linprog(-gains, bounded[1 : 1 + most.size], most, equal, sums)
        return price * case.cost_limit - best.fun

    return found.x[-1] / case.rows.unit, proven


THREE = Plant(A, np.vstack([C, [0.0, 1.0, 0.0, 0.5]]))
HOURS = {"y1": {"price": 2.0, "available": [[0, 3]]}, "y2": {"price": 1.0, "available": [[2, 4]]}}


@pytest.mark.parametrize("states", [0, 12])
@pytest.mark.parametrize(
    ("plant", "limit", "more"),
    few([
        (PLANT, 7.0, {}),
        (PLANT, 4.1, {}),
        (PLANT, 9.0, {"window": 8.0}),
        (PLANT, 13.0, {"period": 8.0, "samples": 8}),
        (PLANT, 9.0, {"forbidden": [[1.1, 1.9]], "fixed": [0.0, 2.5]}),
        (PLANT, 8.0, {"fixed": [0.0, 1.1, 2.0, 3.2]}),
        (PLANT, 7.0, {"sensors": HOURS}),
        (PLANT, 5.0, {"sensors": {"y1": {"price": 2.0}, "y2": {"price": 0.0}}}),
        (THREE, 14.0, {"timing_tolerance": 0.02, "sensors": OUTPUTS | {"y3": {"price": 3.0}}}),
    ], 1, 3, 4, 7),
    ids=["any", "tight", "longer", "shorter", "fixed and closed", "all fixed", "hours", "one free", "three, late"],
)  # fmt: skip
def test_the_relaxation_is_that_of_a_weight_for_each_set_of_outputs(monkeypatch, states, plant, limit, more):
    """By both solvers: its value, and multipliers and a price that prove as much."""
    requirement = asked(cost_limit=limit, **{"period": 4.0, **more})
    case = pose(plant, requirement, requirement.samples["exactly"])
    assert case.is_costly
    value, proven = by_sets(case)
    monkeypatch.setattr(relaxation, "MANY_STATES", states)
    found = relax_costly(case)
    assert found.record.name == ("Clarabel" if states else "sampling_design")
    assert found.value == pytest.approx(value, rel=1e-5)
    assert found.weights.sum() == pytest.approx(case.samples - case.fixed.size, abs=1e-6)
    assert proven(found.Z, found.price) <= value * (1 + 1e-5)


@pytest.mark.long
@pytest.mark.parametrize(
    ("limit", "more"), [(7.0, {}), (9.0, {}), (9.0, {"forbidden": [[1.1, 1.9]]}), (7.0, {"fixed": [0.0]})]
)
def test_no_affordable_schedule_exceeds_the_bound_and_few_exceed_the_design(limit, more):
    design = design_schedule(PLANT, asked(cost_limit=limit, **more), starts=2, branches=0)
    best = best_affordable(7, 4, limit, **more)
    assert 0 < best <= design.upper_bound
    assert design.sigma_attained >= best * (1 - 1e-6)
    assert design.cost <= limit
    assert design.upper_bound < design_schedule(PLANT, asked(**more), starts=1).upper_bound
    assert design.verify()


def test_a_limit_that_does_not_bind_changes_nothing():
    free, rich = (design_schedule(SMALL, asked(**more), starts=1, branches=0) for more in ({}, {"cost_limit": 12.0}))
    assert rich.sigma == free.sigma
    assert rich.schedule.outputs is None
    assert rich.cost == 12.0


@pytest.mark.long
def test_more_money_never_sees_less():
    sigmas = [design_schedule(PLANT, asked(cost_limit=c), starts=1, branches=0).upper_bound for c in (7.0, 9.0, 12.0)]
    assert sigmas == sorted(sigmas)


def test_a_design_over_its_limit_or_with_a_false_price_does_not_verify():
    design = design_schedule(PLANT, asked(cost_limit=9.0), starts=1, branches=0)
    assert not replace(design, requirement=design.requirement.replace(cost_limit=8.0)).verify()
    part = design.bound.parts[0]
    assert part.price > 0
    assert replace(part, price=-part.price).value_for(design.problem) == np.inf
    assert replace(part, price=0.5 * part.price).value_for(design.problem) >= design.upper_bound
    assert "of 9" in str(design)


def test_the_best_choice_is_the_best_by_enumeration():
    rng = np.random.default_rng(2)
    values, prices = rng.random((30, 3)), rng.random(3)
    mask = rng.random((30, 3)) < 0.7
    sets = [np.array(s, dtype=bool) for s in product((0, 1), repeat=3) if any(s)]
    for v, m, found in zip(values, mask, best_choice(values, mask, prices), strict=True):
        assert found == pytest.approx(max([sum((v - prices)[s]) for s in sets if not np.any(s & ~m)], default=-np.inf))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        pytest.param(
            {"cost_limit": 3.0},
            "`cost_limit` 3 is less than 4 of the cheapest measurements cost",
            marks=pytest.mark.long,
        ),
        (
            {
                "cost_limit": 5.0,
                "spacing": 0.9,
                "sensors": {
                    "y1": {"price": 5.0, "available": [[0.0, 2.0]]},
                    "y2": {"price": 1.0, "available": [[2.0, 4.0]]},
                },
            },
            "`cost_limit` 5 is not kept by any schedule that was found",
        ),
    ],
)
def test_a_limit_that_is_too_low_names_one_that_works(changes, words):
    requirement = asked(**changes)
    with pytest.raises(InfeasibleRequirementError, match=words) as caught:
        design_schedule(SMALL, requirement, starts=1, branches=0)
    assert caught.value.obstacle == "cost_limit"
    alone = {"cost_limit": caught.value.nearest["cost_limit"]}
    for change in [alone] if alone == caught.value.nearest else [alone, caught.value.nearest]:
        assert design_schedule(SMALL, requirement.replace(**change), starts=1, branches=0).verify()


def test_the_limit_is_kept_in_files_and_words(tmp_path):
    requirement = asked(cost_limit=7.5)
    again = read_requirement(write_requirement(requirement, tmp_path / "r.toml"))
    assert again.cost_limit == 7.5
    assert "cost at most 7.5 a period" in again.explain()
    assert "cost limit" in str(again)


@pytest.mark.long
def test_losses_of_a_design_that_chooses_outputs():
    design = design_schedule(SMALL, asked(samples=4, cost_limit=9.0), starts=1, branches=0)
    losses = sample_losses(design, every_period=True)
    times, mask = design.schedule.times, design.schedule.outputs
    for i in range(4):
        scan = window_sigma_scan(SMALL.A, SMALL.C, np.delete(times, i), 4.0, 4.0, mask=np.delete(mask, i, axis=0))
        assert losses.lower[i] == pytest.approx(scan, rel=5e-3)
        assert losses.lower[i] <= losses.bound[i]
