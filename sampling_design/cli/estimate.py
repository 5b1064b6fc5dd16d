"""The command that estimates the state along a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.cli import files, options
from sampling_design.cli.estimate_rows import USUAL, EstimateOptions, followed
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError
from sampling_design.estimators.estimate_file import check_radii
from sampling_design.planning.plan_record import Plan
from sampling_design.plants.plant import first_difference
from sampling_design.records.record import short
from sampling_design.records.vector_bounds import VectorBound, vector_bound


def estimate(
    settings: Settings,
    plant_file: options.PlantFile,
    measurement_file: options.MeasurementFile,
    certificate_file: options.CertificateFile = None,
    schedule_file: Annotated[
        Path | None,
        typer.Option("--schedule", "--plan", metavar="FILE", help="Schedule that is certified first, or a plan."),
    ] = None,
    prior: Annotated[str | None, typer.Option(help="State before any sample, with commas between; default 0.")] = None,
    horizon: Annotated[
        float | None, typer.Option(help="Length of the estimator's window [time unit]; default: the certificate's.")
    ] = None,
    typed: options.BoundOptions = options.UNBOUNDED,
    eta: options.Eta = None,
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
    _ = how.most_outliers, how.radii and check_radii(how.radii)  # refused before a certificate is sought
    whole = files.plan_in(plant_file)
    full = files.plant(plant_file) if whole is None else whole.plant
    plant, schedule = settings.part(full), None
    if schedule_file is not None:
        schedule = files.schedule_for(settings, plant, schedule_file)
    elif whole is not None and certificate_file is None:
        schedule = whole.schedule
    planned = files.plan_in(schedule_file) if whole is None else whole
    bounds = known_bounds(settings, plant, full, typed.of(plant), planned)
    zero = None if schedule is None else schedule.origin
    calendar = None if planned is None else planned.requirement.calendar
    zone = None if calendar is None else calendar.zone
    record = files.measurements(settings, measurement_file, plant, zero, zone)
    if schedule is not None:
        files.check_origins(record, schedule)
    files.check_measured(record, measurement_file)
    record = record.in_order() if how.leave_out is None else _without(record, how.leave_out)
    certificate = None if certificate_file is None else files.sampling_certificate(certificate_file, plant)
    first = options.numbers("--prior", prior, plant.states.names)
    with settings.progress("certificate") as progress:
        chosen = sd.estimators.estimator_for(
            plant, record, certificate, schedule=schedule, eta=eta, horizon=horizon,
            prior=None if first is None else np.atleast_1d(first), progress=progress, **bounds,
        )  # fmt: skip
    words = chosen.guarantee if certificate is None else f"Guarantee of {certificate_file}."
    for name, text in chosen.defaults_used.items():
        settings.notice(text if name == "notice" else f"--{name.replace('_', '-')} not given: {text}.")
    counts = followed(settings, chosen.estimator, record, how, words, or_scales(plant, bounds))
    if counts.contradictions or counts.status["bounds disproved"]:
        if any(bound is None for bound in bounds.values()):
            settings.notice(
                "Bounds that were not given are the plant's scales, typical sizes that data may well exceed: give "
                "--w-bound, --v-bound and --initial-error before more is made of the contradiction."
            )
        raise typer.Exit(1)


def known_bounds(
    settings: Settings, plant: sd.Plant, full: sd.Plant, typed: ErrorBoundArguments, planned: Plan | None, *,
    endless: bool = False,
) -> ErrorBoundArguments:  # fmt: skip
    """The bounds as they were typed, else those that a plan was made with, where they are about signals of the plant.

    An `endless` question has no start and takes no initial error of a plan.

    Raises ArgumentError if a plan for another plant bounds signals that this one has not.
    """
    if planned is None:
        return typed
    found: dict[str, VectorBound] = dict(typed)  # type: ignore[arg-type]
    own, other = planned.error_bounds, first_difference(full, planned.plant)
    theirs: dict[str, VectorBound] = dict(own)  # type: ignore[arg-type]
    for name, kind in {"w_bound": "disturbances", "v_bound": "outputs", "initial_error": "states"}.items():
        if found[name] is not None or theirs[name] is None or (endless and kind == "states"):
            continue
        flag, ours, planned_for = f"--{name.replace('_', '-')}", getattr(plant, kind), getattr(planned.plant, kind)
        same = (ours.names, ours.units) == (planned_for.names, planned_for.units)
        if plant is not full and (kind == "states" or not same):
            continue  # of the part that rows need, whose states are others
        if not same or plant.time_unit != planned.plant.time_unit:
            raise ArgumentError(f"`{flag}` is missing, and the plan is for another plant: {other}. Give the bound.")
        found[name] = theirs[name]
        whose = f", which is for another plant: {other}" if other else ""
        said = short(vector_bound(name, found[name], ours.names))
        settings.notice(f"{flag} not given: that of the plan, {said}, is used{whose}.")
    return ErrorBoundArguments(w_bound=found["w_bound"], v_bound=found["v_bound"], initial_error=found["initial_error"])


def or_scales(plant: sd.Plant, bounds: ErrorBoundArguments) -> ErrorBoundArguments:
    """The bounds, with the plant's scales where none was given, as the estimator has them."""
    w, v, error = bounds["w_bound"], bounds["v_bound"], bounds["initial_error"]
    return ErrorBoundArguments(
        w_bound=plant.disturbances.scales if w is None else w,
        v_bound=plant.outputs.scales if v is None else v,
        initial_error=plant.states.scales if error is None else error,
    )


def _without(record: sd.Measurements, text: str) -> sd.Measurements:
    """The record without the samples whose numbers were typed."""
    try:
        return record.without(*(int(word) for word in text.split(",")))
    except ArgumentError as error:
        raise ArgumentError(str(error).replace("`numbers`", "`--leave-out`")) from None
    except ValueError:
        raise ArgumentError(f"`--leave-out` must hold numbers of samples, 3 or 3,17, got {text!r}.") from None
