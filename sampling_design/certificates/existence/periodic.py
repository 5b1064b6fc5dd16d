"""Does any certificate with a given rate exist on a periodic schedule? If not: which mode, and what repairs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from sampling_design.errors import CertificateError, UndecidedError
from sampling_design.numerics.filtering import measurement_update, propagate
from sampling_design.numerics.linalg import balance, balanced, balanced_rows, expm_batch, positive_or_one
from sampling_design.observability.alignment import align
from sampling_design.observability.count.functional import part_for, rows_between_samples
from sampling_design.observability.count.period_modes import LeastObservedMode, PeriodModes, period_modes
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.functional import FunctionalPlant, Wanted
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.record import PlainRecord, YesOrNo, below, short
from sampling_design.records.signatures import checked, open_verb
from sampling_design.schedules.family import period_of
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

UNOBSERVED_TOLERANCE = 1e-9
"""A scaled pencil [e^{AP} - mu I; O] with a singular value below this misses mu: well above rounding (1e-13 for
a period of some time constants), well below any schedule on which an estimate is of use."""
REPAIRED = 1e-2  # a changed schedule counts as repaired from this singular value on: a hundredth of the scaled rows
ALIAS_TOLERANCE = 1e-6  # two eigenvalues alias when (a - b) P/(2 pi i) is this near a whole number
NEARLY = 1e-2  # eigenvalues a, b take part in one unobservable direction if e^{(a - b) P} is this near 1
MOST_PERIODS, FEWEST_PERIODS, MOST_UPDATES = 400, 40, 8000
"""Of the run that checks a "no": what grows at least linearly is told from what settles after some tens of periods."""
SETTLING, SETTLED = 10, 1e-4
"""Y has settled if it changes by less than this part of itself over so many periods, in every direction (linear growth:
2.5e-2 of itself after 400 periods)."""
HUGE = UNOBSERVED_TOLERANCE**-2
"""Covariance that a mode observed as little as that leaves: beyond it, Y counts as unbounded."""
REPAIR_FRACTIONS = np.geomspace(1e-3, 0.5, 28)  # changes of one gap that are tried, as fractions of that gap


class ExistenceAnswer(YesOrNo):
    """Whether a certificate exists for every plant that was asked about, `margin` from the answer no, and why."""

    exists: bool
    margin: float
    reason: str

    def _answer(self) -> bool:
        return self.exists


@dataclass(frozen=True, eq=False, repr=False)
class Existence(ExistenceAnswer, PlainRecord):
    """Whether some certificate with rate eta exists on a schedule: true if one does.

    Attributes
    ----------
    exists : bool
    margin : float
        Least singular value of the scaled pencil [e^{A P} - mu I; rows of one period] over the eigenvalues mu of
        modulus >= e^{-eta P/2}; infinite if there are none. Zero, up to rounding, where a mode is missed; about as
        far from it, relatively, as the period is from one at which two modes are aliased. In units of its own:
        every mode counts as large as what the period shows of it.
    eigenvalue : complex or None
        Of A: the mode that the period does not see.
    partners : tuple of complex
        Eigenvalues of A that it cannot be told from at the sample times.
    period : float
        The period by which they alias.
    reason : str
    """

    exists: bool
    margin: float
    eigenvalue: complex | None = None
    partners: tuple[complex, ...] = ()
    period: float = 0.0
    reason: str = "every mode that does not decay by itself is observable within a period"

    _plain = "exists margin period reason"
    _answers = (
        "whether some certificate of that rate exists on the schedule: {exists}",
        "proven: the modes that do not decay at that rate decide it, up to rounding",
        "margin {margin:3}; 0 would be the answer no",
        "`certify` finds one where it exists",
    )
    _table = {"reason": "{reason}"}

    def explain(self) -> str:
        """Say why."""
        return f"{'A' if self.exists else 'No'} certificate exists: {self.reason}."


@open_verb(ExistenceAnswer)
def certificate_exists(
    plant: Plant, schedule: PeriodicSchedule | Schedule, eta: float, of: Wanted = None, *, budget: float = 60.0
) -> Existence:
    """Decide whether some certificate with rate `eta` exists on a schedule, whatever the weights.

    Parameters
    ----------
    plant : Plant or UncertainPlant
        With constant parameters in a box: whether each plant of it has one, proven by gains in cells of the box.
    schedule : PeriodicSchedule or Schedule
        On a finite one a certificate always exists, to its last time.
    eta : float [1/time]
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows (`functional_plant`).
        Default: all states.
    budget : float [seconds]
        Over a box; what has neither been proven nor refuted then is undecided.

    Returns
    -------
    Existence, or ExistenceOverBox

    Raises
    ------
    NotDetectableError
        If rows are asked for, all states by name among them, into which a mode enters that no output shows and that
        does not decay at the rate: no schedule could be an answer. Of all states, unnamed, the answer is no.
    UndecidedError
        If the lifted pair misses a mode as far as rounding can tell, and yet the filter's covariance stays bounded; or
        the samples are so dense that two modes that longer periods tell apart are one to rounding; or, over a box, the
        budget ran out.

    Notes
    -----
    *Claim.* A certificate exists iff every eigenvalue of e^{AP}, P the period, of modulus at least e^{-eta P/2} is
    observable from the rows C_i e^{A tau_i} of one period, one of that very modulus being driven. *Method.* In the
    coordinates of the invariant subspaces of those modes, each column as large as what the outputs show of it, so
    that units change nothing. *Numerical aspects.* `margin` says how clear the verdict is. A "no" is said only if a
    run of the discounted covariance over many periods does not settle.

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
    plant = part_for(plant, of, decay_rate=eta)
    schedule = align(plant, schedule)
    if not schedule.endless:
        return Existence(True, float("inf"), period=0.0, reason="a finite schedule is certified to its last time")
    existence = judged(plant, schedule, eta)
    if existence.exists:
        return existence
    question = f"whether a certificate with rate {eta:.6g} exists on this schedule is undecided"
    if turn := too_dense(plant, schedule, eta, existence):
        raise UndecidedError(
            f"{question}: its samples are so dense that {existence.eigenvalue:.4g} and the eigenvalues beside it "
            f"differ by only {turn:.3g} in a period of {schedule.period:.4g}, which rounding hides (margin "
            f"{below(existence.margin, 3)}). Sample less often, or count a part of the samples as one.",
            **_missed(existence),
        )
    if stays_bounded(plant, schedule, eta):
        raise UndecidedError(
            f"{question}: {existence.reason}, as far as rounding can tell (margin {below(existence.margin, 3)}), yet "
            "the discounted covariance of the filter stays bounded. Move a sample, or scale the plant.",
            **_missed(existence),
        )
    return existence


