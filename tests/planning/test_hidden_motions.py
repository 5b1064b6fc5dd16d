"""Motions that never fade and that no disturbance drives: a plan sees them, or says that none can."""

import numpy as np
import pytest

from sampling_design import PlanRequirement, Plant, accuracy, plan
from sampling_design.errors import InfeasibleRequirementError, UndecidedError
from sampling_design.planning import plan as room
from sampling_design.planning.motion import hidden_at, motion_of
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
    given = {"period": 24.0, "raster": 4.0, "sensors": {"reading": {"noise_bound": 0.5, "price": 1.0}}} | more
    return PlanRequirement({"level": tolerance}, w_bound=list(w_bound), time_unit="h", **given)


def bare(requirement, **more):
    return plan(LEVEL_AND_RHYTHM, requirement, search_seconds=0.5, certificate=False, robustness=False, **more)


def test_a_plan_sees_a_rhythm_that_nothing_drives():
    found = bare(wanted())
    assert found.ratio <= 1.0
    assert found.samples >= 3  # one or two clock hours a day hide the rhythm from the level
    again = accuracy(
        LEVEL_AND_RHYTHM, found.schedule, w_bound=[0.01, 0.0, 0.0], v_bound=[0.5], of=["level"], rtol=0.005
    )
    assert again.upper[0] <= 2.5


def test_the_most_accurate_choice_sees_it_too():
    found = bare(wanted(aim="most accurate", samples=3))
    assert found.samples == 3
    assert np.isfinite(found.reached).all()


def test_what_no_allowed_time_shows_is_refused():
    with pytest.raises(InfeasibleRequirementError, match=r"a motion that never fades stays hidden. Allow other hours"):
        bare(wanted(raster=24.0))


def test_limits_that_leave_only_blind_choices_are_refused():
    with pytest.raises(InfeasibleRequirementError, match="No choice within the limits shows all that `accuracy` asks"):
        bare(wanted(aim="most accurate", samples=2))


def test_a_search_that_judged_too_well_is_mended_or_says_so(monkeypatch):
    before = room._Planning._ratios
    monkeypatch.setattr(
        room._Planning, "_ratios", lambda self, chosen: (before(self, chosen)[0], np.array([10.0 / chosen.sum()]))
    )
    with pytest.raises(UndecidedError, match=r"the densest one is proven to keep 1.667 times them"):
        bare(wanted())


def test_the_mask_is_where_the_hidden_motion_shows():
    problem = pose_plan(LEVEL_AND_RHYTHM, wanted())
    motion = motion_of(problem)
    rows = motion.rows(np.array([[1.0, 0.0, 0.0]]))
    twice = np.zeros((6, 1), dtype=bool)
    twice[[0, 3]] = True  # twelve hours apart: level, and what turns by half, but not both and the quarter
    where = hidden_at(motion, twice, problem.allowed, rows)
    assert where is not None
    assert not where[twice].any()
    assert where[~twice].all()
    assert hidden_at(motion, problem.allowed, problem.allowed, rows) is None
