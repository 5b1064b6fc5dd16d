"""E25: a triple zero is computed as 2.0e-6 +- 3.5e-6i and -4.0e-6; by the sign of Re one third of it looks stable."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from sampling_design import Plant
from sampling_design.plants.modes import split_modes


def hidden(blocks, seed):
    A = block_diag(*blocks)
    S = np.random.default_rng(seed).standard_normal(A.shape)
    return S @ A @ np.linalg.inv(S)


@pytest.mark.parametrize("size", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("seed", range(5))
def test_integrator_chains_stay_whole(size, seed):
    A = hidden([np.eye(size, k=1), np.diag([-1.0, -3.0])], seed)
    split = split_modes(Plant(A, np.ones((1, size + 2))))
    assert split.retained.n_states == size
    assert [c.index for c in split.retained_clusters] == [size]
    assert abs(split.retained_clusters[0].value) < 1e-9


def test_the_sign_of_the_real_part_alone_tears_the_triple_zero():
    A = hidden([np.eye(3, k=1), np.diag([-1.0, -3.0])], 0)
    values = np.linalg.eigvals(A)
    assert np.sum(values.real >= -1e-8 * np.linalg.norm(A)) != 3  # the trap is there
    assert split_modes(Plant(A, np.ones((1, 5)))).retained.n_states == 3


@pytest.mark.parametrize("seed", range(5))
def test_resonant_oscillators_stay_whole(seed):
    rotation = np.array([[0.0, 1.0], [-1.0, 0.0]])
    chain = np.kron(np.eye(3), rotation) + np.kron(np.eye(3, k=1), np.eye(2))
    split = split_modes(Plant(hidden([chain, [[-0.5]]], seed), np.ones((1, 7))))
    assert split.retained.n_states == 6
    assert sorted(c.index for c in split.retained_clusters) == [3, 3]


@pytest.mark.parametrize("scale", [2.0**-20, 1.0, 2.0**20])
def test_units_of_the_states_do_not_decide(scale):
    """Balancing first: the same plant in metres and in micrometres splits alike."""
    A = hidden([np.eye(2, k=1), [[-1.0]]], 3)
    d = np.array([1.0, scale, scale**2])
    assert split_modes(Plant(A * d / d[:, None], np.ones((1, 3)))).retained.n_states == 2
