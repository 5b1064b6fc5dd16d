"""What a picture can show of more estimates than it has columns: their extremes over equal stretches of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design._record import Record, short
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]

Truths = npt.NDArray[np.bool_]

STRETCHES = 600


@dataclass(frozen=True, eq=False, repr=False)
class EstimateEnvelope(Record):
    """Extremes of estimates and of their proven bounds, at the samples of each stretch of time.

    Attributes
    ----------
    plant : Plant
    edges : (K + 1,) array [time]
    lowest, highest : (K, n) arrays
        Of the estimates; NaN where a stretch has none.
    lower, upper : (K, n) arrays
        Of what is proven at the samples, the estimate and its radius; NaN where nothing is.
    failed : (K,) array of bool
        Whether any of them failed.
    """

    plant: Plant
    edges: Array
    lowest: Array
    highest: Array
    lower: Array
    upper: Array
    failed: Truths

    @classmethod
    def over(cls, plant: Plant, start: float, end: float, stretches: int = STRETCHES) -> EstimateEnvelope:
        """Return an envelope of nothing yet; `add` fills it in place."""
        edges = np.linspace(start, end if end > start else start + 1.0, stretches + 1)
        lowest, highest, lower, upper = np.full((4, stretches, plant.n_states), np.nan)
        return cls(plant, edges, lowest, highest, lower, upper, np.zeros(stretches, dtype=bool))

    def add(self, times: Array, x: Array, radii: Array, certified: Truths, failed: Truths) -> None:
        """Take in estimates x (N, n) at some times, with their radii (N, n) and whether they are proven or failed."""
        share = (times - self.edges[0]) / (self.edges[-1] - self.edges[0])
        at = np.clip((share * self.failed.size).astype(np.intp), 0, self.failed.size - 1)
        np.fmin.at(self.lowest, at, x)
        np.fmax.at(self.highest, at, x)
        around = np.where(np.isfinite(radii) & certified[:, None], radii, np.nan)
        np.fmin.at(self.lower, at, x - around)
        np.fmax.at(self.upper, at, x + around)
        np.logical_or.at(self.failed, at, failed)

    def _rows(self) -> list[tuple[str, str]]:
        return [("stretches", str(self.failed.size)), ("time", f"{short(self.edges[0])} to {short(self.edges[-1])}")]

    def explain(self) -> str:
        """Say what the extremes are of."""
        return f"Extremes of the estimates over {self.failed.size} stretches of time, each state by itself."
