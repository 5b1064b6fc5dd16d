"""How well anybody can know: both bounds of every row over time, and the exact set of two of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.accuracy.projection import Projection
from sampling_design.accuracy.results_out import SAME
from sampling_design.plotting import style
from sampling_design.records.arrays import Array
from sampling_design.records.record import above, below, short


def draw_accuracy(
    result: Accuracy, ax: Axes | Sequence[Axes] | None = None, *, tolerance: Sequence[float] | None = None
) -> list[Axes]:
    """Draw the bracket of each row over time, one axes below the other; samples are grey lines.

    `tolerance` is a wanted error for each row; standard deviations are dashed where the record has them.
    """
    count = len(result.rows)
    axes = (
        style.new_figure(count, row_height=2.3)[1]
        if ax is None
        else style.Panels(np.ravel(np.asarray(ax, dtype=object)))
    )
    for k, one in zip(range(count), axes, strict=False):
        _draw_row(one, result, k, None if tolerance is None else tolerance[k])
    what = "time over one period, samples grey" if result.question.initial is None else "time, samples grey"
    for one in axes if ax is None else axes[-1:]:
        style.time_axis(one, result.plant.time_unit, what)
    if ax is None:
        style.one_time_axis(axes)
    finite = [one for k, one in enumerate(axes[:count]) if np.isfinite(result.upper[k])]
    if finite:
        style.legend(finite[0])
    return axes


def _draw_row(one: Axes, result: Accuracy, k: int, tolerance: float | None) -> None:
    """Draw both bounds of one row, its standard deviation and its tolerance where there are any."""
    profile = result.profile
    label = result.rows.labels()[k]
    one.set_ylabel(f"error of\n{label}")
    begun, ended = profile.edges[0], profile.edges[-1]
    shown = profile.samples
    if result.question.initial is None:  # what is known with results out begins later than the samples
        shown = shown + (ended - begun) * np.ceil((begun - shown) / (ended - begun))
    for t in shown:
        one.axvline(t, color=style.ALLOWED, linewidth=0.8, zorder=0)
    if tolerance is not None:
        one.axhline(tolerance, color=style.FAILED, linewidth=1.0, linestyle=":", label="tolerance")
    if not np.isfinite(result.upper[k]):
        one.text(0.5, 0.5, "without bound", transform=one.transAxes, ha="center", color=style.FAILED)
        return
    lower, upper = (np.where(np.isfinite(side), side, np.nan) for side in (profile.lower[k], profile.upper[k]))
    one.fill_between(
        profile.edges,
        np.append(lower, lower[-1]),
        np.append(upper, upper[-1]),
        step="post",
        color=style.PROVEN,
        alpha=0.3,
        linewidth=0,
    )
    one.stairs(upper, profile.edges, baseline=None, color=style.PROVEN, label="guaranteed by an estimator")
    cut = np.searchsorted(profile.edges[:-1], profile.samples)  # a sample ends a curve, no line falls from it
    attained = np.insert(lower, cut, np.nan)
    times = np.insert(profile.edges[:-1], cut, profile.samples)
    one.plot(times, attained, color=style.ATTAINED, linewidth=1.0, linestyle="--", label="nobody guarantees less")
    late = result.known_from[k]
    if late > profile.edges[0]:
        one.axvspan(profile.edges[0], late, color=style.ALLOWED, alpha=0.3, linewidth=0)
        where, points = ("data", "axes fraction"), "offset points"
        one.annotate("unknown", (profile.edges[0], 0.0), (4, 4), where, points, fontsize="small")
    in_range = [lower, upper] if tolerance is None else [lower, upper, np.array([tolerance])]
    if result.deviation is not None and np.isfinite(result.deviation.worst[k]):
        curve = result.deviation.profile[k]
        in_range.append(curve)
        one.plot(
            result.deviation.times,
            np.where(np.isfinite(curve), curve, np.nan),
            color=style.MEASURED,
            linewidth=1.0,
            linestyle="-.",
            label="standard deviation",
        )
    _mark_worst(one, result, k)
    style.from_below(one, *_range(in_range))
    unit = result.rows.units[k]
    found = f"guaranteed within {above(result.upper[k], 4)} {unit}".rstrip()
    least = f"nobody guarantees less than {below(result.lower[k], 4)} {unit}".rstrip()
    one.set_title(f"{found}; {least}", loc="left", fontsize="medium")


def _mark_worst(one: Axes, result: Accuracy, k: int) -> None:
    """Mark the worst time; just before the first sample of an endless schedule is at the end of its period."""
    begun, ended, when = result.profile.edges[0], result.profile.edges[-1], result.worst[k]
    if result.question.initial is None and when - begun <= SAME * (ended - begun):
        when += ended - begun
    one.plot(when, result.lower[k], "o", color=style.ATTAINED, markersize=4)


def _range(curves: Sequence[Array]) -> tuple[float, float]:
    """The least and the largest finite value of some curves."""
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    return float(values.min()), float(values.max())


def draw_projection(result: Projection, ax: Axes | None = None) -> Axes:
    """Draw both polygons of the exact set, and beside it the ellipse of a quadratic cost."""
    one = ax if ax is not None else style.new_axes(None, height=4.5)
    turn = np.linspace(0.0, 2 * np.pi, 241)
    around = np.linalg.cholesky(result.ellipse) @ np.stack([np.cos(turn), np.sin(turn)])
    one.plot(*around, "-.", color=style.MEASURED, linewidth=1.2, label="ellipse of a quadratic cost")
    for corners, line, colour, label, fill in (
        (result.outer, "-", style.PROVEN, "nothing outside is possible", 0.25),
        (result.inner, "--", style.ATTAINED, "all inside is possible", 0.0),
    ):
        closed = np.vstack([corners, corners[:1]])
        if fill:
            one.fill(*closed.T, color=colour, alpha=fill, linewidth=0)
        one.plot(*closed.T, line, color=colour, linewidth=1.2, label=label)
    names = [f"{n} [{u}]" if u else n for n, u in zip(result.names, result.units, strict=True)]
    one.set_xlabel(f"error of {names[0]}")
    one.set_ylabel(f"error of {names[1]}")
    _, outer, ellipse = result.areas()
    one.set_title(
        f"at {short(result.t, 4)} {result.time_unit}; the ellipse has {short(ellipse / outer, 3)} times the area",
        loc="left",
    )
    one.margins(0.12)
    style.legend(one, 2)
    return one
