"""Linear plants that vary in time along a nonlinear plant's trajectory."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.signatures import checked
from sampling_design.uncertain.plants.time_varying import CLOSER, TOLERANCE, MatrixOfTime, TimeVaryingPlant, integrated


@checked
def plant_along(plant: NonlinearPlant, start: npt.ArrayLike, horizon: float, u: npt.ArrayLike = ()) -> TimeVaryingPlant:
    """Return the small deviations from a nonlinear plant's trajectory from `start`, with constant u and w = 0.

        d' = f_x(t, x(t)) d + f_w w,    y = h_x(t, x(t)) d + h_v v,    d the deviation from x(t)

    Parameters
    ----------
    plant : NonlinearPlant
    start : (n,) array
    horizon : float [time]
    u : (m,) array, optional
        Default 0.

    Returns
    -------
    TimeVaryingPlant
        With the plant's names, units and scales.

    Raises
    ------
    ArgumentError
        If a size differs.
    SolverError
        If the trajectory cannot be followed.
    """
    x0 = checks.vector("start", start, plant.n_states)
    control = checks.vector("u", np.zeros(plant.n_inputs) if not np.size(u) else u, plant.n_inputs)
    end, scale = checks.positive("horizon", horizon), plant.states.scales
    still = np.zeros(plant.n_disturbances)

    def rate(t: float, z: Array) -> Array:
        return np.array(plant.rate_casadi(z * scale, control, still, t)).ravel() / scale

    _, path = integrated(rate, 0.0, end, x0 / scale, CLOSER * TOLERANCE, dense=True)

    def at(which: int) -> MatrixOfTime:
        return lambda t: np.array(plant.slopes_casadi(path(t) * scale, control, 0, 0, t)[which])

    return TimeVaryingPlant(
        at(0), at(3), at(2) if plant.n_disturbances else None, horizon=end, time_unit=plant.time_unit,
        states=plant.states, outputs=plant.outputs, name=plant.name,
    )  # fmt: skip
