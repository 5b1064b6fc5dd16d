"""A certificate whose weights follow the bounds on noise and the first error, for narrow radii."""

from __future__ import annotations

from typing import TypedDict

import numpy.typing as npt

from sampling_design.certificates.certification import certify
from sampling_design.certificates.exact.bound_weights import weights_from_bounds
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.plants.plant import Plant, Signals
from sampling_design.records import checks
from sampling_design.records.progress import Progress
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import AnySchedule, SamplingFamily


class ErrorBoundArguments(TypedDict):
    """Bounds as verbs take them: a number bounds the norm, a vector each entry."""

    w_bound: npt.ArrayLike | None
    v_bound: npt.ArrayLike | None
    initial_error: npt.ArrayLike | None


@checked
def certify_for_bounds(
    plant: Plant,
    schedule: AnySchedule | SamplingFamily,
    *,
    w_bound: npt.ArrayLike | None = None,
    v_bound: npt.ArrayLike | None = None,
    initial_error: npt.ArrayLike | None = None,
    eta: float | None = None,
    progress: Progress | None = None,
) -> SampledCertificate:
    """Return the certificate of a schedule or family with the weights of `weights_from_bounds`.

    Parameters
    ----------
    plant : Plant
    schedule : Schedule, PeriodicSchedule or SamplingFamily
    w_bound, v_bound, initial_error : float or array, optional
        As the estimators take them. Default: the plant's scales, which also weigh where a bound is zero.
    eta : float, optional [1/time]
        Default: one over the longest gap; to find the best rate of a family takes minutes.
    progress : callable, optional
        Called with (fraction, message).

    Returns
    -------
    Certificate or FamilyCertificate

    Raises
    ------
    ArgumentError
        If a bound is negative or has another length.
    CertificateError
        If no certificate exists at this rate.

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> certify_for_bounds(plant, PeriodicSchedule([0.5, 1.0]), w_bound=0.1, v_bound=0.2).eta
    1.0
    """
    rate = 1 / schedule.d_max if eta is None else eta
    w = _or_scales("w_bound", w_bound, plant.disturbances)
    v, start = _or_scales("v_bound", v_bound, plant.outputs), _or_scales("initial_error", initial_error, plant.states)
    weights = weights_from_bounds(plant, rate, w, v, start)
    P2, Qw, R, Qv = (weights[key] for key in ("P2", "Qw", "R", "Qv"))
    return certify(plant, schedule, eta=rate, P2=P2, Qw=Qw, R=R, Qv=Qv, progress=progress)


def _or_scales(name: str, bound: npt.ArrayLike | None, signals: Signals) -> npt.ArrayLike:
    """A bound, or the scales where there is none or it is zero: nothing can be weighed by 1/0."""
    if bound is None:
        return signals.scales
    return bound if checks.bound(name, bound, len(signals.scales)).all() else signals.scales
