"""Commands that prove what a schedule, or every schedule of a family, promises, check it, and say what it survives."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table as RichTable

import sampling_design as sd
from sampling_design.certificates.certification import within_tolerance
from sampling_design.certificates.compare.four_horizons import FourHorizons
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.checkers.strict import Tree
from sampling_design.cli import files, options
from sampling_design.cli.estimate import known_bounds
from sampling_design.cli.settings import Settings, record_table, table
from sampling_design.errors import ArgumentError
from sampling_design.planning.plan_record import Plan
from sampling_design.records.budget import Budget
from sampling_design.records.checks import positive
from sampling_design.records.file_io import write_text
from sampling_design.schedules.family import AnySchedule, SamplingFamily

LEAST_LEFT = 1e-3
"""Seconds that the comparison of horizons is given where the certificate has taken all of them: its row says so."""

OR_A_FAMILY = ", or a family such as --gap-range"

OPTIONS = {
    "gap-range": {"shortest": " A", "longest": " B"},
    "spaced": {"window": " T", "count": " K", "spacing": " E"},
    "timing-tolerance": {"timing_tolerance": ""},
    "lost": {"most": " D", "of": " W"},
}
"""Names of a family's arguments, and where they stand behind its option."""

ScheduleFile = Annotated[
    Path | None,
    typer.Argument(
        metavar="SCHEDULE",
        help="Schedule file; none where PLANT is a plan, or with --gap-range, --spaced, --detectability.",
    ),
]
Eta = Annotated[float | None, typer.Option(help="Discount rate of the squared error [1/time unit]; default: searched.")]
NoiseGain = Annotated[
    float | None,
    typer.Option(help="Noise gains, where chosen: at most so many times their least; default 3 (--detectability: 10)."),
]
Gaps = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="A B", help="Every schedule with gaps between A and B [time unit]: --gap-range 0.8 1.2."),
]
Spaced = Annotated[
    tuple[float, int, float] | None,
    typer.Option(
        metavar="T K E", help="Every schedule with K samples in each window T, E apart [time unit]: --spaced 5 4 .5."
    ),
]
Jittered = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="SCHEDULE with every sample up to this early or late [time unit], EARLY:LATE, or NAME=either,...",
    ),
]
Lost = Annotated[
    tuple[int, int] | None,
    typer.Option(metavar="D W", help="SCHEDULE with at most D of any W samples lost: --lost 1 4."),
]
Detectability = Annotated[bool, typer.Option("--detectability", help="The plant alone, no samples: Theorem 10.")]
Horizons = Annotated[bool, typer.Option("--horizons", help="Set four horizons of SCHEDULE side by side, too.")]
NewFile = Annotated[
    Path | None, typer.Option("--certificate", metavar="FILE", help="Where to write the certificate (.json).")
]


def certify(
    settings: Settings,
    plant_file: options.PlantFile,
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
    typed: options.BoundOptions = options.UNBOUNDED,
) -> None:
    """Prove sample-based exponential i-iIOSS on a schedule, or on every schedule of a family.

    With -o DIR: certificate.json and .png (family.png for a family, horizons.png with --horizons), constants.md and
    constants.tex. With bounds the weights follow from them, for narrow radii; without, the horizon is short. A plan
    (plan.json) for PLANT or SCHEDULE brings its bounds, and the samples of its sensors at their times. With
    --detectability: exponential i-iIOSS of the plant, measured all the time; one file.

    Example: sampling-design certify examples/plants/oscillator.toml out/schedule.csv --eta 0.3 -o out
    """
    plant = settings.part(full := files.plant(plant_file))
    given = {"gap-range": gap_range, "spaced": spaced, "timing-tolerance": timing_tolerance, "lost": lost}
    families: dict[str, object] = {k: v for k, v in given.items() if v is not None}
    if horizons and (families or detectability):
        raise ArgumentError("`--horizons` compares those of one SCHEDULE: it goes without a family or --detectability.")
    bounds = typed.of(plant)
    if detectability:
        if schedule_file is not None or families:
            other = "a SCHEDULE file" if schedule_file is not None else f"`--{next(iter(families))}`"
            raise ArgumentError(f"`--detectability` is about the plant alone and goes without {other}.")
        if any(bound is not None for bound in bounds.values()):
            raise ArgumentError("`--detectability` has weights of its own and goes without bounds.")
        _detectability(settings, plant, certificate_file, eta, noise_gain)
        return
    if not families.keys() & {"gap-range", "spaced"}:
        schedule_file = files.schedule_path(plant_file, schedule_file, "" if families else OR_A_FAMILY)
    times, planned = _times(settings, plant, schedule_file, families), files.plan_in(schedule_file)
    bounds = known_bounds(settings, plant, full, bounds, planned)
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
    notes: list[RichTable | str] = []
    if compared is not None:
        heads = ["horizon", "source", f"M > [{plant.time_unit}]", "C_x", "C_w", "C_v"]
        notes = [table("Four horizons", heads, compared.cells())]
        notes += [f"{r.name}: {r.note}" for r in compared.rows if r.note]
    notes.append(certificate.explain())
    if planned is not None and not families:
        notes.append(_about_the_plan(planned))
    if (folder := settings.folder()) is not None:
        _write(settings, folder, certificate, compared)
        file, made, there = map(options.shell_word, (plant_file, folder / "certificate.json", folder))
        asked = f"{file} MEASUREMENTS.csv --certificate {made} -o {there}"
        notes += [f"Next: sampling-design verify {made}", f"Next: sampling-design estimate {asked}"]
    settings.show(certificate.to_dict(), record_table(certificate), *notes)


