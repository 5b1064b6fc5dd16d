"""How well anybody can know: both bounds of every row over one period of the schedule."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from sampling_design._record import short
from sampling_design.plotting import style
from sampling_design.recovery.accuracy import Accuracy


def draw_accuracy(result: Accuracy, ax: Axes | Sequence[Axes] | None = None) -> list[Axes]:
    """Draw the bracket of each row over a period, one axes below the other; samples are ticks on the time axis."""
    count = len(result.rows)
    axes = list(np.ravel(np.asarray(ax, dtype=object))) if ax is not None else _stack(count)
    profile = result.profile
    for k, one in zip(range(count), axes, strict=False):
        label = result.rows.labels()[k]
        one.set_ylabel(f"error of\n{label}")
        for t in profile.samples:
            one.axvline(t, color=style.ALLOWED, linewidth=0.8, zorder=0)
        if not np.isfinite(result.upper[k]):
            one.text(0.5, 0.5, "unknown for ever", transform=one.transAxes, ha="center", color=style.FAILED)
            continue
        one.fill_between(
            profile.edges,
            np.append(profile.lower[k], profile.lower[k, -1]),
            np.append(profile.upper[k], profile.upper[k, -1]),
            step="post",
            color=style.PROVEN,
            alpha=0.3,
            linewidth=0,
        )
        one.stairs(
            profile.upper[k], profile.edges, baseline=None, color=style.PROVEN, label="guaranteed by an estimator"
        )
        one.plot(
            profile.edges[:-1], profile.lower[k], color=style.ATTAINED, linewidth=1.0, label="nobody guarantees less"
        )
        one.plot(result.worst[k], result.lower[k], "o", color=style.ATTAINED, markersize=4)
        one.set_ylim(bottom=0.0)
        one.set_title(f"{short(result.lower[k], 4)} to {short(result.upper[k], 4)} at the worst time", loc="left")
    axes[-1].set_xlabel(style.time_label(result.plant.time_unit, "time in the period, samples grey"))
    finite = [one for k, one in enumerate(axes[:count]) if np.isfinite(result.upper[k])]
    if finite:
        finite[0].legend(loc="lower right", fontsize="small", frameon=False)
    return axes


def _stack(count: int) -> list[Axes]:
    first = style.new_axes(None, height=1.0 + 1.9 * count)
    figure = first.figure
    first.remove()
    return list(np.ravel(figure.subplots(count, 1, sharex=True)))
