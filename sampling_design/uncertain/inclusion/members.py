"""The members of a plant that is not exactly known, and the coordinates in which programs over them are posed.

Where P(tau) has its nodes, and which samples are proven: the graph of the schedules, laid out in time.

Each word of the graph has a P(tau) of its own, linear between nodes from 0 to the longest gap that leaves the word. A
sample takes P(tau) of one word to P(0) of the next. Before its first sample a schedule is so far in a gap that it ends
as that sample comes: in a gap of the graph that is no shorter, else in one of the start's own.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.linalg

from sampling_design.certificates.exact.given_weights import NoiseWeights
from sampling_design.certificates.exact.riccati import periodic_riccati_solution
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.families.graphs import PathCompleteGraph, graph_of
from sampling_design.certificates.form.horizon import output_information
from sampling_design.checkers.family_file import Edge
from sampling_design.errors import SamplingDesignError
from sampling_design.numerics.linalg import balance
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.schedules.family import SamplingFamily
from sampling_design.schedules.jitter import Jitter
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.uncertain.inclusion.program import InclusionData, InclusionProgram
from sampling_design.uncertain.plants.uncertain_plant import InclusionMembers, LinearInclusion, MemberHull

Schedules = SamplingFamily | PeriodicSchedule

LEAST_PIECES = 2  # pieces of the P(tau) of a word whose gaps are much shorter than the longest
DECIMALS = 10  # of the nodes that are chosen here; the ends of gaps stay what they are


class WordLayout(NamedTuple):
    """The nodes of all words, one after the other; each jump leads from node `later` to node `base`, by outputs."""

    nodes: Array
    later: Index
    base: Index
    measured: Mask

    @property
    def pieces(self) -> Index:
        """The first node of each piece."""
        return np.flatnonzero(self.nodes[1:] != 0)


def family_of(schedules: Schedules) -> SamplingFamily:
    """The family; a periodic schedule is one of deviations 0."""
    return Jitter(schedules, 0.0) if isinstance(schedules, PeriodicSchedule) else schedules


def graph_for(schedules: Schedules, memory: int, outputs: int) -> PathCompleteGraph:
    """The graph of a family, or of a periodic schedule: all deviations 0 from it."""
    return graph_of(family_of(schedules), memory, outputs)


def longer(graph: PathCompleteGraph, first: Edge) -> bool:
    """Whether a first gap is the end of another one of the graph."""
    return any(
        edge.source and (edge.target, edge.outputs) == (first.target, first.outputs) and edge.high >= first.high
        for edge in graph.edges
    )


def layout_of(graph: PathCompleteGraph, pieces: int) -> WordLayout:
    """Nodes and jumps of a graph: so many pieces for the longest gap, fewer for shorter ones."""
    edges = [edge for edge in graph.edges if edge.source]
    own = [replace(edge, low=edge.high) for edge in graph.edges if not edge.source and not longer(graph, edge)]
    words = range(0 if own else 1, graph.count)
    edges = own + edges
    tops = {word: max((edge.high for edge in edges if edge.source == word), default=0.0) for word in words}
    longest, begins = max(tops.values()), dict[int, int]()
    nodes: list[Array] = []
    for word in words:
        ends = {end for edge in edges if edge.source == word for end in (edge.low, edge.high)}
        count = max(int(np.ceil(pieces * tops[word] / longest - 1e-9)), min(LEAST_PIECES, pieces))
        begins[word] = sum(part.size for part in nodes)
        nodes.append(grid(tops[word], sorted(ends), count))
    found: dict[tuple[int, int, tuple[bool, ...]], None] = {}
    for edge in edges:
        times = nodes[edge.source - words[0]]
        for at in np.flatnonzero((times >= edge.low) & (times <= edge.high)).tolist():
            found[begins[edge.source] + at, begins[edge.target], edge.outputs] = None
    later, base, measured = zip(*found, strict=True)
    return WordLayout(
        np.concatenate(nodes), np.array(later, np.intp), np.array(base, np.intp), np.array(measured, bool)
    )


def grid(top: float, ends: list[float], count: int) -> Array:
    """Equal pieces of [0, top], the nearest node moved to each end of a gap, or one put in where it is taken."""
    nodes = {float(f"{t:.{DECIMALS}g}"): False for t in np.linspace(0.0, top, count + 1)[1:-1].tolist()}
    for end in ends:
        if not 0 < end < top:
            continue
        free = [t for t, taken in nodes.items() if not taken]
        near = min((abs(t - end), t) for t in [*free, np.inf])
        if near[0] <= top / count / 2:
            del nodes[near[1]]
        nodes[end] = True
    return np.array([0.0, *sorted(nodes), top])


INFLATED = (0.002, 0.02, 0.1)
"""Share by which sampled members are moved outwards, so that cells of the region need not be tiny."""
HULL_CORNERS, HALVINGS = 10, 3
"""Directions of a set that holds all C whose corners are members; halvings of a stiff plant's region into cells."""
SKEWED = 1e12  # condition, of rows of length 1, from which on a root of the nominal information is no basis
FAR = 1e4  # size, in inner coordinates, from which on what the states' scales call one is given the size 1
FASTEST = 1e3  # rates per longest gap beyond which a plant is stiff


