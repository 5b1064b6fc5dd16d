"""What estimators of linear plants share: parts, prior and predictions, and the window as it begins and slides on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from sampling_design.accuracy.dated_start import nothing_said, resolved
from sampling_design.accuracy.readings import CensoredReading, RecordRow
from sampling_design.accuracy.record_readings import censored_together
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.constraints import WindowConstraints
from sampling_design.estimators.constraints.convex_set import all_inside
from sampling_design.estimators.gap_flows.flows import GapFlow
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.evidence import REMEMBERED
from sampling_design.estimators.online.history import (
    EstimatorState,
    HistoryNode,
    IncomingNode,
    InputHistory,
    WindowStart,
)
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.estimators.online.open_loop import ErrorBounds, OpenLoop, Recorder, is_finite
from sampling_design.estimators.online.schedule_watch import ScheduleClaim
from sampling_design.estimators.online.verdict import (
    SolveVerdict,
    in_units_of,
    judged,
    passed,
    rounding,
    scaled_bound,
)
from sampling_design.estimators.window.check_points import SAME_TIME_ULPS, CheckPoints, pieces
from sampling_design.estimators.window.sliding import BandCache, SlidingBand
from sampling_design.estimators.window.window_problem import (
    DUAL_MARGIN,
    EstimationWindow,
    IntegralFlows,
    MeanReading,
    means_of,
)
from sampling_design.numerics.filtering import covariance_root
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze

DRIFT = 4.0
"""Times what the truth may cost: up to there the cost of a reference does not show in the margin of the dual bound, so
that radii are the same whatever the references are. From that cost itself on, nodes to come take their estimates."""


class WindowedEstimator(OnlineEstimator):
    """An estimator of a linear plant, put together from its parts; its window is M_t = min(t, M) long.

    A child adds what a sample is worth, `_advance`.

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
    horizon: float
    arrival_cost: str
    begins: str = "horizon"
    constraints: WindowConstraints
    check_spacing: float | None = None
    weighs_means: bool = True
    """Whether a composite sample is a row of what is minimised, so that it says something without bounds."""
    _slides = False  # whether windows slide on from one sample to the next
    _between: CheckPoints | None = None

    def prepare(self, recorder: Recorder, input_side: str) -> None:
        """Put the parts together.

        Raises ArgumentError if the plant has no states, or `input_side` is neither "right" nor "left".
        """
        self.recorder, self.loop, self.claim, self.bounds = recorder, recorder.loop, recorder.claim, recorder.bounds
        self.clock_origin = self.claim.origin
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
        flow, drift = self.loop.between(state, state.nodes[-1].t, sample.t)
        feedthrough = self._nothing if u is None else self.plant.D @ u
        return IncomingNode(sample.t, sample, y, mask, feedthrough, flow, drift, self.claim.fits(state, sample.t, mask))

    def _handed_out(self, state: EstimatorState, node: int) -> Estimate:
        return self.recorder.of_node(state, node)

    def _predict(self, state: EstimatorState, t: float) -> Estimate:
        at = state.node_before(t)
        if state.nodes[at].t == t:
            return self._handed_out(state, at)
        return self.recorder.predicted(state, at, t)

    def _after_input(self, state: EstimatorState, t: float) -> EstimatorState:
        a = state.last.t
        return state._replace(reached=(a, t, state.drift(self.table, a, t)))

    def _resolved(self, state: EstimatorState, sample: RecordRow) -> RecordRow:
        if not sample.censored or all(each.stamp is None for each in sample.censored):
            return sample
        assumed = self.recorder.assumed
        assert assumed is not None  # or the sample was refused
        if not state.last.stands:
            return sample._replace(censored=nothing_said(sample.censored))

        def known(rows: Array) -> tuple[Array, Array]:
            interval = self._predict(state, sample.t).interval(rows)
            return interval.lower, interval.upper

        unread = assumed.unread(sample.t, state.inputs)
        censored = resolved(unread, sample.t, sample.censored, known, self.before, waiting=True)
        return sample._replace(censored=censored)

    def _settled(self, nodes: tuple[HistoryNode, ...], inputs: InputHistory) -> tuple[HistoryNode, ...]:
        assumed, last = self.recorder.assumed, nodes[-1]
        if last.limited == -math.inf or assumed is None or not last.stands:
            return nodes
        begun = max(len(nodes) - 1 - REMEMBERED, 0)
        at = next((k for k, node in enumerate(nodes) if k > begun and node.waits), None)
        if at is None:
            return nodes
        first, rows = nodes[begun], list[RecordRow]()
        for node in nodes[begun if first.number else begun + 1 :]:
            censored = tuple(each.as_read for each in node.sample.censored if each.since is None)
            rows.append(RecordRow(node.t, np.where(node.mask > 0, node.y - node.feedthrough, np.nan), None, censored))
        unread = assumed.unread(first.t, inputs)
        proven = censored_together(unread, rows, assumed.noise, self.before)
        if proven is None:
            return nodes
        boxed = first._replace(box=proven[0], boxed_until=last.t)
        settled = EstimatorState((*nodes[:begun], boxed, *nodes[begun + 1 : at]), inputs)
        said = {row.t: censored for row, censored in zip(rows, proven[1], strict=True)}
        for node in nodes[at:]:
            means = [each for each in node.sample.censored if each.since is not None]
            censored = tuple(sorted((*means, *said[node.t]), key=lambda each: each.output))
            sample = node.sample._replace(censored=censored) if node.waits else self._resolved(settled, node.sample)
            settled = settled._replace(nodes=(*settled.nodes, self._advance(settled, sample)._replace(until=last.t)))
        return settled.nodes

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

    def _keep_windows(self) -> None:
        """Begin to remember windows; to be called once weights and bounds are set."""
        self._histories = BandCache(self.table, self.bounds.of_sample)
        self._slides = True
        if self.check_spacing is not None and self.constraints.x is not None:
            self._between = CheckPoints(self.loop.table, self.check_spacing)
        self._fixed_prior: Array = self.weights.prior_root @ self.weights.prior_root.T
        self._prior_roots = self.weights.prior_factor.T.copy(), self.weights.prior_factor
        self._worst: tuple[Array | None, float] = (None, 0.0)  # a covariance in units of the prior: its largest value

    def _expect(self, times: Array) -> None:
        kept = np.array([node.t for node in self.state.nodes])
        before = arriving = np.diff(times, prepend=kept[-1])
        gaps = before
        if self.begins == "horizon":
            nodes, start = np.concatenate([kept, times]), times - self.horizon
            inside = (start > kept[0]) & (start < times)
            at = np.searchsorted(nodes, start[inside], side="right") - 1
            arriving = nodes[at + 1] - start[inside]
            gaps = np.concatenate((before, start[inside] - nodes[at], arriving))
        self.table.known(gaps[gaps > 0].tolist())
        if self._slides:
            self.table.prepare(before[before > 0].tolist(), arriving[arriving > 0].tolist(), self._fixed_prior)

    def _start(self, state: EstimatorState, t: float) -> WindowStart:
        """Return where the window of a solve at t begins, with the online estimate there.

        Numbers that overflow are looked at, so that numpy need not tell of them.
        """
        nodes, s = state.nodes, t - self.horizon
        slack = SAME_TIME_ULPS * math.ulp(max(abs(t), self.horizon))
        given = nodes[0].sample.y is None
        if given and s <= nodes[0].t + slack:
            return WindowStart(nodes[0].t, nodes[0].x, nodes[0].x, nodes[0].beta, None, nodes[1:])
        anchor = state.node_before(s + slack)
        node = nodes[anchor]
        closed = self.weights.cost == "paper" and node.sample.y is not None
        if self.begins == "sample" or abs(node.t - s) <= slack:
            x, Y, beta, s = node.x, node.Y, node.beta, node.t
        else:
            first = nodes[anchor + 1].t if anchor + 1 < len(nodes) else t
            self.table.known((t - nodes[-1].t, s - node.t, first - s))  # what may be new in this window, in one batch
            x, Y, beta = self._propagated_to(state, node, s)
            closed = False
        inside = nodes[anchor if closed else anchor + 1 :]
        if self.arrival_cost == "filtered":
            return WindowStart(s, x, node.x, beta, covariance_root(Y), inside)
        if not math.isfinite(beta):
            return WindowStart(s, x, node.x, beta, None, inside)
        if self._worst[0] is not Y:
            left, right = self._prior_roots
            self._worst = Y, float(lapack.dsyev(left.dot(Y).dot(right), 0)[0][-1])
        return WindowStart(s, x, node.x, self._worst[1] * beta, None, inside)

    def _propagated_to(self, state: EstimatorState, node: HistoryNode, s: float) -> tuple[Array, Array, float]:
        """Return state, covariance and radius of the prior at s; where the discount overflows, undiscounted."""
        flow, drift = self.loop.between(state, node.t, s)
        x, Y, beta = self.loop.propagated(node, flow, drift)
        if is_finite(x) and is_finite(Y):
            return x, Y, beta
        self.loop.refuse_overflow(flow, s, x)
        if not np.isfinite(Y).all() and self.arrival_cost != "filtered":
            x, Y, beta = self.loop.ahead(node, flow, drift)
        self.loop.refuse_overflow(flow, s, Y)
        return x, Y, beta

    def _slid_window(
        self, state: EstimatorState, start: WindowStart, new: IncomingNode
    ) -> tuple[HistoryNode | None, SlidingBand | None]:
        """Return what the window says, from what is remembered of it; None where that is no use or a constraint acts.

        And what is remembered now, for the node to come. Numbers that overflow are looked at, so that numpy need not
        tell of them.
        """
        initial, nodes, s, t = None, state.nodes, start.s, new.t
        if not self._slides or t <= s:
            return None, None
        first = len(nodes) - len(start.inside)
        while first < len(nodes) and nodes[first].t <= s:
            initial, first = nodes[first], first + 1
        prior = self._fixed_prior if start.root is None else start.root @ start.root.T
        held = self._histories.of(nodes, first)
        if held is None:
            return None, None
        sliding, at = held
        if first == len(nodes):
            gap = self.loop.between(state, s, t)
            reference = gap[0].F.dot(start.x) + gap[1]
        else:
            gap = self.loop.between(state, s, nodes[first].t)
            reference = new.flow.F.dot(nodes[-1].x)
            if new.drift is not self.table.no_drift:
                reference += new.drift
        if not sliding.append(new, new.flow, reference, predicted=first < len(nodes)):
            return None, None
        optimum = sliding.solve(at, start, prior, initial, gap, self.constraints.active)
        if optimum is None:
            return None, sliding
        x, gains, cost, above, energy, size, path = optimum
        if path is not None:
            if not self.constraints.hold(path, lambda: sliding.samples(at, initial)):
                return None, sliding
            if self._between is not None and self.constraints.x is not None:
                points = self._between.states(state, [s, *(node.t for node in nodes[first:])], path)
                if points is None or not all_inside(self.constraints.x, points):
                    return None, sliding
        terms = scaled_bound(start.energy, math.exp(self.weights.eta * (s - t))) + self.bounds.over(t - s)
        terms += rounding(size) + energy
        verdict = judged(self.weights, terms, cost - DUAL_MARGIN * max(above, DRIFT * terms), nodes[-1])
        _, status, sound, _ = verdict
        if status == "bounds disproved" and nodes[-1].stands:
            return None, sliding
        sliding.cancelling |= sound and above > terms
        Y, precision = gains.Y, gains.precision
        node = self.recorder.node(state, new, s, x, Y, verdict, "banded", cost=cost, precision=precision)
        return node, sliding

    def _judged(
        self, state: EstimatorState, new: IncomingNode, terms: float, dual: float, held: float = 0.0
    ) -> SolveVerdict:
        """Return what a solve is worth; bounds are disproved only by more than the prediction's rounding may cost."""
        last, flow, drift = state.last, new.flow, new.drift
        verdict = judged(self.weights, terms, dual, last, held)
        if verdict[1] == "bounds disproved":
            with np.errstate(over="ignore", invalid="ignore"):
                x, Y, _ = self.loop.propagated(last, flow, drift)
            verdict = judged(self.weights, terms, dual, last, held + in_units_of(Y, passed(last, flow, drift, x))[0])
        return verdict

    def _mean_noise_energy(self, window: EstimationWindow, end: int | None = None) -> float:
        """A bound on what the noise of the means costs: of correlated outputs, together with the readings beside.

        With `end` only of those that end at that node.
        """
        if window.means is None:
            return 0.0
        masks = window.means.masks
        if not self.weights.diagonal_noise:
            masks = masks + window.masks * masks.any(axis=1, keepdims=True)
        if end is not None:
            masks = masks * (np.arange(len(masks)) == end)[:, None]
        return window.total(self.bounds.of_samples(masks))

    def _limited(self, new: IncomingNode) -> IncomingNode:
        """Return a sample with what C x lies between, as limits of detection say: y = C x + D u + v, |v| bounded."""
        sample, feedthrough = new.sample, new.feedthrough
        if not sample.censored or self.bounds.v is None or all(each.since is not None for each in sample.censored):
            return new
        noise = np.broadcast_to(self.bounds.v, feedthrough.shape)
        found = np.array([np.full(feedthrough.size, -np.inf), np.full(feedthrough.size, np.inf)])
        for each in sample.censored:
            if each.since is None:
                i = each.output
                found[0, i] = max(found[0, i], each.lower - feedthrough[i] - noise[i])
                found[1, i] = min(found[1, i], each.upper - feedthrough[i] + noise[i])
        torn = found[0] > found[1]  # what two limits contradict, the interval tells
        found[0, torn], found[1, torn] = -np.inf, np.inf
        return new._replace(limits=found) if np.isfinite(found).any() else new

    @cached_property
    def _integrals(self) -> IntegralFlows:
        return IntegralFlows(self.weights, self.table.constant_w)

    def _window(self, state: EstimatorState, start: WindowStart, new: IncomingNode | HistoryNode) -> EstimationWindow:
        """Return the window problem from `start` to a sample."""
        t, zero = new.t, np.zeros(self.plant.n_outputs)
        inside = [node for node in start.inside if node.t > start.s]
        first: IncomingNode | HistoryNode | None = next((node for node in start.inside if node.t <= start.s), None)
        later: list[IncomingNode | HistoryNode] = [*inside, new] if t > start.s else [*inside]
        first = first if t > start.s else new
        times = [start.s, *(node.t for node in later)]
        rows = [(zero, zero, zero) if first is None else (first.y, first.mask, first.feedthrough)]
        rows += [(node.y, node.mask, node.feedthrough) for node in later]
        flows, drift, reference = self._path(state, start, inside, times)
        came = [*(node.sample for node in inside), new.sample]
        read = [(node.t, *mean) for node in came for mean in means_of(node) if mean[1] >= start.s]
        begun = sorted({since for _, _, since, _ in read} - set(times))
        checked = self.check_spacing is not None and self.constraints.x is not None
        if checked or begun:
            times, rows, flows, drift, reference = self._refined(state, times, rows, reference, begun, checked)
        y, masks, feedthrough = (np.array(column) for column in zip(*rows, strict=True))
        censored = {node.t: node.limits for node in start.inside if node.limits is not None}
        censored |= {} if new.limits is None else {t: new.limits}
        free = np.array([np.full(self.plant.n_outputs, -np.inf), np.full(self.plant.n_outputs, np.inf)])
        limits = np.array([censored.get(at, free) for at in times]) if censored else None
        root = self.weights.prior_root if start.root is None else start.root
        window = EstimationWindow(
            weights=self.weights, times=np.array(times), flows=flows, reference=reference, drift=drift, y=y,
            masks=masks, feedthrough=feedthrough, prior_root=root, limits=limits,
        )  # fmt: skip
        if not read:
            return window
        at = {t: j for j, t in enumerate(times)}
        readings = [MeanReading(output, at[since], at[t], value) for t, output, since, value in read]
        means = self._integrals.means(state, times, window.reference, window.residual, window.masks, readings)
        return replace(window, means=means)

    def _path(
        self, state: EstimatorState, start: WindowStart, inside: list[HistoryNode], times: list[float]
    ) -> tuple[list[GapFlow], Array, Array]:
        """Return flows and drifts between the nodes, and the online estimates as reference."""
        n = self.plant.n_states
        if len(times) == 1:
            return [], np.zeros((0, n)), start.x[None]
        flows = self.table.get([b - a for a, b in pairwise(times)])
        drift = [state.drift(self.table, times[0], times[1]), *(node.drift for node in inside[1:])]
        if inside:
            drift.append(state.drift(self.table, times[-2], times[-1]))
        known = [start.x, *(node.x for node in inside)]
        known.append(flows[-1].F @ known[-1] + drift[-1])
        return flows, np.array(drift), np.array(known)

    def _refined(
        self,
        state: EstimatorState,
        times: list[float],
        rows: list[tuple[Array, Array, Array]],
        reference: Array,
        also: Sequence[float],
        checked: bool,
    ) -> tuple[list[float], list[tuple[Array, Array, Array]], list[GapFlow], Array, Array]:
        """Put unmeasured nodes between those given: at times that are named, and `checked`, `check_spacing` apart."""
        zero = np.zeros(self.plant.n_outputs)
        edges, data, path, drift = [times[0]], [rows[0]], [reference[0]], []
        for j, t in enumerate(times[1:]):
            between = {s for s in also if times[j] < s < t}
            if checked and self.check_spacing is not None:
                count = pieces(t - times[j], self.check_spacing)
                between |= {times[j] + k * (t - times[j]) / count for k in range(1, count)}
            for when in [*sorted(between), t]:
                last = when == t
                drift.append(state.drift(self.table, edges[-1], when))
                flow = self.table.one(when - edges[-1])
                path.append(reference[j + 1] if last else flow.F @ path[-1] + drift[-1])
                edges.append(when)
                data.append(rows[j + 1] if last else (zero, zero, zero))
        flows = self.table.get([b - a for a, b in pairwise(edges)])
        return edges, data, flows, np.array(drift).reshape(-1, self.plant.n_states), np.array(path)
