"""The open loop of a nonlinear plant: what holds between samples, before any, and where a solve failed.

Each sample becomes a node of the history, its estimate with the proven radius, or the covariance to first order.
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from typing import Any

import numpy as np

from sampling_design.accuracy.readings import RecordRow
from sampling_design.errors import SolverError
from sampling_design.estimators.online.estimate import Estimate, Status
from sampling_design.estimators.online.history import EstimatorState, HistoryNode, SampleBranch
from sampling_design.nonlinear.inclusion_bound import UNCOVERED, InclusionBound
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.simulation import CovarianceIntegrator, Integrator, unknown
from sampling_design.nonlinear.weights import NonlinearWeights
from sampling_design.records.arrays import Array, freeze

NOTE = "No radius: no certificate was given."
GUESS_TOLERANCE = 1e-4  # of the integrator where a solver only starts from what it finds, in scaled states
PARTS = 16  # of a stretch without new inputs, at whose ends an open loop is looked at: does it stay in the region?
EDGE = 1e-6  # states within this share of their scale of the edge of X are in it: the solver ends there


class NonlinearLoop:
    """The flow between samples with w = 0, the covariance to first order, the proven bound on V, and their estimates.

    `ramps`: an input goes in a straight line to the next one, else it is held. `claim_note` says what a horizon costs.
    """

    def __init__(
        self,
        plant: NonlinearPlant,
        scaled: NonlinearWeights,
        error_bound: InclusionBound | None,
        ramps: bool,
        claim_note: str,
    ):
        self.plant, self.scaled, self.error_bound = plant, scaled, error_bound
        self.ramps, self.claim_note = ramps, claim_note
        self._build()

    def _build(self) -> None:
        """Build what casadi holds in memory."""
        Qw = self.scaled.twice * self.scaled.Qw
        noise: Array = np.asarray(np.linalg.solve(Qw, np.eye(len(Qw))), dtype=np.float64)
        self._integrator, self._covariance = (
            Integrator(self.plant, points=1 if self.error_bound is None else PARTS),
            CovarianceIntegrator(self.plant, noise, self.scaled.eta),
        )
        self._rough = Integrator(self.plant, GUESS_TOLERANCE)

    def __getstate__(self) -> dict[str, object]:
        """Everything but what casadi holds in memory."""
        return {
            key: value for key, value in self.__dict__.items() if key not in ("_integrator", "_covariance", "_rough")
        }

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._build()

    def since(self, node: HistoryNode, t: float) -> float:
        """When a sample last counted before t: before the first one, as long ago as lets it count."""
        if self.error_bound is None or node.counted != node.t or node.sample.y is not None:
            return node.counted
        return self.error_bound.origin(node.t, t)

    def input(self, state: EstimatorState, t: float) -> Array:
        """The input in force from t on."""
        return self.input_until(state, t, t)

    def input_until(self, state: EstimatorState, a: float, b: float) -> Array:
        """What the input in force from a on has become at b, with none given in between."""
        u = state.input_at(a)
        if u is None:
            return np.zeros(self.plant.n_inputs)
        times = [t for t, _ in state.inputs]
        k = bisect_right(times, a)
        if not self.ramps or k == len(times):
            return u
        share = (b - times[k - 1]) / (times[k] - times[k - 1])
        return np.asarray(u + share * (state.inputs[k][1] - u))

    def assumed(self, state: EstimatorState, t: float) -> str:
        """What is assumed at t of an input that runs straight to one that is not given yet."""
        if not self.ramps or not state.inputs or t <= state.inputs[-1][0]:
            return ""
        return f"Assumes that the input has kept its value since t = {state.inputs[-1][0]:.6g}, when it was last given."

    def propagated(
        self, state: EstimatorState, x: Array, a: float, b: float, Y: Array | None = None, guess: bool = False
    ) -> tuple[Array, Array | None, bool]:
        """Return where the open loop from x at a is at b, with w = 0 and the inputs that were given: state, covariance,
        and whether region and inputs were the certificate's all the way.

        As a guess it is found to `GUESS_TOLERANCE` only. What the certificate covers is looked at `PARTS` times between
        two inputs.
        """
        error_bound = self.error_bound
        covered = error_bound is not None and error_bound.holds(x)
        if b <= a:
            return x, Y, covered
        edges = [a, *(t for t, _ in state.inputs if a < t < b), b]
        still = np.zeros(self.plant.n_disturbances)
        integrator = self._rough if guess else self._integrator
        for start, stop in pairwise(edges):
            u, later = self.input(state, start), self.input_until(state, start, stop)
            if Y is not None:
                Y = self._covariance.step(x, Y, u, later, start, stop)
            path = integrator.path(x, u, still, start, stop, later)
            x = path[-1]
            if error_bound is not None and covered:
                covered = error_bound.holds(path) and error_bound.drives(np.array([u, later]))
        return x, Y, covered

    def begun(self, node: HistoryNode, last: float) -> float:
        """The bound on V at a node whose P(tau) counts from `last`, for a prior perhaps not as its own does."""
        if self.error_bound is None or last == node.counted or not np.isfinite(node.beta):
            return node.beta
        return self.error_bound.largest(node.t, last, node.x, prior=True)

    def ahead(self, state: EstimatorState, node: HistoryNode, t: float, last: float) -> tuple[Array, Array, float, str]:
        """Return state, covariance to first order, bound on V and what went wrong, in words: open loop from a node.

        The state is in X; if even the open loop fails it is the node's estimate. P(tau) counts from `last`.
        """
        nothing = unknown(node.x.size)
        try:
            x, Y, covered = self.propagated(state, node.x, node.t, t, node.Y)
        except SolverError as error:
            return node.x, nothing, np.inf, f"The open loop fails too, the last estimate is held: {error}"
        Y = nothing if Y is None else Y
        square, error_bound = float("inf"), self.error_bound
        if error_bound is not None and covered and np.isfinite(error_bound.age(t, last)):
            square = error_bound.ahead(self.begun(node, last), node.t, t)
        kept, words = self._projected(x, self.input(state, t))
        return kept, Y, square if kept is x else np.inf, words

    def _projected(self, x: Array, u: Array) -> tuple[Array, str]:
        """Return the nearest state in the box X, and say where x was if that was elsewhere, or where g is positive."""
        lower, upper = self.plant.bounds["states"]
        room = EDGE * self.plant.signals["states"].scales
        out = np.flatnonzero((x < lower - room) | (x > upper + room))
        words = ""
        kept = x
        if out.size:
            names = self.plant.signals["states"].names
            values = ", ".join(f"{names[i]} = {x[i]:.6g}" for i in out.tolist())
            words = f"The open loop leaves X ({values}) and was brought back to its edge."
            kept = np.clip(x, lower, upper)
        over = np.array(self.plant.limits_casadi(kept, u)).ravel()
        if np.any(over > 0):
            k = int(np.argmax(over))
            words = f"{words} The open loop leaves X: limit {k + 1} is {over[k]:.6g}, above 0.".strip()
        return kept, words

    def prior(self, t: float, x: Array) -> HistoryNode:
        """Return the first node, before any sample: x at t with the weight P2."""
        scaled, scale = self.scaled, self.plant.signals["states"].scales
        inverse = np.linalg.solve(scaled.twice * scaled.P2, np.eye(x.size))
        square = np.inf if self.error_bound is None else self.error_bound.largest(t, t, x, prior=True)
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
        *,
        window_start: float = np.nan,
        engine: str = "",
        cost: float = np.nan,
    ) -> HistoryNode:
        """Return a snapshot with the linearised covariance Y and the bound on V; what is linear only is empty."""
        y = np.zeros(self.plant.n_outputs) if sample.y is None else np.nan_to_num(sample.y)
        mask = np.zeros(y.size) if sample.y is None else np.isfinite(sample.y).astype(np.float64)
        nothing = np.zeros(0)
        return HistoryNode(
            t=sample.t, sample=sample, y=y, mask=mask, feedthrough=nothing, drift=nothing, limits=None, engine=engine,
            note=note, cost=cost, status=status, sound=True, own=None, x=freeze(x), Y=freeze(Y), beta=square,
            scheduled=scheduled, branch=SampleBranch(), window_start=window_start, counted=counted,
        )  # fmt: skip

    def of_node(self, node: HistoryNode) -> Estimate:
        """Return the estimate of a node."""
        return self.estimate(
            node.t, node.x, node.status, node.Y, node.beta, node.counted, node.note, node.scheduled,
            window_start=node.window_start, engine=node.engine, cost=node.cost,
        )  # fmt: skip

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
        error_bound = self.error_bound
        if error_bound is None or not np.isfinite(square):
            why = NOTE if error_bound is None else f"No radius: {error_bound.trouble or UNCOVERED}."
            note = " ".join(filter(None, (note, why)))
            return Estimate(t, freeze(x), freeze(Y), status=status, note=note, **details)
        covariance = np.linalg.solve(error_bound.weight(t, counted), np.eye(x.size))
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
            return self.of_node(node)
        last = self.since(node, t)
        x, Y, square, trouble = self.ahead(state, node, t, last)
        status: Status = "solver failed" if "fails" in trouble else "predicted"
        scheduled = node.scheduled and (self.error_bound is None or bool(np.isfinite(self.error_bound.age(t, last))))
        note = f"{trouble} {self.assumed(state, t)}".strip()
        return self.estimate(t, x, status, Y, square, last, note, scheduled)
