"""The window problem as it is written, solved and refined by a modelling library: slow, what the engines are judged by.

Nothing of the smoother's algebra is used: the data of a window, its sets, and the roots of its weights.
"""

import warnings
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np

from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.constraints.qp import ACCEPTED, SOLVER_TOLERANCE
from sampling_design.estimators.gap_flows.cost_weights import marginal_root
from sampling_design.estimators.mhe import CLOSED_FORM
from sampling_design.estimators.window.smoother import smooth
from sampling_design.numerics import conic_programs

SCALES = (1.0, 1e-3, 1e-6)  # units of the steps in which the reference is solved and then refined around its own answer


def by_the_reference(mhe):
    """Return an estimator with its windows solved as they are written wherever a constraint acts."""
    own = mhe._solve

    def solve(window):
        found = own(window)
        return found if found.engine in CLOSED_FORM else solve_reference(window, mhe.constraints, smooth(window))

    mhe._solve = solve
    return mhe


def solve(problem, tolerance):
    """Solve a problem with Clarabel and return its status, "failed" where the solver gives up."""
    settings = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas", "tol_ktratio"), tolerance)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate solution is a status here, not a warning
            problem.solve(solver=cp.CLARABEL, max_iter=200, max_threads=conic_programs.THREADS, **settings)
    except cp.error.SolverError:
        return "failed"
    return problem.status


@dataclass(frozen=True, eq=False)
class _Point:
    """A trajectory: states at the nodes, omega over the gaps, v at the samples, and its cost."""

    x: np.ndarray
    omega: list
    v: dict
    cost: float

    @classmethod
    def zero(cls, window, x):
        """These states, without disturbance and noise."""
        omega = [np.zeros(flow.root.shape[1]) for flow in window.flows]
        return cls(x, omega, {j: np.zeros(window.masks.shape[1]) for j in window.samples}, np.nan)


def solve_reference(window, constraints, free, scales=SCALES):
    """Solve the window problem as it is written, in states, omega and v, with the modelling library. Slow.

    Nothing of the smoother's algebra is used (`free` lends only its type): this is what the others are judged by.

    Notes
    -----
    *Numerical aspects.* A cost that is right to e leaves the states right to sqrt(e) only. So the problem is posed
    again around its own last answer, as a difference from it and in units of the next of `scales`: the same
    tolerances then bite that much further down, and what is curved is straight (`_inside`).
    """
    point = _Point.zero(window, window.reference)
    for scale in scales:
        status, found = _improved(window, constraints, point, scale)
        if found is not None:
            point = found
        elif np.isnan(point.cost):
            if status.startswith("infeasible"):
                note = "No trajectory meets the constraints."
                return replace(free, status="infeasible", note=note, engine="reference")
            return replace(free, status="solver failed", note=f"Status {status}.", engine="reference")
    dual = point.cost - ACCEPTED * max(1.0, abs(point.cost))
    return replace(free, nodes=point.x, cost=point.cost, dual=dual, engine="reference")


def _improved(window, constraints, point, scale):
    """Minimise over the steps (x, omega, v) = point + scale step; None if the solver brings nothing to use."""
    program, x, omega, v = _window_program(window, constraints, point, scale)
    problem = program.problem()
    status = solve(problem, SOLVER_TOLERANCE)
    if not status.startswith("optimal") or problem.value is None or any(step.value is None for step in x):
        return status, None
    return status, _Point(
        point.x + scale * np.array([step.value for step in x]),
        [at + scale * np.asarray(step.value) for at, step in zip(point.omega, omega, strict=True)],
        {j: point.v[j] + scale * np.asarray(step.value) for j, step in v.items()},
        program.constant + scale**2 * float(problem.value),
    )


