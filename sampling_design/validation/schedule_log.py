"""Planned against actual sample times: what came late, what was missed, and what that costs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.estimators.records.measurement_table import time_or_date
from sampling_design.observability.alignment import align
from sampling_design.observability.sigma_bracket import coordinates_of
from sampling_design.observability.windows.pieces import window_pieces
from sampling_design.observability.windows.window_record import RTOL, WindowSigma, sigma_of_pieces
from sampling_design.observability.windows.window_sigma import deviations_of
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.declarations import below, plain
from sampling_design.records.record import Plain, TableRecord, moment, short
from sampling_design.records.signatures import checked
from sampling_design.records.units import spoken
from sampling_design.schedules.jitter import ON_TIME
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

MOST_DATES = 8  # that a row of a table lists
STRETCH = 4000  # samples whose windows are judged at a time: what is held does not grow with the record
MATCHED = 50_000  # planned samples that are matched at a time, for the same reason
AROUND = 400  # samples on either side of the worst window of a long record whose windows are shown
LATE = 100  # planned samples for each one taken that may be missed before the first: more, and clocks differ


@dataclass(frozen=True, eq=False, repr=False)
class ScheduleLog(TableRecord):
    """What became of a schedule.

    Attributes
    ----------
    planned, actual : Schedule
        Over the time of the log; `actual` holds the samples that measured something.
    match : (N,) integer array
        For each planned sample the actual one that stands for it, -1 where it was missed.
    incomplete : (N,) array of bool
        Taken, but without an output that was planned.
    planned_sigma, actual_sigma : WindowSigma or None
        Over every position of the window; None where the log is shorter than the window, or no mode must be observed.
        Of a long record (more than `STRETCH` samples) the profiles are those around its worst window.
    time_unit : str
    decays : bool
        No mode must be observed: every one decays by itself.
    """

    planned: Schedule
    actual: Schedule
    match: Index
    incomplete: Mask
    planned_sigma: WindowSigma | None
    actual_sigma: WindowSigma | None
    time_unit: str
    decays: bool = False

    _frame = "planned:planned.times deviation:deviations incomplete"

    @property
    def deviations(self) -> Array:
        """Actual minus planned time of each planned sample; NaN where it was missed."""
        actual = np.append(self.actual.times, np.nan)
        return np.asarray(actual[self.match] - self.planned.times)

    @property
    def missed(self) -> Array:
        """Planned times at which nothing came."""
        return np.asarray(self.planned.times[self.match < 0])

    @property
    def extra(self) -> Array:
        """Actual times that were not planned."""
        spare = np.ones(len(self.actual), dtype=bool)
        spare[self.match[self.match >= 0]] = False
        return np.asarray(self.actual.times[spare])

    @property
    def largest_deviation(self) -> float:
        """Largest |actual - planned|; 0 where nothing was taken."""
        return float(np.nanmax(np.abs(self.deviations), initial=0.0)) if (self.match >= 0).any() else 0.0

    @property
    def kept(self) -> float | None:
        """Proven sigma of the actual times over the proven sigma of the planned ones; None where there is none."""
        if self.planned_sigma is None or self.actual_sigma is None or not self.planned_sigma.lower:
            return None
        return self.actual_sigma.lower / self.planned_sigma.lower

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; a deviation of a missed sample is None."""
        found = self.contents()
        return {key: plain(value) for key, value in found.items()}

    def contents(self) -> dict[str, Plain | Array]:
        """What `to_dict` holds, rows of numbers as arrays: NaN where a sample was missed."""
        sigmas = {"planned_sigma": self.planned_sigma, "actual_sigma": self.actual_sigma}
        return {
            "format": "sampling-design/schedule-log/1",
            "time_unit": self.time_unit,
            "planned": self.planned.times,
            "actual": self.actual.times,
            "deviations": self.deviations,
            "largest_deviation": self.largest_deviation,
            "missed": self.missed,
            "extra": self.extra,
            "incomplete": self.planned.times[self.incomplete],
            **{key: None if sigma is None else sigma.to_dict() for key, sigma in sigmas.items()},
            "kept": self.kept,
        }

    _answers = (
        "{actual.__len__} samples that were taken, against {planned.__len__} that were planned",
        "{_evidence}",
        "{_share}",
        "`window_sigma` of `.actual`",
    )

    def _evidence(self) -> str:
        both = self.planned_sigma is not None and self.actual_sigma is not None
        said = "proven: sigma of both, over every window" if both else "nothing is claimed"
        return f"{said}; the times are as they were measured"

    def _share(self) -> str:
        return "no sigma is compared" if self.kept is None else f"{below(100 * self.kept, 3)} % of the planned sigma"

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.time_unit
        away = np.abs(self.deviations[self.match >= 0])
        typical = spoken(float(np.median(away)), unit) if away.size else "-"
        rows = [
            ("missed", self._listed(self.missed)),
            ("not planned", self._listed(self.extra)),
            ("an output missing", str(int(self.incomplete.sum()))),
            ("largest deviation", spoken(self.largest_deviation, unit)),
            ("median deviation", typical),
        ]
        if self.planned_sigma is not None and self.actual_sigma is not None:
            rows.append(("window", f"{short(self.planned_sigma.window)} {unit}"))
            rows.append(("sigma, planned", below(self.planned_sigma.lower)))
            if self.planned_sigma.deviations is not None:
                rows += [(f"planned, {label}", value) for label, value in self.planned_sigma.deviations._rows()]
            rows.append(("sigma, actual", below(self.actual_sigma.lower)))
        return rows

    def _listed(self, times: Array) -> str:
        """How many times, and which: as dates where the plan has any."""
        if not self.planned.origin or not times.size:
            return f"{times.size}" + (f" at {moment(times)} {self.time_unit}" if times.size else "")
        shown = [time_or_date(self.planned.origin, t, self.time_unit) for t in times[:MOST_DATES].tolist()]
        return f"{times.size} at {', '.join(shown)}" + ", ..." * (times.size > MOST_DATES)

    def explain(self) -> str:
        """Say what the deviations cost."""
        missed, planned, away = self.missed.size, len(self.planned), self.largest_deviation
        near = f"within {spoken(away, self.time_unit)} of" if away else "at"
        others = f", the others came {near} their times" if missed < planned else ""
        text = f"{missed} of {planned} planned samples were missed{others}. "
        text = text if missed else f"All {planned} planned samples came {near} their times. "
        if self.decays:
            return text + "Every mode decays by itself, so that no window needs a sample and no sigma is compared."
        if self.planned_sigma is None or self.actual_sigma is None:
            return text + "The record is shorter than the window, so that sigma cannot be compared."
        if self.kept is None:
            return text + "The plan itself does not make every mode observable in each window."
        worst = f"sigma {below(self.actual_sigma.lower, 4)} instead of {below(self.planned_sigma.lower, 4)}"
        left = (
            "" if self.planned_sigma.deviations is None else f" Of the plan: {self.planned_sigma.deviations.explain()}"
        )
        return text + f"The worst window keeps {below(100 * self.kept, 3)} % of the plan: {worst}.{left}"


