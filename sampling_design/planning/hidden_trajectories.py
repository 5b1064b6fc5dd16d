"""Hidden trajectories: trajectories that reach a goal's tolerance, and where in the period they would be seen.

A trajectory whose every output stays below its bound wherever a schedule measures is admissible for that schedule: with
reach r and a schedule that sees nothing, no estimator guarantees less than r. Scaled down, it also bounds schedules
that would see it: by r over the largest ratio of output to bound that they measure. Moved by whole steps it is an
trajectory again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sampling_design.planning.adversary_program import DisturbedTrajectory
from sampling_design.records.arrays import Array, Index, Mask

HIDDEN = 1 - 1e-9  # an output counts as hidden if its ratio to the bound is below this: rounding never hides anything
MANY = 64  # measurements from which on it is quicker to go from the largest ratio down than to look at all of them
MOST_ENDS = 400  # ends of one trajectory, the strongest, that are looked at when a swap is weighed


@dataclass(frozen=True, eq=False)
class HiddenTrajectory:
    """A trajectory against one goal, or a tangent of its variance where it is a standard deviation.

    Of a trajectory, measurements see it or not. A tangent says that the variance is at least reach^2 less the sum of
    `peaks` over what is measured.
    """

    goal: int
    reach: float  # what it does to the goal's row, over the tolerance
    end: int  # the step (before any turn of the period) at which it does so
    at_sample: bool  # whether the step's own samples count (accuracy after a sample), else the time just before them
    # (M, p): for each step of the period, counted back from the end (0: the end itself), the largest ratio of output to
    # bound over all periods; of a tangent, its slopes
    peaks: Array
    response: DisturbedTrajectory | None = None  # None for a tangent
    point: Array | None = None  # (M, p): where a tangent touches, in steps back from the end
    parts: int = 1
    """Steps of the response in one of the grid: it begins at a step of the grid and ends within the step `end`."""

    @property
    def early(self) -> int:
        """Of these, how many before the step `end` it ends."""
        return 0 if self.response is None else -len(self.response.w) % self.parts

    def in_parts(self) -> HiddenTrajectory:
        """Its end on the grid of its response, where it is simulated."""
        return replace(self, end=self.end * self.parts - self.early, parts=1)

    def on_grid(self, parts: int) -> HiddenTrajectory:
        """One on a grid of which so many steps are one on that: only there may be measured."""
        own = replace(self, parts=parts)
        back = np.arange(0, len(self.peaks), parts) - own.early  # -k: what shows less than a period before the end
        return replace(own, end=-(-self.end // parts), peaks=self.peaks[back])

    @property
    def touches(self) -> Array:
        """Where a tangent touches."""
        assert self.point is not None
        return self.point

    @property
    def at_touch(self) -> HiddenTrajectory:
        """The tangent less what it says of measurements where it touches a choice that takes all of them.

        With z <= 1, reach^2 - sum s (z - 1) over these is at least reach^2: the row asks only for others.
        """
        whole = self.touches == 1
        reach = float(np.sqrt(max(self.reach**2 - float(self.peaks[whole].sum()), 0.0)))
        return replace(self, reach=reach, peaks=np.where(whole, 0.0, self.peaks))

    def weights(self, level: float) -> Array:
        """What measuring at each step back from the end, and sensor, adds; a choice for `level` must add up to 1.

        One for what sees a trajectory that is scaled to reach just the level; a tangent's slopes over what is missing.
        """
        if self.response is not None:
            return np.asarray(self.peaks * (level / self.reach) > HIDDEN, dtype=float)
        missing = (self.reach**2 - level**2) * HIDDEN
        return np.minimum(self.peaks, missing) / missing if missing > 0 else np.ones_like(self.peaks)


def peaks_of(outputs: Array, steps: int, at_sample: bool, unread_steps: Index | None = None) -> Array:
    """Largest |output| (T+1, p) by steps back from the end, folded into one period; the end itself only if asked.

    Results that are out may be anything: those of each output for the last `unread_steps` steps (p,).
    """
    T, p = len(outputs), outputs.shape[1]
    periods = -(-T // steps)
    back = np.zeros((periods * steps, p))
    back[:T] = np.abs(outputs[::-1])
    if not at_sample:
        back[0] = 0.0
    for i, steps_out in enumerate(() if unread_steps is None else unread_steps.tolist()):
        back[: steps_out + 1, i] = 0.0
    return np.asarray(back.reshape(periods, steps, p).max(axis=0))


def weighed(trajectory: HiddenTrajectory, taken: Array) -> Array:
    """Standard deviation over tolerance that a tangent leaves where measurements have taken so much of it."""
    return np.sqrt(np.maximum(trajectory.reach**2 - taken, 0.0))


class HiddenTrajectories:
    """Every trajectory found, and what they prove of any choice of samples, quickly."""

    def __init__(self, steps: int, ends: list[Mask]):
        self.steps, self.ends = steps, ends
        self.trajectories: list[HiddenTrajectory] = []

    def add(self, trajectory: HiddenTrajectory) -> None:
        """Keep one more."""
        if not any(known is trajectory for known in self.trajectories):
            self.trajectories.append(trajectory)

    def against(self, chosen: Mask) -> tuple[float, HiddenTrajectory | None, int]:
        """The largest ratio of accuracy to tolerance that the pool proves of a choice, the trajectory, and its end."""
        best, which, where = 0.0, None, 0
        at, sensor = np.nonzero(chosen)
        for trajectory in self.trajectories:
            ratios = self.proven(trajectory, at, sensor)
            end = int(np.argmax(ratios))
            if ratios[end] > best:
                best, which, where = float(ratios[end]), trajectory, end
        return best, which, where

    def proven(self, trajectory: HiddenTrajectory, at: Index, sensor: Index) -> Array:
        """For every end of a trajectory, the ratio that it proves of samples (at, sensor)."""
        allowed = self.ends[trajectory.goal].copy()
        if trajectory.at_sample:
            there = np.zeros(self.steps, dtype=bool)
            there[at] = True
            allowed &= there
        if trajectory.response is not None and at.size > MANY:
            outputs = self._largest_ratios(trajectory.peaks, at, sensor)
            return np.where(allowed, trajectory.reach / np.maximum(outputs / HIDDEN, 1.0), 0.0)
        peaks = trajectory.peaks[(np.arange(self.steps)[:, None] - at[None, :]) % self.steps, sensor[None, :]]
        if trajectory.response is None:
            return np.where(allowed, weighed(trajectory, peaks.sum(axis=1)), 0.0)
        outputs = np.max(peaks, axis=1, initial=0.0)
        return np.where(allowed, trajectory.reach / np.maximum(outputs / HIDDEN, 1.0), 0.0)

    def _largest_ratios(self, peaks: Array, at: Index, sensor: Index) -> Array:
        """For every end the largest ratio that is measured, from the largest down; 0 where none is beyond its bound."""
        chosen, outputs, left = np.zeros(peaks.shape, dtype=bool), np.zeros(self.steps), np.arange(self.steps)
        chosen[at, sensor] = True
        order = np.argsort(-peaks, axis=None, kind="stable")[: int(np.sum(peaks > HIDDEN))]
        for back, j in zip(*(part.tolist() for part in np.unravel_index(order, peaks.shape)), strict=True):
            there = chosen[left - back, j]
            outputs[left[there]], left = peaks[back, j], left[~there]
            if not left.size:
                break
        return outputs

    def swaps(self, rest: Mask, options: list[tuple[int, int]]) -> Array:
        """What the pool proves of `rest` with each option (step, sensor) added."""
        at, sensor = np.nonzero(rest)
        step, which = (np.array(part, dtype=int) for part in zip(*options, strict=True))
        values = np.zeros(len(options))
        sampled = rest.any(axis=1)
        for trajectory in self.trajectories:
            ratios = self.proven(trajectory, at, sensor)
            if trajectory.at_sample:  # an option brings an end of its own: said without it, this bounds no less
                ratios = np.where(sampled, ratios, 0.0)
            ends = np.flatnonzero(ratios > 0)
            ends = ends[np.argsort(-ratios[ends], kind="stable")][:MOST_ENDS]
            outputs = trajectory.peaks[(ends[:, None] - step[None, :]) % self.steps, which[None, :]]
            if trajectory.response is None:
                left = np.sqrt(np.maximum(ratios[ends, None] ** 2 - outputs, 0.0))
                values = np.maximum(values, left.max(axis=0, initial=0.0))
                continue
            with np.errstate(divide="ignore"):
                after = np.minimum(ratios[ends, None], trajectory.reach / np.maximum(outputs / HIDDEN, 1.0))
            values = np.maximum(values, after.max(axis=0, initial=0.0))
        return values
