"""One estimation window: this toolbox against cvxpy, do-mpc and python-control."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import block_diag

import sampling_design as sd

from .rivals import ETA, DoMpc, Problem, Rebuilt, optimal_estimation
from .table import Table, duration, named, seconds_of

TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
BOUNDS = {"w_bound": 0.1, "v_bound": 0.3, "initial_error": 2.0}


def problem(n: int, count: int, irregular: bool, box: float | None, seed: int = 0) -> Problem:
    """Return a window of `count` samples of n/2 lightly damped oscillators whose sum is measured."""
    rng = np.random.default_rng(seed)
    A = block_diag(*(rate * TURN - 0.02 * np.eye(2) for rate in 1.0 + np.arange(n // 2)))
    plant = sd.Plant(A, [[1.0, 0.0] * (n // 2)])
    gaps = rng.uniform(0.4, 1.4, count) if irregular else np.full(count, 0.9)
    times, start = np.cumsum(gaps), np.tile([0.9, 0.4], n // 2)
    truth = plant.transition(times) @ start
    y = truth @ plant.C.T + rng.uniform(-0.3, 0.3, (count, 1))
    return Problem(plant, np.eye(n), 100.0 * np.eye(n), 10.0 * np.eye(1), np.zeros(n), times, y, truth, box)


def constrained(n: int, count: int, irregular: bool = True) -> Problem:
    """Return the first window, by seed, in which the box on the states is active at the minimum."""
    for seed in range(100):
        task = problem(n, count, irregular, 1.0, seed)
        if ours(task)[1].engine == "active set":
            return task
    raise RuntimeError(f"no window of {count} samples with an active box")


def ours(task: Problem, **options: Any) -> tuple[Callable[[], sd.estimators.Estimate], sd.estimators.Estimate]:
    """Return a call that takes in the last sample of the window, and its estimate."""
    box = {} if task.box is None else {"constraints": sd.Constraints(x=(-task.box, task.box))}
    weights = {"P2": task.P2, "Qw": task.Qw, "R": 2 * task.Rt, "Qv": 2 * task.Rt, "eta": ETA}
    mhe = sd.MovingHorizonEstimator(
        task.plant, horizon=2 * task.times[-1], cost=sd.CostFunction(**weights), **box, **BOUNDS, **options
    )
    state = mhe.initial_state(task.prior)
    for t, y in zip(task.times[:-1], task.y[:-1], strict=True):
        state, _ = mhe.step(state, sd.estimators.Sample(t, y))
    last = sd.estimators.Sample(task.times[-1], task.y[-1])

    def work() -> sd.estimators.Estimate:
        return mhe.step(state, last)[1]

    return work, work()


def run(quick: bool = False) -> list[Table]:
    """Return the tables of this task."""
    table = Table(
        "One estimation window",
        "The time from a new sample to the estimate, matrices included, when all gaps differ (and, for do-mpc, regular "
        "gaps, the only ones it knows). Weights are the same; the discount is off, since no peer has one.",
        (
            "case",
            "method",
            "first call",
            "time per estimate",
            "times ours",
            "from the exact minimiser",
            "error",
            "bound delivered",
        ),
    )
    sizes = [(2, 5)] if quick else [(2, 5), (4, 10), (4, 20), (6, 30)]
    for n, count in sizes:
        one_case(table, problem(n, count, True, None), f"n = {n}, {count} samples, free", quick)
        one_case(table, constrained(n, count), f"n = {n}, {count} samples, box", quick)
    regular(table, quick)
    table.notes.append(
        f"The toolbox runs with eta = {ETA:g}, which changes the minimiser by less than the solvers' tolerance. "
        "python-control integrates the output error over time (trapezoid rule) instead of counting samples, and is a "
        "general optimiser: its minimiser is another one by construction. do-mpc keeps w constant in a step and takes "
        "its own last window's second state as prior: its minimiser is another one, too."
    )
    return [table]


def one_case(table: Table, task: Problem, case: str, quick: bool) -> None:
    """Add the rows of irregular samples."""
    before = time.process_time()
    work, estimate = ours(task)
    mine = seconds_of(work, budget=0.3)
    exact, truth = estimate.x, task.truth[-1]
    engine = f"sampling_design ({estimate.engine})"
    table.add(
        case,
        engine,
        duration(time.process_time() - before),
        duration(mine),
        "1",
        "0",
        error(exact, truth),
        bound(estimate),
    )
    for parametric in (False, True):
        label = f"{named('cvxpy')}, Clarabel, {'DPP' if parametric else 'rebuilt'}"
        before = time.process_time()
        rival = Rebuilt(task, parametric)
        x = rival.solve(task)
        first = time.process_time() - before
        spent = seconds_of(lambda r=rival: r.solve(task), budget=0.5)
        table.add(
            case,
            label,
            duration(first),
            duration(spent),
            f"{spent / mine:.0f}",
            f"{np.abs(x - exact).max():.0e}",
            error(x, truth),
            "none",
        )
    if task.box is None and task.times.size <= (5 if quick else 10):
        before = time.process_time()
        x = optimal_estimation(task)
        spent = time.process_time() - before
        table.add(
            case,
            named("control") + " OptimalEstimationProblem",
            duration(spent),
            duration(spent),
            f"{spent / mine:.0f}",
            f"{np.abs(x - exact).max():.0e}",
            error(x, truth),
            "none",
        )


def regular(table: Table, quick: bool) -> None:
    """Add the rows of regular samples, with do-mpc."""
    rival = None
    sizes = [(2, 5)] if quick else [(2, 5), (2, 10), (2, 20), (4, 20)]
    tasks = [(f"n = {n}, {count} regular samples, free", problem(n, count, False, None)) for n, count in sizes]
    if not quick:
        tasks.append(("n = 4, 20 regular samples, box active", constrained(4, 20, irregular=False)))
    for case, task in tasks:
        work, estimate = ours(task)
        mine = seconds_of(work, budget=0.3)
        off, label = error(estimate.x, task.truth[-1]), f"sampling_design ({estimate.engine})"
        table.add(case, label, None, duration(mine), "1", "0", off, bound(estimate))
        if table.missing(case, "do-mpc", "do_mpc"):
            continue
        before = time.process_time()
        rival = DoMpc(task, 0.9)
        x = [rival.step(y) for y in task.y][-1]
        first = time.process_time() - before
        spent = seconds_of(lambda r=rival, y=task.y[-1]: r.step(y), budget=0.3)
        table.add(
            case,
            named("do-mpc") + " MHE",
            duration(first),
            duration(spent),
            f"{spent / mine:.0f}",
            f"{np.abs(x - estimate.x).max():.0e}",
            error(x, task.truth[-1]),
            "none",
        )
    if rival is not None:
        lost = rival.step([np.nan])
        status = rival.mhe.solver_stats.get("return_status")
        table.notes.append(
            f"do-mpc given NaN for a missing sample: solver status {status}, nothing raised; "
            f"what it hands back is {'finite' if np.isfinite(lost).all() else 'not finite'}."
        )


def error(x: np.ndarray, truth: np.ndarray) -> str:
    """Return the distance from the truth."""
    return f"{np.linalg.norm(x - truth):.3f}"


def bound(estimate: sd.estimators.Estimate) -> str:
    """Return the certified radii in words."""
    return f"certain within {max(estimate.radii):.2f}" if estimate.certified else "none"
