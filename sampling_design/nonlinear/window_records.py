"""What a window problem is made of, and what came out: records that its program and all who solve it share."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from sampling_design.records.arrays import Array


class WindowData(NamedTuple):
    """One window of K intervals in scaled coordinates; row j of nodes lies at `edges[j]`.

    edges (K+1,) absolute times; inputs (K+1, m) physical, from each node on; later (K, m) what they have become at the
    end of each interval; y (K+1, p) with 0 where `mask` (K+1, p) is 0; prior (n,), and the upper triangular root (n, n)
    of what its error weighs, not discounted.
    """

    edges: Array
    inputs: Array
    later: Array
    y: Array
    mask: Array
    prior: Array
    root: Array


class ProgramPoint(NamedTuple):
    """Values of the unknowns, or of their multipliers: z0 (n,), v (K+1, r), w (K, q), z (K, degree, n)."""

    z0: Array
    v: Array
    w: Array
    z: Array


class WindowSolution(NamedTuple):
    """What came out: the unknowns and the multipliers (of bounds, dynamics, outputs), and how."""

    edges: Array
    point: ProgramPoint
    bound_multipliers: ProgramPoint
    row_multipliers: Array
    output_multipliers: Array
    cost: float
    status: Literal["ok", "infeasible", "solver failed"]
    message: str
    iterations: int
    seconds: float
    engine: Literal["ipopt", "newton"] = "ipopt"

    @property
    def last(self) -> Array:
        """Scaled state at the window's end."""
        return self.point.z[-1, -1] if len(self.point.z) else self.point.z0

    @property
    def nodes(self) -> Array:
        """Scaled states at the edges, (K+1, n)."""
        return np.vstack([self.point.z0[None], self.point.z[:, -1]])


class WindowSlopes(NamedTuple):
    """A window linearised at its solution, scaled.

    F (K, n, n) and G (K, n, q) carry a state and w over each interval; H (K+1, p, n) is the slope of the outputs at the
    nodes, outputs (K+1, p) what they are; roots (K+1, p, p) of their weights, zero where nothing was measured.
    """

    F: Array
    G: Array
    H: Array
    outputs: Array
    roots: Array
