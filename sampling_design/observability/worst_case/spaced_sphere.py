"""Proven lower bound of sigma over spaced schedules: branch and bound over the sphere of states.

For a cell of directions z0 + d, d in a box, and every schedule, with G psd:

    z'Gz - mu |Lz|^2  >=  z0'Gz0 + 2 d'Gz0 - mu |L(z0 + d)|^2,

concave in d, so it is enough to look at the corners; at a corner the right side is a sum over the
samples, and its least value over all schedules is a least path through a table. Between grid times
the terms lie above their chords minus (h^2/8) max of the second derivative.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.observability.worst_case.spaced_paths import sums_so_far, sums_to_go
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_search import Attained, search_from
from sampling_design.observability.worst_case.spaced_tables import Tables

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int_]
Progress = Callable[[float, str], None]

MOST_STATES = 12
"""A cell has 2^{n-1} corners: beyond this many states a proof by cells of directions is not tried."""

_STAGES = (0.25, 0.5, 0.75, 0.9, 1.0)  # of the wanted sigma: a search that is cut short has proven something
_BATCH = 100_000  # numbers per batch: fits into a cache
_ROUND = 20_000  # cells per round
_MOST_CELLS = 400_000  # open at once
_THINNEST = 1e-12  # half-width below which a cell of directions is not cut again
_TIME_SHARE = 0.5  # the grid is refined where time costs more than this part of what direction costs


class SphereCells(NamedTuple):
    """Boxes of directions on the faces z_face = 1 of a cube, each with its own grid and windows in time."""

    centre: Array  # (m, n)
    half: Array  # (m, n), 0 at the face
    face: Indices  # (m,)
    grid: Indices  # (m,) cells of the time grid
    first: Indices  # (m, k) first and last grid point of each sample that can still matter
    last: Indices  # (m, k)
    bound: Array  # (m,) proven lambda

    def take(self, index: Indices | npt.NDArray[np.bool_]) -> SphereCells:
        """The cells at `index`."""
        return SphereCells._make(a[index] for a in self)

    def volume(self) -> float:
        """Share of the sphere, as the share of the cube's faces."""
        n = self.centre.shape[1]
        return float(np.sum(np.prod(self.half, axis=1, where=self.half > 0)) / n)


class Proof(NamedTuple):
    """Bounds of the search: the proven sigma, the best schedule met, why it ended and how many cells it took."""

    lower: float
    attained: Attained
    status: str
    cells: int


def joined(parts: list[SphereCells]) -> SphereCells:
    """All cells of several sets."""
    return SphereCells._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


def prove_worst(
    rows: SpacedRows, found: Attained, rtol: float, seconds: float, progress: Progress | None = None
) -> Proof:
    """Prove a lower bound of sigma that lies within `rtol` below the attained one, or as near as time allows."""
    return _SphereSearch(rows, found, rtol).run(seconds, progress)


