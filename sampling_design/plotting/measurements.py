"""What was measured, and beside it the truth where it was simulated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from sampling_design.estimators.records.measurements import Measurements
from sampling_design.plants.plant import Plant
from sampling_design.plotting import style
from sampling_design.records.arrays import Array
from sampling_design.records.record import counted
from sampling_design.validation.scenario import SimulatedRecord


def draw_measurements(record: Measurements, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw one panel per output: numbers as points, limits as triangles that point to the truth, means as bars.

    With `ax` only the first output is drawn. Where the record has an origin the axis has dates.
    """
    labels = record.plant.outputs.labels()
    if ax is not None:
        return _panel(ax, record, 0, labels[0])
    figure, axes = style.new_figure(len(labels), row_height=1.7 if len(labels) > 1 else 2.6)
    for i, panel in enumerate(axes):
        _panel(panel, record, i, labels[i])
    style.one_time_axis(axes)
    count = int(record.measured.sum())
    axes[0].set_title(
        f"{counted(count, 'reading')} at {counted(len(record.times), 'time')}", loc="left", fontsize="medium"
    )
    style.legend_above(figure, axes, 5)
    return axes


_LIMITS = {"v": "below this limit", "^": "above this limit", "_": "in an interval"}


def _panel(ax: Axes, record: Measurements, i: int, label: str) -> Axes:
    marks: dict[str, list[tuple[float, float]]] = {"v": [], "^": [], "_": []}
    means: list[tuple[float, float, float]] = []
    for time, row in zip(record.times.tolist(), record.censored, strict=True):
        for each in (each for each in row if each.output == i):
            at = each.lower if np.isfinite(each.lower) else each.upper
            mark = "_" if np.isfinite([each.lower, each.upper]).all() else "^" if np.isfinite(each.lower) else "v"
            marks[mark].append((time, at))
            if each.began is not None:
                means.append((at, *(each.span or (each.began, time))))
    style.points(ax, record.times, record.y[:, i], "o", 3.5, "measured")
    for mark, limits in marks.items():
        if limits:
            style.points(ax, [t for t, _ in limits], [at for _, at in limits], mark, 6, _LIMITS[mark])
    if means:
        ax.hlines(*zip(*means, strict=True), color=style.MEASURED, linewidth=1.2, label="mean over this time")
    ax.set_ylabel(label, fontsize="small")
    ax.margins(x=0.02)
    style.time_axis(ax, record.plant.time_unit, origin=record.origin or None)
    return ax


def draw_simulated(record: SimulatedRecord, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw one panel per state: the truth, and the measurements of an output that reads this state alone.

    Ticks at the bottom mark the samples of a state that no output reads alone. With `ax` only the first state is drawn.
    """
    plant = record.measurements.plant
    assert isinstance(plant, Plant)  # simulated from one

    def truth(panel: Axes, i: int) -> None:
        panel.plot(record.times, record.states[:, i], color=style.TRUTH, linewidth=0.9, label="truth")

    said = f"{counted(len(record.at), 'sample')} of a simulation with {record.noise} noise"
    return state_panels(plant, ax, record.measurements, truth, columns=2, title=said)


def state_panels(
    plant: Plant,
    ax: Axes | None,
    measurements: Measurements | None,
    draw: Callable[[Axes, int], None],
    columns: int = 5,
    title: str = "",
    origin: str = "",
) -> Axes | style.Panels:
    """One panel for each state with what was measured of it, or the first of them on `ax`."""
    labels = plant.states.labels()
    figure, axes = style.new_figure(len(labels) if ax is None else 1, row_height=1.7 if len(labels) > 1 else 2.6)
    panels = axes if ax is None else style.Panels([ax])
    for i, panel in enumerate(panels):
        draw(panel, i)
        if measurements is not None:
            mark_readings(panel, plant, i, measurements)
        panel.set_ylabel(labels[i], fontsize="small")
        panel.margins(x=0.01)
        zero = origin if measurements is None else measurements.origin
        style.time_axis(panel, plant.time_unit, origin=zero or None)
    style.one_time_axis(panels)
    if ax is not None:
        return ax
    axes[0].set_title(title, loc="left", fontsize="medium")
    style.legend_above(figure, axes, columns)
    return axes


def mark_readings(ax: Axes, plant: Plant, i: int, measurements: Measurements) -> None:
    """Mark what was read where an output reads state i alone, rescaled to it; else ticks at the sample times."""
    t, y = readings_of_state(plant, i, measurements)
    if t.size:
        style.points(ax, t, y, ".", 5, "measured")
        return
    style.sample_ticks(ax, measurements.times[measurements.measured.any(axis=1)])


def readings_of_state(plant: Plant, i: int, measurements: Measurements | None) -> tuple[Array, Array]:
    """Times and readings of the outputs that read state i alone, rescaled to it; none where there are none."""
    reads = [k for k, row in enumerate(plant.C) if row[i] and np.count_nonzero(row) == 1]
    if measurements is None or not reads:
        return np.zeros(0), np.zeros(0)
    y = np.concatenate([measurements.y[:, k] / plant.C[k, i] for k in reads])
    return np.tile(measurements.times, len(reads)), y
