"""ln lambda of a set of windows as a function of P2, with its gradients: what the choice of weights descends on.

Y(t) is a linear fractional function of X = P2^-1, about X0

    Y = Y0 + Phi D (I + G D)^-1 Phi',   D = X - X0,

with the closed loop Phi of the window and the information G that its gains have taken: one recursion, and then no more.
For the top eigenvector e of L'YL (P2 = L L') the gradient of lambda in P2 is lambda a a' - b b', a = L^-T e,
b = X Phi(X)' L e, Phi(X) = Phi (I + D G)^-1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.exact.riccati import periodic_riccati_solution
from sampling_design.certificates.exact.window_problem import WindowProblem
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.numerics.filtering import joint_update, propagate
from sampling_design.numerics.linalg import eigenvalue_bound, symmetrise
from sampling_design.records.arrays import Array, Index, Mask

LATER = 1e-9  # share of its gap by which a first sample is later than in the rhythm, and not by rounding of its time
MERGED = 1e-3  # a window this near the periodic solution, relative to it or to P2^-1, is followed no further
MOST_WINDOWS = 48  # windows of one set: with fewer, weights are found that other windows make useless
SMALL = 4  # states up to which all eigenvalues take less than to ask which of them count
MOST_STEPS = 150
ACTIVE = 0.05
"""Times whose ln lambda is below the largest by more than this bind nothing for the moment: a descent leaves out their
gradients, and a look at all windows those of each below its own largest; with more, eigenvalues take longer."""
MANY = 4  # largest eigenvalues to be found in a window from which on powers are asked first which of them count
POWERS, SAFE = (4, 16), 1e-9  # that bound a largest eigenvalue, one after the other; more than they lose in rounding
PARTS = (0.5, 1.0)
STEP_WORK, GAINS = (20, 55, 0.4, 0.0013), 1.5
"""Work of one sample of all windows: so much, so much for each output, and for n and n^3 of each window; and how many
times as much it is with gains."""
MOST_HELD = 1.5e5  # numbers in the matrices of the times that are followed as functions of P2, for each of three
MAP_WORK = (100, 1.5, 0.13)
"""Work of asking these once: so much, and so much and so many times n^2 for each of them."""
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

    def looked(self, P: Array) -> Look:
        """ln lambda of P2 = P, and of its multiples nearby."""


@dataclass(frozen=True, eq=False)
class Look:
    """ln lambda for one P2; `along` says it of e^s P2 where s is within `reach`."""

    value: float
    reach: float = 0.0

    def along(self, log_scale: float) -> float:
        """ln lambda of e^s P2."""
        return self.value if log_scale == 0 else np.nan


@dataclass(frozen=True, eq=False)
class WindowSet:
    """Windows of a problem in the coordinates of the (scaled) plant, P2 left open; flows are those of one eta."""

    problem: WindowProblem
    index: Index
    head: tuple[Array, Array]
    inside: tuple[Array, Array]
    steady: Array | None
    work: WorkLimit = field(default_factory=lambda: WorkLimit(np.inf))
    _last: dict[bytes, WindowLook] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: WindowProblem, work: WorkLimit | None = None) -> WindowSet:
        """Sample starts and starts in the middle of each gap; where these are too many, evenly chosen ones."""
        index, remaining = problem.sample_starts()
        index = np.append(index, np.arange(problem.count))
        remaining = np.append(remaining, problem.reach / 2)
        if index.size > MOST_WINDOWS:
            order = np.argsort(-remaining, kind="stable")
            chosen = order[np.linspace(0, order.size - 1, MOST_WINDOWS).astype(int)]
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
        Y, valid = self._paths(prior if self.steady is None else np.zeros_like(prior))
        return np.concatenate([self.cycle, Y[valid]])

    def _paths(self, X: Array) -> tuple[Array, Mask]:
        """Y at the noted times, shape (times, windows, n, n), and which of them lie within the schedule."""
        problem = self.problem
        Y, at = propagate(X, *self.head), self.index
        Ys, valid = [Y[:, None]], [np.ones((at.size, 1), dtype=bool)]
        alive = np.ones(at.size, dtype=bool)
        scale = max(float(np.linalg.norm(X)), 0.0 if self.steady is None else float(np.linalg.norm(self.steady[0])))
        for _ in range(MOST_STEPS):
            Y = joint_update(Y, problem.rows[at])[0]
            if self.steady is None:
                alive = alive & (at + 1 < problem.count)
            else:
                ahead = np.linalg.norm(Y - self.steady[at], axis=(1, 2))
                alive = alive & (ahead > MERGED * scale)
            if not alive.any():
                break
            at = (at + 1) % problem.count
            self._spend(at.size)
            Ys.append(propagate(Y[:, None], self.inside[0][at], self.inside[1][at]))
            valid.append(np.repeat(alive[:, None], len(PARTS), axis=1))
            Y = Ys[-1][:, -1]
        return np.concatenate(Ys, axis=1).swapaxes(0, 1), np.concatenate(valid, axis=1).T

    def _spend(self, windows: int, times: float = 1.0) -> None:
        """Count one sample of so many windows."""
        n, (once, output, row, product) = self.problem.size, STEP_WORK
        price = once + output * self.problem.rows.shape[-2] + windows * (row * n + product * n**3)
        self.work.spend(times * price)

    def looked(self, P: Array) -> WindowLook:
        """ln lambda for P2 = P at every noted time; that of the last P is kept."""
        if P.tobytes() in self._last:
            return self._last[P.tobytes()]
        L = np.asarray(np.linalg.cholesky(P), dtype=np.float64)
        half = np.asarray(np.linalg.inv(L), dtype=np.float64)
        Y, valid = self._paths(half.T @ half)
        logs = np.full(valid.shape, -np.inf)
        logs[valid] = _log_largest_eigenvalues(L.T @ Y[valid] @ L, np.nonzero(valid)[1])
        lasting = _log_largest_eigenvalues(L.T @ self.cycle @ L)
        value = float(np.maximum(logs.max(), lasting.max(initial=0.0)))  # a window starts with one
        self._last.clear()
        self._last[P.tobytes()] = look = WindowLook(value, ACTIVE, windows=self, L=L, logs=logs, cycle=lasting)
        return look

    def maps(self, L: Array, times: WindowTimes) -> WindowMaps:
        """Y at these times as a function of P2, about P2 = L L' and in the coordinates L'x, in which that is I."""
        problem, n = self.problem, self.problem.size
        windows, place = np.unique(times.window, return_inverse=True)
        at, unit = self.index[windows], np.linalg.inv(L).T
        Y = propagate(unit @ unit.T, self.head[0][windows], self.head[1][windows])
        Phi, G = self.head[0][windows] @ unit, np.zeros((at.size, n, n))
        noted = [(Y[:, None], Phi[:, None], G[:, None])]
        for _ in range(times.steps):
            rows = problem.rows[at]
            seen = rows @ Phi
            told = np.linalg.solve(propagate(Y, rows, np.eye(rows.shape[-2])), seen)
            G = G + seen.swapaxes(-1, -2) @ told
            Y, left = joint_update(Y, rows, Phi)
            at = (at + 1) % problem.count
            self._spend(at.size, GAINS)
            F = self.inside[0][at]
            Ys, Phis = propagate(Y[:, None], F, self.inside[1][at]), F @ np.asarray(left)[:, None]
            noted.append((Ys, Phis, np.broadcast_to(G[:, None], Ys.shape)))
            Y, Phi = Ys[:, -1], Phis[:, -1]
        Y, Phi, G = (np.concatenate(part, axis=1)[place, times.time] for part in zip(*noted, strict=True))
        cycle = self.cycle[times.cycle]
        none = np.zeros_like(cycle)  # the long run depends on no P2
        Y, Phi, G = (np.concatenate(both) for both in ((Y, cycle), (Phi, none), (G, none)))
        return WindowMaps(L.T @ Y @ L, L.T @ Phi, G, self.work)


@dataclass(frozen=True, eq=False)
class WindowTimes:
    """Some times, each of its window, and places in the long-run cycle."""

    window: Index
    time: Index
    cycle: Index

    def also(self, other: WindowTimes | None) -> WindowTimes:
        """These and others."""
        if other is None:
            return self
        both = np.unique(np.stack([np.append(self.window, other.window), np.append(self.time, other.time)]), axis=1)
        return WindowTimes(both[0], both[1], np.union1d(self.cycle, other.cycle))

    @property
    def steps(self) -> int:
        """Samples up to the last of these times."""
        return -(-int(self.time.max(initial=0)) // len(PARTS))


@dataclass(frozen=True, eq=False)
class WindowLook(Look):
    """ln lambda at every time of all windows, for P2 = L L'; times first."""

    windows: WindowSet = field(kw_only=True)
    L: Array = field(kw_only=True)
    logs: Array = field(kw_only=True)
    cycle: Array = field(kw_only=True)

    def along(self, log_scale: float) -> float:
        """ln lambda of e^s P2: it rises by s at most, so few times can count."""
        if log_scale == 0:
            return self.value
        maps = self._within_reach
        counts = maps.logs >= maps.logs.max() - ACTIVE - abs(log_scale)
        return maps.only(counts).value(np.exp(log_scale / 2) * np.eye(len(self.L)))

    @cached_property
    def _within_reach(self) -> WindowMaps:
        return self.near(ACTIVE + self.reach)

    def times(self, within: float) -> WindowTimes:
        """The times at which ln lambda lies within so much of its largest."""
        least = max(self.logs.max(), self.cycle.max(initial=-np.inf)) - within
        most = int(MOST_HELD / self.L.size)
        if np.count_nonzero(self.logs > least) > most:
            least = np.partition(self.logs, -most, axis=None).ravel()[-most]
        time, window = np.nonzero(self.logs > least)
        return WindowTimes(window, time, np.flatnonzero(self.cycle > least))

    def near(self, within: float) -> WindowMaps:
        """What these times become where P2 moves."""
        return self.windows.maps(self.L, self.times(within))


