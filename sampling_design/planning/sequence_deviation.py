"""Sequences of samples that leave a plan for a while, and what the best filter makes of them.

A filter that starts from the plan's own covariance runs through the samples. Where it knows, at the end, at most a
times what the plan's does (as covariances), it never knows less than a times that: the recursion is monotone, and
scales with a factor above 1 at most.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from sampling_design.numerics.filtering import TINY, measurement_update, propagate
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.filter_deviation import PERIODS, SETTLED, WIDE, own
from sampling_design.planning.problem import WHOLE, PlanProblem, RowGoal
from sampling_design.planning.search_progress import SEQUENCE
from sampling_design.records.arrays import Array, Mask
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance, shift_of
from sampling_design.schedules.opening import PlanClock
from sampling_design.schedules.schedule import PeriodicSchedule

DAY = 1440.0  # minutes by which clocks are never put forward or back
OFFSETS = 24  # offsets of a gap at which a standard deviation is worked out, its end among them
BETWEEN = 1 + 1e-4  # share by which it may be larger between them
GRAIN = 1e-9  # lengths are the same if they differ by less than this share of a step of the grid
FORGOTTEN = 1e-4  # a filter has forgotten what it was started with where that changes it by no more than this share
ORDINARY: PlanClock = PlanClock()  # clocks that are never changed


@dataclass(frozen=True, eq=False)
class SampleSequence:
    """Sample times [the plant's time unit], what each measures, and the first that may differ from the plan."""

    times: Array  # (K,): real times: what lies between two of them has passed, whatever the clocks showed
    measured: Mask  # (K, p)
    first: int  # index of the first sample that the plan does not have, or has otherwise, or after another gap
    clock: PlanClock = ORDINARY  # what the plan's clocks show at these times
    begins: bool = False
    """Whether the plan starts at the first time, where its requirement says what is known; else it was followed."""
    wider: float = 1.0
    """Before the first change, or at the first sample, the error is at most so many times what the plan followed for
    ever leaves of it."""
    since: float = -np.inf
    """Nothing is judged before this time, though all that was measured then counts."""
    late: TimingTolerance = ON_TIME
    """How early or late a reading of each output may be."""
    known_sides: Array = field(default_factory=lambda: np.zeros((0, 2, 1)))
    """How early and how late (k, 2, p) those of the first samples may be, if otherwise: 0 where the time is known."""
    result_delay: Array | None = None
    """How long after its sample a result of each output comes at most (p,); None: at once."""
    result_times: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Of the first samples, when each result was in (k, p); NaN where it is not yet, or `result_delay` says it."""

    @classmethod
    def of(
        cls, problem: PlanProblem, times: Array, measured: Mask, first: int, clock: PlanClock = ORDINARY
    ) -> SampleSequence:
        """A sequence whose readings are as early or late, and whose results come as late, as those of a plan."""
        late, delay = problem.timing_tolerance, problem.result_delay
        return cls(times, measured, first, clock, late=late, result_delay=delay)

    @cached_property
    def clock_times(self) -> Array:
        """The times on the plan's clocks (K,)."""
        return self.clock.clock_time(self.times)

    @cached_property
    def sides(self) -> Array:
        """How early and how late a reading of each output of each sample may be (K, 2, p)."""
        (count, p), both = self.measured.shape, np.array([self.late.early, self.late.late])
        found = np.tile(np.broadcast_to(both, (2, p)), (count, 1, 1))
        known = min(len(self.known_sides), count)
        found[:known] = self.known_sides[:known]
        return found

    @cached_property
    def shift(self) -> Array:
        """How long after its planned time the centre of each sample lies (K,), as that of a `TimingTolerance`."""
        return shift_of(self.sides[:, 0], self.sides[:, 1])

    @cached_property
    def centres(self) -> Array:
        """About when each sample is read (K,): from `back` before to `forward` after it."""
        return np.asarray(self.times + self.shift)

    @property
    def back(self) -> Array:
        """(K, p): how long before its centre each output of a sample may be read."""
        return np.asarray(self.sides[:, 0] + self.shift[:, None])

    @property
    def forward(self) -> Array:
        """(K, p): how long after its centre each output of a sample may be read."""
        return np.asarray(self.sides[:, 1] - self.shift[:, None])

    @cached_property
    def taken_by(self) -> Array:
        """When each sample is taken, all that it measures, at the latest (K,)."""
        return np.asarray(self.times + np.max(self.sides[:, 1], axis=1, where=self.measured, initial=0.0))

    @property
    def in_parts(self) -> bool:
        """Whether what a sample measures may come in one after the other."""
        return self.result_delay is not None or bool(np.ptp(self.late.late))

    def comes_after(self, readable: Mask | np.bool_, *, late: bool) -> Array:
        """How long after its sample each result that tells something (p,) is in (K, p); infinite where none is read.

        Where samples may be early or late (`late`), after their centres, at the latest; else after their planned times.
        """
        found = (
            np.zeros(self.measured.shape)
            if self.result_delay is None
            else np.tile(self.result_delay, (len(self.times), 1))
        )
        found = found + self.forward if late else found
        count = min(len(self.result_times), len(self.times))
        if count:
            known = self.result_times[:count] - (self.centres if late else self.times)[:count, None]
            found[:count] = np.where(np.isnan(known), found[:count], known)
        return np.where(self.measured & readable, found, np.inf)

    def until(self, count: int) -> SampleSequence:
        """The first so many samples."""
        return replace(self, times=self.times[:count], measured=self.measured[:count])

    @property
    def start(self) -> int:
        """Index of the sample before the first gap that is judged."""
        return max(self.first - 1, 0, self.taken(self.since))

    @property
    def judged_since(self) -> float:
        """Nothing that is over by this time is judged."""
        begun = float(self.taken_by[self.first - 1]) if self.first else -np.inf
        return max(begun, self.since) + self._tiny

    def taken(self, t: float) -> int:
        """Index of the last sample that is taken by a time, however late; -1 if there is none."""
        return int(np.searchsorted(self.taken_by - self._tiny, t, side="right")) - 1

    @property
    def _tiny(self) -> float:
        """Times closer than this are the same."""
        return GRAIN * float(self.times[-1] - self.times[0])

    def skipped(self, k: int) -> float:
        """How much of what follows the centre of a sample is not judged."""
        before = self.since - float(self.centres[k])
        return before if before > self._tiny else 0.0


def phase_of(schedule: PeriodicSchedule, t: float) -> int:
    """Which sample of the period is taken at a time of the plan."""
    phase = (t - schedule.times) / schedule.period
    return int(np.argmin(np.abs(phase - np.round(phase))))


def planned(plan: PlanFigures, start: float, stop: float, clock: PlanClock = ORDINARY) -> tuple[Array, Mask]:
    """The plan's samples in [start, stop): real times by a clock, without those that it skips or that come too soon."""
    schedule, period, problem = plan.schedule, plan.schedule.period, plan.problem
    longest = max(problem.spacing, int(problem.sensor_spacing.max())) * problem.step
    more = 0.0 if clock.calendar is None else DAY / clock.minutes + longest
    periods = np.arange(np.floor((start - more) / period), np.ceil((stop + more) / period) + 1) * period
    times = (periods[:, None] + schedule.times[None, :]).ravel()
    measured = np.tile(plan.chosen[plan.chosen.any(axis=1)], (periods.size, 1))
    near = (times >= start - more - GRAIN * period) & (times < stop + more)
    times, measured = times[near], measured[near]
    real = clock.elapsed(times)
    keep = (real >= start - GRAIN * period) & (real < stop - GRAIN * period)
    shows = np.abs(clock.clock_time(real) - times) < GRAIN * period
    if clock.calendar is not None:
        shows[np.flatnonzero(shows)[too_soon(problem, real[shows], measured[shows])]] = False
    return real[keep & shows], measured[keep & shows]


def sequence_from_start(plan: PlanFigures, times: Array, measured: Mask, clock: PlanClock = ORDINARY) -> SampleSequence:
    """The plan from its start at time 0 on, with samples at real times (K,).

    One whose centre would not lie after the start comes between that and the latest that it may, about their middle.
    """
    late, p = plan.problem.timing_tolerance, plan.plant.n_outputs
    known_sides = np.zeros((0, 2, p))
    if late and times.size and times[0] + late.shift <= 0:
        first, after = float(times[0]), np.broadcast_to(late.late, p)
        before = np.minimum(np.broadcast_to(late.early, p), first)
        middle = first + (after.max() - before.max()) / 2
        known_sides = np.maximum([[middle - first + before, first + after - middle]], 0.0)
        times = np.append(middle, times[1:])
    if not times.size or times[0] > 0:
        times, known_sides = np.append(0.0, times), np.concatenate([np.zeros((1, 2, p)), known_sides])
        measured = np.concatenate([np.zeros((1, p), dtype=bool), measured])
    whole = SampleSequence.of(plan.problem, times, measured, 0, clock)
    return replace(whole, begins=True, known_sides=known_sides)


def too_soon(problem: PlanProblem, times: Array, measured: Mask, taken: int = 0) -> Mask:
    """Which samples at real times (K,) come sooner after those before them, of all or of a sensor, than spacings allow.

    Where clocks are put forward less time passes than they show. What comes too soon is not taken, but for the first
    `taken`, which were. A time at which nothing is read keeps none away.
    """
    found, last, read = np.zeros(times.size, dtype=bool), -np.inf, np.full(measured.shape[1], -np.inf)
    if max(problem.spacing, int(problem.sensor_spacing.max())) <= 1:
        return found
    least, apart = ((np.asarray(s) - WHOLE) * problem.step for s in (problem.spacing, problem.sensor_spacing))
    for k, t in enumerate(times.tolist()):
        found[k] = k >= taken and (t - last < least or bool(np.any(t - read[measured[k]] < apart[measured[k]])))
        if not found[k] and measured[k].any():
            last, read[measured[k]] = t, t
    return found


def is_apart(problem: PlanProblem, times: Array, measured: Mask, t: float, mask: Mask) -> bool:
    """Whether a sample at a real time t keeps the spacings to all those at real times (K,) that read something."""
    off = np.where(measured.any(axis=1), np.abs(times - t), np.inf)
    shared = np.where(measured & mask, off[:, None], np.inf).min(axis=0, initial=np.inf)
    least = np.min(off, initial=np.inf) >= (problem.spacing - WHOLE) * problem.step
    return bool(least and np.all(shared >= (problem.sensor_spacing - WHOLE) * problem.step))


def departs_and_returns(plan: PlanFigures, sequence: SampleSequence) -> tuple[int, int]:
    """Index of the first sample that is not the plan's after the plan's gap, and from which on all are."""
    period, schedule = plan.schedule.period, plan.schedule
    off = (sequence.clock_times[:, None] - schedule.times) / period
    off = np.abs(off - np.round(off))
    phase = np.argmin(off, axis=1)
    own = (off.min(axis=1) <= GRAIN) & np.all(sequence.measured == plan.chosen[plan.chosen.any(axis=1)][phase], axis=1)
    follows = own[1:] & own[:-1] & (phase[1:] == (phase[:-1] + 1) % len(schedule))
    follows &= np.abs(np.diff(sequence.times) - schedule.gaps[phase[1:]]) <= GRAIN * period  # gaps[j]: before sample j
    other = np.flatnonzero(~follows) + 1
    return (int(other[0]), int(other[-1])) if other.size else (len(own), 0)


def asked(
    plan: PlanFigures, sequence: SampleSequence, k: int, goal: RowGoal, span: tuple[float, float] | None = None
) -> list[float]:
    """Offsets after a sample, in its gap or a `span`, at which a goal of given times must hold on the plan's clock."""
    if goal.at != "given times":
        return []
    problem, start = plan.problem, float(sequence.centres[k])
    begin, stop = sequence.taken_by[k : k + 2] - start if span is None else span
    clock_times = sequence.clock_times[k] + sequence.shift[k] + np.array([0.0, stop])
    phases = np.round(goal.steps) * problem.step
    periods = (
        np.arange(np.floor(clock_times[0] / problem.period), np.ceil(clock_times.max() / problem.period) + 2)
        * problem.period
    )
    offsets = np.sort(sequence.clock.elapsed((periods[:, None] + phases[None, :]).ravel())) - start
    tiny = 1e-9 * problem.period
    inside = offsets[(offsets >= begin - tiny) & (offsets <= stop + tiny)]
    return np.clip(inside, begin, stop).tolist()  # type: ignore[no-any-return]


class SequenceFilter:
    """The filter of one plan's standard deviations, through samples that are not all the plan's."""

    def __init__(self, plan: PlanFigures):
        self.plan = plan
        discrete = plan.oracle.discrete
        self.A, self.noise, self.S = discrete.A, discrete.N @ discrete.N.T, discrete.S
        rows = plan.oracle.rows
        self.goals = [(goal, rows[g] / goal.tolerance) for g, goal in enumerate(plan.goals) if goal.stochastic]
        self._known: dict[bytes, tuple[Array, Array]] = {}
        self._run: tuple[SampleSequence, float, list[tuple[int, Array]]] | None = None
        """The last sequence that was followed, until when, and what came of it."""

    @property
    def usual(self) -> float:
        """What the plan itself reaches of its tolerances."""
        pairs = zip(self.plan.reached.tolist(), self.plan.goals, strict=True)
        return float(max(r / g.tolerance for r, g in pairs if g.stochastic))

    def _flows(self, lengths: Array) -> tuple[Array, Array]:
        """Flows over lengths, and the noise that joins; worked out once."""
        key = np.round(lengths / (GRAIN * self.plan.problem.step)).tobytes()
        if key not in self._known:
            self._known[key] = discounted_flow(self.A, self.noise, lengths)
        return self._known[key]

    def _flow(self, P: Array, length: float) -> Array:
        F, W = self._flows(np.array([length]))
        return propagate(P, F[0], W[0])

    @cached_property
    def limits(self) -> Array:
        """Covariances after each sample of the plan, in the periodic limit; `back` is found on the way."""
        return self._limits[0]

    @property
    def back(self) -> int:
        """Samples after which the filter has forgotten what it was started with."""
        return self._limits[1]

    @cached_property
    def _limits(self) -> tuple[Array, int]:
        schedule = self.plan.schedule
        masks = self.plan.chosen[self.plan.chosen.any(axis=1)]
        P, last, back = np.eye(len(self.A)) * WIDE, np.zeros(0), 0
        for period in range(PERIODS):
            after = []
            for mask, gap in zip(masks, np.roll(schedule.gaps, -1), strict=True):  # gaps[j] lies before sample j
                P = measurement_update(P, self.S[mask])
                after.append(P)
                P = self._flow(P, float(gap))
            now = np.array([np.trace(X) for X in after])
            change = float(np.max(np.abs(now - last) / np.maximum(now, TINY))) if last.size else 1.0
            back = back if back or change > FORGOTTEN else (period + 1) * len(schedule)
            if change <= SETTLED:
                break
            last = now
        return np.array(after), max(back, len(schedule))

    def worst(self, sequence: SampleSequence, until: float = np.inf) -> tuple[float, float]:
        """The largest ratio from the sample before the first change on, and by how much more is unknown at the end."""
        worst = max((float(ratios.max()) for _, _, _, ratios in self.gaps(sequence, until)), default=0.0)
        wider, back = np.inf, departs_and_returns(self.plan, sequence)[1]
        for k, P in self._filtered(sequence, until):
            if k >= max(sequence.first, back):
                usual = self._limit(sequence, k)
                wider = min(wider, self._beyond(P, usual))
        return worst, float(np.sqrt(max(wider, 1.0)))

    def gaps(self, sequence: SampleSequence, until: float = np.inf) -> Iterator[tuple[int, RowGoal, Array, Array]]:
        """For each sample from where the sequence is judged, and goal: offsets, and ratios to the tolerance."""
        times, start = sequence.times, sequence.start
        for k, P in self._filtered(sequence, until):
            if k + 1 == len(times) or times[k] >= until:
                return
            if k < start:
                continue
            for goal, row in self.goals:
                offsets = self._offsets(goal, sequence, k, float(times[k + 1] - times[k]))
                if offsets.size:
                    F, W = self._flows(offsets)
                    propagated = row @ F
                    variance = np.einsum("ki,ij,kj->k", propagated, P, propagated) + np.einsum(
                        "i,kij,j->k", row, W, row
                    )
                    yield k, goal, offsets, np.sqrt(np.maximum(variance, 0.0)) * BETWEEN

    def at(self, history: SampleSequence, t: float) -> dict[str, float]:
        """Deviations at a time at or after the last sample."""
        P = self._filtered(history, np.inf)[-1][1]
        P = self._flow(P, max(0.0, t - float(history.times[-1])))
        return {goal.name: float(np.sqrt(row @ P @ row)) * goal.tolerance for goal, row in self.goals}

    def _filtered(self, sequence: SampleSequence, until: float) -> list[tuple[int, Array]]:
        """Covariances after the samples from the one before the first change on, to the first at or after `until`."""
        if self._run is None or self._run[0] is not sequence or self._run[1] != until:
            times = sequence.times
            self.plan.oracle.work.add(SEQUENCE, len(times) * len(self.A))
            start = max(sequence.first - 1, 0)
            usual = sequence.wider**2 * self._limit(sequence, start)
            P = np.eye(len(self.A)) * WIDE if sequence.begins else usual
            P = measurement_update(P, self.S[sequence.measured[0]]) if sequence.begins else P
            found = [(start, P)]
            for k in range(start, len(times) - 1):
                if times[k] >= until:
                    break
                P = self._flow(found[-1][1], float(times[k + 1] - times[k]))
                P = measurement_update(P, self.S[sequence.measured[k + 1]])
                found.append((k + 1, P))
            self._run = sequence, until, found
        return self._run[2]

    def _offsets(self, goal: RowGoal, sequence: SampleSequence, k: int, gap: float) -> Array:
        begin = min(sequence.skipped(k), gap)
        if own(goal):
            return np.zeros(0 if begin else 1)
        if goal.at == "given times":
            return np.array([offset for offset in asked(self.plan, sequence, k, goal) if offset >= begin])
        return np.linspace(begin, gap, OFFSETS)

    def _beyond(self, P: Array, usual: Array) -> float:
        """The least a with P <= a usual."""
        from scipy.linalg import eigh

        tiny = np.diag(1e-13 * np.diag(usual) + TINY)  # of what nothing drives nothing is left
        return float(eigh(P, usual + tiny, eigvals_only=True)[-1])

    def _limit(self, sequence: SampleSequence, k: int) -> Array:
        """The plan's own covariance after a sample of a sequence."""
        return np.asarray(self.limits[phase_of(self.plan.schedule, float(sequence.clock_times[k]))])


@lru_cache(maxsize=4)
def sequence_filter(plan: PlanFigures) -> SequenceFilter:
    """The filter of a plan, made once."""
    return SequenceFilter(plan)
