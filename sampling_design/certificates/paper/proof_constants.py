"""The paper's own certificate, number by number: Theorem 10, Lemma 12, Theorems 14, 5 and 16 in one chain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.detectability.best_rate import detectability_from_proof, refuse_undetectable
from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.form.horizon import Constant, ConstantList
from sampling_design.certificates.paper import observable_case
from sampling_design.certificates.paper.composition import RATE_SHARE, compose, residual_alone, residual_decay
from sampling_design.certificates.paper.gain_sweep import best_gain
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.observability.alignment import align
from sampling_design.observability.sigma_bracket import SigmaDeviations
from sampling_design.observability.windows.window_sigma import deviations_of
from sampling_design.plants.modes import ModalSplit, split_modes
from sampling_design.plants.plant import Plant, first_difference
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import Claim, PlainRecord, SolverRecord, above, below
from sampling_design.records.signatures import checked, open_verb
from sampling_design.schedules.family import AnySchedule, SamplingFamily
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

RESIDUAL_SHARE = 0.95
"""Part of the residual's slowest decay that the tightened chain claims; closer to 1 its Lyapunov matrix degenerates."""


@dataclass(frozen=True, eq=False, repr=False)
class PaperConstants(PlainRecord):
    """Assumption 7 as the paper's proofs give it, of a plant of any kind: the weights, the rate, and every constant."""

    plant: Plant
    variant: str
    P1: Array
    P2: Array
    Qw: Array
    R: Array
    Qv: Array
    eta: float
    constants: ConstantList

    _plain = "variant P1 P2 Qw R Qv eta constants{name value formula source}"
    _answers = (
        "Assumption 7 with the constants of the paper's proofs",
        "{claim.evidence}",
        "a horizon of more than {horizon:up} {plant.time_unit}",
        "`.constants`: each with its formula and its source",
    )
    _table = {"variant": "{variant}", "lambda": "{lam}", "rate": "{eta} 1/{plant.time_unit}"}

    def _rows(self) -> list[tuple[str, str]]:
        return super()._rows() + self.constants.lines()

    def __getitem__(self, name: str) -> Constant:
        return self.constants.named(name)

    @property
    def lam(self) -> float:
        """lambda_max(P2, P1)."""
        return self["lam"].value

    @property
    def horizon(self) -> float:
        """Theorem 9 asks for a horizon longer than this."""
        return self["horizon"].value

    def to_markdown(self) -> str:
        """Return the constants as a markdown table."""
        return self.constants.to_markdown()

    def to_latex(self) -> str:
        """Return the constants as a LaTeX tabular."""
        return self.constants.to_latex()

    def explain(self) -> str:
        """Say what the proof's constants ask for."""
        return (
            f"With the constants of the proof ({self.variant}) the estimator needs a horizon of more than "
            f"{above(self.horizon)} {self.plant.time_unit} (lambda = {above(self.lam)}, "
            f"eta = {below(self.eta)} 1/{self.plant.time_unit})."
        )


@dataclass(frozen=True, eq=False, repr=False)
class ProofConstants(PaperConstants):
    """Assumption 7 with the constants that the paper's proofs give, each with its formula and source.

    Parameters
    ----------
    plant : Plant
    variant : str
        "paper" (its chain, misprints corrected) or "tightened" (the same proof without its avoidable losses).
    P1, P2 : (n, n) arrays
    Qw : (q, q) array
    R, Qv : (p, p) arrays
        With measurement noise: R = Qv = 2 R0 I, so that (R^{-1} + Qv^{-1})^{-1} = R0 I, the noise-free weight.
    eta : float [1/time_unit]
    constants : ConstantList
        In the order of the proof; `record["mu_bar"]` is one of them.
    schedule : Schedule or PeriodicSchedule
    detectability : DetectabilityCertificate or None
        Of the retained part; None where nothing is retained.
    split : ModalSplit
        What was retained.
    """

    schedule: Schedule | PeriodicSchedule
    detectability: DetectabilityCertificate | None
    split: ModalSplit

    _plain = f"{PaperConstants._plain} deviations"
    _answers = (*PaperConstants._answers[:3], "`.certificate().verify()`")

    @cached_property
    def deviations(self) -> SigmaDeviations | None:
        """What is left of sigma_bar if samples come a hundredth of the least gap early or late, or one is lost.

        The constants are of exact times: they hold there with the smaller sigma_bar, where that is positive (and with
        the larger `kappa` and gap). None where nothing is retained.
        """
        if not self.split.retained.n_states:
            return None
        window, sigma = self["T"].value, self["sigma_bar"].value
        return deviations_of(self.split.retained.unscaled(), self.schedule, window, sigma=sigma, start=0.0)

    def _rows(self) -> list[tuple[str, str]]:
        return [*super()._rows(), *([] if self.deviations is None else self.deviations._rows())]

    def explain(self) -> str:
        """Say what the proof's constants ask for, and what is left of their sigma at other times."""
        left = "" if self.deviations is None else f" They are of exact times. {self.deviations.explain()}"
        return super().explain() + left

    @property
    def claim(self) -> Claim:
        """What is proven, and from which theorems."""
        return Claim(
            "Assumption 7 (sample-based exponential i-iIOSS) with these weights",
            theorem="Theorems 5, 10, 14, 16",
            assumptions=("x' = Ax + Bu + Gw, y = Cx + Du + v", "sigma_bar bounds every window of length T"),
        )

    def certificate(self) -> Certificate:
        """Return the certificate with these weights, to be verified and saved like any other."""
        weights = {key: getattr(self, key) for key in ("P1", "P2", "Qw", "R", "Qv")}
        made = Certificate.from_matrices(self.plant, self.schedule, **weights, eta=self.eta)
        return replace(made, solver=SolverRecord("constants of the proof", details={"variant": self.variant}))


