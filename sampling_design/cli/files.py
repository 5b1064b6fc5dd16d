"""Files as arguments: read by their rooms, and where one is of another kind than its place says, that is said."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import sampling_design as sd
from sampling_design.checkers.check import verdict
from sampling_design.checkers.strict import likely
from sampling_design.errors import ArgumentError, CertificateError, FileFormatError, SamplingDesignError
from sampling_design.plants.plant import first_difference
from sampling_design.records.file_io import from_json, from_toml, has_cells, read_text
from sampling_design.schedules.files import MARK

if TYPE_CHECKING:
    from sampling_design.accuracy.interval import Interval
    from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
    from sampling_design.certificates.exact.certificate import SampledCertificate
    from sampling_design.checkers.outcome import Verdict
    from sampling_design.cli.settings import Settings
    from sampling_design.design.problem.requirement import Requirement
    from sampling_design.estimators.records.measurements import Measurements
    from sampling_design.planning.plan_record import Plan
    from sampling_design.planning.requirement import PlanRequirement
    from sampling_design.plants.plant import Plant
    from sampling_design.schedules.family import AnySchedule

T = TypeVar("T")
_FORMAT = re.compile(r"[\"']sampling-design/([a-z-]+)/")
_KEYS = {
    "plant": {"matrices", "states", "outputs", "A", "C"},
    "requirement": {"window", "period", "spacing", "samples", "target_sigma", "forbidden", "fixed", "cost_limit"},
    "certificate": {"P1", "P2", "lam", "claim"},
    "schedule": {"times", "gaps"},
}
"""Keys that tell a file which does not name its own kind."""
_MIXED = {
    ("measurement", "schedule"): (
        "Are the arguments in their order? "
        'A schedule begins with the line "# sampling-design schedule; time_unit=h; period=24".'
    ),
    ("schedule", "measurement"): "Its ones say what is to be measured, not what was read.",
    ("plan", "certificate"): "The certificate of a plan is in certificate.json, written beside it.",
    ("design", "schedule"): "The schedule of a design is in schedule.csv, written beside it.",
    ("plan requirement", "plan"): "`sampling-design plan` makes a plan of it, in plan.json.",
    ("requirement", "plan requirement"): (
        "`design` takes it; a plan requirement says how well what must be known, and `sampling-design new --within` "
        "writes one."
    ),
}
"""The likely slip where one kind of file is given for another."""
_UNREAD = {
    "calendar": (".ics",),
    "picture": (".png", ".svg", ".pdf"),
    "web page": (".html",),
    "document": (".md", ".tex"),
}
"""What is written and never read."""
_WRITTEN = {
    "measurement": "form.csv",
    "plant": "plant.toml",
    "requirement": "requirement.toml",
    "plan requirement": "plan.toml",
    "plan": "plan.json",
    "schedule": "schedule.csv",
    "certificate": "certificate.json",
}
"""What a command calls its file of a kind in the folder that it writes."""


def plant(path: Path) -> Plant:
    """The plant of a file, or of a plan."""
    whole = plan_in(path)
    if whole is not None:
        return whole.plant
    return _read("plant", sd.read_plant, path) if path.exists() else _named_plant(path)


def _named_plant(path: Path) -> Plant:
    """The plant of the library that has this name, where no file has it."""
    from sampling_design.plants.library import PLANTS

    if str(path) in PLANTS:
        return sd.named_plant(str(path))
    try:
        return sd.read_plant(path)
    except FileFormatError as error:
        if "Did you mean" in str(error) or path.parent.name:  # who types a folder means a file
            raise
        raise FileFormatError(f"{error} A plant of the library needs no file. {likely(path.stem, PLANTS)}") from None


def schedule(path: Path) -> AnySchedule:
    """The schedule of a file, or of a plan."""
    whole = plan_in(path)
    return _read("schedule", sd.read_schedule, path) if whole is None else whole.schedule


def schedule_path(plant_file: Path, given: Path | None, otherwise: str = "") -> Path:
    """The file of a command's schedule: the one that was given, or the plan that stands for PLANT.

    Raises ArgumentError if there is neither; `otherwise` says what else would do.
    """
    if given is not None:
        return given
    if plan_in(plant_file) is not None:
        return plant_file
    raise ArgumentError(f"`SCHEDULE` is missing: give its file, or a plan (plan.json) for PLANT{otherwise}.")


def schedule_for(settings: Settings, plant: Plant, path: Path) -> AnySchedule:
    """Return the schedule of a file in the plant's unit of time, with a notice where it had another."""
    found = schedule(path)
    if found.time_unit in (None, plant.time_unit):
        return found
    settings.notice(f"{path}: times in {found.time_unit} are converted to {plant.time_unit}.")
    return found.in_unit(plant.time_unit)


def plan_in(path: Path | None) -> Plan | None:
    """The plan of a file, which holds its plant and its schedule; None where the file is another one."""
    return plan(path) if path is not None and kind_of(path) == "plan" else None


def requirement(path: Path | None) -> Requirement:
    """The requirement of a file, or the one of no file: all defaults."""
    return sd.Requirement() if path is None else _read("requirement", sd.read_requirement, path)


def plan_requirement(first: Path, second: Path | None) -> tuple[PlanRequirement, Plant]:
    """The requirement of a plan and its plant: of one file that holds both, or of a plant file and another.

    Raises ArgumentError if one file is given and holds no plant, or nothing but one.
    """
    from sampling_design.planning.requirement_file import requirement_and_plant
    from sampling_design.plants.library import PLANTS

    if second is None and (kind_of(first) == "plant" or (not first.exists() and str(first) in PLANTS)):
        raise ArgumentError(
            f"`REQUIREMENT` is missing: {first} is a plant, and nothing says how well what must be known. "
            "`sampling-design new --within` writes a plan requirement."
        )
    requirement, own = _read("plan requirement", requirement_and_plant, first if second is None else second)
    if second is not None:
        return requirement, plant(first)
    if own is None:
        beside = first.with_name("plant.toml")
        likely = f" Did you mean {beside} {first}?" if beside.is_file() else ""
        raise ArgumentError(f"`PLANT` is missing: {first} is a requirement that holds no plant.{likely}")
    return requirement, own


