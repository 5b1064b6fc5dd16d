"""The critical length: below it any n distinct times determine the state of a single-output plant."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import expm_batch
from sampling_design.errors import ArgumentError
from sampling_design.observability.pbh import require_observable, spectrum
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

LARGEST_ORDER = 12  # the k-th compound has C(n, k) rows: 924 at n = 12, k = 6
STEPS_PER_RADIAN = 12  # samples of a minor per radian of its fastest oscillation, so that no extremum is missed
TOUCH = 1e-9  # a least |minor| below this fraction of the compound's column counts as a zero that touches


def critical_length(plant: Plant | npt.ArrayLike) -> float:
    """Return h such that any n distinct times in a closed window shorter than h determine the state.

        h = min { t > 0 : W_k(t) = 0 for some k = 1, ..., n-1 },
        W_k = top-right k x k minor of e^{A_c t},    A_c the companion matrix

    Parameters
    ----------
    plant : Plant or (n,) array of complex
        A single-output observable plant, or its eigenvalues with multiplicity [1/time], closed under
        conjugation.

    Returns
    -------
    float
        [time]; infinite if all eigenvalues are real.

    Raises
    ------
    ArgumentError
        If there is more than one output, the order is above `LARGEST_ORDER`, or eigenvalues are not
        closed under conjugation.
    NotObservableError
        If the output does not see some mode.

    Notes
    -----
    *Claim.* y = Ce^{At}x runs through the kernel of the differential operator with the plant's
    characteristic polynomial. W_k(t) = 0 says that some y has n-k zeros at 0 and k at t. Below the first
    such t no y != 0 has n zeros, so that n samples suffice; just above it some n distinct times fail.
    *Method.* W_k is an entry of the exponential of the k-th additive compound of A_c (eigenvalues: sums of
    k eigenvalues), which keeps relative accuracy where the determinant of e^{A_c t} loses it. With
    omega = max |Im lambda| the search runs over [pi/omega, (n-1) pi/omega]: h lies there, since
    e^{at} cos(bt) has n zeros in a length (n-1) pi/b. *Numerical aspects.* Time is scaled by max |lambda|;
    zeros with a change of sign by bisection, touching ones as minima of |W_k| (roots of its derivative)
    below `TOUCH`. The grid resolves the fastest oscillation of W_k; that is evidence, not an enclosure.

    References
    ----------
    Coppel, Disconjugacy (1971); Carnicer, Mainar, Pena, Critical length for design purposes and extended
    Chebyshev spaces (2003).

    Examples
    --------
    >>> round(critical_length([0, 0, 0, 1j, -1j]), 4)
    8.9868
    """
    values = _eigenvalues(plant)
    n, omega = values.size, float(np.max(np.abs(values.imag), initial=0.0))
    if omega == 0.0 or n < 2:
        return np.inf
    if n == 2:
        return float(np.pi / omega)
    if n > LARGEST_ORDER:
        raise ArgumentError(f"`plant` must have at most {LARGEST_ORDER} states for its critical length, got {n}.")
    rho = float(np.max(np.abs(values)))
    companion = np.diag(np.ones(n - 1), 1)
    companion[-1] = -np.real(np.poly(values / rho))[:0:-1]
    start, stop = np.pi * rho / omega, (n - 1) * np.pi * rho / omega
    for k in range(1, n):
        stop = min(stop, _first_zero(values / rho, companion, k, start, stop))
    return stop / rho


def _eigenvalues(plant: Plant | npt.ArrayLike) -> Complex:
    if not isinstance(plant, Plant):
        values = np.atleast_1d(np.asarray(plant, dtype=complex))
        size = float(np.max(np.abs(values), initial=0.0))
        mirror = np.sort_complex(np.round(values.conj() / (size or 1.0), 9))
        if not np.array_equal(np.sort_complex(np.round(values / (size or 1.0), 9)), mirror):
            raise ArgumentError("`plant`: eigenvalues must be closed under conjugation, as those of a real matrix are.")
        return values
    if plant.n_outputs != 1:
        raise ArgumentError(f"`plant` must have one output for its critical length, got {plant.n_outputs}.")
    require_observable(plant, "the critical length")
    return spectrum(eigenvalue_clusters(plant.A))


def _first_zero(values: Complex, companion: Array, k: int, start: float, stop: float) -> float:
    """First zero of W_k on [start, stop], else `stop`; times in units of 1/max|lambda|."""
    compound, shift = _compound(companion, k), _largest_sum(values, k)
    compound = compound - shift * np.eye(compound.shape[0])  # e^{-shift t} W_k has the same zeros and never overflows
    fastest = float(np.sum(np.sort(np.abs(values.imag))[::-1][:k]))
    count = 2 + int(np.ceil((stop - start) * STEPS_PER_RADIAN * max(fastest, 1.0)))
    times, step = np.linspace(start, stop, count, retstep=True)
    advance = expm_batch(compound, [step])[0]
    column = expm_batch(compound, [start])[0][:, -1]
    for t in times:
        following = advance @ column
        zero = _zero_in_step(compound, column, following, float(step))
        if zero is not None:
            return float(min(t + zero, stop))
        column = following
    return stop


def _zero_in_step(compound: Array, left: Array, right: Array, step: float) -> float | None:
    """Where in [0, step] the first entry of e^{compound s} left vanishes or touches zero, or None."""
    floor = TOUCH * float(np.max(np.abs(left)))
    if abs(left[0]) <= floor:
        return 0.0
    row = compound[0]
    sign = np.sign(left[0])
    if sign * right[0] < 0:
        return _bisect(compound, left, step, lambda column: sign * column[0])
    if sign * (row @ left) < 0 < sign * (row @ right):
        low = _bisect(compound, left, step, lambda column: -sign * (row @ column))
        if sign * (expm_batch(compound, [low])[0] @ left)[0] <= floor:
            return low
    return None


def _bisect(compound: Array, left: Array, step: float, test: object) -> float:
    """Where `test` of e^{compound s} left, positive at 0, turns negative: halving with stored half steps."""
    position, column = 0.0, left
    for s in range(1, 50):
        half = float(np.ldexp(step, -s))
        trial = expm_batch(compound, [half])[0] @ column
        if test(trial) > 0:  # type: ignore[operator]
            position, column = position + half, trial
    return position


def _compound(A: Array, k: int) -> Array:
    """k-th additive compound: sum over i of the wedge product with A in place i, rows and columns k-subsets in order.

    Its exponential is the matrix of k x k minors of e^A. The sign of an entry is that of the exchange.
    """
    subsets = list(combinations(range(A.shape[0]), k))
    place = {s: i for i, s in enumerate(subsets)}
    result = np.zeros((len(subsets), len(subsets)))
    for column, subset in enumerate(subsets):
        for position, j in enumerate(subset):
            rest = subset[:position] + subset[position + 1 :]
            for i in np.flatnonzero(A[:, j]):
                if int(i) in rest:
                    continue
                target = tuple(sorted((*rest, int(i))))
                sign = (-1) ** (position + target.index(int(i)))
                result[place[target], column] += sign * A[i, j]
    return result


def _largest_sum(values: Complex, k: int) -> float:
    return float(np.sum(np.sort(values.real)[::-1][:k]))
