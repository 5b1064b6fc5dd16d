"""What the command line itself refuses, in its own words."""

import functools
import inspect
import os
import shutil
from pathlib import Path

import pytest

import sampling_design as sd
from sampling_design.cli import files
from sampling_design.cli.app import COMMANDS, function_of, loaded
from sampling_design.cli.design import _counts, design
from sampling_design.cli.options import timing
from sampling_design.cli.settings import Settings, with_common_flags
from sampling_design.design import write_requirement
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.schedules import PeriodicSchedule, write_schedule
from tests.cases import few

OSCILLATOR = Path(__file__).parents[2] / "examples" / "plants" / "oscillator.toml"


def test_counts():
    assert list(_counts("2,4-6")) == [2, 4, 5, 6]
    for text in ("3-", "\u00b2", "2-\u00b2"):  # a digit that is no number
        with pytest.raises(ArgumentError, match="`--counts` must look like 8,10,12 or 8-16"):
            _counts(text)
    with pytest.raises(ArgumentError, match="`--counts` must name at least one number"):
        _counts("")


def test_a_folder_that_cannot_be_made(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="cannot be made a folder"):
        Settings(output=tmp_path / "file" / "out").folder()
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    with pytest.raises(ArgumentError, match="is a folder in which nothing can be written"):
        Settings(output=tmp_path).folder()


@pytest.mark.parametrize(
    "typed",
    ["design {o} --start 2.3.2026", "pareto {o} --counts x", "plan {p} --periods 0", "next {o}", "thyroid --runs 0",
     "thyroid --reading per_month", "estimate {o} {d} --radii wide", "estimate {o} {d} --outliers x",
     "validate {o} {s} --runs 0", "validate {o} {s} --duration -1", "worst-case {o} --window 4 --count 3 --spacing 5"],
)  # fmt: skip
def test_a_command_that_is_refused_says_so_alone_and_leaves_no_folder(shell, tmp_path, typed):
    schedule = write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "schedule.csv")
    named = {"o": OSCILLATOR, "p": PLANS / "oscillator.toml", "d": DATA / "oscillator.csv", "s": schedule}
    result = shell(*typed.format(**named).split(), "-o", tmp_path / "new" / "out")
    assert result.code == (1 if "worst-case" in typed else 2)
    assert (result.out, result.err.count("\n")) == ("", 1)
    assert not (tmp_path / "new").exists()


def test_a_calendar_without_a_folder():
    with pytest.raises(ArgumentError, match="writes a calendar, so it needs a folder"):
        design(Settings(quiet=True), OSCILLATOR, samples=3, start="2026-01-05")


FOLDERS = ("plants", "requirements", "data", "plans")
PLANTS, REQUIREMENTS, DATA, PLANS = (OSCILLATOR.parents[1] / folder for folder in FOLDERS)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("info", REQUIREMENTS / "oscillator.toml"), "is a requirement file, expected a plant file"),
        (("design", REQUIREMENTS / "oscillator.toml", OSCILLATOR), "is a requirement file, expected a plant file"),
        (("design", OSCILLATOR, OSCILLATOR), "is a plant file, expected a requirement file"),
        (("plan", OSCILLATOR, OSCILLATOR), "is a plant file, expected a plan requirement file"),
        (("next", OSCILLATOR), "is a plant file, expected a plan file"),
        (("info", PLANS / "oscillator.toml"), "is a plan requirement file, expected a plant file"),
        (("sigma", OSCILLATOR, OSCILLATOR), "is a plant file, expected a schedule file"),
        (("sigma", OSCILLATOR, DATA / "satellite.csv"), "is a measurement file, expected a schedule file"),
        (("estimate", PLANTS / "satellite.toml", OSCILLATOR), "is a plant file, expected a measurement file"),
        (("certify", DATA / "satellite.csv", OSCILLATOR), "is a measurement file, expected a plant file"),
        (("robustness", OSCILLATOR, OSCILLATOR), "is a plant file, expected a certificate file"),
        (("verify", REQUIREMENTS / "oscillator.toml"), "is a requirement file, expected a certificate file"),
    ],
)
def test_files_in_the_wrong_place_are_named_as_what_they_are(shell, arguments, words):
    result = shell(*arguments, "--quiet")
    assert result.code == 2
    assert words in result.err
    assert "Are the arguments in their order?" in result.err


@pytest.mark.parametrize("named", [OSCILLATOR, "oscillator", PLANTS / "satellite.toml"])
def test_a_plant_alone_is_no_plan_requirement(shell, named):
    result = shell("plan", named, "--quiet")
    assert (result.code, result.err.count("\n")) == (2, 1)
    assert f"`REQUIREMENT` is missing: {named} is a plant, and nothing says how well what must be known." in result.err


def test_a_window_too_long_to_list_is_said_of_the_schedule(shell, tmp_path):
    schedule = write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "schedule.csv")
    result = shell("sigma", OSCILLATOR, schedule, "--window", "1e9")
    assert (result.code, result.out) == (2, "")
    assert "`schedule` has 1e+09 samples from 1 to 1e+09, which take 7.45 GiB" in result.err


