"""Commands that choose and judge schedules: info, design, sigma."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table as RichTable

import sampling_design as sd
from sampling_design.checkers.strict import is_table
from sampling_design.cli import files
from sampling_design.cli.settings import (
    Settings,
    TimingOption,
    end_bracket,
    end_unobservable,
    record_table,
    table,
    timing,
    timing_number,
)
from sampling_design.design.schedule_design import ScheduleDesign
from sampling_design.errors import ArgumentError
from sampling_design.observability.count.default_window import default_window
from sampling_design.observability.sigma_bracket import coordinates_in
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.functional import split_needed, weighed_over
from sampling_design.plants.modes import ModalSplit
from sampling_design.records.checks import positive
from sampling_design.records.record import short
from sampling_design.schedules.family import AnySchedule
from sampling_design.schedules.time_stamps import parse_date

PlantFile = Annotated[Path, typer.Argument(metavar="PLANT", help="Plant file: .toml, .json, .mat or .npz.")]
ScheduleFile = Annotated[Path, typer.Argument(metavar="SCHEDULE", help="Schedule file: .csv or .json.")]

SECONDS_BOUGHT = 1.0
"""What `design` may take to say what samples buy, where none are needed."""


def info(
    settings: Settings,
    plant_file: PlantFile,
    window: Annotated[float | None, typer.Option(help="Window length for the counts [plant's time unit].")] = None,
) -> None:
    """Show a plant: its modes, which of them must be observable, and how many samples that takes.

    With -o DIR: info.json.

    Example: sampling-design info examples/plants/oscillator.toml
    """
    plant = settings.part(files.plant(plant_file))
    split = sd.plants.split_modes(plant, settings.decay_rate or 0.0)
    tables: list[RichTable | str] = [record_table(plant), _modes(split, plant.time_unit), split.explain()]
    data: dict[str, object] = {"plant": plant.to_dict(), "split": split.to_dict(), "counts": None}
    if split.retained.n_states:
        count = sd.zero_count_bound(split.retained, window_length(settings, split, window))
        tables += [record_table(count), count.explain()]
        left = plant.n_states - split.retained.n_states
        if left:
            kept = split.retained.n_states
            means = "its one retained direction" if kept == 1 else f"its {kept} retained directions"
            others, counts = f"The other {left} decay by themselves and need", "some of them are counted too"
            if left == 1:
                others, counts = "The other one decays by itself and needs", "it may be counted too"
            tables.append(
                f"To determine the state means here: {means}. {others} no samples; with a larger --decay-rate {counts}."
            )
        data["counts"] = count.to_dict()
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "info.json", data)
    settings.show(data, *tables)


def window_length(
    settings: Settings, split: ModalSplit, given: float | None, schedule: AnySchedule | None = None
) -> float:
    """Return the window that was given, or the plant's default with a notice that says so.

    Of a `schedule` it is no shorter than one longest gap for each state: else most windows would hold too few samples.
    """
    if given is not None:
        return positive("window", given)
    length = default_window(split) or 1.0
    if schedule is not None:
        longest = schedule.d_max if schedule.endless else float(np.max(schedule.gaps, initial=0.0))  # from its first on
        length = max(length, split.retained.n_states * longest)
    settings.notice(f"--window not given: {short(length)} {split.plant.time_unit} is used.")
    return length


def schedule_for(settings: Settings, plant: sd.Plant, path: Path) -> AnySchedule:
    """Return the schedule of a file in the plant's unit of time, with a notice where it had another."""
    schedule = files.schedule(path)
    if schedule.time_unit in (None, plant.time_unit):
        return schedule
    settings.notice(f"{path}: times in {schedule.time_unit} are converted to {plant.time_unit}.")
    return schedule.in_unit(plant.time_unit)


def _modes(split: ModalSplit, unit: str) -> RichTable:
    rows = []
    for cluster in split.clusters:
        value = complex(cluster.value)
        if value.imag < 0:
            continue  # its conjugate has a row already
        real = format_eigenvalue(value.real, grain=split.offset)
        written = f"{real} ± {short(value.imag)}i" if value.imag else real
        period = short(2 * np.pi / value.imag) if value.imag else "-"
        part = "retained" if cluster in split.retained_clusters else "left to decay"
        rows.append([written, str(cluster.multiplicity), str(cluster.index), period, part])
    return table("Modes", [f"eigenvalue [1/{unit}]", "multiplicity", "index", f"period [{unit}]", "part"], rows)


