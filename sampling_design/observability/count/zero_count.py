"""How many samples in a window determine the state, whatever the times: the counts side by side.

Below the critical length any n distinct times determine the state of a single-output plant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from sampling_design.errors import ArgumentError
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.count.pbh import observable_rank, require_observable, spectrum
from sampling_design.plants.clusters import EigenvalueCluster, eigenvalue_clusters
from sampling_design.plants.functional import Wanted
from sampling_design.plants.modes import ModalSplit
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Complex
from sampling_design.records.record import Claim, PlainRecord, short
from sampling_design.records.signatures import checked, open_verb

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
        raise ArgumentError(f"`plant` must be a Plant or a list of eigenvalues, got {checks.described(value)}.")
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


ROUNDING_GUARD = 1e-9
"""k* within this of a whole number (relative above 1) counts as that number: floor(k* + guard) + 1, never ceil(k*)."""

MOST_SAMPLES = 1e15  # beyond, the next whole number is no double any more
LARGEST_SUBSETS = 12  # outputs up to which every set of outputs is tried for the lower bound (2^12 rank decisions)


@dataclass(frozen=True, eq=False, repr=False)
class SampleCount(PlainRecord):
    """How many samples in a closed window of length `duration` determine the state of every plant asked about."""

    value: float
    samples_needed: int
    frequency_spread: float
    duration: float

    @property
    def samples(self) -> int:
        """This many distinct times suffice wherever they are placed in the window."""
        return self.samples_needed


@dataclass(frozen=True, eq=False, repr=False)
class ZeroCountBound(SampleCount):
    """Numbers of samples in a closed window of length `duration`, side by side.

    Attributes
    ----------
    value : float
        k* = r - 1 + T delta/(2 pi): any more than k* distinct times determine the state.
    samples_needed : int
        Smallest whole number above k*, strictly; 0 for a plant without states.
    order : int
        r, the sum of the indices of the distinct eigenvalues (n where rounding leaves them in doubt).
    frequency_spread : float
        delta, twice the largest imaginary part [rad/time].
    duration : float
        T [time].
    critical_length : float or None
        Below it any n distinct times suffice [time]; None for several outputs, a large order
        or a stiff spectrum.
    samples_critical : int or None
        n where `duration` is strictly below the critical length, else None.
    samples_least : int
        No fewer samples can do, wherever they are placed.
    claim : Claim
    time_unit : str
    """

    order: int
    n_states: int
    n_outputs: int
    critical_length: float | None
    samples_critical: int | None
    samples_least: int
    claim: Claim
    time_unit: str = "s"

    _plain = (
        "value samples_needed order frequency_spread duration n_states n_outputs critical_length:_length "
        "samples_critical samples_least binding samples claim"
    )

    def _length(self) -> float | str | None:
        """The critical length for a file, in which an infinite one (all eigenvalues real) is a word."""
        return "infinite" if self.critical_length == np.inf else self.critical_length

    _answers = (
        "how many samples in a window of {duration} {time_unit} determine the state, whatever their times",
        "{claim.evidence}",
        "{samples} are enough ({binding}), fewer than {samples_least} never are",
        "`window_sigma` of any such schedule is positive",
    )
    _table = {
        "k*": "{value}",
        "samples needed": "{samples_needed}",
        "order r": "{order}",
        "frequency spread": "{frequency_spread} rad/{time_unit}",
        "critical length": "{critical_length} {time_unit}",
        "samples by critical length": "{samples_critical:or -}",
    }

    @property
    def binding(self) -> str:
        """Which count asks for the fewest samples: "zero count" or "critical length"."""
        if self.samples_critical is not None and self.samples_critical < self.samples_needed:
            return "critical length"
        return "zero count"

    @property
    def samples(self) -> int:
        """The binding count: this many distinct times suffice wherever they are placed in the window."""
        critical = self.samples_critical
        return self.samples_needed if critical is None else min(critical, self.samples_needed)

    def explain(self) -> str:
        """Say how many samples suffice, and by which count."""
        if not self.n_states:
            return "Nothing has to be observed: no samples needed."
        return (
            f"Any {self.samples} distinct times in a closed window of {short(self.duration)} {self.time_unit} "
            f"determine the state ({self.binding}); fewer than {self.samples_least} never do."
        )


@open_verb(SampleCount)
def zero_count_bound(plant: Plant, duration: float, of: Wanted = None) -> ZeroCountBound:
    """Return how many samples in a closed window of length `duration` determine the state, whatever the times.

        k* = r - 1 + T delta/(2 pi),    delta = 2 max |Im lambda|

    Parameters
    ----------
    plant : Plant or UncertainPlant
        With constant parameters in a box: a count for every plant of it, r = n and delta the largest.
        Observable; give the retained part of a plant that is only detectable.
    duration : float
        T >= 0 [the plant's time unit].
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows (`functional_plant`): how many samples
        determine all that they need. Default: all states.

    Returns
    -------
    ZeroCountBound, or ZeroCountOverBox

    Raises
    ------
    ArgumentError
        If `duration` is negative.
    NotObservableError
        If some mode is observed by no output; names its eigenvalue and direction.

    Notes
    -----
    *Assumptions.* Real A and C, every mode observed by some output. *Claim.* Ce^{At}x, x != 0, has at most k*
    zeros in a closed interval of length T, so that any floor(k*) + 1 distinct times make O_s full rank. For
    several outputs this holds for a generic combination of them, and is conservative. With one output and
    T below the critical length, n times suffice. In the other direction k samples of p outputs can only do if
    k (p - |S|) >= n - n_S for every set S of outputs, n_S the dimension that S alone sees.
    *Numerical aspects.* Eigenvalues that rounding cannot tell apart are one; where their grouping or index is
    in doubt, r = n and delta is taken from their members. k* counts as whole within `ROUNDING_GUARD`. A count
    says whether the state is determined, sigma says how well.

    References
    ----------
    The paper, equation (29), and its reference for it.

    Examples
    --------
    >>> import numpy as np
    >>> bound = zero_count_bound(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), np.pi)
    >>> bound.value, bound.samples_needed, bound.binding
    (2.0, 3, 'zero count')
    """
    T, plant = checks.nonnegative("duration", duration), part_for(plant, of)
    n, p = plant.n_states, plant.n_outputs
    if not n:
        return _record(plant, T, -1.0, 0, 0, 0.0, None, 0)
    require_observable(plant, "a zero count")
    clusters = eigenvalue_clusters(plant.A)
    order, spread = _order_and_spread(clusters)
    value = order - 1 + T * spread / (2 * np.pi)
    needed = samples_above(value, T)
    length = search(spectrum(clusters)) if p == 1 else None
    return _record(plant, T, value, needed, order, spread, length, _least(plant))


def samples_above(value: float, duration: float) -> int:
    """Return floor(k*) + 1, the samples in a window of length `duration` that suffice.

    Raises ArgumentError if there are so many that the next whole number is no double.
    """
    if not value < MOST_SAMPLES:
        raise ArgumentError(
            f"`duration` must hold fewer than {MOST_SAMPLES:.0e} samples by the count, got {duration!r}."
        )
    return int(np.floor(value + ROUNDING_GUARD * max(1.0, value))) + 1


def _record(
    plant: Plant, T: float, value: float, needed: int, order: int, spread: float, length: float | None, least: int
) -> ZeroCountBound:
    n = plant.n_states
    below = length is not None and length * (1 - ROUNDING_GUARD) > T
    claim = Claim(
        f"any {needed} distinct times in a closed window of {short(T)} {plant.time_unit} determine the state",
        "the paper, equation (29)",
        ("every mode is observable from some output", f"r = {order} and delta = {short(spread)} as computed"),
        citation="paper, equation (29)",
    )
    critical = n if below else None
    return ZeroCountBound(
        value=float(value), samples_needed=needed, order=order, frequency_spread=spread, duration=T, n_states=n,
        n_outputs=plant.n_outputs, critical_length=length, samples_critical=critical, samples_least=least, claim=claim,
        time_unit=plant.time_unit,
    )  # fmt: skip


def _order_and_spread(clusters: tuple[EigenvalueCluster, ...]) -> tuple[int, float]:
    """Sum of indices and twice the largest imaginary part; the larger values where rounding leaves a doubt."""
    if all(c.sure for c in clusters):
        imaginary = max(abs(c.value.imag) for c in clusters)
        return sum(c.index for c in clusters), 2.0 * float(imaginary)
    imaginary = max(float(np.max(np.abs(c.members.imag))) for c in clusters)
    return sum(c.multiplicity for c in clusters), 2.0 * imaginary


def _least(plant: Plant) -> int:
    """Largest over the sets S of outputs of ceil((n - n_S)/(p - |S|)); S empty and all but one if there are many."""
    n, p = plant.n_states, plant.n_outputs
    sizes = range(p) if p <= LARGEST_SUBSETS else (0, 1, p - 1)
    least = 0
    for size in sizes:
        for measured in combinations(range(p), size):
            rank = observable_rank(plant, list(measured)) if measured else 0
            least = max(least, -(-(n - rank) // (p - size)))
    return least


@checked
def default_window(split: ModalSplit) -> float | None:
    """Return the window that is used where none is given: the slowest oscillation, else 4/|A| of the retained part.

        T = 2 pi / min |Im lambda| over the non-zero ones,    else T = 4/|A_retained|, in scaled coordinates

    Parameters
    ----------
    split : ModalSplit

    Returns
    -------
    float or None
        In the plant's time unit; None where the retained part neither oscillates nor moves.
    """
    rates = np.abs(np.array([c.value.imag for c in split.retained_clusters]))
    rates = rates[rates > 0]
    if rates.size:
        return float(2 * np.pi / rates.min())
    norm = float(np.linalg.norm(split.retained.scaled().A, 2)) if split.retained.n_states else 0.0
    return 4 / norm if norm else None
