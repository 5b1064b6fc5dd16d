"""Commands that prove what a schedule, or every schedule of a family, promises, and that check a proof."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table as RichTable

import sampling_design as sd
from sampling_design.certificates.certification import within_tolerance
from sampling_design.certificates.compare.four_horizons import FourHorizons
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.checkers.strict import Tree
from sampling_design.cli import files
from sampling_design.cli.plan import PlantFile, schedule_for
from sampling_design.cli.settings import Settings, numbers, record_table, table, timing, timing_number
from sampling_design.errors import ArgumentError
from sampling_design.records.budget import Budget
from sampling_design.records.checks import positive
from sampling_design.records.file_io import write_text
from sampling_design.schedules.family import AnySchedule, SamplingFamily

LEAST_LEFT = 1e-3
"""Seconds that the comparison of horizons is given where the certificate has taken all of them: its row says so."""

OPTIONS = {
    "gap-range": {"shortest": " A", "longest": " B"},
    "spaced": {"window": " T", "count": " K", "spacing": " E"},
    "timing-tolerance": {"timing_tolerance": ""},
    "lost": {"most": " D", "of": " W"},
}
"""Names of a family's arguments, and where they stand behind its option."""

ScheduleFile = Annotated[
    Path | None,
    typer.Argument(metavar="SCHEDULE", help="Schedule file; none with --gap-range, --spaced, --detectability."),
]
Eta = Annotated[float | None, typer.Option(help="Discount rate of the squared error; default: searched.")]
NoiseGain = Annotated[
    float | None,
    typer.Option(help="Noise gains, where chosen: at most so many times their least; default 3 (--detectability: 10)."),
]
Gaps = Annotated[
    tuple[float, float] | None, typer.Option(metavar="A B", help="Every schedule with gaps between A and B.")
]
Spaced = Annotated[
    tuple[float, int, float] | None,
    typer.Option(metavar="T K E", help="Every schedule with K samples in each window T, E apart."),
]
Jittered = Annotated[
    str | None,
    typer.Option(
        metavar="TIME", help="SCHEDULE with every sample up to this early or late, EARLY:LATE, or NAME=either,..."
    ),
]
Lost = Annotated[
    tuple[int, int] | None, typer.Option(metavar="D W", help="SCHEDULE with at most D of any W samples lost.")
]
Detectability = Annotated[bool, typer.Option("--detectability", help="The plant alone, no samples: Theorem 10.")]
Horizons = Annotated[
    bool,
    typer.Option("--horizons", help="Set four horizons of SCHEDULE side by side, too."),
]
NewFile = Annotated[
    Path | None, typer.Option("--certificate", metavar="FILE", help="Where to write the certificate (.json).")
]

Numbers = "One number bounds the norm; numbers with commas between bound each entry. Default: the plant's scales."


@dataclass(frozen=True)
class BoundOptions:
    """The three bounds, as they are typed."""

    w_bound: Annotated[
        str | None, typer.Option("--w-bound", "--w", help=f"Bound on the disturbance w(t). {Numbers}")
    ] = None
    v_bound: Annotated[
        str | None, typer.Option("--v-bound", "--v", help=f"Bound on the measurement noise v. {Numbers}")
    ] = None
    initial_error: Annotated[str | None, typer.Option(help=f"Bound on the prior's error. {Numbers}")] = None

    def of(self, plant: sd.Plant) -> ErrorBoundArguments:
        """The bounds as verbs take them."""
        return ErrorBoundArguments(
            w_bound=numbers("--w-bound", self.w_bound, plant.disturbances.names),
            v_bound=numbers("--v-bound", self.v_bound, plant.outputs.names),
            initial_error=numbers("--initial-error", self.initial_error, plant.states.names),
        )


UNBOUNDED = BoundOptions()


