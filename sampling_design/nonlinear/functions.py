"""The functions of a plant as casadi knows them, and how they come back from a file that was pickled."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from casadi import SX, Function


class PlantFunctions(NamedTuple):
    """f, h and g as casadi Functions, and whether time is an argument of f or h."""

    rate: Function
    shown: Function
    limits: Function
    varies: bool


@dataclass(frozen=True)
class TimedFunction:
    """A casadi Function of (x, u, z, t), called like the function that a user wrote."""

    function: Function

    def __call__(self, x: SX, u: SX, z: SX, t: SX) -> SX:
        found: SX = self.function(x, u, z, t)
        return found


@dataclass(frozen=True)
class PlainFunction:
    """A casadi Function of (x, u, z, t) whose time does not matter, called without it."""

    function: Function

    def __call__(self, x: SX, u: SX, z: SX) -> SX:
        found: SX = self.function(x, u, z, 0)
        return found


def takes_time(function: object) -> bool:
    """Whether a function of a user has a fourth argument without a default: the time."""
    try:
        parameters = inspect.signature(function).parameters.values()  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    places = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return sum(p.kind in places and p.default is inspect.Parameter.empty for p in parameters) == 4
