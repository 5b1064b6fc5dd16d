"""The command that writes a first plant and what it shall keep, with comments, from what a newcomer knows."""

from __future__ import annotations

import math
import sys
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path
from typing import Annotated

import typer

import sampling_design as sd
from sampling_design.cli.options import by_name, listed, shell_word
from sampling_design.cli.requirement_flags import RequirementFlags, plan_requirement, positive_times, requirement, week
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.planning.requirement_file import write_plan_requirement
from sampling_design.records.file_io import read_text, write_text
from sampling_design.records.units import check_time_unit
from sampling_design.schedules.opening import OpeningCalendar

PLANT = {
    "format": "A plant: x' = A x + B u + G w, y = C x + D u + v. Times are in time_unit, rates in its inverse.",
    "A": "Each mode has its own rows: one for a level or a decay, two for an oscillation.",
    "C": "One row for each sensor: how much of each state it shows.",
    "[states]": 'Names, and units = ["...", ...] beside them; scales = [...] are typical magnitudes, if you know them.',
}
REQUIREMENT = {
    "format": "What a schedule must keep. All times are in the plant's unit; time zero is midnight, of a Monday.",
    "window": "The samples of every stretch of this length must determine the state.",
    "period": "The schedule repeats after this time.",
    "spacing": "Least time between two samples.",
    "samples": "How many in a period: exactly, at_least, at_most. Without it, as many as the count asks for.",
    "forbidden": "Half-open intervals in which nobody samples.",
}
PLAN = {
    "format": 'What a plan must keep at the least cost. Times are numbers in the plant\'s unit, or text as "15 min".',
    "period": "The plan repeats after this; without it, after a week of the calendar.",
    "grid": "Samples lie on whole multiples of it: a finer one finds cheaper plans and takes longer.",
    "spacing": "Least time between two samples.",
    "aim": 'Least cost that keeps every tolerance; "most accurate" needs samples = ... or cost_limit = ...',
    "visit_price": "Of every visit, whatever is measured then.",
    "w_bound": "The disturbance w(t) of each state is never stronger than this.",
    "[accuracy.": 'How well this must be known, in its unit; at = "after each sample" asks less. Also row = [...].',
    "[sensors.": "Price of one measurement; noise_bound: no reading errs more. Also hours, longest_use, spacing.",
    "[calendar]": "The place: local date of the first period, time zone; holidays are closed dates.",
    "[calendar.hours]": "Opening hours by weekday; days that are not named are closed.",
}


@dataclass(frozen=True)
class PlantModes:
    """What moves in a plant, and what shows it, as it was typed."""

    name: Annotated[str, typer.Option(help="Name of the plant; default: that of DIR.")] = ""
    unit: Annotated[str, typer.Option(help="Unit of time: ms, s, min, h, d or wk.")] = "h"
    oscillation: Annotated[
        str, typer.Option(help="Periods of undamped oscillations [time unit], with commas between.")
    ] = ""
    decay: Annotated[
        str, typer.Option(help="Times in which a decaying mode falls to a third [time unit], commas between.")
    ] = ""
    level: Annotated[bool, typer.Option("--level/--no-level", help="A level that stays, or none.")] = True
    half_life: Annotated[
        str, typer.Option(help="Times in which a decaying mode halves [time unit], commas between: 3, or '3 d'.")
    ] = ""
    names: Annotated[
        str, typer.Option(help="What the modes are called: the level, oscillations, decaying ones, commas between.")
    ] = ""
    sensors: Annotated[str, typer.Option(help="Names of the sensors; each shows the sum of all modes.")] = "sensor"
    units: Annotated[str, typer.Option(help="Unit of what the sensors show, or one for each: mg/l,mg/l.")] = ""

    @property
    def decays(self) -> list[float]:
        """Times in which each decaying mode falls to a third."""
        halves = positive_times("--half-life", self.half_life, self.unit)
        return [*positive_times("--decay", self.decay, self.unit), *(half * math.log(3.0, 2.0) for half in halves)]

    def plant(self) -> sd.Plant:
        """The sum of a level, oscillations and decaying modes."""
        oscillations = positive_times("--oscillation", self.oscillation, self.unit)
        if not oscillations and not self.decays:
            raise ArgumentError(
                "`new` needs to know what moves: give --oscillation PERIODS, --decay or --half-life TIMES, or both."
            )
        sensors, names, units = (_named(f"--{key}", getattr(self, key)) for key in ("sensors", "names", "units"))
        return sd.plants.plant_of_modes(
            oscillations, self.decays, level=self.level, sensors=sensors, units=units, names=names,
            time_unit=self.unit, name=self.name,
        )  # fmt: skip

    def span(self) -> float:
        """The longest oscillation, or twice the longest decay."""
        oscillations = positive_times("--oscillation", self.oscillation, self.unit)
        return max(oscillations) if oscillations else 2.0 * max(self.decays)


