"""A requirement in numbers: steps of the grid, what may be measured at each, prices, and goals as rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sampling_design.accuracy.bounds import InitialSet
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.observability.alignment import align
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.planning.requirement import KINDS, PlanRequirement
from sampling_design.plants.functional import requested_rows
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask, freeze
from sampling_design.records.dates import zoned_text
from sampling_design.records.record import short
from sampling_design.records.units import SECONDS, spoken, time_factor
from sampling_design.records.vector_bounds import vector_bound
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.opening import DAYS, week_hours
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.schedules.sensor import Sensor, duration, result_span

WHOLE = 1e-6  # a time counts as a whole number of grid steps within this share of a step
DEFAULT_STEPS = 96  # steps of a period without a grid
MOST_STEPS = 20_000  # steps of a grid: programs have a column for each step and sensor
SAME_PRICE = 1e-9  # two costs count as equal within this share


@dataclass(frozen=True, eq=False)
class RowGoal:
    """One row with its tolerance, and at which ends of the grid it must hold."""

    name: str
    row: Array
    unit: str
    tolerance: float
    at: str  # "all times", "after each sample" or "given times"
    steps: Array  # grid times of "given times"
    stochastic: bool = False
    """Whether it is a standard deviation, else guaranteed."""

    def when(self) -> str:
        """At which times, and of which kind, in words."""
        return f"standard deviation, {self.at}" if self.stochastic else self.at


@dataclass(frozen=True, eq=False)
class PlanProblem:
    """Numbers of one plan, all times in steps of the grid."""

    plant: Plant
    requirement: PlanRequirement
    goals: tuple[RowGoal, ...]
    step: float  # length of a step [the plant's time unit]
    allowed: Mask  # (M, p): what may be measured at each step of the period
    price: Array  # (p,)
    visit: float  # price of a sample, whatever it measures
    spacing: int  # least steps between two samples
    sensor_spacing: Index  # sensor_spacing, longest_use, (p,)
    longest_use: Index
    # v_bound, v_deviation, (p,): infinite for a sensor that has none: it says nothing of goals of that kind
    v_bound: Array
    v_deviation: Array
    w_intensity: Array  # (q,): 0 where no goal is a standard deviation
    most_samples: float
    most_cost: float
    initial: InitialSet  # what is known of the state's error when the plan starts
    # how early or late each output may be [the plant's time unit]; samples are farther apart than its span
    timing_tolerance: TimingTolerance = ON_TIME
    # (p, 2): how long after its sample a result comes at least and at most [the plant's time unit]; None: at once
    result_delays: Array | None = None

    @property
    def result_delay(self) -> Array | None:
        """How long a result of each sensor is out at most (p,); None where all come at once."""
        return None if self.result_delays is None else self.result_delays[:, 1]

    @property
    def unread_steps(self) -> Index | None:
        """Steps back up to which a reading is out at the moment before some step (p,); None where none is ever out."""
        delay = self.result_delay
        return None if delay is None else np.floor(delay / self.step + WHOLE).astype(np.intp)

    def asked_rows(self) -> list[str] | Array | None:
        """What the goals ask for where a mode that does not decay is hidden from all outputs; None: the whole state.

        Rows that are independent of those before them, by name where the plant has these names.
        """
        if not len(unobservable_modes(self.plant, 0.0)):
            return None
        kept = list[RowGoal]()
        for goal in self.goals:
            rows = np.array([other.row for other in (*kept, goal)])
            if np.linalg.matrix_rank(rows / np.linalg.norm(rows, axis=1)[:, None]) == len(rows):
                kept.append(goal)
        names = [goal.name for goal in kept]
        known = {*self.plant.states.names, *self.plant.outputs.names}
        return names if known.issuperset(names) else np.array([goal.row for goal in kept])

    @property
    def steps(self) -> int:
        """Steps in a period."""
        return len(self.allowed)

    @property
    def period(self) -> float:
        """In the plant's time unit."""
        return self.steps * self.step

    @property
    def counts(self) -> bool:
        """Whether samples are counted, since nothing has a price."""
        return not (self.visit > 0 or np.any(self.price > 0))

    @property
    def unspaced(self) -> bool:
        """Whether all that is allowed may be measured in one period."""
        return self.is_admissible(self.allowed)

    @property
    def is_free(self) -> bool:
        """Whether a plan may be turned by any number of steps, so that one sample may be put at step 0."""
        return bool(self.allowed.all()) and all(goal.at != "given times" for goal in self.goals)

    @property
    def guaranteed(self) -> list[int]:
        """Places of the goals that are guaranteed, and no standard deviations."""
        return [g for g, goal in enumerate(self.goals) if not goal.stochastic]

    def finer(self, parts: int) -> PlanProblem:
        """The same, of which so many steps are one: nothing more may be measured."""
        return replace(
            self,
            goals=tuple(replace(goal, steps=goal.steps * parts) for goal in self.goals),
            step=self.step / parts,
            allowed=on_finer(self.allowed, parts),
            spacing=self.spacing * parts,
            sensor_spacing=self.sensor_spacing * parts,
        )

    def ends(self, g: int) -> Mask:
        """Steps at which a hidden trajectory against a goal may end."""
        goal = self.goals[g]
        ends = np.full(self.steps, goal.at != "given times")
        ends[goal.steps.astype(int) % self.steps] = True
        return ends

    def cost(self, chosen: Mask) -> float:
        """Price of a period in which `chosen` (M, p) is measured; the number of samples where nothing has a price."""
        visits = float(np.any(chosen, axis=1).sum())
        return visits if self.counts else visits * self.visit + float(chosen.sum(axis=0) @ self.price)

    def is_admissible(self, chosen: Mask) -> bool:
        """Whether a choice keeps hours, spacings, uses and limits."""
        samples = np.any(chosen, axis=1)
        if np.any(chosen & ~self.allowed) or np.any(chosen.sum(axis=0) > self.longest_use) or not samples.any():
            return False
        if samples.sum() > self.most_samples or self.cost(chosen) > self.most_cost * (1 + SAME_PRICE):
            return False
        columns = [(samples, self.spacing)]
        columns += [(chosen[:, j], int(s)) for j, s in enumerate(self.sensor_spacing)]
        return all(_apart(taken, least, self.steps) for taken, least in columns)

    def schedule(self, chosen: Mask) -> PeriodicSchedule:
        """The periodic schedule of a choice."""
        at, calendar = np.flatnonzero(chosen.any(axis=1)), self.requirement.calendar
        origin, unit = None if calendar is None else zoned_text(calendar.begun), self.plant.time_unit
        names = self.plant.outputs.names
        return PeriodicSchedule.from_times(
            at * self.step, self.period, chosen[at], time_unit=unit, origin=origin, output_names=names
        )

    def chosen(self, schedule: PeriodicSchedule) -> Mask:
        """The choice that a schedule makes.

        Raises ArgumentError if its period, unit or outputs are others, or a time is off the grid.
        """
        schedule = align(self.plant, schedule)
        at = np.round(schedule.times / self.step).astype(int)
        near = np.abs(schedule.times - at * self.step) <= WHOLE * self.step
        if abs(schedule.period - self.period) > WHOLE * self.step or not near.all() or at.max() >= self.steps:
            raise ArgumentError(
                f"`schedule` must have the period {self.period!r} and times on the grid of {self.step!r}, got a "
                f"period of {schedule.period!r}."
            )
        chosen = np.zeros(self.allowed.shape, dtype=bool)
        chosen[at] = True if schedule.outputs is None else schedule.outputs
        return chosen


