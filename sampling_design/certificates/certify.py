"""From a plant and a schedule to a proven certificate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import __version__, _checks
from sampling_design._linalg import symmetrise
from sampling_design.certificates.certificate import RESOLUTION, Certificate, Verification, Witness
from sampling_design.certificates.existence import require_certificate
from sampling_design.certificates.riccati import Peak, at_peak, supremum
from sampling_design.certificates.window_problem import AnySchedule, WindowProblem, window_problem
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.evidence import SolverRecord
from sampling_design.observability.meeting import meet
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

STATED_MARGIN = 1e-4
"""Margin that a certificate states: Pi >= (1 + this) P1; the rest of the 1e-3 between P1 and P2/lam is for the proof."""
ATTEMPTS = 6


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
    problem = window_problem(plant, schedule, P2, Qw, R, Qv, eta)
    lam, lam_samples, witness = 1.0, 1.0, Witness(0.0, 0.0, (), 1.0)
    if plant.n_states:
        anywhere, at_samples = supremum(problem)
        lam, lam_samples = max(anywhere.value, 1.0), max(at_samples.value, 1.0)
        witness = witness_of(problem, anywhere)
    made = Certificate(
        plant,
        schedule,
        (1 - RESOLUTION) * P2 / lam,
        P2,
        Qw,
        R,
        Qv,
        eta,
        lam,
        lam_samples,
        STATED_MARGIN,
        witness if witness.direction else None,
        solver,
    )
    return made


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
