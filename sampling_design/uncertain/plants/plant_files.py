"""Uncertain plants as files: TOML, or JSON with the same tree."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.parts import PLANT_TREE
from sampling_design.checkers.strict import (
    Reader,
    Tree,
    flag,
    is_list,
    is_number,
    is_text,
    list_of,
    matrix,
    number,
    printed,
    refuse,
    table,
    text,
    word,
)
from sampling_design.errors import ArgumentError
from sampling_design.plants.files import plant_from_dict
from sampling_design.plants.plant import FORMAT as PLANT_FORMAT
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import Plain, PlainRecord, short

_MOVED = ("A", "C", "G")


@frozen
class UncertainParameter(PlainRecord):
    """A number p that is only known to lie in a range, and how it enters a plant.

        A(p) = A + (p - nominal) A_p,    low <= p <= high;    likewise C and G

    Parameters
    ----------
    name : str
    low, high : float
        low <= high.
    A : (n, n) array, C : (p, n) array, G : (n, q) array, optional
        A_p and its like: what a change of the parameter by 1 adds to the matrices of the plant; None: nothing.
    nominal : float, optional
        The value that the plant's own matrices stand for; default the middle of the range.

    Raises
    ------
    ArgumentError
        If the range is empty, the nominal value lies outside, or the parameter moves nothing.

    Examples
    --------
    >>> UncertainParameter("sensor gain", 0.98, 1.02, C=[[1.0, 0.0]]).nominal
    1.0
    """

    name: str
    low: float
    high: float
    A: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    C: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    G: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    nominal: Converted[float | None, float] = field(default=None, kw_only=True)  # type: ignore[arg-type]

    _plain = "name low nominal high A? C? G?"

    def __post_init__(self) -> None:
        if not is_text(self.name) or not self.name:
            raise ArgumentError(f"`name` of a parameter must be a text, got {checks.described(self.name)}.")
        low, high = checks.number("low", self.low), checks.number("high", self.high)
        if low > high:
            raise ArgumentError(f"`high` of {self.name} must be at least `low` = {low!r}, got {high!r}. Swapped?")
        middle = low / 2 + high / 2 if self.nominal is None else checks.number("nominal", self.nominal)
        if not low <= middle <= high:
            raise ArgumentError(f"`nominal` of {self.name} must lie in [{low!r}, {high!r}], got {middle!r}.")
        given = {key: value for key in _MOVED if (value := getattr(self, key)) is not None}
        moved = {key: checks.matrix(key, value) for key, value in given.items()}
        if not any(M.any() for M in moved.values()):
            raise ArgumentError(f"parameter {self.name!r} must move an entry of A, C or G.")
        self._hold(low=low, high=high, nominal=middle, **moved)

    def _rows(self) -> list[tuple[str, str]]:
        moved = ", ".join(key for key in _MOVED if getattr(self, key) is not None)
        return [
            ("name", self.name),
            ("range", short([self.low, self.high])),
            ("nominal", short(self.nominal)),
            ("moves", moved),
        ]

    def explain(self) -> str:
        """Say what is known of the number."""
        return f"{self.name} lies between {short(self.low)} and {short(self.high)}."


Ends: TypeAlias = tuple[float, float]
UncertainParts: TypeAlias = tuple[Plant, Sequence[UncertainParameter], Sequence[Plant], bool]
"""What a file says: the nominal plant, how others differ from it (parameters, or vertices), whether they vary."""
FORMAT = "sampling-design/uncertain-plant/1"
_DECIMAL = r"[+-]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d++)?"  # possessive: long texts are read once
_AROUND = re.compile(rf"({_DECIMAL})\s*\+-\s*({_DECIMAL})", re.ASCII)


def ends(value: object, place: str) -> Ends:
    """A number that is known, or a range: [low, high], or a text "middle +- half"."""
    if is_text(value):
        found = _AROUND.fullmatch(value.strip())
        if found is None:
            raise refuse(place, f'must be a number, a range [low, high] or "middle +- half", got {printed(value)}')
        middle, half = (number(float(part), place) for part in found.groups())
        low, high = middle - half, middle + half
    elif is_list(value):
        if len(value) != 2:
            raise refuse(place, f"must be a range of two numbers, [low, high], got {len(value)}")
        low, high = (number(item, f"{place}[{k}]") for k, item in enumerate(value))
    else:
        low = high = number(value, place)
    if not low <= high:
        raise refuse(place, f"must be a range with low <= high, got {low!r} and {high!r}")
    return low, high


def entries(value: object, place: str) -> list[list[Ends]]:
    """A matrix of numbers or ranges, all rows of one length."""
    rows: list[list[Ends]] = list_of(list_of(ends))(value, place)
    if len({len(row) for row in rows}) > 1:
        raise refuse(place, "must have rows of one length")
    return rows


def _range(value: object, place: str) -> Ends:
    low, high = ends(value, place)
    if is_number(value):
        raise refuse(place, 'must be a range, [low, high] or "middle +- half"')
    return low, high


_parts: dict[str, Reader] = dict.fromkeys(("A", "C", "G"), matrix())
_PARAMETER = table({"name": text, "range": _range}, {"nominal": number, **_parts})
_VERTEX = table({"A": matrix(), "C": matrix()}, {"G": matrix()})
_KEYS: dict[str, Reader] = {
    **PLANT_TREE,
    "format": word(FORMAT),
    "matrices": table({"A": entries, "C": entries}, {"B": matrix(), "D": matrix(), "G": entries}),
}
_TREE = table(
    {key: _KEYS[key] for key in ("format", "matrices")},
    {key: item for key, item in _KEYS.items() if key not in ("format", "matrices")}
    | {"varying": flag, "parameters": list_of(_PARAMETER), "vertices": list_of(_VERTEX)},
)


def parts_of_tree(data: Mapping[str, object], where: str) -> UncertainParts:
    """What a tree of the file format says: the plant at the middles, and its parameters."""
    found = _TREE(data, "")
    matrices = found["matrices"]
    middles, parameters = dict(matrices), []
    for key in ("A", "C", "G"):
        if key not in matrices:
            continue
        rows: list[list[Ends]] = matrices[key]
        low, high = (np.array([[ends[k] for ends in row] for row in rows], dtype=np.float64) for k in (0, 1))
        middle, own = entry_parameters(key, low, high)
        middles[key] = middle.tolist()
        parameters += own
    for key in ("B", "D"):
        if key in matrices:
            middles[key] = np.asarray(matrices[key]).tolist()
    kept = {key: item for key, item in data.items() if key not in ("varying", "parameters", "vertices")}
    nominal = plant_from_dict({**kept, "format": PLANT_FORMAT, "matrices": middles}, where)
    listed = found.get("parameters", [])
    for each in listed:
        moved = [each.get(key) for key in ("A", "C", "G")]
        parameters.append(UncertainParameter(each["name"], *each["range"], *moved, nominal=each.get("nominal")))
    corners = found.get("vertices", [])
    vertices = [Plant(v["A"], v["C"], G=v.get("G"), time_unit=nominal.time_unit) for v in corners]
    return nominal, parameters, vertices, bool(found.get("varying", False))


def entry_parameters(key: str, low: Array, high: Array) -> tuple[Array, list[UncertainParameter]]:
    """The matrix at the middle of a lower and an upper one, and a parameter for each entry where they differ."""
    middle = np.where(low == high, low, low / 2 + high / 2)
    found = []
    for i, j in np.argwhere(low < high).tolist():
        one = np.zeros(low.shape)
        one[i, j] = 1.0
        ends = float(low[i, j]), float(high[i, j])
        moved = [one if key == each else None for each in ("A", "C", "G")]
        found.append(UncertainParameter(f"{key}[{i}, {j}]", *ends, *moved, nominal=float(middle[i, j])))
    return middle, found


def tree_of(parts: UncertainParts) -> dict[str, Plain]:
    """Plain data of the file format: exactly the numbers of the record."""
    nominal, parameters, vertices, varying = parts
    tree = dict(nominal.to_dict()) | {"format": FORMAT, "varying": bool(varying)}
    if vertices:
        return tree | {"vertices": [{key: getattr(v, key).tolist() for key in ("A", "C", "G")} for v in vertices]}
    listed: list[Plain] = []
    for each in parameters:
        data = each.to_dict()
        others = {key: data[key] for key in data if key not in ("name", "low", "high")}
        listed.append({"name": each.name, "range": [each.low, each.high], **others})
    return tree | {"parameters": listed}


def parts_of_model(plant: Plant, model: Tree) -> UncertainParts:
    """What a certificate file says: its plant and its model, as they were judged by the grammar."""
    varying = bool(model["varying"])
    if model["kind"] == "vertices":
        stacks = [np.array(model[key], dtype=np.float64) for key in ("A", "C", "G")]
        vertices = [Plant(A, C, G=G, time_unit=plant.time_unit) for A, C, G in zip(*stacks, strict=True)]
        return plant, (), vertices, varying
    return plant, [UncertainParameter(**each) for each in model["parameters"]], (), varying
