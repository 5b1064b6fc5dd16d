"""Time units: the six that files may name, and conversion between them."""

from __future__ import annotations

from sampling_design._checks import described
from sampling_design.errors import ArgumentError

SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "wk": 604800.0}


def check_time_unit(unit: object, name: str = "time_unit") -> str:
    """Return `unit` if it is one of the six known units, else raise.

    Raises
    ------
    ArgumentError
        If the unit is missing or unknown.
    """
    if unit is None or (isinstance(unit, str) and not unit):
        raise ArgumentError(f"`{name}` is missing. Give one of {', '.join(SECONDS)}.")
    if not isinstance(unit, str) or unit not in SECONDS:
        came = repr(unit) if isinstance(unit, str) else described(unit)
        raise ArgumentError(f"`{name}` must be one of {', '.join(SECONDS)}, got {came}.")
    return str(unit)


def time_factor(source: str, target: str) -> float:
    """Return c so that a time of value t in `source` has value c t in `target`."""
    return SECONDS[check_time_unit(source)] / SECONDS[check_time_unit(target)]
