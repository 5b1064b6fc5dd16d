"""What the explorer answers is what the verbs say, and what is no question changes nothing."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, MissingExtraError
from sampling_design.explorer import SCENES, ScheduleExplorer, explore, scene, schedule_explorer

TURN = 2 * np.pi


@pytest.fixture(autouse=True)
def unhurried(monkeypatch):
    """What half a second leaves undone depends on the machine's load: nothing here is about that."""
    monkeypatch.setattr(schedule_explorer, "LIVE_BUDGET", None)


PLANT = sd.named_plant("oscillator")


def marks(*times, sensors=1):
    return [{"t": float(t), "on": [True] * sensors} for t in times]


def test_the_curve_is_the_proven_one():
    bench = ScheduleExplorer(PLANT, sd.Requirement(window=5.0, period=TURN))
    found = bench.answer({"ask": "sigma", "marks": marks(0.5, 2.0, 4.0)})
    schedule = sd.PeriodicSchedule.from_times([0.5, 2.0, 4.0], TURN, time_unit="s")
    assert found["lower"] == sd.window_sigma(PLANT, schedule, 5.0).lower
    assert found["messages"] == []
    assert bench.schedule.times == pytest.approx(schedule.times)


def test_what_broke_is_said_with_its_repair():
    bench = scene("pathological")
    found = bench.answer({"ask": "sigma"})
    (told,) = found["messages"]
    assert told.startswith("The samples at 1 s and 4.142 s alias the modes")
    assert "±1i" in told
    assert found["broken"]
    repair = bench.answer({"ask": "repair"})
    assert "Move the sample at 1 s by" in repair["said"]
    moved = bench.answer({"ask": "sigma", "marks": marks(repair["to"], 1.0 + np.pi)})
    assert moved["messages"] == []
    assert not moved["broken"]
    assert f"at least {moved['lower']:.3g}" in repair["said"]
    best = max(bench.answer({"ask": "sigma", "marks": marks(1.0 + d, 1.0 + np.pi)})["lower"] for d in (-0.8, 0.8))
    assert moved["lower"] > 0.35 * best
    assert bench.answer({"ask": "sigma", "marks": marks(1.0, 2.5)})["messages"] == []
    (told,) = bench.answer({"ask": "sigma", "marks": marks(1.0)})["messages"]
    assert told.startswith("The sample at 1 s of every period aliases the modes")
    assert "add one" in bench.answer({"ask": "repair"})["said"]


def test_while_a_mark_moves_the_same_is_said_as_where_it_rests():
    """A drag leaves out what cannot matter: where every window is proven to see all, no period misses a mode."""
    rng = np.random.default_rng(7)
    for name, count in (("pathological", 2), ("even", 6), ("laboratory", 3), ("plan", 3)):
        bench = scene(name)
        sensors = bench.plant.n_outputs
        drawn = [np.sort(rng.uniform(0, bench.period, count)) for _ in range(2)]
        for times in [*drawn, (np.arange(count) + 0.5) * bench.period / count, np.array([1.0, 1.0 + np.pi])]:
            laid = marks(*times, sensors=sensors)
            moving, rests = (bench.answer({"ask": ask, "marks": laid}) for ask in ("moving", "sigma"))
            assert {**moving, "ask": "sigma", "left": rests["left"]} == rests
            sigma = sd.window_sigma(bench.plant.scaled(), bench.schedule, bench.window)
            assert rests["messages"] == [*bench._rules(), *bench._broken(sigma, moving=False)]


def test_a_sigma_that_is_barely_proven_is_still_asked_about():
    bench = scene("pathological")
    for off in (1e-3, 1e-7, 1e-11):
        found = bench.answer({"ask": "moving", "marks": marks(1.0, 1.0 + np.pi + off)})
        assert bool(found["messages"]) == (off < 1e-9)
        assert (found["lower"] > bench.clear) == (off > 1e-5)


def test_what_is_not_known_is_not_called_zero():
    """Two samples half a turn apart are as good as one, though there are as many as states."""
    bench = ScheduleExplorer(PLANT, sd.Requirement(window=4.0, period=10.0))
    (told,) = bench.answer({"ask": "sigma", "marks": marks(0.5, 0.5 + np.pi, 4.0, 6.5, 8.0, 9.9)})["messages"]
    assert re.fullmatch(
        r"Of the window that ends .* nothing is proven: it misses a state, or rounding hides it\.", told
    )
    turning = ScheduleExplorer(PLANT, sd.Requirement(window=2.0, period=TURN))
    (told,) = turning.answer({"ask": "sigma", "marks": marks(0.2, 1.2)})["messages"]
    assert told == "Some window holds too few samples: sigma is zero there."


