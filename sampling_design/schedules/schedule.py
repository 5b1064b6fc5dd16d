"""Finite and periodic schedules: sample times, and which outputs each sample measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import ClassVar, Literal, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_list
from sampling_design.errors import ArgumentError, CallError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.dates import parse_date
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import ListRecord, Plain, counted, moment, short
from sampling_design.records.units import check_time_unit, time_factor

MOST_TIMES = 20_000_000  # samples of an endless schedule that are listed at once, 160 MB of times
_GAPS_SLIP = "Did you pass gaps? Use Schedule.from_gaps."


class ScheduleDetails(TypedDict, total=False):
    """What a schedule may carry besides its times, all of it optional."""

    time_unit: str | None
    origin: str | None
    output_names: Sequence[str] | None


@frozen
class _ListWithDetails(ListRecord[float]):
    """Details that every schedule may carry besides its times."""

    time_unit: str | None = field(default=None, kw_only=True)
    origin: str | None = field(default=None, kw_only=True)
    output_names: Converted[Sequence[str] | None, tuple[str, ...] | None] = field(default=None, kw_only=True)  # type: ignore[arg-type]

    endless: ClassVar[bool]
    """Whether it repeats without end."""

    def between(self, start: float, end: float, closed: str = "both") -> Schedule:
        """Return the samples in [start, end]; `closed` = "both", "left", "right" or "neither"."""
        raise NotImplementedError

    @property
    def min_gap(self) -> float:
        """Least gap between two samples; infinite if there is none."""
        return float(np.min(self.gaps, initial=np.inf))  # type: ignore[attr-defined]  # both kinds have gaps and times

    @property
    def d_max(self) -> float:
        """Largest gap, the one before the first sample included.

        Raises
        ------
        ArgumentError
            If there is no sample.
        """
        times, gaps = self.times, self.gaps  # type: ignore[attr-defined]
        if not len(times):
            raise ArgumentError("`schedule` must have at least one sample: without one it has no longest gap.")
        return float(max(times[0], np.max(gaps, initial=0.0)))

    def _moments(self) -> str:
        return moment(self.times)  # type: ignore[attr-defined]

    def window(self, t: float, T: float) -> Schedule:
        """Return the samples in the closed window [t - T, t], times as they are."""
        return self.between(t - T, t)

    def count(self, start: float, end: float, closed: str = "both") -> int:
        """Return the number of samples in [start, end]; `closed` as for `between`."""
        return len(self.between(start, end, closed))

    def _own(self, **values: Array | Mask | float | tuple[str, ...] | None) -> None:
        if self.time_unit is not None:
            check_time_unit(self.time_unit)
        if self.origin is not None:
            parse_date("origin", self.origin)
        mask = values.get("outputs")
        if self.output_names is not None:
            if not is_list(self.output_names):
                came = checks.described(self.output_names)
                raise ArgumentError(f"`output_names` must be a list of strings, got {came}.")
            length = len(self.output_names) if mask is None else np.shape(mask)[1]
            values["output_names"] = checks.names("output_names", self.output_names, length, "y")
        self._hold(**values)

    def _details(self) -> ScheduleDetails:
        return {"time_unit": self.time_unit, "origin": self.origin, "output_names": self.output_names}

    def _columns(self) -> Mapping[str, Array | Mask]:
        """The times, and of each output whether it is measured; all of them where nothing is said."""
        times, mask, names = self.times, self.outputs, tuple(self.output_names or ())  # type: ignore[attr-defined]
        read = np.full((times.size, len(names)), fill_value=True) if mask is None else mask
        names = names or tuple(f"y{i + 1}" for i in range(read.shape[1]))
        return {"time": times, **{name: read[:, i] for i, name in enumerate(names)}}

    def _plain(self, mask: Mask | None, **times: Plain) -> dict[str, Plain]:
        names = None if self.output_names is None else list(self.output_names)
        outputs = None if mask is None else mask.astype(int).tolist()
        details = {"time_unit": self.time_unit, "origin": self.origin, "output_names": names}
        data = {**times, "outputs": outputs, **details}
        return {key: value for key, value in data.items() if value is not None}


@frozen
class Schedule(_ListWithDetails):
    """A finite schedule: times t_1 < t_2 < ... < t_N, all >= 0; a list of these times.

    Parameters
    ----------
    times : (N,) array [the plant's time unit]
        Strictly increasing, non-negative.
    outputs : (N, p) array of bool, optional
        Which outputs each sample measures; None means all of them.
    time_unit : str, optional
        Unit of `times`; None means that of whichever plant it meets.
    origin : str, optional
        Calendar date (ISO 8601) of time 0.
    output_names : sequence of str, optional
    assumed_zone : str
        Zone in which `import_time_stamps` read dates without one; "" where there were none.

    Raises
    ------
    ArgumentError
        If times are unsorted, repeated or negative, the mask has another shape, or `origin` is no date.

    Examples
    --------
    >>> Schedule([0.0, 1.0, 2.5]).gaps
    array([1. , 1.5])
    """

    _slip: ClassVar[str] = "Did you pass times? Use Schedule(times)."
    _reader: ClassVar[str] = "read_schedule"
    times: Converted[npt.ArrayLike, Array]
    outputs: Converted[npt.ArrayLike | None, Mask | None] = None  # type: ignore[assignment]
    assumed_zone: str = field(default="", kw_only=True)

    endless: ClassVar[Literal[False]] = False
    _table = {"samples": "{__len__}", "times": "{_moments}", "time unit": "{time_unit:or -}"}

    def __post_init__(self) -> None:
        times = checks.increasing("times", self.times, _GAPS_SLIP)
        checks.of_kind("assumed_zone", self.assumed_zone, str, "a string")
        self._own(times=times, outputs=checks.output_mask("outputs", self.outputs, times.size))

    @classmethod
    def from_gaps(cls, gaps: npt.ArrayLike, **details: Unpack[ScheduleDetails]) -> Schedule:
        """Return the schedule whose first sample is at gaps[0] and whose later ones follow by gaps[1], gaps[2], ...

        Raises
        ------
        ArgumentError
            If gaps[0] is negative or a later gap is not positive.
        """
        owned = checks.vector("gaps", gaps)
        if owned.size and owned[0] < 0:
            raise ArgumentError(f"`gaps` must not be negative, got gaps[0] = {float(owned[0])!r}.")
        _positive_gaps(owned[1:], offset=1)
        return cls(np.cumsum(owned), **details)

    def _entries(self) -> Sequence[float]:
        return [float(t) for t in self.times]

    def _rows(self) -> list[tuple[str, str]]:
        origin = [("origin", self.origin)] if self.origin else []
        assumed = [("dates without a zone", f"read in {self.assumed_zone}")] if self.assumed_zone else []
        return [*super()._rows(), *origin, *assumed]

    def __len__(self) -> int:
        return self.times.size

    @property
    def gaps(self) -> Array:
        """Differences of successive times, shape (N-1,)."""
        return np.diff(self.times)

    def between(self, start: float, end: float, closed: str = "both") -> Schedule:
        """Return the samples in [start, end]; `closed` = "both", "left", "right" or "neither"."""
        keep = _inside(self.times, start, end, closed)
        mask = None if self.outputs is None else self.outputs[keep]
        return Schedule(self.times[keep], mask, **self._details())

    def in_unit(self, unit: str) -> Schedule:
        """Return the same schedule with times in `unit`; its own unit must be known."""
        c = time_factor(self.time_unit or "", unit)
        return Schedule(self.times * c, self.outputs, **(self._details() | ScheduleDetails(time_unit=unit)))

    def to_dict(self) -> dict[str, Plain]:
        """Plain data, exact; `schedule_from_dict` reads it back."""
        return self._plain(self.outputs, kind="finite", times=self.times.tolist())

    def explain(self) -> str:
        """Say what the schedule is, in words."""
        if not len(self):
            return "A schedule without samples."
        unit = f" {self.time_unit}" if self.time_unit else ""
        return f"{counted(len(self), 'sample')} from {moment(self.times[0])} to {moment(self.times[-1])}{unit}."


@frozen
class PeriodicSchedule(_ListWithDetails):
    """An endless schedule that repeats after sum(gaps).

    Sample 1 is at `first`; sample i+1 follows sample i by gaps[i] (0-based, so that gaps[i] lies before
    the sample in row i), and the next period's first sample follows by gaps[0]. `len` counts the samples of a period;
    having no end it is no list: `between` and `times` are.

    Parameters
    ----------
    gaps : (N,) array
        Positive; gaps[0] lies before the period's first sample.
    first : float, optional
        Time of the first sample, in [0, period]. Default gaps[0].
    outputs : (N, p) array of bool, optional
        Which outputs each sample of the period measures; None means all.
    time_unit, origin, output_names
        As for `Schedule`.

    Attributes
    ----------
    times : (N,) array
        Sample times of the first period: first, first + gaps[1], ...
    period : float
        Length of one period.

    Raises
    ------
    ArgumentError
        If there is no gap, a gap is zero or negative, or `first` lies outside [0, period].

    Examples
    --------
    >>> schedule = PeriodicSchedule.from_times([0.0, 1.0, 2.5], period=4.0)
    >>> schedule.gaps, schedule.period
    (array([1.5, 1. , 1.5]), 4.0)
    >>> schedule.between(3.0, 5.0).times
    array([4., 5.])
    """

    gaps: Converted[npt.ArrayLike, Array]
    first: Converted[float | None, float] = None  # type: ignore[assignment]
    outputs: Converted[npt.ArrayLike | None, Mask | None] = None  # type: ignore[assignment]
    times: Array = field(init=False)
    period: float = field(init=False)

    endless: ClassVar[Literal[True]] = True
    _table = {
        "samples per period": "{__len__}",
        "period": "{period}",
        "times": "{_moments}",
        "time unit": "{time_unit:or -}",
    }

    def __post_init__(self) -> None:
        gaps = checks.vector("gaps", self.gaps)
        if not gaps.size:
            raise ArgumentError("`gaps` must not be empty: a periodic schedule has at least one sample per period.")
        _positive_gaps(gaps, offset=0)
        first = float(gaps[0]) if self.first is None else checks.nonnegative("first", self.first)
        period = float(np.sum(gaps))
        if first > period + gaps.size * np.spacing(period):
            raise ArgumentError(f"`first` must lie in [0, period] = [0, {period!r}], got {first!r}.")
        first = min(first, period)  # gaps in another unit add up to a little less than the period in it
        times = freeze(first + np.concatenate([[0.0], np.cumsum(gaps[1:])]))
        if np.any(np.diff(times, append=times[0] + period) <= 0):
            raise ArgumentError(
                f"`gaps` must be told apart from zero beside the period {period!r} in double precision, "
                f"got a gap of {float(gaps.min())!r}."
            )
        mask = checks.output_mask("outputs", self.outputs, gaps.size)
        self._own(gaps=gaps, first=first, outputs=mask, times=times, period=period)

    @classmethod
    def from_times(
        cls,
        times: npt.ArrayLike,
        period: float,
        outputs: npt.ArrayLike | None = None,
        **details: Unpack[ScheduleDetails],
    ) -> PeriodicSchedule:
        """Return the schedule with samples at `times` + k `period`, k = 0, 1, ...

        `times` is one period: the first in [0, period], the last less than one period after it. Times and
        period are kept to the last bit; gaps are their differences.

        Raises
        ------
        ArgumentError
            If there are no times, they are unsorted, repeated or negative, or do not fit one period.
        """
        owned = checks.increasing("times", times, "Did you pass gaps? Use PeriodicSchedule(gaps).")
        length = checks.positive("period", period)
        if not owned.size:
            raise ArgumentError("`times` must not be empty: a periodic schedule has at least one sample per period.")
        if owned[-1] - owned[0] >= length:
            raise ArgumentError(
                f"`times` must span less than one period {length!r}, got {float(owned[0])!r} to {float(owned[-1])!r}. "
                "Does the last time already belong to the next period?"
            )
        if owned[0] > length:
            raise ArgumentError(f"`times` must begin in [0, period] = [0, {length!r}], got {float(owned[0])!r}.")
        gaps = np.concatenate([[owned[0] + length - owned[-1]], np.diff(owned)])
        mask = checks.output_mask("outputs", outputs, owned.size)
        schedule = cls(gaps, float(owned[0]), mask, **details)
        # times and period as given, not as sums of gaps, so that a file of times comes back to the last bit
        schedule._own(times=owned, period=length)
        return schedule

    def _entries(self) -> Sequence[float]:
        raise CallError(
            "`schedule` repeats without end and is no list: `schedule.between(start, end)` lists the samples of a "
            "time span, `schedule.times` those of one period."
        )

    def __len__(self) -> int:
        return self.gaps.size

    def between(self, start: float, end: float, closed: str = "both") -> Schedule:
        """Return the samples in [start, end] (never before `first`); `closed` as for `Schedule.between`."""
        cycle, period = self.times, self.period
        if not np.isfinite(end):
            raise ArgumentError(f"`end` must be finite, got {end!r}: a periodic schedule has no end.")
        low = max(0, int(np.floor((max(start, 0.0) - cycle[-1]) / period)) - 1)
        high = max(low, int(np.ceil((end - cycle[0]) / period)) + 1)
        if (high - low + 1) * len(self) > MOST_TIMES:
            size = (high - low + 1.0) * len(self)
            raise ArgumentError(
                f"`schedule` has {size:.3g} samples from {short(start)} to {short(end)}, which take "
                f"{8 * size / 2**30:.3g} GiB: at most {MOST_TIMES} are listed at once."
            )
        times = (cycle + period * np.arange(low, high + 1)[:, None]).ravel()
        keep = _inside(times, start, end, closed)
        mask = None if self.outputs is None else np.tile(self.outputs, (high - low + 1, 1))[keep]
        return Schedule(times[keep], mask, **self._details())

    def primitive(self) -> PeriodicSchedule:
        """Return the same samples with the shortest period that gaps and outputs have, to the last bit; else itself."""
        count, masks = len(self), self.outputs
        for part in (k for k in range(1, count) if count % k == 0):
            gaps, times = self.gaps[:part], self.times[:part]
            same = np.array_equal(np.tile(gaps, count // part), self.gaps)
            if masks is not None:
                same = same and np.array_equal(np.tile(masks[:part], (count // part, 1)), masks)
            if same and self.first <= gaps.sum():
                mask = None if masks is None else masks[:part]
                found = PeriodicSchedule(gaps, self.first, mask, **self._details())
                return found if np.array_equal(found.times, times) else self
        return self

    def in_unit(self, unit: str) -> PeriodicSchedule:
        """Return the same schedule with times in `unit`; its own unit must be known."""
        c = time_factor(self.time_unit or "", unit)
        details = self._details() | ScheduleDetails(time_unit=unit)
        return PeriodicSchedule.from_times(self.times * c, self.period * c, self.outputs, **details)

    def to_dict(self) -> dict[str, Plain]:
        """Plain data, exact; `schedule_from_dict` reads it back."""
        period = {"gaps": self.gaps.tolist(), "first": self.first, "times": self.times.tolist(), "period": self.period}
        return self._plain(self.outputs, kind="periodic", **period)

    def explain(self) -> str:
        """Say what the schedule is, in words."""
        unit = f" {self.time_unit}" if self.time_unit else ""
        least, most = short(self.gaps.min()), short(self.gaps.max())
        gaps = f"all gaps {most}" if least == most else f"gaps from {least} to {most}"
        return f"{counted(len(self), 'sample')} every {short(self.period)}{unit}, {gaps}{unit}, without end."


def _inside(times: Array, start: float, end: float, closed: str) -> Mask:
    checks.word("closed", closed, ("both", "left", "right", "neither"))
    low = times >= start if closed in ("both", "left") else times > start
    high = times <= end if closed in ("both", "right") else times < end
    return np.asarray(low & high)


def _positive_gaps(gaps: Array, offset: int) -> None:
    bad = np.flatnonzero(gaps <= 0)
    if bad.size:
        i = int(bad[0])
        raise ArgumentError(f"`gaps` must be positive, got gaps[{i + offset}] = {float(gaps[i])!r}.")
