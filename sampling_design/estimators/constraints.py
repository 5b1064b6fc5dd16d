"""Constraints of the window problem: sets for x, y, v and w, as rows and cones in the smoother's coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.estimators.convex_set import ConvexSet, convex_set
from sampling_design.estimators.disturbance import support_box
from sampling_design.estimators.flows import Flow, FlowTable, discounted_length
from sampling_design.estimators.solution import Kernel
from sampling_design.estimators.window import Window

Array = npt.NDArray[np.float64]

SATISFIED = 1e-10
"""Excess, relative to the size of the values, up to which the unconstrained minimiser counts as feasible."""


@dataclass
class LeastDistance:
    """min |z|^2 subject to lower <= A z <= upper and |M_i z + c_i| <= r_i: what the constraints leave to do.

    Rows have unit norm: bounds count in posterior standard deviations. `labels` say what each row or cone means,
    `scales` turn its slack back into the signal's unit.
    """

    T: Array
    A: Array
    lower: Array
    upper: Array
    cones: list[tuple[Array, Array, float]]
    labels: list[tuple[str, str]]
    scales: Array
    cone_labels: list[str] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A constrained signal at one place: value = base + map z, in `set`; only the entries in `seen` count."""

    name: str
    time: float
    entries: tuple[str, ...]
    base: Array
    map: Array
    set: ConvexSet
    seen: Array | None = None


