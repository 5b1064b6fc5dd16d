"""One table per sensor, which a design and a plan read alike."""

import os

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.readings import BelowDetection
from sampling_design.design.problem.posing import pose, resolve, split_for
from sampling_design.errors import ArgumentError, FileFormatError, InfeasibleRequirementError
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.requirement_file import plan_requirement_from_dict
from sampling_design.schedules.sensor import LARGEST, Sensor, common
from tests.oracles.design import window_sigma_scan

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), time_unit="d", outputs=["gauge", "lab"])
PLACE = {"start": "2026-03-02", "zone": "Europe/Berlin", "hours": {"Mon-Sun": [["06:00", "18:00"]]}}


def designed(**terms):
    asked = sd.Requirement(window=4.0, period=2.0, spacing=0.2, samples=2, **terms)
    split = split_for(PLANT, asked)
    return resolve(split, asked).requirement, pose(split.retained, resolve(split, asked).requirement, 2, check=False)


def planned(sensors, **more):
    asked = sd.PlanRequirement({"x1": 2.0}, period=2.0, grid=0.25, w_bound=[0.1, 0.1], sensors=sensors, **more)
    return pose_plan(PLANT, asked)


TABLE = {
    "gauge": {"price": 1.0, "available": [[0.25, 0.5], [1.0, 2.0]], "noise_bound": 0.2},
    "lab": {"price": 3.0, "hours": {"Mon-Sun": [["12:00", "20:00"]]}, "noise_bound": 0.1, "result_delay": (0.25, 0.5)},
}


def test_a_design_and_a_plan_read_one_table():
    requirement, problem = designed(sensors=TABLE, calendar=PLACE)
    assert requirement.window == 3.5  # of 4: what is in of the last
    assert np.allclose(problem.forbidden, [[0.0, 0.25], [0.75, 1.25], [1.75, 2.0]])
    assert np.allclose(problem.available[0], [[0.25, 0.5], [1.0, 2.0]])
    assert np.allclose(problem.available[1], [[0.5, 0.75], [1.5, 1.75]])
    assert problem.costs.tolist() == [1.0, 3.0]
    plan = planned(TABLE, calendar=PLACE)
    assert (0.25 * np.flatnonzero(plan.allowed[:, 0])).tolist() == [0.25, 1.25, 1.5]
    assert (0.25 * np.flatnonzero(plan.allowed[:, 1])).tolist() == [0.5, 1.5]
    assert plan.price.tolist() == [1.0, 3.0]
    assert plan.result_delay.tolist() == [0.0, 0.5]


def test_a_design_never_says_more_than_the_results_that_are_in_show_each_sensor_by_its_own_delay():
    """Dense in the windows' starts. What quick sensors read in the rest of a window is not counted: safe, not tight."""
    delays = {"gauge": 0.0, "lab": 1.5}
    table = {name: {"price": 1.0, "result_delay": delay} for name, delay in delays.items()}
    asked = sd.Requirement(window=4.0, period=2.0, samples=3, spacing=0.2, decay_rate=0.1, sensors=table)
    found = sd.design_schedule(PLANT, asked, starts=1, branches=0, budget=5.0)
    assert found.requirement.window == 2.5
    mask = np.ones((3, 2), dtype=bool) if found.schedule.outputs is None else found.schedule.outputs
    shown = window_sigma_scan(PLANT.A, PLANT.C, found.schedule.times, 2.0, 4.0, 15, mask, delays=list(delays.values()))
    assert found.sigma <= shown * (1 + 1e-9)
    assert shown > 1.05 * found.sigma
    assert "quicker" in found.notes[-1]
    both = {name: {"price": 1.0, "result_delay": 1.5} for name in delays}
    same, alike = (resolve(split_for(PLANT, asked), asked.replace(sensors=each)) for each in (table, both))
    assert same.requirement.window == alike.requirement.window
    assert "notice" in same.used
    assert "notice" not in alike.used


@pytest.mark.parametrize(
    "text",
    [
        "start,stop\n0.25,0.5\n1.0,2.0\n",
        "0.25;0.5\n1.0;2.0\n",
        "begin,end,note\n2026-03-02T06:00,2026-03-02T12:00,low\n2026-03-03,2026-03-04,high\n",
    ],
)
def test_windows_come_from_a_file(tmp_path, text):
    (tmp_path / "passes.csv").write_text(text)
    (tmp_path / "design.toml").write_text(
        "format = 'sampling-design/requirement/1'\nwindow = 4.0\nperiod = 2.0\nspacing = 0.2\nsamples = 2\n"
        "[sensors.gauge]\navailable = 'passes.csv'\n[calendar]\nstart = '2026-03-02'\n"
    )
    asked = sd.design.read_requirement(tmp_path / "design.toml")
    split = split_for(PLANT, asked)
    windows = resolve(split, asked).requirement.sensors["gauge"].available
    assert np.allclose(windows, [[0.25, 0.5], [1.0, 2.0]])
    problem = planned(
        {"gauge": Sensor(available=tmp_path / "passes.csv", noise_bound=0.1)}, calendar=PLACE | {"hours": None}
    )
    assert (0.25 * np.flatnonzero(problem.allowed[:, 0])).tolist() == [0.25, 1.0, 1.25, 1.5, 1.75]
    again = plan_requirement_from_dict(problem.requirement.to_dict())
    assert again.to_dict() == problem.requirement.to_dict()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("start,stop\n", "must hold rows of two times"),
        ("1.0\n2.0\n", "must hold rows of two times"),
        ("-1,1\n2,3\n", "`available` must not be negative, got -1"),
        ("nan,1\n2,3\n", "`available` must be finite"),
    ],
)
def test_a_file_without_windows_is_refused(tmp_path, text, said):
    (tmp_path / "passes.csv").write_text(text)
    with pytest.raises((FileFormatError, ArgumentError), match=said):
        Sensor(available=tmp_path / "passes.csv")


