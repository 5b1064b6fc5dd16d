"""Windows of a plant whose flow turns states and stretches none, at a tenth of what others cost.

Where e^{As} is orthogonal, sigma is the same wherever a window begins between two samples, and seen from time 0 as well
as from there. If the window holds whole periods, only one window for each sample is left; from one to the next the
rows of a sample, C e^{As}, leave and come back a window later.
"""

from __future__ import annotations

import numpy as np

from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask

WHOLE = 1e-11  # relative: windows that are a whole number of periods to rounding
_STRETCH = 1e-11  # exponent by which states may grow over a window, and still count as turned
BATCH_NUMBERS = 400_000  # numbers per batch: fits into a cache
UNSURE = 1e-5
"""Of the largest eigenvalue of a window's Gram matrix: a least one below it has lost digits to the sums here."""


class OrthogonalFlowWindows:
    """Gram matrices, in the plant's own coordinates, of the windows that begin just before each of k samples."""

    def __init__(self, plant: Plant, window: float, period: float) -> None:
        self.skew = (plant.A - plant.A.T) / 2
        self.speeds, self.modes = np.linalg.eigh(-1j * self.skew)
        self.outputs = plant.C @ self.modes
        self.period, self.repeats = period, round(window / period)
        self.stretch = float(np.linalg.norm(plant.A + plant.A.T, 2)) * window / 2

    @property
    def fastest(self) -> float:
        """Highest frequency of a quadratic form of rows, in radians per time; that of one turn a window at least."""
        return float(2 * max(np.abs(self.speeds).max(), np.pi / (self.repeats * self.period)))

    @classmethod
    def of(cls, plant: Plant, window: float, period: float) -> OrthogonalFlowWindows | None:
        """None where the flow stretches, or the window holds no whole number of periods."""
        ratio = window / period
        whole = ratio > 1 - WHOLE and abs(ratio - round(ratio)) <= WHOLE * ratio
        found = cls(plant, window, period) if whole else None
        return found if found is not None and found.stretch <= _STRETCH else None

    def rows(self, times: Array, mask: Mask) -> Array:
        """Rows C e^{As}, (*times.shape, p, n), zero where `mask` says that nothing is seen."""
        return np.asarray((self._turned(times, mask) @ self.modes.conj().T).real)

    def _turned(self, times: Array, mask: Mask) -> Array:
        turned = self.outputs * np.exp(1j * self.speeds * times[..., None])[..., None, :] * mask[..., None]
        return np.asarray(turned)

    def grams(self, times: Array, mask: Mask) -> Array:
        """(B, k, n, n) of the windows of each schedule (B, k) of sorted times."""
        return self._windows([self.rows(times + r * self.period, mask) for r in range(self.repeats + 1)])

    def _windows(self, rows: list[Array]) -> Array:
        """The Gram matrices of the windows, of the rows of each repetition."""
        grams_of_repeats = [squares(each) for each in rows]
        first = np.sum(grams_of_repeats[:-1], axis=(0, 2))[:, None]
        moved = np.cumsum((grams_of_repeats[-1] - grams_of_repeats[0])[:, :-1], axis=1)
        return np.concatenate([first, first + moved], axis=1)

    def worst(self, times: Array, mask: Mask) -> tuple[Array, Mask]:
        """Least sigma^2 of each schedule, and whether it has digits enough to say so."""
        ends = np.empty((2, times.shape[0]))
        chunk = max(1, BATCH_NUMBERS // (times.shape[1] * self.outputs.shape[1] ** 2))
        for low in range(0, times.shape[0], chunk):
            part = slice(low, low + chunk)
            values = np.linalg.eigvalsh(self.grams(times[part], mask[part]))
            ends[:, part] = values[..., 0].min(axis=1), values[..., -1].max(axis=1)
        return ends[0], ends[0] > UNSURE * ends[1]

    def soft(self, times: Array, mask: Mask, sharpness: float) -> tuple[float, Array]:
        """-log(sum of e^{-sharpness lambda})/sharpness over all eigenvalues lambda of all windows, and its gradient.

        A smooth function below the least eigenvalue: it comes as near as log(k n)/sharpness.
        """
        turned = [self._turned(times + r * self.period, mask) for r in range(self.repeats + 1)]
        back = self.modes.conj().T
        rows = [(each @ back).real for each in turned]
        values, vectors = np.linalg.eigh(self._windows([each[None] for each in rows])[0])
        least = float(values.min())
        shares = np.exp(-sharpness * (values - least))
        total = float(shares.sum())
        M = (vectors * (shares / total)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        later = np.cumsum(M[::-1], axis=0)[::-1]
        every, after = later[0], np.concatenate([later[1:], np.zeros_like(M[:1])])  # windows that begin behind it
        slope = np.zeros(times.size)
        for r in range(self.repeats + 1):
            c, d = rows[r], ((turned[r] * (1j * self.speeds)) @ back).real
            held = every - after if r == 0 else (after if r == self.repeats else every)
            slope += 2 * np.sum((c @ held) * d, axis=(1, 2))
        return least - float(np.log(total)) / sharpness, slope


def squares(rows: Array) -> Array:
    """Gram matrices of rows (..., p, n)."""
    return np.asarray(np.swapaxes(rows, -1, -2) @ rows)
