"""What no plan can beat: a proof that every admissible choice at a level costs at least so much.

Rows of trajectories, and a tree: at each leaf some measurements are given or forbidden, and multipliers prove the cost
of all choices that keep these. A level is out of reach of a limit if what it costs at least exceeds the limit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sampling_design.planning.covering import CoveringRows, Key, relaxed
from sampling_design.planning.evidence import CostProof, CostTree, open_choices
from sampling_design.planning.filter_deviation import GridFilter
from sampling_design.planning.hidden_trajectories import HiddenTrajectories
from sampling_design.planning.hitting_set import DEEPEST, smallest_hitting_set
from sampling_design.planning.problem import SAME_PRICE
from sampling_design.planning.search_progress import ROW, VIEW
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget

INTEGRAL = 1e-6  # an entry counts as 0 or 1 within this
MOST_NODES = 200  # leaves of a proof, at most

CLOSED_NODES = 5000
"""The same of a tree that is only of use if it proves all that is asked for: half of the work left may go into it."""

FEW_NODES = 50  # the same where every row is a tangent's, which has all variables
SEPARATIONS = 60  # times that rows are added to a relaxation
CUTS = (6, 120)  # times that rows are added at a node, and in all
MANY = 60  # rows beyond which those that a point keeps easily are left out, and that are added at a time
EASY = 0.05  # a row is kept easily by this much more than it asks for
ADDED = 8  # rows that are added at a node at a time
FLAT = 1e-6  # rows that raise a node by no more than this share are the last, unless they exclude a choice
BELOW = 1 - 1e-6  # a level this much below what a trajectory reaches that all that is allowed hides is out of reach
ENDS = 6  # ends of one trajectory that are added at a time

Finder: TypeAlias = Callable[[Array, float], None]


def _views(covering: CoveringRows, pool: HiddenTrajectories, level: float) -> dict[int, Array]:
    """What measurements add to each trajectory that reaches a level, by its place in the pool."""
    every = enumerate(pool.trajectories)
    return {a: covering.view(trajectory, level) for a, trajectory in every if trajectory.reach >= level}


def separated(
    covering: CoveringRows, pool: HiddenTrajectories, level: float, keys: list[Key], work: Budget, below: float = np.inf
) -> tuple[list[Key], Array]:
    """Rows of the pool until the relaxation keeps them all, and its point, among choices below a cost."""
    keys, views = [key for key in keys if pool.trajectories[key[0]].reach >= level], _views(covering, pool, level)
    x, high = np.zeros(covering.columns), covering.ceiling(below)
    for _ in range(SEPARATIONS):
        if work.over:
            break
        work.add(ROW, len(keys))
        program = covering.model(pool.trajectories, keys, level)
        x, _, _ = relaxed(program, np.zeros(covering.columns), high, work)
        work.add(VIEW, len(views) * pool.steps)
        fresh = _violated(covering, pool, views, x, set(keys))
        if not fresh or work.over:
            break
        if len(keys) > MANY:  # rows that the point keeps easily may come back when one breaks them
            slack = (program.A @ x - program.b)[covering.frame[0].shape[0] :].reshape(-1, len(keys)).min(axis=0)
            keys = [key for key, s in zip(keys, slack.tolist(), strict=True) if s <= EASY]
        keys += fresh[:MANY]
    return keys, x


def _violated(
    covering: CoveringRows, pool: HiddenTrajectories, views: dict[int, Array], x: Array, known: set[Key]
) -> list[Key]:
    """Ends at which a fractional point sees too little of a trajectory, first where it sees least."""
    steps = pool.steps
    spectrum = np.fft.rfft(covering.coverage(x), axis=0)
    samples = np.fft.rfft(np.where(covering.sample_of >= 0, x[covering.sample_of], 0.0))
    fresh: list[tuple[float, Key]] = []
    for a, view in views.items():
        trajectory = pool.trajectories[a]
        coverage = np.fft.irfft(np.sum(spectrum * np.fft.rfft(view, axis=0), axis=1), steps)
        if not covering.whole:
            any_sensor = np.fft.rfft(np.minimum(view[:, covering.used].sum(axis=1), 1.0))
            coverage = np.minimum(coverage, np.fft.irfft(samples * any_sensor, steps))
        asked = pool.ends[trajectory.goal].astype(float)
        if trajectory.at_sample:
            asked = asked * np.where(covering.sample_of >= 0, x[covering.sample_of], 0.0)
        short = asked - coverage
        ends = np.flatnonzero(short > 1e-4)
        order = ends[np.argsort(-short[ends], kind="stable")]
        taken: list[int] = []
        for end in order.tolist():
            if len(taken) >= ENDS:
                break
            apart = [min((end - t) % steps, (t - end) % steps) for t in taken]
            if (not apart or min(apart) * 4 * ENDS >= steps) and (a, end) not in known:
                taken.append(end)
        fresh += [(-float(short[end]), (a, end)) for end in taken]
    return [key for _, key in sorted(fresh)]


@dataclass(eq=False)
class CostProver:
    """Proves costs over a pool; `find` is asked for trajectories against a point that no row so far excludes."""

    covering: CoveringRows
    pool: HiddenTrajectories
    work: Budget
    find: Finder | None = None
    grid_filter: GridFilter | None = None

    def least_cost(
        self, level: float, target: float, keys: Sequence[Key] = (), *, decide: bool = False, ask: bool = True
    ) -> CostProof:
        """Prove that every choice at a level costs at least `target`, or as much of it as so many nodes, and work, can.

        `decide`: nothing below the target is of use, so that the proof ends with the first choice that costs less.
        Standard deviations of few choices are worked out one by one: fractions of samples average what none can.
        Unless `ask`, nothing new joins the pool.
        """
        find = self.find if ask else None
        counted = self._counted(level, target) if find is not None else None
        if counted is not None:
            return counted
        judged = self._judged(level, target, decide)
        if judged is not None and judged[1]:
            return judged[0]
        found, _ = separated(self.covering, self.pool, level, list(keys), self.work, target)
        proof = _ProofTree(self, level, target, found, self.work, find, decide, MOST_NODES).proof()
        proofs = [proof] if judged is None else [judged[0], proof]
        if not decide and proof.value < target and not self.work.over:
            half = self.work.share(0.5)
            proofs.append(_ProofTree(self, level, target, list(proof.keys), half, find, True, CLOSED_NODES).proof())
        return max(proofs, key=lambda each: each.value)

    def _judged(self, level: float, target: float, decide: bool) -> tuple[CostProof, bool] | None:
        """What judging all choices one by one proves, and whether nothing can prove more; None where they are many."""
        value, left, grid_filter = target, list[Mask](), self.grid_filter
        while grid_filter is not None:
            open_ = open_choices(self.covering, grid_filter, level, value)
            if open_ is None:
                return None
            if not open_:
                cheapest = any(self.covering.problem.is_admissible(each) for each in left)
                sure = value >= target or (grid_filter.decides and cheapest)
                return CostProof(level, value, (), CostTree(), judged=True), sure
            if decide and grid_filter.decides:
                return CostProof(level, 0.0, (), CostTree()), True
            costs = np.array([self.covering.problem.cost(each) for each in open_])
            value = float(costs.min())
            left = [each for each, cost in zip(open_, costs, strict=True) if cost <= value * (1 + SAME_PRICE)]
        return None

    def _counted(self, level: float, target: float) -> CostProof | None:
        """The proof where nothing but the number of samples counts, or None."""
        known = -1
        while self.find is not None and len(self.pool.trajectories) > known and not self.work.over:
            known = len(self.pool.trajectories)
            found = smallest_hitting_set(self.covering, self.pool, level, target, self.work)
            if found is None or found.chosen is None:
                return None if found is None else found.proof
            self.find(self.covering.point(found.chosen), level)
        return None

    def out_of_reach(
        self, limit: float, known: float, high: float, width: float, keys: Sequence[Key]
    ) -> CostProof | None:
        """The proof with the highest level at which every choice costs more than `limit`; None without work for one.

        `known` is a level at which a solver says so, with the rows `keys`; `high` one at which there is a choice. What
        rounding puts above that proves nothing, as where nothing drives what is wanted.
        """
        best: CostProof | None = None
        attained = high
        more, low = self.covering.beyond(limit), 0.0
        enough = more * (1 - 1e-9)
        if known > 0:
            best = self.least_cost(known, more, keys, decide=True)
            if best.value >= enough and not best.judged and known <= attained:
                return best
            best, low, high = (best, known, high) if best.value >= enough else (None, 0.0, known)
        ratio, trajectory, end = self.pool.against(self.covering.problem.allowed)
        if best is None and trajectory is not None:  # one that nothing shows proves its level alone
            place = next(a for a, each in enumerate(self.pool.trajectories) if each is trajectory)
            proof = self.least_cost(ratio * BELOW, more, [(place, end)], decide=True, ask=False)
            best, low = (proof, proof.level) if proof.value >= enough else (None, 0.0)
        while high > low * (1 + width) and high >= 1e-6 and not self.work.over:
            level = (low + high) / 2 if best is None else float(np.sqrt(low * high))
            proof = self.least_cost(level, more, keys, decide=True)
            keys = proof.keys
            if proof.value >= enough:
                best, low = proof, level
            else:
                high = level
        return best if best is not None and best.level <= attained else None


class _ProofTree:
    """Branches and adds rows until every leaf proves the target, or there are no nodes left."""

    def __init__(
        self, prover: CostProver, level: float, target: float, keys: list[Key], work: Budget,
        find: Finder | None, decide: bool, most: int,
    ):  # fmt: skip
        self.covering, self.pool, self.level, self.target = prover.covering, prover.pool, level, target
        self.keys, self.work, self.find, self.decide = keys, work, find, decide
        dense = all(each.response is None and not np.any(each.touches == 1) for each in self.pool.trajectories)
        self.left, self.lost = FEW_NODES * most // MOST_NODES if dense else most, False
        self.cuts = CUTS[1] * most // MOST_NODES if find is not None else 0
        self.work.add(ROW, len(keys))
        self.program = self.covering.model(self.pool.trajectories, keys, level)
        self.of_samples = self._of_samples(len(keys))

    def proof(self) -> CostProof:
        """The proof from the root."""
        tree, value = self.node(np.zeros(self.covering.columns), self.covering.ceiling(self.target))
        first = self.program.b.size - len(self.of_samples)
        place = np.argsort(np.argsort(self.of_samples, kind="stable"), kind="stable")
        tree = tree.numbered(lambda row: row if row < first else first + int(place[row - first]))
        return CostProof(self.level, min(self.covering.lifted(value), self.target), tuple(self.keys), tree)

    def _of_samples(self, keys: int) -> list[bool]:
        """Which rows of so many keys are those of samples: in the proof these are behind all others."""
        return [False] * keys + ([] if self.covering.whole else [True] * keys)

    def node(self, low: Array, high: Array, depth: int = 0) -> tuple[CostTree, float]:
        """The tree below a node and what it proves; nodes are shared out evenly, unless one open leaf ends it all."""
        self.left -= 1
        x, y, value = relaxed(self.program, low, high, self.work)
        for _ in range(min(CUTS[0], self.cuts)):
            if self.work.over or self.covering.lifted(value) >= self.target or not self._cut(x):
                break
            before = value
            x, y, value = relaxed(self.program, low, high, self.work)
            if value <= before + FLAT * abs(before) and np.minimum(x, 1 - x).max(initial=0.0) > INTEGRAL:
                break
        rows = np.flatnonzero(y)
        leaf = CostTree(tuple(rows.tolist()), tuple(y[rows].tolist()))
        torn = np.minimum(x, 1 - x)
        whole = torn.max(initial=0.0) <= INTEGRAL
        spent = self.left <= 0 or depth >= DEEPEST or self.work.over
        if self.covering.lifted(value) >= self.target or whole or spent:
            self.lost = self.lost or (self.decide and self.covering.lifted(value) < self.target)
            return leaf, value
        k = int(np.argmax(torn))
        up, down = low.copy(), high.copy()
        up[k], down[k] = 1.0, 0.0
        spared = 0 if self.decide else self.left - self.left // 2
        self.left -= spared
        given, second = self.node(up, high, depth + 1)
        self.left += spared
        if self.lost:
            return leaf, value
        without, first = self.node(low, down, depth + 1)
        if self.lost or min(first, second) <= value:
            return leaf, value
        return CostTree(variable=k, branches=(without, given)), min(first, second)

    def _cut(self, x: Array) -> bool:
        """Add rows that a point breaks: turns of trajectories that there are, else new trajectories."""
        assert self.find is not None
        self.cuts -= 1
        for ask in (False, True):
            if ask:
                self.find(x, self.level)
            views = _views(self.covering, self.pool, self.level)
            self.work.add(VIEW, len(views) * self.pool.steps)
            fresh = _violated(self.covering, self.pool, views, x, set(self.keys))[:ADDED]
            if fresh:
                self.keys += fresh
                self.program = self.covering.longer(self.program, self.pool.trajectories, fresh, self.level)
                self.of_samples += self._of_samples(len(fresh))
                return True
        return False
