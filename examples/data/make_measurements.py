"""Make the measurement files of this folder: simulated truths, irregular samples, noise within known bounds.

    python examples/data/make_measurements.py [FOLDER]

The seed is fixed, so that the files are the same each time. Bounds on noise and initial error (prior 0) are in BOUNDS.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import sampling_design as sd
from sampling_design.validation.scenario import SimulatedRecord

HERE = Path(__file__).parent
PLANTS = HERE.parent / "plants"

BOUNDS = {
    "oscillator": {"w_bound": [0.01, 0.01], "v_bound": [0.05]},
    "satellite": {"w_bound": [4e-6] * 3, "v_bound": [10.0] * 3},
    "three_compartment": {"w_bound": [0.05, 0.05, 0.05], "v_bound": [0.1]},
}


def irregular(period: float, count: int, jitter: float, lost: tuple[int, ...], rng: np.random.Generator) -> sd.Schedule:
    """Return nearly regular times: each late or early by at most `jitter`, to a tenth; some never come."""
    times = period * np.arange(count) + rng.uniform(0, jitter, size=count).round(1)
    return sd.Schedule(np.delete(times, lost))


def oscillator() -> SimulatedRecord:
    """Return four periods of the designed schedule, every sample up to 0.1 s late, two of them lost; no force."""
    rng = np.random.default_rng(20260107)
    plant = sd.read_plant(PLANTS / "oscillator.toml")
    requirement = sd.read_requirement(PLANTS.parent / "requirements" / "oscillator.toml")
    planned = sd.design_schedule(plant, requirement).schedule
    assert planned is not None
    end = planned.first + 4 * planned.period
    times = planned.between(0.0, end).times
    times = np.delete((times + rng.uniform(0, 0.1, times.size)).round(2), (6, 13))
    force = [(0.0, [0.0])]
    return sd.simulate_record(
        plant, sd.Schedule(times), end + 1, x0=[1.0, -0.5], inputs=force, rng=rng, **BOUNDS["oscillator"]
    )


def satellite() -> SimulatedRecord:
    """Return two orbits of position fixes, three of them lost; a short thrust after the first orbit."""
    rng = np.random.default_rng(20260105)
    plant = sd.read_plant(PLANTS / "satellite.toml")
    schedule = irregular(5554.0 / 12, 25, 120.0, (5, 6, 17), rng)
    thrust = [(0.0, [0.0, 0.0, 0.0]), (5600.0, [0.0, 2e-4, 0.0]), (5900.0, [0.0, 0.0, 0.0])]
    start = [80.0, -60.0, 50.0, 0.05, -0.08, 0.06]
    return sd.simulate_record(plant, schedule, 11_500.0, x0=start, inputs=thrust, rng=rng, **BOUNDS["satellite"])


def three_compartment() -> SimulatedRecord:
    """Return a day of blood samples, about one an hour, two of them lost; the infusion is changed four times."""
    rng = np.random.default_rng(20260106)
    plant = sd.read_plant(PLANTS / "three_compartment.toml")
    schedule = irregular(60.0, 24, 20.0, (9, 10), rng)
    infusion = [(0.0, [20.0]), (15.0, [9.0]), (240.0, [6.0]), (720.0, [0.0]), (900.0, [5.0])]
    return sd.simulate_record(
        plant, schedule, 1440.0, x0=[20.0, 30.0, 150.0], inputs=infusion, rng=rng, **BOUNDS["three_compartment"]
    )


RECORDS = {"oscillator": oscillator, "satellite": satellite, "three_compartment": three_compartment}

if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    for name, make in RECORDS.items():
        print(sd.estimators.write_measurements(make().measurements, folder / f"{name}.csv"))
