"""The window problem without constraints by orthogonal factorisations: no noise Gramian is inverted."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from sampling_design.estimators.window.window_estimate import DUAL_MARGIN, SmootherKernel, WindowEstimate
from sampling_design.estimators.window.window_problem import EstimationWindow
from sampling_design.numerics.filtering import root_update
from sampling_design.records.arrays import Array


def solve_square_root(window: EstimationWindow) -> WindowEstimate:
    """Return the minimiser by orthogonal factorisations, forward and backward.

    Notes
    -----
    *Method.* In units of the last node the covariance root S_j goes through the triangular factor of
    [[S_j'F', S_j'], [root', 0]] = Q [[P', K], [0, D']]: P is the predicted root, (P^-T K)' = G_j the smoother's
    gain, D the root of what x_{j+1} leaves unknown of x_j. A sample does the same with [[I, 0], [S'C', S']].
    """
    n, count = window.reference.shape[1], window.times.size
    roots, gains = np.empty((count, n, n)), np.empty((count - 1, n, n))
    filtered, predicted = np.empty((count, n)), np.empty((count, n))
    scale = np.sqrt(window.discount)
    root, mean, cost = window.prior_root / scale[0], np.zeros(n), 0.0
    for j in range(count):
        predicted[j] = mean
        if window.masks[j].any():
            root, mean, part = _absorb(window, j, root, mean, scale[j])
            cost += part
        filtered[j] = mean
        if j + 1 == count:
            break
        flow = window.flows[j]
        width = flow.root.shape[1]
        stacked = np.zeros((n + max(n, width), 2 * n))
        stacked[:n, :n], stacked[:n, n:] = root.T @ flow.F.T, root.T
        stacked[n : n + width, :n] = flow.root.T / scale[j + 1]
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
        gains[j] = lapack.dtrtrs(triangle[:n, :n], triangle[:n, n:])[0].T
        roots[j] = triangle[n : 2 * n, n:].T
        root, mean = triangle[:n, :n].T, flow.F @ mean + window.defect[j]
    roots[-1] = root
    nodes = filtered
    for j in range(count - 2, -1, -1):
        nodes[j] += gains[j] @ (nodes[j + 1] - predicted[j + 1])
    margin = DUAL_MARGIN * (cost + _cost_of_reference(window))
    found = SmootherKernel(roots, gains)
    return WindowEstimate(window.reference + nodes, root @ root.T, cost, cost - margin, "square root", found)


def _absorb(window: EstimationWindow, j: int, root: Array, mean: Array, scale: float) -> tuple[Array, Array, float]:
    """Return root and mean after the sample at node j, and what the innovation costs."""
    weights = window.weights
    weigh = weights.at(window.masks[j]).y_root * scale
    innovation = weigh @ (window.residual[j] - weights.plant.C @ mean)
    root, step, half = root_update(root, weigh @ weights.plant.C, innovation)
    return root, mean + step, float(half @ half)


def _cost_of_reference(window: EstimationWindow) -> float:
    """What the outputs cost along the reference: the size of the numbers that the optimum is a difference of."""
    fit = window.weighted(window.residual)
    return float(np.einsum("k,ki,ki->", window.discount, fit, fit))
