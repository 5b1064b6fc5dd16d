"""The command that says how well anybody can know the state."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.cli import reading
from sampling_design.cli.plan import PlantFile, ScheduleFile, schedule_for
from sampling_design.cli.settings import Settings, record_table, save_picture
from sampling_design.errors import ArgumentError

NUMBERS = "One number bounds the norm; numbers with commas between bound each entry; 0 for none."


def accuracy(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    w_bound: Annotated[
        str | None, typer.Option("--w-bound", "--w", help=f"Bound on the disturbance w(t). {NUMBERS}")
    ] = None,
    v_bound: Annotated[
        str | None, typer.Option("--v-bound", "--v", help=f"Bound on the measurement noise v. {NUMBERS}")
    ] = None,
    of: Annotated[str, typer.Option(help="Names of states or outputs, with commas between. Default: all states.")] = "",
    rtol: Annotated[float, typer.Option(help="Relative width of the brackets.")] = 0.01,
) -> None:
    """Bracket the least error that any estimator can guarantee on an endless schedule, at its worst time.

    Example: sampling-design accuracy examples/plants/oscillator.toml out/schedule.csv --w 0.02 --v 0.4
    """
    plant = reading.plant(plant_file)
    schedule = schedule_for(settings, plant, schedule_file)
    if not isinstance(schedule, sd.PeriodicSchedule):
        raise ArgumentError(
            f"`SCHEDULE` {schedule_file} ends: accuracy is bracketed on a schedule that repeats (period=...)."
        )
    names = [name.strip() for name in of.split(",") if name.strip()]
    bounds = (_numbers("--w-bound", w_bound), _numbers("--v-bound", v_bound))
    with settings.progress("accuracy"):
        found = sd.accuracy(
            plant, schedule, w_bound=bounds[0], v_bound=bounds[1], of=names if names else None, rtol=rtol
        )
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "accuracy.json", found.to_dict())
        settings.wrote(save_picture(found, folder / "accuracy.png"))
    settings.show(found.to_dict(), record_table(found), found.explain())
    if not np.all(found.closed):
        raise typer.Exit(3)
    if np.isinf(found.upper).any():
        raise typer.Exit(1)


def _numbers(name: str, text: str | None) -> float | list[float] | None:
    """None, a number, or a list of numbers."""
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise ArgumentError(f"`{name}` must be numbers with commas between, got {text!r}.") from None
    return values if len(values) > 1 else values[0]


COMMANDS = (accuracy,)
