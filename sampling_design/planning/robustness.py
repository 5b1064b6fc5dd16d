"""What a plan bears: how late samples may be, and how many may be lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.records.arrays import Array
from sampling_design.records.record import PlainRecord, TableRecord, short
from sampling_design.records.units import spoken

LOST = ("none", "any one", "any two in a row")  # what may be lost, in words


@dataclass(frozen=True, eq=False, repr=False)
class PlanRobustness(TableRecord, PlainRecord):
    """How late samples may be, and how many may be lost, before a tolerance breaks.

    Attributes
    ----------
    time_unit : str
    times : (N,) array
        The samples of the period.
    late : (N,) array
        So late each may be, alone, with every tolerance kept: proven for this delay; for the multiples of `step` below
        it no trajectory was found that breaks one before that sample or in the gap after it.
    step : (N,) array
        Distance of the delays that were judged.
    late_ratio : (N,) array
        Accuracy over tolerance at that delay, at most: a bound that is no closer than 1 asks.
    lost : int
        So many samples in a row may be lost, whichever they are, with every tolerance kept; proven.
    lost_ratio : (N,) array
        Accuracy over tolerance if this sample is lost: up to 1 such a bound, above 1 attained by a trajectory on the
        grid, or, where none was found that breaks a tolerance, a bound.
    """

    time_unit: str
    times: Array
    late: Array
    step: Array
    late_ratio: Array
    lost: int
    lost_ratio: Array

    _frame = "time:times late late_ratio lost_ratio"

    @property
    def least_late(self) -> float:
        """Any one sample may be so late."""
        return float(np.min(self.late))

    def _rows(self) -> list[tuple[str, str]]:
        worst = float(np.max(self.lost_ratio))
        missed = f"{short(worst, 4)} of the tolerance" if np.isfinite(worst) else "beyond all bounds"
        step = spoken(float(np.min(self.step)), self.time_unit)
        late = spoken(self.least_late, self.time_unit) if self.least_late else f"less than {step}"
        return [
            ("any one sample may be late by", late),
            ("may be lost", f"{LOST[self.lost]}; after one at worst {missed}"),
        ]

    def explain(self) -> str:
        """Say what the plan bears."""
        late = self.least_late
        least = f"Not every sample may be {spoken(float(np.min(self.step)), self.time_unit)} late"
        text = f"Any one sample may be {spoken(late, self.time_unit)} late" if late else least
        text += (
            f" (judged in steps of {spoken(float(self.step[np.argmin(self.late)]), self.time_unit)})" if late else ""
        )
        lost = f"{LOST[self.lost]} may be lost" if self.lost else "no sample may be lost"
        worst = float(np.max(self.lost_ratio))
        after = f"the accuracy is then {100 * worst:.3g} % of the tolerance at worst" if np.isfinite(worst) else ""
        return f"{text}; {lost}{'; ' if after else ''}{after}."
