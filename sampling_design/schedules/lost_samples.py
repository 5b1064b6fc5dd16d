"""Schedules that a nominal one leaves when some of its samples are lost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.schedules import family
from sampling_design.schedules.family import AnySchedule, FamilyStep, Leeway, NominalFamily, Steps, Word, period_of
from sampling_design.schedules.jitter import begun_late, nominal_part, same_outputs
from sampling_design.schedules.sampling_set import ROUNDING, SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

LONGEST_PATTERN = 12
QUICK_PATTERN = 6
"""Nominal samples of a pattern of losses that is suspect, and in a quick look."""
_MOST_PERIODS = 10_000  # periods after which two periods must have met, else their ratio counts as irrational


@dataclass(frozen=True, eq=False, repr=False)
class LostSamples(NominalFamily, kind="lost-samples"):
    """All schedules that miss at most `most` of any `of` consecutive samples of a nominal schedule.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        The nominal one.
    most : int
        Largest number lost, >= 0, less than `of`.
    of : int
        Number of consecutive nominal samples among which they are counted.

    Raises
    ------
    ArgumentError
        If the schedule is none or empty, or `most` is not less than `of`.

    Examples
    --------
    >>> family = LostSamples(PeriodicSchedule([1.0]), most=1, of=3)
    >>> family.contains(Schedule([1.0, 3.0, 4.0, 6.0])), family.contains(Schedule([1.0, 3.0, 5.0]))
    (True, False)
    """

    most: int
    of: int

    _plain = "kind schedule most of"
    _table = {"nominal": "{schedule.explain}", "lost at most": "{most} of {of}", "longest gap": "{d_max}"}

    def __post_init__(self) -> None:
        SamplingSet(self.schedule)
        self._check(most=checks.whole, of=checks.at_least_one)
        if self.most >= self.of:
            raise ArgumentError(
                f"`most` must be less than `of` = {self.of}, got {self.most}: every sample could be lost."
            )

    @property
    def min_gap(self) -> float:
        """Least nominal gap."""
        return self.schedule.min_gap

    @property
    def d_max(self) -> float:
        """Longest gap, or latest first sample, when `most` samples in a row are lost."""
        times = self.schedule.times
        if self.schedule.endless:
            times = nominal_part(self.schedule, None, 2 * len(self.schedule) + self.most + 1, 0.0).times
        reach = min(self.most + 1, times.size - 1)
        later = float(np.max(times[reach:] - times[: times.size - reach], initial=0.0)) if reach else 0.0
        return max(float(times[min(self.most, times.size - 1)]), later)

    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether `schedule` has only nominal samples and misses few enough of them.

        A finite schedule is judged up to its last sample (to the end of a finite nominal one).
        """
        schedule = family.in_family_unit(schedule, self.time_unit)
        if not len(schedule):
            return False
        mine = self.schedule
        if not schedule.endless:
            if mine.endless:
                mine = mine.between(0.0, float(schedule.times[-1]) * (1 + ROUNDING))
            return self._judge(mine, schedule, cyclic=False)
        if not mine.endless:
            return False
        ratio = Fraction(schedule.period / mine.period).limit_denominator(_MOST_PERIODS)
        off = abs(schedule.period * ratio.denominator - mine.period * ratio.numerator)
        if ratio.numerator == 0 or off > 4 * ROUNDING * mine.period * ratio.numerator:
            return False
        # first samples may lie anywhere in the first common period; after it both repeat and are judged as a
        # circle, opened half-way between two nominal samples so that rounding cannot move one across
        span = mine.period * ratio.numerator
        stop = span + mine.first + float(mine.gaps[1 % len(mine)]) / 2
        start = self._judge(mine.between(0.0, stop), schedule.between(0.0, stop), cyclic=False)
        later = stop + span
        return start and self._judge(mine.between(stop, later), schedule.between(stop, later), cyclic=True)

    def _judge(self, nominal: Schedule, schedule: Schedule, cyclic: bool) -> bool:
        kept = _positions(nominal.times, schedule.times)
        if kept is None:
            return False
        mask = None if nominal.outputs is None else nominal.outputs[kept]
        if not same_outputs(Schedule(nominal.times[kept], mask), schedule):
            return False
        lost = np.ones(len(nominal), dtype=bool)
        lost[kept] = False
        if cyclic:
            return self._borne_around(lost)
        total = np.concatenate([[0], np.cumsum(lost)])
        ahead = np.minimum(np.arange(lost.size) + self.of, lost.size)
        return bool(np.all(total[ahead] - total[:-1] <= self.most))

    def _borne_around(self, lost: Mask) -> bool:
        """Whether losses that come again for ever are `most` at most of any `of`: whole rounds, and a part of one."""
        rounds, part = divmod(self.of, lost.size)
        total = np.cumsum([0, *lost, *lost])
        worst = int(np.max(total[part : part + lost.size] - total[: lost.size]))
        return rounds * int(total[lost.size]) + worst <= self.most

    def draw(self, rng: checks.Seed = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        """Return a random member: each sample that may be lost is lost with probability 1/2.

        `duration` (default twenty longest gaps) or `samples` (nominal ones) say how far an endless nominal
        schedule is followed; a finite one is followed to its end.

        Raises
        ------
        ArgumentError
            If both are given, or the nominal schedule is finite and one is.
        """
        rng = checks.generator(rng)
        part = nominal_part(self.schedule, duration, samples, 20 * self.d_max)
        lost = np.zeros(len(part), dtype=bool)
        for i in range(lost.size):
            recent = int(lost[max(0, i - self.of + 1) : i].sum())
            lost[i] = recent < self.most and rng.random() < 0.5
        if lost.all():
            lost[-1] = False
        mask = None if part.outputs is None else part.outputs[~lost]
        return Schedule(part.times[~lost], mask, **part._details())

    @property
    def levels_of_memory(self) -> int:
        """From `most` + 1 remembered samples to all of `of`."""
        return self.of - self.most

    def steps(self, memory: int, outputs: int) -> Steps:
        """Words are the phase and the last losses, newest first: at most `most` of any remembered ones are lost."""
        schedule, remembered = period_of(self.schedule), self.most + 1 + memory
        masks, reach, lost = family.masks_of(schedule, outputs), family.reach_of(schedule), (False,) * outputs

        def steps(word: Word) -> list[FamilyStep]:
            start = word == family.START
            phase, *bits = (-1,) if start else tuple(int(x) for x in word)
            found = []
            for j in range(len(schedule)) if start else [(phase + 1) % len(schedule)]:
                low, high = (0.0, reach[j]) if start else (float(schedule.gaps[j]),) * 2
                found.append(FamilyStep((j, *_recent((0, *bits), remembered)), low, high, masks[j]))
                if sum(bits[: remembered - 1]) < self.most:
                    found.append(FamilyStep((j, *_recent((1, *bits), remembered)), low, high, lost))
            return found

        return steps

    @property
    def leeway(self) -> Leeway:
        """Every sample on time or missing."""
        return Leeway(self.schedule, most=self.most, of=self.of)

    def suspects(
        self, periods: Sequence[float], rng: np.random.Generator, quick: bool = False
    ) -> Iterator[PeriodicSchedule]:
        """Yield the members that repeat a pattern of losses."""
        nominal, longest = period_of(self.schedule), QUICK_PATTERN if quick else LONGEST_PATTERN
        for repeats in range(1, max(longest // len(nominal), 1) + 1):
            count = repeats * len(nominal)
            times = (nominal.times + nominal.period * np.arange(repeats)[:, None]).ravel()
            mask = None if nominal.outputs is None else np.tile(nominal.outputs, (repeats, 1))
            for kept in product((True, False), repeat=count):
                on = np.array(kept)
                if not on.any() or not self._borne_around(~on):
                    continue
                kept_mask = None if mask is None else mask[on]
                yield begun_late(times[on], kept_mask, repeats * nominal.period, time_unit=nominal.time_unit)

    def variation(self, start: PeriodicSchedule) -> None:
        """Patterns of losses do not vary continuously."""
        return

    def explain(self) -> str:
        """Say which schedules belong."""
        return f"At most {self.most} of any {self.of} consecutive samples lost. Nominal: {self.schedule.explain()}"


def _positions(nominal: Array, times: Array) -> Index | None:
    """Where in `nominal` each of `times` lies, up to rounding; None if one lies nowhere."""
    if not nominal.size:
        return None
    after = np.clip(np.searchsorted(nominal, times), 0, nominal.size - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(nominal[before] - times) < np.abs(nominal[after] - times)
    place = np.where(nearer, before, after)
    exact = np.abs(nominal[place] - times) <= ROUNDING * np.maximum(times, nominal[place])
    return place if bool(np.all(exact)) and np.unique(place).size == place.size else None


def _recent(bits: tuple[int, ...], remembered: int) -> tuple[int, ...]:
    """The losses that count, without the zeros before the oldest one."""
    recent = bits[: remembered - 1]
    while recent and not recent[-1]:
        recent = recent[:-1]
    return recent
