"""Proof of Y <= I over all real window starts, all later times and all periods, in ball arithmetic.

1. Along time and along the starts of a cell Y bulges over its chord by a bounded multiple of I (`numerics.balls`).
   Where Y rises, the end covers the stretch: what falls is added.
2. With one and the same gain for a whole cell the recursion is affine in Y, and at least as large as with the best
   gains: the two ends of the chord cover the cell.
3. The recursion is monotone: a window below a family B_i that it maps below itself need not be followed any further,
   and none at all where the flow alone takes a multiple of I below itself, since samples only lower Y. Any one of
   several such families will do.

Midpoints propose gains and the family; balls decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, reduce

import numpy as np

from sampling_design.certificates.rigorous.ball_problem import ScheduleFrame
from sampling_design.numerics.balls import (
    BITS,
    Ball,
    BallFlow,
    Matrix,
    ball,
    definite,
    fallen,
    floats,
    highest,
    identity,
    largest,
    raised,
)
from sampling_design.numerics.branch_and_bound import all_proven
from sampling_design.records.budget import Budget

CELLS = 4  # start cells per gap at first
HALVINGS = 40  # most halvings of a start cell
PERIODS = 1000  # periods along one window
DOUBLINGS = 40  # the recursion of midpoints has settled after 2^DOUBLINGS periods, or does not
BEYOND = 1e250  # what grows to this settles nowhere
LOST = 1e6  # where the target is I: what comes here does not come back, or not soon
PROPOSALS = {BITS: (1e-14, 1e-10, 1e-6, 1e-3), 400: (1e-44, 1e-38, 1e-32, 1e-26, 1e-20)}
"""Noise added at every sample, where the target is I, to find the family; and the digits.

Little of it comes first: more of it fills fast directions, where Y must then be followed in short steps. Nearly equal
modes behind few outputs bear 1e-30, with what is known best 1e45 times better than the rest.
"""
SEEN = 5  # samples along which a window is followed before a family is made of it
SOUGHT = 8  # such families in one proof, each of a window that was followed twice as far as that of the one before
LINGERS = 8  # times as many samples as until then, within which it must come below where it was
WIDENED = 1.3  # by how much its covariance is raised first, at most: what is wide catches others early
POWERS = (0.95, 0.8, 0.5, 0.2, 0.02, 0.0)
"""How far the family is blown up towards I, as powers of what samples leave: not at all where the peak lies between."""

Period = tuple[Matrix, Matrix, Matrix]
"""A, H, W of the map Y -> A Y (I + H Y)^-1 A' + W that samples and gaps make; midpoints."""


def settled(frame: ScheduleFrame, inflation: float, clock: Budget) -> tuple[list[Matrix], float]:
    """Return Y after each sample of the last period with inflated noise, midpoints, and its largest eigenvalue there.

    Raises ArithmeticError if it leaves I behind by far, or does not settle.
    """
    more = ball(inflation) * frame.identity

    def converged(before: Matrix, after: Matrix) -> bool:
        return _size(after - before) <= 1e-2 * inflation

    def spend(maps: int) -> None:
        clock.check((60 + frame.n**3) * maps)

    if not frame.schedule.periodic:
        spend(frame.schedule.N)
        return one_period(frame, frame.start.mid(), more)
    covariances, worst = one_period(frame, long_run(frame, more, converged, spend), more)
    if not worst < LOST:
        raise ArithmeticError("the recursion settles far above what is claimed")
    return covariances, worst


def long_run(
    frame: ScheduleFrame, more: Matrix, converged: Callable[[Matrix, Matrix], bool], spend: Callable[[int], None]
) -> Matrix:
    """Y after a period's last sample, in the long run where `more` is added at every sample; midpoints.

    Periods are composed, twice as many in each step, so that what settles over thousands of them costs a dozen maps.
    Raises ArithmeticError if it does not settle over 2^DOUBLINGS periods.
    """
    spend(frame.schedule.N)
    period = reduce(_then, [_sampled(frame, i, more) for i in range(frame.schedule.N)])
    Y = _apply(period, frame.start.mid())
    for _ in range(DOUBLINGS):
        spend(1)
        before, Y = Y, _apply(period, Y)
        if not _size(Y) < BEYOND:
            break
        if converged(before, Y):
            return Y
        period = _then(period, period)
    raise ArithmeticError("the recursion does not settle")


