"""Simulation of nonlinear plants, stiff ones included, with disturbances that are constant between grid times."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear.collocation import BETWEEN
from sampling_design.nonlinear.functions import casadi
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import above, below
from sampling_design.records.signatures import checked
from sampling_design.uncertain.plants.time_varying import CLOSER, MatrixOfTime, TimeVaryingPlant, integrated
from sampling_design.uncertain.plants.time_varying import TOLERANCE as ALONG

TOLERANCE = 1e-10  # relative and absolute tolerance of the integrator, in scaled states
COVARIANCE_TOLERANCE = 1e-6  # of covariances, relative: a millionth of a variance changes no digit that is printed
CVODES = {"max_num_steps": 20000, "disable_internal_warnings": True, "show_eval_warnings": False}
"""Steps that the integrator may take over one stretch; where it fails, that is raised and not printed."""


def simulate(
    plant: NonlinearPlant,
    x0: npt.ArrayLike,
    times: npt.ArrayLike,
    u: npt.ArrayLike | None = None,
    w: npt.ArrayLike | None = None,
    *,
    tolerance: float = TOLERANCE,
    input_between: str = "held",
) -> Array:
    """Return the states at `times` of x' = f(x, u, w, t), x(times[0]) = x0.

    Raises ArgumentError if shapes differ, or x0 lies outside the plant's box of states; SolverError if the integration
    fails; the message says from which time on.

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
    input_between : "held" or "linear"
        Whether u keeps the value of row j on [times[j], times[j+1]) or runs straight to that of row j + 1.

    Returns
    -------
    (N, n) array

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
    start = checks.vector("x0", x0, plant.n_states)
    require_inside(plant, "x0", start)
    grid = checks.increasing("times", times)
    controls = _per_time("u", u, grid.size, plant.n_inputs)
    noise = _per_time("w", w, grid.size, plant.n_disturbances)
    checks.word("input_between", input_between, BETWEEN)
    later = controls[1:] if input_between == "linear" else controls
    integrator = Integrator(plant, tolerance)
    states = np.empty((grid.size, plant.n_states))
    states[:1] = start
    for j in range(grid.size - 1):
        states[j + 1] = integrator.step(states[j], controls[j], noise[j], grid[j], grid[j + 1], later[j])
    return states


@checked
def plant_along(plant: NonlinearPlant, x0: npt.ArrayLike, duration: float, u: npt.ArrayLike = ()) -> TimeVaryingPlant:
    """Return the small deviations from a nonlinear plant's trajectory from `x0`, with constant u and w = 0.

        d' = f_x(t, x(t)) d + f_w w,    y = h_x(t, x(t)) d + v,    d the deviation from x(t)

    Parameters
    ----------
    plant : NonlinearPlant
    x0 : (n,) array
    duration : float [time]
    u : (m,) array, optional
        Default 0.

    Returns
    -------
    TimeVaryingPlant
        With the plant's names, units and scales.

    Raises
    ------
    ArgumentError
        If a size differs, or noise that enters the outputs is not added to them: bounds on v would be others.
    SolverError
        If the trajectory cannot be followed.
    """
    x0 = checks.vector("x0", x0, plant.n_states)
    given = checks.floats("u", u)
    control = checks.vector("u", given if given.size else np.zeros(plant.n_inputs), plant.n_inputs)
    end, scale = checks.positive("duration", duration), plant.states.scales
    still = np.zeros(plant.n_disturbances)
    if not plant.adds_noise and plant.shows_noise:
        raise ArgumentError("`plant` must add its noise to its outputs: write h = h(x, u) + v, v in units of y.")

    def rate(t: float, z: Array) -> Array:
        return np.array(plant.rate_casadi(z * scale, control, still, t)).ravel() / scale

    _, path = integrated(rate, 0.0, end, x0 / scale, CLOSER * ALONG, dense=True)

    def at(which: int) -> MatrixOfTime:
        return lambda t: np.array(plant.slopes_casadi(path(t) * scale, control, 0, 0, t)[which])

    return TimeVaryingPlant(
        at(0), at(3), at(2) if plant.n_disturbances else None, horizon=end, time_unit=plant.time_unit,
        states=plant.states, outputs=plant.outputs, name=plant.name,
    )  # fmt: skip


def _stretch(plant: NonlinearPlant, unit: Array | float = 1.0) -> tuple[Any, ...]:
    """Symbols of a stretch: scaled state, w by its unit, parameters, time from 0 to 1, length; and the scaled rate."""
    ca, scale, m = casadi(), plant.signals["states"].scales, plant.n_inputs
    z, s, w = ca.SX.sym("z", plant.n_states), ca.SX.sym("s"), ca.SX.sym("w", plant.n_disturbances)
    u, rise, start, h = ca.SX.sym("u", m), ca.SX.sym("rise", m), ca.SX.sym("start"), ca.SX.sym("h")
    rate = plant.rate_casadi(z * scale, u + s * rise, w * unit, start + s * h) / scale
    return z, w, ca.vertcat(u, rise, w, start, h), s, h, rate


