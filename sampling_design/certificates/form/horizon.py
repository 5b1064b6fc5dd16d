"""From a certificate to a horizon: Thm 9 of the paper, the sharper theorem, and the RGES constants of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sampling_design.errors import CertificateError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.checks import unit_diagonal
from sampling_design.records.evidence import Claim
from sampling_design.records.record import Record, short

_CONTRACTION = 4.0
"""By default a window shrinks the squared error at least by this factor (formats.md, Defaults)."""


class HasWeights(Protocol):
    """What a horizon needs of a certificate."""

    @property
    def plant(self) -> Plant: ...
    @property
    def P1(self) -> Array: ...
    @property
    def P2(self) -> Array: ...
    @property
    def Qw(self) -> Array: ...
    @property
    def R(self) -> Array: ...
    @property
    def Qv(self) -> Array: ...
    @property
    def eta(self) -> float: ...
    @property
    def lam_proven(self) -> float: ...
    @property
    def lam_samples_proven(self) -> float: ...
    @property
    def d_max(self) -> float: ...


@dataclass(frozen=True, eq=False, repr=False)
class Horizon(Record):
    """A window length of the moving horizon estimator, and the error bound that it buys.

        |e(t)|^2 <= C_x |e(0)|^2 e^{-eta_tilde t} + int C_w |w|^2 e^{-eta_tilde (t-s)} ds
                    + sum over samples C_v |v|^2 e^{-eta_tilde (t-tau)}

    Attributes
    ----------
    theorem : str
        "sharp" (estimator cost "certificate", half-open windows) or "paper" (Thm 9, cost (15)).
    minimum : float [time]
        The length M must exceed this.
    length : float [time]
        The length M for which the constants hold; by default the recommended one.
    eta_tilde : float [1/time]
        Rate of the squared error.
    C_x, C_w, C_v : float
        Gains on the initial error, the disturbance and the measurement noise, all in squared norms.
    lam : float
        The proven lambda_max(P2, P1) that entered.
    time_unit : str
    """

    theorem: str
    minimum: float
    length: float
    eta_tilde: float
    C_x: float
    C_w: float
    C_v: float
    lam: float
    time_unit: str = "s"

    _table = {
        "theorem": "{theorem}",
        "M >": "{minimum} {time_unit}",
        "M": "{length} {time_unit}",
        "eta_tilde": "{eta_tilde} 1/{time_unit}",
        "C_x": "{C_x}",
        "C_w": "{C_w}",
        "C_v": "{C_v}",
        "lambda": "{lam}",
    }

    def __float__(self) -> float:
        """The length M, so that `float(certificate.horizon())` is a horizon to use."""
        return self.length

    @property
    def claim(self) -> Claim:
        """The theorem behind the bound and what it assumes."""
        given = ("Assumption 7 with the certificate's weights", "linear plant", f"M > {short(self.minimum)}")
        if self.theorem == "paper":
            return Claim("RGES of the estimator with the cost (15)", "Theorem 9", given)
        convex = ("convex constraints that hold the truth", "half-open windows (t-M, t]", "every real window start")
        return Claim("RGES of the estimator with the certificate's cost", "sharper horizon theorem", (*given, *convex))

    def explain(self) -> str:
        """Say what the horizon promises."""
        return (
            f"With a window of {short(self.length)} {self.time_unit} (anything above {short(self.minimum)}) the "
            f"squared error decays at rate {short(self.eta_tilde)} per {self.time_unit}; disturbances enter with "
            f"C_w = {short(self.C_w)}, measurement noise with C_v = {short(self.C_v)}."
        )


def horizon_of(
    certificate: HasWeights, theorem: str = "sharp", length: float | None = None, *, apart: float | None = None
) -> Horizon:
    """Return the horizon of a certificate by the sharper theorem or by Thm 9 of the paper.

        sharp:  M > ln(lam)/eta,             eta_tilde = eta - ln(lam)/M
        paper:  M > 2 ln(2 lam_samples)/eta, eta_tilde = eta - ln(4 lam_samples^2)/M, M >= d_max

    Parameters
    ----------
    certificate : SampledCertificate
    theorem : "sharp", "paper", or "arrival": "sharp" with an arrival weight that lambda does not enter
    length : float, optional [time]
        Default max(d_max, ln(4 lam)/eta) and max(d_max, 2 ln(4 lam_samples)/eta): each window shrinks the
        squared error to a quarter.
    apart : float, optional
        V(t) <= this times J(truth), where estimate and truth differ from the centre of the data each by itself
        (Theorem G): a factor on lam and on every gain. Default 1, without "arrival".

    Returns
    -------
    Horizon

    Raises
    ------
    ArgumentError
        If the theorem is unknown.
    CertificateError
        If `length` is too short for the theorem.
    """
    checks.word("theorem", theorem, ("sharp", "paper") if apart is None else ("sharp", "arrival", "paper"))
    eta, paper, share = certificate.eta, theorem == "paper", 1.0 if apart is None else apart
    lam = certificate.lam_samples_proven if paper else certificate.lam_proven
    factor, lost = (2.0, 2.0 * lam) if paper else (1.0, share * (1.0 if theorem == "arrival" else lam))
    minimum = factor * np.log(lost) / eta
    with np.errstate(over="ignore"):
        default = max(certificate.d_max, float((factor * np.log(lost) + np.log(_CONTRACTION)) / eta))
    if not np.isfinite(default):
        raise CertificateError(
            f"The rate {eta:.3g} is so slow that the horizon is no number: ask for a larger `eta`.", minimum=minimum
        )
    M = default if length is None else checks.positive("length", length)
    least = max(minimum, certificate.d_max) if paper else minimum
    if not (minimum < M and least <= M):
        which = "this theorem" if apart is None or paper else "Theorem G"
        raise CertificateError(
            f"`length` = {M:.6g} is too short: {which} needs M > {least:.6g}.", minimum=least, length=M
        )
    low = least_eigenvalue(certificate.P2 / lam if paper else certificate.P1)
    gain = 4.0 * lam if paper else share
    noise = 2.0 * certificate.Qv if paper else output_information(certificate.R, certificate.Qv)
    C_x, C_w, C_v = (gain * largest_eigenvalue(W) / low for W in (certificate.P2, certificate.Qw, noise))
    return Horizon(
        theorem=theorem, minimum=float(minimum), length=float(M), eta_tilde=float(eta - factor * np.log(lost) / M),
        C_x=C_x, C_w=C_w, C_v=C_v, lam=float(lam), time_unit=certificate.plant.time_unit,
    )  # fmt: skip


def output_information(R: Array, Qv: Array) -> Array:
    """Return R~ = (R^-1 + Qv^-1)^-1, written R (R + Qv)^-1 Qv so that neither is inverted."""
    both = R @ np.linalg.solve(R + Qv, Qv)
    return (both + both.T) / 2


def least_eigenvalue(matrix: Array) -> float:
    """Least eigenvalue of a positive definite matrix, to its own digits whatever the units; infinity if it is empty.

    With `matrix` = d M d, M = L L' of diagonal about one, it is 1/|L^-1 d^-1|^2; an eigenvalue beside others that are
    1e16 times larger would have no digits.
    """
    if not matrix.size:
        return float("inf")
    d, M = unit_diagonal(matrix)
    least = float(np.linalg.eigvalsh(M)[0])
    if least <= 0:
        return float(np.linalg.eigvalsh(matrix)[0])
    return float(1 / np.linalg.norm(np.linalg.solve(np.linalg.cholesky(M), np.diag(1 / d)), 2)) ** 2


def largest_eigenvalue(matrix: Array) -> float:
    """Largest eigenvalue of a symmetric matrix; 0 if it is empty."""
    return float(np.linalg.eigvalsh(matrix)[-1]) if matrix.size else 0.0
