"""The cone program of one record: the largest value of a row over everything that the readings and bounds allow.

    maximise  c'x(t)   over starts and w constant on cells, subject to  the bounds and every reading

Its multipliers are gains; what gains prove is evaluated without the solver and for all real times (`upper`). Gains are
kept in plain units: one number for each row that was read.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from sampling_design.accuracy.bounds import EXACT
from sampling_design.accuracy.gains import ROUNDING, RowEnd
from sampling_design.accuracy.gap_table import DisturbanceQuadrature, GapTable, RecordCells
from sampling_design.accuracy.readings import Readings
from sampling_design.accuracy.record_cones import RecordCones, RecordScaling
from sampling_design.accuracy.undetectable import rows_of_start
from sampling_design.accuracy.unknown_start import FreeStart
from sampling_design.numerics.conic_programs import INFEASIBLE, UNBOUNDED
from sampling_design.numerics.linalg import products
from sampling_design.records.arrays import Array

TOLERANCE = (1e-6, 3e-8, 3e-8, 1e-9)
"""Asked of the solver at each level of cells; what it leaves open widens an interval, never breaks it."""

HELD = 1e-13  # relative error with which nominal states and readings are held
FLOW_HELD = 4 * float(np.finfo(float).eps)  # the same of a flow over a panel of a gap: those of a gap are multiplied
CLOSED = 1e-2  # share of the half-width by which the adversary may fall short of it before cells are made finer

SPARED = 0.1  # share of that by which gaps may fall short together whose cells stay as they are

HALVED = 3.0
"""Multiple of that share up to which cells of half the size are tried first: what they lose falls with their square."""

COARSE = 1.1
"""Multiple of the bounds up to which cells on which w is constant may be too coarse to explain what bounds allow."""

ROOM = 1e-3  # how much larger than that multiple the bounds are taken where gains are sought nevertheless

PLAIN = 12
"""Digits after the point to which gains of the last readings alone are rounded: 1 where a row is what was read."""

ALIKE = 1e-6  # share of the width by which plainer gains may prove less
DISPROVED = 1e-9  # a contradiction must exceed this share of its terms before the bounds count as disproved
LEVELS = len(TOLERANCE)  # levels of cells

GROWN = 1e3
"""Growth over a gap from which on the solver's last digits decide: its gains are then fed back, others tried."""

WHICH_BOUNDS = ("all", "w", "v")  # which bounds may grow: all of them, that on w alone, those on v alone


def _slack(up: RowEnd, down: RowEnd) -> float:
    """By how much the adversary may fall short of the ends of a row."""
    return CLOSED * max((up.value + down.value) / 2, 0.0)


