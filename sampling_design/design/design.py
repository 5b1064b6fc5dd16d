"""Design of an endless periodic schedule, with its proven sigma and a bound that none can beat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import TypeVar

import numpy as np

from sampling_design.checkers.strict import Tree
from sampling_design.design.bounds.branching import narrowed
from sampling_design.design.bounds.evidence import UpperBound, bound_of_count, gap_bounded
from sampling_design.design.bounds.relaxation import LEAST_SECONDS, relax_placed, sigma_of_moved
from sampling_design.design.bounds.zones import flow_of
from sampling_design.design.folding import folded, parts, unfolded
from sampling_design.design.problem.canonical import canonical
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.interrupt import DesignInterrupt
from sampling_design.design.problem.posing import in_own_unit, pose, resolve, split_for
from sampling_design.design.problem.requirement import Requirement
from sampling_design.design.schedule_design import (
    CountProblem,
    ScheduleDesign,
    bounded,
    brought_back,
    candidates,
    designed_plant,
    prove,
    rival_counts,
)
from sampling_design.design.search.costs import affordable, relax_costly
from sampling_design.design.search.fedorov_exchange import even, is_admissible
from sampling_design.design.search.local_search import search
from sampling_design.design.sizes import check_size
from sampling_design.errors import InfeasibleRequirementError, SolverError
from sampling_design.observability.count.zero_count import ZeroCountBound, zero_count_bound
from sampling_design.observability.sigma_bracket import rtol_and_seconds
from sampling_design.observability.windows.window_record import WindowSigma
from sampling_design.plants.functional import Wanted, counted_rows
from sampling_design.plants.modes import ModalSplit
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.declarations import above, below
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule

Best = TypeVar("Best")

STARTS = 8  # starts that are refined by default
BRANCHES = 20  # boxes of schedules cut in two by default, to narrow the bound: of eight states, fewer of more
PATIENCE = 150  # boxes that are cut by default where the gap is wide otherwise, as long as that helps
GAP = 0.03  # share of sigma by which the bound may lie above it where no cuts are asked for: cutting ends there
MOST_TRIED = 100  # largest count that a target sigma is tried with where the requirement names none
_MOST_STARTS = 10**9  # or cuts: none that is asked for beyond would ever be reached
_PROOF = 0.2  # of the budget: what the proof of sigma may take at least, even where all is spent
_PLAIN_STATES, _ORDERED_STATES = 8, 20  # up to which a cut takes little time, and where order alone decides
_ENOUGH = 1e-5  # relative distance from the bound at which a search has nothing left to find


@checked
def design_schedule(
    plant: Plant,
    requirement: Requirement | None = None,
    *,
    of: Wanted = None,
    starts: int = STARTS,
    branches: int | None = None,
    rtol: float = 0.001,
    rng: checks.Seed = None,
    budget: float | None = None,
    progress: Progress | None = None,
) -> ScheduleDesign:
    """Design an endless periodic schedule whose worst window shows the state as well as possible.

        maximise over schedules   inf over real t of sigma_n(rows C e^{A (tau - (t - T))}, tau in [t - T, t])

    Parameters
    ----------
    plant : Plant
    requirement : Requirement, optional
        What is left out is filled in from the plant's modes and reported in `defaults_used`.
    of : str, sequence of str, or (k, n) array, optional
        Rows of the state that must be observable, instead of `requirement.of`. Default: those.
    starts : int
        Starts that are refined, beside the even and the rounded ones.
    branches : int, optional
        How often a box of schedules is cut in two to narrow the upper bound; 0 keeps that of the relaxations alone.
        Default: until the gap is at most 3 %, with 20 cuts, or up to 150 as long as it falls (fewer beyond eight
        states, where each takes longer; beyond twenty where no state grows or decays and windows hold whole periods).
    rtol : float
        Width of the bracket that proves sigma.
    rng : numpy.random.Generator or its seed, optional
        Draws the random starts. Default: seeded with 0.
    budget : float, optional [seconds]
        Relaxations, search and branching stop then; what is there is proven, within half as much time again. The
        bound holds but is wider, and `status` says "budget". An interrupt (Ctrl-C) ends the work likewise, `status`
        is "interrupted"; a second one, before the proof is made, is raised.
    progress : callable, optional
        Called with the fraction done and a message: sigma that is proven or was found, the bound, the gap between them,
        and what is done. The first comes as soon as even spacing is proven.

    Returns
    -------
    ScheduleDesign
        With `schedule` None where nothing is retained.

    Raises
    ------
    ArgumentError
        If the requirement does not fit the plant (unknown output, other times than the period holds).
    NotObservableError
        If a retained mode is seen by no output.
    InfeasibleRequirementError
        If no schedule meets the requirement; names the obstacle and the nearest one that works.

    Notes
    -----
    *Claim.* `sigma` is proven over all real window positions; `upper_bound` holds for every admissible
    schedule over all real times with this count of samples (not only on a grid).
    *Method.* Semidefinite relaxations on grids give weights and multipliers. The multipliers give the bound
    by weak duality, re-normalised and maximised over real times, so that no solver is trusted; where the
    requirement may be shifted in time, windows after each sample, weighed by the gap, and branching on how late each
    sample can be narrow it. The weights are rounded;
    even, rounded and random starts are refined by sequential semidefinite programs.
    *Numerical aspects.* Everything runs in a basis in which the windows' Gram matrices are near the
    identity; a congruence keeps the inequalities.

    References
    ----------
    The paper, Theorems 14, 16 and 17 (the schedule rule).

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> design = design_schedule(plant, Requirement(window=4.0, spacing=0.5, samples=3))
    >>> design.sigma <= 1.0539 <= design.upper_bound
    True
    """
    wanted = Requirement() if requirement is None else requirement
    wanted = wanted if of is None else wanted.replace(of=of)
    starts = checks.whole("starts", min(starts, _MOST_STARTS), 1)
    cuts = None if branches is None else checks.whole("branches", min(branches, _MOST_STARTS))
    given = Budget(rtol_and_seconds(rtol, budget)[1])
    split = split_for(plant, wanted)
    plant = split.plant
    if split.retained.n_states == 0:
        return _nothing(plant, split, wanted)
    resolved, used, count = resolve(split, wanted)
    least = max(1, resolved.fixed.size, resolved.samples.get("exactly", resolved.samples.get("at_least", 1)))
    check_size(pose(designed_plant(split), resolved, least, check=False))
    if count is None:  # of chosen rows it refuses a mode that no output observes
        count = zero_count_bound(split.retained, float(resolved.window or 0))
    run = _DesignRun(
        plant=plant,
        split=split,
        requirement=resolved,
        used=used,
        zero_count=count,
        seed=int(checks.generator(rng).integers(2**63)),
        starts=starts,
        branches=cuts,
        rtol=rtol,
        budget=given,
        progress=progress,
    )
    try:
        return _aimed(run) if resolved.target_sigma is not None else run.best()
    except InfeasibleRequirementError as error:
        raise in_own_unit(error, wanted, plant.time_unit) from None


def _aimed(run: _DesignRun) -> ScheduleDesign:
    """The fewest samples for the target; an error's nearest requirement is tried, so that it reaches its target."""
    try:
        return run.fewest()
    except InfeasibleRequirementError as error:
        if error.obstacle == "target_sigma":
            raise
        first = error
    try:
        replace(run, requirement=run.requirement.replace(**first.nearest)).fewest()
    except InfeasibleRequirementError as second:
        first.nearest |= second.nearest
    raise first