class InclusionPlants:
    """Linear plants that stand for one that is not exactly known, those in the program, and how it is posed.

    `chosen` and `chosen_outputs` are the members (A, G) and C in the program: those that bind.
    """

    def __init__(
        self,
        plant: LinearInclusion,
        schedules: Schedules,
        graph: PathCompleteGraph,
        weights: NoiseWeights,
        noise_gain: float,
        budget: Budget = ENDLESS,
        seed: int = 0,
    ) -> None:
        self.noise_gain, self.budget = noise_gain, budget
        self.plant, self.schedules, self.graph, self.weights = plant, schedules, graph, weights
        self.centre = plant.centre
        self.longest = float(graph.tops.max())
        self.members: InclusionMembers = plant.members(np.random.default_rng(seed))
        self.columns, self.sizes = plant.columns, np.zeros(0)
        if self.columns is not None:  # multipliers stand for all members
            self.members = self.members._replace(dynamics=self.columns[0][None], complete=True)
        self.chosen, self.chosen_outputs = extreme(self.members.dynamics), extreme(self.members.outputs)
        self.inflation = 0.0 if self.members.complete else INFLATED[0]
        self._roots: dict[float, Array] = {}
        self._sampled = (self.members, self.chosen, self.chosen_outputs)
        self.hull: MemberHull | None = None
        self.refused = ""

    def program(self, posed: InclusionData) -> InclusionProgram:
        """The blocks of a program, within what is left of the budget; `refused` is why the last one was not posed."""
        made = InclusionProgram(posed, self.budget.seconds_left())
        self.refused = made.refused.status if made.refused else self.refused
        return made

    def inner(self, eta: float, pieces: int, T: Array | None = None) -> tuple[InclusionData, Array]:
        """The program in inner coordinates, and the T with P = T P_inner T': by default that of the rate."""
        layout, b = layout_of(self.graph, pieces), self.longest
        T = self.coordinates(eta) if T is None else T
        inverse = np.linalg.inv(T)
        root_w = np.linalg.cholesky(self.weights.Qw)
        patterns, pattern = np.unique(layout.measured, axis=0, return_inverse=True)
        n = self.centre.n_states
        outputs = np.array([self.shares(measured) @ self.members.outputs @ inverse.T for measured in patterns])
        unit = inverse @ np.diag(1 / self.centre.states.scales**2) @ inverse.T
        size = float(np.linalg.norm(unit, 2))
        if not 1 / FAR <= size <= FAR:  # then p of P >= p unit is none that the solver tells from 0 or bounds
            unit /= max(size, np.finfo(float).tiny)
        q = len(root_w)
        columns = multiplied = np.zeros((0, 0))
        if self.columns is not None:
            to_w = np.linalg.inv(root_w).T / np.sqrt(b)  # of inner disturbances in physical ones
            axes = np.vstack([np.hstack([inverse.T, np.zeros((n, q))]), np.hstack([np.zeros((q, n)), to_w])])
            _, add, at = self.columns
            multiplied = axes[list(at)]
            self.sizes = np.linalg.norm(multiplied, axis=1)
            columns, multiplied = b * (T.T @ add) * self.sizes, multiplied / self.sizes[:, None]
        posed = InclusionData(
            dynamics=self.moved(self.members.dynamics, T), outputs=outputs, Qw=np.eye(q), unit=unit, eta=eta * b,
            nodes=layout.nodes / b, pieces=layout.pieces, later=layout.later, base=layout.base, pattern=pattern.ravel(),
            columns=columns, multiplied=multiplied,
        )  # fmt: skip
        return posed, T

    @property
    def mean(self) -> float:
        """Mean gap, of a family that of its bounds."""
        own = self.schedules
        if isinstance(own, SamplingFamily):
            return (own.min_gap + own.d_max) / 2
        return float(own.gaps.mean())

    @property
    def family(self) -> SamplingFamily:
        """The family; a periodic schedule is one of deviations 0."""
        return family_of(self.schedules)

    def shares(self, measured: Mask) -> Array:
        """S with S'S the information of the outputs that are measured: (V restricted to them)^-1, V = R^-1 + Qv^-1."""
        found = np.zeros((len(measured), len(measured)))
        if measured.any():
            V = np.linalg.inv(output_information(self.weights.R, self.weights.Qv))[np.ix_(measured, measured)]
            found[np.ix_(measured, measured)] = np.linalg.inv(np.linalg.cholesky(V))
        return found

    def coordinates(self, eta: float) -> Array:
        """The coordinates of a rate, found once."""
        if eta not in self._roots:
            self._roots[eta] = self._root(eta)
        return self._roots[eta]

    def _root(self, eta: float) -> Array:
        """A root of the information that the nominal plant keeps; of its balance where there is none."""
        if self.stiff:
            return information_root(
                self.members.dynamics.mean(axis=0)[:, : self.centre.n_states], self.centre.states.scales, self.longest
            )
        try:
            prior = np.diag(1 / self.centre.states.scales**2)
            problem = window_problem(self.centre, self.family.nominal, prior, *self.weights, eta)
            with np.errstate(over="raise", invalid="raise"):  # growth beyond all numbers within a gap
                Y = np.mean(periodic_riccati_solution(problem, iterate=False), axis=0)
            own = np.linalg.cholesky(Y)  # in scaled states
            rows = own / np.linalg.norm(own, axis=1)[:, None]  # whose condition no units change
            root = np.linalg.solve(own, np.diag(1 / self.centre.states.scales)).T
            if np.all(np.isfinite(root)) and np.linalg.cond(rows) < SKEWED:
                return np.asarray(root)
        except (SamplingDesignError, np.linalg.LinAlgError, FloatingPointError):
            pass  # the centre alone may have no certificate, or none at this rate
        return np.diag(1 / balance(self.centre.A * self.longest).d)

    def inflated(self, posed: InclusionData) -> Array:
        """Members moved away from their middle by the share `inflation`."""
        M = posed.dynamics
        middle = (M.max(axis=0) + M.min(axis=0)) / 2
        return np.asarray(middle + (1 + self.inflation) * (M - middle))

    @property
    def stiff(self) -> bool:
        """Whether the centre has rates beyond `FASTEST` per longest gap, which multipliers do not know of."""
        fastest = np.max(np.abs(np.linalg.eigvals(self.centre.A)), initial=0.0)
        return bool(self.columns is None and self.longest * fastest > FASTEST)

    def enter_hull(self, eta: float) -> bool:
        """Take for the members sets that hold all Jacobians of a cell each, so that a proof needs few cells."""
        T = self.coordinates(eta)

        def size(moves: Array) -> Array:
            return np.asarray(np.square(np.linalg.norm(self.moved(moves, T), axis=(-2, -1))).sum(axis=0))

        hull = self.plant.hull(HALVINGS if self.stiff else 0, size)
        if hull is None or not len(hull.moves):
            return False
        self._sampled = (self.members, self.chosen, self.chosen_outputs)
        self.hull = hull
        outputs = corners(hull.output, hull.output_moves)
        self.members = InclusionMembers(hull.middle, outputs, ("a cell of the region",) * len(hull.middle), False)
        self.chosen, self.chosen_outputs = extreme(hull.middle), extreme(outputs)
        return True

    def leave_hull(self) -> None:
        """Take the sampled members again."""
        self.members, self.chosen, self.chosen_outputs = self._sampled
        self.hull = None

    def moved(self, moves: Array, T: Array) -> Array:
        """(A, G) (..., n, n + q), or changes of them, in inner coordinates."""
        n, b = self.centre.n_states, self.longest
        A = b * (T.T @ moves[..., :n] @ np.linalg.inv(T).T)
        G = np.sqrt(b) * (T.T @ moves[..., n:] @ np.linalg.inv(np.linalg.cholesky(self.weights.Qw)).T)
        return np.asarray(np.concatenate([A, G], axis=-1))


