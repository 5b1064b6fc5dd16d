"""Plans: proven on both sides, admissible, and refused where nothing helps."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.covering import CoveringRows
from sampling_design.planning.evidence import PlanBound, broken_below
from sampling_design.planning.hidden_trajectories import HiddenTrajectories
from sampling_design.planning.plan_record import without_limits
from sampling_design.records.budget import Budget
from sampling_design.records.record import above
from tests.cases import few
from tests.oracles import planning as oracle

BARE = {"certificate": False, "robustness": False, "from_start": False}
OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"], outputs=["y"])
GIVEN = {"period": 6.4, "grid": 0.2, "w_bound": 0.02, "sensors": {"y": {"noise_bound": 0.2}}}


@pytest.fixture(scope="module")
def cheapest():
    return sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": 0.35}, **{**GIVEN, "grid": 0.4}), **BARE)


def test_the_cheapest_plan_keeps_its_tolerance_and_none_is_cheaper(cheapest):
    assert cheapest.status == "complete"
    assert cheapest.keeps
    assert cheapest.samples == cheapest.bound.cost.value == 3
    assert cheapest.reached[0] <= 0.35
    assert cheapest.verify()


@pytest.mark.long
def test_four_looks_at_an_oscillator_reach_what_no_plan_beats():
    found = sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": 1.0}, samples=4, **GIVEN), **BARE)
    assert found.gap <= 0.03
    assert found.bound.ratio.level <= 0.3175 <= found.reached[0] * 1.01  # even spacing, as the oracle has it
    assert found.verify()


def test_a_bound_that_says_more_than_its_attacks_is_refused(cheapest):
    bound = cheapest.bound
    for more in (
        PlanBound(bound.trajectories, replace(bound.ratio, level=bound.ratio.level * 1.01), bound.cost),
        PlanBound(bound.trajectories, bound.ratio, replace(bound.cost, value=bound.cost.value + 1)),
        PlanBound(tuple(replace(a, reach=a.reach * 1.01) for a in bound.trajectories), bound.ratio, bound.cost),
    ):
        assert not replace(cheapest, bound=more).verify()


def test_a_plan_says_what_a_cheaper_one_would_have_to_break(cheapest):
    """Each two samples, by brute force, leave a trajectory that is named hidden: `position` is then too far off."""
    problem, bound = cheapest.problem, cheapest.bound
    named = broken_below(bound, CoveringRows(without_limits(problem), fixed=True))
    assert list(named) == [0]
    count = "one time" if len(named[0]) == 1 else f"one of {len(named[0])} times"
    said = f"At a lower cost, disturbances that no sample shows take position at {count} of the period beyond"
    assert said in cheapest.explain()
    pool = HiddenTrajectories(problem.steps, [problem.ends(0)])
    for trajectory in bound.trajectories:
        pool.add(trajectory)
    keys = [(a, end % problem.steps) for a, end in bound.cost.keys]
    for other in range(problem.steps // 2, problem.steps):  # the larger gap of two samples follows step 0
        at, sensor = np.array([0, other]), np.zeros(2, dtype=int)
        reached = [pool.proven(bound.trajectories[a], at, sensor)[end] for a, end in keys if end in named[0]]
        assert max(reached) > 1
    open_ = replace(cheapest, bound=replace(bound, cost=replace(bound.cost, value=2.0)))
    assert "keeps the tolerances for less than 2. At a lower cost," in open_.explain()
    assert "Whether one for less than 3 does is not decided." in open_.explain()
    assert "At a lower cost" not in replace(cheapest, bound=PlanBound((), None, None)).explain()


def test_a_plan_that_says_more_than_its_proof_is_refused(cheapest):
    assert not replace(cheapest, reached=cheapest.reached * 0.99).verify()


def test_what_nobody_can_keep_is_refused_with_what_can_be_kept():
    given = {**GIVEN, "grid": 0.4}
    with pytest.raises(InfeasibleRequirementError, match="Not even measuring at every allowed time") as refused:
        sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": 0.1}, **given), **BARE)
    nearest = refused.value.nearest["position"]
    assert 0.25 < nearest < 0.26  # a look at every step: noise 0.2 and what w does in between
    both = sd.PlanRequirement({"position": 0.1, "velocity": 0.9}, **given)
    with pytest.raises(InfeasibleRequirementError, match=r"at best position 0.2\d+ instead of 0.1 could be") as refused:
        sd.plan_samples(OSCILLATOR, both, **BARE)
    assert refused.value.nearest == {"position": nearest, "velocity": 0.9}  # what holds already is left as it is


@pytest.mark.parametrize("kind", few(["guaranteed", "standard deviation"], 0))
def test_what_not_even_all_times_keep_is_refused_with_what_spacings_allow(kind):
    terms = {"noise_bound": 0.2, "noise_deviation": 0.2, "longest_use": 4}
    given = {**GIVEN, "w_intensity": 0.01, "grid": 0.4, "spacing": 0.8, "sensors": {"y": terms}}

    def wanted(tolerance):
        return sd.PlanRequirement({"position": {"tolerance": tolerance, "kind": kind}}, **given)

    with pytest.raises(
        InfeasibleRequirementError, match=r"With these spacings, uses and limits position \d.* can be"
    ) as refused:
        sd.plan_samples(OSCILLATOR, wanted(0.01), **BARE)
    assert sd.plan_samples(OSCILLATOR, wanted(refused.value.nearest["position"]), **BARE).keeps


@pytest.mark.parametrize("kind", ["guaranteed", "standard deviation"])
def test_a_poor_sample_that_need_not_be_taken_refuses_no_accuracy_after_samples(kind):
    level = sd.Plant([[0.0]], [[1.0], [1.0]], states=["level"], outputs=["fine", "rough"])
    sizes = {
        key: dict(zip(("noise_bound", "noise_deviation"), (size, size), strict=True))
        for key, size in (("fine", 0.05), ("rough", 0.5))
    }
    sensors = {"fine": {**sizes["fine"], "available": [[0.0, 1.0]]}, "rough": sizes["rough"]}
    wanted = sd.PlanRequirement(
        {"level": {"tolerance": 0.1, "kind": kind, "at": "after each sample"}},
        period=4.0, grid=1.0, w_bound=0.1, w_intensity=0.01, sensors=sensors,
    )  # fmt: skip
    plan = sd.plan_samples(level, wanted, **BARE)
    assert plan.keeps
    assert plan.status == "complete"
    assert plan.schedule.times.tolist() == [0.0]
    worse = wanted.replace(accuracy={"level": {"tolerance": 0.02, "kind": kind, "at": "after each sample"}})
    with pytest.raises(InfeasibleRequirementError, match=r"at best level 0.0[45]\d* instead of 0.02 could be kept"):
        sd.plan_samples(level, worse, **BARE)


@pytest.mark.parametrize("unit", few([1e-11, 1e-5, 1e9], 0))
def test_the_unit_of_prices_changes_no_plan_and_no_bound(unit):
    """Also where a relaxation leaves it open that there is a sample at all, after which something is wanted."""
    A = [[-0.6, 3.0, 0.56], [-4.9, -1.2, -0.58], [1.9, 0.45, -0.46]]
    C = [[0.5, -0.68, -1.07], [-0.037, 0.39, 0.67], [-0.4, -0.41, -0.93]]
    G = [[1.5, 0.39, -0.09], [-0.63, 1.97, -0.17], [0.38, -0.72, 0.92]]
    early = [[0.0, 0.1], [0.5, 1.0]]
    sensors = {
        "y1": {"noise_bound": 0.23, "price": 2.99 * unit, "available": early},
        "y2": {"noise_bound": 0.19, "price": unit, "available": early},
        "y3": {"noise_bound": 0.17, "price": 5.01 * unit, "longest_use": 2, "available": [[0.0, 0.1]]},
    }
    wanted = sd.PlanRequirement(
        {"x3": {"tolerance": 0.37, "at": "after each sample"}}, period=2.4, grid=0.8, aim="most accurate", samples=3,
        w_bound=[0.16, 0.043, 0.12], sensors=sensors,
    )  # fmt: skip
    plan = sd.plan_samples(sd.Plant(A, C, G=G), wanted, **BARE)
    for sensor in sensors.values():
        sensor["price"] /= unit
    same = sd.plan_samples(sd.Plant(A, C, G=G), wanted.replace(sensors=sensors), **BARE)
    assert plan.verify()
    assert np.array_equal(plan.schedule.times, same.schedule.times)
    assert np.array_equal(plan.schedule.outputs, same.schedule.outputs)
    assert plan.cost == pytest.approx(same.cost * unit)
    assert plan.bound.ratio.level == pytest.approx(same.bound.ratio.level, rel=1e-3)


@pytest.mark.parametrize("unit", [1e-9, 1e7])
def test_the_cheapest_plan_is_no_dearer_in_any_unit_of_prices(unit):
    """Of plans of its cost the most accurate one is sought: a limit that a solver's tolerance exceeds is none."""
    level = sd.Plant([[0.0]], [[1.0], [1.0]], states=["level"], outputs=["fine", "rough"])

    def planned(unit):
        sensors = {"fine": {"noise_bound": 0.1, "price": 3 * unit}, "rough": {"noise_bound": 0.2, "price": unit}}
        wanted = sd.PlanRequirement({"level": 0.8}, period=4.0, grid=1.0, w_bound=0.1, sensors=sensors)
        return sd.plan_samples(level, wanted, **BARE)

    plain, other = planned(1.0), planned(unit)
    assert other.cost == pytest.approx(plain.cost * unit)
    assert other.ratio == pytest.approx(plain.ratio)


