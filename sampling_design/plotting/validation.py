"""Promises and what became of them: errors against bounds, tubes around each state, planned and actual times."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design._record import short
from sampling_design.plotting import style
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
    _, axes = style.new_figure(1 + count, row_height=1.8, ratios=(2.2, *([1.0] * count)))
    _errors(report, axes[0])
    for i, panel in enumerate(axes[1:]):
        _tube(report, i, panel)
        if i + 1 < count:
            panel.set_xlabel("")
            panel.tick_params(labelbottom=False)
    style.legend(axes[1])
    return axes


def _errors(report: ValidationReport, ax: Axes) -> Axes:
    top = 0.0 if report.bound is None else float(np.max(report.bound))
    for course, line in zip(report.courses, _LINES * len(report.courses), strict=False):
        top = max(top, float(np.max(course.largest)))
        largest = np.where(course.largest > 0, course.largest, np.nan)
        ax.plot(report.times, largest, line, color=style.ATTAINED, linewidth=1.1, label=f"largest, {course.name}")
        if course.name == "random noise":
            median = np.where(course.median > 0, course.median, np.nan)
            ax.plot(report.times, median, color=style.MEASURED, linewidth=1.1, label=f"median, {course.name}")
    if report.bound is not None:
        ax.plot(report.times, report.bound, color=style.PROVEN, linewidth=1.6, label="proven for every run")
    ax.set_yscale("log")
    if top > 0:
        ax.set_ylim(bottom=FLOOR * top, top=3 * top)
    broken = sum(not f.passed for f in report.findings)
    verdict = "all promises held" if report.passed else f"{broken} promise{'s' * (broken != 1)} broken"
    ax.set_title(verdict, loc="left", color=style.TRUTH if report.passed else style.FAILED)
    ax.set_xlabel(style.time_label(report.plant.time_unit))
    ax.set_ylabel(f"error: {report.norm}", fontsize="small")
    style.legend(ax, 3)
    return ax


def _tube(report: ValidationReport, i: int, ax: Axes) -> None:
    run = report.example
    assert run is not None
    t, radius = run.times, run.radii[:, i]
    ax.fill_between(t, -radius, radius, color=style.PROVEN, alpha=0.2, linewidth=0, label="proven to hold the error")
    ax.plot(t, run.errors[:, i], color=style.ATTAINED, linewidth=1.0, label="error of one run")
    ax.axhline(0.0, color=style.TRUTH, linewidth=0.6)
    ax.set_xlabel(style.time_label(report.plant.time_unit))
    ax.set_ylabel(report.plant.states.labels()[i], fontsize="small")
    ax.margins(x=0.01)


def draw_schedule_log(log: ScheduleLog, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw planned and actual times and, below, sigma over the window's end for both."""
    if ax is not None:
        return _times(log, ax)
    if log.planned_sigma is None or log.actual_sigma is None:
        return _times(log, style.new_axes(height=2.0))
    _, (top, bottom) = style.new_figure(2, ratios=(1.0, 1.4))
    _times(log, top)
    for sigma, colour, name in (
        (log.planned_sigma, style.ALLOWED, "planned"),
        (log.actual_sigma, style.MEASURED, "actual"),
    ):
        label: str | None = f"{name}: at least {short(sigma.lower, 4)}"
        for index in np.unique(sigma.profile.piece):
            here = sigma.profile.piece == index
            bottom.plot(sigma.profile.t[here], sigma.profile.sigma[here], color=colour, linewidth=1.3, label=label)
            label = None
    bottom.set_ylim(bottom=0.0)
    bottom.set_xlabel(style.time_label(log.time_unit, f"end of the window of length {short(log.planned_sigma.window)}"))
    bottom.set_ylabel("sigma (state at window's start)")
    style.legend(bottom)
    return style.Panels([top, bottom])


def _times(log: ScheduleLog, ax: Axes) -> Axes:
    ax.vlines(log.planned.times, 0.6, 1.4, color=style.ALLOWED, linewidth=1.8)
    ax.vlines(log.actual.times, -0.4, 0.4, color=style.MEASURED, linewidth=1.8)
    for k, at in enumerate(log.match):
        if at >= 0:
            ax.plot([log.planned.times[k], log.actual.times[at]], [0.6, 0.4], color=style.TRUTH, linewidth=0.6)
    ax.plot(log.missed, np.ones(log.missed.size), "x", color=style.FAILED)
    ax.plot(log.extra, np.zeros(log.extra.size), "o", color=style.ATTAINED, markerfacecolor="none")
    ax.set_yticks([0, 1], ["actual", "planned"])
    ax.set_ylim(-0.6, 1.6)
    ax.set_xlabel(style.time_label(log.time_unit))
    away = f"largest deviation {short(log.largest_deviation, 4)}"
    ax.set_title(f"{log.missed.size} missed, {log.extra.size} not planned, {away}", loc="left")
    return ax
