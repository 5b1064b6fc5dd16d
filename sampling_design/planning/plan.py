"""The verb: from a requirement to a plan on the grid, proven, with what no plan can beat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from sampling_design.certificates.certification import certify
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.errors import (
    ArgumentError,
    CertificateError,
    InfeasibleRequirementError,
    MathematicsError,
    NotDetectableError,
    UndecidedError,
)
from sampling_design.planning import proven_choice
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.bounds import CostProver
from sampling_design.planning.covering import CoveringRows, cheapest
from sampling_design.planning.discrete_plant import discretize, finer_grid, modes_of
from sampling_design.planning.disturbed import plan_robustness, plan_start
from sampling_design.planning.evidence import EASED, CostProof, PlanBound, gathered
from sampling_design.planning.plan_record import Plan, limit_of, without_limits
from sampling_design.planning.problem import PlanProblem, pose_plan
from sampling_design.planning.proven_choice import FeasibleChoices, ProvenChoice
from sampling_design.planning.requirement import PlanRequirement
from sampling_design.planning.search import PlanSearch
from sampling_design.planning.search_progress import AFTER, AFTERWARDS, CERTIFIED, PlanProgress
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Mask
from sampling_design.records.budget import Budget, BudgetSpentError, Progress
from sampling_design.records.record import above, short
from sampling_design.records.signatures import checked
from sampling_design.records.units import spoken

Made = TypeVar("Made")

MARGIN = 0.004
"""A choice is taken if its accuracy is this much below the tolerance, at first: the proof is as much above it."""

LONGER_PAST = 0.03  # a choice proven this much worse than it was judged has a longer past than the search looks at
IDLE = 2  # doublings of the past in a row that show nothing new, after which there is nothing to be seen there

MARGINS = (MARGIN, 0.015, 0.04)

NARROW_MARGINS = (5e-4, 0.015, 0.04)
"""The same for standard deviations, which are only larger between steps of the grid."""

SOUGHT = 0.75
"""Share of the work after which nothing cheaper than what is held is sought: the rest, of what was given for this grid
alone, proves it and bounds the cost."""

COARSER = (0.25, 1.0)
"""By what share of itself, and how many seconds, a budget grows for each coarser grid that is looked at first."""

MOST_REFUSED = 8  # choices judged to keep the tolerances, but not proven to, after which it is left at the margin
ROUNDS = 60  # choices judged at one level
WIDTH = 0.002  # relative width to which the level out of reach is found


@checked
def plan_samples(
    plant: Plant,
    requirement: PlanRequirement,
    *,
    search_seconds: float | None = 60.0,
    certificate: bool = True,
    robustness: bool = True,
    from_start: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """Choose when to measure what, so that wanted accuracies are kept at the least cost, or are best for a cost.

        minimise price over choices with  rho(goal) <= tolerance,   or minimise  max rho(goal)/tolerance

    Parameters
    ----------
    plant : Plant
    requirement : PlanRequirement
    search_seconds : float, optional
        Work of the search for choices, in seconds of an ordinary processor core, counted from the sizes of what it
        solves and never by a clock: the same plan on every machine, however busy. When it is spent, or three quarters
        of it once something is held, the status says "budget". What follows (its proof, the bounds, then certificate,
        robustness and start) may take as much again and two seconds, and what does not fit in is left out, and said
        (`left_out`); of a proof that does not, what it says by then is the plan's, which may not keep the tolerances
        (`keeps`). Coarser grids are searched first, with as much as they would be given alone; each adds a quarter and
        one second. None: no limit.
    certificate : bool
        Also certify the samples, where they show the whole state.
    robustness : bool
        Also prove how late samples may be, and how many may be lost, before a tolerance breaks.
    from_start : bool
        Also prove from when on the tolerances are kept after the plan's start; `dates` does where it is not said.
    progress : callable, optional
        Called with the fraction done and a message: the best plan so far (the densest one before any is found), what
        none costs less than, as soon as that is proven, and the gap; then, and from the start, what is being done.

    Returns
    -------
    Plan
        With `verify()`, which works out everything anew. An interrupt (KeyboardInterrupt) after the search holds
        something ends it: the best of that by proof, with the status "interrupted", and what is left out.

    Raises
    ------
    ArgumentError
        If a name is unknown, a bound is missing, or times do not fit.
    InfeasibleRequirementError
        If not even measuring at every allowed time keeps the tolerances, or no choice within spacings, uses and limits
        does; names the nearest ones that can be kept.
    UndecidedError
        If no choice that shows all that is asked for is found, or none is proven to keep the tolerances.

    Notes
    -----
    *Claim.* `reached` is proven for all real times by `guaranteed_accuracy`, of a plan followed for ever; `start`
    says from when on after its start the tolerances are kept, whatever the error was then or within `initial_error`. No
    admissible choice on the grid of the same cost is better than `bound.ratio.level` times every tolerance, and none
    keeps them for less than `bound.cost.value`.
    *Method.* Hidden trajectories: disturbances that drive a goal to its tolerance while nothing measured shows them.
    Any plan must see every trajectory; moved by whole steps, a trajectory is one again. The cheapest choice that sees
    all trajectories so far is judged, and what breaks it joins (implicit hitting sets). The bounds are multipliers over
    trajectories. *Numerical aspects.* Neither side needs a solver to be checked.

    References
    ----------
    Micchelli and Rivlin (1977); Moreno-Centeno and Karp, The implicit hitting set approach, Oper. Res. 61 (2013).

    Examples
    --------
    >>> plant = Plant([[0.0]], [[1.0]], states=["level"])
    >>> wanted = PlanRequirement({"level": 0.52}, period=8.0, grid=1.0, w_bound=0.1,
    ...                          sensors={"y1": {"noise_bound": 0.1}})
    >>> found = plan_samples(plant, wanted)
    >>> found.samples, found.bound.cost.value
    (2, 2.0)
    """
    problem = pose_plan(plant, requirement)
    seconds = np.inf if search_seconds is None else checks.positive("search_seconds", search_seconds)
    run = _Planning(problem, seconds, progress)
    try:
        found = run.cheapest() if requirement.aim == "cheapest" else run.most_accurate()
    except KeyboardInterrupt:
        found = run.interrupted()
    work, left_out = run.oracle.work, list[str]()
    if found.bound.ratio is None and (work.over or found.status == "interrupted"):
        left_out.append("bound")
    work.extend(*AFTER[2], firm=True)

    def room_for(name: str, make: Callable[[Plan, Budget], Made | None]) -> Made | None:
        nonlocal found
        try:
            if found.status != "interrupted":
                run.progress.say(name, AFTERWARDS)
                return make(found, work)
        except BudgetSpentError:
            pass
        except KeyboardInterrupt:
            found = replace(found, status="interrupted")
        left_out.append(name)
        return None

    certified = room_for("certificate", plan_certificate) if certificate else None
    bears = room_for("robustness", plan_robustness) if robustness else None
    begins = room_for("start", plan_start) if from_start else None
    return replace(found, certificate=certified, start=begins, robustness=bears, left_out=tuple(left_out))


def plan_certificate(found: Plan, work: Budget | None = None) -> Certificate | None:
    """That the samples show the whole state, or else all that the rows of the goals need; or None.

    Raises BudgetSpentError if it takes more work than there is left.
    """
    (work or Budget(counted=True)).add(CERTIFIED, found.samples * found.plant.n_states**2)
    try:
        return certify(found.plant, found.schedule, of=found.problem.asked_rows())
    except (CertificateError, UndecidedError, NotDetectableError):
        return None


class _Planning:
    """One call: the search, its proof, and its bounds."""

    def __init__(self, problem: PlanProblem, work: float, progress: Progress | None, finer: _Planning | None = None):
        self.problem, self.given = problem, work
        more = len(proven_choice.coarser_grids(problem))
        whole = Budget(work * (1 + COARSER[0] * more) + COARSER[1] * more, counted=True)
        own = PlanProgress(progress, problem, whole)
        self.progress: PlanProgress = own if finer is None else finer.progress
        self.progress.say("looking at all that may be measured")
        self.discrete = discretize(problem)
        self.oracle = AccuracyOracle(problem, self.discrete, whole)
        self.search = PlanSearch(problem, self.oracle, self.progress)
        self.kept: list[Mask] = []
        """The densest choice, if it was judged to keep every tolerance."""
        self.least: CostProof | None = None
        """The bound on the cost, once it is proven."""
        self.feasible = FeasibleChoices(problem, self.oracle.work, self._proven)

    def started(self) -> list[Mask]:
        """What a search on a coarser grid holds: it is as good on this one, which has all of its times.

        That search is the one that the coarser grid would have by itself, to the last choice, whatever it was given: so
        none of its plans is cheaper, or more accurate, than that of this grid. Its best comes first.
        What it found against other choices joins them here: what is held needs no more of them, its bound does.
        """
        coarse, work = proven_choice.coarser(self.problem), self.oracle.work
        if coarse is None:
            return []
        try:
            run = _Planning(coarse, self.given, None, self)
        except (ArgumentError, MathematicsError):  # it is too coarse to be looked at
            return []
        best: list[Mask] = []
        try:
            best = [run.sought().chosen]
        except KeyboardInterrupt:
            self.search.incumbents += [(chosen, self.oracle.judge(chosen)[0]) for chosen in self._lifted(run, [])]
            raise
        except (MathematicsError, UndecidedError):  # what cannot be kept there may be kept here
            pass
        work.spend(run.oracle.work.spent)
        self.feasible.lift(run.feasible)
        self.search.add(proven_choice.lifted_trajectories(self.oracle, run.discrete, run.search.pool.trajectories), 1.0)
        return self._lifted(run, best)

    def _lifted(self, run: _Planning, best: list[Mask]) -> list[Mask]:
        """What a search on a coarser grid holds, the best first, and all of its times if they do, on this one."""
        feasible = [chosen for chosen, _ in run.search.incumbents[::-1]]
        return proven_choice.lifted_choices(self.problem, best + feasible + run.kept)

    def sought(self) -> ProvenChoice:
        """The best choice that the search for the requirement's aim comes to, by proof."""
        if self.problem.requirement.aim == "most accurate":
            last = self._most_accurate()
            held = [*self.search.incumbents, *((start, 0.0) for start in self.search.starts[:1])]
            return self.feasible.sharpest(held, last)
        return self._cheapest()[0]

    def _cheapest(self) -> tuple[ProvenChoice, bool]:
        """The least cost that keeps every tolerance, or nearly so, and whether that is what was sought last."""
        search, late = self.search, self.problem.timing_tolerance
        self._require_detectable()
        worst, trajectories = self.oracle.judge(self.problem.allowed, longest=True)
        search.add(trajectories, 0.0 if self.oracle.few else 1.0)
        everything = self._detecting(proven_choice.densest(self.problem))
        if worst > 1:
            proven_choice.refuse_what_none_keeps(self.oracle, self.feasible, everything, 1 + 4 * MARGIN)
        worst, trajectories = self.oracle.judge(everything, longest=True)
        search.add(trajectories, 1.0)
        if worst <= 1:
            self.kept = [everything]
            self.progress.found(everything, worst)
        search.seed(1.0)
        search.starts = self.started()
        search.share = 1 - (1 - SOUGHT) * self.given / self.oracle.work.seconds if np.isfinite(self.given) else SOUGHT
        margins = list(NARROW_MARGINS if search.stochastic else MARGINS[:1] if late else MARGINS)
        for margin in margins:
            again = True
            while again:
                search.chosen, search.complete = None, False
                search.cheapest(1 - margin, ROUNDS)
                last = self.feasible.proven(everything if search.chosen is None else search.chosen)
                again = last.worst > 1 and not search.late and self._needs_longer_past(last)
            if last.worst <= 1 or search.late:
                break
            margins += (
                proven_choice.tighter_margins(margin, self.oracle.judge(last.chosen)[0], last.worst) if late else []
            )
        if last.worst <= 1 and not late:
            last = self._within_margin(last)
        search.share = np.inf
        held = [*search.starts, *(chosen for chosen, _ in search.incumbents)]
        if last.worst > 1 and not search.incumbents and all(self.feasible.proven(each).worst > 1 for each in held):
            return last, False
        best = self.feasible.cheapest(held, everything)
        return best, best is last

    def _within_margin(self, last: ProvenChoice) -> ProvenChoice:
        """The cheapest choice that is proven, those judged between a margin and the tolerances themselves, too.

        One that is not proven is refused, with all that leaves out more.
        """
        search = self.search
        while search.complete and len(search.refused) < MOST_REFUSED:
            known = len(search.incumbents)
            search.cheapest(1 / EASED**2, ROUNDS, self.problem.cost(last.chosen))
            if len(search.incumbents) == known:
                break
            for chosen, _ in search.incumbents[known:]:
                found = self.feasible.proven(chosen)
                if found.worst > 1:
                    search.refused.append(chosen)
                elif self.problem.cost(chosen) < self.problem.cost(last.chosen):
                    last = found
        search.complete &= len(search.refused) < MOST_REFUSED
        return last

    def cheapest(self) -> Plan:
        """The least cost that keeps every tolerance, and what no choice can do."""
        search, (best, sure) = self.search, self._cheapest()
        if best.worst > 1:
            return self._nearest(best)
        cost = self.problem.cost(best.chosen)
        frame = CoveringRows(without_limits(self.problem), fixed=self.problem.is_free)
        search.sharpen(1 / EASED**2, cost)
        self.oracle.work.extend(*AFTER[0])
        prover = CostProver(frame, search.pool, self.oracle.work, search.find, self.oracle.grid_filter)
        self.least = prover.least_cost(1 / EASED**2, cost)
        self.progress.bounded(self.least.value)
        rival = self._better(best, cost)
        best = self.feasible.sharpest(rival.incumbents, best)
        known, keys = rival.out_of_reach, rival.keys
        self.oracle.work.extend(*AFTER[1])
        ratio = prover.out_of_reach(cost, known, best.worst, WIDTH, keys)
        return self._record(best, gathered(search.pool, ratio, self.least), sure)

    def interrupted(self) -> Plan:
        """The best of what the search holds, by proof, with the bound on its cost if that is proven already.

        Raises KeyboardInterrupt if it holds nothing yet.
        """
        incumbents, work = self.search.incumbents, self.oracle.work
        if not incumbents and not self.kept:
            raise KeyboardInterrupt
        work.stop()
        if self.problem.requirement.aim == "cheapest":
            try:
                everything = (self.kept or [proven_choice.densest(self.problem)])[0]
                best = self.feasible.cheapest([chosen for chosen, _ in incumbents], everything)
            except UndecidedError:  # the densest one was judged too well, and nothing else is feasible
                raise KeyboardInterrupt from None
        else:
            best = self.feasible.sharpest(incumbents, self.feasible.proven(incumbents[-1][0]))
        bound = gathered(self.search.pool, None, self.least)
        return proven_choice.plan_of(self.problem, best.chosen, best.proof, bound, "interrupted")

    def _needs_longer_past(self, found: ProvenChoice) -> bool:
        """Whether the search must look farther back, since it holds a choice for better than it is proven to be."""
        judged, _ = self.oracle.judge(found.chosen)
        if judged * (1 + LONGER_PAST) >= found.worst or self.problem.timing_tolerance:  # late samples make it worse
            return False
        return self.search.deepened(found.chosen, judged, found.worst / (1 + LONGER_PAST), IDLE) > judged * (
            1 + LONGER_PAST
        )

    def _nearest(self, best: ProvenChoice) -> Plan:
        """Where spacings, uses and limits leave nothing that keeps the tolerances: the least ratio that they do allow.

        Raises InfeasibleRequirementError if that is above 1, it is what can be kept, and nothing else was left open.
        """
        if best.cut:
            return self._record(best, PlanBound((), None, None), False)
        rival = self._better(best, np.inf)
        best = self.feasible.sharpest(rival.incumbents, best)
        best.require_bounded()
        if best.worst > 1 and self.search.out_of_reach:
            text, what = "No plan with these spacings, uses and limits was found that keeps the tolerances", "spacing"
            if self.problem.unspaced:
                text, what = "The tolerances are too close to the least that can be kept for a proof", "accuracy"
            near = {g.name: g.tolerance * best.worst * (1 + 4 * MARGIN) for g in self.problem.goals}
            kept = ", ".join(
                f"{g.name} {above(near[g.name])} instead of {short(g.tolerance)}" for g in self.problem.goals
            )
            slip = " Ask for that, or for smaller spacings, a larger `longest_use` or higher limits."
            slip = "" if self.problem.unspaced else slip
            raise InfeasibleRequirementError(f"{text}: {kept} can be kept.{slip}", what, near)
        return self._record(best, PlanBound((), None, None))

    def _better(self, best: ProvenChoice, cost: float) -> PlanSearch:
        """Of all plans of a cost, a search for the most accurate one; the trajectories found join the pool."""
        problem = self.problem
        limit = "most_samples" if problem.counts else "most_cost"
        limited = replace(problem, **{limit: min(cost, getattr(problem, limit))})
        search = PlanSearch(limited, self.oracle, self.progress)
        search.pool, search.undetected_at = self.search.pool, self.search.undetected_at
        search.keep(best.chosen, best.worst)
        search.seed(best.worst * 0.9)
        search.improve(ROUNDS // 3)
        return search

    def _most_accurate(self) -> ProvenChoice:
        """The least ratio of accuracy to tolerance that the limits allow, as far as the search comes."""
        search = self.search
        self._require_detectable()
        search.starts = self.started()
        for chosen in [self._detecting(proven_choice.sparse(self.problem)), *search.starts]:
            worst, trajectories = self.oracle.judge(chosen)
            search.add(trajectories, 0.0)
            if worst < search.worst:
                search.keep(chosen, worst)
        search.seed(search.worst * 0.9)
        search.improve(ROUNDS)
        last = self._proven_incumbent()
        while self._needs_longer_past(last) and not search.late:
            search.keep(last.chosen, self.oracle.judge(last.chosen)[0])
            search.improve(ROUNDS)
            last = self._proven_incumbent()
        return last

    def most_accurate(self) -> Plan:
        """The least ratio of accuracy to tolerance that the limits allow, and what no choice can do."""
        search, best = self.search, self.sought()
        limit, known, keys = limit_of(self.problem, 0.0), search.out_of_reach, search.keys
        work = self.oracle.work
        work.extend(*AFTER[1])
        prover = CostProver(search.covering, search.pool, work, search.find, self.oracle.grid_filter)
        ratio = prover.out_of_reach(limit, known, best.worst, WIDTH, keys)
        if ratio is not None:
            self.progress.bounded(ratio.level)
        return self._record(best, gathered(search.pool, ratio, None))

    def _proven_incumbent(self) -> ProvenChoice:
        """What the search holds, proven."""
        assert self.search.chosen is not None
        return self.feasible.proven(self.search.chosen)

    def _proven(self, chosen: Mask) -> ProvenChoice:
        """The proof of a choice, as far as there is work for it: a little after an interrupt or too long a search."""
        self.progress.say("proving")
        work, (share, seconds) = self.oracle.work, AFTER[0]
        left = (1 + share) * work.seconds + seconds - work.spent
        room = share * work.spent + seconds if work.stopped else max(left, min(work.seconds, seconds))
        own = Budget(room, counted=True)
        found = proven_choice.proven_of(self.problem, chosen, own)
        work.spend(own.spent)
        return found

    def _require_detectable(self) -> None:
        """Refuse goals that not even all that is allowed shows.

        Raises InfeasibleRequirementError if a mode that never decays moves a goal and is hidden at every allowed time.
        """
        undetected = self.oracle.hidden(self.problem.allowed)
        if undetected is not None:
            unit = self.problem.plant.time_unit
            finer = finer_grid(self.problem, self.discrete, self.oracle.rows)
            help_ = "Allow other hours or another sensor."
            if finer is not None:
                help_ = f"The grid hides it: one of {spoken(finer, unit)} shows it."
            raise InfeasibleRequirementError(
                "Not even measuring at every allowed time shows all that `accuracy` asks for: "
                f"{modes_of(self.discrete, undetected)} never decays and stays hidden. {help_}",
                "grid" if finer is not None else "accuracy",
            )

    def _detecting(self, chosen: Mask) -> Mask:
        """The choice, or one within the limits that hides no trajectory that never decays.

        Raises InfeasibleRequirementError if the limits leave none, UndecidedError if that is not found out.
        """
        search = self.search
        while (undetected := self.oracle.hidden(chosen)) is not None:
            search.require_detection(undetected, 0.0)
            model = search.covering.model([], [], 0.0, search.undetected_at)
            other, none = cheapest(search.covering, model, np.zeros(model.c.size), self.oracle.work)
            if other is None and not none:
                raise UndecidedError(
                    "undecided: no choice within the limits was found that shows all that `accuracy` asks for. Give "
                    "more `search_seconds`, or allow more samples or other hours."
                )
            if other is None:
                raise InfeasibleRequirementError(
                    "No choice within the limits shows all that `accuracy` asks for: a trajectory that "
                    "never decays stays hidden. Allow more samples or other hours.",
                    "cost_limit",
                )
            chosen = other
        return chosen

    def _record(self, best: ProvenChoice, bound: PlanBound, sure: bool = True) -> Plan:
        complete = sure and self.search.complete
        self.progress.proven(best.chosen, best.worst)
        return proven_choice.plan_of(self.problem, best.chosen, best.proof, bound, "complete" if complete else "budget")
