"""The samples of one period as a user places them: questions about them, answered in plain data."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.accuracy import guaranteed_accuracy
from sampling_design.certificates.certification import certify
from sampling_design.certificates.compare.four_horizons import four_horizons
from sampling_design.certificates.existence.periodic import certificate_exists, judged
from sampling_design.checkers.strict import is_text
from sampling_design.design.design import design_schedule
from sampling_design.design.problem.posing import in_unit, resolve, split_for
from sampling_design.design.problem.requirement import Requirement
from sampling_design.errors import ArgumentError, SamplingDesignError
from sampling_design.observability.sigma_bracket import SigmaDeviations
from sampling_design.observability.windows.window_record import WindowSigma
from sampling_design.observability.windows.window_sigma import window_sigma
from sampling_design.planning.plan import plan_samples
from sampling_design.planning.problem import PlanProblem, pose_plan
from sampling_design.planning.requirement import PlanRequirement
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.declarations import above, below, plain
from sampling_design.records.file_io import from_json
from sampling_design.records.record import Plain, short
from sampling_design.records.units import readable_unit
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.files import read_schedule, write_schedule
from sampling_design.schedules.jitter import ON_TIME, Timing, TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.schedules.sensor import complement, numbers

Reply = dict[str, Plain]

LIVE_BUDGET = 0.5  # seconds that a curve may take while somebody drags; what is proven by then is shown

CLEARLY = 1e-6
"""Share of what one sample weighs above which a proven sigma is no matter of rounding. Where every window sees every
state, no period misses a mode, and nobody need look for one."""

MOST_MARKS = 400  # samples of a period beyond which a time line is no picture any more
PLAN_SECONDS = 15.0  # seconds that the search of a plan may take on a press of its button; its proof comes on top
MOVES = (0.05, 0.1, 0.2)  # shares of the mean gap by which a sample is moved to repair what broke, the smallest first
MENDED = 0.5  # share of the best sigma among those moves that a smaller one must reach to be proposed
MOST_POLYGONS = 6  # that are still distinguished
MOST_MOVED = 6  # samples of a period up to which every one is tried
TOGETHER = 1e-9  # share of the period within which the marks of two sensors are one sample


class ScheduleExplorer:
    """A plant, what is required of its schedule, and the samples of a period as they lie now.

    Parameters
    ----------
    plant : Plant
    requirement : Requirement or PlanRequirement, optional
        A plan requirement brings period, opening hours, bounds and tolerances along, and can be planned for.
    schedule : PeriodicSchedule, optional
        Where to begin; default: what was saved in `folder` before, else evenly spaced samples.
    w_bound, v_bound : as for `guaranteed_accuracy`
        With both, the accuracy of every state is shown as well.
    tolerance : (n,) array, optional
        The error of each state that would do, drawn beside its accuracy.
    projection : (str, str), optional
        Two states or outputs: what the samples of one period leave possible of them is drawn, sample by sample.
    initial_error : as for `guaranteed_accuracy`
        What is known at the start of that period.
    folder : path, optional
        Where `save` writes, and what was saved is found again; default: the current one, where nothing is looked for.
    words : str
        What a lecturer wants to be read above the picture.

    Raises
    ------
    ArgumentError
        If the parts do not fit together.
    """

    def __init__(
        self,
        plant: Plant,
        requirement: Requirement | PlanRequirement | None = None,
        schedule: PeriodicSchedule | None = None,
        *,
        w_bound: VectorBound = None,
        v_bound: VectorBound = None,
        tolerance: npt.ArrayLike | None = None,
        projection: tuple[str, str] | None = None,
        initial_error: VectorBound = None,
        folder: str | Path | None = None,
        words: str = "",
    ) -> None:
        self.plant = plant
        self.problem: PlanProblem | None = None
        if isinstance(requirement, PlanRequirement):
            self.problem = posed = pose_plan(plant, requirement)
            w_bound, v_bound = requirement.w_bound, np.where(np.isfinite(posed.v_bound), posed.v_bound, 1.0)
            requirement = Requirement(
                period=posed.period, time_unit=plant.time_unit, timing_tolerance=posed.timing_tolerance.plain
            )
        given = in_unit(requirement or Requirement(), plant.time_unit)
        self.timing_tolerance = given.timing_tolerance
        self.split = split_for(plant, given)
        # windows, opening hours and tolerance are those for which a design would be proven; its counts and gaps bind it
        counted = given if schedule is None or given.samples else given.replace(samples=len(schedule))
        wanted = resolve(self.split, counted).requirement
        self.requirement = wanted.replace(samples=given.samples, spacing=given.spacing)
        retained = self.split.retained
        self.clear = CLEARLY * float(np.max(np.linalg.norm(retained.scaled().C, axis=1), initial=0.0))
        self.window, self.period = float(wanted.window or 0), float(wanted.period or 0)
        self.axis_unit = readable_unit(
            self.period, plant.time_unit
        )  # of axes and words, and how much of it the plant's is
        self.w_bound, self.v_bound, self.words = w_bound, v_bound, words
        self.folder = None if folder is None else Path(folder)
        self.tolerance = None if tolerance is None else checks.vector("tolerance", tolerance, plant.n_states)
        self.rows: list[str] | Array | None = None
        self.labels = list(plant.states.labels())
        if self.problem is not None:
            goals = self.problem.goals
            self.rows, self.labels = np.array([goal.row for goal in goals]), [goal.name for goal in goals]
            self.tolerance = np.array([goal.tolerance for goal in goals])
        self.projection, self.initial_error = projection, initial_error
        self.closed = [self._closed(k) for k in range(plant.n_outputs)]
        self.schedule = self._begin(schedule, wanted.samples)

    def _begin(self, given: PeriodicSchedule | None, wanted: Mapping[str, int]) -> PeriodicSchedule:
        if given is None and self.folder is not None and (self.folder / "schedule.csv").is_file():
            found = read_schedule(self.folder / "schedule.csv")
            if isinstance(found, PeriodicSchedule) and abs(found.period - self.period) <= TOGETHER * self.period:
                given = found
        if given is not None:
            if abs(given.period - self.period) > TOGETHER * self.period:
                raise ArgumentError(
                    f"`schedule` must have the period {short(self.period)} that is required, got {short(given.period)}."
                )
            return given
        count = next(wanted[key] for key in ("exactly", "at_least", "at_most") if key in wanted)
        times = (np.arange(count) + 0.5) * self.period / count
        return self._scheduled([{"t": float(t), "on": [True] * self.plant.n_outputs} for t in times])

    def _scheduled(self, marks: Sequence[Mapping[str, object]]) -> PeriodicSchedule:
        """The schedule of some marks, each with its time and the sensors that are read."""
        p = self.plant.n_outputs
        if not 1 <= len(marks) <= MOST_MARKS:
            raise ArgumentError(f"`marks` must be 1 to {MOST_MARKS} samples, got {len(marks)}. Add one.")
        found: dict[float, Mask] = {}
        placed = [(checks.number("t", mark.get("t")), mark) for mark in marks]
        for at, mark in sorted(placed, key=lambda one: one[0]):
            t = at % self.period
            on = np.array(mark.get("on"), dtype=bool)
            if on.shape != (p,):
                raise ArgumentError(f"`on` must say for each of {p} sensors if it is read, got {mark.get('on')!r}.")
            near = next((s for s in found if abs(s - t) <= TOGETHER * self.period), t)
            found[near] = found.get(near, np.zeros(p, dtype=bool)) | on
        times = sorted(t for t, on in found.items() if on.any())
        mask = np.array([found[t] for t in times])
        names = self.plant.outputs.names
        return PeriodicSchedule.from_times(
            times,
            self.period,
            outputs=None if mask.all() else mask,
            output_names=None if mask.all() else names,
            time_unit=self.plant.time_unit,
        )

    def marks(self) -> list[Plain]:
        """The samples of a period as they lie now."""
        mask = self.schedule.outputs
        on = np.ones((len(self.schedule), self.plant.n_outputs), dtype=bool) if mask is None else mask
        times = self.schedule.times % self.period
        return [{"t": float(t), "on": [bool(b) for b in row]} for t, row in zip(times, on, strict=True)]

    def answer(self, question: Mapping[str, object]) -> Reply:
        """Answer {"ask": ..., "marks": [...]}; what cannot be answered says why in `error`."""
        verbs: dict[str, Callable[[], Reply]] = {
            "open": self._open,
            "sigma": self._sigma,
            "moving": lambda: self._sigma(moving=True),
            "accuracy": self._accuracy,
            "repair": self._repair,
            "projection": self._projection,
            "plan": self._plan,
            "design": self._design,
            "certify": self._certify,
            "horizons": lambda: {"said": four_horizons(self.plant, self.schedule).explain()},
            "save": self._save,
        }
        verb = question.get("ask")
        try:
            if not is_text(verb) or verb not in verbs:
                raise ArgumentError(f"`ask` must be one of {', '.join(verbs)}, got {verb!r:.40}.")
            marks = question.get("marks")
            if marks is not None:
                if not checks.holds(marks, dict):
                    raise ArgumentError("`marks` must be a list of samples, each with t and on.")
                self.schedule = self._scheduled(marks)
            return {"ask": verb, **{key: plain(value) for key, value in verbs[verb]().items()}}
        except SamplingDesignError as error:
            return {"ask": str(verb), "error": str(error)}

    def _open(self) -> Reply:
        sensors: list[Plain] = []
        for label, closed, price in zip(self.plant.outputs.labels(), self.closed, self._prices(), strict=True):
            sensors.append({"name": label, "closed": [[a, b] for a, b in closed], "cost": price})
        return {
            "name": self.plant.name or "plant",
            "unit": self.axis_unit[0],
            "per_unit": self.axis_unit[1],
            "period": self.period,
            "window": self.window,
            "forbidden": [[float(a), float(b)] for a, b in self.requirement.forbidden],
            "sensors": sensors,
            "states": list(self.labels),
            "plan": self.problem is not None,
            "projection": self.projection is not None,
            "tolerance": None if self.tolerance is None else [float(x) for x in self.tolerance],
            "bounds": self.w_bound is not None and self.v_bound is not None,
            "marks": self.marks(),
            "words": self.words,
        }

    def _at(self, t: float, digits: int = 4) -> str:
        """A time in the unit that the axes show."""
        unit, factor = self.axis_unit
        return f"{short(t * factor, digits)} {unit}"

    def _prices(self) -> list[float]:
        """Of one measurement by each sensor."""
        if self.problem is not None:
            return [float(price) for price in self.problem.price]
        terms = self.requirement.sensors
        return [terms[name].price if name in terms else 0.0 for name in self.plant.outputs.names]

    def _closed(self, sensor: int) -> list[tuple[float, float]]:
        """When a sensor cannot be read, within the period."""
        if self.problem is not None:
            allowed, step = self.problem.allowed[:, sensor], self.problem.step
            edges = np.flatnonzero(np.diff(allowed, prepend=True, append=True))
            return [(float(a * step), float(b * step)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        term = self.requirement.sensors.get(self.plant.outputs.names[sensor])
        if term is None or term.available is None:
            return []
        return [(a, b) for a, b in complement(numbers(term), self.period).tolist()]

    def _sigma(self, moving: bool = False) -> Reply:
        messages = self._rules()
        if not self.split.retained.n_states:
            return {"t": [], "sigma": [], "piece": [], "lower": None, "messages": [*messages, self.split.explain()]}
        found = self._window_sigma(self.schedule)
        profile = found.profile
        broken = [] if found.lower > self.clear else self._broken(found, moving)
        return {
            "t": profile.t.tolist(),
            "sigma": profile.sigma.tolist(),
            "piece": profile.piece.tolist(),
            "lower": found.lower,
            "upper": found.upper,
            "worst": found.witness.t,
            "scaled": found.coordinates == "scaled",
            "late": found._late(),
            "left": None if moving or found.deviations is None else _left(found.deviations),
            "messages": [*messages, *broken],
            "broken": bool(broken),
        }

    def _window_sigma(self, schedule: PeriodicSchedule) -> WindowSigma:
        """Sigma of a schedule for the times that the requirement allows, as long as its samples keep their order."""
        kept = self._kept(self.requirement.timing_tolerance, schedule)
        return window_sigma(self.split.retained, schedule, self.window, budget=LIVE_BUDGET, timing_tolerance=kept)

    def _kept(self, tolerance: Plain, schedule: PeriodicSchedule) -> Timing:
        """A tolerance as long as samples keep their order with it, else none."""
        late = TimingTolerance.of(tolerance, self.plant.outputs.names, self.plant.time_unit)
        return (late if late.span < min(schedule.gaps.min(), self.window) else ON_TIME).plain

    def _rules(self) -> list[Plain]:
        """What the requirement says of these samples, where it says no."""
        messages: list[Plain] = []
        times, gaps = self.schedule.times % self.period, self.schedule.gaps
        closed = [t for t in times if any(a <= t < b for a, b in self.requirement.forbidden)]
        mask = self.schedule.outputs
        for k, (name, hours) in enumerate(zip(self.plant.outputs.names, self.closed, strict=True)):
            read = times if mask is None else times[mask[:, k]]
            shut = [t for t in read if any(a <= t < b for a, b in hours)]
            if shut:
                messages.append(f"{name} cannot be read at {', '.join(self._at(t) for t in shut[:4])}.")
        if closed:
            messages.append(f"Closed at {', '.join(self._at(t) for t in closed[:4])}: no sample is allowed there.")
        late = TimingTolerance.of(self.requirement.timing_tolerance)
        if late and late.span >= gaps.min():
            messages.append(f"Samples {late.describe(self.plant.time_unit)} could change places: shown as if on time.")
        least = self.requirement.spacing
        if least and len(gaps) and gaps.min() < least * (1 - TOGETHER):
            at = int(np.argmin(gaps))
            messages.append(
                f"The samples before and at {self._at(times[at])} are {self._at(gaps[at])} apart; "
                f"at least {self._at(least)} is required."
            )
        return messages

    def _broken(self, found: WindowSigma, moving: bool) -> list[Plain]:
        """Why sigma is zero, or nearly: which modes the period does not tell apart.

        A "no" is confirmed by a run of the covariance over many periods only where the marks have come to rest.
        """
        decide = judged if moving else certificate_exists
        existence = decide(self.split.retained, self.schedule, 0.0)
        if existence.exists:
            if found.status == "too few samples":
                return ["Some window holds too few samples: sigma is zero there."]
            end = f"the window that ends {found.witness.position}"
            return [] if found.lower > 0 else [f"Of {end} nothing is proven: it misses a state, or rounding hides it."]
        if existence.eigenvalue is None or not existence.partners:
            return [
                f"These samples miss something in every window, however many periods one waits: {existence.reason}."
            ]
        names = _modes_said([existence.eigenvalue, *existence.partners])
        times = [self._at(t) for t in self.schedule.times % self.period]
        who = f"The samples at {' and '.join(times)} alias" if len(times) <= 3 else f"All {len(times)} samples alias"
        if len(times) == 1:
            who = f"The sample at {times[0]} of every period aliases"
        return [f"{who} the modes {' and '.join(names)}: they look alike in every window, however long one waits."]

    def _repair(self) -> Reply:
        """The least move of one sample that brings back a good part of what a move can, and its sigma."""
        times, mask = np.sort(self.schedule.times % self.period), self.schedule.outputs
        order = np.argsort(self.schedule.times % self.period)
        on = np.ones((times.size, self.plant.n_outputs), dtype=bool) if mask is None else mask[order]
        step = self.period / times.size
        tried: list[tuple[float, float, int]] = []
        for share in MOVES:
            for sign in (1.0, -1.0):
                for k in range(min(times.size, MOST_MOVED)):
                    moved = np.array(times)
                    moved[k] += sign * share * step
                    marks = [{"t": float(t), "on": row.tolist()} for t, row in zip(moved, on, strict=True)]
                    if not 0 <= moved[k] < self.period or np.unique(moved).size < moved.size:
                        continue
                    found = self._window_sigma(self._scheduled(marks))
                    tried.append((found.lower, sign * share * step, k))
        best = max((sigma for sigma, _, _ in tried), default=0.0)
        if not best > 0:
            return {"said": "No small move of one sample repairs it: add one."}
        sigma, by, k = next(one for one in tried if one[0] >= MENDED * best)
        move = f"Move the sample at {self._at(float(times[k]))} by {self._at(by, 2)}"
        said = f"{move}: sigma is then at least {below(sigma, 3)}."
        return {"said": said, "at": float(times[k]), "to": float(times[k] + by)}

    def _accuracy(self) -> Reply:
        if self.w_bound is None or self.v_bound is None:
            raise ArgumentError("`w_bound` and `v_bound` are needed for the accuracy: give both at the start.")
        found = guaranteed_accuracy(
            self.plant,
            self.schedule,
            w_bound=self.w_bound,
            v_bound=self.v_bound,
            of=self.rows,
            rtol=0.05,
            timing_tolerance=self._kept(self.timing_tolerance, self.schedule),
        )
        profile = found.profile
        finite = np.isfinite(found.upper)
        return {
            "edges": profile.edges.tolist(),
            "upper": [row.tolist() if ok else None for row, ok in zip(profile.upper, finite, strict=True)],
            "worst": [float(x) if ok else None for x, ok in zip(found.upper, finite, strict=True)],
            "messages": [*([] if finite.all() else [found.explain()]), *self._late(profile.edges, profile.upper)],
        }

    def _late(self, edges: Array, upper: Array) -> list[Plain]:
        """Which tolerance is broken, from when to when, and what would keep it."""
        messages: list[Plain] = []
        if self.tolerance is None:
            return messages
        for label, wanted, row in zip(self.labels, self.tolerance.tolist(), upper, strict=True):
            over = row > wanted
            if not over.any() or not np.all(np.isfinite(row)):
                continue
            text = f"{label}: {above(float(row.max()), 3)} is guaranteed, {short(wanted, 3)} wanted; "
            if over.all():
                messages.append(f"{text}at no time is it kept.")
                continue
            at = [self._at(float(t) % self.period) for t in edges]
            # the last cell of a period is followed by the first
            starts = np.flatnonzero(over & ~np.roll(over, 1))
            ends = np.flatnonzero(over & ~np.roll(over, -1))
            ends = np.roll(ends, -1) if ends[0] < starts[0] else ends
            pairs = sorted(zip(starts, ends, strict=True), key=lambda pair: edges[pair[0]] % self.period)
            spans = [f"from {at[a]} to {at[b + 1]}" for a, b in pairs]
            help_at = f"A sample shortly before {at[int(np.argmax(row))]}, where it is worst, would help."
            messages.append(f"{text}not kept {' and '.join(spans)}. {help_at}")
        return messages

    def _projection(self) -> Reply:
        """What the first sample, the first two, ... of a period leave possible at its end: a polygon for each."""
        if self.projection is None or self.w_bound is None or self.v_bound is None:
            raise ArgumentError("`projection` and both bounds are needed for the set: give them at the start.")
        mask, times = self.schedule.outputs, np.sort(self.schedule.times % self.period)
        order = np.argsort(self.schedule.times % self.period)
        steps: list[Plain] = []
        names: tuple[str, ...] = self.projection
        for k in range(1, min(times.size, MOST_POLYGONS) + 1):
            kept = None if mask is None else mask[order][:k]
            labels = None if mask is None else self.plant.outputs.names
            first = Schedule(times[:k], outputs=kept, output_names=labels, time_unit=self.plant.time_unit)
            found = guaranteed_accuracy(
                self.plant,
                first,
                w_bound=self.w_bound,
                v_bound=self.v_bound,
                of=list(self.projection),
                initial_error=self.initial_error,
                start=0.0,
                end=self.period,
            )
            if not np.all(np.isfinite(found.upper)) or np.any(found.known_from > self.period):
                steps.append({"after": k, "corners": []})
                continue
            region = found.projection(*self.projection, self.period, directions=8)
            steps.append({"after": k, "corners": region.outer.tolist(), "area": float(region.areas().outer)})
            names = tuple(f"{n} [{u}]" if u else n for n, u in zip(region.names, region.units, strict=True))
        return {"steps": steps, "names": list(names)}

    def _plan(self) -> Reply:
        if self.problem is None:
            raise ArgumentError("`requirement` must be a plan requirement for that: tolerances, prices, opening hours.")
        found = plan_samples(self.plant, self.problem.requirement, search_seconds=PLAN_SECONDS)
        self.schedule = found.schedule
        return {"said": found.explain(), "marks": self.marks()}

    def _design(self) -> Reply:
        count = len(self.schedule)
        wanted = self.requirement.replace(window=self.window, period=self.period)
        if not wanted.samples:
            wanted = wanted.replace(samples=count)
        found = design_schedule(self.plant, wanted, branches=0, budget=20.0)
        if found.schedule is None:
            return {"said": found.explain(), "marks": self.marks()}
        self.schedule = found.schedule
        left = "" if found.deviations is None else f" {found.deviations.explain()}"
        return {"said": found.explain().removesuffix(left), "marks": self.marks()}  # that stands beside the curve

    def _certify(self) -> Reply:
        found = certify(self.plant, self.schedule)
        return {"said": found.explain(), "passed": bool(found.verify())}

    def _save(self) -> Reply:
        folder = self.folder or Path()
        folder.mkdir(parents=True, exist_ok=True)
        path = write_schedule(self.schedule, folder / "schedule.csv")
        return {"said": f"Saved: {path}"}

    def answer_json(self, text: str) -> str:
        """The same for texts; what is no table of plain data is refused in `error`."""
        try:
            question = from_json(text, "question")
        except SamplingDesignError as error:
            return _message({"error": str(error)})
        return _message(self.answer(question))


def _left(found: SigmaDeviations) -> Reply:
    """What is left of sigma if samples are late (where that was not asked for) or lost."""
    return {"late": None if found.in_sigma else found.late, "lost": found.lost, "said": found.explain()}


def _modes_said(modes: Sequence[complex]) -> list[str]:
    """The modes in words, a conjugate pair as one."""
    said: list[str] = []
    for mode in modes:
        partnered = any(abs(mode - other.conjugate()) <= TOGETHER * abs(mode) for other in modes if other != mode)
        if partnered and mode.imag > 0:
            real = "" if abs(mode.real) <= TOGETHER * abs(mode) else short(mode.real)
            said.append(f"{real}±{short(mode.imag)}i")
        elif not partnered:
            said.append(format_eigenvalue(mode, grain=1e-12 * abs(mode)))
    return said


def _message(reply: Mapping[str, Plain]) -> str:
    """One line of JSON: no eye reads it, and a drag asks for sixty a second."""
    return json.dumps(reply, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
