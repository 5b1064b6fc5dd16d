"""Plans that the pages show do not get worse unseen: their cost, what they bear, and their gaps."""

from pathlib import Path

import pytest

import sampling_design as sd
from sampling_design.planning.requirement_file import requirement_and_plant
from tests.benchmarks import plan_gaps
from tests.cases import few

PLANS = Path(__file__).parents[2] / "examples" / "plans"


@pytest.mark.long
def test_the_passes_of_a_satellite_cost_as_little_as_can_be_and_say_what_they_bear():
    requirement, plant = requirement_and_plant(PLANS / "satellite_passes.toml")
    found = sd.plan_samples(plant, requirement)
    assert found.cost == found.bound.cost.value == 19.0
    assert found.ratio <= 0.93
    assert found.gap <= 0.05
    assert not found.left_out
    assert found.robustness is not None
    assert found.robustness.least_late >= 300.0


@pytest.mark.long
@pytest.mark.parametrize("name", few(["cart_pendulum", "satellite"], 0))
def test_four_samples_with_every_sensor_are_as_good_as_the_best_within_a_hundredth(name):
    found = sd.plan_samples(
        *plan_gaps.posed(name, 4), search_seconds=6.0, certificate=False, robustness=False, from_start=False
    )
    assert found.gap <= 0.01
    assert found.verify()


@pytest.mark.long
@pytest.mark.parametrize("samples", [2, 3, 4])
def test_few_samples_of_three_compartments_are_as_good_as_the_best_within_a_hundredth(samples):
    found = sd.plan_samples(
        *plan_gaps.posed("three_compartment", samples), certificate=False, robustness=False, from_start=False
    )
    assert found.gap <= 0.01
    assert found.verify()
