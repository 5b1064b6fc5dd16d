"""Theorem 5 with its constants for plants that are not exactly known: the proof of the paper over an inclusion.

With |x|_W for the norm and V = |Dx|^2_P(tau) of an inclusion certificate, rate eta, longest gap b:

    Definition 1   gamma_2 = |Dy|^2_R~ / b: the certificate's inequality, averaged over where equal gaps b begin
    Assumption 4   |J|_W <= L_f, |G w|_W <= g |w|_Qw over the whole inclusion
    (4)            |Dx(t-T)|_W <= e^{mu T}(|Dx(t)|_W + int g |Dw|) back in time, put into the certificate's inequality
    Theorem 5      P2 = 4 gamma e^{(2 L_f + eta) t*} W, and so on
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sampling_design.certificates.form.horizon import Constant, ConstantList
from sampling_design.certificates.paper.observable_case import LARGEST, SAFE, ProvenWeights
from sampling_design.certificates.paper.proof_constants import PaperConstants, theorem_9
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics.linalg import balance, generalised_max
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import Claim, short
from sampling_design.schedules.gap_range import GapRange
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion, in_terms
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate
from sampling_design.uncertain.plants.uncertain_plant import LinearInclusion, MemberHull

EXCESS = (0.3, 0.6, 1.2, 2.4)
"""Rates that are tried, per longest gap, beyond what differences grow at backwards in time."""
FASTEST = 40.0  # growth per longest gap beyond which no certificate is looked for
PIECES = 8  # of P(tau)
HALVINGS = 6  # of a nonlinear plant's region
SKEW = 1e6  # modes whose basis has a larger condition make no norm


@dataclass(frozen=True, eq=False, repr=False)
class InclusionConstants(PaperConstants):
    """Theorem 5's constants for every plant of a model and every schedule with gaps in a range.

    Attributes
    ----------
    plant : Plant
        The linear plant at the model's centre.
    variant : str
        "inclusion": the paper's chain, with norms and (4) of the differential inclusion.
    P1, P2, Qw, R, Qv : arrays
        Assumption 7 holds with them and the rate `eta`, for a nonlinear plant as long as it stays in its region.
    eta : float [1/time]
    constants : ConstantList
        In the order of the proof.
    family : GapRange
    metric : (n, n) array
        W: the constants are of the norm |x|_W.
    inclusion : InclusionCertificate
        The certificate they were made from, whose own horizon is far shorter.
    """

    family: GapRange
    metric: Array
    inclusion: InclusionCertificate

    @property
    def claim(self) -> Claim:
        """What is proven, and from which theorem."""
        return Claim(
            "Assumption 7 (sample-based exponential i-iIOSS) with these weights for every plant of the model",
            theorem="Theorem 5, (4) by an inclusion certificate",
            assumptions=self.inclusion.claim.assumptions,
        )


InclusionNorms: TypeAlias = tuple[Array, float, float]
"""Bounds over a whole inclusion in the norm |x|_W, W = S'S, as (S, L_f, mu): L_f >= |J|_W; mu >= 0 with
|x(s)|_W <= e^{mu (t-s)} |x(t)|_W back in time along x' = Jx."""


