"""Families of schedules as plain data, one kind per family."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sampling_design import _checks
from sampling_design.errors import ArgumentError
from sampling_design.schedules.family import SamplingFamily
from sampling_design.schedules.files import schedule_from_dict
from sampling_design.schedules.gap_range import GapRange
from sampling_design.schedules.jitter import Jitter
from sampling_design.schedules.lost_samples import LostSamples
from sampling_design.schedules.spaced_windows import SpacedWindows

_KINDS: dict[str, tuple[type[Any], tuple[str, ...], tuple[str, ...]]] = {
    "spaced-windows": (SpacedWindows, ("window", "count", "spacing"), ("time_unit",)),
    "gap-range": (GapRange, ("shortest", "longest"), ("time_unit",)),
    "jitter": (Jitter, ("schedule", "radius"), ()),
    "lost-samples": (LostSamples, ("schedule", "most", "of"), ()),
}


def family_to_dict(family: SamplingFamily) -> dict[str, Any]:
    """Return a family as plain data; `kind` names it.

    Parameters
    ----------
    family : SamplingFamily

    Returns
    -------
    dict
        Lists, numbers and strings only; `family_from_dict` reads it back.
    """
    return family.to_dict()


def family_from_dict(data: Mapping[str, Any]) -> SamplingFamily:
    """Return the family in plain data.

    Parameters
    ----------
    data : mapping
        `kind` ("spaced-windows", "gap-range", "jitter", "lost-samples") and the arguments of that family.

    Returns
    -------
    SamplingFamily

    Raises
    ------
    ArgumentError
        If `kind` or a key is unknown, a key is missing, or the family refuses a value.

    Examples
    --------
    >>> family_from_dict({"kind": "gap-range", "shortest": 0.5, "longest": 1.5})
    GapRange(shortest_gap=0.5, longest_gap=1.5)
    """
    kind = data.get("kind")
    if kind not in _KINDS:
        raise ArgumentError(f"`kind` of a family must be one of {', '.join(_KINDS)}, got {kind!r}.")
    build, needed, optional = _KINDS[kind]
    _checks.known_keys(f"a family of kind {kind!r}", data, ("kind", *needed, *optional))
    missing = [key for key in needed if key not in data]
    if missing:
        raise ArgumentError(f"a family of kind {kind!r} needs `{missing[0]}`.")
    values = {key: data[key] for key in (*needed, *optional) if key in data}
    if "schedule" in values:
        values["schedule"] = schedule_from_dict(values["schedule"])
    return build(**values)
