"""What `--help` shows: the examples of all commands, in order, are one story that can be typed as it stands."""

import re
import shlex
from pathlib import Path
from shutil import copytree

import pytest

from sampling_design.cli.app import COMMANDS

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.long
def test_the_examples_of_all_commands_are_one_story(monkeypatch, tmp_path, shell):
    copytree(EXAMPLES, tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    for command in COMMANDS:
        (example,) = re.findall(r"^ *Example: sampling-design (.*)$", shell(command, "--help").out, re.MULTILINE)
        assert example.split()[0] == command
        # a server ends by itself only when nobody asks for long
        ended = ["--idle", "0.5", "--no-browser"] if command == "explore" else []
        done = shell(*shlex.split(example), *ended)
        assert done.code == 0, f"{example}: {done.err or done.out}"
        assert done.out
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"schedule.csv", "certificate.json", "estimates.csv", "report.md", "thyroid.md"} <= written
