"""Are samples where the certificate's schedule says? Asked one sample at a time, in constant time."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

Array = npt.NDArray[np.float64]

TIME_TOLERANCE = 1e-9
"""Times that differ by less than this share of the larger one (or of the period) are the same time stamp."""


class ScheduleWatch:
    """Answers for a finite or periodic schedule, or a family of schedules, in the plant's time unit."""

    def __init__(self, schedule: Any, time_unit: str):
        unit = getattr(schedule, "time_unit", None)
        if unit not in (None, time_unit) and hasattr(schedule, "in_unit"):
            schedule = schedule.in_unit(time_unit)
        self.schedule = schedule

    def sample_fits(self, times: Array, mask: Array, first: bool) -> bool:
        """Whether the last of `times` (those kept so far) is as planned; `first` if only the prior lies before it.

        `mask` says which outputs it measured; more than planned is as good.
        """
        before, t = float(times[-2]), float(times[-1])
        if not isinstance(self.schedule, (Schedule, PeriodicSchedule)):
            return self._family_fits(times, first)
        due = self._next(before, first)
        if due is None or abs(due[0] - t) > self._slack(t):
            return False
        wanted = self.schedule.outputs
        return wanted is None or bool(np.all(mask[wanted[due[1]]] > 0))

    def nothing_missed(self, before: float, t: float, first: bool) -> bool:
        """Whether no sample was due after the one at `before` and ahead of t."""
        if not isinstance(self.schedule, (Schedule, PeriodicSchedule)):
            return t - before <= float(getattr(self.schedule, "d_max", np.inf)) + self._slack(t)
        due = self._next(before, first)
        return due is not None and due[0] >= t - self._slack(t)

    def _slack(self, t: float) -> float:
        period = self.schedule.period if isinstance(self.schedule, PeriodicSchedule) else 0.0
        return TIME_TOLERANCE * max(abs(t), period)

    def _next(self, before: float, first: bool) -> tuple[float, int] | None:
        """Time and row of the sample due after `before` (at or after it where `first`); None past the end."""
        slack = self._slack(before)
        limit = before - slack if first else before + slack
        # at time 0 the slack is 0, and yet a sample at `before` must not be due again
        side: Literal["left", "right"] = "left" if first else "right"
        lap = self.schedule.times
        if isinstance(self.schedule, Schedule):
            k = int(np.searchsorted(lap, limit, side))
            return (float(lap[k]), k) if k < lap.size else None
        period = self.schedule.period
        laps = max(0.0, np.floor((limit - lap[0]) / period))
        k = int(np.searchsorted(lap + laps * period, limit, side))
        return (float(lap[k] + laps * period), k) if k < lap.size else (float(lap[0] + (laps + 1) * period), 0)

    def _family_fits(self, times: Array, first: bool) -> bool:
        family = self.schedule
        gap, slack = float(times[-1] - times[-2]), self._slack(float(times[-1]))
        if gap > float(getattr(family, "d_max", np.inf)) + slack:
            return False
        if first:
            return True
        if gap < float(getattr(family, "min_gap", 0.0)) - slack:
            return False
        samples = times[1:] - times[0]
        return samples.size < 2 or bool(family.contains(Schedule(samples)))
