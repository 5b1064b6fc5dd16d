"""The nodes of a history and the estimates that are handed out, each with its flags and why one is down."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.gap_flows.flows import GapFlow
from sampling_design.estimators.online.estimate import Contradiction, Estimate, Status, estimate_of, with_proof
from sampling_design.estimators.online.evidence import EstimateAssumptions, EstimateEvidence
from sampling_design.estimators.online.history import EstimatorState, HistoryNode, SampleBranch
from sampling_design.estimators.online.open_loop import OpenLoop
from sampling_design.estimators.online.schedule_watch import ScheduleClaim
from sampling_design.estimators.online.verdict import CovariancePrecision, SolveVerdict, in_units_of, moved, passed
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze

PROPAGATED = 4e-15
"""Relative error of a covariance that was propagated over a gap, in units of its diagonal: times its condition it is
that of the ellipsoid."""

OFF_SCHEDULE = "No a-priori claim: off the certificate's schedule."


class MeasuredSample(NamedTuple):
    """A sample as the equations take it: y with 0 where it is missing, the mask of 0 and 1, D u, and its limits."""

    sample: RecordRow
    y: Array
    mask: Array
    feedthrough: Array
    limits: Array | None = None


class SolvedSample(NamedTuple):
    """State and covariance after a sample, what they are worth, how they were found, Y's precision where known."""

    x: Array
    Y: Array
    found: SolveVerdict
    engine: str = ""
    note: str = ""
    cost: float = np.nan
    precision: CovariancePrecision | None = None


class SampleReader:
    """Samples as the equations take them; `input_side` says which input enters y where u jumps."""

    def __init__(self, plant: Plant, input_side: str):
        self.plant, self.before = plant, input_side == "left"
        self._direct = bool(plant.D.any())  # whether an input enters a measurement at once
        self._nothing, self._everything = freeze(np.zeros(plant.n_outputs)), freeze(np.ones(plant.n_outputs))

    def read(self, state: EstimatorState, sample: RecordRow) -> tuple[Array, Array, Array]:
        """Return y with 0 where it is missing, the mask of 0 and 1, and D u."""
        y: Array = sample.y
        u = state.input_at(sample.t, before=self.before) if self._direct else None
        feedthrough = self._nothing if u is None else self.plant.D @ u
        if math.isfinite(sum(y.tolist())):
            return y, self._everything, feedthrough
        measured = np.isfinite(y)
        return np.where(measured, y, 0.0), measured.astype(np.float64), feedthrough


