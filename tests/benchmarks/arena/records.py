"""A whole record: moving horizon estimates against continuous-discrete Kalman filters and regular samples."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import sampling_design as sd
from tests.benchmarks.baselines import periodic_at_equal_cost

from .rivals import Problem, steps
from .sets import constrained_zonotope, zonotope_observer
from .table import Table, duration, named

W_BOUND, V_BOUND, LIMIT = 0.02, 0.4, 1.35
BOUNDS = {"w_bound": W_BOUND, "v_bound": V_BOUND, "initial_error": 1.5}


def record(
    schedule: sd.PeriodicSchedule, length: float, seed: int
) -> tuple[sd.Plant, np.ndarray, np.ndarray, np.ndarray]:
    """Return plant, times, states and measurements; the disturbance turns slowly and is exact between samples."""
    plant, rng = sd.named_plant("oscillator"), np.random.default_rng(seed)
    times = schedule.between(0.0, length).times
    slow = 0.05 * np.array([[0.0, 1.0], [-1.0, 0.0]])
    grown = sd.Plant(np.block([[plant.A, np.eye(2)], [np.zeros((2, 2)), slow]]), np.ones((1, 4)))
    states = (grown.transition(times) @ [1.0, 0.4, W_BOUND, 0.0])[:, :2]
    return plant, times, states, states @ plant.C.T + rng.uniform(-V_BOUND, V_BOUND, (times.size, 1))


def plain_filter(task: Problem) -> np.ndarray:
    """Return the estimates of a continuous-discrete Kalman filter in a dozen lines."""
    x, P, found = task.prior, np.linalg.inv(task.P2), []
    C, V = task.plant.C, np.linalg.inv(task.Rt)
    for (F, W), y in zip(steps(task), task.y, strict=True):
        x, P = F @ x, F @ P @ F.T + W
        K = np.linalg.solve(C @ P @ C.T + V, C @ P).T
        x, P = x + K @ (y - C @ x), (np.eye(len(x)) - K @ C) @ P
        found.append(x)
    return np.array(found)


def filterpy_filter(task: Problem) -> np.ndarray:
    """Return filterpy's estimates; F and Q are overwritten before each step, as its users do for varying gaps."""
    from filterpy.kalman import KalmanFilter

    rival = KalmanFilter(dim_x=task.plant.n_states, dim_z=task.plant.n_outputs)
    rival.x, rival.P = task.prior.reshape(-1, 1).copy(), np.linalg.inv(task.P2)
    rival.H, rival.R = task.plant.C, np.linalg.inv(task.Rt)
    found = []
    for (F, W), y in zip(steps(task), task.y, strict=True):
        rival.F, rival.Q = F, W
        rival.predict()
        rival.update(y)
        found.append(rival.x.ravel())
    return np.array(found)


def weights(task: Problem) -> dict[str, Any]:
    """Return the weights of the Kalman filters, as the toolbox's estimators take them."""
    return {"P2": task.P2, "Qw": task.Qw, "R": 2 * task.Rt, "Qv": 2 * task.Rt, "eta": 0.01}


