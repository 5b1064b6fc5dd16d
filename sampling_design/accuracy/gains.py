"""What any gains of the samples of a window prove, without a solver: the guarantee, for all real times.

Gains are those that stand beside the filter's, which act on the costate as it comes: what rounding changes of it decays
on its way back. Gains as numbers would let it grow as the plant does over their samples.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import TypeAlias

import numpy as np

from sampling_design.accuracy.bounds import InitialSet
from sampling_design.accuracy.forgetting import noise_cost
from sampling_design.accuracy.gap_table import AT_ONCE
from sampling_design.accuracy.sampled_system import GapDynamics, SampledSystem
from sampling_design.numerics.linalg import forced_flow
from sampling_design.records.arrays import Array

ROUNDING = 1e-11  # relative allowance for rounding in every sum that bounds from above
REMEMBERED = 2**16  # integrals that are kept for paths that come back
AGAIN = 0.5  # share of the room for rounding that a proof takes when it is evaluated again

LEFT = 0.01
"""What may be left of a direction, in units of what a filter knows, where its past counts as bounded already."""


Integral: TypeAlias = Callable[[GapDynamics, Array, bool], Array]


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of the samples of a window and what they prove."""

    value: float
    gains: tuple[Array, ...]  # (p_k,) in units of the noise, beside the filter's


@dataclass(frozen=True, eq=False)
class RowEnd:
    """What gains of the rows of a record prove: `value`, the upper end of a row.

    `bound` is that beyond the nominal state, `width` the part of it that comes from bounds, `short` by how much the
    adversary of the program falls short of it; `room` is what `value` has for rounding.
    """

    value: float
    bound: float
    width: float
    gains: Array
    short: float = 0.0
    room: float = 0.0

    @property
    def again(self) -> float:
        """What it must be at least, worked out once more with other roundings: `AGAIN` of the room is for that."""
        return self.value - (1 - AGAIN) * self.room


