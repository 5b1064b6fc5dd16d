"""The choice of eta and of the shape of P2 for the least horizon with a limited noise gain."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from sampling_design.certificates.exact.canonical import ScaledProblem, origin_question
from sampling_design.certificates.exact.noise_gain_scale import COARSE, EXACT, RateWindows, rounded
from sampling_design.certificates.exact.weight_variables import WeightVariables
from sampling_design.certificates.exact.window_gains import (
    WindowConditions,
    WindowSet,
    WindowTimes,
)
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.existence.periodic import certificate_exists, require_certificate
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import SolverError, UndecidedError
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget, BudgetSpentError, Progress
from sampling_design.records.declarations import below
from sampling_design.schedules.family import AnySchedule

ETA_RANGE = (0.05, 3.0)  # rates that are searched, in units of 1/(mean gap) (formats.md, Defaults)
LASTING = 10.0
"""What lasting noise leaves of the squared error, C_w and C_v over eta, is at most so many times (and that by the noise
gain) its least at any rate that is searched: beyond it a few percent of horizon cost powers of ten of it."""
BELOW_UNOBSERVABLE = 0.9  # fraction of the rate 2 |Re lambda| of an unobservable stable mode up to which eta is sought
SCAN = 7
SLOWER = 3.0, 10.0, 30.0, 100.0, 1000.0
"""Rates so many times below the slowest that is searched are tried, one after the other, where none can be followed."""
REFERENCE = 3.0  # the budget at which rates are compared and the first descents run, whatever budget is asked for
BELOW = (2.0, 1.5, 1.2), (1.5,)
ABOVE = (10.0, 100.0, 1000.0, 1e4, 1e5, 1e6)
"""Budgets at which a further descent runs: those below the reference always, those above where the budget allows them.

