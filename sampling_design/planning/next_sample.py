"""The next sample: the latest time that keeps the tolerances now and leaves the plan able to keep them afterwards."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._door import door
from sampling_design._record import Plain, Record, short
from sampling_design.errors import ArgumentError
from sampling_design.planning.due import GoalDue, first_due
from sampling_design.planning.opening import WEEK
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.sequence import looks_back, proven_ratio, settles, worst_ratio
from sampling_design.planning.spread_sequence import SampleSequence, planned
from sampling_design.recovery.readings import told

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

NEAR = 0.998
"""A time is taken if floats say at most this share of the tolerance; the proof afterwards decides."""

TRIES = 12
"""Times proven, each a step of the raster earlier than the one before, until one is."""


@dataclass(frozen=True, eq=False, repr=False)
class NextSample(Record):
    """When to sample next, at the latest.

    Attributes
    ----------
    plan : Plan
    now : float
        [the plant's time unit] since the start of the plan.
    latest : float
        With the sensors `outputs`; after it the plan's own times follow. -inf: no time keeps the tolerances any more.
    outputs : tuple of str
    alone : dict of str to float
        For each sensor of the plan, the latest time if that sensor is all that is read then.
    best : float
        The time up to `latest`, with `best_outputs`, after which the worst accuracy is least.
    ratio : float
        What is proven of `latest`: accuracy over tolerance, from now on and for ever after.
    proven : bool
    due : GoalDue or None
        What keeps the sample from coming at the next allowed time after `latest`: which goal reaches its tolerance
        first if it does, and when. None if it may come at any time of a whole period.
    alone_due : dict of str to GoalDue
        The same for each sensor alone.
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
    due: GoalDue | None = None
    alone_due: dict[str, GoalDue] = field(default_factory=dict)

    def date(self, t: float) -> datetime | None:
        """Local date of a time, where the plan has a calendar."""
        calendar = self.plan.requirement.calendar
        return None if calendar is None or not np.isfinite(t) else calendar.instant(self.plan.minutes(t))

    def when(self, t: float, since: float | None = None) -> str:
        """A time in words: local where there is a calendar; with no more of its date than one needs after `since`."""
        if not np.isfinite(t):
            return "never"
        date, before = self.date(t), None if since is None else self.date(since)
        if date is None:
            return f"{short(t)} {self.plan.plant.time_unit}"
        near = before is not None and (date.date() - before.date()).days < WEEK
        return f"{date:%a %H:%M}" if near else f"{date:%a %d %b %H:%M}"

    def _beside(self, t: float) -> str:
        """A time in words next to the latest: on the same day its hour alone."""
        date, latest = self.date(t), self.date(self.latest)
        same = date is not None and latest is not None and date.date() == latest.date()
        return f"{date:%H:%M}" if same else self.when(t, self.now)

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("now", self.when(self.now)), ("latest", self._told(self.latest, self.outputs))]
        rows += [("later", self._later(self.due))] if self.due else []
        for name, t in self.alone.items():
            more = f"; later: {self._later(self.alone_due[name])}" if name in self.alone_due else ""
            rows += [(f"{name} alone", f"by {self.when(t)}{more}")] if np.isfinite(t) else []
        rows += [("best", self._told(self.best, self.best_outputs))] if np.isfinite(self.best) else []
        return [*rows, ("of the tolerance", f"{short(self.ratio, 4)} {'proven' if self.proven else '(not proven)'}")]

    def _later(self, due: GoalDue) -> str:
        """What a later sample would do, in words."""
        if due.breaks:
            return f"{due.goal} reaches its tolerance by {self.when(due.time, self.now)}"
        share = f"{short(due.ratio, 4)} of its tolerance"
        return f"{due.goal} comes to {share} by {self.when(due.time, self.now)}, and more is not ruled out"

    def _told(self, t: float, outputs: tuple[str, ...]) -> str:
        """A time and what is read then."""
        return ", ".join([self.when(t), *(outputs if np.isfinite(t) else ())])

    def explain(self) -> str:
        """Say when to sample."""
        if not np.isfinite(self.latest):
            after = f" ({short(self.ratio, 4)} of them after the last one tried)" if np.isfinite(self.ratio) else ""
            text = f"No allowed sample is proven to keep the tolerances any more{after}: keep to the plan's next one"
            return f"{text}, or sample as soon as the place is open."
        alone = [
            f"{name} alone by {self._beside(t)}"
            for name, t in self.alone.items()
            if np.isfinite(t) and (name,) != self.outputs
        ]
        by = "at" if self.plan.problem.spacing > 1 else "by"
        first = f"Next draw {by} {self.when(self.latest, self.now)} ({', '.join(self.outputs)})"
        later = f" At the next allowed time after that {self._later(self.due)}." if self.due else ""
        return "; ".join([first, *alone]) + "." + later

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""

        def plain(t: float) -> Plain:
            date = self.date(t)
            return {"time": t if np.isfinite(t) else None, "date": None if date is None else date.isoformat()}

        def due(found: GoalDue | None) -> Plain:
            if found is None:
                return None
            return {"goal": found.goal, "ratio": found.ratio, "when": plain(found.time)}

        return {
            "now": plain(self.now),
            "latest": plain(self.latest),
            "outputs": list(self.outputs),
            "due": due(self.due),
            "alone": {name: plain(t) for name, t in self.alone.items()},
            "alone_due": {name: due(self.alone_due.get(name)) for name in self.alone},
            "best": plain(self.best),
            "best_outputs": list(self.best_outputs),
            "ratio": self.ratio if np.isfinite(self.ratio) else None,
            "proven": self.proven,
        }


