"""Sigma over the position of a sliding window, with the bound that is proven for every position."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.observability.sigma_bracket import SigmaDeviations
from sampling_design.observability.windows.window_record import WindowSigma
from sampling_design.plotting import style
from sampling_design.records.record import short
from sampling_design.records.units import spoken


def draw_deviations(found: SigmaDeviations | None, ax: Axes) -> float:
    """Draw what late samples (unless they were asked for) and a lost one leave; the least of it."""
    if found is None:
        return np.inf
    color, looked = (style.ATTAINED, " (sampled)") if found.sampled else (style.PROVEN, "")
    if not found.asked:
        label = f"if {found.tolerance.describe(found.time_unit)}: {short(found.late, 4)}{looked}"
        ax.axhline(found.late, color=color, linestyle="-.", linewidth=1.0, label=label)
    lost = f"if one sample is lost: {short(found.lost, 4)}{looked}"
    ax.axhline(found.lost, color=color, linestyle=":", linewidth=1.0, label=lost)
    return min(found.late, found.lost)


def draw_window_sigma(
    result: WindowSigma, ax: Axes | None = None, *, columns: int = 2, beside: bool = True, origin: str | None = None
) -> Axes:
    """Draw sigma over the window's end: attained values, proven bound, and the worst position, a date from `origin`.

    And, `beside`, what samples that come late or are lost leave of it.
    """
    ax = style.new_axes(ax)
    profile = result.profile
    label: str | None = "sigma of the window"
    for index in np.unique(profile.piece):
        here = profile.piece == index
        ax.plot(profile.t[here], profile.sigma[here], color=style.MEASURED, linewidth=2.2, label=label)
        label = None
    ax.axhline(
        result.lower, color=style.PROVEN, linewidth=1.2, label=f"proven for every position: {short(result.lower, 4)}"
    )
    # an open ring where sigma is only a one-sided limit, a full one where it is reached
    face = style.ATTAINED if result.witness.side == "at" else "none"
    (worst,) = ax.plot([result.witness.t], [result.upper], "o", color=style.ATTAINED, markerfacecolor=face)
    side, end = result.witness.side, style.moment(ax, result.witness.t, result.time_unit, origin=origin)
    worst.set_label(f"attained: {short(result.upper, 4)}, window ends {'' if side == 'at' else f'just {side} '}{end}")
    least = min(result.lower, draw_deviations(result.deviations, ax) if beside else np.inf)
    style.from_below(ax, min(least, float(profile.sigma.min())), float(profile.sigma.max()))
    style.time_axis(ax, result.time_unit, f"end of the window of {spoken(result.window, result.time_unit)}")
    kind = result.coordinates
    ax.set_ylabel("sigma (state at window's start)" if kind == "physical" else f"sigma ({kind}, at start)")
    ax.set_title(f"sigma is at least {short(result.lower, 4)} in every window", loc="left")
    style.legend(ax, columns)
    return ax
