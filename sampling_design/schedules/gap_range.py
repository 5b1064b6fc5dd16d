"""Schedules whose gaps lie between two bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.record import short
from sampling_design.records.units import check_time_unit
from sampling_design.schedules.family import AnySchedule, SamplingFamily, Steps, extent, gap_steps, in_family_unit, pick
from sampling_design.schedules.sampling_set import ROUNDING
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule


@dataclass(frozen=True, eq=False, repr=False)
class GapRange(SamplingFamily, kind="gap-range"):
    """All schedules with h_min <= tau_{i+1} - tau_i <= h_max and the first sample at h_max or before.

    Parameters
    ----------
    shortest, longest : float
        0 < h_min <= h_max [time].
    time_unit : str, optional
        Unit of both; None means that of whatever it meets.

    Raises
    ------
    ArgumentError
        If a bound is not positive or `longest` is less than `shortest`.

    Examples
    --------
    >>> family = GapRange(0.9, 1.1)
    >>> family.contains(PeriodicSchedule([1.0, 1.1])), family.contains(PeriodicSchedule([1.2]))
    (True, False)
    """

    shortest: float
    longest: float
    time_unit: str | None = field(default=None, kw_only=True)
    remembers = False

    _plain = "kind shortest longest time_unit?"

    def __post_init__(self) -> None:
        self._check(shortest=checks.positive, longest=checks.positive)
        if self.longest < self.shortest:
            raise ArgumentError(
                f"`longest` must be at least `shortest` = {self.shortest!r}, got {self.longest!r}. Did you swap them?"
            )
        if self.time_unit is not None:
            check_time_unit(self.time_unit)

    @property
    def min_gap(self) -> float:
        """The shortest gap."""
        return self.shortest

    @property
    def d_max(self) -> float:
        """The longest gap."""
        return self.longest

    @property
    def nominal(self) -> PeriodicSchedule:
        """Equal gaps, half-way between the bounds."""
        return PeriodicSchedule(np.array([(self.shortest + self.longest) / 2]), time_unit=self.time_unit)

    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether every gap of `schedule` lies in the range, up to the rounding of times (`ROUNDING`)."""
        schedule = in_family_unit(schedule, self.time_unit)
        if not len(schedule):
            return False
        slack = ROUNDING * max(float(schedule.times[-1]), self.longest)
        first, gaps = float(schedule.times[0]), schedule.gaps
        low, high = self.shortest - slack, self.longest + slack
        return bool(first <= high and np.all(gaps >= low) and np.all(gaps <= high))

    def draw(self, rng: checks.Seed = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        """Return a random member: it covers [0, duration] (default twenty longest gaps), or has `samples` samples.

        Half of the gaps are the shortest or the longest one, where the family's claims are tight.

        Raises
        ------
        ArgumentError
            If both are given or one is not positive.
        """
        rng = checks.generator(rng)
        stop, most = extent(duration, samples, 20 * self.longest, self.longest)
        gaps = [float(rng.uniform(0.0, self.longest))]
        time = gaps[0]
        while len(gaps) < most and time < stop:
            gaps.append(pick(rng, self.shortest, self.longest))
            time += gaps[-1]
        return Schedule.from_gaps(gaps, time_unit=self.time_unit)

    def steps(self, memory: int, outputs: int) -> Steps:
        """Every gap of the range may follow every other."""
        return gap_steps(self.shortest, self.longest, lambda word: self.longest, memory, outputs)

    def narrowed(self, fraction: float) -> Self:
        """Return the range around the same middle, `fraction` times as wide."""
        middle, half = (self.shortest + self.longest) / 2, fraction * (self.longest - self.shortest) / 2
        return type(self)(middle - half, middle + half, time_unit=self.time_unit)

    def _rows(self) -> list[tuple[str, str]]:
        unit = f" {self.time_unit}" if self.time_unit else ""
        return [("shortest gap", short(self.shortest) + unit), ("longest gap", short(self.longest) + unit)]

    def explain(self) -> str:
        """Say which schedules belong."""
        unit = f" {self.time_unit}" if self.time_unit else ""
        return f"Every schedule whose gaps lie between {short(self.shortest)} and {short(self.longest)}{unit}."
