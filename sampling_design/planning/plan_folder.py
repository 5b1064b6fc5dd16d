"""The files of a plan: for the other commands, for calendars, and for whoever takes the samples."""

from __future__ import annotations

import os
from pathlib import Path

from sampling_design.planning.dates import PlanDates
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.sampling_sheet import write_form, write_sheet
from sampling_design.plants.files import write_plant
from sampling_design.records.file_io import to_json, write_text
from sampling_design.records.signatures import checked
from sampling_design.schedules.calendar import write_calendar_csv, write_ics
from sampling_design.schedules.files import write_schedule


@checked
def write_plan(
    plan: PlanFigures, folder: str | os.PathLike[str], dates: PlanDates | None = None, *, person: str = ""
) -> tuple[list[Path], list[str]]:
    """Write plan.json, plant.toml, schedule.csv and the certificate; where there are dates calendars, sheet and form.

    Parameters
    ----------
    plan : Plan
    folder : path
    dates : PlanDates, optional
        Of a plan with a calendar: plan.ics, calendar.csv, dates.csv, form.csv and sheet.html are of these.
    person : str
        Who takes the samples, for the sheet.

    Returns
    -------
    list of Path, list of str
        The files, and what there is to know of them.

    Raises
    ------
    FileFormatError
        If a file cannot be written.
    """
    place, notes = Path(folder), list[str]()
    files = [
        write_text(place / "plan.json", to_json(plan.to_dict())),
        write_plant(plan.plant, place / "plant.toml"),
        write_schedule(plan.schedule, place / "schedule.csv"),
    ]
    if plan.certificate is not None:
        files.append(plan.certificate.save(place / "certificate.json"))
    elif "certificate" in plan.left_out:
        why = (
            "interrupted" if plan.status == "interrupted" else "the seconds of the search were spent before it was made"
        )
        notes.append(f"certificate.json is not written: {why}.")
    if dates is not None and dates.entries and plan.requirement.calendar is not None:
        real, zone = dates.schedule(), plan.requirement.calendar.zone
        title = f"{plan.plant.name or 'plant'}: sample"
        files += [
            write_calendar_csv(real, place / "calendar.csv", zone=zone),
            write_schedule(real, place / "dates.csv"),
            write_form(dates, place / "form.csv"),
            write_ics(real, place / "plan.ics", summary=title, span=real.times[-1] + 1.0, zone=zone),
            write_sheet(dates, place / "sheet.html", person=person),
        ]
    return files, notes
