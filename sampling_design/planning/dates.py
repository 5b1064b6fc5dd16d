"""A plan on real dates: local hours, changes of the clocks, and holidays; the whole sequence of real times is proven.

The plan's hours are local: 08:00 is 08:00 in summer and in winter. When the clocks change, one gap is an hour shorter
or longer, and everything after it an hour earlier or later than the period says. A sample on a holiday is left out, as
is one that the clocks skip; where that breaks a tolerance, others are added on open days near it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import MAXYEAR, datetime
from typing import TypeAlias

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.planning.disturbed import plan_start
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.sequence import gap_ratios, longest_out, proven_ratio, settling_time
from sampling_design.planning.sequence_deviation import (
    GRAIN,
    SampleSequence,
    departs_and_returns,
    is_apart,
    planned,
    sequence_from_start,
    too_soon,
)
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.dates import zoned_text
from sampling_design.records.record import ListRecord, PlainRecord, above, counted
from sampling_design.records.signatures import checked
from sampling_design.records.units import spoken
from sampling_design.schedules.schedule import Schedule

DatedSample: TypeAlias = tuple[float, Mask]

MINUTES_OF_A_YEAR = 365.2425 * 1440  # of the calendar, on average
MOST_ADDED = 3  # samples added around one closed stretch, at most
AROUND = 3.0  # days around it in which they may lie
MOST_TRIED = 24  # open times tried for each of them

LEVELS = (0.998, 0.985, 0.96)
"""Samples are added until floats say at most this share of the tolerance; where the proof says more, then the next."""

HELPS = 0.1  # an added sample takes at least this share off what is above the tolerances, integrated over time


@dataclass(frozen=True)
class PlannedDate:
    """One sample: its local date, its real time since the start [the plant's time unit], and what it measures."""

    date: datetime
    time: float
    outputs: tuple[str, ...]
    added: bool = False


@dataclass(frozen=True)
class DateException:
    """What is not as the period says, and what is proven from it to the next one (accuracy over tolerance).

    Attributes
    ----------
    what, date : str
    ratio : float
        With all exceptions before it and after it as they are; where more than 1 is all that is proven, the largest
        that a trajectory attains, or that the filter says.
    proven : bool
    """

    what: str
    date: str
    ratio: float
    proven: bool


@dataclass(frozen=True, eq=False, repr=False)
class PlanDates(ListRecord[PlannedDate], PlainRecord):
    """A plan written out on real dates.

    Attributes
    ----------
    plan : Plan
    entries : tuple of PlannedDate
    exceptions : tuple of DateException
        Changes of the clocks and holidays, each with what is proven across it, from `kept_from` on.
    kept_from : float
        From when on the plan keeps the tolerances after its start, but for exceptions, in real time since then [the
        plant's time unit]: 0 where the requirement's `initial_error` is small enough, infinite where nothing is proven.
    """

    plan: PlanFigures
    entries: tuple[PlannedDate, ...]
    exceptions: tuple[DateException, ...]
    kept_from: float = 0.0

    _frame = "entries{date time outputs added}"
    _plain = "entries{date time outputs added} kept_from exceptions{what date proven ratio}"

    def _entries(self) -> tuple[PlannedDate, ...]:
        return self.entries

    @property
    def keeps(self) -> bool:
        """Whether the tolerances are proven to be kept from `kept_from` on, across all exceptions."""
        return bool(np.isfinite(self.kept_from)) and all(e.proven and e.ratio <= 1 for e in self.exceptions)

    def schedule(self) -> Schedule:
        """The samples as a finite schedule in real time, with its origin."""
        names = self.plan.plant.outputs.names
        mask = np.array([[name in entry.outputs for name in names] for entry in self.entries]).reshape(-1, len(names))
        assert self.plan.requirement.calendar is not None
        return Schedule(
            np.array([entry.time for entry in self.entries]),
            mask if len(mask) else None,
            time_unit=self.plan.plant.time_unit,
            origin=zoned_text(self.plan.requirement.calendar.begun),
            output_names=names,
        )

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("samples", str(len(self.entries)))]
        if self.entries:
            rows.append(("from, to", f"{self.entries[0].date:%Y-%m-%d}, {self.entries[-1].date:%Y-%m-%d}"))
        rows.append(("kept from", self._since()))
        for e in self.exceptions:
            rows.append((e.date, f"{e.what}: {above(e.ratio, 4)} of the tolerance{'' if e.proven else ', not proven'}"))
        return rows

    def _since(self) -> str:
        """From when on, in words."""
        if not np.isfinite(self.kept_from):
            return "not proven"
        assert self.plan.requirement.calendar is not None
        date = self.plan.requirement.calendar.date(self.plan.minutes(self.kept_from))
        return f"{date:%Y-%m-%d %H:%M}" if self.kept_from else "the start on"

    def explain(self) -> str:
        """Say whether the dates keep what the plan promises, and from when on."""
        samples = counted(len(self.entries), "sample")
        since = f" The tolerances are kept from {self._since()}{' on' * bool(self.kept_from)}."
        since = since if np.isfinite(self.kept_from) else " From when on the tolerances are kept is not proven."
        return self._across(samples) + since

    def _across(self, samples: str) -> str:
        if not self.exceptions:
            return f"{samples} as planned; no change of the clocks and no holiday among them."
        text = f"{samples} with {counted(len(self.exceptions), 'exception')}"
        bad = [e.date for e in self.exceptions if e.ratio > 1]
        doubtful = [e.date for e in self.exceptions if e.ratio <= 1 and not e.proven]
        for words, dates in (("not kept", bad), ("not proven", doubtful)):
            text += f"; {words}: {', '.join(dates)}" if dates else ""
        return f"{text}." if bad or doubtful else f"{text}; every tolerance is kept across them."


