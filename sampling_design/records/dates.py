"""Dates with their offsets: read from text, by the clocks of a zone, and so much real time after one another."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError
from sampling_design.records import checks

MICROSECONDS = 1_000_000  # of a second: dates are exact to one


def zoned_date(text: str) -> datetime:
    """Return an ISO 8601 date; a zone behind it in brackets says whose clocks tell it (RFC 9557).

    Raises ValueError if it is no such date, ArgumentError if there is no such zone, or its clocks skip or repeat it.
    """
    text = text.replace("\0", "?")  # Python reads a date up to a zero byte
    stem, bracket, zone = text.partition("[")
    date = datetime.fromisoformat(stem if zone.endswith("]") else text)
    if not bracket:
        return date
    place = time_zone(zone[:-1])
    if date.tzinfo is None and not unambiguous(date, place):
        raise ArgumentError(f"{text} is skipped or repeated by the clocks of {place}: give its offset.")
    return date.replace(tzinfo=place) if date.tzinfo is None else date.astimezone(place)


def unambiguous(date: datetime, place: tzinfo) -> bool:
    """Whether clocks there show this local date exactly once: they neither skip nor repeat it."""
    early, late = (date.replace(tzinfo=place, fold=fold).utcoffset() for fold in (0, 1))
    return early == late


def zoned_text(date: datetime) -> str:
    """Return a date as `zoned_date` reads it: with its zone, where that has a name and its clocks may change."""
    named = isinstance(date.tzinfo, ZoneInfo) and date.tzinfo.key != "UTC"
    return date.isoformat() + (f"[{date.tzinfo}]" if named else "")


def date_after(zero: datetime, seconds: float) -> datetime:
    """Return the date so much real time after another one with an offset, by the clocks of its zone.

    Raises OverflowError if it lies outside the years 1 to 9999.
    """
    return (zero.astimezone(UTC) + timedelta(microseconds=round(seconds * MICROSECONDS))).astimezone(zero.tzinfo)


def parse_date(name: str, value: str | datetime, zone: str | None = None) -> datetime:
    """Return an ISO 8601 date with its offset; naive means in `zone` (its IANA name), by default UTC.

    Raises ArgumentError if it is no such date, there is no such zone, or the zone's clocks skip or repeat it.
    """
    return date_in(name, value, UTC if zone is None else time_zone(zone))


def date_in(name: str, value: str | datetime, place: tzinfo) -> datetime:
    """Return an ISO 8601 date with its offset; naive means by the clocks of `place`.

    Raises ArgumentError if it is no such date, or these clocks skip or repeat it.
    """
    date = None
    try:
        date = value if isinstance(value, datetime) else zoned_date(value)
    except ArgumentError as error:
        raise ArgumentError(f"`{name}` names no instant: {error}") from None
    except (TypeError, ValueError, AttributeError):
        pass
    if date is None or date != date:  # pandas counts its missing date among dates
        came = repr(value)[:60] if is_text(value) else checks.described(value)
        raise ArgumentError(f"`{name}` must be a date like 2026-01-05T08:00 (ISO 8601), got {came}.")
    if date.tzinfo is not None:
        return date
    if not unambiguous(date, place):
        raise ArgumentError(f"`{name}` = {value} is skipped or repeated by the clocks of {place}: give its offset.")
    return date.replace(tzinfo=place)


class UnmixedDates:
    """Dates all with a zone or all without, unless it is `said` which clocks those without one are by."""

    def __init__(self, said: bool):
        self.said, self._first = said, ("", False)

    def take(self, date: datetime, called: str) -> None:
        """Take in another date. Raises ArgumentError if it has a zone and the first one has none, or the reverse."""
        own, (first, theirs) = date.tzinfo is not None, self._first
        if not first:
            self._first = called, own
        elif own != theirs and not self.said:
            named, plain = (called, first) if own else (first, called)
            raise ArgumentError(
                f"{plain} has no zone, and {named} has one: give its offset (+01:00), or say the `zone` of dates "
                "without one."
            )


def passed(since: datetime, date: datetime) -> timedelta:
    """The real time between two dates with offsets; of two in one zone, Python subtracts what the clocks show."""
    return date.astimezone(UTC) - since.astimezone(UTC)


def time_zone(zone: str) -> ZoneInfo:
    """Return a time zone by its IANA name. Raises ArgumentError if there is none of that name."""
    try:
        return ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, TypeError, OSError):
        city = f"/{zone}".replace(" ", "_").casefold()
        near = [name for name in sorted(available_timezones()) if name.casefold().endswith(city)]
        raise ArgumentError(
            f"`zone` must be the name of a time zone like Europe/Berlin, got {zone!r}."
            + (f" Did you mean {near[0]!r}?" if near else "")
        ) from None


def day_in(cell: str) -> date | None:
    """A date without an hour."""
    try:
        return date.fromisoformat(cell)
    except ValueError:
        return None