def _nothing(plant: Plant, split: ModalSplit, requirement: Requirement) -> ScheduleDesign:
    """The result where every mode decays by itself."""
    note = "no samples needed; ask for a faster decay with `decay_rate` to have slow modes observed"
    return ScheduleDesign(
        schedule=None,
        sigma=np.inf,
        sigma_attained=np.inf,
        upper_bound=np.inf,
        requirement=requirement,
        defaults_used={},
        plant=plant,
        split=split,
        zero_count=None,
        window=None,
        bound=None,
        status="no samples needed",
        notes=(note,),
    )


@dataclass(eq=False)
class _DesignRun:
    """One call of `design_schedule`: everything that its steps share, and what is known so far."""

    plant: Plant
    split: ModalSplit
    requirement: Requirement
    used: Tree
    zero_count: ZeroCountBound
    seed: int
    starts: int
    branches: int | None
    rtol: float
    budget: Budget
    progress: Progress | None
    late: str = "budget"
    sigma: float = field(default=0.0, init=False)
    bound: float = field(default=np.inf, init=False)

    @property
    def designed(self) -> Plant:
        return designed_plant(self.split)

    def posed(self, samples: int) -> DesignProblem:
        return pose(self.designed, self.requirement, samples, counted=counted_rows(self.split))

    def say(self, fraction: float, message: str) -> None:
        """Tell what is known of the count that is worked on, and what is done."""
        if self.progress:
            known = [f"sigma {below(self.sigma, 5)}"] if self.sigma > 0 else []
            known += [f"bound {above(self.bound, 5)}"] if np.isfinite(self.bound) else []
            known += [f"gap {100 * max(1 - self.sigma / self.bound, 0.0):.1f} %"] if len(known) == 2 else []
            self.progress(fraction, ", ".join([*known, message]))

    def guarded(self, step: Callable[[], Best]) -> Best:
        """What a step gives; after an interrupt what it has by then, and every later step as if time were up."""
        try:
            return step()
        except DesignInterrupt as stop:
            self.interrupt()
            return stop.best  # type: ignore[return-value]
        except KeyboardInterrupt:
            self.interrupt()
            return step()

    def interrupt(self) -> None:
        """Let time be up."""
        self.late = "interrupted"
        self.budget.stop()

    def begin(self, samples: int, fraction: float) -> None:
        """Prove even spacing and say so: the first answer, before anything is solved."""
        self.sigma, self.bound = 0.0, np.inf
        if self.progress and not self.budget.over:
            problem = self.posed(samples)
            times = even(problem, 0.5)
            if times is not None and is_admissible(problem, times):
                self.sigma = self.proven(problem, times, problem.mask(times))[1].lower
        self.say(fraction, f"bounding {samples} samples per period")

    def sized(self, samples: int, fraction: float) -> CountProblem:
        """Bound one count of samples, and say what is known of it as soon as it is."""

        def bounded_by(bound: float) -> None:
            self.bound = bound
            self.say(fraction, f"bounding {samples} samples per period")

        self.guarded(lambda: self.begin(samples, fraction))
        found = self.guarded(lambda: bounded(self.posed(samples), self.budget, bounded_by))
        self.bound = found.bound.value
        return found

    def best(self) -> ScheduleDesign:
        """The best of all counts that are asked for and that count; every other one is bounded, or sees no more."""
        counts = rival_counts(self.designed, self.requirement)
        best: ScheduleDesign | None = None
        refused: InfeasibleRequirementError | SolverError | None = None
        bounds: dict[int, UpperBound] = {}
        sized: CountProblem | None = None
        for done, samples in enumerate(counts):
            low, high = done / len(counts), (done + 1) / len(counts)
            if best is not None and sized is not None and self.budget.over:
                bounds[samples] = bound_of_count(canonical(self.posed(samples)), sized.relaxation)
                continue
            sized = self.sized(samples, low)
            bounds[samples] = sized.bound
            if best is not None and sized.bound.value <= best.sigma:
                continue
            try:
                known = 0.0 if best is None else best.sigma
                found = self.searched(sized, low + 0.15 * (high - low), high, known)
            except (InfeasibleRequirementError, SolverError) as error:  # room and money for this count was not found
                refused = refused or error
                continue
            bounds[samples] = found.bound or sized.bound
            if best is None or found.sigma > best.sigma:
                best = found
        if best is None:
            assert refused is not None
            raise refused
        if len(bounds) == 1:
            return best
        own = len(best.schedule or ())
        rest = {samples: bound for samples, bound in bounds.items() if samples != own}
        top = max(bound.value for bound in bounds.values())
        return replace(best, upper_bound=top, other_counts=rest, status=self.late if self.budget.over else best.status)

    def searched(self, sized: CountProblem, low: float, high: float, known: float = 0.0) -> ScheduleDesign:
        """Search and prove where the bound is known already; none below a sigma that is `known` needs narrowing."""
        middle, near = low + 0.5 * (high - low), low + 0.95 * (high - low)

        problem, size, enough = sized.canon.inside, sized.canon.size, _enough(sized)

        def inner(fraction: float, sigma: float) -> None:
            self.sigma = max(self.sigma, sigma * size)
            self.say(low + fraction * (middle - low), "refining schedules")

        def cut_to(fraction: float, bound: float) -> None:
            self.bound = min(self.bound, bound * size)
            self.say(middle + fraction * (near - middle), "narrowing the bound")

        rng = np.random.default_rng([self.seed, sized.problem.samples])  # the same for a count, whatever came before
        first = self.guarded(lambda: search(problem, sized.relaxation, rng, self.starts, self.budget, inner, enough))
        found, chosen = first, problem.mask(first.times)
        if problem.is_costly:
            found, chosen = self.guarded(lambda: affordable(problem, first, sized.relaxation, self.budget, enough))
        tied = self.guarded(lambda: self.tied(sized, rng, found.sigma))
        reached = [found.sigma, *(sigma for _, _, sigma in tied)]
        if problem.late:  # the search knows exact times alone
            reached = [sigma_of_moved(problem, found.times, chosen)]
        target = max(*reached, known / size)
        steps, most, gap = _cuts(problem, self.branches)
        self.sigma = max(self.sigma, target * size)
        bound, far = sized.inner, target * (1 + gap)
        if steps and bound.value > far:
            bound = self.guarded(lambda: gap_bounded(problem, sized.inner, target, self.budget))
        begun = bound
        if begun is sized.inner or begun.value > far:
            bound = self.guarded(lambda: narrowed(problem, begun, target, steps, self.budget, cut_to, most, gap))
        cut = bound
        bound = sized.bound if cut is sized.inner else self.guarded(lambda: cut.brought_back(sized.canon))
        time_left = not self.budget.over
        self.guarded(lambda: self.say(near, "proving sigma over all window positions"))
        times, chosen = brought_back(sized.canon, found.times, chosen)
        proposed = [*candidates(sized.problem, times, chosen), *((t, mask) for t, mask, _ in tied)]
        proven = self.guarded(lambda: [self.proven(sized.problem, times, mask) for times, mask in proposed])
        schedule, proof = max(proven, key=lambda pair: pair[1].lower)
        return ScheduleDesign(
            schedule=schedule,
            sigma=proof.lower,
            sigma_attained=proof.upper,
            upper_bound=bound.value,
            requirement=self.requirement,
            defaults_used=self.used,
            plant=self.plant,
            split=self.split,
            zero_count=self.zero_count,
            window=proof,
            bound=bound,
            history=tuple(asdict(trial.in_units(size)) for trial in found.trials),
            solver=sized.solver,
            status=_status(proof.lower, bound.value) if found.complete and time_left else self.late,
            notes=(self.used["notice"],) if "notice" in self.used else (),
            seconds=self.budget.seconds,
        )

    def tied(self, sized: CountProblem, rng: np.random.Generator, reached: float) -> list[tuple[Array, Mask, float]]:
        """Times that repeat within the period, what they measure and their sigma, where that could be better."""
        part, enough = folded(sized.canon.inside), _enough(sized)
        if part is None or self.budget.over or reached >= enough:
            return []
        seconds = self.budget.seconds_left(LEAST_SECONDS, 1 / 3)
        placed = (relax_costly if part.is_costly else relax_placed)(part, seconds=seconds)
        try:
            found = search(part, placed, rng, self.starts, self.budget, enough=enough)
            chosen = part.mask(found.times)
            if part.is_costly:
                found, chosen = affordable(part, found, placed, self.budget, enough)
        except (InfeasibleRequirementError, SolverError):  # none of these repeats, or none was found
            return []
        inside = sized.canon.inside
        times, chosen = sized.canon.times(*unfolded(inside, parts(inside), found.times, chosen))
        return [(times, chosen, found.sigma)] if is_admissible(sized.problem, times) else []

    def proven(self, problem: DesignProblem, times: Array, mask: Mask) -> tuple[PeriodicSchedule, WindowSigma]:
        """The times as a schedule, outputs listed only where a sample leaves some out, and what it proves."""
        listed, unit, names = None if mask.all() else mask, self.plant.time_unit, self.plant.outputs.names
        schedule = PeriodicSchedule.from_times(times, problem.period, listed, time_unit=unit, output_names=names)
        least = _PROOF * min(self.budget.seconds, self.budget.spent) + LEAST_SECONDS
        seconds = self.budget.seconds_left(least / 2, 1 / 2)
        return schedule, prove(self.split, schedule, self.requirement, self.rtol, budget=seconds)

    def fewest(self) -> ScheduleDesign:
        """The fewest samples whose proven sigma reaches the target; counts whose bound falls short are skipped."""
        target = float(self.requirement.target_sigma or 0)
        low, high = self.limits()
        ruled_out, best, last = low - 1, None, None
        too_few: Tree = {}
        for samples in range(low, high + 1):
            try:
                last = sized = self.sized(samples, (samples - low) / (high - low + 1))
            except InfeasibleRequirementError as error:
                if error.obstacle != "samples":
                    if last is None:
                        raise
                    break
                ruled_out, too_few = samples, error.nearest  # not enough to see the state at all: go on
                continue
            if self.budget.over:
                break
            if sized.bound.value < target:
                if ruled_out == samples - 1:
                    ruled_out = samples
                continue
            share = (samples - low) / (high - low + 1)
            found = self.searched(sized, share, min(1.0, share + 1 / (high - low + 1)))
            if found.sigma >= target:
                return replace(found, notes=(*found.notes, _fewest_note(samples, ruled_out, target)))
            if found.upper_bound < target and ruled_out == samples - 1:  # the narrowed bound falls short too
                ruled_out = samples
            best = found if best is None or found.sigma > best.sigma else best
        if best is None and last is not None:
            best = self.searched(last, 0.5, 1.0)
        if best is not None and self.budget.over:
            note = f"the budget ran out before every count was tried; {target:g} is not reached yet"
            return best if best.sigma >= target else replace(best, status=self.late, notes=(*best.notes, note))
        raise _out_of_reach(target, high, best, too_few)

    def limits(self) -> tuple[int, int]:
        """Smallest and largest count to try; below the smallest an average over all windows rules the target out.

        The mean of W over one period is (k/P) int_0^T G, so that sigma^2 <= (k/P) lambda_min(int_0^T G).
        """
        wanted = self.requirement.samples
        problem = pose(self.designed, self.requirement, 1, check=False)
        exact = wanted.get("exactly")
        high = exact or min(wanted.get("at_most", MOST_TRIED), max(problem.capacity(), 1))
        mean = problem.window / problem.period * float(problem.rows.least(np.eye(self.designed.n_states))[0])
        ratio = min(float(self.requirement.target_sigma or 0) / np.sqrt(max(mean, np.finfo(float).tiny)), _MOST_STARTS)
        needed = int(np.ceil(0.98 * ratio**2))
        low = exact or max(wanted.get("at_least", 1), problem.fixed.size, needed, 1)
        return min(low, high), high


