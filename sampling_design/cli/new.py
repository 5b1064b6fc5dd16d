"""The command that writes a first plant and a first requirement, with comments, from what a newcomer knows."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

import sampling_design as sd
from sampling_design._files import read_text, write_text
from sampling_design._units import SECONDS, check_time_unit
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError

Array = npt.NDArray[np.float64]

MOST_DAYS = 400
PLANT = {
    "format": "A plant: x' = A x + B u + G w, y = C x + D u + v. Times are in time_unit, rates in its inverse.",
    "A": "Each motion has its own rows: a level stays, a rhythm turns, what decays fades.",
    "C": "One row for each sensor: how much of each state it shows.",
    "[states]": 'Names, and units = ["...", ...] beside them; scales = [...] are typical magnitudes, if you know them.',
}
REQUIREMENT = {
    "format": "What a schedule must keep. All times are in the plant's unit; time zero is midnight, of a Monday.",
    "window": "From every stretch of this length the state must be seen.",
    "period": "The schedule repeats after this time.",
    "spacing": "Least time between two samples.",
    "samples": "How many in a period: exactly, at_least, at_most. Without it, as many as the count asks for.",
    "forbidden": "Half-open intervals in which nobody samples.",
}


def new(
    settings: Settings,
    target: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for plant.toml and requirement.toml.")],
    name: Annotated[str, typer.Option(help="Name of the plant.")] = "",
    unit: Annotated[str, typer.Option(help="Unit of time: ms, s, min, h, d or wk.")] = "h",
    rhythm: Annotated[str, typer.Option(help="Periods of what goes round for ever, with commas between.")] = "",
    decay: Annotated[str, typer.Option(help="Times in which what fades falls to a third, with commas between.")] = "",
    level: Annotated[bool, typer.Option("--level/--no-level", help="A level that stays, or none.")] = True,
    sensors: Annotated[str, typer.Option(help="Names of the sensors; each shows the sum of all motions.")] = "sensor",
    period: Annotated[float | None, typer.Option(help="The schedule repeats after this; default: one rhythm.")] = None,
    samples: Annotated[int | None, typer.Option(help="So many samples in a period.")] = None,
    spacing: Annotated[float | None, typer.Option(help="Least time between two samples.")] = None,
    open_hours: Annotated[str, typer.Option("--open", help="Hours of the day with samples, as 7-19.")] = "",
    weekend: Annotated[bool, typer.Option("--weekend/--no-weekend", help="Samples on Saturday and Sunday too.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Write over files that are there.")] = False,
) -> None:
    """Write a first plant and requirement, with comments, from flags; at a terminal, what is missing is asked.

    Example: sampling-design new out/mine --rhythm 24 --decay 2 --sensors blood --samples 4 --open 7-22
    """
    unit = check_time_unit(unit)
    if not rhythm and not decay and sys.stdin.isatty() and not settings.quiet:
        rhythm = typer.prompt(f"Periods of what goes round for ever [{unit}], with commas between", "24", err=True)
        decay = typer.prompt(f"Times in which what fades falls to a third [{unit}]", "", err=True)
        open_hours = open_hours or typer.prompt("Hours of the day with samples, as 7-19", "", err=True)
    rhythms, decays = _positive("--rhythm", rhythm), _positive("--decay", decay)
    if not rhythms and not decays:
        raise ArgumentError("`new` needs to know what moves: give --rhythm PERIODS, --decay TIMES, or both.")
    plant = _plant(name or target.name, unit, rhythms, decays, level, [s.strip() for s in sensors.split(",")])
    span = period if period is not None else max(rhythms) if rhythms else 2.0 * max(decays)
    requirement = sd.Requirement(
        window=span, period=span, samples=samples, spacing=spacing, forbidden=_closed(unit, span, open_hours, weekend)
    )
    paths = [target / "plant.toml", target / "requirement.toml"]
    there = [str(path) for path in paths if path.exists()]
    if there and not force:
        raise ArgumentError(f"`DIR` holds {' and '.join(there)} already. Take another folder, or --force.")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError(f"`DIR` {target} cannot be made a folder ({error.strerror}).") from None
    settings.wrote(_commented(sd.write_plant(plant, paths[0]), PLANT))
    settings.wrote(_commented(sd.write_requirement(requirement, paths[1]), REQUIREMENT))
    told = f"Next: sampling-design design {paths[0]} {paths[1]} -o {target}"
    settings.show({"plant": plant.to_dict(), "requirement": requirement.to_dict()}, told)


def _positive(flag: str, text: str) -> list[float]:
    """Positive numbers with commas between."""
    try:
        values = [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        values = [-1.0]
    if not all(0 < value < np.inf for value in values):
        raise ArgumentError(f"`{flag}` must be positive numbers with commas between, got {text!r:.40}.")
    return values


def _plant(
    name: str, unit: str, rhythms: list[float], decays: list[float], level: bool, sensors: list[str]
) -> sd.Plant:
    """The sum of a level, rhythms and decaying motions."""
    n = level + 2 * len(rhythms) + len(decays)
    A, row, names, at = np.zeros((n, n)), np.zeros(n), ["level"] * level, int(level)
    row[:at] = 1.0
    for k, length in enumerate(rhythms, 1):
        rate = 2 * np.pi / length
        A[at, at + 1], A[at + 1, at], row[at] = rate, -rate, 1.0
        names += [f"rhythm_{k}", f"rhythm_{k}_quadrature"]
        at += 2
    for k, time in enumerate(decays, 1):
        A[at, at], row[at] = -np.log(3.0) / time, 1.0
        names.append(f"decaying_{k}")
        at += 1
    C = np.tile(row, (len(sensors), 1))
    return sd.Plant(A, C, time_unit=unit, states=sd.Signals(names), outputs=sd.Signals(sensors), name=name)


def _closed(unit: str, period: float, hours: str, weekend: bool) -> Array:
    """The forbidden intervals of a period: closed hours of every day, and whole days of the weekend."""
    day = 86400.0 / SECONDS[unit]
    days = int(np.ceil(period / day * (1 - 1e-12)))
    first, last = 0.0, 24.0
    if hours:
        found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*-\s*(\d+(?:\.\d+)?)\s*", hours)
        first, last = (float(found[1]), float(found[2])) if found else (1.0, 0.0)
        if not 0 <= first < last <= 24:
            raise ArgumentError(f"`--open` must be two hours of a day, as 7-19, got {hours!r:.40}.")
    if (hours or not weekend) and days > MOST_DAYS:
        raise ArgumentError(f"`--open` closes every day: a period of {days} days is too long, at most {MOST_DAYS}.")
    spans: list[list[float]] = []
    for k in range(days if hours or not weekend else 0):
        shut = [[0.0, 24.0]] if not weekend and k % 7 >= 5 else [[0.0, first], [last, 24.0]]
        for a, b in shut:
            start, stop = (k + a / 24) * day, min((k + b / 24) * day, period)
            if stop <= start:
                continue
            if spans and abs(spans[-1][1] - start) <= 1e-9 * day:
                spans[-1][1] = stop
            else:
                spans.append([start, stop])
    return np.array(spans).reshape(-1, 2)


def _commented(path: Path, comments: dict[str, str]) -> Path:
    """Put a comment above each line that begins what it explains."""
    lines = []
    for line in read_text(path).splitlines():
        key = line.split(" = ")[0]
        lines += [f"# {comments[key]}"] if key in comments else []
        lines.append(line)
    return write_text(path, "\n".join(lines) + "\n")


COMMANDS: tuple[Callable[..., None], ...] = (new,)
