"""Theorem 14 with Theorem 5, (A, C) observable: from detectability and a window's sigma to Assumption 7.

The largest |M e^{As} N| over a whole interval of s, bounded from above: proven over the continuum, not sampled.

Every constant of the proof that is "a maximum over [0, T]" (k_w, the growth before the first restart) comes from here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.certificates.form.horizon import Constant, ConstantList
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.numerics.linalg import expm_batch, generalised_max
from sampling_design.observability.windows.window_sigma import window_sigma
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import short
from sampling_design.schedules.sampling_set import SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

RTOL = 1e-3
"""Room left between the proven bound and the largest value met: a thousandth of a constant costs no horizon."""
CELLS = 20_000  # most cells ever opened; a stiffer plant keeps a proven but looser bound instead of running for ever
MODAL_CONDITION = 1e8  # modal coordinates are used only where their basis keeps half of the digits


def largest_flow(M: Array, A: Array, N: Array, duration: float) -> tuple[float, float, float]:
    """Bound the spectral norm of M e^{As} N over s in [0, duration]: upper, lower bound, and where that is attained.

    Notes
    -----
    *Method.* Bisection of cells. With X = M e^{Ac} N, Y = M e^{Ac} A N at a cell's centre c and half-width h,
    |M e^{A(c+d)} N| <= max |X +- hY| + |M e^{Ac}| |A^2 N| h^2/2 e^{m h} for all |d| <= h: the line X + dY is convex
    in d, and the remainder is Taylor's with |e^{Ad}| <= e^{m|d|}, m = max(mu(A), mu(-A)), mu the logarithmic norm.
    Where this is worse than |M e^{Aa} V| e^{m' 2h} |V^{-1} N| from the left end a (stiff plants after their fast
    modes died; V = I or the eigenvectors, m' = mu(V^{-1}AV)^+), that one is taken. A cell closes when its bound is
    within `RTOL` of the largest value met.
    *Numerical aspects.* When `CELLS` are used up the open cells keep their bounds: looser, still proven. A final
    factor 1 + 64 n eps covers rounding.
    """
    size = max(M.shape[0], N.shape[1], A.shape[0])
    if min(M.shape[0], N.shape[1], A.shape[0]) == 0:
        return 0.0, 0.0, 0.0
    half = duration / 2
    starts = np.array([0.0])
    best, at, upper, used = 0.0, 0.0, 0.0, 0
    while starts.size:
        bounds, values, places = _cells(M, A, N, starts, half)
        top = int(np.argmax(values))
        if values[top] > best:
            best, at = float(values[top]), float(places[top])
        used += starts.size
        open_ = bounds > (1 + RTOL) * best
        if used + 2 * int(open_.sum()) > CELLS or half <= np.finfo(float).eps * duration:
            upper = max(upper, float(bounds.max()))
            break
        upper = max(upper, float(bounds[~open_].max(initial=0.0)))
        starts = np.concatenate([starts[open_], starts[open_] + half])
        half /= 2
    return max(upper, best) * (1 + 64 * size * np.finfo(float).eps), best, at


def _cells(M: Array, A: Array, N: Array, starts: Array, half: float) -> tuple[Array, Array, Array]:
    """Proven bound of every cell [a, a + 2 half], the largest value met in it, and where."""
    left = M @ expm_batch(A, starts)
    centre = left @ expm_batch(A, half)[0]
    right = centre @ expm_batch(A, half)[0]
    X, Y = centre @ N, centre @ (A @ N)
    growth, decay = _log_norm(A), _log_norm(-A)
    with np.errstate(over="ignore", invalid="ignore"):
        remainder = (
            _norms(centre) * _norms(A @ A @ N) * half**2 / 2 * np.exp(min(max(growth, decay, 0.0) * half, 700.0))
        )
        second = np.maximum(_norms(X + half * Y), _norms(X - half * Y)) + remainder
        zeroth = _norms(left) * _norms(N) * np.exp(min(max(growth, 0.0) * 2 * half, 700.0))
        zeroth = np.fmin(zeroth, _modal_bound(left, A, N, 2 * half))
    norms = np.stack([_norms(left @ N), _norms(X), _norms(right @ N)])
    which = np.argmax(norms, axis=0)
    return np.fmin(second, zeroth), norms.max(axis=0), starts + which * half


def _modal_bound(left: Array, A: Array, N: Array, length: float) -> Array:
    """Bound of |left e^{As} N| for s in [0, length] in modal coordinates: mu is there the spectral abscissa."""
    _, V = np.linalg.eig(A)
    if np.linalg.cond(V) > MODAL_CONDITION:
        return np.full(left.shape[0], np.inf)
    inverse_N = np.linalg.solve(V, N.astype(V.dtype))
    growth = _log_norm(np.linalg.solve(V, A @ V))
    with np.errstate(over="ignore", invalid="ignore"):
        grown = np.exp(min(max(growth, 0.0) * length, 700.0))
        return np.asarray(_norms(left @ V) * float(np.linalg.norm(inverse_N, 2)) * grown)


def _norms(matrices: Array) -> Array:
    """Spectral norms of a stack."""
    return np.asarray(np.linalg.norm(matrices, 2, axis=(-2, -1)))


def _log_norm(A: Array) -> float:
    """The logarithmic norm mu(A): |e^{As}| <= e^{mu(A) s} for s >= 0."""
    return float(np.linalg.eigvalsh((A + A.conj().T) / 2)[-1])


SAFE = 1 + 1e-9  # factor on every constant of the right-hand side: covers the rounding of the few operations behind it
LARGEST = 1e150  # constants beyond this are refused: their squares leave the range of floating point


@dataclass(frozen=True)
class SamplingHypotheses:
    """What Theorem 14 assumes of the samples, measured on a schedule.

    `window` T; `kappa` the most samples in a closed window of length T; `sigma_bar` > 0 a proven lower bound of sigma
    over all real positions of the window; `d_max` the longest gap, the first one included.
    """

    window: float
    kappa: int
    sigma_bar: float
    d_max: float

    @property
    def t_star(self) -> float:
        """max(T, d_max): the restarts of Theorem 5 need a sample in every interval of this length."""
        return max(self.window, self.d_max)


@dataclass(frozen=True, eq=False)
class ProvenWeights:
    """P1, P2, Qw, R0, eta of the noise-free Assumption 7 (R0 a multiple of the identity), and how they came about."""

    P1: Array
    P2: Array
    Qw: Array
    R0: float
    eta: float
    constants: ConstantList

    @property
    def lam(self) -> float:
        """lambda_max(P2, P1)."""
        return generalised_max(self.P2, self.P1)


def lemma_12(detectability: DetectabilityCertificate, samples: SamplingHypotheses) -> ConstantList:
    """|C e^{AT}|, mu_bar and k_w: what a window of samples says about the output at its end."""
    plant, T = detectability.plant, samples.window
    ends = float(np.linalg.norm(plant.C @ expm_batch(plant.A, T)[0], 2)) * SAFE
    k_w = largest_flow(plant.C, plant.A, plant.G, T)[0]
    return ConstantList(
        (
            Constant("T", T, r"\text{window}", "Theorem 14, hypothesis", "T"),
            Constant("kappa", samples.kappa, r"\max_t |K\cap[t-T,t]|", "Theorem 14, hypothesis", r"\kappa"),
            Constant(
                "sigma_bar",
                samples.sigma_bar,
                r"\inf_{t} \sigma_n(O_s e^{-A(t-T)})",
                "Theorem 14, hypothesis",
                r"\bar\sigma",
            ),
            Constant("d_max", samples.d_max, r"\sup_i d_i", "Definition 2", r"d_{\max}"),
            Constant("norm_CeAT", ends, r"|Ce^{AT}|", "Lemma 12", r"|Ce^{AT}|"),
            Constant("mu_bar", ends / samples.sigma_bar, r"|Ce^{AT}|/\bar\sigma \ge |H|", "Lemma 12", r"\bar\mu"),
            Constant("k_w", k_w, r"\max_{0\le s\le T}|Ce^{As}G|", "Theorem 14", "k_w"),
        )
    )


def paper_weights(detectability: DetectabilityCertificate, samples: SamplingHypotheses) -> ProvenWeights:
    """The paper's own constants, its misprints corrected (theory 3.1).

        P1 = P/2,  P2 = 4 lambda_max(P) e^{(2 Lf + eta) t*} I,
        Qw = [c_w + 2 e^{3 eta t*} alpha_w + 4 lambda_max(P) t* |G|^2 e^{(2 Lf + eta) t*}] I,
        R0 = 2 e^{3 eta t*} alpha_y

    Raises CertificateError if a factor leaves the range of floating point (stiff plants: Lf t* is the exponent).
    """
    plant, eta, t_star = detectability.plant, detectability.eta, samples.t_star
    n, T, kappa = plant.n_states, samples.window, samples.kappa
    first = lemma_12(detectability, samples)
    mu_bar, k_w = first.named("mu_bar").value, first.named("k_w").value
    lipschitz = float(np.linalg.norm(plant.A, 2))
    top = float(np.linalg.eigvalsh(detectability.P)[-1])
    size_G = float(np.linalg.norm(plant.G, 2)) if plant.n_disturbances else 0.0
    growth = within_range("e^{(2 Lf + eta) t*}", (2 * lipschitz + eta) * t_star)
    overlap = within_range("2 e^{3 eta t*}", 3 * eta * t_star) * 2
    c_2 = detectability.c_y
    alpha_w = 4 * T**2 * c_2 * (mu_bar * kappa + 1) ** 2 * k_w**2
    alpha_y = 4 * T * c_2 * mu_bar**2 * kappa
    P2 = 4 * top * growth * SAFE
    Qw = (detectability.c_w + overlap * alpha_w + 4 * top * t_star * size_G**2 * growth) * SAFE
    R0 = overlap * alpha_y * SAFE
    steps = (
        Constant("t_star", t_star, r"\max(T,d_{\max})", "Theorem 14, Theorem 5 (d_max: E6)", "t^*"),
        Constant("alpha_w", alpha_w, r"4T^2c_2(\bar\mu\kappa+1)^2k_w^2\quad(\times s^2)", "(28), E10", r"\alpha_w"),
        Constant("alpha_y", alpha_y, r"4Tc_2\bar\mu^2\kappa\quad(\times s^2)", "(28), E10", r"\alpha_y"),
        Constant("Lf", lipschitz, r"|A|", "Assumption 4", "L_f"),
        Constant("growth", growth, r"e^{(2L_f+\eta)t^*}", "Theorem 5, (5)", r"e^{(2L_f+\eta)t^*}"),
        Constant("overlap", overlap, r"2e^{3\eta t^*}", "Theorem 5, (10), half-open windows (E5)", r"2e^{3\eta t^*}"),
        Constant("P1_scale", 0.5, r"P_1=P/2", "Theorem 5, result", r"P_1"),
        Constant("P2_scale", P2, r"P_2=4\lambda_{\max}(P)e^{(2L_f+\eta)t^*}I", "Theorem 5, result", r"P_2"),
        Constant(
            "Qw_scale",
            Qw,
            r"c_w+2e^{3\eta t^*}\alpha_w+4\lambda_{\max}(P)t^*|G|^2e^{(2L_f+\eta)t^*}",
            "Theorem 5, result",
            r"Q_w",
        ),
        Constant("R0", R0, r"2e^{3\eta t^*}\alpha_y", "Theorem 5, result", r"R_0"),
    )
    _in_range(steps)
    eye_w = np.eye(plant.n_disturbances)
    constants = ConstantList((*_detectability(detectability), *first, *steps))
    return ProvenWeights(detectability.P / 2, P2 * np.eye(n), Qw * eye_w, R0, eta, constants)


def tightened_weights(detectability: DetectabilityCertificate, samples: SamplingHypotheses) -> ProvenWeights:
    """The same proof without its avoidable losses (theory 3.2): Fubini for the overlap, |H| as a whole, P-norms.

        P1 = P,  P2 = beta P,  beta = 2 max_{s<=t*} e^{eta s} lambda_max(e^{A's} P e^{As}, P),  f = (e^{eta T}-1)/eta,
        Qw = [c_w + 2 T c_2 (mu_bar sqrt(kappa) + 1)^2 k_w^2 f + 2 t* max_{s<=t*} e^{eta s} |e^{As} G|_P^2] I,
        R0 = 2 c_2 mu_bar^2 f

    Raises CertificateError if a factor leaves the range of floating point.
    """
    plant, eta, t_star = detectability.plant, detectability.eta, samples.t_star
    T, kappa = samples.window, samples.kappa
    first = lemma_12(detectability, samples)
    mu_bar, k_w, c_2 = first.named("mu_bar").value, first.named("k_w").value, detectability.c_y
    L = np.asarray(np.linalg.cholesky(detectability.P), dtype=np.float64)
    shifted = plant.A + eta / 2 * np.eye(plant.n_states)
    inverse = np.asarray(np.linalg.solve(L.T, np.eye(len(L))), dtype=np.float64)
    swing = largest_flow(L.T, shifted, inverse, t_star)[0] ** 2
    push = largest_flow(L.T, shifted, plant.G, t_star)[0] ** 2
    within_range("e^{eta T}", eta * T)
    f = float(np.expm1(eta * T)) / eta
    alpha_w = 2 * T * c_2 * (mu_bar * np.sqrt(kappa) + 1) ** 2 * k_w**2 * f
    R0 = 2 * c_2 * mu_bar**2 * f * SAFE
    Qw = (detectability.c_w + alpha_w + 2 * t_star * push) * SAFE
    beta = 2 * swing * SAFE
    steps = (
        Constant("t_star", t_star, r"\max(T,d_{\max})", "Theorem 14, Theorem 5 (d_max: E6)", "t^*"),
        Constant("f", f, r"(e^{\eta T}-1)/\eta", "discounted Fubini (E11)", "f"),
        Constant("alpha_w", alpha_w, r"2Tc_2(\bar\mu\sqrt\kappa+1)^2k_w^2f", "(28) tightened, E11", r"\alpha_w"),
        Constant("alpha_y", 2 * c_2 * mu_bar**2 * f, r"2c_2\bar\mu^2f", "(28) tightened, E11", r"\alpha_y"),
        Constant(
            "beta",
            beta,
            r"2\max_{s\le t^*}e^{\eta s}\lambda_{\max}(e^{A^\top s}Pe^{As},P)",
            "Theorem 5, (5) in the P-norm; P1 = P (E8)",
            r"\beta",
        ),
        Constant("push", push, r"\max_{s\le t^*}e^{\eta s}|e^{As}G|_P^2", "Theorem 5, (13) in the P-norm", ""),
        Constant(
            "Qw_scale", Qw, r"c_w+\alpha_w+2t^*\max_{s\le t^*}e^{\eta s}|e^{As}G|_P^2", "Theorem 5, result", "Q_w"
        ),
        Constant("R0", R0, r"2c_2\bar\mu^2f", "Theorem 5, result", r"R_0"),
    )
    _in_range(steps)
    constants = ConstantList((*_detectability(detectability), *first, *steps))
    P = detectability.P
    return ProvenWeights(P, beta * P, Qw * np.eye(plant.n_disturbances), R0, eta, constants)


def _detectability(certificate: DetectabilityCertificate) -> tuple[Constant, ...]:
    """Constants of Definition 1, renamed c_2 where Theorem 14 calls c_y so."""
    start = certificate.constants or (
        Constant("eta", certificate.eta, r"\eta", "Definition 1, from the dissipation inequality", r"\eta"),
        Constant("c_w", certificate.c_w, r"c_w", "Definition 1, from the dissipation inequality", "c_w"),
    )
    others = tuple(c for c in start if c.name != "c_y")
    return (*others, Constant("c_2", certificate.c_y, r"c_2=c_y", "Theorem 10, used in (28)", "c_2"))


def within_range(name: str, exponent: float) -> float:
    """e^exponent, refused where it leaves the range of floating point."""
    if exponent > np.log(LARGEST):
        raise CertificateError(
            f"The factor {name} of the proof is e^{short(exponent)}, beyond floating point: these constants say "
            'nothing for this plant and window. Use variant="tightened" or the exact certificate.',
            factor=name,
            exponent=exponent,
        )
    return float(np.exp(exponent))


def _in_range(constants: tuple[Constant, ...]) -> None:
    for constant in constants:
        if not np.isfinite(constant.value) or constant.value > LARGEST:
            raise CertificateError(
                f"The constant {constant.name} of the proof is {constant.value:.3g}, beyond floating point.",
                factor=constant.name,
            )


LONGEST_WINDOW = 4
"""Windows are tried up to this many times the number of states, in samples (plus one period of a periodic schedule)."""


def measure_hypotheses(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    window: float | None = None,
    sigma_bar: float | None = None,
    kappa: int | None = None,
) -> SamplingHypotheses:
    """Return T, kappa(T), sigma_bar and d_max of a schedule for an observable plant.

    Without `window`: the shortest sum of consecutive gaps (the largest over their position) with sigma_bar > 0. Raises
    ArgumentError if the schedule has no samples, or a given number is out of range; CertificateError if sigma_bar is 0
    for the window given, or for every window tried.
    """
    if not len(schedule):
        raise ArgumentError("`schedule` must have at least one sample.")
    sampling, plant = SamplingSet(schedule), plant.unscaled()  # weights and constants of a proof are physical
    tried = _windows(schedule, plant.n_states) if window is None else [checks.positive("window", window)]
    for T in tried:
        sigma = _sigma(plant, schedule, T) if sigma_bar is None else checks.positive("sigma_bar", sigma_bar)
        if sigma > 0:
            count = sampling.kappa(T) if kappa is None else checks.whole("kappa", kappa, 1)
            return SamplingHypotheses(float(T), count, sigma, float(sampling.d_max))
    length = f"windows of {short(tried[0])}" if len(tried) == 1 else f"windows up to {short(tried[-1])}"
    raise CertificateError(
        f"Theorem 14 does not apply: {length} {plant.time_unit} do not all make every retained state "
        "observable (sigma_bar = 0). "
        "Take a longer window, or other gaps: a gap may be a multiple of half an oscillation.",
        windows=list(map(float, tried)),
    )


def _windows(schedule: Schedule | PeriodicSchedule, states: int) -> list[float]:
    """Largest sum of j consecutive gaps, j = 1, 2, ...: the least T for which every window holds j samples or more."""
    periodic = schedule.endless
    most = LONGEST_WINDOW * states + (len(schedule) if periodic else 0)
    gaps = np.tile(schedule.gaps, most // len(schedule) + 2) if periodic else schedule.gaps
    sums = np.concatenate([[0.0], np.cumsum(gaps)])
    start = 0.0 if periodic else float(schedule.times[0])  # K_1 begins with the time to the first sample
    sums = sums + start if periodic else np.concatenate([[0.0], start + sums])
    longest = [float(np.max(sums[j:] - sums[:-j])) for j in range(1, min(most, sums.size - 1) + 1)]
    return [T for T in longest if T > 0]


def _sigma(plant: Plant, schedule: Schedule | PeriodicSchedule, T: float) -> float:
    """Proven lower bound over all real windows, those that begin before the first sample included."""
    return float(window_sigma(plant, schedule, T, start=0.0).lower)
