"""The only door to CasADi, with one sentence where it is missing."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from sampling_design.errors import MissingExtraError


def casadi() -> ModuleType:
    """Return the module casadi. Raises MissingExtraError if it is not installed; the message names the extra."""
    try:
        return import_module("casadi")
    except ImportError:
        raise MissingExtraError("casadi", "nonlinear") from None
