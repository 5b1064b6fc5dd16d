"""How many samples in a window determine the state, whatever the times: the counts side by side."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.observability.count.critical_length import search
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.count.pbh import observable_rank, require_observable, spectrum
from sampling_design.plants.clusters import EigenvalueCluster, eigenvalue_clusters
from sampling_design.plants.modes import ModalSplit
from sampling_design.plants.plant import Plant
from sampling_design.plants.rows import Wanted
from sampling_design.records import checks
from sampling_design.records.evidence import Claim
from sampling_design.records.record import PlainRecord, short
from sampling_design.records.signatures import checked, open_verb

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
