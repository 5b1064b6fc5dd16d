"""The semidefinite program for P(tau) at its nodes: flow at both ends of every piece and every member, jump, bounds.

Coordinates z = L'x with L L' = W, W the information that the nominal plant keeps, and times in units of the longest
gap: numbers about 1, whatever the units of the plant.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from sampling_design.numerics import conic_programs
from sampling_design.records.arrays import Array, Index
from sampling_design.records.record import SolverRecord

Block = tuple[str, tuple[Index, Index, Array], Array]
"""Cone, rows and columns and values of -A x, right-hand side: one matrix is made of all of them at once."""

MARGIN = 1e-5
"""Of flow and jump, relative to P: solvers miss their inequalities by some 1e-8, and P is rounded afterwards."""
BEARABLE, PACE = 1e3, 4.0
"""Rates per longest gap beyond which flow conditions are posed in their own size; the rate that counts as 1 there."""
LEAST_SLACKEST, MOST_SLACKEST = 0.01, 4.0  # ends of P for the largest slack: the lower one is that part of the slack
LEAST_BOUND = 0.05
"""Of the matrix that P is drawn to: it stays within a factor of twenty of what it is in the coordinates of the turn."""
MEMBERS = 512  # members whose eigenvalues are found at once
SMALLEST = 1e-7  # information below this fraction of the nominal counts as none: the solver's tolerance, with room


@dataclass(frozen=True, eq=False)
class InclusionData:
    """The numbers of one program, in inner coordinates and inner time.

    dynamics (K, n, n + q); outputs (patterns, L, p, n), for each pattern of measured outputs in units in which R~ is I
    and rows of what is not measured are 0; Qw; `unit` what the states' scales call one, up to a
    factor; the layout's nodes, in units of the longest gap; `later`, `base` and `pattern` of each jump.
    """

    dynamics: Array
    outputs: Array
    Qw: Array
    unit: Array
    eta: float
    nodes: Array
    pieces: Index
    later: Index
    base: Index
    pattern: Index
    margin: float = MARGIN
    columns: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(n, m): what uncertain columns add, for multipliers; the dynamics are then those of the middle alone."""
    multiplied: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(m, n + q): the combination of (x, w) that each of them multiplies."""

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.unit)

    def slopes(self, P: Array) -> tuple[Array, Array]:
        """P at both ends of each piece, and its slope there."""
        i, j = self.pieces, self.pieces + 1
        slope = (P[j] - P[i]) / (self.nodes[j] - self.nodes[i])[:, None, None]
        return np.stack([P[i], P[j]], axis=1).reshape(-1, self.n, self.n), np.repeat(slope, 2, axis=0)

    def turned(self, T: Array) -> InclusionData:
        """The same program in coordinates T'z, T (n, n): P = T P_new T'."""
        inverse = np.linalg.inv(T)
        n, q = self.n, self.dynamics.shape[2] - self.n
        A, G = self.dynamics[:, :, :n], self.dynamics[:, :, n:]
        dynamics = np.concatenate([T.T @ A @ inverse.T, T.T @ G], axis=2) if q else T.T @ A @ inverse.T
        unit = inverse @ self.unit @ inverse.T
        multiplied = (
            np.hstack([self.multiplied[:, :n] @ inverse.T, self.multiplied[:, n:]])
            if len(self.multiplied)
            else self.multiplied
        )
        return replace(
            self,
            columns=T.T @ self.columns if len(self.multiplied) else self.columns,
            multiplied=multiplied,
            dynamics=dynamics,
            outputs=self.outputs @ inverse.T,
            unit=(unit + unit.T) / 2,
        )


@dataclass(frozen=True, eq=False)
class InclusionSolution:
    """A solution in inner coordinates, not proven: P at the nodes between s I and q I; T brings it to physical ones."""

    posed: InclusionData
    P: Array
    T: Array
    diagonals: Array | None
    gains: Array
    record: SolverRecord

    @cached_property
    def ends(self) -> tuple[float, float]:
        """s and q, the least and the largest eigenvalue over all nodes."""
        values = np.linalg.eigvalsh(self.P)
        return float(values[:, 0].min()), float(values[:, -1].max())

    @property
    def lam(self) -> float:
        """q/s."""
        low, high = self.ends
        return high / low


def in_coordinates(P: Array, root: Array) -> Array:
    """P (N, n, n) in the coordinates in which root root' is I."""
    own = np.linalg.solve(root, np.linalg.solve(root, P).swapaxes(1, 2))
    return np.asarray((own + own.swapaxes(1, 2)) / 2)


