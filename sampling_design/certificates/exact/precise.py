"""Weights for windows that doubles lose: long runs and lambdas in `BITS` binary digits (extra `rigorous`).

Nearly equal modes behind few outputs leave a covariance of condition 1e30, and the plant is certified all the same: by
a round P2, whose own windows are followed in more digits. These are midpoints of balls, and so proposals; what they
propose is proven in balls.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from sampling_design import __version__
from sampling_design.certificates.exact.canonical import ScaledProblem
from sampling_design.certificates.exact.certificate import Certificate, times_to_dict
from sampling_design.certificates.exact.efforts import BALL_PRICE, PRECISE_PROOF, PRECISE_WORK, ROOM, SPARE_WORK
from sampling_design.certificates.exact.given_weights import NoiseWeights
from sampling_design.certificates.exact.proof import as_proven
from sampling_design.certificates.exact.weight_choice import ROUNDNESS, ChosenWeights, WeightSearch
from sampling_design.certificates.exact.window_gains import LATER, Look
from sampling_design.certificates.form.claims import RESOLUTION, STATED_MARGIN
from sampling_design.certificates.rigorous.ball_problem import BallTimes, BallWeights, ScheduleFrame
from sampling_design.certificates.rigorous.ball_proof import long_run, one_period
from sampling_design.certificates.rigorous.decide import decided_on_schedule
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.checkers.parts import Plant as FilePlant
from sampling_design.checkers.parts import Weights
from sampling_design.checkers.schedule_file import times_of
from sampling_design.errors import SolverError, UndecidedError
from sampling_design.numerics.balls import Ball, Matrix, ball, cholesky, definite, floats, identity, matrix, precision
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.record import SolverRecord
from sampling_design.schedules.family import AnySchedule

BITS = 400  # binary digits: a hundred decimal ones beside those that conditions of 1e45 lose
SHARE = 1e-4
"""Share of every state's variance that is added before a covariance becomes a weight: P2 is then no harder than 1e5."""
REACHED = 1e-6
"""Change of every state's variance with twice as many periods, relative, at which the long run is reached."""
MERGED = 3e-2, 1e-3
"""A window is followed no further that is below the long run and these shares of the long run and of its own start."""
CELLS = 4  # parts of a gap, for starts and for times
STEPS = 200  # samples along one window
STEP_WORK = 60, 0.5  # work of one sample, in units of that of a proof in balls: so much, and so much more for each n^3


class PreciseWindows:
    """The windows of a plant in internal units at one rate, P2 left open: what a search asks of `WindowSet`."""

    def __init__(self, canon: ScaledProblem, eta: float, work: WorkLimit) -> None:
        plant, (Qw, R, Qv) = canon.plant, canon.weights
        self.n, self.work = plant.n_states, work
        stated = FilePlant(plant.A, plant.C, plant.G, plant.time_unit)
        one = np.eye(self.n)
        own = Weights(P1=one, P2=one, Qw=Qw, R=R, Qv=Qv, eta=eta, lam=1.0, lam_samples=1.0, margin=0.0)
        with precision(BITS):
            weights = BallWeights(stated, own)
            self.times = BallTimes(times_of(times_to_dict(canon.schedule), stated))
            self.frame = ScheduleFrame(weights, self.times, identity(self.n), "search")
            self.cycle = self._settled() if self.times.periodic else []
        self.steady = np.array([floats(Y) for Y in self.cycle]) if self.cycle else None

    def _settled(self) -> list[Matrix]:
        """Y after each sample of the period in the long run."""

        def converged(before: Matrix, after: Matrix) -> bool:
            size = np.sqrt(np.abs(np.diagonal(floats(after))))
            return bool(np.all(np.abs(floats(after - before)) <= REACHED * size * size[:, None]))

        try:
            none = ball(0.0) * self.frame.identity
            return one_period(self.frame, long_run(self.frame, none, converged, self._spend), none)[0]
        except ArithmeticError:
            raise SolverError(
                "the information did not settle: the schedule is on the edge of what can be certified."
            ) from None

    def _spend(self, samples: int) -> None:
        self.work.spend(samples * (STEP_WORK[0] + STEP_WORK[1] * self.n**3))

    def starts(self, cells: int) -> list[tuple[int, Ball, bool]]:
        """First sample, time to it, and whether it starts at a sample: all of those, and `cells` - 1 in each gap."""
        times = self.times
        ends = [(i, gap, True) for i, gap in enumerate(times.gaps)] + [(0, times.first, True)]
        inner = [(i, reach * k / cells, False) for i, reach in enumerate(times.reach) for k in range(1, cells)]
        return ends + inner

    def _window(self, X: Matrix, i: int, remaining: Ball, parts: int) -> Iterator[Matrix]:
        """Y at so many times of each gap of the window that starts with X, `remaining` before sample i."""
        frame, times, Y, duration = self.frame, self.times, X, remaining
        for _ in range(STEPS):
            self._spend(parts)
            for k in range(1, parts + 1):
                later = frame.flow.step(Y, duration * k / parts).mid()
                yield later
            Y = frame.with_gain(later, i, frame.gain(later, i)).mid()
            if times.periodic:
                above = self.cycle[i] * ball(1 + MERGED[0]) + X * ball(MERGED[1])
                if definite(above - Y):
                    return
            elif i + 1 == times.N:
                return
            i = times.after(i)
            duration = times.gaps[i]

    def _later(self, parts: int) -> Iterator[Matrix]:
        """The long run at so many times of each gap."""
        for i, Y in enumerate(self.cycle):
            gap = self.times.gaps[self.times.after(i)]
            for k in range(1, parts + 1):
                yield self.frame.flow.step(Y, gap * k / parts)

    def long_run(self, prior: Array) -> Array:
        """Y in the middle and at the end of gaps in the long run; finite: along the windows from P2^-1 = `prior`."""
        with precision(BITS):
            covariances = [floats(Y) for Y in self._later(2)]
            if self.steady is None or self.times.first > self.times.gaps[0] * (1 + LATER):
                X = matrix(prior if self.steady is None else 0 * prior)
                covariances += [floats(Y) for i, r, _ in self.starts(1) for Y in self._window(X, i, r, 2)]
        return np.array(covariances)

    def least_floor(self, size: Array) -> float:
        """The largest eigenvalue of size Y size in the long run; finite: of the windows without prior error."""
        Y = self.long_run(np.zeros((self.n, self.n)))
        return float(np.linalg.eigvalsh(Y * size * size[:, None])[:, -1].max())

    def looked(self, P: Array) -> Look:
        """ln lambda of P2 = P, looked at before samples."""
        return Look(float(np.log(max(self.peaks(P, 2, 1)))))

    def peaks(self, P: Array, cells: int = CELLS, parts: int = CELLS) -> tuple[float, float]:
        """The largest lambda met over all starts, and over those at samples."""
        with precision(BITS):
            form = matrix(P)
            X, L = form.inv().mid(), cholesky(form)
            if L is None:
                raise np.linalg.LinAlgError("P2 is not positive definite")
            L = L.mid()

            def top(Y: Matrix) -> float:
                return float(np.linalg.eigvalsh(floats(L.transpose() * Y * L))[-1])

            best = [1.0, max((top(Y) for Y in self._later(parts)), default=1.0)]
            for i, remaining, at_sample in self.starts(cells):
                value = max(top(Y) for Y in self._window(X, i, remaining, parts))
                best[at_sample] = max(best[at_sample], value)
        return max(best), best[1]


