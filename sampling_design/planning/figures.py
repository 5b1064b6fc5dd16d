"""What a plan is and reaches: its samples, its proofs, and the figures that follow from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.accuracy.accuracy import answer_of
from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.accuracy.deviation import StandardDeviation
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.timing import refuse_tolerance
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.checkers.strict import is_number
from sampling_design.errors import NotDetectableError
from sampling_design.observability.alignment import align
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import PlanProblem, RowGoal, pose_plan
from sampling_design.planning.requirement import PlanRequirement
from sampling_design.plants.functional import RequestedRows, requested_rows
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget
from sampling_design.records.record import PlainRecord, TableRecord, above
from sampling_design.records.units import SECONDS, spoken
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.opening import PlanClock
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.schedules.sensor import Sensor

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
        missed = f"{above(worst, 4)} of the tolerance" if np.isfinite(worst) else "beyond all bounds"
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
        after = (
            f": after one loss errors reach {above(100 * worst, 3)} % of the tolerance" if np.isfinite(worst) else ""
        )
        return f"{text}; {lost}{after}."


RTOL = 0.005  # width of the brackets that prove a plan


@dataclass(frozen=True, eq=False, repr=False)
class PlanStart(PlainRecord):
    """From when on a plan keeps its tolerances after its start, proven.

    Attributes
    ----------
    time_unit : str
    from_time : float
        Since the start; 0 where they are kept from the start on, infinite where nothing is proven.
    ratio : float
        Accuracy over tolerance from then on.
    bounded : bool
        Whether that rests on `initial_error`; else it holds whatever the error was, up to a million times what the
        plan's filter leaves of it later on. Of standard deviations nothing is known at the start, in either case.
    """

    time_unit: str
    from_time: float
    ratio: float
    bounded: bool
    _table = {"followed from its start": "{since}"}

    def since(self) -> str:
        """From when on, in words."""
        if not np.isfinite(self.from_time):
            return "not proven to keep the tolerances at any time"
        any_ = "for any initial error up to a million times what the samples leave"
        what = "for initial errors within `initial_error`" if self.bounded else any_
        when = f"{spoken(self.from_time, self.time_unit)} after it" if self.from_time else "the start"
        return f"the tolerances are kept from {when} on, {what}"

    def explain(self) -> str:
        """Say from when on the tolerances are kept."""
        return f"Once the plan is started, {self.since()} ({above(self.ratio, 3)} of each)."


def accuracy_question(problem: PlanProblem, chosen: Mask) -> tuple[AccuracyQuestion, RequestedRows] | None:
    """What is asked of a choice for the goals that are guaranteed, and their rows; None if it has none."""
    rows = [goal.row for goal in problem.goals if not goal.stochastic]
    if not rows:
        return None
    bounded = chosen & np.isfinite(problem.v_bound)
    if not bounded.any():
        raise NotDetectableError("`schedule` reads no sensor that has a `noise_bound`.")
    schedule = problem.schedule(bounded)
    delays = [None] * bounded.shape[1] if problem.result_delay is None else problem.result_delay.tolist()
    v = {
        name: Sensor(noise_bound=size if np.isfinite(size) else None, result_delay=delay)
        for name, size, delay in zip(problem.plant.outputs.names, problem.v_bound.tolist(), delays, strict=True)
    }
    late, plant = problem.timing_tolerance, problem.plant
    question = AccuracyQuestion.of(plant, align(plant, schedule), problem.requirement.w_bound, v, late=late)
    return question, requested_rows(plant, np.array(rows))


def accuracy_of(problem: PlanProblem, chosen: Mask, work: Budget | None = None) -> Accuracy | None:
    """The accuracy of a choice's goals that are guaranteed, as far as work lasts; None if it has none."""
    asked = accuracy_question(problem, chosen)
    if asked is None:
        return None
    question, rows = asked
    if question.is_late:
        refuse_tolerance(question, False)
    work = work or Budget()
    found = answer_of(question, rows, RTOL, work)  # about the middles
    if work.stopped:
        raise KeyboardInterrupt  # who asked holds other choices, whose proofs are whole
    return found


LEFT_OUT: dict[str, str] = {
    "bound": "how much more accurate a plan of this cost could be",
    "certificate": "a certificate that the samples show the whole state",
    "robustness": "how late samples may be and how many may be lost",
    "start": "from when on the tolerances are kept after the start",
}
"""What a search that is cut short may leave out, in words."""


