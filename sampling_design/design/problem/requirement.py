"""What a schedule must respect: window, period, spacing, number of samples, forbidden and fixed times; and its files.

A requirement file is TOML, or JSON with the same tree.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.parts import time_unit
from sampling_design.checkers.strict import (
    by_name,
    count,
    is_table,
    is_text,
    list_of,
    matrix,
    nonnegative,
    positive,
    table,
    text,
    word,
)
from sampling_design.errors import ArgumentError
from sampling_design.plants.functional import Wanted, row_arguments, rows_in_words
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.file_io import by_first, by_kind, of_format, read_tree, usable, write_tree
from sampling_design.records.record import Plain, WrittenRecord, moment, short
from sampling_design.records.signatures import checked
from sampling_design.records.units import check_time_unit
from sampling_design.schedules.jitter import Timing, TimingTolerance
from sampling_design.schedules.opening import OpeningCalendar
from sampling_design.schedules.sensor import (
    CALENDAR,
    DURATION,
    SENSOR,
    Sensor,
    duration,
    from_files,
    intervals,
    spans_in_words,
)

FORMAT = "sampling-design/requirement/1"
Place: TypeAlias = OpeningCalendar | Mapping[str, object] | None

COUNTS = ("exactly", "at_least", "at_most")


@frozen
class Requirement(WrittenRecord):
    """What an endless periodic schedule must respect.

    Parameters
    ----------
    window : float or str, optional
        Length T of the window from which the state must be seen. Default: from the plant's modes, and early and late
        together longer, so that it holds what was planned in the shorter one.
    period : float or str, optional
        The schedule repeats after this time. Default: the window, before that is added.
    spacing : float or str, optional
        Least time between two samples, the last of a period and the first of the next included.
        Default window/(4 samples).
    samples : int or dict, optional
        Samples per period: a number, or a dict with one of "exactly", "at_least", "at_most" (both of
        the last two may be given). Default: the binding count of the zero-count bound, at most 24.
    target_sigma : float, optional
        Fewest samples (within `samples`) whose proven sigma reaches this.
    decay_rate : float
        Rate of the squared error that the rest of the plant brings by itself; modes with
        Re < -decay_rate/2 need no samples.
    forbidden : (m, 2) array
        Half-open intervals [start, stop) within the period without samples.
    fixed : (m,) array
        Times within the period that must be sampled.
    sensors : dict of str to Sensor or dict, optional
        Windows, hours, price and result delay per output name. The window then ends with the results that are in: it
        is shorter by the longest `result_delay`, for all outputs. Sigma and its bound are of such windows; what quicker
        sensors read in the rest is in as well and counts in neither, so that a window shows no less than sigma, and
        may show more than the bound. What may say "below its `detection_limit`" counts nothing.
    calendar : OpeningCalendar or dict, optional
        Opening hours of the place on ordinary days from time 0 on, which close what is outside them.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state must be known: names of states or outputs, or the rows themselves
        (`functional_plant`). The window must show them; what else it shows counts nothing. Default: all states.
    cost_limit : float, optional
        Most that the measurements of one period may cost together; the design then chooses which outputs
        each sample measures, at least one.
    time_unit : str, optional
        Unit of all times here; None means the plant's. Needed where `window`, `period` or `spacing` is text with a unit
        of its own ("15 min"), which is held in this one.
    timing_tolerance : float, pair (early, late), or dict of these by output, optional
        How early or late each sample may come, together less than `spacing`: sigma is then the least over all such real
        times too, and the bound is one of that least sigma. A window that just holds a sample may lose it; one that is
        early + late longer than a whole number of gaps does not. Default: a hundredth of `spacing` where no `window` is
        given, else 0: a window that is given is taken as it is, and the design says what is left if samples are late.

    Raises
    ------
    ArgumentError
        If a number is not positive, a count is no whole number, an interval is empty, or text has a unit where
        `time_unit` is missing.

    Notes
    -----
    A sample of several outputs counts once. "at_most" n designs with the most samples that n and the
    spacing allow, since a further sample never lowers sigma; "at_least" n designs with n.

    Examples
    --------
    >>> requirement = Requirement(window=4.0, spacing=0.5, samples=3)
    >>> requirement.samples
    {'exactly': 3}
    >>> print(requirement.explain())
    Exactly 3 samples per period, at least 0.5 apart, window 4.
    """

    _reader: ClassVar[str] = "read_requirement"
    _written = "the requirement"
    _format = FORMAT
    _plain = (
        "format:_format window? period? spacing? target_sigma? cost_limit? time_unit? of? samples? decay_rate "
        "timing_tolerance? forbidden? fixed? sensors? calendar?"
    )
    window: Converted[float | str | None, float | None] = None  # type: ignore[assignment]
    period: Converted[float | str | None, float | None] = None  # type: ignore[assignment]
    spacing: Converted[float | str | None, float | None] = None  # type: ignore[assignment]
    samples: Converted[int | Mapping[str, int] | None, dict[str, int]] = None  # type: ignore[assignment]
    target_sigma: float | None = None
    decay_rate: float = 0.0
    forbidden: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]
    fixed: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]
    sensors: Converted[Mapping[str, Sensor | Mapping[str, object]] | None, Mapping[str, Sensor]] = None  # type: ignore[assignment]
    cost_limit: float | None = None
    of: Converted[Wanted, tuple[str, ...] | Array | None] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    time_unit: str | None = field(default=None, kw_only=True)
    timing_tolerance: Converted[Timing | None, Plain] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    calendar: Converted[Place, OpeningCalendar | None] = field(default=None, kw_only=True)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        own: dict[str, object] = {}
        if self.time_unit is not None:
            check_time_unit(self.time_unit)
        self._check(**dict.fromkeys(("window", "period", "spacing"), self._length))
        self._check(**dict.fromkeys(("target_sigma", "cost_limit"), checks.positive), decay_rate=checks.nonnegative)
        if self.timing_tolerance is not None:
            own["timing_tolerance"] = TimingTolerance.of(self.timing_tolerance, unit=self.time_unit).plain
        own["samples"] = _counts(self.samples)
        own["forbidden"] = intervals("forbidden", () if self.forbidden is None else self.forbidden)
        own["fixed"] = checks.increasing("fixed", () if self.fixed is None else self.fixed)
        terms = checks.mapping("sensors", self.sensors, "a table of terms by output")
        own["sensors"] = {str(k): checks.record(f"sensors.{k}", v, Sensor) for k, v in terms.items()}
        self._check(calendar=lambda name, place: checks.record(name, place, OpeningCalendar))
        for name, term in own["sensors"].items():  # type: ignore[attr-defined]
            for key in ("spacing", "longest_use"):
                if getattr(term, key) is not None:
                    raise ArgumentError(
                        f"`sensors.{name}.{key}` is for plans: a design has one `spacing` and counts samples together."
                    )
        own["of"] = row_arguments(self.of)
        self._hold(**own)
        if self.period is not None:
            self._check_within(self.period)

    def _length(self, name: str, value: object) -> float:
        length = duration(name, value, self.time_unit or "s")
        if is_text(value) and self.time_unit is None:
            raise ArgumentError(
                f"`{name}` = {value!r:.40} has a unit of its own: give `time_unit`, that of all times here."
            )
        return length

    def _check_within(self, period: float) -> None:
        """Refuse times beyond the period; called again when a default period is filled in."""
        spans = [("forbidden", self.forbidden)]
        spans += [
            (f"sensors.{k}.available", v.available)
            for k, v in self.sensors.items()
            if v.available is not None and not isinstance(v.available, tuple)
        ]
        for name, value in spans:
            if value.size and value.max() > period:
                raise ArgumentError(f"`{name}` must lie within the period {period!r}, got {float(value.max())!r}.")
        if self.fixed.size and self.fixed[-1] >= period:
            raise ArgumentError(f"`fixed` must lie in [0, period) = [0, {period!r}), got {float(self.fixed[-1])!r}.")

    def _rows(self) -> list[tuple[str, str]]:
        lengths = {key: getattr(self, key) for key in ("window", "period", "spacing")}
        rows = [(key, "default" if length is None else short(length)) for key, length in lengths.items()]
        if self.of is not None:
            rows.append(("of", rows_in_words(self.of)))
        rows.append(("samples", ", ".join(f"{k} {v}" for k, v in self.samples.items()) or "default"))
        if self.target_sigma is not None:
            rows.append(("target sigma", short(self.target_sigma)))
        rows += [("decay rate", short(self.decay_rate)), ("forbidden", spans_in_words(self.forbidden, "none"))]
        rows.append(("fixed", moment(self.fixed, self.forbidden) if self.fixed.size else "none"))
        rows += [(f"sensor {k}", v.explain()) for k, v in self.sensors.items()]
        if late := TimingTolerance.of(self.timing_tolerance):
            rows.append(("samples come", late.describe()))
        if self.cost_limit is not None:
            rows.append(("cost limit", f"{short(self.cost_limit)} a period"))
        return rows

    def explain(self) -> str:
        """Say the requirement in words; what is left to defaults is not mentioned."""
        counts = " and ".join(f"{k.replace('_', ' ')} {v}" for k, v in self.samples.items())
        parts = [f"{counts} samples per period".capitalize() if counts else "As many samples as the zero count asks"]
        if self.target_sigma is not None:
            parts[0] = f"Fewest samples with sigma >= {short(self.target_sigma)}" + (f", {counts}" if counts else "")
        if self.of is not None:
            parts.append(f"for {rows_in_words(self.of)}")
        if self.spacing is not None:
            parts.append(f"at least {short(self.spacing)} apart")
        parts += [f"{key} {short(v)}" for key in ("window", "period") if (v := getattr(self, key)) is not None]
        if self.forbidden.size:
            parts.append(f"none in {spans_in_words(self.forbidden, '')}")
        if self.fixed.size:
            parts.append(f"always at {moment(self.fixed, self.forbidden)}")
        if late := TimingTolerance.of(self.timing_tolerance):
            parts.append(f"each {late.describe()}")
        if self.cost_limit is not None:
            parts.append(f"cost at most {short(self.cost_limit)} a period")
        return ", ".join(parts) + "."


def _counts(value: object) -> dict[str, int]:
    """The sample count as a dict with "exactly", or with "at_least" and "at_most"."""
    if value is None:
        return {}
    if not is_table(value):
        return {"exactly": checks.whole("samples", value, 1)}
    checks.known_keys("`samples`", value, COUNTS)
    counts = {k: checks.whole(f"samples.{k}", value[k], 1) for k in COUNTS if k in value}
    if "exactly" in counts and len(counts) > 1:
        raise ArgumentError("`samples` must give either exactly or at_least and at_most, got both.")
    if counts.get("at_least", 0) > counts.get("at_most", np.inf):
        raise ArgumentError(f"`samples` asks for at_least {counts['at_least']} and at_most {counts['at_most']}.")
    return counts


_SPANS = list_of(list_of(nonnegative, 2))
_COUNTS = table({}, {**dict.fromkeys(COUNTS, count), "target_sigma": positive})


_OF = by_kind({str: text}, by_first({str: list_of(text)}, matrix()))
"""A name, names, or rows of numbers."""

_EARLY_LATE = by_kind({list: list_of(nonnegative, 2), tuple: list_of(nonnegative, 2)}, nonnegative)
TIMING = by_kind({Mapping: by_name(_EARLY_LATE)}, _EARLY_LATE)
"""One number, early and late, or either by output."""

_TREE = table(
    {"format": word(FORMAT)},
    {
        **dict.fromkeys(("window", "period", "spacing"), DURATION),
        **dict.fromkeys(("target_sigma", "cost_limit"), positive),
        "samples": by_kind({Mapping: _COUNTS}, count),
        "decay_rate": nonnegative,
        "timing_tolerance": TIMING,
        "forbidden": _SPANS,
        "fixed": list_of(nonnegative),
        "sensors": by_name(SENSOR),
        "calendar": CALENDAR,
        "of": _OF,
        "time_unit": time_unit,
    },
    whole="the requirement",
)


@checked
def read_requirement(path: str | os.PathLike[str]) -> Requirement:
    """Read a requirement from a `.toml` or `.json` file.

    Parameters
    ----------
    path : path
        The format is told by the ending.

    Returns
    -------
    Requirement

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, of another format, has an unknown key, or holds a value that
        `Requirement` refuses; the message names the file.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> wanted = 'format = "sampling-design/requirement/1"\\nwindow = 4.0\\nsamples = 3'
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "wanted.toml"
    ...     characters = path.write_text(wanted)
    ...     found = read_requirement(path)
    >>> found.window, found.samples
    (4.0, {'exactly': 3})
    """
    return requirement_from_dict(read_tree(path), os.fspath(path))


@checked
def requirement_from_dict(data: Mapping[str, object], where: str = "requirement") -> Requirement:
    """Return the requirement in a tree of plain data; the inverse of `Requirement.to_dict`.

    Parameters
    ----------
    data : dict
        The tree of a requirement file, its "format" included.
    where : str
        Named in messages, in general the path.

    Returns
    -------
    Requirement

    Raises
    ------
    FileFormatError
        As for `read_requirement`.
    """
    with usable(where):
        tree = of_format(_TREE, data, FORMAT)
        samples = tree.get("samples")
        if is_table(samples) and "target_sigma" in samples:  # both places are in use
            if "target_sigma" in tree:
                raise ArgumentError("`target_sigma` is given twice, beside `samples` and inside it.")
            tree["samples"] = {k: v for k, v in samples.items() if k != "target_sigma"}
            tree["target_sigma"] = samples["target_sigma"]
        tree["sensors"] = from_files(tree.get("sensors"), where)
        return Requirement(**tree)


@checked
def write_requirement(requirement: Requirement, path: str | os.PathLike[str]) -> Path:
    """Write a requirement as `.toml` or `.json`, whole or not at all.

    Parameters
    ----------
    requirement : Requirement
    path : path
        The format is told by the ending.

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    FileFormatError
        If the ending is neither, or the file cannot be written.
    """
    return write_tree(path, requirement.to_dict(), "a requirement")
