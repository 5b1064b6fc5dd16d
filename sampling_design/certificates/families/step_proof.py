"""Step inequalities Phi_h(P) >= Z, proven for every h of an interval by stepping along it.

With X = Phi_h(P), N(X) = A'X + XA + eta X + X G Qw^-1 G' X and c = max(0, largest eigenvalue of (N(X), X)) the flow
keeps e^{-cs} X <= Phi_s(X) for all s >= 0. So if theta = lambda_max(Z, X) < 1, the inequality holds on
[h, h - ln(theta)/c]; if theta >= 1 it fails at h. Many intervals are stepped along at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.exact.given_weights import NoiseWeights
from sampling_design.certificates.exact.window_problem import covariance_flow, growing_flow, whitened_rows
from sampling_design.certificates.families.graphs import PathCompleteGraph
from sampling_design.numerics.filtering import EPS
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import ENDLESS, Budget

MOST_STEPS = 300_000
"""Steps of one proof, all intervals together; a proof that needs more is nearly tight and counts as not closed."""
LEAST_REACH = 1e-9
"""A step shorter than this fraction of the whole interval: the inequality is tight there and counts as failed."""
ENOUGH_STEPS = 4_000  # steps after which a proof that has failed already looks for no further failures
BATCH = 4096  # steps taken at once
ROUNDINGS = 4  # n eps that rounding leaves open of an entry of a covariance
LEAST_COVARIANCE = 1e-280  # where Y is 0 to the last bit: its root and the inverse of that are numbers
FIRST_CUT = 16  # parts into which each interval is cut, to be stepped along side by side


@dataclass(frozen=True, eq=False)
class StepDynamics:
    """A plant with its weights in coordinates z = root'x: Y' = AY + YA' + eta Y + noise, samples add `information`."""

    A: Array
    noise: Array
    eta: float
    root: Array
    rows: dict[tuple[bool, ...], Array]

    @property
    def size(self) -> int:
        """Dimension n."""
        return len(self.A)

    def flow(self, durations: npt.ArrayLike) -> tuple[Array, Array]:
        """Return F and W of `growing_flow` for each duration."""
        return growing_flow(self.A, self.noise, self.eta, durations)

    def information(self, outputs: tuple[bool, ...]) -> Array:
        """C'R~C of a sample of these outputs."""
        C = self.rows[outputs]
        return C.T @ C

    def inside(self, X: Array) -> Array:
        """Matrices of quadratic forms of x (information, weights) in these coordinates."""
        half = np.linalg.solve(self.root, X)
        return symmetrise(np.swapaxes(np.linalg.solve(self.root, np.swapaxes(half, -1, -2)), -1, -2))

    def outside(self, X: Array) -> Array:
        """The inverse of `inside`."""
        return symmetrise(self.root @ X @ self.root.T)


def dynamics_of(plant: Plant, weights: NoiseWeights, eta: float, root: Array, graph: PathCompleteGraph) -> StepDynamics:
    """Return the recursion of `plant` in coordinates z = root'x, with the rows of each set of outputs of `graph`."""
    Qw, R, Qv = weights
    rows = {}
    for outputs in {edge.outputs for edge in graph.edges}:
        whitened = whitened_rows(plant.C, R, Qv, np.array([outputs], dtype=bool), 1)[0]
        rows[outputs] = np.linalg.solve(root, whitened.T).T
    return StepDynamics(*covariance_flow(plant, Qw, root), eta, root, rows)


@dataclass(frozen=True, eq=False)
class StepConditions:
    """Inequalities Phi_h(P[source]) >= Z on [low, high], all of them at once."""

    sources: Array
    targets: Array
    low: Array
    high: Array

    def __len__(self) -> int:
        return self.low.size


def edge_conditions(dynamics: StepDynamics, graph: PathCompleteGraph, P: Array) -> StepConditions:
    """Every edge: Phi_h(P_u) >= P_v - C_e'R~C_e."""
    edges = graph.edges
    targets = np.stack([P[e.target] - dynamics.information(e.outputs) for e in edges])
    ends = np.array([(e.low, e.high) for e in edges])
    return StepConditions(P[[e.source for e in edges]], targets, ends[:, 0], ends[:, 1])


def node_conditions(graph: PathCompleteGraph, P: Array, target: Array) -> StepConditions:
    """Every node: Phi_s(P_u) >= target for s up to its longest edge."""
    repeated = np.broadcast_to(target, P.shape)
    return StepConditions(P, repeated, np.zeros(graph.count), graph.tops)


@dataclass(frozen=True)
class StepOutcome:
    """How a proof ended: `failed` maps a condition to the (h, theta) where it was found violated.

    Theta just below 1 means that the steps became too short there. `open` conditions ran out of steps; `slack` is
    the least 1 - theta met.
    """

    failed: dict[int, tuple[float, float]]
    open: tuple[int, ...]
    slack: float
    steps: int

    @property
    def tight(self) -> bool:
        """Whether nothing is violated, but the steps were too short or too many."""
        return not self.proven and all(theta < 1 for _, theta in self.failed.values())

    @property
    def proven(self) -> bool:
        """Whether every condition holds on its whole interval."""
        return not self.failed and not self.open


