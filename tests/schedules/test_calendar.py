from datetime import UTC, datetime, timedelta
from itertools import product
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from sampling_design import ArgumentError, PeriodicSchedule, Schedule
from sampling_design.schedules.calendar import calendar, write_calendar_csv, write_ics
from sampling_design.schedules.opening import OpeningCalendar
from tests.cases import few

DAY = PeriodicSchedule([8.0, 16.0], 0.0, time_unit="h", origin="2026-01-05")


def parse_ics(data):
    """Unfold and unescape by RFC 5545, independent of the writer: a list of events as dictionaries."""
    text = data.decode("utf-8")
    assert "\n" not in text.replace("\r\n", "")
    for line in data.split(b"\r\n"):
        assert len(line) <= 75
    lines = text.replace("\r\n ", "").split("\r\n")
    assert lines[0] == "BEGIN:VCALENDAR"
    assert lines[-2:] == ["END:VCALENDAR", ""]
    assert {"VERSION:2.0"} <= set(lines)
    assert any(line.startswith("PRODID:") for line in lines)
    events = []
    for line in lines:
        name, _, value = line.partition(":")
        if line == "BEGIN:VEVENT":
            events.append({})
        elif events and name not in ("END", "BEGIN", ""):
            plain = value.replace("\\,", ",").replace("\\;", ";").replace("\\n", "\n").replace("\\\\", "\\")
            events[-1][name] = plain
    assert all({"UID", "DTSTAMP", "DTSTART"} <= set(event) for event in events)
    assert len({event["UID"] for event in events}) == len(events)
    return events


