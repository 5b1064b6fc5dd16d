"""The window problem: a finite problem that is exactly the one over functions w.

Nodes s = s_0 < s_1 < ... < s_N = t are the window's start, its samples and, if asked for, check points.
With x_{j+1} = F_j x_j + b_j + L_j omega_j and L_j L_j' = W_j the cost is
    e^{-eta M}|x_0 - prior|^2_P + sum_j e^{-eta(t - s_{j+1})}|omega_j|^2
        + sum_j e^{-eta(t - s_j)}|y_j - C x_j - D u_j|^2_Y,
since the least int e^{-eta(s_{j+1} - tau)}|w|^2_Qw that leads to a displacement d is d'W^-1 d, with
W_h = int_0^h e^{+eta s} e^{As} G Qw^-1 G' e^{A's} ds (the sign is that of the theory: s counts backwards).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.gap_flows.flows import CONDITION_LIMIT, GapFlow
from sampling_design.estimators.window.means import MeanRows
from sampling_design.records.arrays import Array, Index


@dataclass(frozen=True, eq=False)
class EstimationWindow:
    """Data of one window problem, centred on a reference trajectory."""

    weights: CostWeights
    times: Array  # (N+1,): nodes
    flows: list[GapFlow]
    # (N+1, n): any trajectory; reference[0] is the prior. Unknown is the deviation from it, so that numbers stay of the
    # size of the errors however far the state itself wanders.
    reference: Array
    drift: Array  # (N, n): the inputs' part of each gap
    y: Array  # y, feedthrough, (N+1, p): measurements (0 where missing) and D u
    masks: Array  # (N+1, p): 1.0 where measured
    feedthrough: Array
    prior_root: Array  # (n, n): S with S S' = P^-1
    # (N+1, 2, p): what C x lies between where limits of detection were read, infinite elsewhere
    limits: Array | None = None
    means: MeanRows | None = None  # composite samples

    @cached_property
    def F(self) -> Array:
        """Transitions, (N, n, n)."""
        n = self.reference.shape[1]
        return np.array([flow.F for flow in self.flows]).reshape(-1, n, n)

    @cached_property
    def defect(self) -> Array:
        """F_j reference_j + b_j - reference_{j+1}, (N, n)."""
        led = np.matmul(self.F, self.reference[:-1, :, None])[:, :, 0]
        return np.asarray(led + self.drift - self.reference[1:])

    @cached_property
    def residual(self) -> Array:
        """y - D u - C reference where measured, else 0, (N+1, p)."""
        return np.asarray((self.y - self.feedthrough - self.reference @ self.weights.plant.C.T) * self.masks)

    @cached_property
    def discount(self) -> Array:
        """e^{-eta(t - s_j)}, (N+1,)."""
        return np.asarray(np.exp(self.weights.eta * (self.times - self.times[-1])))

    @cached_property
    def joint(self) -> Array | None:
        """Costs of the states at both ends of every gap, (N, 2n, 2n): see `GapFlow.joint`.

        None if some W, or the covariance of a carried prior, is not to be inverted.
        """
        blocks = [flow.joint for flow in self.flows]
        if any(block is None for block in blocks) or not self._prior_fits:
            return None
        n, root = self.reference.shape[1], np.sqrt(self.discount)
        ends = np.repeat(np.column_stack([root[:-1], root[1:]]), n, axis=1)
        joint: Array = np.array(blocks).reshape(-1, 2 * n, 2 * n) * ends[:, :, None] * ends[:, None, :]
        return joint

    @property
    def _prior_fits(self) -> bool:
        """Whether the prior's information is given, or found from its covariance losing less than six digits."""
        root = self.prior_root
        if root is self.weights.prior_root:
            return True
        unit = root / np.linalg.norm(root, axis=1)[:, None]
        values = np.linalg.eigvalsh(unit @ unit.T)
        return bool(values[0] * CONDITION_LIMIT > values[-1])

    @cached_property
    def prior_half(self) -> Array:
        """U with U'U = e^{-eta M} P."""
        if self.prior_root is self.weights.prior_root:
            half = self.weights.prior_factor.T
        else:
            half = np.asarray(np.linalg.solve(self.prior_root, np.eye(self.prior_root.shape[0])))
        return np.asarray(half * np.sqrt(self.discount[0]))

    @cached_property
    def all_or_none(self) -> bool:
        """Whether every node measures every output or none."""
        return bool((self.masks == self.masks[:, :1]).all())

    def weighted(self, residual: Array) -> Array:
        """Return the roots of the samples' weights times (N+1, p) residuals, what is not measured left out."""
        if self.all_or_none:
            return np.asarray((residual * self.masks) @ self.weights.y_root.T)
        return np.asarray(np.matmul(self.weights.of(self.masks).y_root, residual[:, :, None])[:, :, 0])

    def total(self, energies: Array) -> float:
        """Return the discounted sum of one bound per node; infinite where one is, however old the node."""
        return float(np.dot(self.discount, energies)) if np.isfinite(energies).all() else np.inf

    @property
    def samples(self) -> Index:
        """Indices of the nodes at which something is measured."""
        return np.flatnonzero(self.masks.any(axis=1))
