"""Bounds on disturbance, noise and the first error, as the weights of an estimator count them."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import DisturbanceSet, StartError
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.online.evidence import EstimateAssumptions, SetBounds
from sampling_design.records import checks
from sampling_design.records.arrays import Array


class ErrorBounds:
    """What the truth costs at most: |w(t)|^2_Qw, |v|^2_R~ and |x(0) - prior|^2_P2.

    Attributes
    ----------
    w, v : array or None
        The bounds: a number bounds the norm, a vector each entry.
    disturbance, prior : float
        Largest |w|^2_Qw and |x(0) - prior|^2_P2; infinite where nothing bounds them.
    note : str
        Why there is no radius; "" where all three are bounded.
    """

    def __init__(
        self,
        weights: CostWeights,
        w_bound: npt.ArrayLike | None,
        v_bound: npt.ArrayLike | None,
        initial_error: npt.ArrayLike | None,
    ):
        self.weights, self.plant = weights, weights.plant
        plant = self.plant
        self.v = None if v_bound is None else checks.bound("v_bound", v_bound, plant.n_outputs)
        self.w = None if w_bound is None else checks.bound("w_bound", w_bound, plant.n_disturbances)
        self.disturbance = weights.disturbance_energy(self.w)
        noise = float(self.of_samples(np.ones((1, plant.n_outputs)))[0])
        self.prior = weights.prior_energy(
            None if initial_error is None else checks.bound("initial_error", initial_error, plant.n_states)
        )
        self.start_error = StartError.of(plant, initial_error)
        energies = {"w_bound": self.disturbance, "v_bound": noise, "initial_error": self.prior}
        missing = [name for name, energy in energies.items() if np.isinf(energy)]
        self.note = f"No radius: {', '.join(missing)} not given." if missing else ""

    def of_samples(self, masks: Array) -> Array:
        """What the noise of samples costs at most, (N,), of which `masks` (N, p) says what is measured."""
        return self.weights.sample_energy(self.v, False, masks)

    def over(self, h: float) -> float:
        """What the disturbance over a time h costs at most: w_bound^2 (1 - e^{-eta h})/eta in the norm of Qw."""
        eta = self.weights.eta
        return self.disturbance * (h if eta == 0 else -math.expm1(-eta * h) / eta) if h > 0 else 0.0

    def assumptions(self) -> EstimateAssumptions | None:
        """What an interval may take for granted; None where w or v is not bounded."""
        if self.w is None or self.v is None:
            return None
        (w, w_ball), (v, v_ball) = (
            (np.broadcast_to(bound, (count,)), bound.ndim == 0 and count > 1)
            for bound, count in ((self.w, self.plant.n_disturbances), (self.v, self.plant.n_outputs))
        )
        driven = DisturbanceSet(np.zeros(w.size), np.diag(w), w_ball)
        return EstimateAssumptions(self.plant, driven, SetBounds(np.zeros(v.size), v, v_ball), self.start_error)
