"""A plan on real dates: local hours, changes of the clocks, and holidays; what is out of the ordinary is proven anew.

The plan's hours are local: 08:00 is 08:00 in summer and in winter. When the clocks change, one gap is an hour shorter
or longer, and everything after it an hour earlier or later than the period says. A sample on a holiday is left out, and
where that breaks a tolerance, others are added on open days near it. Each such stretch is a sequence of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._door import door
from sampling_design._record import Plain, Record, counted, short
from sampling_design._units import SECONDS, spoken
from sampling_design.errors import ArgumentError
from sampling_design.planning.oracle import Oracle
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.sequence import proven_ratio, settles, worst_ratio
from sampling_design.planning.spread_sequence import SampleSequence, planned
from sampling_design.schedules.schedule import Schedule

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MOST_ADDED = 3
"""Samples added around one closed stretch, at most."""

MOST_TRIED = 24
"""Open times tried for each of them."""

NEAR = 0.998


@dataclass(frozen=True)
class PlannedDate:
    """One sample: its local date, its real time since the start [the plant's time unit], and what it measures."""

    date: datetime
    time: float
    outputs: tuple[str, ...]
    added: bool = False


@dataclass(frozen=True)
class DateException:
    """A stretch that is not as the period says, and what is proven of it (accuracy over tolerance)."""

    what: str
    date: str
    ratio: float
    proven: bool


@dataclass(frozen=True, eq=False, repr=False)
class PlanDates(Record):
    """A plan written out on real dates.

    Attributes
    ----------
    plan : Plan
    entries : tuple of PlannedDate
    exceptions : tuple of DateException
        Changes of the clocks and holidays, each with what is proven across it.
    """

    plan: Plan
    entries: tuple[PlannedDate, ...]
    exceptions: tuple[DateException, ...]

    @property
    def keeps(self) -> bool:
        """Whether every exception is proven to keep the tolerances."""
        return all(e.proven and e.ratio <= 1 for e in self.exceptions)

    def schedule(self) -> Schedule:
        """The samples as a finite schedule in real time, with its origin."""
        names = self.plan.plant.outputs.names
        mask = np.array([[name in entry.outputs for name in names] for entry in self.entries]).reshape(-1, len(names))
        assert self.plan.requirement.calendar is not None
        return Schedule(
            np.array([entry.time for entry in self.entries]),
            mask if len(mask) else None,
            time_unit=self.plan.plant.time_unit,
            origin=self.plan.requirement.calendar.instant(0.0).isoformat(),
            output_names=names,
        )

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("samples", str(len(self.entries)))]
        if self.entries:
            rows.append(("from, to", f"{self.entries[0].date:%Y-%m-%d}, {self.entries[-1].date:%Y-%m-%d}"))
        for e in self.exceptions:
            rows.append((e.date, f"{e.what}: {short(e.ratio, 4)} of the tolerance{'' if e.proven else ', not proven'}"))
        return rows

    def explain(self) -> str:
        """Say whether the dates keep what the plan promises."""
        samples = counted(len(self.entries), "sample")
        if not self.exceptions:
            return f"{samples} as planned; no change of the clocks and no holiday among them."
        told = f"{samples} with {counted(len(self.exceptions), 'exception')}"
        bad = [e.date for e in self.exceptions if e.ratio > 1]
        doubtful = [e.date for e in self.exceptions if e.ratio <= 1 and not e.proven]
        for words, dates in (("not kept", bad), ("not proven", doubtful)):
            told += f"; {words}: {', '.join(dates)}" if dates else ""
        return f"{told}." if bad or doubtful else f"{told}; every tolerance is kept across them."

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return {
            "entries": [
                {"date": e.date.isoformat(), "time": e.time, "outputs": list(e.outputs), "added": e.added}
                for e in self.entries
            ],
            "exceptions": [
                {"what": e.what, "date": e.date, "proven": e.proven, "ratio": e.ratio if np.isfinite(e.ratio) else None}
                for e in self.exceptions
            ],
        }


@door
def plan_dates(plan: Plan, periods: int = 1, *, prove: bool = True) -> PlanDates:
    """Return a plan on real dates, with every change of the clocks and every holiday judged.

    Parameters
    ----------
    plan : Plan
        With a calendar.
    periods : int
        How many, from the calendar's start on.
    prove : bool
        Prove the exceptions over all real times; else they are judged on the raster.

    Returns
    -------
    PlanDates

    Raises
    ------
    ArgumentError
        If the plan has no calendar.
    """
    calendar = plan.requirement.calendar
    if calendar is None:
        raise ArgumentError("`plan` has no calendar: its times are no dates.")
    run = _Dating(plan, _checks.whole("periods", periods, 1), prove)
    return run.dates()


