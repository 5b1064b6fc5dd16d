"""Immutable history of an estimator: what came, and what was said, back to two windows."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from itertools import pairwise
from operator import attrgetter, itemgetter
from typing import NamedTuple, overload

import numpy as np

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.accuracy.readings import RecordRow
from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow
from sampling_design.estimators.online.estimate import Contradiction, Status
from sampling_design.records.arrays import Array

_time = attrgetter("t")
_first = itemgetter(0)

DEEPEST = 32  # branches of a history one within the other


class SampleBranch:
    """Samples one after the other, and since which of them they are proven to contradict the bounds.

    States never change, but what an interval of one of them proves, when it is asked for, holds for all that come after
    it. So every node knows its branch. A branch goes on with the node after its last one; another future of an earlier
    node is a branch of its own, which knows where it left its `parent`; of more than `DEEPEST` one within the other, as
    many late samples make them, the last goes on by itself with what is known by then.
    """

    __slots__ = ("_at", "_depth", "_last", "_parent", "_proven")

    def __init__(self, parent: SampleBranch | None = None, at: int = 0):
        self._at = self._last = at
        self._depth: int = 0 if parent is None else parent._depth + 1
        self._proven: tuple[int, Contradiction] | None = None
        if parent is not None and self._depth > DEEPEST:
            if (known := parent.contradiction(at)) is not None:
                self._proven = at, known
            parent, self._depth = None, 0
        self._parent = parent

    def after(self, number: int) -> SampleBranch:
        """Return the branch of the node that comes after a node of this one."""
        branch = self if number == self._last else SampleBranch(self, number)
        branch._last = number + 1
        return branch

    def record(self, number: int, contradiction: Contradiction) -> None:
        """Take down what the samples up to a node prove."""
        if self._proven is None or number < self._proven[0]:
            self._proven = number, contradiction

    def proven_at(self, number: int) -> bool:
        """Whether the samples up to this node are the first that are known to prove it."""
        return self._proven is not None and self._proven[0] == number

    def contradiction(self, number: int) -> Contradiction | None:
        """Return what is known to be proven by the samples up to a node."""
        branch = self
        while branch._proven is None or branch._proven[0] > number:
            if branch._parent is None:
                return None
            branch, number = branch._parent, min(number, branch._at)
        return branch._proven[1]


class IncomingNode(NamedTuple):
    """A sample on its way in, as the equations take it: y with 0 where it is missing, the mask of 0 and 1, and D u.

    `flow` and `drift` lead here from the node before; `scheduled`: everything up to it is on schedule; `limits` (2, p)
    are what C x lies between.
    """

    t: float
    sample: RecordRow
    y: Array
    mask: Array
    feedthrough: Array
    flow: GapFlow
    drift: Array
    scheduled: bool
    limits: Array | None = None


class HistoryNode(NamedTuple):
    """A processed sample: a snapshot from which everything later can be computed again, and what its estimate says.

    It begins as the `IncomingNode` that it was, and what a solve said of it. Estimates keep the nodes that prove their
    intervals as long as they are kept themselves: a node holds neither its gap's flow, which the table knows, nor an
    estimate. `y` is 0 where `mask` is 0; `sound` says that no assumption was contradicted up to here, `scheduled` that
    everything was on schedule; `own` is what the node's window proved to contradict the bounds, `branch` knows what
    intervals have; `number` counts the samples, 0 is the prior; `counted` is when a sample last counted for the proof
    of a nonlinear estimator, `limited` when one last had limits or means; `held` is the square of x in units of what is
    known of it, with what is left of those before, for the rounding of what follows; `loose` is how far the gaps'
    information may be off; `box` holds the state where nothing else does, by readings of uncertain times that came
    later, on samples `boxed_until` then; its own rest on samples `until` then.
    """

    t: float
    sample: RecordRow
    y: Array
    mask: Array
    feedthrough: Array
    engine: str
    note: str
    cost: float
    status: Status
    sound: bool
    own: Contradiction | None
    drift: Array
    scheduled: bool
    limits: Array | None
    x: Array
    Y: Array
    beta: float
    branch: SampleBranch
    window_start: float = np.nan
    number: int = 0
    held: float = 0.0
    loose: float = 0.0
    limited: float = -np.inf
    counted: float = np.nan
    box: BoundedSet | None = None
    boxed_until: float = -np.inf
    until: float = -np.inf

    @property
    def waits(self) -> bool:
        """Whether a reading of an uncertain time says nothing yet, since nothing bounds how far it may have moved."""
        return any(
            each.stamp is not None and each.lower == -np.inf and each.upper == np.inf for each in self.sample.censored
        )

    def known_by(self, t: float) -> HistoryNode:
        """The same without a box that rests on samples at t or later."""
        return self if self.boxed_until < t else self._replace(box=None, boxed_until=-np.inf)

    @property
    def contradiction(self) -> Contradiction | None:
        """What contradicts the bounds up to here, whichever proof said so."""
        return self.branch.contradiction(self.number) if self.own is None else self.own

    @property
    def stands(self) -> bool:
        """Whether nothing is known to contradict what is assumed."""
        return self.sound and self.branch.contradiction(self.number) is None


class WindowStart(NamedTuple):
    """Where a window begins: time, prior and the state of the node that it was propagated from; bound on the prior
    term, root of P^-1 (None for P2's), nodes inside.
    """

    s: float
    x: Array
    led: Array
    energy: float
    root: Array | None
    inside: tuple[HistoryNode, ...]


class InputHistory(Sequence[tuple[float, Array]]):
    """Pairs (t, u) by time, never changed; one that is later than all is added without a copy of those before it.

    Notes
    -----
    *Method.* Views of one list that only grows: the view that ends where the list ends lengthens it, any other view
    copies what it sees first.
    """

    __slots__ = ("_end", "_log", "_start")

    def __init__(self, pairs: Iterable[tuple[float, Array]] = ()):
        self._log = list(pairs)
        self._start, self._end = 0, len(self._log)

    @classmethod
    def _view(cls, log: list[tuple[float, Array]], start: int, end: int) -> InputHistory:
        found = cls.__new__(cls)
        found._log, found._start, found._end = log, start, end
        return found

    def __len__(self) -> int:
        return self._end - self._start

    @overload
    def __getitem__(self, at: int) -> tuple[float, Array]: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[tuple[float, Array], ...]: ...
    def __getitem__(self, at: int | slice) -> tuple[float, Array] | tuple[tuple[float, Array], ...]:
        if isinstance(at, slice):
            first, last, step = at.indices(len(self))
            return tuple(self._log[self._start + first : self._start + max(first, last)])[::step]
        if not -len(self) <= at < len(self):
            raise IndexError(at)
        return self._log[(self._start if at >= 0 else self._end) + at]

    def until(self, t: float) -> int:
        """How many lie at t or before."""
        return bisect_right(self._log, t, self._start, self._end, key=_first) - self._start

    def before(self, t: float) -> int:
        """How many lie before t."""
        return bisect_left(self._log, t, self._start, self._end, key=_first) - self._start

    def between(self, a: float, b: float) -> tuple[Array | None, list[tuple[float, Array]]]:
        """The value in force at a, None before the first, and what changes after a and before b."""
        log = self._log
        first = bisect_right(log, a, self._start, self._end, key=_first)
        last = first
        while last < self._end and log[last][0] < b:
            last += 1
        return log[first - 1][1] if first > self._start else None, log[first:last]

    def added(self, at: int, t: float, u: Array) -> InputHistory:
        """Return these inputs with one more, at place `at`."""
        if at < len(self):
            return InputHistory((*self[:at], (t, u), *self[at:]))
        log, start = self._log, self._start
        if not len(self) or self._end < len(log):
            log, start = list(self), 0
        log.append((t, u))
        return self._view(log, start, len(log))

    def since(self, first: int) -> InputHistory:
        """Return these inputs without the first ones."""
        start = self._start + first
        if 2 * start > self._end:  # what nobody sees any more is let go
            return InputHistory(self._log[start : self._end])
        return self._view(self._log, start, self._end)


NO_INPUTS = InputHistory()


class EstimatorState(NamedTuple):
    """Everything an estimator knows. Never changed; `step` returns a new one.

    Attributes
    ----------
    nodes : tuple of HistoryNode, by time; the first is the prior or the oldest snapshot kept.
    inputs : InputHistory (t, u), by time; u holds from t on.
    reached : (a, b, drift) or None
        What the inputs add from the last node at a to the last input at b, so that many inputs cost each their own.
    """

    nodes: tuple[HistoryNode, ...]
    inputs: InputHistory = NO_INPUTS
    reached: tuple[float, float, Array] | None = None

    @property
    def last(self) -> HistoryNode:
        """The latest node."""
        return self.nodes[-1]

    def node_before(self, t: float) -> int:
        """Index of the last node at or before t (-1 if there is none)."""
        return bisect_right(self.nodes, t, key=_time) - 1

    def input_at(self, t: float, before: bool = False) -> Array | None:
        """Return the input in force at t (just before t where `before`), None if there is none yet."""
        count = self.inputs.before(t) if before else self.inputs.until(t)
        return self.inputs[count - 1][1] if count else None

    def drift(self, table: FlowTable, a: float, b: float) -> Array:
        """Return int_a^b e^{A(b - s)} B u(s) ds, the inputs' part of a transition; u is zero before the first input."""
        inputs = self.inputs
        if inputs is NO_INPUTS or b <= a or not len(inputs):
            return table.no_drift
        total, start = table.no_drift, a
        if self.reached is not None and self.reached[0] == a and self.reached[1] <= b:
            _, start, total = self.reached
            if start == b:
                return total
        holding, changes = inputs.between(start, b)
        if not changes and total is table.no_drift:  # as most often
            return total if holding is None else table.one(b - start).inputs.dot(holding)
        edges = [start, *(t for t, _ in changes), b]
        if changes:
            table.known([right - left for left, right in pairwise(edges)])  # in one batch
        for (left, right), u in zip(pairwise(edges), (holding, *(u for _, u in changes)), strict=True):
            flow = table.one(right - left)
            if total is not table.no_drift:
                total = flow.F.dot(total)
            if u is not None:
                own = flow.inputs.dot(u)
                total = own if total is table.no_drift else total + own
        return total

    @classmethod
    def kept(cls, nodes: tuple[HistoryNode, ...], inputs: InputHistory, memory: float, least: int) -> EstimatorState:
        """Return the state without what lies further back than `memory` and than `least` nodes.

        Save the last node and input before.
        """
        first, oldest, most = 0, nodes[-1].t - memory, len(nodes) - 1 - least
        while first < most and nodes[first + 1].t <= oldest:  # most often one
            first += 1
        if not first or inputs is NO_INPUTS:
            return EstimatorState(nodes[first:], inputs)
        nodes = nodes[first:]
        keep = max(0, inputs.until(nodes[0].t) - 2)
        return EstimatorState(nodes, inputs.since(keep) if keep else inputs)
