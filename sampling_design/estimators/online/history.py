"""Immutable history of an estimator: what came, and what was said, back to two windows."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow
from sampling_design.estimators.online.estimator import Estimate, Taken

Array = npt.NDArray[np.float64]


class Node(NamedTuple):
    """A processed sample: a snapshot from which everything later can be computed again.

    `flow` and `drift` lead from the node before to this one; `scheduled` says that everything up to here was
    on schedule, `sound` that no assumption was contradicted up to here; `y` is 0 where `mask` is 0; `number` counts
    the samples, 0 is the prior.
    """

    t: float
    y: Array
    mask: Array
    feedthrough: Array
    x: Array
    Y: Array
    beta: float
    flow: GapFlow | None
    drift: Array
    scheduled: bool
    sound: bool
    estimate: Estimate
    sample: Taken
    number: int = 0


class State(NamedTuple):
    """Everything an estimator knows. Never changed; `step` returns a new one.

    Attributes
    ----------
    nodes : tuple of Node, by time; the first is the prior or the oldest snapshot kept.
    inputs : tuple of (t, u), by time; u holds from t on.
    reached : (a, b, drift) or None
        What the inputs add from the last node at a to the last input at b, so that many inputs cost each their own.
    """

    nodes: tuple[Node, ...]
    inputs: tuple[tuple[float, Array], ...] = ()
    reached: tuple[float, float, Array] | None = None

    @property
    def last(self) -> Node:
        """The latest node."""
        return self.nodes[-1]

    def node_before(self, t: float) -> int:
        """Index of the last node at or before t (-1 if there is none)."""
        return bisect_right(self.nodes, t, key=_time) - 1

    def input_at(self, t: float, before: bool = False) -> Array | None:
        """Return the input in force at t (just before t where `before`), None if there is none yet."""
        k = bisect_right(self.inputs, t, key=_first) - 1
        if before and k >= 0 and self.inputs[k][0] == t:
            k -= 1
        return self.inputs[k][1] if k >= 0 else None

    def trimmed(self, memory: float, least: int = 0) -> State:
        """Drop what lies further back than `memory` and than `least` nodes, save the last node and input before."""
        limit = self.last.t - memory
        first = min(self.node_before(limit), len(self.nodes) - 1 - least)
        if first <= 0:
            return self
        nodes = self.nodes[first:]
        keep = max(0, bisect_right(self.inputs, nodes[0].t, key=_first) - 2)
        return State(nodes, self.inputs[keep:])


def _time(node: Node) -> float:
    return node.t


def _first(pair: tuple[float, Array]) -> float:
    return pair[0]


@dataclass(frozen=True)
class Drift:
    """The inputs' part of a transition: int_a^b e^{A(b - s)} B u(s) ds for the inputs of a state."""

    table: FlowTable

    def between(self, state: State, a: float, b: float) -> Array:
        """Return the integral over [a, b]; u is zero before the first input."""
        n = self.table.weights.plant.n_states
        total = np.zeros(n)
        if not state.inputs or b <= a:
            return total
        start = a
        if state.reached is not None and state.reached[0] == a and state.reached[1] <= b:
            _, start, total = state.reached
            if start == b:
                return total
        first = bisect_right(state.inputs, start, key=_first)
        last = bisect_left(state.inputs, b, key=_first)
        edges = [start, *(t for t, _ in state.inputs[first:last]), b]
        flows = self.table.get([right - left for left, right in pairwise(edges)])
        for left, flow in zip(edges, flows, strict=False):
            u = state.input_at(left)
            total = flow.F @ total
            if u is not None:
                total = total + flow.inputs @ u
        return total
