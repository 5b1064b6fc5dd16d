"""Estimates over time: each state with its tube, and the measurements that it was made from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from sampling_design.estimators.online.curve import EstimateCurve
from sampling_design.estimators.online.envelope import EstimateEnvelope
from sampling_design.estimators.online.estimate import FAILURES
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.online.tube import Tube
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.plotting import style
from sampling_design.plotting.readings import mark_readings


def draw_estimates(
    record: EstimateRecord,
    ax: Axes | None = None,
    measurements: Measurements | None = None,
    tube: Tube | None = None,
) -> Axes | style.Panels:
    """Draw one panel per state: the estimate, the tube that is proven to hold the truth, and what was measured.

    A measured output appears in the panel of the state that it reads; ticks at the bottom mark the other samples.
    With `ax` only the first state is drawn. `tube` is what holds the truth between samples, too (`estimate_curve` has
    it); without it the ellipsoids are drawn as bars, at the times of the estimates alone. Where the measurements have
    dates, so has the axis.
    """
    states = record.plant.states
    if ax is not None:
        return _panel(ax, record, 0, measurements, tube)
    figure, axes = style.new_figure(len(states), row_height=1.7 if len(states) > 1 else 2.6)
    for i, panel in enumerate(axes):
        _panel(panel, record, i, measurements, tube)
    style.one_time_axis(axes)
    style.legend_above(figure, axes[0], 4)
    return axes


def draw_curve(curve: EstimateCurve, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw estimates with the tube that holds the truth at all times, one panel for each state."""
    return draw_estimates(curve.estimates, ax, curve.measurements, curve.tube)


def draw_envelope(
    record: EstimateEnvelope, ax: Axes | None = None, measurements: Measurements | None = None
) -> Axes | style.Panels:
    """Draw one panel per state: over stretches of time the extremes of the estimates and of what is proven."""
    states = record.plant.states
    figure, axes = style.new_figure(len(states) if ax is None else 1, row_height=1.7 if len(states) > 1 else 2.6)
    panels: Sequence[Axes] = axes if ax is None else [ax]
    edges = record.edges
    for i, panel in enumerate(panels):
        low, high = record.lower[:, i], record.upper[:, i]
        panel.stairs(high, edges, baseline=low, fill=True, color=style.PROVEN, alpha=0.2, label="proven at the samples")
        for level, label in ((record.lowest[:, i], "estimates, least and largest"), (record.highest[:, i], None)):
            panel.stairs(level, edges, baseline=None, color=style.ATTAINED, linewidth=0.9, label=label)
        style.not_ruled_by_the_start(panel, low, high)
        for edge in edges[:-1][record.failed]:
            panel.axvline(float(edge), color=style.FAILED, linewidth=0.5)
        panel.set_ylabel(states.labels()[i], fontsize="small")
        panel.margins(x=0.01)
    for panel in panels:
        _clock(panel, record, measurements)
    style.one_time_axis(panels)
    if ax is not None:
        return ax
    style.legend_above(figure, axes[0], 4)
    return axes


def _panel(ax: Axes, record: EstimateRecord, i: int, measurements: Measurements | None, tube: Tube | None) -> Axes:
    t, x = record.times, record.x[:, i]
    if tube is None:
        radius = record.ellipsoid_radii[:, i]
        known = np.isfinite(radius) & record.certified
        low, high = x - radius, x + radius
        # bars: a band through them would say something of the times between, which nobody has proven
        ax.vlines(
            t[known], low[known], high[known], color=style.PROVEN, alpha=0.4, linewidth=4, label="proven at the samples"
        )
        ax.plot(t, x, ".-", color=style.ATTAINED, linewidth=0.7, label="estimate")
        low, high = np.where(known, low, np.nan), np.where(known, high, np.nan)
    else:
        s, low, high = tube.times, tube.lower[:, i], tube.upper[:, i]
        bounded = np.isfinite(low) & np.isfinite(high)
        low, high = np.where(bounded, low, np.nan), np.where(bounded, high, np.nan)
        said = "proven to hold the truth at all times"
        ax.fill_between(s, low, high, color=style.PROVEN, alpha=0.2, linewidth=0, label=said)
        ax.plot(t, x, color=style.ATTAINED, linewidth=1.2, label="estimate")
    style.not_ruled_by_the_start(ax, low, high)
    failed = np.array([s in FAILURES for s in record.status])
    if failed.any():
        ax.plot(t[failed], x[failed], "x", color=style.FAILED, label="failed")
    if measurements is not None:
        mark_readings(ax, record.plant, i, measurements)
    ax.set_ylabel(record.plant.states.labels()[i], fontsize="small")
    ax.margins(x=0.01)
    _clock(ax, record, measurements)
    return ax


def _clock(ax: Axes, record: EstimateRecord | EstimateEnvelope, measurements: Measurements | None) -> None:
    """Say what the axis shows: dates where the measurements have them."""
    unit = record.plant.time_unit
    ax.set_xlabel(style.time_label(unit))
    style.dates(ax, unit, (measurements.origin or None) if measurements is not None else None)
