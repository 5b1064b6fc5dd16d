"""What is asked: a plant, a schedule with or without an end, bounds, and what is known at the start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.accuracy.bounded_directions import BoundedDirections
from sampling_design.accuracy.bounds import Bound, InitialSet, NoiseBound, SignalBounds
from sampling_design.accuracy.finite import FiniteDirections, finite_system
from sampling_design.accuracy.results_out import with_branches, with_results_out
from sampling_design.accuracy.sampled_system import SampledSystem, periodic_system
from sampling_design.accuracy.undetectable import DetectablePart, known_part, lasting_part
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, freeze
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.schedules.sensor import Sensor, result_span


def terms_of_sensors(plant: Plant, v_bound: NoiseBound) -> tuple[Bound, Array | None]:
    """Return bounds on the noise, and how long results are out at most (p,), of bounds that may name a `Sensor`.

    None where all results come at once.
    """
    if not isinstance(v_bound, Mapping):
        return v_bound, None
    bounds, delays = dict[str, float | tuple[float, float]](), np.zeros(plant.n_outputs)
    for name, term in v_bound.items():
        if not isinstance(term, Sensor):
            bounds[name] = term
            continue
        checks.known_keys("`v_bound`", v_bound, plant.outputs.names)
        bounds[name] = term.sure_bound
        if term.result_delay is not None:
            at = plant.outputs.names.index(name)
            delays[at] = result_span("result_delay", term.result_delay, plant.time_unit)[1]
    return bounds, freeze(delays) if delays.any() else None


@dataclass(frozen=True, eq=False)
class AccuracyQuestion:
    """A plant, a schedule and bounds."""

    plant: Plant
    schedule: Schedule | PeriodicSchedule
    bounds: SignalBounds  # one row of v for each node
    initial: InitialSet | None  # None: the schedule is endless
    # (N,): sample times of the period; of a finite schedule its start, which may be a sample, and its samples. Where
    # these come early or late, their centres, or as much after these as the tolerance was `moved`
    nodes: Array
    end: float  # of the period that begins at the first node, or of the finite schedule
    timing_tolerance: TimingTolerance = ON_TIME
    result_delay: Array | None = None  # (p,): how long after its sample a result comes at most; None: at once

    @classmethod
    def of(
        cls, plant: Plant, schedule: Schedule | PeriodicSchedule, w_bound: Bound, v_bound: NoiseBound,
        initial_error: VectorBound = None, start: float | None = None, end: float | None = None,
        late: TimingTolerance = ON_TIME,
    ) -> AccuracyQuestion:  # fmt: skip
        """Ask about a schedule of either kind, whose samples may be so early or late, and results so much later.

        A periodic one has been under way for so long that its start no longer matters. A finite one lasts from `start`
        (default: its first sample) to `end` (default: its last result).

        Raises ArgumentError if an endless one is given a start, an end or an initial error, if a sample lies outside,
        or a bound is missing or of another shape.
        """
        v_bound, comes_later = terms_of_sensors(plant, v_bound)
        times, p = schedule.times, plant.n_outputs
        if schedule.endless:
            given = [n for n, x in (("initial_error", initial_error), ("start", start), ("end", end)) if x is not None]
            if given:
                raise ArgumentError(
                    f"`{given[0]}` is for finite schedules, got a PeriodicSchedule, which has no start. "
                    "Cut it: schedule.between(start, end)."
                )
            bounds = SignalBounds.of(plant, len(schedule), schedule.outputs, w_bound, v_bound, times)
            last = float(times[0] + schedule.period) + late.shift
            return cls(plant, schedule, bounds, None, freeze(times + late.shift), last, late, comes_later)
        if not times.size:
            raise ArgumentError("`schedule` must have at least one sample, got none.")
        mask = np.ones((times.size, p), dtype=bool) if schedule.outputs is None else schedule.outputs
        delays = np.zeros(p) if comes_later is None else comes_later
        comes = np.where(mask, delays + late.late, max(late.late))
        first = float(times[0]) if start is None else checks.number("start", start)
        last = float(np.max(times + comes.max(axis=1, initial=0.0))) if end is None else checks.number("end", end)
        if first > times[0]:
            raise ArgumentError(f"`start` must not lie after the first sample {float(times[0])!r}, got {first!r}.")
        if last < times[-1]:
            raise ArgumentError(
                f"`end` must not lie before the last sample {float(times[-1])!r}, got {last!r}. "
                "Cut the schedule: schedule.between(start, end)."
            )
        bounds, nodes = SignalBounds.of(plant, times.size, mask, w_bound, v_bound, times), times + late.shift
        if first < times[0]:
            v, middle = np.vstack([np.full((1, p), np.inf), bounds.v]), bounds.v_centre
            centre = None if middle is None else freeze(np.vstack([np.zeros((1, p)), middle]))
            bounds, nodes = replace(bounds, v=freeze(v), v_centre=centre), np.append(first, nodes)
        initial = InitialSet.of(plant, initial_error)
        return cls(plant, schedule, bounds, initial, freeze(nodes), last, late, comes_later)

    def primitive(self) -> AccuracyQuestion:
        """The same question over the shortest period that samples and bounds on their noise have."""
        if not self.schedule.endless:
            return self
        found, count = self.schedule.primitive(), len(self.schedule)
        part = len(found)
        for rows in (self.bounds.v, self.bounds.v_centre):
            if rows is not None and not np.array_equal(np.tile(rows[:part], (count // part, 1)), rows):
                return self
        if part == count:
            return self
        middle = None if self.bounds.v_centre is None else freeze(self.bounds.v_centre[:part])
        bounds = replace(self.bounds, v=freeze(self.bounds.v[:part]), v_centre=middle)
        nodes = found.times + self.timing_tolerance.shift
        return replace(self, schedule=found, bounds=bounds, nodes=freeze(nodes), end=float(nodes[0] + found.period))

    def about(self, by: float) -> AccuracyQuestion:
        """The same question about samples that are counted so much after their centres, at a time that all allow."""
        late, nodes = self.timing_tolerance, self.nodes.copy()
        nodes[self.samples] += by
        end = self.end + by * (self.initial is None)
        return replace(self, nodes=freeze(nodes), end=end, timing_tolerance=replace(late, moved=late.moved + by))

    def fits_schedule(self) -> bool:
        """Whether its nodes are the samples of the schedule, where these are looked at, and measure no more."""
        times, mask = self.schedule.times + self.timing_tolerance.shift, self.schedule.outputs
        end = float(times[0] + self.schedule.period) if self.schedule.endless else self.end
        planned, mine = np.append(times, end), np.append(self.nodes[self.samples], self.end)
        measured = np.isfinite(self.bounds.v[self.samples])
        less = mask is None or not np.any(measured & ~mask)
        return less and bool(np.all(np.abs(mine - planned) <= 4 * np.spacing(np.abs(planned).max())))

    def is_same(self, other: AccuracyQuestion) -> bool:
        """Whether both ask the same of the same dynamics."""
        mine, theirs = (
            [q.nodes, q.end, q.result_delay, *vars(q.bounds).values(), *vars(q.initial or q.bounds).values()]
            for q in (self, other)
        )
        alike = self.plant.same_dynamics(other.plant) and self.timing_tolerance == other.timing_tolerance
        return alike and all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))

    def noisier(self, noise: Array | None) -> AccuracyQuestion:
        """The same question with so much more noise (N, p)."""
        return self if noise is None else replace(self, bounds=replace(self.bounds, v=freeze(self.bounds.v + noise)))

    @property
    def is_late(self) -> bool:
        """Whether samples may come late, or results come later than they."""
        return bool(self.timing_tolerance) or self.result_delay is not None

    @property
    def comes_after(self) -> Array:
        """How long after each node the result of an output is in at the latest (N, p).

        Infinite where it is not measured.
        """
        delays = np.zeros(self.plant.n_outputs) if self.result_delay is None else self.result_delay
        return np.where(np.isfinite(self.bounds.v), self.timing_tolerance.forward + delays, np.inf)

    @property
    def last_result(self) -> float:
        """When the last result of a finite schedule is in."""
        comes = self.comes_after
        return float(np.max(self.nodes[:, None] + np.where(np.isfinite(comes), comes, 0.0)))

    def time_of(self, system: SampledSystem, node: int) -> float:
        """The time of the sample that a node of the system is, where it is judged."""
        planned = float(self.nodes[system.sample_of(node)])
        turns = np.round((system.judged[node].time - (planned - self.nodes[0])) / (self.end - self.nodes[0] or 1.0))
        return planned + float(turns) * float(self.end - self.nodes[0]) * (self.initial is None)

    @property
    def gaps(self) -> Array:
        """(N,): lengths of the gaps behind the nodes."""
        return np.diff(self.nodes, append=self.end)

    @property
    def samples(self) -> Index:
        """Nodes that are samples."""
        return np.arange(self.nodes.size - len(self.schedule), self.nodes.size)

    def known(self) -> DetectablePart:
        """The plant without what an endless schedule can never show."""
        if not self.schedule.endless:
            n = self.plant.n_states
            return DetectablePart(self.plant, np.eye(n), np.zeros((n, 0)), ())
        outputs = [self.bounds.measured(j) for j in range(self.nodes.size)]
        return known_part(self.plant, self.nodes, float(self.end - self.nodes[0]), outputs)

    def lasting(self, noise: Array | None = None) -> DetectablePart:
        """The same without what an endless past has left nothing of: where nothing drives the plant, what decays.

        With white noise of root `noise` (q, k) in place of w, what it does not reach and what does not grow.
        """
        known, driven = self.known(), self.plant.G * self.bounds.w
        if not self.schedule.endless or known.moving is not None or not known.plant.n_states:
            return known
        if noise is None and (driven.any() or self.bounds.w_centre is not None):
            return known
        reached = None if noise is None else known.plant.G @ noise
        left = lasting_part(known.plant, float(self.end - self.nodes[0]), reached)
        return known if left is None else replace(known, plant=left.plant, lift=known.lift @ left.lift)

    def filter_bounds(
        self, plant: Plant, moving: Array | None = None
    ) -> tuple[SampledSystem, Sequence[BoundedDirections]]:
        """The system whose gap j lies behind node j, and what its filter bounds; `plant` is the known part.

        `moving` (n, m) is what no sample of an endless schedule shows, as it is at the first one.
        """
        if self.initial is not None:
            system = finite_system(plant, self.nodes, self.end, self.bounds, self.initial)
        else:
            system = periodic_system(plant, self.gaps, self.bounds, moving)
        if self.is_late:
            system = with_results_out(system, self.comes_after)
        if system.start is not None:
            return system, with_branches(system, FiniteDirections(system))
        r = system.determined
        directions = [BoundedDirections(np.eye(plant.n_states)[:, :r], reach[:r]) for reach in system.reach]
        return system, with_branches(system, directions)
