"""How early and late samples may be, and the schedules near a nominal one that this allows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import gcd
from typing import Self, TypeAlias, Unpack

import numpy as np

from sampling_design.checkers.strict import is_table, is_text
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import short
from sampling_design.schedules import family
from sampling_design.schedules.family import (
    AnySchedule,
    FamilyStep,
    FamilyVariation,
    Leeway,
    NominalFamily,
    Steps,
    Word,
    period_of,
)
from sampling_design.schedules.sampling_set import ROUNDING, SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule, ScheduleDetails
from sampling_design.schedules.sensor import Duration, duration

DEVIATION_CELLS = (1, 2, 4, 8)  # cells of a sample's deviation, per level of memory
_LONGEST_LAP = 1_000_000  # samples after which the periods of two periodic schedules must have met

EarlyLate: TypeAlias = Duration | Sequence[Duration]
Timing: TypeAlias = EarlyLate | Mapping[str, EarlyLate]
"""How early or late samples may be: one time, a pair (early, late), or either by output; text has a unit."""


def deviation_cells(memory: int) -> int:
    """Return how many cells of a sample's deviation a level of memory tells apart; ArgumentError if there is none."""
    most = len(DEVIATION_CELLS) - 1
    if not 0 <= checks.whole("memory", memory) <= most:
        raise ArgumentError(f"`memory` must be a whole number from 0 to {most}, got {memory!r}.")
    return DEVIATION_CELLS[memory]


@dataclass(frozen=True)
class TimingTolerance:
    """How early and how late each sample may be: a planned t is a real time in [t - early, t + late].

    One number each, for samples whose outputs are read together; or one for each output, each of which is then read at
    a time of its own: the outputs of one planned sample may fall apart by as much as their tolerances say.

    An unequal pair is an equal one about another time: `shift` after the planned time lies the *centre*, and every real
    time lies within `radius` of it. Where outputs have tolerances of their own, the centre is a time that all allow.
    `moved` after it lies another time that is counted from in its place.

    Parameters
    ----------
    early, late : tuple of float
        One number, or one for each name.
    names : tuple of str
        The outputs that have a tolerance of their own; empty where all come together.
    """

    early: tuple[float, ...] = (0.0,)
    late: tuple[float, ...] = (0.0,)
    names: tuple[str, ...] = ()
    moved: float = 0.0

    @classmethod
    def of(cls, value: object, outputs: Sequence[str] | None = None, unit: str | None = None) -> Self:
        """Return the tolerance that a time, a pair, or a table of these says; what has none (None) is on time.

        `outputs` are the names of the plant's, where they are known yet, and `unit` that in which times are counted: a
        time is then text with a unit of its own ("15 min"), too. Raises ArgumentError if it is none of these, a time is
        negative, or an output is unknown.
        """
        name = "timing_tolerance"

        def time(name: str, value: object) -> float:
            return duration(name, value, unit) if unit and is_text(value) else checks.nonnegative(name, value)

        if value is None:
            return cls()
        if is_table(value):
            value = {str(key): side for key, side in value.items()}
            names = tuple(value) if outputs is None else tuple(outputs)
            checks.known_keys(f"`{name}`", value, names)
            on_time = (0.0, 0.0)
            pairs = [_pair(f"{name}.{key}", value[key], time) if key in value else on_time for key in names]
            return cls(tuple(a for a, _ in pairs), tuple(b for _, b in pairs), names) if names else cls()
        early, late = _pair(name, value, time)
        return cls((early,), (late,))

    def __bool__(self) -> bool:
        return max(*self.early, *self.late) > 0

    @property
    def apart(self) -> bool:
        """Whether outputs come apart."""
        return bool(self.names)

    @property
    def span(self) -> float:
        """The earliest to the latest reading of one planned time: twice the radius where outputs come together."""
        return max(self.early) + max(self.late)

    @property
    def shift(self) -> float:
        """How long after the planned time the centre lies."""
        return float(shift_of(np.array(self.early), np.array(self.late))) + self.moved

    @property
    def radius(self) -> float:
        """How far from the centre a reading may be."""
        return max(max(self.early) + self.shift, max(self.late) - self.shift)

    @property
    def back(self) -> Array:
        """(p,) or (1,): how long before the centre each output may be read."""
        return np.array(self.early) + self.shift

    @property
    def forward(self) -> Array:
        """(p,) or (1,): how long after the centre each output may be read."""
        return np.array(self.late) - self.shift

    @property
    def radii(self) -> Array:
        """(p,) or (1,): how far from the middle of its own times each output may be read."""
        return (np.array(self.early) + self.late) / 2

    @property
    def offsets(self) -> Array:
        """(p,) or (1,): how long after the centre that middle lies; 0 where outputs come together."""
        return (np.array(self.late) - self.early) / 2 - self.shift

    def scaled(self, factor: float) -> Self:
        """Return it in another unit of time."""
        early, late = (tuple(factor * x for x in side) for side in (self.early, self.late))
        return type(self)(early, late, self.names, factor * self.moved)

    @property
    def plain(self) -> Timing:
        """As it is written: a number, a pair, or a table of these."""
        each: list[EarlyLate] = [a if a == b else [a, b] for a, b in zip(self.early, self.late, strict=True)]
        return dict(zip(self.names, each, strict=True)) if self.apart else each[0]

    def describe(self, unit: str = "", in_words: Callable[[float], str] | None = None) -> str:
        """In words, such as "up to 2 min early or 20 min late"; `in_words` puts a time in words, else it is short."""
        each = in_words or (lambda time: f"{short(time)} {unit}".rstrip())
        sides = [_in_words(a, b, each) for a, b in zip(self.early, self.late, strict=True)]
        return ", ".join(f"{side} ({n})" for n, side in zip(self.names, sides, strict=True)) if self.apart else sides[0]

    def require_order(self, least: float) -> None:
        """Refuse a tolerance with which samples so far apart could change places. Raises ArgumentError."""
        if self and self.span >= least:
            equal = self.early == self.late and not self.apart
            limit = "less than half of" if equal else "early and late, together less than"
            said = short(self.plain) if isinstance(self.plain, float) else f"{self.plain}"
            raise ArgumentError(
                f"`timing_tolerance` must be {limit} the least gap {short(least)}, got {said}: samples could "
                "change places."
            )

    def require_together(self, what: str) -> None:
        """Refuse tolerances of single outputs where samples are one reading. Raises ArgumentError."""
        if self.apart:
            raise ArgumentError(
                f"`timing_tolerance` of single outputs lets them fall apart, and {what} is of samples whose outputs "
                "are read together: give one number or a pair (early, late)."
            )

    def of_samples(self, mask: Mask | None, what: str) -> tuple[float | Array, float]:
        """How much later than planned the middle of each sample's times lies, and the largest radius of these times.

        Outputs with tolerances of their own must be read one at a time. Raises ArgumentError if a sample reads several.
        """
        if not self.apart:
            return self.shift, self.radius
        every = np.ones((1, len(self.names)), dtype=bool) if mask is None else mask
        if every.shape[1] != len(self.names) or every.sum(axis=1).max(initial=0) > 1:
            self.require_together(what)
        read = np.argmax(every, axis=1)
        early, late = np.array(self.early)[read], np.array(self.late)[read]
        return (late - early) / 2, float(np.max((early + late) / 2))