def test_sensors_that_may_never_be_used_are_refused():
    unused = {"y": {"noise_bound": 0.2, "longest_use": 0}}
    with pytest.raises(InfeasibleRequirementError, match="see `hours`, `available` and `longest_use`"):
        sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": 0.5}, **{**GIVEN, "sensors": unused}))


def test_spacings_that_leave_no_plan_are_refused_with_what_they_allow():
    spaced = sd.PlanRequirement({"position": 0.5}, spacing=2.4, **{**GIVEN, "grid": 0.8})
    with pytest.raises(
        InfeasibleRequirementError, match="No plan with these spacings, uses and limits was found"
    ) as refused:
        sd.plan_samples(OSCILLATOR, spaced, search_seconds=0.4, **BARE)
    near = refused.value.nearest["position"]
    kept = f"position {above(near)} instead of 0.5 can be kept. Ask for that, or for smaller spacings, a larger"
    assert kept in str(refused.value)
    # what it names can be kept; one look, almost once in a swing, only seems to keep it to who looks back a little
    found = sd.plan_samples(OSCILLATOR, spaced.replace(accuracy={"position": near}), **BARE)
    assert found.keeps
    assert found.samples == 2


def test_tolerances_that_only_rounding_separates_from_the_least_are_refused_as_such():
    level = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"])
    given = {"period": 1.0, "grid": 0.1, "w_bound": 0.1, "sensors": {"y": {"noise_bound": 0.1}}}
    with pytest.raises(
        InfeasibleRequirementError,
        match=r"close to the least .* for a proof: level 0\.111\d+ instead of 0\.11 can be kept\.$",
    ) as refused:
        sd.plan_samples(level, sd.PlanRequirement({"level": 0.1 + 0.01}, **given), search_seconds=1, **BARE)
    assert 0.11 < refused.value.nearest["level"] < 0.112


