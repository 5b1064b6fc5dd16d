"""The same physical plant, schedule and data in other units: what every law of units turns round.

A quantity of value q in the old unit has value `factor` q in the new one. Time has a factor of its own and an offset
(dated records start at 1.7e9 s).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.plants.plant import Signals


@dataclass(frozen=True)
class Units:
    """One change of units: a factor for each entry of x, y, u and w, and one for time."""

    states: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray = field(default_factory=lambda: np.ones(0))
    disturbances: np.ndarray = field(default_factory=lambda: np.ones(0))
    time: float = 1.0
    offset: float = 0.0

    @classmethod
    def drawn(cls, rng: np.random.Generator, plant: Plant, decades: int = 12, time_decades: int = 9) -> Units:
        """Each entry by its own power of ten in [-decades, decades], time by one in [-time_decades, time_decades]."""

        def factors(count: int) -> np.ndarray:
            return 10.0 ** rng.integers(-decades, decades + 1, count)

        sizes = (plant.n_states, plant.n_outputs, plant.n_inputs, plant.n_disturbances)
        return cls(*map(factors, sizes), time=float(10.0 ** rng.integers(-time_decades, time_decades + 1)))

    def plant(self, plant: Plant) -> Plant:
        """The plant with its matrices and scales in the new units (`time_unit` is a label only and stays)."""
        x, y, u, w = self.states, self.outputs, self.inputs, self.disturbances
        u = u if plant.n_inputs else np.ones(0)

        def signals(old: Signals, factor: np.ndarray) -> Signals:
            return Signals(old.names, (), old.scales * factor)

        return Plant(
            plant.A * x[:, None] / x / self.time,
            plant.C * y[:, None] / x,
            B=plant.B * x[:, None] / u / self.time,
            D=plant.D * y[:, None] / u,
            G=plant.G * x[:, None] / w / self.time,
            time_unit=plant.time_unit,
            name=plant.name,
            states=signals(plant.states, x),
            outputs=signals(plant.outputs, y),
            inputs=signals(plant.inputs, u),
            disturbances=signals(plant.disturbances, w),
        )

    def schedule(self, schedule: Any) -> Any:
        """The schedule with its times in the new unit; only finite ones are shifted by `offset`."""
        c = self.time
        if isinstance(schedule, Schedule):
            return Schedule(self.offset + c * schedule.times, schedule.outputs)
        times, period = c * schedule.times, c * schedule.period
        return PeriodicSchedule.from_times(times, period, schedule.outputs)

    def state_weight(self, P: np.ndarray) -> np.ndarray:
        """A weight on x (like an inverse covariance) in the new units."""
        return P / np.outer(self.states, self.states)

    def output_weight(self, R: np.ndarray) -> np.ndarray:
        """A weight on y or v in the new units."""
        return R / np.outer(self.outputs, self.outputs)

    def disturbance_weight(self, Q: np.ndarray) -> np.ndarray:
        """A weight on w in the new units: int |w|^2_Q dt keeps its value."""
        return Q / np.outer(self.disturbances, self.disturbances) / self.time