class Integrator:
    """Carries a state over a stretch of constant disturbance, u straight between two values; built once, used often."""

    def __init__(self, plant: NonlinearPlant, tolerance: float = TOLERANCE, points: int = 1) -> None:
        self.plant, self.scale = plant, plant.signals["states"].scales
        z, _, parameters, s, h, rate = _stretch(plant)
        problem = {"x": z, "t": s, "p": parameters, "ode": h * rate}
        options = {"reltol": tolerance, "abstol": tolerance} | CVODES
        self._step = casadi().integrator("step", "cvodes", problem, 0.0, np.arange(1, points + 1) / points, options)

    def step(self, x: Array, u: Array, w: Array, start: float, stop: float, u_stop: Array | None = None) -> Array:
        """Return x(stop) from x(start) = x; u is constant, or runs straight to `u_stop`.

        Raises SolverError if the integration fails.
        """
        return np.asarray(self.path(x, u, w, start, stop, u_stop)[-1])

    def path(self, x: Array, u: Array, w: Array, start: float, stop: float, u_stop: Array | None = None) -> Array:
        """Return the states (points, n) at the ends of so many equal parts of a stretch, as `step` does the last."""
        rise = 0 * u if u_stop is None else u_stop - u
        parameters = np.concatenate([u, rise, w, [start, stop - start]])
        try:
            found = np.array(self._step(x0=x / self.scale, p=parameters)["xf"]).T
        except RuntimeError as error:
            raise SolverError(
                f"the integration fails between t = {start:.6g} and {stop:.6g} {self.plant.time_unit} "
                f"({_reason(error)}).", status="integration failed",
            ) from None  # fmt: skip
        return np.asarray(found * self.scale)

    def steps(self, x: Array, u: Array, later: Array, w: Array, edges: Array) -> Array:
        """Return where K stretches end that begin with the rows of x (K, n); NaN where the integration fails."""
        return np.array([self._or_nan(*row) for row in zip(x, u, w, edges[:-1], edges[1:], later, strict=True)])

    def _or_nan(self, x: Array, u: Array, w: Array, start: float, stop: float, later: Array) -> Array:
        try:
            return self.step(x, u, w, start, stop, later)
        except SolverError:
            return np.full(x.shape, np.nan)


class CovarianceIntegrator:
    """Carries a state and the covariance of its error over a stretch, open loop.

        Y' = A Y + Y A' + eta Y + G W G',    A = df/dx, G = df/dw along x

    Everything is scaled: states by s_x, disturbances by s_w.
    """

    def __init__(
        self, plant: NonlinearPlant, noise: Array, eta: float, tolerance: float = COVARIANCE_TOLERANCE
    ) -> None:
        ca = casadi()
        self.scale, self.unit, n = plant.signals["states"].scales, plant.signals["disturbances"].scales, plant.n_states
        self.n = n
        z, w, parameters, s, h, rate = _stretch(plant, self.unit)
        Y, size = ca.SX.sym("Y", n, n), ca.SX.sym("size")
        A, G = ca.jacobian(rate, z), ca.jacobian(rate, w)
        half = ca.mtimes(A, Y)
        growth = half + half.T + eta * Y + ca.mtimes([G, ca.DM(noise), G.T]) / size
        rates, state = ca.vertcat(rate, ca.vec(growth)), ca.vertcat(z, ca.vec(Y))
        problem = {"x": state, "t": s, "p": ca.vertcat(parameters, size), "ode": h * rates}
        options = {"reltol": tolerance, "abstol": tolerance**1.5} | CVODES
        self._step = ca.integrator("covariance", "cvodes", problem, 0.0, 1.0, options)

    def step(
        self, x: Array, Y: Array, u: Array, later: Array, start: float, stop: float, w: Array | None = None
    ) -> Array:
        """Return Y at `stop`, physical, from Y at `start`; infinite on the diagonal where the integration fails."""
        n = self.n
        scaled = Y / self.scale / self.scale[:, None]
        size = float(np.abs(scaled).max())
        if not (np.isfinite(size) and size > 0):
            return unknown(n)
        disturbance = np.zeros(self.unit.size) if w is None else w / self.unit
        parameters = np.concatenate([u, later - u, disturbance, [start, stop - start, size]])
        begin = np.concatenate([x / self.scale, (scaled / size).ravel()])
        try:
            found = np.array(self._step(x0=begin, p=parameters)["xf"]).ravel()[n:].reshape(n, n)
        except RuntimeError:
            return unknown(n)
        found = size * (found + found.T) / 2 * self.scale * self.scale[:, None]
        return np.asarray(found) if np.isfinite(found).all() else unknown(n)


def unknown(n: int) -> Array:
    """The covariance of what nothing is known of."""
    return np.diag(np.full(n, np.inf))


def _reason(error: RuntimeError) -> str:
    """The integrator's own word for what went wrong."""
    word = re.search(r'returned "(\w+)"', str(error))
    return f"the integrator says {word[1]}" if word else "the integrator gives no reason"


def require_inside(plant: NonlinearPlant, name: str, x: Array) -> None:
    """Refuse a state outside the plant's box. Raises ArgumentError if an entry lies outside; the message names it."""
    lower, upper = plant.bounds["states"]
    outside = np.flatnonzero((x < lower) | (x > upper))
    if outside.size:
        i = int(outside[0])
        raise ArgumentError(
            f"`{name}` must lie in the plant's box of states, got {plant.signals['states'].names[i]} = {x[i]:.6g} "
            f"outside [{above(lower[i])}, {below(upper[i])}]."
        )


def _per_time(name: str, value: npt.ArrayLike | None, rows: int, columns: int) -> Array:
    """Rows of an input, one per grid time; a single row holds throughout."""
    if value is None:
        return np.zeros((rows, columns))
    array = np.asarray(value, dtype=float)
    if array.ndim == 1:
        array = np.broadcast_to(checks.vector(name, array, columns), (rows, columns))
    return checks.matrix(name, array, rows, columns)
