"""The rows that a user wants to know, and the part of a plant that they need.

Rows are names of states and outputs, or a matrix; what no output shows and no row holds is left out of the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, TypeAlias, TypedDict, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.linalg import qr

from sampling_design.checkers.parts import CARRIED, misnamed, not_carried
from sampling_design.checkers.strict import is_text, likely
from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import balance
from sampling_design.plants.modes import ModalSplit, split_modes
from sampling_design.plants.plant import Plant, Signals, replace_matrices
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, freeze
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import Plain, counted, short

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


PlantClass = TypeVar("PlantClass")

if TYPE_CHECKING:  # a checker would forget there what the fields of Plant are converted to

    def _frozen(kind: type[PlantClass]) -> type[PlantClass]: ...

else:
    _frozen = frozen

BESIDE = 1e-2
"""Share of the rows' least gain that the other states may take away in `beside`: sigma is then low by 5e-5 at most."""
STEPS = 16  # times per state at which a window is looked at to weigh the other states
DARK = 1e-8  # least gain of a direction's weight, beside the largest: what decays unobserved has none


@_frozen
class FunctionalPlant(Plant):
    """The quotient of a plant that carries chosen rows z = H x: an exactly known plant like any other.

        q = map x,    q' = A q + B u + G w,    y = C q + D u + v,    z = (q_1, ..., q_k)

        map A_whole = A map,    C_whole = C map,    map B_whole = B,    map G_whole = G,    H = map[:k]

    Every verb takes it, and what it says of q holds for `map x` of every trajectory x of the whole plant: what is left
    out is observed by no output and enters neither z nor q. The first k states are the rows asked for.

    Parameters
    ----------
    A, C, B, D, G, and what else `Plant` takes
    whole : Plant
        The plant that it is a part of.
    map : (n_q, n) array
    rows : int
        k, how many rows were asked for.

    Raises
    ------
    ArgumentError
        If the equations above do not hold, each entry to 1e-10 of the terms that make it up.

    Notes
    -----
    `observability.functional_plant` makes one; files keep `whole`, `map` and `rows` as `part_of`, and every reader
    and checker works the equations out again. *Theory*: section 16.
    """

    is_part = True
    whole: Plant = field(default=None, kw_only=True)  # type: ignore[assignment]
    map: Converted[npt.ArrayLike, Array] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    rows: int = field(default=0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        whole = checks.of_kind("whole", self.whole, Plant, "a Plant")
        onto = checks.matrix("map", self.map, self.n_states, whole.n_states)
        self._hold(map=onto)
        if checks.whole("rows", self.rows, 1) > self.n_states:
            raise ArgumentError(f"`rows` must be at most {self.n_states}, the number of states, got {self.rows}.")
        if whole.time_unit != self.time_unit:
            raise ArgumentError(f"`time_unit` must be that of the whole plant, {whole.time_unit!r}.")
        driven = np.hstack([self.B, self.G]), np.hstack([whole.B, whole.G])
        apart = not_carried(onto, (self.A, self.C, driven[0]), (whole.A, whole.C, driven[1]))
        if apart is not None:
            raise ArgumentError(f"`map` does not carry `{apart}` of the whole plant, each entry to {CARRIED:g}.")
        if (name := misnamed(onto, self.states.called, whole.C, whole.states.called, whole.outputs.called)) is not None:
            raise ArgumentError(f"`states` call {name!r} what is not that state or output of the whole plant.")

    @classmethod
    def of_part(cls, part: Plant, whole: Plant, onto: npt.ArrayLike, rows: int) -> FunctionalPlant:
        """Return the plant `part` as what `rows` rows of `whole` need, its state `onto` x.

        What is a part of a part is one of the whole.
        """
        match whole:
            case FunctionalPlant():
                onto, whole = checks.floats("onto", onto) @ whole.map, whole.whole
        own = {each.name: getattr(part, each.name) for each in fields(Plant)}
        own |= {"whole": whole, "map": onto, "rows": rows}
        return cls(**own)

    @property
    def wanted(self) -> RequestedRows:
        """The rows asked for, on the whole plant's state."""
        return RequestedRows(self.map[: self.rows], self.states.names[: self.rows], self.states.units[: self.rows])

    def beside(self, window: float, split: ModalSplit | None = None) -> FunctionalPlant:
        """Return the plant with scales in which the rows count and the other states hardly do, over a window.

        In them sigma is that of the rows, the least |O q| over |z| of all q, but for 5e-5 of itself and never above
        it: 1/sigma^2 is the largest value of S^-1 W^-1 S^-1, whose block of the other states is made small.

        Parameters
        ----------
        window : float [time_unit]
        split : ModalSplit, optional
            Of this plant: only what it retains is looked at. Default: all states.
        """
        count = self.n_states - self.rows
        if not count:
            return self
        basis, kept = (np.eye(self.n_states), self) if split is None else (split.basis_retained, split.retained)
        weights = balance(kept.A, kept.C).d
        times = np.linspace(0.0, checks.positive("window", window), STEPS * self.n_states)
        outputs = ((self.C / self.outputs.scales[:, None]) @ self.transition(times)).reshape(-1, self.n_states)
        _, gains, V = np.linalg.svd(outputs @ basis * weights, full_matrices=False)
        gains = np.maximum(gains, DARK * gains[0])
        deviations = np.linalg.norm(basis * weights @ (V / gains[:, None]).T, axis=1)
        scales = np.array(self.states.scales)
        least = np.max(deviations[: self.rows] / scales[: self.rows])
        size = np.maximum(deviations, DARK * scales * least)[self.rows :]
        scales[self.rows :] = size * np.sqrt(count) / (BESIDE * least)
        return replace(self, states=Signals(self.states.names, self.states.units, scales))

    def to_dict(self) -> dict[str, Plain]:
        """Return the tree of the plant file format, with what it is a part of."""
        part = {"plant": self.whole.to_dict(), "map": self.map.tolist(), "rows": self.rows}
        return {**super().to_dict(), "part_of": part}

    def explain(self) -> str:
        """Say what is kept."""
        left = self.whole.n_states - self.n_states
        names = ", ".join(self.states.names[: self.rows])
        out = f"{counted(left, 'direction')} of the state that no output shows and no row holds left out"
        return f"What {names} of {self.whole.name or 'a plant'} needs: {counted(self.n_states, 'state')}, {out}."


def is_about(theirs: Plant, plant: Plant) -> bool:
    """Whether what is said of `theirs` is said of a plant, or of chosen rows of it."""
    part = isinstance(theirs, FunctionalPlant) and not isinstance(plant, FunctionalPlant)
    return plant.same_dynamics(getattr(theirs, "whole", theirs) if part else theirs)


def split_needed(plant: Plant, decay_rate: float) -> ModalSplit:
    """Return the split of a plant; of one for chosen rows nothing is retained where only what decays enters them."""
    split = split_modes(plant, decay_rate)
    if not isinstance(plant, FunctionalPlant) or not split.retained.n_states:
        return split
    directions = np.linalg.qr(split.basis_retained / balance(plant.A, plant.C).d[:, None])[0]
    return split if np.max(np.abs(directions[: plant.rows])) > CARRIED else split_modes(split.residual, decay_rate)


def weighed_over(split: ModalSplit, window: float) -> ModalSplit:
    """Return the split of a plant as it is looked at over a window: one for chosen rows weighs the other states."""
    plant = split.plant
    if not isinstance(plant, FunctionalPlant) or not split.retained.n_states:
        return split
    return split_modes(plant.beside(window, split), split.decay_rate)


def rows_counted(plant: Plant) -> int:
    """Return how many of the first states count in sigma: those that were asked for, or all."""
    match plant:
        case FunctionalPlant():
            return plant.rows
    return plant.n_states


def wider_beside(plant: Plant, shares: Array | None) -> Plant | None:
    """Return the plant with other states that count as little as a window asks; None where they do, or all count.

    Of that window sigma of the rows times sqrt((O'O)^-1_ii) (n,) is given, O in scales.
    """
    count = plant.n_states - rows_counted(plant)
    if not count or shares is None or not np.isfinite(shares).all():
        return None
    scales, more = np.array(plant.states.scales), shares[-count:] * (np.sqrt(count) / BESIDE)
    if np.max(more) <= 1 + BESIDE:
        return None
    scales[-count:] *= np.maximum(more, 1.0)
    return replace(plant, states=Signals(plant.states.names, plant.states.units, scales))


def counted_rows(split: ModalSplit) -> Array | None:
    """Return what of the retained state counts in sigma, in its scales, (k, n_r); None where all of it does."""
    match split.plant:
        case FunctionalPlant() as plant:
            basis = split.basis_retained * split.retained.states.scales / plant.states.scales[:, None]
            return np.asarray(basis[: plant.rows])
    return None


def without(plant: Plant, hidden: Array, weights: Array, cut: float) -> tuple[Plant, Array, Index]:
    """Return the quotient of a plant by an invariant subspace that C does not show, the map onto it, and what it keeps.

    Parameters
    ----------
    hidden : (n, m) array
        Independent columns that span it.
    weights : (n,) array
        Typical sizes of the states, in which pivots are chosen.
    cut : float
        Entries of the map below this, in those sizes, are rounding.

    Notes
    -----
    *Method.* m states that together determine the hidden part are left out (pivots of a QR factorisation); each
    other state has subtracted what it holds of them, q_j = x_j - h_j h_J^-1 x_J. A state that holds none of the hidden
    part keeps its name, its unit and its column of C.
    """
    n, m = hidden.shape
    order = qr((hidden / weights[:, None]).T, pivoting=True, mode="r")[1]
    left, kept = np.sort(order[:m]), np.sort(order[m:])
    share = np.linalg.solve(hidden[left].T, hidden[kept].T).T
    share[np.abs(share) * weights[left] <= cut * weights[kept][:, None]] = 0.0
    onto = np.zeros((n - m, n))
    onto[np.arange(n - m), kept] = 1.0
    onto[:, left] = -share
    names = [_sum(plant.states.names, row) for row in onto]
    units = [plant.states.units[j] for j in kept]
    states = Signals(names, units, plant.states.scales[kept])
    return replace_matrices(plant, onto @ plant.A[:, kept], plant.C[:, kept], onto, states), onto, kept


def _sum(names: tuple[str, ...], row: Array) -> str:
    """The name of a sum of states: "x1", "x1 + 2 x3", or, of many, its first state and that it is the shown part."""
    places = np.flatnonzero(row)
    first = int(places[np.argmax(row[places] == 1)])
    others = [j for j in places.tolist() if j != first]
    if len(others) > 2:
        return f"{names[first]} (shown part)"
    sizes = ["" if abs(row[j]) == 1 else f"{short(abs(row[j]), 3)} " for j in others]
    signs = ["-" if row[j] < 0 else "+" for j in others]
    terms = [f" {sign} {size}{names[j]}" for j, sign, size in zip(others, signs, sizes, strict=True)]
    return names[first] + "".join(terms)
