"""Estimates over time: each state with its tube, and the measurements that it was made from."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.estimators.online.estimator import FAILURES, EstimateRecord
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.plotting import style


def draw_estimates(
    record: EstimateRecord, ax: Axes | None = None, measurements: Measurements | None = None
) -> Axes | style.Panels:
    """Draw one panel per state: the estimate, the tube that is proven to hold the truth, and what was measured.

    A measured output appears in the panel of the state that it reads; ticks at the bottom mark the other samples.
    With `ax` only the first state is drawn.
    """
    states = record.plant.states
    if ax is not None:
        return _panel(ax, record, 0, measurements)
    figure, axes = style.new_figure(len(states), row_height=1.7)
    for i, panel in enumerate(axes):
        _panel(panel, record, i, measurements)
        if i + 1 < len(axes):
            panel.set_xlabel("")
            panel.tick_params(labelbottom=False)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4, fontsize="small", frameon=False)
    return axes


def _panel(ax: Axes, record: EstimateRecord, i: int, measurements: Measurements | None) -> Axes:
    t, x, radius = record.times, record.x[:, i], record.ellipsoid_radii[:, i]
    known = np.isfinite(radius) & record.certified
    low, high = np.where(known, x - radius, np.nan), np.where(known, x + radius, np.nan)
    ax.fill_between(t, low, high, color=style.PROVEN, alpha=0.2, linewidth=0, label="proven to hold the truth")
    ax.plot(t, x, color=style.ATTAINED, linewidth=1.2, label="estimate")
    failed = np.array([s in FAILURES for s in record.status])
    if failed.any():
        ax.plot(t[failed], x[failed], "x", color=style.FAILED, label="failed")
    if measurements is not None:
        _readings(ax, record, i, measurements)
    ax.set_xlabel(style.time_label(record.plant.time_unit))
    ax.set_ylabel(record.plant.states.labels()[i], fontsize="small")
    ax.margins(x=0.01)
    return ax


def _readings(ax: Axes, record: EstimateRecord, i: int, measurements: Measurements) -> None:
    """Marks where an output reads this state alone, rescaled to it; else ticks at the sample times."""
    C = record.plant.C
    reads = [k for k, row in enumerate(C) if row[i] and np.count_nonzero(row) == 1]
    drawn = np.isfinite(measurements.y).any(axis=1)
    if reads:
        y = np.concatenate([measurements.y[:, k] / C[k, i] for k in reads])
        t = np.tile(measurements.times, len(reads))
        ax.plot(t, y, ".", color=style.MEASURED, markersize=5, label="measured")
        return
    place = ax.get_xaxis_transform()
    ax.vlines(measurements.times[drawn], 0.0, 0.06, color=style.MEASURED, linewidth=0.8, transform=place)
