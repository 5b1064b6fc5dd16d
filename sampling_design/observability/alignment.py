"""Where a plant and a schedule first meet: one unit of time, one list of outputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar, cast

import numpy as np

from sampling_design.checkers.strict import listed
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.schedules.family import AnySchedule
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule, ScheduleDetails

TimesKind = TypeVar("TimesKind", bound=AnySchedule)


def align(plant: Plant, schedule: TimesKind) -> TimesKind:
    """Return `schedule` in the plant's terms: its columns in the order of the plant's outputs.

    Raises ArgumentError if it is no schedule, if units of time differ, if the mask has another number of outputs, or if
    it names an output that the plant does not have.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        Without a unit its times are in the plant's; without output names its columns are the plant's
        outputs in their order. With names it may list them in another order or leave some out; an
        output that it leaves out is never measured.

    Returns
    -------
    Schedule or PeriodicSchedule
        `schedule` itself where nothing had to be put in order.

    Examples
    --------
    >>> plant = Plant([[0.0]], [[1.0]], time_unit="h")
    >>> align(plant, Schedule([0.0, 30.0], time_unit="min"))
    Traceback (most recent call last):
    ...
    sampling_design.errors.ArgumentError: `schedule` is in min and the plant in h. Convert it: schedule.in_unit("h").
    """
    if not isinstance(schedule, (Schedule, PeriodicSchedule)):
        raise ArgumentError(
            f"`schedule` must be a Schedule or a PeriodicSchedule, got {type(schedule).__name__}. "
            "Did you pass times? Use Schedule(times)."
        )
    if schedule.time_unit is not None and schedule.time_unit != plant.time_unit:
        raise ArgumentError(
            f"`schedule` is in {schedule.time_unit} and the plant in {plant.time_unit}. "
            f'Convert it: schedule.in_unit("{plant.time_unit}").'
        )
    mine, theirs = plant.outputs.names, schedule.output_names
    if theirs is not None and theirs != mine:
        return cast(TimesKind, _in_order(schedule, theirs, mine))
    if schedule.outputs is not None and schedule.outputs.shape[1] != plant.n_outputs:
        raise ArgumentError(
            f"`schedule` has a mask for {schedule.outputs.shape[1]} outputs and the plant has {plant.n_outputs}. "
            "Name them (output_names) if it measures only some."
        )
    return schedule


def _in_order(schedule: AnySchedule, theirs: Sequence[str], mine: tuple[str, ...]) -> AnySchedule:
    """The schedule with one column per output of the plant, False where it does not name that output."""
    if not set(theirs) & set(mine):
        raise ArgumentError(
            f"`schedule` measures {listed(theirs)}, and the plant's outputs are {listed(mine)}. "
            "Is it another plant's schedule?"
        )
    checks.known_keys("`schedule.output_names`", theirs, mine)
    mask = np.zeros((len(schedule), len(mine)), dtype=bool)
    mask[:, [mine.index(name) for name in theirs]] = True if schedule.outputs is None else schedule.outputs
    details = ScheduleDetails(time_unit=schedule.time_unit, origin=schedule.origin, output_names=mine)
    if schedule.endless:
        return PeriodicSchedule.from_times(schedule.times, schedule.period, mask, **details)
    return Schedule(schedule.times, mask, **details)
