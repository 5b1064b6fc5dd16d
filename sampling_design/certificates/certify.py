"""From a plant and a schedule to a proven certificate."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from sampling_design import __version__, _checks
from sampling_design._door import door
from sampling_design.certificates.exact.certificate import Certificate, Witness
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.riccati import Peak, at_peak, located, refine, supremum
from sampling_design.certificates.exact.weight_choice import choose_rate, choose_weights
from sampling_design.certificates.exact.window_problem import AnySchedule, WindowProblem, window_problem
from sampling_design.certificates.existence.periodic import require_certificate
from sampling_design.certificates.form.seal import RESOLUTION, STATED_MARGIN
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.evidence import SolverRecord
from sampling_design.observability.meeting import meet
from sampling_design.plants.plant import Plant
from sampling_design.schedules.family import SamplingFamily

if TYPE_CHECKING:  # the families' programs are loaded when one is asked for
    from sampling_design.certificates.families.family_certificate import FamilyCertificate

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

FINEST = 16
"""How much finer the last look for a missed peak is than the first."""
ATTEMPTS = 8
"""How often a window that the checker found may raise lambda before the proof is given up."""


def certify_given(
    plant: Plant, schedule: AnySchedule, P2: Array, Qw: Array, R: Array, Qv: Array, eta: float, solver: SolverRecord
) -> Certificate:
    """Return the certificate with the best P1 for given weights and rate, proven.

    Raises
    ------
    CertificateError
        If no certificate with that rate exists, or the proof does not close.
    """
    require_certificate(plant, schedule, eta)
    if not plant.n_states:
        return Certificate(
            plant, schedule, P1=P2, P2=P2, Qw=Qw, R=R, Qv=Qv, eta=eta, lam=1.0, lam_samples=1.0, solver=solver
        )
    problem = window_problem(plant, schedule, P2, Qw, R, Qv, eta)
    finer = 1
    anywhere, at_samples = supremum(problem)
    for _ in range(ATTEMPTS):
        made = _made(plant, schedule, problem, (P2, Qw, R, Qv), (anywhere, at_samples), solver)
        verdict = made.verify()
        if verdict.passed:
            return made
        if verdict.time is None or verdict.start is None:  # undecided: the grids missed a peak by a hair
            if finer == FINEST:
                break
            finer *= 4
            others = supremum(problem, finer)
            anywhere, at_samples = (max(pair, key=_value) for pair in zip((anywhere, at_samples), others, strict=True))
            anywhere = max(anywhere, at_samples, key=_value)
            continue
        missed = located(problem, verdict.start, verdict.time)
        if "samples" in verdict.inequality:
            at_samples = max(refine(problem, missed, 0.0), at_samples, key=_value)
        else:
            missed = refine(problem, missed, problem.reach[missed.index] / 16)
        anywhere = max(anywhere, missed, at_samples, key=_value)
    raise CertificateError(
        f"the proof of the certificate did not close: {verdict.reason}.", verification=verdict, certificate=made
    )


def _value(peak: Peak) -> float:
    return peak.value


def _made(
    plant: Plant,
    schedule: AnySchedule,
    problem: WindowProblem,
    weights: tuple[Array, Array, Array, Array],
    peaks: tuple[Peak, Peak],
    solver: SolverRecord,
) -> Certificate:
    lam, lam_samples = (max(peak.value, 1.0) for peak in peaks)
    P2, Qw, R, Qv = weights
    P1 = (1 - RESOLUTION) * P2 / lam
    seen = witness_of(problem, peaks[0])
    return Certificate(
        plant,
        schedule,
        P1=P1,
        P2=P2,
        Qw=Qw,
        R=R,
        Qv=Qv,
        eta=problem.eta,
        lam=lam,
        lam_samples=lam_samples,
        margin=STATED_MARGIN,
        witness=seen,
        solver=solver,
    )


def witness_of(problem: WindowProblem, peak: Peak) -> Witness:
    """Return where a peak is attained, in the plant's coordinates."""
    Y, t, start = at_peak(problem, peak)
    values, vectors = np.linalg.eigh(Y)
    direction = problem.physical(vectors[:, -1])
    return Witness(t, start, tuple(float(v) for v in direction), float(values[-1]))