def new(
    settings: Settings,
    target: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the files.")],
    modes: PlantModes,
    asked: RequirementFlags,
    force: Annotated[bool, typer.Option("--force", help="Write over files that are there.")] = False,
) -> None:
    """Write a first plant and requirement, with comments, from flags; at a terminal, what is missing is asked.

    With --within, --noise and --disturbance (and --prices, --start, --zone) also plan.toml, for
    `plan`.

    Example: sampling-design new out/mine --oscillation 24 --half-life 2 --sensors blood --samples 4 --open 7-22
    """
    modes = replace(modes, name=modes.name or target.name, unit=check_time_unit(modes.unit, "--unit"))
    if not (modes.oscillation or modes.decay or modes.half_life) and sys.stdin.isatty() and not settings.quiet:
        modes, asked = _asked(modes, asked)
    plant, span = modes.plant(), modes.span()
    wanted, planned = requirement(asked, plant.time_unit, span), plan_requirement(asked, plant, span)
    paths = [target / "plant.toml", target / "requirement.toml", *([target / "plan.toml"] if planned else [])]
    there = [str(path) for path in paths if path.exists()]
    if there and not force:
        raise ArgumentError(f"`DIR` holds {' and '.join(there)} already. Take another folder, or --force.")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError(f"`DIR` {target} cannot be made a folder ({error.strerror}).") from None
    settings.wrote(_commented(sd.plants.write_plant(plant, paths[0]), PLANT))
    settings.wrote(_commented(sd.design.write_requirement(wanted, paths[1]), _dated(asked)))
    words = f"Next: sampling-design design {shell_word(paths[0])} {shell_word(paths[1])} -o {shell_word(target)}"
    data = {"plant": plant.to_dict(), "requirement": wanted.to_dict()}
    if planned is not None:
        settings.wrote(_commented(write_plan_requirement(planned, paths[2]), PLAN))
        made = f"{shell_word(paths[2])} -o {shell_word(target / 'out')}"
        words = f"Next: sampling-design plan {shell_word(paths[0])} {made}"
        data["plan"] = planned.to_dict()
    settings.show(data, f"States: {', '.join(plant.states.names)}.", words)


def _named(flag: str, text: str) -> list[str]:
    """Names with commas between; whoever separates them otherwise is told."""
    if any(mark in text for mark in ";=\n"):
        raise ArgumentError(
            f"`{flag}` must be names with commas between, without ; and = and in one line, got {text!r:.60}."
        )
    return listed(text)


def _dated(asked: RequirementFlags) -> dict[str, str]:
    """The comments of a requirement, with the date of time zero where it was said."""
    zero = f"midnight of {asked.start} {asked.zone}".strip() if asked.start else "midnight, of a Monday"
    return {**REQUIREMENT, "format": REQUIREMENT["format"].replace("midnight, of a Monday", zero)}