@door
def next_sample(
    plan: Plan,
    record: Iterable[tuple[float, npt.ArrayLike | None, npt.ArrayLike | None]] | None = None,
    *,
    now: float | None = None,
    prove: bool = True,
) -> NextSample:
    """Return the latest time of the next sample after which the plan still keeps every tolerance, for ever.

    Parameters
    ----------
    plan : Plan
        Whose tolerances are kept.
    record : Measurements or iterable of (t, y, u), optional
        What was measured since the plan began, in order [the plant's time unit since its start]; only the times and the
        outputs that are not NaN matter. Before its first sample, the plan was followed. Default: it was followed until
        `now`.
    now : float, optional
        Default: the last sample of the record, else 0.
    prove : bool
        Prove the answer by gains over all real times; else it rests on the search alone.

    Returns
    -------
    NextSample

    Raises
    ------
    ArgumentError
        If the plan does not keep its tolerances, or the record is not in order.

    Notes
    -----
    *Claim.* If a sample with `outputs` is taken at `latest`, and the plan's samples follow, no tolerance is broken from
    `now` on; so this may be asked again after that sample, and has an answer (induction). *The naive trigger*, which
    waits until the accuracy now reaches its tolerance, leaves states that no later sample can repair in time, and
    overshoots. Earlier than `latest` is as good where the plan has no spacing: it is one sample more; with spacing, a
    sample may push out one of the plan's. *Assumptions.* The bounds; values measured play no part, so that the answer
    holds whatever is read.

    References
    ----------
    Heemels, Johansson and Tabuada, An introduction to event-triggered and self-triggered control (2012).
    """
    if not plan.keeps:
        raise ArgumentError("`plan` must keep its tolerances: it does not, so there is nothing to go on keeping.")
    step = plan.problem.step
    taken = _taken(plan, record)
    last = taken[0][-1] if taken is not None and taken[0].size else 0.0
    at = float(last) if now is None else _checks.number("now", now)
    if taken is not None and taken[0].size and at < last - 1e-9 * step:
        raise ArgumentError(f"`now` must not lie before the last sample {float(last)!r}, got {at!r}.")
    history = _history(plan, taken, at)
    run = _Choice(plan, history, at)
    names = plan.plant.outputs.names
    full, ratio, proven = run.answer(None, prove)
    alone, alone_due = dict[str, float](), dict[str, GoalDue]()
    for j, name in enumerate(names):
        only = np.arange(len(names)) == j
        same = np.array_equal(full[1], only)
        if plan.chosen[:, j].any():
            alone[name] = full[0] if same else run.answer(j, prove)[0][0]
            why = run.later(None if same else j, alone[name])
            if why is not None:
                alone_due[name] = why
    best = run.best(full)
    return NextSample(
        plan=plan,
        now=at,
        latest=full[0],
        outputs=tuple(n for n, s in zip(names, full[1], strict=True) if s),
        alone=alone,
        best=best[0],
        best_outputs=tuple(n for n, s in zip(names, best[1], strict=True) if s),
        ratio=ratio,
        proven=proven,
        due=run.later(None, full[0]),
        alone_due=alone_due,
    )


