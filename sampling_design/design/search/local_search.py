"""The search for one schedule of k samples: starts, exchange, refinement. All of it seeded, none of it a claim."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sampling_design.design.bounds.relaxation import Relaxation, repeating
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import MANY_STATES
from sampling_design.design.problem.interrupt import DesignInterrupt
from sampling_design.design.problem.orthogonal_flow import OrthogonalFlowWindows
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.design.search.fedorov_exchange import (
    at_shares,
    even,
    exchanged,
    is_admissible,
    packed,
    refined,
    rounded,
    shares_of,
)
from sampling_design.design.search.heat_bath import annealed
from sampling_design.design.search.rotations import exchanged_hours, rotated
from sampling_design.design.search.smooth import smoothed
from sampling_design.errors import SolverError
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import ENDLESS, Budget

ValueProgress = Callable[[float, float], None]  # Called with the fraction done and sigma of the best schedule
DRAWS = 60  # random schedules that are looked at before the best few are refined
KICKS = 4  # times, per start, that a few samples of the best schedule are moved elsewhere and all refined anew
FEW = 4  # starts that are refined by semidefinite programs, where the quasi-Newton method led more of them on
LED = 3  # times as many starts as are asked for are led on by the quasi-Newton method

ROTATIONS, CHEAP_ROTATIONS = 4, 16
"""Rotations that are refined where what is allowed repeats; more where a quasi-Newton method leads them on."""

_STARTS_PER_BATH = 2  # where hours repeat
_MORE_STEPS = 5.0  # times as many rotations are looked at then
_KICKED = 3  # samples moved at once
_PATIENCE = 12  # kicks in a row without gain, of many states or samples fewer
_OTHER_OPTIMA = 0.02  # share of starts that may lead to an optimum not seen yet: from there on kicks find nothing
_MANY_SAMPLES = 32  # from there on
_CHEAPER = 10  # kicks that the quasi-Newton method refines for one of programs
_GOOD, _ALIKE = 8, 1e-4  # schedules that are kept to go on from, and by what share of sigma^2 two must differ
_EXCHANGED = 0.5  # of the kicks, where what is allowed repeats: two times of day are exchanged
_BEFORE_KICKS = 0.6  # of the search, as progress counts it
_NEAR = 0.997  # of the bound: from there on a kick, or a heat bath, costs more than it can gain
_BATHED_NEAR = 0.95  # of the bound: where a heat bath came so near, kicks from there find nothing
HOPELESS_START, HOPELESS_KICK = 0.7, 0.92  # of the best sigma^2 after a few steps: not led on any further
HOPELESS = 0.96  # of the best sigma^2 after a first refinement: not refined further
_GAIN = 1e-6  # relative, of sigma^2: less is no gain
_TIE = 1e-9  # likewise: less is rounding, and the schedule that was found first stays
FIRST_STEPS = 12  # of that first refinement
_LEAST_DRAWS = 9  # of those, when the budget is spent already: even spacing alone can be blind
_LED_TO_SEE, _ROUNDS = 6, 8
"""Where all starts are blind: how many others are led on, and how often at most; less of what is large."""
_EXCHANGES = 1200  # schedules that exchange looks at, about: each costs in proportion to its samples


@dataclass(frozen=True)
class SearchTrial:
    """One start and where it led: sigma at the start and after refinement."""

    start: str
    before: float
    after: float

    def in_units(self, size: float) -> SearchTrial:
        """The same with sigma in other units."""
        return SearchTrial(self.start, self.before * size, self.after * size)


@dataclass(frozen=True, eq=False)
class FoundSchedule:
    """The best schedule of the search, sigma as the search sees it, and all trials."""

    times: Array
    sigma: float
    trials: tuple[SearchTrial, ...]
    complete: bool


def search(
    problem: DesignProblem,
    relaxation: Relaxation,
    rng: np.random.Generator,
    starts: int,
    budget: Budget = ENDLESS,
    progress: ValueProgress | None = None,
    enough: float = np.inf,
) -> FoundSchedule:
    """Refine the best starts and return the best schedule.

    Stops at `budget`, and where sigma is `enough`: none can be better. An interrupt is a `DesignInterrupt`, with
    the best schedule found by then. Raises SolverError if no admissible start was found although the requirement leaves
    room for one.
    """
    pool, most = _starts(problem, relaxation, rng, budget), KICKS * starts
    if not pool:
        raise SolverError(
            f"No admissible start was found for {problem.samples} samples, although there is room for them. "
            "Widen the allowed times or ask for less spacing.",
            status="no start",
        )
    run = _Refinement(problem, budget, enough, pool[0][1], 0.0, [])
    try:
        _search_from(run, relaxation, rng, pool, starts, progress)
        _kick(run, rng, most, progress)
    except KeyboardInterrupt:
        raise DesignInterrupt(run.found(complete=False)) from None
    return run.found(complete=run.is_best or not budget.over)


def _search_from(
    run: _Refinement,
    relaxation: Relaxation,
    rng: np.random.Generator,
    pool: list[tuple[str, Array]],
    starts: int,
    progress: ValueProgress | None,
) -> None:
    """Refine the best starts, exchange samples of the best, and draw anew where all are blind."""
    problem, budget, enough = run.problem, run.budget, run.enough
    if problem.orthogonal_flow is not None:
        pool = _led(run, problem.orthogonal_flow, pool, starts)
        if progress:
            progress(0.0, run.reached)
        if repeating(problem) and run.highest < (_NEAR * enough) ** 2:
            begun = [times for _, times in run.good[: -(-starts // _STARTS_PER_BATH)]]

            def cooled(share: float) -> None:
                if progress:
                    progress(_BEFORE_KICKS * share, run.reached)

            led = annealed(problem, relaxation, begun, rng, budget, cooled)
            bathed = [("heat bath", times) for times in led]
            run.near = _BATHED_NEAR if led else _NEAR
            pool += _led(run, problem.orthogonal_flow, bathed, len(bathed)) if bathed else []
        starts = min(starts, FEW)
    values = worst_sigma2(problem, np.array([t for _, t in pool]))
    order = _ranked(values)[:starts]
    named = [i for i, (name, _) in enumerate(pool) if name not in ("random", "packed") and i not in order]
    chosen = [*order, *(named if problem.orthogonal_flow is None else [])]
    for done, i in enumerate(chosen):
        if run.trials and run.is_over:
            break
        run.refine(pool[i][0], pool[i][1], float(values[i]))
        if progress:
            progress(_BEFORE_KICKS * (done + 1) / len(chosen), run.reached)
    if len(run.trials) == len(chosen) and not run.is_over:
        t, value = exchanged(problem, run.best, run.value, count=_places(problem), rounds=1, budget=budget)
        if value > run.value:
            run.refine("exchange", t, value)
    if run.value <= 0 and not run.is_over:
        _restart(run, rng)


def _ranked(values: Array) -> Index:
    """The best first; those that tie with the best one in their own order, and not in that of their rounding."""
    highest = float(np.max(values, initial=0.0))
    return np.argsort(-np.where(values >= highest * (1 - _TIE), highest, values), kind="stable")


def _led(
    run: _Refinement, orthogonal_flow: OrthogonalFlowWindows, pool: list[tuple[str, Array]], starts: int
) -> list[tuple[str, Array]]:
    """The starts worth it, led on by the quasi-Newton method. Without time, as they are."""
    problem = run.problem
    values = worst_sigma2(problem, np.array([t for _, t in pool]))
    best = _ranked(values)[: LED * starts]
    found = []
    for i in [*best, *(i for i, (name, _) in enumerate(pool) if name not in ("random", "packed") and i not in best)]:
        if run.budget.over:
            break
        name, times = pool[i]
        near = smoothed(problem, orthogonal_flow, times, HOPELESS_START * run.highest, run.budget)
        if near is not None:
            run.keep(near)
            found.append((name, near))
    return found or pool


@dataclass
class _Refinement:
    """The best schedule so far, its sigma^2, and the trials that led there.

    `good` are the best that the quasi-Newton method led to, with their sigma^2; `abandoned` counts the starts that were
    not followed to their optimum; `near` is the share of the bound from which on it is not kicked.
    """

    problem: DesignProblem
    budget: Budget
    enough: float
    best: Array
    value: float
    trials: list[SearchTrial]
    good: list[tuple[float, Array]] = field(default_factory=list)
    abandoned: int = 0
    near: float = _NEAR

    @property
    def highest(self) -> float:
        """Sigma^2 of the best of those."""
        return self.good[0][0] if self.good else 0.0

    @property
    def sigma(self) -> float:
        """Sigma of the best schedule so far."""
        return float(np.sqrt(max(self.value, 0.0)))

    @property
    def reached(self) -> float:
        """Sigma of the best schedule that was seen, refined or not yet."""
        return float(np.sqrt(max(self.value if self.trials else 0.0, self.highest)))

    @property
    def other_optima(self) -> float:
        """Expected share of starts that lead to an optimum not seen yet: w (w + 1) / (N (N - 1)) after N with w.

        The estimate of Boender and Rinnooy Kan for multistart search (Mathematical Programming 37, 1987). Optima are
        told apart by their sigma^2; what was abandoned counts as one more each.
        """
        ends = np.sort([trial.after**2 for trial in self.trials])
        tried = ends.size + self.abandoned
        if tried < 2:
            return 1.0
        optima = 1 + int(np.sum(np.diff(ends) > _ALIKE * ends[1:])) + self.abandoned
        return optima * (optima + 1) / (tried * (tried - 1))

    @property
    def is_best(self) -> bool:
        """Whether none can be better."""
        return self.value >= self.enough**2

    @property
    def is_over(self) -> bool:
        """Whether there is nothing left to gain, or no time."""
        return self.is_best or self.budget.over

    def found(self, complete: bool) -> FoundSchedule:
        """The best schedule so far."""
        return FoundSchedule(self.best, self.sigma, tuple(self.trials), complete)

    def refine(self, name: str, times: Array, value: float, before: float | None = None) -> bool:
        """Refine one schedule and keep it if it is the best; `before` is sigma^2 before an earlier refinement."""
        times, after = refined(self.problem, times, value, budget=self.budget)
        first = value if before is None else before
        self.trials.append(SearchTrial(name, float(np.sqrt(max(first, 0.0))), float(np.sqrt(max(after, 0.0)))))
        better = after > self.value * (1 + _GAIN) or len(self.trials) == 1
        if after > self.value * (1 + _TIE) or len(self.trials) == 1:
            self.best, self.value = times, after
        return better

    def keep(self, times: Array) -> float:
        """Keep a schedule among the few best to go on from, of those that are alike the best one; its sigma^2."""
        value = float(worst_sigma2(self.problem, times[None])[0])
        alike = [one for one in self.good if abs(one[0] - value) <= _ALIKE * value]
        if all(value > known for known, _ in alike):
            others = [one for one in self.good if abs(one[0] - value) > _ALIKE * value]
            self.good = sorted([*others, (value, times)], key=lambda one: -one[0])[:_GOOD]
        return value


def _kick(run: _Refinement, rng: np.random.Generator, most: int, progress: ValueProgress | None = None) -> None:
    """Move a few samples of the best schedule, near or far, and refine.

    Until nothing was gained for a while, or all that was refined ends alike so often that no other optimum is expected.
    """
    problem, idle = run.problem, 0
    free = problem.samples - problem.fixed.size
    patience = _PATIENCE * _share(problem) * min(1.0, _MANY_SAMPLES / problem.samples)
    if problem.orthogonal_flow is not None:
        most, patience = most * _CHEAPER, patience * _CHEAPER
    if free == 0:
        return
    for done in range(most):
        if run.is_over or idle >= patience or run.value >= (run.near * run.enough) ** 2:
            return
        if problem.orthogonal_flow is None and run.other_optima <= _OTHER_OPTIMA:
            return
        if progress:
            progress(_BEFORE_KICKS + (1 - _BEFORE_KICKS) * done / most, run.reached)
        idle += 1
        parent = run.good[rng.integers(len(run.good))][1] if run.good else run.best
        times = _kicked(problem, parent, rng)
        if times is None or not is_admissible(problem, times):
            continue
        before = float(worst_sigma2(problem, times[None, :])[0])
        made = _first_steps(run, times, before)
        if made is None:
            run.abandoned += 1
        elif run.refine("kick", *made, before):
            idle = 0


def _first_steps(run: _Refinement, times: Array, before: float) -> tuple[Array, float] | None:
    """The schedule after a first refinement and its sigma^2; None where it is not worth a second one."""
    problem = run.problem
    if problem.orthogonal_flow is None:
        times, value = refined(problem, times, before, steps=FIRST_STEPS, budget=run.budget)
        return (times, value) if value > HOPELESS * run.value else None
    highest = run.highest
    near = smoothed(problem, problem.orthogonal_flow, times, HOPELESS_KICK * highest, run.budget)
    if near is None:
        return None
    value = run.keep(near)
    return (near, value) if value > highest * (1 + _GAIN) else None  # another one leads to no better one, mostly


def _kicked(problem: DesignProblem, times: Array, rng: np.random.Generator) -> Array | None:
    """A few free samples moved at once, near or far; or where hours repeat, two samples' times of day exchanged."""
    free_times = times[~np.isin(times, problem.fixed)]
    parts = round(problem.period / problem.least_shift) if repeating(problem) else 1
    if parts > 1 and free_times.size > 1 and rng.uniform() < _EXCHANGED:
        return exchanged_hours(problem, times, *rng.choice(free_times.size, 2, replace=False))
    shares = shares_of(problem, free_times)
    moved = rng.choice(free_times.size, min(_KICKED, free_times.size), replace=False)
    near = shares[moved] + rng.normal(size=moved.size) / free_times.size
    if parts > 1:  # another hour of the same day
        near = (np.floor(shares[moved] * parts) + rng.uniform(size=moved.size)) / parts
    shares[moved] = (near if rng.uniform() < 0.5 else rng.uniform(size=moved.size)) % 1.0
    return at_shares(problem, shares)


