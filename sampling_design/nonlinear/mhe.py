"""The sample-based moving horizon estimator of a nonlinear plant: one program, solved when a measurement arrives."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import RecordRow
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.history import EstimatorState, HistoryNode
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.estimators.online.schedule_watch import choose_horizon
from sampling_design.nonlinear.collocation import Collocation, OutlierRejection, WindowSolver, beyond
from sampling_design.nonlinear.inclusion_bound import InclusionBound, WindowTrajectory, cost_for
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.nlp import WindowProgram
from sampling_design.nonlinear.open_loop import NonlinearLoop
from sampling_design.nonlinear.region import StateRegion
from sampling_design.nonlinear.simulation import require_inside
from sampling_design.nonlinear.smoothed import SmoothedWindow, smoothed_window
from sampling_design.nonlinear.weights import fit_covariance, scaled_weights, warn_of_scales
from sampling_design.nonlinear.window_forms import WindowData, WindowSolution
from sampling_design.nonlinear.window_search import WHOLE, WindowAnswer, WindowSearch
from sampling_design.numerics.filtering import propagate
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.vector_bounds import VectorBound, vector_bound
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate

SAME_TIME = 1e-12
"""A window start within this share of the current time of a sample is that sample's time (t - M is rounded)."""

ARRIVAL_FLOOR = 1e-8  # standard deviations that a filtered arrival weight assumes at least, in those of P2


class SolverRun(NamedTuple):
    """What one window problem took: time, status, iterations, seconds of this thread, intervals, attempts, degree.

    `error`: what the discretisation costs, in standard deviations of the estimate.
    """

    t: float
    status: str
    iterations: int
    seconds: float
    intervals: int
    attempts: int
    degree: int = 0
    error: float = 0.0


class NonlinearStart(NamedTuple):
    """Where a window begins: time, estimate, bound on V, when a sample last counted, root of the weight, nodes inside.

    `closed`: a sample at the start is inside; `prior`: nothing was sampled before.
    """

    t: float
    x: Array
    square: float
    counted: float
    root: Array
    inside: tuple[HistoryNode, ...]
    closed: bool
    prior: bool


def counts(sample: RecordRow, counted: float) -> bool:
    """Whether the proof takes a sample, the last one that it took being at `counted`: one at the prior's time, too."""
    return counted == sample.t and sample.y is not None and bool(np.isfinite(sample.y).all())


