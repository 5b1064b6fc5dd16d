"""The family certificate as a semidefinite program on a grid of gaps.

    Phi_h(P) >= Z   <=>   [[P - F'ZF, -F'ZL], [., I - L'ZL]] >= 0,   W_h = LL'

Edges are asked with Z = (1 + margin) P_v - C'R~C, nodes with Z = (1 + margin) P2/lam. A solver's point is only a
proposal: `family_proof` closes the continuum between the grid points, or names the gap that the grid must gain.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from typing import TypeAlias

import numpy as np
from scipy import sparse

from sampling_design.certificates.families.graphs import PathCompleteGraph
from sampling_design.certificates.families.step_proof import StepDynamics
from sampling_design.numerics import conic_programs
from sampling_design.numerics.linalg import psd_root
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.records.record import SolverRecord

ConeRows = tuple[str, Array | sparse.csc_matrix, Array]

MARGIN = 2e-4  # relative margin of every inequality on the grid at first; room for the proof between the grid points
WIDER, WIDEST = 10.0, 0.05
"""Factor on the margin where that room was too small for the proof's steps, and the largest margin that is tried."""
POINTS_PER_RADIAN, POINTS_PER_RADIAN_GIVEN = 3.0, 1.0
"""Grid points per unit of |A + eta/2| h (spectral radius) at first, two at least; the proof adds those that it missed.
Where P2 is given, one program is solved and not a bisection of them: few do (thrice as many: thrice the memory)."""
MOST_POINTS = 41
COARSE_TOLERANCE = 1e-6
"""Tolerance of a second attempt where the solver failed; far below MARGIN."""
LEAST_TIME = 0.05  # seconds that a solver is given where the budget has passed
ASIDE, LEAST_PART = 0.4, 0.05
"""How far beside the root of the slack a lambda is tried, in widths at the end, and the least part of an interval that
a trial takes away: some six programs where halvings take nine."""
MOST_KEPT = 1e3
"""Information beyond so many times the nominal schedule's is not looked for: of what decays and nothing drives there is
no most."""
LEAST_SLACK = 1e-9  # a point counts only if the solver reached at least this slack; the tolerance asked of it
SPARSE = 20_000
"""Numbers in the rows of an edge or node from which on zeros are left out: a long schedule's took gigabytes."""


ProgramSolution: TypeAlias = tuple[float, Array | None, SolverRecord]
"""The largest value that was found, its matrices (None: none), and how the solver ended."""


