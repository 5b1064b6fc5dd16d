"""The worst time of each row over the period: of the segments between solved offsets the highest is cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sampling_design.recovery.between import Open, open_row
from sampling_design.recovery.chain import CELL_LOSS, SampleChain
from sampling_design.recovery.program import Adversary, ConeWindow, Gains

Array = npt.NDArray[np.float64]

FINEST = 1e-5
"""Least share that a disturbance constant on cells may lose by the curvature of e^{As}G."""

SHARE = 0.75
"""Share of the tolerance within which both sides of one target must meet; the rest is for the time between targets."""

PROFILE = 1.05
"""Ratio of the two bounds at which a gap's profile counts as known."""

MOST_FILLED = 12
"""Offsets solved on one gap for its profile."""

MOST_ATTACKS = 4
"""On one gap, for its profile."""

LONGEST = 4096
"""Samples back beyond which the past is not followed."""


@dataclass(eq=False)
class SolvedOffset:
    """One offset at which the program was solved: what its gains prove."""

    offset: int
    gains: Gains


@dataclass(eq=False)
class Attack:
    """An adversary against a row after sample j: what it attains at every offset of the gap."""

    sample: int
    adversary: Adversary
    values: Array


@dataclass(eq=False)
class RowSearch:
    """Everything found about one row: solved offsets per gap, adversaries, and the bracket."""

    opened: list[Open]
    nodes: list[dict[int, SolvedOffset]] = field(default_factory=list)
    attacks: list[Attack] = field(default_factory=list)
    lower: float = 0.0
    upper: float = np.inf
    worst: tuple[int, int] = (0, 0)
    closed: bool = False

    def below(self) -> Array:
        """What adversaries attain at the start of every panel of the period."""
        parts = []
        for j, opened in enumerate(self.opened):
            best = np.array(opened.below)
            for attack in self.attacks:
                if attack.sample == j:
                    best = np.maximum(best, np.abs(attack.values))
            parts.append(best[:-1])
        return np.concatenate(parts)

    def above(self) -> Array:
        """What gains prove over every panel of the period."""
        parts = []
        for opened, nodes in zip(self.opened, self.nodes, strict=True):
            solved = sorted(nodes)
            for a, b in pairwise(solved):
                parts.append(opened.bound(a, b, nodes[a].gains.value, nodes[b].gains.value))
        return np.concatenate(parts)