def certify(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile = None,
    eta: Eta = None,
    noise_gain: NoiseGain = None,
    gap_range: Gaps = None,
    spaced: Spaced = None,
    timing_tolerance: Jittered = None,
    lost: Lost = None,
    detectability: Detectability = False,
    certificate_file: NewFile = None,
    horizons: Horizons = False,
    typed: BoundOptions = UNBOUNDED,
) -> None:
    """Prove sample-based exponential i-iIOSS on a schedule, or on every schedule of a family.

    With -o DIR: certificate.json and .png (family.png for a family, horizons.png with --horizons), constants.md and
    constants.tex. With bounds the weights follow from them, for narrow radii; without, the horizon is short. With
    --detectability: exponential i-iIOSS of the plant, measured all the time; one file.

    Example: sampling-design certify examples/plants/oscillator.toml out/schedule.csv --eta 0.3 -o out
    """
    plant = settings.part(files.plant(plant_file))
    given = {"gap-range": gap_range, "spaced": spaced, "timing-tolerance": timing_tolerance, "lost": lost}
    families: dict[str, object] = {k: v for k, v in given.items() if v is not None}
    if horizons and (families or schedule_file is None):
        raise ArgumentError("`--horizons` compares those of one SCHEDULE: it goes without a family or --detectability.")
    bounds = typed.of(plant)
    if detectability:
        _refuse_samples(schedule_file, families)
        if any(bound is not None for bound in bounds.values()):
            raise ArgumentError("`--detectability` has weights of its own and goes without bounds.")
        _detectability(settings, plant, certificate_file, eta, noise_gain)
        return
    times = _times(settings, plant, schedule_file, families)
    budget = Budget(settings.budget)
    with settings.progress("certify") as progress:
        certificate = sd.certify(
            plant, times, eta=eta, budget=settings.budget, progress=progress, **bounds,
            **({} if noise_gain is None else {"noise_gain": noise_gain}),
        )  # fmt: skip
    compared = None
    if horizons:
        assert isinstance(certificate, sd.Certificate)  # of one schedule
        left = max(budget.left, LEAST_LEFT)
        compared = sd.certificates.four_horizons(plant, certificate.schedule, certificate, budget=left)
    if certificate_file is not None:
        settings.wrote(certificate.save(certificate_file))
    notes: list[RichTable | str] = [] if compared is None else [_horizons(compared)]
    notes += [] if compared is None else [f"{r.name}: {r.note}" for r in compared.rows if r.note]
    notes.append(certificate.explain())
    if (folder := settings.folder()) is not None:
        _files(settings, certificate, compared)
        made = folder / "certificate.json"
        notes.append(f"Next: sampling-design verify {made}")
        notes.append(f"Next: sampling-design estimate {plant_file} MEASUREMENTS.csv --certificate {made} -o {folder}")
    settings.show(certificate.to_dict(), record_table(certificate), *notes)


def _refuse_samples(schedule: Path | None, families: Mapping[str, object]) -> None:
    if schedule is not None or families:
        other = "a SCHEDULE file" if schedule is not None else "`--" + next(iter(families)) + "`"
        raise ArgumentError(f"`--detectability` is about the plant alone and goes without {other}.")


def _detectability(
    settings: Settings, plant: sd.Plant, path: Path | None, eta: float | None, noise_gain: float | None
) -> None:
    """Certify the plant alone, at the rate and with the noise gain that are asked for."""
    rate = None if eta is None else positive("eta", eta)
    made = partial(sd.certificates.certify_detectability, plant, rate)
    certificate = made() if noise_gain is None else made(noise_gain=positive("noise_gain", noise_gain))
    folder = settings.folder()
    for place in (path, None if folder is None else folder / "certificate.json"):
        if place is not None:
            settings.wrote(certificate.save(place))
    settings.show(certificate.to_dict(), record_table(certificate), certificate.explain())


