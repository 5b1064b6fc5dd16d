"""Commands that choose and judge schedules: info, design, sigma."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import sampling_design as sd
from sampling_design._files import to_json, write_text
from sampling_design._record import short
from sampling_design.cli.settings import Settings, record_table, table

PlantFile = Annotated[Path, typer.Argument(metavar="PLANT", help="Plant file: .toml, .json, .mat or .npz.")]
ScheduleFile = Annotated[Path, typer.Argument(metavar="SCHEDULE", help="Schedule file: .csv or .json.")]


def info(
    settings: Settings,
    plant_file: PlantFile,
    window: Annotated[float | None, typer.Option(help="Window length for the counts [plant's time unit].")] = None,
) -> None:
    """Show a plant: its modes, which of them must be seen, and how many samples that takes.

    Example: sampling-design info examples/plants/satellite.toml
    """
    plant = sd.read_plant(plant_file)
    split = sd.split_modes(plant, settings.decay_rate or 0.0)
    modes = _mode_rows(split, plant.time_unit)
    tables: list[Any] = [record_table(plant), modes, split.explain()]
    data: dict[str, Any] = {"plant": plant.to_dict(), "split": split.to_dict(), "counts": None}
    if split.retained.n_states:
        length = sd.default_window(split.retained) if window is None else window
        if window is None:
            settings.notice(f"window not given: {short(length)} {plant.time_unit} is used.")
        count = sd.zero_count_bound(split.retained, length)
        tables += [record_table(count), count.explain()]
        data["counts"] = count.to_dict()
    settings.show(data, *tables)


def _mode_rows(split: Any, unit: str) -> Any:
    rows = []
    for cluster in split.clusters:
        value = complex(cluster.value)
        period = f"{short(2 * np.pi / abs(value.imag))}" if value.imag else "-"
        kept = "retained" if cluster.retained else "left to decay"
        rows.append([_eigenvalue(value), str(cluster.multiplicity), str(cluster.index), period, kept])
    return table("Modes", [f"eigenvalue [1/{unit}]", "multiplicity", "index", f"period [{unit}]", "part"], rows)


def _eigenvalue(value: complex) -> str:
    return short(value.real) if not value.imag else f"{short(value.real)} ± {short(abs(value.imag))}i"


def design(
    settings: Settings,
    plant_file: PlantFile,
    requirement_file: Annotated[
        Path | None, typer.Argument(metavar="[REQUIREMENT]", help="Requirement file (.toml); without it, defaults.")
    ] = None,
    window: Annotated[float | None, typer.Option(help="Window length that must be observable.")] = None,
    period: Annotated[float | None, typer.Option(help="The schedule repeats after this time.")] = None,
    spacing: Annotated[float | None, typer.Option(help="Least time between two samples.")] = None,
    samples: Annotated[int | None, typer.Option(help="Exactly so many samples per period.")] = None,
    target_sigma: Annotated[float | None, typer.Option(help="Fewest samples that reach this sigma.")] = None,
) -> None:
    """Design an endless periodic schedule, with its proven sigma and a bound that none can beat.

    Example: sampling-design design examples/plants/satellite.toml examples/requirements/satellite.toml -o out
    """
    plant = sd.read_plant(plant_file)
    flags = {"window": window, "period": period, "spacing": spacing, "samples": samples, "target_sigma": target_sigma}
    flags["decay_rate"] = settings.decay_rate
    given = {key: value for key, value in flags.items() if value is not None}
    requirement = sd.Requirement() if requirement_file is None else sd.read_requirement(requirement_file)
    requirement = requirement.with_changes(**given)
    with settings.progress("design") as progress:
        result = sd.design_schedule(plant, requirement, budget=settings.budget, seed=settings.seed, progress=progress)
    for name, value in result.defaults_used.items():
        settings.notice(f"{name} not given: {value} is used.")
    folder = settings.folder()
    if folder is not None:
        settings.wrote(write_text(folder / "design.json", to_json(result.to_dict())))
        if result.schedule is not None:
            settings.wrote(sd.write_schedule(result.schedule, folder / "schedule.csv"))
            settings.wrote(_picture(result, folder / "design.png"))
    settings.show(result.to_dict(), record_table(result), *_sample_table(result), result.explain())


def _sample_table(result: Any) -> list[Any]:
    if result.schedule is None:
        return []
    schedule = result.schedule
    rows = [
        [str(i + 1), short(t, 9), short(g)] for i, (t, g) in enumerate(zip(schedule.times, schedule.gaps, strict=True))
    ]
    unit = schedule.time_unit or ""
    return [table("Samples of one period", ["sample", f"time [{unit}]", f"gap before [{unit}]"], rows)]


def _picture(record: Any, path: Path) -> Path:
    from sampling_design import plotting

    return plotting.save(record, path)


def sigma(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    window: Annotated[float | None, typer.Option(help="Window length [plant's time unit].")] = None,
) -> None:
    """Prove how well a schedule sees the plant: the least sigma over every real window position.

    Example: sampling-design sigma examples/plants/satellite.toml out/schedule.csv --window 5554
    """
    plant = sd.read_plant(plant_file)
    schedule = sd.read_schedule(schedule_file)
    retained = sd.split_modes(plant, settings.decay_rate or 0.0).retained
    if not retained.n_states:
        settings.show(
            {"sigma": None}, "No samples needed: every mode decays. Ask for a faster decay with --decay-rate."
        )
        return
    length = sd.default_window(retained) if window is None else window
    if window is None:
        settings.notice(f"window not given: {short(length)} {plant.time_unit} is used.")
    with settings.progress("sigma") as progress:
        result = sd.window_sigma(retained, schedule, length, budget=settings.budget, progress=progress)
    folder = settings.folder()
    if folder is not None:
        settings.wrote(write_text(folder / "sigma.json", to_json(result.to_dict())))
        settings.wrote(_picture(result, folder / "sigma.png"))
    settings.show(result.to_dict(), record_table(result), result.explain())
    if result.upper == 0 or (result.closed and result.lower == 0):
        raise typer.Exit(1)
    if not result.closed:
        raise typer.Exit(3)


COMMANDS = (info, design, sigma)
