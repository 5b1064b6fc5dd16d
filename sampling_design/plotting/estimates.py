"""Estimates over time: each state with its tube, and the measurements that it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num

from sampling_design._units import SECONDS
from sampling_design.estimators.online.envelope import EstimateEnvelope
from sampling_design.estimators.online.estimator import FAILURES, EstimateRecord
from sampling_design.estimators.online.tube import Tube
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.plotting import style

Array = npt.NDArray[np.float64]


def draw_estimates(
    record: EstimateRecord,
    ax: Axes | None = None,
    measurements: Measurements | None = None,
    tube: Tube | None = None,
) -> Axes | style.Panels:
    """Draw one panel per state: the estimate, the tube that is proven to hold the truth, and what was measured.

    A measured output appears in the panel of the state that it reads; ticks at the bottom mark the other samples.
    With `ax` only the first state is drawn. `tube` is what holds the truth between samples, too; without it the
    ellipsoids are drawn. Where the measurements have dates, so has the axis.
    """
    states = record.plant.states
    if ax is not None:
        return _panel(ax, record, 0, measurements, tube)
    figure, axes = style.new_figure(len(states), row_height=1.7)
    for i, panel in enumerate(axes):
        _panel(panel, record, i, measurements, tube)
        if i + 1 < len(axes):
            panel.set_xlabel("")
            panel.tick_params(labelbottom=False)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4, fontsize="small", frameon=False)
    return axes


def draw_envelope(
    record: EstimateEnvelope, ax: Axes | None = None, measurements: Measurements | None = None
) -> Axes | style.Panels:
    """Draw one panel per state: over stretches of time the extremes of the estimates and of what is proven."""
    states = record.plant.states
    figure, axes = style.new_figure(len(states) if ax is None else 1, row_height=1.7)
    panels: Sequence[Axes] = axes if ax is None else [ax]
    when = _AxisClock(record, measurements)
    edges = when(record.edges)
    for i, panel in enumerate(panels):
        low, high = record.lower[:, i], record.upper[:, i]
        panel.stairs(high, edges, baseline=low, fill=True, color=style.PROVEN, alpha=0.2, label="proven at the samples")
        for level, label in ((record.lowest[:, i], "estimates, least and largest"), (record.highest[:, i], None)):
            panel.stairs(level, edges, baseline=None, color=style.ATTAINED, linewidth=0.9, label=label)
        _not_ruled_by_the_start(panel, low, high)
        for edge in edges[:-1][record.failed]:
            panel.axvline(float(edge), color=style.FAILED, linewidth=0.5)
        panel.set_ylabel(states.labels()[i], fontsize="small")
        panel.margins(x=0.01)
    when.label(panels[-1])
    for panel in panels[:-1]:
        panel.tick_params(labelbottom=False)
    if ax is not None:
        return ax
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4, fontsize="small", frameon=False)
    return axes


def _panel(ax: Axes, record: EstimateRecord, i: int, measurements: Measurements | None, tube: Tube | None) -> Axes:
    when = _AxisClock(record, measurements)
    t, x, radius = when(record.times), record.x[:, i], record.ellipsoid_radii[:, i]
    known = np.isfinite(radius) & record.certified
    s, low, high = t, np.where(known, x - radius, np.nan), np.where(known, x + radius, np.nan)
    if tube is not None:
        s, low, high = when(tube.times), tube.lower[:, i], tube.upper[:, i]
        bounded = np.isfinite(low) & np.isfinite(high)
        low, high = np.where(bounded, low, np.nan), np.where(bounded, high, np.nan)
    ax.fill_between(s, low, high, color=style.PROVEN, alpha=0.2, linewidth=0, label="proven to hold the truth")
    ax.plot(t, x, color=style.ATTAINED, linewidth=1.2, label="estimate")
    _not_ruled_by_the_start(ax, low, high)
    failed = np.array([s in FAILURES for s in record.status])
    if failed.any():
        ax.plot(t[failed], x[failed], "x", color=style.FAILED, label="failed")
    if measurements is not None:
        _readings(ax, record, i, measurements, when)
    when.label(ax)
    ax.set_ylabel(record.plant.states.labels()[i], fontsize="small")
    ax.margins(x=0.01)
    return ax


START = 0.25
"""Share of the tube, the first one, that does not rule the axis: a wide start would flatten all that follows."""
STRETCH = 1.5


def _not_ruled_by_the_start(ax: Axes, low: Array, high: Array) -> None:
    """Limit the y axis by what comes after the start, where the start alone would stretch it by half."""
    known = np.isfinite(low) & np.isfinite(high)
    low, high = low[known], high[known]
    kept = slice(int(np.ceil(START * low.size)), None)
    if not low[kept].size:
        return
    bottom, top = float(low[kept].min()), float(high[kept].max())
    if top > bottom and float(high.max() - low.min()) > STRETCH * (top - bottom):
        room = 0.15 * (top - bottom)
        ax.set_ylim(bottom - room, top + room)


class _AxisClock:
    """Times as they stand on the axis: dates where the measurements have them."""

    def __init__(self, record: EstimateRecord | EstimateEnvelope, measurements: Measurements | None):
        self.unit = record.plant.time_unit
        self.origin = measurements.origin if measurements is not None else ""

    def __call__(self, times: Array) -> Array:
        if not self.origin:
            return times
        start = float(date2num(datetime.fromisoformat(self.origin)))  # type: ignore[no-untyped-call]
        return np.asarray(start + times * (SECONDS[self.unit] / SECONDS["d"]))

    def label(self, ax: Axes) -> None:
        """Say what the axis shows."""
        if not self.origin:
            ax.set_xlabel(style.time_label(self.unit))
            return
        locator = AutoDateLocator()  # type: ignore[no-untyped-call]
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        ax.set_xlabel("date (UTC)")


def _readings(ax: Axes, record: EstimateRecord, i: int, measurements: Measurements, when: _AxisClock) -> None:
    """Marks where an output reads this state alone, rescaled to it; else ticks at the sample times."""
    C = record.plant.C
    reads = [k for k, row in enumerate(C) if row[i] and np.count_nonzero(row) == 1]
    drawn = measurements.measured.any(axis=1)
    if reads:
        y = np.concatenate([measurements.y[:, k] / C[k, i] for k in reads])
        t = np.tile(when(measurements.times), len(reads))
        ax.plot(t, y, ".", color=style.MEASURED, markersize=5, label="measured")
        return
    place = ax.get_xaxis_transform()
    ax.vlines(when(measurements.times[drawn]), 0.0, 0.06, color=style.MEASURED, linewidth=0.8, transform=place)
