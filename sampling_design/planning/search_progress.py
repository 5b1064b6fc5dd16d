"""What a search for a plan tells on its way: the best so far, what no plan can beat as far as proven, and the gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.planning.problem import PlanProblem
from sampling_design.records.arrays import Mask
from sampling_design.records.budget import Budget
from sampling_design.records.progress import Progress

SEARCHED, PROVEN, AFTERWARDS = 0.6, 0.8, 0.9
"""How far a search comes, that and its bounds, and what else is said of a plan."""

HALF = 30.0  # seconds of work after which a search without an end counts as half done


@dataclass(eq=False)
class PlanProgress:
    """The figures so far of one call, its coarser grids included."""

    report: Progress | None
    problem: PlanProblem
    work: Budget  # that of the whole search
    best: str = ""
    reached: float = np.inf
    bound: float = 0.0
    done: float = 0.0

    def found(self, chosen: Mask, ratio: float) -> None:
        """Tell of a choice that is held, if it is the best so far; `ratio` is its accuracy over the tolerances."""
        if self._figure(chosen, ratio) < self.reached:
            self._known(chosen, ratio)
            self.say("searching")

    def proven(self, chosen: Mask, ratio: float) -> None:
        """Tell of the choice that is proven."""
        self._known(chosen, ratio)
        self.say("proven", PROVEN)

    def bounded(self, bound: float) -> None:
        """Tell of a bound that is proven."""
        self.bound = bound
        self.say("bounding", SEARCHED)

    @property
    def _cheapest(self) -> bool:
        return self.problem.requirement.aim == "cheapest"

    def _figure(self, chosen: Mask, ratio: float) -> float:
        return self.problem.cost(chosen) if self._cheapest else ratio

    def _known(self, chosen: Mask, ratio: float) -> None:
        self.reached = self._figure(chosen, ratio)
        samples, share = f"{int(chosen.any(axis=1).sum())} samples", f"{100 * ratio:.1f} % of the tolerance"
        self.best = f"cost {self.reached:g}, {samples}, {share}" if self._cheapest else f"{share}, {samples}"

    def say(self, message: str, fraction: float = 0.0) -> None:
        """Tell what is known, and what is done; by default as far on as the search's work."""
        if self.report is None:
            return
        spent, whole = self.work.spent, self.work.seconds
        searched = SEARCHED * (min(1.0, spent / whole) if np.isfinite(whole) else spent / (spent + HALF))
        self.done = max(self.done, fraction, searched)
        known = [self.best] if self.best else []
        if self.bound > 0:
            least = f"{self.bound:g}" if self._cheapest else f"{100 * self.bound:.1f} %"
            known += [f"none below {least}", f"gap {100 * max(1 - self.bound / self.reached, 0.0):.1f} %"]
        self.report(self.done, ", ".join([*known, message]))
