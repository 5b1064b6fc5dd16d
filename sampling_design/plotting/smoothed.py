"""The states of a solved window, with their deviations."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.nonlinear.smoothed import SmoothedWindow
from sampling_design.plotting import style
from sampling_design.records.units import spoken


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
