"""Estimates along a record: each written as it comes, so that memory does not grow with the record."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import islice

import numpy as np
import numpy.typing as npt
from rich.table import Table as RichTable

import sampling_design as sd
from sampling_design.cli.settings import Settings, rows_table, table
from sampling_design.estimators.estimate_file import (
    TOGETHER,
    EstimateBlock,
    EstimateColumns,
    EstimateTable,
    as_written,
    check_radii,
)
from sampling_design.estimators.online.curve import CurveCollector
from sampling_design.estimators.online.envelope import EstimateEnvelope
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.in_order import AHEAD
from sampling_design.estimators.online.tally import EstimateCounts
from sampling_design.records.file_io import AtomicWriter
from sampling_design.records.progress import Progress
from sampling_design.records.record import short

Array = npt.NDArray[np.float64]

CLOSELY = 1000
"""Rows up to which radii are those of intervals unless told."""
FEW = 4
"""States up to which that holds; of more it is fewer rows, since the work of one grows with the cube of the states."""
TOLD = 1000
"""Times that the progress of a record is told."""


def followed(
    settings: Settings,
    estimator: sd.MovingHorizonEstimator,
    record: sd.Measurements,
    radii: str | None,
    guarantee: str,
    tube: bool = False,
) -> EstimateCounts:
    """Estimate at every row of `record`; write and show what was asked for; `tube`: draw it between rows, too."""
    kind, plant, folder = check_radii(radii or _usual(settings, estimator, record)), estimator.plant, settings.folder()
    drawn = folder is not None and not settings.no_picture
    curve = (
        CurveCollector(estimator, centred=kind == "centred", start=estimator.state.last.t) if drawn and tube else None
    )
    envelope = EstimateEnvelope.over(plant, record.times) if drawn and not tube else None
    after = {"radii_of": kind, "guarantee": guarantee, "horizon": estimator.horizon}
    with ExitStack() as open_files:
        rows = EstimateTable(plant, folder / "estimates.csv", origin=record.origin, radii=kind) if folder else None
        columns = EstimateColumns(plant, kind) if folder or settings.as_json else None
        for each in (rows, columns):
            if each is not None:
                open_files.enter_context(each)
        tally, last = EstimateCounts(plant.time_unit) if columns is None else columns.tally, None
        with settings.progress("estimate") as progress:
            told = _told(_each(estimator, record, curve, kind), len(record), progress)
            while some := list(islice(told, TOGETHER)):
                last = some[-1]
                if rows is not None or columns is not None:  # always where there is a picture
                    block = EstimateBlock.of(some, kind)
                    for each in (rows, columns):
                        if each is not None:
                            each.put(block)
                    if envelope is not None:
                        _take(envelope, block)
                if columns is None:
                    for estimate in some:
                        tally.add(estimate.t, estimate)
        if columns is not None and folder is not None:
            with AtomicWriter(folder / "estimates.json") as file:
                columns.write(file, settings.named({}), after)
        if columns is not None and settings.as_json:
            columns.write(sys.stdout, settings.named({}), after)
    if folder is not None:
        settings.wrote(folder / "estimates.csv")
        settings.wrote(folder / "estimates.json")
        if envelope is not None:
            settings.draw(envelope, folder / "estimates.png", measurements=record)
        if curve is not None:
            settings.draw(curve.curve(record), folder / "estimates.png")
    assert last is not None
    shown = rows_table("EstimateRecord", tally.rows())
    settings.show_tables(shown, _last(plant, last, kind), f"{guarantee} {tally.explain()}")
    return tally


def _usual(settings: Settings, estimator: sd.MovingHorizonEstimator, record: sd.Measurements) -> str:
    """The kind of radii where none was asked for, with a notice where it is the wider one."""
    n = estimator.plant.n_states
    if _closely(record, n):
        return "intervals"
    if not estimator.bounds.note:
        states = f" and {n} states" if n > FEW else ""
        settings.notice(
            f"--radii not given: of {len(record)} rows{states} the radii are those of ellipsoids; --radii intervals "
            "are narrower and take longer."
        )
    return "ellipsoids"


def _closely(record: sd.Measurements, states: int) -> bool:
    """Whether every row can be looked at closely in bearable time."""
    return len(record) * max(1.0, states / FEW) ** 3 <= CLOSELY


def _take(envelope: EstimateEnvelope, block: EstimateBlock) -> None:
    """Take in estimates as they are written."""
    certified, failed = np.array([(e.certified, e.failed) for e in block.estimates], dtype=bool).T
    envelope.add(block.times, block.x, block.around, certified, failed)


def _each(
    estimator: sd.MovingHorizonEstimator, record: sd.Measurements, curve: CurveCollector | None, kind: str
) -> Iterator[Estimate]:
    """Estimates at every row, as they stand beside radii of a kind."""
    for k, (t, y, u) in enumerate(record):
        if k % AHEAD == 0:
            estimator.expect(record.times[k : k + AHEAD])
        if curve is not None:
            curve.before(t)
        estimate = as_written(estimator.update(t, y, u), kind)
        if curve is not None:
            curve.after(t, estimate)
        yield estimate


def _told(estimates: Iterator[Estimate], count: int, progress: Progress) -> Iterator[Estimate]:
    """The same, with its progress told now and then."""
    every = max(1, count // TOLD)
    for k, estimate in enumerate(estimates, 1):
        yield estimate
        if k % every == 0 or k == count:
            progress(k / count, f"{k} of {count} rows")


def _own_radii(estimate: Estimate, kind: str) -> Array:
    return estimate.ellipsoid_radii if kind == "ellipsoids" else estimate.radii


def _last(plant: sd.Plant, estimate: Estimate, kind: str) -> RichTable:
    radii, labels = _own_radii(estimate, kind), plant.states.labels()
    rows = [[labels[i], short(estimate.x[i]), short(radii[i])] for i in range(len(labels))]
    when = f"{short(estimate.t, 9)} {plant.time_unit}"
    return table(f"Last estimate, at {when}", ["state", "estimate", "radius"], rows)
