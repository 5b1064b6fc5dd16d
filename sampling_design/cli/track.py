"""Commands that meet data and chance: estimate, validate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.cli import files
from sampling_design.cli.estimate_rows import USUAL, EstimateOptions, followed
from sampling_design.cli.plan import PlantFile, ScheduleFile, schedule_for, window_length
from sampling_design.cli.prove import UNBOUNDED, BoundOptions, sampling_certificate
from sampling_design.cli.settings import (
    Hands,
    Scheduler,
    Settings,
    numbers,
    record_table,
    table,
    workforce,
)
from sampling_design.errors import ArgumentError
from sampling_design.planning.plan_record import Plan
from sampling_design.plants.functional import split_needed, weighed_over
from sampling_design.plants.plant import first_difference
from sampling_design.records.file_io import write_text
from sampling_design.records.record import short
from sampling_design.validation.report import ValidationReport

MeasurementFile = Annotated[Path, typer.Argument(metavar="MEASUREMENTS", help="Measurements: a .csv file.")]
CertificateFile = Annotated[Path | None, typer.Option("--certificate", metavar="FILE", help="Certificate (.json).")]
Eta = Annotated[float | None, typer.Option(help="Discount rate of the squared error, where one is certified.")]


def estimate(
    settings: Settings,
    plant_file: PlantFile,
    measurement_file: MeasurementFile,
    certificate_file: CertificateFile = None,
    schedule_file: Annotated[
        Path | None, typer.Option("--schedule", metavar="FILE", help="Schedule that is certified first.")
    ] = None,
    prior: Annotated[str | None, typer.Option(help="State before any sample, with commas between; default 0.")] = None,
    horizon: Annotated[float | None, typer.Option(help="Length of the window; default: the certificate's.")] = None,
    typed: BoundOptions = UNBOUNDED,
    eta: Eta = None,
    how: EstimateOptions = USUAL,
) -> None:
    """Estimate the state from measurements, with a radius that holds the truth if noise keeps its bounds.

    A plan (plan.json) may stand for PLANT or for the schedule: it brings its bounds, too. Without certificate and
    schedule the gaps in the file are certified where that is possible. With -o DIR: estimates.csv, estimates.json
    and estimates.png; --no-picture leaves the picture out, --tube shows more in it.

    Example: sampling-design estimate examples/plants/oscillator.toml examples/data/oscillator.csv -o out
    """
    if how.tube and (settings.output is None or settings.no_picture):
        raise ArgumentError("`--tube` is for the picture: give a folder for it (-o DIR), and leave out --no-picture.")
    if how.tube and (how.most_outliers or how.smooth):
        raise ArgumentError("`--tube` is of estimates as they came: leave it out with --outliers and --smooth.")
    whole = files.plan_in(plant_file)
    full = files.plant(plant_file) if whole is None else whole.plant
    plant, schedule = settings.part(full), None
    if schedule_file is not None:
        schedule = schedule_for(settings, plant, schedule_file)
    elif whole is not None and certificate_file is None:
        schedule = whole.schedule
    planned = files.plan_in(schedule_file) if whole is None else whole
    bounds = _bounds(settings, plant, full, typed.of(plant), planned)
    zero = None if schedule is None else schedule.origin
    calendar = None if planned is None else planned.requirement.calendar
    zone = None if calendar is None else calendar.zone
    record = files.measurements(settings, measurement_file, plant, zero, zone)
    if schedule is not None:
        _check_origins(record, schedule)
    if not record.measured.any():
        raise ArgumentError(f"`MEASUREMENTS` {measurement_file} holds no measurement.")
    record = record.in_order() if how.leave_out is None else record.without(*_numbered(how.leave_out))
    certificate = None if certificate_file is None else sampling_certificate(certificate_file, plant)
    first = numbers("--prior", prior, plant.states.names)
    with settings.progress("certificate") as progress:
        chosen = sd.estimators.estimator_for(
            plant, record, certificate, schedule=schedule, eta=eta, horizon=horizon,
            prior=None if first is None else np.atleast_1d(first), progress=progress, **bounds,
        )  # fmt: skip
    words = chosen.guarantee if certificate is None else f"Guarantee of {certificate_file}."
    for name, text in chosen.defaults_used.items():
        settings.notice(text if name == "notice" else f"--{name.replace('_', '-')} not given: {text}.")
    tally = followed(settings, chosen.estimator, record, how, words, _used(plant, bounds))
    if tally.contradictions or tally.status["bounds disproved"]:
        if any(bound is None for bound in bounds.values()):
            settings.notice(
                "Bounds that were not given are the plant's scales, typical sizes that data may well exceed: give "
                "--w-bound, --v-bound and --initial-error before more is made of the contradiction."
            )
        raise typer.Exit(1)


def _bounds(
    settings: Settings, plant: sd.Plant, full: sd.Plant, typed: ErrorBoundArguments, planned: Plan | None
) -> ErrorBoundArguments:
    """The bounds as they were typed, else those that a plan was made with.

    Raises ArgumentError if the plan is for another plant, of whose signals its bounds say nothing.
    """
    if planned is None:
        return typed
    own = planned.error_bounds
    if settings.of is not None:  # of the part that rows need, whose states are others
        same = all(
            getattr(plant, kind).names == getattr(planned.plant, kind).names for kind in ("disturbances", "outputs")
        )
        own = ErrorBoundArguments(
            w_bound=own["w_bound"] if same else None, v_bound=own["v_bound"] if same else None, initial_error=None
        )
    found = ErrorBoundArguments(
        w_bound=own["w_bound"] if typed["w_bound"] is None else typed["w_bound"],
        v_bound=own["v_bound"] if typed["v_bound"] is None else typed["v_bound"],
        initial_error=own["initial_error"] if typed["initial_error"] is None else typed["initial_error"],
    )
    for (name, used), said in zip(found.items(), typed.values(), strict=True):
        if said is None and used is not None:
            flag = f"--{name.replace('_', '-')}"
            if other := first_difference(full, planned.plant):
                raise ArgumentError(f"`{flag}` is missing, and the plan is for another plant: {other}. Give the bound.")
            settings.notice(f"{flag} not given: that of the plan, {short(used)}, is used.")
    return found


def _used(plant: sd.Plant, bounds: ErrorBoundArguments) -> ErrorBoundArguments:
    """The bounds, with the plant's scales where none was given, as the estimator has them."""
    w, v, error = bounds["w_bound"], bounds["v_bound"], bounds["initial_error"]
    return ErrorBoundArguments(
        w_bound=plant.disturbances.scales if w is None else w,
        v_bound=plant.outputs.scales if v is None else v,
        initial_error=plant.states.scales if error is None else error,
    )