def _taken(
    plan: Plan, record: Iterable[tuple[float, npt.ArrayLike | None, npt.ArrayLike | None]] | None
) -> tuple[Array, Mask] | None:
    """Times and outputs of a record."""
    if record is None:
        return None
    times: list[float] = []
    seen: list[Mask] = []
    for item in record:
        if not isinstance(item, (tuple, list)) or len(item) not in (2, 3):
            raise ArgumentError(f"`record` must hold rows (t, y, u), got {_checks.described(item)}.")
        plain, limits = told(item[1], plan.plant.n_outputs)
        y = None if plain is None else np.isfinite(_checks.floats("y", plain).reshape(-1))
        if y is None:
            continue
        y[[each.output for each in limits]] = True
        if not y.any():
            continue
        t = _checks.number("t", item[0])
        if y.size != plan.plant.n_outputs or (times and t <= times[-1]):
            raise ArgumentError(
                f"`record` must hold {plan.plant.n_outputs} outputs a sample, in order of time, got one at {t!r}."
            )
        times.append(t)
        seen.append(y)
    return np.array(times), np.array(seen).reshape(-1, plan.plant.n_outputs)


def _history(plan: Plan, taken: tuple[Array, Mask] | None, now: float) -> tuple[Array, Mask, int]:
    """Everything measured until now, and how much of it is the plan's."""
    mean = plan.schedule.period / len(plan.schedule)
    span = (looks_back(plan) + 1) * mean + plan.schedule.period
    tiny = 1e-6 * plan.problem.step
    if taken is None or not taken[0].size:
        times, seen = planned(plan, now - span, now + tiny)
        return times, seen, times.size
    first = float(taken[0][0])
    before = planned(plan, first - span, first - tiny)
    wanted = planned(plan, first - tiny, now + tiny)
    same = 0
    for t, mask, due, meant in zip(taken[0], taken[1], wanted[0], wanted[1], strict=False):
        if abs(t - due) > tiny or not np.array_equal(mask, meant):
            break
        same += 1
    times, seen = np.concatenate([before[0], taken[0]]), np.concatenate([before[1], taken[1]])
    return times, seen, before[0].size + same


