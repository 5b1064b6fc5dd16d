"""What a record says, what proves it and what both are about belong together: whoever edits one of them is refused."""

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from sampling_design import (
    PeriodicSchedule,
    PlanRequirement,
    Plant,
    Requirement,
    Schedule,
    design_schedule,
    guaranteed_accuracy,
    plan_samples,
    read_plan,
    state_interval,
)
from sampling_design.accuracy import accuracy_by_count, accuracy_limit
from sampling_design.errors import FileFormatError

PLANT = Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0], [0.0, 1.0]], time_unit="h")
READ = [[True, False], [True, True], [True, False]]
BOUNDS = {"w_bound": 0.02, "v_bound": 0.1}


@cache
def endless():
    return guaranteed_accuracy(PLANT, PeriodicSchedule([1.0, 0.6, 1.4], outputs=READ), rtol=0.1, **BOUNDS)


@cache
def finite():
    return guaranteed_accuracy(PLANT, Schedule([0.5, 1.0, 2.5], outputs=READ), end=3.0, rtol=0.1, **BOUNDS)


@cache
def repeated():
    schedule = PeriodicSchedule([1.0, 0.6, 1.0, 0.6])
    return guaranteed_accuracy(PLANT, schedule, rtol=0.1, **BOUNDS)


def later(upper):
    first, second = np.split(upper, 2, axis=1)
    return np.hstack([first, second * 0.99])


@cache
def late():
    schedule = PeriodicSchedule([1.0, 0.6, 1.4], outputs=READ)
    return guaranteed_accuracy(PLANT, schedule, timing_tolerance=0.05, budget=1e-6, **BOUNDS)


@cache
def started():
    return guaranteed_accuracy(PLANT, Schedule([0.5, 1.5, 2.5]), start=0.0, end=3.0, rtol=0.1, **BOUNDS)


@cache
def by_count():
    return accuracy_by_count(Plant([[-0.1]], [[1.0]]), (0, 1, 4), period=8.0, **BOUNDS)


@cache
def limit():
    return accuracy_limit(PLANT, **BOUNDS)


def record(y):
    return [(0.0, [1.0, 0.0], None), (0.7, [y, -0.6], None)]


@cache
def disproven():
    return state_interval(PLANT, record(5.0), **BOUNDS)


@cache
def design_of(gain, of=None):
    wanted = Requirement(window=6.0, period=6.0, spacing=0.3, samples={"exactly": 3}, forbidden=[[0.0, 1.0]])
    plant = Plant([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -0.5]], [[gain, 0.0, 0.0]])
    return design_schedule(plant, wanted, of=of, starts=1, branches=0)


def split_of_another(found, *of):
    """What makes a design of a plant that is seen half as well say what a better one has."""
    other = design_of(2.0, *of)
    return {what: getattr(other, what) for what in ("split", "sigma", "sigma_attained", "upper_bound", "bound")}


design = partial(design_of, 1.0)
of_rows = partial(design_of, 1.0, ("x1",))


def plan_for(noise):
    sensor = {"noise_bound": noise, "noise_deviation": noise / 2}
    goals = {"a": 0.6, "b": {"tolerance": 0.5, "kind": "standard deviation"}}
    wanted = PlanRequirement(
        goals, period=6.0, grid=1.0, w_bound=0.02, w_intensity=0.02, sensors={"y1": sensor}, samples=3
    )
    plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["a", "b"])
    return plan_samples(plant, wanted, certificate=False, robustness=False, from_start=False)


plan_of = cache(plan_for)


def witness(found, **changes):
    first, *rest = found.witnesses
    return {"witnesses": (replace(first, **changes), *rest)}


def over_time(found, **changes):
    return {"profile": replace(found.profile, **changes)}


def question(found, **changes):
    return {"question": replace(found.question, **changes)}


def plan_proof():
    better = plan_of(0.05)
    return {"accuracy": better.accuracy, "reached": [better.reached[0], plan_of(0.1).reached[1]]}


