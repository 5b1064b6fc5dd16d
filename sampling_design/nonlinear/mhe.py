"""The sample-based moving horizon estimator of a nonlinear plant: one program, solved when a measurement arrives."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._checks import freeze
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.estimators.gap_flows.cost_function import CostFunction
from sampling_design.estimators.online.estimator import Estimate, Status, Taken
from sampling_design.estimators.online.history import Node, State
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.nonlinear.collocation import Collocation
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.nlp import WindowData, WindowProgram, WindowSolution
from sampling_design.nonlinear.simulation import Integrator, require_inside
from sampling_design.nonlinear.warm_start import moved, open_loop_guess
from sampling_design.nonlinear.weights import scaled_weights

Array = npt.NDArray[np.float64]

SAME_TIME = 1e-12
"""A window start within this share of the current time of a sample is that sample's time (t - M is rounded)."""

WHOLE = 1e-9
"""A gap this much longer than a multiple of `w_step`, relatively, still counts as that multiple."""

NOTE = "No radius: nothing is proven for a nonlinear plant."


def _papers(cost: CostFunction | None) -> CostFunction:
    """The cost of (15) with the weights of `cost`."""
    cost = CostFunction() if cost is None else cost
    if cost.form == "certificate" or cost.arrival != "fixed":
        raise ArgumentError(
            f'`cost` must have the form "paper" and the arrival "fixed" for a nonlinear plant, got {cost.form!r} and '
            f"{cost.arrival!r}."
        )
    return cost


class Solve(NamedTuple):
    """What one window problem took: time, status, iterations, seconds of this thread, intervals, attempts."""

    t: float
    status: str
    iterations: int
    seconds: float
    intervals: int
    attempts: int


