"""The least error that any estimator can guarantee along a plant that varies in time, on a finite schedule."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sampling_design.accuracy.accuracy import RTOL
from sampling_design.accuracy.accuracy_record import AccuracyBracket
from sampling_design.accuracy.bounds import Bound, InitialSet, SignalBounds
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.observability.alignment import align
from sampling_design.plants.functional import RequestedRows, Wanted, requested_rows, row_arguments
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask, freeze
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.record import Claim, above, below, short
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.schedule import Schedule
from sampling_design.uncertain.accuracy.accuracy_over_box import refuse_others
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant

LOOKED = 4
"""Times of each gap at which the error is bracketed: just after its sample, in between, and just before the next."""
CELLS = (8, 16, 32)
"""Cells of a gap on which the adversary's w is constant, one number after the other until the bracket closes."""
SPREAD = 0.618034
"""Share by which times are stepped through, from the last on, when most is known: any part lies all over."""
UNOBSERVABLE = 1e-9  # share of a row that readings may leave of a free start and that counts as rounding


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyAlong(AccuracyBracket):
    """The least guaranteed error of each wanted row at the times looked at, of a plant that varies in time.

    Attributes
    ----------
    times : (K,) array
        Those looked at; of a sample just before it and just after it. All over the schedule, but fewer of them where
        `budget` ended.
    lower, upper : (r, K) arrays
        Attained by a start, a disturbance and noise within their bounds; guaranteed by gains. Both to `error`;
        infinite where the samples so far do not determine the row.
    worst : (r,) array
        The time of the largest finite `upper`, if there is one.
    known_from : (r,) array
        The first of those times from which on the row stays known; infinite if never.
    closed : (r,) bool array
        Whether the bracket met the tolerance at that time.
    error : float
        How far the transitions are off at most, relative to scaled states: proven of a table (`proven`), else an
        estimate.
    """

    plant: TimeVaryingPlant
    schedule: Schedule
    rows: RequestedRows
    times: Array
    lower: Array
    upper: Array
    worst: Array
    known_from: Array
    closed: Mask
    error: float
    proven: bool

    _plain = "rows{names matrix} times time_unit:plant.time_unit lower upper worst known_from closed error claim"

    def _columns(self) -> Mapping[str, Sequence[object] | Array]:
        sides = {"": self.upper, " at least": self.lower}
        names = self.rows.names
        return {"time": self.times, **{n + of: side[k] for of, side in sides.items() for k, n in enumerate(names)}}

    @property
    def claim(self) -> Claim:
        """What `upper` claims: numerical evidence, as integrals over w are sums."""
        return Claim(
            f"at the times looked at, gains guarantee {above(self.largest[1])}",
            "optimal recovery, integrals by Simpson's rule",
            ("bounded disturbance, noise and first error", "the plant varies as stated"),
            strength="sampled",
        )

    @property
    def largest(self) -> tuple[Array, Array]:
        """The bracket of each row at its worst time; infinite if the row is never known."""
        at = _worst(self.upper)
        index = np.arange(len(at))
        return self.lower[index, at], self.upper[index, at]

    _answers = (
        "the least error that an estimator can guarantee at {times.size} times of a plant that varies",
        "{claim.evidence}",
        "at most {largest[1]:up}, no less than {largest[0]:down}",
        "the same call with a smaller `rtol`",
    )

    def _rows(self) -> list[tuple[str, str]]:
        found, unit = [], self.plant.time_unit
        for k, label in enumerate(self.rows.labels()):
            low, up = (float(side[k]) for side in self.largest)
            text = f"{below(low)} to {above(up)}, worst at {short(self.worst[k])} {unit}"
            if np.isinf(up):
                text = "without bound: the samples do not determine it"
            elif self.known_from[k] > self.times[0]:
                text += f", unknown before {short(self.known_from[k])} {unit}"
            found.append((label, text + ("" if self.closed[k] else " (not closed)")))
        return [*found, ("transitions off by", f"{short(self.error)} ({'proven' if self.proven else 'an estimate'})")]

    def explain(self) -> str:
        """Say what can be guaranteed."""
        low, up = self.largest
        named = zip(self.rows.labels(), up, strict=True)
        parts = [f"{n} within {above(u, 4)}" if np.isfinite(u) else f"nothing of {n}" for n, u in named]
        unknown = self.known_from[np.isfinite(self.known_from) & (self.known_from > self.times[0])]
        when = f"from {short(unknown.max())} {self.plant.time_unit} on " if unknown.size else ""
        return (
            f"At the {self.times.size} times looked at some estimator guarantees {when}{', '.join(parts)}; none "
            f"guarantees less than {below(low, 4)}. Nothing is proven between these times, nor of the "
            "error of numerical integration."
        )


