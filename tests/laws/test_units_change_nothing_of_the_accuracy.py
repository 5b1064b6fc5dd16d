"""The least guaranteed error in other units is the same error, every row by its own factor."""

from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.plants import library
from tests.cases import few
from tests.rescale import Units


@pytest.mark.parametrize(("name", "seed"), few(product(["double_integrator", "triple_integrator"], range(2)), 0))
def test_units_change_nothing_of_the_accuracy(name, seed):
    plant = library.named_plant(name)
    gaps = [1.0, 0.6, 1.4]
    schedule = sd.PeriodicSchedule(gaps)
    units = Units.drawn(np.random.default_rng(seed), plant)
    w, v = plant.disturbances.scales / 50, plant.outputs.scales / 10
    here = sd.guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=v)
    there = sd.guaranteed_accuracy(
        units.plant(plant),
        units.schedule(schedule),
        w_bound=w * units.disturbances,
        v_bound=v * units.outputs,
    )
    for side in ("lower", "upper"):
        assert getattr(there, side) / units.states == pytest.approx(getattr(here, side), rel=1e-5)
    assert there.closed.tolist() == here.closed.tolist()
    assert there.verify()
