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


EXACT = list(product([0.0, 0.2], [True, False], [(0.0, 0.1), (0.1, 0.0), (0.0, 0.0)], range(12)))


@pytest.mark.parametrize(("w_bound", "start", "noise", "seed"), few(EXACT, 3, 48, 66, 120))
def test_units_change_nothing_of_an_interval_from_exact_sensors(w_bound, start, noise, seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3)) * 0.7
    plant = sd.Plant(A, rng.normal(size=(2, 3)), G=rng.normal(size=(3, 2)))
    units = Units.drawn(np.random.default_rng(seed + 7), plant)
    times, first = [0.5, 1.1, 1.6, 2.4], np.array([0.3, -0.4, 0.5])
    readings = [plant.C @ plant.transition(t) @ first + 0.3 * np.array(noise) for t in times]
    known = {"initial_error": np.array([1.0, 2.0, 1.5])} if start else {}
    here = sd.state_interval(
        plant,
        [(t, y, None) for t, y in zip(times, readings, strict=True)],
        2.7,
        w_bound=[w_bound] * 2,
        v_bound=noise,
        prior_time=0.0,
        **known,
    )
    there = sd.state_interval(
        units.plant(plant),
        [(t * units.time, y * units.outputs, None) for t, y in zip(times, readings, strict=True)],
        2.7 * units.time,
        w_bound=w_bound * units.disturbances,
        v_bound=noise * units.outputs,
        prior_time=0.0,
        **{name: each * units.states for name, each in known.items()},
    )
    assert there.radii / units.states == pytest.approx(
        here.radii, rel=2e-3, abs=1e-7
    )  # 0 where exact samples leave nothing
    assert here.holds(plant.transition(2.7) @ first)


@pytest.mark.parametrize("size", [1e-12, 1e-6, 1.0, 1e12])
def test_no_trajectory_that_an_exact_sensor_shows_attains_a_bound(size):
    """What nothing drives is known exactly from the first exact sample on: the start alone says what is least."""
    plant = sd.Plant([[0.4]], [[2.0 / size]], G=[[size]])
    schedule, known = sd.Schedule([0.6, 1.1, 2.5]), {"start": 0.0, "end": 3.0, "initial_error": 1.5 * size}
    found = sd.guaranteed_accuracy(plant, schedule, w_bound=0.0, v_bound=0.0, **known)
    least = 1.5 * np.exp(0.4 * 0.6) * size
    assert found.lower[0] <= least * (1 + 1e-9) <= found.upper[0] * (1 + 2e-9)
    assert [found.lower[0], found.upper[0]] == pytest.approx([least, least], rel=1e-3)


WITNESSED = {
    "what grows, undriven": ([[0.45, 2.6], [-2.6, 0.45]], np.eye(2), [[3e13], [1e13]], [0.0], [1.6, 1.6]),
    "an entry of w that is 0": (
        [[-1.3, -0.3, 0.8], [-0.3, -2.5, -0.1], [0.8, -0.1, -2.2]],
        [[-0.1, 0.9, 0.5]],
        np.eye(3),
        [1e-6, 0.0, 1e-6],
        [0.9],
    ),
    "a start of which nothing is known": (
        [[-0.1, 1.0, 0.0], [0.0, -0.1, 1.0], [0.0, 0.0, -0.1]],
        [[2e-8, -5e-9, 6e-9], [-0.4, -0.3, -1.5]],
        [[-0.17], [0.24], [0.23]],
        [0.1],
        [2e-9, 0.15],
    ),
}


@pytest.mark.parametrize(("name", "time"), few(product(WITNESSED, [1e-9, 1e9]), 0, 3, 4))
def test_what_is_attained_does_not_hang_on_the_unit_of_time(name, time):
    """A witness's flow is that of its disturbance in units of the bound: a large G in small units costs no digits."""
    A, C, G, w, v = WITNESSED[name]
    plant, times = sd.Plant(np.divide(A, time), C, G=np.divide(G, time)), np.array([0.7, 1.7, 2.0]) * time
    schedule = sd.Schedule(times) if "start" in name else sd.PeriodicSchedule.from_times(times, 2.2 * time)
    found = sd.guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=v, of="x1", rtol=0.05)
    assert found.lower[0] >= found.upper[0] * 0.95
    assert found.verify()


TURNED = {
    "a level beside what decays, undriven": (np.diag([0.0, -0.5]), [[-0.2, -0.7]], [[0.0], [0.0]], 0.7, [1.3]),
    "a level that moves what decays": ([[0.0, 0.0], [0.1, -0.5]], [[-0.15, 0.4]], [[0.0], [-1.8]], 0.0, [0.8]),
    "what grows beside a driven lag": (
        [[-1.7, 0.0, 0.0], [0.0, 0.2, 2.9], [0.0, -2.9, 0.2]],
        [[-0.3, -0.4, 0.6], [-0.2, -2.1, -0.2]],
        [[-0.5], [0.0], [0.0]],
        0.8,
        [0.3, 0.2],
    ),
    "an oscillation beside a driven level": (
        [[0.0, 0.0, 0.0], [0.0, 0.0, 1.7], [0.0, -1.7, 0.0]],
        [[-0.7, -1.3, -1.1], [-0.2, 0.5, -0.5]],
        [[1.3], [0.0], [0.0]],
        0.8,
        [1.4, 2.5],
    ),
}


@pytest.mark.parametrize(("name", "seed"), few(product(TURNED, range(6)), 1, 13))
def test_other_states_attain_as_much(name, seed):
    """What a turn leaves where a plant has zeros is rounding: no growth, and nothing that w has to make up for."""
    A, C, G, w, v = (np.array(each) for each in TURNED[name])
    rng = np.random.default_rng(seed)
    T = rng.normal(size=A.shape)
    while np.linalg.cond(T) > 30:
        T = rng.normal(size=A.shape)
    back, schedule = np.linalg.inv(T), sd.PeriodicSchedule([0.7, 1.3])
    here = sd.guaranteed_accuracy(sd.Plant(A, C, G=G), schedule, w_bound=w, v_bound=v, rtol=0.1)
    plant = sd.Plant(T @ A @ back, C @ back, G=T @ G)
    there = sd.guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=v, of=back, rtol=0.1)
    assert np.all(there.lower <= here.upper * (1 + 1e-6) + 1e-9)
    assert np.all(here.lower <= there.upper * (1 + 1e-6) + 1e-9)
    assert np.all(there.lower >= here.lower * 0.9 - 1e-9)
    assert there.verify()


@pytest.mark.parametrize(("time", "order"), few([(1e-7, 3), (1e4, 3), (3e7, 1), (1e-6, 2)], 2, 3))
def test_the_unit_of_time_changes_no_limit_of_integrators(time, order):
    """They have no rate of their own: how soon w moves an output by its noise says how fast they are."""

    def told(unit):
        plant = sd.Plant(np.eye(order, k=1) / unit, np.eye(order)[:1], G=np.eye(order) / unit)
        return sd.accuracy.accuracy_limit(plant, w_bound=np.full(order, 0.1), v_bound=[0.1])

    here, there = told(1.0), told(time)
    assert there.lower == pytest.approx(here.lower, rel=0.02)
    assert there.closed
    assert here.closed
