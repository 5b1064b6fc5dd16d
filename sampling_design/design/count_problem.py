"""Counts of samples: which a requirement leaves open, and the problem of one, relaxed and bounded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sampling_design.design.bounds.evidence import UpperBound, first_bound, quick_bound
from sampling_design.design.bounds.relaxation import Relaxation, relax_placed
from sampling_design.design.problem.canonical import CanonicalDesign, canonical
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.feasible import fewest_samples, obstacle
from sampling_design.design.problem.posing import pose
from sampling_design.design.problem.requirement import Requirement
from sampling_design.design.search.costs import relax_costly
from sampling_design.design.search.fedorov_exchange import even, is_admissible, repaired
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.records.evidence import SolverRecord


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
