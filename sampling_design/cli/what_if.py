"""Commands that ask what if: every schedule of a family, more or fewer samples, a lost sample."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import sampling_design as sd
from sampling_design.cli import files
from sampling_design.cli.plan import PlantFile
from sampling_design.cli.prove import sampling_certificate
from sampling_design.cli.settings import (
    Hands,
    Scheduler,
    Settings,
    TimingOption,
    end_bracket,
    end_unobservable,
    record_table,
    timing,
    timing_number,
    workforce,
)
from sampling_design.design.pareto import NO_NEED, NO_TIME
from sampling_design.errors import ArgumentError
from sampling_design.observability.sigma_bracket import coordinates_in
from sampling_design.plants.functional import split_needed, weighed_over
from sampling_design.records.checks import positive


def worst_case(
    settings: Settings,
    plant_file: PlantFile,
    window: Annotated[float, typer.Option(help="Window length.")],
    count: Annotated[int, typer.Option(help="At least so many samples in every window.")],
    spacing: Annotated[float, typer.Option(help="Least time between two samples.")],
    rtol: Annotated[float, typer.Option(help="Relative width of the bracket.")] = 0.01,
    rigorous: Annotated[bool, typer.Option("--rigorous", help="Prove the lower bound in ball arithmetic.")] = False,
    timing_tolerance: TimingOption = None,
) -> None:
    """Bracket the least sigma over every schedule with COUNT samples, SPACING apart, in each WINDOW.

    Example: sampling-design worst-case examples/plants/oscillator.toml --window 4 --count 3 --spacing 0.5
    """
    split = split_needed(settings.part(files.plant(plant_file)), settings.decay_rate or 0.0)
    split = weighed_over(split, positive("window", window))
    if not split.retained.n_states:
        settings.show({"lower": None}, "No samples needed: every mode decays. Ask for more with --decay-rate.")
        return
    family = sd.SpacedWindows(window, count, spacing)
    with settings.progress("worst case") as progress:
        result = sd.worst_case_sigma(
            split.retained, family, rtol, budget=settings.budget, progress=progress, rigorous=rigorous,
            timing_tolerance=timing(timing_tolerance or "0", timing_number),
        )  # fmt: skip
    end_bracket(settings, replace(result, coordinates=coordinates_in(split)), "worst_case")


def pareto(
    settings: Settings,
    plant_file: PlantFile,
    requirement_file: Annotated[
        Path | None, typer.Argument(metavar="REQUIREMENT", help="Requirement file (.toml); without it, defaults.")
    ] = None,
    counts: Annotated[str, typer.Option(help="Samples per period: 8,10,12 or 8-16.")] = "",
    workers: Hands = 1,
    scheduler: Scheduler = None,
    budget: Annotated[
        float | None,
        typer.Option(
            help="Seconds that all counts may take together; bounds then depend on how fast they are worked out. "
            "Default: none.",
            metavar="SECONDS",
        ),
    ] = None,
) -> None:
    """Design for several counts: what more samples buy. With -o DIR it can be interrupted and resumed.

    Without a budget the result is the same for any number of workers.

    Example: sampling-design pareto examples/plants/oscillator.toml --counts 2-8 -o out
    """
    plant = files.plant(plant_file)
    requirement = files.requirement(requirement_file)
    requirement = _asked(settings, requirement)
    folder = settings.folder()
    resume = None if folder is None else folder / "pareto.json"
    with settings.progress("pareto") as progress, workforce(workers, scheduler) as hands:
        front = sd.pareto_front(
            plant,
            requirement,
            _counts(counts),
            rng=np.random.default_rng(settings.seed),
            workers=hands,
            resume=resume,
            progress=progress,
            budget=None if budget is None else positive("budget", budget),
        )
    if folder is not None and resume is not None:
        settings.wrote(resume)
        settings.draw(front, folder / "pareto.png")
    settings.show(front.to_dict(), record_table(front), front.explain())
    if not front.efficient and not any(point.obstacle == NO_NEED for point in front.points):
        undecided = any(point.upper_bound > 0 or point.obstacle == NO_TIME for point in front.points)
        raise typer.Exit(3 if undecided else 1)


def losses(
    settings: Settings,
    plant_file: PlantFile,
    requirement_file: Annotated[
        Path | None, typer.Argument(metavar="REQUIREMENT", help="Requirement file (.toml); without it, defaults.")
    ] = None,
    every_period: Annotated[
        bool, typer.Option("--every-period", help="Leave the sample out of every period, not once.")
    ] = False,
) -> None:
    """Design, then say what the loss of each single sample costs: sigma without it, and what none can exceed.

    Example: sampling-design losses examples/plants/oscillator.toml examples/requirements/oscillator.toml
    """
    plant = files.plant(plant_file)
    requirement = files.requirement(requirement_file)
    requirement = _asked(settings, requirement)
    with settings.progress("losses") as progress:
        design, result = sd.design.design_and_losses(
            plant, requirement, every_period=every_period, rng=settings.seed, budget=settings.budget, progress=progress
        )
    if result is None:
        settings.show({"without": []}, design.explain())
        end_unobservable(design)
        return
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "losses.json", result.to_dict())
        settings.draw(result, folder / "losses.png")
    settings.show(result.to_dict(), record_table(result), result.explain())


def _asked(settings: Settings, requirement: sd.Requirement) -> sd.Requirement:
    """The requirement with what the flags say instead."""
    given = {"decay_rate": settings.decay_rate, "of": settings.asked_rows}
    return requirement.replace(**{key: value for key, value in given.items() if value is not None})


def _counts(text: str) -> list[int]:
    """8,10,12 or 8-16, or both mixed."""
    found: list[int] = []
    for part in filter(None, text.split(",")):
        first, dash, last = part.partition("-")
        if not first.strip().isdigit() or (dash and not last.strip().isdigit()):
            raise ArgumentError(f"`--counts` must look like 8,10,12 or 8-16, got {text!r}.")
        if last and int(last) < int(first):
            raise ArgumentError(f"`--counts` must rise from the smaller number to the larger, got {part!r}.")
        found += range(int(first), int(last or first) + 1)
    if not found:
        raise ArgumentError("`--counts` must name at least one number of samples, for example 8-16.")
    return found


def robustness(
    settings: Settings,
    plant_file: PlantFile,
    certificate_file: Annotated[Path, typer.Argument(metavar="CERTIFICATE", help="Certificate file (.json).")],
    horizon: Annotated[float | None, typer.Option(help="Horizon to be kept; default: the certificate's.")] = None,
    longest: Annotated[int, typer.Option(help="Losses are counted among this many samples.")] = 8,
) -> None:
    """Say how late samples may come, and how many may be lost, before a certificate no longer holds.

    Example: sampling-design robustness examples/plants/oscillator.toml out/certificate.json --budget 3 -o out
    """
    plant = settings.part(files.plant(plant_file))
    certificate = sampling_certificate(certificate_file, plant)
    with settings.progress("robustness") as progress:
        result = sd.robustness(
            plant, certificate, horizon=horizon, longest=longest, budget=settings.budget, progress=progress
        )
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "robustness.json", result.to_dict())
        settings.draw(result, folder / "robustness.png")
    settings.show(result.to_dict(), record_table(result), result.explain())
