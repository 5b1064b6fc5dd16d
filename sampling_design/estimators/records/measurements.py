"""Measurement files: time stamps with what was measured and what was applied; and files of estimates."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from sampling_design import _checks, _files
from sampling_design._door import door
from sampling_design._record import Record, short
from sampling_design._units import SECONDS
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.plants.plant import Plant, Signals

Array = npt.NDArray[np.float64]


@runtime_checkable
class Measured(Protocol):
    """What a file of measurements needs of a plant, linear or not."""

    @property
    def name(self) -> str: ...
    @property
    def time_unit(self) -> str: ...
    @property
    def outputs(self) -> Signals: ...
    @property
    def inputs(self) -> Signals: ...
    @property
    def n_outputs(self) -> int: ...
    @property
    def n_inputs(self) -> int: ...


@runtime_checkable
class DataFrame(Protocol):
    """What is asked of a pandas DataFrame, so that reading one needs no pandas here."""

    index: Any

    def reset_index(self) -> DataFrame: ...
    def to_csv(self, *, index: bool) -> str: ...


@dataclass(frozen=True, eq=False, repr=False)
class Measurements(Record):
    """Rows of a measurement file, in the order in which they came.

    Parameters
    ----------
    plant : Plant
    times : (N,) array [the plant's time unit]
    y : (N, p) array
        NaN where not measured.
    u : (N, m) array, optional
        Inputs from each time on; NaN where unchanged. Default: none given.
    origin : str
        Date (ISO 8601) of time 0, if known.

    Raises
    ------
    ArgumentError
        If shapes differ or a time, an output or an input is infinite.

    Notes
    -----
    Iterating yields (t, y, u) as an estimator's `run` and `stream` take them; y is None in a row that only
    reports an input, u is None where nothing changes.
    """

    plant: Measured
    times: Array
    y: Array
    u: Array = None  # type: ignore[assignment]
    origin: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.plant, Measured):
            raise ArgumentError(f"`plant` must be a Plant, got {_checks.described(self.plant)}.")
        times = _checks.vector("times", self.times)
        shapes = {"y": (self.y, self.plant.n_outputs), "u": (self.u, self.plant.n_inputs)}
        owned = {"times": times}
        for key, (value, width) in shapes.items():
            blank = np.full((times.size, width), np.nan)
            array = blank if value is None else _checks.floats(key, value)
            if array.shape != blank.shape or np.isinf(array).any():
                raise ArgumentError(f"`{key}` must be finite or NaN of shape {blank.shape}, got shape {array.shape}.")
            array.flags.writeable = False
            owned[key] = array
        for key, held in owned.items():
            object.__setattr__(self, key, held)

    def __len__(self) -> int:
        return self.times.size

    def __iter__(self) -> Iterator[tuple[float, Array | None, Array | None]]:
        for k in range(len(self)):
            measured, applied = ~np.isnan(self.y[k]).all(), self.u.shape[1] > 0 and not np.isnan(self.u[k]).all()
            yield float(self.times[k]), self.y[k] if measured else None, self.u[k] if applied else None

    def _rows(self) -> list[tuple[str, str]]:
        counts = np.sum(~np.isnan(self.y), axis=0)
        per_output = ", ".join(f"{n}: {c}" for n, c in zip(self.plant.outputs.names, counts, strict=True))
        span = f"{short(self.times.min())} to {short(self.times.max())} {self.plant.time_unit}" if len(self) else "-"
        return [("rows", str(len(self))), ("time", span), ("measured", per_output), ("origin", self.origin or "-")]

    def explain(self) -> str:
        """Say what was measured."""
        return f"{len(self)} rows of measurements of {self.plant.name or 'a plant'}; " + self._rows()[2][1] + "."


@door
def read_measurements(
    path: str | os.PathLike[str] | DataFrame, plant: Plant | Measured, *, origin: str | None = None
) -> Measurements:
    """Return the measurements in a CSV file, or in a pandas DataFrame with the same columns.

    Parameters
    ----------
    path : path or DataFrame
        Header `time` (in the plant's time unit) or `date` (ISO 8601; naive means UTC), then the plant's
        output names, then its input names, in any order. An empty output cell is "not measured", an empty input cell
        "unchanged". Lines that start with # are comments. Of a
        frame, `time` or `date` may be the index, and NaN is what an empty cell is.
    plant : Plant
    origin : str, optional
        Date of time 0 in a file of dates. Default: the date of the first row.

    Returns
    -------
    Measurements

    Raises
    ------
    FileFormatError
        If a column is missing, unknown or repeated, a row has another number of cells, a cell is no number or no date,
        an input has no value in the first row, a row holds nothing, or a time comes twice with different values.
    """
    where, text = _text_of(path)
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if _counts(line)]
    if not lines:
        raise FileFormatError(f"{where}: is empty, expected a header line.", where)
    rows = _files.csv_rows(lines, where)
    header = rows[0][1]
    stamp = _check_header(where, header, plant)
    clock = _Clock(where, plant, None if origin is None else date_of(where, 0, origin))
    table = _MeasurementTable(where, plant)
    for k, cells in rows[1:]:
        if len(cells) != len(header):
            raise FileFormatError(f"{where}: line {k} has {len(cells)} cells, expected {len(header)}.", where)
        cell = dict(zip(header, cells, strict=True))
        table.add(k, clock.date(k, cell["date"]) if stamp == "date" else _number(where, k, "time", cell["time"]), cell)
    p, m = plant.n_outputs, plant.n_inputs
    known = "" if stamp == "time" or clock.zero is None else clock.zero.isoformat()
    return Measurements(
        plant,
        np.array(table.times),
        np.reshape(table.y, (len(table.times), p)),
        np.reshape(table.u, (len(table.times), m)),
        origin=known,
    )


def _text_of(source: str | os.PathLike[str] | DataFrame) -> tuple[str, str]:
    """Name and text of a file; of a frame the text that its file would have, so that both are read by one grammar."""
    if isinstance(source, str | os.PathLike):
        return os.fspath(source), _files.read_text(source)
    columns = source.reset_index() if source.index.name in ("time", "date") else source
    return "the frame", str(columns.to_csv(index=False))


class _Clock:
    """Turns dates into times since the origin, by default the first date seen."""

    def __init__(self, where: str, plant: Measured, zero: datetime | None):
        self.where, self.unit, self.zero = where, SECONDS[plant.time_unit], zero

    def date(self, line: int, cell: str) -> float:
        date = date_of(self.where, line, cell)
        self.zero = date if self.zero is None else self.zero
        return (date - self.zero).total_seconds() / self.unit


class _MeasurementTable:
    """Rows that were read so far; a time may come twice if the rows agree."""

    def __init__(self, where: str, plant: Measured):
        self.where, self.plant = where, plant
        self.times: list[float] = []
        self.y: list[list[float]] = []
        self.u: list[list[float]] = []
        self._seen: dict[float, tuple[int, tuple[float, ...]]] = {}

    def add(self, line: int, t: float, cell: dict[str, str]) -> None:
        outputs = [_number(self.where, line, name, cell[name], blank=True) for name in self.plant.outputs.names]
        inputs = [_number(self.where, line, name, cell[name], blank=True) for name in self.plant.inputs.names]
        if inputs:
            inputs = _held(self.where, line, inputs, self.u[-1] if self.u else None, self.plant)
        if np.isnan(outputs).all() and not inputs:
            raise FileFormatError(f"{self.where}: line {line} measures nothing. Leave a lost sample out.", self.where)
        content = (*outputs, *inputs)
        if t in self._seen:
            _check_twin(self.where, line, content, self._seen[t])
            return
        self._seen[t] = (line, content)
        self.times.append(t)
        self.y.append(outputs)
        self.u.append(inputs)


def _counts(line: str) -> bool:
    text = line.strip()
    return bool(text) and not text.startswith("#")


def _check_header(where: str, header: list[str], plant: Measured) -> str:
    stamps = [name for name in ("time", "date") if name in header]
    if len(stamps) != 1:
        raise FileFormatError(f"{where}: the header must hold `time` or `date`, got {', '.join(header)}.", where)
    wanted = [*plant.outputs.names, *plant.inputs.names]
    missing = [name for name in wanted if name not in header]
    if missing:
        raise FileFormatError(f"{where}: column {missing[0]!r} is missing; the plant names {', '.join(wanted)}.", where)
    twice = [name for i, name in enumerate(header) if name in header[:i]]
    if twice:
        raise FileFormatError(f"{where}: column {twice[0]!r} occurs twice.", where)
    try:
        _checks.known_keys("the header", header, [stamps[0], *wanted])
    except ArgumentError as error:
        raise FileFormatError(f"{where}: unknown column: {error}", where) from None
    return stamps[0]


def _number(where: str, line: int, name: str, cell: str, blank: bool = False) -> float:
    if blank and cell == "":
        return float("nan")
    value = _files.decimal(cell)
    if value is None:
        hint = " Leave the cell empty if nothing was measured." if blank else ""
        raise FileFormatError(f"{where}: {name} in line {line} is not a number: {cell!r:.60}.{hint}", where)
    return value


def date_of(where: str, line: int, cell: str) -> datetime:
    try:
        date = datetime.fromisoformat(cell)
    except ValueError:
        at = f"in line {line}" if line else "given as origin"
        raise FileFormatError(f"{where}: the date {at} is not ISO 8601: {cell!r:.60}.", where) from None
    return date.replace(tzinfo=UTC) if date.tzinfo is None else date


def _held(where: str, line: int, inputs: list[float], before: list[float] | None, plant: Measured) -> list[float]:
    """Fill empty input cells with the value that holds."""
    blank = [i for i, value in enumerate(inputs) if np.isnan(value)]
    if blank and before is None:
        name = plant.inputs.names[blank[0]]
        raise FileFormatError(f"{where}: input {name} has no value in line {line}, the first row.", where)
    return [before[i] if i in blank and before is not None else value for i, value in enumerate(inputs)]


def _check_twin(where: str, line: int, new: tuple[float, ...], old: tuple[int, tuple[float, ...]]) -> None:
    if not np.array_equal(new, old[1], equal_nan=True):
        raise FileFormatError(f"{where}: line {line} repeats the time of line {old[0]} with other values.", where)


@door
def write_measurements(measurements: Measurements, path: str | os.PathLike[str]) -> Path:
    """Write measurements as CSV; `read_measurements` returns them exactly.

    Parameters
    ----------
    measurements : Measurements
    path : path

    Returns
    -------
    Path
        The file, written whole or not at all.
    """
    plant = measurements.plant
    header = ["time", *plant.outputs.names, *plant.inputs.names]
    body = [
        [repr(float(t)), *(cell_of(v) for v in y), *(cell_of(v) for v in u)]
        for t, y, u in zip(measurements.times, measurements.y, measurements.u, strict=True)
    ]
    return write_csv(path, header, body)


def cell_of(value: float) -> str:
    """A number as a file holds it; an empty cell where it is not known."""
    return repr(float(value)) if np.isfinite(value) else ""


def write_csv(path: str | os.PathLike[str], header: list[str], body: list[list[str]]) -> Path:
    """Write a header and rows, whole or not at all; return the path."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *body])
    return _files.write_text(path, text.getvalue())
