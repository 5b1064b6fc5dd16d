"""estimate, validate and log on example plants and files, with right and with wrong input."""

import csv
import json
import runpy
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli import estimate as estimate_command
from sampling_design.cli.options import BoundOptions
from sampling_design.cli.settings import Settings

EXAMPLES = Path(__file__).parents[2] / "examples"
PLANTS, DATA = EXAMPLES / "plants", EXAMPLES / "data"
OSCILLATOR = PLANTS / "oscillator.toml"
TIMES = [0.9, 2.1, 3.0, 4.3, 5.1, 6.2]
INTERVALS = ["--json", "--radii", "intervals"]  # estimates in the middle are no longer those of the schedule's claim


def plant(name):
    return PLANTS / f"{name}.toml"


@pytest.fixture(scope="module")
def schedule(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "schedule.csv"
    return sd.schedules.write_schedule(sd.PeriodicSchedule([1.0, 1.2], time_unit="s"), path)


def write_readings(path, times=TIMES, start=0.0, value=np.cos):
    lines = ["# readings", "time,position,force_per_mass"]
    lines += [f"{float(t + start)!r},{float(value(t))!r},0" for t in times]
    path.write_text("\n".join(lines) + "\n")
    return path


def rows_of(path):
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_the_example_files_are_what_their_script_makes():
    made = runpy.run_path(str(DATA / "make_measurements.py"))
    for name, make in made["RECORDS"].items():
        stored = sd.read_measurements(DATA / f"{name}.csv", sd.read_plant(plant(name)))
        fresh = make().measurements
        for key in ("times", "y", "u"):
            assert getattr(stored, key) == pytest.approx(getattr(fresh, key), rel=1e-9, abs=1e-9, nan_ok=True)


@pytest.mark.long
@pytest.mark.parametrize("name", ["satellite", "three_compartment"])
def test_estimate_on_an_example_file_holds_the_truth(shell, tmp_path, name):
    made = runpy.run_path(str(DATA / "make_measurements.py"))
    truth, bounds = made["RECORDS"][name](), made["BOUNDS"][name]
    eta = {"satellite": "0.0007", "three_compartment": "0.005"}[name]
    flags = [f"--{key.replace('_', '-')}={','.join(map(str, value))}" for key, value in bounds.items()]
    result = shell(
        "estimate", plant(name), DATA / f"{name}.csv", "--eta", eta, *flags, "--radii", "intervals", "-o", tmp_path
    )
    assert result.code == 0, result.err
    assert {p.name for p in tmp_path.iterdir()} == {"estimates.csv", "estimates.json", "estimates.png"}
    assert "The guarantee is for all schedules with gaps from" in " ".join(result.out.split())
    assert "--initial-error not given: the plant's scales" in result.err
    assert "--w-bound" not in result.err
    assert (tmp_path / "estimates.png").read_bytes().startswith(b"\x89PNG")
    rows = rows_of(tmp_path / "estimates.csv")
    found = {float(r["time"]): r for r in rows}
    names = truth.measurements.plant.states.names
    for t, x in zip(truth.times[truth.at], truth.truth, strict=True):
        row = found[float(t)]
        assert row["certified"] == "1"
        for state, value in zip(names, x, strict=True):
            assert abs(float(row[state]) - value) <= float(row[f"{state}_radius"])
    data = json.loads((tmp_path / "estimates.json").read_text())
    assert data["on_schedule"] == [True] * len(rows)
    assert data["times"] == [float(r["time"]) for r in rows]


def test_estimate_with_a_schedule_or_its_certificate_is_the_same(shell, tmp_path, schedule):
    readings = write_readings(tmp_path / "y.csv", [1.0, 2.2, 3.2, 4.4, 5.4])
    quiet = ("--json", "--quiet", "--initial-error", "2")
    by_schedule = shell("estimate", OSCILLATOR, readings, "--schedule", schedule, *quiet)
    assert by_schedule.err == ""
    one = json.loads(by_schedule.out)
    assert one["certified"] == [True] * 5
    oscillator, planned = sd.read_plant(OSCILLATOR), sd.read_schedule(schedule)
    eta = 1 / sd.schedules.SamplingSet(planned).d_max
    bounds = {"w_bound": oscillator.disturbances.scales, "v_bound": oscillator.outputs.scales, "initial_error": 2.0}
    weights = sd.certificates.weights_from_bounds(oscillator, eta, **bounds)
    sd.certify(oscillator, planned, eta=eta, **weights).save(tmp_path / "c.json")
    two = json.loads(shell("estimate", OSCILLATOR, readings, "--certificate", tmp_path / "c.json", *quiet).out)
    for key in ("x", "radii"):  # the rate that the command takes is 1/1.2 up to the rounding of the file's times
        assert np.array(two[key]) == pytest.approx(np.array(one[key]), rel=1e-9)
    assert one["guarantee"] == "The guarantee is for the schedule given."
    assert two["guarantee"].startswith("Guarantee of ")


def test_times_of_a_file_without_a_schedule_need_not_begin_near_zero(shell, tmp_path):
    here = json.loads(shell("estimate", OSCILLATOR, write_readings(tmp_path / "a.csv"), *INTERVALS).out)
    there = json.loads(shell("estimate", OSCILLATOR, write_readings(tmp_path / "b.csv", start=1024.0), *INTERVALS).out)
    assert there["times"] == pytest.approx(np.array(TIMES) + 1024.0)
    assert np.array(there["x"]) == pytest.approx(np.array(here["x"]), abs=1e-8)
    assert there["on_schedule"] == [True] * len(TIMES)


def test_gaps_that_no_schedule_family_survives_are_certified_for_the_file_alone(shell, tmp_path):
    readings = write_readings(tmp_path / "y.csv", [0.5, 1.4, 4.9, 5.6, 6.5, 9.0])  # 0.7 to 3.5 holds pi
    result = shell("estimate", OSCILLATOR, readings, *INTERVALS, "--initial-error", "2")
    data = json.loads(result.out)
    assert "certified to its last time" in data["guarantee"]
    assert data["on_schedule"] == [True] * 6
    said = shell("estimate", OSCILLATOR, readings, "--initial-error", "2")
    assert f"{said.out} {said.err}".replace("\n", " ").count("certified to its last time") == 1


def test_without_any_guarantee_it_says_so_in_plain_words(shell, tmp_path):
    one = write_readings(tmp_path / "one.csv", [1.0])
    data = json.loads(shell("estimate", OSCILLATOR, one, "--json").out)
    assert data["guarantee"].startswith("No guarantee: one sample")
    blind = write_readings(tmp_path / "blind.csv", np.pi * np.arange(1, 5), value=lambda t: 1.0)
    result = shell("estimate", OSCILLATOR, blind, "--v-bound", "3", "--initial-error", "5")
    assert result.code == 0
    assert "--eta not given" in result.err
    assert "estimates" in result.out


def test_a_short_horizon_is_marked(shell, tmp_path, schedule):
    readings = write_readings(tmp_path / "y.csv", [1.0, 2.2, 3.2])
    result = shell("estimate", OSCILLATOR, readings, "--schedule", schedule, "--horizon", "0.1", "--json")
    assert "No a-priori claim: the horizon 0.1 must exceed" in result.err
    assert json.loads(result.out)["on_schedule"] == [False] * 3


def test_noise_bounds_that_the_data_disprove_are_a_no(shell, tmp_path, schedule):
    readings = write_readings(tmp_path / "y.csv", [1.0, 2.2, 3.2, 4.4], value=lambda t: 50.0 * (-1) ** int(t))
    result = shell("estimate", OSCILLATOR, readings, "--schedule", schedule, "--v-bound", "0.01", "--w-bound", "0.01")
    assert result.code == 1
    assert "bounds disproved" in result.out


def test_a_prior_is_used(shell, tmp_path, schedule):
    readings = write_readings(tmp_path / "y.csv", [1.0])
    base = ("estimate", OSCILLATOR, readings, "--schedule", schedule, "--json")
    plain, moved = (json.loads(shell(*base, *more).out) for more in ((), ("--prior", "1,0")))
    assert abs(moved["x"][0][0] - np.cos(1.0)) < abs(plain["x"][0][0] - np.cos(1.0))


def test_validate_writes_report_and_picture(shell, tmp_path, schedule):
    result = shell("validate", OSCILLATOR, schedule, "--runs", 2, "--seed", 5, "--duration", 6, "-o", tmp_path)
    assert result.code == 0, result.err
    assert {p.name for p in tmp_path.iterdir()} == {"report.md", "report.json", "validation.png"}
    assert "inequality (16)" in result.out
    assert "promises held" in result.out
    data = json.loads((tmp_path / "report.json").read_text())
    assert data["passed"] is True
    assert data["settings"]["seed"] == "5"
    assert (tmp_path / "report.md").read_text().startswith("# Validation of oscillator")
    again = json.loads(
        shell("validate", OSCILLATOR, schedule, "--runs", 2, "--seed", 5, "--duration", 6, "--workers", 2, "--json").out
    )
    assert again == data


def test_validate_without_a_certificate_is_a_no(shell, tmp_path):
    (tmp_path / "blind.csv").write_text(
        "# sampling-design schedule; time_unit=s; period=3.141592653589793\ntime\n0.5\n"
    )
    result = shell("validate", OSCILLATOR, tmp_path / "blind.csv")
    assert result.code == 1
    assert "no certificate" in result.err


def test_validate_with_a_false_certificate_fails_with_exit_code_1(shell, tmp_path, schedule):
    made = sd.certify(sd.read_plant(OSCILLATOR), sd.read_schedule(schedule), eta=0.5, P2=np.eye(2))
    parts = {key: getattr(made, key) for key in ("P2", "Qw", "R", "Qv")}
    false = sd.Certificate.from_matrices(made.plant, made.schedule, P1=1.5 * made.P1, **parts, eta=made.eta)
    false.save(tmp_path / "false.json")
    flags = ("--certificate", tmp_path / "false.json", "--runs", 3, "--duration", 12)
    result = shell("validate", OSCILLATOR, schedule, *flags)
    assert result.code == 1
    assert "BROKEN" in result.out


def test_compare_says_what_deviations_cost(shell, tmp_path):
    plan = sd.PeriodicSchedule([5554.0 / 12], first=0.0, time_unit="s")
    sd.schedules.write_schedule(plan, tmp_path / "plan.csv")
    flags = ("--window", 5554, "-o", tmp_path / "out")
    result = shell("compare", plant("satellite"), tmp_path / "plan.csv", DATA / "satellite.csv", *flags)
    assert result.code == 0, result.err
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"compare.json", "compare.png"}
    data = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert len(data["missed"]) == 3
    assert 0 < data["largest_deviation"] <= 120.0
    assert 0 < data["kept"] < 1
    assert "3 of 25 planned samples were missed" in result.out.replace("\n", " ")


