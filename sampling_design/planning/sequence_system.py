"""A sequence of samples as a sampled system in the plan's coordinates: what is the plan's in it is not made again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from sampling_design.accuracy import sampled_system
from sampling_design.accuracy.between_samples import KnownIntegrals
from sampling_design.accuracy.bounded_directions import BoundedDirections, GapProof, combined
from sampling_design.accuracy.bounds import InitialSet, noise_units
from sampling_design.accuracy.finite import DIFFUSE, NO_ERROR, FiniteDirections, coordinate_root, start_covariance
from sampling_design.accuracy.gains import RepeatedIntegrals
from sampling_design.accuracy.gap_table import GapTable
from sampling_design.accuracy.results_out import with_branches, with_results_out
from sampling_design.accuracy.sampled_system import GapDynamics, MeasurementModel, SampledSystem
from sampling_design.accuracy.search import GainSearch
from sampling_design.accuracy.timing import MORE as NOISE_MORE
from sampling_design.accuracy.timing import moved_row
from sampling_design.errors import NotDetectableError, UndecidedError
from sampling_design.numerics.filtering import covariance_root, information_update, propagate, update_with_gain
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.search_progress import GAINS, SYSTEM
from sampling_design.planning.sequence_deviation import GRAIN, SampleSequence, phase_of
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.units import spoken

UNKNOWN = 1e6
"""What is not known of the error at a plan's start is at most so many times what its filter leaves later on: rounding
would hide how states of any size decay."""

AHEAD = 8  # samples after a change whose noise is sought first
FARTHER = 4  # so many times as many are then looked at
FADES = 0.8  # what noise after a change leaves of itself from one sample to the next, as a guess
CLOSE = 4.0  # where a filter's covariance is at most so many times the plan's own, the plan's coordinates serve as well
TURNS = 120  # times that the noise which early and late samples stand for is sought along a sequence

SETTLED = 1 + NOISE_MORE / 4
"""Where the error is at most so many times what the plan leaves, the noise that it proved to be enough is: it left room
for more."""

MORE = 1.01  # so many times what they add, where the noise was not enough
FEWEST = 8  # samples back of the gains that bound what they add, at least
LEAST = 1e-12  # half-width of what is known exactly at the start, as a share of the largest


@lru_cache(maxsize=4)
def plan_bounds(plan: PlanFigures) -> tuple[SampledSystem, Sequence[BoundedDirections]]:
    """The plan's samples with the filter whose gains bound the error once and for all, and what it bounds.

    Raises NotDetectableError if the plan leaves a part of the state unknown for ever: then nothing bounds what a change
    does to it.
    """
    assert plan.accuracy is not None
    question = plan.accuracy.question.noisier(plan.accuracy.noise)
    known = question.known()
    if known.modes:
        raise NotDetectableError(
            f"`plan` never shows {', '.join(known.modes)}: what a change of its samples does is not bounded."
        )
    return question.filter_bounds(plan.plant)


def plan_system(plan: PlanFigures) -> SampledSystem:
    """The same samples. Raises NotDetectableError as `plan_bounds` does."""
    return plan_bounds(plan)[0]


@lru_cache(maxsize=4)
def repeated_integrals(plan: PlanFigures) -> RepeatedIntegrals:
    """What w adds over the plan's gaps, which all sequences share."""
    return RepeatedIntegrals(plan_system(plan).gaps)


def sequence_system(
    plan: PlanFigures, sequence: SampleSequence, settles: int = 1, *, limited: bool = True, until: float = -np.inf
) -> tuple[SampledSystem, Sequence[BoundedDirections]]:
    """The system of a sequence (up to its last sample, or `until` a time) and what its filter bounds.

    Results count once they are in.

    Raises UndecidedError as for `_system_with_noise`.
    """
    system, directions = _system_with_noise(plan, sequence, settles, limited=limited)
    if sequence.result_delay is None and not sequence.late:
        return system, directions
    return _as_results_come(plan, sequence, system, directions, until)


