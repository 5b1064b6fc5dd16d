"""What a bounded disturbance can do over one gap: bounds on omega that provably contain the truth.

A bound on w(t) is no bound on a constant w. Of all w that lead to the true displacement, the one of least cost
obeys |omega|^2 <= sup|w|^2_Qw (1 - e^{-eta h})/eta, since the true w costs no more than that; and every entry of
omega = L^+ int e^{As} G w ds lies between the support functions of the box of w, integrated over the gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.convex_set import ConvexSet, NormBall, all_inside, normed
from sampling_design.estimators.gap_flows.composed_flow import state_units
from sampling_design.estimators.gap_flows.flows import CACHE_SIZE, FlowTable, GapFlow, discounted_length
from sampling_design.numerics.linalg import expm_batch
from sampling_design.records.arrays import Array

CELL = 0.05
"""Cells have |A|_2 times length at most this. The bounds are then loose by less than a thousandth for most plants and
gaps, and by tenths at worst, over many fast time constants."""

CELL_RANGE = (32, 2048)
"""Least and largest number of cells per gap, to within a factor of two: a cell's length is a power of two."""


class DisturbanceReach:
    """The set of omega over each gap, for a set of w; remembered by gap length.

    Raises ArgumentError if the set is unbounded, or w is to be constant and does not follow from its effect.
    """

    def __init__(self, table: FlowTable, w: ConvexSet):
        self.table, self.w = table, w
        self.plant, self.weights = table.weights.plant, table.weights
        self._sets: dict[float, ConvexSet] = {}
        self._gaps: dict[float, Array] = {}
        self._radius, self._box = self._ball_radius(), w.bounding_box()
        # states count in units, so that norms of A mean something
        self.units = state_units(self.plant.A, self.weights.units)
        self.A, self.G = self.plant.A * self.units / self.units[:, None], self.plant.G / self.units[:, None]
        self.size = float(np.linalg.norm(self.A, 2))
        self._grids: dict[float, tuple[Array, Array]] = {}
        bounded = all(bool(np.isfinite(side).all()) for side in self._box)
        if table.constant_w:
            if np.linalg.matrix_rank(normed(self.plant.G / self.weights.units[:, None])) < self.plant.n_disturbances:
                raise ArgumentError('`w_model` = "constant" needs a G of full column rank, so that w follows from d.')
        elif not bounded:
            raise ArgumentError(
                "`constraints.w` is unbounded, so that an outer bound on what w can do says nothing. "
                'Bound every entry of w, or use w_model="constant" (not certified).'
            )

    def over(self, flows: Sequence[GapFlow]) -> list[ConvexSet]:
        """Return the sets that provably hold omega over these gaps (for a constant w: the exact ones)."""
        known = self._sets
        missing = {flow.gap: flow for flow in flows if flow.gap not in known}
        if missing:
            if len(known) + len(missing) > CACHE_SIZE:
                known.clear()
                missing = {flow.gap: flow for flow in flows}
            new = list(missing.values())
            found = map(self._exact, new) if self.table.constant_w else self._outer(new)
            known.update(zip(missing, found, strict=True))
        return [known[flow.gap] for flow in flows]

    def holds(self, flows: Sequence[GapFlow], deviation: Array, defect: Array) -> bool:
        """Whether omega over each gap lies in its set, for states (N + 1, n) that deviate so from a reference.

        `defect` (N, n): what each gap misses there. What disturbances do that are constant over a gap and in the box
        tells most often, without the sets.
        """
        n, every = self.plant.n_states, np.array([self._response(flow) for flow in flows])
        whiten, led, through = every[:, :, :n], every[:, :, n : 2 * n], every[:, :, 2 * n :]
        moved, before = (deviation[1:] - defect)[:, :, None], deviation[:-1, :, None]
        omega = (np.matmul(whiten, moved) - np.matmul(led, before))[:, :, 0]
        lower, upper = self._box
        if not self.table.constant_w and np.isfinite(lower).all() and np.isfinite(upper).all():
            half, middle = (upper - lower) / 2, (lower + upper) / 2
            length = discounted_length(self.weights.eta, [flow.gap for flow in flows])
            least = np.minimum(np.abs(through) @ half, np.sqrt(self.weights.disturbance_energy(half) * length)[:, None])
            inside = np.abs(omega - through @ middle) <= least
            if inside.all() and (np.vecdot(omega, omega) <= self._radius**2 * length).all():
                return True
        return all(all_inside(chosen, own[None]) for chosen, own in zip(self.over(flows), omega, strict=True))

    def _response(self, flow: GapFlow) -> Array:
        """Return omega over a gap for the state after it, the state before it, and a constant disturbance, together."""
        found = self._gaps.get(flow.gap)
        if found is None:
            if len(self._gaps) >= CACHE_SIZE:
                self._gaps.clear()
            parts = np.concatenate([np.eye(len(flow.F)), flow.F, flow.integral @ self.plant.G], axis=1)
            found = self._gaps[flow.gap] = flow.whiten @ parts
        return found

    def _ball_radius(self) -> float:
        """Least bound on |w|_Qw that a single ball gives."""
        half, best = np.linalg.cholesky(self.weights.w).T, np.inf
        for ball in self.w.balls:
            back = ball.inverse()
            if back is not None:
                gain = float(np.linalg.norm(half @ back, 2))
                best = min(best, float(np.linalg.norm(half @ ball.centre)) + ball.radius * gain)
        return best

    def _outer(self, flows: list[GapFlow]) -> Iterator[ConvexSet]:
        n, boxed = self.plant.n_states, self.w.rows.shape[0] or self.w.bounded.size
        lower, upper = np.full((len(flows), n), -np.inf), np.full((len(flows), n), np.inf)
        if boxed:
            lower, upper = self._support(flows)
        for flow, low, high in zip(flows, lower, upper, strict=True):
            balls: tuple[NormBall, ...] = ()
            if np.isfinite(self._radius):
                length = float(np.sqrt(discounted_length(self.weights.eta, flow.gap)))
                balls = (NormBall(self._radius * length, np.zeros(n), np.eye(n)),)
            yield ConvexSet.known(low, high, np.zeros((0, n)), np.zeros(0), balls)

    def _exact(self, flow: GapFlow) -> ConvexSet:
        """The set of w itself, in the coordinates w = half omega."""
        w, width = self.w, flow.root.shape[1]
        length = float(np.sqrt(discounted_length(self.weights.eta, flow.gap)))
        half = np.linalg.solve(np.linalg.cholesky(self.weights.w), np.eye(width)).T / length
        low, high = np.flatnonzero(np.isfinite(w.lower)), np.flatnonzero(np.isfinite(w.upper))
        rows = np.vstack([w.rows @ half, half[high], -half[low]])
        offsets = np.concatenate([w.offsets, w.upper[high], -w.lower[low]])
        whole = np.full(width, np.inf)
        balls = tuple(NormBall(b.radius, np.asarray(np.linalg.solve(half, b.centre)), b.shape @ half) for b in w.balls)
        return ConvexSet.known(-whole, whole, rows, offsets, balls)

    def _support(self, flows: Sequence[GapFlow]) -> tuple[Array, Array]:
        """Return lower and upper bounds on omega, per flow, over all w in the box.

        Notes
        -----
        *Method.* With phi(s) = L^+ e^{As} G and w = middle + deviation, the middle is exact and the deviation adds at
        most int |phi| half (`_absolute_integrals`). Nor is any entry's deviation more than that of |omega|, which the
        cost bounds: over many fast time constants the cells say less than that.
        """
        gaps, (lower, upper) = np.array([flow.gap for flow in flows]), self._box
        middle, half = (lower + upper) / 2, (upper - lower) / 2
        reach = np.empty((gaps.size, flows[0].F.shape[0]))
        lengths = [self._cell(gap) for gap in gaps.tolist()]
        whiten = np.array([flow.whiten for flow in flows])
        for length in set(lengths):
            at = [k for k, own in enumerate(lengths) if own == length]
            reach[at] = self._absolute_integrals(length, gaps[at], whiten[at] * self.units) @ half
        most = self.weights.disturbance_energy(half) * discounted_length(self.weights.eta, gaps)
        reach = np.minimum(reach, np.sqrt(most)[:, None])
        driven = np.array([flow.integral for flow in flows]) @ (self.plant.G @ middle)
        centre = np.matmul(whiten, driven[:, :, None])[:, :, 0]
        return centre - reach, centre + reach

    def _cell(self, gap: float) -> float:
        """Length of the cells for a gap."""
        longest, shortest = (gap / number for number in CELL_RANGE)
        if self.size == 0:
            return 2.0 ** math.floor(math.log2(longest))
        wanted = max(min(CELL / self.size, longest), shortest)
        return 2.0 ** math.floor(math.log2(wanted * self.size) + 1e-9) / self.size

    def _responses(self, gap: float, length: float) -> tuple[Array, Array]:
        """Return e^{As} G in the middle of cells of a length, (n, K, q), and the norms of its columns, (K, q).

        The cells cover the gap, the last one may end beyond it; all gaps share a grid, made by doubling.
        """
        count = math.ceil(gap / length)
        known = self._grids.get(length)
        if known is None or len(known[1]) < count:
            (half,) = expm_batch(self.A, [length / 2])
            moved, power = (half @ self.G)[:, None, :], half @ half
            while moved.shape[1] < count:
                moved = np.concatenate([moved, np.tensordot(power, moved, 1)], axis=1)
                power = power @ power
            known = self._grids[length] = moved, np.sqrt(np.einsum("ikj,ikj->kj", moved, moved))
        return known[0][:, :count], known[1][:count]

    def _absolute_integrals(self, d: float, gaps: Array, whiten: Array) -> Array:
        """Upper bounds on int |phi| over gaps, (N, n, q), from cells of length d.

        Over a cell with middle m, int |phi| <= d|phi(m)| + d^3/24 sup|phi''|, and d^2/4 |phi'(m)| more where phi may
        change sign; sup|phi''_ki| <= |(L^+ A^2)_k| e^{|A|d/2} |e^{Am} g_i|. Of a cell only what lies within the gap
        counts.
        """
        A, (n, count) = self.A, (whiten.shape[2], gaps.size)
        moved, norms = self._responses(float(gaps.max()), d)
        K, q = norms.shape
        first = whiten @ A
        both = np.concatenate([whiten, first]).reshape(-1, n) @ moved.reshape(n, -1)
        phi, slope = both.reshape(2, count, -1, K, q)
        bend = np.linalg.norm(first @ A, axis=2) * math.exp(self.size * d / 2)
        second = bend[:, :, None, None] * norms
        upto = np.clip(gaps[:, None] - d * np.arange(K), 0.0, d)[:, None, :, None]
        beyond = upto - d / 2  # the cell counted from its middle: from -d/2 to here
        size, rise = np.abs(phi), np.abs(slope)
        turning = size < rise * (d / 2) + second * (d * d / 8)
        moments = (beyond * np.abs(beyond) + d * d / 4) / 2, (d * d / 4 - beyond**2) / 2  # of |s - m|, and of m - s
        parts = upto * size + np.where(turning, *moments) * rise + (beyond**3 + d**3 / 8) / 6 * second
        return np.asarray(parts.sum(axis=2))
