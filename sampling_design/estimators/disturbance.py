"""What a bounded disturbance can do over one gap: bounds on omega that provably contain the truth.

A bound on w(t) is no bound on a constant w. Of all w that lead to the true displacement, the one of least cost
obeys |omega|^2 <= sup|w|^2_Qw (1 - e^{-eta h})/eta, since the true w costs no more than that; and every entry of
omega = L^+ int e^{As} G w ds lies between the support functions of the box of w, integrated over the gap.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import expm_batch
from sampling_design.errors import ArgumentError
from sampling_design.estimators.convex_set import Ball, ConvexSet
from sampling_design.estimators.flows import CACHE_SIZE, Flow, FlowTable, discounted_length
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]

CELL = 0.05
"""Cells of the gap have |A|_2 times length at most this; the remainder terms below are then a few per cent at worst."""

CELL_RANGE = (16, 2048)
"""Least and largest number of cells per gap."""


class DisturbanceReach:
    """The set of omega over each gap, for a set of w; remembered by gap length.

    Raises
    ------
    ArgumentError
        If the set is unbounded, or w is to be constant and does not follow from its effect.
    """

    def __init__(self, table: FlowTable, w: ConvexSet):
        self.table, self.w = table, w
        self.plant, self.weights = table.weights.plant, table.weights
        self._sets: dict[float, ConvexSet] = {}
        self._radius, self._box = self._ball_radius(), w.bounding_box()
        self._size = float(np.linalg.norm(self.plant.A, 2))
        bounded = all(bool(np.isfinite(side).all()) for side in self._box)
        if table.constant_w:
            if np.linalg.matrix_rank(self.plant.G) < self.plant.n_disturbances:
                raise ArgumentError('`w_model` = "constant" needs a G of full column rank, so that w follows from d.')
        elif not bounded:
            raise ArgumentError(
                "`w_set` is unbounded, so that an outer bound on what w can do says nothing. "
                'Bound every entry of w, or use w_model="constant" (not certified).'
            )

    def over(self, flow: Flow) -> ConvexSet:
        """Return the set that provably holds omega over this gap (for a constant w: the exact one)."""
        if flow.gap not in self._sets:
            if len(self._sets) >= CACHE_SIZE:
                self._sets.clear()
            self._sets[flow.gap] = self._exact(flow) if self.table.constant_w else self._outer(flow)
        return self._sets[flow.gap]

    def _ball_radius(self) -> float:
        """Least bound on |w|_Qw that a single ball gives."""
        half, best = np.linalg.cholesky(self.weights.w).T, np.inf
        for ball in self.w.balls:
            if np.linalg.matrix_rank(ball.shape) == self.w.dimension:
                gain = float(np.linalg.norm(half @ np.linalg.pinv(ball.shape), 2))
                best = min(best, float(np.linalg.norm(half @ ball.centre)) + ball.radius * gain)
        return best

    def _outer(self, flow: Flow) -> ConvexSet:
        width = flow.root.shape[1]
        lower, upper = np.full(width, -np.inf), np.full(width, np.inf)
        if self.w.rows.shape[0] or self.w.bounded.size:
            lower, upper = support_box(self.plant, flow, *self._box, self._size)
        balls: tuple[Ball, ...] = ()
        if np.isfinite(self._radius):
            length = float(np.sqrt(discounted_length(self.weights.eta, flow.gap)))
            balls = (Ball(self._radius * length, np.zeros(width), np.eye(width)),)
        return ConvexSet.known(lower, upper, np.zeros((0, width)), np.zeros(0), balls)

    def _exact(self, flow: Flow) -> ConvexSet:
        """The set of w itself, in the coordinates w = half omega."""
        w, width = self.w, flow.root.shape[1]
        length = float(np.sqrt(discounted_length(self.weights.eta, flow.gap)))
        half = np.linalg.solve(np.linalg.cholesky(self.weights.w), np.eye(width)).T / length
        low, high = np.flatnonzero(np.isfinite(w.lower)), np.flatnonzero(np.isfinite(w.upper))
        rows = np.vstack([w.rows @ half, half[high], -half[low]])
        offsets = np.concatenate([w.offsets, w.upper[high], -w.lower[low]])
        whole = np.full(width, np.inf)
        balls = tuple(Ball(b.radius, np.asarray(np.linalg.solve(half, b.centre)), b.shape @ half) for b in w.balls)
        return ConvexSet.known(-whole, whole, rows, offsets, balls)


def support_box(plant: Plant, flow: Flow, lower: Array, upper: Array, size: float) -> tuple[Array, Array]:
    """Return lower and upper bounds on omega over all w with `lower` <= w(t) <= `upper`; `size` = |A|_2.

    Notes
    -----
    *Method.* With phi(s) = L^+ e^{As} G and w = middle + deviation, the middle is exact and the deviation adds at
    most int |phi| half. Per cell of length d, int |phi| <= d|phi(m)| + d^3/24 sup|phi''|, and d^2/4 |phi'(m)| more
    where phi may change sign; sup|phi''_ki| <= |(L^+ A^2)_k| e^{|A|d/2} |e^{Am} g_i|.
    """
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    count = int(np.clip(np.ceil(size * flow.gap / CELL), *CELL_RANGE))
    d = flow.gap / count
    moved = _middles(plant, d, count)
    first = flow.whiten @ plant.A
    phi, slope = np.abs(flow.whiten @ moved), np.abs(first @ moved)
    bend = np.linalg.norm(first @ plant.A, axis=1) * np.exp(size * d / 2)
    second = np.outer(bend, np.sqrt(np.einsum("ij,ij->j", moved, moved)))
    turning = phi < slope * d / 2 + second * d * d / 8
    parts = d * phi + d**3 / 24 * second + np.where(turning, d * d / 4 * slope, 0.0)
    centre, reach = _steady(plant, flow, middle), parts.reshape(parts.shape[0], count, -1).sum(axis=1) @ half
    return centre - reach, centre + reach


def _middles(plant: Plant, d: float, count: int) -> Array:
    """e^{A (k + 1/2) d} G for k < count side by side, (n, count q), by doubling."""
    half = expm_batch(plant.A, [d / 2])[0]
    moved, power = half @ plant.G, half @ half
    while moved.shape[1] < count * plant.n_disturbances:
        moved = np.concatenate([moved, power @ moved], axis=1)
        power = power @ power
    return moved[:, : count * plant.n_disturbances]


def _steady(plant: Plant, flow: Flow, w: Array) -> Array:
    """L^+ int_0^h e^{As} G w ds for a constant w, exactly."""
    n = plant.n_states
    if not w.any():
        return np.zeros(flow.whiten.shape[0])
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = plant.A, plant.G @ w
    return np.asarray(flow.whiten @ expm_batch(block, [flow.gap])[0, :n, n])
