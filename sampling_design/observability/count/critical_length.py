"""The critical length: below it any n distinct times determine the state of a single-output plant."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from sampling_design.errors import ArgumentError
from sampling_design.observability.count.pbh import require_observable, spectrum
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Complex
from sampling_design.records.checks import described
from sampling_design.records.signatures import checked

LARGEST_ORDER = 12  # the k-th compound has C(n, k) rows: 924 at n = 12, k = 6
TERMS = 26  # of the Taylor series over one step; with REACH = 2 the remainder is 2^26/26! = 2e-19
REACH = 2.0  # length of a step times the norm of the compound
MOST_STEPS = 100_000  # estimate of Taylor steps over all k, a few seconds of work; more only for stiff spectra
STEPS_PER_RADIAN = 12  # samples of a minor per radian of its fastest oscillation, so that no extremum is missed
TOUCH = 1e-9  # a least |minor| below this fraction of the compound's column counts as a zero that touches


@checked
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
        If there is more than one output, the order is above `LARGEST_ORDER`, the spectrum is too stiff
        (`MOST_STEPS`), or eigenvalues are not closed under conjugation.
    NotObservableError
        If the output does not see some mode.

    Notes
    -----
    *Claim.* y = Ce^{At}x runs through the kernel of the differential operator with the plant's
    characteristic polynomial. W_k(t) = 0 says that some y has n-k zeros at 0 and k at t. Below the first
    such t no y != 0 has n zeros, so that n samples suffice; just above it some n distinct times fail.
    *Method.* W_k is an entry of the exponential of the k-th additive compound of A_c (eigenvalues: sums of
    k eigenvalues), which keeps relative accuracy where the determinant of e^{A_c t} loses it; its column is
    carried along in Taylor steps, so that W_k and its slope are polynomials on each. With
    omega = max |Im lambda| the search runs over [pi/omega, (n-1) pi/omega]: h lies there, since
    e^{at} cos(bt) has n zeros in a length (n-1) pi/b. *Numerical aspects.* Time is scaled by max |lambda|;
    zeros with a change of sign by bisection, touching ones as minima of |W_k| (roots of its derivative)
    below `TOUCH`. Rounding moves a zero of order m by eps^{1/m}, towards shorter lengths. The grid
    resolves the fastest oscillation of W_k; that is evidence, not an enclosure.

    References
    ----------
    Coppel, Disconjugacy (1971); Carnicer, Mainar, Pena, Critical length for design purposes and extended
    Chebyshev spaces (2003); arXiv 1904.09253.

    Examples
    --------
    >>> round(critical_length([0, 0, 0, 1j, -1j]), 4)
    8.9868
    """
    values = _eigenvalues(plant)
    found = search(values)
    if found is not None:
        return found
    if values.size > LARGEST_ORDER:
        raise ArgumentError(
            f"`plant` must have at most {LARGEST_ORDER} states for its critical length, got {values.size}."
        )
    raise ArgumentError(
        "`plant` is too stiff for its critical length: its fastest rate is far above its fastest frequency. "
        "Split off the fast modes (split_modes)."
    )


def search(values: Complex) -> float | None:
    """Critical length of a spectrum, None where the order or the stiffness is beyond the search."""
    n, omega = values.size, float(np.max(np.abs(values.imag), initial=0.0))
    if omega == 0.0 or n < 2:
        return np.inf
    if n == 2:
        return float(np.pi / omega)
    rho = float(np.max(np.abs(values)))
    companion = np.diag(np.ones(n - 1), 1)
    companion[-1] = -np.real(np.poly(values / rho))[:0:-1]
    start, stop = np.pi * rho / omega, (n - 1) * np.pi * rho / omega
    if n > LARGEST_ORDER or stop * n * np.linalg.norm(companion, 1) / REACH > MOST_STEPS:
        return None
    for k in range(1, n):
        stop = min(stop, _first_zero(values / rho, companion, k, start, stop))
    return stop / rho


def _complex_vector(value: npt.ArrayLike) -> Complex:
    try:
        found = np.atleast_1d(np.asarray(value))
    except Exception:  # whatever a foreign object does when it is asked for an array
        found = np.array(None)
    if found.ndim != 1 or found.dtype.kind not in "iufc" or not np.isfinite(found).all():
        raise ArgumentError(f"`plant` must be a Plant or a list of eigenvalues, got {described(value)}.")
    return found.astype(complex)


