"""Both sides of an accuracy again in ball arithmetic: what holds here is a theorem about the doubles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.between_samples import FINENESS, GRID
from sampling_design.accuracy.bounded_directions import BoundedDirections, GapProof
from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.gap_table import PANELS
from sampling_design.accuracy.sampled_system import PANEL, SampledSystem
from sampling_design.numerics.balls import Ball, Matrix, ball, matrix, precision, stacked
from sampling_design.records.arrays import Array

if TYPE_CHECKING:
    from sampling_design.accuracy.witness import AccuracyWitness


BITS = 192  # Working precision: 53 bits of the doubles, the rest against growth
RAISED = 1e-4  # by how much the filter's reach is raised before it is proven

MOST_STEPS = 20_000
"""Samples of a memory beyond which balls are not carried along it: minutes, and radii that grow with them."""


@dataclass(frozen=True, eq=False)
class _CostatePanels:
    """What turns a costate at the start of a stretch into p = G'e^{A's}g, p'' and e^{A's}g at panel ends.

    On a panel the third derivative is at most `third` times |e^{A's}g| at its start.
    """

    step: Ball
    count: int
    every: Matrix
    third: Ball


def _column(x: npt.ArrayLike) -> Matrix:
    return matrix(np.asarray(x, dtype=np.float64)[:, None])


def _entries(M: Matrix) -> list[Ball]:
    return list(M.entries())


def _total(parts: list[Ball]) -> Ball:
    return sum(parts, ball(0.0)).upper()


def _norm(parts: list[Ball]) -> Ball:
    """An exact number that is at least the Euclidean norm."""
    square = _total([x * x for x in parts])
    return square.sqrt().upper() if square > 0 else ball(0.0)


def _larger(a: Ball, b: Ball) -> Ball:
    return a.max(b).upper()


class BallSystem:
    """An endless system in balls, in units of D: flows, panels, and the filter's reach, proven anew."""

    def __init__(self, system: SampledSystem):
        self.system = system
        plant, n = system.plant, system.D.size
        self.n, self.q = n, plant.n_disturbances
        D, w = [ball(d) for d in system.D], [ball(x) for x in system.bounds.w]
        self.A = stacked([[ball(plant.A[i, j]) * D[j] / D[i] for j in range(n)] for i in range(n)], n)
        self.G = stacked([[ball(plant.G[i, j]) * w[j] / D[i] for j in range(self.q)] for i in range(n)], self.q)
        self.D, self.size = D, _norm(_entries(self.A))
        self.Lt = [matrix(L).transpose() for L in system.L]
        self.Ct = [
            stacked([[ball(plant.C[i, k]) * D[k] / ball(z) for k in range(n)] for i, z in pairs], n).transpose()
            for pairs in ([*zip(s.outputs, s.size, strict=True)] for s in system.samples)
        ]
        self._flows: dict[tuple[float, int], tuple[Matrix, _CostatePanels]] = {}
        self.reach: list[list[Ball]] = []

    def over(self, length: float, count: int) -> tuple[Matrix, _CostatePanels]:
        """(e^{A length})' and its panels."""
        if (length, count) not in self._flows:
            step, square = ball(length) / count, self.A * self.A
            E = (self.A * step).exp()
            first, second, flow = self.G, square * self.G, matrix(np.eye(self.n))
            rows, bends, flows = [], [], []
            for _ in range(count + 1):
                rows += first.transpose().tolist()
                bends += second.transpose().tolist()
                flows += flow.transpose().tolist()
                first, second, flow = E * first, E * second, E * flow
            third = (_norm(_entries(square * self.A * self.G)) * (self.size * step).exp()).upper()
            panels = _CostatePanels(step, count, stacked(rows + bends + flows, self.n), third)
            self._flows[length, count] = (self.A * ball(length)).exp().transpose(), panels
        return self._flows[length, count]

    def gap(self, j: int) -> tuple[Matrix, _CostatePanels]:
        """Flow and panels of gap j, finer than those of the system where |A| alone says what a panel loses."""
        gap = self.system.gaps[j]
        return self.over(gap.length, int(np.clip(np.ceil(self.system.size * gap.length / PANEL), *PANELS)))

    def measure(self, entries: list[Ball]) -> Ball:
        """h_W in units of the bounds."""
        return _norm(entries) if self.system.bounds.w_ball else _total([abs(x) for x in entries])

    def integrals(self, g: Matrix, panels: _CostatePanels) -> tuple[list[Ball], list[Ball]]:
        """Upper bounds on int h_W(G'e^{A's}g) ds up to every panel end, and on sup |p''| per panel."""
        values, n, q, half = _entries(panels.every * g), self.n, self.q, (panels.count + 1) * self.q
        sizes = [self.measure(values[k : k + q]) for k in range(0, half, q or 1)] if q else []
        bends = [self.measure(values[half + k : half + k + q]) for k in range(0, half, q or 1)] if q else []
        drift = panels.third * panels.step / 2 * (1 if self.system.bounds.w_ball else max(q, 1))
        sums, sups = [ball(0.0)], []
        for k in range(panels.count):
            size = _norm(values[2 * half + k * n : 2 * half + (k + 1) * n])
            sup = (_larger(bends[k], bends[k + 1]) + drift * size).upper() if q else ball(0.0)
            more = panels.step / 2 * (sizes[k] + sizes[k + 1]) + panels.step**3 / 12 * sup if q else ball(0.0)
            sums.append((sums[-1] + more).upper())
            sups.append(sup)
        return sums, sups

    def noise(self, j: int, gains: list[Ball]) -> Ball:
        """h_V of gains in units of the noise; an exact sensor costs nothing."""
        sample, v = self.system.samples[j], self.system.bounds.v[j]
        pairs = zip(gains, sample.outputs, sample.size, strict=True)
        costs = [abs(x) * ball(v[i]) / ball(z) for x, i, z in pairs]
        return _norm(costs) if self.system.bounds.v_ball else _total(costs)

    def passed(self, j: int, g: Matrix, gains: list[Ball]) -> tuple[Matrix, Ball]:
        """The costate before sample j and what its gains cost."""
        if not gains:
            return g, ball(0.0)
        return g - self.Ct[j] * stacked([[x] for x in gains], 1), self.noise(j, gains)

    def prove_reach(self) -> bool:
        """Whether R_j >= cost_j + |rest_j|'R_k with contracting rests holds for reaches hardly raised."""
        system = self.system
        if system.forgetting.max(initial=0) > MOST_STEPS:
            return False
        self.reach = [[ball(float(x) * (1 + RAISED)) for x in R] for R in system.reach]
        for j, back in enumerate(system.forgetting):
            R = self.reach[(j - back) % len(system)]
            for cost, rest, most in zip(*self._filtered(j, int(back)), self.reach[j], strict=True):
                if not _total(rest) < 1 or not cost + _total([a * b for a, b in zip(rest, R, strict=True)]) <= most:
                    return False
        return True

    def _filtered(self, j: int, back: int) -> tuple[list[Ball], list[list[Ball]]]:
        """Costs and rests of the filter's gains for the entries of z_j, over as many samples as the system's reach."""
        system, at = self.system, j
        costs, columns = [ball(0.0)] * self.n, [self.Lt[j].solve(_column(unit)) for unit in np.eye(self.n)]
        for step in range(back + 1):
            for k, g in enumerate(columns):
                columns[k], paid = self.passed(at, g, self._filter_gains(at, g))
                costs[k] = (costs[k] + paid).upper()
            if step == back:
                break
            at = (at - 1) % len(system)
            flow, panels = self.gap(at)
            for k, g in enumerate(columns):
                costs[k] = (costs[k] + self.integrals(g, panels)[0][-1]).upper()
                columns[k] = flow * g
        return costs, [[abs(x).upper() for x in _entries(self.Lt[at] * g)] for g in columns]

    def _filter_gains(self, j: int, g: Matrix) -> list[Ball]:
        """The filter's gains at sample j for a costate before it is taken out."""
        K = self.system.samples[j].K
        return _entries(matrix(K.T) * (self.Lt[j] * g)) if K.shape[1] else []

    def evaluated(self, j: int, mu: Array, gains: tuple[Array, ...]) -> Ball:
        """What gains prove of mu'z_j."""
        nodes = self.system.nodes(j, len(gains))
        total, g = ball(0.0), self.Lt[j].solve(_column(mu))
        for k in range(len(nodes) - 1, -1, -1):
            own = self._filter_gains(nodes[k], g)
            g, paid = self.passed(nodes[k], g, [x + ball(y) for x, y in zip(own, gains[k], strict=True)])
            total = (total + paid).upper()
            if k:
                flow, panels = self.gap(nodes[k - 1])
                total = (total + self.integrals(g, panels)[0][-1]).upper()
                g = flow * g
        return (total + self.rest(nodes[0], _entries(self.Lt[nodes[0]] * g))).upper()

    def rest(self, j: int, entries: list[Ball]) -> Ball:
        """What the reach bounds."""
        return _total([abs(x) * r for x, r in zip(entries, self.reach[j], strict=True)])

    def bounds(self, j: int, mus: list[list[Ball]], directions: BoundedDirections, values: list[Ball]) -> list[Ball]:
        """Bounds on rho of directions by the fits of floats, whose rests are balls."""
        fit = directions.fit(np.array([[float(x) for x in mu] for mu in mus]))
        bounds = []
        for mu, places, shares in zip(mus, *fit, strict=True):
            total, left = ball(0.0), mu
            for place, share in zip(places, shares, strict=True):
                if share:
                    a = ball(share)
                    total += abs(a) * values[place]
                    left = [x - a * ball(y) for x, y in zip(left, directions.mu[place], strict=True)]
            fitted, plain = (total + self.rest(j, left)).upper(), self.rest(j, mu)
            bounds.append(fitted if fitted < plain else plain)
        return bounds

    def top(self, j: int, row: Array, directions: BoundedDirections, values: list[Ball]) -> Ball:
        """An upper bound on rho of a row over all real times of gap j."""
        length = self.system.gaps[j].length
        count = int(np.clip(np.ceil(float(np.linalg.norm(self.system.A, 2)) * length / FINENESS), *GRID))
        _, panels = self.over(length, count)
        c = stacked([[ball(x) * d] for x, d in zip(row, self.D, strict=True)], 1)
        above, sups = self.integrals(c, panels)
        E, At = (self.A * panels.step).exp().transpose(), self.A.transpose()
        g, mus, bends, slopes, thirds = c, [], [], [], []
        for _ in range(count + 1):
            first = At * g
            second = At * first
            mus.append(_entries(self.Lt[j] * g))
            bends.append(_entries(self.Lt[j] * second))
            slopes.append(self.measure(_entries(self.G.transpose() * first)) if self.q else ball(0.0))
            thirds.append(_norm(_entries(At * second)))
            g = E * g
        nodes = [x + y for x, y in zip(self.bounds(j, mus, directions, values), above, strict=True)]
        turns = self.bounds(j, bends, directions, values)
        widths = [_norm(_entries(self.Lt[j])[k * self.n : (k + 1) * self.n]) for k in range(self.n)]
        reached = _total([a * r for a, r in zip(widths, self.reach[j], strict=True)]) * (self.size * panels.step).exp()
        best, h = ball(0.0), panels.step
        for k in range(count):
            slope = _larger(slopes[k], slopes[k + 1]) + h / 2 * sups[k]
            turn = _larger(turns[k], turns[k + 1]) + h / 2 * thirds[k] * reached
            best = _larger(best, _larger(nodes[k], nodes[k + 1]) + h * h / 8 * (turn + slope))
        return best


def proven_above(system: SampledSystem, rows: Array, uppers: Array, proof: tuple[GapProof, ...]) -> bool:
    """Whether gains prove upper bounds on rows (r, n) at all real times of an endless schedule, in ball arithmetic."""
    with precision(BITS):
        balls = BallSystem(system)
        if not balls.prove_reach():
            return False
        bounded: dict[int, tuple[BoundedDirections, list[Ball]]] = {}
        for part in proof:
            values = [balls.evaluated(part.sample, mu, g) for mu, g in zip(part.directions, part.gains, strict=True)]
            directions = BoundedDirections.of(
                system.reach[part.sample], part.directions, part.gains, [float(x) for x in values]
            )
            bounded[part.sample] = directions, values
        if sorted(bounded) != list(range(len(system))):
            return False
        return all(
            balls.top(j, row, directions, values) <= ball(upper)
            for row, upper in zip(rows, uppers, strict=True)
            for j, (directions, values) in bounded.items()
        )


def proven_below(witness: AccuracyWitness, bounds: SignalBounds, lower: float) -> bool:
    """Whether a witness attains `lower` within its bounds, in ball arithmetic.

    The states at the samples are taken as they stand; the least change of w that leads from one to the next is added,
    and the whole divided by what it exceeds its bounds. What does not start from rest is not decided.
    """
    if np.any(witness.states[0]):
        return lower <= 0
    with precision(BITS):
        response, most, value = _BallTrajectory(witness, bounds), ball(1.0), ball(0.0)
        for k in range(len(witness.states)):
            reached = response.gap(k)
            if reached is None:
                return False
            most, value = _larger(most, reached[0]), reached[1]
        return bool(value / most >= ball(lower))


class _BallTrajectory:
    """A witness in balls, in units of its bounds and of the sizes of its states."""

    def __init__(self, witness: AccuracyWitness, bounds: SignalBounds):
        self.witness, self.bounds = witness, bounds
        plant, self.n, self.q = witness.plant, witness.plant.n_states, witness.plant.n_disturbances
        n, q = self.n, self.q
        self.D = D = [ball(d) for d in witness.scales()]
        A = [[ball(plant.A[i, j]) * D[j] / D[i] for j in range(n)] for i in range(n)]
        G = [[ball(plant.G[i, j]) * ball(bounds.w[j]) / D[i] for j in range(q)] for i in range(n)]
        rows = [[*row, *more] for row, more in zip(A, G, strict=True)]
        self.joint = stacked(rows + [[ball(0.0)] * (n + q)] * q, n + q)
        self.ends = np.searchsorted(witness.edges, [*witness.samples, witness.edges[-1]])
        self.flows: dict[float, list[list[Ball]]] = {}

    def state(self, k: int) -> Matrix:
        """z at sample k."""
        return stacked([[ball(z) / d] for z, d in zip(self.witness.states[k], self.D, strict=True)], 1)

    def gap(self, k: int) -> tuple[Ball, Ball] | None:
        """By how much sample k and the gap behind it exceed their bounds, and the row at its end; None: not decided."""
        witness, a, b = self.witness, self.ends[k], self.ends[k + 1]
        most, blocks, ahead = self._largest_reading(k), [], matrix(np.eye(self.n))
        if most is None:
            return None
        for cell in range(b - 1, a - 1, -1):
            begin, end = float(witness.edges[cell]), float(witness.edges[cell + 1])
            if end - begin not in self.flows:
                self.flows[end - begin] = (self.joint * ball(end - begin)).exp().tolist()[: self.n]
            rows = self.flows[end - begin]
            blocks.append(ahead * stacked([row[self.n :] for row in rows], self.q))
            ahead = ahead * stacked([row[: self.n] for row in rows], self.n)
        blocks.reverse()
        cells = [[_over(u, size) for u, size in zip(row, self.bounds.w, strict=True)] for row in witness.w[a:b]]
        state = ahead * self.state(k)
        for block, u in zip(blocks, cells, strict=True):
            state = state + block * stacked([[one] for one in u], 1)
        if k + 1 < len(witness.states):
            gram = matrix(np.zeros((self.n, self.n)))
            for block in blocks:
                gram = gram + block * block.transpose()
            try:
                change = gram.solve(self.state(k + 1) - state)
            except ZeroDivisionError:
                return None
            more = [_entries(block.transpose() * change) for block in blocks]
            cells = [[x + y for x, y in zip(u, extra, strict=True)] for u, extra in zip(cells, more, strict=True)]
        for u in cells:
            largest = max((abs(one).upper() for one in u), key=float, default=ball(0.0))
            most = _larger(most, _norm(u) if self.bounds.w_ball else largest)
        reached = zip(witness.row, _entries(state), self.D, strict=True)
        return most, sum((ball(c) * z * d for c, z, d in reached), ball(0.0))

    def _largest_reading(self, k: int) -> Ball | None:
        """The largest ratio of C x to its bound at sample k; None if an exact sensor shows anything."""
        witness, v = self.witness, self.bounds.v
        ratios = [ball(0.0)]
        sizes = v[(witness.last - (len(witness.states) - 1 - k)) % len(v)]
        for c, size in zip(witness.plant.C, sizes, strict=True):
            if np.isinf(size):
                continue
            y = abs(sum((ball(p) * ball(z) for p, z in zip(c, witness.states[k], strict=True)), ball(0.0))).upper()
            if size == 0 and y > 0:
                return None
            ratios.append((y / ball(size)).upper() if size else ball(0.0))
        return _norm(ratios) if self.bounds.v_ball else max(ratios, key=float)


def _over(u: float, size: float) -> Ball:
    """u over its bound; only 0 is allowed where the bound is 0."""
    if size == 0:
        return ball(0.0) if u == 0 else ball(np.inf)
    return ball(u) / ball(size)
