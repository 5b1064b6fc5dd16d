"""The continuous-discrete Kalman filter at irregular times, discounted or not, and its fixed-interval smoother.

And the set-membership estimator, a filter whose estimates lie in the centre of what data and bounds leave possible.
"""

from __future__ import annotations

from copy import copy

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from sampling_design.accuracy.readings import RecordRow
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.constraints import Constraints, WindowConstraints, narrowed
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, build_weights
from sampling_design.estimators.gap_flows.flows import FlowTable
from sampling_design.estimators.online.estimate import Contradiction
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.online.evidence import REMEMBERED
from sampling_design.estimators.online.history import EstimatorState, HistoryNode, IncomingNode, WindowStart
from sampling_design.estimators.online.in_order import listed, triple
from sampling_design.estimators.online.open_loop import ErrorBounds, OpenLoop, Recorder
from sampling_design.estimators.online.schedule_watch import ScheduleClaim
from sampling_design.estimators.online.verdict import (
    ROUNDING,
    covariance_precision,
    overflowed,
    represented,
    rounding_energy,
    scaled_bound,
    too_large,
)
from sampling_design.estimators.window.smoother import smooth
from sampling_design.estimators.window.window_problem import means_of
from sampling_design.estimators.windowed_estimator import WindowedEstimator
from sampling_design.numerics.filtering import covariance_root, root_update
from sampling_design.numerics.linalg import symmetrise
from sampling_design.observability.count.functional import part_for
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.declarations import below
from sampling_design.records.vector_bounds import VectorBound

NO_CLAIM = "No a-priori claim: a filter, not the estimator of the certificate."