def _asked(modes: PlantModes, asked: RequirementFlags) -> tuple[PlantModes, RequirementFlags]:
    """Ask at the terminal for what was not said; a slip is named at once, and asked again."""
    unit = modes.unit
    oscillation = _ask(
        f"Periods of undamped oscillations [{unit}], commas between",
        "24",
        lambda t: positive_times("--oscillation", t, unit),
    )
    modes = replace(modes, oscillation=oscillation)
    decay = _ask(
        f"Times in which a decaying mode falls to a third [{unit}], if anything does", "",
        lambda text: replace(modes, decay=text).plant(),
    )  # fmt: skip
    modes = replace(modes, decay=decay)
    if modes.sensors == "sensor":
        words = _ask("Names of the sensors", "sensor", lambda text: replace(modes, sensors=text).plant())
        modes = replace(modes, sensors=words)
    plant = modes.plant()
    states, outputs = plant.states.names, plant.outputs.names
    if not asked.open_hours:
        hours = _ask('When somebody is there, as 7-19 or "Mon-Fri 8-17" (empty: always)', "", lambda t: week(t, True))
        asked = replace(asked, open_hours=hours)
    if not asked.within:
        known = ", ".join((*states, *outputs))
        asked = replace(asked, within=_ask(
            f"How well what must be known at all times, as 0.5 or {states[0]}=0.5, of {known} (empty: no plan)", "",
            lambda t: by_name("--within", t, (*states, *outputs), outputs[:1]),
        ))  # fmt: skip
    if not asked.within.strip():
        return modes, asked

    def named(key: str, words: str, question: str, default: str, names: Sequence[str]) -> str:
        return words or _ask(question, default, lambda text: by_name(f"--{key}", text, names, names))

    one, state = outputs[0], states[0]
    asked = replace(
        asked,
        noise=named("noise", asked.noise, f"No reading errs more than, as 0.1 or {one}=0.1", "0.1", outputs),
        disturbance=named(
            "disturbance",
            asked.disturbance,
            f"Disturbances, per {unit}, of at most 0.01 or {state}=0.01",
            "0.01",
            states,
        ),
        prices=named("prices", asked.prices, f"Price of one measurement, as 12 or {one}=12", "1", outputs),
    )
    if not asked.start:
        today = date.today()
        monday = (today + timedelta(days=7 - today.weekday())).isoformat()
        asked = replace(asked, start=_ask("First day (local date)", monday, lambda t: OpeningCalendar(t)))
    if not asked.zone:
        asked = replace(asked, zone=_ask("Time zone", "UTC", lambda t: OpeningCalendar(asked.start, t)))
    return modes, asked


def _ask(question: str, default: str, read: Callable[[str], object]) -> str:
    """Return an answer that can be read; another is said to be none, and asked for again."""
    while True:
        text = str(typer.prompt(question, default, err=True, show_default=bool(default)))
        try:
            read(text)
        except (ArgumentError, FileFormatError) as slip:
            typer.echo(f"{slip}", err=True)
        else:
            return text


def _commented(path: Path, comments: dict[str, str]) -> Path:
    """Put a comment above the first line that begins what it explains."""
    lines, left = [], dict(comments)
    for line in flat(read_text(path)).splitlines():
        key = line.split(" = ")[0]
        found = next((k for k in left if key == k or (k.endswith(".") and key.startswith(k))), None)
        lines += [] if found is None else [f"# {left.pop(found)}"]
        lines.append(line)
    return write_text(path, "\n".join(lines) + "\n")


WIDE = 110  # Characters of a line of a file up to which an array stays on it


def flat(text: str) -> str:
    """Return TOML with short arrays on one line each, and long ones with an item on each line."""
    lines: list[str] = []
    for line in text.splitlines():
        inside = bool(lines) and lines[-1].startswith("\0")
        if inside:
            lines[-1] += "\n" + line
        else:
            lines.append(f"\0{line}" if line.endswith(" = [") else line)
        if inside and line == "]":
            lines[-1] = _array(lines[-1][1:])
    found = "\n".join(lines) + "\n"
    return found if "\0" not in found and tomllib.loads(found) == tomllib.loads(text) else text


def _array(text: str) -> str:
    """One array, written with an indent of four for each depth."""
    head, *body, _ = text.split("\n")
    items: list[str] = []
    for line in body:
        fresh = line.startswith("    ") and not line.startswith("     ") and line.strip() not in ("]", "],")
        items += [line.strip()] if fresh else []
        if not fresh:
            items[-1] += ("" if items[-1].endswith("[") else " ") + line.strip()
    items = [item.rstrip(",").replace(", ]", "]") for item in items]
    whole = head + ", ".join(items) + "]"
    return whole if len(whole) <= WIDE else "\n".join([head, *(f"    {item}," for item in items), "]"])
