"""A finite schedule as a sampled system that begins with a set of errors, and what its samples determine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sampling_design.accuracy.bounded_directions import BoundedDirections, LazyDirections
from sampling_design.accuracy.bounds import EXACT, InitialSet, SignalBounds, noise_units
from sampling_design.accuracy.gains import Integral, path_bounds
from sampling_design.accuracy.gap_table import GapTable, state_scales
from sampling_design.accuracy.sampled_system import (
    GapDynamics,
    MeasurementModel,
    SampledSystem,
    balanced_flows,
    make_gap,
    refuse_growth,
)
from sampling_design.accuracy.undetectable import ROUNDED, UNOBSERVABLE
from sampling_design.errors import UndecidedError
from sampling_design.numerics.filtering import carried, covariance_root, largest_first, root_update, triangle
from sampling_design.numerics.linalg import right_directions
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask

DIFFUSE = 1e6
"""Covariance of what is free at the start, in scaled coordinates: for the choice of coordinates and gains only."""

NO_ERROR = 1e-9  # half-width given to an entry that is known exactly at the start, in scaled coordinates

BLURRED = 1e-7
"""Share of its way to which a hidden direction may shrink: what rounding makes of it is then below `UNOBSERVABLE`."""

LITTLE = 3e-7
"""Share of the deviation of each state that is added to a root, for coordinates: they have digits left then."""

BEYOND = 1e3  # a state's scale is at most so many times what is known of it at the start


def finite_system(plant: Plant, times: Array, end: float, bounds: SignalBounds, initial: InitialSet) -> SampledSystem:
    """Return the system of nodes `times`, the first of which is the start; rows of `bounds.v` say what is measured."""
    lengths, last = np.diff(times), float(end - times[-1])
    refuse_growth(plant, lengths, last)
    steps = np.append(lengths, last) if last or not lengths.size else lengths
    balance, A, G, F, W = balanced_flows(plant, steps, bounds)
    known = np.linalg.norm(initial.rows * balance, axis=0)  # what nothing drives shows what the start does to it
    begun = np.divide(1.0, known, out=np.zeros_like(known), where=known > 0)
    moved = W if W.any() else np.diag(begun**2)[None]
    rows, sizes, noise = noise_units(plant.C * balance, bounds, moved, A, G, float(np.mean(steps)))
    shown = [H * np.where(own < 1, EXACT, 1.0)[:, None] for H, own in zip(rows, noise, strict=True)]
    D = _scales(F, W, rows, known, initial.exact, shown)
    (A, F), G, W, rows = (M * D / D[:, None] for M in (A, F)), G / D[:, None], W / np.outer(D, D), [H * D for H in rows]
    D = balance * D
    root = covariance_root(start_covariance(initial, D))
    roots, samples = [], []
    for j, H in enumerate(rows):
        K = np.zeros((len(D), 0))
        if len(H):
            root, K, _ = root_update(largest_first(root), H, np.eye(len(H)))
        roots.append(coordinate_root(root))
        K = np.asarray(np.linalg.solve(roots[j], K))
        samples.append(MeasurementModel(bounds.measured(j), sizes[j], H @ roots[j], noise[j], K))
        if j < len(lengths):
            root = carried(root, F[j], covariance_root(W[j]))
    L = np.array(roots)
    table = GapTable(A, G, np.ones(len(A)))
    gaps = tuple(make_gap(table, float(h), L[j], L[j + 1], F[j]) for j, h in enumerate(lengths))
    start = initial.scaled(D[:, None] * L[0], D, NO_ERROR)
    return SampledSystem(plant, bounds, D, L, A, G, tuple(samples), gaps, start=start, last=last, known=initial.exact)


def coordinate_root(root: Array) -> Array:
    """A root of a covariance for coordinates alone: a little is added, of what has decayed beyond numbers, too."""
    size = np.linalg.norm(root, axis=1)
    least = np.finfo(float).eps * (float(size.max(initial=0.0)) or 1.0)
    made = triangle(np.hstack([root, np.diag(np.maximum(LITTLE * size, least))]))
    return np.asarray(np.where(np.abs(made) > ROUNDED * size[:, None], made, np.diag(np.diag(made))))


def _scales(F: Array, W: Array, rows: list[Array], known: Array, exact: Mask, shown: list[Array]) -> Array:
    """Diagonal D: between what w reaches and what samples see, else what is `known` at the start (0: nothing).

    Of what is known exactly and nothing drives: what others bring into it. Of what is unknown and undriven beside what
    is known: what is `shown`, exact sensors like the rest, since a millionth of that would set states far apart.
    """
    pairs = min(len(F), len(rows))
    D = state_scales(F[:pairs], W[:pairs], rows[:pairs])
    if not known.any():
        return D
    driven = np.any(W != 0, axis=(0, 2))
    size = 1 / np.where(known > 0, known, 1.0)
    D = np.where((known == 0) & ~driven, state_scales(F[:pairs], W[:pairs], shown[:pairs]), D)
    # what a sample shows only after it has decayed is known far better from the start and from w
    D = np.where(known == 0, D, np.where(driven, np.minimum(D, BEYOND * size), size))
    brought = np.abs(F).max(axis=0) @ np.where(exact, 0.0, D)
    return np.where(exact & ~driven & (brought > 0), brought, D)


def start_covariance(initial: InitialSet, D: Array, free: float = DIFFUSE) -> Array:
    """Covariance at the start; `free` where nothing is known."""
    known = initial.rows * D
    information = known.T @ known + np.eye(D.size) / free
    information[initial.exact, initial.exact] += 1 / NO_ERROR
    return np.asarray(np.linalg.inv(information))


class FiniteDirections(LazyDirections):
    """What the samples up to each node determine, with bounds from the filter's gains: these when they are asked for.

    `given` are bounds on |z| after the first samples, where something else bounds all of it there. Raises
    UndecidedError where something free has decayed so far that doubles cannot tell what is left.
    """

    def __init__(self, system: SampledSystem, given: Sequence[Array] = (), integral: Integral = GapDynamics.integral):
        self._system, self._integral, self._bases = system, integral, _bases(system)
        super().__init__(len(system))
        self._found.update((j, BoundedDirections(self._bases[j], reach)) for j, reach in enumerate(given))

    def _bounded(self, at: int) -> BoundedDirections:
        waiting = [at]  # each rests on others, which wait with it: so many that they may not call each other
        while True:
            try:
                found = self._of_path(waiting[-1])
            except KeyError as rest:
                waiting.append(rest.args[0])
                continue
            if len(waiting) == 1:
                return found
            self._found[waiting.pop()] = found

    def _of_path(self, j: int) -> BoundedDirections:
        system, basis, path = self._system, self._bases[j], self._system.nodes(j, len(self))
        assert system.start is not None
        return BoundedDirections(basis, path_bounds(system, path, system.start, self._known, basis, self._integral))

    def _known(self, k: int) -> Array | None:
        """Bounds on |z| after a sample; none of the start, or where it is not all determined. KeyError: not yet."""
        whole = k and self._bases[k].shape[1] == self._system.D.size
        return self._found[k].reach if whole else None


def _bases(system: SampledSystem) -> list[Array]:
    """Orthonormal columns that span what the samples up to each node determine."""
    assert system.start is not None
    free, n = system.start.free(), system.D.size
    observed, found, rows = list[Array](), list[Array](), sum(len(sample.H) for sample in system.samples)
    for_ever = not free.shape[1]  # more rows hide nothing: the largest strength is at most the root of their number
    for j, sample in enumerate(system.samples[: len(system)]):
        if not for_ever:
            free = system.gaps[j - 1].F @ free if j else free
            observed.append(sample.H @ free)
            found.append(_determined(free, observed))
            for_ever = found[j].shape[1] == n and _row_strengths(observed)[-1][0][-1] > UNOBSERVABLE * np.sqrt(rows)
        else:
            found.append(np.eye(n))
    return found


def determined_at(system: SampledSystem, path: list[int]) -> Array:
    """Orthonormal columns that span what the samples of a path from the start determine at its last node."""
    assert system.start is not None
    free = system.start.free()
    if not free.shape[1]:
        return np.eye(len(free))
    observed, free = system.outputs_of(path, free)
    return _determined(free, observed)


def _determined(free: Array, observed: list[Array]) -> Array:
    """Orthonormal columns that span what nothing free and unobservable touches.

    Raises UndecidedError if something free has decayed so far that rounding hides whether it is seen, or where it
    points.
    """
    n = len(free)
    if not free.shape[1]:
        return np.eye(n)
    rows, (sizes, right) = _row_strengths(observed)
    norms = np.linalg.norm(rows, axis=0)
    open_ = sizes <= UNOBSERVABLE * max(1.0, float(sizes[0]))
    # a free start may be as large where it decays fast as anywhere: it is no less seen for what little arrives
    alike = _strengths(rows / np.where(norms > 0, norms, 1.0))[0]
    if np.count_nonzero(alike <= UNOBSERVABLE * max(1.0, float(alike[0]))) < np.count_nonzero(open_):
        raise _faded()
    if not open_.any():
        return np.eye(n)
    unobservable = right[open_].T
    open_ends = free @ unobservable
    length, reach = np.linalg.norm(open_ends, axis=0), [float(np.linalg.norm(free[:, v != 0])) for v in unobservable.T]
    if np.any(length <= BLURRED * np.array(reach)):
        raise _faded()
    left, strength, _ = np.linalg.svd(open_ends / length)
    if strength[-1] <= UNOBSERVABLE * strength[0]:
        raise _faded()
    return np.asarray(left[:, len(strength) :])


def _row_strengths(observed: list[Array]) -> tuple[Array, tuple[Array, Array]]:
    """What samples show, none of it larger than 1, and its strengths."""
    rows = np.vstack(observed)
    rows = rows / np.maximum(1.0, np.linalg.norm(rows, axis=1, keepdims=True))
    return rows, _strengths(rows)


def _strengths(rows: Array) -> tuple[Array, Array]:
    """How much of each direction rows show, and the directions (as rows)."""
    width = rows.shape[1]
    sizes, right = np.zeros(width), np.eye(width)
    if len(rows):
        found, right = right_directions(rows)
        sizes[: found.size] = found
    return sizes, right


def _faded() -> UndecidedError:
    return UndecidedError(
        "undecided: of a start of which nothing is known, something becomes so small beside the rest, before samples "
        "show it or until now, that doubles cannot tell what is left of it. Bound it by `initial_error`."
    )