def evaluated(
    system: SampledSystem, nodes: list[int], start: InitialSet, mu: Array, gains: Sequence[Sequence[Array]]
) -> list[Gains]:
    """Return what gains, each for its row of mu'z_K, mu (m, n), prove: h_start(rest) + int h_W(G'g) + sum h_V(gains).

    A few rows at once, whose columns at all nodes a cache holds.
    """
    most = max(1, AT_ONCE // mu.shape[1] // len(nodes))
    parts = [slice(first, first + most) for first in range(0, len(gains), most)]
    return [each for few in parts for each in _evaluated(system, nodes, start, mu[few], gains[few])]


def _evaluated(
    system: SampledSystem, nodes: list[int], start: InitialSet, mu: Array, gains: Sequence[Sequence[Array]]
) -> list[Gains]:
    """The same of all at once."""
    at = [np.column_stack(lam) for lam in zip(*gains, strict=True)]
    cost, g, scale, _ = followed_back(system, nodes, mu.T, lambda k, g: system.samples[nodes[k]].K.T @ g + at[k])
    totals = [c + start.support(rest, s) for c, rest, s in zip(cost.tolist(), g.T, scale.tolist(), strict=True)]
    return [Gains(total * (1 + ROUNDING), tuple(each)) for total, each in zip(totals, gains, strict=True)]


def followed_back(
    system: SampledSystem,
    nodes: list[int],
    mu: Array,
    gains_at: Callable[[int, Array], Array],
    known: Callable[[int], Array | None] | None = None,
    integral: Integral = GapDynamics.integral,
) -> tuple[Array, Array, Array, Array | None]:
    """Columns mu (n, m) at the last node, followed back through the gains that are given there.

    Returned are what gains and w cost, what is left of the columns, the sizes that were added up to it, and of `known`,
    bounds on |z| after the samples before, the one at which so little was left that it went no farther back.
    """
    total, g, scale, reach = np.zeros(mu.shape[1]), mu, np.linalg.norm(mu, axis=0), None
    free = np.zeros((len(mu), 0)) if system.start is None or nodes[0] else system.start.free()
    propagated: dict[int, tuple[GapDynamics, list[Array]]] = {}  # one integral for a gap that comes many times
    for k in range(len(nodes) - 1, -1, -1):
        sample, lam = system.samples[nodes[k]], gains_at(k, g)
        total += noise_cost(lam, sample.noise, system.bounds.v_ball)
        step = sample.H.T @ lam
        scale += np.linalg.norm(step, axis=0)
        terms, g = np.abs(g) + np.abs(step), g - step
        if k:
            gap = system.gap(nodes[k - 1])
            if k == 1 and free.shape[1]:  # what rounding leaves of a difference is as large as the first gap makes it
                scale += np.linalg.svd(terms.T[:, :, None] * (gap.F @ free), compute_uv=False).min(axis=1)
            propagated.setdefault(id(gap), (gap, []))[1].append(g)
            g = gap.F.T @ g
            if known is not None and np.abs(g).sum(axis=0).max(initial=0.0) <= LEFT:
                reach = known(k - 1)
                if reach is not None:
                    break
    for gap, columns in propagated.values():
        every = integral(gap, np.hstack(columns), system.bounds.w_ball)
        total = total + every.reshape(len(columns), -1).sum(axis=0)
    return total, g, scale, reach


class RepeatedIntegrals:
    """What w adds over gaps to which paths come back with the same columns: worked out once."""

    def __init__(self, gaps: Sequence[GapDynamics]) -> None:
        self._gaps = {id(gap): gap for gap in gaps}
        self._found: dict[tuple[int, bytes], Array] = {}

    def __call__(self, gap: GapDynamics, mu: Array, ball: bool) -> Array:
        """The integral of each column of mu (n, k), as `GapDynamics.integral`."""
        if id(gap) not in self._gaps:
            return gap.integral(mu, ball)
        parts = np.split(mu, range(len(mu), mu.shape[1], len(mu)), axis=1)
        keys = [(id(gap), blake2b(part.tobytes(), digest_size=16).digest()) for part in parts]
        fresh = {key: part for key, part in zip(keys, parts, strict=True) if key not in self._found}
        if fresh:
            if len(self._found) > REMEMBERED:
                self._found = {key: self._found[key] for key in keys if key not in fresh}
            every = gap.integral(np.hstack([*fresh.values()]), ball)
            ends = np.cumsum([part.shape[1] for part in fresh.values()])
            self._found.update(zip(fresh, np.split(every, ends[:-1]), strict=True))
        return np.concatenate([self._found[key] for key in keys])


def whole_gains(
    system: SampledSystem, nodes: list[int], mu: Array, gains: Sequence[Array] | None = None
) -> tuple[list[Array], Array]:
    """Return the filter's gains for mu'z_K, with those beside them if any, as they are; and what is left of mu."""
    found, g = [np.zeros(0)] * len(nodes), mu
    for k in range(len(nodes) - 1, -1, -1):
        sample = system.samples[nodes[k]]
        found[k] = sample.K.T @ g + (0.0 if gains is None else gains[k])
        g = g - sample.H.T @ found[k]
        g = system.gap(nodes[k - 1]).F.T @ g if k else g
    return found, g


def filtered(system: SampledSystem, nodes: list[int], known: Callable[[int], Array | None], mu: Array) -> list[Gains]:
    """Return what the filter's gains prove of every column of mu'z_K, mu (n, k), with sizes for integrals; no solver.

    `known` as for `followed_back`; nothing, where the first of the nodes bounds nothing.
    """
    first = len(nodes)

    def gains_at(k: int, g: Array) -> Array:
        nonlocal first
        first = k
        return system.samples[nodes[k]].K.T @ g

    total, g, _, reach = followed_back(system, nodes, mu, gains_at, known, GapDynamics.size)
    reach = known(0) if reach is None else reach
    if reach is None:
        return []
    nothing = tuple(np.zeros(len(system.samples[node].H)) for node in nodes[max(first - 1, 0) :])
    return [Gains(float(value), nothing) for value in (total + reach @ np.abs(g)) * (1 + ROUNDING)]


def filtered_along(
    system: SampledSystem, count: int, known: Callable[[int], Array | None], wanted: Mapping[int, Array]
) -> Iterator[tuple[int, list[Gains]]]:
    """The same of rows (m, n) at many samples, from at most so many: one way back, which they join and leave in turn.

    `known` as for `followed_back`; nothing of what comes to a sample so far back that bounds nothing.
    """
    N, g, total = len(system), np.zeros((system.D.size, 0)), np.zeros(0)
    begun: deque[int] = deque()
    for at in range(max(wanted, default=0), min(wanted, default=0) - count, -1):
        if at in wanted:
            begun.append(at)
            g, total = np.hstack([g, wanted[at].T]), np.append(total, np.zeros(len(wanted[at])))
        if not begun:
            continue
        sample, gap = system.samples[at % N], system.gap((at - 1) % N)
        lam = sample.K.T @ g
        g = g - sample.H.T @ lam
        total = total + noise_cost(lam, sample.noise, system.bounds.v_ball) + gap.integral(g, system.bounds.w_ball)
        g, first = gap.F.T @ g, at - 1
        while begun:
            j, m = begun[0], len(wanted[begun[0]])
            far = j - first >= count - 1
            if not far and np.abs(g[:, :m]).sum(axis=0).max(initial=0.0) > LEFT:
                break
            reach = known(first % N)
            if reach is None and not far:
                break
            if reach is not None:
                nothing = tuple(np.zeros(len(system.samples[k % N].H)) for k in range(first, j + 1))
                values = (total[:m] + reach @ np.abs(g[:, :m])) * (1 + ROUNDING)
                yield j, [Gains(float(value), nothing) for value in values]
            begun.popleft()
            g, total = g[:, m:], total[m:]


def transferred_gains(
    system: SampledSystem, nodes: list[int], mu: Array, others: list[int], gains: tuple[Array, ...]
) -> tuple[Array, ...]:
    """Return gains for mu'z_K from those for a direction near it at the last of other nodes."""
    found = [np.zeros(len(system.samples[node].H)) for node in nodes]
    for k in range(1, min(len(gains), len(nodes)) + 1):
        sample, other = system.samples[nodes[-k]], system.samples[others[-k]]
        if np.array_equal(sample.outputs, other.outputs):
            found[-k] = gains[-k] * (sample.size / other.size)
    if len(gains) < len(nodes):  # what is known before them counts their first sample once more
        k = len(nodes) - len(gains)
        sample, (_, rest) = system.samples[nodes[k]], whole_gains(system, nodes[k:], mu, found[k:])
        found[k] = found[k] + sample.K.T @ rest
    return tuple(found)


def path_bounds(
    system: SampledSystem, nodes: list[int], start: InitialSet, known: Callable[[int], Array | None], mu: Array,
    integral: Integral = GapDynamics.integral,
) -> Array:  # fmt: skip
    """Return what the filter's gains prove of every column of mu'z, mu (n, k), at the last of nodes from the start on.

    `known` are bounds on |z| after the samples before: one serves as a start where little is left of the columns.
    """
    gains = [system.samples[node].K.T for node in nodes]
    total, g, scale, reach = followed_back(system, nodes, mu, lambda k, g: gains[k] @ g, known, integral)
    if reach is not None:
        return np.asarray((total + reach @ np.abs(g)) * (1 + ROUNDING))
    if not start.whole:  # what is free at the start must not be touched
        plain = [np.zeros(len(system.samples[node].H)) for node in nodes]
        corrected = [cleared(system, nodes, start, column, plain) for column in mu.T]
        return np.array([each.value for each in evaluated(system, nodes, start, mu.T, corrected)])
    total += [start.support(rest, float(size)) for rest, size in zip(g.T, scale, strict=True)]
    return np.asarray(total * (1 + ROUNDING))


def cleared(system: SampledSystem, nodes: list[int], start: InitialSet, mu: Array, gains: list[Array]) -> list[Array]:
    """Return gains, changed as little as can be so that nothing is left of what is free at the start."""
    free = start.free()
    outputs, _ = system.outputs_of(nodes, free)
    rows, ends = np.vstack(outputs), np.cumsum([len(H) for H in outputs])[:-1]
    for _ in range(2):
        _, rest = whole_gains(system, nodes, mu, gains)
        change = np.split(np.linalg.lstsq(rows.T, free.T @ rest)[0], ends)
        gains, moved = gains.copy(), np.zeros_like(mu)
        for k in range(len(gains) - 1, -1, -1):  # the filter's gains follow what later ones change
            sample = system.samples[nodes[k]]
            gains[k] = gains[k] + change[k] - sample.K.T @ moved
            moved = system.gap(nodes[k - 1]).F.T @ (moved - sample.H.T @ change[k]) if k else moved
    return gains


def centre_offset(system: SampledSystem, row: Array, j: int, d: float, gains: tuple[Array, ...]) -> float:
    """Return what an estimate of row'x at d after sample j adds to its data since bounds are not centred at 0.

    The nominal state under the centres of the bounds, less the gains' share of what it would show, from gains and flow
    backwards: int g'G w_c - sum lambda'v_c.
    """
    bounds, n = system.bounds, system.D.size
    if bounds.w_centre is None and bounds.v_centre is None:
        return 0.0
    force = np.zeros(n) if bounds.w_centre is None else system.plant.G @ bounds.w_centre / system.D
    flows = forced_flow(system.A, force[:, None], [d, *(gap.length for gap in system.gaps)])
    total = float(row * system.D @ flows[0, :, n])
    g = row * system.D @ flows[0, :, :n]
    nodes = system.latest(j, len(gains))
    for k in range(len(nodes) - 1, -1, -1):
        sample, L = system.samples[nodes[k]], system.L[nodes[k]]
        lam = sample.K.T @ (L.T @ g) + gains[k - len(nodes)]
        if bounds.v_centre is not None:
            total -= float(lam @ (bounds.v_centre[system.sample_of(nodes[k]), sample.outputs] / sample.size))
        g = g - np.linalg.solve(L.T, sample.H.T @ lam)
        if k:
            flow = flows[1 + system.sample_of(nodes[k - 1])]
            total += float(g @ flow[:, n])
            g = g @ flow[:, :n]
    return total