def design(
    settings: Settings,
    plant_file: PlantFile,
    requirement_file: Annotated[
        Path | None, typer.Argument(metavar="REQUIREMENT", help="Requirement file (.toml); without it, defaults.")
    ] = None,
    window: Annotated[float | None, typer.Option(help="Window length that must be observable.")] = None,
    period: Annotated[float | None, typer.Option(help="The schedule repeats after this time.")] = None,
    spacing: Annotated[float | None, typer.Option(help="Least time between two samples.")] = None,
    samples: Annotated[int | None, typer.Option(help="Exactly so many samples per period.")] = None,
    target_sigma: Annotated[float | None, typer.Option(help="Fewest samples that reach this sigma.")] = None,
    cost_limit: Annotated[float | None, typer.Option(help="Most that the measurements of a period may cost.")] = None,
    timing_tolerance: TimingOption = None,
    branches: Annotated[
        int | None, typer.Option(help="Boxes of schedules cut in two to narrow the upper bound; more take longer.")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="DATE", help="Date of time 0 (ISO 8601): writes calendar.csv and schedule.ics too."),
    ] = None,
    zone: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Time zone of --start and of the calendars, as Europe/Berlin; default UTC."),
    ] = None,
) -> None:
    """Design an endless periodic schedule, with its proven sigma and a bound that none can beat.

    The work ends by itself once the bound is at most 3 % above sigma, or where more cuts help little; Ctrl-C ends it at
    any time (exit code 130). Files hold what is proven by then.

    Example: sampling-design design examples/plants/oscillator.toml examples/requirements/oscillator.toml -o out
    """
    plant = files.plant(plant_file)
    flags: dict[str, object] = {"window": window, "period": period, "spacing": spacing, "samples": samples}
    flags.update(target_sigma=target_sigma, cost_limit=cost_limit, decay_rate=settings.decay_rate)
    late = None if timing_tolerance is None else timing(timing_tolerance, timing_number)
    flags.update(timing_tolerance=late, of=settings.asked_rows)
    if settings.folder() is None and start is not None:  # said before the design is computed, not after
        raise ArgumentError("`--start` writes a calendar, so it needs a folder. Give --output DIR.")
    if zone is not None and start is None:
        raise ArgumentError(f"`--zone` {zone} says where --start is local time: give --start DATE with it.")
    zero = None if start is None else parse_date("--start", start, zone).isoformat()
    requirement = files.requirement(requirement_file)
    requirement = requirement.replace(**{key: value for key, value in flags.items() if value is not None})
    with settings.progress("design") as progress:
        rng = np.random.default_rng(settings.seed)
        given = {} if branches is None else {"branches": branches}
        result = sd.design_schedule(plant, requirement, rng=rng, budget=settings.budget, progress=progress, **given)
    for name, value in result.defaults_used.items():
        said = [f"{each.replace('_', ' ')} {of}" for each, of in value.items()] if is_table(value) else [value]
        settings.notice(str(value) if name == "notice" else f"--{name.replace('_', '-')} not given: {said[0]} is used.")
    _write_design(settings, result, zero, zone)
    folder, told = settings.folder(), list[str]()
    if folder is not None and result.schedule is not None and result.sigma > 0:
        told = [f"Next: sampling-design certify {plant_file} {folder / 'schedule.csv'} -o {folder}"]
    if result.decay is not None:
        told = _bought(result, plant_file)
    settings.show(result.to_dict(), record_table(result), *_samples(result), result.explain(), *told)
    end_unobservable(result)


def _bought(result: ScheduleDesign, plant_file: Path) -> list[str]:
    """Where no samples are needed: the accuracy without any and with some, and the line for other bounds."""
    decay, plant, sensors = result.decay, result.split.plant, result.requirement.sensors
    assert decay is not None
    known = {name: term.noise_bound for name, term in sensors.items()}
    noise = list[float]()
    for name, scale in zip(plant.outputs.names, plant.outputs.scales.tolist(), strict=True):
        own = known.get(name)
        noise.append(scale if own is None else own)
    found = sd.accuracy.accuracy_by_count(
        plant, decay.counts, period=decay.to_a_tenth, w_bound=plant.disturbances.scales, v_bound=noise,
        of=result.requirement.of, budget=SECONDS_BOUGHT,
    )  # fmt: skip
    which = "the plant's scales, and the noise bounds of its sensors" if sensors else "the plant's scales"
    line = (
        f"sampling-design accuracy {plant_file} --samples {','.join(map(str, decay.counts))} "
        f"--period {decay.to_a_tenth:g} --w-bound W --v-bound V"
    )
    return [f"{found.explain()} The bounds are typical sizes: {which}. With your own:", f"Next: {line}"]


def _write_design(settings: Settings, result: ScheduleDesign, zero: str | None, zone: str | None) -> None:
    folder = settings.folder()
    if folder is None:
        return
    settings.write_json(folder / "design.json", result.to_dict())
    if result.schedule is not None and result.sigma > 0:
        paths, notes = sd.design.write_design(result, folder, start=zero, zone=zone)
        for path in paths:
            settings.wrote(path)
        for note in notes:
            settings.notice(note)
        settings.draw(result, folder / "design.png", origin=zero)


def _samples(result: ScheduleDesign) -> list[RichTable | str]:
    if result.schedule is None:
        return []
    schedule, unit = result.schedule, result.schedule.time_unit or ""
    times = zip(schedule.times, schedule.gaps, strict=True)
    rows = [[str(i + 1), short(t, 9), short(g)] for i, (t, g) in enumerate(times)]
    return [table("Samples of one period", ["sample", f"time [{unit}]", f"gap before [{unit}]"], rows)]


def sigma(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    window: Annotated[float | None, typer.Option(help="Window length [plant's time unit].")] = None,
    rigorous: Annotated[bool, typer.Option("--rigorous", help="Prove the lower bound in ball arithmetic.")] = False,
    timing_tolerance: TimingOption = None,
) -> None:
    """Prove how observable a plant is along a schedule: the least sigma over every real window position.

    Example: sampling-design sigma examples/plants/oscillator.toml out/schedule.csv --window 6.28
    """
    plant = settings.part(files.plant(plant_file))
    schedule = schedule_for(settings, plant, schedule_file)
    split = split_needed(plant, settings.decay_rate or 0.0)
    if not split.retained.n_states:
        settings.show({"sigma": None, "split": split.to_dict()}, split.explain())
        return
    length = window_length(settings, split, window, schedule)
    split = weighed_over(split, length)
    with settings.progress("sigma") as progress:
        result = sd.window_sigma(
            split.retained, schedule, length, budget=settings.budget, progress=progress, rigorous=rigorous,
            timing_tolerance=timing(timing_tolerance or "0", timing_number),
        )  # fmt: skip
    end_bracket(settings, replace(result, coordinates=coordinates_in(split)), "sigma")
