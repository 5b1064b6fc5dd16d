"""Slow and plain: plants of a box one by one, windows one by one, no derivative and no norm."""

import numpy as np
from scipy.linalg import expm


def drawn_values(plant, rng):
    """Parameters at random, some of them at an end of their range."""
    low = np.array([p.low for p in plant.parameters])
    high = np.array([p.high for p in plant.parameters])
    theta = rng.uniform(low, high)
    ends = np.where(rng.random(low.size) < 0.5, low, high)
    return np.where(rng.random(low.size) < 0.5, ends, theta)


def matrices(plant, theta):
    """A and C of one plant, from the parameters themselves."""
    A, C = plant.nominal.A.copy(), plant.nominal.C.copy()
    for p, value in zip(plant.parameters, theta, strict=True):
        A = A + (0 if p.A is None else (value - p.nominal) * p.A)
        C = C + (0 if p.C is None else (value - p.nominal) * p.C)
    return A, C


def least_sigma(plant, schedule, window, rng, plants=20, positions=8):
    """The least sigma met over some plants and some window starts, those just after a sample among them."""
    low, n = np.inf, plant.n_states
    for _ in range(plants):
        A, C = matrices(plant, drawn_values(plant, rng))
        starts = np.append(rng.uniform(0, schedule.period, positions), schedule.times * (1 + 1e-9))
        for s in starts:
            times = schedule.between(s, s + window).times
            rows = np.vstack([C @ expm(A * (t - s)) for t in times]) if len(times) else np.zeros((0, n))
            low = min(low, np.linalg.svd(rows, compute_uv=False)[n - 1] if len(rows) >= n else 0.0)
    return low


def random_box(rng, largest=3):
    """A plant in random units with one or two parameters that move A and C: generic, integrators, or stable."""
    from sampling_design import Plant
    from sampling_design.uncertain.plants.plant_files import UncertainParameter
    from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

    n, p, kind = int(rng.integers(1, largest + 1)), int(rng.integers(1, 3)), int(rng.integers(3))
    A = np.diag(np.ones(n - 1), 1) if kind == 1 else rng.normal(size=(n, n)) - (2.0 * np.eye(n) if kind == 2 else 0)
    D = 10.0 ** rng.integers(-9, 10, n) if rng.random() < 0.5 else np.ones(n)
    parameters = []
    for k in range(int(rng.integers(1, 3))):
        E = np.zeros((n, n))
        E[rng.integers(n), rng.integers(n)] = rng.normal() + 0.1
        moved = 0.1 * rng.normal(size=(p, n)) * D if k == 0 else None
        parameters.append(UncertainParameter(f"p{k}", -0.08, 0.05, A=E * D / D[:, None], C=moved, nominal=0.0))
    return UncertainPlant(Plant(A * D / D[:, None], rng.normal(size=(p, n)) * D), parameters)