@overload
def certify(
    plant: Plant,
    schedule: AnySchedule | None,
    *,
    eta: float | None = ...,
    P2: npt.ArrayLike | None = ...,
    Qw: npt.ArrayLike | None = ...,
    R: npt.ArrayLike | None = ...,
    Qv: npt.ArrayLike | None = ...,
    budget: float = ...,
    progress: Progress | None = ...,
) -> Certificate: ...
@overload
def certify(
    plant: Plant,
    schedule: SamplingFamily,
    *,
    eta: float | None = ...,
    P2: npt.ArrayLike | None = ...,
    Qw: npt.ArrayLike | None = ...,
    R: npt.ArrayLike | None = ...,
    Qv: npt.ArrayLike | None = ...,
    budget: float = ...,
    progress: Progress | None = ...,
) -> FamilyCertificate: ...
@door
def certify(
    plant: Plant,
    schedule: AnySchedule | SamplingFamily | None,
    *,
    eta: float | None = None,
    P2: npt.ArrayLike | None = None,
    Qw: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    Qv: npt.ArrayLike | None = None,
    budget: float = 3.0,
    progress: Progress | None = None,
) -> Certificate | FamilyCertificate:
    """Certify that a schedule makes a plant sample-based exponentially i-iIOSS (Assumption 7), with the best lambda.

        lam = sup over real window starts and all later t of lambda_max(P2, Pi(t)),    P1 = (1 - 1e-3) P2/lam

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule, Schedule or a family of schedules
        A finite schedule is certified to its last time. For a family see `certify_family`. None, the schedule of a
        design that needs no samples, is refused.
    eta : float, optional [1/time]
        Discount rate of the squared error. Default: chosen in [0.05, 3]/(mean gap) for the least horizon.
    P2 : (n, n) array, optional
        Weight of the prior. Default: shape and scale chosen for the least horizon under the noise budget.
    Qw : (q, q) array, optional
        Default diag(1/s_w^2).
    R, Qv : (p, p) arrays, optional
        Default 2 diag(1/s_y^2), so that R~ = (R^-1 + Qv^-1)^-1 = diag(1/s_y^2). One stands for both.
    budget : float
        C_w and C_v may be at most this many times their least at the eta in question (above 1), states counted in
        their scales. Only used where P2 is chosen.
    progress : callable, optional
        Called with (fraction, message).

    Returns
    -------
    Certificate, or FamilyCertificate for a family
        Proven: its `verify()` has passed.

    Raises
    ------
    ArgumentError
        If a weight is not symmetric positive definite, eta or the budget is out of range, or plant and schedule do
        not fit.
    CertificateError
        If no certificate exists (details: eigenvalue, partners it is aliased with, period, repair), or the proof
        does not close.
    SolverError
        If the schedule is so near the edge that the information does not settle.

    Notes
    -----
    *Assumptions.* Linear plant, unconstrained noise (with convex constraints the certificate still holds).
    *Claim.* The inequality holds iff the discounted information Pi, started at P2, stays above P1 for every start and
    all t; for given weights lam is exact to 1e-3. *Method.* Windows side by side find lam; `checker.py` proves it
    over the continuum of starts and times and over all laps, and whatever window it finds raises lam. Weights are
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
    >>> print(f"{certificate.lam:.3f}, M > {certificate.horizon().minimum:.3f}")
    5.528, M > 4.277
    >>> certificate.verify().passed
    True
    """
    if isinstance(schedule, SamplingFamily):
        from sampling_design.certificates.families.certify_family import certify_family

        given: dict[str, Any] = {"eta": eta, "P2": P2, "Qw": Qw, "R": R, "Qv": Qv}
        return certify_family(plant, schedule, **given, budget=budget, progress=progress)
    if schedule is None:
        raise ArgumentError(
            "`schedule` is None, as in a design with nothing to observe: "
            "`certify_detectability(plant)` certifies such a plant without samples."
        )
    schedule = _met(plant, schedule)
    weights = weights_of(plant, Qw, R, Qv)
    prior = None if P2 is None else _checks.definite("P2", P2, plant.n_states)
    rate = None if eta is None else _checks.positive("eta", eta)
    if not _checks.number("budget", budget) > 1:
        raise ArgumentError(f"`budget` must be above 1, got {budget!r}: no P2 attains the least noise gain.")
    began = time.perf_counter()
    how, steps, status = "given weights", 0, "given"
    if not plant.n_states:
        prior, rate = np.zeros((0, 0)), 1.0 if rate is None else rate
    elif prior is None:
        if rate is not None:
            require_certificate(plant, schedule, rate)
        choice = choose_weights(plant, schedule, weights, rate, budget, progress)
        prior, rate, steps, status = choice.P2, choice.eta, choice.iterations, choice.status
        how = f"least horizon under budget {budget:g}"
    elif rate is None:
        rate, how = choose_rate(plant, schedule, prior, weights, progress), "least horizon for given P2"
    assert prior is not None
    assert rate is not None
    solver = SolverRecord("sampling_design", __version__, status, steps, time.perf_counter() - began, {"weights": how})
    return certify_given(plant, schedule, prior, *weights, rate, solver)


def _met(plant: Plant, schedule: AnySchedule) -> AnySchedule:
    if not isinstance(plant, Plant):
        raise ArgumentError(f"`plant` must be a Plant, got {type(plant).__name__}.")
    schedule = meet(plant, schedule)
    if not len(schedule) or schedule.times[-1] == 0:
        raise ArgumentError("`schedule` must hold a sample later than time 0: without one there is nothing to certify.")
    return schedule
