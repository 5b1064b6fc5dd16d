"""What a bounded disturbance can do over one gap: bounds on omega that provably contain the truth.

A bound on w(t) is no bound on a constant w. Of all w that lead to the true displacement, the one of least cost
obeys |omega|^2 <= sup|w|^2_Qw (1 - e^{-eta h})/eta, since the true w costs no more than that; and every entry of
omega = L^+ int e^{As} G w ds lies between the support functions of the box of w, integrated over the gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import expm_batch
from sampling_design.errors import ArgumentError
from sampling_design.estimators.convex_set import Ball, ConvexSet
from sampling_design.estimators.flows import CACHE_SIZE, Flow, FlowTable, discounted_length
from sampling_design.estimators.weights import Weights
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]

CELL = 0.1
"""Cells of the gap have |A|_2 times length at most this; the remainder terms below are then a few per cent at worst."""

CELL_RANGE = (16, 2048)
"""Least and largest number of cells per gap, to within a factor of two: a cell's length is a power of two."""


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
        self._responses = Responses(self.plant)
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
            lower, upper = support_box(self._responses, self.weights, flow, *self._box)
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


@dataclass(frozen=True, eq=False)
class _Cells:
    """e^{As} G in the middle of equal cells from s = 0 on, (n, K, q), and the norms of its columns, (K, q)."""

    length: float
    moved: Array
    norms: Array


class Responses:
    """e^{As} G on grids that all gaps share: one for each length of cells, remembered as far as it was asked for."""

    def __init__(self, plant: Plant):
        self.plant, self.size = plant, float(np.linalg.norm(plant.A, 2))
        self._grids: dict[float, _Cells] = {}

    def over(self, gap: float) -> _Cells:
        """Return the cells that cover a gap; the last one may end beyond it."""
        longest, shortest = (gap / number for number in CELL_RANGE)
        wanted = min(CELL / self.size, longest) if self.size > 0 else longest
        length = 2.0 ** math.floor(math.log2(max(wanted, shortest)))
        count = math.ceil(gap / length)
        known = self._grids.get(length)
        if known is None or known.norms.shape[0] < count:
            known = self._grids[length] = self._grid(length, count)
        return _Cells(length, known.moved[:, :count], known.norms[:count])

    def _grid(self, length: float, count: int) -> _Cells:
        """At least `count` cells, by doubling."""
        (half,) = expm_batch(self.plant.A, [length / 2])
        moved, power = (half @ self.plant.G)[:, None, :], half @ half
        while moved.shape[1] < count:
            moved = np.concatenate([moved, np.tensordot(power, moved, 1)], axis=1)
            power = power @ power
        return _Cells(length, moved, np.sqrt(np.einsum("ikj,ikj->kj", moved, moved)))


def support_box(responses: Responses, weights: Weights, flow: Flow, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return lower and upper bounds on omega over all w with `lower` <= w(t) <= `upper`.

    Notes
    -----
    *Method.* With phi(s) = L^+ e^{As} G and w = middle + deviation, the middle is exact and the deviation adds at
    most int |phi| half. Per cell of length d and middle m, int |phi| <= d|phi(m)| + d^3/24 sup|phi''|, and
    d^2/4 |phi'(m)| more where phi may change sign; sup|phi''_ki| <= |(L^+ A^2)_k| e^{|A|d/2} |e^{Am} g_i|. Of the last
    cell only the part up to the gap's end counts. Nor is any entry's deviation more than that of |omega|, which the
    cost bounds: over many fast time constants the cells say less than that.
    """
    cells, n = responses.over(flow.gap), flow.F.shape[0]
    d, K, q = cells.length, *cells.norms.shape
    first = flow.whiten @ responses.plant.A
    both = np.concatenate([flow.whiten, first]) @ cells.moved.reshape(n, -1)
    phi, slope = both.reshape(2, -1, K, q)
    bend = np.linalg.norm(first @ responses.plant.A, axis=1) * np.exp(responses.size * d / 2)
    second = bend[:, None, None] * cells.norms
    upto = np.full((K, 1), d)
    upto[-1] = flow.gap - (K - 1) * d
    beyond = upto - d / 2  # the cell as seen from its middle: from -d/2 to here
    size, rise = np.abs(phi), np.abs(slope)
    turning = size < rise * (d / 2) + second * (d * d / 8)
    level = np.abs(upto * phi + (beyond**2 - d * d / 4) / 2 * slope)
    parts = np.where(turning, upto * size + (beyond * np.abs(beyond) + d * d / 4) / 2 * rise, level)
    parts += (beyond**3 + d**3 / 8) / 6 * second
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    most = math.sqrt(float(half @ np.abs(weights.w) @ half) * float(discounted_length(weights.eta, flow.gap)))
    centre = flow.whiten @ (flow.integral @ (responses.plant.G @ middle))
    reach = np.minimum(parts.sum(axis=1) @ half, most)
    return centre - reach, centre + reach