EDITS = {
    "a row that is larger": (endless, lambda a: witness(a, row=a.witnesses[0].row * 1.1) | {"lower": a.lower * 1.05}),
    "outputs that show less": (endless, lambda a: witness(a, plant=replace(PLANT, C=PLANT.C / 2))),
    "a value that is not attained": (endless, lambda a: witness(a, value=a.witnesses[0].value * 1.01)),
    "less at the samples": (endless, lambda a: {"at_samples": a.at_samples * 0.99}),
    "less at one sample": (finite, lambda a: {"at_samples": a.at_samples * [1.0, 1.0, 0.99]}),
    "fewer samples": (endless, lambda a: {"at_samples": a.at_samples[:, 1:]}),
    "less over time": (endless, lambda a: over_time(a, upper=a.profile.upper * 0.99)),
    "less in a later period": (repeated, lambda a: over_time(a, upper=later(a.profile.upper))),
    "less while samples may be late": (late, lambda a: over_time(a, upper=a.profile.upper * 0.99)),
    "known before it is": (started, lambda a: over_time(a, upper=np.minimum(a.profile.upper, a.upper[:, None]))),
    "more attained over time than proven": (endless, lambda a: over_time(a, lower=a.profile.upper * 1.01)),
    "at other times": (endless, lambda a: over_time(a, edges=a.profile.edges + 0.1)),
    "about other samples": (endless, lambda a: over_time(a, samples=a.profile.samples + 0.1)),
    "worst at another time": (endless, lambda a: {"worst": a.worst + 0.1}),
    "worst while samples may be late": (late, lambda a: {"worst": a.worst + 0.3}),
    "another schedule": (endless, lambda a: question(a, schedule=PeriodicSchedule([1.0, 0.5, 1.5], outputs=READ))),
    "another reading": (endless, lambda a: question(a, schedule=replace(a.schedule, outputs=np.roll(READ, 1, axis=0)))),
    "no witness": (finite, lambda a: {"witnesses": (None, None), "lower": a.upper * 2}),
    "known earlier": (finite, lambda a: {"known_from": a.known_from - 0.1}),
    "another period": (by_count, lambda a: {"period": 16.0}),
    "other counts": (by_count, lambda a: {"counts": (0, 2, 4)}),
    "other rows": (by_count, lambda a: {"rows": replace(a.rows, matrix=a.rows.matrix / 2)}),
    "of another plant": (limit, lambda a: {"plant": replace(PLANT, C=PLANT.C * 2)}),
    "of weaker disturbances": (limit, lambda a: {"plant": replace(PLANT, G=PLANT.G / 2)}),
    "data that contradict nothing": (
        disproven,
        lambda a: {"readings": state_interval(PLANT, record(0.7), **BOUNDS).readings},
    ),
    "one end": (disproven, lambda a: {"lower": np.zeros(2)}),
    "of a shorter period": (design, lambda a: {"schedule": PeriodicSchedule.from_times(a.schedule.times, 5.9)}),
    "of a plant seen better": (design, lambda a: {"plant": replace(a.plant, C=a.plant.C * 2)}),
    "of a plant that shows nothing": (design, lambda a: {"plant": replace(a.plant, C=a.plant.C * 0)}),
    "with the split of another plant": (design, lambda a: split_of_another(a)),
    "of rows, with that split": (of_rows, lambda a: split_of_another(a, ("x1",))),
    "of more samples": (design, lambda a: {"requirement": replace(a.requirement, samples={"exactly": 2})}),
    "of better sensors": (lambda: plan_of(0.1), lambda a: plan_proof()),
    "no accuracy": (lambda: plan_of(0.1), lambda a: {"accuracy": None, "reached": a.reached * [0.0, 1.0]}),
    "no deviation": (lambda: plan_of(0.1), lambda a: {"deviation": None, "reached": a.reached * [1.0, 0.0]}),
}


@pytest.mark.parametrize("what", EDITS)
def test_an_edit_is_refused(what):
    made, edit = EDITS[what]
    found = made()
    assert found.verify()
    assert not replace(found, **edit(found)).verify()


def test_what_says_less_is_still_true():
    found = endless()
    weaker = replace(found, lower=found.lower / 2, upper=found.upper * 2, at_samples=found.at_samples * 1.1)
    assert weaker.verify()


@cache
def dated_plan():
    sensors = {"gauge": {"noise_bound": 0.5, "price": 1.0}, "meter": {"noise_bound": 0.1, "price": 1.5}}
    plant = Plant([[0.0, 0.1], [0.0, -0.3]], np.eye(2), time_unit="h", states=("a", "b"), outputs=("gauge", "meter"))
    wanted = PlanRequirement(
        {"a": 3.0}, period="1 d", grid="6 h", w_bound=[0.02, 0.01], sensors=sensors, initial_error=1.0,
        calendar={"start": "2026-03-23", "zone": "Europe/Berlin"},
    )  # fmt: skip
    return plan_samples(plant, wanted)