@open_verb(PaperConstants)
def constants_from_proof(
    plant: Plant,
    schedule: AnySchedule | SamplingFamily,
    window: float | None = None,
    variant: str = "paper",
    *,
    gain: npt.ArrayLike | None = None,
    Q: npt.ArrayLike | None = None,
    detectability: DetectabilityCertificate | None = None,
    sigma_bar: float | None = None,
    kappa: int | None = None,
) -> ProofConstants:
    """Return every constant of the paper's proof for a plant and a schedule.

    Parameters
    ----------
    plant : Plant, UncertainPlant, or NonlinearPlant with a region
    schedule : Schedule or PeriodicSchedule; of a plant that is not exactly known a GapRange
    window : float, optional [time_unit]
        The length T. Default: the shortest sum of consecutive gaps over which every real window sees the retained part.
    variant : {"paper", "tightened"}
    gain, Q : (n_r, p) and (n_r, n_r) arrays, optional
        Observer gain and Lyapunov right-hand side for the retained part (`split_modes(plant).retained`). Default: 64
        choices are swept, the best refined for the shortest horizon.
    detectability : DetectabilityCertificate, optional
        Of the retained part, instead of `gain` and `Q`.
    sigma_bar : float, optional
        A lower bound of sigma over all real windows that is proven elsewhere. Default: `window_sigma(...).lower`.
    kappa : int, optional
        A bound on the samples in a closed window that is proven elsewhere. Default: counted on the schedule.

    Returns
    -------
    ProofConstants; of a plant that is not exactly known InclusionConstants

    Raises
    ------
    ArgumentError
        If an argument is out of range or `detectability` belongs to another plant.
    NotDetectableError
        If the retained part has a mode that no output sees.
    CertificateError
        If no window of the schedule sees the retained part, or a constant leaves the range of floating point.
    UndecidedError
        If the plant is not exactly known and no certificate decays faster than differences grow backwards in time.

    Notes
    -----
    *Method.* Theorem 10 for the retained part, Lemma 12 and Theorem 14 on windows of length T, Theorem 5 with its
    repairs (half-open windows, only the last interval may be short, t* = max(T, d_max)), Theorem 16 for the rest.
    *Claim.* The inequality (16) with the returned weights for every K_i and all t >= 0; maxima over [0, T] are
    proven over the continuum. *Assumptions.* Weights and sigma are in the plant's own coordinates; pass
    `plant.scaled()` for scaled ones. *Numerical aspects.* For a second-order plant with |A| = 1 and T = 2 no gain and
    no Lyapunov matrix bring the paper's chain below M > 44.334 (found by search over both), which the sweep reaches.

    References
    ----------
    The paper, Theorems 5, 9, 10, 14, 16 and Lemma 12; theory section 3.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> proof = constants_from_proof(plant, PeriodicSchedule([1.0]), window=2.0)
    >>> proof["kappa"].value, round(proof["mu_bar"].value, 1)
    (3, 5.9)
    >>> round(proof.horizon, 1)
    44.3
    """
    checks.word("variant", variant, _VARIANTS)
    if not plant.n_states:
        raise ArgumentError("`plant` must have at least one state: of none the paper's proof says nothing.")
    if isinstance(schedule, SamplingFamily):
        raise ArgumentError("`schedule` must be a Schedule or a PeriodicSchedule for a plant that is exactly known.")
    schedule = align(plant, schedule)
    refuse_undetectable(plant, 0.0)
    split = split_modes(plant)
    share = None if variant == "paper" else RESIDUAL_SHARE
    decay = residual_decay(split.residual, share) if split.residual.n_states else None
    if split.retained.n_states == 0:
        assert decay is not None
        return _record(plant, schedule, variant, split, residual_alone(decay), None)
    samples = observable_case.measure_hypotheses(split.retained, schedule, window, sigma_bar, kappa)
    cap = np.inf if decay is None else RATE_SHARE * decay.eta
    certificate = _detectability(split.retained, variant, samples, cap, gain, Q, detectability)
    proven = _VARIANTS[variant](certificate, samples)
    if decay is not None:
        proven = compose(split, proven, decay, samples.window, samples.kappa)
    return _record(plant, schedule, variant, split, proven, certificate)


_VARIANTS = {"paper": observable_case.paper_weights, "tightened": observable_case.tightened_weights}


