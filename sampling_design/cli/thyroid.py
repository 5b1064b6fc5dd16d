"""The command of the paper's example: thyroid."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sampling_design.cli.settings import Settings, record_table
from sampling_design.records.file_io import write_text

if TYPE_CHECKING:
    from sampling_design.nonlinear.patient_run import PatientRun


class NoiseInterpretation(StrEnum):
    """How the paper's w is read."""

    per_second = "per_second"
    per_day = "per_day"
    per_day_slow = "per_day_slow"


def thyroid(
    settings: Settings,
    runs: Annotated[int, typer.Option(help="Noise realisations per interpretation of w.")] = 1,
    reading: Annotated[
        list[NoiseInterpretation] | None,
        typer.Option(help="How w is read; may be repeated. Default: per_second and per_day."),
    ] = None,
    days: Annotated[float, typer.Option(help="Length of a run.")] = 20.0,
    degree: Annotated[int, typer.Option(help="Of the polynomials of the state on pieces of 2 h.")] = 3,
    workers: Annotated[int | None, typer.Option(help="Processes; default: one per core.")] = None,
) -> None:
    """Repeat the paper's Section VI: hormone concentrations from rare blood samples, against sampling every 2 hours.

    With -o DIR every run is saved in DIR/runs.jsonl as it ends; the same command goes on where it stopped.
    DIR also gets the page thyroid.md with the paper's figures 1 to 3, and thyroid.json.

    Example: sampling-design thyroid --runs 1 --days 0.5 -o out
    """
    from sampling_design.nonlinear import experiment  # late: the other commands need none of it

    cases = ["per_second", "per_day"] if not reading else [item.value for item in reading]
    folder = settings.folder()
    path = None if folder is None else folder / "runs.jsonl"
    with settings.progress("thyroid") as progress:
        report = experiment.thyroid_experiment(
            runs,
            cases=cases,
            days=days,
            seed=settings.seed,
            degree=degree,
            path=path,
            workers=workers,
            progress=progress,
        )
    if folder is not None and path is not None:
        settings.wrote(path)
        settings.write_json(folder / "thyroid.json", report.to_dict())
        page = report.to_markdown()
        if not settings.no_picture:
            shown = experiment.patient_run(cases[0], 0, days=days, seed=settings.seed, degree=degree)
            page += _figures(settings, folder, shown, cases[0])
        settings.wrote(write_text(folder / "thyroid.md", page))
    open_points = "Not said in the paper, and what is done instead:\n" + "\n".join(
        f"  {point}: {choice}" for point, choice in report.open_points
    )
    settings.show(report.to_dict(), record_table(report), report.explain(), open_points)


def _figures(settings: Settings, folder: Path, shown: PatientRun, case: str) -> str:
    """Draw the paper's figures, and return what shows them on a page."""
    page = f"\nFigures 1 to 3 of the paper, from run 0 ({case}):\n"
    (folder / "figures").mkdir(exist_ok=True)
    for number in (1, 2, 3):
        name = f"figures/thyroid_figure{number}.png"
        settings.draw(shown.figure(number), folder / name)
        page += f"\n![{shown.figure(number).explain()}]({name})\n"
    return page
