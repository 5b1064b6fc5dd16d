"""What a set of schedules can be asked; each family is a file of its own and says all of this itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, Self, TypeAlias

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import PlainRecord
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

AnySchedule = Schedule | PeriodicSchedule
Word = tuple[float | int | str, ...]
"""What is remembered of a schedule since a window's start."""
START: Word = ("start",)  # nothing yet: the window has just begun, at any real time

OUTWARD = 8 * float(np.finfo(float).eps)
"""Ends of a step that are sums of times are moved outward by this fraction, so that rounding loses no schedule."""
GAP_MEMORY = ((0, 1), (1, 2), (1, 4), (2, 4), (3, 4))
"""(gaps remembered, cells per gap) of each level of memory, for families that speak of gaps."""
MOST_DRAWN = 1_000_000  # samples of a random schedule: its gaps are drawn one by one
LONGEST_WORD = 4  # gaps of a suspect; longer unobservable words exist only for plants with many aliasing modes
RANDOM_WORDS = 6  # suspects of each length and period that are drawn at random, besides the one of equal gaps
EQUAL_RTOL = 1e-9  # sums of gaps this near, relatively, are equal


@dataclass(frozen=True)
class FamilyStep:
    """What may come next: after a time within [low, high] a sample with these outputs (none of them: it is lost)."""

    word: Word
    low: float
    high: float
    outputs: tuple[bool, ...]


Steps = Callable[[Word], list[FamilyStep]]


FamilyVariation: TypeAlias = tuple[Array, float, Callable[[Array], PeriodicSchedule]]
"""(origin, spread, build): members near one, `build(x)` for x near `origin`, as far as `spread`."""


@dataclass(frozen=True)
class Leeway:
    """How far a sample may lie from a plan, and how many may be missing: what can be judged one sample at a time.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        The plan.
    radius : float
        Every sample is at most this much early or late [time].
    most, of : int
        At most `most` of any `of` consecutive samples are missing.
    """

    schedule: AnySchedule
    radius: float = 0.0
    most: int = 0
    of: int = 1


