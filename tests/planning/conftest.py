"""One small plan with a calendar, made once: a level that drifts, read on weekdays, nine to twelve and four to six."""

import pytest

import sampling_design as sd

HOURS = {"Mon-Fri": [["09:00", "12:00"], ["16:00", "18:00"]]}


@pytest.fixture(scope="session")
def tank():
    """The plant: a level that drifts, and a flow that is not measured."""
    return sd.Plant(
        [[0.0, 0.02], [0.0, -0.05]],
        [[1.0, 0.0], [0.0, 1.0]],
        time_unit="h",
        name="tank",
        states=sd.plants.Signals(("level", "flow"), ("cm", "cm/h")),
        outputs=("gauge", "meter"),
    )


@pytest.fixture(scope="session")
def week(tank):
    """A week's plan across a change of the clocks and a holiday."""
    wanted = sd.PlanRequirement(
        {"level": 3.0},
        grid="1 h",
        visit_price=1.0,
        w_bound=[0.02, 0.01],
        sensors={"gauge": {"noise_bound": 0.5, "price": 1.0}, "meter": {"noise_bound": 0.1, "price": 1.0}},
        calendar={"start": "2026-03-23", "zone": "Europe/Berlin", "hours": HOURS, "holidays": ["2026-04-01"]},
    )
    return sd.plan_samples(tank, wanted, certificate=False, robustness=False)
