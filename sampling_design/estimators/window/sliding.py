"""The window problem without constraints as it slides: only what is new is put together, the rest is remembered.

Discounts count from a fixed time z, e^{eta(s_j - z)}, so that the columns of the banded normal equations of nodes
inside the window stay as they are; the window's start and its newest node are added to a copy. Where gaps and measured
outputs have been the same for a whole window, the factor of these equations is that of the window before. Where digits
would be lost, `smooth` is asked instead: this is its banded route, column by column. Vectors of a few entries go
through `dot`, whose call costs a third of that of `@`, and with a number half of that of `*`; names of arguments cost
BLAS and LAPACK as much as the call.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, lapack

from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow, lower_band
from sampling_design.estimators.online.history import HistoryNode, IncomingNode
from sampling_design.estimators.online.verdict import LARGEST_RESIDUAL, CovariancePrecision
from sampling_design.estimators.window.smoother import PIVOT_LIMIT
from sampling_design.numerics.filtering import covariance_root, root_update
from sampling_design.records.arrays import Array

FAR = 60.0  # exponent up to which discounts may grow before they count from a new time

WIDEST = 300.0
"""Exponent of the discount over a window from which on it is not remembered: its start has no weight then."""

HISTORIES = 64  # histories of one estimator that are remembered side by side
_substituted = blas.dtbsv

ROOM = 64  # nodes for which there is room at first, and how many more are made when it is used up
CANCELLED = 1e-4  # share of the reference's cost below which the optimum becomes the reference, at two updates' price

SETTLED = 0.01
"""Share of what the optimum gains on its reference below which the least cost is found with two digits fewer: nodes to
come then take their estimates for references, at a twentieth of an update each."""

FAR_OFF = 1e12
"""Sum of the squares of references and readings, in units of their weights, over the least cost, from which on rounding
of a reference may show in its ninth digit: nodes to come take their estimates for references then, too."""


class OutputInformation(NamedTuple):
    """What measuring some outputs means: band of C'Y C with U'U = Y, a bound on the noise's cost, and a map: of
    (y, x, D u) it makes U (y - D u - C x), below it as much as |y| and |x| are in units of their weights, or more, and
    last how the sample pulls at x, C'Y (y - D u - C x).
    """

    band: Array
    off: Array
    energy: float


class InitialNode(NamedTuple):
    """The window's start: time, prior and its covariance, and the node of a sample taken there, if any."""

    t: float
    x: Array
    Y: Array
    node: HistoryNode | None = None


class WindowGains(NamedTuple):
    """What times and masks decide of a window: Cholesky's factor in a lower band and the inverse of its last block,
    both where the discount of the newest node is `end`; covariance Y of that node and its precision.
    """

    factor: Array
    root: Array
    end: float
    Y: Array
    precision: CovariancePrecision

    def applied(self, right: Array, end: float, whole: bool) -> tuple[Array, float]:
        """Return the last node's deviation, or those of the `whole` window, and what they gain, at its discount."""
        factor, scale = self.factor, self.end / end
        half: Array = _substituted(len(factor) - 1, factor, right.ravel(), 1, 0, 1)
        gain = float(half.dot(half)) * scale
        if whole:
            return _substituted(len(factor) - 1, factor, half, 1, 0, 1, 1) * scale, gain
        last: Array = self.root.T.dot(half[-len(self.root) :])
        return last if scale == 1.0 else last.dot(scale), gain


class OptimalTrajectory(NamedTuple):
    """An optimum at the window's nodes: states, deviations from the reference, and what each gap misses there.

    Attributes
    ----------
    nodes, deviation : (N+1, n)
    defect : (N, n)
        F_j reference_j + b_j - reference_{j+1}.
    flows : N flows
    """

    nodes: Array
    deviation: Array
    defect: Array
    flows: list[GapFlow]


class WindowOptimum(NamedTuple):
    """State, covariance Y and its precision at the newest node; cost; noise and data's squares.

    `above` is the cost of the reference, `path` the whole of the optimum, where that was asked for.
    """

    x: Array
    Y: Array
    precision: CovariancePrecision
    cost: float
    above: float
    energy: float
    size: float
    path: OptimalTrajectory | None = None


