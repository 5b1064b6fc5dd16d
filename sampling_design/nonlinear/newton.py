"""Newton's method for a window that starts near its solution: its intervals eliminated, its nodes by Riccati's step.

A window that was solved before is solved again after few steps, and each costs a fraction of one of IPOPT's, whose
linear algebra knows nothing of intervals. Bounds of w and v become active or are left by the signs of their
multipliers, and where those go round in a circle, interior points of the quadratic model say which are active. What
comes out meets the same conditions, to the same tolerance, and its curvature is that of a minimum; else nothing does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from sampling_design.nonlinear.window_forms import LocalForms, ProgramPoint, WindowData, WindowFunctions, WindowSolution
from sampling_design.numerics.linalg import products
from sampling_design.records.arrays import Array
from sampling_design.records.budget import processor_seconds

MOST_STEPS = 8  # linearisations of a window; from a near start three are enough
MOST_CHANGES = 18  # of the active bounds between two linearisations
BY_SIGNS = 6  # changes after which interior points say what is active: signs may go round in a circle
MOST_INTERIOR = 30  # interior points of a quadratic model
CLOSER = 0.1  # share of the complementarity that an interior point aims to leave
NEAREST = 0.995  # share of the way to a bound that a step between interior points goes at most
COMPLEMENTARY = 1e-9  # share of the complementarity that is left where bounds are distinguished from what is free
FALLS = 0.5  # what a step leaves of the residual, at most: beyond it the start was not near


class ActiveBounds(NamedTuple):
    """Which bounds hold: -1 at the lower, 1 at the upper, 0 free; w (K, q), v (K+1, r)."""

    w: Array
    v: Array


class QuadraticMinimum(NamedTuple):
    """Where a quadratic model is least: moves (K+1, n+1) of the nodes and a 1, of w and v.

    by_w, by_v: slopes of the cost by active w and v; forces (K+1, n+1): those of what lies ahead by the state there.
    """

    moves: Array
    w: Array
    v: Array
    by_w: Array
    by_v: Array
    forces: Array


class CondensedModel(NamedTuple):
    """A quadratic model after w and v are eliminated, as affine functions of the state at their node, (dx, 1).

    over (K, n+1, n+1+q): the next state; values (K+1, n+1, n+1): what lies ahead costs at least; the free ones move by
    -w_gains (K, q, n+1) and -v_gains (K+1, r, n+1), active ones by w_moves, v_moves; first (n,): the move of the start.
    """

    over: Array
    values: Array
    w_gains: Array
    v_gains: Array
    w_moves: Array
    v_moves: Array
    first: Array


class CondensedNewton:
    """Newton's method on the windows of one program.

    `boxes` are the bounds of z0, v, w, z of a whole window, `weight` twice the weight of w.
    """

    def __init__(
        self,
        functions: WindowFunctions,
        boxes: tuple[ProgramPoint, ProgramPoint],
        weight: Array,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        self.functions, self.boxes, self.weight, self.tolerance = functions, boxes, weight, tolerance
        self.most = min(MOST_STEPS, max_iterations)

    def solve(
        self, data: WindowData, guess: WindowSolution, columns: dict[str, Array]
    ) -> tuple[WindowSolution, LocalForms, Array] | None:
        """Return the solution next to `guess`, the forms there and what they carry over the intervals.

        None where none is near or states reach bounds.
        """
        try:
            with np.errstate(all="ignore"):  # what is not finite is not near
                return self._solved(data, guess, columns)
        except np.linalg.LinAlgError:
            return None

    def _solved(
        self, data: WindowData, guess: WindowSolution, columns: dict[str, Array]
    ) -> tuple[WindowSolution, LocalForms, Array] | None:
        started, K = processor_seconds(), data.edges.size - 1
        root = np.zeros((data.prior.size, data.prior.size))
        root[np.triu_indices(data.prior.size)] = columns["P2"]
        weights = columns["w"][self.functions.capacity - K :, None, None] * self.weight
        window = _NewtonWindow(data, root, weights, tuple(_last(box, K) for box in self.boxes), self.functions)
        rows = guess.row_multipliers.reshape(guess.point.z.shape)
        point, active = window.first(guess)
        residual = np.inf
        for steps in range(self.most + 1):
            forms = self.functions.at(data, point, rows, columns)
            before, (residual, by_w, by_v) = residual, window.residual(forms, point, rows, active)
            if not np.isfinite(residual) or (steps > 1 and residual > max(FALLS * before, self.tolerance)):
                return None
            carried = forms.carried()
            if steps and residual <= self.tolerance:
                break
            found = window.step(forms, point, active, carried)
            if found is None:
                return None
            moves, rows, active = found
            point = ProgramPoint(*(old + move for old, move in zip(point, moves, strict=True)))
            point = window.onto_bounds(point, active)
        else:
            return None
        # a bound whose multiplier is within the tolerance of 0 may be left either way
        active_bounds = ActiveBounds(
            *(np.where(np.abs(by) > self.tolerance, side, 0) for by, side in zip((by_w, by_v), active, strict=True))
        )
        if not window.allows(point) or _QuadraticModel(window, forms, point, carried).eliminated(active_bounds) is None:
            return None
        solution = guess._replace(
            point=point,
            bound_multipliers=ProgramPoint(0 * point.z0, -by_v, -by_w, 0 * point.z),
            row_multipliers=rows.reshape(K, -1),
            output_multipliers=0 * guess.output_multipliers,
            cost=forms.cost + window.own_cost(point),
            status="ok",
            message="solve succeeded",
            iterations=steps,
            seconds=processor_seconds() - started,
            engine="newton",
        )
        return solution, forms, carried


class _NewtonWindow:
    """One window: what is quadratic in its cost, its bounds, and a step of Newton's method."""

    def __init__(
        self, data: WindowData, root: Array, weights: Array, boxes: tuple[ProgramPoint, ...], functions: WindowFunctions
    ) -> None:
        self.data, self.root, self.weights, self.functions = data, root, weights, functions
        self.lower, self.upper = boxes

    def first(self, guess: WindowSolution) -> tuple[ProgramPoint, ActiveBounds]:
        """Return where to begin: the bounds that were active before are, all else lies inside."""
        values, forces = guess.point, guess.bound_multipliers
        active = ActiveBounds(self.active_of("w", values.w, forces.w), self.active_of("v", values.v, forces.v))
        return self.onto_bounds(guess.point, active), active

    def active_of(self, key: str, value: Array, force: Array) -> Array:
        """Return which bounds hold w or v: those whose multiplier is over what the way to them costs."""
        scale = np.einsum("kii->ki", self.weights) if key == "w" else 1.0
        over, under = (scale * (value - getattr(box, key)) for box in (self.upper, self.lower))
        return np.where(force + over > 0, 1, np.where(force + under < 0, -1, 0))

    def onto_bounds(self, point: ProgramPoint, active: ActiveBounds) -> ProgramPoint:
        """Return the point with what is active exactly at its bound, and w and v within theirs."""
        moved = {}
        for key in ("w", "v"):
            low, high, side = getattr(self.lower, key), getattr(self.upper, key), getattr(active, key)
            inside = np.clip(getattr(point, key), low, high)
            moved[key] = np.where(side > 0, high, np.where(side < 0, low, inside))
        return point._replace(**moved)

    def own_cost(self, point: ProgramPoint) -> float:
        """Return what the start and w cost."""
        start = self.root @ (point.z0 - self.data.prior)
        return float(start @ start + np.einsum("ki,kij,kj->", point.w, self.weights, point.w) / 2)

    def allows(self, point: ProgramPoint) -> bool:
        """Whether all states lie within their bounds."""
        low, high = self.lower, self.upper
        start = np.all((low.z0 <= point.z0) & (point.z0 <= high.z0))
        return bool(start and np.all((low.z <= point.z) & (point.z <= high.z)))

    def residual(
        self, forms: LocalForms, point: ProgramPoint, rows: Array, active: ActiveBounds
    ) -> tuple[float, Array, Array]:
        """Return how far the first-order conditions are from met, and the slopes of the cost by active w and v.

        Each condition counts relative to the size of its terms, if that is over 1: stiff plants round where it is.
        """
        K, n = len(rows), point.z0.size
        flat, z = rows.reshape(K, -1, 1), point.z.reshape(K, -1, 1)
        by_z = (forms.inside.transpose(0, 2, 1) @ flat)[:, :, 0].reshape(point.z.shape)
        magnitude = np.abs(forms.inside)
        size_z = (magnitude.transpose(0, 2, 1) @ np.abs(flat))[:, :, 0].reshape(point.z.shape)
        size_rows = (magnitude @ np.abs(z))[:, :, 0].reshape(point.z.shape)
        by_before, through_w = (np.einsum("kij,ki->kj", part, flat[:, :, 0]) for part in (forms.before, forms.by_w))
        by_z[:, -1] += forms.gradient[1:, :n]
        by_z[:-1, -1] += by_before[1:]
        by_start = 2 * self.root.T @ (self.root @ (point.z0 - self.data.prior)) + forms.gradient[0, :n] + by_before[0]
        by_w = np.einsum("kij,kj->ki", self.weights, point.w) + through_w
        by_v = forms.gradient[:, n:]
        parts = [forms.rows / np.maximum(size_rows, 1.0), by_z / np.maximum(size_z, 1.0), by_start]
        for side, slope in ((active.w, by_w), (active.v, by_v)):
            parts += [np.where(side == 0, slope, np.maximum(side * slope, 0.0))]
        residual = max(float(np.abs(part).max(initial=0.0)) for part in parts)
        return residual, np.where(active.w == 0, 0.0, by_w), np.where(active.v == 0, 0.0, by_v)

    def step(
        self, forms: LocalForms, point: ProgramPoint, active: ActiveBounds, carried: Array
    ) -> tuple[ProgramPoint, Array, ActiveBounds] | None:
        """Return the step to the minimum of the quadratic model within the bounds of w and v, and what it holds.

        The moves of the unknowns, the multipliers of the rows, and the bounds that are active.
        """
        quadratic = _QuadraticModel(self, forms, point, carried)
        for changes in range(MOST_CHANGES):
            found = quadratic.least(active)
            if found is None:
                return None
            new = ActiveBounds(
                self._side(active.w, point.w + found.w, found.by_w, "w"),
                self._side(active.v, point.v + found.v, found.by_v, "v"),
            )
            if np.array_equal(new.w, active.w) and np.array_equal(new.v, active.v):
                return *quadratic.whole(found), active
            inside = quadratic.interior(found) if changes == BY_SIGNS else new
            if inside is None:
                return None
            active = inside
        return None

    def _side(self, side: Array, value: Array, slope: Array, key: str) -> Array:
        """Return what is active after a step: none with a multiplier of the wrong sign, each that is passed."""
        low, high = getattr(self.lower, key), getattr(self.upper, key)
        free = np.where(value > high, 1, np.where(value < low, -1, 0))
        return np.where(side == 0, free, np.where(side * slope <= 0, side, 0))


