"""Law: with scales that move along, units of states, outputs and time change no design: not whether there is one, nor
how many samples, nor which outputs they measure, nor sigma; times and periods follow the unit of time."""

import functools
import os

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule, pareto_front, window_sigma
from sampling_design.design import sample_losses
from sampling_design.errors import InfeasibleRequirementError
from sampling_design.plants import library
from tests.rescale import Units

PAIR = Plant(np.kron(np.diag([1.0, 1.7]), [[0.0, 1.0], [-1.0, 0.0]]), [[1.0, 0.0, 0.5, 0.0], [0.0, 0.3, 1.0, 0.2]])
CASES = {
    "oscillator": (library.oscillator(), {"window": 4.0, "spacing": 0.5, "samples": 3}),
    "chain": (library.triple_integrator(), {"window": 4.0, "spacing": 0.3, "samples": 4, "forbidden": [[0.5, 1.5]]}),
    "growing": (
        Plant([[0.5, 1.0], [-1.0, 0.5]], [[1.0, 0.2]]),
        {"window": 4.0, "spacing": 0.4, "samples": {"at_most": 4}},
    ),
    "outputs": (
        PAIR,
        {
            "window": 6.0,
            "spacing": 0.3,
            "samples": 3,
            "sensors": {"y1": {"price": 1.0}, "y2": {"price": 2.0}},
            "cost_limit": 8.0,
        },
    ),
    "impossible": (PAIR, {"window": 6.0, "spacing": 0.3, "samples": 1}),
}
QUICK = {"starts": 2, "branches": 4, "rtol": 1e-7}  # sigma is stated to rtol
AGREE = 1e-6
SEEDS = range(int(os.environ.get("UNIT_SEEDS", "1")))
"""A benchmark may ask for more."""


def in_time(asked, c):
    """The requirement with all its times in the new unit."""
    times = {key: np.multiply(asked[key], c) for key in ("window", "spacing", "forbidden") if key in asked}
    return Requirement(**{**asked, **times, "period": asked["window"] * c})


@functools.cache
def first_design(name):
    return designed(*CASES[name], 1.0)


def designed(plant, asked, c):
    try:
        return design_schedule(plant, in_time(asked, c), **QUICK)
    except InfeasibleRequirementError as error:
        return error


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_a_design_is_the_same_in_all_units(name):
    plant, asked = CASES[name]
    first = first_design(name)
    for seed in SEEDS:
        units = Units.drawn(np.random.default_rng([seed, *name.encode()]), plant)
        other = designed(units.plant(plant), asked, units.time)
        assert type(other) is type(first)
        if isinstance(first, InfeasibleRequirementError):
            assert (other.obstacle, other.nearest) == (first.obstacle, first.nearest)
            continue
        assert len(other.schedule) == len(first.schedule)
        assert other.status == first.status == "complete"
        assert other.sigma == pytest.approx(first.sigma, rel=AGREE)
        assert other.upper_bound == pytest.approx(first.upper_bound, rel=AGREE)
        assert other.cost == pytest.approx(first.cost, rel=1e-12)
        assert other.schedule.period == pytest.approx(first.schedule.period * units.time, rel=1e-12)
        moved = units.plant(plant).scaled()
        again = window_sigma(moved, units.schedule(first.schedule), asked["window"] * units.time, rtol=1e-7)
        assert again.lower == pytest.approx(first.sigma, rel=1e-6)  # the first schedule is as good in the new units
        assert other.verify()


@pytest.mark.long
def test_a_front_and_its_losses_are_the_same_in_all_units():
    plant, asked = CASES["oscillator"]
    units = Units.drawn(np.random.default_rng(3), plant)
    c, moved = units.time, units.plant(plant)
    fronts = [pareto_front(p, in_time(asked, t), [1, 2], **QUICK) for p, t in ((plant, 1.0), (moved, c))]
    sigmas = [[point.sigma for point in front.points] for front in fronts]
    assert sigmas[1] == pytest.approx(sigmas[0], rel=AGREE)
    assert [bool(p.obstacle) for p in fronts[1].points] == [bool(p.obstacle) for p in fronts[0].points]
    designs = [design_schedule(p, in_time(asked, t), **QUICK) for p, t in ((plant, 1.0), (moved, c))]
    losses = [sample_losses(design, rtol=1e-7) for design in designs]
    assert losses[1].sigma == pytest.approx(losses[0].sigma, rel=AGREE)
    assert np.sort(losses[1].bound) == pytest.approx(np.sort(losses[0].bound), rel=AGREE)


@pytest.mark.long
def test_where_units_differ_the_scaled_sigma_is_designed_and_named():
    plant, asked = CASES["outputs"]
    units = Units.drawn(np.random.default_rng(0), plant)
    moved = units.plant(plant)
    plain = {**asked, "window": asked["window"] * units.time, "spacing": asked["spacing"] * units.time}
    design = design_schedule(moved, Requirement(**plain), **QUICK)
    assert design.coordinates == "scaled"
    assert "scaled coordinates" in str(design)
    first = first_design("outputs")
    assert design.sigma == pytest.approx(first.sigma, rel=AGREE)
    assert np.array_equal(np.sort(design.schedule.outputs.sum(axis=0)), np.sort(first.schedule.outputs.sum(axis=0)))
