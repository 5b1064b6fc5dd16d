"""A schedule as calendar dates: rows, CSV, and iCalendar (RFC 5545)."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.dates import parse_date, time_zone
from sampling_design.records.file_io import csv_cell, write_text
from sampling_design.records.signatures import checked
from sampling_design.records.units import SECONDS
from sampling_design.schedules.family import AnySchedule
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

_FREQUENCIES = (("WEEKLY", 604800), ("DAILY", 86400), ("HOURLY", 3600), ("MINUTELY", 60), ("SECONDLY", 1))
_FOLD = 75  # octets per line, RFC 5545 section 3.1
_MOST_ENTRIES = 100_000  # a span that asks for more is a slip of the unit


@dataclass(frozen=True)
class CalendarEntry:
    """One sample: its date (with offset), its time in the schedule's unit, and which outputs it measures."""

    date: datetime
    time: float
    outputs: tuple[str, ...]


@checked
def calendar(
    schedule: AnySchedule,
    origin: str | datetime | None = None,
    span: float | None = None,
    *,
    zone: str | None = None,
    grid: float | None = None,
) -> tuple[CalendarEntry, ...]:
    """Return the samples of a schedule as calendar dates.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        With its time unit.
    origin : str or datetime, optional
        Date of time 0 (ISO 8601; naive means in `zone`). Default: the schedule's origin.
    span : float, optional
        Samples in [0, span) [the schedule's time unit]. Default: all of a finite schedule, one period of
        a periodic one.
    zone : str, optional
        IANA name of the time zone in which dates are given. Default: the offset of `origin`, UTC if it has none.
    grid : float, optional
        Dates are rounded to whole multiples of this [s] since midnight of the day of time 0, by the clocks of `zone`:
        900 gives full quarters of an hour. Default: whole seconds, and whole microseconds where samples lie less than
        a second apart.

    Returns
    -------
    tuple of CalendarEntry
        In order of time. `outputs` is empty if the schedule names no outputs.

    Raises
    ------
    ArgumentError
        If there is no time unit or no origin, `span` is not positive, or a date lies beyond the year 9999.

    Notes
    -----
    A day has 86400 s: samples are as far apart as the schedule says, also across a change of the clocks, where a
    `zone` changes its offset instead.

    Examples
    --------
    >>> for entry in calendar(PeriodicSchedule([8.0, 16.0], 0.0, time_unit="h"), "2026-01-05"):
    ...     print(entry.date.isoformat())
    2026-01-05T00:00:00+00:00
    2026-01-05T16:00:00+00:00
    """
    zero = _zero(schedule, origin, zone)
    place = zero.tzinfo if zone is None else time_zone(zone)
    unit = SECONDS[schedule.time_unit or ""]
    part = _part(schedule, span)
    names = _columns(part)
    mask = part.outputs
    grain = _grain(schedule, grid)
    entries: list[CalendarEntry] = []
    for i, time in enumerate(part.times.tolist()):
        measured = names if mask is None else tuple(n for n, m in zip(names, mask[i], strict=True) if m)
        date = _date(zero.astimezone(place), time * unit, grain).astimezone(place)
        if entries and date.astimezone(UTC) <= entries[-1].date.astimezone(UTC):  # in one zone, clocks are compared
            raise ArgumentError(f"`grid` = {grid!r} s puts two samples at {date.isoformat()}: give a finer one.")
        entries.append(CalendarEntry(date, time, measured))
    return tuple(entries)


@checked
def write_calendar_csv(
    schedule: AnySchedule,
    path: str | os.PathLike[str],
    origin: str | datetime | None = None,
    span: float | None = None,
    *,
    zone: str | None = None,
    grid: float | None = None,
) -> Path:
    """Write `calendar(schedule, origin, span, ...)` as CSV: date, time, and per output 1 or 0; return the path.

    Parameters
    ----------
    schedule, origin, span, zone, grid
        As for `calendar`.
    path : path

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    ArgumentError
        As `calendar`.
    FileFormatError
        If the file cannot be written.
    """
    entries = calendar(schedule, origin, span, zone=zone, grid=grid)
    names = _columns(schedule)
    lines = [",".join(["date", "time", *(csv_cell(n) for n in names)])]
    for entry in entries:
        cells = ["1" if name in entry.outputs else "0" for name in names]
        lines.append(",".join([entry.date.isoformat(), repr(entry.time), *cells]))
    return write_text(path, "\n".join(lines) + "\n")


