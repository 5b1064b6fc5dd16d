"""Composite samples in the window problem: means of outputs over an interval as exact rows.

Given the states x_j at the nodes, the integral of an output over each gap is linear in the states at its ends, but for
a part of w that leads nowhere else. With I the integral, d the gap's displacement and [[W, c], [c', b]] the Gramian of
both,
    I = E x_j + c'W^+ d + r,    of cost r^2/(b - c'W^+ c),
so that the mean is a row of all states of its interval, and r joins its noise. What K means add to a problem
of minimiser x* and trajectories x* + T z (`smoother.py`) is of rank K:
    min |z|^2 + |target - g x* - g T z|^2_{V^-1}.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.gap_flows.flows import FlowTable, noise_root
from sampling_design.estimators.online.history import EstimatorState
from sampling_design.estimators.window.window_estimate import DUAL_MARGIN, WindowEstimate
from sampling_design.numerics.filtering import propagate
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array


class MeanReading(NamedTuple):
    """A mean over the nodes from `begin` to `end` of an output, D u in it."""

    output: int
    begin: int
    end: int
    value: float


def means_of(sample: RecordRow) -> tuple[tuple[int, float, float], ...]:
    """Return output, beginning and value of the means that a sample holds as numbers, none of them a limit."""
    return tuple(
        (each.output, each.since, each.lower)
        for each in sample.censored
        if each.since is not None and each.lower == each.upper
    )


@dataclass(frozen=True, eq=False)
class MeanRows:
    """The means of one window, as rows of the deviations from its reference.

    Attributes
    ----------
    readings : K readings
    rows : (K, N+1, n)
    target : (K,)
        What they show beyond the reference.
    spread : (K, K)
        V, in units of the window's cost.
    masks : (N+1, p)
        1.0 where a mean was read.
    y : (N+1, p)
        Means, 0 elsewhere.
    """

    readings: tuple[MeanReading, ...]
    rows: Array
    target: Array
    spread: Array
    masks: Array
    y: Array

    def without(self, k: int) -> MeanRows | None:
        """Return all but one; None where there is no other."""
        kept = [j for j in range(len(self.readings)) if j != k]
        if not kept:
            return None
        one = self.readings[k]
        masks, y = self.masks.copy(), self.y.copy()
        masks[one.end, one.output] = y[one.end, one.output] = 0.0
        readings = tuple(self.readings[j] for j in kept)
        return MeanRows(readings, self.rows[kept], self.target[kept], self.spread[np.ix_(kept, kept)], masks, y)


class IntegralFlows:
    """Flows of a plant's state and of the integrals of all its outputs, with the same disturbance."""

    def __init__(self, weights: CostWeights, constant_w: bool = False):
        plant, n = weights.plant, weights.plant.n_states
        p = plant.n_outputs
        A = np.zeros((n + p, n + p))
        A[:n, :n], A[n:, :n] = plant.A, plant.C
        longer = Plant(
            A, np.hstack([plant.C, np.zeros((p, p))]), B=np.vstack([plant.B, plant.D]), D=plant.D,
            G=np.vstack([plant.G, np.zeros((p, plant.n_disturbances))]), time_unit=plant.time_unit,
        )  # fmt: skip
        prior = block_diag(weights.prior, np.diag(plant.outputs.scales**-2.0))
        self.n, self.weights = n, weights
        self.table = FlowTable(replace(weights, plant=longer, prior=prior), constant_w)

    def means(
        self, state: EstimatorState, times: Sequence[float], reference: Array, residual: Array, masks: Array,
        readings: Sequence[MeanReading],
    ) -> MeanRows:  # fmt: skip
        """Return means as rows; residual and masks are those of the window's plain readings."""
        n, weights, count = self.n, self.weights, len(readings)
        p = weights.plant.n_outputs
        rows, predicted_means = np.zeros((count, len(times), n)), np.zeros(count)
        length = np.array([times[r.end] - times[r.begin] for r in readings])
        picked = np.zeros((count, p))
        picked[np.arange(count), [r.output for r in readings]] = 1 / length
        spread = np.zeros((count, count))
        grown = np.exp(weights.eta * (times[-1] - np.asarray(times)))
        bare = state._replace(reached=None)
        flows = self.table.get([b - a for a, b in pairwise(times)])
        for j, flow in enumerate(flows):
            inside = [k for k, r in enumerate(readings) if r.begin <= j < r.end]
            if not inside:
                continue
            F, W, drift = flow.F, flow.W, bare.drift(self.table, times[j], times[j + 1])
            whiten = noise_root(W[:n, :n])[1]
            gain = (W[n:, :n] @ whiten.T) @ whiten
            moved = reference[j + 1] - F[:n, :n] @ reference[j] - drift[:n]
            rest = W[n:, n:] - gain @ W[:n, n:]
            take = picked[inside]
            predicted_means[inside] += take @ (F[n:, :n] @ reference[j] + drift[n:] + gain @ moved)
            rows[inside, j] += take @ (F[n:, :n] - gain @ F[:n, :n])
            rows[inside, j + 1] += take @ gain
            at = np.ix_(inside, inside)
            spread[at] = propagate((rest + rest.T) / 2 * grown[j + 1], take, spread[at])
        together, y = np.zeros_like(masks), np.zeros_like(masks)
        for r in readings:
            together[r.end, r.output], y[r.end, r.output] = 1.0, r.value
        target = np.array([r.value for r in readings]) - predicted_means
        for end in {r.end for r in readings}:
            own = [k for k, r in enumerate(readings) if r.end == end]
            outputs = [readings[k].output for k in own]
            weight = weights.at(masks[end] + together[end]).y
            part = weight[np.ix_(outputs, outputs)]
            beside = -np.linalg.solve(part, weight[outputs] * masks[end])
            target[own] -= beside @ residual[end]
            rows[own, end] -= beside @ weights.plant.C
            spread[np.ix_(own, own)] += np.linalg.solve(part, np.eye(len(own))) * grown[end]
        return MeanRows(tuple(readings), rows, target, (spread + spread.T) / 2, together, y)


def with_means(solution: WindowEstimate, reference: Array, means: MeanRows) -> WindowEstimate:
    """Return the minimiser with the means, given that without them.

    Notes
    -----
    *Numerical aspects.* V is definite, since noise is; the covariance is a product with its own root.
    """
    count = len(means.target)
    flat = means.rows.reshape(count, -1)
    left = means.target - flat @ (solution.nodes - reference).ravel()
    root = np.linalg.cholesky(means.spread)
    half = np.linalg.solve(root, np.column_stack([solution.spread.rows(flat), left]))
    B, r = half[:, :-1], half[:, -1]
    U, s, Z = np.linalg.svd(B, full_matrices=False)
    inside = U.T @ r
    z = Z.T @ (s / (1 + s**2) * inside)
    # |r|^2 - sum s^2/(1 + s^2) inside^2, without cancellation
    beside = r - U @ inside
    added = float(beside @ beside + np.sum(inside**2 / (1 + s**2)))
    predicted_means = np.linalg.solve(root, means.target)
    spread = replace(solution.spread, known=(Z, 1 - 1 / np.sqrt(1 + s**2)))
    n, size = len(solution.covariance), flat.shape[1]
    last = spread.rows(np.eye(n, size, size - n))
    return replace(
        solution,
        nodes=solution.nodes + solution.spread.states(z),
        covariance=last @ last.T,
        cost=solution.cost + added,
        dual=solution.dual + added - DUAL_MARGIN * (added + float(predicted_means @ predicted_means)),
        spread=spread,
    )
