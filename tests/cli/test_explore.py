"""explore: a server on loopback that says where it is, and what cannot be opened is said before it is."""

import json
import socket
from pathlib import Path

import pytest

import sampling_design as sd
from sampling_design.cli.explore import explore
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = (EXAMPLES / "plants" / "oscillator.toml", EXAMPLES / "requirements" / "oscillator.toml")
ENDS = ("--idle", 0.02, "--no-browser")


def test_it_says_its_address(shell):
    done = shell("explore", *FILES, "--w", 0.1, "--v", 0.2, "--tolerance", "0.1,0.1", *ENDS, "--json")
    assert done.code == 0
    assert json.loads(done.out)["address"].startswith("http://127.0.0.1:")


def test_a_plan_requirement_and_a_scene_open_too(shell):
    plan = EXAMPLES / "plans" / "oscillator.toml"
    assert "is open at" in shell("explore", plan, *ENDS).out
    assert "is open at" in shell("explore", FILES[0], plan, *ENDS).out
    assert "is open at" in shell("explore", "--scene", "set", *ENDS).out
    assert "brings its own plant" in shell("explore", plan, "--scene", "set", *ENDS).err
    assert "`--scene` must be one of" in shell("explore", "--scene", "opera", *ENDS).err
    assert "`PLANT` is missing: give a plant file" in shell("explore", *ENDS).err


def test_a_plan_requirement_without_its_plant_is_told(shell, tmp_path):
    text = (EXAMPLES / "plans" / "oscillator.toml").read_text()
    alone = tmp_path / "alone.toml"
    alone.write_text(text[: text.index("[plant]")])
    assert "is a requirement that holds no plant" in shell("explore", alone, *ENDS).err
    with pytest.raises(ArgumentError, match="is a requirement that holds no plant"):
        explore(Settings(quiet=True), alone)


def test_what_it_says_where_a_program_asks():
    with pytest.raises(ArgumentError, match="`PLANT` is missing: give a plant file, or one of the scenes"):
        explore(Settings(quiet=True))
    with pytest.raises(ArgumentError, match="brings its own plant, got"):
        explore(Settings(quiet=True), FILES[0], scene="set")


def test_what_it_cannot_open_is_refused(shell, tmp_path):
    once = sd.schedules.write_schedule(sd.Schedule([1.0, 2.0], time_unit="s"), tmp_path / "once.csv")
    other = sd.schedules.write_schedule(sd.PeriodicSchedule([1.0], time_unit="s"), tmp_path / "other.csv")
    assert "must be a schedule that repeats" in shell("explore", *FILES, "--schedule", once, *ENDS).err
    assert "must have the period" in shell("explore", *FILES, "--schedule", other, *ENDS).err
    assert "`--port` 70000 cannot be used" in shell("explore", *FILES, "--port", 70000, *ENDS).err
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"`--port` {port} cannot be used" in shell("explore", *FILES, "--port", port, *ENDS).err
    assert shell("explore", *FILES, "--idle", 0, "--no-browser").code == 2
