"""Sigma over all positions of a window along a plant that varies in time.

Within a piece the window's samples stay, O(s) = O(b) Phi(b, s). With y the unit state that O(s) sees least,
sigma(s_0) |Phi(s_0, s) y| <= |O(s_0) Phi(s_0, s) y| = sigma(s), and |Phi(s_0, s) y| >= exp(-int mu), where mu is the
largest eigenvalue of the symmetric part of A for s > s_0 and of that of -A for s < s_0. It is convex in A, so that of a
table its largest value over an interval stands at an end or a knot: a proven bound, of first order. Intervals are
halved where they are lowest. Of functions A is only looked at, and nothing is proven.

A sample that comes e late, |e| <= d, reads C(t + e) Phi(t + e, t) in place of C(t), and with a >= |A| near t

    |C(t + e) Phi(t + e, t) - C(t)| <= |C(t)| (e^{a d} - 1) + c e^{a d},    c >= |C(t + e) - C(t)|,

where a and c stand at ends and knots, too. Rows that see no more than all that differ so little take the place of O.
Of functions each sample is early, late or on time, whichever shows the least seen state least, in turn with that state.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import balance, right_directions
from sampling_design.observability.alignment import align
from sampling_design.observability.sigma_bracket import SigmaDeviations, uninterrupted
from sampling_design.observability.windows.bracket import WindowBracket, too_few
from sampling_design.observability.windows.pieces import WindowPieces
from sampling_design.observability.windows.timing import rows_without
from sampling_design.observability.windows.window_record import WindowSigma, checked_pieces, record_of
from sampling_design.observability.windows.window_sigma import left_of_sigma, lost_one_by_one
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget, BudgetSpentError, Progress
from sampling_design.schedules.schedule import Schedule
from sampling_design.uncertain.plants.time_varying import MatrixTable, TimeVaryingPlant, TransitionTable, length_of

FIRST = 5  # positions of a piece at first, its ends included
TURNS = 6  # in which real times of functions are sought
LOOKED = 5  # instants of an interval at which functions are looked at
MOST_PROVEN, MOST_SAMPLED = 5000, 100
"""Halvings at most: of tables, and of functions, whose every transition is an integration."""
Flows: TypeAlias = Callable[[tuple[float, ...], Budget], TransitionTable]
EPS = float(np.finfo(float).eps)
MOVED = 1 + 1e-9  # covers the rounding of a few operations


class _EvaluatedStart(NamedTuple):
    """A window start: its rows, how far they may be off, sigma, and how far that may be off."""

    at: float
    rows: Array
    wrong: float
    off: float
    sigma: float


class VaryingSearch:
    """The bracket of one plant; transitions are scaled, and rows refer to scaled states."""

    def __init__(self, plant: TimeVaryingPlant, pieces: WindowPieces, flows: Flows, clock: Budget) -> None:
        self.plant, self.pieces, self.flows, self.clock = plant, pieces, flows, clock
        self.unit = plant.states.scales
        self.d = pieces.timing_tolerance.radius
        self.table, self.outputs = (
            part.in_units(unit, self.unit) if isinstance(part, MatrixTable) else None
            for part, unit in ((plant.A, self.unit), (plant.C, plant.outputs.scales))
        )

    def growth(self, a: float, b: float) -> tuple[float, float]:
        """Largest eigenvalues of the symmetric parts of A and of -A over [a, b]: proven of a table."""
        if self.table is not None:
            stack = np.array([self.table(t) for t in self.table.knots(a, b)])
        else:
            looked = np.linspace(a, b, LOOKED).tolist()
            stack = np.array([np.asarray(self.plant.A(t), dtype=float) for t in looked])
            stack = stack * self.unit / self.unit[:, None]
        values = np.linalg.eigvalsh(stack + stack.swapaxes(1, 2)) / 2
        room = 8 * EPS * len(stack[0]) * float(np.abs(values).max(initial=0.0))
        return float(values[:, -1].max()) + room, float(-values[:, 0].min()) + room

    def last(self, g: int) -> _EvaluatedStart:
        """The node at the right end of a piece."""
        start, samples = float(self.pieces.right[g]), self.pieces.samples(g)
        n, mask = self.plant.n_states, self.pieces.measured(g)
        proven = self.table is not None and self.outputs is not None
        if self.d and not proven:
            samples = self.worst_times(start, samples, mask)
        later = np.unique(np.concatenate([[start], np.maximum(samples, start)]))
        transitions = self.flows(tuple(later.tolist()), self.clock)
        flow, off, rows, wrong, unsure = np.eye(n), 0.0, list[Array](), list[float](), list[float]()
        lost = np.zeros((n, n))
        at = np.searchsorted(later, np.maximum(samples, start))
        for k in range(later.size):
            if k:
                F, own = transitions.F[k - 1], float(transitions.errors[k - 1])
                size, before = length_of(F), length_of(flow)
                off = size * off + own * (before + off) + 2 * n * n * EPS * size * before
                flow = F @ flow
            for j in np.flatnonzero(at == k):
                C = transitions.C[k]
                C = C if mask is None else C[mask[j]]
                rows.append(C @ flow)
                beside = off + 2 * n * n * EPS * length_of(flow)
                wrong.append(float(np.linalg.norm(C)) * beside)
                if self.d and proven and C.size:
                    moved = self.moved(float(samples[j]), None if mask is None else mask[j])
                    lost += moved**2 * flow.T @ flow
                    unsure.append(moved * beside)
        O = np.vstack(rows) if rows else np.zeros((0, n))
        if lost.any() and len(O) >= n:
            size = float(np.abs(O).max()) or 1.0
            O = size * rows_without(O[None] / size, lost[None] / size**2)[0]
        return self._node(start, O, math.hypot(*wrong) + math.hypot(*unsure))  # whose squares may overflow

    def worst_times(self, start: float, samples: Array, mask: Mask | None) -> Array:
        """Real times of samples at which the window from `start` on was found to see little; nothing is proven."""
        real = np.clip(samples[:, None] + self.d * np.array([0.0, -1.0, 1.0]), start, self.plant.horizon)
        later, place = np.unique(np.append(start, real), return_inverse=True)
        transitions, flow = self.flows(tuple(later.tolist()), self.clock), [np.eye(self.plant.n_states)]
        for F in transitions.F:
            flow.append(F @ flow[-1])
        rows = (transitions.C @ np.array(flow))[place[1:]].reshape(*real.shape, -1, self.plant.n_states)
        rows = rows if mask is None else rows * mask[:, None, :, None]
        each, chosen = np.arange(len(samples)), np.zeros(len(samples), dtype=np.intp)
        for _ in range(TURNS if len(samples) else 0):
            state = right_directions(rows[each, chosen].reshape(-1, self.plant.n_states))[1][-1]
            chosen = np.argmin(np.linalg.norm(rows @ state, axis=2), axis=1)
        return np.asarray(real[each, chosen])

    def moved(self, t: float, mask: Mask | None) -> float:
        """How far the rows of a sample planned at t may be from those there, times within the horizon; of tables."""
        assert self.table is not None
        assert self.outputs is not None
        d, keep = self.d, slice(None) if mask is None else mask
        ends = max(t - d, 0.0), min(t + d, self.plant.horizon)
        C = self.outputs(t)[keep]
        grown = max(float(np.linalg.norm(self.table(at), 2)) for at in self.table.knots(*ends)) * d
        off = max(float(np.linalg.norm(self.outputs(at)[keep] - C, 2)) for at in self.outputs.knots(*ends))
        return (float(np.linalg.norm(C, 2)) * float(np.expm1(grown)) + off * float(np.exp(grown))) * MOVED

    def before(self, node: _EvaluatedStart, s: float) -> _EvaluatedStart:
        """The node at an earlier start of the same piece."""
        transitions = self.flows((s, node.at), self.clock)
        F, own, whole = transitions.F[0], float(transitions.errors[0]), float(np.linalg.norm(node.rows))
        size = length_of(F)
        off = node.wrong * (size + own) + whole * (own + 2 * F.size * EPS * size)
        return self._node(s, node.rows @ F, off)

    def _node(self, at: float, rows: Array, off: float) -> _EvaluatedStart:
        n = self.plant.n_states
        sigma = float(np.linalg.svd(rows, compute_uv=False)[-1]) if len(rows) >= n else 0.0
        return _EvaluatedStart(at, rows, off, off + 8 * n * EPS * float(np.linalg.norm(rows)), sigma)

    def least(self, a: _EvaluatedStart, b: _EvaluatedStart) -> float:
        """A bound from below of sigma between two neighbours."""
        with np.errstate(divide="ignore"):
            low, high = (float(np.log(max(node.sigma - node.off, 0.0))) for node in (a, b))
        if not np.isfinite([low, high]).any():
            return 0.0
        after, back = self.growth(a.at, b.at)
        h = b.at - a.at
        ends = [max(low, high - back * h), max(low - after * h, high)]
        if np.isfinite([low, high]).all() and after + back > 0:
            meeting = (low - high + back * h) / (after + back)
            if 0 < meeting < h:
                ends.append(low - after * meeting)
        return float(np.exp(min(ends)))


def bracket_varying(
    plant: TimeVaryingPlant, pieces: WindowPieces, rtol: float, budget: float, flows: Flows
) -> WindowBracket:
    """Bracket the least sigma; `status` as of `WindowSigma`, and "sampled" of functions, where `lower` is 0.

    `flows` are the plant's transitions, kept for windows that are judged again without a sample.
    """
    clock = Budget(budget)
    search = VaryingSearch(plant, pieces, flows, clock)
    nothing = _EvaluatedStart(float(pieces.right[0]), np.zeros((0, plant.n_states)), 0.0, 0.0, np.inf)
    short = too_few(pieces, plant.n_states, len(plant.outputs))
    if short is not None:
        best = nothing._replace(at=float(pieces.left[short]), sigma=0.0)
        nodes = [[best] if g == short else [] for g in range(len(pieces))]
        return _bracket(search, nodes, short, best, np.zeros(len(pieces)), "too few samples")
    most = MOST_PROVEN if plant.tabled else MOST_SAMPLED
    nodes, status = _begun(search)
    heap = [(search.least(a, b), g, a.at, a, b) for g, own in enumerate(nodes) for a, b in pairwise(own)]
    heapq.heapify(heap)
    floors = _floors(nodes, pieces)
    met = ((g, node) for g, own in enumerate(nodes) for node in own)
    g, best = min(met, key=lambda found: found[1].sigma, default=(0, nothing))
    for _ in range(most if status == "closed" else 0):
        if best.sigma <= best.off:
            if hidden(search, best):
                return _bracket(search, nodes, g, best._replace(sigma=0.0), np.zeros(len(pieces)), "below rounding")
            status = "rounding"  # of the transitions' own bound, which is no smallness of sigma
            break
        if not heap or heap[0][0] >= (1 - rtol) * best.sigma:
            break
        if clock.over:
            status = "budget"
            break
        low, piece, _, a, b = heap[0]
        middle = a.at / 2 + b.at / 2
        if not pieces.tolerance < middle - a.at < b.at - a.at - pieces.tolerance:  # one time, for events as well
            status = "rounding"
            break
        try:
            new = search.before(b, middle)
            parts = [(search.least(*ends), piece, ends[0].at, *ends) for ends in ((a, new), (new, b))]
            nodes[piece].append(new)
            g, best = (piece, new) if new.sigma < best.sigma else (g, best)
            heapq.heapreplace(heap, parts[0])
            heapq.heappush(heap, parts[1])
        except KeyboardInterrupt:  # what the interval was known to be not below holds for its halves
            floors[piece], status = min(floors[piece], low), "interrupted"
            break
        except BudgetSpentError:
            status = "budget"
            break
    else:
        status = status if status != "closed" else "budget"
    for low, piece, *_ in heap:
        floors[piece] = min(floors[piece], low)
    if not plant.tabled:
        floors = np.zeros(len(pieces))
        status = "sampled" if status != "interrupted" and np.isfinite(best.sigma) else status
    return _bracket(search, nodes, g, best, floors, status)


def _floors(nodes: list[list[_EvaluatedStart]], pieces: WindowPieces) -> Array:
    """What sigma is not below at the nodes of each piece; 0 of one that is not looked at from its beginning on."""
    floors = np.array([max(min(node.sigma - node.off for node in own), 0.0) if own else 0.0 for own in nodes])
    floors[[not own or own[0].at > left for own, left in zip(nodes, pieces.left.tolist(), strict=True)]] = 0.0
    return floors


def kept_flows(plant: TimeVaryingPlant) -> Flows:
    """The plant's transitions between any times, each gap integrated once: windows share nearly all of theirs."""
    kept = dict[tuple[float, float], TransitionTable]()

    def over(gap: tuple[float, float], clock: Budget) -> TransitionTable:
        if gap not in kept:
            kept[gap] = plant.transitions(gap, clock)
        return kept[gap]

    def flows(times: tuple[float, ...], clock: Budget) -> TransitionTable:
        parts = [over(gap, clock) for gap in pairwise(times)]
        if not parts:
            return plant.transitions(times)
        C = np.concatenate([parts[0].C[:1], *(part.C[1:] for part in parts)])
        F, errors = (np.concatenate([each[k] for each in parts]) for k in (0, 2))
        return TransitionTable(F, C, errors, parts[0].proven)

    return flows


