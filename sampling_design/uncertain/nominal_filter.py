"""The filter of a nominal plant whose radius holds for every plant of a box: the mismatch is a bounded disturbance."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from operator import itemgetter

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from sampling_design.accuracy.readings import RecordRow
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, CostWeights, build_weights
from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow, discounted_length
from sampling_design.estimators.kalman import KalmanFilter
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.history import EstimatorState, HistoryNode
from sampling_design.estimators.online.open_loop import ErrorBounds, OpenLoop, Recorder
from sampling_design.estimators.online.schedule_watch import ScheduleClaim
from sampling_design.numerics.filtering import propagate
from sampling_design.numerics.linalg import discounted_flow, forced_flow
from sampling_design.plants.plant import Signals, remade
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.vector_bounds import VectorBound, vector_bound
from sampling_design.uncertain.accuracy.accuracy_over_box import mismatch, moved
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

STEP = 0.25  # |A| times a step within which the mismatch is bounded at once
FEWEST, MOST = 4, 400  # steps of a gap
HALVINGS = 12  # how often a step is halved over which the bound of the mismatch does not hold itself up
GENTLE = 1 + 1 / 16  # factor on the radius over a step up to which the next one may be twice as long
MOST_STEEP = 1200  # steps that raise the radius by more: beyond them, by e^70 and more, it says nothing
TRIALS = 40  # times that the bound over a step is raised before the step is halved
ROUNDING = 1 + 1e-9  # factor on every sum that bounds from above
NO_CLAIM = "No a-priori claim: a filter of the nominal plant; its radius counts the mismatch as it comes."


class MismatchBounds(ErrorBounds):
    """The bounds, with what the outputs of the true plant show beyond those of the nominal one as noise."""

    before: tuple[Array, Array, float] | None = None
    """State, covariance and radius just before the sample that is taken in."""

    def __init__(
        self,
        weights: CostWeights,
        w_bound: Array | None,
        v_bound: VectorBound,
        initial_error: VectorBound,
        energy: float,
        output_mismatch: Array,
    ):
        self.output_mismatch = output_mismatch
        super().__init__(weights, w_bound, v_bound, initial_error)
        self.disturbance = energy

    def assumptions(self) -> None:
        """None: intervals of the data would take the nominal plant for the true one."""

    def of_samples(self, masks: Array) -> Array:
        """What noise and mismatch of samples cost at most."""
        if self.before is None or not len(self.output_mismatch) or self.v is None:
            return super().of_samples(masks)
        x, Y, beta = self.before
        if not np.isfinite(beta):
            return np.full(len(masks), np.inf)
        spread = np.sqrt(
            np.maximum(np.einsum("kpi,ij,kpj->kp", self.output_mismatch, Y, self.output_mismatch), 0.0) * max(beta, 0.0)
        )
        more = ROUNDING * np.sum(np.abs(self.output_mismatch @ x) + spread, axis=0)
        wider = self.v + (more if self.v.ndim else float(np.linalg.norm(more)))
        return self.weights.sample_energy(np.asarray(wider), False, masks)


class MismatchLoop(OpenLoop):
    """The open loop of the nominal plant, its radius with the mismatch bounded step by step.

    Parameters
    ----------
    rows : (m, n) array
        Of x, that drive the mismatch; `known` (k,) are sizes of what is driven by the disturbance.
    q : (m + k,) array
        Weights of the mismatch.
    """

    def __init__(self, table: FlowTable, bounds: MismatchBounds, rows: Array, known: Array, q: Array):
        super().__init__(table, bounds)
        self.plant, self.mismatched = self.weights.plant, bounds
        self._rows, self._known_size, self._q = rows, known, q
        self._inputs: Sequence[tuple[float, Array]] = ()

    @contextmanager
    def along(self, inputs: Sequence[tuple[float, Array]]) -> Iterator[None]:
        """Follow some inputs, and forget afterwards what was before a sample."""
        self._inputs = inputs
        try:
            yield
        finally:
            self.mismatched.before = None

    def undiscounted(self, node: HistoryNode, flow: GapFlow) -> None:
        """None: the bound on the disturbance knows nothing of the mismatch."""

    def propagated(self, node: HistoryNode, flow: GapFlow, drift: Array) -> tuple[Array, Array, float]:
        """Return state, covariance and radius after a gap, for every plant of the box."""
        x, Y, beta = super().propagated(node, flow, drift)
        if flow.gap > 0 and np.isfinite(beta) and np.isfinite(Y).all():
            beta = self._walked(node, flow.gap)
        self.mismatched.before = x, Y, beta
        return x, Y, beta

    def _walked(self, node: HistoryNode, gap: float) -> float:
        """The radius after a gap, the mismatch bounded step by step."""
        A = self.plant.A
        start, end = node.t, node.t + gap
        first, last = (
            bisect_right(self._inputs, start, key=itemgetter(0)),
            bisect_left(self._inputs, end, key=itemgetter(0)),
        )
        cuts = [start, *(t for t, _ in self._inputs[first:last]), end]
        x, Y, beta = np.asarray(node.x), np.asarray(node.Y), float(node.beta)
        speed = float(np.linalg.norm(A * self.weights.units / self.weights.units[:, None], 2))
        for a, b in pairwise(cuts):
            k = bisect_right(self._inputs, a, key=itemgetter(0)) - 1
            forcing = self.plant.B @ self._inputs[k][1] if k >= 0 else np.zeros(len(x))
            count = int(np.clip(np.ceil(speed * (b - a) / STEP), FEWEST, MOST))
            done, step = 0.0, (b - a) / count
            most, steep = step, 0
            for _ in range(count * 2**HALVINGS):
                if done >= (b - a) * (1 - 1e-12):
                    break
                step = min(step, b - a - done)
                found = self._stepped(x, Y, beta, forcing, step)
                if found is None:
                    step /= 2
                    if step * 2**HALVINGS * count < b - a:
                        return float("inf")
                    continue
                gentle = found[2] <= beta * GENTLE
                steep += not gentle
                if steep > MOST_STEEP:
                    return float("inf")
                x, Y, beta = found
                done, step = done + step, min(2 * step, most) if gentle else step
        return beta * ROUNDING

    def _stepped(
        self, x: Array, Y: Array, beta: float, forcing: Array, step: float
    ) -> tuple[Array, Array, float] | None:
        """State, covariance and radius after a step; None if no bound of the mismatch holds itself up over it."""
        A, eta, rows = self.plant.A, self.weights.eta, self._rows
        F, W = (M[0] for M in discounted_flow(A, self.weights.noise, [step], eta))
        x_next = forced_flow(A, forcing[:, None], [step])[0] @ np.append(x, 1.0)
        Y_next = propagate(np.exp(eta * step) * Y, F, W)
        try:
            L = np.linalg.cholesky(Y)
        except np.linalg.LinAlgError:
            return None
        grown = float(np.exp(np.linalg.norm(np.linalg.solve(L, A @ L), 2) * step))
        sag = step**2 / 8 * grown
        own = np.maximum(np.linalg.norm(rows @ L, axis=1), np.linalg.norm(rows @ F @ L, axis=1))
        own = own + sag * np.linalg.norm(rows @ A @ A @ L, axis=1)
        spread = np.sqrt(np.exp(eta * step) * own**2 + np.einsum("ki,ij,kj->k", rows, W, rows))
        forced_size = float(np.linalg.norm(np.linalg.solve(L, A @ x + forcing)))
        centre = (
            np.maximum(np.abs(rows @ x), np.abs(rows @ x_next))
            + sag * np.linalg.norm(rows @ A @ L, axis=1) * forced_size
        )
        known, m = self._known_size, len(rows)
        fixed = self.bounds.disturbance + float(self._q[m:] @ known**2)
        size = centre + spread * np.sqrt(beta)
        for _ in range(TRIALS):
            top = beta + step * (fixed + float(self._q[:m] @ size**2))
            needed = ROUNDING * (centre + spread * np.sqrt(top))
            if not np.isfinite(needed).all():
                return None
            if np.all(needed <= size):
                lost = float(discounted_length(eta, step)) * (fixed + float(self._q[:m] @ size**2))
                return x_next, Y_next, float(np.exp(-eta * step) * beta + lost)
            size = np.maximum(size, needed * (1 + 1e-6))
        return None


class NominalFilter(KalmanFilter):
    """The Kalman filter of the nominal plant, with radii that hold for every plant of a box.

        x' = A_0 x + B u + G w + sum_k d_k A_k x,    |d_k A_k x| <= |A_k xhat| + sqrt(beta) |A_k|_Pi^-1

    Parameters
    ----------
    plant : UncertainPlant
        Parameters in a box, constant or varying as fast as they like.
    cost, prior, prior_time, input_side, maximum_delay
        As for `KalmanFilter`; the weights are those of the nominal plant.
    w_bound, v_bound, initial_error
        As for `MovingHorizonEstimator`; without them there is no radius.
    typical : float
        Size of the states, in units of their scales, for which the mismatch is weighed: it moves the radius, and the
        guarantee holds whatever it is.

    Raises
    ------
    ArgumentError
        If the plant lies between vertices, or an argument has the wrong shape or sign.

    Notes
    -----
    *Claim.* If w, v and the first error keep their bounds, |x - xhat|^2 in the inverse of `covariance` is at most
    `radius` for every plant of the box, at and between samples. *Method.* V = |e|^2_Pi obeys V' <= -eta V + |w|^2_Qw +
    sum q_k m_k^2, m_k the size of the mismatch along the k-th row. It is bounded over short steps by the estimate and
    by the ellipsoid itself: a bound that is not reached while it is assumed is never reached. Of outputs, the mismatch
    counts as noise. *Numerical aspects.* Between the ends of a step rows lie on their chords but for delta^2/8 times
    their second derivative. Where the bound does not hold itself up, the radius is not a number, and says so.

    Examples
    --------
    >>> from sampling_design import Plant
    >>> from sampling_design.uncertain.plants.uncertain_plant import UncertainParameter
    >>> leak = UncertainParameter("leak", 0.9, 1.1, A=[[-1.0]], nominal=1.0)
    >>> plant = UncertainPlant(Plant([[-1.0]], [[1.0]]), [leak])
    >>> cost = CostFunction(eta=0.5)
    >>> filter = NominalFilter(plant, cost=cost, w_bound=0.1, v_bound=0.1, initial_error=1.0)
    >>> filter.update(0.5, [0.4]).certified
    True
    """

    def __init__(
        self,
        plant: UncertainPlant,
        *,
        cost: CostFunction | None = None,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        w_bound: VectorBound = None,
        v_bound: VectorBound = None,
        initial_error: VectorBound = None,
        typical: float = 1.0,
        input_side: str = "right",
        maximum_delay: float = 0.0,
    ):
        if plant.vertices:
            raise ArgumentError("`plant` must have parameters in a box, got one between vertices.")
        nominal = plant.nominal
        stated = ErrorBoundArguments(w_bound=w_bound, v_bound=v_bound, initial_error=initial_error)
        given = build_weights(nominal, None, CostFunction() if cost is None else cost, stated)
        bound = None if w_bound is None else vector_bound("w_bound", w_bound, nominal.disturbances.names)
        energy = given.disturbance_energy(bound)
        self.model = plant
        into, rows, known = _channels(plant, bound)
        size = np.concatenate([np.linalg.norm(rows * nominal.states.scales, axis=1), known])
        size = np.where(size > 0, size, 1.0) * checks.positive("typical", typical)
        q = (energy if 0 < energy < np.inf else 1.0) / size**2
        wide = remade(
            nominal,
            G=np.hstack([nominal.G, into]),
            disturbances=Signals([*nominal.disturbances.names, *(f"mismatch {k + 1}" for k in range(into.shape[1]))]),
        )
        inside = CostFunction(P2=given.prior, Qw=block_diag(given.w, np.diag(q)), R=given.R, Qv=given.v, eta=given.eta)
        super().__init__(wide, cost=inside, input_side=input_side, maximum_delay=maximum_delay)
        output_mismatch = np.array(moved(plant, _reach(plant), "C")).reshape(-1, *nominal.C.shape)
        no_disturbance = None if bound is None else np.zeros(wide.n_disturbances)
        bounds = MismatchBounds(self.weights, no_disturbance, v_bound, initial_error, energy, output_mismatch)
        self.mismatch = MismatchLoop(self.table, bounds, rows, known, q)
        self.prepare(Recorder(self.mismatch, ScheduleClaim(NO_CLAIM), None), input_side)
        self.start(prior, prior_time)

    weighs_means = False  # what a mean shows of the mismatch is not bounded

    def _advance(self, state: EstimatorState, sample: RecordRow) -> HistoryNode:
        with self.mismatch.along(state.inputs):
            return super()._advance(state, sample)

    def _predict(self, state: EstimatorState, t: float) -> Estimate:
        with self.mismatch.along(state.inputs):
            return super()._predict(state, t)


def _channels(plant: UncertainPlant, w_bound: Array | None) -> tuple[Array, Array, Array]:
    """Columns (n, m + k) of the mismatch, the rows (m, n) of x that drive the first, sizes (k,) of the others."""
    columns, rows = mismatch(plant, _reach(plant))
    others, sizes = [], []
    if w_bound is not None:
        for G in moved(plant, _reach(plant), "G"):
            on = np.flatnonzero(G.any(axis=0))
            others.append(G[:, on])
            sizes.append(np.broadcast_to(w_bound, (G.shape[1],))[on])
    n = plant.n_states
    into = np.hstack([np.zeros((n, 0)), *columns, *others])
    return into, ROUNDING * np.vstack([np.zeros((0, n)), *rows]), np.concatenate([np.zeros(0), *sizes])


def _reach(plant: UncertainPlant) -> Array:
    """How far each parameter may be from its nominal value."""
    return np.array([max(each.high - each.nominal, each.nominal - each.low) for each in plant.parameters])
