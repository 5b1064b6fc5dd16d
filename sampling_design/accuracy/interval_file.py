"""Intervals as files: what was read, the bounds and the gains, closed by a digest; the checkers prove them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.accuracy.readings import Readings, RowReading
from sampling_design.checkers import claims
from sampling_design.checkers.interval_file import OfInterval
from sampling_design.checkers.strict import BadFile
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.plants.files import plant_from_dict
from sampling_design.plants.functional import RequestedRows
from sampling_design.plants.plant import Plant
from sampling_design.records import file_io
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import Plain, with_digest

CLAIM = "interval"

STATED = 1e-6
"""Share of its width by which an end that is written lies further out than its gains prove: room for rounding."""


def tree_of(
    readings: Readings,
    t: float,
    rows: RequestedRows,
    ends: tuple[Array, Array],
    gains: Array,
    scales: Array,
    disproof: tuple[dict[str, float], dict[str, Array]] | None,
) -> dict[str, Plain]:
    """Return the plain data of an interval's file, digest included; the ends are those that the gains prove."""
    start, w, proof = readings.start, readings.disturbance, None
    if disproof is not None:
        proof = {"factors": {key: x * (1 - STATED) for key, x in disproof[0].items()}, "gains": disproof[1]}
    times = zip(readings.times, readings.rows, strict=True)
    parts = {
        "claim": CLAIM,
        "t": t,
        "rows": {"names": rows.names, "units": rows.units, "matrix": rows.matrix},
        "lower": ends[0],
        "upper": ends[1],
        "gains": gains,
        "scales": scales,
        "start": {
            "time": readings.times[0],
            "centre": start.centre,
            "root": None if start.unbounded else start.root,
            "ball": start.ball,
        },
        "w": {"centre": w.centre, "root": w.root, "ball": w.ball},
        "noise_together": readings.ball,
        "inputs": [{"t": at, "u": u} for at, u in readings.inputs] if readings.plant.n_inputs else [],
        "readings": [{"t": at, "rows": [_row(row) for row in some]} for at, some in times],
        "disproof": proof,
    }
    return with_digest(readings.plant, parts)


def _row(row: RowReading) -> dict[str, object]:
    return {"row": row.H, "y": row.y, "size": row.size, "below": row.below, "since": row.since}


def write_tree(data: dict[str, Plain], path: str | os.PathLike[str]) -> Path:
    """Write such data as JSON, whole or not at all. Raises ArgumentError if the ending is not .json."""
    if Path(path).suffix.lower() != ".json":
        raise ArgumentError(f"`path` of an interval must end in .json, got {os.fspath(path)!r}.")
    return file_io.write_text(path, file_io.to_json(data))


def read_tree(path: str | os.PathLike[str]) -> tuple[OfInterval, Plant]:
    """Return what a file claims and the plant, every size compared.

    Raises FileFormatError if it is missing, cut off, altered, or holds something else.
    """
    where = os.fspath(path)
    data = file_io.from_json(file_io.read_text(where), where)
    try:
        found = claims.certificate(data)
    except BadFile as error:
        said = error.said(where if error.broken == "digest" else f"{where}: is no interval")
        raise FileFormatError(said, where) from None
    if not isinstance(found, OfInterval):
        raise FileFormatError(
            f"{where}: claims {data['claim']!r}, expected 'interval'. Use read_certificate for a certificate.", where
        )
    return found, plant_from_dict(data["plant"], where)


def readings_of(found: OfInterval, plant: Plant) -> tuple[Readings, RequestedRows]:
    """Return readings and rows of a file that was read."""
    root = np.zeros((plant.n_states, plant.n_states)) if found.root is None else found.root
    readings = Readings(
        plant=plant,
        disturbance=BoundedSet(freeze(found.w_centre), freeze(found.w_root), found.w_ball),
        start=BoundedSet(freeze(found.centre), freeze(root), found.start_ball, found.root is None),
        times=freeze(found.times),
        rows=tuple(
            tuple(RowReading(freeze(r.row), r.y, r.size, r.below, r.since) for r in some) for some in found.readings
        ),
        ball=found.together,
        inputs=tuple((at, freeze(u)) for at, u in found.inputs),
    )
    return readings, RequestedRows(freeze(found.rows), found.names, found.units)
