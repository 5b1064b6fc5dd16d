"""Commands that meet data and chance: estimate, validate, log."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, TypedDict

import numpy as np
import numpy.typing as npt
import typer

import sampling_design as sd
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.checkers.strict import Tree
from sampling_design.cli import reading
from sampling_design.cli.following import CLOSELY, FEW, followed
from sampling_design.cli.plan import PlantFile, ScheduleFile, schedule_for, window_length
from sampling_design.cli.prove import sampling_certificate
from sampling_design.cli.settings import (
    Hands,
    Scheduler,
    Settings,
    numbers,
    record_table,
    table,
    workforce,
)
from sampling_design.errors import ArgumentError, MathematicsError, SolverError
from sampling_design.records.file_io import write_text
from sampling_design.records.progress import Progress
from sampling_design.records.record import short
from sampling_design.schedules.family import AnySchedule
from sampling_design.validation.report import ValidationReport

GAPS_IN_HORIZON = 10
"""Longest gaps in the horizon of an estimator that has no certificate."""

FAMILY_STATES = 8
"""Most states of which a certificate for all schedules with the record's gaps is sought in passing: the work grows with
their sixth power, two seconds for six, minutes for eleven."""

OWN_SAMPLES = 10_000
"""Most samples whose own times are certified in passing: some six seconds; memory and work grow with their number, and
some three times as many are more than one proof may follow."""

MeasurementFile = Annotated[Path, typer.Argument(metavar="MEASUREMENTS", help="Measurements: a .csv file.")]
Numbers = "One number bounds the norm; numbers with commas between bound each entry. Default: the plant's scales."
WBound = Annotated[str | None, typer.Option("--w-bound", "--w", help=f"Bound on the disturbance w(t). {Numbers}")]
VBound = Annotated[str | None, typer.Option("--v-bound", "--v", help=f"Bound on the measurement noise v. {Numbers}")]
InitialError = Annotated[str | None, typer.Option(help=f"Bound on the prior's error. {Numbers}")]
CertificateFile = Annotated[Path | None, typer.Option("--certificate", metavar="FILE", help="Certificate (.json).")]
Eta = Annotated[float | None, typer.Option(help="Discount rate of the squared error, where one is certified.")]


class NoiseBounds(TypedDict):
    """Bounds on the noise and on the first error, as the estimators take them."""

    w_bound: npt.ArrayLike
    v_bound: npt.ArrayLike
    initial_error: npt.ArrayLike


def estimate(
    settings: Settings,
    plant_file: PlantFile,
    measurement_file: MeasurementFile,
    certificate_file: CertificateFile = None,
    schedule_file: Annotated[
        Path | None, typer.Option("--schedule", metavar="FILE", help="Schedule that is certified first.")
    ] = None,
    prior: Annotated[str | None, typer.Option(help="State before any sample, with commas between; default 0.")] = None,
    horizon: Annotated[float | None, typer.Option(help="Length of the window; default: the certificate's.")] = None,
    w_bound: WBound = None,
    v_bound: VBound = None,
    initial_error: InitialError = None,
    eta: Eta = None,
    radii: Annotated[
        str | None,
        typer.Option(
            help="intervals: as narrow as data and bounds allow; centred: the same, and each estimate in the middle of "
            "its interval, where no other has a smaller radius; ellipsoids: wider, a hundred times faster. Default: "
            f"intervals up to {CLOSELY} rows (of more than {FEW} states: fewer), ellipsoids beyond."
        ),
    ] = None,
    tube: Annotated[
        bool,
        typer.Option(
            "--tube",
            help="With -o: prove and draw what holds each state between the samples, too; a tenth of a second a row.",
        ),
    ] = False,
) -> None:
    """Estimate the state from measurements, with a radius that holds the truth if noise keeps its bounds.

    Without certificate and schedule the gaps seen in the file are certified where that is possible. With -o DIR:
    estimates.csv, estimates.json and estimates.png; --no-picture leaves the picture out, --tube shows more in it.

    Example: sampling-design estimate examples/plants/oscillator.toml examples/data/oscillator.csv -o out
    """
    if tube and (settings.output is None or settings.no_picture):
        raise ArgumentError("`--tube` is for the picture: give a folder for it (-o DIR), and leave out --no-picture.")
    plant = reading.plant(plant_file)
    bounds = _bounds(settings, plant, w_bound, v_bound, initial_error)
    schedule = None if schedule_file is None else schedule_for(settings, plant, schedule_file)
    record = reading.measurements(settings, measurement_file, plant, None if schedule is None else schedule.origin)
    if schedule is not None:
        _check_origins(record, schedule)
    if not record.measured.any():
        raise ArgumentError(f"`MEASUREMENTS` {measurement_file} holds no measurement.")
    record = record.in_order()
    start = record.start if certificate_file is None and schedule is None else 0.0
    certificate, words = _guarantee(settings, plant, record, certificate_file, schedule, eta, bounds)
    settings.notice(words)
    first = numbers("--prior", prior, plant.states.names)
    known = None if first is None else np.atleast_1d(first)
    estimator = _estimator(settings, plant, certificate, record, start, horizon, known, bounds)
    tally = followed(settings, estimator, record, radii, words, tube)
    if tally.contradictions or tally.status["bounds disproved"]:
        raise typer.Exit(1)


def _guarantee(
    settings: Settings,
    plant: sd.Plant,
    record: sd.Measurements,
    certificate_file: Path | None,
    schedule: AnySchedule | None,
    eta: float | None,
    bounds: NoiseBounds,
) -> tuple[SampledCertificate | None, str]:
    """The certificate that the estimates rest on (None if there is none), and words for it."""
    if certificate_file is not None or schedule is not None:
        words = f"Guarantee of {certificate_file}." if certificate_file else "Guarantee for the schedule given."
        return _certified(settings, plant, schedule, certificate_file, eta, bounds), words
    with settings.progress("certificate") as progress:
        return _from_gaps(settings, plant, record, eta, bounds, progress)


def _certified(
    settings: Settings,
    plant: sd.Plant,
    schedule: AnySchedule | None,
    path: Path | None,
    eta: float | None,
    bounds: NoiseBounds,
) -> SampledCertificate:
    """The certificate of a file, else one of the schedule with weights that follow the bounds."""
    if path is not None:
        return sampling_certificate(path, plant)
    assert schedule is not None
    rate = _rate(settings, plant, eta, sd.schedules.SamplingSet(schedule).d_max)
    with settings.progress("certificate") as progress:
        return sd.certify(plant, schedule, eta=rate, progress=progress, **_weights(plant, rate, bounds))


def _rate(settings: Settings, plant: sd.Plant, eta: float | None, longest: float) -> float:
    """The rate that was asked for, else one over the longest gap, with a notice."""
    if eta is None:  # the best rate of a whole family takes minutes to find
        eta = 1 / longest
        settings.notice(f"--eta not given: {short(eta)} per {plant.time_unit}, one over the longest gap, is used.")
    return eta


def _weights(plant: sd.Plant, eta: float, bounds: NoiseBounds) -> Tree:
    """Weights that follow the bounds, for narrow radii; a bound of zero is weighed by the plant's scales."""
    w, v, start = (
        given if np.all(np.asarray(given) > 0) else signals.scales
        for given, signals in (
            (bounds["w_bound"], plant.disturbances),
            (bounds["v_bound"], plant.outputs),
            (bounds["initial_error"], plant.states),
        )
    )
    return sd.certificates.weights_from_bounds(plant, eta, w, v, start)


