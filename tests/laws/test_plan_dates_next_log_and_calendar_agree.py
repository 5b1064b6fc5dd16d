"""A plan, its dates, the next sample, the log and the calendar file name the same moments, and what they claim is true.

Over 44 weeks of a leap year, with both changes of the clocks, holidays, and hours that pass midnight, in three zones.
The plant is a level that drifts by `W` an hour at most, read to `V`: after h hours it is known to V + W h, exactly.
"""

import contextlib
import json
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest
import typer

import sampling_design as sd
from sampling_design.cli.plan import next_sample as next_command
from sampling_design.cli.settings import Settings
from sampling_design.cli.validate import compare
from sampling_design.planning.dates import plan_dates
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.sampling_sheet import write_form
from tests.cases import few

W, V, GAP = 0.01, 0.1, 51.75
NIGHTS = {"Mon-Thu": [["20:00", "04:00"]], "Sat": [["22:00", "04:00"]]}
ZONES = ("Europe/Berlin", "America/New_York", "Australia/Lord_Howe")
HOLIDAYS = ("2028-02-29", "2028-03-01", "2028-04-14", "2028-04-17", "2028-07-05")
MONDAY, WEDNESDAY, FRIDAY, SUNDAY = (20.0, 50.0, 99.0, 146.0)  # at 20, 2, 3 and 2 o'clock


def watched(zone, gap, chosen, **more):
    """A plan of a week that reads the level at some hours, and keeps it for gaps up to so many hours."""
    plant = sd.Plant([[0.0]], [[1.0]], time_unit="h", states=("level",), outputs=("gauge",))
    place = {"start": "2028-01-03", "zone": zone, "hours": NIGHTS, "holidays": HOLIDAYS, **more}
    wanted = sd.PlanRequirement(
        {"level": V + W * gap},
        grid="30 min",
        w_bound=W,
        sensors={"gauge": {"noise_bound": V}},
        calendar=place,
    )
    problem = pose_plan(plant, wanted)
    mask = np.zeros_like(problem.allowed)
    mask[np.round(np.array(chosen) / problem.step).astype(int)] = True
    return proven_plan(problem, mask, PlanBound((), None, None), "complete")


def is_open(local, holidays=HOLIDAYS):
    """Whether the place is open, by the calendar on the wall."""
    hour, day = local.hour + local.minute / 60, local.weekday()
    late = {0: 20, 1: 20, 2: 20, 3: 20, 5: 22}.get(day, 24)
    early = 4 if day in (1, 2, 3, 4, 6) else 0
    return local.date().isoformat() not in holidays and (hour >= late or hour < early)


@pytest.fixture(scope="module", params=few(ZONES, 2))
def year(request):
    plan = watched(request.param, GAP, (MONDAY, WEDNESDAY, FRIDAY, SUNDAY))
    return plan, plan_dates(plan, 44)


def test_dates_are_moments_at_which_the_place_is_open(year):
    plan, dates = year
    place = ZoneInfo(plan.requirement.calendar.zone)
    zero = datetime(2028, 1, 3, tzinfo=place).astimezone(UTC)
    for entry in dates.entries:
        local = (zero + timedelta(hours=entry.time)).astimezone(place)
        assert local == entry.date
        assert local.utcoffset() == entry.date.utcoffset()
        assert is_open(local)
        week = (local.replace(tzinfo=None) - datetime(2028, 1, 3)) % timedelta(days=7)
        assert entry.added or week / timedelta(hours=1) in (MONDAY, WEDNESDAY, FRIDAY, SUNDAY)


def test_what_is_said_of_the_year_is_true_of_its_real_gaps(year):
    dates = year[1]
    gaps = np.diff([entry.time for entry in dates.entries])
    attained = (V + W * float(gaps.max())) / (V + W * GAP)
    assert dates.keeps
    assert attained <= max(e.ratio for e in dates.exceptions) * (1 + 1e-9)
    told = [(e.date, e.what) for e in dates.exceptions]
    assert sum("clocks" in what and "skipped" not in what for _, what in told) == 2
    assert sum("skipped by the clocks, 1 left out" in what for _, what in told) == 1
    assert [what for day, what in told if day == "2028-03-01"] == ["closed, 1 left out, 2 added"]
    assert {day for day, what in told if what.startswith("closed")} == {*HOLIDAYS} - {"2028-02-29"}


def test_the_calendar_file_names_the_same_moments(year, tmp_path):
    plan, dates = year
    zone, schedule = plan.requirement.calendar.zone, dates.schedule()
    sd.schedules.write_ics(schedule, tmp_path / "plan.ics", span=schedule.times[-1] + 1.0, zone=zone)
    found = []
    for line in (tmp_path / "plan.ics").read_text().split("BEGIN:VEVENT")[1:]:
        (begin,) = [each for each in line.splitlines() if each.startswith("DTSTART")]
        utc = begin.endswith("Z")
        moment = datetime.strptime(begin.partition(":")[2].removesuffix("Z"), "%Y%m%dT%H%M%S")
        found.append(moment.replace(tzinfo=UTC if utc else ZoneInfo(zone)).astimezone(UTC))
    assert found == [entry.date.astimezone(UTC) for entry in dates.entries]


