"""What no sample of a schedule ever shows and what does not decay: rows that it touches can never be known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise

import numpy as np

from sampling_design.numerics.linalg import expm_batch, right_directions
from sampling_design.plants.clusters import balanced_schur, eigenvalue_clusters, format_eigenvalue
from sampling_design.plants.plant import Plant, Signals, replace_matrices
from sampling_design.records.arrays import Array, Complex, Index

DECAYS = 1e-9  # a mode counts as decaying if it loses more than this share over a period
ALIAS = 1e-7  # two modes look alike at the samples if e^{(mu - nu) period} is 1 within this
UNOBSERVABLE = 1e-9  # a direction counts so if its samples are below this share of what the strongest one shows

HIDDEN = 1e-11
"""A direction of a free start is hidden if rows, each of length one, show less than this of it: what rounding makes of
a mode that no output sees. An end that is infinite for it is no false claim."""

DECAYED = 1e-8
"""Share of |A|, balanced, by which a mode must decay at least to leave nothing where nothing drives it: the line
between stable modes and others (`plants/modes.py`)."""

GROWN = 200.0  # logarithm of the growth up to which outputs are looked at: what grows more says nothing more of sizes
GOLDEN = 1.618  # exponent that spreads times so that no mode is missed by its period
ROUNDED = 1e-12  # an entry of orthonormal columns below this is none
TOUCHED = 1e-9  # a row counts as free of the unknown part if it is below this share of the row, in balanced coordinates


@dataclass(frozen=True, eq=False)
class DetectablePart:
    """The plant without its unknown part: x = lift z + unknown."""

    plant: Plant  # the plant itself where nothing is unknown
    # (n, r): x = lift z + unknown part, once what nothing drives has decayed: a row of x that the unknown part does not
    # touch is row lift of z
    lift: Array
    unknown: Array  # (n, n - r): what spans the unknown part
    modes: tuple[str, ...]  # its eigenvalues, in words
    # (n, m): what no sample shows, as it is at the first one, where that moves on (the samples come at a period of a
    # mode that the outputs see at other times): `plant` is then whole, and `unknown` all that it passes through
    moving: Array | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it has all states, each in its place."""
        return self.lift.shape[0] == self.lift.shape[1] == self.plant.n_states and not self.unknown.size

    def touches(self, row: Array) -> bool:
        """Whether the unknown part changes row'x."""
        norms = np.abs(row @ self.unknown)
        return bool(np.any(norms > TOUCHED * (np.abs(row) @ np.abs(self.unknown))))

    def at_rest(self, row: Array) -> float:
        """What is left of row'x where no search says: nothing if the rest has decayed, else anything."""
        return np.inf if self.plant.n_states or self.touches(row) else 0.0


def known_part(plant: Plant, times: Array, period: float, outputs: list[Index]) -> DetectablePart:
    """Return what an endless schedule lets anybody know of a plant."""
    everything = DetectablePart(plant, np.eye(plant.n_states), np.zeros((plant.n_states, 0)), ())
    if not plant.n_states:
        return everything
    d = output_scales(plant, period)
    A, C = plant.A * d / d[:, None], plant.C * d
    size = np.linalg.norm(C, axis=1, keepdims=True)
    C = C / np.where(size > 0, size, 1.0)
    found = []
    values = [complex(c.value) for c in eigenvalue_clusters(plant.A)]
    for group in _alike(values, period):
        if group[0].real * period < -DECAYS:
            continue
        X = _invariant(A, group, values)
        hidden = _hidden(A, C, X, group[0], times, period, outputs)
        if hidden.shape[1]:
            found.append(X @ hidden)
    if not found:
        return everything
    joined = np.hstack(found)
    real = np.hstack([joined.real, joined.imag])
    left, sizes, _ = np.linalg.svd(real, full_matrices=True)
    rank = int(np.sum(sizes > 1e-7 * sizes[0]))
    U, N = _cleaned(left[:, :rank]), left[:, rank:]
    if np.linalg.norm(N.T @ A @ U) > 1e-7 * np.linalg.norm(A):
        passed = d[:, None] * _cleaned(_invariant_hull(A, U))
        return DetectablePart(
            plant, np.eye(plant.n_states), passed, open_modes(plant.A, d[:, None] * U), d[:, None] * U
        )
    names = Signals([f"known{i + 1}" for i in range(N.shape[1])])
    reduced = replace_matrices(plant, _product(N.T, A, N), _product(plant.C * d, N), N.T / d, names)
    return DetectablePart(reduced, d[:, None] * N, d[:, None] * U, open_modes(plant.A, d[:, None] * U))


