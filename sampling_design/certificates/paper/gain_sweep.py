"""Observer gain and Lyapunov matrix for the shortest horizon that the proof's constants give."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_lyapunov
from scipy.optimize import minimize

from sampling_design.certificates.detectability.best_rate import detectability_from_proof, refuse_undetectable
from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.errors import SolverError
from sampling_design.numerics.filtering import stationary_covariance
from sampling_design.numerics.linalg import expm_batch, symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array

SHIFTS = np.geomspace(0.02, 4.0, 8)  # shifts of the filter's poles in units of |A|
NOISES = np.geomspace(1e-2, 1e3, 8)  # process noise against measurement noise, in units of |A|^2/|C|^2
REFINEMENTS = 400  # evaluations of the simplex search that refines the best of the 64
RATE_CAP = 2.0
"""The sweep values no rate beyond RATE_CAP/t*: where the output shows every state the horizon tends to 2 t* only as the
gain tends to infinity, and the noise gains with e^{3 eta t*}."""
INSTANTS = 17
"""Times at which the growth before the first restart is looked at while choosing; the chain itself proves it."""


def best_gain(plant: Plant, t_star: float, variant: str, cap: float = np.inf) -> DetectabilityCertificate:
    """Return the constants of Theorem 10 for the gain and Q of least 2 ln(2 lambda)/min(eta, cap, 2/t*).

    Raises NotDetectableError if a mode is unobservable; SolverError if no gain of the sweep could be computed.

    Notes
    -----
    *Method.* Gains of Kalman-Bucy filters of the shifted plant, 8 shifts by 8 noise levels with Q = I, then a simplex
    search over shift, diagonal noise and diagonal Q. *Claim.* None on optimality: whatever the choice, the
    constants are those of the proof.
    """
    refuse_undetectable(plant, 0.0)
    n = plant.n_states
    search = _HorizonOfGains(plant, t_star, variant, cap)
    starts = [np.r_[np.log(s), np.log(w), np.zeros(2 * (n - 1))] for s in SHIFTS for w in NOISES]
    scores = [search(start) for start in starts]
    best = starts[int(np.argmin(scores))]
    if not np.isfinite(min(scores)):
        raise SolverError("No observer gain of the sweep could be computed: the filter's Riccati equation failed.")
    least = minimize(search, best, method="Nelder-Mead", options={"maxfev": REFINEMENTS, "xatol": 1e-3, "fatol": 1e-4})
    gain, Q, _ = search.choice(least.x if least.fun < min(scores) else best)
    return detectability_from_proof(plant, gain, Q)


class _HorizonOfGains:
    """The horizon, in units of 1/|A|, as a function of log shift, log noise, log ratios of noise and of Q."""

    def __init__(self, plant: Plant, t_star: float, variant: str, cap: float) -> None:
        self.plant, self.t_star, self.variant, self.cap = plant, t_star, variant, min(cap, RATE_CAP / t_star)
        self.size = float(np.linalg.norm(plant.A, 2)) or 1.0
        self.noise = (self.size / (float(np.linalg.norm(plant.C, 2)) or 1.0)) ** 2
        self.times = np.linspace(0.0, t_star, INSTANTS)
        self.flows = expm_batch(plant.A, self.times)

    def choice(self, parameters: Array) -> tuple[Array, Array, Array]:
        """Gain, Q and P at these parameters."""
        plant, n = self.plant, self.plant.n_states
        shifted = plant.A + np.exp(parameters[0]) * self.size * np.eye(n)
        noise = self.noise * np.exp(parameters[1] + np.r_[0.0, parameters[2 : n + 1]])
        Q = np.diag(np.exp(np.r_[0.0, parameters[n + 1 :]]))
        Y = stationary_covariance(shifted, plant.C, np.diag(noise))
        gain = Y @ plant.C.T
        return gain, Q, symmetrise(solve_continuous_lyapunov((plant.A - gain @ plant.C).T, -Q))

    def __call__(self, parameters: Array) -> float:
        """The horizon in units of 1/|A|, infinite where the equations have no answer."""
        if np.max(np.abs(parameters)) > 30:
            return float("inf")
        try:
            _, Q, P = self.choice(parameters)
            values = np.asarray(np.linalg.eigvalsh(P), dtype=np.float64)
            if values[0] <= 0:
                return float("inf")
            eta = float(np.min(np.diag(Q))) / (2 * values[-1])
            return float(2 * (np.log(2) + self._log_lambda(P, values, eta)) / (min(eta, self.cap) / self.size))
        except (LinAlgError, ValueError):
            return float("inf")

    def _log_lambda(self, P: Array, values: Array, eta: float) -> float:
        if self.variant == "paper":
            return float(np.log(8 * values[-1] / values[0]) + (2 * self.size + eta) * self.t_star)
        L = np.linalg.cholesky(P)
        # L' Phi L^-T, the inverse as a solve from the right
        inside = np.swapaxes(np.linalg.solve(L, np.swapaxes(L.T @ self.flows, 1, 2)), 1, 2)
        swing = np.linalg.norm(inside, 2, axis=(1, 2)) ** 2
        return float(np.log(2) + np.max(eta * self.times + np.log(swing)))
