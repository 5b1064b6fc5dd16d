"""accuracy: the table, the picture and the exit codes."""

import json
from pathlib import Path

import pytest

import sampling_design as sd

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
        *("accuracy", OSCILLATOR, schedule, "--w", "0.02", "--v", "0.4", "--rtol", "0.05", "-o", tmp_path / "out"),
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
