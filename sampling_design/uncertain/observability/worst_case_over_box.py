"""The least sigma over all schedules that keep a spacing rule and all plants of a box of constant parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from sampling_design.numerics.branch_and_bound import LeastOverCells, within
from sampling_design.observability.sigma_bracket import NO_STATES, SigmaBracket, coordinates_of, in_balls, uninterrupted
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
from sampling_design.records.evidence import Claim
from sampling_design.records.record import Plain, below, short
from sampling_design.schedules.jitter import ON_TIME, Timing, TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows
from sampling_design.uncertain.box.branching import BALL_ROOM, REASONS
from sampling_design.uncertain.box.expansion import UP, BoxCells
from sampling_design.uncertain.box.model import BoxModel, at_parameters
from sampling_design.uncertain.observability.worst_case_balls import (
    FINER,
    WIDE,
    SigmaOfOne,
    least_over,
    parts_of,
    points_of,
)
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
        from sampling_design.uncertain.observability.worst_case_balls import prove_worst_over_box

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