WRONG = {
    "schedule.ics": ("BEGIN:VCALENDAR\n", "is a calendar"),
    "design.png": ("", "is a picture"),
    "sheet.html": ("<!DOCTYPE html>\n", "is a web page"),
    "constants.md": ("| constant |\n", "is a document"),
    "estimates.csv": ("time,status,certified\n1,ok,1\n", "is an estimate file"),
    "estimates.json": ('{"format": "sampling-design/estimate/1", "times": [1]}', "is an estimate file"),
    "log.json": ('{"format": "sampling-design/schedule-log/1"}', "is a schedule log file"),
}
PLACES = [
    ("info {}", "plant", "plant.toml"),
    ("design plant.toml {}", "requirement", "requirement.toml"),
    ("plan plant.toml {}", "plan requirement", "plan.toml"),
    ("next {}", "plan", "plan.json"),
    ("sigma plant.toml {}", "schedule", "schedule.csv"),
    ("accuracy plant.toml {}", "schedule", "schedule.csv"),
    ("verify {}", "certificate", "certificate.json"),
    ("estimate plant.toml {}", "measurement", "form.csv"),
]


@pytest.mark.parametrize(
    ("name", "place"), few([(name, place) for name in WRONG for place in range(len(PLACES))], 0, 13)
)
def test_what_is_written_to_be_looked_at_is_no_argument(name, place, shell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(OSCILLATOR, "plant.toml")
    content, said = WRONG[name]
    command, kind, right = PLACES[place]
    Path(name).write_text(content)
    result = shell(*command.format(name).split(), "--quiet")
    assert (result.code, result.out) == (2, "")
    assert f"{name}: {said}, expected a {kind} file." in result.err
    if right == "plant.toml":
        assert result.err.rstrip().endswith("Did you mean plant.toml?")


def test_the_file_beside_is_named_where_a_missing_bound_would_be_asked_for(shell, tmp_path):
    schedule = write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "schedule.csv")
    shutil.copy(OSCILLATOR, plant := tmp_path / "plant.toml")
    assert f"is a plant file, expected a schedule file. Did you mean {schedule}?" in shell("accuracy", plant, plant).err


def test_a_command_in_a_text_does_not_say_what_the_text_is(shell, tmp_path):
    command = "# sampling-design design plant.toml requirement.toml\n"
    notes, wanted = tmp_path / "notes.txt", tmp_path / "wanted.toml"
    notes.write_text(f"Notes\n{command}")
    wanted.write_text(f"{command}samples = 3\n")
    assert "must end in .csv or .json, got" in shell("sigma", OSCILLATOR, notes, "--quiet").err
    assert "is a requirement file, expected a plant file" in shell("info", wanted, "--quiet").err


def test_a_schedule_is_not_read_as_measurements_of_ones(shell, tmp_path):
    path = write_schedule(PeriodicSchedule([1.0, 1.2], time_unit="s"), tmp_path / "schedule.csv")
    result = shell("estimate", OSCILLATOR, path, "--quiet")
    assert result.code == 2
    assert "is a schedule file, expected a measurement file. Its ones say what is to be measured" in result.err
    with pytest.raises(FileFormatError, match="is a schedule file, expected measurements"):
        sd.read_measurements(path, sd.read_plant(OSCILLATOR))


@pytest.mark.parametrize("command", COMMANDS)
def test_an_error_names_the_flag_as_it_is_typed(command, tmp_path):
    """Whatever verb refuses a value, and by whatever name: `v_bound` is typed --v-bound."""
    real = function_of(command)
    for parameter in loaded(command).params:
        flags = [each for each in parameter.opts if each.startswith("--")]
        if not flags or parameter.name in ("help", "version"):
            continue

        @functools.wraps(real)
        def refusing(settings, *, name=parameter.name, **_):
            raise ArgumentError(f"`{name}` must be otherwise, got 3.")

        refusing.__signature__ = inspect.signature(real, eval_str=True)
        wrapped = with_common_flags(refusing, command)
        given = {each: p.default for each, p in wrapped.__signature__.parameters.items()}
        given[parameter.name] = tmp_path if parameter.name == "output" else 3
        with pytest.raises(ArgumentError, match=rf"^`{flags[0]}` must be otherwise, got 3\.$"):
            wrapped(**given)


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ([], "`timing_tolerance`, early and late together, must be less than the least time between two samples, 0.5,"),
        (["--timing-tolerance", "9"], "`--timing-tolerance`, early and late"),
        (["--spacing", "0.25"], "Ask for a wider `--spacing`."),
    ],
)
def test_an_error_about_what_stands_in_a_file_names_the_key_of_the_file(shell, tmp_path, typed, words):
    path = tmp_path / "requirement.toml"
    write_requirement(sd.Requirement(window=4.0, spacing=0.5, samples=3, timing_tolerance=3.0), path)
    result = shell("design", OSCILLATOR, path, *typed, "--quiet")
    assert result.code == 2
    assert words in result.err
    assert ("`--" in result.err) == bool(typed)


