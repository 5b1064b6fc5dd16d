"""Bound of all schedules by windows that begin at each sample, weighed by the gap after it.

Let g_i = s_{i+1} - s_i and r_ij = s_{i+j} - s_i, j = 1 .. mk, where m periods P of k samples hold a window T. In the
window (s_i, s_i + T] any psd Z(g_i) has sigma^2 tr Z(g_i) <= sum_j <Z(g_i), G(r_ij)> over r_ij <= T. For any
function V of distances with V(0) = V(mP) = 0 the differences V(r_ij) - V(r_ij - g_i) add up to nothing over all i and j
of a period, since r_ij - g_i = r_{i+1,j-1}. Hence, where <Z(g), G(r)> <= V(r) - V(r - g) + b(g) for every distance r
that can follow a gap g,

    sum_i (sigma^2 tr Z(g_i) - n(g_i)) <= 0,  n(g) = m(k-2) b(g) + sum of <Z(g), G(r)> - V(r) + V(r - g) over known r,

the known distances being l P and (l-1) P + g, l = 1 .. m; and so sigma^2 <= max n(g) / tr Z(g). Z is linear between
nodes and V between knots, and both inequalities are judged on a grid of gaps and distances: on each triangle of it a
form lies below what is linear between its corners plus what is left of second order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.design.bounds.relaxation import grams_at, psd_part
from sampling_design.design.bounds.tied_windows import growth_rate
from sampling_design.design.bounds.weak_duality import rooted
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.numerics import conic_programs
from sampling_design.numerics.linalg import expm_batch
from sampling_design.records.arrays import Array, Index, Mask

_KNOTS, _LEAST_PARTS, _MOST_PARTS = 96, 4, 24  # of V over a window, about, and in a mean gap at least and at most
_FINE = 800  # steps over a window at which the inequalities are judged, about
_MOST_SAMPLES, _MOST_STATES = 32, 8  # in the periods that hold a window: beyond, the program takes many seconds
_LEAST_SPACING = 1e-8  # of the period: so much longer than whole periods is a window of whole periods
_NODES_ABOVE = 12  # far above the mean gap nodes are that share of a period apart, or a mean gap
_CLOSE, _WIDER = 0.5, 1.5  # of a mean gap beside the mean: nodes on each knot; above, by how much steps grow
_POSED = 3  # mean gaps up to which the program has rows for the gaps between nodes too
_TOLERANCE = 1e-6  # asked of the solver; the bound is true whatever it answers
_SHARE = 0.1  # of the mean multiplier: that of the mean gap at least, so that what falls short of the aim costs little
_LEAST_SHARE = 1e-6  # of the mean multiplier, added to each: no gap is without


@dataclass(frozen=True, eq=False)
class _DistanceGrid:
    """Distances in equal steps, `parts` to a mean gap."""

    problem: DesignProblem
    parts: int

    @cached_property
    def periods(self) -> int:
        """Whole periods that hold a window."""
        return int(np.ceil(self.problem.window / self.problem.period - 1e-9))

    @property
    def per_period(self) -> int:
        """Steps to a period."""
        return self.problem.samples * self.parts

    @property
    def count(self) -> int:
        """Steps to the periods that hold a window."""
        return self.periods * self.per_period

    @property
    def width(self) -> float:
        """Of a step."""
        return self.problem.period / self.per_period

    @property
    def ends(self) -> tuple[int, int]:
        """Steps that no gap is less than, and none more."""
        widest = self.problem.period - (self.problem.samples - 1) * self.problem.spacing
        return int(np.floor(self.problem.spacing / self.width)), int(np.ceil(widest / self.width - 1e-9))

    @property
    def free(self) -> int:
        """Samples of a window that are neither the next one, nor the one it follows, nor these a period later."""
        return self.periods * (self.problem.samples - 2)

    @property
    def in_window(self) -> Mask:
        """Steps that begin within a window: a sample in the last of them counts to its end."""
        return np.asarray(np.arange(self.count) * self.width < self.problem.window * (1 - 1e-12))

    @property
    def known(self) -> list[tuple[int, int, bool]]:
        """Each period's first and last step, and whether the sample that a window follows is in it again by then."""
        later = np.arange(1, self.periods + 1) * self.problem.period <= self.problem.window * (1 + 1e-9)
        return [(m * self.per_period, (m + 1) * self.per_period, bool(again)) for m, again in enumerate(later)]

    def follow(self, gaps: Index) -> Mask:
        """(gaps, count): steps in which free samples may lie after one of `gaps`, or one a step beside it."""
        apart, place = self.problem.spacing / self.width, np.mod(np.arange(self.count), self.per_period)
        return np.asarray((place + 2 >= gaps[:, None] + apart) & (place <= self.per_period - apart + 1))


