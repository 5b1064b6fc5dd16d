"""The adversary's program over one window of samples, and what its two sides prove without the solver.

    maximise  mu'z_K   over w constant on cells, subject to  z_{k+1} = F z_k + sum Gamma w,  |w| <= 1,  |H z_k| <= 1

It is posed once per window; targets mu change its cost only. Its multipliers are gains, its point is an adversary; both
are evaluated anew: `upper` for any gains and all real times, `lower` for an adversary scaled until it is admissible.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from sampling_design.accuracy.bounds import InitialSet
from sampling_design.accuracy.gains import ROUNDING, Gains, cleared, evaluated, whole_gains
from sampling_design.accuracy.lasting import LastingResponses, LastingTrajectory
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.conic_programs import INFEASIBLE, UNBOUNDED, ConeSolver
from sampling_design.numerics.stage_programs import StageProgram, StageSolution
from sampling_design.records.arrays import Array

TOLERANCE = 1e-8  # asked of the solver; what it leaves open shows in the bracket, never in a bound

EXACTLY = 1e-6
"""An exact sensor shows zero within this many of its stand-in units: 1e-12 of what w does to it over a period."""

SLIGHT = 1e-5  # an adversary that is divided by no more than this beyond 1 need not be corrected

STAGED, NEAR = 1e-5, 0.02
"""Shares within which the two sides of a program over stages meet, and where its upper side is low enough."""

STALLED = 5e-3  # a program over stages whose two sides differ by more than this share is left to the general solver


@dataclass(frozen=True, eq=False)
class Adversary:
    """An admissible w with all y = 0 against some row at a sample; its last state serves against every other row."""

    value: float
    w: tuple[Array, ...]  # (m, q) per gap, in units of the bound, latest cell first
    z: Array  # (K, n)
    sample: int
    system: SampledSystem  # with the cells on which w is constant
    past: LastingTrajectory | None = None  # by which it came to its first state, unless that is rest or a known start

    @property
    def end(self) -> Array:
        """z at the sample."""
        return np.asarray(self.z[-1])


def boxed(system: SampledSystem, nodes: list[int]) -> bool:
    """Whether everything that bounds w and v at some samples does so entry by entry, and no sensor is exact."""
    samples = [system.samples[j] for j in nodes]
    round_v = system.bounds.v_ball and any(len(s.H) > 1 for s in samples)
    return not (system.bounds.w_ball or round_v or any(s.exact.any() for s in samples))


class ConeWindow:
    """Samples `nodes` of a system, the target's last; `start`: bounds on |z| before the first, or a set of them.

    `lasting`: adversaries begin as what has gone on for ever, with which those bounds agree. `rough`: tolerance that is
    enough of a large program.
    """

    def __init__(
        self,
        system: SampledSystem,
        nodes: list[int],
        start: InitialSet,
        tolerance: float = TOLERANCE,
        lasting: LastingResponses | None = None,
        rough: float | None = None,
    ):
        self.system, self.nodes, self.start = system, nodes, start
        self._tolerance, self._lasting, self._rough = tolerance, lasting, rough
        self._gaps, self._samples = [system.gap(j) for j in nodes[:-1]], [system.samples[j] for j in nodes]
        self._stages = self._staged()
        self._built = False
        if self._stages is None:
            self._build()

    @property
    def entries(self) -> int:
        """About how many its program has."""
        return sum(gap.F.size + gap.cells.size for gap in self._gaps)

    def _moved(self) -> list[Array]:
        """What w on the cells of each gap adds to z at its end."""
        return [np.swapaxes(gap.cells, 0, 1).reshape(self.system.D.size, -1) for gap in self._gaps]

    def _staged(self) -> StageProgram | None:
        """The window as a program over stages, if all that is bounded is so entry by entry and nothing is exact."""
        if not boxed(self.system, self.nodes) or not self._gaps or self._lasting is not None:
            return None
        fits, S = self.start.staged()
        F, H = [gap.F for gap in self._gaps], [s.H for s in self._samples]
        return StageProgram(F, self._moved(), H, S) if fits else None

    def _build(self) -> None:
        system, n, q = self.system, self.system.D.size, self.system.G.shape[1]
        K = len(self.nodes)
        self._built = True
        B, samples, lasting = self._moved(), self._samples, self._lasting
        self._w_at = K * n + np.concatenate([[0], np.cumsum([own.shape[1] for own in B])]).astype(int)
        before = int(self._w_at[-1])
        table = ConeTable(before + (0 if lasting is None else lasting.columns))
        F = np.array([gap.F for gap in self._gaps]).reshape(-1, n, n)
        table.flow(F, np.hstack([np.zeros((n, 0)), *B]), [own.shape[1] for own in B], 0, K * n)
        self._exact_at = [table.add(np.zeros(int(s.exact.sum())), (k * n, s.H[s.exact])) for k, s in enumerate(samples)]
        if lasting is not None:
            lasting.begin(table, before, np.linalg.inv(system.L[self.nodes[0]]) / system.D)
        table.end("zero")
        pose = partial(self.start.pose, table) if lasting is None else partial(lasting.pose, table, before)
        pose(ball=False)
        noisy = [(k * n, s.H[~s.exact]) for k, s in enumerate(samples)]
        each = [(at, H, system.bounds.v_ball and len(H) > 1) for at, H in noisy]
        self._box_at = [-1 if r else table.box(at, H, np.ones(len(H))) for at, H, r in each]
        if not system.bounds.w_ball:
            table.unit_box(K * n, before - K * n)
        table.end("nonnegative")
        self._ball_at = [table.ball(at, H) if r else -1 for at, H, r in each]
        pose(ball=True)
        if system.bounds.w_ball and q:
            table.unit_balls(K * n, q, (before - K * n) // q)
        self._columns = table.columns
        self._b = table.b()
        self._solver = ConeSolver(table.matrix(), table.cones, tolerance=self._tolerance, rough=self._rough)

    def _solved(self, mu: Array, enough: float = 0.0) -> StageSolution:
        """Point and multipliers for the target mu'z_K; zeros where the solver brought none."""
        size = float(np.linalg.norm(mu))
        if size == 0:
            return self._nowhere()
        if self._stages is not None:
            found = self._stages.solve(mu, whole_gains(self.system, self.nodes, mu)[0], STAGED, enough, NEAR)
            if found.gap <= (NEAR if enough > 0 else STALLED):
                return found
        if not self._built:
            self._build()
        return self._coned(mu / size, size)

    def _coned(self, mu: Array, size: float) -> StageSolution:
        """What the general solver finds."""
        n, K = mu.size, len(self.nodes)
        cost = np.zeros(self._columns)
        cost[(K - 1) * n : K * n] = -mu
        x, y, status = self._solver.solve(cost, self._b)
        if status in (INFEASIBLE, UNBOUNDED) or not (np.isfinite(x).all() and np.isfinite(y).all()):
            return self._nowhere()
        w, y = tuple(x[i:j] for i, j in pairwise(self._w_at)), y * size
        z, costates = x[: K * n].reshape(K, n), y[: (K - 1) * n].reshape(-1, n)
        return StageSolution(z, w, tuple(self._gains(y)), costates, np.zeros(0), np.inf, x[self._w_at[-1] :])

    def _nowhere(self) -> StageSolution:
        system, K = self.system, len(self.nodes)
        w = tuple(np.zeros(system.gap(j).cells.shape[::2]) for j in self.nodes[:-1])
        gains = tuple(np.zeros(len(system.samples[j].H)) for j in self.nodes)
        z, costates = np.zeros((K, system.D.size)), np.zeros((K - 1, system.D.size))
        return StageSolution(z, w, gains, costates, np.zeros(0), np.inf, np.zeros(0))

    def gains(self, mu: Array, enough: float = 0.0) -> Gains:
        """Return the best gains for the target mu'z_K, with what they prove; good ones, if that is `enough`."""
        return self.upper(mu, self._steadied(mu, self._solved(mu, enough)))

    def both(self, mu: Array) -> tuple[Gains, Adversary]:
        """Return both sides for the target mu'z_K, each evaluated without the solver."""
        point = self._solved(mu)
        return self.upper(mu, self._steadied(mu, point)), self._admissible(mu, point)

    def _gains(self, y: Array) -> list[Array]:
        """Gains from the multipliers of the noise cones."""
        found = []
        for k, j in enumerate(self.nodes):
            sample = self.system.samples[j]
            gains, noisy = np.zeros(len(sample.H)), int(np.sum(~sample.exact))
            if self._exact_at[k] >= 0:
                gains[sample.exact] = y[self._exact_at[k] : self._exact_at[k] + len(gains) - noisy]
            if self._box_at[k] >= 0:
                at = self._box_at[k]
                gains[~sample.exact] = y[at : at + noisy] - y[at + noisy : at + 2 * noisy]
            elif self._ball_at[k] >= 0:
                gains[~sample.exact] = y[self._ball_at[k] + 1 : self._ball_at[k] + 1 + noisy]
            found.append(gains)
        return found

    def _steadied(self, mu: Array, point: StageSolution) -> list[Array]:
        """The solver's gains beside the filter's, which see the costate as it is, not as the solver's last digits."""
        system, costates = self.system, [*point.costates, mu]
        for k in range(len(costates) - 1):
            costates[k] = system.gap(self.nodes[k]).F.T @ costates[k]
        samples = (system.samples[node] for node in self.nodes)
        gains = [raw - each.K.T @ g for raw, each, g in zip(point.gains, samples, costates, strict=True)]
        return gains if self.start.whole else cleared(self.system, self.nodes, self.start, mu, gains)

    def upper(self, mu: Array, gains: list[Array]) -> Gains:
        """Return what any gains prove, for all real times."""
        return evaluated(self.system, self.nodes, self.start, mu[None], [gains])[0]

    def _admissible(self, mu: Array, point: StageSolution) -> Adversary:
        """The solver's disturbance, simulated from its start (0 unless that is a set) and scaled until admissible."""
        system, n, K = self.system, mu.size, len(self.nodes)
        none = self._nowhere()
        best = Adversary(0.0, none.u, none.z, self.nodes[-1], system)
        first, past = self._first(point)
        for corrected in (False, True):
            z, w = np.zeros((K, n)), []
            z[0] = first
            for k, j in enumerate(self.nodes[:-1]):
                gap = system.gap(j)
                u = point.u[k].reshape(len(gap.cells), system.G.shape[1])
                z[k + 1] = gap.F @ z[k] + np.einsum("mnq,mq->n", gap.cells, u)
                if corrected:
                    flat = np.swapaxes(gap.cells, 0, 1).reshape(n, -1)
                    extra = np.linalg.lstsq(flat, point.z[k + 1] - z[k + 1], rcond=1e-9)[0]
                    u = u + extra.reshape(u.shape)
                    z[k + 1] += flat @ extra
                w.append(u)
            factor = self._excess(z, w, past)
            value, scaled = float(mu @ z[-1]) / factor, tuple(u / factor for u in w)
            begun = None if past is None else past.scaled(1 / factor)
            found = Adversary(value, scaled, z / factor, self.nodes[-1], system, begun)
            if np.isfinite(factor) and found.value > best.value:
                best = found
            if best.value > 0 and factor <= 1 + SLIGHT:
                break
        return best

    def _first(self, point: StageSolution) -> tuple[Array, LastingTrajectory | None]:
        """The first state of an adversary, from a solver's, and its past: admissible, but for its size."""
        system, z = self.system, point.z[0]
        if self.start is system.start:
            return system.admissible_start(z), None
        if self._lasting is None or not point.others.any():
            return np.zeros_like(z), None
        past = self._lasting.trajectory(point.others)
        return np.linalg.solve(system.L[self.nodes[0]], past.state / system.D), past

    def _excess(self, z: Array, w: list[Array], past: LastingTrajectory | None) -> float:
        """Least factor by which bounds must grow for this trajectory, at least 1."""
        system, factor = self.system, 1.0
        if system.start is not None and self.start is system.start:
            factor = max(factor, system.start.excess(z[0]))
        elif past is not None:
            factor = max(
                factor, past.excess(system.plant, system.bounds, system.lengths, system.sample_of(self.nodes[0]))
            )
        for u in w:
            size = np.linalg.norm(u, axis=1) if system.bounds.w_ball else np.abs(u)
            factor = max(factor, float(np.max(size, initial=0.0)))
        for k, j in enumerate(self.nodes):
            sample = system.samples[j]
            y = np.abs(sample.H @ z[k])
            noisy = y[~sample.exact]
            if system.bounds.v_ball and noisy.size:
                factor = max(factor, float(np.linalg.norm(noisy)))
            most = np.maximum(sample.noise, EXACTLY)
            factor = max(factor, float(np.max(y / most, initial=0.0)))
        return factor * (1 + ROUNDING)
