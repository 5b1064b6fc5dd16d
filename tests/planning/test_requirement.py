"""Requirements of plans: what is refused, what comes back from a file, and which times are allowed."""

import itertools
from datetime import UTC, timedelta
from itertools import product
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, FileFormatError, InfeasibleRequirementError
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.requirement import AccuracyGoal, PlanRequirement, duration
from sampling_design.planning.requirement_file import requirement_and_plant, write_plan_requirement
from sampling_design.schedules.opening import OpeningCalendar, PlanClock, week_hours
from tests.cases import few

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], time_unit="h", outputs=["p", "q"])
WEEK = {"start": "2026-03-23", "zone": "Europe/Berlin", "hours": {"Mon-Fri": [["08:00", "17:00"]]}}
GIVEN = {"w_bound": 0.1, "sensors": {"p": {"noise_bound": 0.1}}}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"accuracy": len}, "`accuracy` must be a table of goals by row, got"),
        ({"accuracy": {"x1": 0.0}}, "accuracy.x1.* must be positive"),
        ({"accuracy": {"x1": {"at": "all times"}}}, r"`accuracy.x1.tolerance` is missing"),
        ({"accuracy": {"x1": {"tolerance": 1.0, "at": "noon"}}}, '`at` must be one of "all times"'),
        ({"accuracy": {"x1": {"tolerance": 1.0, "at": []}}}, "`at` must name at least one time"),
        ({"sensors": range(3)}, "`sensors` must be a table of terms by output, got range"),
        ({"calendar": {}}, "`calendar.start` is missing"),
        ({"sensors": {"p": 3}}, "`sensors.p` must be a table of keys and values"),
        ({"sensors": {"p": {"prize": 3}}}, "Did you mean 'price'"),
        ({"grid": "15 parsec"}, "`grid` must be a time like 0.25 or"),
        ({"grid": "15 hours"}, """`grid` must be a time like 0.25 or "15 min", got '15 hours'. Did you mean 'h'?"""),
        ({"grid": "1e400 min"}, "`grid` must be a time like 0.25 or"),
        ({"aim": "most accurate"}, "`aim` is most accurate, which needs `samples` or `cost_limit`"),
        (
            {"calendar": {**WEEK, "hours": {"Mo": [["08:00", "17:00"]]}}},
            "must name weekdays like Mon or Mon-Fri",
        ),
        ({"calendar": {**WEEK, "hours": {"Mon": [["17:00", "17:00"]]}}}, "must hold spans like "),
        ({"calendar": {**WEEK, "holidays": ["1 May"]}}, "`holidays` must be dates like 2026-05-01"),
        ({"calendar": {**WEEK, "zone": "Mars"}}, "`zone` must be the name of a time zone"),
    ],
)
def test_a_wrong_value_is_refused_in_one_sentence(wrong, words):
    with pytest.raises(ArgumentError, match=words):
        PlanRequirement(**{"accuracy": {"x1": 1.0}, "period": 8.0, **GIVEN, **wrong})


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"period": None}, "`period` is missing: after which time"),
        ({"grid": 0.3}, "`grid` must divide the period"),
        ({"period": 100.0, "grid": 1.0, "calendar": WEEK}, "`period` must be whole weeks"),
        ({"sensors": {"p": {"noise_bound": 0.1, "hours": {"Mon": [["08:00", "09:00"]]}}}}, "needs a `calendar`"),
        ({"accuracy": {"x1": {"tolerance": 1.0, "at": [0.3]}}, "grid": 1.0}, "must name times on the grid of"),
        ({"accuracy": {}}, "names no accuracy. Without bounds, `design_schedule`"),
        ({"w_bound": None}, "`w_bound` is missing: accuracy of x1"),
        ({"sensors": {}}, "`sensors` have no `noise_bound`"),
        ({"sensors": {"p": {"noise_bound": 0.0}}}, "`noise_bound` must be positive"),
        ({"sensors": {"r": {"noise_bound": 0.1}}}, "unknown key 'r' in `sensors`"),
    ],
)
def test_what_does_not_fit_the_plant_is_refused(wrong, words):
    requirement = PlanRequirement(**{"accuracy": {"x1": 1.0}, "period": 8.0, **GIVEN, **wrong})
    with pytest.raises(ArgumentError, match=words):
        pose_plan(PLANT, requirement)


def test_no_hours_at_all_are_no_plan():
    closed = {**WEEK, "hours": {}}
    with pytest.raises(InfeasibleRequirementError, match="No sensor may be measured at any time"):
        pose_plan(PLANT, PlanRequirement({"x1": 1.0}, calendar=closed, **GIVEN))


