"""What happens between two times, computed once per gap length and kept."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sampling_design.estimators.gap_flows.composed_flow import ComposedFlow
from sampling_design.estimators.gap_flows.cost_weights import Weights

Array = npt.NDArray[np.float64]

CONDITION_LIMIT = 1e6
"""W_h is inverted only while its correlation matrix is better conditioned than this: six digits lost of sixteen."""

CACHE_SIZE = 4096
"""Gap lengths that are kept; a few kilobytes each, so that memory stays flat on endless irregular data."""


LONGEST = 700.0
"""Exponents from here on count as overflows: e^709 is the largest double."""


class GapFlow:
    """Transition over one gap h.

    Attributes
    ----------
    F : (n, n)
        e^{A h}.
    growth : float
        e^{eta h}; a covariance Y becomes growth F Y F' + W.
    W, root : (n, n)
        Discounted noise Gramian and a root, W = root root'.
    whiten : (n, n)
        Pseudo-inverse of the root: omega = whiten d is the least omega with root omega = d.
    integral, inputs : (n, n), (n, m)
        int_0^h e^{A s} ds, and that times B.
    information : (3, n, n) or None
        W^-1, W^-1 F, F'W^-1 F; None where W is singular or badly conditioned.
    """

    __slots__ = ("F", "W", "gap", "growth", "information", "inputs", "integral", "root", "whiten")

    def __init__(self, gap: float, growth: float, matrices: tuple[Array, ...], information: Array | None):
        self.gap, self.growth, self.information = gap, growth, information
        self.F, self.W, self.root, self.whiten, self.integral, self.inputs = matrices

    def covariance(self, Y: Array) -> Array:
        """Return growth F Y F' + W, exactly symmetric."""
        moved = self.growth * (self.F @ Y @ self.F.T) + self.W
        return (moved + moved.T) / 2


class FlowTable:
    """Flows by gap length, the least recently used dropped first.

    With `constant_w` the disturbance is constant over each gap; then root is that of the paper's
    piecewise-constant parametrisation, d = root omega with the same cost |omega|^2.
    """

    def __init__(self, weights: Weights, constant_w: bool = False):
        self.weights, self.constant_w = weights, constant_w
        self._table: OrderedDict[float, GapFlow] = OrderedDict()
        self._flow = ComposedFlow(weights.plant.A, weights.noise, weights.eta, weights.units)

    def __len__(self) -> int:
        return len(self._table)

    def get(self, gaps: Sequence[float]) -> list[GapFlow]:
        """Return the flow of every gap; those not known yet are computed in one batch."""
        table = self._table
        missing = [gap for gap in dict.fromkeys(gaps) if gap not in table]
        if missing:
            self._fill(missing)
        found = [table[gap] for gap in gaps]
        for gap in gaps:
            table.move_to_end(gap)
        while len(table) > CACHE_SIZE:
            table.popitem(last=False)
        return found

    def _fill(self, gaps: list[float]) -> None:
        weights = self.weights
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is asked for by its flows' users
            F, integral, W = self._flow.over(gaps)
        if self.constant_w:
            root = self._constant_root(integral, gaps)
            W = root @ np.swapaxes(root, 1, 2)
            size = np.sqrt(np.einsum("kii->ki", W))
            unit = np.where(size > 0, size, 1.0)
            whiten = np.linalg.pinv(root / unit[:, :, None]) / unit[:, None, :]
            information: list[Array | None] = [None] * len(gaps)
        else:
            root, whiten, information = _finite_roots(F, W)
        parts = zip(F, W, root, whiten, integral, integral @ weights.plant.B, strict=True)
        for gap, matrices, info in zip(gaps, parts, information, strict=True):
            growth = math.exp(weights.eta * gap) if weights.eta * gap < LONGEST else math.inf
            self._table[gap] = GapFlow(gap, growth, matrices, info)

    def _constant_root(self, integral: Array, gaps: list[float]) -> Array:
        """Root of the noise that is constant over each gap: cost |w|^2_Qw int_0^h e^{-eta s} ds = |omega|^2."""
        plant, weights = self.weights.plant, self.weights
        length = discounted_length(weights.eta, np.asarray(gaps))
        half = np.linalg.solve(np.linalg.cholesky(weights.w), np.eye(plant.n_disturbances)).T
        scale = np.sqrt(np.where(length > 0, length, 1.0))
        return np.asarray(integral @ (plant.G @ half) / scale[:, None, None])


def discounted_length(eta: float, h: npt.ArrayLike) -> Array:
    """Return int_0^h e^{-eta s} ds."""
    gap = np.asarray(h, dtype=np.float64)
    return gap if eta == 0 else -np.expm1(-eta * gap) / eta


def _finite_roots(F: Array, W: Array) -> tuple[Array, Array, list[Array | None]]:
    """Return what `_roots` does; flows that overflow have no roots (NaN)."""
    fine = np.isfinite(W).all(axis=(1, 2)) & np.isfinite(F).all(axis=(1, 2))
    if fine.all():
        return _roots(F, W)
    root, whiten = np.full_like(W, np.nan), np.full_like(W, np.nan)
    information: list[Array | None] = [None] * len(W)
    if fine.any():
        root[fine], whiten[fine], found = _roots(F[fine], W[fine])
        for k, block in zip(np.flatnonzero(fine), found, strict=True):
            information[int(k)] = block
    return root, whiten, information


def _roots(F: Array, W: Array) -> tuple[Array, Array, list[Array | None]]:
    """Roots of W, their pseudo-inverses and, where it is well conditioned, the blocks W^-1, W^-1 F, F'W^-1 F.

    Both go through the correlation matrix D^-1 W D^-1, D^2 = diag(W): units and the powers of h between
    position and velocity drop out, so that what is called ill-conditioned is so in every unit.
    """
    size = np.sqrt(np.einsum("kii->ki", W))
    unit = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(W / (unit[:, :, None] * unit[:, None, :]))
    good = (values[:, 0] * CONDITION_LIMIT > values[:, -1]) & (size > 0).all(axis=1)
    kept = values > W.shape[-1] * np.finfo(float).eps
    scale = np.sqrt(np.where(kept, values, 1.0))
    root = unit[:, :, None] * vectors * np.where(kept, scale, 0.0)[:, None, :]
    half = vectors.transpose(0, 2, 1) * np.where(kept, 1 / scale, 0.0)[:, :, None] / unit[:, None, :]
    both = np.concatenate([half, half @ F], axis=2)
    squares = both.transpose(0, 2, 1) @ both
    n = W.shape[-1]
    blocks = np.stack([squares[:, :n, :n], squares[:, :n, n:], squares[:, n:, n:]], axis=1)
    return root, half, [block if ok else None for block, ok in zip(blocks, good, strict=True)]
