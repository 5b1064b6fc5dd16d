"""Commands that make a calendar and say when to sample next: plan, next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

import sampling_design as sd
from sampling_design.accuracy.readings import PartialReading, as_typed
from sampling_design.checkers.strict import is_text
from sampling_design.cli import files
from sampling_design.cli.options import TimingOption, number_or_text, shell_word, timing
from sampling_design.cli.settings import Settings, record_table, table
from sampling_design.errors import ArgumentError
from sampling_design.planning.dates import plan_dates
from sampling_design.planning.plan_record import Plan
from sampling_design.records.checks import whole
from sampling_design.records.dates import zoned_date
from sampling_design.records.file_io import check_columns
from sampling_design.schedules.opening import WEEK


def plan(
    settings: Settings,
    plant_file: Annotated[
        Path, typer.Argument(metavar="PLANT", help="Plant file, or a plan requirement that holds its plant.")
    ],
    requirement_file: Annotated[
        Path | None, typer.Argument(metavar="REQUIREMENT", help="Plan requirement (.toml).")
    ] = None,
    periods: Annotated[int, typer.Option(help="Periods that the calendar is written out for.")] = 4,
    search_seconds: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="Work of the search, as seconds of a core; what follows may take as much again, and 2 s.",
        ),
    ] = 60.0,
    timing_tolerance: TimingOption = None,
    person: Annotated[str, typer.Option(metavar="NAME", help="Who takes the samples, for the sheet.")] = "",
    compare: Annotated[
        Path | None, typer.Option(metavar="PLAN", help="Another plan (plan.json) to set beside this one.")
    ] = None,
) -> None:
    """Make a calendar that keeps wanted accuracies at the least cost, with a bound that no other plan can beat.

    With -o DIR: calendar (plan.ics), sheet, form to fill in, picture, and files for the other commands; the page "From
    opening hours to a calendar" of the documentation goes through them. Ctrl-C ends the search: files of the best plan
    that it holds are written, if there is one (exit code 130).

    Example: sampling-design plan examples/plans/oscillator.toml -o out/plan
    """
    requirement, plant = files.plan_requirement(plant_file, requirement_file)
    whole("periods", periods, 1)
    if timing_tolerance is not None:
        requirement = requirement.replace(timing_tolerance=timing(timing_tolerance))
    if settings.output is not None:  # found out before the search, not behind it
        check_columns(f"{plant_file}", plant.outputs.names)
    other = None if compare is None else files.plan(compare)
    with settings.progress("plan") as progress:
        result = sd.plan_samples(plant, requirement, search_seconds=search_seconds, progress=progress)
    dates = plan_dates(result, periods) if requirement.calendar is not None and result.keeps else None
    folder = settings.folder()
    if folder is not None:
        paths, notes = sd.planning.write_plan(result, folder, dates, person=person)
        settings.wrote(*paths, notes=notes)
        settings.draw(result, "plan")
    comparison = None if other is None else other.compare(result, ("before", "now"))
    if comparison is not None:
        settings.write_json(comparison.to_dict(), "comparison")
        settings.draw(comparison, "comparison")
    tables: list[Table | str] = [record_table(result), _times(result), result.explain()]
    if dates is not None and dates.exceptions:
        tables += [record_table(dates), dates.explain()]
    if comparison is not None:
        lines = [[label, *said] for label, said in comparison.lines()]
        tables += [table("Comparison", ["", *comparison.names], lines), comparison.explain()]
    if folder is not None:
        file = folder / "plan.json"
        first = " --initial-error ERROR" if result.error_bounds["initial_error"] is None else ""
        tables += [
            f"Next: sampling-design next {shell_word(file)} [MEASUREMENTS.csv]",
            f"Next: sampling-design compare {shell_word(file)} MEASUREMENTS.csv",
            f"Next: sampling-design estimate {shell_word(file)} MEASUREMENTS.csv{first} -o {shell_word(folder)}",
        ]
    settings.show(result.to_dict(), *tables)
    if not result.keeps and requirement.aim == "cheapest":
        raise typer.Exit(3)


def next_sample(
    settings: Settings,
    plan_file: Annotated[Path, typer.Argument(metavar="PLAN", help="Plan file (plan.json).")],
    measurements_file: Annotated[
        Path | None, typer.Argument(metavar="MEASUREMENTS", help="What was measured so far (.csv).")
    ] = None,
    now: Annotated[
        str | None,
        typer.Option(metavar="DATE", help="Local date, or time passed since the start; default: the last sample."),
    ] = None,
    awaited: Annotated[
        list[str] | None,
        typer.Option(metavar="'SENSOR DATE'", help="A sample that was taken and whose result is not in; repeat it."),
    ] = None,
) -> None:
    """Say when the next sample must be taken at the latest, so that every tolerance is kept, now and afterwards.

    "By" a time: any earlier one will do, too. "At" a time, where it is later than the plan's own next sample or samples
    must be spaced: that very time is proven, and an earlier one is not.

    Where one cannot be kept (exit code 1): since when, what is known now, and which sample brings it back soonest. So
    it is before the first samples of a plan, unless its requirement says what is known then (`initial_error`).

    Exit code 3: nothing is proven within `--budget`.

    Example: sampling-design next out/plan/plan.json --now 7
    """
    result = files.plan(plan_file)
    record = None if measurements_file is None else _record(settings, result, measurements_file)
    out = [_awaited(settings, result, text) for text in awaited or ()]
    found = sd.next_sample(result, record, now=_now(settings, result, now), awaited=out, budget=settings.budget)
    settings.finish(found, found.to_dict(), "next")
    if not found.keeps:
        raise typer.Exit(1 if found.proven or found.complete else 3)


def _record(settings: Settings, result: Plan, path: Path) -> list[tuple[float, list[PartialReading | float], None]]:
    """The measurements in the time that has passed since the plan's start; dates without a zone are the plan's."""
    calendar = result.requirement.calendar
    zone = None if calendar is None else calendar.zone
    rows = files.measurements(settings, path, result.plant, result.schedule.origin, zone)
    found = dict[float, list[PartialReading | float]]()
    for k in np.flatnonzero(rows.measured.any(axis=1)).tolist():
        y = found.setdefault(float(rows.times[k]), [np.nan] * rows.y.shape[1])
        for j in np.flatnonzero(np.isfinite(rows.y[k])).tolist():
            y[j] = 0.0  # whatever was read
        for each in rows.censored[k] if rows.censored else ():
            y[each.output] = as_typed(each)
    return [(t, found[t], None) for t in sorted(found)]


def _awaited(settings: Settings, result: Plan, text: str) -> tuple[float, str]:
    """A sensor and when it was read, as `lab 2026-03-02T09:00`."""
    name, _, when = text.strip().partition(" ")
    t = _now(settings, result, when.strip() or None, "--awaited")
    if t is None:
        raise ArgumentError(f"`--awaited` must be a sensor and when it was read, as 'lab 3.5', got {text!r}.")
    return t, name


def _now(settings: Settings, result: Plan, text: str | None, flag: str = "--now") -> float | None:
    """A date, or a number in the plant's time unit."""
    if text is None:
        return None
    calendar, when = result.requirement.calendar, number_or_text(text)
    t = result.elapsed(flag, when)
    if calendar is not None and is_text(when) and zoned_date(when).tzinfo is None:
        settings.notice(f"Dates without a zone are read in {calendar.zone}.")
    return t


def _times(result: Plan) -> Table:
    """The samples of one period."""
    calendar, unit = result.requirement.calendar, result.plant.time_unit
    rows, names = [], result.plant.outputs.names
    form = "%a %H:%M" if result.minutes(result.schedule.period) <= WEEK * 1440 else "%a %d %b %H:%M"
    for t, mask in zip(result.schedule.times, result.chosen[result.chosen.any(axis=1)], strict=True):
        when = f"{t:.6g}" if calendar is None else f"{calendar.local(result.minutes(float(t))):{form}}"
        rows.append([when, ", ".join(name for name, m in zip(names, mask, strict=True) if m)])
    return table("Samples of one period", [f"time [{unit}]" if calendar is None else "local time", "sensors"], rows)
