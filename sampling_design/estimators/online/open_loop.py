"""What filters and moving horizon estimators share: bounds, the prior, and the flow between samples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._checks import freeze
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import Weights, noise_bound
from sampling_design.estimators.gap_flows.flows import Flow, FlowTable, discounted_length
from sampling_design.estimators.online.estimator import Estimate, Sample, Status
from sampling_design.estimators.online.history import Drift, Node, State
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.estimators.online.schedule_watch import ScheduleWatch
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]

CONTRADICTION = 1e-9
"""The bound must fall below zero by this share of its terms before the noise bounds count as disproved."""

ROUNDING = 1e-12
"""Share of its terms that is added to every bound, so that rounding cannot break it."""

EXACT_DATA = 1e-13
"""Relative error with which even exact data and states are held; its square, in the weights, joins every bound."""


class OpenLoopEstimator(OnlineEstimator):
    """Adds to `OnlineEstimator` the open loop with its ellipsoid: x flows with F, Pi^-1 to e^{eta h} F Pi^-1 F' + W_h,
    and the radius to e^{-eta h} radius + w_bound^2 (1 - e^{-eta h})/eta."""

    claim_note: str
    radius_note: str
    _watch: ScheduleWatch | None

    def _set_up(
        self,
        plant: Plant,
        weights: Weights,
        schedule: Any,
        feedthrough: str,
        constant_w: bool = False,
        timing_tolerance: float = 0.0,
    ) -> None:
        if plant.n_states == 0:
            raise ArgumentError("`plant` must have at least one state: there is nothing to estimate.")
        if feedthrough not in ("right", "left"):
            raise ArgumentError(f'`feedthrough` must be "right" or "left", got {feedthrough!r}.')
        self.plant, self.weights, self.feedthrough = plant, weights, feedthrough
        self.table = FlowTable(weights, constant_w)
        self._drift = Drift(self.table)
        self._watch = None
        tolerance = _checks.nonnegative("timing_tolerance", timing_tolerance)
        if schedule is not None:
            self._watch = ScheduleWatch(schedule, plant.time_unit, tolerance)

    def _set_bounds(self, w_bound: Any, v_bound: Any, initial_error: Any, kept_v: bool) -> None:
        plant, weights = self.plant, self.weights
        self._v_bound, self._kept_v = noise_bound("v_bound", v_bound, plant.n_outputs), kept_v
        self._w_energy = weights.disturbance_energy(noise_bound("w_bound", w_bound, plant.n_disturbances))
        self._v_energy = float(self._sample_energy(np.ones((1, plant.n_outputs)))[0])
        self._prior_energy = weights.prior_energy(noise_bound("initial_error", initial_error, plant.n_states))
        energies = {"w_bound": self._w_energy, "v_bound": self._v_energy, "initial_error": self._prior_energy}
        missing = [name for name, energy in energies.items() if np.isinf(energy)]
        self.radius_note = f"No radius: {', '.join(missing)} not given." if missing else ""

    def _sample_energy(self, masks: Array) -> Array:
        return self.weights.sample_energy(self._v_bound, self._kept_v, masks)

    def initial_state(self, prior: Any = None, prior_time: float = 0.0) -> State:
        """Return the state before any sample: `prior` (default 0) at `prior_time`, with weight P2."""
        n, p = self.plant.n_states, self.plant.n_outputs
        t = _checks.number("prior_time", prior_time)
        x = _checks.vector("prior", np.zeros(n) if prior is None else prior, n)
        Y = freeze(self.weights.prior_root @ self.weights.prior_root.T)
        scheduled = not self.claim_note and self._watch is not None
        estimate = self._estimate(t, x, Y, self._prior_energy, "prior", sound=True, scheduled=scheduled)
        zero = np.zeros(p)
        node = Node(
            t, zero, zero, zero, x, Y, self._prior_energy, None, np.zeros(n), scheduled, True, estimate, Sample(t)
        )
        return State((node,))

    def _estimate(
        self, t: float, x: Array, Y: Array, beta: float, status: Status, *, sound: bool, scheduled: bool, **details: Any
    ) -> Estimate:
        """Return an estimate with its two flags and, in words, why one is down."""
        certified = sound and not self.radius_note and status not in ("infeasible", "bounds disproved")
        notes = [details.pop("note", "")]
        if not certified:
            notes.append(self.radius_note or ("" if sound else "No radius: the data contradict the bounds."))
        if not scheduled:
            notes.append(self.claim_note or "No a-priori claim: off the certificate's schedule.")
        note = " ".join(filter(None, notes))
        return Estimate(t, x, Y, beta, status, certified=certified, on_schedule=scheduled, note=note, **details)

    def _flown(self, node: Node, flow: Flow, drift: Array) -> tuple[Array, Array, float]:
        """Return state, covariance and radius after `flow`, without a measurement."""
        beta = node.beta / flow.growth + self._lost(flow.gap) if flow.gap > 0 else node.beta
        return flow.F @ node.x + drift, flow.covariance(node.Y), beta

    def _lost(self, h: float) -> float:
        """w_bound^2 (1 - e^{-eta h})/eta in the norm of Qw."""
        return self._w_energy * float(discounted_length(self.weights.eta, h)) if h > 0 else 0.0

    def _predict(self, state: State, t: float) -> Estimate:
        node = state.nodes[state.node_before(t)]
        if node.t == t:
            return node.estimate
        (flow,) = self.table.get([t - node.t])
        x, Y, beta = self._flown(node, flow, self._drift.between(state, node.t, t))
        scheduled = node.scheduled and self._nothing_missed(node, t)
        return self._estimate(t, freeze(x), freeze(Y), beta, "predicted", sound=node.sound, scheduled=scheduled)

    def _nothing_missed(self, node: Node, t: float) -> bool:
        return self._watch is None or self._watch.nothing_missed(node.t, t, first=node.sample.y is None)

    def _fits_schedule(self, state: State, t: float, mask: Array) -> bool:
        """Whether everything up to and with a sample at t is on schedule."""
        last = state.last
        if not last.scheduled or self._watch is None:
            return last.scheduled
        times = np.array([*(node.t for node in state.nodes), t])
        return self._watch.sample_fits(times, mask, first=last.sample.y is None)

    def _measured(self, state: State, sample: Sample) -> tuple[Array, Array, Array]:
        """Return y with 0 where it is missing, the mask of 0 and 1, and D u."""
        seen = np.isfinite(sample.y)
        mask = seen.astype(np.float64)
        y = sample.y if seen.all() else np.where(seen, sample.y, 0.0)
        u = state.input_at(sample.t, before=self.feedthrough == "left")
        return y, mask, self.plant.D @ u if u is not None else np.zeros(mask.size)

    def _rounded(self, y: Array, x: Array) -> float:
        """What the rounding of (N, p) measurements and of a state may cost."""
        # entry by entry: a large value in one unit says nothing about the rounding of another
        read, held = np.abs(self.weights.y_root) @ np.abs(y).T, np.abs(self.weights.prior_factor.T) @ np.abs(x).T
        return (EXACT_DATA * (math.sqrt(np.vdot(read, read)) + math.sqrt(np.vdot(held, held)))) ** 2

    def _judged(self, terms: float, dual: float, sound: bool) -> tuple[float, Status, bool]:
        """Return the radius `terms` - `dual`, its status, and whether the assumptions still stand."""
        beta = terms - dual
        if beta < -CONTRADICTION * terms:
            return 0.0, "bounds disproved", False
        return max(beta, 0.0) + ROUNDING * terms, "ok", sound
