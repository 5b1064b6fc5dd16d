"""Choices of samples: those that a search begins with, what is proven of the ones that it holds, and their plans.

The search judges in floats and may judge too well, so that what it holds last need not be what is proven: however long
it goes on, none is forgotten.

A coarser grid of the same problem, and what a search there says on the finer one.

All of its times are times of the finer grid: a choice is one there, and so is a disturbance, constant for more steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.accuracy.deviation import StandardDeviation
from sampling_design.errors import ArgumentError, InfeasibleRequirementError, UndecidedError
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.adversary_program import forced_response
from sampling_design.planning.discrete_plant import DiscretePlant
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.figures import accuracy_of
from sampling_design.planning.filter_deviation import own
from sampling_design.planning.hidden_trajectories import HiddenTrajectory
from sampling_design.planning.plan_record import Plan, deviation_of, reached, without_limits
from sampling_design.planning.problem import SAME_PRICE, WHOLE, PlanProblem, pose_plan
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.budget import Budget
from sampling_design.records.record import above, short
from sampling_design.records.units import SECONDS, time_factor

COARSE, COARSE_DATES = 24, 168
"""Steps of a grid up to which it is not looked at more coarsely first; with a calendar the hours of a week."""


def coarser(problem: PlanProblem) -> PlanProblem | None:
    """The same on a grid of a third as many steps or fewer, all of them steps of this one; None where it is short.

    With a calendar its steps make up whole hours, then days: grids that people use are among those that follow.
    """
    requirement, whole = problem.requirement, np.inf
    if requirement.calendar is not None:
        seconds = problem.step * SECONDS[problem.plant.time_unit]
        whole = (SECONDS["h"] if seconds < SECONDS["h"] * (1 - WHOLE) else SECONDS["d"]) / seconds
    parts = [k for k in range(2, problem.steps) if problem.steps % k == 0]
    if np.isfinite(whole):
        parts = [k for k in parts if abs(whole / k - round(whole / k)) <= WHOLE]
    if problem.steps <= (COARSE if requirement.calendar is None else COARSE_DATES) or not parts:
        return None
    step = problem.step * next((k for k in parts if k > 2), 2)
    unit = requirement.time_unit or problem.plant.time_unit
    try:
        return pose_plan(problem.plant, requirement.replace(grid=step * time_factor(problem.plant.time_unit, unit)))
    except (ArgumentError, InfeasibleRequirementError):  # times that a goal asks for, or hours, fall between its steps
        return None


def coarser_grids(problem: PlanProblem) -> list[PlanProblem]:
    """The same on all the grids that are looked at first, the finest of them first."""
    found, coarse = list[PlanProblem](), coarser(problem)
    while coarse is not None:
        found.append(coarse)
        coarse = coarser(coarse)
    return found


def lifted_choices(problem: PlanProblem, coarse: Iterable[Mask]) -> list[Mask]:
    """The choices of a coarser grid, on this one, as far as they are admissible here."""
    found = []
    for chosen in coarse:
        lifted = np.zeros(problem.allowed.shape, dtype=bool)
        lifted[:: problem.steps // len(chosen)] = chosen
        found += [lifted] if problem.is_admissible(lifted) else []
    return found


def lifted_trajectories(
    oracle: AccuracyOracle, discrete: DiscretePlant, trajectories: Iterable[HiddenTrajectory]
) -> list[HiddenTrajectory]:
    """The trajectories of a coarser grid, where `discrete` is the plant, on the grid of an oracle.

    Simulated over its steps, with what all of these would show. Of a tangent: the one that touches at the same samples.
    """
    found, steps = [], oracle.problem.steps
    for trajectory in trajectories:
        part = steps // len(trajectory.peaks)
        if trajectory.response is None:
            z = np.zeros(oracle.problem.allowed.shape)
            z[::part] = np.roll(trajectory.touches, -(trajectory.end + 1) % len(trajectory.peaks), axis=0)[::-1]
            lifted = oracle.tangent(z, trajectory.goal)
        else:
            response, parts = trajectory.response, trajectory.parts
            own = oracle if parts == 1 else oracle.finer
            states = np.asarray(np.linalg.lstsq(own.discrete.T, discrete.T @ response.states.T)[0].T, dtype=np.float64)
            propagated = forced_response(
                own.discrete, response.knots * part, states, np.repeat(response.w, part, axis=0)
            )
            lifted = own.scaled(propagated, trajectory.goal, trajectory.in_parts().end * part, trajectory.at_sample)
            lifted = lifted.on_grid(parts) if lifted is not None else None
        found += [lifted] if lifted is not None else []
    return found


GoalProofs: TypeAlias = tuple[Accuracy | None, StandardDeviation | None]

EVENLY = (np.sqrt(5.0) - 1) / 2  # multiples of it, less their whole part, are spread evenly

TIGHTER, TIGHTEST, ROOM = 2.0, 0.95, 1.004
"""Where samples may be late: how much tighter a search asks at most than the one before, the last margin, and room."""


def tighter_margins(margin: float, judged: float, worst: float) -> list[float]:
    """What a search asks next whose choice is proven to be worse than judged: early and late samples show there alone.

    So much that this choice is none any more.
    """
    tighter = 1 - min((1 - margin) / min(worst * ROOM, TIGHTER), judged / ROOM)
    return [tighter] if tighter < TIGHTEST else []


@dataclass(frozen=True, eq=False)
class ProvenChoice:
    """A choice, its proof, and the ratios to the tolerances that this proves."""

    chosen: Mask
    proof: GoalProofs
    ratios: Array
    cut: bool = False
    """Whether it was ended before its proof was whole."""

    @property
    def worst(self) -> float:
        """The largest ratio."""
        return float(self.ratios.max(initial=0.0))

    def require_bounded(self) -> None:
        """Refuse a choice of which nothing is proven. Raises UndecidedError."""
        if not np.isfinite(self.worst):
            raise UndecidedError("undecided: no plan was proven at all times within `timing_tolerance`. Ask for less.")


class FeasibleChoices:
    """Choices of one problem, each proven once at most."""

    def __init__(self, problem: PlanProblem, work: Budget, prove: Callable[[Mask], ProvenChoice]):
        self.problem, self.work, self._prove = problem, work, prove
        self._known: dict[bytes, ProvenChoice] = {}

    def proven(self, chosen: Mask) -> ProvenChoice:
        """What is proven of a choice."""
        key = chosen.tobytes()
        if key not in self._known:
            self._known[key] = self._prove(chosen)
        return self._known[key]

    def lift(self, coarse: FeasibleChoices) -> None:
        """Know what is proven of choices on a coarser grid: their times, and so their guarantees, are the same here."""
        for found in coarse._known.values():
            if found.proof[1] is None:
                for chosen in lifted_choices(self.problem, [found.chosen]):
                    self._known.setdefault(chosen.tobytes(), replace(found, chosen=chosen))

    def _first(self, choices: list[Mask], everything: Mask) -> ProvenChoice | None:
        """The first choice that is proven to keep the tolerances; once a proof was cut, of all others the densest."""
        cut = False
        for chosen in choices:
            if not cut or chosen is everything or chosen.tobytes() in self._known:
                found = self.proven(chosen)
                if found.worst <= 1:
                    return found
                cut |= found.cut
        return None

    def sharpest(self, incumbents: Iterable[tuple[Mask, float]], best: ProvenChoice) -> ProvenChoice:
        """The best of what was held, by proof; a choice judged no better than the best is not proven to be better.

        Once a proof was cut, of what is proven already.
        """
        for chosen, judged in incumbents:
            if judged < best.worst and (not best.cut or chosen.tobytes() in self._known):
                best = min(best, self.proven(chosen), key=lambda found: found.worst)
        return best

    def cheapest(self, incumbents: Iterable[Mask], everything: Mask) -> ProvenChoice:
        """The cheapest of what was held, and of all that is allowed, that is proven to keep the tolerances.

        Or a choice that is cheaper still, made of one that is not: more of what is allowed joins it. The densest one if
        none is and its proof was cut; else UndecidedError if nothing is proven to keep them.
        """
        cost = self.problem.cost
        choices = sorted([*incumbents, everything], key=cost)
        best = self._first(choices, everything)
        for chosen in choices:
            if best is not None and (self.work.over or cost(chosen) >= cost(best.chosen)):
                break
            best = self._repaired(chosen, everything, best)
        assert best is not None
        return best

    def _repaired(self, chosen: Mask, everything: Mask, best: ProvenChoice | None) -> ProvenChoice:
        """More of what is allowed, spread out, until the tolerances are proven, as long as that is cheaper than `best`.

        It is asked for where a free response neither decays nor is observed well. Raises UndecidedError if
        there is no `best`, and not even as much as spacings allow is proven to keep them.
        """
        more = np.argwhere(everything & ~chosen)
        more = more[np.argsort((np.arange(len(more)) * EVENLY) % 1.0, kind="stable")]
        low, high = 0, len(more)
        while best is None or low < high:
            count = high if best is None else (low + high) // 2
            trial = chosen.copy()
            for i, j in more[:count].tolist():
                trial[i, j] = True
                if not self.problem.is_admissible(trial):
                    trial[i, j] = False
            if best is not None and self.problem.cost(trial) >= self.problem.cost(best.chosen):
                high = count
                continue
            found = self.proven(trial)
            if found.worst <= 1:
                best, high = found, count
            elif best is None:
                found.require_bounded()
                if found.cut:
                    return found
                raise UndecidedError(
                    f"No plan was proven to keep the tolerances: the densest one is proven to keep "
                    f"{found.worst:.4g} times them. Ask for less, or allow other hours."
                )
            else:
                low = count + 1
        return best


def densest(problem: PlanProblem) -> Mask:
    """As much as hours and spacings allow, from the first allowed time on; what is within the limits, evenly."""
    chosen = np.zeros(problem.allowed.shape, dtype=bool)
    for i in np.flatnonzero(problem.allowed.any(axis=1)).tolist():
        for j in np.flatnonzero(problem.allowed[i]).tolist():
            chosen[i, j] = True
            if not without_limits(problem).is_admissible(chosen):
                chosen[i, j] = False
    return chosen if problem.is_admissible(chosen) else sparse(problem)


def sparse(problem: PlanProblem) -> Mask:
    """A choice within the limits: times as even as can be, at each as many sensors as there is money for.

    Raises InfeasibleRequirementError if not a single measurement is admissible.
    """
    at = np.flatnonzero(problem.allowed.any(axis=1))
    each = problem.visit + problem.price.min()
    affordable = problem.most_cost * (1 + SAME_PRICE) / each if each > 0 else np.inf
    most = int(min(problem.most_samples, len(at), affordable))
    for count in range(most, 0, -1):
        chosen = np.zeros(problem.allowed.shape, dtype=bool)
        wanted = np.arange(count) * problem.steps / count
        for step in wanted:
            near = np.argsort(np.abs((at - step + problem.steps / 2) % problem.steps - problem.steps / 2))
            for i in at[near].tolist():
                if _filled(problem, chosen, i):
                    break
        if int(chosen.any(axis=1).sum()) == count:
            for _ in problem.price:  # every sensor that there is room and money for, the cheapest first
                for i in np.flatnonzero(chosen.any(axis=1)).tolist():
                    _filled(problem, chosen, i)
            return chosen
    raise InfeasibleRequirementError("No measurement is admissible within `cost_limit` and hours.", "cost_limit")


def _filled(problem: PlanProblem, chosen: Mask, i: int) -> bool:
    """Whether one more sensor, the cheapest, fits in at a step."""
    done = False
    for j in np.argsort(problem.price, kind="stable").tolist():
        if problem.allowed[i, j] and not chosen[i, j]:
            chosen[i, j] = True
            done = problem.is_admissible(chosen)
            if done:
                break
            chosen[i, j] = False
    return done


def proof_of(problem: PlanProblem, chosen: Mask, work: Budget | None = None) -> GoalProofs:
    """The proof of a choice, as far as work lasts: accuracy for what is guaranteed, and standard deviations."""
    return accuracy_of(problem, chosen, work), deviation_of(problem, chosen)


def proven_of(problem: PlanProblem, chosen: Mask, work: Budget) -> ProvenChoice:
    """The same, and the ratios to the tolerances: infinite where nothing bounds what early and late samples do."""
    tolerances = np.array([goal.tolerance for goal in problem.goals])
    try:
        proof = proof_of(problem, chosen, work)
    except UndecidedError:
        if not problem.timing_tolerance:
            raise
        return ProvenChoice(chosen, (None, None), np.full_like(tolerances, np.inf), work.over)
    return ProvenChoice(chosen, proof, reached(problem, chosen, *proof) / tolerances, work.over)


def proven_plan(problem: PlanProblem, chosen: Mask, bound: PlanBound, status: str) -> Plan:
    """The plan of a choice, its accuracy proven."""
    return plan_of(problem, chosen, proof_of(problem, chosen), bound, status)


def plan_of(problem: PlanProblem, chosen: Mask, proof: GoalProofs, bound: PlanBound, status: str) -> Plan:
    """The plan of a choice whose proof is at hand."""
    plant, requirement, schedule = problem.plant, problem.requirement, problem.schedule(chosen)
    mine = freeze(reached(problem, chosen, *proof))
    return Plan(plant, requirement, schedule, proof[0], mine, bound, status=status, deviation=proof[1])


def refuse_what_none_keeps(oracle: AccuracyOracle, feasible: FeasibleChoices, everything: Mask, room: float) -> None:
    """Refuse tolerances that not even all that is allowed keeps; what the densest choice is proven to do can be kept.

    After a sample the one that sees most leaves least unknown, and none need be taken that sees less.

    Raises InfeasibleRequirementError if a goal is beyond its tolerance whatever is chosen.
    """
    problem = oracle.problem
    goals, each = problem.goals, _ratios(oracle, problem.allowed)
    least = [float(x.min() if own(g) else x.max()) if x.size else 0.0 for g, x in zip(goals, each, strict=True)]
    if max(least) <= 1:
        return
    kept = ", ".join(
        f"{g.name} {short(g.tolerance * r)} instead of {short(g.tolerance)}"
        for g, r in zip(goals, least, strict=True)
        if r > 1
    )
    text, near = f"Not even measuring at every allowed time keeps the tolerances: at best {kept} could be kept.", {}
    dense = feasible.proven(everything)
    if np.isfinite(dense.worst):
        near = {g.name: g.tolerance * max(1.0, r * room) for g, r in zip(goals, dense.ratios.tolist(), strict=True)}
        if not problem.unspaced:
            text += (
                f" With these spacings, uses and limits {', '.join(f'{k} {above(x)}' for k, x in near.items())} can be."
            )
    raise InfeasibleRequirementError(text, "accuracy", near)


def _ratios(oracle: AccuracyOracle, chosen: Mask) -> list[Array]:
    """What a choice leaves unknown of each goal over its tolerance: after each sample, or at worst in each gap."""
    goals, trajectories = oracle.problem.goals, oracle.judge(chosen)[1]
    found = [
        np.array([t.reach for t in trajectories if t.goal == g and t.response is not None]) for g in range(len(goals))
    ]
    if oracle.grid_filter is not None:
        values = oracle.grid_filter.ratios(chosen[None])[0]
        found = [v[v > 0] if g.stochastic else f for g, f, v in zip(goals, found, values, strict=True)]
    return found
