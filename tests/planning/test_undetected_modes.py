"""Motions that never fade and that no disturbance drives: a plan sees them, or says that none can."""

from dataclasses import replace

import numpy as np
import pytest

from sampling_design import PlanRequirement, Plant, guaranteed_accuracy, plan_samples
from sampling_design.errors import ArgumentError, InfeasibleRequirementError, UndecidedError
from sampling_design.planning import discrete_plant
from sampling_design.planning import plan as room
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.discrete_plant import discretize, hidden_at
from sampling_design.planning.problem import pose_plan

RATE = 2 * np.pi / 24
LEVEL_AND_RHYTHM = Plant(
    [[0.0, 0.0, 0.0], [0.0, 0.0, RATE], [0.0, -RATE, 0.0]],
    [[1.0, 1.0, 0.0]],
    time_unit="h",
    states=["level", "rhythm", "quadrature"],
    outputs=["reading"],
)


def wanted(tolerance=2.5, w_bound=(0.01, 0.0, 0.0), **more):
    given = {"period": 24.0, "grid": 4.0, "sensors": {"reading": {"noise_bound": 0.5, "price": 1.0}}} | more
    return PlanRequirement({"level": tolerance}, w_bound=list(w_bound), time_unit="h", **given)


def bare(requirement, **more):
    return plan_samples(
        LEVEL_AND_RHYTHM, requirement, search_seconds=0.1, certificate=False, robustness=False, from_start=False, **more
    )


@pytest.mark.long
def test_a_plan_sees_a_rhythm_that_nothing_drives():
    found = bare(wanted())
    assert found.ratio <= 1.0
    assert found.samples >= 3  # one or two clock hours a day hide the rhythm from the level
    again = guaranteed_accuracy(
        LEVEL_AND_RHYTHM, found.schedule, w_bound=[0.01, 0.0, 0.0], v_bound=[0.5], of=["level"], rtol=0.005
    )
    assert again.upper[0] <= 2.5


@pytest.mark.long
def test_the_most_accurate_choice_sees_it_too():
    found = bare(wanted(aim="most accurate", samples=3))
    assert found.samples == 3
    assert np.isfinite(found.reached).all()


def test_what_no_allowed_time_shows_is_refused():
    with pytest.raises(InfeasibleRequirementError, match=r"modes 0, 0\+0.261799i never decays.*one of 8 h shows it"):
        bare(wanted(grid=24.0))


@pytest.mark.long
def test_a_grid_at_half_the_period_of_a_swing_is_refused_with_one_that_shows_it():
    swing = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["place", "speed"], outputs=["y"])
    asked = PlanRequirement(
        {"place": 1.0}, period=4 * np.pi, grid=np.pi, w_bound=0.01, sensors={"y": {"noise_bound": 0.1}}
    )
    with pytest.raises(
        InfeasibleRequirementError, match=r"the mode 0\+1i never decays.*grid hides it: one of 1.57\d* s"
    ):
        plan_samples(swing, asked, certificate=False, robustness=False, from_start=False)
    assert plan_samples(
        swing, asked.replace(grid=np.pi / 2), certificate=False, robustness=False, from_start=False
    ).keeps


def test_an_output_that_no_mode_reaches_is_not_the_grids_fault():
    blind = Plant([[0.0, 0.0], [0.0, 0.0]], [[1.0, 0.0]], states=["seen", "unseen"], outputs=["y"])
    asked = PlanRequirement({"unseen": 1.0}, period=4.0, grid=1.0, w_bound=0.01, sensors={"y": {"noise_bound": 0.1}})
    with pytest.raises(InfeasibleRequirementError, match="No sensor ever shows 0, on which unseen depends"):
        plan_samples(blind, asked, certificate=False, robustness=False, from_start=False)
    found = plan_samples(
        blind, asked.replace(accuracy={"seen": 0.14}), certificate=False, robustness=False, from_start=False
    )  # of no account
    assert found.keeps
    assert found.verify()


def test_hours_that_miss_a_motion_at_every_grid_are_said():
    daily = PlanRequirement(
        {"rhythm": 1.0}, period="1 d", grid="1 h", w_bound=[0.01] * 3, sensors={"reading": {"noise_bound": 0.1}},
        calendar={"start": "2026-03-02", "zone": "UTC", "hours": {"Mon-Sun": [["08:00", "09:00"]]}},
    )  # fmt: skip
    with pytest.raises(InfeasibleRequirementError, match=r"never decays and stays hidden. The grid hides it"):
        plan_samples(LEVEL_AND_RHYTHM, daily)  # one look a day at most, always at the same hour: two in it would do


