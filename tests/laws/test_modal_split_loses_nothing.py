"""The two parts together are the plant: bases are inverse to each other, A and the flow are recovered."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from sampling_design.plants import library
from sampling_design.plants.modes import split_modes
from tests import strategies


def check(plant, decay_rate):
    split = split_modes(plant, decay_rate)
    V = np.hstack([split.basis_retained, split.basis_residual])
    L = np.vstack([split.left_retained, split.left_residual])
    n, r = plant.n_states, split.retained.n_states
    size = np.abs(L) @ np.abs(V)  # entrywise, so that units cannot hide an error
    tolerance = 200 * n * np.finfo(float).eps * split.condition
    assert np.all(np.abs(L @ V - np.eye(n)) <= tolerance * np.maximum(size, 1.0))
    blocks = np.zeros((n, n))
    blocks[:r, :r], blocks[r:, r:] = split.retained.A, split.residual.A
    error = L @ plant.A @ V - blocks
    assert np.all(np.abs(error) <= tolerance * np.maximum(np.abs(L) @ np.abs(plant.A) @ np.abs(V), 1e-300))
    assert np.all(np.linalg.eigvals(split.residual.A).real < -decay_rate / 2) or n == r
    for part, left in ((split.retained, split.left_retained), (split.residual, split.left_residual)):
        np.testing.assert_allclose(part.B, left @ plant.B, rtol=1e-12, atol=1e-300)
        np.testing.assert_allclose(part.G, left @ plant.G, rtol=1e-12, atol=1e-300)
    assert np.array_equal(split.retained.D + split.residual.D, plant.D)
    return split


@settings(max_examples=25)
@given(strategies.plants(), st.sampled_from([0.0, 0.5, 2.0, 10.0]))
def test_on_drawn_plants(plant, decay_rate):
    assert check(plant, decay_rate).condition >= 1 - 1e-12


@pytest.mark.parametrize("name", list(library.PLANTS))
@pytest.mark.parametrize("decay_rate", [0.0, 0.01, 0.07, 0.5, 5.0])
def test_on_the_library(name, decay_rate):
    split = check(library.named_plant(name), decay_rate)
    assert all(c.value.real >= -decay_rate / 2 - split.offset for c in split.retained_clusters)


def test_outputs_of_the_parts_add_up():
    plant = library.helicopter_he1()
    split = split_modes(plant)
    x0 = np.array([1.0, -2.0, 0.5, 3.0])
    for t in (0.0, 0.7, 4.0):
        y = plant.C @ expm(plant.A * t) @ x0
        parts = [
            part.C @ expm(part.A * t) @ left @ x0
            for part, left in ((split.retained, split.left_retained), (split.residual, split.left_residual))
        ]
        np.testing.assert_allclose(sum(parts), y, rtol=1e-11)
