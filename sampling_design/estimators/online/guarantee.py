"""What a certificate says about an estimator: its horizon, and whether the a-priori claim is still its own."""

from __future__ import annotations

import math
import warnings
from typing import Any

from sampling_design import _checks
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.estimator import GuaranteeWarning


def least_horizon(certificate: Any, cost: str) -> float:
    """Return the horizon that M must exceed: ln(lam)/eta, for the paper's cost the lesser of its own two.

    The paper's theorem asks 4 lam_samples^2 e^{-eta M} < 1 of the paper's cost, the sharper one 2 lam e^{-eta M} < 1.
    """
    lam, eta = _lam(certificate), float(certificate.eta)
    if cost == "certificate":
        return max(0.0, math.log(lam) / eta)
    return min(2 * math.log(2 * _lam_samples(certificate)) / eta, math.log(2 * lam) / eta)


def default_horizon(certificate: Any, cost: str, d_max: float) -> float:
    """Return max(d_max, ln(4 lam)/eta), for the paper's cost max(d_max, 2 ln(4 lam_samples)/eta)."""
    lam, eta = _lam(certificate), float(certificate.eta)
    if cost == "certificate":
        return max(d_max, math.log(4 * lam) / eta)
    return max(d_max, 2 * math.log(4 * _lam_samples(certificate)) / eta)


def _lam(certificate: Any) -> float:
    """The upper bound of lambda that is proven, not the value that is attained."""
    return float(getattr(certificate, "lam_proven", certificate.lam))


def _lam_samples(certificate: Any) -> float:
    found = getattr(certificate, "lam_samples_proven", getattr(certificate, "lam_samples", None))
    return _lam(certificate) if found is None else float(found)


def longest_gap(schedule: Any) -> float:
    """Return the longest time between samples of a schedule or family, the first sample's time included."""
    if schedule is None:
        return 0.0
    if hasattr(schedule, "d_max"):
        return float(schedule.d_max)
    gaps = schedule.gaps
    first = float(schedule.times[0]) if getattr(schedule, "period", None) is None and schedule.times.size else 0.0
    return max(first, float(gaps.max()) if gaps.size else 0.0)


def choose_horizon(
    certificate: Any, horizon: Any, cost: str, overridden: tuple[str, ...], carried: bool
) -> tuple[float, str]:
    """Return the horizon and, in words, why there is no a-priori claim ("" if there is one).

    Raises
    ------
    ArgumentError
        If there is neither a certificate nor a horizon.

    Warns
    -----
    GuaranteeWarning
        If the horizon is not longer than the certificate allows.
    """
    if certificate is None:
        if horizon is None:
            raise ArgumentError("`horizon` must be given where there is no certificate to take it from.")
        return _checks.positive("horizon", horizon), "No a-priori claim: the weights were given by hand."
    d_max = longest_gap(getattr(certificate, "schedule", None))
    length = default_horizon(certificate, cost, d_max) if horizon is None else _checks.positive("horizon", horizon)
    if overridden:
        return length, f"No a-priori claim: {', '.join(overridden)} differ from the certificate's."
    least = least_horizon(certificate, cost)
    if not carried and length <= least:
        note = f"No a-priori claim: the horizon {length:.6g} must exceed {least:.6g} for this certificate."
        warnings.warn(note, GuaranteeWarning, stacklevel=4)
        return length, note
    return length, ""