def _bounds(
    settings: Settings, plant: sd.Plant, w_bound: str | None, v_bound: str | None, initial_error: str | None
) -> NoiseBounds:
    """The bounds as given, else the plant's scales with a notice that says so."""
    found: dict[str, npt.ArrayLike] = {}
    for name, text, signals in (
        ("w_bound", w_bound, plant.disturbances),
        ("v_bound", v_bound, plant.outputs),
        ("initial_error", initial_error, plant.states),
    ):
        flag = "--" + name.replace("_", "-")
        given = numbers(flag, text, signals.names)
        if given is None:
            settings.notice(f"{flag} not given: the plant's scales {short(signals.scales)} are used.")
        found[name] = signals.scales if given is None else given
    return NoiseBounds(w_bound=found["w_bound"], v_bound=found["v_bound"], initial_error=found["initial_error"])


def _from_gaps(
    settings: Settings,
    plant: sd.Plant,
    record: sd.Measurements,
    eta: float | None,
    bounds: NoiseBounds,
    progress: Progress,
) -> tuple[SampledCertificate | None, str]:
    """A certificate for every schedule with the file's gaps, else for its own times, else none; and words for it.

    The time 0 of both is the start of the record.
    """
    times, taken = record.samples(numbers=True)
    times = times - record.start
    if times.size < 2:
        return None, "No guarantee: one sample is no schedule that could be certified."
    gaps = np.diff(times)
    shortest, longest = float(gaps.min()), float(gaps.max())
    seen = f"gaps from {short(shortest)} to {short(longest)} {plant.time_unit}"
    seen += " between numbers, limits and means left out" if any(record.told) else ""
    rate = _rate(settings, plant, eta, longest)
    chosen: Tree = {"eta": rate, "progress": progress, **_weights(plant, rate, bounds)}
    asked = plant.n_states <= FAMILY_STATES
    if asked and taken.all():
        family = sd.GapRange(shortest, max(longest, float(times[0])), time_unit=plant.time_unit)
        try:
            return sd.certify(plant, family, **chosen), f"Guarantee for all schedules with {seen}."
        except (MathematicsError, SolverError):
            pass  # not every schedule with these gaps can be certified: perhaps this one can
    if times.size > OWN_SAMPLES:
        words = f"No guarantee beyond the ellipsoid: the file's own {times.size} times ({seen}) are more than the "
        return None, words + f"{OWN_SAMPLES} that are certified in passing. Give a certificate or a schedule."
    try:
        own = sd.Schedule(times, taken, time_unit=plant.time_unit)
        certificate = sd.certify(plant, own, **chosen)
    except (MathematicsError, SolverError) as error:
        return None, f"No guarantee beyond the ellipsoid: {seen} cannot be certified ({str(error).rstrip('.')})."
    words = f"Guarantee for the file's own times only, certified to its last time ({seen})."
    if not asked:
        words += f" For all schedules with such gaps ask `certify --gap-range`: {plant.n_states} states take it long."
    return certificate, words


