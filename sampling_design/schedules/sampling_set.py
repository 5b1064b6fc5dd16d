"""The sampling set K of Definition 2: one schedule, re-timed from each of its own samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import Record, short
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule, ScheduleDetails

ROUNDING = 8 * float(np.finfo(float).eps)
"""Two times that differ by less than this fraction of the larger one count as equal.

Decimal times are not exact in binary (0.1 + 0.2 > 0.3), and each period of a periodic schedule adds a rounding."""


@dataclass(frozen=True, eq=False, repr=False)
class SamplingSet(Record):
    """The sets K_i = {d_i, d_i + d_{i+1}, ...} that the gaps D = {d_1, d_2, ...} of a schedule generate.

        K_i = {tau - tau_{i-1} : tau in K_1, tau > tau_{i-1}},    tau_{i-1} = d_1 + ... + d_{i-1}

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        K_1; d_1 is the time of its first sample and may be 0.

    Attributes
    ----------
    first : float
        d_1.
    d_max : float
        Largest gap, d_1 included.
    min_gap : float
        Least of d_2, d_3, ...; infinite if there is only one sample.
    distinct : int
        How many of the K_i differ.

    Raises
    ------
    ArgumentError
        If `schedule` is no schedule or has no sample.

    Notes
    -----
    *Assumptions.* Gaps are real numbers; the paper's integers are a restriction that loses plants
    (theory E19). Only d_1 may be 0: a later zero gap would name the same time twice.
    *Claim.* K_i leaves out the sample from which it is timed.

    References
    ----------
    The paper, Definition 2.

    Examples
    --------
    >>> K = SamplingSet(PeriodicSchedule([1.0, 2.0, 0.5]))
    >>> K.d_max, K.min_gap, K.distinct
    (2.0, 0.5, 3)
    >>> K.starting_at(2).between(0.0, 4.0).times
    array([2. , 2.5, 3.5])
    >>> K.kappa(2.0)
    3
    """

    schedule: Schedule | PeriodicSchedule

    _table = {
        "first": "{first}",
        "d_max": "{d_max}",
        "min gap": "{min_gap}",
        "distinct": "{distinct}",
        "periodic": "{is_periodic}",
    }

    def __post_init__(self) -> None:
        if not isinstance(self.schedule, (Schedule, PeriodicSchedule)):
            inside = checks.held_in("schedule", self.schedule, (Schedule, PeriodicSchedule))
            raise ArgumentError(
                f"`schedule` must be a Schedule or PeriodicSchedule, got {type(self.schedule).__name__}."
                f"{inside or ' Did you pass times? Use Schedule(times).'}"
            )
        if not len(self.schedule):
            raise ArgumentError("`schedule` must have at least one sample, got none.")

    @property
    def is_periodic(self) -> bool:
        """Whether D has no end."""
        return self.schedule.endless

    @property
    def first(self) -> float:
        """d_1, the time of the first sample."""
        return float(self.schedule.times[0])

    @property
    def later_gaps(self) -> Array:
        """d_2, d_3, ...: to the end of a finite schedule, one period of a periodic one."""
        if self.schedule.endless:
            return np.roll(self.schedule.gaps, -1)
        return self.schedule.gaps

    @cached_property
    def d_max(self) -> float:
        """Largest gap, d_1 included."""
        return self.schedule.d_max

    @cached_property
    def min_gap(self) -> float:
        """Least of d_2, d_3, ...; infinite if there are none."""
        return self.schedule.min_gap

    def gap(self, i: int) -> float:
        """Return d_i, i = 1, 2, ... as in the paper."""
        i = self._index(i)
        if i == 1:
            return self.first
        later = self.later_gaps
        return float(later[(i - 2) % later.size])

    def starting_at(self, i: int) -> Schedule | PeriodicSchedule:
        """Return K_i, i = 1, 2, ... as in the paper: the samples after number i-1, timed from it.

        Raises
        ------
        ArgumentError
            If i < 1, or a finite schedule has fewer than i samples.
        """
        i = self._index(i)
        if i == 1:
            return self.schedule
        mask, details = self.schedule.outputs, self.schedule._details() | ScheduleDetails(origin=None)
        if self.schedule.endless:
            turn = -((i - 1) % len(self.schedule))
            turned = None if mask is None else np.roll(mask, turn, axis=0)
            return PeriodicSchedule(np.roll(self.schedule.gaps, turn), None, turned, **details)
        times = self.schedule.times
        return Schedule(times[i - 1 :] - times[i - 2], None if mask is None else mask[i - 1 :], **details)

    def _index(self, i: int) -> int:
        i = checks.whole("i", i, 1)
        if not self.is_periodic and i > len(self.schedule):
            raise ArgumentError(f"`i` must be at most {len(self.schedule)}, the number of samples, got {i}.")
        return i

    @cached_property
    def distinct(self) -> int:
        """How many K_i differ: every one of a finite schedule; one period (and perhaps K_1) of a periodic one."""
        if not self.schedule.endless:
            return len(self.schedule)
        cycle = _least_period(self.schedule)
        off = abs(self.first - float(self.schedule.gaps[0]))
        return cycle if off <= ROUNDING * self.schedule.period else cycle + 1

    def kappa(self, T: float) -> int:
        """Return the largest number of samples in any closed window of length `T` [time].

        Notes
        -----
        *Method.* The fullest closed window may be shifted until it begins at a sample, so only those are
        counted; one period of them for a periodic schedule. *Numerical aspects.* A sample within rounding of
        the window's end counts, so that the number errs on the large side, as its users need it.
        """
        T = checks.nonnegative("T", T)
        starts = self.schedule.times
        if self.schedule.endless:
            last = float(starts[-1]) + T
            times = self.schedule.between(0.0, last * (1 + ROUNDING) + self.schedule.period).times
        else:
            times = starts
        ends = starts + T
        inside = np.searchsorted(times, ends + ROUNDING * ends, side="right") - np.arange(starts.size)
        return int(np.max(inside))

    def explain(self) -> str:
        """Say how many sets there are and how far apart samples lie."""
        return (
            f"{self.distinct} different sets K_i; the longest gap is {short(self.d_max)}, "
            f"the shortest after the first sample {short(self.min_gap)}."
        )


def _least_period(schedule: PeriodicSchedule) -> int:
    """Return the least N' that divides N such that gaps and outputs repeat after N' samples."""
    count, rounding = len(schedule), ROUNDING * schedule.period
    mask = schedule.outputs
    for size in (d for d in range(1, count) if count % d == 0):
        same = np.all(np.abs(schedule.gaps - np.roll(schedule.gaps, size)) <= rounding)
        if same and (mask is None or np.array_equal(mask, np.roll(mask, size, axis=0))):
            return size
    return count