def worst_violated(least: Array, chosen: list[int], most: int) -> list[int]:
    """Those of the least slack, at most so many, that are violated and not chosen yet."""
    return [int(k) for k in np.argsort(least)[:most] if least[k] < 0 and int(k) not in chosen]


def flow_scale(posed: InclusionData) -> Array:
    """N^-1/2, N = I + |A + A'|/(2 pace) where rates are fast, in all coordinates that flow conditions have; else I.

    A congruence with it changes no definiteness. Rates up to `BEARABLE` per longest gap are left as they are.
    """
    n, full = posed.n, np.eye(posed.dynamics.shape[2] + len(posed.multiplied))
    A = posed.dynamics[:, :, :n].mean(axis=0)
    values, vectors = np.linalg.eigh((A + A.T) / 2)
    if np.max(np.abs(values), initial=0.0) > BEARABLE:
        full[:n, :n] = vectors @ np.diag(1 / np.sqrt(1 + np.abs(values) / PACE)) @ vectors.T
    return full


class InclusionProgram:
    """The blocks of a program that do not depend on what is minimised."""

    def __init__(self, posed: InclusionData, budget: float | None = None) -> None:
        self.posed, self.budget = posed, budget
        n = posed.n
        self.pairs = n * (n + 1) // 2
        self.basis = np.asarray(conic_programs.smat(np.eye(self.pairs)), dtype=np.float64)
        self.count = posed.nodes.size
        self.ends = 2 * posed.pieces.size
        self.gains_at = self.count * self.pairs + self.ends * len(posed.multiplied)
        self.open = posed.outputs.shape[1] > 1
        self.rows = posed.outputs.shape[2]
        self.width = (
            self.gains_at + self.open * posed.later.size * self.rows * n + 1
        )  # the last one is what is maximised
        self.scale = flow_scale(posed)
        order = n + posed.Qw.shape[0] + len(posed.multiplied)
        flows = [order * (order + 1) // 2] * (self.ends * len(posed.dynamics))
        self.refused = conic_programs.too_large(flows, budget)  # before it is posed, which takes as long
        self.fixed = [] if self.refused else [*self._flow(), *self._jump()]

    def _block(self, parts: list[tuple[int, Array]], right: Array) -> Block:
        """right - (-parts) x in the cone: columns start at the given places."""
        row, column, data = [], [], []
        for start, values in parts:
            i, j = np.nonzero(values)
            row.append(i)
            column.append(j + start)
            data.append(-values[i, j])
        return "psd", (np.concatenate(row), np.concatenate(column), np.concatenate(data)), right

    def _padded(self, corner: Array, side: Array | None = None) -> Array:
        """svec of [corner, side; side', 0] for each of a stack, as columns."""
        n, m = self.posed.n, self.posed.dynamics.shape[2] + len(self.posed.multiplied)
        full = np.zeros((len(corner), m, m))
        full[:, :n, :n] = corner
        if side is not None:
            full[:, :n, n : n + side.shape[2]] = side
            full[:, n : n + side.shape[2], :n] = np.swapaxes(side, 1, 2)
        return np.asarray(conic_programs.svec(self.scale.T @ full @ self.scale).T)

    def _flow(self) -> list[Block]:
        p, n = self.posed, self.posed.n
        q, m = p.dynamics.shape[2] - n, len(p.multiplied)
        right = np.zeros((n + q + m, n + q + m))
        right[:n, :n] = -p.margin * np.eye(n)
        right[n : n + q, n : n + q] = (1 - p.margin) * p.Qw
        floor = vector(right)
        still, found = self._padded(self.basis), []
        for M in p.dynamics:
            A, G = M[:, :n], M[:, n:]
            drift = self.basis @ A
            side = np.concatenate(
                [-(self.basis @ G), -(self.basis @ p.columns) if m else np.zeros((self.pairs, n, 0))], 2
            )
            along = self._padded(-(drift + np.swapaxes(drift, 1, 2) + p.eta * self.basis), side)
            for k, i in enumerate(p.pieces.tolist()):
                a, b, h = i * self.pairs, (i + 1) * self.pairs, float(p.nodes[i + 1] - p.nodes[i])
                found.append(self._block([(a, along + still / h), (b, -still / h), *self._own(2 * k)], floor))
                found.append(self._block([(b, along - still / h), (a, still / h), *self._own(2 * k + 1)], floor))
        return found

    def _own(self, end: int) -> list[tuple[int, Array]]:
        """What the multipliers of one end add: p_k^2 - z_k^2."""
        p, m = self.posed, len(self.posed.multiplied)
        if not m:
            return []
        size = p.dynamics.shape[2]
        full = np.zeros((m, size + m, size + m))
        full[:, :size, :size] = -p.multiplied[:, :, None] * p.multiplied[:, None, :]
        for k in range(m):
            full[k, size + k, size + k] = 1.0
        scaled = self.scale.T @ full @ self.scale
        return [(self.count * self.pairs + end * m, np.asarray(conic_programs.svec(scaled).T))]

    def _jump(self) -> list[Block]:
        """D + C'C > 0, D what P gains; for several C [D + C'K + K'C, K'; K, I] > 0 with one K, whose Schur complement
        D + C'C - (K - C)'(K - C) is below D + C'C for each of them, and linear in C, so that it holds for their hull.
        """
        p, n, found = self.posed, self.posed.n, []
        one = np.eye(self.pairs)
        for k, (later, base, pattern) in enumerate(zip(p.later, p.base, p.pattern, strict=True)):
            parts = [(int(later) * self.pairs, one), (int(base) * self.pairs, -one)]
            if not self.open:
                C = p.outputs[pattern, 0]
                found.append(self._block(parts, vector((1 - p.margin) * C.T @ C - p.margin * np.eye(n))))
                continue
            floor = np.zeros((n + self.rows, n + self.rows))
            floor[:n, :n] = -p.margin * np.eye(n)
            floor[n:, n:] = (1 - p.margin) * np.eye(self.rows)
            wide = [(at, self._wider(values)) for at, values in ((parts[0][0], self.basis), (parts[1][0], -self.basis))]
            for C in p.outputs[pattern]:
                found.append(self._block([*wide, (self.gains_at + k * self.rows * n, self._gain(C))], vector(floor)))
        return found

    def _wider(self, stack: Array) -> Array:
        """svec of [X, 0; 0, 0] for each of a stack, as columns."""
        full = np.zeros((len(stack), self.posed.n + self.rows, self.posed.n + self.rows))
        full[:, : self.posed.n, : self.posed.n] = stack
        return np.asarray(conic_programs.svec(full).T)

    def _gain(self, C: Array) -> Array:
        """svec of [C'K + K'C, K'; K, 0] for each entry of K, as columns."""
        n, rows = self.posed.n, self.rows
        full = np.zeros((rows * n, n + rows, n + rows))
        for k in range(rows * n):
            i, j = divmod(k, n)
            full[k, :n, j] += C[i]
            full[k, j, :n] += C[i]
            full[k, n + i, j] = full[k, j, n + i] = 1.0
        return np.asarray(conic_programs.svec(full).T)

    def gains(self, x: Array) -> Array:
        """K of each jump, (jumps, p, n)."""
        if not self.open:
            return np.asarray(self.posed.outputs[self.posed.pattern, 0])
        shape = self.posed.later.size, self.rows, self.posed.n
        return np.asarray(x[self.gains_at : self.gains_at + int(np.prod(shape))].reshape(shape))

    def _solved(self, cost: Array, blocks: list[Block], fixed: list[Block]) -> tuple[Array | None, SolverRecord]:
        m, every = np.arange(len(self.posed.multiplied) * self.ends), [*fixed, *blocks]
        if m.size:
            every.append(("nonnegative", (m, self.count * self.pairs + m, -np.ones(m.size)), np.zeros(m.size)))
        sizes = [right.size for _, _, right in every]
        row, column, data = (np.concatenate(part) for part in zip(*(entries for _, entries, _ in every), strict=True))
        row = row + np.repeat(np.cumsum([0, *sizes[:-1]]), [entries[0].size for _, entries, _ in every])
        psd = (size for (kind, _, _), size in zip(every, sizes, strict=True) if kind == "psd")
        if refused := self.refused or conic_programs.too_large(psd, self.budget):
            return None, refused
        A = sparse.csc_matrix((data, (row, column)), shape=(sum(sizes), len(cost)))
        cones = [(kind, right) for kind, _, right in every]
        found = conic_programs.solve_cone_program_of(cost, A, cones, budget=self.budget)
        point = np.asarray(found.x, dtype=np.float64)
        return (point if conic_programs.usable(found.record) else None), found.record

    def matrices(self, x: Array) -> Array:
        """P at the nodes."""
        return np.asarray(
            conic_programs.smat(x[: self.count * self.pairs].reshape(self.count, self.pairs)), dtype=np.float64
        )

    def diagonals(self, x: Array) -> Array:
        """Multipliers per piece and end."""
        m = len(self.posed.multiplied)
        start = self.count * self.pairs
        return np.maximum(x[start : start + self.ends * m], 0.0).reshape(self.ends // 2, 2, m)

    def floor(self) -> tuple[float, Array | None, SolverRecord]:
        """The largest p with P >= p unit, and the solver's point; 0 and None where there is none."""
        cost = np.zeros(self.width)
        cost[-1] = -1.0
        cap = ("nonnegative", (np.array([0]), np.array([self.width - 1]), np.ones(1)), np.array([1e6]))
        one, unit = np.eye(self.pairs), vector(self.posed.unit)
        above = [
            self._block([(i * self.pairs, one), (self.width - 1, -unit[:, None])], 0 * unit) for i in range(self.count)
        ]
        x, record = self._solved(cost, [*above, cap], self.fixed)
        if x is None or x[-1] < SMALLEST:
            return 0.0, None, record
        return float(x[-1]), x, record

    def narrow(self, ratio: float, floor: float) -> tuple[Array | None, Array, SolverRecord]:
        """The point with the most t for which a W has W <= P <= ratio W - t I and W >= floor unit: x if t > 0, and W.

        Linear in P and W at once: turns of it, each with the ratio of the last, end at the least that any W has.
        """
        one, shape, unit = np.eye(self.pairs), vector(np.eye(self.posed.n)), vector(self.posed.unit)
        t, W, more = self.width - 1, self.width, self.pairs
        cost = np.zeros(self.width + more)
        cost[t] = -1.0
        blocks = [self._block([(W, one)], -floor * unit)]
        for i in range(self.count):
            at = i * self.pairs
            blocks.append(self._block([(at, one), (W, -one)], 0 * shape))
            blocks.append(self._block([(W, ratio * one), (at, -one), (t, -shape[:, None])], 0 * shape))
        x, record = self._solved(cost, blocks, self.fixed)
        if x is None:
            return None, np.eye(self.posed.n), record
        drawn = np.asarray(conic_programs.smat(x[W:]), dtype=np.float64)
        good = x[t] > 0 and np.linalg.eigvalsh(drawn)[0] > SMALLEST * floor
        return (x if good else None), drawn, record

    def slackest(self) -> tuple[Array | None, float, SolverRecord]:
        """The most t with every flow condition >= t I in its own size and t I/100 <= P <= 4 I; the point and t."""
        shape = vector(np.eye(self.posed.n))
        blocks = []
        for i in range(self.count):
            at, one = i * self.pairs, np.eye(self.pairs)
            blocks.append(self._block([(at, -one)], MOST_SLACKEST * shape))
            blocks.append(self._block([(at, one), (self.width - 1, -LEAST_SLACKEST * shape[:, None])], 0 * shape))
        return self._with_slack(blocks)

    def within(self, ratio: float) -> tuple[Array | None, float, SolverRecord]:
        """The same with a matrix W chosen too: W <= P <= ratio W and I/20 <= W <= I; W stands behind the point."""
        one, shape, W, more = np.eye(self.pairs), vector(np.eye(self.posed.n)), self.width, self.pairs
        blocks = [self._block([(W, -one)], shape), self._block([(W, one)], -LEAST_BOUND * shape)]
        for i in range(self.count):
            at = i * self.pairs
            blocks.append(self._block([(at, -one), (W, ratio * one)], 0 * shape))
            blocks.append(self._block([(at, one), (W, -one)], 0 * shape))
        return self._with_slack(blocks, more)

    def bound(self, x: Array) -> Array | None:
        """The W of a point that has one."""
        return np.asarray(conic_programs.smat(x[self.width :]), dtype=np.float64) if len(x) > self.width else None

    def _with_slack(self, blocks: list[Block], more: int = 0) -> tuple[Array | None, float, SolverRecord]:
        """The largest slack, which is taken from all flow conditions."""
        n, size = self.posed.n, self.posed.dynamics.shape[2]
        one = np.zeros((size, size))
        one[:n, :n] = np.eye(n)
        flows, at = len(self.posed.dynamics) * self.ends, self.width - 1
        own = self._block([(at, -vector(one)[:, None])], np.zeros(0))[1]
        taken = []
        for kind, entries, right in self.fixed[:flows]:
            row, column, data = (np.concatenate(part) for part in zip(entries, own, strict=True))
            taken.append((kind, (row, column, data), right))
        cost = np.zeros(self.width + more)
        cost[at] = -1.0
        x, record = self._solved(cost, blocks, [*taken, *self.fixed[flows:]])
        if x is None or x[at] <= SMALLEST:
            return None, 0.0, record
        return x, float(x[at]), record


def vector(matrix: Array) -> Array:
    """svec of one matrix."""
    return np.asarray(conic_programs.svec(matrix), dtype=np.float64)


def flow_slacks(posed: InclusionData, P: Array) -> Array:
    """The least eigenvalue of the flow condition in its own size over both ends of all pieces, for each member."""
    n, ends = posed.n, 2 * posed.pieces.size
    scale = flow_scale(posed)
    both, slope = posed.slopes(P)
    least = []
    for first in range(0, len(posed.dynamics), MEMBERS):
        M = posed.dynamics[first : first + MEMBERS, None]
        drift, off = both @ M[..., :n], -(both @ M[..., n:])
        corner = -(slope + drift + np.swapaxes(drift, 2, 3) + posed.eta * both)
        Q = np.broadcast_to(posed.Qw, (len(M), ends, *posed.Qw.shape))
        form = np.concatenate([np.concatenate([corner, off], 3), np.concatenate([np.swapaxes(off, 2, 3), Q], 3)], 2)
        least.append(np.linalg.eigvalsh(scale.T @ form @ scale)[..., 0].min(axis=1))
    return np.concatenate(least)


def jump_slacks(posed: InclusionData, P: Array, gains: Array) -> Array:
    """The least eigenvalue of the jump condition over all jumps with their gains, for each C."""
    gained = P[posed.later] - P[posed.base] - np.swapaxes(gains, 1, 2) @ gains
    cross = np.swapaxes(posed.outputs[posed.pattern], 2, 3) @ gains[:, None]
    forms = gained[:, None] + cross + np.swapaxes(cross, 2, 3)
    return np.asarray(np.linalg.eigvalsh(forms)[..., 0].min(axis=0))
