"""explore: a server on loopback that says where it is, and what cannot be opened is said before it is."""

import json
import socket
from pathlib import Path

import sampling_design as sd

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = (EXAMPLES / "plants" / "oscillator.toml", EXAMPLES / "requirements" / "oscillator.toml")
ENDS = ("--idle", 0.2, "--no-browser")


def test_it_says_its_address(shell):
    done = shell("explore", *FILES, "--w", 0.1, "--v", 0.2, "--tolerance", "0.1,0.1", *ENDS, "--json")
    assert done.code == 0
    assert json.loads(done.out)["address"].startswith("http://127.0.0.1:")


def test_what_it_cannot_open_is_refused(shell, tmp_path):
    once = sd.write_schedule(sd.Schedule([1.0, 2.0], time_unit="s"), tmp_path / "once.csv")
    other = sd.write_schedule(sd.PeriodicSchedule([1.0], time_unit="s"), tmp_path / "other.csv")
    assert "must be a schedule that repeats" in shell("explore", *FILES, "--schedule", once, *ENDS).err
    assert "must have the period" in shell("explore", *FILES, "--schedule", other, *ENDS).err
    assert "`port` 70000 cannot be used" in shell("explore", *FILES, "--port", 70000, *ENDS).err
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"`port` {port} cannot be used" in shell("explore", *FILES, "--port", port, *ENDS).err
    assert shell("explore", *FILES, "--idle", 0, "--no-browser").code == 2
