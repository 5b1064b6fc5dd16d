"""Claim "family": the weights hold on every schedule of a family, from every real window start.

1. Every schedule of the family, from every window start, is a path in the graph (`cover.py`).
2. Edge u -> v: U(h) = (I - KC) Y(h) (I - KC)' + K V K' <= P_v^-1 for all h in [low, high], Y(h) = F P_u^-1 F' + W,
   for any gain K: with one K on a cell of length d, U is affine in Y, and Y <= chord + (d^2/8) sup|Y''| I.
3. Node u: Y(s) <= target^-1 likewise, without a sample, up to the longest edge that leaves u.
"""

import numpy as np

from .cover import judge
from .family_file import OF_FAMILY, OfFamily, of_family
from .frame import Frame, largest, size, turned
from .numbers import EPS, definite, problem, targets
from .outcome import Refused, Verdict, WorkLimit, holds
from .parts import Claim
from .strict import Array, Index

CELLS = 8  # cells per interval at first
ROUNDS = 40  # halvings of a cell
MOST_CELLS = 400_000  # cells of one target, all rounds together


SUBJECT = "every schedule of the family, every real window start and every later t"


def prove(c: OfFamily, work: WorkLimit | None = None) -> Verdict:
    """Prove that the graph holds the family, and every edge and node."""
    judge(c.family, c.graph)
    numbers, graph, w = problem(c.plant, c.weights), c.graph, c.weights
    stated = targets(numbers, w.margin, numbers.P1, w.lam)
    inequality = " and ".join(name for _, name in stated)
    if not numbers.n:
        return holds(inequality, 1.0, SUBJECT)
    P = np.stack([numbers.P2, *(definite(f"P_{u + 1}", M, numbers.units) for u, M in enumerate(graph.P[1:]))])
    patterns = sorted({edge.outputs for edge in graph.edges})
    slack, masks = 1.0, np.array(patterns, bool).reshape(-1, len(c.plant.C))
    for v in sorted({edge.target for edge in graph.edges}):
        entering = [edge for edge in graph.edges if edge.target == v]
        kinds = np.array([patterns.index(edge.outputs) for edge in entering])
        ends = np.array([[edge.low, edge.high] for edge in entering])
        intervals = Intervals(numbers, P[v], f"Phi(P_u) + C'R~C >= P_{v}", masks, work)
        slack = min(slack, intervals.prove(P[[edge.source for edge in entering]], kinds, ends[:, 0], ends[:, 1]))
    tops, none = np.array([graph.top(u) for u in range(len(P))]), np.zeros((1, len(c.plant.C)), bool)
    for target, name in stated:
        intervals = Intervals(numbers, target, name, none, work)
        slack = min(slack, intervals.prove(P, np.zeros(len(P), int), 0 * tops, tops))
    return holds(inequality, slack, SUBJECT)


class Intervals(Frame):
    """Proof of U(h) <= I over intervals of h, in the coordinates of one target."""

    def prove(self, P: Array, kinds: Index, low: Array, high: Array) -> float:
        """Prove U <= I from each P, for samples of each kind, on every interval; return the slack."""
        start, bands = self.inverse_of(P)
        owner = np.repeat(np.arange(len(P)), CELLS)
        cuts = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, CELLS + 1)
        cuts[:, -1] = high
        a, b, total, top = cuts[:, :-1].ravel(), cuts[:, 1:].ravel(), 0, 0.0
        for _ in range(ROUNDS):
            total += owner.size
            if not owner.size or total > MOST_CELLS:
                break
            self.spend(8 * owner.size)
            h = np.concatenate([a, b, (a + b) / 2])
            ends, where = np.unique(h, return_inverse=True)
            flows, kind = self.flow(ends)[where], kinds[owner]
            Y, lost = self.along(np.tile(start[owner], (3, 1, 1)), flows)
            E = flows.F @ np.tile(bands[owner], (3, 1, 1)) @ turned(flows.F) + 2 * lost
            self.violated(Y, E, np.tile(kind, 3), h)
            first, last, middle = np.split(Y, 3)
            K = self.gain(middle, kind)
            (U, left, _), (other, _, _) = self.after(first, kind, K), self.after(last, kind, K)
            bulge = (1 + 1e-9) * size(left) ** 2 * self.curvature(first, b - a)
            bound = np.maximum(largest(U, 0.5), largest(other, 0.5)) + bulge
            top = max(top, bound[bound <= self.one].max(initial=0.0))
            rest = ~(bound <= self.one)
            owner, a, b = owner[rest], a[rest], b[rest]
            owner, a, b = np.tile(owner, 2), np.append(a, (a + b) / 2), np.append((a + b) / 2, b)
        if owner.size:
            raise self.undecided("it is tight or nearly so")
        return float(self.one - top)

    def violated(self, Y: Array, E: Array, kind: Index, h: Array) -> None:
        """Refused if the least U exceeds I at some h."""
        K = self.gain(Y, kind)
        U, left, lost = self.after(Y, kind, K)
        values = largest(U, 1.0)
        doubtful = np.flatnonzero(values > 1)
        if not doubtful.size:
            return
        band = size(self.band_after(E, Y, kind, K, left, lost)) + 8 * self.n * EPS * size(U)
        k = int(doubtful[np.argmax((values - band)[doubtful])])
        if values[k] - band[k] > 2 - self.one:
            amount = float(1 / values[k] - 1)
            reason = f"{self.inequality} fails by {-amount:.3g} at gap {h[k]:.6g}"
            raise Refused(self.inequality, reason, amount, float(h[k]))


CLAIM = Claim(OF_FAMILY, of_family, prove)
