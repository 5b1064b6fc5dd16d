"""One colour language, and axes with names and units.

The colours differ for every kind of sight (red and green blindness included) and stand out from white by 4.5 and more;
a test simulates both.
"""

from __future__ import annotations

import io
from datetime import timedelta

import matplotlib.axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MultipleLocator

from sampling_design._units import SECONDS
from sampling_design.schedules.time_stamps import parse_date

MEASURED = "#2b6398"
PROVEN = "#20793e"
ATTAINED = "#9b6205"
ALLOWED = "#767676"
FAILED = "#910d11"
TRUTH = "#222222"


class Axes(matplotlib.axes.Axes):
    """Axes of a figure that belongs to no global state, and that a notebook shows where a cell ends in them."""

    def _repr_png_(self) -> bytes:
        return png_of(self)


class Panels(list[matplotlib.axes.Axes]):
    """The axes of a picture with several of them, shown in a notebook as the picture that they are."""

    def _repr_png_(self) -> bytes:
        return png_of(self[0])


def png_of(ax: matplotlib.axes.Axes) -> bytes:
    """Return the whole figure of `ax` as a picture."""
    stream = io.BytesIO()
    figure = ax.figure
    assert isinstance(figure, Figure)
    figure.savefig(stream, format="png", dpi=100)
    return stream.getvalue()


def new_axes(ax: matplotlib.axes.Axes | None = None, width: float = 8.0, height: float = 3.2) -> matplotlib.axes.Axes:
    """Return `ax`, or the axes of a new figure that belongs to no global state."""
    if ax is not None:
        return ax
    return Figure(figsize=(width, height), layout="constrained").add_subplot(axes_class=Axes)


def new_figure(
    rows: int, width: float = 9.0, row_height: float = 2.6, ratios: tuple[float, ...] | None = None
) -> tuple[Figure, Panels]:
    """Return (figure, list of axes) with `rows` rows."""
    figure = Figure(figsize=(width, row_height * rows), layout="constrained")
    axes = figure.subplots(
        rows, 1, squeeze=False, gridspec_kw={"height_ratios": ratios or (1.0,) * rows}, subplot_kw={"axes_class": Axes}
    )
    return figure, Panels(row[0] for row in axes)


def time_label(unit: str | None, what: str = "time") -> str:
    """Return an axis label with the unit."""
    return f"{what} [{unit}]" if unit else what


def legend(ax: matplotlib.axes.Axes, columns: int = 0) -> None:
    """Put the legend above the axes, where no curve is; a title on the left moves above it."""
    handles, labels = ax.get_legend_handles_labels()
    if not handles:
        return
    per_row = columns or len(handles)
    ax.legend(
        handles,
        labels,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=per_row,
        fontsize="small",
        frameon=False,
        borderaxespad=0.2,
    )
    title = ax.get_title(loc="left")
    if title:
        ax.set_title(title, loc="left", pad=8.0 + 16.0 * -(-len(handles) // per_row), fontsize="medium")


LOW = 0.6
"""Where a curve never falls below this share of its top, its axis begins under it and not at zero."""


def from_below(ax: matplotlib.axes.Axes, low: float, high: float) -> None:
    """Limit the y axis so that the curve, not the space under it, fills the picture; zero is shown where it is near."""
    if not high > 0:  # nothing is seen: an axis from zero to one says so
        ax.set_ylim(0.0, 1.0)
        return
    bottom = 0.0 if low < LOW * high else low - max(0.6 * (high - low), 0.04 * high)
    ax.set_ylim(bottom, high + max(0.08 * (high - bottom), 0.03 * high))


def dates(ax: matplotlib.axes.Axes, unit: str | None, origin: str | None) -> None:
    """Write weekdays and dates below a time axis, where the date of its zero is known and days are what it shows."""
    if origin is None or unit is None:
        return
    zero = parse_date("origin", origin, None)
    day = 86400.0 / SECONDS[unit]
    low, high = ax.get_xlim()
    count = (high - low) / day
    if not 0.5 <= count <= 400:
        return
    # ticks at midnight, at most eight of them
    shift = (zero.hour + zero.minute / 60 + zero.second / 3600) / 24
    every = next(k for k in (1, 2, 7, 14, 28, 56) if count / k <= 8)

    def said(t: float, _: int | None = None) -> str:
        return f"{zero + timedelta(days=round(t / day + shift) - shift):%a %d %b}"

    ax.xaxis.set_major_locator(MultipleLocator(every * day, offset=-shift * day))
    ax.xaxis.set_major_formatter(FuncFormatter(said))
    ax.set_xlabel(f"date, from {zero:%Y-%m-%d}")