def test_modes_that_look_alike_are_named_in_pairs():
    daily = sd.PeriodicSchedule(np.full(30, 24.0), time_unit="h")
    bench = ScheduleExplorer(sd.named_plant("tidal_gauge"), sd.Requirement(window=720.0, period=720.0), daily)
    for ask in ("moving", "sigma"):
        (told,) = bench.answer({"ask": ask})["messages"]
        assert "alias the modes ±0.523599i and 0:" in told


def test_rules_of_the_requirement_are_said():
    wish = sd.Requirement(window=8.0, period=8.0, spacing=1.0, forbidden=[[2.0, 3.0]])
    told = ScheduleExplorer(PLANT, wish).answer({"ask": "sigma", "marks": marks(2.5, 3.2, 6.0)})["messages"]
    assert any("Closed at 2.5" in t for t in told)
    assert any("0.7 s apart; at least 1 s is required" in t for t in told)
    told = scene("laboratory").answer({"ask": "sigma", "marks": marks(3.0, 12.0, sensors=2)})["messages"]
    assert any("nurse cannot be read at 3" in t for t in told)


def test_marks_of_two_sensors_at_one_time_are_one_sample():
    bench = scene("laboratory")
    bench.answer({"ask": "open", "marks": [{"t": 9.0, "on": [True, False]}, {"t": 9.0, "on": [False, True]}]})
    assert len(bench.schedule) == 1
    assert bench.schedule.outputs is None


def test_nothing_that_small_moves_mend_says_so():
    slow = sd.Plant(np.zeros((2, 2)), np.eye(2), time_unit="s")
    one_alone = sd.PeriodicSchedule([2.0, 2.0], outputs=[[True, False]] * 2, time_unit="s")
    bench = ScheduleExplorer(slow, sd.Requirement(window=4.0, period=4.0), one_alone)
    assert "observable from no sample" in bench.answer({"ask": "sigma"})["messages"][0]
    assert bench.answer({"ask": "repair"})["said"] == "No small move of one sample repairs it: add one."


def test_two_samples_of_the_first_hour_are_answered_as_the_page_says():
    plant = sd.plants.plant_of_modes([24.0], [2.0], sensors=["blood"])
    rule = sd.Requirement(window=24.0, period=24.0, samples=4, spacing=1.0, forbidden=[[0.0, 7.0], [22.0, 24.0]])
    bench = ScheduleExplorer(plant, rule, sd.PeriodicSchedule([12.0, 12.0], 8.0, time_unit="h"))
    assert "alias the modes ±0.261799i" in bench.answer({"ask": "sigma", "marks": marks(8.0, 20.0)})["messages"][0]
    assert bench.answer({"ask": "repair"})["said"] == "No small move of one sample repairs it: add one."
    page = (Path(__file__).parents[2] / "docs" / "first_hour.md").read_text()
    assert "no move of one repairs it: a third is needed" in page


def test_a_tolerance_that_is_not_kept_says_when():
    told = scene("plan").answer({"ask": "accuracy"})["messages"]
    assert len(told) == 1
    assert "0.35 wanted; not kept from 1.975 s to 2 s and from " in told[0]
    stretches = [[float(t) for t in pair] for pair in re.findall(r"from ([\d.]+) s to ([\d.]*\d) s", told[0])]
    worst = float(re.search(r"shortly before ([\d.]+) s,", told[0])[1])
    bench = scene("plan")
    bounds = {"w_bound": bench.w_bound, "v_bound": bench.v_bound}
    known = sd.guaranteed_accuracy(bench.plant, bench.schedule, **bounds, of=bench.rows, rtol=0.05)
    edges, row = known.profile.edges, known.profile.upper[0]
    for t, upper in zip((edges[:-1] + edges[1:]) / 2 % bench.period, row, strict=True):
        assert any((t - a) % bench.period < (b - a) % bench.period for a, b in stretches) == (upper > 0.35)
    assert (worst - stretches[1][0]) % bench.period < (stretches[1][1] - stretches[1][0]) % bench.period
    tight = ScheduleExplorer(
        PLANT, sd.Requirement(period=TURN, window=TURN), w_bound=0.02, v_bound=0.1, tolerance=[0.05, 9.0]
    )
    (told,) = tight.answer({"ask": "accuracy", "marks": marks(1.0, 3.0, 5.0)})["messages"]
    assert "at no time is it kept" in told


