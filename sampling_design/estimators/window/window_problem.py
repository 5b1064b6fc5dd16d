"""The window problem, a finite problem that is exactly the one over functions w, and what an engine hands back.

Nodes s = s_0 < s_1 < ... < s_N = t are the window's start, its samples and, if asked for, check points.
With x_{j+1} = F_j x_j + b_j + L_j omega_j and L_j L_j' = W_j the cost is
    e^{-eta M}|x_0 - prior|^2_P + sum_j e^{-eta(t - s_{j+1})}|omega_j|^2
        + sum_j e^{-eta(t - s_j)}|y_j - C x_j - D u_j|^2_Y,
since the least int e^{-eta(s_{j+1} - tau)}|w|^2_Qw that leads to a displacement d is d'W^-1 d, with
W_h = int_0^h e^{+eta s} e^{As} G Qw^-1 G' e^{A's} ds (the sign is that of the theory: s counts backwards).

Composite samples are means of outputs over an interval, as exact rows. Given the states x_j at the nodes, the integral
of an output over each gap is linear in the states at its ends, but for a part of w that leads nowhere else. With I the
integral, d the gap's displacement and [[W, c], [c', b]] the Gramian of both,
    I = E x_j + c'W^+ d + r,    of cost r^2/(b - c'W^+ c),
so that the mean is a row of all states of its interval, and r joins its noise. What K means add to a problem
of minimiser x* and trajectories x* + T z (`smoother.py`) is of rank K:
    min |z|^2 + |target - g x* - g T z|^2_{V^-1}.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.gap_flows.flows import CONDITION_LIMIT, FlowTable, GapFlow, noise_root
from sampling_design.estimators.online.estimate import Status
from sampling_design.estimators.online.history import EstimatorState
from sampling_design.numerics.filtering import propagate
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index

DUAL_MARGIN = 1e-11
"""Share of the reference trajectory's cost by which a computed optimum may exceed the exact one (see `smooth`)."""


@dataclass(frozen=True, eq=False)
class EstimateDeviations:
    """All trajectories x = x* + T z around a minimiser x*; each costs |z|^2 more.

        x_N = x*_N + S_N y_N,    x_j = x*_j + G_j (x_{j+1} - x*_{j+1}) + S_j y_j,    y = Q z

    roots S (N+1, n, n), gains G (N, n, n); Q = I, or I - Z' diag(loss) Z with orthonormal rows Z (K, (N+1) n), of which
    composite samples say more: `known` = (Z, loss).
    """

    roots: Array
    gains: Array
    known: tuple[Array, Array] | None = None

    def _through(self, g: Array) -> Array:
        """Return g Q."""
        if self.known is None:
            return g
        Z, loss = self.known
        return np.asarray(g - (g @ Z.T * loss) @ Z)

    def covariances(self) -> Array:
        """Return T_j T_j' of every node, (N+1, n, n)."""
        if self.known is not None:
            T = self.maps()
            return np.asarray(np.matmul(T, np.swapaxes(T, 1, 2)))
        found: Array = np.matmul(self.roots, np.swapaxes(self.roots, 1, 2))
        for j in range(len(self.gains) - 1, -1, -1):
            found[j] += symmetrise(self.gains[j] @ found[j + 1] @ self.gains[j].T)
        return found

    def maps(self) -> Array:
        """Return T as (N+1, n, (N+1) n): block rows T_j = [0, S_j, G_j S_{j+1}, G_j G_{j+1} S_{j+2}, ...] Q."""
        count, n = self.roots.shape[:2]
        return self.rows(np.eye(count * n)).reshape(count, n, count * n)

    def states(self, z: Array) -> Array:
        """Return T z, (N+1, n)."""
        found: Array = np.matmul(self.roots, self._through(z).reshape(*self.roots.shape[:2], 1))[:, :, 0]
        for j in range(len(self.gains) - 1, -1, -1):
            found[j] += self.gains[j].dot(found[j + 1])
        return found

    def rows(self, g: Array) -> Array:
        """Return g T for (r, (N+1) n) rows g."""
        led = g.reshape(len(g), *self.roots.shape[:2]).transpose(1, 0, 2).copy()
        for j in range(len(self.gains)):
            led[j + 1] += led[j].dot(self.gains[j])
        return self._through(np.matmul(led, self.roots).transpose(1, 0, 2).reshape(g.shape))


