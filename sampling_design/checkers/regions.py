"""The Jacobians of a nonlinear plant: its region is cut into cells, which are halved until each of them is proven.

Over a cell they are a middle, and what may be added to it, whose entries do not move alone. A derivative of one
instruction that is not linear (an "atom") moves all outputs in which it occurs, and the derivatives of a product move
with its value: those of exp(a) b/c are the value times a' + b'/b - c'/c, which hardly moves where the value ranges over
a decade.
"""

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np

from . import intervals as iv
from . import programs
from .inclusion_file import Inclusion, Region
from .intervals import Interval
from .numbers import EPS
from .outcome import Refused, Undecided, WorkLimit
from .strict import Array, Mask

CORNERS = 6  # directions of a cell's Jacobian whose corners are tried; the others are a perturbation
MORE_CORNERS, FEW = 10, 16  # the same where no more than so many cells are judged at once
SMALL = 1e-3  # share of the widest direction below which one is left to the perturbation
MOST_MATRICES = 1_500_000  # matrices of one proof over cells
BATCH = 40_000
PRICE = 2  # work of one matrix, in microseconds
NARROWER = 0.7  # mean share of the radii of derivatives that is left where the value's radius is taken apart
Parts = tuple[Array, Array]
Judge = Callable[[Array, Array, Array], Parts]
Robust = Callable[[Array, Array, Array], tuple[Array, int]]


def halves(x: Interval) -> Parts:
    """A middle and a radius of each interval: certainly within; radius 0 where both ends are one number."""
    whole = np.isfinite(x.low) & np.isfinite(x.high)
    with np.errstate(invalid="ignore"):
        middle = np.where(whole, x.low / 2 + x.high / 2, 0.0)
        radius = np.maximum(np.nextafter(x.high - middle, np.inf), np.nextafter(middle - x.low, np.inf))
    return middle, np.where(whole, np.where(x.low == x.high, 0.0, radius), np.inf)


class Rate(NamedTuple):
    """An atom's value in each cell, its derivatives as shares of it, and where that says them more narrowly."""

    middle: Array
    radius: Array
    slopes: programs.Slopes
    used: Mask


def rate_of(both: programs.Both, shares: programs.Slopes) -> Rate | None:
    """The derivatives of an atom as its value times shares: None where there are no two, or nothing is gained."""
    value, slopes = both
    if len(slopes) < 2:
        return None
    v, dv = halves(value)
    far, gain, count = np.abs(v) + dv, np.zeros(len(v)), np.zeros(len(v))
    finite = np.isfinite(dv) & (dv > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        for key, slope in slopes.items():
            (_, dg), (share, dl) = halves(slope), halves(shares[key])
            finite &= np.isfinite(dg) & np.isfinite(dl) & np.isfinite(share)
            gain += np.where(dg > 0, far * dl / dg, 1.0)
            count += 1
        used = finite & (gain < NARROWER * count)
    return Rate(v, dv, shares, used) if used.any() else None


def enclosed(region: Region, low: Array, high: Array, of_f: bool) -> tuple[Array, Array, Array]:
    """Middles, radii, and matrices (D, cells, rows, columns) of which any multiples in [-1, 1] may be added.

    A derivative of one atom moves all outputs together in which it occurs: one matrix for each, of rank one.
    """
    n, q = len(region.low["x"]), len(region.low["w"])
    order = [(key, k) for key in ("x", "u", "w") for k in range(len(region.low[key]))]
    inputs: dict[str, list[Interval]] = {"x": [], "u": [], "w": []}
    for k, (name, _) in enumerate(order):
        inputs[name].append(Interval(low[:, k], high[:, k]))
    program, along = (region.f, ("x", "w")) if of_f else (region.h, ("x",))
    done = programs.every(program, inputs, along)
    outputs = programs.forms(program, done)
    columns = [("x", k) for k in range(n)] + [("w", k) for k in range(q if of_f else 0)]
    shape = (len(low), len(outputs), len(columns))
    M, E, size, used = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
    moved: dict[tuple[str, int, int], Array] = {}
    rates = {at: rate_of(done[at], part) for at, part in enumerate(programs.relative(program, done))}
    for i, form in enumerate(outputs):
        for key, factor in form.items():
            slopes = done[key[1]][1] if key[0] == "atom" else {key: iv.number(1.0, factor)}
            c, dc = halves(factor)
            rate = rates[key[1]] if key[0] == "atom" else None
            for column, slope in slopes.items():
                if column not in columns:
                    continue
                j, (g, dg) = columns.index(column), halves(slope)
                top, left = np.abs(g) + dg, dg
                if rate is not None:
                    share, off = halves(rate.slopes[column])
                    with np.errstate(invalid="ignore"):
                        v, dv, far = rate.middle, rate.radius, np.abs(rate.middle) + rate.radius
                        g, left = np.where(rate.used, v * share, g), np.where(rate.used, far * off, dg)
                        top = np.where(rate.used, far * (np.abs(share) + off), top)
                        joint = np.where(rate.used, c * dv * share, 0.0)
                    moved.setdefault(("rate", key[1], 0), np.zeros(shape))[:, i, j] += joint
                    used[:, i, j] |= rate.used
                M[:, i, j] += c * g
                size[:, i, j] += np.abs(c) * top
                E[:, i, j] += np.where(dc > 0, dc * top, 0.0)
                if np.any(left > 0):
                    alone = sum(key in other for other in outputs) == 1
                    if alone:  # slopes that nothing ties together: their sizes add up
                        moved.setdefault(("row", i, j), np.zeros(shape))[:, i, j] += np.abs(c) * left
                    else:
                        moved.setdefault((*key, j), np.zeros(shape))[:, i, j] += c * left
    moving = np.array(list(moved.values())).reshape(len(moved), *shape)
    with np.errstate(invalid="ignore"):
        terms = EPS * (len(program.code) + 4) * size
    still = (E == 0) & (np.abs(moving).sum(axis=0) == 0) & ~used
    exact = still & single(outputs, done, columns)
    return M, E + np.where(exact, 0.0, np.where(np.isnan(terms), np.inf, terms)), moving


def single(outputs: list[programs.Form], done: list[programs.Both], columns: list[tuple[str, int]]) -> Mask:
    """Entries (rows, columns) that one product with a factor of 1 or -1, or none, makes: these are not rounded."""
    count = np.zeros((len(outputs), len(columns)))
    for i, form in enumerate(outputs):
        for key, factor in form.items():
            for column in done[key[1]][1] if key[0] == "atom" else (key,):
                if column in columns:
                    one = factor.known() and abs(factor.low[0]) == 1 if len(factor.low) else True
                    bare = key[0] != "atom" and factor.known() if len(factor.low) else True
                    count[i, columns.index(column)] += 1 if one or bare else 2
    found: Mask = count <= 1
    return found


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
