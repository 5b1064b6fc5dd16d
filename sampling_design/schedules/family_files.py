"""Families of schedules as plain data, one kind per family."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from sampling_design.checkers import family_file
from sampling_design.checkers.strict import anything, is_text
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.file_io import exactly
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import SamplingFamily
from sampling_design.schedules.files import schedule_from_dict
from sampling_design.schedules.gap_range import GapRange  # noqa: F401  # a family is known once its file is loaded
from sampling_design.schedules.jitter import Jitter  # noqa: F401
from sampling_design.schedules.lost_samples import LostSamples  # noqa: F401
from sampling_design.schedules.output_jitter import OutputJitter  # noqa: F401
from sampling_design.schedules.spaced_windows import SpacedWindows  # noqa: F401


@checked
def family_from_dict(data: Mapping[str, Any]) -> SamplingFamily:
    """Return the family in plain data.

    Parameters
    ----------
    data : mapping
        `kind` ("spaced-windows", "gap-range", "jitter", "output-jitter", "lost-samples") and the arguments of
        that family.

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
    if not is_text(kind) or kind not in SamplingFamily.KINDS:
        known = ", ".join(sorted(SamplingFamily.KINDS))
        raise ArgumentError(f"`kind` of a family must be one of {known}, got {kind!r}.")
    build = SamplingFamily.KINDS[kind]
    given = [field for field in fields(build) if field.init]  # type: ignore[arg-type]  # every kind is a dataclass
    needed = [field.name for field in given if field.default is MISSING]
    optional = [field.name for field in given if field.default is not MISSING]
    checks.known_keys(f"a family of kind {kind!r}", data, ("kind", *needed, *optional))
    missing = [key for key in needed if key not in data]
    if missing:
        raise ArgumentError(f"a family of kind {kind!r} needs `{missing[0]}`.")
    exactly(family_file.family if kind in family_file.FAMILIES else anything, data)
    values = {key: data[key] for key in (*needed, *optional) if key in data}
    if "schedule" in values:
        values["schedule"] = schedule_from_dict(values["schedule"])
    return build(**values)