def _worst(upper: Array) -> Index:
    """Where each row is largest among the times at which it is known."""
    return np.asarray(np.where(np.isfinite(upper), upper, -1.0).argmax(axis=1))


def accuracy_along(
    plant: TimeVaryingPlant,
    schedule: object,
    *,
    w_bound: Bound = None,
    v_bound: Bound = None,
    initial_error: VectorBound = None,
    of: Wanted = None,
    start: float | None = None,
    end: float | None = None,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    **others: object,
) -> AccuracyAlong:
    """Bracket the least guaranteed error at the samples and in between: see `guaranteed_accuracy`.

    The adversary's linear program has w constant on cells; its multipliers are gains, whose guarantee is a sum over the
    start, the noise and the integral of |G'g| (Simpson's rule on each cell). Raises ArgumentError if the schedule does
    not lie within the horizon, or a bound is one on a norm of several entries; SolverError if the program is not
    solved.
    """
    refuse_others("of a plant that varies", **others)
    rtol = checks.positive("rtol", RTOL if rtol is None else rtol)
    given = Budget(None if budget is None else checks.positive("budget", budget))
    problem = _VaryingProblem(plant, schedule, w_bound, v_bound, of, initial_error, (start, end))
    lower, upper = (np.zeros((len(problem.rows), len(problem.looked))) for _ in range(2))
    count, seen = len(problem.looked), np.zeros(len(problem.looked), dtype=bool)
    for done, k in enumerate(np.argsort((np.arange(count) - count + 1) * SPREAD % 1).tolist(), 1):
        gap, part, taken = problem.looked[k]
        for i, row in enumerate(problem.rows.matrix):
            if given.over and seen.any():
                break
            before = np.inf
            for cells in CELLS:
                low, up = problem.bracket(row, gap, part, taken, cells)
                lower[i, k], upper[i, k] = low, up
                if not np.isfinite(up) or up <= (1 + rtol) * low or up > (1 - rtol) * before:
                    break
                if given.over:  # the coarsest cells prove a bracket, too
                    break
                before = up
        else:
            seen[k] = True
            if progress is not None:
                progress(done / count, f"{done} of {count} times")
        if given.over:
            break
    lower, upper = lower[:, seen], upper[:, seen]
    at = _worst(upper)
    index = np.arange(len(at))
    least, most = lower[index, at], upper[index, at]
    times = np.array([problem.time(gap, part) for gap, part, _ in problem.looked])[seen]
    return AccuracyAlong(
        plant=plant,
        schedule=problem.schedule,
        rows=problem.rows,
        times=freeze(times),
        lower=freeze(lower),
        upper=freeze(upper),
        worst=freeze(times[at]),
        known_from=freeze([_known_from(times, row) for row in upper]),
        closed=seen.all() & (np.isinf(least) | (most <= (1 + rtol) * least)),
        error=max(level.error for level in problem.levels.values()),
        proven=plant.tabled,
    )


def _known_from(times: Array, upper: Array) -> float:
    """From which of the times on a row stays known."""
    unknown = np.flatnonzero(np.isinf(upper))
    first = int(unknown[-1]) + 1 if unknown.size else 0
    return float(times[first]) if first < times.size else np.inf


