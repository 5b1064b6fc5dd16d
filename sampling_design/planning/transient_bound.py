"""How much worse than a plan proves a gap can be, so many samples after a change: its own gains, cut off at the change.

    rho <= cost_m + wider |rest_m|'R,   against   cost + |rest|'R  of the plan's proof

Gains that reach back m samples leave a rest of the row, of which the error m samples ago is all that is known: at most
`wider` times what the plan's filter bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sampling_design.accuracy.bounded_directions import BoundedDirections, GapProof
from sampling_design.accuracy.forgetting import noise_cost
from sampling_design.accuracy.gains import ROUNDING
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.sequence_system import plan_bounds, plan_system
from sampling_design.records.arrays import Array


@dataclass(frozen=True, eq=False)
class CutGains:
    """Of the directions that prove a gap: what their gains cost over the last 1, 2, ... samples, and what is left."""

    cost: Array  # cost, rest, (b, m): `rest` in what the plan's filter bounds
    rest: Array
    out: int = 0  # so many of the last samples have results that are out: what is known after them is not asked

    def factor(self, wider: Array) -> float:
        """How much more than the plan's proof they prove, where 1, 2, ... samples ago the error was so much wider."""
        count = min(wider.size, len(self.cost))
        if not self.cost.size or not count:
            return np.inf
        proven = self.cost[:count] + wider[:count, None] * self.rest[:count]
        proven[: self.out] = np.inf
        whole = self.cost[-1] + self.rest[-1]
        ratio = np.divide(proven, whole, out=np.where(proven > 0, np.inf, 0.0), where=whole > 0)
        return float(np.min(np.max(ratio, axis=1))) * (1 + ROUNDING)


@lru_cache(maxsize=4)
def cut_gains(plan: PlanFigures) -> tuple[CutGains, ...]:
    """The gains of a plan's proof, node by node of its period."""
    assert plan.accuracy is not None
    system, directions = plan_bounds(plan)
    count = len(plan.accuracy.question.primitive().nodes)  # the proof is over the shortest period
    alike = {part.sample: part for part in plan.accuracy.proof if count == len(system) or part.sample < count}
    nothing = CutGains(np.zeros((0, 0)), np.zeros((0, 0)))
    return tuple(_cut(system, directions, alike[j]) if j in alike else nothing for j in range(len(system.samples)))


def out_at(system: SampledSystem, node: int, phase: int) -> tuple[object, ...]:
    """What is known at a node of which some results are out: its sample, and what of the last ones is in."""
    path = [each for each in system.nodes(node, 1) if each >= len(system)]
    return phase, *(tuple(system.samples[each].outputs.tolist()) for each in path)


@lru_cache(maxsize=4)
def nodes_out(plan: PlanFigures) -> dict[tuple[object, ...], int]:
    """The nodes of a plan of which some results are out, by what is known there."""
    system = plan_system(plan)
    return {out_at(system, node, system.sample_of(node)): node for node in range(len(system), len(system.samples))}


def settled_factors(plan: PlanFigures, phases: list[int], reach: list[Array]) -> Array:
    """How much more than the plan's own gaps those after its samples `phases`, one after another, are at most.

    `reach` bounds |z| after each of them. Of these samples only the first may follow a change.
    """
    own, wider = cut_gains(plan), wider_by(plan, phases, reach)
    return np.array([max(wider[k], own[phase].factor(wider[k::-1])) for k, phase in enumerate(phases)])


def wider_by(plan: PlanFigures, nodes: list[int], reach: list[Array]) -> Array:
    """How many times as large as at the plan's own nodes the error is at most, by bounds on |z|; 1 at least."""
    directions = plan_bounds(plan)[1]
    each = [(now, directions[node].reach) for now, node in zip(reach, nodes, strict=True)]
    return np.array(
        [
            float(np.max(np.divide(now, was, out=np.where(now > 0, np.inf, 1.0), where=was > 0), initial=1.0))
            for now, was in each
        ]
    )


def _cut(system: SampledSystem, directions: Sequence[BoundedDirections], part: GapProof) -> CutGains:
    """One node's gains, followed back in time."""
    back = max(map(len, part.gains), default=0)
    g, total = part.directions.T.copy(), np.zeros(len(part.directions))
    cost, rest = np.zeros((back, total.size)), np.zeros((back, total.size))
    last = np.array([len(given) for given in part.gains])
    path = system.latest(part.sample, back)[::-1]
    for i, node in enumerate(path):
        if i:
            gap = system.gap(node)
            total = total + gap.integral(g, system.bounds.w_ball)
            g = gap.F.T @ g
        sample, going = system.samples[node], i < last
        lam = np.zeros((len(sample.H), total.size))
        for k in np.flatnonzero(going).tolist():
            lam[:, k] = sample.K.T @ g[:, k] + part.gains[k][-1 - i]
        total = total + noise_cost(lam, sample.noise, system.bounds.v_ball)
        g = g - sample.H.T @ lam
        cost[i] = np.where(going, total, cost[i - 1])
        rest[i] = np.where(going, directions[node].reach @ np.abs(g), rest[i - 1])
    return CutGains(cost, rest, sum(node >= len(system) for node in path))
