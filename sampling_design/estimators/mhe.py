"""The sample-based moving horizon estimator: solved when a measurement arrives, open loop in between."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import RecordRow
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.constraints import Constraints, WindowConstraints, narrowed
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.constraints.qp import problem_as_written, solve_constrained
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, build_weights
from sampling_design.estimators.gap_flows.flows import FlowTable
from sampling_design.estimators.online.estimate import Contradiction
from sampling_design.estimators.online.evidence import SUSPECTS
from sampling_design.estimators.online.history import EstimatorState, HistoryNode, IncomingNode, WindowStart
from sampling_design.estimators.online.open_loop import ErrorBounds, OpenLoop, Recorder
from sampling_design.estimators.online.schedule_watch import ScheduleClaim, choose_horizon
from sampling_design.estimators.online.verdict import (
    CONTRADICTION,
    overflowed,
    rounding_energy,
    scaled_bound,
    too_large,
)
from sampling_design.estimators.window.smoother import smooth
from sampling_design.estimators.window.window_problem import EstimationWindow, WindowEstimate, means_of
from sampling_design.estimators.windowed_estimator import WindowedEstimator
from sampling_design.observability.count.functional import part_for
from sampling_design.plants.functional import RowArguments
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.jitter import Timing

if TYPE_CHECKING:
    from sampling_design.estimators.constraints.qp import Problem


CLOSED_FORM = ("banded", "square root")  # engines that say that no constraint was active

LEFT_OUT = "A composite sample began before the window: it counts for the interval alone."
OVERFLOWN = "What the window holds grows beyond double precision: open loop instead."


class MovingHorizonEstimator(WindowedEstimator):
    """Moving horizon estimation from rare, irregular samples.

    At a sample at t the window problem over (t - M_t, t], M_t = min(t, M), is solved,

        min  e^{-eta M_t}|x(t-M_t) - xhat(t-M_t)|^2_P2 + int e^{-eta(t-tau)}|w|^2_Qw
                 + sum e^{-eta(t-tau)}|y - Cx - Du|^2_R~

    under the given constraints; in between the estimate runs open loop. The prior is the estimate that was
    valid online at t - M_t, also where no sample lies there.

    Parameters
    ----------
    plant : Plant
    certificate : Certificate, optional
        Brings weights, rate, horizon and the schedule for which they prove convergence.
    horizon : float, optional
        M [time]. Default max(d_max, ln(4 lam)/eta), for the paper's cost max(d_max, 2 ln(4 lam_samples)/eta). At most
        240/eta is followed: what lies further back has no weight.
    cost : CostFunction, optional
        Weights and rate instead of the certificate's, the cost's form, and what the prior weighs.
    prior : (n,) array, optional
        Estimate at `prior_time` before any sample; default 0.
    constraints : Constraints, optional
        What is known of x, y, v and w, and what solves a window where that is active; see there.
    w_bound, v_bound, initial_error : float or array, optional
        Bounds on |w(t)|, |v| and |x - prior|: a number bounds the Euclidean norm, a vector each entry. All
        three are needed for a radius; the first two default to what `constraints` on w and v allow. With them, and
        without `cost`, `run` returns estimates in the middle of what data and bounds allow; `update` returns what
        minimises the cost, some ten to a hundred times faster.
    timing_tolerance : float, or pair (early, late)
        How early or late [time] a sample may be and still count as on schedule, beyond the rounding of the times and
        what the certificate itself allows (`Jitter`). Default 0. What the certificate of exact times is worth then is
        what `robustness` says of such deviations.
    schedule_zero : float
        What the clock of the samples [time] shows at time 0 of the certificate's schedule. Default 0.
    input_side : "right" or "left"
        Which input enters y at a sample where u jumps: the one that holds from then on, or the one before.
    maximum_delay : float, optional
        How far back a late sample, a correction or a withdrawal may lie [time]. Default: the horizon.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows themselves (`functional_plant`). What else
        is given, and what is returned, is of the part that they need, `estimator.plant`, whose first states they are.
        Default: all states.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape or sign, no horizon can be had, a constraint set is empty, or the prior
        violates the state constraints.

    Warns
    -----
    GuaranteeWarning
        If the horizon is not longer than the certificate allows.

    Notes
    -----
    *Claim.* If w, v and the initial error keep their bounds and the truth meets the constraints, then
    |x - xhat|^2_Pi <= radius for every estimate whose `certified` is true, for any weights and any times.
    *Method.* The problem over functions w is reduced exactly to the states at the samples; without active
    constraints it is solved in closed form, else by an active-set or a conic solver whose answer is
    checked by a dual bound, which also enters the radius. *Numerical aspects.* Unknown is the deviation from the
    online estimates; singular or ill-conditioned noise Gramians are used in factor form.

    Limits of detection (`BelowDetection`, `AboveRange`) are constraints on C x at their sample, the noise bound added,
    which the truth keeps. Composite samples (`CompositeReading`) are exact rows of the window in which their interval
    lies whole, the disturbance inside it taken along; a limit on a mean enters `interval`, `radii` and `centred` only.

    References
    ----------
    The paper, Section IV and Theorem 9; the window and its arrival cost: Rao, Rawlings and Lee 2001; Rao, Rawlings and
    Mayne 2003.

    Examples
    --------
    >>> from sampling_design import CostFunction, Plant
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 2.0}
    >>> mhe = MovingHorizonEstimator(plant, horizon=5.0, cost=CostFunction(eta=0.2), **bounds)
    >>> truth = lambda t: plant.transition(t) @ [1.0, 0.0]
    >>> estimates = [mhe.update(t, plant.C @ truth(t)) for t in (0.4, 1.9, 2.6, 4.4, 5.2, 7.1)]
    >>> all(e.certified and e.holds(truth(e.t)) for e in estimates)
    True
    >>> mhe.predict(8.0).holds(truth(8.0))
    True
    """

    def __init__(
        self,
        plant: Plant,
        certificate: SampledCertificate | None = None,
        *,
        horizon: float | None = None,
        cost: CostFunction | None = None,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        constraints: Constraints | None = None,
        w_bound: VectorBound = None,
        v_bound: VectorBound = None,
        initial_error: VectorBound = None,
        timing_tolerance: Timing = 0.0,
        schedule_zero: float = 0.0,
        input_side: str = "right",
        maximum_delay: float | None = None,
        **rows: Unpack[RowArguments],
    ):
        cost_given, cost = cost is not None, CostFunction() if cost is None else cost
        plant = part_for(plant, rows.get("of"))
        self.certificate, self.arrival_cost, self.begins = certificate, cost.arrival, cost.begins
        self.horizon, note = choose_horizon(certificate, horizon, cost, "paper" if cost.form == "paper" else "improved")
        weighed = ErrorBoundArguments(w_bound=w_bound, v_bound=v_bound, initial_error=initial_error)
        weights = build_weights(plant, certificate, cost, weighed, self.horizon)
        given = Constraints() if constraints is None else constraints
        table = FlowTable(weights, given.w_model == "constant" and given.w is not None)
        covered = None if certificate is None else certificate.covers
        claim = ScheduleClaim(note, covered, plant.time_unit, timing_tolerance, schedule_zero)
        self.constraints = sets = WindowConstraints(table, given)
        self.engine = given.engine
        if self.engine == "active set" and sets.has_balls:
            raise ArgumentError('`engine` = "active set" knows no norm balls: use "auto" or "conic".')
        self.check_spacing = given.check_spacing
        self.keep_for_late(maximum_delay)
        w, v = _from_set(sets.w) if w_bound is None else w_bound, _from_set(sets.v) if v_bound is None else v_bound
        bounds = ErrorBounds(weights, w, v, initial_error)
        if table.constant_w:
            bounds.note = "No radius: a constant disturbance between nodes need not contain the true one."
        assumed = bounds.assumptions()
        self.centres = assumed is not None and not cost_given
        self.prepare(Recorder(OpenLoop(table, bounds), claim, assumed and narrowed(assumed, sets)), input_side)
        self._keep_windows()
        self.state = self.initial_state(prior, prior_time)

    def initial_state(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> EstimatorState:
        """Return the state before any sample: `prior` (default 0) at `prior_time`, with weight P2.

        Raises
        ------
        ArgumentError
            If the prior has another length or lies outside `constraints.x`.
        """
        state = super().initial_state(prior, prior_time)
        outside = -np.inf if self.constraints.x is None else self.constraints.x.excess(state.last.x)
        if outside > 0:
            raise ArgumentError(f"`prior` must lie in `constraints.x`, got one outside by {outside:.6g}.")
        return state

    def problem(self, t: float | None = None) -> Problem:
        """Return the optimisation behind the estimate at a sample, to look at, to change, and to solve otherwise.

        Parameters
        ----------
        t : float, optional [time]
            Of a sample of the last horizon; default the latest.

        Returns
        -------
        cvxpy.Problem
            In `var_dict` x0, x1, ... are the states at the window's nodes (its start and its samples), omega1, ... the
            whitened disturbances between them and v0, ... the noises at the samples, in physical units; in `param_dict`
            are prior and y0, ..., with the values that the estimator took. Its least value is the estimate's `cost`.

        Raises
        ------
        ArgumentError
            If there is no sample at t, or it lies more than a horizon before the latest.
        MissingExtraError
            If cvxpy is not installed (extra `modelling`).

        Examples
        --------
        >>> from sampling_design import Plant
        >>> mhe = MovingHorizonEstimator(Plant([[0.0]], [[1.0]]), horizon=3.0, cost=CostFunction([[1.0]], eta=0.0))
        >>> estimate, problem = mhe.update(1.0, [0.6]), mhe.problem()
        >>> print(f"{problem.solve(solver='CLARABEL'):.6f} {estimate.cost:.6f} {problem.var_dict['x1'].value[0]:.6f}")
        0.120000 0.120000 0.400000
        """
        nodes = self.state.nodes
        held = [node.t for node in nodes if node.sample.y is not None and node.t >= nodes[-1].t - self.horizon]
        if not held:
            raise ArgumentError("`problem` is of a sample of the last horizon, and there is none: `update` takes one.")
        when = held[-1] if t is None else checks.number("t", t)
        if when not in held:
            near = min(held, key=lambda time: abs(time - when))
            raise ArgumentError(
                f"`t` must be the time of a sample of the last horizon, got {when!r}: the nearest is {near!r}."
            )
        at = self.state.node_before(when)
        state = EstimatorState(nodes[:at], self.state.inputs)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            start = self._start(state, when)
        return problem_as_written(self._window(state, start, nodes[at]), self.constraints)

    def _solve(self, window: EstimationWindow) -> WindowEstimate:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what overflows is not finite
            free = smooth(window)
            if not (math.isfinite(free.cost) and np.isfinite(free.covariance).all()):
                return replace(free, status="solver failed", note=OVERFLOWN)
            limited = self.constraints.active or window.limits is not None
            return solve_constrained(window, self.constraints, free, self.engine) if limited else free

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # what overflows is looked at
    def _advance(self, state: EstimatorState, sample: RecordRow) -> HistoryNode:
        t = sample.t
        start = self._start(state, t)
        new = self._limited(self._incoming(state, sample))
        free = not sample.censored and not (start.inside and state.nodes[-1].limited >= start.inside[0].t)
        node, band = self._slid_window(state, start, new) if free else (None, None)
        if node is None:
            node = self._solved(state, start, new)
        if band is not None:
            self._histories.keep(node, band)
        return node

    def _solved(self, state: EstimatorState, start: WindowStart, new: IncomingNode) -> HistoryNode:
        """Return what the window says, put together and solved as a whole."""
        last, sample, flow, drift, engine, cost = state.last, new.sample, new.flow, new.drift, "", np.nan
        with np.errstate(over="ignore", invalid="ignore"):
            self.loop.refuse_overflow(flow, sample.t, flow.F @ last.x + drift)
        window = self._window(state, start, new)
        terms = scaled_bound(start.energy, float(window.discount[0])) + self.bounds.over(sample.t - start.s)
        if too_large(window.weighted(window.residual)):
            terms += window.total(self._kept_energy(window.masks))
            (beta, status, sound, own), note = overflowed(self.weights, last, sample, window.residual[-1], terms)
        else:
            terms += rounding_energy(self.weights, window.y, window.reference) + self._mean_noise_energy(window)
            if window.means is not None:
                terms += rounding_energy(self.weights, window.means.y, window.reference)
            solution = self._solve(window)
            engine, note = solution.engine, solution.note
            if not note and any(since < start.s for _, since, _ in means_of(sample)):
                note = LEFT_OUT
            x, Y = solution.nodes[-1].copy(), solution.covariance
            status, sound, own = solution.status, last.stands, last.contradiction
            if status == "ok":
                # without an active constraint the cost is the one without v; else the truth has a v of its own
                kept = self.bounds.of_samples if solution.engine in CLOSED_FORM else self._kept_energy
                terms += window.total(kept(window.masks))
                beta, status, sound, own = self._judged(state, new, terms, solution.dual, solution.held)
                cost = solution.cost
                if status == "bounds disproved" and last.stands:
                    numbers = {node.t: node.number for node in state.nodes} | {sample.t: last.number + 1}
                    own = self._contradiction(window, terms, solution.dual, numbers)
        if np.isnan(cost):
            x, Y, beta = self.loop.ahead(last, flow, drift)
            self.loop.refuse_overflow(flow, sample.t, Y)
            sound = sound and status == "solver failed"
        verdict = beta, status, sound, own
        return self.recorder.node(state, new, start.s, x, freeze(Y), verdict, engine, note, cost=cost)

    def _contradiction(
        self, window: EstimationWindow, terms: float, dual: float, numbers: dict[float, int]
    ) -> Contradiction | None:
        """Return the output of a sample without which the data come nearest to the bounds; None if there is none."""
        if not np.isfinite(terms):
            return None
        energies = self._kept_energy(window.masks) * window.discount
        suspects: list[tuple[float, int, int, float, float]] = []
        for j in map(int, window.samples):
            for i in map(int, np.flatnonzero(window.masks[j])):
                remaining = _without(window, j, i)
                own = float(energies[j] - self._kept_energy(remaining.masks[j : j + 1])[0] * window.discount[j])
                # a bound on the norm is that of the sample: what one output leaves of it is all of it
                room = own if own > 0 else float(energies[j])
                suspects.append((smooth(remaining).dual - (terms - own), j, i, own, room))
        if self.constraints.active or window.limits is not None:
            suspects.sort()
            suspects = [
                (self._over(_without(window, j, i), terms - own), j, i, own, room)
                for _, j, i, own, room in suspects[:SUSPECTS]
            ]
        for k, mean in enumerate(() if window.means is None else window.means.readings):
            remaining = replace(window, means=window.means and window.means.without(k))
            own, end = self._mean_noise_energy(window) - self._mean_noise_energy(remaining), mean.end
            room = own if own > 0 else self._mean_noise_energy(window, end)
            suspects.append((self._over(remaining, terms - own), end, mean.output, own, room))
        if not suspects:  # limits alone contradict the bounds: no number is the one to blame
            return None
        over, j, i, _, room = min(suspects)
        alone = over <= CONTRADICTION * terms
        room = np.float64(room if alone else terms)
        with np.errstate(divide="ignore", over="ignore"):
            factor = float(np.sqrt((dual - terms + room) / room)) if np.isfinite(dual) else np.inf
        t = float(window.times[j])
        return Contradiction(numbers[t], t, self.plant.outputs.names[i], factor, alone)

    def _over(self, window: EstimationWindow, terms: float) -> float:
        """By how much a window costs more than the bounds allow."""
        solution = self._solve(window)
        return solution.dual - terms if solution.status == "ok" else np.inf

    def _kept_energy(self, masks: Array) -> Array:
        """Return a bound on the cost of the true noise at samples where v is constrained.

        With v in R and Qv alone: |v|^2_Qv. But where 0 may be, so may every share s v of the true v, with the cost
        (1 - s)^2 |v|^2_R + s^2 |v|^2_Qv: the best s leaves R Qv/(R + Qv), what it is without a constraint on v. Boxes
        keep also what takes another share of each entry.
        """
        sets, weights, bound = self.constraints, self.weights, self.bounds.v
        if not sets.keeps_v:
            return self.bounds.of_samples(masks)
        kept = weights.sample_energy(bound, True, masks)
        if sets.y is not None or sets.v is None or not sets.v.contains(np.zeros(self.plant.n_outputs)):
            return kept
        fit = weights.fit_energy(bound, masks)
        together = fit + kept
        with np.errstate(invalid="ignore"):
            shared = np.where(together > 0, fit * (kept / np.where(together > 0, together, 1.0)), 0.0)
        shared = np.where(np.isinf(together), together, shared)
        if sets.v.is_box and weights.diagonal_noise:
            shared = np.minimum(shared, self.bounds.of_samples(masks))
        return np.minimum(kept, shared)


def _without(window: EstimationWindow, j: int, i: int) -> EstimationWindow:
    """The window without output i of the sample at node j."""
    masks, y = window.masks.copy(), window.y.copy()
    masks[j, i] = y[j, i] = 0.0
    return replace(window, masks=masks, y=y)


def _from_set(chosen: ConvexSet | None) -> Array | float | None:
    """The bound that a constraint set implies, in the form that the bounds have."""
    magnitude = None if chosen is None else chosen.magnitude()
    return float(magnitude) if magnitude is not None and magnitude.ndim == 0 else magnitude
