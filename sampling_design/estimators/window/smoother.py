"""The window problem without active constraints, in closed form, by two routes.

`solve_banded` needs every W_h well conditioned: one banded Cholesky factorisation of the block-tridiagonal
information matrix of the nodes. `solve_square_root` inverts no W_h: a forward pass of orthogonal
factorisations (square-root covariance filter) and a backward pass (smoother), whatever the rank of W_h.

Both say more than the minimiser x*: any trajectory is
    x_N = x*_N + S_N z_N,    x_j = x*_j + G_j (x_{j+1} - x*_{j+1}) + S_j z_j,
and then costs J* + |z|^2. Constraints become a least-distance problem in z (`qp.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import lapack

from sampling_design.estimators.window.means import with_means
from sampling_design.estimators.window.solution import DUAL_MARGIN, SmootherKernel, Solution
from sampling_design.estimators.window.square_root import solve_square_root
from sampling_design.estimators.window.window_problem import EstimationWindow
from sampling_design.records.arrays import Array, Index

PIVOT_LIMIT = 1e-5
"""A Cholesky pivot below this share of its diagonal entry has lost five digits: the other route is taken."""


def smooth(window: EstimationWindow) -> Solution:
    """Return the minimiser by the cheaper route that keeps its digits.

    Notes
    -----
    *Numerical aspects.* The banded route is backward stable: with pivots above PIVOT_LIMIT the minimiser's
    relative error e in the norm of the Hessian is below 1e-9, and the cost exceeds the optimum by e^2 of
    what the reference trajectory costs above it. DUAL_MARGIN, taken off for `dual`, is far above both that and
    the rounding of the sums; the other route's cost is a sum of squares, with the same margin.
    """
    found = solve_banded(window)
    if found is None:
        found = solve_square_root(window)
    return found if window.means is None else with_means(found, window.reference, window.means)


def information_band(window: EstimationWindow) -> tuple[Array, Array] | None:
    """Return the lower band (2n, (N+1)n) and the right-hand side of the normal equations, None if some W is unfit."""
    joint = window.joint
    if joint is None:
        return None
    weights, discount = window.weights, window.discount
    C, n, count = weights.plant.C, weights.plant.n_states, window.times.size
    columns = np.zeros((count, 3 * n, n))  # per node: its diagonal block, the one below, zeros
    diagonal = columns[:, :n]
    weighted = window.residual * discount[:, None]
    if window.all_or_none:
        CY = C.T @ weights.y
        np.multiply(CY @ C, (discount * window.masks[:, 0])[:, None, None], out=diagonal)
        rhs = weighted @ CY.T
    else:
        through = C.T @ weights.of(window.masks).y
        np.multiply(through @ C, discount[:, None, None], out=diagonal)
        rhs = np.matmul(through, weighted[:, :, None])[:, :, 0]
    if count > 1:
        diagonal[1:] += joint[:, n:, n:]
        diagonal[:-1] += joint[:, :n, :n]
        columns[:-1, n : 2 * n] = joint[:, n:, :n]
        moved = np.matmul(joint[:, :, n:], window.defect[:, :, None])[:, :, 0]
        rhs[1:] += moved[:, n:]
        rhs[:-1] += moved[:, :n]
    half = window.prior_half
    diagonal[0] += half.T @ half
    # band row r of column b is row r + b of its block column: a view with strides of its own
    step = columns.itemsize
    band = np.ndarray((count, n, 2 * n), buffer=columns, strides=(columns.strides[0], (n + 1) * step, n * step))
    return band.reshape(count * n, 2 * n).T, rhs.ravel()


def solve_banded(window: EstimationWindow) -> Solution | None:
    """Return the minimiser by one banded Cholesky factorisation, None where that would lose digits."""
    assembled = information_band(window)
    if assembled is None:
        return None
    band, rhs = assembled
    n = window.reference.shape[1]
    factor, solution, flag = lapack.dpbsv(band, rhs, lower=1)
    if flag != 0 or (factor[0] ** 2 / band[0]).min() < PIVOT_LIMIT:
        return None
    deviation = solution.reshape(-1, n)
    # the last block of the factor is the root of the last node's marginal information
    last = lapack.dtrtri(last_block(factor, n), lower=1)[0]
    cost = _cost(window, deviation)
    dual = cost - DUAL_MARGIN * (cost + abs(float(rhs @ solution)))
    return Solution(window.reference + deviation, last.T @ last, cost, dual, "banded", _BandSpread(factor, n))


@lru_cache(maxsize=64)
def _block_places(n: int, width: int) -> Index:
    """Where entry (i, j) of the last diagonal block stands in its n columns of a lower band, one after the other."""
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    return np.where(i >= j, j * width + np.maximum(i - j, 0), width * n - 1)


def last_block(factor: Array, n: int) -> Array:
    """Return the last diagonal block, lower triangular, of a factor of block-tridiagonal matrices in a lower band.

    Above its diagonal stands what the band holds below the matrix's last row: zeros.
    """
    columns = factor[:, factor.shape[1] - n :].T
    return np.asarray(columns.ravel()[_block_places(n, columns.shape[1])])


@lru_cache(maxsize=64)
def _stack_index(n: int, width: int) -> tuple[Any, Any, Any]:
    """Where entry (a, b) of a diagonal block and the one below it stands in the band, and whether it is held there."""
    a, b = np.meshgrid(np.arange(2 * n), np.arange(n), indexing="ij")
    return np.clip(a - b, 0, width - 1), b, (a >= b) & (a - b < width)


@dataclass(frozen=True, eq=False)
class _BandSpread:
    """T = L^-T for a banded Cholesky factor L."""

    factor: Array
    n: int

    def states(self, z: Array) -> Array:
        """Return T z, (N+1, n)."""
        return np.asarray(lapack.dtbtrs(self.factor, z[:, None], uplo="L", trans="T")[0].reshape(-1, self.n))

    def rows(self, g: Array) -> Array:
        """Return g T for (r, (N+1) n) rows g."""
        return np.asarray(lapack.dtbtrs(self.factor, g.T, uplo="L")[0].T)

    def maps(self) -> Array:
        """Return T as (N+1, n, (N+1) n)."""
        width, m = min(self.factor.shape[0], self.factor.shape[1]), self.factor.shape[1]
        store = np.zeros(m * m + width)  # L column after column; a view with a stride of m + 1 is its band
        band = np.ndarray((m, width), buffer=store, strides=((m + 1) * store.itemsize, store.itemsize))
        band[:] = self.factor[:width].T
        inverse = lapack.dtrtri(store[: m * m].reshape(m, m).T, lower=1, overwrite_c=1)[0]
        return np.asarray(inverse.T.reshape(-1, self.n, m))

    def covariances(self) -> Array:
        """Return T_j T_j' of every node, (N+1, n, n)."""
        return self.kernel().covariances()

    def kernel(self) -> SmootherKernel:
        """Return T as a backward recursion."""
        n, width = self.n, self.factor.shape[0]
        columns = self.factor.reshape(width, -1, n)
        rows, cols, inside = _stack_index(n, width)
        stacked = np.where(inside[:, None, :], columns[rows, :, cols].transpose(0, 2, 1), 0.0)
        stacked = stacked.transpose(1, 0, 2)  # (N+1, 2n, n): diagonal block on top, the one below under it
        roots = np.swapaxes(np.linalg.solve(stacked[:, :n], np.eye(n)), 1, 2)
        gains = -roots[:-1] @ np.swapaxes(stacked[:-1, n:], 1, 2)
        return SmootherKernel(roots, gains)


def _cost(window: EstimationWindow, deviation: Array) -> float:
    """Cost at the reference plus `deviation`; only where every W is invertible."""
    square = window.prior_half @ deviation[0]
    fit = window.weighted(window.residual - deviation @ window.weights.plant.C.T)
    total = float(square @ square) + float(np.einsum("k,ki,ki->", window.discount, fit, fit))
    joint, n = window.joint, deviation.shape[1]
    if joint is not None and window.flows:
        moved = deviation[1:] - np.matmul(window.F, deviation[:-1, :, None])[:, :, 0] - window.defect
        total += float(np.sum(np.matmul(moved[:, None, :], joint[:, n:, n:])[:, 0] * moved))
    return total
