"""How much a planned schedule may be broken before its certificate is: timing errors and lost samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import comb
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from sampling_design.certificates.certification import certify
from sampling_design.certificates.exact.certificate import Certificate, SampledCertificate
from sampling_design.certificates.exact.given_weights import NoiseWeights
from sampling_design.certificates.existence.periodic import certificate_exists
from sampling_design.certificates.families.certify_family import FamilyProposal, FamilySearch, certified
from sampling_design.certificates.families.family_certificate import FamilyCertificate
from sampling_design.certificates.families.graphs import MOST_NODES, in_plant_terms
from sampling_design.certificates.form.claims import RESOLUTION
from sampling_design.errors import ArgumentError, SamplingDesignError, UndecidedError
from sampling_design.observability.count.functional import part_for
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant, first_difference
from sampling_design.records import checks
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.record import PlainRecord, TableRecord, above, below, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import SamplingFamily, period_of
from sampling_design.schedules.jitter import Jitter
from sampling_design.schedules.lost_samples import LostSamples
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

RADIUS_RTOL = 0.02
"""Width of the bisection on the radius, as a fraction of the largest one that keeps the order of samples."""
LARGEST_PART = 0.999  # the radius stays below this fraction of half the least gap: there samples could change places
FIRST_RADIUS = 1 / 8  # share of that radius which is tried first, then twice as much: what is small is decided soonest
JITTER_MEMORY = 2  # levels of memory that are tried for jitter
PROVING = 0.25  # share of the budget that ball arithmetic has at least for what doubles leave undecided
MOST_UNKNOWNS = 1200  # unknowns of one semidefinite program; a graph with more is taken with less memory


Family = TypeVar("Family", bound=SamplingFamily)


@dataclass(frozen=True)
class FamilyTrial(Generic[Family]):
    """A family that was tried with the unchanged weights: its lambda, and whether the certificate survives on it.

    Where it does not, lambda is that of the semidefinite program on its grid of gaps (infinite: none). `certificate` is
    that of a family that was asked about by name.
    """

    family: Family
    lam: float
    survives: bool
    certificate: FamilyCertificate | None = None

    def __bool__(self) -> bool:
        return self.survives


@dataclass(frozen=True, eq=False, repr=False)
class Robustness(TableRecord, PlainRecord):
    """Timing errors and losses under which a certificate survives.

    It survives if a family certificate with the same P2, Qw, R, Qv and eta holds whose lambda still lets the same
    horizon contract, lambda e^{-eta M} < 1: the estimator need not be changed in anything.

    Attributes
    ----------
    certificate : Certificate
        Of the planned schedule.
    length : float [time]
        The horizon M.
    limit : float
        e^{eta M}: the certificate survives up to this lambda.
    radius : float [time]
        Proven: every sample may be this much early or late.
    broken : float [time]
        The least radius that was tried without success, or where samples could change places.
    trials : tuple of FamilyTrial of Jitter
        In the order of their `family.timing_tolerance`.
    losses : tuple of FamilyTrial of LostSamples
        All that were tried, `family.most` of any `family.of` samples lost.
    jittered : FamilyCertificate or None
        The certificate at `radius`, `verify()` passed; None if radius = 0.
    thinned : tuple of FamilyCertificate
        One for each entry of `tolerated`, `verify()` passed.
    others : tuple of FamilyTrial
        The families that were asked about.
    closed : bool
        False if the budget ran out, or after an interrupt: what is proven stays proven, but more may survive.
    """

    certificate: Certificate
    length: float
    limit: float
    radius: float
    broken: float
    trials: tuple[FamilyTrial[Jitter], ...]
    losses: tuple[FamilyTrial[LostSamples], ...]
    jittered: FamilyCertificate | None
    thinned: tuple[FamilyCertificate, ...]
    others: tuple[FamilyTrial[SamplingFamily], ...]
    closed: bool

    _frame = "trials{amount:family.timing_tolerance lam survives}"
    _plain = (
        "horizon:length limit radius broken tolerated trials{amount:family.timing_tolerance lam survives} "
        "losses{most:family.most of:family.of lam survives} families:others{family lam survives} closed"
    )

    @property
    def tolerated(self) -> tuple[tuple[int, int], ...]:
        """(d, w): at most d of any w consecutive samples may be lost, w the least for each d."""
        leeways = [c.family.leeway for c in self.thinned]
        return tuple((leeway.most, leeway.of) for leeway in leeways if leeway is not None)

    _answers = (
        "how late samples may come, and how many may be lost, with the weights and the horizon of a certificate",
        "proven: a certificate for each family of schedules that is named",
        "samples up to {radius:down} {certificate.plant.time_unit} early or late, losses up to {_lost}",
        "`.jittered.verify()`, `.thinned[0].verify()`",
    )

    def _lost(self, between: str = ", ") -> str:
        return between.join(f"{d} of any {w}" for d, w in self.tolerated) or "none"

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.certificate.plant.time_unit
        beyond = (
            f"not proven at {above(self.broken)} {unit}" if self.broken > self.radius else "all that keeps the order"
        )
        return [
            ("later samples", beyond),
            *((trial.family.kind, "survives" if trial.survives else "not proven") for trial in self.others),
            ("horizon kept", f"{short(self.length)} {unit}"),
            ("lambda, planned", above(self.certificate.lam)),
            ("lambda, limit", short(self.limit)),
            ("searches closed", "yes" if self.closed else "no, the budget ran out or an interrupt came"),
        ]

    def explain(self) -> str:
        """Say what may go wrong without harm."""
        unit = self.certificate.plant.time_unit
        lost = self._lost(" or ") if self.tolerated else ""
        late = f"every sample is up to {below(self.radius)} {unit} early or late" if self.radius else ""
        thin = f"samples are on time and up to {lost} are lost" if lost else ""
        other = [f"samples are those of the {trial.family.kind} family" for trial in self.others if trial.survives]
        if not (late or thin or other):
            return "With weights and horizon unchanged, no timing error and no loss was found that is harmless."
        return (
            f"With weights and horizon ({short(self.length)} {unit}) unchanged, the guarantee still holds if "
            f"{', or if '.join(part for part in (late, thin, *other) if part)}."
        )


@runtime_checkable
class HasSchedule(Protocol):
    """What holds a schedule: a certificate about samples, or a design."""

    @property
    def schedule(self) -> Schedule | PeriodicSchedule | None:
        """The schedule."""


class RobustnessSearch:
    """Families around one schedule, judged with the weights of its certificate."""

    def __init__(self, certificate: Certificate, limit: float, budget: Budget, report: Progress) -> None:
        self.certificate, self.limit, self.whole, self.budget, self.report = certificate, limit, budget, budget, report
        c = certificate
        self.plant, self.weights = c.plant, NoiseWeights(c.Qw, c.R, c.Qv)
        self.late = False

    def judge(self, family: SamplingFamily, levels: Iterable[int]) -> tuple[float, FamilyProposal | None]:
        """The lambda of a family, and its proposal if it survives; infinite where there is none."""
        best = np.inf
        for level in levels:
            if self.budget.over:
                self.late = True
                break
            within = in_plant_terms(self.plant, family)
            search = FamilySearch(self.plant, within, self.weights, self.certificate.P2, np.inf, self.budget)
            try:
                proposal = search.propose(self.certificate.eta, level, worst=self.limit * (1 - RESOLUTION))
            except SamplingDesignError:
                break  # the graph of this level is too large, or the nominal schedule on the edge
            except KeyboardInterrupt:
                self.whole.stop()
                break
            best = min(best, proposal.lam)
            if proposal.P is not None and proposal.lam / (1 - RESOLUTION) < self.limit:
                return proposal.lam, proposal
        self.late = self.late or self.budget.over
        return best, None

    def proven(self, family: SamplingFamily, proposal: FamilyProposal) -> FamilyCertificate:
        """The certificate of a proposal; after an interrupt it is made all the same, and nothing else is sought."""
        given = self.plant, in_plant_terms(self.plant, family), self.weights, proposal
        longest = max(self.whole.left, PROVING * self.whole.seconds)
        try:
            return certified(*given, longest)
        except KeyboardInterrupt:
            self.whole.stop()
            return certified(*given, longest)

    def tried(self, family: SamplingFamily) -> FamilyTrial[SamplingFamily]:
        """One family, with as much memory as is tried for timing errors."""
        if not isinstance(family, SamplingFamily):
            raise ArgumentError(f"`families` must hold families of schedules, got {checks.described(family)}.")
        member = in_plant_terms(self.plant, family).nominal
        if not certificate_exists(self.plant, member, self.certificate.eta).exists:
            return FamilyTrial(family, np.inf, False)
        lam, proposal = self.judge(family, range(min(JITTER_MEMORY, family.levels_of_memory)))
        made = self.certificate_of_last([] if proposal is None else [(family, proposal)])
        return FamilyTrial(family, lam, made is not None, made)

    def certificate_of_last(self, survived: list[tuple[Family, FamilyProposal]]) -> FamilyCertificate | None:
        """The certificate of the last family whose proof closes; those after it are taken away."""
        while survived:
            with suppress(UndecidedError):
                return self.proven(*survived[-1])
            survived.pop()
        return None

    def largest_radius(
        self, schedule: PeriodicSchedule
    ) -> tuple[float, float, list[FamilyTrial[Jitter]], FamilyCertificate | None]:
        """The largest timing error that is proven, the least that is not, all that were tried, and its certificate."""
        top = LARGEST_PART * schedule.min_gap / 2
        low, high, survived = 0.0, top, list[tuple[Jitter, FamilyProposal]]()
        tried = [(Jitter(schedule, 0.0), self.certificate.lam)]
        radius = FIRST_RADIUS * top
        while high - low > RADIUS_RTOL * top and not self.late:
            self.report(0.5 * (1 - (high - low) / top), f"timing error {short(radius, 3)}")
            family = Jitter(schedule, radius)
            lam, proposal = self.judge(family, range(JITTER_MEMORY))
            if self.late:
                break
            tried.append((family, lam))
            if proposal is None:
                high = radius
            else:
                low, survived = radius, [*survived, (family, proposal)]
            failed = len(tried) > len(survived) + 1  # the schedule itself is the first that was tried
            radius = (low + high) / 2 if failed else min(2 * low, top)
        made = self.certificate_of_last(survived)
        low = survived[-1][0].timing_tolerance if survived else 0.0
        trials = [FamilyTrial(family, lam, family.timing_tolerance <= low) for family, lam in tried]
        trials.sort(key=lambda trial: trial.family.timing_tolerance)
        broken = min((trial.family.timing_tolerance for trial in trials if not trial), default=top)
        return low, broken, trials, made

    def most_losses(
        self, schedule: PeriodicSchedule, longest: int
    ) -> tuple[list[FamilyTrial[LostSamples]], list[FamilyCertificate]]:
        """For d = 1, 2, ... the least w for which d of any w may be lost, until there is none."""
        tried: list[FamilyTrial[LostSamples]] = []
        certificates: list[FamilyCertificate] = []
        for d in range(1, longest):
            self.report(0.5 + 0.5 * d / longest, f"{d} lost")
            found, survived = list[tuple[LostSamples, float]](), list[tuple[LostSamples, FamilyProposal]]()
            low, high = d, longest + 1  # w = low fails (all lost), w = high is not asked for
            w = longest
            while high - low > 1 and not self.late:
                family = LostSamples(schedule, d, w)
                lam, proposal = self.judge(family, [self._loss_level(family)])
                if self.late:
                    break
                found.append((family, lam))
                if proposal is None:
                    low = w
                else:
                    high, survived = w, [*survived, (family, proposal)]
                w = (low + high) // 2
            made = self.certificate_of_last(survived)
            least = survived[-1][0].of if survived else np.inf
            tried += [FamilyTrial(family, lam, family.of >= least) for family, lam in found]
            if made is None:
                break
            certificates.append(made)
        return sorted(tried, key=lambda trial: (trial.family.most, trial.family.of)), certificates

    def _loss_level(self, family: LostSamples) -> int:
        """As much memory as the unknowns allow: words are more with every level."""
        n, period = self.plant.n_states, len(period_of(family.schedule))
        for level in range(1, family.levels_of_memory):
            words = sum(comb(family.most + level, k) for k in range(family.most + 1))
            if words * period > MOST_NODES or words * period * n * (n + 1) // 2 > MOST_UNKNOWNS:
                return level - 1
        return family.levels_of_memory - 1


@checked
def robustness(
    plant: Plant,
    certificate: SampledCertificate | HasSchedule,
    *,
    horizon: float | None = None,
    longest: int = 8,
    families: Sequence[SamplingFamily] = (),
    of: Wanted = None,
    budget: float = 60.0,
    progress: Progress | None = None,
) -> Robustness:
    """Return the largest timing error and the most losses under which a certificate survives.

        lambda(family) e^{-eta M} < 1,    family = all schedules with every sample at most r early or late,
                                          or with at most d of any w consecutive samples lost

    Parameters
    ----------
    plant : Plant
    certificate : Certificate or ScheduleDesign
        On a PeriodicSchedule; a design is certified first.
    horizon : float, optional [time]
        The horizon M that is to be kept. Default: `certificate.horizon().length`.
    longest : int
        Losses are counted among at most this many consecutive samples.
    families : sequence of SamplingFamily
        Others, of any kind, on whose schedules the certificate might survive; each is answered as it stands.
    of : str, sequence of str, or (k, n) array, optional
        The rows of the state that the certificate is about; a design is certified for them. Default: all states.
    budget : float [seconds]
        The searches stop there, or at an interrupt (KeyboardInterrupt) once something is proven; `closed` says so.
    progress : callable, optional
        Called with (fraction, message).

    Returns
    -------
    Robustness

    Raises
    ------
    ArgumentError
        If the schedule is not periodic, the certificate is another plant's, or the horizon is too short even for
        the schedule as planned.

    Notes
    -----
    *Claim.* What is kept is proven at `radius` and for `tolerated` (family certificates, verified); that more does not
    survive is not claimed, for family certificates are sufficient. *Method.* Bisection on the radius; for every d
    the least w.

    Examples
    --------
    >>> oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> planned = certify(oscillator, PeriodicSchedule([1.0]), eta=0.4, P2=[[0.5, 0.0], [0.0, 0.5]])
    >>> found = robustness(oscillator, planned, longest=3)
    >>> found.radius > 0.1, found.jittered.verify().passed
    (True, True)
    """
    plant, report = part_for(plant, of), progress or (lambda fraction, message: None)
    match certificate:
        case FamilyCertificate():
            raise ArgumentError(
                "`certificate` must be about one schedule, got a FamilyCertificate, which is itself about a family "
                "of schedules. Certify the schedule that is planned."
            )
        case Certificate():
            planned = certificate
        case HasSchedule(schedule=Schedule() | PeriodicSchedule() as schedule):
            planned = certify(plant, schedule)
        case _:
            raise ArgumentError(f"`certificate` must be one about samples, got {checks.described(certificate)}.")
    schedule = period_of(
        planned.schedule, "`certificate` must be on a PeriodicSchedule: losses and delays are counted without end."
    ).primitive()
    if other := first_difference(plant, planned.plant):
        raise ArgumentError(f"`certificate` certifies another plant: {other}.")
    M = planned.horizon().length if horizon is None else checks.positive("horizon", horizon)
    with np.errstate(over="ignore"):  # infinite: any certificate suffices
        limit = float(np.exp(planned.eta * M))
    if planned.lam_proven >= limit:
        least = planned.horizon().minimum
        raise ArgumentError(
            f"`horizon` = {short(M)} is too short for the planned schedule: it needs M > {short(least)}."
        )
    most = checks.whole("longest", longest, 2)
    whole = Budget(checks.positive("budget", budget))
    search = RobustnessSearch(planned, limit, whole, report)
    others = tuple(search.tried(family) for family in families)
    search.budget = whole.share(0.5)
    radius, broken, trials, jittered = search.largest_radius(schedule)
    search.budget, search.late, closed = whole, False, not search.late
    losses, thinned = search.most_losses(schedule, most)
    if whole.limit < 0 and not (radius or thinned):
        raise KeyboardInterrupt
    return Robustness(
        certificate=planned, length=M, limit=limit, radius=radius, broken=broken, trials=tuple(trials),
        losses=tuple(losses), jittered=jittered, thinned=tuple(thinned), others=others,
        closed=closed and not search.late,
    )  # fmt: skip
