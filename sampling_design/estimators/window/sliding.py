"""The window problem without constraints as it slides: only what is new is put together, the rest is remembered.

Unknown is a node's deviation from a reference, times the root of its discount: the banded normal equations then hold no
discounts, so that the columns of nodes inside the window stay as they are, and right-hand sides and costs count from a
fixed time z, e^{eta(s_j - z)}. Where gaps and measured outputs have been the same for a whole window, the factor of
these equations is that of the window before. Where digits would be lost, `smooth` is asked instead: this is its banded
route, column by column. Vectors of a few entries go through `dot`, whose call costs a third of that of `@`, and with a
number half of that of `*`; names of arguments cost BLAS and LAPACK as much as the call.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from itertools import pairwise
from operator import mul
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.linalg import blas, lapack

from sampling_design.estimators.gap_flows.flows import FlowTable, GapFlow, lower_band
from sampling_design.estimators.online.history import HistoryNode, IncomingNode, WindowStart
from sampling_design.estimators.online.verdict import CovariancePrecision, covariance_precision
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


class WindowGains(NamedTuple):
    """What times and masks decide of a window: Cholesky's factor in a lower band and the inverse of its last block;
    covariance Y of the newest node and its precision.
    """

    factor: Array
    root: Array
    Y: Array
    precision: CovariancePrecision

    def applied(self, right: Array, whole: bool) -> tuple[Array, float]:
        """Return the last node's unknown, or those of the `whole` window, and what they gain."""
        factor = self.factor
        half: Array = _substituted(len(factor) - 1, factor, right.ravel(), 1, 0, 1)
        gain = float(half.dot(half))
        if whole:
            return _substituted(len(factor) - 1, factor, half, 1, 0, 1, 1), gain
        last: Array = self.root.T.dot(half[-len(self.root) :])
        return last, gain


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


WindowOptimum: TypeAlias = tuple[Array, WindowGains, float, float, float, float, OptimalTrajectory | None]
"""State at the newest node, and the gains behind it; cost, and that of the reference; noise and data's squares; the
whole of the optimum, where that was asked for."""


