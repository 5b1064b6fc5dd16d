"""A refusal is an answer: a periodic schedule of the family that has no certificate, which anybody can check."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from sampling_design.certificates.existence.periodic import Existence, judged, stays_bounded, too_dense
from sampling_design.errors import CertificateError
from sampling_design.numerics.linalg import balance, balanced, balanced_rows, expm_batch, positive_or_one
from sampling_design.observability.count.period_modes import period_modes
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Complex
from sampling_design.records.budget import Budget
from sampling_design.records.checks import Seed, generator, positive, vector
from sampling_design.records.record import Record, below, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import LONGEST_WORD, SamplingFamily, period_of
from sampling_design.schedules.schedule import PeriodicSchedule

MOST_PERIODS = 240
"""Periods of aliasing that are tried, of all pairs of eigenvalues together: beyond that, evenly chosen ones."""
MOST_SECONDS = 20.0  # of one search, by default
DESCENTS = 4  # words from which the margin is minimised over the gaps
TIED_RTOL = 1e-9  # real parts this near, relative to the eigenvalues, can alias; speeds this near are one
RESIDUAL = 1e-6
"""A counterexample is accepted if M v = mu v and all samples of v vanish to this, relative to |M| and |C e^{At}|."""


@dataclass(frozen=True, eq=False, repr=False)
class Counterexample(Record):
    """A periodic schedule on which a direction that does not decay at rate eta is never observed.

        e^{A P} v = mu v,    |mu| >= e^{-eta P/2},    C_i e^{A tau_i} v = 0 at every sample

    Attributes
    ----------
    plant : Plant
    schedule : PeriodicSchedule
        The gap word and what its samples measure.
    eta : float [1/time]
    eigenvalue : complex
        Of A: the mode that is not observed; `partners` are those it cannot be told from.
    partners : tuple of complex
    multiplier : complex
        mu.
    direction : tuple of complex
        v, of unit length, just after the last sample of a period.
    residual : float
        The larger of |Mv - mu v| over the norm of |M||v| and |C_i e^{A tau_i} v| over |C_i e^{A tau_i}||v|, in units
        that balance A.
    reason : str
    """

    plant: Plant
    schedule: PeriodicSchedule
    eta: float
    eigenvalue: complex
    partners: tuple[complex, ...]
    multiplier: complex
    direction: tuple[complex, ...]
    residual: float
    reason: str

    def verify(self) -> bool:
        """Whether the three equations hold as nearly as is said, and miss the modes that are named, computed anew."""
        mu, v = self.multiplier, np.array(self.direction)
        grows = abs(mu) >= np.exp(-self.eta * self.schedule.period / 2) * (1 - RESIDUAL)
        if not grows or abs(np.linalg.norm(v) - 1) > RESIDUAL:
            return False
        M, rows, units = _lifted(self.plant, self.schedule)
        reached = _residual(M, rows, mu, (v / units).astype(complex))
        if not reached <= min(self.residual + RESIDUAL**2, RESIDUAL):  # as it was, but for rounding on another machine
            return False
        found = judged(self.plant, self.schedule, self.eta)
        if found.eigenvalue is None or len(found.partners) != len(self.partners):
            return False
        said, missed = [self.eigenvalue, *self.partners], [found.eigenvalue, *found.partners]
        return np.allclose(said, missed, rtol=RESIDUAL, atol=0.0) and self.reason == found.reason

    _answers = (
        "a schedule of the family on which no certificate holds",
        "attained: a direction that no sample shows does not decay",
        "equations hold within {residual:3}",
        "`.verify()`",
    )

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.plant.time_unit
        return [
            ("gaps", f"{short(self.schedule.gaps)} {unit}"),
            ("unobservable eigenvalue", format_eigenvalue(self.eigenvalue, grain=1e-12 * abs(self.eigenvalue))),
            ("eta", f"{below(self.eta)} 1/{unit}"),
            ("reason", self.reason),
        ]

    def explain(self) -> str:
        """Say why no certificate can hold for this schedule."""
        return f"The schedule with the gaps {short(self.schedule.gaps)} belongs to the family, and {self.reason}."


class NearestFailure(NamedTuple):
    """How near a search came to a schedule without certificate: the least margin of all words tried, and its schedule.

    `searched` says what was left out, "" if nothing was.
    """

    margin: float
    schedule: PeriodicSchedule
    searched: str = ""


def _lifted(plant: Plant, schedule: PeriodicSchedule) -> tuple[Array, Array, Array]:
    """Monodromy matrix of a period that begins just after its last sample, rows of its samples, units that balance A.

    Both are in these units, x = units z, so that the units of the plant do not decide what counts as small.
    """
    units = balance(plant.A * schedule.period).d  # of chains alone only time says how fast they are
    with np.errstate(over="ignore", invalid="ignore"):
        flows = expm_batch(balanced(plant.A, units), np.cumsum(schedule.gaps))
        rows = balanced_rows(plant.C, units) @ flows
    if schedule.outputs is not None:
        rows = np.where(schedule.outputs[:, :, None], rows, 0.0)
    return flows[-1], rows.reshape(-1, plant.n_states), units


def _residual(M: Array, rows: Array, mu: complex, z: Complex) -> float:
    """How far the equations are from holding; infinite where the flow is no number."""
    if not np.isfinite(M).all() or not np.isfinite(rows).all():
        return np.inf
    size = np.abs(z)
    outputs = np.abs(rows @ z) / positive_or_one(np.linalg.norm(rows, axis=1) * np.linalg.norm(z))
    moved = np.linalg.norm(M @ z - mu * z) / (np.linalg.norm(np.abs(M) @ size) or 1.0)
    return float(max(moved, outputs.max(initial=0.0)))


def counterexample(plant: Plant, schedule: PeriodicSchedule, eta: float, existence: Existence) -> Counterexample | None:
    """Return the counterexample that a failed existence test stands for, if its equations hold to `RESIDUAL`."""
    modes = period_modes(plant, float(eta))
    if not modes.blocks or too_dense(plant, schedule, eta, existence) or stays_bounded(plant, schedule, eta):
        return None
    least = modes.least_observed(schedule)
    direction = modes.direction(least, schedule, float(schedule.gaps[0]))
    with np.errstate(over="ignore", invalid="ignore"):
        mu = complex(np.exp(least.rate * schedule.period))
    M, rows, units = _lifted(plant, schedule)
    residual = _residual(M, rows, mu, (direction / units).astype(complex))
    if not residual <= RESIDUAL:
        return None
    main = existence.eigenvalue if existence.eigenvalue is not None else least.rate
    return Counterexample(
        plant=plant, schedule=schedule, eta=eta, eigenvalue=main, partners=existence.partners, multiplier=mu,
        direction=tuple(complex(x) for x in direction), residual=residual, reason=existence.reason,
    )  # fmt: skip


@checked
def find_counterexample(
    plant: Plant,
    family: SamplingFamily,
    eta: float,
    hints: Iterable[float | None] = (),
    rng: Seed = None,
    quick: bool = False,
    budget: float = MOST_SECONDS,
) -> tuple[Counterexample | None, NearestFailure]:
    """Search a periodic schedule of `family` whose period is not detectable at rate `eta`.

    Parameters
    ----------
    plant : Plant
    family : GapRange, SpacedWindows, LostSamples or Jitter
    eta : float [1/time]
    hints : floats, optional
        Gaps near which to look as well.
    rng : numpy.random.Generator or its seed, optional
        Default seed 0.
    quick : bool
        Only the words themselves, shorter patterns, no descent on the margin.
    budget : float [seconds]
        The search ends after it with what it has.

    Returns
    -------
    Counterexample or None, and Nearest (margin, schedule, searched)
        The least margin of all words tried (`certificate_exists`), its schedule, and what was left out, in words.

    Notes
    -----
    *Method.* Two eigenvalues of equal real part alias over a period of 2 pi k/|Im(lambda_i - lambda_j)|: for every such
    period that words of up to four gaps can have (240 of them, evenly chosen, where there are more), the word of equal
    gaps, some random ones, and the least margin over gaps of that sum. For lost samples, every pattern of losses of up
    to twelve nominal samples.
    """
    eta, given = positive("eta", eta), Budget(positive("budget", budget))
    near = [float(h) for h in vector("hints", [h for h in hints if h is not None])]
    rng = generator(rng)
    periods, left = _aliasing_periods(plant, eta, family)
    searched = [f"{len(periods)} of {len(periods) + left:.4g} periods at which modes alias were tried"] if left else []
    least: tuple[float, PeriodicSchedule] = (np.inf, period_of(family.nominal))
    tried: list[tuple[float, PeriodicSchedule]] = []

    def refused(schedule: PeriodicSchedule) -> tuple[Counterexample | None, float]:
        existence = judged(plant, schedule, eta)
        return None if existence.exists else counterexample(plant, schedule, eta, existence), existence.margin

    suspects = family.suspects(sorted({*periods, *(h for h in near if h)}), rng, quick)
    for schedule in chain([least[1]], suspects):
        made, margin = refused(schedule)
        if made is not None:
            return made, NearestFailure(margin, schedule, "; ".join(searched))
        tried.append((margin, schedule))
        least = min(least, tried[-1], key=itemgetter(0))
        if given.over:
            searched.append(f"the search ended after {budget:g} s and {len(tried)} schedules")
            break
    if quick:
        return None, NearestFailure(*least, "; ".join(searched))
    for margin, schedule in sorted(tried, key=itemgetter(0))[:DESCENTS]:
        if given.over:
            break
        better = _descend(plant, family, eta, schedule)
        made, reached = refused(better)
        if made is not None:
            return made, NearestFailure(reached, better, "; ".join(searched))
        if reached < min(margin, least[0]):
            least = (reached, better)
    return None, NearestFailure(*least, "; ".join(searched))


def refute(
    plant: Plant, family: SamplingFamily, eta: float, hints: Sequence[float | None] = (), quick: bool = False
) -> NearestFailure:
    """Return how near the search came, if no schedule of the family is found that has no certificate.

    Raises
    ------
    CertificateError
        With details `counterexample`, `gaps`, `eigenvalue`, `direction` if one is found.
    """
    failure, least = find_counterexample(plant, family, eta, hints, quick=quick)
    if failure is None:
        return least
    raise CertificateError(
        f"no certificate with rate {eta:.6g} exists for this family. {failure.explain()}",
        counterexample=failure,
        gaps=tuple(float(gap) for gap in failure.schedule.gaps),
        eigenvalue=failure.eigenvalue,
        direction=failure.direction,
        period=failure.schedule.period,
        eta=eta,
    )


def _aliasing_periods(plant: Plant, eta: float, family: SamplingFamily) -> tuple[list[float], float]:
    """Periods 2 pi k/|Im(a - b)| that words of the family can have, over the eigenvalues that do not decay at rate eta.

    At most `MOST_PERIODS`, evenly chosen on a logarithmic scale where there are more; and how many were left out.
    """
    values = np.array([c.value for block in period_modes(plant, float(eta)).blocks for c in block.clusters])
    if values.size < 2:
        return [], 0.0
    first, second = np.triu_indices(values.size, 1)
    apart = values[first] - values[second]
    tied = np.abs(apart.real) <= TIED_RTOL * np.maximum(np.abs(values[first]), np.abs(values[second]))
    speeds = np.sort(np.abs(apart.imag[tied]))
    speeds = speeds[np.diff(speeds, prepend=0.0) > TIED_RTOL * speeds]
    shortest, longest = family.min_gap, LONGEST_WORD * family.d_max
    chosen, left = [], 0.0
    most = max(MOST_PERIODS // max(speeds.size, 1), 4)
    for cycle in 2 * np.pi / speeds[speeds > 0]:
        low, high = max(np.ceil(shortest / cycle - 1e-9), 1.0), np.floor(longest / cycle + 1e-9)
        if high - low < most:
            multiples = np.arange(low, high + 1)
        else:
            multiples = np.unique(np.rint(np.geomspace(low, high, most)))
            left += float(high - low + 1 - multiples.size)
        chosen += [float(cycle * k) for k in multiples]
    return chosen, left


def _descend(plant: Plant, family: SamplingFamily, eta: float, start: PeriodicSchedule) -> PeriodicSchedule:
    """The member with the least margin near `start`, as the family varies it."""
    from scipy.optimize import minimize

    near = family.variation(start)
    if near is None:
        return start
    origin, spread, build = near

    def margin(steps: Array) -> float:
        schedule = build(origin + spread * steps)
        return judged(plant, schedule, eta).margin if family.contains(schedule) else 1.0

    simplex = np.vstack([np.zeros(origin.size), np.eye(origin.size) / 2])
    optimum = minimize(
        margin, simplex[0], method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 60 * origin.size, "xatol": 1e-12, "fatol": 1e-12},
    )  # fmt: skip
    best = build(origin + spread * optimum.x)
    return best if family.contains(best) else start
