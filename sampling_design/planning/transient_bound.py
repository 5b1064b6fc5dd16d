"""How much worse than a plan proves a gap can be, so many samples after a change: its own gains, cut off at the change.

    rho <= cost_m + wider |rest_m|'R,   against   cost + |rest|'R  of the plan's proof

Gains that reach back m samples leave a rest of the row, of which the error m samples ago is all that is known: at most
`wider` times what the plan's filter bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sampling_design.accuracy.accuracy_profile import GapProof
from sampling_design.accuracy.gains import ROUNDING
from sampling_design.accuracy.sample_chain import SampleChain, noise_cost
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.sequence_chain import plan_chain
from sampling_design.records.arrays import Array


@dataclass(frozen=True, eq=False)
class CutGains:
    """Of the directions that prove a gap: what their gains cost over the last 1, 2, ... samples, and what is left."""

    cost: Array  # cost, rest, (b, m): `rest` in what the plan's filter bounds
    rest: Array

    def factor(self, wider: Array) -> float:
        """How much more than the plan's proof they prove, where 1, 2, ... samples ago the error was so much wider."""
        count = min(wider.size, len(self.cost))
        if not self.cost.size or not count:
            return np.inf
        proven = self.cost[:count] + wider[:count, None] * self.rest[:count]
        whole = self.cost[-1] + self.rest[-1]
        ratio = np.divide(proven, whole, out=np.where(proven > 0, np.inf, 0.0), where=whole > 0)
        return float(np.min(np.max(ratio, axis=1))) * (1 + ROUNDING)


@lru_cache(maxsize=4)
def cut_gains(plan: PlanFigures) -> tuple[CutGains, ...]:
    """The gains of a plan's proof, sample by sample of its period."""
    assert plan.accuracy is not None
    chain = plan_chain(plan)
    parts = {part.sample: part for part in plan.accuracy.proof}
    return tuple(_cut(chain, parts[j]) if j in parts else _nothing() for j in range(len(chain)))


def settled_factors(plan: PlanFigures, phases: list[int], reach: list[Array]) -> Array:
    """How much more than the plan's own gaps those after its samples `phases`, one after another, are at most.

    `reach` bounds |z| after each of them. Of these samples only the first may follow a change.
    """
    own, chain = cut_gains(plan), plan_chain(plan)
    known = [chain.reach[phase] for phase in phases]
    each = [
        float(np.max(np.divide(now, was, out=np.where(now > 0, np.inf, 1.0), where=was > 0), initial=1.0))
        for now, was in zip(reach, known, strict=True)
    ]
    wider = np.array(each)
    return np.array([max(wider[k], own[phase].factor(wider[k::-1])) for k, phase in enumerate(phases)])


def _nothing() -> CutGains:
    return CutGains(np.zeros((0, 0)), np.zeros((0, 0)))


def _cut(chain: SampleChain, part: GapProof) -> CutGains:
    """One sample's gains, followed back in time."""
    back = max(map(len, part.gains), default=0)
    g, total = part.directions.T.copy(), np.zeros(len(part.directions))
    cost, rest = np.zeros((back, total.size)), np.zeros((back, total.size))
    last = np.array([len(given) for given in part.gains])
    for i in range(back):
        node = (part.sample - i) % len(chain)
        sample, going = chain.samples[node], i < last
        lam = np.zeros((len(sample.H), total.size))
        for k in np.flatnonzero(going).tolist():
            lam[:, k] = part.gains[k][-1 - i]
        total = total + noise_cost(lam, sample.exact, chain.bounds.v_ball)
        g = g - sample.H.T @ lam
        cost[i] = np.where(going, total, cost[i - 1])
        rest[i] = np.where(going, chain.reach[node] @ np.abs(g), rest[i - 1])
        gap = chain.gaps[node - 1]
        total = total + gap.panels.integral(g, chain.bounds.w_ball)
        g = gap.F.T @ g
    return CutGains(cost, rest)