class SlidingBand:
    """The nodes of one history as columns of the normal equations, oldest first.

    Unknown is the deviation from a reference, times the root of the discount: what was predicted for a node from the
    estimate before it; where costs cancel, what was estimated for it (`SETTLED`, and where a history is begun anew) or
    the optimum (`CANCELLED`). While `cancelling`, nodes to come take what was estimated.
    """

    def __init__(self, table: FlowTable, energy: Callable[[Array], float]):
        weights, self._no_drift = table.weights, table.no_drift
        n, p = weights.plant.n_states, weights.plant.n_outputs
        self._weights, self._energy, self._n, self._p, self._eta = weights, energy, n, p, weights.eta
        self._direct, self._still = bool(weights.plant.D.any()), np.zeros(n)
        self._C, self._held = weights.plant.C, np.sqrt(n * weights.prior.diagonal())
        self._units: list[float] = self._held.tolist()
        self.nodes: list[HistoryNode] = []
        self._known: list[IncomingNode | HistoryNode] = []
        self._flows: list[GapFlow | None] = []  # of the gap before a node
        self._reference: list[Array] = []
        self._kinds: dict[bytes, OutputInformation] = {}
        self._latest: tuple[Array, OutputInformation] | None = None  # the mask that came last, and what it means
        self._outputs: list[OutputInformation] = []  # what a node's outputs mean
        self._zero, self.cancelling, self._untouched = 0.0, False, False
        self._banded = self._listed = 0  # so many nodes have their columns; so many have their rows in `_measured`
        self._alike = 0  # so many of the newest nodes came after the same gap with the same outputs
        # of so many nodes, and what they came with
        self._gains: tuple[int, GapFlow | None, OutputInformation, GapFlow, Array, WindowGains] | None = None
        self._found: tuple[Array, Array] | None = None  # the newest node's optimum and its unknown there
        # what a sample at the start leaves of the last prior there, of the last outputs: Y, gain, and root of its cost
        self._absorbed: tuple[Array, OutputInformation, Array, Array, Array] | None = None
        # what a node costs with the gap after it, and what the gap before it adds: columns and right-hand sides
        self._own, self._before = np.zeros((ROOM, n, 2 * n)), np.zeros((ROOM, n, 2 * n))
        self._pull, self._pull_before = np.zeros((ROOM, n)), np.zeros((ROOM, n))
        # each with its weight: fit, the noise's energy, the cost of the gap after; unweighted: |y|^2 + |x|^2
        self._sums, self._ones = np.zeros((ROOM, 4)), np.ones(ROOM)
        self._roots = np.zeros(ROOM)  # of the discounts
        self._read = np.zeros(2 * p + n)  # y, a reference and D u of the node that is looked at
        self._measured = np.zeros((ROOM, 3, p))  # y, mask and D u
        self._missed: list[Array | None] = []  # by how much the gap before a node leads elsewhere than to its reference
        self._leading: list[Array | None] = []  # the estimate from which that gap leads to its reference, if one does

    @property
    def _parts(self) -> tuple[Array, ...]:
        return self._own, self._before, self._pull, self._pull_before, self._sums, self._measured, self._roots

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
            off = np.zeros((2 * p + 2 * n, 2 * p + n))
            off[:p] = np.hstack([root, -root @ self._C, -root])
            off[p : 2 * p, :p] = np.diag(np.sqrt(p * weights.y.diagonal()))
            off[2 * p : -n, p : p + n] = np.diag(self._held)
            off[-n:] = back @ off[:p]
            found = self._kinds[key] = OutputInformation(lower_band(back @ back.T, n)[0], off, self._energy(mask))
        self._latest = mask, found
        return found

    def append(
        self, new: IncomingNode | HistoryNode, flow: GapFlow | None, reference: Array, predicted: bool = False
    ) -> bool:
        """Take in a node, whose unknown is the deviation from a reference; False where it cannot be weighed.

        `flow` is that of the gap before it. `predicted`: the reference is where that gap leads from the estimate of the
        node before. If that is the node's reference, the gap costs nothing.
        """
        k = len(self._known)
        if k == len(self._own):
            grown = [np.concatenate([part, np.zeros_like(part)]) for part in self._parts]
            self._own, self._before, self._pull, self._pull_before, self._sums, self._measured, self._roots = grown
            self._ones = np.ones(2 * k)
        kind = self.output_information(new.mask)
        if not k:
            self._zero = new.t
        elif flow is None or not flow.weighed():
            return False
        elif self._eta * (new.t - self._zero) > FAR:
            self._count_from(new.t)
        self._alike = self._alike + 1 if k and flow is self._flows[-1] and kind is self._outputs[-1] else 1
        self._known.append(new)
        self._flows.append(flow)
        self._outputs.append(kind)
        self._reference.append(reference)
        self._missed.append(None)
        self._roots[k] = math.exp(self._eta / 2 * (new.t - self._zero))
        self._leading.append(estimated := self.nodes[k - 1].x if predicted else None)
        self._weigh(k)
        self._untouched = False
        if estimated is None:
            self._join(k)
        elif (last := self._reference[k - 1]) is estimated:
            self._untouched = True
        else:
            found = self._found
            off = found[1] if found and found[0] is estimated else (estimated - last).dot(self._roots.item(k - 1))
            self._led(k, off, slice(None, self._n))
        return True

    def _weigh(self, k: int) -> None:
        """Put down what a node's sample costs at its reference, and how that pulls."""
        read, sums, p, n, new, kind = self._read, self._sums[k], self._p, self._n, self._known[k], self._outputs[k]
        read[:p], read[p : p + n] = new.y, self._reference[k]
        if self._direct:
            read[p + n :] = new.feedthrough
        off, root = kind.off.dot(read), self._roots.item(k)
        scaled, held = off.dot(root), off[p:-n]
        half, self._pull[k] = scaled[:p], scaled[-n:]
        sums[0], sums[1], sums[3] = half.dot(half), kind.energy * (root * root), held.dot(held)

    def _join(self, k: int) -> None:
        """Put down what the gap before a node costs between references."""
        missed = self._missing(k)
        if missed is not None:
            self._led(k, missed.dot(self._roots.item(k)), slice(self._n, None))

    def _led(self, k: int, off: Array, end: slice) -> None:
        """Put down what the gap before a node costs with states at one `end` of it so far off, and how it pulls."""
        flow, n = self._flows[k], self._n
        joint = None if flow is None else flow.joint
        assert joint is not None  # or the node was not taken in
        g, pull = off.dot(joint[end]), self._pull[k - 1]
        pull += g[:n]
        self._pull_before[k] = g[n:]
        self._sums[k - 1, 2] = off.dot(g[end])

    def _missing(self, k: int) -> Array | None:
        """By how much the gap before a node leads elsewhere than to its reference; None without a gap."""
        flow, found = self._flows[k], self._missed[k]
        if found is None and k and flow is not None:
            last, estimated = self._reference[k - 1], self._leading[k]
            if estimated is None:
                found = flow.F.dot(last) + self._known[k].drift - self._reference[k]
            else:
                found = flow.F.dot(last - estimated)
            self._missed[k] = found
        return found

    def settle(self, node: HistoryNode) -> None:
        """Take in what was estimated for the newest node."""
        self.nodes.append(node)
        if self.cancelling:
            self._move_to(len(self._known) - 1, [node.x])

    def _move_to(self, first: int, states: Sequence[Array]) -> None:
        """Take states of the nodes from number `first` on for their references."""
        ahead, missed = self._still, [self._missing(k) for k in range(first, len(self._known))]
        if first and not (self._untouched and len(states) == 1):  # without what the gap from there has pulled
            self._weigh(first - 1)
        self._untouched = False
        for k, (x, before) in enumerate(zip(states, missed, strict=True), first):
            flow, away = self._flows[k], x - self._reference[k]
            self._reference[k], self._leading[k] = x, None
            self._weigh(k)
            if before is not None and flow is not None:
                self._missed[k] = before - away if k == first else before - away + flow.F.dot(ahead)
                self._join(k)
            ahead = away

    def _count_from(self, t: float) -> None:
        """Let discounts count from t."""
        factor = math.exp(-self._eta / 2 * (t - self._zero))
        for part in (self._pull, self._pull_before, self._roots):
            part *= factor
        self._sums[:, :3] *= factor * factor
        self._zero, self._found = t, None

    def forget(self, count: int) -> None:
        """Drop the oldest nodes."""
        kept = len(self._known) - count
        for part in self._parts:
            part[:kept] = part[count : count + kept].copy()
            part[kept:] = 0.0
        self._banded, self._listed = max(self._banded - count, 0), max(self._listed - count, 0)
        histories = self.nodes, self._known, self._flows, self._reference, self._outputs, self._missed, self._leading
        for held in histories:
            del held[:count]

    def _matrix(self, first: int, arrival: Array) -> Array:
        """The columns of the nodes from number `first` on, where a prior arrives: what each costs, and both gaps."""
        own, before, count = self._own, self._before, len(self._known)
        for k in range(self._banded, count):
            flow = self._flows[k]
            own[k] = self._outputs[k].band
            if k and flow is not None:
                gap, column = flow.band, own[k - 1]
                column += gap[0]
                before[k] = gap[1]
        self._banded = count
        before[first] = arrival  # the gap before it is the window's own, here and below
        work: Array = own[first:count] + before[first:count]
        return work

    def solve(
        self,
        first: int,
        start: WindowStart,
        prior: Array,
        initial: HistoryNode | None,
        gap: tuple[GapFlow, Array],
        whole: bool,
        again: WindowGains | None = None,
    ) -> WindowOptimum | None:
        """Return the optimum over the nodes from number `first` on; None where that would lose digits.

        Parameters
        ----------
        prior : (n, n)
            Covariance at the window's start.
        initial : HistoryNode, optional
            That of a sample taken there.
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
        known, eta, n = self._known, self._eta, self._n
        if eta * (known[-1].t - start.s) > WIDEST:
            return None
        x, Y, cost, noise, begun = self._opened(start, prior, initial)
        flow, drift = gap
        arrival = flow.arrival_information(Y)
        if arrival is None:
            return None
        information, band = arrival
        count, rows, root = len(known), slice(first, len(known)), self._roots.item(len(known) - 1)
        fit, energy, gaps, size = self._ones[rows].dot(self._sums[rows]).tolist()
        size, cost, end = size + begun, cost + fit + gaps, root * root
        if initial is None and start.led is self._leading[first]:
            moved = self._still
            self._pull_before[first] = moved
        else:
            moved = flow.F.dot(x) - self._reference[first]
            if drift is not self._no_drift:
                moved += drift
            away = moved.dot(self._roots.item(first))
            self._pull_before[first] = pull = information.dot(away)
            cost += float(away.dot(pull))
        right = self._pull[rows] + self._pull_before[rows]
        gains = again or self._gains_of_last_window(count - first, flow, Y)
        if gains is None:
            gains = _factored(self._matrix(first, band))
            if gains is None:
                return None
            came = count - first, self._flows[-1], self._outputs[-1], flow, Y, gains
            self._gains = came if self._alike >= count - first else None
        left, gain = gains.applied(right, whole)
        if not math.isfinite(gain + cost):
            return None
        cost -= gain
        far = not cost * FAR_OFF > size * end
        self.cancelling = far or not cost > SETTLED * gain
        if not cost > CANCELLED * gain or (far and again):
            if again:
                return None
            away = gains.applied(right, True)[0].reshape(-1, n) / self._roots[rows, None]
            self._move_to(first, list(np.array(self._reference[first:]) + away))
            return self.solve(first, start, prior, initial, gap, whole, gains)
        if not whole:
            newest, path = self._reference[-1] + left.dot(1 / root), None
            self._found = newest, left
        else:
            path = self._path(first, x, Y, moved, left.reshape(-1, n) / self._roots[rows, None], flow)
            newest = path.nodes[-1]
        return newest, gains, cost / end, (cost + gain) / end, (energy + noise) / end, size, path

    def _path(self, first: int, x: Array, Y: Array, moved: Array, deviation: Array, flow: GapFlow) -> OptimalTrajectory:
        """Return the optimum at all nodes, the window's start before them.

        There x and Y are known; `flow` leads from x to `moved` beside the first node's reference.
        """
        arrival = flow.arrival_information(Y)
        assert arrival is not None
        begun = flow.growth * Y.dot(flow.F.T.dot(arrival[0].dot(deviation[0] - moved)))
        places = np.array([x, *self._reference[first:]])
        away = np.concatenate([begun[None], deviation])
        missed = enumerate(self._missed[first + 1 :], first + 1)
        defect = np.array([moved, *[self._missing(k) if each is None else each for k, each in missed]])
        flows = [flow, *(each for each in self._flows[first + 1 :] if each is not None)]
        return OptimalTrajectory(places + away, away, defect, flows)

    def samples(self, first: int, initial: HistoryNode | None) -> tuple[Array, Array, Array]:
        """Return y - D u, the masks and D u at the samples from node `first` on, that at the window's start first."""
        measured, count = self._measured, len(self._known)
        for k in range(self._listed, count):
            new = self._known[k]
            measured[k] = new.y, new.mask, new.feedthrough
        self._listed = count
        rows = measured[first:count]
        if initial is not None:
            rows = np.concatenate([np.array([[initial.y, initial.mask, initial.feedthrough]]), rows])
        y, masks, feedthrough = rows.transpose(1, 0, 2)
        return y - feedthrough, masks, feedthrough

    def _gains_of_last_window(self, count: int, flow: GapFlow, Y: Array) -> WindowGains | None:
        """The gains of the window before, where all `count` nodes came with the same: they are those of this one."""
        if self._gains is None or self._alike < count:
            return None
        so_many, newest, kind, arriving, prior, gains = self._gains
        same = so_many == count and newest is self._flows[-1] and kind is self._outputs[-1]
        return gains if same and arriving is flow and prior is Y else None

    def _opened(
        self, start: WindowStart, prior: Array, initial: HistoryNode | None
    ) -> tuple[Array, Array, float, float, float]:
        """Return state and covariance after a sample at the start, if any; its cost and noise bound; size of data."""
        if initial is None:
            held = math.hypot(*map(mul, self._units, start.x.tolist()))
            return start.x, prior, 0.0, 0.0, held * held
        kind, p, n = self.output_information(initial.mask), self._p, self._n
        off = kind.off.dot(np.concatenate((initial.y, start.x, initial.feedthrough)))
        innovation, rows, held = off[:p], -kind.off[:p, p : p + n], off[p:-n]
        if self._absorbed is None or self._absorbed[0] is not prior or self._absorbed[1] is not kind:
            root, gain, half = root_update(covariance_root(prior), rows, np.eye(innovation.size))
            self._absorbed = prior, kind, root @ root.T, gain, half
        _, _, Y, gain, half = self._absorbed
        missed, begin = half.dot(innovation), math.exp(self._eta * (start.s - self._zero))
        x, cost = start.x + gain.dot(innovation), float(missed @ missed) * begin
        return x, Y, cost, kind.energy * begin, float(held.dot(held))