def shift_of(early: Array, late: Array) -> Array:
    """How long after the planned time (...,) the centre of outputs (..., p) lies that may be so early and late."""
    middle = (late.max(axis=-1) - early.max(axis=-1)) / 2
    return np.minimum(np.maximum(middle, -early.min(axis=-1)), late.min(axis=-1))  # type: ignore[no-any-return]


ON_TIME = TimingTolerance()  # samples come when they are planned


def _in_words(early: float, late: float, in_words: Callable[[float], str]) -> str:
    if early == late:
        return f"up to {in_words(early)} early or late" if early else "on time"
    words = [f"up to {in_words(t)} {side}" for t, side in ((early, "early"), (late, "late")) if t]
    return " or ".join(words)


def _pair(name: str, value: object, time: Callable[[str, object], float]) -> tuple[float, float]:
    """Early and late, of a number or two."""
    if isinstance(value, (list, tuple, np.ndarray)):
        if len(value) != 2:
            raise ArgumentError(f"`{name}` must be one number or two, (early, late), got {len(value)} numbers.")
        return time(f"{name}[0]", value[0]), time(f"{name}[1]", value[1])
    both = time(name, value)
    return both, both


def moved(schedule: AnySchedule, by: float | Array) -> AnySchedule:
    """Return the schedule with every sample so much later (or earlier, if negative), or each by a time of its own.

    Raises ArgumentError if its first sample would come before time 0.
    """
    if not np.any(by):
        return schedule
    times = np.asarray(schedule.times) + by
    if times.size and times[0] < 0:
        raise ArgumentError(
            f"`timing_tolerance`: a first sample at {short(schedule.times[0])} cannot be so much earlier than late: "
            f"plan it at {short(-float(np.min(by)))} or later, or give one number."
        )
    if not schedule.endless:
        return Schedule(times, schedule.outputs, **schedule._details())
    return begun_late(times, schedule.outputs, schedule.period, **schedule._details())


def begun_late(times: Array, mask: Mask | None, period: float, **details: Unpack[ScheduleDetails]) -> PeriodicSchedule:
    """Return the schedule of these times of a period; one that begins after it has two periods as one."""
    if times[0] > period:
        times, period = np.append(times, times + period), 2 * period
        mask = None if mask is None else np.tile(mask, (2, 1))
    return PeriodicSchedule.from_times(times, period, mask, **details)


