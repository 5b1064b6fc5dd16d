"""Grid tables for the sphere: Gram matrices of the rows at grid times, and how far time can bend between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.observability.worst_case.spaced_rows import SpacedRows

Array = npt.NDArray[np.float64]
_EPS = float(np.finfo(float).eps)
_NUMBERS = 12_000_000  # most numbers in one table


class SlackTable(NamedTuple):
    """What a grid of N + 1 slacks holds for each of the k samples.

    With vec the upper triangle of a symmetric matrix, off-diagonal entries doubled, so that
    vec(G) . triangle(X) = <G, X>:

    gram : (k, N + 3, q) array
        vec G(t), one repeated point at either end.
    bend : (k, N + 3, q) array
        vec (h^2/8) G''(t), likewise.
    beyond : (k, N + 1) array
        (h^2/8)(h^2/8) times a proven bound on |G''''| within h of each point.
    blur : (k, N + 1) array
        What rounding in the exponentials can take from x'Gx, |x| = 1, beyond the part `forgiven` of it.
    rounding : (k, N + 1) array
        Of <G, X> and of its place in a sum of k, for |X| = 1.
    """

    gram: Array
    bend: Array
    beyond: Array
    blur: Array
    rounding: Array


class Tables:
    """Tables in the coordinates x = L z, made when asked for and kept.

    Rows y + e with |e| <= delta have |y + e|^2 >= (1 - g) |y|^2 - delta^2/g for every g in (0, 1). `forgiven`
    is g: the caller takes this part off every bound, and delta^2/g stands in the tables as `blur`.
    """

    def __init__(self, rows: SpacedRows, worst: Array, forgiven: float) -> None:
        self.rows, self.forgiven = rows, forgiven
        self.basis, inverse = rows.coordinates(worst)
        self.upper = np.triu_indices(rows.n)
        self.weight = np.where(self.upper[0] == self.upper[1], 1.0, 2.0)
        inner = inverse @ rows.A @ self.basis
        self.speed = float(np.linalg.norm(inner, 2))
        # the logarithmic norm bounds |e^{+-A t}| far better than the norm: oscillators hardly grow
        self.growth = max(0.0, float(np.abs(np.linalg.eigvalsh((inner + inner.T) / 2)).max(initial=0.0)))
        self.most_cells = max(2, _NUMBERS // (2 * rows.count * self.weight.size))
        self._kept: dict[int, SlackTable] = {}

    def triangle(self, X: Array) -> Array:
        """Upper triangles (..., q) of symmetric matrices (..., n, n)."""
        return X[..., self.upper[0], self.upper[1]]

    def first_cells(self) -> int:
        """A power of two of cells on which the plant turns by no more than half a radian."""
        wanted = 2 ** np.ceil(np.log2(max(2 * self.speed * self.rows.slack, 16.0)))
        return int(min(wanted, 2 ** np.floor(np.log2(self.most_cells))))

    def at(self, cells: int) -> SlackTable:
        """The table of a grid of `cells` cells."""
        if cells not in self._kept:
            self._kept[cells] = self._made(cells)
        return self._kept[cells]

    def _made(self, cells: int) -> SlackTable:
        rows = self.rows
        h = rows.slack / cells
        _, times = rows.grid(cells)
        values = rows.at(times.ravel())
        derivative = [values @ self.basis]
        for _ in range(4):
            values = values @ rows.A
            derivative.append(values @ self.basis)
        y, dy, ddy, _, _ = derivative
        gram = np.swapaxes(y, 1, 2) @ y
        cross = np.swapaxes(y, 1, 2) @ ddy
        bend = (2 * np.swapaxes(dy, 1, 2) @ dy + cross + np.swapaxes(cross, 1, 2)) * (h * h / 8)
        reach = np.exp(self.growth * h)
        a = [np.linalg.norm(d, axis=(1, 2)) * reach for d in derivative]
        fourth = 2 * a[0] * a[4] + 8 * a[1] * a[3] + 6 * a[2] ** 2
        rounding = 8 * (rows.count + self.weight.size) * _EPS * np.linalg.norm(gram, axis=(1, 2))
        return SlackTable(
            self._padded(gram, rows.count),
            self._padded(bend, rows.count),
            (fourth * (h * h / 8) ** 2).reshape(rows.count, -1),
            (rows.blur(times.ravel()) ** 2 / self.forgiven).reshape(rows.count, -1),
            rounding.reshape(rows.count, -1),
        )

    def _padded(self, matrices: Array, count: int) -> Array:
        flat = (self.triangle(matrices) * self.weight).reshape(count, -1, self.weight.size)
        return np.concatenate([flat[:, :1], flat, flat[:, -1:]], axis=1)
