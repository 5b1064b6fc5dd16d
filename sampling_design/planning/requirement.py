"""What a plan must keep: accuracy per row, bounds, sensors with prices and hours, and the calendar of the place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, TypeAlias

import numpy.typing as npt

from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, frozen, plain
from sampling_design.records.record import PlainRecord, WrittenRecord, counted, short
from sampling_design.records.units import check_time_unit
from sampling_design.records.vector_bounds import Entry, VectorBound, of_any_names
from sampling_design.schedules.jitter import Timing, TimingTolerance
from sampling_design.schedules.opening import OpeningCalendar
from sampling_design.schedules.sensor import Duration, Sensor, duration

DisturbanceBound: TypeAlias = float | Sequence[float] | Mapping[str, Entry] | None

FORMAT = "sampling-design/plan-requirement/1"
KINDS = ("guaranteed", "standard deviation")
TIMES = ("all times", "until the next", "after each sample")
AIMS = ("cheapest", "most accurate")


@frozen
class AccuracyGoal(PlainRecord):
    """How well one row must be known.

    Parameters
    ----------
    tolerance : float
        In the row's unit, > 0.
    at : str or sequence of float
        "all times" (the same: "until the next" sample), "after each sample", or times of the period from its start on:
        a sample at such a time, or a result that comes then, does not count there yet.
    row : (n,) array, optional
        Combination of states; default: the state or output of the goal's name.
    kind : str
        "guaranteed": no error that the bounds allow is larger; "standard deviation": that of the best filter, for white
        noise of the requirement's `w_intensity` and the sensors' `noise_deviation`.

    Raises
    ------
    ArgumentError
        If the tolerance is not positive, or a word is unknown.
    """

    tolerance: float
    at: str | Sequence[float] = "all times"
    row: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    kind: str = KINDS[0]

    _table = {"tolerance": "{tolerance}", "at": "{when}"}
    _plain = "tolerance at kind row?"

    def __post_init__(self) -> None:
        checks.word("kind", self.kind, KINDS)
        self._check(tolerance=checks.positive, row=checks.vector)
        if is_text(self.at):
            checks.word("at", self.at, TIMES)
        else:
            self._hold(at=tuple(checks.increasing("at", self.at).tolist()))
            if not self.at:
                raise ArgumentError('`at` must name at least one time, or be "all times".')

    def when(self) -> str:
        """Say at which times it holds."""
        times = self.at if is_text(self.at) else "at " + short(list(self.at))
        return times if self.kind == KINDS[0] else f"{self.kind}, {times}"

    def explain(self) -> str:
        """Say the goal in words."""
        return f"Within {short(self.tolerance)}, {self.when()}."


@frozen
class PlanRequirement(WrittenRecord):
    """What a plan must keep and may use.

    Parameters
    ----------
    accuracy : dict of str to AccuracyGoal, dict or float
        By name of a state or output (or any name, with a `row`); a number is a tolerance.
    period : float or str, optional
        The plan repeats after it. Default: one week with a calendar.
    grid : float or str, optional
        Samples lie on whole multiples of it. Default: 15 min with a calendar, else the period over 96.
    spacing : float or str, optional
        Least time between two samples.
    samples : int, optional
        Most samples in a period.
    cost_limit : float, optional
        Most that one period may cost.
    visit_price : float
        Of one sample, whatever it measures.
    aim : str, optional
        "cheapest": least cost (fewest samples where nothing costs) that keeps every tolerance; "most accurate": the
        least ratio of accuracy to tolerance that `samples` or `cost_limit` allow. Default: the latter if one of
        these is given.
    w_bound : float, (q,) sequence or dict by name, optional
        Bound on the disturbance, as for `guaranteed_accuracy`.
    w_intensity : float, (q,) sequence or dict by name, optional
        Intensity of the disturbance as white noise, as for `standard_deviation` [its unit squared times the plant's
        time unit].
    sensors : dict of str to Sensor or dict
        By name of the output; an output without terms is free, and measured without error bound if none is given.
    calendar : OpeningCalendar or dict, optional
    time_unit : str, optional
        Unit of all times that are plain numbers; None means the plant's.
    initial_error : number, array or dict, optional
        Bound on the state's error when the plan starts, as for `guaranteed_accuracy`: one on its norm, half-widths,
        a weight, or by name of the state. Default: nothing is known then.
    timing_tolerance : float or str, pair (early, late), or dict of these by output, optional
        How early or late each sample may be: tolerances that are guaranteed are then kept at all such times, and
        samples lie farther apart than the earliest and the latest reading of one may. Outputs with tolerances of their
        own may fall apart by as much. Default: samples come on time.

    Raises
    ------
    ArgumentError
        If a value is out of range or a key unknown.

    Examples
    --------
    >>> terms = {"position": {"noise_bound": 0.1}}
    >>> wanted = PlanRequirement({"position": 0.5}, period=8.0, w_bound=0.02, sensors=terms)
    >>> print(wanted.explain())
    Cheapest samples that keep position within 0.5 (all times).
    """

    _reader: ClassVar[str] = "read_plan_requirement"
    _written = "the requirement"
    _format = FORMAT
    _plain = (
        "format:_format period? grid? spacing? timing_tolerance? samples? cost_limit? aim time_unit? visit_price "
        "w_bound? w_intensity? initial_error? accuracy sensors calendar?"
    )
    accuracy: Converted[
        Mapping[str, AccuracyGoal | Mapping[str, object] | float] | None, Mapping[str, AccuracyGoal]
    ] = None  # type: ignore[assignment]
    period: Duration | None = None
    grid: Duration | None = None
    spacing: Duration | None = None
    samples: int | None = None
    cost_limit: float | None = None
    visit_price: float = 0.0
    aim: str | None = None
    w_bound: DisturbanceBound = None
    sensors: Converted[Mapping[str, Sensor | Mapping[str, object]] | None, Mapping[str, Sensor]] = None  # type: ignore[assignment]
    calendar: Converted[OpeningCalendar | Mapping[str, object] | None, OpeningCalendar | None] = None  # type: ignore[assignment]
    time_unit: str | None = None
    w_intensity: DisturbanceBound = None
    initial_error: VectorBound = None
    timing_tolerance: Timing | None = None

    def __post_init__(self) -> None:
        own: dict[str, object] = {}
        goals = checks.mapping("accuracy", self.accuracy, "a table of goals by row")
        terms = checks.mapping("sensors", self.sensors, "a table of terms by output")
        own["accuracy"] = {str(k): _goal(str(k), v) for k, v in goals.items()}
        own["sensors"] = {str(k): checks.record(f"sensors.{k}", v, Sensor) for k, v in terms.items()}
        self._check(
            calendar=lambda name, place: checks.record(name, place, OpeningCalendar),
            samples=checks.at_least_one,
            cost_limit=checks.positive,
            visit_price=checks.nonnegative,
            **dict.fromkeys(("w_bound", "w_intensity", "initial_error"), of_any_names),
        )
        if self.time_unit is not None:
            check_time_unit(self.time_unit)
        for key in ("period", "grid", "spacing"):
            if getattr(self, key) is not None:
                duration(key, getattr(self, key), self.time_unit or "h")
        if self.timing_tolerance is not None:
            self.early_or_late(self.time_unit or "h")
        if self.aim is not None:
            checks.word("aim", self.aim, AIMS)
        own["aim"] = self.aim or (AIMS[0] if self.samples is None and self.cost_limit is None else AIMS[1])
        if own["aim"] == AIMS[1] and self.samples is None and self.cost_limit is None:
            raise ArgumentError(
                "`aim` is most accurate, which needs `samples` or `cost_limit`: else all times are best."
            )
        self._hold(**own)

    def early_or_late(self, unit: str, outputs: Sequence[str] | None = None) -> TimingTolerance:
        """How early or late samples may be, in a unit; `outputs`: the names of the plant's, where they are known yet.

        Raises
        ------
        ArgumentError
            If a time is neither a number nor text with a unit, or negative, or an output is unknown.
        """
        return TimingTolerance.of(self.timing_tolerance, outputs, unit)

    def replace(self, **changes: object) -> PlanRequirement:
        """Return a copy with some entries changed.

        Raises
        ------
        ArgumentError
            If an entry is unknown, or as for `PlanRequirement`.
        """
        limited = {"samples", "cost_limit"} & changes.keys() and "aim" not in changes
        return super().replace(**({"aim": None} if limited else {}), **changes)

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(f"accuracy of {k}", f"{short(g.tolerance)} ({g.when()})") for k, g in self.accuracy.items()]
        for key in ("period", "grid", "spacing", "timing_tolerance", "samples", "cost_limit"):
            value = getattr(self, key)
            rows += [] if value is None else [(key.replace("_", " "), f"{value}")]
        rows += [] if self.initial_error is None else [("initial error", f"{plain(self.initial_error)}")]
        rows += [(f"sensor {name}", terms.explain()) for name, terms in self.sensors.items()]
        return [*rows, ("aim", f"{self.aim}")]

    def explain(self) -> str:
        """Say the requirement in words."""
        goals = ", ".join(f"{k} within {short(g.tolerance)} ({g.when()})" for k, g in self.accuracy.items())
        if not goals:
            return "Nothing that must be known."
        if self.aim == AIMS[0]:
            return f"Cheapest samples that keep {goals}."
        limits = [counted(self.samples, "sample")] if self.samples is not None else []
        limits += [f"cost {short(self.cost_limit)}"] if self.cost_limit is not None else []
        return f"Best accuracy for at most {' and '.join(limits)} a period, relative to {goals}."


def _goal(name: str, value: object) -> AccuracyGoal:
    """A goal, the table of one, or a tolerance alone."""
    if isinstance(value, (AccuracyGoal, Mapping)):
        return checks.record(f"accuracy.{name}", value, AccuracyGoal)
    return AccuracyGoal(checks.positive(f"accuracy.{name}", value))
