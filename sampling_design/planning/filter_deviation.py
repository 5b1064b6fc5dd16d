"""Standard deviations of the best filter on the grid, for many choices of samples at once, and tangents of them.

    P <- F P F' + Q from step to step,    P <- (P^-1 + sum over sensors of z_ij h_j h_j')^-1 at step i,  z_ij in [0, 1]

From nothing unknown, P = 0, every period bounds the periodic limit from below, whatever the error once was. A row's
variance is convex in z, since the information is concave in it and in itself. So a tangent at any z, fractions too, is
below it everywhere: it bounds what any choice can reach, and asks every choice for enough of what it weighs.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from sampling_design.numerics.filtering import EPS, carried, covariance_root, noise_roots, propagate, triangle
from sampling_design.numerics.linalg import discounted_flow, symmetrise
from sampling_design.planning.discrete_plant import DiscretePlant
from sampling_design.planning.hidden_trajectories import HiddenTrajectory
from sampling_design.planning.problem import PlanProblem, RowGoal
from sampling_design.planning.search_progress import FILTER
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import Budget

WIDE = 1e4  # covariance at the start of a filter that knows nothing, where a well measured state has size one
SETTLED = 1e-9  # relative change of the largest variance over a period at which it counts as its limit
PERIODS = 400  # periods that are followed, at most
LOOKS = 2  # of these, that are followed step by step at least: the last one is looked at, and what it differs by
SPARSE = 4  # steps for each sample of a period from which on it is followed from sample to sample at first
DROWNED = 1e6  # growth of a covariance over a period from which on roots take its place, step by step
TANGENT_PERIODS = 40  # the same for a tangent, whose steps are kept
BEYOND = 1e120  # a covariance that is larger is as good as infinite
ENOUGH = 1e6  # variance, in squares of the tolerance, beyond which no more periods are followed
BEYOND_LEVEL = 1e-6  # share by which a variance is above a level at least where that counts as proven: rounding
ROUNDED = 100  # of a variance, this many times eps and growth since the sample before may be rounding
PARTS = 4  # of a step, at whose ends what a gap leaves unknown is looked at
ENTRIES = 4_000_000  # numbers that are looked at together, about
NOT_DRIVEN = 1e-12  # share of its size up to which what noise drives by itself counts as rounding
MOST_REACH = 1e9  # what is known no better than this many tolerances is not known


class GridFilter:
    """Variances of the goals that are standard deviations, on the grid of one problem."""

    def __init__(self, problem: PlanProblem, discrete: DiscretePlant, work: Budget | None = None):
        self.problem, self.discrete = problem, discrete
        self.work = Budget(counted=True) if work is None else work
        V, r = reached_first(discrete.A, discrete.N)
        self.S, self.A, self.N = discrete.S @ V, V.T @ discrete.A @ V, V.T @ discrete.N
        self.rows = discrete.rows(np.array([goal.row for goal in problem.goals]).reshape(-1, len(discrete.T))) @ V
        self.A[r:, :r], self.N[r:] = 0.0, 0.0
        apart = np.linalg.norm(self.rows[:, :r], axis=1) <= NOT_DRIVEN * np.linalg.norm(self.rows, axis=1)
        self.rows[apart, :r] = 0.0
        F, Q = discounted_flow(self.A, self.N @ self.N.T, [discrete.step])
        self.F, self.Q = F[0], symmetrise(Q[0])
        self.F[r:, :r], self.Q[r:], self.Q[:, r:] = 0.0, 0.0, 0.0

    @property
    def decides(self) -> bool:
        """Whether a choice that is not `beyond` a level keeps it, up to rounding."""
        return all(goal.stochastic and not own(goal) for goal in self.problem.goals)

    def variances(self, chosen: Mask) -> tuple[Array, Array]:
        """Variances (B, goals, M) before and after the samples of every step, for choices (B, M, p)."""
        n, (B, M, _), read = self.discrete.n, chosen.shape, np.any(chosen, axis=(0, 2)).tolist()
        P, lost, periods = self._from_sample_to_sample(chosen)
        P, one = np.sqrt(P) if self.grows else P, np.ones(B, dtype=int)
        before, after = np.zeros((M, B, len(self.rows))), np.zeros((M, B, len(self.rows)))
        last = np.full((B, len(self.rows)), np.inf)
        for _ in range(periods, PERIODS):
            self.work.add((M * FILTER[0], FILTER[1]), B * M * n)
            for i in range(M):
                P = self.after(P, one)
                before[i] = self._variance(P)
                if read[i]:
                    P = self.measured(P, chosen[:, i])
                after[i] = self._variance(P) if read[i] else before[i]
                far = np.abs(P).max(axis=(1, 2)) > self._most
                if far.any():
                    lost |= far
                    P[far] = 0.0
            now = before.max(axis=0)
            if np.all(np.abs(now - last)[~lost] <= SETTLED * now[~lost]):
                break
            last = now
        before[:, lost], after[:, lost] = BEYOND, BEYOND
        return np.moveaxis(before, 0, 2), np.moveaxis(after, 0, 2)

    def _variance(self, P: Array) -> Array:
        """Of the goals' rows (B, goals), by covariances or by roots."""
        if self.grows:
            return np.asarray(np.sum((self.rows @ P) ** 2, axis=2))
        return np.asarray(np.einsum("gi,bij,gj->bg", self.rows, P, self.rows))

    @cached_property
    def grows(self) -> bool:
        """Whether a period without a sample makes covariances so large that of what is known then no digit is left."""
        growth = float(np.abs(np.linalg.eigvals(self.F)).max(initial=0.0))
        return bool(self.problem.steps * np.log(max(growth, 1.0)) > np.log(DROWNED) / 2)

    @property
    def _most(self) -> float:
        """The entry of a covariance, or of a root, beyond which it is as good as infinite."""
        return BEYOND**0.5 if self.grows else BEYOND

    def _from_sample_to_sample(self, chosen: Mask) -> tuple[Array, Mask, int]:
        """Covariances (B, n, n) after a period like the one before it, which are lost, and the periods that it took.

        Of nothing known, after no period, where samples are many or states grow by much over a period.
        """
        (B, M, _), n = chosen.shape, self.discrete.n
        P, lost, sampled = np.tile(np.eye(n) * WIDE, (B, 1, 1)), np.zeros(B, dtype=bool), chosen.any(axis=2)
        K = int(sampled.sum(axis=1).max(initial=0))
        if SPARSE * K > M or not K or self.grows:
            return P, lost, 0
        order = np.argsort(~sampled, axis=1, kind="stable")[:, :K]
        at = np.where(np.take_along_axis(sampled, order, axis=1), order, M - 1)  # what is not sampled: nothing is read
        read, gaps = np.take_along_axis(chosen, order[:, :, None], axis=1), np.diff(at, prepend=-1)
        last = np.full((B, n), np.inf)
        for period in range(PERIODS - LOOKS):
            self.work.add((K * FILTER[0], FILTER[1]), B * K * n)
            for k in range(K):
                P = self.after(P, gaps[:, k])
                far = np.abs(P).max(axis=(1, 2)) > BEYOND
                lost |= far
                P[far] = 0.0
                P = self.measured(P, read[:, k])
            P = self.after(P, M - 1 - at[:, -1])
            now = np.diagonal(P, axis1=1, axis2=2)
            if np.all(np.abs(now - last) <= SETTLED * now):
                return P, lost, period + 1
            last = now
        return P, lost, PERIODS - LOOKS

    def beyond(self, at: Index, read: Mask, level: float) -> Mask:
        """Which choices leave a goal above a level: samples at the steps `at` (B, k) that `read` (B, k, p).

        Proven: from nothing unknown on, any period that does refutes. Goals just after samples are not looked at.
        """
        found = np.zeros(len(at), dtype=bool)
        for whole in (True, False):  # steps alone refute most, for less
            left = np.flatnonzero(~found)
            found[left] = self._beyond(at[left], read[left], level, whole)
        return found

    def _beyond(self, at: Index, read: Mask, level: float, whole: bool) -> Mask:
        """The same, at whole steps alone or within them too."""
        M, n, k = self.problem.steps, self.discrete.n, at.shape[1]
        gaps = np.diff(at, append=at[:, :1] + M)
        found, left, P, last = np.zeros(len(at), dtype=bool), np.arange(len(at)), np.zeros((len(at), n, n)), np.zeros(1)
        for _ in range(PERIODS):
            worst = np.zeros(len(left))
            for j in range(k):
                P = self.measured(P, read[left, j])
                worst = np.maximum(worst, self._ahead(at[left, j], P, whole)[np.arange(left.size), gaps[left, j] - 1])
                P = self.after(P, gaps[left, j])
            found[left] = worst > self._exceeds(level)
            if self.work.over or (worst.shape == last.shape and np.all(worst <= last * (1 + SETTLED))):
                break
            left, P, last = left[~found[left]], P[~found[left]], worst[~found[left]]
            if not left.size or np.abs(P).max() > self._most:
                break
        return found

    def lasting(self, at: Index, P: Array, level: float) -> Index:
        """Steps (B,) that no sample need come after those at `at` that leave at least P (B, n, n), M at most.

        Proven: a gap that lasts longer leaves a goal above the level, whatever was measured before and will be.
        """
        return np.asarray(np.sum(self._ahead(at, P) <= self._exceeds(level), axis=1))

    def measured(self, P: Array, read: Mask) -> Array:
        """Covariances (B, n, n) after samples that `read` (B, p), or roots: what was large before takes no digit."""
        P = P.copy() if self.grows else P
        for j in np.flatnonzero(read.any(axis=0)).tolist():
            h, mask = self.S[j], read[:, j]
            if self.grows:
                P[mask] = _read(P[mask], self.S[j : j + 1])
                continue
            Ph = P @ h
            P = P - (mask / (1.0 + Ph @ h))[:, None, None] * Ph[:, :, None] * Ph[:, None, :]
        return P

    def after(self, P: Array, gap: Index) -> Array:
        """The same so many steps (B,) later."""
        F, Q = self._gaps
        return carried(P, F[gap], self._gap_roots[gap]) if self.grows else propagate(P, F[gap], Q[gap])

    @cached_property
    def least(self) -> Array:
        """Covariances (M, n, n) before samples that no choice is below: all that is allowed was measured before."""
        M, n = self.problem.steps, self.discrete.n
        P, before, last = np.zeros((1, n, n)), np.zeros((M, n, n)), np.zeros((M, n, n))
        for _ in range(PERIODS):
            self.work.add((M * FILTER[0], FILTER[1]), M * n)
            for i in range(M):
                before[i] = P[0]
                P = self.after(self.measured(P, self.problem.allowed[i : i + 1]), np.array([1]))
            if self.work.over or np.abs(before - last).max() <= SETTLED * np.abs(before).max():
                break
            if np.abs(before).max() > self._most:
                return last
            last = before.copy()
        return before

    @cached_property
    def _gaps(self) -> tuple[Array, Array]:
        """F and Q (M + 1, n, n) over so many steps."""
        n = self.discrete.n
        flow, noise = [np.eye(n)], [np.zeros((n, n))]
        for _ in range(self.problem.steps):
            flow.append(self.F @ flow[-1])
            noise.append(propagate(noise[-1], self.F, self.Q))
        return np.array(flow), np.array(noise)

    @cached_property
    def _gap_roots(self) -> Array:
        """Roots of Q (M + 1, n, n) over so many steps."""
        return noise_roots(self.A, self.N, np.arange(self.problem.steps + 1.0) * self.discrete.step)

    @cached_property
    def _sure(self) -> Array:
        """Share (M + 1,) of a variance so many steps after a sample that is no rounding of a flow that grows so far."""
        return np.asarray(np.maximum(1 - ROUNDED * EPS * np.abs(self._gaps[0]).max(axis=(1, 2)), 0.0))

    def _exceeds(self, level: float) -> float:
        return level**2 * (1 + BEYOND_LEVEL)

    @cached_property
    def _looks(self) -> list[tuple[Array, Array]]:
        """Of each goal, at PARTS times of every step ahead: its row (M s, n) there, and what noise adds (M s,)."""
        F, Q = (each[:-1] for each in self._gaps)
        parts = np.arange(1, PARTS + 1) / PARTS * self.discrete.step
        flow, noise = discounted_flow(self.A, self.N @ self.N.T, parts)
        sure = self._sure[1:, None]
        found = list[tuple[Array, Array]]()
        for g, goal in enumerate(self.problem.goals):
            row, first = self.rows[g] / goal.tolerance, 0 if goal.at == "all times" else PARTS - 1
            later = row @ flow[first:]
            added = np.einsum("si,mij,sj->ms", later, Q, later) + row @ noise[first:] @ row
            found.append(((later @ F * np.sqrt(sure)[:, :, None]).reshape(-1, len(row)), (added * sure).ravel()))
        return found

    def _ahead(self, at: Index, P: Array, whole: bool = False) -> Array:
        """The largest variance (B, M) of a goal, in its tolerance, so many steps from `at` on and before."""
        M, n = self.problem.steps, self.discrete.n
        found, few = np.zeros((len(at), M)), max(1, ENTRIES // (M * PARTS * n))
        self.work.add(FILTER, len(at) * n)
        for g, goal in enumerate(self.problem.goals):
            if not goal.stochastic or own(goal):
                continue
            wanted, (later, added) = self._wanted(goal, np.zeros((1, M, 1), dtype=bool))[0], self._looks[g]
            if whole:
                later, added = later.reshape(M, -1, n)[:, -1], added.reshape(M, -1)[:, -1]
            for of in (slice(b, b + few) for b in range(0, len(at), few)):
                values = later @ P[of]
                values = np.sum(values * (values if self.grows else later), axis=2) + added
                when = wanted[(at[of, None] + np.arange(1, M + 1)) % M]
                most = values.reshape(len(values), M, -1).max(axis=2)
                found[of] = np.maximum(found[of], np.where(when, most, 0.0))
        return np.maximum.accumulate(found, axis=1)

    def ratios(self, chosen: Mask) -> Array:
        """Standard deviations over tolerances (B, goals, M); 0 where they are not asked for."""
        before, after = self.variances(chosen)
        found = np.zeros(before.shape)
        for g, goal in enumerate(self.problem.goals):
            if goal.stochastic:
                values = np.where(self._wanted(goal, chosen), (after if own(goal) else before)[:, g], 0.0)
                found[:, g] = np.sqrt(np.maximum(values, 0.0)) / goal.tolerance
        return found

    def worst(self, chosen: Mask) -> Array:
        """Their largest (B, goals)."""
        return np.asarray(self.ratios(chosen).max(axis=2))

    def _wanted(self, goal: RowGoal, chosen: Mask) -> Mask:
        """Steps (B, M) at which a goal is wanted."""
        if own(goal):
            return np.asarray(chosen.any(axis=2))
        wanted = np.ones(chosen.shape[1], dtype=bool)
        if goal.at == "given times":
            wanted[:] = False
            wanted[goal.steps.astype(int) % wanted.size] = True
        return np.broadcast_to(wanted, chosen.shape[:2])

    def tangent(self, z: Array, g: int) -> HiddenTrajectory | None:
        """The tangent at a point z (M, p) of a goal's variance where that is largest; None if it says nothing."""
        goal = self.problem.goals[g]
        wanted = self._wanted(goal, z[None] > 0)[0]
        if not wanted.any():
            return None
        periods = self._periods(z, g)
        last = periods[-1][1 if own(goal) else 0]
        return self._tangent(z, g, int(np.argmax(np.where(wanted, self._variance(last)[:, g], -1.0))), periods)

    def tangent_at(self, z: Array, g: int, end: int) -> HiddenTrajectory | None:
        """The same at one step: reach^2 less the sum of `peaks` over what is measured is below the variance."""
        return self._tangent(z, g, end, self._periods(z, g))

    @np.errstate(over="ignore", invalid="ignore")  # what overflows says nothing
    def _tangent(self, z: Array, g: int, end: int, periods: list[tuple[Array, Array]]) -> HiddenTrajectory | None:
        goal, M = self.problem.goals[g], len(z)
        i, at_sample = end % M, own(goal)
        lam, slope = self.rows[g] / goal.tolerance, np.zeros(z.shape)
        value = float(self._variance(periods[-1][1 if at_sample else 0][i][None])[0, g]) / goal.tolerance**2
        skip = not at_sample
        for _, after in reversed(periods):
            for k in range(i, -1, -1):
                if not skip:  # dV/dz = -(h'P lam)^2, and lam before the samples is (I - H'z H P) lam
                    gain = self.S @ (after[k] @ (after[k].T @ lam) if self.grows else after[k] @ lam)
                    slope[k] += gain**2
                    lam = lam - self.S.T @ (z[k] * gain)
                lam, skip = self.F.T @ lam, False
            i = M - 1
        (since,) = np.nonzero(np.roll(np.any(z, axis=1)[::-1], end + at_sample))
        sure = self._sure[int(since.min(initial=M - 1)) + (not at_sample)]
        value, slope = value * sure, slope * sure
        reach = float(np.sqrt(max(value + float(np.sum(slope * z)), 0.0)))
        if not 0 < reach < MOST_REACH or not np.isfinite(slope).all():
            return None
        turned = np.roll(slope[::-1], (end + 1) % M, axis=0)  # row k: k steps before the end
        point = np.roll(z[::-1], (end + 1) % M, axis=0)
        return HiddenTrajectory(g, reach, end, at_sample, turned, None, point)

    def _periods(self, z: Array, g: int) -> list[tuple[Array, Array]]:
        """Covariances before and after every step's samples, period by period from P = 0."""
        n, M = self.discrete.n, len(z)
        P, last, enough = np.zeros((1, n, n)), 0.0, ENOUGH * self.problem.goals[g].tolerance ** 2
        some, periods = np.any(z > 0, axis=1), list[tuple[Array, Array]]()
        for _ in range(TANGENT_PERIODS):
            self.work.add((M * FILTER[0], FILTER[1]), M * n)
            before, after = np.zeros((M, n, n)), np.zeros((M, n, n))
            for i in range(M):
                P = self.after(P, np.array([1]))
                before[i] = P[0]
                if some[i]:
                    root = P if self.grows else covariance_root(P[0])[None]
                    root = _read(root, np.sqrt(z[i])[:, None] * self.S)
                    P = root if self.grows else root @ root.swapaxes(1, 2)
                after[i] = P[0]
                if np.abs(P).max() > self._most:
                    return periods or [(before, after)]
            periods.append((before, after))
            now = float(self._variance(P)[0, g])
            if abs(now - last) <= SETTLED * now or now > enough:
                break
            last = now
        return periods


def _read(roots: Array, rows: Array) -> Array:
    """Roots (B, n, n) of what is left unknown once rows (k, n) are read, in units of their noise."""
    (B, n, _), k = roots.shape, len(rows)
    both = np.zeros((B, k + n, k + n))
    both[:, :k, :k], both[:, :k, k:], both[:, k:, k:] = np.eye(k), rows @ roots, roots
    return triangle(both)[:, k:, k:]


def reached_first(A: Array, N: Array) -> tuple[Array, int]:
    """Coordinates z = V s whose first r entries are all that noise N reaches, V orthonormal, and r.

        im V_r = im [N, A N, A^2 N, ...]

    What nothing drives is then exactly 0 in what begins at 0: rounding would drive it, and it may grow.
    """
    V, r, more = np.zeros((len(A), 0)), 0, N
    while True:
        left, sizes, _ = np.linalg.svd(more - V @ (V.T @ more), full_matrices=False)
        fresh = left[:, sizes > NOT_DRIVEN * np.linalg.norm(more, 2)] if sizes.size else left
        V = np.linalg.qr(np.hstack([V, fresh]))[0]
        if not fresh.shape[1]:
            break
        r, more = V.shape[1], A @ V
    return (np.linalg.qr(np.hstack([V, np.identity(len(A))]))[0] if r < len(A) else np.identity(r)), r


def own(goal: RowGoal) -> bool:
    """Whether a goal is wanted just after samples, with what these say."""
    return goal.at == "after each sample"
