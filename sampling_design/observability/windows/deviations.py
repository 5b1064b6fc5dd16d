"""What a schedule keeps of sigma if samples come a little early or late, and if one is lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from sampling_design.observability.sigma_bracket import SHARE, SigmaDeviations
from sampling_design.observability.windows.pieces import WindowPieces, window_pieces
from sampling_design.observability.windows.window_record import sigma_of_pieces
from sampling_design.plants.plant import Plant
from sampling_design.records.budget import Budget
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.sampling_set import SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

LeastOf: TypeAlias = Callable[[WindowPieces, float, float], tuple[float, float]]
"""Proven and attained sigma of some pieces, in so many seconds; what sees more than a number needs no close look."""
LeastLost: TypeAlias = Callable[[WindowPieces, Budget], tuple[float, int]]
"""Proven sigma if any one sample is lost once, and whose loss leaves that."""
RTOL = 0.01  # width of the brackets here: they say how steep the ground is, not where it lies


def deviations_of(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    window: float,
    asked: TimingTolerance = ON_TIME,
    sigma: float = np.inf,
    start: float | None = None,
    seconds: float = np.inf,
) -> SigmaDeviations | None:
    """Prove what is left of `sigma` if samples come early or late, or one is lost; None where `seconds` are too few.

    As early or late as was `asked`, for which `sigma` is proven, else by a share of the least gap (of a window, where
    there is one sample). None, too, where doubles do not show sigma itself, which ball arithmetic may prove.
    """

    def least(pieces: WindowPieces, seconds: float, reached: float) -> tuple[float, float]:
        found = sigma_of_pieces(plant, schedule, pieces, RTOL, seconds, reached=reached, handed_over=0.0)
        return found.lower, found.upper

    def lost(pieces: WindowPieces, limit: Budget) -> tuple[float, int]:
        return lost_one_by_one(least, plant.n_outputs, len(schedule), pieces, limit)

    found = left_of_sigma(
        schedule, window, least, lost, plant.time_unit, asked=asked, sigma=sigma, start=start, seconds=seconds
    )
    if found is None or max(found.late, found.late_wider, found.lost) > 0:
        return found
    return None if _is_hidden(plant, schedule, window, start, asked) else found


def left_of_sigma(
    schedule: Schedule | PeriodicSchedule,
    window: float,
    least: LeastOf,
    lost: LeastLost,
    time_unit: str,
    asked: TimingTolerance = ON_TIME,
    sigma: float = np.inf,
    start: float | None = None,
    seconds: float = np.inf,
) -> SigmaDeviations | None:
    """Prove the same of a plant of any kind; None where `seconds` are too few."""
    limit = Budget(seconds)
    gap = SamplingSet(schedule).min_gap
    tolerance = asked or TimingTolerance.of(SHARE * (gap if np.isfinite(gap) else window))

    def left(length: float) -> float:
        if length <= 2 * tolerance.radius:
            return 0.0
        return min(sigma, least(window_pieces(schedule, length, start, tolerance), limit.left, np.inf)[0])

    fewer, worst = lost(window_pieces(schedule, window, start, asked), limit)
    wider = 0.0 if limit.over else left(window + 2 * tolerance.radius)
    late = sigma if asked or limit.over else left(window)
    if limit.over:
        return None
    return SigmaDeviations(tolerance, late, wider, min(fewer, sigma), worst, time_unit, bool(asked))


def _is_hidden(
    plant: Plant, schedule: Schedule | PeriodicSchedule, window: float, start: float | None, asked: TimingTolerance
) -> bool:
    """Whether growth within the window hides sigma itself from doubles: then they say nothing of what is left of it."""
    pieces = window_pieces(schedule, window, start, asked)
    return sigma_of_pieces(plant, schedule, pieces, RTOL, np.inf, handed_over=0.0).status == "below rounding"


def lost_one_by_one(
    least: LeastOf, outputs: int, samples: int, pieces: WindowPieces, limit: Budget
) -> tuple[float, int]:
    """Prove sigma if any one sample is lost once, over the windows that could hold it, and say whose loss leaves that.

    What sees more than the worst that was found by then is not looked at closely.
    """
    fewer, reached, worst = np.inf, np.inf, 0
    for k in range(int(pieces.first.min()), int(pieces.stop.max())):
        part = pieces.losing(k, outputs)
        if part is None:
            continue
        if limit.over:
            break
        lower, upper = least(part, limit.left, reached)
        if lower < fewer:
            fewer, worst = lower, k % samples
        reached = min(reached, upper)
    return fewer, worst
