"""Measurement files: time stamps with what was measured and what was applied; and files of estimates."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, date
from pathlib import Path

import numpy as np

from sampling_design.accuracy.readings import CensoredReading, as_typed, at_some_time, time_or_span
from sampling_design.checkers.strict import is_list, is_text
from sampling_design.errors import ArgumentError
from sampling_design.estimators.records import measurement_table
from sampling_design.estimators.records.frames import DataFrame, Dataset, LazyFrame, Series, is_frame, lines_of
from sampling_design.estimators.records.measurement_table import MeasuredPlant
from sampling_design.plants.plant import Plant
from sampling_design.records import checks, file_io
from sampling_design.records.arrays import Array, Index, Mask, freeze
from sampling_design.records.dates import date_in, parse_date, passed, zoned_text
from sampling_design.records.declarations import Column
from sampling_design.records.file_io import SINCE, STAMPS, UNTIL
from sampling_design.records.record import ListRecord, counted, moment
from sampling_design.records.signatures import checked
from sampling_design.records.units import SECONDS

MeasuredRow = tuple[float | tuple[float, float], object, Array | None]
"""Time (or from when to when), outputs and inputs of a row, as an estimator takes them."""


@dataclass(frozen=True, eq=False, repr=False)
class Measurements(ListRecord[MeasuredRow]):
    """Rows of a measurement file, in the order in which they came.

    Parameters
    ----------
    plant : Plant
    times : (N,) or (N, 2) array [the plant's time unit]
        Two columns: each row was measured at some time from the first to the second, nobody knows when; where both are
        one, that is the time. `times` of the record are their middles then, what was read stands in `censored`.
    y : (N, p) array
        NaN where not measured.
    u : (N, m) array, optional
        Inputs from each time on; NaN where unchanged. Default: none given.
    origin : str
        Date (ISO 8601; naive means UTC, and the record says so) of time 0, if known; a zone behind it in brackets, as
        2026-03-02T00:00+01:00[Europe/Berlin], tells all dates by its clocks.
    assumed_zone : str
        Zone in which dates without one, the origin or those of rows, were read; "" where there were none.
    censored : tuple of tuples of CensoredReading, optional
        For each row its limits and means (`BelowDetection`, `AboveRange`, `CompositeReading`); y is NaN there.
        Default: none.

    Raises
    ------
    ArgumentError
        If shapes differ, a time, an output or an input is infinite, or `origin` is no date.

    Notes
    -----
    Its rows are (t, y, u) as an estimator's `run` and `stream` take them; y is None in a row that only
    reports an input, u is None where nothing changes. `shifted`, `rebased`, `between`, `in_order` and `merged` move
    everything that a row says of time, the beginnings of its means too.

    Examples
    --------
    >>> plant = Plant([[0.0]], [[1.0]], time_unit="h")
    >>> record = Measurements(plant, np.array([0.0, 12.25]), np.array([[4.1], [np.nan]]))
    >>> len(record), record.measured[:, 0].tolist()
    (2, [True, False])
    """

    plant: MeasuredPlant
    times: Array
    y: Array
    u: Array = None  # type: ignore[assignment]
    origin: str = field(default="", kw_only=True)
    assumed_zone: str = field(default="", kw_only=True)
    censored: tuple[tuple[CensoredReading, ...], ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.plant, MeasuredPlant):
            raise ArgumentError(f"`plant` must be a Plant or a NonlinearPlant, got {checks.described(self.plant)}.")
        checks.of_kind("assumed_zone", self.assumed_zone, str, "a string")
        if not is_text(self.origin) or self.origin:
            self._hold(origin=zoned_text(parse_date("origin", self.origin)))
        spans = checks.matrix("times", self.times, columns=2) if checks.dimensions(self.times) == 2 else None
        times = checks.vector("times", self.times if spans is None else spans.mean(axis=1))
        shapes = {"y": (self.y, self.plant.n_outputs), "u": (self.u, self.plant.n_inputs)}
        owned = {}
        for key, (value, width) in shapes.items():
            blank = np.full((times.size, width), np.nan)
            array = blank if value is None and key == "u" else checks.floats(key, value)
            if array.shape != blank.shape or np.isinf(array).any():
                raise ArgumentError(f"`{key}` must be finite or NaN of shape {blank.shape}, got shape {array.shape}.")
            array.flags.writeable = False
            owned[key] = array
        self._hold(times=times, **owned)
        outputs = range(self.plant.n_outputs)
        if not is_list(self.censored) or not all(
            checks.holds(row, CensoredReading) and all(each.output in outputs for each in row) for row in self.censored
        ):
            raise ArgumentError(
                f"`censored` must be a tuple of what each row says, got {checks.described(self.censored)}."
            )
        rows = tuple(tuple(row) for row in self.censored) or ((),) * times.size
        if len(rows) != times.size or any(
            not np.isnan(self.y[k, each.output]) for k, r in enumerate(rows) for each in r
        ):
            raise ArgumentError("`censored` must have an entry for each row, and y be NaN where it says something.")
        self._hold(censored=rows)
        if spans is not None:
            self._take_spans(spans)

    def _take_spans(self, spans: Array) -> None:
        """Put the middles in place of times that are not known, and what was read then among what is censored."""
        y, censored, middles = np.array(self.y), list(self.censored), np.empty(len(spans))
        for k, pair in enumerate(spans):
            middles[k], span = time_or_span(pair)
            if span is None:
                continue
            if np.isfinite(self.u[k]).any():
                raise ArgumentError(f"`times` = {span!r} is uncertain, and an input needs its time.")
            censored[k], y[k] = at_some_time(y[k], censored[k], span), np.nan
        self._hold(times=freeze(middles), y=freeze(y), censored=tuple(censored))

    def span_of(self, k: int) -> tuple[float, float] | None:
        """First and last time at which row k may have been measured, where that is uncertain."""
        return self.censored[k][0].span if self.censored[k] else None

    def __len__(self) -> int:
        return self.times.size

    @property
    def measured(self) -> Mask:
        """(N, p) where something was read: a number, a limit or a mean."""
        measured = np.isfinite(self.y)
        for k, row in enumerate(self.censored):
            if row:
                measured[k, [each.output for each in row]] = True
        return measured

    def samples(self, numbers: bool = False) -> tuple[Array, Mask]:
        """Times (K,) at which something was measured, in order, and (K, p) which outputs were.

        With `numbers` limits and means do not count: of them no certificate of a schedule speaks.
        """
        taken = np.isfinite(self.y) if numbers else self.measured
        rows = np.flatnonzero(taken.any(axis=1))
        times, at = np.unique(self.times[rows], return_inverse=True)
        outputs = np.zeros((times.size, taken.shape[1]), dtype=bool)
        np.logical_or.at(outputs, at, taken[rows])
        return times, outputs

    @property
    def start(self) -> float:
        """The earliest time that a row tells of: its own, or the beginning of its mean; 0 without rows."""
        begun = [each.began for row in self.censored for each in row if each.began is not None]
        return min([*begun, float(self.times.min())]) if len(self) else 0.0

    def shifted(self, by: float) -> Measurements:
        """Return the same rows on a clock that shows `by` [time] more; of dated ones the origin is as much earlier.

        Raises
        ------
        ArgumentError
            If `by` is no number, or the origin would leave the years 1 to 9999.
        """
        by = checks.number("by", by)
        censored = tuple(tuple(each.shifted(by) for each in row) for row in self.censored)
        zero = measurement_table.moved_origin(self.origin, -by, self.plant.time_unit) if self.origin else ""
        return replace(self, times=self.times + by, censored=censored, origin=zero)

    def rebased(self, origin: str) -> Measurements:
        """Return the same rows with another date as time 0; one without a zone is by the clocks of their own origin.

        Raises
        ------
        ArgumentError
            If they have no dates, or `origin` is no date.
        """
        if not self.origin:
            raise ArgumentError("`origin` can be another one only of measurements with dates: these have none.")
        here = measurement_table.date_of("`origin`", 0, self.origin)
        there = date_in("origin", origin, here.tzinfo or UTC)
        moved = self.shifted(passed(there, here).total_seconds() / SECONDS[self.plant.time_unit])
        return replace(moved, origin=zoned_text(there))

    def on_clock(self, origin: str, plant: Plant | MeasuredPlant) -> Measurements:
        """Return the same rows as a schedule counts time whose time 0 is the date `origin`, where both have dates.

        Raises
        ------
        ArgumentError
            If `plant` has another unit of time, or other outputs or inputs; if their dates have no zone and were read
            in UTC, while those of the schedule are in another one.
        """
        if (mine := _terms(self.plant)) != (theirs := _terms(plant)):
            raise ArgumentError(f"`record` must be Measurements in the plant's terms, {theirs}, got {mine}.")
        if not origin or not self.origin:
            return self
        there = parse_date("origin", origin)
        if self.assumed_zone == str(UTC) and zoned_text(there) != there.astimezone(UTC).isoformat():
            raise ArgumentError(
                f"`record` has dates without a zone, which were read in UTC, and the schedule begins at {origin}: say "
                "their `zone` in `read_measurements`, or give them their offset."
            )
        return self.rebased(origin)

    def between(self, start: float, end: float) -> Measurements:
        """Return the rows from `start` to `end`, both included; the first one says which inputs hold.

        What tells of a time outside, a mean that began before `start` or a reading that may lie outside, is left out.
        """
        start, end = checks.number("start", start), checks.number("end", end)
        ordered = self.in_order()
        within = np.flatnonzero((ordered.times >= start) & (ordered.times <= end))
        censored = tuple(tuple(each for each in ordered.censored[k] if each.within(start, end)) for k in within)
        u = measurement_table.held_on(ordered.u)[within]
        says = np.isfinite(ordered.y[within]).any(axis=1) | np.isfinite(ordered.u[within]).any(axis=1)
        says |= np.array([bool(row) for row in censored], dtype=bool)
        some = tuple(row for row, kept in zip(censored, says, strict=True) if kept)
        rows, u = within[says], u[says]
        times, y = ordered.times[rows], ordered.y[rows]
        spanned = [bool(row) and row[0].stamp is not None for row in some]
        if any(spanned[:1]) and np.isfinite(u[0]).any():  # an input needs its time
            times, y, some = np.append(start, times), np.vstack([y[:1] * np.nan, y]), ((), *some)
            u, spanned = np.vstack([u[:1], u]), [False, *spanned]
        u[spanned] = np.nan
        return replace(ordered, times=times, y=y, u=u, censored=some)

    def without(self, *numbers: int) -> Measurements:
        """Return the rows in order of time without some samples, numbered from 1 as a `Contradiction` numbers them.

        Parameters
        ----------
        numbers : int
            Inputs of their rows stay.

        Raises
        ------
        ArgumentError
            If there is no sample of that number.
        """
        ordered = self.in_order()
        times, _ = ordered.samples()
        for number in numbers:
            if checks.whole("numbers", number) > times.size or number < 1:
                raise ArgumentError(f"`numbers` must be of the {times.size} samples, counted from 1, got {number}.")
        out = np.isin(ordered.times, times[np.array(numbers, dtype=int) - 1])
        y = np.where(out[:, None], np.nan, ordered.y)
        censored = tuple(() if gone else row for row, gone in zip(ordered.censored, out.tolist(), strict=True))
        kept = ~out | np.isfinite(ordered.u).any(axis=1)
        return replace(ordered, y=y, censored=censored)._of_rows(np.flatnonzero(kept))

    def in_order(self) -> Measurements:
        """Return the rows in order of time; those of one time in the order in which they came."""
        if np.all(self.times[1:] >= self.times[:-1]):
            return self
        return self._of_rows(np.argsort(self.times, kind="stable"))

    def _of_rows(self, rows: Index) -> Measurements:
        censored = tuple(self.censored[k] for k in rows.tolist())
        return replace(self, times=self.times[rows], y=self.y[rows], u=self.u[rows], censored=censored)

    def merged(self, other: Measurements) -> Measurements:
        """Return the rows of both in order of time; what both say at one time must agree.

        Raises
        ------
        ArgumentError
            If `other` is of another plant, only one of the two has dates, or they contradict each other.
        """
        if not isinstance(other, Measurements) or _terms(other.plant) != _terms(self.plant):
            raise ArgumentError(f"`other` must be Measurements of the same plant, got {checks.described(other)}.")
        if bool(self.origin) != bool(other.origin):
            raise ArgumentError("`other` must have dates where these measurements do, and none where they have none.")
        if self.origin and other.origin != self.origin:
            other = other.rebased(self.origin)
        times, y, u = (
            np.concatenate([mine, more])
            for mine, more in ((self.times, other.times), (self.y, other.y), (self.u, other.u))
        )
        censored = [*self.censored, *other.censored]
        again, clash = measurement_table.join_rows(times, y, u, censored)
        if clash is not None:
            raise ArgumentError(f"`other` contradicts these measurements at {float(times[clash[0]])!r}.")
        both = replace(self, times=times, y=y, u=u, censored=tuple(censored))
        return both._of_rows(np.flatnonzero(~again)).in_order()

    def _entries(self) -> list[MeasuredRow]:
        return list(self)

    def __iter__(self) -> Iterator[MeasuredRow]:
        measured, applied = (np.asarray(np.isfinite(each).any(axis=1)) for each in (self.y, self.u))
        for k, censored in enumerate(self.censored):
            y: object = self.y[k] if measured[k] else None
            if censored:
                cells: list[object] = list(self.y[k])
                for each in censored:
                    cells[each.output] = as_typed(each)
                y = cells
            yield self.span_of(k) or float(self.times[k]), y, self.u[k] if applied[k] else None

    def _columns(self) -> dict[str, Column]:
        signals = ((self.plant.outputs.names, self.y), (self.plant.inputs.names, self.u))
        dates = measurement_table.dates_of(self.origin, self.times, self.plant.time_unit)
        cells = {name: values[:, i] for names, values in signals for i, name in enumerate(names)}
        return {**({"time": self.times} if dates is None else {"date": dates}), **cells}

    def _rows(self) -> list[tuple[str, str]]:
        counts = np.sum(self.measured, axis=0)
        per_output = ", ".join(f"{n}: {c}" for n, c in zip(self.plant.outputs.names, counts, strict=True))
        span = f"{moment(self.times.min())} to {moment(self.times.max())} {self.plant.time_unit}" if len(self) else "-"
        return [("rows", str(len(self))), ("time", span), ("measured", per_output), ("origin", self.origin or "-")] + (
            [("dates without a zone", f"read in {self.assumed_zone}")] if self.assumed_zone else []
        )

    def explain(self) -> str:
        """Say what was measured."""
        rows, measured = counted(len(self), "row"), self._rows()[2][1]
        return f"{rows} of measurements of {self.plant.name or 'a plant'}; {measured}."


def on_clock(record: object, plant: MeasuredPlant, origin: str = "") -> object:
    """A record as it counts time from the date `origin` ("": none is known), if it is a frame or has dates.

    Dates of a frame that have no zone are by the clocks of that origin.
    """
    if is_frame(record):
        return read_measurements(record, plant, origin=origin or None)
    return record.on_clock(origin, plant) if isinstance(record, Measurements) else record


@checked
def read_measurements(
    path: str | os.PathLike[str] | LazyFrame | DataFrame | Series | Dataset,
    plant: Plant | MeasuredPlant,
    *,
    origin: str | date | None = None,
    zone: str | None = None,
) -> Measurements:
    """Return the measurements in a CSV file, or in a frame of pandas or polars with the same columns.

    Parameters
    ----------
    path : path, DataFrame (lazy, too), Series or Dataset
        Header `time` (in the plant's time unit) or `date` (ISO 8601; a date without an hour is some time of that day),
        then the plant's output names, then its input names, in any order. An empty output cell is "not measured" (a row
        that measures nothing is a visit that was missed or is to come), an empty input cell "unchanged"; rows of one
        time say together what one row would; "<0.5" and
        ">8" are limits of detection, "<=0.5" says the same. A column `time_until` or `date_until` says until when a row
        may have been measured, where its time is not known; empty where it is. A column NAME_since beside an output
        NAME holds where a composite sample began, in the unit of the first column: the output is the mean from then on.
        Lines that start with # are comments. NaN and null of a frame are what an empty cell is. Where a frame has no
        column `time` or `date`, its index has the times (numbers that do more than count the rows, or spans of time) or
        the dates, else its only column of dates has them, whatever they are called. A pandas Series is a frame of one
        output, a Dataset of xarray with one axis the frame that it turns into.
    plant : Plant
    origin : str or datetime, optional
        Date of time 0 in a file of dates. Default: the date of the first row.
    zone : str, optional
        IANA name of the zone of dates without one, that of `origin` too. Default: the offset of `origin`, else UTC,
        if no date has a zone. `assumed_zone` tells.

    Returns
    -------
    Measurements

    Raises
    ------
    FileFormatError
        If a column is missing, unknown or repeated, a row has another number of cells, a cell is no number or no date,
        an input has no value in the first row, rows of one time contradict each other, a date without a zone is
        skipped or repeated by its clocks or stands beside one that has a zone while nothing says its own, numbers have
        decimal commas and decimal points, or a frame's index counts its rows and nothing else says their times.
    ArgumentError
        If there is no zone of that name.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from sampling_design import Plant
    >>> plant = Plant([[0.0]], [[1.0]], time_unit="h", outputs=["blood"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "read.csv"
    ...     characters = path.write_text("date,blood\\n2026-03-02 08:00,4.1\\n2026-03-02 20:15,3.8\\n")
    ...     found = read_measurements(path, plant, zone="Europe/Berlin")
    >>> found.times, found.y[:, 0]
    (array([ 0.  , 12.25]), array([4.1, 3.8]))
    """
    where, lines = lines_of(path, plant)
    table = measurement_table.read_table(
        where, lines, plant, origin.isoformat() if isinstance(origin, date) else origin, zone
    )
    times, y, u = table.arrays()
    censored = tuple(table.censored) if any(table.censored) else ()
    return Measurements(plant, times, y, u, origin=table.origin, assumed_zone=table.assumed_zone, censored=censored)


@checked
def write_measurements(measurements: Measurements, path: str | os.PathLike[str]) -> Path:
    """Write measurements as CSV; `read_measurements` returns them exactly, with the input that holds at each row.

    Parameters
    ----------
    measurements : Measurements
        Each time once. Times are written, and not the date of time 0; inputs are zero until the first is given.
    path : path

    Returns
    -------
    Path
        The file, written whole or not at all.

    Raises
    ------
    ArgumentError
        If the name of an output or input cannot be a column.
    """
    plant = measurements.plant
    spans = [measurements.span_of(k) for k in range(len(measurements))]
    stamps = ["time", *(["time" + UNTIL] if any(spans) else [])]
    means = sorted({each.output for row in measurements.censored for each in row if each.since is not None})
    header = [*stamps, *plant.outputs.names, *(plant.outputs.names[i] + SINCE for i in means), *plant.inputs.names]
    for name in header[len(stamps) :]:
        if header.count(name) > 1 or not file_io.is_column(name, *STAMPS, "time" + UNTIL):
            raise ArgumentError(f"`measurements`: {name!r} cannot be a column of a CSV file, or is one already.")
    body, inputs = list[list[str]](), np.array(measurements.u)
    dated = [k for k, span in enumerate(spans) if span is None]
    if dated:
        first = min(dated, key=lambda k: measurements.times[k])
        inputs[first] = np.nan_to_num(inputs[first])  # which the reader asks for
    table = zip(measurements.times.tolist(), spans, measurements.y, inputs, measurements.censored, strict=True)
    for t, span, y, u, censored in table:
        when = [repr(t), ""] if span is None else [repr(end) for end in span]
        cells, begun = [cell_of(v) for v in y], dict.fromkeys(means, "")
        for each in censored:
            limit = "<" if np.isinf(each.lower) else ">" if np.isinf(each.upper) else ""
            cells[each.output] = limit + cell_of(each.lower if np.isfinite(each.lower) else each.upper)
            if each.since is not None:
                begun[each.output] = cell_of(each.since)
        body.append([*when[: len(stamps)], *cells, *begun.values(), *(cell_of(v) for v in u)])
    return write_csv(path, header, body)


def _terms(plant: MeasuredPlant) -> str:
    """What numbers of a record mean."""
    listed = [
        f"{what} {', '.join(f'{n} [{unit}]' if unit else n for n, unit in zip(own.names, own.units, strict=True))}"
        for what, own in (("outputs", plant.outputs), ("inputs", plant.inputs))
        if len(own.names)
    ]
    return ", ".join([f"time in {plant.time_unit}", *listed])


def cell_of(value: float) -> str:
    """A number as a file holds it; an empty cell where it is not known."""
    return repr(float(value)) if math.isfinite(value) else ""


def write_csv(path: str | os.PathLike[str], header: list[str], body: list[list[str]]) -> Path:
    """Write a header and rows, whole or not at all; return the path."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *body])
    return file_io.write_text(path, text.getvalue())
