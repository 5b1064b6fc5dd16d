"""The result: when to measure what, how well that keeps the goals, what it costs, and what no other plan can do."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import compress
from pathlib import Path

import numpy as np

from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.accuracy.deviation import StandardDeviation, standard_deviation
from sampling_design.errors import ArgumentError, FileFormatError, NotDetectableError
from sampling_design.planning.comparison import PlanComparison
from sampling_design.planning.covering import CoveringRows
from sampling_design.planning.dates import PlanDates, plan_dates
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.disturbed import robustness_holds, start_holds
from sampling_design.planning.evidence import bound_holds, broken_below, proof_to_dict, trajectory_to_dict
from sampling_design.planning.figures import PlanFigures, accuracy_question
from sampling_design.planning.filter_deviation import GridFilter
from sampling_design.planning.problem import PlanProblem
from sampling_design.planning.sampling_sheet import write_form, write_sheet
from sampling_design.plants.files import write_plant
from sampling_design.plants.functional import FunctionalPlant, is_about
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.dates import parse_date
from sampling_design.records.declarations import Column, above, below, plain, selected
from sampling_design.records.file_io import check_columns, to_json, write_text
from sampling_design.records.record import Plain, counted, short
from sampling_design.records.signatures import checked
from sampling_design.records.units import spoken
from sampling_design.schedules.calendar import write_calendar_csv, write_ics
from sampling_design.schedules.files import write_schedule
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule


@checked
def write_plan(
    plan: PlanFigures, folder: str | os.PathLike[str], dates: PlanDates | None = None, *, person: str = ""
) -> tuple[list[Path], list[str]]:
    """Write plan.json, plant.toml, schedule.csv and the certificate; where there are dates calendars, sheet and form.

    Parameters
    ----------
    plan : Plan
    folder : path
    dates : PlanDates, optional
        Of a plan with a calendar: plan.ics, calendar.csv, dates.csv, form.csv and sheet.html are of these.
    person : str
        Who takes the samples, for the sheet.

    Returns
    -------
    list of Path, list of str
        The files, and what there is to know of them.

    Raises
    ------
    ArgumentError
        If the name of a sensor cannot be a column; nothing is written then.
    FileFormatError
        If a file cannot be written.
    """
    place, notes = Path(folder), list[str]()
    check_columns("plan", plan.plant.outputs.names)
    files = [
        write_text(place / "plan.json", to_json(plan.to_dict())),
        write_plant(plan.plant, place / "plant.toml"),
        write_schedule(plan.schedule, place / "schedule.csv"),
    ]
    if plan.certificate is not None:
        files.append(plan.certificate.save(place / "certificate.json"))
    elif "certificate" in plan.left_out:
        why = (
            "interrupted" if plan.status == "interrupted" else "the seconds of the search were spent before it was made"
        )
        notes.append(f"certificate.json is not written: {why}.")
    if dates is not None and dates.entries and plan.requirement.calendar is not None:
        real, zone = dates.schedule(), plan.requirement.calendar.zone
        title = f"{plan.plant.name or 'plant'}: sample"
        files += [
            write_calendar_csv(real, place / "calendar.csv", zone=zone),
            write_schedule(real, place / "dates.csv"),
            write_form(dates, place / "form.csv"),
            write_ics(real, place / "plan.ics", summary=title, span=real.times[-1] + 1.0, zone=zone),
            write_sheet(dates, place / "sheet.html", person=person),
        ]
    return files, notes


FORMAT = "sampling-design/plan/1"

SAME = 1e-6  # figures worked out anew agree to this share

UNSTARTED = " This is said of a plan that has been followed for ever; its start was not looked at."


@dataclass(frozen=True, eq=False, repr=False)
class Plan(PlanFigures):
    """A periodic plan on the grid, with what it guarantees and how far from the best it can be.

    Attributes
    ----------
    plant : Plant
    requirement : PlanRequirement
    schedule : PeriodicSchedule
        Times since the start of the period, with the outputs of each sample; its origin is the calendar's start.
    accuracy : Accuracy or None
        The proof for the goals that are guaranteed, in their order.
    deviation : StandardDeviation or None
        The same for goals that are standard deviations.
    reached : (g,) array
        What the plan proves for each goal, in the goal's unit, at the times that it asks for.
    bound : PlanBound
    status : str
        "complete" where nothing better can be found on the grid (to the search's accuracy), "interrupted" where the
        call was, else "budget" (of seconds, or of choices that are judged to do and proven not to). The search's own
        word: `verify` proves the bounds, not this.
    certificate : Certificate or None
        That the samples show the whole state, with a rate; None where they do not, or where it was not asked for.
    robustness : PlanRobustness or None
        How late samples may be and how many may be lost before a tolerance breaks.
    left_out : tuple of str
        What was asked for and did not fit into `search_seconds`: "bound", "certificate", "robustness", "start".
    start : PlanStart or None
        From when on the tolerances are kept by who follows the plan from its start on; `reached` is of one that has
        been followed for ever. None where that is not decided.
    """

    def compare(self, other: Plan, names: tuple[str, str] = ("first", "second")) -> PlanComparison:
        """Return this plan and another one side by side: accuracy, cost, samples, robustness.

        Raises ArgumentError if it is no plan for the same states with a goal in common.
        """
        return PlanComparison(self, other, names)

    def dates(self, periods: int = 4, *, prove: bool = True) -> PlanDates:
        """Return the samples on real dates from the calendar's start on: clock changes and holidays judged together.

        Raises ArgumentError if the plan has no calendar.

        Parameters
        ----------
        periods : int
        prove : bool
            Prove the whole sequence over all real times; else it is judged in floats, on the grid.
        """
        return plan_dates(self, periods, prove=prove)

    def save(self, path: str | os.PathLike[str], *, periods: int = 4, person: str = "") -> Path:
        """Write the plan (a path that ends in .json), or a folder with all that the command `plan` writes.

        Raises FileFormatError if a file cannot be written, or `path` ends as a file does that is no .json.

        Parameters
        ----------
        path : path
            Into a folder go plan.json, plant.toml, schedule.csv and the certificate; where there is a calendar also
            plan.ics and calendar.csv, dates.csv, form.csv and sheet.html.
        periods : int
            Periods that the calendar is written out for.
        person : str
            Who takes the samples, for the sheet.

        Returns
        -------
        Path
            Where it was written.
        """
        place = Path(path)
        if place.suffix.lower() == ".json":
            return write_text(path, to_json(self.to_dict()))
        if place.suffix[1:].isalpha() and not place.is_dir():  # a folder may be named "v1.2"
            raise FileFormatError(
                f"{place}: a plan is written as .json, or into a folder with plan.ics, form.csv and sheet.html, got "
                f"{place.suffix!r}. For the folder: save({str(place.with_suffix(''))!r}).",
                str(place),
            )
        place.mkdir(parents=True, exist_ok=True)
        dated = self.keeps and self.requirement.calendar is not None
        write_plan(self, path, self.dates(periods) if dated else None, person=person)
        return place

    def elapsed(self, name: str, when: float | str | datetime) -> float:
        """Return the time since the plan's start of a date, or of a time that is a number already.

        Raises
        ------
        ArgumentError
            If it is neither, or a date while the plan has no calendar.
        """
        calendar = self.requirement.calendar
        match when:
            case str() | datetime():
                if calendar is None:
                    raise ArgumentError(f"`{name}` must be a number of {self.plant.time_unit}, got {when!r}.")
                return calendar.elapsed_at(parse_date(name, when, calendar.zone)) / self.minutes(1.0)
        return checks.number(name, when)

    def _columns(self) -> dict[str, Column]:
        """The samples of a period: their dates where there is a calendar, and which sensors are read."""
        read = [", ".join(compress(self.plant.outputs.names, row)) for row in self.chosen[self.chosen.any(axis=1)]]
        calendar, found = self.requirement.calendar, dict[str, Column]()
        if calendar is not None:
            found["date"] = [calendar.date(self.minutes(t)) for t in self.schedule.times]
        return {**found, "time": self.schedule.times, "outputs": read}

    def verify(self) -> bool:
        """Work out every claim anew: hours, accuracy, and both bounds without a solver, and what the plan bears."""
        problem = self.problem
        if not problem.is_admissible(self.chosen):
            return False
        if not self._proofs_hold(problem):
            return False
        mine = reached(problem, self.chosen, self.accuracy, self.deviation)
        if not np.allclose(mine, self.reached, rtol=SAME, atol=0):
            return False
        if not self._extras_hold():
            return False
        free, ends = problem.is_free, [problem.ends(g) for g in range(len(problem.goals))]
        loose, most = CoveringRows(without_limits(problem), fixed=free), limit_of(problem, self.cost)
        # where the least cost is sought, that is the limit: rivals need not keep the requirement's own
        limited = loose if problem.requirement.aim == "cheapest" else CoveringRows(problem, fixed=free)
        return bound_holds(self.bound, loose, limited, discretize(problem), ends, most)

    def _proofs_hold(self, problem: PlanProblem) -> bool:
        """Whether accuracy and standard deviations are those of the choice, for the goals that want them."""
        asked, anew = accuracy_question(problem, self.chosen), deviation_of(problem, self.chosen)
        if (asked is None) != (self.accuracy is None) or (anew is None) != (self.deviation is None):
            return False
        if asked is not None and self.accuracy is not None:
            question, rows = asked
            mine = np.array_equal(rows.matrix, self.accuracy.rows.matrix) and self.accuracy.question.is_same(question)
            if not mine or not self.accuracy.verify():
                return False
        if anew is None or self.deviation is None:
            return True
        pairs = [(getattr(anew, key), getattr(self.deviation, key)) for key in ("worst", "mean", "times", "profile")]
        return (
            anew.plant.same_dynamics(self.deviation.plant)
            and np.array_equal(anew.rows.matrix, self.deviation.rows.matrix)
            and all(a.shape == b.shape and np.allclose(a, b, rtol=SAME, atol=0) for a, b in pairs)
        )

    def _extras_hold(self) -> bool:
        """Whether certificate, start and robustness are of this plan, and proven anew."""
        if self.certificate is not None:
            mine = is_about(self.certificate.plant, self.plant)
            if not mine or not same_samples(self.certificate.schedule, self.schedule):
                return False
            if not self.certificate.verify():
                return False
        if self.start is not None and not start_holds(self, self.start):
            return False
        return self.robustness is None or robustness_holds(self, self.robustness)

    def to_dict(self) -> dict[str, Plain]:
        """Plain data with everything that a re-check needs."""
        bound = self.bound
        return {
            "format": FORMAT,
            **selected(self, "status plant requirement schedule reached cost ratio"),
            "trajectories": plain([trajectory_to_dict(trajectory) for trajectory in bound.trajectories]),
            "no_better_than": plain(bound.ratio and proof_to_dict(bound.ratio)),
            "no_cheaper_than": plain(bound.cost and proof_to_dict(bound.cost)),
            **selected(self, "certificate robustness left_out start"),
        }

    _maker = "plan_samples(plant, requirement)"
    _reader = "read_plan"
    _answers = ("{_what}", "{_evidence}", "{_good}", "`.verify()`")

    def _evidence(self) -> str:
        beaten = self.bound.ratio is not None or self.bound.cost is not None
        return "proven: what the plan keeps" + (", and what none beats, by trajectories" if beaten else "")

    def _what(self) -> str:
        cost = "" if self.problem.counts else f", at a cost of {short(self.cost)}"
        return f"{counted(self.samples, 'sample')} in {spoken(self.schedule.period, self.plant.time_unit)}{cost}"

    def _good(self) -> str:
        more = (
            f"at most {above(100 * self.gap, 2)} %" if self.bound.ratio is not None else "nobody has bounded how much"
        )
        return f"{above(self.ratio, 4)} of the tolerances; {more} could be gained"

    def _rows(self) -> list[tuple[str, str]]:
        rows = list[tuple[str, str]]()
        if self.bound.cost is not None:
            rows.append(("no plan keeps it for less than", below(self.bound.cost.value)))
        rows += [("samples come", self._late())] if self._late() else []
        for value, goal in zip(self.reached, self.goals, strict=True):
            unit = f" {goal.unit}" if goal.unit else ""
            text = f"{above(value, 4)} of {short(goal.tolerance)}{unit} ({goal.when()})"
            if self.bound.ratio is not None and len(self.goals) == 1:
                text += f"; no plan of this cost below {below(self.bound.ratio.level * goal.tolerance, 4)}"
            rows.append((goal.name, text))
        if self.bound.ratio is not None and len(self.goals) > 1:
            level = below(self.bound.ratio.level, 4)
            rows.append(("of the tolerances", f"{above(self.ratio, 4)}; no plan of this cost below {level}"))
        rows += [] if self.start is None else self.start._rows()
        rows += [] if self.robustness is None else self.robustness._rows()
        if self.certificate is not None:
            eta = f"{below(self.certificate.eta)} 1/{self.plant.time_unit}"
            part = self.certificate.plant
            certified = ", ".join(part.wanted.names) if isinstance(part, FunctionalPlant) else "the whole state"
            rows.append(("certificate", f"the samples show {certified}; rate {eta}"))
        rows += [("left out", self.unsaid())] if self.left_out else []
        return [*rows, ("status", self.status)]

    def _late(self) -> str:
        """How early or late samples may be, in words."""
        late, unit = self.problem.timing_tolerance, self.plant.time_unit
        return late.describe(in_words=lambda time: spoken(time, unit)) if late else ""

    def unsaid(self) -> str:
        """What was asked for and left out, in words."""
        why = "interrupted" if self.status == "interrupted" else "`search_seconds` were spent; give more"
        return f"{self.missing()}: {why}"

    def explain(self) -> str:
        """Say what the plan keeps, and what no other can."""
        unit = "" if self.problem.counts else f", at a cost of {short(self.cost)},"
        parts = [
            f"{g.name} within {above(v, 3)}{' ' * bool(g.unit)}{g.unit}{' (standard deviation)' * g.stochastic}"
            for v, g in zip(self.reached, self.goals, strict=True)
        ]
        text = f"{counted(self.samples, 'sample')} every {spoken(self.schedule.period, self.plant.time_unit)}{unit} "
        text += "keeps " if self.samples == 1 else "keep "
        text += ", ".join(parts) + (f", for samples {self._late()}." if self._late() else ".")
        if self.bound.cost is not None:
            text += f" No admissible plan keeps the tolerances for less than {below(self.bound.cost.value)}."
            text += self._for_less(self.bound.cost.value)
        if self.bound.ratio is not None:
            share = 100 * self.bound.ratio.level
            text += f" No admissible plan of this cost is better than {below(share, 3)} % of every tolerance: this one"
            text += f" needs {above(100 * self.ratio, 3)} %, so at most {above(100 * self.gap, 2)} % could be gained."
        text += UNSTARTED if self.start is None else f" {self.start.explain()}"
        text += "" if self.robustness is None else f" {self.robustness.explain()}"
        return f"{text} Left out: {self.unsaid()}." if self.left_out else text

    def _for_less(self, least: float) -> str:
        """What a cheaper plan breaks, and what of it is not decided, in words."""
        covering = CoveringRows(without_limits(self.problem), fixed=self.problem.is_free)
        broken = [
            f"{self.goals[g].name}{' (standard deviation)' * self.goals[g].stochastic} at "
            + (f"one of {len(steps)} times" if len(steps) > 1 else "one time")
            for g, steps in broken_below(self.bound, covering).items()
        ]
        goals = " or ".join(broken)
        text = f" At a lower cost, disturbances that no sample shows take {goals} of the period beyond the tolerance."
        if self.cost > least * (1 + SAME):
            text = f"{text if broken else ''} Whether one for less than {short(self.cost)} does is not decided."
        return text if broken or self.cost > least * (1 + SAME) else ""


def same_samples(one: Schedule | PeriodicSchedule | None, other: PeriodicSchedule) -> bool:
    """Whether two schedules measure the same at the same times of the same period."""
    if one is None or not one.endless or len(one) != len(other):
        return False
    masks = [np.asarray(True) if s.outputs is None else np.asarray(s.outputs) for s in (one, other)]
    close = np.allclose(one.times, other.times, rtol=0, atol=1e-9 * other.period)
    return close and bool(np.all(masks[0] == masks[1])) and bool(np.isclose(one.period, other.period, rtol=1e-12))


def without_limits(problem: PlanProblem) -> PlanProblem:
    """The problem without its limits of samples and cost."""
    return replace(problem, most_samples=np.inf, most_cost=np.inf)


def limit_of(problem: PlanProblem, cost: float) -> float:
    """The cost above which a choice is not a rival: that of the plan, or beyond every price if limits rule."""
    if problem.requirement.aim == "cheapest":
        return cost
    steps = float(problem.allowed.any(axis=1).sum())
    if problem.counts:
        return steps
    return min(problem.most_cost, float(problem.allowed.sum(axis=0) @ problem.price) + steps * problem.visit)


def deviation_of(problem: PlanProblem, chosen: Mask) -> StandardDeviation | None:
    """The standard deviations of a choice's goals of that kind; None if it has none."""
    goals = [goal for goal in problem.goals if goal.stochastic]
    if not goals:
        return None
    bounded = chosen & np.isfinite(problem.v_deviation)
    if not bounded.any():
        raise NotDetectableError("`schedule` reads no sensor that has a `noise_deviation`.")
    return standard_deviation(
        problem.plant,
        problem.schedule(bounded),
        w_intensity=np.array(problem.w_intensity),
        v_deviation=np.where(np.isfinite(problem.v_deviation), problem.v_deviation, 1.0),
        of=np.array([goal.row for goal in goals]),
    )


def reached(
    problem: PlanProblem, chosen: Mask, proof: Accuracy | None, deviation: StandardDeviation | None = None
) -> Array:
    """What is proven for each goal at the times that it asks for."""
    values = np.zeros(len(problem.goals))
    bounded = problem.guaranteed
    if proof is not None:
        values[bounded] = _bounded(problem, proof, bounded)
    if deviation is not None:
        stochastic = [k for k, goal in enumerate(problem.goals) if goal.stochastic]
        on_grid = GridFilter(problem, discretize(problem)).worst(chosen[None])[0]
        for k, worst in zip(stochastic, deviation.worst.tolist(), strict=True):
            goal = problem.goals[k]
            values[k] = worst if goal.at == "all times" else float(on_grid[k]) * goal.tolerance
    return values


def _bounded(problem: PlanProblem, proof: Accuracy, which: list[int]) -> Array:
    """What an accuracy proves for each goal that is guaranteed."""
    values = []
    for k, goal in enumerate(problem.goals[i] for i in which):
        if goal.at == "all times":
            values.append(float(proof.upper[k]))
        elif goal.at == "after each sample":
            values.append(float(np.max(proof.at_samples[k])))
        else:
            values.append(max(_at(proof, k, float(step) * problem.step, problem.period) for step in goal.steps))
    return np.array(values)


def _at(proof: Accuracy, k: int, t: float, period: float) -> float:
    """The upper side of a profile at one time, both panels at an edge; the last one ends where the first begins."""
    edges = proof.profile.edges
    inside = edges[0] + (t - edges[0]) % period
    slack = 1e-9 * period
    again = inside + period * np.array([[-1.0], [0.0], [1.0]])
    panels = np.flatnonzero(np.any((edges[:-1] <= again + slack) & (again - slack <= edges[1:]), axis=0))
    return float(np.max(proof.profile.upper[k][panels]))
