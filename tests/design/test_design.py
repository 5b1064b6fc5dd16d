"""design_schedule end to end: proven sigma below the bound, constraints kept, defaults told."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Requirement, design_schedule, window_sigma
from sampling_design.design.bounds import branching
from sampling_design.design.bounds.derivatives import remainder_of_bend
from sampling_design.design.bounds.evidence import UpperBound
from sampling_design.design.design import GAP, _cuts
from sampling_design.design.problem.posing import pose
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.plants import library
from sampling_design.plants.plant import Signals
from sampling_design.records.record import short
from tests.cases import few


def oscillator():
    return Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_the_oscillator_is_designed_to_its_optimum():
    design = design_schedule(library.oscillator(), Requirement(window=2 * np.pi, spacing=0.2, samples=4))
    assert design.sigma_attained == pytest.approx(np.sqrt(2), rel=1e-6)  # four samples a quarter apart
    assert design.upper_bound == pytest.approx(np.sqrt(2), rel=1e-6)
    assert design.gap < 0.011
    assert design.verify()


def test_constraints_are_kept_and_fixed_times_are_exact():
    requirement = Requirement(window=4.0, spacing=0.4, samples=4, forbidden=[[0.5, 1.0], [3.0, 3.5]], fixed=[0.25])
    design = design_schedule(oscillator(), requirement, starts=1, branches=2)
    times = design.schedule.times
    assert 0.25 in times
    assert not np.any((times >= 0.5) & (times < 1.0))
    assert not np.any((times >= 3.0) & (times < 3.5))
    assert design.schedule.gaps.min() >= 0.4
    assert 0 < design.sigma <= design.sigma_attained <= design.upper_bound
    assert design.verify()


def test_nothing_retained_needs_no_samples():
    design = design_schedule(Plant([[-1.0]], [[1.0]]))
    assert design.schedule is None
    assert design.status == "no samples needed"
    assert design.verify()


@pytest.mark.parametrize("seconds", [1.0, 3600.0])
def test_a_plant_that_needs_no_samples_says_what_happens_without_and_what_samples_buy(seconds):
    """A time constant of 5 h is a tenth after 11.5 h in either unit; at the rate that it names a mode is observed."""
    unit = "s" if seconds > 1 else "h"
    plant = Plant(np.array([[-1.0, 0.3], [0.0, -0.2]]) / seconds, [[1.0, 0.0]], time_unit=unit)
    text = design_schedule(plant).explain()
    assert "falls by itself: to a tenth within 11" in text
    rate = float(re.search(r"--decay-rate ([\d.e-]+)", text)[1])
    asked = design_schedule(plant, Requirement(decay_rate=rate), starts=1, branches=1)
    assert asked.split.retained.n_states == 1
    assert len(asked.schedule) == int(re.search(r"(\d+) in every", text)[1])
    left = np.abs(np.linalg.solve(plant.A, plant.G)).sum(axis=1)
    assert f"x1 {short(left[0], 3)}, x2 {short(left[1], 3)}" in text


def test_a_plant_or_requirement_of_another_type_is_refused():
    with pytest.raises(ArgumentError, match=r"`plant` must be a Plant, got str 'oscillator'\. Use read_plant"):
        design_schedule("oscillator")
    with pytest.raises(ArgumentError, match=r"`requirement` must be a Requirement, got dict .*\. Use read_requirement"):
        design_schedule(oscillator(), {"window": 4.0})


def test_a_target_is_reached_with_the_fewest_samples():
    requirement = Requirement(window=2 * np.pi, spacing=0.2, target_sigma=1.3)
    design = design_schedule(oscillator(), requirement, starts=3)
    assert len(design.schedule) == 4
    assert design.sigma >= 1.3
    assert "4 is the fewest: the bound rules out 1.3 with 3" in design.notes[-1]


@pytest.mark.long
def test_the_narrowed_bound_rules_out_what_the_first_one_leaves_open():
    requirement = Requirement(window=10.0, period=10.0, spacing=0.5, target_sigma=0.445)
    chain = Plant(np.eye(3, k=1), [[1.0, 0.0, 0.0]])
    notes = [design_schedule(chain, requirement, starts=1, branches=b).notes[-1] for b in (0, 20)]
    assert notes[0].startswith("6 is the fewest that was found; the bound rules out 0.445 up to 4 only")
    assert notes[1] == "6 is the fewest: the bound rules out 0.445 with 5"


def test_a_target_out_of_reach_names_what_was_found():
    requirement = Requirement(window=2 * np.pi, spacing=0.2, target_sigma=5.0, samples={"at_most": 5})
    with pytest.raises(
        InfeasibleRequirementError, match="`target_sigma` 5 is not reached with up to 5 samples"
    ) as caught:
        design_schedule(oscillator(), requirement, starts=2)
    assert caught.value.obstacle == "target_sigma"
    again = design_schedule(oscillator(), requirement.replace(**caught.value.nearest), starts=2)
    assert again.sigma >= caught.value.nearest["target_sigma"] > 1.0  # every bound fell short, yet this one is proven


@pytest.mark.parametrize(
    "change",
    few(
        [
            {"samples": {"at_most": 4}},
            {"samples": 3, "spacing": 1.1},
            {"samples": 9},
            {"samples": 9, "target_sigma": 7.0},
        ],
        0,
    ),
)
def test_the_nearest_target_is_reached_by_the_whole_design(change):
    asked = Requirement(window=4.0, spacing=0.5, target_sigma=1.6).replace(**change)
    with pytest.raises(InfeasibleRequirementError, match=r"target_sigma|room for") as caught:
        design_schedule(oscillator(), asked, starts=1, branches=1)
    again = design_schedule(oscillator(), asked.replace(**caught.value.nearest), starts=1, branches=1)
    assert again.schedule is not None
    assert again.verify()


def test_a_blind_target_offers_a_design_without_one():
    plant = Plant(np.kron(np.diag([1.0, 2.0]), [[0.0, 1.0], [-1.0, 0.0]]), [[1.0, 0.0, 1.0, 0.0]])
    asked = Requirement(window=4.0, spacing=0.2, target_sigma=1e3, samples=3)
    with pytest.raises(
        InfeasibleRequirementError, match="found no schedule that makes every state observable"
    ) as caught:
        design_schedule(plant, asked)
    assert caught.value.nearest == {"samples": 4, "target_sigma": None}
    again = design_schedule(plant, asked.replace(**caught.value.nearest), starts=1, branches=0)
    assert len(again.schedule) == 4


def test_at_most_takes_what_there_is_room_for_and_at_least_the_fewest():
    base = {"window": 4.0, "spacing": 0.9}
    assert len(design_schedule(oscillator(), Requirement(samples={"at_most": 9}, **base), starts=1).schedule) == 4
    assert len(design_schedule(oscillator(), Requirement(samples={"at_least": 3}, **base), starts=1).schedule) == 3


def test_scaled_coordinates_are_designed_for_wherever_the_plant_has_scales():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=Signals(("x", "v"), scales=[1.0, 10.0]))
    base = {"window": 4.0, "spacing": 0.5, "samples": 3}
    scaled = design_schedule(plant, Requirement(**base), starts=1, branches=0)
    plain = design_schedule(plant.unscaled(), Requirement(**base), starts=1, branches=0)
    assert (plain.coordinates, scaled.coordinates) == ("physical", "scaled")
    assert scaled.sigma >= window_sigma(plant, plain.schedule, 4.0).lower * (1 - 1e-3)
    assert "scaled coordinates" in str(scaled)
    assert scaled.verify()
    assert plain.verify()


@pytest.mark.long
def test_sigma_of_a_design_is_that_of_the_window_that_its_table_names():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=Signals(("x", "v"), scales=[1.0, 10.0]))
    design = design_schedule(plant, Requirement(window=4.0, period=5.0, spacing=0.5, samples=4), starts=1, branches=0)
    assert "of 4 s (half-open, at every real position)" in str(design)
    again = window_sigma(plant, design.schedule, 4.0)
    assert (again.lower, again.upper) == (design.sigma, design.sigma_attained)
    assert again.lower == design.window.lower


def test_a_budget_that_ran_out_is_told_and_the_proof_still_stands():
    design = design_schedule(oscillator(), Requirement(window=4.0, spacing=0.5, samples=3), budget=0.0)
    assert design.status == "budget"
    assert 0 < design.sigma <= design.upper_bound
    assert design.verify()


@pytest.mark.long
def test_a_budget_cuts_relaxations_and_branches_of_a_large_design_too():
    ends = [0.0, *(24.0 * day + hour for day in range(30) for hour in (7.0, 19.0)), 720.0]
    nights = np.array(ends).reshape(-1, 2)
    requirement = Requirement(window=720.0, period=720.0, spacing=5.0, samples=30, forbidden=nights)
    design = design_schedule(library.tidal_gauge(), requirement, budget=0.2)
    assert design.status == "budget"
    assert len(design.history) == 1  # the first start only
    assert 0 < design.sigma <= design.upper_bound
    assert design.verify()


@pytest.mark.long
def test_a_bound_never_grows_by_branching():
    requirement = Requirement(window=10.0, period=10.0, spacing=0.5, samples=6)
    plant = Plant(np.eye(3, k=1), [[1.0, 0.0, 0.0]])
    designs = [design_schedule(plant, requirement, starts=1, branches=b) for b in (0, 6, 30)]
    bounds = [d.upper_bound for d in designs]
    assert bounds == sorted(bounds, reverse=True)
    assert bounds[2] < bounds[0] * 0.98
    assert designs[2].gap < 0.004
    assert designs[2].verify()


@pytest.mark.long
def test_closed_times_are_branched_on_too():
    requirement = Requirement(window=4.0, spacing=0.3, samples=5, forbidden=[[0.0, 1.2]])
    design = design_schedule(oscillator(), requirement, starts=2, branches=40)
    assert design.gap < 0.002
    assert design.bound.method == "zones"
    assert design.verify()


@pytest.mark.parametrize("step", ["_rooted", "_cut_on"])
def test_an_interrupt_before_a_cut_leaves_the_design_with_the_bound_so_far(step, monkeypatch):
    def interrupted(*asked):
        raise KeyboardInterrupt

    monkeypatch.setattr(branching, step, interrupted)
    requirement = Requirement(window=4.0, spacing=0.3, samples=5, forbidden=[[0.0, 1.2]])
    design = design_schedule(oscillator(), requirement, starts=1, branches=40)
    assert design.status == "interrupted"
    assert design.verify()


def test_progress_rises_to_the_end_and_costs_are_summed():
    seen = []
    outputs = {"y1": {"price": 2.5}}
    requirement = Requirement(window=4.0, spacing=0.5, samples=3, sensors=outputs)
    design = design_schedule(oscillator(), requirement, starts=2, progress=lambda f, m: seen.append(f))
    assert seen == sorted(seen)
    assert seen[-1] <= 1.0
    assert design.cost == 7.5


def test_a_tampered_design_does_not_verify():
    design = design_schedule(oscillator(), Requirement(window=4.0, spacing=0.5, samples=3), starts=2)
    assert design.verify()
    assert not replace(design, sigma=design.sigma * 1.02).verify()
    assert not replace(design, sigma_attained=design.sigma_attained * 0.98).verify()
    assert not replace(design, upper_bound=design.upper_bound * 0.98).verify()
    crowded = PeriodicSchedule.from_times([0.0, 0.1, 2.0], 4.0, time_unit="s", output_names=("y1",))
    assert not replace(design, schedule=crowded).verify()


def test_the_dictionary_is_json_and_holds_the_multipliers():
    design = design_schedule(oscillator(), Requirement(window=4.0, spacing=0.5, samples=3), starts=2)
    data = json.loads(json.dumps(design.to_dict(), allow_nan=False))
    arrays = {"starts": (-1,), "weights": (-1, 2, 2), "zones": (-1, 2), "tilt": (-1,), "tied": (-1, 4)}
    parts = [
        replace(
            part, **{key: np.array(told[key], getattr(part, key).dtype).reshape(size) for key, size in arrays.items()}
        )
        for part, told in zip(design.bound.parts, data["bound"]["parts"], strict=True)
    ]
    bound = UpperBound(data["bound"]["value"], tuple(parts))
    assert bound.value_for(design.problem) == pytest.approx(design.upper_bound, rel=1e-12)
    assert data["requirement"]["samples"] == {"exactly": 3}
    assert data["schedule"]["times"] == design.schedule.times.tolist()


def test_a_strongly_unstable_plant_does_not_break_the_solver():
    plant = Plant([[2.0, 1.0], [0.0, -1.0]], [[1.0, 0.5]])  # e^{AT} about 3000
    design = design_schedule(plant, Requirement(window=4.0, spacing=0.3, samples=4, decay_rate=3.0), starts=3)
    assert design.split.retained.n_states == 2
    assert design.gap < 0.15
    assert design.verify()


@pytest.mark.parametrize(
    ("states", "rate", "cuts"),
    [
        *((2, 0.1, (20, 150)), (8, 0.1, (20, 150)), (11, 0.1, (5, 44)), (20, 0.1, (0, 4))),
        *((11, 0.0, (5, 44)), (20, 0.0, (20, 150)), (40, 0.0, (2, 18))),  # of many that keep their size as many
    ],
)
def test_cuts_that_take_longer_are_fewer(states, rate, cuts):
    rule = Requirement(window=4.0, spacing=0.1, samples=4)
    problem = pose(Plant(-rate * np.eye(states), np.eye(states)), rule.replace(period=4.0), 4)
    assert _cuts(problem, None) == (*cuts, GAP)
    assert _cuts(problem, 7) == (7, 7, 0.0)


def test_a_bound_that_says_nothing_is_called_so():
    near = design_schedule(library.oscillator(), Requirement(window=6.0, samples=4), starts=1, branches=0)
    assert not near.bound_is_vacuous
    far = replace(near, upper_bound=1e30)
    assert far.bound_is_vacuous
    assert "a bound so far off that it says nothing of how near the best this schedule is" in far.explain()
    assert "a bound that says nothing of this design" in str(far)
    bottom = far.plot()[1]
    assert bottom.get_ylim()[1] < 10
    assert "too far off to say more" in bottom.figure.get_suptitle()
    unnamed = replace(near, plant=replace(near.plant, name="")).plot()[0]
    assert unnamed.figure.get_suptitle().startswith("sigma")


def test_a_remainder_that_is_no_number_bounds_nothing():
    spin = np.array([[4.0, 1000.0], [-1000.0, 4.0]])
    node, width = np.array([0, 1]), np.array([0.1, 0.1])
    rest = remainder_of_bend(
        spin, np.array([1e290 * np.eye(2), 0.0 * np.eye(2)]), 9, node, width, np.array([[np.inf]] * 2)
    )
    assert rest.ravel().tolist() == [np.inf, 0.0]


def test_what_needs_no_samples_offers_no_picture():
    stable = design_schedule(Plant([[-1.0]], [[1.0]]))
    assert "how to draw" not in str(stable)
    assert "sd.accuracy.accuracy_by_count(plant, (0, 1, 4), period=" in stable.explain()
