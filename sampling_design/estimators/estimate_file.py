"""Estimates as files, written as they come: a table (CSV), and plain data (JSON)."""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from sampling_design.estimators.online.curve import CurveCollector
from sampling_design.estimators.online.estimate import Estimate, half_widths
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.online.in_order import AHEAD, OnlineEstimator
from sampling_design.estimators.records.measurement_table import date_of, dated
from sampling_design.estimators.records.measurements import Measurements, cell_of
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Progress
from sampling_design.records.file_io import atomic_file
from sampling_design.records.signatures import checked

PIECE = 1 << 20  # Characters that are written at a time
TOGETHER = 32  # estimates that are written at a time

REPORTS = 1000  # times that the progress of a record is reported

RADII = ("intervals", "centred", "ellipsoids")


@contextmanager
def estimate_table(
    plant: Plant, path: str | os.PathLike[str], *, origin: str | None = None
) -> Iterator[Callable[[EstimateBlock], None]]:
    """Open a table of estimates that grows block by block, by what this yields; a file, whole or not at all.

    Parameters
    ----------
    plant : Plant
    path : path
    origin : str, optional
        Date (ISO 8601) of time 0: then a column `date` comes first, to the microsecond.
    """
    zero, text = date_of("`origin`", 0, origin) if origin else None, io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    header = [*(["date"] if zero else []), "time", "status", "certified", "cost"]
    rows.writerow([*header, *(column for name in plant.states.names for column in (name, f"{name}_radius"))])

    def put(block: EstimateBlock) -> None:
        columns = [[dated(zero, t, plant.time_unit) for t in block.times.tolist()]] if zero else []
        columns += [block.time, [e.status for e in block.estimates]]
        columns += [["1" if e.certified else "0" for e in block.estimates], block.cost]
        for pair in zip(block.state, block.radii, strict=True):
            columns += pair
        rows.writerows(zip(*columns, strict=True))
        if text.tell() > PIECE:
            write(text.getvalue().encode())
            text.seek(0)
            text.truncate()

    with atomic_file(path) as write:
        yield put
        write(text.getvalue().encode())


class EstimateColumns:
    """The plain data of `EstimateRecord.to_dict`, column by column, grown row by row outside of memory.

    `write` lays down the JSON that `to_json` would make of it, with what stands before and after; `open_files` ends it.
    """

    LISTS = ("times", "x", "radii", "radius", "cost", "status", "certified", "on_schedule", "notes")

    def __init__(self, open_files: ExitStack, plant: Plant):
        self.plant, self._begun = plant, False
        self._spools: dict[str, IO[str]] = {
            key: open_files.enter_context(tempfile.TemporaryFile("w+", encoding="utf-8"))  # noqa: SIM115
            for key in self.LISTS
        }

    def put(self, block: EstimateBlock) -> None:
        """Add what is said of a block of estimates."""
        columns = (
            block.time,
            _listed(block.state),
            _listed(block.radii),
            [text or "null" for text in block.radius],
            [text or "null" for text in block.cost],
            [_quoted(e.status) for e in block.estimates],
            [_TRUTH[bool(e.certified)] for e in block.estimates],
            [_TRUTH[bool(e.on_schedule)] for e in block.estimates],
            [_quoted(e.note) for e in block.estimates],
        )
        mark = ",\n    " if self._begun else "\n    "
        self._begun = True
        for spool, column in zip(self._spools.values(), columns, strict=True):
            spool.write(mark + ",\n    ".join(column))

    def write(self, put: Callable[[str], object], before: Mapping[str, object], after: Mapping[str, object]) -> None:
        """Write everything as JSON, piece by piece: the entries `before`, the record's, the entries `after`."""
        head = {**before, "states": list(self.plant.states.names), "time_unit": self.plant.time_unit}
        put(json.dumps(head, indent=2, allow_nan=False, ensure_ascii=False).removesuffix("\n}"))
        for key, spool in self._spools.items():
            put(f',\n  "{key}": [')
            spool.seek(0)
            while piece := spool.read(PIECE):
                put(piece)
            spool.seek(0, os.SEEK_END)
            put("\n  ]" if self._begun else "]")
        put(",\n" + json.dumps(after, indent=2, allow_nan=False, ensure_ascii=False).removeprefix("{\n") + "\n")


