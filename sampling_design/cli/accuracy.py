"""The command that says how well anybody can know the state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.accuracy.bounds import NoiseBound
from sampling_design.accuracy.projection import Projection
from sampling_design.accuracy.sample_counts import AccuracyByCount
from sampling_design.cli import files, options
from sampling_design.cli.estimate import known_bounds
from sampling_design.cli.settings import Settings, record_table
from sampling_design.errors import ArgumentError
from sampling_design.records.checks import positive, whole
from sampling_design.schedules.sensor import Sensor


@dataclass(frozen=True)
class TimeOptions:
    """When samples are taken, and when their results are in."""

    samples: Annotated[
        str | None,
        typer.Option(
            metavar="N,N,...", help="Without SCHEDULE: so many, evenly spaced in --period; 0 for none at all."
        ),
    ] = None
    period: Annotated[float | None, typer.Option(help="Of --samples [time unit]; no default.")] = None
    timing_tolerance: options.TimingOption = None
    result_delay: Annotated[
        str | None,
        typer.Option(
            help="How long after its sample a result comes at most [time unit], one number or one for each output; "
            "--v-bound then bounds each entry."
        ),
    ] = None


ON_TIME = TimeOptions()
BY_COUNT = "sampling-design/accuracy-by-count/1"  # the format of its JSON
ScheduleOrCounts = Annotated[
    Path | None, typer.Argument(metavar="SCHEDULE", help="Schedule file: .csv or .json; none with --samples or a plan.")
]
WantedError = Annotated[
    str | None, typer.Option("--tolerance", help="Wanted error of each row, one number or with commas between.")
]
WhiteDisturbance = Annotated[
    str | None, typer.Option(help="Intensity of white w [its unit squared times time]: standard deviations beside.")
]
WhiteNoise = Annotated[
    str | None, typer.Option(help="Standard deviation of the noise of a sample, with --w-intensity.")
]
Pair = Annotated[
    str, typer.Option("--projection", help="Two states, FIRST,SECOND: the exact set of errors, drawn with -o.")
]


def accuracy(
    settings: Settings,
    plant_file: options.PlantFile,
    schedule_file: ScheduleOrCounts = None,
    typed: options.BoundOptions = options.UNBOUNDED,
    of: Annotated[str, typer.Option(help="Names of states or outputs, with commas between. Default: all states.")] = "",
    rtol: options.RelativeWidth = 0.01,
    tolerance: WantedError = None,
    w_intensity: WhiteDisturbance = None,
    v_deviation: WhiteNoise = None,
    projection: Pair = "",
    times: TimeOptions = ON_TIME,
    budget: options.NoLimit = None,
) -> None:
    """Bracket the least error that any estimator can guarantee, at the worst time of a schedule.

    With --samples 0,4,8 --period 7 in place of SCHEDULE: without samples, with 4 and with 8 in 7 units of time.

    Example: sampling-design accuracy examples/plants/oscillator.toml out/schedule.csv --w 0.02 --v 0.4
    """
    plant = files.plant(plant_file)
    planned = files.plan_in(plant_file if schedule_file is None else schedule_file)
    schedule, otherwise = None, ", or --samples 0,4,8 --period 7 for evenly spaced ones"
    if times.samples is None and times.period is None:
        path = files.schedule_path(plant_file, schedule_file, otherwise)
        schedule = files.schedule_for(settings, plant, path)
    bounds, names = known_bounds(settings, plant, plant, typed.of(plant), planned, endless=True), options.listed(of)
    for flag, bound, signals in (
        ("--w-bound", bounds["w_bound"], plant.disturbances), ("--v-bound", bounds["v_bound"], plant.outputs),
    ):  # fmt: skip
        if bound is None:
            raise ArgumentError(
                f"`{flag}` is missing{', and the plan has none' if planned else ''}: without a bound on "
                f"{', '.join(signals.names)} nothing can be guaranteed. Give 0 where there is none."
            )
    v = _noise(plant, bounds["v_bound"], times.result_delay)
    seconds = None if budget is None else positive("budget", budget)
    w, rows = bounds["w_bound"], names or None
    if schedule is None:
        idle = {"SCHEDULE": schedule_file, "--initial-error": typed.initial_error, "--tolerance": tolerance}
        idle |= {"--w-intensity": w_intensity, "--v-deviation": v_deviation, "--projection": projection or None}
        by_count = partial(
            sd.accuracy.accuracy_by_count, plant, w_bound=w, v_bound=v, of=rows, rtol=rtol, budget=seconds
        )
        _finish_counts(settings, times, idle, by_count)
        return
    pair = _pair(projection)
    wanted = _wanted(options.numbers("--tolerance", tolerance), len(names) or plant.n_states)
    with settings.progress("accuracy") as progress:
        found = sd.guaranteed_accuracy(
            plant, schedule, w_bound=w, v_bound=v, of=rows, rtol=rtol, budget=seconds,
            initial_error=bounds["initial_error"],
            w_intensity=options.numbers("--w-intensity", w_intensity, plant.disturbances.names),
            v_deviation=options.numbers("--v-deviation", v_deviation, plant.outputs.names),
            timing_tolerance=options.timing(times.timing_tolerance), progress=progress,
        )  # fmt: skip
        cast = None if pair is None else found.projection(*pair)
    _finish(settings, found, cast, wanted)


def _finish_counts(
    settings: Settings, times: TimeOptions, idle: Mapping[str, object], by_count: Callable[..., AccuracyByCount]
) -> None:
    """Write and print what samples buy; leave with 3 where it is not sharp, with 1 where a row has no bound at all."""
    given = [name for name, value in idle.items() if value is not None]
    given += [] if times.timing_tolerance is None else ["--timing-tolerance"]
    if given:
        raise ArgumentError(f"`--samples` are evenly spaced and come on time: leave {', '.join(given)} out.")
    if times.samples is None or times.period is None:
        lost = "--samples" if times.samples is None else "--period"
        raise ArgumentError(f"`{lost}` is missing: so many samples in each period, as --samples 0,4,8 --period 7.")
    counts = np.atleast_1d(np.asarray(options.numbers("--samples", times.samples))).tolist()
    found = by_count([whole("samples", count) for count in counts], period=positive("period", times.period))
    settings.finish(found, {"format": BY_COUNT, **found.to_dict()}, "accuracy")
    if not found.closed:
        raise typer.Exit(3)
    if np.isinf(found.upper[-1]).any():
        raise typer.Exit(1)


def _noise(plant: sd.Plant, bound: NoiseBound, result_delay: str | None) -> NoiseBound:
    """Bounds on the noise; where results come later, as the terms of each sensor."""
    delay = options.numbers("--result-delay", result_delay, plant.outputs.names)
    if delay is None:
        return bound
    both = (np.broadcast_to(np.asarray(each), plant.n_outputs).tolist() for each in (bound, delay))
    return {
        name: Sensor(noise_bound=size, result_delay=out)
        for name, size, out in zip(plant.outputs.names, *both, strict=True)
    }


def _finish(settings: Settings, found: Accuracy, cast: Projection | None, wanted: list[float] | None) -> None:
    """Write, draw and print; the exit code."""
    data, text = found.to_dict(), found.explain()
    if cast is not None:
        data["projection"] = cast.to_dict()
        text += f" {cast.explain()}"
        settings.draw(cast, "projection")
    settings.write_json(data, "accuracy")
    settings.draw(found, "accuracy", tolerance=wanted)
    missed = [] if wanted is None else [k for k, most in enumerate(wanted) if not found.upper[k] <= most]
    for k in missed:
        impossible = found.lower[k] > (wanted or [])[k]
        text += f" {found.rows.names[k]} {'cannot keep' if impossible else 'is not proven to keep'} its tolerance."
    settings.show(data, record_table(found), text)
    if not np.all(found.closed) and not found.timing_tolerance:
        raise typer.Exit(3)
    if missed or np.isinf(found.upper).any():
        raise typer.Exit(1)


def _pair(text: str) -> tuple[str, str] | None:
    """Two names."""
    names = options.listed(text)
    if names and len(names) != 2:
        raise ArgumentError(f"`--projection` must be two names with a comma between, got {text!r}.")
    return (names[0], names[1]) if names else None


def _wanted(value: float | list[float] | None, rows: int) -> list[float] | None:
    """A tolerance for each row."""
    each = [] if value is None else np.ravel(value).tolist()
    if not all(one > 0 for one in each):
        raise ArgumentError(f"`--tolerance` must be positive, got {value!r}.")
    if len(each) > 1 and len(each) != rows:
        raise ArgumentError(f"`--tolerance` must be one number or one for each of {rows} rows, got {len(each)}.")
    return None if value is None else (each * rows)[:rows]
