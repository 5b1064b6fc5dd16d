"""What a newcomer says in words and numbers: hours of the week, values by name, and the requirements made of them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.cli.options import by_name, listed, number_or_text
from sampling_design.errors import ArgumentError
from sampling_design.records.checks import positive
from sampling_design.records.units import SECONDS
from sampling_design.schedules.opening import DAYS, OpeningCalendar, WeekHours, minutes, week_hours
from sampling_design.schedules.sensor import duration

MOST_DAYS = 400
A_MONDAY = "2001-01-01"
"""Time zero of opening hours where no date is given."""
GRID = "1 h"  # of a plan with a calendar, where none is given: a week is then 168 steps
_HOUR = r"(\d{1,2}(?:\.\d+|:[0-5]\d)?)"
_SPAN = re.compile(rf"\s*(?:([A-Z][a-z]{{2}}(?:-[A-Z][a-z]{{2}})?)\s+)?{_HOUR}\s*-\s*{_HOUR}\s*", re.ASCII)


@dataclass(frozen=True)
class RequirementFlags:
    """The flags of `new` that say what is wanted, as they were typed."""

    period: Annotated[
        float | None,
        typer.Option(help="It repeats after this [time unit]; default: one oscillation, of a plan with dates a week."),
    ] = None
    samples: Annotated[
        int | None,
        typer.Option(help="So many samples in a period, for `design`; default: what the zero count asks for."),
    ] = None
    spacing: Annotated[
        float | None, typer.Option(help="Least time between two samples [time unit]; default: period/(4 samples).")
    ] = None
    open_hours: Annotated[
        str,
        typer.Option(
            "--open",
            metavar="HOURS",
            help='When somebody is there: 7-19, or "Mon-Fri 8:30-12, 13-17"; default: always.',
        ),
    ] = ""
    weekend: Annotated[bool, typer.Option("--weekend/--no-weekend", help="Samples on Saturday and Sunday too.")] = True
    within: Annotated[
        str,
        typer.Option(metavar="ERRORS", help="How well it must be known, for `plan`: 0.5, or level=0.5,decaying_1=0.8."),
    ] = ""
    noise: Annotated[
        str, typer.Option(metavar="BOUNDS", help="No reading errs more: one number, or blood=0.1,saliva=0.4.")
    ] = ""
    prices: Annotated[
        str, typer.Option(metavar="PRICES", help="Of one measurement: 12, or blood=12,saliva=3; 1 where not said.")
    ] = ""
    visit: Annotated[float, typer.Option(metavar="PRICE", help="Of every visit, whatever is measured.")] = 0.0
    disturbance: Annotated[
        str, typer.Option(metavar="BOUNDS", help="No disturbance of a state is stronger: 0.01, or level=0.01.")
    ] = ""
    start: Annotated[str, typer.Option(metavar="DATE", help="Local date of time zero, as 2026-03-02.")] = ""
    zone: Annotated[str, typer.Option(metavar="NAME", help="Time zone, as Europe/Berlin; default UTC.")] = ""
    holidays: Annotated[str, typer.Option(metavar="DATES", help="Closed dates, with commas between.")] = ""
    grid: Annotated[
        str,
        typer.Option(
            metavar="TIME",
            help='Samples of a plan lie on multiples of it [time unit], or "15 min"; default: 1 h with dates.',
        ),
    ] = ""


def positive_times(flag: str, text: str, unit: str) -> list[float]:
    """Positive times in `unit` with commas between, each a number or one with a unit of its own."""
    try:
        return [duration(flag, number_or_text(part), unit) for part in text.split(",") if part.strip()]
    except ArgumentError:
        raise ArgumentError(
            f'`{flag}` must be positive numbers of {unit}, or times like "3 d", with commas between, got {text!r:.40}.'
        ) from None


def week(text: str, weekend: bool) -> WeekHours | None:
    """Return opening hours by weekday of a text like "8-17" or "Mon-Fri 8:30-12, 13-17, Sat 9-12"; None: always."""
    if not text.strip():
        return None if weekend else week("0-24", weekend=False)
    days, found = "Mon-Sun", dict[str, list[tuple[str, str]]]()
    for part in text.split(","):
        said = _SPAN.fullmatch(part)
        first, last = (_clock(said[2]), _clock(said[3])) if said else (1, 0)
        if said is None or not first < last <= 1440:
            raise ArgumentError(
                "`--open` must be two hours of a day, as 7-19, or more of them, as "
                f'"Mon-Fri 8:30-12, 13-17, Sat 9-12" or, over midnight, "0-6, 22-24", got {text!r:.60}.'
            )
        days = said[1] or days
        span = tuple(f"{m // 60:02d}:{m % 60:02d}" for m in (first, last))
        for day in week_hours("--open", {days: [span]}):
            found.setdefault(day, []).append((span[0], span[1]))
    for day, spans in found.items():
        spans.sort()
        if any(minutes(a[1]) > minutes(b[0]) for a, b in pairwise(spans)):
            raise ArgumentError(f"`--open` has hours of {day} that overlap, got {text!r:.60}.")
    return {day: tuple(found[day]) for day in DAYS if day in found and (weekend or day not in DAYS[5:])}


def _clock(text: str) -> int:
    """Minutes since midnight of 7, 7.5 or 7:30."""
    hour, colon, minute = text.partition(":")
    return int(hour) * 60 + int(minute) if colon else round(float(text) * 60)


def requirement(asked: RequirementFlags, unit: str, span: float) -> sd.Requirement:
    """Return what a schedule must keep: a window and, unless told, a period of one oscillation, in whole days."""
    hours = week(asked.open_hours, asked.weekend)
    place = OpeningCalendar(asked.start or A_MONDAY, asked.zone or "UTC", hours)  # a slip is named, hours or none
    if asked.zone and not asked.start:
        raise ArgumentError(f"`--zone` {asked.zone} says where --start is local time: give --start DATE with it.")
    period = span if asked.period is None else positive("period", asked.period)
    if hours is not None:
        period = whole_days(period, unit, hours, given=asked.period is not None)
    minute, shut = 60.0 / SECONDS[unit], list[tuple[float, float]]()
    if hours is not None:
        days = period / (1440 * minute)
        if days > MOST_DAYS:
            raise ArgumentError(
                f"`--open` closes every day: a period of {days:.4g} days is too long, at most {MOST_DAYS}."
            )
        shut = place.closed(period / minute)
    return sd.Requirement(
        window=period,
        period=period,
        samples=asked.samples,
        spacing=asked.spacing,
        forbidden=np.multiply(shut, minute).reshape(-1, 2),
    )


def whole_days(period: float, unit: str, hours: WeekHours, *, given: bool) -> float:
    """Return a period after which opening hours repeat as well: whole days, or weeks where the days differ."""
    days = 1 if len(hours) == 7 and len(set(hours.values())) == 1 else 7
    repeat = days * 86400.0 / SECONDS[unit]
    count = period / repeat
    if abs(count - round(count)) <= 1e-9 * count and round(count):
        return period
    if given:
        raise ArgumentError(
            f"`--period` must be whole {'days' if days == 1 else 'weeks'}, since opening hours repeat so: "
            f"a multiple of {repeat:g} {unit}, got {period!r}."
        )
    return float(np.ceil(count) * repeat)


NEEDED = {"noise": "how far a reading may be off", "disturbance": "how strong what disturbs may be"}


def plan_requirement(asked: RequirementFlags, plant: sd.Plant, span: float) -> sd.PlanRequirement | None:
    """Return what a plan must keep; None where nothing was said of accuracy."""
    if not asked.within.strip():
        for flag in ("noise", "prices", "visit", "disturbance", "holidays", "grid"):
            if getattr(asked, flag):
                raise ArgumentError(f"`--{flag}` belongs to a plan. Say how well what must be known: --within.")
        return None
    for flag, why in NEEDED.items():
        if not getattr(asked, flag).strip():
            raise ArgumentError(f"`--within` makes a plan, which needs --{flag}: {why}.")
    states, outputs = plant.states.names, plant.outputs.names
    goals = by_name("--within", asked.within, (*states, *outputs), outputs[:1])
    noise = by_name("--noise", asked.noise, outputs, outputs)
    prices = by_name("--prices", asked.prices, outputs, outputs)
    disturbance = by_name("--disturbance", asked.disturbance, states, states)
    hours = week(asked.open_hours, asked.weekend)
    if not asked.start and (hours is not None or asked.holidays):
        raise ArgumentError("`--start` is missing: opening hours and holidays of a plan need a date to count from.")
    calendar = None
    if asked.start:
        calendar = {
            "start": asked.start,
            "zone": asked.zone or "UTC",
            **({} if hours is None else {"hours": hours}),
            "holidays": listed(asked.holidays),
        }
    sensors = {
        name: {"price": prices.get(name, 1.0), **({"noise_bound": noise[name]} if name in noise else {})}
        for name in outputs
    }
    bounds = [disturbance.get(name, 0.0) for name in states]
    return sd.PlanRequirement(
        goals,  # numbers are tolerances
        period=asked.period if calendar is not None or asked.period is not None else span,
        grid=number_or_text(asked.grid) if asked.grid else GRID if calendar is not None else None,
        spacing=asked.spacing,
        visit_price=asked.visit,
        w_bound=bounds,
        sensors=sensors,  # tables of terms
        calendar=calendar,  # a table of its keys
    )
