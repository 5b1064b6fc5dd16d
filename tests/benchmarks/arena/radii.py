"""How much wider than the exact set are the radii that estimators prove? `python -m tests.benchmarks.arena.radii`.

Every plant of the library on its evenly spaced example schedule, w at extreme points of its box that change at random
times, v extreme or random, the start known to within twice the scales of the states. `over exact` is the ratio of the
proven radius (from the estimate to the far end) to half the exact set, geometric mean over samples and states.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import expm

import sampling_design as sd

from ..library_accuracy import NOISE, schedule_of
from .records import follow
from .sets import constrained_zonotope, zonotope_observer
from .table import Table, duration

SAMPLES, LEFT_OUT = 24, 6
GROUPS = ("double_integrator", "triple_integrator", "oscillator", "satellite")
GROUPS += ("cart_pendulum", "three_compartment", "helicopter_he1", "tidal_gauge")


def adversarial(name: str, samples: int, seed: int = 0) -> tuple[sd.Plant, np.ndarray, np.ndarray, np.ndarray, Any]:
    """Return plant, times, states, measurements and the bounds that they keep."""
    rng = np.random.default_rng(seed)
    plant, schedule = sd.named_plant(name), schedule_of(name)
    period = schedule.period
    times = schedule.between(0.0, period * (1 + samples / len(schedule))).times[:samples]
    w, v = plant.disturbances.scales, NOISE * plant.outputs.scales
    error = 2 * plant.states.scales
    n, q = plant.G.shape
    joint = np.zeros((n + q, n + q))
    joint[:n] = np.hstack([plant.A, plant.G])
    x, now, states = rng.uniform(-1, 1, n) * error, 0.0, []
    for t in times:
        for a, b in pairwise([now, *np.sort(rng.uniform(now, t, 2)), t]):
            push = rng.choice([-1.0, 1.0], q) * w
            x = expm(joint * (b - a))[:n] @ np.concatenate([x, push])
        states.append(x)
        now = t
    truth = np.array(states)
    noise = rng.choice([-1.0, 1.0, 0.3], (len(times), plant.n_outputs)) * v
    return plant, times, truth, truth @ plant.C.T + noise, {"w_bound": w, "v_bound": v, "initial_error": error}


def schemes(plant: sd.Plant, gap: float, bounds: Any) -> dict[str, Callable[[], Any]]:
    """Estimators whose weights follow the bounds, at a rate of a tenth of that of the gaps."""
    eta = 0.1 / gap
    cost = sd.CostFunction(**sd.certificates.weights_from_bounds(plant, eta, **bounds), eta=eta)
    return {
        "moving horizon": lambda: sd.MovingHorizonEstimator(plant, horizon=20 * gap, cost=cost, **bounds),
        "Kalman filter": lambda: sd.KalmanFilter(plant, cost=cost, **bounds),
    }


def measure(name: str, samples: int = SAMPLES) -> dict[str, tuple[float, float, float]]:
    """Return per scheme: radius over exact, share of states within their radii, seconds an estimate."""
    plant, times, truth, y, bounds = adversarial(name, samples)
    found: dict[str, tuple[float, float, float]] = {}
    gap = float(np.mean(np.diff(times)))
    for label, build in schemes(plant, gap, bounds).items():
        estimator = build()
        estimates = follow(plant, estimator, times, y)[LEFT_OUT:]
        exact = np.array([estimate.interval().radii for estimate in estimates])
        for words, move in (("", False), (", centred", True)):
            before = time.process_time()
            chosen = [estimate.centred() for estimate in estimates] if move else estimates
            radii = np.array([estimate.radii for estimate in chosen])
            spent = (time.process_time() - before) / len(chosen)
            off = np.abs(np.array([estimate.x for estimate in chosen]) - truth[LEFT_OUT:])
            found[label + words] = (
                float(np.exp(np.mean(np.log(radii / exact)))),
                float(np.mean(off <= radii * (1 + 1e-9))),
                spent,
            )
    for label, rival in {"zonotope observer": zonotope_observer, "constrained zonotope": constrained_zonotope}.items():
        before = time.process_time()
        x, radii = rival(plant, times, y, bounds)
        spent = (time.process_time() - before) / len(times)
        off = np.abs(x - truth)[LEFT_OUT:]
        ratio = float(np.exp(np.mean(np.log(radii[LEFT_OUT:] / exact))))
        found[label] = ratio, float(np.mean(off <= radii[LEFT_OUT:] * (1 + 1e-9))), spent
    return found


def run(quick: bool = False) -> list[Table]:
    """Return the tables of this task."""
    question = (__doc__ or "").split("\n\n")[1].replace("\n", " ")
    table = Table("Radii over the exact set", question, ("plant", "method", "over exact", "holds", "time per estimate"))
    means: dict[str, list[float]] = {}
    for name in ("oscillator",) if quick else GROUPS:
        for method, (ratio, holds, spent) in measure(name, 10 if quick else SAMPLES).items():
            table.add(name, method, f"{ratio:.3f}", f"{holds:.0%}", duration(spent) if spent == spent else None)
            means.setdefault(method, []).append(ratio)
    for method, ratios in means.items():
        table.add("geometric mean", method, f"{np.exp(np.mean(np.log(ratios))):.3f}", None, None)
    table.notes.append(
        "An estimate that `centred` moves into the middle of its interval has the least radius that any can have, 1 by "
        "definition; where it was not moved, the ratio says how far from the middle the estimator lies. Plants too "
        "large for matrices are left out."
    )
    return [table]


if __name__ == "__main__":
    for chosen in sys.argv[1:] or GROUPS:
        for label, (over, inside, seconds) in measure(chosen).items():
            print(
                f"{chosen:18s} {label:28s} over exact {over:7.3f}  holds {inside:7.2%}  {1e3 * seconds:7.1f} ms",
                flush=True,
            )
