"""Each sample that a plan allows lies on the grid of the local clock, in opening hours, at changes of the clocks too.

Checked on the days themselves with zoneinfo: both changes of the year, north and south, half an hour and an hour.
"""

from datetime import UTC, datetime, timedelta
from itertools import product
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning.dates import plan_dates
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from tests.cases import few

HOURS = {"Mon-Fri": [["00:00", "04:00"], ["08:00", "17:30"]], "Sun": [["01:00", "04:00"]]}
ZONES = {
    "Europe/Berlin": ("2026-03-23", "2026-10-19"),
    "America/New_York": ("2026-03-02", "2026-10-26"),
    "Australia/Lord_Howe": ("2026-03-30", "2026-09-28"),
    "Asia/Kathmandu": ("2026-03-23", "2026-10-19"),
}
TANK = sd.Plant([[-0.01]], [[1.0]], time_unit="h", states=["level"], outputs=["gauge"])


def wanted(zone, start, grid, closed=()):
    return sd.PlanRequirement(
        {"level": 5.0},
        period="1 wk",
        grid=grid,
        w_bound=0.01,
        sensors={"gauge": {"noise_bound": 0.1}},
        calendar={"start": start, "zone": zone, "hours": HOURS, "holidays": list(closed)},
    )


def is_open(local):
    spans = {**dict.fromkeys("01234", HOURS["Mon-Fri"]), "6": HOURS["Sun"]}.get(str(local.weekday()), [])
    clock = f"{local:%H:%M}"
    return any(a <= clock < b for a, b in spans)


@pytest.mark.parametrize(
    ("zone", "season", "grid"), few(product(ZONES, (0, 1), ["15 min", "30 min"]), 0, 3, 5, 6, 8, 11, 13, 14)
)
def test_all_allowed_times_of_two_weeks(zone, season, grid):
    requirement = wanted(zone, ZONES[zone][season], grid)
    problem, calendar, place = pose_plan(TANK, requirement), requirement.calendar, ZoneInfo(zone)
    minutes = int(grid.split()[0])
    told = set()
    for week in (0, 1):
        for step in np.flatnonzero(problem.allowed[:, 0]):
            real = calendar.instant((week * problem.steps + int(step)) * minutes).astimezone(UTC)
            local = real.astimezone(place)
            meant = datetime.fromisoformat(ZONES[zone][season]) + timedelta(
                minutes=(week * problem.steps + int(step)) * minutes
            )
            skipped = meant.replace(tzinfo=place).astimezone(UTC).astimezone(place).replace(tzinfo=None) != meant
            assert (local.hour * 60 + local.minute) % minutes == 0
            assert skipped or (is_open(local) and local.replace(tzinfo=None) == meant)
            told.add(real)
    every = [
        datetime.fromisoformat(ZONES[zone][season]).replace(tzinfo=place).astimezone(UTC)
        + timedelta(minutes=minutes * k)
        for k in range(2 * problem.steps + 8)
    ]
    span = datetime.fromisoformat(ZONES[zone][season]) + timedelta(days=14)
    missed = []
    for real in every:
        local = real.astimezone(place)
        if local.replace(tzinfo=None) < span and is_open(local) and not local.fold and real not in told:
            missed.append(local)
    assert missed == []  # whatever the clocks show once and the place is open for may be taken


@pytest.mark.parametrize("zone", few(ZONES, 2))
def test_dates_of_a_plan_stand_on_the_grid_in_opening_hours(zone):
    for start in ZONES[zone]:
        requirement = wanted(zone, start, "30 min")
        problem = pose_plan(TANK, requirement)
        chosen = np.zeros_like(problem.allowed)
        chosen[np.flatnonzero(problem.allowed[:, 0])[[1, 40, -3, -1]], 0] = True
        found = proven_plan(problem, chosen, PlanBound((), None, None), "budget")
        dates = plan_dates(found, 2, prove=False)
        place = ZoneInfo(zone)
        first = datetime.fromisoformat(start).replace(tzinfo=place).astimezone(UTC)
        for entry in dates.entries:
            local = (first + timedelta(hours=entry.time)).astimezone(place)
            assert local == entry.date
            assert local.minute % 30 == 0
            assert is_open(local)