def _begun(search: VaryingSearch) -> tuple[list[list[_EvaluatedStart]], str]:
    """Nodes of every piece to begin with, in order, as far as there is time; and how that ended."""
    nodes = [list[_EvaluatedStart]() for _ in range(len(search.pieces))]
    try:
        for g, own in enumerate(nodes):
            for node in _first(search, g):
                own.insert(0, node)
    except KeyboardInterrupt:
        return nodes, "interrupted"
    except BudgetSpentError:
        return nodes, "budget"
    return nodes, "closed"


def _first(search: VaryingSearch, g: int) -> Iterator[_EvaluatedStart]:
    """Nodes of a piece to begin with, the last first."""
    node = search.last(g)
    yield node
    for s in np.linspace(search.pieces.left[g], search.pieces.right[g], FIRST)[-2::-1].tolist():
        if s < node.at:
            node = search.before(node, s)
            yield node


def hidden(search: VaryingSearch, start: _EvaluatedStart) -> bool:
    """Whether rows leave a direction out but for rounding, in the given and in balanced states."""
    unit = search.plant.states.scales
    span = search.pieces.window  # of chains alone only time says how fast they are
    d = balance(np.asarray(search.plant.A(start.at), dtype=float) * span * unit / unit[:, None]).d
    return all(s[-1] <= HIDDEN * s[0] for s in (np.linalg.svd(start.rows * by, compute_uv=False) for by in (1.0, d)))


