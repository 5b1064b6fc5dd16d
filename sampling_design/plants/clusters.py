"""Eigenvalues that rounding cannot tell apart, grouped, with the index of each group, and the balanced Schur form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack, rsf2csf, schur

from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import balance, balanced
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Complex
from sampling_design.records.kept import kept
from sampling_design.records.record import Record
from sampling_design.records.signatures import checked

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


@dataclass(frozen=True, eq=False, repr=False)
class EigenvalueCluster(Record):
    """Eigenvalues that are one within rounding.

    Attributes
    ----------
    value : complex
        Mean of the group.
    multiplicity : int
        How many computed eigenvalues it holds.
    index : int
        Size of the largest Jordan block (degree of the factor in the minimal polynomial).
    radius : float
        Largest distance of a computed eigenvalue from the mean.
    projector_norm : float
        2-norm of the spectral projector in balanced coordinates (an upper bound of LAPACK).
    uncertainty : float
        How well the mean is known: `rounding` |A| times `projector_norm`.
    sure : bool
        Whether grouping and index stay the same if the rounding is `DOUBT` times larger. If not, take
        the sum of indices with care: the truth may be larger or smaller.
    members : (multiplicity,) complex array
        The computed eigenvalues.
    """

    value: complex
    multiplicity: int
    index: int
    radius: float
    projector_norm: float
    uncertainty: float
    sure: bool
    members: Complex

    _table = {
        "value": "{label}",
        "multiplicity": "{multiplicity}",
        "index": "{index}",
        "sure": "{sure}",
        "radius": "{radius:3}",
        "uncertainty": "{uncertainty:3}",
    }

    def label(self) -> str:
        """Return the value as text; a part below its uncertainty is written as zero."""
        return format_eigenvalue(self.value, grain=self.uncertainty)

    def explain(self) -> str:
        """Say what the group is, in words."""
        doubt = "" if self.sure else " Rounding leaves the grouping or the index in doubt."
        blocks = "semisimple" if self.index == 1 else f"largest Jordan block of size {self.index}"
        return f"Eigenvalue {self.label()}, {self.multiplicity}-fold, {blocks}.{doubt}"


def format_eigenvalue(value: complex, digits: int = 6, grain: float = 0.0) -> str:
    """Return a complex number as text; parts of at most `grain` count as zero, a zero imaginary part is left out."""
    real, imaginary = (0.0 if abs(part) <= grain else part for part in (complex(value).real, complex(value).imag))
    return f"{real:.{digits}g}" if imaginary == 0 else f"{real:.{digits}g}{imaginary:+.{digits}g}i"


@checked
def eigenvalue_clusters(
    A: npt.ArrayLike, *, rounding: float | None = None, cap: float = CLUSTER_CAP
) -> tuple[EigenvalueCluster, ...]:
    """Group the eigenvalues of A that rounding cannot tell apart, and find the index of each group.

    Parameters
    ----------
    A : (n, n) array
    rounding : float, optional
        Relative backward error e of A. Default n eps. Give more if the entries of A are less exact.
    cap : float
        Widest group, as a fraction of |A|. Default 1e-2.

    Returns
    -------
    tuple of EigenvalueCluster
        Sorted by real part (largest first), then by imaginary part. Multiplicities add up to n.

    Raises
    ------
    ArgumentError
        If A is not square, real and finite, or a tolerance is not positive.

    Notes
    -----
    *Method.* A is balanced by powers of two and brought to Schur form; |A| is the Frobenius norm of the
    balanced matrix. Along the minimal spanning tree, shortest edge first, two groups are joined if the
    edge is at most 8 times the spread of the wider one: its radius plus e |A| |P|, P its spectral
    projector, which is how far an error e |A| moves it. So distinct eigenvalues that are well conditioned
    stay apart however close they are, and the ring that rounding makes of a Jordan block comes together.
    A group of m wider than min(4 e^{1/m}, cap) |A| (what the error does to a Jordan block of size m) is
    taken apart again; conjugates are grouped alike. The index is the least k for which
    (T_11 - mean I)^k has rank zero, T_11 the group's own triangular block after reordering, with
    tolerance 4 k e |A| |P| |T_11 - mean I|^{k-1}.

    *Numerical aspects.* Where a group holds distinct eigenvalues, powers do not vanish and the index
    becomes the multiplicity, so that the sum of indices errs to the safe side (more samples). `sure`
    says whether a hundredfold rounding would change the grouping or the index.

    References
    ----------
    The paper, Section V (index r_i of an eigenvalue); theory: Golub and Van Loan, Matrix Computations
    (Schur reordering, condition of eigenvalues).

    Examples
    --------
    >>> for cluster in eigenvalue_clusters([[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 2], [0, 0, -2, 0]]):
    ...     print(cluster.explain())
    Eigenvalue 0, 2-fold, largest Jordan block of size 2.
    Eigenvalue 0+2i, 1-fold, semisimple.
    Eigenvalue 0-2i, 1-fold, semisimple.
    """
    matrix = checks.matrix("A", A)
    n = matrix.shape[0]
    matrix = checks.matrix("A", matrix, n, n)
    error = n * np.finfo(float).eps if rounding is None else checks.positive("rounding", rounding)
    if n == 0:
        return ()
    return clusters_of(balanced_schur(matrix), error, checks.positive("cap", cap))[0]


def clusters_of(form: SchurForm, error: float, cap: float) -> tuple[tuple[EigenvalueCluster, ...], list[list[int]]]:
    """Return the clusters of a Schur form, and for each the positions of its members on the diagonal."""
    groups = group_eigenvalues(form, error, cap)
    wider = {tuple(g): block_index(form, g, DOUBT * error)[0] for g in group_eigenvalues(form, DOUBT * error, cap)}
    # couplings that rounding may hide are compared with the plant's own rates; with |A| if all of these are zero
    fastest = max(abs(_mean(form.eigenvalues[g])) for g in groups)
    scale = fastest if fastest > DOUBT * error * form.norm else form.norm
    found = []
    for group in groups:
        members = form.eigenvalues[group]
        index, projector, hidden = block_index(form, group, error)
        sure = wider.get(tuple(group)) == index and hidden <= scale / 10
        members.flags.writeable = False
        doubt = float(error * form.speed * projector)
        found.append(
            EigenvalueCluster(_mean(members), len(group), index, radius(members), projector, doubt, sure, members)
        )
    # noise in a real part must not decide the order
    grain = max(form.norm, np.finfo(float).tiny) * 1e-9
    keys = [(-round(v.real / grain), abs(v.imag), v.imag < 0) for v in (each.value for each in found)]
    order = sorted(range(len(found)), key=keys.__getitem__)
    return tuple(found[i] for i in order), [groups[i] for i in order]


def fastest_rate(A: Array) -> float:
    """Return the largest |eigenvalue|; 0 of integrators alone, whatever rounding leaves of theirs in mixed states."""
    clusters = eigenvalue_clusters(A)
    return max((abs(each.value) for each in clusters if abs(each.value) > each.uncertainty), default=0.0)


def _mean(values: Complex) -> complex:
    """Mean of a group; exactly real if the group is its own mirror."""
    mean = complex(np.mean(values))
    own_mirror = np.array_equal(np.sort_complex(values), np.sort_complex(values.conj()))
    return complex(mean.real, 0.0) if own_mirror else mean
