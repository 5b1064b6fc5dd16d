"""Schedules with enough samples in every window and a least spacing between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import short
from sampling_design.records.units import check_time_unit
from sampling_design.schedules import family
from sampling_design.schedules.family import AnySchedule, SamplingFamily, Steps, Word
from sampling_design.schedules.sampling_set import ROUNDING
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule


@dataclass(frozen=True, eq=False, repr=False)
class SpacedWindows(SamplingFamily, kind="spaced-windows"):
    """All schedules with at least `count` samples in every closed window of length `window`, `spacing` apart.

        |K_1 with [s, s + T]| >= k for all real s >= 0,    tau_{i+1} - tau_i >= epsilon

    Parameters
    ----------
    window : float
        T > 0 [time].
    count : int
        k >= 1.
    spacing : float
        epsilon > 0 [time].
    time_unit : str, optional
        Unit of `window` and `spacing`; None means that of whatever it meets.

    Raises
    ------
    ArgumentError
        If an argument is not positive.
    InfeasibleRequirementError
        If (k - 1) epsilon > T: not even one window can hold the samples.

    Notes
    -----
    *Claim.* Since windows stand at every real time, also just after a sample has left, a schedule
    belongs to the family exactly if no gap is below epsilon, every k consecutive gaps sum to at most T,
    and sample number k comes at T or before. So an endless member exists only if k epsilon <= T
    (`has_endless`); if T lies between (k - 1) epsilon and k epsilon a single window can be filled
    (the compact set of Theorem 17), but the next one cannot.

    References
    ----------
    The paper, Theorem 17.

    Examples
    --------
    >>> family = SpacedWindows(window=4.0, count=2, spacing=0.5)
    >>> family.contains(PeriodicSchedule([2.0])), family.contains(PeriodicSchedule([2.1]))
    (True, False)
    >>> family.contains(family.draw(np.random.default_rng(1)))
    True
    """

    window: float
    count: int
    spacing: float
    time_unit: str | None = field(default=None, kw_only=True)

    judges_pieces = False  # a piece shorter than a window does not belong, and a member may begin with it

    _plain = "kind window count spacing time_unit?"

    def __post_init__(self) -> None:
        self._check(window=checks.positive, count=checks.at_least_one, spacing=checks.positive)
        count, spacing = self.count, self.spacing
        if self.time_unit is not None:
            check_time_unit(self.time_unit)
        if (count - 1) * spacing > self.window * (1 + ROUNDING):
            raise self._infeasible(
                f"{count} samples {short(spacing)} apart need {short((count - 1) * spacing)}, "
                f"and {short(count * spacing)} in an endless schedule"
            )

    def _infeasible(self, what: str) -> InfeasibleRequirementError:
        # the room of an endless schedule, k epsilon <= T, is offered: it also fits one window
        fits = int(np.floor(self.window / self.spacing * (1 + ROUNDING)))
        nearest = {"spacing": self.window / self.count, "count": fits, "window": self.count * self.spacing}
        offer = f"spacing at most {short(nearest['spacing'])}, or a window of at least {short(nearest['window'])}"
        if fits:
            offer += f", or count at most {fits}"
        return InfeasibleRequirementError(
            f"{what}, more than `window` = {short(self.window)}. What fits: {offer}.", "spacing", nearest
        )

    @property
    def has_endless(self) -> bool:
        """Whether an endless schedule belongs to the family: k epsilon <= T."""
        return self.count * self.spacing <= self.window * (1 + ROUNDING)

    @property
    def min_gap(self) -> float:
        """The spacing."""
        return self.spacing

    @property
    def d_max(self) -> float:
        """Longest gap that leaves room for the other k - 1 gaps of its window."""
        return max(self.window - (self.count - 1) * self.spacing, self.spacing)

    @property
    def nominal(self) -> PeriodicSchedule:
        """Equal gaps T/k, the fewest samples that a member can have.

        Raises
        ------
        InfeasibleRequirementError
            If no endless schedule belongs to the family.
        """
        self._need_endless()
        return PeriodicSchedule(np.array([self.window / self.count]), time_unit=self.time_unit)

    def _need_endless(self) -> None:
        if not self.has_endless:
            raise self._infeasible(
                f"an endless schedule needs {self.count} gaps of {short(self.spacing)} in every window that opens "
                f"just after a sample, {short(self.count * self.spacing)} in all"
            )

    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether `schedule` belongs to the family, windows at all real positions judged.

        A finite schedule is judged by the windows within [0, its last sample]; one that is shorter than
        a window does not belong. Comparisons hold up to the rounding of times (`ROUNDING`).
        """
        schedule = family.in_family_unit(schedule, self.time_unit)
        if not len(schedule):
            return False
        T, k = self.window, self.count
        if schedule.endless:
            cycle = float(schedule.times[-1])
            times = schedule.between(0.0, cycle + k * schedule.period).times
            last = len(schedule) - 1
        else:
            times = schedule.times
            if times[-1] < T * (1 - ROUNDING):
                return False
            # a window that opens just after sample i is judged if it ends before the last sample
            last = int(np.searchsorted(times, times[-1] - T - ROUNDING * times[-1], side="left")) - 1
        slack = ROUNDING * times
        if times.size < k or times[k - 1] > T + slack[k - 1]:
            return False
        if np.any(np.diff(times) < self.spacing - slack[1:]):
            return False
        i = np.arange(last + 1)
        if i.size and i[-1] + k >= times.size:
            return False
        return bool(np.all(times[i + k] - times[i] <= T + slack[i + k]))

    def draw(self, rng: checks.Seed = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        """Return a random member: it covers [0, duration] (default ten windows), or has `samples` samples.

        Half of the gaps lie on a border of what is allowed, where the family's claims are tight.

        Raises
        ------
        ArgumentError
            If `duration` is shorter than a window, or both are given.
        InfeasibleRequirementError
            If no endless schedule belongs to the family.
        """
        rng = checks.generator(rng)
        self._need_endless()
        stop, most = family.extent(duration, samples, 10 * self.window, self.window / self.count)
        if stop < self.window:
            raise ArgumentError(
                f"`duration` must be at least the window {short(self.window)}, got {short(stop)}: "
                "a schedule shorter than a window cannot be judged."
            )
        gaps: list[float] = []
        time = 0.0
        while len(gaps) < most and (not gaps or time < stop):
            high = self._room(tuple(gaps[: -self.count : -1]))
            low = self.spacing if gaps else 0.0
            gaps.append(family.pick(rng, low, max(low, high)))
            time += gaps[-1]
        return Schedule.from_gaps(gaps, time_unit=self.time_unit)

    def longest_next(self, times: Array) -> float:
        """What the windows leave that begin with the last samples, if the others come as soon as they may."""
        return self._room(tuple(np.diff(times, prepend=0.0)[::-1]))

    @property
    def levels_of_memory(self) -> int:
        """Gaps further back than count - 1 say nothing."""
        return sum(1 for kept, _ in family.GAP_MEMORY if kept <= max(self.count - 1, 1))

    def steps(self, memory: int, outputs: int) -> Steps:
        """Any k consecutive gaps sum to at most T.

        Raises
        ------
        InfeasibleRequirementError
            If no endless schedule belongs to the family.
        """
        self._need_endless()
        wider = family.OUTWARD * self.window
        return family.gap_steps(
            self.spacing, self.d_max + wider, lambda word: self._room(word) + wider, memory, outputs
        )

    def _room(self, word: Word) -> float:
        """Longest gap after gaps of at least these lengths (newest first).

        Of the k gaps that hold the new one, i are old and k - 1 - i, each at least epsilon, are to come.
        """
        k, old = self.count, [float(gap) for gap in word]
        return min(self.window - sum(old[:i]) - (k - 1 - i) * self.spacing for i in range(min(len(old), k - 1) + 1))

    def _rows(self) -> list[tuple[str, str]]:
        unit = f" {self.time_unit}" if self.time_unit else ""
        return [
            ("window", short(self.window) + unit),
            ("count", str(self.count)),
            ("spacing", short(self.spacing) + unit),
            ("longest gap", short(self.d_max) + unit),
        ]

    def explain(self) -> str:
        """Say which schedules belong."""
        unit = f" {self.time_unit}" if self.time_unit else ""
        return (
            f"Every schedule with at least {self.count} samples in every closed window of length "
            f"{short(self.window)}{unit} and at least {short(self.spacing)}{unit} between samples."
        )