def test_a_schedule_off_the_grid_is_refused():
    problem = pose_plan(PLANT, PlanRequirement({"x1": 1.0}, period=8.0, grid=1.0, **GIVEN))
    with pytest.raises(ArgumentError, match="times on the grid of"):
        problem.chosen(sd.PeriodicSchedule([4.5, 3.5], time_unit="h"))


def test_hours_are_local_and_half_open():
    sensors = {"p": {"noise_bound": 0.1}, "q": {"noise_bound": 0.1, "hours": {"Tue": [["09:00", "24:00"]]}}}
    allowed = pose_plan(PLANT, PlanRequirement({"x1": 1.0}, calendar=WEEK, w_bound=0.1, sensors=sensors)).allowed
    assert allowed.shape == (672, 2)
    hours = np.flatnonzero(allowed[:, 0]) / 4 % 24
    assert (hours.min(), hours.max()) == (8.0, 16.75)
    assert np.flatnonzero(allowed[:, 0]).max() / 4 < 5 * 24
    own = np.flatnonzero(allowed[:, 1]) / 4
    assert (own.min(), own.max()) == (33.0, 40.75)  # Tuesday, nine until five


def test_a_local_hour_keeps_its_hour_across_a_change_of_the_clocks():
    place = OpeningCalendar("2026-03-23", "Europe/Berlin")
    week = 7 * 1440
    assert place.instant(480).isoformat() == "2026-03-23T08:00:00+01:00"
    assert place.instant(week + 480).isoformat() == "2026-03-30T08:00:00+02:00"
    assert place.elapsed(week + 480) - place.elapsed(480) == week - 60


def test_hours_past_midnight_end_on_the_next_day():
    place = OpeningCalendar("2026-03-23", hours={"Mon-Fri": [("22:00", "06:00")], "Sat": [("12:00", "00:00")]})
    week = np.arange(0.0, 10080.0, 15.0)
    nights = [(day * 1440 + 1320.0, day * 1440 + 1800.0) for day in range(5)] + [(5 * 1440 + 720.0, 6 * 1440.0)]
    assert [place.is_open(t) for t in week.tolist()] == [any(a <= t < b for a, b in nights) for t in week.tolist()]
    assert OpeningCalendar(**place.to_dict()).to_dict() == place.to_dict()
    sunday = OpeningCalendar("2026-03-23", hours={"Sun": [("23:00", "01:30")]})
    assert (sunday.is_open(0.0), sunday.is_open(89.0), sunday.is_open(90.0)) == (True, True, False)
    for span in (["08:00", "08:00"], ["24:00", "06:00"]):
        with pytest.raises(ArgumentError, match=r"spans like .* or, past midnight, \[\"22:00\", \"06:00\"\], got"):
            OpeningCalendar("2026-03-23", hours={"Mon": [span]})


def test_a_start_is_what_the_clocks_of_its_zone_show_once():
    for start in ("2026-03-23T08:00+01:00", "2026-03-23T08:00", "2026-03-23T08:00[Europe/Berlin]", "20260323T0800"):
        assert OpeningCalendar(start, "Europe/Berlin").instant(0.0).isoformat() == "2026-03-23T08:00:00+01:00"
    with pytest.raises(ArgumentError, match=r"has another offset than the clocks of Europe/Berlin, which show 2026-03"):
        OpeningCalendar("2026-03-23T08:00+05:00", "Europe/Berlin")
    with pytest.raises(ArgumentError, match="has another offset"):
        OpeningCalendar("2026-03-23T08:00[Asia/Tokyo]", "Europe/Berlin")
    for start in ("2026-03-23T08:00:30", "2026-03-23T08:00:00.5"):
        with pytest.raises(ArgumentError, match="`start` must be at a whole minute, got 2026-03-23T08:00:"):
            OpeningCalendar(start, "Europe/Berlin")
    for start in ("2026-03-29T02:30", "2026-10-25T02:30+01:00"):
        with pytest.raises(ArgumentError, match="skipped or repeated by the clocks of Europe/Berlin: begin at a time"):
            OpeningCalendar(start, "Europe/Berlin")