class NonlinearMovingHorizonEstimator(OnlineEstimator):
    """Moving horizon estimation of a nonlinear plant from rare, irregular samples.

    At a sample at t the window problem over [t - M_t, t], M_t = min(t, M), is solved,

        min  2 e^{-eta M_t}|x(t-M_t) - xhat(t-M_t)|^2_P2 + int 2 e^{-eta(t-tau)}|w|^2_Qw
                 + sum e^{-eta(t-tau)}(2|v|^2_Qv + |y - h(x, u, v)|^2_R)

    subject to x' = f(x, u, w), x in X, w in W, v in V, h(x, u, v) in Y; in between the estimate runs open
    loop with w = 0. The prior is the estimate that was valid online at t - M_t, also where no sample lies there.
    With dense samples this is the standard estimator.

    With a certificate the cost is the certificate's, whose weights have no factors 2, with the arrival weight P(tau)
    over (t - M_t, t], and each estimate has a radius.

    Parameters
    ----------
    plant : NonlinearPlant
        Its boxes and limits are the sets X, W, V, Y; `plant.with_bounds` changes them.
    certificate : InclusionCertificate, optional
        Of this plant in a region: weights, rate, horizon, and the radius of every estimate.
    horizon : float
        M [time]. Default with a certificate: where a window shrinks the squared error to a quarter.
    cost : CostFunction, optional
        Physical weights (inverse-covariance-like) and the rate instead of the certificate's. Default diag(1/s_x^2),
        diag(1/s_w^2), 2 diag(1/s_y^2), 2 diag(1/s_v^2) and 0, in the form "paper". With `arrival="filtered"` the prior
        weighs what the windows before left unknown of it, as in an extended Kalman filter.
    prior : (n,) array, optional
        Estimate at `prior_time` before any sample; default 0.
    initial_error : float or (n,) array, optional
        Bound on |x - prior|, together or entry by entry, for the radius; not needed where the region is bounded.
    collocation : Collocation, optional
        Pieces of the window and degree of the polynomials; refined where the discretisation costs too much.
    solver : WindowSolver, optional
        Tolerance, iterations, and other starts where the cost is out of line with the noise.
    outliers : OutlierRejection, optional
        A robust loss, or a gate for samples that fit nothing else.
    maximum_delay : float, optional
        How far back a late sample, a correction or a withdrawal may lie [time]. Default: the horizon.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape or sign, the certificate is another plant's, the prior lies outside X, or the
        model is not finite there.

    Warns
    -----
    ScaleWarning
        If the states have no scales though their sizes are far from 1.
    GuaranteeWarning
        If the horizon is not longer than the certificate allows.

    Notes
    -----
    *Assumptions.* X holds at the Radau points, Y at the samples (in between v costs nothing there). With a certificate:
    w, v keep the plant's boxes, the truth stays in the certificate's region.
    *Claim.* With a certificate |x - xhat|^2_P(tau) <= radius for every estimate whose `certified` is true, however well
    the program was solved; `covariance` is P(tau)^-1 then. The jumps between integrated pieces count, up to the
    integrator's tolerance (1e-10 relative). Else none: radii are infinite, and `covariance` is that of the linearised
    window, discounted. Theorem 9 holds if the plant satisfies Assumption 7; see `check_detectability` for evidence.
    *Method.* Radau collocation with exact derivatives. The program is built once; while the
    window fills, unused pieces have length 0. Each solve starts from the last solution, moved in time, and the
    open loop beyond: by Newton's method, whose answer counts where it meets the conditions of a minimum to the
    solver's tolerance and no bound of states or outputs acts, else by IPOPT (`engine` of an estimate says which). If
    that fails, once more from the open loop alone, then from other starts. Each piece is integrated anew, and the grid
    refined until that no longer moves the estimate.
    *Numerical aspects.* Unknowns are scaled by the plant's scales. v is eliminated where neither it nor y is
    bounded.

    References
    ----------
    The paper, Section IV, equations (14) and (15).

    Examples
    --------
    >>> pendulum = NonlinearPlant(
    ...     lambda x, u, w: [x[1], -(x[0] - x[0] ** 3 / 6) + w[0]],
    ...     lambda x, u, v: [x[0] + v[0]],
    ...     {"states": 2, "disturbances": 1, "outputs": 1},
    ... )
    >>> cost, pieces = CostFunction(eta=0.1, R=[[50.0]]), Collocation(w_step=0.5)
    >>> mhe = NonlinearMovingHorizonEstimator(pendulum, horizon=4.0, cost=cost, collocation=pieces)
    >>> times = np.array([0.0, 0.5, 1.5, 2.5, 4.0, 5.0])
    >>> from sampling_design.nonlinear.simulation import simulate
    >>> truth = simulate(pendulum, [0.8, 0.0], times)
    >>> record = mhe.run((t, x[:1]) for t, x in zip(times, truth))
    >>> bool(np.abs(record.x[-1] - truth[-1]).max() < 0.05)
    True
    """

    plant: Any  # a linear one in the base

    def __init__(
        self,
        plant: NonlinearPlant,
        certificate: InclusionCertificate | None = None,
        *,
        horizon: float | None = None,
        cost: CostFunction | None = None,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        initial_error: VectorBound = None,
        collocation: Collocation | None = None,
        solver: WindowSolver | None = None,
        outliers: OutlierRejection | None = None,
        maximum_delay: float | None = None,
    ):
        self.plant = plant
        if initial_error is not None:
            vector_bound("initial_error", initial_error, plant.states.names)
        self.error_bound = None if certificate is None else InclusionBound(certificate, plant, initial_error)
        cost, given = cost_for(certificate, cost), Collocation() if collocation is None else collocation
        self.horizon, claim_note = choose_horizon(certificate, horizon, cost, "arrival")
        self.filtered, self.begins = cost.arrival == "filtered", cost.begins
        self.closed = cost.form == "paper" and not self.filtered
        self.scaled = scaled_weights(plant, cost)
        self.keep_for_late(maximum_delay)
        self._scale = plant.signals["states"].scales
        self.outliers = OutlierRejection() if outliers is None else outliers
        self._region = StateRegion(*plant.bounds["states"]) if self.error_bound is None else self.error_bound.region
        self.loop = NonlinearLoop(plant, self.scaled, self.error_bound, given.inputs == "linear", claim_note)
        state = self.initial_state(prior, prior_time)
        warn_of_scales(plant, "states", [state.last.x, *plant.bounds["states"]])
        settings = WindowSolver() if solver is None else solver
        self.search = WindowSearch(plant, self.scaled, given, self.horizon, settings, self._region, self.outliers.huber)
        self._restart(state)

    @property
    def window(self) -> WindowSolution | None:
        """The last solution, scaled."""
        return self.search.window

    @property
    def program(self) -> WindowProgram:
        """The program of the windows."""
        return self.search.program

    @property
    def builds(self) -> int:
        """How often the program was built."""
        return self.search.builds

    def start(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> None:
        """Forget all samples and start again from a prior; the program stays built."""
        self._restart(self.initial_state(prior, prior_time))

    def initial_state(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> EstimatorState:
        """Return the state before any sample: `prior` (default 0) at `prior_time`.

        Raises
        ------
        ArgumentError
            If the prior has the wrong length, lies outside X, breaks a limit, or f or h are not finite there.
        """
        plant = self.plant
        x = checks.vector("prior", np.zeros(plant.n_states) if prior is None else prior, plant.n_states)
        require_inside(plant, "prior", x)
        t, still = checks.number("prior_time", prior_time), np.zeros(plant.n_inputs)
        over = np.array(plant.limits_casadi(x, still)).ravel()
        if np.any(over > 0):
            k = int(np.argmax(over))
            raise ArgumentError(f"`prior` must keep the plant's limits, got limit {k + 1} = {over[k]:.6g} above 0.")
        plant.f(x, still, t=t)
        plant.h(x, still, t=t)
        return EstimatorState((self.loop.prior(t, x),))

    def _restart(self, state: EstimatorState) -> None:
        self.state = state
        self.solves: list[SolverRun] = []
        self.search.forget()
        self._latest: tuple[WindowData, WindowAnswer] | None = None
        self._scales_checked = False

    def _handed_out(self, state: EstimatorState, node: int) -> Estimate:
        return self.loop.of_node(state.nodes[node])

    def _predict(self, state: EstimatorState, t: float) -> Estimate:
        return self.loop.predicted(state, t)

    def _advance(self, state: EstimatorState, sample: RecordRow) -> HistoryNode:
        if not self._scales_checked:
            self._scales_checked = True
            warn_of_scales(self.plant, "outputs", [sample.y])
        taken, rejected = self._without_outliers(state, sample)
        noted = f"{rejected} {self.loop.assumed(state, sample.t)}".strip()
        counted, scheduled = self._counted(state, taken)
        refined, allowed = False, self.search.collocation.accuracy or np.inf
        while True:
            data, guess, start = self._window(state, taken, counted)
            answer = self.search.solve(data, guess)
            rough = answer.error > allowed or (refined and answer.solution.status != "ok")
            if not rough or not self.search.refine():
                break
            refined = True
        solution = answer.solution
        took = sample.t, solution.status, solution.iterations, solution.seconds
        self.solves.append(SolverRun(*took, data.edges.size - 1, answer.attempts, self.search.degree, answer.error))
        begun, engine = float(data.edges[0]), solution.engine
        if solution.status != "ok" or answer.covariances is None:
            x, Y, square, trouble = self.loop.ahead(state, state.last, sample.t, state.last.counted)
            note = f"The solver says: {solution.message}; open-loop prediction instead. {trouble} {noted}".strip()
            if counts(taken, counted) and self.error_bound is not None:
                counted = state.last.counted  # nothing was learned from it
            return self.loop.node(
                taken, x, solution.status, Y, square, counted, note, scheduled, window_start=begun, engine=engine
            )
        self._latest = data, answer
        x = solution.last * self._scale
        Y = answer.covariances.last * self._scale * self._scale[:, None]
        words = [] if solution.message == "solve succeeded" else [f"The solver says: {solution.message}."]
        if rough:
            words.append(
                f"The discretisation costs {answer.error:.2g} standard deviations of the estimate, also with degree "
                f"{self.search.degree} and pieces of {self.search.w_step:.3g}: choose a shorter horizon or w_step."
            )
        square = self._bound(data, answer, start, counts(taken, counted))
        note = " ".join(filter(None, (*words, noted)))
        return self.loop.node(
            taken, x, "ok", Y, square, counted, note, scheduled, window_start=begun, engine=engine, cost=solution.cost
        )

    def _counted(self, state: EstimatorState, sample: RecordRow) -> tuple[float, bool]:
        """When the last sample that the proof takes was, this one included; whether gaps and inputs are certified."""
        last, error_bound = state.last, self.error_bound
        if error_bound is None:
            return sample.t, True
        before = self.loop.since(last, sample.t)
        complete = bool(np.isfinite(sample.y).all())
        inputs = [self.loop.input(state, last.t), *(u for t, u in state.inputs if last.t < t <= sample.t)]
        scheduled = last.scheduled and bool(np.isfinite(error_bound.age(sample.t, before)))
        scheduled = scheduled and error_bound.drives(np.array(inputs))
        return (sample.t if complete and error_bound.counts(sample.t, before) else last.counted), scheduled

    def _without_outliers(self, state: EstimatorState, sample: RecordRow) -> tuple[RecordRow, str]:
        """Leave out the outputs of a sample that lie beyond the gate, and say so."""
        gate, patience = self.outliers.gate, self.outliers.patience
        recent = [node for node in state.nodes[-patience:] if node.sample.y is not None and not node.mask.any()]
        if gate is None or len(recent) == patience or state.last.t == sample.t:
            return sample, ""
        x, Y, _, trouble = self.loop.ahead(state, state.last, sample.t, self.loop.since(state.last, sample.t))
        if trouble or not np.isfinite(Y).all():
            return sample, ""
        u = self.loop.input(state, sample.t)
        C = self.plant.linearise(x, u, sample.t).C
        noise = fit_covariance(self.plant, self.scaled)
        far = beyond(np.nan_to_num(sample.y - self.plant.h(x, u, t=sample.t)), propagate(Y, C, noise), gate)
        if not far.any():
            return sample, ""
        names = ", ".join(np.array(self.plant.outputs.names)[far])
        note = f"Left out as an outlier: {names} (beyond {gate:.3g} standard deviations of the prediction)."
        return sample._replace(y=freeze(np.where(far, np.nan, sample.y))), note

    def _bound(self, data: WindowData, answer: WindowAnswer, start: NonlinearStart, last_counts: bool) -> float:
        """Return the bound on V at the window's end, after the fact."""
        error_bound, solution = self.error_bound, answer.solution
        if error_bound is None or error_bound.trouble or answer.slopes is None:
            return float("inf")
        nodes = solution.nodes * self._scale
        if not error_bound.holds(np.vstack([nodes, solution.point.z.reshape(-1, nodes.shape[1]) * self._scale])):
            return float("inf")
        if not error_bound.drives(np.vstack([data.inputs, data.later])):
            return float("inf")
        jumps = answer.jumps
        if jumps is None:
            jumps = self.search.jumps(data, solution)
        if not np.isfinite(jumps).all():
            return float("inf")
        taken = {node.t for node in start.inside if counts(node.sample, node.counted)}
        taken |= {data.edges[-1]} if last_counts else set()
        counted = np.array([t in taken for t in data.edges.tolist()])
        scale = self.plant.signals["outputs"].scales
        misfit = np.where(data.mask > 0, data.y - answer.slopes.outputs, 0.0) * scale
        if self.search.program.keeps_v:
            misfit = misfit + solution.point.v * self.plant.signals["noises"].scales
        w = solution.point.w * self.plant.signals["disturbances"].scales
        trajectory = WindowTrajectory(data.edges, nodes, w, misfit, counted, jumps * self._scale)
        last = start.counted
        square = min(start.square, error_bound.largest(start.t, last, start.x, start.prior))
        return error_bound.radius(trajectory, start.x, square, last)

    def _window(
        self, state: EstimatorState, sample: RecordRow, counted: float
    ) -> tuple[WindowData, WindowSolution, NonlinearStart]:
        """Return the window that ends with `sample`, and its open loop from the prior and the latest estimate."""
        start = self._start(state, sample, counted)
        rows = {node.t: (node.y, node.mask) for node in start.inside}
        measured = np.isfinite(sample.y)
        if sample.t > start.t or start.closed:
            rows[sample.t] = (np.where(measured, sample.y, 0.0), measured.astype(np.float64))
        changes = [t for t, _ in state.inputs if start.t < t < sample.t]
        edges = self._edges(sorted({start.t, sample.t, *rows, *changes}))
        zero = np.zeros(self.plant.n_outputs)
        y, mask = (np.array([rows.get(t, (zero, zero))[k] for t in edges.tolist()]) for k in (0, 1))
        inputs = np.array([self.loop.input(state, t) for t in edges.tolist()])
        later = np.array([self.loop.input_until(state, a, b) for a, b in pairwise(edges.tolist())])
        data = WindowData(
            edges=edges,
            inputs=inputs,
            later=later.reshape(edges.size - 1, self.plant.n_inputs),
            y=y / self.plant.signals["outputs"].scales,
            mask=mask,
            prior=start.x / self._scale,
            root=start.root,
        )
        return data, self.search.guess(edges, self._path(state, edges, start.x) / self._scale), start

    def _start(self, state: EstimatorState, sample: RecordRow, counted: float) -> NonlinearStart:
        """Return where the window begins, the online estimate there, what it weighs, and the samples in it.

        P(tau) of a prior counts from where the first sample that counts asks for it, and without one from where it will
        at the window's end: `counted`.
        """
        nodes, t = state.nodes, sample.t
        s = t - self.horizon
        slack = SAME_TIME * max(abs(t), self.horizon)
        fixed: Array = np.asarray(np.linalg.cholesky(self.scaled.twice * self.scaled.P2).T, dtype=np.float64)
        if nodes[0].sample.y is None and s <= nodes[0].t + slack:
            first = nodes[0]
            last = self._last_before(first, nodes[1:], sample, counted)
            root = fixed if self.error_bound is None else self._arrival_weight(first.t, last)
            return NonlinearStart(first.t, first.x, self.loop.begun(first, last), last, root, nodes[1:], True, True)
        anchor = state.node_before(s + slack)
        node = nodes[anchor]
        last = self._last_before(node, nodes[anchor + 1 :], sample, counted)
        at, x, Y, square = node.t, node.x, node.Y, self.loop.begun(node, last)
        at_node = self.begins == "sample" or abs(at - s) <= slack
        closed = self.closed and at_node and node.sample.y is not None
        if not at_node:
            at = s
            x, Y, square, _ = self.loop.ahead(state, node, s, last)
        root = fixed
        if self.error_bound is not None:
            root = self._arrival_weight(at, last)
        elif self.filtered:
            root = self._information(Y, fixed)
        return NonlinearStart(at, x, square, last, root, nodes[anchor if closed else anchor + 1 :], closed, False)

    def _last_before(self, node: HistoryNode, later: Sequence[HistoryNode], sample: RecordRow, counted: float) -> float:
        """When the last sample that counts was, as a window that begins at or after a node takes it."""
        if node.sample.y is not None:
            return node.counted
        own = sample.t if counts(sample, counted) else None
        taken = next((each.t for each in later if counts(each.sample, each.counted)), own)
        return counted if taken is None else self.loop.since(node, taken)

    def _arrival_weight(self, t: float, last: float) -> Array:
        """Return the root of P(tau), scaled; beyond the certified gaps of P at the longest one."""
        error_bound = self.error_bound
        assert error_bound is not None
        age = error_bound.age(t, last)
        P = error_bound.certificate.at(error_bound.longest if np.isnan(age) else age)
        return np.asarray(np.linalg.cholesky(P * self._scale * self._scale[:, None]).T)

    def _information(self, Y: Array, fixed: Array) -> Array:
        """Return the root of the inverse of a covariance, scaled; P2's where nothing is known."""
        if not np.isfinite(Y).all():
            return fixed
        floor = ARRIVAL_FLOOR**2 * np.linalg.inv(fixed.T @ fixed)
        root = np.linalg.cholesky(Y / self._scale / self._scale[:, None] + floor)
        return np.asarray(np.linalg.qr(np.linalg.solve(root, np.eye(len(Y))), mode="r"))

    def _edges(self, nodes: list[float]) -> Array:
        """Divide the gaps between the nodes into equal pieces of at most `w_step`."""
        edges = [nodes[0]]
        for a, b in pairwise(nodes):
            count = max(1, int(np.ceil((b - a) / self.search.w_step * (1 - WHOLE))))
            edges += [a + (b - a) * k / count for k in range(1, count)] + [b]
        return np.array(edges)

    def _path(self, state: EstimatorState, edges: Array, prior: Array) -> Array:
        """Return the online estimates at the edges: known at samples, open loop after the last one."""
        last = state.last
        x, t = last.x, last.t
        known = {node.t: node.x for node in state.nodes if node.t > edges[0]}
        times, path = [float(edges[0]), *known], [prior, *known.values()]
        try:
            for edge in edges[edges > last.t].tolist():
                x, t = self.loop.propagated(state, x, t, edge, guess=True)[0], edge
                times.append(edge)
                path.append(x)
        except SolverError:
            pass  # a guess only: it stays constant from there on
        order = np.argsort(times, kind="stable")
        columns = np.array(path)[order]
        return np.stack([np.interp(edges, np.array(times)[order], column) for column in columns.T], axis=1)

    def smoothed(self) -> SmoothedWindow:
        """Return the trajectory of the latest solved window, in units: states, disturbances, outputs, covariances.

        Raises
        ------
        ArgumentError
            If no window was solved yet.
        """
        if self._latest is None:
            raise ArgumentError("`smoothed` needs a solved window: give the estimator a sample first.")
        return smoothed_window(self.plant, self.scaled, *self._latest)
