"""new: a plant and a requirement that a newcomer can read, and that every other command takes."""

import csv
import json

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli.new import PlantModes, flat
from sampling_design.cli.options import numbers
from sampling_design.cli.requirement_flags import (
    RequirementFlags,
    by_name,
    plan_requirement,
    positive_times,
    requirement,
    week,
)
from sampling_design.errors import ArgumentError
from sampling_design.estimators.records.measurements import write_measurements
from sampling_design.planning.requirement_file import read_plan_requirement
from sampling_design.records.units import check_time_unit
from sampling_design.schedules.files import write_schedule


def test_what_it_writes_is_what_was_said(shell, tmp_path):
    done = shell(
        *("new", tmp_path / "a", "--oscillation", "24,12", "--decay", 2, "--sensors", "blood, urine", "--samples", 6)
    )
    assert done.code == 0
    assert "States: level, oscillation_1, oscillation_1_quadrature, oscillation_2," in done.out  # 24,12 are two
    assert "Next: sampling-design design" in done.out
    plant = sd.read_plant(tmp_path / "a" / "plant.toml")
    assert plant.outputs.names == ("blood", "urine")
    rates = np.linalg.eigvals(plant.A)
    assert sorted(np.round(np.abs(rates.imag), 6)) == pytest.approx([0, 0, *[0.261799] * 2, *[0.523599] * 2], abs=1e-6)
    assert min(rates.real) == pytest.approx(-np.log(3) / 2)
    assert plant.transition(2.0)[-1, -1] == pytest.approx(1 / 3)
    text = (tmp_path / "a" / "plant.toml").read_text()
    assert text.count("\n# ") + text.startswith("# ") == 4
    requirement = sd.read_requirement(tmp_path / "a" / "requirement.toml")
    assert (requirement.period, requirement.samples) == (24.0, {"exactly": 6})


def test_half_lives_names_and_units_are_taken(shell, tmp_path):
    flags = ("--oscillation", 24, "--half-life", "6, 12", "--decay", 2, "--sensors", "blood,urine", "--units", "mg/l")
    assert shell("new", tmp_path, *flags, "--names", "mean, daily, fast, slow, slower").code == 0
    plant = sd.read_plant(tmp_path / "plant.toml")
    assert plant.states.names == ("mean", "daily", "daily_quadrature", "fast", "slow", "slower")
    assert set(plant.states.units) == set(plant.outputs.units) == {"mg/l"}
    assert plant.transition(6.0)[4, 4] == pytest.approx(0.5)
    assert plant.transition(12.0)[5, 5] == pytest.approx(0.5)
    refused = shell("new", tmp_path / "x", "--half-life", 6, "--names", "one")
    assert "`--names` must have 2 entries, got 1" in refused.err


ODD = [
    "time", "date", "time_until", "date_until", "a_since", "#1", "a\nb", " a", "Time", 'a "b"', "a,b", "a;b", "a=b",
    "ü", "1", "nan", "w1", "since", "x" * 300,
]  # fmt: skip
REFUSED = 8


@pytest.mark.parametrize("name", ODD)
def test_a_name_of_a_sensor_is_refused_at_the_door_or_comes_back_out_of_every_file(name, tmp_path):
    """A plan names its sensors in a schedule and in a form; those that one of them cannot hold are named before."""
    if ODD.index(name) < REFUSED:
        with pytest.raises(ArgumentError, match=r"cannot be the column of a sensor|must be one line without control"):
            sd.plants.plant_of_modes([24.0], sensors=[name, "a"])
        return
    plant = sd.plants.plant_of_modes([24.0], sensors=[name, "a"])
    schedule = sd.PeriodicSchedule([8.0, 16.0], outputs=[[1, 0], [0, 1]], output_names=[name, "a"], time_unit="h")
    path = tmp_path / "schedule.csv"
    assert sd.read_schedule(write_schedule(schedule, path)).output_names == (name, "a")
    read = sd.Measurements(plant, [0.0, 8.0], [[1.0, np.nan], [np.nan, 2.0]])
    found = sd.read_measurements(write_measurements(read, tmp_path / "read.csv"), plant)
    assert np.array_equal(found.y, read.y, equal_nan=True)
    rows = [["date", name, "a"], ["2026-03-02T08:00", "1", "2"]]
    with (tmp_path / "form.csv").open("w", newline="") as form:
        csv.writer(form).writerows(rows)
    assert sd.read_measurements(tmp_path / "form.csv", plant).y.tolist() == [[1.0, 2.0]]