@pytest.mark.parametrize("sensor", few([False, True], 0))
def test_a_spacing_beyond_the_period_is_refused(sensor):
    level = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"])

    def wanted(spacing):
        terms = {"noise_bound": 0.1, **({"spacing": spacing} if sensor else {})}
        own = {} if sensor else {"spacing": spacing}
        return sd.PlanRequirement({"level": 5.0}, period=10.0, grid=1.0, w_bound=0.1, sensors={"y": terms}, **own)

    match = r"spacing` must be at most the period, 10 s, since the plan repeats after it: got 20 s"
    with pytest.raises(ArgumentError, match=match):
        sd.plan_samples(level, wanted(20.0), **BARE)
    for spacing in (5.0, 7.5, 10.0):
        found = sd.plan_samples(level, wanted(spacing), search_seconds=1, **BARE)
        assert np.min(found.schedule.gaps) >= spacing - 1e-9


@pytest.mark.parametrize("A", few([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0], [-1.0, 0.0]], [[-0.1, 0.0], [0.0, -0.2]],
                                   [[0.1, 0.0], [1.0, -0.2]]], 2))  # fmt: skip
def test_a_motion_that_nothing_drives_is_planned_and_proven(A):
    plant = sd.Plant(A, [[1.0, 0.0]], states=["first", "second"], outputs=["y"])
    given = {**GIVEN, "grid": 0.8, "w_bound": 0.0, "sensors": {"y": {"noise_bound": 0.1}}}
    found = sd.plan_samples(plant, sd.PlanRequirement({"first": 0.5}, **given), search_seconds=1, **BARE)
    assert found.keeps
    assert found.samples == found.bound.cost.value == 1
    best = sd.plan_samples(plant, sd.PlanRequirement({"first": 0.5}, samples=2, **given), search_seconds=1, **BARE)
    assert best.samples == 2
    assert best.status == "budget"  # motions that w drives are what the search goes by, and here there are none
    assert best.bound.ratio is None or best.bound.ratio.level <= best.ratio


