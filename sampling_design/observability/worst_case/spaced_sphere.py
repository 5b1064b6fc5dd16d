"""Proven lower bound of sigma over spaced schedules: branch and bound over the sphere of states.

The state is taken at the first sample, so that a schedule and the same schedule later meet in one cell: a start u and
slacks 0 = v_1 <= ... <= v_k <= S - u. Its worst state z is an eigenvector, Gz = lambda N(u) z with G the sum of its
samples and N(u) = (e^{-Au} L)'(e^{-Au} L), hence for every y

    y'Gz = lambda y'N(u)z.

Both sides are linear in z: where y'Gc > 0 and y'Gc >= mu y'N(u)c at every corner c of a cell, for every schedule, none
whose worst state lies in the cell has lambda < mu. At a corner y'Gc is a sum over the samples, and its least value
over all schedules that end by a slack v is a least path through a table, to be compared with the largest y'N(u)c over
u <= S - v. Between grid times the terms lie above their chords minus (h^2/8) max of the second derivative. y is the
cell's centre z0: at c = z0 + d a sample gives f (f + g) >= -g^2/4, f and g the outputs of z0 and d. (Convexity of z'Gz
alone would give f (f + 2 g) >= -g^2: cells half as wide in n - 1 directions.) Cells lie along what the first sample
sees: by itself it leaves a worst state a thin slab, |R z|^2 <= z'Gz = lambda |x|^2, and nothing else is looked at.
So does every sample: times at which one alone would see more of every state of the cell are no sample's.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_search import (
    AttainedSchedule,
    search_from,
    so_far,
    sums_so_far,
    sums_to_go,
)
from sampling_design.observability.worst_case.spaced_tables import MOST_CELLS, CurveTable, SphereTables, StartTable
from sampling_design.records.arrays import Array, Integers, Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.declarations import below

MOST_STATES = 12  # a cell has 2^{n-1} corners: beyond this many states a proof by cells of directions is not tried
_STAGES = (0.25, 0.5, 0.75, 0.9, 1.0)  # of the wanted sigma: a search that is cut short has proven something
_BATCH = 300_000  # numbers per batch
_ROUND = 20_000  # cells per round
_MOST_CELLS = 400_000  # open at once
_THINNEST = 1e-12  # half-width below which a cell of directions is not cut again
_FAR = 0.1  # below this part of the wanted lambda a cell is cut in four at once
_FOLLOWED = 4096  # cells at most of the grid on which a better schedule is followed
_TEAR = 16  # least points of a stretch at which a window is torn
_TIME_SHARE = 0.5  # the grid is refined where time costs more than this part of what else is missing

_PER_CELL = {  # of what a batch holds, and which axis counts the cells
    "sides": 0,
    "reach": 0,
    "start": 0,
    "outside": 0,
    "own": 0,
    "most": 0,
    "own_cost": 0,
    "sink": 0,
    "lost": 0,
    "cost": 2,
    "so_far": 2,
    "rows": 0,
    "room": 0,
    "rise": 0,
    "norm": 1,
}


class SphereCells(NamedTuple):
    """Boxes of directions on the faces z_face = 1 of a cube, each with its own grid and windows in time."""

    centre: Array  # (m, n)
    half: Array  # (m, n), 0 at the face
    face: Integers  # (m,)
    grid: Integers  # (m,) cells of the time grid
    first: Integers  # (m, k) first and last grid point of each sample that can still matter
    last: Integers  # (m, k)
    bound: Array  # (m,) proven lambda

    def take(self, index: Integers | Mask) -> SphereCells:
        """The cells at `index`."""
        return SphereCells._make(a[index] for a in self)

    def volume(self) -> float:
        """Share of the sphere, as the share of the cube's faces."""
        n = self.centre.shape[1]
        return min(1.0, float(np.sum(np.prod(self.half, axis=1, where=self.half > 0)) / n))


class SphereBounds(NamedTuple):
    """Bounds of the search: the proven sigma, the best schedule met, why it ended and how many cells it took."""

    lower: float
    attained: AttainedSchedule
    status: str
    cells: int


