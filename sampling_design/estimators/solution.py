"""What an engine hands back: the minimiser of a window problem, and every other trajectory relative to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design.estimators.estimator import Status

Array = npt.NDArray[np.float64]

DUAL_MARGIN = 1e-11
"""Share of the reference trajectory's cost by which a computed optimum may exceed the exact one (see `smooth`)."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """Backward recursion of the deviations from the minimiser: roots S_j (N+1, n, n) and gains G_j (N, n, n)."""

    roots: Array
    gains: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """The minimiser of a window problem.

    Attributes
    ----------
    nodes : (N+1, n)
        Smoothed states.
    covariance : (n, n)
        Pi(t)^-1 at the last node.
    cost, dual : float
        Cost at the minimiser, and a lower bound on the least cost.
    engine : str
    kernel : callable
        Returns the `Kernel`, made on demand.
    status : str
        "ok", "infeasible" or "solver failed".
    note : str
        What could not be met.
    """

    nodes: Array
    covariance: Array
    cost: float
    dual: float
    engine: str
    kernel: Callable[[], Kernel]
    status: Status = "ok"
    note: str = ""
