"""What a solved window leaves unknown, to first order: covariances at its nodes, and what errors on the way do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.nonlinear.weights import NonlinearWeights
from sampling_design.nonlinear.window_forms import WindowSlopes
from sampling_design.numerics.filtering import propagate
from sampling_design.records.arrays import Array


class WindowCovariances(NamedTuple):
    """Filtered covariances of a window as roots, scaled, discounted to each node's own time.

    filtered (K+1, n, n) with S S' = Y after the samples of each node, grown (K+1, n, n) before them; noise (K, n, n):
    root of what an interval adds; bias (n,): what the given jumps of the state make of the last estimate.
    """

    filtered: Array
    grown: Array
    noise: Array
    bias: Array

    @property
    def last(self) -> Array:
        """Covariance at the window's end, (n, n)."""
        return np.asarray(self.filtered[-1] @ self.filtered[-1].T)


def window_covariances(
    edges: Array, slopes: WindowSlopes, root: Array, weights: NonlinearWeights, jumps: Array | None = None
) -> WindowCovariances:
    """Return the covariances of a window, without its boxes.

        Y <- e^{eta h} F Y F' + G (Qw int e^{-eta s} ds)^-1 G',    Y^-1 <- Y^-1 + H'WH at a sample

    Parameters
    ----------
    edges : (K+1,) array
    root : (n, n) array
        Upper triangular; its square weighs the error at the window's start.
    jumps : (K, n) array, optional
        Added to the state at the end of each interval; `bias` is what the estimator makes of them.
    """
    n, lengths = root.shape[0], np.diff(edges)
    upper = np.triu(np.ones((n, n)))
    S = lapack.dtrtri(root)[0]
    noise_flow, growth = np.zeros((len(lengths), n, n)), np.exp(weights.eta * lengths / 2)[:, None, None] * slopes.F
    if len(lengths) and slopes.G.shape[2]:
        lower = np.linalg.cholesky(weights.twice * weights.Qw)
        worth = np.sqrt(discounted_length(weights.eta, lengths))[:, None, None]
        noise_roots = np.linalg.solve(lower, slopes.G.transpose(0, 2, 1)) / worth
        triangle: Array = np.asarray(np.linalg.qr(noise_roots, mode="r"), dtype=np.float64)
        noise_flow[:, :, : triangle.shape[1]] = triangle.transpose(0, 2, 1)
    filtered, grown = np.empty((len(edges), n, n)), np.empty((len(edges), n, n))
    bias, whitened_rows = np.zeros(n), slopes.roots @ slopes.H
    measured: list[bool] = [bool(root.any()) for root in slopes.roots]
    for k in range(len(edges)):
        if k:
            wide = np.concatenate([growth[k - 1].dot(S).T, noise_flow[k - 1].T])
            factor = lapack.dgeqrf(wide)[0]
            S = (factor[:n] * upper).T
            if jumps is not None:
                bias = slopes.F[k - 1].dot(bias) + jumps[k - 1]
        grown[k] = S
        if measured[k]:
            A = whitened_rows[k].dot(S)
            information = A.T.dot(A)
            information.flat[:: n + 1] += 1.0
            half = lapack.dtrtri(lapack.dpotrf(information, clean=1)[0])[0]
            S = S.dot(half)
            if jumps is not None:
                bias = bias - S.dot(A.dot(half).T.dot(whitened_rows[k].dot(bias)))
        filtered[k] = S
    return WindowCovariances(filtered, grown, noise_flow, bias)


def smoothed_covariances(covariances: WindowCovariances, slopes: WindowSlopes, edges: Array, eta: float) -> Array:
    """Return the covariances (K+1, n, n) at all nodes, given all samples, discounted to the window's end.

    Y_j = (I - J F) Y (I - J F)' + J (Y_{j+1} + N) J',    J = Y F' (F Y F' + N)^-1
    """
    found = np.empty_like(covariances.filtered)
    found[-1] = covariances.last
    n = found.shape[1]
    for k in range(len(edges) - 2, -1, -1):
        growth = np.exp(eta * (edges[-1] - edges[k]))
        root, F = np.sqrt(growth) * covariances.filtered[k], slopes.F[k]
        noise = np.sqrt(np.exp(eta * (edges[-1] - edges[k + 1]))) * covariances.noise[k]
        ahead = F @ root
        # J' solves (F Y F' + N) J' = F Y, here as a least-squares problem of the roots
        both = np.hstack([ahead, noise])
        gain = root @ np.linalg.lstsq(both, np.eye(n), rcond=None)[0][: root.shape[1]]
        rest = root - gain @ ahead
        found[k] = propagate(found[k + 1] + noise @ noise.T, gain, rest @ rest.T)
    return found
