"""Sample times moved apart, so that more losses by chance are borne."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._door import door
from sampling_design.errors import ArgumentError
from sampling_design.observability.count.loss_tolerance import (
    LossTolerance,
    hidden_rows,
    largest_hidden,
    loss_tolerance,
)
from sampling_design.observability.meeting import meet
from sampling_design.plants.modes import split_modes
from sampling_design.plants.plant import Plant
from sampling_design.schedules.schedule import Details, PeriodicSchedule

Array = npt.NDArray[np.float64]

DRAWS = 32
"""Random moves that are looked at by default."""

CLOSE = 0.05
"""Samples that show less of a direction than this share of their rows count as hidden where moves are compared: among
moves that bear the same, those whose samples see plainly different directions are better for records that are short."""


@door
def design_against_losses(
    plant: Plant,
    schedule: PeriodicSchedule,
    leeway: npt.ArrayLike,
    *,
    periods: int = 4,
    draws: int = DRAWS,
    rng: np.random.Generator | None = None,
) -> tuple[PeriodicSchedule, LossTolerance]:
    """Move samples by at most `leeway` so that a larger probability of losses is borne; as many samples as before.

        p* = exp(-2 a L P/(L N - K_L)) -> exp(-2 a/rho) as fewer samples are hidden together

    What is hidden together in every period is what an exact period repeats; moved each in its own way over several
    periods, which become one, hardly more than n - 1 samples miss one direction.

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule
    leeway : float or (k,) array_like [time]
        How far each sample of a period may move, either way; 0 for those that may not.
    periods : int
        Periods of `schedule` that become one period.
    draws : int
        Random moves that are looked at.
    rng : numpy.random.Generator, optional
        Default: seeded with 0.

    Returns
    -------
    schedule : PeriodicSchedule
        With `periods` times as many samples a period; `schedule` itself where no move is better.
    tolerance : LossTolerance
        Of that schedule: `lower` is proven, and never less than that of `schedule`.

    Raises
    ------
    ArgumentError
        If `leeway` is negative or half the least gap or more, so that samples could change places; or as in
        `loss_tolerance`.
    NotObservableError
        As in `loss_tolerance`.

    Notes
    -----
    *Claim.* The tolerance is that of `loss_tolerance`, proven for the very times returned; that no other move bears
    more is not claimed, but `limit` says what none exceeds.

    Examples
    --------
    >>> plant = Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])
    >>> even = PeriodicSchedule(np.full(4, np.pi / 2))
    >>> moved, tolerance = design_against_losses(plant, even, 0.3)
    >>> round(loss_tolerance(plant, even).lower, 3), round(tolerance.lower, 3), round(tolerance.limit, 3)
    (0.533, 0.715, 0.73)
    """
    schedule = meet(plant, schedule)
    count, k = _checks.whole("periods", periods, 1), len(schedule)
    draws = _checks.whole("draws", draws, 1)
    alike = np.isscalar(leeway)
    reach = np.full(k, _checks.number("leeway", leeway)) if alike else _checks.vector("leeway", leeway, k)
    gaps = np.diff(np.append(schedule.times, schedule.times[0] + schedule.period))
    if np.any(reach < 0) or 2 * float(np.max(reach)) >= float(gaps.min()):
        raise ArgumentError(
            f"`leeway` must be at least 0 and less than half the least gap, {float(gaps.min()) / 2:g}, so that "
            f"samples keep their order, got {float(reach[np.argmax(np.abs(reach))]):g}."
        )
    rng = np.random.default_rng(0) if rng is None else rng
    times = (schedule.times + schedule.period * np.arange(count)[:, None]).ravel()
    mask = None if schedule.outputs is None else np.tile(schedule.outputs, (count, 1))
    details = Details(time_unit=schedule.time_unit, output_names=schedule.output_names)
    best, found = schedule, loss_tolerance(plant, schedule)
    apart = -_close(plant, schedule, count)
    for _ in range(draws if found.growth and np.any(reach > 0) else 0):
        moves = rng.uniform(-1.0, 1.0, (count, k)) * reach
        moved = times + moves.ravel()
        turned = np.mod(moved, count * schedule.period)
        order = np.argsort(turned, kind="stable")
        trial = PeriodicSchedule.from_times(
            turned[order], count * schedule.period, None if mask is None else mask[order], **details
        )
        tolerance, clear = loss_tolerance(plant, trial), -_close(plant, trial, 1)
        if (tolerance.lower, clear) > (found.lower, apart):
            best, found, apart = trial, tolerance, clear
    return best, found


def _close(plant: Plant, schedule: PeriodicSchedule, periods: int) -> float:
    """How many samples of some periods all see next to nothing of one direction; infinite where that is not found."""
    kept = split_modes(plant).retained
    if not kept.n_states:
        return 0.0
    growth = float(np.max(np.linalg.eigvals(kept.A).real))
    largest = largest_hidden(hidden_rows(kept, schedule, periods, growth), CLOSE)
    return np.inf if largest is None else float(len(largest))
