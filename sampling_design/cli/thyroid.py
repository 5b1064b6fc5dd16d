"""The command of the paper's example: thyroid."""

from __future__ import annotations

from typing import Annotated

import typer

from sampling_design.cli.settings import Settings, record_table
from sampling_design.records import checks
from sampling_design.records.file_io import write_text


def thyroid(
    settings: Settings,
    runs: Annotated[int, typer.Option(help="Noise realisations per interpretation of w.")] = 1,
    reading: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CASE",
            help="How w is read: per_second, per_day or per_day_slow; repeat it for more. Default: the first two.",
        ),
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

    cases = [checks.word("reading", each, experiment.CASES) for each in reading or ()] or ["per_second", "per_day"]
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
