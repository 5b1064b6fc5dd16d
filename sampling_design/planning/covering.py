"""Every trajectory must be seen: the cheapest choice of samples that sees a set of them, and bounds on its price.

    minimise  price'z + visit'n   subject to  sum of z over what sees trajectory a >= 1 (or >= n at its own sample),
              spacings, uses, limits,  z <= n <= sum of z,  entries 0 or 1

Whatever a solver says, y >= 0 prove  cost >= b'y + sum over k of min((c - A'y)_k x_k over what x_k may be).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy import sparse

from sampling_design.planning.hidden_trajectories import HiddenTrajectories, HiddenTrajectory
from sampling_design.planning.problem import PlanProblem
from sampling_design.planning.search_progress import COVER, NODE, RELAXED
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import Budget

Key: TypeAlias = tuple[int, int]

NODES = 400  # nodes of the solver's tree when a choice is sought

ENTRIES, FEWEST = 4_000_000, 40
"""Entries that a tree goes through: nodes of a large program are fewer, but so many at least."""

ROUNDING = 1e-9  # relative allowance for rounding in what multipliers prove
NEAR = 5e-4  # a choice is cheap enough within this share; how many trajectories it sees decides no finer
OPEN_ROW = 1e3
"""Price of a row left open, in units of the dearest variable's, or that of all of them and one more: what has no choice
becomes this dear, which is above every limit."""
TIE = 1e-9  # costs are equal within this share
SMALLER = 16  # times as many beginnings are looked at, at most
MOST_CHOICES = 20_000  # beginnings of one length, and choices, that are judged one by one
GRAIN = 1e-6  # costs are whole multiples of a grain within this share of it


@dataclass(frozen=True, eq=False)
class CoveringProgram:
    """Variables: the samples n_i of every allowed step, then its measurements z_ij (left out if they are whole)."""

    c: Array  # (k,)
    A: sparse.csr_matrix  # all rows as A x >= b
    b: Array  # (m,)

    @property
    def unit(self) -> float:
        """A power of two near the least price: a solver's tolerances are absolute, and prices have any unit."""
        return float(2.0 ** np.floor(np.log2(np.min(self.c[self.c > 0], initial=np.inf)))) if self.c.any() else 1.0


class SampleChoices(NamedTuple):
    """What one sample may measure: what is free in any case. By steps."""

    at: Index  # (R,)
    measured: Mask  # (R, p)
    cost: Array  # (R,)
    more: Array  # (R,): the least price of what it leaves out; infinite where that is nothing

    def joins(self, taken: Index, further: bool) -> Array:
        """The least cost of what may join each of these choices (B, k), a further sample or measurement."""
        least, found = np.unique(self.at), self.more[taken].min(axis=1)
        cost = np.minimum.reduceat(self.cost, np.searchsorted(self.at, least))
        for place in np.argsort(cost, kind="stable")[: taken.shape[1] + 1 if further else 0]:
            unused = np.all(self.at[taken] != least[place], axis=1)
            found = np.where(unused, np.minimum(found, cost[place]), found)
        return np.asarray(found)


class TrajectoryRows(NamedTuple):
    """Rows of trajectories, each at an end: one of the variables that a row shows is asked for.

    Where a row has an owner, the sample that ends its trajectory, it asks only if that is taken.
    """

    keys: list[Key]
    shows: Mask  # (R, k)
    owner: Index  # (R,): k where a row asks in any case

    def undominated(self) -> list[Key]:
        """The keys of rows that no other row implies, by showing less, or the first of those that are alike."""
        owned = np.identity(self.shows.shape[1] + 1, dtype=bool)[self.owner, :-1]
        literals, first = np.unique(np.hstack([self.shows, owned]), axis=0, return_index=True)
        size, kept = literals.sum(axis=1), np.zeros(len(literals), dtype=bool)
        for each in np.unique(size):
            mine, less = np.flatnonzero(size == each), np.flatnonzero(kept)
            common = literals[less].astype(np.float32) @ literals[mine].T.astype(np.float32)
            kept[mine] = np.all(common < size[less][:, None], axis=0)
        return [self.keys[k] for k in np.sort(first[kept]).tolist()]