@checked
def certify_from_proof(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    window: float | None = None,
    variant: str = "paper",
    *,
    gain: npt.ArrayLike | None = None,
    Q: npt.ArrayLike | None = None,
    detectability: DetectabilityCertificate | None = None,
    sigma_bar: float | None = None,
    kappa: int | None = None,
) -> Certificate:
    """Return the certificate with the constants of the paper's proof.

    Parameters
    ----------
    plant : Plant
    schedule : Schedule or PeriodicSchedule
    window : float, optional [time_unit]
    variant : {"paper", "tightened"}
    gain, Q, detectability, sigma_bar, kappa
        All as for `constants_from_proof`.

    Returns
    -------
    Certificate
        Proven: its `verify()` has passed.

    Raises
    ------
    ArgumentError, NotDetectableError, CertificateError
        As for `constants_from_proof`.
    UndecidedError
        If the weights cannot be held in doubles, or the proof's inequality cannot be proven there.

    References
    ----------
    The paper, Theorems 5, 10, 14, 16; theory section 3.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> certificate = certify_from_proof(plant, PeriodicSchedule([1.0]), variant="tightened")
    >>> certificate.verify().passed, round(certificate.horizon("paper").minimum)
    (True, 18)
    """
    proof = constants_from_proof(
        plant, schedule, window, variant, gain=gain, Q=Q, detectability=detectability, sigma_bar=sigma_bar, kappa=kappa
    )
    try:
        made = proof.certificate()
    except ArgumentError as error:
        raise UndecidedError(
            f"undecided: the weights that the proof gives cannot be held in doubles: {error}"
        ) from None
    verdict = made.verify()
    if not verdict.passed:
        raise UndecidedError(
            f"undecided: the certificate with the proof's constants is not proven in doubles: {verdict.reason}.",
            verification=verdict,
            certificate=made,
        )
    return made


def _detectability(
    retained: Plant,
    variant: str,
    samples: observable_case.SamplingHypotheses,
    cap: float,
    gain: npt.ArrayLike | None,
    Q: npt.ArrayLike | None,
    given: DetectabilityCertificate | None,
) -> DetectabilityCertificate:
    """The one that was given, the one of a given gain, or the best of the sweep."""
    if given is not None:
        if other := first_difference(retained, given.plant):
            raise ArgumentError(
                f"`detectability` must belong to the retained part, split_modes(plant).retained: {other}."
            )
        if gain is not None or Q is not None:
            raise ArgumentError("`detectability` excludes `gain` and `Q`: it has its own.")
        return given
    if gain is not None or Q is not None:
        return detectability_from_proof(retained, gain, Q)
    if variant == "paper":  # no gain can help where this factor alone leaves floating point: no search then
        observable_case.within_range("e^{2 Lf t*}", 2 * float(np.linalg.norm(retained.A, 2)) * samples.t_star)
    return best_gain(retained, samples.t_star, variant, cap)


def _record(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    variant: str,
    split: ModalSplit,
    proven: observable_case.ProvenWeights,
    detectability: DetectabilityCertificate | None,
) -> ProofConstants:
    """Add measurement noise and the horizon, and freeze everything."""
    R = freeze(2 * proven.R0 * np.eye(plant.n_outputs))
    frozen = {key: freeze(getattr(proven, key)) for key in ("P1", "P2", "Qw")}
    return ProofConstants(
        plant=plant, schedule=schedule, variant=variant, **frozen, R=R, Qv=R, eta=proven.eta,
        constants=ConstantList((*proven.constants, *theorem_9(proven))), detectability=detectability, split=split,
    )  # fmt: skip


def theorem_9(proven: observable_case.ProvenWeights) -> tuple[Constant, ...]:
    """Noise weight, lambda, horizon and gains of Theorem 9."""
    lam = max(proven.lam, 1.0)
    horizon = 2 * float(np.log(2 * lam)) / proven.eta
    least = float(np.linalg.eigvalsh(proven.P1)[0])
    C_x = 4 * lam * float(np.linalg.eigvalsh(proven.P2)[-1]) / least
    C_w = 4 * lam * float(np.max(np.linalg.eigvalsh(proven.Qw), initial=0.0)) / least
    C_v, source = 16 * lam * proven.R0 / least, "Theorem 9, Definition 6"
    return (
        Constant("R", 2 * proven.R0, r"R=Q_v=2R_0:\ (R^{-1}+Q_v^{-1})^{-1}=R_0", "measurement noise (E36)", "R=Q_v"),
        Constant("lam", lam, r"\lambda_{\max}(P_2,P_1)", "Theorem 9", r"\lambda"),
        Constant("horizon", horizon, r"M>2\ln(2\lambda)/\eta", "Theorem 9", "M"),
        Constant("C_x", C_x, r"4\lambda\lambda_{\max}(P_2)/\lambda_{\min}(P_1)", source, "C_x"),
        Constant("C_w", C_w, r"4\lambda\lambda_{\max}(Q_w)/\lambda_{\min}(P_1)", source, "C_w"),
        Constant("C_v", C_v, r"8\lambda\lambda_{\max}(Q_v)/\lambda_{\min}(P_1)", source, "C_v"),
    )
