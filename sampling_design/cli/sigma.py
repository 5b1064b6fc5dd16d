"""Commands that prove how observable a plant is: along a schedule, and over every schedule of a family."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.cli import files
from sampling_design.cli.options import PlantFile, RelativeWidth, ScheduleFile, TimingOption, Window, timing
from sampling_design.cli.settings import Settings
from sampling_design.observability.count.zero_count import default_window
from sampling_design.plants.functional import split_needed, weighed_over
from sampling_design.plants.modes import ModalSplit
from sampling_design.records.checks import positive
from sampling_design.records.record import short

if TYPE_CHECKING:
    from sampling_design.observability.windows.window_record import WindowSigma
    from sampling_design.observability.worst_case.worst_case_sigma import WorstCaseSigma
    from sampling_design.schedules.family import AnySchedule

RigorousBound = Annotated[bool, typer.Option("--rigorous", help="Prove the lower bound in ball arithmetic.")]


def sigma(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile = None,
    window: Window = None,
    rigorous: RigorousBound = False,
    timing_tolerance: TimingOption = None,
) -> None:
    """Prove how observable a plant is along a schedule: the least sigma over every real window position.

    Example: sampling-design sigma examples/plants/oscillator.toml out/schedule.csv --window 6.28
    """
    plant = settings.part(files.plant(plant_file))
    schedule = files.schedule_for(settings, plant, files.schedule_path(plant_file, schedule_file))
    split = split_needed(plant, settings.decay_rate or 0.0)
    if not split.retained.n_states:
        settings.finish_early({"sigma": None, "split": split.to_dict()}, "sigma", split.explain())
        return
    length = window_length(settings, split, window, schedule)
    split = weighed_over(split, length)
    with settings.progress("sigma") as progress:
        result = sd.window_sigma(
            split.retained, schedule, length, budget=settings.budget, progress=progress, rigorous=rigorous,
            timing_tolerance=timing(timing_tolerance),
        )  # fmt: skip
    _end_bracket(settings, result, split, "sigma")


def worst_case(
    settings: Settings,
    plant_file: PlantFile,
    window: Annotated[float, typer.Option(help="Window length [time unit].")],
    count: Annotated[int, typer.Option(help="At least so many samples in every window.")],
    spacing: Annotated[float, typer.Option(help="Least time between two samples [time unit].")],
    rtol: RelativeWidth = 0.01,
    rigorous: RigorousBound = False,
    timing_tolerance: TimingOption = None,
) -> None:
    """Bracket the least sigma over every schedule with COUNT samples, SPACING apart, in each WINDOW.

    Example: sampling-design worst-case examples/plants/oscillator.toml --window 4 --count 3 --spacing 0.5
    """
    split = split_needed(settings.part(files.plant(plant_file)), settings.decay_rate or 0.0)
    split = weighed_over(split, positive("window", window))
    if not split.retained.n_states:
        words = "No samples needed: every mode decays. Ask for more with --decay-rate."
        settings.finish_early({"lower": None}, "worst_case", words)
        return
    family = sd.SpacedWindows(window, count, spacing)
    with settings.progress("worst case") as progress:
        result = sd.worst_case_sigma(
            split.retained, family, rtol, budget=settings.budget, progress=progress, rigorous=rigorous,
            timing_tolerance=timing(timing_tolerance),
        )  # fmt: skip
    _end_bracket(settings, result, split, "worst_case")


def window_length(
    settings: Settings, split: ModalSplit, given: float | None, schedule: AnySchedule | None = None
) -> float:
    """Return the window that was given, or the plant's default with a notice that says so.

    Of a `schedule` it is no shorter than one longest gap for each state: else most windows would hold too few samples.
    """
    if given is not None:
        return positive("window", given)
    length = default_window(split) or 1.0
    if schedule is not None:
        longest = schedule.d_max if schedule.endless else float(np.max(schedule.gaps, initial=0.0))  # from its first on
        length = max(length, split.retained.n_states * longest)
    settings.notice(f"--window not given: {short(length)} {split.plant.time_unit} is used.")
    return length


def _end_bracket(settings: Settings, found: WindowSigma | WorstCaseSigma, split: ModalSplit, name: str) -> None:
    """Write and show a bracket; leave with 3 where it did not close and with 1 where sigma is proven to be nothing."""
    from sampling_design.observability.sigma_bracket import coordinates_of

    result = replace(found, coordinates=coordinates_of(split.plant, split.retained))
    settings.draw(result, name)
    settings.finish(result, result.to_dict(), name)
    proven = result.status == "timing" and result.lower > 0  # for all real times, if not as near as can be
    if not (result.closed or proven):
        raise typer.Exit(3)
    if result.lower == 0:
        raise typer.Exit(1)
