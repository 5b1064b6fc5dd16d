"""The certificate of sample-based exponential i-iIOSS (Assumption 7)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, cast

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.exact.given_weights import FREE_DISTURBANCE
from sampling_design.certificates.form.claims import CLAIM, RESOLUTION
from sampling_design.certificates.form.horizon import (
    CONTRACTION,
    Constant,
    ConstantList,
    Horizon,
    largest_eigenvalue,
    least_eigenvalue,
    output_information,
)
from sampling_design.certificates.rigorous.decide import VerifiableRecord
from sampling_design.checkers.claims import claim_of
from sampling_design.checkers.parts import FORMAT
from sampling_design.checkers.parts import Plant as FilePlant
from sampling_design.checkers.schedule_file import Sampled
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.numerics.linalg import generalised_max
from sampling_design.observability.alignment import align
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import Claim, Plain, SolverRecord, above, below, moment, with_digest
from sampling_design.schedules.family import AnySchedule, SamplingFamily
from sampling_design.schedules.sampling_set import ROUNDING
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

WITHOUT_GAIN = "noise gain is beyond"  # how the weights are told that keep no noise gain as it was asked for
MATRICES: tuple[str, ...] = ("P1", "P2", "Qw", "R", "Qv")
NUMBERS: tuple[str, ...] = ("eta", "lam", "lam_samples", "margin")
"""What a file of this claim holds as it is, beside plant, times and witness."""


@dataclass(frozen=True)
class Witness:
    """Where lambda is attained: the window that starts at `start`, time `t`, and the direction x.

    `ratio` is x'P2x / x'Pi(t)x, reached to rounding.
    """

    t: float
    start: float
    direction: tuple[float, ...]
    ratio: float


@dataclass(frozen=True, eq=False, repr=False)
class SampledCertificate(VerifiableRecord, ABC):
    """Weights with which samples make a plant sample-based exponentially i-iIOSS: what estimators and validation take.

        |Dx(t)|^2_{P1} <= e^{-eta t} |Dx(0)|^2_{P2} + int e^{-eta (t-s)} |Dw|^2_{Qw} ds
                          + sum over [0,t] n K_i of e^{-eta (t-tau)} (|Dy|^2_R + |Dv|^2_{Qv})

    for all t >= 0, all K_i and, beyond the paper, for windows that start at any real time. A leaf says for which sample
    times: one schedule (`Certificate`) or every schedule of a family (`FamilyCertificate`).

    Attributes
    ----------
    plant : Plant
    P1, P2 : (n, n) arrays
    Qw : (q, q) array; R, Qv : (p, p) arrays
    eta : float [1/time]
        Discount rate of the squared error.
    lam : float
        Supremum of lambda_max(P2, Pi) over all real window starts and later times (for a family an upper bound).
    lam_samples : float
        The same over windows that start at samples (Thm 9).
    margin : float
        Pi >= (1 + margin) P1 is what `verify` proves.
    witness : Witness or None
        Where `lam` is attained; None where it need not be.
    solver : SolverRecord
        How the weights were found. Never evidence.

    References
    ----------
    The paper, Assumption 7, equation (16); Theorem 9.
    """

    _slip: ClassVar[str] = "Weights go by name: P2=, Qw=, R=, Qv=, eta=."
    _maker: ClassVar[str] = "certify(plant, schedule)"
    _reader: ClassVar[str] = "read_certificate"
    _weights = MATRICES
    _inequality = r"""  |\Delta x(t)|_{P_1}^2 &\le e^{-\eta t} |\Delta x(0)|_{P_2}^2
    + \int_0^t e^{-\eta (t-\tau)} |\Delta w(\tau)|_{Q_w}^2 \,d\tau \\
    &\quad + \sum_{\tau \in [0,t] \cap K_i} e^{-\eta (t-\tau)}
    \big( |\Delta y(\tau)|_R^2 + |\Delta v(\tau)|_{Q_v}^2 \big)"""
    _apart: ClassVar[float] = 1.0
    """V(t) <= this times J(truth): 4 where estimate and truth differ from the centre of the data each by itself."""
    plant: Plant
    P1: Array = field(kw_only=True)
    P2: Array = field(kw_only=True)
    Qw: Array = field(kw_only=True)
    R: Array = field(kw_only=True)
    Qv: Array = field(kw_only=True)
    eta: float = field(kw_only=True)
    lam: float = field(kw_only=True)
    lam_samples: float = field(kw_only=True)
    margin: float = field(default=0.0, kw_only=True)
    witness: Witness | None = field(default=None, kw_only=True)
    solver: SolverRecord = field(default_factory=lambda: SolverRecord("given"), kw_only=True)

    _answers = (
        "{claim.statement}",
        "{claim.evidence}",
        "windows longer than {horizon.minimum} {plant.time_unit} contract",
        "`.verify()`, `.verify(rigorous=True)`",
    )
    _table = {
        "eta": "{eta} 1/{plant.time_unit}",
        "lambda": "{lam}",
        "lambda, sample starts": "{lam_samples}",
        "horizon, paper": "M > {_paper_horizon.minimum} {plant.time_unit}",
        "C_x, C_w, C_v": "{horizon.C_x:3}, {horizon.C_w:3}, {horizon.C_v:3}",
        "margin": "{margin:3}",
    }

    def _paper_horizon(self) -> Horizon:
        return self.horizon("paper")

    def __post_init__(self) -> None:
        checks.of_kind("plant", self.plant, Plant)
        checks.of_kind("solver", self.solver, SolverRecord)
        if self.witness is not None:
            checks.of_kind("witness", self.witness, Witness)
        n, p, q = self.plant.n_states, self.plant.n_outputs, self.plant.n_disturbances
        owned: dict[str, Array | float] = {"Qw": checks.definite("Qw", self.Qw, q, FREE_DISTURBANCE)}
        for key, size in (("P1", n), ("P2", n), ("R", p), ("Qv", p)):
            owned[key] = checks.definite(key, getattr(self, key), size)
        for key in ("eta", "lam", "lam_samples"):
            owned[key] = checks.positive(key, getattr(self, key))
        owned["margin"] = checks.nonnegative("margin", self.margin)
        for key, value in owned.items():
            object.__setattr__(self, key, value)

    @property
    @abstractmethod
    def covers(self) -> AnySchedule | SamplingFamily:
        """The sample times that it is about: a schedule, or all schedules of a family."""

    @property
    def d_max(self) -> float:
        """Largest gap, the one before the first sample included."""
        return float(self.covers.d_max)

    @property
    def min_gap(self) -> float:
        """Least gap."""
        return float(self.covers.min_gap)

    @abstractmethod
    def _file_parts(self) -> dict[str, object]:
        """What the file says of claim and times; arrays as they are."""

    def _last_time(self) -> float:
        """Until when it holds."""
        return float("inf")

    def _samples_until(self, end: float) -> Array:
        """Sample times in [0, end]: of the schedule, or the most that any schedule of the family has."""
        return latest_samples(end, self.min_gap)

    @property
    def lam_proven(self) -> float:
        """A proven upper bound of lambda_max(P2, Pi) over all real starts: lam/(1 - 1e-3)."""
        return self.lam / (1 - RESOLUTION)

    @property
    def lam_samples_proven(self) -> float:
        """The same over sample starts."""
        return self.lam_samples / (1 - RESOLUTION)

    @cached_property
    def Rtilde(self) -> Array:
        """R~ = (R^-1 + Qv^-1)^-1, the information of one sample."""
        return freeze(output_information(self.R, self.Qv))

    def horizon(self, theorem: str = "improved", length: float | None = None) -> Horizon:
        """Return a horizon and its error bound, by the improved theorem or by Thm 9 of the paper.

            "improved":  M > ln(lam)/eta,             eta_tilde = eta - ln(lam)/M
            "paper":  M > 2 ln(2 lam_samples)/eta, eta_tilde = eta - ln(4 lam_samples^2)/M, M >= d_max

        Where estimate and truth differ from the centre of the data each by itself (an inclusion, Theorem G) a factor of
        4 stands on lam and on every gain of "improved", and there is a third:

            "arrival": M > ln(4)/eta whatever lam is, with the arrival weight P(tau)

        Parameters
        ----------
        theorem : "improved", "paper" or "arrival"
        length : float, optional [time]
            Default max(d_max, ln(4 lam)/eta) and max(d_max, 2 ln(4 lam_samples)/eta): each window shrinks the
            squared error to a quarter.

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
        apart = self._apart
        checks.word("theorem", theorem, ("improved", "paper") if apart == 1 else ("improved", "arrival", "paper"))
        eta, paper, d_max = self.eta, theorem == "paper", self.d_max
        lam = self.lam_samples_proven if paper else self.lam_proven
        factor, lost = (2.0, 2.0 * lam) if paper else (1.0, apart * (1.0 if theorem == "arrival" else lam))
        minimum = factor * np.log(lost) / eta
        with np.errstate(over="ignore"):
            default = max(d_max, float((factor * np.log(lost) + np.log(CONTRACTION)) / eta))
        if not np.isfinite(default):
            raise CertificateError(
                f"The rate {eta:.3g} is so slow that the horizon is no number: ask for a larger `eta`.", minimum=minimum
            )
        M = default if length is None else checks.positive("length", length)
        least = max(minimum, d_max) if paper else minimum
        if not (minimum < M and least <= M):
            which = "this theorem" if apart == 1 or paper else "Theorem G"
            raise CertificateError(
                f"`length` = {M:.6g} is too short: {which} needs M > {least:.6g}.", minimum=least, length=M
            )
        low = least_eigenvalue(self.P2 / lam if paper else self.P1)
        gain = 4.0 * lam if paper else apart
        noise = 2.0 * self.Qv if paper else self.Rtilde
        C_x, C_w, C_v = (gain * largest_eigenvalue(W) / low for W in (self.P2, self.Qw, noise))
        return Horizon(
            theorem=theorem, minimum=float(minimum), length=float(M), eta_tilde=float(eta - factor * np.log(lost) / M),
            C_x=C_x, C_w=C_w, C_v=C_v, lam=float(lam), time_unit=self.plant.time_unit,
        )  # fmt: skip

    def to_dict(self) -> dict[str, Plain]:
        """Plain data as in the file, digest included."""
        return with_digest(self.plant, self._stated(), solver=self.solver)

    def _stated(self) -> dict[str, object]:
        """What the file states; arrays as they are."""
        peak = self.witness
        witness = None if peak is None else {**vars(peak), "direction": list(peak.direction)}
        return {**self._file_parts(), **{key: getattr(self, key) for key in (*MATRICES, *NUMBERS)}, "witness": witness}

    @property
    def content(self) -> object:
        """What checkers judge: the numbers of the file, before there is one."""
        own, stated = self.plant, self._stated()
        judge = claim_of({"format": FORMAT, **stated}).record
        names = own.states.called, own.outputs.called
        return judge(stated, FilePlant(own.A, own.C, own.G, own.time_unit, own.is_part, own.B, *names))

    @property
    def constants(self) -> ConstantList:
        """Rate, lambdas, margin and both horizons with their gains, each with its formula and source."""
        first = [
            Constant("eta", self.eta, r"\eta", "Assumption 7", r"\eta"),
            Constant("lam", self.lam, r"\sup_{s, t} \lambda_{\max}(P_2, \Pi_s(t))", "all real starts", r"\lambda"),
            Constant(
                "lam_samples", self.lam_samples, r"\sup_{i, t} \lambda_{\max}(P_2, \Pi_i(t))", "sample starts",
                r"\lambda_K",
            ),
            Constant("margin", self.margin, r"\Pi \succeq (1 + m) P_1", "verified", "m"),
        ]  # fmt: skip
        return ConstantList([*first, *self.horizon("improved").constants(), *self.horizon("paper").constants()])

    def to_markdown(self) -> str:
        """Return all constants as a markdown table."""
        return self.constants.to_markdown()

    def _numbers(self) -> ConstantList:
        return self.constants

    def _promise(self) -> str:
        """What the inequality means, in words."""
        return (
            f"past errors are discounted at rate {below(self.eta)} per {self.plant.time_unit}, and every window keeps "
            f"information of at least 1/{above(self.lam)} of the prior weight P2. The error bound of a moving horizon "
            f"estimator contracts if its horizon is longer than {above(self.horizon().minimum)} {self.plant.time_unit}."
        )

    def _sample_times(self) -> str:
        return self.covers.explain().rstrip(".")

    def error_bound(
        self,
        t: npt.ArrayLike,
        e0: npt.ArrayLike,
        w_bound: float = 0.0,
        v_bound: float = 0.0,
        *,
        theorem: str = "improved",
        length: float | None = None,
    ) -> Array:
        """Return the guaranteed bound on |e(t)| of the estimator with this certificate.

            |e(t)|^2 <= C_x |e0|^2 e^{-eta_tilde t} + C_w w^2 (1 - e^{-eta_tilde t})/eta_tilde
                        + C_v v^2 sum over samples in [0, t] of e^{-eta_tilde (t - tau)}

        Parameters
        ----------
        t : float or array [time]
            Of a finite schedule at most its last sample.
        e0 : (n,) array
            Initial error, or a bound on its norm as a number.
        w_bound, v_bound : float
            Bounds on |w(t)| and |v(tau)|, Euclidean norms.
        theorem, length
            As for `horizon`.

        Returns
        -------
        array of the shape of `t`
            In the Euclidean norm of the state.
        """
        horizon = self.horizon(theorem, length)
        times = checks.real_array("t", t, checks.dimensions(t))
        if np.any(times < 0):
            raise ArgumentError(f"`t` must not be negative, got {float(times.min())!r}: the bound begins at 0.")
        last = self._last_time()
        if np.any(times > last * (1 + ROUNDING)):
            raise ArgumentError(
                f"`t` must not lie after {last!r}, the last sample: what is certified ends there, got "
                f"{float(times.max())!r}."
            )
        initial = checks.real_array("e0", e0, checks.dimensions(e0))
        w, v = checks.nonnegative("w_bound", w_bound), checks.nonnegative("v_bound", v_bound)
        unit = max(float(np.max(np.abs(initial), initial=0.0)), w, v) or 1.0  # squares of ratios stay numbers
        start, w2, v2 = float(np.sum(np.square(initial / unit))), (w / unit) ** 2, (v / unit) ** 2
        rate = horizon.eta_tilde
        decay = np.exp(-rate * times)
        hits = np.vectorize(lambda end: float(np.sum(np.exp(-rate * (end - self._samples_until(end))))), otypes=[float])
        squared = horizon.C_x * start * decay + horizon.C_w * w2 * (1 - decay) / rate
        with np.errstate(over="ignore"):
            return np.asarray(unit * np.sqrt(squared + horizon.C_v * v2 * (hits(times) if v2 else 0.0)))


