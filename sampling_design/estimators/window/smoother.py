"""The window problem without active constraints, in closed form, by two routes.

`solve_banded` needs every W_h well conditioned: one banded Cholesky factorisation of the block-tridiagonal
information matrix of the nodes. `solve_square_root` inverts no W_h: a forward pass of orthogonal
factorisations (square-root covariance filter) and a backward pass (smoother), whatever the rank of W_h.

Both say more than the minimiser x*: any trajectory is
    x_N = x*_N + S_N z_N,    x_j = x*_j + G_j (x_{j+1} - x*_{j+1}) + S_j z_j,
and then costs J* + |z|^2. Constraints become a least-distance problem in z (`qp.py`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import lapack

from sampling_design.estimators.online.verdict import ROUNDED, SHARE_HELD
from sampling_design.estimators.window.window_problem import (
    DUAL_MARGIN,
    EstimateDeviations,
    EstimationWindow,
    WindowEstimate,
    with_means,
)
from sampling_design.numerics.filtering import inverse_of_unit_rows, root_update
from sampling_design.records.arrays import Array

VANISHED = float(np.sqrt(np.finfo(float).tiny))  # a root below it has no square
ROUNDING_NOISE = 1e-8
"""Deviation of what stands for a gap's rounding, of the size of its terms: the root of eps, half the digits."""

HIDDEN = 1e-14  # share of a column below which what others leave of it is rounding


def solve_square_root(window: EstimationWindow) -> WindowEstimate:
    """Return the minimiser by orthogonal factorisations, forward and backward.

    Notes
    -----
    *Method.* In units of the last node the covariance root S_j goes through the triangular factor of
    [[S_j'F', S_j'], [root', 0]] = Q [[P', K], [0, D']]: P is the predicted root, (P^-T K)' = G_j the smoother's
    gain, D the root of what x_{j+1} leaves unknown of x_j. A sample does the same with [[I, 0], [S'C', S']].

    *Numerical aspects.* Rounding over a gap is a disturbance of its own, entry by entry: of deviation `ROUNDING_NOISE`
    times that of the terms of F S_j, of which the truth, to follow a rounding by e, needs n (e / ROUNDING_NOISE)^2 of
    its cost; and of the size of states and inputs, such that it costs `SHARE_HELD` of a bound in all (`held`).
    """
    n, count = window.reference.shape[1], window.times.size
    roots, gains, filters = np.empty((count, n, n)), np.empty((count - 1, n, n)), np.empty((count, n, n))
    filtered, predicted, size = np.empty((count, n)), np.empty((count, n)), np.zeros((count, n))
    scale, held = np.sqrt(window.discount), np.abs(window.reference)
    root, mean, cost = window.prior_root / scale[0], np.zeros(n), 0.0
    for j in range(count):
        predicted[j] = mean
        if window.masks[j].any():
            root, mean, part = _absorb(window, j, root, mean, scale[j])
            size[j] += np.abs(mean - predicted[j])
            cost += part
        filtered[j], filters[j] = mean, root
        if j + 1 == count:
            break
        flow = window.flows[j]
        width, moved = flow.root.shape[1], flow.size @ np.abs(root)
        size[j + 1] = np.maximum(held[j + 1], flow.size @ (held[j] + np.abs(mean)) + np.abs(window.drift[j]))
        rounding = ROUNDED * math.sqrt(count / SHARE_HELD) / scale[j + 1] * size[j + 1]
        stacked = np.zeros((2 * n + max(n, width), 2 * n))
        stacked[:n, :n], stacked[:n, n:] = root.T @ flow.F.T, root.T
        stacked[n : n + width, :n] = flow.root.T / scale[j + 1]
        stacked[-n:, :n] = np.diag(np.hypot(ROUNDING_NOISE * np.sqrt(np.einsum("ik,ik->i", moved, moved)), rounding))
        root, gains[j], roots[j] = _passed(stacked, n)
        mean = flow.F @ mean + window.defect[j]
    roots[-1] = root
    nodes = filtered
    for j in range(count - 2, -1, -1):
        nodes[j] += gains[j] @ (nodes[j + 1] - predicted[j + 1])
    # what the outputs cost along the reference: the size of the numbers that the optimum is a difference of
    fit = window.weighted(window.residual)
    margin = DUAL_MARGIN * (cost + float(np.einsum("k,ki,ki->", window.discount, fit, fit)))
    found = EstimateDeviations(roots, gains)
    return WindowEstimate(
        window.reference + nodes,
        root @ root.T,
        cost,
        cost - margin,
        "square root",
        found,
        held=_in_units(filters, size),
    )