@pytest.mark.long
def test_a_plan_is_made_on_request_and_keeps_the_tolerance():
    bench = scene("plan")
    opened = bench.answer({"ask": "open"})
    assert opened["plan"]
    assert opened["tolerance"] == [0.35]
    found = bench.answer({"ask": "plan"})
    assert "No admissible plan keeps the tolerances for less than 3" in found["said"]
    assert len(found["marks"]) == 3
    assert bench.answer({"ask": "accuracy"})["messages"] == []
    assert "must be a plan requirement" in scene("even").answer({"ask": "plan"})["error"]


def test_a_plan_requirement_brings_its_hours():
    wanted = sd.PlanRequirement(
        {"level": 0.5},
        grid="1 h",
        w_bound=0.01,
        sensors={
            "y1": {"noise_bound": 0.1, "price": 2.0},
            "y2": {"noise_bound": 1.0, "hours": {"Tue": [["09:00", "10:00"]]}},
        },
        calendar={"start": "2026-03-16", "hours": {"Mon-Fri": [["08:00", "17:00"]]}},
    )
    plant = sd.Plant([[0.0]], [[1.0], [1.0]], time_unit="h", states=["level"])
    opened = ScheduleExplorer(plant, wanted).answer({"ask": "open"})
    assert opened["period"] == 168.0
    assert opened["sensors"][0]["closed"][0] == [0.0, 8.0]
    assert len(opened["sensors"][0]["closed"]) == 6
    assert opened["sensors"][1]["closed"] == [[0.0, 33.0], [34.0, 168.0]]
    assert opened["sensors"][0]["cost"] == 2.0


def test_the_set_shrinks_sample_by_sample():
    found = scene("set").answer({"ask": "projection"})
    areas = [step["area"] for step in found["steps"]]
    assert len(areas) == 4
    assert areas == sorted(areas, reverse=True)
    assert found["names"] == ["position [m]", "velocity [m/s]"]
    assert "`projection` and both bounds" in scene("even").answer({"ask": "projection"})["error"]
    unknown = ScheduleExplorer(
        PLANT, sd.Requirement(period=4.0), w_bound=0.1, v_bound=0.1, projection=("position", "velocity")
    )
    assert unknown.answer({"ask": "projection", "marks": marks(1.0)})["steps"] == [{"after": 1, "corners": []}]


def test_accuracy_is_told_state_by_state_and_needs_bounds():
    bench = scene("pathological")
    hidden = bench.answer({"ask": "accuracy"})
    assert hidden["worst"] == [None, None]
    assert "holds at all times: no sample shows the modes with eigenvalues 0+1i, 0-1i" in hidden["messages"][0]
    seen = bench.answer({"ask": "accuracy", "marks": marks(1.0, 2.5)})
    known = sd.guaranteed_accuracy(PLANT, bench.schedule, w_bound=0.02, v_bound=0.1, rtol=0.05)
    assert seen["worst"] == pytest.approx(known.upper)
    assert len(seen["edges"]) == len(seen["upper"][0]) + 1
    assert "`w_bound` and `v_bound`" in ScheduleExplorer(PLANT).answer({"ask": "accuracy"})["error"]


def test_a_design_moves_the_marks_and_is_found_again_after_saving(tmp_path):
    wish = sd.Requirement(window=TURN, period=TURN, samples=3)
    bench = ScheduleExplorer(PLANT, wish, folder=tmp_path)
    designed = bench.answer({"ask": "design", "marks": marks(0.1, 0.2, 0.3)})
    assert "sigma >=" in designed["said"]
    assert len(designed["marks"]) == 3
    assert "Saved" in bench.answer({"ask": "save", "marks": designed["marks"]})["said"]
    again = ScheduleExplorer(PLANT, wish, folder=tmp_path)
    assert [m["t"] for m in again.marks()] == pytest.approx([m["t"] for m in designed["marks"]])


