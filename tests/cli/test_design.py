"""info, design and sigma on the example plants, with right and with wrong input."""

import json
import os
import signal
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import read_schedule
from sampling_design.cli.settings import Settings
from tests.cases import few

EXAMPLES = Path(__file__).parents[2] / "examples"
PLANTS, REQUIREMENTS = EXAMPLES / "plants", EXAMPLES / "requirements"


def plant(name):
    return PLANTS / f"{name}.toml"


def test_info_lists_modes_and_counts(shell):
    result = shell("info", plant("satellite"))
    assert result.code == 0
    assert "0.00113129i" in result.out
    assert "samples needed" in result.out
    assert "--window not given: 5554 s is used." in result.err


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_the_default_window_of_a_finite_schedule_counts_from_its_first_sample(shell, tmp_path, start):
    """It is judged from there on: what passed on the clock before is no gap."""
    path = sd.schedules.write_schedule(sd.Schedule(start + 3.5 * np.arange(8), time_unit="s"), tmp_path / "s.csv")
    found = shell("sigma", plant("oscillator"), path)
    assert found.code == 0
    assert "--window not given: 7 s is used." in found.err


def test_info_as_json_is_one_object(shell, tmp_path):
    result = shell("info", plant("oscillator"), "--json", "--window", "4", "-o", tmp_path)
    assert (tmp_path / "info.json").read_text() == result.out
    data = json.loads(result.out)
    assert data["counts"]["samples_needed"] == 3
    assert data["split"]["retained_states"] == 2
    assert result.err == f"Written: {tmp_path / 'info.json'}\n"


def test_info_says_when_nothing_needs_samples(shell):
    result = shell("info", plant("three_compartment"))
    assert result.code == 0
    assert "no samples are needed" in result.out.replace("\n", " ")
    assert "faster decay" in result.out


@pytest.mark.long
def test_design_writes_table_picture_files_and_dates(shell, tmp_path):
    folder, start = tmp_path / "out", "2026-01-05T00:00+01:00"
    result = shell("design", plant("satellite"), REQUIREMENTS / "satellite.toml", "-o", folder, "--start", start)
    assert result.code == 0
    dated = {"calendar.csv", "schedule.ics"}
    assert {p.name for p in folder.iterdir()} == {"schedule.csv", "design.json", "design.png"} | dated
    assert (folder / "schedule.ics").read_bytes().startswith(b"BEGIN:VCALENDAR\r\n")
    lines = (folder / "calendar.csv").read_text().splitlines()
    assert sum(line.startswith("2026-01-0") for line in lines) == 12
    assert (folder / "design.png").read_bytes().startswith(b"\x89PNG")
    data = json.loads((folder / "design.json").read_text())
    schedule = read_schedule(folder / "schedule.csv")
    assert len(schedule) == 12
    assert schedule.gaps.min() >= 60
    assert 0 < data["sigma"] <= data["sigma_attained"] <= data["upper_bound"]
    windows = ("--window", 5564, "--timing-tolerance", 5)
    judged = json.loads(shell("sigma", plant("satellite"), folder / "schedule.csv", "--json", *windows).out)
    assert data["coordinates"] == "scaled"  # the plant has scales
    assert judged["lower"] == pytest.approx(data["sigma"], rel=1e-9)
    assert judged["upper"] == pytest.approx(data["sigma_attained"], rel=1e-9)


@pytest.mark.parametrize(("start", "until"), few([("2026-10-05", "2026-10-25"), ("2026-03-02", "2026-03-29")], 1))
def test_a_calendar_of_local_hours_never_leaves_them(shell, tmp_path, start, until):
    """The schedule counts hours that pass: once the clocks are changed, the same samples come at other hours."""
    sd.plants.write_plant(sd.Plant([[0.0]], [[1.0]], time_unit="h"), tmp_path / "level.toml")
    wanted = sd.Requirement(window=24.0, period=24.0, samples=2, forbidden=[[0.0, 8.0], [18.0, 24.0]])
    sd.design.write_requirement(wanted, tmp_path / "hours.toml")
    dated = ("-o", tmp_path / "out", "--start", start)
    result = shell("design", tmp_path / "level.toml", tmp_path / "hours.toml", *dated, "--zone", "Europe/Berlin")
    assert result.code == 0
    assert f"The clocks of Europe/Berlin change on {until}: schedule.ics ends there" in result.err.replace("\n", " ")
    text = (tmp_path / "out" / "schedule.ics").read_text()
    begins = [line.partition("Berlin:")[2] for line in text.splitlines() if line.startswith("DTSTART;")]
    events = [datetime.strptime(begin, "%Y%m%dT%H%M%S") for begin in begins]
    assert {8 <= event.hour < 18 for event in events} == {True}
    days = (datetime.fromisoformat(until) - datetime.fromisoformat(start)).days
    assert len(events) == text.count("BEGIN:VEVENT") == 2 * days
    assert "RRULE" not in text
    shell("design", tmp_path / "level.toml", tmp_path / "hours.toml", *dated, "--zone", "Asia/Kolkata")
    endless = (tmp_path / "out" / "schedule.ics").read_text()
    assert endless.count("RRULE:FREQ=DAILY") == 2  # where clocks are never changed