def test_the_form_that_was_filled_in_is_on_schedule(year, tmp_path):
    plan, dates = year
    head, *lines = write_form(dates, tmp_path / "form.csv").read_text().splitlines()
    (tmp_path / "measured.csv").write_text("\n".join([head, *(line.replace(",", ",1.5") for line in lines)]) + "\n")
    sd.plants.write_plant(plan.plant, tmp_path / "plant.toml")
    sd.schedules.write_schedule(dates.schedule(), tmp_path / "dates.csv")
    compare(
        Settings("compare", output=tmp_path, quiet=True),
        *(tmp_path / f for f in ("plant.toml", "dates.csv", "measured.csv")),
    )
    told = json.loads((tmp_path / "compare.json").read_text())
    assert len(told["actual"]) == len(dates.entries)
    assert max(map(abs, told["deviations"])) < 1e-9


def following(dates, clocks):
    """The last eight samples before a change of the clocks, and the moment from which times are counted."""
    (day,) = [e.date for e in dates.exceptions if e.what.startswith(f"clocks {clocks}")]
    taken = [entry for entry in dates.entries if entry.date.date().isoformat() < day][-8:]
    return taken, dates.entries[0].date.astimezone(UTC) - timedelta(hours=dates.entries[0].time)


@pytest.mark.parametrize("clocks", few(["forward", "back"], 0))
def test_the_next_sample_is_as_late_as_the_hours_that_pass_allow(year, clocks):
    """The latest half hour at which the place is open and no more has passed than keeps the tolerance."""
    plan, dates = year
    taken, zero = following(dates, clocks)
    found = sd.next_sample(plan, [(entry.time, [1.0], None) for entry in taken])
    last, place, latest = taken[-1].date.astimezone(UTC), ZoneInfo(plan.requirement.calendar.zone), None
    for halves in range(1, 120):
        local = (last + timedelta(minutes=30 * halves)).astimezone(place)
        if is_open(local) and not local.fold and V + W * halves / 2 <= 0.998 * (V + W * GAP):
            latest = local
    assert (found.proven, found.keeps) == (True, True)
    assert found.date(found.latest) == latest
    assert found.latest == pytest.approx((latest.astimezone(UTC) - zero) / timedelta(hours=1), rel=1e-12)
    assert (V + W * (found.latest - taken[-1].time)) / (V + W * GAP) <= found.ratio * (1 + 1e-9)


@pytest.mark.long
@pytest.mark.parametrize("clocks", few(["forward", "back"], 1))
def test_now_as_a_local_date_is_the_time_that_passed(year, clocks, tmp_path):
    plan, dates = year
    plan.save(tmp_path / "plan.json")
    taken, zero = following(dates, clocks)
    monday = (taken[-1].date + timedelta(days=7 - taken[-1].date.weekday())).replace(hour=9, minute=0)
    form = ["date,gauge", *(f"{entry.date.isoformat()},1.5" for entry in taken)]
    (tmp_path / "measured.csv").write_text("\n".join(form) + "\n")
    files, local = (tmp_path / "plan.json", tmp_path / "measured.csv"), monday.replace(tzinfo=None).isoformat()
    with contextlib.suppress(typer.Exit):  # by then the tolerance is broken
        next_command(Settings("next", output=tmp_path, quiet=True), *files, now=local)
    told = json.loads((tmp_path / "next.json").read_text())["now"]
    assert told["time"] == pytest.approx((monday.astimezone(UTC) - zero) / timedelta(hours=1), rel=1e-12)
    assert told["date"] == monday.isoformat()


def above(times):
    """How far the level is above its tolerance between samples, over time."""
    gaps = np.diff(times)
    return float(np.sum(gaps * np.maximum(V + W * gaps - (V + W * GAP), 0.0)))


@pytest.mark.parametrize("seed", few(range(3), 1))
def test_whatever_days_are_closed_no_more_is_claimed_than_the_real_gaps_allow(seed):
    """Five days drawn at random from three weeks, some of them side by side."""
    rng = np.random.default_rng(seed)
    days = np.sort(rng.choice(np.arange(10, 31), 5, replace=False))
    closed = [(datetime(2028, 1, 3) + timedelta(days=int(day))).date().isoformat() for day in days]
    plan = watched("Europe/Berlin", GAP, (MONDAY, WEDNESDAY, FRIDAY, SUNDAY), holidays=closed)
    dates = plan_dates(plan, 6)
    times = np.array([entry.time for entry in dates.entries])
    assert all(is_open(entry.date, closed) for entry in dates.entries)
    attained = (V + W * float(np.diff(times).max())) / (V + W * GAP)
    claimed = max(e.ratio for e in dates.exceptions)
    assert dates.keeps == (attained <= 1)
    assert attained <= claimed * (1 + 1e-9)
    if attained > 1:
        assert claimed == pytest.approx(attained, rel=1e-9)
    for k in np.flatnonzero([entry.added for entry in dates.entries]):
        assert above(np.delete(times, k)) > above(times)


def test_a_fortnight_without_samples_is_said_and_nothing_is_added_in_vain():
    closed = [f"2028-02-{day:02d}" for day in range(7, 21)]
    dates = plan_dates(watched("Europe/Berlin", GAP, (MONDAY, WEDNESDAY, FRIDAY, SUNDAY), holidays=closed), 10)
    times = np.array([entry.time for entry in dates.entries])
    attained = (V + W * float(np.diff(times).max())) / (V + W * GAP)
    (exception,) = [e for e in dates.exceptions if e.what.startswith("closed")]
    assert (exception.proven, exception.ratio) == (False, pytest.approx(attained, rel=1e-9))
    assert not dates.keeps
    assert not any(entry.added for entry in dates.entries)