@dataclass(frozen=True, eq=False)
class WindowEstimate:
    """The minimiser of a window problem."""

    nodes: Array  # (N+1, n): smoothed states
    covariance: Array  # (n, n): pi(t)^-1 at the last node
    cost: float  # cost, dual: cost at the minimiser, and a lower bound on the least cost
    dual: float
    engine: str
    spread: EstimateDeviations  # every other trajectory relative to this one
    status: Status = "ok"  # "ok", "infeasible" or "solver failed"
    note: str = ""  # what could not be met
    held: float = 0.0  # squares of the numbers behind the nodes, in units of what is known of each; see `moved`


class MeanReading(NamedTuple):
    """A mean over the nodes from `begin` to `end` of an output, D u in it."""

    output: int
    begin: int
    end: int
    value: float


def means_of(sample: RecordRow) -> tuple[tuple[int, float, float], ...]:
    """Return output, beginning and value of the means that a sample holds as numbers, none of them a limit."""
    return tuple(
        (each.output, each.since, each.lower)
        for each in sample.censored
        if each.since is not None and each.lower == each.upper
    )


@dataclass(frozen=True, eq=False)
class MeanRows:
    """The means of one window, as rows of the deviations from its reference.

    Attributes
    ----------
    readings : K readings
    rows : (K, N+1, n)
    target : (K,)
        What they show beyond the reference.
    spread : (K, K)
        V, in units of the window's cost.
    masks : (N+1, p)
        1.0 where a mean was read.
    y : (N+1, p)
        Means, 0 elsewhere.
    """

    readings: tuple[MeanReading, ...]
    rows: Array
    target: Array
    spread: Array
    masks: Array
    y: Array

    def without(self, k: int) -> MeanRows | None:
        """Return all but one; None where there is no other."""
        kept = [j for j in range(len(self.readings)) if j != k]
        if not kept:
            return None
        one = self.readings[k]
        masks, y = self.masks.copy(), self.y.copy()
        masks[one.end, one.output] = y[one.end, one.output] = 0.0
        readings = tuple(self.readings[j] for j in kept)
        return MeanRows(readings, self.rows[kept], self.target[kept], self.spread[np.ix_(kept, kept)], masks, y)