def constants_over_inclusion(
    plant: LinearInclusion, schedule: object, window: float | None = None, variant: str = "paper", **others: object
) -> InclusionConstants:
    """Return Theorem 5's constants for every plant of a model: see `constants_from_proof`.

    Raises ArgumentError if the schedule is no GapRange, an argument is given that belongs to a plant that is exactly
    known, or no sets that hold the whole model are known; UndecidedError if no certificate of a rate beyond twice the
    growth backwards in time is proven, or constants leave doubles.
    """
    checks.word("variant", variant, ("paper",))
    family = in_terms(plant, schedule, **others)
    if not isinstance(family, GapRange):
        raise ArgumentError("`schedule` must be a GapRange for the constants of a plant that is not exactly known.")
    T = None if window is None else checks.positive("window", window)
    hull = whole(plant)
    norms = [norms_of(hull, S) for S in metrics(plant.centre)]
    b, slowest = family.longest, 2 * min(backward for *_, backward in norms)
    best: InclusionConstants | None = None
    needed = np.inf
    if slowest * b <= FASTEST:
        for excess in EXCESS:
            try:
                found = certify_inclusion(plant, family, eta=float(f"{slowest + excess / b:.4g}"), pieces=PIECES)
            except UndecidedError:
                break
            needed = min(needed, *(shortest_window(found, each) for each in norms))
            made = [c for each in norms if (c := theorem_5(found, hull, each, T)) is not None]
            best = min([*made, *([best] if best else [])], key=lambda c: c.horizon, default=None)
    if best is None and T is not None and needed < np.inf:
        unit = plant.centre.time_unit
        short_by = f"it needs `window` longer than {short(needed)} {unit}" if needed >= T else "constants leave doubles"
        raise UndecidedError(
            f"undecided: condition (4) of Theorem 5 was not proven over windows of {short(T)} {unit}: {short_by}. "
            "Leave `window` out to have one chosen.",
            backward=slowest / 2,
        )
    if best is None:
        raise UndecidedError(
            "undecided: condition (4) of Theorem 5 was not proven. It needs a certificate that decays faster than "
            f"{short(slowest)} per {plant.centre.time_unit}, twice what differences may grow backwards in time. Try "
            "shorter gaps, a smaller region, or `certify`, which does without (4).",
            backward=slowest / 2,
        )
    return best


def whole(plant: LinearInclusion) -> MemberHull:
    """Sets that hold all of the inclusion. Raises ArgumentError if none are known."""
    n, scale = plant.centre.n_states, plant.centre.states.scales
    hull = plant.hull(HALVINGS, lambda m: np.abs(m[..., :n] * scale / scale[:, None]).sum(axis=(0, -2, -1)))
    if hull is not None:
        return hull._replace(output=hull.output[None], output_moves=hull.output_moves[:, None])
    members = plant.members(np.random.default_rng(0))
    if not members.complete:
        raise ArgumentError("`plant` must have few parameters, or derivatives with bounds over its region, for norms.")
    return MemberHull(
        members.dynamics, np.zeros((0, *members.dynamics.shape)), members.outputs, np.zeros((0, *members.outputs.shape))
    )


def metrics(centre: Plant) -> Iterator[Array]:
    """S of the norms |S x| that are tried: scaled or balanced states, and the modes of the centre in these."""
    scales = centre.states.scales
    d = scales if np.any(scales != 1) else balance(centre.A, centre.C).d
    yield np.diag(1 / d)
    V = np.linalg.eig(centre.A * d / d[:, None])[1]
    if np.linalg.cond(V) < SKEW:
        rows = np.linalg.solve(V, np.diag(1 / d).astype(V.dtype))
        yield np.linalg.cholesky(np.real(rows.conj().T @ rows)).T


def largest(middle: Array, moves: Array) -> float:
    """The largest spectral norm over sets, proven by the triangle inequality."""
    norms = np.linalg.norm(middle, 2, axis=(-2, -1)) + np.linalg.norm(moves, 2, axis=(-2, -1)).sum(axis=0)
    return float(np.max(norms, initial=0.0)) * SAFE


def norms_of(hull: MemberHull, S: Array) -> InclusionNorms:
    """L_f and mu of an inclusion in the norm |S x|."""
    n, inverse = len(S), np.linalg.inv(S)
    M, D = (S @ X[..., :n] @ inverse for X in (hull.middle, hull.moves))
    up, moved = (-(X + np.swapaxes(X, -1, -2)) / 2 for X in (M, D))
    tops = np.linalg.eigvalsh(up)[..., -1] + np.linalg.norm(moved, 2, axis=(-2, -1)).sum(axis=0)
    lipschitz = largest(M, D)
    return S, lipschitz, max(float(np.max(tops)) + (SAFE - 1) * lipschitz, 0.0)


