"""What a record says was sampled since a plan began, and what of it is in; on a clock near its start."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import CensoredReading, PartialReading, with_censored
from sampling_design.accuracy.record_rows import rows_of
from sampling_design.errors import ArgumentError
from sampling_design.planning.disturbed import settled_from_start
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.sequence import settling_time
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask

Reading: TypeAlias = npt.ArrayLike | Sequence[PartialReading | float] | None
NEAR = 1e6  # steps of the grid up to which times are taken as they are: there doubles lie within a millionth of one
APART = 1 / 8  # share of a step by which doubles may differ, at most
FARTHEST = 50_000  # steps between samples of a record: a missed year of quarter hours is gone through in a minute


class RecordedSamples(NamedTuple):
    """Samples of a record: times, what each measured, and of that what is in."""

    times: Array
    measured: Mask
    known: Mask


def taken_samples(
    plan: Plan, record: Iterable[tuple[float, Reading, npt.ArrayLike | None]] | None
) -> RecordedSamples | None:
    """Times and outputs of a record."""
    if record is None:
        return None
    found = dict[float, Mask]()
    for item in rows_of(record, plan.plant, plan.schedule.origin or ""):
        _, reading, *_ = checks.entries("record", item, (2, 3), "rows (t, y, u)")
        plain, limits = with_censored(reading, plan.plant.n_outputs)
        y = None if plain is None else np.isfinite(checks.floats("y", plain).reshape(-1))
        if y is None:
            continue
        y[[each.output for each in limits if _as_planned(plan, each)]] = True
        if not y.any():
            continue
        t = check_resolved(plan, "t", checks.number("t", item[0]))
        if y.size != plan.plant.n_outputs:
            raise ArgumentError(f"`record` must hold {plan.plant.n_outputs} outputs a sample, got {y.size} at {t!r}.")
        found[t] = found[t] | y if t in found else y
    mask = np.array([found[t] for t in sorted(found)], dtype=bool).reshape(-1, plan.plant.n_outputs)
    return RecordedSamples(np.array(sorted(found)), mask, mask)


def check_followed(plan: Plan, taken: RecordedSamples | None, now: float) -> None:
    """Raise ArgumentError if more of the grid lies between samples of a record, or behind it, than is gone through."""
    if taken is None or not taken.times.size:
        return
    gaps = np.diff(np.append(taken.times, now)) / plan.problem.step
    longest = int(np.argmax(gaps))
    if gaps[longest] > FARTHEST:
        raise ArgumentError(
            f"`now` or the next row of `record` lies {gaps[longest]:.3g} steps of the plan's grid after the row at "
            f"{float(taken.times[longest])!r}, more than {FARTHEST}: do they count from the plan's start?"
        )


def _as_planned(plan: Plan, reading: CensoredReading) -> bool:
    """Whether a limit that was read says as much as the plan counts with: "< L" of a sensor that may say so."""
    term = plan.requirement.sensors.get(plan.plant.outputs.names[reading.output])
    limit = None if term is None or term.lowest is None else term.detection_limit
    return limit is not None and reading.began is None and np.isinf(reading.lower) and reading.upper <= limit


def with_awaited(
    plan: Plan, taken: RecordedSamples | None, awaited: list[tuple[float, str]], now: float
) -> RecordedSamples | None:
    """A record with the samples whose results are still out; those that should be in by now are lost."""
    if not awaited:
        return taken
    problem, names, tiny = plan.problem, plan.plant.outputs.names, 1e-6 * plan.problem.step
    if taken is None:
        raise ArgumentError(
            "`awaited` needs a `record`: without one the plan was followed, and its own results are out."
        )
    found = {t: (measured.copy(), known.copy()) for t, measured, known in zip(*taken, strict=True)}
    for item in awaited:
        time, output = checks.entries("awaited", item, (2,), "pairs (t, output)")
        t, name = checks.number("awaited", time), checks.of_kind("awaited", output, str, "the name of an output")
        checks.known_keys("`awaited`", [name], names)
        j = names.index(name)
        delay = 0.0 if problem.result_delay is None else float(problem.result_delay[j])
        if not delay:
            raise ArgumentError(f"`awaited` names {name}, which has no `result_delay`: its results come at once.")
        near = min(found, key=lambda other: abs(other - t), default=t)
        t = near if abs(near - t) <= tiny else t
        if t > now + tiny:
            raise ArgumentError(f"`awaited` must have been taken by now, {now!r}, got {name} at {t!r}.")
        measured, _known = found.setdefault(t, (np.zeros(len(names), dtype=bool), np.zeros(len(names), dtype=bool)))
        if measured[j]:
            raise ArgumentError(f"`awaited` names {name} at {t!r}, which is in the record or named twice.")
        measured[j] = t + delay > now + tiny  # else it is lost
    found = {t: masks for t, masks in sorted(found.items()) if masks[0].any()}
    both = np.array(list(found.values()), dtype=bool).reshape(-1, 2, len(names))
    return RecordedSamples(np.array(list(found)), both[:, 0], both[:, 1])


def result_times(plan: Plan, before: int, taken: RecordedSamples, now: float) -> Array:
    """When each result of a history was in: those of the record by now, none earlier than was said."""
    delay = plan.problem.result_delay
    if delay is None:
        return np.zeros((0, 0))
    known = np.where(taken.known, np.minimum(taken.times[:, None] + delay, now), np.nan)
    return np.vstack([np.full((before, delay.size), np.nan), known])


def check_resolved(plan: Plan, name: str, t: float) -> float:
    """Return a time. Raises ArgumentError if it is so large that no double tells steps of the grid from each other."""
    if np.spacing(abs(t)) > APART * plan.problem.step:
        raise ArgumentError(
            f"`{name}` = {t!r} lies so far from the plan's start that no double tells steps of its grid, "
            f"{plan.problem.step!r}, from each other."
        )
    return t


def clock_near_start(plan: Plan, taken: RecordedSamples | None, now: float, *, soon: bool) -> float:
    """By how many whole periods, as a time, a clock may be put back: what came before its zero then counts no more."""
    first = now if taken is None or not taken.times.size else min(now, float(taken.times[0]))
    ago = max(2 * settling_time(plan), NEAR * plan.problem.step)
    spare = np.floor((first - ago) / plan.schedule.period)
    settled = spare >= 1 and plan.requirement.calendar is None and settled_from_start(plan, ago / 2, soon=soon) < np.inf
    return float(spare) * plan.schedule.period if settled else 0.0


def put_back(plan: Plan, t: Array, by: float) -> Array:
    """Times on a clock that shows so much less; on the grid where no double of the large times tells them from it."""
    moved, step = t - by, plan.problem.step
    whole = np.round(moved / step) * step
    return np.where(np.abs(moved - whole) <= 2 * np.spacing(np.abs(t)), whole, moved) if by else t