def on_finer(chosen: Mask, parts: int) -> Mask:
    """A choice (M, p) on a grid of which so many steps are one (M parts, p)."""
    lifted = np.zeros((len(chosen) * parts, chosen.shape[1]), dtype=bool)
    lifted[::parts] = chosen
    return lifted


def _apart(taken: Mask, least: int, steps: int) -> bool:
    at = np.flatnonzero(taken)
    return not at.size or least <= 1 or bool(np.min(np.diff(np.append(at, at[0] + steps))) >= least)


def pose_plan(plant: Plant, requirement: PlanRequirement) -> PlanProblem:
    """Return the numbers of a requirement for a plant.

    Raises ArgumentError if a name is unknown, a bound missing, or period and grid do not fit;
    InfeasibleRequirementError if nothing may be measured at any time.
    """
    unit = requirement.time_unit or plant.time_unit
    steps, step = _grid(plant, requirement, unit)
    checks.known_keys("`sensors`", requirement.sensors, plant.outputs.names)
    terms = [requirement.sensors.get(name, Sensor()) for name in plant.outputs.names]
    used = [steps if t.longest_use is None else t.longest_use for t in terms]
    allowed = _allowed(plant, requirement, terms, steps, step) & (np.array(used) > 0)
    if not allowed.any():
        raise InfeasibleRequirementError(
            "No sensor may be measured at any time of the period: see `hours`, `available` and `longest_use`.", "hours"
        )
    asked = [requirement.spacing, *(term.spacing for term in terms)]
    places = ["spacing", *(f"sensors.{name}.spacing" for name in plant.outputs.names)]
    spacing, *in_step = [
        1 if least is None else _steps(place, least, unit, plant, steps, step)
        for place, least in zip(places, asked, strict=True)
    ]
    late = _tolerance(requirement, unit, plant, steps * step)
    goals = tuple(_goals(plant, requirement, unit, step))
    _check_bounds(requirement, terms, goals)
    bound = np.array([t.sure_bound for t in terms])
    vague = [t.noise_deviation is None or t.detection_limit is not None for t in terms]
    deviation = np.array([np.inf if so else t.noise_deviation for so, t in zip(vague, terms, strict=True)])
    says = np.zeros(len(terms), dtype=bool)
    for stochastic, size in ((False, bound), (True, deviation)):
        says |= np.isfinite(size) & any(goal.stochastic == stochastic for goal in goals)
    allowed &= says
    if not allowed.any():
        raise InfeasibleRequirementError(
            "No sensor that may be measured has a `noise_bound` or `noise_deviation` that its readings are sure to "
            "keep: they say nothing.",
            "sensors",
        )
    return PlanProblem(
        plant=plant,
        requirement=requirement,
        goals=goals,
        step=step,
        allowed=allowed,
        price=np.array([t.price for t in terms]) * allowed.any(axis=0),  # nobody pays for what is never read
        visit=requirement.visit_price,
        spacing=max(1, spacing, int(late.span / step + WHOLE) + 1 if late else 1),
        sensor_spacing=np.array(in_step, dtype=np.intp),
        longest_use=np.array(used, dtype=np.intp),
        v_bound=bound,
        v_deviation=deviation,
        w_intensity=_intensities(plant, requirement, goals),
        most_samples=np.inf if requirement.samples is None else float(requirement.samples),
        most_cost=np.inf if requirement.cost_limit is None else requirement.cost_limit,
        initial=InitialSet.of(plant, requirement.initial_error),
        timing_tolerance=late,
        result_delays=_delays(terms, unit, plant, goals),
    )