def _numbered(text: str) -> list[int]:
    """Numbers of samples as typed."""
    try:
        return [int(word) for word in text.split(",")]
    except ValueError:
        raise ArgumentError(f"`--leave-out` must hold numbers of samples, 3 or 3,17, got {text!r}.") from None


def validate(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    certificate_file: CertificateFile = None,
    runs: Annotated[int, typer.Option(help="Random trials.")] = 200,
    duration: Annotated[float | None, typer.Option(help="Length of a trial [plant's time unit].")] = None,
    typed: BoundOptions = UNBOUNDED,
    eta: Eta = None,
    workers: Hands = 1,
    scheduler: Scheduler = None,
) -> None:
    """Certify a schedule, then try to break the promise: random and worst noise, constraints, inequality (16).

    Exit code 1 if a promise is broken. A plan (plan.json) for SCHEDULE brings its bounds. With -o DIR: report.md,
    report.json and validation.png; an interrupted one is taken up again where it was.

    Example: sampling-design validate examples/plants/oscillator.toml out/schedule.csv -o out
    """
    full = files.plant(plant_file)
    plant = settings.part(full)
    schedule = schedule_for(settings, plant, schedule_file)
    bounds = _bounds(settings, plant, full, typed.of(plant), files.plan_in(schedule_file))
    if certificate_file is not None:
        certificate = sampling_certificate(certificate_file, plant)
    else:
        with settings.progress("certificate") as progress:
            weighed = _used(plant, bounds)
            certificate = sd.certify(plant, schedule, eta=eta, progress=progress, **weighed)
    for name, bound in bounds.items():
        if bound is None:
            flag = name.replace("_", "-")
            settings.notice(f"--{flag} not given: the plant's scales are used, typical sizes, and trials stay in them.")
    if eta is None and certificate_file is None:
        rate = f"{short(certificate.eta)} per {plant.time_unit}"
        settings.notice(f"--eta not given: {rate}, one over the longest gap, is used.")
    folder = settings.folder()
    journal = None if folder is None else folder / "validation.journal"
    with settings.progress("validate") as progress, workforce(workers, scheduler) as hands:
        report = sd.validate(
            plant,
            schedule,
            certificate,
            runs=runs,
            duration=duration,
            rng=np.random.default_rng(settings.seed),
            workers=hands,
            resume=journal,
            progress=progress,
            **bounds,
        )
    _report(settings, report)
    if journal is not None:
        journal.unlink(missing_ok=True)
    if not report.passed:
        raise typer.Exit(1 if report.broken else 3)