def joined(parts: list[SphereCells]) -> SphereCells:
    """All cells of several sets."""
    return SphereCells._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


def prove_worst(
    rows: SpacedRows, found: AttainedSchedule, rtol: float, seconds: float, progress: Progress | None = None
) -> SphereBounds:
    """Prove a lower bound of sigma that lies within `rtol` below the attained one, or as near as time allows."""
    return _SphereSearch(rows, found, rtol).run(seconds, progress)


class _SphereSearch:
    """The open cells, the least bound of the closed ones, and the attained schedule, which may still improve."""

    def __init__(self, rows: SpacedRows, found: AttainedSchedule, rtol: float) -> None:
        self.rows, self.best, self.rtol = rows, found, rtol
        self.tables = SphereTables(rows, found.slacks, rtol / 100, found.moves)
        n, k = rows.n, rows.count
        self.sides = np.array([[j for j in range(n) if j != face] for face in range(n)], dtype=int).reshape(n, n - 1)
        cells = self.tables.least_cells
        zeros = np.zeros((n, k), dtype=int)
        last = zeros + cells
        if self.tables.pulled:
            last[:, 0] = 0  # the first sample is where the state is taken
        self.open = SphereCells(np.eye(n), 1 - np.eye(n), np.arange(n), np.full(n, cells), zeros, last, np.zeros(n))
        self.stuck = self.open.take(np.zeros(0, dtype=int))
        self.closed_at, self.cells = np.inf, 0

    @property
    def wanted(self) -> float:
        """Lambda at which a cell may close."""
        return float((self.best.sigma * (1 - 0.99 * self.rtol)) ** 2)

    def run(self, seconds: float, progress: Progress | None) -> SphereBounds:
        """Work on the cells with the lowest bounds until all are closed or the budget is spent.

        An interrupt ends it too: the cells that were taken out are open again, with the bounds that they had.
        """
        budget, status = Budget(seconds), ""
        while self.open.face.size and not status:
            before = self.open
            try:
                status = self._stepped(budget, progress)
            except KeyboardInterrupt:
                self.open, status = before, "interrupted"
        ended = self._verdict() if status in ("", "zero") else status
        return SphereBounds(self.lower, self.best, ended, self.cells)

    def _stepped(self, budget: Budget, progress: Progress | None) -> str:
        """One round: why the search ends, or nothing."""
        if self.open.face.size > _MOST_CELLS:
            return "budget"
        batches, status = self._batches(self._round()), ""
        results = [self.open]
        for part in batches:
            if not status and budget.over:
                status = "budget"
            results.append(part if status else self._worked(part))
        self.open = joined(results)
        if not status and self.rows.counts_as_zero(self.best.sigma, self.best.slacks, self.best.moves):
            status = "zero"
        if not status and progress is not None:
            share = 1 - self.open.volume() - self.stuck.volume()
            progress(share, f"worst case sigma: {self.open.face.size} cells open, at least {below(self.lower)}")
        return status

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
            room = _BATCH // (self.tables.copies(int(grid[low])) * self.rows.count * 2 ** (self.rows.n - 1))
            most = max(1, room // int(width[low]))
            stop = min(int(np.searchsorted(grid, grid[low], side="right")), low + most)
            stop = low + int(np.searchsorted(width[low:stop], 1.3 * width[low] + 2, side="right"))
            parts.append(cells.take(order[low:stop]))
            low = stop
        return parts

    def _worked(self, cells: SphereCells) -> SphereCells:
        """Bound a batch; return what stays open, cut in two or with a finer grid."""
        cells = self._observed_by_the_first(cells)
        if not cells.face.size:
            return cells
        self.cells += cells.face.size
        work = _CornerBounds(self, cells)
        bound = np.maximum(cells.bound, np.minimum(work.bound, self.wanted))
        cells = cells._replace(bound=bound)
        shut = work.bound >= self.wanted
        self.closed_at = min(self.closed_at, float(np.min(bound[shut], initial=np.inf)))
        if shut.all():
            return cells.take(~shut)
        if shut.any():
            cells, work = cells.take(~shut), work.take(~shut)
        cells, torn = work.narrowed(cells, self.wanted)
        by_time, by_direction, hopeless = work.losses(self.wanted)
        self._improve(work)
        self.stuck = joined([self.stuck, cells.take(hopeless)])
        loss, left = cells.half * np.sqrt(work.stretch()), ~hopeless & (torn.gap == 0)
        cut = self._cut(cells.take(left), by_time[left], by_direction[left], loss[left])
        return joined([cut, *torn.parts(cells, ~hopeless & (torn.gap > 0))])

    def _observed_by_the_first(self, cells: SphereCells) -> SphereCells:
        """The part of each cell whose states the first sample alone does not see enough of; no cell without one."""
        many = self.tables.slab.size
        if not many:
            return cells
        most = self.tables.slabs(cells.centre, cells.half, self.wanted)
        centre, half = cells.centre.copy(), cells.half.copy()
        low = np.maximum(centre[:, :many] - half[:, :many], -most)
        high = np.minimum(centre[:, :many] + half[:, :many], most)
        kept = np.all(low <= high, axis=1)
        if not kept.all():
            self.closed_at = min(self.closed_at, self.wanted)
        cut = half[:, :many] > (high - low) / 2  # a side that is not cut keeps its very numbers, a face its place
        centre[:, :many] = np.where(cut, (low + high) / 2, centre[:, :many])
        half[:, :many] = np.where(cut, (high - low) / 2, half[:, :many])
        return cells._replace(centre=centre, half=half).take(kept)

    def _improve(self, work: _CornerBounds) -> None:
        """Follow a centre whose best schedule on the grid already beats the attained one."""
        value, start = work.centre()
        i = int(np.argmin(value))
        if value[i] < self.best.sigma**2 * (1 - 1e-9):
            direction = self.tables.starts(int(work.cells.grid[i])).flow[start[i]] @ work.cells.centre[i]
            found = search_from(self.rows, direction, min(int(work.cells.grid[i]), _FOLLOWED))
            if found.sigma < self.best.sigma:
                self.best = found

    def _cut(self, cells: SphereCells, by_time: Array, by_direction: Array, loss: Array) -> SphereCells:
        """Halve the costliest side, double the grid, or both, whichever costs most."""
        row, axis = np.arange(cells.face.size), np.argmax(loss, axis=1)
        wide = cells.half[row, axis] > _THINNEST
        finer = ~wide | (by_time > _TIME_SHARE * by_direction)
        finer &= 2 * cells.grid <= MOST_CELLS
        halved = wide & ~(finer & (by_time > 4 * _TIME_SHARE * by_direction))
        scale = np.where(finer, 2, 1)
        cells = cells._replace(
            grid=cells.grid * scale, first=cells.first * scale[:, None], last=cells.last * scale[:, None]
        )
        self.stuck = joined([self.stuck, cells.take(~finer & ~halved)])
        whole, parts = cells.take(finer & ~halved), cells.take(halved)
        loss = loss[halved]
        twice = parts.bound < _FAR * self.wanted
        parts = joined([_halves(parts.take(~twice), loss[~twice]), _quarters(parts.take(twice), loss[twice])])
        return joined([whole, parts])


def _halves(cells: SphereCells, loss: Array) -> SphereCells:
    """Each cell cut in two across its costliest side."""
    row, axis = np.arange(cells.face.size), np.argmax(loss, axis=1)
    half = cells.half.copy()
    half[row, axis] /= 2
    low, high = cells.centre.copy(), cells.centre.copy()
    low[row, axis] -= half[row, axis]
    high[row, axis] += half[row, axis]
    return joined([cells._replace(centre=low, half=half), cells._replace(centre=high, half=half)])


def _quarters(cells: SphereCells, loss: Array) -> SphereCells:
    """Each cell cut in four, since two would stay open."""
    halves = _halves(cells, loss)
    row, axis = np.arange(cells.face.size), np.argmax(loss, axis=1)
    left = loss.copy()
    left[row, axis] /= 2
    return _halves(halves, np.concatenate([left, left]))


class _WideStretch(NamedTuple):
    """Windows with a wide stretch inside at which nothing matters: two windows are looked at instead.

    gap : (B,) points between the last that matters before it and the first after it, 0 where nothing is torn.
    sample, after : (B,) whose window, and the first point that matters after the stretch.
    """

    gap: Integers
    sample: Integers
    after: Integers

    @classmethod
    def of(cls, alive: Mask, start: Integers, width: Integers) -> _WideStretch:
        """The widest stretch of each cell, if it is most of its window."""
        at = np.arange(alive.shape[2])
        before = np.maximum.accumulate(np.where(alive, at, -1), axis=2)
        before = np.concatenate([np.full_like(before[..., :1], -1), before[..., :-1]], axis=2)
        gap = np.where(alive & (before >= 0), at - before, 0)
        end, row = np.argmax(gap, axis=2), np.arange(len(gap))
        gap = np.take_along_axis(gap, end[..., None], axis=2)[..., 0]
        gap = np.where((gap >= _TEAR) & (2 * gap >= width), gap, 0)
        sample = np.argmax(gap, axis=1)
        return cls(gap[row, sample], sample, end[row, sample] + start[row, sample])

    def parts(self, cells: SphereCells, which: Mask) -> list[SphereCells]:
        """The cells of `which` with either part of the window, a cell of the grid wider towards the stretch."""
        row, cells = np.arange(int(which.sum())), cells.take(which)
        sample, after, gap = self.sample[which], self.after[which], self.gap[which]
        first, last = cells.first.copy(), cells.last.copy()
        last[row, sample], first[row, sample] = after - gap + 1, after - 1
        # slacks are in order: what one window loses its neighbours lose too
        last = np.minimum.accumulate(last[:, ::-1], axis=1)[:, ::-1]
        first = np.maximum.accumulate(first, axis=1)
        parts = [cells._replace(last=last), cells._replace(first=first)]
        return [part.take(np.all(part.first <= part.last, axis=1)) for part in parts]


class _CornerBounds:
    """Bounds at the corners of a batch of cells on one grid.

    Of samples, points, cells and corners the corners come last, (k, W, B, c), and every step is one over many of them.
    """

    def __init__(self, search: _SphereSearch, cells: SphereCells) -> None:
        self.cells, self.count, self.sides = cells, search.rows.count, search.sides[cells.face]
        many = self.sides.shape[1]
        self.signs = np.array(list(product((1.0, -1.0), repeat=many))).reshape(2**many, many).T
        z = cells.centre
        self.reach = np.linalg.norm(z, axis=1) * np.linalg.norm(np.abs(z) + cells.half, axis=1)
        grid, tables = int(cells.grid[0]), search.tables
        self.width = min(int(np.max(cells.last - cells.first)) + 1, grid + 1)
        self.start = np.minimum(cells.first, grid + 1 - self.width)
        point = self.start[:, :, None] + np.arange(self.width)
        self.outside = (point < cells.first[:, :, None]) | (point > cells.last[:, :, None])
        groups = [tables.at(grid, point, g) for g in range(len(search.rows.groups))]
        largest = self._starts(tables.starts(grid), np.max(tables.steps(grid, point[:, -1]) ** 2 / 8, axis=1))
        if tables.slab.size:
            most = np.sqrt(search.wanted) * tables.longest(z, cells.half)
            for table, _, at in groups:
                least = table.least_observed(z, cells.half, at).reshape(*point.shape, -1).min(axis=3)
                self.outside |= least > most[:, None, None]
        self._samples(groups)
        self.room = tables.room(grid, point[:, -1])
        before = np.minimum(self.room.astype(int).T, len(largest) - 1)
        after, own = np.minimum(before + 1, len(largest) - 1), np.arange(len(z))
        low, high = largest[before, own], largest[after, own]
        self.norm = low + (high - low) * (self.room.T - before)[:, :, None]
        total = self.so_far[-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(self.norm > 0.0, total / self.norm, np.where(total > 0.0, np.inf, 0.0))
        self.bound = np.maximum(np.min(ratio, axis=(0, 2)), 0.0)

    def _starts(self, table: StartTable, eighth: Array) -> Array:
        """At least y'N(u)c for all starts up to each one, at each corner (Q + 1, B, c).

        Linear between the starts, and between last slacks whose cells have h^2/8 <= `eighth` (B,).
        """
        z, half = self.cells.centre, self.cells.half
        along, bend = (np.einsum("bn,qnm->bmq", z, part) for part in (table.norm, table.bend))
        self.own = np.einsum("bmq,bm->bq", along, z)
        bend = np.einsum("bmq,bm->bq", bend, z) + np.einsum("bmq,bm->bq", np.abs(bend), half)
        self.rise = np.maximum(bend.max(axis=1) + table.beyond * self.reach, 0.0) * (table.eighth + eighth)
        base = self.own + self.rise[:, None] + table.rounding * self.reach[:, None]
        found = self._corners(base.T, along.transpose(2, 0, 1))
        self.most = np.maximum(found[0].max(axis=1), 0.0)
        return so_far(found, np.maximum)

    def _samples(self, groups: list[tuple[CurveTable, Array, Integers]]) -> None:
        """What each sample adds at each corner, lowered by all that bends and rounds, and the least sums.

        Of each group of its outputs that which adds least, wherever it is read: a chord over its moves and over time.
        """
        z, half, reach, shape = self.cells.centre, self.cells.half, self.reach[:, None, None, None], self.outside.shape
        parts, rows = [], []
        for table, blur, place in groups:
            along, bent, of_z = table.against(z, place)
            at, many = place.reshape(*shape, -1), place.shape[2] // shape[2]
            own = np.einsum("bknw,bn->bkw", along, z).reshape(at.shape)
            bent = np.einsum("bknw,bn->bkw", bent, z) + np.einsum("bknw,bn->bkw", np.abs(bent), half)
            sink = _sunk(bent.reshape(at.shape), table, at, reach)
            lost = blur[at] * self.most[:, None, None, None] + table.rounded(z, half, of_z, place).reshape(at.shape)
            base = np.where(self.outside[..., None], np.inf, own - sink - lost)
            cost = self._corners(base.reshape(*shape[:2], -1).transpose(1, 2, 0), along.transpose(1, 3, 0, 2))
            cost = cost.reshape(cost.shape[0], shape[2], many, *cost.shape[2:])
            cost = cost.min(axis=2) if many > 1 else cost[:, :, 0]
            pick = np.argmin(np.where(self.outside[..., None], own, base), axis=3)[..., None]
            parts.append((cost, own.min(axis=3), *(np.take_along_axis(a, pick, axis=3)[..., 0] for a in (sink, lost))))
            rows.append(table.rows[place].reshape(*shape, -1, z.shape[1]) / np.sqrt(many))
        self.cost, self.own_cost, self.sink, self.lost = (
            sum(each[1:], start=each[0]) for each in zip(*parts, strict=True)
        )
        self.rows = np.concatenate(rows, axis=3) if len(rows) > 1 else rows[0]
        self.so_far = sums_so_far(self.cost, self.start)

    def _corners(self, centre: Array, along: Array) -> Array:
        """What is `centre` (..., B) at z0 and of slope `along` (..., B, n), at all corners: (..., B, c)."""
        n = along.shape[-1]
        place = self.sides + n * np.arange(len(self.sides))[:, None]
        steps = np.take((along * self.cells.half).reshape(*along.shape[:-2], -1), place, axis=-1)
        found = steps @ self.signs
        found += centre[..., None]
        return np.asarray(found)

    def take(self, index: Mask) -> _CornerBounds:
        """The same for some of the cells."""
        part = object.__new__(_CornerBounds)
        part.__dict__.update(self.__dict__)
        for name, axis in _PER_CELL.items():
            setattr(part, name, np.compress(index, getattr(self, name), axis=axis))
        part.cells = self.cells.take(index)
        return part

    def narrowed(self, cells: SphereCells, wanted: float) -> tuple[SphereCells, _WideStretch]:
        """Windows without the times through which no schedule with its worst state here comes below `wanted`."""
        needed = wanted * np.maximum(self.norm, 0.0)
        through = self.so_far + sums_to_go(self.cost, self.start, -needed)
        alive = (through.min(axis=3) <= 0.0).transpose(2, 0, 1)
        first = np.argmax(alive, axis=-1) + self.start
        last = self.width - 1 - np.argmax(alive[..., ::-1], axis=-1) + self.start
        # a real time next to a point that matters still counts: one cell more on either side
        cells = cells._replace(first=np.maximum(first - 1, cells.first), last=np.minimum(last + 1, cells.last))
        return cells, _WideStretch.of(alive, self.start, cells.last - cells.first)

    def losses(self, wanted: float) -> tuple[Array, Array, Mask]:
        """What time costs at the weakest corner, what else is missing, and where rounding costs more than both."""
        needed = wanted * np.maximum(self.norm, 0.0)
        missing = np.max(needed - self.so_far[-1], axis=0)
        row, weak = np.arange(missing.shape[0]), np.argmax(missing, axis=1)
        firm = self.cost[:, :, row, weak] + self.sink.transpose(1, 2, 0)
        flat = sums_so_far(np.stack([firm + self.lost.transpose(1, 2, 0), firm], axis=3), self.start)[-1]
        needed = wanted * np.maximum(self.norm[:, row, weak] - self.rise, 0.0)
        left = np.max(needed[:, :, None] - flat, axis=0)
        by_time, by_rounding = missing[row, weak] - left[:, 1], left[:, 1] - left[:, 0]
        by_direction = np.maximum(left[:, 0], 0.0)
        return by_time, by_direction, by_time + by_direction < by_rounding

    def centre(self) -> tuple[Array, Integers]:
        """The least lambda of the centre over the grid's schedules, and the start that gives it."""
        cost = np.where(self.outside, np.inf, self.own_cost).transpose(1, 2, 0)[..., None]
        total = sums_so_far(cost, self.start)[-1, :, :, 0].T
        latest = np.floor(self.room).astype(int)
        ratio = total / np.take_along_axis(np.maximum.accumulate(self.own, axis=1), latest, axis=1)
        row, end = np.arange(len(total)), np.argmin(ratio, axis=1)
        allowed = np.arange(self.own.shape[1]) <= latest[row, end][:, None]
        return ratio[row, end], np.argmax(np.where(allowed, self.own, -np.inf), axis=1)

    def stretch(self) -> Array:
        """How much a step along each axis costs: the diagonal of G, averaged over the windows, (B, n)."""
        weight = np.where(self.outside, 0.0, 1.0)
        weight /= np.sum(weight, axis=2, keepdims=True)
        return np.asarray(np.einsum("bkwpn,bkw->bn", self.rows**2, weight))


def _sunk(bent: Array, table: CurveTable, at: Integers, reach: Array) -> Array:
    """What bends can take below the chords of the cells next to each knot, (B, k, W, q) of points and moves.

    An axis with one knot alone has no cells: nothing happens along it.
    """
    cell, most, wide = at, bent, [axis for axis in (2, 3) if at.shape[axis] > 1]
    for axis in wide:
        low, high = np.arange(at.shape[axis] - 1), np.arange(1, at.shape[axis])
        cell = np.take(cell, low, axis)
        most = np.maximum(np.take(most, low, axis), np.take(most, high, axis))
    sink = np.maximum(most * table.eighth[cell] + table.beyond[cell] * reach, 0.0) if wide else 0.0 * bent
    for axis in wide:
        sink = around(sink, axis)
    return sink


def around(cells: Array, axis: int) -> Array:
    """What the cells on either side of each knot take at most, along one axis."""
    cells = np.moveaxis(cells, axis, 0)
    found = np.concatenate([cells[:1], np.maximum(cells[:-1], cells[1:]), cells[-1:]])
    return np.moveaxis(found, 0, axis)
