"""What the laboratory fills in: a sheet of paper (who, when, which sensor), and a file of measurements."""

from __future__ import annotations

import os
from html import escape
from itertools import groupby
from pathlib import Path

from sampling_design.errors import FileFormatError
from sampling_design.planning.dates import PlanDates
from sampling_design.planning.figures import PlanFigures
from sampling_design.records.file_io import csv_cell, write_text
from sampling_design.records.record import above, short
from sampling_design.records.signatures import checked

STYLE = """
@page { size: A4 portrait; margin: 15mm; }
body { font: 11pt/1.35 sans-serif; color: #111; margin: 1.5em auto; max-width: 190mm; }
h1 { font-size: 15pt; margin: 0 0 .2em; } p { margin: .2em 0 .8em; }
table { border-collapse: collapse; width: 99.7%; } thead { display: table-header-group; }
th, td { border: 1px solid #777; padding: .32em .5em; text-align: left; } th { background: #eee; }
tr { break-inside: avoid; } td.value { min-width: 5em; } td.no { background: #ddd; }
td.day { font-weight: bold; } td.blank { min-width: 7em; } .note { font-size: 9pt; color: #333; }
"""


@checked
def write_sheet(dates: PlanDates, path: str | os.PathLike[str], *, person: str = "") -> Path:
    """Write the dates of a plan as a page that prints on A4: a line for each sample with a cell for each value.

    Raises FileFormatError if the ending is another, or the file cannot be written.

    Parameters
    ----------
    path : path
        Ends in .html.
    person : str
        Who takes the samples; else a line to write the name on.

    Returns
    -------
    Path
        Where it was written.
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise FileFormatError(f"{path}: a sheet ends in .html, got {Path(path).suffix!r}.", os.fspath(path))
    plan, names = dates.plan, dates.plan.plant.outputs.names
    assert plan.requirement.calendar is not None
    head = "".join(f"<th>{escape(label)}</th>" for label in plan.plant.outputs.labels())
    lines = []
    for day, entries in groupby(dates.entries, key=lambda entry: entry.date.date()):
        today = list(entries)
        for k, entry in enumerate(today):
            first = f"<td class='day' rowspan='{len(today)}'>{day:%a %d %b %Y}</td>" if k == 0 else ""
            cells = "".join(f"<td class='{'value' if name in entry.outputs else 'no'}'></td>" for name in names)
            note = " (extra)" if entry.added else ""
            time = f"<td>{entry.date:%H:%M}{note}</td>"
            lines.append(f"<tr>{first}{time}{cells}<td class='blank'></td><td class='blank'></td></tr>")
    notes = "".join(f"<p class='note'>{escape(note)}</p>" for note in _notes(dates))
    title = f"{plan.plant.name or 'Plan'}: samples"
    text = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style></head><body>
<h1>{escape(title)}</h1>
<p>Taken by: {escape(person) or "_" * 28} &nbsp; Times are local ({escape(plan.requirement.calendar.zone)}).<br>
{escape(_promised(dates.plan))}</p>
<table><thead><tr><th>Day</th><th>Time</th>{head}<th>Taken at</th><th>Initials</th></tr></thead>
<tbody>
{chr(10).join(lines)}
</tbody></table>
{notes}
</body></html>
"""
    return write_text(path, text)


def _promised(plan: PlanFigures) -> str:
    """What the samples keep and what they do not, each goal with its tolerance."""
    said: dict[bool, list[str]] = {True: [], False: []}
    for goal, reached in zip(plan.goals, plan.reached.tolist(), strict=True):
        unit, kept = f" {goal.unit}" * bool(goal.unit), reached <= goal.tolerance
        bound = f"within {short(goal.tolerance)}{unit}"
        if not kept:
            bound = f"{above(reached, 4)}{unit} instead of {short(goal.tolerance)}{unit}"
        said[kept].append(f"{goal.name} {bound} ({goal.when()})")
    words = {True: "Kept by these samples", False: "Not kept, even if every sample is taken"}
    return " ".join(f"{words[kept]}: {'; '.join(goals)}." for kept, goals in said.items() if goals)


def _notes(dates: PlanDates) -> list[str]:
    """What whoever takes the samples should know: odd days, what may go wrong, and what nobody has looked at."""
    notes = []
    for e in dates.exceptions:
        doubt = "" if e.ratio <= 1 else " The tolerances are not kept around it."
        doubt = doubt or ("" if e.proven else " That the tolerances are kept around it was not proven.")
        notes.append(f"{e.date}: {e.what}.{doubt}")
    plan = dates.plan
    if plan.robustness is not None:
        notes.append(f"{'Away from those days: ' if dates.exceptions else ''}{plan.robustness.explain()}")
    if plan.left_out:
        notes.append(f"Not looked at when this plan was made: {plan.missing()}.")
    return notes


def write_form(dates: PlanDates, path: str | os.PathLike[str]) -> Path:
    """Write the dates of a plan as a file of measurements whose values are still to be filled in.

    Raises FileFormatError if the file cannot be written.
    """
    names = dates.plan.plant.outputs.names
    lines = [",".join(["date", *(csv_cell(name) for name in names)])]
    lines += [entry.date.isoformat() + "," * len(names) for entry in dates.entries]
    return write_text(path, "\n".join(lines) + "\n")
