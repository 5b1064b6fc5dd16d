"""Between samples and at them: what bounds make of state, covariance and radius, and nodes and estimates made of these.

Each estimate that is handed out has its flags, and in words why one is down.
"""

from __future__ import annotations

import math

import numpy as np

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.accuracy.readings import RecordRow
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.composed_flow import ComposedFlow
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow
from sampling_design.estimators.online.estimate import Estimate, changed, estimate_of
from sampling_design.estimators.online.evidence import REMEMBERED, EstimateAssumptions, EstimateEvidence
from sampling_design.estimators.online.history import EstimatorState, HistoryNode, IncomingNode, SampleBranch
from sampling_design.estimators.online.schedule_watch import ScheduleClaim
from sampling_design.estimators.online.verdict import (
    LARGEST_RESIDUAL,
    ROUNDING,
    CovariancePrecision,
    SolveVerdict,
    passed,
    represented,
    scaled_bound,
)
from sampling_design.numerics.filtering import propagate
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array, freeze
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


OFF_SCHEDULE = "No a-priori claim: off the certificate's schedule."


class Recorder:
    """Makes each sample a node of the history; `assumed` is what intervals of the estimates are proven from.

    Estimates that are handed out are moved into the middle of these where they are to be `centred`.
    """

    bounds: ErrorBounds
    claim: ScheduleClaim
    assumed: EstimateAssumptions | None

    def __init__(
        self, loop: OpenLoop, claim: ScheduleClaim, assumed: EstimateAssumptions | None, centred: bool = False
    ):
        self.loop, self.bounds, self.claim, self.assumed, self.centred = loop, loop.bounds, claim, assumed, centred
        self._evidence: EstimateEvidence | None = None

    def prior(self, t: float, x: Array) -> HistoryNode:
        """Return the first node, before any sample: x at t with the weight P2."""
        root, energy = self.loop.weights.prior_root, self.bounds.prior * (1 + self.loop.weights.loose)
        Y, zero, scheduled = freeze(root @ root.T), np.zeros(self.loop.weights.plant.n_outputs), self.claim.stands
        return HistoryNode(
            t=t, sample=RecordRow(t), y=zero, mask=zero, feedthrough=zero, drift=np.zeros(x.size), limits=None,
            engine="", note="", cost=np.nan, status="prior", sound=True, own=None, x=x, Y=Y, beta=energy,
            scheduled=scheduled, branch=SampleBranch(),
        )  # fmt: skip

    def entries(self, node: HistoryNode) -> dict[str, object]:
        """Return the entries of a node's estimate, with its two flags and, in words, why one is down."""
        sound, note, unbounded = node.sound, node.note, self.bounds.note
        beta = node.beta if sound else np.nan
        certified = sound and not unbounded and math.isfinite(beta) and is_finite(node.Y)
        if node.own is not None:
            note = f"{node.own.sentence()} {note}".strip()
        elif unbounded:
            note = f"{note} {unbounded}"
        elif not certified:
            broken = "the data contradict the constraints. To start again: start(prior, prior_time)."
            note = f"{note} No radius: {broken if not sound else 'it overflows.'}"
        if not node.scheduled:
            note = f"{note} {self.claim.note or OFF_SCHEDULE}"
        return {
            "t": node.t, "x": node.x, "covariance": node.Y, "radius": beta, "status": node.status,
            "certified": certified, "on_schedule": node.scheduled, "note": note.strip(), "contradiction": node.own,
            "engine": node.engine, "window_start": node.window_start, "cost": node.cost,
        }  # fmt: skip

    def node(
        self,
        state: EstimatorState,
        new: IncomingNode,
        start: float,
        x: Array,
        Y: Array,
        verdict: SolveVerdict,
        engine: str,
        note: str = "",
        cost: float = np.nan,
        precision: CovariancePrecision | None = None,
    ) -> HistoryNode:
        """Return the node of a sample, whose window began at `start`; rounding widens the radius.

        State and covariance after it, what they are worth, how they were found, and Y's precision where known.
        """
        last, flow, drift = state.nodes[-1], new.flow, new.drift
        led = passed(last, flow, None if drift is self.loop.table.no_drift else drift, x)
        loose = max(last.loose, flow.loose)
        wider, beta, size = represented(Y, led, verdict[0] * (1 + loose), precision)
        Y = Y if wider is Y else freeze(wider)
        limited = new.t if new.sample.censored else last.limited
        size += 0.0 if math.isinf(flow.growth) else last.held / flow.growth
        x.setflags(write=False)
        return HistoryNode(  # in between: status, whether it is sound, what contradicts; drift, limits, schedule
            *new[:5], engine, note, cost, *verdict[1:], *new[6:], x, Y, beta=beta,
            branch=last.branch.after(last.number), window_start=start, number=last.number + 1, held=size, loose=loose,
            limited=limited,
        )  # fmt: skip

    def of_node(self, state: EstimatorState, at: int) -> Estimate:
        """Return the estimate of the node with the number `at`."""
        return self.proven(state, at, self.entries(state.nodes[at]))

    def predicted(self, state: EstimatorState, at: int, t: float) -> Estimate:
        """Return the estimate at t, open loop from the node with the number `at`."""
        node, loop = state.nodes[at], self.loop
        (flow,) = loop.table.get([t - node.t])
        drift = state.drift(loop.table, node.t, t)
        x, Y, beta = loop.ahead(node, flow, drift)
        loop.refuse_overflow(flow, t, x, Y)
        Y, beta, _ = represented(Y, passed(node, flow, drift, x), beta * (1 + loop.weights.loose))
        scheduled = node.scheduled and self.claim.nothing_missed(state.nodes[: at + 1], t)
        ahead = node._replace(
            t=t, x=freeze(x), Y=freeze(Y), beta=beta, status="predicted", sound=node.stands, own=node.contradiction,
            scheduled=scheduled, engine="", note="", cost=np.nan, window_start=np.nan,
        )  # fmt: skip
        return self.proven(state, at, self.entries(ahead))

    def proven(self, state: EstimatorState, at: int, entries: dict[str, object]) -> Estimate:
        """Return an estimate made from the nodes up to one of them, with the evidence for its interval, or centred."""
        if self.assumed is None:
            return estimate_of(entries)
        nodes = state.nodes[max(at - REMEMBERED, 0) : at + 1]  # each estimate would hold a copy of all that are kept
        evidence = self._evidence
        if evidence is None or not evidence.rests_on(nodes, state.inputs):
            evidence = self._evidence = EstimateEvidence(self.assumed, nodes, state.inputs, not self.bounds.note)
        found = estimate_of(entries, evidence)
        if not self.centred or found.status == "prior":
            return found
        middle = found.centred()
        return changed(middle, engine="set", note="" if middle.certified else middle.note, cost=np.nan)
