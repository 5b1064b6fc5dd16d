"""Measured time stamps become a schedule: numbers or calendar dates, from a CSV file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

import numpy as np

from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.records import checks
from sampling_design.records.file_io import csv_rows, decimal, read_text
from sampling_design.records.signatures import checked
from sampling_design.records.units import SECONDS, check_time_unit
from sampling_design.schedules.files import in_file
from sampling_design.schedules.schedule import Schedule

MISSING = ("", "-", "--", "nan", "na", "n/a", "nat", "null", "none")  # how programs write that nothing was measured
MICROSECONDS = 1_000_000  # of a second: dates are exact to one


@checked
def import_time_stamps(
    path: str | os.PathLike[str],
    time_unit: str,
    origin: str | datetime | None = None,
    column: str | None = None,
    outputs: Sequence[str] | None = None,
) -> Schedule:
    """Return the schedule at which something was measured.

    Parameters
    ----------
    path : path
        CSV with a header; lines that begin with `#` are comments.
    time_unit : str
        Unit of the schedule, and of the column if it holds numbers.
    origin : str or datetime, optional
        Date of time 0 (ISO 8601; naive means UTC). Default, if the column holds dates: the first of them.
    column : str, optional
        Which column holds the times. Default `time`, else `date`. Numbers count as times in `time_unit`,
        anything else must be ISO 8601 (naive means UTC, offsets are honoured).
    outputs : sequence of str, optional
        Columns of measured values: a cell that is not empty (nor nan, NA, null, a dash) says that this output was
        measured; a row without any is left out. Default: every row is a sample of every output.

    Returns
    -------
    Schedule
        With `origin` as ISO date, where there is one.

    Raises
    ------
    ArgumentError
        If `time_unit` or `origin` is not understood.
    FileFormatError
        If the column is missing, or a cell is no time, comes before `origin`, or is not later than the one
        before; the message names the line.

    Notes
    -----
    *Numerical aspects.* Dates are subtracted as whole microseconds before they are divided by the unit.
    """
    check_time_unit(time_unit)
    zero = None if origin is None else parse_date("origin", origin)
    where = os.fspath(path)
    header, rows = _table(read_text(path), where)
    name = _column(header, column, where)
    for output in outputs or ():
        if output not in header:
            raise FileFormatError(f"{where}: no column {output!r}; there are {', '.join(header)}.", where)
    for used in (name, *(outputs or ())):
        if header.count(used) > 1:
            raise FileFormatError(f"{where}: column {used!r:.60} occurs twice.", where)
    times: list[float] = []
    mask: list[list[bool]] = []
    for line, row in rows:
        measured = [row[header.index(o)].strip().lower() not in MISSING for o in outputs or ()]
        if outputs and not any(measured):
            continue
        value, zero = _value(row[header.index(name)].strip(), zero, time_unit, name == "date", f"{where}, line {line}")
        if times and value <= times[-1]:
            raise FileFormatError(f"{where}, line {line}: times must increase strictly, got one not later.", where)
        times.append(value)
        mask.append(measured)
    names = tuple(outputs) if outputs else None
    date = None if zero is None else zero.isoformat()
    chosen = np.array(mask, dtype=bool) if outputs and times else None
    return Schedule(np.array(times), chosen, time_unit=time_unit, origin=date, output_names=names)


def zoned_date(text: str) -> datetime:
    """Return an ISO 8601 date; a zone behind it in brackets says whose clocks tell it (RFC 9557).

    Raises ValueError if it is no such date, ArgumentError if there is no such zone, or its clocks skip or repeat it.
    """
    stem, bracket, zone = text.partition("[")
    date = datetime.fromisoformat(stem if zone.endswith("]") else text)
    if not bracket:
        return date
    place = time_zone(zone[:-1])
    if date.tzinfo is None and not unambiguous(date, place):
        raise ArgumentError(f"{text} is skipped or repeated by the clocks of {place}: give its offset.")
    return date.replace(tzinfo=place) if date.tzinfo is None else date.astimezone(place)


def unambiguous(date: datetime, place: tzinfo) -> bool:
    """Whether clocks there show this local date exactly once: they neither skip nor repeat it."""
    early, late = (date.replace(tzinfo=place, fold=fold).utcoffset() for fold in (0, 1))
    return early == late


def zoned_text(date: datetime) -> str:
    """Return a date as `zoned_date` reads it: with its zone, where that has a name and its clocks may change."""
    named = isinstance(date.tzinfo, ZoneInfo) and date.tzinfo.key != "UTC"
    return date.isoformat() + (f"[{date.tzinfo}]" if named else "")


def date_after(zero: datetime, seconds: float) -> datetime:
    """Return the date so much real time after another one with an offset, by the clocks of its zone.

    Raises OverflowError if it lies outside the years 1 to 9999.
    """
    return (zero.astimezone(UTC) + timedelta(microseconds=round(seconds * MICROSECONDS))).astimezone(zero.tzinfo)


def parse_date(name: str, value: str | datetime, zone: str | None = None) -> datetime:
    """Return an ISO 8601 date with its offset; naive means in `zone` (its IANA name), by default UTC.

    Raises ArgumentError if it is no such date, there is no such zone, or the zone's clocks skip or repeat it.
    """
    date = None
    try:
        date = value if isinstance(value, datetime) else zoned_date(value)
    except ArgumentError as error:
        raise ArgumentError(f"`{name}` names no instant: {error}") from None
    except (TypeError, ValueError, AttributeError):
        pass
    if date is None or date != date:  # pandas counts its missing date among dates
        came = repr(value)[:60] if is_text(value) else checks.described(value)
        raise ArgumentError(f"`{name}` must be a date like 2026-01-05T08:00 (ISO 8601), got {came}.")
    if date.tzinfo is not None or zone is None:
        return date.replace(tzinfo=UTC) if date.tzinfo is None else date
    place = time_zone(zone)
    if not unambiguous(date, place):
        raise ArgumentError(f"`{name}` = {value} is skipped or repeated by the clocks of {zone}: give its offset.")
    return date.replace(tzinfo=place)


def passed(since: datetime, date: datetime) -> timedelta:
    """The real time between two dates with offsets; of two in one zone, Python subtracts what the clocks show."""
    return date.astimezone(UTC) - since.astimezone(UTC)


def time_zone(zone: str) -> ZoneInfo:
    """Return a time zone by its IANA name. Raises ArgumentError if there is none of that name."""
    try:
        return ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, TypeError, OSError):
        city = f"/{zone}".replace(" ", "_").casefold()
        near = [name for name in sorted(available_timezones()) if name.casefold().endswith(city)]
        raise ArgumentError(
            f"`zone` must be the name of a time zone like Europe/Berlin, got {zone!r}."
            + (f" Did you mean {near[0]!r}?" if near else "")
        ) from None


def _table(text: str, where: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1)]
    lines = [(n, line) for n, line in lines if line.strip() and not line.startswith("#")]
    if not lines:
        raise FileFormatError(f"{where}: is empty, expected a header and rows.", where)
    (_, header), *rows = csv_rows(lines, where)
    for n, row in rows:
        if len(row) != len(header):
            raise FileFormatError(
                f"{where}, line {n}: expected {len(header)} cells, got {len(row)}. Was the file cut off?", where
            )
    return header, rows


def _column(header: list[str], column: str | None, where: str) -> str:
    wanted = ("time", "date") if column is None else (column,)
    for name in wanted:
        if name in header:
            return name
    raise FileFormatError(f"{where}: no column {' or '.join(map(repr, wanted))}; there are {', '.join(header)}.", where)


def _value(cell: str, zero: datetime | None, unit: str, is_date: bool, where: str) -> tuple[float, datetime | None]:
    """Time of one cell, and the origin, which the first date sets if nothing else has."""
    if not is_date:
        number = decimal(cell)
        if cell.lower().lstrip("+-") in ("nan", "inf", "infinity") or (number or 0.0) < 0:
            raise FileFormatError(f"{where}: a time must be finite and not negative, got {cell:.60}.", where)
        if number is not None:
            return number, zero
    try:
        date = parse_date("date", cell)
    except ArgumentError as error:
        raise in_file(error, where) from None
    zero = date if zero is None else zero
    apart = passed(zero, date)
    micro = (apart.days * 86400 + apart.seconds) * MICROSECONDS + apart.microseconds
    if micro < 0:
        raise FileFormatError(f"{where}: {cell} comes before the origin {zero.isoformat()}.", where)
    return micro / (MICROSECONDS * SECONDS[unit]), zero
