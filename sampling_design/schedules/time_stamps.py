"""Measured time stamps become a schedule: numbers or calendar dates, from a CSV file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import datetime

import numpy as np

from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.records.dates import MICROSECONDS, parse_date, passed
from sampling_design.records.file_io import csv_rows, decimal, read_text
from sampling_design.records.signatures import checked
from sampling_design.records.units import SECONDS, check_time_unit
from sampling_design.schedules.files import in_file
from sampling_design.schedules.schedule import Schedule

MISSING = ("", "-", "--", "nan", "na", "n/a", "nat", "null", "none")  # how programs write that nothing was measured


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
