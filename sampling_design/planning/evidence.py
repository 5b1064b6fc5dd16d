"""The evidence of a plan's bounds: trajectories in numbers, simulated anew, and the proofs over them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.planning.adversary_program import forced_response
from sampling_design.planning.covering import (
    MOST_CHOICES,
    SMALLER,
    TIE,
    CoveringProgram,
    CoveringRows,
    Key,
    SampleChoices,
    proven,
)
from sampling_design.planning.discrete_plant import DiscretePlant
from sampling_design.planning.filter_deviation import GridFilter
from sampling_design.planning.hidden_trajectories import HiddenTrajectories, HiddenTrajectory, peaks_of
from sampling_design.planning.problem import PlanProblem
from sampling_design.records.arrays import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class CostTree:
    """A leaf: multipliers `values` of `rows`; or the trees where one variable is forbidden, and where it is given."""

    rows: tuple[int, ...] = ()
    values: tuple[float, ...] = ()
    variable: int = 0
    branches: tuple[CostTree, ...] = ()

    def leaves(self) -> list[CostTree]:
        """All leaves of the tree."""
        return [leaf for branch in self.branches for leaf in branch.leaves()] if self.branches else [self]

    def fits(self, rows: int, columns: int) -> bool:
        """Whether a tree names only rows and variables that there are."""
        here = all(0 <= row < rows for row in self.rows) and 0 <= self.variable < columns
        return here and all(branch.fits(rows, columns) for branch in self.branches)

    def numbered(self, place: Callable[[int], int]) -> CostTree:
        """The tree with other numbers of rows."""
        rows, branches = tuple(map(place, self.rows)), tuple(branch.numbered(place) for branch in self.branches)
        return replace(self, rows=rows, branches=branches)

    def below(self, program: CoveringProgram, low: Array, high: Array) -> float:
        """What the tree proves of choices between bounds."""
        if self.branches:
            up, down = low.copy(), high.copy()
            up[self.variable], down[self.variable] = 1.0, 0.0
            without, given = self.branches
            return min(without.below(program, low, down), given.below(program, up, high))
        y = np.zeros(program.b.size)
        y[list(self.rows)] = self.values
        return proven(program, np.maximum(y, 0.0), low, high)

    def to_list(self) -> list[dict[str, object]]:
        """Nodes in the order of a walk, first what is without the variable: a file is never nested deeply."""
        if self.branches:
            return [{"variable": self.variable}, *(node for branch in self.branches for node in branch.to_list())]
        return [{"multipliers": [[row, value] for row, value in zip(self.rows, self.values, strict=True)]}]


@dataclass(frozen=True, eq=False)
class CostProof:
    """Every choice that sees the trajectories `keys` at `level` costs at least `value`.

    `judged`: every choice that costs less was judged by itself, with the filter, and is above the level.
    """

    level: float
    value: float
    keys: tuple[Key, ...]
    tree: CostTree
    judged: bool = False


def open_choices(covering: CoveringRows, grid_filter: GridFilter, level: float, below: float) -> list[Mask] | None:
    """Those of all choices below a cost that the filter does not find beyond a level; None where they are too many.

    More measurements leave no more unknown, so that those that nothing can join stand for all: none proves the cost.
    Spacings and uses are left aside, and of choices that are turns of each other one is looked at.
    """
    kept = None if covering.readings is None else _kept(covering, covering.readings, grid_filter, level, below)
    if kept is None:
        return None
    found = list[Mask]()
    for at, read in kept:
        for k in np.flatnonzero(~grid_filter.beyond(at, read, level)):
            found.append(np.zeros_like(covering.problem.allowed))
            found[-1][at[k]] = read[k]
    return found


def _kept(
    covering: CoveringRows, readings: SampleChoices, grid_filter: GridFilter, level: float, below: float
) -> list[tuple[Index, Mask]] | None:
    """Choices that nothing can join but those whose beginnings leave too much unknown; None where they are too many.

    Steps (B, k) and what is measured there (B, k, p). A beginning is followed with what is unknown at least, since all
    that is allowed was measured before it: then a gap lasts too long, or what may still be paid cannot close the period
    with gaps that do not. Where all turns are alike the longest gap comes first.
    """
    problem, room, alike = covering.problem, below * (1 - TIE), covering.repeats_after == 1
    cheapest = float(readings.cost.min())
    least, every = grid_filter.least, np.arange(problem.steps)
    longest = int(grid_filter.lasting(every, grid_filter.measured(least, problem.allowed), level).max())
    begun = np.flatnonzero((readings.at < covering.repeats_after) & (readings.cost < room))
    taken, P = begun[:, None], grid_filter.measured(least[readings.at[begun]], readings.measured[begun])
    found, count = list[tuple[Index, Mask]](), 0
    for k in range(1, problem.steps + 1):
        at, left = readings.at[taken], room - readings.cost[taken].sum(axis=1)
        gap, whole = grid_filter.lasting(at[:, -1], P, level), at[:, 0] + problem.steps - at[:, -1]
        first = gap if k == 1 else at[:, 1] - at[:, 0]
        gap = np.minimum(gap, first) if alike else gap
        more = np.full(len(at), min(problem.most_samples, problem.steps) - k)
        if cheapest > 0:
            more = np.minimum(more, np.floor(left / cheapest + TIE))
        live = gap + more * np.minimum(longest, first if alike else longest) >= whole
        taken, P, at, left, gap, whole = (each[live] for each in (taken, P, at, left, gap, whole))
        count += len(taken)
        if count > MOST_CHOICES or grid_filter.work.over:
            return None
        done = (whole <= gap) & (readings.joins(taken, k < problem.most_samples) >= left)
        found.append((at[done], readings.measured[taken[done]]))
        start, stop = (np.searchsorted(readings.at, at[:, -1] + d, "right") for d in (np.zeros(1, int), gap))
        size = (stop - start) * (k < problem.most_samples)
        if not size.any():
            return found
        if size.sum() > MOST_CHOICES * SMALLER:
            return None
        of = np.repeat(np.arange(len(taken)), size)
        then = np.arange(of.size) - np.repeat(np.cumsum(size) - size, size) + start[of]
        paid = readings.cost[then] < left[of]
        of, then = of[paid], then[paid]
        taken = np.column_stack([taken[of], then])
        P = grid_filter.measured(grid_filter.after(P[of], readings.at[then] - at[of, -1]), readings.measured[then])
    return found


def proven_cost(covering: CoveringRows, pool: HiddenTrajectories, proof: CostProof) -> float:
    """What a proof's multipliers prove, worked out anew; no solver."""
    if any(not pool.ends[pool.trajectories[a].goal][end % pool.steps] for a, end in proof.keys):
        return -np.inf
    model = covering.model(pool.trajectories, list(proof.keys), proof.level)
    if not proof.tree.fits(model.b.size, covering.columns):
        return -np.inf

    # a choice that cost less than the claim could be turned so that its largest gap follows step 0
    return covering.lifted(proof.tree.below(model, np.zeros(covering.columns), covering.ceiling(proof.value)))


