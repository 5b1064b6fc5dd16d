"""A plan keeps its tolerances from when on it says, whatever the error was at its start, or within `initial_error`."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.planning.dates import plan_dates
from sampling_design.planning.deadline import _ending, _in_gap
from sampling_design.planning.disturbed import (
    NEARLY,
    _own_gains_from_start,
    from_start,
    left_by_own_gains,
    plan_start,
    settled_from_start,
)
from sampling_design.planning.figures import PlanStart
from sampling_design.planning.requirement_file import plan_requirement_from_dict
from sampling_design.planning.sequence import looks_back, spans_of
from sampling_design.planning.sequence_deviation import planned
from sampling_design.planning.sequence_system import plan_system
from tests.cases import few

BARE = {"certificate": False, "robustness": False}
LEVEL = sd.Plant([[0.0]], [[1.0]], states=["a"], outputs=["y"])
TANK = sd.Plant([[0.0, 0.02], [0.0, -0.05]], np.eye(2), time_unit="h", states=["a", "b"], outputs=["y", "z"])


def seen(A):
    return sd.Plant(A, [[1.0, 0.0]], states=["a", "b"], outputs=["y"])


PLANTS = {
    "level": (LEVEL, 8.0, 0.1, 0.1, 0.52),
    "oscillator": (seen([[0.0, 1.0], [-1.0, 0.0]]), 6.4, 0.02, 0.2, 0.35),
    "growing": (seen([[0.2, 1.0], [0.0, -0.5]]), 6.0, 0.02, 0.1, 0.6),
}
ERRORS = (None, 50.0, 0.3, {"a": (-0.1, 0.1)}, 1e-3)
SIZES = (np.inf, 50.0, 0.3, 1e-3)


def asked(name, error, unit=1.0):
    plant, period, w, v, tolerance = PLANTS[name]
    wanted = {"a": tolerance * unit}
    terms = {"y": {"noise_bound": v * unit}}
    given = {"period": period, "grid": period / 16, "w_bound": w * unit, "sensors": terms, "initial_error": error}
    return plant, sd.PlanRequirement(wanted, **given)


@pytest.fixture(scope="module")
def plans():
    """Sought with a budget: the growing one ends by itself, and the others at what they have soon."""
    return {name: sd.plan_samples(*asked(name, None), search_seconds=0.2, **BARE) for name in PLANTS}


def started(plan, name, error):
    """The same samples, with another error at the start."""
    return replace(plan, requirement=asked(name, error)[1], start=None)


@pytest.mark.parametrize(("error", "name"), few(product(ERRORS, PLANTS), 0, 2, 7), ids=str)
def test_no_motion_of_a_finite_schedule_breaks_what_a_plan_says_of_its_start(plans, name, error):
    plan = started(plans[name], name, error)
    found = plan_start(plan)
    assert found.bounded is (error is not None)
    assert found.ratio <= 1
    samples = from_start(plan, found.from_time + 2 * plan.schedule.period)
    problem = plan.problem
    end = float(samples.times[-1])
    alone = sd.guaranteed_accuracy(
        plan.plant,
        sd.Schedule(samples.times[samples.measured[:, 0]]),
        w_bound=plan.requirement.w_bound,
        v_bound=float(problem.v_bound[0]),
        initial_error=error,
        start=0.0,
        end=end,
        of=["a"],
    )
    edges, lower = alone.profile.edges, np.where(np.isfinite(alone.profile.upper[0]), alone.profile.lower[0], np.inf)
    after = edges[:-1] >= found.from_time + 1e-9
    tolerance = plan.goals[0].tolerance
    assert np.max(lower[after]) <= found.ratio * tolerance * (1 + 1e-9)
    if found.from_time:  # and in the gap before it the tolerance is broken, or the state is not known yet
        last = samples.times[samples.times < found.from_time - 1e-9][-1]
        assert np.max(lower[(edges[:-1] >= last - 1e-9) & ~after]) > 0.98 * tolerance


@pytest.mark.parametrize("name", few(PLANTS, 2))
def test_a_smaller_error_at_the_start_is_never_outgrown_later(plans, name):
    times = [plan_start(started(plans[name], name, None if size == np.inf else size)).from_time for size in SIZES]
    assert times == sorted(times, reverse=True)
    assert times[-1] == 0.0


def test_before_the_first_samples_the_next_one_is_not_said_to_keep_what_nobody_knows(plans):
    for error, keeps, record in ((None, False, None), (1e-3, True, [(0.0, [0.0])])):
        found = sd.next_sample(started(plans["oscillator"], "oscillator", error), record, now=0.0)
        assert found.keeps is keeps
        assert found.proven
        assert found.kept_from == (0.0 if keeps else pytest.approx(4.2, abs=1.5))
        assert np.isfinite(found.latest)


HIDDEN = sd.Plant([[0.0, 0.0], [0.0, -0.05]], [[1.0, 0.0]], states=["a", "b"], outputs=["y"])
"""A level, and beside it what no sensor shows and what fades slowly."""


def test_no_next_sample_comes_before_the_start(plans):
    plan = plans["oscillator"]
    found = sd.next_sample(plan, now=-9 * plan.schedule.period)
    assert found.latest >= 0 or found.latest == -np.inf
    assert found.best >= 0
    assert found.best == sd.next_sample(plan, now=-1e-3).best


def fading(error):
    goals = {"a": 0.52, "b": 0.5}
    terms = {"y": {"noise_bound": 0.1}}
    return sd.PlanRequirement(goals, period=8.0, grid=1.0, w_bound=[0.1, 0.01], sensors=terms, initial_error=error)


@pytest.fixture(scope="module")
def followed(plans):
    """Plans that begin with an error, by name and error."""
    known = {(name, error): started(plans[name], name, error) for name in PLANTS for error in (None, 50.0)}
    found = sd.plan_samples(HIDDEN, fading([1.0, 50.0]), search_seconds=0.2, **BARE)
    return known | {("fading", "50"): found, ("fading", "5e4"): replace(found, requirement=fading([1.0, 5e4]))}


@pytest.mark.long
@pytest.mark.parametrize("start", [None, 50.0], ids=str)
@pytest.mark.parametrize("periods", [0.0, 1.0, 3.0, 7.0, 20.0])
def test_the_next_sample_promises_nothing_that_the_start_may_still_break(followed, periods, start):
    """Whoever follows the plan for so long, then the advice: no admissible start and motion breaks a tolerance."""
    for (name, error), plan in followed.items():
        if name != "fading" and error != start:
            continue
        span = (looks_back(plan) + 1) * plan.schedule.period / len(plan.schedule)
        now = span + periods * plan.schedule.period
        found = sd.next_sample(plan, now=now)
        if name == "fading":  # what no sample shows is what is left of it at the start
            assert not found.keeps or float(error) * np.exp(-0.05 * now) <= 0.5
            continue
        assert found.keeps, (name, error)
        assert found.proven, (name, error)
        end = found.latest + 2 * plan.schedule.period
        before, after = planned(plan, 0.0, now + 1e-6)[0], planned(plan, found.latest + 1e-6, end)[0]
        alone = sd.guaranteed_accuracy(
            plan.plant,
            sd.Schedule(np.concatenate([before, [found.latest], after])),
            w_bound=plan.requirement.w_bound,
            v_bound=float(plan.problem.v_bound[0]),
            initial_error=error,
            start=0.0,
            end=end,
            of=["a"],
            rtol=0.1,
        )
        assert np.max(alone.profile.lower[0, alone.profile.edges[:-1] >= now - 1e-9]) <= plan.goals[0].tolerance
    assert sd.next_sample(followed["fading", "50"], now=400.0).keeps


def test_dates_begin_with_the_start():
    hours = {"start": "2026-06-01", "zone": "UTC"}
    for error in (None, [0.5, 0.1]):
        wanted = sd.PlanRequirement(
            {"a": 3.0},
            period="1 d",
            grid="2 h",
            w_bound=[0.02, 0.01],
            sensors={"y": {"noise_bound": 0.5}, "z": {"noise_bound": 0.1}},
            calendar=hours,
            initial_error=error,
        )
        found = sd.plan_samples(TANK, wanted, search_seconds=2, **BARE)
        dates = plan_dates(found, 3)
        assert dates.keeps
        assert dates.kept_from == pytest.approx(found.start.from_time)
        assert dates.to_dict()["kept_from"] == dates.kept_from
        assert dates.kept_from == 0 or error is None
        assert "The tolerances are kept from" in dates.explain()


@pytest.mark.parametrize("error", [0.3, [0.1, 0.2], [[2.0, 0.5], [0.5, 1.0]], {"a": 0.3, "b": (-0.1, 0.2)}], ids=str)
def test_a_requirement_file_holds_every_form_of_it(error):
    plant, wanted = asked("oscillator", error)
    again = plan_requirement_from_dict(wanted.to_dict())
    assert again.to_dict() == wanted.to_dict()
    mine, theirs = (sd.planning.problem.pose_plan(plant, each).initial for each in (wanted, again))
    np.testing.assert_array_equal(mine.S, theirs.S)
    np.testing.assert_array_equal(mine.centre, theirs.centre)


def test_what_is_no_bound_is_refused():
    for bad, match in (([0.1], "`initial_error` must be a number, 2 half-widths"), ({"c": 1.0}, "c")):
        with pytest.raises(ArgumentError, match=match):
            sd.plan_samples(*asked("oscillator", bad), **BARE)
    data = asked("oscillator", 0.3)[1].to_dict()
    with pytest.raises(FileFormatError, match="initial_error"):
        plan_requirement_from_dict({**data, "initial_error": "small"})


def test_a_file_that_says_more_of_the_start_is_refused(plans, tmp_path):
    plan = plans["growing"]
    assert plan.start.from_time > 0
    assert "Once the plan is started, the tolerances are kept from" in plan.explain()
    path = plan.save(tmp_path / "plan.json")
    again = sd.read_plan(path)
    assert again.start.to_dict() == plan.start.to_dict()
    assert again.verify()
    for forged in ({"from_time": 0.0}, {"ratio": plan.start.ratio * 0.9}, {"bounded": True}):
        assert not replace(plan, start=replace(plan.start, **forged)).verify()
    never = replace(plan, start=PlanStart(plan.plant.time_unit, np.inf, np.inf, False))
    assert never.start.to_dict()["from_time"] is None
    assert "not proven to keep the tolerances at any time" in never.explain()
    assert sd.read_plan(never.save(tmp_path / "never.json")).start.from_time == np.inf
    assert "followed for ever; its start was not looked at" in replace(plan, start=None).explain()


def worst_by_own_gains(plan, phases):
    """The largest error z at the last of some samples of a filter that is exact at the first, by w that is constant in
    cells."""
    own, plant, n = plan_system(plan), plan.plant, plan.plant.n_states
    g, total, cells = np.eye(n), np.zeros(n), 32
    for at, before in zip(phases[:0:-1], phases[-2::-1], strict=True):
        sample, h = own.samples[at], plan.schedule.gaps[at] / cells
        total += np.abs(gains := sample.K.T @ g).sum(axis=0)
        p = np.linalg.solve((own.D[:, None] * own.L[at]).T, g - sample.H.T @ gains)
        both = expm(
            np.block([[plant.A, plant.G], [np.zeros_like(plant.G.T), np.zeros((plant.n_disturbances,) * 2)]]) * h
        )
        for _ in range(cells):
            total += plan.requirement.w_bound * np.linalg.norm(p.T @ both[:n, n:], axis=1)
            p = both[:n, :n].T @ p
        g = (own.D[:, None] * own.L[before]).T @ p
    return total


@pytest.mark.parametrize("name", few(PLANTS, 0, 2))
def test_no_error_is_larger_than_a_plans_own_gains_leave_of_one(plans, name):
    """Worst by a recursion of its own: no more than is proven of the filter, and in the end about as much.

    Of the level it is more than is proven of the error: that is known better to who counts a sample again.
    """
    own = plan_system(plans[name])
    phases = [k % len(own) for k in range(200)]
    for k in (1, 2, 5, 199):
        worst = worst_by_own_gains(plans[name], phases[: k + 1])
        assert np.all(worst <= own.filter_reach[phases[k]] * (1 + 1e-11))
    assert np.all(worst >= 0.98 * own.filter_reach[phases[-1]])
    assert name != "level" or np.all(worst > 1.005 * own.reach[phases[-1]])
    for size in (1e6, 3.0, 0.1):
        left = left_by_own_gains(own, phases * 5, size * own.reach[0])
        assert np.all(np.diff(left) <= 0)
        assert left[0] >= max(size, 1.0)
        assert 1 <= left[-1] <= 1 + 1e-6


@pytest.mark.parametrize("name", few(PLANTS, 0))
def test_what_is_known_soon_and_long_after_the_start_is_no_less_than_is_attained(plans, name):
    """Within a budget, where the start is forgotten by the plan's own gains, and where it is not yet."""
    plan = replace(plans[name], start=None)
    times, wider = _own_gains_from_start(plan)
    nearly = float(times[np.argmax(wider <= NEARLY)])
    assert settled_from_start(plan, nearly, soon=True) <= NEARLY
    assert settled_from_start(plan, times[0] - plan.schedule.period, soon=True) == np.inf
    for t in (nearly, float(times[-1])):
        now = t + (looks_back(plan) + 2) * plan.schedule.period + plan.problem.step
        found = [sd.next_sample(plan, now=now, budget=b).known["a"] / plan.goals[0].tolerance for b in (1e-9, 1e3)]
        past = _ending(from_start(plan, now), now + plan.problem.step)
        gap = next(_in_gap(plan, past, 0, spans_of(plan, past)[-1], 1.0))
        attained = gap.ratios[np.argmin(np.abs(gap.times - now))]
        assert attained <= min(found) * (1 + 1e-6)
        assert found[1] <= 1.05 * NEARLY * attained
