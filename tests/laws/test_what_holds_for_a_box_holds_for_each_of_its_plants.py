"""A bound over a box of plants holds for every plant that is drawn from it, at every window that is drawn.

`python -m tests.laws.test_what_holds_for_a_box_holds_for_each_of_its_plants 200` draws 200 boxes.
"""

import sys

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, certificate_exists, window_sigma
from sampling_design.errors import UndecidedError
from tests.cases import few
from tests.oracles.boxes import drawn_values, least_sigma, matrices, random_box


def check(seed: int) -> str:
    rng = np.random.default_rng(seed)
    plant = random_box(rng)
    schedule = PeriodicSchedule(rng.uniform(0.3, 1.0, int(rng.integers(1, 4))))
    window = float(rng.uniform(1.0, 2.0) * plant.n_states)
    found = window_sigma(plant, schedule, window, rtol=0.05, budget=2.0)
    met = least_sigma(plant, schedule, window, rng)
    assert found.lower <= met * (1 + 1e-9), (seed, found.lower, met)
    worst = window_sigma(plant.at(found.worst), schedule, window)
    assert worst.lower <= found.upper * (1 + 1e-6), seed
    try:
        exists = certificate_exists(plant, schedule, 0.1)
    except UndecidedError:
        return found.status
    if exists.exists:
        for _ in range(5):
            assert certificate_exists(plant.at(drawn_values(plant, rng)), schedule, 0.1).exists, seed
    else:
        assert not certificate_exists(plant.at(exists.worst), schedule, 0.1).exists, seed
    return found.status


@pytest.mark.parametrize("seed", few([2, 4], 0))
def test_what_holds_for_a_box_holds_for_each_of_its_plants(seed):
    assert check(seed) in {"closed", "unobservable", "budget", "too few samples"}


def test_the_oracle_makes_the_plant_that_the_box_says():
    rng = np.random.default_rng(3)
    plant = random_box(rng)
    theta = drawn_values(plant, rng)
    A, C = matrices(plant, theta)
    np.testing.assert_allclose(plant.at(theta).A, A, rtol=1e-12)
    np.testing.assert_allclose(plant.at(theta).C, C, rtol=1e-12)


if __name__ == "__main__":
    said = [check(seed) for seed in range(int(sys.argv[1]))]
    print({word: said.count(word) for word in sorted(set(said))})
