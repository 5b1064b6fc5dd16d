"""The balanced Schur form of a plant, and which of its eigenvalues are one within rounding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack, rsf2csf, schur

from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import balance, balanced
from sampling_design.records.arrays import Array, Complex
from sampling_design.records.kept import kept

CLUSTER_CAP = 1e-2  # a group wider than this times |A| is never one eigenvalue, whatever its sensitivity says
LINK = 8.0  # two groups are joined within this many times the spread of the wider one: on a ring that an error
# makes of m equal eigenvalues, neighbours lie 2 pi times the spread of one apart
SPREAD = 4.0  # factor on the spread that a backward error can cause: constants of the perturbation bounds
DOUBT = 100.0  # a grouping counts as sure if it stays the same with this many times the rounding

SMALLEST_RATE, LARGEST_RATE = 1e-120, 1e120  # of a balanced A: squares and their sums stay numbers


@dataclass(frozen=True, eq=False)
class SchurForm:
    """A = diag(d) Q T Q' diag(d)^-1 with d powers of two, T real quasi-triangular, and T's complex twin.

    `norm` is the Frobenius norm of T, `speed` that without what couples sets of states that drive each other: such
    couplings have no size of their own, since units of the states give them any.
    """

    d: Array
    Q: Array
    T: Array
    complex_T: Complex
    complex_Q: Complex
    eigenvalues: Complex  # exact conjugate pairs, in the order of the diagonal of T
    norm: float
    speed: float


@kept
def balanced_schur(A: Array, C: Array | None = None) -> SchurForm:
    """Return the real Schur form of the balanced A (scaling only, by powers of two, so without rounding).

    C scales states that A leaves free against each other. Raises ArgumentError if rates of A are so large or small that
    their products are no numbers any more.
    """
    d, order, speed = balance(A, C)
    moderate = balanced(A, d)[np.ix_(order, order)]
    largest = float(np.max(np.abs(moderate), initial=0.0))
    if largest and not SMALLEST_RATE < largest < LARGEST_RATE:
        raise ArgumentError(
            f"`A` must have rates between {SMALLEST_RATE:g} and {LARGEST_RATE:g} per unit of time, got {largest:.3g} "
            "after balancing. Give the plant in another unit of time."
        )
    # the oldest scipy refuses what has no rows
    T, Q = schur(moderate, output="real") if moderate.size else (moderate, moderate)
    complex_T, complex_Q = rsf2csf(T, Q)
    values = np.array(np.diag(T), dtype=complex)
    for i in np.flatnonzero(np.diag(T, -1)):
        a, b, c, e = T[i, i], T[i, i + 1], T[i + 1, i], T[i + 1, i + 1]
        pair = np.sqrt(complex(((a - e) / 2) ** 2 + b * c))
        values[i], values[i + 1] = (a + e) / 2 + pair, (a + e) / 2 - pair
    back = np.argsort(order)
    norm = float(np.linalg.norm(moderate))
    return SchurForm(d, Q[back], T, complex_T, complex_Q[back], values, norm, speed)


def _projector_norm(form: SchurForm, group: Sequence[int]) -> tuple[float, Complex]:
    """Norm of the spectral projector of some positions on the diagonal, and their block after reordering."""
    n, m = form.eigenvalues.size, len(group)
    select = np.zeros(n, dtype=np.int32)
    select[list(group)] = 1
    result = lapack.ztrsen(select, form.complex_T, form.complex_Q, job="E", wantq=0, lwork=max(1, n * n))
    return (1.0 / result[4] if result[4] > 0 else np.inf), result[0][:m, :m]


def invariant_subspace(form: SchurForm, group: Sequence[int]) -> tuple[Complex, Complex]:
    """Return X (n, m), orthonormal in balanced coordinates, and the triangular T (m, m) with B X = X T.

    B is the balanced A, and the eigenvalues of T are those at the positions `group` of the diagonal.
    """
    n, m = form.eigenvalues.size, len(group)
    select = np.zeros(n, dtype=np.int32)
    select[list(group)] = 1
    T, X = lapack.ztrsen(select, form.complex_T, form.complex_Q, job="N", wantq=1, lwork=max(1, n * n))[:2]
    return X[:, :m], T[:m, :m]


def group_eigenvalues(form: SchurForm, error: float, cap: float) -> list[list[int]]:
    """Groups of positions that rounding cannot tell apart, alike for conjugates."""
    values = form.eigenvalues
    trees: dict[int, _GroupTree] = {k: _leaf(form, [k], error) for k in range(values.size)}
    home = list(range(values.size))
    for i, j, length in _spanning_tree(values):
        a, b = home[i], home[j]
        if length > LINK * max(trees[a].spread, trees[b].spread):
            continue
        trees[a] = _leaf(form, sorted(trees[a].group + trees[b].group), error, (trees[a], trees[b]))
        del trees[b]
        home = [a if h == b else h for h in home]
    accepted = []
    todo = list(trees.values())
    while todo:
        tree = todo.pop()
        width = min(SPREAD * error ** (1 / len(tree.group)), cap) * form.norm
        if tree.parts and radius(values[tree.group]) > width:
            todo.extend(tree.parts)
        else:
            accepted.append(tree.group)
    return _mirrored(form, accepted)


@dataclass(frozen=True, eq=False)
class _GroupTree:
    """Some positions, how far rounding may move or scatter them, and the two groups they were joined from."""

    group: list[int]
    spread: float
    parts: tuple[_GroupTree, ...]


def _leaf(form: SchurForm, group: list[int], error: float, parts: tuple[_GroupTree, ...] = ()) -> _GroupTree:
    spread = error * form.norm * _projector_norm(form, group)[0] + radius(form.eigenvalues[group])
    return _GroupTree(group, spread, parts)


def radius(values: Complex) -> float:
    """Largest distance from the mean."""
    return float(np.max(np.abs(values - np.mean(values))))


def _spanning_tree(values: Complex) -> list[tuple[int, int, float]]:
    """Edges (i, j, length) of the minimal spanning tree of points in the plane, shortest first (Prim).

    Equal points are joined by edges of length 0, which a sparse graph of scipy takes for none.
    """
    distance = np.abs(values[:, None] - values[None, :])
    reach, origin = distance[0].copy(), np.zeros(values.size, dtype=int)
    outside = np.arange(values.size) > 0
    edges = []
    while outside.any():
        nearest = int(np.argmin(np.where(outside, reach, np.inf)))
        edges.append((int(origin[nearest]), nearest, float(reach[nearest])))
        outside[nearest] = False
        closer = distance[nearest] < reach
        reach[closer], origin[closer] = distance[nearest][closer], nearest
    return sorted(edges, key=lambda edge: edge[2])


def _mirrored(form: SchurForm, groups: list[list[int]]) -> list[list[int]]:
    """Join groups until the conjugate of each group is a group."""
    partner = np.arange(form.eigenvalues.size)
    for pair in np.flatnonzero(np.diag(form.T, -1)):
        partner[pair], partner[pair + 1] = pair + 1, pair
    label = np.empty(partner.size, dtype=int)
    for k, group in enumerate(groups):
        label[group] = k
    while True:
        for group in groups:
            images = np.unique(label[partner[group]])
            label[np.isin(label, images)] = images[0]
        joined = [[int(i) for i in np.flatnonzero(label == k)] for k in np.unique(label)]
        if len(joined) == len(groups):
            return sorted(joined)
        groups = joined


def block_index(form: SchurForm, group: list[int], error: float) -> tuple[int, float, float]:
    """Index of a group from the powers of its own block, its projector's norm, and the coupling that may be hidden."""
    m = len(group)
    projector, block = _projector_norm(form, group)
    nilpotent = block - np.trace(block) / m * np.eye(m)
    power = np.eye(m)
    sizes = [1.0]  # norms of the powers so far
    for k in range(1, m):
        power = power @ nilpotent
        first_order = float(np.dot(sizes, sizes[::-1]))
        sizes.append(float(np.linalg.norm(power)))
        tolerance = SPREAD * error * form.norm * projector * first_order
        if sizes[k] <= tolerance:
            return k, projector, tolerance ** (1 / k)
    return m, projector, 0.0
