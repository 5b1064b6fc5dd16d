"""The weights of the cost (15), in the plant's scaled coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design.estimators.gap_flows.cost_function import CostFunction
from sampling_design.nonlinear.model import NonlinearPlant

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NonlinearWeights:
    """P2, Qw, Qv, R for z = x/s_x, w/s_w, v/s_v, y/s_y, and the rate eta [1/time_unit]."""

    P2: Array
    Qw: Array
    Qv: Array
    R: Array
    eta: float


def scaled_weights(
    plant: NonlinearPlant,
    cost: CostFunction,
    name: str = "P2",
) -> NonlinearWeights:
    """Return physical weights in scaled coordinates; the defaults are those of the linear estimator.

    `name` is what the weight of states is called in messages.
    Without a value: P2 = diag(1/s_x^2), Qw = diag(1/s_w^2), R = 2 diag(1/s_y^2), Qv = 2 diag(1/s_v^2).

    Raises
    ------
    ArgumentError
        If a weight has the wrong size or is not positive definite.
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
            physical = _checks.matrix(typed, value, scale.size, scale.size)
            found[weight] = _checks.definite(typed, physical * scale * scale[:, None], scale.size)
    return NonlinearWeights(**found, eta=cost.eta or 0.0)
