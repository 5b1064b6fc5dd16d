"""The window problem without constraints as it slides: only what is new is put together, the rest is remembered.

Discounts count from a fixed time z, e^{eta(s_j - z)}, so that the columns of the banded normal equations of nodes
inside the window stay as they are; the window's start and its newest node are added to a copy. Where digits would be
lost, `smooth` is asked instead: this is its banded route, column by column.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from sampling_design.estimators.gap_flows.cost_weights import Weights
from sampling_design.estimators.gap_flows.flows import GapFlow, lower_band
from sampling_design.estimators.online.history import Node
from sampling_design.estimators.window.smoother import PIVOT_LIMIT, last_block
from sampling_design.estimators.window.solution import DUAL_MARGIN

Array = npt.NDArray[np.float64]

FAR = 60.0
"""Exponent up to which discounts may grow before they count from a new time."""

WIDEST = 300.0
"""Exponent of the discount over a window from which on it is not remembered: its start has no weight then."""

ROOM = 64
"""Nodes for which there is room at first, and how many more are made when it is used up."""

CANCELLED = 1e-4
"""Share of the reference's cost below which the least cost is not found as a difference from it."""

LARGEST = 1e150
"""Residuals beyond this, in units of their weights, are not weighed here: their squares overflow in sums."""

HISTORIES = 64
"""Histories of one estimator that are remembered side by side."""


class Heard(NamedTuple):
    """What measuring some outputs means: band of C'Y C, C'U', U, |U| with U'U = Y, and a bound on the noise's cost."""

    band: Array
    back: Array
    root: Array
    size: Array
    energy: float


class Opening(NamedTuple):
    """The window's start: time, prior, band of the prior's information, the sample taken there (or None)."""

    t: float
    x: Array
    band: Array
    sample: tuple[Array, Array, Array] | None


class Arriving(NamedTuple):
    """The newest node: time, prediction (the reference there), y, mask, D u, and the gap that leads to it."""

    t: float
    x: Array
    y: Array
    mask: Array
    feedthrough: Array
    flow: GapFlow


class Optimum(NamedTuple):
    """State, covariance and cost at the newest node; a lower bound on the cost; noise and rounding bounds."""

    x: Array
    Y: Array
    cost: float
    dual: float
    energy: float
    read: float
    held: float