def _delays(terms: list[Sensor], unit: str, plant: Plant, goals: tuple[RowGoal, ...]) -> Array | None:
    """How long results are out at least and at most (p, 2), in the plant's time unit; None where all come at once."""
    factor = time_factor(unit, plant.time_unit)
    found = np.zeros((len(terms), 2))
    for k, (name, term) in enumerate(zip(plant.outputs.names, terms, strict=True)):
        if term.result_delay is not None:
            found[k] = np.multiply(result_span(f"sensors.{name}.result_delay", term.result_delay, unit), factor)
    if not found.any():
        return None
    if any(goal.stochastic for goal in goals):
        raise ArgumentError("`result_delay` is for goals that are guaranteed, not for standard deviations.")
    after = next((goal.name for goal in goals if goal.at == "after each sample"), None)
    if after is not None:
        raise ArgumentError(
            f"`accuracy.{after}.at` must be all times or given ones where results come later (`result_delay`), got "
            '"after each sample": its result is not in then.'
        )
    return freeze(found)


def _tolerance(requirement: PlanRequirement, unit: str, plant: Plant, period: float) -> TimingTolerance:
    """How early or late readings may be, in the plant's time unit."""
    asked = requirement.early_or_late(unit, plant.outputs.names)
    if not asked:
        return ON_TIME
    late = asked.scaled(time_factor(unit, plant.time_unit))
    if late.span >= period * (1 - WHOLE):
        alike = late.early == late.late
        limit = "less than half of" if alike else "early and late, together less than"
        raise ArgumentError(
            f"`timing_tolerance` must be {limit} the period {spoken(period, plant.time_unit)}, got "
            f"{spoken(late.span / (1 + alike), plant.time_unit)}: samples would change places."
        )
    if any(goal.kind == KINDS[1] for goal in requirement.accuracy.values()):
        raise ArgumentError("`timing_tolerance` is for goals that are guaranteed, not for standard deviations.")
    return late


def _grid(plant: Plant, requirement: PlanRequirement, unit: str) -> tuple[int, float]:
    """Steps of the period, and the length of one."""
    calendar, factor = requirement.calendar, time_factor(unit, plant.time_unit)
    if requirement.period is None and calendar is None:
        raise ArgumentError("`period` is missing: after which time does the plan repeat?")
    week = SECONDS["wk"] / SECONDS[unit]
    period = week if requirement.period is None else duration("period", requirement.period, unit)
    given = requirement.grid
    if given is None:
        grid = period / DEFAULT_STEPS if calendar is None else SECONDS["min"] * 15 / SECONDS[unit]
    else:
        grid = duration("grid", given, unit)
    steps = round(period / grid)
    if steps < 1 or abs(period / grid - steps) > WHOLE or steps > MOST_STEPS:
        raise ArgumentError(
            f"`grid` must divide the period {period!r} {unit} into 1 to {MOST_STEPS} whole steps, got {grid!r}."
        )
    if calendar is not None:
        own = [week_hours("hours", t.hours) for t in requirement.sensors.values() if t.hours is not None]
        every = [calendar.open_hours(), *own]
        whole = "d" if all(len({hours.get(day) for day in DAYS}) == 1 for hours in every) else "wk"
        count = period * SECONDS[unit] / SECONDS[whole]
        if abs(count - round(count)) > WHOLE:
            raise ArgumentError(
                f"`period` must be whole {'weeks' if whole == 'wk' else 'days'} with these opening hours, got "
                f"{period!r} {unit}."
            )
    return steps, period * factor / steps