class _Dating:
    """Dates of one plan: clock times first, then what is added, then real times."""

    def __init__(self, plan: Plan, periods: int, prove: bool):
        assert plan.requirement.calendar is not None
        self.plan, self.calendar, self.prove = plan, plan.requirement.calendar, prove
        self.end = periods * plan.schedule.period
        self.unit = SECONDS[plan.plant.time_unit] / 60

    @property
    def oracle(self) -> Oracle:
        """Judges in floats; made when there is something to judge."""
        return self.plan.oracle

    def dates(self) -> PlanDates:
        """Everything in order."""
        times, seen = planned(self.plan, 0.0, self.end)
        open_ = np.array([self.is_open(t) for t in times], dtype=bool)
        exceptions: list[DateException] = []
        added: list[tuple[float, Mask]] = []
        for lost in _runs(~open_):
            more, exception = self.replaced(times[lost])
            added += more
            exceptions.append(exception)
        exceptions += [self.changed(clock, shift) for clock, shift in self.clock_changes()]
        every = [(t, s, False) for t, s, keep in zip(times, seen, open_, strict=True) if keep]
        every += [(t, s, True) for t, s in added]
        names = self.plan.plant.outputs.names
        entries = [
            PlannedDate(
                self.calendar.instant(t * self.unit),
                float(self.plan.clock.elapsed(t)),
                tuple(n for n, m in zip(names, s, strict=True) if m),
                new,
            )
            for t, s, new in sorted(every, key=lambda item: item[0])
        ]
        return PlanDates(self.plan, tuple(entries), tuple(sorted(exceptions, key=lambda e: e.date)))

    def is_open(self, t: float) -> bool:
        """Whether a clock time is no holiday."""
        return self.calendar.is_open(t * self.unit, holidays=True)

    def judged(self, sequence: SampleSequence) -> tuple[float, bool]:
        """What is known of a sequence, and whether it is proven."""
        if self.prove:
            ratio = proven_ratio(self.plan, sequence)
            if ratio <= 1:
                return ratio, True
        return worst_ratio(self.plan, sequence, until=float(sequence.times[-1]) - self.plan.schedule.period), False

    def around(self, lost: Array, added: list[tuple[float, Mask]]) -> SampleSequence:
        """The plan without the lost samples, with those added."""
        mean = self.plan.schedule.period / len(self.plan.schedule)
        span = settles(self.plan) * mean + self.plan.schedule.period
        first = min([float(lost[0]), *(t for t, _ in added)])
        times, seen = planned(self.plan, first - span, float(lost[-1]) + span)
        keep = np.min(np.abs(times[:, None] - lost[None, :]), axis=1) > 1e-9 * mean
        keep &= np.array([t <= lost[0] or self.is_open(t) or t > lost[-1] for t in times])
        times, seen = times[keep], seen[keep]
        if added:
            times = np.concatenate([times, [t for t, _ in added]])
            seen = np.concatenate([seen, np.array([s for _, s in added])])
            order = np.argsort(times, kind="stable")
            times, seen = times[order], seen[order]
        return SampleSequence(times, seen, int(np.searchsorted(times, first - 1e-9 * mean)))

    def replaced(self, lost: Array) -> tuple[list[tuple[float, Mask]], DateException]:
        """Samples in place of lost ones: none if the plan can do without, else as few as keep the tolerances."""
        added: list[tuple[float, Mask]] = []
        day = self.calendar.local(float(lost[0]) * self.unit).date().isoformat()
        for _ in range(MOST_ADDED + 1):
            ratio, proven = self.judged(self.around(lost, added))
            if ratio <= 1 and (proven or not self.prove):
                break
            options = self.options(lost, added)
            if not options or len(added) == MOST_ADDED:
                break
            added = [*added, min(options, key=lambda option: self.value(lost, [*added, option]))]
        what = f"closed, {len(lost)} left out" + (f", {len(added)} added" if added else "")
        return added, DateException(what, day, ratio, proven)

    def value(self, lost: Array, added: list[tuple[float, Mask]]) -> float:
        """Accuracy over tolerance in floats."""
        sequence = self.around(lost, added)
        return worst_ratio(self.plan, sequence, until=float(lost[-1]) + self.plan.schedule.period)

    def options(self, lost: Array, added: list[tuple[float, Mask]]) -> list[tuple[float, Mask]]:
        """Open times near the lost samples, spread out and spaced, with every sensor of the plan."""
        problem, step = self.plan.problem, self.plan.problem.step
        around = self.around(lost, added).times
        day = 1440 / self.unit
        first, last = float(lost[0]) - 3 * day, float(lost[-1]) + 3 * day
        found = []
        for i in range(max(0, int(first / step)), int(last / step) + 1):
            mask = problem.allowed[i % problem.steps] & self.plan.chosen.any(axis=0)
            apart = np.min(np.abs(around - i * step)) >= (problem.spacing - 1e-6) * step
            if mask.any() and apart and self.is_open(i * step):
                found.append((i * step, mask))
        return (
            [found[k] for k in np.unique(np.round(np.linspace(0, len(found) - 1, MOST_TRIED)).astype(int))]
            if found
            else []
        )

    def clock_changes(self) -> list[tuple[float, float]]:
        """Clock time and shift of each change of the clocks [the plant's time unit]."""
        marks = np.arange(0.0, self.end * self.unit + 1, 60.0)
        real = np.array([self.calendar.elapsed(float(m)) for m in marks])
        jumps = np.diff(real) - 60.0
        return [
            (float(marks[k]) / self.unit, float(jumps[k]) / self.unit) for k in np.flatnonzero(np.abs(jumps) > 1e-6)
        ]

    def changed(self, clock: float, shift: float) -> DateException:
        """What is proven across a change of the clocks: all that follows comes `shift` later."""
        mean = self.plan.schedule.period / len(self.plan.schedule)
        span = settles(self.plan) * mean + self.plan.schedule.period
        at = float(self.plan.clock.elapsed(clock))
        once = replace(self.plan.clock, until=at + max(-shift, 0.0) + self.plan.problem.step)
        times, seen = planned(self.plan, at - span, at + span, once)
        sequence = SampleSequence(times, seen, int(np.searchsorted(times, at)), once)
        ratio, proven = self.judged(sequence)
        word = "back" if shift > 0 else "forward"
        day = self.calendar.local(clock * self.unit).date().isoformat()
        return DateException(f"clocks {word} by {spoken(abs(shift) * self.unit, 'min')}", day, ratio, proven)


def _runs(mask: Mask) -> list[npt.NDArray[np.intp]]:
    """Stretches of neighbours that are true."""
    at = np.flatnonzero(mask)
    return [run for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if run.size]