def plan(path: Path) -> Plan:
    """The plan of a file, proven once for all that a command asks it for: its plant, its schedule, its bounds."""
    return _read("plan", lambda file: _proven(file, read_text(file)), path)


@lru_cache(maxsize=2)  # a command compares two of them
def _proven(path: Path, _: str) -> Plan:
    from sampling_design.planning.files import read_plan

    return read_plan(path)


def measurements(
    settings: Settings, path: Path, about: Plant, origin: str | None, zone: str | None = None
) -> Measurements:
    """The measurements of a file; where its dates have no zone, which one was taken is told."""
    found = _read("measurement", lambda where: sd.read_measurements(where, about, origin=origin, zone=zone), path)
    if found.assumed_zone:
        settings.notice(f"Dates without a zone are read in {found.assumed_zone}.")
    return found


def certificate(path: Path, about: Plant | None) -> SampledCertificate | DetectabilityCertificate:
    """The certificate of a file."""
    return _read("certificate", lambda where: sd.read_certificate(where, about), path)


def sampling_certificate(path: Path, about: Plant) -> SampledCertificate:
    """The certificate of a file, if it is about samples of this plant."""
    found = certificate(path, about)
    if isinstance(found, sd.certificates.DetectabilityCertificate):
        raise ArgumentError(
            f"`CERTIFICATE` {path} proves that the plant is detectable, which promises nothing about samples: "
            "make one with `certify PLANT SCHEDULE`."
        )
    return found


def check_origins(record: Measurements, schedule: AnySchedule) -> None:
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
    if schedule.origin is not None and (first := float(record.times.min(initial=0.0))) < 0:
        from sampling_design.estimators.records.measurement_table import time_or_date

        begins = time_or_date(record.origin, first, record.plant.time_unit)
        raise ArgumentError(
            f"`MEASUREMENTS` begin at {begins}, before time 0 of `SCHEDULE` at {schedule.origin}. Is it the right year?"
        )


def check_measured(record: Measurements, path: Path) -> None:
    """Refuse measurements none of which was taken."""
    if not record.measured.any():
        raise ArgumentError(f"`MEASUREMENTS` {path} holds no measurement.")


def holds_interval(path: Path) -> bool:
    """Whether a file claims an interval."""
    try:
        return from_json(read_text(path), str(path)).get("claim") == "interval"
    except SamplingDesignError:
        return False


def interval(path: Path, about: Plant | None) -> tuple[Interval, Verdict]:
    """The interval of a file, and the checkers' verdict on it."""
    from sampling_design.accuracy.interval import Interval

    found = _read("certificate", Interval.read, path)
    if about is not None and (other := first_difference(about, found.plant)):
        who = found.plant.name or "unnamed"
        raise CertificateError(f"{path}: is about another plant ({who}): {other}.", path=str(path))
    return found, verdict(from_json(read_text(path), str(path)))


def _read(kind: str, reader: Callable[[Path], T], path: Path) -> T:
    try:
        return reader(path)
    except SamplingDesignError:
        if path.is_dir():
            within = path / _WRITTEN.get(kind, "")
            if kind in ("plant", "schedule") and (path / "plan.json").is_file():  # stands for both, with its bounds
                within = path / "plan.json"
            slip = f" Did you mean {within}?" if within.is_file() else ""
            raise FileFormatError(f"{path}: is a folder, expected a file.{slip}", str(path)) from None
        found, where = kind_of(path), str(path)
        if found not in (kind, ""):
            beside = path.with_name(_WRITTEN.get(kind, path.name))
            meant = beside.is_file() and beside != path and kind_of(beside) == kind
            otherwise, file = ("", "") if found in _UNREAD else ("Are the arguments in their order?", " file")
            slip = _MIXED.get((found, kind), f"Did you mean {beside}?" if meant else otherwise)
            a = "an" if found[0] in "aeiou" else "a"
            said = f"{where}: is {a} {found}{file}, expected a {kind} file. {slip}".rstrip()
            raise FileFormatError(said, where) from None
        raise


def is_plan_requirement(path: Path) -> bool:
    """Whether a file says that it is a plan requirement."""
    try:
        text = read_text(path)
        return from_toml(text, "").get("format") == "sampling-design/plan-requirement/1"
    except SamplingDesignError:
        return False


def kind_of(path: Path) -> str:
    """What a file seems to be (plant, schedule, plan, plan requirement, measurement, ...), or "" where that is open."""
    try:
        text = read_text(path)
    except SamplingDesignError:
        text = ""
    unread = next((kind for kind, ends in _UNREAD.items() if path.suffix.lower() in ends), "")
    if unread or not text:
        return unread
    if text.startswith(MARK):
        return "schedule"
    named = _FORMAT.search(text)
    if named:
        return named[1].removeprefix("uncertain-").replace("-", " ")
    try:
        keys = set(from_json(text, "") if text.lstrip().startswith("{") else from_toml(text, ""))
    except SamplingDesignError:
        first = next((line for line in text.splitlines() if has_cells(line)), "")
        cells = {cell.strip() for cell in re.split("[,;\t]", first)}
        if "certified" in cells:
            return "estimate"
        return "measurement" if len(cells) > 1 and cells & {"time", "date"} else ""
    return next((kind for kind, known in _KEYS.items() if keys & known), "")