def _estimator(
    settings: Settings,
    plant: sd.Plant,
    certificate: SampledCertificate | None,
    record: sd.Measurements,
    start: float,
    horizon: float | None,
    prior: npt.ArrayLike | None,
    bounds: NoiseBounds,
) -> sd.MovingHorizonEstimator:
    if certificate is None and horizon is None:
        longest = float(np.max(np.diff(np.unique(record.times)), initial=0.0))
        horizon = GAPS_IN_HORIZON * longest if longest > 0 else 1.0
        settings.notice(f"--horizon not given: {short(horizon)} {plant.time_unit} is used.")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", sd.estimators.GuaranteeWarning)
        estimator = sd.MovingHorizonEstimator(
            plant, certificate, horizon=horizon, prior=prior, prior_time=start, schedule_zero=start, **bounds
        )
    for warning in caught:
        settings.notice(str(warning.message))
    return estimator


def validate(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    certificate_file: CertificateFile = None,
    runs: Annotated[int, typer.Option(help="Random trials.")] = 200,
    duration: Annotated[float | None, typer.Option(help="Length of a trial [plant's time unit].")] = None,
    w_bound: WBound = None,
    v_bound: VBound = None,
    initial_error: InitialError = None,
    eta: Eta = None,
    workers: Hands = 1,
    scheduler: Scheduler = None,
) -> None:
    """Certify a schedule, then try to break the promise: random and worst noise, constraints, inequality (16).

    Exit code 1 if a promise is broken. With -o DIR: report.md, report.json and validation.png; an interrupted one is
    taken up again where it was.

    Example: sampling-design validate examples/plants/oscillator.toml out/schedule.csv -o out
    """
    plant = reading.plant(plant_file)
    schedule = schedule_for(settings, plant, schedule_file)
    bounds = _bounds(settings, plant, w_bound, v_bound, initial_error)
    certificate = _certified(settings, plant, schedule, certificate_file, eta, bounds)
    folder = settings.folder()
    journal = None if folder is None else folder / "validation.journal"
    with settings.progress("validate") as progress, workforce(workers, scheduler) as hands:
        report = sd.validate(
            plant,
            schedule,
            certificate,
            runs=runs,
            duration=duration,
            rng=np.random.default_rng(settings.seed),
            workers=hands,
            resume=journal,
            progress=progress,
            **bounds,
        )
    _report(settings, report)
    if journal is not None:
        journal.unlink(missing_ok=True)
    if not report.passed:
        raise typer.Exit(1 if report.broken else 3)


