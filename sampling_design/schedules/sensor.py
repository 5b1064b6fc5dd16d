"""One sensor: when it can be read, what a reading costs, how good it is, and when its result is in."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import (
    by_name,
    count,
    is_list,
    is_table,
    is_text,
    list_of,
    nonnegative,
    number,
    positive,
    refuse,
    table,
    text,
)
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.dates import parse_date
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.file_io import by_first, by_kind, csv_rows, read_text
from sampling_design.records.record import Plain, PlainRecord, moment, short
from sampling_design.records.units import SECONDS, likely_unit, time_factor
from sampling_design.schedules.opening import OpeningCalendar, week_hours

Duration: TypeAlias = float | str
Windows: TypeAlias = npt.ArrayLike | Sequence[tuple[str, str]] | str | os.PathLike[str] | None
Dates: TypeAlias = tuple[tuple[str, str], ...]

LARGEST = 1 << 22
"""Bytes of a file of windows: some fifty thousand passes; what is larger is another file."""


_DURATION = re.compile(r"(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)\s*([a-z]+)", re.ASCII)


def duration(name: str, value: object, unit: str) -> float:
    """Return a time > 0 in `unit`, given as a number of them or as text with a unit of its own ("15 min").

    Raises ArgumentError if it is neither, or not positive.
    """
    if not is_text(value):
        return checks.positive(name, value)
    found = _DURATION.fullmatch(value.strip())
    length = float(found[1]) * (SECONDS[found[2]] / SECONDS[unit]) if found and found[2] in SECONDS else 0.0
    if not 0 < length < np.inf:
        unknown = likely_unit(found[2]) if found and found[2] not in SECONDS else ""
        raise ArgumentError(f'`{name}` must be a time like 0.25 or "15 min", got {value!r:.60}.{unknown}')
    return length


def delay_span(name: str, given: object) -> tuple[float, float]:
    """Return the least and the most of a delay that is one number or a pair.

    Raises ArgumentError if one is negative, or the least is more than the most.
    """
    if not is_list(given):
        most = checks.nonnegative(name, given)
        return most, most
    if len(given) != 2:
        raise ArgumentError(f"`{name}` must be a number or a pair (least, most), got {given!r:.60}.")
    least, most = (checks.nonnegative(name, each) for each in given)
    if least > most:
        raise ArgumentError(f"`{name}` must be (least, most), got ({least!r}, {most!r}): the least is more.")
    return least, most


def result_span(name: str, value: object, unit: str) -> tuple[float, float]:
    """Return how long a result takes at least and at most in `unit`: one time, or a pair of times.

    Raises ArgumentError if one is negative or no time, or the least is more than the most.
    """
    pair = value if is_list(value) else (value, value)
    each = [duration(name, x, unit) if is_text(x) else checks.nonnegative(name, x) for x in pair]
    return delay_span(name, each if is_list(value) else each[0])


@frozen
class Sensor(PlainRecord):
    """What one sensor costs and can do; the same table serves a design and a plan.

    Parameters
    ----------
    price : float
        Of one measurement, >= 0.
    available : (m, 2) array, sequence of (str, str), or path, optional
        When it can be read: half-open windows [start, stop) within the period, in the requirement's time unit or as
        dates (ISO 8601, which needs a calendar); or a CSV file of such rows, as passes of a satellite or low tides.
        Default: always.
    hours : dict of str to list of (str, str), optional
        Own opening hours by weekday ("Mon": [("08:00", "12:00")]), within those of the calendar, which they need.
    noise_bound : float, optional
        No error of a measurement is larger. Plans need it where an accuracy is to be guaranteed; sigma knows no noise.
    noise_deviation : float, optional
        Standard deviation of a measurement's error, likewise.
    longest_use : int, optional
        Most measurements in one period; of plans.
    spacing : float or str, optional
        Least time between two measurements of this sensor; of plans.
    result_delay : float or str, or a pair of these, optional
        How long after its sample a result comes, or (least, most). What is guaranteed is then known at the time, with
        results still out. Default: at once.
    detection_limit : float, optional
        What is less may be reported as "< L". Such a reading is counted as what it is sure to say: between `lowest` and
        L; nothing where no `lowest` is given, nor in a design, since two values below L look alike.
    lowest : float, optional
        No true value is ever lower, as 0 of a concentration.

    Raises
    ------
    ArgumentError
        If a number is negative, a window is empty, the least delay is more than the most, hours are not understood, or
        `lowest` is not below `detection_limit`.
    FileFormatError
        If the file of windows is missing, or holds no rows of two times.
    """

    price: float = 0.0
    noise_bound: float | None = None
    hours: Mapping[str, object] | None = None
    longest_use: int | None = None
    spacing: Duration | None = None
    noise_deviation: float | None = None
    result_delay: Duration | tuple[Duration, Duration] | None = None
    available: Converted[Windows, Array | Dates | None] = None  # type: ignore[assignment]
    detection_limit: float | None = None
    lowest: float | None = None

    _plain = (
        "price noise_bound? noise_deviation? longest_use? spacing? result_delay? detection_limit? lowest? available? "
        "hours?"
    )

    def __post_init__(self) -> None:
        self._check(
            **dict.fromkeys(("price", "noise_bound"), checks.nonnegative), noise_deviation=checks.positive,
            longest_use=checks.whole, hours=week_hours, detection_limit=checks.number, lowest=checks.number,
        )  # fmt: skip
        if self.spacing is not None:
            duration("spacing", self.spacing, "h")
        if self.result_delay is not None:
            result_span("result_delay", self.result_delay, "h")
        if self.lowest is not None and (self.detection_limit is None or self.lowest >= self.detection_limit):
            raise ArgumentError(
                f"`lowest` must be less than `detection_limit`, got {short(self.lowest)} and "
                f"{'none' if self.detection_limit is None else short(self.detection_limit)}."
            )
        self._hold(available=_windows(self.available))

    @property
    def sure_bound(self) -> float:
        """No error of what a reading is sure to say is larger: infinite where it may say nothing.

        A reading "< L" of noise bound v says that the value is between `lowest` and L + v.
        """
        if self.noise_bound is None or (self.detection_limit is not None and self.lowest is None):
            return np.inf
        if self.detection_limit is None or self.lowest is None:
            return self.noise_bound
        return max(self.noise_bound, (self.detection_limit + self.noise_bound - self.lowest) / 2)

    def in_unit(self, source: str, unit: str) -> Sensor:
        """The same with times that are plain numbers of one unit in another."""
        c = time_factor(source, unit)

        def moved(time: Duration) -> Duration:
            return time if isinstance(time, str) else c * time

        delay, windows = self.result_delay, self.available
        match delay:
            case None:
                pass
            case (least, most):
                delay = moved(least), moved(most)
            case alone:
                delay = moved(alone)
        return replace(
            self, spacing=None if self.spacing is None else moved(self.spacing), result_delay=delay,
            available=windows if windows is None or isinstance(windows, tuple) else windows * c,
        )  # fmt: skip

    def windows(self, name: str, calendar: OpeningCalendar | None, unit: str) -> Array | None:
        """Return when it can be read (m, 2) in `unit`, on the clock of a calendar; None: always.

        Raises ArgumentError if windows are dates and there is no calendar, or one lies before its start.
        """
        if not isinstance(self.available, tuple):
            return self.available
        if calendar is None:
            raise ArgumentError(f"`sensors.{name}.available` are dates, which need a `calendar` with its `start`.")
        place, minute = calendar, SECONDS[unit] / 60

        def clock(date: str) -> float:
            return place.clock(place.elapsed_at(parse_date(f"sensors.{name}.available", date, place.zone))) / minute

        return intervals(f"sensors.{name}.available", [[clock(a), clock(b)] for a, b in self.available])

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; what says nothing is left out: a sensor without windows is never read."""
        never = self.available is not None and not len(self.available)
        return super().to_dict() | ({"available": []} if never else {})

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("price", short(self.price))]
        for key in ("noise_bound", "noise_deviation", "longest_use", "spacing", "detection_limit", "lowest"):
            value = getattr(self, key)
            rows += [] if value is None else [(key.replace("_", " "), value if is_text(value) else short(value))]
        if self.result_delay is not None:
            delay = self.result_delay
            after = f"{delay[0]} to {delay[1]}" if is_list(delay) else f"{delay}"
            rows.append(("results after", after))
        if self.available is not None:
            rows.append(("available", spans_in_words(self.available, "never")))
        return rows

    def explain(self) -> str:
        """Say the terms in words."""
        return ", ".join(f"{label} {value}" for label, value in self._rows()) + "."