def _restart(run: _Refinement, rng: np.random.Generator) -> None:
    """Where every start is blind and stays so: of more random schedules the best ones, led until every state is seen.

    One sample after the other goes where the fewest windows miss a state.
    """
    problem = run.problem
    size, effort = problem.samples - problem.fixed.size, _share(problem) * min(1.0, _MANY_SAMPLES / problem.samples)
    drawn = [at_shares(problem, rng.uniform(size=size)) for _ in range(DRAWS if size else 0)]
    pool = np.array([t for t in drawn if t is not None and is_admissible(problem, t)]).reshape(-1, problem.samples)
    values = worst_sigma2(problem, pool, graded=True)
    led, rounds = (int(np.ceil(effort * most)) for most in (_LED_TO_SEE, _ROUNDS))
    for i in np.argsort(-values, kind="stable")[:led]:
        if run.is_over or run.value > 0:
            return
        t, value = exchanged(problem, pool[i], float(values[i]), _places(problem), rounds, run.budget, graded=True)
        if value > 0:
            run.refine("restart", t, value)


def _places(problem: DesignProblem) -> int:
    """Places that exchange tries for one sample: about the same number of schedules whatever the count."""
    return int(np.clip(_EXCHANGES * _share(problem) / problem.samples, 8, 96))


