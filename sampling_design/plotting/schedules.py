"""A schedule on a time line: one row per output, one stem per sample; a family by some of its members."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.plotting import style
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import counted, short
from sampling_design.schedules.family import SamplingFamily
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

MEMBERS = 6  # members of a family that are drawn below its nominal one
GAPS_SHOWN = 8  # longest gaps that the picture of a family is wide


def draw_schedule(schedule: Schedule | PeriodicSchedule, ax: Axes | None = None) -> Axes:
    """Draw the samples of a schedule (of two periods, the second pale, if it is periodic)."""
    ax = style.new_axes(ax, height=1.8 + 0.25 * _rows(schedule))
    _stems(ax, schedule.times, schedule.outputs, _rows(schedule), 1.0)
    if schedule.endless:
        _stems(ax, schedule.times + schedule.period, schedule.outputs, _rows(schedule), 0.35)
        ax.axvline(schedule.first + schedule.period, color=style.ALLOWED, linewidth=0.8, linestyle=":")
    names = schedule.output_names or tuple(f"y{i + 1}" for i in range(_rows(schedule)))
    if schedule.outputs is None and schedule.output_names is None:
        names = ("samples",)
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(-0.6, len(names) - 0.4)
    style.time_axis(ax, schedule.time_unit, origin=schedule.origin)
    gaps = schedule.gaps
    if gaps.size:
        least, most = short(gaps.min(), 4), short(gaps.max(), 4)
        span = f"every {most}" if least == most else f"gaps {least} to {most}"
        ax.set_title(f"{counted(len(schedule), 'sample')}, {span} {schedule.time_unit or ''}".rstrip(), loc="left")
    return ax


def draw_family(family: SamplingFamily, ax: Axes | None = None) -> Axes:
    """Draw the nominal member of a family and, below it, some that were drawn at random."""
    ax, rng = style.new_axes(ax, height=2.8), np.random.default_rng(0)
    members = [family.draw(rng) for _ in range(MEMBERS)]
    end = min(GAPS_SHOWN * family.d_max, max(float(member.times[-1]) for member in members))
    nominal = family.nominal
    planned = nominal.between(0.0, end) if nominal.endless else nominal
    for row, member in enumerate([planned, *members]):
        visible_times, colour = member.times[member.times <= end], style.TRUTH if row == 0 else style.MEASURED
        ax.vlines(visible_times, -row - 0.32, -row + 0.32, color=colour, linewidth=1.8)
    ax.set_yticks([0, -(MEMBERS + 1) / 2], ["nominal", "at random"])
    ax.tick_params(axis="y", length=0)
    ax.set_xlim(0.0, 1.02 * end)
    style.time_axis(ax, family.time_unit)
    ax.set_title(family.explain(), loc="left", fontsize="medium", wrap=True)
    return ax


def _rows(schedule: Schedule | PeriodicSchedule) -> int:
    if schedule.outputs is not None:
        return int(schedule.outputs.shape[1])
    return len(schedule.output_names) if schedule.output_names else 1


def _stems(ax: Axes, times: Array, outputs: Mask | None, rows: int, alpha: float) -> None:
    mask = np.ones((len(times), rows), dtype=bool) if outputs is None else outputs
    for row in range(rows):
        chosen = np.asarray(times)[mask[:, row]]
        ax.vlines(chosen, row - 0.32, row + 0.32, color=style.MEASURED, alpha=alpha, linewidth=1.8)
