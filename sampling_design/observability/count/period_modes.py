"""What one period of a schedule shows of the modes that do not decay by themselves, each in its own coordinates.

In the coordinates of invariant subspaces the flow over a period is block diagonal, whatever other modes do,
and every column counts as large as what the outputs show of it: neither units nor fast modes decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from sampling_design.numerics.linalg import balanced_rows, expm_batch, positive_or_one, right_directions
from sampling_design.numerics.modal_flow import CONDITION_LIMIT
from sampling_design.observability.count.pbh import RANK_TOLERANCE
from sampling_design.plants.clusters import (
    CLUSTER_CAP,
    SPREAD,
    EigenvalueCluster,
    SchurForm,
    balanced_schur,
    clusters_of,
    invariant_subspace,
)
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.schedules.schedule import PeriodicSchedule

Entries = npt.NDArray[Any]  # real or complex

EPS = float(np.finfo(float).eps)
ROUNDS = 4  # in which outputs and columns are scaled in turn
ON_THE_LINE = 1e-9  # a mode this near Re = -eta/2, relative to its size, counts as on the line


@dataclass(frozen=True, eq=False)
class ModeBlock:
    """An invariant subspace: A X = X T in balanced coordinates, T = mean I + N, and the clusters that it holds."""

    mean: complex
    N: Entries
    X: Entries
    clusters: tuple[EigenvalueCluster, ...]


class LeastObservedMode(NamedTuple):
    """The multiplier e^{rate P} that a period sees least, how well, and what the unobservable direction is made of.

    `parts` holds a vector for each block, in its own coordinates, at the period's first sample.
    """

    rate: complex
    margin: float
    parts: list[Entries]
    shares: Array


@dataclass(frozen=True, eq=False)
class PeriodModes:
    """The modes of a plant that do not decay at rate eta, as blocks that do not drive each other."""

    blocks: tuple[ModeBlock, ...]
    d: Array
    C: Array

    def least_observed(self, schedule: PeriodicSchedule) -> LeastObservedMode:
        """Least singular value of [e^{AP} - mu I; rows of one period] over mu = e^{rate P}, in scaled coordinates."""
        period, tau = schedule.period, schedule.times - schedule.times[0]
        sizes = [len(block.N) for block in self.blocks]
        ends = np.cumsum([0, *sizes])
        rows, norms, ladders = [], [], []
        for block in self.blocks:
            growth = float(np.max(block.mean.real * tau))
            here = self._rows(block, tau, schedule)
            periods = [self._rows(block, tau + k * period, schedule) for k in range(len(block.N))]
            size = np.sqrt(np.sum(np.abs(np.concatenate(periods)) ** 2, axis=0))
            ladders.append(_ladder(block, period))
            if block.N.any():  # one scale for a block whose columns drive each other, beside its ladder
                size = np.broadcast_to(np.max(size * ladders[-1], axis=1, keepdims=True), size.shape)
            norms.append(size)
            rows.append(here * np.exp(block.mean * tau - growth)[:, None, None])
        outputs, scales = _scales(np.hstack(norms))
        columns = [c * ladder for c, ladder in zip(np.split(scales, ends[1:-1]), ladders, strict=True)]
        measured = np.concatenate(
            [(outputs[:, None] * r * c).reshape(-1, c.size) for r, c in zip(rows, columns, strict=True)], axis=1
        )
        if len(measured) > measured.shape[1]:
            measured = np.asarray(np.linalg.qr(measured, mode="r"))
        flows = [expm_batch(b.N * c / c[:, None], period)[0] for b, c in zip(self.blocks, columns, strict=True)]
        best: LeastObservedMode | None = None
        for rate in dict.fromkeys(c.value for block in self.blocks for c in block.clusters):
            parts = [_less(f, b.mean * period, rate * period) for b, f in zip(self.blocks, flows, strict=True)]
            singular, right = right_directions(np.vstack([block_diag(*parts), measured]))
            if best is None or singular[-1] < best.margin:
                z = np.split(right[-1].conj(), ends[1:-1])
                shares = np.array([np.linalg.norm(part) for part in z])
                best = LeastObservedMode(
                    rate, float(singular[-1]), [c * part for c, part in zip(columns, z, strict=True)], shares
                )
        assert best is not None
        return best

    def _rows(self, block: ModeBlock, times: Array, schedule: PeriodicSchedule) -> Entries:
        """C X e^{N t} at the given times, (N, p, m), unmeasured outputs as zeros; what may be rounding is zero."""
        out = self.C @ block.X
        out = np.where(np.abs(out) > RANK_TOLERANCE * (np.abs(self.C) @ np.abs(block.X)), out, 0)
        rows = out @ expm_batch(block.N, times)
        return rows if schedule.outputs is None else rows * schedule.outputs[:, :, None]

    def direction(self, mode: LeastObservedMode, schedule: PeriodicSchedule, before: float) -> Entries:
        """The least observed state, in the plant's coordinates and of length 1, `before` the period's first sample."""
        tau = schedule.times - schedule.times[0]
        tops = np.array([np.max(block.mean.real * tau) + block.mean.real * before for block in self.blocks])
        # parts that the direction is not made of must not decide what overflows
        taking = np.array([np.linalg.norm(part) for part in mode.parts]) > 0
        least = np.min(tops[taking], initial=np.inf)
        x = np.zeros(self.d.size, dtype=complex)
        for block, part, top, takes in zip(self.blocks, mode.parts, tops, taking, strict=True):
            if takes:
                turned = np.exp(complex(least - top, -block.mean.imag * before))
                x += block.X @ (turned * (expm_batch(block.N, -before)[0] @ part))
        x *= self.d
        return np.asarray(x / np.max(np.abs(x)) / np.linalg.norm(x / np.max(np.abs(x))))


def _scales(size: Array) -> tuple[Array, Array]:
    """Factors of rows and columns after which each column has norm 1 and no row is small throughout."""
    outputs, columns = np.ones(len(size)), np.ones(size.shape[1])
    for _ in range(ROUNDS):
        columns = 1 / positive_or_one(np.linalg.norm(outputs[:, None] * size, axis=0))
        outputs = 1 / positive_or_one(np.max(size * columns, axis=1))
    return outputs, 1 / positive_or_one(np.linalg.norm(outputs[:, None] * size, axis=0))


def _ladder(block: ModeBlock, period: float) -> Array:
    """Scales s^k of the columns of a block in which the couplings of its triangle move by 1 in a period."""
    steps = np.arange(len(block.N))
    coupling = float(np.max(np.abs(np.triu(block.N, 1)), initial=0.0)) * period
    return np.asarray(np.power(1 / coupling if coupling > 0 else 1.0, steps), dtype=np.float64)


def _less(cycle: Entries, own: complex, other: complex) -> Entries:
    """(e^{own} period - e^{other} I), divided by the larger of the two, without an overflow."""
    top = max(own.real, other.real)
    flow = np.exp(own - top) * cycle
    return np.asarray((flow - np.exp(other - top) * np.eye(len(cycle))) / max(float(np.linalg.norm(flow)), 1.0))


@lru_cache(maxsize=32)
def period_modes(plant: Plant, eta: float) -> PeriodModes:
    """Return the modes of `plant` with Re >= -eta/2; kept, since a search asks for many schedules of one plant."""
    if not plant.n_states:
        return PeriodModes((), np.ones(0), plant.C)
    form = balanced_schur(plant.A, plant.C)
    clusters, places = clusters_of(form, plant.n_states * EPS, CLUSTER_CAP)
    kept = [(c, g) for c, g in zip(clusters, places, strict=True) if _stays(c, eta)]
    groups = [([c], list(g)) for c, g in kept]
    while True:
        blocks = [_block(form, tuple(c), g) for c, g in groups]
        if len(blocks) < 2 or np.linalg.cond(np.hstack([b.X for b in blocks])) <= CONDITION_LIMIT:
            break
        _, i, j = max(
            (float(np.linalg.norm(a.X.conj().T @ b.X, 2)), i, i + 1 + j)
            for i, a in enumerate(blocks)
            for j, b in enumerate(blocks[i + 1 :])
        )
        joined = (groups[i][0] + groups[j][0], sorted(groups[i][1] + groups[j][1]))
        groups = [g for k, g in enumerate(groups) if k not in (i, j)] + [joined]
    return PeriodModes(tuple(blocks), form.d, balanced_rows(plant.C, form.d))


def _block(form: SchurForm, clusters: tuple[EigenvalueCluster, ...], group: list[int]) -> ModeBlock:
    X, T = invariant_subspace(form, group)
    mean = clusters[0].value if len(clusters) == 1 else complex(np.mean(np.diag(T)))
    N = T - mean * np.eye(len(group))
    noise = SPREAD * len(X) * EPS * form.norm * clusters[0].projector_norm
    if len(clusters) == 1 and np.linalg.norm(N) <= noise:
        N = np.zeros_like(N)
    return ModeBlock(mean, N, X, clusters)


def _stays(cluster: EigenvalueCluster, eta: float) -> bool:
    """Whether a group of eigenvalues does not decay at rate eta: on or right of the line, as far as it is known."""
    value = cluster.value if cluster.sure else complex(max(v.real for v in cluster.members), cluster.value.imag)
    slack = cluster.uncertainty + ON_THE_LINE * max(abs(value), eta / 2)
    return value.real >= -eta / 2 - slack
