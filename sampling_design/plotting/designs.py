"""A design in one picture: the samples of a period, what is forbidden, and sigma over the window's position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from sampling_design.design.schedule_design import ScheduleDesign
from sampling_design.errors import ArgumentError
from sampling_design.plotting import style
from sampling_design.plotting.schedules import draw_schedule
from sampling_design.plotting.windows import draw_deviations, draw_window_sigma
from sampling_design.records.arrays import Array
from sampling_design.records.record import short
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.schedules.sensor import numbers


def draw_design(result: ScheduleDesign, ax: Axes | None = None, *, origin: str | None = None) -> Axes | style.Panels:
    """Draw the schedule (on `ax` alone if given), and below it sigma, its proven bound and the bound on all schedules.

    `origin` is the date of time zero (ISO 8601), where it is known: then the axes show weekdays and dates. Raises
    ArgumentError if there is no schedule: nothing has to be observed.
    """
    if result.schedule is None or result.window is None:
        raise ArgumentError("`record` has no schedule to draw: every mode decays by itself.")
    schedule = result.schedule if origin is None else replace(result.schedule, origin=origin)
    if (
        result.requirement.sensors and schedule.outputs is None
    ):  # sensors with terms of their own have rows of their own
        names = result.plant.outputs.names
        schedule = replace(schedule, outputs=np.ones((len(schedule), len(names)), dtype=bool), output_names=names)
    if ax is not None:
        return _time_line(schedule, result, ax)
    rows = 1 if schedule.outputs is None else schedule.outputs.shape[1]
    figure, (top, bottom) = style.new_figure(2, ratios=(0.75 + 0.3 * rows, 2.4), row_height=2.6 + 0.1 * rows)
    _time_line(schedule, result, top)
    sigma_found = result.window
    draw_window_sigma(sigma_found, bottom, beside=False, origin=schedule.origin)
    bottom.set_title("", loc="left")  # the whole picture has one
    top_value, gap = float(sigma_found.profile.sigma.max()), "the bound on all schedules is too far off to say more"
    if not result.bound_is_vacuous:
        note = f"no admissible schedule exceeds {short(result.upper_bound, 4)}"
        bottom.axhline(result.upper_bound, color=style.TRUTH, linestyle="--", linewidth=1.0, label=note)
        top_value, gap = max(result.upper_bound, top_value), f"gap {100 * result.gap:.1f} %"
    least = draw_deviations(result.deviations, bottom)
    style.legend(bottom, 2)
    style.from_below(bottom, min(sigma_found.lower, least), top_value)
    if schedule.origin is not None:
        label = bottom.get_xlabel()
        style.dates(bottom, schedule.time_unit, schedule.origin)
        bottom.set_xlabel(label.partition(" [")[0])
    late = f" for samples {result.late.describe(result.plant.time_unit)}" if result.late else ""
    figure.suptitle(f"{result.plant.name}: sigma {short(result.sigma, 4)} proven{late}, {gap}", wrap=True)
    return style.Panels([top, bottom])


def _time_line(schedule: PeriodicSchedule, result: ScheduleDesign, ax: Axes) -> Axes:
    draw_schedule(schedule, ax)
    everybody = [(float(a), float(b)) for a, b in result.requirement.forbidden]
    grey = False
    for k, name in enumerate(result.plant.outputs.names if schedule.outputs is not None else ("",)):
        term = result.requirement.sensors.get(name)
        own = [] if term is None or term.available is None else closed(numbers(term), schedule.period)
        spans = _joined(everybody + own)
        style.shut(ax, k, [(cycle + a, cycle + b) for cycle in (0.0, schedule.period) for a, b in spans])
        grey |= bool(spans)
    if grey:
        ax.set_title(f"{ax.get_title(loc='left')}; grey: closed", loc="left")
    return ax


def _joined(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Spans without overlap, in order: what is closed twice is no darker."""
    found: list[tuple[float, float]] = []
    for start, stop in sorted(spans):
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(stop, found[-1][1]))
        else:
            found.append((start, stop))
    return found


def closed(available: Array, period: float) -> list[tuple[float, float]]:
    """What lies between the opening hours of a period."""
    edges = [0.0, *np.ravel(available).tolist(), period]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]