class Constraints:
    """The sets of one estimator, and how a window feels them."""

    def __init__(self, table: FlowTable, x: Any, y: Any, v: Any, w: Any):
        plant = table.weights.plant
        self.table, self.plant, self.weights = table, plant, table.weights
        self.x = convex_set("x_set", x, plant.n_states)
        self.y = convex_set("y_set", y, plant.n_outputs)
        self.v = convex_set("v_set", v, plant.n_outputs)
        self.w = convex_set("w_set", w, plant.n_disturbances)
        self.keeps_v = self.v is not None or self.y is not None
        self._omega_names = tuple(f"omega{i + 1}" for i in range(plant.n_states))
        self._reach: dict[float, ConvexSet] = {}
        weights = self.weights
        self._gain = np.linalg.solve(weights.R + weights.v, weights.R)
        self._v_root = np.linalg.solve(np.linalg.cholesky(weights.R + weights.v), np.eye(plant.n_outputs)).T
        if self.w is not None:
            self._check_w()

    def _check_w(self) -> None:
        assert self.w is not None
        if self.table.constant_w:
            if np.linalg.matrix_rank(self.plant.G) < self.plant.n_disturbances:
                raise ArgumentError(
                    '`w_model` = "constant" needs a G of full column rank: w must follow from its effect.'
                )
        elif not (self._w_radius() < np.inf or self._box_bounded()):
            raise ArgumentError(
                "`w_set` is unbounded, so that an outer bound on what w can do says nothing. "
                'Bound every entry of w, or use w_model="constant" (not certified).'
            )

    @property
    def active(self) -> bool:
        """Whether there is any constraint."""
        return any(s is not None for s in (self.x, self.y, self.v, self.w))

    def _w_radius(self) -> float:
        """Least bound on |w|_Qw that a single ball gives."""
        assert self.w is not None
        half, best = np.linalg.cholesky(self.weights.w).T, np.inf
        for ball in self.w.balls:
            if np.linalg.matrix_rank(ball.shape) == self.w.dimension:
                gain = float(np.linalg.norm(half @ np.linalg.pinv(ball.shape), 2))
                best = min(best, float(np.linalg.norm(half @ ball.centre)) + ball.radius * gain)
        return best

    def _box_bounded(self) -> bool:
        assert self.w is not None
        return all(bool(np.isfinite(side).all()) for side in self.w.bounding_box())

    def omega_set(self, flow: Flow) -> ConvexSet:
        """Return the set that provably holds omega over this gap (for a constant w: the exact one)."""
        assert self.w is not None
        if flow.gap not in self._reach:
            if len(self._reach) > 4096:
                self._reach.clear()
            self._reach[flow.gap] = self._make_omega_set(flow)
        return self._reach[flow.gap]

    def _make_omega_set(self, flow: Flow) -> ConvexSet:
        assert self.w is not None
        length = float(np.sqrt(discounted_length(self.weights.eta, flow.gap)))
        width = flow.root.shape[1]
        if self.table.constant_w:
            half = np.linalg.solve(np.linalg.cholesky(self.weights.w), np.eye(width)).T / length  # w = half omega
            whole = np.full(width, np.inf)
            w = self.w
            bounded = [
                (sign * half[i], sign * side[i])
                for sign, side in ((1, w.upper), (-1, w.lower))
                for i in range(width)
                if np.isfinite(side[i])
            ]
            rows = np.vstack([w.rows @ half, *(row for row, _ in bounded)])
            offsets = np.concatenate([w.offsets, [b for _, b in bounded]])
            found = ConvexSet(-whole, whole, rows, offsets)
            for ball in w.balls:
                centre = np.linalg.solve(half, ball.centre)
                found = found & ConvexSet.ball(ball.radius, centre=centre, shape=ball.shape @ half)
            return found
        found = ConvexSet.box(np.full(width, -np.inf), np.full(width, np.inf))
        if self._w_radius() < np.inf:
            found = found & ConvexSet.ball(self._w_radius() * length, dimension=width)
        else:
            integral = self.table.integrals(self.plant.G, [flow.gap])[0]
            found = found & ConvexSet.box(*support_box(self.plant, flow, integral, *self.w.bounding_box()))
        return found

    def noise(self, window: Window, nodes: Array) -> Array:
        """Return the best v at every node for given states: (R + Qv)^-1 R (y - C x - D u), measured outputs only."""
        return ((window.y - window.feedthrough - nodes @ self.plant.C.T) * window.masks) @ self._gain.T

    def omegas(self, window: Window, nodes: Array) -> list[Array]:
        """Return the least omega of every gap for given states."""
        deviation = nodes - window.reference
        moved = deviation[1:] - np.matmul(window.F, deviation[:-1, :, None])[:, :, 0] - window.defect
        return [flow.whiten @ d for flow, d in zip(window.flows, moved, strict=True)]

    def satisfied(self, window: Window, nodes: Array) -> bool:
        """Whether the trajectory `nodes`, with its best v and w, meets every constraint."""
        tolerance = SATISFIED * max(1.0, float(np.max(np.abs(nodes))))
        if self.x is not None and self.x.excess(nodes) > tolerance:
            return False
        if self.keeps_v:
            v = self.noise(window, nodes)
            y = nodes @ self.plant.C.T + window.feedthrough + v
            for chosen, values in ((self.v, v), (self.y, y)):
                size = SATISFIED * max(1.0, float(np.abs(values).max()))
                if chosen is not None and any(
                    _seen_excess(chosen, values[j], window.masks[j]) > size for j in window.samples
                ):
                    return False
        if self.w is not None:
            for flow, omega in zip(window.flows, self.omegas(window, nodes), strict=True):
                if self.omega_set(flow).excess(omega) > SATISFIED * max(1.0, float(np.abs(omega).max())):
                    return False
        return True

    def least_distance(self, window: Window, nodes: Array, kernel: Kernel) -> LeastDistance:
        """Return the problem that is left when `nodes` minimises without the constraints."""
        T = self._states(window, kernel)
        pieces = self._pieces(window, nodes, T)
        return _assemble(T, pieces)

    def _states(self, window: Window, kernel: Kernel) -> Array:
        """Maps (N+1, n, m) with x_j = nodes_j + T_j z; the last p per sample of z are v's own where v is kept."""
        count, n = kernel.roots.shape[:2]
        extra = window.samples.size * self.plant.n_outputs if self.keeps_v else 0
        T = np.zeros((count, n, count * n + extra))
        T[-1, :, (count - 1) * n : count * n] = kernel.roots[-1]
        for j in range(count - 2, -1, -1):
            np.matmul(kernel.gains[j], T[j + 1, :, (j + 1) * n : count * n], out=T[j, :, (j + 1) * n : count * n])
            T[j, :, j * n : (j + 1) * n] = kernel.roots[j]
        return T

    def _pieces(self, window: Window, nodes: Array, T: Array) -> list[_Piece]:
        plant, pieces = self.plant, []
        times = window.times
        if self.x is not None:
            pieces += [_Piece("x_set", t, plant.states.names, nodes[j], T[j], self.x) for j, t in enumerate(times)]
        if self.keeps_v:
            pieces += self._v_pieces(window, nodes, T)
        if self.w is not None:
            for j, (flow, omega) in enumerate(zip(window.flows, self.omegas(window, nodes), strict=True)):
                moved = flow.whiten @ (T[j + 1] - flow.F @ T[j])
                names = self._omega_names if flow.root.shape[1] == plant.n_states else plant.disturbances.names
                pieces.append(_Piece("w_set", times[j + 1], names, omega, moved, self.omega_set(flow)))
        return pieces

    def _v_pieces(self, window: Window, nodes: Array, T: Array) -> list[_Piece]:
        plant, p, found = self.plant, self.plant.n_outputs, []
        v = self.noise(window, nodes)
        first = T.shape[2] - window.samples.size * p
        for k, j in enumerate(window.samples):
            mask = window.masks[j]
            moved = -self._gain @ (mask[:, None] * (plant.C @ T[j]))
            moved[:, first + k * p : first + (k + 1) * p] += self._v_root / np.sqrt(window.discount[j])
            if self.v is not None:
                found.append(_Piece("v_set", window.times[j], plant.outputs.names, v[j], moved, self.v, mask))
            if self.y is not None:
                base = plant.C @ nodes[j] + window.feedthrough[j] + v[j]
                total = plant.C @ T[j] + moved
                found.append(_Piece("y_set", window.times[j], plant.outputs.names, base, total, self.y, mask))
        return found