class CoveringRows:
    """The rows that hold for every choice of a problem, and those of trajectories."""

    def __init__(self, problem: PlanProblem, *, fixed: bool = False):
        self.problem, self.fixed = problem, fixed
        self.at = np.flatnonzero(problem.allowed.any(axis=1))
        self.used = np.flatnonzero(problem.allowed.any(axis=0))
        self.whole = _is_whole(problem)
        place = -np.ones(problem.allowed.shape, dtype=int)
        if self.whole:
            place[np.ix_(self.at, self.used)] = np.arange(self.at.size)[:, None]
        else:
            place[problem.allowed] = self.at.size + np.arange(int(problem.allowed.sum()))
        self.place = place
        self.sample_of = -np.ones(problem.steps, dtype=int)
        self.sample_of[self.at] = np.arange(self.at.size)
        self.columns = self.at.size + (0 if self.whole else int(problem.allowed.sum()))

    @cached_property
    def cost(self) -> Array:
        """Price of every variable; the number of samples where nothing has a price."""
        problem, c = self.problem, np.zeros(self.columns)
        c[: self.at.size] = 1.0 if problem.counts else problem.visit
        if self.whole:
            c[: self.at.size] += problem.price[self.used].sum()
        else:
            _, sensor = np.nonzero(problem.allowed)
            c[self.at.size :] = problem.price[sensor]
        return c

    @cached_property
    def counts(self) -> Array:
        """One for every sample."""
        return np.concatenate([np.ones(self.at.size), np.zeros(self.columns - self.at.size)])

    @cached_property
    def grain(self) -> float:
        """Every cost is a whole multiple of this; 0 where there is no such number."""
        prices = self.cost[self.cost > 0]
        if not prices.size:
            return 0.0
        unit = float(prices.min())
        for divisor in range(1, 101):
            ratio = prices * divisor / unit
            if np.all(np.abs(ratio - np.round(ratio)) <= GRAIN):
                return unit / divisor
        return 0.0

    def ceiling(self, below: float) -> Array:
        """What each variable may be where a choice costs less than this, and may be turned so that it suits us.

        So few samples leave a gap that is as long as their mean at least: turned, it follows the sample at step 0.
        """
        high, problem = np.ones(self.columns), self.problem
        each = 1.0 if problem.counts else problem.visit + float(problem.price.min())
        if not self.fixed or each <= 0:
            return high
        most = min(np.ceil(below / each * (1 - 1e-9)) - 1, problem.most_samples, problem.steps)
        if most >= 1:
            high[1 : -int(-problem.steps // most)] = 0.0
        return high

    def lifted(self, bound: float) -> float:
        """A bound on the cost, raised to the next cost that there can be."""
        if self.grain <= 0 or not np.isfinite(bound):
            return bound
        return float(np.ceil(bound / self.grain - GRAIN) * self.grain)

    def most_samples(self, below: float) -> int:
        """Samples of a choice below a cost and within the limits, at most; -1 where more than their number counts."""
        problem, cost, (A, b) = self.problem, self.cost, self.frame
        plain = problem.spacing <= 1 and bool(np.all(problem.sensor_spacing[self.used] <= 1))
        plain = plain and bool(np.all(problem.longest_use[self.used] >= problem.steps))
        if not (plain and self.whole and cost[0] > 0 and np.all(cost == cost[0])):
            return -1
        fewer = [np.ceil(below / float(cost[0]) * (1 - TIE)) - 1] if np.isfinite(below) else []
        fewer += [np.floor(b[row] / A[row, 0] * (1 + TIE)) for row in self.limits]
        return int(min(fewer)) if fewer else -1

    @cached_property
    def repeats_after(self) -> int:
        """Steps after which what is allowed, and asked for, repeats: a choice may be shifted by them."""
        problem = self.problem
        asked = [problem.allowed, *(problem.ends(g)[:, None] for g in range(len(problem.goals)))]
        return next(
            s for s in range(1, problem.steps + 1) if all(np.array_equal(np.roll(a, s, axis=0), a) for a in asked)
        )

    @cached_property
    def readings(self) -> SampleChoices | None:
        """What a sample may measure at each step, and its cost; None where that is too much to be looked at."""
        problem, visit = self.problem, 1.0 if self.problem.counts else self.problem.visit
        if self.at.size * 2.0**self.used.size > MOST_CHOICES:
            return None
        found = list[tuple[int, Mask, float, float]]()
        for step in self.at.tolist():
            allowed = problem.allowed[step]
            priced = np.flatnonzero(allowed & (problem.price > 0))
            for taken in product((False, True), repeat=priced.size):
                mask = allowed & (problem.price == 0)
                mask[priced] = taken
                if mask.any():
                    more = float(problem.price[allowed & ~mask].min(initial=np.inf))
                    found.append((step, mask, visit + float(problem.price @ mask), more))
        at, measured, cost, joins = zip(*found, strict=True)
        return SampleChoices(np.array(at), np.array(measured), np.array(cost), np.array(joins))

    @property
    def dearest(self) -> float:
        """Every admissible choice costs less than this."""
        return self.beyond(min(self.problem.most_cost, float(self.cost.sum())))

    def beyond(self, limit: float) -> float:
        """A cost just above a limit, by the next one that there can be, or by a little of the limit or of a price."""
        return limit + (self.grain or GRAIN * (limit or float(self.cost.max())))

    @cached_property
    def frame(self) -> tuple[sparse.csr_matrix, Array]:
        """Rows of every admissible choice: A x >= b."""
        problem = self.problem
        rows: list[tuple[Index, Array, float]] = []
        if not self.whole:
            for i, step in enumerate(self.at.tolist()):
                mine = self.place[step][problem.allowed[step]]
                rows.append((np.append(mine, i), np.append(np.ones(mine.size), -1.0), 0.0))
                rows += [(np.array([i, z]), np.array([1.0, -1.0]), 0.0) for z in mine]
        rows += self._spaced(self.sample_of, problem.spacing)
        for j, (least, most) in enumerate(zip(problem.sensor_spacing, problem.longest_use, strict=True)):
            rows += self._spaced(self.place[:, j], int(least))
            mine = self.place[:, j][self.place[:, j] >= 0]
            if most < mine.size:
                rows.append((mine, -np.ones(mine.size), -float(most)))
        if np.isfinite(problem.most_samples):
            rows.append((np.arange(self.at.size), -np.ones(self.at.size), -problem.most_samples))
        if np.isfinite(problem.most_cost):
            unit = problem.most_cost or float(self.cost.max())  # a solver's tolerances are absolute
            rows.append((np.arange(self.columns), -self.cost / unit, -problem.most_cost / unit))
        if self.fixed:
            rows.append((np.array([0]), np.ones(1), 1.0))
        else:  # a plan has a sample, even where no trajectory asks for one
            rows.append((np.arange(self.at.size), np.ones(self.at.size), 1.0))
        return _stacked(rows, self.columns)

    @property
    def limits(self) -> list[int]:
        """Rows of the frame that limit the number of samples and the cost: behind all others but the last."""
        count = sum(map(np.isfinite, (self.problem.most_samples, self.problem.most_cost)))
        last = int(self.frame[0].shape[0]) - 1
        return list(range(last - count, last))

    def _spaced(self, place: Index, least: int) -> list[tuple[Index, Array, float]]:
        """At most one in every stretch of so many steps."""
        steps, rows = self.problem.steps, []
        if least <= 1:
            return []
        before: tuple[int, ...] = ()
        for start in range(steps):
            mine = place[(start + np.arange(min(least, steps))) % steps]
            mine = mine[mine >= 0]
            if mine.size > 1 and not set(mine.tolist()) <= set(before):
                rows.append((mine, -np.ones(mine.size), -1.0))
                before = tuple(mine.tolist())
        return rows

    @property
    def places(self) -> Index:
        """The variable of each step and sensor, or of each step's sample (M, 1) where samples are whole; -1: none."""
        return self.place[:, self.used[:1]] if self.whole else self.place

    def coverage(self, x: Array) -> Array:
        """How much of each step and sensor, or of each step's sample, a point of the program measures."""
        return np.where(self.places >= 0, x[self.places], 0.0)

    def measured(self, x: Array) -> Array:
        """The fractions (M, p) of measurements of a point of the program."""
        return np.clip(np.where(self.place >= 0, x[self.place], 0.0), 0.0, 1.0)

    def view(self, trajectory: HiddenTrajectory, level: float) -> Array:
        """What measuring at each step back from the end adds, by sensors or, where samples are whole, by samples."""
        weights = trajectory.weights(level)
        return np.minimum(weights[:, self.used].sum(axis=1, keepdims=True), 1.0) if self.whole else weights

    def sizes(self, trajectory: HiddenTrajectory, ends: Index, level: float) -> Index:
        """How many of the measurements that may be taken see a trajectory turned to each of these ends."""
        shows = self.view(trajectory, level) > 0
        there = self.places[self.at] >= 0
        return np.asarray(np.sum(shows[(ends[:, None] - self.at) % self.problem.steps] & there, axis=(1, 2)))

    def trajectory_rows(self, pool: HiddenTrajectories, level: float) -> TrajectoryRows:
        """The rows of all trajectories of a pool that reach a level, at all their ends; none of a tangent."""
        keys, shows, owners = list[Key](), [np.zeros((0, self.columns), dtype=bool)], [np.zeros(0, dtype=np.intp)]
        step, which = np.nonzero(self.places >= 0)
        for a, trajectory in enumerate(pool.trajectories):
            if trajectory.reach < level or trajectory.response is None:
                continue
            ends = np.flatnonzero(pool.ends[trajectory.goal])
            mine = np.zeros((ends.size, self.columns), dtype=bool)
            seen = self.view(trajectory, level) > 0
            mine[:, self.places[step, which]] = seen[(ends[:, None] - step) % self.problem.steps, which]
            owner = np.full(ends.size, self.columns)
            if trajectory.at_sample:  # asked for only where its end is a sample, which does not see it itself
                owner = self.sample_of[ends]
                asks = (owner >= 0) & ~mine[np.arange(ends.size), owner]
                ends, mine, owner = ends[asks], mine[asks], owner[asks]
            keys += [(a, end) for end in ends.tolist()]
            shows.append(mine)
            owners.append(owner)
        return TrajectoryRows(keys, np.concatenate(shows), np.concatenate(owners))

    def rows(self, trajectory: HiddenTrajectory, end: int, level: float) -> list[tuple[Index, Array, float]]:
        """The row that asks for a trajectory, turned to `end` and scaled to `level`, to be seen; that for its samples.

            sum over i, j of w_ij z_ij >= 1,      sum over i of min(1, sum over j of w_ij) n_i >= 1

        The second follows where n_i >= z_ij are 0 or 1, not of fractions: a sensor that is read by half then
        pays for half a visit. Where samples are whole there is no other one than the first.
        """
        weights = trajectory.weights(level)[(end - self.at) % self.problem.steps] * self.problem.allowed[self.at]
        own = int(self.sample_of[end]) if trajectory.at_sample else -1
        each = np.minimum(weights[:, self.used].sum(axis=1), 1.0)
        sensors = np.append(np.zeros(self.at.size), weights[self.problem.allowed[self.at]])
        rows = [each] if self.whole else [sensors, each]
        if trajectory.at_sample:  # only asked for where it is a sample's own
            for values in rows:
                values[own] -= 1.0
            rows = [values if own >= 0 and values[own] < 0 else np.zeros(0) for values in rows]
        places = map(np.flatnonzero, rows)
        right = 0.0 if trajectory.at_sample else 1.0
        return [(place, values[place], right) for place, values in zip(places, rows, strict=True)]

    def model(
        self, trajectories: list[HiddenTrajectory], keys: list[Key], level: float, undetected_at: Sequence[Mask] = ()
    ) -> CoveringProgram:
        """The program of these trajectories at a level, and of what must be measured once wherever it shows.

        Behind the frame: a row for each key, those of what must be measured, and each key's row for samples.
        """
        places = [np.unique(self.place[where]) for where in undetected_at]
        more = [(mine[mine >= 0], np.ones(int(np.sum(mine >= 0))), 1.0) for mine in places]
        return self._with_rows(CoveringProgram(self.cost, *self.frame), trajectories, keys, level, more)

    def longer(
        self, model: CoveringProgram, trajectories: list[HiddenTrajectory], keys: list[Key], level: float
    ) -> CoveringProgram:
        """A program with more rows, behind those that there are: one for each key, then each key's for samples."""
        return self._with_rows(model, trajectories, keys, level, [])

    def _with_rows(
        self,
        model: CoveringProgram,
        trajectories: list[HiddenTrajectory],
        keys: list[Key],
        level: float,
        between: list[tuple[Index, Array, float]],
    ) -> CoveringProgram:
        asked = [self.rows(trajectories[a], end, level) for a, end in keys]
        rows = [rows[0] for rows in asked] + between + [row for rows in asked for row in rows[1:]]
        more, right = _stacked(rows, self.columns)
        A = sparse.vstack([model.A, more], format="csr")
        return CoveringProgram(model.c, A, np.concatenate([model.b, right]))

    def choice(self, x: Array) -> Mask:
        """What a point of the program measures."""
        chosen = np.zeros(self.problem.allowed.shape, dtype=bool)
        at, sensor = np.nonzero(self.place >= 0)
        chosen[at, sensor] = x[self.place[at, sensor]] > 0.5
        return chosen

    def point(self, chosen: Mask) -> Array:
        """A choice as a point of the program."""
        x = np.zeros(self.columns)
        at, sensor = np.nonzero(chosen)
        x[self.place[at, sensor]] = 1.0
        x[self.sample_of[at]] = 1.0
        return x


def _is_whole(problem: PlanProblem) -> bool:
    """Whether a sample may as well read every sensor that there is: more of them cost nothing and break nothing."""
    used = np.flatnonzero(problem.allowed.any(axis=0))
    if used.size <= 1:
        return True
    alike = bool(np.all(problem.allowed[:, used] == problem.allowed[:, used[:1]]))
    free = not np.any(problem.price[used]) and bool(np.all(problem.longest_use[used] >= problem.steps))
    return alike and free and bool(np.all(problem.sensor_spacing[used] <= max(problem.spacing, 1)))


def cheapest(
    covering: CoveringRows,
    model: CoveringProgram,
    tie: Array,
    work: Budget,
    below: float = np.inf,
    nodes: int = NODES,
    within_limits: bool = False,
) -> tuple[Mask | None, bool]:
    """Return a cheap choice that keeps every row, and whether the solver says that there is none.

    `tie` is a small cost that decides among choices of equal price; only those `below` a cost are of use. That is a row
    of the program, too: without it the solver goes through all choices of just that cost before it says so.
    `within_limits`: a choice that the limits admit will do, however dear, the first that is found.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    rows = [LinearConstraint(model.A, model.b, np.inf)]
    if np.isfinite(below):
        most = below - covering.grain / 2 if covering.grain else below * (1 - GRAIN)
        rows.append(LinearConstraint(sparse.csr_matrix(model.c[None] / model.unit), -np.inf, most / model.unit))
    size = max(1, model.A.nnz)
    most = int(np.clip((work.left / (COVER[1] * size) - 1) / NODE, 1, NODES))  # no more than there is work left for
    found = milp(
        (tie if within_limits else model.c + tie) / model.unit,
        constraints=rows,
        integrality=np.ones(covering.columns),
        bounds=Bounds(0, covering.ceiling(min(below, covering.dearest))),
        options={
            "node_limit": min(most, max(FEWEST, min(nodes, ENTRIES // size))),
            "mip_rel_gap": np.inf if within_limits else NEAR,
        },
    )
    work.add(COVER, size * (1 + NODE * max(0, (found.mip_node_count or 0) - 1)))
    if found.x is None:
        return None, found.status == 2
    return covering.choice(found.x), False


def relaxed(model: CoveringProgram, low: Array, high: Array, work: Budget) -> tuple[Array, Array, float]:
    """Solve the relaxation where a row may be left open at a price; return x, multipliers, and what these prove."""
    from scipy.optimize import linprog

    work.add(RELAXED, model.A.nnz)
    (m, k), dearest = model.A.shape, float(np.max(model.c, initial=model.unit))
    price = max(OPEN_ROW * dearest, float(model.c.sum()) + dearest)
    A = sparse.hstack([model.A, sparse.identity(m)], format="csr")
    bounds = np.vstack([np.column_stack([low, high]), np.column_stack([np.zeros(m), np.full(m, np.inf)])])
    cost = np.concatenate([model.c, np.full(m, price)])
    found = linprog(cost / model.unit, A_ub=-A, b_ub=-model.b, bounds=bounds, method="highs")
    if found.x is None:
        return np.zeros(k), np.zeros(m), -np.inf
    y = np.maximum(-np.asarray(found.ineqlin.marginals), 0.0) * model.unit
    y[y < price * 1e-12] = 0.0
    return np.asarray(found.x[:k]), y, proven(model, y, low, high)


def proven(model: CoveringProgram, y: Array, low: Array, high: Array) -> float:
    """Return what multipliers y >= 0 prove of the least cost with low <= x <= high; no solver."""
    rest = model.c - model.A.T @ y
    terms = np.where(rest > 0, rest * low, rest * high)
    size = float(np.abs(model.b * y).sum() + np.abs(terms).sum())
    return float(model.b @ y + terms.sum()) - ROUNDING * size


def _stacked(rows: list[tuple[Index, Array, float]], columns: int) -> tuple[sparse.csr_matrix, Array]:
    """Sparse rows and their right sides."""
    if not rows:
        return sparse.csr_matrix((0, columns)), np.zeros(0)
    at = np.concatenate([np.full(place.size, i) for i, (place, _, _) in enumerate(rows)])
    places = np.concatenate([place for place, _, _ in rows])
    values = np.concatenate([value for _, value, _ in rows])
    matrix = sparse.csr_matrix((values, (at, places)), shape=(len(rows), columns))
    return matrix, np.array([right for _, _, right in rows])