def sampling_certificate(path: Path, plant: sd.Plant) -> SampledCertificate:
    """The certificate of a file, if it is about samples of this plant."""
    certificate = files.certificate(path, plant)
    if isinstance(certificate, sd.certificates.DetectabilityCertificate):
        raise ArgumentError(
            f"`CERTIFICATE` {path} proves that the plant is detectable, which promises nothing about samples: "
            "make one with `certify PLANT SCHEDULE`."
        )
    return certificate


def _times(settings: Settings, plant: sd.Plant, path: Path | None, families: Tree) -> AnySchedule | SamplingFamily:
    """The schedule, or the one family that the flags describe."""
    if len(families) > 1:
        raise ArgumentError(f"`--{'` and `--'.join(families)}` exclude each other: certify one family at a time.")
    kind = next(iter(families), None)
    if (path is None) == (kind in (None, "timing-tolerance", "lost")):
        need = "a SCHEDULE file" if path is None else "no SCHEDULE file"
        raise ArgumentError(
            f"`certify` needs {need} {'with --' + kind if kind else 'or a family such as --gap-range'}."
        )
    schedule = None if path is None else schedule_for(settings, plant, path)
    try:
        if kind == "gap-range":
            return sd.GapRange(*families[kind], time_unit=plant.time_unit)
        if kind == "spaced":
            return sd.SpacedWindows(*families[kind], time_unit=plant.time_unit)
        assert schedule is not None
        if kind is None:
            return schedule
        if kind == "lost":
            return sd.LostSamples(schedule, *families[kind])
        found = within_tolerance(plant, schedule, timing(families[kind], timing_number))
        assert found is not None
        return found
    except ArgumentError as error:
        raise ArgumentError(_as_typed(str(error), str(kind))) from None


def _as_typed(words: str, kind: str) -> str:
    """A refusal that names the option which the user typed, not the argument that it became."""
    for name, place in OPTIONS[kind].items():
        words = words.replace(f"`{name}`", f"`--{kind}{place}`")
    return words


def _files(settings: Settings, certificate: SampledCertificate, horizons: FourHorizons | None) -> None:
    folder = settings.folder()
    assert folder is not None
    markdown, latex = [certificate.to_markdown()], [certificate.to_latex()]
    settings.wrote(certificate.save(folder / "certificate.json"))
    if horizons is not None:
        markdown.append(horizons.to_markdown())
        latex.append(horizons.to_latex())
        settings.draw(horizons, folder / "horizons.png")
    else:
        alone = isinstance(certificate, sd.Certificate)
        settings.draw(certificate, folder / ("certificate.png" if alone else "family.png"))
    settings.wrote(write_text(folder / "constants.md", "\n".join(markdown)))
    settings.wrote(write_text(folder / "constants.tex", "\n".join(latex)))


def _horizons(horizons: FourHorizons) -> RichTable:
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
    """Check a certificate or an interval from its data alone.

    Exit code 1: it does not hold, 3: not decided in time.

    Example: sampling-design verify out/certificate.json --rigorous
    """
    plant = None if plant_file is None else files.plant(plant_file)
    if files.holds_interval(certificate_file):
        _verify_interval(settings, certificate_file, plant)
        return
    certificate = files.certificate(certificate_file, plant)
    verdict = certificate.verify(rigorous=rigorous, budget=settings.budget)
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "verdict.json", verdict.to_dict())
    settings.show(verdict.to_dict(), record_table(verdict), verdict.explain())
    if verdict.verdict == "undecided":
        raise typer.Exit(3)
    if not verdict.passed:
        raise typer.Exit(1)


def _verify_interval(settings: Settings, path: Path, plant: sd.Plant | None) -> None:
    """Prove the ends of an interval from its gains, every rounding included."""
    found, verdict = files.interval(path, plant)
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "verdict.json", verdict.to_dict())
    settings.show(verdict.to_dict(), record_table(found), f"{verdict.verdict.capitalize()}: {verdict.reason}.")
    if not verdict.passed:
        raise typer.Exit(verdict.exit_code)
