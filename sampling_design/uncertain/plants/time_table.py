"""Matrices at times, straight in between, and the flow of a plant that is given so, with a proven error."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sampling_design.errors import SolverError
from sampling_design.numerics.filtering import propagate
from sampling_design.records.arrays import Array

TERMS = 22  # of each Taylor series
LENGTH = 0.5  # |A| times a step at most
MOST_STEPS = 200_000  # over one gap; what asks for more is no motion that doubles could follow
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class MatrixTable:
    """Matrices (N, ., .) at N increasing times, straight in between."""

    times: Array
    stack: Array

    def __call__(self, t: float) -> Array:
        k = int(np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, self.times.size - 2))
        share = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        return np.asarray((1 - share) * self.stack[k] + share * self.stack[k + 1])

    def in_units(self, rows: Array, columns: Array) -> MatrixTable:
        """The matrices of scaled vectors."""
        return MatrixTable(self.times, self.stack * columns / rows[:, None])

    def knots(self, a: float, b: float) -> list[float]:
        """a, the times of the table in between, b: the matrices run straight from each to the next."""
        inner = self.times[(self.times > a) & (self.times < b)]
        return [a, *inner.tolist(), b]


def table_flow(
    A: MatrixTable, G: MatrixTable | None, spread: Array | None, a: float, b: float
) -> tuple[Array, Array, float]:
    """Transition and added covariance over [a, b], and a proven bound of the transition's error (spectral norm).

    On a straight piece A_0 + A_1 s the coefficients of the flow obey (k + 1) F_{k+1} = A_0 F_k + A_1 F_{k-1}, those of
    the covariance (k + 1) W_{k+1} = sym(A_0 W_k + A_1 W_{k-1}) + Q_k. With norms in place of matrices the first
    recursion majorises itself, which bounds the terms left out; each product of matrices rounds by at most (n + 2) eps
    of its factors' norms. Raises SolverError if the matrices are so large that the steps do not come to an end.
    """
    n = A.stack.shape[1]
    F, W, error = np.eye(n), np.zeros((n, n)), 0.0
    ends = A.knots(a, b)
    for p, q in pairwise(ends):
        low, high = A(p), A(q)
        size = max(float(np.linalg.norm(low)), float(np.linalg.norm(high)))
        count = max(1, int(np.ceil(min(size * (q - p) / LENGTH, 2.0 * MOST_STEPS))))
        if count > MOST_STEPS or not np.isfinite(size):
            raise SolverError(
                f"the integration comes to a stop at t = {p:.6g}: |A| reaches {size:.3g} there, too much for doubles.",
                status="integration failed",
            )
        h, slope = (q - p) / count, (high - low) / (q - p)
        first, last = (None, None) if G is None else (G(p), G(q))
        for k in range(count):
            start = low + (high - low) * (k / count)
            noise = np.zeros((3, n, n))
            if first is not None and last is not None and spread is not None:
                g = (first + (last - first) * (k / count)) * np.sqrt(spread), (last - first) / (q - p) * np.sqrt(spread)
                noise = np.array([g[0] @ g[0].T, g[0] @ g[1].T + g[1] @ g[0].T, g[1] @ g[1].T])
            step, added, own = _series(start, slope, noise, h)
            own += 2 * EPS * abs(q) * size * np.exp(size * h)  # the ends of the step are rounded, too
            before, reach = length_of(F), length_of(step)
            error = reach * error + own * (before + error) + 2 * n * n * EPS * reach * before
            F, W = step @ F, propagate(W, step, added)
    return F, W, error


def length_of(matrix: Array) -> float:
    """The largest singular value, rounded up."""
    return float(np.linalg.norm(matrix, 2) * (1 + 8 * max(matrix.shape) * EPS))


def _series(A: Array, slope: Array, noise: Array, h: float) -> tuple[Array, Array, float]:
    """Flow and covariance over a step of a straight piece, and the bound of the flow's error."""
    n = len(A)
    A, slope = A * h, slope * h**2
    sizes = float(np.linalg.norm(A)), float(np.linalg.norm(slope))
    forced = noise * h ** np.arange(1, 4)[:, None, None]
    term, before = np.eye(n), np.zeros((n, n))
    grown, earlier = np.zeros((n, n)), np.zeros((n, n))
    bound, behind = float(np.sqrt(n)), 0.0
    F, W, whole = term, np.zeros((n, n)), bound
    for k in range(TERMS):
        term, before = (A @ term + slope @ before) / (k + 1), term
        half = A @ grown + slope @ earlier
        grown, earlier = (half + half.T + (forced[k] if k < 3 else 0.0)) / (k + 1), grown
        bound, behind = (sizes[0] * bound + sizes[1] * behind) / (k + 1), bound
        F, W, whole = F + term, W + grown, whole + bound
    left_out = 2 * max(bound, behind)  # later terms fall by more than a half each: |A| + |A'| < TERMS / 2
    return F, W, left_out + (TERMS * (n + 6) + 16) * EPS * whole
