"""What one sample is worth: sigma where it is missed once, or left out of every lap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._record import Record, short
from sampling_design.design.schedule_design import ScheduleDesign, prove, stated
from sampling_design.errors import ArgumentError
from sampling_design.observability.windows import WindowSigma
from sampling_design.schedules.schedule import PeriodicSchedule

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False, repr=False)
class SampleLosses(Record):
    """Sigma after the loss of each single sample of a lap.

    Attributes
    ----------
    times : (k,) array
        The lap's sample times.
    sigma : float
        Proven sigma of the whole schedule.
    lower, upper : (k,) array
        Proven and attained sigma without sample i.
    every_lap : bool
        Whether the sample is missing from every lap, or from a single one.
    """

    times: Array
    sigma: float
    lower: Array
    upper: Array
    every_lap: bool

    @property
    def price(self) -> Array:
        """What sigma loses without each sample, from proven to attained: at most sigma - lower."""
        return np.asarray(np.maximum(self.sigma - self.lower, 0.0))

    @property
    def dearest(self) -> int:
        """Index of the sample whose loss hurts most."""
        return int(np.argmin(self.lower))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, one entry per sample."""
        columns = zip(self.times.tolist(), self.lower.tolist(), self.upper.tolist(), strict=True)
        rows = [{"time": t, "lower": low, "upper": up} for t, low, up in columns]
        return {"sigma": self.sigma, "every_lap": self.every_lap, "without": rows}

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("lost", "in every lap" if self.every_lap else "once"), ("sigma with all", short(self.sigma))]
        return rows + [(f"without t = {short(t)}", short(v)) for t, v in zip(self.times, self.lower, strict=True)]

    def explain(self) -> str:
        """Say which sample matters most."""
        i = self.dearest
        how = "left out of every lap" if self.every_lap else "missed once"
        return (
            f"If the sample at {short(self.times[i])} is {how}, sigma falls from {short(self.sigma)} "
            f"to {short(self.lower[i])}; no other single loss costs more."
        )


def sample_losses(
    design: ScheduleDesign, *, every_lap: bool = False, rtol: float = 0.001, progress: Progress | None = None
) -> SampleLosses:
    """Prove sigma over all window positions after each single loss of a sample.

    Parameters
    ----------
    design : ScheduleDesign
    every_lap : bool
        Leave the sample out of every lap (its price), or miss it once (a window that spans several laps
        then keeps the sample of the others).
    rtol : float
        As for `window_sigma`.
    progress : callable, optional
        Called with the fraction done and a message.

    Returns
    -------
    SampleLosses

    Raises
    ------
    ArgumentError
        If the design has no schedule.
    """
    if not isinstance(design, ScheduleDesign) or design.schedule is None:
        raise ArgumentError("`design` must be a ScheduleDesign with a schedule; there is no sample to lose.")
    _checks.positive("rtol", rtol)
    proofs: list[WindowSigma | None] = []
    for i in range(len(design.schedule)):
        rest = _without(design, i, every_lap)
        proofs.append(
            None if rest is None else stated(prove(design.split, rest, design.requirement, rtol), design.requirement)
        )
        if progress:
            progress((i + 1) / len(design.schedule), f"without sample {i + 1}")
    lower, upper = (np.array([0.0 if w is None else getattr(w, key) for w in proofs]) for key in ("lower", "upper"))
    return SampleLosses(design.schedule.times, design.sigma, _checks.freeze(lower), _checks.freeze(upper), every_lap)


def _without(design: ScheduleDesign, i: int, every_lap: bool) -> PeriodicSchedule | None:
    """The schedule without sample i of each lap, or of one lap in as many as a window can touch, plus one."""
    schedule = design.schedule
    assert schedule is not None
    laps = 1 if every_lap else int(np.ceil(float(design.requirement.window or 0) / schedule.period)) + 1
    times = (schedule.times + schedule.period * np.arange(laps)[:, None]).ravel()
    if times.size == 1:
        return None
    keep = np.arange(times.size) != i
    mask = None if schedule.outputs is None else np.tile(schedule.outputs, (laps, 1))[keep]
    details: dict[str, Any] = {"time_unit": schedule.time_unit, "output_names": schedule.output_names}
    return PeriodicSchedule.from_times(times[keep], laps * schedule.period, mask, **details)
