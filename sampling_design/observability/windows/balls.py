"""Lower bounds of sigma over sliding windows, proven in ball arithmetic (extra `rigorous`).

On a piece of window positions the samples are fixed, and Y = (O'O)^-1 flows with the window's start: Y' = A Y + Y A'.
Sigma is at least mu along the piece iff Y <= I/mu^2 there.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.numerics.ball_flow import BallFlow, OutOfTime, TimeBudget, highest
from sampling_design.numerics.balls import Ball, Matrix, ball, flint, floats, matrix, precision
from sampling_design.numerics.linalg import symmetrise
from sampling_design.observability.windows.pieces import Pieces
from sampling_design.plants.plant import Plant
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

SHAVES = (1e-6, 1e-4, 0.01, 0.1, 0.5)
"""Fractions taken off the bound that floats found, one after the other, until what is left is proven."""
PLACES = 33
"""Positions per piece at which sigma is looked at where floats saw nothing."""
ZOOMS = 3
"""Nearer looks around the least of them, each `PLACES`/2 times as near."""
BITS = (160, 400, 1200)
"""Precisions: the inverse of an ill-conditioned Gramian may need the second, growth beyond e^100 the third."""


class ProvenSigma(NamedTuple):
    """What balls proved: sigma >= lower over every window, its ends moved outward by `slack`; "closed" or "budget"."""

    lower: float
    slack: float
    status: str


def nearest_proven(
    guess: float, slack: float, begin: Callable[[], Callable[[float], bool]], shaves: tuple[float, ...] = SHAVES
) -> ProvenSigma:
    """The first of guess (1 - shave) that a search proves.

    Parameters
    ----------
    guess : float
        What floats believe; where it is 0 or infinite there is nothing to prove.
    slack : float
        By which the windows' ends are moved outward.
    begin : callable
        Sets the search up and returns what decides whether sigma >= mu, given mu; called once, within the precision
        of balls. Both may raise `OutOfTime`.
    shaves : tuple of float
        One after the other.

    Returns
    -------
    ProvenSigma
        lower = 0 where nothing is proven: "budget" or "rounding".
    """
    if not 0 < guess < np.inf:
        return ProvenSigma(guess, slack, "closed")
    with precision():
        try:
            proves = begin()
            for mu in (guess * (1 - shave) for shave in shaves):
                if proves(mu):
                    return ProvenSigma(mu, slack, "closed")
        except OutOfTime:
            return ProvenSigma(0.0, slack, "budget")
    return ProvenSigma(0.0, slack, "rounding")


def prove_window_sigma(
    plant: Plant, schedule: Schedule | PeriodicSchedule, pieces: Pieces, guess: float, seconds: float = 60.0
) -> ProvenSigma:
    """Prove a lower bound of sigma over all real window positions, as near to `guess` as can be.

        sigma_n(rows C e^{A (tau - s)}, tau in [s - slack, s + T + slack]) >= lower    for all real s

    Parameters
    ----------
    plant : Plant
    schedule : Schedule or PeriodicSchedule
        Its `times` and `period` are the doubles that the theorem is about.
    pieces : Pieces
        Of that schedule.
    guess : float
        What floats believe.
    seconds : float
        Budget.

    Returns
    -------
    ProvenSigma
        lower = 0 where nothing is proven in time. `slack` is zero where no two events were joined: samples that
        leave and arrive within rounding of each other count as one event, and `slack` is that distance.

    Raises
    ------
    MissingExtraError
        If python-flint is not installed.
    """
    flint()
    clock, exact = TimeBudget(seconds), exact_times(schedule, pieces)
    slack = needed_slack(schedule, pieces, exact)
    if not 0 < guess < np.inf:
        return ProvenSigma(guess, slack, "closed")
    for bits in BITS:
        with precision(bits):
            try:
                return ProvenSigma(_proven(plant, schedule, pieces, exact, guess, clock), slack, "closed")
            except OutOfTime:
                break
            except ZeroDivisionError:  # the Gramian is not certainly invertible at this precision
                continue
    return ProvenSigma(0.0, slack, "budget" if bits < BITS[-1] else "rounding")


class BallSigma(NamedTuple):
    """Sigma of one window in high precision: its piece, its start, sigma and the state that it sees least."""

    piece: int
    start: float
    sigma: float
    direction: npt.NDArray[np.float64]


def see_in_balls(
    plant: Plant, schedule: Schedule | PeriodicSchedule, pieces: Pieces, seconds: float = 60.0
) -> BallSigma | None:
    """The least sigma among some windows of every piece, where growth hides it from floats; None where it is zero.

    A sigma below n eps |C| counts as zero: rounding in the plant and the times alone can hide it.
    """
    clock, exact = TimeBudget(seconds), exact_times(schedule, pieces)
    least = plant.n_states * float(np.finfo(float).eps) * float(np.linalg.norm(plant.C))
    for bits in BITS:
        with precision(bits):
            try:
                seen = _seen(plant, schedule, pieces, exact, clock)
            except OutOfTime:
                return None
            except ZeroDivisionError:  # the Gramian is not certainly invertible at this precision
                continue
        return seen if seen.sigma > least else None
    return None


def _seen(
    plant: Plant, schedule: Schedule | PeriodicSchedule, pieces: Pieces, exact: list[Fraction], clock: TimeBudget
) -> BallSigma:
    """The least of the windows that are looked at, at the precision that is set: all over, then around the least."""
    flow, rows = BallFlow(matrix(plant.A), matrix(np.zeros_like(plant.A))), BallRows(plant)
    best = BallSigma(0, float(pieces.left[0]), np.inf, np.zeros(plant.n_states))

    def look(g: int, left: Fraction, right: Fraction) -> None:
        nonlocal best
        span = slice(int(pieces.first[g]), int(pieces.stop[g]))
        Y, step = rows.gramian(flow, exact[span], left, pieces.measured(g)).inv(), (right - left) / (PLACES - 1)
        E = flow.over(fraction(step))[0]
        for k in range(PLACES):
            values, vectors = np.linalg.eigh(symmetrise(floats(Y)))
            sigma = float(1 / np.sqrt(values[-1])) if values[-1] > 0 else 0.0
            if sigma < best.sigma:
                best = BallSigma(g, float(left + k * step), sigma, vectors[:, -1])
            Y = E * Y * E.transpose()
            clock.check()

    for g in range(len(pieces)):
        look(g, *piece_ends(schedule, pieces, g))
    left, right = piece_ends(schedule, pieces, best.piece)
    near = right - left
    for _ in range(ZOOMS):
        near = near * 2 / (PLACES - 1)
        at = min(max(Fraction(best.start), left), right)
        look(best.piece, max(left, at - near / 2), min(right, at + near / 2))
    return best


def exact_times(schedule: Schedule | PeriodicSchedule, pieces: Pieces) -> list[Fraction]:
    """The times of the pieces without rounding: times of one period plus whole periods."""
    if not isinstance(schedule, PeriodicSchedule):
        return [Fraction(t) for t in pieces.times.tolist()]
    cycle, period = [Fraction(t) for t in schedule.times.tolist()], Fraction(schedule.period)
    found: list[Fraction] = []
    for t in pieces.times.tolist():
        k = max(0, round((t - schedule.times[0]) / schedule.period) - 1)
        near = [own + period * m for m in range(k, k + 3) for own in cycle]
        found.append(min(near, key=lambda x: abs(x - Fraction(t))))
    return found


def last_start(schedule: Schedule | PeriodicSchedule, pieces: Pieces) -> Fraction:
    """The last window start that has to be looked at, without rounding."""
    if isinstance(schedule, PeriodicSchedule):
        return Fraction(schedule.first) + Fraction(schedule.period)
    return max(Fraction(float(schedule.times[-1])) - Fraction(pieces.window), Fraction(float(pieces.left[0])))


def needed_slack(schedule: Schedule | PeriodicSchedule, pieces: Pieces, exact: list[Fraction]) -> float:
    """How far the samples of a piece may lie outside its closed windows: zero, or the rounding of joined events."""
    T, need = Fraction(pieces.window), Fraction(0)
    for g in range(len(pieces)):
        first, stop = int(pieces.first[g]), int(pieces.stop[g])
        if stop > first:
            left, right = piece_ends(schedule, pieces, g)
            need = max(need, right - exact[first], exact[stop - 1] - T - left)
    return float(np.nextafter(float(need), np.inf)) if need else 0.0


def piece_ends(schedule: Schedule | PeriodicSchedule, pieces: Pieces, g: int) -> tuple[Fraction, Fraction]:
    """Ends of piece g without rounding; the last one reaches to the last window start that there is."""
    right = Fraction(float(pieces.right[g]))
    if g + 1 == len(pieces):
        right = max(right, last_start(schedule, pieces))
    return Fraction(float(pieces.left[g])), right


def _proven(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    pieces: Pieces,
    exact: list[Fraction],
    guess: float,
    clock: TimeBudget,
) -> float:
    """The largest of the shaved guesses that holds on every piece, or 0."""
    n = plant.n_states
    zero = matrix(np.zeros((n, n)))
    flow, rows = BallFlow(matrix(plant.A), zero), BallRows(plant)
    starts = []
    for g in range(len(pieces)):
        left, right = piece_ends(schedule, pieces, g)
        span = slice(int(pieces.first[g]), int(pieces.stop[g]))
        mask = pieces.measured(g)
        gramian = rows.gramian(flow, exact[span], left, mask)
        starts.append((gramian.inv(), fraction(right - left)))
    for shave in SHAVES:
        mu = guess * (1 - shave)
        limit = (1 / ball(mu) ** 2).lower()
        if all(highest(flow, Y, length, clock, limit=limit) is not None for Y, length in starts):
            return mu
    return 0.0


def fraction(time: Fraction) -> Ball:
    """A rational number as a ball."""
    made: Ball = flint().arb(time.numerator) / time.denominator
    return made


class BallRows:
    """C'C of each set of outputs, in balls."""

    def __init__(self, plant: Plant) -> None:
        self.C = plant.C
        self._kept: dict[bytes, Matrix] = {}

    def of(self, seen: npt.NDArray[np.bool_]) -> Matrix:
        """C'C of the outputs that a sample measures."""
        key = seen.tobytes()
        if key not in self._kept:
            C = matrix(self.C[seen])
            self._kept[key] = C.transpose() * C
        return self._kept[key]

    def gramian(
        self, flow: BallFlow, times: list[Fraction], start: Fraction, mask: npt.NDArray[np.bool_] | None
    ) -> Matrix:
        """Sum of e^{A'(tau - start)} C'C e^{A (tau - start)}, from the last sample back to the first."""
        n = self.C.shape[1]
        G, whole = matrix(np.zeros((n, n))), np.ones(self.C.shape[0], dtype=bool)
        for k in range(len(times) - 1, -1, -1):
            G = G + self.of(whole if mask is None else mask[k])
            E = flow.over(fraction(times[k] - (times[k - 1] if k else start)))[0]
            G = E.transpose() * G * E
        return G
