"""Grid tables for the sphere: rows at grid times with two derivatives, and how far time can bend between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sampling_design.numerics.linalg import right_directions
from sampling_design.observability.worst_case.spaced_rows import OutputGroup, SpacedRows
from sampling_design.records.arrays import Array, Integers

_EPS = float(np.finfo(float).eps)
_TINY = float(np.finfo(float).tiny)
_NUMBERS = 6_000_000  # most numbers in a table of all points of a grid; of finer ones those that are asked for are made
MOST_CELLS = 2**40  # cells of the finest grid, about
_WIDER = 0.25  # a first cell is no wider than this part of its time since the first sample, or of the spacing
_MOST_MOVES = 512  # cells of the moves of a reading
_MOST_STARTS = 1024  # starts of a table at most
_LOOKS = 64  # starts at which the length of a state at the window's start is looked at
_FARTHEST = 20.0  # powers of e by which it may grow between two of them; beyond, the first sample's slab is not used
_UNOBSERVED = 1e-6  # part of the strongest axis below which the first sample counts as not seeing an axis
_CONDITION = 1e6  # of e^{AS}, beyond which states are not carried from the first sample back to the window's start


class CurveTable(NamedTuple):
    """Rows R(t) at M knots, with what bends their Gram matrices G = R'R in the cells that follow them, h wide.

    rows, turning, bending : (M, p, n) arrays
        R and its first two derivatives: G'' = 2 turning'turning + rows'bending + bending'rows.
    eighth : (M,) array
        h^2/8; with the width of a cell of moves squared beside h^2, where readings move.
    beyond : (M,) array
        (h^2/8)^2 times a proven bound on |d^4 G/dt^4| within the cell.
    size, wrong : (M,) arrays
        |R|; and what the rounding of R itself, a product, can take from z'Gz, |z| = 1, beyond the part `forgiven`.
    rounding : (M,) array
        Of y'Gz and of its place in a sum of k, for |y| |z| = 1.
    step, swing, astray : (M,) arrays
        The wider of the two cells at a knot, a proven bound on |R''| within them, and what rounding may do to |Rz|.
    """

    rows: Array
    turning: Array
    bending: Array
    eighth: Array
    beyond: Array
    size: Array
    wrong: Array
    rounding: Array
    step: Array
    swing: Array
    astray: Array

    def against(self, y: Array, at: Integers) -> tuple[Array, Array, Array]:
        """Gy and G''y, (B, k, n, W), and |Ry| (B, k, W), at the knots `at` (B, k, W), for y (B, n)."""
        seen, turning, bending = self.rows[at], self.turning[at], self.bending[at]
        of_y, turned, bent = (np.einsum("bkwpn,bn->bkwp", part, y) for part in (seen, turning, bending))
        value = np.einsum("bkwpn,bkwp->bknw", seen, of_y)
        second = np.einsum("bkwpn,bkwp->bknw", seen, bent) + np.einsum("bkwpn,bkwp->bknw", bending, of_y)
        second += 2 * np.einsum("bkwpn,bkwp->bknw", turning, turned)
        return value, second, np.linalg.norm(of_y, axis=3)

    def least_observed(self, centre: Array, half: Array, at: Integers) -> Array:
        """At most |R(t)z| for all z in the boxes centre +- half and t in the cells next to the knots `at` (B, k, W)."""
        seen, turning = self.rows[at], self.turning[at]
        value, slope = (np.abs(np.einsum("bkwpn,bn->bkwp", part, centre)) for part in (seen, turning))
        wide, steep = (np.einsum("bkwpn,bn->bkwp", np.abs(part), half) for part in (seen, turning))
        away = np.linalg.norm(np.abs(centre) + half, axis=1)[:, None, None, None]
        step = self.step[at][..., None]
        least = value - wide - step * (slope + steep) - (step**2 / 2 * self.swing[at][..., None]) * away
        return np.asarray(least.max(axis=3) - self.astray[at] * away[..., 0])

    def rounded(self, y: Array, half: Array, of_y: Array, at: Integers) -> Array:
        """What rounding can take from y'Gc at the corners c of the cell y +- half, (B, k, W), where |Ry| is `of_y`.

        Products with Ry as it was rounded lose a part of |Ry| |R| |c|; Ry itself is off by a part of |R| |y|, times
        |Rc| <= |Ry| + |R| |c - y|. So little is lost where y is hardly seen and the cell is small.
        """
        long, wide = (np.linalg.norm(part, axis=1)[:, None, None] for part in (y, half))
        size = np.maximum(self.size[at], _TINY)
        lost = self.rounding[at] * np.minimum(2 * of_y / size + wide + _EPS * long, long)
        return np.asarray((long + wide) * (lost + self.wrong[at] * (long + wide)))


class StartTable(NamedTuple):
    """Starts u on an even grid of [0, S]: what a state at the first sample was at the window's start.

    flow : (Q + 1, n, n) array
        e^{-Au} L.
    norm, bend : (Q + 1, n, n) arrays
        N(u) = flow'flow, and -N''(u).
    eighth : float
        h^2/8 of a cell.
    beyond : float
        h^2/8 times a proven bound on |d^4 N/du^4|.
    rounding : (Q + 1,) array
        Of y'Nz for |y| |z| = 1.
    """

    flow: Array
    norm: Array
    bend: Array
    eighth: float
    beyond: float
    rounding: Array


class SphereTables:
    """Tables in the coordinates x = L z of the state at the first sample, made when asked for and kept.

    A schedule is a start u and slacks v_1 = 0 <= v_2 <= ... <= v_k <= S - u; the state at the window's start is
    e^{-Au} x. Where e^{AS} is too ill-conditioned for that, the state at the window's start takes the place of the
    first sample's, which is then as free as the others (`pulled` is False).

    Rows y + e with |e| <= delta have |y + e|^2 >= (1 - g) |y|^2 - delta^2/g for every g in (0, 1). `forgiven`
    is g: the caller takes this part off every bound, and 2 delta^2/g/(1 - g) is `blur` for the exponentials' share of
    e, `wrong` for that of their product with L: |a + b|^2 <= 2 |a|^2 + 2 |b|^2.
    """

    def __init__(self, rows: SpacedRows, worst: Array, forgiven: float, moves: Array | float = 0.0) -> None:
        self.rows, self.forgiven, self._moves = rows, forgiven, moves
        with np.errstate(all="ignore"):
            there, back = rows.plant.transition(np.array([rows.slack, -rows.slack]))
            self.pulled = bool(np.linalg.norm(there) * np.linalg.norm(back) < _CONDITION)
        self.basis, self.inverse = rows.coordinates(worst - worst[0] if self.pulled else worst, moves)
        turn = self._rotation(worst)
        self.basis, self.inverse = self.basis @ turn, turn.T @ self.inverse
        inner = self.inverse @ rows.A @ self.basis
        self.speed = float(np.linalg.norm(inner, 2))
        # the logarithmic norm bounds |e^{+-A t}| far better than the norm: oscillators hardly grow
        self.growth = max(0.0, float(np.abs(np.linalg.eigvalsh((inner + inner.T) / 2)).max(initial=0.0)))
        self._drift = self._moved_by(rows) if rows.moving else 0.0
        self._whole = max(2, _NUMBERS // (3 * rows.count * rows.p * rows.n))
        self._near = worst - worst[0]
        self._first = self._first_knots()
        self._kept: dict[tuple[int, int], tuple[CurveTable, Array]] = {}
        self._starts: dict[int, StartTable] = {}

    def _moved_by(self, rows: SpacedRows) -> float:
        """At least what readings can differ from those at the middle of their times, |z| = 1: |RA| times the move."""
        slopes = [np.linalg.norm(rows.read(group, np.array(group.lag)) @ rows.A @ self.basis) for group in rows.groups]
        radii = np.array([group.radius for group in rows.groups])
        with np.errstate(over="ignore"):
            drifts = radii * slopes * np.exp(self.growth * radii)
        return float(
            np.linalg.norm(drifts)
            + np.linalg.norm(rows.blur(rows.plant.transition(rows.lags))) * np.linalg.norm(self.basis)
        )

    def _rotation(self, worst: Array) -> Array:
        """The rotation to the axes that the first sample sees, then to those of the worst schedule known.

        Cells lie along these axes: thin where schedules see much, long where they see little.
        """
        seen = self.rows.observed((worst - worst[0] if self.pulled else worst)[None], self._moves)[0] @ self.basis
        self.slab = np.zeros(0)
        self._states = self._back() if self.pulled else np.zeros((0, self.rows.n, self.rows.n))
        if not len(self._states):
            return np.asarray(right_directions(seen)[1].T)
        sees, axes = right_directions(self.rows.middle @ self.basis)
        self.slab = sees[sees > _UNOBSERVED * sees[0]]
        first, rest = axes[: self.slab.size].T, axes[self.slab.size :].T
        within = right_directions(seen @ rest)[1].T if rest.shape[1] else np.zeros((0, 0))
        turn = np.hstack([first, rest @ within])
        flow = float(np.linalg.norm(self._states, axis=(1, 2)).max())
        self._astray = self.rows.grade * flow * float(np.linalg.norm(self.basis))  # by rounding, of a state's length
        self._states = self._states @ self.basis @ turn
        return np.asarray(turn)

    def _back(self) -> Array:
        """e^{-Au} at even starts u, lengthened for all starts next to it; none where that takes much."""
        starts = self.rows.slack * np.arange(_LOOKS + 1) / _LOOKS
        A = self.rows.A
        between = self.rows.slack / (2 * _LOOKS) * float(np.abs(np.linalg.eigvalsh((A + A.T) / 2)).max(initial=0.0))
        if between > _FARTHEST:
            return np.zeros((0, *A.shape))
        return np.asarray(self.rows.plant.transition(-starts) * np.exp(between))

    def slabs(self, centre: Array, half: Array, wanted: float) -> Array:
        """How far along each of the first sample's axes a state in the boxes centre +- half can lie, (B, len(slab)).

        A worst state z has |R z|^2 <= z'Gz = lambda |x|^2, R the first sample's rows and x the state at the window's
        start: along R's axes it is no longer than sqrt(wanted) |x|/(what R sees of them), or lambda is `wanted`.
        """
        longest = self.longest(centre, half)
        away = np.linalg.norm(np.abs(centre) + half, axis=1)
        lost = 4 * self.rows.n * _EPS * float(np.linalg.norm(self.rows.middle) * np.linalg.norm(self.basis)) * away
        lost = lost + self._drift * away
        return np.asarray((np.sqrt(wanted) * longest + lost)[:, None] / self.slab)

    def longest(self, centre: Array, half: Array) -> Array:
        """At least the length |x| at the window's start of all states in the boxes centre +- half, (B,)."""
        at = np.linalg.norm(np.einsum("unm,bm->bun", self._states, centre), axis=2)
        wide = np.linalg.norm(self._states, axis=1)
        away = np.linalg.norm(np.abs(centre) + half, axis=1)
        return np.asarray((at + half @ wide.T).max(axis=1) + self._astray * away)

    def first_cells(self) -> int:
        """A power of two of cells on which the plant turns by no more than half a radian."""
        wanted = 2 ** np.ceil(np.log2(max(2 * self.speed * self.rows.slack, 16.0)))
        return int(min(wanted, 2 ** np.floor(np.log2(self._whole))))

    def _first_knots(self) -> Array:
        """Knots of the first grid: near the samples of the worst schedule known as fine as the spacing."""
        S, wide = self.rows.slack, self.rows.slack / self.first_cells()
        if not self.pulled:
            return np.linspace(0.0, S, self.first_cells() + 1)
        knots = [0.0]
        while knots[-1] < S:
            away = float(np.min(np.abs(self._near - knots[-1])))
            knots.append(knots[-1] + min(wide, max(_WIDER * (away + self.rows.spacing), 1e-12 * S)))
        return np.append(np.array(knots[:-1]) * (S / knots[-1]), S)

    @property
    def least_cells(self) -> int:
        """Cells of the first grid; every finer one has a power of two times as many."""
        return len(self._first) - 1

    def knot(self, cells: int, point: Integers) -> Array:
        """The slacks of points of a grid of `cells` cells."""
        return np.interp(point / (cells // self.least_cells), np.arange(self.least_cells + 1), self._first)

    def steps(self, cells: int, point: Integers) -> Array:
        """How wide the cells are that follow these points; 0 at the end."""
        return self.knot(cells, np.minimum(point + 1, cells)) - self.knot(cells, point)

    def moves(self, cells: int, group: OutputGroup) -> int:
        """Cells of a group's moves that go with a grid of `cells` cells: no finer than those, and as a first cell."""
        first = max(4 * self.speed * group.radius, 1.0) * (cells / self.least_cells)
        return int(np.clip(np.ceil(min(first, 2 * group.radius * cells / self.rows.slack)), 1, _MOST_MOVES))

    def copies(self, cells: int) -> int:
        """How many rows there are at each point of a grid, of all groups and their moves."""
        return sum(group.moves(self.moves(cells, group)).size for group in self.rows.groups)

    def at(self, cells: int, point: Integers, which: int = 0) -> tuple[CurveTable, Array, Integers]:
        """Rows C e^{At} L of a group, their blur, and where in these tables the points (B, k, W) of a grid stand.

        With q moves of its readings, (B, k, W q). `blur` is what rounding in the exponentials can take from x'Gx,
        |x| = 1, beyond the part `forgiven`.
        """
        group, size = self.rows.groups[which], self.rows.count * (cells + 1)
        moves = group.moves(self.moves(cells, group)).size
        place = np.arange(self.rows.count)[:, None] * (cells + 1) + point
        place = (place[..., None] + size * np.arange(moves)).reshape(*place.shape[:-1], -1)
        if cells * moves <= self._whole:
            if (cells, which) not in self._kept:
                self._kept[cells, which] = self._sampled(cells, np.arange(size * moves), group)
            return *self._kept[cells, which], place
        places, at = np.unique(place, return_inverse=True)
        return *self._sampled(cells, places, group), at.reshape(place.shape)

    def _sampled(self, cells: int, places: Integers, group: OutputGroup) -> tuple[CurveTable, Array]:
        """Table and blur of sample places // (cells + 1) at point places % (cells + 1), move after move."""
        move, place = np.divmod(places, self.rows.count * (cells + 1))
        sample, point = np.divmod(place, cells + 1)
        slack, moves = self.knot(cells, point), group.moves(self.moves(cells, group))
        times = np.minimum(slack + self.rows.offsets[sample], self.rows.window) + group.lag + moves[move]
        step, across = self.steps(cells, point), 2 * group.radius / max(moves.size - 1, 1)
        widest = np.maximum(step, slack - self.knot(cells, np.maximum(point - 1, 0))) + across
        astray = self.rows.blur(self.rows.plant.transition(times))
        blur = 2 * astray**2 / self.forgiven / (1 - self.forgiven)
        curve = self._curve(self.rows.read(group, times), step, self.rows.A, widest, astray, across)
        return curve, blur

    def starts(self, cells: int) -> StartTable:
        """The starts that go with a grid of `cells` cells; one alone where the state is not carried back."""
        cells = min(cells, _MOST_STARTS) if self.pulled else 0
        if cells not in self._starts:
            self._starts[cells] = self._started(cells)
        return self._starts[cells]

    def room(self, cells: int, point: Integers) -> Array:
        """How far along the grid of starts the latest one is that leaves room for a last slack at `point`."""
        most = len(self.starts(cells).flow) - 1
        return np.asarray(np.clip((1 - self.knot(cells, point) / self.rows.slack) * most, 0, most))

    def _started(self, cells: int) -> StartTable:
        rows = self.rows
        knots = rows.slack * np.arange(cells + 1) / max(cells, 1)
        flow = rows.plant.transition(-knots)
        step = rows.slack / cells if cells else 0.0
        even = np.full(cells + 1, step)
        curve = self._curve(flow, even, -rows.A, even, 0 * even)
        seen, turning, bending = curve.rows, curve.turning, curve.bending
        across = np.swapaxes(seen, 1, 2) @ bending
        second = 2 * np.swapaxes(turning, 1, 2) @ turning + across + np.swapaxes(across, 1, 2)
        eighth = step**2 / 8
        size = np.linalg.norm(seen, axis=(1, 2))
        lost = 3 * rows.grade * np.linalg.norm(flow, axis=(1, 2)) * np.linalg.norm(self.basis) * size
        lost += 4 * _EPS * self.speed * rows.slack * size**2  # of the place between two starts
        beyond = float(np.max(curve.beyond)) / eighth if cells else 0.0
        return StartTable(seen, np.swapaxes(seen, 1, 2) @ seen, -second, eighth, beyond, curve.rounding + lost)

    def _curve(
        self, values: Array, step: Array, A: Array, widest: Array, blur: Array, across: float = 0.0
    ) -> CurveTable:
        """The table of M e^{At} L, given M e^{At} (M, p, n) at the knots, the widths of their cells, and its blur.

        `across` is the width of cells of moves: of t + e both are chords, one after the other.
        """
        p, n = values.shape[-2:]
        derivative = [values @ self.basis]
        wrong = 2 * (n * _EPS * np.linalg.norm(values, axis=(1, 2)) * np.linalg.norm(self.basis)) ** 2
        astray = (blur + n * _EPS * np.linalg.norm(values, axis=(1, 2))) * np.linalg.norm(self.basis)
        wrong /= self.forgiven * (1 - self.forgiven)
        for _ in range(4):
            values = values @ A
            derivative.append(values @ self.basis)
        size = [np.linalg.norm(d, axis=(1, 2)) for d in derivative]
        a = [d * np.exp(self.growth * (step + across)) for d in size]
        fourth = 2 * a[0] * a[4] + 8 * a[1] * a[3] + 6 * a[2] ** 2
        rounding = 8 * (self.rows.count + n + p) ** 1.5 * _EPS * size[0] ** 2
        seen, turning, bending, eighth = *derivative[:3], (step**2 + across**2) / 8
        return CurveTable(
            *(seen, turning, bending, eighth),
            beyond=fourth * eighth**2,
            size=size[0],
            wrong=wrong,
            rounding=rounding,
            step=widest,
            swing=size[2] * np.exp(self.growth * widest),
            astray=astray,
        )
