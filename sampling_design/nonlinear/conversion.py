"""Nonlinear plants from CasADi expressions and from linear plants."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sampling_design.errors import ArgumentError
from sampling_design.nonlinear._casadi import casadi
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.signatures import checked

if TYPE_CHECKING:
    from casadi import SX


@checked
def from_expressions(
    x: object,
    f: object,
    h: object,
    *,
    u: object = None,
    w: object = None,
    v: object = None,
    **details: Any,
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
    given = {"x": x, "f": f, "h": h, "u": u, "w": w, "v": v}
    e = {key: _expression(key, none if value is None and key in "uwv" else value) for key, value in given.items()}
    try:
        dynamics = ca.Function("dynamics", [e["x"], e["u"], e["w"]], [e["f"]])
        measurement = ca.Function("measurement", [e["x"], e["u"], e["v"]], [e["h"]])
    except RuntimeError as error:
        raise ArgumentError(
            f"`f` and `h` must be expressions in x, u, w and x, u, v only ({str(error).splitlines()[-1]})."
        ) from None
    sizes = {
        "states": e["x"].numel(),
        "inputs": e["u"].numel(),
        "disturbances": e["w"].numel(),
        "outputs": e["h"].numel(),
        "noises": e["v"].numel(),
    }
    return NonlinearPlant(lambda *a: dynamics(*a), lambda *a: measurement(*a), sizes, **details)


def _expression(key: str, value: object) -> SX:
    ca = casadi()
    if not isinstance(value, (ca.SX, ca.MX)):
        raise ArgumentError(f"`{key}` must be an expression of casadi, got {checks.described(value)}.")
    found: SX = value
    return found


@checked
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
    return NonlinearPlant.of_linear(plant, noises)
