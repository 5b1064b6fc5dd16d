"""Does any certificate with a given rate exist on a periodic schedule? If not: which mode, and what repairs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import matrix_balance

from sampling_design._door import door
from sampling_design._linalg import expm_batch, smallest_singular
from sampling_design._record import Record, short
from sampling_design.errors import CertificateError
from sampling_design.observability.meeting import meet
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.modes import ModalSplit, split_modes
from sampling_design.plants.plant import Plant
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

UNSEEN_TOLERANCE = 1e-9
"""A scaled pencil [e^{AP} - mu I; O] with a singular value below this misses mu: well above rounding (1e-13 for
a period of some time constants), well below any schedule on which an estimate is of use."""
REPAIRED = 1e-2
"""A changed schedule counts as repaired from this singular value on: a hundredth of the scaled rows."""
ALIAS_TOLERANCE = 1e-6
"""Two eigenvalues alias when (a - b) P/(2 pi i) is this near a whole number."""
REPAIR_FRACTIONS = np.geomspace(1e-3, 0.5, 28)
"""Changes of one gap that are tried, as fractions of that gap."""


@dataclass(frozen=True, eq=False, repr=False)
class Existence(Record):
    """Whether some certificate with rate eta exists on a schedule.

    Attributes
    ----------
    exists : bool
    margin : float
        Least singular value of the scaled pencil [e^{A P} - mu I; rows of one lap] over the eigenvalues mu of
        modulus >= e^{-eta P/2}; infinite if there are none. Zero, up to rounding, where a mode is missed.
    eigenvalue : complex or None
        Of A: the mode that the lap does not see.
    partners : tuple of complex
        Eigenvalues of A that it cannot be told from at the sample times.
    period : float
        The lap by which they alias.
    reason : str
    """

    exists: bool
    margin: float
    eigenvalue: complex | None = None
    partners: tuple[complex, ...] = ()
    period: float = 0.0
    reason: str = "every mode that does not fade by itself is seen within a lap"

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("exists", "yes" if self.exists else "no"),
            ("margin", short(self.margin, 3)),
            ("period", short(self.period)),
            ("reason", self.reason),
        ]

    def explain(self) -> str:
        """Say why."""
        return f"{'A' if self.exists else 'No'} certificate exists: {self.reason}."


@door
def certificate_exists(plant: Plant, schedule: PeriodicSchedule | Schedule, eta: float) -> Existence:
    """Decide whether some certificate with rate `eta` exists on a schedule, whatever the weights.

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule or Schedule
        On a finite one a certificate always exists, to its last time.
    eta : float [1/time]

    Returns
    -------
    Existence

    Notes
    -----
    *Claim.* A certificate exists iff every eigenvalue of e^{AP}, P the lap, of modulus at least e^{-eta P/2} is
    observable from the rows C_i e^{A tau_i} of one lap. *Numerical aspects.* Decided on the retained part
    of the plant; `margin` says how clear the verdict is.

    References
    ----------
    Theory of the exact certificate: boundedness of the intermittent filter of (A + eta/2 I, C).

    Examples
    --------
    >>> import numpy as np
    >>> oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> certificate_exists(oscillator, PeriodicSchedule([1.0]), 0.4).exists
    True
    >>> certificate_exists(oscillator, PeriodicSchedule([np.pi]), 0.4).exists
    False
    """
    schedule = meet(plant, schedule)
    if isinstance(schedule, Schedule):
        return Existence(True, float("inf"), period=0.0, reason="a finite schedule is certified to its last time")
    split = split_modes(plant, decay_rate=eta)
    if not split.retained.n_states:
        return Existence(True, float("inf"), period=schedule.period, reason="every mode fades by itself at that rate")
    mu, margin, direction = _least_seen(split, schedule)
    if margin > UNSEEN_TOLERANCE:
        return Existence(True, margin, period=schedule.period)
    main, partners = _involved(split, schedule.period, mu, direction)
    reason = _reason(main, partners, schedule, eta)
    return Existence(False, margin, main, partners, schedule.period, reason)


def require_certificate(plant: Plant, schedule: PeriodicSchedule | Schedule, eta: float) -> Existence:
    """Return the existence test if it is passed.

    Raises
    ------
    CertificateError
        If no certificate exists; its details carry eigenvalue, partners, period and repair.
    """
    found = certificate_exists(plant, schedule, eta)
    if found.exists:
        return found
    assert isinstance(schedule, PeriodicSchedule)
    repair = smallest_repair(plant, schedule, eta)
    words = (
        f"The smallest change of one gap that repairs it: gaps[{repair['gap']}] = {repair['from']:.6g} to "
        f"{repair['to']:.6g}."
        if repair
        else "No change of a single gap repairs it."
    )
    raise CertificateError(
        f"no certificate with rate {eta:.6g} exists on this schedule: {found.reason}. {words}",
        eigenvalue=found.eigenvalue,
        partners=found.partners,
        period=found.period,
        margin=found.margin,
        repair=repair,
    )


@door
def smallest_repair(plant: Plant, schedule: PeriodicSchedule, eta: float) -> dict[str, Any] | None:
    """Return the smallest change of one gap after which the lap sees every mode with margin, or None.

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule
    eta : float [1/time]

    Returns
    -------
    dict or None
        Keys `gap` (index), `from`, `to` [time] and `margin` reached.

    Notes
    -----
    *Method.* Every gap is lengthened and shortened by 28 fractions from 0.1 % to 50 %, smallest change first;
    the first change with margin at least 0.01 is returned, so the answer is checked.
    """
    split = split_modes(plant, decay_rate=eta)
    changes = np.outer(schedule.gaps, REPAIR_FRACTIONS)
    for flat in np.argsort(changes, axis=None, kind="stable"):
        gap, column = np.unravel_index(flat, changes.shape)
        for sign in (1.0, -1.0):
            gaps = np.array(schedule.gaps)
            gaps[gap] += sign * changes[gap, column]
            changed = PeriodicSchedule(gaps, outputs=schedule.outputs, time_unit=schedule.time_unit)
            margin = _least_seen(split, changed)[1]
            if margin >= REPAIRED:
                return {
                    "gap": int(gap),
                    "from": float(schedule.gaps[gap]),
                    "to": float(gaps[gap]),
                    "margin": float(margin),
                }
    return None


def _least_seen(split: ModalSplit, schedule: PeriodicSchedule) -> tuple[complex, float, Complex]:
    """The lap's eigenvalue mu with the least pencil singular value, that value, and its right singular vector."""
    part = split.retained
    period = schedule.period
    # in units of the states that balance A: those of the plant may differ by any power of ten
    balanced, (units, _) = matrix_balance(part.A, permute=False, separate=True)
    A: Array = np.asarray(balanced, dtype=np.float64)
    rows = (part.C * units) @ expm_batch(A, schedule.times - schedule.times[0])
    if schedule.outputs is not None:
        rows = rows * schedule.outputs[:, :, None]
    stacked = rows.reshape(-1, part.n_states)
    lap = expm_batch(A, period)[0]
    # each state counts as large as what the outputs show of it: rows and flow are compared in that scale
    size = np.linalg.norm(stacked) or 1.0
    values = np.unique([np.exp(c.value * period) for c in split.retained_clusters])
    pencils = np.stack(
        [
            np.vstack([(lap - mu * np.eye(part.n_states)) / max(np.linalg.norm(lap), abs(mu)), stacked / size])
            for mu in np.concatenate([values, values.conj()])
        ]
    )
    singular = smallest_singular(pencils)
    worst = int(np.argmin(singular))
    direction = units * np.linalg.svd(pencils[worst])[2][-1].conj()
    direction /= np.linalg.norm(direction)
    return complex(np.concatenate([values, values.conj()])[worst]), float(singular[worst]), direction