def test_design_prints_the_defaults_it_used(shell):
    result = shell("design", plant("oscillator"), "--branches", 0)
    assert result.code == 0
    for word in ("window", "period", "samples", "spacing"):
        assert f"{word} not given:" in result.err
    assert shell("design", plant("oscillator"), "--window", 4, "--samples", 2, "--branches", 0, "--quiet").err == ""


@pytest.mark.long
@pytest.mark.usefixtures("pixels")
def test_design_twice_is_the_same_to_the_last_byte(shell, tmp_path):
    for folder in ("one", "two"):
        arguments = (
            "design",
            plant("oscillator"),
            "--samples",
            4,
            "--branches",
            2,
            "-o",
            tmp_path / folder,
            "--seed",
            3,
        )
        done = shell(*arguments)
        assert done.code == 0
        made = tmp_path / folder / "schedule.csv"
        assert f"Next: sampling-design certify {plant('oscillator')} {made} -o {tmp_path / folder}" in done.out
    for name in ("schedule.csv", "design.png"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.long
def test_design_narrows_the_bound_with_more_branches(shell):
    arguments = ("design", plant("triple_integrator"), REQUIREMENTS / "triple_integrator.toml", "--json", "--branches")
    bounds = [json.loads(shell(*arguments, count).out)["upper_bound"] for count in (0, 12)]
    assert bounds[1] < 0.99 * bounds[0]
    refused = shell(*arguments, -1)
    assert refused.code == 2
    assert "`--branches`" in refused.err


def test_a_calendar_needs_a_folder(shell):
    lonely = shell("design", plant("oscillator"), "--start", "2026-01-05")
    assert lonely.code == 2
    assert "needs a folder" in lonely.err


def test_flags_override_the_file(shell):
    data = json.loads(
        shell(
            "design", plant("oscillator"), REQUIREMENTS / "oscillator.toml", "--samples", 3, "--branches", 0, "--json"
        ).out
    )
    assert data["requirement"]["samples"] == {"exactly": 3}


def test_design_of_a_decaying_plant_names_the_decay_rate(shell, tmp_path):
    result = shell("design", plant("three_compartment"), "-o", tmp_path)
    assert result.code == 0
    assert "--decay-rate" in result.out
    assert json.loads((tmp_path / "design.json").read_text())["schedule"] is None


def test_sigma_of_a_blind_schedule_is_a_no(shell, tmp_path):
    (tmp_path / "blind.csv").write_text(
        "# sampling-design schedule; time_unit=s; period=3.141592653589793\ntime\n0.5\n"
    )
    result = shell("sigma", plant("oscillator"), tmp_path / "blind.csv", "--window", "10", "-o", tmp_path)
    assert result.code == 1
    assert (tmp_path / "sigma.png").exists()


def test_a_schedule_in_another_unit_is_converted_with_a_notice(shell, tmp_path):
    minutes = 2.0 / 60
    text = f"# sampling-design schedule; time_unit=min; period={minutes!r}\ntime\n{minutes / 4!r}\n{minutes / 2!r}\n"
    (tmp_path / "minutes.csv").write_text(text)
    (tmp_path / "seconds.csv").write_text("# sampling-design schedule; time_unit=s; period=2.0\ntime\n0.5\n1.0\n")
    found = [
        json.loads(shell("sigma", plant("oscillator"), tmp_path / f"{unit}.csv", "--window", 4, "--json").out)
        for unit in ("minutes", "seconds")
    ]
    assert found[0]["upper"] == pytest.approx(found[1]["upper"])
    result = shell("sigma", plant("oscillator"), tmp_path / "minutes.csv", "--window", 4)
    assert "converted to s" in result.err


def test_an_impossible_requirement_is_a_no(shell):
    result = shell("design", plant("oscillator"), "--samples", 9, "--spacing", 1, "--window", 4)
    assert result.code == 1
    assert result.err.count("\n") == 1 or "not given" in result.err
    assert "sampling-design:" in result.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("info", "nowhere.toml"), "no such file"),
        (("info", PLANTS), "is a folder, expected a file"),
        (("info", plant("oscillator"), "--window", "-1"), "`--window` must be positive"),
        (("info", plant("oscillator"), "--decay-rate", "-1"), "must not be negative"),
        (("design", plant("oscillator"), "--spacing", "0"), "`--spacing` must be positive"),
        (("design", plant("oscillator"), plant("oscillator")), "oscillator.toml"),
        (("sigma", plant("oscillator"), "nowhere.csv"), "no such file"),
        (("design", plant("oscillator"), "-o", "/proc/nowhere/out"), "cannot be made a folder"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(shell, arguments, words):
    result = shell(*arguments)
    assert result.code == 2
    assert words in result.err
    assert "Traceback" not in result.err
    assert result.err.strip().splitlines()[-1].startswith("sampling-design: ")


def test_wrong_usage_is_exit_code_2(shell):
    result = shell("infos")
    assert result.code == 2
    assert "info" in result.err


def test_version(shell):
    assert shell("--version").out.startswith("sampling-design ")
    assert shell("info", "--version").out.startswith("sampling-design ")


def test_every_command_teaches_by_an_example(shell):
    for command in ("info", "design", "sigma"):
        text = shell(command, "--help").out
        assert "Example: sampling-design" in text


@pytest.mark.parametrize("more", [("-o", "taken"), ("--start", "2026-01-01")])
def test_where_to_write_is_settled_before_anything_is_designed(shell, tmp_path, monkeypatch, more):
    (tmp_path / "taken").write_text("a file, no folder")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sampling_design.design_schedule", lambda *_, **__: pytest.fail("designed all the same"))
    result = shell("design", plant("oscillator"), *more)
    assert result.code == 2
    assert "taken" in result.err or "needs a folder" in result.err


def test_info_says_what_determining_the_state_means_where_most_of_it_decays(shell, tmp_path):
    sd.plants.write_plant(sd.Plant(np.diag([0.0, -1.0, -2.0, -3.0]), np.ones((1, 4))), tmp_path / "plant.toml")
    told = " ".join(shell("info", tmp_path / "plant.toml").out.split())
    assert "Here the state means its one retained direction. The other 3 decay by themselves" in told
    sd.plants.write_plant(sd.Plant(np.diag([0.0, 0.1, -3.0]), np.ones((1, 3))), tmp_path / "two.toml")
    told = " ".join(shell("info", tmp_path / "two.toml").out.split())
    assert "its 2 retained directions. The other one decays by itself and needs no samples" in told
    assert "Here the state means" not in shell("info", EXAMPLES / "plants" / "oscillator.toml").out


def required(tmp_path, text):
    file = tmp_path / "wanted.toml"
    file.write_text(f'format = "sampling-design/requirement/1"\nspacing = 0.1\nwindow = {2 * np.pi!r}\n{text}\n')
    return file


def test_a_design_that_sees_nothing_is_no_success(shell, tmp_path):
    """One sample every half turn: all readings are alike but for their sign, whenever they are taken."""
    wanted = required(tmp_path, f"period = {np.pi!r}\nsamples = 1")
    for command in (["design", "-o", tmp_path / "out"], ["pareto", "--counts", "1"]):
        done = shell(command[0], plant("oscillator"), wanted, *command[1:])
        assert done.code == 1
        assert "No admissible schedule with 1 sample every 3.14159 s makes" in " ".join(done.out.split())
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"design.json"}
    told = json.loads((tmp_path / "out" / "design.json").read_text())
    assert (told["status"], told["sigma"], told["upper_bound"]) == ("unobservable", 0.0, 0.0)


