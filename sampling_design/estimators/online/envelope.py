"""What a picture shows of estimates: each of a few, of many the extremes over equal stretches of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import Record, short

STRETCHES = 600  # stretches of a record that has more times than that: about one for each column of dots of a picture


@dataclass(frozen=True, eq=False, repr=False)
class EstimateEnvelope(Record):
    """Extremes of estimates and of their proven bounds, at each time of a few, else at the samples of each stretch.

    Attributes
    ----------
    plant : Plant
    times : (K,) array [time]
        Of the samples, or the middles of the stretches.
    length : float [time]
        Of a stretch; 0 where each time stands for itself.
    lowest, highest : (K, n) arrays
        Of the estimates; NaN where a stretch has none.
    lower, upper : (K, n) arrays
        Of what is proven at the samples, the estimate and its radius; NaN where nothing is.
    failed : (K,) array of bool
        Whether any of them failed.
    """

    plant: Plant
    times: Array
    length: float
    lowest: Array
    highest: Array
    lower: Array
    upper: Array
    failed: Mask

    @classmethod
    def over(cls, plant: Plant, times: npt.ArrayLike, stretches: int = STRETCHES) -> EstimateEnvelope:
        """Return an envelope of nothing yet for estimates at some times; `add` fills it in place."""
        places, length = np.unique(np.asarray(times, dtype=float)), 0.0
        if places.size > stretches:
            length = float((places[-1] - places[0]) / stretches)
            places = places[0] + length * (np.arange(stretches) + 0.5)
        lowest, highest, lower, upper = np.full((4, places.size, plant.n_states), np.nan)
        return cls(plant, places, length, lowest, highest, lower, upper, np.zeros(places.size, dtype=bool))

    @property
    def edges(self) -> Array:
        """Where stretches begin, and where the last one ends (K + 1,)."""
        return np.append(self.times - self.length / 2, self.times[-1:] + self.length / 2)

    def add(self, times: Array, x: Array, radii: Array, certified: Mask, failed: Mask) -> None:
        """Take in estimates x (N, n) at some of the times, with their radii (N, n) and whether proven or failed."""
        begin = self.times if self.length == 0 else self.edges[:-1]
        at = np.maximum(np.searchsorted(begin, times, side="right") - 1, 0)
        np.fmin.at(self.lowest, at, x)
        np.fmax.at(self.highest, at, x)
        around = np.where(np.isfinite(radii) & certified[:, None], radii, np.nan)
        np.fmin.at(self.lower, at, x - around)
        np.fmax.at(self.upper, at, x + around)
        np.logical_or.at(self.failed, at, failed)

    def _rows(self) -> list[tuple[str, str]]:
        edges = self.edges
        what = "stretches" if self.length else "times"
        return [(what, str(self.times.size)), ("time", f"{short(edges[0], 12)} to {short(edges[-1], 12)}")]

    def explain(self) -> str:
        """Say what the extremes are of."""
        where = f"over {self.times.size} stretches of time" if self.length else f"at {self.times.size} times"
        return f"Extremes of the estimates {where}, each state by itself."
