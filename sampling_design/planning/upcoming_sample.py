"""The next sample: the latest time that keeps the tolerances from now on, or else the one that brings them back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.planning.choices import NextChoices
from sampling_design.planning.deadline import GoalDeadline
from sampling_design.planning.disturbed import from_start, settled_from_start
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.recorded_samples import (
    Reading,
    RecordedSamples,
    check_followed,
    check_resolved,
    clock_near_start,
    put_back,
    result_times,
    taken_samples,
    with_awaited,
)
from sampling_design.planning.sequence import known_at, looks_back, time_out
from sampling_design.planning.sequence_deviation import SampleSequence, planned
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget
from sampling_design.records.declarations import above, selected
from sampling_design.records.record import Plain, Record, moment, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.opening import WEEK


class AwaitedResult(NamedTuple):
    """A sample that was taken and whose result is not in yet."""

    output: str
    t: float  # when it was taken, or planned: `earliest` and `latest` are then of all times at which it may have been
    earliest: float  # earliest, latest: when its result comes at least and at most, as the requirement says
    latest: float


GRID_ALONE = "between its times nothing is proven"


@dataclass(frozen=True, eq=False, repr=False)
class NextSample(Record):
    """When to sample next, at the latest.

    Attributes
    ----------
    plan : Plan
    now : float
        Time that has passed since the start of the plan [the plant's time unit], as all times here; `date` names it.
    latest : float
        With the sensors `outputs`, at this very time (`explain` says "by" where any before it will do); after it the
        plan's own times follow. Times up to a period ahead are looked at; the next allowed one of these was found too
        late, by floats or within two thousandths of it; one further on may do again. Where no time keeps every
        tolerance from now on: that after which they are all kept again soonest. -inf: none is known.
    outputs : tuple of str
    alone : dict of str to float
        For each sensor of the plan, the latest time if that sensor is all that is read then.
    best : float
        Of up to eight times up to `latest` that after which the worst accuracy is least, by looks on the grid.
    ratio : float
        What is proven of `latest`: accuracy over tolerance, from `kept_from` on and for ever after.
    proven : bool
        Else all this rests on looks on the grid: between its times, or where results come in, more may be so.
    deadline : GoalDeadline or None
        Which goal reaches its tolerance first, and when, if the sample comes at the next allowed time after `latest`;
        where no sample keeps them all, at `latest`. None if it may come at any time of the period ahead, or where
        `complete` is false.
    alone_deadlines : dict of str to GoalDeadline
        The same for each sensor alone.
    kept_from : float
        From when on every tolerance is kept: `now`, unless one cannot be; inf where nothing is known.
    exceeded : GoalDeadline or None
        The goal that is above its tolerance now, since which look on the grid without a break, and how far.
    known : dict of str to float
        How well each goal is known now, whatever was read [its unit]: proven, or a standard deviation. From a start of
        which nothing is known it may be for errors up to a million times what samples leave, as in `PlanStart`.
    judged_until : float
        The first closed day with a sample of the plan that is too far ahead to be judged; inf if there is none.
    complete : bool
        Whether the budget was enough: else a later sample may do, and `alone`, `best` and deadlines may be left out.
    awaited : tuple of AwaitedResult
        Results that are out now and counted on: each from its `latest` on.
    """

    plan: Plan
    now: float
    latest: float
    outputs: tuple[str, ...]
    alone: dict[str, float]
    best: float
    best_outputs: tuple[str, ...]
    ratio: float
    proven: bool
    deadline: GoalDeadline | None = None
    alone_deadlines: dict[str, GoalDeadline] = field(default_factory=dict)
    kept_from: float = -np.inf
    exceeded: GoalDeadline | None = None
    known: dict[str, float] = field(default_factory=dict)
    judged_until: float = np.inf
    complete: bool = True
    awaited: tuple[AwaitedResult, ...] = ()

    @property
    def keeps(self) -> bool:
        """Whether every tolerance is kept from now on, if the next sample comes by `latest`."""
        return bool(np.isfinite(self.latest)) and self.kept_from <= self.now

    def date(self, t: float) -> datetime | None:
        """Local date of a time, where the plan has a calendar."""
        calendar = self.plan.requirement.calendar
        return None if calendar is None or not np.isfinite(t) else calendar.date(self.plan.minutes(t))

    def when(self, t: float, since: float | None = None) -> str:
        """A time in words: local where there is a calendar; with no more of its date than one needs after `since`."""
        if not np.isfinite(t):
            return "never"
        date, before = self.date(t), None if since is None else self.date(since)
        if date is None:
            return f"{moment(t)} {self.plan.plant.time_unit}"
        near = before is not None and (date.date() - before.date()).days < WEEK
        return f"{date:%a %H:%M}" if near else f"{date:%a %d %b %H:%M}"

    def _beside(self, t: float) -> str:
        """A time in words next to the latest: on the same day its hour alone."""
        date, latest = self.date(t), self.date(self.latest)
        return f"{date:%H:%M}" if date and latest and date.date() == latest.date() else self.when(t, self.now)

    _answers = ("{_what}", "{_evidence}", "{ratio:4up} of the tolerance", "`next_sample` with `now` at `.latest`")

    def _what(self) -> str:
        return "when the next sample must be taken" if self.keeps else "which sample brings the tolerances back"

    def _evidence(self) -> str:
        if self.proven:
            return "proven: that share is not exceeded from then on"
        looked = f"sampled: judged in floats on the grid, {GRID_ALONE}"
        return looked if np.isfinite(self.latest) else "nothing is proven: it may be exceeded"

    def _rows(self) -> list[tuple[str, str]]:
        goals = {goal.name: goal for goal in self.plan.goals}
        rows = [("now", self.when(self.now))]
        for name, value in self.known.items():
            goal = goals[name]
            unit = f" {goal.unit}" if goal.unit else ""
            now = f"within {above(value, 4)}{unit}" if np.isfinite(value) else "not known yet"
            rows.append((f"{name} now", f"{now} (tolerance {short(goal.tolerance)})"))
        for one in self.awaited:
            early = f"from {self.when(one.earliest, self.now)} to " if self.now < one.earliest < one.latest else "by "
            until = self.when(one.latest, self.now)
            rows.append((f"{one.output} of {self.when(one.t)}", f"is out, in {early}{until}"))
        rows += [("exceeded", f"{self.exceeded.goal} since {self.when(self.exceeded.time)}")] if self.exceeded else []
        rows.append(("latest" if self.keeps else "soonest help", self._read_at(self.latest, self.outputs)))
        rows += [("later" if self.keeps else "then", self._later(self.deadline))] if self.deadline else []
        for name, t in self.alone.items():
            more = f"; later: {self._later(self.alone_deadlines[name])}" if name in self.alone_deadlines else ""
            rows += [(f"{name} alone", f"{self._by(t)} {self.when(t)}{more}")] if np.isfinite(t) else []
        rows += [("best", self._read_at(self.best, self.best_outputs))] if np.isfinite(self.best) else []
        rows += [] if self.keeps else [("kept again", self._again())]
        rows += [] if self.complete else [("budget", "spent: a later sample may do")]
        ahead = np.isfinite(self.judged_until)
        rows += [("not judged", f"closed days from {self.when(self.judged_until)} on")] if ahead else []
        return rows

    def _again(self) -> str:
        return f"from {self.when(self.kept_from)} on" if np.isfinite(self.kept_from) else "not known"

    def _later(self, deadline: GoalDeadline) -> str:
        """What a later sample would do, in words."""
        if deadline.breaks:
            return f"{deadline.goal} reaches its tolerance by {self.when(deadline.time, self.now)}"
        share = f"{above(deadline.ratio, 4)} of its tolerance"
        return f"{deadline.goal} comes to {share} by {self.when(deadline.time, self.now)}, and more is not ruled out"

    def _read_at(self, t: float, outputs: tuple[str, ...]) -> str:
        """A time and what is read then."""
        return ", ".join([self.when(t), *(outputs if np.isfinite(t) else ())])

    def explain(self) -> str:
        """Say when to sample."""
        if not np.isfinite(self.latest):
            after = f" ({above(self.ratio, 4)} of them after the last one tried)" if np.isfinite(self.ratio) else ""
            text = f"No allowed sample is proven to bring the tolerances back{after}: keep to the plan's next one"
            return f"{self._state()}{text}, or sample as soon as the place is open."
        if not self.keeps:
            one = f"{self.when(self.latest)} ({', '.join(self.outputs)})"
            text = f"A sample at {one} helps soonest"
            if self.exceeded is None:
                late = "" if self.deadline is None else f": with one at {one} {self._later(self.deadline)}"
                text = f"No single sample keeps every tolerance from now on{late}"
            return f"{self._state()}{text}. Every tolerance is kept {self._again()}{self._unproven()}."
        others = {name: t for name, t in self.alone.items() if np.isfinite(t) and (name,) != self.outputs}
        alone = [f"{name} alone {self._by(t)} {self._beside(t)}" for name, t in others.items()]
        first = f"Next sample {self._by(self.latest)} {self.when(self.latest, self.now)} ({', '.join(self.outputs)})"
        later = f" If taken at the next allowed time after that, {self._later(self.deadline)}." if self.deadline else ""
        return "; ".join([first, *alone]) + f"{self._unproven()}.{later}"

    def _by(self, t: float) -> str:
        """Say "by" up to the plan's own next sample, if nothing is spaced: earlier is one sample more; else "at"."""
        problem, tiny = self.plan.problem, 1e-6 * self.plan.problem.step
        spaced = max(problem.spacing, int(problem.sensor_spacing.max())) > 1
        own = planned(self.plan, self.now + tiny, t + tiny, self.plan.clock)[0]
        return "by" if not spaced and own.size and own[0] >= t - tiny else "at"

    def _unproven(self) -> str:
        return "" if self.proven else f", by looks on the grid alone: {GRID_ALONE}"

    def _state(self) -> str:
        """What is exceeded, and what is known now."""
        if self.exceeded is None:
            return ""
        goal = next(goal for goal in self.plan.goals if goal.name == self.exceeded.goal)
        if not np.isfinite(self.known.get(goal.name, 0.0)):
            return f"{goal.name} is not known yet: what was read since the start does not tell the state. "
        within = above(self.known.get(goal.name, self.exceeded.ratio * goal.tolerance), 4)
        unit = f" {goal.unit}" if goal.unit else ""
        text = f"{goal.name} has been above its tolerance of {short(goal.tolerance)}{unit} since "
        return f"{text}{self.when(self.exceeded.time)}: within {within}{unit} now. "

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""

        def number(x: float) -> Plain:
            return x if np.isfinite(x) else None

        def plain(t: float) -> Plain:
            date = self.date(t)
            return {"time": number(t), "date": None if date is None else date.isoformat()}

        def goal(found: GoalDeadline | None) -> Plain:
            return {"goal": found.goal, "ratio": number(found.ratio), "when": plain(found.time)} if found else None

        return {
            **{key: plain(getattr(self, key)) for key in ("now", "latest", "best", "kept_from", "judged_until")},
            **selected(self, "outputs best_outputs proven complete"),
            **{key: goal(getattr(self, key)) for key in ("deadline", "exceeded")},
            "alone": {name: plain(t) for name, t in self.alone.items()},
            "alone_deadlines": {name: goal(self.alone_deadlines.get(name)) for name in self.alone},
            "ratio": number(self.ratio),
            "known": {name: number(value) for name, value in self.known.items()},
            "awaited": [
                {"output": one.output, "t": plain(one.t), "earliest": plain(one.earliest), "latest": plain(one.latest)}
                for one in self.awaited
            ],
        }


@checked
def next_sample(
    plan: Plan,
    record: Iterable[tuple[float, Reading, npt.ArrayLike | None]] | None = None,
    *,
    now: float | str | datetime | None = None,
    awaited: Iterable[tuple[float, str]] = (),
    prove: bool = True,
    budget: float | None = None,
) -> NextSample:
    """Return how late the next sample may be for every tolerance to be kept from now on, for ever.

    If one cannot be kept: since when, how well it is known now, and the sample that brings it back soonest.

    Parameters
    ----------
    plan : Plan
        Whose tolerances are kept.
    record : Measurements or iterable of (t, y, u), optional
        What was measured since the plan began, in any order; only the times and the outputs that are not NaN matter.
        Before its first sample, the plan was followed since its start, where nothing is known but the requirement's
        `initial_error`. Default: it was followed until `now`.
    now : float, optional
        A date (without a zone: by the plan's clocks), or the time that has passed since the plan's start [the plant's
        time unit]: a day on which clocks are put forward has 23 h. Default: the last sample of the record, else 0.
        Where doubles are far apart, one within two of them of the grid counts as on it, those of the record too.
    awaited : iterable of (t, output)
        Samples of the record whose results are not in; each counts from its `result_delay` on. One that should be in by
        now counts as lost. Without a record the plan's own are out.
    prove : bool
        Prove the answer by gains over all real times; else it rests on the search alone.
    budget : float, optional [seconds]
        Once they are spent, the latest sample that is proven by then is the answer, with less said beside it. An
        interrupt (KeyboardInterrupt) once there is an answer ends what is said beside it likewise.

    Returns
    -------
    NextSample

    Raises
    ------
    ArgumentError
        If the plan does not keep its tolerances, the record or `now` leaves too much of the grid without a sample, or
        what is awaited has no `result_delay`, was not taken by `now`, or is in the record, or a time is so large that
        no double tells steps of the grid apart.

    Notes
    -----
    *Claim.* If a sample with `outputs` is taken at `latest`, and the plan's samples follow, no tolerance is broken from
    `kept_from` on. That is `now` as long as samples come: this may be asked again after each, and has an answer
    (induction). What was broken before now is over, and all that was measured then counts. Samples of the plan on days
    that are known to be closed are left out, or what `plan_dates` puts in their place follows, up to `judged_until`.
    After a miss no sample may keep every tolerance: then `latest` is that after which all are kept again soonest. Who
    waits until the accuracy reaches its tolerance may find that no sample keeps it any more. *Other times.* Up to the
    plan's own next sample any time is as good where the plan has no spacing. Else an earlier one may break a tolerance,
    and one beyond the next allowed time may keep them all. *Assumptions.* The bounds; later samples, and those before
    the record, up to the plan's `timing_tolerance` early or late, the next one too; those of the record were taken when
    it says. Results come by their `result_delay`. It holds whatever is read.

    References
    ----------
    Heemels, Johansson and Tabuada, An introduction to event-triggered and self-triggered control (2012).

    Examples
    --------
    >>> import sampling_design as sd
    >>> wanted = sd.PlanRequirement({"x1": 0.6}, period=4, grid=1, w_bound=0.1, sensors={"y1": {"noise_bound": 0.1}})
    >>> plan = sd.plan_samples(sd.Plant([[0.0]], [[1.0]]), wanted, certificate=False, robustness=False)
    >>> next_sample(plan, now=5.0).latest
    8.0
    """
    if not plan.keeps:
        raise ArgumentError("`plan` must keep its tolerances: it does not, so there is nothing to go on keeping.")
    taken = taken_samples(plan, record)
    last = taken.times[-1] if taken is not None and taken.times.size else 0.0
    at = given = check_resolved(plan, "now", float(last) if now is None else plan.elapsed("now", now))
    if taken is not None and taken.times.size and at < last - 1e-9 * plan.problem.step:
        raise ArgumentError(f"`now` must not lie before the last sample {float(last)!r}, got {at!r}.")
    taken = with_awaited(plan, taken, [*awaited], at)
    check_followed(plan, taken, at)
    limit = Budget(None if budget is None else checks.positive("budget", budget))
    zero = clock_near_start(plan, taken, at, soon=budget is not None)
    if zero:
        at = float(put_back(plan, np.array(at), zero))
        taken = None if taken is None else taken._replace(times=put_back(plan, taken.times, zero))
    run = NextChoices(plan, _history(plan, taken, at, soon=budget is not None), at, limit, prove=prove)
    known = known_at(plan, run.history, at, limit)
    exceeded = run.exceeded(known)
    full = run.answer(None)
    if not np.isfinite(full.t):
        full = run.soonest()
    keeps = full.kept_from <= at
    alone, alone_deadlines = dict[str, float](), dict[str, GoalDeadline]()
    best, deadline = (full.t, full.mask), None
    try:
        for j, name in enumerate(plan.plant.outputs.names):
            same = np.array_equal(full.mask, np.arange(plan.plant.n_outputs) == j)
            if keeps and plan.chosen[:, j].any() and (same or not limit.over):
                alone[name] = full.t if same else run.answer(j).t
                why = run.later(None if same else j, alone[name])
                if why is not None:
                    alone_deadlines[name] = why
        best = run.best(best) if keeps else best
        deadline = run.later(None, full.t) if keeps else run.breach(best) if exceeded is None else None
    except KeyboardInterrupt:  # the answer is there: nothing more is said beside it
        limit.stop()
    found = NextSample(
        plan=plan, now=at, latest=full.t, outputs=_named(plan, full.mask), alone=alone, best=best[0],
        best_outputs=_named(plan, best[1]), ratio=full.ratio, proven=full.proven, deadline=deadline,
        alone_deadlines=alone_deadlines, kept_from=full.kept_from, exceeded=exceeded, known=known,
        judged_until=run.judged_until(max(at, full.t)), complete=not limit.over, awaited=_out(plan, run.history, at),
    )  # fmt: skip
    return _later(found, zero, given) if zero else found


def _later(found: NextSample, by: float, now: float) -> NextSample:
    """The same on a clock that shows so much more, `now` as it was given."""

    def goal(deadline: GoalDeadline | None) -> GoalDeadline | None:
        return deadline and replace(deadline, time=deadline.time + by)

    return replace(
        found, now=now, latest=found.latest + by, best=found.best + by, deadline=goal(found.deadline),
        kept_from=now if found.kept_from == found.now else found.kept_from + by, exceeded=goal(found.exceeded),
        alone={name: t + by for name, t in found.alone.items()},
        alone_deadlines={name: replace(each, time=each.time + by) for name, each in found.alone_deadlines.items()},
        awaited=tuple(
            one._replace(t=one.t + by, earliest=one.earliest + by, latest=one.latest + by) for one in found.awaited
        ),
    )  # fmt: skip


def _named(plan: Plan, mask: Mask) -> tuple[str, ...]:
    return tuple(name for name, measured in zip(plan.plant.outputs.names, mask, strict=True) if measured)


def _out(plan: Plan, history: SampleSequence, now: float) -> tuple[AwaitedResult, ...]:
    """What was taken by now and is out."""
    delays = plan.problem.result_delays
    if delays is None:
        return ()
    comes, tiny = history.centres[:, None] + history.comes_after(np.True_, late=True), 1e-6 * plan.problem.step
    pending = np.argwhere(np.isfinite(comes) & (comes > now + tiny) & (history.times[:, None] <= now + tiny))
    return tuple(
        AwaitedResult(
            plan.plant.outputs.names[j], t, t - float(history.sides[k, 0, j]) + float(delays[j, 0]), float(comes[k, j])
        )
        for k, j in pending.tolist()
        for t in [float(history.times[k])]
    )


def _history(plan: Plan, taken: RecordedSamples | None, now: float, *, soon: bool = False) -> SampleSequence:
    """Everything measured until now, and how much of it is the plan's: from its start, until that settles by proof.

    `soon`: by a proof that costs little.
    """
    mean = plan.schedule.period / len(plan.schedule)
    span = (looks_back(plan) + 1) * mean + plan.schedule.period + time_out(plan)
    tiny = 1e-6 * plan.problem.step
    taken = taken if taken is not None and taken.times.size else None
    late = plan.problem.timing_tolerance
    # a sample of the plan that may be as late as the record's first one may be that one
    until = now + tiny if taken is None else float(taken.times[0]) - max(late.late) - tiny
    wider = settled_from_start(plan, until - span, soon=soon) if until >= span else np.inf
    if wider == np.inf:
        followed = from_start(plan, until, plan.clock)
    else:
        times, measured = planned(plan, until - span, until, plan.clock)
        followed = SampleSequence.of(plan.problem, times, measured, _unchanged(plan, times), plan.clock)
        followed = replace(followed, wider=wider)
    if taken is None:
        return followed
    followed = followed.until(int(np.sum(followed.times < until)))
    times = np.concatenate([followed.times, taken.times])
    measured = np.concatenate([followed.measured, taken.measured])
    count = first = len(followed.times)
    enough = until + (taken.times.size + 2) * plan.schedule.period  # as many of the plan's as there are in the record
    wanted = planned(plan, until, min(now + tiny, enough), plan.clock)
    for t, mask, planned_at, meant in zip(taken.times, taken.measured, *wanted, strict=False):
        if late.shift or abs(t - planned_at) > tiny or not np.array_equal(mask, meant):
            break  # where samples may be late, the plan's own is about its centre
        first += 1
    first = 0 if followed.begins else min(first, _unchanged(plan, times))
    sides = np.concatenate([followed.sides, np.zeros((len(taken.times), 2, plan.plant.n_outputs))])
    come = result_times(plan, count, taken, now)
    return replace(followed, times=times, measured=measured, first=first, known_sides=sides, result_times=come)


def _unchanged(plan: Plan, times: Array) -> int:
    """How many samples there are before the clocks are first changed between them."""
    changed = np.flatnonzero(np.abs(np.diff(plan.clock.clock_time(times) - times)) > 1e-6 * plan.problem.step)
    return int(changed[0]) + 1 if changed.size else times.size