KEPT = 1e-7  # share by which what is simulated anew is scaled down beyond what it exceeds: rounding of its path

AGAIN = 1e-6  # share within which what is worked out anew, on another machine, is the same

EASED = 1 - 1e-5
"""Levels are stated this much lower than they were proven at, so that what is simulated anew proves them, not nearly:
the tolerance of a bound is on the safe side."""


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
        return replace(proof, level=proof.level * EASED, keys=tuple((place[a], end) for a, end in proof.keys))

    return PlanBound(tuple(pool.trajectories[a] for a in used), moved(ratio), moved(cost))


def broken_below(bound: PlanBound, covering: CoveringRows) -> dict[int, list[int]]:
    """Goals and steps of the trajectories by which the cost is proven: a choice for less leaves one of them hidden.

    That goal is then beyond its tolerance at that step; of a plan that may be turned, turned as the proof has it.
    """
    found: dict[int, set[int]] = {}
    if bound.cost is not None and bound.cost.judged:
        goals = enumerate(covering.problem.goals)
        return {g: np.flatnonzero(covering.problem.ends(g)).tolist() for g, goal in goals if goal.stochastic}
    if bound.cost is not None:
        frame = int(covering.frame[0].shape[0])
        for leaf in bound.cost.tree.leaves():
            for row, multiplier in zip(leaf.rows, leaf.values, strict=True):
                if row >= frame and multiplier > 0:
                    a, end = bound.cost.keys[(row - frame) % len(bound.cost.keys)]
                    found.setdefault(bound.trajectories[a].goal, set()).add(end % covering.problem.steps)
    return {goal: sorted(found[goal]) for goal in sorted(found)}