class Recorder:
    """Makes each sample a node of the history; `assumed` is what intervals of the estimates are proven from."""

    def __init__(self, loop: OpenLoop, claim: ScheduleClaim, assumed: EstimateAssumptions | None):
        self.loop, self.bounds, self.claim, self.assumed = loop, loop.bounds, claim, assumed
        self._evidence: EstimateEvidence | None = None

    def prior(self, t: float, x: Array) -> HistoryNode:
        """Return the first node, before any sample: x at t with the weight P2."""
        root, energy = self.loop.weights.prior_root, self.bounds.prior
        Y, zero, scheduled = freeze(root @ root.T), np.zeros(self.loop.weights.plant.n_outputs), self.claim.stands
        estimate = self.estimate(t, x, Y, energy, "prior", sound=True, scheduled=scheduled)
        return HistoryNode(
            t=t, y=zero, mask=zero, feedthrough=zero, x=x, Y=Y, beta=energy, flow=None, drift=np.zeros(x.size),
            scheduled=scheduled, sound=True, estimate=estimate, sample=RecordRow(t), branch=SampleBranch(),
        )  # fmt: skip

    def estimate(
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
        engine: str = "",
        window_start: float = np.nan,
        cost: float = np.nan,
    ) -> Estimate:
        """Return an estimate with its two flags and, in words, why one is down."""
        if not sound:
            beta = np.nan
        unbounded = self.bounds.note
        certified = sound and not unbounded and math.isfinite(beta) and _is_finite(Y)
        if contradiction is not None:
            note = f"{contradiction.sentence()} {note}".strip()
        elif unbounded:
            note = f"{note} {unbounded}"
        elif not certified:
            broken = "the data contradict the constraints. To start again: start(prior, prior_time)."
            note = f"{note} No radius: {broken if not sound else 'it overflows.'}"
        if not scheduled:
            note = f"{note} {self.claim.note or OFF_SCHEDULE}"
        return estimate_of(
            t=t, x=x, covariance=Y, radius=beta, status=status, certified=certified, on_schedule=scheduled,
            note=note.strip(), contradiction=contradiction, engine=engine, window_start=window_start, cost=cost,
        )  # fmt: skip

    def node(
        self,
        state: EstimatorState,
        measured: MeasuredSample,
        gap: tuple[GapFlow, Array],
        solved: SolvedSample,
        window_start: float,
        scheduled: bool = False,
    ) -> HistoryNode:
        """Return the node of a sample after a gap, with the estimate that is handed out; rounding widens its radius."""
        last, (flow, drift), (x, Y, found, engine, note, cost, precision) = state.nodes[-1], gap, solved
        sample, y, mask, feedthrough, limits = measured
        none = self.loop.drift.none
        size, condition = in_units_of(Y, passed(last, flow, None if drift is none else drift, x), precision)
        loose = max(last.loose, flow.loose)
        beta, status, sound, contradiction = found
        beta = beta * (1 + PROPAGATED * condition + loose) + moved(beta, size)
        t = sample.t
        estimate = self.estimate(
            t, x, Y, beta, status, sound=sound, scheduled=scheduled, contradiction=contradiction, note=note,
            engine=engine, window_start=window_start, cost=cost,
        )  # fmt: skip
        limited = t if sample.censored else last.limited
        size += 0.0 if math.isinf(flow.growth) else last.held / flow.growth
        branch = None if last.branch is None else last.branch.after(last.number)
        return HistoryNode(
            t=t, y=y, mask=mask, feedthrough=feedthrough, x=x, Y=Y, beta=beta, flow=flow, drift=drift,
            scheduled=scheduled, sound=sound, estimate=estimate, sample=sample, number=last.number + 1, limits=limits,
            limited=limited, held=size, loose=loose, branch=branch,
        )  # fmt: skip

    def predicted(self, state: EstimatorState, at: int, t: float) -> Estimate:
        """Return the estimate at t, open loop from the node with the number `at`."""
        node, loop = state.nodes[at], self.loop
        (flow,) = loop.table.get([t - node.t])
        drift = loop.drift.between(state, node.t, t)
        x, Y, beta = loop.ahead(node, flow, drift)
        loop.refuse_overflow(flow, x, t)
        if not np.isfinite(Y).all():
            loop.refuse_overflow(flow, np.array([np.inf]), t)
        size, condition = in_units_of(Y, passed(node, flow, drift, x))
        beta = beta * (1 + PROPAGATED * condition + loop.weights.loose) + moved(beta, size)
        scheduled = node.scheduled and self.claim.nothing_missed(state.nodes[: at + 1], t)
        return self.estimate(
            t, freeze(x), freeze(Y), beta, "predicted", sound=node.stands, scheduled=scheduled,
            contradiction=node.contradiction,
        )  # fmt: skip

    def proven(self, state: EstimatorState, at: int, estimate: Estimate) -> Estimate:
        """Return an estimate made from the nodes up to one of them, with the evidence for its interval."""
        if self.assumed is None:
            return estimate
        nodes = state.nodes if at + 1 == len(state.nodes) else state.nodes[: at + 1]
        evidence = self._evidence
        if evidence is None or evidence.nodes is not nodes or evidence.inputs is not state.inputs:
            evidence = self._evidence = EstimateEvidence(self.assumed, nodes, state.inputs, not self.bounds.note)
        return with_proof(estimate, evidence)


def _is_finite(Y: Array) -> bool:
    """Whether all entries of a covariance are finite: most often one sum tells."""
    return math.isfinite(np.vdot(Y, Y)) or bool(np.isfinite(Y).all())