class IntegralFlows:
    """Flows of a plant's state and of the integrals of all its outputs, with the same disturbance."""

    def __init__(self, weights: CostWeights, constant_w: bool = False):
        plant, n = weights.plant, weights.plant.n_states
        p = plant.n_outputs
        A = np.zeros((n + p, n + p))
        A[:n, :n], A[n:, :n] = plant.A, plant.C
        longer = Plant(
            A, np.hstack([plant.C, np.zeros((p, p))]), B=np.vstack([plant.B, plant.D]), D=plant.D,
            G=np.vstack([plant.G, np.zeros((p, plant.n_disturbances))]), time_unit=plant.time_unit,
        )  # fmt: skip
        prior = block_diag(weights.prior, np.diag(plant.outputs.scales**-2.0))
        self.n, self.weights = n, weights
        self.table = FlowTable(replace(weights, plant=longer, prior=prior), constant_w)

    def means(
        self, state: EstimatorState, times: Sequence[float], reference: Array, residual: Array, masks: Array,
        readings: Sequence[MeanReading],
    ) -> MeanRows:  # fmt: skip
        """Return means as rows; residual and masks are those of the window's plain readings."""
        n, weights, count = self.n, self.weights, len(readings)
        p = weights.plant.n_outputs
        rows, predicted_means = np.zeros((count, len(times), n)), np.zeros(count)
        length = np.array([times[r.end] - times[r.begin] for r in readings])
        picked = np.zeros((count, p))
        picked[np.arange(count), [r.output for r in readings]] = 1 / length
        spread = np.zeros((count, count))
        grown = np.exp(weights.eta * (times[-1] - np.asarray(times)))
        bare = state._replace(reached=None)
        flows = self.table.get([b - a for a, b in pairwise(times)])
        for j, flow in enumerate(flows):
            inside = [k for k, r in enumerate(readings) if r.begin <= j < r.end]
            if not inside:
                continue
            F, W, drift = flow.F, flow.W, bare.drift(self.table, times[j], times[j + 1])
            whiten = noise_root(W[:n, :n])[1]
            gain = (W[n:, :n] @ whiten.T) @ whiten
            moved = reference[j + 1] - F[:n, :n] @ reference[j] - drift[:n]
            rest = W[n:, n:] - gain @ W[:n, n:]
            take = picked[inside]
            predicted_means[inside] += take @ (F[n:, :n] @ reference[j] + drift[n:] + gain @ moved)
            rows[inside, j] += take @ (F[n:, :n] - gain @ F[:n, :n])
            rows[inside, j + 1] += take @ gain
            at = np.ix_(inside, inside)
            spread[at] = propagate((rest + rest.T) / 2 * grown[j + 1], take, spread[at])
        together, y = np.zeros_like(masks), np.zeros_like(masks)
        for r in readings:
            together[r.end, r.output], y[r.end, r.output] = 1.0, r.value
        target = np.array([r.value for r in readings]) - predicted_means
        for end in {r.end for r in readings}:
            own = [k for k, r in enumerate(readings) if r.end == end]
            outputs = [readings[k].output for k in own]
            weight = weights.at(masks[end] + together[end]).y
            part = weight[np.ix_(outputs, outputs)]
            beside = -np.linalg.solve(part, weight[outputs] * masks[end])
            target[own] -= beside @ residual[end]
            rows[own, end] -= beside @ weights.plant.C
            spread[np.ix_(own, own)] += np.linalg.solve(part, np.eye(len(own))) * grown[end]
        return MeanRows(tuple(readings), rows, target, (spread + spread.T) / 2, together, y)


def with_means(solution: WindowEstimate, reference: Array, means: MeanRows) -> WindowEstimate:
    """Return the minimiser with the means, given that without them.

    Notes
    -----
    *Numerical aspects.* V is definite, since noise is; the covariance is a product with its own root.
    """
    count = len(means.target)
    flat = means.rows.reshape(count, -1)
    left = means.target - flat @ (solution.nodes - reference).ravel()
    root = np.linalg.cholesky(means.spread)
    half = np.linalg.solve(root, np.column_stack([solution.spread.rows(flat), left]))
    B, r = half[:, :-1], half[:, -1]
    U, s, Z = np.linalg.svd(B, full_matrices=False)
    inside = U.T @ r
    z = Z.T @ (s / (1 + s**2) * inside)
    # |r|^2 - sum s^2/(1 + s^2) inside^2, without cancellation
    beside = r - U @ inside
    added = float(beside @ beside + np.sum(inside**2 / (1 + s**2)))
    predicted_means = np.linalg.solve(root, means.target)
    spread = replace(solution.spread, known=(Z, 1 - 1 / np.sqrt(1 + s**2)))
    n, size = len(solution.covariance), flat.shape[1]
    last = spread.rows(np.eye(n, size, size - n))
    return replace(
        solution,
        nodes=solution.nodes + solution.spread.states(z),
        covariance=last @ last.T,
        cost=solution.cost + added,
        dual=solution.dual + added - DUAL_MARGIN * (added + float(predicted_means @ predicted_means)),
        spread=spread,
    )


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
