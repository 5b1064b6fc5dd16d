"""The proof of a cost: a tree, at each leaf some measurements given or forbidden, and multipliers for what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, Union

import numpy as np

from sampling_design.planning.covering import CoveringProgram, CoveringRows, Key, proven
from sampling_design.planning.hidden_trajectories import HiddenTrajectories
from sampling_design.records.arrays import Array


@dataclass(frozen=True, eq=False)
class CostLeaf:
    """Multipliers: rows and their values."""

    rows: tuple[int, ...]
    values: tuple[float, ...]

    def leaves(self) -> list[CostLeaf]:
        """All leaves of the tree."""
        return [self]

    def fits(self, rows: int, columns: int) -> bool:
        """Whether a tree names only rows and variables that there are."""
        return all(0 <= row < rows for row in self.rows)

    def numbered(self, place: Callable[[int], int]) -> CostLeaf:
        """The tree with other numbers of rows."""
        return CostLeaf(tuple(map(place, self.rows)), self.values)

    def below(self, model: CoveringProgram, low: Array, high: Array) -> float:
        """What the tree proves of choices between bounds."""
        y = np.zeros(model.b.size)
        y[list(self.rows)] = self.values
        return proven(model, np.maximum(y, 0.0), low, high)

    def to_list(self) -> list[dict[str, object]]:
        """Nodes in the order of a walk, first what is without the variable: a file is never nested deeply."""
        return [{"multipliers": [[row, value] for row, value in zip(self.rows, self.values, strict=True)]}]


@dataclass(frozen=True, eq=False)
class CostBranch:
    """One variable forbidden, or given."""

    variable: int
    without: CostTree
    given: CostTree

    def leaves(self) -> list[CostLeaf]:
        """All leaves of the tree."""
        return [*self.without.leaves(), *self.given.leaves()]

    def fits(self, rows: int, columns: int) -> bool:
        """Whether a tree names only rows and variables that there are."""
        both = self.without.fits(rows, columns) and self.given.fits(rows, columns)
        return 0 <= self.variable < columns and both

    def numbered(self, place: Callable[[int], int]) -> CostBranch:
        """The tree with other numbers of rows."""
        return CostBranch(self.variable, self.without.numbered(place), self.given.numbered(place))

    def below(self, model: CoveringProgram, low: Array, high: Array) -> float:
        """What the tree proves of choices between bounds."""
        up, down = low.copy(), high.copy()
        up[self.variable], down[self.variable] = 1.0, 0.0
        return min(self.without.below(model, low, down), self.given.below(model, up, high))

    def to_list(self) -> list[dict[str, object]]:
        """Nodes in the order of a walk."""
        return [{"variable": self.variable}, *self.without.to_list(), *self.given.to_list()]


CostTree: TypeAlias = Union[CostLeaf, CostBranch]  # noqa: UP007


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