class KalmanFilter(WindowedEstimator):
    """The filter of all samples since the prior, without constraints.

        min  e^{-eta t}|x(0) - prior|^2_P2 + int e^{-eta(t-tau)}|w|^2_Qw + sum e^{-eta(t-tau)}|y - Cx - Du|^2_R~

    With eta = 0, and P2, Qw, R~ the inverses of the prior's covariance, the disturbance's intensity and the noise's
    covariance, this is the continuous-discrete Kalman filter; with eta > 0 its discounted form, which is what a
    moving horizon estimator without constraints and with an endless horizon computes.

    Parameters
    ----------
    plant : Plant
    certificate : Certificate, optional
        Brings P2, Qw, R, Qv and eta.
    cost : CostFunction, optional
        Weights and rate instead of the certificate's; its form and arrival are those above.
    prior, prior_time, w_bound, v_bound, initial_error, input_side, of
        As for `MovingHorizonEstimator`.
    maximum_delay : float
        How far back a late sample may lie [time]; snapshots are kept that long. Default 0.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape or sign, or the cost is the paper's.

    Notes
    -----
    A composite sample (`CompositeReading`) is an exact row: the samples since it began are filtered again with the
    integral of the output beside the state, so that they must be kept (`maximum_delay`; with bounds on w and v the last
    24 are).
    Limits of detection are no Gaussian readings: state and ellipsoid leave them out; `interval`, `radii` and `centred`
    use them.

    Examples
    --------
    >>> cost = CostFunction(P2=[[1.0]], Qw=[[1e9]], R=[[2.0]], Qv=[[2.0]])
    >>> filter = KalmanFilter(Plant([[0.0]], [[1.0]]), cost=cost)
    >>> [round(float(filter.update(t, [3.0]).x[0]), 6) for t in (1.0, 2.0)]
    [1.5, 2.0]
    """

    def __init__(
        self,
        plant: Plant,
        certificate: SampledCertificate | None = None,
        *,
        cost: CostFunction | None = None,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        w_bound: VectorBound = None,
        v_bound: VectorBound = None,
        initial_error: VectorBound = None,
        input_side: str = "right",
        maximum_delay: float = 0.0,
        of: Wanted = None,
    ):
        plant, cost = part_for(plant, of), CostFunction() if cost is None else cost
        if cost.form == "paper":
            raise ArgumentError(
                '`cost` must have the form "certificate" here: a filter keeps no window of the paper\'s.'
            )
        given = ErrorBoundArguments(w_bound=w_bound, v_bound=v_bound, initial_error=initial_error)
        weights = build_weights(plant, certificate, cost, given)
        self.memory = self.maximum_delay = checks.nonnegative("maximum_delay", maximum_delay)
        self.horizon = np.inf
        bounds = ErrorBounds(weights, w_bound, v_bound, initial_error)
        loop = OpenLoop(FlowTable(weights), bounds)
        self.prepare(Recorder(loop, ScheduleClaim(NO_CLAIM), bounds.assumptions()), input_side)
        self.start(prior, prior_time)

    def start(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> None:
        """Forget all samples, and what they contradicted, and start again from a prior.

        Raises ArgumentError as `initial_state`.
        """
        super().start(prior, prior_time)
        self._begun = self.state.last  # the oldest node that is kept may be a later one, known otherwise

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # what overflows is looked at
    def _advance(self, state: EstimatorState, sample: RecordRow) -> HistoryNode:
        new, last, weights = self._incoming(state, sample), state.last, self.weights
        y, mask, feedthrough, flow, drift = new.y, new.mask, new.feedthrough, new.flow, new.drift
        x, Y, before = self.loop.propagated(last, flow, drift)
        self.loop.refuse_overflow(flow, sample.t, x, Y)
        root = weights.at(mask).y_root
        H, innovation = root.dot(self.plant.C), root.dot(y - feedthrough - self.plant.C.dot(x))
        begun = state.nodes[0].t
        if means_of(sample):
            return self._with_means(state, new)
        own = self.bounds.of_sample(mask)
        terms = before + own
        if too_large(innovation):
            residual = np.where(mask > 0, y - feedthrough - self.plant.C @ x, 0.0)
            verdict, note = overflowed(self.weights, state.last, sample, residual, terms)
            x, Y, beta = self.loop.ahead(last, flow, drift)
            return self.recorder.node(state, new, begun, x, Y, (beta, *verdict[1:]), "filter", note)
        # an innovation is the difference of what was read and what was predicted, and has no other margin here
        terms += rounding_energy(self.weights, abs(y) + abs(self.plant.C).dot(abs(x)), x)
        deviation, step, weighted_innovation = root_update(covariance_root(Y), H, innovation)
        Y, x = freeze(symmetrise(deviation.dot(deviation.T))), freeze(x + step)
        cost = float(weighted_innovation.dot(weighted_innovation))
        past = 0.0 if last.sample.y is None else last.cost / flow.growth
        verdict = self._judged(state, new, terms, cost * (1 - ROUNDING))
        if "bounds disproved" in verdict and last.stands:
            found = self._contradiction(sample, last.number + 1, (weighted_innovation, cost), (terms, own))
            verdict = *verdict[:3], found
        half, flag = lapack.dtrtri(deviation, 1)
        precision = None if flag else covariance_precision(Y, half.T)
        return self.recorder.node(state, new, begun, x, Y, verdict, "filter", cost=past + cost, precision=precision)

    def _with_means(self, state: EstimatorState, new: IncomingNode) -> HistoryNode:
        """Return the node of a composite sample: from the last node before anything that it overlaps, all at once."""
        nodes, last, sample = state.nodes, state.last, new.sample
        since = min(begun for _, begun, _ in means_of(sample))
        at = state.node_before(since)
        for node in reversed(nodes):
            begun = min((each for _, each, _ in means_of(node.sample)), default=np.inf)
            if node.t > nodes[at].t and nodes[0].t <= begun < nodes[at].t:
                at = state.node_before(begun)
        first = nodes[at]
        start = WindowStart(first.t, first.x, first.x, first.beta, covariance_root(first.Y), nodes[at + 1 :])
        window = self._window(state, start, new)
        solution, passed = smooth(window), float(window.discount[0])
        terms = (
            scaled_bound(first.beta, passed)
            + self.bounds.over(sample.t - first.t)
            + rounding_energy(self.weights, window.y, window.reference)
        )
        terms += window.total(self.bounds.of_samples(window.masks)) + self._mean_noise_energy(window)
        verdict = self._judged(state, new, terms, solution.dual, solution.held)
        if "bounds disproved" in verdict and last.stands:
            means, mask = means_of(sample), np.zeros((1, self.plant.n_outputs))
            mask[0, [output for output, _, _ in means]] = 1.0
            room = float(self.bounds.of_samples(mask)[0]) or terms
            factor = float(np.sqrt((solution.dual - terms + room) / room)) if room > 0 else np.inf
            name = self.plant.outputs.names[means[0][0]]
            verdict = *verdict[:3], Contradiction(last.number + 1, sample.t, name, factor)
        past = 0.0 if first.sample.y is None else first.cost * passed
        x, Y = freeze(solution.nodes[-1].copy()), freeze(symmetrise(solution.covariance))
        return self.recorder.node(state, new, nodes[0].t, x, Y, verdict, "filter", cost=past + solution.cost)

    def _contradiction(
        self, sample: RecordRow, number: int, innovation: tuple[Array, float], bounds: tuple[float, float]
    ) -> Contradiction:
        """Return what is known of the sample that made the innovations cost more than the bounds allow."""
        (half, cost), (terms, own) = innovation, bounds
        measured = np.isfinite(sample.y)
        output = int(np.argmax(np.where(measured, np.abs(half), -1.0)))
        rest = np.where(np.arange(measured.size) == output, 0.0, measured)
        # a bound on the norm is that of the sample: what one output leaves of it is all of it
        alone = own - float(self.bounds.of_samples(rest[None])[0])
        room = alone if alone > 0 else own
        with np.errstate(divide="ignore", over="ignore"):
            factor = float(np.sqrt((cost - terms + room) / np.float64(room)))
        return Contradiction(number, sample.t, self.plant.outputs.names[output], factor)

    def smooth(self, record: object) -> EstimateRecord:
        """Return the estimates at all samples given all samples (fixed-interval smoother); the filter stays as it is.

        Parameters
        ----------
        record : Measurements, DataFrame or iterable of (t, y, u)
            As for `run`. In order of time, from the filter's prior on, whatever it has taken in since.

        Returns
        -------
        EstimateRecord
            `covariance` in units of the last sample (discounted to it), so that the one `radius` of the
            last sample holds for all: |x(t_j) - x_j|^2 in the inverse covariance is at most the radius. `radii` are
            those of intervals that twelve samples before and after prove, no wider than the ellipsoid.

        Raises
        ------
        ArgumentError
            As `run`, or if the record is so long that its discount falls below all numbers.
        """
        fresh = copy(self)
        fresh.memory = np.inf
        fresh.state = fresh.initial_state(self._begun.x, self._begun.t)
        samples, origin = listed(record, self.plant, self.clock_origin)
        for item in samples:
            fresh.update(*triple(item))
        nodes = fresh.state.nodes
        if len(nodes) == 1:
            return EstimateRecord.collect(self.plant, [])
        first, last = nodes[0], nodes[-1]
        start = WindowStart(first.t, first.x, first.x, first.beta, None, nodes[1:-1])
        window = fresh._window(fresh.state, start, last)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what overflows is looked at
            smoothed, latest = smooth(window), fresh.recorder.of_node(fresh.state, len(nodes) - 1)
            covariances, estimates = smoothed.spread.covariances(), []
        if not np.isfinite(smoothed.nodes).all() or not np.isfinite(covariances).all():
            raise ArgumentError(
                f"`record` must be shorter at the rate eta = {below(self.weights.eta)}: over {last.t - first.t:.6g} "
                f"{self.plant.time_unit} its discount falls below all numbers. Smooth it in parts (`between`)."
            )
        at = {t: j for j, t in enumerate(window.times.tolist())}
        for k, node in enumerate(nodes[1:], 1):
            j = at[node.t]
            known = min(k + REMEMBERED // 2, len(nodes) - 1)
            covariance, radius, _ = represented(covariances[j], abs(smoothed.nodes[j]), latest.radius)
            entries: dict[str, object] = {
                "t": node.t, "x": freeze(smoothed.nodes[j]), "covariance": freeze(covariance), "radius": radius,
                "status": latest.status, "certified": latest.certified, "note": latest.note, "cost": latest.cost,
                "engine": smoothed.engine, "window_start": first.t,
            }  # fmt: skip
            estimates.append(fresh.recorder.proven(fresh.state, known, entries))
        return EstimateRecord.collect(self.plant, estimates, origin)


class SetMembershipEstimator(KalmanFilter):
    """The centre of the interval of every state: no other estimate has a smaller largest error.

        x_i = (lower_i + upper_i)/2,    |x_i(t) - x_i| <= radii_i = (upper_i - lower_i)/2

    Parameters
    ----------
    plant : Plant
    constraints : Constraints, optional
        What else is known of x, v and w.
    w_bound, v_bound : float or array
        Bounds on |w(t)| and |v|: a number bounds the Euclidean norm, a vector each entry.
    prior, prior_time, input_side, maximum_delay, of
        As for `KalmanFilter`.
    initial_error : float or array, optional
        Bound on |x - prior|; default: nothing is known, and states are unbounded until the samples show them.

    Raises
    ------
    ArgumentError
        If a bound is missing or has the wrong shape or sign.

    Notes
    -----
    *Claim.* If w, v and the first error keep their bounds, the state lies in the box of half-widths `radii`; the
    ellipsoid is one around that box. Where the data leave a state unbounded it is that of a filter and its radius
    infinite. *Method.* Two cone programs for each state and sample (`accuracy/`): some milliseconds.

    References
    ----------
    Milanese and Tempo, Optimal algorithms theory for robust estimation and prediction (1985).

    Examples
    --------
    >>> walk = SetMembershipEstimator(Plant([[0.0]], [[1.0]]), w_bound=0.1, v_bound=0.3)
    >>> [round(float(walk.update(t, [y]).x[0]), 4) for t, y in ((0.0, 1.0), (1.0, 1.5))]
    [1.0, 1.3]
    >>> walk.predict(2.0).radii.round(4)
    array([0.2])
    """

    def __init__(
        self,
        plant: Plant,
        *,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        constraints: Constraints | None = None,
        w_bound: VectorBound = None,
        v_bound: VectorBound = None,
        initial_error: VectorBound = None,
        input_side: str = "right",
        maximum_delay: float = 0.0,
        of: Wanted = None,
    ):
        missing = [name for name, bound in (("w_bound", w_bound), ("v_bound", v_bound)) if bound is None]
        if missing:
            raise ArgumentError(f"`{missing[0]}` is missing: without it no set is bounded. Give 0 where there is none.")
        super().__init__(
            plant,
            prior=prior,
            prior_time=prior_time,
            w_bound=w_bound,
            v_bound=v_bound,
            initial_error=initial_error,
            input_side=input_side,
            maximum_delay=maximum_delay,
            of=of,
        )
        assumed, given = self.recorder.assumed, Constraints() if constraints is None else constraints
        assert assumed is not None
        narrow = narrowed(assumed, WindowConstraints(self.table, given))
        self.prepare(Recorder(self.loop, self.claim, narrow, centred=True), input_side)
        self.start(prior, prior_time)
