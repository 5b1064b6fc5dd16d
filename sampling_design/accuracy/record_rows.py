"""Rows of a record as they come: each checked in one way by all who take them, those of one time joined."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from sampling_design.accuracy.readings import (
    CensoredReading,
    RecordRow,
    as_typed,
    at_some_time,
    time_or_span,
    with_censored,
)
from sampling_design.checkers.strict import is_list, is_text
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze

LIMITS = {"<": "<", "≤": "<", ">": ">", "≥": ">"}  # signs before a limit of detection, and what they say

Row = TypeVar("Row")


def refuse_truth(record: object) -> None:
    """Raise ArgumentError of a record whose truth is known: an estimator takes what was measured of it."""
    if hasattr(record, "measurements"):
        raise ArgumentError(
            f"`record` must hold rows (t, y, u), got {type(record).__name__}. Give its `.measurements`."
        )


def rows_of(record: Iterable[Row], plant: Plant, origin: str = "") -> list[Row]:
    """Return the rows of a record as they came, those with dates as they count from `origin`, if it is known.

    Raises ArgumentError of a frame, since it does not say the date of time 0, and as `Measurements.on_clock`.
    """
    refuse_truth(record)
    if hasattr(record, "columns"):
        raise ArgumentError(
            "`record` must hold rows (t, y, u), got a frame: give it as `read_measurements(frame, plant)`, which also "
            "takes the date of time 0."
        )
    moved: Callable[[str, Plant], Iterable[Row]] | None = getattr(record, "on_clock", None)
    return list(record if moved is None else moved(origin, plant))


def arrived(record: Iterable[object], plant: Plant) -> list[RecordRow]:
    """Return the rows (t, y, u) of a record in order of time; those of one time are one.

    Raises ArgumentError if a row has another form, or as `read_row` and `joined`.
    """
    rows = list[RecordRow]()
    for item in rows_of(record, plant):
        t, y, *u = checks.entries("record", item, (2, 3), "rows (t, y, u)")
        rows.append(read_row(t, y, u[0] if u else None, plant.n_outputs, plant.n_inputs))
    found: list[RecordRow] = []
    for row in sorted(rows, key=lambda row: row.t):
        found.append(_joined(found.pop(), row) if found and found[-1].t == row.t else row)
    return found


def read_row(time: object, values: object, given: object, outputs: int, inputs: int) -> RecordRow:
    """Return a row (t, y, u) of so many outputs and inputs, checked; its limits and means stand apart.

    Raises ArgumentError if it says nothing, or something that is no reading, input or time.
    """
    t, span = (time, None) if type(time) is float and math.isfinite(time) else time_or_span(time)
    read, limits = (values, ()) if type(values) is np.ndarray else with_censored(values, outputs)
    y = None if read is None else _numbers(read, t, outputs, bool(limits))
    if span is not None:
        if y is None or given is not None:
            raise ArgumentError(f"`t` = {span!r} is uncertain: an input needs its time, and there must be readings.")
        limits = at_some_time(y, limits, span)
        y = freeze(np.full(len(y), np.nan))
    if given is None:
        if y is None:
            raise ArgumentError(
                f"`y` and `u` are both missing at t = {t!r}. Leave the row out; to look ahead use predict(t)."
            )
        return RecordRow(t, y, None, limits)
    plain = type(given) is np.ndarray and given.dtype == np.float64
    u = np.array(given, ndmin=1) if plain else None
    if u is not None and u.shape == (inputs,) and math.isfinite(sum(u.tolist())):
        u.flags.writeable = False
        return RecordRow(t, y, u, limits)
    u = np.atleast_1d(checks.floats("u", given))
    if np.isnan(u).any():
        raise ArgumentError(f"`u` must not hold NaN, got {u.tolist()} at t = {t!r}: a known input has a value.")
    return RecordRow(t, y, checks.vector("u", u, inputs), limits)


def _numbers(value: object, t: float, p: int, limited: bool) -> Array:
    """Readings (p,), NaN where nothing was measured; `limited`: beside limits and means."""
    try:
        given = value if type(value) is np.ndarray else np.asarray(value)
        if given.dtype.kind in "cUSO" and any(isinstance(each, (str, bytes, complex)) for each in given.flat):
            raise TypeError
        y = np.array(given, np.float64, ndmin=1)
    except (TypeError, ValueError):
        limit = " A limit of detection is BelowDetection(0.5) or AboveRange(8)." if _has_limit(value) else ""
        raise ArgumentError(f"`y` must hold numbers, got {checks.described(value)} at t = {t!r}.{limit}") from None
    if y.shape != (p,):
        raise ArgumentError(f"`y` must have {p} entr{'y' if p == 1 else 'ies'}, got shape {y.shape} at t = {t!r}.")
    if not math.isfinite(sum(y.tolist())) and not np.isfinite(y).all():
        if np.isinf(y).any():
            raise ArgumentError(f"`y` must be finite or NaN (not measured), got {y.tolist()} at t = {t!r}.")
        if np.isnan(y).all() and not limited:
            raise ArgumentError(
                f"`y` must measure at least one output, got all NaN at t = {t!r}. "
                "Was the sample lost? Leave it out, or pass y=None if only the input changes."
            )
    y.setflags(write=False)
    return y


def _has_limit(value: object) -> bool:
    """Whether readings hold a limit of detection as a file writes it, "<0.5"."""
    return any(is_text(each) and each.strip()[:1] in LIMITS for each in (value if is_list(value) else [value]))


def _joined(old: RecordRow, new: RecordRow) -> RecordRow:
    """Two rows of one time as one. Raises ArgumentError if they contradict each other."""
    u = old.u if new.u is None else same_input(old.t, old.u, new.u)
    read = new if old.y is None else merge(old, new) or old
    return RecordRow(old.t, read.y, u, read.censored)


def same_input(t: float, old: Array | None, new: Array) -> Array:
    """Return the input from a time on, given once or twice. Raises ArgumentError if that is not the same."""
    if old is not None and not np.array_equal(old, new):
        raise ArgumentError(
            f"`u` at t = {t!r} was already given as {old.tolist()}, got {new.tolist()}: duplicates must agree."
        )
    return new


def merge(old: RecordRow, new: RecordRow) -> RecordRow | None:
    """Join two samples at one time; None if the new one adds nothing. Of one output both must say the same."""
    if new.y is None:
        return old
    before, now = readings_of_sample(old), readings_of_sample(new)
    for output in before.keys() & now.keys():
        if before[output] != now[output]:
            raise ArgumentError(
                f"`y` at t = {old.t!r} was already given as {as_given(old)}, got {as_given(new)}: duplicates must "
                "agree, and an output has one reading at a time."
            )
    if new.u is None and now.keys() <= before.keys():
        return None
    y = np.where(np.isnan(old.y), new.y, old.y)
    y.flags.writeable = False
    return RecordRow(old.t, y, None, (*old.censored, *(each for each in new.censored if each.output not in before)))


def readings_of_sample(sample: RecordRow) -> dict[int, float | CensoredReading]:
    """What a sample says of each output that it reads."""
    found = {each.output: each.as_read for each in sample.censored}
    y = {output: float(sample.y[output]) for output in np.flatnonzero(np.isfinite(sample.y)).tolist()}
    return y | found


def as_given(sample: RecordRow) -> list[object]:
    """What a sample says of each output, as a user gives it."""
    values: list[object] = sample.y.tolist()
    for each in sample.censored:
        values[each.output] = as_typed(each)
    return values
