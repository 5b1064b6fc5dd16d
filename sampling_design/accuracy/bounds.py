"""Bounds as typed by a user, as the programs need them: of the disturbance, the noise, and the error at the start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_table
from sampling_design.errors import ArgumentError
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.linalg import discounted_flow, right_directions, symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask, freeze
from sampling_design.records.vector_bounds import (
    Entry,
    VectorBound,
    half_and_centre,
    named_bounds,
    refuse_apart,
    squarable,
    vector_bound,
)
from sampling_design.schedules.sensor import Sensor

Given: TypeAlias = npt.ArrayLike | Mapping[str, Entry] | Callable[[float], npt.ArrayLike | tuple[float, float]]
Bound: TypeAlias = Given | None
NoiseBound: TypeAlias = Bound | Mapping[str, Entry | Sensor]
"""A number, entries, a mapping from names to numbers or pairs; for noise also rows per sample or functions of time."""

NOTHING = 1e-10
"""A rest below this share of the target counts as none where the start is free: rounding, all being of size one."""

EXACT = 1e-6
"""Size given to an exact sensor, in units of what w does to its output: over a period; of one that is nearly exact over
a time in which little grows. Rows in units of less noise would part states by more than doubles hold."""


@dataclass(frozen=True, eq=False)
class BoundedSet:
    """The values centre + root a, |a| <= 1 in the Euclidean norm (`ball`) or entry by entry; all, if `unbounded`."""

    centre: Array  # (n,)
    root: Array  # (n, m)
    ball: bool
    unbounded: bool = False

    @classmethod
    def box(cls, centre: Array, half: Array, ball: bool = False) -> BoundedSet:
        """Return the set of given half-widths (n,); those of a ball are its half-axes."""
        return cls(freeze(centre), freeze(np.diag(half)), ball)

    @classmethod
    def of(cls, name: str, bound: VectorBound, names: tuple[str, ...]) -> BoundedSet:
        """Return the set about 0 as typed by a user: a number (Euclidean), one for each entry or by name, or None.

        Raises ArgumentError if it is negative, of another shape, or not about 0.
        """
        n = len(names)
        if bound is None:
            return cls(freeze(np.zeros(n)), freeze(np.zeros((n, n))), False, unbounded=True)
        size = vector_bound(name, bound, names)
        return cls.box(np.zeros(n), np.broadcast_to(size, (n,)), size.ndim == 0)

    @property
    def half_widths(self) -> Array:
        """(n,) of the least box around it."""
        return np.asarray(np.linalg.norm(self.root, axis=1) if self.ball else np.abs(self.root).sum(axis=1))

    def support(self, row: Array) -> float:
        """The largest row'(x - centre)."""
        weights = self.root.T @ row
        return float(np.linalg.norm(weights) if self.ball else np.abs(weights).sum())