def _report(settings: Settings, report: ValidationReport) -> None:
    folder = settings.folder()
    if folder is not None:
        settings.wrote(write_text(folder / "report.md", report.to_markdown()))
        settings.write_json(folder / "report.json", report.to_dict())
        settings.draw(report, folder / "validation.png")
    heads = ["claim", "scenario", "predicted", "observed", "margin", "verdict"]
    findings = table("Findings", heads, report.cells())
    settings.show(report.to_dict(), record_table(report), findings, *report.skipped, report.explain())


def _check_origins(record: sd.Measurements, schedule: sd.Schedule | sd.PeriodicSchedule) -> None:
    """Refuse to lay dates over times that have none, or the other way round: nobody knows where they belong."""
    if record.origin and schedule.origin is None:
        raise ArgumentError(
            "`MEASUREMENTS` hold dates and `SCHEDULE` does not say which date its time 0 is: "
            "give it one (design --start DATE, or origin=DATE in the first line of the file)."
        )
    if schedule.origin is not None and not record.origin:
        raise ArgumentError(
            f"`SCHEDULE` has its time 0 at {schedule.origin} and `MEASUREMENTS` hold times without dates: "
            "give the file a column `date`, or the schedule no origin."
        )


def log(
    settings: Settings,
    plant_file: PlantFile,
    schedule_file: ScheduleFile,
    measurement_file: MeasurementFile,
    window: Annotated[float | None, typer.Option(help="Window over which sigma is judged [plant's time unit].")] = None,
) -> None:
    """Compare planned with actual sample times: what came late, what was missed, and what that costs.

    With -o DIR: log.json and log.png.

    Example: sampling-design log examples/plants/oscillator.toml out/schedule.csv examples/data/oscillator.csv -o out
    """
    plant = reading.plant(plant_file)
    schedule = schedule_for(settings, plant, schedule_file)
    record = reading.measurements(settings, measurement_file, plant, schedule.origin)
    _check_origins(record, schedule)
    split = sd.plants.split_modes(plant, settings.decay_rate or 0.0)
    # where every mode decays no window is judged, so that none is chosen and told
    length = 1.0 if window is None and not split.retained.n_states else window_length(settings, split, window)
    times, taken = record.samples()
    if any(record.told):
        settings.notice("Limits and means count as taken, and sigma counts them like numbers.")
    del record  # its numbers are not held beside those of the comparison
    with settings.progress("sigma") as progress:
        result = sd.compare_schedule(
            plant,
            schedule,
            times,
            length,
            outputs=taken if times.size else None,
            retained=split.retained,
            budget=settings.budget,
            progress=progress,
        )
    folder = settings.folder()
    if folder is not None:
        settings.write_json(folder / "log.json", result.contents())
        settings.draw(result, folder / "log.png")
    settings.show(result.contents() if settings.as_json else {}, record_table(result), result.explain())