def _involved(split: ModalSplit, period: float, mu: complex, direction: Complex) -> tuple[complex, tuple[complex, ...]]:
    """The eigenvalues of A of which the unseen direction is made, the largest share first."""
    values, vectors = np.linalg.eig(split.retained.A)
    shares = np.abs(np.linalg.lstsq(vectors, direction, rcond=None)[0])
    near = np.abs(np.exp(values * period) - mu) <= ALIAS_TOLERANCE * max(abs(mu), 1e-300)
    order = [k for k in np.argsort(-np.round(shares, 9), kind="stable") if near[k] and shares[k] > 1e-6]
    if not order:
        order = [int(np.argmin(np.abs(np.exp(values * period) - mu)))]
    found = [complex(values[k]) for k in order]
    main = next((v for v in found if v.imag > 0), found[0])
    return main, tuple(v for v in found if v != main)


def _reason(main: complex, partners: tuple[complex, ...], schedule: PeriodicSchedule, eta: float) -> str:
    name = format_eigenvalue(main, grain=1e-12 * abs(main))
    distinct = [v for v in partners if abs(v - main) > ALIAS_TOLERANCE * max(abs(main), 1e-300)]
    if not distinct:
        rate = f"; it decays at {short(-2 * main.real)} only, so eta must stay below that" if main.real < 0 else ""
        return f"the eigenvalue {name} is seen by no sample of the lap{rate}"
    turns = round(abs((main - distinct[0]).imag) * schedule.period / (2 * np.pi))
    every = np.abs((main - distinct[0]).imag) * schedule.gaps / (2 * np.pi)
    by_gap = np.all(np.abs(every - np.round(every)) <= ALIAS_TOLERANCE * np.maximum(every, 1))
    what = f"{turns} turn{'s' * (turns != 1)} of their difference fit into the period {short(schedule.period)}"
    if by_gap and len(schedule) > 1:
        what += " and whole turns into every gap"
    others = ", ".join(format_eigenvalue(v, grain=1e-12 * abs(v)) for v in distinct)
    return f"the eigenvalue {name} is aliased with {others}: {what}"
