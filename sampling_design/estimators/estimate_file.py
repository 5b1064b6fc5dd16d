"""Estimates as files, written as they come: a table (CSV), and plain data (JSON)."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from datetime import datetime, timedelta
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import IO, NamedTuple

from sampling_design import _checks
from sampling_design._door import door
from sampling_design._files import Growing
from sampling_design._units import SECONDS
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.online.tally import Tally
from sampling_design.estimators.records.measurement_table import date_of
from sampling_design.estimators.records.measurements import cell_of
from sampling_design.plants.plant import Plant

PIECE = 1 << 20
"""Characters that are written at a time."""

TOGETHER = 512
"""Rows of columns that are written at a time."""

RADII = ("intervals", "centred", "ellipsoids")


class EstimateTable:
    """A table of estimates that grows row by row, each of its own length; a file, whole or not at all.

    Parameters
    ----------
    plant : Plant
    path : path
    origin : str, optional
        Date (ISO 8601) of time 0: then a column `date` comes first, to the microsecond.
    radii : "intervals", "centred" or "ellipsoids"
        Distance to the far end of the proven interval of each state; the same from the middle of the interval, which is
        written for the estimate; or half-widths of the ellipsoid, which cost nothing.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from sampling_design import CostFunction, KalmanFilter, Plant
    >>> plant = Plant([[0.0]], [[1.0]])
    >>> cost = CostFunction(eta=0.1)
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "estimates.csv"
    >>> with EstimateTable(plant, path) as table:
    ...     for estimate in KalmanFilter(plant, cost=cost).stream([(1.0, [2.0]), (2.0, [2.1])]):
    ...         table.add(estimate)
    >>> len(path.read_text().splitlines())
    3
    """

    def __init__(
        self,
        plant: Plant,
        path: str | os.PathLike[str],
        *,
        origin: str | None = None,
        radii: str = "intervals",
    ):
        self.plant, self.radii = plant, check_radii(radii)
        self._zero = date_of("`origin`", 0, origin) if origin else None
        self._file, self._text = Growing(path), io.StringIO()
        self._rows = csv.writer(self._text, lineterminator="\n")
        header = [*(["date"] if self._zero else []), "time", "status", "certified", "cost"]
        header += [column for name in plant.states.names for column in (name, f"{name}_radius")]
        self._rows.writerow(header)

    def __enter__(self) -> EstimateTable:
        self._file.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._write()
        except BaseException as fault:
            self._file.__exit__(type(fault))
            raise
        self._file.__exit__(kind)

    def add(self, estimate: Estimate, t: float | None = None) -> None:
        """Add a row; `t` is the time that it gets, where that is not the estimate's own."""
        written = as_written(estimate, self.radii)
        self.put(written, numbers_of(written, self.radii, t))

    def put(self, estimate: Estimate, numbers: WrittenNumbers) -> None:
        """Add a row of numbers that are texts already."""
        cells = [_dated(self._zero, numbers.t, self.plant.time_unit)] if self._zero else []
        cells += [numbers.time, estimate.status, "1" if estimate.certified else "0", numbers.cost]
        for pair in zip(numbers.x, numbers.radii, strict=True):
            cells += pair
        self._rows.writerow(cells)
        if self._text.tell() > PIECE:
            self._write()

    def _write(self) -> None:
        self._file.write(self._text.getvalue().encode())
        self._text.seek(0)
        self._text.truncate()


