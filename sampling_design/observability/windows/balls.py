"""Lower bounds of sigma over sliding windows, proven in ball arithmetic (extra `rigorous`).

On a piece of window positions the samples are fixed, and Y = (O'O)^-1 flows with the window's start: Y' = A Y + Y A'.
Sigma is at least mu along the piece iff Y <= I/mu^2 there. Y is followed in the units that its own diagonal gives the
states, so that steps along it are as long in any units: only |Y| is taken in those of the plant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from fractions import Fraction

import numpy as np

from sampling_design.numerics.balls import (
    Ball,
    BallFlow,
    Matrix,
    ball,
    flint,
    floats,
    highest,
    identity,
    largest,
    matrix,
    precision,
    rational,
)
from sampling_design.numerics.linalg import positive_or_one, symmetrise
from sampling_design.observability.sigma_bracket import ProvenSigma
from sampling_design.observability.windows.pieces import WindowPieces, WindowWitness
from sampling_design.plants.plant import Plant
from sampling_design.records.budget import Budget, BudgetSpentError
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

SHAVES = (1e-6, 1e-4, 0.01, 0.1, 0.5)
"""Fractions taken off the bound that floats found, one after the other, until what is left is proven."""
PLACES = 33  # positions per piece at which sigma is looked at where floats saw nothing
ZOOMS = 3  # nearer looks around the least of them, each `PLACES`/2 times as near
PRECISIONS = (160, 400, 1200)
"""Precisions: the inverse of an ill-conditioned Gramian may need the second, growth beyond e^100 the third."""


def nearest_proven(
    guess: float,
    seconds: float,
    begin: Callable[[Budget], Callable[[float], bool]],
    *,
    slack: float = 0.0,
    shaves: tuple[float, ...] = SHAVES,
    precisions: tuple[int, ...] = PRECISIONS[:1],
) -> ProvenSigma:
    """Prove a lower bound of sigma as near to what floats believe as can be: the first of guess (1 - shave).

    Raises MissingExtraError if python-flint is not installed.

    Parameters
    ----------
    guess : float
        What floats believe; where it is 0 or infinite there is nothing to prove.
    seconds : float
        Budget.
    begin : callable
        Sets the search up within a precision of balls, given the clock, and returns what decides whether sigma >= mu,
        given mu. Both may raise `BudgetSpentError`, and ZeroDivisionError where a matrix is not certainly invertible.
    slack : float
        By which the windows' ends are moved outward.
    shaves : tuple of float
        One after the other.
    precisions : tuple of int
        Bits, the next ones where a matrix is not certainly invertible with those before.

    Returns
    -------
    ProvenSigma
        lower = 0 where nothing is proven: "budget", "interrupted" or "rounding".
    """
    flint()
    if not 0 < guess < np.inf:
        return ProvenSigma(guess, slack, "closed")
    clock = Budget(seconds)
    for bits in precisions:
        with precision(bits), suppress(ZeroDivisionError):
            try:
                proves = begin(clock)
                proven = next((mu for mu in (guess * (1 - shave) for shave in shaves) if proves(mu)), None)
            except (BudgetSpentError, KeyboardInterrupt) as end:
                return ProvenSigma(0.0, slack, "budget" if isinstance(end, BudgetSpentError) else "interrupted")
            return ProvenSigma(0.0, slack, "rounding") if proven is None else ProvenSigma(proven, slack, "closed")
    return ProvenSigma(0.0, slack, "rounding")


def prove_window_sigma(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    pieces: WindowPieces,
    guess: float,
    seconds: float = 60.0,
    rows: BallRows | None = None,
) -> ProvenSigma:
    """Prove a lower bound of sigma over all real window positions: see `nearest_proven`.

        sigma_n(rows C e^{A (tau - s)}, tau in [s - slack, s + T + slack]) >= lower    for all real s

    `times` and `period` of the schedule are the doubles that the theorem is about. `slack` is zero where no two events
    were joined: samples that leave and arrive within rounding of each other count as one event, and `slack` is that
    distance. `rows` may hold what `sigma_in_balls` worked out.
    """
    rows = BallRows(plant, schedule, pieces) if rows is None else rows

    def begin(clock: Budget) -> Callable[[float], bool]:
        starts = [(Y, rows.own_units(Y), length) for Y, length in rows.inverses(clock)]

        def proves(mu: float) -> bool:
            limit = (1 / ball(mu) ** 2).lower()
            return all(rows.stays_below(limit, *start, clock) for start in starts)

        return proves

    return nearest_proven(
        guess, seconds, begin, slack=needed_slack(schedule, pieces, rows.exact), precisions=PRECISIONS
    )


def sigma_in_balls(rows: BallRows, clock: Budget) -> WindowWitness | None:
    """The least sigma among some windows of every piece, where growth hides it from floats; None where it is zero.

    A sigma below n eps |C| counts as zero: rounding in the plant and the times alone can hide it.

    Raises BudgetSpentError if the clock ends before that is known.
    """
    plant = rows.plant
    least = plant.n_states * float(np.finfo(float).eps) * float(np.linalg.norm(plant.C))
    for bits in PRECISIONS:
        with precision(bits):
            try:
                exact_sigma = _observed(rows, clock)
            except ZeroDivisionError:  # the Gramian is not certainly invertible at this precision
                continue
        return exact_sigma if exact_sigma.sigma > least else None
    return None


def _observed(rows: BallRows, clock: Budget) -> WindowWitness:
    """The least of the windows that are looked at, at the precision that is set: all over, then around the least."""
    pieces, plant = rows.pieces, rows.plant
    at, best = (0, float(pieces.left[0])), pieces.witness(0, float(pieces.left[0]), np.zeros(plant.n_states), np.inf)

    def look(g: int, left: Fraction, right: Fraction, Y: Matrix) -> None:
        nonlocal at, best
        step = (right - left) / (PLACES - 1)
        E = rows.flow.over(rational(step))[0]
        for k in range(PLACES):
            values, vectors = np.linalg.eigh(symmetrise(floats(Y)))
            sigma = float(1 / np.sqrt(values[-1])) if values[-1] > 0 else 0.0
            if sigma < best.sigma:
                at = g, float(left + k * step)
                best = pieces.witness(*at, vectors[:, -1], sigma)
            Y = E * Y * E.transpose()
            clock.check()

    starts = []
    for g, (Y, _) in enumerate(rows.inverses(clock)):
        starts.append(Y)
        look(g, *piece_ends(rows.schedule, pieces, g), Y)
    left, right = piece_ends(rows.schedule, pieces, at[0])
    near = right - left
    for _ in range(ZOOMS):
        near = near * 2 / (PLACES - 1)
        middle = min(max(Fraction(at[1]), left), right)
        begin, end = max(left, middle - near / 2), min(right, middle + near / 2)
        look(at[0], begin, end, rows.flow.step(starts[at[0]], rational(begin - left)))
    return best


def exact_times(schedule: Schedule | PeriodicSchedule, pieces: WindowPieces) -> list[Fraction]:
    """The times of the pieces without rounding: times of one period plus whole periods."""
    if not schedule.endless:
        return [Fraction(t) for t in pieces.times.tolist()]
    cycle, period = [Fraction(t) for t in schedule.times.tolist()], Fraction(schedule.period)
    found: list[Fraction] = []
    for t in pieces.times.tolist():
        k = max(0, round((t - schedule.times[0]) / schedule.period) - 1)
        near = [own + period * m for m in range(k, k + 3) for own in cycle]
        found.append(min(near, key=lambda x: abs(x - Fraction(t))))
    return found


def last_start(schedule: Schedule | PeriodicSchedule, pieces: WindowPieces) -> Fraction:
    """The last window start that has to be looked at, without rounding."""
    if schedule.endless:
        return Fraction(schedule.first) + Fraction(schedule.period)
    return max(Fraction(float(schedule.times[-1])) - Fraction(pieces.window), Fraction(float(pieces.left[0])))


def needed_slack(schedule: Schedule | PeriodicSchedule, pieces: WindowPieces, exact: list[Fraction]) -> float:
    """How far the samples of a piece may lie outside its closed windows: zero, or the rounding of joined events."""
    T, need = Fraction(pieces.window), Fraction(0)
    for g in range(len(pieces)):
        first, stop = int(pieces.first[g]), int(pieces.stop[g])
        if stop > first:
            left, right = piece_ends(schedule, pieces, g)
            need = max(need, right - exact[first], exact[stop - 1] - T - left)
    return float(np.nextafter(float(need), np.inf)) if need else 0.0


def piece_ends(schedule: Schedule | PeriodicSchedule, pieces: WindowPieces, g: int) -> tuple[Fraction, Fraction]:
    """Ends of piece g without rounding; the last one reaches to the last window start that there is."""
    right = Fraction(float(pieces.right[g]))
    if g + 1 == len(pieces):
        right = max(right, last_start(schedule, pieces))
    return Fraction(float(pieces.left[g])), right


class BallRows:
    """Flow and outputs of a plant along window pieces of a schedule, in balls."""

    def __init__(self, plant: Plant, schedule: Schedule | PeriodicSchedule, pieces: WindowPieces) -> None:
        self.plant, self.schedule, self.pieces = plant, schedule, pieces
        self.exact, self._bits = exact_times(schedule, pieces), 0
        self._begin()

    def _begin(self) -> None:
        """Keep nothing of another precision."""
        if self._bits != (bits := int(flint().ctx.prec)):
            self._bits = bits
            self.flow = BallFlow(matrix(self.plant.A), matrix(np.zeros_like(self.plant.A)))
            self._outputs: dict[bytes, Matrix] = {}
            self._flows: dict[tuple[float, ...], BallFlow] = {}
            self._inverses: list[tuple[Matrix, Ball]] = []

    def inverses(self, clock: Budget) -> Iterator[tuple[Matrix, Ball]]:
        """Yield Y = (O'O)^-1 at the left end of each piece, and its length, at the precision that is set.

        Raises ZeroDivisionError if one is not certainly invertible, BudgetSpentError if the clock ends.
        """
        self._begin()
        if len(self._inverses) == len(self.pieces):
            yield from self._inverses
            return
        self._inverses = []
        for g, G in enumerate(self._gramians(clock)):
            left, right = piece_ends(self.schedule, self.pieces, g)
            self._inverses.append((G.inv(), rational(right - left)))
            yield self._inverses[-1]

    def _outputs_of(self, k: int) -> Matrix:
        """The rows of C that sample k measures."""
        measured = np.ones(len(self.plant.C), dtype=bool) if self.pieces.mask is None else self.pieces.mask[k]
        key = measured.tobytes()
        if key not in self._outputs:
            self._outputs[key] = matrix(self.plant.C[measured])
        return self._outputs[key]

    def _gramians(self, clock: Budget) -> Iterator[Matrix]:
        """Yield the Gramian of each piece at its left end, as a queue of two stacks: no sample is ever subtracted.

        What was in the window when the first stack was filled is held from the end on, G_k and the flow from sample k
        to the last of them; what came later is one Gramian at that last one. A window takes a few products, not two for
        each of its samples.
        """
        stack: dict[int, tuple[Matrix, Matrix]] = {}
        n, middle, reached = self.plant.n_states, 0, 0
        later, passed = matrix(np.zeros((n, n))), identity(n)

        def crossed(k: int, since: Fraction) -> Matrix:
            clock.check()
            F: Matrix = self.flow.over(rational(self.exact[k] - since))[0]
            return F

        for g in range(len(self.pieces)):
            first, stop = int(self.pieces.first[g]), int(self.pieces.stop[g])
            if first >= middle:
                stack, middle, reached = {}, stop, stop
                later, passed, G = matrix(np.zeros((n, n))), identity(n), matrix(np.zeros((n, n)))
                F = identity(n)
                for k in range(stop - 1, first - 1, -1):
                    if k + 1 < stop:
                        E = crossed(k + 1, self.exact[k])
                        G, F = E.transpose() * G * E, F * E
                    C = self._outputs_of(k)
                    G = G + C.transpose() * C
                    stack[k] = G, F
            for k in range(reached, stop):
                passed = crossed(k, self.exact[k - 1]) * passed
                rows = self._outputs_of(k) * passed
                later = later + rows.transpose() * rows
            reached = stop
            if first == stop:
                yield later
                continue
            G, F = stack[first]
            E = crossed(first, Fraction(float(self.pieces.left[g])))
            yield E.transpose() * (G + F.transpose() * later * F) * E

    def own_units(self, Y: Matrix) -> tuple[float, ...]:
        """Units of the states, powers of two, in which Y has a diagonal near one; any units would be sound."""
        sizes = np.sqrt(positive_or_one(np.diagonal(floats(Y))))
        return tuple(np.exp2(np.rint(np.log2(sizes))).tolist())

    def stays_below(self, limit: Ball, Y: Matrix, units: tuple[float, ...], length: Ball, clock: Budget) -> bool:
        """Whether Y <= `limit` I is proven along the whole flow, which is followed in these units."""
        unit, inverse = matrix(np.diag(units)), matrix(np.diag(1 / np.array(units)))
        if units not in self._flows:
            self._flows[units] = BallFlow(inverse * self.flow.A * unit, self.flow.S)
        slope = ball(max(units)) ** 2
        top = highest(
            self._flows[units], inverse * Y * inverse, length, clock, lambda Z: largest(unit * Z * unit), slope, limit
        )
        return top is not None