def test_limits_and_means_are_taken_samples(shell, tmp_path, schedule):
    """What was read is another question than whether somebody was there: three of six counted as missed."""
    cells = ["1.0,0.5,", "2.2,<0.9,", "3.2,-0.9,", "4.4,-0.6,3.3", "5.4,>0.1,", "6.6,0.9,"]
    (tmp_path / "y.csv").write_text(
        "time,position,position_since,force_per_mass\n" + "".join(f"{each},0\n" for each in cells)
    )
    found = shell("compare", OSCILLATOR, schedule, tmp_path / "y.csv", "--window", "3", "--json")
    assert json.loads(found.out)["missed"] == []
    assert json.loads(found.out)["incomplete"] == []
    assert "Limits and means count as taken" in found.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("estimate", OSCILLATOR, "nowhere.csv"), "no such file"),
        (("estimate", OSCILLATOR, DATA / "satellite.csv"), "column 'position' is missing"),
        (("estimate", OSCILLATOR, "READINGS", "--w-bound", "1,x"), "`--w-bound` must be numbers with commas between"),
        (("estimate", OSCILLATOR, "READINGS", "--prior", "1,2,3"), "`--prior` must be one number, or 2"),
        (("estimate", OSCILLATOR, "READINGS", "--v-bound", "-1"), "`--v-bound` must not be negative"),
        (("estimate", OSCILLATOR, "EMPTY"), "holds no measurement"),
        (("validate", OSCILLATOR, "nowhere.csv"), "no such file"),
        (("validate", OSCILLATOR, "SCHEDULE", "--runs", "0"), "`--runs` must be a whole number"),
        (
            ("compare", OSCILLATOR, "SCHEDULE", "EMPTY", "--window", "3"),
            "holds no measurement",
        ),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(shell, tmp_path, schedule, arguments, words):
    (tmp_path / "empty.csv").write_text("time,position,force_per_mass\n0,,1\n")
    files = {"READINGS": write_readings(tmp_path / "y.csv"), "EMPTY": tmp_path / "empty.csv", "SCHEDULE": schedule}
    result = shell(*(files.get(part, part) for part in arguments))
    assert result.code == 2
    assert words in result.err
    assert "Traceback" not in result.err
    assert result.err.strip().splitlines()[-1].startswith("sampling-design: ")


