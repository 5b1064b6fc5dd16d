"""What happens between two times, computed once per gap length and kept."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from sampling_design.estimators.gap_flows.composed_flow import SMALL, ComposedFlow, FlowParts
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.numerics.filtering import propagate
from sampling_design.records.arrays import Array, Index, Mask, freeze

CONDITION_LIMIT = 1e6
"""W_h is inverted only while its correlation matrix's inverse has a trace below this: six digits lost of sixteen."""

CACHE_SIZE = 4096
"""Gap lengths that are kept; a few kilobytes each, so that memory stays flat on endless irregular data."""

_cholesky, _inverse = lapack.dpotrf, lapack.dtrtri

LONGEST = 700.0  # exponents from here on count as overflows: e^709 is the largest double


COVARIANCE_ERROR = 2e-14
"""Relative error of a W in units of its diagonal: its inverse is off by as much times its condition."""

PROPAGATED = 4e-15
"""Relative error of a covariance that was propagated over a gap, in units of its diagonal: times its condition it is
that of the ellipsoid."""


_BothEnds = tuple[Array | None, float, Array | None]  # `joint`, `loose` and `band` of a gap
_NO_ENDS: _BothEnds = (None, 0.0, None)


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
        [[F'W^-1 F, -F'W^-1], [-W^-1 F, W^-1]] with F times the root of growth: what states at both ends of the gap cost
        together, each times the root of its own discount; None where W is singular or badly conditioned.
    band : (2, n, 2n)
        Its lower triangle, column after column, from the diagonal down.
    undiscounted : (n, n) or None
        W without discount, where a prediction has asked for it.
    """

    __slots__ = (
        *("gap", "growth", "F", "W", "undiscounted"),
        *("_flow", "_B", "_inputs", "_size", "_arrival", "_roots", "_ends"),
    )

    def __init__(
        self,
        gap: float,
        growth: float,
        flow: FlowParts,
        B: Array,
        roots: tuple[Array, Array] | None = None,
    ):
        self.gap, self.growth, self.F, self.W, self._flow, self._B = gap, growth, flow[0], flow[2], flow, B
        self.undiscounted: Array | None = None
        self._inputs: Array | None = None
        self._size: Array | None = None
        self._arrival: tuple[Array, tuple[Array, Array] | None] | None = None
        self._roots = roots
        self._ends: _BothEnds | None = None if roots is None else _NO_ENDS

    @property
    def integral(self) -> Array:
        """Return the integral of e^{A s} over the gap."""
        return self._flow[1]

    @property
    def inputs(self) -> Array:
        """Return that times B: what inputs add that hold over the gap."""
        if self._inputs is None:
            self._inputs = self.integral.dot(self._B)
        return self._inputs

    @property
    def size(self) -> Array:
        """Return |F|, entry by entry."""
        if self._size is None:
            self._size = abs(self.F)
        return self._size

    @property
    def root(self) -> Array:
        """Return a root of W."""
        return (self._roots or self._noise_roots())[0]

    @property
    def whiten(self) -> Array:
        """Return its pseudo-inverse."""
        return (self._roots or self._noise_roots())[1]

    def _noise_roots(self) -> tuple[Array, Array]:
        self._roots = found = noise_root(self.W)
        return found

    @property
    def joint(self) -> Array | None:
        """Return what states at both ends cost together."""
        return (self._ends or self._looked_at())[0]

    @property
    def loose(self) -> float:
        """Return how far `joint` may be off, relative, as a quadratic form; 0 where there is none."""
        return (self._ends or self._looked_at())[1]

    @property
    def band(self) -> Array:
        """Return its lower triangle, where it is known."""
        band = (self._ends or self._looked_at())[2]
        assert band is not None
        return band

    def weighed(self) -> bool:
        """Find what states at both ends cost together; whether it can be had. Overflows are not inverted, but said."""
        if self._ends is None:
            self._ends = _joint(self.F, self.W, self.growth)
        return self._ends is not _NO_ENDS

    def _looked_at(self) -> _BothEnds:
        with np.errstate(over="ignore", invalid="ignore"):
            self.weighed()
        assert self._ends is not None
        return self._ends

    def known(self, joint: Array, loose: float, band: Array) -> None:
        """Take what was found of many gaps at once."""
        self._ends = joint, loose, band

    def arrived(self, Y: Array, found: tuple[Array, Array]) -> None:
        """Take what a prior was found to be worth."""
        self._arrival = Y, found

    def arrival_information(self, Y: Array) -> tuple[Array, Array] | None:
        """Return what a prior of covariance Y is worth after the gap: (growth F Y F' + W)^-1 and its lower band.

        None where that would lose digits. What was asked for last is kept.
        """
        if self._arrival is None or self._arrival[0] is not Y:
            self._arrival = Y, _information_of(self._carried(Y))
        return self._arrival[1]

    def covariance(self, Y: Array) -> Array:
        """Return growth F Y F' + W, exactly symmetric, with what rounding may hide of it."""
        return inflated(self._carried(Y).ravel()[_mirrored(len(Y))])

    def _carried(self, Y: Array) -> Array:
        moved: Array = self.F.dot(Y).dot(self.F.T).dot(self.growth)
        moved += self.W
        return moved


@lru_cache(maxsize=64)
def _mirrored(n: int) -> Index:
    """Where the entries of a symmetric matrix stand in its lower triangle."""
    row, column = np.indices((n, n))
    return np.asarray(np.maximum(row, column) * n + np.minimum(row, column))


@lru_cache(maxsize=64)
def _band_places(width: int, n: int) -> tuple[Index, Array]:
    """Where the entries of a lower band stand in a symmetric matrix; 0 where it has none, 1 elsewhere."""
    column, below = np.meshgrid(np.arange(width), np.arange(2 * n), indexing="ij")
    row = column + below
    places = column * width + np.minimum(row, width - 1)
    return places.reshape(-1, n, 2 * n), (row < width).astype(np.float64).reshape(-1, n, 2 * n)


def lower_band(matrix: Array, n: int) -> Array:
    """Return (m, n, 2n) the lower band of a symmetric (m n, m n) matrix, column after column, from the diagonal down.

    m is 1 or 2: what stands in it is a block of its column and the one below.
    """
    places, held = _band_places(len(matrix), n)
    band: Array = matrix.ravel()[places]
    band *= held
    return band


class FlowTable:
    """Flows by gap length, the least recently used dropped first.

    With `constant_w` the disturbance is constant over each gap; then root is that of the paper's
    piecewise-constant parametrisation, d = root omega with the same cost |omega|^2.
    """

    def __init__(self, weights: CostWeights, constant_w: bool = False):
        self.weights, self.constant_w = weights, constant_w
        self.no_drift = freeze(np.zeros(weights.plant.n_states))  # what inputs add where there are none
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

    def known(self, gaps: Sequence[float]) -> None:
        """See to it that the flows of some gaps are known, in one batch."""
        table = self._table
        missing = [gap for gap in gaps if gap not in table]
        if missing:
            self._fill(list(dict.fromkeys(missing)))
            while len(table) > CACHE_SIZE:
                table.popitem(last=False)

    def prepare(self, gaps: Sequence[float], arrivals: Sequence[float], Y: Array) -> None:
        """Find, each in one batch, `joint` of the flows of some gaps, and `arrival` of a prior Y after others.

        What may lose digits is left to be looked at by itself, and so are more than `SMALL` states.
        """
        if len(Y) > SMALL:
            return
        table = self._table
        before = [flow for flow in map(table.get, dict.fromkeys(gaps)) if flow is not None]
        after = [flow for flow in map(table.get, dict.fromkeys(arrivals)) if flow is not None]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if before and not self.constant_w:
                prepare_joint(before)
            if after:
                prepare_arrival(after, Y)

    def one(self, gap: float) -> GapFlow:
        """Return the flow of a gap."""
        found = self._table.get(gap)
        return self.get((gap,))[0] if found is None else found

    def _fill(self, gaps: list[float]) -> None:
        eta, B, table = self.weights.eta, self.weights.plant.B, self._table
        flows: Sequence[FlowParts] = self._flow.each(gaps)
        roots: Sequence[tuple[Array, Array] | None] = [None] * len(gaps)
        if self.constant_w:
            with np.errstate(over="ignore", invalid="ignore"):  # what overflows is asked for by its flows' users
                found = self._constant_roots(np.array([flow[1] for flow in flows]), gaps)
                flows = [(flow[0], flow[1], root @ root.T) for flow, (root, _) in zip(flows, found, strict=True)]
            roots = found
        for k, gap in enumerate(gaps):
            growth = math.exp(eta * gap) if eta * gap < LONGEST else math.inf
            table[gap] = GapFlow(gap, growth, flows[k], B, roots[k])

    def _constant_roots(self, integral: Array, gaps: list[float]) -> list[tuple[Array, Array]]:
        """Roots of the noise that is constant over each gap and their pseudo-inverses; NaN where they overflowed.

        Its cost is |w|^2_Qw int_0^h e^{-eta s} ds = |omega|^2.
        """
        plant, weights = self.weights.plant, self.weights
        length = discounted_length(weights.eta, np.asarray(gaps))
        half = np.linalg.solve(np.linalg.cholesky(weights.w), np.eye(plant.n_disturbances)).T
        scale = np.sqrt(np.where(length > 0, length, 1.0))
        root = integral @ (plant.G @ half) / scale[:, None, None]
        size = np.linalg.norm(root, axis=2)
        known = np.isfinite(size).all(axis=1)
        unit = np.where(size > 0, size, 1.0)
        whiten = np.full_like(root.transpose(0, 2, 1), np.nan)
        whiten[known] = np.linalg.pinv((root / unit[:, :, None])[known]) / unit[known, None, :]
        root[~known] = np.nan
        return list(zip(root, whiten, strict=True))


def discounted_length(eta: float, h: npt.ArrayLike) -> Array:
    """Return int_0^h e^{-eta s} ds."""
    gap = np.asarray(h, dtype=np.float64)
    return gap if eta == 0 else -np.expm1(-eta * gap) / eta


def inflated(Y: Array) -> Array:
    """Return a covariance that is no smaller than the exact one: `PROPAGATED` times n of its diagonal is added to it.

    In place. A direction in which Y's digits are lost is then known to 1e-7 of the rest, not to 0 or less.
    """
    Y *= _inflation(len(Y))
    return Y


@lru_cache(maxsize=64)
def _inflation(n: int) -> Array:
    return np.asarray(1 + n * PROPAGATED * np.eye(n))


def noise_root(W: Array) -> tuple[Array, Array]:
    """Return a root of W and its pseudo-inverse; NaN where W overflowed.

    Of W and what rounding may hide of it, n `COVARIANCE_ERROR` of its diagonal: a displacement never costs more than in
    exact arithmetic, also in directions in which digits of W are lost.
    """
    if not np.isfinite(W).all():
        return np.full_like(W, np.nan), np.full_like(W, np.nan)
    root, whiten = np.zeros((2, *W.shape))
    driven = np.flatnonzero(W.diagonal() > 0)
    among, size = np.ix_(driven, driven), np.sqrt(W.diagonal()[driven])
    values, vectors = np.linalg.eigh(W[among] / size[:, None] / size)
    scale = np.sqrt(np.maximum(values, 0.0) + len(W) * COVARIANCE_ERROR)
    root[among], whiten[among] = size[:, None] * vectors * scale, vectors.T / scale[:, None] / size
    return root, whiten


def _half(M: Array) -> Array | None:
    """Return L^-1 for Cholesky's factor L of M, None where M is not positive definite."""
    factor, flag = _cholesky(M, 1)  # lower; by name it takes twice as long
    return None if flag else _inverse(factor, 1)[0]


def _condition(M: Array, inverse: Array) -> float:
    """Return the trace of the inverse of M's correlations, from the diagonal of M's; not finite where it overflowed.

    It is the condition in units of the diagonal but for a factor of n^2; units change no digit. The inverse of an M of
    which it exceeds `CONDITION_LIMIT` has lost six digits or more.
    """
    return float(M.diagonal().dot(inverse))


def _halves(M: Array) -> tuple[Array, Array, Mask]:
    """L^-1 and the condition of many matrices, and which of them keep their digits."""
    n = M.shape[1]
    try:
        L = np.linalg.cholesky(M)
    except np.linalg.LinAlgError:
        return M, M[:, 0, 0], np.zeros(len(M), dtype=bool)
    half = np.zeros_like(L)
    for i in range(n):
        half[:, i] = -np.matmul(L[:, None, i, :i], half[:, :i])[:, 0]
        half[:, i, i] += 1.0
        half[:, i] /= L[:, i, i, None]
    condition = np.einsum("kij,kij,kjj->k", half, half, M)
    return half, condition, condition <= CONDITION_LIMIT


def _bands(matrices: Array, n: int) -> Array:
    """`lower_band` of many matrices."""
    places, held = _band_places(matrices.shape[1], n)
    band: Array = matrices.reshape(len(matrices), -1).take(places, 1)
    band *= held
    return band


def prepare_joint(flows: list[GapFlow]) -> None:
    """Find what states at both ends of some gaps cost together, where no digits are lost."""
    F, W = np.array([flow.F for flow in flows]), np.array([flow.W for flow in flows])
    half, condition, fit = _halves(W)
    root = np.array([math.sqrt(flow.growth) for flow in flows])
    both = np.concatenate((half @ F * root[:, None, None], -half), axis=2)
    joint = both.transpose(0, 2, 1) @ both
    fit &= np.isfinite(joint).all(axis=(1, 2))
    bands = _bands(joint, W.shape[1])
    for k in np.flatnonzero(fit).tolist():
        flows[k].known(joint[k], COVARIANCE_ERROR * float(condition[k]), bands[k])


def prepare_arrival(flows: list[GapFlow], Y: Array) -> None:
    """Find what a prior of covariance Y is worth after some gaps, where no digits are lost."""
    F, growth = np.array([flow.F for flow in flows]), np.array([flow.growth for flow in flows])
    M = propagate(Y * growth[:, None, None], F, np.array([flow.W for flow in flows]))
    half, _, fit = _halves(M)
    information = half.transpose(0, 2, 1) @ half
    bands = _bands(information, len(Y))
    for k in np.flatnonzero(fit & np.isfinite(information).all(axis=(1, 2))).tolist():
        flows[k].arrived(Y, (information[k], bands[k, 0]))


def _joint(F: Array, W: Array, growth: float) -> _BothEnds:
    """Return `joint` of a gap, how far it may be off, and its lower band; None where it would lose six digits."""
    half, n = _half(W), len(F)
    if half is None:
        return _NO_ENDS
    both = np.empty((2 * n, n))  # transposed, so that each half of it is one piece
    F.T.dot(half.T.dot(math.sqrt(growth)), both[:n])
    np.negative(half.T, both[n:])
    joint = both.dot(both.T)
    diagonal = joint.diagonal()
    condition = _condition(W, diagonal[n:])
    if not (condition <= CONDITION_LIMIT and math.isfinite(sum(diagonal.tolist()))):
        return _NO_ENDS
    return joint, COVARIANCE_ERROR * condition, lower_band(joint, n)


def _information_of(M: Array) -> tuple[Array, Array] | None:
    """Return the inverse of a covariance, in both forms."""
    half = _half(M)
    if half is None:
        return None
    information = half.T.dot(half)
    return (
        (information, lower_band(information, len(M))[0])
        if _condition(M, information.diagonal()) <= CONDITION_LIMIT
        else None
    )
