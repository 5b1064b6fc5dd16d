"""What is found of sigma over every real position of a sliding window."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from importlib.util import find_spec

import numpy as np

from sampling_design.observability import sigma_bracket
from sampling_design.observability.windows.bracket import WindowBracket, bracket_sigma
from sampling_design.observability.windows.pieces import WindowPieces, WindowWitness, window_pieces
from sampling_design.observability.windows.timing import MOST_TRIED, middle_rows, moved_window, starts_tried
from sampling_design.plants.functional import rows_counted, wider_beside
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Integers
from sampling_design.records.budget import Budget, BudgetSpentError, Progress
from sampling_design.records.declarations import Column, above, below
from sampling_design.records.record import Claim, CurveRecord, Plain, TableRecord, Variable, counted, moment, short
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

RTOL = 0.001  # default width of the bracket, relative
HIDING = 1e3
"""Growth within a window from which on a sigma that doubles lose is asked of balls: n eps |O| is then far above the
n eps |C| below which sigma counts as zero."""
MOST_WIDER = 8  # searches of rows, each with the others counting less where it was kept open by what they hold
HANDED_OVER = 20.0  # seconds that balls have for what was only asked of floats
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
    `start`, `end` and `lower` hold for each piece its interval of window ends and its proven bound.
    """

    t: Array
    sigma: Array
    piece: Integers
    start: Array
    end: Array
    lower: Array


