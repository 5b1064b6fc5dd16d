"""What the sample-based estimator is compared with: dense regular samples, and regular ones of equal number."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule


@checked
def standard_mhe(
    plant: Plant, period: float, *, horizon: float, **options: Any
) -> tuple[MovingHorizonEstimator, PeriodicSchedule]:
    """Return a moving horizon estimator for dense regular samples, and the schedule it wants.

    Parameters
    ----------
    plant : Plant
    period : float
        Time between samples.
    horizon : float
        At least one period.
    **options
        As for `MovingHorizonEstimator`; the cost has the paper's form unless it says otherwise.

    Returns
    -------
    estimator : MovingHorizonEstimator
    schedule : PeriodicSchedule

    Raises
    ------
    ArgumentError
        If the horizon is shorter than the period, or as in `MovingHorizonEstimator`.
    """
    gap = checks.positive("period", period)
    if horizon < gap:
        raise ArgumentError(f"`horizon` must be at least one `period` = {gap!r}, got {horizon!r}.")
    cost = options.pop("cost", None) or CostFunction()
    if isinstance(cost, CostFunction) and cost.form is None:
        cost = replace(cost, form="paper")
    return MovingHorizonEstimator(plant, horizon=horizon, cost=cost, **options), PeriodicSchedule(
        np.array([gap]), time_unit=plant.time_unit
    )


@checked
def periodic_at_equal_cost(schedule: Schedule | PeriodicSchedule) -> PeriodicSchedule:
    """Return the regular schedule with as many samples per time as `schedule`, from the same first sample.

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule

    Returns
    -------
    PeriodicSchedule

    Raises
    ------
    ArgumentError
        If a finite schedule has fewer than two samples.

    Examples
    --------
    >>> periodic_at_equal_cost(PeriodicSchedule([1.0, 0.5, 2.5])).gaps
    array([1.33333333])
    """
    if isinstance(schedule, PeriodicSchedule):
        gap = schedule.period / len(schedule)
    else:
        if len(schedule) < 2:
            raise ArgumentError(f"`schedule` must hold at least two samples, got {len(schedule)}.")
        gap = float(np.mean(schedule.gaps))
    return PeriodicSchedule(np.array([gap]), min(gap, float(schedule.times[0])), time_unit=schedule.time_unit)
