"""Ready-made benches for lectures."""

from __future__ import annotations

import numpy as np

from sampling_design.design.problem.requirement import Requirement
from sampling_design.explorer.schedule_explorer import ScheduleExplorer
from sampling_design.planning.requirement import AccuracyGoal, PlanRequirement
from sampling_design.plants.library import oscillator
from sampling_design.plants.plant import Plant, Signals
from sampling_design.records import checks
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.schedules.sensor import Sensor


def _pathological() -> ScheduleExplorer:
    turn = float(2 * np.pi)
    return ScheduleExplorer(
        oscillator(),
        Requirement(window=turn, period=turn),
        PeriodicSchedule.from_times([1.0, 1.0 + np.pi], turn, time_unit="s"),
        w_bound=0.02,
        v_bound=0.1,
        words="Two samples half a period apart measure the same direction. Move one of them, a little and then a lot.",
    )


def _even() -> ScheduleExplorer:
    rates = [1.0, 2.5]
    A = np.zeros((4, 4))
    for k, rate in enumerate(rates):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, rate], [-rate, 0.0]]
    plant = Plant(A, [[1.0, 0.0, 1.0, 0.0]], time_unit="s", outputs=["sum"], name="two tones")
    return ScheduleExplorer(
        plant,
        Requirement(window=8.0, period=8.0, samples=6, spacing=0.2),
        PeriodicSchedule(np.full(6, 8.0 / 6), time_unit="s"),
        words="Six samples, evenly spaced. Can you do better by hand? Then press Design.",
    )


def _laboratory() -> ScheduleExplorer:
    day = 2 * np.pi / 24
    plant = Plant(
        [[0.0, day, 0.0], [-day, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[1.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
        time_unit="h",
        states=Signals(["rhythm", "quadrature", "level"], ["nmol/l"] * 3),
        outputs=Signals(["nurse", "laboratory"], ["nmol/l"] * 2),
        name="hormone with a daily rhythm",
    )
    open_hours = {"nurse": Sensor(available=[[7.0, 22.0]]), "laboratory": Sensor(5.0, available=[[9.0, 16.0]])}
    mask = [[True, False], [True, True], [True, False]]
    return ScheduleExplorer(
        plant,
        Requirement(window=24.0, period=24.0, sensors=open_hours),
        PeriodicSchedule.from_times(
            [8.0, 11.0, 20.0], 24.0, outputs=mask, output_names=("nurse", "laboratory"), time_unit="h"
        ),
        w_bound=0.01,
        v_bound=0.1,
        tolerance=[0.5, 0.5, 0.25],
        words="Two sensors with opening hours. Which sample is worth most for the level, and which for the rhythm?",
    )


def _set() -> ScheduleExplorer:
    return ScheduleExplorer(
        oscillator(),
        Requirement(window=4.5, period=4.5),
        PeriodicSchedule.from_times([0.4, 1.0, 1.6, 3.0], 4.5, time_unit="s"),
        w_bound=0.02,
        v_bound=0.1,
        projection=("position", "velocity"),
        initial_error=1.5,
        words="Each sample cuts the set of what is possible. Which cuts most? Move one next to another, then away.",
    )


def _plan() -> ScheduleExplorer:
    wanted = PlanRequirement(
        {"position": AccuracyGoal(0.35)},
        period=6.4,
        grid=0.4,
        w_bound=0.02,
        sensors={"position": Sensor(noise_bound=0.2)},
    )
    return ScheduleExplorer(
        oscillator(),
        wanted,
        PeriodicSchedule.from_times([0.4, 1.2, 2.0], 6.4, time_unit="s"),
        words="The position must be known within 0.35, always. Can three samples keep that? Then press Plan.",
    )


SCENES = {"pathological": _pathological, "even": _even, "laboratory": _laboratory, "set": _set, "plan": _plan}
"""Each scene by its name: pathological sampling, design against even spacing, two sensors with opening hours, the exact
set shrinking sample by sample, the cheapest plan that keeps a tolerance."""


@checked
def scene(name: str) -> ScheduleExplorer:
    """Return the explorer of a ready-made scene.

    Parameters
    ----------
    name : str
        One of `SCENES`.

    Returns
    -------
    ScheduleExplorer

    Raises
    ------
    ArgumentError
        If there is no such scene.
    """
    return SCENES[checks.word("name", name, SCENES)]()
