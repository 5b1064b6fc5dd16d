"""What may happen: bounds on noise and initial error, trials within them, and records simulated exactly.

And runs of a real estimator, sample by sample and through its protocol only, beside a truth that is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import input_at
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.estimator import Estimator, estimate_from
from sampling_design.estimators.online.verdict import ROUNDED
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.numerics.filtering import inverse_root
from sampling_design.plants.plant import Plant, remade
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.declarations import Column, selected
from sampling_design.records.record import Plain, TableRecord, counted, short
from sampling_design.records.signatures import checked
from sampling_design.records.vector_bounds import VectorBound, vector_bound
from sampling_design.schedules.family import AnySchedule
from sampling_design.validation.timeline import Timeline, build_timeline, exact_flow

KINDS = ("white", "steady", "held", "sine")
"""How a random disturbance moves: anew in each cell, never, once in a while, or at one frequency."""

NOISES = ("independent", "extremal", "constant")
"""How random noise varies: drawn anew within its bound at each sample, anew on it, or once on it for all samples."""

UNMOVED = 1e-12  # share of what the strongest disturbance does to a mode below which another one does nothing to it


class ErrorSources(NamedTuple):
    """Something for each source of an error: the first error e0, the disturbance w, the noise v.

    Of r runs their inputs: e0 (r, n), w (r, T, q) constant over each cell, v (r, N, p). Of an error
    at one time what each of them adds, matrices to be multiplied by it: e0 (n, n), w (T, n, q), v (N, n, p).
    """

    e0: Array
    w: Array
    v: Array


class ScenarioBounds(ErrorSources):
    """Bounds on x(0) - prior, w(t) and v: 0-d arrays bound the Euclidean norm, vectors each entry."""

    @classmethod
    def of(
        cls, plant: Plant, w_bound: VectorBound = None, v_bound: VectorBound = None, initial_error: VectorBound = None
    ) -> ScenarioBounds:
        """Return checked bounds; where None is given, the plant's scales, entry by entry.

        Raises ArgumentError if a bound is negative or has another length.
        """
        signals = plant.disturbances, plant.outputs, plant.states
        given = {"w_bound": w_bound, "v_bound": v_bound, "initial_error": initial_error}
        pairs = zip(given.items(), signals, strict=True)
        w, v, e0 = (s.scales if bound is None else vector_bound(key, bound, s.names) for (key, bound), s in pairs)
        return cls(e0, w, v)

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return selected(self, "w_bound:w v_bound:v initial_error:e0")


def scaled_to(bound: Array, raw: Array) -> Array:
    """Return the signals (..., m) shrunk or stretched until their largest value over all but the last axis meets it."""
    if raw.shape[-1] == 0:
        return raw
    if bound.ndim == 0:
        size = float(np.max(np.linalg.norm(raw, axis=-1), initial=0.0))
        return raw * (bound / size) if size > 0 else raw
    room = np.divide(bound, np.abs(raw), out=np.full(raw.shape, np.inf), where=np.abs(raw) > 0)
    return raw * float(np.min(room)) if np.isfinite(room).any() else raw


def most_along(bound: Array, direction: Array) -> Array:
    """Return, for each (..., m) direction, the signal within the bound whose product with it is largest."""
    if bound.ndim == 1:
        return bound * np.sign(direction)
    largest = np.abs(direction).max(axis=-1, keepdims=True, initial=0.0)  # of faded ones no square is a double
    unit = direction / np.where(largest > 0, largest, 1.0)
    return np.where(largest > 0, bound * unit / np.maximum(np.linalg.norm(unit, axis=-1, keepdims=True), 1.0), 0.0)


def within(bound: Array, raw: Array) -> Array:
    """Return (..., m) normal draws as signals within the bound, half of them on it."""
    if bound.ndim == 1:
        return bound * np.clip(raw / 0.6745, -1.0, 1.0)
    size = np.linalg.norm(raw, axis=-1, keepdims=True)
    typical = np.sqrt(max(raw.shape[-1] - 2 / 3, 0.4549))  # median of the norm, near enough
    return np.asarray(bound * raw / np.maximum(size, typical))


def norm_of(bound: Array) -> float:
    """Return the largest Euclidean norm within the bound."""
    return float(bound) if bound.ndim == 0 else float(np.linalg.norm(bound))


def draw_inputs(
    line: Timeline, bounds: ScenarioBounds, seeds: Sequence[np.random.SeedSequence], noise: str | None = None
) -> ErrorSources:
    """Return random inputs within the bounds, one run per seed; of any kind, the noise unless one is named.

    Half of the runs have independent noise, a quarter extremal and a quarter constant.
    """
    plant = line.plant
    n, q, p = plant.n_states, plant.n_disturbances, plant.n_outputs
    e0, w = np.empty((len(seeds), n)), np.empty((len(seeds), line.cells, q))
    v = np.empty((len(seeds), line.samples.size, p))
    for k, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        e0[k] = within(bounds.e0, rng.normal(size=n))
        w[k] = _disturbance(line, bounds.w, rng)
        share = rng.random()
        kind = noise or NOISES[2 if share < 0.25 else 1 if share < 0.5 else 0]
        v[k] = _noise(bounds.v, kind, v[k].shape, rng)
    return ErrorSources(e0, w, v * line.masks)


def _noise(bound: Array, kind: str, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    if kind == "independent":
        return within(bound, rng.normal(size=shape))
    drawn = rng.choice([-1.0, 1.0], size=shape[-1] if kind == "constant" else shape)
    return most_along(bound, np.broadcast_to(drawn, shape))


def _disturbance(line: Timeline, bound: Array, rng: np.random.Generator) -> Array:
    q, kind = line.plant.n_disturbances, KINDS[rng.integers(len(KINDS))]
    if kind == "white":
        return within(bound, rng.normal(size=(line.cells, q)))
    if kind == "steady":
        return np.tile(most_along(bound, rng.normal(size=q)), (line.cells, 1))
    middles = (line.times[1:] + line.times[:-1]) / 2
    if kind == "held":
        edges = np.sort(rng.uniform(0.0, line.times[-1], size=rng.integers(1, 30)))
        levels = most_along(bound, rng.normal(size=(edges.size + 1, q)))
        return np.asarray(levels[np.searchsorted(edges, middles)])
    speed = np.exp(rng.uniform(np.log(2 * np.pi / line.times[-1]), np.log(np.pi / np.median(line.lengths))))
    wave = np.cos(speed * middles[:, None] + rng.uniform(0, 2 * np.pi, size=q))
    return np.asarray(wave * most_along(bound, rng.normal(size=q)))


def resonant_inputs(line: Timeline, bounds: ScenarioBounds) -> tuple[ErrorSources, tuple[str, ...]]:
    """Return disturbances in step with each mode (two phases for a swinging one), from rest and without noise.

    The amplitude l'x of a mode with left eigenvector l obeys a' = lambda a + l'G w; driven with
    w = Re(conj(l'G) e^{i (Im lambda t + phase)}) it grows as fast as the bound on w allows.
    """
    plant = line.plant
    values, left = np.linalg.eig(plant.A.T)
    middles = (line.times[1:] + line.times[:-1]) / 2
    waves, names = [], []
    for value, row in zip(values, left.T, strict=True):
        if value.imag < 0:
            continue
        along = np.conj(row @ plant.G)
        sizes = np.abs(along) * bounds.w
        first = along[int(np.argmax(sizes))] if sizes.any() else 1.0
        along = along * (np.abs(first) / first)  # an eigenvector has any phase: that of the entry that moves it most
        for phase in (0.0, np.pi / 2) if value.imag > 0 else (0.0,):
            raw = np.real(np.exp(1j * (value.imag * middles + phase))[:, None] * along)
            if bounds.w.ndim == 0:
                wave = np.where(np.abs(raw) > UNMOVED * np.abs(raw).max(initial=0.0), raw, 0.0)
            else:  # boxes: each entry swings up to its own bound, if it moves the mode at all
                moves = np.abs(along) * bounds.w
                live = moves > UNMOVED * moves.max(initial=0.0)
                wave = np.where(live, raw / np.where(live, np.abs(along), 1.0), 0.0) * bounds.w
            waves.append(scaled_to(bounds.w, wave))
            names.append(f"{short(value.imag, 4)} rad per {plant.time_unit}, phase {short(phase, 3)}")
    runs = len(waves)
    quiet = np.zeros((runs, line.samples.size, plant.n_outputs))
    return ErrorSources(np.zeros((runs, plant.n_states)), np.array(waves).reshape(runs, line.cells, -1), quiet), tuple(
        names
    )


def initial_inputs(line: Timeline, bounds: ScenarioBounds) -> ErrorSources:
    """Return initial errors along each state, both at once with all signs of the first two, and nothing else."""
    n = line.plant.n_states
    directions = np.vstack([np.eye(n), np.ones(n), np.where(np.arange(n) % 2, -1.0, 1.0)])
    e0 = np.array([most_along(bounds.e0, row) for row in directions])
    quiet = np.zeros((e0.shape[0], line.samples.size, line.plant.n_outputs))
    return ErrorSources(e0, np.zeros((e0.shape[0], line.cells, line.plant.n_disturbances)), quiet)


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedRecord(TableRecord):
    """A record whose truth is known.

    Attributes
    ----------
    measurements : Measurements
    times : (T+1,), states : (T+1, n) arrays
        The truth, between samples too.
    at : (N,) array
        Place of each sample in `times`.
    w : (T, q), v : (N, p) arrays
        Disturbance, constant over each cell between two of the times, and measurement noise.
    noise : str
        Its kind: "independent", "extremal" or "constant".
    """

    measurements: Measurements
    times: Array
    states: Array
    at: Index
    w: Array
    v: Array
    noise: str = "independent"

    def _columns(self) -> dict[str, Column]:
        record = self.measurements
        plant = cast("Plant", record.plant)
        read = {name: record.y[record.measured.any(axis=1), i] for i, name in enumerate(plant.outputs.names)}
        truth = {f"true {name}": self.truth[:, i] for i, name in enumerate(plant.states.names)}
        return {"time": self.times[self.at], **read, **truth}

    @property
    def truth(self) -> Array:
        """States at the samples, (N, n)."""
        return self.states[self.at]

    def _rows(self) -> list[tuple[str, str]]:
        largest = short(np.max(np.abs(self.w), axis=0)) if self.w.size else "-"
        return [*self.measurements._rows(), ("largest w", largest), ("largest v", short(np.nanmax(np.abs(self.v))))]

    def explain(self) -> str:
        """Say what was simulated."""
        span = f"{short(self.times[-1])} {self.measurements.plant.time_unit}"
        count = counted(len(self.at), "sample")
        return f"{count} of a simulated truth over {span}, exact up to rounding, with {self.noise} noise."


@checked
def simulate_record(
    plant: Plant,
    schedule: AnySchedule,
    duration: float,
    *,
    x0: npt.ArrayLike | None = None,
    inputs: Sequence[tuple[float, npt.ArrayLike]] = (),
    w_bound: VectorBound = None,
    v_bound: VectorBound = None,
    noise: str = "independent",
    rng: checks.Seed = None,
) -> SimulatedRecord:
    """Simulate a plant on a schedule, exactly: w is constant over cells much shorter than the gaps.

        x' = Ax + Bu + Gw,    y = Cx + Du + v at the samples

    Parameters
    ----------
    plant : Plant
    schedule : Schedule or PeriodicSchedule
    duration : float [time]
    x0 : (n,) array, optional
        Default 0.
    inputs : sequence of (t, u), optional
        From t on u holds; before the first, zero.
    w_bound, v_bound : float or array, optional
        A number bounds the norm, a vector each entry. Default: the plant's scales.
    noise : "independent", "extremal" or "constant"
        Drawn anew within its bound at each sample, anew on its bound, or once on its bound for all samples.
    rng : numpy.random.Generator or its seed, optional
        Default seed 0.

    Returns
    -------
    SimulatedRecord

    Raises
    ------
    ArgumentError
        If a bound is negative, x0 or u has another length, the schedule does not fit, or the state grows beyond all
        numbers.

    Examples
    --------
    >>> from sampling_design import Plant, PeriodicSchedule
    >>> record = simulate_record(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([0.7]), 7.1)
    >>> len(record.measurements), bool(abs(record.v).max() <= 1.0)
    (10, True)
    """
    seed = checks.generator(rng).bit_generator.seed_seq.spawn(1)  # type: ignore[attr-defined]
    bounds = ScenarioBounds.of(plant, w_bound, v_bound)
    line = build_timeline(plant, schedule, duration)
    drawn = draw_inputs(line, bounds, seed, checks.word("noise", noise, NOISES))
    changes = _inputs(plant, inputs)
    start = np.zeros(plant.n_states) if x0 is None else checks.vector("x0", x0, plant.n_states)
    states = _trajectory(line, start, drawn.w[0], changes)
    return _measured(line, states, drawn, changes, noise)


def _inputs(plant: Plant, given: Sequence[tuple[float, npt.ArrayLike]]) -> list[tuple[float, Array]]:
    pairs = [checks.entries("inputs", pair, (2,), "pairs (t, u)") for pair in given]
    checked = [(checks.number("inputs", t), checks.vector("inputs", u, plant.n_inputs)) for t, u in pairs]
    return sorted(checked, key=lambda pair: pair[0])


def _trajectory(line: Timeline, x: Array, w: Array, changes: list[tuple[float, Array]]) -> Array:
    """States at the break points; a cell in which u changes is crossed in parts."""
    plant, breaks, F, gamma = line.plant, line.times, line.F, line.gamma
    edges, driven = breaks, None
    if changes:
        given = np.array([t for t, _ in changes])
        edges = np.union1d(breaks, given[(given > breaks[0]) & (given < breaks[-1])])
        F, both = exact_flow(plant, np.diff(edges), np.hstack([plant.G, plant.B]))
        gamma, driven = np.split(both, [plant.G.shape[1]], axis=2)
        u = np.array([input_at(changes, t, plant.n_inputs) for t in edges.tolist()])
    states, cell = np.empty((breaks.size, x.size)), np.searchsorted(breaks, edges, side="right") - 1
    states[0] = x
    with np.errstate(over="ignore", invalid="ignore"):
        for k, c in enumerate(cell[:-1].tolist()):
            x = F[k] @ x + gamma[k] @ w[c]
            if driven is not None:
                x = x + driven[k] @ u[k]
            if cell[k + 1] > c:
                states[c + 1] = checked_state(line, breaks[c + 1], x)
    return states


def checked_state(line: Timeline, t: float, x: Array) -> Array:
    """Return a state of a simulation; raise ArgumentError where it has grown beyond all numbers."""
    if not np.isfinite(x).all():
        raise ArgumentError(
            "`duration` must end before the state grows beyond all numbers, at "
            f"t = {short(t)} {line.plant.time_unit}. Simulate less of it."
        )
    return x


def _measured(
    line: Timeline, states: Array, drawn: ErrorSources, changes: list[tuple[float, Array]], noise: str
) -> SimulatedRecord:
    """Put outputs at the samples and inputs at their times into one record, in order of time."""
    plant, when = line.plant, line.times[line.samples]
    stamps = np.unique(np.concatenate([when, [t for t, _ in changes], [0.0] if plant.n_inputs else []]))
    y = np.full((stamps.size, plant.n_outputs), np.nan)
    u = np.array([input_at(changes, t, plant.n_inputs) for t in stamps]).reshape(stamps.size, plant.n_inputs)
    outputs = states[line.samples] @ plant.C.T + drawn.v[0]
    rows = np.searchsorted(stamps, when)
    y[rows] = np.where(line.masks > 0, outputs + u[rows] @ plant.D.T, np.nan)
    record = Measurements(plant, stamps, y, u)
    return SimulatedRecord(
        record, line.times, states, line.samples, drawn.w[0], np.where(line.masks > 0, drawn.v[0], 0.0), noise
    )


GROWTH = 3.0  # a truth that would grow by more than e^3 in a run is held near zero by a known input


def driven(plant: Plant) -> Plant:
    """Return the plant with an input on every state in place of its own: only that moves an unstable truth about."""
    n = plant.n_states
    return remade(plant, B=np.eye(n), D=np.zeros((plant.n_outputs, n)), inputs=None)


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """A run's true states (T+1, n), outputs (N, p) with NaN where not measured, and inputs (N+1, n), from 0 and each
    each sample on (None where the plant needs none). The prior is 0: the truth starts at minus the initial error. The
    `rounding` (T+1, n) of the states is what all steps until then add up to where nothing grows: at least that."""

    states: Array
    rounding: Array
    y: Array
    u: Array | None


class EstimatedRun(NamedTuple):
    """Estimates at every row of a timeline, the true states (R, n) beside them, and their own rounding (R, n)."""

    estimates: tuple[Estimate, ...]
    states: Array
    rounding: Array

    @property
    def errors(self) -> Array:
        """Errors at the rows, (R, n)."""
        return np.array([e.x for e in self.estimates]) - self.states

    @property
    def ratios(self) -> Array:
        """How far the truth is out in each ellipsoid, (R,): at most 1 where it holds, whatever its rounding."""
        return np.array([_ratio(*each) for each in zip(self.estimates, self.states, self.rounding, strict=True)])

    @property
    def certified(self) -> Mask:
        """Which estimates say that their ellipsoid is proven, (R,); one without an end says nothing."""
        return np.array([bool(e.certified and e.radius != np.inf) for e in self.estimates])


def _ratio(estimate: Estimate, truth: Array, rounding: Array) -> float:
    """The ratio of a truth that is known to its rounding, entry by entry: of the nearest one that it may be."""
    found = estimate.ratio(truth)
    if not found > 1:
        return found
    half = inverse_root(estimate.covariance)
    away = float(np.linalg.norm(half @ (truth - estimate.x)) - np.linalg.norm(np.abs(half) @ rounding))
    if away <= 0:  # of what has shrunk to a point, too
        return 0.0
    return away**2 / estimate.radius if estimate.radius > 0 and away < np.inf else found


def true_run(line: Timeline, inputs: ErrorSources, run: int = 0, *, steered: bool = True) -> SimulatedRun:
    """Simulate the truth of one run of `inputs`, exactly; an unstable one that is `steered` is brought back to zero at
    each sample.

    Raises ArgumentError if it grows beyond all numbers.
    """
    plant = line.plant
    pace = float(np.max(np.linalg.eigvals(plant.A).real, initial=0.0))
    steered = steered and pace * line.times[-1] > GROWTH
    marks = np.unique(np.concatenate([[0], line.samples, [line.cells]]))
    through = exact_flow(plant, line.lengths, np.eye(plant.n_states))[1]
    x, u = -inputs.e0[run], np.zeros(plant.n_states)
    states, outputs, applied = np.empty((line.times.size, x.size)), [], []
    sizes = np.abs(np.broadcast_to(x, states.shape))
    for b in range(line.times.size):
        if b:
            led = np.abs(line.F[b - 1]) @ np.abs(x) + np.abs(line.gamma[b - 1]) @ np.abs(inputs.w[run, b - 1])
            sizes[b] = led + np.abs(through[b - 1]) @ np.abs(u)
            x = line.F[b - 1] @ x + line.gamma[b - 1] @ inputs.w[run, b - 1] + through[b - 1] @ u
        states[b] = checked_state(line, line.times[b], x)
        if b in line.sample_at:
            j = line.sample_at[b]
            outputs.append(np.where(line.masks[j] > 0, plant.C @ x + inputs.v[run, j], np.nan))
        if steered and b in marks[:-1]:
            until = line.times[marks[np.searchsorted(marks, b) + 1]]
            F, G = exact_flow(plant, np.array([until - line.times[b]]), np.eye(x.size))
            u = np.linalg.lstsq(G[0], -checked_state(line, until, F[0] @ x), rcond=None)[0]
        if b in marks:
            applied.append(u)
    first = 1 if line.samples[0] > 0 else 0
    rounding = ROUNDED * np.arange(1, line.times.size + 1)[:, None] * (sizes + np.abs(states))
    given = np.array(applied)[: len(outputs) + first] if steered else None
    return SimulatedRun(states, rounding, np.array(outputs), given)


def real_run(line: Timeline, truth: SimulatedRun, estimator: Estimator) -> EstimatedRun:
    """Feed a truth's outputs to an estimator and ask it at every row."""
    first = 1 if line.samples[0] > 0 else 0
    if truth.u is not None and first:
        estimator.update(0.0, None, truth.u[0])
    estimates: list[Estimate] = []
    j = 0
    for b, after in zip(line.rows.at, line.rows.after, strict=True):
        t = float(line.times[b])
        if after and j < line.samples.size and b == line.samples[j]:
            came = estimator.update(t, truth.y[j], None if truth.u is None else truth.u[j + first])
            j += 1
        else:
            came = estimator.predict(t)
        estimates.append(estimate_from(came, t, truth.states.shape[1]))
    return EstimatedRun(tuple(estimates), truth.states[line.rows.at], truth.rounding[line.rows.at])


def extent(states: Array, room: float = 0.0) -> tuple[Array, Array]:
    """Return a box that holds states (R, n) and the prior 0, wider by `room` times its size."""
    low = np.minimum(states.min(axis=0), 0.0)
    high = np.maximum(states.max(axis=0), 0.0)
    wide = room * (high - low)
    return low - wide, high + wide
