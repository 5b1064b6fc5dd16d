"""The strongest trajectory that a choice of samples does not show: the adversary's program on the grid.

    maximise  c'z_e   over |w| <= 1, z_0 = 0, |H_j z_i| <= 1 wherever (i, j) is measured

and the least observable one, which reaches a level with as little to be seen anywhere as can be. Either is simulated
anew and scaled until it is admissible: what comes of it never depends on the solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sampling_design.accuracy.bounds import InitialSet
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.conic_programs import INFEASIBLE, SOLVED, UNBOUNDED, ConeSolver
from sampling_design.numerics.stage_programs import StageProgram
from sampling_design.planning.discrete_plant import DiscretePlant
from sampling_design.planning.search_progress import CONE, STAGES
from sampling_design.records.arrays import Array, Index, Mask

TOLERANCE = 1e-7  # asked of the solver: trajectories are scaled until they are admissible, so it only costs strength

STAGED, STALLED, MANY = 1e-4, 2e-3, 2000
"""Share within which the two sides of a program over stages meet, beyond which it is left to the general solver, and
entries of w from which on stages are quicker."""

SPANNED, INDEPENDENT = 3, 1e-6
"""States up to which what was solved bounds other rows, by each of so few; directions whose determinant is less are
taken for dependent."""

SAME = 1 - 1e-12  # two directions are one if their cosine is beyond this
BEYOND = 1 + 1e-4  # a least_observable trajectory reaches this much more than asked, so that scaling leaves it above


@dataclass(frozen=True, eq=False)
class DisturbedTrajectory:
    """A trajectory from rest, with w constant over each step."""

    w: Array  # (T, q): in units of the bound
    knots: Index  # (K,): steps at which the state is given, the first 0
    states: Array  # (K, n): z there
    path: Array  # (T+1, n): z at every step, simulated from the knots

    def size(self, ball: bool) -> float:
        """The largest |w|."""
        sizes = np.linalg.norm(self.w, axis=1) if ball else np.abs(self.w)
        return float(np.max(sizes, initial=0.0))


def in_stages(discrete: DiscretePlant, knots: Array | Index) -> bool:
    """Whether a window of samples at `knots` is so large that it is solved stage by stage."""
    many = sum(len(discrete.gap(d)[2]) for d in np.diff(knots).tolist()) * discrete.G.shape[1]
    return not discrete.ball and many > MANY


class GridWindow:
    """Samples at `knots` (steps or parts of them), each with its `measured` (K, p); all starts at rest at knots[0].

    Or in the set `start` of z there, which may leave it free: what is then wanted may be unbounded.
    `excess`: (K, p) weights; where not zero, an output may exceed its bound, and its excess is what is minimised.
    """

    def __init__(
        self,
        discrete: DiscretePlant,
        knots: Array | Index,
        measured: Mask,
        excess: Array | None = None,
        start: InitialSet | None = None,
    ):
        self.discrete, self.knots, self.measured, self.excess, self.start = discrete, knots, measured, excess, start
        n, q = discrete.n, discrete.G.shape[1]
        self._gaps = [discrete.gap(d) for d in np.diff(knots).tolist()]
        self._w_at = np.concatenate([[0], np.cumsum([len(cells) * q for _, _, cells in self._gaps])]).astype(int)
        self._w_at += n * len(knots)
        self._slack_at = int(self._w_at[-1])
        soft = [] if excess is None else [int(np.count_nonzero(f)) for f in excess]
        self._columns = self._slack_at + sum(soft)
        self._soft, self._built = soft, False
        self._known: list[tuple[Array, tuple[Array, Array, str]]] = []
        self._spanned: tuple[int, Array, Array] | None = None
        self._stages: StageProgram | None = None
        if excess is None and start is None and in_stages(discrete, knots):
            measured_rows = [discrete.H[chosen] for chosen in measured]
            self._stages = StageProgram([F for F, _, _ in self._gaps], [B for _, B, _ in self._gaps], measured_rows)
            self.price, self.entries = STAGES, int(len(knots) * n**1.5)
        else:
            self._build(soft)

    def _build(self, soft: list[int]) -> None:
        self._built = True
        discrete, n, q = self.discrete, self.discrete.n, self.discrete.G.shape[1]
        table, w = ConeTable(self._columns), int(self._w_at[0])
        F, B = (np.array([gap[0] for gap in self._gaps]).reshape(-1, n, n), [gap[1] for gap in self._gaps])
        if self.start is None:
            table.add(np.zeros(n), (0, np.eye(n)))
        table.flow(F, np.hstack([np.zeros((n, 0)), *B]), [own.shape[1] for own in B], 0, w)
        table.end("zero")
        slack = self._slack_at
        if self.start is not None:
            self.start.pose(table, ball=False)
        for k in range(len(self.knots)):
            hard = discrete.H[self.measured[k]]
            table.box(k * n, hard, np.ones(len(hard)))
            if soft and soft[k] and self.excess is not None:
                loose, m = discrete.H[self.excess[k] > 0], soft[k]
                both = np.vstack([-np.eye(m), -np.eye(m)])
                table.add(np.ones(2 * m), (k * n, np.vstack([loose, -loose])), (slack, both))
                table.add(np.zeros(m), (slack, -np.eye(m)))
                slack += m
        if self.excess is not None:
            self._reach_at = table.add(np.zeros(1), ((len(self.knots) - 1) * n, np.ones((1, n))))  # set when solved
        many = int(self._w_at[-1]) - w
        if not discrete.ball:
            table.unit_box(w, many)
        if not table.rows:  # nothing is known and nothing read: a program needs a row
            table.add(np.ones(1), (0, np.zeros((1, n))))
        table.end("nonnegative")
        if discrete.ball and many:
            table.unit_balls(w, q, many // q)
        if self.start is not None:
            self.start.pose(table, ball=True)
        self._b, self._A, self._cones = table.b(), table.matrix(), table.cones
        self.price, self.entries = CONE, int(self._A.nnz)
        self._solver: ConeSolver | None = None

    def _solved(self, mu: Array) -> tuple[Array, Array, str]:
        """What the solver says of a target; a direction is solved once, whatever its length and sign."""
        unit = mu / (float(np.linalg.norm(mu)) or 1.0)
        for known, (x, y, status) in self._known:
            near = float(known @ unit)
            if abs(near) > SAME:
                return float(np.sign(near)) * x, y, status
        self._known.append((unit, self._freshly(mu)))
        return self._known[-1][1]

    def _freshly(self, mu: Array) -> tuple[Array, Array, str]:
        cost = np.zeros(self._columns)
        size = float(np.linalg.norm(mu))
        n, K = self.discrete.n, len(self.knots)
        if self._stages is not None and size:
            found = self._stages.solve(mu, [np.zeros(np.count_nonzero(measured)) for measured in self.measured], STAGED)
            if found.gap <= STALLED:
                return np.concatenate([found.z.ravel(), *found.u]), np.zeros(0), SOLVED
        if not self._built:
            self._build(self._soft)
        cost[(K - 1) * n : K * n] = -mu / (size or 1.0)
        if self._solver is None:
            self._solver = ConeSolver(self._A, self._cones, tolerance=TOLERANCE, rough=STAGED)
        x, y, status = self._solver.solve(cost, self._b)
        return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64), status

    def reach(self, mu: Array) -> float:
        """About the largest mu'z at the last knot, as the solver says; infinite where the start leaves it free."""
        x, _, status = self._solved(mu)
        if self.start is not None and status == UNBOUNDED:
            return np.inf
        n, K = self.discrete.n, len(self.knots)
        usable = status not in (INFEASIBLE, UNBOUNDED) and np.isfinite(x).all()
        return float(mu @ x[(K - 1) * n : K * n]) if usable else 0.0

    def ends(self) -> Array:
        """Where the responses solved so far are at the last knot (m, n)."""
        n, K = self.discrete.n, len(self.knots)
        usable = [x for _, (x, _, status) in self._known if status not in (INFEASIBLE, UNBOUNDED)]
        ends = np.array([x[(K - 1) * n : K * n] for x in usable]).reshape(-1, n)
        return np.asarray(ends[np.isfinite(ends).all(axis=1)], dtype=np.float64)

    def at_most(self, rows: Array) -> Array:
        """What rows (m, n) of z reach at most at the last knot, by those solved so far; infinite where none tells.

        The largest mu'z is sublinear in mu: at most sum |a_i| times those of mu_i, if mu = sum a_i mu_i.
        """
        n, count = self.discrete.n, len(self._known)
        if n > SPANNED or count < n:
            return np.full(len(rows), np.inf)
        if self._spanned is None or self._spanned[0] != count:
            mu = np.array([known for known, _ in self._known])
            reached = np.array([self.reach(row) for row in mu])
            sets = np.array(list(combinations(range(count), n)))
            sets = sets[np.isfinite(reached[sets]).all(axis=1)]
            sets = sets[np.abs(np.linalg.det(mu[sets])) > INDEPENDENT]
            self._spanned = count, np.linalg.solve(np.swapaxes(mu[sets], 1, 2), np.eye(n)), reached[sets]
        _, shares, sizes = self._spanned
        return np.asarray(np.min(np.einsum("sim,si->sm", np.abs(shares @ rows.T), sizes), axis=0, initial=np.inf))

    def strongest(self, mu: Array) -> DisturbedTrajectory | None:
        """The trajectory with the largest mu'z at the last knot."""
        return self._trajectory(self._solved(mu))

    def least_observable(self, mu: Array, level: float) -> DisturbedTrajectory | None:
        """The trajectory that reaches mu'z >= level at the last knot with the least excess."""
        n, K = self.discrete.n, len(self.knots)
        assert self.excess is not None
        A = self._A.tolil()
        A[self._reach_at, (K - 1) * n : K * n] = -mu / level
        b = self._b.copy()
        b[self._reach_at] = -BEYOND
        cost = np.zeros(self._columns)
        cost[self._slack_at :] = self.excess[self.excess > 0]
        x, y, status = ConeSolver(A.tocsc(), self._cones, tolerance=TOLERANCE).solve(cost, b)
        return self._trajectory((np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64), status))

    def _trajectory(self, solved: tuple[Array, Array, str]) -> DisturbedTrajectory | None:
        """The solver's disturbance simulated from its states, gap by gap, every gap closed by a change of w."""
        x, _, status = solved
        if status in (INFEASIBLE, UNBOUNDED) or not np.isfinite(x).all():
            return None
        discrete, n, q, K = self.discrete, self.discrete.n, self.discrete.G.shape[1], len(self.knots)
        states = x[: n * K].reshape(K, n).copy()
        states[0] = 0.0
        w = []
        for k, (_, blocks, cells) in enumerate(self._gaps):
            u = x[self._w_at[k] : self._w_at[k + 1]]
            left = states[k + 1] - self._gaps[k][0] @ states[k] - blocks @ u
            u = u + np.linalg.lstsq(blocks, left, rcond=1e-10)[0]
            states[k + 1] = self._gaps[k][0] @ states[k] + blocks @ u
            w.append(np.repeat(u.reshape(len(cells), q), cells.astype(int), axis=0))
        steps = np.concatenate(w) if w else np.zeros((0, q))
        return forced_response(discrete, self.knots - self.knots[0], states, steps)