def _enough(sized: CountProblem) -> float:
    """The sigma of exact times at which a search has nothing left to find."""
    exact = replace(sized.canon.inside, late=0.0)
    return (sized.inner.value_for(exact) if sized.canon.inside.late else sized.inner.value) * (1 - _ENOUGH)


def _cuts(problem: DesignProblem, proposed: int | None) -> tuple[int, int, float]:
    """How many boxes are cut, how many at most where the gap stays wide, and the gap that ends it."""
    if proposed is not None:
        return proposed, proposed, 0.0
    n = problem.plant.n_states
    share = min(1.0, (_PLAIN_STATES * (_PLAIN_STATES + 1) / (n * (n + 1))) ** 2)  # as inequalities have rows
    share = share if flow_of(problem) is None else min(1.0, (_ORDERED_STATES / n) ** 3)
    return int(BRANCHES * share), int(PATIENCE * share), GAP


def _status(sigma: float, bound: float) -> str:
    """How a search for one count ended that had all the time it needs."""
    if sigma > 0:
        return "complete"
    return "unobservable" if bound == 0 else "none found"


def _out_of_reach(target: float, high: int, best: ScheduleDesign | None, too_few: Tree) -> InfeasibleRequirementError:
    """The error of a target that no count reaches; the nearest is what was proven with the best of them."""
    nearest: Tree = {**too_few, "target_sigma": None}  # where not even the most samples see the state
    reached = "no schedule that makes every state observable"
    if best is not None and best.schedule is not None and best.sigma > 0:
        proven = float(below(best.sigma, 5))
        nearest = {"target_sigma": proven, "samples": len(best.schedule)}
        reached = f"{proven:g} with {len(best.schedule)} samples"
    return InfeasibleRequirementError(
        f"`target_sigma` {target:g} is not reached with up to {high} samples per period; found {reached}. "
        "Ask for less, allow more samples, or narrow the spacing.",
        "target_sigma",
        nearest,
    )


def _fewest_note(samples: int, ruled_out: int, target: float) -> str:
    if ruled_out >= samples - 1:
        return f"{samples} is the fewest: the bound rules out {target:g} with {samples - 1}"
    return f"{samples} is the fewest that was found; the bound rules out {target:g} up to {ruled_out} only"
