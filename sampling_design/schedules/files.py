"""Schedules as files: CSV and its exact copy in JSON. Families of schedules as plain data, one kind per family."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sampling_design.checkers import family_file, schedule_file
from sampling_design.checkers.strict import anything, is_text
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.records import checks, file_io
from sampling_design.records.file_io import (
    csv_cell,
    csv_rows,
    decimal,
    exactly,
    from_json,
    read_text,
    to_json,
    write_text,
)
from sampling_design.records.signatures import checked
from sampling_design.records.units import check_time_unit
from sampling_design.schedules.family import AnySchedule, SamplingFamily
from sampling_design.schedules.gap_range import GapRange  # noqa: F401  # a family is known once its file is loaded
from sampling_design.schedules.jitter import Jitter  # noqa: F401
from sampling_design.schedules.lost_samples import LostSamples  # noqa: F401
from sampling_design.schedules.output_jitter import OutputJitter  # noqa: F401
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule, ScheduleDetails
from sampling_design.schedules.spaced_windows import SpacedWindows  # noqa: F401


@checked
def family_from_dict(data: Mapping[str, Any]) -> SamplingFamily:
    """Return the family in plain data.

    Parameters
    ----------
    data : mapping
        `kind` ("spaced-windows", "gap-range", "jitter", "output-jitter", "lost-samples") and the arguments of
        that family.

    Returns
    -------
    SamplingFamily

    Raises
    ------
    ArgumentError
        If `kind` or a key is unknown, a key is missing, or the family refuses a value.

    Examples
    --------
    >>> family_from_dict({"kind": "gap-range", "shortest": 0.5, "longest": 1.5})
    GapRange(shortest_gap=0.5, longest_gap=1.5)
    """
    kind = data.get("kind")
    if not is_text(kind) or kind not in SamplingFamily.KINDS:
        known = ", ".join(sorted(SamplingFamily.KINDS))
        raise ArgumentError(f"`kind` of a family must be one of {known}, got {kind!r}.")
    build = SamplingFamily.KINDS[kind]
    given = [field for field in fields(build) if field.init]  # type: ignore[arg-type]  # every kind is a dataclass
    needed = [field.name for field in given if field.default is MISSING]
    optional = [field.name for field in given if field.default is not MISSING]
    checks.known_keys(f"a family of kind {kind!r}", data, ("kind", *needed, *optional))
    missing = [key for key in needed if key not in data]
    if missing:
        raise ArgumentError(f"a family of kind {kind!r} needs `{missing[0]}`.")
    exactly(family_file.family if kind in family_file.FAMILIES else anything, data)
    values = {key: data[key] for key in (*needed, *optional) if key in data}
    if "schedule" in values:
        values["schedule"] = schedule_from_dict(values["schedule"])
    return build(**values)


FORMAT = "sampling-design/schedule/1"
MARK = "# sampling-design schedule"
_DETAILS = ("time_unit", "origin", "output_names")
_REDUNDANCY = 1e-9  # gaps and times of one file may differ by this fraction of the period, no more


@checked
def schedule_from_dict(data: Mapping[str, Any]) -> AnySchedule:
    """Return the schedule in plain data, every float to the last bit.

    Parameters
    ----------
    data : mapping
        `kind` "finite" with `times`, or "periodic" with `gaps` (and `first`) or `times` and `period` or
        both; `outputs`, `time_unit`, `origin`, `output_names` optional.

    Returns
    -------
    Schedule or PeriodicSchedule

    Raises
    ------
    ArgumentError
        If a key is unknown or missing, gaps and times contradict each other, or a value is refused by the schedule.

    Examples
    --------
    >>> schedule_from_dict({"kind": "periodic", "gaps": [1.0, 2.0]}).times
    array([1., 3.])
    """
    kind = data.get("kind")
    details = {key: data[key] for key in _DETAILS if key in data}
    outputs = data.get("outputs")
    if kind == "finite":
        checks.known_keys("a finite schedule", data, ("kind", "times", "outputs", *_DETAILS))
        if "times" not in data:
            raise ArgumentError("a finite schedule needs `times`.")
        file_io.exactly(schedule_file.FINITE, data)
        return Schedule(data["times"], outputs, **details)
    if kind != "periodic":
        raise ArgumentError(f'`kind` of a schedule must be "finite" or "periodic", got {kind!r}.')
    known = ("kind", "gaps", "first", "times", "period", "outputs", *_DETAILS)
    checks.known_keys("a periodic schedule", data, known)
    if ("times" in data) != ("period" in data):
        raise ArgumentError("a periodic schedule needs `times` and `period` together, got only one of them.")
    file_io.exactly(schedule_file.PERIODIC, data)
    if "gaps" not in data:
        if "times" not in data:
            raise ArgumentError("a periodic schedule needs `gaps`, or `times` and `period`.")
        return PeriodicSchedule.from_times(data["times"], data["period"], outputs, **details)
    by_gaps = PeriodicSchedule(data["gaps"], data.get("first"), outputs, **details)
    if "times" not in data:
        return by_gaps
    by_times = PeriodicSchedule.from_times(data["times"], data["period"], outputs, **details)
    room = _REDUNDANCY * by_times.period
    if len(by_gaps) != len(by_times) or any(
        not np.allclose(a, b, rtol=0, atol=room)
        for a, b in ((by_gaps.gaps, by_times.gaps), (by_gaps.times, by_times.times))
    ):
        raise ArgumentError("`gaps` and `times` of a periodic schedule contradict each other. Give one of them.")
    by_times._own(gaps=by_gaps.gaps)
    return by_times


@checked
def write_schedule(schedule: AnySchedule, path: str | os.PathLike[str]) -> Path:
    """Write a schedule as `.csv` or `.json`, whole or not at all, and return the path.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        With its time unit.
    path : path
        The ending chooses the format.

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    ArgumentError
        If the ending is unknown, the time unit is missing, or an output's name cannot be a column.
    FileFormatError
        If the file cannot be written.

    Notes
    -----
    *Numerical aspects.* Floats are written as their shortest exact text. CSV keeps times and period of a
    periodic schedule to the last bit and its gaps as their differences; JSON keeps all of them.
    """
    if schedule.time_unit is None:
        raise ArgumentError("`schedule` must have a time unit to be written. Give time_unit=... when you build it.")
    if _ending(path) == ".json":
        return write_text(path, to_json({"format": FORMAT, **schedule.to_dict()}))
    return write_text(path, _to_csv(schedule))


@checked
def read_schedule(path: str | os.PathLike[str]) -> AnySchedule:
    """Return the schedule in a `.csv` or `.json` file.

    Parameters
    ----------
    path : path
        The ending says which format it is.

    Returns
    -------
    Schedule or PeriodicSchedule
        Periodic if the file names a period.

    Raises
    ------
    ArgumentError
        If the ending is unknown.
    FileFormatError
        If the file is missing, cut off, not of this format, has no time unit, an unknown key, or a row that
        does not fit; the message names the line.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from sampling_design import PeriodicSchedule
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_schedule(PeriodicSchedule([2.0, 1.0], time_unit="h"), pathlib.Path(folder) / "times.csv")
    ...     found = read_schedule(path)
    >>> found.times, found.period
    (array([2., 3.]), 3.0)
    """
    where = os.fspath(path)
    if Path(path).suffix and not Path(path).exists():
        read_text(path)  # says so, and what may have been meant
    ending = _ending(path)
    text = read_text(path)
    if ending == ".csv":
        return _from_csv(text, where)
    data = from_json(text, where)
    if data.pop("format", None) != FORMAT:
        raise FileFormatError(f'{where}: `format` must be "{FORMAT}".', where)
    if "time_unit" not in data:
        raise FileFormatError(f"{where}: `time_unit` is missing.", where)
    try:
        return schedule_from_dict(data)
    except ArgumentError as error:
        raise in_file(error, where) from None


def in_file(error: ArgumentError, where: str, line: int | None = None) -> FileFormatError:
    """Return what a record refused as an error of the file that it was read from."""
    return FileFormatError(f"{where}{'' if line is None else f', line {line}'}: {error}", where)


def _ending(path: str | os.PathLike[str]) -> str:
    ending = Path(path).suffix.lower()
    if ending not in (".csv", ".json"):
        raise ArgumentError(f"`path` must end in .csv or .json, got {os.fspath(path)!r}.")
    return ending


def _to_csv(schedule: AnySchedule) -> str:
    head = [MARK, f"time_unit={schedule.time_unit}"]
    if schedule.endless:
        head.append(f"period={schedule.period!r}")
    if schedule.origin is not None:
        head.append(f"origin={schedule.origin}")
    mask = schedule.outputs
    names = schedule.output_names
    if mask is not None and names is None:
        names = _nameless(mask.shape[1])
    for name in schedule.output_names or ():
        if not file_io.is_column(name, "time") or name.startswith("#"):
            raise ArgumentError(f"`output_names`: {name!r} cannot be a column of a CSV file. Write .json instead.")
    if mask is None:
        mask = np.ones((len(schedule), len(names or ())), dtype=bool)
    rows = [
        ",".join([repr(t), *("1" if m else "0" for m in measured)])
        for t, measured in zip(schedule.times.tolist(), mask.tolist(), strict=True)
    ]
    return "\n".join(["; ".join(head), ",".join(["time", *map(csv_cell, names or ())]), *rows]) + "\n"


def _from_csv(text: str, where: str) -> AnySchedule:
    def fail(line: int, what: str) -> FileFormatError:
        return FileFormatError(f"{where}, line {line}: {what}", where)

    lines = text.split("\n")
    if not lines[0].startswith(MARK):
        raise fail(1, f'must begin with "{MARK}; time_unit=...". Measured times are read by import_time_stamps.')
    keys = _header(lines[0], where)
    if len(lines) < 2 or not lines[1].strip():
        raise fail(2, "expected the header `time[,output names]`. Was the file cut off?")
    body = [(n, line) for n, line in enumerate(lines[1:], 2) if n == 2 or (line.strip() and not line.startswith("#"))]
    rows = csv_rows(body, where)
    header = rows[0][1]
    if header[0] != "time":
        raise fail(2, f"the first column must be `time`, got {header[0]!r:.60}.")
    if "" in header or "time" in header[1:]:
        raise fail(2, f"{'an output has no name' if '' in header else 'the column `time` occurs twice'}.")
    if lines[-1] != "":
        raise fail(len(lines), "does not end in a line break. Was the file cut off?")
    times: list[float] = []
    mask: list[list[int]] = []
    for number, cells in rows[1:]:
        if len(cells) != len(header):
            raise fail(number, f"expected {len(header)} cells, got {len(cells)}. Was the file cut off?")
        times.append(_time(cells[0], times, partial(fail, number)))
        if any(cell not in ("0", "1") for cell in cells[1:]):
            raise fail(number, f"cells after the time must be 1 (measured) or 0, got {', '.join(cells[1:]):.60}.")
        mask.append([int(cell) for cell in cells[1:]])
    return _build(times, mask, header[1:], keys, where)


def _nameless(count: int) -> tuple[str, ...]:
    """Columns of outputs that have no names, as none that has one can be called: they fit outputs of any names."""
    return tuple(f"#{i + 1}" for i in range(count))


def _time(cell: str, before: list[float], fail: Callable[[str], Exception]) -> float:
    value = decimal(cell)
    if value is None:
        raise fail(f"the time must be a finite number, got {cell!r:.60}.")
    if value < 0:
        raise fail(f"the time must not be negative, got {cell:.60}.")
    if before and value <= before[-1]:
        raise fail(f"times must increase strictly, got {value!r} after {before[-1]!r}.")
    return value


def _header(line: str, where: str) -> dict[str, str]:
    keys: dict[str, str] = {}
    for part in line[len(MARK) :].split(";"):
        key, equals, value = part.strip().partition("=")
        if not key:
            continue
        try:
            checks.known_keys("the first line", [key], ("time_unit", "period", "origin"))
        except ArgumentError as error:
            raise in_file(error, where, 1) from None
        if not equals or not value.strip() or key in keys:
            raise FileFormatError(f"{where}, line 1: expected {key}=... exactly once.", where)
        keys[key] = value.strip()
    if "time_unit" not in keys:
        raise FileFormatError(f"{where}, line 1: `time_unit` is missing.", where)
    return keys


def _build(
    times: list[float], mask: list[list[int]], names: list[str], keys: dict[str, str], where: str
) -> AnySchedule:
    try:
        check_time_unit(keys["time_unit"])
        every = not names or all(all(row) for row in mask)
        outputs = None if every else np.array(mask, dtype=bool)
        details = ScheduleDetails(
            time_unit=keys["time_unit"],
            origin=keys.get("origin"),
            output_names=None if tuple(names) == _nameless(len(names)) else tuple(names),
        )
        if "period" not in keys:
            return Schedule(np.array(times), outputs, **details)
        period = decimal(keys["period"])
        if period is None:
            raise ArgumentError(f"`period` must be a number, got {keys['period']!r:.60}.")
        return PeriodicSchedule.from_times(times, period, outputs, **details)
    except ArgumentError as error:
        raise in_file(error, where) from None