def test_refusals_carry_their_sentence(tmp_path):
    (tmp_path / "empty.csv").write_text("time,position,force_per_mass\n0,,1\n")
    with pytest.raises(sd.ArgumentError, match=r"`MEASUREMENTS` .* holds no measurement"):
        estimate_command.estimate(Settings(quiet=True), OSCILLATOR, tmp_path / "empty.csv")
    readings = write_readings(tmp_path / "y.csv")
    with pytest.raises(sd.ArgumentError, match="`--w-bound` must be numbers with commas between"):
        estimate_command.estimate(Settings(quiet=True), OSCILLATOR, readings, typed=BoundOptions(w_bound="one"))


def test_every_command_teaches_by_an_example(shell):
    for command in ("estimate", "validate", "compare"):
        text = shell(command, "--help").out
        assert "Example: sampling-design" in text


def dated(path):
    lines = ["date,position,force_per_mass"]
    lines += [f"2026-01-05T00:00:{second:06.3f},{float(np.cos(second))!r},0" for second in (1.0, 2.2, 3.2, 4.4)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.long
def test_dates_are_laid_over_a_schedule_by_its_origin(shell, tmp_path):
    asked = ["--samples", 3, "--period", 6, "--window", 6, "--branches", 0, "--start", "2026-01-05", "--zone", "UTC"]
    made = shell("design", OSCILLATOR, *asked, "-o", tmp_path)
    assert made.code == 0, made.err
    assert sd.read_schedule(tmp_path / "schedule.csv").origin == "2026-01-05T00:00:00+00:00"
    plan = sd.PeriodicSchedule([1.0, 1.2], time_unit="s", origin="2026-01-05T00:00:00+00:00")
    path = sd.schedules.write_schedule(plan, tmp_path / "plan.csv")
    found = shell("compare", OSCILLATOR, path, dated(tmp_path / "data.csv"), "--window", 2, "--json")
    assert found.code == 0, found.err
    assert json.loads(found.out)["largest_deviation"] < 1e-9
    done = shell("estimate", OSCILLATOR, tmp_path / "data.csv", "-o", tmp_path)
    assert done.code == 0, done.err
    assert rows_of(tmp_path / "estimates.csv")[1]["date"] == "2026-01-05T00:00:02.200000+00:00"


@pytest.mark.long
@pytest.mark.parametrize("plant", ["tidal_gauge", "oscillator", "triple_integrator"])
def test_two_rows_ten_thousand_years_apart_end_with_a_sentence(shell, tmp_path, plant):
    file = OSCILLATOR.parent / f"{plant}.toml"
    found = sd.read_plant(file)
    header = ",".join(["date", *found.outputs.names, *found.inputs.names])
    row = ",1" * found.n_outputs + ",0" * found.n_inputs
    readings = tmp_path / "far.csv"
    readings.write_text(f"{header}\n0001-01-01T00:00{row}\n9999-12-31T00:00{row}\n")
    result = shell("estimate", file, readings)
    assert result.code in (0, 2, 3), result.err
    assert ("2 estimates" in result.out) == (result.code == 0)
    assert result.code == 0 or result.err.strip().splitlines()[-1].startswith("sampling-design: ")


def test_calendars_of_a_design_are_in_its_zone(shell, tmp_path):
    asked = ["--samples", 3, "--window", 6.5, "--branches", 0, "--start", "2026-01-05T08:00", "--zone", "Europe/Berlin"]
    made = shell("design", OSCILLATOR, *asked, "-o", tmp_path)
    assert made.code == 0, made.err
    assert "schedule.ics holds one" in made.err
    ics = (tmp_path / "schedule.ics").read_text()
    assert ics.count("BEGIN:VEVENT") == 3
    assert "DTSTART;TZID=Europe/Berlin:20260105T0800" in ics
    assert "+01:00" in (tmp_path / "calendar.csv").read_text()
    wrong = shell("design", OSCILLATOR, *asked[:-1], "Mars", "-o", tmp_path / "none")
    assert wrong.code == 2
    assert "`--zone` must be the name of a time zone" in wrong.err
    assert not (tmp_path / "none" / "design.json").exists()


@pytest.mark.parametrize("command", ["compare", "estimate"])
def test_dates_and_times_without_dates_are_not_mixed(shell, tmp_path, schedule, command):
    data = dated(tmp_path / "data.csv")
    plan = sd.PeriodicSchedule([1.0, 1.2], time_unit="s", origin="2026-01-05T00:00:00+00:00")
    with_origin = sd.schedules.write_schedule(plan, tmp_path / "plan.csv")
    early = tmp_path / "early.csv"
    early.write_text(data.read_text().replace("2026-", "2025-"))
    for path, readings, words in (
        (schedule, data, "`SCHEDULE` does not say which date its time 0 is"),
        (with_origin, write_readings(tmp_path / "plain.csv"), "`MEASUREMENTS` hold times without dates"),
        (with_origin, early, "before time 0 of `SCHEDULE` at 2026-01-05T00:00:00+00:00. Is it the right year?"),
    ):
        given = [path, readings] if command == "compare" else [readings, "--schedule", path]
        result = shell(command, OSCILLATOR, *given)
        assert result.code == 2
        assert words in " ".join(result.err.split())


def test_a_plant_without_inputs_can_be_followed(shell, tmp_path):
    path = tmp_path / "plant.json"
    sd.plants.write_plant(sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], outputs=["level"]), path)
    (tmp_path / "data.csv").write_text("time,level\n" + "".join(f"{t},{float(np.cos(t))!r}\n" for t in TIMES))
    assert shell("estimate", path, tmp_path / "data.csv").code == 0


