"""Measured time stamps become a schedule: numbers or calendar dates, from a CSV file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime, tzinfo

import numpy as np

from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.records.dates import MICROSECONDS, UnmixedDates, date_in, passed, time_zone, zoned_date, zoned_text
from sampling_design.records.file_io import MISSING, csv_rows, decimal, has_cells, read_text
from sampling_design.records.signatures import checked
from sampling_design.records.units import SECONDS, check_time_unit
from sampling_design.schedules.files import in_file
from sampling_design.schedules.schedule import Schedule


@checked
def import_time_stamps(
    path: str | os.PathLike[str],
    time_unit: str,
    origin: str | datetime | None = None,
    column: str | None = None,
    outputs: Sequence[str] | None = None,
    *,
    zone: str | None = None,
) -> Schedule:
    """Return the schedule at which something was measured.

    Parameters
    ----------
    path : path
        CSV with a header; lines that begin with `#` are comments.
    time_unit : str
        Unit of the schedule, and of the column if it holds numbers.
    origin : str or datetime, optional
        Date of time 0 (ISO 8601). Default, if the column holds dates: the first of them.
    column : str, optional
        Which column holds the times. Default `time`, else `date`. Numbers count as times in `time_unit`,
        anything else must be ISO 8601 (offsets are honoured).
    outputs : sequence of str, optional
        Columns of measured values: a cell that is not empty (nor nan, NA, null, a dash) says that this output was
        measured; a row without any is left out. Default: every row is a sample of every output.
    zone : str, optional
        IANA name of the zone of dates without one, that of `origin` too. Default: the offset of `origin`, else UTC,
        if no date has a zone. `assumed_zone` of the schedule tells.

    Returns
    -------
    Schedule
        With `origin` as ISO date, where there is one.

    Raises
    ------
    ArgumentError
        If `time_unit` or `origin` is not understood, or there is no zone of that name.
    FileFormatError
        If the column is missing, or a cell is no time, comes before `origin`, is not later than the one
        before, or is a date without a zone that its clocks skip or repeat, or that stands beside one with a zone; the
        message names the line.

    Notes
    -----
    *Numerical aspects.* Dates are subtracted as whole microseconds before they are divided by the unit.
    """
    check_time_unit(time_unit)
    place: tzinfo = UTC if zone is None else time_zone(zone)
    zero = None if origin is None else date_in("origin", origin, place)
    naive, unmixed = origin is not None and _naive(origin), UnmixedDates(said=zone is not None)
    if origin is not None:
        unmixed.take(zoned_date(f"{origin}"), "`origin`")
        unmixed.said |= not naive
    place = zero.tzinfo or place if zone is None and zero is not None else place
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
        cell, here = row[header.index(name)].strip(), f"{where}, line {line}"
        value = None if name == "date" else _number(cell, here)
        if value is None:
            date = _date(cell, place, here)
            try:
                unmixed.take(zoned_date(cell), f"line {line}")
            except ArgumentError as error:
                raise in_file(error, where) from None
            zero, naive = date if zero is None else zero, naive or _naive(cell)
            value = _since(zero, date, time_unit, cell, here)
        if times and value <= times[-1]:
            raise FileFormatError(f"{where}, line {line}: times must increase strictly, got one not later.", where)
        times.append(value)
        mask.append(measured)
    names = tuple(outputs) if outputs else None
    first = None if zero is None else zoned_text(zero)
    chosen = np.array(mask, dtype=bool) if outputs and times else None
    assumed = str(place) if naive else ""
    return Schedule(
        np.array(times), chosen, time_unit=time_unit, origin=first, output_names=names, assumed_zone=assumed
    )


def _table(text: str, where: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1)]
    lines = [(n, line) for n, line in lines if has_cells(line)]
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


def _naive(date: str | datetime) -> bool:
    """Whether a date that was read names no zone of its own."""
    return zoned_date(f"{date}").tzinfo is None


def _number(cell: str, where: str) -> float | None:
    """The number in a cell; None where there is none."""
    number = decimal(cell)
    if cell.lower().lstrip("+-") in ("nan", "inf", "infinity") or (number or 0.0) < 0:
        raise FileFormatError(f"{where}: a time must be finite and not negative, got {cell:.60}.", where)
    return number


def _date(cell: str, place: tzinfo, where: str) -> datetime:
    """The date in a cell, by the clocks of a place where it names no zone."""
    try:
        return date_in("date", cell, place)
    except ArgumentError as error:
        raise in_file(error, where) from None


def _since(zero: datetime, date: datetime, unit: str, cell: str, where: str) -> float:
    """Time of a date, counted from the origin."""
    apart = passed(zero, date)
    micro = (apart.days * 86400 + apart.seconds) * MICROSECONDS + apart.microseconds
    if micro < 0:
        raise FileFormatError(f"{where}: {cell} comes before the origin {zero.isoformat()}.", where)
    return micro / (MICROSECONDS * SECONDS[unit])
