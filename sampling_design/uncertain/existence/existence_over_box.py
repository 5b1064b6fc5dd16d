"""Whether a certificate exists on a schedule for every plant of a box: gains that make every plant's error contract."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.certificates.existence.periodic import ExistenceAnswer, certificate_exists, judged
from sampling_design.errors import UndecidedError
from sampling_design.numerics.branch_and_bound import all_proven
from sampling_design.numerics.filtering import propagate, update_with_gain
from sampling_design.numerics.linalg import positive_or_one
from sampling_design.observability.alignment import align
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget
from sampling_design.records.record import below, short
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.uncertain.box.branching import halved, least_near
from sampling_design.uncertain.box.model import UP, BoxCells, BoxModel, at_parameters, expanded, signs
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

Margin = Callable[[Plant], tuple[bool, float, str]]  # of a plant: whether a certificate exists, how clearly, and why

PERIODS, SETTLED = 400, 1e-6
"""Periods of the filter that finds the gains, and the relative change at which it has settled."""
SECONDS = 60.0
SMALLEST = 1e-9
"""BoxCells below this share of the box are not halved further."""
STEPS = 60  # of a descent, for each parameter
LOOKS = 8  # cells judged between two looks for a plant without certificate


@dataclass(frozen=True, eq=False, repr=False)
class ExistenceOverBox(ExistenceAnswer):
    """Whether some certificate with rate eta exists on a schedule, for each plant of a box its own: true if so.

    Attributes
    ----------
    exists : bool
        True: proven for every plant of the box, by gains in each cell. False: the plant `worst` has none.
    worst : mapping
        Values of the parameters with the least margin that was found.
    margin : float
        Of `certificate_exists` at `worst`.
    reason : str
    cells : int
        BoxCells of the box, each with gains of its own; 0 where no parameter moves anything: then eigenvalues decide.
    """

    exists: bool
    worst: Mapping[str, float]
    margin: float
    reason: str
    cells: int
    plant: UncertainPlant

    _answers = (
        "whether every plant of a box has a certificate of that rate on the schedule: {exists}",
        "proven: gains in {cells} cells, or one plant that has none",
        "{margin:3} from the answer no",
        "`certificate_exists` of the plant `.worst`",
    )

    _table = {"at": "{worst:or the nominal plant}", "reason": "{reason}"}

    def explain(self) -> str:
        """Say why."""
        if self.exists:
            return (
                f"Every plant of the box has a certificate; the nearest to having none is {at_parameters(self.worst)}."
            )
        return f"Not every plant of the box has a certificate: at {at_parameters(self.worst)}, {self.reason}."


def margin_on(schedule: PeriodicSchedule, eta: float) -> Margin:
    """Whether a certificate exists for a plant, and by what margin, for searches over plants."""

    def margin(member: Plant) -> tuple[bool, float, str]:
        found = judged(member, schedule, eta)
        if not found.exists:
            try:
                found = certificate_exists(member, schedule, eta)
            except UndecidedError:  # beside a plant that has none: the descent goes on to that one
                return True, found.margin, found.reason
        return found.exists, found.margin, found.reason

    return margin


def existence_over_box(
    plant: UncertainPlant, schedule: PeriodicSchedule | Schedule, eta: float, budget: float = SECONDS
) -> ExistenceOverBox:
    """Decide for a whole box: see `certificate_exists`. A "no" is one plant's own.

    Raises UndecidedError if the budget ran out before every cell was proven and no plant without certificate was found.
    """
    schedule, eta = align(plant.nominal, schedule), checks.nonnegative("eta", eta)
    clock = Budget(checks.positive("budget", budget))
    if not schedule.endless:
        nominal = {each.name: each.nominal for each in plant.parameters}
        return ExistenceOverBox(True, nominal, np.inf, "a finite schedule is certified to its last time", 0, plant)
    model, margin = BoxModel.of(plant, "certificate_exists", schedule.period), margin_on(schedule, eta)
    if not model.m:  # of one plant its eigenvalues say it
        own = certificate_exists(plant.nominal, schedule, eta)
        return ExistenceOverBox(own.exists, model.values(model.start), own.margin, own.reason, 0, plant)
    gaps = FilteredErrors(model, schedule, eta, clock)
    worst, proven, looked = looked_at(model, margin, model.start, None), 0, 0

    def parts_of(cell: BoxCells) -> list[BoxCells] | None:
        nonlocal worst, proven, looked
        if gaps.contract(cell):
            proven += 1
            return []
        looked += 1
        if looked % LOOKS == 1:
            worst = looked_at(model, margin, cell.u[0], worst)
            worst = descended(model, margin, worst, clock) if worst[1] else worst
            if not worst[1]:
                return None
        if clock.over or cell.half.max(initial=0.0) < SMALLEST:
            values = model.values(worst[2])
            raise UndecidedError(
                f"undecided: whether a certificate with rate {below(eta)} exists for every plant of the box; the "
                f"nearest to having none is at {at_parameters(values)} (margin {short(worst[0], 3)}). "
                "Try a smaller box or rate.",
                parameters=values, margin=worst[0],
            )  # fmt: skip
        return halved(cell, gaps.effect(cell)).each()

    if not worst[1] or not all_proven([BoxCells.whole(model.m)], parts_of):
        return ExistenceOverBox(False, model.values(worst[2]), worst[0], worst[3], proven, plant)
    worst = descended(model, margin, worst, clock)
    reason = "gains were proven to make the error of every plant contract" if worst[1] else worst[3]
    return ExistenceOverBox(worst[1], model.values(worst[2]), worst[0], reason, proven, plant)


CellAnswer = tuple[float, bool, Array, str]


def looked_at(model: BoxModel, margin: Margin, u: Array, best: CellAnswer | None) -> CellAnswer:
    """The plant of the least margin: this one or the best so far."""
    exists, value, reason = margin(model.plant.at(model.values(u)))
    found = (value, exists, u, reason)
    return found if best is None or not exists or value < best[0] else best


def descended(model: BoxModel, margin: Margin, best: CellAnswer, clock: Budget) -> CellAnswer:
    """The least margin that a descent from there finds, as far as there is time."""
    if not model.m or not np.isfinite(best[0]):
        return best
    found = best

    def value(u: Array) -> float:
        nonlocal found
        if clock.over:
            return 0.0
        here = looked_at(model, margin, np.clip(u, -1.0, 1.0), None)
        found = here if found[1] and (not here[1] or here[0] < found[0]) else found
        return here[0] if found[1] else 0.0  # a plant without certificate ends the descent

    least_near(value, np.clip(best[2], -1.0, 1.0), [(-1.0, 1.0)] * model.m, STEPS * model.m)
    return found


class FilteredErrors:
    """The error e -> (I - K C(theta)) e^{(A(theta) + eta/2) h} e over every gap of a period, with gains of a centre."""

    def __init__(self, model: BoxModel, schedule: PeriodicSchedule, eta: float, clock: Budget) -> None:
        self.clock, self.model, self.gaps = clock, model, np.append(schedule.gaps[1:], schedule.gaps[0])
        n, p = model.n, len(model.C)
        outputs = np.ones((len(schedule), p), dtype=bool) if schedule.outputs is None else schedule.outputs
        self.measured, self.rate = np.roll(outputs, -1, axis=0), eta
        self.size = positive_or_one(np.linalg.norm(model.C, axis=1))
        self.identity = np.eye(n)

    def contract(self, cell: BoxCells) -> bool:
        """Whether gains were found with which the error of every plant of the cell contracts over a period."""
        n, m = self.model.n, self.model.m
        if not n:
            return True
        A, C = self.model.at(cell.u)
        found = self._filter(A[0], C[0] / self.size[:, None])
        if found is None:
            return False
        gains, roots = found
        count = len(self.gaps)
        many = cell.take(np.zeros(count, dtype=int))
        bare = replace(self.model, C=self.identity, parts_C=np.zeros((m, n, n)), unit=np.ones(n))
        flows = expanded(bare, many, self.gaps[:, None], np.ones((count, 1, n), dtype=bool))
        turned = cell.half[0][:, None, None] * self.model.parts_C / self.size[:, None]
        total = 0.0
        for i, gap in enumerate(self.gaps.tolist()):
            after, before, rows = roots[(i + 1) % count], roots[i], self.measured[i]
            back = np.linalg.solve(before.T, self.identity).T if n else before  # before^-1
            keep = after @ (self.identity - gains[i] @ (C[0] / self.size[:, None])[rows])
            moved = -(after @ gains[i]) @ turned[:, rows]
            flow, slopes = flows.rows[i] @ back, flows.slopes[i] @ back
            linear = moved @ flow + keep @ slopes
            corners = keep @ flow + np.einsum("cm,mij->cij", signs(m), linear)
            left = np.linalg.norm(moved, axis=(1, 2)).sum()
            rest = min(float(np.sqrt(max(np.linalg.eigvalsh(back.T @ r.N[i] @ back)[-1], 0.0)))
                       if np.isfinite(r.N[i]).all() else np.inf for r in flows.rest)  # fmt: skip
            bound = np.linalg.norm(corners, 2, axis=(1, 2)).max() + left * np.linalg.norm(slopes, axis=(1, 2)).sum()
            bound += (np.linalg.norm(keep, 2) + left) * rest
            with np.errstate(divide="ignore"):
                total += self.rate / 2 * gap + float(np.log(bound * UP))
        return bool(total < 0)

    def effect(self, cell: BoxCells) -> Array:
        """How much each parameter matters to a period."""
        model, span = self.model, float(self.gaps.sum())
        along = np.linalg.norm(model.parts_A, axis=(1, 2)) * span
        rows = np.linalg.norm(model.parts_C / self.size[:, None], axis=(1, 2))
        return np.append(cell.half[0] * (along + rows), 0.0)[None]

    def _filter(self, A: Array, C: Array) -> tuple[list[Array], list[Array]] | None:
        """Gains after each gap and a root of the information before it, in the rhythm of the period.

        None if that, or time, is lost.
        """
        n, gaps = self.model.n, self.gaps
        shifted = A + self.rate / 2 * self.identity
        flows = Plant(shifted, C).transition(gaps)
        noise = gaps / gaps.sum()
        Y, last, found = self.identity, self.identity, None
        for period in range(PERIODS):
            gains, infos = [], []
            for i, F in enumerate(flows):
                infos.append(Y)
                Y, K = update_with_gain(propagate(Y, F, noise[i] * self.identity), C[self.measured[i]])
                gains.append(K)
            if self.clock.over or not np.isfinite(Y).all() or np.linalg.norm(Y) > 1e12:
                return None
            found = gains, infos
            if period > 3 and np.linalg.norm(Y - last) < SETTLED * np.linalg.norm(Y):
                break
            last = Y
        assert found is not None
        try:
            return found[0], [np.linalg.solve(np.linalg.cholesky(info), np.eye(n)) for info in found[1]]
        except np.linalg.LinAlgError:
            return None
