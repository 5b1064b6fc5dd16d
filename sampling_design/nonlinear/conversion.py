"""Nonlinear plants from CasADi expressions and from linear plants."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._door import door
from sampling_design.errors import ArgumentError
from sampling_design.nonlinear._casadi import casadi
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.plants.plant import Plant, Signals

Array = npt.NDArray[np.float64]


@door
def from_expressions(
    x: Any, f: Any, h: Any, *, u: Any = None, w: Any = None, v: Any = None, **details: Any
) -> NonlinearPlant:
    """Return the plant of CasADi expressions f(x, u, w) and h(x, u, v).

    Parameters
    ----------
    x, u, w, v : casadi SX symbols
        Columns; those that the plant does not have are left out.
    f, h : casadi SX expressions
        Of n and p entries.
    **details
        As for `NonlinearPlant`: time_unit, name, source, signals, bounds.

    Returns
    -------
    NonlinearPlant

    Raises
    ------
    ArgumentError
        If the expressions hold other symbols.

    Examples
    --------
    >>> import casadi
    >>> x, w = casadi.SX.sym("x", 2), casadi.SX.sym("w")
    >>> plant = from_expressions(x, casadi.vertcat(x[1], -casadi.sin(x[0]) + w), x[0], w=w)
    >>> plant.linearise([0.0, 0.0]).A.tolist()
    [[0.0, 1.0], [-1.0, 0.0]]
    """
    ca = casadi()
    none = ca.SX.sym("none", 0)
    u, w, v = (none if s is None else s for s in (u, w, v))
    for key, value in {"x": x, "f": f, "h": h, "u": u, "w": w, "v": v}.items():
        if not isinstance(value, (ca.SX, ca.MX)):
            raise ArgumentError(f"`{key}` must be an expression of casadi, got {_checks.described(value)}.")
    try:
        dynamics = ca.Function("dynamics", [x, u, w], [f])
        measurement = ca.Function("measurement", [x, u, v], [h])
    except RuntimeError as error:
        raise ArgumentError(
            f"`f` and `h` must be expressions in x, u, w and x, u, v only ({str(error).splitlines()[-1]})."
        ) from None
    sizes = {
        "states": x.numel(),
        "inputs": u.numel(),
        "disturbances": w.numel(),
        "outputs": h.numel(),
        "noises": v.numel(),
    }
    return NonlinearPlant(lambda *a: dynamics(*a), lambda *a: measurement(*a), sizes, **details)


@door
def from_linear(plant: Plant, *, noises: bool = True) -> NonlinearPlant:
    """Return a linear plant as a nonlinear one.

        f = A x + B u + G w,    h = C x + D u + v

    Parameters
    ----------
    plant : Plant
    noises : bool
        False leaves v out.

    Returns
    -------
    NonlinearPlant

    Examples
    --------
    >>> plant = from_linear(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]))
    >>> plant.f([1.0, 2.0]).tolist()
    [2.0, -1.0]
    """

    def dynamics(x: Any, u: Any, w: Any) -> Any:
        return _times(plant.A, x) + _times(plant.B, u) + _times(plant.G, w)

    def measurement(x: Any, u: Any, v: Any) -> Any:
        return _times(plant.C, x) + _times(plant.D, u) + (v if noises else 0.0)

    sizes = {"states": plant.n_states, "inputs": plant.n_inputs, "disturbances": plant.n_disturbances}
    sizes |= {"outputs": plant.n_outputs, "noises": plant.n_outputs if noises else 0}
    signals = {key: getattr(plant, key) for key in ("states", "inputs", "disturbances", "outputs")}
    if noises:
        signals["noises"] = Signals(
            _checks.names("v", None, plant.n_outputs, "v"), plant.outputs.units, plant.outputs.scales
        )
    return NonlinearPlant(
        dynamics, measurement, sizes, time_unit=plant.time_unit, name=plant.name, source=plant.source, signals=signals
    )


def _times(matrix: Array, symbol: Any) -> Any:
    """Return a numerical matrix times a casadi column, zeros left out."""
    ca = casadi()
    return ca.mtimes(ca.sparsify(ca.DM(matrix)), symbol) if matrix.shape[1] else ca.SX.zeros(matrix.shape[0])