def _report(settings: Settings, report: ValidationReport) -> None:
    folder = settings.folder()
    if folder is not None:
        settings.wrote(write_text(folder / "report.md", report.to_markdown()))
        settings.write_json(folder / "report.json", report.to_dict())
        settings.draw(report, folder / "validation.png")
    heads = ["claim", "scenario", "predicted", "observed", "margin", "verdict"]
    findings = table("Findings", heads, report.cells())
    settings.show(report.to_dict(), record_table(report), findings, *report.skipped, report.explain())


def _check_origins(record: sd.Measurements, schedule: sd.Schedule | sd.PeriodicSchedule) -> None:
    """Refuse to lay dates over times that have none, or the other way round: nobody knows where they belong."""
    if record.origin and schedule.origin is None:
        raise ArgumentError(
            "`MEASUREMENTS` hold dates and `SCHEDULE` does not say which date its time 0 is: "
            "give it one (design --start DATE, or origin=DATE in the first line of the file)."
        )
    if schedule.origin is not None and not record.origin:
        raise ArgumentError(
            f"`SCHEDULE` has its time 0 at {schedule.origin} and `MEASUREMENTS` hold times without dates: "
            "give the file a column `date`, or the schedule no origin."
        )


def compare(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    measurement_file: MeasurementFile,
    window: Annotated[float | None, typer.Option(help="Window over which sigma is judged [plant's time unit].")] = None,
) -> None:
    """Compare planned with actual sample times: what came late, what was missed, and what that costs.

    With -o DIR: compare.json and compare.png.

    Example: sampling-design compare examples/plants/oscillator.toml out/schedule.csv examples/data/oscillator.csv -o out
    """  # noqa: E501
    plant = settings.part(files.plant(plant_file))
    schedule = schedule_for(settings, plant, schedule_file)
    record = files.measurements(settings, measurement_file, plant, schedule.origin)
    _check_origins(record, schedule)
    split = split_needed(plant, settings.decay_rate or 0.0)
    # where every mode decays no window is judged, so that none is chosen and told
    length = 1.0 if window is None and not split.retained.n_states else window_length(settings, split, window, schedule)
    split = weighed_over(split, length)
    times, taken = record.samples()
    if any(record.censored):
        settings.notice("Limits and means count as taken, and sigma counts them like numbers.")
    del record  # its numbers are not held beside those of the comparison
    with settings.progress("sigma") as progress:
        result = sd.compare_schedule(
            plant,
            schedule,
            times,
            length,
            outputs=taken if times.size else None,
            retained=split.retained,
            budget=settings.budget,
            progress=progress,
        )
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "compare.json", result.contents())
        settings.draw(result, folder / "compare.png")
    settings.show(result.contents() if settings.as_json else {}, record_table(result), result.explain())
