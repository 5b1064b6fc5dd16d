"""Opening hours of a place: which local times of which days are allowed, and the real times that they name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_list
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.dates import parse_date, passed, time_zone, zoned_date
from sampling_design.records.record import PlainRecord

WeekHours: TypeAlias = dict[str, tuple[tuple[str, str], ...]]
DAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
WEEK = len(DAYS)
"""Days after which a weekday alone is no date."""

_CLOCK = re.compile(r"([01]\d|2[0-3]):([0-5]\d)|24:00", re.ASCII)
ALWAYS: WeekHours = dict.fromkeys(DAYS, (("00:00", "24:00"),))


def minutes(clock: str) -> int:
    """Minutes since midnight of "HH:MM"."""
    return int(clock[:2]) * 60 + int(clock[3:])


def week_hours(name: str, value: object) -> WeekHours:
    """Return opening hours by weekday; days that are not named are closed.

    Keys are weekdays, or several of them: "Mon-Fri". Hours that end no later than they begin end on the next day:
    ("22:00", "06:00") on Sun is until Mon 06:00. Raises ArgumentError if a day or a clock time is not understood, or an
    interval is empty.
    """
    own: WeekHours = {}
    for key, spans in checks.mapping(name, value, "a table of spans by weekday").items():
        for day in _days(name, str(key)):
            own[day] = _spans(f"{name}.{key}", spans)
    found = {day: [(a, b if minutes(a) < minutes(b) else "24:00") for a, b in spans] for day, spans in own.items()}
    for day, spans in own.items():
        following = DAYS[(DAYS.index(day) + 1) % WEEK]
        for a, b in spans:
            if 0 < minutes(b) < minutes(a):
                found.setdefault(following, []).append(("00:00", b))
    return {day: tuple(sorted(found[day])) for day in DAYS if day in found}


def _days(name: str, key: str) -> tuple[str, ...]:
    first, _, last = key.partition("-")
    last = last or first
    if first not in DAYS or last not in DAYS or DAYS.index(last) < DAYS.index(first):
        raise ArgumentError(f"`{name}` must name weekdays like Mon or Mon-Fri, got {key!r:.60}.")
    return DAYS[DAYS.index(first) : DAYS.index(last) + 1]


def _spans(name: str, spans: object) -> tuple[tuple[str, str], ...]:
    found = []
    for span in spans if is_list(spans) else [spans]:
        pair = checks.texts(span) or ()
        if len(pair) != 2 or not all(map(_CLOCK.fullmatch, pair)) or pair[0] == pair[1] or pair[0] == "24:00":
            raise ArgumentError(
                f'`{name}` must hold spans like ["08:00", "17:00"] or, past midnight, ["22:00", "06:00"], '
                f"got {span!r:.60}."
            )
        found.append((pair[0], pair[1]))
    return tuple(found)


def is_open(hours: WeekHours, weekday: int, minute: float) -> bool:
    """Whether a minute of a weekday (0 is Monday) lies in half-open hours."""
    spans = hours.get(DAYS[weekday], ())
    return any(minutes(a) <= minute < minutes(b) for a, b in spans)


@dataclass(frozen=True, eq=False, repr=False)
class OpeningCalendar(PlainRecord):
    """The calendar of the place where samples are taken.

    Parameters
    ----------
    start : str
        Local date at which the first period begins (ISO 8601), at midnight unless it has a time; an offset must be the
        zone's then.
    zone : str
        IANA name of the time zone, as Europe/Berlin.
    hours : dict of str to list of (str, str), optional
        Opening hours by weekday, "Mon-Fri": [("08:00", "17:00")], half-open; ("22:00", "06:00") ends on the next day.
        Days not named are closed. Default: always open.
    holidays : sequence of str
        Closed dates.

    Raises
    ------
    ArgumentError
        If a date, zone, day or clock time is not understood, or the zone's clocks never show the start with its offset.

    Examples
    --------
    >>> place = OpeningCalendar("2026-03-23", "Europe/Berlin", {"Mon-Fri": [("08:00", "17:00")]})
    >>> place.instant(7 * 1440 + 480).isoformat()  # a week and eight hours of local clock later
    '2026-03-30T08:00:00+02:00'
    """

    start: str
    zone: str = "UTC"
    hours: Mapping[str, object] | None = None
    holidays: Sequence[str] = ()
    _plain = "start zone hours? holidays?"

    def __post_init__(self) -> None:
        self._check(hours=week_hours)
        start = _local_start(self.start, self.zone).isoformat(timespec="minutes")
        self._hold(start=start, holidays=tuple(sorted(_day(day).isoformat() for day in self.holidays)))

    @cached_property
    def first(self) -> datetime:
        """Local clock time (naive) at which the first period begins."""
        return datetime.fromisoformat(self.start)

    @cached_property
    def begun(self) -> datetime:
        """The real time of the start, with its offset."""
        return self.instant(0.0)

    def open_hours(self) -> WeekHours:
        """Hours by weekday."""
        return ALWAYS if self.hours is None else self.hours  # type: ignore[return-value]

    def local(self, clock: float) -> datetime:
        """Local clock time (naive) so many minutes of clock after the start; each day has 1440 of them."""
        return self.first + timedelta(minutes=clock)

    def instant(self, clock: float) -> datetime:
        """Return the real time that a clock time names, with its offset.

        A time that the clocks skip is taken as far after the change; one that they repeat, its first occurrence.
        """
        place = time_zone(self.zone)
        there = self.local(clock).replace(tzinfo=place)
        return there.astimezone(UTC).astimezone(place)

    def elapsed(self, clock: float) -> float:
        """Real minutes from the start to a clock time."""
        there = self.local(clock).replace(tzinfo=time_zone(self.zone))
        return clock - _ahead(there, self.begun)

    def elapsed_at(self, date: datetime) -> float:
        """Real minutes from the start to a date; without an offset it is one of the place's clocks."""
        return passed(self.begun, parse_date("date", date, self.zone)) / timedelta(minutes=1)

    def date(self, elapsed: float) -> datetime:
        """The local date, with its offset, so many real minutes after the start."""
        real = self.begun.astimezone(UTC) + timedelta(minutes=elapsed)
        return real.astimezone(time_zone(self.zone))

    def clock(self, elapsed: float) -> float:
        """Minutes of clock since the start at which so many real minutes have passed."""
        return elapsed + _ahead(self.date(elapsed), self.begun)

    def is_skipped(self, clock: float) -> bool:
        """Whether the clocks are put forward over a clock time, so that it names no time of its day."""
        return self.instant(clock).replace(tzinfo=None) != self.local(clock)

    def is_open(self, clock: float, own: WeekHours | None = None, *, holidays: bool = False) -> bool:
        """Whether the place (and a sensor with hours of its own) is open at a clock time of an ordinary week.

        `holidays`: of its very day, which may be a holiday, and whose clocks may skip it.
        """
        there = self.local(round(clock, 6))
        minute = there.hour * 60 + there.minute + there.second / 60
        if holidays and (there.date().isoformat() in self.holidays or self.is_skipped(round(clock, 6))):
            return False
        weekday = there.weekday()
        return is_open(self.open_hours(), weekday, minute) and (own is None or is_open(own, weekday, minute))

    def closed(self, length: float, own: WeekHours | None = None) -> list[tuple[float, float]]:
        """Stretches of so many minutes of clock after the start in which the place, or a sensor, is closed.

        Holidays are not among them: a plan is about ordinary days.
        """
        own = None if own is None else week_hours("own", own)
        day, late = 1440, self.first.hour * 60 + self.first.minute
        spans = [span for hours in (self.open_hours(), own or {}) for each in hours.values() for span in each]
        clocks = {0, *(minutes(clock) for span in spans for clock in span)}
        days = range(int(length // day) + 2)
        marks = sorted({min(max(float(k * day + clock - late), 0.0), length) for k in days for clock in clocks})
        found: list[tuple[float, float]] = []
        for start, stop in pairwise(marks):
            if self.is_open(start, own):
                continue
            joined = bool(found) and found[-1][1] == start
            found[-1:] = [(found[-1][0], stop)] if joined else [*found[-1:], (start, stop)]
        return found

    def _rows(self) -> list[tuple[str, str]]:
        hours = [(day, ", ".join(f"{a} to {b}" for a, b in spans)) for day, spans in self.open_hours().items()]
        return [("start", self.start), ("zone", self.zone), *hours, ("holidays", ", ".join(self.holidays) or "none")]

    def explain(self) -> str:
        """Say when the place is open."""
        days = "; ".join(f"{d} {', '.join(f'{a} to {b}' for a, b in s)}" for d, s in self.open_hours().items())
        return f"From {self.start} ({self.zone}): {days}."


@dataclass(frozen=True)
class PlanClock:
    """What the clocks of a plan show beside the real time: both since its start [the plant's time unit].

    Without a calendar, and before the start, they are the same.
    """

    calendar: OpeningCalendar | None = None
    minutes: float = 1.0  # of the plant's time unit
    until: float = np.inf  # real time from which on the clocks are changed no more

    def elapsed(self, clock: npt.ArrayLike) -> Array:
        """Real times at which the clocks show so much for the first time."""
        given = np.asarray(clock, dtype=float)
        if self.calendar is None:
            return np.array(given)
        last, later = self._last()
        real = [self.calendar.elapsed(c * self.minutes) / self.minutes if 0 < c < last else c for c in given.flat]
        return np.where(given < last, np.reshape(real, given.shape), given - later)

    def clock_time(self, elapsed: npt.ArrayLike) -> Array:
        """What the clocks show at real times."""
        given = np.asarray(elapsed, dtype=float)
        if self.calendar is None:
            return np.array(given)
        later = self._last()[1]
        clock = [self.calendar.clock(t * self.minutes) / self.minutes if 0 < t < self.until else t for t in given.flat]
        return np.where(given < self.until, np.reshape(clock, given.shape), given + later)

    def _last(self) -> tuple[float, float]:
        """What the clocks show when they are changed for the last time, and by how much they are ahead from then on."""
        if self.calendar is None or not np.isfinite(self.until):
            return np.inf, 0.0
        last = self.calendar.clock(max(self.until, 0.0) * self.minutes) / self.minutes
        return last, last - max(self.until, 0.0)


def _ahead(date: datetime, zero: datetime) -> float:
    """Minutes by which the clocks are put forward between two dates of a zone."""
    return ((date.utcoffset() or timedelta(0)) - (zero.utcoffset() or timedelta(0))) / timedelta(minutes=1)


def _local_start(start: str, zone: str) -> datetime:
    """The local clock time (naive) of a start, with an offset or without.

    Raises ArgumentError if it is no date, or not one that the clocks of the zone show once, with that offset.
    """
    parse_date("start", start)
    given = zoned_date(str(start))
    if given.second or given.microsecond:
        raise ArgumentError(f"`start` must be at a whole minute, got {start!s:.60}.")
    early, late = (given.replace(tzinfo=time_zone(zone), fold=fold).utcoffset() for fold in (0, 1))
    if early != late:
        raise ArgumentError(
            f"`start` = {start} is skipped or repeated by the clocks of {zone}: begin at a time that they show once."
        )
    local = given.replace(tzinfo=None)
    if given.tzinfo is not None and given.utcoffset() != early:
        raise ArgumentError(
            f"`start` = {start} has another offset than the clocks of {zone}, which show "
            f"{local.replace(tzinfo=time_zone(zone)).isoformat()}. Leave the offset out: the date is local."
        )
    return local


def _day(value: object) -> date:
    try:
        return date.fromisoformat(str(value))
    except ValueError:
        raise ArgumentError(f"`holidays` must be dates like 2026-05-01, got {value!r:.60}.") from None
