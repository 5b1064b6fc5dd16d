"""What filters and moving horizon estimators share: bounds, the prior, and the flow between samples."""

from __future__ import annotations

import math
from typing import NamedTuple, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import CensoredReading, DisturbanceSet, StartError
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.composed_flow import ComposedFlow
from sampling_design.estimators.gap_flows.cost_weights import CostWeights, noise_bound
from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow
from sampling_design.estimators.online.estimate import Contradiction, Estimate, Status, estimate_of, with_proof
from sampling_design.estimators.online.estimator import CheckedSample
from sampling_design.estimators.online.evidence import REMEMBERED, Assumptions, Evidence, SetBounds
from sampling_design.estimators.online.history import Branch, EstimatorState, HistoryNode, InputDrift
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.estimators.online.rounding import CovariancePrecision, faded, in_units_of, moved, passed, rounding
from sampling_design.estimators.online.schedule_watch import ScheduleWatch
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.checks import freeze
from sampling_design.schedules.family import AnySchedule, SamplingFamily

Array = npt.NDArray[np.float64]

CONTRADICTION = 1e-9
"""The bound must fall below zero by this share of its terms before the noise bounds count as disproved."""

ROUNDING = 1e-12
"""Share of its terms that is added to every bound, so that rounding cannot break it."""

FLOWN = 4e-15
"""Relative error of a covariance that was flown over a gap, in units of its diagonal: times its condition it is that of
the ellipsoid."""

OFF_SCHEDULE = "No a-priori claim: off the certificate's schedule."

LARGEST = 1e150
"""Residuals beyond this, in units of their weights, have squares that overflow in sums."""


class SolveVerdict(NamedTuple):
    """What a solve is worth: the bound on |x|^2_Pi, the status, whether the assumptions stand, and what contradicts."""

    beta: float
    status: Status
    sound: bool
    contradiction: Contradiction | None


class SolveDetails(TypedDict, total=False):
    """What an estimate says of its solve."""

    engine: str
    window_start: float
    cost: float


class MeasuredSample(NamedTuple):
    """A sample as the equations take it: y with 0 where it is missing, the mask of 0 and 1, D u, and its limits."""

    sample: CheckedSample
    y: Array
    mask: Array
    feedthrough: Array
    limits: Array | None = None


class OpenLoopState(NamedTuple):
    """What is held after a sample: state, covariance, the flow and drift that led there, Y's precision where known."""

    x: Array
    Y: Array
    flow: GapFlow
    drift: Array
    precision: CovariancePrecision | None = None


