"""The nodes of a history and the estimates that are handed out, each with its flags and why one is down."""

from __future__ import annotations

import math

import numpy as np

from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.online.estimate import Estimate, changed, estimate_of
from sampling_design.estimators.online.evidence import REMEMBERED, EstimateAssumptions, EstimateEvidence
from sampling_design.estimators.online.history import EstimatorState, HistoryNode, IncomingNode, SampleBranch
from sampling_design.estimators.online.open_loop import ErrorBounds, OpenLoop, is_finite
from sampling_design.estimators.online.schedule_watch import ScheduleClaim
from sampling_design.estimators.online.verdict import CovariancePrecision, SolveVerdict, passed, represented
from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze

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
