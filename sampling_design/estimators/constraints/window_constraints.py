"""Constraints of the window problem: sets for x, y, v and w, and how the signals follow from the states."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from sampling_design.estimators.constraints.constrained_signals import ConstrainedSignal
from sampling_design.estimators.constraints.constraints import Constraints
from sampling_design.estimators.constraints.convex_set import ConvexSet, all_inside, convex_set
from sampling_design.estimators.constraints.disturbance import DisturbanceReach
from sampling_design.estimators.constraints.least_distance_problem import ConstraintDemands
from sampling_design.estimators.gap_flows.cost_weights import stretches
from sampling_design.estimators.gap_flows.flows import FlowTable
from sampling_design.estimators.window.sliding import OptimalTrajectory
from sampling_design.estimators.window.window_estimate import WindowEstimate
from sampling_design.estimators.window.window_problem import EstimationWindow
from sampling_design.records.arrays import Array


class WindowConstraints:
    """The sets of one estimator, and what they ask of a window."""

    def __init__(self, table: FlowTable, given: Constraints):
        plant = table.weights.plant
        self.plant, self.weights = plant, table.weights
        self.x = convex_set("constraints.x", given.x, plant.n_states)
        self.y = convex_set("constraints.y", given.y, plant.n_outputs)
        self.v = convex_set("constraints.v", given.v, plant.n_outputs)
        self.w = convex_set("constraints.w", given.w, plant.n_disturbances)
        self.keeps_v = self.v is not None or self.y is not None
        self._omega_names = tuple(f"omega{i + 1}" for i in range(plant.n_states))
        self.reach = None if self.w is None else DisturbanceReach(table, self.w)

    @cached_property
    def active(self) -> bool:
        """Whether there is any constraint."""
        return any(s is not None for s in (self.x, self.y, self.v, self.w))

    @property
    def has_balls(self) -> bool:
        """Whether there is any norm ball."""
        return any(s is not None and s.round_balls for s in (self.x, self.y, self.v, self.w))

    def noise(self, y: Array, masks: Array, nodes: Array) -> Array:
        """Return the best v at every node for given states: (R + Qv)^-1 R (y - C x), measured outputs only.

        `y` without what the input adds.
        """
        found: Array = y - nodes @ self.plant.C.T
        for begin, count in zip(*stretches(masks), strict=True):
            found[begin : begin + count] = found[begin : begin + count] @ self.weights.at(masks[begin]).gain.T
        return found

    def hold(self, path: OptimalTrajectory, samples: Callable[[], tuple[Array, Array, Array]]) -> bool:
        """Whether a trajectory keeps all sets, none by rounding alone. `samples` gives y - D u, the masks, and D u."""
        if self.x is not None and not all_inside(self.x, path.nodes):
            return False
        if self.reach is not None and not self.reach.holds(path.flows, path.deviation, path.defect):
            return False
        if not self.keeps_v:
            return True
        y, masks, feedthrough = samples()
        nodes, measured = path.nodes[-len(y) :], masks > 0
        v = self.noise(y, masks, nodes)
        if self.v is not None and not all_inside(self.v, v, measured):
            return False
        return self.y is None or all_inside(self.y, nodes @ self.plant.C.T + feedthrough + v, measured)

    def demands(self, window: EstimationWindow, free: WindowEstimate) -> ConstraintDemands:
        """Return what the constraints ask of all trajectories around the minimiser without them."""
        nodes = free.nodes
        signals = []
        if self.x is not None:
            at = np.arange(window.times.size)
            unit = np.sqrt(np.diag(free.covariance))
            signals.append(
                ConstrainedSignal("constraints.x", window.times, self.plant.states.names, nodes, [self.x], at, unit)
            )
        if self.keeps_v:
            signals += self._noisy_signals(window, free)
        if window.limits is not None:
            signals.append(self._limited_signal(window, free, window.limits))
        if self.reach is not None and window.flows:
            whiten = np.array([flow.whiten for flow in window.flows])
            base, before = _omegas(window, nodes, whiten), -np.matmul(whiten, window.F)
            names, at = self._omega_names[: whiten.shape[1]], np.arange(1, window.times.size)
            sets = self.reach.over(window.flows)
            signals.append(
                ConstrainedSignal(
                    name="constraints.w",
                    times=window.times[1:],
                    entries=names,
                    base=base,
                    sets=sets,
                    at=at,
                    unit=np.ones(len(names)),
                    here=whiten,
                    before=before,
                )
            )
        return ConstraintDemands(free.spread, signals, *nodes.shape)

    def _limited_signal(self, window: EstimationWindow, free: WindowEstimate, limits: Array) -> ConstrainedSignal:
        """C x where limits of detection were read."""
        measured = np.isfinite(limits[:, 0]) | np.isfinite(limits[:, 1])
        at, C = np.flatnonzero(measured.any(axis=1)), self.plant.C
        known = np.sqrt(np.einsum("ij,jk,ik->i", C, free.covariance, C))
        return ConstrainedSignal(
            name="limits of detection",
            times=window.times[at],
            entries=self.plant.outputs.names,
            base=free.nodes[at] @ C.T,
            sets=[ConvexSet.box(*limits[k]) for k in at],
            at=at,
            unit=np.where(known > 0, known, 1.0),
            here=np.broadcast_to(C, (at.size, *C.shape)),
            measured=measured[at],
        )

    def _noisy_signals(self, window: EstimationWindow, free: WindowEstimate) -> list[ConstrainedSignal]:
        """The noise v = gain (y - C x - D u) + its own part, and the output C x + D u + v, at the samples."""
        plant, at, found, nodes = self.plant, window.samples, [], free.nodes
        unit = np.linalg.norm(self.weights.at(np.ones(plant.n_outputs)).v_root, axis=1)
        known = np.sqrt(np.einsum("ij,jk,ik->i", plant.C, free.covariance, plant.C))
        times, names, taken = window.times[at], plant.outputs.names, window.masks[at] > 0
        v = self.noise(window.y - window.feedthrough, window.masks, nodes)[at]
        kinds = self.weights.of(window.masks[at])
        here = -kinds.gain @ plant.C
        own = kinds.v_root / np.sqrt(window.discount[at])[:, None, None]
        if self.v is not None:
            found.append(
                ConstrainedSignal("constraints.v", times, names, v, [self.v], at, unit, here, own=own, measured=taken)
            )
        if self.y is not None:
            y, wide = nodes[at] @ plant.C.T + window.feedthrough[at] + v, unit + known
            both = plant.C + here
            found.append(
                ConstrainedSignal("constraints.y", times, names, y, [self.y], at, wide, both, own=own, measured=taken)
            )
        return found


def _omegas(window: EstimationWindow, nodes: Array, whiten: Array) -> Array:
    """The least omega of every gap for given states, (N, width)."""
    deviation = nodes - window.reference
    moved = deviation[1:] - np.matmul(window.F, deviation[:-1, :, None])[:, :, 0] - window.defect
    return np.asarray(np.matmul(whiten, moved[:, :, None])[:, :, 0])
