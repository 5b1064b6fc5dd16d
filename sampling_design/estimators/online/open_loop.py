"""Bounds on what is not measured, and what state, covariance and radius become between samples under them."""

from __future__ import annotations

import math

import numpy as np

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.composed_flow import ComposedFlow
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow
from sampling_design.estimators.online.evidence import EstimateAssumptions
from sampling_design.estimators.online.history import EstimatorState, HistoryNode
from sampling_design.estimators.online.verdict import LARGEST_RESIDUAL, ROUNDING, scaled_bound
from sampling_design.numerics.filtering import propagate
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array
from sampling_design.records.vector_bounds import VectorBound, refuse_apart, vector_bound


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

    def __init__(self, weights: CostWeights, w_bound: VectorBound, v_bound: VectorBound, initial_error: VectorBound):
        self.weights, self.plant = weights, weights.plant
        self._samples: dict[bytes, float] = {}
        plant = self.plant
        self.v = None if v_bound is None else vector_bound("v_bound", v_bound, plant.outputs.names)
        self.w = None if w_bound is None else vector_bound("w_bound", w_bound, plant.disturbances.names)
        self.disturbance = weights.disturbance_energy(self.w)
        noise = float(self.of_samples(np.ones((1, plant.n_outputs)))[0])
        self.prior = weights.prior_energy(
            None if initial_error is None else vector_bound("initial_error", initial_error, plant.states.names)
        )
        self.start_error = BoundedSet.of("initial_error", initial_error, plant.states.names)
        energies = {"w_bound": self.disturbance, "v_bound": noise, "initial_error": self.prior}
        missing = [name for name, energy in energies.items() if np.isinf(energy)]
        self.note = f"No radius: {', '.join(missing)} not given." if missing else ""

    def of_samples(self, masks: Array) -> Array:
        """What the noise of samples costs at most, (N,), of which `masks` (N, p) says what is measured."""
        return self.weights.sample_energy(self.v, False, masks)

    def of_sample(self, mask: Array) -> float:
        """What the noise of one sample costs at most; found once for each mask."""
        key = mask.tobytes()
        if key not in self._samples:
            self._samples[key] = float(self.of_samples(mask[None])[0])
        return self._samples[key]

    def over(self, h: float) -> float:
        """What the disturbance over a time h costs at most: w_bound^2 (1 - e^{-eta h})/eta in the norm of Qw."""
        eta = self.weights.eta
        return self.disturbance * (h if eta == 0 else -math.expm1(-eta * h) / eta) if h > 0 else 0.0

    def assumptions(self) -> EstimateAssumptions | None:
        """What an interval may take for granted; None where w or v is not bounded."""
        if self.w is None or self.v is None:
            return None
        plant = self.plant
        refuse_apart(plant.C, plant.G, w_bound=self.w, v_bound=self.v)
        disturbance = BoundedSet.of("w_bound", self.w, plant.disturbances.names)
        noise = BoundedSet.of("v_bound", self.v, plant.outputs.names)
        return EstimateAssumptions(plant, disturbance, noise, self.start_error)