@dataclass(frozen=True, eq=False)
class SignalBounds:
    """|w(t)| <= w and |v_j| <= v_j in the Euclidean norm ("ball"), or entry by entry ("box")."""

    w: Array  # (q,): half-widths; equal ones for a ball
    w_ball: bool
    v: Array  # (N, p): one row for each sample; infinite where an output is not measured
    v_ball: bool  # the norm is over the outputs that a sample measures
    w_centre: Array | None = None
    v_centre: Array | None = None

    @classmethod
    def of(
        cls, plant: Plant, samples: int, mask: Mask | None, w_bound: Bound, v_bound: Bound, times: Array | None = None
    ) -> SignalBounds:
        """Return the bounds as typed by a user.

        Numbers bound the Euclidean norm, vectors each entry, mappings entries by name: a number or a pair (lower,
        upper). For v also one row per sample, or functions of the sample's time. Raises ArgumentError if one is
        missing, negative, not a number, of another shape, or names what is not there.
        """
        missing = _refuse_missing("w_bound", w_bound, plant.disturbances.names)
        w, w_centre, w_ball = _one("w_bound", missing, plant.disturbances.names)
        v, v_centre, v_ball = _each(_refuse_missing("v_bound", v_bound, plant.outputs.names), plant, samples, times)
        measured = np.ones(v.shape, dtype=bool) if mask is None else mask
        if is_table(v_bound):
            lost = [n for k, n in enumerate(plant.outputs.names) if n not in v_bound and measured[:, k].any()]
            if lost:
                raise ArgumentError(
                    f"`v_bound` is missing for {', '.join(lost)}, which the schedule measures. "
                    "Give it a number, 0 for an exact sensor, infinity for one that says nothing."
                )
        v[~measured] = np.inf
        refuse_apart(plant.C, plant.G, w_bound=w, v_bound=v)
        if times is None and (w_centre.any() or v_centre.any()):
            raise ArgumentError(
                f"`{'w_bound' if w_centre.any() else 'v_bound'}` must be centred at 0 here, got an interval that is "
                "not. Subtract its middle from the data."
            )
        if np.isinf(w).any():
            lost = [n for n, size in zip(plant.disturbances.names, w, strict=True) if np.isinf(size)]
            raise ArgumentError(f"`w_bound` is missing for {', '.join(lost)}: give both ends, or 0.")
        centres = (
            freeze(w_centre) if w_centre.any() else None,
            freeze(np.where(np.isfinite(v), v_centre, 0.0)) if v_centre.any() else None,
        )
        return cls(freeze(w), w_ball and w.size > 1, freeze(v), v_ball and plant.n_outputs > 1, *centres)

    def measured(self, sample: int) -> Index:
        """Outputs that a sample measures."""
        return np.flatnonzero(np.isfinite(self.v[sample]))


def _refuse_missing(name: str, value: Bound, names: tuple[str, ...]) -> Given:
    if value is None and names:
        raise ArgumentError(
            f"`{name}` is missing: without a bound on {', '.join(names)} nothing can be guaranteed. "
            "Give 0 where there is none."
        )
    return 0.0 if value is None else value


def _one(name: str, value: Given, names: tuple[str, ...]) -> tuple[Array, Array, bool]:
    """Half-widths, centres, and whether the bound is one on the norm."""
    nothing = np.zeros(len(names))
    if callable(value):
        raise ArgumentError(f"`{name}` must be numbers, got a function: only noise may differ from sample to sample.")
    if is_table(value):
        return (*named_bounds(name, value, names), False)
    if isinstance(value, tuple) and len(names) == 1 and len(value) == 2:
        half, centre = half_and_centre(name, value)
        return np.array([half]), np.array([centre]), False
    return np.full(len(names), vector_bound(name, value, names)), nothing, checks.dimensions(value) == 0


def _each(value: Given, plant: Plant, samples: int, times: Array | None) -> tuple[Array, Array, bool]:
    """The same for every sample, shapes (N, p)."""
    names, shape = plant.outputs.names, (samples, plant.n_outputs)
    if callable(value):
        rows = [_one("v_bound", value(float(t)), names) for t in _known_times(times)]
        balls = {ball for *_, ball in rows}
        if len(balls) > 1:
            raise ArgumentError("`v_bound` must return numbers for all samples or entries for all samples, got both.")
        return np.array([v for v, *_ in rows]), np.array([c for _, c, _ in rows]), balls == {True}
    if is_table(value):
        v, centre = np.full(shape, np.inf), np.zeros(shape)
        checks.known_keys("`v_bound`", [str(key) for key in value], names)
        for name, entry in value.items():
            at = names.index(name)
            given: Sequence[object]
            if callable(entry):
                given = [entry(float(t)) for t in _known_times(times)]
            elif not isinstance(entry, (list, np.ndarray)):
                given = [entry] * samples
            else:
                given = list(entry)
                if len(given) != samples:
                    raise ArgumentError(
                        f"`v_bound[{name!r}]` must have one entry for each of {samples} samples, got {len(given)}. "
                        "An interval is a pair in round brackets."
                    )
            pairs = [half_and_centre(f"v_bound[{name!r}]", one) for one in given]
            v[:, at], centre[:, at] = np.array(pairs).reshape(-1, 2).T
        return v, centre, False
    if not isinstance(value, tuple) and checks.dimensions(value) == 2:
        v = np.array(checks.matrix("v_bound", value, samples, len(names)))
        if np.any(v < 0):
            raise ArgumentError(f"`v_bound` must not be negative, got {float(v.min())!r}.")
        return squarable("v_bound", v), np.zeros(shape), False
    row, middle, ball = _one("v_bound", value, names)
    return np.broadcast_to(row, shape).copy(), np.broadcast_to(middle, shape).copy(), ball


