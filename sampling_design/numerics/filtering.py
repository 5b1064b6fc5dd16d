"""A filter's covariance over a gap and at a sample, for one or for stacks (..., n, n) that step together.

    Y -> F Y F' + W  over a gap,    Y -> (I - K H) Y (I - K H)' + K K'  at a sample,    K = Y H'(H Y H' + I)^-1

Rows H are in units of their noise (`whitened`). What is found so is in doubles: proofs carry a bound of all rounding
(`checkers`) or are in balls (`certificates/rigorous`).

References
----------
Joseph's form, positive semidefinite whatever the rounding: Bucy and Joseph 1968. Riccati equations by ordered Schur
forms: Laub 1979.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import lapack

from sampling_design.numerics.linalg import SHORT, expm_batch, symmetrise
from sampling_design.records.arrays import Array

EPS = float(np.finfo(float).eps)
BLOCK = 32  # columns that Householder's transformations take together, where there are so many
TINY = float(np.finfo(float).tiny)  # the least variance: any error of a state that is known exactly lies beyond


def propagate(Y: Array, F: Array, W: Array) -> Array:
    """Return F Y F' + W, exactly symmetric: a covariance over a gap, or that of an innovation (F = H, W its noise)."""
    return symmetrise(F @ Y @ F.swapaxes(-1, -2) + W)


def stationary_covariance(A: Array, C: Array, W: Array) -> Array:
    """Return the stabilising Y of A Y + Y A' + W - Y C'C Y = 0: that of a filter of white noise after a long time.

    Raises LinAlgError where there is none that doubles can tell: modes that are not observed, or on the imaginary axis.

    Notes
    -----
    *Method.* The stable invariant subspace [U; V] of the Hamiltonian matrix, from its ordered Schur form after a
    symplectic balancing by powers of two: Y = V U^{-1}. *Numerical aspects.* With unit noise nothing is inverted
    beforehand; the pencil that a library takes for any noise costs twelve times as much.
    """
    n = len(A)
    joint = np.empty((2 * n, 2 * n))
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows has no solution
        joint[:n, :n], joint[:n, n:], joint[n:, :n], joint[n:, n:] = A.T, -C.T @ C, -W, -A
        size = np.abs(joint)
        if not np.isfinite(size.sum()):
            raise np.linalg.LinAlgError("The Hamiltonian matrix leaves double precision.")
        np.fill_diagonal(size, 0.0)
        power = np.log2(lapack.dgebal(size, scale=1, permute=0)[3])
        half = np.exp2(np.rint((power[:n] - power[n:]) / 2))
        scale = np.concatenate([half, 1 / half])
        _, count, _, _, basis, _, trouble = lapack.dgees(
            lambda real, _: real < 0, joint * scale / scale[:, None], sort_t=1
        )
        if trouble or count != n:
            raise np.linalg.LinAlgError("The Hamiltonian matrix has no n modes that decay.")
        Y = np.linalg.solve(basis[:n, :n].T, basis[n:, :n].T) / half[:, None] / half
    if not np.isfinite(Y).all():
        raise np.linalg.LinAlgError("The Hamiltonian matrix leaves double precision.")
    return symmetrise(Y)


def measurement_update(Y: Array, rows: Array) -> Array:
    """Return Y after a sample with whitened rows (..., p, n), in Joseph's form: psd to a few units in the last place.

    The rows' noise is independent, so that they count one after the other: nothing is solved, and outputs of any sizes
    may stand side by side. A row of zeros changes nothing.
    """
    return joint_update(Y, rows)[0]


def update_with_gain(Y: Array, rows: Array) -> tuple[Array, Array]:
    """Return Y after a sample, and the gain K (..., n, p): what an estimate of 0 becomes where the sample reads I."""
    p, n = rows.shape[-2:]
    Y, K = joint_update(Y, rows, np.zeros((n, p)), np.eye(p))
    assert K is not None
    return Y, K


