"""Law: no disturbance breaks Assumption 7, and the worst one reaches it: ratio one within 1e-3, never above."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import PeriodicSchedule, Plant, Schedule, certify
from sampling_design.errors import ArgumentError
from tests.oracles import riccati as oracle

PLANTS = [
    Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]),
    Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]]),
    Plant([[-0.5, -1.1], [1.5, 0.6]], [[0.5, -0.4], [0.0, 1.0]]),
]


def cost(plant, made, samples, chi, w, v, start, edges, t):
    """Right side of Assumption 7 and the final state, for w constant on pieces (both differences of trajectories)."""
    eta = made.eta
    total, x, n = np.exp(-eta * (t - start)) * chi @ made.P2 @ chi, chi, plant.n_states
    for k, (a, b) in enumerate(pairwise(edges)):
        total += (np.exp(-eta * (t - b)) - np.exp(-eta * (t - a))) / eta * w[k] @ made.Qw @ w[k]
        step = expm(np.block([[plant.A, plant.G], [np.zeros((len(w[k]), n + len(w[k])))]]) * (b - a))
        x = step[:n, :n] @ x + step[:n, n:] @ w[k]
        hit = np.flatnonzero(np.abs(samples - b) < 1e-9)
        if hit.size and b < t - 1e-9:
            y = plant.C @ x + v[hit[0]]
            total += np.exp(-eta * (t - b)) * (y @ made.R @ y + v[hit[0]] @ made.Qv @ v[hit[0]])
    return total, x


@pytest.mark.parametrize("k", range(3))
def test_random_disturbances_never_exceed_the_bound(k):
    plant = PLANTS[k]
    made = certify(plant, PeriodicSchedule([0.8, 1.3]), eta=0.4, P2=0.5 * np.eye(2))
    rng = np.random.default_rng(k)
    least = np.inf
    for _ in range(60):
        start, length = rng.uniform(0, 2.1), rng.uniform(0.3, 5)
        t = start + length
        samples = made.schedule.between(start, t, closed="right").times
        edges = np.unique(np.concatenate([[start, t], samples, rng.uniform(start, t, 4)]))
        w = rng.normal(size=(edges.size - 1, plant.n_disturbances)) * rng.uniform(0, 1)
        v = rng.normal(size=(samples.size, plant.n_outputs)) * rng.uniform(0, 1)
        total, x = cost(plant, made, samples, rng.normal(size=2), w, v, start, edges, t)
        least = min(least, total / (x @ made.P1 @ x))
    assert least > 1


@pytest.mark.parametrize("k", range(3))
def test_the_worst_trajectory_reaches_the_bound(k):
    plant = PLANTS[k]
    made = certify(plant, PeriodicSchedule([0.8, 1.3]), eta=0.4, P2=0.5 * np.eye(2))
    seen = made.witness
    C, times = [], made.schedule.between(seen.start, seen.t, closed="neither").times - seen.start
    C = [plant.C] * times.size
    args = (plant.A, C, times, plant.G, made.P2, made.Qw, made.R, made.Qv, made.eta, seen.t - seen.start)
    Pi = oracle.brute_force_information(*args, 40)
    ratio = oracle.worst_trajectory_ratio(made.P1, Pi)
    assert 1 - 2.2e-3 < ratio <= 1.0
    exact = oracle.worst_trajectory_ratio(made.P2 / made.lam, Pi)
    assert exact == pytest.approx(1.0, abs=1e-3)
    x = np.array(seen.direction)
    assert x @ made.P2 @ x / made.lam / (x @ Pi @ x) == pytest.approx(1.0, abs=1e-3)


def test_a_finite_schedule_promises_nothing_after_its_last_sample():
    """In resonance the error grows beyond what the bound would be; its files say so, decided in floats and in balls."""
    made = certify(PLANTS[0], Schedule([0.5, 1.3, 2.0, 2.6]), eta=0.1, P2=np.eye(2))
    assert made.error_bound([0.0, 2.6], 1.0, 0.1, 0.1).shape == (2,)
    with pytest.raises(ArgumentError, match=r"`t` must not lie after 2\.6, the last sample: .* ends there, got 100\.0"):
        made.error_bound([1.0, 100.0], 1.0, 0.1, 0.1)
    for rigorous in (False, True):
        assert "every later t up to 2.6, the last sample" in made.verify(rigorous=rigorous).reason
