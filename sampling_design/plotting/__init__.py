"""The only door to matplotlib: which picture belongs to which record."""

from __future__ import annotations

import inspect
import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from sampling_design.errors import ArgumentError, CallError
from sampling_design.records import file_io
from sampling_design.records.checks import described, meant
from sampling_design.records.dispatch import register

# record -> (file of this room, function), also for what is derived from it; one without a picture is not listed
_PICTURES = {
    "Schedule": ("designs", "draw_schedule"),
    "PeriodicSchedule": ("designs", "draw_schedule"),
    "SamplingFamily": ("designs", "draw_family"),
    "WindowSigma": ("designs", "draw_window_sigma"),
    "ScheduleDesign": ("designs", "draw_design"),
    "Plan": ("plans", "draw_plan"),
    "PlanComparison": ("plans", "draw_plan_comparison"),
    "PatientRun": ("thyroid", "draw_patient_run"),
    "PatientFigure": ("thyroid", "draw_figure"),
    "Accuracy": ("accuracy", "draw_accuracy"),
    "Projection": ("accuracy", "draw_projection"),
    "WorstCaseSigma": ("designs", "draw_worst_case"),
    "ParetoFront": ("designs", "draw_pareto"),
    "SampleLosses": ("designs", "draw_losses"),
    "Certificate": ("certificates", "draw_certificate"),
    "FamilyCertificate": ("certificates", "draw_family_certificate"),
    "InclusionCertificate": ("certificates", "draw_inclusion"),
    "InformationCurve": ("certificates", "draw_information"),
    "TradeoffCurve": ("certificates", "draw_tradeoff"),
    "Robustness": ("certificates", "draw_robustness"),
    "FourHorizons": ("certificates", "draw_four_horizons"),
    "Counterexample": ("modes", "draw_counterexample"),
    "ModalSplit": ("modes", "draw_split"),
    "Measurements": ("estimates", "draw_measurements"),
    "SimulatedRecord": ("estimates", "draw_simulated"),
    "SmoothedWindow": ("estimates", "draw_smoothed"),
    "EstimateRecord": ("estimates", "draw_estimates"),
    "EstimateCurve": ("estimates", "draw_curve"),
    "EstimateEnvelope": ("estimates", "draw_envelope"),
    "ValidationReport": ("validation", "draw_validation"),
    "ScheduleLog": ("validation", "draw_schedule_log"),
}

register("plot", object, f"{__name__}:draw")
register("picture", object, f"{__name__}:picture_of")


def picture_of(record: object) -> tuple[str, str] | None:
    """Return which file of this room, and which function in it, draws a record; None where there is no picture."""
    return next((_PICTURES[each.__name__] for each in type(record).__mro__ if each.__name__ in _PICTURES), None)


def draw(record: object, ax: object = None, **beside: object) -> Any:
    """Draw `record` and return the axes (a list of axes where the picture has several); a notebook shows them.

    `beside` is what some pictures show beside the record, such as the measurements of estimates. Raises ArgumentError
    if there is no picture for this kind of record, or `ax` is no axes.
    """
    picture = picture_of(record)
    if picture is None:
        drawn = "schedules, designs, plans, certificates, accuracies, estimates and reports have"
        raise ArgumentError(f"`record` has no picture of its own, got {described(record)}: {drawn}.")
    _check_axes(ax)
    room, function = picture
    drawing = getattr(import_module(f"sampling_design.plotting.{room}"), function)
    _, _, *known = inspect.signature(drawing).parameters
    for key in beside:
        if key not in known:
            slip = meant(key, ["ax", *known])
            raise CallError(f"`plot` of a {type(record).__name__} has no argument `{key}`. {slip}")
    drawn = drawing(record, ax, **beside)
    _as_typed(drawn)
    return drawn


def _as_typed(drawn: object) -> None:
    """Show a name with dollars as it is where they hold no formula that matplotlib reads."""
    from matplotlib.axis import Axis
    from matplotlib.mathtext import MathTextParser
    from matplotlib.text import Text
    from matplotlib.ticker import FixedLocator

    artists = [np.ravel(np.asarray(drawn, dtype=object))[0].figure]
    for artist in artists:
        match artist:
            case Text() if artist.get_text().count("$") > 1:
                try:
                    MathTextParser("path").parse(artist.get_text())
                except ValueError:
                    artist.set_parse_math(False)
            case Axis() if type(artist.get_major_locator()) is not FixedLocator:
                artists.append(artist.label)  # at its ticks are numbers and dates, and to ask for them makes them all
            case _:
                artists += artist.get_children()


def _check_axes(ax: object) -> None:
    """Refuse what is no axes; several of them come as a list or an array."""
    each = list(np.ravel(np.asarray(ax, dtype=object))) if isinstance(ax, (list, tuple, np.ndarray)) else [ax]
    if ax is not None and not (each and all(hasattr(a, "plot") and hasattr(a, "transAxes") for a in each)):
        raise ArgumentError(f"`ax` must be axes of matplotlib, or None for a new figure, got {described(ax)}.")


def save(record: object, path: str | os.PathLike[str], dpi: int = 130, **beside: object) -> Path:
    """Draw `record` into a new figure and write it to `path` (.png, .svg or .pdf), whole or not at all.

    What the record explains stands in the file as its description. Raises ArgumentError if there is no picture for this
    kind of record, or the suffix is not a picture's.
    """
    import io

    target = Path(path)
    kind = target.suffix.lstrip(".")
    if kind not in ("png", "svg", "pdf"):
        raise ArgumentError(f"`path` must end in .png, .svg or .pdf, got {str(path)!r}.")
    axes = draw(record, **beside)
    first = axes[0] if isinstance(axes, list | tuple) else axes
    # no date and no version inside, so that the same result is the same file
    words = str(record.explain())  # type: ignore[attr-defined]  # every record that has a picture has words
    metadata = {
        "svg": {"Date": None, "Description": words},
        "pdf": {"CreationDate": None, "Subject": words},
        "png": {"Software": None, "Description": words},
    }[kind]
    buffer = io.BytesIO()
    first.figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    return file_io.write_bytes(target, buffer.getvalue())