WindowBound: TypeAlias = tuple[float, float, float, float, float, float]
"""Condition (4) from a certificate, (c, g, beta, gamma, T, q): |Dy|_R~ <= c|Dx|_W, |G w|_W <= g|w|_Qw, W <= beta P1,
P2 <= gamma W; q < 1 is what the inequality returns of |Dx(t)|^2_W over a window of length T."""


def shortest_window(found: InclusionCertificate, norms: InclusionNorms) -> float:
    """The window beyond which a certificate gives condition (4); infinite where it gives it over none."""
    S, _, backward = norms
    W, excess = S.T @ S, found.eta - 2 * backward
    if excess <= 0:
        return np.inf
    beta, gamma = generalised_max(W, found.P1) * SAFE, generalised_max(found.P2, W) * SAFE
    return max(float(np.log(2 * beta * gamma * SAFE)) / excess, 0.0)


def window_bound(
    found: InclusionCertificate, hull: MemberHull, norms: InclusionNorms, window: float | None
) -> WindowBound | None:
    """What makes (4) true; None where it does not follow."""
    S, _, backward = norms
    n, W = len(S), S.T @ S
    beta, gamma = generalised_max(W, found.P1) * SAFE, generalised_max(found.P2, W) * SAFE
    inverse, root = np.linalg.inv(S), np.linalg.cholesky(found.Rtilde).T
    unit = np.linalg.inv(np.linalg.cholesky(found.Qw)).T
    g = largest(S @ hull.middle[..., n:] @ unit, S @ hull.moves[..., n:] @ unit)
    c = largest(root @ hull.output @ inverse, root @ hull.output_moves @ inverse)
    excess = found.eta - 2 * backward
    if excess <= 0:
        return None
    T = float(np.log(4 * beta * gamma)) / excess if window is None else window
    q = 2 * beta * gamma * float(np.exp(-excess * T)) * SAFE
    return (c, g, beta, gamma, T, q) if q < 1 else None