class _QuadraticModel:
    """The quadratic model of a window at one point: of each interval in (dx, 1, dw), of each node in (dx, 1, dv)."""

    def __init__(self, window: _NewtonWindow, forms: LocalForms, point: ProgramPoint, carried: Array) -> None:
        self.window, self.forms, self.point = window, forms, point
        K, d, n = point.z.shape
        q, r, one = point.w.shape[1], point.v.shape[1], n + 1
        self.Z = carried.reshape(K, d, n, one + q)
        self.over = np.zeros((K, one, one + q))
        self.over[:, :n], self.over[:, n, n] = self.Z[:, -1], 1.0
        own = np.zeros((K, d, q, one + q))
        own[..., one:] = np.eye(q)
        self.inside = np.concatenate([self.Z, own], axis=2)
        self.interval = np.matmul(self.inside.transpose(0, 1, 3, 2), np.matmul(forms.curve, self.inside)).sum(axis=1)
        slope = np.einsum("kij,kj->ki", window.weights, point.w)
        self.interval[:, one:, one:] += window.weights
        self.interval[:, one:, n] += slope
        self.interval[:, n, one:] += slope
        kept = [*range(n), *range(one, one + r)]
        self.node = np.zeros((K + 1, one + r, one + r))
        self.node[np.ix_(range(K + 1), kept, kept)] = forms.bend
        self.node[:, n, kept] = self.node[:, kept, n] = forms.gradient
        self._free: tuple[Array, Array] | None = None  # gains of v, and what nodes cost, while no v is at its bound

    def least(self, active: ActiveBounds, barrier: tuple[Array, ...] = ()) -> QuadraticMinimum | None:
        """Return where the value is least with what is active at its bound; None where it is nowhere.

        `barrier`: steep and linear of w and v, for steep d^2 / 2 + linear d more at each move d of them.
        """
        found = self.eliminated(active, barrier)
        if found is None:
            return None
        K, one = len(self.point.w), self.point.z0.size + 1
        moves = np.ones((K + 1, one))
        moves[0, :-1] = found.first
        closed = found.over[:, :, :one] - found.over[:, :, one:] @ found.w_gains
        for k in range(K):
            moves[k + 1] = closed[k].dot(moves[k])
        w = found.w_moves - products(found.w_gains, moves[:-1])
        v = found.v_moves - products(found.v_gains, moves)
        forces = products(found.values, moves)
        by_w = products(self.interval[:, one:], np.concatenate([moves[:-1], w], axis=1))
        by_w += products(self.over[:, :, one:].transpose(0, 2, 1), forces[1:])
        by_v = products(self.node[:, one:], np.concatenate([moves, v], axis=1))
        return QuadraticMinimum(moves, w, v, by_w, by_v, forces)

    def interior(self, near: QuadraticMinimum) -> ActiveBounds | None:
        """Return which bounds hold where the model is least within them, found by interior points.

        None where they find no minimum. `near` says how large multipliers are.
        """

        def split(flat: Array) -> tuple[Array, Array]:
            return flat[: near.w.size].reshape(near.w.shape), flat[near.w.size :].reshape(near.v.shape)

        low, high, start = (_flat(part.w, part.v) for part in (self.window.lower, self.window.upper, self.point))
        fixed = low == high
        has_low, has_high = np.isfinite(low) & ~fixed, np.isfinite(high) & ~fixed
        count: int = max(1, int(np.count_nonzero(has_low) + np.count_nonzero(has_high)))
        room = CLOSER * np.minimum(high - low, 1.0)  # of what has one bound, in scaled units
        value, force = np.clip(start, low + room, high - room), float(np.abs(_flat(near.by_w, near.by_v)).max())
        under, over = force * has_low, force * has_high
        active_bounds, least = ActiveBounds(*split(fixed.astype(np.float64))), 0.0
        for _ in range(MOST_INTERIOR):
            below, above = np.where(has_low, value - low, 1.0), np.where(has_high, high - value, 1.0)
            gap = float(under @ below + over @ above) / count
            least = least or COMPLEMENTARY * gap
            if gap <= least:
                (w, v), (by_w, by_v) = split(value), split(over - under)
                found_w, found_v = self.window.active_of("w", w, by_w), self.window.active_of("v", v, by_v)
                return ActiveBounds(
                    np.where(active_bounds.w, active_bounds.w, found_w),
                    np.where(active_bounds.v, active_bounds.v, found_v),
                )
            aim_under, aim_over = CLOSER * gap * has_low / below, CLOSER * gap * has_high / above
            steep = under / below + over / above
            linear = aim_over - aim_under - steep * (value - start)
            found = self.least(active_bounds, (*split(steep), *split(linear)))
            if found is None:
                return None
            move = start + _flat(found.w, found.v) - value
            by_under, by_over = aim_under - under * (1 + move / below), aim_over - over * (1 - move / above)
            shares: list[float] = [
                float(np.max(-change / part, initial=0.0, where=part > 0))
                for part, change in (
                    (below, move * has_low),
                    (above, -move * has_high),
                    (under, by_under),
                    (over, by_over),
                )
            ]
            share = min(1.0, NEAREST / max([*shares, 1e-300]))
            value, under, over = value + share * move, under + share * by_under, over + share * by_over
        return None

    def eliminated(self, active: ActiveBounds, barrier: tuple[Array, ...] = ()) -> CondensedModel | None:
        """Minimise over what is free from the last node to the first; None (or LinAlgError) if there is no minimum."""
        n = self.point.z0.size
        one, window = n + 1, self.window
        w_moves, v_moves = self._to_bounds("w", active.w), self._to_bounds("v", active.v)
        over, interval, node = self.over, self.interval, self.node
        if active.w.any():
            over, interval = _at_bounds(over, active.w, w_moves), _both_at_bounds(interval, active.w, w_moves)
        held = bool(active.v.any())
        if held:
            node = _both_at_bounds(node, active.v, v_moves)
        if barrier:
            steep_w, steep_v, linear_w, linear_v = barrier
            interval, node = _bent(interval, n, steep_w, linear_w), _bent(node, n, steep_v, linear_v)
        condensed = None if held or barrier else self._free
        if condensed is None:
            np.linalg.cholesky(node[:, one:, one:])
            v_gains = np.linalg.solve(node[:, one:, one:], node[:, one:, :one])
            condensed = v_gains, node[:, :one, :one] - node[:, :one, one:] @ v_gains
            self._free = self._free if held or barrier else condensed
        v_gains, at = condensed
        values, w_gains = window.functions.eliminated(over, interval, at)
        P, start = values[0], 2 * window.root.T @ window.root
        if not np.isfinite(P).all():
            return None
        slope = P[:n, n] + start @ (self.point.z0 - window.data.prior)
        _, first, trouble = lapack.dposv(P[:n, :n] + start, slope)
        return None if trouble else CondensedModel(over, values, w_gains, v_gains, w_moves, v_moves, -first)

    def _to_bounds(self, key: str, side: Array) -> Array:
        """Return how far what is active is from its bound, 0 for what is free."""
        low, high, value = (getattr(part, key) for part in (self.window.lower, self.window.upper, self.point))
        go = np.zeros(side.shape)
        up, down = side > 0, side < 0
        go[up], go[down] = (high - value)[up], (low - value)[down]
        return go

    def whole(self, found: QuadraticMinimum) -> tuple[ProgramPoint, Array]:
        """Return the moves of all unknowns, and the multipliers of the rows."""
        K, d, n = self.point.z.shape
        known = np.concatenate([found.moves[:-1], found.w], axis=1)
        both = np.matmul(self.inside, known[:, None, :, None])
        by_z = np.matmul(self.forms.curve, both)[..., :n, 0]
        by_z[:, -1] += found.forces[1:, :n]
        rows = -np.linalg.solve(self.forms.inside.transpose(0, 2, 1), by_z.reshape(K, d * n, 1))
        move = ProgramPoint(found.moves[0, :n], found.v, found.w, both[..., :n, 0])
        return move, rows.reshape(K, d, n)


