"""The weights of the cost (15), in the plant's scaled coordinates."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.records import checks
from sampling_design.records.arrays import Array


@dataclass(frozen=True, eq=False)
class NonlinearWeights:
    """P2, Qw, Qv, R for z = x/s_x, w/s_w, v/s_v, y/s_y, the rate eta [1/time_unit], and the paper's factor 2 (or 1)."""

    P2: Array
    Qw: Array
    Qv: Array
    R: Array
    eta: float
    twice: float = 2.0


def scaled_weights(plant: NonlinearPlant, cost: CostFunction, name: str = "P2") -> NonlinearWeights:
    """Return physical weights in scaled coordinates; the defaults are those of the linear estimator.

    `name` is what the weight of states is called in messages. Without a value: P2 = diag(1/s_x^2), Qw = diag(1/s_w^2),
    R = 2 diag(1/s_y^2), Qv = 2 diag(1/s_v^2). Raises ArgumentError if a weight has the wrong size or is not positive
    definite.
    """
    kinds = {"P2": ("states", 1.0), "Qw": ("disturbances", 1.0), "R": ("outputs", 2.0), "Qv": ("noises", 2.0)}
    found = {}
    for weight, (key, default) in kinds.items():
        value = getattr(cost, weight)
        typed = name if weight == "P2" else weight
        scale = plant.signals[key].scales
        if value is None:
            found[weight] = default * np.eye(scale.size)
        else:
            # scaled before it is judged: physical entries may differ by 24 orders of magnitude
            physical = checks.matrix(typed, value, scale.size, scale.size)
            found[weight] = checks.definite(typed, physical * scale * scale[:, None], scale.size)
    return NonlinearWeights(**found, eta=cost.eta or 0.0, twice=1.0 if cost.form == "certificate" else 2.0)


FAR = 1e3  # beyond this factor from 1 a signal without scales is likely to be one whose scales were forgotten


class ScaleWarning(UserWarning):
    """Signals without scales whose sizes are far from 1: weights and tolerances are likely not what is meant."""


def warn_of_scales(plant: NonlinearPlant, key: str, values: Sequence[Array]) -> None:
    """Warn if a vector of the plant has no scales though some of these values of it are far from 1.

    Warns
    -----
    ScaleWarning
        Names the largest such entry.
    """
    signals = plant.signals[key]
    sizes = np.abs(np.array([np.where(np.isfinite(value), value, 0.0) for value in values]))
    far = (sizes > FAR) | ((sizes < 1 / FAR) & (sizes > 0))
    if np.any(signals.scales != 1.0) or not far.any():
        return
    _, i = np.argwhere(far)[0]
    size = float(sizes[:, i][far[:, i]][0])
    warnings.warn(
        f"The {key} have no scales though {signals.names[i]} is about {size:.1e}: default weights and the solver's "
        f"tolerance mean 1. Give signals={{{key!r}: Signals(names, units, scales)}} to the plant.",
        ScaleWarning, stacklevel=4,
    )  # fmt: skip


def fit_covariance(plant: NonlinearPlant, weights: NonlinearWeights) -> Array:
    """The covariance (p, p) of the noise of a sample, physical, that the weights stand for: R^-1 + Qv^-1."""
    y, v = plant.signals["outputs"].scales, plant.signals["noises"].scales
    found = np.linalg.solve(weights.R, np.eye(y.size)) * y * y[:, None]
    if plant.n_noises == plant.n_outputs:
        found = found + np.linalg.solve(weights.twice * weights.Qv, np.eye(v.size)) * v * v[:, None]
    return np.asarray(found)