@pytest.mark.parametrize(
    "text", [".5,1\n2,3\n", "+0.5,1\n2,3\n", "begin,end\n.5,1\n2,3\n", "begin,end,\n.5,1,low\n2,3,\n"]
)
def test_the_first_window_of_a_file_is_no_line_of_names(tmp_path, text):
    (tmp_path / "passes.csv").write_text(text)
    assert Sensor(available=tmp_path / "passes.csv").available.tolist() == [[0.5, 1.0], [2.0, 3.0]]


@pytest.mark.parametrize("first", ["-1 h,.5 h", ".5 h,.7 h", "begin,2026-03-02", "pass,end,7", ",", ",end"])
def test_a_first_row_with_a_number_a_date_or_nothing_is_never_passed_over(tmp_path, first):
    (tmp_path / "passes.csv").write_text(f"{first}\n2,3\n")
    with pytest.raises((FileFormatError, ArgumentError), match=r"rows of two times|must be a date"):
        Sensor(available=tmp_path / "passes.csv")


ASKED = {
    "design": ("requirement/1", "window = 4.0\nperiod = 2.0\nspacing = 0.2\nsamples = 2\n[sensors.gauge]\n"),
    "plan": (
        "plan-requirement/1",
        "period = 2.0\ngrid = 0.25\nw_bound = [0.1, 0.1]\naccuracy = {x1 = 2.0}\n[sensors.gauge]\nnoise_bound = 0.1\n",
    ),
}


def asked_of(kind, folder, name):
    form, text = ASKED[kind]
    path = folder / "asked.toml"
    path.write_text(f"format = 'sampling-design/{form}'\n{text}available = {name!r}\n")
    return sd.design.read_requirement(path) if kind == "design" else sd.planning.read_plan_requirement(path)


@pytest.mark.parametrize("kind", ASKED)
def test_a_requirement_file_names_windows_beside_or_below_it_and_no_other_file(tmp_path, kind):
    place, secret = tmp_path / "place", tmp_path / "secret.csv"
    (place / "below").mkdir(parents=True)
    secret.write_text("0.25,0.5\n")
    (place / "below" / "passes.csv").write_text("0.25,0.5\n")
    (place / "link.csv").symlink_to(secret)
    for name in ("below/passes.csv", "./below/passes.csv"):
        assert asked_of(kind, place, name).sensors["gauge"].available.tolist() == [[0.25, 0.5]]
    elsewhere = ("../secret.csv", "below/../../secret.csv", "link.csv", str(secret), "/dev/zero", "..\\secret.csv")
    for name in (*elsewhere, "C:\\secret.csv", "below/../below/passes.csv"):
        with pytest.raises(FileFormatError, match=r"sensors\.gauge\.available.* must name a file beside or below"):
            asked_of(kind, place, name)


def test_what_is_no_plain_file_of_windows_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(FileFormatError, match="must be a plain file of windows, got a device or a pipe"):
        asked_of("plan", tmp_path, "pipe.csv")
    with pytest.raises(FileFormatError, match="must be a plain file of windows"):
        Sensor(available="/dev/zero")
    with open(tmp_path / "large.csv", "wb") as large:
        large.truncate(LARGEST + 1)
    with pytest.raises(FileFormatError, match="at most 4194304 bytes, got 4194305"):
        asked_of("plan", tmp_path, "large.csv")
    with pytest.raises(FileFormatError, match="no such file"):
        asked_of("plan", tmp_path, "passes.csv")
    with pytest.raises(FileFormatError, match="is a folder"):
        asked_of("plan", tmp_path, ".")
    with pytest.raises(FileFormatError, match="cannot be read"):
        Sensor(available="pass\0es.csv")