def prove(dynamics: StepDynamics, conditions: StepConditions, budget: Budget = ENDLESS) -> StepOutcome:
    """Prove every condition on its whole interval, or say where it fails; what is left in the end stays open."""
    parts = np.linspace(0.0, 1.0, FIRST_CUT + 1)
    widths = conditions.high - conditions.low
    owner = np.repeat(np.arange(len(conditions)), FIRST_CUT)
    low = (conditions.low[:, None] + widths[:, None] * parts[:-1]).ravel()
    high = (conditions.low[:, None] + widths[:, None] * parts[1:]).ravel()
    high[FIRST_CUT - 1 :: FIRST_CUT] = conditions.high
    single = np.repeat(widths == 0, FIRST_CUT) & (np.arange(owner.size) % FIRST_CUT > 0)
    owner, low, high = owner[~single], low[~single], high[~single]
    failed: dict[int, tuple[float, float]] = {}
    slack, steps = 1.0, 0
    while owner.size and steps < (ENOUGH_STEPS if failed else MOST_STEPS) and not budget.over:
        now, rest = slice(0, BATCH), slice(BATCH, None)
        theta, reach = _step(dynamics, conditions, owner[now], low[now])
        steps += theta.size
        slack = min(slack, float(1 - theta.max()))
        # what is no wider than a last step is walked to its end, however short the steps
        bad = (theta >= 1) | (reach < np.minimum(LEAST_REACH * widths[owner[now]], high[now] - low[now]))
        for k in np.flatnonzero(bad):
            if theta[k] > failed.get(int(owner[k]), (0.0, 0.0))[1]:
                failed[int(owner[k])] = (float(low[k]), float(theta[k]))
        on = ~bad & (low[now] + reach < high[now])
        pieces = _cut(owner[now][on], low[now][on] + reach[on], high[now][on], reach[on])
        owner, low, high = (np.append(new, old[rest]) for new, old in zip(pieces, (owner, low, high), strict=True))
    return StepOutcome(failed, tuple(sorted(set(owner.tolist()))), slack, steps)


def _cut(owner: Index, low: Array, high: Array, reach: Array) -> tuple[Index, Array, Array]:
    """What is left of each interval, halved where it is long against the last step."""
    long = high - low > 4 * reach
    middle = (low[long] + high[long]) / 2
    stop = high.copy()
    stop[long] = middle
    return np.append(owner, owner[long]), np.append(low, middle), np.append(stop, high[long])


def beyond_rounding(Y: Array) -> tuple[Array, Array]:
    """Sizes u (K, n) and L (K, n, n) with u L L' u' what rounding leaves open of covariances, and more than they are.

    So less is proven, and they are never singular: of modes that no disturbance drives nothing may be left that sums of
    products could tell from 0.
    """
    n = Y.shape[-1]
    unit = np.sqrt(np.maximum(np.einsum("kii->ki", Y), LEAST_COVARIANCE))
    correlations = Y / unit[:, :, None] / unit[:, None, :]
    return unit, np.asarray(np.linalg.cholesky(correlations + ROUNDINGS * n * EPS * np.eye(n)))


def _step(dynamics: StepDynamics, conditions: StepConditions, owner: Index, h: Array) -> tuple[Array, Array]:
    """Theta at h, and how far beyond h the inequality is then proven."""
    times, where = np.unique(h, return_inverse=True)
    F, W = (part[where] for part in dynamics.flow(times))
    P = np.linalg.cholesky(conditions.sources[owner])
    half = np.linalg.solve(P, np.swapaxes(F, 1, 2))
    unit, L = beyond_rounding(symmetrise(np.swapaxes(half, 1, 2) @ half + W))
    root = unit[:, :, None] * L  # X = (root root')^-1
    theta = np.linalg.eigvalsh(symmetrise(np.swapaxes(root, 1, 2) @ conditions.targets[owner] @ root))[:, -1]
    drift = np.linalg.solve(L, dynamics.A @ root / unit[:, :, None])
    half = np.linalg.solve(L, dynamics.noise / unit[:, :, None] / unit[:, None, :])
    noise = np.linalg.solve(L, np.swapaxes(half, 1, 2))
    rate = drift + np.swapaxes(drift, 1, 2) + dynamics.eta * np.eye(dynamics.size) + noise
    c = np.linalg.eigvalsh(symmetrise(rate))[:, -1]
    gain = np.where(theta > 0, -np.log(np.where((theta > 0) & (theta < 1), theta, 1.0)), np.inf)
    free = (c <= 0) | np.isinf(gain)
    return np.asarray(theta, dtype=np.float64), np.where(free, np.inf, gain / np.where(free, 1.0, c))