class EstimateColumns:
    """The plain data of `EstimateRecord.to_dict`, column by column, grown row by row outside of memory.

    `write` lays down the JSON that `to_json` would make of it, with what stands before and after.
    """

    LISTS = ("times", "x", "radii", "radius", "cost", "status", "certified", "on_schedule", "notes")

    def __init__(self, plant: Plant, radii: str = "intervals"):
        self.plant, self.radii, self.tally = plant, check_radii(radii), Tally(plant.time_unit)
        self._held: list[tuple[str, ...]] = []
        self._begun = False

    def __enter__(self) -> EstimateColumns:
        with ExitStack() as stack:
            self._spools: dict[str, IO[str]] = {
                key: stack.enter_context(tempfile.TemporaryFile("w+", encoding="utf-8")) for key in self.LISTS
            }
            self._open = stack.pop_all()
        return self

    def __exit__(self, *fault: object) -> None:
        self._open.close()

    def add(self, estimate: Estimate, t: float | None = None) -> None:
        """Add what is said of one estimate."""
        written = as_written(estimate, self.radii)
        self.put(written, numbers_of(written, self.radii, t))

    def put(self, estimate: Estimate, numbers: WrittenNumbers) -> None:
        """Add what is said of one estimate, whose numbers are texts already."""
        self.tally.add(numbers.t, estimate)
        self._held.append(
            (
                numbers.time,
                _listed(numbers.x),
                _listed(numbers.radii),
                numbers.radius or "null",
                numbers.cost or "null",
                _quoted(estimate.status),
                _TRUTH[bool(estimate.certified)],
                _TRUTH[bool(estimate.on_schedule)],
                _quoted(estimate.note),
            )
        )
        if len(self._held) == TOGETHER:
            self._let_go()

    def _let_go(self) -> None:
        """Write the rows that are held."""
        held, self._held = self._held, []
        if held:
            mark = ",\n    " if self._begun else "\n    "
            self._begun = True
            for spool, column in zip(self._spools.values(), zip(*held, strict=True), strict=True):
                spool.write(mark + ",\n    ".join(column))

    def write(self, file: Growing | IO[str], before: Mapping[str, object], after: Mapping[str, object]) -> None:
        """Write everything as JSON: the entries `before`, the record's, the entries `after`."""

        def put(text: str) -> None:
            file.write(text.encode()) if isinstance(file, Growing) else file.write(text)

        self._let_go()
        head = {**before, "states": list(self.plant.states.names), "time_unit": self.plant.time_unit}
        contradictions = [each.to_dict() for each in self.tally.contradictions]
        put(json.dumps(head, indent=2, allow_nan=False, ensure_ascii=False).removesuffix("\n}"))
        for key, spool in self._spools.items():
            put(f',\n  "{key}": [')
            spool.seek(0)
            while piece := spool.read(PIECE):
                put(piece)
            spool.seek(0, os.SEEK_END)
            put("\n  ]" if self.tally.count else "]")
        tail = {"contradictions": contradictions, **after}
        put(",\n" + json.dumps(tail, indent=2, allow_nan=False, ensure_ascii=False).removeprefix("{\n") + "\n")


_TRUTH = {True: "true", False: "false"}


class WrittenNumbers(NamedTuple):
    """The numbers of an estimate as texts, empty where they are not known; time and radii also as they are."""

    t: float
    around: list[float]
    time: str
    x: list[str]
    radii: list[str]
    radius: str
    cost: str


def as_written(estimate: Estimate, kind: str) -> Estimate:
    """Return the estimate that stands beside radii of a kind (`RADII`): itself, or moved into its interval's middle."""
    return estimate.centred() if kind == "centred" else estimate


def numbers_of(estimate: Estimate, kind: str, t: float | None = None) -> WrittenNumbers:
    """Return the numbers of an estimate, with radii of a kind (`RADII`), at its own time or another."""
    time = float(estimate.t if t is None else t)
    size, variances = estimate.radius, estimate.covariance.diagonal().tolist()
    if kind != "ellipsoids":
        around = estimate.radii.tolist()
    elif math.isfinite(size) and size >= 0:  # as `ellipsoid_radii`, without its arrays
        size = math.sqrt(size)
        around = [size * math.sqrt(max(value, 0.0)) for value in variances]
    else:
        around = estimate.ellipsoid_radii.tolist()
    x, radii = [cell_of(value) for value in estimate.x.tolist()], [cell_of(value) for value in around]
    return WrittenNumbers(time, around, repr(time), x, radii, cell_of(estimate.radius), cell_of(estimate.cost))


@lru_cache(maxsize=64)
def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _listed(texts: list[str]) -> str:
    return "[\n      " + ",\n      ".join([text or "null" for text in texts]) + "\n    ]"


def check_radii(radii: str) -> str:
    """Return which radii are meant.

    Raises
    ------
    ArgumentError
        If there are none of that name.
    """
    return _checks.word("radii", radii, RADII)


@door
def write_estimates(record: EstimateRecord, path: str | os.PathLike[str], *, origin: str | None = None) -> Path:
    """Write estimates as CSV: time, status, certified, cost, then per state its value and its radius.

    Parameters
    ----------
    record : EstimateRecord
    path : path
    origin : str, optional
        Date (ISO 8601) of time 0, as `Measurements.origin`: then a column `date` comes first, to the microsecond.

    Returns
    -------
    Path
        The file, written whole or not at all. A radius or cost that is not known is an empty cell.

    Notes
    -----
    *Method.* Row by row, as `EstimateTable` does for estimates that no record holds.
    """
    with EstimateTable(record.plant, path, origin=origin) as table:
        for t, estimate in zip(record.times.tolist(), record.estimates, strict=True):
            table.add(estimate, t)
    return Path(path)


def _dated(zero: datetime, t: float, unit: str) -> str:
    try:
        return (zero + timedelta(microseconds=round(t * SECONDS[unit] * 1e6))).isoformat()
    except OverflowError:
        raise ArgumentError(f"`origin` plus {t!r} {unit} lies outside the years 1 to 9999.") from None