def _missed(existence: Existence) -> dict[str, object]:
    """What an error says of the mode that a schedule misses."""
    return {key: getattr(existence, key) for key in ("eigenvalue", "partners", "period", "margin")}


def judged(plant: Plant, schedule: PeriodicSchedule, eta: float) -> Existence:
    """Return what the lifted pair says alone, for searches that ask about many schedules."""
    modes = period_modes(plant, float(eta))
    if not modes.blocks:
        return Existence(True, float("inf"), period=schedule.period, reason="every mode decays by itself at that rate")
    least = modes.least_observed(schedule)
    if least.margin > REPAIRED:
        return Existence(True, least.margin, period=schedule.period)
    main, partners = _involved(modes, least, schedule.period)
    reason = _reason(main, partners, schedule)
    if least.margin > UNOBSERVED_TOLERANCE:
        claim = f"every mode that does not decay by itself is observable, but barely (margin {below(least.margin, 3)})"
        reason = f"{claim}: nearly, {reason}"
        return Existence(True, least.margin, period=schedule.period, reason=reason)
    if isinstance(plant, FunctionalPlant):
        reason += rows_between_samples(plant, schedule, eta)
    return Existence(False, least.margin, main, partners, schedule.period, reason)


def too_dense(plant: Plant, schedule: PeriodicSchedule, eta: float, existence: Existence) -> float:
    """How far the modes that a period does not tell apart turn within it, if a longer one tells them apart; else 0."""
    main = existence.eigenvalue or 0j
    turns = [abs(main - other) * schedule.period for other in existence.partners]
    if not turns or not 0 < max(turns) <= NEARLY:
        return 0.0
    longer = PeriodicSchedule(schedule.gaps / max(turns), outputs=schedule.outputs)
    return max(turns) if judged(plant, longer, eta).exists else 0.0


