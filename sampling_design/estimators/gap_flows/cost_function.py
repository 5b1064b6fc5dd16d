"""What a user says of the cost that an estimator minimises, all of it in one place."""

from __future__ import annotations

from typing import ClassVar, Literal, get_args

import numpy.typing as npt

from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import Record, short

Form = Literal["certificate", "paper"]
ArrivalKind = Literal["fixed", "filtered"]
Beginning = Literal["horizon", "sample"]
MATRICES = ("P2", "Qw", "R", "Qv")


@frozen
class CostFunction(Record):
    """The cost that an estimator minimises over a window that began at s, at time t.

        "certificate":  e^{-eta(t-s)}|x(s) - xhat(s)|^2_P2 + int e^{-eta(t-tau)}|w|^2_Qw
                            + sum e^{-eta(t-tau)}|y - Cx - Du|^2_R~,          R~ = (R^-1 + Qv^-1)^-1
        "paper":        2 e^{-eta(t-s)}|x(s) - xhat(s)|^2_P2 + int 2 e^{-eta(t-tau)}|w|^2_Qw
                            + sum e^{-eta(t-tau)}(2|v|^2_Qv + |y - Cx - Du - v|^2_R)

    What is left out comes from the certificate. Without certificate and weights each bound of the estimator is one
    (`weights_from_bounds` at the rate eta, one over the horizon, or the plant's fastest); else they are those of the
    plant's scales: P2 = diag(1/s_x^2), Qw = diag(1/s_w^2), R = Qv = 2 diag(1/s_y^2), eta = 0.

    Parameters
    ----------
    P2 : (n, n) array, optional
        Weight of the error at the window's start.
    Qw : (q, q) array, optional
        Weight of the disturbance, per unit of time.
    R, Qv : (p, p) arrays, optional
        Weights of the fit and of the noise.
    eta : float, optional
        Discount rate [1/time] of the squared errors.
    form : "certificate" or "paper", optional
        Default "certificate"; for nonlinear plants it is "paper", whose window is closed.
    arrival : "fixed" or "filtered"
        What the error at the window's start weighs: always P2, or its own information Pi(s), which gives the full rate
        for every horizon.
    begins : "horizon" or "sample"
        s = t - M, as in the paper; or the last sample until then, which is at most one gap earlier, keeps every claim
        (a longer window has the rate of M and more), and spares flows to a time between samples where gaps are uneven.

    Raises
    ------
    ArgumentError
        If a weight is no square matrix, the rate is negative or a word is unknown. The sizes meet the plant's in the
        estimator.

    Examples
    --------
    >>> from sampling_design import KalmanFilter, Plant
    >>> cost = CostFunction(P2=[[1.0]], Qw=[[1e9]], R=[[2.0]], Qv=[[2.0]])
    >>> KalmanFilter(Plant([[0.0]], [[1.0]]), cost=cost).update(1.0, [3.0]).x.round(6)
    array([1.5])
    """

    P2: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    Qw: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    R: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    Qv: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    eta: float | None = None
    form: Form | None = None
    arrival: ArrivalKind = "fixed"
    begins: Beginning = "horizon"

    _slip: ClassVar[str] = "Use CostFunction(P2=, Qw=, R=, Qv=, eta=, form=, arrival=, begins=)."

    def __post_init__(self) -> None:
        for key in MATRICES:
            value = getattr(self, key)
            if value is not None:
                array = checks.matrix(key, value)
                self._hold(**{key: checks.matrix(key, value, len(array), len(array))})
        self._check(eta=checks.nonnegative)
        words_of = ("form", self.form, Form), ("arrival", self.arrival, ArrivalKind), ("begins", self.begins, Beginning)
        for key, value, known in words_of:
            named = is_text(value) and value in get_args(known)
            if not (named or (key == "form" and value is None)):
                words = " or ".join(f'"{word}"' for word in get_args(known))
                raise ArgumentError(f"`{key}` must be {words}, got {checks.described(value)}.")

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the weights and the rate that are given here."""
        return tuple(key for key in (*MATRICES, "eta") if getattr(self, key) is not None)

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(key, short(getattr(self, key), 4)) for key in self.given]
        rows += [] if self.form is None else [("form", self.form)]
        return [*rows, ("arrival", self.arrival), ("begins", self.begins)]

    def explain(self) -> str:
        """Say what is given and what is taken from elsewhere."""
        given = f"{', '.join(self.given)} given" if self.given else "No weight given"
        weighs = "P2" if self.arrival == "fixed" else "what is known of it"
        weighs += "" if self.begins == "horizon" else "; windows begin at a sample"
        return f"{given}, the rest from the certificate or the scales; the window's first error weighs {weighs}."