def _sampled(frame: ScheduleFrame, i: int, more: Matrix) -> Period:
    """The gap before sample i, the sample, and what is added after it."""
    F, W = frame.flow.over(frame.schedule.gaps[i])
    C, K = frame.rows[i], frame.gain(W, i)
    output, variance = C * F, C * W * C.transpose() + frame.noises[i]
    left = _even(frame.with_gain(W, i, K)) + more
    return ((frame.identity - K * C) * F).mid(), _even(output.transpose() * variance.solve(output)), left


def _then(first: Period, second: Period) -> Period:
    """The composition of two maps of that form."""
    (A, H, W), (B, J, V) = first, second
    n = A.nrows()
    carried = (identity(n) + W * J).transpose().solve(B.transpose()).transpose()  # B (I + W J)^-1
    through = (identity(n) + J * W).solve(J * A)
    return (carried * A).mid(), _even(H + A.transpose() * through), _even(V + carried * W * B.transpose())


def _apply(period: Period, Y: Matrix) -> Matrix:
    A, H, W = period
    return _even(W + A * Y * (identity(A.nrows()) + H * Y).solve(A.transpose()))


def one_period(frame: ScheduleFrame, Y: Matrix, more: Matrix) -> tuple[list[Matrix], float]:
    """Y after each sample, with `more` added, and the largest eigenvalue; midpoints."""
    covariances, worst = [], 0.0
    for i, gap in enumerate(frame.schedule.gaps):
        F, W = frame.flow.over(gap)
        before = (F * Y * F.transpose() + W).mid()
        Y = _even(frame.with_gain(before, i, frame.gain(before, i))) + more
        covariances.append(Y)
        worst = max(worst, _top(before), _top(Y))
    return covariances, worst


def _even(M: Matrix) -> Matrix:
    """The midpoints of a matrix that is symmetric but for rounding."""
    return ((M + M.transpose()) / 2).mid()


def _top(M: Matrix) -> float:
    return float(np.linalg.eigvalsh(floats(M))[-1])


def _size(M: Matrix) -> float:
    return float(np.abs(floats(M)).max())


StartCell = tuple[int, Ball, Ball, int]


