"""Plants that are not exactly known: the difference of two trajectories follows one of a set of linear plants."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.record import Plain
from sampling_design.records.signatures import checked_methods


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
