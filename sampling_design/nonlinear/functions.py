"""The functions of a plant as casadi knows them: a linear one's, and how pickled ones come back."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, TypeAlias

from sampling_design.errors import MissingExtraError
from sampling_design.plants.plant import Plant, Signals
from sampling_design.records import checks
from sampling_design.records.arrays import Array

if TYPE_CHECKING:
    from casadi import SX


def casadi() -> ModuleType:
    """Return the module casadi. Raises MissingExtraError if it is not installed; the message names the extra."""
    try:
        return import_module("casadi")
    except ImportError:
        raise MissingExtraError("casadi", "nonlinear") from None


Equation: TypeAlias = "Callable[[SX, SX, SX], SX]"


def takes_time(function: object) -> bool:
    """Whether a function of a user, or casadi's own, has a fourth argument without a default: the time."""
    if (count := getattr(function, "n_in", None)) is not None:
        return bool(count() == 4)
    try:
        parameters = inspect.signature(function).parameters.values()  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    places = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return sum(p.kind in places and p.default is inspect.Parameter.empty for p in parameters) == 4


def linear_model(plant: Plant, noises: bool) -> tuple[Equation, Equation, dict[str, int], dict[str, Signals]]:
    """Return f = A x + B u + G w, h = C x + D u + v (without noises no v), sizes and signals of a linear plant."""

    def dynamics(x: SX, u: SX, w: SX) -> SX:
        return _times(plant.A, x) + _times(plant.B, u) + _times(plant.G, w)

    def measurement(x: SX, u: SX, v: SX) -> SX:
        return _times(plant.C, x) + _times(plant.D, u) + (v if noises else 0.0)

    sizes = {"states": plant.n_states, "inputs": plant.n_inputs, "disturbances": plant.n_disturbances}
    sizes |= {"outputs": plant.n_outputs, "noises": plant.n_outputs if noises else 0}
    signals = {key: getattr(plant, key) for key in ("states", "inputs", "disturbances", "outputs")}
    if noises:
        signals["noises"] = Signals(
            checks.names("v", None, plant.n_outputs, "v"), plant.outputs.units, plant.outputs.scales
        )
    return dynamics, measurement, sizes, signals


def _times(matrix: Array, symbol: SX) -> SX:
    """Return a numerical matrix times a casadi column, zeros left out."""
    ca = casadi()
    found: SX = ca.mtimes(ca.sparsify(ca.DM(matrix)), symbol) if matrix.shape[1] else ca.SX.zeros(matrix.shape[0])
    return found