@checked
def write_ics(
    schedule: AnySchedule,
    path: str | os.PathLike[str],
    origin: str | datetime | None = None,
    span: float | None = None,
    *,
    summary: str = "Sample",
    zone: str | None = None,
    grid: float | None = None,
) -> Path:
    """Write a schedule as an iCalendar file that calendars import; return the path.

    Parameters
    ----------
    schedule, origin, span
        As for `calendar`. A periodic schedule whose period is whole seconds becomes one repeating event per
        sample of its period, without end if `span` is None; any other is written out over `span`.
    path : path
    summary : str
        Title of the events; the outputs to measure are appended.
    zone : str, optional
        IANA name of the time zone in which events are written out, its changes of the clocks included. Events that
        repeat by rule without end stay in UTC, as a rule in local time would stretch a gap when clocks change.
    grid : float, optional
        As for `calendar`, in whole seconds.

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    ArgumentError
        As `calendar`; `grid` is no whole number of seconds; or the period is none (or none of `grid`) and `span` is
        missing.
    FileFormatError
        If the file cannot be written.

    Notes
    -----
    *Numerical aspects.* Dates are UTC, or local in `zone`, rounded to whole seconds as the format asks. The same
    schedule and origin give the same file, octet for octet: DTSTAMP is the origin, UIDs are digests.

    References
    ----------
    RFC 5545.
    """
    zero, grain = _zero(schedule, origin, zone), 1.0 if grid is None else checks.positive("grid", grid)
    if grain != int(grain):
        raise ArgumentError(f"`grid` must be whole seconds in an iCalendar file, got {grid!r}.")
    rule = None
    if schedule.endless:
        rule = _rule(schedule.period * SECONDS[schedule.time_unit or ""], grain)
        if rule is None and span is None:
            raise ArgumentError(
                f"`span` is missing: the period {schedule.period!r} {schedule.time_unit} is no whole number of "
                "seconds and cannot repeat by rule."
            )
    out = not rule or (zone is not None and span is not None)
    if out:
        events = [(e, "") for e in calendar(schedule, zero, span, zone=zone, grid=grain)]
    else:
        events = _repeating(schedule, zero, span, rule or "", grain)
    stamp = _utc(zero)
    lines = ["BEGIN:VCALENDAR", "VERSION:2.0", "PRODID:-//sampling_design//schedule//EN", "CALSCALE:GREGORIAN"]
    if out and zone is not None and events:
        lines += _zone_lines(zone, events[0][0].date, events[-1][0].date)
    for entry, repeat in events:
        title = summary + (f": {', '.join(entry.outputs)}" if entry.outputs else "")
        key = f"{stamp}|{entry.time!r}|{repeat}|{title}"
        lines += [
            "BEGIN:VEVENT",
            f"UID:{hashlib.sha256(key.encode()).hexdigest()[:32]}@sampling-design",
            f"DTSTAMP:{stamp}",
            _begin(entry.date, zone if out else None),
            *([f"RRULE:{repeat}"] if repeat else []),
            f"SUMMARY:{_escaped(title)}",
            "END:VEVENT",
        ]
    lines.append("END:VCALENDAR")
    return write_text(path, "".join(_folded(line) + "\r\n" for line in lines))


def _zero(schedule: AnySchedule, origin: str | datetime | None, zone: str | None = None) -> datetime:
    if schedule.time_unit is None:
        raise ArgumentError("`schedule` must have a time unit to become dates. Give time_unit=... when you build it.")
    date = schedule.origin if origin is None else origin
    if date is None:
        raise ArgumentError("`origin` is missing, and the schedule has none. Give the date of time 0.")
    return parse_date("origin", date, zone)


def _grain(schedule: AnySchedule, grid: float | None) -> int:
    """Grid of the dates in microseconds."""
    if grid is not None:
        return max(1, round(checks.positive("grid", grid) * 1e6))
    gaps = schedule.gaps
    close = gaps.size > 0 and float(gaps.min()) * SECONDS[schedule.time_unit or ""] < 1.0
    return 1 if close else 1_000_000


def _part(schedule: AnySchedule, span: float | None) -> Schedule:
    if span is None:
        if not schedule.endless:
            return schedule
        return Schedule(schedule.times, schedule.outputs, **schedule._details())
    span = checks.positive("span", span)
    if schedule.endless and span / schedule.period * len(schedule) > _MOST_ENTRIES:
        raise ArgumentError(f"`span` = {span!r} {schedule.time_unit} asks for more than {_MOST_ENTRIES} dates.")
    return schedule.between(0.0, span, closed="left")


def _columns(schedule: AnySchedule) -> tuple[str, ...]:
    if schedule.output_names is not None or schedule.outputs is None:
        return tuple(schedule.output_names or ())
    return tuple(f"y{i + 1}" for i in range(schedule.outputs.shape[1]))


