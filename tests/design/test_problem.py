"""Defaults, allowed times, and impossible requirements: what is in the way, and what would work."""

import re

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule, split_modes
from sampling_design.design.problem import pose, resolve
from sampling_design.errors import ArgumentError, InfeasibleRequirementError, NotObservableError, SolverError

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
BASE = {"window": 4.0, "spacing": 0.5, "samples": 3}


def test_defaults_come_from_the_modes_and_are_told():
    requirement, used = resolve(split_modes(OSCILLATOR), Requirement())
    assert requirement.window == pytest.approx(2 * np.pi)
    assert requirement.period == requirement.window
    assert requirement.samples == {"exactly": 4}  # k* = 1 + T delta/(2 pi) = 3, strictly more
    assert requirement.spacing == pytest.approx(2 * np.pi / 16)
    assert set(used) == {"window", "period", "samples", "spacing"}


def test_without_oscillation_the_window_is_four_over_the_norm():
    plant = Plant([[0.0, 2.0], [0.0, 0.0]], [[1.0, 0.0]])
    assert resolve(split_modes(plant), Requirement())[0].window == pytest.approx(2.0)


def test_the_default_count_is_cut_with_a_notice():
    A = np.kron(np.diag(np.arange(1.0, 6.0)), [[0.0, 1.0], [-1.0, 0.0]])
    plant = Plant(A, np.tile([[1.0, 0.0]], 5))
    requirement, used = resolve(split_modes(plant), Requirement(window=20.0))
    assert requirement.samples == {"exactly": 24}
    assert "24 are designed" in used["notice"]


def test_times_are_converted_to_the_unit_of_the_plant():
    requirement, _ = resolve(split_modes(OSCILLATOR), Requirement(window=0.1, spacing=0.01, samples=3, time_unit="min"))
    assert requirement.window == pytest.approx(6.0)
    assert requirement.spacing == pytest.approx(0.6)
    assert requirement.time_unit == "s"


@pytest.mark.parametrize(
    ("changes", "obstacle", "words"),
    [
        ({"spacing": 1.5}, "spacing", "room for 2 samples in the period 4, 3 are asked for"),
        ({"forbidden": [[0.0, 3.2]]}, "forbidden", "`forbidden` and `fixed` times leave room for 2 samples"),
        ({"forbidden": [[0.0, 4.0]]}, "forbidden", "leave no time to sample at all"),
        ({"forbidden": [[0.0, 1.0]], "fixed": [0.5]}, "fixed", "`fixed` time 0.5 is forbidden"),
        ({"fixed": [0.0, 0.3]}, "fixed", "`fixed` times 0 and 0.3 lie 0.3 apart, closer than `spacing` 0.5"),
        ({"fixed": [0.0, 1.0, 2.0, 3.0]}, "fixed", "`fixed` names 4 times, `samples` allows 3"),
        ({"samples": 1}, "samples", "need at least 2. The nearest that works: samples 2"),
    ],
)
def test_an_impossible_requirement_names_the_obstacle_and_the_nearest_that_works(changes, obstacle, words):
    with pytest.raises(InfeasibleRequirementError, match=re.escape(words)) as caught:
        design_schedule(OSCILLATOR, Requirement(**{**BASE, **changes}))
    error = caught.value
    assert error.obstacle == obstacle
    assert error.exit_code == 1
    assert error.nearest
    for key, value in error.nearest.items():  # each change alone works
        repaired = {**BASE, **changes, key: value}
        if key == "spacing":
            repaired[key] = value * (1 - 1e-6)
        requirement, _ = resolve(split_modes(OSCILLATOR), Requirement(**repaired))
        assert pose(OSCILLATOR, requirement, requirement.samples["exactly"]).capacity() >= 1


def test_the_capacity_is_the_most_by_enumeration():
    from itertools import combinations

    grid = np.arange(20) / 5
    for forbidden in ([[0.4, 1.0]], [[0.0, 0.6], [2.0, 3.0]], [[1.0, 1.2], [3.4, 4.0]]):
        requirement, _ = resolve(
            split_modes(OSCILLATOR), Requirement(window=4.0, spacing=0.6, samples=2, forbidden=forbidden)
        )
        problem = pose(OSCILLATOR, requirement, 2)
        allowed = grid[problem.mask(grid).any(axis=-1)]
        most = max(
            k
            for k in range(1, 8)
            for c in combinations(allowed, k)
            if k == 1 or np.min(np.diff([*c, c[0] + 4.0])) >= 0.6 - 1e-9
        )
        assert problem.capacity() >= most
        assert problem.capacity() <= most + 1  # off the grid there may be room for one more


def test_an_unknown_output_and_times_beyond_a_default_period_are_refused():
    with pytest.raises(ArgumentError, match="unknown key 'z' in `outputs` of the requirement"):
        design_schedule(OSCILLATOR, Requirement(**BASE, outputs={"z": {"cost": 1.0}}))
    with pytest.raises(ArgumentError, match="`forbidden` must lie within the period"):
        design_schedule(OSCILLATOR, Requirement(**BASE, forbidden=[[5.0, 6.0]]))


def test_an_unseen_mode_is_refused_by_name():
    plant = Plant(np.diag([0.1, 0.2]), [[1.0, 0.0]])
    with pytest.raises(NotObservableError, match=r"0\.2"):
        design_schedule(plant, Requirement(window=4.0, spacing=0.5, samples=3))


def test_a_search_without_a_start_says_so(monkeypatch):
    monkeypatch.setattr("sampling_design.design.search.repaired", lambda problem, times: None)
    monkeypatch.setattr("sampling_design.design.exchange.repaired", lambda problem, times: None)
    with pytest.raises(SolverError, match="No admissible start was found for 3 samples") as caught:
        design_schedule(OSCILLATOR, Requirement(**BASE))
    assert caught.value.status == "no start"
