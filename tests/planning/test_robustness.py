"""What a plan bears is proven, stands in its file, and more than that is refused."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.checkers.strict import BadFile
from sampling_design.errors import FileFormatError
from sampling_design.planning import accuracy_oracle as judges
from sampling_design.planning import disturbed, files
from sampling_design.planning.disturbed import plan_robustness, without
from sampling_design.planning.plan import plan_certificate
from sampling_design.planning.sequence import worst_ratio
from tests.oracles import planning as oracle


@pytest.fixture(scope="module")
def whole(week):
    """The week with what it bears."""
    return replace(week, robustness=plan_robustness(week))


@pytest.fixture(scope="module")
def borne():
    """A level read twice in a period: either may be late, and neither lost; nothing proven of it is slow."""
    plant = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"])
    wanted = sd.PlanRequirement({"level": 0.75}, period=8.0, grid=1.0, w_bound=0.1, sensors={"y": {"noise_bound": 0.1}})
    found = sd.plan_samples(plant, wanted, certificate=False, robustness=False, from_start=False)
    return replace(found, robustness=plan_robustness(found))


def worst_level(plan, times, seen):
    """The level's largest hidden motion over all gaps after the first eight samples, by another program."""
    plant, w, v = plan.plant, np.array([0.02, 0.01]), np.array([0.5, 0.1])
    found = 0.0
    for k in range(8, len(times) - 1):
        for end in np.linspace(times[k], times[k + 1], 3):
            program = oracle.hidden(plant.A, plant.C, plant.G, times[: k + 1], seen[: k + 1], [1.0, 0.0], end, w, v)
            found = max(found, program[0])
    return found


def test_so_late_is_kept_and_a_lost_sample_is_told(whole):
    schedule, masks = whole.schedule, whole.chosen[whole.chosen.any(axis=1)]
    periods = 8
    times = (np.arange(periods)[:, None] * schedule.period + schedule.times).ravel()
    seen = np.tile(masks, (periods, 1))
    k = 5 * whole.samples
    late = times.copy()
    late[k] += whole.robustness.late[0]
    assert whole.robustness.late[0] > 0
    assert worst_level(whole, late, seen) <= 3.0
    assert whole.robustness.lost == 0
    lost = worst_level(whole, np.delete(times, k), np.delete(seen, k, axis=0)) / 3.0
    assert lost == pytest.approx(whole.robustness.lost_ratio[0], rel=0.02)
    assert "no sample may be lost" in whole.explain()


@pytest.mark.long
def test_it_is_in_the_file_and_proven_again(whole, tmp_path):
    whole = replace(whole, certificate=plan_certificate(whole))
    path = whole.save(tmp_path / "plan.json")
    back = sd.read_plan(path)
    assert back.robustness.to_dict() == whole.robustness.to_dict()
    assert back.certificate.to_dict() == whole.certificate.to_dict()
    assert back.verify()
    data = json.loads(path.read_text())
    other = sd.certify(sd.Plant([[0.0]], [[1.0]]), sd.PeriodicSchedule([1.0]))
    cases = [
        ({"certificate": 3}, "must be a table of keys and values"),
        ({"certificate": other.to_dict()}, "is of another plant, or of no schedule"),
        ({"robustness": {**data["robustness"], "late": [1.0]}}, "must have 2 entries, one for each sample"),
    ]
    for changed, words in cases:
        path.write_text(json.dumps({**data, **changed}))
        with pytest.raises(FileFormatError, match=words):
            sd.read_plan(path)
    schedule = sd.PeriodicSchedule.from_times([100.0, 132.0], 168.0, [[True, True]] * 2, time_unit="h")
    forged = sd.certify(whole.plant, schedule)
    path.write_text(json.dumps({**data, "certificate": forged.to_dict()}))
    with pytest.raises(FileFormatError, match="is of another schedule"):
        sd.read_plan(path)


def test_more_than_it_bears_does_not_verify(whole):
    robustness = whole.robustness
    for more in (
        replace(robustness, lost=1),
        replace(robustness, late=robustness.late + 60.0),
        replace(robustness, lost_ratio=robustness.lost_ratio * 0.5),
        replace(robustness, late_ratio=robustness.late_ratio * 0.9),
        replace(robustness, late=robustness.late * 0.0, late_ratio=robustness.late_ratio * 0.0),
    ):
        assert not replace(whole, robustness=more).verify()


@pytest.mark.parametrize(
    ("entry", "change"),
    [
        ("lost_ratio", lambda x: 1 + (x - 1) / 2),
        ("lost_ratio", lambda x: 1 + 2 * (x - 1)),
        ("step", lambda x: x / 2),
        ("step", lambda x: 1.5 * x),
        ("late_ratio", lambda x: 1.01 + 0 * x),
        ("late", lambda x: 0.9 * x),
        ("lost", lambda x: 1 - x),
        ("time_unit", lambda x: "d"),
    ],
)
def test_no_entry_of_what_a_plan_bears_says_something_else(entry, change, borne):
    """More or less than is so: what is attained, how finely it was judged, in which unit."""
    found = borne.robustness
    assert disturbed.robustness_holds(borne, found)
    assert found.late.min() > 0
    assert found.lost_ratio.max() > 1
    assert not disturbed.robustness_holds(borne, replace(found, **{entry: change(getattr(found, entry))}))