@pytest.mark.parametrize(
    ("zone", "minutes"),
    few(product(("Europe/Berlin", "Australia/Lord_Howe", "America/St_Johns"), (1e-3 / 60, 1.0, 60.0, 1440.0)), 4),
)
def test_time_that_passed_and_what_clocks_show_name_each_other(zone, minutes):
    """In any unit: real times give back themselves, and clock times the first real time that shows them."""
    place = OpeningCalendar("2026-01-01", zone)
    clock, day = PlanClock(place, minutes), 1440 / minutes
    real = np.arange(0.0, 366.0, 1 / 48) * day
    clock_time = clock.clock_time(real)
    zero = place.instant(0.0).astimezone(UTC)
    for t, c in list(zip(real.tolist(), clock_time.tolist(), strict=True))[:: 48 * 5]:
        there = (zero + timedelta(minutes=t * minutes)).astimezone(ZoneInfo(zone))
        assert abs((there.replace(tzinfo=None) - place.first) / timedelta(minutes=minutes) - c) <= 1e-9 * day
    back = clock.elapsed(clock_time)
    again = np.abs(back - real) > 1e-9 * day  # the clocks had shown it before
    assert np.all(back[again] < real[again])
    assert again.sum() in (1, 2)
    np.testing.assert_allclose(clock.clock_time(back), clock_time, rtol=1e-12)
    still = PlanClock(place, minutes, until=100 * day)
    np.testing.assert_array_equal(still.clock_time(real[:4800]), clock_time[:4800])
    assert np.ptp(still.clock_time(real[4800:]) - real[4800:]) <= 1e-9 * day
    np.testing.assert_allclose(still.elapsed(still.clock_time(real[4800:])), real[4800:], rtol=1e-12)


def test_durations_have_units():
    assert duration("grid", "15 min", "h") == 0.25
    assert duration("grid", 2.0, "h") == 2.0


def test_a_file_comes_back_and_may_hold_its_plant(tmp_path):
    goals = {
        "x1": AccuracyGoal(0.5, at=[1.0, 2.0]),
        "both": {"tolerance": 1.0, "row": [1.0, 1.0], "at": "after each sample"},
    }
    sensors = {"p": {"price": 2.0, "noise_bound": 0.1, "longest_use": 3, "spacing": "2 h", "hours": WEEK["hours"]}}
    wanted = PlanRequirement(goals, grid="15 min", calendar=WEEK, w_bound=[0.1, 0.2], sensors=sensors, cost_limit=9.0)
    for name in ("r.toml", "r.json"):
        back = sd.planning.read_plan_requirement(write_plan_requirement(wanted, tmp_path / name))
        assert back.to_dict() == wanted.to_dict()
    with pytest.raises(FileFormatError, match=r"ends in \.toml or \.json"):
        write_plan_requirement(wanted, tmp_path / "r.csv")
    (tmp_path / "bad.toml").write_text('format = "sampling-design/plan-requirement/1"\ngirds = 1\n')
    with pytest.raises(FileFormatError, match="Did you mean 'grid'"):
        sd.planning.read_plan_requirement(tmp_path / "bad.toml")
    (tmp_path / "bad.toml").write_text('format = "sampling-design/plan-requirement/1"\naccuracy = 3\n')
    with pytest.raises(FileFormatError, match="`accuracy` must be a table of keys and values"):
        sd.planning.read_plan_requirement(tmp_path / "bad.toml")
    (tmp_path / "bad.toml").write_text('format = "sampling-design/plan-requirement/1"\naim = "most accurate"\n')
    with pytest.raises(FileFormatError, match="cannot be used: `aim`"):
        sd.planning.read_plan_requirement(tmp_path / "bad.toml")
    requirement, plant = requirement_and_plant("examples/plans/oscillator.toml")
    assert plant is not None
    assert plant.name == "oscillator"
    assert requirement.accuracy["position"].tolerance == 0.35


def test_what_is_closed_is_all_that_is_not_open():
    place = OpeningCalendar("2026-03-24T10:30", hours={"Mon-Fri": [("08:00", "12:00"), ("12:00", "17:00")]})
    own = week_hours("hours", {"Tue": [("11:00", "13:15")], "Fri": [("16:00", "20:00")]})
    for hours in (None, own):
        spans = place.closed(10080.0, hours)
        assert all(a < b < c < d for (a, b), (c, d) in itertools.pairwise(spans))
        for minute in np.arange(0.0, 10080.0, 15.0).tolist():
            assert any(a <= minute < b for a, b in spans) != place.is_open(minute, hours)
    assert OpeningCalendar("2026-03-23").closed(10080.0) == []


@pytest.mark.parametrize("hours", ['"Mon-Fri 8-12"', '{ Mon-Fri = "8-12" }'])
def test_hours_in_words_are_told_how_a_file_says_them(tmp_path, hours):
    place = tmp_path / "wanted.toml"
    place.write_text(
        f'format = "sampling-design/plan-requirement/1"\n[calendar]\nstart = "2026-03-23"\nhours = {hours}\n'
    )
    with pytest.raises(
        FileFormatError, match=r'`calendar.hours` must be spans by weekday, as hours = { "Mon-Fri" = \[\['
    ):
        requirement_and_plant(place)
