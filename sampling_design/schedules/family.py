"""What a set of schedules can be asked; each family lives in a file of its own."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from sampling_design import _checks
from sampling_design.errors import ArgumentError
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

AnySchedule = Schedule | PeriodicSchedule


@runtime_checkable
class SamplingFamily(Protocol):
    """A set of schedules.

    Attributes
    ----------
    min_gap, d_max : float
        Bounds on the gaps of every member (d_max also bounds the time of the first sample).
    nominal : Schedule or PeriodicSchedule
        The member that stands for all.
    """

    @property
    def min_gap(self) -> float:
        """Every gap between samples is at least this."""
        ...

    @property
    def d_max(self) -> float:
        """Every gap, and the time of the first sample, is at most this."""
        ...

    @property
    def nominal(self) -> AnySchedule:
        """The member that stands for all."""
        ...

    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether `schedule` belongs to the family."""
        ...

    def draw(
        self, rng: np.random.Generator | None = None, *, duration: float | None = None, samples: int | None = None
    ) -> Schedule:
        """Return a random finite member that covers [0, duration] or has `samples` samples."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Plain data with a key "kind"."""
        ...

    def explain(self) -> str:
        """Say what the family is, in one sentence."""
        ...


def in_family_unit(schedule: Any, time_unit: str | None) -> AnySchedule:
    """Return `schedule` in the family's time unit where both are known, else as it is.

    Raises
    ------
    ArgumentError
        If it is no schedule.
    """
    if not isinstance(schedule, (Schedule, PeriodicSchedule)):
        raise ArgumentError(
            f"`schedule` must be a Schedule or PeriodicSchedule, got {type(schedule).__name__}. "
            "Did you pass times? Use Schedule(times)."
        )
    if time_unit is None or schedule.time_unit in (None, time_unit):
        return schedule
    return schedule.in_unit(time_unit)


def generator(rng: np.random.Generator | None) -> np.random.Generator:
    """Return `rng`, or the default generator with seed 0.

    Raises
    ------
    ArgumentError
        If it is something else, for instance a seed.
    """
    if rng is None:
        return np.random.default_rng(0)
    if not isinstance(rng, np.random.Generator):
        raise ArgumentError(
            f"`rng` must be a numpy.random.Generator, got {type(rng).__name__}. "
            "Did you pass a seed? Use numpy.random.default_rng(seed)."
        )
    return rng


def extent(duration: float | None, samples: int | None, default: float) -> tuple[float, int]:
    """Return (duration, samples) to draw: whichever is given, the other without effect.

    Raises
    ------
    ArgumentError
        If both are given, or one is not positive.
    """
    if duration is not None and samples is not None:
        raise ArgumentError("give `duration` or `samples`, not both.")
    if samples is not None:
        return np.inf, _checks.whole("samples", samples, 1)
    return (default if duration is None else _checks.positive("duration", duration)), np.iinfo(np.int64).max


def pick(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number in [low, high]: one of the two ends in half of all cases, since claims are tight there."""
    chance = rng.random()
    if chance < 0.25:
        return low
    if chance < 0.5:
        return high
    return float(rng.uniform(low, high))
