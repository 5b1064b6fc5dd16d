"""Designs for samples that come early or late: sigma holds for all real times, and the bound for all schedules."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize

import sampling_design as sd
from sampling_design.design import read_requirement, write_requirement
from sampling_design.design.problem.posing import pose
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.records.record import below
from tests.cases import few
from tests.oracles.design import random_schedule, window_sigma_scan

A, C = [[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]
OSCILLATOR, TURN, LATE = sd.Plant(A, C), 2 * np.pi, 0.02
ASKED = sd.Requirement(window=TURN, period=TURN, spacing=0.2, samples=4, timing_tolerance=LATE)
WIDER = ASKED.replace(window=TURN + 2 * LATE)


@pytest.fixture(scope="module")
def designs():
    return tuple(sd.design_schedule(OSCILLATOR, asked, starts=1, branches=0) for asked in (ASKED, WIDER))


def worst_of_real_times(times, window):
    """The least sigma of the windows just after a sample, or just before the one that comes a period later, over real
    times on plan and at both ends of their tolerance."""
    found = np.inf
    moves = np.array(list(product((-LATE, 0.0, LATE), repeat=len(times) + 1)))
    for j in range(len(times)):
        real = np.concatenate([times[j:], times[: j + 1] + TURN]) + moves
        rows = np.stack([np.cos(real), np.sin(real)], axis=-1)
        for start in (real[:, :1] + 1e-9, real[:, -1:] - window - 1e-9):
            inside = (real >= start) & (real <= start + window)
            seen = np.linalg.svd(rows * inside[:, :, None], compute_uv=False)  # turned states are seen alike
            found = min(found, seen[:, 1].min())
    return found


def test_sigma_is_that_of_all_real_times_and_is_nearly_attained(designs):
    for design, asked in zip(designs, (ASKED, WIDER), strict=True):
        proof = sd.window_sigma(OSCILLATOR, design.schedule, asked.window, timing_tolerance=LATE)
        assert design.sigma == proof.lower
        assert design.sigma_attained == proof.upper
        attained = worst_of_real_times(design.schedule.times, asked.window)
        assert design.sigma <= attained * (1 + 1e-9)
        assert attained <= 1.05 * design.sigma
        assert design.verify()


def test_the_bound_is_one_of_that_aim_and_near(designs):
    exact = sd.design_schedule(OSCILLATOR, ASKED.replace(timing_tolerance=0.0), starts=2, branches=2)
    plain, wider = designs
    assert plain.upper_bound < 0.9 * exact.upper_bound  # a window of one turn may lose a sample
    assert wider.upper_bound <= exact.upper_bound * (1 + 1e-6)
    assert wider.gap < 0.05
    assert wider.sigma == pytest.approx(exact.sigma, rel=0.05)
    rng = np.random.default_rng(5)
    for _ in range(6):
        times = random_schedule(rng, TURN, 0.2, 4)
        for design, asked in zip(designs, (ASKED, WIDER), strict=True):
            assert worst_of_real_times(times, asked.window) <= design.upper_bound


@pytest.mark.parametrize("seed", few([0, 2, 3, 4, 6, 10, 11, 12], 0))
def test_no_schedule_beats_the_bound_under_the_tolerance(seed):
    """Schedules that are sought for their least sigma over real times, which a plain program tries one by one.

    The bound of exact times is up to 1.7 times as large for these plants.
    """
    rng = np.random.default_rng(seed)
    states, samples, late = 2 + seed % 2, 3 + seed % 2, (0.02, 0.1, 0.2)[seed % 3]
    A, C = rng.normal(size=(states, states)), rng.normal(size=(1 + seed % 2, states))
    asked = sd.Requirement(window=(4.0, 4.0 + 2 * late)[seed // 2 % 2], period=4.0, spacing=0.45, samples=samples)
    plant = sd.Plant(A - (np.linalg.eigvals(A).real.min() - 0.05) * np.eye(states), C)  # every mode grows
    design = sd.design_schedule(plant, asked.replace(timing_tolerance=late), starts=1, branches=20 if seed else 6)
    posed = pose(plant, design.requirement, samples)

    def worst(gaps):
        gaps = np.maximum(gaps, 0.0) / np.sum(np.maximum(gaps, 0.0)) * (4.0 - 0.45 * samples) + 0.45
        times = np.cumsum(gaps) - gaps[0]
        return window_sigma_scan(plant.A, posed.plant.C, times, 4.0, posed.window, places=0, late=late)

    tried = [rng.exponential(size=samples) for _ in range(2)]
    found = [minimize(lambda gaps: -worst(gaps), x, method="Nelder-Mead", options={"maxfev": 30}) for x in tried]
    own = worst(design.schedule.gaps - 0.45)
    assert design.sigma <= own * (1 + 1e-9)
    assert max(own, *(-each.fun for each in found)) <= design.upper_bound * (1 + 1e-9)
    assert own >= 0.96 * design.upper_bound


def crossed(seed):
    """A random plant and requirement: late samples beside whatever else may be asked, in units far apart."""
    rng = np.random.default_rng(seed)
    states, outputs, late = 2 + seed % 2, 1 + seed // 2 % 2, (0.02, 0.08)[seed % 2]
    A, C = rng.normal(size=(states, states)), rng.normal(size=(outputs, states))
    A -= (np.linalg.eigvals(A).real.min() - 0.05) * np.eye(states)
    names, delays = ["a", "b"][:outputs], np.array([0.2, 0.0])[:outputs] * (seed % 3 == 0)
    unit, size = 10.0 ** rng.choice([-12, 0, 12], 2)
    sensors = {
        name: {"price": 1.0 + k, "available": [[0.0, (2.0, 1.1)[k] * unit], [2.5 * unit, 4.0 * unit]]}
        | ({"result_delay": float(delay * unit)} if delay else {})
        for k, (name, delay) in enumerate(zip(names, delays, strict=True))
    }
    times = {"window": (4.0 + 2 * late + delays.max()) * unit, "period": 4.0 * unit, "spacing": 0.45 * unit}
    more = [{"forbidden": [[0.9 * unit, 1.6 * unit]]}, {"fixed": [0.4 * unit]}, {"cost_limit": 9.0}][seed % 3]
    asked = sd.Requirement(
        **times, **more, sensors=sensors, samples={"at_most": 4}, timing_tolerance=late * unit * (1 - 1e-9)
    )
    return sd.Plant(A / unit, C * size, outputs=names), asked, late, delays, (unit, size), rng


@pytest.mark.parametrize("seed", few(range(12), 0))
def test_no_real_times_break_a_design_and_no_schedule_beats_its_bound_whatever_else_is_asked(seed):
    plant, asked, late, delays, (unit, size), rng = crossed(seed)
    design = sd.design_schedule(plant, asked, starts=1, branches=2)
    scan = window_sigma_scan(
        plant.A * unit, plant.C / size, np.array(design.schedule.times) / unit, 4.0, asked.window / unit, places=2,
        mask=design.schedule.outputs, late=late * (1 - 1e-9), delays=delays,
    )  # fmt: skip
    assert design.sigma <= scan * size * (1 + 1e-9)
    assert design.sigma >= 0.3 * scan * size
    assert design.verify()
    problem, window = design.problem, design.requirement.window
    for _ in range(4):
        times = random_schedule(rng, problem.period, problem.spacing, len(design.schedule))
        times = (
            times if not problem.fixed.size else np.sort(np.mod(times - times[0] + problem.fixed[0], problem.period))
        )
        there = problem.mask(times)
        if there.any(axis=1).all() and np.sum(there * problem.costs) <= problem.cost_limit:
            other = sd.PeriodicSchedule.from_times(times, problem.period, there, time_unit="s")
            found = sd.window_sigma(plant, other, window, timing_tolerance=asked.timing_tolerance)
            assert found.lower <= design.upper_bound * (1 + 1e-9)


def test_texts_files_and_losses_say_for_which_times(designs, tmp_path):
    design = designs[1]
    assert "each up to 0.02 s early or late" in design.explain().split(";")[0]
    assert f"If one sample is lost, sigma is at least {below(design.deviations.lost)}." in design.explain()
    assert f"samples are up to {LATE} s early or late" in design.claim.assumptions
    assert f"each up to {LATE} early or late" in ASKED.explain()
    assert "up to 0.02" in str(ASKED)
    assert design.deviations.tolerance.plain == LATE
    assert design.deviations.late == design.sigma
    assert sd.design.sample_losses(design).lower.min() == pytest.approx(design.deviations.lost, rel=0.02)
    front = sd.pareto_front(OSCILLATOR, WIDER, [4], starts=2, branches=0)
    assert front.points[0].sigma == pytest.approx(design.sigma, rel=1e-6)
    again = read_requirement(write_requirement(ASKED, tmp_path / "wish.toml"))
    assert again.to_dict() == ASKED.to_dict()
    assert design.to_dict()["requirement"]["timing_tolerance"] == LATE


@pytest.mark.long
def test_early_apart_from_late_is_the_same_design_about_other_times(designs, tmp_path):
    asked = WIDER.replace(timing_tolerance=(0.0, 2 * LATE))
    design = sd.design_schedule(OSCILLATOR, asked, starts=1, branches=0)
    assert design.sigma == pytest.approx(designs[1].sigma, rel=1e-9)
    assert design.upper_bound == pytest.approx(designs[1].upper_bound, rel=1e-9)
    assert design.verify()
    assert "each up to 0.04 s late" in design.explain()
    again = read_requirement(write_requirement(asked, tmp_path / "wish.toml"))
    assert again.to_dict() == asked.to_dict()
    minutes = asked.replace(time_unit="min")
    assert sd.design.problem.posing.in_unit(minutes, "s").timing_tolerance == [0.0, 120 * LATE]


def test_outputs_with_tolerances_of_their_own(tmp_path):
    plant = sd.Plant(A, np.eye(2), outputs=["a", "b"])
    asked = WIDER.replace(samples=3, timing_tolerance={"a": LATE, "b": (0.0, LATE)})
    design, alike = (
        sd.design_schedule(plant, each, starts=1, branches=0)
        for each in (asked, asked.replace(timing_tolerance={"a": LATE, "b": LATE}))
    )
    assert alike.sigma <= design.sigma <= design.upper_bound
    assert design.verify()
    again = read_requirement(write_requirement(asked, tmp_path / "wish.json"))
    assert again.timing_tolerance == {"a": LATE, "b": [0.0, LATE]}
    with pytest.raises(ArgumentError, match="unknown key 'c'"):
        sd.design_schedule(plant, asked.replace(timing_tolerance={"c": LATE}))


@pytest.mark.long
def test_another_unit_of_time_changes_nothing(designs):
    minutes = sd.Plant(np.array(A) * 60, C, time_unit="min")
    design = sd.design_schedule(minutes, WIDER.replace(time_unit="s"), starts=1, branches=0)
    assert design.requirement.timing_tolerance == pytest.approx(LATE / 60)
    assert design.sigma == pytest.approx(designs[1].sigma, rel=1e-6)
    assert design.upper_bound == pytest.approx(designs[1].upper_bound, rel=1e-6)


@pytest.mark.long
def test_opening_hours_and_counts_that_are_left_open():
    asked = sd.Requirement(
        window=TURN + 2 * LATE, period=TURN, spacing=0.2, samples={"at_most": 4}, forbidden=[[1.0, 2.5]]
    )
    exact = sd.design_schedule(OSCILLATOR, asked.replace(window=TURN), starts=1, branches=0)
    late = sd.design_schedule(OSCILLATOR, asked.replace(timing_tolerance=LATE), starts=1, branches=0)
    assert 0.9 * exact.sigma < late.sigma < exact.sigma
    assert late.gap < exact.gap + 0.05
    assert late.verify()


def test_a_design_for_late_samples_that_was_forged_does_not_verify(designs):
    design = designs[0]
    times = np.array(design.schedule.times)
    turned = sd.PeriodicSchedule.from_times(times + np.array([0.0, 0.05, 0.0, 0.0]), TURN)
    forged = [
        {"sigma": 1.01 * design.sigma},
        {"sigma_attained": 0.98 * design.sigma},
        {"upper_bound": 0.99 * design.upper_bound},
        {"schedule": turned},
        *({"requirement": ASKED.replace(timing_tolerance=late, decay_rate=0.0)} for late in (0.0, LATE / 2, 2 * LATE)),
        {"requirement": ASKED.replace(timing_tolerance=(LATE, 2 * LATE))},
    ]
    assert design.verify()
    assert [k for k, changes in enumerate(forged) if replace(design, **changes).verify()] == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"timing_tolerance": -1.0}, "`timing_tolerance` must not be negative"),
        ({"timing_tolerance": 0.1}, "early and late together, must be less than the least time between two samples"),
        ({"timing_tolerance": 4.0, "spacing": 9.0}, "`window` must be longer than early and late together, 8"),
    ],
)
def test_a_tolerance_that_is_too_large_is_refused(changes, words):
    with pytest.raises(ArgumentError, match=words):
        sd.design_schedule(OSCILLATOR, ASKED.replace(**changes))


def test_a_tolerance_that_leaves_nothing_proven_is_not_called_unobservable():
    fast = sd.Plant(6 * np.array(A), C)
    asked = sd.Requirement(window=1.2, period=1.2, spacing=0.29, samples=4, timing_tolerance=0.14)
    design = sd.design_schedule(fast, asked, starts=1, branches=0)
    assert design.sigma == 0 < design.sigma_attained <= design.upper_bound
    assert "each up to 0.14 s early or late, is proven to make every state in every window" in design.explain()
    assert design.verify()


def test_windows_are_named_as_they_were_typed():
    asked = sd.Requirement(window=TURN, period=TURN, spacing=1.0, samples=1, timing_tolerance=0.1)
    with pytest.raises(InfeasibleRequirementError, match=r"leave some window 6\.28319 with 0 samples"):
        sd.design_schedule(OSCILLATOR, asked)
    finite = sd.Schedule([0.0, 1.0, 2.0])
    with pytest.raises(ArgumentError, match=r"which spans 2 with up to 0.1 more at both ends, got 2.5"):
        sd.window_sigma(OSCILLATOR, finite, 2.5, timing_tolerance=0.1)
    assert sd.window_sigma(OSCILLATOR, finite, 2.2, timing_tolerance=0.1).lower > 0
