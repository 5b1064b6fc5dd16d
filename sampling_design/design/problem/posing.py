"""A requirement met with a plant: defaults filled in, units converted, numbers posed and checked."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sampling_design.design.problem.design_problem import SLACK, DesignProblem
from sampling_design.design.problem.feasible import check_feasible
from sampling_design.design.problem.requirement import Requirement
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.count.pbh import require_observable
from sampling_design.observability.count.zero_count import ZeroCountBound, default_window, zero_count_bound
from sampling_design.observability.sigma_bracket import SHARE
from sampling_design.plants.functional import split_needed, weighed_over
from sampling_design.plants.modes import ModalSplit
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import short
from sampling_design.records.signatures import checked
from sampling_design.records.units import SECONDS, time_factor
from sampling_design.schedules.jitter import TimingTolerance
from sampling_design.schedules.opening import DAYS, WeekHours, week_hours
from sampling_design.schedules.sensor import Sensor, common, complement, numbers, result_span

MOST_DEFAULT_SAMPLES = 24
"""Samples of a period that are taken unasked, at most: more take minutes."""
TIMES = ("window", "period", "spacing")
"""What a requirement says in its unit of time, beside what is within the period."""

_TIMED = {*TIMES, "forbidden", "fixed", "sensors", "timing_tolerance"}


class ResolvedRequirement(NamedTuple):
    """A requirement without gaps, the defaults that were used, with reasons, and the zero count if they took it."""

    requirement: Requirement
    used: dict[str, Any]
    zero_count: ZeroCountBound | None


def split_for(plant: Plant, requirement: Requirement) -> ModalSplit:
    """Split what is designed for: the plant, or what the rows asked for need, weighed over the window."""
    rate = _decay_rate(plant, requirement)
    split = split_of(part_for(plant, requirement.of, decay_rate=rate), requirement)
    if requirement.of is None:
        require_observable(plant, "a zero count", rate)
    return split


def split_of(part: Plant, requirement: Requirement) -> ModalSplit:
    """The same of a plant that is what the rows asked for need, as that of a design is."""
    split = split_needed(part, _decay_rate(part, requirement))
    if requirement.of is None or not split.retained.n_states:
        return split
    return weighed_over(split, float(resolve(split, requirement).requirement.window or 0))


def _decay_rate(plant: Plant, requirement: Requirement) -> float:
    """In the plant's unit of time."""
    return requirement.decay_rate / time_factor(requirement.time_unit or plant.time_unit, plant.time_unit)


@checked
def resolve(split: ModalSplit, requirement: Requirement) -> ResolvedRequirement:
    """Fill in the defaults, in the plant's time unit; return them with what they rest on."""
    r = in_unit(requirement, split.plant.time_unit)
    used: dict[str, Any] = {}
    retained, count, own = split.retained, None, r.window is None
    if own:
        r = r.replace(window=default_window(split) or r.period or 1.0)
        used["window"] = r.window
    if r.period is None:
        r = r.replace(period=r.window)
        used["period"] = r.period
    if own and r.timing_tolerance is not None:
        r = _longer(r)
        used["window"] = r.window
    longer, notice, r = r.window, _of_quicker_sensors(r, split.plant.outputs.names), _in_windows(r)
    if r.window != longer:
        used["window"] = r.window
    if not r.samples:
        sure_window = _sure_window(r)
        count = zero_count_bound(retained, sure_window)
        needed = count.samples
        per_period = max(1, int(np.ceil(needed * _known(r.period) / sure_window - SLACK)))
        kind = "exactly" if r.target_sigma is None else "at_most"
        most = min(per_period, MOST_DEFAULT_SAMPLES) if r.target_sigma is None else MOST_DEFAULT_SAMPLES
        r = r.replace(samples={kind: max(most, r.fixed.size)})
        used["samples"] = dict(r.samples)
        if r.target_sigma is None and per_period > MOST_DEFAULT_SAMPLES:
            notice.append(
                f"The zero count asks for {per_period} samples per period; {MOST_DEFAULT_SAMPLES} are designed. "
                "Give `samples` to change this."
            )
    if r.spacing is None:
        r = r.replace(spacing=_known(r.window) / (4 * max(r.samples.values())))
        used["spacing"] = r.spacing
    if r.timing_tolerance is None and own:
        r = _longer(r.replace(timing_tolerance=SHARE * _known(r.spacing)))
        used.update(timing_tolerance=r.timing_tolerance, window=r.window)
    r = r.replace(timing_tolerance=TimingTolerance.of(r.timing_tolerance).plain)
    r._check_within(_known(r.period))
    late = TimingTolerance.of(r.timing_tolerance, split.plant.outputs.names)
    if late and late.span >= _known(r.spacing):
        raise ArgumentError(
            f"`timing_tolerance`, early and late together, must be less than the least time between two samples, "
            f"{short(r.spacing)}, got {short(late.span)}: they could change places. Ask for a wider `spacing`."
        )
    return ResolvedRequirement(r, {**used, "notice": " ".join(notice)} if notice else used, count)


