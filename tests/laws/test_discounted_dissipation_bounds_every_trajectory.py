"""Law: with P, eta, c_w, c_y no trajectory exceeds the discounted bound of Definition 1, and some come close to it."""

import numpy as np
import pytest
import scipy.linalg as sla

from sampling_design import Plant
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from tests.cases import few
from tests.oracles.proof_constants import trajectories


def worst_ratio(found, t, cells=400):
    """sup of |x(t)|_P^2 over the right side of Definition 1, w constant on each cell, integrals by Simpson's rule."""
    plant, n, q = found.plant, found.plant.n_states, found.plant.n_disturbances
    maps, h = trajectories(plant.A, plant.C, plant.G, t, cells)
    grid = h * np.arange(cells + 1)
    simpson = (
        h / 3 * np.where((grid == 0) | (np.arange(cells + 1) == cells), 1.0, np.where(np.arange(cells + 1) % 2, 4, 2))
    )
    weight = np.exp(-found.eta * (t - grid))
    right = np.zeros((maps.shape[2],) * 2)
    right[:n, :n] = np.exp(-found.eta * t) * found.P
    for k in range(cells + 1):
        y = plant.C @ maps[k]
        right += found.c_y * simpson[k] * weight[k] * y.T @ y
    cell = found.c_w * weight[1:] * (1 - np.exp(-found.eta * h)) / found.eta
    right[n:, n:] += np.diag(np.repeat(cell, q))
    left = maps[-1].T @ found.P @ maps[-1]
    return sla.eigh(left, right, eigvals_only=True, subset_by_index=[len(left) - 1] * 2)[0]


@pytest.mark.parametrize("seed", few(range(6), 0))
def test_no_trajectory_exceeds_the_bound(seed):
    rng = np.random.default_rng(seed)
    n = 1 + seed % 3
    plant = Plant(rng.normal(size=(n, n)), rng.normal(size=(1, n)), G=rng.normal(size=(n, 1)))
    for found in (certify_detectability(plant, eta=0.3), detectability_from_proof(plant)):
        assert worst_ratio(found, 1.0) <= 1 + 1e-4


def test_riccati_certificate_is_tight():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    found = certify_detectability(plant, eta=0.5, margin=1e-6, floor=0.0)
    assert 0.99 < worst_ratio(found, 2.0, cells=300) <= 1 + 1e-4
