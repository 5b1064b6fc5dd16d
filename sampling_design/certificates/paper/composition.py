"""Theorem 16: a certificate of the retained part and the decay of the residual part, put together with constants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from sampling_design.certificates.form.horizon import Constant, ConstantList
from sampling_design.certificates.paper.observable_case import SAFE, ProvenWeights, _in_range
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.modes import ModalSplit
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array

RATE_SHARE = 0.9
"""Part of the residual's rate that the composition may use; at 1 the sum over samples would not converge."""

SLACK = 1e-3
"""P1 = (1 - SLACK) P2 where the proof would allow P1 = P2: a tight inequality cannot be proven over the continuum."""


@dataclass(frozen=True, eq=False)
class ResidualDecay:
    """|z(t)|_P^2 <= e^{-eta t}|z(0)|_P^2 + int e^{-eta(t-s)} |w|_W^2 ds for a Hurwitz part z' = A z + G w."""

    P: Array
    eta: float
    W: Array


def residual_decay(plant: Plant, share: float | None = None) -> ResidualDecay:
    """Lyapunov decay of a Hurwitz plant.

    With `share` None as in the theorem's proof: A'P + PA = -I, eta = 1/(2 lambda_max(P)), W = 2 G'P^2 G.
    Otherwise eta is `share` times twice the slowest decay, (A + eta/2 I)'P + P(A + eta/2 I) = -I and W = G'P^2 G.
    """
    eye = np.eye(plant.n_states)
    if share is None:
        P = _lyapunov(plant.A, eye)
        eta, young = 1 / (2 * float(np.linalg.eigvalsh(P)[-1])) / SAFE, 2.0
    else:
        eta, young = -2 * share * float(np.max(np.linalg.eigvals(plant.A).real)), 1.0
        P = _lyapunov(plant.A + eta / 2 * eye, eye)
    PG = P @ plant.G
    return ResidualDecay(P, eta, young * SAFE * symmetrise(PG.T @ PG))


def _lyapunov(A: Array, Q: Array) -> Array:
    """P with A'P + PA = -Q."""
    return symmetrise(np.asarray(solve_continuous_lyapunov(A.T, -Q), dtype=np.float64))


def compose(split: ModalSplit, proven: ProvenWeights, decay: ResidualDecay, window: float, kappa: int) -> ProvenWeights:
    """Put the retained part's chain and the residual's decay together (theory 3.3).

        eta = min(eta_u, .9 eta_s),  S = kappa/(1 - e^{-(eta_s - eta) T}),  beta = 2 R0u |C_s|^2 S/lambda_min(P_s),
        rho = beta/(lambda_u - 1),  P1 = blk(rho P_s, P1u),  P2 = blk((rho + beta) P_s, P2u),
        Qw = (rho + beta) W_s + Qwu,  R0 = 2 R0u

    Notes
    -----
    *Claim.* lambda_max(P2, P1) = lambda_u: the residual part costs rate, not lambda. *Assumptions.* The chain
    holds for the retained plant with its own disturbance input; both parts are driven by the same w.
    """
    eta = min(proven.eta, RATE_SHARE * decay.eta)
    size_C = float(np.linalg.norm(split.residual.C, 2))
    S = kappa / -np.expm1(-(decay.eta - eta) * window)
    beta = max(2 * proven.R0 * size_C**2 * S / float(np.linalg.eigvalsh(decay.P)[0]) * SAFE, np.finfo(float).tiny)
    lam_u = proven.lam
    # an output that does not see the residual part leaves rho free: its size then sets nothing but the norm
    rho = beta / (lam_u - 1) if size_C else proven.R0
    L_r, L_s = split.left_retained, split.left_residual
    P1 = rho * L_s.T @ decay.P @ L_s + L_r.T @ proven.P1 @ L_r
    P2 = (rho + beta) * L_s.T @ decay.P @ L_s + L_r.T @ proven.P2 @ L_r
    Qw = (rho + beta) * decay.W + proven.Qw
    steps = (
        Constant("eta_s", decay.eta, r"1/(2\lambda_{\max}(P_s))", "Theorem 16, residual part", r"\eta_s"),
        Constant("eta_composed", eta, r"\min(\eta_u, 0.9\,\eta_s)", "Theorem 16 (E27)", r"\eta"),
        Constant("S", S, r"\kappa/(1-e^{-(\eta_s-\eta)T})", "Theorem 16, sum over samples", "S"),
        Constant("beta_s", beta, r"2R_{0u}|C_s|^2S/\lambda_{\min}(P_s)", "Theorem 16", r"\beta_s"),
        Constant("lam_u", lam_u, r"\lambda_{\max}(P_{2u},P_{1u})", "Theorem 16, retained part", r"\lambda_u"),
        Constant("rho_s", rho, r"\beta_s/(\lambda_u-1)", "Theorem 16", r"\rho_s"),
        Constant("R0_composed", 2 * proven.R0, r"2R_{0u}", "Theorem 16", "R_0"),
    )
    _in_range(steps)
    constants = ConstantList((*proven.constants, *steps))
    return ProvenWeights(symmetrise(P1), symmetrise(P2), symmetrise(Qw), 2 * proven.R0, eta, constants)


def residual_alone(decay: ResidualDecay) -> ProvenWeights:
    """Chain of a plant of which nothing is retained: no sample is needed, lambda = 1 but for SLACK."""
    eta = decay.eta
    sizes = np.diagonal(decay.W)
    floor = np.diag(np.where(sizes > 0, SLACK * sizes, 1.0))  # G'P^2G may be singular, a weight must not be
    steps = (
        Constant("eta_s", eta, r"1/(2\lambda_{\max}(P_s))", "Theorem 16 with an empty retained part", r"\eta_s"),
        Constant("R0", 1.0, r"\text{any positive number}", "Theorem 16 with an empty retained part", "R_0"),
    )
    return ProvenWeights((1 - SLACK) * decay.P, decay.P, decay.W + floor, 1.0, eta, ConstantList(steps))