def resimulated(problem: PlanProblem, discrete: DiscretePlant, trajectory: HiddenTrajectory) -> HiddenTrajectory | None:
    """A trajectory as its response, simulated anew and made admissible, proves it; None if that is not one trajectory.

    Of a tangent: the filter run anew.
    """
    response, parts = trajectory.response, trajectory.parts
    if response is None:
        return _filtered(problem, discrete, trajectory)
    if parts > 1:
        found = resimulated(problem.finer(parts), discrete.finer(parts), trajectory.in_parts())
        return None if found is None else found.on_grid(parts)
    if response.states[0].any() or response.knots[0] != 0:
        return None
    w = response.w.copy()
    for k in range(len(response.knots) - 1):
        a, b = int(response.knots[k]), int(response.knots[k + 1])
        part = forced_response(discrete, np.zeros(1, dtype=np.intp), response.states[k : k + 1], w[a:b])
        blocks, F = np.zeros((discrete.n, (b - a) * w.shape[1])), np.eye(discrete.n)
        for i in range(b - a - 1, -1, -1):
            blocks[:, i * w.shape[1] : (i + 1) * w.shape[1]] = F @ discrete.Gamma
            F = F @ discrete.F
        left = response.states[k + 1] - part.path[-1]
        change = np.linalg.lstsq(blocks, left, rcond=1e-12)[0]
        size = np.abs(blocks) @ np.ones(blocks.shape[1]) + np.abs(F) @ np.abs(response.states[k])
        if np.any(np.abs(left - blocks @ change) > 1e-12 * size):
            return None
        w[a:b] += change.reshape(b - a, -1)
    propagated = forced_response(discrete, response.knots, response.states, w)
    factor = max(propagated.size(discrete.ball), 1.0) * (1 + KEPT)
    row = discrete.rows(problem.goals[trajectory.goal].row[None])[0]
    reach = float(row @ propagated.path[-1]) / factor / problem.goals[trajectory.goal].tolerance
    outputs = peaks_of(
        propagated.path @ discrete.H.T / factor, problem.steps, trajectory.at_sample, problem.unread_steps
    )
    peaks = outputs * (1 + 2 * KEPT)
    if reach <= 0 or (trajectory.at_sample and problem.unread_steps is not None):
        return None
    return HiddenTrajectory(trajectory.goal, reach, trajectory.end, trajectory.at_sample, np.asarray(peaks), response)


def _filtered(problem: PlanProblem, discrete: DiscretePlant, trajectory: HiddenTrajectory) -> HiddenTrajectory | None:
    """A tangent worked out anew where it touches, by the filter from nothing unknown on."""
    z = np.roll(trajectory.touches, -((trajectory.end + 1) % problem.steps), axis=0)[::-1]
    if not problem.goals[trajectory.goal].stochastic or np.any(z < 0) or np.any(z > 1):
        return None
    found = GridFilter(problem, discrete).tangent_at(z, trajectory.goal, trajectory.end)
    if found is not None and trajectory.reach <= found.at_touch.reach * (1 + AGAIN):
        found = found.at_touch
    return None if found is None else replace(found, reach=found.reach * (1 - KEPT), end=trajectory.end)


