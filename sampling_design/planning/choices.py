"""What may be measured next, and what comes of it: judged in floats from now on, and proven."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from sampling_design.planning.dates import plan_dates
from sampling_design.planning.deadline import GoalDeadline, exceeded_since, first_deadline, kept_from, reached_at
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.sequence import proven_ratio, settling_time, worst_ratio
from sampling_design.planning.sequence_deviation import SampleSequence, departs_and_returns, is_apart, planned, too_soon
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.schedules.opening import PlanClock

Option = tuple[float, Mask]

NEAR = 0.998  # a time is taken if floats say at most this share of the tolerance; the proof afterwards decides
TRIES = 12  # times proven, each a step of the grid earlier than the one before, until one is
SAME = 1e-9  # times are the same if they differ by less than this share of a step


@dataclass(frozen=True)
class NextAnswer:
    """One choice, and from when on every tolerance is kept after it."""

    t: float
    mask: Mask
    kept_from: float
    ratio: float
    proven: bool


class NextChoices:
    """The choices for the next sample of a plan, after a history; once the budget is over, what was found by then.

    Where answers are to be proven, what floats say of one is then left at that: the proof decides.
    """

    def __init__(
        self, plan: Plan, history: SampleSequence, now: float, budget: Budget = ENDLESS, *, prove: bool = True
    ):
        self.budget, self.plan, self.history, self.now, self.clock = budget, plan, history, now, plan.clock
        self.prove, self._looks = prove, budget if prove else ENDLESS
        self.level = max(NEAR, plan.ratio)
        self._known: dict[tuple[float, bytes], float] = {}
        self._ratios: dict[tuple[float, bytes, bytes], float] = {}
        self._chosen: dict[tuple[float, bytes], SampleSequence] = {}
        self._options: dict[int | None, list[Option]] = {}
        self._deadlines: dict[tuple[int | None, float], GoalDeadline | None] = {}
        self._after: dict[float, list[tuple[Array, Mask, PlanClock]]] = {}
        self._added: dict[int, list[Option]] = {}

    def exceeded(self, known: Mapping[str, float]) -> GoalDeadline | None:
        """The goal that is above its tolerance now for longest, and since when; none that is known well enough now."""
        within = {g.name for g in self.plan.goals if g.at == "all times" and known[g.name] <= g.tolerance}
        return exceeded_since(self.plan, self.history, self.now, within)

    def options(self, sensor: int | None) -> list[Option]:
        """Allowed times of the grid over a period, the first that keeps the spacing on; with what is read then.

        One sensor, or those that the plan reads.
        """
        if sensor not in self._options:
            self._options[sensor] = self._listed(sensor)
        return self._options[sensor]

    def _listed(self, sensor: int | None) -> list[Option]:
        problem, step = self.plan.problem, self.plan.problem.step
        read = self.history.times[self.history.measured.any(axis=1)]  # the plan's start alone is no sample
        spaced = float(np.max(read, initial=-np.inf)) + (problem.spacing - 1) * step  # the first may be a step later
        begun = float(self.history.times[-1]) - step / 2  # nothing is known before: the start itself may be one
        first = int(np.floor(float(self.clock.clock_time(max(self.now, spaced, begun))) / step + 1e-6)) + 1
        found = []
        for i, t in enumerate(self.clock.elapsed(np.arange(first, first + problem.steps) * step).tolist(), first):
            allowed = self.allowed(i)
            mask = (
                self.planned_sensors(i) & allowed if sensor is None else allowed & (np.arange(allowed.size) == sensor)
            )
            mask = allowed if sensor is None and not mask.any() else mask
            later = t > self.now + 1e-6 * step and mask.any()
            if later and is_apart(problem, self.history.times, self.history.measured, t, mask):
                found.append((t, mask))
        return found

    def allowed(self, i: int) -> Mask:
        """What may be measured at a step of the clock since the start; holidays and skipped hours are left out."""
        problem = self.plan.problem
        mask = problem.allowed[i % problem.steps] & self.plan.chosen.any(axis=0)
        return np.asarray(mask if self.is_open(i * problem.step) else np.zeros_like(mask))

    def is_open(self, clock: float) -> bool:
        """Whether a clock time is within the hours of the place, on no closed day, and not skipped."""
        calendar = self.plan.requirement.calendar
        return calendar is None or calendar.is_open(self.plan.minutes(clock), holidays=True)

    def planned_sensors(self, i: int) -> Mask:
        """What the plan's sample at a step, or the next one after it, measures."""
        steps = self.plan.problem.steps
        at = np.flatnonzero(self.plan.chosen.any(axis=1))
        following = at[np.argmin((at - i) % steps)]
        return np.asarray(self.plan.chosen[following])

    def followed(self, start: float) -> list[tuple[Array, Mask, PlanClock]]:
        """The plan's samples from a time on until all that is over, and the clock that they keep to.

        Without those on closed days; where there are such, also with the samples that `plan_dates` adds for them.
        """
        if start in self._after:
            return self._after[start]
        plan = self.plan
        span = settling_time(plan)
        times, measured = planned(plan, start, start + span, self.clock)
        clock = replace(self.clock, until=float(times[-1]))
        local = clock.clock_time(times)
        odd = ~np.array([self.is_open(t) for t in local.tolist()], dtype=bool)
        closed = odd.any()
        odd[1:] |= np.abs(np.diff(local - times)) > SAME * plan.problem.step  # the first after a change of the clocks
        if not odd.any():
            self._after[start] = [(times, measured, clock)]
            return self._after[start]
        last = float(times[odd][-1])
        times, measured = planned(plan, start, last + span, clock)
        local = clock.clock_time(times).tolist()
        keep = np.array([t > last or self.is_open(c) for t, c in zip(times.tolist(), local, strict=True)], dtype=bool)
        ways = [(times[keep], measured[keep], clock)]
        dated = self._dated(last) if closed else []
        more = [(t, mask) for t, mask in dated if start <= t <= last + plan.schedule.period]
        if more:
            both = np.concatenate([times[keep], [t for t, _ in more]])
            order = np.argsort(both, kind="stable")
            masks = np.concatenate([measured[keep], np.array([mask for _, mask in more])])
            ways.append((both[order], masks[order], clock))
        self._after[start] = ways
        return ways

    def _dated(self, last: float) -> list[Option]:
        """Times and sensors of the samples that are added for closed days up to one of them."""
        names = self.plan.plant.outputs.names
        periods = max(1, int(np.ceil(float(self.clock.clock_time(last)) / self.plan.schedule.period)) + 1)
        if last < 0:
            return []
        if periods not in self._added:
            self._added[periods] = [
                (entry.time, np.isin(names, entry.outputs))
                for entry in plan_dates(self.plan, periods, prove=False).entries
                if entry.added
            ]
        return self._added[periods]

    def judged_until(self, t: float) -> float:
        """The first closed day with a sample of the plan that lies so far behind one at t that it is not judged."""
        calendar, plan = self.plan.requirement.calendar, self.plan
        span = settling_time(plan)
        day = 1440 / plan.minutes(1.0)
        if calendar is None:
            return np.inf
        for each in calendar.holidays:
            clock = (datetime.fromisoformat(each) - calendar.first) / timedelta(minutes=1) / plan.minutes(1.0)
            begins, ends = self.clock.elapsed([clock, clock + day]).tolist()
            times = planned(plan, max(begins, t + span), ends, self.clock)[0]
            if times.size:
                return float(times[0])
        return np.inf

    def sequences(self, choice: Option) -> Iterator[SampleSequence]:
        """History, the sample, and the plan afterwards (spacings kept), as it may be followed."""
        t, mask = choice
        step = self.plan.problem.step
        resume = t + max(self.plan.problem.spacing - 1e-6, 1e-6) * step
        for times, measured, clock in self.followed(resume):
            every = np.concatenate([self.history.times, [t], times])
            masks = np.concatenate([self.history.measured, mask[None], measured])
            keep = ~too_soon(self.plan.problem, every, masks, len(self.history.times) + 1)
            yield replace(self.history, times=every[keep], measured=masks[keep], clock=clock, since=self.now)

    def sequence(self, choice: Option) -> SampleSequence:
        """The best of them, as far as is known."""
        key = self._key(choice)
        return self._chosen[key] if key in self._chosen else next(self.sequences(choice))

    def _key(self, choice: Option) -> tuple[float, bytes]:
        return choice[0], choice[1].tobytes()

    def _until(self, sequence: SampleSequence) -> float:
        """When it is no longer worth looking: one and a half periods after the last change."""
        back = max(departs_and_returns(self.plan, sequence)[1], len(self.history.times))
        return float(sequence.times[min(back, len(sequence.times) - 1)]) + 1.5 * self.plan.schedule.period

    def ratio(self, choice: Option, above: float = np.inf) -> float:
        """Accuracy over tolerance from now on if this is the next sample."""
        if not np.isfinite(choice[0]):
            return np.inf
        key = self._key(choice)
        if key not in self._known:
            self._known[key] = np.inf
            for sequence in self.sequences(choice):
                found = worst_ratio(self.plan, sequence, above, self._until(sequence), budget=self._looks)
                if found < self._known[key]:
                    self._known[key], self._chosen[key] = found, sequence
                if found <= self.level:
                    break
        return self._known[key]

    def keeps(self, choice: Option) -> bool:
        """Whether every tolerance is kept from now on if this is the next sample, as floats say."""
        return self.ratio(choice, self.level) <= self.level

    def _keeps_in_time(self, choice: Option) -> bool:
        """The same, unless the budget was over before all of it was looked at."""
        return self.keeps(choice) and not self.budget.over

    def latest(self, sensor: int | None) -> Option:
        """The latest option that keeps the tolerances: doubling, then halving; one by one where that finds none."""
        last, period = float(self.history.times[-1]), self.plan.schedule.period
        alone = reached_at(self.plan, self.history, self.now, max(self.now, last) + period, self.level, self._looks)
        options = [option for option in self.options(sensor) if option[0] < alone]
        if not options:
            return self._nothing
        good = self._planned_option(options) if sensor is None else 0
        if not self.keeps(options[good]):
            return next((option for option in reversed(options) if self._keeps_in_time(option)), self._nothing)
        at, bad, width = good + 1, len(options), 1
        while at < len(options) and not self.budget.over:
            if not self._keeps_in_time(options[at]):
                bad = at
                break
            good, at, width = at, at + width, 2 * width
        while bad - good > 1 and not self.budget.over:
            middle = (good + bad) // 2
            good, bad = (middle, bad) if self._keeps_in_time(options[middle]) else (good, middle)
        return options[good]

    @property
    def _nothing(self) -> Option:
        return -np.inf, np.zeros(self.plan.plant.n_outputs, dtype=bool)

    def _planned_option(self, options: list[Option]) -> int:
        """Which option is the plan's next sample; the first one where the place is closed then."""
        step = self.plan.problem.step
        planned_times = planned(self.plan, options[0][0] - step / 2, options[-1][0] + step / 2, self.clock)[0]
        times = np.array([t for t, _ in options])
        same = np.flatnonzero(
            np.min(np.abs(times[:, None] - planned_times[None, :]), axis=1, initial=np.inf) < step / 4
        )
        return int(same[0]) if same.size else 0

    def answer(self, sensor: int | None) -> NextAnswer:
        """The latest option, proven if asked: earlier ones, at growing steps, until the proof holds, then between."""
        choice = self.latest(sensor)
        ratio, options = self.ratio(choice), self.options(sensor)
        if np.isfinite(choice[0]) and not self.prove:
            return NextAnswer(*choice, self.now, ratio, False)
        place = next((k for k, option in enumerate(options) if option[0] == choice[0]), -1)
        kept, broken, step, found = -1, place + 1, 1, NextAnswer(*self._nothing, np.inf, ratio, False)
        while place > kept:
            self.ratio(options[place], self.level)
            ratio = self._proven(self.sequence(options[place]))
            if ratio <= 1:
                kept, found = place, NextAnswer(*options[place], self.now, ratio, True)
            else:
                broken = place
            if self.budget.over:
                break
            if kept < 0 < place:
                place, step = max(0, place - step), 2 * step
            else:
                place = (max(kept, 0) + broken) // 2 if kept >= 0 else kept
        return found if found.proven else replace(found, ratio=ratio)

    def _proven(self, sequence: SampleSequence) -> float:
        """Accuracy over tolerance that is proven of a sequence, once."""
        key = sequence.since, sequence.times.tobytes(), sequence.measured.tobytes()
        if key not in self._ratios:
            self._ratios[key] = proven_ratio(self.plan, sequence, budget=self.budget)
        return self._ratios[key]

    def soonest(self) -> NextAnswer:
        """The choice after which every tolerance is kept again soonest; of those the plan's own, else the latest.

        With every sensor of the plan, unless those that it reads then do as well.
        """
        own = self.options(None)
        if not own:
            return NextAnswer(*self._nothing, np.inf, np.inf, False)
        tiny = SAME * self.plan.problem.step
        best = own[self._planned_option(own)]
        planned_ = kept = self._kept(best, np.inf)
        for t, _ in own:
            if t > kept + tiny or self.budget.over:
                break
            option = t, self.allowed(round(float(self.clock.clock_time(t)) / self.plan.problem.step))
            found = self._kept(option, kept + tiny)
            if found < planned_ - tiny and found <= kept + tiny:
                best, kept = option, found
        lean = next(option for option in own if option[0] == best[0])
        if not np.array_equal(lean[1], best[1]) and self._kept(lean, kept + tiny) <= kept + tiny:
            best = lean
        return self._again(best, kept)

    def _kept(self, choice: Option, latest: float) -> float:
        """From when on every tolerance is kept if this is the next sample, as floats say."""
        key, found = self._key(choice), np.inf
        for sequence in self.sequences(choice):
            kept = kept_from(self.plan, sequence, self._until(sequence), self.level, min(latest, found), self._looks)
            if kept < found:
                found, self._chosen[key] = kept, sequence
        return found

    def _again(self, choice: Option, kept: float) -> NextAnswer:
        """The same, proven if asked from a sample to the next until the proof holds."""
        sequence = self.sequence(choice)
        if not np.isfinite(kept):
            return NextAnswer(*self._nothing, np.inf, np.inf, False)
        sequence = replace(sequence, since=kept)
        if not self.prove:
            return NextAnswer(*choice, kept, worst_ratio(self.plan, sequence, until=self._until(sequence)), False)
        ratio = np.inf
        for since in [kept, *sequence.times[sequence.times > kept][: TRIES - 1].tolist()]:
            ratio = self._proven(replace(sequence, since=since))
            if ratio <= 1:
                return NextAnswer(*choice, since, ratio, True)
            if self.budget.over:
                break
        return NextAnswer(*self._nothing, np.inf, ratio, False)

    def later(self, sensor: int | None, latest: float) -> GoalDeadline | None:
        """What keeps the next sample from coming at the first option after the latest; None without such an option."""
        after = [option for option in self.options(sensor) if option[0] > latest]
        t = after[0][0] if after else np.inf
        if not after or (self.budget.over and (sensor, t) not in self._deadlines):
            return None
        if (sensor, t) not in self._deadlines:
            self._deadlines[sensor, t] = self.breach(after[0])
        return self._deadlines[sensor, t]

    def breach(self, choice: Option) -> GoalDeadline | None:
        """Which goal reaches its tolerance after a choice, and when."""
        if not np.isfinite(choice[0]) or self.budget.over:
            return None
        sequence = self.sequence(choice)
        return first_deadline(self.plan, sequence, self._until(sequence))

    def best(self, latest: Option) -> Option:
        """Of the options up to the latest, the one after which the worst accuracy is least."""
        options = [option for option in self.options(None) if option[0] <= latest[0]]
        if not options:
            return latest
        few = [options[k] for k in np.unique(np.round(np.linspace(0, len(options) - 1, 8)).astype(int))]
        judged = [(round(self.ratio(option), 3), -option[0], option) for option in few if not self.budget.over]
        return min(judged, key=lambda one: one[:2])[2] if judged else latest