@dataclass(frozen=True, eq=False)
class WindowMaps:
    """Y at some times of some windows as a function of P2 = L T T' L', in the coordinates L'x."""

    Y: Array
    Phi: Array
    G: Array
    work: WorkLimit

    @cached_property
    def logs(self) -> Array:
        """ln lambda at each of the times for P2 = L L'."""
        return _log(np.linalg.eigvalsh(self.Y)[:, -1])

    def only(self, where: Mask) -> WindowMaps:
        """Some of the times."""
        return WindowMaps(self.Y[where], self.Phi[where], self.G[where], self.work)

    def _moved(self, T: Array) -> tuple[Array, Array, Array, Array]:
        """T'YT, (I + D G)^-1, T^-1 and X = T^-T T^-1."""
        n, (once, each, product) = len(T), MAP_WORK
        self.work.spend(once + len(self.Y) * (each + product * n**2))
        half = np.asarray(np.linalg.inv(T), dtype=np.float64)
        X = half.T @ half
        D = X - np.eye(n)
        left = np.asarray(np.linalg.inv(np.eye(n) + D @ self.G), dtype=np.float64)
        Y = propagate(left @ D, self.Phi, self.Y)
        return symmetrise(T.T @ Y @ T), left, half, X

    def value(self, T: Array) -> float:
        """The largest of `log_lambda`, without gradients."""
        ratios = self._moved(T)[0]
        return float(np.maximum(_log_largest_eigenvalues(ratios).max(), 0.0))

    def log_lambda(self, T: Array) -> tuple[Array, Array]:
        """ln lambda at each time and gradients in T T', (m,) and (m, n, n).

        What is below the largest by more than `ACTIVE` is said to be so much below it, whatever T is.
        """
        ratios, left, half, X = self._moved(T)
        counts = _hopeful(ratios)
        values, vectors = np.linalg.eigh(ratios[counts])
        lam, e = np.maximum(values[:, -1], 1e-300), vectors[..., -1]
        a = e @ half
        b = (left[counts].swapaxes(-1, -2) @ (self.Phi[counts].swapaxes(-1, -2) @ (e @ T.T)[..., None]))[..., 0] @ X
        logs, gradients = np.full(counts.size, np.log(lam.max()) - ACTIVE), np.zeros_like(ratios)
        logs[counts] = np.log(lam)
        gradients[counts] = a[:, :, None] * a[:, None, :] - b[:, :, None] * b[:, None, :] / lam[:, None, None]
        return logs, gradients


