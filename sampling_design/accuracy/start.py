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
class StartSet:
    """|S z| <= 1 in the Euclidean norm ("ball") or entry by entry; z is free where S says nothing, and without S.

    Rows of S are independent of each other.
    """

    S: Array | None
    ball: bool

    @property
    def rows(self) -> int:
        """How many rows S has."""
        return 0 if self.S is None else len(self.S)

    def support(self, rest: Array, scale: float) -> float:
        """h_start(rest). What is free costs nothing if the rest is rounding there, and everything else."""
        if self.S is None:
            return 0.0 if np.linalg.norm(rest) <= NOTHING * scale else np.inf
        if self.S.shape[0] == self.S.shape[1]:
            weights = np.linalg.solve(self.S.T, rest)
        else:
            weights = np.linalg.lstsq(self.S.T, rest)[0]
            if np.linalg.norm(rest - self.S.T @ weights) > NOTHING * scale:
                return np.inf
        return float(np.linalg.norm(weights) if self.ball else np.abs(weights).sum())

    def free(self, n: int) -> Array:
        """Orthonormal columns (n, m) that span what S says nothing about."""
        if self.S is None or not len(self.S):
            return np.eye(n)
        return np.asarray(np.linalg.svd(self.S / np.linalg.norm(self.S, axis=1, keepdims=True))[2][len(self.S) :].T)

    def excess(self, z: Array) -> float:
        """The factor by which z lies outside."""
        if self.S is None:
            return 0.0
        inside = self.S @ z
        return float(np.linalg.norm(inside) if self.ball else np.max(np.abs(inside), initial=0.0))

    def staged(self) -> tuple[bool, Array | None]:
        """Whether a program over stages takes the set, and its rows."""
        return not self.ball and self.S is not None and self.S.shape[0] == self.S.shape[1], self.S

    def pose(self, table: ConeTable, *, ball: bool) -> None:
        """Add the set to a program whose first variables are z, where it is of that kind."""
        if self.S is not None and self.ball and ball:
            table.ball(0, self.S)
        elif self.S is not None and not self.ball and not ball:
            table.box(0, self.S, np.ones(len(self.S)))


@dataclass(frozen=True, eq=False)
class ErrorReach:
    """|z| <= reach entry by entry before the first of some samples, by the gains of those before it; at rest: z = 0."""

    reach: Array

    @property
    def rows(self) -> int:
        """Every entry is bounded."""
        return self.reach.size

    def support(self, rest: Array, scale: float) -> float:
        """h_start(rest)."""
        return float(np.abs(rest) @ self.reach)

    def free(self, n: int) -> Array:
        """Nothing is free."""
        return np.zeros((n, 0))

    def staged(self) -> tuple[bool, Array | None]:
        """Whether a program over stages takes the set, and its rows: none at rest."""
        if self.reach.all():
            return True, np.diag(1 / self.reach)
        return not self.reach.any(), None

    def pose(self, table: ConeTable, *, ball: bool) -> None:
        """Add the set to a program whose first variables are z."""
        if not ball:
            table.box(0, np.eye(self.reach.size), self.reach)


ErrorBefore: TypeAlias = StartSet | ErrorReach
"""What is known before the first sample of a window: at the start of a record, or of the past of an endless one."""


@dataclass(frozen=True, eq=False)
class InitialSet:
    """The error x(start) - xbar: |S (e - centre)| <= 1, in the Euclidean norm or entry by entry."""

    S: Array  # (k, n): in the plant's units; no rows: nothing is known
    ball: bool
    exact: Mask  # (n,): entries that are known exactly; S says nothing of them
    centre: Array  # (n,): 0 where the bounds are symmetric

    @property
    def whole(self) -> bool:
        """Whether every state is bounded."""
        return len(self.S) + int(self.exact.sum()) >= self.exact.size

    @classmethod
    def of(cls, plant: Plant, value: InitialError) -> InitialSet:
        """Return the set as typed by a user.

        A number bounds the Euclidean norm, a vector each entry (infinite: unknown), a symmetric matrix P means e'P e <=
        1, a mapping gives names of states a number or a pair (lower, upper); None: nothing is known. Raises
        ArgumentError if it is negative, of another shape, names no state, or a pair is in the wrong order.
        """
        n = plant.n_states
        known, centre = np.zeros(n, dtype=bool), np.zeros(n)
        if value is None:
            return cls(freeze(np.zeros((0, n))), False, known, freeze(centre))
        if isinstance(value, Mapping):
            half, centre = named_bounds("initial_error", value, plant.states.names, np.inf)
            return cls._box(half, centre)
        if checks.dimensions(value) == 0:
            radius = checks.nonnegative("initial_error", value)
            if radius == 0 or n == 1:
                return cls._box(np.full(n, radius), centre)
            return cls(freeze(np.eye(n) / radius), True, known, freeze(centre))
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
            return cls(freeze(S), len(S) > 1, known, freeze(centre))
        half = np.array(_half_widths(value, n))
        return cls._box(half, centre)

    @classmethod
    def _box(cls, half: Array, centre: Array) -> InitialSet:
        some = np.isfinite(half) & (half > 0)
        S = np.eye(half.size)[some] / half[some, None]
        return cls(freeze(S), False, half == 0, freeze(centre))

    @property
    def free(self) -> bool:
        """Whether nothing is known."""
        return not len(self.S) and not self.exact.any()

    def scaled(self, change: Array, sizes: Array, tiny: float) -> StartSet:
        """The set in coordinates x = change z; what is known exactly gets `tiny` of its size there."""
        rows = np.vstack([self.S, np.diag(1 / (tiny * sizes))[self.exact]])
        return StartSet(rows @ change if len(rows) else None, self.ball)

    def excess(self, e: Array) -> float:
        """The factor by which an error about the centre lies outside; infinite if an exact entry is off."""
        if np.any(e[self.exact] != 0):
            return np.inf
        return StartSet(self.S, self.ball).excess(e)


SEMIDEFINITE = 1e-12  # an eigenvalue of a weight with unit diagonal below this share counts as 0


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
