"""Eigenvalues that rounding cannot tell apart, grouped, with the index of each group."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack, matrix_balance, rsf2csf, schur

from sampling_design import _checks
from sampling_design._record import Record, short

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

CLUSTER_CAP = 1e-2  # a group wider than this times |A| is never one eigenvalue, whatever its sensitivity says
SPREAD = 4.0  # factor on the spread that a backward error can cause: constants of the perturbation bounds
DOUBT = 100.0  # a grouping counts as sure if it stays the same with this many times the rounding


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

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("value", self.label()),
            ("multiplicity", str(self.multiplicity)),
            ("index", str(self.index)),
            ("sure", "yes" if self.sure else "no"),
            ("radius", short(self.radius, 3)),
            ("uncertainty", short(self.uncertainty, 3)),
        ]

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


@dataclass(frozen=True, eq=False)
class SchurForm:
    """A = diag(d) Q T Q' diag(d)^-1 with d powers of two, T real quasi-triangular, and T's complex twin."""

    d: Array
    Q: Array
    T: Array
    complex_T: Complex
    complex_Q: Complex
    eigenvalues: Complex  # exact conjugate pairs, in the order of the diagonal of T
    norm: float = field(default=0.0)  # Frobenius norm of the balanced matrix


def balanced_schur(A: Array) -> SchurForm:
    """Return the real Schur form of the balanced A (scaling only, by powers of two, so without rounding)."""
    balanced, (d, _) = matrix_balance(A, permute=False, separate=True)
    T, Q = schur(balanced, output="real")
    complex_T, complex_Q = rsf2csf(T, Q)
    values = np.array(np.diag(T), dtype=complex)
    for i in np.flatnonzero(np.diag(T, -1)):
        a, b, c, e = T[i, i], T[i, i + 1], T[i + 1, i], T[i + 1, i + 1]
        pair = np.sqrt(complex(((a - e) / 2) ** 2 + b * c))
        values[i], values[i + 1] = (a + e) / 2 + pair, (a + e) / 2 - pair
    scale = np.asarray(d, dtype=np.float64)
    return SchurForm(scale, Q, T, complex_T, complex_Q, values, float(np.linalg.norm(balanced)))


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
    balanced matrix. m eigenvalues are one group if their distance from their mean is at most
    min(4 e^{1/m}, cap) |A| (what an error e |A| does to a Jordan block of size m) *and* at most
    4 m e |A| / s with s the least condition number among them: distinct eigenvalues that are well
    conditioned stay apart however close they are. Single linkage gives the candidates, from wide to
    narrow; conjugates are grouped alike. The index is the least k for which (T_11 - mean I)^k has rank
    zero, T_11 the group's own triangular block after reordering, with tolerance
    4 k e |A| |P| |T_11 - mean I|^{k-1}, |P| the norm of the spectral projector.

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
    matrix = _checks.matrix("A", A)
    n = matrix.shape[0]
    matrix = _checks.matrix("A", matrix, n, n)
    error = n * np.finfo(float).eps if rounding is None else _checks.positive("rounding", rounding)
    if n == 0:
        return ()
    return clusters_of(balanced_schur(matrix), error, _checks.positive("cap", cap))[0]


def clusters_of(form: SchurForm, error: float, cap: float) -> tuple[tuple[EigenvalueCluster, ...], list[Any]]:
    """Return the clusters of a Schur form, and for each the positions of its members on the diagonal."""
    sensitivity = _sensitivities(form)
    groups = _groups(form, sensitivity, error, cap)
    wider = {tuple(g): _index(form, g, DOUBT * error)[0] for g in _groups(form, sensitivity, DOUBT * error, cap)}
    found = []
    for group in groups:
        members = form.eigenvalues[group]
        index, projector = _index(form, group, error)
        sure = wider.get(tuple(group)) == index
        radius = float(np.max(np.abs(members - _mean(members))))
        members.flags.writeable = False
        doubt = error * form.norm * projector
        found.append(EigenvalueCluster(_mean(members), len(group), index, radius, projector, doubt, sure, members))
    # noise in a real part must not decide the order
    grain = max(form.norm, np.finfo(float).tiny) * 1e-9
    order = sorted(range(len(found)), key=lambda i: (-round(found[i].value.real / grain), _imaginary(found[i].value)))
    return tuple(found[i] for i in order), [groups[i] for i in order]


def _imaginary(value: complex) -> tuple[float, bool]:
    return abs(value.imag), value.imag < 0


def _mean(values: Complex) -> complex:
    """Mean of a group; exactly real if the group is its own mirror."""
    mean = complex(np.mean(values))
    own_mirror = np.array_equal(np.sort_complex(values), np.sort_complex(values.conj()))
    return complex(mean.real, 0.0) if own_mirror else mean


def _sensitivities(form: SchurForm) -> Array:
    """Condition number 1/s of each eigenvalue (inf where it is defective in exact arithmetic), alike for conjugates."""
    n = form.eigenvalues.size
    result = np.empty(n)
    for i in range(n):
        select = np.zeros(n, dtype=np.int32)
        select[i] = 1
        s = lapack.ztrsen(select, form.complex_T, form.complex_Q, job="E", wantq=0, lwork=max(1, n * n))[5]
        result[i] = 1.0 / s if s > 0 else np.inf
    for pair in np.flatnonzero(np.diag(form.T, -1)):
        result[pair : pair + 2] = np.max(result[pair : pair + 2])
    return result


def _groups(form: SchurForm, sensitivity: Array, error: float, cap: float) -> list[npt.NDArray[np.intp]]:
    """Groups of positions, split from wide to narrow until each is one eigenvalue within rounding."""
    distance = np.abs(form.eigenvalues[:, None] - form.eigenvalues[None, :])
    todo = [np.arange(form.eigenvalues.size)]
    done = []
    while todo:
        group = todo.pop()
        if group.size == 1 or _is_one(form, group, sensitivity, error, cap):
            done.append(group)
            continue
        inside = distance[np.ix_(group, group)]
        labels = _components(inside, _widest_link(inside))
        todo.extend(group[labels == k] for k in range(labels.max() + 1))
    return sorted(done, key=lambda g: int(g[0]))


def _is_one(form: SchurForm, group: npt.NDArray[np.intp], sensitivity: Array, error: float, cap: float) -> bool:
    members = form.eigenvalues[group]
    radius = float(np.max(np.abs(members - np.mean(members))))
    by_size = min(SPREAD * error ** (1 / group.size), cap) * form.norm
    by_condition = SPREAD * group.size * error * form.norm * float(np.max(sensitivity[group]))
    return radius <= min(by_size, by_condition)


def _widest_link(distance: Array) -> float:
    """Length of the longest edge of the minimal spanning tree (Prim)."""
    reach = distance[0].copy()
    reach[0] = np.inf
    inside = np.zeros(reach.size, dtype=bool)
    inside[0] = True
    widest = 0.0
    for _ in range(reach.size - 1):
        nearest = int(np.argmin(np.where(inside, np.inf, reach)))
        widest = max(widest, float(reach[nearest]))
        inside[nearest] = True
        reach = np.minimum(reach, distance[nearest])
    return widest


def _components(distance: Array, below: float) -> npt.NDArray[np.intp]:
    """Label the connected components of the graph of distances strictly less than `below`."""
    labels = np.full(distance.shape[0], -1)
    for start in range(len(labels)):
        if labels[start] >= 0:
            continue
        label = int(labels.max()) + 1
        front = [int(start)]
        while front:
            i = front.pop()
            if labels[i] < 0:
                labels[i] = label
                front.extend(int(j) for j in np.flatnonzero((distance[i] < below) & (labels < 0)))
    return labels


def _index(form: SchurForm, group: npt.NDArray[np.intp], error: float) -> tuple[int, float]:
    """Index of a group from the powers of its own block, and the norm of its spectral projector."""
    n, m = form.eigenvalues.size, group.size
    select = np.zeros(n, dtype=np.int32)
    select[group] = 1
    T, _, _, _, s, _, _ = lapack.ztrsen(select, form.complex_T, form.complex_Q, job="E", wantq=0, lwork=max(1, n * n))[
        :7
    ]
    projector = 1.0 / s if s > 0 else np.inf
    block = T[:m, :m]
    nilpotent = block - np.trace(block) / m * np.eye(m)
    size = float(np.linalg.norm(nilpotent))
    power = np.eye(m)
    for k in range(1, m):
        power = power @ nilpotent
        tolerance = SPREAD * k * error * form.norm * projector * size ** (k - 1)
        if np.linalg.norm(power) <= tolerance:
            return k, projector
    return m, projector
