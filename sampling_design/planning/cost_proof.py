"""The proof of a cost: a tree, at each leaf some measurements given or forbidden, and multipliers for what is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias, Union

import numpy as np
import numpy.typing as npt

from sampling_design.planning.covering import CoveringRows, Key, proven
from sampling_design.planning.hidden_trajectories import HiddenTrajectories

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CostLeaf:
    """Multipliers: rows and their values."""

    rows: tuple[int, ...]
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class CostBranch:
    """One variable forbidden, or given."""

    variable: int
    without: CostTree
    given: CostTree


CostTree: TypeAlias = Union[CostLeaf, CostBranch]  # noqa: UP007


@dataclass(frozen=True, eq=False)
class CostProof:
    """Every choice that sees the attacks `keys` at `level` costs at least `value`."""

    level: float
    value: float
    keys: tuple[Key, ...]
    tree: CostTree


def proven_cost(cover: CoveringRows, pool: HiddenTrajectories, proof: CostProof) -> float:
    """What a proof's multipliers prove, worked out anew; no solver."""
    if any(not pool.ends[pool.attacks[a].goal][end % pool.steps] for a, end in proof.keys):
        return -np.inf
    model = cover.model(pool.attacks, list(proof.keys), proof.level)
    if not _fits(proof.tree, model.b.size, cover.columns):
        return -np.inf

    def below(tree: CostTree, low: Array, high: Array) -> float:
        if isinstance(tree, CostBranch):
            up, down = low.copy(), high.copy()
            up[tree.variable], down[tree.variable] = 1.0, 0.0
            return min(below(tree.without, low, down), below(tree.given, up, high))
        y = np.zeros(model.b.size)
        y[list(tree.rows)] = tree.values
        return proven(model, np.maximum(y, 0.0), low, high)

    # a choice that cost less than the claim could be turned so that its largest gap follows step 0
    return cover.lifted(below(proof.tree, np.zeros(cover.columns), cover.ceiling(proof.value)))


def _fits(tree: CostTree, rows: int, columns: int) -> bool:
    """Whether a tree names only rows and variables that there are."""
    if isinstance(tree, CostBranch):
        inside = 0 <= tree.variable < columns
        return inside and _fits(tree.without, rows, columns) and _fits(tree.given, rows, columns)
    return all(0 <= row < rows for row in tree.rows)
