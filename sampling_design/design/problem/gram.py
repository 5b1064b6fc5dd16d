"""Measurement rows in a basis in which the windows' Gram matrices are near the identity.

With z = R x and R from the triangular factor of the rows C e^{Ar}, r over the window, every congruence
keeps its inequality: W >= t I in x means S'WS >= t S'S in z with S = R^-1. A plant that grows by
thousands over a window is harmless there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.numerics.linalg import expm_batch, product, product_quotient
from sampling_design.observability.windows.sampled import observability_matrix
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask

_NODES = 2049  # positions in the window at which rows are held: trapezoidal weights are exact to rounding between them
_LOOKED_AT = 257  # nodes at which rounding is judged, and steps in whose middle what lies between nodes is
_CLOSE = 1e-5  # of the rows: what lies between nodes may be off by so much and still lead a search
ROUNDING = 1e-9  # relative allowance for rounding in a bound, at least
MANY_STATES = 12  # beyond, a relaxation takes seconds and a search spends less on what it hardly ever finds
ROUNDING_MARGIN = 8.0  # what the first order of rounding is taken times

EPS = float(np.finfo(float).eps)

_ALIKE = 1e3  # condition of the scaling up to which an eigenvalue in x keeps ten digits
_FLOOR = 1e-15  # eigenvalues of a scaled Gram matrix below this times the largest count as unseen
_NOTHING = 1e-100  # stands for the size of an empty window: squares of its inverse stay numbers


@dataclass(frozen=True, eq=False)
class ScaledRows:
    """Rows c(r) = C e^{Ar} S over [0, window], S = R^-1; `A`, `C` in the same basis."""

    plant: Plant
    window: float
    late: float = 0.0  # by which a bound moves rows beyond the window's ends

    @cached_property
    def _nodes(self) -> Array:
        return np.linspace(0.0, self.window, _NODES)

    @cached_property
    def _raw(self) -> Array:
        return observability_matrix(self.plant, self._nodes)

    @cached_property
    def R(self) -> Array:
        """Triangular (n, n): the window's rows of equal weight have Gram matrix R'R."""
        R = np.linalg.qr(self._raw / np.sqrt(_NODES), mode="r")
        signs = np.where(np.diagonal(R) < 0, -1.0, 1.0)
        return np.asarray(R * signs[:, None])

    @cached_property
    def S(self) -> Array:
        """R^-1, for which solves are used everywhere but in products of n by n."""
        eye = np.eye(self.R.shape[0])
        return product_quotient(eye, eye, self.R)

    @cached_property
    def A(self) -> Array:
        """R A R^-1."""
        return product_quotient(self.R, self.plant.A, self.R)

    @cached_property
    def C(self) -> Array:
        """C R^-1."""
        return product_quotient(self.plant.C, np.eye(self.R.shape[0]), self.R)

    @cached_property
    def rounding(self) -> float:
        """Relative allowance for rounding in forms <Z, G>: to first order, with a margin.

        Rows C e^{Ar} are of size 1 here, but what is summed to them, |C| |e^{Ar}|, may be larger, and a change of A by
        eps moves them by eps |A| r times that.
        """
        flows = expm_batch(self.A, np.linspace(-self.late, self.window + self.late, _LOOKED_AT))
        summed = np.max(np.linalg.norm(np.abs(self.C) @ np.abs(flows), axis=(1, 2)))
        turned = float(np.linalg.norm(self.A, 1)) * (self.window + 2 * self.late)
        return float(np.maximum(ROUNDING, ROUNDING_MARGIN * len(self.A) * EPS * summed * (1 + turned)))

    def carried(self, roots: Array) -> Array:
        """Return roots F of multipliers F F' (M, n, r) in this basis, for `roots` of psd weights of x.

        In x the sum of all <F F', I> is at least 1 then, with rounding: what is rounded in F is worth no more there
        than eps |S| |F|, and they are made larger by that.
        """
        count, n, rank = roots.shape
        moved = product(self.R, np.moveaxis(roots / np.linalg.norm(roots), 0, 1).reshape(n, -1))
        lost = EPS * (n + float(np.linalg.norm(np.abs(self.S) @ np.abs(moved))))
        found = moved / (1 - lost) if lost < 1 else np.full_like(moved, np.nan)
        return np.moveaxis(found.reshape(n, count, rank), 1, 0)

    @cached_property
    def unit(self) -> float:
        """Largest eigenvalue of S'S: t is measured in 1/unit inside the solvers."""
        return float(np.linalg.norm(self.S, 2) ** 2)

    @cached_property
    def N(self) -> Array:
        """S'S/unit, so that W >= t I reads W^ >= (t unit) N."""
        return np.asarray(self.S.T @ self.S / self.unit)

    @cached_property
    def _table(self) -> Array:
        rows = np.asarray(np.linalg.solve(self.R.T, self._raw.T).T, dtype=np.float64)
        return self._side_by_side(rows, rows @ self.A)

    @cached_property
    def _is_close(self) -> bool:
        """Whether interpolation is: not where the plant turns many times between two nodes."""
        middles = (self._nodes[:-1] + self._nodes[1:])[:: (_NODES - 1) // (_LOOKED_AT - 1)] / 2
        there = self._exact(middles).reshape(middles.size, -1)
        off = np.abs(self._between(self._table, middles).reshape(there.shape) - there)
        return bool(np.max(off) <= _CLOSE * np.max(np.abs(there)))

    def _exact(self, r: Array) -> Array:
        raw = observability_matrix(self.plant, r.ravel())
        return np.asarray(np.linalg.solve(self.R.T, raw.T).T.reshape(*r.shape, *self.plant.C.shape))

    def rows(self, r: Array) -> Array:
        """Return c(r), shape (*r.shape, p, n), by cubic Hermite interpolation where that is close (search only)."""
        if not self._is_close:
            return self._exact(r)
        return self._between(self._table, r).reshape(*r.shape, self.plant.n_outputs, self.plant.n_states)

    @cached_property
    def _flow_table(self) -> Array:
        flow = expm_batch(self.A, self._nodes)
        return self._side_by_side(flow, flow @ self.A)

    def flows(self, r: Array) -> Array:
        """Return e^{Ar} in the scaled basis, shape (*r.shape, n, n), 0 <= r <= window, likewise."""
        if not self._is_close:
            flow = self.plant.transition(r.ravel())
            return np.asarray((self.R @ flow @ self.S).reshape(*r.shape, *self.A.shape))
        return self._between(self._flow_table, r).reshape(*r.shape, *self.A.shape)

    def _side_by_side(self, values: Array, slopes: Array) -> Array:
        """Values and slopes at both ends of each step, in one row: a view, every node is held once."""
        h = self.window / (_NODES - 1)
        node_values = np.stack([values.reshape(_NODES, -1), h * slopes.reshape(_NODES, -1)], axis=1)
        size = node_values[0].size
        return np.lib.stride_tricks.sliding_window_view(node_values.ravel(), 2 * size)[::size]

    def _between(self, table: Array, r: Array) -> Array:
        place = np.minimum(np.maximum(r / (self.window / (_NODES - 1)), 0.0), _NODES - 1)
        node = np.minimum(place.astype(np.intp), _NODES - 2)
        u = place - node
        v = 1.0 - u
        weights = np.empty((*r.shape, 1, 4))
        late, early = u**2, v**2
        weights[..., 0, 0], weights[..., 0, 1] = (1 + 2 * u) * early, u * early
        weights[..., 0, 2], weights[..., 0, 3] = (1 + 2 * v) * late, -v * late
        return np.asarray(weights @ table[node].reshape(*r.shape, 4, table.shape[1] // 4))

    def least(self, grams: Array) -> tuple[Array, Array]:
        """Return sigma^2 of scaled Gram matrices (..., n, n) and the vectors z with z'S'Sz = 1 that attain it.

        sigma^2 = 1/lambda_max(S'S, W^): relative accuracy does not suffer from the scale of x.
        """
        values, vectors = np.linalg.eigh(grams)
        top = values[..., -1:]
        floored = np.maximum(values, _FLOOR * np.maximum(top, _NOTHING))
        half = vectors / np.sqrt(floored)[..., None, :]
        inner = np.swapaxes(half, -1, -2) @ self.N @ half
        largest, direction = np.linalg.eigh(inner)
        sigma2 = 1.0 / (largest[..., -1] * self.unit)
        z = (half @ direction[..., -1:])[..., 0]
        z = z / np.sqrt(np.maximum(largest[..., -1:] * self.unit, 1e-300))
        return np.where(values[..., 0] <= _FLOOR * top[..., 0], 0.0, sigma2), np.asarray(z)

    def least_sigma2(self, grams: Array) -> Array:
        """Return sigma^2 alone, of many states at a third of the time where x and z are scaled nearly alike."""
        if grams.shape[-1] <= MANY_STATES or np.linalg.cond(self.R) > _ALIKE:
            return self.least(grams)[0]
        return np.asarray(np.maximum(np.linalg.eigvalsh(self.R.T @ grams @ self.R)[..., 0], 0.0))

    def least_observable(self, grams: Array, count: int) -> Array:
        """The `count` directions z of each Gram matrix that it sees least against z'S'Sz, (..., n, count)."""
        values, vectors = np.linalg.eigh(grams)
        floored = np.maximum(values, _FLOOR * np.maximum(values[..., -1:], _NOTHING))
        half = vectors / np.sqrt(floored)[..., None, :]
        _, direction = np.linalg.eigh(np.swapaxes(half, -1, -2) @ self.N @ half)
        z = half @ direction[..., -count:]
        size, rounding = np.einsum("...iq,ij,...jq->...q", z, self.N, z), np.finfo(float).eps * np.linalg.norm(self.N)
        return np.asarray(z / np.sqrt(np.maximum(size, rounding * np.sum(z**2, axis=-2)))[..., None, :])


def lags(times: Array, start: Array, window: float, period: float, below: Mask | bool) -> tuple[Array, Mask]:
    """Return the distances of all periods of `times` from `start`, and which lie in the half-open window.

    That is (start, start + T], the limit just after a sample leaves, or from `below` [start, start + T). Distances
    within 1e-11 periods of an end lie on it. Shapes broadcast; one axis of periods is appended.
    """
    tiny = 1e-11 * period
    base = np.mod(times - start, period)
    base = np.where(below, np.where(base >= period - tiny, base - period, base), base + period * (base <= tiny))
    r = base[..., None] + period * np.arange(int(np.ceil(window / period - 1e-9)))
    inside = np.where(np.asarray(below)[..., None], r < window - tiny, r <= window + tiny)
    return np.clip(r, 0.0, window), inside