class SlidingBand:
    """The nodes of one history as columns of the normal equations, oldest first.

    Unknown is the deviation from a reference: what was predicted for a node from the estimate before it; where costs
    cancel, what was estimated for it (`SETTLED`, and where a history is begun anew) or the optimum (`CANCELLED`).
    While `cancelling`, nodes to come take what was estimated.
    """

    def __init__(self, table: FlowTable, energy: Callable[[Array], float]):
        weights, self._no_drift = table.weights, table.no_drift
        n = weights.plant.n_states
        self._weights, self._energy, self._n, self._eta = weights, energy, n, weights.eta
        self._C, self._held = weights.plant.C, np.diag(np.sqrt(n * weights.prior.diagonal()))
        self._p, self._direct = len(self._C), bool(weights.plant.D.any())
        self.nodes: list[HistoryNode] = []
        self._known: list[IncomingNode | HistoryNode] = []
        self._reference: list[Array] = []
        self._kinds: dict[bytes, OutputInformation] = {}
        self._latest: tuple[Array, OutputInformation] | None = None  # the mask that came last, and what it means
        self._outputs: list[OutputInformation] = []  # what a node's outputs mean
        self._data: list[Array] = []  # y, reference and D u, one after the other
        self._zero, self.cancelling, self._untouched = 0.0, False, False
        self._banded = self._listed = 0  # so many nodes have their columns; so many have their rows in `_measured`
        self._alike = 0  # so many of the newest nodes came after the same gap with the same outputs
        # of so many nodes, and what they came with
        self._gains: tuple[int, GapFlow | None, OutputInformation, GapFlow, Array, WindowGains] | None = None
        # what a sample at the start leaves of the last prior there, of the last outputs: Y, gain, and root of its cost
        self._absorbed: tuple[Array, OutputInformation, Array, Array, Array] | None = None
        # what a node costs with the gap after it, and what the gap before it adds: columns and right-hand sides
        self._own, self._before = np.zeros((ROOM, n, 2 * n)), np.zeros((ROOM, n, 2 * n))
        self._pull, self._pull_before = np.zeros((ROOM, n)), np.zeros((ROOM, n))
        # each with its weight: fit, the noise's energy, the cost of the gap after; unweighted: |y|^2 + |x|^2
        self._sums = np.zeros((ROOM, 4))
        self._measured = np.zeros((ROOM, 3, len(self._C)))  # y, mask and D u
        self._missed: list[Array] = []  # by how much the gap before a node leads elsewhere than to its reference
        self._leading: list[Array | None] = []  # the estimate from which that gap leads to its reference, if one does
        self._still, self._ones = np.zeros(n), np.ones(ROOM)

    @property
    def _parts(self) -> tuple[Array, ...]:
        return self._own, self._before, self._pull, self._pull_before, self._sums, self._measured

    def output_information(self, mask: Array) -> OutputInformation:
        """Return what a sample of some outputs means."""
        if self._latest is not None and self._latest[0] is mask:
            return self._latest[1]
        key = mask.tobytes()
        found = self._kinds.get(key)
        if found is None:
            weights, p, n = self._weights.at(mask), self._p, self._n
            root = weights.y_root
            back = self._C.T @ root.T
            off = np.zeros((2 * p + 2 * n, 2 * p + n if self._direct else p + n))
            off[:p] = np.hstack([root, -root @ self._C, -root])[:, : off.shape[1]]
            off[p : p + n, p : p + n], off[p + n : -n, :p] = self._held, np.diag(np.sqrt(p * weights.y.diagonal()))
            off[-n:] = back @ off[:p]
            band, energy = lower_band(back @ back.T, n)[0], self._energy(mask)
            found = self._kinds[key] = OutputInformation(band, off, energy)
        self._latest = mask, found
        return found

    def append(self, new: IncomingNode | HistoryNode, reference: Array, predicted: bool = False) -> bool:
        """Take in a node, whose unknown is the deviation from a reference; False where it cannot be weighed.

        `predicted`: the reference is where the gap leads from the estimate of the node before. If that is the node's
        reference, the gap costs nothing.
        """
        k = len(self._known)
        if k == len(self._own):
            grown = [np.concatenate([part, np.zeros((k, *part.shape[1:]))]) for part in self._parts]
            self._own, self._before, self._pull, self._pull_before, self._sums, self._measured = grown
            self._ones = np.ones(2 * k)
        kind, flow = self.output_information(new.mask), new.flow
        if not k:
            self._zero = new.t
        elif flow is None or not flow.weighed():
            return False
        elif self._eta * (new.t - self._zero) > FAR:
            self._count_from(new.t)
        self._alike = self._alike + 1 if k and flow is self._known[-1].flow and kind is self._outputs[-1] else 1
        d = math.exp(self._eta * (new.t - self._zero))
        self._known.append(new)
        self._outputs.append(kind)
        self._data.append(self._read(kind, new))
        self._reference.append(reference)
        self._missed.append(self._still)
        self._leading.append(self.nodes[k - 1].x if predicted else None)
        weighed = self._weighed(k, d)
        self._sums[k, 1] = kind.energy * d
        if (estimated := self._leading[k]) is None or flow is None:
            self._untouched = False
            return weighed and self._joined(k, d)
        last = self._reference[k - 1]
        self._untouched = last is estimated
        return weighed and (self._untouched or self._joined(k, d, flow.F.dot(last - estimated)))

    def _read(self, kind: OutputInformation, node: IncomingNode | HistoryNode) -> Array:
        """Return y, room for a state, and D u where there may be any."""
        p, read = self._p, np.empty(kind.off.shape[1])
        read[:p] = node.y
        if self._direct:
            read[-p:] = node.feedthrough
        return read

    def _weighed(self, k: int, d: float) -> bool:
        """Put down what a node's sample costs at its reference, and how that pulls; False where that overflows."""
        data, sums, p, n = self._data[k], self._sums[k], self._p, self._n
        data[p : p + n] = self._reference[k]
        off = self._outputs[k].off.dot(data)
        half, held = off[:p], off[:-n]
        square = float(half.dot(half))
        np.multiply(off[-n:], d, self._pull[k])
        sums[0], sums[3] = square * d, held.dot(held)
        return square < LARGEST_RESIDUAL**2

    def _joined(self, k: int, d: float, moved: Array | None = None) -> bool:
        """Put down what the gap before the newest node costs between references; False where that overflows.

        `moved`: by how much it leads elsewhere than to the newest one, where that is known.
        """
        n, new = self._n, self._known[k]
        flow = new.flow
        if not k or flow is None or (joint := flow.joint) is None:
            return True
        if moved is None:
            moved = flow.F.dot(self._reference[k - 1]) + new.drift - self._reference[k]
        self._missed[k] = moved
        g = moved.dot(d).dot(joint[n:])
        pull, own = self._pull[k - 1], g[n:]
        pull += g[:n]
        self._pull_before[k] = own
        self._sums[k - 1, 2] = cost = float(moved.dot(own))
        return math.isfinite(cost)

    def settle(self, node: HistoryNode) -> bool:
        """Take in what was estimated for the newest node; False where that cannot be weighed."""
        self.nodes.append(node)
        return not self.cancelling or self._moved_to(len(self._known) - 1, [node.x])

    def _moved_to(self, first: int, states: Sequence[Array]) -> bool:
        """Take states of the nodes from number `first` on for their references; False where these cannot be weighed."""
        known, eta, zero, ahead, fit = self._known, self._eta, self._zero, self._still, True
        if first and not (self._untouched and len(states) == 1):  # without what the gap from there has pulled
            self._weighed(first - 1, math.exp(eta * (known[first - 1].t - zero)))
        self._untouched = False
        for k, x in enumerate(states, first):
            flow, away = known[k].flow, x - self._reference[k]
            moved = self._missed[k] - away
            if k > first and flow is not None:
                moved += flow.F.dot(ahead)
            ahead, self._reference[k], self._leading[k] = away, x, None
            d = math.exp(eta * (known[k].t - zero))
            fit = fit and self._weighed(k, d) and self._joined(k, d, moved)
        return fit

    def ends_with(self, node: HistoryNode) -> bool:
        """Whether the last entry, of which there is no node yet, is that of a node."""
        last = self._known[-1]
        return last.y is node.y and last.drift is node.drift and last.feedthrough is node.feedthrough

    def _count_from(self, t: float) -> None:
        """Let discounts count from t."""
        factor, k = math.exp(-self._eta * (t - self._zero)), len(self._known)
        for part in (self._own, self._before):
            part[: self._banded] *= factor
        for part in (self._pull, self._pull_before, self._sums[:, :3]):
            part[:k] *= factor
        self._zero = t

    def forget(self, count: int) -> None:
        """Drop the oldest nodes."""
        kept = len(self._known) - count
        for part in self._parts:
            part[:kept] = part[count : count + kept].copy()
            part[kept:] = 0.0
        self._banded, self._listed = max(self._banded - count, 0), max(self._listed - count, 0)
        histories = self.nodes, self._known, self._reference, self._outputs, self._data, self._missed, self._leading
        for held in histories:
            del held[:count]

    def _columns(self, rows: slice) -> Array:
        """The columns of some nodes up to the newest: what each costs, and both gaps beside it."""
        own, before, eta, zero = self._own, self._before, self._eta, self._zero
        for k in range(self._banded, rows.stop):
            new = self._known[k]
            d = math.exp(eta * (new.t - zero))
            np.multiply(self._outputs[k].band, d, own[k])
            if k and new.flow is not None:
                gap, column = new.flow.band.dot(d), own[k - 1]
                column += gap[0]
                before[k] = gap[1]
        self._banded = rows.stop
        work: Array = own[rows] + before[rows]
        return work

    def solve(
        self,
        first: int,
        initial: InitialNode,
        gap: tuple[GapFlow, Array],
        whole: bool,
        again: WindowGains | None = None,
    ) -> WindowOptimum | None:
        """Return the optimum over the nodes from number `first` on; None where that would lose digits.

        Parameters
        ----------
        gap : (GapFlow, (n,) array)
            From the window's start to the first node, with the inputs' part.
        whole : bool
            Whether its `path` is asked for.

        Notes
        -----
        *Method.* The window's start, where no weight is left but the prior's and a sample's, is eliminated first:
        what is known of it arrives at the first node as one covariance. Where the least cost is lost in the difference
        from that of the reference, the optimum found becomes the reference, and is sought `again` with the same gains.
        """
        known, eta, zero = self._known, self._eta, self._zero
        later = known[-1].t - zero
        if eta * later > WIDEST or eta * (zero - initial.t) > WIDEST:
            return None
        d, end = math.exp(eta * (known[first].t - zero)), math.exp(eta * later)
        x, Y, cost, noise, begun = self._opened(initial)
        flow, drift = gap
        arrival = flow.arrival_information(Y)
        if arrival is None:
            return None
        information, band = arrival
        count, rows = len(known), slice(first, len(known))
        right = self._pull[rows] + self._pull_before[rows]  # the gap before the first node is the window's own, below
        fit, energy, gaps, size = self._ones[rows].dot(self._sums[rows]).tolist()
        size, cost = size + float(begun.dot(begun)), cost + fit + gaps
        if x is self._leading[first] and flow is known[first].flow:
            moved, right[0] = self._still, self._pull[first]
        else:
            moved = flow.F.dot(x) - self._reference[first]
            if drift is not self._no_drift:
                moved += drift
            g = information.dot(moved.dot(d))
            np.add(self._pull[first], g, right[0])
            cost += float(moved.dot(g))
        gains = again or self._gains_of_last_window(count - first, flow, Y)
        if gains is None:
            work = self._columns(rows)
            np.add(self._own[first], band.dot(d), work[0])
            gains = _factored(work, end)
            if gains is None:
                return None
            came = count - first, known[-1].flow, self._outputs[-1], flow, Y, gains
            self._gains = came if self._alike >= count - first else None
        deviation, gain = gains.applied(right, end, whole)
        if not math.isfinite(gain + cost):
            return None
        cost -= gain
        far = not cost * FAR_OFF > size * end
        self.cancelling = far or not cost > SETTLED * gain
        if not cost > CANCELLED * gain or (far and again):
            away = gains.applied(right, end, True)[0].reshape(-1, self._n)
            if again or not self._moved_to(first, list(np.array(self._reference[first:]) + away)):
                return None
            return self.solve(first, initial, gap, whole, gains)
        path = self._path(first, x, Y, moved, deviation, flow) if whole else None
        newest, energy = self._reference[-1] + deviation[-self._n :], (energy + noise) / end
        return WindowOptimum(newest, gains.Y, gains.precision, cost / end, (cost + gain) / end, energy, size, path)

    def _path(self, first: int, x: Array, Y: Array, moved: Array, deviation: Array, flow: GapFlow) -> OptimalTrajectory:
        """Return the optimum at all nodes, the window's start before them.

        There x and Y are known; `flow` leads from x to `moved` beside the first node's reference.
        """
        arrival = flow.arrival_information(Y)
        assert arrival is not None
        begun = flow.growth * Y.dot(flow.F.T.dot(arrival[0].dot(deviation[: self._n] - moved)))
        places = np.array([x, *self._reference[first:]])
        away = np.concatenate([begun, deviation]).reshape(-1, self._n)
        defect = np.array([moved, *self._missed[first + 1 :]])
        flows = [flow, *(new.flow for new in self._known[first + 1 :] if new.flow is not None)]
        return OptimalTrajectory(places + away, away, defect, flows)

    def samples(self, first: int, initial: InitialNode) -> tuple[Array, Array, Array]:
        """Return y - D u, the masks and D u at the samples from node `first` on, that at the window's start first."""
        measured, count = self._measured, len(self._known)
        for k in range(self._listed, count):
            new = self._known[k]
            measured[k] = new.y, new.mask, new.feedthrough
        self._listed = count
        rows = measured[first:count]
        if (node := initial.node) is not None:
            rows = np.concatenate([np.array([[node.y, node.mask, node.feedthrough]]), rows])
        y, masks, feedthrough = rows.transpose(1, 0, 2)
        return y - feedthrough, masks, feedthrough

    def _gains_of_last_window(self, count: int, flow: GapFlow, Y: Array) -> WindowGains | None:
        """The gains of the window before, where all `count` nodes came with the same: they are those of this one."""
        if self._gains is None or self._alike < count:
            return None
        so_many, newest, kind, arriving, prior, gains = self._gains
        same = so_many == count and newest is self._known[-1].flow and kind is self._outputs[-1]
        return gains if same and arriving is flow and prior is Y else None

    def _opened(self, initial: InitialNode) -> tuple[Array, Array, float, float, Array]:
        """Return state and covariance after a sample at the start, if any; its cost and noise bound; sizes of data."""
        node = initial.node
        if node is None:
            return initial.x, initial.Y, 0.0, 0.0, self._held.dot(initial.x)
        kind = self.output_information(node.mask)
        data, p, n = self._read(kind, node), self._p, self._n
        data[p : p + n] = initial.x
        off = kind.off.dot(data)
        innovation, rows = off[:p], -kind.off[:p, p : p + n]
        if self._absorbed is None or self._absorbed[0] is not initial.Y or self._absorbed[1] is not kind:
            root, gain, half = root_update(covariance_root(initial.Y), rows, np.eye(innovation.size))
            self._absorbed = initial.Y, kind, root @ root.T, gain, half
        _, _, Y, gain, half = self._absorbed
        missed, begin = half.dot(innovation), math.exp(self._eta * (initial.t - self._zero))
        return initial.x + gain.dot(innovation), Y, float(missed @ missed) * begin, kind.energy * begin, off[:-n]


