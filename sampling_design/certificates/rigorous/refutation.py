"""Search for a window in which Y <= I fails: found and polished in floats, decided in balls at one point.

A window is named by (i, r, k, s): it starts r before sample i, takes k samples, and is looked at s later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sampling_design.certificates.rigorous.ball_problem import ScheduleFrame
from sampling_design.checkers.outcome import Refused
from sampling_design.numerics.balls import ball, definite, floats, lowered, precision
from sampling_design.numerics.filtering import measurement_update, propagate, whitened
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget

PARTS = 8  # parts of a gap in the first grid of starts and of times
PERIODS = 100  # most periods followed in the first grid
POLISHES = 4  # how many of the grid's best points are polished
SETTLED = 1e-12  # relative change over a period below which a window is not followed any further
BITS = (160, 400)  # precisions of the decision, one after the other
DOUBT = 1e-6  # points that floats see this close to failing are decided in balls
FAR = 1e-3  # a point that is further than this from failing, also after a coarse polish, is not polished sharply
COARSE, SHARP = (1e-2, 1e-4, 40), (1e-9, 0.0, 150)
"""Of a polish: shares of the longer gap and of the value within which it ends, and how many points it looks at."""


@dataclass(frozen=True)
class WindowPoint:
    """One window and time, with the largest eigenvalue of Y there as floats see it."""

    i: int
    r: float
    k: int
    s: float
    value: float


class RefutationSearch:
    """Float search for the largest eigenvalue of Y over starts and times."""

    def __init__(self, frame: ScheduleFrame, samples_only: bool, clock: Budget) -> None:
        self.frame, self.schedule, self.samples_only, self.clock = frame, frame.schedule, samples_only, clock
        self.gaps = [float(gap) for gap in self.schedule.gaps]
        self.reach = [float(gap) for gap in self.schedule.reach]
        self.A, self.S = floats(frame.flow.A), floats(frame.flow.S)
        self.rows = [whitened(floats(H), floats(V)) for H, V in zip(frame.rows, frame.noises, strict=True)]
        self.over_gaps = [tuple(floats(M) for M in frame.flow.over(gap)) for gap in self.schedule.gaps]

    def step(self, Y: Array, duration: float) -> Array:
        """Y `duration` later: doubles, as a polish asks for hundreds of durations that nothing else needs."""
        F, W = discounted_flow(self.A, self.S, duration)
        return propagate(Y, F[0], W[0])

    def grid(self) -> list[WindowPoint]:
        """Best points of a grid, the best first: one for each cell of starts and gap in which it is looked at."""
        parts, start = np.arange(PARTS + 1) / PARTS, floats(self.frame.start)
        pairs = [[self.frame.flow.over(gap * float(part)) for part in parts] for gap in self.schedule.gaps]
        flows = [(np.array([floats(F) for F, _ in row]), np.array([floats(W) for _, W in row])) for row in pairs]
        points = []
        for i in range(self.schedule.N):
            ends = {self.gaps[i], float(self.schedule.first) if i == 0 else self.gaps[i]}
            r = np.array(sorted(ends)) if self.samples_only else parts * self.reach[i]
            Y = np.array([self.step(start, float(x)) for x in r])
            points.append(self._best(Y, i, r, 0, np.zeros(1)))
            points += self._followed(Y, i, r, flows)
        return sorted(points, key=lambda point: (-round(point.value, 12), point.k))

    def _followed(self, Y: Array, i: int, r: Array, flows: list[tuple[Array, Array]]) -> list[WindowPoint]:
        """Best points along the windows that start r before sample i, until a period changes nothing."""
        schedule, points, before, parts = self.schedule, [], np.zeros_like(Y), np.arange(PARTS + 1) / PARTS
        for k in range(1, PERIODS * schedule.N + 1):
            at = (i + k - 1) % schedule.N
            self.clock.check(100 + r.size * PARTS * self.frame.n)
            Y, after = measurement_update(Y, self.rows[at]), schedule.after(at)
            if not schedule.periodic and at + 1 == schedule.N:
                break
            if k % schedule.N == 0:
                if np.abs(Y - before).max() <= SETTLED * np.abs(Y).max():
                    break
                before = Y
            F, W = (part[:, None] for part in flows[after])
            stack = propagate(Y, F, W)
            points.append(self._best(stack.reshape(-1, *Y.shape[1:]), i, r, k, parts * self.gaps[after]))
            Y = stack[-1]
        return points

    def _best(self, Y: Array, i: int, r: Array, k: int, times: Array) -> WindowPoint:
        values = np.linalg.eigvalsh(Y)[:, -1].reshape(times.size, r.size)
        row, column = np.unravel_index(int(np.argmax(values)), values.shape)
        return WindowPoint(i, float(r[column]), k, float(times[row]), float(values[row, column]))

    def value(self, i: int, r: float, k: int, s: float) -> float:
        """Largest eigenvalue of Y at a point."""
        self.clock.check(40.0 * (k + 1))
        Y = self.step(floats(self.frame.start), r)
        for j in range(k):
            Y = measurement_update(Y, self.rows[(i + j) % self.schedule.N])
            Y = self.step(Y, s) if j + 1 == k else propagate(Y, *self.over_gaps[(i + j + 1) % self.schedule.N])
        return float(np.linalg.eigvalsh(Y)[-1])

    def polished(self, point: WindowPoint) -> WindowPoint:
        """The point moved to the nearest local maximum over r and s, or near it where that is far from failing."""
        if point.value < 1 - FAR:
            coarse = self._moved(point, *COARSE)
            if coarse.value < 1 - FAR:
                return coarse
        return self._moved(point, *SHARP)

    def _moved(self, point: WindowPoint, near: float, alike: float, most: int) -> WindowPoint:
        from scipy.optimize import minimize

        tops = np.array([self.reach[point.i], self.gaps[(point.i + point.k) % self.schedule.N]])
        free = np.array([not self.samples_only and tops[0] > 0, point.k > 0])
        if not free.any():
            return point
        best = np.array([point.r, point.s])

        def at(x: Array) -> Array:
            moved = best.copy()
            moved[free] = x
            return np.asarray(np.clip(moved, 0.0, tops))

        def lost(x: Array) -> float:
            r, s = at(x)
            return -self.value(point.i, float(r), point.k, float(s))

        simplex = np.tile(best[free], (free.sum() + 1, 1))
        simplex[1:] += np.diag(np.where(simplex[0] > tops[free] / 2, -1, 1) * tops[free] / (2 * PARTS))
        options = {"initial_simplex": simplex, "xatol": near * float(tops.max()), "fatol": alike, "maxfev": most}
        result = minimize(lost, best[free], method="Nelder-Mead", options=options)
        if -result.fun <= point.value:
            return point
        r, s = at(result.x)
        return WindowPoint(point.i, float(r), point.k, float(s), float(-result.fun))


def fails_at(frame: ScheduleFrame, point: WindowPoint) -> bool:
    """Whether Y <= I certainly fails at a point: a lower bound of Y is carried along, for the recursion is monotone."""
    schedule = frame.schedule
    Y = frame.flow.step(frame.start, ball(point.r).min(schedule.reach[point.i]))
    for j in range(point.k):
        i = (point.i + j) % schedule.N
        after = schedule.after(i)
        left = frame.sampled(lowered(Y), i)
        if left is None:  # so many digits lose it
            return False
        Y = lowered(left)
        Y = frame.flow.step(Y, ball(point.s).min(schedule.gaps[after]) if j + 1 == point.k else schedule.gaps[after])
    return definite(frame.identity - Y) is False


def refute(make: Callable[[], ScheduleFrame], clock: Budget, samples_only: bool = False) -> None:
    """Raise Refused if some window is found in which Y <= I certainly fails; `make()` makes the frame."""
    frame = make()
    search = RefutationSearch(frame, samples_only, clock)
    for found in search.grid()[:POLISHES]:
        point = search.polished(found)
        for bits in BITS if point.value > 1 - DOUBT else ():
            with precision(bits):
                failed = fails_at(make(), point)
            if failed:
                raise _refutation(frame, point)


def _refutation(frame: ScheduleFrame, point: WindowPoint) -> Refused:
    """The exception that names the window, the time and by how much."""
    schedule = frame.schedule
    times, gaps = [float(t) for t in schedule.times], [float(gap) for gap in schedule.gaps]
    start = times[point.i] - point.r
    start += float(schedule.period) if start < 0 and schedule.periodic else 0.0
    late = point.r + point.s + sum(gaps[(point.i + j) % schedule.N] for j in range(1, point.k))
    amount = 1 / point.value - 1
    reason = f"{frame.inequality} fails by {-amount:.3g} at time {start + late:.6g} in the window from {start:.6g}"
    return Refused(frame.inequality, reason, amount=amount, time=start + late, start=start)
