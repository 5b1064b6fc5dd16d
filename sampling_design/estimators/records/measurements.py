"""Measurement files: time stamps with what was measured and what was applied; and files of estimates."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator
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
from sampling_design.recovery.readings import Told, as_typed

Array = npt.NDArray[np.float64]

SINCE = "_since"
"""Ending of the column that says where a composite sample of an output began."""


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
    told : tuple of tuples of Told, optional
        For each row its limits and means (`Below`, `Above`, `Mean`); y is NaN there. Default: none.

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
    told: tuple[tuple[Told, ...], ...] = field(default=(), kw_only=True)

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
        rows = tuple(tuple(row) for row in self.told) or ((),) * times.size
        if len(rows) != times.size or any(
            not np.isnan(self.y[k, each.output]) for k, r in enumerate(rows) for each in r
        ):
            raise ArgumentError("`told` must have an entry for each row, and y be NaN where it says something.")
        object.__setattr__(self, "told", rows)

    def __len__(self) -> int:
        return self.times.size

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """(N, p) where something was read: a number, a limit or a mean."""
        found = np.isfinite(self.y)
        for k, row in enumerate(self.told):
            found[k, [each.output for each in row]] = True
        return found

    def __iter__(self) -> Iterator[tuple[float, object, Array | None]]:
        for k in range(len(self)):
            if self.told[k]:
                y: list[object] = list(self.y[k])
                for each in self.told[k]:
                    y[each.output] = as_typed(each)
                applied = self.u.shape[1] > 0 and not np.isnan(self.u[k]).all()
                yield float(self.times[k]), y, self.u[k] if applied else None
                continue
            measured, applied = ~np.isnan(self.y[k]).all(), self.u.shape[1] > 0 and not np.isnan(self.u[k]).all()
            yield float(self.times[k]), self.y[k] if measured else None, self.u[k] if applied else None

    def _rows(self) -> list[tuple[str, str]]:
        counts = np.sum(self.measured, axis=0)
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
        "unchanged"; "<0.5" and ">8" are limits of detection. A column NAME_since beside an output NAME holds where a
        composite sample began, in the unit of the first column: the output is the mean from then on. Lines that start
        with # are comments. Of a
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
        read = clock.date if stamp == "date" else clock.time
        table.add(k, read(k, cell[stamp]), cell, read)
    p, m = plant.n_outputs, plant.n_inputs
    known = "" if stamp == "time" or clock.zero is None else clock.zero.isoformat()
    return Measurements(
        plant,
        np.array(table.times),
        np.reshape(table.y, (len(table.times), p)),
        np.reshape(table.u, (len(table.times), m)),
        origin=known,
        told=tuple(table.told),
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

    def time(self, line: int, cell: str) -> float:
        return _number(self.where, line, "time", cell)

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
        self.told: list[tuple[Told, ...]] = []
        self._seen: dict[float, tuple[int, tuple[float, ...]]] = {}

    def add(self, line: int, t: float, cell: dict[str, str], read: Callable[[int, str], float]) -> None:
        outputs: list[float] = []
        told: list[Told] = []
        for i, name in enumerate(self.plant.outputs.names):
            limit = cell[name][:1] if cell[name][:1] in ("<", ">") else ""
            value = _number(self.where, line, name, cell[name].removeprefix(limit).strip(), blank=not limit)
            since = self._since(line, t, cell.get(name + SINCE, ""), read)
            if np.isnan(value) and since is not None:
                raise FileFormatError(
                    f"{self.where}: {name}{SINCE} in line {line} has no {name} beside it. Leave both cells empty.",
                    self.where,
                )
            if limit or since is not None:
                ends = {"<": (-np.inf, value), ">": (value, np.inf), "": (value, value)}[limit]
                told.append(Told(i, *ends, since))
            outputs.append(np.nan if limit or since is not None else value)
        inputs = [_number(self.where, line, name, cell[name], blank=True) for name in self.plant.inputs.names]
        if inputs:
            inputs = _held(self.where, line, inputs, self.u[-1] if self.u else None, self.plant)
        if np.isnan(outputs).all() and not told and not inputs:
            raise FileFormatError(f"{self.where}: line {line} measures nothing. Leave a lost sample out.", self.where)
        flat = [np.nan if x is None else x for each in told for x in each]
        content = (*outputs, *inputs, *flat)
        if t in self._seen:
            _check_twin(self.where, line, content, self._seen[t])
            return
        self._seen[t] = (line, content)
        self.times.append(t)
        self.y.append(outputs)
        self.u.append(inputs)
        self.told.append(tuple(told))

    def _since(self, line: int, t: float, cell: str, read: Callable[[int, str], float]) -> float | None:
        if cell == "":
            return None
        since = read(line, cell)
        if since >= t:
            raise FileFormatError(
                f"{self.where}: line {line} begins a composite sample at {cell!r:.60}, which is not before its end.",
                self.where,
            )
        return since


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
        known = [stamps[0], *wanted, *(name + SINCE for name in plant.outputs.names)]
        _checks.known_keys("the header", header, known)
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
    means = sorted({each.output for row in measurements.told for each in row if each.since is not None})
    header = ["time", *plant.outputs.names, *(plant.outputs.names[i] + SINCE for i in means), *plant.inputs.names]
    body = []
    for t, y, u, told in zip(measurements.times, measurements.y, measurements.u, measurements.told, strict=True):
        cells, begun = [cell_of(v) for v in y], dict.fromkeys(means, "")
        for each in told:
            limit = "<" if np.isinf(each.lower) else ">" if np.isinf(each.upper) else ""
            cells[each.output] = limit + cell_of(each.lower if np.isfinite(each.lower) else each.upper)
            if each.since is not None:
                begun[each.output] = cell_of(each.since)
        body.append([repr(float(t)), *cells, *begun.values(), *(cell_of(v) for v in u)])
    return write_csv(path, header, body)


def cell_of(value: float) -> str:
    """A number as a file holds it; an empty cell where it is not known."""
    return repr(float(value)) if np.isfinite(value) else ""


def write_csv(path: str | os.PathLike[str], header: list[str], body: list[list[str]]) -> Path:
    """Write a header and rows, whole or not at all; return the path."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *body])
    return _files.write_text(path, text.getvalue())
