"""A refusal is an answer: a periodic schedule of the family that has no certificate, which anybody can check."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import matrix_balance

from sampling_design._checks import positive, vector
from sampling_design._door import door
from sampling_design._linalg import expm_batch
from sampling_design._record import Record, short
from sampling_design.certificates.existence.periodic import Existence, certificate_exists
from sampling_design.errors import CertificateError
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.modes import split_modes
from sampling_design.plants.plant import Plant
from sampling_design.schedules.family import LONGEST_WORD, SamplingFamily, period_of
from sampling_design.schedules.schedule import PeriodicSchedule

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

DESCENTS = 4
"""Words from which the margin is minimised over the gaps."""
TIED_RTOL = 1e-9
"""Real parts this near, relative to |A|, can alias."""
RESIDUAL = 1e-6
"""A counterexample is accepted if M v = mu v and all samples of v vanish to this, relative to |M| and |C e^{At}|."""


@dataclass(frozen=True, eq=False, repr=False)
class Counterexample(Record):
    """A periodic schedule on which a direction that does not fade at rate eta is never seen.

        e^{A P} v = mu v,    |mu| >= e^{-eta P/2},    C_i e^{A tau_i} v = 0 at every sample

    Attributes
    ----------
    plant : Plant
    schedule : PeriodicSchedule
        The gap word and what its samples measure.
    eta : float [1/time]
    eigenvalue : complex
        Of A: the mode that is not seen; `partners` are those it cannot be told from.
    partners : tuple of complex
    multiplier : complex
        mu.
    direction : tuple of complex
        v, of unit length, just after the last sample of a lap.
    residual : float
        The largest of |Mv - mu v|/|M| and |C_i e^{A tau_i} v|/|C_i e^{A tau_i}|, in units that balance A.
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
        """Whether the three equations hold, computed anew."""
        mu, v = self.multiplier, np.array(self.direction)
        grows = abs(mu) >= np.exp(-self.eta * self.schedule.period / 2) * (1 - RESIDUAL)
        if not grows or abs(np.linalg.norm(v) - 1) > RESIDUAL:
            return False
        M, rows, units = _lifted(self.plant, self.schedule)
        z = v / units
        return _residual(M, rows, mu, z / np.linalg.norm(z)) <= RESIDUAL

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("gaps", short(self.schedule.gaps)),
            ("unseen eigenvalue", format_eigenvalue(self.eigenvalue, grain=1e-12 * abs(self.eigenvalue))),
            ("eta", short(self.eta)),
            ("residual", short(self.residual, 3)),
            ("reason", self.reason),
        ]

    def explain(self) -> str:
        """Say why no certificate can hold for this schedule."""
        return f"The schedule with the gaps {short(self.schedule.gaps)} belongs to the family, and {self.reason}."


def _lifted(plant: Plant, schedule: PeriodicSchedule) -> tuple[Array, Array, Array]:
    """Monodromy matrix of a lap that begins just after its last sample, rows of its samples, units that balance A.

    Both are in these units, x = units z, so that the units of the plant do not decide what counts as small.
    """
    balanced, (units, _) = matrix_balance(plant.A, permute=False, separate=True)
    flows = expm_batch(np.asarray(balanced, dtype=np.float64), np.cumsum(schedule.gaps))
    rows = (plant.C * units) @ flows
    if schedule.outputs is not None:
        rows = rows * schedule.outputs[:, :, None]
    return flows[-1], rows.reshape(-1, plant.n_states), np.asarray(units, dtype=np.float64)


def _residual(M: Array, rows: Array, mu: complex, z: Complex) -> float:
    sizes = np.linalg.norm(rows, axis=1)
    seen = np.abs(rows @ z)[sizes > 0] / sizes[sizes > 0]
    return float(max(np.linalg.norm(M @ z - mu * z) / np.linalg.norm(M), seen.max(initial=0.0)))


def counterexample(plant: Plant, schedule: PeriodicSchedule, eta: float, found: Existence) -> Counterexample | None:
    """Return the counterexample that a failed existence test stands for, if its equations hold to `RESIDUAL`."""
    M, rows, units = _lifted(plant, schedule)
    values = np.linalg.eigvals(np.asarray(plant.A))
    modes = [found.eigenvalue, *found.partners] if found.eigenvalue is not None else list(values)
    sizes = np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
    best: tuple[float, complex, Complex] | None = None
    for mu in {complex(np.exp(value * schedule.period)) for value in modes}:
        pencil = np.vstack([(M - mu * np.eye(len(M))) / np.linalg.norm(M), rows / sizes])
        z = np.linalg.svd(pencil)[2][-1].conj()
        residual = _residual(M, rows, mu, z)
        if best is None or residual < best[0]:
            best = (residual, mu, z)
    if best is None or best[0] > RESIDUAL:
        return None
    residual, mu, z = best
    direction = tuple(complex(x) for x in units * z / np.linalg.norm(units * z))
    main = found.eigenvalue if found.eigenvalue is not None else complex(values[0])
    return Counterexample(plant, schedule, eta, main, found.partners, mu, direction, residual, found.reason)


