"""One colour language, and axes with names and units.

The colours differ for every kind of sight (red and green blindness included) and stand out from white by 4.5 and more;
a test simulates both.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from datetime import datetime, timedelta
from typing import Literal

import matplotlib.axes
import numpy as np
import numpy.typing as npt
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, Locator, LogLocator, MaxNLocator, NullFormatter

from sampling_design.records.arrays import Array, Index
from sampling_design.records.dates import date_after, parse_date, passed
from sampling_design.records.record import short
from sampling_design.records.units import SECONDS, readable_unit

MEASURED = "#2b6398"
PROVEN = "#20793e"
ATTAINED = "#9b6205"
ESTIMATE = "#6929c4"
ALLOWED = "#767676"
FAILED = "#910d11"
TRUTH = "#222222"


class Axes(matplotlib.axes.Axes):
    """Axes of a figure that belongs to no global state, and that a notebook shows where a cell ends in them."""

    _title_pad: float | None = None  # points from the axes up to a title that stands above a legend

    def _repr_png_(self) -> bytes:
        return png_of(self)

    def set_title(
        self,
        label: str,
        fontdict: Mapping[str, object] | None = None,
        loc: Literal["left", "center", "right"] | None = None,
        pad: float | None = None,
        *,
        y: float | None = None,
        **how: object,
    ) -> Text:
        """Set a title; one of a user's own stands above the legend, as the picture's did."""
        self._title_pad = self._title_pad if pad is None else pad
        font = None if fontdict is None else dict(fontdict)
        return super().set_title(label, font, loc, pad=self._title_pad, y=y, **how)


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


def new_figure(rows: int, row_height: float = 2.6, ratios: tuple[float, ...] | None = None) -> tuple[Figure, Panels]:
    """Return (figure, list of axes) with `rows` rows."""
    figure = Figure(figsize=(9.0, row_height * rows), layout="constrained")
    axes = figure.subplots(
        rows, 1, squeeze=False, gridspec_kw={"height_ratios": ratios or (1.0,) * rows}, subplot_kw={"axes_class": Axes}
    )
    return figure, Panels(row[0] for row in axes)


def by_pieces(t: Array, value: Array, piece: Index) -> tuple[Array, Array]:
    """Return a curve with a gap wherever one of its pieces ends."""
    breaks = np.flatnonzero(np.diff(piece)) + 1
    return np.insert(t, breaks, np.nan), np.insert(value, breaks, np.nan)


def one_time_axis(panels: Iterable[matplotlib.axes.Axes]) -> None:
    """Panels below each other share one time axis, named below the lowest: what is above each other is at one time."""
    below = list(panels)
    ends = np.array([panel.get_xlim() for panel in below])
    for panel in below:
        panel.set_xlim(ends[:, 0].min(), ends[:, 1].max())
    for panel in below[:-1]:
        panel.set_xlabel("")
        panel.tick_params(labelbottom=False)


def legend_above(figure: Figure, panels: Iterable[matplotlib.axes.Axes], columns: int) -> None:
    """Above the whole picture, what its panels name, each name once."""
    named = [pair for ax in panels for pair in zip(*ax.get_legend_handles_labels(), strict=True)]
    names = list(dict.fromkeys(name for _, name in named))
    handles = [next(handle for handle, own in named if own == name) for name in names]
    figure.legend(handles, names, loc="outside upper right", ncols=columns, fontsize="small", frameon=False)


def time_label(unit: str | None, what: str = "time") -> str:
    """Return an axis label with the unit."""
    return f"{what} [{unit}]" if unit else what


class _UnitLocator(MaxNLocator):
    """Marks at whole numbers of another unit of time."""

    def __init__(self, factor: float) -> None:
        super().__init__("auto", steps=[1, 2, 3, 5, 6, 10])
        self.factor = factor

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        return [float(mark) / self.factor for mark in super().tick_values(vmin * self.factor, vmax * self.factor)]


class _DateLocator(Locator):
    """Marks at equal steps of a zone's clocks, counted from midnight of the day of `zero`, over changes of the clocks.

    `unit` is the unit of the axis in seconds, `every` the step in days.
    """

    def __init__(self, zero: datetime, unit: float, every: float) -> None:
        self.zero, self.unit, self.every = zero, unit, timedelta(days=every)

    def __call__(self) -> list[float]:
        assert self.axis is not None
        low, high = self.axis.get_view_interval()
        return self.tick_values(low, high)

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        midnight = self.zero.replace(hour=0, minute=0, second=0, microsecond=0)
        ends = (date_after(self.zero, t * self.unit).replace(tzinfo=None) for t in sorted((vmin, vmax)))
        first, last = ((end - midnight.replace(tzinfo=None)) // self.every for end in ends)
        dates = (midnight + k * self.every for k in range(first, last + 2))  # Python counts on by the clocks of a zone
        return sorted({passed(self.zero, date).total_seconds() / self.unit for date in dates})


def _unit_label(ax: matplotlib.axes.Axes, unit: str | None) -> tuple[str | None, float]:
    """The unit in which the time axis of what is drawn counts, and how much of it `unit` is."""
    low, high = ax.get_xlim()
    return readable_unit(high - low, unit) if unit in SECONDS else (unit, 1.0)


def moment(ax: matplotlib.axes.Axes, t: float, unit: str | None, digits: int = 5, *, origin: str | None = None) -> str:
    """Return a time in the unit that its axis shows, or as a date; to be called when everything is drawn."""
    if origin is not None and unit is not None:
        return f"{date_after(parse_date('origin', origin), float(t) * SECONDS[unit]):%a %d %b %H:%M}"
    shown, factor = _unit_label(ax, unit)
    return f"{short(t * factor, digits)} {shown or ''}".rstrip()


def time_axis(ax: matplotlib.axes.Axes, unit: str | None, what: str = "time", origin: str | None = None) -> None:
    """Name a time axis: dates where that of its zero is known, else minutes, hours or days where these are short.

    To be called when everything is drawn.
    """
    shown, factor = _unit_label(ax, unit)
    ax.set_xlabel(time_label(shown, what))
    if shown != unit:
        ax.xaxis.set_major_locator(_UnitLocator(factor))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda t, _: f"{t * factor:.6g}"))
    dates(ax, unit, origin)


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


def sigma_label(coordinates: str) -> str:
    """Sigma, and what it refers to."""
    return f"sigma ({'' if coordinates == 'physical' else f'{coordinates}, '}state at window's start)"


def finished(ax: matplotlib.axes.Axes, ylabel: str, title: str, columns: int = 0) -> matplotlib.axes.Axes:
    """Name the y axis, give the picture its title and its legend, and return it."""
    ax.set_ylabel(ylabel)
    ax.set_title(title, loc="left")
    legend(ax, columns)
    return ax


def note(
    ax: matplotlib.axes.Axes,
    text: str,
    at: tuple[float, float],
    offset: tuple[float, float],
    ha: str = "left",
    va: str = "baseline",
) -> None:
    """Write a few small words so many points beside a place."""
    ax.annotate(text, at, xytext=offset, textcoords="offset points", fontsize="small", ha=ha, va=va)


LOW = 0.6  # where a curve never falls below this share of its top, its axis begins under it and not at zero


def shut(ax: matplotlib.axes.Axes, row: int, spans: Iterable[tuple[float, float]]) -> None:
    """Shade when a sensor cannot be read, in its row of a time line."""
    bars = [(start, stop - start) for start, stop in spans]
    if bars:
        ax.broken_barh(bars, (row - 0.5, 1.0), color=ALLOWED, alpha=0.3, linewidth=0, zorder=0)


def from_below(ax: matplotlib.axes.Axes, low: float, high: float) -> None:
    """Limit the y axis so that the curve, not the space under it, fills the picture; zero is shown where it is near."""
    if not high > 0:  # nothing is seen: an axis from zero to one says so
        ax.set_ylim(-0.04, 1.0)
        return
    bottom = 0.0 if low < LOW * high else low - max(0.3 * (high - low), 0.005 * high)
    if low < 0.02 * high:  # a curve at zero would lie on the frame
        bottom = -0.04 * high
    ax.set_ylim(bottom, high + max(0.08 * (high - bottom), 0.005 * high))


def log_axis(ax: matplotlib.axes.Axes) -> None:
    """Make the y axis logarithmic, with plain numbers at 1, 2 and 5 where it spans few decades."""
    ax.set_yscale("log")
    plain_numbers(ax.yaxis)


def plain_numbers(axis: Axis) -> None:
    """Write plain numbers at 1, 2 and 5 on a logarithmic axis that spans few decades."""
    low, high = axis.get_view_interval()
    if high < 2e3 * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
        axis.set_minor_formatter(NullFormatter())


START = 0.25  # share of a band, the first one, that does not rule the axis: a wide start would flatten all that follows
WIDER = 3.0
"""Bands of the start up to so many times as wide as most later ones rule the axis too."""
STRETCH = 1.5  # how much longer the whole must be than what rules the axis, for the rest to be cut off


def not_ruled_by_the_start(
    ax: matplotlib.axes.Axes, t: Array, low: Array, high: Array, include: Array | None = None
) -> None:
    """Limit the y axis by what comes after the start, where the start alone would stretch it by half.

    What must be seen all the same, what was read and what was made of it, is `include` within it.
    Where the band goes on beyond the axis a triangle says up to which value.
    """
    known = np.isfinite(low) & np.isfinite(high)
    t, low, high = t[known], low[known], high[known]
    kept = slice(int(np.ceil(START * low.size)), None)
    if not low[kept].size:
        return
    near = high - low <= WIDER * float(np.median((high - low)[kept]))  # what is little wider is shown on both sides
    near[kept] = True
    within = np.zeros(0) if include is None else include[np.isfinite(include)]
    bottom = float(min(low[near].min(), within.min(initial=np.inf)))
    top = float(max(high[near].max(), within.max(initial=-np.inf)))
    if not (top > bottom and float(high.max() - low.min()) > STRETCH * (top - bottom)):
        return
    room = 0.15 * (top - bottom)
    bottom, top = bottom - room, top + room
    ax.set_ylim(bottom, top)
    for ends, at, mark, level in ((high, int(np.argmax(high)), "^", 0.95), (low, int(np.argmin(low)), "v", 0.05)):
        if not bottom <= ends[at] <= top:
            place, said = ax.get_xaxis_transform(), f"  {short(float(ends[at]), 3)}"
            ax.plot(t[at : at + 1], [level], mark, color=PROVEN, markersize=5, transform=place)
            ax.text(t[at], level, said, color=PROVEN, fontsize="x-small", va="center", transform=place)


COLUMNS = 600  # stretches of time of which a picture tells one from the next


def points(
    ax: matplotlib.axes.Axes, t: npt.ArrayLike, y: npt.ArrayLike, mark: str, size: float, label: str = ""
) -> None:
    """Mark what was measured: each point of a few, of many the least to the largest of each short stretch of time."""
    times, values = np.asarray(t, dtype=float), np.asarray(y, dtype=float)
    known = np.isfinite(values)
    times, values = times[known], values[known]
    if times.size <= 2 * COLUMNS:
        ax.plot(times, values, mark, color=MEASURED, markersize=size, label=label or None)
        return
    edges = np.linspace(times.min(), times.max(), COLUMNS + 1)
    least, largest = np.full((2, COLUMNS), np.nan)
    at = np.searchsorted(edges[1:-1], times, side="right")
    np.fmin.at(least, at, values)
    np.fmax.at(largest, at, values)
    said = f"{label}, least to largest" if label else None
    ax.use_sticky_edges = False  # else the axis ends where the values do, as if they went on
    filled(ax, edges, least, largest, MEASURED, said)


def filled(
    ax: matplotlib.axes.Axes, edges: Array, least: Array, largest: Array, colour: str, label: str | None
) -> None:
    """Fill from the least to the largest value of each stretch, with a line where both are one."""
    ax.stairs(
        largest,
        edges,
        baseline=least,
        fill=True,
        label=label,
        facecolor=(colour, 0.35),
        edgecolor=colour,
        linewidth=0.5,
        zorder=0.9,
    )


def distinct_times(times: Array) -> Array:
    """Return the times, in order, that a picture tells apart: of many one for each short stretch that has some."""
    if times.size <= 2 * COLUMNS:
        return times
    edges = np.linspace(times.min(), times.max(), COLUMNS + 1)
    return np.asarray(times[np.unique(np.searchsorted(edges, times), return_index=True)[1]])


def sample_ticks(ax: matplotlib.axes.Axes, times: Array) -> None:
    """Ticks at the bottom where samples are."""
    times = distinct_times(times)
    ax.vlines(times, 0.0, 0.06, color=MEASURED, linewidth=0.8, transform=ax.get_xaxis_transform())


HOURS = (1 / 12, 1 / 4, 1 / 2, 1, 2, 3, 6)  # hours between marks where an axis shows less than a day and a half


def dates(ax: matplotlib.axes.Axes, unit: str | None, origin: str | None) -> None:
    """Write weekdays and dates below a time axis, where the date of its zero is known, and hours where it is short."""
    if origin is None or unit is None:
        return
    zero = parse_date("origin", origin, None)
    low, high = ax.get_xlim()
    count = (high - low) * SECONDS[unit] / 86400.0
    if not HOURS[0] / 24 <= count <= 4000:
        return
    # ticks at midnight or at whole hours of the zone, at most eight of them
    every = next(k for k in (*(h / 24 for h in HOURS), 1, 2, 7, 14, 28, 56, 112, 560) if count / k <= 8)
    form = "%a %H:%M" if every < 1 else "%a %d %b" if count <= 300 else "%d %b %Y"

    def said(t: float, _: int | None = None) -> str:
        return f"{date_after(zero, t * SECONDS[unit] + 30.0):{form}}"  # of the minute that is nearest

    ax.xaxis.set_major_locator(_DateLocator(zero, SECONDS[unit], every))
    ax.xaxis.set_major_formatter(FuncFormatter(said))
    between = 1 / 4 if every >= 1 and count <= 4 else 1.0 if every == 7 else 0.0
    if between:
        ax.xaxis.set_minor_locator(_DateLocator(zero, SECONDS[unit], between))
    ax.set_xlabel(f"date, from {zero:%Y-%m-%d}")