def test_names_that_are_not_separated_by_commas_are_no_one_name(shell, tmp_path):
    flags = ("--oscillation", 24, "--within", 1, "--noise", 0.1, "--disturbance", 0.1)
    for flag, words in (("--sensors", "strip;lab"), ("--units", "mg/l;g/l"), ("--names", "a=b,c")):
        refused = shell("new", tmp_path, *flags, flag, words)
        assert (refused.code, f"`{flag}` must be names with commas between" in refused.err) == (2, True)
    assert "'date' cannot be the column of a sensor" in shell("new", tmp_path, *flags, "--sensors", "date").err
    assert not any(tmp_path.iterdir())
    assert shell("new", tmp_path, *flags, "--grid", 6).code == 0  # a number of hours, as times are elsewhere
    named = (
        (tmp_path / "plan.toml").read_text().replace('"sensor"', '"date"').replace("[sensors.sensor]", "[sensors.date]")
    )
    (tmp_path / "plan.toml").write_text(named)
    (tmp_path / "plant.toml").write_text((tmp_path / "plant.toml").read_text().replace('"sensor"', '"date"'))
    refused = shell("plan", tmp_path / "plant.toml", tmp_path / "plan.toml", "-o", tmp_path / "out")
    assert (refused.code, "'date' cannot be the column of a sensor" in refused.err) == (2, True)
    assert not (tmp_path / "out" / "plan.json").exists()


def test_a_measurement_without_a_price_costs_one():
    """Of 0, which nobody typed, every plan would cost nothing."""
    asked = RequirementFlags(within="0.5", noise="0.1", disturbance="0.01", prices="blood=12")
    modes = PlantModes(oscillation="24", sensors="blood,urine")
    terms = plan_requirement(asked, modes.plant(), modes.span()).sensors
    assert [each.price for each in terms.values()] == [12.0, 1.0]


def test_nobody_copies_thirty_closed_nights_by_hand(shell, tmp_path):
    done = shell("new", tmp_path, "--oscillation", "12.42", "--period", 720, "--open", "7-19", "--json")
    assert json.loads(done.out)["requirement"]["forbidden"][:2] == [[0.0, 7.0], [19.0, 31.0]]
    closed = sd.read_requirement(tmp_path / "requirement.toml").forbidden
    example = sd.read_requirement("examples/requirements/tidal_gauge.toml").forbidden
    np.testing.assert_allclose(closed, example)


def test_weekends_are_closed_and_other_units_are_converted():
    def closed(unit, period, hours="8-16", weekend=False, start=""):
        return requirement(RequirementFlags(open_hours=hours, weekend=weekend, start=start), unit, period).forbidden

    spans = closed("h", 168.0)
    assert spans[-1].tolist() == [112.0, 168.0]
    assert len(spans) == 6
    np.testing.assert_allclose(closed("min", 168.0 * 60), 60 * spans)
    assert closed("s", 10.0, "", weekend=True).shape == (0, 2)
    assert closed("s", 86400.0, "0-24", weekend=True).shape == (0, 2)
    friday = closed("h", 168.0, start="2026-03-06")
    assert friday[:2].tolist() == [[0.0, 8.0], [16.0, 80.0]]  # a Friday, then the weekend
    late = closed("h", 168.0, start="2026-03-06T07:00")
    assert late[0].tolist() == [0.0, 1.0]  # time zero is that of the start


def test_hours_are_said_as_people_say_them():
    told = week("Mon-Wed 8:30-12, 13-17.5, Sat 9-12", weekend=True)
    assert list(told) == ["Mon", "Tue", "Wed", "Sat"]
    assert told["Tue"] == (("08:30", "12:00"), ("13:00", "17:30"))
    assert "Sat" not in week("Mon-Wed 8:30-12, Sat 9-12", weekend=False)
    assert week("", weekend=False)["Fri"] == (("00:00", "24:00"),)
    # every minute of a fortnight is forbidden, or the place is open
    typed = RequirementFlags(open_hours="Mon-Wed 8:30-12, 13-17.5, Sat 9-12", start="2026-03-04")
    shut = requirement(typed, "min", 14 * 1440.0).forbidden
    opened = sd.PlanRequirement({"x": 1.0}, calendar={"start": "2026-03-04", "hours": told}).calendar
    for minute in range(0, 14 * 1440, 15):
        assert opened.is_open(minute) != any(a <= minute < b for a, b in shut)