def test_no_start_says_that_tolerances_are_kept_and_exceeded(borne):
    found = disturbed.plan_start(borne)
    assert disturbed.start_holds(borne, found)
    assert not disturbed.start_holds(borne, replace(found, ratio=1.01))


@pytest.mark.parametrize("late", [240.0, 1e308])
def test_a_sample_is_not_said_to_come_after_the_next_one(late, week, monkeypatch):
    monkeypatch.setattr(disturbed, "proven_ratio", lambda *_: 0.0)
    ones = np.ones(week.samples)
    found = disturbed.PlanRobustness("h", np.array(week.schedule.times), 0 * ones, ones, ones, 1, ones)
    assert disturbed.robustness_holds(week, found)
    assert not disturbed.robustness_holds(week, replace(found, late=late * ones))


def test_a_plan_that_breaks_its_tolerance_bears_nothing(week):
    assert plan_robustness(replace(week, reached=week.reached * 2)) is None


@pytest.mark.parametrize(("broken", "proven"), [(2, 8), (9, 5), (9, 8), (4, 0.5), (0.5, 8), (9, 1), (0, 0)])
def test_the_latest_delay_is_proven_by_halves(broken, proven, week, monkeypatch):
    """Delays in eighths of the room: the first `broken` of them are not, and so many are proven."""
    ends = np.append(week.schedule.times, week.schedule.times[0] + week.schedule.period)
    steps = (round((ends[1] - ends[0]) / week.problem.step) - 1) // 8
    assert steps > 2  # so that less than an eighth can be looked at, too
    unit, asked = steps * week.problem.step, []
    monkeypatch.setattr(disturbed, "delayed", lambda plan, k, late: late)
    monkeypatch.setattr(disturbed, "_broken", lambda plan, late: late > broken * unit)

    def ratio(plan, late):
        asked.append(late)
        return 0.9 if late <= proven * unit else 1.1

    monkeypatch.setattr(disturbed, "proven_ratio", ratio)
    late, stride, reached = disturbed._late(week, 0)
    limit = min(broken, proven, 8)
    if limit >= 1:
        assert (late, stride) == (limit * unit, unit)
    else:
        finest = week.problem.step
        assert (late, stride) == (min(8, np.floor(limit * steps)) * finest, finest)
    assert reached == (0.9 if late else week.ratio)
    assert all(one <= broken * unit for one in asked)  # what a motion breaks is not tried to be proven
    assert len(asked) <= 8  # four at either distance


@pytest.mark.parametrize(("attained", "said"), [(0.9, 1.05), (1.03, 1.03)])
def test_a_loss_that_no_motion_breaks_and_no_proof_keeps_is_told_its_bound(attained, said, week, monkeypatch):
    monkeypatch.setattr(disturbed, "_broken", lambda *_: False)
    monkeypatch.setattr(disturbed, "proven_ratio", lambda plan, sequence, gaps=None: 1.02 if gaps is None else 1.05)
    monkeypatch.setattr(disturbed, "worst_ratio", lambda *_, **__: attained)
    assert disturbed._judged(week, without(week, 0, 1)) == said


def test_what_is_far_below_the_worst_is_not_looked_at_and_changes_nothing(week, monkeypatch):
    for k in range(week.samples):
        lost = without(week, k, 1)
        until = float(lost.times[-1]) - week.schedule.period
        found = worst_ratio(week, lost, np.inf, until)
        with monkeypatch.context() as patch:
            patch.setattr(judges, "FAR", 0.0)
            assert found == worst_ratio(week, lost, np.inf, until)


def test_what_a_plan_file_holds_beside_the_plan_is_of_that_plan():
    plant, own = sd.Plant([[0.0]], [[1.0]]), sd.PeriodicSchedule([1.0])
    made = sd.certify(plant, own).to_dict()
    others = sd.Plant([[1.0]], [[1.0]]), sd.PeriodicSchedule([2.0])
    for value, found, words in (
        (3, SimpleNamespace(), "must be a table of keys and values"),
        (made, SimpleNamespace(plant=others[0], schedule=own), "is of another plant, or of no schedule"),
        (made, SimpleNamespace(plant=plant, schedule=others[1]), "is of another schedule"),
    ):
        with pytest.raises(BadFile, match=words):
            files._certificate(value, found)
    with pytest.raises(BadFile, match="must have 2 entries, one for each sample"):
        files._robustness({"times": [1.0]}, SimpleNamespace(samples=2))