class _SphereSearch:
    """The open cells, the least bound of the closed ones, and the attained schedule, which may still improve."""

    def __init__(self, rows: SpacedRows, found: Attained, rtol: float) -> None:
        self.rows, self.best, self.rtol = rows, found, rtol
        self.tables = Tables(rows, found.slacks, rtol / 100)
        self.metric = self.tables.basis.T @ self.tables.basis
        n, k = rows.n, rows.count
        signs = np.array(list(product((-1.0, 1.0), repeat=n - 1))).reshape(2 ** (n - 1), n - 1)
        self.signs = np.stack([np.insert(signs, f, 0.0, axis=1) for f in range(n)])
        cells = self.tables.first_cells()
        zeros = np.zeros((n, k), dtype=int)
        self.open = SphereCells(
            np.eye(n), 1 - np.eye(n), np.arange(n), np.full(n, cells), zeros, zeros + cells, np.zeros(n)
        )
        self.stuck = self.open.take(np.zeros(0, dtype=int))
        self.closed_at, self.cells = np.inf, 0

    @property
    def wanted(self) -> float:
        """Lambda at which a cell may close."""
        return float((self.best.sigma * (1 - 0.99 * self.rtol)) ** 2)

    def run(self, seconds: float, progress: Progress | None) -> Proof:
        """Work on the cells with the lowest bounds until all are closed or the budget is spent."""
        began, status = time.monotonic(), ""
        while self.open.face.size:
            if self.open.face.size > _MOST_CELLS:
                status = "budget"
                break
            batches = self._batches(self._round())
            results = [self.open]
            for part in batches:
                if not status and time.monotonic() - began > seconds:
                    status = "budget"
                results.append(part if status else self._worked(part))
            self.open = joined(results)
            if status or self.rows.counts_as_zero(self.best.sigma, self.best.slacks):
                break
            if progress is not None:
                share = 1 - self.open.volume() - self.stuck.volume()
                progress(share, f"worst case sigma: {self.open.face.size} cells open, at least {self.lower:.6g}")
        return Proof(self.lower, self.best, status or self._verdict(), self.cells)

    @property
    def lower(self) -> float:
        """Sigma proven so far."""
        parts = (self.open.bound, self.stuck.bound)
        least = min([self.closed_at, *(float(np.min(b, initial=np.inf)) for b in parts)])
        return float(np.sqrt(min(least * (1 - self.tables.forgiven), self.best.sigma**2)))

    def _verdict(self) -> str:
        return "closed" if self.lower >= (1 - self.rtol) * self.best.sigma else "rounding"

    def _round(self) -> SphereCells:
        """Take the cells below the present stage out of the pool, lowest bounds first."""
        bound = self.open.bound
        stage = next(s for s in _STAGES if s == 1.0 or np.min(bound) < s * s * self.wanted)
        now = np.flatnonzero(bound < (stage * stage * self.wanted if stage < 1 else np.inf))
        if now.size > _ROUND:
            now = now[np.argpartition(bound[now], _ROUND)[:_ROUND]]
        taken, rest = self.open.take(now), np.ones(bound.size, dtype=bool)
        rest[now] = False
        self.open = self.open.take(rest)
        return taken

    def _batches(self, cells: SphereCells) -> list[SphereCells]:
        """Groups of one grid and windows of about one width."""
        width = np.max(cells.last - cells.first, axis=1) + 1
        order = np.lexsort((width, cells.grid))
        grid, width = cells.grid[order], width[order]
        parts, low = [], 0
        while low < order.size:
            most = max(1, _BATCH // (self.rows.count * self.signs.shape[1] * int(width[low])))
            stop = min(int(np.searchsorted(grid, grid[low], side="right")), low + most)
            stop = low + int(np.searchsorted(width[low:stop], 1.3 * width[low] + 2, side="right"))
            parts.append(cells.take(order[low:stop]))
            low = stop
        return parts

    def _worked(self, cells: SphereCells) -> SphereCells:
        """Bound a batch; return what stays open, cut in two or with a finer grid."""
        self.cells += cells.face.size
        work = _Batch(self, cells)
        bound = np.maximum(cells.bound, np.minimum(work.bound, self.wanted))
        cells = cells._replace(bound=bound)
        shut = work.bound >= self.wanted
        self.closed_at = min(self.closed_at, float(np.min(bound[shut], initial=np.inf)))
        if shut.all():
            return cells.take(~shut)
        cells, work = cells.take(~shut), work.take(~shut)
        cells = work.narrowed(cells, self.wanted)
        by_time, by_direction, value, hopeless = work.losses()
        self._improve(cells, value)
        self.stuck = joined([self.stuck, cells.take(hopeless)])
        loss = cells.half * np.sqrt(work.stretch())
        return self._cut(cells.take(~hopeless), by_time[~hopeless], by_direction[~hopeless], loss[~hopeless])

    def _improve(self, cells: SphereCells, value: Array) -> None:
        """Follow a centre whose best schedule on the grid already beats the attained one."""
        i = int(np.argmin(value))
        if value[i] < self.best.sigma**2 * (1 - 1e-9):
            found = search_from(self.rows, self.tables.basis @ cells.centre[i], int(cells.grid[i]))
            if found.sigma < self.best.sigma:
                self.best = found

    def _cut(self, cells: SphereCells, by_time: Array, by_direction: Array, loss: Array) -> SphereCells:
        """Halve the costliest side, double the grid, or both, whichever costs most."""
        row, axis = np.arange(cells.face.size), np.argmax(loss, axis=1)
        wide = cells.half[row, axis] > _THINNEST
        finer = ~wide | (by_time > _TIME_SHARE * by_direction)
        finer &= 2 * cells.grid <= self.tables.most_cells
        halved = wide & ~(finer & (by_time > 4 * _TIME_SHARE * by_direction))
        scale = np.where(finer, 2, 1)
        cells = cells._replace(
            grid=cells.grid * scale, first=cells.first * scale[:, None], last=cells.last * scale[:, None]
        )
        self.stuck = joined([self.stuck, cells.take(~finer & ~halved)])
        whole, parts = cells.take(finer & ~halved), cells.take(halved)
        row, axis = np.arange(parts.face.size), axis[halved]
        half = parts.half.copy()
        half[row, axis] /= 2
        low, high = parts.centre.copy(), parts.centre.copy()
        low[row, axis] -= half[row, axis]
        high[row, axis] += half[row, axis]
        return joined([whole, parts._replace(centre=low, half=half), parts._replace(centre=high, half=half)])


class _Batch:
    """Bounds at the corners of a batch of cells on one grid."""

    def __init__(self, search: _SphereSearch, cells: SphereCells) -> None:
        self.tables, self.metric, self.count = search.tables, search.metric, search.rows.count
        self.cells = cells
        grid = int(cells.grid[0])
        self.table = self.tables.at(grid)
        self.width = min(int(np.max(cells.last - cells.first)) + 1, grid + 1)
        self.start = np.minimum(cells.first, grid + 1 - self.width)
        point = self.start[:, :, None] + np.arange(self.width)
        self.outside = ((point < cells.first[:, :, None]) | (point > cells.last[:, :, None]))[:, :, None, :]
        z, d = cells.centre[:, None, :], search.signs[cells.face] * cells.half[:, None, :]
        self.corner = z + d
        # z0 z0' + d z0' + z0 d' is symmetric of rank two: its nuclear norm bounds its product with any matrix
        size = np.linalg.norm(z, axis=2)
        nuclear = size**2 + 2 * size * np.linalg.norm(d, axis=2)
        forms = self.tables.triangle(z[..., :, None] * (z + 2 * d)[..., None, :])
        forms = (forms + self.tables.triangle((z + 2 * d)[..., :, None] * z[..., None, :])) / 2
        self.value, self.bent = self._costs(forms, nuclear)
        self.norm = self._squared(self.corner)
        row = np.arange(self.count)[:, None]
        blur = self.table.blur[row, point][:, :, None] * self.norm[:, None, :, None]
        rounded = self.table.rounding[row, point][:, :, None] * nuclear[:, None, :, None]
        self.firm = self.value - blur - rounded
        self.cost = np.where(self.outside, np.inf, self.firm - self.bent)
        self.so_far = sums_so_far(self.cost, self.start)
        self.total = np.min(self.so_far[:, -1], axis=-1)
        self.ratio = self.total / self.norm
        self.bound = np.maximum(np.min(self.ratio, axis=1), 0.0)

    def take(self, index: npt.NDArray[np.bool_]) -> _Batch:
        """The same for some of the cells."""
        part = object.__new__(_Batch)
        part.__dict__.update(self.__dict__)
        for name in ["cost", "so_far", "start", "outside", "corner", "norm", "value", "firm", "total", "ratio"]:
            setattr(part, name, getattr(self, name)[index])
        part.cells = self.cells.take(index)
        return part

    def _squared(self, z: Array) -> Array:
        """|L z|^2, rounded up: a bound is divided by it."""
        rounding = 8 * z.shape[-1] * float(np.finfo(float).eps) * float(np.linalg.norm(self.metric))
        return np.asarray(np.sum((z @ self.metric) * z + rounding * z * z, axis=-1))

    def _costs(self, forms: Array, nuclear: Array) -> tuple[Array, Array]:
        """<G, X> at each window point, and how far <G, X> can sink below its chords there: both (B, k, c, W)."""
        row, point = np.arange(self.count)[:, None], self.start[:, :, None] + np.arange(self.width + 2)
        gram = np.swapaxes(self.table.gram[row, point[..., 1:-1]], 2, 3)
        bend = np.swapaxes(self.table.bend[row, point], 2, 3)
        beyond = self.table.beyond[row, point[..., :-2]]
        value, bent = forms[:, None] @ gram, forms[:, None] @ bend
        bent = np.maximum(np.maximum(bent[..., :-2], bent[..., 2:]), bent[..., 1:-1])
        return value, np.maximum(bent + beyond[:, :, None, :] * nuclear[:, None, :, None], 0.0)

    def narrowed(self, cells: SphereCells, wanted: float) -> SphereCells:
        """Windows without the times through which no schedule comes below `wanted` at any corner."""
        through = self.so_far + sums_to_go(self.cost, self.start) - (wanted * self.norm)[:, None, :, None]
        alive = np.any(through < 0.0, axis=2)
        first = np.argmax(alive, axis=-1) + self.start
        last = self.width - 1 - np.argmax(alive[..., ::-1], axis=-1) + self.start
        # a real time next to a point that matters still counts: one cell more on either side
        return cells._replace(first=np.maximum(first - 1, cells.first), last=np.minimum(last + 1, cells.last))

    def losses(self) -> tuple[Array, Array, Array, npt.NDArray[np.bool_]]:
        """What time and direction cost at the weakest corner, the centre's value, and where rounding costs more."""
        row, weak = np.arange(self.ratio.shape[0]), np.argmin(self.ratio, axis=1)
        flat = np.stack([self.value[row, :, weak], self.firm[row, :, weak]], axis=2)
        flat = np.min(sums_so_far(np.where(self.outside, np.inf, flat), self.start)[:, -1], axis=-1)
        z, corner = self.cells.centre, self.corner[row, weak]
        points = np.stack([corner, z], axis=1)
        forms = self.tables.triangle(points[..., :, None] * points[..., None, :])
        exact = np.where(self.outside, np.inf, self._costs(forms, np.zeros(forms.shape[:2]))[0])
        exact = np.min(sums_so_far(exact, self.start)[:, -1], axis=-1)
        by_rounding, by_time = flat[:, 0] - flat[:, 1], flat[:, 1] - self.total[row, weak]
        by_direction = exact[:, 0] - flat[:, 0]
        return by_time, by_direction, exact[:, 1] / self._squared(z), by_time + by_direction < by_rounding

    def stretch(self) -> Array:
        """How much a step along each axis costs: the diagonal of G, averaged over the windows, (B, n)."""
        row, point = np.arange(self.count)[:, None], self.start[:, :, None] + np.arange(self.width) + 1
        diagonal = self.table.gram[row, point][..., self.tables.upper[0] == self.tables.upper[1]]
        weight = np.where(self.outside[:, :, 0], 0.0, 1.0)
        weight /= np.sum(weight, axis=2, keepdims=True)
        return np.asarray(np.sum(diagonal * weight[..., None], axis=(1, 2)))
