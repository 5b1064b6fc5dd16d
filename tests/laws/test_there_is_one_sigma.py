"""Law: sigma of a schedule is one number, whoever states it: a design, `window_sigma`, `worst_case_sigma`,
`pareto_front`,
`sample_losses` and the command line, of plants with scales and without, of whole plants and of retained parts; it is
told of the state's length in the plant's own scales, so that neither a basis nor a unit chosen inside shows in it."""

import json
import sys

import numpy as np
import pytest

from sampling_design import (
    PeriodicSchedule,
    Plant,
    Requirement,
    Schedule,
    SpacedWindows,
    design_schedule,
    pareto_front,
    window_sigma,
    worst_case_sigma,
)
from sampling_design.certificates.paper.proof_constants import certify_from_proof
from sampling_design.cli import main
from sampling_design.design import sample_losses
from sampling_design.plants.files import write_plant
from sampling_design.plants.modes import split_modes
from sampling_design.plants.plant import Signals
from sampling_design.plotting import style
from sampling_design.schedules.files import write_schedule
from sampling_design.validation import compare_schedule
from tests.cases import few

QUICK = {"starts": 1, "branches": 0}
RNG = np.random.default_rng(35)
TURN = np.linalg.qr(RNG.standard_normal((4, 4)))[0] + 0.3 * RNG.standard_normal((4, 4))
FOUR = Plant(
    np.linalg.solve(TURN, np.array([[0, 1.0, 0, 0], [-1.0, 0, 0, 0], [0, 0, -2.0, 1.0], [0, 0, 0, -3.0]]) @ TURN),
    RNG.standard_normal((1, 4)),
)
PAIR = Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.2], [0.0, 1.0]])


def with_scales(plant, states, outputs):
    return Plant(
        plant.A,
        plant.C,
        time_unit="h",
        states=Signals(plant.states.names, scales=states),
        outputs=Signals(plant.outputs.names, scales=outputs),
    )


PLANTS = {
    "whole, growing, without scales": PAIR,
    "whole, scales of states and outputs": with_scales(PAIR, [10.0, 2.0], [2.0, 0.3]),
    "retained part, without scales": FOUR,
    "retained part, scales of states": with_scales(FOUR, [10.0, 1.0, 0.1, 3.0], [1.0]),
    "retained part, scales of outputs": with_scales(FOUR, np.ones(4), [1e-9]),
}
ASKED = {"window": 4.0, "spacing": 0.5, "samples": 3}


@pytest.fixture(scope="module", params=few(PLANTS, 0, 3))
def designed(request):
    plant = PLANTS[request.param]
    return plant, design_schedule(plant, Requirement(**ASKED), **QUICK)


def seen_by_hand(plant, schedule, window, count=4000):
    """The least |y~| over states of the retained part with |x~| = 1, over many windows: rows as they are."""
    split, scales = split_modes(plant), plant.states.scales
    V = split.basis_retained if split.residual.n_states else np.eye(plant.n_states)
    Q = np.linalg.qr(V / scales[:, None])[0]
    least = np.inf
    for start in schedule.first + schedule.period * (np.arange(count) + 1e-9) / count:
        held = schedule.between(start, start + window).times - start
        rows = (plant.C @ plant.transition(held)) / plant.outputs.scales[:, None] * scales @ Q
        least = min(least, np.linalg.svd(rows.reshape(-1, Q.shape[1]), compute_uv=False)[-1])
    return least


def test_a_design_states_the_sigma_of_its_schedule(designed):
    plant, design = designed
    there = window_sigma(split_modes(plant).retained, design.schedule, 4.0)
    assert (design.sigma, design.sigma_attained) == (there.lower, there.upper)
    assert design.coordinates == ("modal" if design.split.residual.n_states else there.coordinates)
    by_hand = seen_by_hand(plant, design.schedule, 4.0, 400)
    assert there.lower <= by_hand * (1 + 1e-9)
    assert there.lower >= by_hand * (1 - 2e-2)


def test_a_front_states_the_sigma_and_the_bound_of_its_designs(designed):
    plant, design = designed
    (point,) = pareto_front(plant, Requirement(**ASKED), [3], **QUICK).points
    assert (point.sigma, point.upper_bound) == (design.sigma, design.upper_bound)
    assert point.times == tuple(design.schedule.times.tolist())


def test_losses_state_the_sigma_of_the_design_and_the_bound_of_a_front():
    plant = with_scales(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), [2.0, 2.0], [0.1])
    design = design_schedule(plant, Requirement(**ASKED), **QUICK)
    losses = sample_losses(design, every_period=True)
    assert (losses.sigma, losses.coordinates) == (design.sigma, design.coordinates)
    assert losses.plot().get_ylabel() == "sigma (scaled, state at window's start)"
    times, period = design.schedule.times, design.schedule.period
    for i in range(3):
        rest = PeriodicSchedule.from_times(np.delete(times, i), period, time_unit="h")
        assert losses.lower[i] == window_sigma(plant, rest, 4.0).lower
    (fewer,) = pareto_front(plant, Requirement(**ASKED), [2]).points
    assert losses.bound == pytest.approx(np.maximum(min(fewer.upper_bound, design.upper_bound), losses.lower))