def test_a_family_is_not_sought_in_passing_for_many_states(shell, tmp_path, monkeypatch):
    """The oscillator counts as large here; of eleven states the search took minutes and gigabytes."""
    monkeypatch.setattr("sampling_design.estimators.estimator_choice.FAMILY_STATES", 1)
    readings = write_readings(tmp_path / "y.csv", [1.0, 2.2, 3.2, 4.4, 5.4])
    result = shell("estimate", OSCILLATOR, readings, "--initial-error", "2")
    assert result.code == 0, result.err
    told = " ".join(f"{result.err} {result.out}".split())
    assert "The guarantee is for the file's own times only" in told
    assert "ask `certify --gap-range`: 2 states take it long" in told


def test_the_own_times_of_a_long_record_are_not_certified_in_passing(shell, tmp_path, monkeypatch):
    """Gaps around half a turn hide a state, so that no family with them can be certified."""
    readings = write_readings(tmp_path / "y.csv", [1.0, 1.5, 4.7, 5.2, 8.4])
    short = shell("estimate", OSCILLATOR, readings, "--initial-error", "2")
    monkeypatch.setattr("sampling_design.estimators.estimator_choice.OWN_SAMPLES", 4)
    long = shell("estimate", OSCILLATOR, readings, "--initial-error", "2")
    assert (short.code, long.code) == (0, 0)
    assert "The guarantee is for the file's own times only" in " ".join(short.out.split())
    assert (
        "the file's own 5 times (gaps from 0.5 to 3.2 s) are more than the 4 that are certified in passing"
        in " ".join(long.out.split())
    )