def _as_results_come(
    plan: PlanFigures,
    sequence: SampleSequence,
    system: SampledSystem,
    directions: Sequence[BoundedDirections],
    until: float = np.inf,
) -> tuple[SampledSystem, Sequence[BoundedDirections]]:
    """A system and what its filter bounds, each result once it is in, up to the last sample or `until` a time; default:
    until all are in."""
    comes = sequence.comes_after(np.isfinite(plan.problem.v_bound), late=True)
    if until == np.inf:
        until = float(np.max(sequence.centres[:, None] + np.where(np.isfinite(comes), comes, 0.0)))
    system = with_results_out(replace(system, last=max(0.0, until - float(sequence.centres[-1]))), comes)
    return system, with_branches(system, directions)


def _system_with_noise(
    plan: PlanFigures, sequence: SampleSequence, settles: int = 1, *, limited: bool = True
) -> tuple[SampledSystem, Sequence[BoundedDirections]]:
    """The system of a sequence and what its filter bounds, all results in at once.

    Coordinates and gains after a sample that is the plan's are the plan's: any of them are a proof. Before the first
    change the plan's filter bounds the error, whatever it once was; where the sequence is the plan's start, what is
    known then does, and the filter is followed from there on until it is the plan's. Where nothing is known then, that
    is `limited`, or free: then what no sample has determined since has no bound.

    Samples that may be early or late are samples on time with more noise, as much as they need, from the first to the
    last: what one adds follows from those before it. Raises UndecidedError if nothing bounds what early and late
    samples do.
    """
    count = len(sequence.times)
    starting = count - settles if sequence.begins else 0
    usual = _usual_noise(plan, sequence)
    noise, found, since = usual, np.zeros_like(usual), 0
    upto = min(count, sequence.first + AHEAD) if sequence.late else count
    work, n = plan.oracle.work, plan.plant.n_states
    for _ in range(TURNS):
        part = sequence.until(upto)
        system, directions = _noisier_system(plan, part, starting, noise, limited=limited)
        if not sequence.late:
            return system, directions
        work.add(SYSTEM, upto * n**2)
        coming = _as_results_come(plan, part, system, directions) if part.in_parts else (system, directions)
        times = TimingEffects(plan, part, GainSearch(*coming, lambda: work.add(GAINS, FEWEST * n)))
        found[:upto] = times.added(noise[:upto], usual[:upto], found[:upto], since)
        if not np.isfinite(found).all():
            break
        tighter = np.maximum(usual, found * MORE)  # enough, too, where that is less: what is added grows with it
        enough, tail = np.all(found[:upto] <= noise[:upto]), slice(max(0, upto - settles), upto)
        if enough and np.all(noise[tail] <= tighter[tail] * MORE):
            if upto == count:
                return system, directions
            since, upto = upto, min(count, sequence.first + FARTHER * (upto - sequence.first))
            continue
        tighter = tighter if enough else np.maximum(tighter, _fading(tighter[:upto], len(tighter)))
        since = int(np.argmax(np.any(tighter != noise, axis=1)))
        noise = tighter
    late = sequence.late.describe(in_words=lambda time: spoken(time, plan.plant.time_unit))
    raise UndecidedError(
        f"undecided: nothing bounds what samples {late} do where they are not the plan's. Ask for a smaller "
        "`timing_tolerance`."
    )


def _fading(noise: Array, count: int) -> Array:
    """What noise would be that decays, a share of itself from one sample to the next: a guess that is often enough."""
    found = np.zeros((count, noise.shape[1]))
    for k in range(1, count):
        found[k] = FADES * np.maximum(found[k - 1], noise[k - 1] if k <= len(noise) else 0.0)
    return found


def _usual_noise(plan: PlanFigures, sequence: SampleSequence) -> Array:
    """What stands for the times of the plan's samples (K, p), and a first guess for those that it does not have."""
    own_noise = None if plan.accuracy is None else plan.accuracy.noise
    noise = np.zeros(sequence.measured.shape)
    if own_noise is None:
        return noise
    for k in range(len(noise)):
        if sequence.sides[k].any() or k < sequence.first:
            phase = _planned(plan, sequence, k)
            noise[k] = own_noise.max(axis=0) if phase is None else own_noise[phase]
    return noise