def test_a_period_holds_whole_days_of_opening():
    assert requirement(RequirementFlags(open_hours="7-19"), "h", 12.42).period == 24.0
    assert requirement(RequirementFlags(weekend=False), "h", 30.0).period == 168.0
    assert requirement(RequirementFlags(weekend=False), "d", 8.0).period == 14.0
    assert requirement(RequirementFlags(open_hours="7-19"), "h", 48.0).period == 48.0
    assert requirement(RequirementFlags(), "h", 12.42).period == 12.42
    with pytest.raises(ArgumentError, match="must be whole weeks, since opening hours repeat so: a multiple of 168 h"):
        requirement(RequirementFlags(weekend=False, period=24.0), "h", 24.0)


LABORATORY = (
    "--oscillation", 24, "--decay", 6, "--sensors", "blood,saliva", "--within", "level=0.4, oscillation_1=0.6",
    "--noise", "blood=0.1,saliva=0.3", "--prices", "blood=12,saliva=3", "--visit", 5, "--disturbance", "level=0.002",
    "--start", "2026-03-04", "--zone", "Europe/Berlin", "--open", "Mon-Fri 8-17, Sat 9-12", "--holidays", "2026-04-03",
)  # fmt: skip


def test_a_plan_is_asked_for_in_one_command(shell, tmp_path):
    done = shell("new", tmp_path, *LABORATORY)
    assert done.code == 0
    assert f"Next: sampling-design plan {tmp_path / 'plant.toml'} {tmp_path / 'plan.toml'}" in done.out
    asked = read_plan_requirement(tmp_path / "plan.toml")
    assert {name: goal.tolerance for name, goal in asked.accuracy.items()} == {"level": 0.4, "oscillation_1": 0.6}
    assert [(t.price, t.noise_bound) for t in asked.sensors.values()] == [(12.0, 0.1), (3.0, 0.3)]
    assert asked.w_bound == [0.002, 0.0, 0.0, 0.0]
    assert (asked.visit_price, asked.grid, asked.aim) == (5.0, "1 h", "cheapest")
    assert (asked.calendar.zone, list(asked.calendar.hours), asked.calendar.holidays) == (
        "Europe/Berlin", ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat"], ("2026-04-03",)
    )  # fmt: skip
    text = (tmp_path / "plan.toml").read_text()
    keys = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert 'Sat = [["09:00", "12:00"]]' in keys
    assert text.count("\n# ") + 1 == 9  # one comment for each kind of line, none twice
    first = sd.read_requirement(tmp_path / "requirement.toml").forbidden[0]
    assert first.tolist() == [0.0, 8.0]
    assert "midnight of 2026-03-04" in (tmp_path / "requirement.toml").read_text()


