"""Sigma over every real position of a sliding window: a proven lower and an attained upper bound."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from importlib.util import find_spec

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import meet
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.sigma_bracket import (
    NO_STATES,
    SigmaBracket,
    coordinates_of,
    in_balls,
    rtol_and_seconds,
)
from sampling_design.observability.windows.bracket import WindowBracket, bracket_sigma
from sampling_design.observability.windows.pieces import Pieces, WindowWitness, window_pieces
from sampling_design.observability.windows.timing import MOST_TRIED, middle_rows, moved_window
from sampling_design.plants.functional import FunctionalPlant
from sampling_design.plants.plant import Plant
from sampling_design.plants.rows import Wanted
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Integers
from sampling_design.records.declarations import Column
from sampling_design.records.evidence import Claim
from sampling_design.records.progress import Progress
from sampling_design.records.record import CurveRecord, Plain, TableRecord, Variable, short
from sampling_design.records.signatures import open_verb
from sampling_design.schedules.jitter import ON_TIME, Timing, TimingTolerance
from sampling_design.schedules.sampling_set import SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

RTOL = 0.001
"""Default width of the bracket, relative."""
HIDING = 1e3
"""Growth within a window from which on a sigma that doubles lose is asked of balls: n eps |O| is then far above the
n eps |C| below which sigma counts as zero."""
HANDED_OVER = 20.0
"""Seconds that balls have for what was only asked of floats."""
_REASONS = {
    "budget": "the budget ran out before the bracket closed; more time narrows it",
    "interrupted": "the search was interrupted before the bracket closed; more time narrows it",
    "rounding": "rounding in the exponentials keeps the bracket open; scale the plant",
    "timing": "what late and early samples may take away is bounded no better",
}


@dataclass(frozen=True)
class WindowProfile:
    """Sigma over the window's end, for pictures: one curve per piece, with a jump between two pieces.

    `t`, `sigma` and `piece` hold the points, ordered; the ends of a piece are one-sided limits.
    `start`, `stop` and `lower` hold for each piece its interval of window ends and its proven bound.
    """

    t: Array
    sigma: Array
    piece: Integers
    start: Array
    stop: Array
    lower: Array


@dataclass(frozen=True, eq=False, repr=False)
class WindowSigma(SigmaBracket, TableRecord, CurveRecord):
    """Bounds on the least sigma over all real positions of a window along one schedule.

    Attributes
    ----------
    lower : float
        Proven for every real position, limits just after a departure or before an arrival included.
    upper : float
        Attained at `witness`.
    witness : WindowWitness
    status : str
        Why the search ended: "closed", "too few samples", "below rounding", "budget", "interrupted", "rounding",
        "timing" where late and early samples leave the bracket wider than `rtol`, "no states", or "sampled" where the
        plant varies in time by functions: `lower` is 0 then, and nothing is proven.
    window : float
    from_time : float
        Every window that begins then or later is covered: 0 for an endless schedule, the first sample of a finite one,
        or what `start` said.
    profile : WindowProfile
    coordinates : str
        Which both bounds and the witness's direction refer to: "scaled" (x/s_x, y/s_y) where the plant has scales, else
        "physical".
    time_unit : str
    timing_tolerance : float, pair of floats, or dict of these
        Both bounds are those of all real times that are so early or late: the witness holds such times, the profile is
        of samples at their centres, in windows as much shorter at both ends.
    rigorous : bool
        Whether `lower` is proven in ball arithmetic, a theorem about the stated doubles.
    slack : float
        With `rigorous`: the windows of that theorem are [t - T - slack, t + slack]. Zero unless samples leave and
        arrive within rounding of each other, which count as one event.
    """

    witness: WindowWitness
    window: float
    profile: WindowProfile
    from_time: float = field(default=0.0, kw_only=True)
    time_unit: str = field(default="s", kw_only=True)
    slack: float = field(default=0.0, kw_only=True)
    late: TimingTolerance = field(default=ON_TIME, kw_only=True)

    _plain = (
        "lower upper closed status window from_time rtol time_unit refers_to:_refers_to rigorous slack "
        "timing_tolerance witness{t side samples direction} coordinates claim"
    )
    _refers_to = "the state at the window's start"

    _table = {
        **SigmaBracket._table,
        "worst window ends": "{witness.position} {time_unit}",
        "samples in it": "{witness.samples.size}",
        "window": "{window} {time_unit}, from {from_time} {time_unit} on",
        "samples come": "{_late}",
        "status": "{status}",
    }

    @property
    def claim(self) -> Claim:
        """What `lower` claims, and on what grounds."""
        wider = f", samples in [t - T - {self.slack:.3g}, t + {self.slack:.3g}]" if self.slack else ""
        return Claim(
            f"sigma_n(O_s e^(-A(t-T))) >= {short(self.lower)} for every real window end t >= T + "
            f"{short(self.from_time)}, T = {short(self.window)}{wider}",
            theorem="Theorem 14, hypothesis" + (", in ball arithmetic" if self.rigorous else ""),
            assumptions=(
                f"the plant's matrices are exact, samples are {self._late()}"
                if self.late
                else "the plant's matrices and the sample times are exact",
                f"{self.coordinates} coordinates",
            ),
        )

    def _variables(self) -> dict[str, Variable]:
        profile, time = self.profile, self.time_unit
        return {
            "window_end": Variable(("point",), profile.t, time),
            "sigma": Variable(("point",), profile.sigma),
            "piece_of": Variable(("point",), profile.piece),
            "piece": Variable(("piece",), np.unique(profile.piece)),
            "start": Variable(("piece",), profile.start, time),
            "stop": Variable(("piece",), profile.stop, time),
            "proven": Variable(("piece",), profile.lower),
        }

    def _columns(self) -> dict[str, Column]:
        profile = self.profile
        proven = profile.lower[np.searchsorted(np.unique(profile.piece), profile.piece)]
        return {"window_end": profile.t, "sigma": profile.sigma, "piece": profile.piece, "proven": proven}

    @property
    def timing_tolerance(self) -> Plain:
        """How early or late each sample may be, as it is written."""
        return self.late.plain

    def _late(self) -> str | None:
        return self.late.describe(self.time_unit) if self.late else None

    def explain(self) -> str:
        """Say what was proven, where the worst window is, and why a bracket did not close."""
        where = (
            f"The worst window ends {self.witness.position} {self.time_unit} with {self.witness.samples.size} samples"
        )
        if self.status == "no states":
            return NO_STATES
        if self.status == "too few samples":
            empty = " The window is shorter than a gap." if self.witness.samples.size == 0 else ""
            return f"{where}, too few for {self.witness.direction.size} states: sigma is 0.{empty}"
        if self.status == "below rounding":
            hidden = "" if self.rigorous else " What growth hides from doubles, ball arithmetic sees: extra `rigorous`."
            state = short(self.witness.direction)
            return f"{where}; it does not see the state {state}: sigma is zero to rounding.{hidden}"
        length = f"{short(self.window)} {self.time_unit}"
        if self.status == "sampled":
            return (
                f"Sigma falls to {short(self.upper)} among the windows of {length} that were looked at; nothing is "
                f"proven, as A is a function of time and no table. {where}."
            )
        later = f" from {short(self.from_time)} {self.time_unit} on" if self.from_time else ""
        later += f", for samples {self._late()}" if self.late else ""
        proven = f"Sigma is at least {short(self.lower)} over every window of {length}{later} ({self._grounds})"
        return self._concluded(proven, where, _REASONS)


@open_verb(SigmaBracket)
def window_sigma(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    window: float,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    rigorous: bool = False,
    start: float | None = None,
    timing_tolerance: Timing = 0.0,
    of: Wanted = None,
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
    budget : float, optional [seconds]
        When it runs out, the bounds so far are returned with closed = False; so they are after an interrupt (Ctrl-C).
    progress : callable, optional
        Called with the fraction done and a message.
    rigorous : bool
        Prove `lower` anew in ball arithmetic (extra `rigorous`), at most 1e-6 of it given away; `budget` then holds
        for that proof too. Growth within the window hides nothing from balls: e^200 is no obstacle. Over a box every
        cell is proven so (growth that hides sigma from doubles hides it there).
    start : float, optional [plant.time_unit]
        Where the first window begins. Of a finite schedule such as 0, where the plan counts from there and not from its
        first sample; of an endless one whose `first` comes late such as `first`, to judge its rhythm alone.
    timing_tolerance : float, pair (early, late), or dict of these by output [plant.time_unit]
        How early or late each sample may be, together less than the least gap: the least sigma over all such real times
        too. A window that just holds a sample may lose it then; in windows of T + early + late, which hold all samples
        planned in T, sigma falls to that of T continuously. By output: those of one sample may fall apart, each within
        its own; a window counts with a sample only where it is sure of all its outputs. Of exactly known plants.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows (`functional_plant`). Sigma is then the
        least |O x| over |H x|, in coordinates that the rows share with states that count next to nothing.
        Default: all states.

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
    Sigma counts as zero below n eps |O|; then lower = 0 and the witness holds the unseen direction. Where the rows grow
    within the window, so that this says little, sigma is asked of ball arithmetic (extra `rigorous`), which growth
    does not hide it from; it then counts as zero below n eps |C|, and `rigorous` of the record is true.
    Events that coincide to rounding (`pieces.SAME_TIME`) are one event.
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
    aligned = meet(plant, schedule)
    late = TimingTolerance.of(timing_tolerance, plant.outputs.names)
    if late:
        late.require_order(SamplingSet(aligned).min_gap)
        if rigorous:
            raise ArgumentError("`rigorous` is for exact sample times: leave it or `timing_tolerance` out.")
        if not 2 * late.radius < checks.positive("window", window):
            raise ArgumentError(
                f"`window` must be longer than early and late together, {short(2 * late.radius)}, got {short(window)}: "
                "no sample is certain to lie in it."
            )
    pieces, tolerance, seconds = asked(aligned, window, start, RTOL if rtol is None else rtol, budget, late)
    return sigma_of_pieces(plant, aligned, pieces, tolerance, seconds, progress, rigorous=rigorous)


def asked(
    schedule: Schedule | PeriodicSchedule,
    window: float,
    start: float | None,
    rtol: float,
    budget: float | None,
    late: TimingTolerance = ON_TIME,
) -> tuple[Pieces, float, float]:
    """Return the window's pieces along a schedule in the plant's unit, the tolerance and the seconds, all checked.

    Raises ArgumentError if the window does not fit, or a number is out of range.
    """
    length, first = checks.positive("window", window), None if start is None else checks.nonnegative("start", start)
    return window_pieces(schedule, length, first, late), *rtol_and_seconds(rtol, budget)


def sigma_of_pieces(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    pieces: Pieces,
    rtol: float,
    seconds: float,
    progress: Progress | None = None,
    *,
    rigorous: bool = False,
    reached: WindowSigma | None = None,
) -> WindowSigma:
    """Return the record of some pieces of a schedule in the plant's unit.

    `reached` is what was found over other pieces: windows that see more than that are not looked at closely.
    """
    own = plant.scaled() if plant.has_scales else plant
    shown = middle_rows(own, pieces.timing_tolerance)
    found = bracket_sigma(shown, pieces, rtol, seconds, progress, np.inf if reached is None else reached.upper)
    result = record_of(
        found, rtol, plant.time_unit, coordinates_of(plant.has_scales, isinstance(plant, FunctionalPlant))
    )
    if pieces.timing_tolerance:
        return _with_tolerance(result, own, found)
    if rigorous:
        return _in_balls(result, own, schedule, pieces, seconds)
    if _hidden(found) and find_spec("flint") is not None:
        return _in_balls(result, own, schedule, pieces, min(seconds, HANDED_OVER))
    return result


def _with_tolerance(record: WindowSigma, plant: Plant, found: WindowBracket) -> WindowSigma:
    """The record of windows for all real times within a tolerance, with times that see as little as was found."""
    pieces, least = found.pieces, np.full(len(found.pieces), np.inf)
    np.minimum.at(least, found.owner, found.sigma)
    tried = []
    for g in np.argsort(least, kind="stable")[:MOST_TRIED].tolist():
        at, own = found.nodes[found.owner == g], found.sigma[found.owner == g]
        start = float(at[np.argmin(own)])
        tried.append(moved_window(plant, pieces, g, start))
    worst = min(tried, key=lambda one: one.sigma)
    status, lower = found.status, min(found.lower, worst.sigma)
    if status in ("closed", "rounding", "below rounding") and worst.sigma > 0:  # of rows that stand for all times
        status = "closed" if lower >= (1 - record.rtol) * worst.sigma else "timing"
    return replace(record, lower=lower, upper=worst.sigma, witness=worst, status=status, late=pieces.timing_tolerance)


def _hidden(found: WindowBracket) -> bool:
    """Whether growth within the window may be all that hides sigma from doubles."""
    return found.status in ("below rounding", "rounding") and found.growth > HIDING


def _in_balls(
    result: WindowSigma, plant: Plant, schedule: Schedule | PeriodicSchedule, pieces: Pieces, seconds: float
) -> WindowSigma:
    """The record with the lower bound that ball arithmetic proves."""
    from sampling_design.observability.windows.balls import prove_window_sigma, see_in_balls

    if result.status in ("below rounding", "rounding"):
        seen = see_in_balls(plant, schedule, pieces, seconds)
        if seen is not None:
            result = replace(result, lower=seen.sigma, upper=seen.sigma, witness=seen, status="closed")
    proof = prove_window_sigma(plant, schedule, pieces, result.lower, seconds)
    result = in_balls(result, proof)
    return replace(result, slack=proof.slack) if result.rigorous else result


def record_of(found: WindowBracket, rtol: float, time_unit: str, coordinates: str) -> WindowSigma:
    """The public record: window starts become window ends."""
    window = found.pieces.window
    left, right = found.pieces.left + window, found.pieces.right + window
    profile = WindowProfile(found.nodes + window, found.sigma, found.owner, left, right, found.piece_lower)
    return WindowSigma(
        found.witness, window, profile, lower=found.lower, upper=found.witness.sigma, status=found.status, rtol=rtol,
        from_time=found.pieces.start, coordinates=coordinates, time_unit=time_unit,
    )  # fmt: skip
