"""ln lambda of a set of windows as a smooth function of P2, with its gradient: what the choice of weights descends on.

Y depends on X = P2^-1 through dY(t) = Phi dX Phi', Phi the closed loop of the window, so that for the top
eigenvector e of L'YL (P2 = L L') the gradient of lambda in P2 is lambda a a' - b b', a = L^-T e, b = X Phi' L e.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from sampling_design.certificates.exact.riccati import periodic_riccati_solution
from sampling_design.certificates.exact.window_problem import WindowProblem
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.numerics.filtering import joint_update, propagate
from sampling_design.numerics.linalg import eigenvalue_bound
from sampling_design.records.arrays import Array, Index, Mask

LATER = 1e-9  # share of its gap by which a first sample is later than in the rhythm, and not by rounding of its time
MERGED = 1e-3  # a window this near the periodic solution, relative to it or to P2^-1, is followed no further
MOST_WINDOWS, FEWER = 48, 20  # windows of one set, of plants with at most FOUR states and of larger ones
FOUR = 4
MOST_STEPS = 150
ACTIVE = 0.05
"""Times of a window whose ln lambda lies within this of its largest enter the smooth maximum."""
SHARPNESS = 100.0
"""Exponent of the smooth maximum over a window's times: it exceeds the true one by ln(times)/100 at most."""
MANY = 4  # largest eigenvalues to be found in a window from which on powers are asked first which of them count
POWERS, SAFE = (4, 16), 1e-9  # that bound a largest eigenvalue, one after the other; more than they lose in rounding
PARTS = (0.5, 1.0)
STEP_WORK, GAINS = (20, 55, 0.6, 0.002), 1.5
"""Work of one sample of all windows: so much, so much for each output, and for n and n^3 of each window; and how many
times as much it is with gains."""
SET_UP = 1000  # work, about microseconds, of a set of windows before any is followed


class WindowConditions(Protocol):
    """What first guesses ask of the windows of one rate, however many digits these are followed in."""

    @property
    def steady(self) -> Array | None:
        """Y after each sample of the period in the long run; None for a finite schedule."""

    def long_run(self, prior: Array) -> Array:
        """Y in the long run and of windows before it; of a finite schedule, along those from P2^-1 = `prior`."""

    def least_floor(self, size: Array) -> float:
        """The largest eigenvalue of size Y size in the long run."""

    def value(self, P: Array) -> float:
        """ln lambda of P2 = P."""


@dataclass(frozen=True, eq=False)
class WindowSet:
    """Windows of a problem in the coordinates of the (scaled) plant, P2 left open; flows are those of one eta."""

    problem: WindowProblem
    index: Index
    head: tuple[Array, Array]
    inside: tuple[Array, Array]
    steady: Array | None
    work: WorkLimit = field(default_factory=lambda: WorkLimit(np.inf))

    @classmethod
    def of(cls, problem: WindowProblem, work: WorkLimit | None = None) -> WindowSet:
        """Sample starts and starts in the middle of each gap; where these are too many, evenly chosen ones."""
        index, remaining = problem.sample_starts()
        index = np.append(index, np.arange(problem.count))
        remaining = np.append(remaining, problem.reach / 2)
        most = MOST_WINDOWS if problem.size <= FOUR else FEWER
        if index.size > most:
            order = np.argsort(-remaining, kind="stable")
            chosen = order[np.linspace(0, order.size - 1, most).astype(int)]
            index, remaining = index[chosen], remaining[chosen]
        work = WorkLimit(np.inf) if work is None else work
        work.spend(SET_UP + 100 * problem.count)
        parts = np.asarray(PARTS)
        F, W = problem.flow(np.outer(problem.gaps, parts).ravel())
        shape = (problem.count, parts.size, problem.size, problem.size)
        steady = None if problem.period is None else periodic_riccati_solution(problem, work)
        return cls(problem, index, problem.flow(remaining), (F.reshape(shape), W.reshape(shape)), steady, work)

    def least_floor(self, size: Array) -> float:
        """The largest eigenvalue of size Y size in the long run and on the way there (of windows without prior error).

        No certificate with this eta has a smaller 1/lambda_min(P1), states counted in units of 1/size.
        """
        Y = self.long_run(np.zeros((self.problem.size, self.problem.size)))
        return float(np.linalg.eigvalsh(Y * size * size[:, None])[..., -1].max())

    @property
    def cycle(self) -> Array:
        """Y within the gaps of the long-run period, (times, n, n); none of a finite schedule."""
        n = self.problem.size
        if self.steady is None:
            return np.zeros((0, n, n))
        follower = (np.arange(self.problem.count) + 1) % self.problem.count
        return propagate(self.steady[:, None], self.inside[0][follower], self.inside[1][follower]).reshape(-1, n, n)

    def long_run(self, prior: Array) -> Array:
        """Y within the gaps of the long-run period; of a finite schedule, along its windows from P2^-1 = `prior`.

        A first sample that comes later than in the rhythm has windows that rise above the long run even from zero.
        """
        late = self.problem.times[0] > self.problem.gaps[0] * (1 + LATER)
        if self.problem.period is not None and not late:
            return self.cycle
        Y, _, valid = self._paths(prior if self.steady is None else np.zeros_like(prior), gains=False)
        return np.concatenate([self.cycle, Y[valid]])

    def _paths(self, X: Array, gains: bool = True) -> tuple[Array, Array, Mask]:
        """Y and Phi at the noted times, shape (times, windows, n, n), and which of them lie within the schedule.

        Without `gains` Phi stays as it is at the first sample.
        """
        problem = self.problem
        Y, Phi, at = propagate(X, *self.head), self.head[0], self.index
        Ys, Phis, valid = [Y], [Phi], [np.ones(at.size, dtype=bool)]
        alive = valid[0]
        scale = max(float(np.linalg.norm(X)), 0.0 if self.steady is None else float(np.linalg.norm(self.steady[0])))
        for _ in range(MOST_STEPS):
            following, gain_free = joint_update(Y, problem.rows[at], Phi if gains else None)
            if self.steady is None:
                alive = alive & (at + 1 < problem.count)
            else:
                ahead = np.linalg.norm(following - self.steady[at], axis=(1, 2))
                alive = alive & (ahead > MERGED * scale)
            if not alive.any():
                break
            at = (at + 1) % problem.count
            n, (once, output, row, product) = problem.size, STEP_WORK
            price = once + output * problem.rows.shape[-2] + at.size * (row * n + product * n**3)
            self.work.spend(price * (GAINS if gains else 1))
            for part in range(len(PARTS)):
                F, W = self.inside[0][at, part], self.inside[1][at, part]
                Y = propagate(following, F, W)
                Ys.append(Y)
                valid.append(alive)
                if gain_free is not None:
                    Phi = F @ gain_free
                    Phis.append(Phi)
        return np.array(Ys), np.array(Phis), np.array(valid)

    def value(self, P: Array) -> float:
        """The largest of `log_lambda` for P2 = P, without gradients."""
        L = np.linalg.cholesky(P)
        half = np.asarray(np.linalg.inv(L), dtype=np.float64)
        Y, _, valid = self._paths(half.T @ half, gains=False)
        tops = []
        if len(cycle := self.cycle):
            tops.append(_log_largest_eigenvalues(L.T @ cycle @ L, np.ones(len(cycle), dtype=bool)).max())
        logs = _log_largest_eigenvalues(L.T @ Y @ L, valid)
        top = logs.max(axis=0)
        total = np.sum(np.exp(SHARPNESS * np.minimum(logs - top, 0.0)), axis=0, where=logs > top - ACTIVE)
        return float(max([0.0, *tops, (top + np.log(total) / SHARPNESS).max()]))  # a window starts with one

    def log_lambda(self, L: Array) -> tuple[Array, Array]:
        """Return ln lambda of each window (last: the periodic solution) and gradients in P2, (m,) and (m, n, n)."""
        half = np.asarray(np.linalg.inv(L), dtype=np.float64)
        X = half.T @ half
        Y, Phi, valid = self._paths(X)
        cycle = self.cycle
        values, gradients = _smooth_max(L, half, X, Y, Phi, valid)
        if not len(cycle):
            return values, gradients
        last, slope = _smooth_max(
            L, half, X, cycle[:, None], np.zeros_like(cycle[:, None]), np.ones((len(cycle), 1), bool)
        )
        return np.append(values, last), np.concatenate([gradients, slope])