@checked
def compare_schedule(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    times: npt.ArrayLike,
    window: float,
    *,
    outputs: npt.ArrayLike | None = None,
    retained: Plant | None = None,
    budget: float = 20.0,
    progress: Progress | None = None,
) -> ScheduleLog:
    """Compare the times at which samples were taken with those that were planned.

    Parameters
    ----------
    plant : Plant
    schedule : Schedule or PeriodicSchedule
        What was planned; of a `Plan` its `.schedule`.
    times : (N,) array [time]
        When samples were taken, in order.
    window : float [time]
        Length of the windows over which sigma is judged.
    outputs : (N, p) array of bool, optional
        Which outputs each sample measured; default all.
    retained : Plant, optional
        The modes that must be observed; default the whole plant.
    budget : float
        Seconds for each of the two sigmas.
    progress : callable, optional
        Called with (fraction, message).

    Returns
    -------
    ScheduleLog

    Raises
    ------
    ArgumentError
        If there are no times, they are not in order, or the plan has no sample in their range; or if an endless plan
        has so many before them that they seem to count from another date.

    Notes
    -----
    *Method.* The plan is cut at half a gap beyond the last actual time. Planned and actual samples are matched in
    order, each to the nearest within half of the gaps around it. Sigma of a long record is that of the
    worst of its stretches; of an endless plan the windows that begin within two periods stand for all.

    Examples
    --------
    >>> from sampling_design import Plant, PeriodicSchedule
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> log = compare_schedule(plant, PeriodicSchedule([1.0]), [1.0, 2.2, 4.0, 5.0], window=2.0)
    >>> log.missed, round(log.largest_deviation, 3)
    (array([3.]), 0.2)
    """
    actual = checks.increasing("times", times)
    if not actual.size:
        raise ArgumentError("`times` must hold at least one sample: there is nothing to compare with the plan.")
    length = checks.positive("window", window)
    taken = Schedule(actual, checks.output_mask("outputs", outputs, actual.size), time_unit=plant.time_unit)
    plan = align(plant, schedule)
    before_all = len(plan) * (float(actual[0]) - plan.first) / plan.period if plan.endless else 0.0
    if before_all > LATE * actual.size:
        raise ArgumentError(
            f"`times` begin at {moment(actual[0])}, after {before_all:.3g} samples of `schedule`, which counts from "
            "time 0: do they count from another date? Of a plan that did begin so early, give the part that was due, "
            "`schedule.between(start, end)`."
        )
    half_gap = float(plan.gaps.min()) / 2 if plan.gaps.size else 0.0
    planned = plan.between(0.0, float(actual[-1]) + half_gap)
    if not len(planned):
        raise ArgumentError(f"`schedule` plans no sample up to {float(actual[-1])!r}, the last of `times`.")
    match = _paired_times(planned.times, actual)
    judged = plant if retained is None else retained
    before: WindowSigma | None = None
    after: WindowSigma | None = None
    start, end = float(min(planned.times[0], actual[0])), float(min(planned.times[-1], actual[-1]))
    if judged.n_states and end - start >= length:
        after = _judged(judged, taken, length, budget, progress, start)
        limit, part = Budget(budget), _distinct_windows(plan, planned, start + length)
        before = _judged(judged, part, length, budget, progress, start)
        beside = partial(deviations_of, judged, part, length, ON_TIME, before.lower, start, limit.left)
        named = coordinates_of(plant, judged)
        before, after = replace(before, beside=beside, coordinates=named), replace(after, coordinates=named)
        if max(len(planned), len(taken)) > STRETCH:
            before, after = (
                replace(sigma, profile=_around(judged, each, length, after.witness.t, start).profile)
                for sigma, each in ((before, planned), (after, taken))
            )
    incomplete = _lost_samples(plant, planned, taken, match)
    return ScheduleLog(planned, taken, match, incomplete, before, after, plant.time_unit, not judged.n_states)


