"""Estimates as files, written as they come: a table (CSV), and plain data (JSON)."""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from datetime import datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import IO

from sampling_design._door import door
from sampling_design._files import Growing
from sampling_design._units import SECONDS
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.estimator import Estimate, EstimateRecord
from sampling_design.estimators.online.tally import Tally
from sampling_design.estimators.records.measurement_table import date_of
from sampling_design.estimators.records.measurements import cell_of
from sampling_design.plants.plant import Plant

PIECE = 1 << 20
"""Characters that are written at a time."""

RADII = ("intervals", "ellipsoids")


class EstimateTable:
    """A table of estimates that grows row by row, each of its own length; a file, whole or not at all.

    Parameters
    ----------
    plant : Plant
    path : path
    origin : str, optional
        Date (ISO 8601) of time 0: then a column `date` comes first, to the microsecond.
    radii : "intervals" or "ellipsoids"
        Distance to the far end of the proven interval of each state, or half-widths of the ellipsoid, which cost
        nothing.

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
        time = float(estimate.t if t is None else t)
        cells = [_dated(self._zero, time, self.plant.time_unit)] if self._zero else []
        cells += [repr(time), estimate.status, str(int(estimate.certified)), cell_of(estimate.cost)]
        for value, radius in zip(estimate.x.tolist(), _radii(estimate, self.radii), strict=True):
            cells += [cell_of(value), cell_of(radius)]
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
        time = float(estimate.t if t is None else t)
        mark = ",\n    " if self.tally.count else "\n    "
        self.tally.add(time, estimate)
        texts = (
            repr(time),
            _listed(estimate.x.tolist()),
            _listed(_radii(estimate, self.radii)),
            _number(estimate.radius),
            _number(estimate.cost),
            json.dumps(estimate.status),
            _TRUTH[bool(estimate.certified)],
            _TRUTH[bool(estimate.on_schedule)],
            json.dumps(estimate.note, ensure_ascii=False),
        )
        for spool, text in zip(self._spools.values(), texts, strict=True):
            spool.write(mark + text)

    def write(self, file: Growing | IO[str], before: Mapping[str, object], after: Mapping[str, object]) -> None:
        """Write everything as JSON: the entries `before`, the record's, the entries `after`."""

        def put(text: str) -> None:
            file.write(text.encode()) if isinstance(file, Growing) else file.write(text)

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


def _number(value: float) -> str:
    """A number in JSON; null where it is not known."""
    return cell_of(value) or "null"


def _listed(values: Iterable[float]) -> str:
    return "[\n      " + ",\n      ".join(map(_number, values)) + "\n    ]"


def check_radii(radii: str) -> str:
    """Return which radii are meant.

    Raises
    ------
    ArgumentError
        If there are none of that name.
    """
    if not isinstance(radii, str) or radii not in RADII:
        raise ArgumentError(f"`radii` must be one of {', '.join(RADII)}, got {radii!r}.")
    return radii


def _radii(estimate: Estimate, kind: str) -> list[float]:
    found = estimate.radii if kind == "intervals" else estimate.ellipsoid_radii
    return [float(each) for each in found]


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
