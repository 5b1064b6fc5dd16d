"""Commands that prove what a schedule, or every schedule of a family, promises, and that check a proof."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import sampling_design as sd
from sampling_design._files import to_json, write_text
from sampling_design.cli.plan import PlantFile, schedule_for
from sampling_design.cli.settings import Settings, record_table, save_picture, table
from sampling_design.errors import ArgumentError


def certify(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: Annotated[
        Path | None, typer.Argument(metavar="[SCHEDULE]", help="Schedule file; not needed for --gap-range, --spaced.")
    ] = None,
    eta: Annotated[float | None, typer.Option(help="Discount rate of the squared error; default: searched.")] = None,
    noise_budget: Annotated[
        float, typer.Option(help="How many times its least the noise gain may be, when weights are chosen.")
    ] = 3.0,
    gap_range: Annotated[
        tuple[float, float] | None, typer.Option(metavar="A B", help="Every schedule with gaps between A and B.")
    ] = None,
    spaced: Annotated[
        tuple[float, int, float] | None,
        typer.Option(metavar="T K E", help="Every schedule with K samples in each window T, E apart."),
    ] = None,
    jitter: Annotated[float | None, typer.Option(help="SCHEDULE with every sample up to this early or late.")] = None,
    lost: Annotated[
        tuple[int, int] | None, typer.Option(metavar="D W", help="SCHEDULE with at most D of any W samples lost.")
    ] = None,
    certificate_file: Annotated[
        Path | None, typer.Option("--certificate", metavar="FILE", help="Where to write the certificate (.json).")
    ] = None,
) -> None:
    """Prove sample-based exponential i-iIOSS on a schedule, or on every schedule of a family.

    With -o DIR: certificate.json, constants.md, constants.tex and horizons.png (family.png for a family).

    Example: sampling-design certify examples/plants/oscillator.toml --gap-range 0.5 1.5 -o out
    """
    plant = sd.read_plant(plant_file)
    given = {"gap-range": gap_range, "spaced": spaced, "jitter": jitter, "lost": lost}
    times = _times(settings, plant, schedule_file, {k: v for k, v in given.items() if v is not None})
    with settings.progress("certify") as progress:
        certificate = sd.certify(plant, times, eta=eta, budget=noise_budget, progress=progress)
    single = isinstance(times, (sd.Schedule, sd.PeriodicSchedule))
    horizons = sd.four_horizons(plant, times, certificate) if single else None
    if certificate_file is not None:
        settings.wrote(certificate.save(certificate_file))
    if settings.folder() is not None:
        _files(settings, certificate, horizons)
    notes = [] if horizons is None else [_horizons(horizons), *(f"{r.name}: {r.note}" for r in horizons.rows if r.note)]
    settings.show(certificate.to_dict(), record_table(certificate), *notes, certificate.explain())


def _times(settings: Settings, plant: Any, path: Path | None, families: dict[str, Any]) -> Any:
    """The schedule, or the one family that the flags describe."""
    if len(families) > 1:
        raise ArgumentError(f"`--{'` and `--'.join(families)}` exclude each other: certify one family at a time.")
    kind = next(iter(families), None)
    if (path is None) == (kind in (None, "jitter", "lost")):
        need = "a SCHEDULE file" if path is None else "no SCHEDULE file"
        raise ArgumentError(
            f"`certify` needs {need} {'with --' + kind if kind else 'or a family such as --gap-range'}."
        )
    value: Any = families.get(kind or "")
    if kind == "gap-range":
        return sd.GapRange(*value, time_unit=plant.time_unit)
    if kind == "spaced":
        return sd.SpacedWindows(*value, time_unit=plant.time_unit)
    assert path is not None
    schedule = schedule_for(settings, plant, path)
    if kind is None:
        return schedule
    return sd.Jitter(schedule, value) if kind == "jitter" else sd.LostSamples(schedule, *value)


def _files(settings: Settings, certificate: Any, horizons: Any) -> None:
    folder = settings.folder()
    assert folder is not None
    markdown, latex = [certificate.to_markdown()], [certificate.to_latex()]
    settings.wrote(certificate.save(folder / "certificate.json"))
    if horizons is not None:
        markdown.append(horizons.to_markdown())
        latex.append(horizons.to_latex())
        settings.wrote(save_picture(horizons, folder / "horizons.png"))
    else:
        settings.wrote(save_picture(certificate, folder / "family.png"))
    settings.wrote(write_text(folder / "constants.md", "\n".join(markdown)))
    settings.wrote(write_text(folder / "constants.tex", "\n".join(latex)))


def _horizons(horizons: Any) -> Any:
    unit = horizons.certificate.plant.time_unit
    heads = ["horizon", "source", f"M > [{unit}]", "C_x", "C_w", "C_v"]
    return table("Four horizons", heads, horizons.cells())


def verify(
    settings: Settings,
    certificate_file: Annotated[Path, typer.Argument(metavar="CERTIFICATE", help="Certificate file (.json).")],
    plant_file: Annotated[
        Path | None, typer.Option("--plant", metavar="PLANT", help="Also check that it is about this plant.")
    ] = None,
    rigorous: Annotated[
        bool, typer.Option("--rigorous", help="Decide in ball arithmetic: a theorem about the stated numbers.")
    ] = False,
) -> None:
    """Check a certificate from its data alone; exit code 1 if it does not hold, 3 if that cannot be decided in time.

    Example: sampling-design verify out/certificate.json --rigorous
    """
    plant = None if plant_file is None else sd.read_plant(plant_file)
    certificate = sd.load_certificate(certificate_file, plant)
    verdict = certificate.verify(rigorous=rigorous, budget=settings.budget)
    folder = settings.folder()
    if folder is not None:
        settings.wrote(write_text(folder / "verdict.json", to_json(verdict.to_dict())))
    settings.show(verdict.to_dict(), record_table(verdict), verdict.explain())
    if getattr(verdict, "verdict", "") == "undecided":
        raise typer.Exit(3)
    if not verdict.passed:
        raise typer.Exit(1)


COMMANDS = (certify, verify)