def latest_samples(end: float, gap: float) -> Array:
    """The latest times in [0, end] of samples at least `gap` apart: the i-th last lies i gaps before `end`.

    Rounding of end/gap leaves none out: a time just before 0 counts.
    """
    return np.asarray(end - gap * np.arange(int(max(end, 0.0) / gap * (1 + ROUNDING)) + 1))


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(SampledCertificate):
    """The certificate of one schedule; a finite one is certified to its last time.

        |Dx(t)|^2_{P1} <= e^{-eta t} |Dx(0)|^2_{P2} + int e^{-eta (t-s)} |Dw|^2_{Qw} ds
                          + sum over samples of e^{-eta (t-tau)} (|Dy|^2_R + |Dv|^2_{Qv})

    for any two trajectories. `certify` makes it, `verify()` proves it from its numbers, `save` writes it,
    `read_certificate` reads it; `horizon()` is what an estimator needs.

    Attributes
    ----------
    schedule : Schedule or PeriodicSchedule
        All others are those of `SampledCertificate`: P1, P2 (n, n), Qw (q, q), R, Qv (p, p), eta [1/time], lam, ...

    Raises
    ------
    ArgumentError
        If the schedule holds no sample, or a weight has the wrong shape or is not positive definite.

    References
    ----------
    The paper, Assumption 7, equation (16).
    """

    schedule: AnySchedule

    def __post_init__(self) -> None:
        super().__post_init__()
        schedule = align(self.plant, self.schedule)
        if not len(schedule):
            raise ArgumentError("`schedule` must hold at least one sample: without any there is nothing to certify.")
        object.__setattr__(self, "schedule", schedule)

    @property
    def covers(self) -> AnySchedule:
        """The schedule."""
        return self.schedule

    def _file_parts(self) -> dict[str, object]:
        return {"claim": CLAIM, "times": times_to_dict(self.schedule)}

    @property
    def content(self) -> Sampled:
        """What checkers judge: the numbers of its file, before there is one."""
        return cast("Sampled", super().content)

    @classmethod
    def from_matrices(
        cls,
        plant: Plant,
        schedule: Schedule | PeriodicSchedule,
        *,
        P1: npt.ArrayLike,
        P2: npt.ArrayLike,
        Qw: npt.ArrayLike,
        R: npt.ArrayLike,
        Qv: npt.ArrayLike,
        eta: float,
        lam: float | None = None,
        lam_samples: float | None = None,
    ) -> Certificate:
        """Return a certificate made by hand; nothing is proven before `verify()` passes.

        Parameters
        ----------
        plant, schedule
        P1, P2, Qw, R, Qv : arrays
            Symmetric positive definite.
        eta : float [1/time]
        lam, lam_samples : float, optional
            Default lambda_max(P2, P1), which is what the matrices claim.

        Returns
        -------
        Certificate

        Raises
        ------
        ArgumentError
            If a weight is not symmetric positive definite, a rate is not positive, or plant and schedule
            do not fit.

        Examples
        --------
        >>> plant, schedule = Plant([[0.0]], [[1.0]]), PeriodicSchedule([1.0])
        >>> made = Certificate.from_matrices(plant, schedule, P1=[[0.2]], P2=[[1.0]], Qw=[[1.0]],
        ...                                  R=[[2.0]], Qv=[[2.0]], eta=0.1)
        >>> made.verify().passed
        True
        """
        n = plant.n_states
        claimed = generalised_max(checks.definite("P2", P2, n), checks.definite("P1", P1, n))
        top = max(claimed, 1.0) if lam is None else lam
        return cls(
            plant,
            schedule,
            P1=P1,  # type: ignore[arg-type]
            P2=P2,  # type: ignore[arg-type]
            Qw=Qw,  # type: ignore[arg-type]
            R=R,  # type: ignore[arg-type]
            Qv=Qv,  # type: ignore[arg-type]
            eta=eta,
            lam=top,
            lam_samples=top if lam_samples is None else lam_samples,
            solver=SolverRecord("by hand"),
        )

    @property
    def claim(self) -> Claim:
        """What the certificate says; `verify()` proves it."""
        return Claim(
            f"sample-based exponential i-iIOSS with rate {below(self.eta)}{self._until()}, for every real window start",
            "Assumption 7",
            ("linear plant",),
        )

    def _last_time(self) -> float:
        return float("inf") if self.schedule.endless else float(self.schedule.times[-1])

    def _until(self) -> str:
        return "" if self.schedule.endless else f" up to time {moment(self._last_time())}"

    def _samples_until(self, end: float) -> Array:
        return self.schedule.between(0.0, max(end, 0.0)).times

    def explain(self) -> str:
        """Say what the certificate proves."""
        return f"The plant is detectable with this schedule{self._until()}: {self._promise()}{self._beyond()}"

    def _beyond(self) -> str:
        how = str(self.solver.details.get("weights", ""))
        return f" Its {how}." if how.startswith(WITHOUT_GAIN) else ""


def times_to_dict(schedule: Schedule | PeriodicSchedule) -> dict[str, Plain]:
    """Return the `times` of a certificate file; outputs null means that every sample measures all of them."""
    outputs = None if schedule.outputs is None else schedule.outputs.astype(int).tolist()
    if schedule.endless:
        return {"kind": "periodic", "gaps": schedule.gaps.tolist(), "first": schedule.first, "outputs": outputs}
    return {"kind": "finite", "times": schedule.times.tolist(), "outputs": outputs}
