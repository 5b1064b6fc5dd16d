"""Plants, schedules and certificates that several tests of this room share."""

import functools

import numpy as np

from sampling_design import PeriodicSchedule, Plant, Schedule, certify

PLANTS = {
    "oscillator": Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]),
    "unstable": Plant([[0.3, 1.0], [-1.0, 0.3]], [[1.0, 0.0]], G=[[0.0], [1.0]]),
    "two outputs": Plant([[-0.1, 1, 0], [-1, -0.1, 0], [0, 0, -0.5]], [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
}
SCHEDULES = {
    "oscillator": PeriodicSchedule([0.8, 1.3]),
    "unstable": PeriodicSchedule([0.5, 0.9, 0.7], first=0.0),
    "two outputs": PeriodicSchedule([1.0, 0.6], outputs=[[1, 1], [1, 0]]),
}
FINITE = Schedule([0.0, 0.9, 1.4, 2.9, 3.3, 4.4, 5.0, 6.2, 7.1, 7.8, 9.0, 10.1])


@functools.cache
def certificate(name, finite=False):
    """A certificate with a moderate rate."""
    plant = PLANTS[name]
    return certify(plant, FINITE if finite else SCHEDULES[name], eta=0.5, P2=np.eye(plant.n_states))
