"""Sigma over every real position of a sliding window and every plant of a box of constant parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from sampling_design.observability.alignment import align
from sampling_design.observability.sigma_bracket import NO_STATES, SigmaBracket, coordinates_of, in_balls, uninterrupted
from sampling_design.observability.windows.bracket import require_moderate
from sampling_design.observability.windows.pieces import WindowPieces
from sampling_design.observability.windows.window_record import checked_pieces
from sampling_design.observability.windows.window_sigma import left_of_sigma
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.evidence import Claim
from sampling_design.records.record import above, below, short
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.uncertain.box.branching import BALL_ROOM, REASONS, BoxBounds, branch
from sampling_design.uncertain.box.model import BoxModel, at_parameters
from sampling_design.uncertain.observability.window_balls import WindowsOverBox
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

RTOL = 0.01  # default width of the bracket, relative
WIDER = 2.5  # times that: brackets of what late and lost samples leave, which say how steep the ground is
BESIDE, LEAST_BESIDE = 10.0, 1.0  # times what the bracket took, of so many seconds: what late and lost samples may take


@dataclass(frozen=True, eq=False, repr=False)
class WindowSigmaOverBox(SigmaBracket):
    """Bounds on the least sigma over all real positions of a window and all plants of a box.

    Attributes
    ----------
    lower : float
        Proven for every plant of the box and every real position.
    upper : float
        Attained by the plant `worst` in the window that begins at `window_start`.
    worst : mapping
        Values of the parameters.
    window_start : float [time]
    samples : (k,) array [time]
        In that window.
    status : str
        "closed", "unobservable" (the plant `worst` is not seen, as nearly as a descent can tell), "too few samples",
        "budget", "rounding" or "no states".
    cells : int
        How many cells of parameters and positions were judged.
    from_time : float [time]
        As for `WindowSigma`: every window that begins then or later is covered.
    coordinates : str
        Which both bounds refer to: "scaled" where the plant has scales, else "physical".
    rigorous : bool
        Whether `lower` was proven in ball arithmetic: a theorem about the doubles of plant, parameters and times.
    slack : float [time]
        With `rigorous`: as for `WindowSigma`, zero unless samples leave and arrive within rounding of each other.
    """

    worst: Mapping[str, float]
    window_start: float
    samples: Array
    window: float
    cells: int
    plant: UncertainPlant
    from_time: float = field(default=0.0, kw_only=True)
    slack: float = field(default=0.0, kw_only=True)

    _answers = (
        "the least sigma of every plant of a box, over every window of {window} {time_unit} along a schedule, from "
        "{from_time} {time_unit} on",
        "{_grounds}",
        SigmaBracket._good,
        SigmaBracket._balls.format(at="the plant `.worst`"),
    )
    _table = {
        "worst plant": "{worst:or the nominal plant}",
        "worst window begins": "{window_start} {time_unit}",
        "samples in it": "{samples.size}",
        "status": "{status}, {cells} cells",
    }
    _plain = (
        "lower upper worst window_start samples closed status window from_time rtol cells rigorous slack time_unit "
        "coordinates deviations claim"
    )

    @property
    def time_unit(self) -> str:
        """Unit of all times."""
        return self.plant.time_unit

    @property
    def sees_every_plant(self) -> bool | None:
        """Whether every plant of the box is seen in every window: proven, refuted by `worst`, or None (not decided)."""
        if self.lower > 0:
            return True
        return False if self.status in ("unobservable", "too few samples") else None

    @property
    def claim(self) -> Claim:
        """What `lower` claims, and on what grounds."""
        balls = ", in ball arithmetic" if self.rigorous else ""
        return Claim(
            f"sigma_n(O_s e^(-A(t-T))) >= {below(self.lower)} for every plant of the box and every real window end "
            f"t >= T + {short(self.from_time)}, T = {short(self.window)}",
            theorem="Theorem 14, hypothesis, for each plant of the box" + balls,
            assumptions=("constant parameters in their ranges", "the sample times are exact"),
        )

    def explain(self) -> str:
        """Say what was proven, and which plant is worst."""
        where = f"The worst plant has {at_parameters(self.worst)}, in the window from {short(self.window_start)}"
        if self.status == "no states":
            return NO_STATES
        if self.status == "too few samples":
            return f"{where}: {self.samples.size} samples are too few, and sigma is 0."
        if self.status == "unobservable":
            return (
                f"Not every plant of the box is observable: {where[0].lower()}{where[1:]} sigma is {above(self.upper)}."
            )
        length = f"{short(self.window)} {self.time_unit}"
        proven = f"Sigma is at least {below(self.lower)} for every plant of the box, over every window of {length}"
        return self._concluded(f"{proven} ({self._grounds})", where, REASONS)


def window_sigma_over_box(
    plant: UncertainPlant,
    schedule: Schedule | PeriodicSchedule,
    window: float,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    rigorous: bool = False,
    start: float | None = None,
) -> WindowSigmaOverBox:
    """Bound sigma over all positions of a window and all plants of a box: see `window_sigma`."""
    aligned = align(plant.nominal, schedule)
    pieces, tolerance, seconds = checked_pieces(aligned, window, start, RTOL if rtol is None else rtol, budget)
    require_moderate(plant.nominal)
    model, clock = BoxModel.of(plant, "window_sigma", pieces.window), Budget(seconds)
    best = _searched(WindowsOverBox(model, pieces), tolerance, seconds, progress)
    found = WindowSigmaOverBox(
        lower=best.lower, upper=best.upper, worst=model.values(best.u), window_start=best.s,
        samples=pieces.samples(best.piece), status=best.status, window=pieces.window, rtol=tolerance, cells=best.cells,
        plant=plant, from_time=pieces.start, coordinates=coordinates_of(plant.nominal),
    )  # fmt: skip
    left = min(clock.left, BESIDE * max(clock.spent, LEAST_BESIDE))
    if rigorous:
        from sampling_design.uncertain.observability.window_balls import prove_over_box

        proof = prove_over_box(WindowsOverBox(model, pieces), aligned, found.lower, seconds)
        found = replace(in_balls(found, proof, BALL_ROOM), slack=proof.slack)
    wide = min(WIDER * tolerance, 0.5)
    least, lost = partial(_least, model, wide), partial(_lost, model, wide, len(aligned))
    beside = partial(
        left_of_sigma, aligned, window, least, lost, plant.time_unit, sigma=found.lower, start=start, seconds=left
    )
    return replace(found, beside=beside)


def _least(model: BoxModel, rtol: float, pieces: WindowPieces, seconds: float, _: float) -> tuple[float, float]:
    """Proven sigma of pieces for all real times within their tolerance, and the least such bound of one plant."""
    found = uninterrupted(_searched(WindowsOverBox(model, pieces), rtol, seconds, None))
    return found.lower, found.upper


def _lost(model: BoxModel, rtol: float, samples: int, pieces: WindowPieces, limit: Budget) -> tuple[float, int]:
    """Proven sigma if any one sample is lost, and whose loss leaves what is attained: all in one search."""
    asked = WindowsOverBox(model, pieces, losing=True)
    found = uninterrupted(_searched(asked, rtol, limit.left, None))
    return found.lower, int(asked.lost[found.piece]) % samples


def _searched(asked: WindowsOverBox, rtol: float, seconds: float, progress: Progress | None) -> BoxBounds:
    """The bracket over the box and all pieces."""
    model, pieces = asked.model, asked.pieces
    if not model.n:
        return BoxBounds(np.inf, np.inf, model.start, float(pieces.left[0]), 0, "no states", 0)
    few = asked.too_few()
    if few is not None:
        return BoxBounds(0.0, 0.0, model.start, float(pieces.left[few]), few, "too few samples", 0)
    ends = (pieces.left, pieces.right)
    value = None if pieces.timing_tolerance else asked.value
    return branch(asked.cells(), asked.judge, value, asked.unobservable, rtol, seconds, ends, progress)