class TimingEffects:
    """What the times of a sequence's samples add at most to what they read: C (x(t + e) - x(t)), and w in between."""

    def __init__(self, plan: PlanFigures, sequence: SampleSequence, search: GainSearch):
        self.plan, self.own, self.sequence, self.search = plan, plan_system(plan), sequence, search
        search.back = max(FEWEST, int(self.own.forgetting.max(initial=0)))
        self.phases = [_planned(plan, sequence, k) for k in range(len(sequence.times))]
        self.known = [self._known(k) for k in range(len(self.phases))]
        self.tables: dict[tuple[int, float, bool], KnownIntegrals] = {}
        self.aside = np.stack([sequence.forward, sequence.back], axis=1)

    def added(self, noise: Array, usual: Array, before: Array, since: int) -> Array:
        """What they add (K, p), from one sample on; 0 where the plan's noise is known to be enough."""
        sequence, found = self.sequence, before.copy()
        first = 0 if sequence.begins or sequence.wider > 1 else sequence.first
        plain = np.all(noise == usual, axis=1) & np.array([phase is not None for phase in self.phases])
        for k in range(max(first, since), len(noise)):
            found[k] = 0.0
            if not self.aside[k].any() or self._settled(k, plain):
                continue
            for i in self.search.system.samples[k].outputs.tolist():
                found[k, i] = self._sample(self.search.system.incoming[k, i], i, float(usual[k, i]))
        return found

    def _known(self, k: int) -> float:
        """How many times as large as after the plan's own sample the error may be at most; infinite after others."""
        phase = self.phases[k]
        if phase is None:
            return np.inf
        change = np.linalg.solve(self.own.L[phase], self.search.system.L[k])
        return float(np.max(self.search.directions[k].bound(change) / self.own.reach[phase]))

    def _settled(self, k: int, plain: Mask) -> bool:
        """Whether the plan's own proof that its noise is enough holds for a sample."""
        phase = self.phases[k]
        if phase is None:
            return False
        back = proof_back(self.plan, phase)
        if k < back or self.known[k - back] > SETTLED or not plain[k - back : k + 1].all():
            return False
        if self.search.system.again and np.isfinite(self.sequence.result_times[k - back : k + 1]).any():
            return False  # results that came in another order
        run = self.phases[k - back : k + 1]
        follows = all(b == ((a or 0) + 1) % len(self.own) for a, b in pairwise(run))
        gaps = np.diff(self.sequence.centres[k - back : k + 1])
        usual = np.array([self.own.gaps[a or 0].length for a in run[:-1]])
        return follows and bool(np.all(np.abs(gaps - usual) <= GRAIN * self.plan.schedule.period))

    def _sample(self, k: int, i: int, enough: float) -> float:
        """The same of one output at a node; by gains where the filter's are not enough, the plan's if they fit."""
        row, most = self.plan.plant.C[i], 0.0
        for back, late in enumerate(self.aside[self.search.system.sample_of(k), :, i].tolist()):
            if not late:
                continue
            table = self.tables.setdefault((i, late, bool(back)), {})
            opened = moved_row(self.search.system, k, row, late, bool(back), table)
            known = BoundedDirections(self.search.directions[k].basis, self.search.directions[k].reach)
            value, mu = float(opened.bound(known)[1].max()), opened.mu[-1]
            gains = self._plan_gains(k, i, bool(back)) if value > enough and known.whole else ()
            if gains:
                known.add(mu, *self.search.evaluate(k, mu[None], [gains]))
                value = float(opened.bound(known)[1].max())
            if value > enough and known.whole:
                known.add(mu, self.search.gains(k, mu))
                value = float(opened.bound(known)[1].max())
            most = max(most, value)
        return most

    def _plan_gains(self, k: int, i: int, back: bool) -> tuple[Array, ...]:
        """The gains by which the plan's proof bounds this, as far back as the samples are the plan's."""
        system, proof, fitting = self.search.system, proof_system(self.plan), list[Array]()
        phase = self.phases[system.sample_of(k)]
        if phase is None:
            return ()
        node = proof.incoming[phase % len(proof), i]
        gains = timing_gains(self.plan, node, i, back)
        paths = (reversed(each.latest(at, len(gains))) for each, at in ((system, k), (proof, node)))
        for lam, at, expected in zip(reversed(gains), *paths, strict=False):
            phase, own, usual = self.phases[system.sample_of(at)], system.samples[at], proof.samples[expected]
            fits = phase is not None and phase % len(proof) == proof.sample_of(expected)
            if not fits or not np.array_equal(own.outputs, usual.outputs):
                break
            fitting.append(lam * own.size / usual.size)
        return tuple(reversed(fitting))


