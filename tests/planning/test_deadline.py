"""The deadline of a goal: against levels that drift by themselves, whose accuracy is a line in time."""

import json

import numpy as np
import pytest

import sampling_design as sd

BARE = {"certificate": False, "robustness": False, "from_start": False}
STEP, TOLERANCE, DRIFT, NOISE = 1.0, {"tank": 0.72, "well": 0.43}, {"tank": 0.1, "well": 0.05}, 0.1
LEVELS = sd.Plant(np.zeros((2, 2)), np.eye(2), time_unit="h", states=list(TOLERANCE), outputs=["float", "rule"])
SENSOR = {"tank": "float", "well": "rule"}


def wanted(**more):
    kept = {
        "period": "12 h",
        "grid": "1 h",
        "w_bound": list(DRIFT.values()),
        "sensors": {name: {"noise_bound": NOISE, "price": 1.0} for name in SENSOR.values()},
    }
    return sd.PlanRequirement(TOLERANCE, **{**kept, **more})


@pytest.fixture(scope="module")
def plan():
    return sd.plan_samples(LEVELS, wanted(), search_seconds=0.5, **BARE)


@pytest.fixture(scope="module")
def answers(plan):
    """What is said at two times of one plan."""
    return {now: sd.next_sample(plan, now=now) for now in (2.6, 5.2)}


def lines(plan, taken, until):
    """By hand: a level is known as well as at its last reading, and DRIFT more for every hour since."""
    reached = {}
    for state, sensor in SENSOR.items():
        column = plan.plant.outputs.names.index(sensor)
        times = np.array([t for t, seen in taken if seen[column]])
        for t in np.arange(1, round(until / STEP)) * STEP:
            since = t - times[times < t].max()  # at a reading's own time, the moment before it
            if NOISE + DRIFT[state] * since >= TOLERANCE[state] * (1 - 1e-9) and state not in reached:
                reached[state] = t
    return reached


def samples(plan, start, stop):
    """The plan's samples in [start, stop)."""
    found = [
        (float(t) + 12.0 * period, mask)
        for period in range(-2, 6)
        for t, mask in zip(plan.schedule.times, plan.chosen[plan.chosen.any(axis=1)], strict=True)
    ]
    return [(t, mask) for t, mask in found if start <= t < stop]


@pytest.mark.parametrize("now", [2.6, 5.2])
def test_the_goal_that_is_due_and_its_time_are_those_of_the_lines(plan, answers, now):
    found = answers[now]
    assert set(found.alone) == set(SENSOR.values())
    before = samples(plan, -24.0, now + 1e-9)
    for name, deadline in {None: found.deadline, **found.alone_deadlines}.items():
        last = found.latest if name is None else found.alone[name]
        names = found.outputs if name is None else (name,)
        t = (round(last / STEP) + 1) * STEP if np.isfinite(last) else (np.floor(now / STEP) + 1) * STEP
        seen = np.array([each in names for each in plan.plant.outputs.names])
        if name is None:  # what the plan reads at its own next sample then
            seen = min(samples(plan, t - 1e-9, t + 12.0), key=lambda pair: pair[0])[1]
        reached = lines(plan, [*before, (t, seen), *samples(plan, t + 1e-9, t + 40.0)], t + 18.0)
        first = min(reached.values())
        assert deadline.breaks
        assert deadline.time == pytest.approx(first, abs=1e-9)
        assert reached[deadline.goal] == pytest.approx(first, abs=1e-9)


def test_it_is_said_in_words_in_the_table_and_in_json(answers):
    found = answers[5.2]
    text = f"{found.deadline.goal} reaches its tolerance by {found.deadline.time:g} h"
    assert found.explain().endswith(f"If taken at the next allowed time after that, {text}.")
    assert dict(found._rows())["later"] == text
    plain = json.loads(json.dumps(found.to_dict()))
    assert plain["deadline"]["goal"] == found.deadline.goal
    assert plain["deadline"]["when"] == {"time": found.deadline.time, "date": None}
    assert set(plain["alone_deadlines"]) == set(plain["alone"])


def test_a_sample_that_may_come_at_any_time_has_nothing_due():
    still = sd.Plant([[-1.0]], [[1.0]], states=["x"], outputs=["y"])
    sensors = {"y": {"noise_bound": 0.1}}
    asked = sd.PlanRequirement({"x": 1.0}, period=4.0, grid=1.0, w_bound=0.1, sensors=sensors)
    found = sd.next_sample(sd.plan_samples(still, asked, search_seconds=1, **BARE))
    assert found.deadline is None
    assert found.alone_deadlines == {}
    assert found.to_dict()["deadline"] is None
    assert found.explain().endswith("(y).")
