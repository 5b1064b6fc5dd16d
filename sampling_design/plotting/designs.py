"""Sigma of a window, designs, and what else was weighed: fronts, lost samples, worst cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from sampling_design.design.losses import SampleLosses
from sampling_design.design.pareto import ParetoFront, ParetoPoint
from sampling_design.design.schedule_design import ScheduleDesign
from sampling_design.errors import ArgumentError
from sampling_design.observability.sigma_bracket import SigmaDeviations
from sampling_design.observability.windows.window_record import WindowSigma
from sampling_design.observability.worst_case.worst_case_sigma import WorstCaseSigma
from sampling_design.plotting import style
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import above, below, counted, short
from sampling_design.records.units import spoken
from sampling_design.schedules.family import SamplingFamily
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.schedules.sensor import complement, numbers

MEMBERS = 6  # members of a family that are drawn below its nominal one
GAPS_SHOWN = 8  # longest gaps that the picture of a family is wide


def draw_schedule(schedule: Schedule | PeriodicSchedule, ax: Axes | None = None) -> Axes:
    """Draw the samples of a schedule (of two periods, the second pale, if it is periodic)."""
    ax = style.new_axes(ax, height=1.8 + 0.25 * _rows(schedule))
    _stems(ax, schedule.times, schedule.outputs, _rows(schedule), 1.0)
    if schedule.endless:
        _stems(ax, schedule.times + schedule.period, schedule.outputs, _rows(schedule), 0.35)
        ax.axvline(schedule.first + schedule.period, color=style.ALLOWED, linewidth=0.8, linestyle=":")
    names = schedule.output_names or tuple(f"y{i + 1}" for i in range(_rows(schedule)))
    if schedule.outputs is None and schedule.output_names is None:
        names = ("samples",)
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(-0.6, len(names) - 0.4)
    style.time_axis(ax, schedule.time_unit, origin=schedule.origin)
    gaps = schedule.gaps
    if gaps.size:
        least, most = short(gaps.min(), 4), short(gaps.max(), 4)
        span = f"every {most}" if least == most else f"gaps {least} to {most}"
        ax.set_title(f"{counted(len(schedule), 'sample')}, {span} {schedule.time_unit or ''}".rstrip(), loc="left")
    return ax


def draw_family(family: SamplingFamily, ax: Axes | None = None) -> Axes:
    """Draw the nominal member of a family and, below it, some that were drawn at random."""
    ax, rng = style.new_axes(ax, height=2.8), np.random.default_rng(0)
    members = [family.draw(rng) for _ in range(MEMBERS)]
    end = min(GAPS_SHOWN * family.d_max, max(float(member.times[-1]) for member in members))
    nominal = family.nominal
    planned = nominal.between(0.0, end) if nominal.endless else nominal
    for row, member in enumerate([planned, *members]):
        visible_times, colour = member.times[member.times <= end], style.TRUTH if row == 0 else style.MEASURED
        ax.vlines(visible_times, -row - 0.32, -row + 0.32, color=colour, linewidth=1.8)
    ax.set_yticks([0, -(MEMBERS + 1) / 2], ["nominal", "at random"])
    ax.tick_params(axis="y", length=0)
    ax.set_xlim(0.0, 1.02 * end)
    style.time_axis(ax, family.time_unit)
    ax.set_title(family.explain(), loc="left", fontsize="medium", wrap=True)
    return ax


def _rows(schedule: Schedule | PeriodicSchedule) -> int:
    if schedule.outputs is not None:
        return int(schedule.outputs.shape[1])
    return len(schedule.output_names) if schedule.output_names else 1


def _stems(ax: Axes, times: Array, outputs: Mask | None, rows: int, alpha: float) -> None:
    mask = np.ones((len(times), rows), dtype=bool) if outputs is None else outputs
    for row in range(rows):
        chosen = style.distinct_times(np.asarray(times)[mask[:, row]])
        ax.vlines(chosen, row - 0.32, row + 0.32, color=style.MEASURED, alpha=alpha, linewidth=1.8)


_LEFT = (("late", "if samples are late or early", "v-."), ("lost", "if one sample is lost", "x:"))
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
    if (left := result.deviations) is not None:  # these are sigmas, the curve is of one state
        wider = f"{below(left.late, 4)}, {below(left.late_wider, 4)} in longer windows"
        late = "" if left.in_sigma else f"if late or early: {wider}; "
        ax.set_title(f"{late}if one is lost: {below(left.lost, 4)}", loc="right", fontsize="small")
    title = f"sigma {below(result.lower, 4)} proven, {above(result.upper, 4)} attained"
    return style.finished(ax, "output of a state of size 1", title)


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
        style.note(ax, above(gap, 2), (p.samples, gap), (0, 2), ha="center")
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
        left = [np.nan if one is None or (one.in_sigma and key == "late") else getattr(one, key) for one in deviations]
        if np.isfinite(left).any():
            ax.plot(counts, left, line, color=style.PROVEN, linewidth=1.2, markersize=4, label=words)
            least.append(float(np.nanmin(left)))
    style.from_below(ax, min(least), float(bound.max()))
    _whole_counts(ax)
    ends = (f"{counted(p.samples, 'sample')}: sigma {below(p.sigma, 4)}" for p in (points[0], points[-1]))
    coordinates = next((p.coordinates for p in points if p.coordinates), "physical")
    return style.finished(ax, style.sigma_label(coordinates), "; ".join(dict.fromkeys(ends)))


def draw_losses(losses: SampleLosses, ax: Axes | None = None) -> Axes:
    """Draw sigma without each single sample, against sigma with all of them, and the share of it that is lost."""
    ax = style.new_axes(ax)
    ax.vlines(losses.times, losses.lower, losses.sigma, color=style.PROVEN, linewidth=1.2)
    ax.plot(losses.times, losses.lower, "o", color=style.PROVEN, label="without this sample (proven)")
    ax.plot(losses.times, losses.bound, "_", color=style.TRUTH, markersize=10, label="no schedule of one fewer exceeds")
    ax.axhline(losses.sigma, color=style.PROVEN, linewidth=1.2, label=f"with all: {below(losses.sigma, 4)}")
    for t, low in zip(losses.times, losses.lower, strict=True):
        said = f"{100 * (low / losses.sigma - 1):+.0f} %" if losses.sigma > 0 else ""
        style.note(ax, said, (t, low), (7, 3))  # above what is drawn at its height
    top, least = max(losses.sigma, float(np.max(losses.bound))), float(min(np.min(losses.lower), losses.sigma))
    if (left := losses.deviations) is not None and not left.in_sigma:
        label = f"with all, {left.tolerance.describe(left.time_unit)}: {below(left.late, 4)}"
        ax.axhline(left.late, color=style.PROVEN, linestyle="-.", linewidth=1.0, label=label)
        least = min(least, left.late)
    style.from_below(ax, least, top)
    ax.margins(x=0.08)
    style.time_axis(ax, losses.time_unit, "time of the lost sample")
    worst = style.moment(ax, losses.times[int(np.argmin(losses.lower))], losses.time_unit, 4)
    missed = "missing in every period" if losses.every_period else "missed once"
    dear = "each sample costs as much" if losses.alike else f"the sample at {worst} costs most"
    return style.finished(ax, style.sigma_label(losses.coordinates), f"{missed}: {dear}", 2)


def draw_deviations(found: SigmaDeviations | None, ax: Axes) -> float:
    """Draw what late samples (unless they were asked for) and a lost one leave; the least of it."""
    if found is None:
        return np.inf
    color, looked = (style.ATTAINED, " (sampled)") if found.sampled else (style.PROVEN, "")
    if not found.in_sigma:
        label = f"if {found.tolerance.describe(found.time_unit)}: {below(found.late, 4)}{looked}"
        ax.axhline(found.late, color=color, linestyle="-.", linewidth=1.0, label=label)
    lost = f"if one sample is lost: {below(found.lost, 4)}{looked}"
    ax.axhline(found.lost, color=color, linestyle=":", linewidth=1.0, label=lost)
    return min(found.late, found.lost)


def draw_window_sigma(
    result: WindowSigma, ax: Axes | None = None, *, beside: bool = True, origin: str | None = None
) -> Axes:
    """Draw sigma over the window's end: attained values, proven bound, and the worst position, a date from `origin`.

    And, `beside`, what samples that come late or are lost leave of it.
    """
    ax = style.new_axes(ax)
    profile = result.profile
    curve = style.by_pieces(profile.t, profile.sigma, profile.piece)
    ax.plot(*curve, color=style.MEASURED, linewidth=2.2, label="sigma of the window")
    ax.axhline(
        result.lower, color=style.PROVEN, linewidth=1.2, label=f"proven for every position: {below(result.lower, 4)}"
    )
    # an open ring where sigma is only a one-sided limit, a full one where it is reached
    face = style.ATTAINED if result.witness.side == "at" else "none"
    (worst,) = ax.plot([result.witness.t], [result.upper], "o", color=style.ATTAINED, markerfacecolor=face)
    side, end = result.witness.side, style.moment(ax, result.witness.t, result.time_unit, origin=origin)
    worst.set_label(f"attained: {above(result.upper, 4)}, window ends {'' if side == 'at' else f'just {side} '}{end}")
    least = min(result.lower, draw_deviations(result.deviations, ax) if beside else np.inf)
    style.from_below(ax, min(least, float(profile.sigma.min())), float(profile.sigma.max()))
    style.time_axis(ax, result.time_unit, f"end of the window of {spoken(result.window, result.time_unit)}")
    title = f"sigma is at least {below(result.lower, 4)} in every window"
    return style.finished(ax, style.sigma_label(result.coordinates), title, 2)


def draw_design(result: ScheduleDesign, ax: Axes | None = None, *, origin: str | None = None) -> Axes | style.Panels:
    """Draw the schedule (on `ax` alone if given), and below it sigma, its proven bound and the bound on all schedules.

    `origin` is the date of time zero (ISO 8601), where it is known: then the axes show weekdays and dates. Raises
    ArgumentError if there is no schedule: nothing has to be observed.
    """
    if result.schedule is None or result.window is None:
        raise ArgumentError("`record` has no schedule to draw: every mode decays by itself.")
    schedule = result.schedule if origin is None else replace(result.schedule, origin=origin)
    if (
        result.requirement.sensors and schedule.outputs is None
    ):  # sensors with terms of their own have rows of their own
        names = result.plant.outputs.names
        schedule = replace(schedule, outputs=np.ones((len(schedule), len(names)), dtype=bool), output_names=names)
    if ax is not None:
        return _time_line(schedule, result, ax)
    rows = 1 if schedule.outputs is None else schedule.outputs.shape[1]
    figure, (top, bottom) = style.new_figure(2, ratios=(0.75 + 0.3 * rows, 2.4), row_height=2.6 + 0.1 * rows)
    _time_line(schedule, result, top)
    sigma_found = result.window
    draw_window_sigma(sigma_found, bottom, beside=False, origin=schedule.origin)
    bottom.set_title("", loc="left")  # the whole picture has one
    top_value, gap = float(sigma_found.profile.sigma.max()), "the bound on all schedules is too far off to say more"
    if not result.bound_is_vacuous:
        note = f"no admissible schedule exceeds {above(result.upper_bound, 4)}"
        bottom.axhline(result.upper_bound, color=style.TRUTH, linestyle="--", linewidth=1.0, label=note)
        top_value, gap = max(result.upper_bound, top_value), f"gap {above(100 * result.gap, 2)} %"
    least = draw_deviations(result.deviations, bottom)
    style.legend(bottom, 2)
    style.from_below(bottom, min(sigma_found.lower, least), top_value)
    if schedule.origin is not None:
        label = bottom.get_xlabel()
        style.dates(bottom, schedule.time_unit, schedule.origin)
        bottom.set_xlabel(label.partition(" [")[0])
    late = f" for samples {result.late.describe(result.plant.time_unit)}" if result.late else ""
    name = f"{result.plant.name}: " if result.plant.name else ""
    figure.suptitle(f"{name}sigma {below(result.sigma, 4)} proven{late}, {gap}", wrap=True)
    return style.Panels([top, bottom])


def _time_line(schedule: PeriodicSchedule, result: ScheduleDesign, ax: Axes) -> Axes:
    draw_schedule(schedule, ax)
    everybody = result.requirement.forbidden.tolist()
    grey = False
    for k, name in enumerate(result.plant.outputs.names if schedule.outputs is not None else ("",)):
        term = result.requirement.sensors.get(name)
        own = [] if term is None or term.available is None else complement(numbers(term), schedule.period).tolist()
        spans = _joined(everybody + own)
        style.shut(ax, k, [(cycle + a, cycle + b) for cycle in (0.0, schedule.period) for a, b in spans])
        grey |= bool(spans)
    if grey:
        ax.set_title(f"{ax.get_title(loc='left')}; grey: closed", loc="left")
    return ax


def _joined(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Spans without overlap, in order: what is closed twice is no darker."""
    found: list[tuple[float, float]] = []
    for start, stop in sorted(spans):
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(stop, found[-1][1]))
        else:
            found.append((start, stop))
    return found
