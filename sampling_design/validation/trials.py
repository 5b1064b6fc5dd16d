"""Runs of a real estimator, sample by sample and through its protocol only, beside a truth that is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.estimator import Estimator, estimate_from
from sampling_design.estimators.online.verdict import ROUNDED
from sampling_design.numerics.filtering import inverse_root
from sampling_design.plants.plant import Plant, remade
from sampling_design.records.arrays import Array, Mask
from sampling_design.validation.scenario import ErrorSources, checked_state
from sampling_design.validation.timeline import Timeline, exact_flow

GROWTH = 3.0  # a truth that would grow by more than e^3 in a run is held near zero by a known input


def driven(plant: Plant) -> Plant:
    """Return the plant with an input on every state in place of its own: only that moves an unstable truth about."""
    n = plant.n_states
    return remade(plant, B=np.eye(n), D=np.zeros((plant.n_outputs, n)), inputs=None)


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """A run's true states (T+1, n), outputs (N, p) with NaN where not measured, and inputs (N+1, n), from 0 and each
    each sample on (None where the plant needs none). The prior is 0: the truth starts at minus the initial error. The
    `rounding` (T+1, n) of the states is what all steps until then add up to where nothing grows: at least that."""

    states: Array
    rounding: Array
    y: Array
    u: Array | None


class EstimatedRun(NamedTuple):
    """Estimates at every row of a timeline, the true states (R, n) beside them, and their own rounding (R, n)."""

    estimates: tuple[Estimate, ...]
    states: Array
    rounding: Array

    @property
    def errors(self) -> Array:
        """Errors at the rows, (R, n)."""
        return np.array([e.x for e in self.estimates]) - self.states

    @property
    def ratios(self) -> Array:
        """How far the truth is out in each ellipsoid, (R,): at most 1 where it holds, whatever its rounding."""
        return np.array([_ratio(*each) for each in zip(self.estimates, self.states, self.rounding, strict=True)])

    @property
    def certified(self) -> Mask:
        """Which estimates say that their ellipsoid is proven, (R,); one without an end says nothing."""
        return np.array([bool(e.certified and e.radius != np.inf) for e in self.estimates])


def _ratio(estimate: Estimate, truth: Array, rounding: Array) -> float:
    """The ratio of a truth that is known to its rounding, entry by entry: of the nearest one that it may be."""
    found = estimate.ratio(truth)
    if not found > 1:
        return found
    half = inverse_root(estimate.covariance)
    away = float(np.linalg.norm(half @ (truth - estimate.x)) - np.linalg.norm(np.abs(half) @ rounding))
    if away <= 0:  # of what has shrunk to a point, too
        return 0.0
    return away**2 / estimate.radius if estimate.radius > 0 and away < np.inf else found


def true_run(line: Timeline, inputs: ErrorSources, run: int = 0, *, steered: bool = True) -> SimulatedRun:
    """Simulate the truth of one run of `inputs`, exactly; an unstable one that is `steered` is brought back to zero at
    each sample.

    Raises ArgumentError if it grows beyond all numbers.
    """
    plant = line.plant
    pace = float(np.max(np.linalg.eigvals(plant.A).real, initial=0.0))
    steered = steered and pace * line.times[-1] > GROWTH
    marks = np.unique(np.concatenate([[0], line.samples, [line.cells]]))
    through = exact_flow(plant, line.lengths, np.eye(plant.n_states))[1]
    x, u = -inputs.e0[run], np.zeros(plant.n_states)
    states, outputs, applied = np.empty((line.times.size, x.size)), [], []
    sizes = np.abs(np.broadcast_to(x, states.shape))
    for b in range(line.times.size):
        if b:
            led = np.abs(line.F[b - 1]) @ np.abs(x) + np.abs(line.gamma[b - 1]) @ np.abs(inputs.w[run, b - 1])
            sizes[b] = led + np.abs(through[b - 1]) @ np.abs(u)
            x = line.F[b - 1] @ x + line.gamma[b - 1] @ inputs.w[run, b - 1] + through[b - 1] @ u
        states[b] = checked_state(line, line.times[b], x)
        if b in line.sample_at:
            j = line.sample_at[b]
            outputs.append(np.where(line.masks[j] > 0, plant.C @ x + inputs.v[run, j], np.nan))
        if steered and b in marks[:-1]:
            until = line.times[marks[np.searchsorted(marks, b) + 1]]
            F, G = exact_flow(plant, np.array([until - line.times[b]]), np.eye(x.size))
            u = np.linalg.lstsq(G[0], -checked_state(line, until, F[0] @ x), rcond=None)[0]
        if b in marks:
            applied.append(u)
    first = 1 if line.samples[0] > 0 else 0
    rounding = ROUNDED * np.arange(1, line.times.size + 1)[:, None] * (sizes + np.abs(states))
    given = np.array(applied)[: len(outputs) + first] if steered else None
    return SimulatedRun(states, rounding, np.array(outputs), given)


def real_run(line: Timeline, truth: SimulatedRun, estimator: Estimator) -> EstimatedRun:
    """Feed a truth's outputs to an estimator and ask it at every row."""
    first = 1 if line.samples[0] > 0 else 0
    if truth.u is not None and first:
        estimator.update(0.0, None, truth.u[0])
    estimates: list[Estimate] = []
    j = 0
    for b, after in zip(line.rows.at, line.rows.after, strict=True):
        t = float(line.times[b])
        if after and j < line.samples.size and b == line.samples[j]:
            came = estimator.update(t, truth.y[j], None if truth.u is None else truth.u[j + first])
            j += 1
        else:
            came = estimator.predict(t)
        estimates.append(estimate_from(came, t, truth.states.shape[1]))
    return EstimatedRun(tuple(estimates), truth.states[line.rows.at], truth.rounding[line.rows.at])


def extent(states: Array, room: float = 0.0) -> tuple[Array, Array]:
    """Return a box that holds states (R, n) and the prior 0, wider by `room` times its size."""
    low = np.minimum(states.min(axis=0), 0.0)
    high = np.maximum(states.max(axis=0), 0.0)
    wide = room * (high - low)
    return low - wide, high + wide