def _flat(w: Array, v: Array) -> Array:
    return np.concatenate([w.ravel(), v.ravel()])


def _at_bounds(forms: Array, side: Array, moves: Array) -> Array:
    """Return L T for (K, m, one + q) forms L of (dx, 1, d): T moves what is active to its bound and keeps it there."""
    found, one = forms.copy(), forms.shape[2] - side.shape[1]
    found[:, :, one - 1] += products(forms[:, :, one:], moves)
    found[:, :, one:] *= (side == 0)[:, None]
    return found


def _both_at_bounds(forms: Array, side: Array, moves: Array) -> Array:
    """Return T'MT for symmetric M, which weighs what is kept at its bound by 1."""
    found = _at_bounds(_at_bounds(forms, side, moves).transpose(0, 2, 1), side, moves)
    each = np.arange(forms.shape[2] - side.shape[1], forms.shape[2])
    found[:, each, each] += side != 0
    return found


def _bent(forms: Array, n: int, steep: Array, linear: Array) -> Array:
    """Return quadratic forms of (dx, 1, d) with steep d^2 / 2 + linear d more."""
    bent, each = forms.copy(), np.arange(n + 1, forms.shape[2])
    bent[:, each, each] += steep
    bent[:, n, each] += linear
    bent[:, each, n] += linear
    return bent


def _last(box: ProgramPoint, pieces: int) -> ProgramPoint:
    """Return the bounds of the last intervals of a window."""
    idle = len(box.w) - pieces
    return ProgramPoint(box.z0, box.v[idle:], box.w[idle:], box.z[idle:])
