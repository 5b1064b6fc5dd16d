"""What a certificate says about an estimator: its horizon, and whether the a-priori claim is still its own."""

from __future__ import annotations

import math
import warnings

import numpy as np

from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_function import CostFunction
from sampling_design.estimators.online.estimator import GuaranteeWarning
from sampling_design.records import checks


def choose_horizon(
    certificate: SampledCertificate | None, horizon: float | None, cost: CostFunction, theorem: str
) -> tuple[float, str]:
    """Return the horizon and, in words, why there is no a-priori claim ("" if there is one).

    With the paper's cost M must exceed the lesser of two: the paper's theorem asks 4 lam_samples^2 e^{-eta M} < 1, the
    sharper one 2 lam e^{-eta M} < 1. Raises ArgumentError if there is neither a certificate nor a horizon.

    Parameters
    ----------
    certificate : Certificate, FamilyCertificate or InclusionCertificate, optional
    horizon : float, optional [time]
        Default: the one that the certificate recommends.
    cost : CostFunction
        Weights that are given and differ from the certificate's leave no claim.
    theorem : str
        The one that the estimator's cost needs, as `certificate.horizon` takes it.

    Warns
    -----
    GuaranteeWarning
        If the horizon is not longer than the certificate allows.
    """
    if certificate is None:
        if horizon is None:
            raise ArgumentError("`horizon` must be given where there is no certificate to take it from.")
        return checks.positive("horizon", horizon), "No a-priori claim: no certificate was given."
    own = certificate.horizon(theorem)
    length = own.length if horizon is None else checks.positive("horizon", horizon)
    differ = [key for key in cost.given if not np.array_equal(getattr(cost, key), getattr(certificate, key))]
    if differ:
        return length, f"No a-priori claim: {', '.join(differ)} differ from the certificate's."
    least = own.minimum
    if theorem == "paper":
        least = min(least, math.log(2 * certificate.lam_proven) / certificate.eta)
    if cost.arrival != "fixed" or length > least:
        return length, ""
    note = f"No a-priori claim: the horizon {length:.6g} must exceed {least:.6g} for this certificate."
    warnings.warn(note, GuaranteeWarning, stacklevel=4)
    return length, note
