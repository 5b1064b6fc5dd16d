"""What an estimate knows: the samples behind it and the bounds; its interval is proven from them when asked for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.accuracy.disproof import Disproof
from sampling_design.accuracy.gap_table import GapTable
from sampling_design.accuracy.interval import Interval, prove
from sampling_design.accuracy.readings import Readings, RowReading, censored_rows
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.estimators.online.estimate import Contradiction, StateTube, open_tube
from sampling_design.estimators.online.history import HistoryNode, InputHistory
from sampling_design.numerics.filtering import correlation_root
from sampling_design.plants.functional import Wanted, requested_rows
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array

SUSPECTS = 5  # samples that are left out in turn to find the one that contradicts the bounds
FACTOR_WITHIN = 1e-3  # share within which the factor is found by which the noise of a sample would have to be larger
FARTHEST = 1e12  # factor beyond which no noise explains a sample
REMEMBERED = 24  # samples that an interval looks back; what came before them is what their first one knew


@dataclass(frozen=True, eq=False)
class EstimateAssumptions:
    """What the truth is taken to keep: bounds on w and v, on the first error, and rows of the state.

    Attributes
    ----------
    plant : Plant
    disturbance, noise : BoundedSet
        The root of the noise is diagonal.
    error : BoundedSet
        Of the prior.
    state : tuple of RowReading
        One-sided rows that the state keeps at all times.
    """

    plant: Plant
    disturbance: BoundedSet
    noise: BoundedSet
    error: BoundedSet
    state: tuple[RowReading, ...] = ()
    _tables: dict[tuple[bytes, ...], GapTable] = field(default_factory=dict, repr=False)
    _latest: dict[EstimateEvidence, RecordProgram] = field(default_factory=dict, repr=False)

    def unread(self, begin: float, inputs: InputHistory, start: BoundedSet | None = None) -> Readings:
        """Return what is known before anything is read, of a state in a set (default: unknown) at a time."""
        known = BoundedSet.of("initial_error", None, self.plant.states.names) if start is None else start
        return Readings.unread(self.plant, self.disturbance, known, begin, self.noise.ball, inputs)

    def program(self, readings: Readings) -> RecordProgram:
        """Return the program of some readings; gaps are shared with those before.

        Not with those of one sample, which say nothing of the states' sizes: in unsuitable ones proofs lose.
        """
        found = RecordProgram(readings, self._tables.get(readings.means))
        if len(readings.times) > 1:
            self._tables.setdefault(readings.means, found.table)
        return found


def output_of(found: Disproof, k: int) -> int:
    """Which output contradicts most among the readings at a place of a disproof; the first where none was read."""
    first, rows = int(found.readings.offsets[k]), found.readings.rows[k]
    shares = np.abs(found.gains["all"][first : first + len(rows)]) * [row.size for row in rows]
    return (rows[int(np.argmax(shares))].output or 0) if rows else 0


class EstimateEvidence:
    """The last samples behind an estimate, with what is assumed of them; nothing is computed before it is asked for."""

    __slots__ = ("assumed", "inputs", "radius_known", "samples")

    def __init__(self, assumed: EstimateAssumptions, nodes: tuple[HistoryNode, ...], inputs: InputHistory, known: bool):
        self.assumed, self.samples, self.inputs, self.radius_known = assumed, nodes, inputs, known

    def rests_on(self, nodes: tuple[HistoryNode, ...], inputs: InputHistory) -> bool:
        """Whether it is what these nodes and inputs prove."""
        return self.samples[0] is nodes[0] and self.samples[-1] is nodes[-1] and inputs is self.inputs

    @property
    def _program(self) -> RecordProgram:
        """The program of its samples. It takes megabytes, so that only that of the evidence asked last is kept."""
        latest = self.assumed._latest
        found = latest.get(self)
        if found is None:
            latest.clear()
            found = latest[self] = self.assumed.program(self._readings())
        return found

    @property
    def contradiction(self) -> Contradiction | None:
        """What is known to contradict the bounds among the samples behind it."""
        return self.samples[-1].contradiction

    @property
    def newly(self) -> bool:
        """Whether the last of the samples is what made them do so."""
        last = self.samples[-1]
        return last.branch.proven_at(last.number)

    def interval(self, t: float, of: Wanted = None, ellipsoid: tuple[Array, Array, float] | None = None) -> Interval:
        """Return the interval of wanted rows at t; `ellipsoid` (x, covariance, radius) holds the state, too."""
        program, rows = self._program, requested_rows(self.assumed.plant, of)
        if self.assumed.state and t > program.readings.times[-1]:
            program = self.assumed.program(self._readings(t))
        outer = None
        if ellipsoid is not None:
            x, covariance, radius = ellipsoid
            with np.errstate(over="raise", invalid="raise"):  # rows beyond all numbers end in a sentence
                z, reach = rows.matrix @ x, np.sqrt(radius) * _deviations(rows.matrix, covariance)
            outer = np.array([z - reach, z + reach]).T
        interval = prove(program, t, rows, outer)
        last = self.samples[-1]
        if interval.disproof is not None and last.contradiction is None:
            last.branch.record(last.number, self._contradiction_of(interval.disproof))
        return interval

    def _contradiction_of(self, found: Disproof) -> Contradiction:
        """Return the sample without which the rest agrees and what its noise would have to be; else the strongest."""
        readings, names = found.readings, self.assumed.plant.outputs.names
        numbers = {sample.t: sample.number for sample in self.samples}
        suspects = [k for k in found.strongest.tolist() if numbers.get(float(readings.times[k])) and readings.rows[k]]

        def named(k: int, factor: float, alone: bool) -> Contradiction:
            t = float(readings.times[k])
            return Contradiction(numbers[t], t, names[output_of(found, k)], factor, alone)

        for k in suspects[:SUSPECTS]:
            if self._agrees(readings, k, np.inf):
                return named(k, self._least(readings, k), True)
        if suspects:
            return named(suspects[0], found.factors["all"], False)
        last = self.samples[-1]
        return Contradiction(last.number, last.t, names[0], found.factors["all"], False)

    def _least(self, readings: Readings, k: int) -> float:
        """The least factor of the noise of the sample at a time with which the readings agree, to `FACTOR_WITHIN`."""
        if not any(row.size for row in readings.rows[k]):
            return np.inf  # exact readings stay exact, however often their noise is taken
        low, high = 1.0, 2.0
        while not self._agrees(readings, k, high):
            low, high = high, 2 * high
            if high > FARTHEST:
                return np.inf
        while high > low * (1 + FACTOR_WITHIN):
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if self._agrees(readings, k, middle) else (middle, high)
        return high

    def _agrees(self, readings: Readings, k: int, factor: float) -> bool:
        """Whether the readings agree with the bounds if the noise of the sample at a time may be so much larger."""
        kept = () if np.isinf(factor) else tuple(row._replace(size=row.size * factor) for row in readings.rows[k])
        rows = (*readings.rows[:k], kept, *readings.rows[k + 1 :])
        if not any(rows):
            return True
        program = self.assumed.program(replace(readings, rows=rows))
        return prove(program, float(readings.times[-1]), requested_rows(self.assumed.plant, None)).disproof is None

    def tube(self, times: Array, x: Array) -> StateTube:
        """Return the tube over increasing times from the last sample on, for estimates x (N, n) there."""
        tube = open_tube(self._program, times, x)
        if self.contradiction is None:
            return tube
        nothing = np.full(tube.lower.shape, np.nan)
        return StateTube(tube.times, nothing, nothing)

    def _readings(self, until: float | None = None) -> Readings:
        first = self.samples[0]
        start = replace(self.assumed.error, centre=first.x)
        if first.number:
            known = self.radius_known and first.stands and bool(np.isfinite(first.beta) and np.isfinite(first.Y).all())
            Y = first.beta * first.Y if known else np.zeros_like(first.Y)
            root = correlation_root(Y, len(Y) * np.finfo(float).eps) if known else Y
            start = BoundedSet(first.x, root, ball=known, unbounded=not known)
        if start.unbounded and first.box is not None:
            start = first.box
        rows: dict[float, tuple[RowReading, ...]] = {}
        for sample in self.samples:
            rows[sample.t] = (*rows.get(sample.t, ()), *self._rows(sample), *self.assumed.state)
        if until is not None:
            rows[until] = self.assumed.state
        return self.assumed.unread(first.t, self.inputs, start).reading(sorted(rows.items()))

    def _rows(self, node: HistoryNode) -> tuple[RowReading, ...]:
        C, noise, sizes = self.assumed.plant.C, self.assumed.noise, self.assumed.noise.half_widths
        y = node.y - node.feedthrough - noise.centre
        rows = [RowReading(C[i], float(y[i]), float(sizes[i]), output=int(i)) for i in np.flatnonzero(node.mask)]
        first = self.samples[0].t
        for each in node.sample.censored:
            if each.since is None or each.since >= first:
                size, centre = float(sizes[each.output]), float(noise.centre[each.output])
                direct = float(node.feedthrough[each.output])
                rows += censored_rows(self.assumed.plant, node.t, each, size, centre, tuple(self.inputs), direct)
        return tuple(rows)


def _deviations(rows: Array, Y: Array) -> Array:
    """sqrt(c'Yc) of each row, also where the squares of its terms overflow, and no less than rounding leaves of it."""
    size = np.sqrt(np.maximum(np.diag(Y), 0.0))
    unit = np.where(size > 0, size, 1.0)
    terms = rows * size
    largest = np.abs(terms).max(axis=1, initial=0.0)
    shares = terms / np.where(largest > 0, largest, 1.0)[:, None]
    square = np.einsum("ri,ij,rj->r", shares, Y / unit[:, None] / unit, shares)
    lost = len(Y) * np.finfo(float).eps * np.sum(np.abs(shares), axis=1) ** 2
    return np.asarray(largest * np.sqrt(np.maximum(square, 0.0) + lost))
