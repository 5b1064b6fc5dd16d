"""What `--help` shows: the examples of all commands, in order, are one story that can be typed as it stands."""

import inspect
import re
import shlex
from pathlib import Path
from shutil import copytree
from typing import get_args

import pytest

from sampling_design.cli.app import COMMANDS, function_of, loaded
from sampling_design.cli.settings import with_common_flags

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.long
def test_the_examples_of_all_commands_are_one_story(monkeypatch, tmp_path, shell):
    copytree(EXAMPLES, tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    written: dict[Path, bytes] = {}
    for command in COMMANDS:
        (example,) = re.findall(r"^ *Example: sampling-design (.*)$", shell(command, "--help").out, re.MULTILINE)
        assert example.split()[0] == command
        # a server ends by itself only when nobody asks for long
        ended = ["--idle", "0.5", "--no-browser"] if command == "explore" else []
        done = shell(*shlex.split(example), *ended)
        assert done.code == 0, f"{example}: {done.err or done.out}"
        assert done.out
        files = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
        assert [path for path in written if files.get(path) != written[path]] == [], f"{command} overwrites"
        written = files
    told = {path.name for path in written}
    assert {"schedule.csv", "plan.json", "certificate.json", "estimates.csv", "report.md", "thyroid.md"} <= told


TIMES = {
    "window", "period", "spacing", "horizon", "duration", "timing_tolerance", "gap_range", "spaced", "result_delay",
    "oscillation", "decay", "half_life", "grid", "eta", "decay_rate", "days",
}  # fmt: skip


def options(command):
    return [each for each in loaded(command).params if each.param_type_name == "option"]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_time_has_a_unit_and_a_number_its_default(command):
    """Read by who has neither the code nor another option beside it."""
    assert [
        o.opts[0] for o in options(command) if o.name in TIMES and not re.search(r"time unit\]|\[d\]", o.help)
    ] == []
    typed = inspect.signature(with_common_flags(function_of(command), command)).parameters
    numbers = {name for name, each in typed.items() if {float, int} & set(get_args(get_args(each.annotation)[0]))}
    silent = [o for o in options(command) if o.name in numbers and o.default is None and "efault" not in o.help]
    assert [o.opts[0] for o in silent] == []


def test_every_time_is_an_option_of_some_command():
    assert {o.name for command in COMMANDS for o in options(command)} >= TIMES