def forced_response(discrete: DiscretePlant, knots: Index, states: Array, w: Array) -> DisturbedTrajectory:
    """Return the path over every step, simulated from each knot to the next."""
    path = np.empty((len(w) + 1, discrete.n))
    F, Gamma = discrete.F, discrete.Gamma
    driven = w @ Gamma.T
    ends = [*knots[1:].tolist(), len(w)]
    path[0] = states[0]
    for k, (a, b) in enumerate(zip(knots.tolist(), ends, strict=True)):
        path[a] = states[k]
        for i in range(a, b):
            path[i + 1] = F @ path[i] + driven[i]
    return DisturbedTrajectory(w, knots, states, path)


def extended(discrete: DiscretePlant, response: DisturbedTrajectory, mu: Array, steps: int) -> DisturbedTrajectory:
    """Continue a response over an open end of so many steps with the w that moves mu'z furthest at its end."""
    if steps == 0:
        return response
    q = discrete.G.shape[1]
    w, row = np.zeros((steps, q)), mu
    for i in range(steps - 1, -1, -1):
        along = row @ discrete.Gamma
        size = float(np.linalg.norm(along))
        w[i] = (along / size if size > 0 else 0.0) if discrete.ball else np.sign(along)
        row = row @ discrete.F
    return forced_response(discrete, response.knots, response.states, np.concatenate([response.w, w]))