def theorem_5(
    found: InclusionCertificate, hull: MemberHull, norms: InclusionNorms, window: float | None
) -> InclusionConstants | None:
    """The chain of Theorem 5 from a certificate; None where (4) does not follow, or a constant leaves doubles."""
    bound = window_bound(found, hull, norms, window)
    if bound is None:
        return None
    c, g, beta, gamma, T, q = bound
    S, L, backward = norms
    b, eta, W = found.d_max, found.eta, S.T @ S
    t_star = max(T, b)
    if (2 * L + 3 * eta) * t_star > np.log(LARGEST):
        return None
    growth, overlap = float(np.exp((2 * L + eta) * t_star)), 2 * float(np.exp(3 * eta * t_star))
    alpha_y, alpha_w = (c**2 * T * part / (b * (1 - q)) * SAFE for part in (beta, beta + q * T * g**2))
    R0, P2 = overlap * alpha_y * SAFE, 4 * gamma * growth * SAFE
    Qw = (1 + overlap * alpha_w + 4 * gamma * t_star * g**2 * growth) * SAFE
    result, weighed = "Theorem 5, result", r"\quad(\times|\Delta %s|^2)"
    steps = (
        Constant("eta", eta, r"\eta", "Definition 1, the certificate's", r"\eta"),
        Constant("gamma_2", 1 / b, "1/b" + weighed % "y", "Definition 1, averaged", r"\gamma_2"),
        Constant("Lf", L, r"\max|J|_W", "Assumption 4, over the inclusion", "L_f"),
        Constant("rho", g / L if L else 0.0, r"\max|G|/L_f\quad(\times|\Delta w|)", "Assumption 4", r"\rho"),
        Constant("mu", backward, r"\max\lambda_{\max}(-(J^\top W+WJ)/2,W)^+", "backwards in time", r"\mu"),
        Constant("beta", beta, r"\lambda_{\max}(W,P_1)", "the certificate's P1", r"\beta"),
        Constant("gamma", gamma, r"\lambda_{\max}(P_2,W)", "the certificate's P2", r"\gamma"),
        Constant("T", T, r"\ln(4\beta\gamma)/(\eta-2\mu)", "(4): q = 1/2", "T"),
        Constant("q", q, r"2\beta\gamma e^{(2\mu-\eta)T}", "(4): below 1", "q"),
        Constant("t_star", t_star, r"\max(T,d_{\max})", "Theorem 5 (d_max: E6)", "t^*"),
        Constant("alpha_w", alpha_w, r"c^2T(\beta+qTg^2)/(b(1-q))" + weighed % "w", "(4)", r"\alpha_w"),
        Constant("alpha_y", alpha_y, r"c^2T\beta/(b(1-q))" + weighed % "y", "(4)", r"\alpha_y"),
        Constant("growth", growth, r"e^{(2L_f+\eta)t^*}", "Theorem 5, (5)", r"e^{(2L_f+\eta)t^*}"),
        Constant("overlap", overlap, r"2e^{3\eta t^*}", "Theorem 5, (10), half-open windows (E5)", r"2e^{3\eta t^*}"),
        Constant("P2_scale", P2, r"4\gamma e^{(2L_f+\eta)t^*}\quad(\times W)", result, "P_2"),
        Constant("Qw_scale", Qw, r"1+2e^{3\eta t^*}\alpha_w+4\gamma t^*g^2e^{(2L_f+\eta)t^*}", result, "Q_w"),
        Constant("R0", R0, r"2e^{3\eta t^*}\alpha_y\quad(\times\tilde R)", result, "R_0"),
        *linear_constants(bound, L, eta, b),
    )  # fmt: skip
    if not max(P2, Qw, R0) < LARGEST:
        return None
    matrices = {"P1": found.P1, "P2": P2 * W, "Qw": Qw * found.Qw, "R": 2 * R0 * found.Rtilde}
    top = float(np.linalg.eigvalsh(R0 * found.Rtilde)[-1])
    proven = ProvenWeights(matrices["P1"], matrices["P2"], matrices["Qw"], top, eta, ConstantList(steps))
    weights = {key: freeze(value) for key, value in matrices.items()}
    family = GapRange(found.min_gap, b, time_unit=found.plant.time_unit)
    return InclusionConstants(
        plant=found.plant, family=family, variant="inclusion", **weights, Qv=weights["R"], eta=eta,
        constants=ConstantList((*steps, *theorem_9(proven))), metric=freeze(W), inclusion=found,
    )  # fmt: skip


def linear_constants(bound: WindowBound, L: float, eta: float, b: float) -> tuple[Constant, ...]:
    """Remark 15: the same proof with linear functions (r = 1), from (sqrt V)' <= -eta/2 sqrt V + |G w|_P."""
    c, g, beta, gamma, T, q = bound
    t_star, half = max(T, b), float(np.sqrt(q / 2))
    growth, overlap = float(np.exp((L + eta / 2) * t_star)), 2 * float(np.exp(1.5 * eta * t_star))
    share = c * T / (b * (1 - half)) * SAFE
    alpha_w, alpha_y = share * g * (half + float(np.sqrt(beta * gamma))), share * float(np.sqrt(beta))
    forced = float(np.sqrt(gamma)) * SAFE
    source = "Remark 15, rate eta/2"
    return (
        Constant("linear_alpha_w", alpha_w, r"cTg(\sqrt{q/2}+\sqrt{\beta\gamma})/(b(1-\sqrt{q/2}))", source),
        Constant("linear_alpha_y", alpha_y, r"cT\sqrt\beta/(b(1-\sqrt{q/2}))", source),
        Constant("linear_x", forced * growth, r"\sqrt\gamma e^{(L_f+\eta/2)t^*}\quad(\times|\Delta\chi|_W)", source),
        Constant(
            "linear_w", forced * g * (1 + growth) + overlap * alpha_w,
            r"\sqrt\gamma g(1+e^{(L_f+\eta/2)t^*})+2e^{3\eta t^*/2}\alpha_w", source,
        ),
        Constant("linear_y", overlap * alpha_y, r"2e^{3\eta t^*/2}\alpha_y", source),
    )  # fmt: skip
