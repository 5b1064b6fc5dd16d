"""The grammar of measurement files: blocks of plain rows as columns of numbers, every other row by itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, time, timedelta, tzinfo
from itertools import chain, islice
from typing import Protocol, runtime_checkable

import numpy as np

from sampling_design.accuracy.readings import CensoredReading, at_some_time, time_or_span
from sampling_design.accuracy.record_rows import LIMITS
from sampling_design.checkers.strict import nearest
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.plants.plant import Signals
from sampling_design.records import checks, dates, file_io
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.dates import UnmixedDates, date_after, time_zone, unambiguous, zoned_date, zoned_text
from sampling_design.records.declarations import moment
from sampling_design.records.file_io import MISSING, SINCE, STAMPS, UNTIL, row_name
from sampling_design.records.units import SECONDS
from sampling_design.schedules.files import MARK, in_file

Numbered = tuple[int, str]

DATE_SLIP = "Write 2026-03-16 08:00: year, month, day; where a zone is known, its offset behind it: +01:00."
BLOCK = 4096  # lines that are held as text at a time; what they say is held as numbers
_MANY = -1  # stands for the line where the dates of many rows are read at once
LONGEST_LINE = 100_000  # Characters; a longer line is read by itself, where a cell beyond all measure is refused
NOT_READ = " A sensor that was not read has a column of empty cells, an input one with its value in the first row."


@runtime_checkable
class MeasuredPlant(Protocol):
    """What a file of measurements needs of a plant, linear or not."""

    @property
    def n_states(self) -> int: ...
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


def read_table(
    where: str, lines: Iterator[str], plant: MeasuredPlant, origin: str | None, zone: str | None = None
) -> MeasurementTable:
    """Return what the lines of a file say, read block by block. Raises FileFormatError as `read_measurements`."""
    opening = next(lines, "")
    if opening.startswith(MARK):
        raise FileFormatError(
            f"{where}: is a schedule file, expected measurements: its ones say what is to be measured, not what was "
            "read.",
            where,
        )
    numbered = ((k, line) for k, line in enumerate(chain([opening], lines), 1) if file_io.has_cells(line))
    first = next(numbered, None)
    if first is None:
        raise FileFormatError(f"{where}: is empty, expected a header line.", where)
    mark = file_io.separator(first[1])
    ((_, found),) = file_io.csv_rows([first], where)
    while found and not found[-1]:  # spreadsheets end every line with the separators of empty columns
        found.pop()
    own = {*plant.outputs.names, *plant.inputs.names}
    header = [name.lower() if name.lower() in STAMPS and name not in own else name for name in found]
    stamp = _check_header(where, header, plant)
    clock = _DateConverter(where, plant, origin, zone, stamp)
    table = MeasurementTable(where, plant, header, mark, clock, stamp)
    while block := list(islice(numbered, BLOCK)):
        table.add_block(block)
    return table


class _DateConverter:
    """Turns dates into times since the origin, by default the first date.

    A date without a zone is one of `zone` (its IANA name), else of the origin's own offset, else of UTC; `naive` says
    whether there was one, the origin or a row's, and `zone` where it was taken to be.
    """

    def __init__(self, where: str, plant: MeasuredPlant, origin: str | None, zone: str | None, stamp: str):
        self.stamp, self.named = stamp, zone is not None
        self.where, self.unit, self.naive = where, SECONDS[plant.time_unit], False
        self.zone: tzinfo = UTC if zone is None else time_zone(zone)
        self._unmixed = UnmixedDates(said=self.named)
        self.zero = None if origin is None else self.placed(0, origin, date_of(where, 0, origin, None))
        if zone is None and self.zero is not None:
            self.zone = self.zero.tzinfo or UTC
            self._unmixed.said = not self.naive

    def time(self, line: int, cell: str) -> float:
        return _number(self.where, line, "time", cell)

    def date(self, line: int, cell: str) -> float:
        return self.since(line, cell, date_of(self.where, line, cell, None))

    def span(self, line: int, cell: str, until: str) -> tuple[float, tuple[float, float] | None]:
        """A time, and its span where it is uncertain: until another one, or some time of a day without an hour."""
        dated, end = self.stamp == "date", until or cell
        first = (self.date if dated else self.time)(line, cell)
        last = first if not until else (self.date if dated else self.time)(line, until)
        if dated and (day := dates.day_in(end)) is not None:
            last = self.since(line, end, datetime.combine(day + timedelta(days=1), time()))
        if first == last:  # as most often
            return first, None
        try:
            return time_or_span((first, last))
        except ArgumentError:
            raise FileFormatError(
                f"{self.where}: {row_name(self.where, line)} ends before it begins: {until!r:.60}.", self.where
            ) from None

    def since(self, line: int, cell: str, date: datetime) -> float:
        """Time of a date, with or without a zone of its own; elapsed time, whatever the clocks did meanwhile."""
        date = self.placed(line, cell, date)
        self.zero = date if self.zero is None else self.zero
        return (date.astimezone(UTC) - self.zero.astimezone(UTC)).total_seconds() / self.unit

    def placed(self, line: int, cell: str, date: datetime) -> datetime:
        """The date with its zone. Raises FileFormatError where clocks do not say which instant it is."""
        try:
            self._unmixed.take(date, f"the date {_place(self.where, line)}")
        except ArgumentError as error:
            raise in_file(error, self.where) from None
        if date.tzinfo is not None:
            return date
        self.naive = True
        if not unambiguous(date, self.zone):
            raise FileFormatError(
                f"{self.where}: the date {_place(self.where, line)} is skipped or repeated by the clocks of "
                f"{self.zone}: {cell!r:.60}. Give its offset.",
                self.where,
            )
        return date.replace(tzinfo=self.zone)


class MeasurementTable:
    """Rows that were read so far, eight bytes a cell; those of one time are one."""

    def __init__(
        self, where: str, plant: MeasuredPlant, header: list[str], mark: str, clock: _DateConverter, stamp: str
    ):
        self.where, self.plant, self.header, self.mark = where, plant, header, mark
        self.clock, self.stamp = clock, stamp
        self.read = clock.date if stamp == "date" else clock.time
        self.censored: list[tuple[CensoredReading, ...]] = []
        self._blocks: list[tuple[Array, Array, Array, Index]] = []
        self._marks: frozenset[str] = frozenset()  # decimal marks so far
        self._rows: list[tuple[float, list[float], list[float], int]] = []  # that were read one by one
        self._undated: list[tuple[tuple[float, float], list[float], int]] = []  # inputs of rows whose time is uncertain

    @property
    def assumed_zone(self) -> str:
        """Where dates without a zone were taken to be; "" where there were none."""
        return str(self.clock.zone) if self.clock.naive and self.stamp == "date" else ""

    @property
    def origin(self) -> str:
        """Date of time 0, where the file has dates."""
        zero = self.clock.zero
        if self.stamp == "time" or zero is None:
            return ""
        return zoned_text(zero.astimezone(self.clock.zone) if self.clock.named else zero)

    def arrays(self) -> tuple[Array, Array, Array]:
        """Times, outputs and inputs of all rows as they came, those of one time as one; the table is empty then."""
        p, m = self.plant.n_outputs, self.plant.n_inputs
        blocks, self._blocks = self._blocks, []
        empty = (np.zeros(0), np.zeros((0, p)), np.zeros((0, m)), np.zeros(0, dtype=int))
        times, y, u, lines = (np.concatenate([empty[i], *(block[i] for block in blocks)]) for i in range(4))
        again, clash = join_rows(times, y, u, self.censored)
        if clash is not None:
            first, other = (row_name(self.where, int(lines[k])) for k in clash)
            raise FileFormatError(f"{self.where}: {other} repeats the time of {first} with other values.", self.where)
        times, y, u, lines = times[~again], y[~again], u[~again], lines[~again]
        self.censored = [row for row, gone in zip(self.censored, again.tolist(), strict=True) if not gone]
        self._fill(times, u, lines, np.argsort(times, kind="stable"))
        return times, y, u

    def _fill(self, times: Array, u: Array, lines: Index, order: Index) -> None:
        """Fill blank inputs with what held at the time of their row, whenever that row came."""
        dated = np.array([not row or row[0].stamp is None for row in self.censored], dtype=bool)
        at = order[dated[order]]
        u[at] = held_on(u[at])
        if at.size and np.isnan(u[at[0]]).any():
            name = self.plant.inputs.names[int(np.argmax(np.isnan(u[at[0]])))]
            raise FileFormatError(
                f"{self.where}: input {name} has no value in {row_name(self.where, int(lines[at[0]]))}, the first row.",
                self.where,
            )
        for span, inputs, line in self._undated:
            begin, end = np.searchsorted(times[at], span, side="right").tolist()
            held = u[at[max(begin - 1, 0) : end]]
            if any(not np.isnan(value) and value not in held[:, i] for i, value in enumerate(inputs)):
                raise FileFormatError(
                    f"{self.where}: {row_name(self.where, line)} changes an input at a time that is not known. "
                    "Give it a row of its own.",
                    self.where,
                )

    def add_block(self, lines: list[Numbered]) -> None:
        """Take in numbered lines: at once where all are plain rows in order of time, else one by one."""
        self._marks = file_io.one_decimal_mark(lines, self.where, self.mark, self._marks)
        plain = self._plain(lines)
        if plain is not None:
            times, y, u, censored = plain
            kept = np.asarray(np.isfinite(y).any(axis=1) | bool(u.shape[1]))
            kept[list(censored)] = True
            self._blocks.append((times[kept], y[kept], u[kept], np.array([number for number, _ in lines])[kept]))
            self.censored += [tuple(censored.get(row, ())) for row in np.flatnonzero(kept).tolist()]
            return
        for number, row in file_io.csv_rows(lines, self.where, self.mark):
            cells = self._own(row)
            if len(cells) != len(self.header):
                slip = " Decimals have a point." if self.mark == "," and len(cells) > len(self.header) else ""
                came = f"{self.where}: {row_name(self.where, number)} has {len(cells)} cells"
                raise FileFormatError(f"{came}, expected {len(self.header)}.{slip}", self.where)
            cell = dict(zip(self.header, cells, strict=True))
            self._add(number, *self.clock.span(number, cell[self.stamp], cell.get(self.stamp + UNTIL, "")), cell)
        self._close()

    def _own(self, cells: list[str]) -> list[str]:
        """The cells of a row, without empty ones beyond the last column."""
        own = len(self.header)
        return cells[:own] if len(cells) > own and not any(map(str.strip, cells[own:])) else cells

    def _plain(self, lines: list[Numbered]) -> tuple[Array, Array, Array, dict[int, list[CensoredReading]]] | None:
        """Times, outputs, inputs and, by row, readings beyond limits; None where not all rows are plain.

        Plain ones hold numbers, numbers after < or >, and blanks.
        """
        texts = [line for _, line in lines]
        if any('"' in text or len(text) > LONGEST_LINE for text in texts):
            return None
        rows = [self._own(text.split(self.mark)) for text in texts]
        if any(len(row) != len(self.header) for row in rows):
            return None
        columns = dict(zip(self.header, zip(*rows, strict=True), strict=True))
        times = self._stamps(columns[self.stamp])
        if times is None:
            return None
        more = [self.stamp + UNTIL, *(name + SINCE for name in self.plant.outputs.names)]
        if any(cell.strip() for name in more for cell in columns.get(name, ())):
            return None
        censored: dict[int, list[CensoredReading]] = {}
        outputs = [self._output(i, columns[name], censored) for i, name in enumerate(self.plant.outputs.names)]
        y = _beside(outputs, times.size)
        u = _beside([self._column(columns[name]) for name in self.plant.inputs.names], times.size)
        return None if y is None or u is None else (times, y, u, censored)

    def _output(self, i: int, cells: tuple[str, ...], censored: dict[int, list[CensoredReading]]) -> Array | None:
        """The numbers of an output, NaN beyond a limit of detection, which joins `censored` by its row; else None."""
        limits, plain = dict[int, str](), [cell.strip() for cell in cells]
        for row, cell in enumerate(plain):
            if cell[:1] in LIMITS:
                limits[row], plain[row] = _limit(cell)
        numbers = self._column(plain)
        if numbers is None:
            numbers = self._column(plain := ["" if cell.lower() in MISSING else cell for cell in plain])
        if numbers is None or not limits:
            return numbers
        values = numbers[list(limits)].tolist()
        numbers[list(limits)] = np.nan
        for (row, limit), value in zip(limits.items(), values, strict=True):
            ends = (-np.inf, value) if limit == "<" else (value, np.inf)
            censored.setdefault(row, []).append(CensoredReading(i, *ends))
        return None if np.isnan(values).any() else numbers

    def _stamps(self, cells: tuple[str, ...]) -> Array | None:
        if self.stamp == "time":
            return self._column(cells, blank=False)
        if any(dates.day_in(cell.strip()) for cell in cells):
            return None
        try:
            read = [datetime.fromisoformat(cell.strip()) for cell in cells]
        except ValueError:
            return None
        try:
            return np.array([self.clock.since(_MANY, "", date) for date in read])
        except FileFormatError:
            return None  # said again with its line

    def _column(self, cells: Sequence[str], blank: bool = True) -> Array | None:
        return file_io.decimals([cell.strip() for cell in cells], self.mark != ",", blank)

    def _add(self, line: int, t: float, span: tuple[float, float] | None, cell: dict[str, str]) -> None:
        outputs: list[float] = []
        censored: list[CensoredReading] = []
        for i, name in enumerate(self.plant.outputs.names):
            limit, number = _limit(cell[name])
            value = _number(self.where, line, name, number, blank=not limit)
            since = self._since(line, t, cell.get(name + SINCE, ""))
            if np.isnan(value) and since is not None:
                raise FileFormatError(
                    f"{self.where}: {name}{SINCE} in {row_name(self.where, line)} has no {name} beside it. "
                    "Leave both cells empty.",
                    self.where,
                )
            if limit or since is not None:
                ends = {"<": (-np.inf, value), ">": (value, np.inf), "": (value, value)}[limit]
                censored.append(CensoredReading(i, *ends, since))
            outputs.append(np.nan if limit or since is not None else value)
        inputs = [_number(self.where, line, name, cell[name], blank=True) for name in self.plant.inputs.names]
        if span is not None:
            if any(each.since is not None for each in censored):
                raise FileFormatError(
                    f"{self.where}: {row_name(self.where, line)} holds a mean, whose end must be one time.", self.where
                )
            censored, outputs = list(at_some_time(np.array(outputs), tuple(censored), span)), [np.nan] * len(outputs)
            self._undated.append((span, inputs, line))
            inputs = [np.nan] * len(inputs)
        if np.isnan(outputs).all() and not censored and (span is not None or not inputs):
            return  # a visit that was missed, or is still to come
        self._rows.append((t, outputs, inputs, line))
        self.censored.append(tuple(censored))

    def _close(self) -> None:
        """Put the rows that were read one by one among the others, as numbers."""
        if self._rows:
            times, y, u, lines = zip(*self._rows, strict=True)
            shapes = (len(times), self.plant.n_outputs), (len(times), self.plant.n_inputs)
            self._blocks.append((np.array(times), np.reshape(y, shapes[0]), np.reshape(u, shapes[1]), np.array(lines)))
            self._rows = []

    def _since(self, line: int, t: float, cell: str) -> float | None:
        if cell == "":
            return None
        since = self.read(line, cell)
        if since >= t:
            raise FileFormatError(
                f"{self.where}: {row_name(self.where, line)} begins a composite sample at {cell!r:.60}, "
                "which is not before its end.",
                self.where,
            )
        return since


def join_rows(
    times: Array, y: Array, u: Array, censored: list[tuple[CensoredReading, ...]]
) -> tuple[Mask, tuple[int, int] | None]:
    """Join rows of one time, known or not, in the place of the first; return who went there, and who contradict.

    A row at a time and one that may have been taken then stay two.
    """
    again = np.zeros(times.size, dtype=bool)
    _, group, sizes = np.unique(times, return_inverse=True, return_counts=True)
    places: dict[object, int] = {}
    for k in np.flatnonzero(sizes[group] > 1).tolist():
        at = places.setdefault((times[k], censored[k][0].span if censored[k] else None), k)
        if at == k:
            continue
        again[k] = True
        read = {each.output: each for each in censored[at]}
        new = [each for each in censored[k] if read.get(each.output) != each]
        torn = any(each.output in read or np.isfinite(y[at, each.output]) for each in new)
        if torn or np.isfinite(y[k, list(read)]).any():
            return again, (at, k)
        for table in (y, u):
            if np.any(table[at] != table[k], where=np.isfinite(table[at]) & np.isfinite(table[k])):
                return again, (at, k)
            table[at] = np.where(np.isnan(table[at]), table[k], table[at])
        censored[at] = (*censored[at], *new)
    return again, None


def _beside(columns: list[Array | None], rows: int) -> Array | None:
    """Columns as one table; None where one of them is."""
    known = [column for column in columns if column is not None]
    if len(known) < len(columns):
        return None
    return np.stack(known, axis=1) if known else np.zeros((rows, 0))


def held_on(inputs: Array) -> Array:
    """Inputs (N, m) in order of time whose blanks are what held before; NaN where that is not known."""
    known, rows = np.isfinite(inputs), np.arange(len(inputs))[:, None]
    last = np.maximum.accumulate(np.where(known, rows, -1), axis=0)
    return np.where(last < 0, np.nan, np.take_along_axis(inputs, last, axis=0)) if len(inputs) else inputs


def _check_header(where: str, header: list[str], plant: MeasuredPlant) -> str:
    stamps = [name for name in STAMPS if name in header]
    if len(stamps) != 1:
        both = " One of them: a day and an hour stand in one cell, as 2026-03-16 08:00." if stamps else ""
        raise FileFormatError(f"{where}: the header must hold `time` or `date`, got {', '.join(header)}.{both}", where)
    wanted = [*plant.outputs.names, *plant.inputs.names]
    missing = [name for name in wanted if name not in header]
    if missing:
        free = [name for name in header if name and name not in (*stamps, *wanted)]
        near = nearest(missing[0], free)
        slip = f" Is it {near!r}? Names stand as in the plant, without units." if near else NOT_READ
        text = f"{where}: column {missing[0]!r} is missing; the plant names {', '.join(wanted)}.{slip}"
        raise FileFormatError(text, where)
    if "" in header:
        at = header.index("") + 1
        raise FileFormatError(f"{where}: column {at} has no name in the header. Name it, or take it out.", where)
    twice = [name for i, name in enumerate(header) if name in header[:i]]
    if twice:
        raise FileFormatError(f"{where}: column {twice[0]!r} occurs twice.", where)
    try:
        known = [stamps[0], stamps[0] + UNTIL, *wanted, *(name + SINCE for name in plant.outputs.names)]
        checks.known_keys("the header", header, known)
    except ArgumentError as error:
        names = ", ".join(wanted)
        raise FileFormatError(
            f"{where}: {error} Take a column that is neither out; the plant names {names}.", where
        ) from None
    return stamps[0]


def _limit(cell: str) -> tuple[str, str]:
    """The limit that a cell states, "<", ">" or none, and what stands behind its sign: nothing where it is blank.

    "<0.5" and "<=0.5" say the same: what is possible is a closed set. "NA" says that an output was not measured; an
    input would keep its value then, which nobody said.
    """
    if cell.lower() in MISSING:
        return "", ""
    sign = LIMITS.get(cell[:1], "")
    number = cell[1:].removeprefix("=" if cell[:1] == sign else "") if sign else cell
    return sign, number.strip()


def _number(where: str, line: int, name: str, cell: str, blank: bool = False) -> float:
    if blank and cell == "":
        return float("nan")
    value = file_io.decimal(cell)
    if value is None:
        if not cell and name == "time":
            raise FileFormatError(f"{where}: the time in {row_name(where, line)} is missing.", where)
        hint = " Leave the cell empty if nothing was measured." if blank else ""
        if name == "time" and cell[4:5] == "-":  # behind a year
            hint = " Dates stand in a column named date."
        hint = file_io.number_slip(cell, where) or hint
        raise FileFormatError(f"{where}: {name} in {row_name(where, line)} is not a number: {cell!r:.60}.{hint}", where)
    return value


def _place(where: str, line: int) -> str:
    named = {0: "given as origin", _MANY: "of the first row"}  # the first of many is the one that others differ from
    return named.get(line) or f"in {row_name(where, line)}"


def date_of(where: str, line: int, cell: str, zone: tzinfo | None = UTC) -> datetime:
    try:
        date = zoned_date(cell)
    except ArgumentError as error:
        raise FileFormatError(f"{where}: the date {_place(where, line)} names no instant: {error}", where) from None
    except ValueError:
        at = _place(where, line)
        if not cell:
            raise FileFormatError(f"{where}: the date {at} is missing.", where) from None
        raise FileFormatError(f"{where}: the date {at} is not ISO 8601: {cell!r:.60}. {DATE_SLIP}", where) from None
    return date.replace(tzinfo=zone) if date.tzinfo is None else date


def dated(zero: datetime, t: float, unit: str) -> str:
    """Return the date (ISO 8601, to the microsecond) of a time counted from `zero`, by the clocks of its zone."""
    return _date_at(zero, t, unit).isoformat()


def moved_origin(origin: str, t: float, unit: str) -> str:
    """Return the origin that is `t` after another one, in the same zone."""
    return zoned_text(_date_at(date_of("`origin`", 0, origin), t, unit))


def _date_at(zero: datetime, t: float, unit: str) -> datetime:
    """The date of a time counted from `zero`. Raises ArgumentError if it lies outside the years 1 to 9999."""
    try:
        return date_after(zero, t * SECONDS[unit])
    except OverflowError:
        raise ArgumentError(f"`origin` plus {t!r} {unit} lies outside the years 1 to 9999.") from None


def dates_of(origin: str, times: Array, unit: str) -> list[datetime] | None:
    """Return the dates of times counted from the date `origin`; None where that is ""."""
    if not origin:
        return None
    zero = date_of("origin", 0, origin)
    return [_date_at(zero, t, unit) for t in times.tolist()]


def time_or_date(origin: str, t: float, unit: str) -> str:
    """Return a time counted from the date `origin` as its date to the minute; as it is where that is ""."""
    dates = dates_of(origin, np.array([t]), unit)
    return f"{moment(t)} {unit}" if dates is None else dates[0].isoformat(sep=" ", timespec="minutes")
