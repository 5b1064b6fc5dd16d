"""Plans on real dates, on paper and in files: local hours, clocks, holidays, and nothing believed that a file says."""

import json
from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli.settings import Settings
from sampling_design.cli.validate import compare
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.planning.dates import plan_dates
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.figures import PlanRobustness
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.sampling_sheet import write_form, write_sheet
from tests.cases import few


@pytest.fixture(scope="module")
def dates(week):
    return plan_dates(week, 2)


def test_every_sample_is_at_an_open_local_hour_and_no_holiday(week, dates):
    assert dates.entries
    for entry in dates.entries:
        assert entry.date.weekday() < 5
        assert entry.date.hour in (9, 10, 11, 16, 17)
        assert entry.date.date().isoformat() != "2026-04-01"
    offsets = {entry.date.utcoffset().total_seconds() for entry in dates.entries}
    assert offsets == {3600.0, 7200.0}


def test_the_change_of_the_clocks_is_proven(dates):
    (change,) = [e for e in dates.exceptions if "clocks" in e.what]
    assert (change.date, change.what) == ("2026-03-29", "clocks forward by 1 h")
    assert change.proven
    assert change.ratio <= 1


def test_an_hour_across_the_change_is_an_hour_less(dates):
    real = dates.schedule()
    local = [(b.date.replace(tzinfo=None) - a.date.replace(tzinfo=None)).total_seconds() / 3600
             for a, b in zip(dates.entries, dates.entries[1:], strict=False)]  # fmt: skip
    shorter = [round(wall - gap, 6) for wall, gap in zip(local, real.gaps, strict=True)]
    assert sorted(set(shorter)) == [0.0, 1.0]
    assert shorter.count(1.0) == 1


def test_a_sheet_has_a_line_for_each_sample(dates, tmp_path):
    text = write_sheet(dates, tmp_path / "sheet.html", person="A <b>").read_text()
    assert text.count("<tr><td") + text.count("<tr>\n") >= len({e.date for e in dates.entries})
    assert text.count("class='value'") == sum(len(e.outputs) for e in dates.entries)
    assert "A &lt;b&gt;" in text
    with pytest.raises(FileFormatError, match=r"a sheet ends in \.html"):
        write_sheet(dates, tmp_path / "sheet.pdf")


def test_a_sheet_promises_no_more_than_the_plan(week, dates, tmp_path):
    """Whoever takes the samples reads what they keep, what they do not, and what nobody has looked at."""

    def page(plan, exceptions=dates.exceptions):
        altered = replace(dates, plan=plan, exceptions=exceptions)
        return write_sheet(altered, tmp_path / "sheet.html").read_text()

    kept = page(week)
    assert "Kept by these samples: level within 3 cm (all times)." in kept
    assert "Not " not in kept
    broken = page(replace(week, reached=np.array([3.25])))
    assert "Not kept, even if every sample is taken: level 3.25 cm instead of 3 cm (all times)." in broken
    assert "Kept by" not in broken
    cut = page(replace(week, left_out=("bound", "robustness")))
    assert (
        "Not looked at when this plan was made: how much more accurate a plan of this cost could be; "
        "how late samples may be and how many may be lost." in cut
    )
    (change,) = dates.exceptions
    odd = (replace(change, ratio=1.2), replace(change, proven=False), change)
    day, told = change.date, replace(dates, exceptions=odd).explain()
    assert f" with 3 exceptions; not kept: {day}; not proven: {day}. The tolerances are kept from" in told
    doubted = page(week, odd)
    assert doubted.count("The tolerances are not kept around it.") == 1
    assert doubted.count("That the tolerances are kept around it was not proven.") == 1
    bears = PlanRobustness("h", np.zeros(1), np.array([2.0]), np.ones(1), np.ones(1), 1, np.array([0.9]))
    said = "Any one sample may be 2 h late (judged in steps of 1 h); any one may be lost: after one loss "
    said += "errors reach 90 % of the tolerance."
    assert f"Away from those days: {said}" in page(replace(week, robustness=bears))
    assert f"<p class='note'>{said}" in page(replace(week, robustness=bears), ())


