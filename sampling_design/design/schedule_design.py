"""The result of a design: schedule, proven sigma, the bound that none can beat, and all that a re-check needs.

And counts of samples: which a requirement leaves open, and the problem of one, relaxed and bounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sampling_design.design.bounds.evidence import UpperBound, first_bound, quick_bound
from sampling_design.design.bounds.relaxation import Relaxation, relax_placed
from sampling_design.design.problem.canonical import CanonicalDesign, canonical
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.feasible import fewest_samples, obstacle
from sampling_design.design.problem.posing import pose, split_of
from sampling_design.design.problem.requirement import Requirement
from sampling_design.design.search.costs import relax_costly
from sampling_design.design.search.fedorov_exchange import even, is_admissible, repaired
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.observability.count.zero_count import ZeroCountBound, default_window, zero_count_bound
from sampling_design.observability.sigma_bracket import SigmaDeviations, coordinates_of
from sampling_design.observability.windows.window_record import WindowSigma
from sampling_design.observability.windows.window_sigma import deviations_of, window_sigma
from sampling_design.plants.functional import counted_rows, rows_in_words
from sampling_design.plants.modes import ModalSplit, split_modes
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import ENDLESS, Budget, Progress
from sampling_design.records.record import (
    ANSWERS,
    Claim,
    Plain,
    PlainRecord,
    SolverRecord,
    above,
    below,
    counted,
    moment,
    short,
)
from sampling_design.records.units import spoken
from sampling_design.schedules.jitter import TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule


def rival_counts(plant: Plant, requirement: Requirement) -> list[int]:
    """The counts of samples to design for, largest first: those of which no larger one is always at least as good.

    A further sample never lowers sigma, but spacing, closed times and costs may leave no room for it. Raises
    InfeasibleRequirementError if no count that is asked for can be met.
    """
    wanted = requirement.samples
    if "exactly" in wanted:
        return [wanted["exactly"]]
    low = wanted.get("at_least", 1)
    problem = pose(plant, requirement, low, check=False)
    room = problem.capacity()
    if "at_most" not in wanted:  # up to where every window holds measurements enough
        high = min(room, max(low, problem.fixed.size, fewest_samples(problem)))
        return [next((k for k in range(low, high + 1) if _can_be(plant, requirement, k)), low)]
    high = max(min(wanted["at_most"], room), low)
    counts: list[int] = []
    for samples in range(high, low - 1, -1):
        if counts and pose(plant, requirement, samples + 1, check=False).always_has_room and counts[-1] == samples + 1:
            break  # all smaller ones have room for one more too
        if _can_be(plant, requirement, samples):
            counts.append(samples)
    return counts or [high]


def _can_be(plant: Plant, requirement: Requirement, samples: int) -> bool:
    return obstacle(pose(plant, requirement, samples, check=False)) is None


@dataclass(frozen=True, eq=False)
class CountProblem:
    """One count of samples: its problem, the relaxation to round, and the smaller of the bounds.

    The relaxation and `inner`, the bound as it was found, are in canonical units; `bound` is that of the problem.
    """

    canon: CanonicalDesign
    relaxation: Relaxation
    inner: UpperBound
    bound: UpperBound
    solver: tuple[SolverRecord, ...]

    @property
    def problem(self) -> DesignProblem:
        """The problem as it was posed."""
        return self.canon.outside


def bounded(
    problem: DesignProblem, budget: Budget = ENDLESS, progress: Callable[[float], None] | None = None
) -> CountProblem:
    """Relax and bound one count of samples.

    `progress` is called with a first bound, before smaller ones are sought.
    """
    canon = canonical(problem)
    placed = (relax_costly if canon.inside.is_costly else relax_placed)(
        canon.inside, seconds=budget.seconds_left(share=1 / 3)
    )
    if progress:
        progress(quick_bound(canon.inside, placed).value * canon.size)
    inner = first_bound(canon.inside, placed, budget)
    return CountProblem(canon, placed, inner, inner.brought_back(canon), (placed.record,))


def brought_back(canon: CanonicalDesign, found: Array, chosen: Mask) -> tuple[Array, Mask]:
    """Times found in canonical units as those of the problem itself, pushed apart where rounding asks for it."""
    times, chosen = canon.times(found, chosen)
    if is_admissible(canon.outside, times):
        return times, chosen
    again = repaired(canon.outside, times)
    return (times, chosen) if again is None else (again, chosen)


def candidates(problem: DesignProblem, times: Array, chosen: Mask) -> list[tuple[Array, Mask]]:
    """What to prove: the best found, and even spacing where samples may enter at the instant at which others leave.

    Even spacing is best there if its times are exact to the last bit; the search does not count on that.
    """
    candidates = [(times, chosen)]
    ratio = problem.window * problem.samples / problem.period
    exact = abs(ratio - round(ratio)) < 1e-9 and problem.window % problem.period > 0
    if exact and problem.is_shift_invariant and not problem.is_costly:
        spread = even(problem, 0.0)
        candidates += [] if spread is None else [(spread, problem.mask(spread))]
    return candidates


VACUOUS = 100.0  # times sigma from which on a bound on all schedules says nothing of the one that was found


class ErrorDecay(NamedTuple):
    """How fast an error dies by itself, and which samples would show the slow modes."""

    to_a_tenth: float  # [plant.time_unit]
    decay_rate: float  # that retains the slow modes
    window: float  # [plant.time_unit]
    needed: int  # samples that determine the slow modes, wherever they lie in a window; 0 where none does
    hidden: str  # modes that no output shows, in words
    counts: tuple[int, ...]  # of samples in `to_a_tenth` whose accuracies say what samples buy


@dataclass(frozen=True, eq=False, repr=False)
class ScheduleDesign(PlainRecord):
    """A designed schedule, what it proves, and how far from the best it can be.

    Attributes
    ----------
    schedule : PeriodicSchedule or None
        None where nothing has to be observed.
    sigma : float
        Proven lower bound over every real window position; of the state at the window's start.
    sigma_attained : float
        Least value that was evaluated; the true worst sigma lies between the two.
    upper_bound : float
        No admissible schedule over all real times has a larger worst sigma.
    gap : float
        1 - sigma/upper_bound: the share that a better schedule could at most gain.
    requirement : Requirement
        With all defaults filled in, in the plant's time unit.
    defaults_used : dict
        What was filled in, and a notice where the default count was cut.
    split : ModalSplit
        What is retained; sigma refers to the scaled coordinates of `split.retained`, where the plant has scales.
    zero_count : ZeroCountBound or None
    window : WindowSigma or None
        The proof of sigma, with its curve and its worst window: what `window_sigma(split.retained, ...)` says.
    bound : UpperBound or None
        The multipliers that prove `upper_bound`.
    history : tuple of dict
        Every start of the search and where it led.
    status : str
        "complete"; "budget" and "interrupted", cut short; "unobservable": no admissible schedule makes every
        state observable; "none found": none was found, and the bound does not show that there is none; or "no samples
        needed".
    other_counts : dict of int to UpperBound
        With "at_most": the bounds of the other counts of samples, as far as these need one of their own; every
        schedule of any count left out can take one sample more, and sees no less then.
    seconds : float
        That the search was given; `deviations` take as many at most.
    """

    schedule: PeriodicSchedule | None
    sigma: float
    sigma_attained: float
    upper_bound: float
    requirement: Requirement
    defaults_used: dict[str, Plain]
    plant: Plant
    split: ModalSplit
    zero_count: ZeroCountBound | None
    window: WindowSigma | None
    bound: UpperBound | None
    history: tuple[dict[str, Plain], ...] = ()
    solver: tuple[SolverRecord, ...] = ()
    status: str = "complete"
    notes: tuple[str, ...] = field(default=())
    other_counts: dict[int, UpperBound] = field(default_factory=dict)
    seconds: float = np.inf

    _plain = (
        "format:_format status claim plant requirement defaults_used retained_states:split.retained.n_states schedule "
        "coordinates sigma sigma_attained upper_bound gap deviations cost zero_count bound other_counts "
        "history solver notes"
    )
    _format = "sampling-design/design/1"

    @property
    def gap(self) -> float:
        """1 - sigma/upper_bound; 0 where nothing has to be observed."""
        if self.schedule is None or self.upper_bound == 0:
            return 0.0
        return max(0.0, 1.0 - self.sigma / self.upper_bound)

    @property
    def bound_is_vacuous(self) -> bool:
        """Whether the bound on all schedules is so far above sigma that it says nothing of this one."""
        return self.schedule is not None and self.upper_bound > VACUOUS * self.sigma

    @property
    def coordinates(self) -> str:
        """Which coordinates sigma, the bound and the gap refer to."""
        return coordinates_of(self.split.plant, self.split.retained)

    @property
    def cost(self) -> float:
        """Price of one period: the sum of the outputs' costs over all measurements."""
        if self.schedule is None:
            return 0.0
        prices = np.array([_cost(self.requirement, name) for name in self.plant.outputs.names])
        mask = self.schedule.outputs
        return float(np.sum(prices) * len(self.schedule) if mask is None else np.sum(mask * prices))

    @cached_property
    def deviations(self) -> SigmaDeviations | None:
        """What is left of sigma if samples come early or late or one is lost.

        None where nothing has to be observed, or `seconds` are too few.
        """
        if self.schedule is None or not self.sigma > 0:
            return None
        window = float(self.requirement.window or 0)
        return deviations_of(self.split.retained, self.schedule, window, self.late, self.sigma, seconds=self.seconds)

    @property
    def late(self) -> TimingTolerance:
        """How early or late samples may come, as was asked."""
        return TimingTolerance.of(self.requirement.timing_tolerance, self.plant.outputs.names)

    @cached_property
    def problem(self) -> DesignProblem:
        """The numbers of the design, posed anew from plant and requirement."""
        samples = 1 if self.schedule is None else len(self.schedule)
        return pose(designed_plant(self.split), self.requirement, samples, counted=counted_rows(self.split))

    @property
    def claim(self) -> Claim:
        """What is claimed, and how strongly."""
        if self.schedule is None:
            return Claim("no samples needed: nothing is retained", theorem="Theorem 16", strength="proven")
        times = (f"samples are {self.late.describe(self.plant.time_unit)}",) if self.late else ()
        length = f"{short(self.requirement.window)} {self.plant.time_unit}"
        return Claim(
            f"sigma >= {below(self.sigma)} over every window of {length}, and no admissible schedule with "
            f"{self._counts} samples per period exceeds {above(self.upper_bound)}",
            theorem="Theorems 14 and 16; weak duality",
            assumptions=("the plant's matrices are exact", *times, f"sigma in {self.coordinates} coordinates"),
        )

    def verify(self, rtol: float | None = None) -> bool:
        """Work out sigma and the bound anew from the data alone, and whether the schedule is admissible.

        Parameters
        ----------
        rtol : float, optional
            As for `window_sigma`. Default: that with which sigma was proven.

        Returns
        -------
        bool
            True where the new proofs carry the stated numbers (to 1e-6 relative) and every constraint holds.
        """
        mine = replace(self, split=split_of(self.plant, self.requirement))
        return mine.split.retained.n_states == self.split.retained.n_states and mine._holds(rtol)

    def _holds(self, rtol: float | None) -> bool:
        """The same of a design whose split is that of its plant."""
        if self.schedule is None:
            least = min(self.sigma, self.sigma_attained, self.upper_bound)
            return self.split.retained.n_states == 0 and least == np.inf
        if self.bound is None or not self._is_admissible() or not self._is_affordable():
            return False
        width = 0.001 if self.window is None else self.window.rtol
        proof = prove(self.split, self.schedule, self.requirement, width if rtol is None else rtol)
        holds = self.sigma * (1 - 1e-6) <= proof.lower <= self.sigma_attained * (1 + 1e-6)
        return holds and self._bounds_hold()

    @property
    def _counts(self) -> str:
        """For which counts of samples the bound holds, in words."""
        wanted = self.requirement.samples
        if self.requirement.target_sigma is None and "at_most" in wanted:
            low, high = wanted.get("at_least"), wanted["at_most"]
            return f"at most {high}" if low is None else f"{low} to {high}"
        return str(len(self.schedule or ()))

    def _bounds_hold(self) -> bool:
        """Whether the bounds of all counts that were asked for, worked out anew, carry the stated one."""
        assert self.schedule is not None
        assert self.bound is not None
        if self.requirement.target_sigma is None and "at_most" in self.requirement.samples:
            plant = designed_plant(self.split)
            counts = rival_counts(plant, self.requirement)
            if {len(self.schedule), *self.other_counts} < set(counts):
                return False
            rest = [
                b.value_for(pose(plant, self.requirement, k, check=False, counted=counted_rows(self.split)))
                for k, b in self.other_counts.items()
            ]
        else:
            rest = []
        return max([self.bound.value_for(self.problem), *rest]) <= self.upper_bound * (1 + 1e-6)

    def _is_admissible(self) -> bool:
        """Whether the schedule keeps period, counts, spacing, forbidden and fixed times."""
        assert self.schedule is not None
        wanted, many, period = self.requirement.samples, len(self.schedule), self.problem.period
        low, high = (wanted.get("exactly", wanted.get(key, many)) for key in ("at_least", "at_most"))
        counts = low <= many <= high or self.requirement.target_sigma is not None
        same = bool(np.isclose(self.schedule.period, period, rtol=1e-12))
        return counts and same and is_admissible(self.problem, self.schedule.times)

    def _is_affordable(self) -> bool:
        """Whether the schedule measures only what is available, within the cost limit."""
        assert self.schedule is not None
        there = self.problem.mask(self.schedule.times)
        used = there if self.schedule.outputs is None else self.schedule.outputs
        complete = self.schedule.outputs is not None or bool(there.all())
        return complete and not bool(np.any(used & ~there)) and self.cost <= self.problem.cost_limit * (1 + 1e-9)

    _answers = ("{_what}", "{claim.evidence}", "{_good}", "`.verify()`")

    def _answered(self, most: int = len(ANSWERS)) -> list[tuple[str, str]]:
        found = super()._answered(most)
        return found if self.schedule is not None else [each for each in found if each[0] != ANSWERS[-1]]

    def _what(self) -> str:
        if self.schedule is None:
            return "no samples needed"
        return f"{counted(len(self.schedule), 'sample')} every {short(self.schedule.period)} {self.plant.time_unit}"

    def _good(self) -> str:
        if self.schedule is None:
            return "every mode decays by itself at the rate asked for"
        least = f"sigma at least {below(self.sigma)}, of no schedule more than {above(self.upper_bound)}"
        gap = (
            "a bound that says nothing of this design" if self.bound_is_vacuous else f"gap {above(100 * self.gap, 3)} %"
        )
        return f"{least}: {gap} ({self.coordinates} coordinates, state at the window's start)"

    def _rows(self) -> list[tuple[str, str]]:
        if self.schedule is None:
            return [*self._unobserved().items()]
        unit = self.plant.time_unit
        rows = [
            *([] if self.deviations is None else self.deviations._rows()),
            ("over every window", f"of {short(self.requirement.window)} {unit} (half-open, at every real position)"),
            ("period", f"{short(self.requirement.period)} {unit}"),
            ("spacing", f"{short(self.schedule.gaps.min())} (asked {short(self.requirement.spacing)}) {unit}"),
            ("times", f"{moment(self.schedule.times, self.problem.breakpoints)} {unit}"),
            ("retained", f"{self.split.retained.n_states} of {self.plant.n_states} states"),
            ("status", self.status),
        ]
        if self.cost:
            limit = self.requirement.cost_limit
            rows.append(("cost of a period", short(self.cost) + ("" if limit is None else f" of {short(limit)}")))
        return rows

    @cached_property
    def decay(self) -> ErrorDecay | None:
        """How fast an error dies by itself and which samples show the slow modes; None where samples are needed."""
        slowest = max((float(each.value.real) for each in self.split.clusters), default=-np.inf)
        if self.schedule is not None or not slowest > -np.inf:
            return None
        more = split_modes(self.split.plant, float(f"{-2.2 * slowest:.2g}"))
        window, hidden = (
            float(f"{default_window(more) or 1.0:.3g}"),
            unobservable_modes(self.split.plant, more.decay_rate),
        )
        needed = 0 if len(hidden) else zero_count_bound(more.retained, window).samples_needed
        lasts = float(f"{np.log(10) / -slowest:.3g}")
        counts = (0, needed, 4 * needed) if needed else (0,)
        return ErrorDecay(lasts, more.decay_rate, window, needed, hidden.describe() if len(hidden) else "", counts)

    def _unobserved(self) -> dict[str, str]:
        """Where no samples are needed: how fast an error dies by itself, what samples buy, and what to type."""
        plant, unit, decay = self.split.plant, self.plant.time_unit, self.decay
        if decay is None:
            return {"by itself": "there is no state"}
        pushed = np.abs(np.linalg.solve(plant.A, plant.G)) @ plant.disturbances.scales
        left = [f"{name} {short(by, 3)}" for name, by in zip(plant.states.labels(), pushed, strict=True)]
        with_samples = f"no output shows {decay.hidden}, so that none helps against it"
        if decay.needed:
            with_samples = (
                f"{decay.needed} in every {spoken(decay.window, unit)}, wherever they lie, determine the slow "
                f"modes: ask for them with decay_rate={decay.decay_rate:g} (--decay-rate {decay.decay_rate:g})"
            )
        return {
            "an error falls by itself": f"to a tenth within {spoken(decay.to_a_tenth, unit)}",
            "disturbances of typical size that stay leave, without samples": ", ".join(left[:6]),
            "with samples": with_samples,
            "what they buy": (
                f"sd.accuracy.accuracy_by_count(plant, {decay.counts}, period={decay.to_a_tenth:g}, w_bound=..., "
                "v_bound=...)"
            ),
        }

    def explain(self) -> str:
        """Say what was designed and how good it is."""
        rows = "" if self.requirement.of is None else rows_in_words(self.requirement.of)
        if self.schedule is None:
            entering = rows and f" that enters {rows}"
            rates = ". ".join(f"{what[0].upper()}{what[1:]}: {value}" for what, value in self._unobserved().items())
            return f"No samples needed: every mode{entering} decays by itself at the rate asked for. {rates}."
        tolerance, unit = self.late, self.plant.time_unit
        many = self._what()
        if not self.sigma > 0:
            window = (
                f"{rows or 'every state'} in every window of {short(self.requirement.window)} {self.plant.time_unit}"
            )
            if self.upper_bound == 0:
                return f"No admissible schedule with {many} makes {window} observable: sigma is 0 for all of them."
            if tolerance and self.sigma_attained > 0:
                return (
                    f"No schedule with {many}, each {tolerance.describe(unit)}, is proven to make {window} observable: "
                    f"of the one found no sigma below {below(self.sigma_attained)} is known, and none exceeds "
                    f"{above(self.upper_bound)}. Ask for a smaller `timing_tolerance`."
                )
            return (
                f"No schedule with {many} was found that makes {window} observable; sigma of none exceeds "
                f"{above(self.upper_bound)}, which does not show that there is none."
            )
        makes = "makes" if len(self.schedule) == 1 else "make"
        late = f", each {tolerance.describe(unit)}" if tolerance else ""
        left = "" if self.deviations is None else f" {self.deviations.explain()}"
        near = f"an optimality gap of {above(100 * self.gap, 3)} %"
        if self.bound_is_vacuous:
            near = "a bound so far off that it says nothing of how near the best this schedule is"
        return (
            f"{many} {makes} {rows or 'every state'} observable in every window, with sigma >= "
            f"{below(self.sigma)}{late}; no admissible schedule can exceed {above(self.upper_bound)}, {near}.{left}"
        )


def designed_plant(split: ModalSplit) -> Plant:
    """The plant whose sigma is designed: the retained part, in the coordinates that `window_sigma` refers to."""
    return split.retained.scaled() if split.retained.has_scales else split.retained


def prove(
    split: ModalSplit,
    schedule: PeriodicSchedule,
    requirement: Requirement,
    rtol: float,
    progress: Progress | None = None,
    budget: float | None = None,
) -> WindowSigma:
    """Sigma of the retained part over all real window positions."""
    found = window_sigma(
        split.retained, schedule, float(requirement.window or 0), rtol, budget=budget, progress=progress,
        timing_tolerance=TimingTolerance.of(requirement.timing_tolerance).plain,
    )  # fmt: skip
    return replace(found, coordinates=coordinates_of(split.plant, split.retained))


def _cost(requirement: Requirement, name: str) -> float:
    term = requirement.sensors.get(name)
    return 0.0 if term is None else term.price
