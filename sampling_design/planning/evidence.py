"""The evidence of a plan's bounds: trajectories in numbers, checked by flying them again, and the proofs over them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sampling_design.planning.adversary_program import fly
from sampling_design.planning.cost_proof import CostProof, proven_cost
from sampling_design.planning.covering import CoveringRows
from sampling_design.planning.discrete_plant import DiscretePlant
from sampling_design.planning.filter_deviation import GridFilter
from sampling_design.planning.hidden_trajectories import HiddenTrajectories, HiddenTrajectory, peaks_of
from sampling_design.planning.problem import PlanProblem
from sampling_design.records.arrays import Mask

KEPT = 1e-7  # share by which a motion that is flown anew is scaled down beyond what it exceeds: rounding of its path

EASED = 1 - 1e-5
"""Levels are stated this much lower than they were proven at, so that what is flown anew proves them, not nearly: the
tolerance of a bound is on the safe side."""


@dataclass(frozen=True, eq=False)
class PlanBound:
    """What no admissible plan can do.

    Attributes
    ----------
    trajectories : tuple of HiddenTrajectory
        Those that the proofs use.
    ratio : CostProof or None
        No plan of this cost has an accuracy below `ratio.level` times all tolerances: what was proven less 1e-5 of it,
        a hundred times what its rounding comes to.
    cost : CostProof or None
        No plan keeps the tolerances for less than `cost.value`.
    """

    trajectories: tuple[HiddenTrajectory, ...]
    ratio: CostProof | None
    cost: CostProof | None


def gathered(pool: HiddenTrajectories, ratio: CostProof | None, cost: CostProof | None) -> PlanBound:
    """Return the bound with no more trajectories than its proofs use."""
    used = sorted({key[0] for proof in (ratio, cost) if proof is not None for key in proof.keys})
    place = {a: k for k, a in enumerate(used)}

    def moved(proof: CostProof | None) -> CostProof | None:
        if proof is None:
            return None
        return CostProof(proof.level * EASED, proof.value, tuple((place[a], end) for a, end in proof.keys), proof.tree)

    return PlanBound(tuple(pool.trajectories[a] for a in used), moved(ratio), moved(cost))


def broken_below(bound: PlanBound, cover: CoveringRows) -> dict[int, list[int]]:
    """Goals and steps of the trajectories by which the cost is proven: a choice for less leaves one of them hidden.

    That goal is then beyond its tolerance at that step; of a plan that may be turned, turned as the proof has it.
    """
    found: dict[int, set[int]] = {}
    if bound.cost is not None:
        frame = int(cover.frame[0].shape[0])
        for leaf in bound.cost.tree.leaves():
            for row, multiplier in zip(leaf.rows, leaf.values, strict=True):
                if row >= frame and multiplier > 0:
                    a, end = bound.cost.keys[row - frame]
                    found.setdefault(bound.trajectories[a].goal, set()).add(end % cover.problem.steps)
    return {goal: sorted(found[goal]) for goal in sorted(found)}


def reflown(problem: PlanProblem, motion: DiscretePlant, trajectory: HiddenTrajectory) -> HiddenTrajectory | None:
    """A trajectory as its flight, flown anew and made admissible, proves it; None if the flight is not one motion.

    Of a tangent: the filter run anew.
    """
    flight = trajectory.flight
    if flight is None:
        return _filtered(problem, motion, trajectory)
    if flight.states[0].any() or flight.knots[0] != 0:
        return None
    w = flight.w.copy()
    for k in range(len(flight.knots) - 1):
        a, b = int(flight.knots[k]), int(flight.knots[k + 1])
        part = fly(motion, np.zeros(1, dtype=np.intp), flight.states[k : k + 1], w[a:b])
        blocks, F = np.zeros((motion.n, (b - a) * w.shape[1])), np.eye(motion.n)
        for i in range(b - a - 1, -1, -1):
            blocks[:, i * w.shape[1] : (i + 1) * w.shape[1]] = F @ motion.Gamma
            F = F @ motion.F
        left = flight.states[k + 1] - part.path[-1]
        change = np.linalg.lstsq(blocks, left, rcond=1e-12)[0]
        size = np.abs(blocks) @ np.ones(blocks.shape[1]) + np.abs(F) @ np.abs(flight.states[k])
        if np.any(np.abs(left - blocks @ change) > 1e-12 * size):
            return None
        w[a:b] += change.reshape(b - a, -1)
    flown = fly(motion, flight.knots, flight.states, w)
    factor = max(flown.size(motion.ball), 1.0) * (1 + KEPT)
    row = motion.rows(problem.goals[trajectory.goal].row[None])[0]
    reach = float(row @ flown.path[-1]) / factor / problem.goals[trajectory.goal].tolerance
    seen = peaks_of(flown.path @ motion.H.T / factor, problem.steps, trajectory.at_sample, problem.unread_steps)
    peaks = seen * (1 + 2 * KEPT)
    if reach <= 0 or (trajectory.at_sample and problem.unread_steps is not None):
        return None
    return HiddenTrajectory(trajectory.goal, reach, trajectory.end, trajectory.at_sample, np.asarray(peaks), flight)


def _filtered(problem: PlanProblem, motion: DiscretePlant, trajectory: HiddenTrajectory) -> HiddenTrajectory | None:
    """A tangent worked out anew where it touches, by the filter from nothing unknown on."""
    z = np.roll(trajectory.touches, -((trajectory.end + 1) % problem.steps), axis=0)[::-1]
    if not problem.goals[trajectory.goal].spread or np.any(z < 0) or np.any(z > 1):
        return None
    found = GridFilter(problem, motion).tangent_at(z, trajectory.goal, trajectory.end)
    return None if found is None else replace(found, reach=found.reach * (1 - KEPT), end=trajectory.end)


def holds(
    bound: PlanBound, cover: CoveringRows, limited: CoveringRows, motion: DiscretePlant, ends: list[Mask], most: float
) -> bool:
    """Whether both proofs hold: trajectories flown anew, multipliers added up anew.

    `cover` has no limits of its own; `limited` has those of the requirement; `most` is what the ratio's plans may cost.
    """
    pool = HiddenTrajectories(cover.problem.steps, ends)
    for trajectory in bound.trajectories:
        flown = reflown(cover.problem, motion, trajectory)
        if flown is None or flown.reach < trajectory.reach * (1 - 1e-6):
            return False
        pool.add(flown)
    for proof, frame, least in ((bound.ratio, limited, most), (bound.cost, cover, None)):
        if proof is None:
            continue
        if any(pool.trajectories[a].reach < proof.level for a, _ in proof.keys):
            return False
        value = proven_cost(frame, pool, proof)
        if value < proof.value * (1 - 1e-9) or (least is not None and value <= least):
            return False
    return True


def trajectory_to_dict(trajectory: HiddenTrajectory) -> dict[str, object]:
    """Plain data; peaks are left out, since they are worked out anew."""
    flight = trajectory.flight
    data: dict[str, object] = {key: getattr(trajectory, key) for key in ("goal", "end", "at_sample", "reach")}
    if flight is None:
        touched = np.argwhere(trajectory.touches).tolist()
        return data | {"point": [[*at, float(trajectory.touches[tuple(at)])] for at in touched]}
    return data | {key: getattr(flight, key).tolist() for key in ("knots", "states", "w")}


def trajectory_of(problem: PlanProblem, motion: DiscretePlant, data: dict[str, object]) -> HiddenTrajectory:
    """A trajectory from plain data that a strict reader has passed."""
    if "point" in data:
        point, end = np.zeros(problem.allowed.shape), int(str(data["end"]))
        for back, sensor, share in np.array(data["point"], dtype=float).reshape(-1, 3):
            point[int(back), int(sensor)] = share
        reach, at_sample = float(str(data["reach"])), bool(data["at_sample"])
        return HiddenTrajectory(int(str(data["goal"])), reach, end, at_sample, np.zeros_like(point), None, point)
    knots = np.array(data["knots"], dtype=np.intp)
    flight = fly(motion, knots, np.array(data["states"]), np.array(data["w"]))
    at_sample = bool(data["at_sample"])
    peaks = peaks_of(flight.path @ motion.H.T, problem.steps, at_sample, problem.unread_steps)
    return HiddenTrajectory(
        int(str(data["goal"])), float(str(data["reach"])), int(str(data["end"])), at_sample, peaks, flight
    )


def proof_to_dict(proof: CostProof) -> dict[str, object]:
    """Plain data."""
    return {
        "level": proof.level,
        "value": proof.value,
        "rows": [list(key) for key in proof.keys],
        "tree": proof.tree.to_list(),
    }
