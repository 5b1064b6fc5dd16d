"""At most so many samples that see every trajectory, where nothing but their number counts: by branching, no solver.

    |X| <= N,   X meets V_a, the steps that show a trajectory, for every trajectory a

Branching is on the trajectory that the fewest steps show: its first step is given, or forbidden and its second given,
and so on. Trajectories that share no step that is left need one sample each. What comes out is a choice, or the tree of
a proof that there is none, whose leaves are multipliers of rows of the cover.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sampling_design.planning.covering import TIE, CoveringRows
from sampling_design.planning.evidence import CostProof, CostTree, proven_cost
from sampling_design.planning.hidden_trajectories import HiddenTrajectories
from sampling_design.planning.search_progress import MEETING
from sampling_design.records.arrays import Index, Mask
from sampling_design.records.budget import Budget

Array32 = npt.NDArray[np.float32]

MOST_NODES = 10_000  # nodes of a tree, beyond which it is given up
DEEPEST = 300  # branches above one another, at most: a tree is walked by calls within calls
MOST_ENTRIES = 20_000_000  # trajectories, their ends and the steps of a program, beyond which it is not written out


@dataclass(frozen=True, eq=False)
class HittingSet:
    """What a search among so few samples came to."""

    chosen: Mask | None = None  # (M, p): what sees every trajectory
    none: bool = False  # whether there is no such choice; neither if the search was given up
    proof: CostProof | None = None  # that there is none; None also where it takes what no proof counts


def smallest_hitting_set(
    covering: CoveringRows,
    pool: HiddenTrajectories,
    level: float,
    below: float,
    work: Budget,
    undetected_at: Sequence[Mask] = (),
) -> HittingSet | None:
    """A choice below a cost, within the limits, that sees every trajectory at a level, or that there is none.

    None where more than the number of samples counts, nothing limits it, or the program is too large to be written
    out: then a solver is asked. `undetected_at`: masks that a choice must meet, too, which no proof counts.
    """
    most = covering.most_samples(below)
    reaching = [a for a, trajectory in enumerate(pool.trajectories) if trajectory.reach >= level]
    size = len(reaching) * covering.problem.steps * covering.columns
    if most < 0 or size > MOST_ENTRIES or any(pool.trajectories[a].response is None for a in reaching):
        return None
    return _TreeSearch(covering, pool, level, below, most, work).run(undetected_at)


class _TreeSearch:
    """The tree, node by node."""

    def __init__(
        self, covering: CoveringRows, pool: HiddenTrajectories, level: float, below: float, most: int, work: Budget
    ):
        self.covering, self.pool, self.level = covering, pool, level
        self.below, self.most, self.work = below, most, work
        self.left, self.found, self.frame = MOST_NODES, False, covering.frame[0].shape[0]
        self.given = np.zeros(covering.columns + 1, dtype=bool)
        self.given[-1] = True  # the owner of what is asked for in any case
        rows = covering.trajectory_rows(pool, level)
        self.keys, self.shows, self.owner = rows.keys, rows.shows.astype(np.float32), rows.owner

    def run(self, undetected_at: Sequence[Mask]) -> HittingSet:
        """The search from the root."""
        own = self.covering.frame[0][[-1]].toarray()  # step 0 where it is fixed, else any step: a plan has a sample
        masks = [np.isin(np.arange(own.size), self.covering.place[where]) for where in undetected_at]
        self.shows = np.concatenate([self.shows, np.array([own[0], *masks], dtype=np.float32)])
        self.owner = np.append(self.owner, np.full(1 + len(masks), own.size))
        tree = self._node(np.arange(len(self.shows)), self.covering.ceiling(self.below) > 0, 0)
        if tree is None:
            return HittingSet(self.covering.choice(self.given[:-1].astype(float))) if self.found else HittingSet()
        return HittingSet(none=True, proof=self._proof_of(tree))

    def _node(self, unmet: Index, free: Mask, depth: int) -> CostTree | None:
        """The tree below what is given and what is still free; None once a choice is found, or nodes ran out."""
        self.left -= 1
        asked = unmet[self.given[self.owner[unmet]]]
        self.found = not asked.size
        if self.found:
            return None
        shows = self.shows[asked] * free
        self.work.add(MEETING, shows.size)
        counts = shows.sum(axis=1)
        first, left = int(np.argmin(counts)), self.most - int(self.given[:-1].sum())
        if counts[first] == 0:
            return self._closed(asked[first])
        apart = _apart(shows, counts, left + 1)
        if len(apart) > left:
            return self._counted(asked[apart])
        if self.left <= 0 or depth + counts[first] > DEEPEST or self.work.over:
            return None
        steps = np.flatnonzero(shows[first])
        branches = list[tuple[int, CostTree]]()
        for k in steps[np.argsort(-shows[:, steps].sum(axis=0), kind="stable")].tolist():
            free[k], self.given[k] = False, True
            below = self._node(unmet[self.shows[unmet, k] == 0], free.copy(), depth + len(branches) + 1)
            if below is None:
                return None
            self.given[k] = False
            branches.append((k, below))
        tree = self._closed(asked[first])
        for k, below in reversed(branches):
            tree = CostTree(variable=k, branches=(tree, below))
        return tree

    def _closed(self, row: np.intp) -> CostTree:
        """Where a trajectory is shown by nothing that is left: its row alone proves any cost."""
        return CostTree((int(row),), (self.below,))

    def _counted(self, rows: Index) -> CostTree:
        """Where so many trajectories ask for one sample each: the samples cost too much, or are too many."""
        price, count = float(self.covering.cost[0]), int(self.given[:-1].sum()) + len(rows)
        missing = self.below - price * count
        if missing <= TIE * self.below:
            return CostTree(tuple(rows.tolist()), (price,) * len(rows))
        A, b = self.covering.frame
        limit = min(self.covering.limits, key=lambda row: b[row] / A[row, 0])
        value = missing / (b[limit] - A[limit, 0] * count)
        each = price - value * A[limit, 0]
        return CostTree((*rows.tolist(), limit - self.frame), (*(each,) * len(rows), value))

    def _proof_of(self, tree: CostTree) -> CostProof | None:
        """The proof with the rows that it uses, the frame's before them."""
        used = sorted({row for leaf in tree.leaves() for row in leaf.rows})
        if used[-1] > len(self.keys):
            return None
        place = {row: self.frame + i for i, row in enumerate(row for row in used if 0 <= row < len(self.keys))}
        place[len(self.keys)] = self.frame - 1

        numbered = tree.numbered(lambda row: place.get(row, self.frame + row))
        proof = CostProof(self.level, self.below, tuple(self.keys[row] for row in sorted(place)[:-1]), numbered)
        return replace(proof, value=min(self.below, proven_cost(self.covering, self.pool, proof)))


def _apart(shows: Array32, counts: Array32, enough: int) -> Index:
    """Rows that share no step, those with few steps first, until there are so many."""
    taken, apart = list[int](), np.where(counts > 0, counts, np.inf)
    while len(taken) < enough and np.isfinite(apart.min()):
        taken.append(int(np.argmin(apart)))
        apart[shows @ shows[taken[-1]] > 0] = np.inf
    return np.array(taken, dtype=np.intp)