class _Choice:
    """The choices for the next sample, judged in floats."""

    def __init__(self, plan: Plan, history: tuple[Array, Mask, int], now: float):
        self.plan, self.now = plan, now
        self.times, self.seen, self.same = history
        self.oracle = plan.oracle
        self._known: dict[tuple[int, bytes], float] = {}
        self._options: dict[int | None, list[tuple[float, Mask]]] = {}
        self._due_at: dict[tuple[int | None, float], GoalDue | None] = {}

    def options(self, sensor: int | None) -> list[tuple[float, Mask]]:
        """Allowed times of the raster after now, over a period, each with one sensor or those that the plan reads."""
        if sensor not in self._options:
            self._options[sensor] = self._listed(sensor)
        return self._options[sensor]

    def _listed(self, sensor: int | None) -> list[tuple[float, Mask]]:
        problem, step = self.plan.problem, self.plan.problem.step
        first = int(np.floor(self.now / step + 1e-6)) + 1
        found = []
        for i in range(first, first + problem.steps):
            allowed = self.allowed(i)
            mask = self.due(i) & allowed if sensor is None else allowed & (np.arange(allowed.size) == sensor)
            mask = allowed if sensor is None and not mask.any() else mask
            if self.times.size and i - self.times[-1] / step < problem.spacing - 1e-6:
                continue
            if mask.any():
                found.append((i * step, mask))
        return found

    def allowed(self, i: int) -> Mask:
        """What may be measured at a step since the start, holidays left out."""
        problem, calendar = self.plan.problem, self.plan.requirement.calendar
        mask = problem.allowed[i % problem.steps] & self.plan.chosen.any(axis=0)
        if calendar is not None and not calendar.is_open(self.plan.minutes(i * problem.step), holidays=True):
            return np.zeros_like(mask)
        return np.asarray(mask)

    def due(self, i: int) -> Mask:
        """What the plan's sample at a step, or the next one after it, measures."""
        steps = self.plan.problem.steps
        at = np.flatnonzero(self.plan.chosen.any(axis=1))
        following = at[np.argmin((at - i) % steps)]
        return np.asarray(self.plan.chosen[following])

    def sequence(self, t: float, mask: Mask) -> SampleSequence:
        """History, the sample, and the plan afterwards (its spacing kept)."""
        problem = self.plan.problem
        mean = self.plan.schedule.period / len(self.plan.schedule)
        span = settles(self.plan) * mean + self.plan.schedule.period
        resume = t + max(problem.spacing - 1e-6, 1e-6) * problem.step
        after = planned(self.plan, resume, t + span)
        times = np.concatenate([self.times, [t], after[0]])
        return SampleSequence(times, np.concatenate([self.seen, mask[None], after[1]]), self.same)

    def ratio(self, choice: tuple[float, Mask], above: float = np.inf) -> float:
        """Accuracy over tolerance if this is the next sample."""
        if not np.isfinite(choice[0]):
            return np.inf
        key = (round(choice[0] / self.plan.problem.step), choice[1].tobytes())
        if key not in self._known:
            until = choice[0] + 1.5 * self.plan.schedule.period
            self._known[key] = worst_ratio(self.plan, self.sequence(*choice), above, until)
        return self._known[key]

    def latest(self, sensor: int | None) -> tuple[float, Mask]:
        """The latest option that keeps the tolerances: doubling, then halving, then a step at a time."""
        options = self.options(sensor)
        nothing = -np.inf, np.zeros(self.plan.plant.n_outputs, dtype=bool)
        if not options:
            return nothing
        good, bad, width = -1, len(options), 1
        at = self._due(options) if sensor is None else 0
        if sensor is None:  # the plan's own next sample: if anything keeps the tolerances, it does (induction)
            if self.ratio(options[at]) > 1:
                return nothing
            good, at = at, at + 1
        while at < len(options):
            if self.ratio(options[at], NEAR) > NEAR:
                bad = at
                break
            good, at, width = at, at + width, 2 * width
        while bad - good > 1:
            middle = (good + bad) // 2
            good, bad = (middle, bad) if self.ratio(options[middle], NEAR) <= NEAR else (good, middle)
        return options[good] if good >= 0 else nothing

    def _due(self, options: list[tuple[float, Mask]]) -> int:
        """Which option is the plan's next sample; the first one where the place is closed then."""
        step = self.plan.problem.step
        due = planned(self.plan, options[0][0] - step / 2, options[-1][0] + step / 2)[0]
        times = np.array([t for t, _ in options])
        same = np.flatnonzero(np.min(np.abs(times[:, None] - due[None, :]), axis=1, initial=np.inf) < step / 4)
        return int(same[0]) if same.size else 0

    def answer(self, sensor: int | None, prove: bool) -> tuple[tuple[float, Mask], float, bool]:
        """The latest option, proven if asked: a step of the raster earlier at a time until the proof holds."""
        choice = self.latest(sensor)
        if not prove or not np.isfinite(choice[0]):
            return choice, self.ratio(choice), False
        options, ratio = self.options(sensor), np.inf
        place = next(k for k, option in enumerate(options) if option[0] == choice[0])
        for option in options[place::-1][:TRIES]:
            ratio = proven_ratio(self.plan, self.sequence(*option))
            if ratio <= 1:
                return option, ratio, True
        return (-np.inf, np.zeros(self.plan.plant.n_outputs, dtype=bool)), ratio, False

    def later(self, sensor: int | None, latest: float) -> GoalDue | None:
        """What keeps the next sample from coming at the first option after the latest; None without such an option."""
        after = [option for option in self.options(sensor) if option[0] > latest]
        if not after:
            return None
        t, mask = after[0]
        if (sensor, t) not in self._due_at:
            sequence = self.sequence(t, mask)
            self._due_at[sensor, t] = first_due(self.plan, sequence, t + 1.5 * self.plan.schedule.period)
        return self._due_at[sensor, t]

    def best(self, latest: tuple[float, Mask]) -> tuple[float, Mask]:
        """Of the options up to the latest, the one after which the worst accuracy is least."""
        options = [option for option in self.options(None) if option[0] <= latest[0]]
        if not options:
            return latest
        few = [options[k] for k in np.unique(np.round(np.linspace(0, len(options) - 1, 8)).astype(int))]
        chosen: tuple[float, Mask] = min(few, key=lambda option: (round(self.ratio(option), 3), -option[0]))
        return chosen
