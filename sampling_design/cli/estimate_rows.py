"""Estimates along a record: each written as it comes, so that memory does not grow with the record."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer
from rich.table import Table as RichTable

import sampling_design as sd
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.cli.settings import Settings, rows_table, table
from sampling_design.errors import ArgumentError
from sampling_design.estimators.estimate_file import (
    EstimateBlock,
    EstimateColumns,
    EstimateTable,
    check_radii,
    estimates_along,
    usual_radii,
)
from sampling_design.estimators.online.curve import CurveCollector, EstimateEnvelope
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.estimator import EstimateCounts
from sampling_design.estimators.online.in_order import FEW_STATES, MOST_INTERVALS
from sampling_design.estimators.record_intervals import estimates_despite_outliers, smoothed_along
from sampling_design.estimators.records.measurement_table import time_or_date
from sampling_design.records.budget import Progress
from sampling_design.records.file_io import AtomicWriter
from sampling_design.records.record import above, short


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
    after = {"radii_of": kind, "guarantee": guarantee, "horizon": estimator.horizon}
    with ExitStack() as open_files:
        rows = EstimateTable(plant, folder / "estimates.csv", origin=record.origin, radii=kind) if folder else None
        columns = EstimateColumns(plant, kind, record.origin) if folder or settings.as_json else None
        for each in (rows, columns):
            if each is not None:
                open_files.enter_context(each)
        counts, last = EstimateCounts(plant.time_unit, centred, record.origin), None
        counted = counts if columns is None else columns.counts
        with settings.progress("estimate") as progress:
            for some in options.estimates(estimator, record, bounds, kind, curve=curve, progress=progress):
                last = some[-1]
                if rows is not None or columns is not None:  # always where there is a picture
                    block = EstimateBlock.of(some, kind)
                    for each in (rows, columns):
                        if each is not None:
                            each.put(block)
                    if envelope is not None:
                        flags = np.array([(e.certified, e.failed) for e in some], dtype=bool).T
                        envelope = envelope.including(block.times, block.x, block.around, *flags)
                if columns is None:
                    for estimate in some:
                        counted.add(estimate.t, estimate)
        if columns is not None and folder is not None:
            with AtomicWriter(folder / "estimates.json") as file:
                columns.write(lambda text: file.write(text.encode()), settings.named({}), after)
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
        rows_table("EstimateRecord", counted.rows()),
        _last(plant, last, kind, record.origin),
        f"{guarantee} {counted.explain()}" + f" The last radius with --radii centred: {least}." * bool(least),
    )
    return counted


def _usual(settings: Settings, estimator: sd.MovingHorizonEstimator, record: sd.Measurements) -> str:
    """The kind of radii where none was asked for, with a notice where it is the wider one."""
    n = estimator.plant.n_states
    kind = usual_radii(len(record), n)
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