def run(quick: bool = False) -> list[Table]:
    """Return the tables of this task."""
    table = Table(
        "A whole record",
        "An oscillator with bounded disturbance and coarse bounded noise. RMSE of the state at the samples "
        "after the first five; `mean radius` is that from the estimate to the far end of what is proven, "
        "`holds` the share of states within it, `over exact` its ratio to half the exact set (geometric mean).",
        ("samples", "method", "time per sample", "RMSE", "mean radius", "holds", "proven", "ellipsoid", "over exact"),
    )
    gaps, length = [0.7, 1.6, 0.9, 2.0], 15.0 if quick else 200.0
    uneven = sd.PeriodicSchedule(gaps)
    for label, schedule in (("irregular", uneven), ("regular, equal number", periodic_at_equal_cost(uneven))):
        plant, times, states, y = record(schedule, length, seed=1)
        certificate = sd.certify(plant, schedule)
        task = Problem(plant, np.eye(2), 100.0 * np.eye(2), 10.0 * np.eye(1), np.zeros(2), times, y, states)
        schemes: dict[str, Callable[[], Any]] = {
            "sampling_design MHE": lambda p=plant, c=certificate: sd.MovingHorizonEstimator(p, c, **BOUNDS),
            "sampling_design MHE, box on the states": lambda p=plant, c=certificate: sd.MovingHorizonEstimator(
                p, c, constraints=sd.Constraints(x=(-LIMIT, LIMIT)), **BOUNDS
            ),
            "sampling_design MHE, certificate for the rate 0.1": lambda p=plant, s=schedule: sd.MovingHorizonEstimator(
                p, sd.certify(p, s, eta=0.1), **BOUNDS
            ),
            "sampling_design MHE, the filters' weights, rate 0.01": lambda t=task: sd.MovingHorizonEstimator(
                t.plant, horizon=20.0, cost=sd.CostFunction(arrival="filtered", **weights(t)), **BOUNDS
            ),
            "sampling_design KalmanFilter, the filters' weights, rate 0.01": lambda t=task: sd.KalmanFilter(
                t.plant, cost=sd.CostFunction(**weights(t)), **BOUNDS
            ),
        }
        schemes["sampling_design SetMembershipEstimator"] = lambda p=plant: sd.SetMembershipEstimator(p, **BOUNDS)
        exact = np.array([e.interval().radii for e in follow(plant, sd.KalmanFilter(plant, **BOUNDS), times, y)])
        for name, build in schemes.items():
            add_own(table, label, name, build(), (plant, times, states, y), exact)
        for name in list(schemes)[:1] + list(schemes)[-2:-1]:
            add_own(table, label, f"{name}, centred", schemes[name](), (plant, times, states, y), exact, centred=True)
        for name, observe in (("zonotope observer", zonotope_observer), ("constrained zonotope", constrained_zonotope)):
            add_set(table, label, name, observe, (plant, times, y), states, exact)
        for name, work, module in (
            ("continuous-discrete Kalman filter, plain", plain_filter, "numpy"),
            (f"{named('filterpy')} KalmanFilter", filterpy_filter, "filterpy"),
        ):
            if not table.missing(label, module, module):
                work(task)  # imports are not timed
                before = time.process_time()
                spread = work(task) - states
                spent = (time.process_time() - before) / times.size
                table.add(label, name, duration(spent), rmse(spread), "none", "none", "no", "none", "none")
    table.notes.append(
        "A certificate without further wishes is chosen for the least horizon, that is for a fast rate: its estimates "
        "follow the noise more than those of a slow rate. The Kalman filters are tuned as for "
        "Gaussian noise and give covariances, which are no bounds. "
        f"The box |x_i| <= {LIMIT:g} holds for the truth."
    )
    return [table]


def follow(plant: sd.Plant, estimator: sd.estimators.Estimator, times: Any, y: Any) -> list[Any]:
    """Return the estimates at all samples, of any object with `start`, `update` and `predict`."""
    return list(sd.estimators.estimate(plant, zip(times, y, strict=True), estimator).estimates)


def over(radii: np.ndarray, exact: np.ndarray) -> str:
    """Return the geometric mean of radii over those of the exact set, the first five left out."""
    return f"{np.exp(np.mean(np.log(radii[5:] / exact[5:]))):.3f}"


def add_own(
    table: Table, label: str, name: str, estimator: Any, data: Any, exact: np.ndarray, centred: bool = False
) -> None:
    """Run an estimator over the record and add its row; radii are not timed, but those of its own making are.

    `centred`: every estimate moves into the middle of its interval.
    """
    plant, times, states, y = data
    before = time.process_time()
    found = follow(plant, estimator, times, y)
    if centred:
        found = [estimate.centred() for estimate in found]
    spent = (time.process_time() - before) / times.size
    radii = np.array([estimate.radii for estimate in found])
    spread = np.array([estimate.x for estimate in found]) - states
    holds = np.mean(np.all(np.abs(spread) <= radii * (1 + 1e-9), axis=1))
    certified = "yes" if all(estimate.certified for estimate in found[5:]) else "no"
    wide = np.mean([np.max(estimate.ellipsoid_radii) for estimate in found[5:]])
    mean = f"{np.mean(np.max(radii[5:], axis=1)):.3f}"
    row = (duration(spent), rmse(spread), mean, f"{holds:.0%}", certified, f"{wide:.3f}", over(radii, exact))
    table.add(label, name, *row)


def add_set(
    table: Table, label: str, name: str, observe: Callable[..., Any], given: Any, states: Any, exact: np.ndarray
) -> None:
    """Run a rival that hands out boxes and add its row."""
    before = time.process_time()
    x, radii = observe(*given, BOUNDS)
    spent = (time.process_time() - before) / len(x)
    holds = np.mean(np.all(np.abs(x - states) <= radii * (1 + 1e-9), axis=1))
    mean = f"{np.mean(np.max(radii[5:], axis=1)):.3f}"
    table.add(label, name, duration(spent), rmse(x - states), mean, f"{holds:.0%}", "yes", "none", over(radii, exact))


def rmse(spread: np.ndarray) -> str:
    """Return the root mean square of the distances, the first five left out."""
    return f"{np.sqrt(np.mean(np.sum(spread[5:] ** 2, axis=1))):.4f}"
