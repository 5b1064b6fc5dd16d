"""Two plans in one picture: when each reads what, and each shared goal over its period."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.planning.comparison import PlanComparison
from sampling_design.planning.figures import PlanFigures
from sampling_design.plotting import style
from sampling_design.plotting.plans import draw_sensors, mark_days, priced, whole

LINES = ("-", "-.")  # both are proven, in the colour of what is


def draw_plan_comparison(result: PlanComparison, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw both plans' sensors above each other, and each shared goal in a panel (on `ax` alone: the first goal)."""
    shared = [goal.name for goal in result.shared()]
    if ax is not None:
        _goal(result, shared[0], ax)
        return ax
    sensors = [p.problem.allowed.shape[1] for p in result.plans]
    ratios = (*(0.3 + 0.2 * count for count in sensors), *(1.0 for _ in shared))
    figure, axes = style.new_figure(2 + len(shared), row_height=2.1, ratios=ratios)
    for one, plan, name in zip(axes, result.plans, result.names, strict=False):
        draw_sensors(plan, one)
        shut = "; grey: closed" * (not plan.problem.allowed.all())
        one.set_title(f"{name}: {priced(plan)}{shut}", loc="left", fontsize="small")
    for name, one in zip(shared, axes[2:], strict=True):
        _goal(result, name, one)
    longest = max(result.plans, key=lambda p: p.schedule.period)
    for one in axes:
        one.set_xlim(*whole(longest))
        mark_days(longest, one)
    style.one_time_axis(axes)
    each = [f"{name} {priced(plan)} a period" for plan, name in zip(result.plans, result.names, strict=True)]
    figure.suptitle(f"{result.first.plant.name or 'plans'}: {', '.join(each)}", wrap=True)
    return axes


def _goal(result: PlanComparison, name: str, ax: Axes) -> None:
    """One goal of both plans, over as many periods as the longer one needs."""
    longest = max(plan.schedule.period for plan in result.plans)
    top = 0.0
    for plan, label, line in zip(result.plans, result.names, LINES, strict=True):
        k = [goal.name for goal in plan.goals].index(name)
        edges, upper = curve(plan, k)
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


def curve(plan: PlanFigures, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Edges and height of a goal over the period."""
    return plan.curve(k)
