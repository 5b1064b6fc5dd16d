"""What rounding may cost a radius: of data and states, and of the matrices between them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from sampling_design.estimators.gap_flows.flows import GapFlow
from sampling_design.estimators.online.history import HistoryNode
from sampling_design.records.arrays import Array

ROUNDED = 1e-14
"""Relative error of what is computed with data and states: it moves a centre, and adds to the root of a bound. (Found:
3e-15, against fifty digits, in tests/laws.)"""

EXACT_DATA = 1e-13
"""Relative error with which even exact data and states are held; its square, in the weights, joins every bound."""


def moved(bound: float, held: float) -> float:
    """What is added to a bound by rounding that moves what is measured against it: its root grows by that.

    `held` is the square of the numbers, in the units of the bound.
    """
    if not math.isfinite(bound):
        return 0.0
    size = ROUNDED * math.sqrt(held)
    return (2 * math.sqrt(max(bound, 0.0)) + size) * size


def scaled_bound(bound: float, share: float) -> float:
    """Return what is left of a bound; all of one that is infinite, however small the share."""
    return bound * share if math.isfinite(bound) else bound


def passed(node: HistoryNode, flow: GapFlow, drift: Array | None, x: Array) -> Array:
    """The sizes of the numbers that x was computed from, along a gap from a node; no `drift`: without inputs."""
    led: Array = flow.size.dot(abs(node.x))
    if drift is not None:
        led += abs(drift)
    return np.maximum(abs(x), led, out=led)


class CovariancePrecision(NamedTuple):
    """Of a covariance Y: |U|, r with U U' = r Y^-1, and the trace of the inverse of Y's correlations."""

    size: Array
    scale: float
    condition: float

    @classmethod
    def of(cls, Y: Array, U: Array, scale: float) -> CovariancePrecision:
        """Return that of Y = scale (U U')^-1."""
        return cls(abs(U), scale, sum(Y.diagonal().dot(U * U).tolist()) / scale)


def in_units_of(Y: Array, size: Array, precision: CovariancePrecision | None = None) -> tuple[float, float]:
    """|z|^2 for |z_i| <= |S^-1| size, S S' = Y: a state, entry by entry, in units of what is known of it.

    And the trace of the inverse of Y's correlations, which is their condition or more. What rounding has made singular
    counts as known to n eps of the rest.
    """
    if precision is not None:
        half, scale, near = precision
        far = math.hypot(*size.dot(half).tolist()) / math.sqrt(scale)
        # beyond all numbers there is no radius, as below
        return (far * far, near) if math.isfinite(far) and math.isfinite(near) else (0.0, 0.0)
    unit = np.sqrt(Y.diagonal())
    if not (np.isfinite(Y).all() and np.isfinite(size).all()):
        return 0.0, 0.0  # then there is no radius
    kept = unit > 0
    if not kept.all():
        if not kept.any():
            return 0.0, 0.0
        Y, size, unit = Y[np.ix_(kept, kept)], size[kept], unit[kept]
    factor, flag = lapack.dpotrf(Y / unit[:, None] / unit, lower=1, clean=1)
    if flag:
        values, vectors = np.linalg.eigh(Y / unit[:, None] / unit)
        least = len(Y) * float(np.finfo(float).eps) * values[-1]
        half = vectors.T / np.sqrt(np.maximum(values, least))[:, None]
    else:
        half = lapack.dtrtri(factor, lower=1)[0]
    far, near = math.hypot(*np.abs(half).dot(size / unit).tolist()), math.hypot(*half.ravel().tolist())
    return far * far, near * near


def rounding(read: float, held: float) -> float:
    """What the rounding of measurements and of states may cost, for the sums of their weighted squares."""
    return (EXACT_DATA * (math.sqrt(read) + math.sqrt(held))) ** 2
