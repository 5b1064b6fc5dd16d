"""The rows that a user wants to know: names of states and outputs, or a matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypedDict

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_text, likely
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze
from sampling_design.records.record import counted

Wanted: TypeAlias = str | Sequence[str] | npt.ArrayLike | None


class RowArguments(TypedDict, total=False):
    """Rows as verbs of many arguments take them."""

    of: Wanted


@dataclass(frozen=True, eq=False)
class RequestedRows:
    """z = matrix x with a name and a unit for each entry."""

    matrix: Array
    names: tuple[str, ...]
    units: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    def labels(self) -> tuple[str, ...]:
        """Names with their units in brackets."""
        return tuple(f"{n} [{u}]" if u else n for n, u in zip(self.names, self.units, strict=True))


def requested_rows(plant: Plant, of: Wanted = None, argument: str = "of") -> RequestedRows:
    """Return the rows named by `of`: None (all states), names of states or outputs, or an (r, n) matrix.

    Raises ArgumentError if a name is unknown (the nearest is offered) or is that of a state and of another output, if
    there is no row, or a matrix has another shape.

    Parameters
    ----------
    of : str, sequence of str, or (r, n) array, optional
        The row of an output is C (without D u and v).
    argument : str
        What the user called it.
    """
    if of is None:
        return RequestedRows(freeze(np.eye(plant.n_states)), plant.states.names, plant.states.units)
    asked = row_arguments(of, argument)
    if isinstance(asked, tuple):
        found = [_named(plant, name, argument) for name in asked]
        return RequestedRows(freeze([row for row, _ in found]), asked, tuple(unit for _, unit in found))
    matrix = checks.matrix(argument, of, None, plant.n_states)
    taken, letter = {*plant.states.names, *plant.outputs.names}, "z"
    while taken & {f"{letter}{i + 1}" for i in range(len(matrix))}:  # of a part, whose states are called so
        letter += "z"
    return RequestedRows(matrix, tuple(f"{letter}{i + 1}" for i in range(len(matrix))), ("",) * len(matrix))


def row_arguments(of: Wanted, argument: str = "of") -> tuple[str, ...] | Array | None:
    """Return what `of` asks for as names or as a matrix, before any plant is known; None as it is.

    Raises ArgumentError if it holds neither names alone nor rows of numbers, or nothing.
    """
    if of is None:
        return None
    names = checks.texts([of] if is_text(of) else of)
    if names:
        return names
    matrix = checks.matrix(argument, of)
    if not matrix.shape[0]:
        raise ArgumentError(f"`{argument}` must name at least one row, got none.")
    return matrix


def rows_in_words(asked: tuple[str, ...] | Array) -> str:
    """Say what `row_arguments` found: the names, or how many rows."""
    return ", ".join(asked) if isinstance(asked, tuple) else counted(len(asked), "row")


def _named(plant: Plant, name: str, argument: str) -> tuple[Array, str]:
    """Row and unit of a state, else of an output."""
    states, outputs = plant.states, plant.outputs
    state = np.eye(plant.n_states)[states.names.index(name)] if name in states.names else None
    output = plant.C[outputs.names.index(name)] if name in outputs.names else None
    if state is not None and output is not None and np.any(output[state == 0]):
        raise ArgumentError(
            f"`{argument}` names {name!r}, a state and an output that is not that state alone. "
            "Give the row as a matrix."
        )
    if state is not None:
        return state, states.units[states.names.index(name)]
    if output is not None:
        return output, outputs.units[outputs.names.index(name)]
    known = dict.fromkeys((*states.names, *outputs.names))
    raise ArgumentError(f"`{argument}` must name states or outputs, got {name!r}. {likely(name, known)}")