def joint_update(Y: Array, rows: Array, x: Array | None = None, y: Array | None = None) -> tuple[Array, Array | None]:
    """Return Y after a sample, and what becomes of estimates x (..., n, m), where it reads y (p, m), 0 by default.

    With y = 0 that is (I - K H) x, the closed loop.
    """
    for k in range(rows.shape[-2]):
        row = rows[..., k : k + 1, :]
        cross = Y @ row.swapaxes(-1, -2)
        gain = cross / (1 + row @ cross)
        left = Y - gain * cross.swapaxes(-1, -2)  # Joseph's form by two dyads, not by two products
        Y = symmetrise(left - (left @ row.swapaxes(-1, -2) - gain) * gain.swapaxes(-1, -2))
        if x is not None:
            x = x - gain * (row @ x if y is None else row @ x - y[k])
    return Y, x


def whitened(rows: Array, noise: Array) -> Array:
    """Return rows (p, n) in units of their noise (p, p), a covariance: L^-1 rows with L L' = noise."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(noise), rows))


def root_update(root: Array, rows: Array, innovation: Array) -> tuple[Array, Array, Array]:
    """Return a covariance's root (n, m) after a sample, the step of the mean, and the whitened innovation.

    With Y = root root', S = H Y H' + I: the step is Y H' S^-1 innovation, |whitened|^2 = innovation' S^-1 innovation.
    The rows of the root come first, so that a large one (little is known) costs no digits of what is then known.
    """
    p, (n, m) = len(rows), root.shape
    stacked = np.zeros((m + p, p + n), order="F")
    stacked[:m, :p], stacked[:m, p:] = rows.dot(root).T, root.T
    stacked[m:, :p] = np.eye(p)
    R = lapack.dgeqrf(stacked, BLOCK * (p + n), 1)[0]  # below the diagonal are Householder's vectors
    half: Array = lapack.dtrtrs(R[:p, :p], innovation, 0, 1)[0]
    known: Array = R[p : p + n, p:].T
    return known * _triangle(*known.shape), R[:p, p:].T.dot(half), half


def exact_update(root: Array, row: Array) -> Array:
    """Return a root (n, m) of a covariance after a sensor without noise has read one row: of a column less."""
    root = largest_first(root)
    lower = np.asarray(np.linalg.qr(np.column_stack([row @ root, root.T]), mode="r"), dtype=np.float64).T
    return lower[1:, 1:]


@lru_cache(maxsize=64)
def _triangle(n: int, m: int) -> Array:
    return np.tri(n, m)


def covariance_root(Y: Array) -> Array:
    """Return S with S S' = Y: Cholesky's factor, or where rounding has made Y singular, that of its correlations."""
    try:
        return np.asarray(np.linalg.cholesky(Y))
    except np.linalg.LinAlgError:
        return correlation_root(Y)


def correlation_root(Y: Array, rounding: float = 0.0) -> Array:
    """Return S with S S' = Y by the eigenvalues of its correlations, 0 at least.

    To each so much `rounding` is added, times the largest: what rounding may hide of one, so that the set of S only
    grows.
    """
    size = np.sqrt(np.maximum(np.diag(Y), 0.0))
    unit = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(Y / unit[:, None] / unit)
    values = np.maximum(values, 0.0) + rounding * float(values.max(initial=1.0))
    return np.asarray(unit[:, None] * vectors * np.sqrt(values))


def inverse_root(Y: Array) -> Array:
    """Return Z with Z'Z = Y^-1, also of a Y that rounding has made singular: that is known to n eps of the rest."""
    unit = np.sqrt(np.maximum(np.diag(Y), TINY))
    correlations = Y / unit[:, None] / unit
    factor, flag = lapack.dpotrf(correlations, lower=1, clean=1)
    return (floored(correlations) if flag else lapack.dtrtri(factor, lower=1)[0]) / unit


def floored(correlations: Array) -> Array:
    """Return Z with Z'Z their inverse, eigenvalues below n eps of the largest counted as that."""
    values, vectors = np.linalg.eigh(correlations)
    return np.asarray(vectors.T / np.sqrt(np.maximum(values, max(len(values) * EPS * values[-1], TINY)))[:, None])


def inverse_of_root(root: Array) -> Array:
    """Return Z (..., n, n) with Z'Z = (root root')^-1, entry by entry to n eps of what is known of it."""
    unit = np.maximum(np.linalg.norm(root, axis=-1), TINY)
    return np.asarray(inverse_of_unit_rows(root / unit[..., None]) / unit[..., None, :])