@dataclass(frozen=True, eq=False, repr=False)
class PlanFigures(TableRecord, PlainRecord):
    """The entries of a `Plan`, which says what they mean, and what follows from them."""

    plant: Plant
    requirement: PlanRequirement
    schedule: PeriodicSchedule
    accuracy: Accuracy | None
    reached: Array
    bound: PlanBound
    status: str = "complete"
    certificate: Certificate | None = None
    robustness: PlanRobustness | None = None
    deviation: StandardDeviation | None = None
    left_out: tuple[str, ...] = ()
    start: PlanStart | None = None

    def missing(self) -> str:
        """What was asked for and left out, in words."""
        return "; ".join(LEFT_OUT[name] for name in self.left_out)

    @cached_property
    def problem(self) -> PlanProblem:
        """The numbers of the requirement, posed anew."""
        return pose_plan(self.plant, self.requirement)

    @property
    def error_bounds(self) -> ErrorBoundArguments:
        """The bounds that it was made with, as estimators take them; None where the requirement has none.

        An initial error that is no bound on the norm becomes half-widths about 0 that hold it.
        """
        wanted, noise, start = self.requirement, self.problem.v_bound, self.problem.initial
        error: VectorBound = None
        if start.whole:
            box = np.abs(start.centre) + [start.support(row, 1.0) for row in np.eye(start.centre.size)]
            error = wanted.initial_error if is_number(wanted.initial_error) else box
        return ErrorBoundArguments(
            w_bound=wanted.w_bound, v_bound=noise if np.isfinite(noise).all() else None, initial_error=error
        )

    @property
    def goals(self) -> tuple[RowGoal, ...]:
        """The goals as rows."""
        return self.problem.goals

    @cached_property
    def chosen(self) -> Mask:
        """What is measured at each step of the grid (M, p)."""
        return self.problem.chosen(self.schedule)

    @cached_property
    def oracle(self) -> AccuracyOracle:
        """Judges samples near this plan in floats; how far back it looks is found from the plan itself."""
        return self._judging(Budget(counted=True))

    def _judging(self, work: Budget) -> AccuracyOracle:
        oracle = AccuracyOracle(self.problem, discretize(self.problem), work)
        oracle.look_back(self.chosen)
        return oracle

    def count(self, work: Budget) -> None:
        """Count what the oracle does from now on, and did, as part of some work.

        Raises BudgetSpentError if that is more than there is left.
        """
        if "oracle" in vars(self):
            self.oracle.count(work)
        else:
            vars(self)["oracle"] = self._judging(work)

    @property
    def clock(self) -> PlanClock:
        """What the clocks show beside the real time."""
        return PlanClock(self.requirement.calendar, self.minutes(1.0))

    @property
    def samples(self) -> int:
        """Samples in a period."""
        return len(self.schedule)

    def minutes(self, t: float) -> float:
        """Minutes of a time since the start of the period."""
        return t * SECONDS[self.plant.time_unit] / 60

    @property
    def cost(self) -> float:
        """Price of a period; the number of samples where nothing has a price."""
        return self.problem.cost(self.chosen)

    def curve(self, k: int) -> tuple[Array, Array]:
        """Edges of panels over the period, and what is proven of a goal on each: a bound, or a standard deviation."""
        goal = self.goals[k]
        place = [g for g, other in enumerate(self.goals) if other.stochastic == goal.stochastic].index(k)
        if self.deviation is not None and goal.stochastic:
            times, values = self.deviation.times, self.deviation.profile[place]
            keep = np.flatnonzero(np.diff(times) > 0)
            return np.append(times[keep], times[-1]), np.maximum(values[keep], values[keep + 1])
        assert self.accuracy is not None
        return self.accuracy.profile.edges, self.accuracy.profile.upper[place]

    @property
    def ratio(self) -> float:
        """The largest ratio of a goal's accuracy to its tolerance."""
        return float(np.max([r / g.tolerance for r, g in zip(self.reached, self.goals, strict=True)], initial=0.0))

    @property
    def keeps(self) -> bool:
        """Whether every tolerance is kept, proven."""
        return self.ratio <= 1

    @property
    def gap(self) -> float:
        """The share of its accuracy that a plan of this cost could at most gain; 1 where nothing is proven."""
        proof = self.bound.ratio
        return 1.0 if proof is None or not self.goals else max(0.0, 1 - proof.level / self.ratio)