def _bracket(
    search: VaryingSearch, nodes: list[list[_EvaluatedStart]], g: int, best: _EvaluatedStart, floors: Array, status: str
) -> WindowBracket:
    """What was found, as the search of a plant that does not vary tells it."""
    pieces, n = search.pieces, best.rows.shape[1]
    every = [sorted(own, key=lambda node: node.at) for own in nodes]
    direction = right_directions(best.rows)[1][-1] if len(best.rows) else np.eye(n)[0]
    return WindowBracket(
        lower=min(float(floors.min()), best.sigma),
        status=status,
        witness=pieces.witness(g, best.at, direction, best.sigma + (best.off if best.sigma > 0 else 0.0)),
        pieces=pieces,
        nodes=np.array([node.at for own in every for node in own]),
        sigma=np.array([node.sigma for own in every for node in own]),
        owner=np.repeat(np.arange(len(pieces)), [len(own) for own in every]),
        piece_lower=floors,
    )


HIDDEN = 1e-9  # singular value of rows, over the largest, up to which it is what integration rounds
RTOL = 0.01  # default width of the bracket, relative
ROUGH = 1.0  # of what is beside it where nothing is proven: no interval is halved


def window_sigma_varying(
    plant: TimeVaryingPlant,
    schedule: object,
    window: float,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    rigorous: bool = False,
    start: float | None = None,
) -> WindowSigma:
    """Bound sigma over all positions of a window, rows C(tau) Phi(tau, t - T): see `window_sigma`.

    `deviations`, `sampled` of functions, are of real times within the horizon; windows that are longer by it may begin
    before the horizon, of the state at its beginning.

    Raises ArgumentError if balls are asked for, or the schedule is not finite or leaves the plant's horizon.
    """
    if rigorous:
        raise ArgumentError("`rigorous` is for plants that do not vary: of a table all rounding is counted anyway.")
    if not isinstance(schedule, Schedule):
        raise ArgumentError(
            f"`schedule` must be a Schedule within the plant's horizon, got {checks.described(schedule)}."
        )
    aligned = align(plant.at(0.0), schedule)
    outside = [t for t in aligned.times.tolist() if not 0 <= t <= plant.horizon]
    if outside:
        raise ArgumentError(
            f"`schedule` must lie within the plant's horizon [0, {plant.horizon:.6g}], got a sample at {outside[0]!r}."
        )
    pieces, tolerance, seconds = checked_pieces(aligned, window, start, RTOL if rtol is None else rtol, budget)
    limit = Budget(seconds)
    flows = kept_flows(plant)
    bracket = bracket_varying(plant, pieces, tolerance, seconds, flows)
    found = record_of(bracket, tolerance, plant.time_unit, "scaled" if plant.has_scales else "physical")
    proven = plant.tabled and isinstance(plant.C, MatrixTable)  # between samples other C are only looked at
    rough = tolerance if proven else max(tolerance, ROUGH)

    def least(pieces: WindowPieces, seconds: float, _: float) -> tuple[float, float]:
        # windows that are longer may begin before the horizon: the state is that at its beginning
        left, right = np.maximum(pieces.left, 0.0), np.maximum(pieces.right, 0.0)
        found = uninterrupted(bracket_varying(plant, replace(pieces, left=left, right=right), rough, seconds, flows))
        return found.lower if proven else found.witness.sigma, found.witness.sigma

    def beside() -> SigmaDeviations | None:
        lost = partial(lost_one_by_one, least, len(plant.outputs), len(aligned))
        sigma = found.lower if proven else found.upper
        left = left_of_sigma(
            aligned, window, least, lost, plant.time_unit, sigma=sigma, start=start, seconds=seconds_left
        )
        return left if proven or left is None else replace(left, sampled=True)

    seconds_left = limit.left
    return replace(found, beside=beside)
