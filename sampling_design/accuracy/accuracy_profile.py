"""What an accuracy shows over time, and the gains that prove it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze


@dataclass(frozen=True, eq=False)
class GapProof:
    """Gains for some directions at one sample: what bounds every row from above over the gap that follows."""

    sample: int  # its place in the schedule's period
    directions: Array  # (m, n): in the coordinates of the system
    # for each direction, the gains of the samples back in time, the latest last, in units of v_bound
    gains: tuple[tuple[Array, ...], ...]


@dataclass(frozen=True, eq=False)
class AccuracyProfile:
    """Both bounds over time: `upper` holds all along [edges[k], edges[k+1]], `lower` is attained at edges[k].

    Attributes
    ----------
    edges : (N+1,) array
        From the first sample of a period on, or from the start of a finite schedule [the plant's time unit].
    lower : (r, N) array
    upper : (r, N) array
        Infinite where the samples taken by then do not determine the row.
    samples : (m,) array
        Sample times.
    """

    edges: Array
    lower: Array
    upper: Array
    samples: Array

    def repeated(self, times: Array) -> AccuracyProfile:
        """The profile of one period over as many of them as `times` (sample times from the same first one on) fill."""
        count = times.size // self.samples.size
        starts = times[:: self.samples.size] - times[0]
        edges = np.append((self.edges[:-1] + starts[:, None]).ravel(), self.edges[-1] + starts[-1])
        return AccuracyProfile(
            freeze(edges), freeze(np.tile(self.lower, count)), freeze(np.tile(self.upper, count)), times
        )
