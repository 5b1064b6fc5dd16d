"""Commands that compare what was promised with what happens: validate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.cli import files, options
from sampling_design.cli.estimate import known_bounds, or_scales
from sampling_design.cli.settings import Settings, table
from sampling_design.cli.sigma import window_length
from sampling_design.errors import ArgumentError
from sampling_design.plants.functional import split_needed, weighed_over
from sampling_design.records.checks import positive, whole
from sampling_design.records.file_io import write_text
from sampling_design.records.record import below
from sampling_design.records.units import time_factor


def validate(
    settings: Settings,
    plant_file: options.PlantFile,
    schedule_file: options.ScheduleFile = None,
    certificate_file: options.CertificateFile = None,
    runs: Annotated[int, typer.Option(help="Random trials.")] = 200,
    duration: Annotated[
        float | None, typer.Option(help="Length of a trial [time unit]; default: three horizons, and at least 40 gaps.")
    ] = None,
    typed: options.BoundOptions = options.UNBOUNDED,
    eta: options.Eta = None,
    workers: options.WorkerCount = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Certify a schedule, then try to break the promise: random and worst noise, constraints, inequality (16).

    Exit code 1 if a promise is broken. A plan (plan.json) for PLANT or SCHEDULE brings its bounds. With -o DIR:
    report.md, report.json and validation.png; an interrupted one is taken up again where it was.

    Example: sampling-design validate examples/plants/oscillator.toml out/schedule.csv -o out
    """
    full = files.plant(plant_file)
    whole("runs", runs, 1)  # before a certificate is sought
    if duration is not None:
        positive("duration", duration)
    plant = settings.part(full)
    schedule_file = files.schedule_path(plant_file, schedule_file)
    schedule = files.schedule_for(settings, plant, schedule_file)
    bounds = known_bounds(settings, plant, full, typed.of(plant), files.plan_in(schedule_file))
    if certificate_file is not None:
        certificate = files.sampling_certificate(certificate_file, plant)
    else:
        with settings.progress("certificate") as progress:
            certificate = sd.certify(plant, schedule, eta=eta, progress=progress, **or_scales(plant, bounds))
    for name, bound in bounds.items():
        if bound is None:
            flag = name.replace("_", "-")
            settings.notice(f"--{flag} not given: the plant's scales are used, typical sizes, and trials stay in them.")
    if eta is None and certificate_file is None:
        rate = f"{below(certificate.eta)} per {plant.time_unit}"
        settings.notice(f"--eta not given: {rate}, one over the longest gap, is used.")
    folder = settings.folder()
    journal = None if folder is None else folder / "validation.journal"
    with settings.progress("validate") as progress, options.workforce(workers, scheduler) as pool:
        report = sd.validate(
            plant, schedule, certificate, runs=runs, duration=duration, rng=np.random.default_rng(settings.seed),
            workers=pool, resume=journal, progress=progress, **bounds,
        )  # fmt: skip
    if folder is not None:
        settings.wrote(write_text(folder / "report.md", report.to_markdown()))
    settings.draw(report, "validation")
    heads = ["claim", "scenario", "predicted", "observed", "margin", "verdict"]
    settings.finish(report, report.to_dict(), "report", table("Checks", heads, report.cells()), *report.skipped)
    if journal is not None:
        journal.unlink(missing_ok=True)
    if not report.passed:
        raise typer.Exit(1 if report.broken else 3)


def compare(
    settings: Settings,
    plant_file: options.PlantFile,
    schedule_file: Annotated[
        Path, typer.Argument(metavar="SCHEDULE", help="Schedule file: .csv or .json; none where PLANT is a plan.")
    ],
    measurement_file: Annotated[
        Path | None, typer.Argument(metavar="MEASUREMENTS", help="Measurements: a .csv file.")
    ] = None,
    window: options.Window = None,
) -> None:
    """Compare planned with actual sample times: what came late, what was missed, and what that costs.

    A plan (plan.json) stands for both PLANT and SCHEDULE: `compare plan.json measured.csv`. With -o DIR: compare.json
    and compare.png.

    Example: sampling-design compare examples/plants/oscillator.toml out/schedule.csv examples/data/oscillator.csv -o out
    """  # noqa: E501
    plant = settings.part(files.plant(plant_file))
    if measurement_file is None:  # two files: what stands second was read, and the first is a plan
        if files.plan_in(plant_file) is None:
            raise ArgumentError("`MEASUREMENTS` is missing: give it last, after PLANT and SCHEDULE or after a plan.")
        schedule_file, measurement_file = plant_file, schedule_file
    schedule = files.schedule_for(settings, plant, schedule_file)
    record = files.measurements(settings, measurement_file, plant, schedule.origin)
    files.check_origins(record, schedule)
    whole, last = files.plan_in(schedule_file), float(np.max(record.times, initial=0.0))
    if whole is not None and whole.requirement.calendar is not None:  # clocks change, and places are closed
        periods = 1 + int(last * time_factor(plant.time_unit, whole.plant.time_unit) // whole.schedule.period)
        schedule = whole.dates(periods, prove=False).schedule().in_unit(plant.time_unit)
    split = split_needed(plant, settings.decay_rate or 0.0)
    # where every mode decays no window is judged, so that none is chosen and told
    length = 1.0 if window is None and not split.retained.n_states else window_length(settings, split, window, schedule)
    split = weighed_over(split, length)
    files.check_measured(record, measurement_file)
    times, taken = record.samples()
    if any(record.censored):
        settings.notice("Limits and means count as taken, and sigma counts them like numbers.")
    del record  # its numbers are not held beside those of the comparison
    with settings.progress("sigma") as progress:
        result = sd.compare_schedule(
            plant, schedule, times, length, outputs=taken if times.size else None, retained=split.retained,
            budget=settings.budget, progress=progress,
        )  # fmt: skip
    contents = result.contents() if settings.as_json or settings.output is not None else {}
    settings.draw(result, "compare")
    settings.finish(result, contents, "compare")