def numbers(sensor: Sensor) -> Array:
    """The windows of a sensor that has some, as numbers."""
    assert isinstance(sensor.available, np.ndarray)
    return sensor.available


def complement(spans: Array, period: float) -> Array:
    """What stretches (m, 2) of a period leave of it."""
    edges = np.array([0.0, *np.ravel(spans), period]).reshape(-1, 2)
    return np.asarray(edges[edges[:, 1] > edges[:, 0]])


def joined(spans: Array, tiny: float = 0.0) -> Array:
    """Sorted disjoint intervals (m, 2); those that overlap, or are no more than `tiny` apart, are one."""
    found: list[list[float]] = []
    for a, b in spans[np.argsort(spans[:, 0], kind="stable")].tolist():
        if found and a <= found[-1][1] + tiny:
            found[-1][1] = max(found[-1][1], b)
        else:
            found.append([a, b])
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def spans_in_words(value: Array | Dates | None, empty: str) -> str:
    """Windows in words."""
    if value is None or not len(value):
        return empty
    if isinstance(value, tuple):
        return ", ".join(f"[{a}, {b})" for a, b in value)
    return ", ".join(f"[{moment(a, value)}, {moment(b, value)})" for a, b in value)


def intervals(name: str, value: object) -> Array:
    """Frozen (m, 2) array of non-empty, non-negative, sorted, disjoint intervals; overlapping ones are joined."""
    if not checks.floats(name, value).size:
        return freeze(np.zeros((0, 2)))
    array = checks.matrix(name, value, None, 2)
    if np.any(array < 0):
        raise ArgumentError(f"`{name}` must not be negative, got {float(array.min())!r}.")
    empty = np.flatnonzero(array[:, 1] <= array[:, 0])
    if empty.size:
        a, b = array[int(empty[0])]
        raise ArgumentError(
            f"`{name}` must hold intervals [start, stop) with start < stop, got [{float(a)!r}, {float(b)!r}]. "
            "An interval over the end of the period is written as two."
        )
    return freeze(joined(array))