FILE_EDITS = {
    "reached": lambda f: f.update(reached=[f["reached"][0] * 0.99]),
    "ratio": lambda f: f.update(ratio=f["ratio"] * 0.99),
    "cost": lambda f: f.update(cost=f["cost"] * 0.9999),
    "bound of the cost": lambda f: f["no_cheaper_than"].update(value=f["cost"] * 1.01),
    "level of the cost's bound": lambda f: f["no_cheaper_than"].update(level=0.99),
    "bound of the accuracy": lambda f: f["no_better_than"].update(level=f["ratio"]),
    "what it costs": lambda f: f["no_better_than"].update(value=f["no_better_than"]["value"] * 2),
    "reach": lambda f: f["trajectories"][0].update(reach=f["trajectories"][0]["reach"] * 1.01),
    "of which sensors": lambda f: f["schedule"].update(output_names=["meter", "gauge"]),
    "of no sensors": lambda f: f["schedule"].update(output_names=["gauge", "other"]),
    "in days": lambda f: f["schedule"].update(time_unit="d"),
    "on another date": lambda f: f["schedule"].update(origin="2026-03-24T00:00:00+01:00[Europe/Berlin]"),
    "in another zone": lambda f: f["requirement"]["calendar"].update(zone="UTC"),
    "from another date": lambda f: f["requirement"]["calendar"].update(start="2026-03-24"),
    "while it is closed": lambda f: f["requirement"]["calendar"].update(hours={"Sat": [["00:00", "24:00"]]}),
    "tolerance": lambda f: f["requirement"]["accuracy"]["a"].update(tolerance=f["reached"][0] * 0.99),
    "price": lambda f: f["requirement"]["sensors"]["gauge"].update(price=0.9),
    "noise": lambda f: f["requirement"]["sensors"]["gauge"].update(noise_bound=0.6),
    "disturbance": lambda f: f["requirement"].update(w_bound=[0.03, 0.01]),
    "initial error": lambda f: f["requirement"].update(initial_error=10.0),
    "plant": lambda f: f["plant"]["matrices"].update(A=[[0.0, 0.11], [0.0, -0.3]]),
    "left out, and there": lambda f: f.update(left_out=["robustness"]),
    "rate": lambda f: f["certificate"].update(eta=f["certificate"]["eta"] * 1.01),
    "later": lambda f: f["robustness"].update(late=[t + f["robustness"]["step"][0] for t in f["robustness"]["late"]]),
    "late for less": lambda f: f["robustness"].update(late_ratio=[r * 0.99 for r in f["robustness"]["late_ratio"]]),
    "more lost": lambda f: f["robustness"].update(lost=f["robustness"]["lost"] + 1),
    "lost for less": lambda f: f["robustness"].update(lost_ratio=[r * 0.99 for r in f["robustness"]["lost_ratio"]]),
    "in minutes": lambda f: f["robustness"].update(time_unit="min"),
    "kept earlier": lambda f: f["start"].update(from_time=f["start"]["from_time"] - 0.1),
    "kept closer": lambda f: f["start"].update(ratio=f["start"]["ratio"] * 0.99),
    "of any error": lambda f: f["start"].update(bounded=False),
}


@pytest.mark.parametrize("what", FILE_EDITS)
def test_an_edited_file_of_a_plan_is_refused_or_not_verified(what, tmp_path):
    data = json.loads(dated_plan().save(tmp_path / "plan.json").read_text())
    FILE_EDITS[what](data)
    (tmp_path / "plan.json").write_text(json.dumps(data))
    try:
        found = read_plan(tmp_path / "plan.json")
    except FileFormatError:
        return
    assert not found.verify()


def test_contradictions_within_a_file_of_a_plan_are_named(tmp_path):
    for what, words in (
        ("on another date", "`schedule.origin` is .* where the calendar begins at another time"),
        ("left out, and there", '`left_out` names "robustness", which the file holds'),
        ("more lost", "`robustness.lost` must be 0 to 2"),
        ("in days", "`schedule` is in d and the plant in h"),
    ):
        data = json.loads(dated_plan().save(tmp_path / "plan.json").read_text())
        FILE_EDITS[what](data)
        (tmp_path / "plan.json").write_text(json.dumps(data))
        with pytest.raises(FileFormatError, match=words):
            read_plan(tmp_path / "plan.json")
