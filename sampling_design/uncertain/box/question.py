"""What records about a box of plants show and say."""

from __future__ import annotations

from collections.abc import Mapping

from sampling_design.records.record import short

REASONS = {
    "budget": "the budget ran out before the bracket closed; more time, or a smaller box, narrows it",
    "interrupted": "the search was interrupted before the bracket closed",
    "rounding": "rounding keeps the bracket open; scale the plant",
}


def at_parameters(values: Mapping[str, float]) -> str:
    """The parameters in words, such as "omega^2 = 1.21"."""
    return ", ".join(f"{name} = {short(value)}" for name, value in values.items()) or "the nominal plant"
