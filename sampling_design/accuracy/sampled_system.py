"""A schedule as a sampled system in coordinates in which every program is well scaled, whatever the units.

    x(t_j) = D L_j z_j,   z_{j+1} = F_j z_j + int (e^{A_z s} G_z) w ds,   |H_j z_j| <= 1

D evens out units, L_j is a root of a filter's covariance at that sample: z_j is of size one. The filter only scales;
its gains also bound the error once and for all (`reach`), which is what an endless past costs at its far end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.bounds import InitialSet, SignalBounds, noise_units
from sampling_design.accuracy.forgetting import HALVED, PATIENT, FilterPast, FilterStep, filter_pasts, too_far
from sampling_design.accuracy.gap_table import GROWN, GapTable, PropagatedGap, cell_rate, pace, state_scales
from sampling_design.accuracy.lasting import LastingResponses
from sampling_design.accuracy.riccati import least_bounds, settled
from sampling_design.errors import UndecidedError
from sampling_design.numerics.filtering import update_with_gain
from sampling_design.numerics.linalg import discounted_flow, expm_batch, forced_flow
from sampling_design.plants.clusters import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index, Mask

PANEL = 0.125  # length of a panel times the pace of A in scaled coordinates
CELL_LOSS = 8e-3  # what a disturbance that is constant on cells may lose at first
MOST_CELLS = 2**14  # of a gap, however often the plant turns in it: an adversary's, which may be coarser
BETWEEN = (0.2360, 0.6180)  # shares of a gap at which the outputs are looked at for the sizes of what its samples hide
FORGOTTEN = 0.01  # the share of the past that may be left after the filter's memory
PERIODS = 4000  # periods after which a filter that still remembers is given up: a bound that long would be no use
FOLLOWED = 40.0  # growth over a gap, as an exponent, beyond which a root of a covariance has no digit left
AHEAD = 150.0  # growth after the last sample, as an exponent, whose square is a number still, in any units


@dataclass(frozen=True, eq=False)
class GapDynamics:
    """From one sample to the next, in the coordinates of both."""

    length: float
    F: Array
    flow: PropagatedGap
    back: Array
    """(n, n): g = back mu for columns mu that multiply z at the end of the gap."""
    table: GapTable
    loss: float
    """What an adversary whose w is constant on cells may lose, as a share, by the curvature of e^{A_z s} G_z alone."""

    @property
    def edges(self) -> Array:
        """Ends of the cells, back from the end of the gap."""
        return self._cut[0]

    @property
    def cells(self) -> Array:
        """(m, n, q): int over a cell of e^{A_z s} G_z ds."""
        return self._cut[1]

    @cached_property
    def _cut(self) -> tuple[Array, Array]:
        """Edges and integrals of cells so short that delta^2/24 |M''|/|M| <= loss, or the most."""
        s, ahead = np.linspace(0.0, self.length, len(self.flow.propagated)), self.back.T
        rate = cell_rate(ahead @ self.flow.propagated, ahead @ self.flow.bend, self.loss)
        marks = np.concatenate([[0.0], np.cumsum(np.diff(s) * (rate[1:] + rate[:-1]) / 2)])
        number = int(np.clip(np.ceil(marks[-1]), 2, MOST_CELLS))
        even = np.linspace(0.0, s[-1], number + 1)
        edges = np.unique(np.interp(np.linspace(0.0, marks[-1], number + 1), marks, s)) if marks[-1] > 0 else even
        edges[0], edges[-1] = 0.0, s[-1]
        A, G = self.table.A, self.table.G
        inner = forced_flow(A, G, np.diff(edges))[:, :, len(A) :]
        return edges, ahead @ (expm_batch(A, edges[:-1]) @ inner)

    def integral(self, mu: Array, ball: bool) -> Array:
        """Return an upper bound on the integral over the gap of h_W for each column of mu (n, k), for all real s."""
        return self.flow.integral(self.back @ mu, ball)

    def size(self, mu: Array, ball: bool) -> Array:
        """The same, a little larger, on coarser panels where there are many."""
        return self.flow.coarser.integral(self.back @ mu, ball)


@dataclass(frozen=True, eq=False)
class MeasurementModel:
    """One sample: rows in units of `size`, a bound on the noise in them, and the filter's gain.

    That bound is 1, or less of sensors that are nearly `exact` (`EXACT`), and 0 of those that are.
    """

    outputs: Index
    size: Array
    H: Array
    noise: Array
    K: Array

    @property
    def exact(self) -> Mask:
        """Which sensors adversaries leave no noise: what that costs them is nothing, or nearly."""
        return np.asarray(self.noise < 1)


class KnownSpan(NamedTuple):
    """A time during which no result comes in: all that is known then was in when it began."""

    node: int  # of the latest sample of which anything is in
    time: float  # of that sample, since the first one of the system
    begin: float  # begin, end: since that sample
    end: float
    new: tuple[tuple[int, int], ...] = ()  # what comes in as it begins: the node of its sample, and the output


@dataclass(frozen=True, eq=False)
class SampledSystem:
    """Samples j = 0..N-1 and the gaps behind them; endless (without `start`): after the last comes the first.

    Nodes N, N+1, ... are samples again, of which some results are out: each follows another node.
    """

    plant: Plant
    bounds: SignalBounds
    D: Array
    L: Array
    A: Array
    G: Array
    samples: tuple[MeasurementModel, ...]
    gaps: tuple[GapDynamics, ...]
    start: InitialSet | None = None  # of z_0 in a finite system
    last: float = 0.0  # how long a finite system goes on after its last sample
    known: Mask | None = None  # (n,): entries of x that are exactly their centre at the start
    # how many of the last entries of every z no sample of an endless system shows: they move on by themselves, and the
    # others are free of them
    hidden: int = 0
    # in order of time, what is known when; none: a sample counts from its own time until the next one
    known_spans: tuple[KnownSpan, ...] = ()
    # of the nodes beyond the samples: which sample each one is, and the node before it (-1: none)
    again: tuple[int, ...] = ()
    before: tuple[int, ...] = ()
    # how fast panels take A to be, if not as its `pace`, so that systems in other coordinates have the same ones
    speed: float | None = None

    @cached_property
    def size(self) -> float:
        """|A|."""
        return float(np.linalg.norm(self.A, 2))

    @cached_property
    def pace(self) -> float:
        """As fast as which panels take A to be."""
        return pace(self.A)

    @property
    def determined(self) -> int:
        """How many entries of z samples determine."""
        return self.D.size - self.hidden

    def __len__(self) -> int:
        return len(self.samples) - len(self.again)

    @cached_property
    def spans(self) -> tuple[KnownSpan, ...]:
        """What is known when, in order of time; each has a node of its own."""
        if self.known_spans:
            return self.known_spans
        lengths = [*self.lengths.tolist(), *[self.last] * (len(self) - len(self.gaps))]
        times = np.append(0.0, np.cumsum(lengths))
        return tuple(KnownSpan(j, float(times[j]), 0.0, h) for j, h in enumerate(lengths))

    @cached_property
    def judged(self) -> dict[int, KnownSpan]:
        """The same by node."""
        return {span.node: span for span in self.spans}

    @cached_property
    def incoming(self) -> dict[tuple[int, int], int]:
        """By sample and output the node of each result: its sample with no more than what is in when that comes."""
        if self.known_spans:
            return {(self.sample_of(node), i): node for span in self.known_spans for node, i in span.new}
        return {(j, i): j for j, sample in enumerate(self.samples) for i in sample.outputs.tolist()}

    @property
    def lengths(self) -> Array:
        """Those of the gaps."""
        return np.array([gap.length for gap in self.gaps])

    def sample_of(self, j: int) -> int:
        """Which of the samples node j is."""
        return j if j < len(self) else self.again[j - len(self)]

    def gap(self, j: int) -> GapDynamics:
        """The gap behind node j."""
        return self.gaps[self.sample_of(j)]

    @property
    def exact_at_start(self) -> Mask:
        """(n,): entries of x that are known exactly at the start."""
        return np.zeros(self.D.size, dtype=bool) if self.known is None else self.known

    @cached_property
    def exact_for_ever(self) -> Mask:
        """(n,): those of them that neither w nor any other entry moves."""
        still = self.exact_at_start & ~self.G.any(axis=1)
        for _ in still:
            still = still & ~self.A[:, ~still].any(axis=1)
        return still

    def admissible_start(self, z: Array) -> Array:
        """z_0 with what is known exactly of it put right."""
        if not self.exact_at_start.any():
            return z
        return np.asarray(np.linalg.solve(self.L[0], np.where(self.exact_at_start, 0.0, self.L[0] @ z)))

    @cached_property
    def lasting(self) -> LastingResponses | None:
        """Those of an endless system that may have gone on for ever; None where something is unknown for ever."""
        return LastingResponses.of(self.plant, self.bounds) if self.start is None and not self.hidden else None

    @property
    def undriven(self) -> bool:
        """Whether no w drives one of its modes that do not decay."""
        return self.lasting is not None and self.lasting.undriven

    def repeating(self, j: int) -> LastingResponses:
        """The same with the period of the samples, up to sample j."""
        return LastingResponses.of(self.plant, self.bounds, self.lengths, j)

    def mu(self, j: int, rows: Array) -> Array:
        """Return rows (k, n) of x at node j as columns (n, k) that multiply z."""
        return np.asarray((rows * self.D @ self.L[j]).T)

    def nodes(self, j: int, count: int) -> list[int]:
        """Indices of the `count` samples up to and with j, the latest last, or as many as there are.

        Of which some results are out are beside that count.
        """
        out = list[int]()
        while j >= len(self):
            out.append(j)
            j = self.before[j - len(self)]
        if j < 0:
            return out[::-1]
        if self.start is not None:
            return [*range(max(0, j + 1 - count), j + 1), *out[::-1]]
        return [*((j - k) % len(self) for k in range(count - 1, -1, -1)), *out[::-1]]

    def latest(self, j: int, length: int) -> list[int]:
        """Indices of the last `length` nodes up to and with j, or as many as there are, the latest last."""
        every = self.nodes(j, length)
        return every[max(len(every) - length, 0) :]

    def outputs_of(self, nodes: list[int], columns: Array) -> tuple[list[Array], Array]:
        """What the samples of a path show of columns (n, m) of z at its first node, and what these are at its last."""
        outputs = list[Array]()
        for k, node in enumerate(nodes):
            columns = self.gap(nodes[k - 1]).F @ columns if k else columns
            outputs.append(self.samples[node].H @ columns)
        return outputs, columns

    def refined(self, loss: float) -> SampledSystem:
        """Return the system with cells so fine that their curvature loses no more than `loss`."""
        return replace(self, gaps=tuple(replace(gap, loss=loss) for gap in self.gaps))._proven_as(self)

    def at_speed(self, speed: float) -> SampledSystem:
        """Return the system whose panels take A to be so fast."""
        return replace(self, speed=speed)._proven_as(self)

    def _proven_as(self, other: SampledSystem) -> SampledSystem:
        """The system with what is proven of the filter of another one, which is the same."""
        if "reach" in other.__dict__:
            self.__dict__["reach"] = other.reach
        return self

    @cached_property
    def memory(self) -> int:
        """Samples after which a filter's error forgets all but a small share of its past; endless."""
        return self._steps_back(lambda mu: float(np.linalg.norm(mu, 2)), FORGOTTEN)

    def _steps_back(self, size: Callable[[Array], float], least: float) -> int:
        """Samples back from the first one until less than `least` is left of an error there by the filter's gains.

        Over `PERIODS` at most; after `PATIENT` samples by doubled periods: what is forgotten slowly costs no more.
        """
        count, r = len(self), self.determined
        left = np.eye(self.D.size)[:, :r]
        for steps in range(min(PATIENT, PERIODS * count)):
            left = self._before(-steps, 1, left)
            if size(left) < least:
                return steps + 1
            if size(left) > GROWN:
                raise too_far()
        left = np.eye(self.D.size)[:, :r]
        periods = [self._before(0, count, left)[:r]]
        while size(periods[-1]) >= least and 2 ** len(periods) <= PERIODS:
            periods.append(periods[-1] @ periods[-1])
            if not np.abs(periods[-1]).max(initial=0.0) <= GROWN:
                raise too_far()
        steps = 0
        for k in range(len(periods) - 1, -1, -1):
            ahead = periods[k] @ left[:r]
            if size(ahead) >= least:
                left[:r], steps = ahead, steps + count * 2**k
        while steps < PERIODS * count:
            left, steps = self._before(-steps, 1, left), steps + 1
            if size(left) < least:
                break
        return min(steps, PERIODS * count)

    def _before(self, j: int, count: int, mu: Array) -> Array:
        """What the filter's gains leave of columns mu that multiply z after sample j, `count` samples before it."""
        for k in range(j, j - count, -1):
            sample, gap = self.samples[k % len(self)], self.gaps[(k - 1) % len(self)]
            mu = gap.F.T @ (mu - sample.H.T @ (sample.K.T @ mu))
        return mu

    @cached_property
    def reach(self) -> Array:
        """(N, n): bounds on |z_j - estimate|, proven from the filter's gains, whatever the error once was; endless.

            R_j >= cost_j + |rest_j|'R_k   for all j at once,   k the sample `forgetting[j]` before j,

        is a bound, since |rest| contracts; put in on the right, it gives another one, which is no larger. 1 where
        nothing is known, of which nothing is asked.
        """
        at = (np.arange(len(self)) - self.forgetting) % len(self)
        costs, rests = (np.array([past[i] for past in self._filtered]) for i in (1, 2))
        found = least_bounds(costs, rests, at)
        return np.hstack([found, np.ones((len(self), self.D.size - self.determined))])

    @cached_property
    def filter_reach(self) -> Array:
        """(N, n): the same of the filter that counts each sample once; infinite where that is not so easily bounded.

        Whoever goes on from z_k counts sample k again, and so does `reach`: the rest before that is carried on here.
        """
        found = []
        for j, (steps, cost, rest) in enumerate(self._filtered):
            gap = self.gaps[(j - steps - 1) % len(self)]
            found.append((cost + gap.size(rest, self.bounds.w_ball), gap.F.T @ rest))
        at = (np.arange(len(self)) - self.forgetting - 1) % len(self)
        return least_bounds(np.array([cost for cost, _ in found]), np.array([rest for _, rest in found]), at)

    def rests_on(self, j: int, known: Array) -> Array:
        """What follows after sample j of bounds on |z| at that `forgetting[j]` before it; endless."""
        _, cost, rest = self._filtered[j]
        return np.asarray(cost + known[: cost.size] @ np.abs(rest[: cost.size]))

    @property
    def forgetting(self) -> Index:
        """How many samples before each the filter's error is forgotten but for a small share; endless."""
        return np.array([steps for steps, _, _ in self._filtered])

    @cached_property
    def _filtered(self) -> list[FilterPast]:
        """The past of each sample. Raises UndecidedError if the filter's error does not contract."""
        before = [(self.samples[j], self.gaps[j - 1]) for j in range(len(self))]
        steps = [FilterStep(s.K, s.H, s.noise, gap.F, gap.back, gap.flow) for s, gap in before]
        return filter_pasts(steps, self.determined, (self.bounds.w_ball, self.bounds.v_ball), self._require_forgetting)

    def _require_forgetting(self) -> None:
        if self._steps_back(_largest_column, HALVED) >= PERIODS * len(self):
            raise UndecidedError(
                f"Nothing bounds the error on this schedule: its filter forgets no past within {PERIODS} periods."
            )