def lasting_part(plant: Plant, period: float, noise: Array | None = None) -> DetectablePart | None:
    """Return what an endless past leaves of a plant whose samples show what does not decay; None if that is all of it.

    Where nothing drives it, what does not decay. Where white `noise` (n, k) does, the states that it reaches and what
    grows by itself: of all else information grows without bound.
    """
    d = output_scales(plant, period)
    A = plant.A * d / d[:, None]
    values, size = [complex(cluster.value) for cluster in eigenvalue_clusters(plant.A)], float(np.linalg.norm(A, 2))
    least = max(DECAYS / period, DECAYED * size)
    driven = np.zeros((len(A), 0)) if noise is None else noise / d[:, None]
    linked = np.linalg.matrix_power((A.T != 0) | np.eye(len(A), dtype=bool), len(A))
    gone, growing = [np.zeros((len(A), 0))], [np.zeros((len(A), 0))]
    for value in values:
        if noise is not None or value.real < -least:
            left = _invariant(A.T, [value], values)
            step = (left.conj().T @ A.T @ left - value * np.eye(left.shape[1])) / (size or 1.0)
            near = driven * np.any(linked[:, np.any(left, axis=1)], axis=1, keepdims=True)  # sizes of no others matter
            rows = [(near / np.where(near.any(axis=0), np.linalg.norm(near, axis=0), 1.0)).T @ left]
            for _ in range(left.shape[1] - 1):
                rows.append(rows[-1] @ step)
            sizes, right = right_directions(np.vstack(rows))
            unreached = left @ right[np.count_nonzero(sizes > UNOBSERVABLE) :].conj().T
            (growing if value.real > least else gone).extend([unreached.real, unreached.imag])
    across, rank = _spanned(np.hstack(gone))
    if not rank and not any(each.size for each in growing):
        return None
    above, many = _spanned(across[:, rank:].T @ np.hstack(growing))
    U = _cleaned(across[:, rank:] @ above)  # what grows and no noise reaches, then what it reaches
    names = Signals([f"lasting{i + 1}" for i in range(U.shape[1])])
    reduced = replace_matrices(plant, _product(U.T, A, U), _product(plant.C * d, U), U.T / d, names)
    A, G = reduced.A.copy(), reduced.G.copy()
    A[:many, many:] = G[:many] = 0.0
    return DetectablePart(replace(reduced, A=A, G=G), d[:, None] * U, np.zeros((plant.n_states, 0)), ())


def _spanned(X: Array) -> tuple[Array, int]:
    """Orthonormal columns, of which the first so many span the columns of X, of size one or nothing."""
    left, sizes, _ = np.linalg.svd(X)
    return np.asarray(left), int(np.count_nonzero(sizes > UNOBSERVABLE))


def _cleaned(U: Array) -> Array:
    """Orthonormal columns without entries that are rounding."""
    return np.where(np.abs(U) > ROUNDED, U, 0.0)


def _product(*factors: Array) -> Array:
    """Their product without entries that are rounding of its terms, which alone would have no size to be judged by."""
    found, terms = reduce(np.matmul, factors), reduce(np.matmul, map(np.abs, factors))
    return np.asarray(np.where(np.abs(found) > ROUNDED * terms, found, 0.0))


def _invariant_hull(A: Array, U: Array) -> Array:
    """Orthonormal columns that span the least invariant subspace of A with the columns of U in it."""
    size = max(float(np.linalg.norm(A, 2)), np.finfo(float).tiny)
    for _ in range(len(A)):
        left, sizes, _ = np.linalg.svd(np.hstack([U, A @ U / size]), full_matrices=False)
        wider = left[:, sizes > 1e-7 * sizes[0]]
        if wider.shape[1] == U.shape[1]:
            break
        U = wider
    return U


def open_modes(A: Array, U: Array) -> tuple[str, ...]:
    """Return the eigenvalues of A, in words, of which the columns of U have a share."""
    d = balanced_schur(A).d
    A, U = A * d / d[:, None], U / d[:, None]
    U = U / np.linalg.norm(U, axis=0)
    values = [complex(cluster.value) for cluster in eigenvalue_clusters(A)]
    found = []
    for value in values:
        left = _invariant(A.T, [value], values)
        if np.linalg.norm(left.T @ U) > UNOBSERVABLE:
            found.append(format_eigenvalue(value))
    return tuple(found)


