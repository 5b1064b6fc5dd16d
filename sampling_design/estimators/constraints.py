"""Constraints of the window problem: sets for x, y, v and w, as rows and cones in the smoother's coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design.estimators.convex_set import ConvexSet, convex_set
from sampling_design.estimators.disturbance import DisturbanceReach
from sampling_design.estimators.flows import FlowTable
from sampling_design.estimators.solution import Kernel
from sampling_design.estimators.window import Window

Array = npt.NDArray[np.float64]

SATISFIED = 1e-10
"""Excess, relative to the size of the values, up to which the unconstrained minimiser counts as feasible."""


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


@dataclass(frozen=True, eq=False)
class LeastDistance:
    """min |z|^2 subject to lower <= A z <= upper and |M_i z + c_i| <= r_i: what the constraints leave to do.

    Rows have unit norm: bounds count in posterior standard deviations; `scales` turn slack back into the signal's
    unit. `owners` (per block of rows) and `cone_owners` remember which signal each row or cone belongs to.
    """

    T: Array
    A: Array
    lower: Array
    upper: Array
    cones: list[tuple[Array, Array, float]]
    scales: Array
    owners: list[tuple[_Piece, npt.NDArray[np.intp]]]
    cone_owners: list[_Piece]

    def row_label(self, index: int, below: bool) -> str:
        """Say in words what row `index` asks, of its lower bound where `below`."""
        sizes = np.cumsum([entries.size for _, entries in self.owners])
        block = int(np.searchsorted(sizes, index, side="right"))
        piece, entries = self.owners[block]
        entry, k = int(entries[index - sizes[block]]), piece.base.size
        if entry >= k:
            return f"half-space {entry - k + 1} of {piece.name} at t = {piece.time:.6g}"
        bound = f">= {piece.set.lower[entry]:.6g}" if below else f"<= {piece.set.upper[entry]:.6g}"
        return f"{piece.entries[entry]} {bound} at t = {piece.time:.6g} ({piece.name})"

    def cone_label(self, index: int) -> str:
        """Say in words what cone `index` asks."""
        return f"a ball of {self.cone_owners[index].name} at t = {self.cone_owners[index].time:.6g}"


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
        weights = self.weights
        self._gain = np.linalg.solve(weights.R + weights.v, weights.R)
        self._v_root = np.linalg.solve(np.linalg.cholesky(weights.R + weights.v), np.eye(plant.n_outputs)).T
        self.reach = None if self.w is None else DisturbanceReach(table, self.w)

    @property
    def active(self) -> bool:
        """Whether there is any constraint."""
        return any(s is not None for s in (self.x, self.y, self.v, self.w))

    def noise(self, window: Window, nodes: Array) -> Array:
        """Return the best v at every node for given states: (R + Qv)^-1 R (y - C x - D u), measured outputs only."""
        return ((window.y - window.feedthrough - nodes @ self.plant.C.T) * window.masks) @ self._gain.T

    def omegas(self, window: Window, nodes: Array) -> Array:
        """Return the least omega of every gap for given states, (N, width)."""
        deviation = nodes - window.reference
        moved = deviation[1:] - np.matmul(window.F, deviation[:-1, :, None])[:, :, 0] - window.defect
        return np.asarray(np.matmul(self._whitened(window), moved[:, :, None])[:, :, 0])

    def _whitened(self, window: Window) -> Array:
        width = window.flows[0].root.shape[1] if window.flows else 0
        return np.array([flow.whiten for flow in window.flows]).reshape(-1, width, self.plant.n_states)

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
        return self.reach is None or self._w_satisfied(self.reach, window, nodes)

    def _w_satisfied(self, reach: DisturbanceReach, window: Window, nodes: Array) -> bool:
        sets, omegas = [reach.over(flow) for flow in window.flows], self.omegas(window, nodes)
        tolerance = SATISFIED * max(1.0, float(np.max(np.abs(omegas), initial=0.0)))
        if all(chosen.is_box for chosen in sets):
            lower = np.array([chosen.lower for chosen in sets]).reshape(omegas.shape)
            upper = np.array([chosen.upper for chosen in sets]).reshape(omegas.shape)
            return bool(np.all(omegas >= lower - tolerance) and np.all(omegas <= upper + tolerance))
        return all(chosen.contains(omega, tolerance) for chosen, omega in zip(sets, omegas, strict=True))

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
        if self.reach is not None:
            omegas = self.omegas(window, nodes)
            moved = np.matmul(self._whitened(window), T[1:] - np.matmul(window.F, T[:-1]))
            for j, flow in enumerate(window.flows):
                names = self._omega_names if flow.root.shape[1] == plant.n_states else plant.disturbances.names
                pieces.append(_Piece("w_set", times[j + 1], names, omegas[j], moved[j], self.reach.over(flow)))
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
    rows, base, lower, upper = [np.zeros((0, T.shape[2]))], [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    owners, cones = [], []
    for piece in pieces:
        chosen = piece.set
        bounded = chosen.bounded if piece.seen is None else chosen.bounded[piece.seen[chosen.bounded] > 0]
        whole = piece.seen is None or bool(np.all(piece.seen > 0))
        kept: Any = slice(None) if bounded.size == piece.base.size else bounded  # a view where all entries are bounded
        rows.append(piece.map[kept])
        base.append(piece.base[kept])
        lower.append(chosen.lower[kept])
        upper.append(chosen.upper[kept])
        owners.append((piece, bounded))
        if whole and chosen.rows.shape[0]:
            rows.append(chosen.rows @ piece.map)
            base.append(chosen.rows @ piece.base)
            lower.append(np.full(chosen.rows.shape[0], -np.inf))
            upper.append(chosen.offsets)
            owners.append((piece, piece.base.size + np.arange(chosen.rows.shape[0])))
        if whole:
            cones += [(piece, ball) for ball in chosen.balls]
    A, at = np.concatenate(rows), np.concatenate(base)
    scales = np.sqrt(np.einsum("ij,ij->i", A, A))
    unit = np.where(scales > 0, scales, 1.0)
    mapped = [(ball.shape @ piece.map, ball.shape @ (piece.base - ball.centre), ball.radius) for piece, ball in cones]
    low, high = (np.concatenate(lower) - at) / unit, (np.concatenate(upper) - at) / unit
    return LeastDistance(T, A / unit[:, None], low, high, mapped, unit, owners, [p for p, _ in cones])
