"""What a record says of a plant under bounds as typed by a user."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.bounds import Bound, BoundedSet, SignalBounds
from sampling_design.accuracy.dated_start import resolved, start_of_dated
from sampling_design.accuracy.readings import (
    CensoredReading,
    Readings,
    RecordRow,
    RowReading,
    censored_rows,
    input_at,
)
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.vector_bounds import VectorBound

MOST_CASES = 3000  # sets of samples that may be left out: some seconds for a small plant


def left_out(outliers: int | tuple[int, int], count: int) -> list[tuple[int, ...]]:
    """The sets of samples, counted from 0, that may be outliers: those of the largest size hold the others."""
    pair = (outliers, count) if isinstance(outliers, int) else outliers
    if len(pair) != 2:
        raise ArgumentError(f"`outliers` must be a number or a pair (how many, of the last so many), got {outliers!r}.")
    most, among = (checks.whole("outliers", each) for each in pair)
    among = min(among, count)
    if most > among or most >= count:
        raise ArgumentError(f"`outliers` must be of the {count} samples and leave one of them, got {outliers!r}.")
    if math.comb(among, most) > MOST_CASES:
        raise ArgumentError(
            f"`outliers` = {outliers!r} of {count} samples may be {math.comb(among, most)} sets, more than "
            f"{MOST_CASES}: say of how many of the last samples, (1, 10)."
        )
    return list(combinations(range(count - among, count), most))


Rows: TypeAlias = list[tuple[float, tuple[RowReading, ...]]]


def read_record(
    plant: Plant,
    items: Sequence[RecordRow],
    w_bound: Bound,
    v_bound: Bound,
    initial_error: VectorBound,
    prior: npt.ArrayLike | None,
    prior_time: float | None,
    also: float | None = None,
) -> Readings:
    """Return what rows of a record say of a plant under bounds as typed by a user; `also` becomes one of its times.

    Raises ArgumentError if the record is empty or begins before `prior_time`, or a bound is missing or of another
    shape.
    """
    centre = checks.vector("prior", np.zeros(plant.n_states) if prior is None else prior, plant.n_states)
    spans, begun = any(each.stamp for item in items for each in item.censored), beginning(items)
    start = begun if prior_time is None else checks.number("prior_time", prior_time)
    samples, inputs = _less_inputs(plant, items, start)
    if spans and begun < start:
        raise ArgumentError(f"`prior_time` = {start!r} must not lie after {begun!r}, where an uncertain time begins.")
    if spans and callable(v_bound):
        raise ArgumentError("`v_bound` must not depend on time where the time of a reading is uncertain.")
    if not samples:
        raise ArgumentError("`record` must hold at least one measurement, got none.")
    y, times = np.array([item.y for item in samples]), np.array([item.t for item in samples])
    measured = np.isfinite(y)
    for k, item in enumerate(samples):
        measured[k, [each.output for each in item.censored]] = True
    bounds = SignalBounds.of(plant, len(y), measured, w_bound, v_bound, times)
    centre_w = np.zeros(plant.n_disturbances) if bounds.w_centre is None else bounds.w_centre
    disturbance = BoundedSet.box(centre_w, bounds.w, bounds.w_ball)
    centre_v = np.zeros(y.shape) if bounds.v_centre is None else bounds.v_centre
    error = replace(BoundedSet.of("initial_error", initial_error, plant.states.names), centre=centre)
    unread = Readings.unread(plant, disturbance, error, start, bounds.v_ball, inputs)
    proven = start_of_dated(unread, samples, (bounds.v, centre_v)) if spans and error.unbounded else None
    unread = unread if proven is None else replace(unread, start=proven)
    said = _one_by_one(unread, samples, (bounds.v, centre_v))
    rows = [(item.t, own) for item, (_, own) in zip(samples, said, strict=True)]
    if also is not None and also < start:
        raise ArgumentError(f"`t` must not lie before the start {start!r}, got {also!r}.")
    return unread.reading(rows if also is None or also >= rows[-1][0] or also in dict(rows) else [*rows, (also, ())])


def censored_together(
    unread: Readings, samples: Sequence[RecordRow], noise: BoundedSet, before: bool
) -> tuple[BoundedSet, list[tuple[CensoredReading, ...]]] | None:
    """Return a box of the start, and what readings of uncertain times say together of theirs.

    Of the start nothing else is known; None if they bound nothing. Samples are less D u.
    """
    every = np.tile(noise.half_widths, (len(samples), 1)), np.tile(noise.centre, (len(samples), 1))
    proven = start_of_dated(unread, samples, every, before)
    if proven is None:
        return None
    known = replace(unread, start=proven)
    return proven, [row for row, _ in _one_by_one(known, samples, every, before, waiting=True)]


def _one_by_one(
    unread: Readings,
    samples: Sequence[RecordRow],
    noise: tuple[Array, Array],
    before: bool = False,
    waiting: bool = False,
) -> Iterator[tuple[tuple[CensoredReading, ...], tuple[RowReading, ...]]]:
    """What each sample says of its time, by those before it, and as rows of the state."""
    rows, plant, inputs = list[tuple[float, tuple[RowReading, ...]]](), unread.plant, unread.inputs
    for item, size, middle in zip(samples, *noise, strict=True):
        values = item.y - middle
        measured = np.flatnonzero(np.isfinite(size) & np.isfinite(values))
        own = [RowReading(plant.C[i], values[i], size[i], output=int(i)) for i in measured]
        known = partial(_known, unread, rows, item.t)
        censored = resolved(unread, item.t, item.censored, known, before, waiting)
        u = input_at(inputs, item.t, plant.n_inputs, before)
        for each in censored:
            i = each.output
            own += censored_rows(plant, item.t, each, float(size[i]), float(middle[i]), inputs, float(plant.D[i] @ u))
        rows.append((item.t, tuple(row for row in own if np.isfinite(row.size))))
        yield censored, rows[-1][1]


def beginning(items: Sequence[RecordRow]) -> float:
    """The earliest time at which a row may have come; 0 without rows."""
    spans = [each.stamp for item in items for each in item.censored if each.stamp is not None]
    return min([items[0].t, *(span.first for span in spans)]) if items else 0.0


def _known(unread: Readings, before: Rows, t: float, rows: Array) -> tuple[Array, Array]:
    """Ends of rows of x(t), by the readings before; NaN where these contradict the bounds."""
    program = RecordProgram(unread.reading([*before, (t, ())]))
    ends = program.solve(t, rows)
    limits = np.array([(-down.value, up.value) for up, down in ends]).T
    contradicted = program.seems_infeasible and program.contradicted
    return (limits[0] * np.nan, limits[1] * np.nan) if contradicted else (limits[0], limits[1])


def _less_inputs(
    plant: Plant, items: Sequence[RecordRow], start: float
) -> tuple[list[RecordRow], tuple[tuple[float, Array], ...]]:
    """Samples less D u, and inputs."""
    u = np.zeros(plant.n_inputs)
    if items and items[0].t < start:
        raise ArgumentError(f"`prior_time` = {start!r} must not lie after the first row of `record`, {items[0].t!r}.")
    samples: list[RecordRow] = []
    inputs: list[tuple[float, Array]] = []
    for item in items:
        if item.u is not None and plant.n_inputs:
            u = item.u
            inputs.append((item.t, u))
        if item.y is not None:
            samples.append(item._replace(y=item.y - plant.D @ u))
    return samples, tuple(inputs)
