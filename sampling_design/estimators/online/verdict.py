"""What a solve is worth: the radius that follows from its cost, and what contradicts the bounds."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.online.estimate import Contradiction, Status
from sampling_design.estimators.online.history import HistoryNode
from sampling_design.estimators.online.rounding import moved, rounding
from sampling_design.records.arrays import Array

CONTRADICTION = 1e-9
"""The bound must fall below zero by this share of its terms before the noise bounds count as disproved."""

ROUNDING = 1e-12  # share of its terms that is added to every bound, so that rounding cannot break it
LARGEST_RESIDUAL = 1e150  # residuals beyond this, in units of their weights, have squares that overflow in sums


class SolveVerdict(NamedTuple):
    """What a solve is worth: the bound on |x|^2_Pi, the status, whether the assumptions stand, and what contradicts."""

    beta: float
    status: Status
    sound: bool
    contradiction: Contradiction | None


def judged(weights: CostWeights, terms: float, dual: float, last: HistoryNode) -> SolveVerdict:
    """Return the radius `terms` - `dual`, its status, and whether the assumptions still stand.

    `terms` is what the truth costs at most, `dual` a lower bound on what any trajectory costs.
    """
    beta = terms - dual
    if beta < -CONTRADICTION * terms:
        return SolveVerdict(0.0, "bounds disproved", False, last.contradiction)
    rest = (ROUNDING + weights.loose) * terms + moved(terms, last.held)
    return SolveVerdict(max(beta, 0.0) + rest, "ok", last.stands, last.contradiction)


def rounding_energy(weights: CostWeights, y: Array, x: Array) -> float:
    """Return what the rounding of (N, p) measurements and of a state may cost."""
    # entry by entry: a large value in one unit says nothing about the rounding of another
    read, held = np.abs(weights.y_root) @ np.abs(y).T, np.abs(weights.prior_factor.T) @ np.abs(x).T
    return rounding(float(np.vdot(read, read)), float(np.vdot(held, held)))


def too_large(weighted: Array) -> bool:
    """Whether residuals, in units of their weights, are so large that their squares overflow."""
    return not bool((np.abs(weighted) < LARGEST_RESIDUAL).all())


def overflowed(
    weights: CostWeights, last: HistoryNode, sample: RecordRow, residual: Array, terms: float
) -> tuple[SolveVerdict, str]:
    """Return what a sample is worth that is too large to be weighed: nothing, and a contradiction of all bounds."""
    contradiction, words = last.contradiction, "A measurement is too large to be weighed."
    if np.isinf(terms):
        return SolveVerdict(np.nan, "solver failed", last.stands, contradiction), words
    if contradiction is None:
        measured = np.isfinite(sample.y)
        output = int(np.argmax(np.where(measured, np.abs(residual), -1.0)))
        weight = float(np.max(np.abs(weights.y_root[:, output])))
        factor = weight * abs(float(residual[output])) / math.sqrt(terms) if terms > 0 else np.inf
        name = weights.plant.outputs.names[output]
        contradiction = Contradiction(last.number + 1, sample.t, name, factor)
    return SolveVerdict(np.nan, "bounds disproved", False, contradiction), words
