"""Promises and what became of them: errors against bounds, tubes around each state, planned and actual times."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.plotting import style
from sampling_design.records.arrays import Array
from sampling_design.records.record import below, short
from sampling_design.validation.report import ValidationReport
from sampling_design.validation.schedule_log import ScheduleLog

_LINES = ("-", "--", "-.", ":")
FLOOR = 1e-6
"""Share of the largest error below which a log axis shows nothing more."""


def draw_validation(report: ValidationReport, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw the errors against the bound on a log axis and, below, one run of the estimator inside its tubes."""
    if ax is not None:
        return _errors(report, ax)
    if report.example is None:
        return _errors(report, style.new_axes(height=3.6))
    count = len(report.plant.states)
    _, axes = style.new_figure(1 + count, row_height=1.8 if count > 1 else 2.6, ratios=(2.2, *([1.0] * count)))
    _errors(report, axes[0])
    for i, panel in enumerate(axes[1:]):
        _tube(report, i, panel)
    style.one_time_axis(axes[1:])
    style.legend(axes[1])
    return axes


def _errors(report: ValidationReport, ax: Axes) -> Axes:
    top = 0.0 if report.bound is None else float(np.max(report.bound))
    for error_curve, line in zip(report.error_curves, _LINES * len(report.error_curves), strict=False):
        top = max(top, float(np.max(error_curve.largest)))
        largest = np.where(error_curve.largest > 0, error_curve.largest, np.nan)
        ax.plot(report.times, largest, line, color=style.ATTAINED, linewidth=1.1, label=f"largest, {error_curve.name}")
        if error_curve.name == "random noise":
            median = np.where(error_curve.median > 0, error_curve.median, np.nan)
            ax.plot(report.times, median, color=style.MEASURED, linewidth=0.6, label=f"median, {error_curve.name}")
    if report.bound is not None:
        ax.plot(report.times, report.bound, color=style.PROVEN, linewidth=1.6, label="proven for every run")
    ax.set_yscale("log")
    if top > 0:
        drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in ax.lines])
        ax.set_ylim(bottom=max(FLOOR * top, np.min(drawn[drawn > 0]) / 3), top=3 * top)
    broken = len(report.broken)
    verdict = f"{broken} promise{'s' * (broken != 1)} broken" if broken else "not all promises were checked"
    verdict = "all promises held" if report.passed else verdict
    ax.set_title(verdict, loc="left", color=style.TRUTH if report.passed else style.FAILED)
    style.time_axis(ax, report.plant.time_unit)
    ax.set_ylabel(f"error: {report.norm}".replace(", ", ",\n"), fontsize="small")
    style.legend(ax, 3)
    return ax


def _tube(report: ValidationReport, i: int, ax: Axes) -> None:
    run = report.example
    assert run is not None
    t, radius = run.times, run.radii[:, i]
    ax.fill_between(t, -radius, radius, color=style.PROVEN, alpha=0.2, linewidth=0, label="proven to hold the error")
    ax.plot(t, run.errors[:, i], color=style.ATTAINED, linewidth=1.0, label="error of one run")
    ax.axhline(0.0, color=style.TRUTH, linewidth=0.6)
    style.not_ruled_by_the_start(ax, t, np.minimum(-radius, run.errors[:, i]), np.maximum(radius, run.errors[:, i]))
    style.time_axis(ax, report.plant.time_unit)
    ax.set_ylabel(report.plant.states.labels()[i], fontsize="small")
    ax.margins(x=0.01)


DRAWN = 300  # planned samples of a log that are drawn: of a longer one those around its worst window


def draw_schedule_log(log: ScheduleLog, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw planned and actual times and, below, sigma over the window's end for both.

    Of a long record what lies around its worst window is drawn.
    """
    low, high = _drawn(log)
    if ax is not None:
        return _times(log, ax, low, high)
    if log.planned_sigma is None or log.actual_sigma is None:
        return _times(log, style.new_axes(height=2.0), low, high)
    _, (top, bottom) = style.new_figure(2, ratios=(1.0, 1.4))
    _times(log, top, low, high)
    highest = 0.0
    for sigma, colour, width, name in (
        (log.planned_sigma, style.ALLOWED, 3.5, "planned"),
        (log.actual_sigma, style.MEASURED, 1.3, "actual"),
    ):
        profile, label = sigma.profile, f"{name}: at least {below(sigma.lower, 4)}"
        in_view = (low <= profile.t) & (profile.t <= high)
        curve = style.by_pieces(profile.t[in_view], profile.sigma[in_view], profile.piece[in_view])
        bottom.plot(*curve, color=colour, linewidth=width, label=label)
        highest = float(profile.sigma[in_view].max(initial=highest))
    style.from_below(bottom, 0.0, highest)
    style.time_axis(bottom, log.time_unit, "end of the window")
    bottom.set_ylabel(style.sigma_label(log.planned_sigma.coordinates))
    style.legend(bottom)
    return style.Panels([top, bottom])


def _drawn(log: ScheduleLog) -> tuple[float, float]:
    """The stretch of time that is drawn."""
    times = log.planned.times
    if times.size <= DRAWN:
        return -np.inf, np.inf
    worst = times[0] if log.actual_sigma is None else log.actual_sigma.witness.t
    first = min(max(int(np.searchsorted(times, worst)) - DRAWN // 2, 0), times.size - DRAWN)
    return float(times[first]), float(times[first + DRAWN - 1])


def _times(log: ScheduleLog, ax: Axes, low: float, high: float) -> Axes:
    def visible(times: Array) -> Array:
        return times[(low <= times) & (times <= high)]

    ax.vlines(visible(log.planned.times), 0.6, 1.4, color=style.ALLOWED, linewidth=1.8)
    ax.vlines(visible(log.actual.times), -0.4, 0.4, color=style.MEASURED, linewidth=1.8)
    drawn = (low <= log.planned.times) & (log.planned.times <= high) & (log.match >= 0)
    for k in np.flatnonzero(drawn):
        ax.plot([log.planned.times[k], log.actual.times[log.match[k]]], [0.6, 0.4], color=style.TRUTH, linewidth=0.6)
    missed, extra = visible(log.missed), visible(log.extra)
    ax.plot(missed, np.ones(missed.size), "x", color=style.FAILED)
    ax.plot(extra, np.zeros(extra.size), "o", color=style.MEASURED, markerfacecolor="none")
    ax.set_yticks([0, 1], ["actual", "planned"])
    ax.set_ylim(-0.6, 1.6)
    style.time_axis(ax, log.time_unit)
    away = f"largest deviation {short(log.largest_deviation, 4)} {log.time_unit or ''}".rstrip()
    ax.set_title(f"{log.missed.size} missed, {log.extra.size} not planned, {away}", loc="left")
    return ax