@checked
def plan_dates(plan: PlanFigures, periods: int = 1, *, prove: bool = True) -> PlanDates:
    """Return a plan on real dates, with every change of the clocks and every holiday in it judged together.

    Parameters
    ----------
    plan : Plan
        With a calendar.
    periods : int
        How many, from the calendar's start on.
    prove : bool
        Prove the whole sequence over all real times; else it is judged in floats, on the grid.

    Returns
    -------
    PlanDates

    Raises
    ------
    ArgumentError
        If the plan has no calendar, or so many periods have no dates.

    Notes
    -----
    *Claim.* The plan begins at `calendar.start`, with an error within the requirement's `initial_error`, or any; from
    the period after the last one it is followed again; between them the samples are those of the dates, at their real
    times, each up to the `timing_tolerance` early or late. From `kept_from` on the tolerances are kept. *Method.*
    Up to three samples are added around those that are left out, each at the open time after which least of the
    accuracy is above its tolerance, integrated over time; none where that takes off less than a tenth.
    """
    calendar = plan.requirement.calendar
    if calendar is None:
        raise ArgumentError("`plan` has no calendar: its times are no dates.")
    count = checks.whole("periods", periods, 1)
    year = calendar.date(0.0).year + (count + 2) * plan.minutes(plan.schedule.period) / MINUTES_OF_A_YEAR
    if year >= MAXYEAR:
        raise ArgumentError(f"`periods` must end before the year {MAXYEAR}, the last of dates, got {count}.")
    return _DatedPlan(plan, count, prove).dates()