class OpenLoop:
    """The flow between samples, with the ellipsoid |x - xhat|^2_Pi <= radius.

    x flows with F, Pi^-1 to e^{eta h} F Pi^-1 F' + W_h, and the radius to
    e^{-eta h} radius + w_bound^2 (1 - e^{-eta h})/eta. Far ahead the discount alone would widen that ellipsoid. So a
    prediction takes the smaller of it and of the one that flows undiscounted: radius Pi^-1 becomes
    (1 + p) radius F Pi^-1 F' + (1 + 1/p) h w_bound^2 W_h with W_h at eta = 0 and the p of least trace in units of P2,
    an outer ellipsoid of the sum of the two.
    """

    def __init__(self, table: FlowTable, bounds: ErrorBounds):
        self.table, self.weights, self.bounds = table, table.weights, bounds
        plant = self.weights.plant
        self._undiscounted_flow = ComposedFlow(plant.A, self.weights.noise, 0.0, self.weights.units)

    def between(self, state: EstimatorState, a: float, b: float) -> tuple[GapFlow, Array]:
        """Return the gap from a to b and what the inputs of a state add over it."""
        return self.table.one(b - a), state.drift(self.table, a, b)

    def propagated(self, node: HistoryNode, flow: GapFlow, drift: Array) -> tuple[Array, Array, float]:
        """Return state, covariance and radius after a gap, without a measurement."""
        beta = scaled_bound(node.beta, 1 / flow.growth) + self.bounds.over(flow.gap) if flow.gap > 0 else node.beta
        x: Array = flow.F.dot(node.x)
        return x if drift is self.table.no_drift else x + drift, flow.covariance(node.Y), beta

    def ahead(self, node: HistoryNode, flow: GapFlow, drift: Array) -> tuple[Array, Array, float]:
        """Return state, covariance and radius after a gap: of the two ellipsoids the smaller one."""
        with np.errstate(over="ignore", invalid="ignore"):
            x, Y, beta = self.propagated(node, flow, drift)
            whole = self.undiscounted(node, flow)
        if whole is None or not np.isfinite(whole).all():
            if not np.isfinite(Y).all():
                with np.errstate(over="ignore", invalid="ignore"):
                    Y = propagate(node.Y, flow.F, self._disturbed(flow))
            return x, Y, beta
        size = self._trace(whole)
        if np.isfinite(Y).all() and beta * self._trace(Y) <= size:
            return x, Y, beta
        scale = beta if beta > 0 else 1.0
        return x, whole / scale, scale

    def undiscounted(self, node: HistoryNode, flow: GapFlow) -> Array | None:
        """Return the matrix of an ellipsoid z'M^-1 z <= 1 that holds the error after a gap; None without bounds."""
        energy = self.bounds.disturbance
        if not (np.isfinite(node.beta) and np.isfinite(energy)) or flow.gap == 0:
            return None
        own = node.beta * symmetrise(flow.F @ node.Y @ flow.F.T)
        driven = energy * flow.gap * self._disturbed(flow)
        first, second = self._trace(own), self._trace(driven)
        if not (first > 0 and second > 0):
            return own + driven
        p = min(
            max(math.sqrt(second) / math.sqrt(first), 1 / LARGEST_RESIDUAL), LARGEST_RESIDUAL
        )  # any p > 0 proves it
        return (own * (1 + p) + driven * (1 + 1 / p)) * (1 + ROUNDING)

    def refuse_overflow(self, flow: GapFlow, t: float, *reached: Array) -> None:
        """Refuse what grows beyond double precision over a gap up to t.

        Raises ArgumentError if the flow or what it leads to is not finite.
        """
        if not all(map(is_finite, (flow.F, *reached))):
            raise ArgumentError(
                f"`t` = {t!r} lies {flow.gap:.6g} {self.weights.plant.time_unit} after the last sample: what is not "
                "measured for so long grows beyond double precision. Start again near it: start(prior, prior_time)."
            )

    def _trace(self, Y: Array) -> float:
        """Trace of a covariance in units of P2."""
        with np.errstate(over="ignore", invalid="ignore"):  # of two that overflow neither is the smaller one
            return float(np.sum(self.weights.prior * Y))

    def _disturbed(self, flow: GapFlow) -> Array:
        """int_0^h e^{As} G Qw^-1 G' e^{A's} ds over a gap, found once: predictions look ahead by the same gaps."""
        if flow.undiscounted is None:
            with np.errstate(over="ignore", invalid="ignore"):
                flow.undiscounted = np.asarray(self._undiscounted_flow.over([flow.gap])[2][0])
        return flow.undiscounted


def is_finite(values: Array) -> bool:
    """Whether all entries are finite: most often one sum tells."""
    return math.isfinite(sum(values.ravel().tolist())) or bool(np.isfinite(values).all())
