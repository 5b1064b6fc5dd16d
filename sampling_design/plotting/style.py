"""One colour language, and axes with names and units."""

from __future__ import annotations

import io

import matplotlib.axes
from matplotlib.figure import Figure

MEASURED = "#1f5fa8"
PROVEN = "#2a8f4f"
ATTAINED = "#e07b00"
ALLOWED = "#b8b8b8"
FAILED = "#c0202c"
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
