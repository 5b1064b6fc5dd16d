"""Estimates over time: each state with what is proven of it, and the measurements that it was made from."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.estimators.online.curve import EstimateCurve
from sampling_design.estimators.online.envelope import EstimateEnvelope
from sampling_design.estimators.online.estimate import FAILURES
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.plotting import style
from sampling_design.plotting.measurements import readings_of_state, state_panels
from sampling_design.records.arrays import Array
from sampling_design.records.record import counted


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
    envelope.add(record.times, record.x, record.ellipsoid_radii, record.certified, failed)
    return draw_envelope(envelope, ax, measurements, record.origin)


def draw_envelope(
    record: EstimateEnvelope, ax: Axes | None = None, measurements: Measurements | None = None, origin: str = ""
) -> Axes | style.Panels:
    """Draw one panel per state: at each sample, or over stretches of time, the estimates and what is proven of them."""
    draw = _stretches if record.length else _bars
    proven = int(np.isfinite(record.lower).all(axis=1).sum())
    parts = counted(len(record.lower), "interval" if record.length else "sample")
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