def _share(problem: DesignProblem) -> float:
    """Of kicks and exchanges that are tried: each takes the longer, the more states there are."""
    return min(1.0, (MANY_STATES / problem.plant.n_states) ** 2)


def _starts(
    problem: DesignProblem, relaxation: Relaxation, rng: np.random.Generator, budget: Budget
) -> list[tuple[str, Array]]:
    """Even, rounded and random admissible schedules; even ones also shaken, since symmetry can be a saddle."""
    found: list[tuple[str, Array | None]] = [("even", even(problem, 0.5))]
    found.append(("packed", packed(problem)))
    if repeating(problem):
        count = ROTATIONS if problem.orthogonal_flow is None else CHEAP_ROTATIONS
        steps = 1.0 if problem.orthogonal_flow is None else _MORE_STEPS
        turned = rotated(problem, relaxation, count, _share(problem), budget, steps)
        found += [("rotated", times) for times in turned]
    else:
        found += [("rounded", rounded(problem, relaxation, offset)) for offset in (0.25, 0.75)]
    size = problem.samples - problem.fixed.size
    for i in range(DRAWS):
        if i >= _LEAST_DRAWS and budget.over and any(t is not None for _, t in found):
            break
        if i % 3 == 0:
            shares = (np.arange(size) + rng.uniform() + 0.3 * rng.normal(size=size)) / max(size, 1) % 1.0
        else:
            shares = rng.uniform(size=size)
        found.append(("random", at_shares(problem, shares)))
    return [(name, t) for name, t in found if t is not None and is_admissible(problem, t)]