class PreciseSearch(WeightSearch):
    """The first guesses of the search, judged by windows in more digits than doubles have."""

    def guesses(self, eta: float) -> list[Array]:
        """One between the inverse of the long-run covariance and the least P1, or a rounder one: each costs much."""
        shapes = super().guesses(eta)
        return [shapes[0], shapes[-3]] if len(shapes) > len(ROUNDNESS) + 1 else shapes[-3:-2]

    def windows(self, eta: float) -> PreciseWindows:
        """The windows of one rate."""
        return PreciseWindows(self.canon, eta, self.work)


def precisely_chosen(
    problem: tuple[Plant, AnySchedule, NoiseWeights],
    canon: ScaledProblem,
    bounds: tuple[float, float],
    eta: float | None,
    budget: float,
    whole: WorkLimit,
) -> Certificate:
    """A certificate at the first rate, of few within `bounds` and below (internal units), at which balls prove one.

    The last one is fast and has work of its own: what settles soon is proven though all that went before it failed.
    P2 is the best of the first guesses; lambda is stated with `ROOM` above the largest that was met. Raises
    UndecidedError if balls prove none, or are not installed.
    """
    if eta is not None:
        stages = [([bounds[0]], 0.0)]
    else:
        low, high = bounds
        stages = [([(low * high) ** 0.5, low, low / 10], 0.0), ([(low * high**3) ** 0.25], SPARE_WORK)]
    for rates, spare in stages if find_spec("flint") else ():
        left = whole if whole.left > spare else WorkLimit(spare, stop=whole.stop)
        dear = WorkLimit(left.left / BALL_PRICE, left, BALL_PRICE)
        search, proofs = PreciseSearch(canon, SHARE, dear.share(PRECISE_WORK)), dear.share(2 * PRECISE_PROOF)
        for rate in rates:
            choice = None if search.work.over or proofs.over else search.best_guess(rate, budget)
            if choice is None:
                continue
            windows = search.setting(rate).windows
            assert isinstance(windows, PreciseWindows)
            met, stated_rate = windows.peaks(choice.P2), rate / canon.time if eta is None else eta
            stated = replace(choice, eta=stated_rate, P2=symmetrise(canon.outside(choice.P2)))
            how = {"weights": f"a first guess with noise gain {budget:g}, followed in {BITS} binary digits"}
            solver = SolverRecord("sampling_design", __version__, choice.status, choice.iterations, how)
            try:
                return _proven(problem, stated, met, solver, proofs)
            except UndecidedError:
                continue
    raise UndecidedError("undecided: no proof closes in more digits than doubles have either.")


def _proven(
    problem: tuple[Plant, AnySchedule, NoiseWeights],
    choice: ChosenWeights,
    met: tuple[float, float],
    solver: SolverRecord,
    proofs: WorkLimit,
) -> Certificate:
    """The certificate of this choice, in the plant's units, that balls prove with the widest `ROOM` above what was met.

    With the next narrower one the proof takes twice the work, which is near all that there is.
    """
    plant, schedule, weights = problem
    lam, lam_samples = (ROOM[-1] * value for value in met)
    spare = {"lambda": f"{ROOM[-1]:g} times the largest met: the proof needs the room"}
    made = Certificate(
        plant, schedule, P1=(1 - RESOLUTION) * choice.P2 / lam, P2=choice.P2, **weights._asdict(), eta=choice.eta,
        lam=lam, lam_samples=lam_samples, margin=STATED_MARGIN,
        solver=replace(solver, details={**solver.details, **spare}),
    )  # fmt: skip
    verdict = decided_on_schedule(made.content, proofs.share(PRECISE_PROOF))
    if verdict.passed:
        return as_proven(made)
    raise UndecidedError(f"undecided: {verdict.reason}.", verification=verdict, certificate=made)