def test_a_design_has_as_many_samples_as_lie_on_the_line_where_no_requirement_counts_them():
    bench = ScheduleExplorer(PLANT, sd.Requirement(window=TURN, period=TURN))
    for times in ((0.5, 2.0, 3.5, 5.0), (0.5, 2.0, 3.5, 4.5, 5.5)):
        assert len(bench.answer({"ask": "design", "marks": marks(*times)})["marks"]) == len(times)


def test_certificate_and_horizons_are_said_in_words():
    bench = ScheduleExplorer(
        PLANT, sd.Requirement(window=TURN, period=TURN), sd.PeriodicSchedule([TURN / 2] * 2, time_unit="s")
    )
    assert "no certificate" in bench.answer({"ask": "certify"})["error"]
    found = bench.answer({"ask": "certify", "marks": marks(0.5, 2.0)})
    assert found["passed"] is True


@pytest.mark.parametrize(
    "question",
    [
        {},
        {"ask": "delete"},
        {"ask": ["sigma"]},
        {"ask": "sigma", "marks": "all"},
        {"ask": "sigma", "marks": []},
        {"ask": "sigma", "marks": [{"t": "soon", "on": [True]}]},
        {"ask": "sigma", "marks": [{"t": 1.0, "on": [True, False]}]},
        {"ask": "sigma", "marks": [{"t": 1.0, "on": "yes"}]},
        {"ask": "sigma", "marks": [{"t": 1.0, "on": [False]}]},
        {"ask": "sigma", "marks": marks(*range(500))},
    ],
)
def test_what_is_no_question_is_refused_and_changes_nothing(question):
    bench = ScheduleExplorer(PLANT, sd.Requirement(window=4.0, samples=3))
    before = bench.marks()
    assert bench.answer(question)["error"]
    assert bench.marks() == before
    assert json.loads(bench.answer_json("[1, 2"))["error"]


def test_a_bench_refuses_what_does_not_fit():
    with pytest.raises(ArgumentError, match="`schedule` must have the period"):
        ScheduleExplorer(PLANT, sd.Requirement(period=4.0), sd.PeriodicSchedule([1.0], time_unit="s"))
    with pytest.raises(ArgumentError, match="`on` must say for each of 1 sensors"):
        ScheduleExplorer(PLANT)._scheduled([{"t": 1.0, "on": [True, True]}])
    with pytest.raises(ArgumentError, match="are needed for the accuracy"):
        ScheduleExplorer(PLANT)._accuracy()
    with pytest.raises(ArgumentError, match="`projection` and both bounds are needed for the set"):
        ScheduleExplorer(PLANT)._projection()
    with pytest.raises(ArgumentError, match="`name` must be one of"):
        scene("opera")
    with pytest.raises(ArgumentError, match="`tolerance`"):
        ScheduleExplorer(PLANT, tolerance=[0.1])


def test_requirements_in_another_unit_are_converted():
    bench = ScheduleExplorer(PLANT, sd.Requirement(window=0.1, period=0.1, time_unit="min"))
    assert bench.period == pytest.approx(6.0)


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_opens_with_words(name):
    opened = scene(name).answer({"ask": "open"})
    assert opened["words"]
    assert len(opened["marks"]) >= 2
    assert len(json.dumps(opened)) < 10_000


def test_a_plant_that_decays_needs_no_samples():
    found = ScheduleExplorer(sd.Plant([[-1.0]], [[1.0]]), sd.Requirement(window=1.0)).answer({"ask": "sigma"})
    assert found["lower"] is None
    assert "No samples" in found["messages"][0] or "decay" in found["messages"][0]


def test_a_notebook_gets_the_same_answers(monkeypatch):
    widget = explore(scene("pathological"))
    sent = []
    widget.send = lambda message, *_: sent.append(message)
    widget._handle_custom_msg({"number": 3, "question": {"ask": "sigma", "marks": marks(1.0, 2.5)}}, [])
    widget._handle_custom_msg({"number": 4}, [])
    assert [m["number"] for m in sent] == [3, 4]
    assert sent[0]["answer"]["lower"] > 0.5
    assert sent[1]["answer"]["error"]
    assert widget.explorer.schedule.times == pytest.approx([1.0, 2.5])
    assert "export default" in widget._esm
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(MissingExtraError, match="anywidget"):
        explore(PLANT)


