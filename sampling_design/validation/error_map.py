"""The estimation error as a linear map of initial error, disturbance and noise; whole batches of runs at once.

Without active constraints the estimator's error does not depend on the state itself. In coordinates of the error
a window is a filter started anew: e = F e - d between events, e = e + K (v - C e) at a sample, with gains that
depend on the schedule alone. States that grow never enter, so they cannot drown the errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.numerics.filtering import propagate, update_with_gain, whitened
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.records.arrays import Array
from sampling_design.validation.scenario import ErrorSources, ScenarioBounds
from sampling_design.validation.timeline import Timeline


class SampleUpdate(NamedTuple):
    """What a window does with a sample: e += gain innovation, cost += |root innovation|^2."""

    sample: int
    gain: Array
    root: Array


@dataclass(frozen=True, eq=False)
class SolveWindow:
    """One solve: from event `start` to event `end`; `absorbs` by event; `given` if the prior is the given one.

    `worst` is lambda_max(P, Y) at the start, `known` the part of the radius that noise bounds give.
    """

    start: int
    end: int
    given: bool
    absorbs: dict[int, SampleUpdate]
    discount: float
    worst: float
    known: float


class RunErrors(NamedTuple):
    """Errors xhat - x (r, R, n) and radii (r, R) of r runs at the rows of a map."""

    e: Array
    radius: Array


class ErrorMap:
    """Error of an estimator with given weights and horizon along a timeline: covariances and gains of all its windows.

    Parameters
    ----------
    timeline : Timeline
        Built with the estimator's horizon.
    estimator : MovingHorizonEstimator
        Or another that names its `weights` (prior, w, y, eta); `arrival_cost` is "fixed" where it names none. A cost
        "paper" means windows closed at their start.
    bounds : ScenarioBounds
        For the radii.
    """

    def __init__(self, timeline: Timeline, estimator: OnlineEstimator, bounds: ScenarioBounds):
        line, weights = timeline, estimator.weights
        self.timeline, self.weights, eta = line, weights, weights.eta
        gaps = np.diff(line.times[line.events])
        self.F, self.W = discounted_flow(line.plant.A, weights.noise, gaps, eta)  # (K, n, n), between events
        self.growth, self.decay = np.exp(eta * gaps), np.exp(-eta * gaps)
        self.weigh = weights.of(line.masks).y_root  # (N, p, p) and (N, p, n): weighted rows of v and C at each sample
        self.H = self.weigh @ line.plant.C
        self.prior = weights.prior_root @ weights.prior_root.T
        self.filtered = getattr(estimator, "arrival_cost", "fixed") == "filtered"
        self.place = {int(b): k for k, b in enumerate(line.events)}
        self.energies = weights.sample_energy(bounds.v, False, line.masks)
        self.w_energy, self.prior_energy = weights.disturbance_energy(bounds.w), weights.prior_energy(bounds.e0)
        self.windows: dict[int, SolveWindow] = {}  # by the event at which they end
        covariances = self._covariances()  # (R, n, n), and |half e|^2 = |e|^2_Pi at each row
        self.half = np.asarray(np.linalg.solve(np.linalg.cholesky(covariances), np.eye(line.plant.n_states)))

    def _covariances(self) -> Array:
        """Solve every window; return the covariances at the rows."""
        line, eta = self.timeline, self.weights.eta
        noise = discounted_flow(line.plant.A, self.weights.noise, line.lengths, eta)[1]
        Y, covariances = self.prior, []
        online: dict[int, Array] = {}
        for b in range(line.times.size):
            if b:
                Y = propagate(np.exp(eta * line.lengths[b - 1]) * Y, line.F[b - 1], noise[b - 1])
            if b in line.sample_at:
                covariances.append(Y)
                window, Y = self._window(b, online)
                self.windows[window.end] = window
            if b in self.place:
                online[self.place[b]] = Y
            covariances.append(Y)
        return np.array(covariances)

    def _window(self, b: int, online: dict[int, Array]) -> tuple[SolveWindow, Array]:
        line, j, eta = self.timeline, self.timeline.sample_at[b], self.weights.eta
        start, end, times = self.place[int(line.starts[j])], self.place[b], line.times[line.events]
        given = bool(line.given[j])
        Y, worst = self.prior, 1.0
        if not given:
            factor = self.weights.prior_factor
            worst = 1.0 if self.filtered else float(np.linalg.eigvalsh(factor.T @ online[start] @ factor)[-1])
            Y = online[start] if self.filtered else Y
        length = times[end] - times[start]
        known = self.w_energy * float(discounted_length(eta, length)) if length > 0 else 0.0
        absorbs: dict[int, SampleUpdate] = {}
        for k in range(start, end + 1):
            if k > start:
                Y = propagate(self.growth[k - 1] * Y, self.F[k - 1], self.W[k - 1])
            sample = line.sample_at.get(int(line.events[k]))
            if sample is not None and (k > start or given or self.weights.cost == "paper"):
                absorbs[k], Y = self._absorbed(sample, Y)
                known += self.energies[sample] * float(np.exp(eta * (times[k] - times[end])))
        return SolveWindow(start, end, given, absorbs, float(np.exp(-eta * length)), worst, known), Y

    def _absorbed(self, j: int, Y: Array) -> tuple[SampleUpdate, Array]:
        H = self.H[j]
        unit = np.eye(len(H))
        root = whitened(unit, propagate(Y, H, unit))
        Y, gain = update_with_gain(Y, H)
        return SampleUpdate(j, gain, root), Y

    def apply(self, inputs: ErrorSources) -> RunErrors:
        """Return errors and radii of a batch of runs."""
        line, runs = self.timeline, inputs.e0.shape[0]
        n, size, eta = line.plant.n_states, line.rows.at.size, self.weights.eta
        d = self._displacements(inputs.w)
        v = np.einsum("jab,rjb->jra", self.weigh, inputs.v)
        e, radius = np.array(inputs.e0), np.full(runs, self.prior_energy)
        errors, radii = np.empty((size, runs, n)), np.empty((size, runs))
        online: list[tuple[Array, Array]] = [(e, radius)] * line.events.size
        row = 0
        for b in range(line.times.size):
            if b:
                e = e @ line.F[b - 1].T - inputs.w[:, b - 1] @ line.gamma[b - 1].T
                h = line.lengths[b - 1]
                radius = np.asarray(radius * np.exp(-eta * h) + self.w_energy * discounted_length(eta, h))
            if b in line.sample_at:
                errors[row], radii[row] = e, radius
                row += 1
                e, radius = self._solve(self.windows[self.place[b]], online, (inputs.e0, d, v))
            if b in self.place:
                online[self.place[b]] = e, radius
            errors[row], radii[row] = e, radius
            row += 1
        return RunErrors(errors.transpose(1, 0, 2), radii.T)

    def _solve(
        self, window: SolveWindow, online: list[tuple[Array, Array]], given: tuple[Array, Array, Array]
    ) -> tuple[Array, Array]:
        e0, d, v = given
        e, radius = (e0, np.full(e0.shape[0], self.prior_energy)) if window.given else online[window.start]
        cost = np.zeros(e0.shape[0])
        for k in range(window.start, window.end + 1):
            if k > window.start:
                e = e @ self.F[k - 1].T - d[k - 1]
                cost = cost * self.decay[k - 1]
            absorb = window.absorbs.get(k)
            if absorb is not None:
                innovation = v[absorb.sample] - e @ self.H[absorb.sample].T
                cost = cost + np.sum((innovation @ absorb.root.T) ** 2, axis=1)
                e = e + innovation @ absorb.gain.T
        return e, np.maximum(window.discount * window.worst * radius + window.known - cost, 0.0)

    def _displacements(self, w: Array) -> Array:
        """What w adds to the state between events, (K, r, n)."""
        line = self.timeline
        d = np.zeros((line.events.size - 1, w.shape[0], line.plant.n_states))
        for k, (a, b) in enumerate(zip(line.events[:-1], line.events[1:], strict=True)):
            for c in range(a, b):
                d[k] = d[k] @ line.F[c].T + w[:, c] @ line.gamma[c].T
        return d

    def ellipsoid_ratio(self, errors: RunErrors) -> Array:
        """Return |e|^2_Pi / radius, (r, R): at most 1 where the ellipsoid holds the truth."""
        square = np.sum(np.einsum("kab,rkb->rka", self.half, errors.e) ** 2, axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = square / errors.radius
        return np.where(errors.radius > 0, ratio, np.where(square > 0, np.inf, 0.0))