def _eigenvalues(plant: Plant | npt.ArrayLike) -> Complex:
    if Plant._foreign(plant) is not None:  # a system of another library; the door takes it for a list of eigenvalues
        return _eigenvalues(Plant(plant, time_unit="s"))  # type: ignore[arg-type]
    if not isinstance(plant, Plant):
        values = _complex_vector(plant)
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
    shift = float(np.sum(np.sort(values.real)[::-1][:k]))
    compound = _compound(companion, k, shift)  # e^{-shift t} W_k has the same zeros and never overflows
    fastest = float(np.sum(np.sort(np.abs(values.imag))[::-1][:k]))
    longest = REACH / max(float(abs(compound).sum(axis=0).max()), 1.0)
    points = 2 + int(np.ceil(longest * STEPS_PER_RADIAN * max(fastest, 1.0)))
    column = np.zeros(compound.shape[0])
    column[-1] = 1.0
    for begin, end in ((0.0, start), (start, stop)):
        count = max(1, int(np.ceil((end - begin) / longest)))
        step = (end - begin) / count
        for i in range(count):
            terms = _taylor(compound, column, step)
            if begin == start:
                zero = _zero_in_step(terms[:, 0], TOUCH * float(np.max(np.abs(column))), points)
                if zero is not None:
                    return float(min(start + (i + zero) * step, stop))
            column = terms.sum(axis=0)
    return stop


def _taylor(compound: csr_array, column: Array, step: float) -> Array:
    """Terms of e^{compound s step} column as a polynomial in s, 0 <= s <= 1, constant first."""
    terms = np.empty((TERMS, column.size))
    terms[0] = column
    for j in range(1, TERMS):
        terms[j] = compound @ terms[j - 1] * (step / j)
    return terms


def _zero_in_step(polynomial: Array, floor: float, points: int) -> float | None:
    """Where in [0, 1] a polynomial first vanishes, or comes nearer to zero than `floor`; None if nowhere."""
    sign = 1.0 if polynomial[0] > 0 else -1.0
    value = np.polynomial.Polynomial(sign * polynomial)
    slope = value.deriv()
    grid = np.linspace(0.0, 1.0, points)
    heights, slopes = value(grid), slope(grid)
    if heights[0] <= floor:
        return 0.0
    for i in range(points - 1):
        if heights[i + 1] <= 0:
            return _bisect(value, grid[i], grid[i + 1])
        if slopes[i] < 0 <= slopes[i + 1]:
            lowest = _bisect(lambda s: -slope(s), grid[i], grid[i + 1])
            if value(lowest) <= floor:
                return lowest
    return None


def _bisect(test: Callable[[float], float], low: float, high: float) -> float:
    """Last point at which `test`, positive at `low` and not at `high`, was found positive."""
    for _ in range(60):
        middle = low + (high - low) / 2
        if test(middle) > 0:
            low = middle
        else:
            high = middle
    return float(low)


def _compound(A: Array, k: int, shift: float = 0.0) -> csr_array:
    """k-th additive compound less shift I, sparse: e^A in place of A gives the k x k minors of e^A.

    Rows and columns are the k-subsets in order; an entry of A takes its place in the wedge product of the
    unit vectors of a subset, its sign is that of the exchange.
    """
    subsets = list(combinations(range(A.shape[0]), k))
    place = {s: i for i, s in enumerate(subsets)}
    entries: list[tuple[float, int, int]] = [(-shift, i, i) for i in range(len(subsets))]
    for column, subset in enumerate(subsets):
        for position, j in enumerate(subset):
            rest = subset[:position] + subset[position + 1 :]
            for i in (int(i) for i in np.flatnonzero(A[:, j]) if int(i) not in rest):
                target = tuple(sorted((*rest, i)))
                sign = (-1) ** (position + target.index(i))
                entries.append((sign * A[i, j], place[target], column))
    values, rows, columns = zip(*entries, strict=True)
    return csr_array((np.array(values), (rows, columns)), shape=(len(subsets), len(subsets)))
