"""Linear programs over stages with boxes, solved in time proportional to their length.

    maximise  mu'z_K   subject to   z_{k+1} = F_k z_k + B_k u_k,   |u_k| <= 1,   |H_k z_k| <= 1

from z_0 = 0 or from |S z_0| <= 1. An interior point method
(Mehrotra, with Gondzio's corrections): states and costates of all stages are the unknowns of one banded system, whose
width is that of a stage; u is eliminated. What comes back is unchecked: whoever calls it evaluates both sides anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dgbtrf, dgbtrs

from sampling_design.records.arrays import Array, Index

ITERATIONS = 100  # at most; thirty are usual
SHORT = 0.9995  # share of the way to the nearest wall that a step may take, at most
CORRECTIONS = 1  # times that products far from their mean are brought nearer to it, if steps get longer by it

REACH, NEAR, GAINED = 0.3, 0.1, 0.01
"""How much longer a corrected step tries to be, the share of the mean that a product should keep, and what must come
of it."""

TINY = 1e-9  # steps shorter than this lead nowhere
CLOSE, PATIENCE = 1e-4, 5  # share within which the two sides are close, and iterations that must halve it from there on


@dataclass(frozen=True, eq=False)
class StageSolution:
    """Where the method ended.

    Attributes
    ----------
    z : (K, n) array
    u : tuple of (m_k,) arrays
    gains : tuple of (p_k,) arrays
        Multipliers of |H_k z_k| <= 1.
    costates : (K-1, n) array
        Multipliers of the dynamics: g after stage k+1.
    start : (r,) array
        Multipliers of |S z_0| <= 1.
    gap : float
        The two sides' difference, relative to the larger one.
    others : (r,) array
        Variables that a general solver's program has beside z and u.
    """

    z: Array
    u: tuple[Array, ...]
    gains: tuple[Array, ...]
    costates: Array
    start: Array
    gap: float
    others: Array


class StageProgram:
    """The stages, put together once; targets mu differ.

    Parameters
    ----------
    F : sequence of (n, n) arrays
        One fewer than stages.
    B : sequence of (n, m_k) arrays
        As many as F.
    H : sequence of (p_k, n) arrays
        One for each stage.
    start : (r, n) array or None
        S, of rank n; None: z_0 = 0.
    """

    def __init__(self, F: list[Array], B: list[Array], H: list[Array], start: Array | None = None):
        self.n, self.K = H[0].shape[1], len(H)
        self._from_zero = start is None
        S = np.zeros((0, self.n)) if start is None else start
        self._rows = np.vstack([S, *H])
        self._stage = np.repeat(np.arange(self.K + 1), [len(S), *map(len, H)]) - 1
        self._stage[: len(S)] = 0
        self._reading_ends = np.cumsum([len(S), *map(len, H)])
        self._F = np.array(F).reshape(-1, self.n, self.n)
        self._widths = [X.shape[1] for X in B]
        self._places = np.concatenate([[0], np.cumsum(self._widths)]).astype(int)
        self._many, self._entries = int(self._places[-1]), int(self._places[-1]) + len(self._rows)
        self._single = np.unique(self._stage).size == self._stage.size
        self._groups = []
        for width in sorted(set(self._widths)):
            gaps = np.flatnonzero(np.array(self._widths) == width)
            spots = self._places[gaps][:, None] + np.arange(width)
            self._groups.append((gaps, spots, np.array([B[k] for k in gaps])))
        self._band()

    def _band(self) -> None:
        """Where blocks stand in the band, and what of it never changes."""
        n, K = self.n, self.K
        self._width = 2 * n
        self._size = (2 * K - 1) * n
        inner = np.arange(n)
        self._tall = 3 * self._width + 1

        def flat(row: Index, column: Index) -> Index:
            i = row[:, None, None] + inner[:, None]
            j = column[:, None, None] + inner
            return np.asarray((2 * self._width + i - j) + j * self._tall)

        z, p = 2 * n * np.arange(K), 2 * n * np.arange(K - 1) + n
        self._own, self._between = flat(z, z), flat(p, p)
        fixed = np.zeros(self._tall * self._size)
        fixed[flat(z[:-1], p)] = -np.swapaxes(self._F, 1, 2)
        fixed[flat(z[1:], p)] = np.eye(n)
        fixed[flat(p, z[:-1])] = -self._F
        fixed[flat(p, z[1:])] = np.eye(n)
        if self._from_zero:
            fixed[flat(z[:1], p[:1])] = 0.0
            fixed[flat(z[:1], z[:1])] = np.eye(n)
        self._fixed = fixed

    def _driven(self, u: Array) -> Array:
        """B u of each gap."""
        found = np.empty((self.K - 1, self.n))
        for gaps, spots, B in self._groups:
            found[gaps] = (B @ u[spots][:, :, None])[:, :, 0]
        return found

    def _input_slopes(self, p: Array) -> Array:
        """B'p of each gap, in one row."""
        found = np.empty(self._places[-1])
        for gaps, spots, B in self._groups:
            found[spots] = (p[gaps][:, None, :] @ B)[:, 0, :]
        return found

    def _covariances(self, weight: Array) -> Array:
        """B diag(weight) B' of each gap."""
        found = np.empty((self.K - 1, self.n, self.n))
        for gaps, spots, B in self._groups:
            found[gaps] = (B * weight[spots][:, None, :]) @ np.swapaxes(B, 1, 2)
        return found

    def _rows_of(self, z: Array) -> Array:
        return np.asarray(np.einsum("rn,rn->r", self._rows, z[self._stage]))

    def _gathered(self, weight: Array) -> Array:
        """H'weight of each stage."""
        return self._summed(self._rows * weight[:, None])

    def _summed(self, parts: Array) -> Array:
        """Parts of rows, added up stage by stage."""
        found = np.zeros((self.K, *parts.shape[1:]))
        if self._single:
            found[self._stage] = parts
        else:
            np.add.at(found, self._stage, parts)
        return found

    def solve(
        self, mu: Array, gains: list[Array], tolerance: float = 1e-6, enough: float = 0.0, near: float = 0.0
    ) -> StageSolution:
        """Return the best point and multipliers for the target mu; `gains` are a first guess.

        It ends when the two sides are within `tolerance` of each other, or within `near` and the upper one is at most
        `enough`.
        """
        size = float(np.linalg.norm(mu))
        target = np.zeros((self.K, self.n))
        target[-1] = mu / size
        z, p, t = np.zeros((self.K, self.n)), np.zeros((self.K - 1, self.n)), np.zeros(self._entries)
        m = self._first(p, target, np.concatenate(gains) / size)
        best, history = (np.inf, z, t, m, p), []
        for _ in range(ITERATIONS):
            slacks, drift = np.concatenate([1 - t, 1 + t]), self._drift(z, t)
            reached = float(np.sum(z[-1] * target[-1]))
            opened = float(m @ slacks)  # the two sides' difference, where both are balanced
            gap = max(opened / max(abs(reached + opened), 1e-300), self._off(p, m, target), float(np.abs(drift).max()))
            history.append(gap)
            if gap < best[0]:
                best = gap, z, t, m, p
            late = len(history) > PATIENCE and gap < CLOSE and 2 * gap > history[-1 - PATIENCE]
            if gap <= tolerance or late or (gap <= near and size * (reached + opened) <= enough):
                break
            step = _NewtonStep(self, slacks, m, drift, target).step(opened / m.size)
            if step is None:
                break
            (dz, new_p, dt, dm), primal, dual = step
            z, p, t, m = z + primal * dz, p + dual * (new_p - p), t + primal * dt, m + dual * dm
            t[self._many :] = self._rows_of(z)
            if np.max(np.abs(t)) >= 1 or np.min(m) <= 0:
                break
        gap, z, t, m, p = best
        return self._solution(z, t, self.signed(m), p, size, gap)

    def _solution(self, z: Array, t: Array, q: Array, p: Array, size: float, gap: float) -> StageSolution:
        at = self._many + self._reading_ends
        multipliers = [size * q[i:j] for i, j in pairwise(at)]
        u = [t[i:j] for i, j in pairwise(self._places)]
        return StageSolution(z, tuple(u), tuple(multipliers), size * p, size * q[self._many : at[0]], gap, np.zeros(0))

    def _first(self, p: Array, target: Array, gains: Array) -> Array:
        """First multipliers, which balance those of a guess; their costates are written to p."""
        q = np.zeros(self._entries)
        q[self._many + self._reading_ends[0] :] = gains
        g, pull = target[-1], self._gathered(q[self._many :])
        for k in range(self.K - 2, -1, -1):
            p[k] = g - pull[k + 1]
            g = self._F[k].T @ p[k]
        q[: self._many] = self._input_slopes(p)
        level = max(float(np.mean(np.abs(q))), 1e-3 / q.size)
        return np.concatenate([np.maximum(q, 0) + level, np.maximum(-q, 0) + level])

    def signed(self, m: Array) -> Array:
        """Multipliers of the upper less those of the lower bounds."""
        return np.asarray(m[: self._entries] - m[self._entries :])

    def _drift(self, z: Array, t: Array) -> Array:
        return np.asarray(z[1:] - (self._F @ z[:-1, :, None])[:, :, 0] - self._driven(t))

    def _off(self, p: Array, m: Array, target: Array) -> float:
        """How far the multipliers are from balanced."""
        q = self.signed(m)
        rest = self._gathered(q[self._many :]) - target
        rest[1:] += p
        rest[:-1] -= (p[:, None, :] @ self._F)[:, 0, :]
        if self._from_zero:
            rest[0] = 0.0
        w = self._input_slopes(p) - q[: self._many]
        return max(float(np.max(np.abs(rest))), float(np.max(np.abs(w), initial=0.0)))

    def factorised(self, D: Array) -> tuple[Array, Index]:
        """The banded system for weights D of the bounded entries."""
        band, many = self._fixed.copy(), self._many
        own = self._summed(self._rows[:, :, None] * (self._rows * D[many:, None])[:, None, :])
        if self._from_zero:
            own[0] = np.eye(self.n)
        band[self._own], band[self._between] = own, -self._covariances(1 / D[:many])
        ab = band.reshape(self._size, self._tall).T
        lu, pivots, _ = dgbtrf(ab, self._width, self._width, overwrite_ab=1)
        return lu, pivots

    def direction(
        self, system: tuple[Array, Index], D: Array, aimed: Array, drift: Array, target: Array
    ) -> tuple[Array, Array, Array]:
        """dz, the new p, and dt, for multipliers aimed + D dt."""
        n, K, many = self.n, self.K, self._many
        blocks = np.zeros((K, 2, n))
        blocks[:, 0] = target - self._gathered(aimed[many:])
        if self._from_zero:
            blocks[0, 0] = 0.0
        blocks[:-1, 1] = -drift - self._driven(aimed[:many] / D[:many])
        x, _ = dgbtrs(system[0], self._width, self._width, blocks.ravel()[: self._size], system[1])
        blocks = np.concatenate([x, np.zeros(n)]).reshape(K, 2, n)
        dz, p = blocks[:, 0], blocks[:-1, 1]
        dt = np.concatenate([(self._input_slopes(p) - aimed[:many]) / D[:many], self._rows_of(dz)])
        return dz, p, dt


