"""Schedules near a nominal one: every sample a little early or late."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import gcd
from typing import Self

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.checks import Seed
from sampling_design.records.record import short
from sampling_design.schedules.family import (
    OUTWARD,
    RANDOM_WORDS,
    START,
    AnySchedule,
    FamilyStep,
    FamilyVariation,
    SamplingFamily,
    Steps,
    TimingTolerance,
    Word,
    extent,
    in_family_unit,
    masks_of,
    period_of,
    pick,
    reach_of,
)
from sampling_design.schedules.sampling_set import ROUNDING, SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

DEVIATION_CELLS = (1, 2, 4, 8)
"""Cells of a sample's deviation, per level of memory."""
_LONGEST_LAP = 1_000_000  # samples after which the periods of two periodic schedules must have met


@dataclass(frozen=True, eq=False, repr=False)
class Jitter(SamplingFamily, kind="jitter"):
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

    schedule: AnySchedule
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

    @property
    def time_unit(self) -> str | None:
        """Unit of the nominal schedule."""
        return self.schedule.time_unit

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

    @property
    def nominal(self) -> AnySchedule:
        """The schedule without deviations."""
        return self.schedule

    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether every sample of `schedule` lies within the tolerance of its nominal place.

        A finite schedule is compared with the nominal samples of the same numbers (a finite nominal one must
        have as many); an endless one must keep the nominal pace for ever, and measure the same outputs.
        """
        schedule = in_family_unit(schedule, self.time_unit)
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

    def draw(self, rng: Seed = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
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
        shifts = np.array([pick(rng, -self.timing_tolerance, self.timing_tolerance) for _ in range(len(part))])
        return Schedule(np.maximum(part.times + shifts, 0.0), part.outputs, **part._details())

    @property
    def levels_of_memory(self) -> int:
        """How finely the last deviation may be remembered."""
        return len(DEVIATION_CELLS)

    def steps(self, memory: int, outputs: int) -> Steps:
        """Words are the phase, and lower and upper end of the last deviation."""
        schedule, radius = period_of(self.schedule), self.timing_tolerance
        masks, reach, cells = masks_of(schedule, outputs), reach_of(schedule), DEVIATION_CELLS[memory]
        borders = np.linspace(-radius, radius, cells + 1).tolist() if radius else [0.0, 0.0]

        def steps(word: Word) -> list[FamilyStep]:
            start = word == START
            phase, *last = (-1, 0.0, 0.0) if start else (int(word[0]), float(word[1]), float(word[2]))
            found = []
            for j in range(len(schedule)) if start else [(phase + 1) % len(schedule)]:
                gap = float(schedule.gaps[j])
                for a, b in pairwise(borders):
                    low, high = (0.0, reach[j] + radius + b) if start else (gap + a - last[1], gap + b - last[0])
                    wider = OUTWARD * (gap + radius) if radius else 0.0  # no deviation, no rounding
                    found.append(FamilyStep((j, a, b), max(low - wider, 0.0), high + wider, masks[j]))
            return found

        return steps

    @property
    def planned(self) -> AnySchedule:
        """The nominal schedule."""
        return self.schedule

    def replanned(self, schedule: PeriodicSchedule) -> Self:
        """Return the same deviations around another nominal schedule."""
        return type(self)(schedule, self.timing_tolerance)

    @property
    def leeway(self) -> TimingTolerance:
        """Every sample within the tolerance."""
        return TimingTolerance(self.schedule, radius=self.timing_tolerance)

    def suspects(
        self, periods: Sequence[float], rng: np.random.Generator, quick: bool = False
    ) -> Iterator[PeriodicSchedule]:
        """Yield two periods with every deviation none or the largest."""
        cycle = period_of(self.schedule)
        for _ in range(4 * RANDOM_WORDS):
            yield self._shifted(rng.choice([-1.0, 0.0, 1.0], 2 * len(cycle)) * self.timing_tolerance)

    def variation(self, start: PeriodicSchedule) -> FamilyVariation | None:
        """Return two periods with other deviations, near those of `start`."""
        cycle = period_of(self.schedule)
        if len(start) == len(cycle) or not self.timing_tolerance:
            return None
        origin = np.array(start.times) - np.append(cycle.times, cycle.times + cycle.period)
        return FamilyVariation(origin, self.timing_tolerance, self._shifted)

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
        return f"Every sample at most {short(self.timing_tolerance)} early or late. Nominal: {self.schedule.explain()}"


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
    stop, most = extent(duration, samples, default, schedule.period / len(schedule))
    if samples is not None:
        return _first(schedule, most)
    inside = schedule.count(0.0, stop, closed="left")
    return _first(schedule, inside + 1)
