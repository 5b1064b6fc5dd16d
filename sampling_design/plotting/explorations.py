"""What if: the worst schedule of a family, sigma over the number of samples, the loss of one sample."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from sampling_design._record import short
from sampling_design.design.losses import SampleLosses
from sampling_design.design.pareto import ParetoFront
from sampling_design.errors import ArgumentError
from sampling_design.observability.worst_case.worst_case_sigma import WorstCaseSigma
from sampling_design.plotting import style


def draw_worst_case(result: WorstCaseSigma, ax: Axes | None = None) -> Axes:
    """Draw what the worst schedule sees of the worst state over the window."""
    ax = style.new_axes(ax)
    profile = result.profile
    ax.plot(profile.times, profile.seen, color=style.ALLOWED, label="|C exp(As) x| of the worst state")
    ax.vlines(profile.samples, 0.0, profile.at_samples, color=style.MEASURED, linewidth=1.8)
    ax.plot(profile.samples, profile.at_samples, "o", color=style.MEASURED, label="seen at the worst times")
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel(style.time_label(result.time_unit, "time in the window"))
    ax.set_ylabel("output")
    ax.set_title(f"sigma {short(result.lower, 4)} proven, {short(result.upper, 4)} attained", loc="left")
    style.legend(ax)
    return ax


def draw_pareto(front: ParetoFront, ax: Axes | None = None) -> Axes:
    """Draw proven sigma and the bound over the number of samples per period.

    Raises
    ------
    ArgumentError
        If no count can be met.
    """
    points = [p for p in front.points if p.times]
    if not points:
        raise ArgumentError("`record` has no point to draw: none of the counts can be met.")
    ax = style.new_axes(ax)
    counts = [p.samples for p in points]
    sigma, bound = np.array([p.sigma for p in points]), np.array([p.upper_bound for p in points])
    ax.fill_between(counts, sigma, bound, color=style.ALLOWED, alpha=0.4, linewidth=0)
    ax.plot(
        counts, bound, "_--", color=style.TRUTH, linewidth=1.0, markersize=14, label="no schedule exceeds", zorder=3
    )
    ax.plot(counts, sigma, "o-", color=style.PROVEN, linewidth=2.5, alpha=0.8, label="proven sigma of the design")
    ax.set_ylim(bottom=0.0)
    ax.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
    ax.set_xlabel("samples per period")
    ax.set_ylabel("sigma")
    style.legend(ax)
    return ax


def draw_losses(losses: SampleLosses, ax: Axes | None = None) -> Axes:
    """Draw sigma without each single sample, against sigma with all of them."""
    ax = style.new_axes(ax)
    ax.vlines(losses.times, losses.lower, losses.sigma, color=style.FAILED, linewidth=1.2)
    ax.plot(losses.times, losses.lower, "o", color=style.FAILED, label="without this sample (proven)")
    ax.plot(losses.times, losses.bound, "_", color=style.TRUTH, markersize=10, label="no schedule of one fewer exceeds")
    ax.axhline(losses.sigma, color=style.PROVEN, linewidth=1.2, label=f"with all: {short(losses.sigma, 4)}")
    ax.set_ylim(0.0, 1.1 * max(losses.sigma, float(np.max(losses.bound))) or 1.0)
    ax.set_xlabel(style.time_label(losses.time_unit, "time of the lost sample"))
    ax.set_ylabel("sigma")
    ax.set_title("missing in every period" if losses.every_period else "missed once", loc="left")
    style.legend(ax)
    return ax