class _NewtonStep:
    """One iteration: predictor, corrector, and what brings single products nearer to their mean."""

    def __init__(self, program: StageProgram, slacks: Array, m: Array, drift: Array, target: Array):
        self.program, self.slacks, self.m, self._drift, self._target = program, slacks, m, drift, target
        weights = m / slacks
        self._D = weights[: m.size // 2] + weights[m.size // 2 :]
        self._system = program.factorised(self._D)

    def _towards(self, products: Array) -> tuple[Array, Array, Array, Array]:
        """dz, the new p, dt and dm for wanted products of rooms and multipliers."""
        aimed = self.program.signed(products / self.slacks)
        found = self.program.direction(self._system, self._D, aimed, self._drift, self._target)
        changed = _slack_changes(found[2])
        return (*found, (products - self.m * self.slacks - self.m * changed) / self.slacks)

    def _lengths(self, dt: Array, dm: Array) -> tuple[float, float]:
        """How far both sides may go, at most 1."""
        return min(_longest_step(self.slacks, _slack_changes(dt)), 1.0), min(_longest_step(self.m, dm), 1.0)

    def step(self, mean: float) -> tuple[tuple[Array, Array, Array, Array], float, float] | None:
        """The step and its lengths; None where rounding leaves none."""
        *_, dt, dm = self._towards(np.zeros(self.m.size))
        primal, dual = self._lengths(dt, dm)
        changed = _slack_changes(dt)
        after = float((self.m + dual * dm) @ (self.slacks + primal * changed)) / self.m.size
        aim = (after / mean) ** 3 * mean
        products = aim - dm * changed
        found = self._towards(products)
        primal, dual = self._lengths(*found[2:])
        for _ in range(CORRECTIONS):
            ahead = min(primal + REACH, 1.0), min(dual + REACH, 1.0)
            meant = (self.m + ahead[1] * found[3]) * (self.slacks + ahead[0] * _slack_changes(found[2]))
            again = products + np.maximum(np.clip(meant, NEAR * aim, aim / NEAR) - meant, -aim / NEAR)
            tried = self._towards(again)
            longer = self._lengths(*tried[2:])
            if sum(longer) < primal + dual + GAINED:
                break
            found, products, (primal, dual) = tried, again, longer
        share = min(max(1 - 10 * mean, 0.95), SHORT)
        primal, dual = (x if x == 1 and share == SHORT else min(share * x, 1.0) for x in (primal, dual))
        usable = all(np.isfinite(x).all() for x in found) and max(primal, dual) > TINY
        return (found, primal, dual) if usable else None


def _slack_changes(dt: Array) -> Array:
    """How a step changes the rooms."""
    return np.concatenate([-dt, dt])


def _longest_step(size: Array, change: Array) -> float:
    """How far one may go until an entry is 0."""
    fastest = float(np.max(-change / size))
    return 1 / fastest if fastest > 0 else np.inf