def expand(events, count):
    """The first dates of weekly, daily, ... rules, merged."""
    units = {"WEEKLY": 604800, "DAILY": 86400, "HOURLY": 3600, "MINUTELY": 60, "SECONDLY": 1}
    dates = []
    for event in events:
        start = datetime.strptime(event["DTSTART"], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
        rule = dict(part.split("=") for part in event["RRULE"].split(";"))
        step = timedelta(seconds=units[rule["FREQ"]] * int(rule["INTERVAL"]))
        until = rule.get("UNTIL")
        until = (
            datetime.strptime(until, "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
            if until
            else datetime.max.replace(tzinfo=UTC)
        )
        dates += [start + i * step for i in range(count) if start + i * step <= until]
    return sorted(dates)


def test_dates_begin_at_the_origin_or_the_start_given():
    assert [e.date.isoformat() for e in calendar(DAY)] == ["2026-01-05T00:00:00+00:00", "2026-01-05T16:00:00+00:00"]
    zone = calendar(DAY, "2026-03-01T06:00+02:00", span=48.0)
    assert [e.date.isoformat() for e in zone] == [
        f"2026-03-0{d}T{h}:00:00+02:00" for d, h in ((1, "06"), (1, "22"), (2, "06"), (2, "22"))
    ]
    assert [e.time for e in zone] == [0.0, 16.0, 24.0, 40.0]
    finite = Schedule([0.5, 1.0], [[1, 0], [1, 1]], time_unit="d", output_names=["TSH", "T3"])
    entries = calendar(finite, datetime(2026, 1, 1))
    assert [e.outputs for e in entries] == [("TSH",), ("TSH", "T3")]
    assert entries[1].date == datetime(2026, 1, 2, tzinfo=UTC)
    assert len(calendar(finite, "2026-01-01", span=1.0)) == 1  # the span is open at its end


def test_csv(tmp_path):
    path = tmp_path / "dates.csv"
    schedule = Schedule([0.5, 1.0], [[1, 0], [1, 1]], time_unit="d", output_names=["TSH", 'a,"b"'])
    write_calendar_csv(schedule, path, "2026-01-01")
    assert path.read_text() == (
        'date,time,TSH,"a,""b"""\n2026-01-01T12:00:00+00:00,0.5,1,0\n2026-01-02T00:00:00+00:00,1.0,1,1\n'
    )
    write_calendar_csv(Schedule([1.0], [[0, 1]], time_unit="s"), path, "2026-01-01")
    assert path.read_text() == "date,time,y1,y2\n2026-01-01T00:00:01+00:00,1.0,0,1\n"


def test_ics_repeats_by_rule_without_end(tmp_path):
    path = tmp_path / "day.ics"
    write_ics(DAY, path)
    events = parse_ics(path.read_bytes())
    assert [e["RRULE"] for e in events] == ["FREQ=DAILY;INTERVAL=1"] * 2
    assert expand(events, 4) == [e.date for e in calendar(DAY, span=96.0)]


@pytest.mark.parametrize(
    ("gaps", "unit", "rule"),
    [
        ([3.0, 4.0], "d", "FREQ=WEEKLY;INTERVAL=1"),
        ([36.0], "h", "FREQ=HOURLY;INTERVAL=36"),
        ([48.0], "h", "FREQ=DAILY;INTERVAL=2"),
        ([90.0], "s", "FREQ=SECONDLY;INTERVAL=90"),
        ([0.1, 0.2], "min", "FREQ=SECONDLY;INTERVAL=18"),
        ([90.0], "min", "FREQ=MINUTELY;INTERVAL=90"),
    ],
)
def test_rules_use_the_largest_whole_unit(tmp_path, gaps, unit, rule):
    schedule = PeriodicSchedule(gaps, time_unit=unit, origin="2026-01-05")
    write_ics(schedule, tmp_path / "a.ics")
    events = parse_ics((tmp_path / "a.ics").read_bytes())
    assert {e["RRULE"] for e in events} == {rule}
    expected = [e.date for e in calendar(schedule, span=5 * schedule.period)]
    assert expand(events, 9)[: len(expected)] == expected


def test_a_span_ends_the_repetition_where_the_dates_end(tmp_path):
    for span in (24.0, 40.0, 40.5, 100.0):
        write_ics(DAY, tmp_path / "a.ics", span=span)
        events = parse_ics((tmp_path / "a.ics").read_bytes())
        assert expand(events, 50) == [e.date for e in calendar(DAY, span=span)]
    write_ics(DAY, tmp_path / "a.ics", span=10.0)
    assert len(parse_ics((tmp_path / "a.ics").read_bytes())) == 1  # the second sample of the period comes later


def test_other_schedules_are_written_out_and_rounded_to_seconds(tmp_path):
    path = tmp_path / "a.ics"
    orbit = PeriodicSchedule([5554.4], time_unit="s", origin="2026-01-05")
    write_ics(orbit, path, span=20000.0)
    events = parse_ics(path.read_bytes())
    assert [e["DTSTART"] for e in events] == ["20260105T013234Z", "20260105T030509Z", "20260105T043743Z"]
    assert all("RRULE" not in e for e in events)
    write_ics(Schedule([1.0], time_unit="h"), path, "2026-01-05T12:00+03:00")
    assert parse_ics(path.read_bytes())[0]["DTSTART"] == "20260105T100000Z"
    with pytest.raises(ArgumentError, match=r"`span` is missing: the period 5554.4 s is no whole number of seconds"):
        write_ics(orbit, path)


def test_text_is_escaped_and_folded(tmp_path):
    names = ["Größe, links; \\unten", "日本語" * 30]
    schedule = Schedule([1.0, 2.0], [[1, 1], [1, 0]], time_unit="h", output_names=names)
    write_ics(schedule, tmp_path / "a.ics", "2026-01-05", summary="Line one\nand two")
    events = parse_ics((tmp_path / "a.ics").read_bytes())
    assert events[0]["SUMMARY"] == f"Line one\nand two: {', '.join(names)}"
    assert events[1]["SUMMARY"] == f"Line one\nand two: {names[0]}"


def test_the_same_schedule_gives_the_same_octets(tmp_path):
    write_ics(DAY, tmp_path / "a.ics")
    write_ics(PeriodicSchedule([8.0, 16.0], 0.0, time_unit="h"), tmp_path / "b.ics", "2026-01-05T00:00Z")
    assert (tmp_path / "a.ics").read_bytes() == (tmp_path / "b.ics").read_bytes()
    assert b"DTSTAMP:20260105T000000Z" in (tmp_path / "a.ics").read_bytes()


def test_bad_input(tmp_path):
    with pytest.raises(ArgumentError, match="`schedule` must have a time unit to become dates"):
        calendar(Schedule([1.0]), "2026-01-05")
    with pytest.raises(ArgumentError, match="`origin` is missing, and the schedule has none"):
        calendar(Schedule([1.0], time_unit="h"))
    with pytest.raises(ArgumentError, match="`origin` must be a date like 2026-01-05T08:00"):
        calendar(DAY, "next week")
    with pytest.raises(ArgumentError, match="`span` must be positive"):
        calendar(DAY, span=0.0)
    with pytest.raises(ArgumentError, match="asks for more than 100000 dates"):
        calendar(DAY, span=1e9)
    with pytest.raises(ArgumentError, match=r"lies beyond the year 9999. Is the time unit right\?"):
        calendar(Schedule([1e9], time_unit="wk"), "2026-01-05")
    with pytest.raises(ArgumentError, match="must be a Schedule or a PeriodicSchedule, got list"):
        write_ics([1.0], tmp_path / "a.ics", "2026-01-05")
    assert not list(tmp_path.iterdir())


def test_a_zone_keeps_the_gaps_across_a_change_of_its_clocks(tmp_path):
    """Berlin puts its clocks forward on 29 March 2026: a day's gap stays 24 hours, the clock then shows one more."""
    daily = Schedule([0.0, 24.0, 48.0], time_unit="h")
    entries = calendar(daily, "2026-03-28T08:00", zone="Europe/Berlin")
    assert [e.date.isoformat() for e in entries] == [
        "2026-03-28T08:00:00+01:00",
        "2026-03-29T09:00:00+02:00",
        "2026-03-30T09:00:00+02:00",
    ]
    told = calendar(daily, datetime(2026, 3, 28, 8, tzinfo=ZoneInfo("Europe/Berlin")))
    assert [e.date for e in told] == [e.date for e in entries]
    text = write_calendar_csv(daily, tmp_path / "c.csv", "2026-03-28T08:00", zone="Europe/Berlin").read_text()
    assert "2026-03-29T09:00:00+02:00,24.0" in text
    ics = write_ics(PeriodicSchedule([24.0], time_unit="h"), tmp_path / "c.ics", entries[0].date).read_text()
    assert "DTSTART:20260329T070000Z" in ics
    assert "FREQ=DAILY;INTERVAL=1" in ics


def test_dates_lie_on_a_grid():
    schedule = Schedule([1.0 / 3.0, 2.0], time_unit="h")
    assert [e.date.microsecond for e in calendar(schedule, "2026-01-05")] == [0, 0]
    quarter = calendar(schedule, "2026-01-05", grid=15.0)
    assert [e.date.isoformat() for e in quarter] == ["2026-01-05T00:20:00+00:00", "2026-01-05T02:00:00+00:00"]
    fast = Schedule([0.0, 0.25], time_unit="s")
    assert calendar(fast, "2026-01-05")[1].date.microsecond == 250_000
    with pytest.raises(ArgumentError, match=r"`grid` = 1\.0 s puts two samples at 2026-01-05T00:00:00"):
        calendar(fast, "2026-01-05", grid=1.0)


@pytest.mark.parametrize(
    ("grid", "zone", "clocks"),
    [
        (900.0, None, ["00:15", "07:30", "23:00", "07:45"]),
        (3600.0, None, ["00:00", "08:00", "23:00", "08:00"]),
        (3600.0, "Asia/Kolkata", ["00:00", "08:00", "23:00", "08:00"]),
        (7200.0, "Europe/Berlin", ["00:00", "08:00", "00:00", "10:00"]),
        (43200.0, "Europe/Berlin", ["00:00", "12:00", "00:00", "12:00"]),
    ],
)
def test_a_grid_of_minutes_and_hours_is_that_of_the_clocks_on_the_wall(grid, zone, clocks):
    schedule = Schedule([0.05, 7.4, 22.9, 31.7 + (zone == "Europe/Berlin")], time_unit="h")
    dates = [e.date for e in calendar(schedule, "2026-03-29T00:10", zone=zone, grid=grid)]
    assert [f"{d:%H:%M}" for d in dates] == clocks
    exact = [e.date for e in calendar(schedule, "2026-03-29T00:10", zone=zone)]
    moved = [a.astimezone(UTC) - b.astimezone(UTC) for a, b in zip(dates, exact, strict=True)]
    assert max(abs(m.total_seconds()) for m in moved) <= grid / 2


CHANGES = {
    "Europe/Berlin": ("2026-03-28", "2026-10-24"),
    "Australia/Lord_Howe": ("2026-10-03", "2026-04-04"),
    "America/Santiago": ("2026-09-05", "2026-04-04"),  # at midnight
    "America/New_York": ("2026-03-07", "2026-10-31"),
    "Asia/Kathmandu": ("2026-03-28", "2026-10-24"),
}
"""The days before clocks go forward, and back."""


@pytest.mark.parametrize(("zone", "back"), few(product(CHANGES, (0, 1)), 0, 3, 4))
def test_a_date_is_the_nearest_that_the_clocks_show_on_the_grid(zone, back):
    """Against every minute of three days: the grid of a change of the clocks is that of what they show."""
    place, start, rng = ZoneInfo(zone), datetime.fromisoformat(CHANGES[zone][back]), np.random.default_rng(back)
    zero = start.replace(tzinfo=place).astimezone(UTC)
    every = [zero + timedelta(minutes=k) for k in range(-600, 4920)]
    shown = [each.astimezone(place).replace(tzinfo=None) - start for each in every]
    for grid in (20, 60, 120, 180, 240, 300):
        on_grid = [each for each, clock in zip(every, shown, strict=True) if not clock % timedelta(minutes=grid)]
        for minutes in np.append(rng.uniform(0, 4300, 10), rng.uniform(1380, 1750, 20)):
            schedule = Schedule([minutes], time_unit="min")
            (entry,) = calendar(schedule, start, zone=zone, grid=60.0 * grid)
            exact = zero + timedelta(minutes=float(minutes))
            assert entry.date.astimezone(UTC) == min(on_grid, key=lambda each: abs(each - exact))


def test_events_that_repeat_by_rule_lie_on_a_grid_of_minutes_too(tmp_path):
    text = write_ics(DAY, tmp_path / "a.ics", "2026-01-05T08:02", grid=900.0).read_text()
    starts = [line for line in text.splitlines() if line.startswith("DTSTART")]
    assert starts
    assert all(line[-5:-1] in ("0000", "1500", "3000", "4500") for line in starts)
    assert "RRULE:FREQ=DAILY;INTERVAL=1" in text


def test_zones_and_hours_that_are_not_are_refused():
    schedule = Schedule([0.0], time_unit="h")
    with pytest.raises(ArgumentError, match="`zone` must be the name of a time zone like Europe/Berlin, got 'Mars'"):
        calendar(schedule, "2026-01-05", zone="Mars")
    for skipped_or_repeated in ("2026-03-29T02:30", "2026-10-25T02:30"):
        with pytest.raises(ArgumentError, match="is skipped or repeated by the clocks of Europe/Berlin"):
            calendar(schedule, skipped_or_repeated, zone="Europe/Berlin")


def local_dates(text):
    """Dates of events by the file's own VTIMEZONE: the last observance that had begun."""
    lines = text.replace("\r\n ", "").split("\r\n")
    changes, dates = [], []
    for line in lines:
        name, _, value = line.partition(":")
        if name in ("BEGIN", "END"):
            inside = value if name == "BEGIN" else ""
        elif name == "DTSTART" and inside in ("STANDARD", "DAYLIGHT"):
            changes.append([datetime.strptime(value, "%Y%m%dT%H%M%S"), None])
        elif name == "TZOFFSETTO":
            changes[-1][1] = timedelta(hours=int(value[:3]), minutes=int(value[0] + value[3:5]))
        elif name.startswith("DTSTART;TZID"):
            local = datetime.strptime(value, "%Y%m%dT%H%M%S")
            offset = [to for onset, to in changes if onset <= local][-1]
            dates.append((local - offset).replace(tzinfo=UTC))
        elif name == "DTSTART":
            dates.append(datetime.strptime(value, "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC))
    return dates


@pytest.mark.parametrize(
    ("zone", "start"),
    few(
        product(
            ["Europe/Berlin", "America/St_Johns", "Australia/Lord_Howe", "Asia/Tokyo", "UTC"],
            ["2026-03-01T08:00", "2026-09-20T08:00"],
        ),
        *(0, 1, 5, 8),
    ),
)
def test_local_events_are_the_dates_of_the_calendar_across_changes_of_the_clocks(zone, start, tmp_path):
    schedule = PeriodicSchedule([1.0], time_unit="h")
    text = write_ics(schedule, tmp_path / "a.ics", start, 60 * 24.0, zone=zone).read_bytes().decode()
    expected = [e.date.astimezone(UTC) for e in calendar(schedule, start, 60 * 24.0, zone=zone)]
    assert local_dates(text) == expected
    assert f"TZID:{zone}\r\n" in text


def test_an_endless_rule_keeps_its_gaps_and_a_grid_keeps_seconds(tmp_path):
    path = tmp_path / "a.ics"
    text = write_ics(DAY, path, "2026-03-28T08:00", zone="Europe/Berlin").read_text()
    assert "DTSTART:20260328T070000Z" in text
    assert "RRULE:FREQ=DAILY;INTERVAL=1" in text
    odd = PeriodicSchedule([90.0], 7.0, time_unit="s", origin="2026-01-05")
    assert "DTSTART:20260105T000010Z" in write_ics(odd, path, grid=10.0).read_text()
    with pytest.raises(ArgumentError, match=r"`grid` must be whole seconds in an iCalendar file, got 0\.5"):
        write_ics(odd, path, grid=0.5)


def test_a_date_without_an_offset_is_one_of_the_places_clocks():
    """Not of this computer's: noon in Berlin is noon there wherever it is asked."""
    place = OpeningCalendar("2026-03-28", "Europe/Berlin")
    assert place.elapsed_at(datetime(2026, 3, 28, 12)) == 720.0
    assert place.elapsed_at(datetime(2026, 3, 29, 12)) == 1440.0 + 660.0  # the clocks were put forward
    assert place.elapsed_at(datetime(2026, 3, 28, 12, tzinfo=UTC)) == 780.0
