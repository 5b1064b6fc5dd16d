"""Simulation of nonlinear plants, stiff ones included, with disturbances that are constant between grid times."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear._casadi import casadi
from sampling_design.nonlinear.model import NonlinearPlant

Array = npt.NDArray[np.float64]
TOLERANCE = 1e-10
"""Relative and absolute tolerance of the integrator, in scaled states."""


MAX_STEPS = 20000
"""Steps that the integrator may take over one stretch."""


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
    start = _checks.vector("x0", x0, plant.n_states)
    require_inside(plant, "x0", start)
    grid = _checks.increasing("times", times)
    controls = _per_time("u", u, grid.size, plant.n_inputs)
    noise = _per_time("w", w, grid.size, plant.n_disturbances)
    integrator = Integrator(plant, tolerance)
    states = np.empty((grid.size, plant.n_states))
    states[:1] = start
    for j in range(grid.size - 1):
        states[j + 1] = integrator.step(states[j], controls[j], noise[j], grid[j], grid[j + 1])
    return states


class Integrator:
    """Carries a state over a stretch of constant input and disturbance; built once, used for many stretches."""

    def __init__(self, plant: NonlinearPlant, tolerance: float = TOLERANCE) -> None:
        ca = casadi()
        m, q = plant.n_inputs, plant.n_disturbances
        z, uw, h = ca.SX.sym("z", plant.n_states), ca.SX.sym("uw", m + q), ca.SX.sym("h")
        self.plant, self.scale = plant, plant.signals["states"].scales
        rate = plant.f_casadi(z * self.scale, uw[:m], uw[m:]) / self.scale
        problem = {"x": z, "p": ca.vertcat(uw, h), "ode": h * rate}
        options: dict[str, object] = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": MAX_STEPS}
        options |= {"disable_internal_warnings": True, "show_eval_warnings": False}  # raised, not printed
        self._step = ca.integrator("step", "cvodes", problem, 0.0, 1.0, options)

    def step(self, x: Array, u: Array, w: Array, start: float, stop: float) -> Array:
        """Return x(stop) from x(start) = x.

        Raises
        ------
        SolverError
            If the integration fails.
        """
        parameters = np.concatenate([u, w, [stop - start]])
        try:
            found = np.array(self._step(x0=x / self.scale, p=parameters)["xf"]).ravel()
        except RuntimeError as error:
            raise SolverError(
                f"the integration fails between t = {start:.6g} and {stop:.6g} {self.plant.time_unit} "
                f"({_reason(error)}).", status="integration failed",
            ) from None  # fmt: skip
        return np.asarray(found * self.scale)


def _reason(error: RuntimeError) -> str:
    """The integrator's own word for what went wrong."""
    word = re.search(r'returned "(\w+)"', str(error))
    return f"the integrator says {word[1]}" if word else "the integrator gives no reason"


def require_inside(plant: NonlinearPlant, name: str, x: Array) -> None:
    """Refuse a state outside the plant's box.

    Raises
    ------
    ArgumentError
        If an entry lies outside; the message names it.
    """
    lower, upper = plant.bounds["states"]
    outside = np.flatnonzero((x < lower) | (x > upper))
    if outside.size:
        i = int(outside[0])
        raise ArgumentError(
            f"`{name}` must lie in the plant's box of states, got {plant.signals['states'].names[i]} = {x[i]:.6g} "
            f"outside [{lower[i]:.6g}, {upper[i]:.6g}]."
        )


def _per_time(name: str, value: npt.ArrayLike | None, rows: int, columns: int) -> Array:
    """Rows of an input, one per grid time; a single row holds throughout."""
    if value is None:
        return np.zeros((rows, columns))
    array = np.asarray(value, dtype=float)
    if array.ndim == 1:
        array = np.broadcast_to(_checks.vector(name, array, columns), (rows, columns))
    return _checks.matrix(name, array, rows, columns)