def _log_largest_eigenvalues(ratios: Array, valid: Mask) -> Array:
    """ln lambda_max of each matrix, times first; -inf where it cannot enter a smooth maximum over times.

    Bounds from the diagonal and the Frobenius norm spare most of the eigenvalues; of larger matrices the largest one of
    the time with the largest entry, and the bound of powers, spare most of those that are left.
    """
    diagonal = np.where(valid, np.diagonal(ratios, axis1=-2, axis2=-1).max(axis=-1), 0.0)
    below, bound = diagonal.max(axis=0), eigenvalue_bound(ratios)
    hopeful = valid & ~(bound < np.exp(-ACTIVE) * below)
    if ratios.shape[-1] > FOUR and below.size and np.count_nonzero(hopeful) > MANY * below.size:
        leading = ratios[(np.argmax(diagonal, axis=0), *np.indices(below.shape))]
        below = np.maximum(below, np.linalg.eigvalsh(leading)[..., -1] * (1 - SAFE))
        hopeful &= ~(bound < np.exp(-ACTIVE) * below)
        where = np.nonzero(hopeful)
        raised = ratios[where] / below[where[1:]][..., None, None]
        for power in POWERS:
            raised = raised @ raised
            raised = raised @ raised
            left = ~(eigenvalue_bound(raised) * (1 + SAFE) < np.exp(-ACTIVE * power))
            hopeful[tuple(part[~left] for part in where)] = False
            raised, where = raised[left], tuple(part[left] for part in where)
    logs = np.full(ratios.shape[:-2], -np.inf)
    logs[hopeful] = np.log(np.maximum(np.linalg.eigvalsh(ratios[hopeful])[..., -1], 1e-300))
    return logs


def _smooth_max(L: Array, half: Array, X: Array, Y: Array, Phi: Array, valid: Mask) -> tuple[Array, Array]:
    """Smooth maximum over times (first axis) of ln lambda_max(L'YL) per window, and its gradient in P2."""
    ratios = L.T @ Y @ L
    logs = _log_largest_eigenvalues(ratios, valid)
    top = logs.max(axis=0)
    time, window = np.nonzero(logs > top - ACTIVE)
    share = np.exp(SHARPNESS * (logs[time, window] - top[window]))
    total = np.bincount(window, share, minlength=top.size)
    values, vectors = np.linalg.eigh(ratios[time, window])
    e, lam = vectors[..., -1], values[..., -1]
    a = e @ half
    b = np.einsum("kji,kj->ki", Phi[time, window], e @ L.T) @ X
    slopes = a[:, :, None] * a[:, None, :] - b[:, :, None] * b[:, None, :] / lam[:, None, None]
    gradients = np.zeros((top.size, *X.shape))
    np.add.at(gradients, window, (share / total[window])[:, None, None] * slopes)
    return top + np.log(total) / SHARPNESS, gradients
