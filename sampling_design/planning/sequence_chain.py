"""A sequence of samples as a chain in the coordinates of the plan's own: what is the plan's in it is not made again."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from sampling_design.accuracy.bounded_directions import BoundedDirections
from sampling_design.accuracy.finite import NO_ERROR, covariance_root, finite_atoms, start_covariance
from sampling_design.accuracy.gap_table import GapTable
from sampling_design.accuracy.sample_chain import (
    ChainGap,
    ChainSample,
    SampleChain,
    make_gap,
    noise_units,
    refuse_growth,
)
from sampling_design.accuracy.start import StartSet
from sampling_design.errors import NotDetectableError
from sampling_design.numerics.filtering import information_update, propagate, update_with_gain
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.sequence_deviation import GRAIN, SampleSequence, phase_of
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.checks import freeze

UNKNOWN = 1e6
"""What is not known of the error at a plan's start is at most so many times what its filter leaves later on: rounding
would hide how states of any size decay."""

LEAST = 1e-12
"""Half-width of what is known exactly at the start, as a share of the largest."""


@lru_cache(maxsize=4)
def plan_chain(plan: PlanFigures) -> SampleChain:
    """The plan's samples with the filter whose gains bound the error once and for all.

    Raises NotDetectableError if the plan leaves a part of the state unknown for ever: then nothing bounds what a change
    does to it.
    """
    assert plan.accuracy is not None
    known = plan.accuracy.question.known()
    if known.modes:
        raise NotDetectableError(
            f"`plan` never shows {', '.join(known.modes)}: what a change of its samples does is not bounded."
        )
    return plan.accuracy.question.chain(plan.plant)[0]


def sequence_chain(
    plan: PlanFigures, own: SampleChain, sequence: SampleSequence, settles: int = 1, *, limited: bool = True
) -> tuple[SampleChain, list[BoundedDirections]]:
    """The chain of a sequence and what its filter bounds; `own` is the plan's chain.

    Coordinates and gains after a sample that is the plan's are the plan's: any of them are a proof. Before the first
    change the plan's filter bounds the error, whatever it once was; where the sequence is the plan's start, what is
    known then does, and the filter is followed from there on until it is the plan's. Where nothing is known then, that
    is `limited`, or free: then what no sample has determined since has no bound.
    """
    times, gaps = sequence.times, np.diff(sequence.times)
    refuse_growth(plan.plant, gaps)
    starting = len(times) - settles if sequence.begins else 0
    phases = [None if k < starting else _planned(plan, own, sequence, k) for k in range(len(times))]
    same = [
        i is not None
        and following == (i + 1) % len(own)
        and abs(own.gaps[i].length - h) <= GRAIN * plan.schedule.period
        for i, following, h in zip(phases, phases[1:], gaps.tolist(), strict=False)
    ]
    fresh = [k for k in range(len(gaps)) if not same[k]]
    F, W = discounted_flow(own.A, own.G @ own.G.T, gaps[fresh]) if fresh else (np.zeros((0, 0, 0)),) * 2
    flows = {k: (F[i], W[i] * float(np.mean(gaps))) for i, k in enumerate(fresh)}
    L: list[Array] = []
    samples: list[ChainSample] = []
    for k, phase in enumerate(phases):
        if phase is None:
            P = start_covariance(plan.problem.initial, own.D) if k == 0 else np.zeros(0)
            if k:
                step, noise = flows[k - 1]
                P = propagate(L[-1] @ L[-1].T, step, noise)
            root, sample = _fresh(plan, own, P, sequence.seen[k])
        else:
            root, sample = own.L[phase], own.samples[phase]
        L.append(root)
        samples.append(sample)
    table = GapTable(own.A, own.G, np.ones(len(own.A)))
    made: list[ChainGap] = []
    for k, h in enumerate(gaps.tolist()):
        phase = phases[k]
        if same[k] and phase is not None:
            made.append(own.gaps[phase])
        else:
            made.append(make_gap(table, h, L[k], L[k + 1], flows[k][0]))
    if sequence.begins:
        initial = plan.problem.initial
        start = initial.scaled(own.D[:, None] * L[0], own.D, NO_ERROR)
        start = _limited(start, np.linalg.solve(L[0], own.L[0]), own) if limited else start
        chain = replace(own, L=np.array(L), samples=tuple(samples), gaps=tuple(made), start=start, last=0.0)
        chain = replace(chain, known=initial.exact)
        return chain, finite_atoms(chain)
    before = [sequence.wider * own.reach[phase_of(plan.schedule, float(t))] for t in sequence.shown[: sequence.first]]
    start = StartSet(np.diag(1 / np.maximum(before[0], LEAST * before[0].max(initial=1.0))), ball=False)
    chain = replace(own, L=np.array(L), samples=tuple(samples), gaps=tuple(made), start=start, last=0.0)
    return chain, finite_atoms(chain, before)


def _limited(start: StartSet, change: Array, own: SampleChain) -> StartSet:
    """A start, limited where nothing is known; `change` leads from the plan's coordinates to those of the start."""
    free = start.free(own.D.size)
    if not free.shape[1]:
        return start
    size = UNKNOWN * np.abs(free.T @ change) @ np.max(own.reach, axis=0)
    far = free.T / size[:, None]
    if start.S is None:
        return StartSet(far, ball=False)
    return StartSet(np.vstack([start.S, far]) / (np.sqrt(2.0) if start.ball else 1.0), start.ball)


def _planned(plan: PlanFigures, own: SampleChain, sequence: SampleSequence, k: int) -> int | None:
    """Which sample of the plan a sequence's sample is; None if it is another one."""
    schedule, t = plan.schedule, float(sequence.shown[k])
    phase = phase_of(schedule, t)
    off = (t - float(schedule.times[phase])) / schedule.period
    told = np.flatnonzero(sequence.seen[k] & np.isfinite(plan.problem.v_bound))
    same = abs(off - round(off)) <= GRAIN and np.array_equal(told, own.samples[phase].outputs)
    return phase if same else None


def _fresh(plan: PlanFigures, own: SampleChain, P: Array, seen: Mask) -> tuple[Array, ChainSample]:
    """Coordinates after a sample that the plan does not have, and the sample; P is the covariance before it."""
    v = np.where(seen & np.isfinite(plan.problem.v_bound), plan.problem.v_bound, np.inf)
    bounds = replace(own.bounds, v=freeze(v[None]))
    (H,), (size,), (exact,) = noise_units(plan.plant.C * own.D, bounds, P[None])
    root = covariance_root(information_update(P, H.T @ H))
    K = np.asarray(np.linalg.solve(root, update_with_gain(P, H)[1]), dtype=np.float64)
    return root, ChainSample(bounds.measured(0), size, H @ root, exact, K)
