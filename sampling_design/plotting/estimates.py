"""What was measured, what was estimated from it, and the truth where it was simulated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from sampling_design.estimators.online.curve import EstimateCurve, EstimateEnvelope
from sampling_design.estimators.online.estimate import FAILURES
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.nonlinear.smoothed import SmoothedWindow
from sampling_design.plants.plant import Plant
from sampling_design.plotting import style
from sampling_design.records.arrays import Array
from sampling_design.records.record import counted
from sampling_design.records.units import spoken
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


def draw_smoothed(window: SmoothedWindow, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw one panel per state: the smoothed state and a band of one standard deviation of the linearised window.

    Ticks at the bottom mark the samples. With `ax` only the first state is drawn.
    """
    labels = window.plant.states.labels()
    _, axes = style.new_figure(len(labels) if ax is None else 1, row_height=1.7 if len(labels) > 1 else 2.6)
    panels = list(axes) if ax is None else [ax]
    sampled = window.times[np.isfinite(window.residuals).any(axis=1)]
    for i, panel in enumerate(panels):
        x, far = window.x[:, i], window.deviation[:, i]
        said = "one standard deviation, to first order"
        panel.fill_between(window.times, x - far, x + far, color=style.ESTIMATE, alpha=0.2, linewidth=0, label=said)
        panel.plot(window.times, x, color=style.ESTIMATE, linewidth=1.2, label="smoothed")
        place = panel.get_xaxis_transform()
        panel.vlines(sampled, 0.0, 0.06, color=style.MEASURED, linewidth=0.8, transform=place, label="samples")
        panel.set_ylabel(labels[i], fontsize="small")
        panel.margins(x=0.01)
        style.time_axis(panel, window.plant.time_unit)
    style.one_time_axis(panels)
    over = spoken(float(window.times[-1] - window.times[0]), window.plant.time_unit)
    panels[0].set_title(f"states over the last {over}, by all measurements", loc="left", fontsize="medium")
    style.legend(panels[0])
    return ax if ax is not None else axes


def draw_estimates(
    record: EstimateRecord, ax: Axes | None = None, measurements: Measurements | None = None
) -> Axes | style.Panels:
    """Draw one panel per state: the estimates, the ellipsoids proven there as bars, and what was measured.

    A measured output appears in the panel of the state that it reads; ticks at the bottom mark the other samples.
    With `ax` only the first state is drawn. Of a long record the extremes over short stretches are drawn. What holds
    the truth between samples is in an `estimate_curve`. Where they or the measurements have dates, so has the axis.
    """
    envelope = EstimateEnvelope.over(record.plant, record.times)
    failed = np.array([status in FAILURES for status in record.status], dtype=bool)
    envelope = envelope.including(record.times, record.x, record.ellipsoid_radii, record.certified, failed)
    return draw_envelope(envelope, ax, measurements, record.origin)


def draw_envelope(
    record: EstimateEnvelope, ax: Axes | None = None, measurements: Measurements | None = None, origin: str = ""
) -> Axes | style.Panels:
    """Draw one panel per state: at each sample, or over stretches of time, the estimates and what is proven of them."""
    draw = _stretches if record.length else _bars
    proven = int(np.isfinite(record.lower).all(axis=1).sum())
    found = int(np.isfinite(record.lowest).all(axis=1).sum())
    parts = counted(found, "interval" if record.length else "estimate")
    said = f"error bounds are proven for {proven} of {parts}"

    def drawn(panel: Axes, i: int) -> None:
        draw(panel, record, i, readings_of_state(record.plant, i, measurements)[1])

    return state_panels(record.plant, ax, measurements, drawn, title=said, origin=origin)


def draw_curve(curve: EstimateCurve, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw estimates with the tube that holds the truth at all times, one panel for each state."""
    tube, plant, read = curve.tube, curve.estimates.plant, curve.measurements
    whole = tube is not None and bool(np.isfinite(tube.lower).all() and np.isfinite(tube.upper).all())
    said = "the true state is proven to lie in the band at all times" if whole else "estimates"

    def drawn(panel: Axes, i: int) -> None:
        _band(panel, curve, i, readings_of_state(plant, i, read)[1])

    return state_panels(plant, ax, read, drawn, title=said)


def _bars(ax: Axes, record: EstimateEnvelope, i: int, read: Array) -> None:
    """A bar at each sample: a band through them would say something of the times between, which nobody has proven."""
    t, low, high = record.times, record.lower[:, i], record.upper[:, i]
    known = np.isfinite(low)
    width = min(4.0, 500.0 / max(t.size, 1))
    ax.vlines(
        t[known], low[known], high[known], color=style.PROVEN, alpha=0.4, linewidth=width, label="proven at the samples"
    )
    x = (record.lowest[:, i] + record.highest[:, i]) / 2
    ax.plot(t, x, ".-", color=style.ESTIMATE, linewidth=0.7, markersize=width, label="estimate")
    style.not_ruled_by_the_start(ax, t, low, high, np.append(x, read))
    if record.failed.any():
        ax.plot(t[record.failed], x[record.failed], "x", color=style.FAILED, label="failed")


def _stretches(ax: Axes, record: EstimateEnvelope, i: int, read: Array) -> None:
    """The extremes of many samples over each stretch."""
    low, high, edges = record.lower[:, i], record.upper[:, i], record.edges
    least, largest = record.lowest[:, i], record.highest[:, i]
    ax.use_sticky_edges = False  # else the axis ends where the band does, as if it went on
    ax.stairs(high, edges, baseline=low, fill=True, color=style.PROVEN, alpha=0.2, label="proven at the samples")
    style.filled(ax, edges, least, largest, style.ESTIMATE, "estimates, least to largest")
    style.not_ruled_by_the_start(ax, record.times, low, high, np.concatenate([least, largest, read]))
    for edge in edges[:-1][record.failed]:
        ax.axvline(float(edge), color=style.FAILED, linewidth=0.5)


def _band(ax: Axes, curve: EstimateCurve, i: int, read: Array) -> None:
    """The tube between and at samples, with the open loop between them."""
    record, tube = curve.estimates, curve.tube
    if tube is not None:
        t, low, high = tube.times, tube.lower[:, i], tube.upper[:, i]
        bounded = np.isfinite(low) & np.isfinite(high)
        low, high = np.where(bounded, low, np.nan), np.where(bounded, high, np.nan)
        said = "proven to hold the truth at all times"
        ax.fill_between(t, low, high, color=style.PROVEN, alpha=0.2, linewidth=0, label=said)
        style.not_ruled_by_the_start(ax, t, low, high, np.append(record.x[:, i], read))
    ax.plot(record.times, record.x[:, i], color=style.ESTIMATE, linewidth=1.2, label="estimate")
    failed = np.array([s in FAILURES for s in record.status], dtype=bool)
    if failed.any():
        ax.plot(record.times[failed], record.x[failed, i], "x", color=style.FAILED, label="failed")