def test_a_design_that_found_nothing_leaves_the_question_open(shell, tmp_path):
    wanted = required(tmp_path, f"samples = 2\nfixed = [1.0, {1 + np.pi!r}]")
    for command in (["design"], ["losses"], ["pareto", "--counts", "2"]):
        done = shell(command[0], plant("oscillator"), wanted, *command[1:])
        assert done.code == 3
        assert "which does not show that there is none" in " ".join(done.out.replace("│", " ").split())


def test_counts_that_need_no_samples_are_met(shell):
    done = shell("pareto", plant("three_compartment"), "--counts", "1-2")
    assert done.code == 0
    assert "No samples needed" in done.out


def test_an_interrupted_design_writes_what_is_proven(shell, tmp_path, monkeypatch):
    """Ctrl-C while the bound is narrowed."""
    calls = []

    @contextmanager
    def progress(self, label):
        def call(fraction, message):
            calls.append(message)
            if len(calls) == 3:
                os.kill(os.getpid(), signal.SIGINT)

        yield call

    monkeypatch.setattr(Settings, "progress", progress)
    files = plant("oscillator"), REQUIREMENTS / "oscillator.toml"
    before = signal.getsignal(signal.SIGINT)
    result = shell("design", *files, "-o", tmp_path, "--no-picture", "--quiet")
    signal.signal(signal.SIGINT, before)
    assert (result.code, result.err) == (130, "sampling-design: interrupted.\n")
    design = json.loads((tmp_path / "design.json").read_text())
    assert design["status"] == "interrupted"
    assert 0 < design["sigma"] <= design["upper_bound"]
    assert len(read_schedule(tmp_path / "schedule.csv")) > 0


def test_where_no_samples_are_needed_the_file_is_written_too(shell, tmp_path):
    plant, schedule = tmp_path / "plant.toml", tmp_path / "schedule.csv"
    sd.plants.write_plant(sd.Plant([[-1.0]], [[1.0]]), plant)
    sd.schedules.write_schedule(sd.PeriodicSchedule([1.0], time_unit="s"), schedule)
    family = ["--window", "4", "--count", "3", "--spacing", "0.5"]
    for name, more in (("losses", []), ("sigma", [schedule]), ("worst-case", family)):
        result = shell(name, plant, *more, "-o", tmp_path / "out", "--json")
        assert result.code == 0
        written = json.loads((tmp_path / "out" / f"{name.replace('-', '_')}.json").read_text())
        assert written == json.loads(result.out)
