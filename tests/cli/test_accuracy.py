"""accuracy: the table, the picture and the exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli import files
from sampling_design.cli.accuracy import TimeOptions, _finish_counts, _wanted
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError
from sampling_design.records.record import above

OSCILLATOR = Path(__file__).parents[2] / "examples" / "plants" / "oscillator.toml"


@pytest.fixture
def schedule(tmp_path):
    path = tmp_path / "schedule.json"
    sd.schedules.write_schedule(sd.PeriodicSchedule([0.7, 1.6, 0.9, 2.0], time_unit="s"), path)
    return path


def test_the_bracket_is_printed_drawn_and_written(shell, schedule, tmp_path):
    result = shell("accuracy", OSCILLATOR, schedule, "--w", "0.02", "--v", "0.4", "-o", tmp_path / "out")
    assert result.code == 0
    assert "position [m]" in result.out
    data = json.loads((tmp_path / "out" / "accuracy.json").read_text())
    assert data["lower"][0] <= 0.595 <= data["upper"][0]
    assert (tmp_path / "out" / "accuracy.png").read_bytes().startswith(b"\x89PNG")


def test_one_row_by_name(shell, schedule):
    result = shell("accuracy", OSCILLATOR, schedule, "--w", "0.01,0.02", "--v-bound", "0.4", "--of", "velocity")
    assert result.code == 0
    assert "velocity" in result.out
    assert "position" not in result.out


def test_a_missing_bound_and_a_wrong_number_are_one_sentence(shell, schedule):
    missing = shell("accuracy", OSCILLATOR, schedule, "--v", "0.4")
    assert missing.code == 2
    assert "`--w-bound` is missing" in missing.err
    wrong = shell("accuracy", OSCILLATOR, schedule, "--w", "small", "--v", "0.4")
    assert wrong.code == 2
    assert "`--w-bound` must be numbers with commas between" in wrong.err


def test_a_schedule_that_ends_has_a_start(shell, tmp_path):
    path = tmp_path / "finite.json"
    sd.schedules.write_schedule(sd.Schedule([0.7, 1.6], time_unit="s"), path)
    result = shell("accuracy", OSCILLATOR, path, "--w", "0.02", "--v", "0.4", "--initial-error", "0.5,0.5")
    assert result.code == 0
    assert "from 0.7 to 1.6 s" in result.out


def test_tolerance_deviation_and_projection(shell, schedule, tmp_path):
    result = shell(
        *("accuracy", OSCILLATOR, schedule, "--w", "0.02", "--v", "0.4", "--rtol", "0.2", "-o", tmp_path / "out"),
        *("--tolerance", "0.7,0.1", "--w-intensity", "1e-4", "--v-deviation", "0.2"),
        *("--projection", "position,velocity"),
    )
    assert result.code == 1
    assert "velocity cannot keep its tolerance" in result.out
    assert "deviation of position" in result.out
    assert (tmp_path / "out" / "projection.png").read_bytes().startswith(b"\x89PNG")
    one = shell("accuracy", OSCILLATOR, schedule, "--w", "0.02", "--v", "0.4", "--projection", "position")
    assert one.code == 2
    assert "`--projection` must be two names" in one.err
    three = shell(
        "accuracy", OSCILLATOR, schedule, "--w", "0.02", "--v", "0.4", "--tolerance", "1,2,3", "--rtol", "0.5"
    )
    assert three.code == 2
    assert "`--tolerance` must be one number or one for each of 2 rows" in three.err
    for wanted in (-1.0, [1.0, 0.0], np.nan):
        with pytest.raises(ArgumentError, match="`--tolerance` must be positive, got"):
            _wanted(wanted, 2)
    assert _wanted(np.inf, 2) == [np.inf, np.inf]


DECAYING = sd.Plant([[-0.05]], [[1.0]], time_unit="h", states=["level"])


def test_what_samples_buy_is_said_by_the_design_of_a_plant_that_needs_none(shell, tmp_path, monkeypatch):
    """Its numbers are those of the line that it says to type, for the plant's scales."""
    monkeypatch.setattr("sampling_design.cli.design.SECONDS_BOUGHT", 60.0)  # however busy the machine
    sd.plants.write_plant(DECAYING, tmp_path / "plant.toml")
    told = shell("design", tmp_path / "plant.toml")
    assert told.code == 0
    line = told.out.splitlines()[-1]
    assert line.startswith("Next: sampling-design accuracy")
    words = line.removeprefix("Next: sampling-design ").replace("-bound W", "-bound 1").replace("-bound V", "-bound 1")
    found = shell(*words.split(), "--json", "-o", tmp_path / "out")
    assert found.code == 0
    data = json.loads(found.out)
    assert (tmp_path / "out" / "accuracy.json").read_text() == found.out
    assert data["counts"] == [0, 1, 4]
    again = sd.accuracy.accuracy_by_count(DECAYING, data["counts"], period=46.1, w_bound=1, v_bound=1, rtol=0.01)
    assert data["upper"] == again.upper.tolist()
    assert f"Without samples: level {above(again.upper[0, 0], 3)}." in told.out
    for value in again.upper[1:, 0]:
        assert f"level {value:.2g}" in told.out


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("--samples", "0,2"), "`--period` is missing: so many samples in each period, as --samples"),
        (("--period", "2"), "`--samples` is missing: so many"),
        (("SCHEDULE", "--samples", "1", "--period", "2"), "are evenly spaced and come on time: leave SCHEDULE out"),
        (
            ("--samples", "1", "--period", "2", "--tolerance", "1", "--projection", "a,b"),
            "--tolerance, --projection out",
        ),
        (("--samples", "1", "--period", "2", "--timing-tolerance", "1"), "leave --timing-tolerance out"),
        (("--samples", "1.5", "--period", "2"), "`--samples` must be a whole number"),
    ],
)
def test_counts_take_the_place_of_a_schedule_and_of_what_has_one(shell, typed, words):
    result = shell("accuracy", OSCILLATOR, *typed, "--w", "0.02", "--v", "0.4")
    assert result.code == 2
    assert words in result.err


def test_without_samples_an_oscillator_has_no_bound(shell):
    bounds = ("--w", "0.02", "--v", "0.4")
    never = shell("accuracy", OSCILLATOR, "--samples", "0", "--period", "2", *bounds)
    assert never.code == 1
    assert "position has no bound" in never.out
    some = shell("accuracy", OSCILLATOR, "--samples", "0,4", "--period", "2", *bounds, "--json")
    assert some.code == 0
    assert json.loads(some.out)["format"] == "sampling-design/accuracy-by-count/1"
    assert "`SCHEDULE` is missing: give its file" in shell("accuracy", OSCILLATOR, *bounds).err


def test_refusals_of_counts_are_of_arguments():
    """The same words, where they are raised."""
    with pytest.raises(ArgumentError, match="`SCHEDULE` is missing: give its file, or a plan"):
        files.schedule_path(OSCILLATOR, None)
    with pytest.raises(ArgumentError, match="are evenly spaced and come on time: leave"):
        _finish_counts(Settings(), TimeOptions(samples="1"), {"SCHEDULE": "s.csv"}, list)
    with pytest.raises(ArgumentError, match="is missing: so many samples in each period, as --samples"):
        _finish_counts(Settings(), TimeOptions(samples="1"), {}, list)
