"""The least sigma over all schedules that keep a spacing rule and all plants of a box of constant parameters.

Its lower bound may be proven in ball arithmetic (extra `rigorous`): sigma of the corners of a cell, as in
`worst_case/balls.py`, and what the rows of all plants of the cell are beside those of its middle, to first order and
beyond, in metrics of `box/`. What sigma at the corners says of every plant inside:

With O(d) = O_0 + sum d_k O_k + X, |d_k| <= 1, |sum +-O_k| <= first and |X| <= second, for every x and every schedule

    |O_0 x + sum d_k O_k x|^2  >=  |O_0 x|^2 + 2 sum d_k (O_0 x)'(O_k x),

which is least at a corner c, where it is |O_0 x + sum c_k O_k x|^2 - |sum c_k O_k x|^2. So, on the whole cell,

    sigma  >=  sqrt((least sigma of the corners - second)^2 - first^2) - second,

off by second order. Where there are too many corners the centre stands for them: sigma of it - first - second.

Where states have units far apart the same is better said in balanced coordinates z, as a share of what each x shows:
with sigma_z of the corners there and f = first_z/sigma_z, g = second_z/sigma_z, |z| <= |O z|/sigma_z gives

    sigma  >=  (sqrt((1 - g)^2 - f^2) - g) (least sigma of the corners),   (1 - f - g) sigma for the centre.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from sampling_design.numerics.balls import Ball, ball, frobenius, identity, largest, matrix, positive_part
from sampling_design.numerics.branch_and_bound import LeastOverCells, all_proven, within
from sampling_design.observability.sigma_bracket import (
    NO_STATES,
    ProvenSigma,
    SigmaBracket,
    coordinates_of,
    in_balls,
    uninterrupted,
)
from sampling_design.observability.windows.balls import SHAVES, nearest_proven
from sampling_design.observability.worst_case.balls import prove_worst_sigma
from sampling_design.observability.worst_case.worst_case_sigma import (
    LEAST_SEARCH,
    WorstCaseSigma,
    asked,
    deviations_of_family,
    said_of_readings,
    worst_case_sigma,
)
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.checks import Seed
from sampling_design.records.record import Claim, Plain, below, short
from sampling_design.schedules.jitter import ON_TIME, Timing, TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows
from sampling_design.uncertain.box.balls import BallBox, CellMetric, largest_over
from sampling_design.uncertain.box.branching import BALL_ROOM, REASONS, halved
from sampling_design.uncertain.box.model import UP, BoxCells, BoxModel, at_parameters, bases, norms_in, signs
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

RTOL = 0.1  # default width of the bracket, relative
BESIDE, LEAST_BESIDE = 4.0, 1.0  # times what the bracket took, of so many seconds: what late and lost samples may take


@dataclass(frozen=True, eq=False, repr=False)
class WorstCaseOverBox(SigmaBracket):
    """Bounds on the least sigma over all schedules with k samples, epsilon apart, in a window, and all plants of a box.

    Attributes
    ----------
    lower : float
        Proven for every admissible schedule and every plant of the box.
    upper : float
        Attained by the plant `worst` at the times `witness`.
    worst : mapping
        Values of the parameters.
    witness : (k,) array
        Sample times within [0, T]; planned ones where samples may be early or late, and the window is as much longer.
    readings : (k, p) array or None
        When each output of these samples is read, there.
    timing_tolerance : float, pair of floats, dict of these, or None
        As in `WorstCaseSigma`.
    status : str
        "closed", "unobservable" (of a state of some plant some schedule measures nothing), "budget", "interrupted" or
        "no states".
    plants : int
        How many plants were judged one by one.
    coordinates : str
        Which both bounds refer to: "scaled" where the plant has scales, else "physical".
    rigorous : bool
        Whether `lower` was proven in ball arithmetic: a theorem about the doubles of plant, parameters and family.
    """

    worst: Mapping[str, float]
    witness: Array
    family: SpacedWindows
    plants: int
    plant: UncertainPlant
    late: TimingTolerance = field(default=ON_TIME, kw_only=True)
    readings: Array | None = field(default=None, kw_only=True)

    _answers = (
        "the least sigma of every plant of a box, over all schedules with {family.count} samples in {family.window} "
        "{_unit}, {family.spacing} {_unit} apart{_read}",
        "{_grounds}",
        SigmaBracket._good,
        SigmaBracket._balls.format(at="the plant `.worst`"),
    )
    _table = {
        "worst plant": "{worst:or the nominal plant}",
        "samples come": "{_late}",
        "worst times": "{witness} {plant.time_unit}",
        "status": "{status}, {plants} plants",
    }
    _plain = (
        "lower upper worst witness readings? status rtol plants rigorous coordinates family{window count spacing} "
        "timing_tolerance? deviations claim"
    )

    def _unit(self) -> str:
        return self.plant.time_unit

    @property
    def timing_tolerance(self) -> Plain:
        """How early or late each sample may be read, as it is written; None where it is on time."""
        return self.late.plain if self.late else None

    def _late(self) -> str | None:
        return self.late.describe(self._unit()) if self.late else None

    def _read(self) -> str:
        return said_of_readings(self.family, self.late, self._unit())

    @property
    def claim(self) -> Claim:
        """What `lower` claims, and on what grounds."""
        f = self.family
        return Claim(
            f"sigma_n(O_s) >= {below(self.lower)} for every plant of the box and all schedules with at least {f.count} "
            f"samples, at least {short(f.spacing)} apart, in every window of {short(f.window)}{self._read()}",
            theorem="Theorem 17, for each plant of the box" + (", in ball arithmetic" if self.rigorous else ""),
            assumptions=("constant parameters in their ranges", "every sample measures all outputs"),
        )

    def explain(self) -> str:
        """Say what was proven, and which plant and times are worst."""
        if self.status == "no states":
            return NO_STATES
        where = f"The worst plant has {at_parameters(self.worst)}, at {short(self.witness)} {self.plant.time_unit}"
        proven = (
            f"Sigma is at least {below(self.lower)} for every plant of the box and every such schedule{self._read()}"
        )
        return self._concluded(f"{proven} ({self._grounds})", where, REASONS)


def worst_case_over_box(
    plant: UncertainPlant,
    family: SpacedWindows,
    rtol: float | None = None,
    budget: float | None = 60.0,
    rng: Seed = None,
    progress: Progress | None = None,
    rigorous: bool = False,
    timing_tolerance: Timing = 0.0,
) -> WorstCaseOverBox:
    """Bracket the worst case over the box: single plants, and what they say of all within a cell (`least_over`)."""
    late = TimingTolerance.of(timing_tolerance, plant.nominal.outputs.names, plant.time_unit)
    late.require_order(family.spacing)
    tolerance, seconds = asked(plant, family, RTOL if rtol is None else rtol, budget)
    model = BoxModel.of(plant, "worst_case_sigma", family.window)
    found = WorstCaseOverBox(
        lower=np.inf, upper=np.inf, worst=model.values(model.start), witness=np.zeros(family.count if model.n else 0),
        status="no states", family=family, rtol=tolerance, plants=0, plant=plant,
        coordinates=coordinates_of(plant.nominal),
    )  # fmt: skip
    if not model.n:
        return found
    clock = Budget(seconds)

    def one(member: Plant, fine: float, left: float) -> WorstCaseSigma:
        limit = max(left, LEAST_SEARCH) if np.isfinite(left) else None
        own = replace(late, names=member.outputs.names if late.apart else ()).plain
        found = worst_case_sigma(member, replace(family, time_unit=None), fine, budget=limit, timing_tolerance=own)
        if found.status == "interrupted":  # of one plant: the others are not looked at
            clock.stop()
        return found

    def firm(member: Plant, fine: float, left: float) -> WorstCaseSigma:
        found = one(member, fine, left)
        if clock.limit < 0:
            raise KeyboardInterrupt
        return found

    settled: list[BoxCells] = []
    found = _searched(found, model, late, clock, one, settled)
    left = min(clock.left, BESIDE * max(clock.spent, LEAST_BESIDE))
    if rigorous and found.status != "interrupted":
        proof = prove_worst_over_box(model, family, found.lower, FINER * tolerance, settled, firm, seconds, late)
        found = in_balls(found, proof, BALL_ROOM)
    least = partial(_least, plant, tolerance)
    beside = partial(deviations_of_family, least, family, late, found.lower, left, plant.time_unit)
    return replace(found, late=late, beside=beside)


def _least(plant: UncertainPlant, rtol: float, family: SpacedWindows, late: TimingTolerance, seconds: float) -> float:
    """Proven sigma of a rule."""
    rule = replace(family, time_unit=None)
    inner = worst_case_sigma(plant.nominal, rule, rtol, budget=seconds, timing_tolerance=late.plain)
    if uninterrupted(inner).lower == 0:
        return 0.0  # a box about a zero is cut for as long as it may be
    return uninterrupted(worst_case_over_box(plant, family, rtol, seconds, timing_tolerance=late.plain)).lower


def _searched(
    best: WorstCaseOverBox,
    model: BoxModel,
    late: TimingTolerance,
    budget: Budget,
    one: SigmaOfOne,
    settled: list[BoxCells],
) -> WorstCaseOverBox:
    """The bracket, of which `best` is what is met so far; `settled` takes the cells that were proven."""
    family, rtol = best.family, best.rtol
    known = dict[tuple[float, ...], tuple[float, float]]()
    wide = bool(np.ptp(np.log(model.unit)) > np.log(WIDE))

    def judged(cell: BoxCells) -> tuple[Array, Array] | None:
        nonlocal best
        points = points_of(cell)
        for u in points:
            left = budget.left
            if left <= 0 and known:
                return None
            if tuple(u.tolist()) not in known:
                found = one(model.plant.at(model.values(u)), FINER * rtol, left)
                inner = one(model.balanced_at(u), FINER * rtol, budget.left).lower if wide and budget.left else 0.0
                # |x| <= |z| times the largest unit: what is left where rounding hides sigma in units far apart
                known[tuple(u.tolist())] = max(found.lower, inner / (UP * float(model.unit.max()))), inner
                if search.attain(np.array([found.upper])).size:
                    best = replace(best, upper=found.upper, witness=found.witness, readings=found.readings)
                    best = replace(best, worst=model.values(u))
            if best.upper == 0:
                return None
        least, inner = np.min([known[tuple(u.tolist())] for u in points], axis=0).tolist()
        return np.array([[least_over(model, cell, family, least, inner, late)]]), np.zeros((1, 0))

    def cut(cell: BoxCells, _: Array) -> tuple[BoxCells, Index]:
        parts = parts_of(model, cell, family)
        return parts, np.zeros(len(parts.s), dtype=np.intp)

    search = LeastOverCells(BoxCells.whole(model.m), np.zeros((1, 1)), within(rtol), budget)
    status = search.run(judged, cut)
    settled += [*search.closed, search.cells]
    if best.upper == 0:
        status = "unobservable"
    elif status != "closed":
        status = "interrupted" if status == "interrupted" or budget.limit < 0 else "budget"
    return replace(best, lower=min(float(search.lower[0]), best.upper), status=status, plants=len(known))


SigmaOfOne = Callable[[Plant, float, float], WorstCaseSigma]
"""Sigma of a plant, to a tolerance, in so many seconds."""

MOST_CORNERS = 4  # parameters up to which cells are judged by their corners
WIDE = 10.0  # units this far apart, in balanced coordinates, are judged by what sigma is there
FINER = 0.25  # share of the tolerance that the bracket of each single plant may take


def parts_of(model: BoxModel, cell: BoxCells, family: SpacedWindows) -> BoxCells:
    """Both halves of a cell, along the parameter that moves the rows most."""
    effect = np.zeros((1, model.m + 1))
    effect[:, :-1] = np.linalg.norm(model.parts_A, axis=(1, 2)) * family.window * cell.half
    effect[:, :-1] += np.linalg.norm(model.parts_C, axis=(1, 2)) * cell.half
    return halved(cell, effect)


def points_of(cell: BoxCells) -> Array:
    """The plants (P, m) by which a cell is judged: its corners, or its centre where there are too many."""
    u, half = cell.u[0], cell.half[0]
    if u.size > MOST_CORNERS:
        return np.asarray(cell.u)
    return np.asarray(u + signs(u.size) * half)


def least_over(
    model: BoxModel,
    cell: BoxCells,
    family: SpacedWindows,
    least: float,
    balanced: float = 0.0,
    late: TimingTolerance = ON_TIME,
) -> float:
    """At most sigma of every plant of a cell and any k times in the window; `least`: of the plants of `points_of`.

    `balanced` is at most their sigma in balanced coordinates; 0 where it is not known.
    """
    A, C = model.at(cell.u)
    ends, found = latest(family, late), 0.0
    for T in bases(A, C, np.array([family.window])):
        inverse = np.linalg.inv(T).astype(complex)
        norms, _, _ = norms_in(model, cell, A, C, T, inverse)
        with np.errstate(over="ignore", invalid="ignore"):
            rows = norms.rows(ends[None], np.maximum(norms.rate, 0.0))
            first, second = (UP * float(np.linalg.norm(part)) for part in rows)
            own, there = (float(np.linalg.norm(X, 2, axis=(1, 2))[0]) for X in (inverse, inverse / model.unit))
            shares = [left(least, there * first, there * second, cell.u.shape[1])]
            if balanced > 0:
                shares.append(least * left(1.0, own * first / balanced, own * second / balanced, cell.u.shape[1]))
        found = max(found, *(share for share in shares if np.isfinite(share)), 0.0)
    return found


def left(least: float, first: float, second: float, parameters: int) -> float:
    """What is left of the least sigma of the points of a cell, all over it."""
    if parameters > MOST_CORNERS:
        return least - first - second
    return float(np.sqrt(max(max(least - second, 0.0) ** 2 - first**2, 0.0)) - second)


def latest(family: SpacedWindows, late: TimingTolerance = ON_TIME) -> Array:
    """By when each sample is taken at the latest, once for each output where these are read at times of their own."""
    planned = np.maximum(family.window - family.spacing * np.arange(family.count), 0.0)
    return np.asarray(np.repeat(planned + late.span, len(late.early)) * UP)


SMALLEST = 2.0**-20  # cells below this share of the box are not halved further
ROUNDED = 1 + 2.0**-50  # covers the rounding of one double


def prove_worst_over_box(
    model: BoxModel,
    family: SpacedWindows,
    guess: float,
    rtol: float,
    cells: list[BoxCells],
    one: SigmaOfOne,
    seconds: float,
    late: TimingTolerance = ON_TIME,
) -> ProvenSigma:
    """Prove a lower bound of sigma over a box and all schedules of a family: see `nearest_proven`.

    Floats believe it of `cells`, which together are the box; `one` is sigma of one plant in floats with its worst
    times, to a tolerance `rtol`, from which its proof begins.
    """

    def begin(clock: Budget) -> Callable[[float], bool]:
        box, known = BallBox(model), dict[tuple[float, ...], float]()

        def reaches(u: Array, plant: Plant, needed: float) -> bool:
            clock.check()
            at = tuple(u.tolist())
            if known.get(at, 0.0) < needed < np.inf:
                found = one(plant, rtol, np.inf)
                left = clock.left
                if found.lower >= needed:
                    proof = prove_worst_sigma(plant, family, needed * ROUNDED, found.witness, left, (0.0,), late)
                    known[at] = proof.lower
            return known.get(at, 0.0) >= needed

        def proves(mu: float) -> bool:
            def proven(cell: BoxCells) -> list[BoxCells] | None:
                points = points_of(cell)
                plants = [model.plant.at(model.values(u)) for u in points]
                needed = _needed(box, cell, (points, plants), (family, late), mu)
                if all(reaches(u, plant, needed) for u, plant in zip(points, plants, strict=True)):
                    return []
                small = cell.half.max(initial=0.0) < SMALLEST
                return None if small else parts_of(model, cell, family).each()

            return all_proven([cell for part in cells for cell in part.each()], proven, clock)

        return proves

    return nearest_proven(guess, seconds, begin, shaves=SHAVES[:1])


def _needed(
    box: BallBox,
    one: BoxCells,
    judged: tuple[Array, list[Plant]],
    rule: tuple[SpacedWindows, TimingTolerance],
    mu: float,
) -> float:
    """What sigma of the plants by which a cell is judged must be for sigma >= mu all over it; infinity if unknown."""
    least, points = np.inf, judged[0]
    cell, off_A, off_C = box.cell(one.u[0], one.half[0]), ball(0.0), ball(0.0)
    for u, plant in zip(*judged, strict=True):
        exact, (A, C) = box.cell(u, 0 * u), box.balanced(matrix(plant.A), matrix(plant.C))
        off_A, off_C = off_A.max(frobenius(exact.A - A)), off_C.max(frobenius(exact.C - C))
    for metric in box.metrics(cell, rule[0].window):
        spread = _pulse_sizes(box, metric, (off_A, off_C), *rule)
        if spread is not None:
            first, second = spread
            corners = ((second + mu) ** 2 + first * first).sqrt() + second
            found = corners if len(points) > 1 else first + second + mu
            least = min(least, float(found.upper()) * ROUNDED)
    return least


def _pulse_sizes(
    box: BallBox, metric: CellMetric, off: tuple[Ball, Ball], family: SpacedWindows, late: TimingTolerance
) -> tuple[Ball, Ball] | None:
    """At least |sum +-O_k| and |X| over a cell, in one metric; `off`: the rounding of the plants that are judged."""
    eye, (W, norms, _) = identity(box.n), metric
    rounded = largest_over(eye * (largest(W) * off[0] * off[0]), W)
    output_moved = largest_over(eye * (off[1] * off[1]), W)
    there = largest_over(W, box.unit.transpose() * box.unit)
    if rounded is None or output_moved is None or there is None:
        return None
    lost = replace(norms, moved=rounded.sqrt(), output_moved=output_moved.sqrt())
    both = replace(norms, moved=norms.moved + lost.moved, output_moved=norms.output_moved + lost.output_moved)
    first, second, rate = ball(0.0), ball(0.0), positive_part(norms.rate)
    for j in range(family.count):
        t = positive_part(ball(family.window) - ball(family.spacing) * j) + ball(max(late.early)) + ball(max(late.late))
        first += norms.rows(t, rate)[0] ** 2
        second += (lost.rows(t, rate)[0] + both.rows(t, rate)[1]) ** 2
    first, second = (part * len(late.early) for part in (first, second))  # outputs read at times of their own
    return (first * there).sqrt().upper(), (second * there).sqrt().upper()
