"""Plants that are not exactly known: the difference of two trajectories follows one of a set of linear plants.

Of some of these plants the numbers are only known to lie in ranges, or between vertices.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_flag
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant, Signals, remade
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.file_io import read_tree, usable, write_tree
from sampling_design.records.record import Plain, PlainRecord, short
from sampling_design.records.signatures import checked_methods
from sampling_design.uncertain.plants.plant_files import UncertainParameter, entry_parameters, parts_of_tree, tree_of


class InclusionMembers(NamedTuple):
    """Some plants of an inclusion: (A, G) side by side (K, n, n + q), C (L, p, n), and where each (A, G) comes from.

    `complete` says that their convex hull is the whole inclusion; otherwise they are samples of it.
    """

    dynamics: Array
    outputs: Array
    places: tuple[str, ...]
    complete: bool


BoxColumns: TypeAlias = tuple[Array, Array, tuple[int, ...]]
"""A box of many parameters, (middle, add, at): (A, G) at its middle (n, n + q), changes d_k add[:, k] (x, w)_at[k] with
|d_k| <= 1, in the order in which certificate files hold a multiplier for each: by parameter, then by the column it
moves."""


class MemberHull(NamedTuple):
    """Sets that together hold the whole inclusion: (A, G) side by side at the middle of each (K, n, n + q), what may
    be added to it times any numbers in [-1, 1] (D, K, n, n + q); C at the middle of one set (p, n), its moves.
    """

    middle: Array
    moves: Array
    output: Array
    output_moves: Array


@checked_methods
class LinearInclusion(ABC):
    """A plant of which certificates know a set: two trajectories with the same parameters and inputs differ by Dx with

        Dx' = A(t) Dx + G(t) Dw,    Dy = C(t) Dx + Dv,    (A, G, C)(t) in a convex set

    References
    ----------
    Boyd, El Ghaoui, Feron and Balakrishnan 1994, linear differential inclusions.
    """

    @property
    @abstractmethod
    def centre(self) -> Plant:
        """One linear plant of the set, with the names, units and scales of all."""

    @abstractmethod
    def model_to_dict(self) -> dict[str, Plain]:
        """The set as plain data, as certificate files hold it."""

    @abstractmethod
    def members(self, rng: np.random.Generator) -> InclusionMembers:
        """Some of its plants, the extreme ones among them as far as they are known."""

    @abstractmethod
    def constant_members(self, rng: np.random.Generator) -> list[tuple[str, Plant]]:
        """Linear plants that, each for itself, are possible for all time, the extreme ones first, and their names."""

    @property
    def columns(self) -> BoxColumns | None:
        """The changes for which multipliers take the place of members that are too many; None where they are not."""
        return None

    def hull(self, halvings: int, size: Callable[[Array], Array]) -> MemberHull | None:
        """Sets of few directions that hold the inclusion, proven; None where the members say more.

        `size` of moves (D, K, n, n + q) says which sets (K,) are large, and which way to halve them.
        """
        return None

    @property
    def members_are_plants(self) -> bool:
        """Whether each member is possible for all time; if not, none of them alone refutes anything."""
        return True

    @property
    @abstractmethod
    def assumptions(self) -> tuple[str, ...]:
        """What a certificate about it takes for granted."""


_MOVED = ("A", "C", "G")
MOST_CORNERS = 10
"""Parameters of a box up to which all its corners are listed; beyond it random ones."""
MOST_LISTED = 8  # parameters that move A or G up to which a certificate's program knows corners; beyond it multipliers
DRAWN = 1024  # corners that are drawn where there are more


@frozen
class UncertainPlant(LinearInclusion, PlainRecord):
    """A linear plant whose matrices depend on parameters in a box, or lie between vertices.

        A(theta) = A + sum_k (theta_k - nominal_k) A_k,    likewise C and G,    low_k <= theta_k <= high_k

    Parameters
    ----------
    nominal : Plant
        The plant at the nominal values, with names, units and scales.
    parameters : sequence of UncertainParameter
    vertices : sequence of Plant
        Instead of parameters: A, C and G are any convex combination of theirs.
    varying : bool
        Whether the parameters may change in time, as fast as they like. False: constant, with unknown values.

    Raises
    ------
    ArgumentError
        If both or neither of parameters and vertices are given, a name repeats, or a matrix has the wrong shape.

    Notes
    -----
    *Assumptions.* Two trajectories that are compared have the same parameters. A certificate (`certify`) holds for
    varying parameters too. B and D are known.

    Examples
    --------
    >>> oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> stiffness = UncertainParameter("omega^2", 0.81, 1.21, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
    >>> plant = UncertainPlant(oscillator, [stiffness])
    >>> plant.at([1.21]).A.tolist()
    [[0.0, 1.0], [-1.21, 0.0]]
    """

    nominal: Plant
    parameters: Converted[Sequence[UncertainParameter], tuple[UncertainParameter, ...]] = ()  # type: ignore[assignment]
    vertices: Converted[Sequence[Plant], tuple[Plant, ...]] = field(default=(), kw_only=True)  # type: ignore[arg-type]
    varying: bool = field(default=False, kw_only=True)

    _plain = "plant:nominal model:model_to_dict"

    def __post_init__(self) -> None:
        checks.of_kind("nominal", self.nominal, Plant)
        for key, kind in (("parameters", UncertainParameter), ("vertices", Plant)):
            value = getattr(self, key)
            if not checks.holds(value, kind):
                raise ArgumentError(f"`{key}` must be a list of {kind.__name__}, got {checks.described(value)}.")
            self._hold(**{key: tuple(value)})
        if bool(self.parameters) == bool(self.vertices):
            raise ArgumentError("`parameters` or `vertices` must be given, one of them and not both.")
        if not is_flag(self.varying):
            raise ArgumentError(f"`varying` must be True or False, got {checks.described(self.varying)}.")
        checks.names("parameters", [each.name for each in self.parameters], len(self.parameters), "")
        for each in self.parameters:
            for key in _MOVED:
                M, wanted = getattr(each, key), getattr(self.nominal, key).shape
                if M is not None and M.shape != wanted:
                    raise ArgumentError(f"`{key}` of {each.name} must have shape {wanted} of the plant, got {M.shape}.")
        for k, vertex in enumerate(self.vertices):
            same = all(getattr(vertex, key).shape == getattr(self.nominal, key).shape for key in _MOVED)
            if not same or vertex.time_unit != self.nominal.time_unit:
                raise ArgumentError(f"`vertices[{k}]` must have the sizes and the time unit of `nominal`.")

    @classmethod
    def from_intervals(
        cls,
        A: tuple[npt.ArrayLike, npt.ArrayLike],
        C: tuple[npt.ArrayLike, npt.ArrayLike] | npt.ArrayLike,
        G: tuple[npt.ArrayLike, npt.ArrayLike] | npt.ArrayLike | None = None,
        *,
        varying: bool = False,
        time_unit: str = "s",
        name: str = "",
        states: Signals | Sequence[str] | None = None,
        outputs: Signals | Sequence[str] | None = None,
    ) -> UncertainPlant:
        """Return the plant whose matrices lie entry by entry between a lower and an upper one.

        Parameters
        ----------
        A, C, G : (lower, upper)
            Pairs of matrices, or one matrix where it is known. Each entry that is not becomes a parameter.
        varying, time_unit, name, states, outputs
            As for `UncertainPlant` and `Plant`.

        Returns
        -------
        UncertainPlant

        Raises
        ------
        ArgumentError
            If shapes differ or a lower entry exceeds the upper one.
        """
        sides = {
            key: _lower_and_upper(key, value) for key, value in (("A", A), ("C", C), ("G", G)) if value is not None
        }
        found = {key: entry_parameters(key, low, high) for key, (low, high) in sides.items()}
        middle = {key: each for key, (each, _) in found.items()}
        known = {"time_unit": time_unit, "name": name}
        nominal = Plant(middle["A"], middle["C"], G=middle.get("G"), states=states, outputs=outputs, **known)
        return cls(nominal, [each for _, own in found.values() for each in own], varying=varying)

    @property
    def n_states(self) -> int:
        """Dimension n of x."""
        return self.nominal.n_states

    @property
    def time_unit(self) -> str:
        """Unit of all times."""
        return self.nominal.time_unit

    @property
    def low(self) -> Array:
        """Lower ends of the parameters."""
        return np.array([each.low for each in self.parameters])

    @property
    def high(self) -> Array:
        """Upper ends of the parameters."""
        return np.array([each.high for each in self.parameters])

    def at(self, values: npt.ArrayLike | Mapping[str, float]) -> Plant:
        """Return the plant at these values of the parameters, or at these weights of the vertices.

        Raises
        ------
        ArgumentError
            If a value lies outside its range, or a name is unknown.
        """
        if isinstance(values, Mapping):
            checks.known_keys("`values`", values, [each.name for each in self.parameters])
            values = [values.get(each.name, each.nominal) for each in self.parameters]
        theta = checks.vector("values", values, len(self.parameters or self.vertices))
        if self.vertices:
            if np.any(theta < 0) or abs(float(theta.sum()) - 1) > 1e-12:
                raise ArgumentError("`values` of a plant between vertices must be shares that sum to 1.")
            found = {key: np.tensordot(theta, np.array([getattr(v, key) for v in self.vertices]), 1) for key in _MOVED}
            return remade(self.nominal, A=found["A"], C=found["C"], G=found["G"])
        for each, value in zip(self.parameters, theta.tolist(), strict=True):
            if not each.low <= value <= each.high:
                raise ArgumentError(f"`values` must lie in the ranges, got {each.name} = {value!r} outside.")
        return remade(self.nominal, A=self._matrix("A", theta), C=self._matrix("C", theta), G=self._matrix("G", theta))

    def _matrix(self, key: str, theta: Array) -> Array:
        found: Array = getattr(self.nominal, key)
        for each, value in zip(self.parameters, theta.tolist(), strict=True):
            M = getattr(each, key)
            if M is not None:
                found = found + (value - each.nominal) * M
        return found

    def moves(self, key: str) -> list[Array]:
        """Return what one unit of each parameter adds to "A", "C" or "G": zeros where it adds nothing."""
        key = checks.word("key", key, _MOVED)
        nothing = np.zeros(getattr(self.nominal, key).shape)
        return [nothing if (M := getattr(each, key)) is None else M for each in self.parameters]

    def draw(self, rng: checks.Seed = None) -> Plant:
        """Return a random plant of the set; half of the parameters are at an end of their range."""
        rng = checks.generator(rng)
        if self.vertices:
            return self.at(rng.dirichlet(np.ones(len(self.vertices))))
        theta = rng.uniform(self.low, self.high)
        ends = np.where(rng.random(theta.size) < 0.5, self.low, self.high)
        return self.at(np.where(rng.random(theta.size) < 0.5, ends, theta))

    def within(self, low: npt.ArrayLike, high: npt.ArrayLike) -> UncertainPlant:
        """Return the same plant with narrower ranges; nominal values are moved to their middles.

        Raises
        ------
        ArgumentError
            If it has no parameters, or a range is empty or not inside.
        """
        count = len(self.parameters)
        a, b = checks.vector("low", low, count), checks.vector("high", high, count)
        if not count or np.any(a > b) or np.any(a < self.low) or np.any(b > self.high):
            raise ArgumentError("`low` and `high` must be ranges inside those of the parameters.")
        middle = a / 2 + b / 2
        parts = [
            replace(each, low=float(u), high=float(v), nominal=float(m))
            for each, u, v, m in zip(self.parameters, a, b, middle, strict=True)
        ]
        return UncertainPlant(self.at(middle), parts, varying=self.varying)

    @property
    def columns(self) -> BoxColumns | None:
        """The columns of (A, G) that parameters move, where there are more than `MOST_LISTED` of them."""
        moving = [
            each for each in self.parameters if each.low < each.high and (each.A is not None or each.G is not None)
        ]
        if len(moving) <= MOST_LISTED:
            return None
        middle, add, at = np.hstack([self.nominal.A, self.nominal.G]), [], []
        for each, A, G in zip(self.parameters, self.moves("A"), self.moves("G"), strict=True):
            M = np.hstack([A, G])
            middle = middle + (each.low / 2 + each.high / 2 - each.nominal) * M
            for k in np.flatnonzero(np.any(M != 0, axis=0)).tolist():
                add.append((each.high - each.low) / 2 * M[:, k])
                at.append(k)
        return middle, np.array(add).T, tuple(at)

    # --- what certificates need ---------------------------------------------------------------------------------------

    @property
    def centre(self) -> Plant:
        """The nominal plant."""
        return self.nominal

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What a certificate about it takes for granted."""
        known = f"{len(self.parameters)} parameters in their ranges" if self.parameters else "between the vertices"
        return (f"linear plant, {known}, constant or varying", "two trajectories share the parameters")

    def model_to_dict(self) -> dict[str, Plain]:
        """The set as certificate files hold it."""
        if self.vertices:
            stacks = {key: [getattr(each, key).tolist() for each in self.vertices] for key in _MOVED}
            return {"kind": "vertices", "varying": bool(self.varying), **stacks}
        listed = [each.to_dict() for each in self.parameters]
        return {"kind": "box", "varying": bool(self.varying), "parameters": listed}

    def corners(self, rng: np.random.Generator) -> tuple[list[str], Array]:
        """Names and values (K, parameters) of the corners of the box, random ones where there are too many."""
        count = len(self.parameters)
        if count <= MOST_CORNERS:
            signs = np.array(list(product((False, True), repeat=count))).reshape(2**count, count)
        else:
            signs = rng.random((DRAWN, count)) < 0.5
        values = np.where(signs, self.high, self.low)
        names = [each.name for each in self.parameters]
        words = [", ".join(f"{n} = {short(v)}" for n, v in zip(names, row, strict=True)) for row in values.tolist()]
        return words, values

    def members(self, rng: np.random.Generator) -> InclusionMembers:
        """Vertices, or corners of the box, each once and in one order, however they were listed."""
        listed = self.constant_members(rng)[: None if self.vertices else 2 ** min(len(self.parameters), MOST_CORNERS)]
        dynamics, at = np.unique(
            np.array([np.hstack([plant.A, plant.G]) for _, plant in listed]), axis=0, return_index=True
        )
        outputs = np.unique(np.array([plant.C for _, plant in listed]), axis=0)
        complete = bool(self.vertices) or len(self.parameters) <= MOST_CORNERS
        return InclusionMembers(dynamics, outputs, tuple(listed[k][0] for k in at.tolist()), complete)

    def constant_members(self, rng: np.random.Generator) -> list[tuple[str, Plant]]:
        """Corners or vertices, then plants along each parameter's range."""
        if self.vertices:
            return [(f"vertex {k}", each) for k, each in enumerate(self.vertices)]
        words, values = self.corners(rng)
        return [(word, self.at(row)) for word, row in zip(words, values, strict=True)]

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> UncertainPlant:
        """Return the plant in a .toml or .json file.

        Parameters
        ----------
        path : path
            A plant file whose entries may be ranges, `[-1.21, -0.81]` or `"-1 +- 0.2"`, with `[[parameters]]` that move
            several entries together, or with `[[vertices]]`.

        Raises
        ------
        FileFormatError
            If the file is missing, cut off, has an unknown key, or does not describe such a plant.

        Notes
        -----
        *Numerical aspects.* The ends of "middle +- half" are rounded to doubles once; ranges are read exactly.
        """
        return cls.from_tree(read_tree(path), os.fspath(path))

    @classmethod
    def from_tree(cls, data: Mapping[str, object], where: str = "uncertain plant") -> UncertainPlant:
        """Return the plant in a tree of the file format.

        Raises
        ------
        FileFormatError
            If the data do not describe one.
        """
        with usable(where):
            nominal, parameters, vertices, varying = parts_of_tree(data, where)
            return cls(nominal, parameters, vertices=vertices, varying=varying)

    def to_tree(self) -> dict[str, Plain]:
        """Plain data of the file format: exactly the numbers of the record."""
        return tree_of((self.nominal, self.parameters, self.vertices, self.varying))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the plant to a .toml or .json file, whole or not at all; return the path.

        Raises
        ------
        FileFormatError
            If the suffix is another or the file cannot be written.
        """
        return write_tree(path, self.to_tree(), "an uncertain plant")

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(each.name, f"{short(each.low)} to {short(each.high)}") for each in self.parameters]
        rows += [("vertices", str(len(self.vertices)))] if self.vertices else []
        word = "may vary in time" if self.varying else "constant, unknown"
        return [("name", self.nominal.name or "-"), *rows, ("parameters", word), ("time unit", self.time_unit)]

    def explain(self) -> str:
        """Say what is known of the plant."""
        ranges = "; ".join(each.explain().rstrip(".") for each in self.parameters)
        known = ranges or f"it lies between {len(self.vertices)} vertices"
        return f"{self.nominal.name or 'A plant'} with {self.n_states} states: {known}."


def _lower_and_upper(key: str, value: object) -> tuple[Array, Array]:
    """Lower and upper matrix; one matrix stands for both."""
    match value:
        case tuple((low, high)):
            a = checks.matrix(f"{key} lower", low)
            b = checks.matrix(f"{key} upper", high, *a.shape)
        case _:
            return (only := checks.matrix(key, value)), only
    if np.any(a > b):
        i, j = (int(k) for k in np.argwhere(a > b)[0])
        raise ArgumentError(
            f"`{key}` must have lower entries at most the upper ones, got {key}[{i}, {j}] the other way."
        )
    return a, b