def _judged(
    plant: Plant, schedule: Schedule, window: float, budget: float, progress: Progress | None, start: float
) -> WindowSigma:
    """Sigma over every window of a record: of a long one the worst of its stretches, which overlap by a window.

    Notes
    -----
    *Method.* A stretch ends with a sample, and the next one's first window is the one that ends there: every real
    position of the window lies in one of them.
    """
    times = schedule.times
    ends = [*range(STRETCH, len(schedule) - STRETCH // 2, STRETCH), len(schedule) - 1]
    ends = [k for k in ends if k == len(schedule) - 1 or times[k] - window > start]
    worst: WindowSigma | None = None
    for k, end in enumerate(ends):
        within = slice(int(np.searchsorted(times, start)), end + 1)
        mask = None if schedule.outputs is None else schedule.outputs[within]
        part = align(plant, Schedule(times[within], mask, time_unit=schedule.time_unit))
        pieces, alone = window_pieces(part, window, start), progress if len(ends) == 1 else None
        reached = np.inf if worst is None else worst.upper
        stretch = sigma_of_pieces(plant, part, pieces, RTOL, budget / len(ends), alone, reached=reached)
        worst = stretch if worst is None else _joint(worst, stretch)
        start = float(times[end]) - window
        if progress is not None and alone is None:
            progress((k + 1) / len(ends), f"sigma over windows: {end + 1} of {len(schedule)} samples")
    assert worst is not None
    return worst


def _joint(one: WindowSigma, other: WindowSigma) -> WindowSigma:
    """Sigma over the windows of both: the worst window, the lesser of the bounds, and whatever is open in either."""
    worst = other if other.upper < one.upper else one
    open_ = next((each for each in (one, other) if not each.closed), worst)
    return replace(
        worst,
        lower=min(one.lower, other.lower),
        from_time=min(one.from_time, other.from_time),
        status=open_.status,
        rigorous=one.rigorous and other.rigorous,
        slack=max(one.slack, other.slack),
    )


def _distinct_windows(plan: Schedule | PeriodicSchedule, planned: Schedule, end: float) -> Schedule:
    """The planned samples without those of an endless plan whose windows are shifts of others by whole periods.

    `end` is where the first window ends; every later one is, but for the number of periods before it, one of those that
    begin within two periods.
    """
    if not plan.endless:
        return planned
    cut = planned.between(0.0, max(end, float(plan.first)) + 2 * plan.period)
    return cut if len(cut) < len(planned) else planned


def _around(plant: Plant, schedule: Schedule, window: float, end: float, start: float) -> WindowSigma:
    """Sigma over the windows of the samples around the one that ends at `end`, for its profile; none before `start`."""
    times, n = schedule.times, len(schedule)
    first, last = (int(np.searchsorted(times, t)) for t in (end - window, end))
    within = slice(max(0, first - AROUND), min(n, last + AROUND + 1))
    mask = None if schedule.outputs is None else schedule.outputs[within]
    part = align(plant, Schedule(times[within], mask, time_unit=schedule.time_unit))
    pieces = window_pieces(part, window, None if within.start else start)
    return sigma_of_pieces(plant, part, pieces, RTOL, np.inf)


def _paired_times(planned: Array, actual: Array) -> Index:
    """Pair each planned time with the nearest actual one within half of the gaps around it, none twice.

    A stretch at a time. Of two neighbours that rounding leaves one sample between them, the first has it.
    """
    match = np.full(planned.size, -1, dtype=np.intp)
    last = -1
    for low in range(0, planned.size, MATCHED):
        index = np.arange(low, min(low + MATCHED, planned.size))
        t = planned[index]
        after_it = np.searchsorted(actual, t).clip(0, actual.size - 1)
        before_it = (after_it - 1).clip(0)
        away = actual[np.array([before_it, after_it])] - t
        within = (-_half_before(planned, index) <= away) & (away < _half_before(planned, index + 1))
        distance = np.where(within, np.abs(away), np.inf)
        fits = np.flatnonzero(within.any(axis=0))
        nearest = np.where(distance[0] <= distance[1], before_it, after_it)[fits]
        new = np.diff(nearest, prepend=last) > 0
        match[index[fits[new]]] = nearest[new]
        last = int(nearest[-1]) if nearest.size else last
    return match


def _half_before(planned: Array, index: Index) -> Array:
    """Half of the gap that ends at each planned sample; the first gap before the first one, the last after the last."""
    if planned.size < 2:
        return np.full(index.size, np.inf)
    end = index.clip(1, planned.size - 1)
    return np.asarray((planned[end] - planned[end - 1]) / 2)


def _lost_samples(plant: Plant, planned: Schedule, taken: Schedule, match: Index) -> Mask:
    full = np.ones((len(planned), plant.n_outputs), dtype=bool)
    wanted = full if planned.outputs is None else planned.outputs
    if taken.outputs is None:
        return np.zeros(len(planned), dtype=bool)
    return (match >= 0) & np.asarray((wanted & ~taken.outputs[match]).any(axis=1))
