"""Results that come later in a requirement: its file, its refusals, what a plan and the next sample say of them."""

import json

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.disturbed import without
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.requirement_file import (
    plan_requirement_from_dict,
    read_plan_requirement,
    write_plan_requirement,
)
from sampling_design.planning.sequence import proven_ratio, worst_ratio
from tests.cases import few

WALK = sd.Plant([[0.0]], [[1.0], [1.0]], states=["level"], outputs=["gauge", "lab"])


def wanted(goal=0.6, delay=(0.5, 1.5), **more):
    sensors = {"gauge": {"noise_bound": 0.3, "price": 1.0}, "lab": {"noise_bound": 0.02, "price": 1.0}}
    sensors["lab"]["result_delay"] = delay
    return sd.PlanRequirement(
        {"level": goal}, **{"period": 4.0, "grid": 0.5, "w_bound": 0.1, "sensors": sensors, **more}
    )


def planned(requirement, gauge, lab):
    problem = pose_plan(WALK, requirement)
    chosen = np.zeros_like(problem.allowed)
    chosen[gauge, 0] = chosen[lab, 1] = True
    return proven_plan(problem, chosen, PlanBound((), None, None), "budget")


def test_a_plan_is_as_good_as_what_is_known_at_the_time():
    """For x' = w: the exact result of age 4 + 1.5 - it is the last one until the next is in - says .02 + .55."""
    plan = planned(wanted(), [], [0])
    assert plan.reached[0] == pytest.approx(0.57, rel=2e-3)
    assert planned(wanted(delay=None), [], [0]).reached[0] == pytest.approx(0.42, rel=2e-3)
    both = planned(wanted(), [2], [0])  # the gauge of time 5 is better until the laboratory's result of 4 is in
    assert both.reached[0] == pytest.approx(0.02 + 0.5, rel=2e-3)
    assert plan.verify()


@pytest.mark.parametrize("delay", few([6.0, 30.0], 0))
def test_what_is_out_for_many_periods_is_judged_to_the_end(delay):
    """For x' = w: of the lost result the one before is known for a gap longer, however late both come."""
    plan = planned(wanted(20.0, delay=delay), [], [0, 5])
    for k in range(2):
        lost = without(plan, k, 1)
        assert 20.0 * worst_ratio(plan, lost) == pytest.approx(0.02 + 0.1 * (delay + 4.0), rel=1e-6)
        assert 20.0 * proven_ratio(plan, lost) == pytest.approx(0.02 + 0.1 * (delay + 4.0), rel=2e-3)
    latest = max(t for k in range(60) for t in (4.0 * k, 4.0 * k + 2.5) if t + delay <= 201.0)
    followed = sd.next_sample(plan, now=201.0, prove=False)
    assert followed.known["level"] == pytest.approx(0.02 + 0.1 * (201.0 - latest), rel=1e-6)
    assert len(followed.awaited) == sum(
        4.0 * k + h > 201.0 - delay for k in range(60) for h in (0.0, 2.5) if 4.0 * k + h <= 201.0
    )


def test_the_cheapest_plan_and_its_bound_count_with_the_delay():
    found = sd.plan_samples(
        WALK, wanted(0.46), search_seconds=4.0, certificate=False, robustness=False, from_start=False
    )
    assert found.keeps
    assert found.verify()
    assert found.bound.cost.value == pytest.approx(found.cost)
    at_once = sd.plan_samples(
        WALK, wanted(0.46, None), search_seconds=4.0, certificate=False, robustness=False, from_start=False
    )
    assert at_once.cost == 1.0 < found.cost


def test_a_file_keeps_the_delay(tmp_path):
    for delay in (1.5, "90 min", (0.5, 1.5), ("30 min", "2 h")):
        asked = wanted(delay=delay, time_unit="h")
        again = read_plan_requirement(write_plan_requirement(asked, tmp_path / "wanted.toml"))
        assert again.to_dict() == asked.to_dict()
        assert "results after" in asked.sensors["lab"].explain()
    plan = planned(wanted(), [], [0])
    read = sd.read_plan(plan.save(tmp_path / "plan.json"))
    assert read.verify()
    assert read.reached[0] == plan.reached[0]
    forged = json.loads((tmp_path / "plan.json").read_text())
    forged["requirement"]["sensors"]["lab"]["result_delay"] = 2.5
    (tmp_path / "plan.json").write_text(json.dumps(forged))
    with pytest.raises(FileFormatError, match=r"`reached` is .* where the schedule gives"):
        sd.read_plan(tmp_path / "plan.json")


@pytest.mark.parametrize(
    ("delay", "said"),
    [
        (-1.0, "`sensors.lab.result_delay` must not be negative"),
        ("soon", '`result_delay` must be a time like 0.25 or "15 min"'),
        ((2.0, 1.0), "the least is more"),
        (("2 h", "30 min"), "the least is more"),
        ((1.0, 2.0, 3.0), r"must be a number or a pair \(least, most\)"),
    ],
)
def test_a_delay_that_is_none_is_refused(delay, said):
    with pytest.raises(ArgumentError, match=said.replace("sensors.lab.", "(sensors.lab.)?")):
        wanted(delay=delay)
    tree = wanted().to_dict()
    tree["sensors"]["lab"]["result_delay"] = list(delay) if isinstance(delay, tuple) else delay
    with pytest.raises(FileFormatError, match="result_delay"):
        plan_requirement_from_dict(tree)


