"""The Jacobians of a nonlinear plant: its region is cut into cells, which are halved until each of them is proven."""

from collections.abc import Callable
from itertools import product

import numpy as np

from .inclusion_file import Inclusion, Region
from .numbers import EPS
from .outcome import Refused, Undecided, WorkLimit
from .slopes import Parts, enclosed
from .strict import Array, Mask

CORNERS = 6  # directions of a cell's Jacobian whose corners are tried; the others are a perturbation
MORE_CORNERS, FEW = 10, 16  # the same where no more than so many cells are judged at once
SMALL = 1e-3  # share of the widest direction below which one is left to the perturbation
MOST_MATRICES = 1_500_000  # matrices of one proof over cells
BATCH = 40_000
PRICE = 2  # work of one matrix, in microseconds
Judge = Callable[[Array, Array, Array], Parts]
Robust = Callable[[Array, Array, Array], tuple[Array, int]]


def bounded(E: Array, moving: Array) -> Mask:
    """Cells over which the Jacobian has bounds."""
    return np.asarray(np.isfinite(E).all(axis=(1, 2)) & np.isfinite(moving).all(axis=(0, 2, 3)))


class Cells:
    """The region of a nonlinear plant, halved until the Jacobians of every cell are proven."""

    def __init__(self, c: Inclusion, region: Region, P: Array, work: WorkLimit) -> None:
        self.c, self.region, self.work = c, region, work
        self.n = c.plant.n
        root = np.sqrt(np.einsum("kii->i", P) / len(P))
        self.x = root
        rate = np.abs(np.diag(c.plant.A)) + c.weights.eta + 1 / c.longest
        self.pace = np.sqrt(rate)
        self.disturbance_scale = np.sqrt(np.diag(c.weights.Qw))
        self.output_scale = 1 / np.sqrt(1 / np.diag(c.weights.R) + 1 / np.diag(c.weights.Qv))

    def prove(self, name: str, judge: Judge, of_f: bool, each: int, robust: Robust | None = None) -> float:
        """Prove that `judge` is positive for every Jacobian in the region; return the least slack.

        `judge` takes (A, G) side by side, or C, their radius, and what they are in the middle of the cell, and bounds a
        relative slack; it looks at `each` matrices. What cells that move by given matrices leave of it `robust` says,
        without it the corners of the widest of these.
        """
        low = np.concatenate([self.region.low[key] for key in ("x", "u", "w")])[None]
        high = np.concatenate([self.region.high[key] for key in ("x", "u", "w")])[None]
        slack, spent, most = 1.0, 0, BATCH if robust is None else max(1, BATCH // (8 * each))
        while len(low):
            inside = self.inside(low, high)
            low, high = low[inside], high[inside]
            if not len(low):
                break
            M, E, moving = enclosed(self.region, low, high, of_f)
            tried = each * 2**CORNERS * int(np.sum(~bounded(E, moving)))  # as if judged, or halving had no end
            left = np.empty(len(low))
            for first in range(0, len(low), most):
                part = slice(first, first + most)
                parts = M[part], E[part], moving[:, part]
                left[part], more = self.at_corners(judge, each, *parts) if robust is None else robust(*parts)
                tried += more
            spent += tried
            self.work.spend(PRICE * tried)
            slack = min(slack, float(left[left > 0].min(initial=1.0)))
            if (left > 0).all():
                break
            low, high = low[left <= 0], high[left <= 0]
            self.refute(name, low, high, judge, of_f)
            if spent > MOST_MATRICES or self.work.over:
                raise Undecided(name, f"{name} could not be decided: {len(low)} cells of the region are left")
            low, high = self.halved(name, low, high, of_f)
        return slack

    def inside(self, low: Array, high: Array) -> Mask:
        """Cells that are not certainly outside of the half-spaces."""
        found = np.ones(len(low), bool)
        for row, offset in zip(self.region.rows, self.region.offsets, strict=True):
            ends = np.where(row > 0, low[:, : self.n] * row, np.where(row < 0, high[:, : self.n] * row, 0.0))
            room = (self.n + 2) * EPS * (np.abs(ends).sum(axis=1) + abs(offset))
            found &= ~(ends.sum(axis=1) - room > offset)
        return found

    def jacobians(self, low: Array, high: Array, of_f: bool) -> Parts:
        """Middles and radii of (A, G) side by side, or of C, over each cell."""
        M, E, moving = enclosed(self.region, low, high, of_f)
        return M, E + np.abs(moving).sum(axis=0)

    def effect(self, E: Array, of_f: bool) -> Array:
        """Sizes of the radii in units in which the diagonals of what is proven are about 1."""
        if not of_f:
            return np.asarray(E * self.output_scale[:, None] / self.x)
        left, right = self.x / self.pace, np.concatenate([self.x * self.pace, self.disturbance_scale])
        return np.asarray(E * left[:, None] / right)

    def at_corners(self, judge: Judge, each: int, M: Array, E: Array, moving: Array) -> tuple[Array, int]:
        """The least slack over the corners of the widest directions, the others as a perturbation; how many were tried.

        Of outputs. Nothing is proven of a cell without bounds.
        """
        finite = bounded(E, moving)
        least_of = np.where(finite, np.inf, -np.inf)
        if not finite.any():
            return least_of, 0
        E, M, moving = E[finite], M[finite], moving[:, finite]
        worth = np.array([self.effect(np.abs(D), False).max() for D in moving])
        order = np.argsort(-worth)
        most = CORNERS if len(M) > FEW else MORE_CORNERS
        wide = [int(k) for k in order[:most] if worth[k] > SMALL * worth.max(initial=0.0)]
        others = [k for k in range(len(moving)) if k not in wide]
        signs = np.array(list(product((-1.0, 1.0), repeat=len(wide)))).reshape(2 ** len(wide), len(wide))
        size = np.abs(moving[wide]).sum(axis=0)
        off = E + np.abs(moving[others]).sum(axis=0) + np.where(size > 0, EPS * (len(wide) + 2) * (np.abs(M) + size), 0)
        found, step = np.full(len(M), np.inf), max(1, BATCH // each)
        for sign in signs:
            at = M + np.tensordot(sign, moving[wide], 1)
            for first in range(0, len(M), step):
                part = slice(first, first + step)
                found[part] = np.minimum(found[part], judge(at[part], off[part], M[part])[0])
        least_of[finite] = found
        return least_of, each * len(M) * len(signs)

    def refute(self, name: str, low: Array, high: Array, judge: Judge, of_f: bool) -> None:
        """Refused if the inequality fails at the Jacobian in the middle of some cell that lies in the region."""
        with np.errstate(invalid="ignore"):
            at = np.where(np.isfinite(low) & np.isfinite(high), low / 2 + high / 2, np.clip(0.0, low, high))
        at = at[:64]
        inside = np.all(self.region.rows @ at[:, : self.n].T <= self.region.offsets[:, None], axis=0)
        if not inside.any():
            return
        M, E = self.jacobians(at[inside], at[inside], of_f)
        fine = np.isfinite(E).all(axis=(1, 2))
        if not fine.any():
            return
        _, above = judge(M[fine], E[fine], M[fine])
        k = int(np.argmin(above))
        if above[k] < 0:
            x = at[inside][fine][k, : self.n]
            where = ", ".join(f"{v:.6g}" for v in x)
            amount, reason = float(above[k]), f"{name} fails by {-above[k]:.3g} of its terms at x = [{where}]"
            raise Refused(name, reason, amount, direction=x.tolist())

    @staticmethod
    def finite(low: Array, high: Array) -> Mask:
        """Sides of cells that can be halved."""
        found: Mask = np.isfinite(low) & np.isfinite(high) & (low < high)
        return found

    def halved(self, name: str, low: Array, high: Array, of_f: bool) -> Parts:
        """Both halves of each cell, along the side that narrows the Jacobian most."""
        best, side = np.full(len(low), np.inf), np.full(len(low), -1)
        sides = [j for j in range(low.shape[1]) if np.any(self.finite(low, high)[:, j])]
        pairs = []
        for j in sides:
            finite = self.finite(low, high)[:, j]
            middle = np.where(finite, low[:, j] / 2 + high[:, j] / 2, 0.0)
            left, right = high.copy(), low.copy()
            left[:, j], right[:, j] = np.where(finite, middle, high[:, j]), np.where(finite, middle, low[:, j])
            pairs += [(low, left), (right, high)]
        if pairs:
            lows, highs = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
            size = np.minimum(self.effect(self.jacobians(lows, highs, of_f)[1], of_f), 1e100)
            costs = np.square(size).sum(axis=(1, 2)).reshape(len(sides), 2, len(low)).sum(axis=1)
            for j, cost in zip(sides, costs, strict=True):
                better = self.finite(low, high)[:, j] & (cost < best)
                best, side = np.where(better, cost, best), np.where(better, j, side)
        if np.any(side < 0):
            raise Undecided(name, f"{name} could not be decided: a cell of the region cannot be halved")
        rows = np.arange(len(low))
        middle = low[rows, side] / 2 + high[rows, side] / 2
        left, right = high.copy(), low.copy()
        left[rows, side], right[rows, side] = middle, middle
        return np.concatenate([low, right]), np.concatenate([left, high])