CHEAPEST = re.compile(r"cost (\S+), (\d+) samples, (\S+) % of the tolerance(?:, none below (\S+), gap (\S+) %)?, .+")


@pytest.mark.long
def test_progress_tells_the_cheapest_plan_so_far_and_its_bound_early_and_ever_better():
    """Work is counted, not timed: in the first tenth a plan that keeps the tolerances is told, and at last the plan.

    Before that, and before any work, what is being done.
    """
    told, works, of = [], [], Budget.spend
    wanted = sd.PlanRequirement({"position": 0.35}, **{**GIVEN, "grid": 0.4})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Budget, "spend", lambda work, seconds: (works.append(seconds), of(work, seconds))[1])
        found = sd.plan_samples(OSCILLATOR, wanted, progress=lambda *said: told.append((sum(works), *said)))
    first = next(k for k, (*_, message) in enumerate(told) if message.startswith("cost"))
    assert told[0] == (0, 0.0, "looking at all that may be measured")
    figures = [CHEAPEST.fullmatch(message).groups() for *_, message in told[first:]]
    assert told[first][0] <= sum(works) / 10
    costs, least = [float(each[0]) for each in figures], [float(each[3] or 0) for each in figures]
    assert costs == sorted(costs, reverse=True)
    assert least == sorted(least)
    assert [each for _, each, _ in told] == sorted(each for _, each, _ in told)
    assert (costs[-1], float(figures[-1][2])) == (found.cost, pytest.approx(100 * found.ratio, abs=0.06))
    assert least[-1] == found.bound.cost.value
    assert float(figures[-1][4]) == pytest.approx(100 * (1 - least[-1] / costs[-1]), abs=0.06)
    assert {"certificate", "robustness", "start"} <= {message.rsplit(", ", 1)[-1] for _, _, message in told}


@pytest.mark.parametrize(
    ("limit", "words"), few(product([{}, {"samples": 4}], ["samples", "bounding", "certificate"]), 4)
)
def test_an_interrupt_leaves_what_the_search_holds_and_what_is_proven(words, limit, tmp_path):
    def interrupt(_, message):
        if words in message:
            raise KeyboardInterrupt

    wanted = sd.PlanRequirement({"position": 0.5}, **{**GIVEN, "grid": 0.4}, **limit)
    found = sd.plan_samples(OSCILLATOR, wanted, search_seconds=2, progress=interrupt)
    assert found.status == "interrupted"
    assert found.keeps
    assert found.left_out == (("bound",) if found.bound.ratio is None else ()) + ("certificate", "robustness", "start")
    assert (found.bound.ratio is None) == (words != "certificate")
    if not limit:  # the first that was told, the densest, or what was found, with its bound
        assert (found.bound.cost is None) == (words == "samples")
    assert found.explain().endswith("after the start: interrupted.")
    back = sd.read_plan(found.save(tmp_path / "plan.json"))
    assert back.verify()
    assert back.status == "interrupted"


