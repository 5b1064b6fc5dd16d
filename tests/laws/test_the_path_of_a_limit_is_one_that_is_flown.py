"""What no schedule beats is attained by one path from rest, which shows nothing at any allowed time: flown again here.

Gap by gap with the disturbance that closes it, by matrix exponentials of its own steps.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant
from sampling_design.accuracy import accuracy_limit
from tests.cases import few

ZONES, PERIOD, STEPS = [(0.1, 0.3), (0.8, 0.8)], 1.2, 7


def drawn(seed):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    q = int(rng.integers(1, n + 1))
    plant = Plant(0.8 * rng.normal(size=(n, n)), rng.normal(size=(p, n)), G=rng.normal(size=(n, q)))
    zones = {"zones": ZONES, "period": PERIOD} if seed % 2 else {}
    return accuracy_limit(plant, w_bound=rng.uniform(0.01, 1, q), v_bound=rng.uniform(0.05, 1, p), budget=0.2, **zones)


def flown(found, k):
    """Times in the period of the zones, outputs then, the disturbance, how far gaps stay open, and the row's end."""
    path = found.witnesses[k]
    plant, w = path.plant, path.simulate(found.bounds.w).w
    n, size = plant.n_states, plant.n_states + plant.n_disturbances
    joint = np.zeros((size, size))
    joint[:n, :n], joint[:n, n:] = plant.A, plant.G
    times, seen, left, x = [], [], 0.0, np.zeros(n)
    for t, h, now in zip(path.edges, np.diff(path.edges), w, strict=False):
        at = np.flatnonzero(path.samples == t)
        if at.size:
            left = max(left, float(np.max(np.abs(x - path.states[at[0]]))))
            x = path.states[at[0]]
        step = expm(joint * h / STEPS)
        for part in range(STEPS):
            times.append(t + part * h / STEPS)
            seen.append(plant.C @ x)
            x = step[:n] @ np.concatenate([x, now])
    left /= np.max(np.abs(path.states), initial=1e-300)
    return np.array(times) - path.samples[-1] + found.phases[k], np.array(seen), w, left, float(path.row @ x)


def exceeded(found, k):
    """By which factors outputs at allowed times, and the disturbance, exceed their bounds."""
    times, seen, w, _, _ = flown(found, k)
    allowed = np.ones(len(times), dtype=bool)
    if found.zones is not None:
        place = np.mod(times + 1e-9, found.period)
        allowed = np.any([(place >= a) & (place <= b + 2e-9) for a, b in found.zones], axis=0)
    return np.max(np.abs(seen[allowed]) / found.bounds.v), np.max(np.abs(w) / found.bounds.w)


@pytest.mark.parametrize("seed", few(range(8), 1))
def test_a_limit_is_attained_by_what_nobody_sees(seed):
    found = drawn(seed)
    assert found.verify()
    for k, path in enumerate(found.witnesses):
        assert path is not None
        *_, left, end = flown(found, k)
        assert left <= 1e-9
        assert end == pytest.approx(found.lower[k], rel=1e-6)
        assert max(exceeded(found, k)) <= 1 + 1e-9


def test_a_path_that_is_seen_once_its_gaps_are_closed_is_refused():
    """Between its last two nodes x rises beyond its bound and falls again; the w that is told has it fall faster."""
    plant, v = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]]), 0.1
    found = accuracy_limit(plant, w_bound=1.0, v_bound=v, of=[[0.0, -1.0]])
    path = found.witnesses[0]
    nodes, edges = np.array([0.0, 0.5, 0.7]), np.append(np.linspace(0.0, 0.5, 9)[:-1], np.linspace(0.5, 0.7, 9))
    states, told = np.array([[0.0, 0.0], [0.95 * v, 0.25], [0.95 * v, -0.25]]), np.repeat([[0.0], [-10.0]], 8, axis=0)
    measured = np.ones((3, 1), dtype=bool)
    forged = replace(path, samples=nodes, edges=edges, states=states, w=told, outputs=measured, value=0.25)
    seen = replace(found, witnesses=(forged,), lower=np.zeros(1), bounds=replace(found.bounds, w=np.array([9.0])))
    assert exceeded(seen, 0)[0] > 1.05
    assert exceeded(seen, 0)[1] <= 1
    assert not seen.verify()
    assert replace(seen, bounds=replace(seen.bounds, v=1.5 * seen.bounds.v)).verify()