@pytest.mark.parametrize(
    ("text", "name"), [("1:-1", "[1]"), ("position=-1", ".position"), ("position=1:-2", ".position[1]"), ("-1", "")]
)
def test_one_number_of_a_tolerance_is_named_by_its_flag(shell, text, name):
    result = shell("design", OSCILLATOR, f"--timing-tolerance={text}", "--quiet")
    assert result.code == 2
    assert f"`--timing-tolerance{name}` must not be negative" in result.err


@pytest.mark.parametrize("text", ["5:", ":5", "position=", "=1", "position=1,", "1:,2"])
def test_a_half_written_tolerance_is_named_as_it_was_typed(shell, text):
    result = shell("design", OSCILLATOR, "--timing-tolerance", text, "--quiet")
    assert result.code == 2
    said = f"`--timing-tolerance` must be TIME, EARLY:LATE or NAME=TIME,..., got {text!r}."
    assert result.err == f"sampling-design: {said}\n"


def test_a_tolerance_that_an_output_has_twice_is_none():
    with pytest.raises(ArgumentError, match="`--timing-tolerance` names an output twice, got 'y=1,x=2,y=3'"):
        timing("y=1,x=2,y=3")


@pytest.mark.parametrize(
    ("sensors", "words"), [("", "must name at least one"), ("a,b,a", "must be distinct, got 'a' ")]
)
def test_sensors_of_a_new_plant_are_named_as_they_are_typed(shell, tmp_path, sensors, words):
    result = shell("new", tmp_path / "new", "--oscillation", "24", "--sensors", sensors)
    assert result.code == 2
    assert result.err.startswith(f"sampling-design: `--sensors` {words}")
    assert not (tmp_path / "new").exists()


def test_a_folder_in_place_of_a_file_leads_to_the_file_in_it(shell, tmp_path):
    (tmp_path / "empty").mkdir()
    shutil.copy(OSCILLATOR, tmp_path / "plant.toml")
    write_requirement(sd.Requirement(), tmp_path / "requirement.toml")
    for arguments, words in (
        (("info", tmp_path), f"{tmp_path}: is a folder, expected a file. Did you mean {tmp_path / 'plant.toml'}?"),
        (("info", tmp_path / "empty"), f"{tmp_path / 'empty'}: is a folder, expected a file."),
        (("design", OSCILLATOR, tmp_path), f"Did you mean {tmp_path / 'requirement.toml'}?"),
    ):
        result = shell(*arguments)
        assert result.code == 2
        assert result.err.endswith(f"{words}\n")


@pytest.mark.parametrize(("earlier", "today"), [("log", "compare"), ("survive", "robustness")])
def test_an_earlier_name_of_a_command_leads_to_the_one_of_today(shell, earlier, today):
    result = shell(earlier, "plant.toml")
    assert result.code == 2
    assert result.err == f"sampling-design: `{earlier}` is called `{today}` now, with the same arguments.\n"


@pytest.mark.parametrize(
    ("command", "typed", "meant"),
    [("certify", "--rate", "--eta"), ("design", "--count", "--samples"), ("design", "--timeout", "--budget"),
     ("validate", "--n-runs", "--runs"), ("design", "--random-state", "--seed"), ("design", "--spaceing", "--spacing")],
)  # fmt: skip
def test_an_option_that_has_another_name_here_is_named(shell, command, typed, meant):
    result = shell(command, OSCILLATOR, OSCILLATOR, typed, 3)
    assert result.code == 2
    assert f"No such option: {typed} (Possible options: {meant})" in " ".join(result.err.split())


def test_a_file_in_the_wrong_place_is_an_error_of_the_file():
    with pytest.raises(FileFormatError, match="is a plant file, expected a schedule file"):
        files.schedule(OSCILLATOR)


def test_a_plant_of_the_library_is_named_without_a_file(shell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    named, read = shell("info", "oscillator"), shell("info", OSCILLATOR)
    assert named.code == read.code == 0
    assert named.out == read.out
    with pytest.raises(FileFormatError, match="A plant of the library needs no file"):
        files.plant(Path("oscilator.toml"))
    (tmp_path / "plant.toml").write_text("")
    assert "Did you mean plant.toml?" in shell("info", "plan.toml").err


def test_a_key_that_others_use_leads_to_ours(shell, tmp_path):
    text = (OSCILLATOR.parents[1] / "plans" / "oscillator.toml").read_text()
    (tmp_path / "plan.toml").write_text(text.replace("grid =", "raster ="))
    told = shell("plan", tmp_path / "plan.toml")
    assert told.code == 2
    assert "unknown key 'raster' in the requirement. Did you mean 'grid'?" in told.err
