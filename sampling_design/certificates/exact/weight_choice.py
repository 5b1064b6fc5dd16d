"""The choice of eta and of the shape of P2 for the least horizon under a noise budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize, minimize_scalar

from sampling_design.certificates.exact.window_gains import WindowSet
from sampling_design.certificates.exact.window_problem import AnySchedule, window_problem
from sampling_design.certificates.existence.periodic import certificate_exists, require_certificate
from sampling_design.errors import SolverError
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

ETA_RANGE = (0.05, 3.0)
"""Rates that are searched, in units of 1/(mean gap) (formats.md, Defaults)."""
BELOW_UNSEEN = 0.9
"""Fraction of the rate 2 |Re lambda| of an unseen stable mode up to which eta is searched."""
SCAN = 7
SCALES = (-12, 12)
"""Powers of two between which the first guess scales L."""
ROUNDNESS = (0.01, 1.0, 30.0)
"""Shares of the identity in the shapes of the first guess."""
STARTS = 3
"""Rates of the scan from which the descent starts."""
MAX_ITERATIONS = 40
PRECISION = 1e-5
"""Change of ln lam (of the horizon, relative) at which the descent stops."""
DIFFERENCE = 1e-5
"""Relative step in eta of the one difference quotient."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Weights found: P2 in the plant's coordinates, eta, and how the search ended."""

    P2: Array
    eta: float
    iterations: int
    status: str


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended: L of P2 = L L' in scaled coordinates, eta, ln(lam)/eta."""

    L: Array
    eta: float
    value: float
    iterations: int
    status: str


@dataclass(frozen=True, eq=False)
class Search:
    """Minimise ln(lam)/eta over the shape of P2, in scaled coordinates where the noise budget is counted."""

    plant: Plant
    schedule: AnySchedule
    weights: tuple[Array, Array, Array]
    budget: float

    def windows(self, eta: float) -> WindowSet:
        """The windows of one rate, in coordinates x/s_x."""
        P2 = np.diag(1.0 / self.plant.states.scales**2)
        return WindowSet.of(window_problem(self.plant, self.schedule, P2, *self.weights, eta))

    def first_guess(self, windows: WindowSet) -> tuple[Array, float]:
        """L of P2 = L L' at the least scale allowed, the best of a few shapes, and its ln lam.

        The shapes lie between the average long-run information and the identity, which any budget above 1 allows.
        """
        mean = windows.average()
        allowed = np.log(self.budget * windows.least_floor())
        size = np.trace(mean) / len(mean)
        found: list[tuple[float, Array]] = []
        for roundness in ROUNDNESS:
            L = np.linalg.cholesky(np.linalg.inv(mean + roundness * size * np.eye(len(mean))))
            least = float(np.log(np.linalg.eigvalsh(L @ L.T)[0]))
            low, high, best = *SCALES, np.inf
            while high - low > 1:  # lam falls with the scale of P2 while the noise gain lam/lambda_min(P2) grows
                middle = (low + high) // 2
                log_lam = float(windows.log_lambda(2.0**middle * L)[0].max())
                fits = log_lam - least - middle * np.log(4.0) <= allowed
                low, high, best = (low, middle, log_lam) if fits else (middle, high, best)
            found.append((best, 2.0**high * L))
        log_lam, L = min(found, key=lambda pair: pair[0])
        return L, log_lam

    def descend(self, L: Array, eta: float, bounds: tuple[float, float]) -> Descent:
        """Sequential quadratic programming on ln lam, T (L = L0 T) and ln eta."""
        state = _State(self, L, eta, bounds)
        start = state.start()
        free = [(None, None)] * (start.size - 1)
        solve: Any = minimize
        found = solve(
            state.objective,
            start,
            jac=True,
            method="SLSQP",
            bounds=[*free, (np.log(bounds[0]), np.log(bounds[1]))],
            constraints={"type": "ineq", "fun": lambda z: state.at(z)[0], "jac": state.jacobian},
            options={"maxiter": MAX_ITERATIONS, "ftol": PRECISION},
        )
        T, rate = state.unpack(state.best)
        return Descent(L @ T, rate, state.value, int(found.nit), str(found.message))


