"""One estimation window as the peers' own documentation says it, and as a Kalman filter."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, expm, solve_triangular

import sampling_design as sd

ETA = 1e-6  # the peers know no discount; this one is the toolbox's least


@dataclass(frozen=True)
class Problem:
    """A plant, weights, a prior at time 0 and samples of one output, with a box on the states (or none)."""

    plant: sd.Plant
    P2: np.ndarray
    Qw: np.ndarray
    Rt: np.ndarray
    prior: np.ndarray
    times: np.ndarray
    y: np.ndarray
    truth: np.ndarray
    box: float | None = None


def steps(problem: Problem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return e^{A h} and the covariance of the disturbance for each gap, by Van Loan's block exponential."""
    A, n, found = problem.plant.A, problem.plant.n_states, []
    N = problem.plant.G @ np.linalg.solve(problem.Qw, problem.plant.G.T)
    for h in np.diff(problem.times, prepend=0.0):
        E = expm(np.block([[-A, N], [np.zeros((n, n)), A.T]]) * h)
        found.append((E[n:, n:].T, E[n:, n:].T @ E[:n, n:]))
    return found


def roots(problem: Problem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return L^-1 and L^-1 e^{A h} of each gap, L L' the covariance."""
    pairs = []
    for F, W in steps(problem):
        L = cholesky(W, lower=True)
        pairs.append((solve_triangular(L, np.eye(len(L)), lower=True), solve_triangular(L, F, lower=True)))
    return pairs


class Rebuilt:
    """The window in cvxpy with Clarabel; `parametric` keeps the problem and sets its parameters (DPP)."""

    def __init__(self, problem: Problem, parametric: bool):
        import cvxpy as cp

        self.cp, self.parametric = cp, parametric
        n, N, p = problem.plant.n_states, problem.times.size, problem.plant.n_outputs
        if parametric:
            self.parts = [(cp.Parameter((n, n)), cp.Parameter((n, n))) for _ in range(N)]
            self.y, self.prior = cp.Parameter((N, p)), cp.Parameter(n)
            self.x, self.program = self._program(problem, self.parts, self.y, self.prior)

    def _program(self, problem: Problem, parts: Any, y: Any, prior: Any) -> Any:
        cp, plant = self.cp, problem.plant
        x = cp.Variable((problem.times.size + 1, plant.n_states))
        rootP, rootR = np.linalg.cholesky(problem.P2).T, np.linalg.cholesky(problem.Rt).T
        terms = [cp.sum_squares(rootP @ (x[0] - prior))]
        for k, (left, right) in enumerate(parts):
            terms.append(cp.sum_squares(left @ x[k + 1] - right @ x[k]))
            terms.append(cp.sum_squares(rootR @ (y[k] - plant.C @ x[k + 1])))
        limits = [] if problem.box is None else [cp.abs(x) <= problem.box]
        return x, cp.Problem(cp.Minimize(sum(terms)), limits)

    def solve(self, problem: Problem) -> np.ndarray:
        """Return the estimate at the last sample."""
        if self.parametric:
            for (left, right), (a, b) in zip(self.parts, roots(problem), strict=True):
                left.value, right.value = a, b
            self.y.value, self.prior.value = problem.y, problem.prior
            x, program = self.x, self.program
        else:
            x, program = self._program(problem, roots(problem), problem.y, problem.prior)
        program.solve(solver=self.cp.CLARABEL)
        return np.array(x.value[-1])


def optimal_estimation(problem: Problem) -> np.ndarray:
    """python-control: OptimalEstimationProblem in continuous time on the sample times, as its manual shows it."""
    import control
    import control.optimal as opt

    plant = problem.plant
    system = control.ss(plant.A, plant.G, plant.C, 0)
    likelihood = opt.gaussian_likelihood_cost(system, np.linalg.inv(problem.Qw), np.linalg.inv(problem.Rt))
    start = plant.transition(problem.times[0]) @ problem.prior

    def initial(xhat: np.ndarray, x: np.ndarray) -> float:
        return float((xhat - x) @ problem.P2 @ (xhat - x))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        task = opt.OptimalEstimationProblem(
            system, problem.times, likelihood, terminal_cost=initial, control_indices=[]
        )
        found = task.compute_estimate(problem.y.T, np.zeros((0, problem.times.size)), start, print_summary=False)
    return np.array(found.states[:, -1])


class DoMpc:
    """do-mpc's MHE: one fixed time step, orthogonal collocation, IPOPT silenced as its manual shows."""

    def __init__(self, problem: Problem, gap: float):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import do_mpc

            plant, model = problem.plant, do_mpc.model.Model("continuous")
            x = model.set_variable("_x", "x", (plant.n_states, 1))
            model.set_meas("y", plant.C @ x, meas_noise=True)
            model.set_rhs("x", plant.A @ x, process_noise=True)
            model.setup()
            mhe = do_mpc.estimator.MHE(model, [])
            mhe.settings.n_horizon = problem.times.size
            mhe.settings.t_step = gap
            mhe.settings.meas_from_data = True
            mhe.settings.supress_ipopt_output()
            full = np.linalg.inv(problem.plant.G @ np.linalg.inv(problem.Qw) @ problem.plant.G.T)
            mhe.set_default_objective(P_x=problem.P2, P_v=problem.Rt, P_w=full * gap)
            if problem.box is not None:
                mhe.bounds["lower", "_x", "x"] = -problem.box
                mhe.bounds["upper", "_x", "x"] = problem.box
            mhe.setup()
            mhe.x0 = problem.prior
            mhe.set_initial_guess()
        self.mhe = mhe

    def step(self, y: np.ndarray) -> np.ndarray:
        """Return the estimate after one more measurement."""
        return np.array(self.mhe.make_step(np.asarray(y, dtype=float).reshape(-1, 1))).ravel()
