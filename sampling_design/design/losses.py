"""What one sample is worth: sigma where it is missed once, or left out of every period."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.design.design import design_schedule
from sampling_design.design.problem.posing import pose, repeated
from sampling_design.design.problem.requirement import Requirement
from sampling_design.design.schedule_design import ScheduleDesign, bounded, designed_plant, prove
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.observability.sigma_bracket import SigmaDeviations
from sampling_design.observability.windows.window_record import WindowSigma
from sampling_design.plants.functional import Wanted, counted_rows
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.declarations import selected
from sampling_design.records.record import Plain, TableRecord, above, below, moment
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule, ScheduleDetails


@dataclass(frozen=True, eq=False, repr=False)
class SampleLosses(TableRecord):
    """Sigma after the loss of each single sample of a period.

    Attributes
    ----------
    times : (k,) array
        The period's sample times.
    sigma : float
        Proven sigma of the whole schedule.
    lower, upper : (k,) array
        Proven and attained sigma without sample i, the others where they are.
    bound : (k,) array
        No admissible schedule with one sample fewer exceeds this, wherever its samples lie: so much could
        planning for the loss save at most. One sample fewer in every period, or in as many periods as a window
        can touch, plus one.
    every_period : bool
        Whether the sample is missing from every period, or from a single one.
    time_unit : str or None
        Unit of the times.
    deviations : SigmaDeviations or None
        What is left of `sigma` if samples come early or late.
    coordinates : str
        Those that sigma refers to.
    """

    times: Array
    sigma: float
    lower: Array
    upper: Array
    bound: Array
    every_period: bool
    time_unit: str | None = None
    deviations: SigmaDeviations | None = None
    coordinates: str = "physical"

    @property
    def price(self) -> Array:
        """What sigma loses without each sample, from proven to attained: at most sigma - lower."""
        return np.asarray(np.maximum(self.sigma - self.lower, 0.0))

    @property
    def dearest(self) -> int:
        """Index of the sample whose loss hurts most."""
        return int(np.argmin(self.lower))

    @property
    def alike(self) -> bool:
        """Whether each loss costs as much as any other, to the digits that are printed."""
        return len({below(low) for low in self.lower}) == 1

    _answers = (
        "sigma of a design without each single sample",
        "proven: over every window, and what no schedule with one sample fewer exceeds",
        "at worst {_least:down} of {sigma} is left ({coordinates} coordinates, state at the window's start)",
        "`window_sigma` of the schedule without a sample",
    )

    def _least(self) -> float:
        return float(self.lower.min())

    _frame = "time:times lower upper bound price"

    def to_dict(self) -> dict[str, Plain]:
        """Plain data, one entry per sample."""
        columns = zip(*(a.tolist() for a in (self.times, self.lower, self.upper, self.bound)), strict=True)
        rows = [{"time": t, "lower": low, "upper": up, "bound": top} for t, low, up, top in columns]
        left = None if self.deviations is None else self.deviations.to_dict()
        return {**selected(self, "sigma coordinates every_period"), "deviations": left, "without": rows}

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("lost", "in every period" if self.every_period else "once"), ("sigma with all", below(self.sigma))]
        rows += [] if self.deviations is None else self.deviations._rows()[:1]
        columns = zip(self.times, self.lower, self.bound, strict=True)
        return rows + [(f"without {self._at(t)}", f"{below(v)}, none exceeds {above(b)}") for t, v, b in columns]

    def _at(self, t: float) -> str:
        return f"t = {moment(t, self.times)} {self.time_unit or ''}".rstrip()

    def explain(self) -> str:
        """Say which sample matters most."""
        i = self.dearest
        how = "left out of every period" if self.every_period else "missed once"
        which, more = f"the sample at {self._at(self.times[i])}", "; no other single loss costs more"
        if self.alike:
            which, more = "any sample", ""
        return (
            f"If {which} is {how}, sigma falls from {below(self.sigma)} "
            f"to {below(self.lower[i])}{more}. No schedule with one sample fewer exceeds "
            f"{above(self.bound[i])}."
            + ("" if self.deviations is None or self.deviations.in_sigma else f" {self.deviations.explain()}")
        )


@checked
def sample_losses(
    design: ScheduleDesign,
    *,
    every_period: bool = False,
    rtol: float = 0.001,
    rng: checks.Seed = None,
    budget: float | None = None,
    progress: Progress | None = None,
) -> SampleLosses:
    """Prove sigma over all window positions after each single loss of a sample, and what no re-planning exceeds.

    Parameters
    ----------
    design : ScheduleDesign
    every_period : bool
        Leave the sample out of every period (its price), or miss it once (a window that spans several periods
        then keeps the sample of the others).
    rtol : float
        As for `window_sigma`.
    rng : numpy.random.Generator or its seed, optional
        As for `design_schedule`: what designs the schedules with one sample fewer in every period.
    budget : float, optional [seconds]
        What is not proven by then keeps the bounds it has: `lower` may be 0, `bound` that of the multipliers so far.
    progress : callable, optional
        Called with the fraction done and a message.

    Returns
    -------
    SampleLosses

    Notes
    -----
    *Claim.* `lower` is proven as in `window_sigma`. `bound` holds for every schedule that meets the
    requirement with one sample fewer, a fixed time that is lost being free of its duty; where a sample is
    missed once, over the periods that a window can touch, plus one, as one long period. Where a sample is lost in
    every period, `bound` is that of a design with one sample fewer (as `pareto` states it); where there is always
    room for one more it is never above `design.upper_bound`.

    Raises
    ------
    ArgumentError
        If the design has no schedule, or one that leaves a state unseen.
    """
    if not isinstance(design, ScheduleDesign) or design.schedule is None:
        raise ArgumentError("`design` must be a ScheduleDesign with a schedule; there is no sample to lose.")
    if not design.sigma > 0:
        raise ArgumentError(
            f"`design` must make every state observable, or there is nothing to lose. {design.explain()}"
        )
    checks.positive("rtol", rtol)
    given = Budget(None if budget is None else checks.nonnegative("budget", budget))
    proving, count = given.share(0.7), len(design.schedule)
    touched = int(np.ceil(float(design.requirement.window or 0) / design.schedule.period)) + 1  # by a window, plus one
    periods = 1 if every_period else touched
    proofs: list[WindowSigma | None] = []
    for i in range(count):
        rest = without_sample(design.schedule, i, periods)
        share = proving.seconds_left(share=1 / (count - i))
        required = design.requirement
        proofs.append(None if rest is None else prove(design.split, rest, required, rtol, budget=share))
        if progress:
            progress((i + 1) / len(design.schedule), f"without sample {i + 1}")
    lower, upper = (np.array([0.0 if w is None else getattr(w, key) for w in proofs]) for key in ("lower", "upper"))
    bound = np.maximum(_bounds(design, periods, every_period, given, rng), lower)  # it may round to just below a proof
    lower, upper, bound = (freeze(a) for a in (lower, upper, bound))
    judged = design if given.left >= design.seconds else replace(design, seconds=given.left)
    times, left = design.schedule.times, judged.deviations
    unit, coordinates = design.schedule.time_unit, design.coordinates
    return SampleLosses(times, design.sigma, lower, upper, bound, every_period, unit, left, coordinates=coordinates)


@checked
def design_and_losses(
    plant: Plant,
    requirement: Requirement | None = None,
    *,
    every_period: bool = False,
    of: Wanted = None,
    rng: checks.Seed = None,
    budget: float | None = None,
    progress: Progress | None = None,
) -> tuple[ScheduleDesign, SampleLosses | None]:
    """Design a schedule, and prove what the loss of each of its samples costs; each takes half of the budget.

    Parameters
    ----------
    plant : Plant
    requirement : Requirement, optional
    every_period, progress
        As for `sample_losses`.
    of : str, sequence of str, or (k, n) array, optional
        As for `design_schedule`.
    rng : numpy.random.Generator or its seed, optional
        Both begin with it, as it was.
    budget : float, optional [seconds]
        Of both together.

    Returns
    -------
    ScheduleDesign, SampleLosses or None
        None where there is no sample to lose: no schedule, or one that leaves a state unseen.

    Raises
    ------
    InfeasibleRequirementError
        As `design_schedule`.
    """
    half = None if budget is None else checks.positive("budget", budget) / 2
    design = design_schedule(plant, requirement, rng=copy.deepcopy(rng), budget=half, progress=progress, of=of)
    if design.schedule is None or not design.sigma > 0:
        return design, None
    if design.status == "interrupted":
        raise KeyboardInterrupt
    return design, sample_losses(design, every_period=every_period, rng=rng, budget=half, progress=progress)


def _bounds(design: ScheduleDesign, periods: int, every_period: bool, budget: Budget, rng: checks.Seed) -> Array:
    """The bound with one sample fewer, for each sample that is lost: one for all that are not fixed."""
    schedule, requirement = design.schedule, design.requirement
    assert schedule is not None
    plant = designed_plant(design.split)
    known: dict[float | None, float] = {}
    keys = [float(t) if np.any(requirement.fixed == t) else None for t in schedule.times]
    for key in set(keys):
        fixed = (requirement.fixed + schedule.period * np.arange(periods)[:, None]).ravel()
        required = repeated(requirement, periods).replace(fixed=fixed if key is None else fixed[fixed != key])
        try:
            if every_period:
                found = _fewer(design, required, budget, rng)
            else:
                fewer = pose(plant, required, periods * len(schedule) - 1, counted=counted_rows(design.split))
                found = bounded(fewer, budget).bound.value
            whole = pose(plant, required, periods * len(schedule), check=False)
            roomy = key is None and periods == 1 and whole.always_has_room  # else fewer may see more than the design
            known[key] = min(found, design.upper_bound) if roomy else found
        except InfeasibleRequirementError:  # too few measurements for the states, or none left
            known[key] = 0.0
    return np.array([known[key] for key in keys])


def _fewer(design: ScheduleDesign, required: Requirement, budget: Budget, rng: checks.Seed) -> float:
    """The bound of a design with one sample fewer in every period; 0 where none is left."""
    count = len(design.schedule or ()) - 1
    if count == 0:
        return 0.0
    required = required.replace(samples=count, target_sigma=None)
    found = design_schedule(design.plant, required, rng=copy.deepcopy(rng), budget=budget.seconds_left())
    if found.status == "interrupted":
        raise KeyboardInterrupt
    return found.upper_bound


def without_sample(schedule: PeriodicSchedule, i: int, periods: int) -> PeriodicSchedule | None:
    """The schedule without sample i in one of so many periods; None where there is no other sample."""
    times = (schedule.times + schedule.period * np.arange(periods)[:, None]).ravel()
    if times.size == 1:
        return None
    keep = np.arange(times.size) != i
    mask = None if schedule.outputs is None else np.tile(schedule.outputs, (periods, 1))[keep]
    details = ScheduleDetails(time_unit=schedule.time_unit, output_names=schedule.output_names)
    return PeriodicSchedule.from_times(times[keep], periods * schedule.period, mask, **details)