def test_times_without_a_calendar_are_no_dates(week):
    bare = replace(week, requirement=week.requirement.replace(calendar=None))
    with pytest.raises(ArgumentError, match="`periods` must end before the year 9999, the last of dates"):
        plan_dates(week, 10**9)
    with pytest.raises(ArgumentError, match="has no calendar: its times are no dates"):
        plan_dates(bare)


def test_two_closed_days_with_a_sample_between_them_are_judged_together():
    """One is read on Mon, Wed and Fri, two on Sat: without Fri and Mon nobody reads one for a week."""
    ten = {"Mon": [["10:00", "11:00"]], "Wed": [["10:00", "11:00"]], "Fri": [["10:00", "11:00"]]}
    sat = {"Sat": [["10:00", "11:00"]]}
    plant = sd.Plant(np.zeros((2, 2)), np.eye(2), time_unit="h", states=("one", "two"), outputs=("a", "b"))
    wanted = sd.PlanRequirement(
        {"one": 1.35, "two": 3.0},
        grid="1 h",
        w_bound=[0.01, 0.01],
        sensors={"a": {"noise_bound": 0.1, "hours": ten}, "b": {"noise_bound": 0.1, "hours": sat}},
        calendar={"start": "2026-03-30", "hours": {**ten, **sat}, "holidays": ["2026-04-03", "2026-04-06"]},
    )
    problem = pose_plan(plant, wanted)
    dates = plan_dates(proven_plan(problem, problem.allowed, PlanBound((), None, None), "complete"), 3)
    assert not dates.keeps
    assert max(e.ratio for e in dates.exceptions) == pytest.approx((0.1 + 0.01 * 168) / 1.35, rel=1e-9)
    assert "not kept: 2026-04-03, 2026-04-06" in dates.explain()
    assert not any(entry.added for entry in dates.entries)


@pytest.mark.parametrize("name", ["plan.ics", "form.csv", "plan.xlsx"])
def test_a_plan_saved_as_a_file_that_is_none_makes_no_folder(name, week, tmp_path):
    with pytest.raises(sd.errors.FileFormatError, match=r"a plan is written as \.json, or into a folder .*: save\('"):
        week.save(tmp_path / name)
    assert not [*tmp_path.iterdir()]


def test_a_plan_file_comes_back_proven_and_is_not_believed(week, tmp_path):
    path = week.save(tmp_path / "plan.json")
    back = sd.read_plan(path)
    assert back.verify()
    assert back.to_dict()["schedule"] == week.to_dict()["schedule"]
    data = json.loads(path.read_text())
    more = {**data["no_cheaper_than"], "tree": [*data["no_cheaper_than"]["tree"], {"variable": 0}]}
    cases = [
        ({**data, "reached": [x * 0.9 for x in data["reached"]]}, "where the schedule gives"),
        ({**data, "cost": data["cost"] - 1}, "where the schedule gives"),
        ({**data, "cost": data["cost"] + 1}, "where the schedule gives"),
        ({**data, "schedule": {**data["schedule"], "times": [0.0] * len(data["schedule"]["times"])}}, "cannot be used"),
        ({**data, "trajectories": [{**a, "knots": [1]} for a in data["trajectories"]]}, "that do not fit together"),
        ({**data, "trajectories": [{**a, "parts": 0} for a in data["trajectories"]]}, "parts` must be 1 to 64"),
        ({**data, "no_cheaper_than": {**data["no_cheaper_than"], "tree": []}}, "has a tree that is cut off"),
        ({**data, "no_cheaper_than": {**data["no_cheaper_than"], "rows": [[99, 0]]}}, "none of the `trajectories`"),
        ({**data, "no_cheaper_than": more}, "has nodes beside its tree"),
    ]  # fmt: skip
    for changed, words in cases:
        path.write_text(json.dumps(changed))
        with pytest.raises(FileFormatError, match=words):
            sd.read_plan(path)
    path.write_text(
        json.dumps({**data, "reached": [data["reached"][0] * 1.1, *data["reached"][1:]], "ratio": data["ratio"] * 1.1})
    )
    np.testing.assert_array_equal(sd.read_plan(path).reached, back.reached)  # what is proven by now, and it is less
    finite = {key: value for key, value in data["schedule"].items() if key not in ("period", "gaps", "first")} | {
        "kind": "finite"
    }
    path.write_text(json.dumps({**data, "schedule": finite}))
    with pytest.raises(FileFormatError, match="must be periodic"):
        sd.read_plan(path)