def bound_holds(
    bound: PlanBound,
    covering: CoveringRows,
    limited: CoveringRows,
    discrete: DiscretePlant,
    ends: list[Mask],
    most: float,
) -> bool:
    """Whether both proofs hold: trajectories simulated anew, multipliers added up anew.

    `covering` has no limits of its own; `limited` has those that rivals keep; `most` is what these may cost.
    """
    if bound.cost is not None and bound.cost.level < 1:  # what leaves more than that unknown may keep the tolerances
        return False
    pool = HiddenTrajectories(covering.problem.steps, ends)
    for trajectory in bound.trajectories:
        propagated = resimulated(covering.problem, discrete, trajectory)
        if propagated is None or propagated.reach < trajectory.reach * (1 - AGAIN):
            return False
        pool.add(propagated)
    for proof, frame, least in ((bound.ratio, limited, most), (bound.cost, covering, None)):
        if proof is None:
            continue
        if any(pool.trajectories[a].reach < proof.level for a, _ in proof.keys):
            return False
        if proof.judged:
            grid_filter = GridFilter(frame.problem, discrete)
            value = proof.value if open_choices(frame, grid_filter, proof.level, proof.value) == [] else -np.inf
        else:
            value = proven_cost(frame, pool, proof)
        if value < proof.value * (1 - 1e-9) or (least is not None and value <= least):
            return False
    return True


def trajectory_to_dict(trajectory: HiddenTrajectory) -> dict[str, object]:
    """Plain data; peaks are left out, since they are worked out anew."""
    response = trajectory.response
    data: dict[str, object] = {key: getattr(trajectory, key) for key in ("goal", "end", "at_sample", "reach")}
    if response is None:
        touched = np.argwhere(trajectory.touches).tolist()
        return data | {"point": [[*at, float(trajectory.touches[tuple(at)])] for at in touched]}
    data |= {"parts": trajectory.parts} if trajectory.parts > 1 else {}
    return data | {key: getattr(response, key).tolist() for key in ("knots", "states", "w")}


def trajectory_of(problem: PlanProblem, discrete: DiscretePlant, data: dict[str, object]) -> HiddenTrajectory:
    """A trajectory from plain data that a strict reader has passed."""
    if "point" in data:
        point, end = np.zeros(problem.allowed.shape), int(str(data["end"]))
        for back, sensor, share in np.array(data["point"], dtype=float).reshape(-1, 3):
            point[int(back), int(sensor)] = share
        reach, at_sample = float(str(data["reach"])), bool(data["at_sample"])
        return HiddenTrajectory(int(str(data["goal"])), reach, end, at_sample, np.zeros_like(point), None, point)
    knots, parts = np.array(data["knots"], dtype=np.intp), int(str(data.get("parts", 1)))
    grid = problem.finer(parts)
    response = forced_response(discrete.finer(parts), knots, np.array(data["states"]), np.array(data["w"]))
    at_sample = bool(data["at_sample"])
    peaks = peaks_of(response.path @ discrete.H.T, grid.steps, at_sample, grid.unread_steps)
    goal, reach, end = int(str(data["goal"])), float(str(data["reach"])), int(str(data["end"]))
    return HiddenTrajectory(goal, reach, end, at_sample, peaks, response, parts=parts).in_parts().on_grid(parts)


def proof_to_dict(proof: CostProof) -> dict[str, object]:
    """Plain data."""
    return {
        "level": proof.level,
        "value": proof.value,
        "rows": [list(key) for key in proof.keys],
        "tree": [] if proof.judged else proof.tree.to_list(),
    }