def common(first: Array | None, second: Array | None) -> Array | None:
    """The windows in which both are open; None: always."""
    if first is None or second is None:
        return second if first is None else first
    low = np.maximum(first[:, None, 0], second[None, :, 0]).ravel()
    high = np.minimum(first[:, None, 1], second[None, :, 1]).ravel()
    keep = low < high
    return intervals("available", np.column_stack([low[keep], high[keep]]))


def _windows(value: object) -> Array | Dates | None:
    """Windows as numbers or as dates."""
    if value is None:
        return None
    if isinstance(value, (str, os.PathLike)):
        value = _from_file(os.fspath(value))
    rows = [checks.texts(row) for row in value] if is_list(value) else []
    dates = [row for row in rows if row is not None]
    if dates and len(dates) == len(rows):
        for row in dates:
            if len(row) != 2:
                raise ArgumentError(f"`available` must hold pairs of dates, got {row!r:.60}.")
            parse_date("available", row[0], "UTC"), parse_date("available", row[1], "UTC")
        return tuple((a, b) for a, b in dates)
    return intervals("available", value)


def _from_file(path: str) -> list[list[float]] | list[tuple[str, str]]:
    """Rows of two times of a CSV file, below a line of names if there is one."""
    try:
        found = os.stat(path)
    except FileNotFoundError:
        found = None  # said where it is read
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path!r:.200}: cannot be read ({error}).", path) from None
    if found is not None and not stat.S_ISDIR(found.st_mode):
        if not stat.S_ISREG(found.st_mode):
            raise FileFormatError(f"{path}: must be a plain file of windows, got a device or a pipe.", path)
        if found.st_size > LARGEST:
            raise FileFormatError(f"{path}: must hold windows in at most {LARGEST} bytes, got {found.st_size}.", path)
    lines = [(k, line) for k, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
    rows = [row for _, row in csv_rows(lines, path)]
    if rows and all(_is_name(cell) for cell in rows[0] if cell) and all(rows[0][:2]):
        rows = rows[1:]
    short_of = next((row for row in rows if len(row) < 2 or not row[0] or not row[1]), None)
    if not rows or short_of is not None:
        raise FileFormatError(f"{path}: must hold rows of two times, start and stop, got {short_of or 'none'}.", path)
    try:
        return [[float(row[0]), float(row[1])] for row in rows]
    except ValueError:
        return [(row[0], row[1]) for row in rows]


def _is_name(word: str) -> bool:
    """Whether a word heads a column: it is no number, and no date or time, which begins with a digit."""
    try:
        float(word)
    except ValueError:
        return not word.lstrip("+-., ")[:1].isdigit()
    return False


def from_files(sensors: object, where: str) -> object:
    """The sensors of a requirement file, with files of windows beside or below it.

    Raises ArgumentError if one lies elsewhere: whoever reads a file from others reads nothing but what came with it.
    """
    if not is_table(sensors):
        return sensors
    place = Path(where).parent
    return {
        name: {**terms, "available": _beside(place, f"sensors.{name}.available", str(terms["available"]))}
        if is_table(terms) and is_text(terms.get("available"))
        else terms
        for name, terms in sensors.items()
    }


def _beside(place: Path, key: str, name: str) -> str:
    kinds = PurePosixPath(name), PureWindowsPath(name)
    path = place / name
    try:
        inside = path.resolve().is_relative_to(place.resolve())  # a link may lead elsewhere
    except (OSError, ValueError, RuntimeError):
        inside = False
    if not inside or any(kind.anchor or ".." in kind.parts for kind in kinds):
        raise ArgumentError(f"`{key}` must name a file beside or below the one that names it, got {name!r:.80}.")
    return os.fspath(path)


_SPANS = by_name(list_of(list_of(text, 2)))


def hours_in_file(value: object, place: str) -> object:
    """Spans of opening hours by weekday; hours in words are told how a file says them."""
    if is_text(value) or (is_table(value) and any(is_text(item) for item in value.values())):
        form = '{ "Mon-Fri" = [["08:00", "12:00"], ["13:00", "17:00"]] }'
        raise refuse(place, f"must be spans by weekday, as hours = {form}, got {value!r:.60}")
    return _SPANS(value, place)


DURATION = by_kind({str: text}, positive)
"""A time of a file: a number, or text with a unit of its own."""
_DELAYS = list_of(by_kind({str: text}, nonnegative), 2)
_delay = by_kind({str: text, list: _DELAYS, tuple: _DELAYS}, nonnegative)  # a time, or the least and the most of it
_available = by_kind({str: text}, list_of(by_first({str: list_of(text, 2)}, list_of(nonnegative, 2))))
SENSOR = table(
    {},
    {
        **dict.fromkeys(("price", "noise_bound"), nonnegative),
        "noise_deviation": positive,
        "available": _available,
        "hours": hours_in_file,
        "longest_use": count,
        "spacing": DURATION,
        "result_delay": _delay,
        **dict.fromkeys(("detection_limit", "lowest"), number),
    },
)
"""The table of a sensor in a requirement file, of a design or of a plan."""
CALENDAR = table({"start": text}, {"zone": text, "hours": hours_in_file, "holidays": list_of(text)})
