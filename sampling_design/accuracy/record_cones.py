"""The program of one record as a solver takes it: b - A x in cones, x = (start, states at the times, w on cells)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import Readings
from sampling_design.numerics.conic_programs import INFEASIBLE, UNBOUNDED, ConeSolver

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


class RecordCones:
    """States count as x = path + D L z, readings (`shown`) from `path`; `H` and `path` in D coordinates, in `unit`.

    Attributes
    ----------
    columns : int
    last : slice
        The columns of the state at the last time.
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
        self._shown = readings.shown - np.einsum("rn,rn->r", H, path[readings.nodes])
        self._K, self._n, self._q = len(readings.times), len(D), readings.G.shape[1]
        root = readings.start.root
        self._starts = 0 if root is None else root.shape[1]
        self._cells = int(sum(len(own) for own in cells))
        self._w_at = self._starts + self._K * self._n
        self.columns = self._w_at + self._q * self._cells
        self.last = slice(self._w_at - self._n, self._w_at)
        self._grown: list[tuple[int, Array, str]] = []  # rows of b that are bounds, and whose
        self._found: dict[str, tuple[Array | None, float]] = {}
        self._kinds()
        table = ConeTable(self.columns)
        with np.errstate(over="ignore", invalid="ignore"):  # a flow may overflow: no solver takes it, and no bound is
            self._dynamics(table, np.asarray(np.linalg.solve(L, F @ L)), cells, L)
        if root is not None:
            longer = np.zeros((self._n, self._starts))
            longer[: len(root)] = root
            i = np.arange(self._n)[:, None]
            table.put(i, self._starts + i.T, np.eye(self._n))
            table.put(i, np.arange(self._starts), -np.asarray(np.linalg.solve(L, longer / D[:, None])))
            table.more(-np.asarray(np.linalg.solve(L, path[0])))
        self._seen(table, np.asarray(H @ L / unit[:, None]))
        self.b, self._A, self._cones = table.b(), table.matrix(), table.cones
        interior = not self._exact.size  # without one the last digits of every step count
        self.solver = ConeSolver(self._A, self._cones, tolerance=tolerance, scaled=interior)

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

    def _dynamics(self, table: ConeTable, F: Array, cells: list[Array], L: Array) -> None:
        """z_{k+1} - F_k z_k - sum over the gap's cells of (int e^{As}G) w = 0."""
        n, q, z = self._n, self._q, self._starts
        joined = np.concatenate([np.zeros((0, n, q)), *cells])
        moved = np.asarray(np.linalg.solve(L, np.swapaxes(joined, 0, 1).reshape(n, -1)))
        moved = moved.reshape(n, -1, q).swapaxes(0, 1)
        owner = np.repeat(np.arange(self._K - 1), [len(own) for own in cells])[:, None, None]
        k, i, j = np.arange(self._K - 1)[:, None, None], np.arange(n)[:, None], np.arange(n)
        table.put(k * n + i, z + (k + 1) * n + j, np.broadcast_to(np.eye(n), F.shape))
        table.put(k * n + i, z + k * n + j, -F)
        m = np.arange(len(joined))[:, None, None]
        table.put(owner * n + i, self._w_at + m * q + np.arange(q), -moved)
        table.more(np.zeros((self._K - 1) * n))

    def _seen(self, table: ConeTable, H: Array) -> None:
        """Readings and bounds: first what is exact, then what is linear, then what is round."""
        read = self._readings
        y, size = self._shown / self._unit, read.size / self._unit
        columns = self._starts + read.nodes[:, None] * self._n + np.arange(self._n)
        self._exact_at = table.block(self._exact, columns, H, y)
        table.end("zero")
        if self._starts and not read.start.ball:
            self._box(table, 0, self._starts, "start")
        self._up = table.block(self._boxed, columns, H, y + size)
        self._down = table.block(self._boxed, columns, -H, size - y)
        self._below_at = table.block(self._below, columns, H, y + size)
        for at, rows in ((self._up, self._boxed), (self._down, self._boxed), (self._below_at, self._below)):
            self._grown.append((at, size[rows], "v"))
        if not read.push.ball:
            self._box(table, self._w_at, self._q * self._cells, "w")
        table.end("nonnegative")
        self._rounds = []
        for chosen in self._groups:
            self._rounds.append((table.rows, chosen))
            self._grown.append((table.rows, np.ones(1), "v"))
            table.put(np.arange(1, len(chosen) + 1)[:, None], columns[chosen], H[chosen])
            table.more(np.concatenate([[1.0], y[chosen]]))
            table.end("second order")
        if self._starts and read.start.ball:
            self._balls(table, 0, self._starts, 1, "start")
        if read.push.ball and self._q:
            self._balls(table, self._w_at, self._q, self._cells, "w")

    def _box(self, table: ConeTable, column: int, count: int, whose: str) -> None:
        """|x_j| <= 1 for some columns."""
        many, one = np.arange(count)[:, None], np.ones(count)
        for sign in (1.0, -1.0):
            self._grown.append((table.rows, one, whose))
            table.put(many, column + many, sign * one[:, None])
            table.more(one)

    def _balls(self, table: ConeTable, column: int, size: int, count: int, whose: str) -> None:
        """Every `size` columns lie in the unit ball."""
        heads, many = np.tile(np.eye(size + 1)[0], count), np.arange(size * count)[:, None]
        self._grown.append((table.rows, heads, whose))
        table.put(many // size * (size + 1) + 1 + many % size, column + many, np.ones((many.size, 1)))
        table.more(heads)
        table.ends("second order", size + 1, count)

    def read(self, y: Array) -> tuple[Array, Array]:
        """Return gains of the rows in plain units, and multipliers (K-1, n) of the gaps, from those of all cones."""
        found, m = np.zeros(len(self._unit)), self._boxed.size
        found[self._exact] = y[self._exact_at : self._exact_at + self._exact.size]
        found[self._boxed] = y[self._up : self._up + m] - y[self._down : self._down + m]
        found[self._below] = np.maximum(y[self._below_at : self._below_at + self._below.size], 0.0)
        for at, chosen in self._rounds:
            found[chosen] = y[at + 1 : at + 1 + len(chosen)]
        return found / self._unit, y[: (self._K - 1) * self._n].reshape(-1, self._n)

    def _sizes(self, which: str) -> Array:
        """What b gains when some bounds grow by their own size."""
        found = np.zeros(len(self.b))
        for at, sizes, whose in self._grown:
            if which in ("all", whose):
                found[at : at + sizes.size] += sizes
        return found

    def loosened(self, multiple: float) -> Array:
        """b for bounds so many times as large."""
        return np.asarray(self.b + (multiple - 1.0) * self._sizes("all"))

    def grown(self, which: str) -> tuple[Array | None, float]:
        """Return the least multiple of some bounds under which something is possible, and its multipliers first.

        Where no multiple suffices the multipliers are a ray; None where the solver brought nothing. What was found is
        kept.
        """
        if which not in self._found:
            self._found[which] = self._least(which)
        return self._found[which]

    def _least(self, which: str) -> tuple[Array | None, float]:
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


class ConeTable:
    """Entries, right-hand sides and cones, gathered block by block."""

    def __init__(self, columns: int):
        self.columns, self.rows, self._ended = columns, 0, 0
        self.cones: list[tuple[str, int]] = []
        self._entries: list[tuple[Index, Index, Array]] = []
        self._b: list[Array] = []

    def put(self, rows: Index, columns: Index, values: Array) -> None:
        """Entries relative to the next row."""
        i, j, v = np.broadcast_arrays(rows + self.rows, columns, values)
        self._entries.append((i.ravel(), j.ravel(), v.ravel()))

    def more(self, b: Array) -> None:
        """The rows that the last entries stand in, with their b."""
        self._b.append(b)
        self.rows += b.size

    def block(self, chosen: Index, columns: Index, values: Array, b: Array) -> int:
        """One row for each of the chosen ones; where they begin."""
        at = self.rows
        self.put(np.arange(chosen.size)[:, None], columns[chosen], values[chosen])
        self.more(b[chosen])
        return at

    def end(self, kind: str) -> None:
        """Close the rows since the last end as one cone."""
        self.ends(kind, self.rows - self._ended, 1)

    def ends(self, kind: str, size: int, count: int) -> None:
        """Close them as several of one size."""
        if self.rows > self._ended:
            self.cones += [(kind, size)] * count
        self._ended = self.rows

    def b(self) -> Array:
        """Right-hand side."""
        return np.concatenate(self._b)

    def matrix(self) -> csc_matrix:
        """A, with the sign of b - A x."""
        from scipy import sparse

        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        A = sparse.csc_matrix((values, (rows, columns)), shape=(self.rows, self.columns))
        A.eliminate_zeros()
        return A
