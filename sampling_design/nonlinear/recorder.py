"""The nodes and estimates of a nonlinear estimator: with the proven radius, or the covariance to first order."""

from __future__ import annotations

from typing import Any

import numpy as np

from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.online.estimate import Estimate, Status
from sampling_design.estimators.online.history import EstimatorState, HistoryNode
from sampling_design.nonlinear.open_loop import NonlinearLoop
from sampling_design.nonlinear.promise import UNCOVERED
from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze

NOTE = "No radius: no certificate was given."


class NonlinearRecorder:
    """Makes each sample a node of the history, with the estimate that is handed out."""

    def __init__(self, loop: NonlinearLoop, claim_note: str):
        self.loop, self.plant, self.promise, self.claim_note = loop, loop.plant, loop.promise, claim_note

    def prior(self, t: float, x: Array) -> HistoryNode:
        """Return the first node, before any sample: x at t with the weight P2."""
        scaled, scale = self.loop.scaled, self.plant.signals["states"].scales
        inverse = np.linalg.solve(scaled.twice * scaled.P2, np.eye(x.size))
        square = np.inf if self.promise is None else self.promise.largest(t, t, prior=True)
        return self.node(RecordRow(t), x, "prior", inverse * scale * scale[:, None], square, t)

    def node(
        self,
        sample: RecordRow,
        x: Array,
        status: Status,
        Y: Array,
        square: float,
        counted: float,
        note: str = "",
        scheduled: bool = True,
        **details: Any,
    ) -> HistoryNode:
        """Return a snapshot with the linearised covariance Y and the bound on V; what is linear only is empty."""
        x, Y = freeze(x), freeze(Y)
        estimate = self.estimate(sample.t, x, status, Y, square, counted, note, scheduled, **details)
        y = np.zeros(self.plant.n_outputs) if sample.y is None else np.nan_to_num(sample.y)
        mask = np.zeros(y.size) if sample.y is None else np.isfinite(sample.y).astype(np.float64)
        nothing = np.zeros(0)
        return HistoryNode(
            t=sample.t,
            y=y,
            mask=mask,
            feedthrough=nothing,
            x=x,
            Y=Y,
            beta=square,
            flow=None,
            drift=nothing,
            scheduled=scheduled,
            sound=True,
            estimate=estimate,
            sample=sample,
            counted=counted,
        )

    def estimate(
        self,
        t: float,
        x: Array,
        status: Status,
        Y: Array,
        square: float,
        counted: float,
        note: str,
        scheduled: bool,
        **details: Any,
    ) -> Estimate:
        """Return an estimate: with its radius where one is proven, else with the covariance to first order."""
        promise = self.promise
        if promise is None or not np.isfinite(square):
            why = NOTE if promise is None else f"No radius: {promise.trouble or UNCOVERED}."
            note = " ".join(filter(None, (note, why)))
            return Estimate(t, freeze(x), freeze(Y), status=status, note=note, **details)
        covariance = np.linalg.solve(promise.weight(t, counted), np.eye(x.size))
        return Estimate(
            t,
            freeze(x),
            freeze((covariance + covariance.T) / 2),
            square,
            status,
            certified=True,
            on_schedule=scheduled and not self.claim_note,
            note=" ".join(filter(None, (note, self.claim_note))),
            **details,
        )

    def predicted(self, state: EstimatorState, t: float) -> Estimate:
        """Return the estimate at t, open loop from the last node at or before it."""
        node = state.nodes[state.node_before(t)]
        if node.t == t:
            return node.estimate
        x, Y, square, trouble = self.loop.ahead(state, node, t)
        status: Status = "solver failed" if "fails" in trouble else "predicted"
        last = self.loop.since(node, t)
        scheduled = node.scheduled and (self.promise is None or bool(np.isfinite(self.promise.age(t, last))))
        if self.promise is not None and last != node.counted and np.isfinite(square):
            square = self.promise.ahead(self.promise.largest(node.t, last, prior=True), node.t, t)
        return self.estimate(t, x, status, Y, square, last, trouble, scheduled)