class BallWindows:
    """The proof for one target: a family that catches the windows, then every cell of window starts."""

    def __init__(self, frame: ScheduleFrame, clock: Budget) -> None:
        self.frame, self.schedule, self.clock, self.reached = frame, frame.schedule, clock, 0.0
        self.longest = reduce(lambda a, b: a.max(b), self.schedule.reach)
        self.families: list[list[Matrix]] = []
        self.sought = 0  # how often a wider one than the first was sought

    @cached_property
    def falling(self) -> BallFlow:
        """The flow of what falls at the start."""
        return BallFlow(self.frame.flow.A, fallen(self.frame.flow.slope(self.frame.start)))

    def start_is_invariant(self) -> bool:
        """Whether some s I, s <= 1, holds the start and the flow alone takes it below itself: then all windows."""
        frame = self.frame
        for s in (largest(frame.start), ball(1.0)):
            self.clock.check(frame.n**3)
            if (
                s <= 1
                and definite(s * frame.identity - frame.start)
                and definite(-frame.flow.slope(s * frame.identity))
            ):
                self.reached = float(s)
                return True
        return False

    def below_one(self, Y: Matrix, duration: Ball) -> bool:
        """Whether Y <= I is proven along `duration`."""
        top = highest(self.frame.flow, Y, duration, self.clock)
        if top is not None:
            self.reached = max(self.reached, float(top))
        return top is not None

    def propose(self, inflations: Sequence[float]) -> bool:
        """Find and prove a family B_i that the recursion maps below itself and that stays below I, and that catches.

        A finite schedule needs none.
        """
        for inflation in inflations:
            try:
                Z, worst = settled(self.frame, inflation, self.clock)
            except (ArithmeticError, np.linalg.LinAlgError):
                continue
            if not worst < 1:  # nor with more noise
                break
            if any(self.invariant([ball(worst**-power) * z for z in Z]) for power in POWERS):
                return True
        return not self.schedule.periodic

    def widen(self, Y: Matrix, i: int, most: int) -> None:
        """Make a family of Y just before sample i, raised: if it comes below where it was, and is below I until then.

        Where windows come down slowly, they are below it long before they are near those in the long run.
        """
        frame, schedule, passed = self.frame, self.schedule, dict[int, Matrix]()
        self.sought += 1
        Y = _even(Y) * ball(np.clip(_top(Y) ** -0.5, 1.0, WIDENED))
        for _ in range(most):
            self.clock.check(200 + 3 * frame.n**3)
            Y = raised(frame.with_gain(Y, i, frame.gain(Y, i)))
            if len(passed) == schedule.N and (self.caught([Y], i) or definite(passed[i] - Y)):
                self.families.append([passed[k] for k in range(schedule.N)])
                return
            passed.setdefault(i, Y)
            i = schedule.after(i)
            if not self.below_one(Y, schedule.gaps[i]):
                return
            Y = frame.flow.step(Y, schedule.gaps[i])

    def invariant(self, B: list[Matrix]) -> bool:
        """Whether the family is proven; keep it if so."""
        frame, schedule, reached = self.frame, self.schedule, self.reached
        for i in range(schedule.N if schedule.periodic else schedule.N - 1):
            after = schedule.after(i)
            later = frame.flow.step(B[i], schedule.gaps[after])
            left = frame.with_gain(later, after, frame.gain(later, after))
            if not (definite(B[after] - left) and self.below_one(B[i], schedule.gaps[after])):
                self.reached = reached
                return False
        self.families.append(B)
        return True

    def caught(self, ends: list[Matrix], i: int) -> bool:
        """Whether the window need not be followed beyond sample i."""
        if not self.schedule.periodic and i + 1 == self.schedule.N:
            return True
        return any(all(definite(family[i] - Y) for Y in ends) for family in reversed(self.families))

    def follow(self, ends: list[Matrix], i: int) -> bool:
        """Whether all windows between `ends`, which hold Y just before sample i, stay below I."""
        frame, schedule = self.frame, self.schedule
        for followed in range(PERIODS * schedule.N):
            self.clock.check(200 + 3 * frame.n**3)
            middle = sum(ends[1:], ends[0]) / len(ends)
            if self.families and self.sought < SOUGHT and followed == SEEN * 2**self.sought:
                self.widen(middle, i, LINGERS * followed)
            K = frame.gain(middle, i)
            ends = [raised(frame.with_gain(Y, i, K)) for Y in ends]
            if self.caught(ends, i):
                return True
            i = schedule.after(i)
            if not all(self.below_one(Y, schedule.gaps[i]) for Y in ends):
                return False
            ends = [frame.flow.step(Y, schedule.gaps[i]) for Y in ends]
        return False

    def cell(self, low: Ball, high: Ball) -> list[Matrix]:
        """Ends of a chord that lies above Y(r), r in [low, high], r after the window's start; one end where Y rises."""
        flow, Y = self.frame.flow, self.frame.start
        first, last, length = flow.step(Y, low), flow.step(Y, high), high - low
        if not length > 0:
            return [first]
        bulge = length**2 / 8 * flow.carried(fallen(flow.second(first)), length)
        F, _ = flow.over(low)
        _, W = self.falling.over(length)
        moved = F * W * F.transpose()
        if np.trace(floats(moved)) <= np.trace(floats(bulge)):
            return [last + moved]
        return [first + bulge, last + bulge]

    def everywhere(self, failed: Callable[[int], None]) -> bool:
        """Prove every real start; `failed(depth)` hears of each cell that is halved."""
        schedule = self.schedule
        if not self.below_one(self.frame.start, self.longest):
            return False
        pending = [
            (i, schedule.reach[i] * k / CELLS, schedule.reach[i] * (k + 1) / CELLS, 0)
            for i in range(schedule.N)
            for k in range(CELLS if schedule.reach[i] > 0 else 1)
        ]

        def parts_of(cell: StartCell) -> list[StartCell] | None:
            i, low, high, depth = cell
            if self.follow(self.cell(low, high), i):
                return []
            failed(depth)
            if depth >= HALVINGS or not high > low:
                return None
            middle = (low + high) / 2
            return [(i, low, middle, depth + 1), (i, middle, high, depth + 1)]

        return all_proven(pending, parts_of)

    def at_samples(self) -> bool:
        """Prove the starts just after samples, and at time 0."""
        schedule = self.schedule
        starts = [(i, schedule.gaps[i]) for i in range(schedule.N)] + [(0, schedule.first)]
        whole = self.below_one(self.frame.start, self.longest)
        return whole and all(self.follow([self.frame.flow.step(self.frame.start, r)], i) for i, r in starts)