@pytest.mark.long
def test_from_flags_to_an_estimate_nobody_edits_a_file_but_the_form(shell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flags = (
        "--decay",
        12,
        "--sensors",
        "probe",
        "--within",
        "level=0.9",
        "--noise",
        0.1,
        "--disturbance",
        0.01,
        "--prices",
        2,
    )
    place = ("--start", "2026-03-02", "--zone", "Europe/Berlin", "--period", 48, "--grid", "4 h", "--open", "8-17")
    assert shell("new", "lab", *flags, *place).code == 0
    limits = ("--periods", 2, "--search-seconds", 3)
    assert shell("plan", "lab/plant.toml", "lab/plan.toml", "-o", "lab/out", *limits).code == 0
    form = (tmp_path / "lab/out/form.csv").read_text().splitlines()
    assert form[0] == "date,probe"
    assert [line.split(",")[1] for line in form[1:]] == [""] * len(form[1:])
    said = shell("next", "lab/out/plan.json", "--now", "2026-03-03T08:00")
    assert said.code == 1  # nothing is known at the start, and nothing was read: no tolerance is kept yet
    assert "Tue 03 Mar" in said.out
    taken = [f"{line}1.0" for line in form[1:-1]]  # the last sample is not taken yet: its line stays empty
    (tmp_path / "filled.csv").write_text("\n".join([form[0], *taken, form[-1], ""]))
    log = shell("compare", "lab/out/plant.toml", "lab/out/dates.csv", "filled.csv")
    assert log.code == 0
    assert "came at their times" in log.out
    bounds = ("--schedule", "lab/out/schedule.csv", "--w", 0.01, "--v", 0.1, "--initial-error", 5)
    done = shell("estimate", "lab/out/plant.toml", "filled.csv", *bounds, "-o", "lab/out")
    assert done.code == 0, done.err
    assert "level" in done.out
    assert (tmp_path / "lab/out/estimates.png").is_file()


def test_a_plan_without_dates_repeats_after_a_rhythm():
    plant = sd.Plant([[0.0]], [[1.0]], time_unit="h", states=["level"], outputs=["probe"])
    asked = RequirementFlags(within="0.5", noise="0.1", disturbance="0.01")
    found = plan_requirement(asked, plant, 24.0)
    assert (found.period, found.calendar, found.grid) == (24.0, None, None)
    assert list(found.accuracy) == ["probe"]
    assert plan_requirement(RequirementFlags(), plant, 24.0) is None
    with pytest.raises(
        ArgumentError, match=r"`--prices` belongs to a plan\. Say how well what must be known: --within\."
    ):
        plan_requirement(RequirementFlags(prices="3"), plant, 24.0)
    with pytest.raises(ArgumentError, match="`--within` makes a plan, which needs --disturbance: how strong"):
        plan_requirement(RequirementFlags(within="0.5", noise="0.1"), plant, 24.0)
    with pytest.raises(ArgumentError, match="`--start` is missing: opening hours and holidays of a plan need a date"):
        plan_requirement(
            RequirementFlags(within="0.5", noise="0.1", disturbance="0.01", open_hours="8-17"), plant, 24.0
        )
    with pytest.raises(ArgumentError, match=r"unknown key 'levl' in `--within`\. Did you mean 'level'"):
        plan_requirement(RequirementFlags(within="levl=0.5", noise="0.1", disturbance="0.01"), plant, 24.0)


def test_arrays_stand_on_a_line_each_and_mean_the_same():
    text = 'a = [\n    1.0,\n    2.0,\n]\nb = [\n    [\n        "x",\n        "y",\n    ],\n]\nc = "no"\n'
    assert flat(text).splitlines() == ["a = [1.0, 2.0]", 'b = [["x", "y"]]', 'c = "no"']
    odd = text.replace('"x"', '"x, ]"')  # a name that looks like the end of an array: left as it was
    assert flat(odd) == odd


def test_the_files_are_designed_for(shell, tmp_path):
    shell("new", tmp_path, "--oscillation", 24, "--samples", 4, "--open", "7-22")
    done = shell("design", tmp_path / "plant.toml", tmp_path / "requirement.toml", "--branches", 0, "-o", tmp_path)
    assert done.code == 0
    assert np.all(sd.read_schedule(tmp_path / "schedule.csv").times >= 7.0)


def test_a_terminal_is_asked(shell, tmp_path, monkeypatch):
    asked, answers = [], iter(["24", "3", "sensor", "7-19", ""])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.prompt", lambda text, *_, **__: asked.append(text) or next(answers))
    assert shell("new", tmp_path).code == 0
    assert len(asked) == 5
    assert sd.read_plant(tmp_path / "plant.toml").n_states == 4
    assert not (tmp_path / "plan.toml").exists()


def test_a_terminal_is_asked_again_after_a_slip_and_down_to_the_plan(shell, tmp_path, monkeypatch):
    answers = iter([
        "dayly", "24", "", "blood,blood", "blood", "8 to 5", "Mon-Fri 8-17", "levl=0.4", "level=0.4", "-1", "0.1",
        "0.002", "12", "next week", "2026-03-02", "Berlin", "Europe/Berlin",
    ])  # fmt: skip
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.prompt", lambda *_, **__: next(answers))
    done = shell("new", tmp_path)
    assert done.code == 0
    assert next(answers, "all were taken") == "all were taken"
    for slip in ("positive numbers", "twice", "two hours of a day", "Did you mean 'level'", "`--noise` must be"):
        assert slip in done.err
    asked = read_plan_requirement(tmp_path / "plan.toml")
    assert (asked.calendar.start, asked.calendar.zone) == ("2026-03-02T00:00", "Europe/Berlin")
    assert asked.w_bound == [0.002] * 3


def test_nothing_is_written_over_unless_forced(shell, tmp_path):
    shell("new", tmp_path, "--oscillation", 24)
    before = (tmp_path / "plant.toml").read_text()
    refused = shell("new", tmp_path, "--oscillation", 12)
    assert refused.code == 2
    assert "already" in refused.err
    assert (tmp_path / "plant.toml").read_text() == before
    assert shell("new", tmp_path, "--oscillation", 12, "--force").code == 0


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ((), "`new` needs to know what moves"),
        (("--oscillation", "daily"), "`--oscillation` must be positive numbers"),
        (("--oscillation", "24", "--open", "19-7"), 'over midnight, "0-6, 22-24", got'),
        (("--oscillation", "24", "--unit", "fortnight"), "`--unit` must be one of ms, s, min, h, d, wk"),
        (("--oscillation", "24", "--unit", "days"), "got 'days'. Did you mean 'd'?"),
        (("--half-life", "3x"), """`--half-life` must be positive numbers of h, or times like "3 d", with"""),
        (("--half-life", "3", "--within", "0,5", "--noise", "1", "--disturbance", "1"), "Decimals have a point"),
        (("--oscillation", "24", "--period", "24000", "--open", "7-19"), "at most 400"),
        (("--oscillation", "24", "--period", "0"), "`--period` must be positive, got 0.0"),
        (
            ("--decay", "5", "--within", "-1", "--noise", "1", "--disturbance", "1"),
            "with commas between, none negative, got '-1'",
        ),
        (("--oscillation", "24", "--within", "0.5"), "which needs --noise"),
        (("--oscillation", "24", "--within", "0.5", "--noise", "0.1", "--disturbance", "0", "--start", "no"), "start"),
        (("--oscillation", "24", "--sensors", "a,a"), "twice"),
        (("--decay", "5", "--zone", "Berlin"), "a time zone like Europe/Berlin"),
        (("--decay", "5", "--start", "soon"), "start"),
        (("--decay", "5", "--zone", "Europe/Berlin"), "`--zone` Europe/Berlin says where --start is local time"),
        (("--decay", "5", "--visit", "3"), "`--visit` belongs to a plan"),
    ],
)
def test_a_slip_is_one_sentence_and_writes_nothing(shell, tmp_path, flags, said):
    done = shell("new", tmp_path / "mine", *flags)
    assert done.code == 2
    assert said in done.err
    assert not (tmp_path / "mine").exists()


