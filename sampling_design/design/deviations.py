"""What a designed schedule keeps if samples come a little early or late, and if one is lost."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sampling_design.observability.windows.pieces import window_pieces
from sampling_design.observability.windows.window_sigma import WindowSigma, sigma_of_pieces
from sampling_design.plants.plant import Plant
from sampling_design.records.record import Plain, Record, short
from sampling_design.schedules.jitter import TimingTolerance
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
    tolerance : TimingTolerance
        How early or late each sample may be.
    late : float
        Sigma over windows of the design's length for all such times.
    late_wider : float
        The same over windows that are early and late together longer: they hold every sample that was planned in the
        shorter one.
    lost : float
        Sigma if any one sample is lost once.
    lost_sample : int
        Which loss leaves that, counted from 0.
    time_unit : str
    """

    tolerance: TimingTolerance
    late: float
    late_wider: float
    lost: float
    lost_sample: int
    time_unit: str

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return {
            "tolerance": self.tolerance.plain,
            "late": self.late,
            "late_wider": self.late_wider,
            "lost": self.lost,
            "lost_sample": self.lost_sample,
        }

    def _rows(self) -> list[tuple[str, str]]:
        wider = f"windows {short(2 * self.tolerance.radius)} {self.time_unit} longer"
        return [
            (
                f"if {self.tolerance.describe(self.time_unit)}",
                f"{short(self.late)}; {short(self.late_wider)} in {wider}",
            ),
            ("if one sample is lost", f"{short(self.lost)} (sample {self.lost_sample + 1})"),
        ]

    def explain(self) -> str:
        """Say what is left of sigma."""
        wider = f"{short(2 * self.tolerance.radius)} {self.time_unit}"
        return (
            f"If samples come {self.tolerance.describe(self.time_unit)}, sigma is at least {short(self.late)}, and "
            f"over windows that are {wider} longer {short(self.late_wider)}; if one is lost, {short(self.lost)}."
        )

    @property
    def lost_only(self) -> str:
        """The sentence where the other says again what was asked for."""
        return f"If one sample is lost, sigma is at least {short(self.lost)}."


def deviations_of(
    plant: Plant, schedule: PeriodicSchedule, window: float, asked: TimingTolerance, sigma: float = 0.0
) -> DesignDeviations:
    """Prove what is left of sigma if samples come early or late, or one is lost.

    As early or late as was `asked`, for which `sigma` is proven, else by a share of the least gap.
    """
    tolerance = asked or TimingTolerance.of(SHARE * float(schedule.gaps.min()))

    def left(length: float) -> float:
        if length <= 2 * tolerance.radius:
            return 0.0
        pieces = window_pieces(schedule, length, late=tolerance)
        return sigma_of_pieces(plant, schedule, pieces, RTOL, np.inf).lower

    lost, worst = _lost(plant, schedule, window, asked)
    wider = left(window + 2 * tolerance.radius)
    return DesignDeviations(tolerance, sigma if asked else left(window), wider, lost, worst, plant.time_unit)


def _lost(plant: Plant, schedule: PeriodicSchedule, window: float, late: TimingTolerance) -> tuple[float, int]:
    """Proven sigma if any one sample is lost once, and whose loss leaves that: over the windows that could hold it.

    What sees more than the worst that was found by then is not looked at closely.
    """
    found: WindowSigma | None = None
    least, worst = np.inf, 0
    more = window + 2 * late.radius
    begin = schedule.period * np.ceil(more / schedule.period)
    for i, t in enumerate((schedule.times + begin).tolist()):
        held = schedule.between(t - more, t + more + float(schedule.gaps.max()))
        kept = np.abs(held.times - t) > schedule.gaps.min() / 2
        rest = replace(held, times=held.times[kept], outputs=None if held.outputs is None else held.outputs[kept])
        pieces = window_pieces(rest, window, t - window - late.radius, late)
        seen = sigma_of_pieces(plant, rest, pieces, RTOL, np.inf, reached=found)
        if seen.lower < least:
            least, worst = seen.lower, i
        found = seen if found is None or seen.upper < found.upper else found
    return least, worst


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
