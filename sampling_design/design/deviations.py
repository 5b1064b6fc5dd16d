"""What a designed schedule keeps if samples come a little early or late, and if one is lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.observability.windows.window_sigma import window_sigma
from sampling_design.plants.plant import Plant
from sampling_design.records.record import Plain, Record, short
from sampling_design.schedules.schedule import PeriodicSchedule, ScheduleDetails

SHARE = 0.01
"""Of the least gap: how early or late samples are taken to be where nobody says."""
RTOL = 0.01
"""Width of the brackets here: they say how steep the ground is, not where it lies."""


@dataclass(frozen=True, eq=False, repr=False)
class DesignDeviations(Record):
    """Proven sigma of a schedule that is not kept to the letter.

    Attributes
    ----------
    tolerance : float
        How early or late each sample may be.
    late : float
        Sigma over windows of the design's length for all such times.
    late_wider : float
        The same over windows that are 2 `tolerance` longer: they hold every sample that was planned in the shorter one.
    lost : float
        Sigma if any one sample is lost once.
    lost_sample : int
        Which loss leaves that, counted from 0.
    time_unit : str
    """

    tolerance: float
    late: float
    late_wider: float
    lost: float
    lost_sample: int
    time_unit: str

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return {
            "tolerance": self.tolerance,
            "late": self.late,
            "late_wider": self.late_wider,
            "lost": self.lost,
            "lost_sample": self.lost_sample,
        }

    def _rows(self) -> list[tuple[str, str]]:
        early = f"{short(self.tolerance)} {self.time_unit}"
        wider = f"windows {short(2 * self.tolerance)} {self.time_unit} longer"
        return [
            (f"if {early} early or late", f"{short(self.late)}; {short(self.late_wider)} in {wider}"),
            ("if one sample is lost", f"{short(self.lost)} (sample {self.lost_sample + 1})"),
        ]

    def explain(self) -> str:
        """Say what is left of sigma."""
        early, wider = (f"{short(length)} {self.time_unit}" for length in (self.tolerance, 2 * self.tolerance))
        return (
            f"If samples come up to {early} early or late, sigma is at least {short(self.late)}, and over windows that "
            f"are {wider} longer {short(self.late_wider)}; if one is lost, {short(self.lost)}."
        )


def deviations_of(plant: Plant, schedule: PeriodicSchedule, window: float, share: float = SHARE) -> DesignDeviations:
    """Prove what is left of sigma if samples come early or late by a share of the least gap, or one is lost."""
    tolerance = share * float(schedule.gaps.min())
    late, wider = (
        window_sigma(plant, schedule, length, RTOL, timing_tolerance=tolerance).lower if length > 2 * tolerance else 0.0
        for length in (window, window + 2 * tolerance)
    )
    periods = periods_touched(schedule, window)
    rest = [without_sample(schedule, i, periods) for i in range(len(schedule))]
    lost = np.array([0.0 if one is None else window_sigma(plant, one, window, RTOL).lower for one in rest])
    worst = int(np.argmin(lost))
    return DesignDeviations(tolerance, late, wider, float(lost[worst]), worst, plant.time_unit)


def periods_touched(schedule: PeriodicSchedule, window: float) -> int:
    """Periods that a window can touch, plus one."""
    return int(np.ceil(window / schedule.period)) + 1


def without_sample(schedule: PeriodicSchedule, i: int, periods: int) -> PeriodicSchedule | None:
    """The schedule without sample i in one of so many periods; None where there is no other sample."""
    times = (schedule.times + schedule.period * np.arange(periods)[:, None]).ravel()
    if times.size == 1:
        return None
    keep = np.arange(times.size) != i
    mask = None if schedule.outputs is None else np.tile(schedule.outputs, (periods, 1))[keep]
    details = ScheduleDetails(time_unit=schedule.time_unit, output_names=schedule.output_names)
    return PeriodicSchedule.from_times(times[keep], periods * schedule.period, mask, **details)
