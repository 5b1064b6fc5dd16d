"""The sliding bands of an estimator's histories, each found by its last node."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.online.history import HistoryNode
from sampling_design.estimators.window.sliding import ROOM, SlidingBand
from sampling_design.records.arrays import Array

HISTORIES = 64  # histories of one estimator that are remembered side by side

NOTHING: tuple[HistoryNode | None, SlidingBand | None] = (None, None)


class BandCache:
    """Sliding bands by their last node, the least recently used dropped first."""

    def __init__(self, weights: CostWeights, energy: Callable[[Array], Array]):
        self._weights, self._energy = weights, energy
        self._known: OrderedDict[int, tuple[HistoryNode, SlidingBand]] = OrderedDict()
        self._begun: SlidingBand | None = None

    def of(self, nodes: tuple[HistoryNode, ...], first: int) -> tuple[SlidingBand, int] | None:
        """Return the band that ends with the last of `nodes`, and the number in it of node `first`; None if unfit."""
        count = len(nodes) - first
        if not count:
            return SlidingBand(self._weights, self._energy), 0
        node, band = self._known.pop(id(nodes[-1]), NOTHING)
        if band is not None and node is nodes[-1] and band.settle(node):
            at = len(band.nodes) - count
            if at >= 0 and band.nodes[at] is nodes[first]:
                if at >= ROOM // 2:
                    band.forget(at)
                    at = 0
                return band, at
        band = SlidingBand(self._weights, self._energy)
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