@pytest.mark.long
def test_a_mode_that_grows_beyond_all_numbers_in_a_period_is_planned_for():
    asked = PlanRequirement({"x1": 500.0}, period=84.0, grid=4.0, w_bound=0.01, sensors={"y1": {"noise_bound": 1e-6}})
    found = plan_samples(
        Plant([[5.0]], [[1.0]]),
        asked.replace(accuracy={"x1": 1e7}),
        certificate=False,
        robustness=False,
        from_start=False,
    )
    assert found.samples == 21  # e^20 from one look to the next, e^420 in the period
    assert found.keeps
    with pytest.raises(
        InfeasibleRequirementError, match="Not even measuring at every allowed time keeps the tolerances"
    ):
        plan_samples(Plant([[5.0]], [[1.0]]), asked, certificate=False, robustness=False, from_start=False)


def test_a_mode_that_outgrows_a_step_of_the_grid_is_said_at_once():
    asked = PlanRequirement({"x1": 1.0}, period=168.0, grid=1.0, w_bound=0.01, sensors={"y1": {"noise_bound": 0.1}})
    with pytest.raises(ArgumentError, match=r"`grid` is too coarse: from one of its steps.*grows by e\^400"):
        plan_samples(Plant([[400.0]], [[1.0]]), asked)


def test_limits_that_leave_only_blind_choices_are_refused():
    with pytest.raises(InfeasibleRequirementError, match="No choice within the limits shows all that `accuracy` asks"):
        bare(wanted(aim="most accurate", samples=2))


def test_a_choice_that_is_not_found_for_want_of_work_is_not_said_to_be_none(monkeypatch):
    monkeypatch.setattr(room, "cheapest", lambda *_: (None, False))
    with pytest.raises(UndecidedError, match="undecided: no choice within the limits was found that shows all"):
        bare(wanted(aim="most accurate", samples=2))


@pytest.mark.long
def test_a_search_that_judged_too_well_is_mended_or_says_so(monkeypatch):
    before = room._Planning._proven
    monkeypatch.setattr(
        room._Planning,
        "_proven",
        lambda self, chosen: replace(before(self, chosen), ratios=np.array([10.0 / chosen.sum()])),
    )
    with pytest.raises(UndecidedError, match=r"the densest one is proven to keep 1.667 times them"):
        bare(wanted())


def test_the_mask_is_where_the_hidden_motion_shows():
    problem = pose_plan(LEVEL_AND_RHYTHM, wanted())
    discrete = discretize(problem)
    rows = discrete.rows(np.array([[1.0, 0.0, 0.0]]))
    twice = np.zeros((6, 1), dtype=bool)
    twice[[0, 3]] = True  # twelve hours apart: level, and what turns by half, but not both and the quarter
    found = hidden_at(discrete, twice, rows, np.array([True]))
    assert found is not None
    assert not found.where[twice].any()
    assert found.where[~twice].all()
    assert hidden_at(discrete, problem.allowed, rows, np.array([True])) is None


@pytest.mark.long
def test_no_sensor_is_paid_for_what_no_goal_asks():
    """A second sensor would show the zero of the first; the tide can be told without it, so no reading is bought."""
    turn = 2 * np.pi / 12.42
    gauge = Plant(
        [[0, 0, 0], [0, 0, turn], [0, -turn, 0]],
        [[1.0, 1.0, 0.0]] * 2,
        time_unit="h",
        states=["mean", "tide", "other"],
        outputs=["gauge", "survey"],
    ).augmented(bias=["gauge"], drift={"gauge_bias": 0.001})
    sensors = {"gauge": {"price": 1.0, "noise_bound": 0.02}, "survey": {"price": 20.0, "noise_bound": 0.02}}
    wanted = PlanRequirement({"tide": 0.4}, period=12.0, grid="2 h", w_bound=0.01, sensors=sensors)
    found = plan_samples(gauge, wanted, robustness=False, certificate=False, from_start=False)
    assert (found.cost, found.schedule.outputs[:, 1].any(), found.status) == (3.0, False, "complete")


def test_rows_on_the_grid_are_worked_out_once_for_all_choices(monkeypatch):
    worked_out, evenly = [], discrete_plant._even
    monkeypatch.setattr(discrete_plant, "_even", lambda rows: worked_out.append(rows.ndim) or evenly(rows))
    problem = pose_plan(LEVEL_AND_RHYTHM, wanted())
    oracle = AccuracyOracle(problem, discretize(problem))
    choices = np.eye(problem.steps, dtype=bool)
    found = [oracle.hidden(chosen[:, None]) for chosen in [*choices, np.ones(problem.steps, dtype=bool)]]
    assert [each is None for each in found] == [False] * problem.steps + [True]
    assert worked_out.count(3) == 2  # outputs and goals, at every step