class SamplingFamily(PlainRecord, ABC):
    """A set of schedules.

    A subclass is a frozen dataclass that names its kind, `class MyFamily(SamplingFamily, kind="my-family")`; its fields
    are what a file holds. It needs `min_gap`, `d_max`, `nominal`, `contains`, `draw`, `to_dict`, `explain` and
    `steps`; whatever is about gaps alone has a default for the rest.

    Attributes
    ----------
    min_gap, d_max : float
        Bounds on the gaps of every member (d_max also bounds the time of the first sample).
    nominal : Schedule or PeriodicSchedule
        The member that stands for all.
    time_unit : str or None
    """

    _table = {"members": "{explain}"}
    KINDS: ClassVar[dict[str, type[SamplingFamily]]] = {}
    kind: ClassVar[str]
    remembers: ClassVar[bool] = True
    """Whether more than the last gap decides what may come next."""
    judges_pieces: ClassVar[bool] = True
    """Whether `contains` says of any finite piece whether a member may begin so; else least and longest gaps do."""

    def __init_subclass__(cls, kind: str | None, **others: object) -> None:
        super().__init_subclass__(**others)
        if kind is None:  # a base of several kinds
            return
        if kind in SamplingFamily.KINDS:
            raise ArgumentError(f"`kind` {kind!r} is taken by {SamplingFamily.KINDS[kind].__name__}.")
        cls.kind = kind
        SamplingFamily.KINDS[kind] = cls

    @property
    @abstractmethod
    def time_unit(self) -> str | None:
        """Unit of all times; None means that of whatever plant it meets."""

    @property
    @abstractmethod
    def min_gap(self) -> float:
        """Every gap between samples is at least this."""

    @property
    @abstractmethod
    def d_max(self) -> float:
        """Every gap, and the time of the first sample, is at most this."""

    def longest_next(self, times: Array) -> float:
        """Longest gap that may follow samples at some times (N,) of a member, counted from its start or a sample."""
        del times
        return self.d_max

    @property
    @abstractmethod
    def nominal(self) -> AnySchedule:
        """The member that stands for all."""

    @abstractmethod
    def contains(self, schedule: AnySchedule) -> bool:
        """Say whether `schedule` belongs to the family."""

    @abstractmethod
    def draw(self, rng: checks.Seed = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        """Return a random finite member that covers [0, duration] or has `samples` samples."""

    @property
    def by_output(self) -> tuple[SamplingFamily | None, ...]:
        """The family of each output, None if it is never read, where each is read at times of its own; else none."""
        return ()

    # The graph whose paths are the members (certificates/families/).

    @property
    def levels_of_memory(self) -> int:
        """How many graphs of growing memory there are."""
        return len(GAP_MEMORY)

    @abstractmethod
    def steps(self, memory: int, outputs: int) -> Steps:
        """Return what may come next after each word, with level `memory` of memory, for a plant with `outputs` outputs.

        From `START` the time counts from the window's start, which may be any real time. Together the steps that leave
        a word must allow whatever a member may do there; what a word remembers must be true of every member that
        reaches it.
        """

    @property
    def planned(self) -> AnySchedule | None:
        """The schedule that the family is built around, None if it is built from numbers."""
        return None

    def replanned(self, schedule: PeriodicSchedule) -> Self:
        """Return the same family around another `planned` schedule."""
        return self

    # What a sample taken is held against (estimators/online/).

    @property
    def leeway(self) -> Leeway | None:
        """The plan and how far its samples may leave it, if that says all; None: `contains` is asked."""
        return None

    # The search for a member without a certificate (certificates/existence/).

    def suspects(
        self, periods: Sequence[float], rng: np.random.Generator, quick: bool = False
    ) -> Iterator[PeriodicSchedule]:
        """Yield periodic members worth a look; over `periods` two modes of the plant alias."""
        periods = checks.vector("periods", periods).tolist()
        low, high, unit = self.min_gap, self.d_max, self.nominal.time_unit
        for gap in (low, high):
            if self.contains(ends := PeriodicSchedule(np.array([gap]), time_unit=unit)):
                yield ends
        for period in periods:
            for count in range(1, LONGEST_WORD + 1):
                if not count * low <= period * (1 + EQUAL_RTOL) or not period <= count * high * (1 + EQUAL_RTOL):
                    continue
                drawn = rng.dirichlet(np.ones(count), RANDOM_WORDS if count > 1 else 0)
                for shares in [np.full(count, 1 / count), *drawn]:
                    gaps = low + shares * max(period - count * low, 0.0)
                    word = PeriodicSchedule(gaps if count > 1 else np.array([period]), time_unit=unit)
                    if self.contains(word):
                        yield word

    def variation(self, start: PeriodicSchedule) -> FamilyVariation | None:
        """Return the members near `start` among which a worse one may be sought: gaps of the same sum."""
        spread = (self.d_max - self.min_gap) / 4
        if len(start) < 2 or spread <= 0:
            return None

        def build(gaps: Array) -> PeriodicSchedule:
            last = start.period - float(np.sum(gaps))
            if last <= 0 or np.any(gaps <= 0):
                return start
            return PeriodicSchedule(np.append(gaps, last), time_unit=start.time_unit)

        return np.array(start.gaps)[:-1], spread, build

    def narrowed(self, fraction: float) -> Self | None:
        """Return the part of the family around its nominal schedule, None where that has no obvious meaning."""
        return None


@dataclass(frozen=True, eq=False, repr=False)
class NominalFamily(SamplingFamily, kind=None):
    """Base of the families that are built around a nominal schedule, their first field."""

    schedule: AnySchedule

    @property
    def time_unit(self) -> str | None:
        """Unit of the nominal schedule."""
        return self.schedule.time_unit

    @property
    def nominal(self) -> AnySchedule:
        """The nominal schedule: without deviations or losses."""
        return self.schedule

    @property
    def planned(self) -> AnySchedule:
        """The nominal schedule."""
        return self.schedule

    def replanned(self, schedule: PeriodicSchedule) -> Self:
        """Return the same deviations and losses around another nominal schedule."""
        return replace(self, schedule=schedule)


def gap_steps(shortest: float, longest: float, room: Callable[[Word], float], memory: int, outputs: int) -> Steps:
    """Steps of gaps in [shortest, min(longest, room(word))], words the lower ends of the last gaps, newest first.

    The first gap, cut by the window's start, may be short. What of a cell is only rounding belongs to the one before.
    """
    kept, cells = GAP_MEMORY[memory]
    borders = np.linspace(shortest, longest, cells + 1).tolist()
    every = (True,) * outputs

    def steps(word: Word) -> list[FamilyStep]:
        old = () if word == START else word
        found, most = [], min(longest, room(old))
        for k, (low, high) in enumerate(pairwise(borders)):
            low, last = 0.0 if word == START and k == 0 else low, most <= high * (1 + EQUAL_RTOL)
            if low <= most:
                found.append(FamilyStep((low, *old)[:kept], low, most if last else high, every))
            if last:
                break
        return found

    return steps


def masks_of(schedule: PeriodicSchedule, outputs: int) -> list[tuple[bool, ...]]:
    """Which outputs each sample of the period measures."""
    if schedule.outputs is None:
        return [(True,) * outputs] * len(schedule)
    return [tuple(bool(on) for on in row) for row in schedule.outputs]


def reach_of(schedule: PeriodicSchedule) -> list[float]:
    """Longest time before each sample of the period at which a window may start with that sample next."""
    reach = [float(gap) for gap in schedule.gaps]
    reach[0] = max(reach[0], float(schedule.times[0]))
    return reach


FINITE_FAMILY = "`schedule` of the family must be a PeriodicSchedule: a finite one has no long run."


def period_of(schedule: AnySchedule, refusal: str = FINITE_FAMILY) -> PeriodicSchedule:
    """Return the schedule if it is endless.

    Raises ArgumentError if it is finite, with the sentence that says why that is refused.
    """
    if not schedule.endless:
        raise ArgumentError(refusal)
    return schedule


def in_family_unit(schedule: AnySchedule, time_unit: str | None) -> AnySchedule:
    """Return `schedule` in the family's time unit where both are known, else as it is."""
    if time_unit is None or schedule.time_unit in (None, time_unit):
        return schedule
    return schedule.in_unit(time_unit)


def extent(duration: float | None, samples: int | None, default: float, gap: float) -> tuple[float, int]:
    """Return (duration, samples) to draw: whichever is given, the other without effect.

    `gap` is the longest that gaps may be on average: it says how many samples a duration takes at least. Raises
    ArgumentError if both are given, one is not positive, or so many samples are not drawn one by one.
    """
    if duration is not None and samples is not None:
        raise ArgumentError("give `duration` or `samples`, not both.")
    if samples is not None:
        stop, count = np.inf, float(checks.whole("samples", samples, 1))
    else:
        stop = default if duration is None else checks.positive("duration", duration)
        count = stop / gap
    if count > MOST_DRAWN:
        name = "duration" if samples is None else "samples"
        raise ArgumentError(f"`{name}` asks for {count:.3g} samples or more: at most {MOST_DRAWN} are drawn.")
    return stop, np.iinfo(np.int64).max if samples is None else int(count)


def pick(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number in [low, high]: one of the two ends in half of all cases, since claims are tight there."""
    chance = rng.random()
    if chance < 0.25:
        return low
    if chance < 0.5:
        return high
    return float(rng.uniform(low, high))