class SlidingBand:
    """The nodes of one history as columns of the normal equations, oldest first."""

    def __init__(self, weights: Weights, energy: Callable[[Array], Array]):
        n = weights.plant.n_states
        self._weights, self._energy, self._n, self._eta = weights, energy, n, weights.eta
        self._C, self._held = weights.plant.C, np.abs(weights.prior_factor.T)
        self.nodes: list[Node] = []
        self._owned: list[bool] = []  # whether the gap before a node is in its column
        self._kinds: dict[bytes, Heard] = {}
        self._zero = 0.0
        self._columns = np.zeros((ROOM, n, 2 * n))
        self._heard, self._pushed = np.zeros((ROOM, n)), np.zeros((ROOM, 2 * n))
        self._sums = np.zeros((ROOM, 4))  # fit, the noise's energy, |y|^2 and |x|^2, each with its weight
        self._costs = np.zeros(ROOM)  # of the gap before

    @property
    def _parts(self) -> tuple[Array, ...]:
        return self._columns, self._heard, self._pushed, self._sums, self._costs

    def heard(self, mask: Array) -> Heard:
        """Return what a sample of some outputs means."""
        key = mask.tobytes()
        found = self._kinds.get(key)
        if found is None:
            root = self._weights.at(mask).y_root
            back = self._C.T @ root.T
            band = lower_band((back @ back.T)[None])[0]
            found = self._kinds[key] = Heard(band, back, root, np.abs(root), float(self._energy(mask[None])[0]))
        return found

    def append(self, node: Node) -> bool:
        """Take in a node; False where it cannot be weighed."""
        k, n = len(self.nodes), self._n
        if k == len(self._columns):
            self._columns, self._heard, self._pushed, self._sums, self._costs = (
                np.concatenate([part, np.zeros_like(part)]) for part in self._parts
            )
        if not k:
            self._zero = node.t
        elif self._eta * (node.t - self._zero) > FAR:
            self._count_from(node.t)
        d, x = math.exp(self._eta * (node.t - self._zero)), node.x
        kind = self.heard(node.mask)
        own, push = self._columns[k], 0.0
        np.multiply(kind.band, d, out=own)
        if k:
            flow = node.flow
            if flow is None or flow.joint is None:
                return False
            self._columns[k - 1 : k + 1] += flow.band * d
            moved = flow.F @ self.nodes[-1].x + node.drift - x
            g = self._pushed[k]
            np.matmul(flow.joint[:, n:], moved * d, out=g)
            push = float(moved @ g[n:])
        half = kind.root @ (node.y - node.feedthrough - self._C @ x)
        size = math.hypot(*half.tolist())
        if not (size < LARGEST and math.isfinite(push)):
            return False
        np.matmul(kind.back, half * d, out=self._heard[k])
        read, held = _square(kind.size @ np.abs(node.y)), _square(self._held @ np.abs(x))
        self._sums[k], self._costs[k] = (size * size * d, kind.energy * d, read, held), push
        self.nodes.append(node)
        self._owned.append(k > 0)
        return True

    def _count_from(self, t: float) -> None:
        """Let discounts count from t."""
        factor, k = math.exp(-self._eta * (t - self._zero)), len(self.nodes)
        for part in (self._columns, self._heard, self._pushed, self._sums[:, :2], self._costs):
            part[:k] *= factor
        self._zero = t

    def forget(self, count: int) -> None:
        """Drop the oldest nodes."""
        kept = len(self.nodes) - count
        for part in self._parts:
            part[:kept] = part[count : count + kept]
        del self.nodes[:count], self._owned[:count]

    def solve(self, first: int, opening: Opening, gap: tuple[GapFlow, Array], new: Arriving) -> Optimum | None:
        """Return the optimum over the nodes from number `first` on; None where that would lose digits.

        Parameters
        ----------
        first : int
        opening : Opening
        gap : (GapFlow, (n,) array)
            From the window's start to the first node, with the inputs' part.
        new : Arriving
        """
        if not self.nodes:
            self._zero = opening.t
        n, eta, zero, inside = self._n, self._eta, self._zero, len(self.nodes) - first
        if eta * max(new.t - zero, zero - opening.t) > WIDEST:
            return None
        begin, end = math.exp(eta * (opening.t - zero)), math.exp(eta * (new.t - zero))
        work, right = np.empty((inside + 2, n, 2 * n)), np.zeros((inside + 2, n))
        fit = push = energy = read = held = 0.0
        work[0] = opening.band * begin
        if inside:
            rows = slice(first, first + inside)
            work[1:-1], right[1:-1] = self._columns[rows], self._heard[rows]
            right[2:-1] += self._pushed[first + 1 : first + inside, n:]
            right[1:-2] += self._pushed[first + 1 : first + inside, :n]
            flow, drift = gap
            node, joint = self.nodes[first], flow.joint
            if joint is None:
                return None
            d = math.exp(eta * (node.t - zero))
            if self._owned[first] and node.flow is not None:
                # the gap from the start is no longer than the whole one and costs no less: no digits are lost
                work[0] += flow.band[0] * d
                if flow is not node.flow:
                    work[1] += (flow.band[1] - node.flow.band[1]) * d
            else:
                work[:2] += flow.band * d
            moved = flow.F @ opening.x + drift - node.x
            g = joint[:, n:] @ (moved * d)
            right[:2] += g.reshape(2, n)
            fit, energy, read, held = self._sums[rows].sum(axis=0).tolist()
            push = float(moved @ g[n:]) + float(self._costs[first + 1 : first + inside].sum())
        if new.flow.joint is None:
            return None
        kind = self.heard(new.mask)
        np.multiply(kind.band, end, out=work[-1])
        work[-2:] += new.flow.band * end
        samples = [(inside + 1, kind, new.y, new.feedthrough, new.x, end)]
        if opening.sample is not None:
            y, mask, feedthrough = opening.sample
            also = self.heard(mask)
            work[0] += also.band * begin
            samples.append((0, also, y, feedthrough, opening.x, begin))
        for k, one, y, feedthrough, x, d in samples:
            half = one.root @ (y - feedthrough - self._C @ x)
            size = math.hypot(*half.tolist())
            if not size < LARGEST:
                return None
            right[k] += one.back @ (half * d)
            fit, energy = fit + size * size * d, energy + one.energy * d
            read += _square(one.size @ np.abs(y))
        held += _square(self._held @ np.abs(opening.x)) + _square(self._held @ np.abs(new.x))
        found = _solved(work, right, fit + push)
        if found is None:
            return None
        x, root, gain = found
        cost = fit + push - gain
        if not cost > CANCELLED * gain:
            return None
        dual = cost - DUAL_MARGIN * (cost + abs(gain))
        return Optimum(new.x + x, (root.T @ root) * end, cost / end, dual / end, energy / end, read, held)