def _longer(requirement: Requirement) -> Requirement:
    """The requirement whose window holds what was planned in its own, whenever samples come."""
    late = TimingTolerance.of(requirement.timing_tolerance)
    return requirement.replace(window=_known(requirement.window) + 2 * late.radius)


def _in_windows(requirement: Requirement) -> Requirement:
    """The requirement with its sensors' terms as numbers: windows, prices, and a window that ends with what is in."""
    unit, terms = str(requirement.time_unit), requirement.sensors
    changes = dict[str, object]()
    if requirement.calendar is not None:
        changes = {"forbidden": np.vstack([requirement.forbidden, _shut(requirement, None)]), "calendar": None}
    elif any(term.hours is not None for term in terms.values()):
        raise ArgumentError("`sensors` have hours of their own, which needs a `calendar`.")
    delays = [t.result_delay for t in terms.values() if t.result_delay is not None]
    out = max((result_span("result_delay", delay, unit)[1] for delay in delays), default=0.0)
    if out:
        window = _known(requirement.window)
        if not window > out:
            raise ArgumentError(
                f"`window` must be longer than the longest `result_delay` {short(out)}, got {short(window)}: no result "
                "of a sample in it is in."
            )
        changes["window"] = window - out
    plain = {name: {"available": _open(requirement, name), "price": term.price} for name, term in terms.items()}
    return requirement.replace(**changes, sensors=plain)


def _of_quicker_sensors(requirement: Requirement, outputs: tuple[str, ...]) -> list[str]:
    """One sentence where results of some outputs come sooner than those of the slowest, which end windows for all."""
    terms, unit = [requirement.sensors.get(name, Sensor()) for name in outputs], str(requirement.time_unit)
    out = [0.0 if t.result_delay is None else result_span("result_delay", t.result_delay, unit)[1] for t in terms]
    quicker = ", ".join(name for name, delay in zip(outputs, out, strict=True) if delay < max(out))
    said = f"Windows end with the results of the slowest sensor: what quicker ones ({quicker}) read in the rest"
    return [f"{said} counts neither in sigma nor in its bound."] if quicker else []


def _open(requirement: Requirement, name: str) -> Array | None:
    """When a sensor can be read and is sure to say something."""
    term = requirement.sensors[name]
    windows = term.windows(name, requirement.calendar, str(requirement.time_unit))
    if term.detection_limit is not None:  # two values below it look alike: no difference is sure to be seen
        return np.zeros((0, 2))
    if term.hours is None:
        return windows
    shut = _shut(requirement, week_hours("hours", term.hours))
    return common(windows, complement(shut, _known(requirement.period)))


def _shut(requirement: Requirement, own: WeekHours | None) -> Array:
    """When the place, or a sensor with hours of its own, is closed within the period (m, 2).

    Raises ArgumentError if the period does not hold whole days, or weeks where these differ.
    """
    assert requirement.calendar is not None
    period, unit = _known(requirement.period), str(requirement.time_unit)
    others = [week_hours("hours", term.hours) for term in requirement.sensors.values() if term.hours is not None]
    every = [requirement.calendar.open_hours(), *others]
    repeat = "d" if all(len({hours.get(day) for day in DAYS}) == 1 for hours in every) else "wk"
    count = period * SECONDS[unit] / SECONDS[repeat]
    if abs(count - round(count)) > 1e-6:
        raise ArgumentError(
            f"`period` must be whole {'weeks' if repeat == 'wk' else 'days'} with these opening hours, got "
            f"{short(period)} {unit}."
        )
    minute = 60 / SECONDS[unit]
    return np.multiply(requirement.calendar.closed(period / minute, own), minute).reshape(-1, 2)


def _sure_window(requirement: Requirement) -> float:
    """The part of a window whose planned samples lie in it whatever their real times are."""
    window, late = _known(requirement.window), TimingTolerance.of(requirement.timing_tolerance)
    if not window > 2 * late.radius:
        raise ArgumentError(
            f"`window` must be longer than early and late together, {short(2 * late.radius)}, got {short(window)}: no "
            "sample is certain to lie in it."
        )
    return window - 2 * late.radius


def repeated(requirement: Requirement, periods: int) -> Requirement:
    """Return the same constraints on times, over `periods` periods as one; `requirement` is resolved."""
    period = _known(requirement.period)

    def tiled(spans: Array) -> Array:
        return np.asarray((spans[None] + period * np.arange(periods)[:, None, None]).reshape(-1, 2))

    sensors = {
        name: {"available": None if a.available is None else tiled(numbers(a)), "price": a.price}
        for name, a in requirement.sensors.items()
    }
    fixed = (requirement.fixed + period * np.arange(periods)[:, None]).ravel()
    changes: dict[str, object] = {
        "period": periods * period,
        "forbidden": tiled(requirement.forbidden),
        "fixed": fixed,
        "sensors": sensors,
    }
    if requirement.cost_limit is not None:
        changes["cost_limit"] = periods * requirement.cost_limit
    return requirement.replace(**changes)