def _in_units(roots: Array, size: Array) -> float:
    """Return |z|^2 for the largest |S_j^-1| size_j of all nodes, entry by entry; infinite beyond all numbers."""
    unit = np.linalg.norm(roots, axis=2)
    if not (np.isfinite(unit).all() and np.isfinite(size).all()):
        return np.inf
    unit = np.where(unit > 0, unit, np.inf)  # what is nothing, and known to be, is not rounded
    far = np.matmul(np.abs(inverse_of_unit_rows(roots / unit[:, :, None])), (size / unit)[:, :, None])
    return float(np.vdot(far, far))


def _passed(stacked: Array, n: int) -> tuple[Array, Array, Array]:
    """P, G and D of stacked rows. What has decayed beyond numbers says nothing of what it was: it has no gain."""
    size = np.sqrt(np.einsum("ki,ki->i", stacked[:, :n], stacked[:, :n]))
    order, m = np.arange(n), n
    while True:
        R = np.asarray(np.linalg.qr(np.hstack([stacked[:, order], stacked[:, n:]]), mode="r"))
        lost = np.abs(R.diagonal()[:m]) <= np.maximum(HIDDEN * size[order[:m]], VANISHED)
        if not lost.any():
            break
        order, m = np.append(np.delete(order, at := int(np.argmax(lost))), order[at]), m - 1
    P, G = np.zeros((2, n, n))
    P[order, :m] = R[:m, :n].T
    G[:, order[:m]] = lapack.dtrtrs(R[:m, :m], R[:m, n:])[0].T
    rest = R[m:, n:]
    return P, G, (rest if m == n else np.asarray(np.linalg.qr(rest, mode="r"))).T


def _absorb(window: EstimationWindow, j: int, root: Array, mean: Array, scale: float) -> tuple[Array, Array, float]:
    """Return root and mean after the sample at node j, and what the innovation costs."""
    weights = window.weights
    weigh = weights.at(window.masks[j]).y_root * scale
    innovation = weigh @ (window.residual[j] - weights.plant.C @ mean)
    root, step, half = root_update(root, weigh @ weights.plant.C, innovation)
    return root, mean + step, float(half @ half)


PIVOT_LIMIT = 1e-5
"""A Cholesky pivot below this share of its diagonal entry has lost five digits: the other route is taken."""


def smooth(window: EstimationWindow) -> WindowEstimate:
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


def solve_banded(window: EstimationWindow) -> WindowEstimate | None:
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
    spread, cost = _kernel(factor, n), _cost(window, deviation)
    last = spread.roots[-1]  # from the factor's last block, the root of the last node's marginal information
    dual = cost - DUAL_MARGIN * (cost + abs(float(rhs @ solution)))
    return WindowEstimate(window.reference + deviation, last @ last.T, cost, dual, "banded", spread)


@lru_cache(maxsize=64)
def _stack_index(n: int, width: int) -> tuple[Any, Any, Any]:
    """Where entry (a, b) of a diagonal block and the one below it stands in the band, and whether it is held there."""
    a, b = np.meshgrid(np.arange(2 * n), np.arange(n), indexing="ij")
    return np.clip(a - b, 0, width - 1), b, (a >= b) & (a - b < width)


def _kernel(factor: Array, n: int) -> EstimateDeviations:
    """The inverse L^-T of a banded Cholesky factor L as a recursion from the last node back."""
    width = factor.shape[0]
    columns = factor.reshape(width, -1, n)
    rows, cols, inside = _stack_index(n, width)
    stacked = np.where(inside[:, None, :], columns[rows, :, cols].transpose(0, 2, 1), 0.0)
    stacked = stacked.transpose(1, 0, 2)  # (N+1, 2n, n): diagonal block on top, the one below under it
    roots = np.swapaxes(np.linalg.solve(stacked[:, :n], np.eye(n)), 1, 2)
    return EstimateDeviations(roots, -roots[:-1] @ np.swapaxes(stacked[:-1, n:], 1, 2))


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
