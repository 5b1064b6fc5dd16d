"""The rows C e^{A tau} of k samples, spaced, in one window, addressed by their slacks."""

from __future__ import annotations

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.observability.windows.bracket import ALLOWANCE
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array

_EPS = float(np.finfo(float).eps)
_SURVEY = 128  # times at which the plant is looked at to choose coordinates; no bound rests on them
_GOLDEN = (np.sqrt(5.0) - 1) / 2  # spreads those times evenly and in step with no oscillation


class SpacedRows:
    """A plant observed k times within [0, T], at least epsilon apart.

        tau_i = u_i + (i - 1) epsilon,    0 <= u_1 <= ... <= u_k <= S = T - (k - 1) epsilon

    Raises ArgumentError if e^{A tau} overflows within the window.

    Parameters
    ----------
    plant : Plant
    window, spacing : float
        T and epsilon.
    count : int
        k.

    Attributes
    ----------
    slack : float
        S; 0 where only one schedule is admissible.
    offsets : (k,) array
        (i - 1) epsilon.
    survey : (N p, n) array
        Rows over the whole window, weighted to the size of k samples.
    grade : float
        Relative error granted to C e^{A tau}, of |C||e^{A tau}|.
    """

    def __init__(self, plant: Plant, window: float, count: int, spacing: float) -> None:
        self.A, self.C, self.n, self.p = plant.A, plant.C, plant.n_states, plant.n_outputs
        self.plant, self.window, self.count = plant, window, count
        self.spacing, self.offsets = spacing, spacing * np.arange(count)
        slack = window - float(self.offsets[-1])
        self.slack = slack if slack > 8 * _EPS * window else 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            flow = plant.transition(window * np.append((np.arange(_SURVEY) * _GOLDEN) % 1.0, 1.0))
            size = float(np.linalg.norm(self.C)) * float(np.max(np.linalg.norm(flow, axis=(1, 2)), initial=0.0))
        if not np.isfinite(size**4):
            raise ArgumentError(
                f"`family.window` = {window:.6g} is too long for this plant: e^(A t) overflows within it. "
                "Split off the fast unstable modes or use a shorter window."
            )
        self.survey = (self.C @ flow).reshape(-1, self.n) * np.sqrt(count / (_SURVEY + 1))
        self.grade = ALLOWANCE * max(1.0, float(np.linalg.norm(self.A, 1)) * window / 200)

    def times(self, slacks: Array) -> Array:
        """Sample times (..., k) of slacks (..., k), within [0, T]."""
        return np.minimum(slacks + self.offsets, self.window)

    def at(self, times: Array) -> Array:
        """Rows C e^{A tau}, shape (*times.shape, p, n)."""
        return (self.C @ self.plant.transition(times.ravel())).reshape(*times.shape, self.p, self.n)

    def observed(self, slacks: Array) -> Array:
        """The matrices O (B, k p, n) of schedules (B, k)."""
        return self.at(self.times(slacks)).reshape(slacks.shape[0], -1, self.n)

    def grid(self, cells: int) -> tuple[Array, Array]:
        """Slacks j S/cells, and the times (k, cells + 1) that each sample can take there."""
        slacks = self.slack * np.arange(cells + 1) / cells
        return slacks, self.times(slacks[:, None]).T

    def coordinates(self, worst: Array | None = None) -> tuple[Array, Array]:
        """Return L and its inverse, x = L z: a survey of the window, and the schedule `worst`, see all z alike.

        An unobservable direction is scaled as if it were seen n eps of the best seen one.
        """
        stacked = self.survey if worst is None else np.vstack([self.survey, self.observed(worst[None])[0]])
        _, singular, right = np.linalg.svd(stacked, full_matrices=False)
        scale = np.maximum(singular, max(self.n * _EPS * float(singular[0]), 1e-300))
        return right.T / scale, scale[:, None] * right

    def blur(self, times: Array) -> Array:
        """How far rounding in the exponentials can move |C e^{A tau} x|, |x| = 1, for each of `times` (N,)."""
        flow = np.linalg.norm(self.plant.transition(times), axis=(1, 2))
        return np.asarray(self.grade * float(np.linalg.norm(self.C)) * flow)

    def rounding(self, slacks: Array) -> float:
        """How far rounding in the exponentials can move sigma of one schedule (k,)."""
        return float(np.linalg.norm(self.blur(self.times(slacks))))

    def counts_as_zero(self, sigma: float, slacks: Array) -> bool:
        """Whether sigma of this schedule cannot be distinguished from 0."""
        least = self.n * _EPS * float(np.linalg.norm(self.observed(slacks[None])))
        return sigma <= max(least, self.rounding(slacks))
