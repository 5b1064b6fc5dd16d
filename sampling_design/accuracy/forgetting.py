"""How far back a filter's error counts on an endless schedule, and what its gains cost until then.

All samples are followed back at once, one step of each at a time: a schedule of N samples whose filter remembers k of
them takes k steps, not N k.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.gap_table import GROWN, GapIntegrals, PropagatedGap
from sampling_design.errors import UndecidedError
from sampling_design.records.arrays import Array, Index

CONTRACTED = 0.03  # samples are added until the filter's error forgets all but this share of its past

PATIENT, HALVED = 256, 0.5
"""Samples from which on so large a share may be left of it: a filter that forgets slowly took ten times as many, and
what is left is bounded all the same."""

KEPT = 2**21  # numbers on the way of samples that are followed together


class FilterStep(NamedTuple):
    """A sample of a filter and the gap before it: its gain and rows, bounds on their noise, what brings z here."""

    K: Array
    H: Array
    noise: Array
    F: Array
    back: Array
    gap: PropagatedGap


class FilterPast(NamedTuple):
    """Of one sample: samples back until the error contracts, what noise and w cost till then, the rest (n, r)."""

    steps: int
    cost: Array
    rest: Array


def filter_pasts(
    steps: Sequence[FilterStep], known: int, balls: tuple[bool, bool], slow: Callable[[], None]
) -> list[FilterPast]:
    """Return the past of every sample, of the first `known` entries of z; `balls`: whether |w| and |v| are Euclidean.

    `slow` is asked once the first sample has been followed over `PATIENT` others. Raises UndecidedError if an error
    grows beyond all numbers.
    """
    every = _Steps(steps, balls)
    found = every.followed(np.zeros(1, dtype=np.intp), known, slow)
    together = max(1, KEPT // max(found[0].steps * found[0].rest.size, 1))
    for begin in range(1, len(steps), together):
        found += every.followed(np.arange(begin, min(begin + together, len(steps))), known)
    return found


class _Steps:
    """The steps of a schedule, each kind of samples with as many outputs stacked."""

    def __init__(self, steps: Sequence[FilterStep], balls: tuple[bool, bool]) -> None:
        self.w_ball, self.v_ball = balls
        self.integrals = GapIntegrals([step.gap.coarser for step in steps])
        self.back = np.array([step.back.T for step in steps])  # turned: as they lie in memory
        self.F = np.array([step.F for step in steps])
        outputs = np.array([len(step.H) for step in steps])
        self.kinds: list[tuple[Array, Array, Array]] = []
        self.kind, self.place = np.zeros((2, len(steps)), dtype=np.intp)
        for k, p in enumerate(np.unique(outputs).tolist()):
            at = np.flatnonzero(outputs == p)
            self.kind[at], self.place[at] = k, np.arange(at.size)
            K, H, noise, *_ = zip(*(steps[i] for i in at.tolist()), strict=True)
            self.kinds.append((np.array(K), np.array(H), np.array(noise)))

    def followed(self, samples: Index, known: int, slow: Callable[[], None] = lambda: None) -> list[FilterPast]:
        """The pasts of some samples."""
        count, n = len(self.F), self.F.shape[1]
        found: dict[int, FilterPast] = {}
        mu, cost = np.tile(np.eye(n)[:, :known], (samples.size, 1, 1)), np.zeros((samples.size, known))
        alive, way, steps = np.arange(samples.size), np.empty((samples.size, 16, n, known)), 0
        while alive.size:
            self._sampled(mu, cost, (samples[alive] - steps) % count)
            left = np.abs(mu).sum(axis=1).max(axis=1, initial=0.0)
            if (left > GROWN).any():
                raise too_far()
            if steps == PATIENT:
                slow()
            done = (left < (CONTRACTED if steps <= PATIENT else HALVED)) & (steps > 0)
            for k in np.flatnonzero(done).tolist():
                j = int(alive[k])
                found[j] = FilterPast(steps, self._driven(cost[k], way[j, :steps], int(samples[j])), mu[k])
            alive, mu, cost = alive[~done], mu[~done], cost[~done]
            if steps == way.shape[1]:
                way = np.concatenate([way, np.empty_like(way)], axis=1)
            way[alive, steps] = mu
            mu = np.swapaxes(self.F[(samples[alive] - steps) % count], 1, 2) @ mu
            steps += 1
        return [found[j] for j in range(samples.size)]

    def _sampled(self, mu: Array, cost: Array, at: Index) -> None:
        """What the gains of a sample each leave of mu, and cost, in place."""
        for k, (K, H, noise) in enumerate(self.kinds):
            own = np.flatnonzero(self.kind[at] == k)
            place = self.place[at[own]]
            gains = np.swapaxes(K[place], 1, 2) @ mu[own]
            mu[own] = mu[own] - np.swapaxes(H[place], 1, 2) @ gains
            cost[own] += noise_cost(gains, noise[place], self.v_ball)

    def _driven(self, cost: Array, way: Array, sample: int) -> Array:
        """The same with what w does over the gaps on a way (steps, n, r) back: one integral for a gap that returns."""
        count, (steps, n, r) = len(self.F), way.shape
        for first, last in ((0, steps % count), (steps % count, min(steps, count))):
            back = np.arange(first, last)
            times = -(-(steps - first) // count)  # how often they come
            at = (sample - back) % count
            columns = way[back[:, None] + count * np.arange(times)]
            columns = np.swapaxes(columns, 1, 2).reshape(back.size, n, times * r)
            g = np.swapaxes(self.back[at], 1, 2) @ columns
            every = self.integrals.over(at, g, self.w_ball)
            each = every.reshape(back.size, times, r).sum(axis=1)
            cost = np.cumsum(np.vstack([cost, each]), axis=0)[-1]
        return cost


def noise_cost(gains: Array, noise: Array, ball: bool) -> Array:
    """h_V of scaled gains (..., p, k): exact sensors cost nothing."""
    noisy = gains * noise[..., None]
    return np.asarray(np.linalg.norm(noisy, axis=-2) if ball else np.abs(noisy).sum(axis=-2))


def too_far() -> UndecidedError:
    """What is said where growth has left nothing of what samples show."""
    return UndecidedError(
        "undecided: what is not measured grows so far between the samples of this schedule that no filter's error can "
        "be followed in doubles. Measure more often."
    )
