"""What is known of the state before the first sample: a set about the prior's centre, or nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias, TypeGuard

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_number
from sampling_design.errors import ArgumentError
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.checks import freeze

Entry: TypeAlias = float | tuple[float, float]
InitialError: TypeAlias = npt.ArrayLike | Mapping[str, Entry] | None

NOTHING = 1e-10
"""A rest below this share of the target counts as none where the start is free: rounding, all being of size one."""


@dataclass(frozen=True, eq=False)
class InitialSet:
    """An error e at the start with |S (e - centre)| <= size row by row, or <= 1 in the Euclidean norm ("ball").

    Rows of S are independent of each other; e is free where they say nothing. Where a size is 0, the row is that of an
    entry that is known exactly; sizes of a ball are 1.
    """

    S: Array  # (k, n): no rows: nothing is known
    size: Array  # (k,)
    ball: bool
    centre: Array  # (n,): 0 where the bounds are symmetric

    @classmethod
    def box(cls, half: Array, centre: Array | None = None) -> InitialSet:
        """Return the set of given half-widths: infinite where nothing is known, 0 of what is known exactly."""
        order = np.argsort(half == 0, kind="stable")
        at = order[np.isfinite(half[order])]
        return cls(freeze(np.eye(half.size)[at]), freeze(half[at]), False, freeze(_origin(half.size, centre)))

    @classmethod
    def within(cls, S: Array, ball: bool) -> InitialSet:
        """Return the set |S e| <= 1 about 0."""
        return cls(freeze(S), freeze(np.ones(len(S))), ball, freeze(np.zeros(S.shape[1])))

    @property
    def whole(self) -> bool:
        """Whether every state is bounded."""
        return bool(len(self.S) >= self.S.shape[1])

    @property
    def rows(self) -> Array:
        """S over the sizes, without what is known exactly: |rows (e - centre)| <= 1."""
        some = self.size > 0
        return np.asarray(self.S[some] / self.size[some, None])

    @property
    def exact(self) -> Mask:
        """(n,): entries that are known exactly."""
        return np.asarray(np.any(self.S[self.size == 0] != 0, axis=0))

    def support(self, rest: Array, scale: float) -> float:
        """The largest rest'(e - centre). What is free costs nothing if the rest is rounding there, else everything."""
        if self.whole:
            weights = np.linalg.solve(self.S.T, rest)
        else:
            weights = np.linalg.lstsq(self.S.T, rest)[0] if len(self.S) else np.zeros(0)
            if np.linalg.norm(rest - self.S.T @ weights) > NOTHING * scale:
                return np.inf
        weights = weights * self.size
        return float(np.linalg.norm(weights) if self.ball else np.abs(weights).sum())

    def free(self) -> Array:
        """Orthonormal columns (n, m) that span what S says nothing about."""
        count, n = self.S.shape
        if not count:
            return np.eye(n)
        if self.whole:
            return np.zeros((n, 0))
        return np.asarray(np.linalg.svd(self.S / np.linalg.norm(self.S, axis=1, keepdims=True))[2][count:].T)

    def excess(self, e: Array) -> float:
        """The factor by which an error about the centre lies outside; infinite if what is known exactly is off."""
        some, shown = self.size > 0, self.S @ e
        if np.any(shown[~some] != 0):
            return np.inf
        inside = shown[some] / self.size[some]
        return float(np.linalg.norm(inside) if self.ball else np.max(np.abs(inside), initial=0.0))

    def staged(self) -> tuple[bool, Array | None]:
        """Whether a program over stages takes the set, and its rows: none at rest."""
        if self.ball or not self.whole:
            return False, None
        if np.all(self.size > 0):
            return True, self.rows
        return not self.size.any(), None

    def pose(self, table: ConeTable, *, ball: bool) -> None:
        """Add the set to a program whose first variables are e, where it is of that kind."""
        if len(self.S) and self.ball and ball:
            table.ball(0, self.S)
        elif len(self.S) and not self.ball and not ball:
            table.box(0, self.S, self.size)

    def scaled(self, change: Array, sizes: Array, tiny: float) -> InitialSet:
        """The set about 0 in coordinates x = change z; what is known exactly gets `tiny` of its size there."""
        unit = np.where(self.size > 0, self.size, tiny * np.abs(self.S) @ sizes)
        return InitialSet.within(self.S / unit[:, None] @ change, self.ball)

    @classmethod
    def of(cls, plant: Plant, value: InitialError) -> InitialSet:
        """Return the set as typed by a user.

        A number bounds the Euclidean norm, a vector each entry (infinite: unknown), a symmetric matrix P means e'P e <=
        1, a mapping gives names of states a number or a pair (lower, upper); None: nothing is known. Raises
        ArgumentError if it is negative, of another shape, names no state, or a pair is in the wrong order.
        """
        n = plant.n_states
        if value is None:
            return cls.box(np.full(n, np.inf))
        if isinstance(value, Mapping):
            return cls.box(*named_bounds("initial_error", value, plant.states.names, np.inf))
        if checks.dimensions(value) == 0:
            radius = checks.nonnegative("initial_error", value)
            if radius == 0 or n == 1:
                return cls.box(np.full(n, radius))
            return cls.within(np.eye(n) / radius, True)
        if checks.dimensions(value) == 2:
            P = checks.symmetric("initial_error", value, n)
            d = np.sqrt(np.abs(np.diag(P)))
            d = np.where(d > 0, d, 1.0)
            sizes, vectors = np.linalg.eigh(symmetrise(P / np.outer(d, d)))
            if sizes[0] < -SEMIDEFINITE * n:
                raise ArgumentError(
                    "`initial_error` as a matrix P means e'P e <= 1 and must be positive semidefinite, "
                    f"got an eigenvalue below 0: {sizes[0]:.3g} with unit diagonal."
                )
            keep = sizes > SEMIDEFINITE * n
            S = (vectors[:, keep] * np.sqrt(sizes[keep])).T * d
            return cls.within(S, len(S) > 1)
        return cls.box(np.array(_half_widths(value, n)))