class ChainSearch:
    """Windows of a chain, made once for each phase and remembered."""

    def __init__(self, chain: SampleChain, solved: Callable[[], None] = lambda: None):
        self.chain, self._tell = chain, solved
        self._windows: dict[tuple[int, int, bool], ConeWindow] = {}
        self.back = self.deep = 8
        self.cell_loss = CELL_LOSS
        self.solves = 0

    def window(self, j: int, count: int, from_zero: bool) -> ConeWindow:
        """The window of `count` samples that ends with sample j."""
        key = (j, count, from_zero)
        if key not in self._windows:
            nodes = self.chain.nodes(j, count)
            start = np.zeros(self.chain.D.size) if from_zero else self.chain.reach[nodes[0]]
            self._windows[key] = ConeWindow(self.chain, nodes, start)
        return self._windows[key]

    def gains(self, j: int, mu: Array) -> Gains:
        """Gains for mu'z_j over `back` samples."""
        self.solves += 1
        self._tell()
        return self.window(j, self.back, False).gains(mu)

    def attack(self, j: int, mu: Array) -> tuple[Gains, Adversary]:
        """An adversary from rest against mu'z_j over `deep` samples, and the gains that come with it."""
        self.solves += 1
        self._tell()
        gains, adversary = self.window(j, self.deep, True).both(mu)
        return self.proven(j, mu, gains), adversary

    def proven(self, j: int, mu: Array, gains: Gains) -> Gains:
        """What the gains of a start at rest prove when the past is endless."""
        return self.window(j, len(gains.gains), False).upper(mu, list(gains.gains))

    def improve(self, j: int, mu: Array, best: Gains, below: float, rtol: float) -> bool:
        """Whether longer windows, or finer cells, bring the two sides of one target closer; if so they stay."""
        if 2 * self.deep <= LONGEST:
            self.deep *= 2
            gains, adversary = self.attack(j, mu)
            if adversary.value > below * (1 + rtol / 8) or gains.value < best.value * (1 - rtol / 8):
                return True
            self.deep //= 2
        if 2 * self.back <= self.deep:
            self.back *= 2
            if self.gains(j, mu).value < best.value * (1 - rtol / 8):
                return True
            self.back //= 2
        if self.cell_loss <= FINEST:
            return False
        self.cell_loss /= 4
        self.chain = self.chain.refined(self.cell_loss)
        self._windows.clear()
        gains, adversary = self.attack(j, mu)
        target = min(best.value * (1 - rtol), below * (1 + rtol / 8))
        return adversary.value >= target or gains.value < best.value * (1 - rtol / 8)

    def opened(self, row: Array) -> RowSearch:
        """A row over the period, with nothing solved yet."""
        found = RowSearch([open_row(self.chain, j, row) for j in range(len(self.chain))])
        found.nodes = [{} for _ in found.opened]
        return found

    def restore(self, found: RowSearch, j: int, offsets: list[int], gains: tuple[tuple[Array, ...], ...]) -> None:
        """Evaluate given gains at offsets after sample j; no solver."""
        for offset, given in zip(offsets, gains, strict=True):
            window = self.window(j, len(given), False)
            found.nodes[j][offset] = SolvedOffset(offset, window.upper(found.opened[j].mu[offset], list(given)))

    def profile(self, found: RowSearch) -> None:
        """Attack every gap where its two bounds are furthest apart: the lower one, too, is known at all times."""
        for j, nodes in enumerate(found.nodes):
            opened = found.opened[j]
            self._fill(found, j)
            tried: set[int] = set()
            while len(tried) < MOST_ATTACKS:
                best = np.max([np.abs(a.values) for a in found.attacks if a.sample == j] or [opened.below], axis=0)
                left = {o: (node.gains.value + opened.above[o]) for o, node in nodes.items() if o not in tried}
                left = {o: value / best[o] if best[o] > 0 else np.inf for o, value in left.items() if value > 0}
                if not left or max(left.values()) <= PROFILE:
                    break
                offset = max(left, key=lambda o: left[o])
                tried.add(offset)
                self._attack(found, j, offset)

    def _fill(self, found: RowSearch, j: int) -> None:
        """Cut the segments of a gap whose bound rises most above its ends, until the curve is smooth."""
        opened, nodes = found.opened[j], found.nodes[j]
        for _ in range(MOST_FILLED):
            rises = []
            for a, b in pairwise(sorted(nodes)):
                ends = max(nodes[o].gains.value + float(opened.above[o]) for o in (a, b))
                top = opened.between(a, b, nodes[a].gains.value, nodes[b].gains.value)[0]
                rises.append((top / ends if ends > 0 else 1.0, a, b))
            rise, a, b = max(rises)
            if rise <= PROFILE or b - a < 2:
                return
            self._node(found, j, (a + b) // 2)

    def row(self, row: Array, rtol: float, most: int) -> RowSearch:
        """Bracket the worst time of one row to `rtol`, with at most so many solves."""
        found = self.opened(row)
        for j, opened in enumerate(found.opened):
            for offset in (0, opened.d.size - 1):
                self._node(found, j, offset)
        limit = self.solves + most
        while True:
            top, j, a, b, panel = max(self.segments(found))
            found.upper, found.worst = top, (j, panel)
            if top <= found.lower * (1 + rtol):
                found.closed = True
                return found
            if self.solves >= limit:
                return found
            high, at, offset = self._highest(found)
            if len(found.nodes[at][offset].gains.gains) < self.back:
                self._node(found, at, offset)
            elif top > high * (1 + 0.9 * rtol * (1 - SHARE)) and b - a > 1:
                self._node(found, j, (a + b) // 2)
            elif not self._close(found, high, at, offset, rtol):
                return found

    def _highest(self, found: RowSearch) -> tuple[float, int, int]:
        """The largest bound at a solved offset, its sample and the offset."""
        return max(
            (node.gains.value + float(found.opened[j].above[offset]), j, offset)
            for j, nodes in enumerate(found.nodes)
            for offset, node in nodes.items()
        )

    def _close(self, found: RowSearch, high: float, j: int, offset: int, rtol: float) -> bool:
        """Whether an attack at an offset, or better windows, brought its two sides closer."""
        below, above = self._attack(found, j, offset)
        if below * (1 + rtol * SHARE) >= high:
            return True
        if above < high * (1 - rtol / 8):  # a longer past says more
            self.back = min(2 * self.back, self.deep)
            return True
        known = below - float(found.opened[j].below[offset])
        if not self.improve(j, found.opened[j].mu[offset], found.nodes[j][offset].gains, known, rtol):
            return False
        self._node(found, j, offset)
        return True

    def _node(self, found: RowSearch, j: int, offset: int) -> None:
        gains, old = self.gains(j, found.opened[j].mu[offset]), found.nodes[j].get(offset)
        if old is None or gains.value < old.gains.value or len(gains.gains) > len(old.gains.gains):
            found.nodes[j][offset] = SolvedOffset(offset, gains)

    def strike(self, found: RowSearch, j: int, offset: int) -> tuple[Gains, Attack]:
        """Attack a row at an offset after sample j: what its gains prove, and what it attains all along the gap."""
        opened = found.opened[j]
        gains, adversary = self.attack(j, opened.mu[offset])
        return gains, Attack(j, adversary, opened.mu @ adversary.z[-1] + opened.below)

    def _attack(self, found: RowSearch, j: int, offset: int) -> tuple[float, float]:
        """Strike at an offset; what is attained there, and what gains prove there now."""
        opened = found.opened[j]
        gains, attack = self.strike(found, j, offset)
        values = attack.values
        found.attacks.append(attack)
        found.lower = max(found.lower, float(np.max(values)))
        if gains.value < found.nodes[j][offset].gains.value:
            found.nodes[j][offset] = SolvedOffset(offset, gains)
        return float(values[offset]), found.nodes[j][offset].gains.value + float(opened.above[offset])

    def segments(self, found: RowSearch) -> list[tuple[float, int, int, int, int]]:
        """Bound, sample, both ends and the highest panel of every segment."""
        segments = []
        for j, nodes in enumerate(found.nodes):
            solved = sorted(nodes)
            for a, b in pairwise(solved):
                bound, panel = found.opened[j].between(a, b, nodes[a].gains.value, nodes[b].gains.value)
                segments.append((bound, j, a, b, panel))
        return segments
