"""Lower bound of sigma over all spaced schedules, proven with enclosed arithmetic (extra `rigorous`).

Claim: z'G z >= mu |L z|^2 for every direction z and G the sum of (C e^{A tau_i} L)'(C e^{A tau_i} L) over any
admissible schedule. A schedule's worst z is an eigenvector, Gz = lambda L'Lz, so that for the centre z0 of a cell of
directions z0 + d, d in a box,

    z0'Gz  =  lambda z0'L'Lz,

both sides linear in z: where z0'Gc > 0 and z0'Gc >= mu z0'L'Lc at each corner c, no worst z of the cell has
lambda < mu. At a corner the left side is a sum over the samples; between the points of a time grid each term lies
above its chords minus (h^2/8) max of its second derivative, and the least sum over ordered slacks is a least path.
Outputs that are read at times of their own add what they add least at any of them, a chord over these too.
Rows come from balls; sums of doubles are lowered by the bound on their rounding; directions are dyadic, so that their
products are exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np

from sampling_design.numerics.balls import Ball, BallFlow, Matrix, ball, definite, matrix, rational, stacked
from sampling_design.observability.sigma_bracket import ProvenSigma
from sampling_design.observability.windows.balls import SHAVES, nearest_proven
from sampling_design.observability.worst_case.spaced_rows import SpacedRows, output_groups
from sampling_design.observability.worst_case.spaced_sphere import around
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Integers, Mask
from sampling_design.records.budget import Budget, BudgetSpentError
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows

FIRST_GRID, LAST_GRID = 32, 8192  # cells of the time grid at first and at most
FIRST_MOVES = 4  # cells of the time grid for one of a reading's moves
THINNEST = 20  # most halvings of a side: products of such dyadic numbers are exact doubles
MOST_STATES = 8  # 2^(n-1) corners per cell
MOST_CELLS = 200_000  # open at once
BATCH = 2_000_000  # numbers per batch
FALSE = 1e-9  # a schedule this far below the claim, relative, ends the attempt
UNIT = 2.0**-53  # rounding unit of doubles
UP = 1 + 2.0**-40  # factor that covers the rounding of a few products of positive doubles


class BallCells(NamedTuple):
    """Boxes of directions on the faces z_face = 1 of a cube: centre, halvings of each side, halvings of time."""

    centre: Array  # (m, n)
    depth: Integers  # (m, n)
    face: Integers  # (m,)
    grid: Integers  # (m,)

    def take(self, index: Mask | Integers) -> BallCells:
        """The cells at `index`."""
        return BallCells._make(part[index] for part in self)

    @property
    def half(self) -> Array:
        """Half-widths, 0 at the face."""
        half = np.ldexp(1.0, -self.depth)
        half[np.arange(len(self.face)), self.face] = 0.0
        return half


BallGroup: TypeAlias = tuple[Matrix, Fraction, Fraction]
"""Outputs that are read at one time: rows C to C A^4 (5 p, n), how long after the planned time, and how far from that,
exactly."""


class BallTable(NamedTuple):
    """Per sample, grid point and move vec G and vec (h^2/8) G''; for |X| = 1 the rounding of both and the bend's bend.

    Squared beside h stands the width of a cell of moves.
    """

    gram: Array  # (k, N + 1, m, q)
    bend: Array  # (k, N + 1, m, q)
    rounding: Array  # (k, N + 1, m) of <G, X>
    blur: Array  # (k, N + 1, m) of <(h^2/8) G'', X>
    fourth: Array  # (k, N, m) (h^2/8)^2 times the supremum of the fourth derivative over each cell and its moves


class WorstCase:
    """Tables and cells of one plant and family, in coordinates x = L z."""

    def __init__(
        self, plant: Plant, family: SpacedWindows, basis: Array, clock: Budget, late: TimingTolerance = ON_TIME
    ) -> None:
        self.n, self.p, self.k, self.clock = plant.n_states, plant.n_outputs, family.count, clock
        self.offsets = [Fraction(family.spacing) * i for i in range(self.k)]
        self.slack = max(Fraction(family.window) - self.offsets[-1], Fraction(0))
        L, A = matrix(basis), matrix(plant.A)
        self.flow = BallFlow(L.solve(A * L), matrix(np.zeros((self.n, self.n))))
        self.groups = [
            self._group(matrix(group.C) * L, late, group.outputs[0]) for group in output_groups(plant.C, late)
        ]
        self.upper = np.triu_indices(self.n)
        self.weight = np.where(self.upper[0] == self.upper[1], 1.0, 2.0)
        self.basis = L
        metric = (L.transpose() * L).tolist()
        self.metric = np.array([[float(x) for x in row] for row in metric])
        self.terms = 8 * (self.weight.size + self.p + self.n + self.k + 8)
        signs = np.array(list(product((-1.0, 1.0), repeat=self.n - 1))).reshape(2 ** (self.n - 1), self.n - 1)
        signs = np.vstack([signs, np.zeros((1, self.n - 1))])  # the centre too: it tells a claim that is false
        self.signs = np.stack([np.insert(signs, f, 0.0, axis=1) for f in range(self.n)])
        self._tables: dict[int, list[BallTable]] = {}

    def _group(self, C: Matrix, late: TimingTolerance, output: int) -> BallGroup:
        """The group of an output, whose rows these are."""
        rows = [C]
        for _ in range(4):
            rows.append(rows[-1] * self.flow.A)
        early, after = (Fraction(side[output if late.apart else 0]) for side in (late.early, late.late))
        lag = max(map(Fraction, late.early)) + (after - early) / 2
        return stacked([row for part in rows for row in part.tolist()]), lag, (early + after) / 2

    def moves(self, cells: int, radius: Fraction) -> int:
        """Cells of the moves that go with a grid: two at first, none finer than the grid's; none where none moves."""
        finest = 2 * radius * cells / self.slack if self.slack else cells
        return min(cells // FIRST_MOVES, math.ceil(finest))

    def tables(self, cells: int) -> list[BallTable]:
        """The tables of a grid of `cells` cells, one of each group."""
        if cells not in self._tables:
            self._tables[cells] = [self._made(cells, group) for group in self.groups]
        return self._tables[cells]

    def _made(self, cells: int, group: BallGroup) -> BallTable:
        rows, lag, radius = group
        step, parts = self.slack / cells, self.moves(cells, radius)
        E, across = self.flow.over(rational(step))[0], 2 * radius / max(parts, 1)
        y = np.empty((self.k, cells + 1, parts + 1, 5, rows.nrows() // 5, self.n))
        for i, m in np.ndindex(self.k, parts + 1):
            self.clock.check()
            begun = self.offsets[i] + lag - radius + m * across
            at = rows * self.flow.over(rational(begun))[0]
            for j in range(cells + 1):
                y[i, j, m] = np.array([float(x) for x in at.entries()]).reshape(y.shape[3:])
                at = at * E
        eighth = float(rational((step**2 + across**2) / 8).upper()) * UP
        turned = np.swapaxes(y, -1, -2)
        cross = turned[:, :, :, 0] @ y[:, :, :, 2]
        gram = turned[:, :, :, 0] @ y[:, :, :, 0]
        bend = (2 * turned[:, :, :, 1] @ y[:, :, :, 1] + cross + np.swapaxes(cross, -1, -2)) * eighth
        size = np.linalg.norm(y, axis=(-1, -2)) * UP
        reach = np.sqrt(self._reach(rational(step + across))) * UP
        a = [size[..., order] * reach for order in range(5)]
        fourth = (2 * a[0] * a[4] + 8 * a[1] * a[3] + 6 * a[2] ** 2) * UP
        bent = (2 * size[..., 1] ** 2 + 2 * size[..., 0] * size[..., 2]) * eighth
        lost = self.terms * UNIT
        rounding = lost * size[..., 0] ** 2
        return BallTable(self._vec(gram), self._vec(bend), rounding, lost * bent, fourth[:, :-1] * eighth**2 * UP)

    def _reach(self, step: Ball) -> float:
        """At least sup |e^{Bs}|^2 over a step."""
        if not step > 0:
            return 1.0
        return float((self.flow.reach(step) * 8 / step**2).upper()) * UP

    def _vec(self, matrices: Array) -> Array:
        return np.asarray(matrices[..., self.upper[0], self.upper[1]] * self.weight)

    def norms(self, y: Array, z: Array) -> Array:
        """At least y'L'Lz."""
        lost = self.terms * UNIT * np.abs(y).sum(axis=-1) * np.abs(z).sum(axis=-1) * np.abs(self.metric).max()
        return np.asarray(np.einsum("...i,ij,...j->...", y, self.metric, z) + lost)

    def least(self, cells: BallCells) -> tuple[Array, Array, Array]:
        """Least z0'Gc at the corners (m, c): proven; the same without the bend of time; and at least z0'L'Lc there."""
        z = cells.centre[:, None, :]
        d = self.signs[cells.face] * cells.half[:, None, :]
        other = z + d
        pair = z[..., :, None] * other[..., None, :]
        X = ((pair + np.swapaxes(pair, -1, -2)) / 2)[..., self.upper[0], self.upper[1]]
        nuclear = np.linalg.norm(z, axis=-1) * np.linalg.norm(other, axis=-1) * UP
        forms, nuclear, costs = X.reshape(-1, X.shape[-1]).T, nuclear.ravel(), list[tuple[Array, Array]]()
        for table in self.tables(int(cells.grid[0])):
            value = table.gram @ forms - table.rounding[..., None] * nuclear
            bent = table.bend @ forms + table.blur[..., None] * nuclear
            most, beyond = np.maximum(bent[:, :-1], bent[:, 1:]), table.fourth[..., None] * nuclear
            if moved := bent.shape[2] > 1:
                most, beyond = np.maximum(most[:, :, :-1], most[:, :, 1:]), beyond[:, :, :-1]
            sink = around(np.maximum(most + beyond, 0.0) * UP, 1)
            low = value - (around(sink, 2) if moved else sink)
            costs.append((low.min(axis=2), value.min(axis=2)))
        found = [self._path(np.asarray(sum(each[1:], start=each[0]))) for each in zip(*costs, strict=True)]
        shape = X.shape[:-1]
        return found[0].reshape(shape), found[1].reshape(shape), self.norms(z, other)

    def _path(self, cost: Array) -> Array:
        """At most the least sum of one cost per sample along non-decreasing grid points, (k, N + 1, K) -> (K,)."""
        total = cost[0]
        for row in cost[1:]:
            total = np.minimum.accumulate(total, axis=0) + row
        lost = self.terms * UNIT * np.sum(np.abs(cost).max(axis=1), axis=0)
        return np.asarray(total.min(axis=0) - lost)

    def only(self, mu: float) -> bool:
        """The same where one schedule alone is admissible."""
        total = matrix(np.zeros((self.n, self.n)))
        first = stacked(self.groups[0][0].tolist()[: self.p])
        for offset in self.offsets:
            at = first * self.flow.over(rational(offset))[0]
            total = total + at.transpose() * at
        return definite(total - ball(mu) * self.basis.transpose() * self.basis) is True

    def proves(self, sigma: float) -> bool:
        """Whether z'Gz >= sigma^2 |Lz|^2 is proven for all directions and schedules."""
        mu = float(np.nextafter(sigma * sigma, np.inf))
        if self.slack == 0 and not any(radius for *_, radius in self.groups):
            return self.only(mu)
        n = self.n
        pending = BallCells(np.eye(n), np.zeros((n, n), dtype=int), np.arange(n), np.full(n, FIRST_GRID))
        while pending.face.size:
            if pending.face.size > MOST_CELLS:
                raise BudgetSpentError("too many cells are open")
            grid = int(pending.grid.min())
            same = np.flatnonzero(pending.grid == grid)
            read = sum(self.moves(grid, radius) + 1 for *_, radius in self.groups)
            same = same[: max(1, BATCH // (self.k * (grid + 1) * read * self.signs.shape[1]))]
            rest = np.ones(pending.face.size, dtype=bool)
            rest[same] = False
            self.clock.check()
            cut = self._cut(pending.take(same), mu)
            if cut is None:
                return False
            pending = BallCells._make(np.concatenate(parts) for parts in zip(pending.take(rest), *cut, strict=True))
        return True

    def _cut(self, cells: BallCells, mu: float) -> list[BallCells] | None:
        """The cells that stay open, cut in two or with a finer grid; None where one can be cut no further."""
        proven, flat, norms = self.least(cells)
        needed = mu * np.maximum(norms, 0.0) * UP
        if np.any(flat[:, -1] < needed[:, -1] * (1 - FALSE)):
            return None
        open_ = np.asarray(~np.all((proven >= needed) & (proven > 0), axis=1))  # nan stays open
        cells, short, flat_short = cells.take(open_), (needed - proven)[open_], (needed - flat)[open_]
        if not open_.any():
            return []
        # time is to blame where, without its bends, half of what is missing would not be
        by_time = flat_short.max(axis=1) < short.max(axis=1) / 2
        finer = by_time & (2 * cells.grid <= LAST_GRID)
        loss = cells.half * np.sqrt(np.maximum(self._stretch(), 0.0))
        loss[cells.depth >= THINNEST] = 0.0
        if (~finer & (by_time | (loss.max(axis=1, initial=0.0) <= 0))).any():
            return None
        whole = cells.take(finer)
        parts, axis = cells.take(~finer), np.argmax(loss[~finer], axis=1)
        row, depth = np.arange(parts.face.size), parts.depth.copy()
        depth[row, axis] += 1
        step = np.zeros_like(parts.centre)
        step[row, axis] = parts.half[row, axis] / 2
        halves = [parts._replace(centre=parts.centre + sign * step, depth=depth) for sign in (-1, 1)]
        return [whole._replace(grid=2 * whole.grid), *halves]

    def _stretch(self) -> Array:
        """How much a step along each axis costs: the mean diagonal of G."""
        grams = [table.gram[..., self.upper[0] == self.upper[1]] for table in self.tables(FIRST_GRID)]
        return np.asarray(sum(gram.mean(axis=(0, 1, 2)) for gram in grams))


def prove_worst_sigma(
    plant: Plant,
    family: SpacedWindows,
    guess: float,
    worst: Array,
    seconds: float = 60.0,
    shaves: tuple[float, ...] = SHAVES,
    late: TimingTolerance = ON_TIME,
) -> ProvenSigma:
    """Prove a lower bound of sigma over all schedules of a family: see `nearest_proven`.

    Window, count and spacing are the doubles that the theorem is about, and those of `late`, of outputs that are read
    at times of their own; `worst` (k,), the times of a bad schedule, chooses the coordinates, nothing else.
    """
    if plant.n_states > MOST_STATES:
        return ProvenSigma(0.0, 0.0, "too many states")

    def begin(clock: Budget) -> Callable[[float], bool]:
        rows = SpacedRows(plant, family.window, family.count, family.spacing, late)
        basis, _ = rows.coordinates(np.clip(worst - max(late.early) - rows.offsets, 0.0, None))
        return WorstCase(plant, family, basis, clock, late).proves

    return nearest_proven(guess, seconds, begin, shaves=shaves)
