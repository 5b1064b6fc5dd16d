"""The command that estimates the state along a record.

Each estimate is written as it comes, so that memory does not grow with the record.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table as RichTable

import sampling_design as sd
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.cli import files, options
from sampling_design.cli.settings import Settings, rows_table, table
from sampling_design.errors import ArgumentError
from sampling_design.estimators.estimate_file import (
    EstimateBlock,
    EstimateColumns,
    check_radii,
    estimate_table,
    estimates_along,
)
from sampling_design.estimators.online.curve import CurveCollector, EstimateEnvelope
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.estimator import EstimateCounts
from sampling_design.estimators.online.in_order import FEW_STATES, MOST_INTERVALS, few_intervals
from sampling_design.estimators.record_intervals import estimates_despite_outliers, smoothed_along
from sampling_design.estimators.records.measurement_table import time_or_date
from sampling_design.planning.plan_record import Plan
from sampling_design.plants.plant import first_difference
from sampling_design.records.budget import Progress
from sampling_design.records.file_io import atomic_file
from sampling_design.records.record import above, short
from sampling_design.records.vector_bounds import VectorBound, vector_bound


@dataclass(frozen=True)
class EstimateOptions:
    """What is worked out along a record, and how it is written."""

    radii: Annotated[
        str | None,
        typer.Option(
            help="centred: each estimate in the middle of the interval that data and bounds allow, where no other has "
            "a smaller radius; intervals: the estimator's own, which may lie aside of that middle; ellipsoids: wider, "
            f"a hundred times faster. Default: centred up to {MOST_INTERVALS} rows (of more than {FEW_STATES} states: "
            "fewer), ellipsoids beyond."
        ),
    ] = None
    tube: Annotated[
        bool,
        typer.Option(
            "--tube",
            help="With -o: prove and draw what holds each state between the samples, too; a tenth of a second a row.",
        ),
    ] = False
    leave_out: Annotated[
        str | None,
        typer.Option(help="Samples to leave out, by the numbers that a contradiction names, with commas between."),
    ] = None
    outliers: Annotated[
        str | None,
        typer.Option(
            metavar="Q[:M]",
            help="At most Q samples (of the last M) are outliers, nobody knows which: radii that hold for any such.",
        ),
    ] = None
    smooth: Annotated[
        bool, typer.Option("--smooth", help="What all rows say of each time, not only those up to it.")
    ] = False

    @property
    def most_outliers(self) -> int | tuple[int, int]:
        """How many samples may be outliers, of the last so many.

        Raises ArgumentError if the text is no such numbers, or does not go with another option.
        """
        if self.outliers is None:
            return 0
        if self.radii not in (None, "centred"):
            raise ArgumentError(f"`--radii` {self.radii} does not go with --outliers: its radii are those of middles.")
        try:
            most, *among = (int(word) for word in self.outliers.split(":"))
        except ValueError:
            most, among = 0, []
        if most < 1 or len(among) > 1:
            raise ArgumentError(f"`--outliers` must be Q or Q:M, 1 or 1:10, got {self.outliers!r}.")
        return (most, *among) if among else most  # type: ignore[return-value]

    def estimates(
        self,
        estimator: sd.MovingHorizonEstimator,
        record: sd.Measurements,
        bounds: ErrorBoundArguments,
        kind: str,
        *,
        curve: CurveCollector | None,
        progress: Progress,
    ) -> Iterator[list[Estimate]]:
        """The estimates along a record as they are asked for, some at a time."""
        if outliers := self.most_outliers:
            return estimates_despite_outliers(
                estimator, record, bounds, outliers, smooth=self.smooth, progress=progress
            )
        if self.smooth:
            return smoothed_along(estimator, record, bounds, kind)
        return estimates_along(estimator, record, kind, curve, progress)


USUAL = EstimateOptions()
"""Every row as it came, with the usual radii."""


def followed(
    settings: Settings,
    estimator: sd.MovingHorizonEstimator,
    record: sd.Measurements,
    options: EstimateOptions,
    guarantee: str,
    bounds: ErrorBoundArguments,
) -> EstimateCounts:
    """Estimate at every row of `record`, or at its samples where it is smoothed; write and show what was asked for."""
    outliers, tube = options.most_outliers, options.tube
    if outliers:
        most, *among = np.ravel(outliers).tolist()
        guarantee = f"Radii hold if at most {most} of the {f'last {among[0]} ' if among else ''}samples are outliers."
    asked = options.radii or ("centred" if outliers else _usual(settings, estimator, record))
    kind, plant, folder = check_radii(asked), estimator.plant, settings.folder()
    drawn, centred = folder is not None and not settings.no_picture, kind == "centred"
    curve = CurveCollector(estimator, centred=centred, start=estimator.state.last.t) if drawn and tube else None
    envelope = EstimateEnvelope.over(plant, record.times) if drawn and not tube else None
    counts, last = EstimateCounts(plant.time_unit, centred, record.origin), None
    with ExitStack() as open_files:
        columns = EstimateColumns(open_files, plant) if folder or settings.as_json else None
        puts: list[Callable[[EstimateBlock], None]] = [] if columns is None else [columns.put]
        if folder is not None:
            rows = estimate_table(plant, folder / "estimates.csv", origin=record.origin)
            puts.append(open_files.enter_context(rows))
        with settings.progress("estimate") as progress:
            for some in options.estimates(estimator, record, bounds, kind, curve=curve, progress=progress):
                last = some[-1]
                if puts:  # as wherever there is a picture
                    block = EstimateBlock.of(some, kind)
                    for put in puts:
                        put(block)
                    if envelope is not None:
                        flags = np.array([(e.certified, e.failed) for e in some], dtype=bool).T
                        envelope = envelope.including(block.times, block.x, block.around, *flags)
                for estimate in some:  # after the block: its radii may disprove the bounds
                    counts.add(estimate.t, estimate)
        contradictions = [each.to_dict() for each in counts.contradictions]
        known = {"radii_of": kind, "guarantee": guarantee, "horizon": estimator.horizon}
        after = {"contradictions": contradictions, **known}
        if columns is not None and folder is not None:
            with atomic_file(folder / "estimates.json") as write:
                columns.write(lambda text: write(text.encode()), settings.named({}), after)
        if columns is not None and settings.as_json:
            columns.write(sys.stdout.write, settings.named({}), after)
    if folder is not None:
        settings.wrote(folder / "estimates.csv", folder / "estimates.json")
    if envelope is not None:
        settings.draw(envelope, "estimates", measurements=record)
    if curve is not None:
        settings.draw(curve.curve(record), "estimates")
    assert last is not None
    least = last.if_centred() if kind == "intervals" else ""
    settings.show_tables(
        rows_table("EstimateRecord", counts.rows()),
        _last(plant, last, kind, record.origin),
        f"{guarantee} {counts.explain()}" + f" The last radius with --radii centred: {least}." * bool(least),
    )
    return counts


def _usual(settings: Settings, estimator: sd.MovingHorizonEstimator, record: sd.Measurements) -> str:
    """The kind of radii where none was asked for, with a notice where it is the wider one."""
    n = estimator.plant.n_states
    kind = "centred" if few_intervals(len(record), n) else "ellipsoids"
    if kind == "ellipsoids" and not estimator.bounds.note:
        settings.notice(
            f"--radii not given: of {len(record)} rows and {n} states the radii are those of ellipsoids; --radii "
            "centred are narrower and take ten to a hundred times as long."
        )
    return kind


def _last(plant: sd.Plant, estimate: Estimate, kind: str, origin: str) -> RichTable:
    radii, labels = estimate.ellipsoid_radii if kind == "ellipsoids" else estimate.radii, plant.states.labels()
    known = ["not known" if np.isnan(radius) else above(radius) for radius in radii]
    rows = [[label, short(x), radius] for label, x, radius in zip(labels, estimate.x, known, strict=True)]
    when = time_or_date(origin, estimate.t, plant.time_unit)
    return table(f"Last estimate, at {when}", ["state", "estimate", "radius"], rows)


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
