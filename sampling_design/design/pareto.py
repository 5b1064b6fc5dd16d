"""Samples per period against sigma: one design per count, in parallel and resumable."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from sampling_design.checkers.parts import digest
from sampling_design.checkers.strict import Tree, count, flag, list_of, nonnegative, number, or_nothing, table, text
from sampling_design.design.design import design_schedule
from sampling_design.design.problem.requirement import TIMING, Requirement
from sampling_design.errors import ArgumentError, FileFormatError, InfeasibleRequirementError
from sampling_design.observability.sigma_bracket import SigmaDeviations
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.file_io import from_json, read_text, to_json, usable, write_text
from sampling_design.records.record import ListRecord, PlainRecord, above, below, counted
from sampling_design.records.signatures import checked
from sampling_design.records.sweeps import digest_of
from sampling_design.records.workers import Workers, check_workers, numbered
from sampling_design.schedules.jitter import TimingTolerance

FORMAT = "sampling-design/pareto/1"
MOST_COUNTS = 1000  # of one front: each is a design of its own, and a billion are not listed
NO_NEED = "no samples needed"
NO_TIME = "not designed: the budget ran out"
_LEAST_SHARE = 0.05  # of an equal share of the budget: with less than that a count is not begun

_LEFT = table(
    {
        "tolerance": TIMING,
        "in_sigma": flag,
        **dict.fromkeys(("late", "late_wider", "lost"), nonnegative),
        "lost_sample": or_nothing(count),
        "time_unit": text,
    }
)
_POINTS = list_of(
    table(
        {
            "samples": count,
            **dict.fromkeys(("sigma", "upper_bound"), or_nothing(nonnegative)),
            "times": list_of(number),
            "obstacle": text,
        },
        {"deviations": or_nothing(_LEFT), "coordinates": text},
    )
)


@dataclass(frozen=True)
class ParetoPoint:
    """One count of samples: proven sigma, the bound that none can beat, and the times.

    Both are 0 where that is impossible and infinite where no samples are needed; where nothing was designed the bound
    is infinite, as nothing is known.

    `deviations` says what is left of sigma if samples come early or late or one is lost, `coordinates` which ones all
    of these refer to ("" where there is no design).
    """

    samples: int
    sigma: float
    upper_bound: float
    times: tuple[float, ...]
    obstacle: str = ""
    deviations: SigmaDeviations | None = None
    coordinates: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class ParetoFront(ListRecord[ParetoPoint], PlainRecord):
    """Sigma and its bound over the number of samples per period.

    Attributes
    ----------
    points : tuple of ParetoPoint
        By count.
    """

    points: tuple[ParetoPoint, ...]

    _plain = "points{samples sigma upper_bound deviations times obstacle coordinates}"

    @property
    def coordinates(self) -> str:
        """Which coordinates sigma refers to; "" where nothing is designed."""
        return next((point.coordinates for point in self.points if point.coordinates), "")

    @property
    def efficient(self) -> tuple[ParetoPoint, ...]:
        """The points that no smaller count reaches or exceeds."""
        kept: list[ParetoPoint] = []
        for point in self.points:
            if point.times and point.sigma > max((p.sigma for p in kept), default=0.0):
                kept.append(point)
        return tuple(kept)

    _answers = (
        "the sigma of designs with {points.__len__} counts of samples",
        "proven: sigma of each, and what none exceeds",
        "{efficient.__len__} of them exceed all smaller ones",
        "`window_sigma` of the times of a point",
    )
    _frame = "points{samples sigma upper_bound times obstacle}"

    def _entries(self) -> tuple[ParetoPoint, ...]:
        return self.points

    def _rows(self) -> list[tuple[str, str]]:
        rows = [
            (
                counted(p.samples, "sample"),
                p.obstacle or f"sigma {below(p.sigma)}, none exceeds {above(p.upper_bound)}{_left(p)}",
            )
            for p in self.points
        ]
        where = f"{self.coordinates} coordinates, state at the window's start"
        return [*rows, ("sigma refers to", where)] if self.coordinates else rows

    def explain(self) -> str:
        """Say what more samples buy."""
        good = self.efficient
        if not good:
            needless = any(point.obstacle == NO_NEED for point in self.points)
            return "No samples needed." if needless else "None of the counts can be met."
        left = "" if good[-1].deviations is None else good[-1].deviations.explain()
        if len(good) == 1:
            return f"{counted(good[0].samples, 'sample')} per period: sigma {below(good[0].sigma)}.{left and ' '}{left}"
        return (
            f"From {good[0].samples} to {good[-1].samples} samples per period sigma grows from "
            f"{below(good[0].sigma)} to {below(good[-1].sigma)}."
            + (left and f" With {good[-1].samples} samples: {left[0].lower()}{left[1:]}")
        )


def _left(point: ParetoPoint) -> str:
    """What late or lost samples leave of it."""
    left = point.deviations
    if left is None:
        return ""
    late = "" if left.in_sigma else f"; {left.tolerance.describe(left.time_unit)}: {below(left.late)}"
    return f"{late}; one lost: {below(left.lost)}"


@checked
def pareto_front(
    plant: Plant,
    requirement: Requirement,
    counts: Iterable[int],
    *,
    rng: checks.Seed = None,
    workers: Workers = None,
    resume: str | os.PathLike[str] | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    **options: object,
) -> ParetoFront:
    """Design a schedule for every count of samples per period: what more samples buy.

        k -> (sigma_k, bound_k),    sigma_k <= sup of sigma over schedules with k samples <= bound_k

    Parameters
    ----------
    plant : Plant
    requirement : Requirement
        Its `samples` and `target_sigma` are replaced by each count.
    counts : iterable of int
    rng : numpy.random.Generator or its seed, optional
        As for `design_schedule`: each count is designed as it is there, by a copy of this one.
    workers : Executor, Client, int or str, optional
        Any `concurrent.futures.Executor`, a Dask client, a number of processes, or the name of a joblib backend.
        Default: one after the other.
    resume : path, optional
        A JSON file that is written after every count; what it holds already is not designed again.
    budget : float, optional [seconds]
        For all counts together, each of which gets its share of what is left; counts that time was not left for say
        so, and are not written to `resume`.
    progress : callable, optional
        Called with the fraction done and a message.
    **options
        As for `design_schedule` (starts, branches, rtol, of).

    Returns
    -------
    ParetoFront

    Raises
    ------
    ArgumentError
        If there is no count, or `workers` is none of the above.
    FileFormatError
        If `resume` belongs to another plant, requirement, option or version, or was changed.

    Notes
    -----
    *Claim.* That of `design_schedule`, for each count; one that no schedule keeps has its `obstacle`.

    Examples
    --------
    >>> wanted = Requirement(window=4.0, spacing=0.5)
    >>> front = pareto_front(Plant([[0.0]], [[1.0]]), wanted, [1, 4], starts=1, branches=0)
    >>> [(each.samples, round(each.sigma, 6)) for each in front]
    [(1, 1.0), (4, 2.0)]
    """
    listed = list(islice(counts, MOST_COUNTS + 1))
    wanted = sorted({checks.whole("counts", c, 1) for c in listed})
    if len(listed) > MOST_COUNTS:
        raise ArgumentError(f"`counts` must be at most {MOST_COUNTS} numbers of samples, got more: each is a design.")
    if not wanted:
        raise ArgumentError("`counts` must hold at least one number of samples.")
    seconds = None if budget is None else checks.nonnegative("budget", budget)
    if rng is not None:
        options = {**options, "rng": rng}
    key = _key(plant, requirement, options if budget is None else {**options, "budget": budget})
    known = {} if resume is None else _load(resume, key)
    todo = [c for c in wanted if c not in known]
    check_workers(workers)
    given = Budget(seconds)
    rounds = [_rest(place, len(todo), workers) for place in range(len(todo))]
    jobs = [(plant, requirement, c, options, given, left) for c, left in zip(todo, rounds, strict=True)]
    for done, (_, point) in enumerate(numbered(_point, jobs, workers)):
        known[point.samples] = point
        if resume is not None:
            done_by_now = ParetoFront(tuple(known[c] for c in sorted(known) if known[c].obstacle != NO_TIME))
            written = {"format": FORMAT, "key": key, **done_by_now.to_dict()}
            write_text(resume, to_json({**written, "digest": digest(written)}))
        if progress:
            progress((done + 1) / len(jobs), f"{counted(point.samples, 'sample')}: sigma {below(point.sigma)}")
    return ParetoFront(tuple(known[c] for c in wanted))


def _rest(place: int, jobs: int, workers: Workers) -> float:
    """How many rounds of jobs are left from this one on."""
    if workers is None:
        return float(jobs - place)
    known = workers if isinstance(workers, int) and workers > 0 else getattr(workers, "_max_workers", None)
    n_workers = int(known) if isinstance(known, int) else os.cpu_count() or 1
    return max(1.0, (jobs - place) / n_workers)


def _point(job: tuple[Plant, Requirement, int, Tree, Budget, float]) -> ParetoPoint:
    """One count, in its share of the time that is left; an impossible one is a point that says why."""
    plant, requirement, count, options, budget, rounds = job
    if np.isfinite(budget.seconds) and budget.left < _LEAST_SHARE * budget.seconds / rounds:
        return ParetoPoint(count, 0.0, np.inf, (), NO_TIME)
    if np.isfinite(budget.seconds):
        options = {**options, "budget": budget.left / rounds}
    options = {key: copy.deepcopy(value) for key, value in options.items()}  # threads share what they were given
    required = requirement.replace(samples=count, target_sigma=None)
    try:
        design = design_schedule(plant, required, **options)
    except InfeasibleRequirementError as error:
        return ParetoPoint(count, 0.0, 0.0, (), str(error))
    if design.status == "interrupted":  # ends the front: what is finished is in `resume`
        raise KeyboardInterrupt
    if design.schedule is None:
        return ParetoPoint(count, design.sigma, design.upper_bound, (), NO_NEED)
    obstacle_found = "" if design.sigma > 0 else design.explain()
    times = tuple(design.schedule.times.tolist())
    return ParetoPoint(
        count, design.sigma, design.upper_bound, times, obstacle_found, design.deviations, design.coordinates
    )


def _key(plant: Plant, requirement: Requirement, options: Tree) -> str:
    """Digest of everything that a point depends on but its count."""
    required = requirement.replace(samples=None, target_sigma=None).to_dict()
    return digest_of(plant, required, options)


def _load(path: str | os.PathLike[str], key: str) -> dict[int, ParetoPoint]:
    where = os.fspath(path)
    if not Path(where).exists():
        return {}
    data = from_json(read_text(where), where)
    if data.get("format") != FORMAT:
        raise FileFormatError(f"{where}: `format` must be {FORMAT!r}, got {data.get('format')!r}.", where)
    if data.get("key") != key:
        raise FileFormatError(
            f"{where}: belongs to another plant, requirement, option or version. Name another file to resume from.",
            where,
        )
    with usable(where):
        points = [_read(entry) for entry in _POINTS(data.get("points"), "points")]
    if data.get("digest") != digest(data):  # what a point proves is not proven again
        raise FileFormatError(f"{where}: was changed since it was written. Name another file to resume from.", where)
    return {point.samples: point for point in points}


def _read(entry: Tree) -> ParetoPoint:
    left = entry.get("deviations")
    if left is not None:
        left = SigmaDeviations(**{**left, "tolerance": TimingTolerance.of(left["tolerance"])})
    infinite = {key: np.inf for key in ("sigma", "upper_bound") if entry[key] is None}
    return ParetoPoint(**{**entry, **infinite, "times": tuple(entry["times"]), "deviations": left})