def _date(zero: datetime, seconds: float, grain: int = 1) -> datetime:
    """The date so many seconds after `zero`, in UTC: clocks that are put forward or back do not count.

    It is the nearest at which the clocks there show whole multiples of `grain` microseconds since the midnight before
    `zero`.
    """
    place, step = zero.tzinfo, timedelta(microseconds=grain)
    midnight = zero.replace(hour=0, minute=0, second=0, microsecond=0, tzinfo=None)

    def clock(date: datetime) -> datetime:
        return date.astimezone(place).replace(tzinfo=None)

    try:
        exact = zero.astimezone(UTC) + timedelta(microseconds=round(seconds * 1e6))
        over = (clock(exact) - midnight) % step
        near = [exact - over, exact - over + step]
        if clock(near[1]) - clock(near[0]) != step:  # clocks are changed in between
            shown = [clock(exact) - over + k * step for k in range(-1, 3)]
            near += [each.replace(tzinfo=place, fold=fold).astimezone(UTC) for each in shown for fold in (0, 1)]
            near = [date for date in near if not (clock(date) - midnight) % step]
        return min(near, key=lambda date: abs(date - exact))
    except OverflowError:
        raise ArgumentError(
            f"`origin` plus {seconds:.6g} s lies beyond the year 9999. Is the time unit right?"
        ) from None


def _begin(date: datetime, zone: str | None) -> str:
    """DTSTART in the zone, or in UTC: a local time that the clocks repeat means its first occurrence to a reader."""
    if zone is None or date.fold:
        return f"DTSTART:{_utc(date)}"
    return f"DTSTART;TZID={zone}:{date:%Y%m%dT%H%M%S}"


def _zone_lines(zone: str, first: datetime, last: datetime) -> list[str]:
    """VTIMEZONE: the offset at the first date, and each change of it until the last."""
    begin = first.astimezone(time_zone(zone))
    lines = ["BEGIN:VTIMEZONE", f"TZID:{zone}", *_observance(begin, begin)]
    for before, after in clock_changes(zone, first, last):
        lines += _observance(before, after)
    return [*lines, "END:VTIMEZONE"]


def clock_changes(zone: str, first: datetime, last: datetime) -> Iterator[tuple[datetime, datetime]]:
    """Each change of a zone's offset between two dates: the last second before it, and the first after it."""
    place, second = time_zone(zone), timedelta(seconds=1)
    now, end = first.astimezone(UTC), last.astimezone(UTC)
    while now < end:
        later = min(now + timedelta(days=1), end)
        if later.astimezone(place).utcoffset() != now.astimezone(place).utcoffset():
            before, after = now, later
            while after - before > second:
                middle = before + ((after - before) // 2 // second or 1) * second
                same = middle.astimezone(place).utcoffset() == now.astimezone(place).utcoffset()
                before, after = (middle, after) if same else (before, middle)
            yield before.astimezone(place), after.astimezone(place)
        now = later


def _observance(before: datetime, after: datetime) -> list[str]:
    """One offset and when it begins, in the local time of the offset before it."""
    kind = "DAYLIGHT" if after.dst() else "STANDARD"
    return [
        f"BEGIN:{kind}",
        f"DTSTART:{after.astimezone(timezone(before.utcoffset() or timedelta(0))):%Y%m%dT%H%M%S}",
        f"TZOFFSETFROM:{before:%z}",
        f"TZOFFSETTO:{after:%z}",
        f"TZNAME:{after:%Z}",
        f"END:{kind}",
    ]


def _repeating(
    schedule: AnySchedule, zero: datetime, span: float | None, rule: str, grain: float
) -> list[tuple[CalendarEntry, str]]:
    """Each sample of the period with its rule; with a span, only those that begin in it, repeated until its end."""
    unit = SECONDS[schedule.time_unit or ""]
    cycle = calendar(schedule, zero, grid=grain)
    if span is None:
        return [(entry, rule) for entry in cycle]
    # UNTIL is inclusive and whole seconds, the span half-open
    last = _date(zero, checks.positive("span", span) * unit) - timedelta(seconds=1)
    return [(entry, f"{rule};UNTIL={_utc(last)}") for entry in cycle if entry.time < span]


def repeats_by_rule(schedule: PeriodicSchedule) -> bool:
    """Whether the period is whole seconds, so that a calendar can repeat it without end."""
    assert schedule.time_unit is not None
    return _rule(schedule.period * SECONDS[schedule.time_unit or ""], 1.0) is not None


def _rule(seconds: float, grain: float) -> str | None:
    whole = round(seconds)
    if whole < 1 or whole % grain or abs(seconds - whole) > 1e-9 * whole:
        return None
    for name, length in _FREQUENCIES:
        if whole % length == 0:
            return f"FREQ={name};INTERVAL={whole // length}"
    return None


def _utc(date: datetime) -> str:
    whole = (date.astimezone(UTC) + timedelta(microseconds=500_000)).replace(microsecond=0)
    return whole.strftime("%Y%m%dT%H%M%SZ")


def _escaped(text: str) -> str:
    escaped = str.maketrans({"\\": "\\\\", ";": "\\;", ",": "\\,", "\n": "\\n", "\r": "\\n"})
    return text.replace("\r\n", "\n").translate(escaped)


def _folded(line: str) -> str:
    """Break a line after at most 75 octets, never inside a character; the rest begins with a space."""
    pieces, current = [], ""
    for character in line:
        if len((current + character).encode()) > _FOLD:
            pieces.append(current)
            current = " "
        current += character
    return "\r\n".join([*pieces, current])