def test_a_plan_needs_a_plan_requirement():
    with pytest.raises(ArgumentError, match="`requirement` must be a plan requirement for that"):
        ScheduleExplorer(PLANT)._plan()


def test_sigma_is_shown_for_the_tolerance_that_is_required():
    schedule = sd.PeriodicSchedule([1.0] * 5)
    bench = ScheduleExplorer(PLANT, sd.Requirement(window=5.0, period=5.0, timing_tolerance=0.05), schedule)
    found = bench.answer({"ask": "sigma"})
    asked = sd.window_sigma(PLANT, schedule, 5.0, timing_tolerance=0.05)
    assert found["lower"] == asked.lower
    assert found["late"] == "up to 0.05 s early or late"
    assert found["left"] == {"late": None, "lost": asked.deviations.lost, "said": asked.deviations.explain()}
    plain = ScheduleExplorer(PLANT, sd.Requirement(window=5.0, period=5.0), schedule).answer({"ask": "sigma"})
    assert plain["late"] is None
    assert plain["left"]["late"] < plain["lower"]
    near = bench.answer({"ask": "sigma", "marks": marks(1.0, 1.05, 2.0, 3.0, 4.0)})
    assert near["late"] is None
    assert any("could change places: shown as if on time" in text for text in near["messages"])


def test_a_requirement_without_window_is_shown_as_it_is_designed():
    bench = ScheduleExplorer(PLANT)
    design = sd.design_schedule(PLANT, starts=1, branches=0)
    assert bench.window == design.requirement.window
    assert bench.requirement.timing_tolerance == design.requirement.timing_tolerance
    assert len(bench.schedule) == len(design.schedule)
    shown = bench.answer({"ask": "sigma", "marks": marks(*design.schedule.times % bench.period)})
    assert shown["lower"] == pytest.approx(design.sigma, rel=1e-6)
    assert shown["late"] == "up to 0.00392699 s early or late"
    designed = bench.answer({"ask": "design"})["said"]
    assert f"sigma >= {bench.answer({'ask': 'sigma'})['lower']:.6g}" in designed
    assert "lost" not in designed  # the sentence beside the curve says it


def test_the_accuracy_is_of_the_times_that_a_plan_allows():
    schedule = sd.PeriodicSchedule([1.0] * 5)
    sensors = {"position": {"noise_bound": 0.1}}
    wanted = sd.PlanRequirement(
        {"position": 0.5}, period=5.0, grid=1.0, timing_tolerance=0.05, w_bound=0.02, sensors=sensors
    )
    bench = ScheduleExplorer(PLANT, wanted, schedule)
    bounds = {"w_bound": 0.02, "v_bound": [0.1], "of": "position"}
    late = sd.guaranteed_accuracy(PLANT, schedule, **bounds, rtol=0.05, timing_tolerance=0.05)
    assert bench.answer({"ask": "accuracy"})["worst"] == pytest.approx(late.upper)
    assert bench.answer({"ask": "sigma"})["late"] == "up to 0.05 s early or late"


@pytest.mark.parametrize(
    ("unit", "day", "shown"), [("s", 86400.0, "h"), ("min", 1440.0, "h"), ("h", 24.0, "h"), ("h", 168.0, "d")]
)
def test_axes_and_words_count_in_a_unit_that_people_read(unit, day, shown):
    """A day in seconds is told in hours, a week in hours in days; places of samples stay the plant's."""
    rhythm = sd.Plant(np.array([[0.0, 1.0], [-1.0, 0.0]]) * 6.283 / day, [[1.0, 0.0]], time_unit=unit)
    bench = ScheduleExplorer(rhythm, sd.Requirement(window=day, period=day, forbidden=[[0.25 * day, 0.5 * day]]))
    opened = bench.answer({"ask": "open"})
    assert opened["unit"] == shown
    assert opened["period"] == day
    hours = day * opened["per_unit"]
    assert hours == pytest.approx(7.0 if shown == "d" else 24.0)
    told = bench.answer({"ask": "sigma", "marks": marks(0.25 * day, 0.9 * day)})["messages"]
    assert f"Closed at {0.25 * hours:g} {shown}: no sample is allowed there." in told
