"""Plan requirement files: TOML, or JSON with the same tree; one file may hold the plant as well."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from sampling_design.checkers.parts import time_unit
from sampling_design.checkers.strict import (
    anything,
    by_name,
    count,
    is_table,
    list_of,
    matrix,
    nonnegative,
    number,
    positive,
    table,
    text,
    word,
)
from sampling_design.planning.requirement import AIMS, FORMAT, KINDS, TIMES, PlanRequirement
from sampling_design.plants.files import plant_from_dict
from sampling_design.plants.plant import Plant
from sampling_design.records.file_io import by_first, by_kind, of_format, read_tree, usable, write_tree
from sampling_design.records.signatures import checked
from sampling_design.schedules.sensor import CALENDAR, DURATION, SENSOR, from_files

_NUMBERS = list_of(nonnegative)
_time = by_kind({str: text}, nonnegative)
_early_late = by_kind({list: list_of(_time, 2), tuple: list_of(_time, 2)}, _time)
_TIMING = by_kind({Mapping: by_name(_early_late)}, _early_late)  # a duration, early and late, or either by output
_when = by_kind({str: word(*TIMES)}, _NUMBERS)  # a word, or times of the period


def _pair(value: object, place: str) -> object:
    return tuple(list_of(number, 2)(value, place))


_ENTRIES = by_name(by_kind({list: _pair, tuple: _pair}, nonnegative))
_bound = by_kind({Mapping: _ENTRIES, list: _NUMBERS, tuple: _NUMBERS}, nonnegative)
"""A bound on the norm, half-widths, or numbers about 0 and pairs by name."""

_error = by_first({list: matrix(), tuple: matrix()}, _bound)  # the same, or a weight

_GOAL = table({"tolerance": positive}, {"at": _when, "row": list_of(number), "kind": word(*KINDS)})

_goal = by_kind({Mapping: _GOAL}, positive)  # a tolerance, or a table of all that may be said of a goal
_TREE = table(
    {"format": word(FORMAT)},
    {
        **dict.fromkeys(("period", "grid", "spacing"), DURATION),
        "timing_tolerance": _TIMING,
        "samples": count,
        "cost_limit": positive,
        "visit_price": nonnegative,
        "aim": word(*AIMS),
        **dict.fromkeys(("w_bound", "w_intensity"), _bound),
        "initial_error": _error,
        "accuracy": by_name(_goal),
        "sensors": by_name(SENSOR),
        "calendar": CALENDAR,
        "time_unit": time_unit,
        "plant": anything,
    },
    whole="the requirement",
)


@checked
def read_plan_requirement(path: str | os.PathLike[str]) -> PlanRequirement:
    """Read the requirement of a plan from a `.toml` or `.json` file; a plant in it is left alone.

    Parameters
    ----------
    path : path
        The ending says which format.

    Returns
    -------
    PlanRequirement

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, of another format, has an unknown key, or holds a value that
        `PlanRequirement` refuses; the message names the file.
    """
    return requirement_and_plant(path)[0]


def requirement_and_plant(path: str | os.PathLike[str]) -> tuple[PlanRequirement, Plant | None]:
    """Return the requirement in a file, and the plant if it holds one."""
    where = os.fspath(path)
    data = read_tree(where)
    plant = data.get("plant")
    found = None
    if is_table(plant):
        found = plant_from_dict(dict(plant), f"{where}: plant")
    return plan_requirement_from_dict(data, where), found


def plan_requirement_from_dict(data: Mapping[str, object], where: str = "requirement") -> PlanRequirement:
    """Return the requirement in a tree of plain data; the inverse of `PlanRequirement.to_dict`.

    Raises FileFormatError as for `read_plan_requirement`.
    """
    with usable(where):
        tree = of_format(_TREE, data, FORMAT)
        tree.pop("plant", None)
        tree["sensors"] = from_files(tree.get("sensors"), where)
        return PlanRequirement(**tree)


@checked
def write_plan_requirement(requirement: PlanRequirement, path: str | os.PathLike[str]) -> Path:
    """Write the requirement of a plan as `.toml` or `.json`, whole or not at all; return the path.

    Raises FileFormatError if the ending is neither, or the file cannot be written.

    Parameters
    ----------
    path : path
        The ending says which format.

    Returns
    -------
    Path
        Where it was written.
    """
    return write_tree(path, requirement.to_dict(), "a requirement")