def require_certificate(plant: Plant, schedule: PeriodicSchedule | Schedule, eta: float) -> Existence:
    """Return the existence test if it is passed.

    Raises CertificateError if no certificate exists; its details carry eigenvalue, partners, period and repair.
    """
    existence = certificate_exists(plant, schedule, eta)
    if existence.exists:
        return existence
    whole = period_of(schedule)
    repair = smallest_repair(plant, whole, eta)
    words = (
        f"The smallest change of one gap that repairs it: gaps[{repair['gap']}] = {repair['from']:.6g} to "
        f"{repair['to']:.6g}, which makes the period {whole.period - repair['from'] + repair['to']:.6g}."
        if repair
        else "No change of a single gap repairs it."
    )
    raise CertificateError(
        f"no certificate with rate {eta:.6g} exists on this schedule: {existence.reason}. {words}",
        **_missed(existence),
        repair=repair,
    )


Repair = TypedDict("Repair", {"gap": int, "from": float, "to": float, "margin": float})
"""One gap of a period, by its index, and what it becomes; `margin` is what it shows then."""


@checked
def smallest_repair(plant: Plant, schedule: PeriodicSchedule, eta: float) -> Repair | None:
    """Return the smallest change of one gap after which the period sees every mode with margin, or None.

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
    schedule, modes = align(plant, schedule), period_modes(plant, float(eta))
    if not modes.blocks:
        return None
    changes = np.outer(schedule.gaps, REPAIR_FRACTIONS)
    for flat in np.argsort(changes, axis=None, kind="stable"):
        gap, column = np.unravel_index(flat, changes.shape)
        for sign in (1.0, -1.0):
            gaps = np.array(schedule.gaps)
            gaps[gap] += sign * changes[gap, column]
            changed = PeriodicSchedule(gaps, outputs=schedule.outputs, time_unit=schedule.time_unit)
            margin = modes.least_observed(changed).margin
            if margin >= REPAIRED:
                return {
                    "gap": int(gap),
                    "from": float(schedule.gaps[gap]),
                    "to": float(gaps[gap]),
                    "margin": float(margin),
                }
    return None


def _involved(modes: PeriodModes, least: LeastObservedMode, period: float) -> tuple[complex, tuple[complex, ...]]:
    """The eigenvalues of A of which the unobservable direction is made, the largest share first."""
    shares = [
        (float(share), c) for block, share in zip(modes.blocks, least.shares, strict=True) for c in block.clusters
    ]
    # a turn more or less in e^{(a - b) P} does not count; what is left is how far a and b are from being aliased
    turns = ((share, c.value, (c.value - least.rate) * period) for share, c in shares)
    near = [(share, v) for share, v, z in turns if abs(np.expm1(complex(min(z.real, 1.0), z.imag))) <= NEARLY]
    eigenvalues = [v for share, v in sorted(near, key=lambda pair: -round(pair[0], 9)) if share > 1e-6] or [least.rate]
    main = next((v for v in eigenvalues if v.imag > 0), eigenvalues[0])
    return main, tuple(v for v in eigenvalues if v != main)


def stays_bounded(plant: Plant, schedule: PeriodicSchedule, eta: float) -> bool:
    """Whether the discounted covariance settles in a run over many periods: then some certificate does exist.

        Y -> F Y F' + I,  F = e^{(A + eta/2 I) h};    Y -> Y - Y C'(C Y C' + I)^{-1} C Y at a sample

    Notes
    -----
    *Claim.* Y is bounded iff a certificate exists, whatever the weights. This run shares neither modes nor singular
    values with the test that it checks. An unobservable mode grows by at least I a period, so Y never settles; where it
    grows beyond all numbers it does not settle either.
    """
    d = balance(plant.A * schedule.period).d  # of chains alone only time says how fast they are
    A = balanced(plant.A, d) + eta / 2 * np.eye(plant.n_states)
    C = balanced_rows(plant.C, d)
    C = C / positive_or_one(np.linalg.norm(C, axis=1))[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        flows = expm_batch(A, np.append(schedule.gaps[1:], schedule.gaps[0]))
        if not np.isfinite(flows).all():
            return False
        Y = last = np.eye(plant.n_states)
        for cycle in range(max(FEWEST_PERIODS, min(MOST_PERIODS, MOST_UPDATES // len(schedule)))):
            for i, F in enumerate(flows):
                rows = C if schedule.outputs is None else C[schedule.outputs[i]]
                Y = propagate(measurement_update(Y, rows), F, np.eye(len(Y)) / len(flows))
                if not np.isfinite(Y).all() or np.max(np.abs(Y)) > HUGE:
                    return False
            if cycle % SETTLING == SETTLING - 1:
                # relative in every direction: what grows slowly may hide beside what is large
                if _change(last, Y) <= SETTLED:
                    return True
                last = Y
    return False


def _change(last: Array, Y: Array) -> float:
    """How far Y is from `last`, relative to it, where that is most; infinite where rounding hides it."""
    try:
        return float(np.max(np.abs(np.linalg.eigvals(np.linalg.solve(last, Y - last)))))
    except np.linalg.LinAlgError:
        return float("inf")


def _reason(main: complex, partners: tuple[complex, ...], schedule: PeriodicSchedule) -> str:
    name = format_eigenvalue(main, grain=1e-12 * abs(main))
    if not partners:
        faded = main.real * schedule.period < -ALIAS_TOLERANCE  # less is rounding of an eigenvalue on the axis
        rate = f"; it decays at {short(-2 * main.real)} only, so eta must stay below that" if faded else ""
        return f"the eigenvalue {name} is observable from no sample of the period{rate}"
    aliased = [v for v in partners if _multiples_of_2_pi(main - v, schedule.period)]
    others = ", ".join(format_eigenvalue(v, grain=1e-12 * abs(v)) for v in aliased or partners)
    if not aliased:
        apart = max(abs(v - main) for v in partners)
        why = f"the samples of a period of {short(schedule.period)} do not distinguish them"
        return f"the eigenvalue {name} lies within {short(apart)} of {others}: {why}"
    multiples = _multiples_of_2_pi(main - aliased[0], schedule.period)
    every = np.abs((main - aliased[0]).imag) * schedule.gaps / (2 * np.pi)
    by_gap = np.all(np.abs(every - np.round(every)) <= ALIAS_TOLERANCE * np.maximum(every, 1))
    many = "2 pi" if multiples == 1 else f"{multiples} times 2 pi"
    what = f"their difference is {many} over the period {short(schedule.period)}"
    if by_gap and len(schedule) > 1:
        what += " and a multiple of 2 pi over every gap"
    return f"the eigenvalue {name} is aliased with {others}: {what}"


def _multiples_of_2_pi(difference: complex, period: float) -> int:
    """By how many times 2 pi two eigenvalues differ over a period; none where they are nearly one."""
    return round(abs(difference.imag) * period / (2 * np.pi))
