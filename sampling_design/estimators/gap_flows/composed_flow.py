"""The flow of one plant over any gap, put together from remembered pieces, so that irregular gaps cost little.

With base 64 and a short unit of time h_0 every gap is h = r + sum_j d_j 64^j h_0, 0 <= r < h_0. Over r three short
Taylor polynomials do, whose terms are the plant's; the flows over d_j 64^j h_0 are remembered; and with
F_h = e^{Ah}, E_h = int_0^h e^{As} ds, W_h = int_0^h e^{eta s} e^{As} N e^{A's} ds two gaps make one:
    F_{a+b} = F_b F_a,    E_{a+b} = E_b + F_b E_a,    W_{a+b} = W_b + e^{eta b} F_b W_a F_b'.
Where few gaps are asked for at once, and none takes more than one level, the sum with the piece d_0 h_0 is itself one
polynomial in r, remembered with the piece: a gap is then one product.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from scipy.linalg import matrix_balance

from sampling_design.numerics.linalg import SHORT, expm_batch, exponential_terms, gramian_terms
from sampling_design.records.arrays import Array, Index, Mask

BASE = 64  # pieces of one size that are remembered: one level of them covers |A| h up to 8 at least, three up to 3e4

STILL = 1e-150
"""A plant in which nothing moves counts as one this slow: what is divided by it, disturbances, stays a number."""

FlowParts: TypeAlias = Array | tuple[Array, Array, Array]  # F, E and W of one gap

FEW = 4  # gaps up to which each is a product of its own with the polynomial around its piece
SMALL = 12  # states up to which these polynomials are remembered: four megabytes at most


def state_units(A: Array, units: Array | None = None) -> Array:
    """Return units s of the states in which A is small: x = s x~, A~ = S^-1 A S, from some `units` that are given.

    In states whose units differ by powers of ten a norm of A says nothing, and e^{Ah} loses the small entries.
    """
    first = np.ones(A.shape[0]) if units is None else np.asarray(units, dtype=np.float64)
    _, (second, _) = matrix_balance(A * first / first[:, None], permute=False, separate=True)
    return np.asarray(first * second)


def _symmetric(W: Array) -> Array:
    half = W / 2
    return np.asarray(half + half.transpose(0, 2, 1))


def _triangle(n: int) -> tuple[Mask, Index]:
    """What of [F, E, W], one row after the other, is not above the diagonal of W; and where what each holds stands."""
    row, column = np.divmod(np.arange(3 * n * n), 3 * n)
    below = column - 2 * n <= row
    place = np.cumsum(below) - 1
    mirrored = np.where(below, np.arange(3 * n * n), (column - 2 * n) * 3 * n + row + 2 * n)
    return below, place[mirrored].reshape(n, 3, n).transpose(1, 0, 2).copy()


class ComposedFlow:
    """F, E and W over gaps, for A, the intensity N of the noise and the rate eta >= 0; `units` of the states, about.

    Notes
    -----
    *Numerical aspects.* Every term of W is positive semidefinite, and nothing overflows before F or W does. Each
    remembered F is an exponential of its own: F is as exact as `expm_batch` makes it.
    """

    def __init__(self, A: Array, noise: Array, eta: float, units: Array | None = None):
        n = A.shape[0]
        s = state_units(A, units)
        moved, spread = s[:, None] / s, s[:, None] * s
        self._moved = np.concatenate([moved, moved, spread], axis=1)
        A, noise = A / moved, noise / spread
        shifted = A + (eta / 2) * np.eye(n)
        self._norm = max(float(np.linalg.norm(M, 1)) for M in (A, shifted, np.full((1, 1), STILL)))
        self._A, self._n, self._eta = A, n, eta
        self._unit = float(np.exp2(np.floor(np.log2(SHORT / self._norm))))  # a power of two: counting is exact
        powers = exponential_terms(A, self._norm)
        order = np.arange(1, len(powers) + 1)[:, None, None]
        # side by side, here and in every piece: [F, E, W]
        terms = np.concatenate([powers, powers / order, gramian_terms(shifted, noise, self._norm)], axis=2)
        self._powers, self._terms = np.arange(float(len(terms))), terms.reshape(len(terms), -1)
        self._shifted, self._exponential, self._rest = shifted, powers, terms[:, :, n:]
        self._levels: list[Array] = []
        self._around: dict[int, Array] = {}  # of pieces, without what is above the diagonal of W
        below, self._whole = _triangle(n)
        self._kept = np.flatnonzero(below)

    def over(self, gaps: Sequence[float]) -> tuple[Array, Array, Array]:
        """Return F, E and W for every gap, each (N, n, n)."""
        n = self._n
        if self._few(gaps):
            F, E, W = np.array([self._near(h) for h in gaps]).swapaxes(0, 1)
            return F, E, W
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is not finite: its users look
            flow = self._far(np.array(gaps, dtype=np.float64))
        return flow[:, :, :n], flow[:, :, n : 2 * n], _symmetric(flow[:, :, 2 * n :])

    def each(self, gaps: Sequence[float]) -> Sequence[FlowParts]:
        """Return the same gap by gap."""
        if self._few(gaps):
            return [self._near(h) for h in gaps]
        F, E, W = self.over(gaps)
        return [(F[k], E[k], W[k]) for k in range(len(gaps))]  # to iterate an array takes ten times as long

    def _few(self, gaps: Sequence[float]) -> bool:
        """Whether some gaps, at least one, are few and of one level."""
        return 0 < len(gaps) <= FEW and self._n <= SMALL and max(gaps) < BASE * self._unit

    def _near(self, h: float) -> Array:
        """F, E and W over a gap of one level, (3, n, n), from the polynomial around its piece."""
        digit = int(h // self._unit)
        terms = self._around.get(digit)
        if terms is None:
            terms = self._around[digit] = self._expanded(digit)
        flow: Array = np.power((h - digit * self._unit) * self._norm, self._powers).dot(terms)[self._whole]
        return flow

    def _expanded(self, digit: int) -> Array:
        """Coefficients of the flow over `digit` units and r more, by powers of |A| r; in the states' own units."""
        n, powers, norm = self._n, self._exponential, self._norm
        piece = self._unit_flows(0, np.array([digit]))[0]
        terms = np.zeros((len(powers), n, 3 * n))
        np.matmul(powers, piece[:, : 2 * n], out=terms[:, :, : 2 * n])
        current = piece[:, 2 * n :]
        for k in range(len(powers)):
            terms[k, :, 2 * n :] = current
            moved = self._shifted @ current
            current = (moved + moved.T) / (norm * (k + 1))
        terms[1:, :, n:] += self._rest[:-1] / norm
        terms *= self._moved
        terms[:, :, 2 * n :] = _symmetric(terms[:, :, 2 * n :])
        return terms.reshape(len(terms), -1)[:, self._kept]

    def _far(self, h: Array) -> Array:
        """Flows over any gaps, pieces of all levels put together."""
        count = np.floor(h / self._unit)
        longest = max(count.tolist(), default=0.0)
        if not math.isfinite(longest):
            raise OverflowError("a gap is too long to be counted in the plant's fastest units")
        passed = h - count * self._unit
        flow, level, unit = self._short_flows(passed), 0, self._unit
        while longest:
            longest //= BASE
            count, digits = np.divmod(count, BASE) if longest else (count, count)
            flow = self._composed(flow, self._unit_flows(level, digits.astype(np.intp)), passed)
            if longest:
                passed = passed + digits * unit
                level, unit = level + 1, unit * BASE
        flow *= self._moved
        return flow

    def _short_flows(self, h: Array) -> Array:
        """Flows over gaps up to a unit."""
        factors = (h * self._norm)[:, None] ** self._powers
        flow: Array = factors.dot(self._terms).reshape(h.size, self._n, -1)
        flow[:, :, self._n :] *= h[:, None, None]
        return flow

    def _composed(self, late: Array, early: Array, length: Array | float) -> Array:
        """Flows over `early` (one or more) and then over `late` (one, or as many), which lasts `length`."""
        n = self._n
        flow, F = np.empty_like(early), late[..., :n]
        np.matmul(F, early[..., : 2 * n], out=flow[..., : 2 * n])
        grown = F * np.exp(self._eta / 2 * np.asarray(length))[..., None, None] if self._eta else F
        np.matmul(grown @ early[..., 2 * n :], grown.swapaxes(-1, -2), out=flow[..., 2 * n :])
        flow[..., n:] += late[..., n:]
        return flow

    def _unit_flows(self, level: int, digits: Index) -> Array:
        """Flows over `digits` units of 64^level h_0; the table grows until it holds them all."""
        if level == len(self._levels):
            self._levels.append(self._first(level))
        largest = max(digits.tolist(), default=0)
        if len(self._levels[level]) <= largest:
            self._grow(level, largest + 1)
        return self._levels[level][digits]

    def _first(self, level: int) -> Array:
        """Flows over no and over one unit of a level."""
        if level == 0:
            return self._short_flows(np.array([0.0, self._unit]))
        self._grow(level - 1, BASE)
        half = self._levels[level - 1][BASE // 2]
        one = self._composed(half, half, self._unit * float(BASE) ** level / 2)
        return np.stack([self._levels[0][0], one])

    def _grow(self, level: int, count: int) -> None:
        """Remember `count` pieces of a level or a few more, by doubling; what overflows is beyond those asked for."""
        table, unit, n = self._levels[level], self._unit * float(BASE) ** level, self._n
        size = 1 << (count - 1).bit_length()
        with np.errstate(over="ignore", invalid="ignore"):
            F = expm_batch(self._A, unit * np.arange(size))
            while (known := len(table)) < size:
                whole = self._composed(table[-1], table[1], (known - 1) * unit)
                more = self._composed(whole, table, known * unit)
                more[:, :, :n] = F[known : 2 * known]
                table = np.concatenate([table, more])
        self._levels[level] = table