def _largest_column(mu: Array) -> float:
    """The largest sum of moduli of a column."""
    return float(np.abs(mu).sum(axis=0).max(initial=0.0))


def refuse_growth(plant: Plant, gaps: Array, last: float = 0.0) -> None:
    """Refuse gaps over which a mode grows so far that no double tells what samples show of it; `last` comes after all.

    Raises UndecidedError if there is one.
    """
    rate = float(np.max(np.linalg.eigvals(plant.A).real, initial=0.0))
    if rate * float(np.max(gaps, initial=0.0)) > FOLLOWED or rate * last > AHEAD:
        raise too_far()


def periodic_system(plant: Plant, gaps: Array, bounds: SignalBounds, moving: Array | None = None) -> SampledSystem:
    """Return the system of a periodic schedule; gaps[j] lies behind sample j.

    `moving` (n, m) is what no sample shows, as it is at the first one; nobody knows it.
    """
    refuse_growth(plant, gaps)
    balance, A, G, F, W = balanced_flows(plant, gaps, bounds)
    rows, sizes, noise = noise_units(plant.C * balance, bounds, W, A, G, float(np.mean(gaps)))
    D = state_scales(F, W, rows if moving is None else _rows_between(A, gaps, rows))
    (A, F), G, W, rows = (M * D / D[:, None] for M in (A, F)), G / D[:, None], W / np.outer(D, D), [H * D for H in rows]
    U = np.zeros((len(A), 0)) if moving is None else moving / (balance * D)[:, None]
    bases = _bases(F, U)
    r, count = len(A) - U.shape[1], len(rows)
    # what samples determine moves by itself, whatever the rest does
    N = [basis[:, :r] for basis in bases]
    inner = np.array([N[(j + 1) % count].T @ F[j] @ N[j] for j in range(count)])
    driven = np.array([N[(j + 1) % count].T @ W[j] @ N[(j + 1) % count] for j in range(count)])
    P, roots, shares = settled(inner, driven, [H @ X for H, X in zip(rows, N, strict=True)])
    L, samples = np.zeros_like(F), []
    for j, H in enumerate(rows):
        output = H @ N[j]
        root = roots[j]
        L[j, :, :r], L[j, :, r:] = N[j] @ root, bases[j][:, r:]
        gain = update_with_gain(P[j], output * shares[j][:, None])[1] * shares[j]
        K = np.vstack([np.linalg.solve(root, gain), np.zeros((len(A) - r, len(H)))])
        scaled_rows = H @ L[j]
        scaled_rows[:, r:] = 0.0
        samples.append(MeasurementModel(bounds.measured(j), sizes[j], scaled_rows, noise[j], K))
    steps, table = [], GapTable(A, G, np.ones(len(A)))
    for j, h in enumerate(gaps):
        gap = make_gap(table, float(h), L[j], L[(j + 1) % len(rows)], F[j])
        gap.F[:r, r:] = 0.0
        steps.append(gap)
    return SampledSystem(plant, bounds, balance * D, L, A, G, tuple(samples), tuple(steps), hidden=len(A) - r)