def test_an_interrupt_before_anything_is_held_is_one(monkeypatch):
    def rung(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(AccuracyOracle, "judge", rung)
    with pytest.raises(KeyboardInterrupt):
        sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": 0.5}, **GIVEN), **BARE)


def test_what_nobody_can_afford_is_refused():
    dear = {**GIVEN, "sensors": {"y": {"noise_bound": 0.2, "price": 5.0}}}
    with pytest.raises(InfeasibleRequirementError, match="No measurement is admissible within"):
        sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": 1.0}, cost_limit=3.0, **dear), **BARE)


def test_spacing_and_limits_are_kept():
    wanted = sd.PlanRequirement({"velocity": 1.0}, samples=3, spacing=1.5, **{**GIVEN, "grid": 0.4})
    found = sd.plan_samples(OSCILLATOR, wanted, **BARE)
    assert len(found.schedule) <= 3
    assert np.min(found.schedule.gaps) >= 1.5 - 1e-9


@pytest.mark.parametrize(
    ("tolerance", "limits"),  # which all times do not keep, and which they do
    few(
        product(
            [0.15, 0.25], [{"spacing": 8.0}, {"samples": 1}, {"cost_limit": 3.0}, {"samples": 1, "visit_price": 5.0}]
        ),
        *(0, 5, 6),
    ),
)
def test_what_limits_leave_no_plan_for_is_refused_with_what_they_allow(tolerance, limits):
    plant, sensors = sd.Plant([[0.0]], [[1.0]], states=["level"]), {"y1": {"noise_bound": 0.1, "price": 3.0}}
    given = {"period": 8.0, "grid": 1.0, "w_bound": 0.1, "sensors": sensors, "aim": "cheapest", **limits}
    with pytest.raises(InfeasibleRequirementError, match="these spacings, uses and limits") as refused:
        sd.plan_samples(plant, sd.PlanRequirement({"level": tolerance}, **given), **BARE)
    assert refused.value.nearest["level"] == pytest.approx(0.9, rel=0.02)  # noise, and what w does in a period
    found = sd.plan_samples(plant, sd.PlanRequirement(refused.value.nearest, **given), **BARE)
    assert found.keeps
    assert found.samples == 1
    assert found.verify()


def test_no_time_to_look_for_a_plan_within_limits_is_no_proof_that_there_is_none():
    spaced = sd.PlanRequirement({"position": 0.5}, spacing=2.4, **{**GIVEN, "grid": 0.8})
    found = sd.plan_samples(OSCILLATOR, spaced, search_seconds=0.01, **BARE)
    assert not found.keeps
    assert found.status == "budget"


def test_prices_of_what_is_never_read_decide_nothing():
    plant = sd.Plant([[0.0]], [[1.0], [1.0]], states=["level"])
    sensors = {"y1": {"noise_bound": 0.1}, "y2": {"noise_bound": 0.1, "price": 2.0, "longest_use": 0}}
    wanted = sd.PlanRequirement({"level": 0.52}, period=8.0, grid=1.0, w_bound=0.1, sensors=sensors)
    found = sd.plan_samples(plant, wanted, **BARE)
    assert found.samples == found.cost == found.bound.cost.value == 2
    assert found.verify()


@pytest.mark.parametrize(("hours", "delay", "age"), [([4.0, 5.0], None, 8.0), ([2.0, 3.0], 2.0, 10.0)])
def test_a_sample_or_a_result_at_a_given_time_does_not_count_there_yet(hours, delay, age):
    plant, goal = sd.Plant([[0.0]], [[1.0]], states=["level"]), {"tolerance": 2.0, "at": [4.0]}
    terms = {"y1": {"noise_bound": 0.1, "available": [hours], "result_delay": delay}}
    wanted = sd.PlanRequirement({"level": goal}, period=8.0, grid=1.0, w_bound=[0.1], sensors=terms)
    assert sd.plan_samples(plant, wanted, **BARE).reached == pytest.approx([0.1 + age * 0.1], rel=1e-3)


@pytest.mark.parametrize("limits", [{"samples": 3}, {"cost_limit": 13.0}])
def test_a_limit_beside_the_least_cost_changes_no_bound(limits):
    plant = sd.Plant([[0.0]], [[1.0]], states=["level"])
    terms = {"y1": {"noise_bound": 0.2, "price": 3.0}}
    given = {"period": 4.0, "grid": 1.0, "w_bound": [0.1], "sensors": terms, "visit_price": 1.0}
    wanted = sd.PlanRequirement({"level": 0.45}, **given)
    plain, limited = (sd.plan_samples(plant, own, **BARE) for own in (wanted, wanted.replace(aim="cheapest", **limits)))
    assert limited.verify()
    assert limited.cost == plain.cost == limited.bound.cost.value == 8.0
    assert limited.bound.ratio.level == plain.bound.ratio.level


def test_a_plant_that_comes_to_rest_by_itself_has_one_sample_at_least():
    plant = sd.Plant([[-1.0]], [[1.0]], time_unit="h", outputs=["y"], states=["level"])
    hours = {"start": "2026-03-02", "zone": "UTC", "hours": {"Mon-Sun": [["08:00", "10:00"]]}}
    wanted = sd.PlanRequirement(
        {"level": 0.2}, period="1 d", grid="1 h", w_bound=0.1, sensors={"y": {"noise_bound": 0.5}}, calendar=hours
    )
    found = sd.plan_samples(plant, wanted, **BARE)  # 0.1 is kept whatever is measured
    assert found.keeps
    assert found.samples == found.bound.cost.value == 1
    assert found.verify()


def test_another_program_measures_the_same(week):
    ((name, reached, below, above),) = oracle.remeasured(week.to_dict(), samples=12, looks=3)
    assert name == "level"
    assert below <= reached <= 1.01 * below
    assert above <= reached