class _DatedPlan:
    """Dates of one plan: what is left out, what is added, and what is proven of the whole; times of the clock."""

    def __init__(self, plan: PlanFigures, periods: int, prove: bool):
        assert plan.requirement.calendar is not None
        self.plan, self.calendar, self.prove = plan, plan.requirement.calendar, prove
        self.end, self.known = (count * plan.schedule.period for count in (periods, periods + 1))
        self.clock = replace(plan.clock, until=float(plan.clock.elapsed(self.known)))
        self.span = settling_time(plan)
        self.shows = plan.schedule.period + longest_out(plan)  # how long after it a change is looked for
        self.times, self.measured = planned(plan, 0.0, self.known + self.span)
        start = plan.start or plan_start(plan)
        self.since = np.inf if start is None else float(self.clock.elapsed(start.from_time))
        """From when on the plan keeps the tolerances if nothing is left out, in real time."""
        self.open = np.array([not 0 <= t < self.known or self.is_open(t) for t in self.times.tolist()], dtype=bool)
        self.soon = np.zeros(self.open.size, dtype=bool)
        self.soon[self.open] = too_soon(
            plan.problem, self.clock.elapsed(self.times[self.open]), self.measured[self.open]
        )
        self.open &= ~self.soon
        runs = _runs(~self.open)
        self.closed = [self.times[run] for run in runs]
        """Clock times of samples one after another that cannot be taken, and why."""
        self.why = [self._why(run) for run in runs]
        self.day = 1440 / self.clock.minutes

    def dates(self) -> PlanDates:
        """Everything in order; with a wider margin where the proof fails."""
        found = self.judged(self.added(LEVELS[0])) if self.closed else self.judged([])
        for level in LEVELS[1:]:
            if found.keeps or not self.prove or not self.closed or any(e.ratio > 1 for e in found.exceptions):
                break
            again = self.judged(self.added(level))
            found = again if again.keeps else found
        return found

    def is_open(self, t: float) -> bool:
        """Whether a clock time is no holiday, and one that the clocks show."""
        return self.calendar.is_open(t * self.clock.minutes, holidays=True)

    def _why(self, run: Index) -> str:
        """Why samples one after another cannot be taken."""
        if self.soon[run].all():
            return "too soon after the sample before by the changed clocks"
        minutes = np.round(self.times[run] * self.clock.minutes, 6).tolist()
        return "skipped by the clocks" if all(map(self.calendar.is_skipped, minutes)) else "closed"

    def sequence(self, added: list[DatedSample], start: float = -np.inf, stop: float = np.inf) -> SampleSequence:
        """The samples that are taken in [start, stop), at real times."""
        keep = self.open & (self.times >= start) & (self.times < stop)
        times, measured = self.times[keep], self.measured[keep]
        if added:
            times = np.concatenate([times, [t for t, _ in added]])
            measured = np.concatenate([measured, np.array([s for _, s in added])])
        real = self.clock.elapsed(times)
        order = np.argsort(real, kind="stable")
        real, measured = real[order], measured[order]
        if start <= 0:
            return sequence_from_start(self.plan, real, measured, self.clock)
        whole = SampleSequence.of(self.plan.problem, real, measured, len(real), self.clock)
        return replace(whole, first=departs_and_returns(self.plan, whole)[0])

    def added(self, level: float) -> list[DatedSample]:
        """Samples for those that are left out: none where the plan can do without, else as few as keep the level."""
        level, found = max(level, self.plan.ratio), list[DatedSample]()
        for closed in self.closed:
            above = self.above(closed, found, level)
            for _ in range(MOST_ADDED if above else 0):
                tried = [(self.above(closed, [*found, one], level), one) for one in self.options(closed, found)]
                best, one = min(tried, key=lambda pair: pair[0], default=(np.inf, None))
                if one is None or best > (1 - HELPS) * above:
                    break
                found, above = [*found, one], best
                if not above:
                    break
        far = AROUND * self.day
        for one in found:  # what a later one makes needless
            others = [other for other in found if other is not one]
            near = [closed for closed in self.closed if abs(np.clip(one[0], *closed[[0, -1]]) - one[0]) <= far]
            if all(self.above(closed, others, level) <= self.above(closed, found, level) for closed in near):
                found = others
        return found

    def above(self, closed: Array, added: list[DatedSample], level: float) -> float:
        """How far accuracies are above a share of their tolerances around samples that are left out, over time."""
        since, until = (float(t) for t in closed[[0, -1]])
        since, until = since - AROUND * self.day, until + self.shows
        near = [one for one in added if since - self.span <= one[0] < until + self.span]
        sequence = self.sequence(near, since - self.span, until + self.span)
        real = self.clock.elapsed([since, until]).tolist()
        ratios = gap_ratios(self.plan, sequence, *real)
        length = np.diff(sequence.times)
        return float(sum(length[k] * max(ratio - level, 0.0) for k, ratio in ratios.items()))

    def options(self, closed: Array, added: list[DatedSample]) -> list[DatedSample]:
        """Open times near samples that are left out, spread out and spaced, with every sensor of the plan."""
        problem, step = self.plan.problem, self.plan.problem.step
        first, last = float(closed[0]) - AROUND * self.day, float(closed[-1]) + AROUND * self.day
        taken = self.sequence(added)
        found = []
        for i in range(max(0, int(first / step)), int(min(last, self.known) / step) + 1):
            mask = problem.allowed[i % problem.steps] & self.plan.chosen.any(axis=0)
            if mask.any() and self.is_open(i * step):
                t = float(self.clock.elapsed(i * step))
                found += [(i * step, mask)] if is_apart(problem, taken.times, taken.measured, t, mask) else []
        few = np.unique(np.round(np.linspace(0, len(found) - 1, MOST_TRIED)).astype(int)) if found else np.zeros(0, int)
        return [found[k] for k in few.tolist()]

    def judged(self, added: list[DatedSample]) -> PlanDates:
        """The dates, and what is proven of them."""
        whole = self.sequence(added)
        about = [(t, float(self.clock.elapsed(t)), what) for t, what in self.exceptions(added)]
        ratios = self.ratios(whole, [real for _, real, _ in about])
        exceptions, ends = [], np.append(whole.times, np.inf)
        tiny = GRAIN * self.plan.schedule.period
        since = self.since if np.isfinite(self.since) else 0.0
        for k, (t, real, what) in enumerate(about):
            later = min((other for _, other, _ in about[k + 1 :] if other > max(real, since)), default=np.inf)
            gaps = [g for g in ratios if ends[g] >= since - tiny and ends[g + 1] >= real and ends[g] < later]
            ratio, proven = max((ratios[g][0] for g in gaps), default=0.0), all(ratios[g][1] for g in gaps)
            if t < self.end:
                day = self.calendar.local(t * self.clock.minutes).date().isoformat()
                exceptions.append(DateException(what, day, ratio, proven and self.prove))
        return PlanDates(self.plan, self.entries(added), tuple(exceptions), self.since)

    def ratios(self, whole: SampleSequence, about: list[float]) -> dict[int, tuple[float, bool]]:
        """Of each gap that the start or exceptions can touch: accuracy over tolerance, and whether it is proven."""
        if not self.prove:
            found = dict[int, float]()
            for real in (0.0, *about):
                found |= gap_ratios(self.plan, whole, real - AROUND * self.day, real + self.shows)
            return {k: (ratio, False) for k, ratio in found.items()}
        proven = dict[int, float]()
        proven_ratio(self.plan, whole, proven)
        ratios = {k: (ratio, ratio <= 1) for k, ratio in proven.items()}
        for k in [k for k, ratio in proven.items() if ratio > 1 and k + 1 < len(whole.times)]:
            attained = gap_ratios(self.plan, whole, float(whole.times[k]), float(whole.times[k + 1]))
            ratios[k] = min(attained.get(k, np.inf), proven[k]), False
        return ratios

    def exceptions(self, added: list[DatedSample]) -> list[tuple[float, str]]:
        """Clock times of what is not as the period says, in order, and what it is."""
        shares = [0] * len(self.closed)
        for t, _ in added:
            shares[int(np.argmin([np.abs(closed - t).min() for closed in self.closed]))] += 1
        found = [
            (float(closed[0]), f"{why}, {closed.size} left out" + (f", {n} added" if n else ""))
            for closed, why, n in zip(self.closed, self.why, shares, strict=True)
        ]
        hours = np.arange(0.0, float(self.clock.elapsed(self.known)) * self.clock.minutes, 60.0) / self.clock.minutes
        local = self.clock.clock_time(hours)
        jumps = np.diff(local - hours)
        for k in np.flatnonzero(np.abs(jumps) > 1e-6 / self.clock.minutes).tolist():
            word = "back" if jumps[k] < 0 else "forward"
            found.append((float(local[k]), f"clocks {word} by {spoken(abs(jumps[k]) * self.clock.minutes, 'min')}"))
        return sorted(found)

    def entries(self, added: list[DatedSample]) -> tuple[PlannedDate, ...]:
        """The samples that are taken, as dates."""
        names = self.plan.plant.outputs.names
        every = [(t, s, False) for t, s in zip(self.times[self.open].tolist(), self.measured[self.open], strict=True)]
        found = []
        for t, s, new in sorted([*every, *((t, s, True) for t, s in added)], key=lambda item: item[0]):
            if 0 <= t < self.end:
                read = tuple(n for n, m in zip(names, s, strict=True) if m)
                date = self.calendar.instant(t * self.clock.minutes)
                found.append(PlannedDate(date, float(self.clock.elapsed(t)), read, new))
        return tuple(found)


def _runs(mask: Mask) -> list[Index]:
    """Stretches of neighbours that are true."""
    at = np.flatnonzero(mask)
    return [run for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if run.size]