def _about_the_plan(planned: Plan) -> str:
    late = planned.problem.timing_tolerance
    own = f" (the plan lets them be {late.describe(planned.plant.time_unit)})" if late else ""
    more = "none lost: --timing-tolerance and --lost allow for more."
    return f"It is about the plan's samples at their times{own}, {more}"


def _detectability(
    settings: Settings, plant: sd.Plant, path: Path | None, eta: float | None, noise_gain: float | None
) -> None:
    """Certify the plant alone, at the rate and with the noise gain that are asked for."""
    rate = None if eta is None else positive("eta", eta)
    made = partial(sd.certificates.certify_detectability, plant, rate)
    certificate = made() if noise_gain is None else made(noise_gain=positive("noise_gain", noise_gain))
    folder = settings.folder()
    places = [path, None if folder is None else folder / "certificate.json"]
    settings.wrote(*(certificate.save(place) for place in places if place is not None))
    settings.show(certificate.to_dict(), record_table(certificate), certificate.explain())


def _times(settings: Settings, plant: sd.Plant, path: Path | None, families: Tree) -> AnySchedule | SamplingFamily:
    """The schedule, or the one family that the flags describe."""
    if len(families) > 1:
        raise ArgumentError(f"`--{'` and `--'.join(families)}` exclude each other: certify one family at a time.")
    kind = next(iter(families), None)
    if path is not None and kind in ("gap-range", "spaced"):
        raise ArgumentError(f"`certify` needs no SCHEDULE file with --{kind}.")
    schedule = None if path is None else files.schedule_for(settings, plant, path)
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
        found = within_tolerance(plant, schedule, options.timing(families[kind]))
        assert found is not None
        return found
    except ArgumentError as error:
        raise ArgumentError(_as_typed(str(error), str(kind))) from None


def _as_typed(words: str, kind: str) -> str:
    """A refusal that names the option which the user typed, not the argument that it became."""
    for name, place in OPTIONS[kind].items():
        words = words.replace(f"`{name}`", f"`--{kind}{place}`")
    return words


def _write(settings: Settings, folder: Path, certificate: SampledCertificate, compared: FourHorizons | None) -> None:
    settings.wrote(certificate.save(folder / "certificate.json"))
    if compared is not None:
        settings.draw(compared, "horizons")
    else:
        settings.draw(certificate, "certificate" if isinstance(certificate, sd.Certificate) else "family")
    beside = [] if compared is None else [compared]
    text = "\n".join([certificate.to_markdown(), *(each.to_markdown() for each in beside)])
    settings.wrote(write_text(folder / "constants.md", text))
    text = "\n".join([certificate.to_latex(), *(each.to_latex() for each in beside)])
    settings.wrote(write_text(folder / "constants.tex", text))


def verify(
    settings: Settings,
    certificate_file: options.CertificateArgument,
    plant_file: Annotated[
        Path | None, typer.Option("--plant", metavar="PLANT", help="Also check that it is about this plant.")
    ] = None,
    rigorous: options.Rigorous = False,
) -> None:
    """Check a certificate or an interval from its data alone.

    Exit code 1: it does not hold, 3: not decided in time.

    Example: sampling-design verify out/certificate.json --rigorous
    """
    plant = None if plant_file is None else files.plant(plant_file)
    if files.holds_interval(certificate_file):
        found, outcome = files.interval(certificate_file, plant)
        settings.write_json(outcome.to_dict(), "verdict")
        words = f"{outcome.verdict.capitalize()}: {outcome.reason}."
        settings.show(outcome.to_dict(), record_table(found), words)
        if not outcome.passed:
            raise typer.Exit(outcome.exit_code)
        return
    certificate = files.certificate(certificate_file, plant)
    verdict = certificate.verify(rigorous=rigorous, budget=settings.budget)
    settings.finish(verdict, verdict.to_dict(), "verdict")
    if verdict.verdict == "undecided":
        raise typer.Exit(3)
    if not verdict.passed:
        raise typer.Exit(1)


def robustness(
    settings: Settings,
    plant_file: options.PlantFile,
    certificate_file: options.CertificateArgument,
    horizon: Annotated[
        float | None, typer.Option(help="Horizon to be kept [time unit]; default: the certificate's.")
    ] = None,
    longest: Annotated[int, typer.Option(help="Losses are counted among this many samples.")] = 8,
) -> None:
    """Say how late samples may come, and how many may be lost, before a certificate no longer holds.

    Example: sampling-design robustness examples/plants/oscillator.toml out/certificate.json --budget 3 -o out
    """
    plant = settings.part(files.plant(plant_file))
    certificate = files.sampling_certificate(certificate_file, plant)
    with settings.progress("robustness") as progress:
        result = sd.robustness(
            plant, certificate, horizon=horizon, longest=longest, budget=settings.budget, progress=progress
        )
    settings.draw(result, "robustness")
    settings.finish(result, result.to_dict(), "robustness")
