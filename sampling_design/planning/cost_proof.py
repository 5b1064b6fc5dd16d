"""The proof of a cost: a tree, at each leaf some measurements given or forbidden, and multipliers for what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.planning.covering import CoveringProgram, CoveringRows, Key, proven
from sampling_design.planning.hidden_trajectories import HiddenTrajectories
from sampling_design.records.arrays import Array


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
    """Every choice that sees the trajectories `keys` at `level` costs at least `value`."""

    level: float
    value: float
    keys: tuple[Key, ...]
    tree: CostTree


def proven_cost(covering: CoveringRows, pool: HiddenTrajectories, proof: CostProof) -> float:
    """What a proof's multipliers prove, worked out anew; no solver."""
    if any(not pool.ends[pool.trajectories[a].goal][end % pool.steps] for a, end in proof.keys):
        return -np.inf
    model = covering.model(pool.trajectories, list(proof.keys), proof.level)
    if not proof.tree.fits(model.b.size, covering.columns):
        return -np.inf

    # a choice that cost less than the claim could be turned so that its largest gap follows step 0
    return covering.lifted(proof.tree.below(model, np.zeros(covering.columns), covering.ceiling(proof.value)))