def test_what_delays_do_not_fit_is_refused():
    with pytest.raises(ArgumentError, match="must be all times or given ones where results come later"):
        pose_plan(WALK, wanted({"tolerance": 0.6, "at": "after each sample"}))
    goals = {"level": {"tolerance": 0.6, "kind": "standard deviation"}}
    sensors = {"lab": {"noise_deviation": 0.1, "result_delay": 1.0}}
    asked = sd.PlanRequirement(goals, period=4.0, grid=0.5, w_intensity=0.1, sensors=sensors)
    with pytest.raises(ArgumentError, match="`result_delay` is for goals that are guaranteed"):
        pose_plan(WALK, asked)


ROWS = [(4.0 * k, [np.nan, 0.0], None) for k in range(3)]


def test_what_is_awaited_is_said_and_counts_when_it_is_in():
    plan = planned(wanted(0.7), [], [0])
    found = sd.next_sample(plan, ROWS, now=12.5, awaited=[(12.0, "lab")], prove=False)
    assert found.keeps
    assert found.known["level"] == pytest.approx(0.02 + 0.45, rel=1e-2)  # of the sample at 8: that of 12 is out
    assert [tuple(one) for one in found.awaited] == [("lab", 12.0, 12.5, 13.5)]
    assert dict(found._rows())["lab of 12 s"] == "is out, in by 13.5 s"
    assert found.to_dict()["awaited"][0]["latest"]["time"] == 13.5
    at_once = sd.next_sample(plan, [*ROWS, (12.0, [np.nan, 0.0], None)], now=12.5, prove=False)
    assert at_once.known["level"] == pytest.approx(0.02 + 0.05, rel=1e-2)
    without = sd.next_sample(plan, ROWS, now=12.5, prove=False)
    assert without.latest < found.latest
    overdue = sd.next_sample(plan, ROWS, now=13.75, awaited=[(12.0, "lab")], prove=False)
    assert not overdue.awaited
    assert overdue.latest == sd.next_sample(plan, ROWS, now=13.75, prove=False).latest
    followed = sd.next_sample(plan, now=12.25, prove=False)
    assert [one[:2] for one in followed.awaited] == [("lab", 12.0)]
    apart = planned(wanted(0.9, timing_tolerance={"lab": (0.2, 0.4)}), [], [0])
    assert tuple(sd.next_sample(apart, now=12.25, prove=False).awaited[0][1:]) == pytest.approx((12.0, 12.3, 13.9))
    told = sd.next_sample(apart, ROWS, now=12.5, awaited=[(12.0, "lab")], prove=False).awaited  # that time is known
    assert tuple(told[0][1:]) == pytest.approx((12.0, 12.5, 13.5))


@pytest.mark.parametrize(
    ("awaited", "said"),
    [
        ([(12.0, "gauge")], "`awaited` names gauge, which has no `result_delay`"),
        ([(12.0, "labb")], "unknown key 'labb' in `awaited`"),
        ([(14.0, "lab")], "`awaited` must have been taken by now, 12.5"),
        ([(8.0, "lab")], "which is in the record or named twice"),
        ([(12.0, "lab"), (12.0, "lab")], "which is in the record or named twice"),
        ([12.0], r"`awaited` must hold pairs \(t, output\)"),
    ],
)
def test_what_cannot_be_awaited_is_refused(awaited, said):
    with pytest.raises(ArgumentError, match=said):
        sd.next_sample(planned(wanted(0.7), [], [0]), ROWS, now=12.5, awaited=awaited)


def test_without_a_record_nothing_is_awaited_by_name():
    with pytest.raises(ArgumentError, match="`awaited` needs a `record`"):
        sd.next_sample(planned(wanted(0.7), [], [0]), now=12.5, awaited=[(12.0, "lab")])


def test_nothing_that_is_known_well_enough_now_is_said_to_be_exceeded():
    """For x' = w: known to .02 + .1 since the last result that is in, also where that is in at this very moment."""
    plan, rng, both = planned(wanted(0.7), [], [0]), np.random.default_rng(7), set()
    for _ in range(12):
        now = float(rng.choice([16.0, 17.25, 18.0]))
        rows = [
            (t, [np.nan, 0.0], None) for t in (4.0, 8.0, 12.0, 16.0) if t == 4.0 or (t <= now and rng.random() < 0.5)
        ]
        found = sd.next_sample(plan, rows, now=now, prove=False)
        known = 0.02 + 0.1 * (now - rows[-1][0])
        assert found.known["level"] == pytest.approx(known, rel=2e-3)
        assert (found.exceeded is not None) is (known > 0.7)
        both.add((found.exceeded is not None, now - rows[-1][0] < 1.5))
    assert both == {(True, False), (False, True), (False, False)}


def test_however_many_periods_results_are_out_a_choice_is_judged_as_one_worked_out_by_hand():
    """For x' = w, on the grid: of all results that are in before a step the least noise with its age."""
    rng = np.random.default_rng(3)
    for delay in (0.5, 2.0, 4.5, 11.0, 26.5):
        sensors = {
            "gauge": {"noise_bound": 0.3},
            "lab": {"noise_bound": 0.02, "result_delay": delay},
        }
        plan_problem = pose_plan(WALK, wanted(sensors=sensors))
        chosen = np.zeros_like(plan_problem.allowed)
        chosen[rng.choice(8, 2, replace=False), 1] = True
        chosen[rng.choice(8, 1), 0] = True
        known = [
            (0.5 * (k + 8 * period) + after, noise - 0.05 * (k + 8 * period))
            for period in range(-9, 1)
            for j, after, noise in ((0, 0.0, 0.3), (1, delay, 0.02))
            for k in np.flatnonzero(chosen[:, j])
        ]
        worst = max(min(c + 0.1 * t for comes, c in known if comes < t - 1e-9) for t in np.arange(1, 9) * 0.5)
        oracle = AccuracyOracle(plan_problem, discretize(plan_problem))
        assert 0.6 * oracle.judge(chosen)[0] == pytest.approx(worst, rel=1e-5)