def information_root(A: Array, scales: Array, longest: float) -> Array:
    """A root T of an information TT' that weighs each direction by how long it lasts: I where A = 0.

    The solution of (A - s)'P + P(A - s) = -Q, Q what the scales call one, with s just beyond what grows.
    """
    unit = np.diag(1 / scales)
    own = scales[:, None] ** -1 * A * scales * longest
    shift = max(float(np.max(np.linalg.eigvals(own).real, initial=0.0)), 0.0) + 0.5
    P = scipy.linalg.solve_continuous_lyapunov((own - shift * np.eye(len(own))).T, -np.eye(len(own)))
    return np.asarray(unit @ np.linalg.cholesky((P + P.T) / 2))


def corners(middle: Array, moves: Array) -> Array:
    """The middle and all signs of the moves, of up to `HULL_CORNERS` of them."""
    signs = np.array(list(product((-1.0, 1.0), repeat=min(len(moves), HULL_CORNERS))))
    return np.asarray(middle + np.tensordot(signs.reshape(len(signs), -1), moves[:HULL_CORNERS], 1))


def extreme(stack: Array) -> list[int]:
    """Members that begin: all where there are few, else those that are extreme in some entry."""
    flat = stack.reshape(len(stack), -1)
    if len(stack) <= 8:
        return list(range(len(stack)))
    moving = np.flatnonzero(np.ptp(flat, axis=0) > 0)
    ends = {int(k) for j in moving for k in (np.argmin(flat[:, j]), np.argmax(flat[:, j]))}
    return sorted(ends)[:16]
