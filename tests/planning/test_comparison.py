"""Two plans side by side: figures of each, in a table, a picture and words."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError


@pytest.fixture(scope="module")
def pair(week):
    """The week, and what one sample more would bring."""
    more = sd.PlanRequirement(
        {"level": 3.0}, grid="1 h", w_bound=[0.02, 0.01], sensors=week.requirement.sensors, visit_price=1.0,
        cost_limit=6.0, calendar=week.requirement.calendar,
    )  # fmt: skip
    return week, sd.plan_samples(week.plant, more, certificate=False, robustness=False, search_seconds=0.3)


@pytest.mark.long
def test_figures_of_both_are_side_by_side(pair):
    found = pair[0].compare(pair[1], ("cheap", "close"))
    rows = dict(found.lines())
    assert rows["cost of a period"] == (f"{pair[0].cost:g}", f"{pair[1].cost:g}")
    assert [(goal.name, goal.unit) for goal in found.shared()] == [("level", "cm")]
    assert found.reached("level") == (float(pair[0].reached[0]), float(pair[1].reached[0]))
    assert pair[1].reached[0] < pair[0].reached[0]
    saved = 100 * (1 - pair[0].cost / pair[1].cost)
    assert found.explain().startswith(f"cheap costs {saved:.3g} % less; known better: level by close")
    assert found.to_dict()["close"]["cost"] == pair[1].cost


@pytest.mark.long
def test_the_picture_shows_both(pair):
    axes = pair[0].compare(pair[1]).plot()
    assert len(axes) == 3
    for k in (0, 1):
        points = [line.get_xdata().size for line in axes[k].lines if line.get_marker() == "o"]
        assert sum(points) == int(pair[k].chosen.sum())
    tops = [max(patch.get_data().values) for patch in axes[2].patches]
    assert {round(float(top), 9) for top in tops} == {round(float(p.curve(0)[1].max()), 9) for p in pair}
    assert pair[0].compare(pair[1]).plot(axes[2]) is axes[2]


def test_plans_of_other_states_are_not_compared():
    plans = []
    for states in (["level", "rate"], ["level"]):
        plant = sd.Plant(-np.eye(len(states)), [np.ones(len(states))], states=states)
        terms = {"y1": {"noise_bound": 0.1}}
        wanted = sd.PlanRequirement({"level": 0.9}, period=8.0, grid=4.0, w_bound=0.1, sensors=terms)
        plans.append(sd.plan_samples(plant, wanted, certificate=False, robustness=False, from_start=False))
    one, other = plans
    with pytest.raises(ArgumentError, match="must be a plan for the same states with at least one goal in common"):
        one.compare(other)
