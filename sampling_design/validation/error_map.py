"""The estimation error as a linear map of initial error, disturbance and noise; whole batches of runs at once.

Without active constraints the estimator's error does not depend on the state itself. In coordinates of the error
a window is a filter started anew: e = F e - d between events, e = e + K (v - C e) at a sample, with gains that
depend on the schedule alone. States that grow never enter, so they cannot drown the errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.estimators.online.verdict import ROUNDING
from sampling_design.numerics.filtering import carried, covariance_root, inverse_of_root, root_update
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.records.arrays import Array
from sampling_design.records.record import short
from sampling_design.validation.scenario import ErrorSources, ScenarioBounds
from sampling_design.validation.timeline import Timeline

ROUNDED = 1e-13
"""Relative error of errors that pass through all windows: some ten times what one gap and one sample cost."""


@dataclass(frozen=True, eq=False)
class SolveWindow:
    """One solve: from event `start` to event `end`; `given` if the prior is the given one.

    `absorbs` has by event (sample, gain, root): e += gain innovation, cost += |root innovation|^2. `worst` is
    lambda_max(P, Y) at the start, `known` the part of the radius that noise bounds give.
    """

    start: int
    end: int
    given: bool
    absorbs: dict[int, tuple[int, Array, Array]]
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

    Raises
    ------
    ArgumentError
        If covariances grow beyond double precision in a gap.
    """

    def __init__(self, timeline: Timeline, estimator: OnlineEstimator, bounds: ScenarioBounds):
        line, weights = timeline, estimator.weights
        self.timeline, self.weights, eta = line, weights, weights.eta
        gaps = np.diff(line.times[line.events])
        self.F, W = discounted_flow(line.plant.A, weights.noise, gaps, eta)  # (K, n, n), between events
        beyond = ~(np.isfinite(self.F) & np.isfinite(W)).all(axis=(1, 2))
        if beyond.any():
            raise ArgumentError(
                "`schedule` must not leave the plant alone until it has grown beyond double precision, as at "
                f"t = {short(line.times[line.events][1:][beyond][0])} {line.plant.time_unit}."
            )
        self.noise = [covariance_root(each) for each in W]
        self.growth, self.decay = np.exp(eta * gaps / 2), np.exp(-eta * gaps)
        self.weigh = weights.of(line.masks).y_root  # (N, p, p) and (N, p, n): weighted rows of v and C at each sample
        self.H = self.weigh @ line.plant.C
        self.filtered = getattr(estimator, "arrival_cost", "fixed") == "filtered"
        self.place = {int(b): k for k, b in enumerate(line.events)}
        self.energies = weights.sample_energy(bounds.v, False, line.masks)
        self.w_energy, self.prior_energy = weights.disturbance_energy(bounds.w), weights.prior_energy(bounds.e0)
        self.windows: dict[int, SolveWindow] = {}  # by the event at which they end
        roots = self._roots()
        self.half = inverse_of_root(roots)  # (R, n, n), and |half e|^2 = |e|^2_Pi at each row
        self.spread = np.linalg.norm(np.abs(self.half) @ np.abs(roots), axis=(1, 2))  # digits that these lost

    def _roots(self) -> Array:
        """Solve every window; return roots of the covariances at the rows."""
        line, eta = self.timeline, self.weights.eta
        noise = discounted_flow(line.plant.A, self.weights.noise, line.lengths, eta)[1]
        S, roots = self.weights.prior_root, list[Array]()
        online: dict[int, Array] = {}
        for b in range(line.times.size):
            if b:
                S = carried(np.exp(eta * line.lengths[b - 1] / 2) * S, line.F[b - 1], covariance_root(noise[b - 1]))
            if b in line.sample_at:
                roots.append(S)
                window, S = self._window(b, online)
                self.windows[window.end] = window
            if b in self.place:
                online[self.place[b]] = S
            roots.append(S)
        return np.array(roots)

    def _window(self, b: int, online: dict[int, Array]) -> tuple[SolveWindow, Array]:
        line, j, eta = self.timeline, self.timeline.sample_at[b], self.weights.eta
        start, end, times = self.place[int(line.starts[j])], self.place[b], line.times[line.events]
        given = bool(line.given[j])
        S, worst = self.weights.prior_root, 1.0
        if not given:
            worst = 1.0 if self.filtered else float(np.linalg.norm(self.weights.prior_factor.T @ online[start], 2)) ** 2
            S = online[start] if self.filtered else S
        length = times[end] - times[start]
        known = self.w_energy * float(discounted_length(eta, length)) if length > 0 else 0.0
        absorbs: dict[int, tuple[int, Array, Array]] = {}
        for k in range(start, end + 1):
            if k > start:
                S = carried(self.growth[k - 1] * S, self.F[k - 1], self.noise[k - 1])
            sample = line.sample_at.get(int(line.events[k]))
            if sample is not None and (k > start or given or self.weights.cost == "paper"):
                S, gain, root = root_update(S, self.H[sample], np.eye(len(self.H[sample])))
                absorbs[k] = sample, gain, root
                known += self.energies[sample] * float(np.exp(eta * (times[k] - times[end])))
        return SolveWindow(start, end, given, absorbs, float(np.exp(-eta * length)), worst, known), S

    def apply(self, inputs: ErrorSources) -> RunErrors:
        """Return errors and radii of a batch of runs; infinite or NaN what grows beyond all numbers."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self._applied(inputs)

    def _applied(self, inputs: ErrorSources) -> RunErrors:
        line, runs = self.timeline, inputs.e0.shape[0]
        n, size, eta = line.plant.n_states, line.rows.at.size, self.weights.eta
        d = self._displacements(inputs.w)
        v = np.einsum("jab,rjb->jra", self.weigh, inputs.v)
        e, radius = np.array(inputs.e0), np.full(runs, self.prior_energy)
        errors, radii, led = np.empty((size, runs, n)), np.empty((size, runs)), np.empty((size, runs, n))
        online: list[tuple[Array, Array]] = [(e, radius)] * line.events.size
        row, before = 0, np.abs(e)
        for b in range(line.times.size):
            if b:
                before = np.abs(e) @ np.abs(line.F[b - 1]).T
                e = e @ line.F[b - 1].T - inputs.w[:, b - 1] @ line.gamma[b - 1].T
                h = line.lengths[b - 1]
                radius = np.asarray(radius * np.exp(-eta * h) + self.w_energy * discounted_length(eta, h))
            if b in line.sample_at:
                errors[row], radii[row], led[row] = e, radius, before
                row += 1
                before = np.abs(e)
                e, radius = self._solve(self.windows[self.place[b]], online, (inputs.e0, d, v))
            if b in self.place:
                online[self.place[b]] = e, radius
            errors[row], radii[row], led[row] = e, radius, before
            row += 1
        moved = self._rounded(np.maximum(np.abs(errors), led)) + ROUNDED * self.spread[:, None] * np.sqrt(radii)
        return RunErrors(errors.transpose(1, 0, 2), (radii + (2 * np.sqrt(radii) + moved) * moved).T)

    def _rounded(self, sizes: Array) -> Array:
        """By how much rounding of numbers of these sizes (R, r, n) may move errors, in units of the ellipsoids."""
        held = np.linalg.norm(np.einsum("kab,krb->kra", np.abs(self.half), sizes), axis=2)
        faded = np.exp(-self.weights.eta / 2 * np.diff(self.timeline.rows.times))
        for k, share in enumerate(faded.tolist(), 1):
            held[k] += share * held[k - 1]
        return np.asarray(ROUNDED * held)

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
            if k in window.absorbs:
                sample, gain, root = window.absorbs[k]
                innovation = v[sample] - e @ self.H[sample].T
                cost = cost + np.sum((innovation @ root.T) ** 2, axis=1)
                e = e + innovation @ gain.T
        terms = window.discount * window.worst * radius + window.known
        return e, np.maximum(terms - cost, 0.0) + (ROUNDING + self.weights.loose) * terms

    def _displacements(self, w: Array) -> Array:
        """What w adds to the state between events, (K, r, n)."""
        line = self.timeline
        d = np.zeros((line.events.size - 1, w.shape[0], line.plant.n_states))
        for k, (a, b) in enumerate(zip(line.events[:-1], line.events[1:], strict=True)):
            for c in range(a, b):
                d[k] = d[k] @ line.F[c].T + w[:, c] @ line.gamma[c].T
        return d

    def ellipsoid_ratio(self, errors: RunErrors) -> Array:
        """Return |e|^2_Pi / radius, (r, R): at most 1 where the ellipsoid holds the truth; NaN beyond all numbers."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            away = np.linalg.norm(np.einsum("kab,rkb->rka", self.half, errors.e), axis=2)
            return np.where(away == 0, 0.0, away / np.sqrt(errors.radius)) ** 2
