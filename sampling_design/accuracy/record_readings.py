"""What a record says of a plant under bounds as typed by a user."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.bounds import Bound, SignalBounds
from sampling_design.accuracy.dated_start import start_of_dated
from sampling_design.accuracy.readings import (
    Arrived,
    DisturbanceSet,
    Readings,
    RecordRow,
    RowReading,
    StartError,
    arrived,
    gathered,
    rows_told,
)
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.accuracy.uncertain_times import resolved
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze


def read_record(
    plant: Plant,
    record: Iterable[Arrived],
    w_bound: Bound,
    v_bound: Bound,
    initial_error: npt.ArrayLike | None,
    prior: npt.ArrayLike | None,
    prior_time: float | None,
    also: float | None = None,
) -> Readings:
    """Return what a record says of a plant under bounds as typed by a user; `also` becomes one of its times.

    Raises ArgumentError if the record is empty or not in order, or a bound is missing or of another shape.
    """
    centre = checks.vector("prior", np.zeros(plant.n_states) if prior is None else prior, plant.n_states)
    items = arrived(record, plant.n_outputs)
    spans, begun = any(each.stamp for come in items for each in come.told), beginning(items)
    start = begun if prior_time is None else checks.number("prior_time", prior_time)
    samples, inputs = _in_order(plant, items, start)
    if spans and begun < start:
        raise ArgumentError(f"`prior_time` = {start!r} must not lie after {begun!r}, where an uncertain time begins.")
    if spans and callable(v_bound):
        raise ArgumentError("`v_bound` must not depend on time where the time of a reading is uncertain.")
    if not samples:
        raise ArgumentError("`record` must hold at least one measurement, got none.")
    y, times = np.array([come.y for come in samples]), np.array([come.t for come in samples])
    measured = np.isfinite(y)
    for k, come in enumerate(samples):
        measured[k, [each.output for each in come.told]] = True
    bounds = SignalBounds.of(plant, len(y), measured, w_bound, v_bound, times)
    centre_w = np.zeros(plant.n_disturbances) if bounds.w_centre is None else bounds.w_centre
    push = DisturbanceSet(freeze(centre_w), freeze(np.diag(bounds.w)), bounds.w_ball)
    centre_v = np.zeros(y.shape) if bounds.v_centre is None else bounds.v_centre
    error = StartError.of(plant, initial_error)
    if spans and error.root is None:
        proven = start_of_dated(plant, push, inputs, samples, (bounds.v, centre_v), start)
        centre, error = (centre, error) if proven is None else (proven[0], StartError.of(plant, proven[1]))
    rows: list[tuple[float, tuple[RowReading, ...]]] = []

    def read(t: float | None = None) -> Readings:
        some = rows if t is None else [*rows, (t, ())]
        return gathered(plant, push, error, centre, start, some, ball=bounds.v_ball, inputs=inputs)

    for come, values, size, middle in zip(samples, y - centre_v, bounds.v, centre_v, strict=True):
        seen = np.flatnonzero(np.isfinite(size) & np.isfinite(values))
        own = [RowReading(plant.C[i], values[i], size[i]) for i in seen]
        for each in resolved(plant, push, inputs, come.t, come.told, partial(_known, read, come.t)):
            i = each.output
            own += rows_told(plant, come.t, each, float(size[i]), float(middle[i]), inputs)
        rows.append((come.t, tuple(row for row in own if np.isfinite(row.size))))
    if also is not None and also < start:
        raise ArgumentError(f"`t` must not lie before the start {start!r}, got {also!r}.")
    return read(None if also is None or also >= rows[-1][0] or also in dict(rows) else also)


def beginning(items: Sequence[RecordRow]) -> float:
    """The earliest time at which a row may have come; 0 without rows."""
    spans = [each.stamp for come in items for each in come.told if each.stamp is not None]
    return min([items[0].t, *(span.first for span in spans)]) if items else 0.0


def _known(read: Callable[[float], Readings], t: float, rows: Array) -> tuple[Array, Array]:
    """Ends of rows of x(t), by the readings before; NaN where these contradict the bounds."""
    program = RecordProgram(read(t))
    ends = [program.solve(t, row) for row in rows]
    found = np.array([(-down.value, up.value) for up, down in ends]).T
    return (found[0], found[1]) if not program.infeasible else (found[0] * np.nan, found[1] * np.nan)


def _in_order(
    plant: Plant, items: Sequence[RecordRow], start: float
) -> tuple[list[RecordRow], tuple[tuple[float, Array], ...]]:
    """Samples less D u, and inputs."""
    now, u = start, np.zeros(plant.n_inputs)
    samples: list[RecordRow] = []
    inputs: list[tuple[float, Array]] = []
    for come in items:
        t = come.t
        if t < now:
            raise ArgumentError(
                f"`record` must be in order of time and not begin before `prior_time`, got {t!r} after {now!r}."
            )
        now = t
        if come.u is not None and plant.n_inputs:
            u = np.array(checks.vector("u", come.u, plant.n_inputs))
            if inputs and inputs[-1][0] == t:
                inputs.pop()
            inputs.append((t, u))
        if come.y is None or not (come.told or np.isfinite(come.y).any()):
            continue
        if samples and t == samples[-1].t:
            raise ArgumentError(f"`record` measures twice at {t!r}. Put both into one row.")
        samples.append(come._replace(y=come.y - plant.D @ u))
    return samples, tuple(inputs)
