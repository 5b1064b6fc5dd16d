"""Bounds on the disturbance and on the measurement noise, as the programs need them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.start import Entry, half_and_centre, named_bounds
from sampling_design.checkers.strict import is_table
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.checks import freeze
from sampling_design.schedules.sensor import Sensor

Given: TypeAlias = npt.ArrayLike | Mapping[str, Entry] | Callable[[float], npt.ArrayLike | tuple[float, float]]
Bound: TypeAlias = Given | None
NoiseBound: TypeAlias = Bound | Mapping[str, Entry | Sensor]
"""A number, entries, a mapping from names to numbers or pairs; for noise also rows per sample or functions of time."""


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
    def of(cls, name: str, bound: npt.ArrayLike | None, n: int) -> BoundedSet:
        """Return the set about 0 as typed by a user: a number (Euclidean), one for each entry, or None.

        Raises ArgumentError if it is negative or of another shape.
        """
        if bound is None:
            return cls(freeze(np.zeros(n)), freeze(np.zeros((n, n))), False, unbounded=True)
        size = checks.bound(name, bound, n)
        return cls.box(np.zeros(n), np.broadcast_to(size, (n,)), size.ndim == 0 and n > 1)

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
    if value is None:
        raise ArgumentError(
            f"`{name}` is missing: without a bound on {', '.join(names)} nothing can be guaranteed. "
            "Give 0 where there is none."
        )
    return value


def _one(name: str, value: Given, names: tuple[str, ...]) -> tuple[Array, Array, bool]:
    """Half-widths, centres, and whether the bound is one on the norm."""
    nothing = np.zeros(len(names))
    if callable(value):
        raise ArgumentError(f"`{name}` must be numbers, got a function: only noise may differ from sample to sample.")
    if isinstance(value, Mapping):
        return (*named_bounds(name, value, names, np.inf), False)
    if isinstance(value, tuple) and len(names) == 1 and len(value) == 2:
        half, centre = half_and_centre(name, value)
        return np.array([half]), np.array([centre]), False
    if checks.dimensions(value) == 0:
        return np.full(len(names), checks.nonnegative(name, value)), nothing, True
    array = np.array(checks.vector(name, value, len(names)))
    if np.any(array < 0):
        raise ArgumentError(f"`{name}` must not be negative, got {float(array.min())!r}.")
    return array, nothing, False


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
        return v, np.zeros(shape), False
    row, middle, ball = _one("v_bound", value, names)
    return np.broadcast_to(row, shape).copy(), np.broadcast_to(middle, shape).copy(), ball


def _known_times(times: Array | None) -> Array:
    if times is None:
        raise ArgumentError("`v_bound` must be numbers here, got a function: there are no sample times to give it.")
    return times