@dataclass(frozen=True, eq=False, repr=False)
class Jitter(NominalFamily, kind="jitter"):
    """All schedules whose i-th sample lies within `timing_tolerance` of the nominal i-th sample.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        The nominal one.
    timing_tolerance : float
        Largest deviation [time], >= 0, less than half of the nominal least gap so that order is kept.

    Raises
    ------
    ArgumentError
        If the schedule is none or empty, or the tolerance is negative or too large.

    Notes
    -----
    A sample whose nominal time is less than `timing_tolerance` never comes before time 0. Each sample measures what the
    nominal one measures.

    Examples
    --------
    >>> family = Jitter(PeriodicSchedule([1.0]), 0.1)
    >>> family.contains(PeriodicSchedule([1.1, 0.9])), family.contains(PeriodicSchedule([1.01]))
    (True, False)
    """

    timing_tolerance: float

    _plain = "kind schedule timing_tolerance"
    _table = {"nominal": "{schedule.explain}", "early or late": "{timing_tolerance}"}

    def __post_init__(self) -> None:
        least = SamplingSet(self.schedule).min_gap
        self._check(timing_tolerance=checks.nonnegative)
        if 2 * self.timing_tolerance >= least:
            raise ArgumentError(
                f"`timing_tolerance` must be less than half of the least gap {short(least)}, got "
                f"{short(self.timing_tolerance)}: samples could change places."
            )

    @classmethod
    def around(cls, schedule: AnySchedule, tolerance: TimingTolerance) -> Self:
        """Return the schedules whose samples are so early or late: those within the radius about their centres.

        Where outputs have tolerances of their own and are read one at a time, each sample has the centre of its output,
        and all have the largest radius of what is read.

        Raises
        ------
        ArgumentError
            As for the family, or if outputs of one sample have tolerances of their own, or the first centre lies before
            time 0.
        """
        SamplingSet(schedule)
        by, radius = tolerance.of_samples(schedule.outputs, "a family of schedules")
        return cls(moved(schedule, by), radius)

    @property
    def min_gap(self) -> float:
        """Least nominal gap less twice the tolerance."""
        return self.schedule.min_gap - 2 * self.timing_tolerance

    @property
    def d_max(self) -> float:
        """Longest gap that two deviations can make, or the latest first sample."""
        nominal = SamplingSet(self.schedule)
        later = float(np.max(nominal.later_gaps, initial=0.0))
        return max(nominal.first + self.timing_tolerance, later + 2 * self.timing_tolerance if later else 0.0)

    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether every sample of `schedule` lies within the tolerance of its nominal place.

        A finite schedule is compared with the nominal samples of the same numbers (a finite nominal one must
        have as many); an endless one must keep the nominal pace for ever, and measure the same outputs.
        """
        schedule = family.in_family_unit(schedule, self.time_unit)
        if not len(schedule):
            return False
        mine = self.schedule
        if schedule.endless:
            return mine.endless and self._contains_endless(mine, schedule)
        if not mine.endless and len(mine) != len(schedule):
            return False
        return self._near(_first(mine, len(schedule)), schedule)

    def _contains_endless(self, mine: PeriodicSchedule, schedule: PeriodicSchedule) -> bool:
        n, m = len(mine), len(schedule)
        common = n * m // gcd(n, m)
        if common > _LONGEST_LAP:
            raise ArgumentError(f"`schedule`: {m} samples a period against {n} nominal ones meet too late to compare.")
        spans = mine.period * (common // n), schedule.period * (common // m)
        if abs(spans[0] - spans[1]) > ROUNDING * max(spans) * 4:
            return False
        return self._near(_first(mine, common), _first(schedule, common))

    def _near(self, nominal: Schedule, schedule: Schedule) -> bool:
        slack = ROUNDING * np.maximum(nominal.times, schedule.times)
        near = np.abs(schedule.times - nominal.times) <= self.timing_tolerance + slack
        return bool(np.all(near)) and same_outputs(nominal, schedule)

    def draw(self, rng: checks.Seed = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        """Return a random member: half of the deviations are the largest in one direction or the other.

        `duration` (default twenty longest gaps) or `samples` say how far an endless nominal schedule is
        followed; a finite one is followed to its end.

        Raises
        ------
        ArgumentError
            If both are given, or the nominal schedule is finite and one is.
        """
        rng = checks.generator(rng)
        part = nominal_part(self.schedule, duration, samples, 20 * self.d_max)
        shifts = np.array([family.pick(rng, -self.timing_tolerance, self.timing_tolerance) for _ in range(len(part))])
        return Schedule(np.maximum(part.times + shifts, 0.0), part.outputs, **part._details())

    @property
    def levels_of_memory(self) -> int:
        """How finely the last deviation may be remembered."""
        return len(DEVIATION_CELLS)

    def steps(self, memory: int, outputs: int) -> Steps:
        """Words are the phase, and lower and upper end of the last deviation."""
        schedule, radius = period_of(self.schedule), self.timing_tolerance
        masks, reach, cells = family.masks_of(schedule, outputs), family.reach_of(schedule), deviation_cells(memory)
        borders = np.linspace(-radius, radius, cells + 1).tolist() if radius else [0.0, 0.0]

        def steps(word: Word) -> list[FamilyStep]:
            start = word == family.START
            phase, *last = (-1, 0.0, 0.0) if start else (int(word[0]), float(word[1]), float(word[2]))
            found = []
            for j in range(len(schedule)) if start else [(phase + 1) % len(schedule)]:
                gap = float(schedule.gaps[j])
                for a, b in pairwise(borders):
                    low, high = (0.0, reach[j] + radius + b) if start else (gap + a - last[1], gap + b - last[0])
                    wider = family.OUTWARD * (gap + radius) if radius else 0.0  # no deviation, no rounding
                    found.append(FamilyStep((j, a, b), max(low - wider, 0.0), high + wider, masks[j]))
            return found

        return steps

    @property
    def leeway(self) -> Leeway:
        """Every sample within the tolerance."""
        return Leeway(self.schedule, radius=self.timing_tolerance)

    def suspects(
        self, periods: Sequence[float], rng: np.random.Generator, quick: bool = False
    ) -> Iterator[PeriodicSchedule]:
        """Yield two periods with every deviation none or the largest."""
        cycle = period_of(self.schedule)
        for _ in range(4 * family.RANDOM_WORDS):
            yield self._shifted(rng.choice([-1.0, 0.0, 1.0], 2 * len(cycle)) * self.timing_tolerance)

    def variation(self, start: PeriodicSchedule) -> FamilyVariation | None:
        """Return two periods with other deviations, near those of `start`."""
        cycle = period_of(self.schedule)
        if len(start) == len(cycle) or not self.timing_tolerance:
            return None
        origin = np.array(start.times) - np.append(cycle.times, cycle.times + cycle.period)
        return origin, self.timing_tolerance, self._shifted

    def _shifted(self, shifts: Array) -> PeriodicSchedule:
        """Two periods with these deviations."""
        cycle = period_of(self.schedule)
        times = np.maximum(np.append(cycle.times, cycle.times + cycle.period) + shifts, 0.0)
        mask = None if cycle.outputs is None else np.tile(cycle.outputs, (2, 1))
        return PeriodicSchedule.from_times(times, 2 * cycle.period, mask, time_unit=cycle.time_unit)

    def narrowed(self, fraction: float) -> Self:
        """Return the family of `fraction` times the tolerance."""
        return type(self)(self.schedule, fraction * self.timing_tolerance)

    def explain(self) -> str:
        """Say which schedules belong."""
        unit = f" {self.time_unit}" if self.time_unit else ""
        most = f"{short(self.timing_tolerance)}{unit}"
        return f"Every sample at most {most} early or late. Nominal: {self.schedule.explain()}"


def _first(schedule: AnySchedule, count: int) -> Schedule:
    """The first `count` samples, or fewer if a finite schedule has fewer."""
    if schedule.endless:
        cycles = -(-count // len(schedule))
        times = (schedule.times + schedule.period * np.arange(cycles)[:, None]).ravel()[:count]
        mask = None if schedule.outputs is None else np.tile(schedule.outputs, (cycles, 1))[:count]
        return Schedule(times, mask, **schedule._details())
    mask = None if schedule.outputs is None else schedule.outputs[:count]
    return Schedule(schedule.times[:count], mask, **schedule._details())


def same_outputs(nominal: Schedule, schedule: Schedule) -> bool:
    """Say whether two schedules of equal length measure the same; None stands for every output."""
    if nominal.outputs is None or schedule.outputs is None:
        return all(m is None or bool(m.all()) for m in (nominal.outputs, schedule.outputs))
    return bool(np.array_equal(nominal.outputs, schedule.outputs))


def nominal_part(schedule: AnySchedule, duration: float | None, samples: int | None, default: float) -> Schedule:
    """Return the finite part of a nominal schedule that a draw follows.

    Raises ArgumentError if an extent is given for a finite schedule, or both are given.
    """
    if not schedule.endless:
        if duration is not None or samples is not None:
            raise ArgumentError("`duration` and `samples` are for an endless nominal schedule; this one is finite.")
        return schedule
    stop, most = family.extent(duration, samples, default, schedule.period / len(schedule))
    if samples is not None:
        return _first(schedule, most)
    inside = schedule.count(0.0, stop, closed="left")
    return _first(schedule, inside + 1)
