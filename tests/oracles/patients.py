"""Pairs of patients with disturbances of their own and one therapy: the distance beside what Assumption 7 allows.

Trajectories are flown one by one with the integrator for stiff plants, and every two of them are a pair.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.thyroid import NOISE_BOUND, PROCESS_BOUND, SCALING, TRUE_START
from sampling_design.nonlinear.thyroid_logs import REST, TUBE, logarithms

PARTS = 3
"""Instants in each gap at which pairs are compared."""
NEAR = 1e-4
"""Of the region's size: how far apart a trajectory and its near one begin."""


def scattered(plant, count, rng):
    """Starts in the middle part of the region, every second one near the one before."""
    low, high = plant.region.lower, plant.region.upper
    middle, half = (low + high) / 2, (high - low) / 2
    starts = middle + 0.7 * half * rng.uniform(-1.0, 1.0, (count, middle.size))
    starts[1::2] = starts[: 2 * (count // 2) : 2] + NEAR * half * rng.uniform(-1.0, 1.0, (count // 2, middle.size))
    return starts


def largest_ratio(certificate, plant, starts, gaps, rng, dose=0.0):
    """The largest V over what is allowed, over all pairs that stay in the region, and how many those are."""
    doses = dose * rng.integers(0, 2, gaps.size)
    paths, pushes = [], []
    for start in starts:
        state, path, push = start, [], []
        for gap, taken in zip(gaps, doses, strict=True):
            w = PROCESS_BOUND * rng.choice([-1.0, 1.0], 2)
            u = np.tile([taken, 0.0], (PARTS + 1, 1))
            run = simulate(plant, state, np.linspace(0.0, gap, PARTS + 1), u=u, w=np.tile(w, (PARTS + 1, 1)))
            state = run[-1]
            path.append(run)
            push.append(w)
        paths.append(np.array(path))
        pushes.append(push)
    stay = [k for k, path in enumerate(paths) if plant.region.holds(path.reshape(-1, path.shape[-1])).all()]
    shown = {k: [plant.h(run[-1]) for run in paths[k]] for k in stay}
    worst = 0.0
    for one, two in combinations(stay, 2):
        apart = paths[one] - paths[two]
        allowed = float(apart[0, 0] @ certificate.P2 @ apart[0, 0])
        for k, gap in enumerate(gaps):
            dw, dt = pushes[one][k] - pushes[two][k], gap / PARTS
            faded = np.exp(-certificate.eta * dt)
            for i in range(1, PARTS + 1):
                allowed = allowed * faded + float(dw @ certificate.Qw @ dw) * (1 - faded) / certificate.eta
                worst = max(worst, float(apart[k, i] @ certificate.at(gap * i / PARTS) @ apart[k, i]) / allowed)
            dy = shown[one][k] - shown[two][k]
            allowed += float(dy @ certificate.Rtilde @ dy)
    return worst, len(stay) * (len(stay) - 1) // 2


STEP, SHORTEST, LONGEST = 2 / 24, 6, 18
"""The paper's grid of 2 h [d], and gaps of 12 to 36 h in its steps."""


def estimated(scheme, plant, rng, days=20.0, dose=0.0):
    """One patient as the paper draws one: the error of each estimate over its radius, and in scaled states.

    `dose` is absorbed or not, day by day. The error over the radius is infinite where an estimate has none.
    """
    steps = round(days / STEP)
    times = STEP * np.arange(steps + 1)
    w = rng.uniform(-1.0, 1.0, (times.size, 2)) * PROCESS_BOUND
    v = rng.uniform(-1.0, 1.0, (times.size, 3)) * NOISE_BOUND
    u = np.zeros((times.size, 2))
    if dose:
        u[:, 0] = dose * np.repeat(rng.integers(0, 2, steps // 12 + 1), 12)[: times.size]
    sampled = np.zeros(times.size, dtype=bool)
    at = 0
    while at < times.size:
        sampled[at] = True
        at += int(rng.integers(SHORTEST, LONGEST + 1))
    truth = simulate(plant, logarithms(TRUE_START), times, u=u, w=w)
    shares, errors = [], []
    for k, t in enumerate(times.tolist()):
        y = plant.h(truth[k]) + v[k] if sampled[k] else None
        found = scheme.update(t, y, u=u[k]) if dose or sampled[k] else scheme.predict(t)
        off = truth[k] - found.x
        bound = found.radius if found.certified else 0.0
        shares.append(np.sqrt(off @ np.linalg.solve(found.covariance, off)) / bound if bound else np.inf)
        apart = [REST * np.exp(np.linalg.solve(TUBE, state)) for state in (truth[k], found.x)]
        errors.append(np.linalg.norm(SCALING * (apart[0] - apart[1])))
    return np.array(shares), np.array(errors)
