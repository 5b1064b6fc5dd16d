"""From a plant that is not exactly known and its schedules to a proven certificate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Unpack

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.certification import certify
from sampling_design.certificates.exact.bound_weights import CertifyOptions
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.certificates.exact.given_weights import above_one, certifiable_schedule, weights_of
from sampling_design.certificates.existence.counterexample import find_counterexample
from sampling_design.certificates.families.certify_family import best_rates
from sampling_design.certificates.families.graphs import PathCompleteGraph, in_plant_terms
from sampling_design.certificates.form.verdict import Verification
from sampling_design.errors import ArgumentError, CertificateError, UndecidedError
from sampling_design.numerics.conic_programs import NO_TIME
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.record import below, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import SamplingFamily, period_of
from sampling_design.schedules.gap_range import GapRange
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate
from sampling_design.uncertain.inclusion.members import Schedules, graph_for, layout_of
from sampling_design.uncertain.inclusion.search import InclusionSearch
from sampling_design.uncertain.plants.uncertain_plant import LinearInclusion

PIECES = (8, 16, 32)  # pieces of P(tau) that are tried one after the other where a number is not given
ENOUGH = 0.05  # share by which twice as many pieces must shorten the horizon for the next number to be tried
RATES, FINER_RATES = 5, 2
SUSPECTS = 24
"""Constant plants in which a schedule without certificate is looked for."""
LONGEST_LOOK = 6.0  # seconds of that search
MOST_UNKNOWNS = 4000  # of a program with more memory than the least: it would take minutes
BISECTIONS, CLOSE = 12, 1.003  # of the longest gap: at most so many, until both ends are this near
SEEKING = 0.6  # share of a budget in which the rate or the longest gap is sought; it is proven in the rest


@checked
def certify_inclusion(
    plant: LinearInclusion,
    schedule: Schedules,
    *,
    eta: float | None = None,
    Qw: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    Qv: npt.ArrayLike | None = None,
    noise_gain: float = 3.0,
    budget: float | None = None,
    pieces: int | None = None,
    arrival: bool = False,
    progress: Progress | None = None,
) -> InclusionCertificate:
    """Certify every plant of a model, uncertain, varying or nonlinear, on a periodic schedule or all of a family.

        [P' + A'P + PA + eta P, PG; G'P, -Qw] < 0,    P(0) < P(tau) + C'R~C for tau where a sample may come

    Parameters
    ----------
    plant : UncertainPlant, or NonlinearPlant with a region
    schedule : GapRange, another family, or PeriodicSchedule
        Its gaps in their order and its first sample: each word of its graph has a P(tau) of its own.
    eta : float, optional [1/time]
        Rate of the squared error. Default: chosen for the least horizon.
    Qw, R, Qv : arrays, optional
        As for `certify`.
    noise_gain : float
        The information P1 may fall to this part of the most that is possible (above 1), for a smaller lambda.
    budget : float, optional [seconds]
        Of the search. What is proven by then is returned; so it is where the search is interrupted.
    pieces : int, optional
        Of P(tau). Default: 8, 16 or 32, as many as shorten the horizon.
    arrival : bool
        Choose eta for the horizon with the arrival weight P(tau), which lambda does not enter: the largest rate.
    progress : callable, optional
        Called with (fraction, message).

    Returns
    -------
    InclusionCertificate
        Proven: its `verify()` has passed.

    Raises
    ------
    ArgumentError
        If an argument is out of range, or schedule and plant do not fit.
    CertificateError
        If some plant of the model has no certificate for some schedule of the family: details `parameters`, `plant`,
        `counterexample`.
    UndecidedError
        If neither a certificate nor such a plant was found, or not within the budget.

    Notes
    -----
    *Assumptions.* Two trajectories share parameters and inputs; those of a nonlinear plant stay in its region.
    *Claim.* Assumption 7 with P1, P2 and these weights. *Method.* One semidefinite program per number of pieces, over
    the members that bind, solved with a margin; P rounded to short decimals; every inequality proven by `checkers`.
    *Numerical aspects.* Posed in coordinates where the centre keeps about the identity.

    References
    ----------
    The paper, Assumption 7; Boyd et al. 1994.

    Examples
    --------
    >>> from sampling_design import GapRange, Plant
    >>> from sampling_design.uncertain.plants.uncertain_plant import UncertainParameter, UncertainPlant
    >>> oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> omega2 = UncertainParameter("omega^2", 0.81, 1.21, A=[[0.0, 0.0], [-1.0, 0.0]])
    >>> found = certify_inclusion(UncertainPlant(oscillator, [omega2]), GapRange(0.5, 1.5), eta=0.1, pieces=8)
    >>> found.verify().passed
    True
    """
    schedules, report = in_terms(plant, schedule), progress or (lambda fraction, message: None)
    weights = weights_of(plant.centre, Qw, R, Qv)
    rate = None if eta is None else checks.positive("eta", eta)
    counts = PIECES if pieces is None else (checks.whole("pieces", pieces, 1),)
    gain = above_one("noise_gain", noise_gain, "P(tau)")
    given = Budget(None if budget is None else checks.positive("budget", budget))
    search: InclusionSearch | None = None
    verdict: Verification | None = None
    tried = rate
    for graph in graphs_of(schedules, plant.centre, counts[0]):
        search = InclusionSearch(plant, schedules, graph, weights, gain, given)
        report(0.0, f"search with {graph.count - 1} matri{'x' if graph.count == 2 else 'ces'} P(tau)")
        tried = choose_rate(search, counts[0], arrival, report) if rate is None else rate
        best, found = within_pieces(search, tried, counts, arrival, report)
        verdict = found or verdict
        if best is not None:
            report(1.0, "proven")
            return best
        if search.budget.over:
            break
    assert search is not None
    assert tried is not None
    if search.budget.over or search.refused == NO_TIME:
        raise UndecidedError(
            f"undecided: no P(tau) was proven within `budget` = {short(float(budget or 0.0))} s. "
            "Give it more time, or a rate `eta`.", eta=tried, verification=verdict, status="budget",
        )  # fmt: skip
    report(0.9, "search for a plant without certificate")
    raise refused(search, tried, verdict)


def within_pieces(
    search: InclusionSearch, rate: float, counts: tuple[int, ...], arrival: bool, report: Progress
) -> tuple[InclusionCertificate | None, Verification | None]:
    """The certificate of the shortest horizon, and the verdict on the last one that did not pass."""
    best: InclusionCertificate | None = None
    verdict: Verification | None = None
    began = Budget()
    for k, count in enumerate(counts):
        if search.budget.over:
            break
        report(0.5 + 0.4 * k / len(counts), f"{count} pieces")
        try:
            made, found = search.proven(rate, count, began)
        except KeyboardInterrupt:
            if best is None:
                raise
            break  # what is proven stays
        if made is None:
            verdict = found or verdict
            continue
        enough = best is not None and np.log(4 * made.lam) > (1 - ENOUGH) * np.log(4 * best.lam)
        best = made if best is None or made.lam < best.lam else best
        if enough or arrival:
            break
    return best, verdict


def graphs_of(schedules: Schedules, plant: Plant, pieces: int) -> Iterator[PathCompleteGraph]:
    """Graphs of more and more memory, as long as their programs can be solved."""
    levels = schedules.levels_of_memory if isinstance(schedules, SamplingFamily) and schedules.remembers else 1
    pairs = plant.n_states * (plant.n_states + 1) // 2
    for memory in range(levels):
        try:
            graph = graph_for(schedules, memory, plant.n_outputs)
        except ArgumentError:  # too many nodes
            if not memory:
                raise
            return
        if memory and layout_of(graph, pieces).nodes.size * pairs > MOST_UNKNOWNS:
            return
        yield graph


def certify_plant(
    plant: LinearInclusion,
    schedule: object,
    *,
    P2: object = None,
    memory: object = None,
    **options: Unpack[CertifyOptions],
) -> SampledCertificate:
    """`certify` of a plant that is not exactly known: `certify_inclusion` of the schedule in its terms.

    Of a set with one member it is that of the member, whose least P1 is known.
    """
    schedules = in_terms(plant, schedule, P2=P2, memory=memory)
    return (
        certify(plant.centre, schedules, **options)
        if is_one_plant(plant)
        else certify_inclusion(plant, schedules, **options)
    )


def is_one_plant(plant: LinearInclusion) -> bool:
    """Whether the set has one member, which is its centre."""
    known = plant.members(np.random.default_rng(0))
    return known.complete and all(bool(np.all(each == each[:1])) for each in (known.dynamics, known.outputs))


def in_terms(plant: LinearInclusion, schedule: object, **others: object) -> Schedules:
    """The schedule or family in the plant's terms.

    Raises ArgumentError if it is neither periodic nor a family, does not fit, or one of the `others` is given.
    """
    for name, value in others.items():
        if value is not None:
            raise ArgumentError(f"`{name}` must be left out for a plant that is not exactly known: P(tau) is chosen.")
    if not isinstance(schedule, (PeriodicSchedule, SamplingFamily)):
        raise ArgumentError(
            "`schedule` must be a GapRange, another family or a periodic schedule for a plant that is not exactly "
            f"known, got {checks.described(schedule)}."
        )
    if not plant.centre.n_states:
        raise ArgumentError("`plant` must have states: there is nothing to certify.")
    if isinstance(schedule, SamplingFamily):
        if schedule.by_output:
            raise ArgumentError(
                "`schedule` must have samples whose outputs are read together for a plant that is not exactly known, "
                f"got {checks.described(schedule)}."
            )
        return in_plant_terms(plant.centre, schedule)
    known = certifiable_schedule(plant.centre, schedule)
    return period_of(known).primitive()


def choose_rate(search: InclusionSearch, pieces: int, arrival: bool, report: Progress) -> float:
    """The rate of the least horizon in a part of the budget; the slowest of the scan where none has one."""
    given, search.budget = search.budget, search.budget.share(SEEKING)

    def horizon(rate: float) -> float:
        found = search.solve(rate, pieces, narrow=not arrival)
        lost = np.inf if found is None else (0.0 if arrival else np.log(max(found.lam, 1.0)))
        return float((lost + np.log(4.0)) / rate)

    scan = (np.geomspace(3.0, 0.05, RATES) / search.mean).tolist()
    found = best_rates(scan, FINER_RATES, horizon, lambda: search.budget.over, report)
    search.budget = given
    best = found[0] if found else scan[-1]
    return best if best in scan else float(f"{best:.4g}")


def refused(search: InclusionSearch, eta: float, verdict: Verification | None) -> CertificateError:
    """What to say: a plant of the model and a schedule of the range that no weights can certify, or "undecided"."""
    look = Budget(LONGEST_LOOK, whole=search.budget)
    margins: list[tuple[float, str]] = []
    for place, plant in search.plant.constant_members(np.random.default_rng(0))[:SUSPECTS]:
        if look.over:
            break
        found, nearest = find_counterexample(plant, search.family, eta, quick=True, budget=look.left)
        if found is not None and not search.plant.members_are_plants:
            return UndecidedError(
                f"undecided: no P(tau) can be found, as the linearisation at {place} with the gaps "
                f"{short(found.schedule.gaps)} has none, {found.reason}. The nonlinear plant is not refuted by that. "
                "Try a smaller region, shorter gaps or other coordinates.",
                parameters=place, plant=plant, counterexample=found, gaps=found.schedule.gaps, eta=eta,
            )  # fmt: skip
        if found is not None:
            return CertificateError(
                f"No certificate: at {place} the gaps {short(found.schedule.gaps)} have none, {found.reason}.",
                parameters=place, plant=plant, counterexample=found, gaps=found.schedule.gaps, eta=eta,
            )  # fmt: skip
        margins.append((nearest.margin, place))
    worst = f"; the plant nearest to having none is {min(margins)[1]}" if margins else ""
    last = "" if verdict is None else f" (the last one: {verdict.reason})"
    return UndecidedError(
        f"undecided: no P(tau) was proven at rate {below(eta)}{last}, and no plant and schedule without certificate "
        f"were found{worst}. Try more pieces, a smaller eta or shorter gaps.",
        eta=eta, verification=verdict, nearest=min(margins)[1] if margins else None,
    )  # fmt: skip


@checked
def longest_gap(
    plant: LinearInclusion,
    *,
    eta: float,
    shortest: float | None = None,
    most: float,
    Qw: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    Qv: npt.ArrayLike | None = None,
    pieces: int = 16,
    budget: float | None = None,
    progress: Progress | None = None,
) -> InclusionCertificate:
    """Return the certificate of the longest gaps that are proven at a rate.

    Parameters
    ----------
    plant : UncertainPlant, or NonlinearPlant with a region
    eta : float [1/time]
    shortest : float, optional [time]
        Of the gaps; default a tenth of the longest.
    most : float [time]
        No longer gap is tried.
    Qw, R, Qv : arrays, optional
        As for `certify`.
    pieces : int
        Of P(tau): more pieces, longer gaps.
    budget : float, optional [seconds]
        When it runs out, the longest gap so far is proven, in what is left of it.
    progress : callable, optional

    Returns
    -------
    InclusionCertificate
        Proven; `family.longest` is the gap, to about .3 % of what so many pieces prove.

    Raises
    ------
    ArgumentError
        If an argument is out of range.
    UndecidedError
        If no gap of at least a thousandth of `most` is proven.

    Notes
    -----
    *Claim.* Proven, not the longest that is true: P(tau) is piecewise linear, and one for the whole model.
    """
    rate, top = checks.positive("eta", eta), checks.positive("most", most)
    count = checks.whole("pieces", pieces, 1)
    least = None if shortest is None else checks.positive("shortest", shortest)
    if least is not None and least > top:
        raise ArgumentError(f"`most` must be at least `shortest` = {least!r}, got {top!r}.")
    given = Budget(None if budget is None else checks.positive("budget", budget))
    report, seeking = progress or (lambda fraction, message: None), given.share(SEEKING)
    weights = weights_of(plant.centre, Qw, R, Qv)
    in_terms(plant, GapRange(top, top))

    def search(gap: float, within: Budget) -> InclusionSearch:
        family = GapRange(min(gap, gap / 10 if least is None else least), gap)
        return InclusionSearch(plant, family, graph_for(family, 0, plant.centre.n_outputs), weights, 3.0, within)

    low, high = top / 1000 if least is None else least, top
    for k in range(BISECTIONS):
        gap = high if not k else float(np.sqrt(low * high)) if low < high / 4 else (low + high) / 2
        found = search(gap, seeking).solve(rate, count, narrow=False)
        if seeking.over:
            break
        if found is None:
            high = gap
        else:
            low = gap
        report((k + 1) / (BISECTIONS + 2), f"gaps up to {gap:.4g}")
        if high < low * CLOSE:
            break
    for factor in (1.0, 0.997, 0.99, 0.97, 0.93, 0.8, 0.5):
        last = search(float(f"{low * factor:.4g}"), given)
        made, _ = last.proven(rate, count, given)
        if made is not None:
            return made
        if ended := given.over or last.refused == NO_TIME:
            break
    late = f" within `budget` = {short(given.seconds)} s" if ended else ""
    raise UndecidedError(
        f"undecided: no gap of at least {low / 2:.3g} was proven at rate {short(rate)}{late}.", eta=rate
    )
