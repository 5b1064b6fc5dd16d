"""Law: the proven sigma of a design lies below a dense scan over window positions, and near it."""

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.plants import library
from tests.oracles.design import window_sigma_scan


def assert_agrees(design, A, C):
    requirement = design.requirement
    mask = design.schedule.outputs
    scan = window_sigma_scan(A, C, design.schedule.times, requirement.period, requirement.window, 5, mask)
    assert design.sigma <= scan * (1 + 1e-7)
    assert design.sigma >= scan * (1 - 5e-3)
    assert scan <= design.upper_bound * (1 + 1e-7)


@pytest.mark.long
@pytest.mark.parametrize("period", [4.0, 3.0])
def test_pair_of_oscillators(period):
    A = np.zeros((4, 4))
    A[0, 1], A[1, 0], A[2, 3], A[3, 2] = 1.0, -1.0, 2.0, -2.0
    C = np.array([[1.0, 0.0, 1.0, 0.0]])
    requirement = Requirement(window=4.0, period=period, spacing=0.3, samples=6)
    assert_agrees(design_schedule(Plant(A, C), requirement, starts=3, branches=1), A, C)


@pytest.mark.long
def test_satellite():
    plant = library.satellite()
    requirement = Requirement(window=5554.0, spacing=60.0, samples=6)
    own = plant.scaled()  # where a plant has scales its sigma is judged in them
    assert_agrees(design_schedule(plant, requirement, starts=2, branches=0), own.A, own.C)


@pytest.mark.long
def test_outputs_that_are_available_at_different_times():
    A = np.array([[0.0, 1.0], [-1.0, 0.0]])
    plant = Plant(A, np.eye(2), outputs=["position", "speed"])
    rules = {"position": {"available": [[0.0, 2.0]]}, "speed": {"available": [[1.0, 4.0]]}}
    design = design_schedule(
        plant, Requirement(window=4.0, spacing=0.4, samples=4, sensors=rules), starts=2, branches=2
    )
    mask = design.schedule.outputs
    times = design.schedule.times
    assert np.array_equal(mask[:, 0], times < 2.0)
    assert np.array_equal(mask[:, 1], times >= 1.0)
    assert_agrees(design, A, np.eye(2))
