"""When should the tide be read? A schedule, its proven sigma, and what no schedule can exceed.

A mean level, a lunar and a solar tide: five states, ten readings in fifteen days, in daylight only. A reading at noon
every day costs more and never tells the solar tide (it returns every 12 h) from the mean, however long it goes on.

Run: `python examples/02_design_with_a_proven_gap.py`
"""

import numpy as np
from scipy.linalg import block_diag

import sampling_design as sd

SOLAR, LUNAR = 12.0, 12.4206  # periods [h]
DAYS, READINGS = 15, 10
PERIOD = 24.0 * DAYS  # the two tides separate in 355 h


def tide() -> sd.Plant:
    """Return the level at a gauge: a constant and two undamped oscillations."""
    turns = [np.array([[0.0, 1.0], [-1.0, 0.0]]) * 2 * np.pi / period for period in (SOLAR, LUNAR)]
    return sd.Plant(block_diag(np.zeros((1, 1)), *turns), [[1.0, 1.0, 0.0, 1.0, 0.0]], time_unit="h", name="tide")


def daylight(samples: int) -> sd.Requirement:
    """Return the requirement: readings from 7 to 19 o'clock, at least four hours apart."""
    nights = [[0.0, 7.0], *([24.0 * day + 19.0, 24.0 * day + 31.0] for day in range(DAYS - 1)), [PERIOD - 5.0, PERIOD]]
    return sd.Requirement(window=PERIOD, period=PERIOD, spacing=4.0, samples=samples, forbidden=nights)


def random_schedules(number: int, samples: int, rng: np.random.Generator) -> list[sd.PeriodicSchedule]:
    """Return admissible schedules: readings on different days, each at a random hour of daylight."""
    days = [24.0 * np.sort(rng.choice(DAYS, samples, replace=False)) for _ in range(number)]
    draws = [day + rng.uniform(7.0, 19.0, samples) for day in days]
    return [sd.PeriodicSchedule.from_times(times, PERIOD, time_unit="h") for times in draws]


def main() -> None:
    """Design ten readings in fifteen days and compare them with noon and with chance."""
    plant = tide()
    design = sd.design_schedule(plant, daylight(READINGS))
    print(design.explain())
    print("hours of the day:", np.round(design.schedule.times % 24, 1))

    noon = sd.window_sigma(plant, sd.PeriodicSchedule([24.0], 12.0, time_unit="h"), PERIOD)
    print(f"Every day at noon, fifteen readings: sigma {noon.upper:.1e}.")
    rng = np.random.default_rng(0)
    drawn = [sd.window_sigma(plant, s, PERIOD).upper for s in random_schedules(50, READINGS, rng)]
    print(f"Fifty draws of days and hours: the best has sigma {max(drawn):.3f}, the median {np.median(drawn):.3f}.")

    assert design.sigma <= design.upper_bound
    assert design.gap < 0.01
    assert noon.upper < 1e-9
    assert design.sigma > max(drawn)
    assert design.verify()


if __name__ == "__main__":
    main()