class BandCache:
    """Sliding bands by their last node, the least recently used dropped first."""

    def __init__(self, table: FlowTable, energy: Callable[[Array], float]):
        self._table, self._energy = table, energy
        self._known: OrderedDict[int, tuple[HistoryNode, SlidingBand]] = OrderedDict()
        self._begun: SlidingBand | None = None

    def of(self, nodes: tuple[HistoryNode, ...], first: int) -> tuple[SlidingBand, int] | None:
        """Return the band that ends with the last of `nodes`, and the number in it of node `first`; None if unfit."""
        count = len(nodes) - first
        if not count:
            return SlidingBand(self._table, self._energy), 0
        node, band = self._known.pop(id(nodes[-1]), (None, None))
        if band is not None and node is nodes[-1] and band.settle(node):
            at = len(band.nodes) - count
            if at >= 0 and band.nodes[at] is nodes[first]:
                if at >= ROOM // 2:
                    band.forget(at)
                    at = 0
                return band, at
        band = SlidingBand(self._table, self._energy)
        for node in nodes[first:]:
            if not band.append(node, node.x):
                return None
            band.nodes.append(node)
        return band, 0

    def begun(self, band: SlidingBand) -> None:
        """Hold a band to whose last entry there is no node yet."""
        self._begun = band

    def keep(self, node: HistoryNode) -> None:
        """Remember the band that was begun, if `node` is what its last entry has become."""
        band, self._begun = self._begun, None
        if band is not None and band.ends_with(node):
            self._known[id(node)] = node, band
            if len(self._known) > HISTORIES:
                self._known.popitem(last=False)


def _factored(work: Array, end: float) -> WindowGains | None:
    """Return what does not depend on the data; `end` is the discount of the newest node.

    None where digits would be lost.
    """
    count, n, width = work.shape
    band = work.reshape(count * n, width).T
    diagonal = band[0].copy()
    factor, flag = lapack.dpbtrf(band, 1, overwrite_ab=1)
    if flag or not (shares := factor[0] * factor[0] / diagonal)[shares.argmin()] > PIVOT_LIMIT:
        return None
    # the last diagonal block; above its diagonal the band's zeros below the last row
    step = work.itemsize
    last = np.ndarray((n, n), np.float64, work, step * (count - 1) * n * width, (step, step * (width - 1))).copy()
    root = lapack.dtrtri(last, 1)[0]
    Y = root.T.dot(root).dot(end)
    Y.setflags(write=False)
    return WindowGains(factor, root, end, Y, CovariancePrecision.of(Y, last, end))
