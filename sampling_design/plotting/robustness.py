"""How much a certificate survives: lambda over the timing error, and over the losses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes

from sampling_design.certificates.compare.robustness import Robustness
from sampling_design.plotting import style
from sampling_design.records.record import short


def draw_robustness(result: Robustness, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw lambda over the timing error (on `ax` alone if given), and below it over the losses."""
    if ax is not None:
        return _radii(result, ax)
    lost = ", ".join(f"{d} of any {w}" for d, w in result.tolerated)
    losses = f"losses of {lost}" if lost else "no loss"
    unit = result.certificate.plant.time_unit or ""
    words = f"survives timing errors up to {short(result.radius, 4)} {unit} and {losses}"
    # a panel of losses only where some were tried with a lambda to show
    found = any(np.isfinite(loss.lam) for loss in result.losses)
    figure, panels = style.new_figure(2 if found else 1, row_height=2.8)
    _radii(result, panels[0])
    if found:
        _losses(result, panels[1])
    figure.suptitle(words, wrap=True)
    return panels


def _radii(result: Robustness, ax: Axes) -> Axes:
    good = [t for t in result.trials if t.survives]
    bad = [t for t in result.trials if not t.survives]
    ax.plot(
        [t.family.timing_tolerance for t in good],
        [t.lam for t in good],
        "o-",
        color=style.PROVEN,
        label="survives, proven",
    )
    if bad:
        ax.plot(
            [t.family.timing_tolerance for t in bad],
            _heights(result, [t.lam for t in bad]),
            "x",
            color=style.FAILED,
            label="not proven",
        )
    _limit(result, ax)
    ax.axvline(result.radius, color=style.PROVEN, linewidth=1.0)
    ax.set_xlabel(style.time_label(result.certificate.plant.time_unit, "timing error of every sample"))
    style.legend(ax)
    return ax


def _losses(result: Robustness, ax: Axes) -> Axes:
    for d in sorted({loss.family.most for loss in result.losses}):
        mine = [loss for loss in result.losses if loss.family.most == d]
        heights = _heights(result, [loss.lam for loss in mine])
        for loss, height in zip(mine, heights, strict=True):
            colour = style.PROVEN if loss.survives else style.FAILED
            ax.plot([loss.family.of], [height], "o" if loss.survives else "x", color=colour)
            ax.annotate(
                f"{d} lost", (loss.family.of, height), xytext=(5, 3), textcoords="offset points", fontsize="small"
            )
    _limit(result, ax)
    ax.set_xlim(1, max((loss.family.of for loss in result.losses), default=2) + 1)
    ax.xaxis.set_major_locator(ticker.MaxNLocator(integer=True))
    ax.set_xlabel("consecutive samples among which they are counted")
    return ax


def _heights(result: Robustness, lams: Sequence[float]) -> list[float]:
    """Lambdas to draw; where none was found, a mark above the limit."""
    return [lam if np.isfinite(lam) else 1.5 * result.limit for lam in lams]


def _limit(result: Robustness, ax: Axes) -> None:
    unit = result.certificate.plant.time_unit or ""
    label = f"limit of the horizon {short(result.length, 4)} {unit}".rstrip()
    ax.axhline(result.limit, color=style.TRUTH, linestyle="--", linewidth=1.0, label=label)
    style.log_axis(ax)
    low, high = ax.get_ylim()
    ax.set_ylim(low / 1.2, high * 1.2)
    ax.set_ylabel("lambda")
