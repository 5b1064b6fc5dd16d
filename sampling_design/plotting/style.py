"""One colour language, and axes with names and units."""

from __future__ import annotations

from typing import Any

MEASURED = "#1f5fa8"
PROVEN = "#2a8f4f"
ATTAINED = "#e07b00"
ALLOWED = "#b8b8b8"
FAILED = "#c0202c"
TRUTH = "#222222"


def new_axes(ax: Any = None, width: float = 8.0, height: float = 3.2) -> Any:
    """Return `ax`, or the axes of a new figure that belongs to no global state."""
    if ax is not None:
        return ax
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained").add_subplot()


def new_figure(rows: int, width: float = 9.0, row_height: float = 2.6, ratios: tuple[float, ...] | None = None) -> Any:
    """Return (figure, list of axes) with `rows` rows."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, row_height * rows), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False, gridspec_kw={"height_ratios": ratios or (1.0,) * rows})
    return figure, [row[0] for row in axes]


def time_label(unit: str | None, what: str = "time") -> str:
    """Return an axis label with the unit."""
    return f"{what} [{unit}]" if unit else what