def test_of_many_states_fewer_rows_are_looked_at_closely(shell, tmp_path, monkeypatch):
    """Two states count as many here; of eleven a row took a second."""
    readings = write_readings(tmp_path / "y.csv", [1.0, 2.2, 3.2, 4.4, 5.4])
    before = shell("estimate", OSCILLATOR, readings, "--initial-error", "2", "--json")
    monkeypatch.setattr("sampling_design.estimators.online.in_order.FEW_STATES", 0.2)
    after = shell("estimate", OSCILLATOR, readings, "--initial-error", "2", "--json")
    assert "--radii" not in before.err
    assert "of 5 rows and 2 states the radii are those of ellipsoids; --radii centred" in " ".join(after.err.split())
    narrow, wide = (np.array(json.loads(found.out)["radii"]) for found in (before, after))
    assert np.all(narrow <= wide * (1 + 1e-12))
    assert np.any(narrow < wide)


def test_a_sample_that_contradicts_the_bounds_is_left_out_by_its_number(tmp_path, shell):
    path = write_readings(tmp_path / "wild.csv", value=lambda t: np.cos(t) + 3.0 * (t == 4.3))
    bounds = ["--w", "0.05", "--v", "0.1", "--initial-error", "2", "--json"]
    wild = shell("estimate", OSCILLATOR, path, *bounds)
    assert wild.code == 1
    named = json.loads(wild.out)["contradictions"]
    assert [each["number"] for each in named] == [4]
    mended = shell("estimate", OSCILLATOR, path, *bounds, "--leave-out", "4")
    assert mended.code == 0
    assert all(json.loads(mended.out)["certified"])
    assert len(json.loads(mended.out)["times"]) == len(TIMES)
    refused = shell("estimate", OSCILLATOR, path, *bounds, "--leave-out", "4;5")
    assert "`--leave-out` must hold numbers of samples, 3 or 3,17, got '4;5'" in refused.err
    refused = shell("estimate", OSCILLATOR, path, *bounds, "--leave-out", "999")
    assert "`--leave-out` must be of the" in refused.err


def test_a_folder_names_the_file_in_it(shell, schedule):
    given = shell("sigma", OSCILLATOR, schedule.parent, "--window", 3)
    assert given.code == 2
    assert f"is a folder, expected a file. Did you mean {schedule}?" in given.err