@lru_cache(maxsize=4)
def proof_system(plan: PlanFigures) -> SampledSystem:
    """The system of a plan's proof: the shortest period that its samples have."""
    assert plan.accuracy is not None
    question = plan.accuracy.question.noisier(plan.accuracy.noise).primitive()
    return question.filter_bounds(plan.plant)[0]


def _proof_part(plan: PlanFigures, node: int) -> GapProof | None:
    assert plan.accuracy is not None
    parts = [part for part in plan.accuracy.proof if part.sample == node and len(part.directions)]
    return parts[0] if parts else None


@lru_cache(maxsize=512)
def proof_back(plan: PlanFigures, phase: int) -> int:
    """Samples that the gains of a plan's proof after one of them look back, also where some results are out."""
    own = proof_system(plan)
    found = [phase % len(own), *(node for (j, _), node in own.incoming.items() if j == phase % len(own))]
    parts = [part for node in found if (part := _proof_part(plan, node)) is not None]
    return max([len(own.nodes(node, 0)) for node in found] + [len(gains) for part in parts for gains in part.gains])


@lru_cache(maxsize=512)
def timing_gains(plan: PlanFigures, node: int, i: int, back: bool) -> tuple[Array, ...]:
    """The gains by which a plan's proof bounds what the time of a node adds to an output, the latest last."""
    own, late = proof_system(plan), plan.problem.timing_tolerance
    side = float(np.broadcast_to(late.back if back else late.forward, plan.plant.n_outputs)[i])
    part = _proof_part(plan, node)
    if part is None:
        return ()
    reach = own.reach[own.sample_of(node)]
    directions = BoundedDirections.of(reach, part.directions, part.gains, [0.0] * len(part.gains))
    mu = moved_row(own, node, plan.plant.C[i], side, back, {}).mu[-1]
    return combined(own, node, mu[None], directions)[0]


def _noisier_system(
    plan: PlanFigures, sequence: SampleSequence, starting: int, noise: Array, *, limited: bool
) -> tuple[SampledSystem, Sequence[BoundedDirections]]:
    """The system of a sequence whose samples have so much more noise, (K, p) at least; its first `starting` samples are
    in coordinates of their own."""
    own, times, gaps = plan_system(plan), sequence.centres, np.diff(sequence.centres)
    sampled_system.refuse_growth(plan.plant, gaps)
    phases = [None if k < starting else _planned(plan, sequence, k) for k in range(len(times))]
    same = _same_gaps(plan, phases, gaps)
    fresh = [k for k in range(len(gaps)) if not same[k]]
    F, W = discounted_flow(own.A, own.G @ own.G.T, gaps[fresh]) if fresh else (np.zeros((0, 0, 0)),) * 2
    flows = {k: (F[i], W[i] * float(np.mean(gaps))) for i, k in enumerate(fresh)}
    L: list[Array] = []
    samples: list[MeasurementModel] = []
    for k, phase in enumerate(phases):
        if phase is None:
            free = UNKNOWN**2 if sequence.late else DIFFUSE  # above the noise that samples have at such a start
            P = start_covariance(plan.problem.initial, own.D, free) if k == 0 else np.zeros(0)
            if k:
                P = propagate(L[-1] @ L[-1].T, *flows[k - 1])
            root, sample = _fresh(plan, P, sequence.measured[k], noise[k])
            if sequence.begins and sequence.late and k < starting and _is_close(plan, sequence, k, root):
                phases[k + 1 :] = [_planned(plan, sequence, i) for i in range(k + 1, len(times))]
        else:
            root, sample = own.L[phase], _noisier(own.samples[phase], plan.problem.v_bound, noise[k])
        L.append(root)
        samples.append(sample)
    same = _same_gaps(plan, phases, gaps)
    own = replace(own, L=own.L[: len(own)], samples=own.samples[: len(own)], again=(), before=(), known_spans=())
    table = GapTable(own.A, own.G, np.ones(len(own.A)))
    made: list[GapDynamics] = []
    for k, h in enumerate(gaps.tolist()):
        phase = phases[k]
        if same[k] and phase is not None:
            made.append(own.gaps[phase])
        else:
            key = h, L[k].tobytes(), L[k + 1].tobytes()
            if key not in plan.oracle.gaps:
                plan.oracle.gaps[key] = sampled_system.make_gap(table, h, L[k], L[k + 1], flows[k][0])
            made.append(plan.oracle.gaps[key])
    followed = () if sequence.begins else sequence.clock_times[: sequence.first].tolist()
    before = [sequence.wider * own.reach[phase_of(plan.schedule, t)] for t in followed]
    known, initial = own.known, plan.problem.initial
    if sequence.begins:
        known, start = initial.exact, initial.scaled(own.D[:, None] * L[0], own.D, NO_ERROR)
        start = _limited(start, np.linalg.solve(L[0], own.L[0]), own) if limited else start
    else:
        start = InitialSet.box(np.maximum(before[0], LEAST * before[0].max(initial=1.0)))
    system = replace(own, L=np.array(L), samples=tuple(samples), gaps=tuple(made), start=start, last=0.0, known=known)
    return system, FiniteDirections(system, before, repeated_integrals(plan))


