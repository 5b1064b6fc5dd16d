"""From a plant and a schedule to a proven certificate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import __version__, _checks
from sampling_design.certificates.certificate import RESOLUTION, Certificate, Witness
from sampling_design.certificates.existence import require_certificate
from sampling_design.certificates.riccati import Peak, at_peak, located, refine, supremum
from sampling_design.certificates.window_problem import AnySchedule, WindowProblem, window_problem
from sampling_design.errors import CertificateError
from sampling_design.evidence import SolverRecord
from sampling_design.observability.meeting import meet
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

STATED_MARGIN = 1e-4
"""Margin that a certificate states, Pi >= (1 + this) P1; what is left of the 1e-3 is for the proof."""
ATTEMPTS = 8
"""How often a window that the checker found may raise lambda before the proof is given up."""


def default_weights(plant: Plant) -> tuple[Array, Array, Array]:
    """Return Qw = diag(1/s_w^2), R = Qv = 2 diag(1/s_y^2), so that R~ = diag(1/s_y^2)."""
    noise = 2.0 * np.diag(1.0 / plant.outputs.scales**2)
    return np.diag(1.0 / plant.disturbances.scales**2), noise, noise.copy()


def weights_of(plant: Plant, Qw: Any, R: Any, Qv: Any) -> tuple[Array, Array, Array]:
    """Return the weights as given, where None the default; one of R and Qv stands for both."""
    w, r, _ = default_weights(plant)
    one = r if R is None and Qv is None else (Qv if R is None else R)
    p = plant.n_outputs
    return (
        _checks.symmetric("Qw", w if Qw is None else Qw, plant.n_disturbances),
        _checks.definite("R" if R is not None else "Qv", one if R is None else R, p),
        _checks.definite("Qv" if Qv is not None else "R", one if Qv is None else Qv, p),
    )


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
        return Certificate(plant, schedule, P2, P2, Qw, R, Qv, eta, 1.0, 1.0, 0.0, None, solver)
    problem = window_problem(plant, schedule, P2, Qw, R, Qv, eta)
    anywhere, at_samples = supremum(problem)
    for _ in range(ATTEMPTS):
        made = _made(plant, schedule, problem, (P2, Qw, R, Qv), (anywhere, at_samples), solver)
        verdict = made.verify()
        if verdict.passed:
            return made
        if verdict.time is None or verdict.start is None:
            break
        missed = located(problem, verdict.start, verdict.time)
        if "samples" in verdict.inequality:
            at_samples = max(refine(problem, missed, 0.0), at_samples, key=lambda peak: peak.value)
        else:
            missed = refine(problem, missed, problem.reach[missed.index] / 16)
        anywhere = max(anywhere, missed, at_samples, key=lambda peak: peak.value)
    raise CertificateError(
        f"the proof of the certificate did not close: {verdict.reason}.", verification=verdict, certificate=made
    )


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
    return Certificate(plant, schedule, P1, P2, Qw, R, Qv, problem.eta, lam, lam_samples, STATED_MARGIN, seen, solver)


def witness_of(problem: WindowProblem, peak: Peak) -> Witness:
    """Return where a peak is attained, in the plant's coordinates."""
    Y, t, start = at_peak(problem, peak)
    values, vectors = np.linalg.eigh(Y)
    direction = problem.physical(vectors[:, -1])
    return Witness(t, start, tuple(float(v) for v in direction), float(values[-1]))


def certify(
    plant: Plant,
    schedule: AnySchedule,
    *,
    eta: float | None = None,
    P2: npt.ArrayLike | None = None,
    Qw: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    Qv: npt.ArrayLike | None = None,
    budget: float = 3.0,
    progress: Progress | None = None,
) -> Certificate:
    schedule = meet(plant, schedule)
    weights = weights_of(plant, Qw, R, Qv)
    return certify_given(
        plant,
        schedule,
        _checks.definite("P2", P2, plant.n_states),
        *weights,
        eta,
        SolverRecord("given weights", __version__),
    )