class NonlinearMovingHorizonEstimator(OnlineEstimator):
    """Moving horizon estimation of a nonlinear plant from rare, irregular samples.

    At a sample at t the window problem over [t - M_t, t], M_t = min(t, M), is solved,

        min  2 e^{-eta M_t}|x(t-M_t) - xhat(t-M_t)|^2_P2 + int 2 e^{-eta(t-tau)}|w|^2_Qw
                 + sum e^{-eta(t-tau)}(2|v|^2_Qv + |y - h(x, u, v)|^2_R)

    subject to x' = f(x, u, w), x in X, w in W, v in V, h(x, u, v) in Y; in between the estimate runs open
    loop with w = 0. The prior is the estimate that was valid online at t - M_t, also where no sample lies there.
    With dense samples this is the standard estimator.

    Parameters
    ----------
    plant : NonlinearPlant
        Its boxes are the sets X, W, V, Y; `plant.with_bounds` changes them.
    horizon : float
        M [time].
    cost : CostFunction, optional
        Physical weights (inverse-covariance-like) and the rate, in the form "paper". Default diag(1/s_x^2),
        diag(1/s_w^2), 2 diag(1/s_y^2), 2 diag(1/s_v^2) and 0.
    prior : (n,) array, optional
        Estimate at `prior_time` before any sample; default 0.
    collocation : Collocation, optional
        Pieces of the window and degree of the polynomials.
    tolerance : float
        Of IPOPT, in scaled variables.
    max_iterations : int

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape or sign, the cost has another form, the prior lies outside X, or the model is
        not finite there.

    Notes
    -----
    *Assumptions.* u is constant between the times at which it is given; X holds at the Radau points, Y at
    the samples (in between v costs nothing there).
    *Claim.* None: the record's radii are infinite. Theorem 9 holds if the plant satisfies Assumption 7; see
    `check_detectability` for evidence.
    *Method.* Radau collocation and IPOPT with exact derivatives. The program is built once; while the
    window fills, unused pieces have length 0. Each solve starts from the last solution, moved in time, and the
    open loop beyond; if that fails, once more from the open loop alone.
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

    def __init__(
        self,
        plant: NonlinearPlant,
        *,
        horizon: float,
        cost: CostFunction | None = None,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        collocation: Collocation | None = None,
        tolerance: float = 1e-8,
        max_iterations: int = 200,
    ):
        if not isinstance(plant, NonlinearPlant):
            raise ArgumentError(
                f"`plant` must be a NonlinearPlant, got {type(plant).__name__}. For a linear plant use "
                "MovingHorizonEstimator, or convert it with from_linear."
            )
        self.plant: Any = plant
        self.horizon = _checks.positive("horizon", horizon)
        given = Collocation() if collocation is None else collocation
        self.w_step = self.horizon / 60 if given.w_step is None else given.w_step
        self.scaled = scaled_weights(plant, _papers(cost))
        self._options = (
            given.degree,
            _checks.positive("tolerance", tolerance),
            _checks.whole("max_iterations", max_iterations, 1),
        )
        self.memory, self.maximum_delay = 2 * self.horizon, self.horizon
        self._scale = plant.signals["states"].scales
        self._integrator = Integrator(plant)
        state = self.initial_state(prior, prior_time)
        self.builds = 0
        pieces = int(np.ceil(self.horizon / self.w_step * (1 - WHOLE))) + 1
        self._build(given.capacity or pieces)
        self._restart(state)

    def _build(self, capacity: int) -> None:
        self.program = WindowProgram(self.plant, self.scaled, capacity, *self._options)
        self.builds += 1

    def _restart(self, state: State) -> None:
        self.state = state
        self.solves: list[Solve] = []
        self.window: WindowSolution | None = None

    def reset(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> None:
        """Forget all samples and start again from a prior; the program stays built."""
        self._restart(self.initial_state(prior, prior_time))

    def initial_state(self, prior: npt.ArrayLike | None = None, prior_time: float = 0.0) -> State:
        """Return the state before any sample: `prior` (default 0) at `prior_time`.

        Raises
        ------
        ArgumentError
            If the prior has the wrong length, lies outside X, or f or h are not finite there.
        """
        plant = self.plant
        x = _checks.vector("prior", np.zeros(plant.n_states) if prior is None else prior, plant.n_states)
        require_inside(plant, "prior", x)
        plant.f(x, np.zeros(plant.n_inputs))
        plant.h(x, np.zeros(plant.n_inputs))
        t = _checks.number("prior_time", prior_time)
        return State((self._node(Taken(t), x, "prior"),))

    def _node(self, sample: Taken, x: Array, status: Status, note: str = "", **details: Any) -> Node:
        """Return a snapshot; what only the linear estimators keep is empty."""
        x = freeze(x)
        estimate = self._said(sample.t, x, status, note, **details)
        y = np.zeros(self.plant.n_outputs) if sample.y is None else np.nan_to_num(sample.y)
        mask = np.zeros(y.size) if sample.y is None else np.isfinite(sample.y).astype(np.float64)
        nothing = np.zeros(0)
        return Node(
            t=sample.t,
            y=y,
            mask=mask,
            feedthrough=nothing,
            x=x,
            Y=estimate.covariance,
            beta=np.inf,
            flow=None,
            drift=nothing,
            scheduled=False,
            sound=True,
            estimate=estimate,
            sample=sample,
        )

    def _said(self, t: float, x: Array, status: Status, note: str = "", **details: Any) -> Estimate:
        unknown = freeze(np.diag(np.full(x.size, np.inf)))
        return Estimate(t, freeze(x), unknown, status=status, note=" ".join(filter(None, (note, NOTE))), **details)

    def _advance(self, state: State, sample: Taken) -> Node:
        data, guess = self._window(state, sample)
        solution, attempts = self._solve(data, guess)
        pieces = data.edges.size - 1
        self.solves.append(Solve(sample.t, solution.status, solution.iterations, solution.seconds, pieces, attempts))
        details = {"window_start": float(data.edges[0]), "engine": "ipopt"}
        if solution.status == "ok":
            self.window = solution
            x = solution.last * self._scale
            note = "" if solution.message == "solve succeeded" else f"The solver says: {solution.message}."
            return self._node(sample, x, "ok", note, cost=solution.cost, **details)
        self.window = None
        x, trouble = self._open_loop(state, state.last, sample.t)
        note = f"The solver says: {solution.message}; open-loop prediction instead. {trouble}".strip()
        return self._node(sample, x, solution.status, note, **details)

    def _solve(self, data: WindowData, guess: WindowSolution) -> tuple[WindowSolution, int]:
        """Solve from the last solution, and if that fails from the open loop; seconds and iterations add up."""
        if self.window is None:
            return self.program.solve(data, guess, warm=False), 1
        start = moved(self.window, guess, self.program.points)
        first = self.program.solve(data, start, warm=True)
        if first.status == "ok":
            return first, 1
        second = self.program.solve(data, guess, warm=False)
        return second._replace(
            seconds=first.seconds + second.seconds, iterations=first.iterations + second.iterations
        ), 2

    def _window(self, state: State, sample: Taken) -> tuple[WindowData, WindowSolution]:
        """Return the window that ends with `sample`, and its open loop from the prior and the latest estimate."""
        start, prior, inside = self._start(state, sample.t)
        rows = {node.t: (node.y, node.mask) for node in inside}
        seen = np.isfinite(sample.y)
        rows[sample.t] = (np.where(seen, sample.y, 0.0), seen.astype(np.float64))
        changes = [t for t, _ in state.inputs if start < t < sample.t]
        edges = self._edges(sorted({start, *rows, *changes}))
        if edges.size - 1 > self.program.capacity:
            self._build(max(edges.size - 1, int(1.25 * self.program.capacity)))
            self.window = None
        zero = np.zeros(self.plant.n_outputs)
        y, mask = (np.array([rows.get(t, (zero, zero))[k] for t in edges.tolist()]) for k in (0, 1))
        inputs = np.array([self._input(state, t) for t in edges.tolist()])
        data = WindowData(edges, inputs, y / self.plant.signals["outputs"].scales, mask, prior / self._scale)
        states = self._path(state, edges, prior) / self._scale
        sizes = (self.plant.n_disturbances, self.program.n_noises, self.plant.n_outputs)
        return data, open_loop_guess(edges, states, self.program.points, sizes)

    def _start(self, state: State, t: float) -> tuple[float, Array, tuple[Node, ...]]:
        """Return where the window begins, the online estimate there, and the samples in it (closed)."""
        nodes, s = state.nodes, t - self.horizon
        slack = SAME_TIME * max(abs(t), self.horizon)
        if nodes[0].sample.y is None and s <= nodes[0].t + slack:
            return nodes[0].t, nodes[0].x, nodes[1:]
        anchor = state.node_before(s + slack)
        node = nodes[anchor]
        if abs(node.t - s) <= slack:
            return node.t, node.x, nodes[anchor:] if node.sample.y is not None else nodes[anchor + 1 :]
        return s, self._open_loop(state, node, s)[0], nodes[anchor + 1 :]

    def _edges(self, nodes: list[float]) -> Array:
        """Divide the gaps between the nodes into equal pieces of at most `w_step`."""
        edges = [nodes[0]]
        for a, b in pairwise(nodes):
            count = max(1, int(np.ceil((b - a) / self.w_step * (1 - WHOLE))))
            edges += [a + (b - a) * k / count for k in range(1, count)] + [b]
        return np.array(edges)

    def _path(self, state: State, edges: Array, prior: Array) -> Array:
        """Return the online estimates at the edges: known at samples, open loop after the last one."""
        last = state.last
        x, t = last.x, last.t
        known = {node.t: node.x for node in state.nodes if node.t > edges[0]}
        times, path = [float(edges[0]), *known], [prior, *known.values()]
        try:
            for edge in edges[edges > last.t].tolist():
                x, t = self._flown(state, x, t, edge), edge
                times.append(edge)
                path.append(x)
        except SolverError:
            pass  # a guess only: it stays constant from there on
        order = np.argsort(times, kind="stable")
        columns = np.array(path)[order]
        return np.stack([np.interp(edges, np.array(times)[order], column) for column in columns.T], axis=1)

    def _input(self, state: State, t: float) -> Array:
        u = state.input_at(t)
        return np.zeros(self.plant.n_inputs) if u is None else u

    def _flown(self, state: State, x: Array, a: float, b: float) -> Array:
        """Return the open loop from x at a to b, with w = 0 and the inputs that were given."""
        if b <= a:
            return x
        edges = [a, *(t for t, _ in state.inputs if a < t < b), b]
        still = np.zeros(self.plant.n_disturbances)
        for start, stop in pairwise(edges):
            x = self._integrator.step(x, self._input(state, start), still, start, stop)
        return x

    def _open_loop(self, state: State, node: Node, t: float) -> tuple[Array, str]:
        """Return the open loop from a node at t; if even that fails, the node's estimate, and say so."""
        try:
            return self._flown(state, node.x, node.t, t), ""
        except SolverError as error:
            return node.x, f"The open loop fails too, the last estimate is held: {error}"

    def _predict(self, state: State, t: float) -> Estimate:
        node = state.nodes[state.node_before(t)]
        if node.t == t:
            return node.estimate
        x, trouble = self._open_loop(state, node, t)
        return self._said(t, x, "solver failed" if trouble else "predicted", trouble)
