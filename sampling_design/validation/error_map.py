"""The estimation error as a linear map of initial error, disturbance and noise; whole batches of runs at once.

Without active constraints the estimator's error does not depend on the state itself. In coordinates of the error
a window is a filter started anew: e = F e - d between events, e = e + K (v - C e) at a sample, with gains that
depend on the schedule alone. States that grow never enter, so they cannot drown the errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.numerics.filtering import propagate, update_with_gain, whitened
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.records.arrays import Array, Index, Mask
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


@dataclass(frozen=True, eq=False)
class ErrorRows:
    """Where errors are looked at: every break point, a sample's both before and after it."""

    at: Index
    after: Mask
    times: Array

    @cached_property
    def samples(self) -> Index:
        """Rows just after a sample: those whose break point has a row before."""
        return np.flatnonzero(np.concatenate([[False], self.at[1:] == self.at[:-1]]))


class RunErrors(NamedTuple):
    """Errors xhat - x (r, R, n) and radii (r, R) of r runs at the rows of a map."""

    e: Array
    radius: Array


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Error of an estimator with given weights and horizon along a timeline. Built by `build_error_map`."""

    timeline: Timeline
    F: Array  # F, decay, (K, n, n), (K,): flow and discount between events
    decay: Array
    windows: tuple[SolveWindow, ...]
    rows: ErrorRows
    half: Array  # (R, n, n): |half e|^2 = |e|^2_Pi at each row
    H: Array  # (N, p, n): weighted rows of C and of v at each sample
    weigh: Array
    w_energy: float
    prior_energy: float
    eta: float

    def apply(self, inputs: ErrorSources) -> RunErrors:
        """Return errors and radii of a batch of runs."""
        line, runs = self.timeline, inputs.e0.shape[0]
        n, rows = line.plant.n_states, self.rows
        events = {int(b): k for k, b in enumerate(line.events)}
        solves = {window.end: window for window in self.windows}
        d = self._displacements(inputs.w)
        v = np.einsum("jab,rjb->jra", self.weigh, inputs.v)
        e, radius = np.array(inputs.e0), np.full(runs, self.prior_energy)
        errors, radii = np.empty((rows.at.size, runs, n)), np.empty((rows.at.size, runs))
        online: list[tuple[Array, Array]] = [(e, radius)] * line.events.size
        row = 0
        for b in range(line.times.size):
            if b:
                e = e @ line.F[b - 1].T - inputs.w[:, b - 1] @ line.gamma[b - 1].T
                radius = self._radius_after(radius, line.lengths[b - 1])
            k = events.get(b)
            if k is not None and k in solves:
                errors[row], radii[row] = e, radius
                row += 1
                e, radius = self._solve(solves[k], online, (inputs.e0, d, v))
            if k is not None:
                online[k] = e, radius
            errors[row], radii[row] = e, radius
            row += 1
        return RunErrors(errors.transpose(1, 0, 2), radii.T)

    def _radius_after(self, radius: Array, h: float) -> Array:
        return np.asarray(radius * np.exp(-self.eta * h) + self.w_energy * discounted_length(self.eta, h))

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
        worst = 1.0 if window.given else window.worst
        return e, np.maximum(window.discount * worst * radius + window.known - cost, 0.0)

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


def build_error_map(timeline: Timeline, estimator: OnlineEstimator, bounds: ScenarioBounds) -> ErrorMap:
    """Return the error map of an estimator that names its `weights` (prior, w, y, eta), and `arrival_cost`.

    Parameters
    ----------
    timeline : Timeline
        Built with the estimator's horizon.
    estimator : MovingHorizonEstimator
        Or another with such weights; `arrival_cost` is "fixed" where it names none. A cost "paper" means windows
        closed at their start.
    bounds : Bounds
        For the radii.
    """
    return _ErrorMapBuilder(estimator, timeline, bounds).build()


class _ErrorMapBuilder:
    """Covariances and gains of all windows, in order of time."""

    def __init__(self, estimator: OnlineEstimator, line: Timeline, bounds: ScenarioBounds):
        self.weights, self.line, self.bounds = estimator.weights, line, bounds
        gaps, eta = np.diff(line.times[line.events]), self.weights.eta
        self.F, self.W = discounted_flow(line.plant.A, self.weights.noise, gaps, eta)
        self.growth, self.decay = np.exp(eta * gaps), np.exp(-eta * gaps)
        self.weigh = self.weights.of(line.masks).y_root
        self.H = self.weigh @ line.plant.C
        self.filtered = getattr(estimator, "arrival_cost", "fixed") == "filtered"
        self.closed = self.weights.cost == "paper"
        self.prior = self.weights.prior_root @ self.weights.prior_root.T
        self.place = {int(b): k for k, b in enumerate(line.events)}
        self.sample_of = {self.place[int(b)]: j for j, b in enumerate(line.samples)}
        self.energies = self.weights.sample_energy(bounds.v, False, line.masks)
        self.w_energy = self.weights.disturbance_energy(bounds.w)

    def build(self) -> ErrorMap:
        """The map of all windows."""
        line, eta = self.line, self.weights.eta
        noise = discounted_flow(line.plant.A, self.weights.noise, line.lengths, eta)[1]
        Y, windows, covariances, at, after = self.prior, [], [], [], []
        online = {0: Y}
        for b in range(line.times.size):
            if b:
                Y = propagate(np.exp(eta * line.lengths[b - 1]) * Y, line.F[b - 1], noise[b - 1])
            k = self.place.get(b)
            if k is not None and k in self.sample_of:
                covariances.append(Y)
                at.append(b)
                after.append(False)
                window, Y = self._window(k, online)
                windows.append(window)
            if k is not None:
                online[k] = Y
            covariances.append(Y)
            at.append(b)
            after.append(True)
        half = np.asarray(np.linalg.solve(np.linalg.cholesky(np.array(covariances)), np.eye(Y.shape[0])))
        rows = ErrorRows(np.array(at), np.array(after), line.times[at])
        return ErrorMap(
            timeline=line, F=self.F, decay=self.decay, windows=tuple(windows), rows=rows, half=half, H=self.H,
            weigh=self.weigh, w_energy=self.w_energy, prior_energy=self.weights.prior_energy(self.bounds.e0), eta=eta,
        )  # fmt: skip

    def _window(self, end: int, online: dict[int, Array]) -> tuple[SolveWindow, Array]:
        j, times = self.sample_of[end], self.line.times[self.line.events]
        start = self.place[int(self.line.starts[j])]
        given = bool(self.line.given[j])
        Y, worst = self.prior, 1.0
        if not given:
            factor = self.weights.prior_factor
            worst = 1.0 if self.filtered else float(np.linalg.eigvalsh(factor.T @ online[start] @ factor)[-1])
            Y = online[start] if self.filtered else Y
        length = times[end] - times[start]
        known = self.w_energy * float(discounted_length(self.weights.eta, length)) if length > 0 else 0.0
        absorbs: dict[int, SampleUpdate] = {}
        for k in range(start, end + 1):
            if k > start:
                Y = propagate(self.growth[k - 1] * Y, self.F[k - 1], self.W[k - 1])
            if k in self.sample_of and (k > start or given or self.closed):
                absorbs[k], Y = self._absorbed(self.sample_of[k], Y)
                known += self.energies[self.sample_of[k]] * float(np.exp(self.weights.eta * (times[k] - times[end])))
        return SolveWindow(start, end, given, absorbs, float(np.exp(-self.weights.eta * length)), worst, known), Y

    def _absorbed(self, j: int, Y: Array) -> tuple[SampleUpdate, Array]:
        H = self.H[j]
        unit = np.eye(len(H))
        root = whitened(unit, propagate(Y, H, unit))
        Y, gain = update_with_gain(Y, H)
        return SampleUpdate(j, gain, root), Y