def _grid(problem: DesignProblem) -> _DistanceGrid | None:
    """The grid of V; None where gaps do not say all of a schedule, or there are too few or too many."""
    held = problem.samples * _DistanceGrid(problem, 1).periods
    alike = problem.is_shift_invariant and not problem.is_costly and problem.samples > 1
    if not alike or held > _MOST_SAMPLES or problem.spacing <= _LEAST_SPACING * problem.period:
        return None
    return _DistanceGrid(problem, int(np.clip(round(_KNOTS / held), _LEAST_PARTS, _MOST_PARTS)))


def _nodes(grid: _DistanceGrid) -> Index:
    """Gaps, in steps, at which Z is given: close about the mean gap, from the least to the widest."""
    (low, high), close = grid.ends, int(grid.parts * _CLOSE)
    near = np.arange(grid.parts - close, grid.parts + close + 1)
    above, step = [int(near[-1])], 1.0
    while above[-1] < high:
        step = min(step * _WIDER, max(grid.parts, grid.per_period // _NODES_ABOVE))
        above.append(min(above[-1] + int(step), high))
    found = np.unique(np.concatenate([np.arange(low, near[0], 2), near, above]))
    return np.asarray(found[(found >= low) & (found <= high)])


def _between(nodes: Index, gaps: Index) -> Array:
    """(gaps, nodes): weights of the nodes at the gaps between them."""
    return np.stack([np.interp(gaps, nodes, row) for row in np.eye(nodes.size)], axis=1)


def _rows(grid: _DistanceGrid, Z: Array) -> Array:
    """Rows y, yA, yAA, yAAA (4, count, 2, p, n) at both ends of each step.

    Early and late samples go where Z sees least of them in the middle of the step.
    """
    problem = grid.problem
    flow = expm_batch(problem.rows.A, np.arange(2 * grid.count + 1) * (grid.width / 2))
    C = problem.rows.C @ problem.moves
    middle = C[:, None] @ flow[1::2]
    which = np.argmin(np.einsum("mcpi,ij,mcpj->mc", middle, Z, middle), axis=0)
    found = [C[which][:, None] @ np.stack([flow[:-1:2], flow[2::2]], axis=1)]
    for _ in range(3):
        found.append(found[-1] @ problem.rows.A)
    return np.array(found)


def _gram(y: Array, z: Array) -> Array:
    """(y'z + z'y)/2 of rows (..., p, n)."""
    found = np.swapaxes(y, -1, -2) @ z
    return np.asarray((found + np.swapaxes(found, -1, -2)) / 2)


def relax_gaps(problem: DesignProblem, sigma: float, seconds: float | None = None) -> tuple[Array, Array, Array] | None:
    """Multipliers that prove a sigma near the one that is aimed at, if any do.

    Gaps, psd Z (N, n, n) at them in the scaled basis, linear between them, and V at the ends of equal parts. None
    where gaps do not say all of a schedule, states are many or grow, the aim is 0, or nothing is found.
    """
    grid = _grid(problem)
    if grid is None or problem.plant.n_states > _MOST_STATES or growth_rate(problem) > 0 or not sigma > 0:
        return None
    program = _DualProgram(grid, _nodes(grid), sigma**2 * problem.rows.unit)
    found = conic_programs.solve_cone_program(*program.posed(), tolerance=_TOLERANCE, budget=seconds, refined=False)
    Z, V = program.taken_from(np.nan_to_num(found.x))
    if not float(np.trace(Z, axis1=1, axis2=2).sum()) > 0:
        return None
    return np.asarray(program.nodes * grid.width, dtype=np.float64), Z + _LEAST_SHARE * Z.mean(axis=0), V


@dataclass(frozen=True, eq=False)
class _DualProgram:
    """The inequalities at the knots: unknown are Z at the nodes, V at the knots, b at the gaps, and what is missed.

    Least e with aim tr Z(g) + e share(g) >= n(g) and aim tr Z(g) >= share(g), so that n(g) <= (1 + e) aim tr Z(g).
    """

    grid: _DistanceGrid
    nodes: Index
    aim: float

    @cached_property
    def gaps(self) -> Index:
        """Gaps with rows of their own."""
        (low, high), middle = self.grid.ends, (self.nodes[1:] + self.nodes[:-1]) // 2
        close = np.arange(low, min(high, _POSED * self.grid.parts) + 1)
        return np.unique(np.concatenate([self.nodes, close, middle]))

    @cached_property
    def entries(self) -> int:
        """Of one Z."""
        n = self.grid.problem.plant.n_states
        return n * (n + 1) // 2

    @property
    def columns(self) -> tuple[int, int, int]:
        """Where V, b and e begin."""
        start = self.nodes.size * self.entries
        return start, start + self.grid.count, start + self.grid.count + self.gaps.size

    def potential(self, at: Index) -> Array:
        """Rows of V at the knots `at`: 0 at the first and the last, and before."""
        found = np.zeros((at.size, self.columns[-1] + 1))
        inner = np.flatnonzero((at > 0) & (at < self.grid.count))
        found[inner, self.columns[0] + at[inner]] = 1.0
        return found

    def form(self, weights: Array, forms: Array) -> Array:
        """Rows of <Z(g), F> for weights of the nodes (m, nodes) and forms F (m, entries)."""
        found = np.zeros((len(weights), self.columns[-1] + 1))
        found[:, : self.columns[0]] = (weights[:, :, None] * forms[:, None, :]).reshape(len(weights), self.columns[0])
        return found

    def posed(self) -> tuple[Array, list[tuple[str, Array, Array]]]:
        """Cost and cones."""
        grid, gaps, d, problem = self.grid, self.gaps, self.entries, self.grid.problem
        weights = _between(self.nodes, gaps)
        y = _rows(grid, _least_observable(problem))[0]
        G = conic_programs.svec(_gram(y, y)) * grid.in_window[:, None, None]
        _, begin_b, missed = self.columns
        pairs = []
        apart = np.append(np.any(G[:-1, 1] != G[1:, 0], axis=1), True)  # moved or held unlike what follows
        for side, told in ((0, np.ones(grid.count, dtype=bool)), (1, apart)):
            a, j = np.nonzero(grid.follow(gaps) & told)
            rows = self.form(weights[a], G[j, side]) - self.potential(j + side) + self.potential(j + side - gaps[a])
            rows[np.arange(a.size), begin_b + a] = -1.0
            pairs.append(rows)
        share = _SHARE * np.minimum(gaps / grid.parts, 1.0) ** 2
        unit = self.aim * conic_programs.svec(problem.rows.N)
        least = -self.form(weights, np.tile(unit, (gaps.size, 1)))
        sums = least.copy()
        sums[np.arange(gaps.size), begin_b + np.arange(gaps.size)] = grid.free
        sums[:, missed] = -share
        for begin, end, again in grid.known:
            sums += self.form(weights, np.tile(again * G[end - 1, 1], (gaps.size, 1)))
            sums += self.potential(end - gaps) - self.potential(np.full(gaps.size, end))
            sums += self.form(weights, G[np.maximum(begin + gaps - 1, 0), 1])
            sums += self.potential(np.full(gaps.size, begin)) - self.potential(begin + gaps)
        below = np.vstack([*pairs, sums, least])
        limits = np.append(np.zeros(len(below) - gaps.size), -share)
        total = self.form(np.ones((1, self.nodes.size)), unit[None])
        blocks = [("zero", total, np.array([float(self.nodes.size)])), ("nonnegative", below, limits)]
        for m in range(self.nodes.size):
            chosen = np.zeros((d, missed + 1))
            chosen[:, m * d : (m + 1) * d] = -np.eye(d)
            blocks.append(("psd", chosen, np.zeros(d)))
        return np.eye(missed + 1)[missed], blocks

    def taken_from(self, x: Array) -> tuple[Array, Array]:
        """Psd Z at the nodes, and V at the knots after the first."""
        start, end, _ = self.columns
        Z = psd_part(conic_programs.smat(x[:start].reshape(-1, self.entries)))
        return Z, np.append(x[start + 1 : end], 0.0)


def _least_observable(problem: DesignProblem) -> Array:
    """Dyad of the state that is seen least of even spacing, just after a sample."""
    times = np.arange(problem.samples, dtype=np.float64) * (problem.period / problem.samples)
    z = problem.rows.least(grams_at(problem, times, times[:1], problem.mask(times)).sum(axis=1))[1][0]
    return np.outer(z, z)


def gap_bound(problem: DesignProblem, gaps: Array, Z: Array, potential: Array, traces: Array) -> float:
    """Bound sigma of every schedule by multipliers whose `traces` (N,) in the plant's coordinates are those."""
    posed, size = _grid(problem), potential.size
    parts = 0 if posed is None else size // (problem.samples * posed.periods)
    known = 0 < parts <= _MOST_PARTS and gaps.size > 1  # a file's own grid may be too fine to be judged
    if not known or np.any(traces <= problem.rows.rounding):
        return np.inf
    coarse = _DistanceGrid(problem, parts)
    nodes = np.rint(gaps / coarse.width)
    on = np.all(np.abs(gaps / coarse.width - nodes) <= 1e-9 * size) and np.all(np.diff(nodes) > 0)
    low, high = coarse.ends
    if not on or size != coarse.count or not 0 <= nodes[0] <= low or not high <= nodes[-1] <= size:
        return np.inf
    times = max(1, round(_FINE / size))
    grid = _DistanceGrid(problem, parts * times)
    at = np.arange(max(grid.ends[0], int(nodes[0]) * times), min(grid.ends[1], int(nodes[-1]) * times) + 1)
    weights = _between(nodes.astype(np.intp) * times, at)
    V = np.interp(np.arange(grid.count + 1), np.arange(size + 1) * times, [0.0, *potential[:-1], 0.0])
    with np.errstate(over="ignore", invalid="ignore"):
        values, rest = _forms(grid, weights, Z)
        top = _most(grid, at, values, rest, V)
        added = problem.rows.rounding * (grid.free + 2 * grid.periods) * (values.max() + 4 * np.abs(V).max())
        return rooted(problem, float(np.max((top + added) / (weights @ (traces - problem.rows.rounding)))))


def _forms(grid: _DistanceGrid, weights: Array, Z: Array) -> tuple[Array, Array]:
    """<Z(g), G(r)> (gaps, count, 2) at both ends of each step of r, and (gaps, count) what is left beside each.

    Between gaps and ends F = <Z(g), G(r)> is above what is linear by at most h^2/8 (-F_rr + 2 |F_gr|), h the step.
    """
    n, asked = grid.problem.plant.n_states, len(weights)
    weights = weights if asked > 1 else np.repeat(weights, 2, axis=0)  # one gap alone: nothing lies between gaps
    flat = Z.reshape(-1, n * n)
    y = _rows(grid, np.tensordot(weights.mean(axis=0), Z, axes=1))
    size = np.linalg.norm(y, axis=(3, 4)).max(axis=2)
    growth = 2 * np.exp(2 * float(np.linalg.norm(grid.problem.rows.A, 2)) * grid.width)
    second, third = growth * (size[0] * size[2] + size[1] ** 2), growth * (size[0] * size[3] + 3 * size[1] * size[2])

    def along(forms: Array, shares: Array) -> Array:
        return shares @ (flat @ forms.reshape(-1, n * n).T)

    values = np.stack([along(_gram(y[0], y[0])[:, side], weights) for side in (0, 1)], axis=2)
    change = np.diff(weights, axis=0) / grid.width
    nuclear = np.linalg.svd((change @ flat).reshape(-1, n, n), compute_uv=False).sum(axis=1)
    slope, bend = 2 * _gram(y[0], y[1]), 2 * (_gram(y[1], y[1]) + _gram(y[0], y[2]))
    cross = np.max([np.abs(along(slope[:, side], change)) for side in (0, 1)], axis=0)
    cross += nuclear[:, None] * (second * grid.width / 2)
    sunk = np.max([-along(bend[:, side], weights) for side in (0, 1)], axis=0)
    trace = weights @ np.trace(Z, axis1=1, axis2=2)
    sunk = np.maximum(sunk, 0.0) + trace[:, None] * (third * grid.width / 2)
    rest = (np.maximum(sunk[1:], sunk[:-1]) + 2 * cross) * (grid.width**2 / 8) * grid.in_window
    beside = np.maximum(np.concatenate([rest[:1], rest]), np.concatenate([rest, rest[-1:]]))
    return values[:asked] * grid.in_window[:, None], beside[:asked]


def _most(grid: _DistanceGrid, at: Index, values: Array, rest: Array, V: Array) -> Array:
    """n(g) at the gaps `at`; between them it lies below what is linear."""
    ends = np.stack([np.arange(grid.count), np.arange(1, grid.count + 1)], axis=1)
    before = V[np.maximum(ends - at[:, None, None], 0)]  # V is 0 below 0
    over = (values - V[ends] + before).max(axis=2) + rest
    b = np.max(np.where(grid.follow(at), over, -np.inf), axis=1) if grid.free else np.zeros(at.size)
    top, place = grid.free * b, np.arange(at.size)
    for begin, end, again in grid.known:
        top = top + again * values[:, end - 1, 1] - V[end] + V[end - at]
        low, high = np.maximum(begin + at - 1, 0), np.minimum(begin + at, grid.count - 1)
        seen = np.maximum(values[place, low, 1], values[place, high, 0])
        top = top + seen + np.maximum(rest[place, low], rest[place, high]) - V[begin + at] + V[begin]
    return np.asarray(top)
