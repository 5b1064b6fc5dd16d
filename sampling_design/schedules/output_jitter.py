"""Schedules near a nominal one whose outputs are read at times of their own, in any order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import combinations, pairwise
from typing import Self

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.declarations import Converted, frozen
from sampling_design.schedules import jitter
from sampling_design.schedules.family import (
    OUTWARD,
    RANDOM_WORDS,
    START,
    AnySchedule,
    FamilyStep,
    FamilyVariation,
    NominalFamily,
    Steps,
    Word,
    in_family_unit,
    masks_of,
    period_of,
    pick,
    reach_of,
)
from sampling_design.schedules.jitter import Jitter, TimingTolerance
from sampling_design.schedules.sampling_set import ROUNDING, SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

MOST_WORDS = 399  # of a level of memory beyond the first: so many nodes may a graph have beside its start


@frozen
class OutputJitter(NominalFamily, kind="output-jitter"):
    """All schedules that read output i of each nominal sample at t within [t - early_i, t + late_i], in any order.

    One nominal sample becomes up to p real ones; outputs that are read at one instant are one sample.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        The nominal one.
    early, late : (p,) array [time]
        Of each output, >= 0. Together less than the nominal least gap, the largest of each, so that nominal samples
        keep their order.

    Raises
    ------
    ArgumentError
        If the schedule is none or empty, has other outputs, a number is negative or too large, or the middle of an
        output's first times lies before time 0.

    Examples
    --------
    >>> family = OutputJitter(PeriodicSchedule([1.0]), early=[0.0, 0.1], late=[0.2, 0.1])
    >>> family.contains(PeriodicSchedule([0.9, 0.1], 0.9, outputs=[[0, 1], [1, 0]]))
    True
    >>> family.contains(PeriodicSchedule([0.9, 0.1], 0.9, outputs=[[1, 0], [0, 1]]))
    False
    """

    early: Converted[npt.ArrayLike, Array]
    late: Converted[npt.ArrayLike, Array]

    _plain = "kind schedule early late"
    _table = {"nominal": "{schedule.explain}", "early": "{early}", "late": "{late}"}

    def __post_init__(self) -> None:
        least = SamplingSet(self.schedule).min_gap
        early = checks.vector("early", self.early)
        self._hold(early=early, late=checks.vector("late", self.late, early.size))
        mask = self.schedule.outputs
        if not early.size or (mask is not None and mask.shape[1] != early.size):
            outputs = "at least one output" if mask is None else f"{mask.shape[1]} outputs"
            raise ArgumentError(f"`early` must say it for each output: the schedule has {outputs}, got {early.size}.")
        for side, times in (("early", self.early), ("late", self.late)):
            for i, time in enumerate(times.tolist()):
                checks.nonnegative(f"{side}[{i}]", time)
        self.tolerance.require_order(least)
        assert self.by_output  # refuses a first centre before time 0

    @classmethod
    def around(cls, schedule: AnySchedule, tolerance: TimingTolerance) -> Self:
        """Return the family of a tolerance of its own for each column of the schedule."""
        tolerance.require_order(SamplingSet(schedule).min_gap)  # it knows the outputs' names
        return cls(schedule, tolerance.early, tolerance.late)

    @property
    def tolerance(self) -> TimingTolerance:
        """The tolerances, by the names of the outputs."""
        names = tuple(self.schedule.output_names or (f"y{i + 1}" for i in range(self.early.size)))
        return TimingTolerance(tuple(self.early.tolist()), tuple(self.late.tolist()), names)

    @cached_property
    def by_output(self) -> tuple[Jitter | None, ...]:
        """The schedules of each output by itself; None where it is never measured."""
        middles, radii = (self.late - self.early) / 2, (self.late + self.early) / 2
        parts = [_read_by(self.schedule, own) for own in self._mask(self.schedule).T]
        return tuple(
            None if part is None else Jitter(jitter.moved(part, float(by)), float(radius))
            for part, by, radius in zip(parts, middles, radii, strict=True)
        )

    def _mask(self, schedule: AnySchedule) -> Mask:
        whole = np.ones((len(schedule), self.early.size), dtype=bool)
        return whole if schedule.outputs is None else schedule.outputs

    @property
    def min_gap(self) -> float:
        """Zero: two outputs may be read one right after the other."""
        return 0.0

    @property
    def d_max(self) -> float:
        """Longest time without a reading, or before the first."""
        nominal, mask = SamplingSet(self.schedule), self._mask(self.schedule)
        early, late = (np.where(mask, side, np.inf).min(axis=1) for side in (self.early, self.late))
        later = float(np.max(nominal.later_gaps, initial=0.0))
        return float(max(nominal.first + late[0], later + early.max() + late.max() if later else 0.0))

    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether each output is read as the nominal schedule reads it, within its own tolerance.

        A finite piece of an endless schedule has read all that was due before its last sample.
        """
        schedule = in_family_unit(schedule, self.time_unit)
        mask = self._mask(schedule)
        if not len(schedule) or mask.shape[1] != self.early.size:
            return False
        return all(_reads_as(family, schedule, own) for family, own in zip(self.by_output, mask.T, strict=True))

    def draw(self, rng: checks.Seed = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        """Return a random member: half of the deviations are the largest in one direction or the other.

        `duration` (default twenty longest gaps) or `samples` (nominal ones) say how far an endless nominal schedule is
        followed; a finite one is followed to its end. Raises ArgumentError as `Jitter.draw` does.
        """
        rng = checks.generator(rng)
        part = jitter.nominal_part(self.schedule, duration, samples, 20 * self.d_max)
        at, read = np.nonzero(self._mask(part))
        shifts = [pick(rng, -self.early[i], self.late[i]) for i in read]
        times, mask = self._readings(part.times[at] + np.array(shifts), read)
        return Schedule(times, mask, **part._details())

    def _readings(self, times: Array, read: Index) -> tuple[Array, Mask]:
        """Samples of readings at these times, none before 0, of these outputs."""
        instants, which = np.unique(np.maximum(times, 0.0), return_inverse=True)
        mask = np.zeros((instants.size, self.early.size), dtype=bool)
        mask[which, read] = True
        return instants, mask

    @property
    def levels_of_memory(self) -> int:
        """How finely the last deviation may be remembered; less so where many words say what is yet to be read."""
        words = sum(int(n) << int(n) - 1 for n in self._mask(self.schedule).sum(axis=1))
        return max(1, sum(words * cells <= MOST_WORDS for cells in jitter.DEVIATION_CELLS))

    def steps(self, memory: int, outputs: int) -> Steps:
        """Words are the phase, lower and upper end of the last deviation, and the outputs that are yet to be read."""
        schedule, cells = period_of(self.schedule), jitter.deviation_cells(memory)
        read = [tuple(i for i, on in enumerate(row) if on) for row in masks_of(schedule, outputs)]
        reach, early, late = reach_of(schedule), self.early.tolist(), self.late.tolist()
        rounding = OUTWARD * (max(early) + max(late))

        def steps(word: Word) -> list[FamilyStep]:
            found = []
            for j, k, left in following(word, read):
                done = [i for i in read[j] if i not in left]
                soonest, latest = max(-early[i] for i in done), min(late[i] for i in (k, *left))
                gap, first, last = 0.0, 0.0, np.inf
                if word != START:
                    gap, first, last = 0.0 if word[3:] else float(schedule.gaps[j]), float(word[1]), float(word[2])
                elif len(done) > 1:
                    first = max(-early[i] for i in done if i != k)
                else:
                    gap, first = reach[j], max(-early[i] for i in read[j - 1])
                wider = OUTWARD * gap + rounding if rounding else 0.0
                borders = np.linspace(soonest, latest, cells + 1).tolist() if soonest < latest else [latest] * 2
                for a, b in pairwise(borders):
                    if gap or b > first or b == latest:  # the others end before the last reading
                        low, high = gap + a - last - wider, gap + b - first + wider
                        only = tuple(i == k for i in range(outputs))
                        found.append(FamilyStep((j, a, b, *left), max(low, 0.0), high, only))
            return found

        return steps

    def suspects(
        self, periods: Sequence[float], rng: np.random.Generator, quick: bool = False
    ) -> Iterator[PeriodicSchedule]:
        """Yield two periods with every deviation none or the largest; in turn each reading's own, and each output's."""
        cycle = period_of(self.schedule)
        at, read = np.nonzero(np.tile(self._mask(cycle), (2, 1)))
        times = np.append(cycle.times, cycle.times + cycle.period)[at]
        for k in range(4 * RANDOM_WORDS):
            side = rng.choice([-1.0, 0.0, 1.0], read.size if k % 2 else self.early.size)[slice(None) if k % 2 else read]
            shifts = np.where(side < 0, side * self.early[read], side * self.late[read])
            yield jitter.begun_late(*self._readings(times + shifts, read), 2 * cycle.period, time_unit=cycle.time_unit)

    def variation(self, start: PeriodicSchedule) -> FamilyVariation | None:
        """None: no member is sought near another one."""
        return None

    def narrowed(self, fraction: float) -> Self:
        """Return the family of `fraction` times the tolerances."""
        return type(self)(self.schedule, fraction * self.early, fraction * self.late)

    def explain(self) -> str:
        """Say which schedules belong."""
        late = self.tolerance.describe(self.schedule.time_unit or "")
        return f"Each output of a sample read at a time of its own, {late}. Nominal: {self.schedule.explain()}"


def following(word: Word, read: Sequence[tuple[int, ...]]) -> Iterable[tuple[int, int, tuple[int, ...]]]:
    """Yield the sample, the output that may be read next, and which outputs of that sample are then yet to be read.

    `read` lists what each sample of the period measures. A window may start between two readings of a sample.
    """
    if word == START:
        for j, own in enumerate(read):
            for count in range(len(own)):
                for left in combinations(own, count):
                    yield from ((j, k, left) for k in own if k not in left)
        return
    j, unread = int(word[0]), tuple(int(i) for i in word[3:])
    if not unread:
        j = (j + 1) % len(read)
        unread = read[j]
    yield from ((j, k, tuple(i for i in unread if i != k)) for k in unread)


def _read_by(schedule: AnySchedule, own: Mask) -> AnySchedule | None:
    """When one output is read, by itself."""
    if not own.any():
        return None
    if schedule.endless:
        return jitter.begun_late(schedule.times[own], None, schedule.period, time_unit=schedule.time_unit)
    return Schedule(schedule.times[own], time_unit=schedule.time_unit)


def _reads_as(family: Jitter | None, schedule: AnySchedule, own: Mask) -> bool:
    """Whether a schedule reads one output as the family of that output has it."""
    part = _read_by(schedule, own)
    if family is None or part is None:
        some = family is not None and (schedule.endless or not family.schedule.endless)
        if part is not None or some:
            return False
    elif not family.contains(part):
        return False
    if family is None or schedule.endless or not family.schedule.endless:
        return True
    end, count = float(schedule.times[-1]), int(own.sum())
    deadline = jitter.nominal_part(family.schedule, None, count + 1, 0.0).times[-1] + family.timing_tolerance
    return bool(deadline >= end * (1 - ROUNDING))
