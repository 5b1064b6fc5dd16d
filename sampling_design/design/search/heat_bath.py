"""Which hour on which day, where what is allowed repeats: one sample after another drawn anew over all places.

Windows that begin one sample apart differ by what that sample sees as it leaves and as it comes back, so that the worst
window is decided by the order in which the hours follow each other, and by days with two readings and days with none:
a question of words, which no gradient answers. A sample is taken out, all windows are worked out for every place where
it may be put back (the hours that the relaxation weighs, of every repetition), and one of them is drawn, a better one
more often: Gibbs' sampler, slowly cooled.

One inverse for each window is enough for all places. With A = W - t I, t a little below the least eigenvalue of what
the other samples see,

    lambda_min(W + X'X) >= t + 1/trace((A + X'X)^{-1}),

Newton's step for the characteristic polynomial from below, and the trace changes by one division for each row of X.

References
----------
Geman and Geman 1984.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sampling_design.design.bounds.relaxation import Relaxation
from sampling_design.design.bounds.zones import least_shift
from sampling_design.design.problem.numbers import DesignProblem
from sampling_design.design.problem.turning import TurningWindows
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import ENDLESS, Budget

Valued = tuple[float, Array]

_HOURS, _WEIGHS = 12, 0.01  # that samples may move to: the heaviest ones, of a share of the heaviest one at least
_WARM, _COOL = 0.06, 0.03  # temperatures at first and in the end, in sigma^2 of the relaxation for one sample
_SHARPNESS = 100.0  # in 1/sigma^2 of the relaxation: how the windows are weighed, as at first in `smooth`
_SWEEPS = 130  # times that each sample is drawn anew, about
_WORK = 4_000_000_000  # multiplications of a run at most: fewer steps of many samples, places or states
_BELOW = 0.1  # of sigma^2 of the relaxation: how far t stays below the least eigenvalue
_KEPT, _ALIKE = 2, 1e-3  # schedules of a run that are kept, and by what share two must differ
_PARENTS = 2  # runs that are gone on from
_SAME = 1e-6  # of the shift: hours nearer than that are one


def annealed(
    problem: DesignProblem,
    found: Relaxation,
    starts: list[Array],
    rng: np.random.Generator,
    budget: Budget = ENDLESS,
    progress: Callable[[float], None] | None = None,
) -> list[Array]:
    """The best few schedules of a run from each of the `starts`, and of as many again from where the best ones led.

    None where flow or relaxation do not serve, or a run would not come to every sample. A run that is not over by the
    `budget` is cut short. `progress` is called with the share that is done, after each run.
    """
    if problem.turning is None or problem.samples < 2 or not 0 < found.value < np.inf:
        return []
    bath = HeatBath(problem, problem.turning, places(problem, found), found.value)
    if bath.steps < problem.samples:
        return []
    found_by: list[list[Valued]] = []
    for start in starts:
        found_by.append(bath.run(start, rng, bath.steps, budget))
        if progress:
            progress(len(found_by) / (2 * len(starts)))
    parents = sorted([run[0] for run in found_by if run], key=lambda one: -one[0])[:_PARENTS]
    for i in range(len(starts) if parents else 0):
        parent = parents[i % len(parents)]
        run = bath.run(parent[1], rng, bath.steps, budget)
        parents[i % len(parents)] = max([parent, *run[:1]], key=lambda one: one[0])
        found_by.append(run)
        if progress:
            progress(len(found_by) / (2 * len(starts)))
    return [times for run in found_by for _, times in run]


def places(problem: DesignProblem, found: Relaxation) -> Array:
    """The hours that weigh most, in every repetition, sorted."""
    shift = least_shift(problem)
    hours = np.mod(found.times, shift)
    order = np.argsort(hours, kind="stable")
    first = np.flatnonzero(np.append(True, np.diff(hours[order]) > _SAME * shift))
    weights = np.add.reduceat(found.weights[order], first)
    heavy = np.argsort(-weights, kind="stable")[:_HOURS]
    heavy = np.sort(heavy[weights[heavy] >= _WEIGHS * weights.max()])
    repeats = np.arange(round(problem.period / shift))[:, None] * shift
    wanted: Array = np.asarray((repeats + hours[order][first][heavy]).ravel(), dtype=np.float64)
    begins = problem.intervals[:, 0]
    near = begins[np.argmin(np.abs(wanted[:, None] - begins), axis=1)]
    wanted = np.where(np.abs(wanted - near) <= _SAME * shift, near, wanted)
    return np.unique(wanted[problem.mask(wanted).any(axis=-1)])


class HeatBath:
    """Schedules whose samples are drawn anew one by one over some `places`; `unit` is the sigma^2 that is hoped for."""

    def __init__(self, problem: DesignProblem, turning: TurningWindows, places: Array, unit: float) -> None:
        self.problem, self.turning, self.places, self.unit = problem, turning, places, unit
        self.early, self.late = self.rows(places)

    @property
    def steps(self) -> int:
        """Samples that a run draws anew."""
        _, q, n = self.early.shape
        return int(min(_SWEEPS * self.problem.samples, _WORK // (self.places.size * self.problem.samples * q * n**2)))

    def rows(self, times: Array) -> tuple[Array, Array]:
        """What samples at `times` show to windows that begin before them, and behind them, (m, q, n) each."""
        turned = times[:, None] + np.arange(self.turning.repeats + 1) * self.problem.period
        every, _ = self.turning.rows(turned, self.problem.mask(times)[:, None, :])
        shape = (times.size, -1, every.shape[-1])
        return every[:, :-1].reshape(shape), every[:, 1:].reshape(shape)

    def least_eigenvalues(self, others: Array, early: Array, late: Array, free: Index) -> Array:
        """(m, k) at most the least eigenvalue of each window, one more sample at each of the `free` places.

        The windows begin just before each of the `others` (k - 1 of them, sorted, with their rows), and before it.
        """
        n = early.shape[-1]
        squares, moved = _squares(early), _squares(late)
        W = np.concatenate([np.zeros((1, n, n)), np.cumsum(moved - squares, axis=0)]) + squares.sum(axis=0)
        least = float(np.linalg.eigvalsh(W)[:, 0].min()) - _BELOW * self.unit
        inverse = np.linalg.inv(W - least * np.eye(n))
        places, before_it, behind_it = self.places[free], self.early[free], self.late[free]
        behind = np.searchsorted(others, places)
        before = others[:, None] <= places
        X = np.where(before[:, :, None, None], before_it, behind_it)
        traces = np.concatenate([_traces(inverse[:-1], X), _traces(inverse[behind], before_it[:, None]).T])
        return np.asarray(least + 1 / traces.T)

    def room(self, others: Array) -> Mask:
        """Which of the places keep the spacing."""
        period = self.problem.period
        away = np.abs((self.places[:, None] - others + period / 2) % period - period / 2)
        return np.asarray(away.min(axis=1) >= self.problem.gap)

    def run(self, times: Array, rng: np.random.Generator, steps: int, budget: Budget = ENDLESS) -> list[Valued]:
        """The best few schedules of a number of steps from `times`, the best first, with about their sigma^2."""
        kept: list[Valued] = []
        early, late = self.rows(times)
        for step in range(steps):
            if budget.over:
                break
            rest = np.arange(times.size) != rng.integers(times.size)
            others = times[rest]
            free = np.flatnonzero(self.room(others))
            if not free.size:
                continue
            seen = self.least_eigenvalues(others, early[rest], late[rest], free) / self.unit
            least = seen.min(axis=1)
            soft = least - np.log(np.exp(-_SHARPNESS * (seen - least[:, None])).sum(axis=1)) / _SHARPNESS
            heat = _WARM * (_COOL / _WARM) ** (step / steps) / times.size
            odds = np.cumsum(np.exp((soft - soft.max()) / heat))
            drawn = int(np.searchsorted(odds, rng.uniform() * odds[-1], side="right"))
            place, value = free[drawn], float(least[drawn])
            at = int(np.searchsorted(others, self.places[place]))
            times = np.insert(others, at, self.places[place])
            early = np.insert(early[rest], at, self.early[place], axis=0)
            late = np.insert(late[rest], at, self.late[place], axis=0)
            alike = [known for known, _ in kept if abs(known - value) <= _ALIKE]
            if all(value > known for known in alike):
                kept = [one for one in kept if one[0] not in alike]
                kept = sorted([*kept, (value, times)], key=lambda one: -one[0])[:_KEPT]
        return kept


def _squares(rows: Array) -> Array:
    return np.asarray(np.swapaxes(rows, -1, -2) @ rows)


def _traces(inverse: Array, X: Array) -> Array:
    """(b, m) the trace of (A + X'X)^{-1}, `inverse` (b, n, n) that of A and X (b, m, q, n)."""
    Y = (X.reshape(X.shape[0], -1, X.shape[-1]) @ inverse).reshape(X.shape)
    traces = np.broadcast_to(np.trace(inverse, axis1=1, axis2=2)[:, None], X.shape[:2])
    for r in range(X.shape[2]):
        x, y = X[:, :, r], Y[:, :, r]
        grown = 1 + np.einsum("bmi,bmi->bm", x, y)
        traces = traces - np.einsum("bmi,bmi->bm", y, y) / grown
        mixed = np.einsum("bmsi,bmi->bms", X[:, :, r + 1 :], y) / grown[..., None]
        Y[:, :, r + 1 :] -= mixed[..., None] * y[:, :, None]
    return traces
