"""Opening hours of a place: which local times of which days are allowed, and the real times that they name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from itertools import pairwise
from typing import TypeAlias

from sampling_design._record import Plain, Record
from sampling_design.errors import ArgumentError
from sampling_design.schedules.time_stamps import parse_date, time_zone

WeekHours: TypeAlias = dict[str, tuple[tuple[str, str], ...]]
DAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
WEEK = len(DAYS)
"""Days after which a weekday alone is no date."""

_CLOCK = re.compile(r"([01]\d|2[0-3]):([0-5]\d)|24:00", re.ASCII)
ALWAYS: WeekHours = dict.fromkeys(DAYS, (("00:00", "24:00"),))


def minutes(clock: str) -> int:
    """Minutes since midnight of "HH:MM"."""
    return int(clock[:2]) * 60 + int(clock[3:])


def week_hours(name: str, value: Mapping[str, object]) -> WeekHours:
    """Return opening hours by weekday; days that are not named are closed.

    Keys are weekdays, or several of them: "Mon-Fri".

    Raises
    ------
    ArgumentError
        If a day or a clock time is not understood, or an interval is empty.
    """
    found: WeekHours = {}
    for key, spans in value.items():
        for day in _days(name, str(key)):
            found[day] = _spans(f"{name}.{key}", spans)
    return {day: found[day] for day in DAYS if day in found}


def _days(name: str, key: str) -> tuple[str, ...]:
    first, _, last = key.partition("-")
    last = last or first
    if first not in DAYS or last not in DAYS or DAYS.index(last) < DAYS.index(first):
        raise ArgumentError(f"`{name}` must name weekdays like Mon or Mon-Fri, got {key!r:.60}.")
    return DAYS[DAYS.index(first) : DAYS.index(last) + 1]


def _spans(name: str, spans: object) -> tuple[tuple[str, str], ...]:
    found = []
    for span in spans if isinstance(spans, Sequence) and not isinstance(spans, str) else [spans]:
        pair = list(span) if isinstance(span, Sequence) and not isinstance(span, str) else []
        right = len(pair) == 2 and all(isinstance(c, str) and _CLOCK.fullmatch(c) for c in pair)
        if not right or minutes(pair[0]) >= minutes(pair[1]):
            raise ArgumentError(f'`{name}` must hold spans like ["08:00", "17:00"], got {span!r:.60}.')
        found.append((pair[0], pair[1]))
    return tuple(found)


def is_open(hours: WeekHours, weekday: int, minute: float) -> bool:
    """Whether a minute of a weekday (0 is Monday) lies in half-open hours."""
    spans = hours.get(DAYS[weekday], ())
    return any(minutes(a) <= minute < minutes(b) for a, b in spans)


@dataclass(frozen=True, eq=False, repr=False)
class OpeningCalendar(Record):
    """The calendar of the place where samples are taken.

    Parameters
    ----------
    start : str
        Local date at which the first period begins (ISO 8601), at midnight unless it has a time.
    zone : str
        IANA name of the time zone, as Europe/Berlin.
    hours : dict of str to list of (str, str), optional
        Opening hours by weekday, "Mon-Fri": [("08:00", "17:00")], half-open; days not named are closed. Default:
        always open.
    holidays : sequence of str
        Closed dates.

    Raises
    ------
    ArgumentError
        If a date, zone, day or clock time is not understood.

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

    def __post_init__(self) -> None:
        time_zone(self.zone)
        first = parse_date("start", self.start).replace(tzinfo=None)
        object.__setattr__(self, "start", first.isoformat(timespec="minutes"))
        if self.hours is not None:
            object.__setattr__(self, "hours", week_hours("hours", self.hours))
        object.__setattr__(self, "holidays", tuple(sorted(_day(day).isoformat() for day in self.holidays)))

    @property
    def first(self) -> datetime:
        """Local clock time (naive) at which the first period begins."""
        return datetime.fromisoformat(self.start)

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
        return (self.instant(clock).astimezone(UTC) - self.instant(0.0).astimezone(UTC)) / timedelta(minutes=1)

    def clock(self, elapsed: float) -> float:
        """Minutes of clock since the start at which so many real minutes have passed."""
        real = self.instant(0.0).astimezone(UTC) + timedelta(minutes=elapsed)
        return (real.astimezone(time_zone(self.zone)).replace(tzinfo=None) - self.first) / timedelta(minutes=1)

    def is_open(self, clock: float, own: WeekHours | None = None, *, holidays: bool = False) -> bool:
        """Whether the place (and a sensor with hours of its own) is open at a clock time; holidays if asked."""
        there = self.local(clock)
        minute = there.hour * 60 + there.minute + there.second / 60
        if holidays and there.date().isoformat() in self.holidays:
            return False
        weekday = there.weekday()
        return is_open(self.open_hours(), weekday, minute) and (own is None or is_open(own, weekday, minute))

    def closed(self, length: float, own: WeekHours | None = None) -> list[tuple[float, float]]:
        """Stretches of so many minutes of clock after the start in which the place, or a sensor, is closed.

        Holidays are not among them: a plan is about ordinary days.
        """
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

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        data: dict[str, Plain] = {"start": self.start, "zone": self.zone}
        if self.hours is not None:
            data["hours"] = {day: [list(span) for span in spans] for day, spans in self.open_hours().items()}
        return {**data, "holidays": list(self.holidays)} if self.holidays else data


def _day(value: object) -> date:
    try:
        return date.fromisoformat(str(value))
    except ValueError:
        raise ArgumentError(f"`holidays` must be dates like 2026-05-01, got {value!r:.60}.") from None
