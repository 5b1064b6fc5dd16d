"""The states of an optimum between its nodes, where constraints are checked, too."""

from __future__ import annotations

import math

import numpy as np

from sampling_design.estimators.gap_flows.flows import CACHE_SIZE, FlowTable, GapFlow
from sampling_design.estimators.online.history import EstimatorState
from sampling_design.estimators.window.sliding import OptimalTrajectory
from sampling_design.records.arrays import Array

SAME_TIME_ULPS = 4.0
"""A window start within so many units in the last place of the times of a sample is that sample's time."""


def pieces(gap: float, spacing: float) -> int:
    """Into how many equal parts, none longer than `spacing`, a gap is cut."""
    return math.ceil(gap / spacing * (1 - SAME_TIME_ULPS * math.ulp(1.0)))


class CheckPoints:
    """Points between two nodes, at most `spacing` apart, remembered by gap length.

    Notes
    -----
    *Method.* Of all ways from x_0 to x_1 over a gap h = a + b the cheapest passes at a through
    F_a x_0 + drift + e^{eta b} W_a F_b' W_h^-1 (x_1 - F_h x_0 - drift_h).
    """

    def __init__(self, table: FlowTable, spacing: float):
        self._table, self._spacing = table, spacing
        self._known: dict[float, tuple[list[float], Array, Array] | None] = {}

    def states(self, state: EstimatorState, times: list[float], path: OptimalTrajectory) -> Array | None:
        """Return an optimum at all check points, (K, n); None where that would lose digits."""
        found = [np.zeros((0, path.nodes.shape[1]))]
        for j, flow in enumerate(path.flows):
            if flow.gap not in self._known:
                if len(self._known) >= CACHE_SIZE:
                    self._known.clear()
                self._known[flow.gap] = self._flows_to_points(flow)
            led = self._known[flow.gap]
            if led is None:
                return None
            after, F, bridge = led
            missed = path.deviation[j + 1] - flow.F.dot(path.deviation[j]) - path.defect[j]
            points = F.dot(path.nodes[j]) + bridge.dot(missed)
            if len(state.inputs):
                points += np.array([state.drift(self._table, times[j], times[j] + a) for a in after]).reshape(
                    F.shape[:2]
                )
            found.append(points)
        return np.concatenate(found)

    def _flows_to_points(self, flow: GapFlow) -> tuple[list[float], Array, Array] | None:
        """Return how long after a node its check points are, and what leads there from x_0 and from what is missed."""
        n, count = len(flow.F), pieces(flow.gap, self._spacing)
        after = [k * flow.gap / count for k in range(1, count)]
        F, bridge = np.zeros((2, len(after), n, n))
        if not after:
            return after, F, bridge
        if flow.joint is None:
            return None
        both = zip(self._table.get(after), self._table.get(after[::-1]), strict=True)
        for k, (a, b) in enumerate(both):
            F[k], bridge[k] = a.F, b.growth * a.W.dot(b.F.T).dot(flow.joint[n:, n:])
        return after, F, bridge