def output_scales(plant: Plant, period: float) -> Array:
    """One over what the outputs show of each state over as many periods as there are states: units play no part.

    At any time, since what the samples alone hide must not look small; without the growth of the fastest mode, beside
    which others would.
    """
    balance = balanced_schur(plant.A).d
    rate = float(np.max(np.linalg.eigvals(plant.A).real, initial=0.0))
    span = min(period * plant.n_states, GROWN / rate if rate > 0 else np.inf)
    times = span * (np.arange(8 * plant.n_states + 1) / (8 * plant.n_states)) ** GOLDEN
    C = plant.C * balance
    for order in (np.inf, 2):  # squares of what is left have no units to overflow in
        sizes = np.linalg.norm(C, ord=order, axis=1, keepdims=True)
        C = C / np.where(sizes > 0, sizes, 1.0)
    outputs_at = C @ expm_batch(plant.A * balance / balance[:, None] - rate * np.eye(plant.n_states), times)
    norms = np.linalg.norm(outputs_at.reshape(-1, plant.n_states), axis=0)
    return np.asarray(balance / np.where((norms > 0) & np.isfinite(norms), norms, 1.0))


def _alike(values: list[complex], period: float) -> list[list[complex]]:
    """Eigenvalues that no sample of a periodic schedule can tell apart."""
    groups: list[list[complex]] = []
    for value in values:
        for group in groups:
            near = (value - group[0]) * period
            if abs(near.real) < ALIAS and abs(np.exp(1j * near.imag) - 1) < ALIAS:
                group.append(value)
                break
        else:
            groups.append([value])
    return groups


def _invariant(A: Array, group: list[complex], others: list[complex]) -> Complex:
    """Orthonormal basis of the invariant subspace of some eigenvalues."""
    from scipy.linalg import schur

    def chosen(z: complex) -> bool:
        return min(others, key=lambda value: abs(z - value)) in group

    _, Z, count = schur(A, output="complex", sort=chosen)
    return np.asarray(Z[:, :count], dtype=np.complex128)


def _hidden(
    A: Array, C: Array, X: Complex, value: complex, times: Array, period: float, outputs: list[Index]
) -> Complex:
    """Combinations of the columns of X that no sample shows."""
    within = X.conj().T @ A @ X - value.real * np.eye(X.shape[1])  # of X alone, its growth taken out: never overflows
    flows = expm_batch(within, np.append(times - times[0], period))  # type: ignore[arg-type]  # complex, as it takes too
    cycle = np.vstack([C[outputs_at] @ X @ flow for outputs_at, flow in zip(outputs, flows[:-1], strict=True)])
    M = flows[-1]
    rows = [cycle]
    for _ in range(X.shape[1] - 1):
        rows.append(rows[-1] @ M)
    sizes, right = right_directions(np.vstack(rows))
    sizes = np.pad(sizes, (0, X.shape[1] - sizes.size)) if sizes.size < X.shape[1] else sizes
    return np.asarray(right.conj().T[:, sizes < UNOBSERVABLE * max(1.0, float(sizes[0]))], dtype=np.complex128)


def rows_of_start(H: Array, F: Array, offsets: Index, flow: Array) -> Array:
    """What rows H (R, n), read at the ends of gaps F (K-1, n, n), say of the start, in the columns of `flow`."""
    found = []
    with np.errstate(over="ignore", invalid="ignore"):  # who asks looks whether it is finite
        for k, (a, b) in enumerate(pairwise(offsets.tolist())):
            flow = F[k - 1] @ flow if k else flow
            found.append(H[a:b] @ flow)
    return np.vstack(found) if found else np.zeros((0, flow.shape[1]))


def unobservable_directions(H: Array) -> Array:
    """Directions (n, m) of the start that no row (R, n) shows; none where they grow beyond all numbers."""
    size = np.linalg.norm(H, axis=1)
    if not np.isfinite(size).all():
        return np.zeros((H.shape[1], 0))
    values, right = right_directions(H[size > 0] / size[size > 0, None])
    return np.asarray(right[np.count_nonzero(values > HIDDEN) :].T)


OTHER_STATES = (
    "Where states nearly depend on each other, give the plant in other states z, x = T z, and ask for x by `of=T`."
)
"""What helps where rounding in the coordinates of a plant hides what its outputs show."""


def modes_with(eigenvalues: tuple[str, ...]) -> str:
    """Return "the mode with eigenvalue 0.1", "the modes with eigenvalues 0+1i, 0-1i"."""
    what = "the mode with eigenvalue" if len(eigenvalues) == 1 else "the modes with eigenvalues"
    return f"{what} {', '.join(eigenvalues)}"