def test_what_the_flags_refuse(tmp_path, monkeypatch):
    with pytest.raises(ArgumentError, match="must be positive numbers of"):
        positive_times("--decay", "-1", "h")
    with pytest.raises(ArgumentError, match="must be two hours of a day, as 7-19"):
        week("7", weekend=True)
    with pytest.raises(ArgumentError, match=r"has hours of .* that overlap, got"):
        week("8-12, Mon 11-13", weekend=True)
    for text in ("one", "0.1, 0.2", "blood=1, blood=2", "blood=1, 2", "-1", "nan"):
        with pytest.raises(ArgumentError, match="must be a number, or blood=NUMBER with commas between"):
            by_name("--noise", text, ("blood", "urine"), ("blood",))
    with pytest.raises(ArgumentError, match="`--v-bound` is missing for urine: give a number, 0 for none"):
        numbers("--v-bound", "blood=1", ("blood", "urine"))
    with pytest.raises(ArgumentError, match="closes every day: a period of"):
        requirement(RequirementFlags(open_hours="7-19"), "h", 24.0 * 500)
    from sampling_design.cli.new import PlantModes, new
    from sampling_design.cli.settings import Settings

    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ArgumentError, match="needs to know what moves"):
        new(Settings("new"), tmp_path / "x", PlantModes(), RequirementFlags())
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="cannot be made a folder"):
        new(Settings("new"), tmp_path / "file" / "x", PlantModes(oscillation="24"), RequirementFlags())
    (tmp_path / "plant.toml").write_text("")
    with pytest.raises(ArgumentError, match=r"already\. Take another folder, or --force"):
        new(Settings("new"), tmp_path, PlantModes(oscillation="24"), RequirementFlags())


def test_times_may_have_units_of_their_own(shell, tmp_path):
    """Three days are 72 hours and 4320 minutes, whatever the plant counts in."""
    for folder, unit, typed in (("a", "h", "72, 1.5"), ("b", "h", "3 d, 90min"), ("c", "min", "3d,1.5 h")):
        assert shell("new", tmp_path / folder, "--half-life", typed, "--unit", unit).code == 0
    plants = [sd.read_plant(tmp_path / folder / "plant.toml") for folder in "abc"]
    assert np.array_equal(plants[0].A, plants[1].A)
    assert np.allclose(60 * plants[2].A, plants[0].A, rtol=1e-12)


@pytest.mark.parametrize(
    ("word", "unit"), [("days", "d"), ("Hours", "h"), ("seconds", "s"), ("minutes", "min"), ("weeks", "wk")]
)
def test_a_unit_that_is_written_out_names_its_letter(word, unit):
    with pytest.raises(ArgumentError, match=rf"got '{word}'\. Did you mean '{unit}'"):
        check_time_unit(word)
