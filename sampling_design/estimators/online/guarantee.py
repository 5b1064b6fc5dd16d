"""What a certificate says about an estimator: its horizon, and whether the a-priori claim is still its own."""

from __future__ import annotations

import math
import warnings

from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_function import CostFunction
from sampling_design.estimators.online.estimator import GuaranteeWarning
from sampling_design.records import checks


def least_horizon(certificate: SampledCertificate, cost: str) -> float:
    """Return the horizon that M must exceed: ln(lam)/eta, for the paper's cost the lesser of its own two.

    The paper's theorem asks 4 lam_samples^2 e^{-eta M} < 1 of the paper's cost, the sharper one 2 lam e^{-eta M} < 1.
    """
    lam, eta = certificate.lam_proven, certificate.eta
    if cost == "certificate":
        return max(0.0, math.log(lam) / eta)
    return min(2 * math.log(2 * certificate.lam_samples_proven) / eta, math.log(2 * lam) / eta)


def choose_horizon(
    certificate: SampledCertificate | None,
    horizon: float | None,
    cost: CostFunction,
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
        return own_horizon(horizon), "No a-priori claim: the weights were given by hand."
    if horizon is None:
        length = certificate.horizon("paper" if cost.form == "paper" else "sharp").length
    else:
        length = checks.positive("horizon", horizon)
    if cost.given:
        return length, f"No a-priori claim: {', '.join(cost.given)} differ from the certificate's."
    least = least_horizon(certificate, cost.form or "certificate")
    return length, too_short(length, least) if cost.arrival == "fixed" and length <= least else ""


def own_horizon(horizon: float | None) -> float:
    """Return the horizon that was given.

    Raises
    ------
    ArgumentError
        If none was.
    """
    if horizon is None:
        raise ArgumentError("`horizon` must be given where there is no certificate to take it from.")
    return checks.positive("horizon", horizon)


def too_short(length: float, least: float) -> str:
    """Warn that a horizon is not longer than a certificate allows; return the warning's words."""
    note = f"No a-priori claim: the horizon {length:.6g} must exceed {least:.6g} for this certificate."
    warnings.warn(note, GuaranteeWarning, stacklevel=5)
    return note
