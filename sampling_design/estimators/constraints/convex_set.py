"""Convex sets in which a signal lies: boxes, linear inequalities, norm balls, and their intersections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_list
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask, freeze
from sampling_design.records.record import Record

EMPTY_MARGIN = 1e-9
"""A set counts as empty if every point violates it by more than this, relative to the sizes it names."""


@dataclass(frozen=True, eq=False)
class NormBall:
    """{z : |shape (z - centre)| <= radius}."""

    radius: float
    centre: Array
    shape: Array

    def inverse(self) -> Array | None:
        """Return the pseudo-inverse of the shape, None where its columns depend on each other, in any units."""
        size = np.linalg.norm(self.shape, axis=0)
        if not size.all() or np.linalg.matrix_rank(self.shape / size) < size.size:
            return None
        return np.asarray(np.linalg.pinv(self.shape / size) / size[:, None])


@dataclass(frozen=True, eq=False, repr=False)
class ConvexSet(Record):
    """The intersection of a box, half-spaces and norm balls in R^k.

        lower <= z <= upper,    rows z <= offsets,    |shape_i (z - centre_i)| <= radius_i

    Parameters
    ----------
    lower, upper : (k,) arrays
        May hold -inf and inf.
    rows : (m, k) array; offsets : (m,) array
    balls : tuple of NormBall

    Raises
    ------
    ArgumentError
        If shapes differ, a bound is NaN, a radius is negative, or the set is empty.

    Examples
    --------
    >>> disc = ConvexSet.box([-1, -1], [1, 1]) & ConvexSet.ball(1.2, dimension=2)
    >>> disc.contains([1.0, 0.5]), disc.contains([1.0, 0.9])
    (True, False)
    """

    lower: Array
    upper: Array
    rows: Array
    offsets: Array
    balls: tuple[NormBall, ...] = ()

    _table = {
        "dimension": "{dimension}",
        "lower": "{lower:up}",
        "upper": "{upper:down}",
        "half-spaces": "{rows.shape[0]}",
        "balls": "{balls.__len__}",
    }

    def __post_init__(self) -> None:
        lower, upper = _bounds("lower", self.lower), _bounds("upper", self.upper)
        k = lower.size
        if upper.size != k:
            raise ArgumentError(f"`upper` must have {k} entries as `lower` has, got {upper.size}.")
        rows = checks.matrix("rows", np.zeros((0, k)) if self.rows is None else self.rows, None, k)
        offsets = checks.vector("offsets", np.zeros(0) if self.offsets is None else self.offsets, rows.shape[0])
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            raise ArgumentError(
                f"`lower` must not exceed `upper`: the set is empty, got {lower[i]} > {upper[i]} at {i}."
            )
        self._hold(lower=lower, upper=upper, rows=rows, offsets=offsets)
        if not checks.holds(self.balls, NormBall):
            raise ArgumentError(f"`balls` must be a tuple of balls, got {checks.described(self.balls)}.")
        if rows.shape[0] + len(self.balls) > 0:
            self._refuse_empty()

    @classmethod
    def box(cls, lower: npt.ArrayLike, upper: npt.ArrayLike) -> ConvexSet:
        """Return {z : lower <= z <= upper}; entries may be infinite."""
        return cls(lower, upper, None, None)  # type: ignore[arg-type]

    @classmethod
    def halfspaces(cls, rows: npt.ArrayLike, offsets: npt.ArrayLike) -> ConvexSet:
        """Return {z : rows z <= offsets}."""
        matrix = checks.matrix("rows", rows)
        whole = np.full(matrix.shape[1], np.inf)
        return cls(-whole, whole, matrix, checks.vector("offsets", offsets, matrix.shape[0]))

    @classmethod
    def ball(
        cls,
        radius: float,
        *,
        dimension: int | None = None,
        centre: npt.ArrayLike | None = None,
        shape: npt.ArrayLike | None = None,
    ) -> ConvexSet:
        """Return {z : |shape (z - centre)| <= radius}; centre 0 and shape I by default.

        Raises
        ------
        ArgumentError
            If the radius is negative or nothing says the dimension.
        """
        size = checks.nonnegative("radius", radius)
        if shape is not None:
            E = checks.matrix("shape", shape)
            k = E.shape[1]
        elif dimension is None and centre is None:
            raise ArgumentError("`dimension` must be given for a ball without `centre` and `shape`.")
        else:
            k = checks.floats("centre", centre).size if dimension is None else checks.whole("dimension", dimension, 1)
            E = freeze(np.eye(k))
        middle = checks.vector("centre", np.zeros(k) if centre is None else centre, k)
        whole = np.full(k, np.inf)
        return cls(-whole, whole, None, None, (NormBall(size, middle, E),))  # type: ignore[arg-type]

    @classmethod
    def known(
        cls, lower: Array, upper: Array, rows: Array, offsets: Array, balls: tuple[NormBall, ...] = ()
    ) -> ConvexSet:
        """Return the set of these parts, known to be in order and not empty: nothing is checked."""
        found = object.__new__(cls)
        found._hold(lower=lower, upper=upper, rows=rows, offsets=offsets, balls=balls)
        return found

    def __and__(self, other: ConvexSet) -> ConvexSet:
        if other.dimension != self.dimension:
            raise ArgumentError(f"sets must have one dimension, got {self.dimension} and {other.dimension}.")
        return ConvexSet(
            np.maximum(self.lower, other.lower),
            np.minimum(self.upper, other.upper),
            np.vstack([self.rows, other.rows]),
            np.concatenate([self.offsets, other.offsets]),
            self.balls + other.balls,
        )

    @property
    def dimension(self) -> int:
        """k."""
        return self.lower.size

    @property
    def is_box(self) -> bool:
        """Whether there are bounds on single entries only."""
        return not self.balls and self.rows.shape[0] == 0

    @cached_property
    def bounded(self) -> Index:
        """Indices of the entries that have a bound of their own."""
        return np.flatnonzero(np.isfinite(self.lower) | np.isfinite(self.upper))

    @property
    def round_balls(self) -> tuple[NormBall, ...]:
        """The balls that are more than a point."""
        return tuple(ball for ball in self.balls if ball.radius > 0)

    @property
    def _is_ball(self) -> bool:
        whole = np.isinf(self.lower).all() and np.isinf(self.upper).all()
        return bool(whole) and self.rows.shape[0] == 0 and len(self.balls) == 1

    def excess(self, values: npt.ArrayLike) -> float:
        """Return by how much the worst of (N, k) `values` leaves the set (0 or negative: none does)."""
        z = checks.floats("values", values)
        if not self.dimension or z.shape[-1:] != (self.dimension,):
            if z.size and self.dimension:
                raise ArgumentError(f"`values` must have {self.dimension} columns, got shape {z.shape}.")
            return -np.inf
        z = z.reshape(-1, self.dimension)
        if z.shape[0] == 0:
            return -np.inf
        worst = max(float(np.max(self.lower - z, initial=-np.inf)), float(np.max(z - self.upper, initial=-np.inf)))
        if self.rows.shape[0]:
            worst = max(worst, float(np.max(z @ self.rows.T - self.offsets)))
        for ball in self.balls:
            distance = np.linalg.norm((z - ball.centre) @ ball.shape.T, axis=1)
            worst = max(worst, float(np.max(distance)) - ball.radius)
        return worst

    def contains(self, value: npt.ArrayLike, tolerance: float = 0.0) -> bool:
        """Whether `value` lies in the set, up to `tolerance` in each inequality."""
        return self.excess(value) <= tolerance

    def magnitude(self) -> Array | None:
        """Return a bound on the signal, as `checks.bound` makes them: on its norm (0-d), on its entries, or None."""
        if self._is_ball:
            ball = self.balls[0]
            if not ball.centre.any() and np.array_equal(ball.shape, np.eye(self.dimension)):
                return np.asarray(ball.radius)
        lower, upper = self.bounding_box()
        bound = np.maximum(np.abs(lower), np.abs(upper))
        return bound if np.isfinite(bound).all() else None

    def bounding_box(self) -> tuple[Array, Array]:
        """Return bounds on each entry, from all parts of the set (by linear programs where there are half-spaces)."""
        lower, upper = self.lower.copy(), self.upper.copy()
        for ball in self.balls:
            back = ball.inverse()
            if back is not None:
                reach = ball.radius * np.linalg.norm(back, axis=1)
                lower, upper = np.maximum(lower, ball.centre - reach), np.minimum(upper, ball.centre + reach)
        if self.rows.shape[0]:
            lower, upper = _linear_extent(self.rows, self.offsets, lower, upper)
        return lower, upper

    def _refuse_empty(self) -> None:
        if self._is_ball:
            return
        from sampling_design.numerics import conic_programs

        units = _sizes_of_entries(*self._all_rows(), self.lower, self.upper)
        n, low, high = self.dimension, np.isfinite(self.lower), np.isfinite(self.upper)
        rows, offsets = _of_norm_one(self.rows * units, self.offsets)
        rows = np.vstack([-np.eye(n)[low], np.eye(n)[high], rows, np.zeros((1, n))])
        offsets = np.concatenate([-(self.lower / units)[low], (self.upper / units)[high], offsets, [1.0]])
        blocks = [("nonnegative", np.column_stack([rows, -np.ones(len(rows))]), offsets)]  # the last: excess >= -1
        sizes = [1.0, *np.abs(offsets)]
        for ball in self.balls:
            largest = np.max(np.abs(ball.shape * units), initial=0.0) or ball.radius or 1.0
            shape, radius = ball.shape * units / largest, ball.radius / largest
            matrix = np.vstack([np.zeros(n), -shape])
            bound = np.concatenate([[radius], -shape @ (ball.centre / units)])
            blocks.append(("second order", np.column_stack([matrix, -np.eye(len(matrix))[0]]), bound))
            sizes += [radius, *np.abs(bound[1:])]
        found = conic_programs.solve_cone_program(np.eye(n + 1)[n], blocks)
        excess = found.x[n]
        if conic_programs.usable(found.record) and excess > EMPTY_MARGIN * max(sizes):
            raise ArgumentError(f"the set is empty: every point violates it by {excess:.3g} of its size or more.")

    def _all_rows(self) -> tuple[Array, Array]:
        """Half-spaces and rows of balls, and how large z may be by each of them, about: for scaling only."""
        shapes = [ball.shape for ball in self.balls]
        reach = [ball.radius + np.abs(ball.shape @ ball.centre) for ball in self.balls]
        return np.vstack([self.rows, *shapes]), np.concatenate([self.offsets, *reach])

    def explain(self) -> str:
        """Say what bounds the set."""
        return f"A convex set in R^{self.dimension}: a box, {self.rows.shape[0]} half-spaces, {len(self.balls)} balls."


def normed(matrix: Array) -> Array:
    """Return a matrix with columns of norm 1 (zero columns stay)."""
    size = np.linalg.norm(matrix, axis=0)
    return np.asarray(matrix / np.where(size > 0, size, 1.0))


def set_like(name: str, value: object) -> ConvexSet | tuple[Array, Array] | None:
    """Return `value`, a ConvexSet or a pair (lower, upper) of arrays of any length; None stays None.

    Raises ArgumentError if it is something else.
    """
    if value is None or isinstance(value, ConvexSet):
        return value
    if not is_list(value) or len(value) != 2:
        raise ArgumentError(f"`{name}` must be a ConvexSet or a pair (lower, upper), got {checks.described(value)}.")
    lower, upper = (checks.floats(name, side) for side in value)
    return lower, upper


def convex_set(name: str, value: object, dimension: int) -> ConvexSet | None:
    """Return `value`, a ConvexSet or a pair (lower, upper), as a set in R^dimension; None stays None.

    Raises ArgumentError if it is something else or has another dimension.
    """
    match set_like(name, value):
        case None:
            return None
        case ConvexSet() as found:
            pass
        case sides:
            lower, upper = (np.broadcast_to(side, (dimension,)) if side.ndim == 0 else side for side in sides)
            found = ConvexSet.box(lower, upper)
    if found.dimension != dimension:
        raise ArgumentError(f"`{name}` must have dimension {dimension}, got {found.dimension}.")
    return found


def all_inside(chosen: ConvexSet, values: Array, measured: Mask | None = None) -> bool:
    """Whether all (N, k) values lie in a set, of which entries not `measured` are free; nothing is checked.

    Half-spaces and balls count only where all of a value is measured.
    """
    inside = (values >= chosen.lower) & (values <= chosen.upper)
    measured = None if measured is None else np.asarray(measured, dtype=bool)
    if not (inside if measured is None else inside | ~measured).all():
        return False
    if chosen.is_box:
        return True
    whole = values if measured is None else values[measured.all(axis=1)]
    return not len(whole) or chosen.excess(whole) <= 0


def _bounds(name: str, value: object) -> Array:
    array = checks.floats(name, value)
    if array.ndim != 1 or np.isnan(array).any():
        raise ArgumentError(f"`{name}` must be a vector without NaN, got {checks.described(value)}.")
    array.flags.writeable = False
    return array


def _linear_extent(rows: Array, offsets: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Tighten a box by half-spaces, entry by entry; an entry that stays unbounded keeps its infinity."""
    from scipy.optimize import linprog

    units = _sizes_of_entries(rows, offsets, lower, upper)  # the solver's tolerances are absolute
    rows, offsets = _of_norm_one(rows * units, offsets)
    box = list(zip(lower / units, upper / units, strict=True))
    low, high = lower.copy(), upper.copy()
    for i in range(lower.size):
        for sign, side, inner in ((1.0, low, np.maximum), (-1.0, high, np.minimum)):
            cost = np.zeros(lower.size)
            cost[i] = sign
            found = linprog(cost, A_ub=rows, b_ub=offsets, bounds=box)
            if found.status == 0:
                value = sign * float(found.fun or 0.0)
                # outward by the solver's own tolerance, so that nothing of the set is cut off
                side[i] = inner(side[i], units[i] * (value - sign * 1e-7 * max(1.0, abs(value))))
    return low, high


def _of_norm_one(rows: Array, offsets: Array) -> tuple[Array, Array]:
    """The same half-spaces by rows of norm 1; of a row of zeros the offset is."""
    size = np.linalg.norm(rows, axis=1)
    size = np.where(size > 0, size, np.abs(offsets))
    size[size == 0] = 1.0
    return rows / size[:, None], offsets / size


def _sizes_of_entries(rows: Array, offsets: Array, lower: Array, upper: Array) -> Array:
    """Powers of two (k,), about as large as entries of the set: what bounds and half-spaces leave to each alone.

    An entry of which offsets say nothing is as large as the entries that it stands beside.
    """
    sizes = np.zeros(lower.size)
    for _ in range(lower.size):
        with np.errstate(divide="ignore", invalid="ignore"):
            left = (np.abs(offsets) + np.abs(rows) @ sizes)[:, None] / np.abs(rows)
        left = np.vstack([left, np.abs(lower), np.abs(upper)])
        for j in np.flatnonzero(sizes == 0):
            met = left[np.isfinite(left[:, j]) & (left[:, j] > 0), j]
            sizes[j] = 2.0 ** np.round(np.log2(np.median(met))) if met.size else 0.0
    return np.where(sizes > 0, sizes, 1.0)
