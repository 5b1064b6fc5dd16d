"""What a solve is worth: the radius that follows from its cost, what contradicts the bounds, what rounding costs."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from scipy.linalg import lapack

from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.gap_flows.flows import PROPAGATED, GapFlow, inflated
from sampling_design.estimators.online.estimate import Contradiction, Status
from sampling_design.estimators.online.history import HistoryNode
from sampling_design.numerics.filtering import floored
from sampling_design.records.arrays import Array

ROUNDED = 1e-14
"""Relative error of what is computed with data and states: it moves a centre, and adds to the root of a bound. (Found:
3e-15, against fifty digits, in tests/laws.)"""

SHARE_HELD = 1e-3
"""Share of a bound that is added to it for entries that it leaves less than their rounding: a larger one widens them
less, and all others more."""

INFLATED_BEYOND = 1e-6
"""Share of a radius that rounding of its covariance may cost; beyond it the covariance grows instead."""

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
    found: Array = np.maximum(abs(x), led)
    return found


CovariancePrecision: TypeAlias = tuple[Array, float]
"""Of a covariance Y: |U| with U U' = Y^-1, and the trace of the inverse of Y's correlations."""


def covariance_precision(Y: Array, U: Array) -> CovariancePrecision:
    """Return that of Y = (U U')^-1."""
    return abs(U), sum(Y.diagonal().dot(U * U).tolist())


def held_entries(Y: Array, size: Array, bound: float) -> tuple[Array, Array, float]:
    """Y and a bound |z|^2_Y^-1, widened where they leave an entry less than its own rounding; what is left of `size`.

    With D = diag(d) and |r|^2_D^-1 <= more, |z + r|^2 in the inverse of Y + D is at most bound + more: a decay that
    makes an entry of Y vanish does not make its state known beyond its digits.
    """
    entries = enumerate(zip(Y.diagonal().tolist(), size.tolist(), strict=True))
    lost = [i for i, (variance, held) in entries if bound * variance < (ROUNDED * held) * (ROUNDED * held)]
    if not lost or not (math.isfinite(bound) and np.isfinite(Y).all()):
        return Y, size, bound
    more, Y, size = SHARE_HELD * (bound if bound > 0 else 1.0), Y.copy(), size.copy()
    Y[lost, lost] += len(lost) * (ROUNDED * size[lost]) ** 2 / more
    size[lost] = 0.0
    return Y, size, bound + more


def in_units_of(Y: Array, size: Array, precision: CovariancePrecision | None = None) -> tuple[float, float]:
    """|z|^2 for |z_i| <= |S^-1| size, S S' = Y: a state, entry by entry, in units of what is known of it.

    And the trace of the inverse of Y's correlations, which is their condition or more. What rounding has made singular
    counts as known to n eps of the rest.
    """
    if precision is not None:
        half, near = precision
        far = math.hypot(*size.dot(half).tolist())
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
        half = floored(Y / unit[:, None] / unit)
    else:
        half = lapack.dtrtri(factor, lower=1)[0]
    far, near = math.hypot(*np.abs(half).dot(size / unit).tolist()), math.hypot(*half.ravel().tolist())
    return far * far, near * near


def represented(
    Y: Array, size: Array, bound: float, precision: CovariancePrecision | None = None
) -> tuple[Array, float, float]:
    """Return Y and a bound |z|^2_Y^-1 as doubles can hold them, no smaller than in exact numbers, and `size` in Y.

    Where the condition of Y's correlations has cost it digits, its diagonal grows by what rounding may hide; elsewhere
    the bound does.
    """
    held, condition = in_units_of(Y, size, precision)
    wider = Y
    if precision is None or not 0.0 < ROUNDED * ROUNDED * held <= bound:  # else no entry is left less than its rounding
        wider, size, bound = held_entries(Y, size, bound)
        held, condition = (held, condition) if wider is Y else in_units_of(wider, size)
    if PROPAGATED * condition > INFLATED_BEYOND:
        wider, condition = inflated(wider.copy()), 0.0
        held, _ = in_units_of(wider, size)
    return wider, bound * (1 + PROPAGATED * condition) + moved(bound, held), held


def rounding(size: float) -> float:
    """What the rounding of measurements and of states may cost, for the sum of their weighted squares."""
    return 2 * EXACT_DATA * EXACT_DATA * size  # (a + b)^2 <= 2 (a^2 + b^2)


CONTRADICTION = 1e-9
"""The bound must fall below zero by this share of its terms before the noise bounds count as disproved."""

ROUNDING = 1e-12  # share of its terms that is added to every bound, so that rounding cannot break it
LARGEST_RESIDUAL = 1e150  # residuals beyond this, in units of their weights, have squares that overflow in sums


SolveVerdict: TypeAlias = tuple[float, Status, bool, Contradiction | None]
"""What a solve is worth: the bound on |x|^2_Pi, the status, whether the assumptions stand, and what contradicts."""


def judged(weights: CostWeights, terms: float, dual: float, last: HistoryNode, held: float = 0.0) -> SolveVerdict:
    """Return the radius `terms` - `dual`, its status, and whether the assumptions still stand.

    `terms` is what the truth costs at most, `dual` a lower bound on what any trajectory costs, `held` the squares of
    the numbers of a solve in units of what is known of them.
    """
    beta, rest, contradiction = terms - dual, moved(terms, last.held + held), last.contradiction
    if beta < -CONTRADICTION * terms - rest:
        return 0.0, "bounds disproved", False, contradiction
    rest += (ROUNDING + weights.loose) * terms
    return max(beta, 0.0) + rest, "ok", last.sound and contradiction is None, contradiction


def rounding_energy(weights: CostWeights, y: Array, x: Array) -> float:
    """Return what the rounding of (N, p) measurements and of a state may cost."""
    # entry by entry: a large value in one unit says nothing about the rounding of another
    read, held = y * weights.entries[0], x * weights.entries[1]
    return rounding(float(np.vdot(read, read) + np.vdot(held, held)))


def too_large(weighted: Array) -> bool:
    """Whether residuals, in units of their weights, are so large that their squares overflow."""
    return not bool((np.abs(weighted) < LARGEST_RESIDUAL).all())


def overflowed(
    weights: CostWeights, last: HistoryNode, sample: RecordRow, residual: Array, terms: float
) -> tuple[SolveVerdict, str]:
    """Return what a sample is worth that is too large to be weighed: nothing, and a contradiction of all bounds."""
    contradiction, words = last.contradiction, "A measurement is too large to be weighed."
    if np.isinf(terms):
        return (np.nan, "solver failed", last.stands, contradiction), words
    if contradiction is None:
        measured = np.isfinite(sample.y)
        output = int(np.argmax(np.where(measured, np.abs(residual), -1.0)))
        weight = float(np.max(np.abs(weights.y_root[:, output])))
        factor = weight * abs(float(residual[output])) / math.sqrt(terms) if terms > 0 else np.inf
        name = weights.plant.outputs.names[output]
        contradiction = Contradiction(last.number + 1, sample.t, name, factor)
    return (np.nan, "bounds disproved", False, contradiction), words