def _square(z: Array) -> float:
    """|z|^2, infinite where it overflows."""
    size = math.hypot(*z.tolist())
    return size * size


def _solved(work: Array, right: Array, size: float) -> tuple[Array, Array, float] | None:
    """Return the last node's deviation, the root of its information inverted, and what the deviations gain."""
    count, n, width = work.shape
    band, b = work.reshape(count * n, width).T, right.ravel()
    diagonal = band[0].copy()
    factor, solution, flag = lapack.dpbsv(band, b, lower=1, overwrite_ab=1)
    if flag or not (factor[0] ** 2 > PIVOT_LIMIT * diagonal).all():
        return None
    gain = float(b @ solution)
    if not (math.isfinite(gain) and math.isfinite(size)):
        return None
    last = lapack.dtrtri(last_block(factor, n), lower=1)[0]
    return solution[-n:], last, gain


class Histories:
    """Sliding bands by their last node, the least recently used dropped first."""

    def __init__(self, weights: Weights, energy: Callable[[Array], Array]):
        self._weights, self._energy = weights, energy
        self._known: OrderedDict[int, SlidingBand] = OrderedDict()

    def of(self, nodes: tuple[Node, ...], first: int) -> tuple[SlidingBand, int] | None:
        """Return the band that ends with the last of `nodes`, and the number in it of node `first`; None if unfit."""
        count = len(nodes) - first
        if not count:
            return SlidingBand(self._weights, self._energy), 0
        band = self._taken(nodes[-1], 0) or (self._taken(nodes[-2], 1) if count > 1 else None)
        if band is not None:
            if band.nodes[-1] is not nodes[-1] and not band.append(nodes[-1]):
                return None
            at = len(band.nodes) - count
            if at >= 0 and band.nodes[at] is nodes[first]:
                if at >= ROOM // 2:
                    band.forget(at)
                    at = 0
                return self._kept(band, at)
        band = SlidingBand(self._weights, self._energy)
        return self._kept(band, 0) if all(map(band.append, nodes[first:])) else None

    def _taken(self, node: Node, missing: int) -> SlidingBand | None:
        band = self._known.pop(id(node), None)
        return band if band is not None and band.nodes and band.nodes[-1] is node else None

    def _kept(self, band: SlidingBand, at: int) -> tuple[SlidingBand, int]:
        self._known[id(band.nodes[-1])] = band
        if len(self._known) > HISTORIES:
            self._known.popitem(last=False)
        return band, at
