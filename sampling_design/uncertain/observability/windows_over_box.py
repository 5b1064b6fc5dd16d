"""The windows of one schedule for cells of a box of plants: bounds, values of single plants, what they do not show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.observability.windows.pieces import WindowPieces
from sampling_design.records.arrays import Array, Mask
from sampling_design.uncertain.box.branching import UNOBSERVABLE
from sampling_design.uncertain.box.expansion import BoxCells
from sampling_design.uncertain.box.least import least_sigma
from sampling_design.uncertain.box.model import BoxModel


class WindowsOverBox:
    """Sigma of the windows of one schedule, for cells of a box."""

    def __init__(
        self, model: BoxModel, pieces: WindowPieces, *, losing: bool = False, unobservable_share: float = UNOBSERVABLE
    ) -> None:
        """With `losing` every piece once for each of its samples, without that: of the number `lost`."""
        held = np.maximum(pieces.stop - pieces.first, 0) if losing else np.ones(len(pieces), dtype=np.intp)
        piece = np.repeat(np.arange(len(pieces)), held)
        self.lost = pieces.first[piece] + np.arange(piece.size) - np.repeat(np.cumsum(held) - held, held)
        if losing:
            left, right, first, stop = pieces.left[piece], pieces.right[piece], pieces.first[piece], pieces.stop[piece]
            pieces = replace(pieces, left=left, right=right, first=first, stop=stop)
        self.model, self.pieces, self.unobservable_share = model, pieces, unobservable_share
        self.times, self.measured = _padded(pieces, len(model.C))
        if losing:
            self.measured[np.arange(len(pieces)), self.lost - pieces.first] = False

    def too_few(self) -> int | None:
        """A piece with fewer measurements than states."""
        few = np.flatnonzero(self.measured.sum(axis=(1, 2)) < self.model.n)
        return int(few[0]) if few.size else None

    def cells(self) -> BoxCells:
        """The whole box, once for each piece."""
        pieces, count = self.pieces, len(self.pieces)
        box = np.zeros((count, self.model.m))
        half = (pieces.right - pieces.left) / 2 + pieces.tolerance
        return BoxCells(box, box + 1, (pieces.left + pieces.right) / 2, half, np.arange(count))

    def judge(self, cells: BoxCells) -> tuple[Array, Array, Array]:
        """Lower bounds, values at the centres, and what each direction matters; for all times that pieces allow."""
        piece, late = cells.piece, self.pieces.timing_tolerance.radius
        times = self.times[piece] - cells.s[:, None]
        return least_sigma(self.model, cells, times, self.measured[piece], late)

    def value(self, u: Array, s: float, piece: int) -> float:
        """Sigma of one plant and window."""
        return float(np.linalg.svd(self._rows(u, s, piece) / self.model.unit, compute_uv=False)[self.model.n - 1])

    def unobservable(self, u: Array, s: float, piece: int) -> bool:
        """Whether one plant has a direction that its window does not show, in whatever units."""
        least = np.linalg.svd(self._rows(u, s, piece), compute_uv=False)[self.model.n - 1]
        return bool(least <= self.unobservable_share * np.linalg.norm(self.model.C))

    def _rows(self, u: Array, s: float, piece: int) -> Array:
        """The rows of one plant and window, in balanced coordinates."""
        plant, at = self.model.balanced_at(u), self.pieces.samples(piece) - s
        return np.asarray((plant.C @ plant.transition(at))[self.measured[piece][: at.size]])


def _padded(pieces: WindowPieces, outputs: int) -> tuple[Array, Mask]:
    """Sample times (P, N) of every piece and what is measured (P, N, p), filled up with what is not."""
    count = pieces.stop - pieces.first
    most = max(1, int(count.max(initial=0)))
    index = pieces.first[:, None] + np.arange(most)
    there = index < pieces.stop[:, None]
    if not len(pieces.times):
        return np.zeros(there.shape), np.zeros((*there.shape, outputs), dtype=bool)
    index = np.where(there, index, 0)
    mask = np.ones((len(pieces.times), outputs), dtype=bool) if pieces.mask is None else pieces.mask
    return pieces.times[index], there[..., None] & mask[index]
