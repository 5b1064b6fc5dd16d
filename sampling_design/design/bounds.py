"""The upper bound as evidence: multipliers in the plant's own coordinates, checked without any solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sampling_design.design.bound import placed_bound, relative_bound
from sampling_design.design.problem import DesignProblem
from sampling_design.design.relaxation import Relaxation
from sampling_design.evidence import SolverRecord

Array = npt.NDArray[np.floating[Any]]
Kind = Literal["placed", "relative"]

_NEGLIGIBLE = 1e-9  # multipliers below this share of the total are left out: the bound holds with any of them


@dataclass(frozen=True, eq=False)
class UpperBound:
    """Multipliers, and the sigma that no admissible schedule over all real times can beat.

    `weights` (M, n, n) are psd in the coordinates of `problem.plant` with traces that sum to one; any such
    matrices give a true bound, which `value_for` works out anew.
    """

    kind: Kind
    value: float
    starts: Array
    weights: Array
    cosines: Array

    def value_for(self, problem: DesignProblem) -> float:
        """The bound that these multipliers prove for `problem`, from the data alone."""
        total = float(np.trace(self.weights, axis1=1, axis2=2).sum())
        least = float(np.linalg.eigvalsh(self.weights).min(initial=0.0))
        if total <= 0 or least < -1e-12 * total or np.any(self.cosines < 0):
            return np.inf
        R = problem.rows.R
        return evaluate(problem, self.kind, self.starts, R @ (self.weights / total) @ R.T, self.cosines)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "kind": self.kind,
            "value": self.value,
            "starts": self.starts.tolist(),
            "weights": self.weights.tolist(),
            "cosines": self.cosines.tolist(),
        }


def evaluate(problem: DesignProblem, kind: Kind, starts: Array, Z: Array, cosines: Array) -> float:
    """Bound from multipliers in the scaled basis, sum <Z, S'S> = 1."""
    record = SolverRecord("none")
    found = Relaxation(np.zeros(0), np.zeros(0), starts, Z, cosines, np.nan, record)
    return placed_bound(problem, found) if kind == "placed" else relative_bound(problem, found)


def upper_bound(problem: DesignProblem, kind: Kind, found: Relaxation) -> UpperBound:
    """Turn a relaxation's multipliers into a bound over all real times."""
    S = problem.rows.S
    weights = S @ found.Z @ S.T
    weights = (weights + np.swapaxes(weights, 1, 2)) / 2
    traces = np.trace(weights, axis1=1, axis2=2)
    kept = traces > _NEGLIGIBLE * traces.sum()
    weights, starts = weights[kept] / traces[kept].sum(), found.starts[kept]
    bare = UpperBound(kind, np.inf, starts, weights, found.cosines)
    return UpperBound(kind, bare.value_for(problem), starts, weights, found.cosines)