def _window_program(window, constraints, point, scale):
    """The program over the steps (x, omega, v) = point + scale step."""
    weights, plant, root = window.weights, window.weights.plant, np.sqrt(window.discount)
    x = [cp.Variable(plant.n_states, name=f"x{j}") for j in range(window.times.size)]
    omega = [cp.Variable(flow.root.shape[1], name=f"omega{j + 1}") for j, flow in enumerate(window.flows)]
    v = {j: cp.Variable(plant.n_outputs, name=f"v{j}") for j in window.samples}
    program = _Program(scale, [], [], 0.0)
    program.add_square(window.prior_half @ (point.x[0] - window.reference[0]), window.prior_half @ x[0])
    for j, flow in enumerate(window.flows):
        drift = window.defect[j] + window.reference[j + 1] - flow.F @ window.reference[j]
        missing = flow.F @ point.x[j] + drift + flow.root @ point.omega[j] - point.x[j + 1]
        program.parts.append(x[j + 1] == flow.F @ x[j] + flow.root @ omega[j] + missing / scale)
        program.add_square(root[j + 1] * point.omega[j], root[j + 1] * omega[j])
        if constraints.reach is not None:
            program.keep_inside(constraints.reach.over([flow])[0], point.omega[j], omega[j])
    if constraints.x is not None:
        for at, step in zip(point.x, x, strict=True):
            program.keep_inside(constraints.x, at, step)
    if window.limits is not None:
        for bounds, at, step in zip(window.limits, point.x, x, strict=True):
            program.keep_inside(ConvexSet.box(*bounds), plant.C @ at, plant.C @ step)
    for j, step in v.items():
        seen = window.masks[j] > 0
        fit, own = marginal_root(weights.R, seen), marginal_root(weights.v, seen)
        mask, model, moved = window.masks[j], plant.C @ point.x[j] + window.feedthrough[j], plant.C @ x[j]
        residual = np.diag(mask) @ (window.y[j] - model) - point.v[j]
        program.add_square(root[j] * (fit @ residual), root[j] * (fit @ (-cp.multiply(mask, moved) - step)))
        program.add_square(root[j] * (own @ point.v[j]), root[j] * (own @ step))
        for chosen, at, total in ((constraints.v, point.v[j], step), (constraints.y, model + point.v[j], moved + step)):
            if chosen is not None:
                program.keep_inside(chosen, at, total, mask)
    if window.means is not None:
        root, means = np.linalg.cholesky(window.means.spread), window.means
        shown = means.target - np.einsum("kjn,jn->k", means.rows, point.x - window.reference)
        rows = np.linalg.solve(root, means.rows.reshape(len(shown), -1))
        program.add_square(np.linalg.solve(root, shown), -rows @ cp.hstack(x))
    return program, x, omega, v


@dataclass
class _Program:
    """Terms of the cost, over scale^2 and without the constant, and constraints on signals value + scale step."""

    scale: float
    terms: list
    parts: list
    constant: float

    def problem(self):
        """The problem, without its constant."""
        return cp.Problem(cp.Minimize(cp.sum(self.terms)), self.parts)

    def add_square(self, value, step):
        """Add |value + scale step|^2."""
        self.terms += [cp.sum_squares(step), (2 / self.scale) * (step @ value)]
        self.constant += float(value @ value)

    def keep_inside(self, chosen, value, step, mask=None):
        """Keep value + scale step in a set, measured entries only where there is a mask.

        A ball |a + scale b| <= r is asked as 2 a'b + scale |b|^2 <= (r^2 - |a|^2)/scale: no small difference of norms.
        """
        seen = np.ones(chosen.dimension, bool) if mask is None else mask > 0
        low, up = seen & np.isfinite(chosen.lower), seen & np.isfinite(chosen.upper)
        self.parts += [step[low] >= (chosen.lower[low] - value[low]) / self.scale] if low.any() else []
        self.parts += [step[up] <= (chosen.upper[up] - value[up]) / self.scale] if up.any() else []
        if not seen.all():
            return
        if chosen.rows.shape[0]:
            self.parts.append(step @ chosen.rows.T <= (chosen.offsets - chosen.rows @ value) / self.scale)
        for ball in chosen.balls:
            if ball.radius == 0:
                self.parts.append(ball.shape @ step == ball.shape @ (ball.centre - value) / self.scale)
                continue
            a, b = ball.shape @ (value - ball.centre) / ball.radius, ball.shape @ step / ball.radius
            self.parts.append(2 * a @ b + self.scale * cp.sum_squares(b) <= (1 - a @ a) / self.scale)