def inverse_of_unit_rows(root: Array) -> Array:
    """Return it for a root whose rows have the length 1, or 0; what is known of any direction is n eps or more."""
    turn, sizes, _ = np.linalg.svd(root)
    least = np.maximum(sizes, np.maximum(root.shape[-2] * EPS * sizes[..., :1], TINY))
    return np.asarray(turn.swapaxes(-1, -2) / least[..., None])


def carried(root: Array, F: Array, noise: Array) -> Array:
    """Return a root (..., n, n) of F Y F' + W over a gap, from roots of Y and W."""
    return triangle(np.concatenate([F @ root, noise], axis=-1))


def triangle(root: Array) -> Array:
    """The lower triangle T with T T' = `root` `root`'; the largest columns first, or the small ones would drown."""
    return np.asarray(np.linalg.qr(largest_first(root).swapaxes(-1, -2), mode="r")).swapaxes(-1, -2)


def largest_first(root: Array) -> Array:
    """The same root, its columns in order of size: what is factorised so keeps the digits of the small ones."""
    order = np.argsort(-np.abs(root).max(axis=-2, initial=0.0), axis=-1, kind="stable")
    return np.take_along_axis(root, order[..., None, :], axis=-1)


def noise_roots(A: Array, N: Array, gaps: Array) -> Array:
    """Return roots (gaps, n, n) of W_h = int_0^h e^{As} N N' e^{A's} ds; N (n, q).

    Notes
    -----
    *Method.* Gauss' quadrature over h/2^s, columns side by side, then doubling. *Numerical aspects.* Over a gap that
    grows by e^k, W_h itself holds what does not grow to e^2k eps, a root to e^k eps.
    """
    n, (h, place) = len(A), np.unique(gaps, return_inverse=True)
    doublings = np.maximum(np.ceil(np.log2(np.maximum(h * np.linalg.norm(A, 1) / SHORT, 1e-300))), 0).astype(int)
    step = np.ldexp(h, -doublings)
    points, weights = np.polynomial.legendre.leggauss(n + 4)
    columns = expm_batch(A, np.outer(step, (1 + points) / 2).ravel()).reshape(h.size, points.size, n, n) @ N
    columns *= np.sqrt(np.outer(step, weights) / 2)[:, :, None, None]
    roots = triangle(np.concatenate([*columns.swapaxes(0, 1), np.zeros((h.size, n, n))], axis=-1))
    F = expm_batch(A, step)
    for s in range(int(doublings.max(initial=0))):
        todo = doublings > s
        roots[todo], F[todo] = carried(roots[todo], F[todo], roots[todo]), F[todo] @ F[todo]
    return np.asarray(roots[place])


def information_update(P: Array, G: Array) -> Array:
    """Return P (I + G P)^-1 = root (I + root' G root)^-1 root', the covariance after information G."""
    root = covariance_root(P)
    inner = np.eye(root.shape[1]) + root.T @ G @ root
    return symmetrise(root @ np.linalg.solve(inner, root.T))


@dataclass(frozen=True, eq=False)
class CovarianceMap:
    """P -> Q + F P (I + G P)^-1 F', a sample of information G and a gap, or any number of both.

    Two of them make a third without a difference of covariances (structure-preserving doubling, Chu et al. 2004).
    """

    F: Array
    G: Array
    Q: Array

    def __call__(self, P: Array) -> Array:
        """Return the image of a covariance."""
        return propagate(information_update(P, self.G), self.F, self.Q)

    def then(self, later: CovarianceMap) -> CovarianceMap:
        """Return the map that applies this one first."""
        root = covariance_root(self.Q)
        inner = np.eye(root.shape[1]) + root.T @ later.G @ root
        # (I + Q G)^-1 = I - root inner^-1 root' G
        solved = np.linalg.solve(inner, root.T)
        passed = np.eye(len(self.F)) - root @ solved @ later.G
        mid = later.G - later.G @ root @ solved @ later.G
        Q = propagate(root @ solved, later.F, later.Q)
        return CovarianceMap(later.F @ passed @ self.F, propagate(mid, self.F.T, self.G), Q)

    def repeated(self) -> CovarianceMap:
        """Return the map applied as many times as there are states, or more."""
        several = self
        for _ in range(int(np.ceil(np.log2(len(self.F) + 1)))):
            several = several.then(several)
        return several
