"""Plans in pictures: sensors as rows over the period with opening hours, and each goal against its tolerance."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.planning.comparison import PlanComparison
from sampling_design.planning.figures import PlanFigures
from sampling_design.plotting import style
from sampling_design.records.record import above, short
from sampling_design.records.units import SECONDS
from sampling_design.schedules.opening import week_hours

LINES = ("-", "-.")  # both are proven, in the colour of what is


def draw_plan_comparison(result: PlanComparison, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw both plans' sensors above each other, and each shared goal in a panel (on `ax` alone: the first goal)."""
    shared = [goal.name for goal in result.shared()]
    if ax is not None:
        _shared_goal(result, shared[0], ax)
        return ax
    sensors = [p.problem.allowed.shape[1] for p in result.plans]
    ratios = (*(0.3 + 0.2 * count for count in sensors), *(1.0 for _ in shared))
    figure, axes = style.new_figure(2 + len(shared), row_height=2.1, ratios=ratios)
    for one, plan, name in zip(axes, result.plans, result.names, strict=False):
        draw_sensors(plan, one)
        shut = "; grey: closed" * (not plan.problem.allowed.all())
        one.set_title(f"{name}: {priced(plan)}{shut}", loc="left", fontsize="small")
    for name, one in zip(shared, axes[2:], strict=True):
        _shared_goal(result, name, one)
    longest = max(result.plans, key=lambda p: p.schedule.period)
    for one in axes:
        one.set_xlim(*whole(longest))
        mark_days(longest, one)
    style.one_time_axis(axes)
    each = [f"{name} {priced(plan)} a period" for plan, name in zip(result.plans, result.names, strict=True)]
    figure.suptitle(f"{result.first.plant.name or 'plans'}: {', '.join(each)}", wrap=True)
    return axes


def _shared_goal(result: PlanComparison, name: str, ax: Axes) -> None:
    """One goal of both plans, over as many periods as the longer one needs."""
    longest = max(plan.schedule.period for plan in result.plans)
    top = 0.0
    for plan, label, line in zip(result.plans, result.names, LINES, strict=True):
        k = [goal.name for goal in plan.goals].index(name)
        edges, upper = plan.curve(k)
        periods = np.arange(-1, 1 + int(np.ceil(longest / plan.schedule.period - 1e-9)))
        for shift in periods.tolist():
            ax.stairs(upper, edges + shift * plan.schedule.period, baseline=None, color=style.PROVEN,
                      linestyle=line, linewidth=1.4, label=label if shift == 0 else None)  # fmt: skip
        tolerance = plan.goals[k].tolerance
        dashes = "--" if plan is result.first else ":"
        ax.axhline(tolerance, color=style.FAILED, linewidth=1.2, linestyle=dashes, label=f"tolerance, {label}")
        top = max(top, tolerance, float(np.max(upper)))
    unit = next(goal.unit for goal in result.shared() if goal.name == name)
    ax.set_ylim(0.0, 1.15 * top)
    ax.set_ylabel(f"{name}\n[{unit}]" if unit else name)
    style.time_axis(ax, result.first.plant.time_unit)
    style.legend(ax, columns=4)


