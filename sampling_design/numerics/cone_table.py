"""Rows of a cone program over a window, gathered block by block: b - A x in cones, for a `ConeSolver`.

    x = (..., z_0, ..., z_{K-1}, ..., w, ...),    z_{k+1} = F_k z_k + B_k w_k,    what is measured and what is bounded

Which readings, bounds and starts there are is for the callers to say, in this order of cones: zero, nonnegative, second
order. Rows of thousands of samples go in as one block.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sampling_design.records.arrays import Array, Index

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix


class ConeTable:
    """Entries, right-hand sides and cones."""

    def __init__(self, columns: int):
        self.columns, self.rows, self._ended = columns, 0, 0
        self.cones: list[tuple[str, int]] = []
        self._entries: list[tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], Array]] = []  # as scipy counts
        self._b: list[Array] = []

    def put(self, rows: Index, columns: Index, values: Array) -> None:
        """Entries relative to the next row."""
        shape = np.broadcast(rows, columns, values).shape  # a table has thousands of small ones
        i, j, v = np.empty(shape, np.int32), np.empty(shape, np.int32), np.empty(shape)
        np.add(rows, self.rows, out=i, casting="same_kind")
        j[...], v[...] = columns, values
        self._entries.append((i.ravel(), j.ravel(), v.ravel()))

    def more(self, b: Array) -> int:
        """The rows that the last entries stand in, with their b; where they begin."""
        self._b.append(b)
        self.rows += b.size
        return self.rows - b.size

    def add(self, b: Array, *blocks: tuple[int, Array]) -> int:
        """Rows made of dense blocks, each from a column on; where they begin."""
        for column, X in blocks:
            self.put(np.arange(len(X))[:, None], column + np.arange(X.shape[1]), X)
        return self.more(b)

    def block(self, chosen: Index, columns: Index, values: Array, b: Array) -> int:
        """One row for each of the chosen ones; where they begin."""
        self.put(np.arange(chosen.size)[:, None], columns[chosen], values[chosen])
        return self.more(b[chosen])

    def flow(self, F: Array, B: Array, widths: list[int], z: int, w: int) -> None:
        """z_{k+1} - F_k z_k - B_k w_k = 0 over all gaps: F (K-1, n, n), and B_k side by side, so many columns each."""
        k, i, j = np.arange(len(F))[:, None, None], np.arange(F.shape[1])[:, None], np.arange(F.shape[1])
        n = j.size
        self.put(k * n + i, z + (k + 1) * n + j, np.broadcast_to(np.eye(n), F.shape))
        self.put(k * n + i, z + k * n + j, -F)
        self.put(np.repeat(np.arange(len(F)), widths) * n + i, w + np.arange(B.shape[1]), -B)
        self.more(np.zeros(len(F) * n))

    def box(self, column: int, X: Array, size: Array, y: Array | float = 0.0) -> int:
        """|y - X x| <= size, entry by entry: first X x <= size + y, then -X x <= size - y; where they begin."""
        return self.add(np.concatenate([size + y, size - y]), (column, np.vstack([X, -X])))

    def ball(self, column: int, X: Array, y: Array | float = 0.0) -> int:
        """|y - X x| <= 1 in the Euclidean norm, a cone of its own; where it begins."""
        at = self.add(np.append(1.0, np.zeros(len(X)) + y), (column, np.vstack([np.zeros((1, X.shape[1])), X])))
        self.end("second order")
        return at

    def unit_box(self, column: int, count: int) -> int:
        """|x_j| <= 1 for so many columns; where the rows begin."""
        many = np.arange(count)
        self.put(np.concatenate([many, many + count]), np.tile(column + many, 2), np.repeat([1.0, -1.0], count))
        return self.more(np.ones(2 * count))

    def unit_balls(self, column: int, size: int, count: int) -> int:
        """Every `size` columns lie in the unit ball, `count` times: cones of their own; where they begin."""
        many = np.arange(size * count)
        self.put(many // max(size, 1) * (size + 1) + 1 + many % max(size, 1), column + many, np.ones(many.size))
        at = self.more(np.tile(np.eye(size + 1)[0], count))
        self.ends("second order", size + 1, count)
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