class OpenLoopEstimator(OnlineEstimator):
    """Adds to `OnlineEstimator` the open loop with its ellipsoid.

    x flows with F, Pi^-1 to e^{eta h} F Pi^-1 F' + W_h, and the radius to
    e^{-eta h} radius + w_bound^2 (1 - e^{-eta h})/eta. Far ahead the discount alone would widen that ellipsoid. So a
    prediction takes the smaller of it and of the one that flows undiscounted: radius Pi^-1 becomes
    (1 + p) radius F Pi^-1 F' + (1 + 1/p) h w_bound^2 W_h with W_h at eta = 0 and the p of least trace in units of P2,
    an outer ellipsoid of the sum of the two.
    """

    claim_note: str
    radius_note: str
    weighs_means: bool = False
    """Whether a composite sample is a row of what is minimised, so that it says something without bounds."""
    _watch: ScheduleWatch | None
    _assumed: Assumptions | None

    def _set_up(
        self,
        plant: Plant,
        weights: CostWeights,
        schedule: AnySchedule | SamplingFamily | None,
        input_side: str,
        constant_w: bool = False,
        timing_tolerance: float = 0.0,
        schedule_zero: float = 0.0,
    ) -> None:
        if plant.n_states == 0:
            raise ArgumentError("`plant` must have at least one state: there is nothing to estimate.")
        checks.word("input_side", input_side, ("right", "left"))
        self.plant, self.weights, self.input_side = plant, weights, input_side
        self.table = FlowTable(weights, constant_w)
        self._drift = InputDrift.of(self.table)
        self._undiscounted_flow = ComposedFlow(plant.A, weights.noise, 0.0, weights.units)
        self._direct = bool(plant.D.any())  # whether an input enters a measurement at once
        self._nothing, self._everything = freeze(np.zeros(plant.n_outputs)), freeze(np.ones(plant.n_outputs))
        self._watch = None
        tolerance = checks.nonnegative("timing_tolerance", timing_tolerance)
        zero = checks.number("schedule_zero", schedule_zero)
        if schedule is not None:
            self._watch = ScheduleWatch(schedule, plant.time_unit, tolerance, zero)

    def _set_bounds(
        self, w_bound: npt.ArrayLike | None, v_bound: npt.ArrayLike | None, initial_error: npt.ArrayLike | None
    ) -> None:
        plant, weights = self.plant, self.weights
        self._v_bound = noise_bound("v_bound", v_bound, plant.n_outputs)
        self._w_bound = noise_bound("w_bound", w_bound, plant.n_disturbances)
        self._w_energy = weights.disturbance_energy(self._w_bound)
        v_energy = float(self._sample_energy(np.ones((1, plant.n_outputs)))[0])
        self._prior_energy = weights.prior_energy(noise_bound("initial_error", initial_error, plant.n_states))
        energies = {"w_bound": self._w_energy, "v_bound": v_energy, "initial_error": self._prior_energy}
        missing = [name for name, energy in energies.items() if np.isinf(energy)]
        self.radius_note = f"No radius: {', '.join(missing)} not given." if missing else ""
        self._assumed = self._assumptions(StartError.of(plant, initial_error))
        self.remembered = REMEMBERED if self._assumed is not None else 0
        self._evidence: Evidence | None = None

    def _assumptions(self, error: StartError) -> Assumptions | None:
        """Return what an interval may take for granted; None where w or v is not bounded."""
        if self._w_bound is None or self._v_bound is None:
            return None
        (w, w_ball), (v, v_ball) = (
            (np.broadcast_to(bound, (count,)), bound.ndim == 0 and count > 1)
            for bound, count in (
                (self._w_bound, self.plant.n_disturbances),
                (self._v_bound, self.plant.n_outputs),
            )
        )
        push = DisturbanceSet(np.zeros(w.size), np.diag(w), w_ball)
        return Assumptions(self.plant, push, SetBounds(np.zeros(v.size), v, v_ball), error)

    def _check_told(self, state: EstimatorState, t: float, limits: tuple[CensoredReading, ...]) -> None:
        exact = self.weighs_means and all(each.since is not None and each.lower == each.upper for each in limits)
        if self._assumed is None and not exact:
            raise ArgumentError(
                f"`w_bound` and `v_bound` must be given for the limit or mean at t = {t!r} to say anything."
            )
        for each in limits:
            if each.since is None:
                continue
            begin = state.nodes[0].t
            for node in state.nodes:
                if any(other.output == each.output and other.since is not None for other in node.sample.told):
                    begin = max(begin, node.t) if node.t < t else begin
            if not begin <= each.since < t:
                raise ArgumentError(
                    f"`since` = {each.since!r} of the mean at t = {t!r} must lie before it and not before {begin!r}, "
                    "the oldest time kept or the end of the mean before."
                )

    def _handed_out(self, state: EstimatorState, node: int) -> Estimate:
        return self._known(state, node, state.nodes[node].estimate)

    def _known(self, state: EstimatorState, node: int, estimate: Estimate) -> Estimate:
        """Return an estimate made from the nodes up to one of them, with the evidence for its interval."""
        if self._assumed is None:
            return estimate
        nodes = state.nodes if node + 1 == len(state.nodes) else state.nodes[: node + 1]
        evidence = self._evidence
        if evidence is None or evidence.nodes is not nodes or evidence.inputs is not state.inputs:
            evidence = self._evidence = Evidence(self._assumed, nodes, state.inputs, not self.radius_note)
        return with_proof(estimate, evidence)

    def _sample_energy(self, masks: Array) -> Array:
        return self.weights.sample_energy(self._v_bound, False, masks)

    def start(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> None:
        """Forget all samples, and what they contradicted, and start again from a prior.

        Raises
        ------
        ArgumentError
            As `initial_state`.
        """
        self.state = self.initial_state(prior, prior_time)

    def initial_state(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> EstimatorState:
        """Return the state before any sample: `prior` (default 0) at `prior_time`, with weight P2."""
        n, p = self.plant.n_states, self.plant.n_outputs
        t = checks.number("prior_time", prior_time)
        x = checks.vector("prior", np.zeros(n) if prior is None else prior, n)
        Y = freeze(self.weights.prior_root @ self.weights.prior_root.T)
        scheduled = not self.claim_note and self._watch is not None
        estimate = self._estimate(t, x, Y, self._prior_energy, "prior", sound=True, scheduled=scheduled)
        zero = np.zeros(p)
        node = HistoryNode(
            t=t,
            y=zero,
            mask=zero,
            feedthrough=zero,
            x=x,
            Y=Y,
            beta=self._prior_energy,
            flow=None,
            drift=np.zeros(n),
            scheduled=scheduled,
            sound=True,
            estimate=estimate,
            sample=CheckedSample(t),
            branch=Branch(),
        )
        return EstimatorState((node,))

    def _estimate(
        self,
        t: float,
        x: Array,
        Y: Array,
        beta: float,
        status: Status,
        *,
        sound: bool,
        scheduled: bool,
        contradiction: Contradiction | None = None,
        note: str = "",
        **details: Unpack[SolveDetails],
    ) -> Estimate:
        """Return an estimate with its two flags and, in words, why one is down."""
        if not sound:
            beta = np.nan
        certified = sound and not self.radius_note and math.isfinite(beta) and _is_finite(Y)
        if contradiction is not None:
            note = f"{contradiction.told()} {note}".strip()
        elif self.radius_note:
            note = f"{note} {self.radius_note}"
        elif not certified:
            broken = "the data contradict the constraints. To start again: start(prior, prior_time)."
            note = f"{note} No radius: {broken if not sound else 'it overflows.'}"
        if not scheduled:
            note = f"{note} {self.claim_note or OFF_SCHEDULE}"
        return estimate_of(
            t=t, x=x, covariance=Y, radius=beta, status=status, certified=certified, on_schedule=scheduled,
            note=note.strip(), contradiction=contradiction, **details,
        )  # fmt: skip

    def _node(
        self,
        state: EstimatorState,
        measured: MeasuredSample,
        held: OpenLoopState,
        found: SolveVerdict,
        details: SolveDetails,
        note: str = "",
        scheduled: bool = False,
    ) -> HistoryNode:
        """Return the node of a sample, with the estimate that is handed out; its rounding widens the radius."""
        last, (x, Y, flow, drift, precision) = state.nodes[-1], held
        sample, y, mask, feedthrough, limits = measured
        size, condition = in_units_of(Y, passed(last, flow, None if drift is self._drift.none else drift, x), precision)
        loose = max(last.loose, flow.loose)
        beta, status, sound, contradiction = found
        beta = beta * (1 + FLOWN * condition + loose) + moved(beta, size)
        t = sample.t
        estimate = self._estimate(
            t, x, Y, beta, status, sound=sound, scheduled=scheduled, contradiction=contradiction, note=note, **details
        )
        limited = t if sample.told else last.limited
        size += 0.0 if math.isinf(flow.growth) else last.held / flow.growth
        branch = None if last.branch is None else last.branch.after(last.number)
        return HistoryNode(
            t=t, y=y, mask=mask, feedthrough=feedthrough, x=x, Y=Y, beta=beta, flow=flow, drift=drift,
            scheduled=scheduled, sound=sound, estimate=estimate, sample=sample, number=last.number + 1, limits=limits,
            limited=limited, held=size, loose=loose, branch=branch,
        )  # fmt: skip

    def _flown(self, node: HistoryNode, flow: GapFlow, drift: Array) -> tuple[Array, Array, float]:
        """Return state, covariance and radius after `flow`, without a measurement."""
        beta = faded(node.beta, 1 / flow.growth) + self._lost(flow.gap) if flow.gap > 0 else node.beta
        x: Array = flow.F.dot(node.x)
        return x if drift is self._drift.none else x + drift, flow.covariance(node.Y), beta

    def _lost(self, h: float) -> float:
        """w_bound^2 (1 - e^{-eta h})/eta in the norm of Qw."""
        eta = self.weights.eta
        return self._w_energy * (h if eta == 0 else -math.expm1(-eta * h) / eta) if h > 0 else 0.0

    def _after_input(self, state: EstimatorState, t: float) -> EstimatorState:
        a = state.last.t
        return state._replace(reached=(a, t, self._drift.between(state, a, t)))

    def _predict(self, state: EstimatorState, t: float) -> Estimate:
        at = state.node_before(t)
        node = state.nodes[at]
        if node.t == t:
            return self._handed_out(state, at)
        (flow,) = self.table.get([t - node.t])
        drift = self._drift.between(state, node.t, t)
        self._refuse_overflow(flow, self._moved(node, flow, drift), t)
        x, Y, beta = self._ahead(node, flow, drift)
        if not np.isfinite(Y).all():
            self._refuse_overflow(flow, np.array([np.inf]), t)
        size, condition = in_units_of(Y, passed(node, flow, drift, x))
        beta = beta * (1 + FLOWN * condition + self.weights.loose) + moved(beta, size)
        scheduled = node.scheduled and self._nothing_missed(state.nodes[: at + 1], t)
        found = self._estimate(
            t,
            freeze(x),
            freeze(Y),
            beta,
            "predicted",
            sound=node.stands,
            scheduled=scheduled,
            contradiction=node.contradiction,
        )
        return self._known(state, at, found)

    @staticmethod
    def _moved(node: HistoryNode, flow: GapFlow, drift: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(flow.F @ node.x + drift)

    def _refuse_overflow(self, flow: GapFlow, x: Array, t: float) -> None:
        if not (np.isfinite(flow.F).all() and np.isfinite(x).all()):
            raise ArgumentError(
                f"`t` = {t!r} lies {flow.gap:.6g} {self.plant.time_unit} after the last sample: what is not measured "
                "for so long grows beyond double precision. Start again near it: start(prior, prior_time)."
            )

    def _ahead(self, node: HistoryNode, flow: GapFlow, drift: Array) -> tuple[Array, Array, float]:
        """Return state, covariance and radius after `flow`: of the two ellipsoids the smaller one."""
        with np.errstate(over="ignore", invalid="ignore"):
            x, Y, beta = self._flown(node, flow, drift)
            whole = self._undiscounted(node, flow)
        if whole is None or not np.isfinite(whole).all():
            if not np.isfinite(Y).all():
                with np.errstate(over="ignore", invalid="ignore"):
                    Y = symmetrise(flow.F @ node.Y @ flow.F.T + self._plain_flow(flow.gap))
            return x, Y, beta
        size = self._trace(whole)
        if np.isfinite(Y).all() and beta * self._trace(Y) <= size:
            return x, Y, beta
        scale = beta if beta > 0 else 1.0
        return x, whole / scale, scale

    def _undiscounted(self, node: HistoryNode, flow: GapFlow) -> Array | None:
        """Return the matrix of an ellipsoid z'M^-1 z <= 1 that holds the error after `flow`; None without bounds."""
        if not (np.isfinite(node.beta) and np.isfinite(self._w_energy)) or flow.gap == 0:
            return None
        own = node.beta * symmetrise(flow.F @ node.Y @ flow.F.T)
        pushed = self._w_energy * flow.gap * self._plain_flow(flow.gap)
        first, second = self._trace(own), self._trace(pushed)
        if not (first > 0 and second > 0):
            return own + pushed
        p = min(max(math.sqrt(second) / math.sqrt(first), 1 / LARGEST), LARGEST)  # any p > 0 proves it
        return (own * (1 + p) + pushed * (1 + 1 / p)) * (1 + ROUNDING)

    def _trace(self, Y: Array) -> float:
        """Trace of a covariance in units of P2."""
        return float(np.sum(self.weights.prior * Y))

    def _plain_flow(self, gap: float) -> Array:
        """int_0^h e^{As} G Qw^-1 G' e^{A's} ds."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(self._undiscounted_flow.over([gap])[2][0])

    def _nothing_missed(self, nodes: tuple[HistoryNode, ...], t: float) -> bool:
        if self._watch is None:
            return True
        last = next((node for node in reversed(nodes) if _counts(node)), None)
        return last is not None and self._watch.nothing_missed(last.t, t, first=last.sample.y is None)

    def _fits_schedule(self, state: EstimatorState, t: float, mask: Array) -> bool:
        """Whether everything up to and with a sample at t is on schedule.

        A sample without a number, of limits and means alone, is none for the schedule: the claim is about numbers.
        """
        if not state.last.scheduled or self._watch is None:
            return state.last.scheduled
        if not mask.any():
            return self._nothing_missed(state.nodes, t)
        before = [node for node in state.nodes if _counts(node)]
        if not before:
            return False
        times = [node.t for node in before]
        times.append(t)
        return self._watch.sample_fits(times, mask, first=before[-1].sample.y is None)

    def _measured(self, state: EstimatorState, sample: CheckedSample) -> tuple[Array, Array, Array]:
        """Return y with 0 where it is missing, the mask of 0 and 1, and D u."""
        y: Array = sample.y
        u = state.input_at(sample.t, before=self.input_side == "left") if self._direct else None
        feedthrough = self._nothing if u is None else self.plant.D @ u
        if math.isfinite(sum(y.tolist())):
            return y, self._everything, feedthrough
        seen = np.isfinite(y)
        return np.where(seen, y, 0.0), seen.astype(np.float64), feedthrough

    def _rounded(self, y: Array, x: Array) -> float:
        """What the rounding of (N, p) measurements and of a state may cost."""
        # entry by entry: a large value in one unit says nothing about the rounding of another
        read, held = np.abs(self.weights.y_root) @ np.abs(y).T, np.abs(self.weights.prior_factor.T) @ np.abs(x).T
        return rounding(float(np.vdot(read, read)), float(np.vdot(held, held)))

    def _too_large(self, weighted: Array) -> bool:
        """Whether residuals, in units of their weights, are so large that their squares overflow."""
        return not bool((np.abs(weighted) < LARGEST).all())

    def _overflowed(
        self, state: EstimatorState, sample: CheckedSample, residual: Array, terms: float
    ) -> tuple[SolveVerdict, str]:
        """Return what a sample is worth that is too large to be weighed: nothing, and a contradiction of all bounds."""
        last = state.last
        contradiction, words = last.contradiction, "A measurement is too large to be weighed."
        if np.isinf(terms):
            return SolveVerdict(np.nan, "solver failed", last.stands, contradiction), words
        if contradiction is None:
            seen = np.isfinite(sample.y)
            output = int(np.argmax(np.where(seen, np.abs(residual), -1.0)))
            weight = float(np.max(np.abs(self.weights.y_root[:, output])))
            factor = weight * abs(float(residual[output])) / math.sqrt(terms) if terms > 0 else np.inf
            name = self.plant.outputs.names[output]
            contradiction = Contradiction(last.number + 1, sample.t, name, factor)
        return SolveVerdict(np.nan, "bounds disproved", False, contradiction), words

    def _judged(self, terms: float, dual: float, last: HistoryNode) -> SolveVerdict:
        """Return the radius `terms` - `dual`, its status, and whether the assumptions still stand."""
        beta = terms - dual
        if beta < -CONTRADICTION * terms:
            return SolveVerdict(0.0, "bounds disproved", False, last.contradiction)
        rest = (ROUNDING + self.weights.loose) * terms + moved(terms, last.held)
        return SolveVerdict(max(beta, 0.0) + rest, "ok", last.stands, last.contradiction)


def _counts(node: HistoryNode) -> bool:
    """Whether a node is the prior or holds a number: what a certificate's schedule is about."""
    return not node.sample.told or bool(node.mask.any())


def _is_finite(Y: Array) -> bool:
    """Whether all entries of a covariance are finite: most often one sum tells."""
    return math.isfinite(np.vdot(Y, Y)) or bool(np.isfinite(Y).all())
