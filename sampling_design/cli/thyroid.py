"""The command of the paper's example: thyroid."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from sampling_design.cli.settings import Settings, record_table
from sampling_design.records.file_io import write_text

NoiseInterpretation = StrEnum("NoiseInterpretation", ["per_second", "per_day", "per_day_slow"])
"""How the paper's w is read."""


def thyroid(
    settings: Settings,
    runs: Annotated[int, typer.Option(help="Noise realisations per interpretation of w.")] = 1,
    reading: Annotated[
        list[NoiseInterpretation] | None,
        typer.Option(help="How w is read; may be repeated. Default: per_second and per_day."),
    ] = None,
    days: Annotated[float, typer.Option(help="Length of a run [d].")] = 20.0,
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
            runs, cases=cases, days=days, seed=settings.seed, degree=degree, path=path, workers=workers,
            progress=progress,
        )  # fmt: skip
    if folder is not None and path is not None:
        settings.wrote(path)
        settings.write_json(report.to_dict(), "thyroid")
        page = report.to_markdown()
        if not settings.no_picture:
            run = experiment.patient_run(cases[0], 0, days=days, seed=settings.seed, degree=degree)
            page += f"\nFigures 1 to 3 of the paper, from run 0 ({cases[0]}):\n"
            (folder / "figures").mkdir(exist_ok=True)
            for figure in (run.figure(1), run.figure(2), run.figure(3)):
                name = f"figures/thyroid_figure{figure.number}"
                settings.draw(figure, name)
                page += f"\n![{figure.explain()}]({name}.png)\n"
        settings.wrote(write_text(folder / "thyroid.md", page))
    open_points = "Not said in the paper, and what is done instead:\n" + "\n".join(
        f"  {point}: {choice}" for point, choice in report.open_points
    )
    settings.show(report.to_dict(), record_table(report), report.explain(), open_points)