def test_a_comparison_names_the_coordinates_of_the_design(designed):
    plant, design = designed
    taken = design.schedule.between(0.0, 9.0).times
    log = compare_schedule(plant, design.schedule, taken, 4.0, retained=design.split.retained)
    assert log.planned_sigma.coordinates == log.actual_sigma.coordinates == design.coordinates
    assert log.plot()[1].get_ylabel() == style.sigma_label(design.coordinates)


def test_a_target_is_that_sigma(designed):
    plant, design = designed
    asked = Requirement(window=4.0, spacing=0.5, samples=3, target_sigma=0.98 * design.sigma)
    reached = design_schedule(plant, asked, **QUICK)
    assert window_sigma(split_modes(plant).retained, reached.schedule, 4.0).lower >= 0.98 * design.sigma


@pytest.mark.parametrize("name", PLANTS)
def test_the_worst_case_of_one_schedule_is_its_sigma(name):
    """Three samples half a second apart in a window of one second: no other schedule keeps that rule."""
    retained = split_modes(PLANTS[name]).retained
    alone = worst_case_sigma(retained, SpacedWindows(1.0, 3, 0.5))
    there = window_sigma(retained, Schedule([0.0, 0.5, 1.0]), 1.0)
    assert alone.upper == pytest.approx(there.upper, rel=1e-9)
    assert alone.coordinates == there.coordinates
    every = worst_case_sigma(retained, SpacedWindows(4.0, 4, 0.5))
    assert every.upper >= every.lower
    assert window_sigma(retained, PeriodicSchedule([0.9]), 4.0).upper >= every.lower


@pytest.mark.long
@pytest.mark.parametrize("name", few(list(PLANTS)[1:3], 0))
def test_the_command_line_states_it_too(name, tmp_path, capsys, monkeypatch):
    def told(*arguments):
        monkeypatch.setattr(sys, "argv", ["sampling-design", *map(str, arguments), "--json"])
        with pytest.raises(SystemExit) as stop:
            main()
        assert not stop.value.code
        return json.loads(capsys.readouterr().out)

    plant = PLANTS[name]
    retained = split_modes(plant).retained
    schedule = PeriodicSchedule([0.5, 1.5, 1.0], time_unit=plant.time_unit)
    file, times = write_plant(plant, tmp_path / "plant.toml"), write_schedule(schedule, tmp_path / "times.csv")
    said = told("sigma", file, times, "--window", 4.0)
    there = window_sigma(retained, schedule, 4.0)
    kind = there.coordinates if retained is plant else "modal"
    assert (said["lower"], said["coordinates"]) == (there.lower, kind)
    rule = ("--window", 1.0, "--count", 3, "--spacing", 0.5)
    worst = told("worst-case", file, *rule)
    assert worst["upper"] == worst_case_sigma(retained, SpacedWindows(1.0, 3, 0.5)).upper
    asked = ("--window", 4.0, "--spacing", 0.5, "--samples", 2)
    design = told("design", file, *asked, "--branches", 0, "--no-picture", "-o", tmp_path)
    again = told("sigma", file, tmp_path / "schedule.csv", "--window", 4.0)
    assert (design["sigma"], design["coordinates"]) == (again["lower"], again["coordinates"])


@pytest.mark.parametrize("name", list(PLANTS)[2:])
def test_more_that_is_retained_is_never_seen_better(name):
    """What is retained at a larger rate contains what was: sigma over more states falls, down to the whole plant's."""
    plant, schedule = PLANTS[name], PeriodicSchedule([0.4])
    told = [window_sigma(split_modes(plant, rate).retained, schedule, 4.0) for rate in (0.0, 4.5, 7.0)]
    assert told[0].lower >= told[1].lower * (1 - 1e-3)
    assert told[1].lower >= told[2].lower * (1 - 1e-3)
    assert told[2].lower == window_sigma(plant, schedule, 4.0).lower


@pytest.mark.parametrize("seed", range(3))
def test_units_that_scales_follow_change_no_sigma_of_a_retained_part(seed):
    rng = np.random.default_rng([35, seed])
    units, size = 10.0 ** rng.integers(-9, 10, 4), 10.0 ** rng.integers(-9, 10)
    moved = Plant(FOUR.A * units[:, None] / units, FOUR.C * size / units, states=Signals(list("abcd"), scales=units),
                  outputs=Signals(["y"], scales=[size]))  # fmt: skip
    schedule = PeriodicSchedule([0.5, 1.5, 1.0])
    one, other = (window_sigma(split_modes(p).retained, schedule, 4.0) for p in (FOUR, moved))
    assert other.lower == pytest.approx(one.lower, rel=1e-6)


@pytest.mark.long
def test_a_proof_counts_in_physical_units():
    """Constants of the paper's proof are about the matrices as they stand, whatever scales stand beside them."""
    plant, schedule = PLANTS["whole, scales of states and outputs"], PeriodicSchedule([0.4], time_unit="h")
    with_them, bare = (certify_from_proof(p, schedule) for p in (plant, plant.unscaled()))
    assert with_them.lam == bare.lam
