"""What happens between two times, computed once per gap length and kept."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from sampling_design.estimators.gap_flows.composed_flow import ComposedFlow
from sampling_design.estimators.gap_flows.cost_weights import Weights

Array = npt.NDArray[np.float64]

CONDITION_LIMIT = 1e6
"""W_h is inverted only while its correlation matrix's inverse has a trace below this: six digits lost of sixteen."""

CACHE_SIZE = 4096
"""Gap lengths that are kept; a few kilobytes each, so that memory stays flat on endless irregular data."""


LONGEST = 700.0
"""Exponents from here on count as overflows: e^709 is the largest double."""


class GapFlow:
    """Transition over one gap h; roots and information are found when they are first asked for.

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
    joint : (2n, 2n) or None
        [[F'W^-1 F, -F'W^-1], [-W^-1 F, W^-1]], what states at both ends of the gap cost together; None where W is
        singular or badly conditioned.
    band : (2, n, 2n)
        Its lower triangle, column after column, from the diagonal down.
    """

    __slots__ = ("F", "W", "_band", "_joint", "_roots", "gap", "growth", "inputs", "integral")

    def __init__(
        self,
        gap: float,
        growth: float,
        F: Array,
        W: Array,
        integral: Array,
        inputs: Array,
        roots: tuple[Array, Array] | None = None,
    ):
        self.gap, self.growth, self.F, self.W, self.integral, self.inputs = gap, growth, F, W, integral, inputs
        self._roots = roots
        self._band: Array | None = None
        self._joint: Array | bool | None = None if roots is not None else False

    @property
    def root(self) -> Array:
        """Return a root of W."""
        return self._rooted()[0]

    @property
    def whiten(self) -> Array:
        """Return its pseudo-inverse."""
        return self._rooted()[1]

    def _rooted(self) -> tuple[Array, Array]:
        if self._roots is None:
            self._roots = _root(self.W)
        return self._roots

    @property
    def joint(self) -> Array | None:
        """Return what states at both ends cost together."""
        if isinstance(self._joint, bool):
            self._joint = _joint(self.F, self.W)
        return self._joint

    @property
    def band(self) -> Array:
        """Return its lower triangle, where it is known."""
        if self._band is None:
            assert self.joint is not None
            n = len(self.F)
            blocks = np.zeros((2, 2 * n, n))
            blocks[0], blocks[1, :n] = self.joint[:, :n], self.joint[n:, n:]
            self._band = lower_band(blocks)
        return self._band

    def covariance(self, Y: Array) -> Array:
        """Return growth F Y F' + W, exactly symmetric."""
        moved = self.growth * (self.F @ Y @ self.F.T) + self.W
        return (moved + moved.T) / 2


def lower_band(blocks: Array) -> Array:
    """Return (N, n, 2n) the lower bands of (N, m n, n) block columns, m <= 2, from the diagonal down; a copy.

    Band row r of column i is row i + r of its block column: a view with strides of its own.
    """
    count, rows, n = blocks.shape
    whole = np.zeros((count, 3 * n, n))
    whole[:, :rows] = blocks
    step = whole.itemsize
    return np.ndarray((count, n, 2 * n), buffer=whole, strides=(whole.strides[0], (n + 1) * step, n * step)).copy()


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
        inputs = integral @ weights.plant.B
        roots: dict[float, tuple[Array, Array]] = {}
        if self.constant_w:
            roots = dict(zip(gaps, self._constant_roots(integral, gaps), strict=True))
            W = np.array([root @ root.T for root, _ in roots.values()])
        for k, gap in enumerate(gaps):
            growth = math.exp(weights.eta * gap) if weights.eta * gap < LONGEST else math.inf
            self._table[gap] = GapFlow(gap, growth, F[k], W[k], integral[k], inputs[k], roots.get(gap))

    def _constant_roots(self, integral: Array, gaps: list[float]) -> list[tuple[Array, Array]]:
        """Roots and their pseudo-inverses."""
        root = self._constant_root(integral, gaps)
        size = np.linalg.norm(root, axis=2)
        unit = np.where(size > 0, size, 1.0)
        whiten = np.linalg.pinv(root / unit[:, :, None]) / unit[:, None, :]
        return list(zip(root, whiten, strict=True))

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


def _units(W: Array) -> Array:
    """Roots of the diagonal of W, 1 where it is 0: in these units W is a correlation matrix.

    Units and the powers of h between position and velocity drop out of what is then called ill-conditioned.
    """
    size = np.sqrt(W.diagonal())
    return np.where(size > 0, size, 1.0)


def _root(W: Array) -> tuple[Array, Array]:
    """Return a root of W and its pseudo-inverse; NaN where W overflowed."""
    if not np.isfinite(W).all():
        return np.full_like(W, np.nan), np.full_like(W, np.nan)
    unit = _units(W)
    values, vectors = np.linalg.eigh(W / unit[:, None] / unit)
    kept = values > len(W) * np.finfo(float).eps
    scale = np.sqrt(np.where(kept, values, 1.0))
    root = unit[:, None] * vectors * np.where(kept, scale, 0.0)
    return root, vectors.T * np.where(kept, 1 / scale, 0.0)[:, None] / unit


def _joint(F: Array, W: Array) -> Array | None:
    """Return [[F'W^-1 F, -F'W^-1], [-W^-1 F, W^-1]]; None where that would lose six digits or more.

    By Cholesky's factor of the correlation matrix; the trace of its inverse is its condition but for a factor of n^2.
    """
    size = np.sqrt(W.diagonal())
    if not (size.all() and np.isfinite(W).all() and np.isfinite(F).all()):
        return None
    factor, flag = lapack.dpotrf(W / size[:, None] / size, lower=1, clean=1)
    if flag:
        return None
    half = lapack.dtrtri(factor, lower=1)[0]
    if np.vdot(half, half) > CONDITION_LIMIT:
        return None
    half = half / size
    both = np.concatenate([-half @ F, half], axis=1)
    return np.asarray(both.T @ both)