def _known(value: float | None) -> float:
    """A number that was filled in before."""
    assert value is not None
    return value


def in_unit(requirement: Requirement, unit: str) -> Requirement:
    """Return the requirement with every time and rate in another unit."""
    if requirement.time_unit in (None, unit):
        return requirement.replace(time_unit=unit)
    c = time_factor(str(requirement.time_unit), unit)
    times = {k: v * c for k in TIMES if (v := getattr(requirement, k)) is not None}
    if requirement.timing_tolerance is not None:
        times["timing_tolerance"] = TimingTolerance.of(requirement.timing_tolerance).scaled(c).plain
    return requirement.replace(
        **times,
        forbidden=requirement.forbidden * c,
        fixed=requirement.fixed * c,
        decay_rate=requirement.decay_rate / c,
        sensors={name: term.in_unit(str(requirement.time_unit), unit) for name, term in requirement.sensors.items()},
        time_unit=unit,
    )


def in_own_unit(error: InfeasibleRequirementError, asked: Requirement, unit: str) -> InfeasibleRequirementError:
    """The error with its times in the unit of what was asked; its words keep those of the plant, and say so."""
    if asked.time_unit in (None, unit):
        return error
    found = error.nearest
    if _TIMED & found.keys():
        timed = {key: value for key, value in found.items() if key in _TIMED}
        own = in_unit(Requirement().replace(**timed, time_unit=unit), str(asked.time_unit))
        found = found | {key: getattr(own, key) for key in timed}
    return InfeasibleRequirementError(f"{error} Times here are in {unit}, as the plant's.", error.obstacle, found)


def pose(
    plant: Plant, requirement: Requirement, samples: int, check: bool = True, counted: Array | None = None
) -> DesignProblem:
    """Return the numbers of the design with `samples` per period; `requirement` is resolved, `counted` as there.

    With samples that come up to a early or b late, no schedule has a larger sigma over windows of T than exact ones
    have over windows of T - a - b, of the state a before these begin, read (b - a)/2 after they are planned: of the
    plant (A, C e^{A(a + b)/2}). Those planned within a of a window's beginning or b of its end may be out of it, and
    all others in the middle. Of outputs with tolerances of their own each has its row, and the least a and b hold.
    Raises InfeasibleRequirementError if no schedule meets it; names the obstacle and the nearest one that works.
    """
    names = plant.outputs.names
    checks.known_keys("`sensors` of the requirement", requirement.sensors, names)
    terms = [requirement.sensors.get(name) for name in names]
    prices = np.array([0.0 if a is None else a.price for a in terms])
    late = TimingTolerance.of(requirement.timing_tolerance, names)
    lost = min(late.early) + min(late.late)
    problem = DesignProblem(
        plant=_read_in_the_middle(plant, late) if late else plant,
        window=_sure_window(requirement) + 2 * late.radius - lost,
        late=lost / 2,
        closest=late.span,
        period=_known(requirement.period),
        spacing=_known(requirement.spacing),
        samples=samples,
        forbidden=requirement.forbidden,
        fixed=requirement.fixed,
        available=tuple(None if a is None or a.available is None else numbers(a) for a in terms),
        costs=prices,
        cost_limit=np.inf if requirement.cost_limit is None else requirement.cost_limit,
        counted=counted,
    )
    if check:
        try:
            check_feasible(problem)
        except InfeasibleRequirementError as error:
            raise InfeasibleRequirementError(
                str(error), error.obstacle, _as_asked(error.nearest, requirement, names)
            ) from None
    return problem


def _read_in_the_middle(plant: Plant, late: TimingTolerance) -> Plant:
    """The plant whose outputs show, when a sample is planned, what each shows in the middle of its own times.

    Of the state at a window's beginning, the least `early` before the first sample that it is sure of is planned.
    """
    after = np.broadcast_to((np.array(late.late) - late.early) / 2 + min(late.early), plant.n_outputs)
    return Plant(plant.A, np.einsum("pi,pij->pj", plant.C, plant.transition(after)))


def _as_asked(change: dict[str, Any], requirement: Requirement, names: tuple[str, ...]) -> dict[str, Any]:
    """A change of the problem as keyword arguments of the requirement."""
    result = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in change.items()}
    if "closest" in result:
        late = TimingTolerance.of(requirement.timing_tolerance, names)
        result["timing_tolerance"] = late.scaled(result.pop("closest") / late.span).plain
    spans = result.pop("available", None)
    if spans is not None:
        prices = {name: term.price for name, term in requirement.sensors.items()}
        result["sensors"] = {
            name: {"available": None if span is None else span.tolist(), "price": prices.get(name, 0.0)}
            for name, span in zip(names, spans, strict=True)
        }
    return result
