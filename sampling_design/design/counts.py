"""Which counts of samples a requirement leaves open, and of which none is always at least as good as another."""

from __future__ import annotations

from sampling_design.design.problem.feasible import fewest_samples, obstacle
from sampling_design.design.problem.posing import pose
from sampling_design.design.problem.requirement import Requirement
from sampling_design.plants.plant import Plant


def rival_counts(plant: Plant, requirement: Requirement) -> list[int]:
    """The counts of samples to design for, largest first: those of which no larger one is always at least as good.

    A further sample never lowers sigma, but spacing, closed times and costs may leave no room for it. Raises
    InfeasibleRequirementError if no count that is asked for can be met.
    """
    wanted = requirement.samples
    if "exactly" in wanted:
        return [wanted["exactly"]]
    low = wanted.get("at_least", 1)
    room = pose(plant, requirement, low, check=False).capacity()
    if "at_most" not in wanted:
        high = min(room, _needed(plant, requirement, low))
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


def _needed(plant: Plant, requirement: Requirement, least: int) -> int:
    """The count from which every window holds measurements enough, or `least` if that is more."""
    problem = pose(plant, requirement, least, check=False)
    return max(least, problem.fixed.size, fewest_samples(problem))