def test_a_reading_below_the_limit_says_what_it_is_sure_to_say():
    assert Sensor(noise_bound=0.1).sure_bound == 0.1
    assert Sensor(noise_bound=0.1, detection_limit=0.5).sure_bound == np.inf
    assert Sensor(noise_bound=0.1, detection_limit=0.5, lowest=0.0).sure_bound == pytest.approx(0.3)
    assert Sensor(noise_bound=0.6, detection_limit=0.5, lowest=0.0).sure_bound == 0.6
    for true in np.linspace(0.0, 1.0, 41):  # the middle of what is said is off by no more
        for noise in (-0.1, 0.0, 0.1):
            read = true + noise
            said = read if read >= 0.5 else (0.0 + 0.5 + 0.1) / 2
            assert abs(said - true) <= 0.3 + 1e-12


def test_a_plan_and_a_design_count_with_it():
    limited = {"gauge": {"noise_bound": 0.1, "detection_limit": 0.5, "lowest": 0.0}, "lab": {"noise_bound": 0.2}}
    assert planned(limited).v_bound.tolist() == pytest.approx([0.3, 0.2])
    del limited["gauge"]["lowest"]
    assert planned(limited).allowed.any(axis=0).tolist() == [False, True]
    _, problem = designed(sensors=limited)
    assert problem.available[0].size == 0
    assert problem.available[1] is None
    with pytest.raises(InfeasibleRequirementError, match="are sure to"):
        planned({"gauge": limited["gauge"]})


def test_a_limit_that_was_read_counts_as_planned():
    walk = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["lab"])
    for terms, known in (({"detection_limit": 0.5, "lowest": 0.0}, 0.3 + 0.05), ({}, 0.1 + 0.25)):
        asked = sd.PlanRequirement(
            {"level": 1.0}, period=2.0, grid=0.5, w_bound=0.1, sensors={"lab": {"noise_bound": 0.1, **terms}}
        )
        problem = pose_plan(walk, asked)
        chosen = np.zeros_like(problem.allowed)
        chosen[0] = True
        plan = proven_plan(problem, chosen, PlanBound((), None, None), "budget")
        rows = [(0.0, [2.0], None), (2.0, [BelowDetection(0.5)], None)]
        found = sd.next_sample(plan, rows, now=2.5, prove=False)
        assert found.known["level"] == pytest.approx(known, rel=1e-2)


@pytest.mark.parametrize(
    ("terms", "said"),
    [
        ({"lowest": 1.0}, "`lowest` must be less than `detection_limit`, got 1 and none"),
        ({"lowest": 1.0, "detection_limit": 0.5}, "`lowest` must be less than `detection_limit`, got 1 and 0.5"),
        ({"available": [["2026-03-02"]]}, "`available` must hold pairs of dates"),
        ({"available": [["soon", "later"]]}, "`available` must be a date"),
        ({"result_delay": -1.0}, "`result_delay` must not be negative"),
        ({"spacing": -1.0}, "`spacing` must be positive"),
        ({"spacing": [1.0]}, "`spacing` must be a number"),
    ],
)
def test_terms_that_say_nothing_are_refused(terms, said):
    with pytest.raises(ArgumentError, match=said):
        Sensor(**terms)


def test_what_a_design_or_a_plan_cannot_keep_is_refused():
    dated = {"gauge": {"available": [["2026-03-02", "2026-03-03"]], "noise_bound": 0.1}}
    with pytest.raises(ArgumentError, match="are dates, which need a `calendar`"):
        planned(dated)
    with pytest.raises(ArgumentError, match=r"`sensors\.gauge.available` must lie within the period"):
        planned({"gauge": {"available": [[0.0, 2.5]], "noise_bound": 0.1}})
    with pytest.raises(ArgumentError, match="is for plans: a design has one `spacing` and counts"):
        designed(sensors={"gauge": {"spacing": 1.0}})
    with pytest.raises(ArgumentError, match="`sensors` have hours of their own, which needs a `calendar`"):
        designed(sensors={"gauge": {"hours": {"Mon": [["08:00", "09:00"]]}}})
    with pytest.raises(ArgumentError, match="`window` must be longer than the longest `result_delay` 4"):
        designed(sensors={"gauge": {"result_delay": 4.0}})
    with pytest.raises(ArgumentError, match="`period` must be whole weeks with these opening hours"):
        designed(calendar=PLACE | {"hours": {"Mon": [["08:00", "09:00"]]}})


def test_windows_that_both_hold():
    assert common(None, None) is None
    assert np.array_equal(common([[0.0, 1.0]] * np.ones((1, 1)), None), [[0.0, 1.0]])
    assert np.array_equal(common(np.array([[0.0, 2.0], [3.0, 5.0]]), np.array([[1.0, 4.0]])), [[1.0, 2.0], [3.0, 4.0]])


def test_units_of_a_table_are_those_of_the_requirement():
    hours = {"gauge": {"available": [[6.0, 12.0]], "result_delay": ("6 h", "12 h"), "price": 1.0}}
    asked = sd.Requirement(window=96.0, period=48.0, spacing=4.8, samples=2, sensors=hours, time_unit="h")
    split = split_for(PLANT, asked)
    found = resolve(split, asked).requirement
    assert np.allclose(found.sensors["gauge"].available, [[0.25, 0.5]])
    assert found.window == pytest.approx(3.5)
