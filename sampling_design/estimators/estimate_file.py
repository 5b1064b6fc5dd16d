"""Estimates as a file."""

from __future__ import annotations

import os
from datetime import datetime, timedelta
from pathlib import Path

from sampling_design._door import door
from sampling_design._units import SECONDS
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.records.measurements import cell_of, date_of, write_csv


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
    """
    zero = date_of("`origin`", 0, origin) if origin else None
    header = [*(["date"] if zero else []), "time", "status", "certified", "cost"]
    header += [column for name in record.plant.states.names for column in (name, f"{name}_radius")]
    body = []
    for k in range(len(record)):
        pairs = [v for pair in zip(record.x[k], record.radii[k], strict=True) for v in pair]
        head = [repr(float(record.times[k])), record.status[k], str(int(record.certified[k])), cell_of(record.cost[k])]
        dated = [_dated(zero, float(record.times[k]), record.plant.time_unit)] if zero else []
        body.append([*dated, *head, *(cell_of(v) for v in pairs)])
    return write_csv(path, header, body)


def _dated(zero: datetime, t: float, unit: str) -> str:
    try:
        return (zero + timedelta(microseconds=round(t * SECONDS[unit] * 1e6))).isoformat()
    except OverflowError:
        raise ArgumentError(f"`origin` plus {t!r} {unit} lies outside the years 1 to 9999.") from None
