"""Mutants of a file's structure: every key and value of a tree, every cell of a table, made into something else.

A mutant is a tree like the whole one; what no tree can say (a key that is there twice, NaN, 1e999) stands in it as a
text that `as_json` and `as_toml` write without its quotes.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from typing import Any

import tomli_w

AS_IT_STANDS, AGAIN = "@@", "@@@"
WRONG = (True, False, "1", "", None, [], {}, {"a": 1.0}, 10**400, 0, -1, 0.5, "@@1e999", "@@1e-999", "@@NaN", "@@nan")
CELLS = (
    "True",
    "nan",
    "-inf",
    "1_0",
    "'1'",
    '"1"',
    "",
    "1e999",
    "1e-999",
    "[1]",
    "\u0663",
    "0x1",
    "null",
    "2",
    "-1",
    "0.5",
)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every path into plain data."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inside:
        yield (*path, key)
        yield from places(item, (*path, key))


def holder(data: Any, path: tuple[Any, ...]) -> Any:
    """What holds the last step of a path."""
    for key in path[:-1]:
        data = data[key]
    return data


def kinds(data: Any, path: tuple[Any, ...]) -> list[str]:
    """What can be done at a place."""
    inside, old = holder(data, path), holder(data, path)[path[-1]]
    found = [f"value {k}" for k in range(len(WRONG))] + ["nested", "nested twice", "dropped"]
    found += ["renamed", "twice"] if isinstance(inside, dict) else ["longer", "next swapped"]
    if isinstance(old, (int, float)) and not isinstance(old, bool):
        found += ["negative", "double", "half", "nearly"]
    if isinstance(old, list) and len(old) > 1:
        found += ["reversed", "rotated", "first swapped"]
    return found


def mutant(whole: Any, path: tuple[Any, ...], kind: str) -> Any:
    """A copy of the whole with one thing done at one place."""
    data = copy.deepcopy(whole)
    inside, key = holder(data, path), path[-1]
    old = inside[key]
    if kind.startswith("value "):
        inside[key] = copy.deepcopy(WRONG[int(kind[6:])])
    elif kind == "dropped":
        del inside[key]
    elif kind == "renamed":
        inside[f"{key}_"] = inside.pop(key)
    elif kind == "twice":
        inside[f"{AGAIN}{key}"] = copy.deepcopy(old)
    elif kind == "longer":
        inside.insert(key, copy.deepcopy(old))
    elif kind == "next swapped":
        inside[key], inside[key - 1] = inside[key - 1], inside[key]
    else:
        inside[key] = {
            "nested": lambda: [old],
            "nested twice": lambda: [[old]],
            "negative": lambda: -old,
            "double": lambda: old * 2,
            "half": lambda: old / 2,
            "nearly": lambda: old * (1 + 1e-7),
            "reversed": lambda: old[::-1],
            "rotated": lambda: old[1:] + old[:1],
            "first swapped": lambda: [old[1], old[0], *old[2:]],
        }[kind]()
    return data


def as_json(data: Any) -> str:
    """JSON in which the texts that begin with @@ stand as they are."""
    return _unquoted(json.dumps(data))


def as_toml(data: Any) -> str | None:
    """TOML likewise; None where TOML has no word for it."""
    try:
        return _unquoted(tomli_w.dumps(data))
    except TypeError:
        return None


def _unquoted(text: str) -> str:
    return re.sub(f'"{AS_IT_STANDS}([^"]*)"', r"\1", text.replace(f'"{AGAIN}', '"'))


def of_table(text: str) -> Iterator[tuple[str, str]]:
    """Mutants of a schedule's CSV: its first line's keys, its header, its rows, its cells."""
    first, *lines = text.splitlines()
    parts = first.split("; ")

    def whole(head: list[str], rows: list[str]) -> str:
        return "\n".join(["; ".join(head), *rows]) + "\n"

    for k in range(1, len(parts)):
        key, _, value = parts[k].partition("=")
        yield f"{key} dropped", whole(parts[:k] + parts[k + 1 :], lines)
        yield f"{key} twice", whole([*parts, parts[k]], lines)
        yield f"{key} renamed", whole([*parts[:k], f"{key}_={value}", *parts[k + 1 :]], lines)
        for cell in CELLS:
            yield f"{key}={cell}", whole([*parts[:k], f"{key}={cell}", *parts[k + 1 :]], lines)
    for i, line in enumerate(lines):
        cells = line.split(",")
        yield f"row {i} dropped", whole(parts, lines[:i] + lines[i + 1 :])
        yield f"row {i} twice", whole(parts, lines[: i + 1] + lines[i:])
        yield (
            f"row {i} swapped",
            whole(parts, [*lines[: max(i - 1, 0)], *lines[max(i - 1, 0) : i + 1][::-1], *lines[i + 1 :]]),
        )
        yield f"row {i} longer", whole(parts, [*lines[:i], line + ",1", *lines[i + 1 :]])
        yield f"row {i} shorter", whole(parts, [*lines[:i], ",".join(cells[:-1]), *lines[i + 1 :]])
        yield f"row {i} reversed", whole(parts, [*lines[:i], ",".join(cells[::-1]), *lines[i + 1 :]])
        for j in range(len(cells)):
            for cell in CELLS:
                row = ",".join([*cells[:j], cell, *cells[j + 1 :]])
                yield f"cell {i},{j} {cell}", whole(parts, [*lines[:i], row, *lines[i + 1 :]])
    for j in range(len(lines[0].split(","))):
        table = [line.split(",") for line in lines]
        yield f"column {j} dropped", whole(parts, [",".join(row[:j] + row[j + 1 :]) for row in table])
        yield f"column {j} twice", whole(parts, [",".join([*row, row[j]]) for row in table])
