"""What happens between two times, computed once per gap length and kept."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import discounted_flow, expm_batch
from sampling_design.estimators.weights import Weights

Array = npt.NDArray[np.float64]

CONDITION_LIMIT = 1e6
"""W_h is inverted only while its correlation matrix is better conditioned than this: six digits lost of sixteen."""

CACHE_SIZE = 4096
"""Gap lengths that are kept; a few kilobytes each, so that memory stays flat on endless irregular data."""


class Flow:
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
    inputs : (n, m)
        int_0^h e^{A s} B ds.
    information : (3, n, n) or None
        W^-1, W^-1 F, F'W^-1 F; None where W is singular or badly conditioned.
    """

    __slots__ = ("F", "W", "gap", "growth", "information", "inputs", "root", "whiten")

    def __init__(self, gap: float, growth: float, matrices: tuple[Array, ...], information: Array | None):
        self.gap, self.growth, self.information = gap, growth, information
        self.F, self.W, self.root, self.whiten, self.inputs = matrices

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
        self._table: OrderedDict[float, Flow] = OrderedDict()

    def __len__(self) -> int:
        return len(self._table)

    def get(self, gaps: Sequence[float]) -> list[Flow]:
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
        plant, weights = self.weights.plant, self.weights
        F, W = discounted_flow(plant.A, weights.noise, gaps, weights.eta)
        inputs = self.integrals(plant.B, gaps)
        if self.constant_w:
            root = self._constant_root(gaps)
            whiten = np.linalg.pinv(root)
            W = root @ np.swapaxes(root, 1, 2)
            information: list[Array | None] = [None] * len(gaps)
        else:
            root, whiten, information = _roots(F, W)
        for k, gap in enumerate(gaps):
            growth = float(np.exp(weights.eta * gap))
            matrices = (F[k], W[k], root[k], whiten[k], inputs[k])
            self._table[gap] = Flow(gap, growth, matrices, information[k])

    def integrals(self, matrix: Array, gaps: list[float]) -> Array:
        """int_0^h e^{A s} ds times `matrix`, per gap, from one augmented exponential."""
        n, m = matrix.shape
        if m == 0:
            return np.zeros((len(gaps), n, 0))
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.weights.plant.A, matrix
        return np.ascontiguousarray(expm_batch(block, gaps)[:, :n, n:])

    def _constant_root(self, gaps: list[float]) -> Array:
        """Root of the noise that is constant over each gap: cost |w|^2_Qw int_0^h e^{-eta s} ds = |omega|^2."""
        plant, weights = self.weights.plant, self.weights
        length = discounted_length(weights.eta, np.asarray(gaps))
        half = np.linalg.solve(np.linalg.cholesky(weights.w), np.eye(plant.n_disturbances)).T
        per_gap = self.integrals(plant.G, gaps) @ half
        scale = np.sqrt(np.where(length > 0, length, 1.0))
        return np.asarray(per_gap / scale[:, None, None])


def discounted_length(eta: float, h: npt.ArrayLike) -> Array:
    """Return int_0^h e^{-eta s} ds."""
    gap = np.asarray(h, dtype=np.float64)
    return gap if eta == 0 else -np.expm1(-eta * gap) / eta


def _roots(F: Array, W: Array) -> tuple[Array, Array, list[Array | None]]:
    """Roots of W, their pseudo-inverses and, where it is well conditioned, the blocks W^-1, W^-1 F, F'W^-1 F.

    Both go through the correlation matrix D^-1 W D^-1, D^2 = diag(W): units and the powers of h between
    position and velocity drop out, so that what is called ill-conditioned is so in every unit.
    """
    n = W.shape[-1]
    size = np.sqrt(np.einsum("kii->ki", W))
    unit = np.where(size > 0, size, 1.0)
    correlation = W / unit[:, :, None] / unit[:, None, :]
    values, vectors = np.linalg.eigh(correlation)
    tolerance = n * np.finfo(float).eps
    kept = np.where(values > tolerance, values, 0.0)
    root = unit[:, :, None] * vectors * np.sqrt(kept)[:, None, :]
    good = (values[:, 0] * CONDITION_LIMIT > values[:, -1]) & np.all(size > 0, axis=1)
    inverse = np.where(kept > 0, 1 / np.sqrt(np.where(kept > 0, kept, 1.0)), 0.0)
    half = np.swapaxes(vectors, 1, 2) * inverse[:, :, None] / unit[:, None, :]
    forward = half @ F
    half_t, forward_t = np.swapaxes(half, 1, 2), np.swapaxes(forward, 1, 2)
    blocks = np.stack([half_t @ half, half_t @ forward, forward_t @ forward], axis=1)
    return root, half, [block if ok else None for block, ok in zip(blocks, good, strict=True)]
