"""Eigenvalues that rounding cannot tell apart, grouped, with the index of each group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design.plants.grouping import (
    CLUSTER_CAP,
    DOUBT,
    SchurForm,
    balanced_schur,
    block_index,
    group_eigenvalues,
    radius,
)
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Complex
from sampling_design.records.record import Record
from sampling_design.records.signatures import checked


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