def _allowed(plant: Plant, requirement: PlanRequirement, terms: list[Sensor], steps: int, step: float) -> Mask:
    allowed = np.ones((steps, len(terms)), dtype=bool)
    calendar, unit = requirement.calendar, requirement.time_unit or plant.time_unit
    if calendar is None and any(t.hours for t in terms):
        raise ArgumentError("`sensors` have hours of their own, which needs a `calendar`.")
    times = np.arange(steps) * step
    for j, (name, term) in enumerate(zip(plant.outputs.names, terms, strict=True)):
        if calendar is not None:
            own = None if term.hours is None else week_hours("hours", term.hours)
            clock = np.round(times * SECONDS[plant.time_unit] / 60, 6)
            allowed[:, j] = [calendar.is_open(float(minute), own) for minute in clock]
        windows = term.windows(name, calendar, unit)
        if windows is not None:
            first, last = (windows * time_factor(unit, plant.time_unit) / step).T
            if last.size and last.max() > steps + WHOLE:
                raise ArgumentError(
                    f"`sensors.{name}.available` must lie within the period {spoken(steps * step, plant.time_unit)}, "
                    f"got {short(float(windows.max()))}."
                )
            at = np.arange(steps)[:, None]
            allowed[:, j] &= np.any((first - WHOLE <= at) & (at < last - WHOLE), axis=1)
    return allowed


def _steps(name: str, value: float | str, unit: str, plant: Plant, steps: int, step: float) -> int:
    """Steps of the grid that hold a least time.

    Raises ArgumentError if it is longer than the period: then not even one sample a period keeps it.
    """
    least = duration(name, value, unit) * time_factor(unit, plant.time_unit)
    if least > (steps + WHOLE) * step:
        raise ArgumentError(
            f"`{name}` must be at most the period, {spoken(steps * step, plant.time_unit)}, since the plan repeats "
            f"after it: got {spoken(least, plant.time_unit)}."
        )
    return int(np.ceil(least / step - WHOLE))


def _goals(plant: Plant, requirement: PlanRequirement, unit: str, step: float) -> list[RowGoal]:
    found = []
    for name, goal in requirement.accuracy.items():
        asked, argument = ([name], "accuracy") if goal.row is None else ([list(goal.row)], f"accuracy.{name}.row")
        rows = requested_rows(plant, asked, argument)
        at = "all times" if goal.at in ("all times", "until the next") else str(goal.at)
        steps = np.zeros(0)
        if not isinstance(goal.at, str):
            at = "given times"
            steps = np.array([t * time_factor(unit, plant.time_unit) / step for t in goal.at])
            if np.any(np.abs(steps - np.round(steps)) > WHOLE):
                raise ArgumentError(f"`accuracy.{name}.at` must name times on the grid of {step!r}, got {goal.when()}.")
        found.append(
            RowGoal(name, rows.matrix[0], rows.units[0], goal.tolerance, at, np.round(steps), goal.kind == KINDS[1])
        )
    return found


def _check_bounds(requirement: PlanRequirement, terms: list[Sensor], goals: tuple[RowGoal, ...]) -> None:
    """Refuse goals whose bounds are missing."""
    if not goals:
        raise ArgumentError(
            "`requirement` names no accuracy. Without bounds, `design_schedule` designs for sigma instead."
        )
    if any(t.noise_bound == 0 for t in terms):
        raise ArgumentError("`noise_bound` must be positive in a plan, got 0: give the sensor's resolution.")
    for stochastic, of, size in ((False, "w_bound", "noise_bound"), (True, "w_intensity", "noise_deviation")):
        asks = [goal.name for goal in goals if goal.stochastic == stochastic]
        if asks and getattr(requirement, of) is None:
            raise ArgumentError(f"`{of}` is missing: accuracy of {asks[0]} needs it; 0 for none.")
        if asks and all(getattr(t, size) is None for t in terms):
            raise ArgumentError(f"`sensors` have no `{size}`: accuracy of {asks[0]} needs it.")


def _intensities(plant: Plant, requirement: PlanRequirement, goals: tuple[RowGoal, ...]) -> Array:
    """Intensity of each disturbance, 0 where no goal asks for it."""
    given = requirement.w_intensity
    if given is None or not any(goal.stochastic for goal in goals):
        return np.zeros(plant.n_disturbances)
    return np.full(plant.n_disturbances, vector_bound("w_intensity", given, plant.disturbances.names))
