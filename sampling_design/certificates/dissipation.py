"""The record of a discounted dissipation inequality (Thm 10): P, eta, c_w, c_y, and its check by eigenvalues alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._record import Record, short
from sampling_design.certificates.constants import ConstantList
from sampling_design.errors import CertificateError
from sampling_design.evidence import Claim, SolverRecord
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class DissipationCheck(Record):
    """Outcome of `DetectabilityCertificate.verify`: eigenvalues against the rounding they may carry.

    Parameters
    ----------
    margin : float
        Least eigenvalue of the negative dissipation matrix, scaled to unit diagonal; negative where it fails.
    least_P : float
        Least eigenvalue of P.
    rounding : float
        Bound of the rounding in `margin`.
    """

    margin: float
    least_P: float
    rounding: float

    @property
    def passed(self) -> bool:
        """Whether P > 0 and the dissipation matrix is negative definite by more than rounding."""
        return bool(self.least_P > 0 and self.margin > self.rounding)

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("passed", str(self.passed)),
            ("margin", short(self.margin)),
            ("rounding", short(self.rounding)),
            ("least eigenvalue of P", short(self.least_P)),
        ]

    def explain(self) -> str:
        """Say what was found."""
        if self.passed:
            return (
                f"The dissipation inequality holds with margin {short(self.margin)} (rounding {short(self.rounding)})."
            )
        return (
            f"The dissipation inequality is not established: margin {short(self.margin)} "
            f"against rounding {short(self.rounding)}, least eigenvalue of P {short(self.least_P)}."
        )


@dataclass(frozen=True, eq=False, repr=False)
class DetectabilityCertificate(Record):
    """V(x) = x'Px decays at rate eta up to disturbance and output, so that the plant is exponentially i-iIOSS.

        |dx(t)|_P^2 <= e^{-eta t} |dx(0)|_P^2 + int_0^t e^{-eta(t-s)} (c_w |dw(s)|^2 + c_y |C dx(s)|^2) ds

    Parameters
    ----------
    plant : Plant
    P : (n, n) array
        Symmetric positive definite.
    eta : float [1/time_unit]
        Rate of the squared error.
    c_w, c_y : float
        Gains of the disturbance w (through G) and of the output difference, in the plant's own coordinates.
    method : str
        "riccati", "lmi", "proof" or "given".
    gain : (n, p) array, optional
        Observer gain L behind the certificate; A - LC is Hurwitz.
    constants : ConstantList
        The numbers of the proof in order, where there is one.

    Raises
    ------
    ArgumentError
        If P is not symmetric positive definite or a constant is not positive.

    Notes
    -----
    *Claim.* `verify` decides it from A, C, G, P, eta, c_w, c_y alone. *Assumptions.* None beyond a linear plant;
    outputs are noise-free here, noise enters where samples do. The paper's (19) has lost the factors e^{-eta(t-s)}.

    References
    ----------
    The paper, Definition 1 and Theorem 10; theory 1.6, E1.

    Examples
    --------
    x' = x + w, y = x, V = x^2: V' = 2x^2 + 2xw <= -V + w^2 + 4y^2, with equality at w = x.

    >>> plant = Plant([[1.0]], [[1.0]])
    >>> DetectabilityCertificate(plant, [[1.0]], eta=1.0, c_w=1.0, c_y=4.01).verify().passed
    True
    >>> DetectabilityCertificate(plant, [[1.0]], eta=1.0, c_w=1.0, c_y=3.99).verify().passed
    False
    """

    plant: Plant
    P: Array
    eta: float
    c_w: float
    c_y: float
    method: str = field(default="given", kw_only=True)
    gain: Array | None = field(default=None, kw_only=True)
    constants: ConstantList = field(default=ConstantList(), kw_only=True)
    solver: SolverRecord | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        n, p = self.plant.n_states, self.plant.n_outputs
        object.__setattr__(self, "P", _checks.definite("P", self.P, n))
        for key in ("eta", "c_w", "c_y"):
            object.__setattr__(self, key, _checks.positive(key, getattr(self, key)))
        if self.gain is not None:
            object.__setattr__(self, "gain", _checks.matrix("gain", self.gain, n, p))

    @property
    def overshoot(self) -> float:
        """cond(P): how far |dx|^2 may rise above its start before the decay shows."""
        values = np.linalg.eigvalsh(self.P)
        return float(values[-1] / values[0])

    @property
    def claim(self) -> Claim:
        """What is proven, and from which theorem."""
        return Claim(
            f"exponentially i-iIOSS at rate {short(self.eta)} with c_w = {short(self.c_w)}, c_y = {short(self.c_y)}",
            theorem="Theorem 10 (discounted)",
            assumptions=("x' = Ax + Bu + Gw, y = Cx + Du",),
        )

    def verify(self) -> DissipationCheck:
        """Recompute the eigenvalues of [[A'P+PA+eta P-c_y C'C, PG], [G'P, -c_w I]] from the data alone."""
        return dissipation_check(self.plant, self.P, self.eta, self.c_w, self.c_y)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the tree of a certificate with claim "detectability" without its plant."""
        return {
            "claim": "detectability",
            "P": self.P.tolist(),
            "eta": self.eta,
            "c_w": self.c_w,
            "c_y": self.c_y,
            "method": self.method,
            "solver": None if self.solver is None else self.solver.to_dict(),
        }

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.plant.time_unit
        rows = [
            ("eta", f"{short(self.eta)} 1/{unit}"),
            ("c_w", short(self.c_w)),
            ("c_y", short(self.c_y)),
            ("cond P", short(self.overshoot)),
            ("method", self.method),
            ("margin", short(self.verify().margin)),
        ]
        return rows + [(c.name, f"{short(c.value)}  ({c.source})") for c in self.constants]

    def explain(self) -> str:
        """Say what the certificate promises."""
        return (
            f"Two trajectories of this plant with the same input and output come together: their squared distance in "
            f"the norm of P shrinks by e^(-{short(self.eta)} t), t in {self.plant.time_unit}; whatever keeps them "
            f"apart shows in w (gain {short(self.c_w)}) or in y (gain {short(self.c_y)})."
        )


def dissipation_check(plant: Plant, P: Array, eta: float, c_w: float, c_y: float) -> DissipationCheck:
    """Judge the dissipation inequality for V = x'Px by eigenvalues alone.

    Notes
    -----
    *Numerical aspects.* The congruence with blkdiag(L^{-T}/sqrt(eta), I/sqrt(c_w)), P = LL', makes every entry
    dimensionless and leaves the sign as it is; a rotation that puts c_y C'C on the diagonal and a scaling to unit
    diagonal then keep that term, which may be 1e15 times the rest, from drowning it in its rounding.
    """
    n, q = plant.n_states, plant.n_disturbances
    values = np.linalg.eigvalsh(P)
    if values[0] <= 0:
        return DissipationCheck(-float("inf"), float(values[0]), 0.0)
    L = np.linalg.cholesky(P)
    U, sizes, _ = np.linalg.svd(np.linalg.solve(L, plant.C.T) * np.sqrt(c_y / eta))
    seen = np.zeros(n)
    seen[: sizes.size] = sizes**2
    Z = U.T @ np.linalg.solve(L, plant.A.T @ L) @ U / eta
    off = U.T @ L.T @ plant.G / np.sqrt(eta * c_w)
    negative = np.block([[np.diag(seen) - Z - Z.T - np.eye(n), -off], [-off.T, np.eye(q)]])
    diagonal = np.diag(negative)
    if diagonal.min() <= 0:
        return DissipationCheck(float(diagonal.min()), float(values[0]), 0.0)
    root = np.sqrt(diagonal)
    size = 1 + (2 * np.linalg.norm(Z, 2) + np.linalg.norm(off, 2)) * np.sqrt(values[-1] / values[0]) / diagonal.min()
    rounding = 8 * (n + q) * np.finfo(float).eps * float(size)
    return DissipationCheck(float(np.linalg.eigvalsh(negative / root / root[:, None])[0]), float(values[0]), rounding)


def proven(certificate: DetectabilityCertificate) -> DetectabilityCertificate:
    """Return `certificate` if it passes its own check.

    Raises
    ------
    CertificateError
        If it does not; `details` holds the check.
    """
    check = certificate.verify()
    if not check.passed:
        raise CertificateError(f"No detectability certificate: {check.explain()}", check=check)
    return certificate
