"""What estimators of linear plants share: their parts, the prior, and predictions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.dated_start import nothing_said, resolved
from sampling_design.accuracy.readings import CensoredReading, RecordRow
from sampling_design.accuracy.record_readings import censored_together
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.evidence import REMEMBERED
from sampling_design.estimators.online.history import EstimatorState, IncomingNode, StateBox
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.estimators.online.open_loop import ErrorBounds, OpenLoop
from sampling_design.estimators.online.recorder import Recorder
from sampling_design.estimators.online.schedule_watch import ScheduleClaim
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze


class LinearPlantEstimator(OnlineEstimator):
    """An estimator put together from its parts; a child adds what a sample is worth, `_advance`.

    Attributes
    ----------
    recorder : Recorder
        Makes the nodes and the estimates, and holds the other parts:
    loop : OpenLoop
        The flow between samples.
    bounds : ErrorBounds
        Those on w, v and the first error.
    claim : ScheduleClaim
        Whether what a certificate says holds of the samples so far.
    """

    _table: ClassVar[Mapping[str, str]] = {
        **OnlineEstimator._table,
        "largest w, v": "{bounds.w:or not given}, {bounds.v:or not given}",
        "radii": "{bounds.note:or guaranteed where these bounds hold}",
    }

    recorder: Recorder
    loop: OpenLoop
    bounds: ErrorBounds
    claim: ScheduleClaim
    weighs_means: bool = False
    """Whether a composite sample is a row of what is minimised, so that it says something without bounds."""

    def prepare(self, recorder: Recorder, input_side: str) -> None:
        """Put the parts together.

        Raises ArgumentError if the plant has no states, or `input_side` is neither "right" nor "left".
        """
        self.recorder, self.loop, self.claim, self.bounds = recorder, recorder.loop, recorder.claim, recorder.bounds
        self.weights, self.table, self.plant = self.loop.weights, self.loop.table, self.loop.weights.plant
        if self.plant.n_states == 0:
            raise ArgumentError("`plant` must have at least one state: there is nothing to estimate.")
        checks.word("input_side", input_side, ("right", "left"))
        self.input_side, self.before = input_side, input_side == "left"
        self._direct = bool(self.plant.D.any())  # whether an input enters a measurement at once
        self._nothing, self._everything = freeze(np.zeros(self.plant.n_outputs)), freeze(np.ones(self.plant.n_outputs))
        self.remembered = REMEMBERED if recorder.assumed is not None else 0

    def start(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> None:
        """Forget all samples, and what they contradicted, and start again from a prior.

        Raises ArgumentError as `initial_state`.
        """
        self.state = self.initial_state(prior, prior_time)

    def initial_state(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> EstimatorState:
        """Return the state before any sample: `prior` (default 0) at `prior_time`, with weight P2."""
        n = self.plant.n_states
        t = checks.number("prior_time", prior_time)
        x = checks.vector("prior", np.zeros(n) if prior is None else prior, n)
        return EstimatorState((self.recorder.prior(t, x),))

    def _incoming(self, state: EstimatorState, sample: RecordRow) -> IncomingNode:
        """Return a sample as the equations take it, after the last node of a state."""
        y, mask = sample.y, self._everything
        u = state.input_at(sample.t, before=self.before) if self._direct else None
        if not math.isfinite(sum(y.tolist())):
            measured = np.isfinite(y)
            y, mask = np.where(measured, y, 0.0), measured.astype(np.float64)
        flow, drift = self.loop.between(state, state.last.t, sample.t)
        return IncomingNode(sample.t, sample, y, mask, self._nothing if u is None else self.plant.D @ u, flow, drift)

    def _handed_out(self, state: EstimatorState, node: int) -> Estimate:
        return self.recorder.proven(state, node, state.nodes[node].estimate)

    def _predict(self, state: EstimatorState, t: float) -> Estimate:
        at = state.node_before(t)
        if state.nodes[at].t == t:
            return self._handed_out(state, at)
        return self.recorder.proven(state, at, self.recorder.predicted(state, at, t))

    def _after_input(self, state: EstimatorState, t: float) -> EstimatorState:
        a = state.last.t
        return state._replace(reached=(a, t, state.drift(self.table, a, t)))

    def _resolved(self, state: EstimatorState, sample: RecordRow) -> RecordRow:
        if all(each.stamp is None for each in sample.censored):
            return sample
        assumed = self.recorder.assumed
        assert assumed is not None  # or the sample was refused
        if not state.last.stands:
            return sample._replace(censored=nothing_said(sample.censored))

        def known(rows: Array) -> tuple[Array, Array]:
            found = self._predict(state, sample.t).interval(rows)
            return found.lower, found.upper

        unread = assumed.unread(sample.t, state.inputs)
        censored = resolved(unread, sample.t, sample.censored, known, self.before, waiting=True)
        return sample._replace(censored=censored)

    def _settled(self, state: EstimatorState) -> EstimatorState:
        assumed, begun = self.recorder.assumed, max(len(state.nodes) - 1 - REMEMBERED, 0)
        if assumed is None or not np.isfinite(state.last.limited) or not state.last.stands:
            return state
        at = next((k for k, node in enumerate(state.nodes) if k > begun and node.waits), None)
        if at is None:
            return state
        first, last, rows = state.nodes[begun], state.last.t, list[RecordRow]()
        for node in state.nodes[begun if first.number else begun + 1 :]:
            censored = tuple(each.as_read for each in node.sample.censored if each.since is None)
            rows.append(RecordRow(node.t, np.where(node.mask > 0, node.y - node.feedthrough, np.nan), None, censored))
        unread = assumed.unread(first.t, state.inputs)
        proven = censored_together(unread, rows, assumed.noise, self.before)
        if proven is None:
            return state
        held = first._replace(box=StateBox(proven[0], until=last))
        found = state._replace(nodes=(*state.nodes[:begun], held, *state.nodes[begun + 1 : at]))
        said = {row.t: censored for row, censored in zip(rows, proven[1], strict=True)}
        for node in state.nodes[at:]:
            means = [each for each in node.sample.censored if each.since is not None]
            censored = tuple(sorted((*means, *said[node.t]), key=lambda each: each.output))
            sample = node.sample._replace(censored=censored) if node.waits else self._resolved(found, node.sample)
            found = found._replace(nodes=(*found.nodes, self._advance(found, sample)._replace(until=last)))
        return found

    def _check_censored(self, state: EstimatorState, t: float, limits: tuple[CensoredReading, ...]) -> None:
        exact = self.weighs_means and all(each.since is not None and each.lower == each.upper for each in limits)
        if self.recorder.assumed is None and not exact:
            raise ArgumentError(
                f"`w_bound` and `v_bound` must be given for the limit, mean or uncertain time at t = {t!r} to say "
                "anything."
            )
        for each in limits:
            if each.stamp is not None and each.stamp.first < state.nodes[0].t:
                raise ArgumentError(
                    f"`t` = {each.span!r} must not begin before {state.nodes[0].t!r}, the oldest time kept."
                )
            if each.since is None:
                continue
            begin = state.nodes[0].t
            for node in state.nodes:
                if any(other.output == each.output and other.since is not None for other in node.sample.censored):
                    begin = max(begin, node.t) if node.t < t else begin
            if not begin <= each.since < t:
                raise ArgumentError(
                    f"`since` = {each.since!r} of the mean at t = {t!r} must lie before it and not before {begin!r}, "
                    "the oldest time kept or the end of the mean before."
                )
