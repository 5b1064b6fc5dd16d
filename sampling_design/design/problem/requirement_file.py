"""Requirement files: TOML, or JSON with the same tree."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from sampling_design.checkers.parts import time_unit
from sampling_design.checkers.strict import (
    by_name,
    count,
    is_table,
    list_of,
    matrix,
    nonnegative,
    positive,
    table,
    text,
    word,
)
from sampling_design.design.problem.requirement import COUNTS, FORMAT, Requirement
from sampling_design.errors import ArgumentError
from sampling_design.records.file_io import by_first, by_kind, of_format, read_tree, usable, write_tree
from sampling_design.records.signatures import checked
from sampling_design.schedules.sensor import CALENDAR, DURATION, SENSOR, from_files

_SPANS = list_of(list_of(nonnegative, 2))
_COUNTS = table({}, {**dict.fromkeys(COUNTS, count), "target_sigma": positive})


_OF = by_kind({str: text}, by_first({str: list_of(text)}, matrix()))
"""A name, names, or rows of numbers."""

_EARLY_LATE = by_kind({list: list_of(nonnegative, 2), tuple: list_of(nonnegative, 2)}, nonnegative)
TIMING = by_kind({Mapping: by_name(_EARLY_LATE)}, _EARLY_LATE)
"""One number, early and late, or either by output."""

_TREE = table(
    {"format": word(FORMAT)},
    {
        **dict.fromkeys(("window", "period", "spacing"), DURATION),
        **dict.fromkeys(("target_sigma", "cost_limit"), positive),
        "samples": by_kind({Mapping: _COUNTS}, count),
        "decay_rate": nonnegative,
        "timing_tolerance": TIMING,
        "forbidden": _SPANS,
        "fixed": list_of(nonnegative),
        "sensors": by_name(SENSOR),
        "calendar": CALENDAR,
        "of": _OF,
        "time_unit": time_unit,
    },
    whole="the requirement",
)


@checked
def read_requirement(path: str | os.PathLike[str]) -> Requirement:
    """Read a requirement from a `.toml` or `.json` file.

    Parameters
    ----------
    path : path
        The format is told by the ending.

    Returns
    -------
    Requirement

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, of another format, has an unknown key, or holds a value that
        `Requirement` refuses; the message names the file.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> wanted = 'format = "sampling-design/requirement/1"\\nwindow = 4.0\\nsamples = 3'
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "wanted.toml"
    ...     characters = path.write_text(wanted)
    ...     found = read_requirement(path)
    >>> found.window, found.samples
    (4.0, {'exactly': 3})
    """
    return requirement_from_dict(read_tree(path), os.fspath(path))


@checked
def requirement_from_dict(data: Mapping[str, object], where: str = "requirement") -> Requirement:
    """Return the requirement in a tree of plain data; the inverse of `Requirement.to_dict`.

    Parameters
    ----------
    data : dict
        The tree of a requirement file, its "format" included.
    where : str
        Named in messages, in general the path.

    Returns
    -------
    Requirement

    Raises
    ------
    FileFormatError
        As for `read_requirement`.
    """
    with usable(where):
        tree = of_format(_TREE, data, FORMAT)
        samples = tree.get("samples")
        if is_table(samples) and "target_sigma" in samples:  # both places are in use
            if "target_sigma" in tree:
                raise ArgumentError("`target_sigma` is given twice, beside `samples` and inside it.")
            tree["samples"] = {k: v for k, v in samples.items() if k != "target_sigma"}
            tree["target_sigma"] = samples["target_sigma"]
        tree["sensors"] = from_files(tree.get("sensors"), where)
        return Requirement(**tree)


@checked
def write_requirement(requirement: Requirement, path: str | os.PathLike[str]) -> Path:
    """Write a requirement as `.toml` or `.json`, whole or not at all.

    Parameters
    ----------
    requirement : Requirement
    path : path
        The format is told by the ending.

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    FileFormatError
        If the ending is neither, or the file cannot be written.
    """
    return write_tree(path, requirement.to_dict(), "a requirement")