class RecordProgram:
    """The program of one record, posed once; every row and both its ends are solves of it.

    `table` keeps gaps between records that grow or slide.
    """

    def __init__(self, readings: Readings, table: GapTable | None = None):
        self.readings = readings
        lengths = np.diff(readings.times)
        if table is None:
            counts = ~readings.below | (readings.size > 0)
            H = np.where(counts[:, None], readings.H / readings.units[:, None], 0.0)
            rows = np.split(H, readings.offsets[1:-1])[:-1]
            table = GapTable.suited(readings.A, readings.G, lengths, rows)
        self.table = table
        self.gaps = table.get(lengths.tolist())
        n = len(table.D)
        self.F = np.array([gap.F for gap in self.gaps]).reshape(len(self.gaps), n, n)
        if readings.kept is not None:
            self.F = self.F * readings.kept[:-1, None, :]
        self.H = readings.H * table.D
        self.scaling = RecordScaling(readings, self.gaps, self.F, table.D, self.H)
        self.infeasible = self._is_centred = False
        self._aim = len(readings.times) - 1  # the time of the row that was asked for last
        self._posed: tuple[int, RecordCones] | None = None
        self._found: dict[tuple[int, str], tuple[Array | None, float]] = {}
        self._run_back: tuple[tuple[bytes, int], Array] | None = None
        self._asked: tuple[tuple[float, bytes], tuple[Array, float]] | None = None
        self._nominal = math.nan, np.zeros(0)  # the time asked for last, and that state then

    @cached_property
    def _quadrature(self) -> DisturbanceQuadrature:
        return DisturbanceQuadrature(self.table, self.gaps)

    @cached_property
    def _cells(self) -> RecordCells:
        return RecordCells(self.gaps, self._quadrature, self.readings.disturbance.ball)

    @cached_property
    def _rounded(self) -> float:
        """Relative error with which nominal states are held: those of its gaps, panel after panel."""
        return HELD + FLOW_HELD * sum(gap.third.size for gap in self.gaps)

    def posed(self, level: int = 0) -> RecordCones:
        """Return the program with the cells of a level; one is held at a time, since a solver's memory is large."""
        if self._posed is None or self._posed[0] != level:
            self._posed = None
            cells = self._cells.of(level)
            self._posed = level, RecordCones(
                self.readings, self._near, self.F, cells, self.table.D, self.scaling.L, self.H, self.scaling.unit,
                tolerance=TOLERANCE[level],
            )  # fmt: skip
        return self._posed[1]

    def solve(self, t: float, rows: Array, stops: bool = False) -> list[list[RowEnd]]:
        """Return both ends of each row of x at t, the upper one of c and that of -c, and the gains that prove them.

        Cells become finer until the adversary comes as far as the gains allow, but for `CLOSED` of the half-width, and
        only those by which it falls short. It `stops` where the data contradict the bounds: what is left has no ends.
        Where readings are nearly exact, gains for exact ones are tried, too: their program parts states less.
        """
        nothing = RowEnd(np.inf, np.inf, np.inf, np.zeros(len(self.H)))
        ends, last = [[nothing, nothing] for _ in rows], 0
        for row, pair in zip(rows, ends, strict=True):
            pair[:] = self._end(t, row, 0), self._end(t, -row, 0)
            if stops and self.infeasible and self.contradicted:
                return ends
        early = [max(up.short, down.short) <= HALVED * _slack(up, down) for up, down in ends]
        for level in range(1, LEVELS):
            due = [k for k in range(len(ends)) if early[k] or level > 1]
            open_ = [(k, s) for k in due for s in (0, 1) if ends[k][s].short > _slack(*ends[k])]
            if not open_:
                continue
            if self.infeasible and self.contradicted:
                break
            for k, s in open_:
                costates = self._costates(self._ahead(t, (-1.0) ** s * rows[k])[0], ends[k][s].gains)[0]
                self._cells.refine(level, last, costates, ends[k][s].short, SPARED * _slack(*ends[k]))
            for k, s in open_:
                finer = self._end(t, (-1.0) ** s * rows[k], level)
                ends[k][s] = finer if finer.value < ends[k][s].value else replace(ends[k][s], short=finer.short)
            last = level
        for row, pair, others in zip(rows, ends, self._of_exact.solve(t, rows) if self._of_exact else (), strict=False):
            for s, end in enumerate(others):
                pair[s] = min(pair[s], self.upper(t, (-1.0) ** s * row, end.gains), key=lambda end: end.value)
        return ends

    @cached_property
    def _of_exact(self) -> RecordProgram | None:
        """The program in which what is nearly exact is exact; None where nothing is."""
        read = self.readings
        nearly = ~read.below & (read.size > 0) & (read.size < EXACT * self.scaling.driven)
        if not nearly.any():
            return None
        sizes = iter(np.where(nearly, 0.0, read.size).tolist())
        rows = tuple(tuple(row._replace(size=next(sizes)) for row in each) for each in read.rows)
        return RecordProgram(replace(read, rows=rows), self.table)

    def after(self, t: float, row: Array) -> float:
        """Return what w adds to a row between the last time and t at most."""
        return self._ahead(t, row)[1]

    def end(self, t: float, row: Array) -> RowEnd:
        """Return the upper end of a row from coarse cells."""
        return self._end(t, row, 0)

    def _end(self, t: float, row: Array, level: int) -> RowEnd:
        """The upper end of a row, from the program of one level."""
        c, added = self._ahead(t, row)
        if self._hidden(c):
            self.infeasible = not self._feasible
            return RowEnd(np.inf, np.inf, np.inf, np.zeros(len(self.H)))
        attained, gains, ahead = self._solved(c, level)
        with np.errstate(over="ignore", invalid="ignore"):  # where nothing is free, a solver may diverge
            found = self._plainest(t, row, self.upper(t, row, self._steadied(c, gains, ahead)))
            if not abs(self._short(found, added + attained)) < CLOSED * found.width:
                for other in self._fed_back(c, gains, ahead):
                    found = min(found, self.upper(t, row, other), key=lambda end: end.value)
            short = self._short(found, added + attained)
        return replace(found, short=short if np.isfinite(found.bound) and attained < np.inf else 0.0)

    def _short(self, found: RowEnd, attained: float) -> float:
        """By how much the adversary of the last program falls short of what gains prove."""
        return (found.width if self._is_centred else found.bound) - attained

    def _plainest(self, t: float, row: Array, found: RowEnd) -> RowEnd:
        """Gains of the last readings alone, where they leave exactly nothing of a free start and prove as much.

        With fewer readings than states no change of gains takes away the rest that rounding leaves; where gaps let it
        grow, nothing else is worth much.
        """
        read = self.readings
        last = np.flatnonzero((read.nodes == len(read.times) - 1) & ~read.below)
        few = np.count_nonzero(~read.below) < len(row)
        asked = self._grown or (few and read.start.unbounded)
        if t != read.times[-1] or not (asked and last.size):
            return found
        own, gains = read.H[last, : row.size], np.zeros(len(read.H))
        gains[last] = np.round(np.linalg.lstsq(own.T, row, rcond=None)[0], PLAIN)
        if read.H[last, row.size :].any() or np.any(gains[last] @ own != row):
            return found
        plain = self.upper(t, row, gains)
        return plain if plain.value <= found.value + ALIKE * plain.width else found

    def _ahead(self, t: float, row: Array) -> tuple[Array, float]:
        """The row where it is asked for or at the last time, and a bound on what w adds from there; kept once."""
        key = t, row.tobytes()
        if self._asked is None or self._asked[0] != key:
            self._asked = key, self._moved(t, row)
        return self._asked[1]

    def _moved(self, t: float, row: Array) -> tuple[Array, float]:
        times = self.readings.times
        self._aim = min(int(np.searchsorted(times, t)), len(times) - 1)
        longer = np.zeros(len(self.table.D))
        longer[: row.size] = row
        c, last = longer * self.table.D, float(self.readings.times[-1])
        if t <= last:
            return c, 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            gap = self.table.open(t - last)
            return np.asarray(gap.F.T @ c), DisturbanceQuadrature(self.table, [gap]).integral(
                c[None], self.readings.disturbance.ball
            )

    def _solved(self, c: Array, level: int) -> tuple[float, Array, Array]:
        """What the adversary attains, and multipliers of rows and gaps, for a target at the last time, unchecked."""
        with np.errstate(over="ignore", invalid="ignore"):
            posed, mu = self.posed(level), self.scaling.L[self._aim].T @ c
        size = math.hypot(*mu.tolist())  # its square may overflow
        nothing = np.inf, np.zeros(len(self.H)), np.zeros_like(self.F[:, 0])
        if size == 0 or not np.isfinite(size):
            return nothing
        cost = np.zeros(posed.columns)
        cost[posed.state(self._aim)] = -mu / size
        x, y, status = posed.solver.solve(cost, posed.b)
        self.infeasible = status == INFEASIBLE
        self._is_centred = self.infeasible and not 1 - ROOM <= self._multiple(level) <= COARSE
        if self.infeasible:  # gains prove something of any bounds and readings, whichever they were sought for
            larger = posed.centred() if self._is_centred else posed.loosened(self._multiple(level) * (1 + ROOM))
            x, y, status = posed.solver.solve(cost, larger)
        with np.errstate(over="ignore", invalid="ignore"):
            gains, ahead = posed.read(y * size)
            least = -float(cost @ x) * size + (0.0 if self._is_centred else float(c @ self._near[self._aim]))
        if status in (INFEASIBLE, UNBOUNDED) or not (np.isfinite(gains).all() and np.isfinite(ahead).all()):
            return nothing
        # of data that contradict the bounds nobody knows what is attained
        unknown = (self.infeasible and not self._is_centred) or np.isnan(least)
        return -np.inf if unknown else least, gains, ahead

    def _multiple(self, level: int) -> float:
        """The least multiple of all bounds under which the program of a level has a solution."""
        return self._least(level, "all")[1]

    def _least(self, level: int, which: str) -> tuple[Array | None, float]:
        if (level, which) not in self._found:
            self._found[level, which] = self.posed(level).grown(which)
        return self._found[level, which]

    @property
    def seems_infeasible(self) -> bool:
        """Whether a solver found no trajectory that the readings allow, when a row was asked for last."""
        return self.infeasible or (self._of_exact is not None and self._of_exact.infeasible)

    @cached_property
    def contradicted(self) -> bool:
        """Whether gains prove that the readings contradict the bounds."""
        return self.growth("all", self.least_growth("all")) > 1 + DISPROVED

    def _steadied(self, c: Array, gains: Array, ahead: Array) -> Array:
        """The solver's gains, corrected by the filter's wherever its costate and the true one part.

        The costate runs backwards through a plant that may grow: without the correction the solver's last digits would.
        What is left of a free start then is taken away by the least change of the gains.
        """
        unit, read = self.scaling.unit, self.readings
        gains = np.where(read.below, np.maximum(gains, 0.0), gains)
        meant, begun = self._meant(c, ahead)
        open_ = begun - self.readings.per_time(self.H * gains[:, None])
        open_[1:] -= meant
        e, errors = np.zeros(len(c)), np.zeros_like(begun)
        for k in range(len(begun) - 1, 0, -1):
            errors[k] = e
            e = np.asarray(self._through[k - 1].dot(e) + open_[k].dot(self.F[k - 1]))  # one time earlier
        errors[0] = e
        return self.leaving_nothing(c, gains + np.einsum("rn,rn->r", self.scaling.filter[0], errors[read.nodes]) / unit)

    def _meant(self, c: Array, ahead: Array) -> tuple[Array, Array]:
        """The costates (K-1, n) that multipliers stand for just after each gap, and those (K, n) before each time."""
        meant = np.asarray(np.linalg.solve(np.swapaxes(self.scaling.L[1:], 1, 2), ahead[:, :, None])[:, :, 0])
        begun = np.zeros((len(self.readings.times), len(c)))
        begun[:-1] = products(np.swapaxes(self.F, 1, 2), meant)
        begun[self._aim] += c
        return meant, begun

    @cached_property
    def _grown(self) -> bool:
        """Whether a gap lets the state grow so much that rounding matters."""
        return bool(np.abs(self.F).max(initial=0.0) > GROWN)

    def _fed_back(self, c: Array, gains: Array, ahead: Array) -> list[Array]:
        """The solver's gains, and the filter's alone, corrected where the *computed* costate parts from what was meant.

        So rounding that one gap makes grow is met at the next sample.
        """
        read, found = self.readings, []
        filter_ = np.where(read.below[:, None], 0.0, self.scaling.filter[0] / self.scaling.unit[:, None])
        solved = np.where(read.below, np.maximum(gains, 0.0), gains), self._meant(c, ahead)[1]
        nothing = np.zeros_like(gains), np.zeros_like(solved[1])
        for start, meant in (solved, nothing):
            own, g = start.copy(), np.zeros_like(c)
            for k in range(len(meant) - 1, -1, -1):
                g = g + c if k == self._aim else g
                rows = slice(*read.offsets[k : k + 2])
                own[rows] += filter_[rows] @ (g - meant[k])
                g = g - (self.H[rows] * own[rows, None]).sum(axis=0)
                g = g.dot(self.F[k - 1]) if k else g
            found.append(self.leaving_nothing(c, own))
        return found

    def leaving_nothing(self, c: Array, gains: Array) -> Array:
        """Return gains after the least change that takes away what they leave of a free start."""
        if not self.readings.start.unbounded:
            return gains
        return self._free.without(gains, self._begun(c), lambda own: self._costates(c, own)[1])

    def _begun(self, c: Array) -> Array:
        """A target, run back to the start; what was asked for last is kept."""
        key = c.tobytes(), self._aim
        if self._run_back is None or self._run_back[0] != key:
            self._run_back = key, self._costates(c, np.zeros(len(self.H)))[1]
        return self._run_back[1]

    @cached_property
    def _free(self) -> FreeStart:
        read = self.readings
        H = rows_of_start(self.H, self.F, read.offsets, np.eye(len(self.table.D)))
        return FreeStart(H, read.below, self.scaling.unit)

    def _closed(self, c: Array, gains: Array, rest: Array) -> bool:
        """Whether what gains leave of a free start is rounding."""
        return self._free.closes(gains, self._begun(c), rest) and not self._hidden(c)

    @cached_property
    def _feasible(self) -> bool:
        """Whether the program of the coarsest cells has a solution: without a target, which might be unbounded."""
        posed = self.posed()
        return posed.solver.solve(np.zeros(posed.columns), posed.b)[2] != INFEASIBLE

    def _hidden(self, c: Array) -> bool:
        """Whether a target holds a part of a free start that no reading shows: then no gains prove anything of it."""
        if not self.readings.start.unbounded:
            return False
        with np.errstate(over="ignore", invalid="ignore"):
            return self._free.hides(self._begun(c))

    @cached_property
    def _through(self) -> Array:
        """(K-1, n, n) how a difference of costates passes a time with the filter's gains, and the gap before."""
        H = np.where(self.readings.below[:, None], 0.0, self.H / self.scaling.unit[:, None])
        n = len(self.table.D)
        squares = self.readings.per_time((H[:, :, None] * self.scaling.filter[0][:, None, :]).reshape(len(H), n**2))
        return np.asarray(np.matmul(np.swapaxes(self.F, 1, 2), np.eye(n) - squares.reshape(-1, n, n)[1:]))

    @cached_property
    def _near(self) -> Array:
        """(K, n) a trajectory without w near the readings: states count from it in a program.

        Where states have grown to a million times of what is known of them, a solver's last digits would be seen.
        """
        path = np.zeros((len(self.readings.times), len(self.table.D)))
        with np.errstate(over="ignore", invalid="ignore"):
            path[0] = self._free.start(self.readings.residuals)
            for k, F in enumerate(self.F):
                path[k + 1] = F @ path[k]
        return path if np.isfinite(path).all() else np.zeros_like(path)

    @cached_property
    def _flow_errors(self) -> Array:
        """(K-1, n) errors of the states after each gap, of the terms of F x: where these cancel, they exceed x."""
        held = np.abs(self.readings.nominal) / self.table.D
        moved = np.matmul(np.abs(self.F), (held + np.abs(self._near))[:-1, :, None])[:, :, 0] + held[1:]
        return np.asarray(moved * (FLOW_HELD * np.array([gap.third.size for gap in self.gaps]).reshape(-1, 1)))

    def _costates(self, c: Array, gains: Array) -> tuple[Array, Array]:
        """(K-1, n) costates just after each gap, and the rest at the start."""
        steps = self.readings.per_time(self.H * gains[:, None])
        steps[self._aim] -= c
        found, g = np.empty_like(self.F[:, 0]), np.zeros_like(c)
        for step, costate, F in zip(steps[:0:-1], found[::-1], self.F[::-1], strict=True):
            np.subtract(g, step, costate)
            g = costate.dot(F)
        return found, g - steps[0]

    def upper(self, t: float, row: Array, gains: Array) -> RowEnd:
        """Return what any gains prove of a row at t, without a solver: for all real times, rounded outwards."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self._upper(t, row, gains)

    def _upper(self, t: float, row: Array, gains: Array) -> RowEnd:
        (c, added), read = self._ahead(t, row), self.readings
        residuals, start, w, v, rounded = self.costs(c, gains)
        if self._nominal[0] != t:
            self._nominal = t, read.nominal_at(t)
        nominal = self._nominal[1]
        exact = added + start + w + v
        width = exact * (1 + ROUNDING)
        terms = np.abs(row) @ np.abs(nominal) + np.abs(gains) @ (np.abs(read.y) + np.abs(read.residuals))
        ahead = self.table.open(t - read.times[-1]).third.size if t > read.times[-1] else 0
        held = (self._rounded + FLOW_HELD * ahead) * float(terms) + rounded
        end = float(row @ nominal) + residuals + width + held
        if not np.isfinite(end):
            return RowEnd(np.inf, residuals + width, width, gains)
        return RowEnd(end, residuals + width, width, gains, room=ROUNDING * exact + held)

    def costs(self, c: Array, gains: Array) -> tuple[float, float, float, float, float]:
        """Return what gains cost for a target (n,) in D coordinates at the last time: residuals, start, w and v.

        And the rounding of the flows, which acts on states as w does. Residuals are in units of no bound:
        0 <= residuals + start + w + v + rounding for the row 0.
        """
        read = self.readings
        costates, rest = self._costates(c, gains)
        w = self._quadrature.integral(costates, read.disturbance.ball) if len(costates) else 0.0
        if np.any(gains[read.below] < 0):
            return 0.0, np.inf, w, 0.0, 0.0
        if read.start.unbounded:
            start = 0.0 if self._closed(c, gains, rest) else np.inf
        else:
            start = read.start.support((rest / self.table.D)[: read.plant.n_states])
        rounded = float(np.vdot(np.abs(costates), self._flow_errors))
        return float(gains @ read.residuals), start, w, read.noise(gains), rounded

    def least_growth(self, which: str) -> Array:
        """Return gains for the row 0 that prove best by how much bounds (`WHICH_BOUNDS`) would have to grow.

        Cells become finer until a multiple that suffices is no larger than that but for `CLOSED`, or none is needed.
        Where readings are nearly exact, the solver's digits do not suffice, and gains for exact ones are tried, too.
        """
        gains, enough, zero = np.zeros(len(self.H)), np.inf, np.zeros(len(self.table.D))
        if self._of_exact:
            gains = self._of_exact.least_growth(which)
        best = self.growth(which, gains), gains
        for level in range(LEVELS):
            y, multiple = self._least(level, which)
            if y is not None:
                enough = min(enough, multiple)
                gains = self._steadied(zero, *self.posed(level).read(y))
                best = max(best, (self.growth(which, gains), gains), key=lambda pair: pair[0])
            if y is None or best[0] >= (1 - CLOSED) * enough or enough <= 1:
                break
        return best[1]

    def growth(self, which: str, gains: Array, room: float = 1.0) -> float:
        """Return the factor by which bounds must grow for the data, as gains for the row 0 prove it.

        `room` is the share of what is left to rounding, as `RowEnd.again`.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            residuals, start, w, v, rounded = self.costs(np.zeros(len(self.table.D)), gains)
        fixed = {"all": 0.0, "w": start + v, "v": start + w}[which]
        grown = {"all": start + w + v, "w": w, "v": v}[which]
        error = self._rounded * float(np.abs(gains) @ (np.abs(self.readings.y) + np.abs(self.readings.residuals)))
        error += rounded
        needed = -residuals - fixed * (1 + room * ROUNDING) - room * error
        if not (0 < needed < np.inf and grown < np.inf):
            return 0.0
        return needed / (grown * (1 + room * ROUNDING)) if grown > 0 else np.inf
