"""Arguments and flags of several commands, and how what was typed behind them is read."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError
from sampling_design.records.checks import known_keys
from sampling_design.schedules.jitter import EarlyLate, Timing
from sampling_design.schedules.sensor import duration

if TYPE_CHECKING:
    from sampling_design.plants.plant import Plant
    from sampling_design.records.workers import Workers


PlantFile = Annotated[
    Path,
    typer.Argument(
        metavar="PLANT",
        help="Plant file: .toml, .json, .mat or .npz; or the name of a plant of the library, as oscillator.",
    ),
]
ScheduleFile = Annotated[
    Path | None,
    typer.Argument(metavar="SCHEDULE", help="Schedule file: .csv or .json; none where PLANT is a plan (plan.json)."),
]
RequirementFile = Annotated[
    Path | None, typer.Argument(metavar="REQUIREMENT", help="Requirement file (.toml); without it, defaults.")
]
MeasurementFile = Annotated[Path, typer.Argument(metavar="MEASUREMENTS", help="Measurements: a .csv file.")]
CertificateFile = Annotated[Path | None, typer.Option("--certificate", metavar="FILE", help="Certificate (.json).")]
CertificateArgument = Annotated[Path, typer.Argument(metavar="CERTIFICATE", help="Certificate file (.json).")]
Eta = Annotated[
    float | None,
    typer.Option(help="Discount rate of the squared error [1/time unit], where one is certified; default: searched."),
]
Window = Annotated[
    float | None,
    typer.Option(
        help="Window over which sigma is judged [time unit]; default: the longest oscillation, or of longer gaps."
    ),
]
RelativeWidth = Annotated[float, typer.Option(help="Relative width of the bracket.")]
Rigorous = Annotated[
    bool, typer.Option("--rigorous", help="Decide in ball arithmetic: a theorem about the stated numbers.")
]
NoLimit = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="After which bounds stay as they are. Default: none.")
]
WorkerCount = Annotated[int, typer.Option(help="Processes that share the work (-1: one per core).")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler whose machines share the work (tcp://host:8786).")
]
TimingOption = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="How early or late each sample may be [time unit]: TIME, EARLY:LATE, or NAME=TIME,... of each output.",
    ),
]
"""What is said then holds at all such times."""

_FORM = "One number bounds the norm; numbers or NAME=NUMBER with commas between bound each entry; 0 for none."
DisturbanceBound = Annotated[
    str | None, typer.Option("--w-bound", "--w", help=f"Bound on the disturbance w(t). {_FORM}")
]
NoiseBound = Annotated[str | None, typer.Option("--v-bound", "--v", help=f"Bound on the measurement noise v. {_FORM}")]


@dataclass(frozen=True)
class BoundOptions:
    """The three bounds, as they are typed."""

    w_bound: DisturbanceBound = None
    v_bound: NoiseBound = None
    initial_error: Annotated[
        str | None,
        typer.Option("--initial-error", help=f"Bound on the error of the prior, before the first sample. {_FORM}"),
    ] = None

    def of(self, plant: Plant) -> ErrorBoundArguments:
        """The bounds as verbs take them."""
        return ErrorBoundArguments(
            w_bound=numbers("--w-bound", self.w_bound, plant.disturbances.names),
            v_bound=numbers("--v-bound", self.v_bound, plant.outputs.names),
            initial_error=numbers("--initial-error", self.initial_error, plant.states.names),
        )


UNBOUNDED = BoundOptions()


def shell_word(path: Path) -> str:
    """A path as it is typed at a shell."""
    return shlex.quote(str(path))


def listed(text: str) -> list[str]:
    """Names with commas between."""
    return [name.strip() for name in text.split(",") if name.strip()]


def by_name(flag: str, text: str, names: Sequence[str], alone: Sequence[str], least: float = 0.0) -> dict[str, float]:
    """Values as NAME=VALUE with commas between; one number without a name holds for each of `alone`."""
    found: dict[str, float] = {}
    for part in listed(text):
        name, equals, number = part.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = np.inf
        alone_of_many = not equals and "," in text.strip(" ,")
        if not least <= value < np.inf or alone_of_many or (name.strip() in found):
            none_less = ", none negative" * (least == 0)
            raise ArgumentError(
                f"`{flag}` must be a number, or {names[0]}=NUMBER with commas between{none_less}, got {text!r:.60}. "
                "Decimals have a point, not a comma."
            )
        keys = [name.strip()] if equals else list(alone)
        known_keys(f"`{flag}`", keys, names)
        found |= dict.fromkeys(keys, value)
    return found


def numbers(flag: str, text: str | None, names: Sequence[str] = ()) -> float | list[float] | None:
    """None, one number, or numbers with commas between: one for each name, or NAME=NUMBER, where names are given."""
    if text is None:
        return None
    if names and "=" in text:
        named = by_name(flag, text, names, names, -np.inf)
        if lost := [name for name in names if name not in named]:
            raise ArgumentError(f"`{flag}` is missing for {', '.join(lost)}: give a number, 0 for none.")
        return [named[name] for name in names]
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise ArgumentError(f"`{flag}` must be numbers with commas between, got {text!r}.") from None
    if len(values) > 1 and names and len(values) != len(names):
        each = f", or {len(names)}: one for each of {', '.join(names)}" if len(names) > 1 else ""
        raise ArgumentError(f"`{flag}` must be one number{each}, got {text!r}. Decimals have a point, not a comma.")
    return values if len(values) > 1 else values[0]


def timing(text: str | None) -> Timing:
    """How early or late samples may be: TIME or EARLY:LATE, or NAME=either with commas between, one for each output.

    On time where nothing was said. Raises ArgumentError if one is neither a number nor text with a unit.
    """
    text = text or "0"
    if not all(part.strip() for part in re.split("[,:=]", text)):
        raise ArgumentError(f"`--timing-tolerance` must be TIME, EARLY:LATE or NAME=TIME,..., got {text!r}.")
    if "=" not in text:
        return _early_late(text)
    named = [part.partition("=") for part in text.split(",")]
    found = {name.strip(): _early_late(value) for name, _, value in named}
    if len(found) < len(named):
        raise ArgumentError(f"`--timing-tolerance` names an output twice, got {text!r}.")
    return found


def _early_late(text: str) -> EarlyLate:
    values = [number_or_text(part.strip()) for part in text.split(":")]
    for value in values:
        if is_text(value):
            duration("--timing-tolerance", value, "s")
    return values if len(values) > 1 else values[0]


def number_or_text(part: str) -> float | str:
    """A number, or what may be text with a unit."""
    try:
        return float(part)
    except ValueError:
        return part


@contextmanager
def workforce(workers: int, scheduler: str | None) -> Iterator[Workers]:
    """Yield who does the work of a command: this process, several, or the machines of a scheduler."""
    from sampling_design.records.workers import check_workers, cluster

    if scheduler is None:
        check_workers(workers)
        yield None if workers == 1 else workers
        return
    if workers != 1:
        raise ArgumentError("`--workers` and `--scheduler` exclude each other: a scheduler knows its own workers.")
    client = cluster(scheduler)
    try:
        yield client
    finally:
        client.close()