@dataclass(frozen=True, eq=False, repr=False)
class WindowSigma(sigma_bracket.SigmaBracket, TableRecord, CurveRecord):
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
        "timing_tolerance deviations witness{t side samples direction} coordinates claim"
    )
    _refers_to = "the state at the window's start"

    _answers = (
        "the least sigma over every window of {window} {time_unit} along a schedule, from {_since} {time_unit} on",
        "{_grounds}",
        sigma_bracket.SigmaBracket._good,
        sigma_bracket.SigmaBracket._balls.format(at="`.witness`"),
    )
    _table = {
        "worst window ends": "{witness.position} {time_unit}",
        "samples in it": "{witness.samples.size}",
        "samples come": "{_late}",
        "status": "{status}",
    }

    @property
    def claim(self) -> Claim:
        """What `lower` claims, and on what grounds."""
        wider = f", samples in [t - T - {self.slack:.3g}, t + {self.slack:.3g}]" if self.slack else ""
        return Claim(
            f"sigma_n(O_s e^(-A(t-T))) >= {below(self.lower)} for every real window end t >= T + "
            f"{moment(self.from_time)}, T = {short(self.window)}{wider}",
            theorem="Theorem 14, hypothesis" + (", in ball arithmetic" if self.rigorous else ""),
            assumptions=(
                f"the plant's matrices are exact, samples are {self._late()}"
                if self.late
                else "the plant's matrices and the sample times are exact",
                f"{self.coordinates} coordinates",
            ),
            strength="sampled" if self.status == "sampled" else "proven",
        )

    def _variables(self) -> dict[str, Variable]:
        profile, time = self.profile, self.time_unit
        return {
            "window_end": Variable(("point",), profile.t, time),
            "sigma": Variable(("point",), profile.sigma),
            "piece_of": Variable(("point",), profile.piece),
            "piece": Variable(("piece",), np.unique(profile.piece)),
            "start": Variable(("piece",), profile.start, time),
            "end": Variable(("piece",), profile.end, time),
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

    def _since(self) -> str:
        return moment(self.from_time)

    def explain(self) -> str:
        """Say what was proven, where the worst window is, and why a bracket did not close."""
        samples = counted(self.witness.samples.size, "sample")
        where = f"The worst window ends {self.witness.position} {self.time_unit} with {samples}"
        if self.status == "no states":
            return sigma_bracket.NO_STATES
        if self.status == "too few samples":
            empty = " The window is shorter than a gap." if self.witness.samples.size == 0 else ""
            return f"{where}, too few for {counted(self.witness.direction.size, 'state')}: sigma is 0.{empty}"
        if self.status == "below rounding":
            hidden = (
                "" if self.rigorous else " What growth hides from doubles, ball arithmetic shows: extra `rigorous`."
            )
            state = short(self.witness.direction)
            return f"{where}; it does not observe the state {state}: sigma is zero to rounding.{hidden}"
        length = f"{short(self.window)} {self.time_unit}"
        if self.status == "sampled":
            left = "" if self.deviations is None else f" {self.deviations.explain()}"
            return (
                f"Sigma falls to {above(self.upper)} among the windows of {length} that were looked at; nothing is "
                f"proven, as A is a function of time and no table. {where}.{left}"
            )
        later = f" from {self._since()} {self.time_unit} on" if self.from_time else ""
        later += f", for samples {self._late()}" if self.late else ""
        proven = f"Sigma is at least {below(self.lower)} over every window of {length}{later} ({self._grounds})"
        return self._concluded(proven, where, _REASONS)


def checked_pieces(
    schedule: Schedule | PeriodicSchedule,
    window: float,
    start: float | None,
    rtol: float,
    budget: float | None,
    late: TimingTolerance = ON_TIME,
) -> tuple[WindowPieces, float, float]:
    """Return the window's pieces along a schedule in the plant's unit, the tolerance and the seconds, all checked.

    Raises ArgumentError if the window does not fit, or a number is out of range.
    """
    length, first = checks.positive("window", window), None if start is None else checks.nonnegative("start", start)
    return window_pieces(schedule, length, first, late), *sigma_bracket.rtol_and_seconds(rtol, budget)


def sigma_of_pieces(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    pieces: WindowPieces,
    rtol: float,
    seconds: float,
    progress: Progress | None = None,
    *,
    rigorous: bool = False,
    reached: float = np.inf,
    handed_over: float = HANDED_OVER,
) -> WindowSigma:
    """Return the record of some pieces of a schedule in the plant's unit.

    `reached` was found over other pieces: windows that see more than that are not looked at closely. Balls have
    `handed_over` seconds for what growth hides from floats.
    """
    whole, counted = Budget(seconds), rows_counted(plant)
    for _ in range(MOST_WIDER):
        own = plant.scaled() if plant.has_scales else plant
        middle = middle_rows(own, pieces.timing_tolerance)
        found = bracket_sigma(middle, pieces, rtol, whole.left, progress, reached, counted)
        wider = wider_beside(plant, found.shares)
        if found.status != "rounding" or wider is None:
            break
        plant = wider
    seconds = whole.left
    result = record_of(found, rtol, plant.time_unit, sigma_bracket.coordinates_of(plant))
    if pieces.timing_tolerance:
        late = pieces.timing_tolerance
        return _with_tolerance(result, own, found, counted) if own.n_states else replace(result, late=late)
    hidden = handed_over and _hidden(found) and find_spec("flint") is not None
    if rigorous or hidden:
        return _in_balls(result, own, schedule, pieces, seconds, np.inf if rigorous else handed_over)
    return result


def _with_tolerance(record: WindowSigma, plant: Plant, found: WindowBracket, counted: int) -> WindowSigma:
    """The record of windows for all real times within a tolerance, with times that see as little as was found."""
    pieces, least = found.pieces, np.full(len(found.pieces), np.inf)
    np.minimum.at(least, found.owner, found.sigma)
    tried = []
    for g in np.argsort(least, kind="stable")[:MOST_TRIED].tolist():
        at, own = found.nodes[found.owner == g], found.sigma[found.owner == g]
        start = float(at[np.argmin(own)])
        tried += [moved_window(plant, pieces, g, each, counted) for each in starts_tried(pieces, g, start)]
    worst = min(tried, key=lambda one: one.sigma)
    status, lower = found.status, min(found.lower, worst.sigma)
    if status in ("closed", "rounding", "below rounding") and worst.sigma > 0:  # of rows that stand for all times
        status = "closed" if lower >= (1 - record.rtol) * worst.sigma else "timing"
    return replace(record, lower=lower, upper=worst.sigma, witness=worst, status=status, late=pieces.timing_tolerance)


def _hidden(found: WindowBracket) -> bool:
    """Whether growth within the window may be all that hides sigma from doubles."""
    return found.status in ("below rounding", "rounding") and found.growth > HIDING


def _in_balls(
    result: WindowSigma,
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    pieces: WindowPieces,
    seconds: float,
    most: float,
) -> WindowSigma:
    """The record with the lower bound that ball arithmetic proves, within what is left of a budget and `most`.

    Where it is the budget that ends before balls have said whether sigma is zero, that is not known.
    """
    from sampling_design.observability.windows.balls import BallRows, prove_window_sigma, sigma_in_balls

    clock, rows = Budget(min(seconds, most)), BallRows(plant, schedule, pieces)
    if result.status in ("below rounding", "rounding"):
        try:
            witness = sigma_in_balls(rows, clock)
        except BudgetSpentError:
            return result if most <= seconds else replace(result, status="budget")
        except KeyboardInterrupt:
            return replace(result, status="interrupted")
        if witness is not None:
            result = replace(result, lower=witness.sigma, upper=witness.sigma, witness=witness, status="closed")
    proof = prove_window_sigma(plant, schedule, pieces, result.lower, clock.left, rows)
    result = sigma_bracket.in_balls(result, proof)
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
