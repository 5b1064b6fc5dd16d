"""What if: the worst schedule of a family, sigma over the number of samples, the loss of one sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from sampling_design.design.losses import SampleLosses
from sampling_design.design.pareto import ParetoFront, ParetoPoint
from sampling_design.errors import ArgumentError
from sampling_design.observability.worst_case.worst_case_sigma import WorstCaseSigma
from sampling_design.plotting import style
from sampling_design.records.record import counted, short

_LEFT = (
    ("late", "if samples are late or early", "v-."),
    ("lost", "if one sample is lost", "x:"),
)
"""What is left of sigma, proven as it is: its name, words and line."""


def draw_worst_case(result: WorstCaseSigma, ax: Axes | None = None) -> Axes:
    """Draw what the worst schedule sees of the worst state over the window."""
    ax = style.new_axes(ax)
    profile = result.profile
    ax.plot(profile.times, profile.output_norm, color=style.ALLOWED, label="|C exp(As) x| of the worst state")
    ax.vlines(profile.samples, 0.0, profile.at_samples, color=style.MEASURED, linewidth=1.8)
    ax.plot(profile.samples, profile.at_samples, "o", color=style.MEASURED, label="output at the worst times")
    ax.set_ylim(bottom=0.0)
    style.time_axis(ax, result.time_unit, "time in the window")
    ax.set_ylabel("output of a state of size 1")
    ax.set_title(f"sigma {short(result.lower, 4)} proven, {short(result.upper, 4)} attained", loc="left")
    if (left := result.deviations) is not None:  # these are sigmas, the curve is of one state
        wider = f"{short(left.late, 4)}, {short(left.late_wider, 4)} in longer windows"
        late = "" if left.asked else f"if late or early: {wider}; "
        ax.set_title(f"{late}if one is lost: {short(left.lost, 4)}", loc="right", fontsize="small")
    style.legend(ax)
    return ax


def draw_pareto(front: ParetoFront, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw proven sigma and the bound over the number of samples (on `ax` alone if given), and below what is between.

    Both are often a fraction of a per cent apart, so the room between them has a panel of its own. Raises ArgumentError
    if no count can be met.
    """
    points = [p for p in front.points if p.times]
    if not points:
        raise ArgumentError("`record` has no point to draw: none of the counts can be met.")
    if ax is not None:
        return _front(points, ax)
    _, (top, bottom) = style.new_figure(2, row_height=2.4, ratios=(2.0, 1.0))
    _front(points, top)
    top.tick_params(labelbottom=False)
    top.set_xlabel("")
    _gaps(points, bottom)
    for one in (top, bottom):
        one.set_xlim(points[0].samples - 0.6, points[-1].samples + 0.6)
    return style.Panels([top, bottom])


def _gaps(points: Sequence[ParetoPoint], ax: Axes) -> None:
    """By what share of its bound each design may fall short of the best schedule, at most."""
    gaps = [100 * max(0.0, 1 - p.sigma / p.upper_bound) if p.upper_bound > 0 else 0.0 for p in points]
    ax.bar([p.samples for p in points], gaps, width=0.5, color=style.ALLOWED)
    for p, gap in zip(points, gaps, strict=True):
        ax.annotate(
            f"{gap:.1f}", (p.samples, gap), xytext=(0, 2), textcoords="offset points", ha="center", fontsize="small"
        )
    ax.set_ylim(0.0, 1.35 * (max(gaps) or 1.0))
    _whole_counts(ax)
    ax.set_ylabel("optimality gap\n[%]")


def _whole_counts(ax: Axes) -> None:
    ax.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
    ax.set_xlabel("samples per period")


def _front(points: Sequence[ParetoPoint], ax: Axes) -> Axes:
    counts = [p.samples for p in points]
    sigma, bound = np.array([p.sigma for p in points]), np.array([p.upper_bound for p in points])
    least = [float(sigma.min())]
    ax.fill_between(counts, sigma, bound, color=style.ALLOWED, alpha=0.4, linewidth=0)
    ax.plot(
        counts, bound, "_--", color=style.TRUTH, linewidth=1.0, markersize=14, label="no schedule exceeds", zorder=3
    )
    ax.plot(counts, sigma, "o-", color=style.PROVEN, linewidth=2.5, alpha=0.8, label="proven sigma of the design")
    deviations = [p.deviations for p in points]
    for key, words, line in _LEFT:
        left = [np.nan if one is None or (one.asked and key == "late") else getattr(one, key) for one in deviations]
        if np.isfinite(left).any():
            ax.plot(counts, left, line, color=style.PROVEN, linewidth=1.2, markersize=4, label=words)
            least.append(float(np.nanmin(left)))
    style.from_below(ax, min(least), float(bound.max()))
    _whole_counts(ax)
    ax.set_ylabel("sigma")
    ends = (f"{counted(p.samples, 'sample')}: sigma {short(p.sigma, 4)}" for p in (points[0], points[-1]))
    ax.set_title("; ".join(dict.fromkeys(ends)), loc="left")
    style.legend(ax)
    return ax


def draw_losses(losses: SampleLosses, ax: Axes | None = None) -> Axes:
    """Draw sigma without each single sample, against sigma with all of them, and the share of it that is lost."""
    ax = style.new_axes(ax)
    ax.vlines(losses.times, losses.lower, losses.sigma, color=style.PROVEN, linewidth=1.2)
    ax.plot(losses.times, losses.lower, "o", color=style.PROVEN, label="without this sample (proven)")
    ax.plot(losses.times, losses.bound, "_", color=style.TRUTH, markersize=10, label="no schedule of one fewer exceeds")
    ax.axhline(losses.sigma, color=style.PROVEN, linewidth=1.2, label=f"with all: {short(losses.sigma, 4)}")
    for t, low in zip(losses.times, losses.lower, strict=True):
        said = f"{100 * (low / losses.sigma - 1):+.0f} %" if losses.sigma > 0 else ""
        ax.annotate(said, (t, low), xytext=(7, 0), textcoords="offset points", va="center", fontsize="small")
    top, least = max(losses.sigma, float(np.max(losses.bound))), float(min(np.min(losses.lower), losses.sigma))
    if (left := losses.deviations) is not None and not left.asked:
        label = f"with all, {left.tolerance.describe(left.time_unit)}: {short(left.late, 4)}"
        ax.axhline(left.late, color=style.PROVEN, linestyle="-.", linewidth=1.0, label=label)
        least = min(least, left.late)
    style.from_below(ax, least, top)
    ax.margins(x=0.08)
    style.time_axis(ax, losses.time_unit, "time of the lost sample")
    ax.set_ylabel("sigma (state at window's start)")
    worst = style.moment(ax, losses.times[int(np.argmin(losses.lower))], losses.time_unit, 4)
    missed = "missing in every period" if losses.every_period else "missed once"
    ax.set_title(f"{missed}: the sample at {worst} costs most", loc="left")
    style.legend(ax, 2)
    return ax