SEMIDEFINITE = 1e-12  # an eigenvalue of a weight with unit diagonal below this share counts as 0


def _origin(n: int, centre: Array | None) -> Array:
    return np.zeros(n) if centre is None else centre


def _half_widths(value: npt.ArrayLike, n: int) -> Array:
    try:
        half = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        half = np.full(n + 1, np.nan)
    if half.shape != (n,) or np.isnan(half).any() or np.any(half < 0):
        raise ArgumentError(
            f"`initial_error` must be a number, {n} half-widths (infinite where nothing is known), a weight ({n}, {n}) "
            f"or a mapping from names of states, got {checks.described(value)}."
        )
    return half


def named_bounds(
    argument: str, value: Mapping[str, Entry], names: tuple[str, ...], missing: float
) -> tuple[Array, Array]:
    """Return half-widths and centres of a mapping from names to numbers or pairs (lower, upper).

    Raises ArgumentError if a name is unknown, a number negative or a pair in the wrong order.
    """
    checks.known_keys(f"`{argument}`", [str(key) for key in value], names)
    half, centre = np.full(len(names), missing), np.zeros(len(names))
    for name, entry in value.items():
        at = names.index(name)
        half[at], centre[at] = half_and_centre(f"{argument}[{name!r}]", entry)
    return half, centre


def half_and_centre(argument: str, entry: object) -> tuple[float, float]:
    """Return half-width and centre of a number (about 0) or a pair (lower, upper); what is one-sided is unbounded.

    Raises ArgumentError if the number is negative, or the pair in the wrong order.
    """
    if isinstance(entry, tuple):
        if len(entry) != 2:
            raise ArgumentError(f"`{argument}` must be a number or a pair (lower, upper), got {entry!r:.60}.")
        low, high = (float(x) if _is_infinite(x) else checks.number(argument, x) for x in entry)
        if low > high:
            raise ArgumentError(f"`{argument}` must be a pair (lower, upper), got {entry!r:.60}: lower exceeds upper.")
        if np.isinf(low) or np.isinf(high):
            return np.inf, 0.0
        return (high - low) / 2, (high + low) / 2
    if _is_infinite(entry) and entry == np.inf:
        return np.inf, 0.0
    return checks.nonnegative(argument, entry), 0.0


def _is_infinite(value: object) -> TypeGuard[float]:
    return is_number(value) and bool(np.isinf(value))