class BandCache:
    """Sliding bands by their last node, the least recently used dropped first."""

    def __init__(self, table: FlowTable, energy: Callable[[Array], float]):
        self._table, self._energy = table, energy
        self._known: OrderedDict[int, tuple[HistoryNode, SlidingBand]] = OrderedDict()

    def of(self, nodes: tuple[HistoryNode, ...], first: int) -> tuple[SlidingBand, int] | None:
        """Return the band that ends with the last of `nodes`, and the number in it of node `first`; None if unfit."""
        count = len(nodes) - first
        if not count:
            return SlidingBand(self._table, self._energy), 0
        node, band = self._known.pop(id(nodes[-1]), (None, None))
        if band is not None and node is nodes[-1]:
            band.settle(node)
            at = len(band.nodes) - count
            if at >= 0 and band.nodes[at] is nodes[first]:
                if at >= ROOM // 2:
                    band.forget(at)
                    at = 0
                return band, at
        band, inside = SlidingBand(self._table, self._energy), nodes[first:]
        flows = self._table.get([after.t - before.t for before, after in pairwise(inside)])
        for node, flow in zip(inside, (None, *flows), strict=True):
            if not band.append(node, flow, node.x):
                return None
            band.nodes.append(node)
        return band, 0

    def keep(self, node: HistoryNode, band: SlidingBand) -> None:
        """Remember a band by the node that its last entry has become."""
        self._known[id(node)] = node, band
        if len(self._known) > HISTORIES:
            self._known.popitem(last=False)


def _factored(work: Array) -> WindowGains | None:
    """Return what does not depend on the data; None where digits would be lost."""
    count, n, width = work.shape
    band = work.reshape(count * n, width).T
    diagonal = band[0].copy()
    factor, flag = lapack.dpbtrf(band, 1, width, 1)  # in place
    pivots = factor[0]
    diagonal /= pivots
    diagonal /= pivots
    if flag or not diagonal[diagonal.argmax()] < 1 / PIVOT_LIMIT:  # also where one is no number
        return None
    # the last diagonal block; above its diagonal the band's zeros below the last row
    step = work.itemsize
    last = np.ndarray((n, n), np.float64, work, step * (count - 1) * n * width, (step, step * (width - 1))).copy()
    root = lapack.dtrtri(last, 1)[0]
    Y = root.T.dot(root)
    Y.setflags(write=False)
    return WindowGains(factor, root, Y, covariance_precision(Y, last))
