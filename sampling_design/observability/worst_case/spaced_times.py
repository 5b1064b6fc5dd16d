"""Proven lower bound of sigma over spaced schedules of few samples: branch and bound over their times.

As over the sphere the state z is taken at the first sample: a schedule is a start u and slacks 0 = v_1 <= ... <= v_k
<= S - u, and sigma^2 >= mu where G - mu N(u) is positive definite, G the sum of R_i'R_i over the samples' rows and
N(u) = (e^{-Au} L)'(e^{-Au} L). A cell is a window of each slack and one of the start. With c_i and d_i the centre and
the half-width of a window, R(c_i + s) differs from R_i by no more than

    v_i = d_i |R_i' z| + d_i^2/2 |R_i'' z| + d_i^3/6 sup |R'''| |z|,

and (|R_i z| - v_i)_+^2 >= (1 - k_i) |R_i z|^2 - (1/k_i - 1) v_i^2 for every 0 < k_i <= 1, v_i^2 <= sum of its terms
squared over shares q_ij that add up to 1. So one matrix M lies below G in the whole cell, and one factorisation decides
it for all states at once. A sample whose window is too wide has k_i = 1 and is left out: it costs nothing until enough
others have come near to where they are. Any k_i and q_ij prove; those of the saddle point are sought in a few turns.
N(u) <= |e^{-A(u - c)}|^2 N(c) in the window of starts.

Directions take 2^{n-1} corners and cells in n - 1 dimensions, times k dimensions and one matrix: where samples are few
that is far less, since what is small in z is small because of a few times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_search import AttainedSchedule, polish, worst_of
from sampling_design.observability.worst_case.spaced_sphere import SphereBounds
from sampling_design.observability.worst_case.spaced_tables import SphereTables
from sampling_design.records.arrays import Array, Integers, Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.declarations import below

_EPS = float(np.finfo(float).eps)
_TINY = 1e-300  # added to sizes that are divided by and may be 0: factors of any size prove
_FINEST = 4096  # cells of the finest grid of slacks
_FEWEST_STATES = 5  # below, cells of directions are few
_MOST_SAMPLES = 12  # beyond, times are too many
_LEAST_SPACING = 1 / 64  # of the slack: clusters that are narrower need a finer grid than this
_STAGES = (0.25, 1.0)  # of the wanted sigma: a search that is cut short has proven something
_BATCH = 400_000  # numbers per batch of matrices
_MOST_CELLS = 2_000_000  # open at once
_TURNS = 10  # towards the best factors
_FARTHER = 0.3  # how much counts what a window moves beside what it takes
_CENTRAL = 0.06  # of the spread of eigenvalues, at first: how far from the weakest direction the factors look
_LONGEST = 1e100  # stands for what overflows: such a sample is left out
_STRETCHED = 1e12  # the most by which N may grow within a window of starts that proves anything
_BETWEEN = 64  # parts of a finest cell at which the growth within it is looked at


class TimeWindows(NamedTuple):
    """Windows of slacks and starts, in points of the finest grid, and which share of all schedules they stand for."""

    first: Integers  # (m, k)
    last: Integers  # (m, k)
    earliest: Integers  # (m,) starts
    latest: Integers  # (m,)
    share: Array  # (m,)

    def take(self, index: Integers | Mask) -> TimeWindows:
        """The cells at `index`."""
        return TimeWindows._make(a[index] for a in self)


def has_few_times(rows: SpacedRows) -> bool:
    """Whether there are few samples for the states, on time, and not too near to each other for a grid of times."""
    near = rows.spacing < _LEAST_SPACING * rows.slack
    return rows.n >= _FEWEST_STATES and rows.count <= _MOST_SAMPLES and not rows.moving and not near


def prove_by_times(
    rows: SpacedRows, found: AttainedSchedule, rtol: float, seconds: float, progress: Progress | None = None
) -> SphereBounds | None:
    """Prove a lower bound of sigma that lies within `rtol` below the attained one, or as near as time allows.

    None where states cannot be carried from the first sample back to the window's start.
    """
    tables = SphereTables(rows, found.slacks, rtol / 100, found.moves)
    inner = rows.within(tables.inverse) if tables.pulled else None
    if inner is None:
        return None
    return _TimeSearch(rows, _CellBounds(rows, *inner, tables.forgiven), found, rtol).run(Budget(seconds), progress)


class _TimeSearch:
    """Cells of times stage by stage: what is proven at one is looked at again at the next."""

    def __init__(self, rows: SpacedRows, bounds: _CellBounds, found: AttainedSchedule, rtol: float) -> None:
        self.rows, self.best, self.rtol, self.bounds = rows, found, rtol, bounds
        zero: Integers = np.zeros((1, rows.count), dtype=np.int32)
        last: Integers = zero + np.int32(_FINEST)
        last[:, 0] = 0  # the first sample is where the state is taken
        whole = TimeWindows(zero, last, zero[:, 0], zero[:, 0] + np.int32(_FINEST), np.ones(1))
        self.open, self.proven = [whole], list[TimeWindows]()
        self.stage, self.settled, self.cells = 0, 0.0, 0
        self.size = max(1, _BATCH // (rows.count * rows.n**2))

    @property
    def wanted(self) -> float:
        """Lambda that all cells are to have in the end."""
        return float((self.best.sigma * (1 - 0.99 * self.rtol)) ** 2)

    @property
    def lower(self) -> float:
        """Sigma proven so far: that of the last stage that all cells have passed."""
        passed = _STAGES[self.stage - 1] if self.stage else 0.0
        return float(passed * np.sqrt(self.wanted * (1 - self.bounds.forgiven)))

    def run(self, budget: Budget, progress: Progress | None) -> SphereBounds:
        """Work on the cells until all have passed all stages, or the budget is spent, or rounding decides."""
        status = ""
        try:
            while self.stage < len(_STAGES) and not status:
                status = self._stepped(budget, progress)
        except KeyboardInterrupt:
            status = "interrupted"
        return SphereBounds(self.lower, self.best, status or "closed", self.cells)

    def _stepped(self, budget: Budget, progress: Progress | None) -> str:
        """One batch: why the search ends, or nothing."""
        if budget.over or sum(len(part.share) for part in self.open + self.proven) > _MOST_CELLS:
            return "budget"
        cells, better = self._taken(), None
        if len(cells.share):
            self.cells += len(cells.share)
            mu = _STAGES[self.stage] ** 2 * self.wanted
            done, sure, moved, stretched = self.bounds.of(cells, mu, self.wanted)
            self.proven.append(cells.take(done & ~sure))
            self.settled += float(np.sum(cells.share[done]))
            cells, moved, stretched = cells.take(~done), moved[~done], stretched[~done]
            if len(cells.share):
                better = self._improved(cells)
                if not self._cut(cells, moved, stretched):
                    return "rounding"
        if progress is not None:
            share = (self.stage + min(self.settled, 1.0)) / len(_STAGES)
            left = sum(len(part.share) for part in self.open)
            progress(share, f"worst case sigma: {left} cells open, at least {below(self.lower)}")
        if not self.open:
            self.open, self.proven, self.stage, self.settled = self.proven, [], self.stage + 1, 0.0
        return "rounding" if better and self.rows.counts_as_zero(better.sigma, better.slacks, better.moves) else ""

    def _taken(self) -> TimeWindows:
        """A batch of the cells that came last, without starts that leave the last sample no room."""
        parts, many = [], 0
        while self.open and many < self.size:
            part = self.open.pop()
            over = many + len(part.share) - self.size
            if over > 0:
                self.open.append(part.take(np.arange(over)))
                part = part.take(np.arange(over, len(part.share)))
            parts.append(part)
            many += len(part.share)
        cells = TimeWindows._make(np.concatenate(column) for column in zip(*parts, strict=True))
        cells = cells._replace(latest=np.minimum(cells.latest, _FINEST - cells.first[:, -1]))
        fits = cells.latest >= cells.earliest
        self.settled += float(np.sum(cells.share[~fits]))
        return cells.take(fits)

    def _improved(self, cells: TimeWindows) -> AttainedSchedule | None:
        """Follow the centre of the narrowest cell if it beats the attained schedule; None if it does not."""
        narrowest = int(np.argmin(np.sum(cells.last - cells.first, axis=1)))
        slacks = self.bounds.slacks[(cells.first[narrowest] + cells.last[narrowest]) // 2]
        start = self.bounds.slacks[cells.earliest[narrowest]]
        here = worst_of(self.rows, np.minimum(slacks + start, self.rows.slack)[None])
        if here.sigma >= self.best.sigma * (1 - 1e-9):
            return None
        better = polish(self.rows, here.slacks, here.moves, self.rows.slack / _FINEST)
        self.best = min(here, better, key=lambda a: a.sigma)
        return self.best

    def _cut(self, cells: TimeWindows, moved: Array, stretched: Array) -> bool:
        """Halve in each cell the window that takes most; False where one is too narrow to be cut."""
        row = np.arange(len(cells.share))
        moved = np.where(cells.last - cells.first >= 2, moved, -1.0)
        stretched = np.where(cells.latest - cells.earliest >= 2, stretched, -1.0)
        which = np.argmax(moved, axis=1)
        early = stretched > moved[row, which] ** 2 * np.sign(moved[row, which])
        if np.any(~early & (moved[row, which] < 0)):
            return False
        cells = cells._replace(share=cells.share / 2)
        part = cells.take(early)
        middle = (part.earliest + part.latest) // 2
        self.open += [part._replace(latest=middle), part._replace(earliest=middle)]
        part, at = cells.take(~early), which[~early, None]
        ends = (np.take_along_axis(end, at, axis=1) for end in (part.first, part.last))
        middle, sample = np.add(*ends) // 2, np.arange(self.rows.count)
        # slacks are in order: what one window loses its neighbours lose too
        sooner = part._replace(last=np.where(sample <= at, np.minimum(part.last, middle), part.last))
        later = part._replace(first=np.where(sample >= at, np.maximum(part.first, middle), part.first))
        self.open = [cells for cells in [*self.open, sooner, later] if len(cells.share)]
        return True


class _CellBounds:
    """Rows with three derivatives at points of the finest grid, and what lies below G in cells of times.

    Points are worked out when a cell asks for them first: of many states all of them take longer than many a budget.
    """

    def __init__(self, rows: SpacedRows, inner: SpacedRows, basis: Array, forgiven: float) -> None:
        self.forgiven, self.count, self.n, self.wide = forgiven, rows.count, rows.n, rows.slack / _FINEST
        self.slacks, self.inner, self.basis = rows.slack * np.arange(_FINEST + 1) / _FINEST, inner, basis
        self.growth = float(np.abs(np.linalg.eigvalsh((inner.A + inner.A.T) / 2)).max(initial=0.0)) * (1 + 1e-9)
        self.rounding = 16 * (rows.count + rows.n + rows.p) ** 1.5 * _EPS
        self.times = rows.times(self.slacks[:, None]).T
        self.rows = [np.empty((*self.times.shape, rows.p, rows.n)) for _ in range(3)]
        self.third, *self.astray = (np.empty(self.times.shape) for _ in range(4))
        self.norm, self.lost = np.empty((_FINEST + 1, rows.n, rows.n)), np.empty(_FINEST + 1)
        self.filled, self.filled_starts = np.zeros(self.times.shape, dtype=bool), np.zeros(_FINEST + 1, dtype=bool)
        self.stretch = self._stretches(rows)

    def _fill(self, at: Integers, start: Integers) -> None:
        """Work out what is new of points `at` (m, k) of samples, and of those at which windows `start` (m,)."""
        asked, begin = np.zeros_like(self.filled), np.zeros_like(self.filled_starts)
        asked[np.arange(self.count), at], begin[start] = True, True
        new, begin = np.nonzero(asked & ~self.filled), begin & ~self.filled_starts
        self.filled[new], self.filled_starts[begin] = True, True
        flow = self.inner.plant.transition(self.times[new])
        values, astray, rate = self.inner.C @ flow, self.inner.blur(flow), 2 * float(np.linalg.norm(self.inner.A))
        for j in range(3):
            self.rows[j][new], self.astray[j][new] = values, astray * rate**j
            values = values @ self.inner.A
        self.third[new] = np.linalg.norm(values, axis=(1, 2)) * (1 + 1e-9)
        back = self.inner.plant.transition(-self.slacks[begin])
        state = self.basis @ back
        self.norm[begin] = np.swapaxes(state, 1, 2) @ state
        summed, length = (np.linalg.norm(part, axis=(1, 2)) for part in (np.abs(self.basis) @ np.abs(back), state))
        self.lost[begin] = 3 * self.inner.grade * summed * length + self.rounding * length**2

    def _stretches(self, rows: SpacedRows) -> Array:
        """At least |e^{As}|^2 for all |s| up to each point of the grid's first half: no window reaches farther."""
        away = self.slacks[: _FINEST // 2 + 1]
        parts = self.wide * np.arange(_BETWEEN + 1) / _BETWEEN
        rate = float(np.abs(np.linalg.eigvalsh((rows.A + rows.A.T) / 2)).max(initial=0.0))
        with np.errstate(over="ignore"):
            most = max(np.linalg.norm(rows.plant.transition(s * parts), 2, axis=(1, 2)).max() for s in (1.0, -1.0))
            between = float(most) * np.exp(rate * self.wide / (2 * _BETWEEN))
            there, back = (np.linalg.norm(rows.plant.transition(s * away), 2, axis=(1, 2)) for s in (1.0, -1.0))
            found = (np.maximum.accumulate(np.maximum(there, back)) * between * (1 + 1e-9)) ** 2
        found[0] = 1.0
        return np.asarray(found)

    def of(self, cells: TimeWindows, mu: float, enough: float) -> tuple[Mask, Mask, Array, Array]:
        """Which cells have sigma^2 >= mu, and >= enough; what each window of slacks moves (m, k), and of starts (m,).

        The last two in the states that the cell sees least: a length, and a square of one.
        """
        at, half = (cells.first + cells.last) // 2, (cells.last - cells.first + 1) // 2 * self.wide
        sample, away = np.arange(self.count), (cells.latest - cells.earliest + 1) // 2
        start, stretch = (cells.earliest + cells.latest) // 2, self.stretch[away]
        self._fill(at, start)
        whole = stretch < _STRETCHED
        stretch = np.minimum(stretch, _STRETCHED)
        norm = (mu * stretch)[:, None, None] * (self.norm[start] + self.lost[start][:, None, None] * np.eye(self.n))
        astray = [part[sample, at] for part in self.astray]
        reach = (np.ones_like(half), half, half**2 / 2)
        rows = np.stack([r[sample, at] * d[..., None, None] for r, d in zip(self.rows, reach, strict=True)], axis=1)
        with np.errstate(over="ignore"):
            beyond = half**3 / 6 * self.third[sample, at] * np.exp(self.growth * half)
        beyond = np.minimum(beyond + half * astray[1] + half**2 / 2 * astray[2], _LONGEST)
        lost = 2 * astray[0] ** 2 / self.forgiven / (1 - self.forgiven)
        forms = _CellForms.of(rows, beyond, lost, norm)
        done, sure, states = self._decided(forms, enough / mu)
        observed, turned, bent = forms.sizes(states)
        moved = turned + bent + beyond * forms.length(states)
        gained = np.where(moved < observed, moved * (2 * observed - moved), observed**2)
        moved = np.sqrt(gained) + _FARTHER * moved
        return done & whole, sure & whole, moved, (1 - 1 / stretch) * np.sum(forms.needed * states, axis=(1, 2))

    def _decided(self, forms: _CellForms, more: float) -> tuple[Mask, Mask, Array]:
        """In which cells some M - mu N is positive definite, and M - more mu N; the states (m, n, n) each sees least.

        No factors prove anything where these states by themselves see less: such a cell needs no further turns.
        """
        done, states = np.zeros((2, len(forms.norm)), dtype=bool), forms.states.copy()
        left: Integers = np.arange(len(forms.norm))
        mean, last = np.zeros((len(left), *forms.rows.shape[1:3])), np.zeros(len(left))
        for turn in range(_TURNS):
            factors, least, worth = self._factors(forms)
            step = 2 / (turn + 2)  # the last of them counts most
            mean, last = mean + step * (factors - mean), last + step * (least - last)
            level, axes = np.linalg.eigh(forms.above(mean, last))
            away = level - level[:, :1] + _CENTRAL / (turn + 1) * (level[:, -1:] - level[:, :1]) + _TINY
            forms = forms._replace(states=(axes / away[:, None, :]) @ np.swapaxes(axes, 1, 2))
            states[left] = forms.states
            good = np.flatnonzero(level[:, 0] > 0)
            for which, times in enumerate((1.0, more)):
                done[which, left[good]] = self._is_above(forms.take(good), mean[good], last[good], times)
            on = ~done[0, left] & (worth >= 0 if turn else True)
            left, mean, last, forms = left[on], mean[on], last[on], forms.take(on)
            if not left.size:
                break
        return done[0], done[1], states

    def _is_above(self, forms: _CellForms, factors: Array, last: Array, times: float) -> Mask:
        """Where M - times mu N is positive definite, in the rows as they are, by more than rounding."""
        sizes = np.sum(forms.rows**2, axis=(3, 4))
        rough = np.sum(np.abs(factors) * sizes, axis=(1, 2)) + last + times * _traces(forms.norm)
        found = _sum_of_squares(forms.rows, factors) - last[:, None, None] * np.eye(self.n) - times * forms.norm
        return np.asarray(np.linalg.eigvalsh(found)[:, 0] > self.rounding * rough)

    def _factors(self, forms: _CellForms) -> tuple[Array, Array, Array]:
        """Factors (m, 3, k) of the squares in a matrix M below G, what it lacks of I, and its worth in the states."""
        (u, *v), beyond = forms.sizes(forms.states), forms.beyond
        v.append(beyond * forms.length(forms.states))
        total = v[0] + v[1] + v[2] + _TINY
        part = np.clip(total / np.maximum(u, _TINY), 1e-12, 1.0)
        taken = (1 / part - 1) * total / (1 - self.forgiven)
        kept, *less = 1 - part, *(taken / np.maximum(each, _TINY) for each in v)
        last = np.sum(less[2] * beyond**2 + kept * forms.lost, axis=1)
        worth = np.sum(np.maximum(u - total, 0.0) ** 2, axis=1) - np.sum(forms.needed * forms.states, axis=(1, 2))
        return np.stack([kept, -less[0], -less[1]], axis=1), last, worth


class _CellForms(NamedTuple):
    """Rows of each cell: at its centre, and how they turn and bend; and what their squares are compared with.

    rows : (m, 3, k, p, n) array
        R, d R' and (d^2/2) R''.
    beyond, lost : (m, k) arrays
        What more R may move, |z| = 1, and what rounding takes from |Rz|^2.
    norm : (m, n, n) array
        mu N with all that it may grow.
    turned, needed, unit, states : arrays
        In the coordinates Wz where G + mu N is I, about: the rows (m, 3 k p, n), mu N and I (m, n, n), and the states
        X >= 0 (m, n, n) that are seen least.
    """

    rows: Array
    beyond: Array
    lost: Array
    norm: Array
    turned: Array
    needed: Array
    unit: Array
    states: Array

    @classmethod
    def of(cls, rows: Array, beyond: Array, lost: Array, norm: Array) -> _CellForms:
        """At first all states count, each as much as it is seen."""
        m, n = norm.shape[:2]
        centre = rows[:, 0].reshape(m, -1, n)
        whole = np.swapaxes(centre, 1, 2) @ centre + norm
        root = np.linalg.cholesky(whole + (1e-9 / n * _traces(whole))[:, None, None] * np.eye(n))
        white = np.linalg.solve(root, np.broadcast_to(np.eye(n), whole.shape))
        back = np.swapaxes(white, 1, 2)
        states = np.broadcast_to(np.eye(n), whole.shape)
        return cls(rows, beyond, lost, norm, rows.reshape(m, -1, n) @ back, white @ norm @ back, white @ back, states)

    def sizes(self, states: Array) -> Array:
        """The root of <R'R, X> for each kind of row and sample, (3, m, k)."""
        squares = np.einsum("mij,mij->mi", self.turned @ states, self.turned).reshape(self.rows.shape[:4])
        return np.asarray(np.sqrt(np.maximum(squares.sum(axis=3), 0.0)).swapaxes(0, 1))

    def length(self, states: Array) -> Array:
        """The root of the states' trace, (m, 1)."""
        return np.asarray(np.sqrt(np.einsum("mij,mij->m", self.unit, states)))[:, None]

    def above(self, factors: Array, last: Array) -> Array:
        """M - mu N in the coordinates Wz."""
        turned = self.turned.reshape(self.rows.shape)
        return np.asarray(_sum_of_squares(turned, factors) - last[:, None, None] * self.unit - self.needed)

    def take(self, index: Integers | Mask) -> _CellForms:
        """The cells at `index`."""
        return _CellForms._make(a[index] for a in self)


def _sum_of_squares(rows: Array, factors: Array) -> Array:
    """The sum of f R'R over rows (m, 3, k, p, n) and their factors (m, 3, k)."""
    flat = (len(rows), int(np.prod(rows.shape[1:-1])), rows.shape[-1])
    return np.asarray(np.swapaxes((factors[..., None, None] * rows).reshape(flat), 1, 2) @ rows.reshape(flat))


def _traces(matrices: Array) -> Array:
    """The trace of each matrix, (m,)."""
    return np.asarray(np.trace(matrices, axis1=1, axis2=2))