class _State:
    """Variables z = (ln lam, entries of T, ln eta); constraints: every window, and every eigenvalue of P2."""

    def __init__(self, search: Search, L: Array, eta: float, bounds: tuple[float, float]) -> None:
        self.search, self.L, self.eta, self.bounds = search, L, eta, bounds
        self.lower = np.tril_indices(len(L))
        self.known: tuple[bytes, Array, Array] = (b"", np.zeros(0), np.zeros(0))
        self.sets: dict[float, WindowSet] = {}
        self.best, self.value = np.zeros(0), np.inf  # the best point met that keeps the budget

    def start(self) -> Array:
        """The starting point, ln lam just feasible."""
        z = np.concatenate([[0.0], np.eye(len(self.L))[self.lower], [np.log(self.eta)]])
        z[0] = -self.at(z)[0][: -len(self.L)].min()
        self.best = z.copy() if not self.best.size else self.best
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
        T, rate = self.unpack(z)
        value, slope = self._constraints(T, rate, z[0])
        # what counts is the least horizon with the constraints kept, at whatever ln lam the windows then need
        need = z[0] - value[: -len(T)].min()
        room = value[-len(T) :].min() + z[0] - need
        if room >= -1e-6 and need / rate < self.value:
            self.best, self.value = z.copy(), need / rate
        self.known = (z.tobytes(), value, slope)
        return value, slope

    def jacobian(self, z: Array) -> Array:
        """Gradients of the constraints; the one in ln eta is a difference quotient, and only here."""
        value, slope = self.at(z)
        if self.bounds[1] > self.bounds[0]:
            T, rate = self.unpack(z)
            step = DIFFERENCE if rate * (1 + DIFFERENCE) <= self.bounds[1] else -DIFFERENCE
            slope[:, -1] = (self._constraints(T, rate * (1 + step), z[0])[0] - value) / np.log1p(step)
        return slope

    def _constraints(self, T: Array, rate: float, log_lam: float) -> tuple[Array, Array]:
        windows = self._windows(rate)
        L = self.L @ T
        logs, gradients = windows.log_lambda(L)
        values, vectors = np.linalg.eigh(L @ L.T)
        values = np.maximum(values, 1e-300)
        sized = np.einsum("ik,jk->kij", vectors / np.sqrt(values), vectors / np.sqrt(values))
        room = np.log(self.search.budget * windows.least_floor()) - log_lam + np.log(values)
        slopes = np.concatenate([-gradients, sized])
        in_T = 2 * self.L.T @ slopes @ L
        slope = np.zeros((len(slopes), 2 + self.lower[0].size))
        slope[:, 1:-1] = in_T[:, self.lower[0], self.lower[1]]
        slope[:, 0] = np.append(np.ones(logs.size), -np.ones(values.size))
        return np.append(log_lam - logs, room), slope

    def _windows(self, rate: float) -> WindowSet:
        if rate not in self.sets:
            if len(self.sets) > 1:
                self.sets.pop(next(iter(self.sets)))
            self.sets[rate] = self.search.windows(rate)
        return self.sets[rate]


def rate_range(plant: Plant, schedule: AnySchedule) -> tuple[float, float]:
    """Return the rates that are searched: [0.05, 3]/(mean gap), below what an unseen stable mode allows.

    Raises
    ------
    CertificateError
        If no rate has a certificate: the lap misses a mode that does not decay.
    """
    mean = float(np.mean(schedule.gaps)) if schedule.gaps.size else float(schedule.times[0])
    low, high = (factor / max(mean, 1e-300) for factor in ETA_RANGE)
    for _ in range(plant.n_states + 1):
        found = certificate_exists(plant, schedule, high)
        if found.exists:
            return min(low, high / 8), high
        assert found.eigenvalue is not None
        if found.eigenvalue.real >= 0:
            break
        high = -2 * BELOW_UNSEEN * found.eigenvalue.real
    require_certificate(plant, schedule, high)
    return min(low, high / 8), high


def choose_weights(
    plant: Plant,
    schedule: AnySchedule,
    weights: tuple[Array, Array, Array],
    eta: float | None,
    budget: float,
    progress: Progress | None = None,
) -> Choice:
    """Return P2, and eta where it is None, for the least horizon ln(lam)/eta under the noise budget.

    Notes
    -----
    *Method.* A scan over eta with P2 the average long-run information, then sequential quadratic programming on
    the exact lambda of a set of windows, with gradients. The result is a local optimum, never evidence.
    """
    search = Search(plant, schedule, weights, budget)
    report = progress or (lambda fraction, message: None)
    bounds = rate_range(plant, schedule) if eta is None else (eta, eta)
    rates = np.geomspace(*bounds, SCAN) if eta is None else np.array([eta])
    guesses = []
    for k, rate in enumerate(rates):
        report(0.3 * k / rates.size, f"rate {rate:.3g}")
        try:
            L, log_lam = search.first_guess(search.windows(float(rate)))
        except (SolverError, np.linalg.LinAlgError):
            continue
        guesses.append((log_lam / rate, float(rate), L))
    if not guesses:
        raise SolverError("no rate gave a first guess of the weights: the schedule is on the edge.", status="edge")
    guesses.sort(key=lambda guess: guess[0])
    found = []
    for k, (_, rate, L) in enumerate(guesses[:STARTS]):
        report(0.3 + 0.13 * k, f"descent at rate {rate:.3g}")
        found.append(search.descend(L, rate, (rate, rate)))
    best = min(found, key=lambda result: result.value)
    if eta is None:
        report(0.7, "descent on shape and rate")
        best = min(best, search.descend(best.L, best.eta, bounds), key=lambda result: result.value)
    L = best.L
    report(0.9, "proof")
    scaled = L / plant.states.scales[:, None]
    return Choice(scaled @ scaled.T, best.eta, sum(result.iterations for result in found), best.status)


def choose_rate(
    plant: Plant,
    schedule: AnySchedule,
    P2: Array,
    weights: tuple[Array, Array, Array],
    progress: Progress | None = None,
) -> float:
    """Return the eta with the least ln(lam)/eta for a given P2: a scan, then golden section around its best."""
    report = progress or (lambda fraction, message: None)
    scales = plant.states.scales
    root = np.asarray(np.linalg.cholesky(P2 * np.outer(scales, scales)), dtype=np.float64)
    search = Search(plant, schedule, weights, np.inf)

    def horizon(log_rate: float) -> float:
        rate = float(np.exp(log_rate))
        report(0.5, f"rate {rate:.3g}")
        try:
            return max(float(search.windows(rate).log_lambda(root)[0].max()), 0.0) / rate
        except (SolverError, np.linalg.LinAlgError):
            return np.inf

    grid = np.log(np.geomspace(*rate_range(plant, schedule), SCAN))
    k = int(np.argmin([horizon(rate) for rate in grid]))
    found = minimize_scalar(horizon, bounds=(grid[max(k - 1, 0)], grid[min(k + 1, SCAN - 1)]), options={"xatol": 1e-3})
    return float(np.exp(found.x))