def _same_gaps(plan: PlanFigures, phases: list[int | None], gaps: Array) -> list[bool]:
    """Which gaps are the plan's, between its samples."""
    own = plan_system(plan)
    return [
        i is not None
        and following == (i + 1) % len(own)
        and abs(own.gaps[i].length - h) <= GRAIN * plan.schedule.period
        for i, following, h in zip(phases, phases[1:], gaps.tolist(), strict=False)
    ]


def _is_close(plan: PlanFigures, sequence: SampleSequence, k: int, root: Array) -> bool:
    """Whether a filter's covariance after a sample is so near the plan's that the plan's coordinates serve as well."""
    own, phase = plan_system(plan), _planned(plan, sequence, k)
    return phase is not None and float(np.linalg.norm(np.linalg.solve(own.L[phase], root), 2)) ** 2 <= CLOSE


def _limited(start: InitialSet, change: Array, own: SampledSystem) -> InitialSet:
    """A start, limited where nothing is known; `change` leads from the plan's coordinates to those of the start."""
    free = start.free()
    if not free.shape[1]:
        return start
    size = UNKNOWN * np.abs(free.T @ change) @ np.max(own.reach, axis=0)
    far = free.T / size[:, None]
    return InitialSet.within(np.vstack([start.S, far]) / (np.sqrt(2.0) if start.ball else 1.0), start.ball)


def _planned(plan: PlanFigures, sequence: SampleSequence, k: int) -> int | None:
    """Which sample of the plan a sequence's sample is; None if it is another one."""
    schedule, t = plan.schedule, float(sequence.clock_times[k])
    phase = phase_of(schedule, t)
    off = (t - float(schedule.times[phase])) / schedule.period
    sensors = np.flatnonzero(sequence.measured[k] & np.isfinite(plan.problem.v_bound))
    same = abs(off - round(off)) <= GRAIN and np.array_equal(sensors, plan_system(plan).samples[phase].outputs)
    return phase if same else None


def _noisier(sample: MeasurementModel, v_bound: Array, noise: Array) -> MeasurementModel:
    """A sample of the plan with so much more noise (p,): itself where that is the plan's."""
    bound = (v_bound + noise)[sample.outputs]
    size = np.where(sample.exact, np.maximum(bound, sample.size), bound)
    own = np.where(sample.exact, np.minimum(bound / sample.size, 1.0), 1.0)
    if np.array_equal(size, sample.size) and np.array_equal(own, sample.noise):
        return sample
    share = sample.size / size
    return replace(sample, size=size, H=sample.H * share[:, None], noise=own, K=sample.K / share)


def _fresh(plan: PlanFigures, P: Array, measured: Mask, noise: Array) -> tuple[Array, MeasurementModel]:
    """Coordinates after a sample that the plan does not have, and the sample; P is the covariance before it."""
    own, v_bound = plan_system(plan), plan.problem.v_bound
    v = np.where(measured & np.isfinite(v_bound), v_bound + noise, np.inf)
    bounds = replace(own.bounds, v=freeze(v[None]))
    (H,), (size,), (own_noise,) = noise_units(
        plan.plant.C * own.D, bounds, P[None], own.A, own.G, float(np.mean(own.lengths))
    )
    root = coordinate_root(covariance_root(information_update(P, H.T @ H)))
    K = np.asarray(np.linalg.solve(root, update_with_gain(P, H)[1]), dtype=np.float64)
    return root, MeasurementModel(bounds.measured(0), size, H @ root, own_noise, K)
