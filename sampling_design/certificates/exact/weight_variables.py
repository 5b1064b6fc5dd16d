"""What a descent on weights varies, at which times of windows it looks, and the best points that it meets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_triangular

from sampling_design.certificates.exact.noise_gain_scale import RateWindows
from sampling_design.certificates.exact.window_gains import WindowMaps
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.records.arrays import Array
from sampling_design.records.budget import BudgetSpentError

DIFFERENCE = 1e-5  # relative step in eta of the one difference quotient
KEPT = 1e-6  # ln of what a point may be off the budget that counts as kept: more would flatter it
OFF = 0.05  # ln of what a point may be off the budget to be brought back to it to first order: farther off that errs
STEEPEST = 0.9  # rise of ln lam with the logarithm of the scale, beyond which no slope tells what a scale costs
STEP_WORK = 30  # work of one step of a descent, per variable, beside that of its windows


class WeightVariables:
    """Variables z = (ln lam, entries of T, ln eta), P2 = L T T' L'.

    Constraints: ln lambda at every time that is followed, and every eigenvalue of (P2, B).
    """

    def __init__(
        self,
        setting: Callable[[float], RateWindows],
        maps: Callable[[float], WindowMaps],
        start: tuple[Array, float],
        bounds: tuple[float, float],
        budget: float,
        work: WorkLimit,
    ) -> None:
        self.setting, self.maps, self.bounds, self.budget = setting, maps, bounds, budget
        (self.L, self.eta), self.work = start, work
        self._maps: tuple[float, WindowMaps | None] = (np.nan, None)
        self.lower = np.tril_indices(len(self.L))
        self.known: tuple[bytes, Array, Array] = (b"", np.zeros(0), np.zeros(0))
        self.kept: tuple[float, float, Array] = (np.inf, 0.0, np.zeros(0))
        """The least ln(lam)/eta met that keeps the budget, ln lam of windows there, and where."""
        self.near = self.kept  # likewise of what is near the budget, on it to first order

    def start(self) -> Array:
        """The starting point, ln lam just feasible."""
        z = np.concatenate([[0.0], np.eye(len(self.L))[self.lower], [np.log(self.eta)]])
        z[0] = max(-self.at(z)[0][: -len(self.L)].min(), 0.0)
        return z

    def unpack(self, z: Array) -> tuple[Array, float]:
        """T and eta."""
        T = np.zeros_like(self.L)
        T[self.lower] = z[1:-1]
        return T, float(np.clip(np.exp(z[-1]), *self.bounds))

    def objective(self, z: Array) -> tuple[float, Array]:
        """ln(lam)/eta in units of the first eta, and its gradient."""
        ratio = self.eta / np.exp(z[-1])
        slope = np.zeros_like(z)
        slope[0], slope[-1] = ratio, -z[0] * ratio
        return float(z[0] * ratio), slope

    def at(self, z: Array) -> tuple[Array, Array]:
        """Constraint values (>= 0) and gradients at z."""
        if self.known[0] == z.tobytes():
            return self.known[1:]
        if self.work.over:
            raise BudgetSpentError
        self.work.spend(STEP_WORK * z.size)
        T, rate = self.unpack(z)
        value, slope = self._constraints(T, rate, z[0])
        # what counts is the least horizon on the budget: at the scale that it allows, by the slope of ln lam in that
        highest = int(np.argmin(value[: -len(T)]))
        need = max(z[0] - value[highest], 0.0)
        room = value[-len(T) :].min() + z[0] - need
        rises = float(np.clip(-slope[highest, 1:-1] @ z[1:-1] / 2, 0.0, STEEPEST))
        on_budget = max(need - room * rises / (1 - rises), 0.0) / rate
        if room >= -KEPT and need / rate < self.kept[0]:
            self.kept = need / rate, need, z.copy()
        if room >= -OFF and on_budget < self.near[0]:
            self.near = on_budget, need, z.copy()
        self.known = (z.tobytes(), value, slope)
        return value, slope

    def _maps_at(self, rate: float) -> WindowMaps:
        """The windows of a rate about the first P2, of the last rate kept."""
        if self._maps[0] != rate:
            self._maps = rate, self.maps(rate)
        assert self._maps[1] is not None
        return self._maps[1]

    def jacobian(self, z: Array) -> Array:
        """Gradients of the constraints; the one in ln eta is a difference quotient, and only here."""
        value, slope = self.at(z)
        if self.bounds[1] > self.bounds[0]:
            T, rate = self.unpack(z)
            step = DIFFERENCE if rate * (1 + DIFFERENCE) <= self.bounds[1] else -DIFFERENCE
            slope[:, -1] = (self._constraints(T, rate * (1 + step), z[0])[0] - value) / np.log1p(step)
        return slope

    def _constraints(self, T: Array, rate: float, log_lam: float) -> tuple[Array, Array]:
        setting = self.setting(rate)
        logs, gradients = self._maps_at(rate).log_lambda(T)
        vectors, sizes, _ = np.linalg.svd(solve_triangular(setting.b, self.L @ T, lower=True))
        sizes = np.maximum(sizes, 1e-150)
        along = self.L.T @ solve_triangular(setting.b, vectors, lower=True, trans="T") / sizes
        sized = np.einsum("ik,jk->kij", along, along)
        room = np.log(self.budget) - log_lam + 2 * np.log(sizes)
        slopes = np.concatenate([-gradients, sized])
        in_T = 2 * slopes @ T
        slope = np.zeros((len(slopes), 2 + self.lower[0].size))
        slope[:, 1:-1] = in_T[:, self.lower[0], self.lower[1]]
        slope[:, 0] = np.append(np.ones(logs.size), -np.ones(sizes.size))
        return np.append(log_lam - logs, room), slope
