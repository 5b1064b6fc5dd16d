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
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.orthogonal_flow import OrthogonalFlowWindows, squares
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
_REMEMBERED = 2000  # schedules of all samples but one whose places are judged: memory for time
_LATELY = 16  # windows that were the worst lately, whose eigenvalues are found first
_TIED = 1e-12  # relative: another window may be worse than those by so much, far below what moves a draw
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
    if problem.orthogonal_flow is None or problem.samples < 2 or not 0 < found.value < np.inf:
        return []
    bath = HeatBath(problem, problem.orthogonal_flow, places(problem, found), found.value)
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
    shift = problem.least_shift
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

    def __init__(
        self, problem: DesignProblem, orthogonal_flow: OrthogonalFlowWindows, places: Array, unit: float
    ) -> None:
        self.problem, self.orthogonal_flow, self.places, self.unit = problem, orthogonal_flow, places, unit
        self.early, self.late = self.rows(places)
        # place by place, so that those of a few places are found quickly
        self._forms = np.stack([_products(self.early), _products(self.late)])
        self._lately: dict[float, None] = {}  # when they begin, the latest last
        self._upper = np.triu_indices(self.early.shape[-1])

    @property
    def steps(self) -> int:
        """Samples that a run draws anew."""
        _, q, n = self.early.shape
        return int(min(_SWEEPS * self.problem.samples, _WORK // (self.places.size * self.problem.samples * q * n**2)))

    def rows(self, times: Array) -> tuple[Array, Array]:
        """What samples at `times` show to windows that begin before them, and behind them, (m, q, n) each."""
        turned = times[:, None] + np.arange(self.orthogonal_flow.repeats + 1) * self.problem.period
        every = self.orthogonal_flow.rows(turned, self.problem.mask(times)[:, None, :])
        shape = (times.size, -1, every.shape[-1])
        return every[:, :-1].reshape(shape), every[:, 1:].reshape(shape)

    def least_eigenvalues(self, others: Array, early: Array, late: Array, free: Index) -> Array:
        """(free, k) at most the least eigenvalue of each window, one more sample at each of the `free` places.

        The windows begin just before each of the `others` (k - 1 of them, sorted, with the `squares` of their rows),
        and before it.
        """
        n, k = early.shape[-1], others.size
        W = np.empty((k + 1, n, n))
        W[0] = early.sum(axis=0)
        np.add(W[0], np.cumsum(late - early, axis=0), out=W[1:])
        least = self.least(others, W[:-1]) - _BELOW * self.unit
        inverse = np.linalg.inv(W - least * np.eye(n))
        both = np.concatenate([inverse, inverse @ inverse])[:, *self._upper]
        products = self._forms[:, :, free].reshape(-1, both.shape[1])
        forms = (both @ products.T).reshape(2, k + 1, 2, -1, free.size)
        before_it, behind_it = forms[:, :, 0], forms[:, :, 1]
        behind = np.searchsorted(others, self.places[free])
        forms = np.where(np.arange(k)[:, None, None] < behind, before_it[:, :-1], behind_it[:, :-1])
        own = before_it[:, behind, :, np.arange(free.size)].transpose(1, 2, 0)[:, None]
        traces = np.trace(inverse, axis1=1, axis2=2)
        before = np.concatenate([np.repeat(traces[:-1, None], free.size, axis=1), traces[behind][None]])
        return np.asarray(least + 1 / _traces(before, np.concatenate([forms, own], axis=1)).T)

    def least(self, others: Array, W: Array) -> float:
        """The least eigenvalue of windows W, which begin before each of the `others`: of all, mostly found in a few.

        Those that held it lately are looked at first; that no other window is below them, one factorisation of each
        says at a ninth of the price of their eigenvalues.
        """
        times = others.tolist()
        if lately := [j for j, t in enumerate(times) if t in self._lately]:
            found = float(np.linalg.eigvalsh(W[lately])[:, 0].min())
            try:
                np.linalg.cholesky(W - (found - _TIED * abs(found)) * np.eye(W.shape[-1]))
            except np.linalg.LinAlgError:
                pass
            else:
                return found
        values = np.linalg.eigvalsh(W)[:, 0]
        t = times[int(values.argmin())]
        self._lately.pop(t, None)
        self._lately[t] = None
        if len(self._lately) > _LATELY:
            del self._lately[next(iter(self._lately))]
        return float(values.min())

    def room(self, others: Array) -> Mask:
        """(k, m) which of the places keep the spacing from each."""
        period = self.problem.period
        away = np.abs((self.places - others[:, None] + period / 2) % period - period / 2)
        return np.asarray(away >= self.problem.gap)

    def judged(self, others: Array, early: Array, late: Array, free: Index) -> tuple[Index, Array, Array]:
        """The `free` places beside the others; the soft least of their windows, less that of the best; their least."""
        if not free.size:
            return free, np.zeros(0), np.zeros(0)
        eigenvalues = self.least_eigenvalues(others, early, late, free) / self.unit
        least = eigenvalues.min(axis=1)
        soft = least - np.log(np.exp(-_SHARPNESS * (eigenvalues - least[:, None])).sum(axis=1)) / _SHARPNESS
        return free, soft - soft.max(), least

    def run(self, times: Array, rng: np.random.Generator, steps: int, budget: Budget = ENDLESS) -> list[Valued]:
        """The best few schedules of a number of steps from `times`, the best first, with about their sigma^2."""
        kept: list[Valued] = []
        known = np.concatenate([times, self.places])  # what a schedule is chosen from, by its number
        rows = zip(self.rows(times), (self.early, self.late), strict=True)
        early, late = (squares(np.concatenate(pair)) for pair in rows)
        crowded, chosen = ~self.room(known), np.arange(times.size)
        # cooled down, the same sample goes out of the same schedule again and again
        judged: dict[bytes, tuple[Index, Array, Array]] = {}
        for step in range(steps):
            if budget.over:
                break
            rest = np.delete(chosen, rng.integers(times.size))
            key = rest.tobytes()
            if len(judged) > _REMEMBERED:
                judged.clear()
            if key not in judged:
                free = np.flatnonzero(~crowded[rest].any(axis=0))
                judged[key] = self.judged(known[rest], early[rest], late[rest], free)
            free, soft, least = judged[key]
            if not free.size:
                continue
            heat = _WARM * (_COOL / _WARM) ** (step / steps) / times.size
            odds = np.cumsum(np.exp(soft / heat))
            drawn = int(np.searchsorted(odds, rng.uniform() * odds[-1], side="right"))
            place, value = free[drawn], float(least[drawn])
            others = known[rest]
            at = int(np.searchsorted(others, self.places[place]))
            chosen = np.concatenate([rest[:at], [times.size + place], rest[at:]])
            alike = [one for one, _ in kept if abs(one - value) <= _ALIKE]
            if all(value > one for one in alike):
                kept = [one for one in kept if one[0] not in alike]
                kept = sorted([*kept, (value, known[chosen])], key=lambda one: -one[0])[:_KEPT]
        return kept


def _products(X: Array) -> Array:
    """What makes x'Mx of all pairs of rows of X (m, q, n) out of the upper triangle of M, (pairs, m, n (n + 1) / 2)."""
    _, q, n = X.shape
    i, j = np.triu_indices(n)
    r, s = np.triu_indices(q)
    mixed = X[:, r][..., i] * X[:, s][..., j] + X[:, s][..., i] * X[:, r][..., j]
    return np.ascontiguousarray((mixed * np.where(i == j, 0.5, 1.0)).transpose(1, 0, 2))


def _traces(traces: Array, forms: Array) -> Array:
    """(k, m) the trace of (A + X'X)^{-1}, given that of A^{-1} and forms (2, k, pairs, m).

    Those are x'A^{-1}x and x'A^{-2}x for all pairs of rows of X, which are eliminated one after the other.
    """
    q = (round((8 * forms.shape[2] + 1) ** 0.5) - 1) // 2
    pairs = [(r, s) for r in range(q) for s in range(r, q)]
    once, twice = ({pair: part[:, k] for k, pair in enumerate(pairs)} for part in forms)
    for r in range(q):
        grown = 1 + once[r, r]
        traces = traces - twice[r, r] / grown
        share = {s: once[r, s] / grown for s in range(r + 1, q)}
        for s, t in [pair for pair in pairs if pair[0] > r]:
            once[s, t] = once[s, t] - share[s] * once[r, t]
            mixed = share[s] * twice[r, t] + share[t] * twice[r, s]
            twice[s, t] = twice[s, t] - mixed + share[s] * share[t] * twice[r, r]
    return traces
