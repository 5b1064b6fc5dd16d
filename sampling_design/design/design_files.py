"""The files of a design: its schedule, and where time 0 has a date the calendars of it."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

from sampling_design.design.schedule_design import ScheduleDesign
from sampling_design.errors import ArgumentError
from sampling_design.records.dates import parse_date, passed
from sampling_design.records.signatures import checked
from sampling_design.records.units import SECONDS
from sampling_design.schedules.calendar import clock_changes, repeats_by_rule, write_calendar_csv, write_ics
from sampling_design.schedules.files import write_schedule

AHEAD = 400  # days in which the next change of a zone's clocks is looked for


@checked
def write_design(
    design: ScheduleDesign, folder: str | os.PathLike[str], *, origin: str | None = None, zone: str | None = None
) -> tuple[list[Path], list[str]]:
    """Write schedule.csv and, where time 0 has a date, calendar.csv and schedule.ics.

    Parameters
    ----------
    design : ScheduleDesign
    folder : path
    origin : str, optional
        Date of time 0 (ISO 8601).
    zone : str, optional
        Time zone of the calendars, as Europe/Berlin; default UTC.

    Returns
    -------
    list of Path, list of str
        The files, and what there is to know of them.

    Raises
    ------
    ArgumentError
        If the design has no schedule.
    FileFormatError
        If a file cannot be written.

    Notes
    -----
    Where closed hours are local and the clocks of the zone change, schedule.ics ends there; a period that no calendar
    repeats by rule is written out once.
    """
    if design.schedule is None:
        raise ArgumentError("`design` must be a ScheduleDesign with a schedule, or there is no file to write.")
    place = Path(folder)
    if origin is None:
        return [write_schedule(design.schedule, place / "schedule.csv")], []
    dated, span, notes = replace(design.schedule, origin=origin), None, []
    requirement = design.requirement
    closed = bool(requirement.forbidden.size) or any(s.available is not None for s in requirement.sensors.values())
    if zone is not None and closed:
        zero = parse_date("origin", origin, zone)
        before, after = next(clock_changes(zone, zero, zero + timedelta(days=AHEAD)), (None, None))
        if before is not None and after is not None:
            span = passed(zero, after) / timedelta(seconds=SECONDS[design.plant.time_unit])
            notes.append(
                f"The clocks of {zone} change on {after:%Y-%m-%d}: schedule.ics ends there, since the same times would "
                "be other hours. Design again with a start after it; a plan keeps local hours all year."
            )
    if span is None and not repeats_by_rule(dated):
        span = dated.period
        notes.append("The period is no whole number of seconds, which no calendar repeats: schedule.ics holds one.")
    title = f"{design.plant.name or 'plant'}: sample"
    files = [
        write_schedule(dated, place / "schedule.csv"),
        write_calendar_csv(dated, place / "calendar.csv", zone=zone),
    ]
    return [*files, write_ics(dated, place / "schedule.ics", summary=title, span=span, zone=zone)], notes