def balanced_flows(plant: Plant, steps: Array, bounds: SignalBounds) -> tuple[Array, Array, Array, Array, Array]:
    """Sizes of the states in which A is even, and there A, G in units of the bound on w, flows and noise over steps."""
    balance = balanced_schur(plant.A).d
    A, G = plant.A * balance / balance[:, None], plant.G * bounds.w / balance[:, None]
    F, W = discounted_flow(A, G @ G.T, steps)
    return balance, A, G, F, W * float(np.mean(steps))


def _rows_between(A: Array, gaps: Array, rows: list[Array]) -> list[Array]:
    """Rows of the samples and of times between them, for sizes: what samples alone hide must not look small."""
    flows = [expm_batch(A, h * np.array(BETWEEN)) for h in gaps]
    return [np.vstack([H, *(H @ E)]) for H, E in zip(rows, flows, strict=True)]


def _bases(F: Array, U: Array) -> list[Array]:
    """Orthonormal [N_j, U_j] at every sample, U_j what U has become; plain axes where it is nothing."""
    if not U.shape[1]:
        return [np.eye(len(U))] * len(F)
    found = []
    for step in F:
        Q = np.linalg.qr(U, mode="complete")[0]
        m = U.shape[1]
        found.append(np.hstack([Q[:, m:], Q[:, :m]]))
        U = step @ Q[:, :m]
    return found


def make_gap(table: GapTable, h: float, L: Array, following: Array, F: Array, loss: float = CELL_LOSS) -> GapDynamics:
    """Return one gap from coordinates L to those of `following`; `table` keeps what gaps of one length share.

    Raises UndecidedError if what is between its panels has no bound in doubles.
    """
    flow = table.cut(h, PANEL)
    if not np.isfinite(flow.third).all():
        raise too_far()
    back = np.asarray(np.linalg.inv(following).T, dtype=np.float64)
    through = np.asarray(np.linalg.solve(following, F @ L), dtype=np.float64)
    return GapDynamics(h, through, flow, back, table, loss)
