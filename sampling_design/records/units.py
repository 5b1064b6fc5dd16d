"""Time units: the six that files may name, and conversion between them."""

from __future__ import annotations

import math

from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError
from sampling_design.records.checks import described
from sampling_design.records.record import short

WHOLE = (1e-3, 1e-6)  # a length counts as whole seconds within so many of them, and within this share of it

FEW, MANY = 1.5, 120.0
"""A time axis is as long as so many of its units, at least and at most, where a longer unit has a name."""

SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "wk": 604800.0}
WORDS = {"ms": "milli", "s": "sec", "min": "min", "h": "h", "d": "d", "wk": "w"}
"""How words for the units begin: what is likely meant where one is written out."""


def check_time_unit(unit: object, name: str = "time_unit") -> str:
    """Return `unit` if it is one of the six known units, else raise.

    Raises ArgumentError if the unit is missing or unknown.
    """
    if unit is None or (is_text(unit) and not unit):
        raise ArgumentError(f"`{name}` is missing. Give one of {', '.join(SECONDS)}.")
    if not is_text(unit) or unit not in SECONDS:
        came = repr(unit) if is_text(unit) else described(unit)
        slip = likely_unit(unit) if is_text(unit) else ""
        raise ArgumentError(f"`{name}` must be one of {', '.join(SECONDS)}, got {came}.{slip}")
    return str(unit)


def likely_unit(word: str) -> str:
    """The question which unit a word that is none may mean, or ""."""
    meant = next((unit for unit, name in WORDS.items() if word.lower().startswith(name)), None)
    return "" if meant is None else f" Did you mean {meant!r}?"


def time_factor(source: str, target: str) -> float:
    """Return c so that a time of value t in `source` has value c t in `target`."""
    return SECONDS[check_time_unit(source)] / SECONDS[check_time_unit(target)]


def readable_unit(length: float, unit: str) -> tuple[str, float]:
    """Return the unit in which a time axis of some length counts, and how much of it one `unit` is.

    `unit` itself up to `MANY` of them; else seconds, minutes, hours or days, the longest of which there are `FEW`.
    """
    own = SECONDS[check_time_unit(unit)]
    longer = [u for u in ("s", "min", "h", "d") if own < SECONDS[u] <= length * own / FEW] if length > MANY else []
    readable = longer[-1] if longer else unit
    return readable, own / SECONDS[readable]


def spoken(length: float, unit: str) -> str:
    """Return a length of time as people say it: 1.08333 d is "26 h", 5400 s "1 h 30 min", 100 h "4 d 4 h".

    Below two days in hours; what is shorter than a minute, or no whole number of seconds, stays as it is ("6.4 s").
    """
    seconds = length * SECONDS[check_time_unit(unit)]
    whole = round(seconds) if math.isfinite(seconds) else 0
    if abs(whole) < 60 or abs(seconds - whole) > min(WHOLE[0], WHOLE[1] * abs(seconds)):
        return f"{short(length)} {unit}"
    rest, parts = abs(whole), []
    for name in ("d", "h", "min", "s"):
        size = round(SECONDS[name])
        if name == "d" and rest < 2 * size and rest != size:
            continue
        count, rest = divmod(rest, size)
        parts += [f"{count} {name}"] if count else []
    return ("-" if whole < 0 else "") + " ".join(parts)