class _VaryingProblem:
    """Everything along one schedule, in scaled states."""

    def __init__(
        self, plant: TimeVaryingPlant, schedule: object, w_bound: Bound, v_bound: Bound, of: Wanted,
        initial_error: VectorBound, ends: tuple[float | None, float | None],
    ) -> None:  # fmt: skip
        if not isinstance(schedule, Schedule) or not len(schedule):
            raise ArgumentError(
                "`schedule` must be a Schedule with samples within the plant's horizon, got "
                f"{checks.described(schedule)}."
            )
        still = plant.at(0.0)
        self.plant, self.schedule, self.rows = plant, align(still, schedule), requested_rows(still, of)
        wanted = row_arguments(of)
        if isinstance(wanted, tuple) and not set(wanted) <= set(still.states.names):
            raise ArgumentError("`of` must name states, or be rows of a matrix: the rows of outputs vary in time.")
        times = self.schedule.times
        first, last = (float(edge if end is None else checks.number(name, end))
                       for name, edge, end in zip(("start", "end"), times[[0, -1]], ends, strict=True))  # fmt: skip
        if not 0 <= first <= times[0] or not times[-1] <= last <= plant.horizon:
            raise ArgumentError(
                f"`start`, the samples and `end` must follow each other within [0, {plant.horizon:.6g}], the plant's "
                f"horizon, got {first!r}, {float(times[0])!r} to {float(times[-1])!r}, {last!r}."
            )
        bounds = SignalBounds.of(still, len(times), self.schedule.outputs, w_bound, v_bound)
        start = InitialSet.of(still, initial_error)
        for name, ball in (("w_bound", bounds.w_ball), ("v_bound", bounds.v_ball), ("initial_error", start.ball)):
            if ball:
                raise ArgumentError(f"`{name}` must hold one number for each entry here, not one bound on the norm.")
        self.w, self.v = bounds.w, bounds.v / plant.outputs.scales
        self.free = ~start.exact & ~np.any(start.rows != 0, axis=0)
        self.reach = np.where(start.exact | self.free, 0.0, 1 / np.maximum(np.abs(start.rows).sum(axis=0), 1e-300))
        self.reach = self.reach / plant.states.scales
        self.nodes = np.unique(np.concatenate([[first], times, [last]]))
        self.sample = {int(np.searchsorted(self.nodes, t)): j for j, t in enumerate(times.tolist())}
        self.looked = self._looked()
        self.levels: dict[int, _CellProgram] = {}

    def _looked(self) -> list[tuple[int, int, bool]]:
        """Gap, quarter, and whether the sample at that time is taken: just after each node, in between, before it."""
        found = [(0, 0, True)]
        for gap in range(self.nodes.size - 1):
            found += [(gap, part, True) for part in range(0 if gap else 1, LOOKED)] + [(gap, LOOKED, False)]
        if self.nodes.size > 1 and self.nodes.size - 1 in self.sample:
            found.append((self.nodes.size - 2, LOOKED, True))
        return found

    def time(self, gap: int, part: int) -> float:
        """The time of a quarter of a gap."""
        if self.nodes.size == 1:
            return float(self.nodes[0])
        a, b = self.nodes[gap : gap + 2].tolist()
        return float(b if part == LOOKED else a + (b - a) * part / LOOKED)

    def bracket(self, row: Array, gap: int, part: int, taken: bool, cells: int) -> tuple[float, float]:
        """What is attained and what gains guarantee at one time."""
        if cells not in self.levels:
            self.levels[cells] = _CellProgram(self, cells)
        return self.levels[cells].bracket(row * self.plant.states.scales, gap * cells + part * cells // LOOKED, taken)


class _CellProgram:
    """Transitions of one number of cells, and the adversary's program on them."""

    def __init__(self, problem: _VaryingProblem, cells: int) -> None:
        self.problem, plant, nodes = problem, problem.plant, problem.nodes
        steps = [np.linspace(a, b, 2 * cells + 1)[:-1] for a, b in pairwise(nodes.tolist())]
        grid = np.concatenate([*steps, nodes[-1:]])
        transitions = plant.transitions(grid)
        self.error, n, q = transitions.error, plant.n_states, len(problem.w)
        G = np.zeros((grid.size, n, q))
        if plant.G is not None:
            G = np.array([np.asarray(plant.G(t), dtype=float) for t in grid.tolist()]) / plant.states.scales[:, None]
        G = G * problem.w
        self.late, self.whole = transitions.F[1::2], transitions.F[1::2] @ transitions.F[::2]
        self.h, self.G = np.diff(grid[::2]), G
        ends = self.whole @ G[:-1:2], 4 * self.late @ G[1::2], G[2::2]
        self.disturbance_flow = (ends[0] + ends[1] + ends[2]) * self.h[:, None, None] / 6
        self.read: dict[int, tuple[Array, Array]] = {}
        for node, j in problem.sample.items():
            measured = np.isfinite(problem.v[j])
            self.read[node * cells] = transitions.C[2 * node * cells][measured], problem.v[j][measured]
        count = len(self.h)
        state = np.hstack([np.diag(np.where(problem.free, 1.0, problem.reach)), np.zeros((n, count * q))])
        self.states = [state]
        for k in range(count):
            state = self.whole[k] @ state
            state[:, n + k * q : n + (k + 1) * q] += self.disturbance_flow[k]
            self.states.append(state)

    def bracket(self, row: Array, at: int, taken: bool) -> tuple[float, float]:
        """What is attained and what gains guarantee at a boundary of cells, its sample taken or not."""
        problem, n = self.problem, self.problem.plant.n_states
        used = [k for k in self.read if k < at or (k == at and taken)]
        width = n + at * len(problem.w)
        R = np.vstack([np.zeros((0, width)), *(self.read[k][0] @ self.states[k][:, :width] for k in used)])
        v = np.concatenate([np.zeros(0), *(self.read[k][1] for k in used)])
        c = row @ self.states[at][:, :width]
        free, known = np.flatnonzero(problem.free), np.append(~problem.free, np.ones(width - n, dtype=bool))
        terms = [np.abs(C) @ np.abs(self.states[k]) for C, k in [(row, at), *((self.read[k][0], k) for k in used)]]
        moved = np.abs(np.vstack([c, R])[:, free]) > UNOBSERVABLE * np.vstack([each[..., free] for each in terms])
        # an exact sensor counts in what bounded signals move, and a free start in what it moves readings by
        unit, changed = np.where(v > 0, v, np.linalg.norm(R[:, known], axis=1)), np.abs(R[:, free]) * moved[1:]
        shown = (changed[unit > 0] / unit[unit > 0, None]).max(axis=0, initial=0.0)
        shown = np.where(shown > 0, shown, changed.max(axis=0, initial=0.0))
        if np.any(moved[0] & (shown == 0)):
            return np.inf, np.inf
        for each in (c, R):
            each[..., free] *= (shown > 0) / np.where(shown > 0, shown, 1.0)
        unit = np.where(unit > 0, unit, np.maximum(np.linalg.norm(R, axis=1), 1e-300))
        observed_rows, unobserved = R[:, free], c[free]
        left = unobserved - (
            np.linalg.pinv(observed_rows / unit[:, None]) @ (observed_rows / unit[:, None]) @ unobserved
            if len(v)
            else 0.0
        )
        if np.linalg.norm(left) > UNOBSERVABLE * np.linalg.norm(c):
            return np.inf, np.inf
        if not np.any(c):
            return 0.0, 0.0
        z, gains = self._solved(c, R / unit[:, None], v / unit)
        gains = gains / unit
        if len(v) and len(unobserved):  # what the gains leave of a free start is rounding, and is taken away
            off = unobserved - gains @ observed_rows
            gains = gains + np.linalg.lstsq((observed_rows / unit[:, None]).T, off, rcond=None)[0] / unit
        inside = np.concatenate([np.abs(z[n:]), np.abs(z[:n][~problem.free]), np.abs(R @ z)[v > 0] / v[v > 0], [1.0]])
        exact = np.abs(R @ z)[v == 0] / unit[v == 0]
        bounded_by = float(inside.max()) + float(exact.max(initial=0.0))
        return float(c @ z) / bounded_by, self._guaranteed(row, c, R, v, gains, used, at)

    def _solved(self, c: Array, R: Array, v: Array) -> tuple[Array, Array]:
        """The adversary's start and w, and the multipliers of the readings."""
        from scipy.optimize import linprog

        n = self.problem.plant.n_states
        limits = np.ones((len(c), 2)) * [-1.0, 1.0]
        limits[:n][self.problem.free] = -np.inf, np.inf
        size = float(np.abs(c).max())
        found = linprog(-c / size, A_ub=np.vstack([R, -R]), b_ub=np.concatenate([v, v]), bounds=limits)
        if found.status != 0:
            raise SolverError(f"the program of a row was not solved: {found.message}", status="failed")
        above, below = np.split(-np.asarray(found.ineqlin.marginals) * size, 2)
        return np.asarray(found.x), above - below

    def _guaranteed(self, row: Array, c: Array, R: Array, v: Array, gains: Array, used: list[int], at: int) -> float:
        """The noise's, the start's and the disturbance's part of what gains guarantee."""
        n, known = self.problem.plant.n_states, ~self.problem.free
        total = float(np.abs(gains) @ v + np.abs((c - gains @ R)[:n][known]).sum())
        sizes = [len(self.read[k][1]) for k in used]
        parts = dict(zip(used, np.split(gains, np.cumsum(sizes)[:-1]), strict=True)) if used else {}
        g = row
        for k in range(at, -1, -1):
            if k in parts:
                g = g - parts[k] @ self.read[k][0]
            if k:
                a, middle = g @ self.whole[k - 1], g @ self.late[k - 1]
                ends = [np.abs(x @ self.G[i]).sum() for x, i in ((a, 2 * k - 2), (middle, 2 * k - 1), (g, 2 * k))]
                total += float(self.h[k - 1] / 6 * (ends[0] + 4 * ends[1] + ends[2]))
                g = a
        return total
