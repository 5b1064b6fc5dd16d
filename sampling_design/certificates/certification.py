"""From a plant and a schedule to a proven certificate."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Unpack, overload

import numpy as np
import numpy.typing as npt

from sampling_design import __version__
from sampling_design.certificates.exact.bound_weights import (
    BoundedOptions,
    CertifyOptions,
    ErrorBoundArguments,
    weights_within,
)
from sampling_design.certificates.exact.canonical import ScaledProblem, canonical, followed, origin_question
from sampling_design.certificates.exact.certificate import WITHOUT_GAIN, Certificate, SampledCertificate
from sampling_design.certificates.exact.efforts import ALL_WORK, BEYOND, LOOK_WORK, SEARCHED, SearchEffort
from sampling_design.certificates.exact.given_weights import NoiseWeights, above_one, certifiable_schedule, weights_of
from sampling_design.certificates.exact.precise import precisely_chosen
from sampling_design.certificates.exact.proof import ScheduleProof
from sampling_design.certificates.exact.retained_part import own_decay, retained_part_weights, search_units
from sampling_design.certificates.exact.weight_choice import (
    COMPARED,
    SEARCH_WORK,
    ChosenWeights,
    WeightSearch,
    choose_rate,
    choose_weights,
    rate_range,
    round_choices,
)
from sampling_design.certificates.existence.periodic import certificate_exists, require_certificate
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import ArgumentError, CertificateError, UndecidedError
from sampling_design.numerics.linalg import symmetrise
from sampling_design.observability.alignment import align
from sampling_design.observability.count.functional import part_for
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant, Signals, remade
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget, Progress
from sampling_design.records.dispatch import OpenPlant, registered
from sampling_design.records.record import SolverRecord
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import AnySchedule, SamplingFamily
from sampling_design.schedules.jitter import Jitter, Timing, TimingTolerance
from sampling_design.schedules.output_jitter import OutputJitter
from sampling_design.schedules.schedule import PeriodicSchedule

if TYPE_CHECKING:  # the families' programs are loaded when one is asked for
    from sampling_design.certificates.families.family_certificate import FamilyCertificate


AS_IF_DRIVEN = ", as if disturbances moved each state by its scale within a mean gap, for nothing drives the plant"


def certify_given(
    plant: Plant,
    schedule: AnySchedule,
    P2: Array,
    Qw: Array,
    R: Array,
    Qv: Array,
    eta: float,
    solver: SolverRecord,
    exists: bool = False,
    limit: Budget = ENDLESS,
) -> Certificate:
    """Return the certificate with the best P1 for given weights and rate, proven.

    `exists` says that one with this rate, or a larger one, is known to exist: then that is not asked again. `limit` is
    the time that it may take. Raises CertificateError if no certificate with that rate exists; UndecidedError if the
    proof does not close, or the information is lost in rounding.
    """
    weights = (P2, Qw, R, Qv)
    if not plant.n_states:
        return Certificate(
            plant, schedule, P1=P2, P2=P2, Qw=Qw, R=R, Qv=Qv, eta=eta, lam=1.0, lam_samples=1.0, solver=solver
        )
    with np.errstate(all="ignore"):  # what overflows is not finite, and then undecided
        proof = ScheduleProof(
            plant, schedule, weights, eta, SearchEffort(WorkLimit(ALL_WORK, stop=lambda: limit.over), alone=True)
        )
        followed(proof.canon, eta * proof.canon.time)
        if not exists:
            _require(plant, schedule, eta, proof.canon)
        return proof.closed(solver)


def _require(plant: Plant, schedule: AnySchedule, eta: float, canon: ScaledProblem) -> None:
    """Refuse where no certificate exists, in the internal units and, for the words, in those of the caller."""
    if not certificate_exists(canon.plant, canon.schedule, eta * canon.time).exists:
        require_certificate(plant, schedule, eta)


def _bounds(plant: Plant, schedule: AnySchedule, canon: ScaledProblem) -> tuple[float, float]:
    """The rates to be searched, in internal units; refused as in `_require`."""
    try:
        return rate_range(canon.plant, canon.schedule)
    except CertificateError:
        low, high = rate_range(plant, schedule)
        return low * canon.time, high * canon.time


@overload
def certify(
    plant: Plant, schedule: AnySchedule | None, *, P2: npt.ArrayLike | None = ..., of: Wanted = ...,
    **options: Unpack[BoundedOptions],
) -> Certificate: ...  # fmt: skip
@overload
def certify(
    plant: Plant, schedule: SamplingFamily, *, P2: npt.ArrayLike | None = ..., of: Wanted = ...,
    memory: int | None = ..., **options: Unpack[BoundedOptions],
) -> FamilyCertificate: ...  # fmt: skip
@overload
def certify(
    plant: Plant, schedule: AnySchedule | SamplingFamily, *, of: Wanted = ..., **options: Unpack[BoundedOptions]
) -> SampledCertificate: ...
@overload
def certify(
    plant: Plant | OpenPlant, schedule: AnySchedule, *, timing_tolerance: Timing, P2: npt.ArrayLike | None = ...,
    of: Wanted = ..., memory: int | None = ..., **options: Unpack[BoundedOptions],
) -> SampledCertificate: ...  # fmt: skip
@overload
def certify(
    plant: OpenPlant, schedule: SamplingFamily | PeriodicSchedule, **options: Unpack[CertifyOptions]
) -> SampledCertificate: ...
@checked
def certify(
    plant: Plant | OpenPlant,
    schedule: AnySchedule | SamplingFamily | None,
    *,
    eta: float | None = None,
    P2: npt.ArrayLike | None = None,
    Qw: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    Qv: npt.ArrayLike | None = None,
    noise_gain: float = 3.0,
    of: Wanted = None,
    memory: int | None = None,
    timing_tolerance: Timing = 0.0,
    budget: float | None = None,
    progress: Progress | None = None,
    **bounds: Unpack[ErrorBoundArguments],
) -> SampledCertificate:
    """Certify that a schedule makes a plant sample-based exponentially i-iIOSS (Assumption 7), with the best lambda.

        lam = sup over real window starts and all later t of lambda_max(P2, Pi(t)),    P1 = (1 - 1e-3) P2/lam

    Parameters
    ----------
    plant : Plant, or an UncertainPlant or a NonlinearPlant with a region
        For the last two see `certify_inclusion`: they take a periodic schedule or a family, and no P2.
    schedule : PeriodicSchedule, Schedule or a family of schedules
        A finite one is certified to its last time, a family for every schedule that it holds. None, the schedule of a
        design that needs no samples, is refused.
    eta : float, optional [1/time]
        Discount rate of the squared error. Default: chosen in [0.05, 3]/(mean gap) for the least horizon, below rates
        at which lasting noise would leave ten times the least that it leaves at any; slower where nothing in this range
        can be followed in doubles, or proven. With bounds one over the longest gap.
    P2 : (n, n) array, optional
        Weight of the prior. Default: shape and scale chosen for the least horizon that `noise_gain` allows.
    Qw : (q, q) array, optional
        Default diag(1/s_w^2): a disturbance of typical size counts one per unit of time, whatever that unit is.
    R, Qv : (p, p) arrays, optional
        Default 2 diag(1/s_y^2): R~ = (R^-1 + Qv^-1)^-1 = diag(1/s_y^2); one stands for both. A family without scales
        that is undecided so is tried with noise as large as disturbances of one move outputs, which it says.
    w_bound, v_bound, initial_error : float or array, optional
        As the estimators take them, in place of the weights: the certificate has those of `weights_from_bounds`, for
        narrow radii instead of the least horizon. Where one is not given, or zero, the plant's scales stand for it.
    noise_gain : float
        C_w and C_v may be at most this many times their least at the eta in question (above 1), states counted in
        their scales. Only used where P2 is chosen; of a plant that nothing drives, as if a disturbance moved each state
        by its scale within a mean gap. Where nothing is proven with it, a plant that decays on its own is
        certified without, which `explain()` says.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows themselves (`functional_plant`). The
        certificate is about the part of the plant that they need, and its file holds the whole plant beside it.
        Default: all states.
    memory : int, optional
        For a family alone: how much of the past its graph remembers (0 the least). Default: as little as is enough.
    timing_tolerance : float, pair (early, late), or dict of these by output [plant.time_unit]
        Other than 0: of one schedule, how early or late each sample may be. All such times are a `Jitter` family, about
        the schedule itself or, where early and late differ, half of their difference after it: its certificate is
        returned. A first sample that could come before time 0 is refused. By output: where each sample reads one, each
        about the middle of its own times, all within the largest radius, which is safe. Where a sample reads several
        they come apart, in any order: an `OutputJitter` family, for an exactly known plant and diagonal R and Qv.
    budget : float, optional [seconds]
        Of the whole call. What is best by then is proven and returned; without a budget the work is counted, and the
        result is the same on every machine. An interrupt (KeyboardInterrupt) ends the search of weights likewise, once
        it holds some; a second one ends the call.
    progress : callable, optional
        Called with (fraction, message).

    Returns
    -------
    Certificate; FamilyCertificate for a family; InclusionCertificate for a plant that is not exactly known
        Proven: its `verify()` has passed.

    Raises
    ------
    ArgumentError
        If a weight is not symmetric positive definite, eta or the noise gain is out of range, or plant and schedule do
        not fit.
    CertificateError
        If no certificate exists (details: eigenvalue, partners it is aliased with, period, repair); for a family, if
        some schedule of it has none.
    UndecidedError
        If no proof closes, not within the budget, or the information cannot be followed in doubles; the reason says
        which.

    Notes
    -----
    *Assumptions.* Linear plant, unconstrained noise (with convex constraints the certificate still holds).
    *Claim.* The inequality holds iff the discounted information Pi, started at P2, stays above P1 for every start and
    all t; for given weights lam is exact to 1e-3, unless the checker's rounding left no proof that near (then lam is
    stated up to 3 times larger) or windows come near the long run too slowly to be followed (then it is that of the
    long run); `solver.details` says so. *Method.* Windows side by side find lam; `checkers` proves it
    over the continuum of starts and times and over all periods, and whatever window it finds raises lam. Weights are
    chosen by sequential quadratic programming on the exact lambda: a local optimum. *Numerical aspects.* Y = Pi^-1 is
    propagated in coordinates where P2 = I, samples in Joseph's form, gaps by doubling.

    References
    ----------
    The paper, Assumption 7 and Theorem 9.

    Examples
    --------
    >>> from sampling_design.schedules.schedule import PeriodicSchedule
    >>> oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> certificate = certify(oscillator, PeriodicSchedule([1.0]), eta=0.4, P2=[[1.0, 0.0], [0.0, 1.0]])
    >>> print(f"{certificate.lam:.3f}, M > {certificate.horizon().minimum:.3f}, {certificate.verify().passed}")
    5.528, M > 4.277, True
    >>> certify(oscillator, PeriodicSchedule([0.5, 1.0]), w_bound=0.1, v_bound=0.2, initial_error=1.0).eta
    1.0
    """
    schedule = within_tolerance(plant, schedule, timing_tolerance)
    bounded = any(bound is not None for bound in bounds.values())
    if bounded and any(weight is not None for weight in (P2, Qw, R, Qv)):
        raise ArgumentError("`w_bound`, `v_bound` and `initial_error` say the weights: leave out P2, Qw, R and Qv.")
    if not isinstance(plant, Plant):
        if of is not None:
            raise ArgumentError("`of` is for exactly known plants: certify all states of this one.")
        if bounded:
            raise ArgumentError("`w_bound`, `v_bound` and `initial_error` are for exactly known plants: give Qw and R.")
        return registered("certify", plant, SampledCertificate)(  # type: ignore[type-abstract]
            plant, schedule, eta=eta, P2=P2, Qw=Qw, R=R, Qv=Qv, noise_gain=noise_gain, budget=budget, memory=memory,
            progress=progress,
        )  # fmt: skip
    plant = part_for(plant, of, decay_rate=eta)
    if bounded and schedule is not None:
        eta = 1 / schedule.d_max if eta is None else eta
        P2, Qw, R, Qv = weights_within(plant, eta, bounds)
    if isinstance(schedule, SamplingFamily):
        from sampling_design.certificates.families.certify_family import certify_family

        return certify_family(
            plant, schedule, eta=eta, P2=P2, Qw=Qw, R=R, Qv=Qv, noise_gain=noise_gain, budget=budget, memory=memory,
            progress=progress,
        )  # fmt: skip
    if schedule is None:
        raise ArgumentError(
            "`schedule` is None, as in a design with nothing to observe: "
            "`certify_detectability(plant)` certifies such a plant without samples."
        )
    if memory is not None:
        raise ArgumentError(f"`memory` is for families of schedules, got {memory!r} with a {type(schedule).__name__}.")
    noise_gain = above_one("noise_gain", noise_gain)
    limit = Budget(None if budget is None else checks.positive("budget", budget))
    schedule = certifiable_schedule(plant, schedule)
    with _within(limit):
        return _of_schedule(plant, schedule, (Qw, R, Qv), P2, eta, noise_gain, progress, limit)


def within_tolerance(
    plant: OpenPlant, schedule: AnySchedule | SamplingFamily | None, timing_tolerance: Timing
) -> AnySchedule | SamplingFamily | None:
    """Return the family of all times within a tolerance of a schedule. Raises ArgumentError if they do not fit."""
    known = plant if isinstance(plant, Plant) else None
    late = TimingTolerance.of(timing_tolerance, None if known is None else known.outputs.names, plant.time_unit)
    if not late:
        return schedule
    if schedule is None or isinstance(schedule, SamplingFamily):
        raise ArgumentError(
            f"`timing_tolerance` is for one schedule, got {checks.described(schedule)}: a family says itself which "
            "times its samples may have."
        )
    if known is None or not late.apart:
        return Jitter.around(schedule, late)
    schedule = align(known, schedule)
    read = known.n_outputs if schedule.outputs is None else int(schedule.outputs.sum(axis=1).max(initial=0))
    return (OutputJitter if read > 1 else Jitter).around(schedule, late)


@contextmanager
def _within(limit: Budget) -> Iterator[None]:
    """What a spent budget left undecided says so."""
    try:
        yield
    except UndecidedError as error:
        if not limit.over:
            raise
        tried = str(error).removeprefix("undecided: ").split(". ")[0].rstrip(".")
        raise UndecidedError(
            f"undecided: no certificate was proven within `budget` = {limit.seconds:g} s. Give it more time, or a rate "
            f"`eta`. When it ended: {tried}.", **{**error.details, "status": "budget"},
        ) from None  # fmt: skip


def _of_schedule(
    plant: Plant, schedule: AnySchedule, given: tuple[object, object, object], P2: object, eta: float | None,
    noise_gain: float, progress: Progress | None, limit: Budget,
) -> Certificate:  # fmt: skip
    """The certificate of one schedule: for the weights that are given, others chosen."""
    weights = weights_of(plant, *given)
    prior = None if P2 is None else checks.definite("P2", P2, plant.n_states)
    rate = None if eta is None else checks.positive("eta", eta)
    if not plant.n_states:
        prior, rate = np.zeros((0, 0)), 1.0 if rate is None else rate
    if prior is None:
        return chosen(plant, schedule, weights, rate, [float(noise_gain)], progress, limit)[0]
    how, searched = "given weights", rate is None
    if rate is None:
        canon = canonical(plant, schedule, weights, prior)
        with np.errstate(all="ignore"):
            bounds = _bounds(plant, schedule, canon)
            rate = choose_rate(canon, canon.inside(prior), bounds, progress, limit.share(SEARCHED)) / canon.time
        how = "least horizon for given P2"
    solver, known = SolverRecord("sampling_design", __version__, "given", 0, {"weights": how}), bool(plant.n_states)
    return certify_given(plant, schedule, prior, *weights, rate, solver, exists=searched and known, limit=limit)


def chosen(
    plant: Plant,
    schedule: AnySchedule,
    weights: NoiseWeights,
    eta: float | None,
    gains: list[float],
    progress: Progress | None = None,
    limit: Budget = ENDLESS,
) -> list[Certificate]:
    """Return a certificate for each noise gain, P2 (and eta where it is None) chosen for the least horizon.

    A larger gain has no longer horizon. `schedule` is in the plant's terms. Raises CertificateError if no certificate
    exists; UndecidedError if the proof closes for none of the weights that were tried.
    """
    if not plant.n_states:
        empty = np.zeros((0, 0))
        return [certify_given(plant, schedule, empty, *weights, eta or 1.0, SolverRecord("given")) for _ in gains]
    canon = canonical(plant, schedule, weights)
    with np.errstate(all="ignore"):  # what overflows is not finite, and then undecided
        followed(canon, 0.0 if eta is None else eta * canon.time)
        if eta is not None:
            _require(plant, schedule, eta, canon)
        bounds = _bounds(plant, schedule, canon) if eta is None else (eta * canon.time, eta * canon.time)
        plain, between = canon, bounds
        canon, bounds = search_units(*driven(plant, schedule, weights), bounds)
        problem, searching = (plant, schedule, weights), limit.share(SEARCHED)
        asked = [(gain, SearchEffort(WorkLimit(ALL_WORK, stop=lambda: limit.over))) for gain in gains]
        # where lambda is one no search finds a shorter horizon; the slow modes of a large plant are sought alone
        ways = (
            partial(own_decay, canon, bounds, gains, WorkLimit(SEARCH_WORK, stop=lambda: searching.over)),
            partial(retained_part_weights, canon, bounds, gains, progress, searching),
        )
        for way in ways:
            try:
                if len(made := [choice for choice in way() if choice is not None]) == len(gains):
                    known = zip(made, asked, strict=True)
                    return [_first_proven(problem, canon, [choice], eta, *each) for choice, each in known]
            except UndecidedError:
                pass
        try:
            ranked = zip(choose_weights(canon, bounds, gains, progress, searching), asked, strict=True)
            return [_best_proven(problem, canon, choices, eta, *each) for choices, each in ranked]
        except UndecidedError as error:
            if origin_question(plain):  # dates are asked for their origin, and not followed from time 0
                raise
            try:  # nearly equal modes behind few outputs leave conditions that doubles lose, and more digits hold
                return [precisely_chosen(problem, plain, between, eta, gain, first.total) for gain, first in asked]
            except UndecidedError:
                return _without_gain(problem, canon, bounds, eta, gains, error, lambda: limit.over)


def driven(plant: Plant, schedule: AnySchedule, weights: NoiseWeights) -> tuple[Plant, AnySchedule, NoiseWeights]:
    """The problem in which weights are sought: where nothing drives the plant, a disturbance does that moves each state
    by its scale within a mean gap. Else what is known would stay known for ever, and no noise gain have a least one.
    """
    if plant.G.any():
        return plant, schedule, weights
    gaps = schedule.gaps if schedule.gaps.size else np.asarray(schedule.times)
    n, scales = plant.n_states, plant.states.scales
    moved = remade(plant, G=np.diag(scales), disturbances=Signals([f"w{i + 1}" for i in range(n)]))
    return moved, schedule, weights._replace(Qw=float(np.mean(gaps)) * np.eye(n))


def _without_gain(
    problem: tuple[Plant, AnySchedule, NoiseWeights], canon: ScaledProblem, bounds: tuple[float, float],
    eta: float | None, gains: list[float], error: UndecidedError, over: Callable[[], bool],
) -> list[Certificate]:  # fmt: skip
    """What the plant's own decay proves without the noise gain that was asked for, which the certificate says.

    Raises UndecidedError, the `error`, where it proves nothing.
    """
    own = -2 * float(np.max(np.linalg.eigvals(canon.plant.A).real))
    if not own > 0:
        raise error from None
    slower = bounds if eta is not None else (min(bounds[0], own / 2), bounds[1])
    choice = own_decay(canon, slower, [np.inf], WorkLimit(SEARCH_WORK, stop=over))[0]
    if choice is None:
        raise error from None
    gain = float(np.exp(-WeightSearch(canon).setting(choice.eta).least(choice.P2)))
    try:
        made = _first_proven(problem, canon, [choice], eta, gain, SearchEffort(WorkLimit(ALL_WORK, stop=over)))
    except UndecidedError:
        raise error from None
    notes = [f"{WITHOUT_GAIN} {asked:g}: {gain:.3g}, for none was proven with {asked:g}" for asked in gains]
    return [replace(made, solver=replace(made.solver, details={"weights": how})) for how in notes]


def _best_proven(
    problem: tuple[Plant, AnySchedule, NoiseWeights],
    canon: ScaledProblem,
    choices: list[ChosenWeights],
    eta: float | None,
    gain: float,
    first: SearchEffort,
) -> Certificate:
    """The choice of the least exact horizon whose proof closes; a spare one where none does, and then a round one."""
    failed: list[UndecidedError] = []
    choices = [choice for choice in choices if choice.value * choice.eta < BEYOND] or choices
    stages: list[Iterable[list[ChosenWeights]]] = [[[c for c in choices if c.spare == k]] for k in (False, True)]
    if choices:
        low = min(choice.eta for choice in choices)
        stages.append(round_choices(canon, [low, low / 10] if eta is None else [low], gain, first.total))
    efforts = first
    for groups in stages:
        for some in groups:
            try:
                if some:
                    return _first_proven(problem, canon, some, eta, gain, efforts)
            except UndecidedError as error:
                failed.append(error)
            if efforts.over:
                break
        efforts = efforts.later()
    if failed:
        raise failed[0]
    raise UndecidedError(
        f"undecided: no weights of noise gain {gain:g} could be followed in doubles.{origin_question(canon)}"
    )


def _first_proven(
    problem: tuple[Plant, AnySchedule, NoiseWeights],
    canon: ScaledProblem,
    choices: list[ChosenWeights],
    eta: float | None,
    gain: float,
    efforts: SearchEffort,
) -> Certificate:
    """The first of these choices whose proof closes, the nearest ones in the order of their exact horizons."""
    plant, schedule, weights = problem
    failed: list[UndecidedError] = []
    proofs: list[tuple[float, int, ScheduleProof, ChosenWeights]] = []
    for choice in choices:
        rate = choice.eta / canon.time if eta is None else eta
        prior = symmetrise(canon.outside(choice.P2))
        try:
            proof = ScheduleProof(
                plant, schedule, (prior, *weights), rate, efforts, float(np.exp(choice.value * choice.eta))
            )
            near = choice.value <= COMPARED * choices[0].value and efforts.looks.left > LOOK_WORK
            proofs.append((proof.horizon if not proofs or near else np.inf, len(proofs), proof, choice))
        except UndecidedError as error:
            failed.append(error)
    proofs = sorted(proofs, key=lambda item: item[:2])
    order = [(True, item) for item in proofs] + [(False, item) for item in proofs[:1]]  # room for the best one
    for plainly, (_, _, proof, choice) in order:
        how = {"weights": f"least horizon with noise gain {gain:g}{'' if plant.G.any() else AS_IF_DRIVEN}"}
        if choice.spare:
            how = {"weights": f"a first guess with noise gain {gain:g}: at the best rate no proof closed"}
        solver = SolverRecord("sampling_design", __version__, choice.status, choice.iterations, how)
        try:
            return proof.closed(solver, plainly)
        except UndecidedError as error:
            failed.append(error)
        if efforts.over:
            break
    raise failed[0]