def draw_plan(result: PlanFigures, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw when which sensor is read (on `ax` alone if given), and below it the accuracy of every goal."""
    if ax is not None:
        return draw_sensors(result, ax)
    goals = result.goals
    sensors = result.problem.allowed.shape[1]
    figure, axes = style.new_figure(
        1 + len(goals), row_height=2.1, ratios=(0.25 + 0.2 * sensors, *(1.0 for _ in goals))
    )
    draw_sensors(result, axes[0])
    for k, one in enumerate(axes[1:]):
        _goal(result, k, one)
    for one in axes:
        one.set_xlim(*whole(result))
        mark_days(result, one)
    style.one_time_axis(axes)
    kept = "the tolerances are kept" if result.keeps else f"errors reach {above(result.ratio, 3)} of the tolerances"
    figure.suptitle(f"{result.plant.name or 'plan'}: {kept}, {priced(result)} a period", wrap=True)
    return axes


def whole(result: PlanFigures) -> tuple[float, float]:
    """Limits of an axis that shows a period, samples at its very ends included."""
    period = result.schedule.period
    return -0.008 * period, 1.008 * period


def priced(result: PlanFigures) -> str:
    """What a period of a plan costs, in words."""
    if not result.problem.counts:
        return f"cost {short(result.cost)}"
    return f"{result.samples} sample{'s' * (result.samples != 1)}"


def draw_sensors(result: PlanFigures, ax: Axes) -> Axes:
    """One row for each sensor: when it may not be read, in grey, and when it is."""
    problem, names = result.problem, result.plant.outputs.names
    for j in range(len(names)):
        style.shut(ax, j, closed(result, j))
        at = np.flatnonzero(result.chosen[:, j]) * problem.step
        ax.plot(at, np.full(at.size, j), "o", color=style.MEASURED, markersize=6, zorder=3)
    for t in result.schedule.times:
        ax.axvline(t, color=style.MEASURED, linewidth=0.6, alpha=0.5, zorder=0)
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    style.time_axis(ax, result.plant.time_unit)
    if len(names) * problem.steps > int(problem.allowed.sum()):
        ax.set_title("grey: closed", loc="left", fontsize="small")
    return ax


def _goal(result: PlanFigures, k: int, ax: Axes) -> None:
    """The accuracy of one goal over the period, with its tolerance."""
    goal = result.goals[k]
    (edges, upper), period = result.curve(k), result.schedule.period
    for cycle, label in (
        (-period, None),
        (0.0, "standard deviation" if goal.stochastic else "guaranteed"),
        (period, None),
    ):
        ax.stairs(upper, edges + cycle, baseline=None, color=style.PROVEN, label=label)
    ax.axhline(goal.tolerance, color=style.FAILED, linewidth=1.2, linestyle="--", label="tolerance")
    if result.bound.ratio is not None:
        level = result.bound.ratio.level * goal.tolerance
        if len(result.goals) == 1:
            ax.axhline(level, color=style.TRUTH, linewidth=1.0, label="no plan of this cost has its worst below")
    if goal.at == "given times":
        for step in goal.steps:
            ax.axvline(float(step) * result.problem.step % period, color=style.TRUTH, linewidth=0.8, linestyle=":")
    for t in result.schedule.times:
        ax.axvline(t, color=style.MEASURED, linewidth=0.6, alpha=0.5, zorder=0)
    ax.set_ylim(0.0, 1.25 * max(goal.tolerance, float(np.max(upper))))
    ax.set_ylabel(f"{goal.name}\n[{goal.unit}]" if goal.unit else goal.name)
    style.time_axis(ax, result.plant.time_unit)
    style.legend(ax)


def mark_days(result: PlanFigures, ax: Axes) -> None:
    """Weekdays instead of numbers where the plan has a calendar."""
    calendar = result.requirement.calendar
    if calendar is None:
        return
    style.dates(ax, result.plant.time_unit, calendar.start)
    ax.set_xlabel(f"local time, {calendar.zone}")


def closed(result: PlanFigures, j: int) -> list[tuple[float, float]]:
    """When a sensor may not be read, by the clock: whatever the grid, the hours are those that were asked for."""
    problem, requirement = result.problem, result.requirement
    if not problem.allowed[:, j].any():
        return [(0.0, problem.period)]
    if requirement.calendar is None:
        return []
    terms = requirement.sensors.get(result.plant.outputs.names[j])
    own = None if terms is None or terms.hours is None else week_hours("hours", terms.hours)
    minute = 60 / SECONDS[result.plant.time_unit]
    spans = requirement.calendar.closed(problem.period / minute, own)
    return [(start * minute, stop * minute) for start, stop in spans]
