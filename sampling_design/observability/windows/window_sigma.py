"""Sigma over every real position of a sliding window: a proven lower and an attained upper bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import align
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.sigma_bracket import SHARE, SigmaBracket, SigmaDeviations, uninterrupted
from sampling_design.observability.windows.pieces import WindowPieces, window_pieces
from sampling_design.observability.windows.window_record import RTOL, WindowSigma, checked_pieces, sigma_of_pieces
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.record import short
from sampling_design.records.signatures import open_verb
from sampling_design.schedules.jitter import ON_TIME, Timing, TimingTolerance
from sampling_design.schedules.sampling_set import SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

LeastOf: TypeAlias = Callable[[WindowPieces, float, float], tuple[float, float]]
"""Proven and attained sigma of some pieces, in so many seconds; what sees more than a number needs no close look."""
LeastLost: TypeAlias = Callable[[WindowPieces, Budget], tuple[float, int]]
"""Proven sigma if any one sample is lost once, and whose loss leaves that."""
DEVIATION_RTOL = 0.01  # width of the brackets here: they say how steep the ground is, not where it lies


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
        found = sigma_of_pieces(plant, schedule, pieces, DEVIATION_RTOL, seconds, reached=reached, handed_over=0.0)
        return uninterrupted(found).lower, found.upper

    def lost(pieces: WindowPieces, limit: Budget) -> tuple[float, int]:
        return lost_one_by_one(least, plant.n_outputs, len(schedule), pieces, limit)

    limit = Budget(seconds)
    found = left_of_sigma(
        schedule, window, least, lost, plant.time_unit, asked=asked, sigma=sigma, start=start, seconds=limit.left
    )
    if found is None or max(found.late, found.late_wider, found.lost) > 0:
        return found
    # where growth within the window hides sigma itself from doubles they say nothing of what is left of it
    pieces = window_pieces(schedule, window, start, asked)
    whole = sigma_of_pieces(plant, schedule, pieces, DEVIATION_RTOL, limit.left, handed_over=0.0)
    return None if whole.status == "below rounding" else found


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
    sooner = None if start is None else start - tolerance.radius  # what is wider begins as much before

    def left(length: float, start: float | None) -> float:
        if length <= 2 * tolerance.radius:
            return 0.0
        return min(sigma, least(window_pieces(schedule, length, start, tolerance), limit.left, np.inf)[0])

    fewer, worst = lost(window_pieces(schedule, window, start, asked), limit)
    # what is longer from where a window starts sees no less: where sigma is of late samples, longer windows have it too
    wider = sigma if asked else 0.0 if limit.over else left(window + 2 * tolerance.radius, sooner)
    late = sigma if asked or limit.over else left(window, start)
    if limit.over:
        return None
    return SigmaDeviations(tolerance, late, wider, min(fewer, sigma), worst, time_unit, bool(asked))


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


@open_verb(SigmaBracket)
def window_sigma(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    window: float,
    rtol: float | None = None,
    *,
    of: Wanted = None,
    timing_tolerance: Timing = 0.0,
    start: float | None = None,
    rigorous: bool = False,
    budget: float | None = None,
    progress: Progress | None = None,
) -> WindowSigma:
    """Bound sigma over all real positions of a sliding window.

        sigma = inf over real t of sigma_n(rows C e^{A (tau - (t - T))}, tau in [t - T, t])

    Parameters
    ----------
    plant : Plant, UncertainPlant or TimeVaryingPlant
        With constant parameters in a box: the least sigma over every plant of the box too. One that varies in time: a
        finite schedule within its horizon, rows C(tau) Phi(tau, t - T); proven of a table, not of functions.
    schedule : Schedule or PeriodicSchedule
        A finite schedule is judged from the window that begins with its first sample (or at `start`) to the one that
        ends with its last; an endless one from time 0 (or `start`) on, for ever.
    window : float [plant.time_unit]
        Length T > 0.
    rtol : float
        The search ends when lower >= (1 - rtol) upper; in (0, 1). Default 0.001, over a box or in varying time 0.01.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows (`functional_plant`). Sigma is then the
        least |O x| over |H x|, in coordinates that the rows share with states that count next to nothing.
        Default: all states.
    timing_tolerance : float, pair (early, late), or dict of these by output [plant.time_unit]
        How early or late each sample may be, together less than the least gap: the least sigma over all such real times
        too. A window that just holds a sample may lose it then; in windows of T + early + late, which hold all samples
        planned in T, sigma falls to that of T continuously. By output: those of one sample may fall apart, each within
        its own; a window counts with a sample only where it is sure of all its outputs. Of exactly known plants.
    start : float, optional [plant.time_unit]
        Where the first window begins. Of a finite schedule such as 0, where the plan counts from there and not from its
        first sample; of an endless one whose `first` comes late such as `first`, to judge its rhythm alone.
    rigorous : bool
        Prove `lower` anew in ball arithmetic (extra `rigorous`), at most 1e-6 of it given away; `budget` then holds
        for that proof too. Growth within the window hides nothing from balls: e^200 is no obstacle. Over a box every
        cell is proven so (growth that hides sigma from doubles hides it there).
    budget : float, optional [seconds]
        When it runs out, the bounds so far are returned with closed = False; so they are after an interrupt (Ctrl-C).
    progress : callable, optional
        Called with the fraction done and a message.

    Returns
    -------
    WindowSigma, or WindowSigmaOverBox
        lower = upper = 0 where a window holds fewer measurements than states; infinity for a plant
        without states.

    Raises
    ------
    ArgumentError
        If plant and schedule do not fit, or the window is not positive or longer than the schedule.
    MissingExtraError
        If `rigorous` is asked for and python-flint is not installed.

    Notes
    -----
    *Claim.* `lower` holds for every real t, the limits just after a sample leaves included (there the
    infimum is often attained). Sigma refers to the state at the window's *start*: of a plant with scales in scaled
    coordinates, x/s_x and y/s_y, else in physical ones (those of a plant with scales: `plant.unscaled()`).
    *Method.* Between two events all relative times shift together, O(s) = O(b) e^{A(b-s)}, so that
    1/sigma(s) = |F(s)| with F(s) = e^{-A(b-s)} O(b)^+. A norm is convex: |F| lies below its chord plus
    (h^2/8) max |A^2 F|, an error of second order, relative to 1/sigma itself whatever the condition
    of O. Intervals are halved, all at once, until each is closed.
    *Numerical aspects.* The lower bound is reduced by the named allowance of `bracket.ALLOWANCE`.
    Sigma counts as zero below n eps |O|; then lower = 0 and the witness holds the unobservable direction. Where the
    rows grow within the window, so that this says little, sigma is asked of ball arithmetic (extra `rigorous`), which
    growth does not hide it from; it then counts as zero below n eps |C|, and `rigorous` of the record is true.
    Events that coincide to rounding (`pieces.SAME_TIME`) are one event.
    *Deviations.* `deviations` of the record says what is left where samples come a hundredth of the least gap early or
    late (or as was asked), in windows of T and in such that hold what was planned in T, and where one is lost; within
    what is left of a `budget`.
    *Late samples.* See `timing`: the planned samples of the window that is shorter at both ends, less what moving them
    can take away; `upper` is attained by real times that a search found.

    References
    ----------
    The paper, Theorem 14: its hypothesis, for all real t >= T.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> sigma = window_sigma(plant, PeriodicSchedule([1.0]), 2.0)
    >>> sigma.witness.samples.size, round(sigma.upper, 6)
    (2, 0.381966)
    >>> window_sigma(plant, PeriodicSchedule([1.0]), 1.0).upper
    0.0
    """
    plant = part_for(plant, of, window)
    aligned = align(plant, schedule)
    late = TimingTolerance.of(timing_tolerance, plant.outputs.names, plant.time_unit)
    if late:
        aligned = aligned.primitive() if aligned.endless else aligned  # each window is looked at closely
        late.require_order(SamplingSet(aligned).min_gap)
        if rigorous:
            raise ArgumentError("`rigorous` is for exact sample times: leave it or `timing_tolerance` out.")
        if not 2 * late.radius < checks.positive("window", window):
            raise ArgumentError(
                f"`window` must be longer than early and late together, {short(2 * late.radius)}, got {short(window)}: "
                "no sample is certain to lie in it."
            )
    pieces, tolerance, seconds = checked_pieces(aligned, window, start, RTOL if rtol is None else rtol, budget, late)
    limit = Budget(seconds)
    found = sigma_of_pieces(plant, aligned, pieces, tolerance, seconds, progress, rigorous=rigorous)
    beside = partial(deviations_of, plant, aligned, window, late, found.lower, start, limit.left)
    return replace(found, beside=beside)