_TRUTH = {True: "true", False: "false"}


class EstimateBlock(NamedTuple):
    """Some estimates with their numbers, those of a state one column; as texts, empty where they are not known.

    `times` (N,) are those that they are written at, `x` and `around` (N, n) estimates and radii.
    """

    estimates: list[Estimate]
    times: Array
    x: Array
    around: Array
    time: list[str]
    state: list[list[str]]
    radii: list[list[str]]
    radius: list[str]
    cost: list[str]

    @classmethod
    def of(cls, estimates: list[Estimate], kind: str, times: Sequence[float] | Array | None = None) -> EstimateBlock:
        """Return the block of estimates as they are written, radii of a kind (`RADII`), at their times or others."""
        when = np.array([e.t for e in estimates] if times is None else times, dtype=np.float64)
        x = np.array([e.x for e in estimates])
        radii = [] if kind == "ellipsoids" else [e.radii for e in estimates]  # first: they may disprove the bounds
        radius = np.array([e.radius for e in estimates])
        if kind == "ellipsoids":
            variance = np.array([e.covariance.diagonal() for e in estimates])
            around = half_widths(np.repeat(radius[:, None], x.shape[1], axis=1), variance)
        else:
            around = np.array(radii)
        return cls(
            estimates,
            times=when,
            x=x,
            around=around,
            time=_texts(when),
            state=[_texts(column) for column in x.T],
            radii=[_texts(column) for column in around.T],
            radius=_texts(radius),
            cost=_texts(np.array([e.cost for e in estimates])),
        )


def _texts(numbers: Array) -> list[str]:
    """Numbers as a file holds them."""
    return list(map(repr if np.isfinite(numbers).all() else cell_of, numbers.tolist()))


def as_written(estimate: Estimate, kind: str) -> Estimate:
    """Return the estimate that stands beside radii of a kind (`RADII`): itself, or moved into its interval's middle.

    Where they are those of intervals it is judged by these, whether they are written or not.
    """
    if kind == "intervals" and estimate.proof is not None:
        estimate.interval()
    return estimate.centred() if kind == "centred" else estimate


@lru_cache(maxsize=64)
def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _listed(columns: list[list[str]]) -> list[str]:
    """The rows of a table of texts as lists."""
    known = [[text or "null" for text in column] for column in columns]
    return ["[\n      " + ",\n      ".join(row) + "\n    ]" for row in zip(*known, strict=True)]


def estimates_along(
    estimator: OnlineEstimator,
    record: Measurements,
    kind: str,
    curve: CurveCollector | None = None,
    progress: Progress | None = None,
) -> Iterator[list[Estimate]]:
    """Yield the estimates at every row of a record, `TOGETHER` at a time, as they stand beside radii of a kind.

    A `curve` that is given takes in what is between the rows; memory does not grow with the record.
    """
    report = progress or (lambda fraction, message: None)
    every, found = max(1, len(record) // REPORTS), list[Estimate]()
    for k, (t, y, u) in enumerate(record):
        if k % AHEAD == 0:
            estimator.expect(record.times[k : k + AHEAD])
        if curve is not None:
            curve.before(float(record.times[k]))
        found.append(as_written(estimator.update(t, y, u), kind))
        if curve is not None:
            curve.after(float(record.times[k]), found[-1])
        last = k + 1 == len(record)
        if last or (k + 1) % every == 0:
            report((k + 1) / len(record), f"{k + 1} of {len(record)} rows")
        if last or len(found) == TOGETHER:
            yield found
            found = []


def check_radii(radii: str) -> str:
    """Return which radii are meant. Raises ArgumentError if there are none of that name."""
    return checks.word("radii", radii, RADII)


@checked
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
    *Method.* Block by block, as estimates are written that no record holds.
    """
    with estimate_table(record.plant, path, origin=origin) as put:
        for k in range(0, len(record), TOGETHER):
            rows = slice(k, k + TOGETHER)
            put(EstimateBlock.of(list(record.estimates[rows]), "intervals", record.times[rows]))
    return Path(path)