So a larger budget has all the shapes of a smaller one and perhaps more, and each shape is scaled to the budget, which
shortens its horizon as the budget grows: the horizon cannot grow with the budget.
"""
ROUNDNESS = (0.01, 1.0, 30.0)  # shares of the least P1 in the shapes of the first guess
FAR = 1e6
"""Where the budget knows some states so much better than others, in units that nobody stated, every mixture with it is
nearly singular, and what the disturbance alone leaves has a shape too."""
LEAST_SHARE = 1e-6
"""P1 keeps at least this part of the long-run information in every direction (over the budget): below it the prior is
lost in rounding, and the horizon gains nothing."""
LEAST_ROUND = 1e-10
"""Share of each state's variance that is added to a covariance before it is inverted: what is known better than that
of a combination of states drowns in rounding."""
ROUNDER = 1e-7, 1e-4, 0.1  # shares for shapes of less and less condition, where none of a larger one can be proven
SMALL = 4  # states up to which a search may take its full time; beyond them the second number of each pair below counts
STARTS = 3, 1  # rates of the scan from which the descent starts
MAX_ITERATIONS = 40, 20
JOINT = 40, 20
FIRST = 10
"""Likewise of a first descent, which follows few times, and at whose end others often count."""
RESTARTS = 4, 2
WORTHWHILE = 1e-3
"""Descents that follow each other at most, and the relative gain below which none follows."""
ROUNDS = 6  # further descents at most, since times of windows count at the end of one that it did not follow
MISSED = 1e-4  # ln lam (over 1 + ln lam) by which these exceed those that it followed: less brings nothing
NEAR, WIDER = 0.1, 0.25
"""How far below the largest ln lambda, and by which share of it more, the times of windows lie that a descent follows:
with fewer it ends where others are larger and begins anew, more of them only cost time."""
PRECISION = 1e-6  # change of ln lam (of the horizon, relative) at which the descent stops
SEARCH_WORK, RATE_WORK, ROUND_WORK = 5e6, 3e6, 4e6
"""Work, about microseconds, after which the search of weights (of a rate alone, of round shapes) ends with the best
that it has: any shape within the budget is proven afterwards, or not. Counted and not timed, so that it ends there on
every machine."""
MODERATE = float(np.log(1e6))
"""ln of the lambda up to which a proof in doubles is easy: rounding counts about as much less than it as it grows."""
COMPARED = 1.15  # shapes whose horizon is within this factor of the best one's are compared by their exact lambda


@dataclass(frozen=True, eq=False)
class ChosenWeights:
    """Weights found: P2 in the coordinates of the search, eta, ln(lam)/eta by its windows, and how the search ended.

    A `spare` one is a first guess at another rate, for where nothing at the best rate can be proven.
    """

    P2: Array
    eta: float
    value: float
    iterations: int = 0
    status: str = "first guess"
    spare: bool = False


class WeightSearch:
    """Minimise ln(lam)/eta over the shape of P2 and eta, in internal units."""

    def __init__(self, canon: ScaledProblem, roundness: float = LEAST_ROUND, work: WorkLimit | None = None) -> None:
        self.canon, self.roundness = canon, roundness
        self.known: dict[float, RateWindows] = {}
        large = canon.plant.n_states > SMALL
        self.starts, self.iterations, self.restarts = STARTS[large], MAX_ITERATIONS[large], RESTARTS[large]
        self.joint, self.below = JOINT[large], BELOW[large]
        self.work = WorkLimit(SEARCH_WORK) if work is None else work
        self.interrupted = False

    @property
    def late(self) -> bool:
        """Whether the seconds that were given are over, whatever work is left: then one shape will do."""
        return self.work.stop is not None and self.work.stop()

    @contextmanager
    def ended_by_interrupt(self, met: list[ChosenWeights]) -> Iterator[None]:
        """After an interrupt the search ends with what it has met; it is on its way where that is nothing."""
        try:
            yield
        except KeyboardInterrupt:
            if not met:
                raise
            self.interrupted, self.work.left = True, 0.0

    def setting(self, eta: float) -> RateWindows:
        """The windows of one rate and the demand on P1."""
        if eta not in self.known:
            if len(self.known) > SCAN + 1:
                self.known.pop(next(iter(self.known)))
            self.known[eta] = self._setting(eta)
        return self.known[eta]

    def windows(self, eta: float) -> WindowConditions:
        """The windows of one rate."""
        canon, one = self.canon, np.eye(self.canon.plant.n_states)
        return WindowSet.of(window_problem(canon.plant, canon.schedule, one, *canon.weights, eta), self.work)

    def _setting(self, eta: float) -> RateWindows:
        canon = self.canon
        windows = self.windows(eta)
        prior = np.diag(canon.sizes**2)
        size = 1.0 / canon.plant.states.scales
        along = rounded(np.mean(windows.long_run(prior), axis=0), self.roundness, prior)
        covariance = np.linalg.inv(along)
        B = np.diag(size**2) / windows.least_floor(size) + LEAST_SHARE * covariance
        mean = along if windows.steady is None else rounded(np.mean(windows.steady, axis=0), self.roundness, prior)
        return RateWindows(windows, np.asarray(np.linalg.cholesky(symmetrise(B))), mean)

    def calmest(self, bounds: tuple[float, float], rates: list[float]) -> float:
        """The largest rate up to which lasting noise is held (`LASTING`), of `rates` that rise within bounds.

        Between two of them ln(floor/eta) is taken to be convex in ln(eta), so that its chord is above it.
        """
        size = 1.0 / self.canon.plant.states.scales
        with np.errstate(divide="ignore"):
            lasting = np.log([self.setting(rate).windows.least_floor(size) / rate for rate in rates])
        limit = float(lasting.min()) + np.log(LASTING)
        within = int(np.flatnonzero(lasting <= limit)[-1])
        if within + 1 == len(rates) or not np.isfinite(lasting[within : within + 2]).all():
            return bounds[1] if within + 1 == len(rates) else rates[within]
        share = (limit - lasting[within]) / (lasting[within + 1] - lasting[within])
        return float(rates[within] * (rates[within + 1] / rates[within]) ** share)

    def guesses(self, eta: float) -> list[Array]:
        """Shapes between the inverse of the long-run covariance and the least P1, which any budget allows."""
        setting = self.setting(eta)
        B, mean = setting.b @ setting.b.T, setting.mean
        size = float(np.trace(B @ mean)) / len(mean)
        free = np.linalg.inv(B)
        mixed = [symmetrise(np.linalg.inv(mean + r * size * free)) for r in ROUNDNESS]
        far = float(np.linalg.eigvalsh(setting.b.T @ mean @ setting.b)[0]) < size / FAR
        return [*(setting.driven(self.roundness) if far else ()), *mixed, B]

    def best_guess(self, eta: float, budget: float) -> ChosenWeights | None:
        """The best of the guesses at a rate, None where the windows of that rate cannot be followed."""
        choices: list[ChosenWeights] = []
        try:
            for shape in self.guesses(eta):
                if choices and self.late:
                    break
                least = min((choice.value for choice in choices), default=np.inf)
                choice = self.judged(shape, eta, budget, width=COARSE, below=least)
                choices += [] if choice is None else [choice]
        except (SolverError, np.linalg.LinAlgError):
            return None
        return min(choices, key=attrgetter("value"), default=None)

    def judged(
        self,
        shape: Array,
        eta: float,
        budget: float,
        like: ChosenWeights | None = None,
        width: float = EXACT,
        below: float = np.inf,
    ) -> ChosenWeights | None:
        """A shape at the budget, or None where the budget does not allow it at any scale or it is lost in rounding.

        None, too, where it is not `below` a value.
        """
        try:
            scaled = self.setting(eta).scaled(shape, budget, width, lambda: self.late, below * eta)
        except (np.linalg.LinAlgError, SolverError, ValueError):
            return None
        if scaled is None or not np.isfinite(scaled[1]):
            return None
        steps, status = (0, "first guess") if like is None else (like.iterations, like.status)
        return ChosenWeights(scaled[0], eta, scaled[1] / eta, steps, status)

    def descend(self, start: ChosenWeights, budget: float, bounds: tuple[float, float]) -> ChosenWeights:
        """Descend anew from where a descent ended until that brings nothing: at a kink of lambda one may stop early."""
        best, times, restarts = start, None, self.restarts if bounds[0] == bounds[1] else 1
        for k in range(restarts + ROUNDS):
            descended, times, complete, settled = self._descent(
                best, budget, bounds, times, first=k == 0 and bounds[0] == bounds[1]
            )
            gained = descended is not None and descended.value < best.value * (1 - WORTHWHILE)
            if descended is not None:
                steps = best.iterations + descended.iterations
                best = replace(min(descended, best, key=attrgetter("value")), iterations=steps)
            restarts -= complete and k > 0
            if self.work.over or restarts < 0 or settled or (complete and not gained):
                break
        return best

    def _descent(
        self, start: ChosenWeights, budget: float, bounds: tuple[float, float], known: WindowTimes | None, first: bool
    ) -> tuple[ChosenWeights | None, WindowTimes | None, bool, bool]:
        """Sequential quadratic programming on ln lam, T (P2 = L T T' L') and ln eta; None where nothing is met.

        Only those times of windows enter at which ln lam is near its largest, or that are `known`. Also returned: these
        with what counts at the end, whether they were all that does, and whether the descent is at its end, too.
        """
        L = np.asarray(np.linalg.cholesky(start.P2), dtype=np.float64)
        solve: Any = minimize
        most = self.iterations if bounds[0] == bounds[1] else self.joint
        steps, ended = 0, False
        state: WeightVariables | None = None
        try:
            look = self._followed(start.eta).looked(start.P2)
            known = followed = look.times(NEAR + WIDER * look.value).also(known)
            state = WeightVariables(
                self.setting,
                lambda rate: self._followed(rate).maps(L, followed),
                (L, start.eta),
                bounds,
                budget,
                self.work,
            )
            z = state.start()
            free = [(None, None)] * (z.size - 1)
            optimum = solve(
                state.objective, z, jac=True, method="SLSQP",
                bounds=[(0.0, None), *free[1:], (np.log(bounds[0]), np.log(bounds[1]))],
                constraints={"type": "ineq", "fun": lambda z: state.at(z)[0], "jac": state.jacobian},
                options={"maxiter": FIRST if first else most, "ftol": PRECISION},
            )  # fmt: skip
            steps, status, ended = int(optimum.nit), str(optimum.message), bool(optimum.success)
        except BudgetSpentError:
            status = "the search has used its work, and ended with the best that it had"
        except (np.linalg.LinAlgError, SolverError, ValueError) as error:
            status = f"the descent ended where windows are lost in rounding ({error})"
        if state is None:
            return None, known, True, True
        best: ChosenWeights | None = None
        times, complete, settled = known, True, True
        for value, need, z in (state.near, state.kept):
            if not z.size or (best is not None and best.value <= value):
                continue
            T, rate = state.unpack(z)
            P = L @ T @ T.T @ L.T
            try:
                look = self._followed(rate).looked(P)
            except (np.linalg.LinAlgError, SolverError, ValueError):
                continue
            complete &= look.value <= need + MISSED * (1 + need)
            made = self.judged(P, rate, budget, replace(start, iterations=steps, status=status))
            settled = ended and complete and made is not None and made.value <= value * (1 + MISSED)
            times = look.times(NEAR + WIDER * look.value).also(times)
            best = made if made is not None and (best is None or made.value < best.value) else best
        return best, times, complete, settled

    def _followed(self, eta: float) -> WindowSet:
        windows = self.setting(eta).windows
        assert isinstance(windows, WindowSet)  # descents run in doubles
        return windows


def rate_range(plant: Plant, schedule: AnySchedule) -> tuple[float, float]:
    """Return the rates that are searched: [0.05, 3]/(mean gap), below what an unobservable stable mode allows.

    Raises CertificateError if no rate has a certificate: the period misses a mode that does not decay.
    """
    mean = float(np.mean(schedule.gaps)) if schedule.gaps.size else float(schedule.times[0])
    low, high = (factor / max(mean, 1e-300) for factor in ETA_RANGE)
    for _ in range(plant.n_states + 1):
        existence = certificate_exists(plant, schedule, high)
        if existence.exists:
            return min(low, high / 8), high
        assert existence.eigenvalue is not None
        if existence.eigenvalue.real >= 0:
            break
        high = -2 * BELOW_UNOBSERVABLE * existence.eigenvalue.real
    require_certificate(plant, schedule, high)
    return min(low, high / 8), high


def choose_weights(
    canon: ScaledProblem,
    bounds: tuple[float, float],
    budgets: list[float],
    progress: Progress | None = None,
    budget: Budget = ENDLESS,
) -> list[list[ChosenWeights]]:
    """Return for each budget P2, and eta within its bounds, for the least horizon ln(lam)/eta; the best first.

    Raises UndecidedError if the windows of every rate are lost in rounding.

    Notes
    -----
    *Method.* A scan over eta with P2 between the long-run information and the least that the budget asks for, then
    sequential quadratic programming on the exact lambda of a set of windows, with gradients, at reference budgets;
    every shape met is scaled to the budget asked for. A local optimum, never evidence. After `SEARCH_WORK` no further
    descent begins and the one that runs ends; so they do once `budget` is spent, or after an interrupt.
    """
    search = WeightSearch(canon, work=WorkLimit(SEARCH_WORK, stop=lambda: budget.over))
    report = progress or (lambda fraction, message: None)
    free = bounds[0] < bounds[1]
    rates = [float(rate) for rate in np.geomspace(*bounds, SCAN)] if free else [bounds[0]]
    guesses: list[ChosenWeights] = []
    for k, rate in enumerate(rates):
        if search.work.over:
            break
        with search.ended_by_interrupt(guesses):
            report(0.3 * k / len(rates), f"rate {rate:.3g}")
            guess = search.best_guess(rate, REFERENCE)
            guesses += [] if guess is None else [guess]
    if free and not guesses:  # the slower the rate, the fewer modes grow when their squares are discounted
        for rate in (bounds[0] / slower for slower in SLOWER):
            if search.work.over:
                break
            guess = search.best_guess(rate, REFERENCE)
            if guess is not None:
                guesses.append(guess)
                bounds, free = (rate, rate), False
                break
    if not guesses:
        raise UndecidedError(
            "undecided: at no rate that was tried could the information on this schedule be followed in doubles; the "
            f"schedule is on the edge of what can be certified.{origin_question(canon)}"
        )
    if free:
        bounds = bounds[0], search.calmest(bounds, [guess.eta for guess in guesses])
        guesses = [guess for guess in guesses if guess.eta <= bounds[1]]
    guesses.sort(key=attrgetter("value"))
    descended: list[ChosenWeights] = []
    for k, guess in enumerate(guesses[: search.starts]):
        if descended and search.work.over:
            break
        with search.ended_by_interrupt(guesses):
            report(0.3 + 0.13 * k, f"descent at rate {below(guess.eta, 3)}")
            descended.append(search.descend(guess, REFERENCE, (guess.eta, guess.eta)))
    best = min(descended or guesses, key=attrgetter("value"))
    if free and not search.work.over:
        with search.ended_by_interrupt(guesses):
            report(0.7, "descent on shape and rate")
            best = min(best, search.descend(best, REFERENCE, bounds), key=attrgetter("value"))
    with search.ended_by_interrupt(guesses):
        report(0.8, "descents at other budgets")
    shapes = [(0.0, best), (0.0, guesses[0])]
    _descend_at_others(search, shapes, guesses, bounds, max(budgets))
    if search.interrupted:
        shapes = [(least, replace(choice, status="interrupted")) for least, choice in shapes]
    shapes += [(0.0, ChosenWeights(shape, best.eta, np.inf)) for shape in search.guesses(best.eta)]
    report(0.9, "proof")
    others = [guess for guess in guesses if guess.eta != best.eta]
    return [_ordered(search, shapes, budget) + _guesses_at_other_rates(search, others, budget) for budget in budgets]


def _descend_at_others(
    search: WeightSearch,
    shapes: list[tuple[float, ChosenWeights]],
    guesses: list[ChosenWeights],
    bounds: tuple[float, float],
    most: float,
) -> None:
    """Add to `shapes`, whose first is the best at the reference budget, those that descents at others end at."""
    last = shapes[0][1]
    for reference in (*search.below, *(above for above in ABOVE if above <= most)):
        if search.work.over:
            break
        above = reference > REFERENCE
        with search.ended_by_interrupt(guesses):
            start = search.judged(last.P2, last.eta, reference) or search.best_guess(last.eta, reference)
            if start is not None:
                made = search.descend(start, reference, bounds if above else (start.eta, start.eta))
                shapes.append((reference if above else 0.0, made))
                last = made if above else last


def _guesses_at_other_rates(search: WeightSearch, guesses: list[ChosenWeights], budget: float) -> list[ChosenWeights]:
    """The guesses at other rates, scaled to the budget: those of moderate lambda first, then by their horizons."""
    choices = [None if search.late else search.judged(guess.P2, guess.eta, budget, guess, COARSE) for guess in guesses]
    spare = [replace(choice, spare=True) for choice in choices if choice is not None]
    return sorted(spare, key=lambda choice: (choice.value * choice.eta > MODERATE, choice.value))


def round_choices(
    canon: ScaledProblem, rates: list[float], budget: float, whole: WorkLimit
) -> Iterator[list[ChosenWeights]]:
    """First guesses of less and less condition at these rates: for where nothing better can be proven."""
    work = whole.share(ROUND_WORK)
    for share in ROUNDER:
        search = WeightSearch(canon, share, work)
        choices: list[ChosenWeights] = []
        for rate in rates:
            guess = None if search.work.over else search.best_guess(rate, budget)
            choices += [] if guess is None else [replace(guess, spare=True)]
        yield choices


def _ordered(search: WeightSearch, shapes: list[tuple[float, ChosenWeights]], budget: float) -> list[ChosenWeights]:
    """The shapes of references up to the budget, each scaled to it, the best first, and none twice."""
    scaled: list[ChosenWeights] = []
    for choice in (choice for least, choice in shapes if least <= budget):
        if scaled and search.late:
            break
        allowed = search.late and not choice.iterations and budget >= REFERENCE and np.isfinite(choice.value)
        made = choice if allowed else search.judged(choice.P2, choice.eta, budget, choice)
        scaled += [] if made is None else [made]
    distinct: list[ChosenWeights] = []
    for choice in sorted(scaled, key=attrgetter("value")):
        distinct += [] if any(_same_choice(choice, other) for other in distinct) else [choice]
    return distinct


def _same_choice(one: ChosenWeights, other: ChosenWeights) -> bool:
    """Whether two choices are one as far as a descent tells: one that gains nothing ends where it began."""
    size = np.sqrt(np.diagonal(other.P2))
    near = np.abs(one.P2 - other.P2) <= PRECISION * size * size[:, None]
    return abs(one.eta - other.eta) <= PRECISION * other.eta and bool(np.all(near))


def choose_rate(
    canon: ScaledProblem,
    P2: Array,
    bounds: tuple[float, float],
    progress: Progress | None = None,
    budget: Budget = ENDLESS,
) -> float:
    """Return the eta with the least ln(lam)/eta for a given P2: a scan, then golden section around its best.

    After `RATE_WORK`, or once `budget` is spent, it is the best that was met.
    """
    report = progress or (lambda fraction, message: None)
    n, work, met = canon.plant.n_states, WorkLimit(RATE_WORK, stop=lambda: budget.over), dict[float, float]()

    def horizon(log_rate: float) -> float:
        rate = float(np.exp(log_rate))
        report(0.5, f"rate {rate:.3g}")
        if work.over:
            raise BudgetSpentError
        try:
            problem = window_problem(canon.plant, canon.schedule, np.eye(n), *canon.weights, rate)
            met[rate] = WindowSet.of(problem, work).looked(P2).value / rate
        except (SolverError, np.linalg.LinAlgError):
            met[rate] = np.inf
        return met[rate]

    grid = np.log(np.geomspace(*bounds, SCAN))
    try:
        k = int(np.argmin([horizon(rate) for rate in grid]))
        ends = grid[max(k - 1, 0)], grid[min(k + 1, SCAN - 1)]
        return float(np.exp(minimize_scalar(horizon, bounds=ends, options={"xatol": 1e-3}).x))
    except BudgetSpentError:
        return min(met, key=lambda rate: met[rate])
