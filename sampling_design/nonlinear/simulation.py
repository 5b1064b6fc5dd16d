"""Simulation of nonlinear plants, stiff ones included, with disturbances that are constant between grid times."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear._casadi import casadi
from sampling_design.nonlinear.model import NonlinearPlant

Array = npt.NDArray[np.float64]
TOLERANCE = 1e-10
"""Relative and absolute tolerance of the integrator, in scaled states."""


def simulate(
    plant: NonlinearPlant,
    x0: npt.ArrayLike,
    times: npt.ArrayLike,
    u: npt.ArrayLike | None = None,
    w: npt.ArrayLike | None = None,
    *,
    tolerance: float = TOLERANCE,
) -> Array:
    """Return the states at `times` of x' = f(x, u, w), x(times[0]) = x0.

    Parameters
    ----------
    plant : NonlinearPlant
    x0 : (n,) array
    times : (N,) array [plant.time_unit]
        Strictly increasing; row j of u and w holds on [times[j], times[j+1]).
    u : (N, m) or (m,) array, optional
    w : (N, q) or (q,) array, optional
        Default zero.
    tolerance : float
        Of the integrator, relative and absolute, in scaled states.

    Returns
    -------
    (N, n) array

    Raises
    ------
    ArgumentError
        If shapes differ, or x0 lies outside the plant's box of states.
    SolverError
        If the integration fails; the message says from which time on.

    Notes
    -----
    *Method.* Variable-order BDF (CVODES) in scaled states x/s_x, restarted at each grid time because
    the disturbance jumps there; copes with time constants from milliseconds to days.

    References
    ----------
    The paper, equation (1).

    Examples
    --------
    >>> decay = NonlinearPlant(lambda x, u, w: [-x[0]], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    >>> bool(abs(simulate(decay, [1.0], [0.0, 1.0])[-1, 0] - np.exp(-1)) < 1e-8)
    True
    """
    ca = casadi()
    n = plant.sizes["states"]
    start = _checks.vector("x0", x0, n)
    lower, upper = plant.bounds["states"]
    outside = np.flatnonzero((start < lower) | (start > upper))
    if outside.size:
        name = plant.signals["states"].names[int(outside[0])]
        raise ArgumentError(
            f"`x0` must lie in the plant's box of states, got {name} = {start[outside[0]]:.6g} outside it."
        )
    grid = _checks.increasing("times", times)
    controls = _per_time("u", u, grid.size, plant.sizes["inputs"])
    noise = _per_time("w", w, grid.size, plant.sizes["disturbances"])
    scale = plant.signals["states"].scales
    z, uw, h = ca.SX.sym("z", n), ca.SX.sym("uw", controls.shape[1] + noise.shape[1]), ca.SX.sym("h")
    rate = plant.f_casadi(z * scale, uw[: controls.shape[1]], uw[controls.shape[1] :]) / scale
    problem = {"x": z, "p": ca.vertcat(uw, h), "ode": h * rate}
    options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 100000}
    step = ca.integrator("step", "cvodes", problem, 0.0, 1.0, options)
    states = np.empty((grid.size, n))
    states[:1] = start
    for j in range(grid.size - 1):
        parameters = np.concatenate([controls[j], noise[j], [grid[j + 1] - grid[j]]])
        try:
            found = np.array(step(x0=states[j] / scale, p=parameters)["xf"]).ravel()
        except RuntimeError as error:
            raise SolverError(
                f"the integration fails between t = {grid[j]:.6g} and {grid[j + 1]:.6g} {plant.time_unit} "
                f"({str(error).strip().splitlines()[-1]:.120})", status="integration failed",
            ) from None  # fmt: skip
        states[j + 1] = found * scale
    return states


def _per_time(name: str, value: npt.ArrayLike | None, rows: int, columns: int) -> Array:
    """Rows of an input, one per grid time; a single row holds throughout."""
    if value is None:
        return np.zeros((rows, columns))
    array = np.asarray(value, dtype=float)
    if array.ndim == 1:
        array = np.broadcast_to(_checks.vector(name, array, columns), (rows, columns))
    return _checks.matrix(name, array, rows, columns)