@door
def find_counterexample(
    plant: Plant,
    family: SamplingFamily,
    eta: float,
    hints: Iterable[float | None] = (),
    rng: np.random.Generator | None = None,
    quick: bool = False,
) -> tuple[Counterexample | None, tuple[float, PeriodicSchedule]]:
    """Search a periodic schedule of `family` whose lap is not detectable at rate `eta`.

    Parameters
    ----------
    plant : Plant
    family : GapRange, SpacedWindows, LostSamples or Jitter
    eta : float [1/time]
    hints : floats, optional
        Gaps near which to look as well.
    rng : numpy.random.Generator, optional
        Default seed 0.
    quick : bool
        Only the words themselves, shorter patterns, no descent on the margin.

    Returns
    -------
    Counterexample or None, and (margin, schedule)
        The least margin of all words tried (`certificate_exists`), and its schedule.

    Notes
    -----
    *Method.* Two eigenvalues of equal real part alias over a lap of 2 pi k/|Im(lambda_i - lambda_j)|: for every such
    lap that words of up to four gaps can have, the word of equal gaps, some random ones, and the least margin over
    gaps of that sum. For lost samples, every pattern of losses of up to twelve nominal samples.
    """
    eta = positive("eta", eta)
    laps = [float(h) for h in vector("hints", [h for h in hints if h is not None])]
    rng = np.random.default_rng(0) if rng is None else rng
    least: tuple[float, PeriodicSchedule] = (np.inf, period_of(family.nominal))
    tried: list[tuple[float, PeriodicSchedule]] = []
    for schedule in _suspects(plant, family, eta, laps, rng, quick):
        found = certificate_exists(plant, schedule, eta)
        if not found.exists:
            made = counterexample(plant, schedule, eta, found)
            if made is not None:
                return made, (found.margin, schedule)
        tried.append((found.margin, schedule))
        least = min(least, tried[-1], key=lambda pair: pair[0])
    if quick:
        return None, least
    for margin, schedule in sorted(tried, key=lambda pair: pair[0])[:DESCENTS]:
        better = _descend(plant, family, eta, schedule)
        found = certificate_exists(plant, better, eta)
        if not found.exists:
            made = counterexample(plant, better, eta, found)
            if made is not None:
                return made, (found.margin, better)
        if found.margin < min(margin, least[0]):
            least = (found.margin, better)
    return None, least


def refute(
    plant: Plant, family: SamplingFamily, eta: float, hints: Sequence[float | None] = (), quick: bool = False
) -> tuple[float, PeriodicSchedule]:
    """Return the least margin met and its schedule, if no schedule of the family is found that has no certificate.

    Raises
    ------
    CertificateError
        With details `counterexample`, `gaps`, `eigenvalue`, `direction` if one is found.
    """
    found, least = find_counterexample(plant, family, eta, hints, quick=quick)
    if found is None:
        return least
    raise CertificateError(
        f"no certificate with rate {eta:.6g} exists for this family. {found.explain()}",
        counterexample=found,
        gaps=tuple(float(gap) for gap in found.schedule.gaps),
        eigenvalue=found.eigenvalue,
        direction=found.direction,
        period=found.schedule.period,
        eta=eta,
    )


def _suspects(
    plant: Plant,
    family: SamplingFamily,
    eta: float,
    hints: Iterable[float | None],
    rng: np.random.Generator,
    quick: bool,
) -> Iterator[PeriodicSchedule]:
    """Periodic members worth a look: the nominal one, and those that the family suspects."""
    yield period_of(family.nominal)
    laps = sorted({*_aliasing_laps(plant, eta, LONGEST_WORD * family.d_max), *(h for h in hints if h)})
    yield from family.suspects(laps, rng, quick)


def _aliasing_laps(plant: Plant, eta: float, longest: float) -> list[float]:
    """Laps 2 pi k/|Im(a - b)| up to `longest` over the eigenvalues that do not fade by themselves at rate eta."""
    retained = split_modes(plant, decay_rate=eta).retained
    if not retained.n_states:
        return []
    values = np.linalg.eigvals(retained.A)
    first, second = np.triu_indices(values.size, 1)
    apart = values[first] - values[second]
    tied = np.abs(apart.real) <= TIED_RTOL * max(float(np.linalg.norm(retained.A)), 1e-300)
    speeds = np.unique(np.round(np.abs(apart.imag[tied]), 12))
    return [2 * np.pi * k / w for w in speeds if w > 0 for k in range(1, int(longest * w / (2 * np.pi) + 1e-9) + 1)]


def _descend(plant: Plant, family: SamplingFamily, eta: float, start: PeriodicSchedule) -> PeriodicSchedule:
    """The member with the least margin near `start`, as the family varies it."""
    from scipy.optimize import minimize

    near = family.variation(start)
    if near is None:
        return start
    origin, build = near.origin, near.build

    def margin(x: Array) -> float:
        schedule = build(x)
        return certificate_exists(plant, schedule, eta).margin if family.contains(schedule) else 1.0

    simplex = np.vstack([origin, origin + near.spread * np.eye(origin.size) / 2])
    found = minimize(
        margin, origin, method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 60 * origin.size, "xatol": 1e-12, "fatol": 1e-12},
    )  # fmt: skip
    best = build(found.x)
    return best if family.contains(best) else start
