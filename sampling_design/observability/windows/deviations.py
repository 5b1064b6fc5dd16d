"""What a schedule keeps of sigma if samples come a little early or late, and if one is lost."""

from __future__ import annotations

import numpy as np

from sampling_design.observability.sigma_bracket import SHARE, SigmaDeviations
from sampling_design.observability.windows.pieces import Pieces, window_pieces
from sampling_design.observability.windows.window_record import WindowSigma, sigma_of_pieces
from sampling_design.plants.plant import Plant
from sampling_design.records.budget import Budget
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.sampling_set import SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

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
    limit = Budget(seconds)
    least = SamplingSet(schedule).min_gap
    tolerance = asked or TimingTolerance.of(SHARE * (least if np.isfinite(least) else window))

    def left(length: float) -> float:
        if length <= 2 * tolerance.radius:
            return 0.0
        pieces = window_pieces(schedule, length, start, tolerance)
        return min(sigma, sigma_of_pieces(plant, schedule, pieces, RTOL, limit.left, handed_over=0.0).lower)

    lost, worst = _lost(plant, schedule, window_pieces(schedule, window, start, asked), limit)
    wider = 0.0 if limit.over else left(window + 2 * tolerance.radius)
    late = sigma if asked or limit.over else left(window)
    if limit.over or (not max(late, wider, lost) > 0 and _is_hidden(plant, schedule, window, start, asked)):
        return None
    return SigmaDeviations(tolerance, late, wider, min(lost, sigma), worst, plant.time_unit, bool(asked))


def _is_hidden(
    plant: Plant, schedule: Schedule | PeriodicSchedule, window: float, start: float | None, asked: TimingTolerance
) -> bool:
    """Whether growth within the window hides sigma itself from doubles: then they say nothing of what is left of it."""
    pieces = window_pieces(schedule, window, start, asked)
    return sigma_of_pieces(plant, schedule, pieces, RTOL, np.inf, handed_over=0.0).status == "below rounding"


def _lost(plant: Plant, schedule: Schedule | PeriodicSchedule, pieces: Pieces, limit: Budget) -> tuple[float, int]:
    """Proven sigma if any one sample is lost once, and whose loss leaves that: over the windows that could hold it.

    What sees more than the worst that was found by then is not looked at closely.
    """
    found: WindowSigma | None = None
    least, worst = np.inf, 0
    for k in range(int(pieces.first.min()), int(pieces.stop.max())):
        part = pieces.losing(k, plant.n_outputs)
        if part is None:
            continue
        if limit.over:
            break
        seen = sigma_of_pieces(plant, schedule, part, RTOL, limit.left, reached=found, handed_over=0.0)
        if seen.lower < least:
            least, worst = seen.lower, k % len(schedule)
        found = seen if found is None or seen.upper < found.upper else found
    return least, worst