def test_a_schedule_outside_its_hours_is_refused(week, tmp_path):
    path = week.save(tmp_path / "plan.json")
    data = json.loads(path.read_text())
    data["requirement"]["calendar"]["hours"] = {"Sun": [["09:00", "10:00"]]}
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="does not keep the hours, spacings or limits"):
        sd.read_plan(path)


def test_a_forged_bound_does_not_verify(week, tmp_path):
    path = week.save(tmp_path / "plan.json")
    data = json.loads(path.read_text())
    data["no_cheaper_than"]["value"] += 1.0
    path.write_text(json.dumps(data))
    assert not sd.read_plan(path).verify()


def test_what_is_written_is_taken_by_log_as_it_is(week, dates, tmp_path):
    form = write_form(dates, tmp_path / "form.csv").read_text().splitlines()
    head, *lines = form
    assert head == "date,gauge,meter"
    assert len(lines) == len(dates.entries)
    filled = [line.replace(",,", ",1.5,0.2") for line in lines]
    (tmp_path / "measured.csv").write_text("\n".join([head, *filled]) + "\n")
    sd.plants.write_plant(week.plant, tmp_path / "plant.toml")
    sd.schedules.write_schedule(dates.schedule(), tmp_path / "dates.csv")
    files = [tmp_path / name for name in ("plant.toml", "dates.csv", "measured.csv")]
    compare(Settings("compare", output=tmp_path, quiet=True), *files)
    told = json.loads((tmp_path / "compare.json").read_text())
    assert len(told["planned"]) == len(told["actual"]) == len(lines)
    assert max(map(abs, told["deviations"])) < 1e-6  # on both sides of the change of the clocks


SPACED = [
    ("24 h", None, 2.0, "2026-03-23", "Europe/Berlin"),
    (None, "12 h", 1.3, "2026-10-01", "Australia/Sydney"),
    ("12 h", None, 1.3, "2026-03-23", "Europe/Berlin"),
    ("24 h", None, 2.0, "2026-10-01", "Australia/Sydney"),
]


@pytest.mark.parametrize(("spacing", "own", "tolerance", "start", "zone"), few(SPACED, 0))
def test_less_time_passes_between_no_two_samples_than_the_spacing(spacing, own, tolerance, start, zone):
    level = sd.Plant([[0.0]], [[1.0]], time_unit="h", states=["level"], outputs=["gauge"])
    wanted = sd.PlanRequirement(
        {"level": tolerance},
        period="1 d",
        grid="1 h",
        spacing=spacing,
        w_bound=0.05,
        sensors={"gauge": {"noise_bound": 0.1, "spacing": own}},
        calendar={"start": start, "zone": zone, "hours": {"Mon-Sun": [["07:00", "22:00"]]}},
    )
    found = sd.plan_samples(level, wanted, certificate=False, robustness=False)
    dates = plan_dates(found, 8)  # the clocks are put forward on the sixth night, or the third
    least = float((spacing or own).split()[0])
    gaps = np.diff([entry.time for entry in dates.entries])
    assert np.min(gaps) >= least - 1e-9
    assert any("too soon after the sample before by the changed clocks, 1 left out" in e.what for e in dates.exceptions)
    entries = [entry for entry in dates.entries if entry.time < (144 if zone == "Europe/Berlin" else 72)]
    after = sd.next_sample(found, [(entry.time, [0.0]) for entry in entries], prove=False)
    assert after.latest - entries[-1].time >= least - 1e-9
