"""The record of a discounted dissipation inequality (Thm 10): P, eta, c_w, c_y, and its file."""

from __future__ import annotations

from dataclasses import field
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.form.claims import DETECTABILITY_CLAIM
from sampling_design.certificates.form.horizon import Constant, ConstantList
from sampling_design.certificates.rigorous.decide import VerifiableRecord
from sampling_design.errors import CertificateError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, above, below, frozen
from sampling_design.records.record import Claim, Plain, SolverRecord, with_digest

METHODS = ("riccati", "proof", "given")


@frozen
class DetectabilityCertificate(VerifiableRecord):
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
    margin : float
        What `verify` proves is the inequality at the rate (1 + margin) eta.
    method : str
        "riccati", "proof" or "given".
    gain : (n, p) array, optional
        Observer gain L behind the certificate; A - LC is Hurwitz. Not in the file: c_y P^{-1} C' is always one.
    constants : ConstantList
        The numbers of the proof in order, where there is one. Not in the file, which holds nothing unproven.

    Raises
    ------
    ArgumentError
        If P is not symmetric positive definite, a constant is not positive, or the method is another.

    Notes
    -----
    *Claim.* `verify` decides from A, C, G, P, eta, c_w, c_y, margin alone whether P > 0 and

        [[A'P + PA + (1 + margin) eta P - c_y C'C, PG], [G'P, -c_w I]] < 0;

    its `amount` is the least eigenvalue relative to the size of the terms, `direction` says where it fails.
    *Assumptions.* None beyond a linear
    plant; outputs are noise-free here, noise enters where samples do. The paper's (19) has lost the factors
    e^{-eta(t-s)}.

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
    P: Converted[npt.ArrayLike, Array]
    eta: float
    c_w: float
    c_y: float
    margin: float = field(default=0.0, kw_only=True)
    method: str = field(default="given", kw_only=True)
    gain: Converted[npt.ArrayLike | None, Array | None] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    constants: ConstantList = field(default=ConstantList(), kw_only=True)
    solver: SolverRecord | None = field(default=None, kw_only=True)

    _weights = ("P",)
    _inequality = r"""  |\Delta x(t)|_P^2 \le e^{-\eta t} |\Delta x(0)|_P^2
    + \int_0^t e^{-\eta (t-\tau)} \big( c_w |\Delta w(\tau)|^2 + c_y |\Delta y(\tau)|^2 \big) \,d\tau"""
    _answers = (
        "a plant is {claim.statement}",
        "{claim.evidence}",
        "errors decay at {eta} 1/{plant.time_unit}, with gains {c_w} of w and {c_y} of y",
        "`.verify()`, `.verify(rigorous=True)`",
    )
    _table = {"cond P": "{overshoot}", "method": "{method}", "margin": "{margin:3}", "slack": "{verify.amount:down}"}

    def _rows(self) -> list[tuple[str, str]]:
        return super()._rows() + self.constants.lines()

    def __post_init__(self) -> None:
        checks.of_kind("plant", self.plant, Plant)
        checks.word("method", self.method, METHODS)
        n, p = self.plant.n_states, self.plant.n_outputs
        object.__setattr__(self, "P", checks.definite("P", self.P, n))
        for key in ("eta", "c_w", "c_y"):
            object.__setattr__(self, key, checks.positive(key, getattr(self, key)))
        object.__setattr__(self, "margin", checks.nonnegative("margin", self.margin))
        if self.gain is not None:
            object.__setattr__(self, "gain", checks.matrix("gain", self.gain, n, p))

    def __getattr__(self, name: str) -> NoReturn:
        # what only a certificate about samples has: asked for by an estimator or a validation that was given this one
        raise AttributeError(
            f"a DetectabilityCertificate promises nothing about samples and has no `{name}`: "
            "certify(plant, schedule) makes a certificate that has."
        )

    @property
    def overshoot(self) -> float:
        """cond(P): how far |dx|^2 may rise above its start before the decay shows."""
        values = np.linalg.eigvalsh(self.P)
        return float(values[-1] / values[0])

    @property
    def claim(self) -> Claim:
        """What is proven, and from which theorem."""
        return Claim(
            f"exponentially i-iIOSS at rate {below(self.eta)} with c_w = {above(self.c_w)}, c_y = {above(self.c_y)}",
            theorem="Theorem 10 (discounted)",
            assumptions=("x' = Ax + Bu + Gw, y = Cx + Du",),
        )

    def _numbers(self) -> ConstantList:
        stated = ((key, getattr(self, key), rf"\{key}" * (key == "eta") or key) for key in ("eta", "c_w", "c_y"))
        first = [Constant(key, value, symbol, "Definition 1", symbol) for key, value, symbol in stated]
        return ConstantList([*first, *(each for each in self.constants if each.name not in ("eta", "c_w", "c_y"))])

    def to_dict(self) -> dict[str, Plain]:
        """Plain data as in the file, digest included."""
        numbers = {key: getattr(self, key) for key in ("eta", "c_w", "c_y", "margin")}
        parts = {"claim": DETECTABILITY_CLAIM, "P": self.P, **numbers, "method": self.method}
        return with_digest(self.plant, parts, solver=self.solver)

    def explain(self) -> str:
        """Say what the certificate promises."""
        return (
            "The plant is detectable: two trajectories with the same inputs, disturbances and outputs come together. "
            f"Their squared distance in the norm of P decays like e^(-{below(self.eta)} t), t in "
            f"{self.plant.time_unit}. A difference in w adds to it with gain {above(self.c_w)}, one in y with gain "
            f"{above(self.c_y)}."
        )


def proven(certificate: DetectabilityCertificate) -> DetectabilityCertificate:
    """Return `certificate` if it passes its own check.

    Raises CertificateError if it does not; `details` holds the verdict.
    """
    verdict = certificate.verify()
    if not verdict.passed:
        raise CertificateError(f"No detectability certificate: {verdict.reason}.", verdict=verdict)
    return certificate