@dataclass(eq=False)
class FamilyProgram:
    """The inequalities of one graph on a grid that grows; `P2` None means that it is a variable."""

    dynamics: StepDynamics
    graph: PathCompleteGraph
    unit: Array
    P2: Array | None = None
    budget: Budget = ENDLESS
    margin: float = MARGIN
    edge_times: list[list[float]] = field(default_factory=list)
    node_times: list[list[float]] = field(default_factory=list)
    _cache: dict[object, tuple[Array, Array, Array]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        few = self.P2 is not None
        self.edge_times = [_grid(self.dynamics, e.low, e.high, few) for e in self.graph.edges]
        self.node_times = [_grid(self.dynamics, 0.0, top, few) for top in self.graph.tops.tolist()]
        self.pairs = self.dynamics.size * (self.dynamics.size + 1) // 2
        self.basis = conic_programs.smat(np.eye(self.pairs))

    def _flow(self, h: float) -> tuple[Array, Array, Array]:
        """Operators of one gap on svec: P -> J P J', Z -> E'ZE, and E = [F L] itself."""
        if h not in self._cache:
            n = self.dynamics.size
            F, W = self.dynamics.flow([h])
            L = psd_root(W[0])
            E = np.hstack([F[0], L])
            J = np.vstack([np.eye(n), np.zeros((L.shape[1], n))])
            lift = conic_programs.svec(J @ self.basis @ J.T).T
            self._cache[h] = lift, conic_programs.svec(E.T @ self.basis @ E).T, E
        return self._cache[h]

    @property
    def _width(self) -> int:
        """Variables: the matrices of nodes, P2 last where it is one, and a number."""
        return (self.graph.count - 1 + (self.P2 is None)) * self.pairs + 1

    def _place(self, node: int) -> slice:
        """Where the variables of a node's matrix lie."""
        k = (node or self.graph.count) - 1
        return slice(k * self.pairs, (k + 1) * self.pairs)

    def floor(self) -> ProgramSolution:
        """Return the largest p such that Pi >= p unit is certified from P2 = infinity on the grid, the P_v (P[0] nan).

        p <= 0 or None: not even this exists.
        """
        given, self.P2 = self.P2, np.zeros((0, 0))  # the start's matrix is infinite: no variable
        try:
            blocks = chain(
                (self._edge(k, h) for k, h in self._edge_points()),
                (self._node_above(u, s, self.unit) for u, s in self._node_points()),
                [self._at_most(MOST_KEPT / float(np.linalg.eigvalsh(self.unit)[-1]))],
            )
            return self._largest((b for b in blocks if b[2].size), -np.inf)
        finally:
            self.P2 = given

    def feasible(self, lam: float, floor: float) -> ProgramSolution:
        """Return the largest slack at `lam` with P2/lam >= floor unit, and the matrices (P2 first); P2 a variable."""
        ratio = (1 + self.margin) / lam
        blocks = chain(
            (self._edge(k, h, slack=True) for k, h in self._edge_points()),
            (self._node(u, s, ratio) for u, s in self._node_points()),
            [self._kept(lam, floor), self._at_most(1.0)],
        )
        return self._largest(blocks, LEAST_SLACK)

    def _kept(self, lam: float, floor: float) -> ConeRows:
        """P2/lam >= floor unit."""
        above = np.zeros((self.pairs, self._width))
        above[:, self._place(0)] = -np.eye(self.pairs) / lam
        return "psd", above, -floor * conic_programs.svec(self.unit)

    def _at_most(self, value: float) -> ConeRows:
        """The last variable is at most so much."""
        rows = np.zeros((1, self._width))
        rows[0, -1] = 1.0
        return "nonnegative", rows, np.array([value])

    def best_ratio(self) -> ProgramSolution:
        """Return the largest mu with Phi_s(P_u) >= mu P2 for the given P2, and the matrices."""
        assert self.P2 is not None
        blocks = chain(
            (self._edge(k, h) for k, h in self._edge_points()),
            (self._node_above(u, s, self.P2, 1 + self.margin) for u, s in self._node_points()),
        )
        return self._largest(blocks, np.nextafter(0.0, 1.0))

    def _largest(self, blocks: Iterable[ConeRows], least: float) -> ProgramSolution:
        """The largest last variable under these blocks, and the matrices; none below `least`, or where it fails.

        They are made one after the other, and not all, where they are too large for memory or for what is left of time.
        """
        posed: list[ConeRows] = []
        places, numbers = len(self._edge_points()) + len(self._node_points()), 0.0
        for block in blocks:
            each = float(block[2].size) ** 2
            expected = numbers + each * max(places - len(posed), 0)
            if refused := conic_programs.too_large((), self.budget.seconds_left(LEAST_TIME), expected):
                return 0.0, None, refused
            posed.append(block)
            numbers += each
        cost = np.zeros(self._width)
        cost[-1] = -1.0
        solution = _solved(cost, posed, self.budget)
        if not conic_programs.usable(solution.record):
            return 0.0, None, solution.record
        value, P = float(solution.x[-1]), self._matrices(solution.x)
        chosen = P[0 if self.P2 is None else 1 :]
        definite = np.all(np.linalg.eigvalsh(chosen)[:, 0] > 0)  # a solver that ended early keeps to no cone
        return value, P if value >= least and definite else None, solution.record

    def _edge_points(self) -> list[tuple[int, float]]:
        return [(k, h) for k, times in enumerate(self.edge_times) for h in times]

    def _node_points(self) -> list[tuple[int, float]]:
        return [(u, s) for u, times in enumerate(self.node_times) for s in times]

    def _is_infinite(self, node: int) -> bool:
        return node == 0 and self.P2 is not None and not self.P2.size

    def _start(self, node: int, h: float) -> tuple[Array, Array, Array, Array]:
        """Rows of -[J P_u J'], right side blk(P_u, I) as far as it is given, Z's operator and E.

        Of an infinite P_u what is left of them: I, and E is L.
        """
        lift, press, E = self._flow(h)
        n = self.dynamics.size
        if self._is_infinite(node):
            L = E[:, n:]
            press = conic_programs.svec(L.T @ self.basis @ L).T
            return np.zeros((len(press), self._width)), np.eye(L.shape[1]), press, L
        rows, right = np.zeros((lift.shape[0], self._width)), np.zeros((E.shape[1], E.shape[1]))
        right[n:, n:] = np.eye(E.shape[1] - n)
        if node == 0 and self.P2 is not None:
            right[:n, :n] = self.P2
        else:
            rows[:, self._place(node)] = -lift
        return rows, right, press, E

    def _edge(self, k: int, h: float, slack: bool = False) -> ConeRows:
        edge = self.graph.edges[k]
        rows, right, press, E = self._start(edge.source, h)
        rows[:, self._place(edge.target)] += (1 + self.margin) * press
        right = right + E.T @ self.dynamics.information(edge.outputs) @ E
        if slack:
            rows[:, -1] = conic_programs.svec(np.eye(E.shape[1]))
        return "psd", _stored(rows), conic_programs.svec(right)

    def _node(self, node: int, s: float, ratio: float) -> ConeRows:
        rows, right, press, E = self._start(node, s)
        rows[:, self._place(0)] += ratio * press
        rows[:, -1] = conic_programs.svec(np.eye(E.shape[1]))
        return "psd", _stored(rows), conic_programs.svec(right)

    def _node_above(self, node: int, s: float, form: Array, factor: float = 1.0) -> ConeRows:
        """Phi_s(P_u) above so many times the last variable times a form."""
        rows, right, press, E = self._start(node, s)
        exact = self._is_infinite(node)  # of its own products, as the edges there
        rows[:, -1] = conic_programs.svec(E.T @ form @ E) if exact else factor * press @ conic_programs.svec(form)
        return "psd", _stored(rows), conic_programs.svec(right)

    def _matrices(self, x: Array) -> Array:
        """P of every node, P2 first (nan where it is infinite)."""
        P = conic_programs.smat(x[:-1].reshape(-1, self.pairs))
        if self.P2 is None:
            return np.concatenate([P[-1:], P[:-1]])
        first = self.P2 if self.P2.size else np.full_like(P[0], np.nan)
        return np.concatenate([first[None], P])

    @staticmethod
    def gain(times: list[list[float]], failed: dict[int, tuple[float, float]]) -> None:
        """Add the gaps at which a proof failed to the grid of edges, or to that of nodes."""
        for k, (h, _) in failed.items():
            if h not in times[k]:
                times[k].append(h)

    def widen(self) -> bool:
        """Ask for more room between the grid points; False if there is no more."""
        before, self.margin = self.margin, min(self.margin * WIDER, WIDEST)
        return self.margin > before


def between(ratio: float, missing: float, room: float, rtol: float) -> float:
    """Where lambda is tried next, between 1 and `ratio`: beside the root of the slack, on the side of its farther end.

    Slack is about linear in ln lambda. Where that of the lower end, 1, is not known, ln lambda is squared, down to the
    width that is asked for: where the rate is slow and gaps are short the least lambda is hardly above 1.
    """
    width = np.log(ratio)
    if missing == 0:
        return float(np.exp(max(np.log1p(rtol), min(width / 2, width**2))))
    at = missing / (missing - room)
    at += np.copysign(ASIDE * np.log1p(rtol) / width, 0.5 - at)
    return float(np.exp(width * np.clip(at, LEAST_PART, 1 - LEAST_PART)))


def _stored(rows: Array) -> Array | sparse.csc_matrix:
    """Rows of one edge or node, without their zeros where many nodes have columns of their own."""
    return rows if rows.size < SPARSE else sparse.csc_matrix(rows)


def _solved(cost: Array, blocks: list[ConeRows], budget: Budget) -> conic_programs.ConeSolution:
    """The solver's answer; where it broke down on the way, that to a coarser tolerance, which the proof judges."""

    left = budget.seconds_left(LEAST_TIME)
    solution = conic_programs.solve_cone_program(cost, blocks, budget=left)
    if solution.record.status == conic_programs.FAILED and not budget.over:
        solution = conic_programs.solve_cone_program(
            cost, blocks, tolerance=COARSE_TOLERANCE, budget=budget.seconds_left(LEAST_TIME)
        )
    return solution


def _grid(dynamics: StepDynamics, low: float, high: float, few: bool) -> list[float]:
    """Grid of an interval, ends included; one point where it has no length."""
    if high <= low:
        return [low]
    speed = float(np.abs(np.linalg.eigvals(dynamics.A)).max(initial=0.0)) + dynamics.eta / 2
    density = POINTS_PER_RADIAN_GIVEN if few else POINTS_PER_RADIAN
    count = min(int(np.ceil(density * speed * (high - low))) + 1, MOST_POINTS)
    return [float(v) for v in np.linspace(low, high, count)]