def _seen_excess(chosen: ConvexSet, value: Array, mask: Array) -> float:
    """Excess over the measured entries; half-spaces and balls count where everything is measured."""
    if mask.all():
        return chosen.excess(value)
    return float(np.max(np.where(mask > 0, np.maximum(chosen.lower - value, value - chosen.upper), -np.inf)))


def _assemble(T: Array, pieces: list[_Piece]) -> LeastDistance:
    rows, lower, upper, labels, cones, cone_labels = [], [], [], [], [], []
    for piece in pieces:
        chosen = piece.set
        seen = np.ones(piece.base.size, bool) if piece.seen is None else piece.seen > 0
        for i in map(int, np.flatnonzero(seen & (np.isfinite(chosen.lower) | np.isfinite(chosen.upper)))):
            rows.append(piece.map[i])
            lower.append(chosen.lower[i] - piece.base[i])
            upper.append(chosen.upper[i] - piece.base[i])
            at = f"{piece.entries[i]} {{}} at t = {piece.time:.6g} ({piece.name})"
            labels.append((at.format(f">= {chosen.lower[i]:.6g}"), at.format(f"<= {chosen.upper[i]:.6g}")))
        if not seen.all():
            continue
        for i in range(chosen.rows.shape[0]):
            rows.append(chosen.rows[i] @ piece.map)
            lower.append(-np.inf)
            upper.append(chosen.offsets[i] - chosen.rows[i] @ piece.base)
            labels.append(("", f"half-space {i + 1} of {piece.name} at t = {piece.time:.6g}"))
        for i, ball in enumerate(chosen.balls):
            cones.append((ball.shape @ piece.map, ball.shape @ (piece.base - ball.centre), ball.radius))
            cone_labels.append(f"ball {i + 1} of {piece.name} at t = {piece.time:.6g}")
    A = np.array(rows).reshape(-1, T.shape[2])
    scales = np.linalg.norm(A, axis=1)
    unit = np.where(scales > 0, scales, 1.0)
    return LeastDistance(
        T, A / unit[:, None], np.array(lower) / unit, np.array(upper) / unit, cones, labels, unit, cone_labels
    )
