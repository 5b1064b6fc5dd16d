"""A design in one picture: the samples of a period, what is forbidden, and sigma over the window's position."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from sampling_design._record import short
from sampling_design.design.schedule_design import ScheduleDesign, stated
from sampling_design.errors import ArgumentError
from sampling_design.plotting import style
from sampling_design.plotting.schedules import draw_schedule
from sampling_design.plotting.windows import draw_window_sigma
from sampling_design.schedules.schedule import PeriodicSchedule


def draw_design(result: ScheduleDesign, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw the schedule (on `ax` alone if given), and below it sigma, its proven bound and the bound on all schedules.

    Raises
    ------
    ArgumentError
        If there is no schedule: nothing has to be observed.
    """
    if result.schedule is None or result.window is None:
        raise ArgumentError("`record` has no schedule to draw: every mode decays by itself.")
    if ax is not None:
        return _time_line(result.schedule, result, ax)
    figure, (top, bottom) = style.new_figure(2, ratios=(1.0, 2.2))
    _time_line(result.schedule, result, top)
    shown = stated(result.window, result.requirement)
    draw_window_sigma(shown, bottom)
    note = f"no admissible schedule exceeds {short(result.upper_bound, 4)}"
    bottom.axhline(result.upper_bound, color=style.TRUTH, linestyle="--", linewidth=1.0, label=note)
    style.legend(bottom, 2)
    style.from_below(bottom, shown.lower, max(result.upper_bound, float(shown.profile.sigma.max())))
    figure.suptitle(f"{result.plant.name}: sigma {short(result.sigma, 4)} proven, gap {100 * result.gap:.1f} %")
    return style.Panels([top, bottom])


def _time_line(schedule: PeriodicSchedule, result: ScheduleDesign, ax: Axes) -> Axes:
    draw_schedule(schedule, ax)
    for cycle in (0.0, schedule.period):
        for start, stop in result.requirement.forbidden:
            ax.axvspan(cycle + start, cycle + stop, color=style.ALLOWED, alpha=0.3, linewidth=0, zorder=0)
        for k, name in enumerate(result.plant.outputs.names):
            access = result.requirement.outputs.get(name)
            if access is not None and access.available is not None and schedule.outputs is not None:
                for start, stop in closed(access.available, schedule.period):
                    span = [(cycle + start, stop - start)]
                    ax.broken_barh(span, (k - 0.4, 0.8), color=style.ALLOWED, alpha=0.3, linewidth=0, zorder=0)
    return ax


def closed(available: npt.NDArray[np.float64], period: float) -> list[tuple[float, float]]:
    """What lies between the opening hours of a period."""
    edges = [0.0, *np.ravel(available).tolist(), period]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]