def _known_times(times: Array | None) -> Array:
    if times is None:
        raise ArgumentError("`v_bound` must be numbers here, got a function: there are no sample times to give it.")
    return times


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
        order, middle = np.argsort(half == 0, kind="stable"), np.zeros(half.size) if centre is None else centre
        at = order[np.isfinite(half[order])]
        return cls(freeze(np.eye(half.size)[at]), freeze(half[at]), False, freeze(middle))

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
            sizes = np.linalg.norm(self.S, axis=1)  # what is known exactly beside what is not is far apart
            rows = self.S / sizes[:, None]
            weights = np.linalg.lstsq(rows.T, rest)[0] if len(rows) else np.zeros(0)
            if np.linalg.norm(rest - rows.T @ weights) > NOTHING * scale:
                return np.inf
            weights = weights / sizes
        weights = weights * self.size
        return float(np.linalg.norm(weights) if self.ball else np.abs(weights).sum())

    def free(self) -> Array:
        """Orthonormal columns (n, m) that span what S says nothing about."""
        count, n = self.S.shape
        if not count:
            return np.eye(n)
        if self.whole:
            return np.zeros((n, 0))
        return np.asarray(right_directions(self.S / np.linalg.norm(self.S, axis=1, keepdims=True))[1][count:].T)

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
    def of(cls, plant: Plant, value: VectorBound) -> InitialSet:
        """Return the set as typed by a user.

        A number bounds the Euclidean norm, a vector each entry (infinite: unknown), a symmetric matrix P means e'P e <=
        1, a mapping gives names of states a number or a pair (lower, upper); None: nothing is known. Raises
        ArgumentError if it is negative, of another shape, names no state, or a pair is in the wrong order.
        """
        n = plant.n_states
        if value is None:
            return cls.box(np.full(n, np.inf))
        if is_table(value):
            return cls.box(*named_bounds("initial_error", value, plant.states.names))
        if checks.dimensions(value) == 0:
            radius = float(squarable("initial_error", checks.nonnegative("initial_error", value)))
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


def _half_widths(value: object, n: int) -> Array:
    try:
        half = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        half = np.full(n + 1, np.nan)
    if half.shape != (n,) or np.isnan(half).any() or np.any(half < 0):
        raise ArgumentError(
            f"`initial_error` must be a number, {n} half-widths (infinite where nothing is known), a weight ({n}, {n}) "
            f"or a mapping from names of states, got {checks.described(value)}."
        )
    return squarable("initial_error", half)


def noise_units(
    C: Array, bounds: SignalBounds, W: Array, A: Array, G: Array, step: float
) -> tuple[list[Array], list[Array], list[Array]]:
    """Rows of each sample over the size of its noise, those sizes, and bounds on the noise in them.

    W (k, n, n) is what w does over a period, `step` a time between samples.
    """
    driven, brief = _output_sizes(C, W), step / max(1.0, step * float(np.linalg.norm(A, 1)))
    least = EXACT * _output_sizes(C, discounted_flow(A, G @ G.T, np.array([brief]))[1] * brief)
    stand_in = np.where(driven > 0, EXACT * driven, np.linalg.norm(C, axis=1))
    stand_in = np.where(stand_in > 0, stand_in, 1.0)
    rows, sizes, noise = [], [], []
    for j in range(bounds.v.shape[0]):
        outputs = bounds.measured(j)
        v = bounds.v[j, outputs]
        size = np.where(v > 0, np.maximum(v, least[outputs]), stand_in[outputs])
        rows.append(C[outputs] / size[:, None])
        sizes.append(size)
        noise.append(v / size)
    return rows, sizes, noise


def _output_sizes(C: Array, W: Array) -> Array:
    """Deviations of outputs of which covariances W (k, n, n) are joined."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("pi,kij,pj->p", C, W, C), 0.0)))
