"""Commands that make a calendar and say when to sample next: plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

import sampling_design as sd
from sampling_design.cli import reading
from sampling_design.cli.settings import Settings, record_table, save_picture, table
from sampling_design.errors import ArgumentError
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.requirement_file import requirement_and_plant


def plan(
    settings: Settings,
    plant_file: Annotated[
        Path, typer.Argument(metavar="PLANT", help="Plant file, or a plan requirement that holds its plant.")
    ],
    requirement_file: Annotated[
        Path | None, typer.Argument(metavar="REQUIREMENT", help="Plan requirement (.toml).")
    ] = None,
) -> None:
    """Make a calendar that keeps wanted accuracies at the least cost, with a bound that no other plan can beat.

    Example: sampling-design plan examples/plans/oscillator.toml -o out
    """
    requirement, plant = requirement_and_plant(plant_file if requirement_file is None else requirement_file)
    if requirement_file is not None:
        plant = reading.plant(plant_file)
    if plant is None:
        raise ArgumentError(f"`PLANT` is missing: {plant_file} is a requirement that holds no plant.")
    with settings.progress("plan") as progress:
        result = sd.plan(plant, requirement, budget=settings.budget, progress=progress)
    _write(settings, result)
    settings.show(result.to_dict(), record_table(result), _times(result), result.explain())
    if not result.keeps and requirement.aim == "cheapest":
        raise typer.Exit(3)


def _write(settings: Settings, result: Plan) -> None:
    folder = settings.folder()
    if folder is None:
        return
    settings.write_json(folder / "plan.json", result.to_dict())
    settings.wrote(sd.write_plant(result.plant, folder / "plant.toml"))
    settings.wrote(sd.write_schedule(result.schedule, folder / "schedule.csv"))
    settings.wrote(save_picture(result, folder / "plan.png"))


def _times(result: Plan) -> Table:
    """The samples of one period."""
    calendar, unit = result.requirement.calendar, result.plant.time_unit
    rows, names = [], result.plant.outputs.names
    for t, mask in zip(result.schedule.times, result.chosen[result.chosen.any(axis=1)], strict=True):
        when = f"{t:.6g}" if calendar is None else f"{calendar.local(result.minutes(float(t))):%a %H:%M}"
        rows.append([when, ", ".join(name for name, m in zip(names, mask, strict=True) if m)])
    return table("Samples of one period", [f"time [{unit}]" if calendar is None else "local time", "sensors"], rows)


COMMANDS: tuple[Callable[..., None], ...] = (plan,)
