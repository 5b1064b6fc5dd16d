"""Commands that prove what a schedule promises, and check a proof: certify, verify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import sampling_design as sd
from sampling_design._files import to_json, write_text
from sampling_design.cli.plan import PlantFile, ScheduleFile, schedule_for
from sampling_design.cli.settings import Settings, record_table, save_picture, table


def certify(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    eta: Annotated[float | None, typer.Option(help="Discount rate of the squared error; default: searched.")] = None,
    noise_budget: Annotated[
        float, typer.Option(help="How many times its least the noise gain may be, when weights are chosen.")
    ] = 3.0,
    certificate_file: Annotated[
        Path | None, typer.Option("--certificate", metavar="FILE", help="Where to write the certificate (.json).")
    ] = None,
) -> None:
    """Prove sample-based exponential i-iIOSS on a schedule; print four horizons side by side.

    With -o DIR: certificate.json, horizons.png, constants.md and constants.tex.

    Example: sampling-design certify examples/plants/satellite.toml out/schedule.csv -o out
    """
    plant = sd.read_plant(plant_file)
    schedule = schedule_for(settings, plant, schedule_file)
    with settings.progress("certify") as progress:
        certificate = sd.certify(plant, schedule, eta=eta, budget=noise_budget, progress=progress)
    horizons = sd.four_horizons(plant, schedule, certificate)
    folder = settings.folder()
    if certificate_file is not None:
        settings.wrote(certificate.save(certificate_file))
    if folder is not None:
        settings.wrote(certificate.save(folder / "certificate.json"))
        settings.wrote(save_picture(horizons, folder / "horizons.png"))
        settings.wrote(write_text(folder / "constants.md", certificate.to_markdown() + "\n" + horizons.to_markdown()))
        settings.wrote(write_text(folder / "constants.tex", certificate.to_latex() + "\n" + horizons.to_latex()))
    notes = [f"{row.name}: {row.note}" for row in horizons.rows if row.note]
    settings.show(certificate.to_dict(), record_table(certificate), _horizons(horizons), *notes, certificate.explain())


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
) -> None:
    """Check a certificate from its data alone; exit code 1 if it does not hold.

    Example: sampling-design verify out/certificate.json
    """
    plant = None if plant_file is None else sd.read_plant(plant_file)
    certificate = sd.load_certificate(certificate_file, plant)
    verdict = certificate.verify()
    folder = settings.folder()
    if folder is not None:
        settings.wrote(write_text(folder / "verdict.json", to_json(verdict.to_dict())))
    settings.show(verdict.to_dict(), record_table(verdict), verdict.explain())
    if not verdict.passed:
        raise typer.Exit(1)


COMMANDS = (certify, verify)