def _log_largest_eigenvalues(ratios: Array, window: Index | None = None) -> Array:
    """ln lambda_max of each matrix; -inf where it is below the largest of its window (of all) by more than `ACTIVE`."""
    logs, hopeful = np.full(len(ratios), -np.inf), _hopeful(ratios, window)
    logs[hopeful] = _log(np.linalg.eigvalsh(ratios[hopeful])[:, -1])
    return logs


def _log(values: npt.ArrayLike) -> Array:
    return np.asarray(np.log(np.maximum(values, 1e-300)), dtype=np.float64)


def _hopeful(ratios: Array, window: Index | None = None) -> Mask:
    """Which largest eigenvalues may lie within `ACTIVE` of the largest of their window (of all), in logarithms.

    Bounds from the diagonal and the Frobenius norm spare most of the eigenvalues; of larger matrices the largest one of
    the time with the largest entry, and the bound of powers, spare most of those that are left.
    """
    window = np.zeros(len(ratios), dtype=np.intp) if window is None else window
    diagonal, bound = np.diagonal(ratios, axis1=-2, axis2=-1).max(axis=-1), eigenvalue_bound(ratios)
    order = np.lexsort((diagonal, window))
    leading = order[np.append(np.diff(window[order]) > 0, True)[: order.size]]  # of each window
    below, least = np.zeros(int(window.max(initial=-1)) + 1), np.exp(-ACTIVE)
    below[window[leading]] = diagonal[leading]
    hopeful = ~(bound < least * below[window])
    if ratios.shape[-1] > SMALL and np.count_nonzero(hopeful) > MANY * leading.size:
        largest = np.linalg.eigvalsh(ratios[leading])[:, -1] * (1 - SAFE)
        below[window[leading]] = np.maximum(diagonal[leading], largest)
        where = np.flatnonzero(hopeful := hopeful & ~(bound < least * below[window]))
        raised = ratios[where] / below[window[where]][:, None, None]
        for power in POWERS:
            raised = raised @ raised
            raised = raised @ raised
            left = ~(eigenvalue_bound(raised) * (1 + SAFE) < least**power)
            hopeful[where[~left]] = False
            raised, where = raised[left], where[left]
    return np.asarray(hopeful)
