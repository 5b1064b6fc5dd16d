"""Requirement files: TOML, or JSON with the same tree."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from sampling_design import _checks
from sampling_design._door import door
from sampling_design._files import from_json, from_toml, read_text, to_json, write_text
from sampling_design.design.problem.requirement import FORMAT, Requirement
from sampling_design.errors import ArgumentError, FileFormatError

_KEYS = tuple(Requirement.__dataclass_fields__)


@door
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
    """
    where = os.fspath(path)
    text = read_text(where)
    if Path(where).suffix.lower() == ".json":
        return requirement_from_dict(from_json(text, where), where)
    return requirement_from_dict(from_toml(text, where), where)


@door
def requirement_from_dict(data: dict[str, Any], where: str = "requirement") -> Requirement:
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
    tree = dict(data)
    found = tree.pop("format", None)
    if found != FORMAT:
        raise FileFormatError(f"{where}: `format` must be {FORMAT!r}, got {found!r}.", where)
    try:
        _checks.known_keys("the requirement", tree, _KEYS)
        samples = tree.get("samples")
        if isinstance(samples, dict) and "target_sigma" in samples:  # both places are in use
            if "target_sigma" in tree:
                raise ArgumentError("`target_sigma` is given twice, beside `samples` and inside it.")
            tree["samples"] = {k: v for k, v in samples.items() if k != "target_sigma"}
            tree["target_sigma"] = samples["target_sigma"]
        return Requirement(**tree)
    except ArgumentError as error:
        raise FileFormatError(f"{where}: cannot be used: {error}", where) from None


@door
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
    ending = Path(path).suffix.lower()
    if ending == ".json":
        return write_text(path, to_json(requirement.to_dict()))
    if ending != ".toml":
        raise FileFormatError(f"{path}: a requirement file ends in .toml or .json, got {ending!r}.", os.fspath(path))
    import tomli_w

    return write_text(path, tomli_w.dumps(requirement.to_dict()))
