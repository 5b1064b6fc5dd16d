"""The program of one record as a solver takes it: b - A x in cones, x = (start, states at the times, w on cells)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from sampling_design.accuracy.bounds import EXACT
from sampling_design.accuracy.finite import DIFFUSE
from sampling_design.accuracy.gap_table import RecordGap
from sampling_design.accuracy.readings import Readings
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.conic_programs import INFEASIBLE, UNBOUNDED, ConeSolver
from sampling_design.numerics.filtering import covariance_root, root_update, triangle
from sampling_design.records.arrays import Array

BEYOND = 1e75  # a deviation that grows beyond it is as good as infinite: its square would overflow in what follows
UNKNOWN = 1e-3  # the deviation of a state whose start is exactly known
LEAST = 1e-12  # eigenvalues of a correlation matrix count as so large at least, in the choice of coordinates


class RecordScaling:
    """Units of rows and coordinates of states in which a solver takes a record: nothing that is proven rests on them.

    `gaps`, `F` and `H` are in D coordinates.
    """

    def __init__(self, readings: Readings, gaps: Sequence[RecordGap], F: Array, D: Array, H: Array):
        self.readings, self.gaps, self.F, self.D, self.H = readings, gaps, F, D, H

    @cached_property
    def _noise(self) -> Array:
        """(K-1, n, n) what w does over each gap: the sum over its cells of their squares."""
        cells, n = [gap.cells(0) for gap in self.gaps], len(self.D)
        return np.array([np.einsum("mnq,mkq->nk", own, own) for own in cells]).reshape(len(cells), n, n)

    @cached_property
    def driven(self) -> Array:
        """(R,) what w does to each row over a gap, or its own size if that is nothing."""
        driven, size = np.zeros(len(self.H)), np.linalg.norm(self.H, axis=1)
        if len(self._noise):
            driven = np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", self.H, self._noise.mean(axis=0), self.H), 0.0))
        return np.where(driven > 0, driven, np.where(size > 0, size, 1.0))

    @cached_property
    def unit(self) -> Array:
        """(R,) the size of the noise of each row, or what stands for it."""
        read, stand_in = self.readings, self.driven
        stand_in = np.where(read.below, np.maximum(stand_in, read.size), EXACT * stand_in)
        return np.where((read.size > 0) & ~read.below, read.size, stand_in)

    @cached_property
    def filter(self) -> tuple[Array, Array]:
        """Gains (R, n) of the filter with the bounds as deviations, roots (K, n, n) of its covariances.

        Roots, since exact rows leave less of a state than the rounding of a difference of covariances.
        """
        read, n, D = self.readings, len(self.D), self.D
        root = np.eye(n) * math.sqrt(DIFFUSE)
        if not read.start.unbounded:
            root = np.zeros((n, n))
            root[: len(read.start.root), : read.start.root.shape[1]] = read.start.root
            root = root / D[:, None]
            root = np.hstack([root, np.diag(np.where(root.any(axis=1), 0.0, UNKNOWN))])
        H = np.where(read.below[:, None], 0.0, self.H / self.unit[:, None])
        gains, roots = np.zeros((len(H), n)), np.zeros((len(read.times), n, n))
        for k, (a, b) in enumerate(zip(read.offsets[:-1], read.offsets[1:], strict=True)):
            if k:
                with np.errstate(over="ignore", invalid="ignore"):
                    root = np.hstack([self.F[k - 1] @ root, covariance_root(self._noise[k - 1])])
                if not np.abs(root).max(initial=0.0) < BEYOND:  # as good as nothing is known of what was before
                    root = np.eye(n) * BEYOND
            if b > a:
                root, K, _ = root_update(root, H[a:b], np.eye(b - a))
                gains[a:b] = K.T
            roots[k] = root = triangle(root)
        return gains, roots

    @cached_property
    def L(self) -> Array:
        """(K, n, n) coordinates x = D L z of each time in which what is possible is of size one: roots of covariances.

        Where nothing drives a state that decays, those of one time would make it as large as it has decayed by then.
        """
        roots = self.filter[1]
        size = np.maximum(np.linalg.norm(roots, axis=2), math.sqrt(np.finfo(float).tiny))
        vectors, values, _ = np.linalg.svd(roots / size[:, :, None])
        least = math.sqrt(LEAST * roots.shape[1])
        return np.asarray(size[:, :, None] * vectors * np.maximum(values, least)[:, None, :])


class RecordCones:
    """States count as x = path + D L z, each time with its L; residuals from `path`; `H` and `path` in D coordinates.

    Attributes
    ----------
    columns : int
    b : (m,) array
    solver : ConeSolver
    """

    def __init__(
        self,
        readings: Readings,
        path: Array,
        F: Array,
        cells: list[Array],
        D: Array,
        L: Array,
        H: Array,
        unit: Array,
        tolerance: float,
    ):
        self._readings, self._unit = readings, unit
        self._residuals = readings.residuals - np.einsum("rn,rn->r", H, path[readings.nodes])
        self._K, self._n, self._q = len(readings.times), len(D), readings.G.shape[1]
        root = readings.start.root
        self._starts = 0 if readings.start.unbounded else root.shape[1]
        self._cells = int(sum(len(own) for own in cells))
        self._w_at = self._starts + self._K * self._n
        self.columns = self._w_at + self._q * self._cells
        self._grown: list[tuple[int, Array, str]] = []  # rows of b that are bounds, and whose
        self._kinds()
        table = ConeTable(self.columns)
        with np.errstate(over="ignore", invalid="ignore"):  # a flow may overflow: no solver takes it, and no bound is
            self._flow(table, np.asarray(np.linalg.solve(L[1:], F @ L[:-1])), cells, L)
        if not readings.start.unbounded:
            longer = np.zeros((self._n, self._starts))
            longer[: len(root)] = root
            turned = -np.asarray(np.linalg.solve(L[0], longer / D[:, None]))
            table.add(-np.asarray(np.linalg.solve(L[0], path[0])), (self._starts, np.eye(self._n)), (0, turned))
        self._pose_readings(table, np.einsum("rn,rnm->rm", H, L[readings.nodes]) / unit[:, None])
        self.b, self._A, self._cones = table.b(), table.matrix(), table.cones
        interior = not self._exact.size  # without one the last digits of every step count
        self.solver = ConeSolver(self._A, self._cones, tolerance=tolerance, scaled=interior)

    def state(self, k: int) -> slice:
        """Return the columns of the state at a time."""
        return slice(self._starts + k * self._n, self._starts + (k + 1) * self._n)

    def _kinds(self) -> None:
        """Which rows are exact, two-sided one by one, one-sided, or two-sided together."""
        read = self._readings
        self._below = np.flatnonzero(read.below)
        self._exact = np.flatnonzero(~read.below & (read.size == 0))
        noisy = ~read.below & (read.size > 0)
        many = np.bincount(read.nodes[noisy], minlength=self._K)[read.nodes] > 1
        together = noisy & many if read.ball else np.zeros_like(noisy)
        self._boxed = np.flatnonzero(noisy & ~together)
        at = np.flatnonzero(together)
        self._groups = np.split(at, np.flatnonzero(np.diff(read.nodes[at])) + 1) if at.size else []

    def _flow(self, table: ConeTable, F: Array, cells: list[Array], L: Array) -> None:
        """z_{k+1} - F_k z_k - sum over the gap's cells of (int e^{As}G) w = 0."""
        turned = [np.linalg.solve(own, np.hstack(list(gap))) for own, gap in zip(L[1:], cells, strict=True)]
        moved = np.hstack([np.zeros((self._n, 0)), *turned])
        table.flow(F, moved, [len(own) * self._q for own in cells], self._starts, self._w_at)

    def _pose_readings(self, table: ConeTable, H: Array) -> None:
        """Readings and bounds: first what is exact, then what is linear, then what is round."""
        read = self._readings
        y, size = self._residuals / self._unit, read.size / self._unit
        columns = self._starts + read.nodes[:, None] * self._n + np.arange(self._n)
        self._exact_at = table.block(self._exact, columns, H, y)
        table.end("zero")
        if self._starts and not read.start.ball:
            self._grown.append((table.unit_box(0, self._starts), np.ones(2 * self._starts), "start"))
        self._up = table.block(self._boxed, columns, H, y + size)
        self._down = table.block(self._boxed, columns, -H, size - y)
        self._below_at = table.block(self._below, columns, H, y + size)
        for at, rows in ((self._up, self._boxed), (self._down, self._boxed), (self._below_at, self._below)):
            self._grown.append((at, size[rows], "v"))
        if not read.disturbance.ball:
            count = self._q * self._cells
            self._grown.append((table.unit_box(self._w_at, count), np.ones(2 * count), "w"))
        table.end("nonnegative")
        self._rounds = []
        for chosen in self._groups:
            self._rounds.append((table.ball(int(columns[chosen[0], 0]), H[chosen], y[chosen]), chosen))
            self._grown.append((self._rounds[-1][0], np.ones(1), "v"))
        if self._starts and read.start.ball:
            self._grown.append((table.unit_balls(0, self._starts, 1), np.ones(1), "start"))
        if read.disturbance.ball and self._q:
            heads = np.tile(np.eye(self._q + 1)[0], self._cells)
            self._grown.append((table.unit_balls(self._w_at, self._q, self._cells), heads, "w"))

    def read(self, y: Array) -> tuple[Array, Array]:
        """Return gains of the rows in plain units, and multipliers (K-1, n) of the gaps, from those of all cones."""
        gains, m = np.zeros(len(self._unit)), self._boxed.size
        gains[self._exact] = y[self._exact_at : self._exact_at + self._exact.size]
        gains[self._boxed] = y[self._up : self._up + m] - y[self._down : self._down + m]
        gains[self._below] = np.maximum(y[self._below_at : self._below_at + self._below.size], 0.0)
        for at, chosen in self._rounds:
            gains[chosen] = y[at + 1 : at + 1 + len(chosen)]
        return gains / self._unit, y[: (self._K - 1) * self._n].reshape(-1, self._n)

    def _sizes(self, which: str) -> Array:
        """What b gains when some bounds grow by their own size."""
        growth = np.zeros(len(self.b))
        for at, sizes, whose in self._grown:
            if which in ("all", whose):
                growth[at : at + sizes.size] += sizes
        return growth

    def loosened(self, multiple: float) -> Array:
        """b for bounds so many times as large."""
        return np.asarray(self.b + (multiple - 1.0) * self._sizes("all"))

    def centred(self) -> Array:
        """b as if readings were those of `path`, and the start were about it: what is possible then is never empty.

        Its gains leave no record more than the worst one: it is symmetric, but for readings below a limit.
        """
        b, below = self._sizes("all"), slice(self._below_at, self._below_at + self._below.size)
        b[below] = np.maximum(self.b[below], b[below])
        return b

    def grown(self, which: str) -> tuple[Array | None, float]:
        """Return the least multiple of some bounds under which something is possible, and its multipliers first.

        Where no multiple suffices the multipliers are a ray; None where the solver brought nothing.
        """
        from scipy import sparse

        column = self._sizes(which)
        b = self.b - column
        A = sparse.hstack([self._A, sparse.csc_matrix(-column[:, None])])
        cost = np.zeros(self.columns + 1)
        cost[-1] = 1.0
        x, y, status = ConeSolver(sparse.csc_matrix(A), self._cones).solve(cost, b)
        if status == UNBOUNDED or not np.isfinite(y).all():
            return None, np.inf
        return np.asarray(y, dtype=np.float64), np.inf if status == INFEASIBLE else max(float(x[-1]), 0.0)
