"""The command that opens the explorer in a browser."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from sampling_design.cli import files
from sampling_design.cli.options import DisturbanceBound, NoiseBound, numbers
from sampling_design.cli.settings import Settings
from sampling_design.design.problem.requirement import Requirement
from sampling_design.errors import ArgumentError
from sampling_design.planning.requirement import PlanRequirement
from sampling_design.plants.plant import Plant
from sampling_design.records import checks


def explore(
    settings: Settings,
    plant_file: Annotated[
        Path | None,
        typer.Argument(metavar="PLANT", help="Plant file (.toml), or a plan requirement that holds its plant."),
    ] = None,
    requirement_file: Annotated[
        Path | None,
        typer.Argument(metavar="REQUIREMENT", help="Requirement, or plan requirement (.toml); without it, defaults."),
    ] = None,
    schedule_file: Annotated[
        Path | None, typer.Option("--schedule", metavar="FILE", help="Schedule to begin with; default: saved, or even.")
    ] = None,
    w_bound: DisturbanceBound = None,
    v_bound: NoiseBound = None,
    tolerance: Annotated[str | None, typer.Option(help="Error of each state that would do, commas between.")] = None,
    scene: Annotated[str | None, typer.Option(help="A ready-made scene for lectures, instead of files.")] = None,
    port: Annotated[int, typer.Option(help="Port on this machine; 0 takes a free one.")] = 0,
    idle: Annotated[float, typer.Option(help="End when nobody has asked for so many seconds.")] = 3600.0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser.")] = True,
) -> None:
    """Drag samples on a time line in the browser and see what they prove; Save writes schedule.csv to -o DIR.

    Example: sampling-design explore examples/plants/oscillator.toml examples/requirements/oscillator.toml -o out
    """
    from sampling_design.explorer import SCENES, ScheduleExplorer, serve
    from sampling_design.explorer import scene as ready_made

    if scene is not None:
        if plant_file is not None:
            raise ArgumentError(f"`--scene` {scene} brings its own plant, got {plant_file} too. Leave one out.")
        explorer = ready_made(checks.word("--scene", scene, SCENES))
        explorer.folder = settings.folder()
    else:
        plant, requirement = _wanted(settings, plant_file, requirement_file)
        schedule = None if schedule_file is None else files.schedule_for(settings, plant, schedule_file)
        if schedule is not None and not schedule.endless:
            raise ArgumentError(
                f"`--schedule` must be a schedule that repeats, got {schedule_file}, which has no period."
            )
        wanted = numbers("--tolerance", tolerance)
        explorer = ScheduleExplorer(
            plant,
            requirement,
            schedule,
            w_bound=numbers("--w-bound", w_bound, plant.disturbances.names),
            v_bound=numbers("--v-bound", v_bound, plant.outputs.names),
            tolerance=None if wanted is None else np.ravel(wanted),
            folder=settings.folder(),
        )

    def ready(address: str) -> None:
        settings.show({"address": address}, f"The explorer is open at {address}")
        settings.notice("Ctrl-C ends it.")
        if browser and sys.stdout.isatty():
            import webbrowser

            webbrowser.open(address)

    serve(explorer, port, idle, ready)


def _wanted(
    settings: Settings, plant_file: Path | None, requirement_file: Path | None
) -> tuple[Plant, Requirement | PlanRequirement]:
    """The plant and what is wanted of its schedule; a plan requirement may hold its plant."""
    if plant_file is None:
        raise ArgumentError("`PLANT` is missing: give a plant file, or one of the scenes with `--scene`.")
    if files.is_plan_requirement(requirement_file or plant_file):
        wanted, plant = files.plan_requirement(plant_file, requirement_file)
        return plant, wanted
    requirement = files.requirement(requirement_file)
    if settings.decay_rate is not None:
        requirement = requirement.replace(decay_rate=settings.decay_rate)
    return files.plant(plant_file), requirement
