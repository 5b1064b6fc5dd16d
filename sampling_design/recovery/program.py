"""The adversary's program over one window of samples, and what its two sides prove without the solver.

    maximise  mu'z_K   over w constant on cells, subject to  z_{k+1} = F z_k + sum Gamma w,  |w| <= 1,  |H z_k| <= 1

It is posed once per window; targets mu change its cost only. Its multipliers are gains, its point is an adversary; both
are evaluated anew: `upper` for any gains and all real times, `lower` for an adversary scaled until it is admissible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design._conic import INFEASIBLE, UNBOUNDED, ConeSolver
from sampling_design.recovery.chain import SampleChain
from sampling_design.recovery.gains import ROUNDING, Gains, cleared, evaluated
from sampling_design.recovery.start import StartSet

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-8
"""Asked of the solver; what it leaves open shows in the bracket, never in a bound."""

EXACTLY = 1e-6
"""An exact sensor shows zero within this many of its stand-in units: 1e-12 of what w does to it over a period."""


@dataclass(frozen=True, eq=False)
class Adversary:
    """An admissible w with all y = 0: cells per gap, and the state at the last sample."""

    value: float
    w: tuple[Array, ...]  # (m, q) per gap, in units of the bound, latest cell first
    z: Array  # (K, n)


class _ConeRows:
    """Rows of b - A x in a cone, gathered block by block: zero first, then nonnegative, then second order."""

    def __init__(self, columns: int):
        self.columns, self.rows = columns, 0
        self._entries: list[tuple[Array, npt.NDArray[np.intp], npt.NDArray[np.intp]]] = []
        self._b: list[Array] = []
        self._cones: list[tuple[str, int]] = []
        self._ended = 0

    def _block(self, row: int, column: int, X: Array) -> None:
        i, j = np.indices(X.shape)
        self._entries.append((X.ravel(), (i + row).ravel(), (j + column).ravel()))

    def add(self, kind: str, count: int, parts: list[tuple[int, Array]], b: Array | None = None) -> int:
        """Append rows made of blocks; where they begin."""
        at = self.rows
        for column, X in parts:
            self._block(at, column, X)
        self._b.append(np.zeros(count) if b is None else b)
        self.rows += count
        if kind == "second order":
            self._cones.append((kind, count))
        return at

    def end(self, kind: str) -> None:
        """Close the rows since the last end as one cone."""
        if self.rows > self._ended:
            self._cones.append((kind, self.rows - self._ended))
        self._ended = self.rows

    def box(self, column: int, X: Array, size: Array | None = None) -> int:
        """|X x| <= size (default 1), entry by entry: first X x <= size, then -X x <= size."""
        size = np.ones(len(X)) if size is None else size
        at = self.add("nonnegative", len(X), [(column, X)], size)
        self.add("nonnegative", len(X), [(column, -X)], size)
        return at

    def ball(self, column: int, X: Array) -> int:
        """|X x| <= 1 in the Euclidean norm."""
        stacked = np.vstack([np.zeros((1, X.shape[1])), -X])
        return self.add("second order", len(stacked), [(column, stacked)], np.eye(len(stacked))[0])

    def diagonal_box(self, column: int) -> None:
        """|x_j| <= 1 for every entry from a column on."""
        many = np.arange(self.columns - column)
        for sign in (1.0, -1.0):
            self._entries.append((np.full(many.size, sign), many + self.rows, many + column))
            self.add("nonnegative", many.size, [], np.ones(many.size))

    def diagonal_balls(self, column: int, q: int) -> None:
        """Every q entries from a column on lie in the unit ball."""
        many = np.arange(self.columns - column)
        self._entries.append((np.full(many.size, -1.0), self.rows + many // q * (q + 1) + 1 + many % q, many + column))
        for _ in range(many.size // q if q else 0):
            self.add("second order", q + 1, [], np.eye(q + 1)[0])

    def solver(self, tolerance: float) -> tuple[Array, ConeSolver]:
        """b, and the solver with A."""
        from scipy import sparse

        values, rows, columns = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        self.A = sparse.csc_matrix((values, (rows, columns)), shape=(self.rows, self.columns))
        self.A.eliminate_zeros()
        return np.concatenate(self._b), ConeSolver(self.A, self._cones, tolerance=tolerance)

    def scaled(self, change: Array) -> ConeSolver:
        """The solver with one more column: b + scale change in place of b."""
        from scipy import sparse

        return ConeSolver(
            sparse.hstack([self.A, sparse.csc_matrix(-change[:, None])]), self._cones, tolerance=TOLERANCE
        )


class ConeWindow:
    """Samples `nodes` of a chain, the target's last; `start`: bounds on |z| before the first, or a set of them.

    `data` are the measurements less what they would be without error, one array for each sample, in units of its noise.
    """

    def __init__(
        self,
        chain: SampleChain,
        nodes: list[int],
        start: Array | StartSet,
        data: list[Array] | None = None,
        tolerance: float = TOLERANCE,
    ):
        self.chain, self.nodes, self.start, self.data = chain, nodes, start, data
        self._tolerance = tolerance
        self.infeasible = False
        self._build()

    def _build(self) -> None:
        chain, n, q = self.chain, self.chain.D.size, self.chain.G.shape[1]
        K = len(self.nodes)
        gaps, samples = [chain.gaps[j] for j in self.nodes[:-1]], [chain.samples[j] for j in self.nodes]
        self._w_at = K * n + q * np.concatenate([[0], np.cumsum([len(g.cells) for g in gaps])]).astype(int)
        table = _ConeRows(int(self._w_at[-1]))
        for k, gap in enumerate(gaps):
            flat = np.swapaxes(gap.cells, 0, 1).reshape(n, -1)
            parts = [((k + 1) * n, np.eye(n)), (k * n, -gap.F), (int(self._w_at[k]), -flat)]
            table.add("zero", n, parts)
        exact = [s.H[s.exact] for s in samples]
        self._exact_at = [table.add("zero", len(H), [(k * n, H)]) for k, H in enumerate(exact)]
        table.end("zero")
        ball = isinstance(self.start, StartSet) and self.start.ball
        if isinstance(self.start, StartSet) and not ball and self.start.S is not None:
            table.box(0, self.start.S)
        elif not isinstance(self.start, StartSet):
            table.box(0, np.eye(n), self.start)
        noisy = [s.H[~s.exact] for s in samples]
        round_v = [chain.bounds.v_ball and len(H) > 1 for H in noisy]
        self._box_at = [-1 if r else table.box(k * n, H) for k, (H, r) in enumerate(zip(noisy, round_v, strict=True))]
        if not chain.bounds.w_ball:
            table.diagonal_box(K * n)
        table.end("nonnegative")
        self._ball_at = [table.ball(k * n, H) if r else -1 for k, (H, r) in enumerate(zip(noisy, round_v, strict=True))]
        if isinstance(self.start, StartSet) and self.start.S is not None and ball:
            table.ball(0, self.start.S)
        if chain.bounds.w_ball:
            table.diagonal_balls(K * n, q)
        self._b, self._solver = table.solver(self._tolerance)
        self._table, self._bare = table, self._b.copy()
        if self.data is not None:
            self._shift(self.data)

    def _shift(self, data: list[Array]) -> None:
        """|H z| <= 1 becomes |y - H z| <= 1."""
        for k, y in enumerate(data):
            exact = self.chain.samples[self.nodes[k]].exact
            noisy = y[~exact]
            self._b[self._exact_at[k] : self._exact_at[k] + int(exact.sum())] = y[exact]
            if self._ball_at[k] >= 0:
                self._b[self._ball_at[k] + 1 : self._ball_at[k] + 1 + noisy.size] = -noisy
            elif noisy.size:
                at = self._box_at[k]
                self._b[at : at + 2 * noisy.size] += np.concatenate([noisy, -noisy])

    def _solved(self, mu: Array) -> tuple[Array, Array]:
        """Point and multipliers for the target mu'z_K, unchecked; zeros where the solver brought none."""
        n, K, size = mu.size, len(self.nodes), float(np.linalg.norm(mu))
        cost = np.zeros(int(self._w_at[-1]))
        if size == 0:
            return cost, np.zeros(self._b.size)
        cost[(K - 1) * n : K * n] = -mu / size
        x, y, status = self._solver.solve(cost, self._b)
        self.infeasible = status == INFEASIBLE
        if status in (INFEASIBLE, UNBOUNDED) or not (np.isfinite(x).all() and np.isfinite(y).all()):
            return 0 * cost, np.zeros(self._b.size)
        return np.asarray(x, dtype=np.float64), np.asarray(y * size, dtype=np.float64)

    def gains(self, mu: Array) -> Gains:
        """Return the best gains for the target mu'z_K, with what they prove."""
        return self.upper(mu, self._steadied(mu, self._solved(mu)[1]))

    def both(self, mu: Array) -> tuple[Gains, Adversary]:
        """Return both sides for the target mu'z_K, each evaluated without the solver."""
        x, y = self._solved(mu)
        return self.upper(mu, self._steadied(mu, y)), self._admissible(mu, x)

    def least_scale(self) -> list[Array]:
        """Return the gains that prove best by how much the data exceed what the bounds allow."""
        solver = self._table.scaled(self._b - self._bare)
        _, y, status = solver.solve(np.append(np.zeros(int(self._w_at[-1])), -1.0), self._bare)
        if status in (INFEASIBLE, UNBOUNDED) or not np.isfinite(y).all():
            y = np.zeros(self._b.size)
        return self._steadied(np.zeros(self.chain.D.size), np.asarray(y, dtype=np.float64))

    def _nothing(self) -> Adversary:
        chain = self.chain
        w = tuple(np.zeros(chain.gaps[j].cells.shape[::2]) for j in self.nodes[:-1])
        return Adversary(0.0, w, np.zeros((len(self.nodes), chain.D.size)))

    def _gains(self, y: Array) -> list[Array]:
        """Gains from the multipliers of the noise cones."""
        found = []
        for k, j in enumerate(self.nodes):
            sample = self.chain.samples[j]
            gains, noisy = np.zeros(len(sample.H)), int(np.sum(~sample.exact))
            if self._exact_at[k] >= 0:
                gains[sample.exact] = y[self._exact_at[k] : self._exact_at[k] + len(gains) - noisy]
            if self._box_at[k] >= 0:
                at = self._box_at[k]
                gains[~sample.exact] = y[at : at + noisy] - y[at + noisy : at + 2 * noisy]
            elif self._ball_at[k] >= 0:
                gains[~sample.exact] = -y[self._ball_at[k] + 1 : self._ball_at[k] + 1 + noisy]
            found.append(gains)
        return found

    def _steadied(self, mu: Array, y: Array) -> list[Array]:
        """The solver's gains, corrected by the filter's wherever its costate and the true one part.

        The costate runs backwards through a plant that may grow: without the correction the solver's last digits would.
        """
        n, chain, raw = mu.size, self.chain, self._gains(y)
        ahead = y[: (len(self.nodes) - 1) * n].reshape(-1, n)
        gains: list[Array] = [np.zeros(0)] * len(raw)
        true, meant = mu, mu
        for k in range(len(raw) - 1, -1, -1):
            sample = chain.samples[self.nodes[k]]
            gains[k] = raw[k] + sample.K.T @ (true - meant)
            if k:
                F = chain.gaps[self.nodes[k - 1]].F
                true, meant = F.T @ (true - sample.H.T @ gains[k]), F.T @ ahead[k - 1]
        if isinstance(self.start, StartSet) and self.start.rows < mu.size:
            cleared(self.chain, self.nodes, self.start, mu, gains)
        return gains

    def upper(self, mu: Array, gains: list[Array]) -> Gains:
        """Return what any gains prove, for all real times."""
        return evaluated(self.chain, self.nodes, self.start, mu, gains, self.data)

    def _admissible(self, mu: Array, x: Array) -> Adversary:
        """The solver's disturbance, flown from its start (0 unless that is a set) and scaled until admissible."""
        chain, n, K = self.chain, mu.size, len(self.nodes)
        meant = x[: K * n].reshape(K, n)
        best = self._nothing()
        for corrected in (False, True):
            z, w = np.zeros((K, n)), []
            z[0] = chain.opening(meant[0]) if isinstance(self.start, StartSet) else 0.0
            for k, j in enumerate(self.nodes[:-1]):
                gap, q = chain.gaps[j], chain.G.shape[1]
                u = x[self._w_at[k] : self._w_at[k + 1]].reshape(-1, q)
                z[k + 1] = gap.F @ z[k] + np.einsum("mnq,mq->n", gap.cells, u)
                if corrected:
                    flat = np.swapaxes(gap.cells, 0, 1).reshape(n, -1)
                    extra = np.linalg.lstsq(flat, meant[k + 1] - z[k + 1], rcond=1e-9)[0]
                    u = u + extra.reshape(-1, q)
                    z[k + 1] += flat @ extra
                w.append(u)
            factor = self._excess(z, w)
            found = Adversary(float(mu @ z[-1]) / factor, tuple(u / factor for u in w), z / factor)
            if np.isfinite(factor) and found.value > best.value:
                best = found
        return best

    def _excess(self, z: Array, w: list[Array]) -> float:
        """Least factor by which bounds must grow for this trajectory, at least 1."""
        chain, factor = self.chain, 1.0
        if isinstance(self.start, StartSet):
            factor = max(factor, self.start.excess(z[0]))
        for u in w:
            size = np.linalg.norm(u, axis=1) if chain.bounds.w_ball else np.abs(u)
            factor = max(factor, float(np.max(size, initial=0.0)))
        for k, j in enumerate(self.nodes):
            sample = chain.samples[j]
            y = np.abs(sample.H @ z[k])
            noisy = y[~sample.exact]
            if chain.bounds.v_ball and noisy.size:
                factor = max(factor, float(np.linalg.norm(noisy)))
            factor = max(
                factor, float(np.max(noisy, initial=0.0)), float(np.max(y[sample.exact], initial=0.0)) / EXACTLY
            )
        return factor * (1 + ROUNDING)
