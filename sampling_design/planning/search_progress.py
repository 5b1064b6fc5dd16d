"""What a search for a plan tells on its way: the best so far, what no plan can beat as far as proven, and the gap.

What work costs that is counted, never timed: a search that stops after so much finds the same plan on every machine.

The unit is about a second of an ordinary processor core, worked out from the sizes of what is solved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.planning.problem import PlanProblem
from sampling_design.records.arrays import Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.declarations import below

CONE = (1e-3, 2e-6)  # work of a cone program, and for each entry that is not zero
STAGES = (1e-2, 1.5e-5)  # of a program over stages, and for each of them, with n states, n^1.5 times
EXCESS = (2e-3, 4e-6)  # the same where every output is a variable
WINDOW = (3e-4, 1.7e-5)  # of posing one in a window of samples, and for each of them
SIMULATED = (2e-4, 1.9e-5, 4e-6)  # of simulating what it found, and for each sample and each step of the grid

COVER, NODE = (5e-3, 2e-5), 0.2
"""Of an integer program, and for each entry; a node of its tree more costs so much of that."""

ROW, VIEW = (0.0, 3e-5), (0.0, 2.4e-7)
"""Of a row of a trajectory in a program; of looking where a point breaks one, for each of them and step."""

MEETING = (4e-5, 2e-9)  # of a node of a tree of sets that a choice must meet, and for each entry of them

WEIGHED = (1.2e-4, 2e-9)
"""For each trajectory, of weighing what may take the place of a measurement, and for each end and measurement."""

FILTER = (4e-5, 1e-7)  # of each step of a filter, and for each choice, step and state

SEQUENCE = (1e-3, 5e-5)
"""The same through samples that leave a plan for a while: for each of them, with n states, n times."""

RELAXED = (5e-3, 3e-6)  # of a linear program, and for each entry
GAINS = (5e-3, 1e-4)  # of bounding a row by gains, and for each sample behind it, with n states, n times
BETWEEN = 1e-2  # of bounding a row between two samples
SYSTEM = (1e-2, 2e-4)  # of making a sampled system, and for each of them, with n states, n^2 times

STARTED = (0.0, 5e-5)
"""The same from a plan's start on: for N samples, of which a filter with n states forgets F, n N F times."""

CERTIFIED = (1.5, 0.06)  # of a certificate, and for each sample, with n states, n^2 times

AFTER = ((0.1, 1.0), (0.2, 1.5), (1.0, 2.0))
"""By what share of itself, and how many seconds, a budget may be exceeded: after the proof of the least cost, after
that of the best accuracy, and in the end."""


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
        """Tell what is known, and what is done; by default as far on as the search's work. Not once it is stopped."""
        if self.report is None or self.work.stopped:
            return
        spent, whole = self.work.spent, self.work.seconds
        searched = SEARCHED * (min(1.0, spent / whole) if np.isfinite(whole) else spent / (spent + HALF))
        self.done = max(self.done, fraction, searched)
        known = [self.best] if self.best else []
        if self.bound > 0:
            least = below(self.bound) if self._cheapest else f"{below(100 * self.bound, 3)} %"
            known += [f"none below {least}", f"gap {100 * max(1 - self.bound / self.reached, 0.0):.1f} %"]
        self.report(self.done, ", ".join([*known, message]))
