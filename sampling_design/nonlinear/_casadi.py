"""The only door to CasADi, with one sentence where it is missing."""

from __future__ import annotations

from typing import Any

from sampling_design.errors import MissingExtraError


def casadi() -> Any:
    """Return the module casadi.

    Raises
    ------
    MissingExtraError
        If it is not installed; the message names the extra.
    """
    try:
        import casadi as module
    except ImportError:
        raise MissingExtraError("casadi", "nonlinear") from None
    return module
