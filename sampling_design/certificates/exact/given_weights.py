"""Weights as given, or by default from the scales of the plant's signals; the schedule as given."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import align
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.schedules.family import AnySchedule

FREE_DISTURBANCE = (
    "A direction without weight is a free disturbance; one that does not exist is removed through the plant's G."
)
"""What a singular Qw means, for the refusal."""


class NoiseWeights(NamedTuple):
    """Weights of the disturbance, of the fit and of the measurement noise."""

    Qw: Array
    R: Array
    Qv: Array


def default_weights(plant: Plant) -> NoiseWeights:
    """Return Qw = diag(1/s_w^2), R = Qv = 2 diag(1/s_y^2), so that R~ = diag(1/s_y^2)."""
    noise = 2.0 * np.diag(1.0 / plant.outputs.scales**2)
    return NoiseWeights(np.diag(1.0 / plant.disturbances.scales**2), noise, noise.copy())


def above_one(name: str, value: float, what: str = "P2") -> float:
    """Return a noise gain relative to its least, which no `what` attains. Raises ArgumentError if it is not above 1."""
    if not checks.number(name, value) > 1:
        raise ArgumentError(f"`{name}` must be above 1, got {value!r}: no {what} attains the least noise gain.")
    return float(value)


def weights_of(plant: Plant, Qw: object, R: object, Qv: object) -> NoiseWeights:
    """Return the weights as given, where None the default; one of R and Qv stands for both."""
    w, r, _ = default_weights(plant)
    one = r if R is None and Qv is None else (Qv if R is None else R)
    p = plant.n_outputs
    return NoiseWeights(
        checks.definite("Qw", w if Qw is None else Qw, plant.n_disturbances, FREE_DISTURBANCE),
        checks.definite("R" if R is not None else "Qv", one if R is None else R, p),
        checks.definite("Qv" if Qv is not None else "R", one if Qv is None else Qv, p),
    )


def certifiable_schedule(plant: Plant, schedule: AnySchedule) -> AnySchedule:
    """Return the schedule in the plant's terms.

    Raises ArgumentError if they do not fit, or the schedule holds no sample later than time 0.
    """
    schedule = align(plant, schedule)
    # the period of an endless one comes again, though its first sample be at time 0
    if not len(schedule) or (schedule.times[-1] == 0 and not schedule.endless):
        raise ArgumentError("`schedule` must hold a sample later than time 0: without one there is nothing to certify.")
    return schedule
